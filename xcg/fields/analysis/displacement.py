"""Fields of the displacement between frames: a scene in which grains have displacements in the place of velocities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.messages import unknown
from xcg.compiled._jit import THREADS
from xcg.fields.coarse_grain import about, compute_chunk, labelled, prepare
from xcg.fields.formulas import registry
from xcg.fields.formulas.averages import derive, needed_for_averages
from xcg.fields.grids.frames import refuse_cylindrical
from xcg.fields.plan import make_plan
from xcg.fields.request import SharedOptions, takes
from xcg.scene.box import BoxMotion, partners
from xcg.scene.conform import require_ids, require_scene
from xcg.scene.description import describe
from xcg.scene.frame import (
    require_known_times,
    require_rising_times,
    steps_in,
    times_are_known,
    unit_of_times,
    with_measures,
)
from xcg.scene.schema import COMPONENTS, MOTION, OF_STEP, PADDING
from xcg.steps.faults import Compute, Result
from xcg.steps.labels import mark_skipped
from xcg.steps.mapping import map_over_time, threads_a_chunk

# what else may be asked for: fields of the grains where they are in the first of two frames
BESIDE = (
    "sample_count",
    "centre_offset",
    "density",
    "volume_fraction",
    "number_density",
    "effective_count",
    "fluctuation_density",
)
_GRADIENT, _TOTAL = "displacement_gradient", "deformation_gradient"
_LATER = "_later"
_MADE = ("velocity", "interval")
_MOTION: dict[str, Result] = {
    "left": ((), "int64"),
    "entered": ((), "int64"),
    "box_gradient": ((3, 3), "float64"),
    "box_shift": ((3,), "float64"),
}


@dataclass(frozen=True)
class DisplacementRequest(SharedOptions):
    """Arguments of `displacement`.

    Parameters
    ----------
    fields : str or list of str, optional
        Names of fields of displacements: ``displacement``, ``displacement_gradient``,
        ``deformation_gradient``, ``strain``, ``small_strain``, ``volumetric_strain``,
        ``shear_strain``, ``rotation``, ``rotation_vector``, ``nonaffine_covariance``, ``d2min`` and
        ``self_diffusion``; all of them and ``sample_count`` by default, without ``self_diffusion``
        where times are not known.
    lag : int
        Frames from each frame to the later one; 1 is the next.
    accumulate : bool
        Compose the deformation gradients of consecutive steps of `lag` frames at each node,
        ``F = F_n ... F_2 F_1``, and give the fields that follow from it, at the time of the later
        frame; ``interval`` is then the time since the first frame, ``left`` and ``entered`` are of
        the last of these steps.
    width : float, str or mapping, optional
        Half-width w of the kernel (m), or a multiple of a size such as "0.75 d43" (the default), as
        in `coarse_grain`.
    at : mapping, optional
        Coordinate of fixed axes (m), or points, as in `coarse_grain`.
    for_averages : bool
        Also compute what `time_average` and `profile` of the fields need beside them.
    by_pair : bool
        Refused: displacements take no contacts.
    preset : str, optional
        Refused: displacements have no names in other programs.
    """

    fields: str | Sequence[str] | None = None
    lag: int = 1
    accumulate: bool = False
    _: KW_ONLY
    width: float | str | Mapping[int, float | str] | None = None
    at: Mapping[str, float | xr.DataArray] | None = None
    for_averages: bool = False


@takes(DisplacementRequest)
def displacement(ds: xr.Dataset, asked: DisplacementRequest) -> xr.Dataset:
    """Coarse-grain the displacement between frames: strain, rotation, and what an affine deformation leaves over.

    Each grain moves by ``u_i = r_i(t + lag) - r_i(t)``, found by its id. Across periodic edges
    ``image`` of the scene says how far; without it, it is the image that moves least relative to
    the box. A box that deforms carries its images with it. Fields belong to frame t, at the places
    that grains have in frame t (the reference configuration), which therefore takes no contacts.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene of several frames, with particles known by id in all of them.
    {arguments}

    Returns
    -------
    xarray.Dataset
        The fields at each frame t that has a partner, with the coordinates ``interval`` (time), the
        time between the two frames (s), and ``left`` and ``entered`` (time): how many grains are in
        the first of them only, and in the later one only. These are in no field.

    Raises
    ------
    SceneError
        If times do not rise, two frames have no id in common, or `self_diffusion` is asked for and
        times are not known.
    ValueError
        If there are not enough frames for `lag`, a field is not one of displacements, or an
        argument is wrong.

    Notes
    -----
    ``u = sum m_i u_i Psi / rho`` and its gradient H are fitted as velocity and its gradient are; F
    = I + H, E = (F^T F - I) / 2, and F = R U. Along an axis that is averaged, H is zero but for the
    change of a periodic box. ``d2min`` is the mean over grains of the squared distance from the
    fit, all components of the scene's dimensions together: the sum of Falk & Langer (1998, Phys.
    Rev. E 57, 7192) over the number of grains, with the kernel as weight, divided by rho_T (see
    ``granular_temperature``).

    An accumulated strain is composed at fixed nodes, through which grains pass: it is that of a
    material point only as far as the deformation differs little over the way that grains go. A node
    that sees no grains once is NaN from then on.

    Examples
    --------
    >>> import numpy as np
    >>> import xcg
    >>> r = np.random.default_rng(1).uniform(0, 4, (400, 3))
    >>> ds = xcg.scene_from_arrays([r, r * [1.01, 1, 1]], diameter=np.ones((2, 400)), density=1.0, time=[0.0, 1.0])
    >>> f = ds.cg.displacement(["strain", "d2min"], axes="", at=dict(x=2, y=2, z=2))
    >>> round(float(f.strain.sel(component="x", direction="x").item()), 6)
    0.01005
    """
    names = _names(ds, asked)
    require_scene(ds, ("mass",), "displacement")
    require_ids(ds, "displacement")
    call = asked.call("displacement")
    ds, asked = prepare(with_measures(ds), asked)
    if asked.accumulate:
        refuse_cylindrical(ds, "displacement(accumulate=True)")
        ds, asked = ds.isel(time=slice(None, None, asked.lag)), replace(asked, lag=1)
    moves = bool(ds.attrs.get("periodic")) and not describe(ds).box_lasts
    if moves and "frame" in ds.attrs:
        raise ValueError(
            "displacements in a box that changes are found in the scene's own axes: leave frame= out"
        )
    options = registry.options_of(
        {**ds.attrs, "gradient": asked.gradient, "temperature": asked.temperature}
    )
    options = replace(options, lag=asked.lag)
    if asked.for_averages:
        names = (*names, *needed_for_averages(names, options))
    derived = [
        name
        for name in names
        if name != _GRADIENT and _GRADIENT in registry.order_of((name,), options)
    ]
    summed = [name for name in names if name not in derived] + [_GRADIENT] * bool(derived)
    summed += ["centre_offset"] * (moves and "displacement" in names)
    f, motion = _between_frames(ds, asked, list(dict.fromkeys(summed)), call)
    found = {name: f[name] for name in summed}
    if moves:
        found |= _with_box(f, ds, motion)
    if asked.accumulate:
        found[_TOTAL] = _composed(derive(_TOTAL, dict(found), options))
        labels = [name for name in ("time", "step") if name in ds.coords]
        f = f.assign_coords(
            {name: ("time", ds[name].to_numpy()[1:], ds[name].attrs) for name in labels}
        )
        since = f["interval"].attrs["long_name"].replace("to the later", "since the first")
        since = {"units": f["interval"].attrs["units"], "long_name": since}
        f = f.assign_coords(
            interval=("time", ds["time"].to_numpy()[1:] - ds["time"].to_numpy()[0], since)
        )
    system = f.attrs.get("unit_system", "SI")
    data = {}
    for name in names:
        values = derive(name, found, options)
        data[name] = (values.dims, values.data, about(registry.row(name, options), system))
    return xr.Dataset(data, f.coords, f.attrs).unify_chunks()


def _names(ds: xr.Dataset, asked: DisplacementRequest) -> tuple[str, ...]:
    """Check what is asked for, and give the names of the fields."""
    frames, lag = ds.sizes.get("time", 1), asked.lag
    if not isinstance(lag, (int, np.integer)) or isinstance(lag, bool) or lag < 1:
        raise ValueError(f"lag={lag!r}: expected a number of frames, 1 for the next")
    if lag >= frames:
        raise ValueError(
            f"lag={lag!r}: the scene has {frames} frames, and displacements need lag + 1 or more of them"
        )
    for name, no in (("preset", None), ("by_pair", False)):
        if getattr(asked, name) != no:
            raise ValueError(
                f"{name}={getattr(asked, name)!r}: not available for displacements; leave it out"
            )
    require_rising_times(ds, "displacement")
    known = [name for name in registry.listed() if registry.FIELDS[name].option == "lag"]
    timed = [name for name in known if "interval" in registry.FIELDS[name].moments]
    ours = [name for name in known if registry.FIELDS[name].default]
    if not times_are_known(ds):
        ours = [name for name in ours if name not in timed]
    given = ["sample_count", *ours] if asked.fields is None else asked.fields
    names = [str(name) for name in ([given] if isinstance(given, str) else given)]
    if not names:
        raise ValueError(
            f"fields={asked.fields!r}: expected at least one; leave it out for all of displacements"
        )
    for name in names:
        if name not in (*known, *BESIDE):
            raise ValueError(unknown("field of displacements", name, (*known, *BESIDE)))
        if name in timed:
            require_known_times(ds, f"displacement({name!r})")
    if asked.accumulate:
        total = [name for name in known if _TOTAL in registry.order_of((name,), registry.Options())]
        if asked.fields is None:
            names = total
        if wrong := [name for name in names if name not in total]:
            raise ValueError(
                f"accumulate=True composes deformation gradients: {wrong} do not follow from one; take {total}"
            )
    return tuple(dict.fromkeys(names))


# --- pairs of frames ------------------------------------------------------------------------------


def _between_frames(
    ds: xr.Dataset, asked: DisplacementRequest, names: Sequence[str], call: str
) -> tuple[xr.Dataset, xr.Dataset]:
    """Fields of displacements relative to the box, and ``box_gradient`` and ``box_shift`` (time)."""
    count, lag = ds.sizes["time"] - asked.lag, asked.lag
    contacts = [name for name in ds.data_vars if "contact" in ds[name].dims]
    # displacements relative to the box are the same in all images
    first = ds.drop_vars([*contacts, "lattice_velocity"], errors="ignore").isel(
        time=slice(0, count)
    )
    # a plan looks at names only: what stands for displacements and intervals comes with the frames
    moved = first.assign(velocity=first["position"], interval=first["mass"]).assign_attrs(lag=lag)
    scene = describe(moved, asked.by)
    plan = make_plan(scene, asked.ask(fields=names, width=asked.width, at=asked.at))
    both = [
        "particle_id",
        "position",
        "time",
        *(name for name in (*MOTION, *OF_STEP) if name in ds and name != "lattice_velocity"),
    ]
    later = {
        f"{name}{_LATER}": ds[name].variable[{"time": slice(lag, None)}].to_base_variable()
        for name in both
    }
    read = list(dict.fromkeys([*(name for name in plan.variables if name not in _MADE), *both]))
    pairs = first.assign(later)
    threads = threads_a_chunk(pairs, [*read, *later], THREADS)
    compute = partial(_of_pairs, plan.setup.periodic, partial(compute_chunk, plan, threads))
    results = {field: (plan.shapes[field], "float64") for field in plan.fields} | _MOTION
    arrays = map_over_time(pairs, [*read, *later], compute, results, "displacement", asked.on_error)
    f = mark_skipped(labelled(scene, plan, arrays, call), arrays)
    times = ds["time"].to_numpy()
    what = "time" if times_are_known(ds) else "steps of the simulation"
    coords = {
        "interval": (
            times[lag:] - times[:count],
            {"units": unit_of_times(ds), "long_name": f"{what} to the later frame"},
        ),
        "left": (
            arrays["left"],
            {"units": "1", "long_name": "number of grains in the first frame only"},
        ),
        "entered": (
            arrays["entered"],
            {"units": "1", "long_name": "number of grains in the later frame only"},
        ),
    }
    axes = {dim: list(COMPONENTS) for dim in ("component", "direction")}
    tensors = {"box_gradient": ("component", "direction"), "box_shift": ("component",)}
    motion = xr.Dataset(
        {name: (("time", *dims), arrays[name]) for name, dims in tensors.items()}, axes
    )
    return f.assign_coords({name: ("time", *values) for name, values in coords.items()}), motion


def _of_pairs(periodic: str, compute: Compute, arrays: Mapping[str, NDArray]) -> dict[str, NDArray]:
    """Compute fields of a chunk of frames, with displacements to their later frames in the place of velocities."""
    first = {name: a for name, a in arrays.items() if not name.endswith(_LATER)}
    later = {name.removesuffix(_LATER): a for name, a in arrays.items() if name.endswith(_LATER)}
    steps, grains = first["particle_id"].shape
    found = {name: np.empty((steps, *shape), dtype) for name, (shape, dtype) in _MOTION.items()}
    first["interval"] = np.broadcast_to(
        (later.pop("time") - first.pop("time"))[:, None], (steps, grains)
    )
    first["velocity"] = np.full((steps, grains, 3), np.nan)
    ids = np.full((steps, grains), PADDING)
    frames = {name: first[name] for name in later}
    for t, (one, other) in enumerate(
        zip(steps_in(frames, periodic), steps_in(later, periodic), strict=True)
    ):
        sources = one[2], other[2]
        rows = partners(one[0], other[0], sources)
        stay = rows >= 0
        motion = BoxMotion.between(one[1], other[1])
        # grains without a partner become padding, and all rows stay where they are
        given = first["particle_id"][t]
        place = np.argsort(given, kind="stable")[grains - len(rows) :][stay]
        ids[t, place] = given[place]
        first["velocity"][t, place] = motion.relative(
            one[0], other[0], np.flatnonzero(stay), rows[stay]
        )
        found["left"][t], found["entered"][t] = (
            (~stay).sum(),
            len(other[0]["position"]) - stay.sum(),
        )
        found["box_gradient"][t], found["box_shift"][t] = motion.gradient, motion.shift
    return {**compute(first | {"particle_id": ids}), **found}


# --- from displacements relative to the box -------------------------------------------------------


def _with_box(f: xr.Dataset, ds: xr.Dataset, motion: xr.Dataset) -> dict[str, xr.DataArray]:
    """Add the displacement that the box imposes where the grains at each node are, and its gradient."""
    found, gradient = {}, motion["box_gradient"]
    if _GRADIENT in f:
        found[_GRADIENT] = f[_GRADIENT] + gradient
    if "displacement" in f:
        middle = ds["box"].isel(time=slice(0, f.sizes["time"])).mean("bound").drop_vars("time")
        imposed = motion["box_shift"]
        for a in ds.attrs["periodic"]:
            along = {"component": a, "drop": True}
            # along an averaged axis, the middle of the box stands for all that is there
            place = f[a] + f["centre_offset"].sel(**along) if a in f.coords else middle.sel(**along)
            imposed = imposed + gradient.sel(direction=a, drop=True) * place
        found["displacement"] = (f["displacement"] + imposed).transpose(*f["displacement"].dims)
    return found


def _composed(steps: xr.DataArray) -> xr.DataArray:
    """Products F_n ... F_2 F_1 of tensors along time, one chunk of time after the other."""
    steps = steps.transpose("time", ..., "component", "direction")
    if steps.chunks is None:
        return steps.copy(data=_products(steps.data, axis=0))
    from dask.array.reductions import cumreduction  # slow to import

    whole = cumreduction(_products, lambda before, now: now @ before, np.eye(3), steps.data, axis=0)
    return steps.copy(data=whole)


def _products(tensors: NDArray, axis: int = 0, **_: Any) -> NDArray:
    out = tensors.copy()
    for t in range(1, len(out)):
        out[t] = out[t] @ out[t - 1]
    return out
