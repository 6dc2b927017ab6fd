"""Frames, one step of a scene as plain arrays, and back; times of the steps; sizes and extent of the particles."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.checks import is_whole
from xcg.common.compat import is_in_memory
from xcg.common.messages import SceneError, plain
from xcg.scene.conform import require_scene, takes_scene
from xcg.scene.lattice import Lattice
from xcg.scene.schema import (
    BOX,
    MAX_GROUPS,
    NUMBERED,
    OF_STEP,
    PADDING,
    VARIABLES,
    Frame,
    known_without_reading,
    mark_measured,
    units_in,
    variable,
)

T = TypeVar("T", xr.Dataset, xr.DataArray)


def _require_numbers(times: NDArray, purpose: str) -> None:
    """Raise SceneError for dates and durations of NumPy, whose numbers are nanoseconds or the like."""
    if times.dtype.kind not in "fiu":
        raise SceneError(
            f"{purpose}: expected times as numbers (s), and these are {times.dtype}; ds.assign_coords(time=seconds)"
        )


def check_times(time: NDArray, purpose: str, way_out: str) -> None:
    """Raise SceneError for times (t,) that are not finite or do not rise; name the step."""
    _require_numbers(time, purpose)
    late = np.flatnonzero(~(time[1:] > time[:-1]))
    if not np.isfinite(time).all() or late.size:
        times = f"{time}"
        if late.size:
            times = f"{time[late[0] + 1]} follows {time[late[0]]} at index {late[0] + 1}"
        raise SceneError(
            f"{purpose} needs finite times that rise from step to step, and {times}; {way_out}"
        )


def require_rising_times(ds: xr.Dataset, purpose: str) -> None:
    """Raise SceneError for a series whose times do not rise, as after a selection or joining: rates would be wrong."""
    check_times(
        ds["time"].to_numpy(),
        purpose,
        "order the steps with ds.sortby('time').drop_duplicates('time')",
    )


def times_are_known(ds: xr.Dataset) -> bool:
    """Return whether the coordinate time holds times, and not the numbers of the steps in their place.

    Arithmetic keeps attributes, so that assigned times may still be labelled as numbers; they
    differ from the steps, and where these are lazy, they are not whole.
    """
    if ds["time"].attrs.get("long_name") != NUMBERED:
        return True
    if "step" not in ds.coords:
        return False
    times = ds["time"].to_numpy()
    if ds["step"].chunks is not None:
        return bool((times % 1 != 0).any())
    return not np.array_equal(times, ds["step"])


def unit_of_times(ds: xr.Dataset) -> str:
    """Return the unit of differences of times: "1" where the times are not known."""
    if not times_are_known(ds):
        return "1"
    return units_in("s", str(ds.attrs.get("unit_system", "SI")))


def require_known_times(ds: xr.Dataset, purpose: str) -> None:
    """Raise SceneError for a series whose times are numbers of steps: rates would have a wrong unit."""
    if not times_are_known(ds):
        raise SceneError(
            f"{purpose}: the times of the steps are not known, and 'time' holds the numbers of the steps; give "
            "timestep= or times= in open_scene, time= in scene_from_arrays, or ds.assign_coords(time=seconds)"
        )


def require_times(ds: xr.Dataset, purpose: str) -> None:
    """Raise SceneError for a series whose times are not known, or do not rise."""
    require_known_times(ds, purpose)
    require_rising_times(ds, purpose)


def evenly_spaced(values: NDArray, what: str) -> float:
    """Return the distance of numbers that rise by equal steps; refuse others, as `what`."""
    _require_numbers(values, what)
    steps = np.diff(values)
    if not (steps > 0).all() or not np.allclose(steps, steps[0], rtol=1e-4, atol=0.0):
        raise SceneError(
            f"{what} at equal distances are needed, and these are {steps.min():.6g} to {steps.max():.6g} apart"
        )
    return float((values[-1] - values[0]) / len(steps))


def with_rising(f: T, dims: Iterable[str]) -> T:
    """Sort data along dimensions whose coordinates do not rise, as after ``isel(x=slice(None, None, -1))``."""
    indexes = {dim: f.indexes[dim] for dim in dims if dim in f.indexes}
    others = [dim for dim, index in indexes.items() if not index.is_monotonic_increasing]
    if not others:
        return f
    return f.sortby(others)


def with_time(ds: xr.Dataset) -> xr.Dataset:
    """Name the dimension of the steps "time" where it goes by their numbers (``swap_dims(time="step")``)."""
    if "step" in ds.sizes and "time" not in ds.sizes and "time" in ds.coords:
        ds = ds.swap_dims(step="time")
    return ds


def require_steps(ds: xr.Dataset, purpose: str) -> None:
    """Raise SceneError for data whose dimension of time is empty, as after a selection."""
    if not ds.sizes.get("time", 1):
        raise SceneError(f"{purpose}: there is no step; select one at least")


def step_at(ds: xr.Dataset, index: int) -> xr.Dataset:
    """Select a step by its position; data without a dimension of time are one step.

    Raises
    ------
    ValueError
        If the step does not exist, or none.
    """
    ds = with_time(ds)
    require_steps(ds, f"index={plain(index)}")
    count = ds.sizes.get("time", 1)
    if not (isinstance(index, int | np.integer) and is_whole(index, -count, count - 1)):
        raise ValueError(
            f"index={plain(index)}: expected the position of a step, a whole number from {-count} to {count - 1}; "
            "select a time by .sel(time=...)"
        )
    if "time" in ds.sizes:
        ds = ds.isel(time=int(index))
    return ds


def frame_at(ds: xr.Dataset, index: int, names: Iterable[str]) -> tuple[Frame, Lattice, str]:
    """Compute some variables of the step at a position: its frame, periodic images and name; errors as `step_at`."""
    step = step_at(ds, index)
    wanted = {*names, *OF_STEP}
    step = step[[name for name in step.variables if name in wanted]].compute()
    arrays = {
        str(name): values.to_numpy()[None]
        for name, values in step.variables.items()
        if name in wanted
    }
    return next(steps_in(arrays, str(ds.attrs.get("periodic", ""))))


def stack(frames: Sequence[Frame], names: Sequence[str], rows: int) -> Frame:
    """Stack frames along a new first axis, padded to `rows` rows; one frame that fills them is not copied."""
    stacked = {}
    for name in names:
        row = variable(name, frames[0][name].dtype, frames[0][name].ndim)
        if len(frames) == 1 and len(frames[0][name]) == rows:
            stacked[name] = np.ascontiguousarray(frames[0][name], row.dtype)[None]
            continue
        out = np.empty((len(frames), *row.shape(rows)), row.dtype)
        for t, frame in enumerate(frames):
            out[t, : len(frame[name])] = frame[name]
            out[t, len(frame[name]) :] = row.fill
        stacked[name] = out
    return stacked


def particle_rows(ids: NDArray, source: str = "scene") -> slice | NDArray:
    """Rows of the particles of one padded step, by id: a slice where they are sorted already.

    Raises
    ------
    SceneError
        If an id occurs twice.
    """
    count = np.count_nonzero(ids != PADDING)
    if (ids[:count] != PADDING).all() and (ids[1:count] > ids[: max(count - 1, 0)]).all():
        return slice(0, count)
    rows = np.flatnonzero(ids != PADDING)
    rows = rows[np.argsort(ids[rows], kind="stable")]
    twice = np.flatnonzero(np.diff(ids[rows]) == 0)
    if twice.size:
        one, other = rows[twice[0] : twice[0] + 2]
        raise SceneError(
            f"{source}: particle id {ids[one]} occurs twice (rows {one} and {other}); ids must be unique: select parts "
            "that do not overlap before they are joined, or give the particles of one part other ids"
        )
    return rows


def frame_of(
    arrays: Mapping[str, NDArray],
    t: int,
    source: str = "scene",
    dims: Mapping[str, str] | None = None,
) -> Frame:
    """Return a frame of padded arrays: the rows of step `t` without padding, particles by id.

    `dims` holds the dimension of the rows of each variable, by default that of its name; arrays
    along other dimensions than particles and contacts are whole.

    Raises
    ------
    SceneError
        If an id occurs twice, or a variable of scenes is not finite in one of these rows.
    """
    rows: dict[str, Any] = {}
    if "particle_id" in arrays:
        rows["particle"] = particle_rows(arrays["particle_id"][t], source)
    if "contact_i" in arrays:
        valid = arrays["contact_i"][t] != PADDING
        count = np.count_nonzero(valid)
        rows["contact"] = slice(0, count) if valid[:count].all() else valid
    found: Frame = {}
    for name, values in arrays.items():
        row = variable(name, values.dtype, values.ndim - 1)
        dim = row.dims[0] if dims is None else dims[name]
        # as loops are compiled for: files may hold bytes or axes the other way round
        if dim in rows:
            found[name] = values[t][rows[dim]].astype(row.dtype, order="C", copy=False)
        elif dims is not None:
            found[name] = values[t]
    for name in found:
        if name in VARIABLES:
            check_finite(name, found, source)
    return found


def check_finite(name: str, frame: Frame, source: str) -> None:
    """Raise SceneError for a variable that is not finite in a row of data, as an assigned one may be."""
    if frame[name].dtype.kind != "f" or np.isfinite(frame[name]).all():
        return
    row = int(np.argwhere(~np.isfinite(frame[name]))[0][0])
    if variable(name).dims[0] == "contact":
        whose = f"contact row {row}"
    else:
        whose = f"particle {frame['particle_id'][row]}"
    raise SceneError(
        f"{source}: {name!r} of {whose} is {frame[name][row]}; every row must hold finite numbers: repair it, or leave "
        "the row out of the scene"
    )


def phase_of(frame: Frame, by: str | None, groups: Sequence[int], source: str) -> NDArray:
    """Return the group of each particle; raise SceneError for particles without one."""
    count = len(frame["position"])
    if by is None:
        return np.zeros(count, "int64")
    values = frame[by]
    known = np.asarray(groups)
    row = np.minimum(np.searchsorted(known, values), len(known) - 1)
    strange = np.flatnonzero(known[row] != values)
    if strange.size:
        raise SceneError(
            f"{source}: particle {frame['particle_id'][strange[0]]} has {by}={values[strange[0]]}, which is not among "
            f"the groups {list(groups)}; pass groups= with every value that occurs"
        )
    return row


def without_frozen(frame: Frame) -> Frame:
    """Drop frozen grains; contacts with them become contacts with a wall, as their partner is not there."""
    if "frozen" not in frame:
        return frame
    free = frame["frozen"] != 1
    particles = {
        name: values[free]
        for name, values in frame.items()
        if not name.startswith(("contact", "overlap"))
    }
    return {**frame, **particles}


def steps_in(
    arrays: Mapping[str, NDArray], periodic: str, dims: Mapping[str, str] | None = None
) -> Iterator[tuple[Frame, Lattice, str]]:
    """Yield frame, periodic images and name of each step of padded arrays; `dims` as in `frame_of`."""
    rows = {name: a for name, a in arrays.items() if name not in (*OF_STEP, "time")}
    for t in range(len(next(iter(rows.values())))):
        source = f"frame {t} of its chunk"
        if "step" in arrays:
            source = f"step {arrays['step'][t]}"
        box = {name: arrays[name][t] for name in BOX if name in arrays}
        yield frame_of(rows, t, source, dims), Lattice.of(box, periodic, source), source


# --- sizes and extent: of a set of particles, of a scene, of each step -----------------------------------

_SIZE_NAMES = {
    "d43": "volume-weighted mean diameter",
    "d32": "surface-weighted mean diameter",
    "d50": "median diameter by mass",
    "drms": "root mean square diameter",
    "dmin": "smallest diameter",
    "dmax": "largest diameter",
}
SIZES = tuple(_SIZE_NAMES)


def sizes_of(diameter: NDArray, mass: NDArray | None = None) -> dict[str, float]:
    """Sizes of a set of particles (m); NaN for an empty one.

    ``d43 = S d^4 / S d^3``, ``d32 = S d^3 / S d^2``, ``drms = sqrt(S d^2 / n)``, ``d50`` the
    diameter below which half of the mass lies (of the volume, where no mass is given), ``dmin`` and
    ``dmax``.
    """
    if not len(diameter):
        return dict.fromkeys(SIZES, float("nan"))
    d = np.sort(diameter)
    squares, cubes, fourths = [(d**k).sum() for k in (2, 3, 4)]
    # powers of zero: NaN, which no width may be
    with np.errstate(invalid="ignore", divide="ignore"):
        d32 = float(cubes / squares)
        d43 = float(fourths / cubes)
    smallest = float(d[0])
    largest = float(d[-1])
    del d
    return {
        "d43": d43,
        "d32": d32,
        "d50": _median_by(diameter, diameter**3 if mass is None else mass),
        "drms": float(np.sqrt(squares / len(diameter))),
        "dmin": smallest,
        "dmax": largest,
    }


_BINS = 4096  # of values, to find those that their median by weight is among


def _median_by(values: NDArray, weights: NDArray) -> float:
    """Return the smallest of the values up to which half of the weight lies. Only those near it are sorted."""
    near = np.arange(len(values))
    below = 0.0
    total = weights.sum()
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        per_value = (_BINS - 1) / (values.max() - values.min())
    if len(values) > _BINS and np.isfinite(per_value) and weights.min() >= 0:
        scaled = values - values.min()
        scaled *= per_value
        place = scaled.astype("int16")
        sums = np.cumsum(np.bincount(place, weights, _BINS))
        total = sums[-1]
        middle = int(np.searchsorted(sums, 0.5 * total))
        near = np.flatnonzero(place == middle)
        if middle:
            below = sums[middle - 1]
    near = near[np.argsort(values[near])]
    up_to = below + np.cumsum(weights[near])
    # the last one where rounding keeps the sum below its half
    return float(values[near[min(np.searchsorted(up_to, 0.5 * total), len(near) - 1)]])


_OF_SIZE = ("diameter", "mass")  # which sizes follow from


def measured_variables(frame: Frame) -> Frame:
    """Return what `measure_frames` looks at; all other memory of the frame can go before.

    Of positions these are the lowest and highest ones (2, 3), of integer variables the values that
    they take.
    """
    measured: Frame = {name: frame[name] for name in _OF_SIZE if name in frame}
    if "position" in frame and len(frame["position"]):
        # axis by axis: along the first axis of an array (n, 3) NumPy takes many times as long
        axes = frame["position"].T
        measured["position"] = np.array([[x.min() for x in axes], [x.max() for x in axes]])
    for name, values in frame.items():
        is_number = values.dtype.kind == "i" and values.ndim == 1
        if is_number and name not in ("particle_id", *_OF_SIZE):
            measured[name] = _different(values)
    return measured


def measure_frames(frames: Iterable[Frame]) -> dict[str, Any]:
    """Sizes and extent of particles, as attributes: what default widths and bounds follow from.

    The sizes of `sizes_of`, the lowest and highest coordinates of the centres, and the values that
    integer variables take (``species_values``), over all the frames given, one of which is held
    whole at a time. Frames may be such as `measured_variables` returns.
    """
    measured: dict[str, Any] = {}
    parts = [measured_variables(frame) for frame in frames]
    corners = [part["position"] for part in parts if "position" in part]
    if corners:
        measured["particle_lower"] = np.min(corners, axis=(0, 1))
        measured["particle_upper"] = np.max(corners, axis=(0, 1))
    diameters = [part["diameter"] for part in parts if "diameter" in part]
    if diameters and sum(map(len, diameters)):
        masses = [part["mass"] for part in parts if "mass" in part]
        mass = None
        if len(masses) == len(diameters):
            mass = _joined(masses)
        measured |= sizes_of(_joined(diameters), mass)
    for name in dict.fromkeys(name for part in parts for name in part):
        if name not in ("position", *_OF_SIZE):
            unique = np.unique(np.concatenate([part[name] for part in parts if name in part]))
            if 0 < len(unique) <= MAX_GROUPS:
                measured[f"{name}_values"] = unique
    return measured


def _joined(arrays: Sequence[NDArray]) -> NDArray:
    """Return arrays one after the other; a single one is not copied."""
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)


def _different(values: NDArray) -> NDArray:
    """Return the different values of whole numbers, sorted; by counting where they are few."""
    if not len(values):
        return values
    lowest = int(values.min())
    highest = int(values.max())
    if highest - lowest < len(values):
        return np.flatnonzero(np.bincount(values - lowest)) + lowest
    return np.unique(values)


_RANGES = {"position": ("particle_lower", "particle_upper"), "diameter": ("dmin", "dmax")}
MEASURED_ATTRIBUTES = {"position": _RANGES["position"], "diameter": SIZES}


def without_attrs(ds: xr.Dataset, names: Collection[str]) -> xr.Dataset:
    """Return the scene without some of its attributes."""
    return ds.drop_attrs(deep=False).assign_attrs(
        {k: v for k, v in ds.attrs.items() if k not in names}
    )


def with_measures(ds: xr.Dataset) -> xr.Dataset:
    """Return the scene with such sizes and extent as its attributes as hold for its particles. Nothing is read.

    Variables may have been replaced since they were measured. Those in memory are looked at: where
    grains of the first or the last step lie outside the extent, the extent of these steps is
    measured anew, and the sizes where diameters lie outside their range: places say nothing of
    sizes. Attributes of lazy variables that were computed from others are left out.
    """
    of = {name: attrs for name, attrs in MEASURED_ATTRIBUTES.items() if name in ds}
    lost = {attr for name in of if not known_without_reading(ds, name) for attr in of[name]} & set(
        ds.attrs
    )
    if lost:
        ds = without_attrs(ds, lost)
    order = ("time", "particle", ...)
    given = {n: ds.variables[n] for n in ("particle_id", *of, "mass") if n in ds}
    arrays = {
        name: v.transpose(*order).to_numpy()
        for name, v in given.items()
        if "time" in v.dims and is_in_memory(v)
    }
    ends: list[Frame] = []
    if "particle_id" in arrays and ds.sizes["time"]:
        for t in sorted({0, ds.sizes["time"] - 1}):
            valid = arrays["particle_id"][t] != PADDING
            rows = slice(None) if valid.all() else valid  # without a copy where they are all
            ends.append({name: a[t][rows] for name, a in arrays.items()})
    outside = {
        attr
        for name in of
        if not all(_within(name, frame, ds.attrs) for frame in ends)
        for attr in of[name]
    }
    if outside:
        measured = measure_frames(ends)
        ds = ds.assign_attrs({attr: measured[attr] for attr in outside & set(measured)})
    return ds


def _within(name: str, frame: Frame, known: Mapping[Any, Any]) -> bool:
    """Return whether positions or diameters of a frame lie inside the range of them that is known."""
    values = frame.get(name)
    if values is None or not len(values):
        return True
    low, high = _RANGES[name]
    if low not in known:
        return False
    lower, upper = (np.ravel(known[end]) for end in (low, high))
    small = 1e-9 * np.abs([lower, upper]).max()
    inside = zip(np.atleast_2d(values.T), lower - small, upper + small, strict=True)
    return all(x.min() >= least and x.max() <= most for x, least, most in inside)


# --- measured on request ---------------------------------------------------------------------------------


def measure(ds: xr.Dataset) -> xr.Dataset:
    """Measure sizes and extent of all steps of a scene and store them as attributes (computes).

    Returns
    -------
    xarray.Dataset
        The same scene with the attributes of `sizes_of`, particle_lower and particle_upper set
        anew.
    """
    require_scene(ds, (), "measure")
    return _measure(
        without_attrs(ds, {attr for attrs in MEASURED_ATTRIBUTES.values() for attr in attrs})
    )


@takes_scene
def _measure(ds: xr.Dataset) -> xr.Dataset:
    names = [
        str(name)
        for name, values in ds.data_vars.items()
        if "particle" in values.dims
        and (name in ("position", *_OF_SIZE) or values.dtype.kind == "i")
    ]

    def frame(t: int) -> Frame:
        step = ds[names].isel(time=[t]).compute()
        arrays = {name: step[name].transpose("time", ...).to_numpy() for name in names}
        return frame_of(arrays, 0, f"step {t}")

    measured = measure_frames(frame(t) for t in range(ds.sizes["time"]))
    return mark_measured(ds.assign_attrs(measured))


@takes_scene
def size_statistics(ds: xr.Dataset) -> xr.Dataset:
    """Sizes of the grains in each step, lazy where the scene is.

    ``d43 = S d^4 / S d^3``, ``d32 = S d^3 / S d^2``, ``drms = sqrt(S d^2 / n)``, ``d50`` the
    diameter below which half of the mass lies, ``dmin``, ``dmax``.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with ``diameter``, and ``mass`` (else d50 is by volume).

    Returns
    -------
    xarray.Dataset
        Variables (time,) in m; NaN for steps without grains.

    Raises
    ------
    SceneError
        If the scene holds no diameters.
    """
    require_scene(ds, ("diameter",), "size_statistics")
    weight = ds["mass"] if "mass" in ds else ds["diameter"] ** 3
    inputs = [a.chunk(particle=-1) if a.chunks is not None else a for a in (ds["diameter"], weight)]
    if not ds.sizes["particle"]:  # which dask takes no function over
        inputs = [a.compute() for a in inputs]
    table = xr.apply_ufunc(
        _sizes_of_rows,
        *inputs,
        input_core_dims=[["particle"]] * 2,
        output_core_dims=[["size"]],
        dask="parallelized",
        output_dtypes=[float],
        dask_gufunc_kwargs={"output_sizes": {"size": len(SIZES)}},
    )
    units = units_in("m", ds.attrs.get("unit_system", "SI"))
    out = {
        name: table.isel(size=k).assign_attrs(units=units, long_name=_SIZE_NAMES[name])
        for k, name in enumerate(SIZES)
    }
    return xr.Dataset(out)


def _sizes_of_rows(diameter: NDArray, weight: NDArray) -> NDArray:
    out = np.empty((*diameter.shape[:-1], len(SIZES)))
    for at in np.ndindex(diameter.shape[:-1]):
        here = np.isfinite(diameter[at])
        found = sizes_of(diameter[at][here], weight[at][here])
        out[at] = [found[name] for name in SIZES]
    return out
