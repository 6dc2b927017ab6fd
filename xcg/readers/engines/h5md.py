"""H5MD, the layout of HDF5 files that LAMMPS, ESPResSo, HALMD and others write (nongnu.org/h5md).

An element of a group of particles is a dataset, which does not change in time, or a group of
``value``, ``step`` and ``time``, whose first dimension counts the steps. The steps of a scene are
the steps of the positions. Edges of the box count along periodic axes only.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import compress
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError, unknown, warn_user
from xcg.readers.cells import box_of_cell
from xcg.readers.column_units import parse_unit
from xcg.readers.columns import Columnar
from xcg.readers.engine import ReadOptions, StepRef
from xcg.readers.files.hdf5data import dataset, is_hdf5, opened, text_of
from xcg.readers.files.text import source_of
from xcg.readers.named_columns import powers_of_slot
from xcg.readers.names import vector_columns
from xcg.readers.paths import index_steps
from xcg.scene.schema import COMPONENTS

if TYPE_CHECKING:
    import h5py

_MOST_COMPONENTS = 9
_BOUNDARIES = ("none", "periodic")
_WITH_UNITS = ("position", "velocity", "mass", "radius", "diameter", "time")


class H5md(Columnar):
    """H5MD."""

    OPTIONS = ("timestep", "group")
    NEEDS_ID = False

    def recognises(self, path: str) -> bool:
        """Return whether this is an HDF5 file with a group ``h5md``."""
        if not is_hdf5(path):
            return False
        with opened(path) as file:
            return "h5md" in file

    def list_steps(
        self, paths: Sequence[str], options: ReadOptions, *, contacts: bool
    ) -> list[StepRef]:
        """List the steps of one group of particles."""
        if contacts:
            raise SceneError(
                f"contacts={paths[0]!r}: H5MD has no contacts; if the file holds some in datasets of "
                "its own, name them by engine='hdf5' and mapping="
            )
        wanted = options.extra.get("group")
        scan = partial(_steps, wanted=wanted)
        refs = index_steps(paths, f"h5md {wanted}", scan, options.extra.get("timestep"))
        with opened(refs[0].path) as file:
            group = _group_of(file, wanted)
        if group.unread:
            warn_user(
                f"{refs[0].path}: {', '.join(group.unread)} of {group.name!r} are not there at each "
                "step of 'position', and are not read; write them at the same steps"
            )
        return refs

    def read_columns(
        self, ref: StepRef, wanted: Iterable[str], rows: int | None, options: ReadOptions
    ) -> dict[str, NDArray]:
        """Read the wanted columns of one step, without rows that hold no particle."""
        with opened(ref.path) as file:
            group = _group_of(file, options.extra.get("group"))
            exists = group.exists(ref.offset)
            return {column: group.read(column, ref)[exists] for column in set(wanted)}


def _steps(path: str, wanted: object) -> Iterator[StepRef]:
    with opened(path) as file:
        group = _group_of(file, wanted)
        header = StepRef(
            path, group.particle_count, step=-1, columns=(*group.columns,), units=_units(group)
        )
        for k in range(group.position.count):
            ref = replace(header, offset=k, **group.position.clock(k))
            yield replace(ref, **_box(file, group, k, source_of(ref)))


# --- elements and groups ---------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _H5mdElement:
    """An element: its values, and the steps and times that they are of.

    Attributes
    ----------
    values : Dataset
        The values, steps first if they change in time.
    steps, times : array (t,) or None
        Number and time of each step; None for what does not change, or whose time is unknown.
    """

    values: h5py.Dataset
    steps: NDArray | None = None
    times: NDArray | None = None

    @property
    def count(self) -> int:
        """Number of steps."""
        return 1 if self.steps is None else len(self.steps)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the values of one step."""
        return self.values.shape if self.steps is None else self.values.shape[1:]

    def clock(self, k: int) -> dict[str, Any]:
        """Return the number and the time of a step, as far as they are known."""
        clock: dict[str, Any] = {}
        if self.steps is not None:
            clock["step"] = int(self.steps[k])
        if self.times is not None:
            clock["time"] = float(self.times[k])
        return clock

    def index_at(self, k: int, position: _H5mdElement) -> int | None:
        """Return the index of the values at a step of the positions, None if it is absent."""
        if self.steps is not None and position.steps is not None:
            indices = np.flatnonzero(self.steps == position.steps[k])
            return int(indices[0]) if indices.size else None
        return 0 if self.count == 1 else None

    def covers(self, position: _H5mdElement) -> bool:
        """Return whether there are values at each step of the positions."""
        if self.steps is None or position.steps is None:
            return self.count == 1
        return bool(np.isin(position.steps, self.steps).all())

    def at(self, index: int, component: tuple[int, ...] = ()) -> NDArray:
        """Read the values of a step, or one of their components."""
        leading = () if self.steps is None else (index,)
        return np.asarray(self.values[(*leading, ..., *component)], float)


def _element(file: h5py.File, path: str) -> _H5mdElement | None:
    """Return an element; None if the path leads to something else."""
    import h5py

    member = file[path]
    if isinstance(member, h5py.Dataset):
        return _H5mdElement(member)
    if "value" not in member:
        return None
    values = member["value"]
    if not isinstance(values, h5py.Dataset) or not values.shape:
        raise SceneError(f"{file.filename}: '{path}/value' is no dataset of steps")
    count = values.shape[0]
    steps = _series(file, f"{path}/step", count)
    if steps is None:
        steps = np.arange(count)
    if (steps < 0).any() or (steps >= 2.0**63).any():
        raise SceneError(f"{file.filename}: '{path}/step' holds numbers below 0 or above 2^63")
    return _H5mdElement(values, steps.astype("int64"), _series(file, f"{path}/time", count))


def _series(file: h5py.File, path: str, count: int) -> NDArray | None:
    """Return the numbers or times of all steps, which are listed or follow from an increment."""
    if path not in file:
        return None
    data = dataset(file, path)
    values = np.asarray(data[()])
    if data.shape == ():
        values = np.arange(count) * float(values) + float(data.attrs.get("offset", 0))
    if values.shape != (count,) or not np.isfinite(values).all():
        raise SceneError(
            f"{file.filename}: {path!r} has the shape {data.shape}, expected {count} finite numbers, "
            "one for each step, or their increment"
        )
    return values


@dataclass(frozen=True, eq=False)
class _Group:
    """A group of particles.

    Attributes
    ----------
    name : str
        Its path in the file.
    file : File
        The file.
    elements : mapping
        Elements with values at each step of the positions, by name.
    unread : sequence of str
        Names of the other elements.
    """

    name: str
    file: h5py.File
    elements: Mapping[str, _H5mdElement]
    unread: Sequence[str]

    @property
    def position(self) -> _H5mdElement:
        """The positions."""
        return self.elements["position"]

    @property
    def particle_count(self) -> int:
        """Number of particles, at most."""
        return self.position.shape[0]

    @property
    def columns(self) -> dict[str, tuple[str, tuple[int, ...]]]:
        """Name of the element and the component of each column."""
        columns: dict[str, tuple[str, tuple[int, ...]]] = {}
        for name, element in self.elements.items():
            if element.shape[:1] != (self.particle_count,):
                continue
            if len(element.shape) == 1:
                columns[name] = name, ()
            if len(element.shape) == 2:
                names = vector_columns(name, min(element.shape[1], _MOST_COMPONENTS))
                columns |= {column: (name, (k,)) for k, column in enumerate(names)}
        # without ids the index in the datasets is the identity
        columns.setdefault("id", ("id", ()))
        return columns

    def exists(self, k: int) -> NDArray:
        """Return which rows hold a particle: their id is not the fill value that the file defines."""
        import h5py

        ids = self.elements.get("id")
        if ids is None:
            return np.ones(self.particle_count, bool)
        defined = ids.values.id.get_create_plist().fill_value_defined()
        index = ids.index_at(k, self.position)
        if defined != h5py.h5d.FILL_VALUE_USER_DEFINED or index is None:
            return np.ones(self.particle_count, bool)
        return ids.at(index) != ids.values.fillvalue

    def read(self, column: str, ref: StepRef) -> NDArray:
        """Read a column (rows,) of a step."""
        name, component = self.columns[column]
        if name not in self.elements:
            return np.arange(self.particle_count, dtype=float)
        element = self.elements[name]
        dataset(self.file, element.values.name)  # checks that it holds numbers
        index = element.index_at(ref.offset, self.position)
        values = element.at(index or 0, component)
        if index is None or values.shape != (ref.rows,):
            raise SceneError(f"{source_of(ref)}: {name!r} lacks the {ref.rows} rows of this step")
        return values


def _group_of(file: h5py.File, wanted: object) -> _Group:
    """Return the group of particles that the caller wants, or the only one.

    Raises
    ------
    SceneError
        If there are several, or none of this name, or its positions are no vectors.
    """
    parent = file.get("particles", {})
    names = [name for name in parent if "position" in parent[name]]
    if not names:
        raise SceneError(
            f"{file.filename}: no group of particles with a position; H5MD has it in "
            "/particles/<name>/position. For other layouts say engine='hdf5' and mapping="
        )
    if wanted is None and len(names) > 1:
        raise SceneError(
            f"{file.filename}: several groups of particles, {', '.join(names)}; open one, "
            f"group={names[0]!r}, or each of them, and join their scenes by "
            "xarray.concat(scenes, 'particle', data_vars='minimal')"
        )
    name = str(wanted or names[0])
    if name not in names:
        raise SceneError(f"{file.filename}: {unknown('group', name, names)}")
    path = f"/particles/{name}"
    elements = {}
    for member in ("position", *parent[name]):
        element = None
        if member != "box":
            element = _element(file, f"{path}/{member}")
        if element is not None:
            elements[member] = element
    position = elements.get("position")
    if position is None or len(position.shape) != 2 or position.shape[1] not in (2, 3):
        shape = position and position.values.shape
        raise SceneError(
            f"{file.filename}: '{path}/position' has the shape {shape}, expected (n, 2) or (n, 3), or "
            "(steps, n, 2) or (steps, n, 3) with 'value' and 'step'"
        )
    dataset(file, position.values.name)
    unread = [member for member, element in elements.items() if not element.covers(position)]
    for member in unread:
        del elements[member]
    return _Group(path, file, elements, unread)


# --- the header of a step --------------------------------------------------------------------------


def _box(file: h5py.File, group: _Group, k: int, source: str) -> dict[str, Any]:
    """Return box, lattice and periodic axes at a step of the positions."""
    path = f"{group.name}/box"
    if path not in file:
        return {}
    words = [text_of(word) for word in np.ravel(file[path].attrs.get("boundary", ()))]
    count = group.position.shape[1]
    if len(words) != count or not set(words) <= set(_BOUNDARIES):
        raise SceneError(
            f"{source}: the box has the boundary {words}, expected {count} of 'none' and 'periodic'"
        )
    wraps = [word == "periodic" for word in words]
    periodic = "".join(compress(COMPONENTS, wraps))
    if not periodic:
        return {"periodic": ""}
    edges = None
    index = None
    if "edges" in file[path]:
        edges = _element(file, f"{path}/edges")
    if edges is not None:
        index = edges.index_at(k, group.position)
    if edges is None or index is None or edges.shape not in ((count,), (count, count)):
        raise SceneError(
            f"{source}: the edges of the box have the shape {edges and edges.shape} at this step, expected "
            f"{(count,)} or {(count, count)}, as its boundary is periodic along {periodic}"
        )
    dataset(file, edges.values.name)
    values = edges.at(index)
    if values.ndim == 1:
        values = np.diag(values)
    cell = np.zeros((3, 3))
    cell[:count, :count] = values
    for axis in range(3):
        if COMPONENTS[axis] not in periodic:  # there the edges mean nothing
            cell[axis] = 0
    return box_of_cell(cell, np.zeros(3), periodic, source)


def _units(group: _Group) -> str | None:
    """Return the units that the file names: "si", None, or a list of units outside SI."""
    named: dict[str, Any] = {name: element.values for name, element in group.elements.items()}
    time = f"{group.name}/position/time"
    if time in group.file:
        named["time"] = group.file[time]
    units = {
        name: text_of(named[name].attrs["unit"])
        for name in _WITH_UNITS
        if name in named and "unit" in named[name].attrs
    }
    others = [
        f"{unit} of {name}"
        for name, unit in units.items()
        if parse_unit(unit) != (1.0, powers_of_slot(name))
    ]
    if units and not others:
        return "si"
    return ", ".join(others) or None
