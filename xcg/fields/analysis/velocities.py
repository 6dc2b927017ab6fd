"""Velocities from positions, where files hold none: of tracked particles in experiments, for example."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.messages import SceneError, warn_once
from xcg.scene.box import BoxMotion
from xcg.scene.conform import require_scene, takes_scene
from xcg.scene.frame import particle_rows, require_rising_times, steps_in
from xcg.scene.sanity import rows_of
from xcg.scene.schema import COMPONENTS, OF_STEP, VARIABLES, units_in
from xcg.steps.labels import format_call, provenance
from xcg.steps.mapping import map_over_time

_SIDES = {"_before": -1, "_after": 1}
_LARGE_SHARE = 0.25  # of a period


@takes_scene
def derive_velocity(ds: xr.Dataset) -> xr.Dataset:
    """Add velocities from positions by differences in time; lazy where the scene is.

    ``v(t_k) = (r_{k+1} - r_{k-1}) / (t_{k+1} - t_{k-1})``, particles by id, with the nearest periodic image relative to
    the box; one-sided in the first and last step, and where a particle is missing before or after. Exact for constant
    acceleration and even steps. Steps have to be so close that no particle moves by half a period: from there on the
    nearest image is another one, and the velocity is wrong.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene of two steps or more, with ids that stay the same.

    Returns
    -------
    xarray.Dataset
        The scene with ``velocity`` (m/s), in place of a former one; NaN for particles that are in no neighbouring step:
        leave these out, ``ds.where(ds.velocity.notnull().all("component"))``.

    Raises
    ------
    SceneError
        If there is one step only, or times do not rise.

    Warns
    -----
    SceneWarning
        When it is computed, if a particle moves by more than a quarter of a period between two steps.

    Examples
    --------
    >>> import numpy as np
    >>> import xcg
    >>> t = np.array([0.0, 0.1, 0.2])
    >>> r = np.stack([0.5 * 9.81 * t**2, 0 * t, 0 * t], axis=-1)[:, None]
    >>> ds = xcg.scene_from_arrays(r, time=t, diameter=[0.01])
    >>> derive_velocity(ds).velocity.sel(component="x").values.round(6)[1]
    array([0.981])
    """
    require_scene(ds, (), "derive_velocity")
    count = ds.sizes["time"]
    if count < 2:
        raise SceneError("derive_velocity needs two steps or more, and this scene has one")
    require_rising_times(ds, "derive_velocity")
    names = ["particle_id", "position", *(name for name in OF_STEP if name in ds and name != "lattice_velocity")]
    series = ds.drop_vars("velocity", errors="ignore").assign(moment=("time", ds["time"].to_numpy()))
    beside: dict[str, xr.Variable] = {}
    for side, step in _SIDES.items():
        other = np.clip(np.arange(count) + step, 0, count - 1)
        for name in [*names, "moment"]:
            beside[name + side] = series[name].variable.isel(time=other).to_base_variable()
    series = series.assign(beside)
    compute = partial(_velocities, str(ds.attrs.get("periodic", "")))
    shape = {"velocity": ((ds.sizes["particle"], 3), "float64")}
    found = map_over_time(series, [*names, "moment", *beside], compute, shape, "derive-velocity")
    row = VARIABLES["velocity"]
    about = {"units": units_in(row.units, str(ds.attrs.get("unit_system", "SI"))), "long_name": row.long_name}
    velocity = xr.Variable(("time", *row.dims), found["velocity"], about)
    history = provenance(ds, format_call("derive_velocity", {}))["history"]
    return ds.assign(velocity=velocity).assign_attrs(history=history)


def _velocities(periodic: str, arrays: Mapping[str, NDArray]) -> dict[str, Any]:
    """Velocities (t, n, 3) of a chunk, NaN in padding."""
    moment = arrays["moment"]
    here = {name: a for name, a in arrays.items() if not name.endswith(tuple(_SIDES)) and name != "moment"}
    out = np.full((*here["particle_id"].shape, 3), np.nan)
    frames = [list(steps_in(here, periodic))]
    for side in _SIDES:
        others = {name.removesuffix(side): a for name, a in arrays.items() if name.endswith(side)}
        others.pop("moment")
        frames.append(list(steps_in(others, periodic)))
    for t, (now, before, after) in enumerate(zip(*frames, strict=True)):
        position = now[0]["position"]
        total, time = np.zeros_like(position), np.zeros(len(position))
        for side, other in zip(_SIDES, (before, after), strict=True):
            apart = float(arrays[f"moment{side}"][t] - moment[t])
            row = rows_of(other[0]["particle_id"], now[0]["particle_id"])
            there = np.flatnonzero(row >= 0) if apart else np.empty(0, int)
            motion = BoxMotion.between(now[1], other[1])
            moved = motion.relative(position[there], other[0]["position"][row[there]])
            _warn_of_aliasing(np.abs(moved).max(axis=0, initial=0.0) / now[1].period, now[2])
            moved += motion.shift + position[there] @ motion.gradient.T
            total[there] += np.sign(apart) * moved
            time[there] += abs(apart)
        with np.errstate(invalid="ignore", divide="ignore"):
            out[t, particle_rows(here["particle_id"][t])] = total / time[:, None]
    return {"velocity": out}


def _warn_of_aliasing(share: NDArray, source: str) -> None:
    """Warn where particles move by a large share (3,) of the period, as the nearest image may be another one."""
    k = int(share.argmax())
    if share[k] > _LARGE_SHARE:
        warn_once(
            "velocities across a period",
            f"{source}: particles move by up to {share[k]:.2f} of the period along '{COMPONENTS[k]}' from one step to "
            "the next; velocities of those that move by half a period or more are wrong. Write steps more often",
        )
