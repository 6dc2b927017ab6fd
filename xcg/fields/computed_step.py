"""Warnings about the fields of a computed step that are unknown, impossible, or noise."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import active_call, warn_once, warn_user
from xcg.fields.formulas.doubts import UNKNOWN
from xcg.fields.formulas.field import Support
from xcg.fields.formulas.floors import CONSIDERABLE_FLOOR, UNIT_OF_RATES
from xcg.fields.formulas.rules import takes_stress_of_step
from xcg.fields.plan import Plan
from xcg.fields.pressures import Pressures, pressures_of, spread_of_contacts
from xcg.fields.support import floors_of
from xcg.scene.frame import without_frozen
from xcg.scene.lattice import Lattice
from xcg.scene.sanity_sample import Particles, sample_of
from xcg.scene.schema import COMPONENTS, Frame

_CONSIDERABLE = 0.05  # share of the pressure
_CONTRADICTED = 0.3  # share of a floor below which what nodes show is no noise of random contacts
_OF_LATTICE = 1e12  # contacts as good as independent ones, as they repeat without scatter
_FLOORS = "floors"  # what the warning about them is about
_ALIKE = 0.3  # difference of a slope of the velocities from the rate of the box
_SLACK = 1.2  # of a volume fraction above 1 that one grain is the cause of
_SURE = 5.0  # standard errors of such a slope
# Share of a temperature along a period: waves of a homogeneous flow are fluctuations, and vary by half of it.
_ALONG_PERIOD = 0.6

_AVERAGED_OVER = ("granular_temperature", "directional_temperature", "mixture_temperature")
_OF_READ_CONTACTS = ("branch_anisotropy", "tangential_force_anisotropy")
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
        plan = self.plan
        if plan.undercut is not None:  # the call has warned of the cause
            return
        call = active_call()
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
            if plan.stretch is not None and call.is_new("stretch"):
                self._warn_of_moving_edges(plan.stretch)
            if plan.support is not None and call.is_new("pressures"):
                effects |= self._lost_stress()
                effects |= self._lost_flux()
                self._warn_of_flow_in_temperatures()
                self._warn_of_lost_variances()
            if (plan.named or effects) and not call.has_asked(f"few grains: {_FLOORS}"):
                effects |= self._floors(plan.support)
            texts = [text for about, text in effects.items() if call.is_new(f"few grains: {about}")]
            if texts:
                self._warn_of_few_grains(texts)

    def _warn_of_few_grains(self, effects: Sequence[str]) -> None:
        """Warn of what few grains at a node do to fields."""
        seen = "too few grains"
        if self.plan.support is not None:
            seen = f"only about {self.plan.support.text()}"
        warn_user(
            f"{self.source}: a node sees {seen}, so that in a single step {'; '.join(effects)}: take the time_average "
            f"of the result, average along axes (axes=), or increase width= (it is {self.plan.kernel.width:.3g})"
        )

    def _floors(self, support: Support | None) -> dict[str, str]:
        """Return which norms and eigenvalues are noise, unless all are small or contradict the step."""
        if support is None:
            return {}
        if {*_OF_READ_CONTACTS} & {*self.plan.requested}:
            branches, forces = spread_of_contacts(self.frame, self.lattice)
            support = replace(support, branch_spread=branches, tangential=forces)
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
    def _fluctuation(self) -> float:
        """Return the root of the temperature of the step (m s-1), 0 without grains."""
        free = without_frozen(self.frame)
        if not len(free["mass"]):
            return 0.0
        parts = pressures_of(self.plan, free, self.lattice)
        temperature = float(parts.kinetic.sum()) / (self.plan.options.dimension * parts.mass)
        # it holds what is left of a flow that is no smooth one
        of_fits = self.fields.get("granular_temperature", np.empty(0))
        of_fits = of_fits[of_fits >= 0]
        if of_fits.size:
            temperature = min(temperature, float(np.median(of_fits)))
        return math.sqrt(temperature)

    def _unknown_temperatures(self, names: Sequence[str]) -> dict[str, str]:
        """Return which temperatures are NaN at most nodes."""
        effects = {}
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
            if abs(slope - of_box) < _ALIKE * abs(slope) and abs(slope) > _SURE * error:
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
            name for name in plan.requested if takes_stress_of_step(plan.definitions[name], options)
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
        for field in self.plan.about_means:
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
        named = [name for name in _AVERAGED_OVER if name in self.plan.requested]
        free = without_frozen(self.frame)
        hidden = not self.plan.nodes.active[list(self.plan.options.plane)].all()
        if not (self.plan.named and named and hidden and len(free["mass"])):
            return
        parts = pressures_of(self.plan, free, self.lattice)
        kinetic = float(parts.kinetic.sum())
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
        """Warn where a considerable part of the pressure is no fluctuation but the variation of the flow.

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
