"""Sums over grains and contacts at the nodes: from a frame to the passes that make them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.compiled.threads import for_each
from xcg.fields.sums import points
from xcg.fields.sums.nodes import NodeBlock
from xcg.fields.sums.segments import along_branches
from xcg.fields.sums.step import DepositSpec, Layout, Pass, StepRows
from xcg.scene.frame import check_finite
from xcg.scene.lattice import Lattice
from xcg.scene.schema import Frame


@dataclass(frozen=True, eq=False)
class BlockSums:
    """Sums at the nodes of one block, each pass (groups, nodes, columns), and what they refer to.

    `velocity` (nodes, 3) is what the main pass refers to, `references` what each does; NaN where nothing reaches.
    """

    of: Sums
    filled: Sequence[NDArray]
    velocity: NDArray
    references: Sequence[NDArray]

    @property
    def moments(self) -> dict[str, NDArray]:
        """Moments at the nodes: arrays (phase, node, ...).

        Phase 0 is the bulk, the sum over groups. Nodes run fastest in memory, so that algebra on small tensors is a
        loop over nodes.
        """
        reference = np.where(np.isnan(self.velocity), 0.0, self.velocity)
        found = {"reference": np.ascontiguousarray(reference.T).T}
        for run, sums in zip(self.of.passes, self.filled, strict=True):
            found |= self._of_pass(run.layout, sums)
        return found

    def _of_pass(self, layout: Layout, records: NDArray) -> dict[str, NDArray]:
        nodes, phases = records.shape[1], self.of.spec.phases
        found = {}
        for name, part in layout.turned(records):
            if layout.groups > phases:  # by phase of the partner
                part = np.moveaxis(part.reshape(*part.shape[:-2], phases, -1, nodes), -2, 0)
            if self.of.spec.by is not None:
                bulk = sum(part[..., [k], :] for k in range(phases))  # in this order whatever the number of nodes
                part = np.concatenate([bulk, part], axis=-2)
            found[name] = part.transpose(part.ndim - 2, part.ndim - 1, *range(part.ndim - 2))
        return found


@dataclass(frozen=True, eq=False)
class Sums:
    """The sums of one frame, prepared: computed for one block of nodes after the other, in any order or at once.

    A node's sums have one order whatever the block, so that their bits are the same.
    """

    spec: DepositSpec
    passes: Sequence[Pass]

    def over(self, block: Any) -> BlockSums:
        """Compute the sums at the nodes of a `Block`: they are filled, or averages of its `inner` nodes that are."""
        nodes: NodeBlock = block.inner or block
        velocity = np.full((nodes.count, 3), np.nan)
        filled, references = [], []
        for run in self.passes:
            references.append(np.full_like(velocity, np.nan) if run.layout.apart else velocity)
            filled.append(np.zeros((run.layout.groups, nodes.count, run.layout.columns)))
            for fill in run.fill:
                fill(nodes, filled[-1], references[-1])
        found = BlockSums(self, filled, velocity, references)
        return block.averages(found) if block.inner else found


def sums_of_frame(
    frame: Frame, spec: DepositSpec, lattice: Lattice, scale: float, source: str, threads: int = 1
) -> Sums:
    """Prepare the sums of one frame.

    Parameters
    ----------
    frame : Frame
        One step of a scene.
    spec : DepositSpec
        What is wanted.
    lattice : Lattice
        Periodic images.
    scale : float
        1 / extent of the averaged axes (and thickness of a layer).
    source : str
        Names the step in messages.
    threads : int
        Threads that prepare passes.
    """
    step = StepRows(frame, spec, lattice, scale, source)
    for name in {name for row in spec.own.values() for name in row.variables}:
        check_finite(name, step.frame, source)  # variables of scenes were checked with their frame
    rows = spec.rows
    ways = [  # the calling thread begins with the last: contacts take more memory than grains
        (points.grains, spec.of_grains),
        (points.relative, {name for name, row in rows.items() if row.level and row.column}),
        (points.at_contacts, {name for name, row in rows.items() if row.at_contacts and not row.level}),
        (points.between_phases, rows.keys() & {"pair_force"}),
        (along_branches, {name for name, row in rows.items() if row.along_branches}),
        (points.slopes, rows.keys() & {"mass_slope", "momentum_slope"}),
        (points.at_walls, rows.keys() & {"traction"}),
    ]
    prepared = for_each([way for way, moments in ways if moments], lambda way: way(step), threads)
    return Sums(spec, [one for passes in prepared for one in passes])
