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
        if setup.dimension == 3 or setup.thickness is not None:
            return setup.thickness if setup.dimension == 2 else None
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
        middle = 0.0 if self.corners is None else (self.corners[0][k] + self.corners[1][k]) / 2
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
        found = np.atleast_1d(self.values.get(by, ()) if groups is None else groups)
        if not found.size:
            raise ValueError(
                f"by={by!r}: its values are not known without reading the series; pass groups= with all that occur"
            )
        if found.dtype.kind not in "iuf" or (found % 1 != 0).any():
            raise ValueError(f"groups={plain(groups)}: expected whole numbers, values of {by!r}")
        return tuple(np.unique(found.astype("int64")).tolist())


def describe(ds: xr.Dataset, by: str | None = None) -> Description:
    """Describe a scene that was brought to its form by `xcg.scene.conform`, with the values of the variable `by`.

    Nothing is read, but the six numbers of the first box where a lazy box changes.
    """
    ds = with_measures(ds)
    gravity = ds.attrs.get("gravity")
    edges = _edges(ds)
    setup = Setup.make(
        periodic=ds.attrs.get("periodic", ""),
        gravity=None if gravity is None else np.asarray(gravity, float).tolist(),
        dimension=int(ds.attrs.get("dimension", 3)),
        plane=ds.attrs.get("plane"),
        thickness=ds.attrs.get("thickness"),
        units=ds.attrs.get("unit_system"),
    )
    columns = {}
    lasts, periods = _what_lasts(ds, setup, edges)
    for name in map(str, ds.data_vars):
        given = ds.variables[name]
        texts = [
            None if (text := given.attrs.get(key)) is None else str(text)
            for key in ("units", "long_name")
        ]
        columns[name] = Column(tuple(map(str, given.dims)), given.dtype.kind, *texts)
    corners = [
        tuple(np.ravel(ds.attrs[end]).tolist())
        for end in ("particle_lower", "particle_upper")
        if end in ds.attrs
    ]
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
        corners=(corners[0], corners[1]) if len(corners) == 2 else None,
        position_known="position" in ds and known_without_reading(ds, "position"),
        values={} if by is None else _values(ds, by),
        cylindrical=cylindrical,
        radius=_largest_radius(ds) if cylindrical else None,
        lag=ds.attrs.get("lag"),
        attrs=ds.attrs,
        times={name: ds.variables[name] for name in ("time", "step") if name in ds.coords},
    )


def _values(ds: xr.Dataset, by: str) -> dict[str, tuple[int, ...]]:
    """Values of an integer variable of the particles: those in memory, or the attributes that were measured."""
    if by not in ds or ds[by].dtype.kind not in "iu" or "particle" not in ds[by].dims:
        return {}
    if is_in_memory(ds[by].variable):
        valid = ds["particle_id"].to_numpy() >= 0
        return {
            by: tuple(
                np.unique(ds[by].transpose(*ds["particle_id"].dims).to_numpy()[valid]).tolist()
            )
        }
    return (
        {by: tuple(np.ravel(ds.attrs.get(f"{by}_values", [])).tolist())}
        if known_without_reading(ds, by)
        else {}
    )


def _edges(ds: xr.Dataset) -> dict[str, tuple[float, float]]:
    """Edges of the first box: of one in memory; of a lazy one the attributes, which hold a box that does not change."""
    box = None
    lower = ds.attrs.get("box_lower")
    upper = ds.attrs.get("box_upper")
    given = ds.variables["box"] if "box" in ds else None
    if (
        given is not None
        and given.size
        and (given.chunks is None or lower is None or upper is None)
    ):
        # "step", too
        first = given.isel({dim: 0 for dim in given.dims if dim not in ("component", "bound")})
        box = first.transpose("component", "bound").to_numpy()
    elif lower is not None and upper is not None:
        box = np.stack([lower, upper], axis=1)
    if box is None:
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
    lasting = [
        a
        for a, lasts in zip(COMPONENTS, same, strict=True)
        if lasts and a in setup.periodic and a in edges
    ]
    x, y, z = (edges[a][1] - edges[a][0] if a in lasting else np.inf for a in COMPONENTS)
    return bool(same.all()), (x, y, z)


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
    particles, contacts = (ds.sizes.get(dim, 1) for dim in ("particle", "contact"))
    contacts = contacts if "contact_i" in ds else 0
    # one order, whatever that of a file is
    there = [
        name
        for name in dict.fromkeys([*VARIABLES, *map(str, ds.variables)])
        if name in ds.variables
    ]
    names = {
        dim: [n for n in there if n not in BOX and variable(n).dims[0] == dim] for dim in _ROWS
    }
    own = {
        dim: [n for n in names[dim] if n not in ds.dims and (n in ds.data_vars or n == dim + "_id")]
        for dim in _ROWS
    }
    missing = [name for name in ("velocity", "diameter", "mass", "contact_force") if name not in ds]
    sizes = ", ".join(
        f"{k} = {ds.attrs[k]:.6g}" for k in ("dmin", "d50", "d43", "dmax") if k in ds.attrs
    )
    return Summary.of(
        f"scene of {steps} step{'s' * (steps != 1)} with up to {particles} particles and {contacts} contacts",
        [
            *rows_of_origin(ds),
            *((f"{dim}s", ", ".join(own[dim]) or "none") for dim in _ROWS),
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


_ROWS = ("particle", "contact")
_SIDES = {
    "mean": "contacts listed from both sides are one, with the mean of both",
    "first": "contacts listed from both sides are one, as the first row has it",
    "separate": "contacts listed from both sides, with forces not quite opposite, are two",
}


def rows_of_origin(ds: xr.Dataset) -> list[tuple[str, str]]:
    """Rows on where data come from and what holds for all of them: engine, files, times, gravity, units."""
    gravity = ds.attrs.get("gravity")
    system = ds.attrs.get("unit_system")
    skipped = str(ds.attrs.get("skipped_files", ""))
    pull = "" if gravity is None else ", ".join(f"{g:.6g}" for g in np.atleast_1d(gravity))
    unit = units_in("m s^-2", system or "SI").removesuffix("1")
    assumed = " (assumed: the files do not name them)" if "assumed_units" in ds.attrs else ""
    return [
        ("engine", str(ds.attrs.get("engine", ""))),
        ("files", str(ds.attrs.get("files", "")).replace("\n", "; ")),
        ("ignored", str(ds.attrs.get("ignored_columns", "")).replace("\n", "; ")),
        ("skipped", f"{len(skipped.splitlines())} files" if skipped else ""),
        ("forces", str(ds.attrs.get("estimated_forces", ""))),
        ("time", _times(ds)),
        ("gravity", f"({pull}) {unit}".rstrip() if pull else ""),
        (
            "units",
            {None: "", "SI": "SI"}.get(system, f"{system}: scaled numbers, without units")
            + assumed,
        ),
    ]


def _times(ds: xr.Dataset) -> str:
    """First and last time."""
    if "time" not in ds.coords or not ds["time"].size or ds["time"].dtype.kind not in "iuf":
        return ""
    times = np.atleast_1d(ds["time"].to_numpy())
    unit = str(ds["time"].attrs.get("units", "")).removesuffix("1")
    text = f"{times[0]:g} to {times[-1]:g} {unit}" if len(times) > 1 else f"{times[0]:g} {unit}"
    if not times_are_known(ds):
        text += "(numbers of steps, times are not known)"
    return text.rstrip()


def _box(ds: xr.Dataset) -> str:
    """Edges of the box where they are known without reading."""
    if "box" in ds and ds["box"].chunks is not None and "box_lower" not in ds.attrs:
        return "changes with time"
    edges = describe(ds).edges
    unit = units_in("m", ds.attrs.get("unit_system", "SI")).removesuffix("1")
    text = ", ".join(
        f"{a} {edges[a][0]:.6g} to {edges[a][1]:.6g}" for a in COMPONENTS if a in edges
    )
    text += ", tilted" * ("lattice" in ds) + ", with images that move" * ("lattice_velocity" in ds)
    changes = "box" in ds and "box_lower" not in ds.attrs and ds["box"].sizes.get("time", 1) > 1
    return f"{text} {unit}".rstrip() + (" (first step)" if changes else "") if text else "none"
