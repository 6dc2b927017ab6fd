"""Scenes from tables in memory, as pandas has them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from xcg.common.messages import SceneError, warn_user
from xcg.readers import columns
from xcg.readers.engine import ReadOptions, StepRef
from xcg.readers.engines.tabular import Table, clock_of, runs_of
from xcg.scene.build import scene_from_arrays
from xcg.scene.schema import Frame


def scene_from_table(
    particles: Any, *, contacts: Any = None, names: Mapping[str, str | None] | None = None, **options: Any
) -> xr.Dataset:
    """Build a scene from tables in memory, as pandas has them.

    Parameters
    ----------
    particles : pandas.DataFrame, or what makes one
        A row a particle and step. Columns are named as in `xcg.open_scene`: ``x y z`` or ``position_x``,
        ``diameter`` or ``radius``, ``mass``, ``density``, ``particle_id`` or ``id``, ``species`` or ``type``; ``time``
        (s) or ``step`` tell steps apart, whose rows come in any order.
    contacts : pandas.DataFrame, or what makes one, optional
        A row a contact and step: ``contact_i contact_j`` or ``id1 id2``, ``fx fy fz`` or ``contact_force_x``, on i, or
        ``normal_force_x`` and ``tangential_force_x``, ``contact_point_x``, ``overlap``, and ``time`` or ``step``.
        Magnitudes ``normal_force`` and ``tangential_force`` of discs in the plane of x and y, as PeGS2 lists them, have
        the direction n of the centres, from j to i: the force on i is ``normal_force n + tangential_force (z x n)``.
    names : mapping, optional
        From other columns to these names; None drops a column.
    **options
        All else that `xcg.scene_from_arrays` takes: ``density``, ``box``, ``periodic``, ``units``, ...

    Returns
    -------
    xarray.Dataset
        The scene, in memory.

    Raises
    ------
    SceneError
        If a column is missing, holds something other than numbers, or the tables disagree; the message names table,
        column and row.

    Examples
    --------
    >>> import pandas as pd, xcg
    >>> table = pd.DataFrame({"time": [0.0, 0.0, 0.1], "x": [0.0, 1.0, 0.5], "y": 0.0, "z": 0.0, "radius": 0.5})
    >>> ds = xcg.scene_from_table(table, density=2500.0)
    >>> dict(ds.sizes)
    {'time': 2, 'particle': 2, 'component': 3}
    """
    said = ReadOptions(dict(names or {}))
    grains = _frames(particles, "particles", said, contacts=False)
    steps = sorted(grains)
    given: dict[str, Any] = _stacked([grains[key][1] for key in steps])
    given |= {what: [grains[key][0][what] for key in steps] for what in grains[steps[0]][0]}
    if contacts is not None:
        contacts, said = _with_directions(contacts, grains, said)
        touching = _frames(contacts, "contacts", said, contacts=True)
        unknown = sorted(set(touching) - set(steps))
        if unknown:
            raise SceneError(
                f"contacts: rows of {unknown[0]}, and no particles of that time or step; there are {steps[:3]}"
            )
        empty = {name: values[:0] for name, values in next(iter(touching.values()))[1].items()}
        given |= _stacked([touching[key][1] if key in touching else empty for key in steps])
    position = given.pop("position")
    return scene_from_arrays(position, **(options | given))


def _with_directions(
    contacts: Any, grains: Mapping[float, tuple[dict[str, float], Frame]], options: ReadOptions
) -> tuple[pd.DataFrame, ReadOptions]:
    """Contacts with forces as vectors where they are magnitudes along and across the line of centres, and names."""
    table = contacts if isinstance(contacts, pd.DataFrame) else pd.DataFrame(contacts)
    wanted = {column: name for column, name in options.names.items() if name is not None}
    table = table.rename(columns=str).rename(columns=wanted | {"id1": "contact_i", "id2": "contact_j"})
    if not {"normal_force", "contact_i", "contact_j"} <= set(table):
        return contacts, options
    if (walls := table.contact_j < 0).any():
        warn_user(
            f"contacts: {int(walls.sum())} rows name a wall, whose direction is unknown, and are dropped; give forces "
            "as normal_force_x, ... and contact_point_x, ... to keep them"
        )
        table = table[~walls]
    clock = clock_of(tuple(table.columns), {})
    keys = table[next(iter(clock.values()))].to_numpy(float) if clock else np.zeros(len(table))
    normal = np.zeros((len(table), 2))
    for key in np.unique(keys):
        if key not in grains:
            continue  # the caller names it
        frame, rows = grains[key][1], np.flatnonzero(keys == key)
        ids = frame["particle_id"]
        order = np.argsort(ids)
        ends = [table[name].to_numpy()[rows] for name in ("contact_i", "contact_j")]
        unknown = np.setdiff1d(np.concatenate(ends), ids)
        if unknown.size:
            raise SceneError(f"contacts: no particle has id {unknown[0]:g} at {key:g}; drop its contacts or add it")
        i, j = (order[np.searchsorted(ids, end, sorter=order)] for end in ends)
        apart = frame["position"][i, :2] - frame["position"][j, :2]
        normal[rows] = apart / np.linalg.norm(apart, axis=1, keepdims=True)
    across = table["tangential_force"].to_numpy() if "tangential_force" in table else 0.0
    along = table["normal_force"].to_numpy()
    x, y = normal.T
    forces = {"contact_force_x": along * x - across * y, "contact_force_y": along * y + across * x}
    table = table.drop(columns=["normal_force", "tangential_force"], errors="ignore")
    return table.assign(**forces, contact_force_z=0.0), ReadOptions({})


def _stacked(frames: Sequence[Frame]) -> dict[str, list[NDArray]]:
    return {name: [frame[name] for frame in frames] for name in frames[0]}


def _frames(
    table: Any, what: str, options: ReadOptions, *, contacts: bool
) -> dict[float, tuple[dict[str, float], Frame]]:
    """Time and number of each step, and its frame, by the first of both."""
    data = table if isinstance(table, pd.DataFrame) else pd.DataFrame(table)
    data = data.reset_index(drop=False) if any(data.index.names) else data
    data = data.rename(columns=str)
    engine, found = Table(), {}
    clock = clock_of(tuple(data.columns), options.names)
    rows = {word: _numbers(data, name, what) for word, name in clock.items()}
    runs = [np.arange(len(data))]
    if rows:
        key = next(iter(rows.values()))
        order = np.argsort(key, kind="stable")
        runs_of({word: values[order] for word, values in rows.items()}, len(data), what)
        runs = np.split(order, np.flatnonzero(np.diff(key[order])) + 1)
    for k, chosen in enumerate(runs):
        told = {word: float(values[chosen[0]]) for word, values in rows.items()} if len(chosen) else {}
        ref = StepRef(what, len(chosen), step=int(told.get("step", k)), columns=tuple(data.columns))
        read = partial(_of_rows, data.iloc[chosen], what)
        if contacts:
            frame = columns.contacts_from(ref, engine.contact_columns(ref, options), options, read)
        else:
            frame = columns.particles_from(ref, engine.particle_columns(ref, options), options, read)
        found[next(iter(told.values()), 0.0)] = told, frame
    return found


def _of_rows(data: pd.DataFrame, what: str, ref: StepRef, wanted: Iterable[str], *_: object) -> dict[str, NDArray]:
    return {name: _numbers(data, name, what) for name in wanted}


def _numbers(data: pd.DataFrame, name: str, what: str) -> NDArray:
    try:
        return data[name].to_numpy(dtype="float64", na_value=np.nan)
    except (TypeError, ValueError) as error:
        raise SceneError(f"{what}: column {name!r} holds other things than numbers ({error})") from None
