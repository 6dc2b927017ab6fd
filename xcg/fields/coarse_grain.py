"""From a scene to its continuum fields: what is asked for, who answers, and the labels of the answer."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import xarray as xr

from xcg.fields.accessible import check_walls, with_accessible
from xcg.fields.evaluate import evaluate_plan
from xcg.fields.formulas import registry
from xcg.fields.formulas.field import Field
from xcg.fields.places.frames import in_frame, is_cylindrical
from xcg.fields.plan import Plan, make_plan
from xcg.fields.presets import lammps, pysammos
from xcg.fields.request import Request, SharedOptions, takes
from xcg.scene.bodies import group_bodies
from xcg.scene.build import storable
from xcg.scene.conform import takes_scene
from xcg.scene.schema import COMPONENTS, units_of
from xcg.scene.sizes import with_measures
from xcg.steps.errors import check_on_error
from xcg.steps.label import format_call, mark_skipped, provenance
from xcg.steps.phase_labels import with_phase_labels

# names of other programs: from a request in them to one in names of xcg, and what turns its answer into theirs
PRESETS: dict[str, Callable[[xr.Dataset, Request], tuple[Request, Callable[[xr.Dataset], xr.Dataset]]]] = {
    "pysammos": pysammos.translate,
    "lammps": lammps.translate,
}
_CYLINDRICAL: dict[str, dict[str, str]] = {
    "r": {"long_name": "distance from the axis"},
    "theta": {"units": "rad", "long_name": "angle about the axis"},
    "z": {"long_name": "position along the axis", "axis": "Z"},
}
_AXES = {*COMPONENTS, *_CYLINDRICAL}
Asked = TypeVar("Asked", bound=SharedOptions)


@takes_scene
@takes(Request)
def coarse_grain(ds: xr.Dataset, request: Request) -> xr.Dataset:
    """Coarse-grain a scene to continuum fields.

    Lazy where the scene is: nothing is read or computed until a result is, one task for each chunk of time.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene, from `open_scene` or `scene_from_arrays`.
    {arguments}

    Returns
    -------
    xarray.Dataset
        Fields with dimensions (time, x, y, z, phase, component, direction), those that apply. Sums are zero where
        nothing reaches; ratios are NaN there, and ``sample_count`` says how many particles each node saw.

    Raises
    ------
    SceneError
        If the scene lacks what the fields need.
    ValueError
        If an argument is wrong; the message says what was expected.

    Notes
    -----
    A field is ``sum_i q_i Psi(r - r_i)`` over particles or, for contact stress, ``sum f_ij a_ij int_0^1
    Psi(r - r_i + s a_ij) ds`` over both sides of every contact. Sources: Goldhirsch (2010); Weinhart et al. (2012).

    Examples
    --------
    >>> import xcg
    >>> ds = xcg.datasets.simple_cubic(4)
    >>> f = coarse_grain(ds, ["volume_fraction"], axes="z")
    >>> f.volume_fraction.dims
    ('time', 'z')
    """
    return answer(ds, request)


@takes_scene
@takes(Request)
def explain(ds: xr.Dataset, request: Request) -> Plan:
    """Plan what `coarse_grain` with the same arguments will do, without doing it; printing the plan explains it.

    With ``by_body``, spheres in memory are grouped first, as the plan is that of the bodies; with ``preset="lammps"``,
    the plan is that of the fields which the preset's are made of.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene.
    {arguments}

    Returns
    -------
    Plan
        Its text names fields, variables read, nodes, kernel, sums, passes, the rule for contacts, and memory.

    Raises
    ------
    SceneError, ValueError
        As `coarse_grain`.

    Examples
    --------
    >>> import xcg
    >>> print(explain(xcg.datasets.simple_cubic(4), "volume_fraction", axes="z"))  # doctest: +ELLIPSIS
    fields    volume_fraction
    ...
    """
    ds, request = prepare(ds, request)
    request, _ = _in_own_names(ds, request)
    return make_plan(ds, request)


def answer(ds: xr.Dataset, request: Request) -> xr.Dataset:
    """Give what a request asks for."""
    check_walls(request)
    framed = {"frame": request.frame} if request.frame is not None else {}
    ds, request = prepare(ds, request)
    skips = check_on_error(request.on_error) == "skip"
    given = {k: v for k, v in (request.given() | framed).items() if k != "on_error" or skips}
    call = format_call("coarse_grain", given)
    request, rename = _in_own_names(ds, request)
    plan = make_plan(ds, request)
    arrays = evaluate_plan(ds, plan, request.on_error)
    result = label_fields(ds, plan, arrays, call)
    if request.walls is not None:
        result = with_accessible(result, ds, plan, request)
    return rename(mark_skipped(result, arrays))


def prepare(ds: xr.Dataset, asked: Asked) -> tuple[xr.Dataset, Asked]:
    """Group spheres where bodies are asked for, and turn the scene into the frame that is asked for.

    What is asked for then holds of the bodies, in the axes of the frame.
    """
    if asked.by_body is not None:
        ds, asked = group_bodies(ds, asked.by_body), replace(asked, by_body=None)
    if asked.frame is not None:
        ds = ds if is_cylindrical(ds) else in_frame(with_measures(ds), asked.frame)
        if not is_cylindrical(ds):
            return ds, replace(asked, frame=None)
        letters = {ord("r"): "x", ord("t"): "y"}  # of the components that stand in their places
        dims = {name: getattr(asked, name) for name in ("pressure_dims", "shear_dims")}
        asked = replace(asked, **{name: axes and axes.translate(letters) for name, axes in dims.items()})
    return ds, asked


def _in_own_names(ds: xr.Dataset, request: Request) -> tuple[Request, Callable[[xr.Dataset], xr.Dataset]]:
    """Give the request in names of xcg, and what turns its answer into what was asked for."""
    if request.preset is None:
        return request, lambda result: result
    if request.preset not in PRESETS:
        msg = f"preset={request.preset!r}: expected {' or '.join(map(repr, PRESETS))}"
        raise ValueError(msg)
    return PRESETS[request.preset](ds, request)


def label_fields(ds: xr.Dataset, plan: Plan, arrays: Mapping[str, Any], call: str) -> xr.Dataset:
    """Label what a plan gave as a result of the scene."""
    system = plan.setup.unit_system
    length = units_of((1, 0, 0), system)
    coords: dict[str, Any] = {name: ds[name].variable for name in ("time", "step") if name in ds.coords}
    for name, coord in plan.deposit.grid.coords.items():
        attrs = {"units": length, "long_name": f"position along {name}", "axis": name.upper()}
        if is_cylindrical(ds):
            attrs = _CYLINDRICAL[name] | ({} if name == "theta" else {"units": length})
        coords[name] = (coord.dims, coord, attrs | coord.attrs if name in _AXES else coord.attrs)
    if plan.deposit.by:
        attrs = {"long_name": f"phase by {plan.deposit.by}"}
        coords["phase"] = ("phase", ["bulk", *map(str, plan.deposit.groups)], attrs)
    data = {}
    for name in plan.fields:
        row = registry.row(name, plan.options)
        tail = ("component", "direction")[: row.rank]
        coords |= {dim: (dim, list(_CYLINDRICAL) if is_cylindrical(ds) else list(COMPONENTS)) for dim in tail}
        if row.paired:
            tail = ("other_phase", *tail)
            coords["other_phase"] = ("other_phase", [*map(str, plan.deposit.groups), "wall"])
        attrs = about(row, system)
        if lacking := plan.left_out(name):
            attrs["comment"] = f"without rotation, as the scene holds no {' and no '.join(lacking)}"
        data[name] = (("time", *plan.dims, *tail), arrays[name], attrs)
    return with_phase_labels(storable(xr.Dataset(data, coords, _provenance(ds, plan, call))))


def about(row: Field, system: str) -> dict[str, str]:
    """Attributes of a field in a result."""
    units = units_of(row.powers, system) if row.units is None else row.units
    found = {"units": units, "long_name": row.long_name, "formula": row.formula, "source": row.source}
    found |= {"weight": row.weight} if row.source else {}  # what averages of fields without a row need
    return {key: text for key, text in found.items() if text}


def _provenance(ds: xr.Dataset, plan: Plan, call: str) -> dict[str, Any]:
    return {
        **provenance(ds, call),
        **plan.deposit.grid.attrs,
        "kernel": plan.kernel.name,
        "width": plan.widths if len(plan.widths) > 1 else plan.kernel.width,
        "cutoff": list(plan.deposit.cutoffs) if len(plan.widths) > 1 else plan.kernel.cutoff,
        "kernel_dimension": plan.kernel.dimension,
        "rtol": plan.rtol,
        "gradient": plan.options.gradient,
        "pressure_dims": _axes(plan.options.pressure_axes or plan.options.plane),
        "deviatoric": plan.options.deviatoric,
        "size": plan.options.size,
        "temperature": plan.options.temperature,
        **registry.given_options(plan.options),
        "sampling": "cell" if plan.deposit.grid.half.any() else "node",
        "averaged_axes": plan.deposit.grid.averaged,
        "wrapped_axes": "".join(a for a, wraps in zip(COMPONENTS, plan.options.wrapped, strict=True) if wraps),
    }


def _axes(indices: Sequence[int]) -> str:
    return "".join(COMPONENTS[k] for k in indices)
