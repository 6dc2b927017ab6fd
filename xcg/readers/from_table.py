"""Scenes from tables in memory, as pandas has them."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from xcg.common.messages import SceneError, warn_user
from xcg.readers.assigned import assign, magnitudes_among
from xcg.readers.caller_names import CallerNames
from xcg.readers.column_units import with_unit
from xcg.readers.engine import ReadOptions, StepRef
from xcg.readers.engines.tabular import (
    Table,
    check_clock,
    clock_of,
    read_clock,
    warn_of_unread_clock,
)
from xcg.readers.files.table import way_of_words
from xcg.readers.named_columns import columns_by_name
from xcg.readers.order import cause_by_column, warn_if_none_recurs
from xcg.readers.report import check_plane, list_not_read, report_missing_ids, warn_of_columns
from xcg.scene.box import domain_of
from xcg.scene.conform import ROW_NUMBERS
from xcg.scene.frame import entries_of, indices_of
from xcg.scene.from_arrays import scene_from_arrays
from xcg.scene.lattice import Lattice, unit_vectors
from xcg.scene.schema import Frame, Setup, periodic_axes
from xcg.scene.times import seconds_between, without_noise


def scene_from_table(
    particles: Any,
    contacts: Any = None,
    *,
    names: Mapping[str, Any] | None = None,
    **options: Any,
) -> xr.Dataset:
    """Build a scene from tables in memory, as pandas has them.

    Parameters
    ----------
    particles : pandas.DataFrame, or what makes one
        A row a particle and step; arrays (rows, 3) of a mapping or structured array are vectors.
        Columns are named as in `xcg.open_scene`: ``x y z`` or ``position_x``, ``diameter`` or
        ``radius``, ``mass``, ``density``, ``particle_id`` or ``id``, ``species`` or ``type``;
        ``time`` (s; also durations or dates, which count from the first, the attribute ``start``)
        or ``step`` distinguish steps, whose rows come in any order.
    contacts : pandas.DataFrame, or what makes one, optional
        A row a contact and step: ``contact_i contact_j`` or ``id1 id2``, ``fx fy fz`` or
        ``contact_force_x``, on i, or ``normal_force_x`` and ``tangential_force_x``,
        ``contact_point_x``, ``overlap``, and ``time`` or ``step``. In a step without rows nothing
        touches; a warning lists such steps, unless the table has no rows at all. Magnitudes
        ``normal_force`` (``fn``) have the direction n of the centres, from j to i, and, of discs in
        the plane of x and y, as PeGS2 lists them, ``tangential_force`` (``ft``) that of z x n: the
        force on i is ``normal_force n + tangential_force (z x n)``.
    names : mapping, optional
        From other columns to these names; None drops a column. ``{"particles": {...}, "contacts":
        {...}}`` gives names of each table.
    **options
        All else that `xcg.scene_from_arrays` takes: ``box``, ``periodic``, ``units``, and variables
        that the tables do not hold. ``density`` is used where the tables hold neither mass nor
        density.

    Returns
    -------
    xarray.Dataset
        The scene, in memory. Its attribute `not_read` lists the columns that are not read.

    Raises
    ------
    SceneError
        If a column is missing, holds something other than numbers, is also given as an argument, or
        the tables disagree; the message names table, column and row.

    Warns
    -----
    SceneWarning
        If columns resemble variables that are not read, or name a unit that is not known; if steps
        of the particles have no rows of contacts, rows of several steps have no ids, or no particle
        recurs. The scene is checked as that of files, see `xcg.open_scene`.

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
    read_options = _read_options(names, options)
    table = _table(particles, "particles")
    table, start = _with_seconds(table, "particles", read_options, options.get("units"))
    refs = {"particles": [_ref_of(table, "particles")]}
    engines = {"particles": _InMemory(table)}
    grains = _frames(table, "particles", read_options.of_kind("particles"), contacts=False)
    steps = sorted(grains)
    clock, _ = grains[steps[0]]
    frames = [grains[key][1] for key in steps]
    arrays: dict[str, Any] = _stacked(frames)
    arrays |= {what: [grains[key][0][what] for key in steps] for what in clock}
    nameless = "particle_id" not in arrays and options.get("particle_id") is None
    if nameless:
        has_contacts = contacts is not None
        report_missing_ids(refs["particles"][0], len(steps), contacts=has_contacts)
    names_of_particles = read_options.of_kind("particles").names
    columns = clock_of(refs["particles"][0].columns, names_of_particles).values()
    if len(steps) > 1 and not {*columns} & {*names_of_particles}:
        cause = cause_by_column(next(iter(columns)), in_order=False)
        compared = dict.fromkeys((0, len(steps) - 1, 1))
        named = [(f"step {steps[k]:g}", frames[k]) for k in compared]
        warn_if_none_recurs(named, cause)
    if contacts is not None:
        lattices = _lattices(steps, options)
        of_kind = read_options.of_kind("contacts")
        units = options.get("units")
        table = _table(contacts, "contacts")
        table, _ = _with_seconds(table, "contacts", read_options, units, start)
        table = _at_steps(table, clock_of(tuple(table.columns), of_kind.names), steps)
        table = _with_vectors(table, grains, of_kind, lattices)
        refs["contacts"] = [_ref_of(table, "contacts")]
        engines["contacts"] = _InMemory(table)
        arrays |= _contacts(table, steps, of_kind)
    _check_arguments(options, arrays)
    arguments = [name for name, value in options.items() if value is not None]
    for kind, engine in engines.items():
        ref, of_kind = refs[kind][0], read_options.of_kind(kind)
        warn_of_columns(engine, ref, of_kind, contacts=kind == "contacts", arguments=arguments)
        warn_of_unread_clock(ref, of_kind)
    scene = scene_from_arrays(**(options | arrays))
    if contacts is not None:
        of_grains, of_contacts = refs["particles"][0], refs["contacts"][0]
        check_plane(Table(), of_grains, of_contacts, read_options, scene.attrs["dimension"])
    not_read = list_not_read(Table(), refs, read_options)
    if not_read:
        scene = scene.assign_attrs(not_read=not_read)
    if start:
        scene = scene.assign_attrs(start=start)
    if nameless:
        scene["particle_id"].attrs |= ROW_NUMBERS
    return scene


def _read_options(names: Mapping[str, Any] | None, arguments: Mapping[str, Any]) -> ReadOptions:
    """Return the options of reading; names may be given apart for grains and contacts."""
    parsed = CallerNames.parse(names)
    if parsed.listed:
        raise SceneError(
            f"names={names!r}: tables in memory name their columns; map them, names={{'column': 'variable'}}"
        )
    given = frozenset(name for name in ("units",) if arguments.get(name) is not None)
    return ReadOptions(parsed.mapped, names_of=parsed.of_kind, given=given)


def _ref_of(table: pd.DataFrame, what: str) -> StepRef:
    return StepRef(what, len(table), columns=tuple(table.columns))


def _lattices(steps: Sequence[float], options: Mapping[str, Any]) -> dict[float, Lattice]:
    """Return the lattice of each step, from the arguments of the caller."""
    box = options.get("box")
    periodic = periodic_axes(options.get("periodic"), options.get("plane"))
    if box is None or not periodic:
        return dict.fromkeys(steps, Lattice.of({}, ""))
    boxes = domain_of(box, options.get("lattice"), {}, periodic, len(steps))
    lattices = {}
    for t, key in enumerate(steps):
        box_of_step = entries_of(boxes, t)
        lattices[key] = Lattice.of(box_of_step, periodic)
    return lattices


def _contacts(
    table: pd.DataFrame, steps: Sequence[float], options: ReadOptions
) -> dict[str, list[NDArray]]:
    """Return the variables of the contacts at each step; nothing touches in a step without rows."""
    frames = {
        key: frame for key, (_, frame) in _frames(table, "contacts", options, contacts=True).items()
    }
    empty = {name: values[:0] for name, values in next(iter(frames.values())).items()}
    unknown = sorted(set(frames) - set(steps))
    lacking = [key for key in steps if key not in frames]
    if len(table) and unknown:
        raise SceneError(
            f"contacts: rows of {unknown[0]}, and no particles of that time or step; there are {steps[:3]}"
        )
    if len(table) and lacking:
        warn_user(
            f"contacts: no rows for {len(lacking)} of {len(steps)} steps of the particles, such as {lacking[0]:g}, "
            "and nothing touches in them; if their contacts are unknown, leave these steps out of both tables"
        )
    return _stacked([frames.get(key, empty) for key in steps])


def _check_arguments(options: Mapping[str, Any], arrays: Mapping[str, Any]) -> None:
    """Raise SceneError for a variable that is an argument and a column; warn of an unused density."""
    twice = [name for name, value in options.items() if value is not None and name in arrays]
    for name in twice:
        if name != "density":
            raise SceneError(
                f"{name}= is given, and the tables hold {name!r}, too; leave the argument out, or drop the column, "
                "names={'column': None}"
            )
    if twice:
        warn_user(
            f"density={options['density']!r} is not used, as the tables hold 'density': leave the argument out, or "
            "drop the column, names={'density': None}"
        )


def _branches(
    table: pd.DataFrame,
    ends: Mapping[str, str],
    options: ReadOptions,
    grains: Mapping[float, tuple[dict[str, float], Frame]],
    lattices: Mapping[float, Lattice],
) -> NDArray:
    """Return the vectors (n, 3) from j to i of the contacts in a table, nearest images in the lattice of the step."""
    ids_i = _numbers(table, ends["contact_i"], "contacts")
    ids_j = _numbers(table, ends["contact_j"], "contacts")
    keys = np.zeros(len(table))
    clock = [*clock_of(tuple(table.columns), options.names).values()]
    if clock:
        keys = _numbers(table, clock[0], "contacts")
    branch = np.zeros((len(table), 3))
    for key, (_, frame) in grains.items():
        indices = np.flatnonzero(keys == key)
        position = frame["position"]
        ids = frame.get("particle_id", np.arange(len(position)))
        unknown = np.setdiff1d(np.concatenate([ids_i[indices], ids_j[indices]]), ids)
        if unknown.size:
            raise SceneError(
                f"contacts: no particle has id {unknown[0]:g} at {key:g}; drop its contacts or add it"
            )
        order = np.argsort(ids)
        sorted_ids = ids[order].astype(int)
        i = order[indices_of(sorted_ids, ids_i[indices].astype(int))]
        j = order[indices_of(sorted_ids, ids_j[indices].astype(int))]
        branch[indices] = lattices[key].shortest(position[i] - position[j])
    return branch


def _with_vectors(
    contacts: pd.DataFrame,
    grains: Mapping[float, tuple[dict[str, float], Frame]],
    options: ReadOptions,
    lattices: Mapping[float, Lattice],
) -> pd.DataFrame:
    """Replace magnitudes of forces along and across the lines of centres by vectors; other tables stay as they are.

    Raises
    ------
    SceneError
        If there are tangential forces, and centres are not in a plane of x and y.
    """
    magnitudes = magnitudes_among(contacts.columns, options.names)
    normal = magnitudes.get("normal_force")
    tangential = magnitudes.get("tangential_force")
    table = contacts
    slots = {end: Table.CONTACT_SLOTS[end] for end in ("contact_i", "contact_j")}
    ends = assign(_ref_of(table, "contacts"), slots, options)
    free = [column for column in table.columns if column not in options.names]
    vectors = columns_by_name(free, Table.CONTACT_SLOTS).keys() | {*options.names.values()}
    if normal is None or len(ends) < 2 or vectors & {"contact_force_x", "normal_force_x"}:
        return contacts
    walls = _numbers(table, ends["contact_j"], "contacts") < 0
    if walls.any():
        warn_user(
            f"contacts: {int(walls.sum())} rows name a wall, whose direction is unknown, and are dropped; give forces "
            "as normal_force_x, ... and contact_point_x, ... to keep them"
        )
        table = table[~walls]
    branch = _branches(table, ends, options, grains, lattices)
    x, y, z = unit_vectors(branch).T
    along = _numbers(table, normal, "contacts")
    across = np.zeros(len(table))
    if tangential is not None:
        across = _numbers(table, tangential, "contacts")
    if across.any() and z.any():
        raise SceneError(
            f"contacts: {tangential!r} is a magnitude, whose direction is known only of discs in the plane of x and y; "
            f"give its components, or drop it by names={{{tangential!r}: None}}"
        )
    forces = {
        "contact_force_x": along * x - across * y,
        "contact_force_y": along * y + across * x,
        "contact_force_z": along * z,
    }
    return table.drop(columns=[*magnitudes.values()]).assign(**forces)


def _table(data: Any, what: str) -> pd.DataFrame:
    """Return rows as a table whose index is a column if it has a name."""
    if isinstance(data, xr.Dataset):
        columns = {
            name: with_unit(str(name), str(values.attrs.get("units", "")))
            for name, values in data.variables.items()
        }
        rows = [name for name in data.dims if name not in data.coords]
        data = data.to_dataframe().reset_index().drop(columns=rows).rename(columns=columns)
    elif not isinstance(data, pd.DataFrame) and hasattr(data, "to_pandas"):
        data = data.to_pandas()  # of pyarrow
    if isinstance(data, np.ndarray) and data.dtype.names:
        data = {name: data[name] for name in data.dtype.names}
    if isinstance(data, Mapping):
        data = _by_component(data)
    table = pd.DataFrame(data)
    if any(table.index.names):
        table = table.reset_index()
    if table.columns.nlevels > 1:  # ("position", "x") is position_x, and ("radius", "") radius
        named = [
            # pandas calls empty cells of headers so
            [str(level) for level in levels if level and not str(level).startswith("Unnamed: ")]
            for levels in table.columns
        ]
        table.columns = ["_".join(levels) for levels in named]
    table = table.rename(columns=str)
    for name, values in table.items():
        if isinstance(
            next(iter(values), None), list | tuple | np.ndarray
        ):  # [x, y, z] in each cell
            parts = _by_component({str(name): values.tolist()})
            table = table.drop(columns=name).assign(**parts)
    twice = table.columns[table.columns.duplicated()]
    if len(twice):
        raise SceneError(
            f"{what}: two columns are called {twice[0]!r}; rename one, or drop it: "
            "table.loc[:, ~table.columns.duplicated()]"
        )
    return table


def _by_component(columns: Mapping[str, Any]) -> dict[str, Any]:
    """Return columns with vectors (rows, 2 or 3) as one column each component, ``position_x``, ..."""
    out: dict[str, Any] = {}
    for name, values in columns.items():
        rows = values
        if isinstance(values, list | tuple):
            rows = np.array(values, object)  # as its items may differ in length
        if np.ndim(rows) == 2 and np.shape(rows)[1] in (2, 3):
            out |= {f"{name}_{a}": x for a, x in zip("xyz", np.asarray(values).T, strict=False)}
        else:
            out[name] = values
    return out


def _with_seconds(
    table: pd.DataFrame, what: str, options: ReadOptions, units: Any, since: str | None = None
) -> tuple[pd.DataFrame, str | None]:
    """Return a table whose times are numbers, without rounding noise, and what they count from.

    Dates count from `since` where it is given, else from the first.
    """
    column = clock_of(tuple(table.columns), options.of_kind(what).names).get("time")
    if column is None or not len(table):
        return table, None
    convert = units is None
    times, start = read_clock(table[column], column, what, convert=convert)
    if start and since:
        times = times + seconds_between(since, start)
    if start is not None and units is not None:
        times = times / Setup.make(units=units).scales[2]
    return table.assign(**{column: times}), start


def _at_steps(
    contacts: pd.DataFrame, clock: Mapping[str, str], steps: Sequence[float]
) -> pd.DataFrame:
    """Return contacts with times replaced by the steps' times that equal them up to rounding."""
    column = clock.get("time")
    if column is None or not len(contacts):
        return contacts
    times = contacts[column].to_numpy("float64")
    if not np.isfinite(times).all():
        return contacts
    joint = without_noise(np.concatenate([steps, times]))
    time_of_step = dict(zip(joint[: len(steps)].tolist(), steps, strict=True))
    distinct, index = np.unique(joint[len(steps) :], return_inverse=True)
    matched = np.array([time_of_step.get(time, time) for time in distinct.tolist()])
    return contacts.assign(**{column: matched[index]})


def _stacked(frames: Sequence[Frame]) -> dict[str, list[NDArray]]:
    return {name: [frame[name] for frame in frames] for name in frames[0]}


def _frames(
    data: pd.DataFrame, what: str, options: ReadOptions, *, contacts: bool
) -> dict[float, tuple[dict[str, float], Frame]]:
    """Time and number of each step, and its frame, by the first of both."""
    if not len(data.columns):
        raise SceneError(f"{what}: the table has no columns")
    if not len(data) and not contacts:
        raise SceneError(f"{what}: the table has no rows")
    clock = clock_of(tuple(data.columns), options.names)
    clocks = {word: _numbers(data, name, what) for word, name in clock.items()}
    check_clock(clocks, what)
    runs: list[Any] = [np.arange(len(data))]
    if clocks and len(data):
        key = next(iter(clocks.values()))
        runs = [*data.groupby(key).indices.values()]
    frames = {}
    for k, indices in enumerate(runs):
        clock_of_step = {
            word: float(values[indices[0]]) for word, values in clocks.items() if len(indices)
        }
        step = int(clock_of_step.get("step", k))
        ref = StepRef(what, len(indices), step=step, columns=tuple(data.columns))
        engine = _InMemory(data.iloc[indices])
        read = engine.read_contacts if contacts else engine.read_particles
        frames[next(iter(clock_of_step.values()), 0.0)] = clock_of_step, read(ref, options)
    return frames


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
            f"{what}: column {name!r} holds other things than numbers ({error}); {way_of_words(name)}"
        ) from None
