"""Quantities of packings in each step, by region and phase."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.analysis.by_phase import PhaseAnalysis
from xcg.analysis.mixing import Mixture, ratio
from xcg.analysis.network import CONTACTS
from xcg.analysis.quantities import QUANTITIES
from xcg.analysis.regions import Bounds, ends_of, images_in
from xcg.analysis.samples import OF_PARTICLES, ContactSides, Sample
from xcg.scene.contacts import Contacts
from xcg.scene.lattice import Lattice
from xcg.scene.scene import Scene
from xcg.scene.schema import COMPONENTS, Frame, Variable
from xcg.steps.labels import annotated

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
        sides = None
        if "contact_i" in frame:
            contacts = Contacts.of(frame, lattice, source)
            sides = ContactSides.of(contacts, self.setup.dimension, iterative=self.iterative)
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
            is_endless = [a in self.setup.periodic and a not in bounds for a in COMPONENTS]
            for which, member in enumerate(members):
                sample = Sample(
                    count=int(member.sum()),
                    region_volume=volume,
                    plane=self.setup.axes,
                    is_endless=np.array(is_endless),
                    min_contacts=self.min_contacts,
                    max_connectivity=self.max_connectivity,
                    force_bins=self.force_bins,
                    which=which,
                    mixture=mixture,
                )
                for name in OF_PARTICLES & images.keys():
                    setattr(sample, name, images[name][member])
                if sides is not None:
                    sample.add_contacts(sides, member)
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
