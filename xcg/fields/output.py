"""Results of plans: dimensions, coordinates, units, and what they were computed with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import xarray as xr

from xcg.fields.formulas import registry
from xcg.fields.formulas.field import Field
from xcg.fields.plan import Plan
from xcg.scene.build import storable
from xcg.scene.description import Description
from xcg.scene.schema import COMPONENTS, units_in
from xcg.steps.labels import provenance, with_phase_labels

_CYLINDRICAL: dict[str, dict[str, str]] = {
    "r": {"long_name": "distance from the axis"},
    "theta": {"units": "rad", "long_name": "angle about the axis"},
    "z": {"long_name": "position along the axis", "axis": "Z"},
}
_AXES = {*COMPONENTS, *_CYLINDRICAL}


def labelled(scene: Description, plan: Plan, arrays: Mapping[str, Any], call: str) -> xr.Dataset:
    """Return arrays of the plan's fields as a result of the scene, with dimensions, coordinates, units and history."""
    system = plan.setup.unit_system
    length = units_in("m", system)
    # those of the scene may be changed in place
    coords: dict[str, Any] = {name: given.copy() for name, given in scene.times.items()}
    for name, coord in plan.deposit.grid.coords.items():
        attrs = {"units": length, "long_name": f"position along {name}", "axis": name.upper()}
        if scene.cylindrical:
            attrs = _CYLINDRICAL[name] | ({} if name == "theta" else {"units": length})
        coords[name] = (coord.dims, coord, attrs | coord.attrs if name in _AXES else coord.attrs)
    if plan.deposit.by:
        attrs = {"long_name": f"phase by {plan.deposit.by}"}
        coords["phase"] = ("phase", ["bulk", *map(str, plan.deposit.groups)], attrs)
    data = {}
    for name in plan.fields:
        row = registry.row(name, plan.options)
        tail = ("component", "direction")[: row.rank]
        coords |= {dim: (dim, list(_CYLINDRICAL) if scene.cylindrical else list(COMPONENTS)) for dim in tail}
        if row.paired:
            tail = ("other_phase", *tail)
            coords["other_phase"] = ("other_phase", [*map(str, plan.deposit.groups), "wall"])
        attrs = about(row, system)
        if lacking := plan.left_out(name):
            attrs["comment"] = f"without rotation, as the scene holds no {' and no '.join(lacking)}"
        data[name] = xr.Variable(("time", *plan.dims, *tail), arrays[name], attrs)
    result = with_phase_labels(storable(xr.Dataset(data, coords)))
    return result.assign_attrs(provenance(scene, call) | _choices(plan))


def about(row: Field, system: str) -> dict[str, str]:
    """Attributes of a field in a result."""
    units = row.units if row.source else units_in(row.units, system)  # a scene's own variables may have any unit
    found = {"units": units, "long_name": row.long_name, "formula": row.formula, "source": row.source}
    found |= {"weight": row.weight} if row.source else {}  # what averages of fields without a row need
    return {key: text for key, text in found.items() if text}


def _choices(plan: Plan) -> dict[str, Any]:
    return {
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
