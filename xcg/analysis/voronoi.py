"""Radical Voronoi (Laguerre) cells of the particles."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from xcg.common.checks import rising_pair
from xcg.common.messages import SceneError, plain, warn_once
from xcg.compiled._jit import for_parts, threads_for
from xcg.compiled.voronoi import Cell, Results, Tree, add_cells
from xcg.scene.conform import takes_scene
from xcg.scene.lattice import Lattice
from xcg.scene.scene import Scene
from xcg.scene.schema import COMPONENTS, VARIABLES, Frame, Variable
from xcg.steps.analysis import FrameAnalysis, run
from xcg.steps.faults import OnError
from xcg.steps.labels import call_of
from xcg.steps.mapping import is_lazy

_LEAF = 6  # particles of the smallest boxes, at most
# memory for planes that cut a cell, and for faces; both grow where they do not suffice
_PLANES = 64
_FACES_A_CELL = 16
# by which the volumes of the cells may miss that of the box
_ROUNDING = 1e-9
# Rows of a lazy result; cells of random points have 15.5 faces on average, half of them a pair.
_PAIRS_A_PARTICLE = 12
# cells without a face to an edge that tell the packing inside, and share of the volume of those at
# both ends of an axis above which they are said to reach beyond the grains: at flat walls a packing
# is looser by less, and a bed under a free surface rests on the other end
_INSIDE = 20
_OUTSIDE = 0.4

_ROWS = {
    "particle_id": VARIABLES["particle_id"],
    "voronoi_volume": Variable(("particle",), "m^3", "volume of the Voronoi cell"),
    "voronoi_fraction": Variable(("particle",), "1", "volume of the particle over its cell's"),
    "voronoi_area": Variable(("particle",), "m^2", "surface of the Voronoi cell"),
    "voronoi_neighbours": Variable(("particle",), "1", "number of faces to others", "int64"),
    "voronoi_at_edge": Variable(("particle",), "1", "1 where the cell ends at the region", "int64"),
}
_FACES = {
    "face_i": Variable(("face",), "1", "id of the first particle", "int64"),
    "face_j": Variable(("face",), "1", "id of the second particle", "int64"),
    "face_area": Variable(("face",), "m^2", "area of the face"),
    "face_normal": Variable(("face", "component"), "1", "normal from the first to the second"),
}


@takes_scene
def voronoi(
    scene: Scene,
    *,
    bounds: Mapping[str, Sequence[float]] | None = None,
    faces: bool = False,
    on_error: OnError = "raise",
) -> xr.Dataset:
    """Compute the radical Voronoi (Laguerre) cell of each particle.

    Lazy where the scene is.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with diameters.
    bounds : mapping, optional
        First and last coordinate (m) of the cells along axes that are not periodic, for example
        walls, ``{"z": (0.0, 0.2)}``. By default the edges of the box.
    faces : bool
        Add the faces between particles, each once.
    on_error : {"raise", "skip"}
        What to do about a step that cannot be read or computed: stop with its error, or leave it
        out (NaN, or padding), warn of it, and mark it in the coordinate ``skipped`` (time).

    Returns
    -------
    xarray.Dataset
        By particle: ``voronoi_volume`` (m3), 0 for a particle that others cover so far that it has
        no cell; ``voronoi_fraction``, the volume of the particle over it; ``voronoi_area`` (m2);
        ``voronoi_neighbours``, how many faces the cell has to other particles, images counted each.
        ``voronoi_at_edge``, 1 where the cell ends at an edge of the region that is not periodic.
        With `faces` by face: ``face_i`` and ``face_j``, the ids of its particles, ``face_area``
        (m2), and ``face_normal`` from i to j; padding is -1 and NaN.

    Raises
    ------
    SceneError
        If an axis has no finite edges, centres are outside of them or coincide, or a tilted box is
        not periodic along all axes.
    ValueError
        If `bounds` has a periodic or unknown axis.

    Notes
    -----
    The cell of particle i is where ``|r - r_i|^2 - R_i^2`` is less than for all others (Gellatly &
    Finney 1982), so that planes between touching spheres touch both. Cells fill the box: near a free
    surface they reach up to its edge, unless `bounds` ends there, so their ``voronoi_fraction`` is too
    low. ``v.where(v.voronoi_at_edge == 0)`` leaves them out. Cells of a layer of discs are as
    high as the layer. Faces below 1e-6 of the mean cell's ``V^(2/3)`` are rounding and do not count,
    nor do faces to edges or to the particle's own images. Boxes of Lees and Edwards are taken as
    they are at each step. Source of the algorithm: Rycroft, Chaos 19 (2009) 041111 (Voro++).

    Results are variables of particles: ``ds.assign(voronoi_volume=v.voronoi_volume)`` has fields of
    them.

    Examples
    --------
    >>> import xcg
    >>> v = voronoi(xcg.datasets.face_centred_cubic(3))
    >>> round(float(v.voronoi_fraction[0, 0]), 5), int(v.voronoi_neighbours[0, 0])
    (0.74048, 12)
    """
    scene.require(("diameter", "volume"), "voronoi")
    if bounds is not None and not isinstance(bounds, Mapping):
        raise ValueError(
            f"bounds={plain(bounds)}: expected ends of axes, for example {{'z': (0.0, 0.2)}}"
        )
    call = call_of("voronoi", {"bounds": bounds, "faces": faces or None})
    return run(scene, _Cells(bounds or {}, faces), call=call, on_error=on_error)


@dataclass(frozen=True)
class _Cells(FrameAnalysis):
    """Voronoi cells of the particles of a step, within bounds along axes that are not periodic."""

    name = "voronoi"

    bounds: Mapping[str, Any]
    faces: bool

    def prepare(self, scene: Scene) -> _Cells:
        """Check the bounds; those across a layer are its edges."""
        is_open = [a for a in self.setup.plane if a not in self.setup.periodic]
        bounds = {}
        for axis, ends in self.bounds.items():
            if axis not in is_open:
                raise ValueError(
                    f"bounds: {axis!r} is not an axis with ends; expected one of {is_open or 'none'}"
                )
            bounds[axis] = rising_pair(f"bounds[{axis!r}]", ends)
        if scene.layer is not None:
            across, low, high = scene.layer
            bounds[COMPONENTS[across]] = (low, high)
        if scene.tilted and is_open:
            raise SceneError(
                "voronoi: cells in a tilted box need one that is periodic along all axes, and it "
                f"is open along {', '.join(is_open)}"
            )
        return replace(self, bounds=bounds)

    def reads(self, scene: Scene) -> tuple[str, ...]:
        """Return positions and sizes."""
        return ("position", "diameter", "volume")

    def rows(self, scene: Scene) -> dict[str, Variable]:
        """Return the rows of cells, and of faces."""
        if self.faces:
            return _ROWS | _FACES
        return _ROWS

    def sizes(self, scene: Scene, ds: xr.Dataset) -> dict[str, int | None]:
        """Return the most faces of a step, a bound if anything is lazy."""
        if is_lazy(ds, ds.variables):
            return {"face": _PAIRS_A_PARTICLE * ds.sizes["particle"]}
        return {"face": None}

    def frame(self, frame: Frame, lattice: Lattice, source: str) -> dict[str, ArrayLike]:
        """Compute the cells of the particles of a step."""
        vectors, first = self._region(lattice, source)
        position = _inside(frame, vectors, first, lattice, source)
        volume = abs(np.linalg.det(vectors))
        unit = (volume / max(1, len(position))) ** (1 / 3)  # edge of a mean cell
        radius = frame["diameter"] / 2
        order, tree = _tree(position / unit, radius / unit, vectors / unit, lattice.open_axes)
        cells, faces = _cells(tree, self.faces, self.threads)
        back = np.argsort(order)
        volumes = cells.volume[back] * unit**3
        ids = frame["particle_id"]
        _check(volumes, volume, ids, source)
        fraction = np.full(len(position), np.nan)
        np.divide(frame["volume"], volumes, out=fraction, where=volumes > 0)
        # the two faces of a layer are no edges
        in_plane = np.repeat([axis in self.setup.plane for axis in COMPONENTS], 2)
        at_ends = cells.at_ends[back] & in_plane
        self._warn_of_reach(at_ends, volumes, fraction, source)
        results = {
            "particle_id": ids,
            "voronoi_volume": volumes,
            "voronoi_fraction": fraction,
            "voronoi_area": cells.area[back] * unit**2,
            "voronoi_neighbours": cells.neighbours[back],
            "voronoi_at_edge": at_ends.any(axis=1).astype(int),
        }
        if self.faces:
            i, j = order[faces[:, :2].astype(int)].T
            once = np.flatnonzero(i < j)
            once = once[np.lexsort([j[once], i[once]])]
            area = np.linalg.norm(faces[once, 2:], axis=1, keepdims=True)
            results["face_i"] = ids[i[once]]
            results["face_j"] = ids[j[once]]
            results["face_area"] = area[:, 0] * unit**2
            results["face_normal"] = faces[once, 2:] / area
        return results

    def _warn_of_reach(
        self, at_ends: NDArray, volumes: NDArray, fraction: NDArray, source: str
    ) -> None:
        """Warn if cells at both ends of an axis hold much more volume than their grains need inside.

        The packing fraction of grains inside is the median of cells without a face to an open edge.
        """
        at_edge = at_ends.any(axis=1)
        inside = ~at_edge & np.isfinite(fraction)
        if inside.sum() < _INSIDE:
            return
        packing = np.median(fraction[inside])
        axes = []
        for axis in self.setup.plane:
            low, high = at_ends[:, 2 * COMPONENTS.index(axis) :][:, :2].T
            held = [volumes[cells].sum() for cells in (low, high)]
            needed = [(fraction[cells] * volumes[cells]).sum() / packing for cells in (low, high)]
            if all(n < (1 - _OUTSIDE) * h for n, h in zip(needed, held, strict=True)):
                axes.append(axis)
        if axes:
            warn_once(
                "cells beyond the grains",
                f"{source}: {at_edge.sum()} of {len(volumes)} cells end at edges of the region, and at both ends "
                f"along {', '.join(axes)} they hold more than {1 / (1 - _OUTSIDE):.2g} times the volume that "
                "their grains take up inside, as in a container that is no box: voronoi_fraction is too low "
                "there. Leave them out, v.where(v.voronoi_at_edge == 0), or end the region at the grains, bounds=",
            )

    def _region(self, lattice: Lattice, source: str) -> tuple[NDArray, NDArray]:
        """Return vectors along the edges of the region that cells fill (3, 3), and its corner."""
        edges = np.full((3, 2), np.nan)
        if lattice.edges is not None:
            edges[:] = lattice.edges
        for axis, ends in self.bounds.items():
            edges[COMPONENTS.index(axis)] = ends
        vectors = np.diag(edges[:, 1] - edges[:, 0])
        if lattice.cell is not None:
            vectors = np.where(lattice.cell.any(axis=1, keepdims=True), lattice.cell, vectors)
        first = np.where(np.isfinite(edges[:, 0]), edges[:, 0], 0.0)
        lacks = [
            a for a, edge in zip(COMPONENTS, vectors, strict=True) if not np.isfinite(edge).all()
        ]
        if lacks:
            raise SceneError(
                f"{source}: cells need ends along {', '.join(lacks)}, and the box has none; pass "
                f"bounds={dict.fromkeys(lacks, (0.0, 1.0))} with those of the walls"
            )
        return vectors, first


def _check(volumes: NDArray, volume: float, ids: NDArray, source: str) -> None:
    """Raise SceneError if a particle has no cell, as another coincides with it, or the cells do not fill the region."""
    together = np.isnan(volumes)
    if together.any():
        raise SceneError(
            f"{source}: no Voronoi cells of {together.sum()} particles, such as id "
            f"{ids[together.argmax()]}, as others are at the same places; remove one of two"
        )
    if len(volumes) and abs(volumes.sum() / volume - 1) > _ROUNDING:
        raise SceneError(
            f"{source}: the cells fill {volumes.sum() / volume:.9g} of the box, as rounding "
            "broke some; are there particles at almost one place, or of extremely different sizes?"
        )


def _inside(
    frame: Frame, vectors: NDArray, first: NDArray, lattice: Lattice, source: str
) -> NDArray:
    """Return positions (n, 3) in the region, relative to its corner; raise if one is outside."""
    position = lattice.wrapped(frame["position"], first, source) - first
    is_open = lattice.open_axes
    outside = ((position < 0) | (position > np.diag(vectors)))[:, is_open].any(axis=1)
    if outside.any():
        index = int(outside.argmax())
        raise SceneError(
            f"{source}: {outside.sum()} particles are outside of the ends of the cells, such as id "
            f"{frame['particle_id'][index]} at {frame['position'][index].tolist()}; pass wider bounds="
        )
    return position


def _tree(
    position: NDArray, radius: NDArray, vectors: NDArray, is_open: NDArray
) -> tuple[NDArray, Tree]:
    """Sort particles (n, 3), from the corner of a region, by halves; return their indices in this order."""
    inverse = np.linalg.inv(vectors)
    position = position - np.where(is_open, 0.0, np.floor(position @ inverse)) @ vectors
    order = np.arange(len(position))
    depth = max(0, math.ceil(math.log2(max(1, len(position)) / _LEAF)))
    boxes = []
    for k in range(depth + 1):
        starts = len(position) * np.arange(2**k + 1) // 2**k
        in_order = position[order]
        low = np.minimum.reduceat(in_order, starts[:-1])
        high = np.maximum.reduceat(in_order, starts[:-1])
        boxes.append((low, high, np.maximum.reduceat(radius[order], starts[:-1])))
        # the next halves are those along the longest side
        longest = (high - low).argmax(axis=1)
        box = np.repeat(np.arange(2**k), np.diff(starts))
        along = in_order[np.arange(len(position)), longest[box]]
        if k < depth:
            order = order[np.lexsort([along, box])]
    low, high, largest = map(np.concatenate, zip(*boxes, strict=True))
    lengths = np.linalg.norm(vectors, axis=1)
    half = lengths / 2
    if (vectors != np.diag(np.diag(vectors))).any():
        half = np.full(3, lengths.sum() / 2)
    return order, Tree(
        np.column_stack([position, radius])[order],
        low,
        high,
        largest,
        vectors,
        1 / np.linalg.norm(inverse, axis=0),
        half,
        is_open,
    )


def _cells(tree: Tree, with_faces: bool, threads: int) -> tuple[Results, NDArray]:
    """Return the cells of particles in the order of their tree, and their faces, if they are asked for."""
    count = len(tree.particles)
    results = Results(
        np.zeros(count), np.zeros(count), np.zeros(count, int), np.zeros((count, 6), bool)
    )

    def add(first: int, last: int) -> list[NDArray]:
        planes = _PLANES
        parts = []
        while first < last:
            faces = np.empty((with_faces * (planes + _FACES_A_CELL * (last - first)), 5))
            stop, found = add_cells(first, last, tree, Cell.of(planes), results, faces)
            parts.append(faces[:found])
            if stop == first:
                planes *= 2
            first = stop
        return parts

    parts = for_parts(count, add, threads_for(count, threads))
    return results, np.concatenate([np.zeros((0, 5)), *chain.from_iterable(parts)])
