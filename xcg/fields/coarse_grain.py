"""From a scene to its continuum fields: the plan, the steps computed by it, and the labels of the results."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from inspect import unwrap
from typing import Any, TypeVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.messages import warn_once
from xcg.compiled._jit import THREADS, for_each
from xcg.fields.accessible import accessible_of, check_walls, walls_of, with_accessible
from xcg.fields.formulas import registry
from xcg.fields.formulas.field import Field
from xcg.fields.formulas.program import program_for
from xcg.fields.grids.frames import in_frame, is_cylindrical
from xcg.fields.grids.grid import MeshTooLargeError, check_mesh
from xcg.fields.layout import about_strays, check_size
from xcg.fields.plan import Plan, effective_count, make_plan, scale_of
from xcg.fields.presets import lammps, pysammos
from xcg.fields.request import Preset, Request, SharedOptions, takes
from xcg.fields.sums.deposit import sums_of_frame
from xcg.fields.sums.nodes import Block
from xcg.scene.bodies import group_bodies
from xcg.scene.conform import storable
from xcg.scene.description import Description, describe
from xcg.scene.facts import SETUP, setup_of
from xcg.scene.frame import steps_in, with_measures
from xcg.scene.lattice import Lattice
from xcg.scene.schema import COMPONENTS, OF_STEP, ROTATION, Frame, units_in
from xcg.steps.faults import OnError
from xcg.steps.labels import format_call, mark_skipped, provenance, with_phase_labels
from xcg.steps.mapping import map_over_time, threads_a_chunk

# names of other programs: from a request in them to one in names of xcg, and what turns its answer
# into theirs
PRESETS: dict[
    Preset, Callable[[Description, Request], tuple[Request, Callable[[xr.Dataset], xr.Dataset]]]
] = {
    "pysammos": pysammos.translate,
    "lammps": lammps.translate,
}
Asked = TypeVar("Asked", bound=SharedOptions)


@takes(Request)
def coarse_grain(ds: xr.Dataset, request: Request) -> xr.Dataset:
    """Coarse-grain a scene to continuum fields.

    Lazy where the scene is: nothing is read or computed until a result is, one task for each chunk
    of time.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene, from `open_scene` or `scene_from_arrays`.
    {arguments}

    Returns
    -------
    xarray.Dataset
        Fields with dimensions (time, x, y, z, phase, component, direction), as far as they apply.
        Sums are zero where nothing reaches; ratios are NaN there, and ``sample_count`` says how
        many particles each node saw.

    Raises
    ------
    SceneError
        If the scene lacks what the fields need.
    ValueError
        If an argument is wrong; the message says what was expected.

    Notes
    -----
    A field is ``sum_i q_i Psi(r - r_i)`` over particles or, for contact stress, ``sum f_ij a_ij
    int_0^1 Psi(r - r_i + s a_ij) ds`` over both sides of every contact. Sources: Goldhirsch (2010);
    Weinhart et al. (2012).

    Examples
    --------
    >>> import xcg
    >>> ds = xcg.datasets.simple_cubic(4)
    >>> f = coarse_grain(ds, ["volume_fraction"], axes="z")
    >>> f.volume_fraction.dims
    ('time', 'z')
    """
    if request.walls is not None or request.per is not None:
        check_walls(request)
    walls = walls_of(request)
    framed = {"frame": request.frame} if request.frame is not None else {}
    ds, request = prepare(ds, request)
    given = request.given() | framed
    if request.on_error == "raise":
        del given["on_error"]
    call, rename = format_call("coarse_grain", given), None
    scene = describe(ds, request.by)
    if request.preset is not None:
        request, rename = _in_own_names(scene, request)
    by_sizes = request.width is request.spacing is None and isinstance(request.kernel, str)
    try:
        plan = make_plan(scene, request)
    except MeshTooLargeError as error:
        units = "check that sizes and positions have one unit; " if by_sizes else ""
        raise ValueError(f"{error}; {units}{about_strays(ds, scene)}") from None
    check_size(
        ds,
        scene,
        plan.deposit.grid,
        sum(map(math.prod, plan.shapes.values())),
        by_sizes=by_sizes,
    )
    arrays = evaluate_plan(ds, plan, request.on_error)
    result = labelled(scene, plan, arrays, call)
    if request.walls is not None:
        result = with_accessible(result, scene, plan, request, walls)
    result = mark_skipped(result, arrays)
    return rename(result) if rename else result


# coarse_grain of a conformed scene and a Request, for functions built on it
answer: Callable[[xr.Dataset, Request], xr.Dataset] = unwrap(coarse_grain)


@takes(Request)
def explain(ds: xr.Dataset, request: Request) -> Plan:
    """Plan what `coarse_grain` with the same arguments will do, without doing it; printing the plan explains it.

    With ``by_body``, spheres in memory are grouped first, as the plan is that of the bodies; with
    ``preset="lammps"``, the plan is that of the fields which the preset's are made of.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene.
    {arguments}

    Returns
    -------
    Plan
        Its text names fields, variables read, nodes, kernel, sums, passes, the rule for contacts,
        memory, the noise of velocity and temperature that a dense packing would have, and the time
        for the accessible fraction.

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
    if request.walls is not None or request.per is not None:
        check_walls(request)
    walls = walls_of(request)
    ds, request = prepare(ds, request)
    scene = describe(ds, request.by)
    if request.preset is not None:
        request, _ = _in_own_names(scene, request)
    plan = make_plan(scene, request)
    cost = None
    if walls:
        accessible = accessible_of(scene, plan, walls)
        cost = accessible.text(accessible.seconds())
    return replace(plan, effective_count=effective_count(scene, plan), walls=cost)


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
        asked = replace(
            asked, **{name: axes and axes.translate(letters) for name, axes in dims.items()}
        )
    return ds, asked


def _in_own_names(
    scene: Description, request: Request
) -> tuple[Request, Callable[[xr.Dataset], xr.Dataset]]:
    """Return the request in names of xcg, and the function that turns its answer into what was asked for."""
    if request.preset not in PRESETS:
        raise ValueError(f"preset={request.preset!r}: expected {' or '.join(map(repr, PRESETS))}")
    return PRESETS[request.preset](scene, request)


# --- computing a plan ------------------------------------------------------------------------------------


def evaluate_plan(ds: xr.Dataset, plan: Plan, on_error: OnError) -> dict[str, Any]:
    """Arrays of the plan's fields (time, axes, phase, ...), lazy where the scene is."""
    names = [*plan.variables, *(name for name in OF_STEP if name in ds)]
    results = {field: (plan.shapes[field], "float64") for field in plan.fields}
    threads = threads_a_chunk(ds, names, THREADS)
    return map_over_time(
        ds, names, partial(compute_chunk, plan, threads), results, "coarse-grain", on_error
    )


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


# Threads share a step of more visits of nodes by grains and contacts than this; for fewer they cost
# more than they gain. What is done once for each grain or contact, or for each node, takes as long
# as `_ONCE` visits.
WORTH_SHARING = 1_500_000
_ONCE = 30


def compute_chunk(plan: Plan, threads: int, arrays: Mapping[str, NDArray]) -> dict[str, NDArray]:
    """Fields of one chunk of time, from padded arrays."""
    rows = sum(arrays[name].shape[1] for name in ("particle_id", "contact_i") if name in arrays)
    if rows * (plan.reached + _ONCE) + plan.deposit.grid.count * _ONCE <= WORTH_SHARING:
        threads = 1
    out = {name: np.empty((len(arrays["particle_id"]), *plan.shapes[name])) for name in plan.fields}
    for_each([a.reshape(-1) for a in out.values() if a.size > _PAGE], _take_memory, threads)
    for t, (frame, lattice, source) in enumerate(steps_in(arrays, plan.setup.periodic)):
        results = {
            name: a[t, ...].reshape(-1, plan.phases, *a.shape[1 + len(plan.dims) :])
            for name, a in out.items()
        }
        _compute_step(plan, frame, lattice, source, threads, results)
    return out


def _compute_step(
    plan: Plan,
    frame: Frame,
    lattice: Lattice,
    source: str,
    threads: int,
    rows: Mapping[str, NDArray],
) -> None:
    """Compute the fields of one step into arrays (nodes, phase, ...)."""
    grid = plan.deposit.grid
    check_mesh(frame["position"], grid, max(plan.deposit.cutoffs), lattice.open_axes, source)
    scale = scale_of(plan, lattice, source)
    sums = sums_of_frame(frame, plan.deposit, lattice, scale, source, threads)
    program = program_for(plan.fields, plan.options, len(plan.deposit.groups))
    traced = program.widths if program else ()
    untraced = tuple(name for name in plan.fields if name not in traced)

    reached: list[int] = []

    def fill(part: Block) -> None:
        found, place = sums.over(part), part.places
        reached.append(int(np.count_nonzero(~np.isnan(found.velocity[:, 0]))))
        if program:
            program.run(found, place, rows, part.order)
        if untraced:  # with NumPy
            # the box may change
            options = replace(plan.options, wrapped=grid.fills(lattice.axis_periods))
            for name, values in registry.evaluate(untraced, found.moments, options).items():
                rows[name][place] = values.swapaxes(0, 1)

    whole = plan.options.gradient == "finite_difference"
    for_each(
        grid.blocks(grid.count, 1) if whole else grid.blocks(plan.block_nodes, threads),
        fill,
        threads,
    )
    if grid.undirected.size:
        for name, values in rows.items():
            if registry.row(name, plan.options).rank:
                values[grid.undirected] = np.nan
    if plan.options.temperature == "unbiased" and not rows.keys().isdisjoint(_TEMPERATURES):
        _warn_of_unknown(rows, sum(reached), plan.kernel.width, source)
    # extent=1 m asks for an integral in place of an average: no warning
    if (
        "volume_fraction" in rows
        and 1.0 not in plan.extent.values()
        and rows["volume_fraction"].max(initial=0.0) > 1.0
    ):
        _warn_of_fraction(
            plan, rows["volume_fraction"], frame["volume"].max(initial=0.0) * scale, source
        )


def _warn_of_fraction(plan: Plan, fraction: NDArray, largest: float, source: str) -> None:
    """Warn of a volume fraction (nodes, phases) above 1, where the volume of the `largest` grain may be the cause."""
    node = int(fraction.max(axis=1).argmax())
    grid, kernel = plan.deposit.grid, plan.kernel
    index = dict(zip(grid.dims, np.unravel_index(node, grid.sizes), strict=True))
    coords = {
        name: coord.isel({dim: index[str(dim)] for dim in coord.dims})
        for name, coord in grid.coords.items()
    }
    place = (
        ", ".join(f"{name} = {float(coord):.4g}" for name, coord in coords.items())
        or "the only node"
    )
    alone = largest * float(kernel.value(np.zeros(1), int(grid.active.sum()))[0])
    cause = "grains overlap, or their sizes, or the length of an average (extent=, thickness=), are not right"
    if alone > 0.5:
        cause = (
            f"the kernel is narrower than the largest grains, one of which alone adds up to {alone:.3g}: increase "
            f"width= (it is {kernel.width:.3g}), or give each group its own with by= and width={{group: width}}"
        )
    warn_once(
        "volume fraction",
        f"{source}: the volume fraction is {fraction.max():.3g} at {place}: {cause}",
    )


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
    system, options, grid = plan.setup.unit_system, plan.options, plan.deposit.grid
    length = units_in("m", system)
    # those of the scene may be changed in place
    coords: dict[str, Any] = {name: given.copy() for name, given in scene.times.items()}
    facts = provenance(scene, call) | _choices(plan)
    coords[SETUP] = setup_of(facts)
    wrapped = {a: scene.lasting_periods[k] for k, a in enumerate(COMPONENTS) if options.wrapped[k]}
    for name, coord in grid.coords.items():
        attrs: dict[str, Any] = {
            "units": length,
            "long_name": f"position along {name}",
            "axis": name.upper(),
        }
        if scene.cylindrical:
            attrs = _CYLINDRICAL[name] | ({} if name == "theta" else {"units": length})
        attrs |= {"period": wrapped[name]} if name in wrapped else {}  # also of a part of the nodes
        coords[name] = (coord.dims, coord, attrs | coord.attrs if name in _AXES else coord.attrs)
    if plan.deposit.by:
        attrs = {"long_name": f"phase by {plan.deposit.by}"}
        coords["phase"] = ("phase", ["bulk", *map(str, plan.deposit.groups)], attrs)
    data = {}
    for name in plan.fields:
        row = registry.row(name, options)
        tail = ("component", "direction")[: row.rank]
        coords |= {
            dim: (dim, list(_CYLINDRICAL) if scene.cylindrical else list(COMPONENTS))
            for dim in tail
        }
        if row.paired:
            tail = ("other_phase", *tail)
            coords["other_phase"] = ("other_phase", [*map(str, plan.deposit.groups), "wall"])
        attrs = about(row, system)
        taken = {
            variable
            for moment in registry.moments_of([name], options).values()
            for variable in moment.optional
        }
        if lacking := [variable for variable in ROTATION if variable in taken - {*plan.variables}]:
            attrs["comment"] = f"without rotation, as the scene holds no {' and no '.join(lacking)}"
        data[name] = xr.Variable(("time", *plan.dims, *tail), arrays[name], attrs)
    result = storable(xr.Dataset(data, coords, facts))
    return with_phase_labels(result) if plan.deposit.by else result


def _choices(plan: Plan) -> dict[str, Any]:
    """Return the options of a plan as attributes of its result."""
    options, grid = plan.options, plan.deposit.grid
    choices: dict[str, Any] = {
        **grid.attrs,
        "kernel": plan.kernel.name,
        "width": plan.widths if len(plan.widths) > 1 else plan.kernel.width,
        "cutoff": list(plan.deposit.cutoffs) if len(plan.widths) > 1 else plan.kernel.cutoff,
        "kernel_dimension": plan.kernel.dimension,
        "rtol": plan.rtol,
        "gradient": options.gradient,
        "pressure_dims": "".join(COMPONENTS[k] for k in options.pressure_axes or options.plane),
        "deviatoric": options.deviatoric,
        "size": options.size,
        "temperature": options.temperature,
        "sampling": "cell" if grid.half.any() else "node",
        "averaged_axes": grid.averaged,
        "wrapped_axes": "".join(
            a for a, wraps in zip(COMPONENTS, options.wrapped, strict=True) if wraps
        ),
    }
    lengths = {axis: length for axis, length in plan.extent.items() if length is not None}
    given: dict[str, Any] = {
        "shear_dims": None
        if options.shear_axes is None
        else "".join(COMPONENTS[k] for k in options.shear_axes),
        "fluid_viscosity": options.fluid_viscosity,
        "friction": options.friction,
        "size_diameter": options.diameter,
        "lag": options.lag,
        "extent": json.dumps(lengths) if lengths else None,
    }
    return choices | {name: value for name, value in given.items() if value is not None}


def about(row: Field, system: str) -> dict[str, str]:
    """Attributes of a field in a result."""
    # a scene's own variables may have any unit
    units = row.units if row.source else units_in(row.units, system)
    found = {
        "units": units,
        "long_name": row.long_name,
        "formula": row.formula,
        "source": row.source,
    }
    # what averages of fields without a row need
    found |= {"weight": row.weight} if row.source else {}
    return {key: text for key, text in found.items() if text}
