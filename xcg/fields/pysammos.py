"""Pysammos's names for fields, its variants of them, and its mesh: ``coarse_grain(preset="pysammos")``.

Its names carry their variant: ``inertial_number_Sxy_Pxy_d32`` takes the shear rate in the plane xy, the pressure
(sigma_xx + sigma_yy) / 2 and d32. Each is algebra on fields of xcg, so that values are those of the registry. Formulas:
Pysammos 1.0.0 and its paper (EGUsphere 2026-2591). What differs from it is listed in the documentation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import xarray as xr

from xcg.fields import algebra, registry
from xcg.fields.plan import make_plan
from xcg.fields.request import Request
from xcg.fields.smoothing import as_kernel, choose_width
from xcg.fields.variables import Quantity
from xcg.scene.query import require_scene, setup_of
from xcg.scene.schema import COMPONENTS, did_you_mean, units_of
from xcg.scene.sizes import with_measures

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
    "kinetic_tensor": "kinetic_stress",
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
        part = partial(algebra.restricted, axes=index[dims])
        return (
            lambda x: _on_tensor(part, x, scalar=False),
            lambda x: _on_tensor(lambda a: algebra.deviator(part(a), index[dims]), x, scalar=False),
        )

    def normal(x: xr.DataArray, dims: str) -> xr.DataArray:
        """Mean of the normal components along some axes."""
        return _on_tensor(partial(algebra.mean_normal, axes=index[dims]), x, scalar=True)

    def pressure(f: xr.Dataset, dims: str) -> xr.DataArray:
        return normal(f["stress"], dims)

    def temperature(f: xr.Dataset, dims: str) -> xr.DataArray:
        # of the whole density: nothing is taken off for the freedoms of the fit
        return normal(f["fluctuation_stress"], dims).clip(min=0.0) / f["density"].where(f["density"] > 0)

    def stress_size(x: xr.DataArray) -> xr.DataArray:
        return _on_tensor(algebra.stress_magnitude, x, scalar=True)

    def rate_size(x: xr.DataArray) -> xr.DataArray:
        return _on_tensor(algebra.rate_magnitude, x, scalar=True)

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

    for dims in ("xyz", plane):
        add_tensor("total_stress_tensor", ("stress",), lambda f: f["stress"], stress_size, "sqrt(X:X / 2)", dims)
        add_tensor(_RATE, (_RATE,), lambda f: f[_RATE], rate_size, "sqrt(2 X:X)", dims)
    for dims in ("xyz", plane, *axes):
        formula = f"mean of sigma_aa, a in {dims}"
        add(f"pressure_{dims}", "pressure", ("stress",), lambda f, dims=dims: pressure(f, dims), formula, "stress")
    for dims in ("xyz", *axes):
        add(
            f"granular_temperature_{dims}", "granular_temperature", ("fluctuation_stress", "density"),
            lambda f, dims=dims: temperature(f, dims), f"mean of fluctuation_stress_aa / density, a in {dims}",
            "granular_temperature",
        )  # fmt: skip

    def inertial(f: xr.Dataset, dims: str, size: str) -> xr.DataArray:
        p = pressure(f, dims)
        rate = rate_size(parts(plane)[1](f[_RATE]))
        return rate * f[size] * (f["particle_density"] / p.where(p > 0)) ** 0.5

    def friction(f: xr.Dataset, kind: str, dims: str) -> xr.DataArray:
        sigma, p = f["stress"], pressure(f, dims)
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
                (_RATE, "particle_density", size, "stress"),
                lambda f, dims=dims, size=size: inertial(f, dims, size),
                f"shear_rate_tensor_{plane}_dev_mag {size} sqrt(density_particle / pressure_{dims}), pressure > 0",
            )  # fmt: skip
    for kind in ("Dxyz", f"D{plane}", "01"):
        for dims in pressures:
            shear = f"|sigma_{plane}|" if kind == "01" else f"total_stress_tensor_{kind[1:]}_dev_mag"
            add(
                f"frictional_coefficient_{kind}_P{dims}", "frictional_coefficient", ("stress",),
                lambda f, kind=kind, dims=dims: friction(f, kind, dims), f"{shear} / pressure_{dims}, pressure > 0",
            )  # fmt: skip
    return table


def choose(
    asked: str | Quantity | Sequence[str | Quantity] | None, table: Mapping[str, Row], available: Sequence[str]
) -> list[str]:
    """Names for a request: names, keys of ``fields_to_export``, or None for all that `available` fields of xcg allow.

    Raises
    ------
    ValueError
        For names that are neither.
    """
    if asked is None:
        return [name for name, row in table.items() if set(row.needs) <= set(available)]
    names: list[str] = []
    for word in map(str, [asked] if isinstance(asked, (str, Quantity)) else asked):
        found = [word] if word in table else [name for name, row in table.items() if row.family == word]
        if not found:
            known = f"choose from {', '.join(table)}{did_you_mean(word, table)}"
            msg = f"unknown field {word!r} of the preset 'pysammos': {known}"
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
        powers = registry.FIELDS[row.units].powers if row.units else (0, 0, 0)
        units = units_of(powers, f.attrs["unit_system"])
        attrs = {"units": units, "long_name": name.replace("_", " "), "formula": row.formula}
        out[name] = row.compute(f).assign_attrs(attrs)
    if "sample_count" in f:
        out["sample_count"] = f["sample_count"]
    return xr.Dataset(out, attrs=f.attrs)


def translate(ds: xr.Dataset, request: Request) -> tuple[Request, Callable[[xr.Dataset], xr.Dataset]]:
    """Put a request in its names into names of xcg; the function turns the answer into its fields.

    Raises
    ------
    SceneError
        If `ds` is not a scene.
    ValueError
        If a variant is asked for by an argument, or names or plane are wrong.
    """
    clash = request.changed(("pressure_dims", "deviatoric", "size", "temperature"))
    if clash:
        msg = f"preset='pysammos' has a name for each variant: leave out {clash}, and take the field that you want"
        raise ValueError(msg)
    require_scene(ds, (), "coarse_grain")
    table = rows(*plane_of(ds, request.shear_dims))
    own = replace(request, preset=None, shear_dims=None)
    names = choose(request.fields, table, make_plan(ds, replace(own, fields=None)).fields)
    needed = list(dict.fromkeys(["sample_count", *(n for name in names for n in table[name].needs)]))
    # its temperature is per density; other fields do not depend on it
    return replace(own, fields=needed, temperature="biased"), partial(from_xcg, names=names, table=table)


def pysammos_mesh(
    ds: xr.Dataset,
    axes: str = "xyz",
    *,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    at: Mapping[str, float] | None = None,
    width: float | str | None = None,
    kernel: str = "lucy",
) -> dict[str, Any]:
    """Arguments for `xcg.coarse_grain` that place nodes as Pysammos does.

    It divides the range from first to last into the fewest equal parts that are no longer than c / 2, so that both
    are nodes. Its automatic range leaves ``2.5 c + 0.5 dmax`` off the extent of the particles on each side, and axes
    that are not resolved are cut in the middle of that extent.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with the attributes particle_lower, particle_upper and dmax.
    axes : str
        Resolved axes: three, two, or one; those that the scene lacks (one layer) are left out.
    bounds : mapping, optional
        First and last node of resolved axes (m), in place of the automatic range.
    at : mapping, optional
        Coordinates of axes that are not resolved (m), in place of the middle.
    width, kernel
        As in `xcg.coarse_grain`.

    Returns
    -------
    dict
        ``axes``, ``at``, ``bounds``, ``spacing`` (m, by axis), ``width`` (m) and ``kernel``.

    Raises
    ------
    ValueError
        If the scene was not measured, or is too small for the margin of the automatic range.

    Examples
    --------
    >>> import xcg
    >>> ds = xcg.datasets.simple_cubic(10)
    >>> f = ds.cg.coarse_grain(preset="pysammos", **xcg.pysammos_mesh(ds, "xz"))
    """
    ds = with_measures(ds)
    lacking = [name for name in ("particle_lower", "particle_upper", "dmax") if name not in ds.attrs]
    if lacking:
        msg = f"pysammos_mesh needs the attributes {lacking}; call ds = ds.cg.measure() first"
        raise ValueError(msg)
    setup = setup_of(ds)
    chosen = as_kernel(kernel, choose_width(width, ds.attrs), setup.dimension)
    lower, upper = ([float(x) for x in ds.attrs[f"particle_{end}"]] for end in ("lower", "upper"))
    extent = {a: (lower[k], upper[k]) for k, a in enumerate(COMPONENTS) if a in setup.plane}
    resolved = "".join(a for a in axes if a in extent)
    margin = 2.5 * chosen.cutoff + 0.5 * float(ds.attrs["dmax"])
    ranges = {a: (extent[a][0] + margin, extent[a][1] - margin) for a in resolved}
    small = [a for a, (first, last) in ranges.items() if first > last and a not in (bounds or {})]
    if small:
        msg = (
            f"the particles extend less than twice the margin of 2.5 c + 0.5 dmax = {margin:g} along {small}: give "
            "bounds= yourself, or a smaller width"
        )
        raise ValueError(msg)
    ranges |= {a: ends for a, ends in (bounds or {}).items() if a in extent}
    middle = {a: 0.5 * (first + last) for a, (first, last) in extent.items() if a not in resolved}
    return {
        "axes": resolved,
        "at": middle | {a: value for a, value in (at or {}).items() if a in extent},
        "bounds": ranges,
        "spacing": {a: _spacing(*ends, chosen.cutoff) for a, ends in ranges.items()},
        "width": chosen.width,
        "kernel": kernel,
    }


def _spacing(first: float, last: float, cutoff: float) -> float:
    """Length of the equal parts of a range; half the cutoff for one without a length, which is one node."""
    length = last - first
    return length / math.ceil(2 * length / cutoff) if 0 < length < math.inf else cutoff / 2
