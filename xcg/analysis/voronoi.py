"""Radical Voronoi (Laguerre) cells of the particles, by Voro++."""

from __future__ import annotations

import gc
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from xcg.common.checks import extra, rising_pair
from xcg.common.messages import SceneError, plain, warn_once
from xcg.scene.conform import takes_scene
from xcg.scene.lattice import Lattice
from xcg.scene.scene import Scene
from xcg.scene.schema import COMPONENTS, VARIABLES, Frame, Variable
from xcg.steps.analysis import FrameAnalysis, run
from xcg.steps.faults import OnError
from xcg.steps.labels import call_of

# of the mean cell's volume^(2/3): rounding makes smaller faces where more than four cells meet
_LEAST_AREA = 1e-6
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

    Lazy where the scene is. Needs ``pip install 'xcg[voronoi]'``.

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
    ImportError
        If pyvoro2 is not installed.

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
    extra("pyvoro2", "voronoi", "voronoi")
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
        """Return the most faces of a step, a bound if it is lazy."""
        if ds["position"].chunks is None:
            return {"face": None}
        return {"face": _PAIRS_A_PARTICLE * ds.sizes["particle"]}

    def frame(self, frame: Frame, lattice: Lattice, source: str) -> dict[str, ArrayLike]:
        """Compute the cells of the particles of a step."""
        vectors, first = self._region(lattice, source)
        place = _inside(frame, vectors, first, lattice, source)
        volume = abs(np.linalg.det(vectors))
        unit = (volume / max(1, len(place))) ** (1 / 3)  # length of a mean cell
        # Voro++ expects coordinates of the order of one
        box = _domain(vectors / unit, lattice)
        with _collector_paused():
            cells = _cells(place / unit, frame["diameter"] / 2 / unit, box, source)
            i, j, area_vector = _faces_of(cells)
        volumes = np.array([cell["volume"] for cell in cells]) * unit**3
        if len(cells) and abs(volumes.sum() / volume - 1) > _ROUNDING:
            raise SceneError(
                f"{source}: the cells fill {volumes.sum() / volume:.9g} of the box, as rounding "
                "broke some; are there particles at one place, or of extremely different sizes?"
            )
        area = np.linalg.norm(area_vector, axis=1)
        counts = (j >= 0) & (j != i) & (area > _LEAST_AREA)
        with np.errstate(divide="ignore"):
            fraction = np.where(volumes > 0, frame["volume"] / volumes, np.nan)
        at_ends = self._at_ends(i, j, area_vector, area, len(volumes))
        at_edge = np.zeros(len(volumes), bool)
        for pair in at_ends.values():
            at_edge |= pair.any(axis=0)
        _warn_of_reach(at_ends, at_edge, volumes, fraction, source)
        ids = frame["particle_id"]
        results = {
            "particle_id": ids,
            "voronoi_volume": volumes,
            "voronoi_fraction": fraction,
            "voronoi_area": np.bincount(i, area, len(ids)) * unit**2,
            "voronoi_neighbours": np.bincount(i[counts], minlength=len(ids)),
            "voronoi_at_edge": at_edge.astype(int),
        }
        if self.faces:
            once = counts & (i < j)
            results["face_i"] = ids[i[once]]
            results["face_j"] = ids[j[once]]
            results["face_area"] = area[once] * unit**2
            results["face_normal"] = area_vector[once] / area[once, None]
        return results

    def _at_ends(
        self, i: NDArray, j: NDArray, area_vector: NDArray, area: NDArray, count: int
    ) -> dict[str, NDArray]:
        """Return which cells have a face to the low and the high end (2, n) of each open axis."""
        at_ends = {}
        to_edge = (j < 0) & (area > _LEAST_AREA)
        for axis in self.setup.plane:
            if axis not in self.setup.periodic:
                outward = area_vector[:, COMPONENTS.index(axis)]
                pair = np.zeros((2, count), bool)
                pair[0, i[to_edge & (outward < -0.5 * area)]] = True
                pair[1, i[to_edge & (outward > 0.5 * area)]] = True
                at_ends[axis] = pair
        return at_ends

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


def _warn_of_reach(
    at_ends: Mapping[str, NDArray],
    at_edge: NDArray,
    volumes: NDArray,
    fraction: NDArray,
    source: str,
) -> None:
    """Warn if cells at both ends of an axis hold much more volume than their grains need inside.

    The packing fraction of grains inside is the median of cells without a face to an open edge.
    """
    inside = ~at_edge & np.isfinite(fraction)
    if inside.sum() < _INSIDE:
        return
    packing = np.median(fraction[inside])
    axes = []
    for axis, pair in at_ends.items():
        held = [volumes[cells].sum() for cells in pair]
        needed = [(fraction[cells] * volumes[cells]).sum() / packing for cells in pair]
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


def _inside(
    frame: Frame, vectors: NDArray, first: NDArray, lattice: Lattice, source: str
) -> NDArray:
    """Return positions (n, 3) in the region, relative to its corner; raise if one is outside."""
    place = lattice.wrapped(frame["position"], first, source) - first
    is_open = lattice.open_axes
    outside = ((place < 0) | (place > np.diag(vectors)))[:, is_open].any(axis=1)
    if outside.any():
        row = int(outside.argmax())
        raise SceneError(
            f"{source}: {outside.sum()} particles are outside of the ends of the cells, such as id "
            f"{frame['particle_id'][row]} at {frame['position'][row].tolist()}; pass wider bounds="
        )
    return place


def _domain(vectors: NDArray, lattice: Lattice) -> Any:
    """Return a region as pyvoro2 takes it."""
    import pyvoro2

    is_tilted = (vectors != np.diag(np.diag(vectors))).any()
    if not is_tilted:
        ends = tuple((0.0, length) for length in np.diag(vectors).tolist())
        return pyvoro2.OrthorhombicCell(ends, tuple((~lattice.open_axes).tolist()))
    return pyvoro2.PeriodicCell(tuple(map(tuple, vectors.tolist())))


@contextmanager
def _collector_paused() -> Iterator[None]:
    """Pause Python's garbage collector, which scans the lists of all cells again and again while they grow."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def _cells(place: NDArray, radius: NDArray, box: Any, source: str) -> list[dict[str, Any]]:
    """Return the cells of particles in their order, with vertices and faces."""
    import pyvoro2

    if not len(place):
        return []
    try:
        cells = pyvoro2.compute(
            place,
            domain=box,
            mode="power",
            radii=radius,
            include_empty=True,
            return_adjacency=False,
            output="cells",
        )
    except ValueError as error:
        raise SceneError(
            f"{source}: no Voronoi cells of these particles, which are too close to each other or "
            f"outside of the box; remove one of two at the same place ({error})"
        ) from None
    return sorted(cells, key=lambda cell: cell["id"])


def _faces_of(cells: Sequence[Mapping[str, Any]]) -> tuple[NDArray, NDArray, NDArray]:
    """Return the rows of both particles (j < 0 at edges) and area vectors (n, 3) of all faces."""
    faces = list(chain.from_iterable(cell["faces"] for cell in cells))
    if not faces:
        return np.zeros(0, int), np.zeros(0, int), np.zeros((0, 3))
    of_cell = np.cumsum([0, *(len(cell["vertices"]) for cell in cells)])
    vertices = np.array(list(chain.from_iterable(cell["vertices"] for cell in cells)))
    i = np.repeat(np.arange(len(cells)), [len(cell["faces"]) for cell in cells])
    j = np.array([face["adjacent_cell"] for face in faces])
    size = np.array([len(face["vertices"]) for face in faces])
    start = np.cumsum(size) - size
    corner = np.array(list(chain.from_iterable(face["vertices"] for face in faces)))
    corner += np.repeat(of_cell[i], size)
    following = np.arange(len(corner)) + 1
    following[start + size - 1] = start
    # triangles between the first corner of a face and each of its edges; Voro++ lists corners
    # clockwise as seen from outside of the cell, which the centre of a small particle may be
    away = vertices[corner] - np.repeat(vertices[corner[start]], size, axis=0)
    return i, j, 0.5 * np.add.reduceat(np.cross(away[following], away), start)
