"""Summary that `ds.cg` shows: a title and rows of (label, text), written as text and as HTML."""

from __future__ import annotations

import html
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import xarray as xr

from xcg.common.messages import printable
from xcg.scene.description import describe
from xcg.scene.schema import BOX, COMPONENTS, VARIABLES, units_in, variable
from xcg.scene.walls import walls_of

_WIDTH = 11  # of labels


@dataclass(frozen=True)
class Summary:
    """A title and rows of (label, text). Rows without text are left out; names in files are made printable."""

    title: str
    rows: tuple[tuple[str, str], ...]

    @classmethod
    def of(cls, title: str, rows: Iterable[tuple[str, str]]) -> Summary:
        """Make one of what there is to say."""
        return cls(printable(title), tuple((label, printable(text)) for label, text in rows if text))

    def __str__(self) -> str:
        return "\n".join([self.title, *(f"  {label + ':':{_WIDTH}s}{text}" for label, text in self.rows)])

    def html(self) -> str:
        """Write a table, for notebooks."""
        style = "text-align: left; vertical-align: top"
        rows = "".join(
            f'<tr><th style="{style}">{html.escape(label)}</th><td style="{style}">{html.escape(text)}</td></tr>'
            for label, text in self.rows
        )
        return f"<div><p><b>{html.escape(self.title)}</b></p><table>{rows}</table></div>"


def summary_of_scene(ds: xr.Dataset) -> Summary:
    """Return a summary of what a scene holds and lacks, without reading it."""
    steps = ds["time"].size if "time" in ds.coords else ds.sizes.get("time", 1)  # also by other dimensions
    particles, contacts = (ds.sizes.get(dim, 1) for dim in ("particle", "contact"))
    contacts = contacts if "contact_i" in ds else 0
    # one order, whatever that of a file is
    there = [name for name in dict.fromkeys([*VARIABLES, *map(str, ds.variables)]) if name in ds.variables]
    names = {dim: [n for n in there if n not in BOX and variable(n).dims[0] == dim] for dim in _ROWS}
    own = {
        dim: [n for n in names[dim] if n not in ds.dims and (n in ds.data_vars or n == dim + "_id")] for dim in _ROWS
    }
    missing = [name for name in ("velocity", "diameter", "mass", "contact_force") if name not in ds]
    sizes = ", ".join(f"{k} = {ds.attrs[k]:.6g}" for k in ("dmin", "d50", "d43", "dmax") if k in ds.attrs)
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
            ("periodic", f"{ds.attrs.get('periodic') or 'no axis'}; dimension {ds.attrs.get('dimension', 3)}"),
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
    system, skipped = ds.attrs.get("unit_system"), str(ds.attrs.get("skipped_files", ""))
    pull = "" if gravity is None else ", ".join(f"{g:.6g}" for g in np.atleast_1d(gravity))
    unit = units_in("m s^-2", system or "SI").removesuffix("1")
    assumed = " (assumed: the files do not name them)" if "assumed_units" in ds.attrs else ""
    return [
        ("engine", str(ds.attrs.get("engine", ""))),
        ("files", str(ds.attrs.get("files", "")).replace("\n", "; ")),
        ("ignored", str(ds.attrs.get("ignored_columns", "")).replace("\n", "; ")),
        ("skipped", f"{len(skipped.splitlines())} files" if skipped else ""),
        ("time", _times(ds)),
        ("gravity", f"({pull}) {unit}".rstrip() if pull else ""),
        ("units", {None: "", "SI": "SI"}.get(system, f"{system}: scaled numbers, without units") + assumed),
    ]


def _times(ds: xr.Dataset) -> str:
    """First and last time."""
    if "time" not in ds.coords or not ds["time"].size or ds["time"].dtype.kind not in "iuf":
        return ""
    times = np.atleast_1d(ds["time"].to_numpy())
    unit = str(ds["time"].attrs.get("units", "")).removesuffix("1")
    text = f"{times[0]:g} to {times[-1]:g} {unit}" if len(times) > 1 else f"{times[0]:g} {unit}"
    return text.rstrip()


def _box(ds: xr.Dataset) -> str:
    """Edges of the box where they are known without reading."""
    if "box" in ds and ds["box"].chunks is not None and "box_lower" not in ds.attrs:
        return "changes with time"
    edges = describe(ds).edges
    unit = units_in("m", ds.attrs.get("unit_system", "SI")).removesuffix("1")
    text = ", ".join(f"{a} {edges[a][0]:.6g} to {edges[a][1]:.6g}" for a in COMPONENTS if a in edges)
    text += ", tilted" * ("lattice" in ds) + ", with images that move" * ("lattice_velocity" in ds)
    changes = "box" in ds and "box_lower" not in ds.attrs and ds["box"].sizes.get("time", 1) > 1
    return f"{text} {unit}".rstrip() + (" (first step)" if changes else "") if text else "none"
