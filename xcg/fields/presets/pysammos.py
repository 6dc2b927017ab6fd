"""Pysammos's names for fields, its variants of them, and its mesh: ``coarse_grain(preset="pysammos")``.

Its names carry their variant: ``inertial_number_Sxy_Pxy_d32`` takes the shear rate in the plane xy,
the pressure (sigma_xx + sigma_yy) / 2 and d32. Each is algebra on fields of xcg, so that values
follow the registry. Formulas: Pysammos 1.0.0 and its paper (EGUsphere 2026-2591). What differs from
it is listed in the documentation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import product
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.messages import unknown
from xcg.fields.choice import possible_fields
from xcg.fields.formulas import algebra, registry
from xcg.fields.formulas.algebra import at_least_zero, where_positive
from xcg.fields.formulas.field import Field, Options, Quantity
from xcg.fields.grids.grid import check_axes
from xcg.fields.request import Request
from xcg.fields.sums.kernels import KernelName, kernel_of
from xcg.scene.conform import takes_scene
from xcg.scene.scene import Scene
from xcg.scene.schema import COMPONENTS

_RATE = "shear_rate_tensor"
_SAME = ("d32", "d43", "coordination_number", "momentum_density", "velocity", "velocity_gradient")
_RENAMED = {
    "volume_fraction": "volume_fraction",
    "density_mixture": "density",
    "density_particle": "particle_density",
    **{name: name for name in _SAME},
    "kinetic_tensor": "kinetic_stress",
    "contact_tensor": "contact_stress",
    "fabric_tensor": "fabric",
}


@dataclass(frozen=True)
class Formula:
    """A function of the fields at hand and of further arguments, as the algebra of a row.

    Two of the same are equal, so that a program that was made for one serves the other.
    """

    function: Callable[..., NDArray]
    arguments: tuple[Any, ...]

    def __call__(self, f: Any, s: Any, o: Options) -> NDArray:
        """Compute the field from others."""
        return self.function(f, *self.arguments)


@dataclass(frozen=True)
class PysammosRow:
    """Field of the preset.

    Attributes
    ----------
    name : str
    family : str
        Its key among ``fields_to_export``.
    field : Field
        Its units, the fields of xcg that it is made of, and the algebra.
    """

    name: str
    family: str
    field: Field


def _part(
    f: Any,
    tensor: str,
    axes: tuple[int, ...],
    deviatoric: bool,
    magnitude: Callable[[NDArray], NDArray] | None = None,
) -> NDArray:
    """Restriction of a tensor to some axes, or the deviator of that, or a magnitude of either."""
    part = algebra.restricted(getattr(f, tensor), axes)
    if deviatoric:
        part = algebra.deviator(part, axes)
    if magnitude is not None:
        part = magnitude(part)
    return part


def _pressure(f: Any, axes: tuple[int, ...]) -> NDArray:
    return algebra.mean_normal(f.stress, axes)


def _temperature(f: Any, axes: tuple[int, ...]) -> NDArray:
    # divided by rho, without subtracting the degrees of freedom of the fit
    return at_least_zero(algebra.mean_normal(f.fluctuation_stress, axes)) / where_positive(
        f.density
    )


def _inertial(f: Any, plane: tuple[int, ...], axes: tuple[int, ...], size: str) -> NDArray:
    rate = algebra.rate_magnitude(_part(f, _RATE, plane, deviatoric=True))
    return (
        rate * getattr(f, size) * np.sqrt(f.particle_density / where_positive(_pressure(f, axes)))
    )


def _friction(f: Any, shear: tuple[int, ...], axes: tuple[int, ...], component: bool) -> NDArray:
    if component:
        stress = algebra.absolute(f.stress[..., shear[0], shear[1]])
    else:
        stress = algebra.stress_magnitude(_part(f, "stress", shear, deviatoric=True))
    return stress / where_positive(_pressure(f, axes))


def _row(
    name: str,
    family: str,
    needs: Sequence[str],
    formula: str,
    compute: Callable[..., NDArray],
    *arguments: Any,
    rank: int = 0,
    like: str = "",
) -> PysammosRow:
    """Return a row; `compute` takes the fields and `arguments`, and the unit is that of the field `like`."""
    units = "1"
    if like:
        units = registry.FIELDS[like].units
    field = Field(
        rank=rank,
        units=units,
        long_name=name.replace("_", " "),
        formula=formula,
        compute=Formula(compute, arguments),
        fields=tuple(needs),
    )
    return PysammosRow(name, family, field)


@lru_cache
def rows(plane: str, axes: str) -> Mapping[str, PysammosRow]:
    """Its fields by their names.

    Parameters
    ----------
    plane : str
        Two axes, for ``xy`` in the names.
    axes : str
        The axes of the scene, for ``xyz``: all three, or the two of a layer.
    """
    # by their name in names of fields
    named = {"xyz": axes, plane: plane, **dict(zip(axes, axes, strict=True))}
    index = {name: tuple(map(COMPONENTS.index, dims)) for name, dims in named.items()}
    table = [
        _row(name, name, (ours,), ours, getattr, ours, rank=registry.FIELDS[ours].rank, like=ours)
        for name, ours in _RENAMED.items()
    ]
    for dims in ("xyz", plane):
        table += _parts_of_tensors(dims, index[dims])
    for dims in ("xyz", plane, *axes):
        formula = f"mean of sigma_aa, a in {dims}"
        name = f"pressure_{dims}"
        arguments = (_pressure, index[dims])
        table.append(_row(name, "pressure", ("stress",), formula, *arguments, like="stress"))
    temperature = "granular_temperature"
    for dims in ("xyz", *axes):
        formula = f"mean of fluctuation_stress_aa / density, a in {dims}"
        needs = ("fluctuation_stress", "density")
        name = f"{temperature}_{dims}"
        arguments = (_temperature, index[dims])
        table.append(_row(name, temperature, needs, formula, *arguments, like=temperature))
    table += _numbers_of_rheology(plane, index)
    return {row.name: row for row in table}


def _parts_of_tensors(dims: str, axes: tuple[int, ...]) -> list[PysammosRow]:
    """Restrictions of stress and shear rate to some axes, their deviators, and the magnitudes of both."""
    table = []
    for family, tensor, size, formula in (
        ("total_stress_tensor", "stress", algebra.stress_magnitude, "sqrt(X:X / 2)"),
        (_RATE, _RATE, algebra.rate_magnitude, "sqrt(2 X:X)"),
    ):
        for deviatoric, end, what in (
            (False, "", f"{family}, restricted to {dims}"),
            (True, "_dev", f"deviator over {dims}"),
        ):
            name = f"{family}_{dims}{end}"
            arguments = (tensor, axes, deviatoric)
            table.append(
                _row(name, family, (tensor,), what, _part, *arguments, rank=2, like=tensor)
            )
            of_part = _row(
                f"{name}_mag", family, (tensor,), formula, _part, *arguments, size, like=tensor
            )
            table.append(of_part)
    return table


def _numbers_of_rheology(plane: str, index: Mapping[str, tuple[int, ...]]) -> list[PysammosRow]:
    """Inertial numbers and friction coefficients."""
    table = []
    pressures = ("xyz", plane, plane[1])
    for diameter, dims in product(("d43", "d32"), pressures):
        name = f"inertial_number_S{plane}_P{dims}_{diameter}"
        needs = (_RATE, "particle_density", diameter, "stress")
        root = f"sqrt(density_particle / pressure_{dims}), pressure > 0"
        formula = f"shear_rate_tensor_{plane}_dev_mag {diameter} {root}"
        of_planes = (index[plane], index[dims])
        number = _row(name, "inertial_number", needs, formula, _inertial, *of_planes, diameter)
        table.append(number)
    tops = [
        ("Dxyz", "xyz", "total_stress_tensor_xyz_dev_mag"),
        (f"D{plane}", plane, f"total_stress_tensor_{plane}_dev_mag"),
        ("01", plane, f"|sigma_{plane}|"),
    ]
    for (kind, shear, top), dims in product(tops, pressures):
        name = f"frictional_coefficient_{kind}_P{dims}"
        formula = f"{top} / pressure_{dims}, pressure > 0"
        arguments = (index[shear], index[dims], kind == "01")
        table.append(
            _row(name, "frictional_coefficient", ("stress",), formula, _friction, *arguments)
        )
    return table


def choose(
    fields: str | Quantity | Sequence[str | Quantity] | None,
    table: Mapping[str, PysammosRow],
    available: Sequence[str],
) -> list[str]:
    """Names for a request: names, keys of ``fields_to_export``, or None for all that `available` fields of xcg allow.

    Raises
    ------
    ValueError
        For names that are neither.
    """
    if fields is None:
        return [name for name, row in table.items() if set(row.field.fields) <= set(available)]
    if isinstance(fields, (str, Quantity)):
        fields = [fields]
    names: list[str] = []
    for word in map(str, fields):
        of_word = [name for name, row in table.items() if word in (name, row.family)]
        if word in table:
            of_word = [word]
        if not of_word:
            listed = "the documentation lists them on the page on Pysammos"
            raise ValueError(f"preset='pysammos': {unknown('field', word, table, listed)}")
        names += of_word
    return list(dict.fromkeys(names))


def plane_of(scene: Scene, shear_dims: str | None) -> tuple[str, str]:
    """Plane for ``xy`` in the names, and axes for ``xyz``.

    Raises
    ------
    ValueError
        If `shear_dims` are not two axes of the scene.
    """
    axes = scene.setup.plane
    plane = shear_dims or axes[:2]
    if len(set(plane)) != 2 or len(plane) != 2 or set(plane) - set(axes):
        raise ValueError(
            f"shear_dims={shear_dims!r}: the preset 'pysammos' takes a plane, two axes of {axes!r}"
        )
    return plane, axes


def _in_its_names(f: xr.Dataset, renamed: Mapping[str, Field]) -> xr.Dataset:
    """Describe those fields of a result that are named alike here and there as it does."""
    for name, row in renamed.items():
        f[name].attrs |= {"long_name": row.long_name, "formula": row.formula}
    return f


def translate(scene: Scene, request: Request) -> tuple[Request, Callable[[xr.Dataset], xr.Dataset]]:
    """Translate a request into names of xcg; the returned function translates the result back.

    Raises
    ------
    SceneError
        If it is not a scene.
    ValueError
        If a variant is asked for by an argument, or names or plane are wrong.
    """
    clash = request.changed(("pressure_dims", "deviatoric", "size"))
    if request.temperature != "biased":
        clash.append("temperature")
    if request.for_averages:
        raise ValueError(
            "preset='pysammos': averages take fields under names of xcg; leave out preset= or for_averages="
        )
    idle = request.changed(("fluid_viscosity", "friction"))
    if idle:
        raise ValueError(f"preset='pysammos': none of its fields depends on {idle}; leave them out")
    if clash:
        raise ValueError(
            f"preset='pysammos' has a name for each variant: leave out {clash}, and take the field that you want"
        )
    scene.require((), "coarse_grain")
    table = rows(*plane_of(scene, request.shear_dims))
    in_xcg = replace(request, preset=None, for_averages=False, shear_dims=None)
    chosen = {
        name: table[name].field
        for name in choose(request.fields, table, possible_fields(scene, in_xcg))
    }
    same = {name: row for name, row in chosen.items() if row.fields == (name,)}
    fields: list[Any] = []
    for name, row in chosen.items():
        fields.append(name if name in same else registry.NamedField(name, row))
    in_xcg = replace(in_xcg, fields=[*fields, "sample_count"])
    return in_xcg, partial(_in_its_names, renamed=same)


@takes_scene
def pysammos_mesh(
    scene: Scene,
    axes: str = "xyz",
    *,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    at: Mapping[str, float] | None = None,
    width: float | str | None = None,
    kernel: KernelName | str = "lucy",
) -> dict[str, Any]:
    """Arguments for `xcg.coarse_grain` that place nodes as Pysammos does.

    It divides the range from first to last into the fewest equal parts that are no longer than c /
    2, so that both are nodes. Its automatic range leaves ``2.5 c + 0.5 dmax`` off the extent of the
    particles on each side, and axes that are not resolved are cut in the middle of that extent.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with the attributes particle_lower, particle_upper and dmax.
    axes : str
        Resolved axes: three, two, or one; axes that the scene lacks (one layer) are left out.
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
    if scene.corners is None or "dmax" not in scene.sizes:
        raise ValueError(
            "pysammos_mesh needs the extent and the largest diameter; call ds = ds.cg.measure() first"
        )
    setup = scene.setup
    check_axes(COMPONENTS, axes=axes, bounds=bounds or {}, at=at or {})
    chosen = kernel_of(kernel, width, scene.sizes, setup.dimension)
    corners = zip(COMPONENTS, *scene.corners, strict=True)
    extent = {a: (first, last) for a, first, last in corners if a in setup.plane}
    resolved = "".join(a for a in axes if a in extent)
    margin = 2.5 * chosen.cutoff + 0.5 * scene.sizes["dmax"]
    ranges = {a: (extent[a][0] + margin, extent[a][1] - margin) for a in resolved}
    small = [a for a, (first, last) in ranges.items() if first > last and a not in (bounds or {})]
    if small:
        raise ValueError(
            f"the particles extend less than twice the margin of 2.5 c + 0.5 dmax = {margin:g} along {small}: give "
            "bounds= yourself, or a smaller width"
        )
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
