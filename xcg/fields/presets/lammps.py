"""LAMMPS' own coarse-graining, ``compute continuum/chunk``: ``coarse_grain(preset="lammps")``.

Its names, with "_" in place of "/" (``stress/contacts/*`` is ``stress_contacts``), its signs
(tension is positive), and its kernel, the shifted Gaussian of as many dimensions as there are axes.
Each is algebra on fields of xcg. What it defines in a way of its own, and is not followed, is
listed in the documentation. Formulas: documentation of the compute (LAMMPS pull request 5092),
which follows Goldhirsch (2010).
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from typing import Any

import numpy as np
import xarray as xr

from xcg.common.checks import POSITIVE, check
from xcg.common.messages import unknown
from xcg.fields.choice import possible_fields
from xcg.fields.formulas import registry
from xcg.fields.formulas.field import Quantity
from xcg.fields.grids.grid import check_axes
from xcg.fields.request import Request
from xcg.fields.sums.kernels import Gaussian, Kernel, kernel_of
from xcg.scene.conform import takes_scene
from xcg.scene.scene import Scene
from xcg.scene.schema import COMPONENTS, units_in


@dataclass(frozen=True)
class LammpsRow:
    """Field of the preset.

    Attributes
    ----------
    ours : str
        The field of xcg that it is made of, and shares its units with.
    formula : str
        In names of xcg.
    compute : callable
        From ours, and the axes of the scene, to its values.
    """

    ours: str
    formula: str
    compute: Callable[[xr.DataArray, str], xr.DataArray]


def _same(ours: str) -> LammpsRow:
    return LammpsRow(ours, ours, lambda field, _: field)


def _negative(ours: str) -> LammpsRow:
    return LammpsRow(ours, f"-{ours}", lambda field, _: -field)


def _half_trace(field: xr.DataArray, axes: str) -> xr.DataArray:
    normal = [field.isel(component=k, direction=k, drop=True) for k in map(COMPONENTS.index, axes)]
    return 0.5 * reduce(operator.add, normal)


ROWS: dict[str, LammpsRow] = {
    "density": _same("density"),
    "volume/fraction": _same("volume_fraction"),
    "momentum": _same("momentum_density"),
    "velocity": _same("velocity"),
    "velocity/grad": _same("velocity_gradient"),
    "strain/rate": _same("shear_rate_tensor"),
    "stress": _negative("stress"),
    "stress/ke": _negative("kinetic_stress"),
    "stress/contacts": _negative("contact_stress"),
    "boundary/force": _negative("boundary_force_density"),
    "temperature": LammpsRow("kinetic_stress", "tr(kinetic_stress) / 2", _half_trace),
}
_NOT_FOLLOWED = {
    "fabric": "it is smeared along branches there, and as the grains are here: take 'fabric' without the preset",
    "momentum/grad": "there is no such field: take differences of 'momentum'",
    "natoms": "it counts centres in bins, which are no field",
}
_GRADIENTS = ("velocity/grad", "strain/rate")
# arguments that change none of its fields
_WITHOUT_EFFECT = (
    "pressure_dims",
    "shear_dims",
    "deviatoric",
    "size",
    "temperature",
    "fluid_viscosity",
    "friction",
    "by_pair",
    "errors",
    "for_averages",
)


def _choose(
    fields: str | Quantity | Sequence[str | Quantity] | None, available: Sequence[str]
) -> list[str]:
    """Its names for a request, with or without ``/*`` and with "_" or "/"; all that `available` fields allow for None.

    Raises
    ------
    ValueError
        For unknown names, single components, and fields that the preset does not provide.
    """
    if fields is None:
        return [name for name, row in ROWS.items() if row.ours in available]
    by_word = {name.replace("/", "_"): name for name in (*ROWS, *_NOT_FOLLOWED)}
    if isinstance(fields, (str, Quantity)):
        fields = [fields]
    names = []
    for word in map(str, fields):
        name = by_word.get(word.removesuffix("/*").replace("/", "_"))
        if name in ROWS:
            names.append(name)
            continue
        whole, _, parts = word.replace("/", "_").rpartition("_")
        if name is not None:
            msg = f"{word!r} is not followed by the preset 'lammps': {_NOT_FOLLOWED[name]}"
        elif by_word.get(whole) in ROWS and 0 < len(parts) <= 2 and set(parts) <= set(COMPONENTS):
            labels = zip(("component", "direction"), parts, strict=False)
            part = ", ".join(f"{dim}={a!r}" for dim, a in labels)
            msg = f"{word!r} is a component: ask for {by_word[whole]!r} as a whole, and take .sel({part}) of it"
        else:
            msg = f"preset='lammps': {unknown('field', word, ROWS)}"
        raise ValueError(msg)
    return list(dict.fromkeys(names))


def _from_xcg(f: xr.Dataset, names: Sequence[str], axes: str) -> xr.Dataset:
    """Compute its fields from a result of `xcg.coarse_grain` that holds what they need."""
    out = {}
    for name in names:
        row = ROWS[name]
        units = units_in(registry.FIELDS[row.ours].units, f.attrs["unit_system"])
        attrs = {
            "units": units,
            "long_name": f"{name} of compute continuum/chunk",
            "formula": row.formula,
        }
        out[name.replace("/", "_")] = row.compute(f[row.ours], axes).assign_attrs(attrs)
    return xr.Dataset(out | {"sample_count": f["sample_count"]}, attrs=f.attrs)


def _kernel(scene: Scene, request: Request) -> Kernel:
    """Return the kernel in as many dimensions as there are axes, in a cylinder all."""
    setup = scene.setup
    seen = len({*request.axes_of(setup.plane), *(request.at or {})})
    if scene.cylindrical or not seen:
        seen = setup.dimension
    if isinstance(request.width, Mapping):
        raise ValueError(
            "preset='lammps' has one kernel for all grains: give one width= instead of one for each group"
        )
    return kernel_of(request.kernel, request.width, scene.sizes, seen)


def translate(scene: Scene, request: Request) -> tuple[Request, Callable[[xr.Dataset], xr.Dataset]]:
    """Translate a request into names of xcg; the returned function translates the result back.

    Raises
    ------
    SceneError
        If it is not a scene.
    ValueError
        If names are not its, or an argument is given that changes none of its fields.
    """
    idle = request.changed(_WITHOUT_EFFECT)
    if idle:
        raise ValueError(f"preset='lammps': none of its fields depends on {idle}; leave them out")
    scene.require((), "coarse_grain")
    in_xcg = replace(
        request, preset=None, for_averages=False, kernel=_kernel(scene, request), width=None
    )
    names = _choose(request.fields, possible_fields(scene, in_xcg))
    points = any(map(np.ndim, (request.at or {}).values()))
    if request.gradient == "finite_difference" and (scene.cylindrical or points):
        # rings and points have no differences
        names = [name for name in names if request.fields is not None or name not in _GRADIENTS]
        if not set(names) & set(_GRADIENTS):
            in_xcg = replace(in_xcg, gradient="least_squares")
    needed = list(dict.fromkeys(["sample_count", *(ROWS[name].ours for name in names)]))
    return replace(in_xcg, fields=needed), partial(_from_xcg, names=names, axes=scene.setup.plane)


@takes_scene
def lammps_mesh(
    scene: Scene,
    axes: str = "xyz",
    *,
    delta: float | Mapping[str, float],
    cutoff: float,
    width: float,
    origin: Mapping[str, float] | None = None,
) -> dict[str, Any]:
    """Arguments for `xcg.coarse_grain` that place nodes at the centres of LAMMPS' bins, and take its kernel.

    They are the nodes of ``compute ID all chunk/atom bin/3d x lower delta y lower delta z lower
    delta units box`` and ``compute ID all continuum/chunk chunkID cutoff width ...``: of bins of
    equal size from the origin on, and as many as cover the box.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with a box.
    axes : str
        Axes with bins.
    delta : float or mapping
        Size of the bins (m), for all axes or by axis.
    cutoff, width : float
        Of the kernel (m), as the compute takes them.
    origin : mapping, optional
        Where the first bin begins (m), by axis; by default the lower edge of the box.

    Returns
    -------
    dict
        ``axes``, ``bounds``, ``spacing`` and ``kernel``.

    Raises
    ------
    ValueError
        If a size is not positive, or an axis is not one of the scene's or has no finite box.

    Examples
    --------
    >>> import xcg
    >>> ds = xcg.datasets.simple_cubic(10)
    >>> mesh = xcg.lammps_mesh(ds, "z", delta=2.0, cutoff=1.5, width=0.5)
    >>> f = ds.cg.coarse_grain(["density", "stress/contacts/*"], preset="lammps", **mesh)
    >>> dict(f.sizes)["z"]
    5
    """
    scene.require((), "lammps_mesh")
    sizes: Mapping[str, Any] = dict.fromkeys(axes, delta)
    if isinstance(delta, Mapping):
        sizes = delta
    check_axes(scene.setup.plane, axes=axes, delta=sizes, origin=origin or {})
    edges = scene.edges
    bounds = {}
    spacing = {}
    for a in axes:
        if a not in edges:
            raise ValueError(
                f"lammps_mesh: the scene has no finite box along {a!r}; bins of LAMMPS cover the box"
            )
        check(f"delta[{a!r}]", sizes.get(a), POSITIVE, "m")
        size = sizes[a]
        first, last = edges[a]
        first = (origin or {}).get(a, first)
        # a box of a whole number of bins has that many, whatever the rounding
        count = max(1, math.ceil((last - first) / size * (1 - 1e-12)))
        bounds[a] = (first + 0.5 * size, first + (count - 0.5) * size)
        spacing[a] = size
    kernel = Gaussian(width, cutoff=cutoff, shifted=True)
    return {"axes": axes, "bounds": bounds, "spacing": spacing, "kernel": kernel}
