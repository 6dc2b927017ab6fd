"""Solid volume in the cells of a mesh: each grain's own volume, shared exactly among the cells that it overlaps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.compiled.geometry import add_shares
from xcg.fields.grids.grid import make_grid
from xcg.fields.layout import automatic_bounds
from xcg.fields.sums.nodes import Grid
from xcg.scene.conform import require_scene, storable, takes_scene
from xcg.scene.description import Description, describe
from xcg.scene.frame import phase_of, steps_in
from xcg.scene.schema import COMPONENTS, OF_STEP, Setup, units_in
from xcg.steps.faults import OnError
from xcg.steps.labels import format_call, mark_skipped, provenance, with_phase_labels
from xcg.steps.mapping import map_over_time

_SPHERE = 1e-6  # how far volumes may be from those of spheres of their diameters
# number, volume, mass and momentum of each grain
_COLUMNS = 6


@dataclass(frozen=True, eq=False)
class _Cells:
    """Options of the shares of cells."""

    grid: Grid
    setup: Setup
    depth: float
    by: str | None
    groups: tuple[int, ...]


@takes_scene
def cell_volumes(
    ds: xr.Dataset,
    spacing: float | Mapping[str, float],
    *,
    axes: str | None = None,
    bounds: Mapping[str, Sequence[float]] | None = None,
    by: str | None = None,
    groups: Sequence[int] | None = None,
    on_error: OnError = "raise",
) -> xr.Dataset:
    """Share the volume of each grain among the cells of a mesh that it overlaps, exactly; lazy where the scene is.

    No kernel is chosen: a sphere counts in a cell by the part of it that lies inside, in closed form, so that the solid
    volume of all cells is that of the grains to rounding. This is what fluid solvers of coupled runs (CFD-DEM) ask for.
    Fields jump where grains leave cells; smooth fields and stress take a kernel, see `coarse_grain`.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with ``diameter`` and ``volume``. Discs (a scene of one layer whose volumes differ from spheres)
        are shared by their areas; other shapes as spheres of their diameter.
    spacing : float or mapping
        Size of the cells (m), for all axes or by axis. Periodic axes without bounds take the nearest that divides them.
    axes : str, optional
        Axes that are divided into cells, all of the scene by default; cells reach through the box along the others.
    bounds : mapping, optional
        First and last centre of the cells by axis (m), as in `coarse_grain`; by default cells cover all grains.
    by, groups, on_error
        As in `coarse_grain`.

    Returns
    -------
    xarray.Dataset
        On the centres of the cells, (time, axes, phase): ``volume_fraction``, ``void_fraction``, ``number_density``
        (m-3, parts of grains counted by their share), ``density``, and, where the scene has velocities,
        ``momentum_density`` and ``velocity``, the mean weighted by the mass inside.

    Raises
    ------
    SceneError
        If the scene lacks sizes, or its box is tilted.
    ValueError
        If an argument is wrong.

    Examples
    --------
    >>> import xcg
    >>> f = cell_volumes(xcg.datasets.simple_cubic(4), 2.0)
    >>> round(float(f.volume_fraction.mean()), 6)
    0.523599
    """
    require_scene(ds, ("diameter", "volume", "mass"), "cell_volumes")
    scene = describe(ds, by)
    setup = scene.setup
    if scene.tilted:
        raise SceneError("cell_volumes takes boxes with edges along x, y and z, and this one is tilted")
    if scene.cylindrical:
        raise SceneError("cell_volumes takes cells along x, y and z, not about an axis")
    axes = setup.plane if axes is None else axes
    largest = 0.5 * scene.sizes.get("dmax", 0.0)
    grid = make_grid(
        axes, {}, bounds or {}, spacing, plane=setup.plane, cutoff=largest or math.inf,
        automatic=automatic_bounds(scene, largest), period=scene.periods, cells=True,
    )  # fmt: skip
    if loose := [a for a in grid.averaged if a not in scene.edges]:
        raise ValueError(
            f"cells reach through the box along {loose}, and the scene has no finite box there: name them in axes="
        )
    values = () if by is None else scene.groups(by, groups)
    task = _Cells(grid, setup, _depth(scene), by, values)
    phases = (1 + len(values),) if by is not None else ()
    shape = (*grid.sizes, *phases)
    fields = {name: row for name, row in _FIELDS.items() if "velocity" in ds or name not in _OF_MOTION}
    results = {name: ((*shape, *(3,) * rank), "float64") for name, (rank, _, _) in fields.items()}
    names = ["particle_id", "position", "diameter", "volume", "mass", *([by] if by else [])]
    names += [name for name in ("velocity", "frozen", *OF_STEP) if name in ds]
    found = map_over_time(ds, names, partial(_of_chunk, task), results, "cell-volumes", on_error)
    coords: dict[str, Any] = {name: given.copy() for name, given in scene.times.items()}
    length = units_in("m", setup.unit_system)
    for a, nodes in grid.coords.items():
        coords[a] = (a, nodes.to_numpy(), {"units": length, "long_name": f"position along {a}", "axis": a.upper()})
    if by is not None:
        coords["phase"] = ("phase", ["bulk", *map(str, values)], {"long_name": f"phase by {by}"})
    coords["component"] = list(COMPONENTS)
    dims = ("time", *grid.dims, *(("phase",) if by is not None else ()))
    data = {}
    for name, (rank, unit, text) in fields.items():
        about = {"units": units_in(unit, setup.unit_system), "long_name": text}
        data[name] = ((*dims, *("component",) * rank), found[name], about)
    result = storable(xr.Dataset(data, coords))
    result = with_phase_labels(result) if by is not None else result
    call = format_call("cell_volumes", {"spacing": spacing, "axes": axes, "by": by})
    return mark_skipped(result.assign_attrs(provenance(ds, call), sampling="cell"), found)


# rank, unit, name in words
_FIELDS = {
    "volume_fraction": (0, "1", "solid volume in the cell over its volume"),
    "void_fraction": (0, "1", "share of the cell between the grains"),
    "number_density": (0, "m^-3", "number of grains in a unit of volume, by their shares"),
    "density": (0, "kg m^-3", "mass of the grains in a unit of volume, by their shares"),
    "momentum_density": (1, "kg m^-2 s^-1", "momentum of the grains in a unit of volume, by their shares"),
    "velocity": (1, "m s^-1", "velocity of the grains, weighted by the mass inside"),
}


_OF_MOTION = ("momentum_density", "velocity")


def _depth(scene: Description) -> float:
    """Thickness of a scene of one layer, 1 in three dimensions; NaN where it is that of the box of each step."""
    depth = scene.layer_depth
    return math.nan if isinstance(depth, str) else 1.0 if depth is None else depth


def _of_chunk(task: _Cells, arrays: Mapping[str, NDArray]) -> dict[str, NDArray]:
    """Fields of one chunk of time."""
    grid, groups = task.grid, max(1, len(task.groups))
    steps = [_shares(task, groups, *step) for step in steps_in(arrays, task.setup.periodic)]
    sums = np.stack(steps)  # (time, groups, cells..., columns)
    if task.by is not None:
        sums = np.concatenate([sums.sum(axis=1, keepdims=True), sums], axis=1)
    sums = np.moveaxis(sums, 1, -2).reshape(len(sums), *grid.sizes, *(sums.shape[1:2] if task.by else ()), _COLUMNS)
    found = {
        "volume_fraction": sums[..., 1], "void_fraction": 1.0 - sums[..., 1], "number_density": sums[..., 0],
        "density": sums[..., 2],
    }  # fmt: skip
    if "velocity" in arrays:
        with np.errstate(invalid="ignore", divide="ignore"):
            found |= {"momentum_density": sums[..., 3:], "velocity": sums[..., 3:] / sums[..., 2:3]}
    return found


def _shares(task: _Cells, groups: int, frame: Any, lattice: Any, source: str) -> NDArray:
    """Return sums of one step per volume of a cell, (groups, nx, ny, nz, columns)."""
    grid, setup = task.grid, task.setup
    free = frame["frozen"] != 1 if "frozen" in frame else np.ones(len(frame["position"]), bool)
    some = {name: values[free] for name, values in frame.items()}
    phase = phase_of(some, task.by, task.groups, source)
    count, diameter, volume = free.sum(), some["diameter"], some["volume"]
    momentum = some["mass"][:, None] * some.get("velocity", np.zeros((count, 3)))
    values = np.column_stack([np.ones(count), volume, some["mass"], momentum])
    spheres = setup.dimension == 3 or np.allclose(volume, np.pi / 6 * diameter**3, rtol=_SPHERE, atol=0.0)
    across = next((k for k, a in enumerate(COMPONENTS) if a not in setup.plane), -1)
    step = np.array([grid.spacing.get(a, np.inf) for a in COMPONENTS])
    reach = [1.0 if np.isinf(size) else diameter.max(initial=0.0) // size + 3.0 for size in step]
    out = np.zeros((groups, *grid.shape, _COLUMNS))
    add_shares(
        np.ascontiguousarray(some["position"]), diameter / 2, values, phase, grid.lower, step, np.array(grid.shape),
        lattice.period, -1 if spheres else across, np.empty(int(math.prod(n + 1 for n in reach))), out,
    )  # fmt: skip
    lengths = [lattice.length(a) for a in grid.averaged]
    if setup.dimension == 2:
        lengths.append(lattice.length(COMPONENTS[across]) if math.isnan(task.depth) else task.depth)
    return np.asarray(out / math.prod([*lengths, *grid.spacing.values()]))
