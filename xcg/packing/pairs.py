"""Pairs of particles that touch or are near, from arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from xcg.common.checks import is_finite
from xcg.common.messages import SceneError
from xcg.compiled import THREADS
from xcg.compiled.pairs import rows_of_pairs, sort_pairs
from xcg.compiled.threads import for_parts, worth
from xcg.packing.cells import CellLists
from xcg.scene.box import box_array, with_lattice
from xcg.scene.contacts import MOST_A_PARTICLE, MOST_PAIRS
from xcg.scene.lattice import Lattice

PairMethod: TypeAlias = Literal["hierarchical", "linked-cell"]


def find_pairs(
    position: ArrayLike,
    radius: ArrayLike,
    box: ArrayLike | Mapping[str, Sequence[float]] | None = None,
    periodic: str = "",
    *,
    lattice: ArrayLike | Mapping[str, ArrayLike] | None = None,
    skin: float = 0.0,
    method: PairMethod = "hierarchical",
    levels: int | None = None,
    threads: int | None = None,
    most: int | None = None,
) -> NDArray:
    """Find all pairs of spheres with ``|r_i - r_j| < R_i + R_j + skin``, each once, for any mix of sizes.

    Particles are sorted by size into levels, each with cells as large as its largest particles need. Pairs of one
    level are found in forward cells, pairs of two levels from the smaller particle in the cells of the larger level
    (Iwai, Hong & Greil 1999; Ogarko & Luding 2012; Shire, Hanley & Stratford 2020). Time and memory are linear in
    particles and pairs, whatever the ratio of sizes.

    Parameters
    ----------
    position : array (n, 3) or (n, 2)
        Centres (m). Those outside the box are wrapped into it along periodic axes; along the others, cells are laid
        where the particles are.
    radius : array (n,)
        Radii (m), zero included.
    box : array (3, 2) or mapping, optional
        Edges of the domain (m), needed along periodic axes, for example ``{"x": (0.0, 0.1)}``.
    periodic : str
        Periodic axes, any of "xyz". Distances are to the nearest image; a particle is no partner of its own image.
    lattice : array (3, 3) or mapping, optional
        Vectors a, b, c to the next images of a tilted box, or its tilts, as in `xcg.scene_from_arrays` (m).
    skin : float
        Width of gaps that still count (m).
    method : str
        "hierarchical", or "linked-cell": one level for all sizes, the common method, to compare with.
    levels : int, optional
        Number of levels, spaced logarithmically from the smallest to the largest radius; those that hold no
        particles are left out. By default one for each factor of 3.
    threads : int, optional
        Threads that search; by default all cores for many particles. The result does not depend on it.
    most : int, optional
        Pairs that are meant, where they are more than a million and 200 a particle, at which the search stops.

    Returns
    -------
    array (pairs, 2)
        Rows i < j of the particles of each pair, sorted by i, then j.

    Raises
    ------
    SceneError
        If arrays have the wrong shape or hold values that are not finite, a radius is negative, or the box is
        unbounded along a periodic axis, or there are more than `most` pairs.
    ValueError
        If `method`, `skin`, `levels` or `threads` is not as expected.

    Examples
    --------
    >>> find_pairs([[0.1, 0, 0], [9.9, 0, 0], [5.0, 0, 0]], [0.2, 0.2, 0.2], {"x": (0, 10)}, "x").tolist()
    [[0, 1]]
    """
    centres, radii = _spheres(position, radius)
    check_search(skin, method, levels, threads)
    if box is not None and not isinstance(box, Mapping) and np.shape(box) == (2, 2):
        box = dict(zip("xy", np.asarray(box, float).tolist(), strict=True))
    edges = None if box is None else box_array(box, 1)
    arrays = with_lattice(edges, lattice, {}, periodic, None)
    images = Lattice.of({name: values[0] for name, values in arrays.items()}, periodic, "find_pairs")
    return pairs_of(centres, radii, images, skin=skin, method=method, levels=levels, threads=threads, most=most)


def pairs_of(
    centres: NDArray, radii: NDArray, lattice: Lattice, *, skin: float, method: str, levels: int | None,
    threads: int | None, most: int | None, source: str = "find_pairs",
) -> NDArray:  # fmt: skip
    """Find pairs of spheres in any box, see `find_pairs`."""
    if len(centres) < 2:
        return np.empty((0, 2), "int64")
    corner = np.zeros(3) if lattice.edges is None else np.where(lattice.open_axes, 0.0, lattice.edges[:, 0])
    count, whose = len(centres), np.arange(len(centres))
    if lattice.vectors is not None:  # images near the box stand beside it as particles of their own
        centres, reach = lattice.wrapped(centres, corner, source), 2 * radii.max() + skin
        low, high = centres.min(axis=0) - reach, centres.max(axis=0) + reach
        row, shift, _ = lattice.images(centres, low, high, source)
        others = shift.any(axis=1)
        centres = np.concatenate([centres, centres[row[others]] + shift[others]])
        whose = np.concatenate([whose, row[others]])
    near = _near(centres, radii[whose], corner, lattice.period, skin, method, levels, threads, most)
    if lattice.vectors is None:
        return near
    near = whose[near[near[:, 0] < count]]  # of two images that are near each other one is in the box
    return np.unique(np.sort(near[near[:, 0] != near[:, 1]], axis=1), axis=0)


def _near(
    centres: NDArray, radii: NDArray, corner: NDArray, period: NDArray, skin: float, method: str, levels: int | None,
    threads: int | None, most: int | None,
) -> NDArray:  # fmt: skip
    """Pairs of spheres in a box with periods along the axes, or none."""
    workers = threads or worth(len(centres), THREADS)
    levels = 1 if method == "linked-cell" else levels
    lists = CellLists.of(centres, radii, corner, period, skin=skin, levels=levels, threads=workers)
    most = max(MOST_PAIRS, MOST_A_PARTICLE * len(centres), most or 0)
    counts = [0]

    def find(first: int, last: int) -> tuple[NDArray, NDArray]:
        left, right, _ = lists.find(first, last, most - sum(counts))
        counts.append(len(left))
        rows_of_pairs(left, right, lists.row)
        return left, right

    # more parts than threads, as large particles take longer than small ones
    found = for_parts(len(centres), find, workers, each=8)
    if sum(counts) > most:
        raise SceneError(
            f"more than {most} pairs of near particles among {len(centres)}: positions coincide, or diameters or skin= "
            "are too large for their unit. Where so many are meant, give most= (max_contacts= of find_contacts)"
        )
    low, high = (np.concatenate([part[side] for part in found]) for side in (0, 1))
    pairs = np.empty((len(low), 2), "int64")
    for_parts(len(centres), lambda first, last: sort_pairs(low, high, len(centres), first, last, pairs), workers)
    return pairs


def _spheres(position: ArrayLike, radius: ArrayLike) -> tuple[NDArray, NDArray]:
    """Centres (n, 3) and radii (n,), checked."""
    centres, radii = np.asarray(position, float), np.ascontiguousarray(radius, float)
    if centres.size == 0:
        centres = centres.reshape(0, 3)
    if centres.ndim != 2 or centres.shape[1] not in (2, 3) or radii.shape != (len(centres),):
        raise SceneError(
            f"position has shape {np.shape(position)} and radius {np.shape(radius)}: expected (n, 3), or (n, 2) for a "
            "plane, and (n,)"
        )
    wrong = ~(np.isfinite(centres).all(axis=1) & np.isfinite(radii) & (radii >= 0))
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        raise SceneError(
            f"particle {row} has position {centres[row]} and radius {radii[row]} ({int(wrong.sum())} such rows): "
            "expected finite coordinates and a radius of at least 0; repair or drop these rows"
        )
    if centres.shape[1] == 2:
        centres = np.column_stack([centres, np.zeros(len(centres))])
    return np.ascontiguousarray(centres), radii


def check_search(skin: float, method: str, levels: int | None, threads: int | None = None) -> None:
    """Refuse options of the search that are not as expected."""
    if method not in get_args(PairMethod):
        raise ValueError(f"method={method!r}: expected one of {', '.join(map(repr, get_args(PairMethod)))}")
    if not (is_finite(skin) and skin >= 0):
        raise ValueError(f"skin={skin!r}: expected 0 or the width of a gap that still counts as a contact (m)")
    for name, value in (("levels", levels), ("threads", threads)):
        if value is not None and not (isinstance(value, (int, np.integer)) and value >= 1):
            raise ValueError(f"{name}={value!r}: expected a whole number of at least 1, or None to let it be chosen")
