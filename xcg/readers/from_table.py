"""Scenes from tables in memory, as pandas has them."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from xcg.common.messages import SceneError, printable, warn_user
from xcg.readers import unread_columns
from xcg.readers.assigned import assign
from xcg.readers.engine import ReadOptions, StepRef
from xcg.readers.engines.tabular import Table, clock_of, runs_of, warn_of_unread_clock
from xcg.readers.pairs import ignored_columns
from xcg.scene.box import domain_of
from xcg.scene.build import scene_from_arrays
from xcg.scene.conform import ROW_NUMBERS
from xcg.scene.lattice import Lattice
from xcg.scene.rows import rows_of, unit_vectors
from xcg.scene.schema import Frame, periodic_axes


def scene_from_table(
    particles: Any,
    contacts: Any = None,
    *,
    names: Mapping[str, str | None] | None = None,
    **options: Any,
) -> xr.Dataset:
    """Build a scene from tables in memory, as pandas has them.

    Parameters
    ----------
    particles : pandas.DataFrame, or what makes one
        A row a particle and step. Columns are named as in `xcg.open_scene`: ``x y z`` or
        ``position_x``, ``diameter`` or ``radius``, ``mass``, ``density``, ``particle_id`` or
        ``id``, ``species`` or ``type``; ``time`` (s) or ``step`` distinguish steps, whose rows come
        in any order.
    contacts : pandas.DataFrame, or what makes one, optional
        A row a contact and step: ``contact_i contact_j`` or ``id1 id2``, ``fx fy fz`` or
        ``contact_force_x``, on i, or ``normal_force_x`` and ``tangential_force_x``,
        ``contact_point_x``, ``overlap``, and ``time`` or ``step``. In a step without rows nothing
        touches; a warning lists such steps, unless the table has no rows at all. Magnitudes
        ``normal_force`` and ``tangential_force`` of discs in the plane of x and y, as PeGS2 lists
        them, have the direction n of the centres, from j to i: the force on i is ``normal_force n +
        tangential_force (z x n)``.
    names : mapping, optional
        From other columns to these names; None drops a column.
    **options
        All else that `xcg.scene_from_arrays` takes: ``box``, ``periodic``, ``units``, and variables
        that the tables do not hold. ``density`` is used where the tables hold neither mass nor
        density.

    Returns
    -------
    xarray.Dataset
        The scene, in memory. Its attribute `ignored_columns` lists the columns that are not read.

    Raises
    ------
    SceneError
        If a column is missing, holds something other than numbers, is also given as an argument, or
        the tables disagree; the message names table, column and row.

    Examples
    --------
    >>> import pandas as pd, xcg
    >>> table = pd.DataFrame({"time": [0.0, 0.0, 0.1], "id": [1, 2, 1], "x": [0.0, 1.0, 0.5]})
    >>> table = table.assign(y=0.0, z=0.0, radius=0.5)
    >>> ds = xcg.scene_from_table(table, density=2500.0)
    >>> dict(ds.sizes)
    {'time': 2, 'particle': 2, 'component': 3}
    """
    if isinstance(particles, (str, os.PathLike)):
        raise TypeError(
            f"scene_from_table({os.fspath(particles)!r}): expected a table; files are opened by xcg.open_scene"
        )
    said = ReadOptions(dict(names or {}))
    tables = {"particles": _table(particles)}
    grains = _frames(tables["particles"], "particles", said, contacts=False)
    steps = sorted(grains)
    given: dict[str, Any] = _stacked([grains[key][1] for key in steps])
    given |= {what: [grains[key][0][what] for key in steps] for what in grains[steps[0]][0]}
    nameless = "particle_id" not in given and options.get("particle_id") is None
    if nameless:
        ref = StepRef("particles", 0, columns=tuple(tables["particles"].columns))
        unread_columns.report_missing_ids(ref, len(steps), contacts=contacts is not None)
    if contacts is not None:
        periodic = periodic_axes(options.get("periodic"), options.get("plane"))
        lattices = [Lattice.of({}, "")] * len(steps)
        if periodic and options.get("box") is not None:
            boxes = domain_of(options["box"], options.get("lattice"), {}, periodic, len(steps))
            lattices = [
                Lattice.of({name: v[t] for name, v in boxes.items()}, periodic)
                for t in range(len(steps))
            ]
        tables["contacts"] = rows = _with_vectors(
            _table(contacts), grains, said, dict(zip(steps, lattices, strict=True))
        )
        touching = _frames(rows, "contacts", said, contacts=True)
        unknown = sorted(set(touching) - set(steps)) if len(rows) else []
        if unknown:
            raise SceneError(
                f"contacts: rows of {unknown[0]}, and no particles of that time or step; there are {steps[:3]}"
            )
        lacking = [key for key in steps if key not in touching] if len(rows) else []
        if lacking:
            warn_user(
                f"contacts: no rows for {len(lacking)} of {len(steps)} steps of the particles, such as {lacking[0]:g}, "
                "and nothing touches in them; if their contacts are unknown, leave these steps out of both tables"
            )
        empty = {name: values[:0] for name, values in next(iter(touching.values()))[1].items()}
        given |= _stacked([touching[key][1] if key in touching else empty for key in steps])
    twice = [
        name
        for name, value in options.items()
        if name in given and value is not None and name != "density"
    ]
    if twice:
        raise SceneError(
            f"{twice[0]}= is given, and the tables hold {twice[0]!r}, too; leave the argument out, or drop the column, "
            "names={'column': None}"
        )
    if options.get("density") is not None and "density" in given:
        warn_user(
            f"density={options['density']!r} is not used, as the tables hold 'density': leave the argument out, or "
            "drop the column, names={'density': None}"
        )
    refs = {
        what: [StepRef(what, len(table), columns=tuple(table.columns))]
        for what, table in tables.items()
    }
    for (ref,) in refs.values():
        _warn_of_columns(ref, said, options)
    ignored = printable(ignored_columns(Table(), refs, said))
    scene = scene_from_arrays(**(options | given))
    if nameless:
        scene["particle_id"].attrs |= ROW_NUMBERS
    return scene.assign_attrs(ignored_columns=ignored) if ignored else scene


def _with_vectors(
    contacts: pd.DataFrame,
    grains: Mapping[float, tuple[dict[str, float], Frame]],
    options: ReadOptions,
    lattices: Mapping[float, Lattice],
) -> pd.DataFrame:
    """Replace magnitudes of forces along and across the lines of centres by vectors; other tables stay as they are.

    The line of centres leads to the nearest image in the lattice of the step.
    """
    magnitudes = ("normal_force", "tangential_force")
    table = contacts.rename(
        columns={column: name for column, name in options.names.items() if name in magnitudes}
    )
    ref = StepRef("contacts", len(table), columns=tuple(table.columns))
    ends = assign(
        ref, {end: Table.CONTACT_SLOTS[end] for end in ("contact_i", "contact_j")}, options
    )
    if "normal_force" not in table or len(ends) < 2:
        return contacts
    walls = _numbers(table, ends["contact_j"], "contacts") < 0
    if walls.any():
        warn_user(
            f"contacts: {int(walls.sum())} rows name a wall, whose direction is unknown, and are dropped; give forces "
            "as normal_force_x, ... and contact_point_x, ... to keep them"
        )
        table = table[~walls]
    ids_i, ids_j = (_numbers(table, ends[end], "contacts") for end in ("contact_i", "contact_j"))
    clock = clock_of(tuple(table.columns), options.names)
    keys = (
        _numbers(table, next(iter(clock.values())), "contacts") if clock else np.zeros(len(table))
    )
    apart = np.zeros((len(table), 3))
    for key, (_, frame) in grains.items():
        rows, position = np.flatnonzero(keys == key), frame["position"]
        ids = frame.get("particle_id", np.arange(len(position)))
        unknown = np.setdiff1d(np.concatenate([ids_i[rows], ids_j[rows]]), ids)
        if unknown.size:
            raise SceneError(
                f"contacts: no particle has id {unknown[0]:g} at {key:g}; drop its contacts or add it"
            )
        order = np.argsort(ids)
        i, j = (
            order[rows_of(ids[order].astype(int), end[rows].astype(int))] for end in (ids_i, ids_j)
        )
        apart[rows, :2] = lattices[key].shortest(position[i] - position[j])[:, :2]
    x, y, _ = unit_vectors(apart).T
    along = _numbers(table, "normal_force", "contacts")
    across = _numbers(table, "tangential_force", "contacts") if "tangential_force" in table else 0.0
    forces = {"contact_force_x": along * x - across * y, "contact_force_y": along * y + across * x}
    return table.drop(columns=[*magnitudes], errors="ignore").assign(**forces, contact_force_z=0.0)


def _table(rows: Any) -> pd.DataFrame:
    """Return rows as a table whose index is a column if it has a name."""
    data = rows if isinstance(rows, pd.DataFrame) else pd.DataFrame(rows)
    return (data.reset_index() if any(data.index.names) else data).rename(columns=str)


def _stacked(frames: Sequence[Frame]) -> dict[str, list[NDArray]]:
    return {name: [frame[name] for frame in frames] for name in frames[0]}


def _frames(
    data: pd.DataFrame, what: str, options: ReadOptions, *, contacts: bool
) -> dict[float, tuple[dict[str, float], Frame]]:
    """Time and number of each step, and its frame, by the first of both."""
    found = {}
    clock = clock_of(tuple(data.columns), options.names)
    rows = {word: _numbers(data, name, what) for word, name in clock.items()}
    runs = [np.arange(len(data))]
    if not len(data.columns) or not (len(data) or contacts):
        raise SceneError(f"{what}: the table has no {'rows' if len(data.columns) else 'columns'}")
    if rows and len(data):
        key = next(iter(rows.values()))
        order = np.argsort(key, kind="stable")
        runs_of({word: values[order] for word, values in rows.items()}, len(data), what)
        runs = np.split(order, np.flatnonzero(np.diff(key[order])) + 1)
    for k, chosen in enumerate(runs):
        told = (
            {word: float(values[chosen[0]]) for word, values in rows.items()} if len(chosen) else {}
        )
        ref = StepRef(what, len(chosen), step=int(told.get("step", k)), columns=tuple(data.columns))
        engine = _InMemory(data.iloc[chosen])
        frame = (
            engine.read_contacts(ref, options) if contacts else engine.read_particles(ref, options)
        )
        found[next(iter(told.values()), 0.0)] = told, frame
    return found


def _warn_of_columns(ref: StepRef, options: ReadOptions, arguments: Mapping[str, Any]) -> None:
    """Warn of columns that are probably not ignored on purpose, as for files."""
    contacts = ref.path == "contacts"
    table = Table()
    read = (table.contact_columns if contacts else table.particle_columns)(ref, options)
    read = {name: "" for name, value in arguments.items() if value is not None} | read
    unread_columns.warn_of_unread(ref, read, options, contacts=contacts)
    warn_of_unread_clock(ref, options)
    if arguments.get("units") is None:
        unread_columns.warn_of_other_units(ref, options)


class _InMemory(Table):
    """Rows of one step."""

    def __init__(self, data: pd.DataFrame) -> None:
        self.data = data

    def read_columns(
        self, ref: StepRef, wanted: Iterable[str], rows: int | None, options: ReadOptions
    ) -> dict[str, NDArray]:
        """Read columns of a table that `ref` names."""
        return {name: _numbers(self.data, name, ref.path) for name in wanted}


def _numbers(data: pd.DataFrame, name: str, what: str) -> NDArray:
    try:
        return data[name].to_numpy(dtype="float64", na_value=np.nan)
    except (TypeError, ValueError) as error:
        raise SceneError(
            f"{what}: column {name!r} holds other things than numbers ({error})"
        ) from None
