"""Solid volume in the cells of a mesh: each grain's own volume, shared exactly among the cells that it overlaps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.analysis.by_phase import PhaseAnalysis
from xcg.common.messages import SceneError
from xcg.compiled.geometry import Cells, add_shares
from xcg.fields.grids.grid import make_grid, warn_beyond
from xcg.fields.layout import automatic_bounds
from xcg.fields.sums.nodes import Nodes
from xcg.scene.conform import takes_scene
from xcg.scene.lattice import Lattice
from xcg.scene.scene import Scene
from xcg.scene.schema import COMPONENTS, Frame, Variable
from xcg.steps.analysis import run
from xcg.steps.faults import OnError
from xcg.steps.labels import call_of, place_along

_SPHERE = 1e-6  # how far volumes may be from those of spheres of their diameters
_COLUMNS = 6  # number, volume, mass and momentum of each grain
_FIELDS = {
    "volume_fraction": Variable((), "1", "solid volume in the cell over its volume"),
    "void_fraction": Variable((), "1", "share of the cell between the grains"),
    "number_density": Variable((), "m^-3", "number of grains in a unit of volume, by their shares"),
    "density": Variable((), "kg m^-3", "mass of the grains in a unit of volume, by their shares"),
    "momentum_density": Variable(
        ("component",),
        "kg m^-2 s^-1",
        "momentum of the grains in a unit of volume, by their shares",
    ),
    "velocity": Variable(
        ("component",), "m s^-1", "velocity of the grains, weighted by the mass inside"
    ),
}


@takes_scene
def cell_volumes(
    scene: Scene,
    spacing: float | Mapping[str, float],
    *,
    axes: str | None = None,
    bounds: Mapping[str, Sequence[float]] | None = None,
    by: str | None = None,
    groups: Sequence[int] | None = None,
    on_error: OnError = "raise",
) -> xr.Dataset:
    """Share the volume of each grain among the cells of a mesh that it overlaps, exactly; lazy where the scene is.

    No kernel is chosen: a sphere counts in a cell by the part of it that lies inside, in closed
    form, so that the solid volume of all cells is that of the grains to rounding. This is what
    fluid solvers of coupled runs (CFD-DEM) ask for. Fields jump where grains leave cells; smooth
    fields and stress take a kernel, see `coarse_grain`.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with ``diameter`` and ``volume``. Discs (a scene of one layer whose volumes differ
        from spheres) are shared by their areas; other shapes as spheres of their diameter.
    spacing : float or mapping
        Size of the cells (m), for all axes or by axis. Periodic axes without bounds take the
        nearest that divides them.
    axes : str, optional
        Axes that are divided into cells, all of the scene by default; cells reach through the box
        along the others.
    bounds : mapping, optional
        First and last centre of the cells by axis (m), as in `coarse_grain`; by default cells cover
        all grains.
    by, groups, on_error
        As in `coarse_grain`.

    Returns
    -------
    xarray.Dataset
        On the centres of the cells, (time, axes, phase): ``volume_fraction``, ``void_fraction``,
        ``number_density`` (m-3, parts of grains counted by their share), ``density``, and, where
        the scene has velocities, ``momentum_density`` and ``velocity``, the mean weighted by the
        mass inside.

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
    scene.require(("diameter", "volume", "mass"), "cell_volumes")
    setup = scene.setup
    if scene.tilted:
        raise SceneError(
            "cell_volumes takes boxes with edges along x, y and z, and this one is tilted"
        )
    if scene.cylindrical:
        raise SceneError("cell_volumes takes cells along x, y and z, not about an axis")
    if axes is None:
        axes = setup.plane
    call = call_of("cell_volumes", {"spacing": spacing, "axes": axes, "by": by})
    largest = 0.5 * scene.sizes.get("dmax", 0.0)
    cells = make_grid(
        axes,
        {},
        bounds or {},
        spacing,
        plane=setup.plane,
        cutoff=largest or math.inf,
        automatic=automatic_bounds(scene, largest),
        period=scene.periods,
        cells=True,
    )
    if loose := [a for a in cells.averaged if a not in scene.edges]:
        raise ValueError(
            f"cells reach through the box along {loose}, and the scene has no finite box there: name them in axes="
        )
    analysis = _CellShares(cells, scene.layer_depth, by=by, groups=groups)
    return run(scene, analysis, call=call, on_error=on_error)


@dataclass(frozen=True, eq=False)
class _CellShares(PhaseAnalysis):
    """Volume, mass and momentum of the grains in each cell."""

    name = "cell_volumes"
    optional = ("velocity", "frozen")

    cells: Nodes
    depth: float | str | None

    def reads(self, scene: Scene) -> list[str]:
        """Return what is shared, and what the grains are grouped by."""
        return [*super().reads(scene), "diameter", "volume", "mass"]

    def rows(self, scene: Scene) -> dict[str, Variable]:
        """Return the fields on the cells, with velocity where the scene has one."""
        dims = self.cells.dims
        if self.by is not None:
            dims = (*dims, "phase")
        return {
            name: replace(row, dims=(*dims, *row.dims))
            for name, row in _FIELDS.items()
            if "velocity" in scene.columns or not row.dims
        }

    def coords(self, scene: Scene) -> dict[str, xr.Variable]:
        """Return the centres of the cells, and the phases."""
        system = self.setup.unit_system
        centres = {
            a: place_along(a, coord.to_numpy(), system) for a, coord in self.cells.coords.items()
        }
        return centres | super().coords(scene)

    def frame(self, frame: Frame, lattice: Lattice, source: str) -> dict[str, NDArray]:
        """Compute the fields of one step."""
        sums = self.with_bulk(self._sums(frame, lattice, source))
        sums = np.moveaxis(sums, 0, -2)
        if self.by is None:
            sums = sums[..., 0, :]
        sums = sums.reshape(*self.cells.sizes, *sums.shape[3:])
        results = {
            "volume_fraction": sums[..., 1],
            "void_fraction": 1.0 - sums[..., 1],
            "number_density": sums[..., 0],
            "density": sums[..., 2],
        }
        if "velocity" in frame:
            results["momentum_density"] = sums[..., 3:]
            with np.errstate(invalid="ignore", divide="ignore"):
                results["velocity"] = sums[..., 3:] / sums[..., 2:3]
        return results

    def _sums(self, frame: Frame, lattice: Lattice, source: str) -> NDArray:
        """Return sums of one step per volume of a cell, (groups, nx, ny, nz, columns)."""
        cells = self.cells
        some, phase = self.moving(frame, source)
        position = some["position"]
        diameter = some["diameter"]
        radius = diameter / 2
        for a in cells.fitted:
            k = COMPONENTS.index(a)
            warn_beyond(a, position[:, k], cells.lower[k], cells.upper[k], source, room=radius)
        volume = some["volume"]
        momentum = some["mass"][:, None] * some.get("velocity", np.zeros_like(position))
        values = np.column_stack([np.ones(len(position)), volume, some["mass"], momentum])
        across = -1  # spheres
        of_spheres = np.pi / 6 * diameter**3
        if self.setup.dimension == 2 and not np.allclose(volume, of_spheres, _SPHERE, atol=0.0):
            (across,) = {0, 1, 2} - set(self.setup.axes)
        size = np.array([cells.spacing.get(a, np.inf) for a in COMPONENTS])
        reach = diameter.max(initial=0.0) // size + 3.0
        out = np.zeros((self.phase_count, *cells.shape, _COLUMNS))
        add_shares(
            np.ascontiguousarray(position),
            radius,
            values,
            phase,
            Cells(cells.lower, size, np.array(cells.shape), lattice.period),
            across,
            np.empty(int((reach + 1).prod())),
            out,
        )
        lengths = [lattice.length(a) for a in cells.averaged]
        if isinstance(self.depth, str):
            lengths.append(lattice.length(self.depth))
        elif self.depth is not None:
            lengths.append(self.depth)
        return np.asarray(out / math.prod([*lengths, *cells.spacing.values()]))
