"""Summary that ``ds.cg`` shows of a scene, without reading it; rows on the origin of data, which results show, too."""

from __future__ import annotations

import html
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import xarray as xr

from xcg.common.messages import printable
from xcg.scene.conform import conform
from xcg.scene.contacts import walls_of
from xcg.scene.scene import Scene
from xcg.scene.schema import BOX, VARIABLES, units_in, variable
from xcg.scene.times import times_are_known

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
    edges = Scene(ds).edges
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
