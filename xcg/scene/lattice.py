"""Periodic images of a step, in tilted boxes, too: the shortest, within a distance, wrapping.

A lattice is all ``n_a a + n_b b + n_c c`` with whole numbers n. Where its vectors change in time,
as in a box that is sheared, an image moves with ``n_a da/dt + n_b db/dt + n_c dc/dt`` relative to
its original (Lees & Edwards 1972).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.compiled.arrays import Reduced, nearest_images
from xcg.scene.schema import COMPONENTS

_SAME = 1e-9  # rounding of lattice vectors, as a share of the longest
_MOST_IMAGES = 20_000  # lattice translations that are looked at


@dataclass(frozen=True, eq=False)
class Lattice:
    """Periodic images of one step.

    Attributes
    ----------
    period : array (3,)
        Length of the periodic axes (m), infinity along the others; infinity along all where there
        are `vectors`.
    edges : array (3, 2) or None
        Edges of the box, without its tilt (m).
    vectors : array (k, 3) or None
        Vectors to the next images (m), as short as they can be chosen, in boxes with other edges
        than x, y and z, or with images that move; None in all others.
    rates : array (k, 3) or None
        Rates at which the vectors change (m/s).
    cell : array (3, 3) or None
        The vectors a, b, c as they were given, zero where they are not periodic.
    """

    period: NDArray
    edges: NDArray | None = None
    vectors: NDArray | None = None
    rates: NDArray | None = None
    cell: NDArray | None = None

    @classmethod
    def of(cls, box: Mapping[str, NDArray], periodic: str, source: str = "scene") -> Lattice:
        """Read the box of a step from its ``box``, ``lattice`` and ``lattice_velocity``, if any.

        Raises
        ------
        SceneError
            If the box has no finite extent along a periodic axis, or its vectors span no volume.
        """
        edges = box.get("box")
        axes = [COMPONENTS.index(axis) for axis in periodic]
        if box.get("lattice") is not None:
            return cls._of_vectors(box, axes, source)
        return cls(_periods(edges, axes, source), edges)

    @classmethod
    def _of_vectors(cls, box: Mapping[str, NDArray], axes: list[int], source: str) -> Lattice:
        """Read a box that has vectors, which may be along the axes."""
        edges = box.get("box")
        rates = np.asarray(box.get("lattice_velocity", np.zeros((3, 3))), float)[axes]
        vectors = np.asarray(box["lattice"], float)[axes]
        lengths = np.linalg.norm(vectors, axis=1)
        finite = np.isfinite(vectors).all() and np.isfinite(rates).all()
        if not (finite and _volume(vectors) > 1e-12 * lengths.prod()):
            periodic = "".join(COMPONENTS[k] for k in axes)
            raise SceneError(
                f"{source}: the lattice vectors of the periodic axes {periodic!r} are "
                f"{vectors.tolist()} (m), moving with {rates.tolist()} (m/s); expected finite "
                "vectors that span a volume"
            )
        straight = np.zeros((len(axes), 3))
        straight[range(len(axes)), axes] = lengths
        if edges is not None and not rates.any() and (vectors == straight).all():
            return cls(_periods(edges, axes, source), edges)
        cell = np.zeros((3, 3))
        cell[axes] = vectors
        return cls(np.full(3, np.inf), edges, *_reduced(vectors, rates), cell)

    @property
    def lengths(self) -> NDArray:
        """Length (3,) of the periodic axes in the box without tilt (m), else infinity."""
        if self.cell is None:
            return self.period
        return np.where(self.cell.any(axis=1), np.diagonal(self.cell), np.inf)

    def length(self, axis: str) -> float:
        """Extent of the box along an axis (m); NaN where it has none."""
        if self.edges is None:
            return np.nan
        low, high = self.edges[COMPONENTS.index(axis)]
        return float(high - low)

    @property
    def periodic_vectors(self) -> NDArray:
        """Vectors of the periodic axes (k, 3) as they were given, in the order of the axes."""
        if self.cell is None:
            return self.basis
        return self.cell[self.cell.any(axis=1)]

    @property
    def axes(self) -> NDArray:
        """Indices (k,) of those vectors a, b, c that are in `periodic_vectors`."""
        return np.flatnonzero(np.isfinite(self.lengths))

    def scaled(self, unit: float) -> Lattice:
        """Return the lattice with lengths over `unit` (m) and the same rates, no edges or cell."""
        vectors = self.vectors
        if vectors is not None:
            vectors = vectors / unit
        return Lattice(self.period / unit, vectors=vectors, rates=self.rates)

    # --- vectors between two places ---

    @cached_property
    def basis(self) -> NDArray:
        """Vectors to the next images (k, 3), in any box."""
        if self.vectors is not None:
            return self.vectors
        periodic = np.isfinite(self.period)
        return np.diag(np.where(periodic, self.period, 0.0))[periodic]

    @cached_property
    def reduced(self) -> Reduced | None:
        """The lattice as compiled loops take it; None where periods along the axes are enough."""
        if self.vectors is None:
            return None
        count = len(self.vectors)
        numbers = np.array([n for n in product((-1.0, 0.0, 1.0), repeat=count) if any(n)])
        around = numbers.reshape(3**count - 1, count) @ self.vectors
        return Reduced(np.ascontiguousarray(self.vectors), self._dual, around)

    @property
    def for_loops(self) -> tuple[tuple[float, float, float], Reduced | None]:
        """Periods along the axes, and the lattice of other boxes, as compiled loops take them."""
        x, y, z = self.period.tolist()
        return (x, y, z), self.reduced

    @cached_property
    def _dual(self) -> NDArray:
        if self.vectors is None:
            periodic = np.isfinite(self.period)
            return np.diag(1.0 / self.period)[periodic]
        return np.ascontiguousarray(np.linalg.pinv(self.basis).T).reshape(-1, 3)

    def shortest(self, vector: NDArray, to: NDArray | None = None) -> NDArray:
        """Shortest periodic image of vectors (n, 3), or the image nearest to other vectors."""
        if self.reduced is None:
            return minimum_image(vector, self.period, to)
        if to is not None:
            return self.shortest(vector - to) + to
        out = np.empty((len(vector), 3))
        nearest_images(np.ascontiguousarray(vector, float), self.reduced, out)
        return out

    def numbers(self, vector: NDArray) -> NDArray:
        """Whole numbers (n, k) of lattice vectors nearest to vectors (n, 3)."""
        return np.rint(np.einsum("...i,ki->...k", vector, self._dual))

    def drift(self, shift: NDArray) -> NDArray | float:
        """Return velocities (n, 3) of images shifted by lattice vectors (n, 3), 0 if none moves."""
        if self.rates is None or not self.rates.any():
            return 0.0
        return self.numbers(shift) @ self.rates

    def translations(self, length: float, source: str = "scene") -> NDArray:
        """Return all lattice vectors (m, 3) shorter than a length, but zero."""
        if self.vectors is None and length <= self.period.min():
            return np.zeros((0, 3))
        most = np.ceil(length * np.linalg.norm(self._dual, axis=1))
        numbers = _numbers(-most, most, source)
        vectors = numbers[numbers.any(axis=1)] @ self.basis
        return vectors[(vectors**2).sum(axis=1) < length**2]

    def within(self, vector: NDArray, reach: NDArray) -> tuple[NDArray, NDArray]:
        """Return rows and vectors of the images of shortest vectors (n, 3) within their reach (n,).

        The shortest one always is among them.
        """
        moves = self.translations(2 * reach.max(initial=0.0))
        if not len(moves):
            return np.arange(len(vector)), vector
        # the other images of shorter vectors are beyond their reach
        length = np.linalg.norm(vector, axis=1)
        near = np.flatnonzero(length + reach > self.closest[0] * (1 - _SAME))
        images = vector[near, None] + moves
        inside = (images**2).sum(axis=2) < reach[near, None] ** 2
        rows = np.concatenate([np.arange(len(vector)), near[np.nonzero(inside)[0]]])
        vectors = np.concatenate([vector, images[inside]])
        order = np.argsort(rows, kind="stable")
        return rows[order], vectors[order]

    def is_halfway(self, vector: NDArray, hair: float) -> NDArray:
        """Return whether other images of vectors (n, 3) are as short, up to a share of a period."""
        if self.reduced is None:
            return (np.abs(vector) >= 0.5 * (1 - hair) * self.period).any(axis=1)
        around = self.reduced.around
        toward = np.einsum("ni,mi->nm", vector, around) / (around**2).sum(axis=1)
        return (np.abs(toward) >= 0.5 * (1 - hair)).any(axis=1)

    @property
    def closest(self) -> tuple[float, str]:
        """Distance to the nearest image, and the direction in which it is, for messages."""
        lengths = np.linalg.norm(self.basis, axis=1)
        if not len(lengths):
            return np.inf, ""
        k = int(np.argmin(lengths))
        if self.vectors is not None:
            return float(lengths[k]), f"along {self.vectors[k].tolist()}"
        axis = COMPONENTS[self.axes[k]]
        return float(lengths[k]), f"along '{axis}'"

    # --- places ---

    @property
    def open_axes(self) -> NDArray:
        """Axes (3,) along which nothing repeats."""
        if self.vectors is None:
            return np.isinf(self.period)
        return ~(np.abs(self.basis) > _SAME * np.abs(self.basis).max(initial=0.0)).any(axis=0)

    @cached_property
    def axis_periods(self) -> NDArray:
        """Period (3,) along each axis alone, also of the velocities; infinite without one."""
        if self.vectors is None or self.edges is None or self.rates is None:
            return self.period
        lengths = self.edges[:, 1] - self.edges[:, 0]
        periods = np.full(3, np.inf)
        for k in np.flatnonzero(np.isfinite(lengths)):
            step = lengths[k] * np.eye(3)[k]
            number = self.numbers(step)
            is_image = np.abs(number @ self.vectors - step).max() <= _SAME * lengths[k]
            moves = (number @ self.rates).any()
            if is_image and not moves:
                periods[k] = lengths[k]
        return periods

    def wrapped(self, position: NDArray, first: NDArray, source: str = "scene") -> NDArray:
        """Return images of positions (n, 3) in the box without tilt that begins at `first` (3,).

        Raises
        ------
        SceneError
            If no such box holds one image of each place, as where the vectors point in any
            direction.
        """
        position = position.copy()
        cell = self.cell
        if cell is None:
            cell = np.diag(np.where(np.isfinite(self.period), self.period, 0.0))
        left = [k for k in range(3) if cell[k].any()]
        while left:
            # the other vectors have no part along this axis, so that wrapping along them later
            # leaves it as it is
            alone = [k for k in left if cell[k, k] and not any(cell[j, k] for j in left if j != k)]
            if not alone:
                raise SceneError(
                    f"{source}: the lattice {cell.tolist()} has no axis that one of its vectors "
                    "leads along alone"
                )
            k = alone[-1]
            left.remove(k)
            x = position[:, k]
            position -= np.floor((x - first[k]) / cell[k, k])[:, None] * cell[k]
            x[x >= first[k] + cell[k, k]] = first[k]
        return position

    def seen(self, active: NDArray, source: str = "scene") -> Lattice:
        """Return the lattice as seen along some axes (3,).

        Averages along the other axes do not distinguish images that are shifted along these. It has
        no edges.

        Raises
        ------
        SceneError
            If images are shifted along the seen axes by a distance that is not a period, so that an
            average along the others is that over infinitely many shifted boxes.
        """
        if self.vectors is None:
            return Lattice(np.where(active, self.period, np.inf))
        return self._shadow(active, source)

    def _shadow(self, active: NDArray, source: str) -> Lattice:
        """Return `seen` of a lattice of vectors: their parts along some axes (3,)."""
        vectors, rates, apart = self._along(active)
        shadows = (vectors * active)[apart]
        if not _independent(shadows):
            is_tilted = (vectors * active).any(axis=1) & (vectors * ~active).any(axis=1)
            tilted = vectors[is_tilted].any(axis=0)
            across = " and ".join(_names_of(tilted & ~active))
            along = " and ".join(_names_of(tilted & active))
            raise SceneError(
                f"{source}: the box is tilted, or turned against the axes of the nodes, so that "
                f"its images along {across} are shifted along {along}, and an average along "
                f"{across} alone does not exist; resolve more axes "
                f"(axes={self._resolvable(active)!r}) and average the result"
            )
        return Lattice(self.period, None, *_reduced(shadows, rates[apart]))

    def gradient_along(self, axes: NDArray) -> NDArray | None:
        """Velocity gradient (3, 3) of moving images (1/s), in columns of `axes`; None if zero."""
        if self.vectors is None or self.rates is None or not self.rates.any():
            return None
        rates = self.numbers(self.periodic_vectors) @ self.rates
        gradient = (np.linalg.pinv(self.periodic_vectors) @ rates).T * axes
        if not gradient.any():
            return None
        return gradient

    @property
    def corner(self) -> NDArray:
        """Lower corner of the box (3,), 0 along open axes (m)."""
        if self.edges is None:
            return np.zeros(3)
        return np.where(self.open_axes, 0.0, self.edges[:, 0])

    @property
    def middle(self) -> NDArray:
        """Middle of the box (3,), 0 along axes where it is not finite (m)."""
        if self.edges is None:
            return np.zeros(3)
        finite = np.isfinite(self.edges).all(axis=1, keepdims=True)
        return np.where(finite, self.edges, 0.0).mean(axis=1)

    def _along(self, active: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        """Return the vectors, their rates, and which of them some axes (3,) distinguish.

        The vectors are the given ones, or else the reduced ones, if only their shadows on
        these axes are independent.
        """
        assert self.vectors is not None
        assert self.rates is not None
        longest = np.linalg.norm(self.vectors, axis=1).max(initial=0.0)
        for vectors in (self.periodic_vectors, self.vectors):
            shadows = vectors * active
            apart = np.linalg.norm(shadows, axis=1) > _SAME * longest
            if _independent(shadows[apart]):
                break
        return vectors, self.numbers(vectors) @ self.rates, apart

    def _resolvable(self, active: NDArray) -> str:
        """Fewest further axes that make `seen` possible, with the seen axes."""
        for more in np.flatnonzero(~active):
            resolved = active.copy()
            resolved[more] = True
            try:
                self.seen(resolved)
            except SceneError:
                continue
            return "".join(_names_of(resolved))
        return "".join(COMPONENTS)

    def images(
        self, position: NDArray, low: NDArray, high: NDArray, source: str = "scene"
    ) -> tuple[NDArray, NDArray, NDArray]:
        """Return all images of positions (n, 3) within [low, high], (3,) each.

        Both are infinite along axes without limits.

        Returns
        -------
        row : array (m,)
            Of the position that each is an image of: first all by one translation, in their order,
            then by the next.
        shift, drift : array (m, 3)
            How far away from it the image is (m), and how fast it moves relative to it (m/s).
        """
        vectors = self.basis
        limited = np.isfinite(low) & np.isfinite(high)
        assert limited[np.abs(vectors).any(axis=0)].all()
        rates = np.zeros_like(vectors) if self.rates is None else self.rates
        first = np.where(limited, low, 0.0)
        last = np.where(limited, high, 0.0)
        middle = 0.5 * (first + last)
        home = self.numbers(position - middle)
        # NumPy is several times as fast along rows of n numbers as along n rows of three
        near = np.ascontiguousarray((position - np.einsum("nk,ki->ni", home, vectors)).T)
        # a translation by n leads from the extent of the positions into the limits where n is
        # between centre - spread and centre + spread
        lowest = (near - middle[:, None]).min(axis=1, initial=0.0)
        highest = (near - middle[:, None]).max(axis=1, initial=0.0)
        half_extent = np.where(limited, 0.5 * (highest - lowest), 0.0)
        spread = np.abs(self._dual) @ (0.5 * (last - first) + half_extent)
        centre = -self._dual @ np.where(limited, 0.5 * (lowest + highest), 0.0)
        numbers = _numbers(
            np.ceil(centre - spread - _SAME), np.floor(centre + spread + _SAME), source
        )
        rows_of_numbers = []
        translations = []
        for number in numbers:
            images = near + (number @ vectors)[:, None]
            is_inside = (low[:, None] <= images) & (images <= high[:, None])
            inside = np.flatnonzero(is_inside.all(axis=0))
            rows_of_numbers.append(inside)
            translations.append(number - home[inside])
        translation = np.concatenate(translations)
        shift = np.einsum("nk,ki->ni", translation, vectors)
        drift = np.einsum("nk,ki->ni", translation, rates)
        return np.concatenate(rows_of_numbers), shift, drift

    def extent(self, hidden: NDArray) -> float:
        """Length, area or volume by which sums over all images become averages along axes (3,).

        That of the vectors along these axes, and of the box along axes that are not periodic; not
        finite where the scene does not say.
        """
        lengths = np.full(3, np.nan) if self.edges is None else self.edges[:, 1] - self.edges[:, 0]
        if self.cell is None:
            return float(lengths[hidden].prod())
        return self._volume_of_images(hidden, lengths, self.cell)

    def _volume_of_images(self, hidden: NDArray, lengths: NDArray, cell: NDArray) -> float:
        """Return `extent` in a box of vectors `cell` (3, 3), whose edges have some lengths (3,)."""
        vectors, _, apart = self._along(~hidden)
        along = vectors[~apart]
        open_axes = hidden & ~cell.any(axis=1)
        if len(along) + open_axes.sum() < hidden.sum() or not np.isfinite(lengths[open_axes]).all():
            return np.nan
        box = np.diag(np.where(open_axes, lengths, 0.0))[open_axes]
        return _volume(np.concatenate([along, box]))


def _names_of(axes: NDArray) -> list[str]:
    """Names of the axes that a mask (3,) selects."""
    return [a for a, selected in zip(COMPONENTS, axes, strict=True) if selected]


def _periods(edges: NDArray | None, axes: list[int], source: str) -> NDArray:
    """Box length along some axes, infinity along the others; shape (3,)."""
    lengths = np.full(3, np.inf)
    for k in axes:
        if edges is not None:
            lengths[k] = edges[k, 1] - edges[k, 0]
        if not 0 < lengths[k] < np.inf:
            axis = COMPONENTS[k]
            raise SceneError(
                f"{source}: axis '{axis}' is periodic, but the box has no finite extent along it; "
                f"give its edges, for example box={{'{axis}': (0.0, 0.1)}}"
            )
    return lengths


def _volume(vectors: NDArray) -> float:
    """Length, area or volume that vectors (k, 3) span; 1 for none."""
    if not len(vectors):
        return 1.0
    return float(np.prod(np.linalg.svd(vectors, compute_uv=False)))


def _independent(vectors: NDArray) -> bool:
    """Return whether vectors (k, 3) span a volume, or as much as they can."""
    return _volume(vectors) > _SAME * np.linalg.norm(vectors, axis=1).prod()


def _numbers(low: NDArray, high: NDArray, source: str) -> NDArray:
    """Return all rows of whole numbers (m, k) from `low` to `high` (k,)."""
    if not np.prod(high - low + 1) <= _MOST_IMAGES:
        raise SceneError(
            f"{source}: the box is so small that {np.prod(high - low + 1):.3g} periodic images "
            "are within reach; it is damaged, or the kernel is too wide"
        )
    if not len(low):
        return np.zeros((1, 0))
    axes = [np.arange(first, last + 1) for first, last in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(low))


def same_vectors(one: NDArray, two: NDArray, axes: Sequence[int] | NDArray) -> NDArray:
    """Return whole numbers (k, k) for which ``numbers @ two`` is nearest to `one`, (k, 3) each.

    Codes flip a box that is tilted far: a vector is then written as its sum with others. `axes`
    (k,) are the axes that the vectors belong to.
    """
    numbers = np.eye(len(axes))
    for row in range(len(axes)):
        for other in reversed(range(len(axes))):
            changes_length = two[other, axes[row]] != 0  # along the axis of the vector
            if row != other and not changes_length:
                away = numbers[row] @ two - one[row]
                numbers[row, other] -= np.rint(away[axes[other]] / two[other, axes[other]])
    return numbers


def _reduced(vectors: NDArray, rates: NDArray) -> tuple[NDArray, NDArray]:
    """Shortest vectors (k, 3) of the same lattice, shortest first, and their rates.

    Each vector is shortened by whole numbers of the others until none gets shorter (Lagrange; in
    three dimensions Semaev 2001).
    """
    vectors = vectors.copy()
    rates = rates.copy()
    shortened = len(vectors) > 1
    while shortened:
        shortened = False
        order = np.argsort((vectors**2).sum(axis=1), kind="stable")
        vectors = vectors[order]
        rates = rates[order]
        for k in reversed(range(len(vectors))):
            others = [j for j in range(len(vectors)) if j != k]
            combinations = [np.array(n) for n in product((-1.0, 0.0, 1.0), repeat=len(others))]
            for j, unit in zip(others, np.eye(len(others)), strict=True):
                nearest = np.rint(vectors[k] @ vectors[j] / (vectors[j] @ vectors[j]))
                combinations.append(unit * nearest)
            squares = [((vectors[k] - n @ vectors[others]) ** 2).sum() for n in combinations]
            if min(squares) < (vectors[k] @ vectors[k]) * (1 - _SAME):
                numbers = combinations[int(np.argmin(squares))]
                vectors[k] -= numbers @ vectors[others]
                rates[k] -= numbers @ rates[others]
                shortened = True
                break
    return vectors, rates


# --- boxes with edges along the axes --------------------------------------------------------------


def minimum_image(vector: NDArray, period: NDArray, to: NDArray | None = None) -> NDArray:
    """Shortest periodic image of vectors (n, 3), or the image nearest to other vectors.

    `period` (3,) holds infinity along axes that are not periodic.
    """
    image = vector.copy()
    away = vector if to is None else vector - to
    for k in np.flatnonzero(np.isfinite(period)):
        image[:, k] -= period[k] * np.rint(away[:, k] / period[k])
    return image


def unit_vectors(vector: NDArray) -> NDArray:
    """Return vectors (n, 3) over their lengths; zero where these are zero."""
    length = np.linalg.norm(vector, axis=1, keepdims=True)
    return np.divide(vector, length, out=np.zeros_like(vector), where=length > 0)
