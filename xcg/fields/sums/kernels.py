"""Smoothing functions: Lucy, Gaussian, Heaviside, and a user's own.

A kernel belongs to a number of dimensions k, in which its integral is 1. Seen in m < k of them it
acts through its *marginal*, the kernel integrated over the axes that are left out; the marginal of
the 3D Lucy is not the 1D Lucy.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Mapping
from copy import copy
from functools import lru_cache, partial
from itertools import accumulate
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from xcg.common.checks import POSITIVE, Kind, check, is_finite, is_positive, whole
from xcg.common.messages import did_you_mean, warn_user
from xcg.compiled import smoothing as codes
from xcg.compiled.lines import mean_along
from xcg.compiled.smoothing import LUCY_FULL, PLAIN, KernelCode
from xcg.fields.sums.kernel_tables import check_table, jumps_of, profile_integral, table_of
from xcg.scene.schema import LONGEST, SHORTEST
from xcg.scene.sizes import SIZES

_USUAL = "; the usual choice is 0.75 mean diameters"
_DIMENSION = whole(1, 3)
_LENGTH = Kind(
    lambda value: is_finite(value) and SHORTEST <= value <= LONGEST,
    "a positive",
    f"from {SHORTEST:g} to {LONGEST:g}",
)


class Kernel:
    """A radial smoothing function of finite support.

    Parameters
    ----------
    width : float, optional
        Half-width w (m).
    cutoff : float, optional
        Radius c of the support (m). One of the two is enough; a Gaussian takes both.
    dimension : int, optional
        The number of dimensions in which it integrates to 1; by default that of the scene.

    Raises
    ------
    ValueError
        If neither is given, both contradict each other, a length is not positive, or dimension is
        not 1, 2 or 3.
    """

    name = ""
    code = 0  # of the loops
    ratio = 1.0  # cutoff / width
    _any_ratio = False  # whether another one may be given
    smoothness = -1  # continuous derivatives
    # 1 / integral of the profile over the unit ball in 1, 2 and 3 dimensions
    _norms: tuple[float, ...] = ()
    profile: Any = None  # P(q) of kernels that loops take from a table

    def __init__(
        self,
        width: float | None = None,
        *,
        cutoff: float | None = None,
        dimension: int | None = None,
    ) -> None:
        check("width", width, _LENGTH, "m", optional=True, hint=_USUAL)
        check("cutoff", cutoff, _LENGTH, "m", optional=True, hint=_USUAL)
        check("dimension", dimension, _DIMENSION, optional=True)
        if width is None:
            if cutoff is None:
                raise ValueError(f"{type(self).__name__} needs width= or cutoff= (in metres)")
            width = cutoff / self.ratio
        self.width = float(width)
        self.cutoff = self.ratio * self.width
        if cutoff is not None:
            self.cutoff = float(cutoff)
        self.dimension = dimension
        self.spread = self.width / self.cutoff
        if not self._any_ratio and not math.isclose(
            self.cutoff, self.ratio * self.width, rel_tol=1e-9
        ):
            raise ValueError(
                f"width={self.width} and cutoff={self.cutoff} contradict each other: the {self.name} kernel has "
                f"cutoff = {self.ratio:g} width; give one of them"
            )

    def __repr__(self) -> str:
        options = f"width={self.width:g}, cutoff={self.cutoff:g}"
        if self.dimension is not None:
            options += f", dimension={self.dimension}"
        return f"{type(self).__name__}({options})"

    def in_dimension(self, dimension: int) -> Kernel:
        """Return the same kernel normalised in `dimension` dimensions, unless it has its own."""
        if self.dimension is not None:
            return self
        twin = copy(self)
        twin.dimension = dimension
        return twin

    @property
    def differentiable(self) -> bool:
        """Return whether the kernel is continuously differentiable, as the differential balance laws need."""
        return self.smoothness >= 1

    def _unit_norm(self, dimension: int) -> float:
        """Return 1 / integral of a profile over the unit ball, of kernels without `_norms`."""
        return 1 / profile_integral(self.profile, dimension)

    def weights(self, seen: int | None = None) -> KernelCode:
        """Return the kernel as the loops need it, seen in `seen` of its dimensions (all by default)."""
        dimension = self.dimension or 3
        if seen is None:
            seen = dimension
        if seen == 0:  # averaged over every axis: each grain counts in full
            return KernelCode(codes.HEAVISIDE, PLAIN, 1.0)
        codimension = dimension - seen
        if not 0 <= codimension <= 2:
            raise ValueError(
                f"a {dimension}D {self.name} kernel cannot be seen in {seen} dimensions; use a kernel of dimension "
                f"{max(seen, 1)} to {min(seen + 2, 3)}"
            )
        kind: int | None = self.code + codimension
        if kind == codes.LUCY:
            kind = LUCY_FULL
        table = PLAIN  # of kernels with formulas
        if self.profile is not None:
            table = table_of(self.profile, codimension)
        norm = self._norms[dimension - 1] if self._norms else self._unit_norm(dimension)
        return KernelCode(kind, table, norm / self.cutoff**seen)

    def _sample(self, r: ArrayLike, seen: int | None, derivative: bool) -> NDArray:
        w = self.weights(seen)
        q = np.abs(np.asarray(r, float)) / self.cutoff
        values = codes.sample(w.kind, w.table, np.ravel(q), derivative=derivative).reshape(q.shape)
        if derivative:
            return values * (w.norm / self.cutoff)
        return values * w.norm

    def value(self, r: ArrayLike, seen: int | None = None) -> NDArray:
        """Psi(r) (m^-k); with ``seen=m`` its marginal in m dimensions (m^-m)."""
        return self._sample(r, seen, derivative=False)

    def derivative(self, r: ArrayLike, seen: int | None = None) -> NDArray:
        """Return dPsi/dr, of the kernel or of its marginal in `seen` dimensions; jumps at the cutoff are left out."""
        return self._sample(r, seen, derivative=True)

    def squared_integral(self, seen: int) -> float:
        """Integral of the square of the kernel, as it is seen in some dimensions (m^-seen)."""
        if not seen:
            return 1.0
        r, psi = self.sampled(seen)
        shells = {1: 2.0, 2: 2 * np.pi * r, 3: 4 * np.pi * r**2}
        return float(np.trapezoid(psi**2 * shells[seen], dx=r[1]))

    def second_moment(self, seen: int) -> float:
        """Variance of the place of a grain along an axis, as the kernel weighs it in some dimensions (m^2)."""
        if not seen:
            return 0.0
        r, psi = self.sampled(seen)
        shells = {1: 2.0 * r**2, 2: np.pi * r**3, 3: 4 / 3 * np.pi * r**4}[seen]
        return float(np.trapezoid(psi * shells, dx=r[1]))

    def sampled(self, seen: int) -> tuple[NDArray, NDArray]:
        """Return radii from 0 to the cutoff (2001,), and the kernel there; at the cutoff its value from inside."""
        r = np.linspace(0.0, self.cutoff, 2001)
        return r, self.value(np.minimum(r, self.cutoff * (1 - 1e-12)), seen)

    def mean_of_cells(self, values: NDArray, places: NDArray, size: float) -> NDArray:
        """Return means of values of cells about places, weighted by the kernel, seen along the axes of the cells.

        Parameters
        ----------
        values : array (cells,) or (cells, cells)
            Values of cells along one axis or two.
        places : array (n, axes)
            Places (m), counted from the centre of the first cell. The support about each is within
            the cells.
        size : float
            Edge of the cells (m).
        """
        seen = values.ndim
        w = self.weights(seen)
        rows = np.ascontiguousarray(values, float).reshape(-1, values.shape[-1])
        place = np.zeros((len(places), 2))
        place[:, 2 - seen :] = places / size
        return codes.weighted_means(w.kind, w.table, rows, place, self.cutoff / size)

    def segment(
        self, points: ArrayLike, start: ArrayLike, end: ArrayLike, order: int = 0
    ) -> NDArray:
        """Mean of Psi(r - s) over the points s of a segment: ``int_0^1 Psi(r - start + u (start - end)) du``.

        Parameters
        ----------
        points : array (n, m)
            Where it is wanted (m); m is the number of dimensions that are seen.
        start, end : array (m,)
            Ends of the segment (m).
        order : int
            Number of Gauss-Legendre points; 0 for the closed form.

        Raises
        ------
        ValueError
            If `order` is not a whole number from 0 on.
        """
        check("order", order, whole(0), hint=", of Gauss-Legendre points")
        r = np.atleast_2d(np.asarray(points, float))
        w = self.weights(r.shape[1])
        first = np.asarray(start, float)
        branch = np.asarray(end, float) - first
        of_unit = mean_along(
            (r - first) / self.cutoff, branch / self.cutoff, int(order), w.kind, w.table
        )
        return w.norm * of_unit


class Lucy(Kernel):
    """Lucy's kernel, ``105 / (16 pi c^3) (1 - 6 q^2 + 8 q^3 - 3 q^4)`` with q = r / c and c = 2 w in 3D.

    Twice continuously differentiable, so that its fields satisfy the differential balance laws.
    Source: Lucy (1977).

    Parameters
    ----------
    width : float, optional
        Half-width w (m).
    cutoff : float, optional
        Radius c of the support (m), 2 w. One of the two is enough.
    dimension : int, optional
        The number of dimensions in which it integrates to 1; by default that of the scene.
    """

    name = "lucy"
    code = codes.LUCY
    ratio = 2.0
    smoothness = 2
    _norms = 5 / 4, 5 / math.pi, 105 / (16 * math.pi)


class Gaussian(Kernel):
    """A Gaussian cut at c = 3 w (or another `cutoff`), normalised with its cut; it jumps there by 1.1 % of its peak.

    With `shifted`, its value at the cutoff is taken off, ``exp(-r^2 / 2 w^2) - exp(-c^2 / 2 w^2)``,
    so that it is continuous: its gradient is then exact, and jumps at the cutoff. This is the
    kernel of LAMMPS' ``compute continuum/chunk``.

    Parameters
    ----------
    width : float, optional
        Half-width w (m), its standard deviation before it is cut.
    cutoff : float, optional
        Radius c of the support (m), 3 w by default and 6 w at most. Above 3 w the first use of a
        cutoff in a process takes up to half a second for its tables.
    dimension : int, optional
        The number of dimensions in which it integrates to 1; by default that of the scene.
    shifted : bool
        Subtract the value at the cutoff. The name ``kernel="shifted gaussian"`` means this.

    Raises
    ------
    ValueError
        As `Kernel`.
    """

    name = "gaussian"
    code = codes.TABLE
    ratio = 3.0
    _any_ratio = True

    def __init__(
        self,
        width: float | None = None,
        *,
        cutoff: float | None = None,
        dimension: int | None = None,
        shifted: bool = False,
    ) -> None:
        super().__init__(width, cutoff=cutoff, dimension=dimension)
        self.shifted = bool(shifted)
        if self.cutoff > _FARTHEST * self.width:
            raise ValueError(
                f"width={self.width:g} and cutoff={self.cutoff:g}: expected a cutoff of at most {_FARTHEST} w, where a "
                "Gaussian is 1.5e-8 of its peak; the usual cutoff is 3 w"
            )
        if self.shifted:
            self.name = _SHIFTED_GAUSSIAN
            self.smoothness = 0
        self.profile = _gaussian_profile(self.spread, self.shifted)

    def __repr__(self) -> str:
        text = super().__repr__()
        if self.shifted:
            text = text.replace(")", ", shifted=True)")
        return text

    def _unit_norm(self, dimension: int) -> float:
        s = self.spread
        tail = math.exp(-0.5 / s**2)
        core = math.erf(1 / (math.sqrt(2) * s))
        integral = {
            1: math.sqrt(2 * math.pi) * s * core,
            2: 2 * math.pi * s**2 * (1 - tail),
            3: (2 * math.pi) ** 1.5 * s**3 * core - 4 * math.pi * s**2 * tail,
        }[dimension]
        if self.shifted:
            ball = {1: 2.0, 2: math.pi, 3: 4 * math.pi / 3}[dimension]
            y = 0.5 / s**2
            integral -= ball * tail
            # the same without a difference: sum over n > 0 of (2 y)^n / ((k + 2) (k + 4) ... (k + 2
            # n))
            if y < 1:
                terms = accumulate(
                    (2 * y / (dimension + 2 * n) for n in range(1, 25)), operator.mul
                )
                integral = ball * tail * sum(terms)
        return 1 / integral


_SHIFTED_GAUSSIAN = "shifted gaussian"
# Cutoff over width of a Gaussian: its table is right to 1e-15 of the peak, and 7 digits are left at
# the rim, where a node may see nothing else.
_FARTHEST = 6


@lru_cache
def _gaussian_profile(spread: float, shifted: bool) -> Callable[[NDArray], NDArray]:
    """Return the profile of q = r / c of a Gaussian; the same object each time, as tables are kept by it."""

    def gaussian(q: NDArray) -> NDArray:
        return np.exp(-0.5 * (q / spread) ** 2)

    def above_edge(q: NDArray) -> NDArray:
        # a product, as a difference has no digits close to the rim
        return -gaussian(q) * np.expm1(-0.5 * (1.0 - q * q) / spread**2)

    if shifted:
        return above_edge
    return gaussian


class Heaviside(Kernel):
    """Constant inside c = w, zero outside; its fields jump.

    Parameters
    ----------
    width : float, optional
        Half-width w (m).
    cutoff : float, optional
        Radius c of the support (m), equal to the width. One of the two is enough.
    dimension : int, optional
        The number of dimensions in which it integrates to 1; by default that of the scene.
    """

    name = "heaviside"
    code = codes.HEAVISIDE
    _norms = 1 / 2, 1 / math.pi, 3 / (4 * math.pi)


KernelName: TypeAlias = Literal["lucy", "gaussian", "shifted gaussian", "heaviside"]
_NAMED: dict[str, Callable[..., Kernel]] = {
    "lucy": Lucy,
    "gaussian": Gaussian,
    _SHIFTED_GAUSSIAN: partial(Gaussian, shifted=True),
    "heaviside": Heaviside,
}
# kernels by the words that others use for them
_OTHER_NAMES = {
    "tophat": "heaviside",
    "top_hat": "heaviside",
    "box": "heaviside",
    "uniform": "heaviside",
    "step": "heaviside",
    "sphere": "heaviside",
    "normal": "gaussian",
    "quintic": "lucy",
    "spline": "lucy",
    "polynomial": "lucy",
}
_OF_THE_PACKAGE = frozenset(get_args(KernelName))


def register_kernel(
    name: str, profile: Callable[[NDArray], NDArray], *, ratio: float = 2.0, smoothness: int = 2
) -> type[Kernel]:
    """Register a custom radial kernel under a name.

    Parameters
    ----------
    name : str
        The name for ``kernel=``. It may be registered again, which replaces the former kernel;
        names of kernels of the package are refused.
    profile : callable
        ``P(q)`` for an array q = r / c in [0, 1); it need not be normalised. Values, marginals and
        gradients are kept as polynomials of degree 7 on 64 intervals: where P is smooth, values to
        1e-11 and derivatives to 1e-7 of the largest. (A cusp at q = 0, as of exp(-5 q), leaves 1e-6
        in the marginal in a plane.) A warning says where values of P itself are off by more than
        1e-10, or where P jumps inside. Integrals along segments are closed forms, right to a few
        1e-12 of the largest value (and to rounding over the length of segments below a tenth of c),
        where up to eight polynomials of q, each between two radii, are P to 1e-13. Registration
        determines these polynomials. Other profiles, such as one that ends like a root, take a long
        quadrature; a warning says where it is off by more than 1e-7.
    ratio : float
        Cutoff over width.
    smoothness : int
        Continuous derivatives of the kernel, the cutoff included, and -1 for one that jumps; from 1
        on the kernel gradient is exact.

    Returns
    -------
    type
        The class of the kernel, called like ``Lucy(width=...)``.

    Raises
    ------
    ValueError
        If the name is that of a kernel of the package, the ratio or the smoothness is invalid, or
        the profile is not finite from 0 on, below 1, or has no positive integral.
    """
    _check_registration(name, profile, ratio, smoothness)
    # an object for each registration, as what is kept of profiles goes by them
    profile = partial(profile)
    check_table(name, profile)
    jumps = jumps_of(profile)
    if jumps and smoothness >= 0:
        warn_user(
            f"kernel {name!r}: smoothness={smoothness}, but its profile jumps at q={jumps[-1]:.3g}; it is taken for "
            "one that jumps: give smoothness=-1, or a profile without jumps that ends at zero"
        )
        smoothness = -1

    members: dict[str, Any] = {
        "name": name,
        "code": codes.TABLE,
        "profile": staticmethod(profile),
        "ratio": ratio,
        "smoothness": smoothness,
        "__doc__": f"The kernel registered as {name!r}.",
    }
    kind = _NAMED[name.lower()] = type(name.title(), (Kernel,), members)
    return kind


def _check_registration(name: Any, profile: Any, ratio: Any, smoothness: Any) -> None:
    """Raise ValueError for arguments that make no kernel, before the profile is evaluated."""
    if not isinstance(name, str) or not name.strip():
        raise ValueError(f"register_kernel({name!r}): expected a name, such as 'tent'")
    if name.lower() in _OF_THE_PACKAGE:
        raise ValueError(
            f"register_kernel({name!r}): the name is that of a kernel of xcg; choose another"
        )
    if not callable(profile):
        raise ValueError(
            f"register_kernel({name!r}): profile={profile!r}, expected a function P(q) of q = r / c in [0, 1)"
        )
    check("ratio", ratio, POSITIVE, hint=", cutoff over width")
    check("smoothness", smoothness, whole(-1), hint=", and -1 for a kernel that jumps")


def kernel_of(
    kernel: str | Kernel, width: float | str | None, sizes: Mapping[Any, Any], dimension: int
) -> Kernel:
    """Return the kernel of a call: an object with its own width, or one of a name and a width, 0.75 d43 by default.

    Raises
    ------
    ValueError
        If the name is unknown, or a kernel object comes with a second width.
    """
    if isinstance(kernel, Kernel):
        if width is not None:
            raise ValueError(f"kernel={kernel!r} has its own width; leave width= out")
        return kernel.in_dimension(dimension)
    if str(kernel).lower() not in _NAMED:
        likely = ""
        if isinstance(kernel, str):
            likely = did_you_mean(kernel, _NAMED, 0.4, synonyms=_OTHER_NAMES)
        raise ValueError(
            f"kernel={kernel!r}: expected one of {sorted(_NAMED)} or a kernel object such as "
            f"xcg.Lucy(width=0.01){likely}"
        )
    if isinstance(width, Mapping):
        raise ValueError(f"width={dict(width)!r}: expected one width here, not one for each group")
    length = resolve_length("width", "0.75 d43" if width is None else width, sizes)
    return _NAMED[kernel.lower()](length, dimension=dimension)


# such as "0.75 d43", "2*d50", "d43"
_MULTIPLE = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)?\s*\*?\s*([A-Za-z]\w*)\s*")


def resolve_length(
    name: str,
    length: float | str,
    attrs: Mapping[Any, Any],
    advice: str = "the usual choice is 0.75 mean diameters",
) -> float:
    """Return a length in metres from a number or a multiple of a size such as "0.75 d43".

    Parameters
    ----------
    name : str
        The argument, for messages.
    length : float or str
        Its value.
    attrs : mapping
        Sizes of the scene (m).
    advice : str
        End of the message about a length that is not positive.

    Raises
    ------
    ValueError
        If it is not positive, or names a size that the scene does not hold.
    """
    meters = length
    if isinstance(length, str):
        parts = _MULTIPLE.fullmatch(length)
        if parts is None or parts[2] not in SIZES:
            raise ValueError(
                f"{name}={length!r}: expected a length in metres or a multiple of {', '.join(SIZES)} such as "
                "'0.75 d43'"
            )
        size = parts[2]
        if size not in attrs:
            raise ValueError(
                f"{name}={length!r} needs the attribute {size!r}, which the scene does not hold, or no longer, as "
                f"diameters were changed; give {name}= in metres, or, where there are diameters, call "
                "ds = ds.cg.measure() first (of bodies: ds = ds.cg.group_bodies(...).cg.measure() in place of by_body=)"
            )
        meters = float(parts[1] or 1.0) * float(attrs[size])
    if not is_positive(meters):
        raise ValueError(f"{name}={length!r}: expected a positive length (m); {advice}")
    return float(meters)
