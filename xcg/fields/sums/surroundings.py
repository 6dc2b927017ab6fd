"""What the steps of one box share: the nodes among periodic images, and the kernel, in each cutoff."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from xcg.compiled.points import SQUARED
from xcg.fields.sums.passes import AnyKernel, DepositSpec
from xcg.fields.sums.reach import Mesh
from xcg.scene.lattice import Lattice


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Nodes and kernels of a recipe by cutoff, in a box.

    Attributes
    ----------
    lattice : Lattice
        Periodic images, as seen along the axes of the nodes.
    meshes : dict
        Mesh and its surroundings, in cutoffs.
    kernels : dict
        The kernel, divided by the extent of averaged axes.
    """

    lattice: Lattice
    meshes: Mapping[float, Mesh]
    kernels: Mapping[float, AnyKernel]
    _others: dict[float, NDArray] = field(default_factory=dict)

    @classmethod
    def of(cls, spec: DepositSpec, lattice: Lattice, scale: float, source: str) -> Surroundings:
        """Return those of a box, and kernels times a scale.

        Raises
        ------
        SceneError
            If the box is too small, or has no images as seen along some axes.
        """
        lattice = replace(lattice.seen(spec.grid.active, source), edges=None)  # which are a part of the scene
        meshes = {cutoff: Mesh.of(spec.grid, lattice.period, cutoff) for cutoff in spec.distinct}
        for cutoff in {spec.distinct[0], spec.distinct[-1]}:
            meshes[cutoff].check_reach(meshes[cutoff].reach, source, paired=spec.level >= SQUARED)
        kernels, seen = {}, int(spec.grid.active.sum())
        for cutoff in spec.distinct:
            norm = spec.weights.norm * (spec.cutoffs[0] / cutoff) ** seen
            kernels[cutoff] = spec.weights._replace(norm=norm * scale)
        return cls(lattice, meshes, kernels)

    def meet(self, cutoff: float, source: str) -> NDArray | None:
        """Return translations (m, 3), in cutoffs, between images of a grain that reach one node; None where none do."""
        if cutoff not in self._others:
            both_seen = 2.0 + 2.0 * float(np.linalg.norm(self.meshes[cutoff].half))
            self._others[cutoff] = self.lattice.scaled(cutoff).translations(both_seen, source)
        found = self._others[cutoff]
        return found if len(found) else None
