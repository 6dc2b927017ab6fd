"""Microstructure of one step: particles and contacts of each region and group."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.analysis.by_phase import PhaseAnalysis
from xcg.analysis.mixing import Mixture
from xcg.analysis.network import Clusters
from xcg.analysis.quantities import CONTACTS, QUANTITIES, ratio
from xcg.analysis.regions import Bounds, ends_of, images_in
from xcg.scene.contacts import Contacts
from xcg.scene.lattice import Lattice
from xcg.scene.scene import Scene
from xcg.scene.schema import COMPONENTS, Frame, Variable
from xcg.steps.labels import annotated

# Partners that hold a sphere in place without friction: one more than the dimensions.
NOT_A_RATTLER = {3: 4, 2: 3}
_ROUNDING = 1e-9  # of a force, below which its tangential part is none
CELL = 3.0  # edge of the cells that concentrations are sampled in, in mean diameters d43


@dataclass(frozen=True, eq=False)
class Measure(PhaseAnalysis):
    """Quantities of each step, by region and phase.

    Attributes
    ----------
    names : tuple of str
        Names in `QUANTITIES`.
    regions : mapping
        Bounds by name of the region; the name is empty where there is one region only, and no
        bounds mean the whole scene.
    depth : float or str or None
        Thickness of a one-layer scene (m), or the axis whose box extent it is.
    axis : str
        Axis that heights are measured along.
    """

    name = "microstructure"

    names: tuple[str, ...]
    regions: Mapping[str, Bounds]
    depth: float | str | None
    min_contacts: int
    iterative: bool
    max_connectivity: int
    force_bins: NDArray
    cell: float | Mapping[str, float] | None
    by_volume: bool
    axis: str

    @property
    def needs(self) -> set[str]:
        """Variables of the scene that the quantities need."""
        return {variable for name in self.names for variable in QUANTITIES[name].needs}

    def reads(self, scene: Scene) -> list[str]:
        """Return what the quantities need, what groups follow from, and normals if there are any."""
        read = self.needs | {"position", self.by}
        if self.needs & set(CONTACTS):
            read.add("contact_normal")
        return [name for name in scene.columns if name in read]

    def rows(self, scene: Scene) -> dict[str, Variable]:
        """Return the quantities by region and phase, as far as there are several."""
        rows = {}
        for name in self.names:
            row = QUANTITIES[name]
            dims = (*self._lengths, *row.dims)
            rows[name] = Variable(dims, row.units, row.long_name, formula=row.formula)
        return rows

    @property
    def _lengths(self) -> dict[str, int]:
        """Numbers of regions and phases, as far as these are dimensions of the results."""
        lengths = {}
        if "" not in self.regions:
            lengths["region"] = len(self.regions)
        if self.by is not None:
            lengths["phase"] = 1 + self.phase_count
        return lengths

    def coords(self, scene: Scene) -> dict[str, xr.Variable]:
        """Return regions, phases, and the bins of distributions."""
        bins = self.force_bins
        middle = (bins[1:] + bins[:-1]) / 2
        if bins[0] > 0:
            middle = np.sqrt(bins[1:] * bins[:-1])
        counts = np.arange(self.max_connectivity + 1)
        return super().coords(scene) | {
            "partners": annotated("partners", counts, "1", "number of contact partners"),
            "force_ratio": annotated("force_ratio", middle, "1", "force over its mean"),
            "force_ratio_width": annotated("force_ratio", np.diff(bins), "1", "width of the bin"),
            "region": xr.Variable("region", list(self.regions)),
        }

    def frame(self, frame: Frame, lattice: Lattice, source: str) -> dict[str, NDArray]:
        """Compute the quantities of one step."""
        frame, phase = self.moving(frame, source)
        contacts = None
        if "contact_i" in frame:
            contacts = Contacts.of(frame, lattice, source)
        shared = _shared(self, contacts)
        samples = []
        for bounds in self.regions.values():
            position, inside = images_in(bounds, frame["position"], lattice, source)
            volume = self._volume(bounds, lattice)
            images = frame | {"position": position}
            if "velocity" in frame:
                drift = lattice.drift(position - frame["position"])
                images["velocity"] = frame["velocity"] + drift
            mixture = self._mixture(bounds, lattice, images, inside, phase)
            members = [inside]
            if self.by is not None:
                members += [inside & (phase == p) for p in range(self.phase_count)]
            for which, member in enumerate(members):
                sample = _sample(self, images, contacts, shared, member, volume)
                sample.mixture = mixture
                sample.which = which
                sample.is_endless = [
                    a in self.setup.periodic and a not in bounds for a in COMPONENTS
                ]
                samples.append(sample)
        shape = self._lengths.values()
        results = {}
        for name in self.names:
            values = np.array([QUANTITIES[name].compute(sample) for sample in samples], float)
            results[name] = values.reshape((*shape, *values.shape[1:]))
        return results

    def _mixture(
        self, bounds: Bounds, lattice: Lattice, frame: Frame, inside: NDArray, phase: NDArray
    ) -> Mixture | None:
        """Grains of a region by phase, if a quantity needs them.

        Without bounds or box, the region is as large as the extent of their centres.
        """
        if not any(QUANTITIES[name].of_phases for name in self.names):
            return None
        size = frame["diameter"][inside]
        x = frame["position"][inside][:, self.setup.axes]
        ends = ends_of(bounds, lattice)
        lower, upper = np.array([ends[a] for a in self.setup.plane], float).T
        if len(x):
            lower = np.where(np.isfinite(lower), lower, x.min(axis=0))
            upper = np.where(np.isfinite(upper), upper, x.max(axis=0))
        lengths = np.where(upper > lower, upper - lower, 1.0)
        cell = self.cell or CELL * float(ratio((size**4).sum(), (size**3).sum()))
        if not isinstance(cell, Mapping):
            cell = dict.fromkeys(self.setup.plane, cell)
        weight = np.ones(len(x))
        if self.by_volume:
            weight = frame["volume"][inside]
        return Mixture(
            position=x - lower,
            phase=phase[inside],
            weight=weight,
            lengths=lengths,
            cell=np.array([cell.get(a, np.inf) for a in self.setup.plane], float),
            height=x[:, self.setup.plane.index(self.axis)],
            volume=frame["volume"][inside],
        )

    def _volume(self, bounds: Bounds, lattice: Lattice) -> float:
        """Volume of a region (m3); NaN where neither bounds nor box say how far it reaches."""
        ends = ends_of(bounds, lattice)
        volume = 1.0
        for axis in self.setup.plane:
            volume *= ends[axis][1] - ends[axis][0]
        if isinstance(self.depth, str):
            volume *= lattice.length(self.depth)
        elif self.depth is not None:
            volume *= self.depth
        return float(volume) if np.isfinite(volume) else np.nan


def _shared(measure: Measure, contacts: Contacts | None) -> SimpleNamespace:
    """Return partners, rattlers, forces and virials of a frame, which all its groups share."""
    if contacts is None:
        return SimpleNamespace()
    least = NOT_A_RATTLER[measure.setup.dimension]
    total = np.linalg.norm(contacts.force, axis=1)
    tangential = np.linalg.norm(contacts.tangential_force, axis=1)
    tangential[~(tangential > _ROUNDING * total)] = 0.0
    virial_i = contacts.force[:, :, None] * contacts.branch_i[:, None, :]
    virial_j = -contacts.force[:, :, None] * contacts.branch_j[:, None, :]
    backbone = contacts.partners >= least
    if measure.iterative:
        backbone = contacts.k_core(least)
    return SimpleNamespace(
        partners=contacts.partners,
        backbone=backbone,
        normal_force=contacts.normal_force,
        tangential_force=tangential,
        virial=contacts.sum_over_particles(virial_i, virial_j),
    )


def _sample(
    measure: Measure,
    frame: Frame,
    contacts: Contacts | None,
    shared: SimpleNamespace,
    member: NDArray,
    volume: float,
) -> SimpleNamespace:
    """Particles and contacts of one group, as the functions of the quantities take them.

    A contact counts half for each of its particles in the group, and whole for a particle at a
    wall.
    """
    sample = SimpleNamespace(
        count=int(member.sum()),
        region_volume=volume,
        plane=measure.setup.axes,
        min_contacts=measure.min_contacts,
        max_connectivity=measure.max_connectivity,
        force_bins=measure.force_bins,
    )
    for name in ("position", "diameter", "volume", "mass", "velocity"):
        if name in frame:
            setattr(sample, name, frame[name][member])
    if contacts is None:
        return sample
    is_member = np.append(member, False)  # row -1 is a missing partner
    members = is_member[contacts.i].astype(float) + is_member[contacts.j]
    particles = (contacts.i >= 0).astype(int) + (contacts.j >= 0)
    weight = np.divide(members, particles, out=np.zeros(len(particles)), where=particles > 0)
    counted = weight > 0
    sample.weight = weight[counted]
    sample.normal = contacts.normal[counted]
    pushing = counted & (shared.normal_force > 0)
    sample.pushing = weight[pushing]
    sample.normal_force = shared.normal_force[pushing]
    sample.tangential_force = shared.tangential_force[pushing]
    sample.clusters = Clusters(contacts, member)
    sample.partners = shared.partners[member]
    sample.backbone = shared.backbone[member]
    sample.virial = shared.virial[member].sum(axis=0)
    return sample
