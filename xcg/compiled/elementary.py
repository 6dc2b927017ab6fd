"""Angles and logarithms by arithmetic alone, in loops that become vector instructions, as none branches.

Each is compiled into the loop that calls it. Compiled or not they give the same bits, on every
machine. `tests/compiled/test_elementary.py` measures the errors stated here.
"""

import math

from xcg.compiled._jit import inlined
from xcg.compiled.simd import exponent, mantissa

_SQRT2 = math.sqrt(2.0)
_LN2 = math.log(2.0)
_TAN_EIGHTH = math.sqrt(2.0) - 1.0
_QUARTER = 0.25 * math.pi
_HALF_PI = 0.5 * math.pi
_LEAST_LENGTH = 1e-300  # keeps the quotient at the origin a number


@inlined
def angle(y, x):
    """Angle of a point (x, y) with y >= 0 to the x axis, from 0 to pi, to 5e-16; 0 at the origin."""
    across = abs(x)
    less = min(across, y)
    more = max(across, y)
    steep = less > _TAN_EIGHTH * more
    t = (less - more if steep else less) / ((less + more if steep else more) + _LEAST_LENGTH)
    z = t * t
    p = -0.017805397205419446
    p = p * z + 0.03796525745386593
    p = p * z - 0.05035102456601552
    p = p * z + 0.05846878297330872
    p = p * z - 0.06662951813629191
    p = p * z + 0.07692045330902225
    p = p * z - 0.09090896809064027
    p = p * z + 0.11111110744919658
    p = p * z - 0.14285714279250245
    p = p * z + 0.19999999999940893
    p = p * z - 0.3333333333333312
    found = t + t * (z * p) + (_QUARTER if steep else 0.0)
    found = found if y <= across else _HALF_PI - found
    return found if x >= 0.0 else math.pi - found


@inlined
def logarithm(x):
    """Natural logarithm of a number from 1 on, to 2e-16 + 3 ulp."""
    m = mantissa(x)
    f = (m - _SQRT2) / (m + _SQRT2)
    f2 = f * f
    series = 1.0 / 19.0
    series = series * f2 + 1.0 / 17.0
    series = series * f2 + 1.0 / 15.0
    series = series * f2 + 1.0 / 13.0
    series = series * f2 + 1.0 / 11.0
    series = series * f2 + 1.0 / 9.0
    series = series * f2 + 1.0 / 7.0
    series = series * f2 + 1.0 / 5.0
    series = series * f2 + 1.0 / 3.0
    series = series * f2 + 1.0
    return _LN2 * (exponent(x) + 0.5) + 2.0 * f * series
