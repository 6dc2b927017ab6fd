"""From a scene to its continuum fields: plan, map over time, label."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import xarray as xr

from xcg.fields import pysammos, registry
from xcg.fields.evaluate import evaluate_plan
from xcg.fields.plan import Fields, Plan, make_plan
from xcg.fields.smoothing import Kernel
from xcg.scene.bodies import group_bodies
from xcg.scene.build import storable
from xcg.scene.conform import takes_scene
from xcg.scene.query import require_scene
from xcg.scene.schema import COMPONENTS, units_of
from xcg.steps.errors import check_on_error
from xcg.steps.label import format_call, mark_skipped, provenance


@takes_scene
def coarse_grain(
    ds: xr.Dataset,
    fields: Fields = None,
    *,
    width: float | str | Mapping[Any, float | str] | None = None,
    kernel: str | Kernel = "lucy",
    spacing: float | Mapping[str, float] | None = None,
    axes: str | None = None,
    at: Mapping[str, float] | None = None,
    bounds: Mapping[str, Sequence[float]] | None = None,
    by: str | None = None,
    groups: Sequence[int] | None = None,
    extent: Mapping[str, float] | None = None,
    gradient: str = "least_squares",
    pressure_dims: str | None = None,
    shear_dims: str | None = None,
    deviatoric: str = "stress",
    size: str = "d43",
    fluid_viscosity: float | None = None,
    by_pair: bool = False,
    temperature: str = "unbiased",
    by_body: str | None = None,
    rtol: float = 0.0,
    preset: str | None = None,
    on_error: str = "raise",
) -> xr.Dataset:
    """Coarse-grain a scene to continuum fields.

    Lazy where the scene is: nothing is read or computed until a result is, one task for each chunk of time.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene, from `open_scene` or `scene_from_arrays`.
    fields : str, quantity, or list of these, optional
        Names in the registry (`xcg.FIELDS`), by default all that the scene's variables allow; names of other variables
        of the scene, for their means; and `xcg.Mean`, `xcg.Sum`, `xcg.Variance` or `xcg.Flux` of any variable. Only
        what these need is read and summed.
    width : float, str or mapping, optional
        Half-width w of the kernel (m), or a multiple of a size such as "0.75 d43" (the default). With `by`, a mapping
        gives each group its own, for very polydisperse scenes: ``{1: 1e-3, 2: "0.75 d43"}``. Every grain, and its
        side of its contacts, is then smeared by the width of its group.
    kernel : str or Kernel
        "lucy" (default), "gaussian", "heaviside", a registered name, or an object such as ``xcg.Lucy(cutoff=0.01)``.
        Only kernels as smooth as Lucy give fields that satisfy the differential balance laws.
    spacing : float or mapping, optional
        Distance of nodes (m), for all axes or by axis; the width by default. Periodic axes without bounds take the
        nearest spacing that divides the period.
    axes : str, optional
        Resolved axes, for example "xyz" (the default), "xz", "z". Axes neither here nor in `at` are averaged: the
        exact integral over them (through the kernel's marginal), divided by their extent.
    at : mapping, optional
        Coordinate of fixed axes, for example ``{"y": 0.0}`` (m).
    bounds : mapping, optional
        First and last node of resolved axes (m). By default the box along periodic axes, and the extent of the
        particles with their supports along the others.
    by : str, optional
        An integer variable of the particles, for example "species": adds the dimension ``phase`` with "bulk" first.
        Fluctuations of each phase are about the bulk velocity; contact stress is split at the contact point.
    groups : list of int, optional
        All values of `by`, where they are not known without reading.
    extent : mapping, optional
        Length that the integral over an averaged axis is divided by (m); by default that of the box of each step.
    gradient : str
        The way to the velocity gradient, and with it to the granular temperature: "least_squares" (default), exact
        in linear flow; "kernel", the exact derivative of the field V(r); "finite_difference" between the nodes
        (resolved axes only); "paper", least squares about the node instead of the grains' centre of mass.
    pressure_dims : str, optional
        Axes whose normal stresses make the pressure: "z", "xy", ... (all axes of the scene by default).
    shear_dims : str, optional
        Axes that deviatoric stress, shear stress and shear rate are restricted to, for example "xz".
    deviatoric : str
        Which magnitudes are those of deviators: of the "stress" (default), the "rate", "both" or "neither".
    size : str
        Diameter in the inertial number: "d43" (default) or "d32" of the node, "d50" or "dmax" of the scene.
    fluid_viscosity : float, optional
        Viscosity of the fluid between the grains (Pa s), for ``viscous_number`` and ``effective_viscosity``.
    by_pair : bool
        Also divide contact stress by the phase of the partner: ``contact_stress_by_pair`` with the dimension
        ``other_phase``, the phases and then "wall". Its sum over them is the contact stress of the phase.
    temperature : str
        "unbiased" (default) divides the fluctuations about the fitted velocity by the density less what the fit takes
        of them (``fluctuation_density``); "biased" by the density alone, which gives less than half of the temperature
        of a dense packing at the default width, and a tenth of that of a gas.
    by_body : str, optional
        An integer variable of the particles that says which body each component sphere belongs to, for example
        "body_id": bodies are coarse-grained instead of spheres, see `xcg.group_bodies`.
    rtol : float
        Promise for the contact stress of every segment, relative to its largest value: the cheapest quadrature that
        keeps it is taken, from 1e-4 on with weights in single precision. 0 (default) takes the closed form.
    preset : {"pysammos"}, optional
        Names and variants of another program; `fields` are then its names, and `shear_dims` its plane ("xy" by
        default). See `xcg.fields.pysammos`.
    on_error : {"raise", "skip"}
        What to do about a step that cannot be read or computed: stop with its error (default), or leave it NaN, warn
        of it by file and cause when it is computed, and mark it in the coordinate ``skipped`` (time).

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
    given = {k: v for k, v in locals().items() if k != "ds" and v is not None}
    if by_body is not None:
        return coarse_grain(group_bodies(ds, given.pop("by_body")), **given)
    if preset is not None:
        names, table, own = _as_own(ds, given)
        return pysammos.from_xcg(coarse_grain(ds, **own), names, table)
    if check_on_error(given.pop("on_error")) == "skip":
        call = format_call("coarse_grain", given | {"on_error": on_error})
    else:
        call = format_call("coarse_grain", given)
    plan = make_plan(**{"ds": ds, **given})
    arrays = evaluate_plan(ds, plan, on_error)
    return mark_skipped(_label(ds, plan, arrays, call), arrays)


@takes_scene
def explain(ds: xr.Dataset, fields: Fields = None, **options: Any) -> Plan:
    """Plan what `coarse_grain` with the same arguments will do, without doing it; printing the plan explains it.

    Parameters
    ----------
    ds, fields, **options
        As for `coarse_grain`. With ``by_body``, spheres in memory are grouped first, as the plan is that of the
        bodies; with ``preset``, the plan is that of the fields which the preset's are made of.

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
    given = {"fields": fields, **options}
    if given.get("by_body") is not None:
        return explain(group_bodies(ds, given.pop("by_body")), **given)
    if given.get("preset") is not None:
        _, _, given = _as_own(ds, given)
    return make_plan(ds, **{k: v for k, v in given.items() if k not in ("by_body", "preset", "on_error")})


def _as_own(ds: xr.Dataset, given: Mapping[str, Any]) -> tuple[Any, Any, dict[str, Any]]:
    """Names and table of another program, and the call of `coarse_grain` that its fields come from."""
    if given["preset"] != "pysammos":
        msg = f"preset={given['preset']!r}: expected 'pysammos'"
        raise ValueError(msg)
    own = {"preset", "fields", "shear_dims"}
    options = {k: v for k, v in given.items() if k not in own}
    planned = {k: v for k, v in options.items() if k != "on_error"}
    fixed = {"pressure_dims": None, "deviatoric": "stress", "size": "d43", "temperature": "unbiased"}
    clash = [k for k, usual in fixed.items() if options.get(k, usual) != usual]
    if clash:
        msg = f"preset='pysammos' has a name for each variant: leave out {clash}, and take the field that you want"
        raise ValueError(msg)
    require_scene(ds, (), "coarse_grain")
    table = pysammos.rows(*pysammos.plane_of(ds, given.get("shear_dims")))
    names = pysammos.choose(given.get("fields"), table, make_plan(ds, None, **planned).fields)
    needed = dict.fromkeys(["sample_count", *(n for name in names for n in table[name].needs)])
    # its temperature is per density; other fields do not depend on it
    return names, table, {"fields": list(needed), **options, "temperature": "biased"}


def _label(ds: xr.Dataset, plan: Plan, arrays: Mapping[str, Any], call: str) -> xr.Dataset:
    system = plan.setup.unit_system
    grid = plan.deposit.grid
    length = units_of((1, 0, 0), system)
    coords: dict[str, Any] = {name: ds[name].variable for name in ("time", "step") if name in ds.coords}
    for a in COMPONENTS:
        attrs = {"units": length, "long_name": f"position along {a}", "axis": a.upper()}
        if a in grid.nodes:
            coords[a] = (a, grid.nodes[a], attrs)
        elif a in grid.at:
            coords[a] = ((), grid.at[a], attrs)
    if plan.deposit.by:
        attrs = {"long_name": f"phase by {plan.deposit.by}"}
        coords["phase"] = ("phase", ["bulk", *map(str, plan.deposit.groups)], attrs)
    data = {}
    for name in plan.fields:
        row = registry.row(name, plan.options)
        tail = ("component", "direction")[: row.rank]
        coords |= {dim: (dim, list(COMPONENTS)) for dim in tail}
        if row.paired:
            tail = ("other_phase", *tail)
            coords["other_phase"] = ("other_phase", [*map(str, plan.deposit.groups), "wall"])
        units = units_of(row.powers, system) if row.units is None else row.units
        about = {"units": units, "long_name": row.long_name, "formula": row.formula, "source": row.source}
        about |= {"weight": row.weight} if row.source else {}  # what averages of fields without a row need
        attrs = {key: text for key, text in about.items() if text}
        data[name] = (("time", *plan.dims, *tail), arrays[name], attrs)
    return storable(xr.Dataset(data, coords, _provenance(ds, plan, call)))


def _provenance(ds: xr.Dataset, plan: Plan, call: str) -> dict[str, Any]:
    return {
        **provenance(ds, call),
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
        "averaged_axes": plan.deposit.grid.averaged,
    }


def _axes(indices: Sequence[int]) -> str:
    return "".join(COMPONENTS[k] for k in indices)
