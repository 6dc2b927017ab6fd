"""Hand-written vector instructions against the Python function beside each."""

from unittest import mock

import numba
import numpy as np
import pytest

from xcg.compiled import cells, simd
from xcg.compiled.reach import ALONG, LISTS, NODE, NUMBERS, Q2, X, Y, Z


def numbers(rng, shape, dtype):
    """Any numbers: for floats also negative, very large and small ones, zeros of both signs, infinities and NaN."""
    if np.dtype(dtype).kind == "i":
        return rng.integers(-1000, 1000, shape).astype(dtype)
    values = rng.normal(size=shape) * 10.0 ** rng.integers(-30, 30, shape)
    special = rng.choice([0.0, -0.0, np.inf, -np.inf, np.nan], shape)
    return np.where(rng.random(shape) < 0.1, special, values).astype(dtype)


def place(rng, end):
    """An index below `end`."""
    return np.uint64(rng.integers(0, end))


def scalar(rng):
    return float(rng.normal() * 10.0 ** rng.integers(-3, 4))


def scalars(rng, count):
    return [scalar(rng) for _ in range(count)]


# instruction, numbers of the array, and the other arguments
ARRAYS = [
    (simd.add4, "float64", (3, 5, 12),
     lambda r: [place(r, 3), place(r, 5), place(r, 9), scalar(r), tuple(scalars(r, 4))]),
    (simd.fill8, "float64", (4, 24), lambda r: [place(r, 4), place(r, 17), scalar(r)]),
    (simd.fill8, "float32", (4, 24), lambda r: [place(r, 4), place(r, 17), scalar(r)]),
    *[
        (simd.add_scalar8, dtype, (4, 24),
         lambda r, real=real: [place(r, 4), place(r, 17), real(9 * r.normal()), place(r, 4), place(r, 17)])
        for dtype, real in [("float64", float), ("float32", np.float32), ("float32", float), ("int32", int)]
    ],
    *[
        (simd.ramp8, dtype, (4, 24),
         lambda r: [*r.permutation(4)[:2].tolist(), place(r, 17), int(r.integers(-99, 99)), *scalars(r, 3)])
        for dtype in ("float64", "float32")
    ],
    *[
        (simd.stream, "float64", (24,), lambda r, n=n: [place(r, 25 - n), tuple(scalars(r, n))])
        for n in (1, 3, 9)
    ],
    (simd.prefetch, "float64", (4, 24), lambda r: [int(r.integers(-5, 50))]),
]  # fmt: skip


def compiled(instruction, count):
    """A loop that does one instruction of `count` arguments."""
    names = ", ".join(f"x{k}" for k in range(count))
    found = {}
    exec(f"def call({names}): return instruction({names})", {"instruction": instruction}, found)
    return numba.njit(error_model="numpy")(found["call"])


def assert_same_bits(one, other):
    """NaN is NaN, whatever its sign and payload."""
    np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(
        np.signbit(one)[~np.isnan(one)], np.signbit(other)[~np.isnan(other)]
    )


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize(("instruction", "dtype", "shape", "arguments"), ARRAYS)
def test_instructions_on_arrays_equal_their_python_functions(instruction, dtype, shape, arguments):
    rng = np.random.default_rng(7)
    call = compiled(instruction, 1 + len(arguments(rng)))
    changed = False
    for _ in range(30):
        before = numbers(rng, shape, dtype)
        others = arguments(rng)
        by_compiler = before.copy()
        by_python = before.copy()
        call(by_compiler, *others)
        instruction.py_func(by_python, *others)
        assert_same_bits(by_compiler, by_python)
        changed |= not np.array_equal(before, by_compiler, equal_nan=True)
    assert changed == (instruction is not simd.prefetch)


@pytest.mark.parametrize("compresses", sorted({False, cells._COMPRESSES}))
@pytest.mark.parametrize("real", ["float64", "float32", None])
def test_near_points_are_listed_with_the_same_bits_by_both_forms(real, compresses):
    """Both forms of what lists points write the same bits, of the points that are near, and nothing before them."""
    rng = np.random.default_rng(11)
    points = rng.uniform(-1, 1, (3, 64))
    place = np.array([0.1, -0.2, 0.3])
    e = np.array([0.6, 0.0, 0.8])
    along = np.clip((points.T - place) @ e, 0.0, 0.5)
    of_place = real is None
    away = np.linalg.norm(points.T - place - (0.0 if of_place else along[:, None] * e), axis=1)
    # whether the last digit counts is not the point here
    points[:, abs(away - 1.0) < 1e-5] = 9.0
    away[abs(away - 1.0) < 1e-5] = 9.0
    with mock.patch.object(cells, "_COMPRESSES", compresses):
        instruction = cells.list_near_point
        others = (tuple(place),)
        rows = (X, Y, Z, Q2)
        if not of_place:
            instruction = cells.list_near_segment
            others = (tuple(place), tuple(e), 0.5)
            rows = (Q2, ALONG)
        call = compiled(instruction, 6 + len(others))
        lanes = cells.VECTOR // np.dtype(real or "float64").itemsize
        for left in (-1, 0, 1, 5, 8, 11, 16, 40):
            found = []
            for run in (call, instruction.py_func):
                lists = np.zeros((LISTS, 40), real or "float64"), np.zeros((NUMBERS, 40), "int32")
                count = int(
                    run(*lists, np.uint64(3), tuple(points), np.uint64(20), np.int64(left), *others)
                )
                for row in rows:
                    lists[0][row, 3 + count :] = 0.0
                lists[1][NODE, 3 + count :] = 0
                found.append(lists)
            for one, other in zip(*found, strict=True):
                assert_same_bits(one, other)
            expected = [n for n in range(20, 20 + max(0, min(left, lanes))) if away[n] < 1.0]
            assert found[0][1][NODE, 3 : 3 + count].tolist() == expected
            assert not found[0][1][NODE, :3].any()
            q2 = ((points[:, expected] - place[:, None]) ** 2).sum(axis=0)
            np.testing.assert_allclose(found[0][0][Q2, 3 : 3 + count], q2, rtol=1e-5)
            if of_place:
                for row, a, b in zip((X, Y, Z), place, points, strict=True):
                    assert_same_bits(found[0][0][row, 3 : 3 + count], a - b[expected])
            else:
                foot = (points[:, expected].T - place) @ e
                np.testing.assert_allclose(found[0][0][ALONG, 3 : 3 + count], foot, atol=1e-6)


def test_transpose8x8_transposes_eight_rows():
    rng = np.random.default_rng(9)
    memory = numbers(rng, 200, "float64")
    call = compiled(simd.transpose8x8, 6)
    for _ in range(20):
        by_compiler = np.zeros((12, simd.TILE))
        by_python = by_compiler.copy()
        apart = rng.integers(8, 20)
        first = rng.integers(0, 50)
        row = rng.integers(0, 5)
        column = rng.integers(0, simd.TILE - 7)
        call(memory, first, apart, by_compiler, row, column)
        simd.transpose8x8.py_func(memory, first, apart, by_python, row, column)
        assert_same_bits(by_compiler, by_python)
        assert_same_bits(by_python[row : row + 8, column + 3], memory[first + 3 * apart :][:8])
