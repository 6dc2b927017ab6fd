"""Pysammos's names for fields, its variants of them, and its mesh: ``coarse_grain(preset="pysammos")``.

Its names carry their variant: ``inertial_number_Sxy_Pxy_d32`` takes the shear rate in the plane xy, the pressure
(sigma_xx + sigma_yy) / 2 and d32. Each is algebra on fields of xcg, so that values are those of `xcg.fields`. Formulas:
Pysammos 1.0.0 and its paper (EGUsphere 2026-2591). What differs from it is listed in the documentation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import xarray as xr

from xcg import fields as registry
from xcg.plan import choose_width
from xcg.scene import setup_of
from xcg.schema import COMPONENTS
from xcg.smoothing import as_kernel

_TENSOR = ("component", "direction")
_RATE = "shear_rate_tensor"


_RENAMED = {
    "volume_fraction": "volume_fraction",
    "density_mixture": "density",
    "density_particle": "particle_density",
    "d32": "d32",
    "d43": "d43",
    "coordination_number": "coordination_number",
    "momentum_density": "momentum_density",
    "velocity": "velocity",
    "velocity_gradient": "velocity_gradient",
    "contact_tensor": "contact_stress",
    "fabric_tensor": "fabric",
}


@dataclass(frozen=True)
class Row:
    """One of its fields.

    Attributes
    ----------
    family : str
        Its key among ``fields_to_export``.
    needs : tuple of str
        Fields of xcg.
    compute : callable
        From a Dataset that holds these to the values.
    formula : str
        In names of xcg.
    units : str
        The field of xcg that it shares its units with; "" for a pure number.
    """

    family: str
    needs: tuple[str, ...]
    compute: Callable[[xr.Dataset], xr.DataArray]
    formula: str
    units: str


def _on_tensor(function: Callable[..., Any], tensor: xr.DataArray, *, scalar: bool) -> xr.DataArray:
    """Apply the registry's algebra of tensors to a labelled one."""
    return xr.apply_ufunc(
        function, tensor, input_core_dims=[_TENSOR], output_core_dims=[() if scalar else _TENSOR],
        dask="parallelized", output_dtypes=[float], keep_attrs=False,
    )  # fmt: skip


def rows(plane: str, axes: str) -> dict[str, Row]:
    """Its fields by their names.

    Parameters
    ----------
    plane : str
        Two axes, for ``xy`` in the names.
    axes : str
        The axes of the scene, for ``xyz``: all three, or those of a layer.
    """
    index = {name: tuple(COMPONENTS.index(a) for a in dims) for name, dims in (("xyz", axes), (plane, plane))}
    index |= {a: (COMPONENTS.index(a),) for a in axes}
    table: dict[str, Row] = {}

    def add(name: str, family: str, needs: Sequence[str], compute: Any, formula: str, units: str = "") -> None:
        table[name] = Row(family, tuple(needs), compute, formula, units)

    def renamed(name: str, ours: str) -> None:
        add(name, name, (ours,), lambda f: f[ours], ours, ours)

    def parts(dims: str) -> tuple[Callable[[xr.DataArray], xr.DataArray], Callable[[xr.DataArray], xr.DataArray]]:
        """Restriction to some axes, and its deviator."""
        part = partial(registry.restricted, axes=index[dims])
        return (
            lambda x: _on_tensor(part, x, scalar=False),
            lambda x: _on_tensor(lambda a: registry.deviator(part(a), index[dims]), x, scalar=False),
        )

    def kinetic(f: xr.Dataset) -> xr.DataArray:
        # where the grains are too few for a fit, fluctuations are those about V(r)
        return f["fluctuation_stress"].fillna(f["kinetic_stress"])

    def total(f: xr.Dataset) -> xr.DataArray:
        return f["contact_stress"] + kinetic(f)

    def pressure(f: xr.Dataset, dims: str) -> xr.DataArray:
        return _on_tensor(partial(registry.mean_normal, axes=index[dims]), total(f), scalar=True)

    def stress_size(x: xr.DataArray) -> xr.DataArray:
        return _on_tensor(registry.stress_magnitude, x, scalar=True)

    def rate_size(x: xr.DataArray) -> xr.DataArray:
        return _on_tensor(registry.rate_magnitude, x, scalar=True)

    for name, ours in _RENAMED.items():
        renamed(name, ours)

    def add_tensor(label: str, needs: Sequence[str], tensor: Any, size: Any, size_formula: str, dims: str) -> None:
        """Add one tensor restricted to some axes, its deviator, and the magnitudes of both."""
        part, dev = parts(dims)
        name, units = f"{label}_{dims}", needs[0]
        add(name, label, needs, lambda f: part(tensor(f)), f"{label}, restricted to {dims}", units)
        add(f"{name}_mag", label, needs, lambda f: size(part(tensor(f))), size_formula, units)
        add(f"{name}_dev", label, needs, lambda f: dev(tensor(f)), f"deviator over {dims}", units)
        add(f"{name}_dev_mag", label, needs, lambda f: size(dev(tensor(f))), size_formula, units)

    both = ("contact_stress", "fluctuation_stress", "kinetic_stress")
    add("kinetic_tensor", "kinetic_tensor", both[1:], kinetic, "fluctuation_stress, else kinetic_stress", both[1])
    for dims in ("xyz", plane):
        add_tensor("total_stress_tensor", both, total, stress_size, "sqrt(X:X / 2)", dims)
        add_tensor(_RATE, (_RATE,), lambda f: f[_RATE], rate_size, "sqrt(2 X:X)", dims)
    for dims in ("xyz", plane, *axes):
        formula = f"mean of sigma_aa, a in {dims}"
        add(f"pressure_{dims}", "pressure", both, lambda f, dims=dims: pressure(f, dims), formula, both[0])
    temperature, along = "granular_temperature", "directional_temperature"
    add(f"{temperature}_xyz", temperature, (temperature,), lambda f: f[temperature], temperature, temperature)
    for a in axes:
        add(
            f"{temperature}_{a}", temperature, (along,), lambda f, a=a: f[along].sel(component=a, drop=True),
            f"{along} along {a}", along,
        )  # fmt: skip

    def inertial(f: xr.Dataset, dims: str, size: str) -> xr.DataArray:
        p = pressure(f, dims)
        rate = rate_size(parts(plane)[1](f[_RATE]))
        return rate * f[size] * (f["particle_density"] / p.where(p > 0)) ** 0.5

    def friction(f: xr.Dataset, kind: str, dims: str) -> xr.DataArray:
        sigma, p = total(f), pressure(f, dims)
        if kind == "01":
            shear = abs(sigma.sel(component=plane[0], direction=plane[1], drop=True))
        else:
            shear = stress_size(parts(kind.removeprefix("D"))[1](sigma))
        return shear / p.where(p > 0)

    pressures = ("xyz", plane, plane[1])
    for size in ("d43", "d32"):
        for dims in pressures:
            add(
                f"inertial_number_S{plane}_P{dims}_{size}", "inertial_number",
                (_RATE, "particle_density", size, *both),
                lambda f, dims=dims, size=size: inertial(f, dims, size),
                f"shear_rate_tensor_{plane}_dev_mag {size} sqrt(density_particle / pressure_{dims}), pressure > 0",
            )  # fmt: skip
    for kind in ("Dxyz", f"D{plane}", "01"):
        for dims in pressures:
            shear = f"|sigma_{plane}|" if kind == "01" else f"total_stress_tensor_{kind[1:]}_dev_mag"
            add(
                f"frictional_coefficient_{kind}_P{dims}", "frictional_coefficient", both,
                lambda f, kind=kind, dims=dims: friction(f, kind, dims), f"{shear} / pressure_{dims}, pressure > 0",
            )  # fmt: skip
    return table


def choose(asked: str | Sequence[str] | None, table: Mapping[str, Row], available: Sequence[str]) -> list[str]:
    """Names for a request: names, keys of ``fields_to_export``, or None for all that `available` fields of xcg allow.

    Raises
    ------
    ValueError
        For names that are neither.
    """
    if asked is None:
        return [name for name, row in table.items() if set(row.needs) <= set(available)]
    names: list[str] = []
    for word in [asked] if isinstance(asked, str) else asked:
        found = [word] if word in table else [name for name, row in table.items() if row.family == word]
        if not found:
            msg = f"unknown field {word!r} of the preset 'pysammos': choose from {', '.join(table)}"
            raise ValueError(msg)
        names += found
    return list(dict.fromkeys(names))


def plane_of(ds: xr.Dataset, shear_dims: str | None) -> tuple[str, str]:
    """Plane for ``xy`` in the names, and axes for ``xyz``.

    Raises
    ------
    ValueError
        If `shear_dims` are not two axes of the scene.
    """
    axes = setup_of(ds).plane
    plane = shear_dims or ("xy" if len(axes) == 3 else axes)
    if len(set(plane)) != 2 or len(plane) != 2 or set(plane) - set(axes):
        msg = f"shear_dims={shear_dims!r}: the preset 'pysammos' takes a plane, two axes of {axes!r}"
        raise ValueError(msg)
    return plane, axes


def from_xcg(f: xr.Dataset, names: Sequence[str], table: Mapping[str, Row]) -> xr.Dataset:
    """Compute its fields from a result of `xcg.coarse_grain` that holds what they need."""
    out = {}
    for name in names:
        row = table[name]
        units = f[row.units].attrs["units"] if row.units else "1"
        attrs = {"units": units, "long_name": name.replace("_", " "), "formula": row.formula}
        out[name] = row.compute(f).assign_attrs(attrs)
    if "sample_count" in f:
        out["sample_count"] = f["sample_count"]
    return xr.Dataset(out, attrs=f.attrs)


def pysammos_mesh(
    ds: xr.Dataset, axes: str = "xyz", *, width: float | str | None = None, kernel: str = "lucy"
) -> dict[str, Any]:
    """Arguments for `xcg.coarse_grain` that place nodes as Pysammos does.

    Its spacing is c / 2; its automatic range leaves ``2.5 c + 0.5 dmax`` off the extent of the particles on each side;
    axes that are not resolved are cut in the middle of that extent.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with the attributes particle_lower, particle_upper and dmax.
    axes : str
        Resolved axes: three, two, or one.
    width, kernel
        As in `xcg.coarse_grain`.

    Returns
    -------
    dict
        ``axes``, ``at``, ``bounds``, ``spacing``, ``width`` (m) and ``kernel``.

    Raises
    ------
    ValueError
        If the scene was not measured, or is too small for the margin.

    Examples
    --------
    >>> import xcg
    >>> ds = xcg.datasets.simple_cubic(10)
    >>> f = ds.cg.coarse_grain(preset="pysammos", **xcg.pysammos_mesh(ds, "xz"))
    """
    lacking = [name for name in ("particle_lower", "particle_upper", "dmax") if name not in ds.attrs]
    if lacking:
        msg = f"pysammos_mesh needs the attributes {lacking}; call ds = ds.cg.measure() first"
        raise ValueError(msg)
    setup = setup_of(ds)
    chosen = as_kernel(kernel, choose_width(width, ds.attrs), setup.dimension)
    margin = 2.5 * chosen.cutoff + 0.5 * float(ds.attrs["dmax"])
    lower, upper = (dict(zip(COMPONENTS, ds.attrs[f"particle_{end}"], strict=True)) for end in ("lower", "upper"))
    axes = "".join(a for a in axes if a in setup.plane)
    bounds = {a: (float(lower[a]) + margin, float(upper[a]) - margin) for a in axes}
    small = [a for a, (first, last) in bounds.items() if first > last]
    if small:
        msg = (
            f"the particles extend less than twice the margin of 2.5 c + 0.5 dmax = {margin:g} along {small}: give "
            "bounds= yourself, or a smaller width"
        )
        raise ValueError(msg)
    at = {a: 0.5 * float(lower[a] + upper[a]) for a in setup.plane if a not in axes}
    return {
        "axes": axes, "at": at, "bounds": bounds, "spacing": chosen.cutoff / 2, "width": chosen.width, "kernel": kernel
    }  # fmt: skip
