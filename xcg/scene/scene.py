"""Scene: a Dataset in the form that tasks read, and what is known of it without reading lazy data."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Set
from functools import cached_property
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.compat import is_in_memory
from xcg.common.messages import SceneError, plain
from xcg.scene.lattice import Lattice
from xcg.scene.schema import BOX, COMPONENTS, PADDING, Frame, Setup, known_without_reading
from xcg.scene.sizes import MEASURES, SIZES, measure_frames, without_measures

# attributes that are the range of a variable, and all that follow from it
_RANGES = {"position": ("particle_lower", "particle_upper"), "diameter": ("dmin", "dmax")}
_OF_VARIABLES = {"position": _RANGES["position"], "diameter": SIZES}


class Scene:
    """Scene of one call: its Dataset, and what follows from it, found when it is asked for.

    Nothing is read, but the six numbers of the first box where a lazy box changes.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene, as `xcg.scene.conform.conform` returns it.
    made : mapping
        Further variables by name, which tasks make themselves.
    lag : int, optional
        Frames to the later one, in a scene of displacements.

    Attributes
    ----------
    columns : dict of xarray.Variable
        Variables by name, with those in `made`.
    tilted : bool
        Whether the edges of the box are not along x, y and z.
    cylindrical : bool
        Whether axes x, y, z belong to a cylindrical frame.
    setup : Setup
        Periodic axes, gravity, dimension, plane, thickness and unit system.
    """

    def __init__(
        self,
        ds: xr.Dataset,
        *,
        made: Mapping[str, xr.Variable] | None = None,
        lag: int | None = None,
    ) -> None:
        self.ds = ds
        self.lag = lag
        self.setup = Setup.of(ds.attrs)
        self.tilted = "lattice" in ds
        self.cylindrical = ds.attrs.get("frame") == "cylindrical"
        self.columns = {str(name): ds.variables[name] for name in ds.data_vars} | {**(made or {})}

    @property
    def rows(self) -> list[str]:
        """Names of the variables of particles and contacts."""
        of_rows = {"particle", "contact"}
        return [name for name, column in self.columns.items() if of_rows & {*column.dims}]

    # --- sizes and extent of the particles ---------------------------------------------------------

    @cached_property
    def measures(self) -> dict[str, Any]:
        """Sizes and extent that hold for the particles, by the names of attributes.

        Variables may have been replaced since they were measured. Those in memory are looked at:
        where grains of the first or the last step lie outside the extent, the extent of these steps
        is measured anew, and the sizes where diameters lie outside their range: positions say
        nothing of sizes. Attributes of lazy variables that were computed from others are left out.
        """
        ds = self.ds
        measures = {name: ds.attrs[name] for name in MEASURES if name in ds.attrs}
        present = [name for name in _OF_VARIABLES if name in ds]
        for name in present:
            if not known_without_reading(ds, name):
                for attr in _OF_VARIABLES[name]:
                    measures.pop(attr, None)
        ends = self._ends(("particle_id", *present, "mass"))
        outside = [
            name for name in present if not all(_within(name, frame, measures) for frame in ends)
        ]
        if outside:
            anew = measure_frames(ends)
            for name in outside:
                measures |= {attr: anew[attr] for attr in _OF_VARIABLES[name] if attr in anew}
        return measures

    def _ends(self, names: Sequence[str]) -> list[Frame]:
        """Return the variables in memory, of the particles of the first and of the last step."""
        arrays = {}
        for name in names:
            values = self.ds.variables.get(name)
            if values is not None and "time" in values.dims and is_in_memory(values):
                arrays[name] = values.transpose("time", "particle", ...).to_numpy()
        if "particle_id" not in arrays:
            return []
        frames = []
        count = self.ds.sizes["time"]
        for t in sorted({0, count - 1} & set(range(count))):
            held = arrays["particle_id"][t] != PADDING
            particles: Any = (
                slice(None) if held.all() else held
            )  # without a copy where they are all
            frames.append({name: values[t][particles] for name, values in arrays.items()})
        return frames

    def with_measures(self) -> Scene:
        """Return the scene with the sizes and the extent that hold for its particles as attributes."""
        return Scene(without_measures(self.ds).assign_attrs(self.measures))

    @cached_property
    def sizes(self) -> dict[str, float]:
        """Diameters of `xcg.scene.sizes.SIZES` that are known (m)."""
        return {name: float(self.measures[name]) for name in SIZES if name in self.measures}

    @cached_property
    def corners(self) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
        """Lowest and highest coordinates of the particles' centres (m); None where they are not known."""
        if not {"particle_lower", "particle_upper"} <= self.measures.keys():
            return None
        lowest = np.ravel(self.measures["particle_lower"]).tolist()
        highest = np.ravel(self.measures["particle_upper"]).tolist()
        return tuple(lowest), tuple(highest)

    @property
    def radius(self) -> float | None:
        """Distance (m) of the outermost particle of first and last step from the axis z; None where it is not known.

        Of a lazy scene it is that of the farthest corner of the particles' extent.
        """
        position = self.columns["position"]
        if is_in_memory(position):
            ends = position.transpose("time", "particle", "component")[[0, -1]].to_numpy()
            return float(np.nanmax(np.hypot(ends[..., 0], ends[..., 1])))
        if self.corners is None:
            return None
        far = np.abs(self.corners).max(axis=0)
        return float(np.hypot(far[0], far[1]))

    # --- box and layer -----------------------------------------------------------------------------

    @cached_property
    def edges(self) -> dict[str, tuple[float, float]]:
        """Edges of the box of the first step (m), along the axes where it is finite.

        Attributes hold a lazy box that does not change.
        """
        attrs = self.ds.attrs
        in_attributes = {"box_lower", "box_upper"} <= attrs.keys()
        box = self.columns.get("box")
        if box is not None and box.size and (box.chunks is None or not in_attributes):
            # "step", too
            first = box.isel({dim: 0 for dim in box.dims if dim not in ("component", "bound")})
            ends = first.transpose("component", "bound").to_numpy()
        elif in_attributes:
            ends = np.stack([attrs["box_lower"], attrs["box_upper"]], axis=1)
        else:
            return {}
        return {
            a: (float(low), float(high))
            for a, (low, high) in zip(COMPONENTS, ends, strict=True)
            if high - low < np.inf
        }

    @cached_property
    def periods(self) -> dict[str, float]:
        """Period of the first step along the periodic axes (m)."""
        edges = self.edges
        return {a: edges[a][1] - edges[a][0] for a in self.setup.periodic if a in edges}

    @cached_property
    def _lasting(self) -> NDArray:
        """Return True along each axis (3,) where the box is the same in all steps.

        A lazy box is not read, as attributes hold a box that lasts.
        """
        box = [(self.ds.variables[n], row) for n, row in BOX.items() if n in self.ds]
        if not box or box[0][0].chunks is not None:
            return np.full(3, "box_lower" in self.ds.attrs and not self.tilted)
        lasting = np.full(3, True)
        for values, row in box:
            steps = values.transpose("time", *row.dims).to_numpy()
            lasting &= (steps == steps[:1]).all(axis=(0, 2))
        return lasting

    @property
    def box_lasts(self) -> bool:
        """Return True if the box is the same in all steps."""
        return bool(self._lasting.all())

    @cached_property
    def lasting_periods(self) -> tuple[float, float, float]:
        """Period along x, y, z (m); infinite unless it is the same in all steps."""
        if self.tilted:
            return self._periods_of_lattice()
        x, y, z = (
            self.periods.get(a, np.inf) if lasts else np.inf
            for a, lasts in zip(COMPONENTS, self._lasting, strict=True)
        )
        return x, y, z

    def _periods_of_lattice(self) -> tuple[float, float, float]:
        """Return `lasting_periods` of a tilted box."""
        x, y, z = np.full(3, np.inf)
        if self.box_lasts and self.setup.periodic:
            first = {
                n: self.ds[n].transpose("time", ...).to_numpy()[0] for n in BOX if n in self.ds
            }
            x, y, z = Lattice.of(first, self.setup.periodic).axis_periods.tolist()
        return x, y, z

    @property
    def layer_depth(self) -> float | str | None:
        """Thickness of a layer (m), or the axis whose box extent it is; None in three dimensions.

        Raises
        ------
        SceneError
            If it is not known.
        """
        setup = self.setup
        if setup.dimension == 3:
            return None
        if setup.thickness is not None:
            return setup.thickness
        (across,) = set(COMPONENTS) - set(setup.plane)
        if across in self.edges:
            return across
        if "dmax" in self.sizes:
            return self.sizes["dmax"]
        raise SceneError(
            "a one-layer scene needs its thickness: give thickness= when opening it, or a box that is finite across it"
        )

    @property
    def layer(self) -> tuple[int, float, float] | None:
        """Axis across a scene of one layer, and the edges of the layer (m); None in three dimensions."""
        depth = self.layer_depth
        if depth is None:
            return None
        k = next(k for k, a in enumerate(COMPONENTS) if a not in self.setup.plane)
        if isinstance(depth, str):
            return k, *self.edges[depth]
        middle = 0.0
        if self.corners is not None:
            low, high = self.corners
            middle = (low[k] + high[k]) / 2
        return k, middle - depth / 2, middle + depth / 2

    # --- groups of particles -----------------------------------------------------------------------

    def values(self, by: str) -> list[int]:
        """Return the values of an integer variable of the particles, sorted; none where they are not known."""
        column = self.columns[by]
        values: Any = []
        if is_in_memory(column):
            ids = self.columns["particle_id"]
            values = column.transpose(*ids.dims).to_numpy()[ids.to_numpy() >= 0]
        elif known_without_reading(self.ds, by):
            values = self.ds.attrs.get(f"{by}_values", [])
        return np.unique(values).tolist()

    def groups(self, by: str | None, groups: Sequence[int] | None = None) -> tuple[int, ...]:
        """Return the values of an integer variable of the particles, sorted: given, or known without reading.

        None for `by` has none.

        Raises
        ------
        ValueError
            If the variable does not exist, its values are not known, or values are given without
            it.
        """
        if by is None:
            if groups is not None:
                raise ValueError(
                    f"groups={groups!r} are the values of an integer variable of the particles: say which with by="
                )
            return ()
        whole = [
            name
            for name, column in self.columns.items()
            if column.dtype.kind in "iu" and "particle" in column.dims
        ]
        if by not in whole:
            shown = [name for name in whole if name != "particle_id"]
            raise ValueError(
                f"by={by!r}: expected an integer variable of the particles; this scene has "
                f"{', '.join(shown) or 'none'}; ds.cg.assign_phases(edges=[...]) makes 'phase' from diameters"
            )
        values = np.atleast_1d(self.values(by) if groups is None else groups)
        if not values.size:
            raise ValueError(
                f"by={by!r}: its values are not known without reading the series; pass groups= with all that occur"
            )
        if values.dtype.kind not in "iuf" or (values % 1 != 0).any():
            raise ValueError(f"groups={plain(groups)}: expected whole numbers, values of {by!r}")
        return tuple(np.unique(values.astype("int64")).tolist())

    # --- variables that calls need -----------------------------------------------------------------

    def require(self, names: Iterable[str], purpose: str, instead: str = "") -> None:
        """Raise SceneError unless this is a scene and holds these variables; the message lists all that are missing.

        `instead` ends the advice with what can be asked for without them.
        """
        needed = ("position", "particle_id", *names)
        missing = {n for n in needed if n not in self.columns and n not in self.ds.coords}
        if missing:
            shown = ", ".join(self.columns) or "nothing"
            raise SceneError(
                f"{purpose} needs {sorted(missing)}: {_way_to(missing, self.columns)}{instead} "
                f"(this Dataset holds {shown})"
            )

    def require_ids(self, purpose: str) -> None:
        """Raise SceneError for a scene whose rows may be other particles in every step."""
        if "rows" in self.columns["particle_id"].attrs:
            raise SceneError(
                f"{purpose} follows particles by their ids, and the data hold none: rows may be other "
                "particles in every step. Map the column of ids in xcg.open_scene, "
                "names={'...': 'particle_id'}, or give particle_id= to xcg.scene_from_arrays; if rows "
                "are the same particles in all steps, say so by del ds.particle_id.attrs['rows']"
            )


def _within(name: str, frame: Frame, ranges: Mapping[Any, Any]) -> bool:
    """Return whether positions or diameters of a frame lie inside the range of them that is known."""
    values = frame.get(name)
    if values is None or not len(values):
        return True
    low, high = _RANGES[name]
    if low not in ranges:
        return False
    lower, upper = (np.ravel(ranges[end]) for end in (low, high))
    small = 1e-9 * np.abs([lower, upper]).max()
    inside = zip(np.atleast_2d(values.T), lower - small, upper + small, strict=True)
    return all(x.min() >= least and x.max() <= most for x, least, most in inside)


def _way_to(missing: Set[str], present: Iterable[str]) -> str:
    """Return what to do where these variables are missing, as the middle of a message."""
    if {"position", "particle_id"} <= missing:
        return "call it on a scene, from xcg.open_scene or xcg.scene_from_arrays, not on a result or another Dataset"
    if missing == {"contact_force"}:
        return "ds.cg.find_contacts(k_n=...) estimates forces, and contacts= of xcg.open_scene reads them"
    ways = []
    if any(name.startswith("contact_") for name in missing):
        stiffness = "k_n=..." if "contact_force" in missing else ""
        ways.append(
            "contacts= to xcg.open_scene (contact_i=, contact_j=, contact_force= to xcg.scene_from_arrays), or call "
            f"ds.cg.find_contacts({stiffness}) first"
        )
    no_sizes = not {"diameter", "volume"} & set(present)
    lacks_size = no_sizes and missing & {"mass", "volume", "diameter", "moment_of_inertia"}
    if lacks_size and "half_axis_x" in present:
        return "ds.cg.derive_superquadric(density=...) gives them to ellipsoids and superquadrics, from their half-axes"
    if lacks_size:
        return (
            "the files hold no sizes of the grains. Map their column in xcg.open_scene, names={'...': 'radius'} or "
            "'diameter', with density=; for grains of one size d, d = xr.full_like(ds.position[..., 0], 0.001) gives "
            "ds.assign(diameter=d, volume=np.pi / 6 * d**3, mass=2500 * np.pi / 6 * d**3)"
        )
    if missing & {"mass", "density", "moment_of_inertia"}:
        ways.append("density= to xcg.open_scene or xcg.scene_from_arrays")
    if others := sorted(
        missing & {"position", "particle_id", "velocity", "diameter", "angular_velocity"}
    ):
        way = f"{', '.join(f'{name}=' for name in others)} to xcg.scene_from_arrays, or files that hold them"
        ways.append(
            way + ", or call ds.cg.derive('velocity') on several steps" * ("velocity" in missing)
        )
    if "director" in missing:
        ways.append("quaternions to ds.cg.derive_director()")
    return f"give {', and '.join(ways) or 'them to xcg.open_scene or xcg.scene_from_arrays'}"
