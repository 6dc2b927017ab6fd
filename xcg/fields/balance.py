"""Residuals of the balance laws on a mesh: whether mesh and time between frames resolve the flow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from xcg.fields.coarse_grain import answer, of_bodies
from xcg.fields.plan import make_plan
from xcg.fields.request import SharedOptions, takes
from xcg.scene.conform import takes_scene
from xcg.scene.query import box_stays, require_rising_times
from xcg.scene.schema import COMPONENTS

FIELDS = [
    "density",
    "momentum_density",
    "velocity",
    "stress",
    "contact_stress",
    "contact_force_density",
    "wall_traction",
]
OF_PHASES = ["interphase_force", "segregation_flux"]  # what phases have besides


def _derivative(field: xr.DataArray, axis: str, *, wraps: bool) -> xr.DataArray:
    """Central difference of fourth order; NaN at the two nodes next to an end, unless the axis wraps."""
    step = float(field[axis][1] - field[axis][0])
    nodes = field.sizes[axis]
    wide = field.pad({axis: 2}, mode="wrap") if wraps else field.pad({axis: 2}, constant_values=np.nan)
    near, far = (
        wide.isel({axis: slice(2 + k, nodes + 2 + k)}).drop_vars(axis)
        - wide.isel({axis: slice(2 - k, nodes + 2 - k)}).drop_vars(axis)
        for k in (1, 2)
    )
    return ((8 * near - far) / (12 * step)).assign_coords({axis: field[axis]})


def _divergence(field: xr.DataArray, dim: str, axes: str, wraps: set[str]) -> xr.DataArray:
    """Sum over the axes of the derivative of the components along `dim`; averaged axes have none."""
    parts = [_derivative(field.sel({dim: a}, drop=True), a, wraps=a in wraps) for a in axes]
    return sum(parts[1:], start=parts[0])


@dataclass(frozen=True, kw_only=True)
class BalanceRequest(SharedOptions):
    """Arguments of `balance`: every axis must be resolved or averaged, with five nodes or more.

    Parameters
    ----------
    width : float or str, optional
        Half-width w of the kernel (m), or a multiple of a size such as "0.75 d43" (the default). A spacing of a quarter
        of the width or less resolves the kernel.
    at : mapping, optional
        Refused unless empty: no derivative is taken along a fixed axis.
    """

    width: float | str | None = None
    at: Mapping[str, float] | None = None


@takes_scene
@takes(BalanceRequest)
def balance(ds: xr.Dataset, asked: BalanceRequest) -> xr.Dataset:
    """Residuals of the balances of force, mass and momentum, as fields and as norms.

    With div by central differences of fourth order between the nodes,

    - ``force_residual`` = div sigma^c + sum_i F_i Psi - t, at each step: zero for the exact divergence, so that
      it tells how well the mesh resolves the kernel;
    - ``mass_residual`` = d rho/dt + div p, between consecutive steps;
    - ``momentum_residual`` = d p/dt + div(rho V V + sigma) - rho g - t, between consecutive steps (with g).

    Rates are differences of two steps, the other terms their mean, so that these fall with the square of the time
    between the steps; consecutive frames of a usual series are far too far apart.

    With `by`, each phase has its residuals: t is then what walls and the other phases do to it
    (``interphase_force``), and the flux of its momentum is p_a V + V J_a + sigma_a, with V the bulk's velocity, which
    its stress is about, and J_a = rho_a (V_a - V) (``segregation_flux``).

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with contacts.
    {arguments}

    Returns
    -------
    xarray.Dataset
        The residuals (N m-3, kg m-3 s-1), and for each ``<name>_norm`` (time): its root mean square over the nodes,
        relative to that of its largest term. Between steps, ``time`` is that in the middle.

    Raises
    ------
    SceneError
        If the scene lacks what the fields need, or its times do not rise.
    ValueError
        If an axis is fixed or has fewer than five nodes, if each group has a width of its own, or with a preset.

    Notes
    -----
    Source: Goldhirsch (2010), eqs. 4 to 14; walls: Weinhart et al. (2012).
    """
    if asked.at:
        msg = f"at={asked.at!r}: no derivative is taken along a fixed axis; resolve it, or leave it out to average"
        raise ValueError(msg)
    if isinstance(asked.width, Mapping):
        msg = "contacts between grains of different widths exchange momentum at a distance: give one width for all"
        raise ValueError(msg)
    if asked.preset is not None:
        msg = f"preset={asked.preset!r}: the balances are those of fields of xcg; leave it out"
        raise ValueError(msg)
    ds, asked = of_bodies(ds, asked)
    request = asked.ask(fields=[*FIELDS, *(OF_PHASES if asked.by else [])], width=asked.width)
    plan = make_plan(ds, request)
    grid = plan.deposit.grid
    short = [a for a in grid.axes if len(grid.nodes[a]) < 5]
    if short:
        msg = f"axes {short} have fewer than five nodes: differences of fourth order need them; lower spacing="
        raise ValueError(msg)
    if ds.sizes["time"] > 1:
        require_rising_times(ds, "balance")
    f = answer(ds, request)
    wraps = set(plan.setup.periodic) & set(grid.axes) - set(asked.bounds or {}) if box_stays(ds) else set()

    def divergence(field: xr.DataArray, dim: str) -> xr.DataArray:
        return _divergence(field, dim, grid.axes, wraps)

    traction = f.interphase_force.sum("other_phase") if asked.by else f.wall_traction
    terms: dict[str, list[xr.DataArray]] = {
        "force_residual": [divergence(f.contact_stress, "direction"), f.contact_force_density, -traction]
    }
    if f.sizes["time"] > 1:
        terms["mass_residual"] = [_between_steps(f.density), _middle(divergence(f.momentum_density, "component"))]
    if f.sizes["time"] > 1 and "gravity" in ds.attrs:
        velocity = f.velocity.sel(phase="bulk", drop=True) if asked.by else f.velocity
        flux = f.momentum_density * velocity.rename(component="direction") + f.stress
        if asked.by:
            flux = flux + velocity * f.segregation_flux.rename(component="direction")
        flux = flux.where(f.density > 0, f.stress)
        sources = [divergence(flux, "direction"), -f.density * _gravity(ds), -traction]
        terms["momentum_residual"] = [_between_steps(f.momentum_density), *map(_middle, sources)]
    out: dict[str, xr.DataArray] = {}
    about = {
        "force_residual": ("N m-3", "residual of the divergence of contact stress"),
        "mass_residual": ("kg m-3 s-1", "residual of the balance of mass"),
        "momentum_residual": ("N m-3", "residual of the balance of momentum"),
    }
    for name, parts in terms.items():
        unit, long_name = about[name]
        unit = unit if plan.setup.unit_system == "SI" else "1"
        steps = {} if name == "force_residual" else {"time": "interval"}
        residual = sum(parts[1:], start=parts[0]).transpose("time", *plan.dims, ...)
        valid = residual.notnull()
        largest = xr.concat([_rms(part.where(valid)) for part in parts], "term").max("term")
        norm = (_rms(residual) / largest.where(largest > 0)).rename(steps)
        out[name] = residual.rename(steps).assign_attrs(units=unit, long_name=long_name)
        out[f"{name}_norm"] = norm.assign_attrs(units="1", long_name=f"{long_name}, relative to its largest term")
    known = {name: c for residual in out.values() for name, c in residual.coords.items()}
    coords = {name: known[name] for name in (*f.coords, "interval") if name in known}  # in the order of the fields
    return xr.Dataset({name: residual.variable for name, residual in out.items()}, coords, f.attrs)


def _gravity(ds: xr.Dataset) -> xr.DataArray:
    return xr.DataArray(np.asarray(ds.attrs["gravity"], float), {"component": list(COMPONENTS)}, "component")


def _ends(field: xr.DataArray) -> tuple[xr.DataArray, xr.DataArray, Any]:
    """Each step but the last, each but the first, and the times in the middle."""
    bare = field.drop_vars(["time", "step"], errors="ignore")
    middle = (field.time[:-1].values + field.time[1:].values) / 2
    return bare.isel(time=slice(None, -1)), bare.isel(time=slice(1, None)), middle


def _between_steps(field: xr.DataArray) -> xr.DataArray:
    """Rate of change from each step to the next, at the time in the middle."""
    first, second, middle = _ends(field)
    return ((second - first) / xr.DataArray(np.diff(field.time.values), dims="time")).assign_coords(time=middle)


def _middle(field: xr.DataArray) -> xr.DataArray:
    """Mean of each step and the next, at the time in the middle."""
    first, second, middle = _ends(field)
    return ((first + second) / 2).assign_coords(time=middle)


def _rms(field: xr.DataArray) -> xr.DataArray:
    return (field**2).mean([d for d in field.dims if d != "time"]) ** 0.5
