"""Outlines: all of a scene but its grains and contacts, as a key that two scenes share which are planned alike."""

from __future__ import annotations

from collections.abc import Hashable
from types import FunctionType
from typing import Any

import numpy as np
import xarray as xr

from xcg.scene.schema import BOX

_MOST_BYTES = 4096  # of an array in a key, so that keys stay small


class NoKeyError(TypeError):
    """What was given has no key: arrays of grains or nodes, lazy variables, objects of unknown kinds."""


def key_of(value: Any) -> Hashable:
    """Return a key that two values share only if they are the same in type and in each bit.

    Functions are known by themselves, objects of xcg by their class and what they hold.

    Raises
    ------
    NoKeyError
        If there is none.
    """
    kind = type(value)
    if value is None or kind is str or kind is FunctionType:
        return value
    if kind is int or kind is bool:
        return kind, value
    if kind is float:
        return kind, value.hex()  # which tells the sign of zero
    if kind is list or kind is tuple:
        return kind, *[key_of(one) for one in value]
    if kind is dict:
        return kind, *[(key_of(name), key_of(one)) for name, one in value.items()]
    if isinstance(value, (np.ndarray, np.generic)) and not value.dtype.hasobject and value.nbytes <= _MOST_BYTES:
        return kind, value.dtype, value.shape, value.tobytes()
    if kind.__module__.partition(".")[0] == __package__.partition(".")[0]:
        return kind, key_of(vars(value))
    msg = f"{kind.__name__} has no key"
    raise NoKeyError(msg)


def outline(ds: xr.Dataset) -> Hashable:
    """Return the key of a scene in memory: attributes, the box, and names, dimensions, types and units of variables.

    Raises
    ------
    NoKeyError
        If a variable is lazy, or an attribute has no key.
    """
    found: list[Hashable] = [key_of(ds.attrs)]
    coords = ds.coords
    for name, given in ds.variables.items():
        if name in coords:
            continue
        if not isinstance(given._data, np.ndarray):
            msg = f"{name} is lazy"
            raise NoKeyError(msg)
        values = key_of(given._data) if name in BOX else None
        found.append((name, given.dims, given.dtype, key_of(given.attrs), values))
    return tuple(found)
