"""Warnings about implausible scenes: sizes, positions, boxes, densities and times that contradict each other.

Checks look at samples of the grains, so that they take no noticeable time.
"""

from __future__ import annotations

import numpy as np

from xcg.common.messages import warn_user
from xcg.scene.frame import indices_of
from xcg.scene.lattice import Lattice
from xcg.scene.sanity_lengths import OF_LENGTHS
from xcg.scene.sanity_masses import OF_ARGUMENTS, OF_MASSES
from xcg.scene.sanity_sample import FEW, Particles, sample_of
from xcg.scene.schema import Frame, Setup

_WRONG_TIME = 5.0  # displacements over those that follow from velocities
_ALIKE = 0.9  # correlation of both, so that velocities hardly changed in between


def check_scene(frame: Frame, setup: Setup, lattice: Lattice, *, is_volume: bool = False) -> None:
    """Warn if sizes, positions, box, masses or densities contradict each other, or `density=` is not used.

    Only the first message about lengths is given, as others follow from the same mistake.

    Parameters
    ----------
    frame : Frame
        Particles of one step, completed.
    setup : Setup
        Arguments of the scene.
    lattice : Lattice
        Box and periodic axes of this step.
    is_volume : bool
        Whether the scene was named three-dimensional, or found to be so.
    """
    grains = Particles(frame, setup, lattice, is_volume)
    if not grains.count:
        return
    for checks in (OF_LENGTHS, OF_MASSES, OF_ARGUMENTS):
        for check in checks:
            message = check(grains)
            if message:
                warn_user(message)
                break


def check_motion(first: Frame, second: Frame, lapse: float, lattice: Lattice) -> None:
    """Warn if displacements are a multiple of velocities times the time between two steps.

    Silent unless both are alike in direction and size but for a factor, as other motion in between
    makes displacements independent of velocities.

    Parameters
    ----------
    first, second : Frame
        Particles of two steps that follow each other, completed.
    lapse : float
        Time between them (s).
    lattice : Lattice
        Periodic images of the first step.
    """
    if not {"velocity", "particle_id"} <= set(first) & set(second):
        return
    some = sample_of(len(first["position"]))
    indices = indices_of(second["particle_id"], first["particle_id"][some])
    before = {name: values[some][indices >= 0] for name, values in first.items()}
    after = {name: values[indices[indices >= 0]] for name, values in second.items()}
    if len(after["position"]) < FEW:
        return
    moved = after["position"] - before["position"]
    expected = 0.5 * lapse * (before["velocity"] + after["velocity"])
    if "image" in before and "image" in after and len(lattice.periodic_vectors):
        moved += (after["image"] - before["image"])[:, lattice.axes] @ lattice.periodic_vectors
    elif len(lattice.periodic_vectors):
        # whole periods are unknown, and motion by more than half of one has no direction
        moved = lattice.shortest(moved)
        periods = lattice.period
        if lattice.vectors is not None:
            periods = np.full(3, np.linalg.norm(lattice.periodic_vectors, axis=1).min())
        has_direction = np.abs(expected).max(axis=0) < 0.5 * periods
        moved = moved[:, has_direction]
        expected = expected[:, has_direction]
    along = float((moved * expected).sum())
    of_velocities = float((expected**2).sum())
    of_positions = float((moved**2).sum())
    if not along > _ALIKE * np.sqrt(of_velocities * of_positions):
        return
    factor = along / of_velocities
    if 1 / _WRONG_TIME <= factor <= _WRONG_TIME:
        return
    warn_user(
        f"grains move {factor:.3g} times their velocity times the time between the first two steps "
        f"({lapse:.4g}): times or velocities are in another unit. timestep= is the time of one step of the "
        "simulation, not of the interval between two outputs"
    )
