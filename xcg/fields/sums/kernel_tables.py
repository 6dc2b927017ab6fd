"""Tables of the profiles of kernels: polynomials for values at points, and for integrals along lines.

Values, marginals and derivatives are polynomials on equal intervals. Lines take *shells*, a few
polynomials within radii each, whose integrals are closed forms (`xcg.compiled.polynomials`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache, partial

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial
from numpy.typing import NDArray

from xcg.common.messages import warn_user
from xcg.compiled import smoothing as codes
from xcg.compiled.lines import mean_along
from xcg.compiled.polynomials import AT_ONCE, FIRST, POWERS, RADIUS, along_shells

Profile = Callable[[NDArray], NDArray]
Shells = list[tuple[float, Polynomial]]  # radii, and polynomials of q

_Q = Polynomial([0.0, 1.0])

_INTERVALS = 64
_TESTED = np.linspace(0.0, 1.0, 11 * _INTERVALS, endpoint=False)  # where profiles are looked at
_MOST_ERROR = 1e-10  # of values at points, relative to the largest
# of quadratures along chords; and parts of these that tell it
_MOST_LINE_ERROR = 1e-7
_PANELS = 2000
_SHELL_ERROR = 1e-13  # of the polynomials of shells, relative to the largest value
# Sums of the sizes of a polynomial's terms, relative to the largest value: rounding is as many
# times that of a value.
_LARGEST_TERMS = 5e3
_EVEN_ERROR = 2e-15  # of a polynomial of the squared radius, relative to the largest value
_MOST_EVEN = 24  # coefficients of it: more lose digits
_JUMP = 1e-4  # relative to the largest value
_AT_END = 1.0 - 1e-12  # where the last jump shows
_NEARLY = 0.97  # of the way that a piece may reach: as far as this the lowest degree is taken
_BISECTED = 1e-12  # to which ends of pieces are found
_DEGREES = (3, 5, 7, 9, 11, 13, 15, 19, 23)


def _value(profile: Profile, q: float) -> float:
    return float(profile(np.asarray(q)))


def _values(profile: Profile, q: NDArray) -> NDArray:
    """Values of a profile, of one that takes numbers only, too."""
    try:
        return np.broadcast_to(np.asarray(profile(q), float), q.shape)
    except (TypeError, ValueError):
        return np.array([_value(profile, x) for x in q])


@lru_cache
def _largest(profile: Profile) -> float:
    """Largest absolute value of a profile."""
    return float(np.abs(_values(profile, _TESTED)).max())


def _integral(function: Callable[[float], float], begin: float, end: float) -> float:
    from scipy.integrate import quad  # slow to import, and only few kernels need it

    # with its full output it does not warn, of profiles of fewer digits: `check_table` tells how
    # far they are off
    return quad(function, begin, end, epsabs=1e-14, epsrel=1e-13, limit=500, full_output=1)[0]


@lru_cache
def profile_integral(profile: Profile, dimension: int) -> float:
    """Integral of a profile over the unit ball of this many dimensions."""
    sphere = {1: 2.0, 2: 2 * math.pi, 3: 4 * math.pi}[dimension]
    shells = _shells(profile)
    if shells:
        return sphere * sum(
            (shell * _Q ** (dimension - 1)).integ()(radius) for radius, shell in shells
        )
    return sphere * _integral(lambda q: _value(profile, q) * q ** (dimension - 1), 0.0, 1.0)


def check_table(name: str, profile: Profile) -> None:
    """Raise ValueError for profiles that are not finite or have no positive integral; warn if a table is inaccurate.

    Values are looked at in places between the nodes of the table.
    """
    exact = _values(profile, _TESTED)
    if not np.isfinite(exact).all():
        wrong = _TESTED[~np.isfinite(exact)][0]
        raise ValueError(
            f"the profile of kernel {name!r} must be finite on [0, 1): it is not at q={wrong:.3g}"
        )
    if not profile_integral(profile, 3) > 0:
        raise ValueError(f"the profile of kernel {name!r} must have a positive integral")
    largest = _largest(profile)
    error = np.abs(
        codes.sample(codes.TABLE, table_of(profile, 0), _TESTED, derivative=False) - exact
    )
    if error.max() > _MOST_ERROR * largest:
        warn_user(
            f"kernel {name!r}: sums use its profile to {error.max() / largest:.1e} of its largest value, worst at "
            f"q={_TESTED[error.argmax()]:.3g}; a profile that is smooth, or has its kinks at multiples of "
            f"1/{_INTERVALS}, is kept to {_MOST_ERROR:g}"
        )
        return
    inside = [radius for radius in jumps_of(profile) if radius < 1.0]
    if inside:
        warn_user(
            f"kernel {name!r}: its profile jumps at q={inside[0]:.3g}, and where one axis is averaged, sums take "
            f"values within 1/{_INTERVALS} of there that are off by up to 3 % of the jump"
        )
    if not _shells(profile) and (off := _line_error(profile)) > _MOST_LINE_ERROR:
        warn_user(
            f"kernel {name!r}: its profile takes more than {codes.PIECE} polynomials between radii, so that integrals "
            f"along contacts are quadratures, which are off by {off:.1e} of the largest value; a profile with fewer "
            "kinks has closed forms"
        )


def _line_error(profile: Profile) -> float:
    """Error of quadratures along chords of the support, relative to the largest value of the profile."""
    x, weights = np.polynomial.legendre.leggauss(4)
    share = (np.arange(_PANELS)[:, None] + 0.5 + 0.5 * x) / _PANELS
    largest = 0.0
    for distance in np.linspace(0.0, 0.96, 13):
        half = math.sqrt(1.0 - distance * distance)
        radii = np.hypot(distance, half * (2.0 * share - 1.0))
        exact = 0.5 * (_values(profile, radii.ravel()).reshape(radii.shape) @ weights).mean()
        chord = np.array([[half, distance]]), np.array([2.0 * half, 0.0])
        mean = mean_along(*chord, 0, codes.TABLE, table_of(profile, 0))
        largest = max(largest, abs(float(mean[0]) - exact))
    return largest / _largest(profile)


def jumps_of(profile: Profile) -> list[float]:
    """Radii at which a profile jumps, the cutoff among them; without shells no others are known."""
    # each shell ends with the jump of the profile
    jumps = {radius: float(shell(radius)) for radius, shell in _shells(profile)}
    jumps = jumps or {1.0: _value(profile, _AT_END)}
    return [radius for radius, jump in jumps.items() if abs(jump) > _JUMP * _largest(profile)]


@lru_cache
def table_of(profile: Profile, codimension: int) -> NDArray:
    """Polynomials of the value and of its derivative / q on equal intervals, integrated over `codimension` axes.

    In codimension 1 both are over half of the chord, sqrt(1 - q^2), as loops take them: the
    quotient is as smooth up to the cutoff as the profile. With them come the shells that lines
    take, where there are any.
    """
    degree = codes.PIECE - 1
    table = np.zeros((4, _INTERVALS, codes.PIECE))
    domains = [(k / _INTERVALS, (k + 1) / _INTERVALS) for k in range(_INTERVALS)]
    value = np.vectorize(_integrated(profile, codimension))
    pieces = [Chebyshev.interpolate(value, degree, domain) for domain in domains]
    points = np.polynomial.chebyshev.chebpts1(codes.PIECE)
    for k, (domain, series) in enumerate(zip(domains, pieces, strict=True)):
        q = 0.5 * (domain[0] + domain[1]) + 0.5 / _INTERVALS * points
        slope = series.deriv()(q) / q
        # with the slope of the chord; what a jump at the cutoff adds is left out
        if codimension == 1:
            slope -= (series(q) - pieces[-1](1.0)) / (1.0 - q * q)
        for row, values in enumerate((series, Chebyshev.fit(q, slope, degree, domain))):
            powers = np.polynomial.chebyshev.cheb2poly(values.coef)
            table[row, k, codes.PIECE - len(powers) :] = powers[::-1]
    if codimension == 0:
        even = _even(profile)
        table[codes.EVEN].flat[: 1 + len(even)] = [len(even), *even]
    shells = _shells(profile)
    if codimension:
        shells = _beyond(shells, {1: 1.0, 2: 2.0 * math.pi}[codimension])
    table[codes.SHELLS] = _columns(shells)
    return table


def _even(profile: Profile) -> list[float]:
    """Return a profile as a polynomial of 2 q^2 - 1, the highest power first; empty unless it is one to rounding.

    The number of coefficients is a multiple of `AT_ONCE`, as loops take them.
    """
    largest = _largest(profile)
    exact = _values(profile, _TESTED)
    for count in range(AT_ONCE, _MOST_EVEN + 1, AT_ONCE):
        series = Chebyshev.interpolate(
            lambda y: _values(profile, np.sqrt(0.5 * (y + 1.0))), count - 1, (-1.0, 1.0)
        )
        polynomial = series.convert(kind=Polynomial)
        error = np.abs(polynomial(2.0 * _TESTED**2 - 1.0) - exact).max()
        if error <= _EVEN_ERROR * largest:
            coefficients = np.zeros(count)
            coefficients[: len(polynomial.coef)] = polynomial.coef
            return coefficients[::-1].tolist()
    return []


def _integrated(profile: Profile, codimension: int) -> Callable[[float], float]:
    """Return the profile of q, its line integral divided by half the chord, or its plane integral."""
    shells = _shells(profile)
    if codimension == 1 and shells:
        columns = _columns(shells)
        return lambda q: along_shells(columns, q * q, -_half(q), _half(q)) / _half(q)
    if codimension == 1:
        return lambda q: (
            2.0 * _integral(lambda z: _value(profile, math.hypot(q, z)), 0.0, _half(q)) / _half(q)
        )
    if codimension == 2 and shells:
        planes = _beyond(shells, 2.0 * math.pi)
        return lambda q: sum(plane(q) for radius, plane in planes if q < radius)
    if codimension == 2:
        return lambda q: 2.0 * math.pi * _integral(lambda r: _value(profile, r) * r, q, 1.0)
    return partial(_value, profile)


def _half(q: float) -> float:
    """Half of the chord of the unit sphere at this distance from its middle."""
    return math.sqrt(1.0 - q * q)


# --- shells ----------------------------------------------------------------------------------------------


def _columns(shells: Shells) -> NDArray:
    """Shells as compiled loops take them, padded with zeros."""
    columns = np.zeros((_INTERVALS, codes.PIECE))
    for k, (radius, shell) in enumerate(shells):
        coefficients = np.asarray(shell.coef, float)
        powers = len(coefficients)
        columns[RADIUS, k] = radius
        columns[POWERS, k] = AT_ONCE * math.ceil(powers / AT_ONCE)
        columns[FIRST : FIRST + powers, k] = coefficients / np.arange(1, powers + 1)
    return columns


def _beyond(shells: Shells, factor: float) -> Shells:
    """Integral of each shell times q, from q on outwards, and times a factor."""
    return [(radius, (-factor * shell * _Q).integ(lbnd=radius)) for radius, shell in shells]


@lru_cache
def _shells(profile: Profile) -> Shells:
    """Shells of a profile; none where too many are needed."""
    pieces = _pieces(profile)
    outer = [piece for _, piece in pieces[1:]] + [Polynomial([0.0])]
    shells = [
        (radius, piece - beyond) for (radius, piece), beyond in zip(pieces, outer, strict=False)
    ]
    return [(radius, shell) for radius, shell in shells if shell.coef.any()]


def _pieces(profile: Profile) -> Shells:
    """Polynomials of a profile, each up to a radius, from the middle outwards; none where too many are needed."""
    largest = _largest(profile)
    pieces: Shells = []
    if not np.isfinite(largest):
        return pieces
    begin = 0.0
    while begin < 1.0 - _BISECTED and len(pieces) < codes.PIECE:
        fits = partial(_fit, profile, largest, begin)
        end, piece = _farthest(fits, begin, _DEGREES)
        if piece is None:
            return []
        # nearly as far with the fewest powers: what lies beyond a kink takes many
        nearly = begin + _NEARLY * (end - begin)
        lowest = next((degree for degree in _DEGREES if fits(nearly, (degree,))), _DEGREES[-1])
        end_of_lowest, of_lowest = _farthest(fits, begin, (lowest,))
        if of_lowest is not None:
            end = end_of_lowest
            piece = of_lowest
        pieces.append((end, piece))
        begin = end
        if end < 1.0:
            begin += _BISECTED  # beyond a jump
    if begin != 1.0:
        return []
    return pieces


def _farthest(
    fits: Callable[[float, tuple[int, ...]], Polynomial | None],
    begin: float,
    degrees: tuple[int, ...],
) -> tuple[float, Polynomial | None]:
    """Largest radius up to which there is a polynomial of one of these degrees, and that polynomial."""
    piece = fits(1.0, degrees)
    end = begin
    failed = 1.0
    if piece is not None:
        return 1.0, piece
    while failed - end > _BISECTED:
        middle = 0.5 * (end + failed)
        of_middle = fits(middle, degrees)
        if of_middle is None:
            failed = middle
        else:
            end = middle
            piece = of_middle
    return end, piece


def _fit(
    profile: Profile, largest: float, begin: float, end: float, degrees: tuple[int, ...]
) -> Polynomial | None:
    """Polynomial of the lowest of these degrees that is as good as shells must be between two radii, or None."""
    inside = np.linspace(begin, end, 8 + math.ceil(11 * _INTERVALS * (end - begin)), endpoint=False)
    near_ends = 0.5 * (begin + end) + 0.5 * (end - begin) * np.polynomial.chebyshev.chebpts1(
        4 * _DEGREES[-1]
    )
    tested = np.concatenate([inside, near_ends, [end * (1.0 - 1e-14)]])
    exact = _values(profile, tested)
    for degree in degrees:
        series = Chebyshev.interpolate(partial(_values, profile), degree, (begin, end))
        if np.abs(series(tested) - exact).max() <= _SHELL_ERROR * largest:
            polynomial = series.convert(kind=Polynomial)
            error = np.abs(polynomial(tested) - exact).max()  # with the rounding of its terms
            terms = np.abs(polynomial.coef) @ end ** np.arange(len(polynomial.coef))
            if error <= _SHELL_ERROR * largest and terms <= _LARGEST_TERMS * largest:
                return polynomial
            return None
    return None
