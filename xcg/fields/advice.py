"""Warnings about fields of single steps that are noise or in another unit: at the call, and of a computed step."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.compat import is_in_memory
from xcg.common.messages import active_call, warn_once, warn_user
from xcg.fields.formulas import registry
from xcg.fields.formulas.averages import second_moment, squared_integral, takes_stress_of_step
from xcg.fields.formulas.doubts import UNKNOWN
from xcg.fields.formulas.field import Support
from xcg.fields.plan import Plan
from xcg.fields.pressures import Pressures, pressures_of
from xcg.fields.sums.kernels import Kernel
from xcg.scene.frame import without_frozen
from xcg.scene.lattice import Lattice
from xcg.scene.scene import Scene
from xcg.scene.schema import COMPONENTS, PADDING, Frame

# --- at the call, from scene and plan; nothing is read -----------------------------------------------


def advise(scene: Scene, plan: Plan, *, named: bool | None) -> None:
    """Warn of empty scenes, and of fields that are far from the truth; tell the plan what its steps warn of.

    `named` is whether fields were asked for by name; None is for functions that measure the noise
    of single steps, which are not told of it.
    """
    if nothing := _what_is_left_out(scene.ds):
        warn_once("nothing left", f"coarse_grain: {nothing}; fields are those of no grain")
    if named is None:
        return
    plan.named = named
    if _depends_on_support(plan):
        plan.support = support_of(scene, plan)
    if plan.is_narrow:
        return  # the plan has warned of the cause
    for about, advice in _ADVICE.items():
        text = advice(scene, plan)
        if text:
            warn_once(about, text)


def _what_is_left_out(ds: xr.Dataset) -> str:
    """Return that a selection left no step or no particle, with the range of positions before, else ""."""
    if not {"particle", "time"} <= set(ds.sizes) or "particle_id" not in ds:
        return ""
    if ds.sizes["particle"] and not ds.sizes["time"]:
        return "no step is left, as of a selection of times that holds for none"
    ids = ds.variables["particle_id"]
    padded = is_in_memory(ids) and not (ids.to_numpy() != PADDING).any()
    # a scene that never had particles has no range
    if not {"particle_lower", "particle_upper"} <= set(ds.attrs) or not (padded or not ids.size):
        return ""
    edges = zip(COMPONENTS, ds.attrs["particle_lower"], ds.attrs["particle_upper"], strict=True)
    ranges = ", ".join(f"{axis} {low:.4g} to {high:.4g}" for axis, low, high in edges)
    return (
        "no particle is left, as of a selection whose condition holds for none: before, positions were "
        f"{ranges}"
    )


def _depends_on_support(plan: Plan) -> bool:
    """Return whether a requested field of single steps depends on how many grains a node sees."""
    options = plan.options
    rows = [registry.row(name, options) for name in plan.asked]
    if any(row.floor is not None for row in rows) or {*_OF_ONE_VARIANCE} & {*plan.asked}:
        return True
    return any(takes_stress_of_step(row, options) for row in rows)


def _without_friction(scene: Scene, plan: Plan) -> str:
    """Return a warning if a redundancy counts sliding contacts as sticking; "" if it does not."""
    if "redundancy_number" not in plan.asked or plan.options.sliding:
        return ""
    return (
        "redundancy_number without friction= counts sliding contacts as sticking: where all slide it is "
        f"{scene.setup.dimension} times too large. Pass friction=, the coefficient between the grains (0 without, "
        "a large one where none slides)"
    )


# Ratio of the largest to the smallest mass above which the bulk's temperature is off by 5 % or more
# in equilibrium (sizes 0.85 to 1.15, volume fraction 0.2, default width: 9 %).
_ALIKE = 2.0
_BIAS = 0.05


def _mixed_masses(scene: Scene, plan: Plan) -> str:
    """Return a warning if a temperature was asked for of grains of different masses together; "" if not.

    Where the temperature is one of all fields, nobody asked for it: packings of many sizes, most of
    them at rest, would all warn.
    """
    fields = [name for name in _OF_ONE_VARIANCE if name in plan.asked]
    smallest = scene.sizes.get("dmin", 0.0)
    if not plan.named or not fields or plan.options.temperature != "unbiased" or not smallest > 0:
        return ""
    masses = (scene.sizes["dmax"] / smallest) ** 3
    if masses <= _ALIKE:
        return ""
    # at most the share that the fit of velocity and gradient takes, if only the slow grains lose it
    support = plan.support
    if support is not None and (1 + len(plan.nodes.seen)) / support.grains < _BIAS:
        return ""
    return (
        f"{', '.join(fields)} of grains whose masses differ by {masses:.2g} assumes that all have the same variance of "
        "velocities: where light grains are faster, as in equilibrium, it is too large. Pass by= of species or of "
        "ds.cg.find_phases(...): each phase then has its temperature, and the bulk their mean by mass"
    )


_LONG = 50.0  # extents of the scene by which extent= is in another unit, most likely


def _long_extent(scene: Scene, plan: Plan) -> str:
    """Return a warning if the length of an average is many times that of the scene; "" if it is not."""
    if scene.cylindrical:
        return ""
    for axis, length in plan.extent.items():
        known = _length(scene, axis, scene.sizes.get("d43", np.nan))
        if not length or not length > _LONG * known:
            continue
        return (
            f"extent={{{axis!r}: {length:.4g}}} is {length / known:.3g} times the length of the scene along {axis!r} "
            f"({known:.4g} m), so that sums over it are as many times too small: lengths are in m. Leave it out where "
            f"the box has edges along {axis!r}, or give extent={{{axis!r}: {known:.4g}}}"
        )
    return ""


_OF_ONE_VARIANCE = ("granular_temperature", "directional_temperature", "mixture_temperature")

# what a warning is about, and a function of scene and plan
_ADVICE = {
    "redundancy without friction": _without_friction,
    "mixed masses": _mixed_masses,
    "long extent": _long_extent,
}


def text_of_floors(scene: Scene, plan: Plan) -> str | None:
    """Return the floors of the requested fields in words, None where no field has one."""
    support = support_of(scene, plan)
    if support is None:
        return None
    floors = floors_of(plan, support)
    if not floors:
        return None
    values = ", ".join(
        f"{name} {_number(plan, name, floor)}" for name, (floor, _) in floors.items()
    )
    return f"{values} in one step where the true value is 0, from {support.text()} at a node"


def describe_floors(plan: Plan) -> dict[str, str]:
    """Return the floor of each requested field that has one, in words, for its attributes."""
    if plan.support is None:
        return {}
    return {
        name: f"about {_number(plan, name, floor)} where the true value is 0"
        for name, (floor, _) in floors_of(plan, plan.support).items()
    }


def _number(plan: Plan, name: str, floor: float) -> str:
    """Return a floor with its unit."""
    return f"{floor:.2g} {registry.row(name, plan.options).floor_units}".rstrip()


def floors_of(plan: Plan, support: Support) -> dict[str, tuple[float, float]]:
    """Return floor and usual value of each requested field that has a floor."""
    floors = {}
    for name in plan.asked:
        row = registry.row(name, plan.options)
        if row.floor is not None:
            floors[name] = row.floor(support), row.usual
    return floors


def support_of(scene: Scene, plan: Plan) -> Support | None:
    """Return the effective numbers of a node, of grains that fill their extent evenly.

    None for widths by group, whose weights are not those of one kernel, and where sizes, extent or
    the box are not known. Of the rings of a cylinder it is that of the middle one.
    """
    grid = plan.nodes
    count = scene.ds.sizes.get("particle", 0)
    other_weights = len(plan.cutoffs) > 1
    size = scene.sizes.get("d43", np.nan)
    filled = _extent(scene, size)
    lengths = [
        length or np.ptp(scene.edges.get(a, (0.0, np.inf))) for a, length in plan.extent.items()
    ]
    if other_weights or not count or not np.isfinite([filled, *lengths]).all():
        return None
    d = scene.setup.dimension
    seen = len(grid.seen)
    if scene.cylindrical and "theta" not in grid.coords:
        seen -= 1
        lengths.append(2 * math.pi * float(np.median(grid.coords["r"])))
    # in a unit of the space that the kernel sees
    number = count / filled * math.prod(lengths)
    partners = 2 * scene.ds.sizes.get("contact", 0) / count
    grains = max(1.0, number / squared_integral(plan.kernel, seen))
    share = {2: math.pi / 4, 3: math.pi / 6}[d] * size**d * count / filled
    return Support(
        grains=grains,
        contacts=max(1.0, grains * partners / 2),
        partners=partners,
        dimension=d,
        slope=_slope(plan.kernel, seen, d, number) * size,
        volume_fraction=share,
    )


def _extent(scene: Scene, size: float) -> float:
    """Return the volume (in a layer the area) of the box around the grains; NaN where it is not known."""
    box = math.prod(_length(scene, a, size) for a in scene.setup.plane)
    if scene.cylindrical and not {"x", "y"} & scene.periods.keys():
        return box * math.pi / 4  # a disc in its square
    return box


def _length(scene: Scene, axis: str, size: float) -> float:
    """Return the period along an axis, or the extent of the grains; NaN where it is not known."""
    if axis in scene.periods:
        return scene.periods[axis]
    if scene.corners is None:
        return np.nan
    k = "xyz".index(axis)
    return scene.corners[1][k] - scene.corners[0][k] + size


def _slope(kernel: Kernel, seen: int, dimension: int, number: float) -> float:
    """Root mean square of |dev Gamma| of independent velocities with the variance 1 along each axis (m^-1).

    Each of the components of the gradient along the axes that are seen has the variance
    ``S = int Psi^2 x^2 / n (int Psi x^2)^2``, of n grains in a unit of what the kernel sees.
    """
    if not seen:
        return 0.0
    r, step = np.linspace(0.0, kernel.cutoff, 2001, retstep=True)
    shells = {1: 2.0 * r**2, 2: np.pi * r**3, 3: 4 / 3 * np.pi * r**4}[seen]
    psi = kernel.value(r, seen)
    squares = np.trapezoid(psi**2 * shells, dx=step)
    components = seen * (dimension + 1 - 2 / dimension)
    return math.sqrt(float(squares) * components / number) / second_moment(kernel, seen)


# --- of a computed step ------------------------------------------------------------------------------

_CONSIDERABLE_FLOOR = 0.2  # share of the usual value of a field
_CONSIDERABLE = 0.05  # share of the pressure

_TURN = threading.Lock()  # so that the first step of several threads warns of all effects
# means of squared fluctuations
_TEMPERATURES = (
    "granular_temperature",
    "directional_temperature",
    "d2min",
    "nonaffine_covariance",
    "self_diffusion",
)


@dataclass(frozen=True, eq=False)
class ComputedStep:
    """Fields of one step, and what they were computed from.

    Attributes
    ----------
    plan : Plan
        Plan of the call.
    frame, lattice, source
        The step: variables, box, and its name.
    fields : mapping
        Arrays (nodes, phases, ...) by name.
    reached : int
        Number of nodes that grains reach.
    scale : float
        1 / (extents of the averaged axes x thickness of the layer).
    """

    plan: Plan
    frame: Frame
    lattice: Lattice
    source: str
    fields: Mapping[str, NDArray]
    reached: int
    scale: float

    def warn(self) -> None:
        """Warn of fields that are unknown, impossible, or far from those of averages; once for each cause."""
        if not self.plan.is_narrow:  # else the plan has warned of the cause
            with _TURN:
                self._warn()

    def _warn(self) -> None:
        plan = self.plan
        call = active_call()
        effects = self._unknown_temperatures()
        # extent=1 m asks for an integral in place of an average: no warning
        if "volume_fraction" in self.fields and 1.0 not in plan.extent.values():
            effects |= self._fraction()
        if plan.support is not None and call.is_new("pressures"):
            effects |= self._lost_stress()
        if plan.support is not None and (plan.named or effects):
            effects |= self._floors()
        texts = [text for about, text in effects.items() if call.is_new(f"few grains: {about}")]
        if not texts:
            return
        seen = "too few grains"
        if plan.support is not None:
            seen = f"only about {plan.support.text()}"
        warn_user(
            f"{self.source}: a node sees {seen}, so that in a single step {'; '.join(texts)}: take the time_average of "
            f"the result, average along axes (axes=), or increase width= (it is {plan.kernel.width:.3g})"
        )

    def _floors(self) -> dict[str, str]:
        """Return which norms and eigenvalues are noise, unless all are small."""
        assert self.plan.support is not None
        texts = [
            f"{name} is about {_number(self.plan, name, floor)}"
            for name, (floor, usual) in floors_of(self.plan, self.plan.support).items()
            if floor > _CONSIDERABLE_FLOOR * usual
        ]
        if not texts:
            return {}
        return {"floors": f"{', '.join(texts)} where the true value is 0"}

    def _unknown_temperatures(self) -> dict[str, str]:
        """Return which temperatures are NaN at most nodes, or at many nodes of a phase."""
        plan = self.plan
        effects: dict[str, str] = {}
        if plan.options.temperature == "biased":
            return effects
        for name in (name for name in _TEMPERATURES if name in self.fields):
            values = self.fields[name]
            known = np.count_nonzero(np.isfinite(values.reshape(len(values), -1)[:, 0]))
            if 2 * known < self.reached:
                effects[name] = f"{name} is NaN at {self.reached - known} of {self.reached} nodes"
        if not plan.named or plan.options.temperature != "mixture" or "density" not in self.fields:
            return effects
        reached = self.fields["density"] > 0
        count = np.maximum(reached.sum(axis=0), 1)
        for name in ("granular_temperature", "mixture_temperature"):
            if name not in self.fields:
                continue
            lost = reached & ~np.isfinite(self.fields[name])
            shares = lost.sum(axis=0) / count
            phases = [
                f"{100 * share:.0f} % of the nodes of phase {group}"
                for group, share in zip(plan.groups, shares[1:], strict=True)
                if share > UNKNOWN
            ]
            if phases:
                effects[f"{name} of phases"] = (
                    f"{name} is NaN, as its error is larger, at {' and '.join(phases)}"
                )
        return effects

    def _fraction(self) -> dict[str, str]:
        """Return where the volume fraction is above 1 as one grain fills a node; warn if that is not the cause."""
        fraction = self.fields["volume_fraction"]
        if not fraction.max(initial=0.0) > 1.0:
            return {}
        node = int(fraction.max(axis=1).argmax())
        grid = self.plan.nodes
        index = dict(zip(grid.dims, np.unravel_index(node, grid.sizes), strict=True))
        at_node = []
        for name, coord in grid.coords.items():
            value = float(coord.isel({dim: index[str(dim)] for dim in coord.dims}))
            at_node.append(f"{name} = {value:.4g}")
        place = ", ".join(at_node) or "the only node"
        largest = self.frame["volume"].max(initial=0.0) * self.scale
        kernel = self.plan.kernel
        alone = largest * float(kernel.value(np.zeros(1), int(grid.active.sum()))[0])
        text = f"the volume fraction is {fraction.max():.3g} at {place}"
        if alone > 0.5:
            cause = (
                f"as the kernel is narrower than the largest grains, one of which alone adds up to {alone:.3g} (by= "
                "and width={group: width} give each group its own)"
            )
            return {"volume fraction": f"{text}, {cause}"}
        diameter = (6 / np.pi * self.frame["volume"].max(initial=0.0)) ** (1 / 3)
        if kernel.dimension == 3 and kernel.cutoff < diameter:
            cause = (
                f"as the kernel, which ends at {kernel.cutoff:.3g}, is narrower than the grains of {diameter:.3g}: it "
                "sees layers of centres (cell_volumes has exact volumes)"
            )
            return {"volume fraction": f"{text}, {cause}"}
        warn_once(
            "volume fraction",
            f"{self.source}: {text}: grains overlap, or their sizes, or the length of an average (extent=, "
            "thickness=), are not right",
        )
        return {}

    def _lost_stress(self) -> dict[str, str]:
        """Return how much of the pressure the kinetic stress lacks; warn if it adds what is no fluctuation.

        It lacks what the velocity at a node takes, as that follows the few grains there; it adds the
        variation of the flow within what a node sees. Without contacts the pressure is not known, and
        shares are those of the kinetic stress itself, where it was asked for by name.
        """
        plan = self.plan
        assert plan.support is not None
        has_contacts = "contact_i" in self.frame
        options = plan.options
        taking = [
            name
            for name in plan.asked
            if takes_stress_of_step(registry.row(name, options), options)
        ]
        free = without_frozen(self.frame)
        if not taking or not len(free["mass"]) or not (has_contacts or plan.named):
            return {}
        parts = pressures_of(plan, free, self.lattice)
        usual = [name for name in ("kinetic_stress", "stress", "pressure") if name in taking]
        names = ", ".join(usual or taking[:1])
        whole = "the pressure" if has_contacts else "it"
        kinetic = float(parts.kinetic.sum())
        true = kinetic + max(float(parts.contact.sum()), 0.0)
        self._warn_of_variation(parts, true, names, whole)
        lost = kinetic / plan.support.grains
        if not lost > _CONSIDERABLE * true:
            return {}
        verb = "lack" if ", " in names else "lacks"
        share = f"about {100 * lost / true:.0f} % of {whole}"
        return {
            "lost stress": f"{names} {verb} {share}, as the velocity at a node follows these grains"
        }

    def _warn_of_variation(self, parts: Pressures, true: float, names: str, whole: str) -> None:
        """Warn where a considerable part of the pressure is no fluctuation but the variation of the flow.

        Of tensors it is also the part of a normal stress, or of the mean one, whichever is larger:
        a stress that is small beside the others is of no weight in their ratios.
        """
        by_component = parts.smeared + sum(parts.averaged.values())
        added = float(by_component.sum())
        if not added:
            return
        share = added / (added + true)
        if {"kinetic_stress", "stress"} & {*self.plan.asked}:
            normal = by_component + parts.kinetic + np.maximum(parts.contact, 0.0)
            mean = (added + true) / self.plan.options.dimension
            shares = by_component / np.maximum(normal, mean)
            largest = int(shares.argmax())
            if shares[largest] > share:
                share = float(shares[largest])
                whole = f"the component {2 * COMPONENTS[largest]}"
        if not share > _CONSIDERABLE:
            return
        hidden = "".join(a for a, part in parts.averaged.items() if part.sum() > 0.3 * added)
        where = "within the support of the kernel"
        way_out = (
            f"decrease width= (it is {self.plan.kernel.width:.3g}); the kinetic part without it is density times the "
            "granular temperature"
        )
        if hidden:
            where = f"along {' and '.join(hidden)}, which fields are averaged over"
            way_out = f"resolve {' and '.join(hidden)} too (axes=), and average after"
        warn_once(
            "variation of the flow",
            f"{self.source}: {names}: about {100 * share:.0f} % of {whole} is no fluctuation but the "
            f"variation of the flow {where}: {way_out}",
        )
