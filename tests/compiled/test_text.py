"""Numbers in text are the float64 nearest to their digits, as Python's `float` reads them."""

import math
import os
import random
import subprocess
import sys
from fractions import Fraction

import numpy as np
import pytest

from tests import ROOT
from tests.loops import compiled
from xcg.common.messages import SceneError
from xcg.compiled import text
from xcg.readers.files.table import parse_table


def digits(rng, most):
    return "".join(rng.choices("0123456789", k=rng.randint(1, most)))


def double(rng):
    """Any finite float64, each pattern of bits as likely as any other."""
    value = math.inf
    while not math.isfinite(value):
        value = float(np.uint64(rng.getrandbits(64)).view(np.float64))
    return value


def halfway(rng):
    """All digits of what lies in the middle between two neighbouring numbers, or of a shorter one beside it."""
    low = (
        abs(double(rng))
        if rng.random() < 0.1
        else math.ldexp(1 + rng.random(), rng.randint(-60, 60))
    )
    middle = (Fraction(low) + Fraction(math.nextafter(low, math.inf))) / 2
    power = middle.denominator.bit_length() - 1  # the denominator is a power of two
    whole = str(middle.numerator * 5**power)
    if rng.random() < 0.5:
        whole = whole[: rng.randint(15, 25)] + "0" * max(0, len(whole) - 25)
    return f"{whole}e-{power}"


SHAPES = [
    lambda rng: str(rng.getrandbits(rng.randint(1, 63))),  # whole numbers up to 2^63
    lambda rng: str(2**53 + rng.randint(-3, 3)) + rng.choice(["", ".0", "00", "e1"]),
    lambda rng: f"{digits(rng, 9)}.{digits(rng, 25)}",
    lambda rng: f"{digits(rng, 9)}.{digits(rng, 8)}",
    lambda rng: f"{digits(rng, 25)}",
    lambda rng: f".{digits(rng, 18)}",
    lambda rng: f"{digits(rng, 12)}.",
    lambda rng: f"{digits(rng, 12)}e{rng.choice(['', '+', '-'])}{digits(rng, 3)}",
    lambda rng: f"{digits(rng, 3)}.{digits(rng, 17)}E{rng.choice(['', '+', '-'])}{rng.randint(0, 340)}",
    lambda rng: f"{digits(rng, 3)}.{digits(rng, 17)}e{rng.choice('+-')}{rng.randint(0, 30):02d}",
    lambda rng: "0" * rng.randint(1, 30) + digits(rng, 9),
    lambda rng: f"0.{'0' * rng.randint(0, 30)}{digits(rng, 18)}",
    lambda rng: f"{rng.random():.{rng.randint(1, 20)}g}",
    lambda rng: f"{rng.gauss(0, 1) * 10.0 ** rng.randint(-12, 12):.{rng.randint(1, 20)}g}",
    lambda rng: f"{rng.gauss(0, 1):.{rng.randint(0, 20)}f}",
    lambda rng: f"{rng.gauss(0, 1):.{rng.randint(0, 20)}e}",
    lambda rng: repr(double(rng)),
    lambda rng: f"{double(rng):.{rng.randint(1, 24)}e}",
    lambda rng: f"{math.ldexp(rng.random(), -1022):.{rng.randint(1, 20)}g}",  # subnormal
    lambda rng: f"{rng.choice([4.9e-324, 2.2250738585072014e-308, 1.7976931348623157e308]):.{rng.randint(12, 30)}e}",
    lambda rng: f"{rng.gauss(0, 1):.{rng.randint(0, 20)}e}".replace("e", rng.choice("dD")),  # Fortran
    lambda rng: f"{digits(rng, 3)}.{digits(rng, 3)}D{rng.choice(['', '+', '-'])}{rng.randint(0, 340)}",
    halfway,
    lambda rng: rng.choice(["inf", "Infinity", "0", "0.0", "0e9", "1e999", "1e-999", "0e9999999999", "1e-9999999999"]),
]  # fmt: skip


def words(count, seed=0):
    rng = random.Random(seed)
    found = []
    for k in range(count):
        word = SHAPES[k % len(SHAPES)](rng)
        found.append(word if word[0] in "+-" else rng.choice(["", "", "-", "-", "+"]) + word)
    return found


def wrong(found, columns=10):
    """Words that are not read as Python reads them, to the bit, and how many are left to Python."""
    rows = len(found) // columns
    numbers = [float(word.lower().replace("d", "e")) for word in found]
    expected = np.array(numbers).reshape(rows, columns).T
    ends = [" \n", "\r\n", "\n", "\t \n"]
    lines = [
        " \t"[row % 2].join(found[row * columns : (row + 1) * columns]) + ends[row // 7 % 4]
        for row in range(rows)
    ]
    names = [f"{k}" for k in range(columns)]
    table = parse_table("".join(lines).rstrip().encode(), names, names, rows, "numbers")
    read = np.stack([table[name] for name in names])
    differs = read.view(np.uint64) != expected.view(np.uint64)
    return [found[k] for k in np.flatnonzero(differs.T)]


def test_numbers_are_the_nearest_float64():
    assert wrong(words(220_000)) == []


def test_numbers_are_the_same_without_the_compiler():
    """The loop is the same Python function: eight digits at a time, products of 128 bits."""
    code = """
import numba, numpy as np
from tests.compiled.test_text import words, wrong
assert numba.config.DISABLE_JIT
assert wrong(words(880, seed=1)) == []
"""
    env = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], env=env, cwd=ROOT, capture_output=True,
                          text=True, check=False)  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]


@pytest.mark.parametrize("most", [4, 7, 8, 9, 17, 19])
def test_usual_numbers_are_decided_by_compiled_code(most):
    """Usual numbers are decided by compiled code."""
    rng = random.Random(most)
    for _ in range(2000):
        word = f"{rng.gauss(0, 1) * 10.0 ** rng.randint(-9, 9):.{most}g}".encode()
        data = np.full(len(word) + text.BEYOND, 10, np.uint8)
        data[: len(word)] = np.frombuffer(word, np.uint8)
        value, known = compiled(text.number)(data, 0, len(word))
        assert known
        assert value == float(word)


@pytest.mark.parametrize(
    "word",
    ["", "x", "1x", "--1", "+-1", "1-", "1e", "1e+", "e5", ".", "-", "+", "-.", ".e5", "1..2", "1.2.3", "1e5.", "1e5e5",
     "0x10", "1_000", "1,5", "nan", "-nan", "1e-0x", "12345678.1x", "1234567x", "1.2345678x", "1 e5"[2:], "1\x00",
     "١٢", "1e+٣", "infinit", "1:2", "1/2", "12345678:", "1.:", "1.0000000:", "e-05", "-e-05", "1e--5", "1e+-5",
     "1d", "1D+", "d5", "1d5e5", "1c5", "1g-05"],
)  # fmt: skip
@pytest.mark.parametrize("other", ["1", "-0.5", "1e-05"])
def test_words_that_are_no_numbers_raise(word, other):
    body = f"{other} {other}\n{other} {word}\n{other} {other}\n".encode()
    with pytest.raises(SceneError, match="file: row 1 has"):
        parse_table(body, ("a", "b"), ("a", "b"), 3, "file")
    if word:
        assert parse_table(body, ("a", "b"), ("a",), 3, "file")["a"].tolist() == [float(other)] * 3
