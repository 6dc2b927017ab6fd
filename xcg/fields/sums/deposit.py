"""Sums over grains and contacts at the nodes: from a frame to the passes that make them."""

from __future__ import annotations

from xcg.compiled.threads import for_each
from xcg.fields.sums import points
from xcg.fields.sums.passes import DepositSpec, Sums
from xcg.fields.sums.segments import along_branches
from xcg.fields.sums.step import StepRows
from xcg.scene.frame import check_finite
from xcg.scene.lattice import Lattice
from xcg.scene.schema import Frame


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
