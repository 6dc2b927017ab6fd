"""Logarithms and angles of the loops: errors as stated, against NumPy; the same bits uncompiled."""

import numba
import numpy as np

from tests.loops import uncompiled
from xcg.compiled import elementary

COUNT = 1_000_000


def test_logarithms_are_accurate():
    """To 2e-16 and rounding; the same bits uncompiled."""
    rng = np.random.default_rng(1)
    room = 4096
    ratio = np.concatenate(
        [10.0 ** rng.uniform(0, 290, room // 2), 1.0 + 10.0 ** rng.uniform(-16, 1, room // 2)]
    )
    function = elementary.logarithm

    @numba.njit(error_model="numpy")
    def run(x, out):
        for k in range(x.size):
            out[k] = function(x[k])

    values = np.empty(room)
    run(ratio, values)
    plain = uncompiled(elementary.logarithm)
    assert [plain(x) for x in ratio.tolist()] == values.tolist()
    exact = np.log(ratio)
    assert (np.abs(values - exact) <= 2e-16 + 3 * np.spacing(exact)).all()


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
