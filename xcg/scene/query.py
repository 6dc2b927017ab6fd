"""Questions to a scene: what it holds, its box, its groups, and what a call needs of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.scene.schema import BOX, COMPONENTS, SceneError, Setup


def require_scene(ds: xr.Dataset, names: Sequence[str], purpose: str) -> None:
    """Refuse a Dataset that lacks variables; the message lists all that is missing.

    Raises
    ------
    SceneError
        If `ds` is not a scene or lacks any of `names`.
    """
    missing = [name for name in ("position", "particle_id", *names) if name not in ds]
    if missing:
        msg = (
            f"{purpose} needs {sorted(set(missing))}, which this Dataset does not hold (it has "
            f"{sorted(map(str, ds.data_vars))}); open it with xcg.open_scene or build it with xcg.scene_from_arrays, "
            "giving contacts= for fields of contacts and density= where files hold no mass"
        )
        raise SceneError(msg)


def _require_numbers(times: NDArray, purpose: str) -> None:
    """Refuse dates and durations of NumPy, whose numbers are nanoseconds or the like."""
    if times.dtype.kind not in "fiu":
        msg = f"{purpose}: expected times as numbers (s), and these are {times.dtype}; ds.assign_coords(time=seconds)"
        raise SceneError(msg)


def check_times(time: NDArray, purpose: str, way_out: str) -> None:
    """Refuse times (t,) that are not finite or do not rise from step to step; the message says which."""
    _require_numbers(time, purpose)
    late = np.flatnonzero(~(time[1:] > time[:-1]))
    if not np.isfinite(time).all() or late.size:
        found = f"{time[late[0] + 1]} follows {time[late[0]]} at index {late[0] + 1}" if late.size else f"{time}"
        msg = f"{purpose} needs finite times that rise from step to step, and {found}; {way_out}"
        raise SceneError(msg)


def require_rising_times(ds: xr.Dataset, purpose: str) -> None:
    """Refuse a series whose times do not rise, as after a selection or joining: rates would be wrong."""
    check_times(ds["time"].to_numpy(), purpose, "order the steps with ds.sortby('time').drop_duplicates('time')")


def evenly_spaced(values: NDArray, what: str) -> float:
    """Return the distance of numbers that rise by equal steps; refuse others, as `what`."""
    _require_numbers(values, what)
    steps = np.diff(values)
    if not (steps > 0).all() or not np.allclose(steps, steps[0], rtol=1e-4, atol=0.0):
        msg = f"{what} at equal distances are needed, and these are {steps.min():.6g} to {steps.max():.6g} apart"
        raise SceneError(msg)
    return float((values[-1] - values[0]) / len(steps))


def setup_of(ds: xr.Dataset) -> Setup:
    """Return what a scene's attributes say."""
    gravity = ds.attrs.get("gravity")
    setup = Setup.make(
        periodic=ds.attrs.get("periodic", ""),
        gravity=None if gravity is None else np.asarray(gravity, float).tolist(),
        dimension=int(ds.attrs.get("dimension", 3)),
        plane=ds.attrs.get("plane"),
        thickness=ds.attrs.get("thickness"),
    )
    return replace(setup, unit_system=ds.attrs.get("unit_system", "SI"))


# A lazy variable that is as it was when its attributes were measured has an encoding: this mark, or what came with a
# file that holds the attributes, too. Selections keep encodings, arithmetic drops them.
MEASURED = "measured"


def mark_measured(ds: xr.Dataset, names: Sequence[str] | None = None) -> xr.Dataset:
    """Note that the attributes measured from some variables (all by default) are those of what they are now."""
    for name in ds.data_vars if names is None else names:
        ds[name].encoding[MEASURED] = True
    return ds


def known_without_reading(ds: xr.Dataset, name: str) -> bool:
    """Whether a variable is in memory, or as it was when its attributes were measured."""
    given = ds.variables[name]
    return isinstance(given._data, np.ndarray) or bool(given.encoding)


def numbers_of(given: xr.Variable) -> NDArray:
    """Return the array of a variable, at once where it is in memory: xarray looks for other kinds of arrays first."""
    if isinstance(given._data, np.ndarray):
        return given._data
    return given.values if isinstance(given, xr.IndexVariable) else given.to_numpy()


def groups_of(ds: xr.Dataset, by: str, groups: Sequence[int] | None) -> tuple[int, ...]:
    """Values of an integer variable of the particles, sorted: given, or known without reading."""
    if by not in ds or ds[by].dtype.kind not in "iu" or "particle" not in ds[by].dims:
        whole = [
            n for n in ds.data_vars if ds[n].dtype.kind in "iu" and "particle" in ds[n].dims and n != "particle_id"
        ]
        msg = f"by={by!r}: expected an integer variable of the particles; this scene has {whole}"
        raise ValueError(msg)
    if groups is None and isinstance(ds[by].variable._data, np.ndarray):
        valid = ds["particle_id"].to_numpy() >= 0
        groups = np.unique(ds[by].transpose(*ds["particle_id"].dims).to_numpy()[valid]).tolist()
    elif groups is None and known_without_reading(ds, by):
        groups = np.atleast_1d(ds.attrs.get(f"{by}_values", [])).tolist()
    if not groups:
        msg = f"by={by!r}: its values are not known without reading the series; pass groups= with all that occur"
        raise ValueError(msg)
    return tuple(sorted({int(g) for g in groups}))


def edges_of(ds: xr.Dataset) -> dict[str, tuple[float, float]]:
    """Edges of the box of the first step along the axes where it is finite.

    A box in memory is looked at, and for a lazy one the attributes, which hold a box that does not change. Where a lazy
    box changes, the six numbers of the first step are read.
    """
    box, lower, upper = None, ds.attrs.get("box_lower"), ds.attrs.get("box_upper")
    given = ds.variables["box"] if "box" in ds else None
    if given is not None and given.size and (given.chunks is None or lower is None or upper is None):
        first = given.isel({dim: 0 for dim in given.dims if dim not in ("component", "bound")})  # "step", too
        box = first.transpose("component", "bound").to_numpy()
    elif lower is not None and upper is not None:
        box = np.stack([lower, upper], axis=1)
    if box is None:
        return {}
    return {a: (float(low), float(high)) for a, (low, high) in zip(COMPONENTS, box, strict=True) if high - low < np.inf}


def axes_that_stay(ds: xr.Dataset) -> str:
    """Axes along which the edges of a box that is not tilted are the same in all steps; see `box_stays`."""
    if box_stays(ds):
        return "".join(COMPONENTS)
    if "box" not in ds or ds.variables["box"].chunks is not None:
        return ""
    box = ds.variables["box"].transpose("time", "component", ...).to_numpy()
    return "".join(a for a, edges in zip(COMPONENTS, box.swapaxes(0, 1), strict=True) if (edges == edges[:1]).all())


def box_stays(ds: xr.Dataset) -> bool:
    """Whether the box is the same in all steps; a lazy one is not read, as attributes hold a box that stays."""
    if "box" not in ds or ds.variables["box"].chunks is not None:
        return "box_lower" in ds.attrs and "lattice" not in ds
    if ds.sizes["time"] == 1:
        return True
    parts = [ds.variables[name].transpose("time", ...).to_numpy() for name in BOX if name in ds]
    return all(bool((part == part[:1]).all()) for part in parts)
