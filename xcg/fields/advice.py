"""Warnings about what a call makes of a scene: from scene and plan, without reading, and from its computed steps.

Each piece of advice is a function of what it is about, called only where a plan or a step has that,
and warns once a call. None changes a result.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.compat import is_in_memory
from xcg.common.messages import active_call, warn_once, warn_user
from xcg.compiled.points import FLUCTUATION
from xcg.fields.formulas.doubts import UNKNOWN
from xcg.fields.formulas.field import Support
from xcg.fields.formulas.floors import CONSIDERABLE_FLOOR, UNIT_OF_RATES
from xcg.fields.formulas.rules import takes_stress_of_step
from xcg.fields.formulas.variables import OwnField
from xcg.fields.grids.grid import warn_beyond
from xcg.fields.layout import LARGE, about_strays, about_width, takes_gradient
from xcg.fields.plan import Plan
from xcg.fields.pressures import Pressures, pressures_of, spread_of_contacts
from xcg.fields.sums.kernels import Kernel
from xcg.fields.sums.nodes import Nodes
from xcg.fields.support import floors_of, length_along, support_of
from xcg.scene.frame import without_frozen
from xcg.scene.lattice import Lattice
from xcg.scene.sanity_sample import Particles, sample_of
from xcg.scene.scene import Scene
from xcg.scene.schema import COMPONENTS, PADDING, Frame
from xcg.scene.times import times_are_known

_MANY = 1000  # nodes a particle, of a mesh that was laid around the particles
_LONG = 50.0  # extents of the scene by which extent= is in another unit, most likely
# Ratio of the largest to the smallest mass above which the bulk's temperature is off by 5 % or more
# in equilibrium (sizes 0.85 to 1.15, volume fraction 0.2, default width: 9 %).
_ALIKE_MASSES = 2.0
_BIAS = 0.05
_OF_ONE_VARIANCE = ("granular_temperature", "directional_temperature", "mixture_temperature")
_CONSIDERABLE = 0.05  # share of the pressure
_CONTRADICTED = 0.3  # share of a floor below which what nodes show is no noise of random contacts
_OF_LATTICE = 1e12  # contacts as good as independent ones, as they repeat without scatter
_FLOORS = "floors"  # what the warning about them is about
_ALIKE_RATES = 0.3  # difference of a slope of the velocities from the rate of the box
_SLACK = 1.2  # of a volume fraction above 1 that one grain is the cause of
_SURE = 5.0  # standard errors of such a slope
# Share of a temperature along a period: waves of a homogeneous flow are fluctuations, and vary by half of it.
_ALONG_PERIOD = 0.6

_OF_READ_CONTACTS = ("branch_anisotropy", "tangential_force_anisotropy")
_OF_FLUCTUATION = {"inertial_number", "stress_strain_rate_angle"}
_TURN = threading.Lock()  # so that the first step of several threads warns of all effects
# means of squared fluctuations
_TEMPERATURES = (
    "granular_temperature",
    "directional_temperature",
    "d2min",
    "nonaffine_covariance",
    "self_diffusion",
)


def advise(scene: Scene, plan: Plan) -> None:
    """Warn of empty scenes, and of nodes and kernels that are hardly meant."""
    options = plan.options
    if options.averaged_gradient == "unknown":
        _warn_of_unknown_gradients(plan)
    text = about_width(scene, min(plan.widths), plan.undercut)
    if text:
        warn_once("width", text)
    has_cut = len(plan.nodes.active_axes) > len(plan.nodes.spacing)
    if has_cut and scene.periods and not scene.cylindrical:
        _warn_of_cuts(scene, plan)
    if options.gradient == "kernel" and {"mass_slope", "momentum_slope"} & plan.moments.keys():
        _warn_of_jumping_kernels(plan.kernel)
    if plan.nodes.fitted and plan.nodes.count >= LARGE:
        _warn_of_strays(scene, plan.nodes)
    ids = scene.columns["particle_id"]
    if not ids.size or (is_in_memory(ids) and not (ids.to_numpy() != PADDING).any()):
        _warn_of_nothing_left(scene.ds)


def advise_on_steps(scene: Scene, plan: Plan, *, named: bool) -> None:
    """Warn of fields that are far from the truth in single steps, and let the plan's steps warn of theirs.

    `named` is whether the user named the fields. Functions that measure the noise of single steps
    leave this advice out.
    """
    plan.named = named
    if "velocity" in plan.variables and scene.setup.periodic and scene.ds.sizes["time"] > 1:
        plan.stretch = _stretch_of(scene)
    has_floor = any(plan.definitions[name].floor is not None for name in plan.requested)
    has_squares = any(moment.level == FLUCTUATION for moment in plan.moments.values())
    if has_floor or has_squares or "segregation_flux" in plan.requested:
        plan.support = support_of(scene, plan)
    if plan.undercut is not None:  # `advise` has warned of the cause
        return
    if "redundancy_number" in plan.requested and not plan.options.sliding:
        _warn_of_unknown_sliding(scene.setup.dimension)
    variances = [name for name in _OF_ONE_VARIANCE if name in plan.requested]
    if variances and plan.named and plan.options.temperature == "unbiased":
        _warn_of_mixed_masses(scene, plan, variances)
    if any(plan.extent.values()) and not scene.cylindrical:
        _warn_of_long_extent(scene, plan.extent)


def _stretch_of(scene: Scene) -> NDArray | None:
    """Return the least and largest rates (3, 2) of a periodic box whose length changes; None where none do.

    None as well where the rates were given, as images move with such a box.
    """
    ds = scene.ds
    box = scene.columns.get("box")
    moves = "lattice_velocity" in scene.columns
    if box is None or moves or "time" not in box.dims:
        return None
    if not is_in_memory(box) or not times_are_known(ds):
        return None
    lengths = np.diff(box.to_numpy(), axis=-1)[..., 0]
    periodic = [axis in scene.setup.periodic for axis in COMPONENTS]
    lengths = np.where(periodic, lengths, 1.0)
    if (lengths == lengths[0]).all():
        return None
    rates = np.diff(np.log(lengths), axis=0) / np.diff(ds["time"].to_numpy())[:, None]
    return np.stack([rates.min(axis=0), rates.max(axis=0)], axis=1)


# --- of all plans ----------------------------------------------------------------------------------


def _warn_of_unknown_gradients(plan: Plan) -> None:
    """Warn of fields of a velocity gradient that no axis shows."""
    lost = [name for name in plan.requested if takes_gradient(name, plan.options)]
    if lost:
        text = (
            f"{', '.join(lost)}: NaN, as no axis is resolved or fixed, and so the velocity has no neighbours to differ "
            "from: resolve the axis that it varies along, axes='z' for example, and average the result"
        )
        warn_once("unknown gradients", text)


def _warn_of_cuts(scene: Scene, plan: Plan) -> None:
    """Warn of fixed coordinates that lie outside a periodic box."""
    nodes = plan.nodes
    for k, a in enumerate(COMPONENTS):
        is_fixed = a in nodes.active_axes and a not in nodes.spacing
        if not is_fixed or a not in scene.periods:
            continue
        low, high = scene.edges[a]
        # grains and cuts of scenes that were shifted, or are not wrapped, are beyond an edge by up
        # to a period
        room = high - low + plan.kernel.cutoff
        ends = (nodes.lower[k], nodes.upper[k])
        beyond = [x for x in ends if not low - room <= x <= high + room]
        if beyond:
            text = (
                f"at={{{a!r}: {beyond[0]:g}}} is outside the box, which is periodic from {low:g} to {high:g} along "
                f"{a!r}: fields are those of the image inside; check the units of lengths"
            )
            warn_once(f"cut along {a}", text)


def _warn_of_jumping_kernels(kernel: Kernel) -> None:
    """Warn of gradients of a kernel that jumps, or whose slope does."""
    if kernel.smoothness == 0:
        text = (
            f"the {kernel.name} kernel is continuous, but its slope jumps at its cutoff: its gradient is exact almost "
            "everywhere, and the fields made of it jump where a grain comes into reach; take Lucy for smooth ones"
        )
        warn_once("kernel of gradients", text)
    elif not kernel.differentiable:
        text = (
            f"the {kernel.name} kernel jumps at its cutoff: its gradient leaves the jump out (8 % low for a Gaussian "
            "cut at 3 w); take Lucy, or gradient='least_squares'"
        )
        warn_once("kernel of gradients", text)


def _warn_of_strays(scene: Scene, nodes: Nodes) -> None:
    """Warn of a mesh with many nodes for each particle, as of particles that are far from the others."""
    particles = max(1, scene.ds.sizes["particle"])
    if nodes.count > _MANY * particles:
        text = (
            f"the automatic mesh has {' x '.join(map(str, nodes.sizes))} nodes, {nodes.count / particles:.3g} for each "
            f"particle: {about_strays(scene)}"
        )
        warn_once("strays", text)


def _warn_of_nothing_left(ds: xr.Dataset) -> None:
    """Warn of a selection that left no step or no particle, with the range of positions before."""
    if ds.sizes["particle"] and not ds.sizes["time"]:
        nothing = "no step is left, as of a selection of times that holds for none"
        warn_once("nothing left", f"{nothing}; fields are those of no grain")
        return
    # a scene that never had particles has no range
    if {"particle_lower", "particle_upper"} <= ds.attrs.keys():
        ends = zip(COMPONENTS, ds.attrs["particle_lower"], ds.attrs["particle_upper"], strict=True)
        ranges = ", ".join(f"{axis} {low:.4g} to {high:.4g}" for axis, low, high in ends)
        text = (
            "no particle is left, as of a selection whose condition holds for none: before, positions "
            f"were {ranges}; fields are those of no grain"
        )
        warn_once("nothing left", text)


# --- of fields of single steps ---------------------------------------------------------------------


def _warn_of_unknown_sliding(dimension: int) -> None:
    """Warn of a redundancy that counts sliding contacts as sticking."""
    warn_once(
        "redundancy without friction",
        "redundancy_number without friction= counts sliding contacts as sticking: where all slide it is "
        f"{dimension} times too large. Pass friction=, the coefficient between the grains (0 without, "
        "a large one where none slides)",
    )


def _warn_of_mixed_masses(scene: Scene, plan: Plan, fields: Sequence[str]) -> None:
    """Warn of a temperature that was asked for of grains of different masses together.

    Where the temperature is one of all fields, nobody asked for it: packings of many sizes, most of
    them at rest, would all warn.
    """
    smallest = scene.sizes.get("dmin", 0.0)
    if not smallest > 0:
        return
    masses = (scene.sizes["dmax"] / smallest) ** 3
    if masses <= _ALIKE_MASSES:
        return
    # at most the share that the fit of velocity and gradient takes, if only the slow grains lose it
    support = plan.support
    if support is not None and (1 + len(plan.nodes.active_axes)) / support.grains < _BIAS:
        return
    text = (
        f"{', '.join(fields)} of grains whose masses differ by {masses:.2g} assumes that all have the same variance of "
        "velocities: where light grains are faster, as in equilibrium, it is too large. Pass by= of species or of "
        "ds.cg.find_phases(...): each phase then has its temperature, and the bulk their mean by mass"
    )
    warn_once("mixed masses", text)


def _warn_of_long_extent(scene: Scene, extent: Mapping[str, float | None]) -> None:
    """Warn of a length of an average that is many times that of the scene."""
    for axis, length in extent.items():
        of_scene = length_along(scene, axis, scene.sizes.get("d43", np.nan))
        if length and length > _LONG * of_scene:
            text = (
                f"extent={{{axis!r}: {length:.4g}}} is {length / of_scene:.3g} times the length of the scene along "
                f"{axis!r} ({of_scene:.4g} m), so that sums over it are as many times too small: lengths are in m. "
                f"Leave it out where the box has edges along {axis!r}, or give extent={{{axis!r}: {of_scene:.4g}}}"
            )
            warn_once("long extent", text)


# --- of computed steps ----------------------------------------------------------------------------


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
        Number of nodes that grains reach; 0 where no sum takes velocities.
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
        plan = self.plan
        out_of_reach = not self.reached and self._warn_of_reach()
        if plan.nodes.fitted and not out_of_reach:
            self._warn_beyond_mesh()
        if plan.undercut is not None:  # the call has warned of the cause
            return
        effects: dict[str, str] = {}
        with _TURN:
            temperatures = [name for name in _TEMPERATURES if name in self.fields]
            if temperatures and plan.options.temperature != "biased":
                effects |= self._unknown_temperatures(temperatures)
            if plan.named and plan.options.temperature == "mixture" and "density" in self.fields:
                effects |= self._unknown_in_phases()
            # extent=1 m asks for an integral in place of an average: no warning
            if "volume_fraction" in self.fields and 1.0 not in plan.extent.values():
                effects |= self._fraction()
            call = active_call()
            if plan.stretch is not None and call.is_new("stretch"):
                self._warn_of_moving_edges(plan.stretch)
            if plan.support is not None and call.is_new("pressures"):
                effects |= self._lost_stress()
                effects |= self._lost_flux()
                self._warn_of_flow_in_temperatures()
                self._warn_of_lost_variances()
            if plan.support is not None and (plan.named or effects):
                effects |= self._floors(plan.support)
            texts = [text for about, text in effects.items() if call.is_new(f"few grains: {about}")]
            if texts:
                self._warn_of_few_grains(texts)

    def _warn_of_reach(self) -> bool:
        """Warn where all grains lie beyond the reach of the nodes, along axes where nothing repeats; return whether."""
        nodes = self.plan.nodes
        position = self.frame["position"]
        open_axes = np.flatnonzero(nodes.active & self.lattice.open_axes)
        if not len(position) or not open_axes.size or not nodes.count:
            return False
        reach = max(self.plan.cutoffs)
        low, high = nodes.around(reach)
        if ((position > low) & (position < high))[:, open_axes].all(axis=1).any():
            return False
        grains = []
        of_nodes = []
        for k in open_axes:
            axis = COMPONENTS[k]
            x = position[:, k]
            grains.append(f"{axis} from {x.min():.6g} to {x.max():.6g}")
            of_nodes.append(f"{axis} from {nodes.lower[k]:.6g} to {nodes.upper[k]:.6g}")
        warn_once(
            "reach",
            f"{self.source}: no grain reaches any node, so that sums are zero: grains lie at {', '.join(grains)}, "
            f"nodes at {', '.join(of_nodes)}, and the kernel reaches {reach:.4g}; check bounds=, at= and the units of "
            "lengths",
        )
        return True

    def _warn_beyond_mesh(self) -> None:
        """Warn where grains lie beyond a mesh that was laid around others."""
        nodes = self.plan.nodes
        room = 0.5 * max(self.plan.cutoffs)
        for k in np.flatnonzero(self.lattice.open_axes):
            axis = COMPONENTS[k]
            if axis in nodes.fitted:
                x = self.frame["position"][:, k]
                warn_beyond(axis, x, nodes.lower[k], nodes.upper[k], self.source, room=room)

    def _warn_of_few_grains(self, effects: Sequence[str]) -> None:
        """Warn of what few grains at a node do to fields."""
        seen = "too few grains"
        if self.plan.support is not None:
            seen = f"only about {self.plan.support.text()}"
        warn_user(
            f"{self.source}: a node sees {seen}, so that in a single step {'; '.join(effects)}: take the time_average "
            f"of the result, average along axes (axes=), or increase width= (it is {self.plan.kernel.width:.3g})"
        )

    def _floors(self, support: Support) -> dict[str, str]:
        """Return which norms and eigenvalues are noise, unless all are small or contradict the step.

        Empty if the call has already named floors of another step.
        """
        if active_call().has_asked(f"few grains: {_FLOORS}"):
            return {}
        if {*_OF_READ_CONTACTS} & {*self.plan.requested}:
            branches, forces = spread_of_contacts(self.frame, self.lattice)
            support = replace(support, branch_spread=branches, tangential=forces)
        if support.is_dense and not _OF_FLUCTUATION.isdisjoint(self.plan.requested):
            support = replace(support, shaken=self._shaken(support.volume_fraction))
        texts = self._texts_of_floors(support)
        if not texts:
            return {}
        # looks at pairs of grains, so that it comes last
        if Particles(self.frame, self.plan.setup, self.lattice, is_volume=False).is_lattice:
            texts = self._texts_of_floors(replace(support, contacts=_OF_LATTICE))
        if not texts:
            return {}
        return {_FLOORS: f"{', '.join(texts)} where the true value is 0"}

    def _texts_of_floors(self, support: Support) -> list[str]:
        """Return the floors that are considerable, and that the values at nodes do not contradict."""
        texts = []
        for name, (floor, field) in floors_of(self.plan, support).items():
            if not floor > CONSIDERABLE_FLOOR * field.usual:
                continue
            values = self.fields[name]
            sampled = values[sample_of(len(values))]
            finite = sampled[np.isfinite(sampled)]
            shown = float(np.median(finite)) if finite.size else np.nan
            if field.floor_units == UNIT_OF_RATES:
                noise = floor * self._fluctuation / support.diameter
                is_small = noise <= CONSIDERABLE_FLOOR * shown
            else:
                is_small = shown < _CONTRADICTED * floor
            if not is_small:
                texts.append(f"{name} is about {field.floor_text(floor)}")
        return texts

    @cached_property
    def _pressures(self) -> Pressures | None:
        """Parts of the pressure of the grains that are free, None without any."""
        free = without_frozen(self.frame)
        if not len(free["mass"]):
            return None
        return pressures_of(self.plan, free, self.lattice)

    @cached_property
    def _fluctuation(self) -> float:
        """Return the root of the temperature of the step (m s-1), 0 without grains."""
        parts = self._pressures
        if parts is None:
            return 0.0
        temperature = float(parts.kinetic.sum()) / (self.plan.options.dimension * parts.mass)
        # it holds what is left of a flow that is no smooth one
        of_fits = self.fields.get("granular_temperature", np.empty(0))
        of_fits = of_fits[of_fits >= 0]
        if of_fits.size:
            temperature = min(temperature, float(np.median(of_fits)))
        return math.sqrt(temperature)

    def _shaken(self, volume_fraction: float) -> float:
        """Return the velocity fluctuation over sqrt(p / rho_p), infinite without a pressure."""
        parts = self._pressures
        if parts is None:
            return math.inf
        pressure = float((parts.kinetic + parts.contact).sum()) * volume_fraction
        if not pressure > 0:
            return math.inf
        return self._fluctuation / math.sqrt(pressure / (self.plan.options.dimension * parts.mass))

    def _unknown_temperatures(self, names: Sequence[str]) -> dict[str, str]:
        """Return which temperatures are NaN at most nodes, unless grains have no mass."""
        effects: dict[str, str] = {}
        if "mass" in self.frame and not self.frame["mass"].any():
            return effects
        for name in names:
            values = self.fields[name]
            count = np.count_nonzero(np.isfinite(values.reshape(len(values), -1)[:, 0]))
            if 2 * count < self.reached:
                effects[name] = f"{name} is NaN at {self.reached - count} of {self.reached} nodes"
        return effects

    def _unknown_in_phases(self) -> dict[str, str]:
        """Return which temperatures are NaN at many nodes of a phase."""
        effects = {}
        reached = self.fields["density"] > 0
        count = np.maximum(reached.sum(axis=0), 1)
        for name in ("granular_temperature", "mixture_temperature"):
            if name not in self.fields:
                continue
            lost = reached & ~np.isfinite(self.fields[name])
            shares = lost.sum(axis=0) / count
            phases = [
                f"{100 * share:.0f} % of the nodes of phase {group}"
                for group, share in zip(self.plan.groups, shares[1:], strict=True)
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
        # around one grain the others fill the space at most
        if alone > 0.5 and fraction.max() < _SLACK * (1 + alone):
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

    def _warn_of_moving_edges(self, stretch: NDArray) -> None:
        """Warn where the grains move with a box that changes its length, and their images are taken to be at rest."""
        position = self.frame["position"]
        velocity = self.frame["velocity"]
        rates = {}
        for k, axis in enumerate(COMPONENTS):
            x = position[:, k] - position[:, k].mean()
            v = velocity[:, k] - velocity[:, k].mean()
            squares = float(x @ x)
            if not stretch[k].any() or not squares > 0:
                continue
            slope = float(x @ v) / squares
            error = math.sqrt(float(((v - slope * x) ** 2).mean()) / squares)
            of_box = float(np.clip(slope, *stretch[k]))
            if abs(slope - of_box) < _ALIKE_RATES * abs(slope) and abs(slope) > _SURE * error:
                rates[axis] = of_box
        if rates:
            axes = " and ".join(rates)
            named = ", ".join(f"'{2 * axis}': {rate:.3g}" for axis, rate in rates.items())
            warn_once(
                "moving edges",
                f"{self.source}: the grains move with the box, whose length changes along {axes}, and their images are "
                "taken to be at rest: velocities jump at its edges, gradients lack this motion where these axes are "
                "averaged, and temperatures contain it. Name its rates, a number or one for each step: "
                f"shear_rate={{{named}}} in open_scene or scene_from_arrays",
            )

    def _lost_stress(self) -> dict[str, str]:
        """Return how much of the pressure the kinetic stress lacks; warn if it contains variation of the flow.

        It lacks the part of the fluctuations that the velocity at a node follows, as few grains make
        this velocity; it contains the variation of the flow within the support. Without contacts the
        pressure is not known: shares are of the kinetic stress itself, if it was requested by name.
        """
        plan = self.plan
        assert plan.support is not None
        has_contacts = "contact_i" in self.frame
        options = plan.options
        taking = [
            name for name in plan.requested if takes_stress_of_step(plan.definitions[name], options)
        ]
        if not taking or not (has_contacts or plan.named):
            return {}
        parts = self._pressures
        if parts is None:
            return {}
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

    def _lost_flux(self) -> dict[str, str]:
        """Return how much the flux of a phase lacks, as the bulk's velocity at a node follows the grains there."""
        assert self.plan.support is not None
        share = 1 / self.plan.support.grains
        if "segregation_flux" not in self.plan.requested or share <= _CONSIDERABLE:
            return {}
        text = (
            f"segregation_flux lacks about {100 * share:.0f} % of it, as the bulk's velocity at a node follows these "
            "grains"
        )
        return {"lost flux": text}

    def _warn_of_lost_variances(self) -> None:
        """Warn of variances and fluxes of variables that lack a part, which averages over steps do not give back."""
        support = self.plan.support
        assert support is not None
        lost = {}
        for field in self.plan.options.own:
            is_quantity = isinstance(field, OwnField) and field.name in self.plan.requested
            if not (is_quantity and field.follows_mean):
                continue
            share = 1 / (support.contacts if field.at_contacts else support.grains)
            if share > _CONSIDERABLE:
                lost[field.name] = f"{field.name} lacks about {100 * share:.0f} % of it"
        if lost:
            warn_once(
                "lost variances",
                f"{self.source}: a node sees only about {support.text()}, so that {', '.join(lost.values())}, in "
                "averages over steps and nodes, too, as the mean at a node follows these: average along axes (axes=), "
                f"or increase width= (it is {self.plan.kernel.width:.3g})",
            )

    def _warn_of_flow_in_temperatures(self) -> None:
        """Warn where temperatures hold the variation of the flow along an averaged axis, which no gradient sees."""
        named = [name for name in _OF_ONE_VARIANCE if name in self.plan.requested]
        hidden = not self.plan.nodes.active[list(self.plan.options.plane)].all()
        if not (self.plan.named and named and hidden):
            return
        parts = self._pressures
        if parts is None:
            return
        kinetic = float(parts.about_flow.sum())
        added = {}
        for axis, part in parts.averaged.items():
            size = float(part.sum())
            least = _ALONG_PERIOD if axis in self.plan.setup.periodic else _CONSIDERABLE
            if size > least * (size + kinetic):
                added[axis] = size
        if added:
            total = sum(added.values())
            share = total / (total + kinetic)
            axes = " and ".join(axis for axis, size in added.items() if size > 0.3 * total)
            warn_once(
                "flow in temperatures",
                f"{self.source}: {', '.join(named)}: about {100 * share:.0f} % of it is no fluctuation but the "
                f"variation of the flow along {axes}, which fields are averaged over: resolve {axes} too (axes=), and "
                "average after",
            )

    def _warn_of_variation(self, parts: Pressures, true: float, names: str, whole: str) -> None:
        """Warn where a considerable part of the pressure is variation of the flow, not fluctuation.

        Of tensors it is also the part of a normal stress, or of the mean one, whichever is larger:
        a stress that is small beside the others is of no weight in their ratios.
        """
        by_component = parts.smeared + sum(parts.averaged.values())
        added = float(by_component.sum())
        if not added:
            return
        share = added / (added + true)
        if {"kinetic_stress", "stress"} & {*self.plan.requested}:
            normal = by_component + parts.kinetic + np.maximum(parts.contact, 0.0)
            mean = (added + true) / self.plan.options.dimension
            shares = by_component / np.maximum(normal, mean)
            largest = int(shares.argmax())
            if shares[largest] > share:
                share = float(shares[largest])
                whole = f"the component {2 * COMPONENTS[largest]} of the stress"
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
