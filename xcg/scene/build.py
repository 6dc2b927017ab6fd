"""Scenes: many frames in one Dataset."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from xcg.scene.conform import storable
from xcg.scene.facts import SETUP, setup_of
from xcg.scene.schema import (
    BOX,
    COMPONENTS,
    NUMBERED,
    VECTORS,
    Setup,
    mark_measured,
    units_in,
    variable,
)


def to_dataset(
    arrays: Mapping[str, Any],
    *,
    time: ArrayLike | None,
    step: ArrayLike,
    box: Mapping[str, NDArray],
    setup: Setup,
    measured: Mapping[str, Any],
) -> xr.Dataset:
    """Label padded arrays (NumPy or dask, time first) as a scene.

    Parameters
    ----------
    arrays : mapping
        Padded arrays by scene name, time first.
    time : array (t,) or None
        Times (s); None if they are unknown: the numbers of the steps replace them.
    step : array (t,)
        Step numbers.
    box : mapping
        Variables of the domain, time first, see `domain_of`.
    """
    data = {}
    for name, values in (*arrays.items(), *box.items()):
        row = BOX.get(name) or variable(name, values.dtype, values.ndim - 1)
        attrs = {"units": units_in(row.units, setup.unit_system), "long_name": row.long_name}
        data[name] = xr.Variable(("time", *row.dims), values, attrs)
    unit = units_in("s", setup.unit_system)
    long_name = "time"
    if time is None:
        time = step
        unit = "1"
        long_name = NUMBERED
    coords: dict[str, Any] = {
        "time": (
            "time",
            np.asarray(time, float),
            {"units": unit, "long_name": long_name, "axis": "T"},
        ),
        "step": (
            "time",
            np.asarray(step, "int64"),
            {"units": "1", "long_name": "number of the time step"},
        ),
        "component": ("component", list(COMPONENTS)),
    }
    if any("direction" in variable.dims for variable in data.values()):
        coords["direction"] = ("direction", list(COMPONENTS))
    if "lattice" in box:
        coords["vector"] = ("vector", list(VECTORS))
    edges = box.get("box")
    # attributes stay with every selection of steps
    if edges is not None and (edges == edges[:1]).all():
        measured = {"box_lower": edges[0, :, 0], "box_upper": edges[0, :, 1], **measured}
    about: dict[str, Any] = {
        "Conventions": "CF-1.11",
        "periodic": setup.periodic,
        "dimension": setup.dimension,
        "plane": setup.plane,
        "unit_system": setup.unit_system,
    }
    if setup.gravity is not None:
        about["gravity"] = np.asarray(setup.gravity)
    if setup.thickness is not None:
        about["thickness"] = setup.thickness
    if "contact_i" in data:
        about["sides"] = setup.sides
    about |= measured
    coords[SETUP] = setup_of(about)
    return mark_measured(storable(xr.Dataset(data, coords, about)))
