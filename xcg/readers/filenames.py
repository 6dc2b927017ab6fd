"""Numbers in the names of files: the order of a glob, and the step or time of files that state neither.

Of several numbers in a name the one that varies from file to file counts. Whether "2.5" is a
decimal or two numbers with a dot between them follows from all names together.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

from xcg.readers.files.text import plain_name

_NUMBER = re.compile(
    r"(?<!\d)(?<!\d\.)\d+\.\d+(?:[eE][-+]?\d{1,2})?(?!\.?\d)"  # 0.05, but no part of 2024.01.05
    r"|(?<!\d)\d+[eE][-+]\d{1,2}(?!\d)"  # 5e-05
    r"|\d+",
    re.ASCII,
)
_WHOLE = re.compile(r"\d+", re.ASCII)
_POINT = re.compile(r"\d(\.|[eE][-+])\d", re.ASCII)
_ENDING = re.compile(r"\.[A-Za-z]\w*$")  # ".h5" holds no number
_SIGN = re.compile(r"(^|[_=\s])-$")  # before a number, as in "t_-0.5"
_OTHER_UNIT = re.compile(r"\s?([mnuµμ]s|min|h|hr|hours)(?![A-Za-z])")  # after a number, as in "5ms"
_OF_TIME = re.compile(r"(?:^|[^a-z])t(?:ime)?[^a-z0-9]*$", re.IGNORECASE)  # before a number


@dataclass(frozen=True)
class FileNumbers:
    """Steps and times in the names of the files of one series.

    Attributes
    ----------
    steps : list of int or None
        Number of the step of each file, if the number that counts is a whole one.
    times : list of float or None
        Time of each file, if the number that counts is a decimal.
    runs : list of str
        Paths without the number that counts; files of one run share it.
    problem : str
        Why the steps do not follow from the names; "" if they do, or names hold no numbers.
    """

    steps: list[int | None]
    times: list[float | None]
    runs: list[str]
    problem: str = ""


class _Number(NamedTuple):
    """Number in a name: its text, and where it begins."""

    text: str
    start: int

    @property
    def value(self) -> float:
        return int(self.text) if self.is_whole else float(self.text)

    @property
    def is_whole(self) -> bool:
        return self.text.isdecimal()


def sort_by_numbers(paths: Iterable[str]) -> list[str]:
    """Sort paths by the numbers in them: ``step9`` before ``step10``, ``t_0.15`` before ``t_0.2``."""
    listed = sorted(paths)
    numbers, _ = _numbers_of(listed)
    keys = {
        path: _natural_key(path, listed_numbers)
        for path, listed_numbers in zip(listed, numbers, strict=True)
    }
    return sorted(listed, key=keys.__getitem__)


def suffix_of(path: str) -> str:
    """Return the suffix of a file in lower case, before that of its compression."""
    return os.path.splitext(plain_name(path))[1].lower()


def _natural_key(path: str, numbers: Sequence[_Number]) -> list[str | float]:
    """Return texts and the numbers between them in turn, numbers by value."""
    key: list[str | float] = []
    end = 0
    for number in numbers:
        key += path[end : number.start], number.value
        end = number.start + len(number.text)
    return [*key, path[end:]]


def read_file_numbers(paths: Sequence[str]) -> FileNumbers:
    """Read the step or the time of each file from the names of all of them.

    If no number varies among the names, those in the folders are taken; if these do not vary
    either, the last number of each name.
    """
    folders = [os.path.join(os.path.dirname(path), "") for path in paths]
    names = [_ENDING.sub("", plain_name(path)) for path in paths]
    texts = names
    columns: list[list[_Number]] | list[list[_Number | None]]
    columns, problem = _varying(names)
    if not columns and not problem:
        columns, problem = _varying(folders)
        if columns:
            texts = folders
    if not columns:
        columns = [_last_numbers(names)]
    for numbers in columns:
        problem = problem or _doubt_about(texts, numbers)
    steps: list[int | None] = [None] * len(paths)
    times: list[float | None] = [None] * len(paths)
    for numbers in columns:
        if problem:
            break
        if all(number is None or number.is_whole for number in numbers):
            steps = [number and int(number.text) for number in numbers]
        else:
            times = [number and float(number.text) for number in numbers]
    without = [_without(text, number) for text, number in zip(texts, columns[-1], strict=True)]
    if texts is folders:
        folders = without
    else:
        names = without
    runs = [folder + name for folder, name in zip(folders, names, strict=True)]
    return FileNumbers(steps, times, runs, problem)


def _doubt_about(texts: Sequence[str], numbers: Sequence[_Number | None]) -> str:
    """Return why numbers cannot be steps or times in the files' unit: a sign, or another unit; "" if they can."""
    units = set()
    for text, number in zip(texts, numbers, strict=True):
        if number is None:
            continue
        end = number.start + len(number.text)
        if _SIGN.search(text[: number.start]):
            return f"'-{number.text}' in the names may be negative"
        unit = _OTHER_UNIT.match(text[end:])
        units.add(unit and unit[1])
        if unit and (not number.is_whole or len(units) > 1):
            return f"times in the names have a unit ({text[number.start : end]}{unit[0]})"
    return ""


def _without(text: str, number: _Number | None) -> str:
    if number is None:
        return text
    return f"{text[: number.start]}#{text[number.start + len(number.text) :]}"


def _last_numbers(names: Sequence[str]) -> list[_Number | None]:
    """Return the last number of each name; None for a decimal that is not called a time, as in "mu0.5"."""
    numbers_of_names, _ = _numbers_of(names)
    last: list[_Number | None] = []
    for name, numbers in zip(names, numbers_of_names, strict=True):
        last.append(None)
        if numbers and (numbers[-1].is_whole or _OF_TIME.search(name[: numbers[-1].start])):
            last[-1] = numbers[-1]
    return last


def _varying(texts: Sequence[str]) -> tuple[list[list[_Number]], str]:
    """Return the numbers that vary and may be steps or times, for each text; and why they cannot be."""
    numbers_of_texts, doubt = _numbers_of(texts)
    if doubt:
        return [], doubt
    counts = {len(listed): text for listed, text in zip(numbers_of_texts, texts, strict=True)}
    if len(counts) > 1:
        few, many = min(counts), max(counts)
        return [], f"{counts[few]!r} holds {few} numbers, and {counts[many]!r} {many}"
    columns = [
        list(numbers)
        for numbers in zip(*numbers_of_texts, strict=True)
        if len({number.value for number in numbers}) > 1
    ]
    if not all(_rise_together(column, columns[-1]) for column in columns[:-1]):
        ranges = " and ".join(_range(column) for column in columns)
        columns = _without_ranks(columns)
        if not columns:
            return [], f"several numbers in the names vary ({ranges})"
    for column in columns:
        whole = [number.text for number in column if number.is_whole]
        if not _are_whole(whole):
            return [], f"the numbers in the names ({_range(column)}) are not padded to one length"
    return columns, ""


def _range(column: Sequence[_Number]) -> str:
    least = min(column, key=lambda number: number.value)
    most = max(column, key=lambda number: number.value)
    return f"{least.text} to {most.text}"


def _rise_together(numbers: Sequence[_Number], others: Sequence[_Number]) -> bool:
    """Return whether two numbers that vary put the files into the same order."""
    pairs = sorted((b.value, a.value) for a, b in zip(numbers, others, strict=True))
    return all(before[1] <= after[1] for before, after in pairwise(pairs))


def _without_ranks(columns: Sequence[list[_Number]]) -> list[list[_Number]]:
    """Return the steps of pieces that are named by step and rank: 0, 1, ... at each step; else nothing."""
    if len(columns) != 2 or not all(number.is_whole for column in columns for number in column):
        return []
    values = [{int(number.text) for number in column} for column in columns]
    pairs = {(int(a.text), int(b.text)) for a, b in zip(*columns, strict=True)}
    if len(pairs) != len(columns[0]) or len(pairs) != len(values[0]) * len(values[1]):
        return []
    steps = [
        column
        for column, numbers in zip(columns, values, strict=True)
        if numbers != set(range(len(numbers)))
    ]
    return steps if len(steps) == 1 else []


# --- decimals --------------------------------------------------------------------------------------------


def _numbers_of(texts: Sequence[str]) -> tuple[list[list[_Number]], str]:
    """Return the numbers in each text, and what is in doubt about them: a dot may be a point or stand between two."""
    whole = [[_Number(m[0], m.start()) for m in _WHOLE.finditer(text)] for text in texts]
    if not _POINT.search("\n".join(texts)):
        return whole, ""
    numbers_of_texts = [
        [_Number(m[0], m.start()) for m in _NUMBER.finditer(text)] for text in texts
    ]
    if len(set(map(len, numbers_of_texts))) > 1:
        return whole, ""
    doubt = ""
    split = []
    for k, column in enumerate(zip(*numbers_of_texts, strict=True)):
        before = [text[: number.start] for text, number in zip(texts, column, strict=True)]
        words = [number.text for number in column]
        decimal = _are_decimals(words, before)
        if decimal is None:
            doubt = f"{column[0].text!r} in the names may be a decimal or two numbers"
        if not decimal:
            split.append(k)
    separate = []
    for listed in numbers_of_texts:
        numbers = []
        for k, number in enumerate(listed):
            if k in split:
                parts = _WHOLE.finditer(number.text)
                numbers += [_Number(m[0], number.start + m.start()) for m in parts]
            else:
                numbers.append(number)
        separate.append(numbers)
    return separate, doubt


def _are_decimals(texts: Sequence[str], before: Sequence[str]) -> bool | None:
    """Return whether numbers with dots are decimals; None where they may be, and the order of files depends on it.

    Decimals have equally many digits or no zeros at their end; whole numbers no zeros before them
    unless they are padded to one length. Where both fit, decimals are called a time ("t_0.5"), or
    follow "_", "-" or "=" and do not all begin with the same number other than 0.
    """
    if not all(text.count(".") == 1 and text.replace(".", "").isdecimal() for text in texts):
        return True
    first = [text.partition(".")[0] for text in texts]
    second = [text.partition(".")[2] for text in texts]
    of_one_length = len(set(map(len, second))) == 1
    may_be_decimals = of_one_length or all(t == "0" or not t.endswith("0") for t in second)
    may_be_whole = _are_whole(first) and _are_whole(second)
    if may_be_decimals != may_be_whole:
        return may_be_decimals
    if not may_be_decimals:
        return None
    if all(map(_OF_TIME.search, before)):
        return True
    from_zero = len(set(first)) > 1 or float(first[0]) == 0
    if from_zero and all(re.search(r"(^|[^\w.]|_)$", text) for text in before):
        return True
    in_parts = sorted(texts, key=lambda text: tuple(map(int, text.split("."))))
    if in_parts == sorted(texts, key=float):
        return False
    return None


def _are_whole(texts: Sequence[str]) -> bool:
    """Return whether texts of digits are numbers that are padded with zeros to one length, or not at all."""
    shortest = min(map(len, texts), default=0)
    return not any(text.startswith("0") and len(text) > shortest for text in texts)
