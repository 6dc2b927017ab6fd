"""Evaluation of a plan: the fields of each step, their labels, and warnings about what came out."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.messages import SceneError, warn_once
from xcg.compiled._jit import for_each
from xcg.fields.formulas import registry
from xcg.fields.formulas.averages import second_moment, takes_stress_of_step
from xcg.fields.formulas.field import Field
from xcg.fields.formulas.program import program_for
from xcg.fields.grids.grid import check_mesh
from xcg.fields.plan import Plan
from xcg.fields.sums.deposit import sums_of_frame
from xcg.fields.sums.nodes import Block
from xcg.scene.contacts import Contacts
from xcg.scene.description import Description
from xcg.scene.facts import SETUP, setup_of
from xcg.scene.frame import without_frozen
from xcg.scene.lattice import Lattice
from xcg.scene.schema import COMPONENTS, ROTATION, Frame, Variable, units_in
from xcg.steps.analysis import FrameAnalysis
from xcg.steps.labels import ABOUT, annotated, phases_of

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


@dataclass(frozen=True, eq=False)
class CoarseGraining(FrameAnalysis):
    """Fields of a plan, as an analysis of each step."""

    name = "coarse_grain"

    plan: Plan

    def reads(self, scene: Description) -> tuple[str, ...]:
        """Return the variables of the plan."""
        return self.plan.variables

    def rows(self, scene: Description) -> dict[str, Variable]:
        """Return dimensions and units of the fields."""
        rows = {}
        for name in self.plan.fields:
            field = registry.row(name, self.plan.options)
            dims = [*self.plan.dims]
            if field.paired:
                dims.append("other_phase")
            dims += ("component", "direction")[: field.rank]
            rows[name] = Variable(tuple(dims), field.units, field.long_name)
        return rows

    def coords(self, scene: Description) -> dict[str, xr.Variable]:
        """Return the nodes, phases and axes, and the options that averages depend on."""
        return _coordinates(scene, self.plan)

    def attrs(self, scene: Description) -> dict[str, Any]:
        """Return the options of the plan."""
        return _choices(self.plan)

    def frame(self, frame: Frame, lattice: Lattice, source: str) -> dict[str, NDArray]:
        """Compute the fields of one step (axes, phase, ...)."""
        plan = self.plan
        threads = self.threads
        rows = len(frame["particle_id"]) + len(frame.get("contact_i", ()))
        if rows * (plan.reached + _ONCE) + plan.deposit.grid.count * _ONCE <= WORTH_SHARING:
            threads = 1
        fields = {name: np.empty(plan.shapes[name]) for name in plan.fields}
        for_each([a.reshape(-1) for a in fields.values() if a.size > _PAGE], _take_memory, threads)
        nodes = {
            name: a.reshape(-1, plan.phases, *a.shape[len(plan.dims) :])
            for name, a in fields.items()
        }
        _compute_step(plan, frame, lattice, source, threads, nodes)
        return fields

    def after(self, result: xr.Dataset, ds: xr.Dataset) -> xr.Dataset:
        """Name the formula and source of each field, and what the scene lacks for it."""
        system = self.plan.setup.unit_system
        for name in self.plan.fields:
            field = registry.row(name, self.plan.options)
            attrs = about(field, system)
            moments = registry.moments_of([name], self.plan.options).values()
            optional = {variable for moment in moments for variable in moment.optional}
            lacking = [n for n in ROTATION if n in optional and n not in self.plan.variables]
            if lacking:
                attrs["comment"] = (
                    f"without rotation, as the scene holds no {' and no '.join(lacking)}"
                )
            result.variables[name].attrs = attrs
        return result.set_coords([n for n in self.plan.fields if n not in self.plan.asked])


def scale_of(plan: Plan, lattice: Lattice, source: str) -> float:
    """1 / (extents of the averaged axes x thickness of the layer) for one step."""
    extent = dict(plan.extent)
    if isinstance(plan.depth, str):
        extent[plan.depth] = None
    lengths = [length for length in extent.values() if length is not None]
    of_box = [extent.get(a, 0.0) is None for a in COMPONENTS]
    if any(of_box):
        lengths.append(lattice.extent(np.array(of_box)))
        if not (np.isfinite(lengths[-1]) and lengths[-1] > 0):
            lattice.seen(plan.deposit.grid.active, source)  # which may say more
            axes = " and ".join(
                repr(a) for a, averaged in zip(COMPONENTS, of_box, strict=True) if averaged
            )
            raise SceneError(
                f"{source}: fields are averaged along {axes}, and the box of this step is not finite there; give the "
                "length that the integral is divided by (extent=)"
            )
    if isinstance(plan.depth, float):
        lengths.append(plan.depth)
    return 1.0 / math.prod(lengths)


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
    untraced = plan.fields
    if program:
        untraced = tuple(name for name in plan.fields if name not in program.widths)

    reached: list[int] = []

    def fill(part: Block) -> None:
        at_nodes = sums.over(part)
        place = part.places
        reached.append(int(np.count_nonzero(~np.isnan(at_nodes.velocity[:, 0]))))
        if program:
            program.run(at_nodes, place, rows, part.order)
        if untraced:  # with NumPy
            # the box may change
            options = replace(plan.options, wrapped=grid.fills(lattice.axis_periods))
            for name, values in registry.evaluate(untraced, at_nodes.moments, options).items():
                rows[name][place] = values.swapaxes(0, 1)

    if plan.options.gradient == "finite_difference":  # of all nodes at once
        blocks = grid.blocks(grid.count, 1)
    else:
        blocks = grid.blocks(plan.block_nodes, threads)
    for_each(blocks, fill, threads)
    for name, values in rows.items():
        rank = registry.row(name, plan.options).rank
        if rank and grid.undirected.size:  # what is along the axis alone has a direction there
            along: Any = (grid.undirected, ..., *(2,) * rank)
            known = values[along]
            values[grid.undirected] = np.nan
            values[along] = known
    if not plan.is_narrow:  # else the plan has warned of the cause of what follows
        _warn_of_step(plan, frame, lattice, source, rows, sum(reached), scale)


def _warn_of_step(
    plan: Plan,
    frame: Frame,
    lattice: Lattice,
    source: str,
    rows: Mapping[str, NDArray],
    reached: int,
    scale: float,
) -> None:
    """Warn of fields of a step that are unknown, impossible, or far from those of averages."""
    if plan.lost_share:
        _warn_of_kinetic_stress(plan, frame, lattice, source)
        plan.lost_share = 0.0
    if plan.named and plan.options.temperature == "mixture":
        _warn_of_phases(rows, plan.deposit.groups, source)
    if plan.options.temperature != "biased":
        _warn_of_unknown(rows, reached, plan.kernel.width, source)
    # extent=1 m asks for an integral in place of an average: no warning
    if "volume_fraction" in rows and 1.0 not in plan.extent.values():
        largest = frame["volume"].max(initial=0.0) * scale
        _warn_of_fraction(plan, rows["volume_fraction"], largest, source)


_NARROW = "narrow kernel"  # a cause that both warnings have, and that one of them tells


def _warn_of_fraction(plan: Plan, fraction: NDArray, largest: float, source: str) -> None:
    """Warn of a volume fraction (nodes, phases) above 1, where the volume of the `largest` grain may be the cause."""
    if not fraction.max(initial=0.0) > 1.0:
        return
    node = int(fraction.max(axis=1).argmax())
    grid = plan.deposit.grid
    kernel = plan.kernel
    index = dict(zip(grid.dims, np.unravel_index(node, grid.sizes), strict=True))
    at_node = []
    for name, coord in grid.coords.items():
        value = float(coord.isel({dim: index[str(dim)] for dim in coord.dims}))
        at_node.append(f"{name} = {value:.4g}")
    place = ", ".join(at_node) or "the only node"
    alone = largest * float(kernel.value(np.zeros(1), int(grid.active.sum()))[0])
    about = "volume fraction"
    cause = "grains overlap, or their sizes, or the length of an average (extent=, thickness=), are not right"
    if alone > 0.5:
        about = _NARROW
        cause = (
            f"the kernel is narrower than the largest grains, one of which alone adds up to {alone:.3g}: increase "
            f"width= (it is {kernel.width:.3g}), or give each group its own with by= and width={{group: width}}"
        )
    warn_once(
        about,
        f"{source}: the volume fraction is {fraction.max():.3g} at {place}: {cause}",
    )


def _warn_of_unknown(rows: Mapping[str, NDArray], reached: int, width: float, source: str) -> None:
    """Warn where most of the nodes that grains reach have no temperature."""
    for name in (name for name in _TEMPERATURES if name in rows):
        known = np.count_nonzero(np.isfinite(rows[name].reshape(len(rows[name]), -1)[:, 0]))
        if 2 * known < reached:
            warn_once(
                _NARROW,
                f"{source}: {name} is NaN at {reached - known} of {reached} nodes: too few particles per node. "
                f"Increase width= (it is {width:.3g}), average along an axis (axes=), or mask by sample_count",
            )


_CONSIDERABLE = 0.05  # share of the pressure
_SAMPLED = 4_000  # grains and contacts of a step from which its pressures are estimated
_UNKNOWN = 0.16  # of normal values, these are negative where the error is as large as the mean


@dataclass(frozen=True)
class _Pressures:
    """Parts of the pressure of the sampled grains, times volume and dimension (J).

    Attributes
    ----------
    kinetic, contact : float
        Of fluctuations, and of contacts.
    smeared : float
        Of the variation of the flow within the support of the kernel.
    averaged : dict
        Of the variation of the flow along each averaged axis.
    """

    kinetic: float
    contact: float
    smeared: float
    averaged: Mapping[str, float]


def _warn_of_kinetic_stress(plan: Plan, frame: Frame, lattice: Lattice, source: str) -> None:
    """Warn where the kinetic stress lacks a considerable part of the pressure, or adds one that is no fluctuation.

    It lacks what the velocity at a node takes, as that follows the few grains there; it adds the
    variation of the flow within what a node sees. Without contacts the pressure is not known, and
    shares are those of the kinetic stress itself, where it was asked for by name.
    """
    if "contact_i" not in frame and not plan.named:
        return
    free = without_frozen(frame)
    if not len(free["mass"]):
        return
    parts = _pressures_of(plan, free, lattice, source)
    options = plan.options
    taking = [
        name for name in plan.asked if takes_stress_of_step(registry.row(name, options), options)
    ]
    usual = [name for name in ("kinetic_stress", "stress", "pressure") if name in taking]
    names = ", ".join(usual or taking[:1])
    of = "the pressure"
    if "contact_i" not in frame:
        of = "its value"
    width = f"width= (it is {plan.kernel.width:.3g})"
    true = parts.kinetic + max(parts.contact, 0.0)
    lost = plan.lost_share * parts.kinetic
    if lost > _CONSIDERABLE * true:
        warn_once(
            "kinetic stress",
            f"{source}: {names} of a single step lacks kinetic stress of about {100 * lost / true:.0f} % of "
            f"{of}, as the velocity at a node follows the {1 / plan.lost_share:.2g} grains there: take the "
            "time_average of the result, which is about the averaged velocity, average along axes (axes=), or increase "
            f"{width}",
        )
    added = parts.smeared + sum(parts.averaged.values())
    hidden = "".join(a for a, part in parts.averaged.items() if part > 0.3 * added)
    where = "within the support of the kernel"
    way_out = (
        f"decrease {width}; the kinetic part without it is density times the granular temperature"
    )
    if hidden:
        where = f"along {' and '.join(hidden)}, which fields are averaged over"
        way_out = f"resolve {' and '.join(hidden)} too (axes=), and average after"
    if added > _CONSIDERABLE * (added + true):
        warn_once(
            "variation of the flow",
            f"{source}: {names}: about {100 * added / (added + true):.0f} % of {of} is no fluctuation but the "
            f"variation of the flow {where}: {way_out}",
        )


def _pressures_of(plan: Plan, frame: Frame, lattice: Lattice, source: str) -> _Pressures:
    """Return the parts of the pressure of a step, from a sample of its grains and contacts.

    Fluctuations are those between grains in contact where there are many; else of all grains about
    the flow, as in a gas.
    """
    velocity = frame["velocity"]
    count = len(velocity)
    every = max(1, count // _SAMPLED)
    sample = {name: frame[name][::every] for name in ("position", "velocity", "mass")}
    mass = sample["mass"]
    flow, smeared, averaged = _variation_of_flow(plan, sample, lattice)
    kinetic = float((mass[:, None] * (sample["velocity"] - flow) ** 2).sum())
    contact = 0.0
    if "contact_i" in frame:
        rows = max(1, len(frame["contact_i"]) // _SAMPLED)
        of_contacts = {
            name: values[::rows]
            for name, values in frame.items()
            if name.startswith(("contact", "overlap"))
        }
        contacts = Contacts.of(frame | of_contacts, lattice, source)
        sides = (contacts.branch_i - contacts.branch_j) * contacts.force
        contact = float(sides[:, list(plan.options.plane)].sum()) * rows / every
        pairs = (contacts.i >= 0) & (contacts.j >= 0)
        if 2 * rows * np.count_nonzero(pairs) > count:
            relative = velocity[contacts.i[pairs]] - velocity[contacts.j[pairs]]
            kinetic = float((relative**2).sum(axis=1).mean() * mass.sum()) / 2
    return _Pressures(kinetic, contact, smeared, averaged)


def _variation_of_flow(
    plan: Plan, frame: Frame, lattice: Lattice
) -> tuple[NDArray, float, dict[str, float]]:
    """Return the flow at the grains, and ``sum m |V - <V>|^2`` within supports and along averaged axes.

    The flow is a sum of cubic polynomials along each axis. Of each part of V the noise of the fit
    is subtracted, from the squares and the squared derivatives of Legendre polynomials.
    """
    grid = plan.deposit.grid
    velocity = frame["velocity"]
    position = frame["position"]
    mass = frame["mass"]
    count = max(len(mass), 1)
    of_box = np.zeros_like(velocity)
    gradient = lattice.gradient_along(~grid.active)
    if gradient is not None:
        of_box = (position - lattice.middle) @ gradient.T
    root = np.sqrt(mass)[:, None]
    places = position - position.mean(axis=0)
    spread = places.std(axis=0)
    places = places / np.where(spread > 0, spread, 1.0)
    powers = [np.ones((len(mass), 1))]
    powers += [places[:, [k]] ** np.arange(1, 4) for k in plan.options.plane]
    columns = root * np.concatenate(powers, axis=1)
    # normal equations: an orthogonal fit takes longer than the stress, and the columns are of one size
    right = columns.T @ (root * (velocity - of_box))
    terms = np.linalg.lstsq(columns.T @ columns, right, rcond=None)[0]
    flow = np.concatenate(powers, axis=1) @ terms
    noise = float((mass[:, None] * (velocity - of_box - flow) ** 2).sum()) / count
    smeared = 0.0
    averaged = {}
    variance = second_moment(plan.kernel, len(grid.seen))
    for n, k in enumerate(plan.options.plane):
        first, second, third = terms[1 + 3 * n : 4 + 3 * n]
        u = places[:, [k]]
        if COMPONENTS[k] in grid.seen:
            slope = first + 2 * second * u + 3 * third * u**2
            share = variance / spread[k] ** 2 if spread[k] > 0 else 0.0
            smeared += share * _beyond(float((mass[:, None] * slope**2).sum()), 20 * noise)
        else:
            along = first * u + second * u**2 + third * u**3
            along -= along.mean(axis=0)
            averaged[COMPONENTS[k]] = _beyond(float((mass[:, None] * along**2).sum()), 3 * noise)
    return flow + of_box, smeared, averaged


def _beyond(total: float, noise: float) -> float:
    """Return a sum of squares less its noise; 0 unless it is well beyond the scatter of that noise."""
    if total < 4 * noise:
        return 0.0
    return total - noise


def _warn_of_phases(rows: Mapping[str, NDArray], groups: Sequence[int], source: str) -> None:
    """Warn of phases whose temperature one step does not tell."""
    if not {"density", "granular_temperature"} <= rows.keys():
        return
    reached = rows["density"] > 0
    lost = reached & ~np.isfinite(rows["granular_temperature"])
    shares = lost.sum(axis=0) / np.maximum(reached.sum(axis=0), 1)
    unknown = [
        f"{group} (at {100 * share:.0f} % of its nodes)"
        for group, share in zip(groups, shares[1:], strict=True)
        if share > _UNKNOWN
    ]
    if unknown:
        warn_once(
            "temperatures of phases",
            f"{source}: the error of one step is larger than the granular_temperature of phase {', '.join(unknown)}, "
            "which is NaN where negative: take the time_average or profile of the result, which solves for the "
            "temperatures after averaging, average along axes (axes=), or increase width=",
        )


_CYLINDRICAL: dict[str, dict[str, str]] = {
    "r": {"long_name": "distance from the axis"},
    "theta": {"units": "rad", "long_name": "angle about the axis"},
    "z": {"long_name": "position along the axis", "axis": "Z"},
}


def _coordinates(scene: Description, plan: Plan) -> dict[str, xr.Variable]:
    """Return the coordinates of a result beside time."""
    options = plan.options
    grid = plan.deposit.grid
    length = units_in("m", plan.setup.unit_system)
    facts = {name: scene.attrs[name] for name in ABOUT if name in scene.attrs}
    choices = _choices(plan)
    coords: dict[str, xr.Variable] = {}
    # titles of plots name coordinates in this order, and xarray cuts them after 50 characters
    if np.ndim(choices["width"]) == 0:
        coords["width"] = annotated((), choices["width"], length, "width of the kernel")
    wrapped = {a: scene.lasting_periods[k] for k, a in enumerate(COMPONENTS) if options.wrapped[k]}
    for name, coord in grid.coords.items():
        attrs: dict[str, Any] = {}
        if scene.cylindrical and name in _CYLINDRICAL:
            attrs = {"units": length} | _CYLINDRICAL[name]
        elif name in COMPONENTS:
            attrs = {"units": length, "long_name": f"position along {name}", "axis": name.upper()}
        if name in wrapped:
            attrs["period"] = wrapped[name]  # also of a part of the nodes
        coords[name] = xr.Variable(coord.dims, coord, attrs | coord.attrs)
    if plan.deposit.by:
        coords["phase"] = phases_of(plan.deposit.by, plan.deposit.groups)
    fields = [registry.row(name, options) for name in plan.fields]
    axes = list(COMPONENTS)
    if scene.cylindrical:
        axes = list(_CYLINDRICAL)
    for dim in ("component", "direction")[: max(field.rank for field in fields)]:
        coords[dim] = xr.Variable(dim, axes)
    if any(field.paired for field in fields):
        others = [*map(str, plan.deposit.groups), "wall"]
        coords["other_phase"] = xr.Variable("other_phase", others)
    coords[SETUP] = setup_of(facts | choices)
    return coords


def _choices(plan: Plan) -> dict[str, Any]:
    """Return the options of a plan as attributes of its result."""
    options = plan.options
    grid = plan.deposit.grid
    width: Any = plan.kernel.width
    cutoff: Any = plan.kernel.cutoff
    if len(plan.widths) > 1:
        width = plan.widths
        cutoff = list(plan.deposit.cutoffs)
    shear_dims = "".join(COMPONENTS[k] for k in options.shear_axes or ())
    lengths = {axis: length for axis, length in plan.extent.items() if length is not None}
    choices = {
        **grid.attrs,
        "kernel": plan.kernel.name,
        "width": width,
        "cutoff": cutoff,
        "kernel_dimension": plan.kernel.dimension,
        "rtol": plan.rtol,
        "gradient": options.gradient,
        "pressure_dims": "".join(COMPONENTS[k] for k in options.pressure_axes or options.plane),
        "deviatoric": options.deviatoric,
        "size": options.size,
        "temperature": options.temperature,
        "averaged_axes": grid.averaged,
        "wrapped_axes": "".join(
            a for a, wraps in zip(COMPONENTS, options.wrapped, strict=True) if wraps
        ),
        "shear_dims": shear_dims or None,
        "fluid_viscosity": options.fluid_viscosity,
        "friction": options.friction,
        "size_diameter": options.diameter,
        "lag": options.lag,
    }
    if lengths:
        choices["extent"] = json.dumps(lengths)
    return {name: value for name, value in choices.items() if value is not None}


def about(row: Field, system: str) -> dict[str, str]:
    """Attributes of a field in a result."""
    attrs = {
        "units": row.units,
        "long_name": row.long_name,
        "formula": row.formula,
        "source": row.source,
        "averages": row.text_of_averages,
    }
    if row.source:  # a variable of the scene: it has any unit, and averages need its weight
        attrs["weight"] = row.weight
    else:
        attrs["units"] = units_in(row.units, system)
    return {key: text for key, text in attrs.items() if text}
