"""exp, erf and logarithms of the loops: errors as stated, against the C library and SciPy; the same bits uncompiled."""

import math

import numba
import numpy as np
import pytest
from scipy import special

from tests.loops import compiled, uncompiled
from xcg.compiled import elementary, simd

COUNT = 1_000_000


def over_numbers(function):
    """A loop over numbers."""

    def run(x, out):
        for k in range(x.size):
            out[k] = function(x[k])

    return numba.njit(error_model="numpy")(run)


def units(found, exact):
    """Error in units of the last place of the exact value."""
    return np.abs(found - exact) / np.spacing(np.abs(exact))


def below_zero(rng):
    """Numbers from -708 to -1e-9, half of them evenly spaced and half by decades."""
    return -np.concatenate(
        [rng.uniform(0.0, 708.0, COUNT // 2), 10.0 ** rng.uniform(-9, 2.85, COUNT // 2)]
    )


def above_zero(rng):
    """Numbers from 1e-9 to 27, as above."""
    return np.concatenate(
        [rng.uniform(0.0, 27.0, COUNT // 2), 10.0 ** rng.uniform(-9, 1.43, COUNT // 2)]
    )


def of_each(function):
    return lambda x: np.fromiter(map(function, x.tolist()), float)


# function, what it is compared with, arguments, and units of the last place: those stated and those of the other
FUNCTIONS = [
    (elementary.exp, of_each(math.exp), below_zero, 1 + 1),
    (elementary.expm1, of_each(math.expm1), below_zero, 2 + 1),
    (elementary.erf, special.erf, above_zero, 2 + 2),
    (elementary.erfcx, special.erfcx, above_zero, 11 + 5),
    (elementary.erfcx, special.erfcx, lambda rng: rng.uniform(0.0, 3.0, COUNT), 6 + 5),
]


def test_logarithms_are_accurate():
    """To 2e-16 and rounding, times their factors; the same bits uncompiled."""
    rng, room = np.random.default_rng(1), 4096
    ratio = np.concatenate(
        [10.0 ** rng.uniform(0, 290, room // 2), 1.0 + 10.0 ** rng.uniform(-16, 1, room // 2)]
    )
    factor, found = rng.normal(size=room), []
    for add in (compiled(elementary.add_logarithms), uncompiled(elementary.add_logarithms)):
        memory, out = ratio.copy(), np.zeros(room)
        add(memory, memory.view("int64"), np.zeros(room, "int64"), factor, room, out)
        found.append(out)
    np.testing.assert_array_equal(*found)
    exact = np.log(ratio)
    assert (
        np.abs(found[0] - factor * exact) <= np.abs(factor) * (2e-16 + 3 * np.spacing(exact))
    ).all()


@pytest.mark.parametrize(("function", "other", "arguments", "most"), FUNCTIONS)
def test_errors_are_within_the_stated_bounds(function, other, arguments, most):
    x = arguments(np.random.default_rng(0))
    found = np.empty_like(x)
    over_numbers(function)(x, found)
    error = units(found, other(x))
    assert error.max() <= most, x[error.argmax()]


@pytest.mark.parametrize(
    "function", [elementary.exp, elementary.expm1, elementary.erf, elementary.erfcx]
)
def test_python_gives_the_bits_of_compiled_code(function):
    rng = np.random.default_rng(1)
    x = np.concatenate([[0.0, 0.5, 1.0, 3.0, 26.9], above_zero(rng)[::5000]])
    x = -x if function in (elementary.exp, elementary.expm1) else x
    found = np.empty_like(x)
    over_numbers(function)(x, found)
    np.testing.assert_array_equal(found, [uncompiled(function)(v) for v in x])


def test_values_at_zero_and_far_out_are_exact():
    """Exact at 0, and nothing but zeros and ones far away."""
    ends = [(elementary.exp, 0.0, 1.0), (elementary.exp, -709.0, 0.0), (elementary.exp, -1e300, 0.0),
            (elementary.expm1, 0.0, 0.0), (elementary.expm1, -1e300, -1.0), (elementary.erf, 0.0, 0.0),
            (elementary.erf, 6.0, 1.0), (elementary.erf, 1e150, 1.0), (elementary.erfcx, 0.0, 1.0)]  # fmt: skip
    for function, x, value in ends:
        assert compiled(function)(x) == uncompiled(function)(x) == value
    exp = compiled(elementary.exp)
    assert exp(700.0) == pytest.approx(math.exp(700.0), rel=3e-16)
    assert math.isnan(exp(math.nan))
    for k in (-1022, -1, 0, 5, 1000):
        number = 1.5 * 2.0**52 + 1023.0 + k
        assert simd.low_bits_as_exponent.py_func(number) == _compiled(number) == 2.0**k


@numba.njit
def _compiled(number):
    return simd.low_bits_as_exponent(number)


def test_angles():
    """From the x axis, of points with y >= 0 in all directions and at all distances; the same bits uncompiled."""
    rng = np.random.default_rng(2)
    x, y = 10.0 ** rng.uniform(-150, 2, (2, COUNT // 4))
    x *= rng.choice([-1.0, 1.0], x.size)
    x[:10], y[5:15] = 0.0, 0.0
    function = elementary.angle

    @numba.njit(error_model="numpy")
    def run(y, x, out):
        for k in range(x.size):
            out[k] = function(y[k], x[k])

    found = np.empty(x.size)
    run(y, x, found)
    np.testing.assert_allclose(
        found, np.where(x == 0, np.arctan2(y, 0.0), np.arctan2(y, x)), rtol=0, atol=5e-16
    )
    plain = uncompiled(elementary.angle)
    assert [
        plain(b, a) for a, b in zip(x[:1000].tolist(), y[:1000].tolist(), strict=True)
    ] == found[:1000].tolist()
