"""Residuals of the balance laws on a mesh: whether mesh and time between frames resolve the flow."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from xcg.fields.coarse_grain import answer, prepare
from xcg.fields.grids.frames import refuse_cylindrical
from xcg.fields.plan import make_plan
from xcg.fields.request import SharedOptions, takes
from xcg.scene.scene import Scene
from xcg.scene.schema import COMPONENTS, units_in
from xcg.scene.times import require_times, times_are_known
from xcg.steps.labels import provenance

OF_PHASES = ("interphase_force", "segregation_flux")  # what phases have besides


def _derivative(field: xr.DataArray, axis: str, *, wraps: bool) -> xr.DataArray:
    """Central difference of fourth order; NaN at the two nodes next to an end, unless the axis wraps."""
    spacing = float(field[axis][1] - field[axis][0])
    nodes = field.sizes[axis]
    how: Any = {"constant_values": np.nan}
    if wraps:
        how = {"mode": "wrap"}
    wide = field.drop_vars(axis).pad({axis: 2}, **how)
    near = wide.isel({axis: slice(3, nodes + 3)}) - wide.isel({axis: slice(1, nodes + 1)})
    far = wide.isel({axis: slice(4, nodes + 4)}) - wide.isel({axis: slice(0, nodes)})
    return ((8 * near - far) / (12 * spacing)).assign_coords({axis: field[axis]})


@dataclass(frozen=True)
class _Law:
    """Balance law: its terms add up to zero.

    Attributes
    ----------
    units, long_name : str
        Of the residual; reduced scenes have no units.
    fields : tuple of str
        What it needs.
    terms : callable
        ``terms(f, divergence, gravity)``, all but a rate of change.
    rate : str
        The field whose rate of change is one more term, so that it holds between steps.
    needs_gravity : bool
        Whether the scene has to say its gravity.
    """

    units: str
    long_name: str
    fields: tuple[str, ...]
    terms: Callable[
        [xr.Dataset, Callable[[xr.DataArray], xr.DataArray], xr.DataArray | float],
        list[xr.DataArray],
    ]
    rate: str = ""
    needs_gravity: bool = False


def _traction(f: xr.Dataset) -> xr.DataArray:
    """Return the forces of the walls on the grains, and of other phases on a phase."""
    if "phase" in f.dims:
        return f.interphase_force.sum("other_phase")
    return f.boundary_force_density


def _momentum(f: xr.Dataset, divergence: Any, gravity: Any) -> list[xr.DataArray]:
    velocity = f.velocity
    if "phase" in f.dims:
        velocity = velocity.sel(phase="bulk", drop=True)
    flux = f.momentum_density * velocity.rename(component="direction") + f.stress
    if "phase" in f.dims:
        flux = flux + velocity * f.segregation_flux.rename(component="direction")
    flux = flux.where(f.density != 0, f.stress)  # below zero where parts of a kernel are
    return [divergence(flux), -f.density * gravity, -_traction(f)]


def _energy(f: xr.Dataset, divergence: Any, gravity: Any) -> list[xr.DataArray]:
    weight = (f.momentum_density * gravity).sum("component", skipna=False)
    flux = f.kinetic_energy_flux + f.contact_energy_flux
    return [divergence(flux), -weight, f.dissipation_rate, -f.wall_power]


LAWS: dict[str, _Law] = {
    "force": _Law(
        "N m^-3",
        "residual of the divergence of contact stress",
        ("contact_stress", "contact_force_density", "boundary_force_density"),
        lambda f, div, g: [div(f.contact_stress), f.contact_force_density, -_traction(f)],
    ),
    "torque": _Law(
        "N m^-2",
        "residual of the divergence of couple stress",
        ("couple_stress", "torque_density", "contact_couple_density"),
        lambda f, div, g: [div(f.couple_stress), f.torque_density, -f.contact_couple_density],
    ),
    "power": _Law(
        "W m^-3",
        "residual of the divergence of the contact energy flux",
        ("contact_energy_flux", "contact_power", "dissipation_rate", "wall_power"),
        lambda f, div, g: [
            div(f.contact_energy_flux),
            f.contact_power,
            f.dissipation_rate,
            -f.wall_power,
        ],
    ),
    "mass": _Law(
        "kg m^-3 s^-1",
        "residual of the balance of mass",
        ("density", "momentum_density"),
        lambda f, div, g: [div(f.momentum_density)],
        rate="density",
    ),
    "momentum": _Law(
        "N m^-3",
        "residual of the balance of momentum",
        ("density", "momentum_density", "velocity", "stress", "boundary_force_density"),
        _momentum,
        rate="momentum_density",
        needs_gravity=True,
    ),
    "spin": _Law(
        "N m^-2",
        "residual of the balance of spin",
        ("spin_density", "spin_flux", "couple_stress", "contact_couple_density"),
        lambda f, div, g: [div(f.spin_flux + f.couple_stress), -f.contact_couple_density],
        rate="spin_density",
    ),
    "energy": _Law(
        "W m^-3",
        "residual of the balance of energy",
        (
            "kinetic_energy",
            "kinetic_energy_flux",
            "contact_energy_flux",
            "momentum_density",
            "dissipation_rate",
            "wall_power",
        ),
        _energy,
        rate="kinetic_energy",
        needs_gravity=True,
    ),
}
USUAL = ("force", "mass", "momentum")
# contacts between phases are shared, their sides are not
OF_THE_MIXTURE = ("torque", "power", "spin", "energy")


@dataclass(frozen=True, kw_only=True)
class BalanceRequest(SharedOptions):
    """Arguments of `balance`: every axis must be resolved or averaged, with five nodes or more.

    Parameters
    ----------
    width : float or str, optional
        Half-width w of the kernel (m), or a multiple of a size such as "0.75 d43" (the default). A
        spacing of a quarter of the width or less resolves the kernel.
    at : mapping, optional
        Refused unless empty: no derivative is taken along a fixed axis.
    quantities : list of str, optional
        What is balanced: any of "force", "torque" and "power" at each step, and of "mass",
        "momentum", "spin" and "energy" between steps. By default force, mass and momentum, as far
        as the scene allows.
    """

    width: float | str | None = None
    at: Mapping[str, float] | None = None
    quantities: Sequence[str] | None = None


@takes(BalanceRequest)
def balance(scene: Scene, request: BalanceRequest) -> xr.Dataset:
    """Residuals of the balances of force, mass and momentum, and of spin and energy, as fields and as norms.

    With div by central differences of fourth order between the nodes,

    - ``force_residual`` = div sigma^c + sum_i F_i Psi - t, at each step: zero for the exact
      divergence, so that it shows how well the mesh resolves the kernel;
    - ``torque_residual`` = div C + sum_i T_i Psi - c, likewise, with C the couple stress, T_i the
      torque of the contact forces on a grain, and c the couple of contact forces at the contact
      points;
    - ``power_residual`` = div q_c + sum_i (F_i.v_i + T_i.omega_i) Psi + Gamma - w, likewise, with
      q_c the contact energy flux, Gamma the dissipation rate and w the power of moving walls;
    - ``mass_residual`` = d rho/dt + div p, between consecutive steps;
    - ``momentum_residual`` = d p/dt + div(rho V V + sigma) - rho g - t, between consecutive steps
      (with g);
    - ``spin_residual`` = d s/dt + div(sum I omega v Psi + C) - c, likewise, with s the spin
      density;
    - ``energy_residual`` = d e/dt + div(sum e_i v_i Psi + q_c) - p.g + Gamma - w, likewise (with
      g), with e the density of the kinetic energy.

    Rates are differences of two steps, the other terms their mean, so that these fall with the
    square of the time between the steps; consecutive frames of a usual series are far too far
    apart.

    With `by`, each phase has its residuals: t is then the force of walls and of the other phases on it
    (``interphase_force``), and the flux of its momentum is p_a V + V J_a + sigma_a, with V the
    bulk's velocity, which its stress is about, and J_a = rho_a (V_a - V) (``segregation_flux``).

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with contacts.
    {arguments}

    Returns
    -------
    xarray.Dataset
        The residuals (N m-3, N m-2, W m-3, kg m-3 s-1), and for each ``<name>_norm`` (time): its
        root mean square over the nodes, relative to that of its largest term. Between steps,
        ``time`` is that in the middle.

    Raises
    ------
    SceneError
        If the scene lacks what the fields need, or its times are not known or do not rise.
    ValueError
        If an axis is fixed or has fewer than five nodes, if each group has a width of its own, or
        with a preset; if `quantities` names no such balance or a quantity that the scene lacks, or torque,
        power, spin or energy with `by`.

    Notes
    -----
    Source: Goldhirsch (2010), eqs. 4 to 14; walls: Weinhart et al. (2012); spin and energy: Babic
    (1997).
    """
    _check_options(request)
    call = request.call("balance")
    scene, request = prepare(scene, request)
    ds = scene.ds
    refuse_cylindrical(ds, "balance")
    laws = _chosen(ds, request)
    fields = dict.fromkeys(name for law in laws.values() for name in law.fields)
    if request.by:
        fields |= dict.fromkeys(OF_PHASES)
    of_fields = request.as_request(fields=[*fields], width=request.width, for_averages=False)
    plan = make_plan(scene, of_fields)
    nodes = plan.nodes
    if not nodes.axes:
        raise ValueError(
            "balance takes differences between nodes: resolve an axis at least, such as axes='z'"
        )
    short = [a for a, size in zip(nodes.dims, nodes.sizes, strict=True) if size < 5]
    if short:
        raise ValueError(
            f"axes {short} have fewer than five nodes, which differences take; lower spacing="
        )
    if any(law.rate for law in laws.values()):
        require_times(ds, "balance")
    f = answer(scene, of_fields, plan)
    wraps = {a for a, wrapped in zip(COMPONENTS, plan.options.wrapped, strict=True) if wrapped}

    def divergence(field: xr.DataArray) -> xr.DataArray:
        dim = "component"
        if "direction" in field.dims:
            dim = "direction"
        parts = [
            _derivative(field.sel({dim: a}, drop=True), a, wraps=a in wraps) for a in nodes.axes
        ]
        return sum(parts[1:], start=parts[0])

    acceleration = np.asarray(ds.attrs.get("gravity", (0.0, 0.0, 0.0)), float)
    gravity = xr.DataArray(acceleration, {"component": list(COMPONENTS)}, "component")
    interval = xr.DataArray(np.diff(f.time.values), dims="time")
    out = dict[str, xr.DataArray]()
    for balanced, law in laws.items():
        name = f"{balanced}_residual"
        parts = law.terms(f, divergence, gravity)
        if law.rate:
            before, after = _halfway(f[law.rate])
            means = [(now + then) / 2 for now, then in map(_halfway, parts)]
            parts = [(after - before) / interval, *means]
        residual = sum(parts[1:], start=parts[0]).transpose("time", *plan.dims, ...)
        valid = residual.notnull()
        largest = xr.concat([_rms(part.where(valid)) for part in parts], "term").max("term")
        norm = _rms(residual) / largest.where(largest > 0)
        if law.rate:
            residual = residual.rename(time="interval")
            norm = norm.rename(time="interval")
        units = units_in(law.units, plan.setup.unit_system)
        text = f"{law.long_name}, relative to its largest term"
        out[name] = residual.assign_attrs(units=units, long_name=law.long_name)
        out[f"{name}_norm"] = norm.assign_attrs(units="1", long_name=text)
    coords_of_terms = {name: c for residual in out.values() for name, c in residual.coords.items()}
    # in the order of the fields
    coords = {
        name: coords_of_terms[name].variable
        for name in (*f.coords, "interval")
        if name in coords_of_terms
    }
    return xr.Dataset(
        {name: residual.variable for name, residual in out.items()},
        coords,
        f.attrs | provenance(ds, call),
    )


def _check_options(request: BalanceRequest) -> None:
    """Raise ValueError for options of `coarse_grain` that no balance has."""
    if request.at:
        raise ValueError(
            f"at= names {list(request.at)}: no derivative is taken along a fixed axis, or between points; resolve it, "
            "or leave it out to average"
        )
    if isinstance(request.width, Mapping):
        raise ValueError(
            "contacts between grains of different widths exchange momentum at a distance: give one width for all"
        )
    if request.preset is not None:
        raise ValueError(
            f"preset={request.preset!r}: the balances are those of fields of xcg; leave it out"
        )


def _chosen(ds: xr.Dataset, request: BalanceRequest) -> dict[str, _Law]:
    """Balances that are asked for, or the usual ones that the scene allows."""
    if (
        isinstance(request.quantities, str)
        or not set(request.quantities or ()) <= set(LAWS)
        or request.quantities == []
    ):
        raise ValueError(
            f"quantities={request.quantities!r}: expected a list of any of {', '.join(LAWS)}"
        )
    lacking = {name for name, law in LAWS.items() if law.rate and ds.sizes["time"] < 2}
    lacking |= {
        name for name, law in LAWS.items() if law.needs_gravity and "gravity" not in ds.attrs
    }
    for name in request.quantities or ():
        if name in lacking:
            way_out = "; open two steps or more"
            if LAWS[name].needs_gravity:
                way_out = ", and takes the scene's gravity; open two steps or more, with gravity="
            raise ValueError(
                f"quantities={list(request.quantities or ())}: the balance of {name} holds between steps{way_out}"
            )
        if request.by is not None and name in OF_THE_MIXTURE:
            raise ValueError(
                f"quantities={list(request.quantities or ())}: the balance of {name} holds for all grains "
                "together; leave out by="
            )
    if request.quantities:
        return {name: LAWS[name] for name in request.quantities}
    if not times_are_known(ds):
        lacking |= {name for name, law in LAWS.items() if law.rate}
    return {name: LAWS[name] for name in USUAL if name not in lacking}


def _halfway(field: xr.DataArray) -> tuple[xr.DataArray, xr.DataArray]:
    """Return the values before and after the time in the middle between each step and the next."""
    bare = field.drop_vars(["time", "step"], errors="ignore")
    middle = (field.time[1:].variable + field.time[:-1].values) / 2
    middle.attrs = field.time.attrs | {"long_name": "time in the middle between two steps"}
    before = bare.isel(time=slice(None, -1)).assign_coords(time=middle)
    after = bare.isel(time=slice(1, None)).assign_coords(time=middle)
    return before, after


def _rms(field: xr.DataArray) -> xr.DataArray:
    return (field**2).mean([d for d in field.dims if d != "time"]) ** 0.5
