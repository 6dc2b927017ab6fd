"""From a path, a glob or a list of them to the files meant, in natural order."""

from __future__ import annotations

import difflib
import glob
import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import TypeAlias

from xcg.steps import errors as errors

PathLike: TypeAlias = str | os.PathLike[str]


def natural_key(path: str) -> list[tuple[int, int, str]]:
    """Key that sorts the numbers in names by value: ``step9`` comes before ``step10``."""
    return [(1, int(part), part) if part.isdecimal() else (0, 0, part) for part in re.split(r"(\d+)", path)]


def expand_paths(paths: PathLike | Iterable[PathLike], argument: str) -> list[str]:
    """List the files that a path, a glob or a list of them means.

    Parameters
    ----------
    paths : str, path or iterable of them
        Globs are sorted naturally; a list keeps its order. A file named twice counts once.
    argument : str
        Name of the argument, for messages.

    Raises
    ------
    FileNotFoundError
        If a path does not exist or a glob matches nothing; the message names similar files.
    """
    if isinstance(paths, (str, os.PathLike)):
        return _expand(os.path.expanduser(os.fspath(paths)), argument)
    found = []
    for path in paths:
        try:
            found += _expand(os.path.expanduser(os.fspath(path)), argument)
        except FileNotFoundError as error:
            if not errors.record_fault(os.fspath(path), error):
                raise
    if not found:
        errors.raise_recorded()
        raise FileNotFoundError(f"{argument}=[]: expected at least one file")
    return list(dict.fromkeys(found))


def _expand(path: str, argument: str) -> list[str]:
    if os.path.isfile(path):
        return [path]
    if os.path.isdir(path):
        if os.path.splitext(os.path.abspath(path))[1].lower() == ".zarr":
            raise FileNotFoundError(
                f"{argument}={path!r} is a Zarr folder, which is opened alone, as a scene that xcg saved"
            )
        pattern = os.path.join(path, "*.dump")
        raise FileNotFoundError(f"{argument}={path!r} is a folder; give the files in it, for example {pattern!r}")
    if glob.has_magic(path):
        files = [file for file in glob.glob(path, recursive=True) if os.path.isfile(file)]
        if files:
            return sorted(files, key=natural_key)
    folder, name = os.path.split(path)
    problem = "no file matches this pattern" if glob.has_magic(path) else "no such file"
    raise FileNotFoundError(f"{argument}={path!r}: {problem}{_what_is_there(folder or '.', name)}")


def _what_is_there(folder: str, name: str) -> str:
    if glob.has_magic(folder):
        return ""
    if not os.path.isdir(folder):
        return f"; the folder {folder!r} does not exist"
    files = sorted((entry.name for entry in Path(folder).iterdir() if entry.is_file()), key=natural_key)
    if not files:
        return f"; the folder {folder!r} holds no files"
    similar = difflib.get_close_matches(name, files, n=3, cutoff=0.4) or files[:3]
    return f"; the folder {folder!r} holds {len(files)} files, among them {', '.join(map(repr, similar))}"
