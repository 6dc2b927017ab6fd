"""Box of a scene: edges, tilt and shear as callers give them, and its motion between frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from xcg.common.checks import floats
from xcg.common.messages import SceneError, warn_once, warn_user
from xcg.scene.frame import indices_of
from xcg.scene.lattice import Lattice, same_vectors
from xcg.scene.schema import COMPONENTS, Frame

_BOX_FORMS = "six numbers as [[x0, x1], [y0, y1], [z0, z1]], or a mapping {'x': (x0, x1), ...}"
_TILT_FORMS = "the vectors a, b, c as an array (3, 3), one such array a step, or tilts such as {'xy': 0.01} (m)"
_SHEARS = tuple(i + j for i in COMPONENTS for j in COMPONENTS if i != j)
_STRETCHES = tuple(2 * i for i in COMPONENTS)
# Steps of a random walk are wrapped where some reach a half of the period: many a quarter, or one nearly a half.
_LARGE_SHARE = 0.25
_FEW = 0.01  # of the grains may move by more than a quarter
_NEARLY_HALF = 0.4
_FAST = 0.25  # change of the tilt from step to step, in periods, from which it is hardly known: a half is two rates


def _edges(box: ArrayLike | Mapping[str, Sequence[float]], steps: int) -> NDArray:
    """Edges of the domain as an array (steps, 3, 2); axes left out of a mapping are unbounded."""
    if isinstance(box, Mapping):
        wrong = set(box) - set(COMPONENTS)
        if wrong:
            raise SceneError(f"box has keys {sorted(wrong)}: expected {_BOX_FORMS}")
        box = [box.get(axis, (-np.inf, np.inf)) for axis in COMPONENTS]
    edges = floats(box)
    if edges.shape not in ((3, 2), (steps, 3, 2)):
        raise SceneError(
            f"box has shape {edges.shape}: expected {_BOX_FORMS}, or one such array a step"
        )
    if not (edges[..., 0] < edges[..., 1]).all():
        raise SceneError(f"box={box!r}: the lower edge of every axis must lie below the upper edge")
    return np.broadcast_to(edges, (steps, 3, 2)).copy()


def domain_of(
    box: ArrayLike | Mapping[str, Sequence[float]] | None,
    lattice: ArrayLike | Mapping[str, ArrayLike] | None,
    shear_rate: Mapping[str, ArrayLike] | None,
    periodic: str,
    steps: int,
    time: NDArray | None = None,
    unit: float = 1.0,
) -> dict[str, NDArray]:
    """Variables of the domain, time first: its edges, and where it is tilted or sheared its lattice and how that moves.

    Parameters
    ----------
    box : array (3, 2), array (t, 3, 2) or mapping, optional
        Edges of the box without its tilt; axes left out of a mapping are unbounded.
    lattice : array (3, 3), array (t, 3, 3) or mapping, optional
        Vectors a, b, c, or tilts by name, a number or one a step: "xy" is how far images along y
        are shifted along x.
    shear_rate : mapping, optional
        Rates by name (s-1), a number or one a step: "xy" is how much faster images one length up y
        move along x, "xx" that of images along x. By default the rates at which the tilts change
        from step to step.
    periodic : str
        Periodic axes.
    steps : int
        Number of steps.
    time : array (t,), optional
        Times of the steps (s), where they are known.
    unit : float
        Unit of `box` and `lattice`, in that of the result.

    Raises
    ------
    SceneError
        If edges or vectors have another shape, a lattice is given without edges or does not fit
        them, or a shear is given without a lattice.
    """
    if box is None:
        if lattice is not None or shear_rate:
            raise SceneError(
                f"lattice={lattice!r}, shear_rate={shear_rate!r}: give the edges without the tilt, too (box=)"
            )
        return {}
    edges = _edges(box, steps) * unit
    domain = {"box": edges}
    if lattice is None:
        rates_of_boxes = dict(shear_rate or {})
        shears = [name for name, rate in rates_of_boxes.items() if name in _SHEARS and np.any(rate)]
        if shears:
            raise SceneError(
                f"shear_rate={rates_of_boxes!r}: where images are, along the shear, is not known from edges; give "
                f"the tilt at each step as well: lattice={{{shears[0]!r}: tilts}}, in Lees-Edwards boxes "
                "the offset of the images"
            )
        if not rates_of_boxes:
            return domain
        lattice = {}
    vectors = _vectors(edges, lattice, periodic, unit)
    if shear_rate is None:
        rates = _rates(vectors, periodic, time)
    else:  # the transposed gradient; images along axes without edges do not exist
        rates = np.where(np.isinf(vectors), 0.0, vectors) @ _entries(
            len(edges), shear_rate, "shear_rate", (*_SHEARS, *_STRETCHES)
        )
    axes = [COMPONENTS.index(a) for a in periodic]
    tilted = _tilts(vectors)[:, axes].any()
    if tilted or rates.any():
        domain["lattice"] = vectors
    if rates.any():
        domain["lattice_velocity"] = rates
    return domain


def _entries(
    steps: int, entries: Mapping[str, ArrayLike], name: str, keys: Sequence[str] = _SHEARS
) -> NDArray:
    """Matrices (t, 3, 3) of numbers such as {"xy": value}, in row y and column x."""
    wrong = {repr(entries)}
    if isinstance(entries, Mapping):
        wrong = set(entries) - set(keys)
    if wrong:
        raise SceneError(
            f"{name} names {sorted(wrong)}: expected a mapping from {', '.join(keys)} to numbers"
        )
    out = np.zeros((steps, 3, 3))
    for key, values in entries.items():
        i = COMPONENTS.index(key[0])
        j = COMPONENTS.index(key[1])
        numbers = floats(values)
        if numbers.shape not in ((), (steps,)) or not np.isfinite(numbers).all():
            raise SceneError(
                f"{name}[{key!r}]={values!r}: expected a finite number, or one for each of {steps} steps"
            )
        out[:, j, i] = numbers
    return out


def _vectors(
    edges: NDArray, lattice: ArrayLike | Mapping[str, ArrayLike], periodic: str, unit: float
) -> NDArray:
    """Lattice vectors (t, 3, 3), given in some unit, checked against the edges."""
    lengths = edges[..., 1] - edges[..., 0]
    if isinstance(lattice, Mapping):
        vectors = _entries(len(edges), lattice, "lattice") * unit
        vectors[:, range(3), range(3)] = lengths
        return vectors
    vectors = floats(lattice) * unit
    if vectors.shape not in ((3, 3), (len(edges), 3, 3)):
        raise SceneError(f"lattice has shape {vectors.shape}: expected {_TILT_FORMS}")
    vectors = np.broadcast_to(vectors, (len(edges), 3, 3)).copy()
    for axis in periodic:
        k = COMPONENTS.index(axis)
        off = np.flatnonzero(~(np.abs(vectors[:, k, k] - lengths[:, k]) <= 1e-9 * lengths[:, k]))
        if off.size:
            raise SceneError(
                f"lattice vector {'abc'[k]} is {vectors[off[0], k].tolist()}, and the box without its tilt is "
                f"{lengths[off[0], k]:g} long along {axis!r}: expected that as its component along {axis!r}"
            )
        vectors[:, k, k] = lengths[:, k]
    return vectors


def _tilts(vectors: NDArray) -> NDArray:
    """Return lattice vectors (t, 3, 3) without their lengths along the axes, which may be infinite."""
    return np.where(np.eye(3, dtype=bool), 0.0, vectors)


def _rates(vectors: NDArray, periodic: str, time: NDArray | None) -> NDArray:
    """Rates (t, 3, 3) at which tilts change, from the steps before and after each.

    Codes flip a box that is tilted far: a vector is then written as its sum with whole numbers of
    others, and moves as that sum does.
    """
    axes = [COMPONENTS.index(a) for a in periodic]
    cells = _tilts(vectors)[:, axes]
    rates = np.zeros_like(vectors)
    if not cells.any() or (cells == cells[:1]).all():
        return rates
    if time is None:
        warn_user(
            "the tilt of the box changes from step to step, but the times of the steps are not known, so that its "
            "images are taken to be at rest relative to each other; give timestep=, times= or shear_rate="
        )
        return rates
    cells = vectors[:, axes]
    largest = 0.0
    # rates before and after each step, of the vectors as written there
    one_sided = np.zeros((2, len(time), len(axes), 3))
    for t, (one, two) in enumerate(pairwise(cells)):
        turned = same_vectors(one, two, axes)
        move = (turned @ two - one) * ~np.eye(3, dtype=bool)[axes]
        largest = max(largest, float(np.abs(move[:, axes] / two[range(len(axes)), axes]).max()))
        one_sided[1, t] = move / (time[t + 1] - time[t])
        one_sided[0, t + 1] = np.linalg.solve(turned, one_sided[1, t])
    if largest > _FAST:
        warn_user(
            f"the tilt of the box changes by up to {largest:.2g} periods from step to step; where it is half of one or "
            "more, the rate of shear that follows is wrong: give shear_rate=, for example {'xy': 0.1} (s-1)"
        )
    one_sided[0, 0] = one_sided[1, 0]
    one_sided[1, -1] = one_sided[0, -1]
    lengths = np.diff(time)[:, None, None]
    before = np.concatenate([lengths[:1], lengths])
    after = np.concatenate([lengths, lengths[-1:]])
    rates[:, axes] = (after * one_sided[0] + before * one_sided[1]) / (before + after)
    return rates


@dataclass(frozen=True, eq=False)
class BoxMotion:
    """The displacement ``shift + gradient r`` that a box imposes on what it holds: zero along axes that are open.

    It follows from the shapes of the box in both frames.

    Attributes
    ----------
    gradient : array (3, 3)
        Change of the periods over the periods.
    shift : array (3,)
        Displacement that belongs to the origin of coordinates (m).
    lattice : Lattice
        Periodic images of the later frame.
    turned : array (k, k)
        Whole numbers: the vectors of the first frame are ``turned @ lattice.periodic_vectors``, moved with the
        box.
    """

    gradient: NDArray
    shift: NDArray
    lattice: Lattice
    turned: NDArray

    @classmethod
    def between(cls, first: Lattice, later: Lattice) -> BoxMotion:
        """Compare the boxes of two frames."""
        stretch, lower, moved = np.zeros((3, 3))
        wraps = np.isfinite(first.lengths)
        if first.edges is not None and later.edges is not None:
            has_edges = wraps & np.isfinite(first.edges[:, 0]) & np.isfinite(later.edges[:, 0])
            lower[has_edges] = first.edges[has_edges, 0]
            moved[has_edges] = later.edges[has_edges, 0] - first.edges[has_edges, 0]
            # an edge that is a period further on is the same edge
            moved = later.shortest(moved[None])[0]
        if first.vectors is None and later.vectors is None:
            stretch[wraps] = later.period[wraps] / first.period[wraps] - 1.0
            return cls(np.diag(stretch), moved - stretch * lower, later, np.eye(wraps.sum()))
        before = first.periodic_vectors
        after = later.periodic_vectors
        turned = same_vectors(before, after, np.flatnonzero(wraps))
        gradient = (np.linalg.pinv(before) @ (turned @ after - before)).T
        return cls(gradient, moved - gradient @ lower, later, turned)

    def warn_of_jumps(
        self, moved: NDArray, frame: Frame, lattice: Lattice, source: str, results: str
    ) -> None:
        """Warn of relative displacements (n, 3) so large that the nearest image may be another one.

        `results` is what would be wrong, such as "velocities".
        """
        if "image" in frame:
            return
        shares = np.abs(moved) / lattice.period
        share = shares.max(axis=0, initial=0.0)
        large = int((shares > _LARGE_SHARE).any(axis=1).sum())
        if share.max() > _NEARLY_HALF or large > _FEW * len(moved):
            warn_once(
                f"{results} across a period",
                f"{source}: particles move by up to {share.max():.2f} of the period along "
                f"'{COMPONENTS[share.argmax()]}' between two steps, {large} of {len(moved)} by more than a quarter; "
                f"{results} of those that move by half a period "
                "or more are wrong. Write steps more often, or with images (ix iy iz, or xu yu zu)",
            )

    def relative(
        self, first: Frame, later: Frame, indices: NDArray, later_indices: NDArray
    ) -> NDArray:
        """Return the displacements (n, 3) of grains, less that of the box where they were.

        Frames with ``image`` say which image each grain went to; in others it is the one that moved
        least.

        Parameters
        ----------
        first, later : Frame
            The two frames.
        indices, later_indices : array (n,)
            Indices of the same grains in the first and in the later frame.

        Raises
        ------
        SceneError
            If ``image`` changes along an axis that is not periodic.
        """
        position = first["position"][indices]
        moved = (
            later["position"][later_indices] - position - self.shift - position @ self.gradient.T
        )
        if "image" not in first:
            return self.lattice.shortest(moved)
        before = first["image"][indices]
        after = later["image"][later_indices]
        axes = self.lattice.axes
        crossed = np.argwhere(np.delete(after - before, axes, axis=1))
        if crossed.size:
            n, k = crossed[0]
            axis = np.delete(list(COMPONENTS), axes)[k]
            raise SceneError(
                f"particle {first['particle_id'][indices][n]} has another image along '{axis}' than before, and the "
                f"scene is not periodic along it; give periodic= with '{axis}', or ds.drop_vars('image')"
            )
        return (
            moved + (after[:, axes] - before[:, axes] @ self.turned) @ self.lattice.periodic_vectors
        )


def partners(first: Frame, later: Frame, sources: tuple[str, str]) -> NDArray:
    """Return the index in a later frame of each grain of the first, -1 for lost grains.

    Raises
    ------
    SceneError
        If the first frame holds grains, and the later one none of them.
    """
    indices = indices_of(later["particle_id"], first["particle_id"])
    if len(indices) and (indices < 0).all():
        raise SceneError(
            f"{sources[0]} and {sources[1]} have no particle id in common: grains are followed by ids that stay the "
            "same from step to step; choose a smaller lag, or open the files with names= for the column of such ids"
        )
    return indices
