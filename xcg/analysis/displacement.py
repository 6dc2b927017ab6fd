"""Fields of the displacement between frames, which are computed as fields of velocities are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.checks import check, whole
from xcg.common.messages import unknown
from xcg.fields.advice import advise
from xcg.fields.coarse_grain import prepare
from xcg.fields.evaluate import CoarseGraining, about
from xcg.fields.formulas import registry
from xcg.fields.formulas.field import Options
from xcg.fields.formulas.mean_sums import derive
from xcg.fields.formulas.rules import needed_for_averages
from xcg.fields.grids.frames import refuse_cylindrical
from xcg.fields.plan import make_plan
from xcg.fields.request import SharedOptions, takes
from xcg.scene.box import BoxMotion, partners
from xcg.scene.scene import Scene
from xcg.scene.schema import MOTION, Variable
from xcg.scene.times import (
    require_known_times,
    require_rising_times,
    times_are_known,
    unit_of_times,
)
from xcg.steps.analysis import FrameAnalysis, Step, run
from xcg.steps.labels import annotated

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
_GRADIENT = "displacement_gradient"
_TOTAL = "deformation_gradient"
_MADE = ("velocity", "interval")
_COUNTS = {
    "left": Variable((), "1", "number of grains in the first frame only", "int64"),
    "entered": Variable((), "1", "number of grains in the later frame only", "int64"),
}
_MOTION = {
    "box_gradient": Variable(("component", "direction"), "1", "displacement gradient of the box"),
    "box_shift": Variable(("component",), "m", "displacement of the box"),
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
    for_averages : bool, optional
        As in `coarse_grain`.
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
    for_averages: bool | None = None


@takes(DisplacementRequest)
def displacement(scene: Scene, request: DisplacementRequest) -> xr.Dataset:
    """Coarse-grain the displacement between frames: strain, rotation, and non-affine motion.

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

    Warns
    -----
    SceneWarning
        When it is computed, if more than 1 % of the particles move by more than a quarter of a
        period between the two frames, or one by more than 0.4, and the scene has no ``image``.

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
    >>> ds = xcg.scene_from_arrays(
    ...     [r, r * [1.01, 1, 1]], diameter=np.ones((2, 400)), density=1.0, time=[0.0, 1.0]
    ... )
    >>> f = ds.cg.displacement(["strain", "d2min"], axes="", at=dict(x=2, y=2, z=2))
    >>> round(float(f.strain.sel(component="x", direction="x").item()), 6)
    0.01005
    """
    names = _names(scene.ds, request)
    scene.require(("mass",), "displacement")
    scene.require_ids("displacement")
    call = request.call("displacement")
    scene, request = prepare(scene.with_measures(), replace(request, lag=int(request.lag)))
    if request.accumulate:
        refuse_cylindrical(scene.ds, "displacement(accumulate=True)")
        scene = Scene(scene.ds.isel(time=slice(None, None, request.lag)))
        request = replace(request, lag=1)
    ds = scene.ds
    box_changes = bool(scene.setup.periodic) and not scene.box_lasts
    if box_changes and "frame" in ds.attrs:
        raise ValueError(
            "displacements in a box that changes are found in the scene's own axes: "
            "leave frame= out"
        )
    options = Options(
        plane=tuple(scene.setup.axes),
        gradient=request.gradient,
        temperature=request.temperature,
        lag=request.lag,
    )
    beside: tuple[str, ...] = ()
    if request.for_averages is not False:
        beside = needed_for_averages(names, options)
        names = (*names, *beside)
    # fields that follow from the gradient relative to the box, once the box is added to it
    derived = [
        name
        for name in names
        if name != _GRADIENT and _GRADIENT in registry.fields_of((name,), options)
    ]
    summed = [name for name in names if name not in derived]
    if derived:
        summed.append(_GRADIENT)
    if box_changes and "displacement" in names:
        summed.append("centre_offset")
    f = _between_frames(ds, request, list(dict.fromkeys(summed)), call, box_changes)
    fields = {name: f[name] for name in summed}
    if box_changes:
        fields |= _with_box(f, ds)
    if request.accumulate:
        fields[_TOTAL] = _composed(derive(_TOTAL, dict(fields), options))
        f = f.assign_coords(_coords_of_later_frames(ds, f["interval"].attrs))
    system = f.attrs.get("unit_system", "SI")
    data = {}
    for name in names:
        values = derive(name, fields, options)
        data[name] = (values.dims, values.data, about(registry.field_of(name, options), system))
    result = xr.Dataset(data, f.coords, f.attrs).unify_chunks()
    if request.for_averages:
        return result
    return result.set_coords(beside)


def _coords_of_later_frames(ds: xr.Dataset, of_interval: Mapping[str, Any]) -> dict[str, Any]:
    """Return time and step of all frames but the first, and the time since that."""
    coords: dict[str, Any] = {}
    for name in ("time", "step"):
        if name in ds.coords:
            coords[name] = ("time", ds[name].to_numpy()[1:], ds[name].attrs)
    times = ds["time"].to_numpy()
    long_name = of_interval["long_name"].replace("to the later", "since the first")
    coords["interval"] = annotated("time", times[1:] - times[0], of_interval["units"], long_name)
    return coords


def _names(ds: xr.Dataset, request: DisplacementRequest) -> tuple[str, ...]:
    """Check the request, and return the names of its fields."""
    frames = ds.sizes.get("time", 1)
    lag = request.lag
    check("lag", lag, whole(1), hint="; 1 is the next frame")
    if lag >= frames:
        raise ValueError(
            f"lag={lag!r}: the scene has {frames} frames, and displacements need lag + 1 "
            "or more of them"
        )
    for name in ("preset", "by_pair"):
        if value := getattr(request, name):
            raise ValueError(f"{name}={value!r}: not available for displacements; leave it out")
    require_rising_times(ds, "displacement")
    return _fields(ds, request.fields, accumulate=request.accumulate)


def _fields(
    ds: xr.Dataset, fields: str | Sequence[str] | None, *, accumulate: bool
) -> tuple[str, ...]:
    """Return the names of the fields that are asked for; raise ValueError for one that is not known."""
    available = [name for name in registry.listed() if registry.FIELDS[name].option == "lag"]
    timed = [name for name in available if "interval" in registry.FIELDS[name].moments]
    if fields is None:
        names = [
            "sample_count",
            *(name for name in available if registry.FIELDS[name].default),
        ]
        if not times_are_known(ds):
            names = [name for name in names if name not in timed]
    elif isinstance(fields, str):
        names = [fields]
    else:
        names = [str(name) for name in fields]
    if not names:
        raise ValueError(
            f"fields={fields!r}: expected at least one; leave it out for all of displacements"
        )
    for name in names:
        if name not in (*available, *BESIDE):
            raise ValueError(unknown("field of displacements", name, (*available, *BESIDE)))
        if name in timed:
            require_known_times(ds, f"displacement({name!r})")
    if accumulate:
        total = [
            name for name in available if _TOTAL in registry.fields_of((name,), registry.Options())
        ]
        if fields is None:
            names = total
        wrong = [name for name in names if name not in total]
        if wrong:
            raise ValueError(
                f"accumulate=True composes deformation gradients: {wrong} do not follow from one; "
                f"take {total}"
            )
    return tuple(dict.fromkeys(names))


# --- pairs of frames ------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Displacements(FrameAnalysis):
    """Fields of displacements relative to the box, which take the place of velocities."""

    name = "displacement"
    optional = MOTION

    fields: CoarseGraining
    lag: int
    box_changes: bool

    @property
    def lags(self) -> tuple[int, ...]:
        """Return the offset of the later frame."""
        return (self.lag,)

    def reads(self, scene: Scene) -> list[str]:
        """Return what the fields need of the first frame, and where grains are in both."""
        of_fields = [name for name in self.fields.reads(scene) if name not in _MADE]
        return [*of_fields, "position", "time"]

    def rows(self, scene: Scene) -> dict[str, Variable]:
        """Return the fields, the grains that are in one frame only, and the motion of the box."""
        rows = self.fields.rows(scene) | _COUNTS
        if self.box_changes:
            return rows | _MOTION
        return rows

    def coords(self, scene: Scene) -> dict[str, xr.Variable]:
        """Return the coordinates of the fields."""
        return self.fields.coords(scene)

    def attrs(self, scene: Scene) -> dict[str, Any]:
        """Return the options of the fields."""
        return self.fields.attrs(scene)

    def frames(self, now: Step, *others: Step | None) -> dict[str, Any]:
        """Compute the fields of the grains that are in both frames."""
        (later,) = others
        if later is None:  # the last frames are left out of the result
            shapes = {**self.fields.plan.shapes, "box_gradient": (3, 3), "box_shift": (3,)}
            nothing = {name: np.full(shape, np.nan) for name, shape in shapes.items()}
            return nothing | {"left": 0, "entered": 0}
        frame, lattice, source = now
        later_frame, later_lattice, later_source = later
        indices = partners(frame, later_frame, (source, later_source))
        stays = np.flatnonzero(indices >= 0)
        motion = BoxMotion.between(lattice, later_lattice)
        of_both = {name: values[stays] for name, values in frame.items() if np.ndim(values)}
        moved = motion.relative(frame, later_frame, stays, indices[stays])
        motion.warn_of_jumps(moved, frame, lattice, source, "displacements")
        of_both["velocity"] = moved
        of_both["interval"] = np.full(len(stays), later_frame["time"] - frame["time"])
        fields = replace(self.fields, threads=self.threads).frame(of_both, lattice, source)
        return fields | {
            "left": len(indices) - len(stays),
            "entered": len(later_frame["position"]) - len(stays),
            "box_gradient": motion.gradient,
            "box_shift": motion.shift,
        }

    def after(self, result: xr.Dataset, ds: xr.Dataset) -> xr.Dataset:
        """Leave out frames without a later one, and name the time between the two."""
        count = ds.sizes["time"] - self.lag
        result = self.fields.after(result, ds).isel(time=slice(0, count))
        times = ds["time"].to_numpy()
        what = "time"
        if not times_are_known(ds):
            what = "steps of the simulation"
        apart = times[self.lag :] - times[:count]
        interval = annotated("time", apart, unit_of_times(ds), f"{what} to the later frame")
        return result.assign_coords(interval=interval).set_coords([*_COUNTS])


def _between_frames(
    ds: xr.Dataset,
    request: DisplacementRequest,
    names: Sequence[str],
    call: str,
    box_changes: bool,
) -> xr.Dataset:
    """Return fields of displacements relative to the box, and its motion where it changes."""
    # contacts belong to one frame; displacements relative to the box are the same in all images
    contacts = [name for name in ds.data_vars if "contact" in ds[name].dims]
    first = ds.drop_vars([*contacts, "lattice_velocity"], errors="ignore")
    made = dict.fromkeys(_MADE, first.variables["position"])
    scene = Scene(first, made=made, lag=request.lag)
    of_fields = request.as_request(
        fields=names, width=request.width, at=request.at, for_averages=False
    )
    plan = make_plan(scene, of_fields)
    advise(scene, plan)
    analysis = _Displacements(CoarseGraining(plan), request.lag, box_changes)
    return run(scene, analysis, call=call, on_error=request.on_error)


# --- from displacements relative to the box -------------------------------------------------------


def _with_box(f: xr.Dataset, ds: xr.Dataset) -> dict[str, xr.DataArray]:
    """Add the displacement and gradient that the box imposes on the grains of a node."""
    fields = {}
    gradient = f["box_gradient"]
    if _GRADIENT in f:
        fields[_GRADIENT] = f[_GRADIENT] + gradient
    if "displacement" in f:
        middle = ds["box"].isel(time=slice(0, f.sizes["time"])).mean("bound").drop_vars("time")
        imposed = f["box_shift"]
        for a in ds.attrs["periodic"]:
            if a in f.coords:
                centre = f[a] + f["centre_offset"].sel(component=a, drop=True)
            else:  # the middle of the box stands for all grains along an averaged axis
                centre = middle.sel(component=a, drop=True)
            imposed = imposed + gradient.sel(direction=a, drop=True) * centre
        fields["displacement"] = (f["displacement"] + imposed).transpose(*f["displacement"].dims)
    return fields


def _composed(gradients: xr.DataArray) -> xr.DataArray:
    """Return the products F_n ... F_2 F_1 of tensors along time, chunk after chunk."""
    gradients = gradients.transpose("time", ..., "component", "direction")
    if gradients.chunks is None:
        return gradients.copy(data=_products(gradients.data, axis=0))
    from dask.array.reductions import cumreduction  # slow to import

    whole = cumreduction(
        _products, lambda before, now: now @ before, np.eye(3), gradients.data, axis=0
    )
    return gradients.copy(data=whole)


def _products(tensors: NDArray, axis: int = 0, **_: Any) -> NDArray:
    """Return the products of tensors (time, ..., 3, 3) from the first to each; called by dask."""
    out = tensors.copy()
    for t in range(1, len(out)):
        out[t] = out[t] @ out[t - 1]
    return out
