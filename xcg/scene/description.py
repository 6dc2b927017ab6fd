"""Description of a scene, found once and without reading lazy data: for planning, labels, messages, and `ds.cg`."""

from __future__ import annotations

import html
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.compat import is_in_memory
from xcg.common.messages import SceneError, plain, printable
from xcg.scene.conform import conform
from xcg.scene.contacts import walls_of
from xcg.scene.frame import SIZES, times_are_known, with_measures
from xcg.scene.lattice import Lattice
from xcg.scene.schema import (
    BOX,
    COMPONENTS,
    VARIABLES,
    Setup,
    known_without_reading,
    units_in,
    variable,
)


@dataclass(frozen=True)
class Column:
    """Variable of a scene as its Dataset declares it: dimensions, NumPy's letter of its type, unit, name in words."""

    dims: tuple[str, ...]
    kind: str
    units: str | None
    long_name: str | None


@dataclass(frozen=True)
class Description:
    """Description of a scene. Equal for a scene in memory and the same one in chunks.

    Attributes
    ----------
    columns : mapping
        Variables by name.
    steps : int
        Number of steps.
    setup : Setup
        Periodic axes, gravity, dimension, plane and thickness, unit system.
    edges : mapping
        Edges of the box of the first step (m), along the axes where it is finite.
    lasting_periods : tuple of float
        Period along x, y, z (m); infinite unless it is the same in all steps.
    box_lasts : bool
        Whether the box is the same in all steps.
    tilted : bool
        Whether the edges of the box are not along x, y and z.
    sizes : mapping
        Diameters of `xcg.scene.frame.SIZES` that are known (m).
    corners : tuple, optional
        Lowest and highest coordinates of the particles' centres (m), where they are known.
    position_known : bool
        Whether `position` is in memory, or unchanged since it was measured.
    values : mapping
        Values of the integer variable that divides the particles into groups, where they are known.
    cylindrical : bool
        Whether axes x, y, z belong to a cylindrical frame.
    radius : float, optional
        Distance of the outermost particle from the axis of that frame (m), where it is known.
    lag : int, optional
        Frames to the later one, in a scene of displacements.
    counts : mapping
        Largest number of particles and of contacts in a step, as far as it is known without reading.
    attrs, times : mapping
        Attributes, and coordinates along time, which results have, too.
    """

    columns: Mapping[str, Column]
    steps: int
    setup: Setup
    edges: Mapping[str, tuple[float, float]]
    lasting_periods: tuple[float, float, float]
    box_lasts: bool
    tilted: bool
    sizes: Mapping[str, float]
    corners: tuple[tuple[float, ...], tuple[float, ...]] | None
    position_known: bool
    values: Mapping[str, tuple[int, ...]]
    cylindrical: bool
    radius: float | None
    lag: int | None
    counts: Mapping[str, int]
    attrs: Mapping[str, Any] = field(compare=False, repr=False)
    times: Mapping[str, xr.Variable] = field(compare=False, repr=False)

    @cached_property
    def rows(self) -> list[str]:
        """Names of the variables of particles and contacts."""
        return [
            name
            for name, column in self.columns.items()
            if {"particle", "contact"} & set(column.dims)
        ]

    @cached_property
    def periods(self) -> dict[str, float]:
        """Period of the first step along the periodic axes (m)."""
        return {
            a: self.edges[a][1] - self.edges[a][0] for a in self.setup.periodic if a in self.edges
        }

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
            if column.kind in "iu" and "particle" in column.dims
        ]
        if by not in whole:
            shown = [name for name in whole if name != "particle_id"]
            raise ValueError(
                f"by={by!r}: expected an integer variable of the particles; this scene has "
                f"{', '.join(shown) or 'none'}; ds.cg.assign_phases(edges=[...]) makes 'phase' from diameters"
            )
        if groups is None:
            groups = self.values.get(by, ())
        values = np.atleast_1d(groups)
        if not values.size:
            raise ValueError(
                f"by={by!r}: its values are not known without reading the series; pass groups= with all that occur"
            )
        if values.dtype.kind not in "iuf" or (values % 1 != 0).any():
            raise ValueError(f"groups={plain(groups)}: expected whole numbers, values of {by!r}")
        return tuple(np.unique(values.astype("int64")).tolist())


def describe(ds: xr.Dataset, by: str | None = None) -> Description:
    """Describe a scene that was brought to its form by `xcg.scene.conform`, with the values of the variable `by`.

    Nothing is read, but the six numbers of the first box where a lazy box changes.
    """
    ds = with_measures(ds)
    edges = _edges(ds)
    setup = Setup.make(
        periodic=ds.attrs.get("periodic", ""),
        gravity=ds.attrs.get("gravity"),
        dimension=int(ds.attrs.get("dimension", 3)),
        plane=ds.attrs.get("plane"),
        thickness=ds.attrs.get("thickness"),
        units=ds.attrs.get("unit_system"),
    )
    columns = {}
    lasts, periods = _what_lasts(ds, setup, edges)
    for name in map(str, ds.data_vars):
        given = ds.variables[name]
        texts = [given.attrs.get(key) for key in ("units", "long_name")]
        units, long_name = (text if text is None else str(text) for text in texts)
        dims = tuple(map(str, given.dims))
        columns[name] = Column(dims, given.dtype.kind, units, long_name)
    corners = None
    if {"particle_lower", "particle_upper"} <= ds.attrs.keys():
        lowest, highest = (np.ravel(ds.attrs[f"particle_{end}"]) for end in ("lower", "upper"))
        corners = (tuple(lowest.tolist()), tuple(highest.tolist()))
    cylindrical = ds.attrs.get("frame") == "cylindrical"
    return Description(
        columns=columns,
        steps=ds.sizes.get("time", 1),
        setup=setup,
        edges=edges,
        lasting_periods=periods,
        box_lasts=lasts,
        tilted="lattice" in ds,
        sizes={name: float(ds.attrs[name]) for name in SIZES if name in ds.attrs},
        corners=corners,
        position_known="position" in ds and known_without_reading(ds, "position"),
        values=_values(ds, by),
        cylindrical=cylindrical,
        radius=_largest_radius(ds) if cylindrical else None,
        lag=ds.attrs.get("lag"),
        counts={row: ds.sizes.get(row, 0) for row in ("particle", "contact")},
        attrs=ds.attrs,
        times={name: ds.variables[name] for name in ("time", "step") if name in ds.coords},
    )


def _values(ds: xr.Dataset, by: str | None) -> dict[str, tuple[int, ...]]:
    """Values of an integer variable of the particles: those in memory, or the attributes that were measured."""
    if by is None or by not in ds:
        return {}
    if ds[by].dtype.kind not in "iu" or "particle" not in ds[by].dims:
        return {}
    if is_in_memory(ds[by].variable):
        ids = ds["particle_id"]
        values = ds[by].transpose(*ids.dims).to_numpy()[ids.to_numpy() >= 0]
    elif known_without_reading(ds, by):
        values = ds.attrs.get(f"{by}_values", [])
    else:
        return {}
    return {by: tuple(np.unique(values).tolist())}


def _edges(ds: xr.Dataset) -> dict[str, tuple[float, float]]:
    """Edges of the first box: of one in memory; of a lazy one the attributes, which hold a box that does not change."""
    in_attributes = {"box_lower", "box_upper"} <= ds.attrs.keys()
    if "box" in ds and ds["box"].size and (ds["box"].chunks is None or not in_attributes):
        given = ds.variables["box"]
        # "step", too
        first = given.isel({dim: 0 for dim in given.dims if dim not in ("component", "bound")})
        box = first.transpose("component", "bound").to_numpy()
    elif in_attributes:
        box = np.stack([ds.attrs["box_lower"], ds.attrs["box_upper"]], axis=1)
    else:
        return {}
    return {
        a: (float(low), float(high))
        for a, (low, high) in zip(COMPONENTS, box, strict=True)
        if high - low < np.inf
    }


def _what_lasts(
    ds: xr.Dataset, setup: Setup, edges: Mapping[str, tuple[float, float]]
) -> tuple[bool, tuple[float, float, float]]:
    """Return whether the box is the same in all steps, and the period along each axis, infinite unless that is.

    A lazy box is not read, as attributes hold a box that lasts.
    """
    if "box" in ds and ds.variables["box"].chunks is None:
        box = {
            n: ds.variables[n].transpose("time", *row.dims).to_numpy()
            for n, row in BOX.items()
            if n in ds
        }
        same = np.all([(steps == steps[:1]).all(axis=(0, 2)) for steps in box.values()], axis=0)
        if "lattice" in ds:
            x, y, z = np.full(3, np.inf)
            if same.all() and setup.periodic:
                first = {name: steps[0] for name, steps in box.items()}
                x, y, z = Lattice.of(first, setup.periodic).axis_periods.tolist()
            return bool(same.all()), (x, y, z)
    else:
        same = np.full(3, "box_lower" in ds.attrs and "lattice" not in ds)
    periods = dict.fromkeys(COMPONENTS, np.inf)
    for a, lasts in zip(COMPONENTS, same, strict=True):
        if lasts and a in setup.periodic and a in edges:
            low, high = edges[a]
            periods[a] = high - low
    return bool(same.all()), (periods["x"], periods["y"], periods["z"])


def _largest_radius(ds: xr.Dataset) -> float | None:
    """Distance from the axis z of the outermost grain of the first and last step; of the corners of a lazy scene."""
    position = ds["position"]
    if is_in_memory(position.variable):
        ends: NDArray = position.transpose("time", "particle", "component")[[0, -1]].to_numpy()
        return float(np.nanmax(np.hypot(ends[..., 0], ends[..., 1])))
    if "particle_lower" not in ds.attrs:
        return None
    far = np.maximum(np.abs(ds.attrs["particle_lower"]), np.abs(ds.attrs["particle_upper"]))
    return float(np.hypot(far[0], far[1]))


# --- summary that ds.cg shows ----------------------------------------------------------------------------


_WIDTH = 11  # of labels


@dataclass(frozen=True)
class Summary:
    """A title and rows of (label, text). Rows without text are left out; names in files are made printable."""

    title: str
    rows: tuple[tuple[str, str], ...]

    @classmethod
    def of(cls, title: str, rows: Iterable[tuple[str, str]]) -> Summary:
        """Make one of what there is to say."""
        return cls(
            printable(title), tuple((label, printable(text)) for label, text in rows if text)
        )

    def __str__(self) -> str:
        return "\n".join(
            [self.title, *(f"  {label + ':':{_WIDTH}s}{text}" for label, text in self.rows)]
        )

    def html(self) -> str:
        """Write a table, for notebooks."""
        style = "text-align: left; vertical-align: top"
        rows = "".join(
            f'<tr><th style="{style}">{html.escape(label)}</th><td style="{style}">{html.escape(text)}</td></tr>'
            for label, text in self.rows
        )
        return f"<div><p><b>{html.escape(self.title)}</b></p><table>{rows}</table></div>"


def summary_of_scene(ds: xr.Dataset) -> Summary:
    """Return a summary of what a scene, or a part of one, holds and lacks, without reading it."""
    try:
        return _summary(conform(ds))
    except ValueError as error:
        return Summary.of(
            f"a part of a scene: {error}", [("variables", ", ".join(map(str, ds.data_vars)))]
        )


def _summary(ds: xr.Dataset) -> Summary:
    # also by other dimensions
    steps = ds["time"].size if "time" in ds.coords else ds.sizes.get("time", 1)
    particles = ds.sizes.get("particle", 1)
    contacts = 0
    if "contact_i" in ds:
        contacts = ds.sizes.get("contact", 1)
    # one order, whatever that of a file is
    names = [name for name in VARIABLES if name in ds.variables and name not in ds.dims]
    names += [n for n in map(str, ds.data_vars) if n not in VARIABLES and n not in BOX]
    missing = [name for name in ("velocity", "diameter", "mass", "contact_force") if name not in ds]
    sizes = ", ".join(
        f"{k} = {ds.attrs[k]:.6g}" for k in ("dmin", "d50", "d43", "dmax") if k in ds.attrs
    )
    return Summary.of(
        f"scene of {steps} step{'s' * (steps != 1)} with up to {particles} particles and {contacts} contacts",
        [
            *rows_of_origin(ds),
            *(
                (f"{dim}s", ", ".join(n for n in names if variable(n).dims[0] == dim) or "none")
                for dim in ("particle", "contact")
            ),
            ("missing", ", ".join(missing) or "nothing"),
            ("walls", ", ".join(f"{name} ({number})" for name, number in walls_of(ds).items())),
            ("sides", _SIDES.get(str(ds.attrs.get("sides")), "")),
            ("sizes", sizes or "not measured"),
            ("box", _box(ds)),
            (
                "periodic",
                f"{ds.attrs.get('periodic') or 'no axis'}; dimension {ds.attrs.get('dimension', 3)}",
            ),
        ],
    )


_SIDES = {
    "mean": "contacts listed from both sides are one, with the mean of both",
    "first": "contacts listed from both sides are one, as the first row has it",
    "separate": "contacts listed from both sides, with forces not quite opposite, are two",
}


def rows_of_origin(ds: xr.Dataset) -> list[tuple[str, str]]:
    """Rows on where data come from and what holds for all of them: engine, files, times, gravity, units."""
    attrs = ds.attrs
    system = attrs.get("unit_system")
    gravity = ""
    if attrs.get("gravity") is not None:
        pull = ", ".join(f"{g:.6g}" for g in np.atleast_1d(attrs["gravity"]))
        unit = units_in("m s^-2", system or "SI").removesuffix("1")
        gravity = f"({pull}) {unit}".rstrip()
    skipped = ""
    if attrs.get("skipped_files"):
        skipped = f"{len(str(attrs['skipped_files']).splitlines())} files"
    units = {None: "", "SI": "SI"}.get(system, f"{system}: scaled numbers, without units")
    if "assumed_units" in attrs:
        units += " (assumed: the files do not name them)"
    return [
        ("engine", str(attrs.get("engine", ""))),
        ("files", str(attrs.get("files", "")).replace("\n", "; ")),
        ("unread", str(attrs.get("not_read", "")).replace("\n", "; ")),
        ("skipped", skipped),
        ("forces", str(attrs.get("estimated_forces", ""))),
        ("time", _times(ds)),
        ("gravity", gravity),
        ("units", units),
    ]


def _times(ds: xr.Dataset) -> str:
    """First and last time."""
    if "time" not in ds.coords or not ds["time"].size or ds["time"].dtype.kind not in "iuf":
        return ""
    times = np.atleast_1d(ds["time"].to_numpy())
    unit = str(ds["time"].attrs.get("units", "")).removesuffix("1")
    text = f"{times[0]:g}"
    if len(times) > 1:
        text += f" to {times[-1]:g}"
    text += f" {unit}"
    if not times_are_known(ds):
        text += "(numbers of steps, times are not known)"
    return text.rstrip()


def _box(ds: xr.Dataset) -> str:
    """Edges of the box where they are known without reading."""
    if "box" in ds and ds["box"].chunks is not None and "box_lower" not in ds.attrs:
        return "changes with time"
    edges = describe(ds).edges
    unit = units_in("m", ds.attrs.get("unit_system", "SI")).removesuffix("1")
    parts = [f"{a} {low:.6g} to {high:.6g}" for a, (low, high) in edges.items()]
    if "lattice" in ds:
        parts.append("tilted")
    if "lattice_velocity" in ds:
        parts.append("with images that move")
    if not parts:
        return "none"
    text = f"{', '.join(parts)} {unit}".rstrip()
    if "box" in ds and "box_lower" not in ds.attrs and ds["box"].sizes.get("time", 1) > 1:
        text += " (first step)"
    return text
