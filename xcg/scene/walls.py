"""Walls of a scene: numbers and names of the negative partners in contacts, and the contacts of some walls alone."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, TypeAlias

import numpy as np
import xarray as xr

from xcg.common.messages import SceneError, unknown
from xcg.scene.conform import require_scene, takes_scene
from xcg.scene.schema import PADDING

Walls: TypeAlias = str | int | Sequence[str | int]

FIRST_WALL = PADDING - 1  # walls that have names are -2, -3, ... in their order


def named_walls(names: Iterable[str]) -> dict[str, Any]:
    """Attributes of a scene whose walls -2, -3, ... have names.

    Raises
    ------
    SceneError
        If a name is not a single word, as the attribute is words with blanks between.
    """
    names = list(names)
    wrong = [name for name in names if not isinstance(name, str) or len(name.split()) != 1]
    if wrong:
        raise SceneError(f"walls: {wrong[0]!r} is no name of a wall: expected a word without blanks")
    return {"wall_names": " ".join(names), "wall_ids": FIRST_WALL - np.arange(len(names))}


def walls_of(ds: xr.Dataset) -> dict[str, int]:
    """Names of a scene's walls and their numbers in ``contact_j``; empty where walls have no names."""
    names = str(ds.attrs.get("wall_names", "")).split()
    numbers = np.atleast_1d(ds.attrs.get("wall_ids", [])).tolist()
    return {name: int(number) for name, number in zip(names, numbers, strict=True)}


def numbers_of_walls(ds: xr.Dataset, walls: Walls) -> tuple[int, ...]:
    """Numbers in ``contact_j`` of walls that are given by number or by name.

    Raises
    ------
    ValueError
        If the scene has no wall of a name, or a number is not negative.
    """
    known = walls_of(ds)
    given = [walls] if isinstance(walls, str | int | np.integer) else list(walls)
    for wall in given:
        if isinstance(wall, str) and wall not in known:
            there = f"the walls of this scene are {', '.join(known)}" if known else "no wall of this scene has a name"
            raise ValueError(unknown("wall", wall, known, f"{there}; or give numbers as in contact_j"))
        if not isinstance(wall, str) and not (isinstance(wall, int | np.integer) and wall < 0):
            raise ValueError(f"walls: {wall!r} is no wall: expected names, or negative numbers as in contact_j")
    if not given:
        raise ValueError("walls: none is given; expected names, or negative numbers as in contact_j")
    return tuple(dict.fromkeys(known[wall] if isinstance(wall, str) else int(wall) for wall in given))


@takes_scene
def select_walls(ds: xr.Dataset, walls: Walls) -> xr.Dataset:
    """Keep the contacts with some walls, and no others; lazy where the scene is.

    Fields of contacts are then the part that these walls have in them: ``wall_traction`` of several walls adds up to
    that of all.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with contacts.
    walls : str, int or list of these
        Names of walls, as `open_scene` was given them, or their numbers in ``contact_j``: LAMMPS -2, -3, ... in the
        order of ``walls=``; LIGGGHTS -(mesh + 1); MercuryDPM -(index + 1).

    Returns
    -------
    xarray.Dataset
        The scene with the other contacts turned into padding (``contact_i == -1``).

    Raises
    ------
    SceneError
        If the scene has no contacts.
    ValueError
        If a wall is unknown.

    Examples
    --------
    >>> import xcg
    >>> ds = xcg.datasets.random_scene(100)
    >>> int((select_walls(ds, -1).contact_i >= 0).sum()) == int((ds.contact_j == -1).sum() - (ds.contact_i < 0).sum())
    True
    """
    require_scene(ds, ("contact_i", "contact_j"), "select_walls")
    kept = ds["contact_j"].isin(numbers_of_walls(ds, walls))
    return ds.assign(contact_i=ds["contact_i"].where(kept, PADDING).assign_attrs(ds["contact_i"].attrs))
