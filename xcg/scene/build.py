"""Scenes: many frames in one Dataset, built from arrays, checked, measured, summed up."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from xcg.scene.complete import complete_contacts, complete_particles, periods
from xcg.scene.conform import takes_scene
from xcg.scene.schema import (
    BOX,
    COMPONENTS,
    MAX_GROUPS,
    PADDING,
    VARIABLES,
    Frame,
    SceneError,
    Setup,
    did_you_mean,
    units_of,
    variable,
)

SIZES = ("d43", "d32", "d50", "drms", "dmin", "dmax")

# --- many frames: the Dataset ----------------------------------------------------------------------------


def stack(frames: Sequence[Frame], names: Sequence[str], rows: int) -> Frame:
    """Stack frames along a new first axis, padded to `rows` rows."""
    stacked = {}
    for name in names:
        row = variable(name, frames[0][name].dtype)
        out = np.full((len(frames), *row.shape(rows)), row.fill, row.dtype)
        for t, frame in enumerate(frames):
            out[t, : len(frame[name])] = frame[name]
        stacked[name] = out
    return stacked


def sizes_of(diameter: NDArray, mass: NDArray | None = None) -> dict[str, float]:
    """Sizes of a set of particles (m); NaN for an empty one.

    ``d43 = S d^4 / S d^3``, ``d32 = S d^3 / S d^2``, ``drms = sqrt(S d^2 / n)``, ``d50`` the diameter below which half
    of the mass lies (of the volume, where no mass is given), ``dmin`` and ``dmax``.
    """
    if not len(diameter):
        return dict.fromkeys(SIZES, float("nan"))
    order = np.argsort(diameter, kind="stable")
    d = diameter[order]
    share = np.cumsum(d**3 if mass is None else mass[order])
    sums = [(d**k).sum() for k in range(5)]
    with np.errstate(invalid="ignore", divide="ignore"):  # powers of zero: NaN, which no width may be
        ratios = [float(sums[k] / sums[k - 1]) for k in (3, 4)]
    return {
        "d43": ratios[1],
        "d32": ratios[0],
        "d50": float(d[np.searchsorted(share, 0.5 * share[-1])]),
        "drms": float(np.sqrt(sums[2] / sums[0])),
        "dmin": float(d[0]),
        "dmax": float(d[-1]),
    }


def measure_frames(frames: Sequence[Frame]) -> dict[str, Any]:
    """Sizes and extent of particles, as attributes: what default widths and bounds follow from.

    The sizes of `sizes_of`, the lowest and highest coordinates of the centres, and the values that integer variables
    take (``species_values``), over all the frames given.
    """
    measured: dict[str, Any] = {}
    positions = [f["position"] for f in frames if "position" in f and len(f["position"])]
    if positions:
        measured["particle_lower"] = np.min([p.min(axis=0) for p in positions], axis=0)
        measured["particle_upper"] = np.max([p.max(axis=0) for p in positions], axis=0)
    diameters = [f["diameter"] for f in frames if "diameter" in f]
    if diameters and sum(map(len, diameters)):
        masses = [f["mass"] for f in frames if "mass" in f]
        whole = len(masses) == len(diameters)
        measured |= sizes_of(np.concatenate(diameters), np.concatenate(masses) if whole else None)
    for name in frames[0] if frames else ():
        values = [f[name] for f in frames if f[name].dtype.kind == "i"]
        if values and name != "particle_id":
            unique = np.unique(np.concatenate(values))
            if 0 < len(unique) <= MAX_GROUPS:
                measured[f"{name}_values"] = unique
    return measured


def to_dataset(
    arrays: Mapping[str, Any],
    *,
    time: ArrayLike,
    step: ArrayLike,
    box: NDArray | None,
    setup: Setup,
    measured: Mapping[str, Any],
) -> xr.Dataset:
    """Label padded arrays (NumPy or dask, time first) as a scene.

    Parameters
    ----------
    arrays : mapping
        Padded arrays by scene name, time first.
    time, step : array (t,)
        Times (s) and step numbers.
    box : array (t, 3, 2) or None
        Edges of the domain.
    """
    data = {}
    for name, values in arrays.items():
        row = variable(name, values.dtype)
        attrs = {"units": units_of(row.powers, setup.unit_system), "long_name": row.long_name}
        data[name] = xr.Variable(("time", *row.dims), values, attrs)
    if box is not None:
        attrs = {"units": units_of(BOX.powers, setup.unit_system), "long_name": BOX.long_name}
        data["box"] = xr.Variable(("time", *BOX.dims), box, attrs)
    second = "s" if setup.unit_system == "SI" else "1"
    coords = {
        "time": ("time", np.asarray(time, float), {"units": second, "long_name": "time", "axis": "T"}),
        "step": ("time", np.asarray(step, "int64"), {"units": "1", "long_name": "number of the time step"}),
        "component": ("component", list(COMPONENTS)),
    }
    if box is not None and (box == box[:1]).all():  # attributes stay with every selection of steps
        measured = {"box_lower": box[0, :, 0], "box_upper": box[0, :, 1], **measured}
    about: dict[str, Any] = {
        "Conventions": "CF-1.11",
        "periodic": setup.periodic,
        "dimension": setup.dimension,
        "plane": setup.plane,
        "unit_system": setup.unit_system,
        **({} if setup.gravity is None else {"gravity": np.asarray(setup.gravity)}),
        **({} if setup.thickness is None else {"thickness": setup.thickness}),
        **measured,
    }
    return mark_measured(storable(xr.Dataset(data, coords, about)))


def storable(ds: xr.Dataset) -> xr.Dataset:
    """Have text coordinates stored without a fixed length: no other text is in the specification of Zarr 3."""
    for name, coordinate in ds.coords.items():
        if coordinate.dtype.kind == "U":
            ds[name].encoding["dtype"] = object
    return ds


_BOX_FORMS = "six numbers as [[x0, x1], [y0, y1], [z0, z1]], or a mapping {'x': (x0, x1), ...}"


def box_array(box: ArrayLike | Mapping[str, Sequence[float]], steps: int) -> NDArray:
    """Edges of the domain as an array (steps, 3, 2); axes left out of a mapping are unbounded."""
    if isinstance(box, Mapping):
        wrong = set(box) - set(COMPONENTS)
        if wrong:
            msg = f"box has keys {sorted(wrong)}: expected {_BOX_FORMS}"
            raise SceneError(msg)
        box = [box.get(axis, (-np.inf, np.inf)) for axis in COMPONENTS]
    edges = np.asarray(box, float)
    if edges.shape not in ((3, 2), (steps, 3, 2)):
        msg = f"box has shape {edges.shape}: expected {_BOX_FORMS}, or one such array a step"
        raise SceneError(msg)
    if not (edges[..., 0] < edges[..., 1]).all():
        msg = f"box={box!r}: the lower edge of every axis must lie below the upper edge"
        raise SceneError(msg)
    return np.broadcast_to(edges, (steps, 3, 2)).copy()


def _refuse_mask(name: str, values: Any) -> None:
    """Refuse masked values: what stands below the mask would count."""
    if np.ma.is_masked(values):
        msg = (
            f"'{name}' is a masked array with {np.ma.count_masked(values)} masked values; leave out such rows of all "
            "variables, by giving a list of steps of different length, or fill them"
        )
        raise SceneError(msg)


def _split_steps(name: str, values: Any) -> list[NDArray]:
    """Arrays of one step each, from one step, a stack of steps, or a list of steps of different length."""
    for part in values if isinstance(values, (list, tuple)) else [values]:
        _refuse_mask(name, part)
    if isinstance(values, (list, tuple)) and len(values) and np.ndim(values[0]) == len(variable(name).dims):
        return [np.asarray(v) for v in values]
    array = np.asarray(values)
    dims = len(variable(name).dims)
    if array.ndim == dims:
        return [array]
    if array.ndim == dims + 1:
        return list(array)
    msg = f"'{name}' has shape {array.shape}: expected {dims} dimensions for one step, or {dims + 1} with time first"
    raise SceneError(msg)


def scene_from_arrays(
    position: Any,
    *,
    time: ArrayLike | None = None,
    step: ArrayLike | None = None,
    box: ArrayLike | Mapping[str, Sequence[float]] | None = None,
    periodic: str = "",
    gravity: Sequence[float] | None = None,
    dimension: int = 3,
    plane: str | None = None,
    thickness: float | None = None,
    shape: str = "sphere",
    density: Any = None,
    units: Mapping[str, float] | str | None = None,
    allow_unknown: bool = False,
    **variables: Any,
) -> xr.Dataset:
    """Build a scene from arrays in memory.

    Every variable may be one step ``(n, ...)``, a stack of steps ``(t, n, ...)``, or a list of steps of
    different length. Mass, volume, density, diameter and contact points that are missing are completed
    (`complete_particles`, `complete_contacts`).

    Parameters
    ----------
    position : array (n, 3), array (t, n, 3) or list of arrays
        Positions of the centres (m).
    time, step : array (t,), optional
        Times (s), rising, and step numbers; 0, 1, 2, ... by default.
    box : array (3, 2), array (t, 3, 2) or mapping, optional
        Edges of the domain (m), needed along periodic axes.
    periodic : str
        Periodic axes, for example "xy".
    gravity : three floats, optional
        Acceleration of gravity (m s-2).
    dimension : {2, 3}
        2 for one layer of particles in `plane`.
    plane : str, optional
        The two axes of a one-layer scene, "xy" by default.
    thickness : float, optional
        Depth of a one-layer scene (m); by default that of the box where it is finite, else the largest diameter.
    shape : {"sphere", "disc"}
        How volume follows from diameter.
    density : float or array
        Density of the material (kg m-3): one number, or one a particle.
    units : mapping or "reduced", optional
        Factors from the data's units to SI, for example ``{"length": 1e-3}``; "reduced" for scaled data.
    allow_unknown : bool
        Take contacts with ids that are not among the particles as contacts with a wall.
    **variables
        Other variables by their scene name: ``velocity``, ``diameter``, ``mass``, ``volume``, ``particle_id``,
        ``species``, ``contact_i``, ``contact_j``, ``contact_force``, ``contact_point``, ... In a periodic box of less
        than two diameters ``contact_branch`` (from j to i) tells on which side grains touch, where no point does.
        Any other name is one value a particle of your own, but for names that are almost one of these.

    Returns
    -------
    xarray.Dataset
        The scene, in memory.

    Raises
    ------
    SceneError
        If arrays disagree or do not make a scene; the message names the variable and row.

    Examples
    --------
    >>> import xcg
    >>> ds = xcg.scene_from_arrays([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], diameter=[1.0, 1.0], density=2500.0)
    >>> dict(ds.sizes)
    {'time': 1, 'particle': 2, 'component': 3}
    """
    _refuse_misspelt(variables)
    one_density = density if np.ndim(density) == 0 else None
    setup = Setup.make(
        units=units, gravity=gravity, dimension=dimension, plane=plane, periodic=periodic, thickness=thickness,
        shape=shape, density=one_density,
    )  # fmt: skip
    given = {"position": position, **variables}
    if density is not None and one_density is None:
        given["density"] = density
    steps = {name: _split_steps(name, values) for name, values in given.items() if values is not None}
    counts = {name: len(values) for name, values in steps.items()}
    if len(set(counts.values())) > 1:
        msg = f"variables have different numbers of steps: {counts}"
        raise SceneError(msg)
    total = counts["position"]
    _refuse_mask("time", time)
    times = np.arange(total, dtype=float) if time is None else np.atleast_1d(np.asarray(time, float)) * setup.scales[2]
    numbers = np.arange(total) if step is None else np.atleast_1d(step)
    for name, values in (("time", times), ("step", numbers)):
        if values.shape != (total,):
            msg = f"{name}= has shape {values.shape}: expected one value for each of the {total} steps"
            raise SceneError(msg)
    check_times(times, "a scene", "sort the steps, and leave out those that stand twice")
    edges = None if box is None else box_array(box, total) * setup.factor(BOX.powers)
    particle_names = [name for name in steps if variable(name).dims[0] == "particle"]
    contact_names = [name for name in steps if variable(name).dims[0] == "contact"]
    particles, contacts = [], []
    for t in range(total):
        where = f"step {t}" if total > 1 else "scene"
        particles.append(complete_particles(_prefix(steps, particle_names, "particle_id", t), setup, where))
        if contact_names:
            frame = _prefix(steps, contact_names, "contact_i", t)
            box_t = None if edges is None else edges[t]
            contacts.append(complete_contacts(frame, particles[-1], box_t, setup, where, allow_unknown=allow_unknown))
        periods(None if edges is None else edges[t], setup.periodic, where)
    arrays: Frame = {}
    for frames, key in ((particles, "particle_id"), (contacts, "contact_i")):
        if frames:
            arrays |= stack(frames, list(frames[0]), max(len(f[key]) for f in frames))
    return to_dataset(
        arrays,
        time=times,
        step=numbers,
        box=edges,
        setup=setup,
        measured=measure_frames(particles),
    )


def _refuse_misspelt(names: Iterable[str]) -> None:
    """Refuse names of variables that are almost, but not quite, one that is known; ``diameter_2`` is one of its own."""
    known = [*VARIABLES, *inspect.signature(scene_from_arrays).parameters]
    for name in names:
        own = any(name.startswith(word) and not name[len(word) :][:1].isalpha() for word in known)
        likely = "" if own else did_you_mean(name, known, 0.77)
        if likely:
            msg = f"scene_from_arrays: {name!r} is neither an argument nor a variable of scenes{likely} Variables of "
            msg += "your own need names that are less alike"
            raise SceneError(msg)


def _prefix(steps: Mapping[str, list[NDArray]], names: Sequence[str], key: str, t: int) -> Frame:
    """Drop the rows of step t that `key` marks as padding."""
    frame = {name: steps[name][t] for name in names}
    if key in frame:
        valid = frame[key] != PADDING
        if not valid.all():
            frame = {name: values[valid] for name, values in frame.items()}
    return frame


# --- reading a scene -------------------------------------------------------------------------------------


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


def check_times(time: NDArray, purpose: str, way_out: str) -> None:
    """Refuse times (t,) that are not finite or do not rise from step to step; the message says which."""
    late = np.flatnonzero(~(time[1:] > time[:-1]))
    if not np.isfinite(time).all() or late.size:
        found = f"{time[late[0] + 1]!r} follows {time[late[0]]!r} at index {late[0] + 1}" if late.size else f"{time}"
        msg = f"{purpose} needs finite times that rise from step to step, and {found}; {way_out}"
        raise SceneError(msg)


def require_rising_times(ds: xr.Dataset, purpose: str) -> None:
    """Refuse a series whose times do not rise, as after a selection or joining: rates would be wrong."""
    check_times(ds["time"].to_numpy(), purpose, "order the steps with ds.sortby('time').drop_duplicates('time')")


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


def particle_rows(ids: NDArray, where: str = "scene") -> slice | NDArray:
    """Rows of the particles of one padded step, by id: a slice where they are sorted already.

    Raises
    ------
    SceneError
        If an id occurs twice.
    """
    count = int((ids != PADDING).sum())
    if (ids[:count] != PADDING).all() and (ids[1:count] > ids[: max(count - 1, 0)]).all():
        return slice(0, count)
    rows = np.flatnonzero(ids != PADDING)
    rows = rows[np.argsort(ids[rows], kind="stable")]
    twice = np.flatnonzero(np.diff(ids[rows]) == 0)
    if twice.size:
        one, other = rows[twice[0] : twice[0] + 2]
        msg = (
            f"{where}: particle id {ids[one]} occurs twice (rows {one} and {other}); ids must be unique: select parts "
            "that do not overlap before they are joined, or give the particles of one part other ids"
        )
        raise SceneError(msg)
    return rows


def frame_of(arrays: Mapping[str, NDArray], t: int, where: str = "scene") -> Frame:
    """One frame of padded arrays: the rows of step `t` that are not padding, particles by id."""
    rows: dict[str, Any] = {}
    if "particle_id" in arrays:
        rows["particle"] = particle_rows(arrays["particle_id"][t], where)
    if "contact_i" in arrays:
        valid = arrays["contact_i"][t] != PADDING
        count = int(valid.sum())
        rows["contact"] = slice(0, count) if valid[:count].all() else valid
    found: Frame = {}
    for name, values in arrays.items():
        row = variable(name, values.dtype)
        if row.dims[0] in rows:  # in the types of compiled loops: netCDF-3 holds bytes the other way round
            found[name] = values[t][rows[row.dims[0]]].astype(row.dtype, copy=False)
    return found


@takes_scene
def measure(ds: xr.Dataset) -> xr.Dataset:
    """Measure sizes and extent of all steps of a scene and store them as attributes (computes).

    Returns
    -------
    xarray.Dataset
        The same scene with the attributes of `sizes_of`, particle_lower and particle_upper set anew.
    """
    require_scene(ds, (), "measure")
    names = [str(name) for name in ds.data_vars if variable(str(name), ds[name].dtype).dims[0] == "particle"]
    frames = []
    for t in range(ds.sizes["time"]):
        arrays = {name: ds[name].isel(time=[t]).transpose("time", ...).to_numpy() for name in names}
        frames.append(frame_of(arrays, 0, f"step {t}"))
    return mark_measured(ds.assign_attrs(measure_frames(frames)))


# --- do measured attributes still hold? ------------------------------------------------------------------

# A lazy variable that is as it was when its attributes were measured has an encoding: this mark, or what came with a
# file that holds the attributes, too. Selections keep encodings, arithmetic drops them.
_MARK = "measured"
_ATTRIBUTES = {"position": ("particle_lower", "particle_upper"), "diameter": SIZES}


def mark_measured(ds: xr.Dataset, names: Sequence[str] | None = None) -> xr.Dataset:
    """Note that the attributes measured from some variables (all by default) are those of what they are now."""
    for name in ds.data_vars if names is None else names:
        ds[name].encoding[_MARK] = True
    return ds


def known_without_reading(ds: xr.Dataset, name: str) -> bool:
    """Whether a variable is in memory, or as it was when its attributes were measured."""
    given = ds[name].variable
    return isinstance(given._data, np.ndarray) or bool(given.encoding)


def with_measures(ds: xr.Dataset) -> xr.Dataset:
    """Return the scene with such sizes and extent as its attributes as hold for its particles. Nothing is read.

    Variables may have been replaced since they were measured. Those in memory are looked at: where grains of the first
    or the last step lie outside the extent or the range of sizes, these steps are measured anew. Attributes of lazy
    variables that were computed from others are left out.
    """
    of = {name: attrs for name, attrs in _ATTRIBUTES.items() if name in ds}
    lost = {attr for name in of if not known_without_reading(ds, name) for attr in of[name]} & set(ds.attrs)
    if lost:
        ds = ds.drop_attrs(deep=False).assign_attrs({k: v for k, v in ds.attrs.items() if k not in lost})
    now = measure_frames(_ends_in_memory(ds, ("particle_id", *of, "mass")))
    return ds if _within(now, ds.attrs) else ds.assign_attrs(now)


def _ends_in_memory(ds: xr.Dataset, names: Sequence[str]) -> list[Frame]:
    """Give the first and the last step of those variables that are in memory; nothing where the ids are not."""
    here = [n for n in names if n in ds and "time" in ds[n].dims and isinstance(ds[n].variable._data, np.ndarray)]
    if "particle_id" not in here or not ds.sizes["time"]:
        return []
    ends = {name: ds[name].transpose("time", ...)[[0, -1]].to_numpy() for name in here}
    return [{name: a[t][ends["particle_id"][t] != PADDING] for name, a in ends.items()} for t in range(2)]


def _within(now: Mapping[str, Any], known: Mapping[Any, Any]) -> bool:
    """Whether an extent and range of sizes lie inside those that are known, where these are."""
    for low, high in (("particle_lower", "particle_upper"), ("dmin", "dmax")):
        if low in now and low in known:
            small = 1e-9 * np.max(np.abs([known[low], known[high]]))
            if (now[low] < known[low] - small).any() or (now[high] > known[high] + small).any():
                return False
        elif low in now:
            return False
    return True


def summary(ds: xr.Dataset) -> str:
    """Tell what a Dataset holds of a scene, and what is missing."""
    if "position" not in ds:
        return "not a scene: no 'position' (fields are saved with .cg.to_vtkhdf, .to_netcdf, .to_zarr)"
    steps, particles, contacts = (ds.sizes.get(d, d == "time") for d in ("time", "particle", "contact"))
    lines = [f"scene of {int(steps)} steps with up to {particles} particles and {contacts} contacts"]
    for dim in ("particle", "contact"):
        names = [str(n) for n in ds.data_vars if dim in ds[n].dims]
        lines.append(f"  {dim + 's:':11s}{', '.join(names) or 'none'}")
    missing = [n for n in ("velocity", "diameter", "mass", "contact_force") if n not in ds]
    lines.append(f"  missing:   {', '.join(missing) or 'nothing'}")
    sizes = ", ".join(f"{k} = {ds.attrs[k]:.6g}" for k in ("dmin", "d50", "d43", "dmax") if k in ds.attrs)
    lines.append(f"  sizes:     {sizes or 'not measured'}")
    lines.append(f"  periodic:  {ds.attrs.get('periodic') or 'no axis'}; dimension {ds.attrs.get('dimension', 3)}")
    return "\n".join(lines)


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
    if "box" in ds and ds["box"].size and (ds["box"].chunks is None or lower is None or upper is None):
        first = ds["box"].isel(time=0) if "time" in ds["box"].dims else ds["box"]
        box = first.transpose("component", "bound").to_numpy()
    elif lower is not None and upper is not None:
        box = np.stack([lower, upper], axis=1)
    if box is None:
        return {}
    return {a: (float(low), float(high)) for a, (low, high) in zip(COMPONENTS, box, strict=True) if high - low < np.inf}


def layer_depth(ds: xr.Dataset, setup: Setup, edges: Mapping[str, tuple[float, float]]) -> float | str | None:
    """Thickness of a layer, or the axis whose box extent it is."""
    if setup.dimension == 3:
        return None
    if setup.thickness is not None:
        return setup.thickness
    (across,) = set(COMPONENTS) - set(setup.plane)
    if across in edges:
        return across
    measured = with_measures(ds).attrs
    if "dmax" in measured:
        return float(measured["dmax"])
    msg = "a one-layer scene needs its thickness: give thickness= when opening it, or a box that is finite across it"
    raise SceneError(msg)


def phase_of(frame: Frame, by: str | None, groups: Sequence[int], where: str) -> NDArray:
    """Which of the groups each particle belongs to; refuses particles of none."""
    count = len(frame["position"])
    if by is None:
        return np.zeros(count, "int64")
    values, known = frame[by], np.asarray(groups)
    row = np.minimum(np.searchsorted(known, values), len(known) - 1)
    strange = np.flatnonzero(known[row] != values)
    if strange.size:
        msg = (
            f"{where}: particle {frame['particle_id'][strange[0]]} has {by}={values[strange[0]]}, which is not among "
            f"the groups {list(groups)}; pass groups= with every value that occurs"
        )
        raise SceneError(msg)
    return row


def without_frozen(frame: Frame) -> Frame:
    """Drop frozen grains; contacts with them become contacts with a wall, as their partner is not there."""
    if "frozen" not in frame:
        return frame
    free = frame["frozen"] != 1
    particles = {name: values[free] for name, values in frame.items() if not name.startswith(("contact", "overlap"))}
    return {**frame, **particles}


def steps_in(arrays: Mapping[str, NDArray]) -> Iterator[tuple[Frame, NDArray | None, str]]:
    """Frame, box and name of each step of padded arrays; the box is None where they hold none."""
    rows = {name: a for name, a in arrays.items() if name not in ("box", "step", "time")}
    for t in range(len(next(iter(rows.values())))):
        where = f"step {arrays['step'][t]}" if "step" in arrays else f"frame {t} of its chunk"
        yield frame_of(rows, t, where), arrays["box"][t] if "box" in arrays else None, where


_SIZE_NAMES = {
    "d43": "volume-weighted mean diameter",
    "d32": "surface-weighted mean diameter",
    "d50": "median diameter by mass",
    "drms": "root mean square diameter",
    "dmin": "smallest diameter",
    "dmax": "largest diameter",
}


@takes_scene
def size_statistics(ds: xr.Dataset) -> xr.Dataset:
    """Sizes of the grains in each step, lazy where the scene is.

    ``d43 = S d^4 / S d^3``, ``d32 = S d^3 / S d^2``, ``drms = sqrt(S d^2 / n)``, ``d50`` the diameter below which half
    of the mass lies, ``dmin``, ``dmax``.

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
    table = xr.apply_ufunc(
        _sizes_of_rows, *inputs, input_core_dims=[["particle"]] * 2, output_core_dims=[["size"]],
        dask="parallelized", output_dtypes=[float], dask_gufunc_kwargs={"output_sizes": {"size": len(SIZES)}},
    )  # fmt: skip
    units = units_of((1, 0, 0), ds.attrs.get("unit_system", "SI"))
    out = {
        name: table.isel(size=k).assign_attrs(units=units, long_name=_SIZE_NAMES[name]) for k, name in enumerate(SIZES)
    }
    return xr.Dataset(out)


def _sizes_of_rows(diameter: NDArray, weight: NDArray) -> NDArray:
    out = np.empty((*diameter.shape[:-1], len(SIZES)))
    for at in np.ndindex(diameter.shape[:-1]):
        here = np.isfinite(diameter[at])
        found = sizes_of(diameter[at][here], weight[at][here])
        out[at] = [found[name] for name in SIZES]
    return out
