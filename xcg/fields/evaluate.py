"""Evaluation of a plan: sums and algebra of each step, mapped over time, with labels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.messages import warn_once
from xcg.compiled import THREADS
from xcg.compiled._jit import for_each
from xcg.fields.formulas import registry
from xcg.fields.formulas.field import Field
from xcg.fields.formulas.program import Loads, program_for
from xcg.fields.grids.grid import check_mesh
from xcg.fields.plan import Plan, scale_of
from xcg.fields.sums.deposit import sums_of_frame
from xcg.fields.sums.nodes import Block
from xcg.scene.conform import storable
from xcg.scene.description import Description
from xcg.scene.frame import steps_in
from xcg.scene.lattice import Lattice
from xcg.scene.schema import COMPONENTS, OF_STEP, Frame, units_in
from xcg.steps.faults import OnError
from xcg.steps.labels import provenance, with_phase_labels
from xcg.steps.mapping import map_over_time, threads_a_chunk


def evaluate_plan(ds: xr.Dataset, plan: Plan, on_error: OnError) -> dict[str, Any]:
    """Arrays of the plan's fields (time, axes, phase, ...), lazy where the scene is."""
    names = [*plan.variables, *(name for name in OF_STEP if name in ds)]
    results = {field: (plan.shapes[field], "float64") for field in plan.fields}
    threads = threads_a_chunk(ds, names, THREADS)
    return map_over_time(ds, names, partial(compute_chunk, plan, threads), results, "coarse-grain", on_error)


# means of squared fluctuations
_TEMPERATURES = (
    "granular_temperature",
    "directional_temperature",
    "d2min",
    "nonaffine_covariance",
    "self_diffusion",
)
_PAGE = 4096 // 8  # numbers in a page of memory


def _take_memory(numbers: NDArray) -> None:
    """Write to every page, so that the system gives the memory now, which is quick just after other memory was freed.

    See docs/measurements.md.
    """
    numbers[::_PAGE] = 0.0


# Threads share a step of more visits of nodes by grains and contacts than this; for fewer they cost more than they
# gain. What is done once for each grain or contact, or for each node, takes as long as `_ONCE` visits.
WORTH_SHARING = 5_000_000
_ONCE = 30


def compute_chunk(plan: Plan, threads: int, arrays: Mapping[str, NDArray]) -> dict[str, NDArray]:
    """Fields of one chunk of time, from padded arrays."""
    rows = sum(arrays[name].shape[1] for name in ("particle_id", "contact_i") if name in arrays)
    if rows * (plan.reached + _ONCE) + plan.deposit.grid.count * _ONCE <= WORTH_SHARING:
        threads = 1
    out = {name: np.empty((len(arrays["particle_id"]), *plan.shapes[name])) for name in plan.fields}
    for_each([a.reshape(-1) for a in out.values() if a.size > _PAGE], _take_memory, threads)
    for t, (frame, lattice, source) in enumerate(steps_in(arrays, plan.setup.periodic)):
        results = {name: a[t, ...].reshape(plan.rows[name]) for name, a in out.items()}
        _compute_step(plan, frame, lattice, source, threads, results)
    return out


def _compute_step(
    plan: Plan, frame: Frame, lattice: Lattice, source: str, threads: int, rows: Mapping[str, NDArray]
) -> None:
    """Compute the fields of one step into arrays (nodes, phase, ...)."""
    grid = plan.deposit.grid
    check_mesh(frame["position"], grid, max(plan.deposit.cutoffs), lattice.open_axes, source)
    scale = scale_of(plan, lattice, source)
    sums = sums_of_frame(frame, plan.deposit, lattice, scale, source, threads)
    program = program_for(plan.fields, plan.options, len(plan.deposit.groups))
    loads = Loads.of(program, [run.layout for run in sums.passes]) if program else None
    traced = program.widths if program else ()
    untraced = tuple(name for name in plan.fields if name not in traced)

    reached: list[int] = []

    def fill(part: Block) -> None:
        found, place = sums.over(part), part.places
        reached.append(int(np.count_nonzero(~np.isnan(found.velocity[:, 0]))))
        if program and loads:
            program.run(loads, found, place, rows, part.order)
        if untraced:  # with NumPy
            options = replace(plan.options, wrapped=grid.fills(lattice.axis_periods))  # the box may change
            for name, values in registry.evaluate(untraced, found.moments, options).items():
                rows[name][place] = values.swapaxes(0, 1)

    whole = plan.options.gradient == "finite_difference"
    for_each(grid.blocks(grid.count, 1) if whole else grid.blocks(plan.block_nodes, threads), fill, threads)
    if grid.undirected.size:
        for name, values in rows.items():
            if registry.row(name, plan.options).rank:
                values[grid.undirected] = np.nan
    if plan.options.temperature == "unbiased" and not rows.keys().isdisjoint(_TEMPERATURES):
        _warn_of_unknown(rows, sum(reached), plan.kernel.width, source)
    # a given extent of 1 m makes integrals of averages
    if "volume_fraction" in rows and 1.0 not in plan.extent.values() and rows["volume_fraction"].max(initial=0.0) > 1.0:
        _warn_of_fraction(plan, rows["volume_fraction"], frame["volume"].max(initial=0.0) * scale, source)


def _warn_of_fraction(plan: Plan, fraction: NDArray, largest: float, source: str) -> None:
    """Warn of a volume fraction (nodes, phases) above 1, where the volume of the `largest` grain may be the cause."""
    node = int(fraction.max(axis=1).argmax())
    grid, kernel = plan.deposit.grid, plan.kernel
    index = dict(zip(grid.dims, np.unravel_index(node, grid.sizes), strict=True))
    coords = {name: coord.isel({dim: index[str(dim)] for dim in coord.dims}) for name, coord in grid.coords.items()}
    place = ", ".join(f"{name} = {float(coord):.4g}" for name, coord in coords.items()) or "the only node"
    alone = largest * float(kernel.value(np.zeros(1), int(grid.active.sum()))[0])
    cause = "grains overlap, or their sizes, or the length of an average (extent=, thickness=), are not right"
    if alone > 0.5:
        cause = (
            f"the kernel is narrower than the largest grains, one of which alone adds up to {alone:.3g}: increase "
            f"width= (it is {kernel.width:.3g}), or give each group its own with by= and width={{group: width}}"
        )
    warn_once("volume fraction", f"{source}: the volume fraction is {fraction.max():.3g} at {place}: {cause}")


def _warn_of_unknown(rows: Mapping[str, NDArray], reached: int, width: float, source: str) -> None:
    """Warn where most of the nodes that grains reach have no temperature."""
    for name in (name for name in _TEMPERATURES if name in rows):
        known = np.count_nonzero(np.isfinite(rows[name].reshape(len(rows[name]), -1)[:, 0]))
        if 2 * known < reached:
            warn_once(
                "temperature",
                f"{source}: {name} is NaN at {reached - known} of {reached} nodes: too few particles per node. "
                f"Increase width= (it is {width:.3g}), average along an axis (axes=), or mask by sample_count",
            )


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
    result = storable(xr.Dataset(data, coords))
    if plan.deposit.by:
        result = with_phase_labels(result)
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
        "pressure_dims": "".join(COMPONENTS[k] for k in plan.options.pressure_axes or plan.options.plane),
        "deviatoric": plan.options.deviatoric,
        "size": plan.options.size,
        "temperature": plan.options.temperature,
        **registry.given_options(plan.options),
        "sampling": "cell" if plan.deposit.grid.half.any() else "node",
        "averaged_axes": plan.deposit.grid.averaged,
        "wrapped_axes": "".join(a for a, wraps in zip(COMPONENTS, plan.options.wrapped, strict=True) if wraps),
    }
