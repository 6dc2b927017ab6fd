"""Microstructure of one step: what is measured of the particles and contacts of each region and group."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.packing.mixing import Mixture
from xcg.packing.network import Clusters
from xcg.packing.quantities import QUANTITIES, ratio
from xcg.scene.contacts import Contacts
from xcg.scene.frame import phase_of, steps_in, without_frozen
from xcg.scene.lattice import Lattice
from xcg.scene.schema import COMPONENTS, Frame, Setup

Bounds = Mapping[str, Sequence[float]]

# Partners that hold a sphere in place without friction: one more than the dimensions.
NOT_A_RATTLER = {3: 4, 2: 3}
_ROUNDING = 1e-9  # of a force, below which its tangential part is none
CELL = 3.0  # edge of the cells that concentrations are sampled in, in mean diameters d43


@dataclass(frozen=True, eq=False)
class Measure:
    """Options of the measurement of a frame.

    Attributes
    ----------
    names : tuple of str
        Names in `QUANTITIES`.
    regions : tuple of mapping
        Bounds of each region; one without bounds is the whole scene.
    groups : tuple of int
        Values of `by`; empty without phases.
    depth : float or str or None
        Thickness of a one-layer scene (m), or the axis whose box extent it is.
    """

    names: tuple[str, ...]
    setup: Setup
    regions: tuple[Bounds, ...]
    by: str | None
    groups: tuple[int, ...]
    depth: float | str | None
    min_contacts: int
    iterative: bool
    max_connectivity: int
    force_bins: NDArray
    cell: float | None
    by_volume: bool
    neighbours: int

    @property
    def phases(self) -> int:
        """Number of phases, the bulk included."""
        return 1 + len(self.groups)

    def sizes(self, name: str) -> tuple[int, ...]:
        """Size of a quantity along its own dimensions."""
        lengths = {"partners": self.max_connectivity + 1, "force_ratio": len(self.force_bins) - 1}
        return tuple(lengths.get(dim, 3) for dim in QUANTITIES[name].dims)

    def shape(self, name: str) -> tuple[int, ...]:
        """Shape of one step of a quantity: region, phase, its own dimensions."""
        return (len(self.regions), self.phases, *self.sizes(name))

    def __call__(self, arrays: Mapping[str, NDArray]) -> dict[str, NDArray]:
        """Quantities of one chunk of time."""
        out = {name: np.empty((len(arrays["particle_id"]), *self.shape(name))) for name in self.names}
        for t, step in enumerate(steps_in(arrays, self.setup.periodic)):
            self.measure(*step, {name: a[t] for name, a in out.items()})
        return out

    def measure(self, frame: Frame, lattice: Lattice, source: str, out: Mapping[str, NDArray]) -> None:
        """Write the quantities of one frame into arrays (region, phase, ...)."""
        frame = without_frozen(frame)
        contacts = Contacts.of(frame, lattice, source) if "contact_i" in frame else None
        shared = _shared(self, frame, contacts)
        phase = phase_of(frame, self.by, self.groups, source)
        for r, bounds in enumerate(self.regions):
            position, inside = _images_in(bounds, frame["position"], lattice, source)
            volume, here = self._volume(bounds, lattice.edges), frame
            if "velocity" in frame:
                here = frame | {"velocity": frame["velocity"] + lattice.drift(position - frame["position"])}
            mixture = self._mixture(bounds, lattice, frame, position, inside, phase, source)
            for p in range(self.phases):
                member = inside if p == 0 else inside & (phase == p - 1)
                sample = _sample(self, here, position, contacts, shared, member, volume)
                sample.mixture, sample.which = mixture, p
                for name in self.names:
                    out[name][r, p] = QUANTITIES[name].compute(sample)

    def _mixture(
        self, bounds: Bounds, lattice: Lattice, frame: Frame, position: NDArray, inside: NDArray, phase: NDArray,
        source: str,
    ) -> Mixture | None:  # fmt: skip
        """Grains of a region by phase, where quantities need them; without bounds or box it is as large as they are."""
        if not any(QUANTITIES[name].of_phases for name in self.names):
            return None
        axes = [COMPONENTS.index(a) for a in self.setup.plane]
        x, size = position[inside][:, axes], frame["diameter"][inside]
        edges = np.full((3, 2), np.nan) if lattice.edges is None else lattice.edges
        lower, upper = np.array([bounds.get(COMPONENTS[k], edges[k]) for k in axes], float).T
        if len(x):
            lower = np.where(np.isfinite(lower), lower, x.min(axis=0))
            upper = np.where(np.isfinite(upper), upper, x.max(axis=0))
        lengths = np.where(upper > lower, upper - lower, 1.0)
        whole = np.isclose(lengths, lattice.lengths[axes], rtol=1e-9)

        def images(reach: float) -> tuple[NDArray, NDArray]:
            low, high = position[inside].min(axis=0), position[inside].max(axis=0)
            low[axes] = np.minimum(low[axes], lower) - np.where(whole, reach, 0.0)
            high[axes] = np.maximum(high[axes], upper) + np.where(whole, reach, 0.0)
            row, shift, _ = lattice.images(position[inside], low, high, source)
            return row, (position[inside][row] + shift)[:, axes] - lower

        d43 = float(ratio((size**4).sum(), (size**3).sum()))
        return Mixture(
            x - lower, phase[inside], frame["volume"][inside] if self.by_volume else np.ones(len(x)), lengths,
            whole, self.cell or CELL * d43, self.neighbours, None if lattice.vectors is None else images,
        )  # fmt: skip

    def _volume(self, bounds: Bounds, box: NDArray | None) -> float:
        """Volume of a region (m3); NaN where neither bounds nor box say how far it reaches."""
        edges = np.full((3, 2), np.nan) if box is None else box
        lengths = []
        for axis in self.setup.plane + (self.depth if isinstance(self.depth, str) else ""):
            low, high = bounds.get(axis, edges[COMPONENTS.index(axis)])
            lengths.append(high - low if np.isfinite(high - low) else np.nan)
        return float(np.prod(lengths)) * (self.depth if isinstance(self.depth, float) else 1.0)


def _images_in(bounds: Bounds, position: NDArray, lattice: Lattice, source: str) -> tuple[NDArray, NDArray]:
    """Positions (n, 3), which begin at the bounds or the box along periodic axes, and which are in the bounds."""
    corner = np.zeros(3) if lattice.edges is None else lattice.edges[:, 0]
    first, inside = corner.copy(), np.ones(len(position), bool)
    for k, axis in enumerate(COMPONENTS):
        if axis in bounds:
            first[k], high = bounds[axis]
            period = lattice.lengths[k]
            if high - first[k] > period * (1 + 1e-9):
                raise SceneError(
                    f"{source}: the region reaches from {first[k]:g} to {high:g} along {axis!r}, further than the "
                    f"period {period:g}, and would hold grains twice; take narrower bounds, or none along "
                    f"{axis!r} for the whole period"
                )
    for start in (corner, first):  # grains of the box stay as they are where bounds are in it, too
        position = lattice.wrapped(position, start, source)
    for k, axis in enumerate(COMPONENTS):
        if axis in bounds:
            inside &= (bounds[axis][0] <= position[:, k]) & (position[:, k] < bounds[axis][1])
    return position, inside


def _shared(measure: Measure, frame: Frame, contacts: Contacts | None) -> SimpleNamespace:
    """Compute what all groups of a frame share: partners, rattlers, normal forces, the virial of each particle."""
    if contacts is None:
        return SimpleNamespace()
    least = NOT_A_RATTLER[measure.setup.dimension]
    tangential = np.linalg.norm(contacts.tangential_force, axis=1)
    virial_i = contacts.force[:, :, None] * contacts.branch_i[:, None, :]
    virial_j = -contacts.force[:, :, None] * contacts.branch_j[:, None, :]
    return SimpleNamespace(
        partners=contacts.partners,
        held=contacts.k_core(least) if measure.iterative else contacts.partners >= least,
        normal_force=contacts.normal_force,
        tangential_force=np.where(tangential > _ROUNDING * np.linalg.norm(contacts.force, axis=1), tangential, 0.0),
        virial=contacts.sum_over_particles(virial_i, virial_j),
    )


def _sample(
    measure: Measure, frame: Frame, position: NDArray, contacts: Contacts | None, shared: SimpleNamespace,
    member: NDArray, volume: float,
) -> SimpleNamespace:  # fmt: skip
    """Particles and contacts of one group, as the functions of the quantities take them.

    A contact counts half for each of its particles in the group, and whole for a particle at a wall.
    """
    s = SimpleNamespace(
        count=int(member.sum()),
        region_volume=volume,
        position=position[member],
        plane=[COMPONENTS.index(a) for a in measure.setup.plane],
        min_contacts=measure.min_contacts,
        max_connectivity=measure.max_connectivity,
        force_bins=measure.force_bins,
        **{name: frame[name][member] for name in ("diameter", "volume", "mass", "velocity") if name in frame},
    )
    if contacts is not None:
        known = np.append(member, False)  # row -1 is that of a partner that is not there
        side_i, side_j = known[contacts.i], known[contacts.j]
        sides = (contacts.i >= 0).astype(int) + (contacts.j >= 0)
        weight = np.divide(side_i.astype(float) + side_j, sides, out=np.zeros(len(sides)), where=sides > 0)
        here = weight > 0
        s.weight, s.normal = weight[here], contacts.normal[here]
        push = shared.normal_force[here] > 0
        s.pushing = s.weight[push]
        s.normal_force, s.tangential_force = shared.normal_force[here][push], shared.tangential_force[here][push]
        s.clusters = Clusters(contacts, member)
        s.partners, s.held = shared.partners[member], shared.held[member]
        s.virial = shared.virial[member].sum(axis=0)
    return s
