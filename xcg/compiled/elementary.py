"""exp, erf, angles and logarithms by arithmetic alone, in loops that become vector instructions, as none branches.

Each is compiled into the loop that calls it. Compiled or not they give the same bits, on every
machine. `tests/compiled/test_elementary.py` measures the errors stated here.
"""

import math

from xcg.compiled._jit import inlined
from xcg.compiled.simd import low_bits_as_exponent

_SQRT2, _LN2 = math.sqrt(2.0), math.log(2.0)
_PER_LN2 = 1.4426950408889634
# ln 2 in two parts: whole numbers below 2^11 times the first one are exact
_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
# Added to k, it leaves k rounded, and the exponent of 2^k, in the last bits of the sum.
_TO_EXPONENT = 1.5 * 2.0**52 + 1023.0
_LEAST = -709.0  # exp is 0 from here on: 2^-1023 of this many last bits is zero
_FARTHEST = 27.0  # beyond it erfc is 0
_TAN_EIGHTH, _QUARTER, _HALF_PI = math.sqrt(2.0) - 1.0, 0.25 * math.pi, 0.5 * math.pi
_LEAST_LENGTH = 1e-300  # keeps the quotient at the origin a number


@inlined
def _reduced(x):
    """2^k and exp(x - k ln 2) - 1, where |x - k ln 2| is at most half of ln 2, for x <= 709."""
    shifted = max(x, _LEAST) * _PER_LN2 + _TO_EXPONENT
    k = shifted - _TO_EXPONENT
    r = (max(x, _LEAST) - k * _LN2_HIGH) - k * _LN2_LOW
    p = 2.5100472505694996e-08
    p = p * r + 2.7620201591031547e-07
    p = p * r + 2.7557268276905696e-06
    p = p * r + 2.4801521057868204e-05
    p = p * r + 0.00019841269863171557
    p = p * r + 0.0013888888917367081
    p = p * r + 0.008333333333330039
    p = p * r + 0.041666666666623824
    p = p * r + 0.16666666666666669
    p = p * r + 0.5
    return low_bits_as_exponent(shifted), r + r * r * p


@inlined
def exp(x):
    """Exponential of x <= 709, to 1 ulp; 0 where it is below 2^-1022."""
    scale, rest = _reduced(x)
    return scale + scale * rest


@inlined
def expm1(x):
    """``exp(x) - 1`` for x <= 709, to 2 ulp."""
    scale, rest = _reduced(x)
    return scale * rest + (scale - 1.0)


@inlined
def erfcx(x):
    """``exp(x^2) erfc(x)`` for x >= 0: to 6 ulp up to 3, and 11 ulp up to 27, beyond which it is that of 27.

    A ratio of polynomials all of whose terms are positive.
    """
    x = min(x, _FARTHEST)
    p = 6.197153639121326e-05
    p = p * x + 0.0011808474066560546
    p = p * x + 0.011011627705169932
    p = p * x + 0.0650228871286509
    p = p * x + 0.2659363214370664
    p = p * x + 0.7786026847670473
    p = p * x + 1.6320945936853797
    p = p * x + 2.3717067258853435
    p = p * x + 2.1895393226357895
    p = p * x + 1.0
    q = 0.00010984168832345639
    q = q * x + 0.002092997533211815
    q = q * x + 0.019572522778103004
    q = q * x + 0.11629656532763695
    q = q * x + 0.4810637405877715
    q = q * x + 1.4366157942953586
    q = q * x + 3.1188717690926504
    q = q * x + 4.838739202196602
    q = q * x + 5.11557682781966
    q = q * x + 3.3179184897312908
    q = q * x + 1.0
    return p / q


@inlined
def erf(x):
    """Error function of x >= 0, to 2 ulp."""
    s = x * x
    p = -7.795898827002142e-10
    p = p * s + 1.3720064546777686e-08
    p = p * s - 1.6208483801871705e-07
    p = p * s + 1.6447424703317362e-06
    p = p * s - 1.492473690741966e-05
    p = p * s + 0.00012055294904839707
    p = p * s - 0.0008548325975389692
    p = p * s + 0.0052239776071164225
    p = p * s - 0.02686617064323777
    p = p * s + 0.11283791670945006
    p = p * s - 0.37612638903183543
    p = p * s + 1.1283791670955126
    return x * p if x < 1.0 else 1.0 - exp(-s) * erfcx(x)


@inlined
def angle(y, x):
    """Angle of a point (x, y) with y >= 0 to the x axis, from 0 to pi, to 5e-16; 0 at the origin."""
    across = abs(x)
    less, more = min(across, y), max(across, y)
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
def add_logarithms(ratio, bits, exponent, factor, room, out):
    """Add ``factor * log(ratio)``, for ratios from 1 on, to the first `room` numbers of an array.

    Logarithms are right to 2e-16 + 3 ulp. `bits` is the memory of `ratio` as integers, which are
    overwritten, and `exponent` is scratch (integers).
    """
    # floats and integers of one memory in separate loops, or none of them vectorises
    for k in range(room):
        exponent[k] = (bits[k] >> 52) - 1023
        bits[k] = (bits[k] & 0x000FFFFFFFFFFFFF) | 0x3FF0000000000000
    for k in range(room):
        m = ratio[k]  # mantissa, in [1, 2)
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
        out[k] += factor[k] * (_LN2 * (exponent[k] + 0.5) + 2.0 * f * series)
