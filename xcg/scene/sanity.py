"""Warnings about implausible input: attractive contacts, distant contact points, discs read as spheres."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import warn_once, warn_user
from xcg.compiled.contacts import far_and_pulling
from xcg.scene.lattice import Lattice
from xcg.scene.repeats import rows_of
from xcg.scene.schema import Frame, Setup

SAMPLE = 4096  # rows looked at, spread over all
_FAR = 3.0  # diameters from a centre to a contact point; the ends of rods are as far that are 18 times as long as wide
_FEW = 20  # contacts that are too few to tell a wrong sign by
_MOST = 0.9  # share of contacts that pull
_CENTRAL = 1e-2  # sine of the angle between forces and branches, from positions of six digits
_OFF = 0.1  # largest distance of the ends in a file from the centres, in branches

_SAME = 2e-3  # scatter of masses over d^2, from sizes and masses of four digits
_VARIED = 0.02  # scatter of diameters that tells d^2 from d^3


def check_shape(frame: Frame, setup: Setup) -> None:
    """Warn where grains are taken for spheres, and their masses are those of discs.

    Parameters
    ----------
    frame : Frame
        Particles of one step, completed.
    setup : Setup
        Arguments of the scene.
    """
    if setup.shape != "sphere" or not {"mass", "diameter", "volume"} <= set(frame):
        return
    some = _sample(len(frame["position"]))
    d, mass, volume = (np.asarray(frame[name][some], float) for name in ("diameter", "mass", "volume"))
    if (
        len(d) < _FEW
        or np.std(d) < _VARIED * np.mean(d)
        or not np.allclose(volume, np.pi / 6 * d**3, rtol=1e-6, atol=0)
    ):
        return
    if np.std(mass / d**2) < _SAME * np.mean(mass / d**2):
        warn_user(
            "masses go with the square of the diameter, as those of discs, and volumes and densities are taken to be "
            "those of spheres: give shape='disc' and thickness=" + (" and dimension=2" if setup.dimension == 3 else "")
        )


def _every(rows: int) -> int:
    return max(1, rows // SAMPLE)


def _sample(rows: int) -> slice:
    return slice(None, None, _every(rows))


def check_contacts(frame: Frame, row_i: NDArray, row_j: NDArray, lattice: Lattice, source: str) -> None:
    """Warn of contact points far from the centres of their grains, and of contacts that pull nearly throughout.

    Parameters
    ----------
    frame : Frame
        Particles and contacts of one step.
    row_i, row_j : array (contacts,)
        Rows of the partners among the particles, negative where they are not there.
    lattice : Lattice
        Periodic images.
    source : str
        Names the step.
    """
    if not len(frame["position"]) or not len(row_i):
        return
    every = _every(len(row_i))
    looked = len(range(0, len(row_i), every))
    of_frame = (frame.get("diameter"), frame["contact_point"], frame.get("contact_force"))
    rows = row_i, row_j, every, frame["position"]
    far, first, farthest, pulling, pushing = far_and_pulling(*rows, *of_frame, *lattice.for_loops, _FAR)
    if far:
        i, j = frame["contact_i"][first], frame["contact_j"][first]
        warn_once(
            "far contacts",
            f"{source}: {far} of {looked} contacts looked at lie more than {_FAR:g} diameters from the "
            f"centre of a particle of theirs ({farthest:.3g} diameters for contact_i={i}, contact_j={j}): "
            "they are of another step or box, ids are mixed up, or positions were changed without contact_point",
        )
    elif pulling + pushing >= _FEW and pulling > _MOST * (pulling + pushing):
        warn_once(
            "tension",
            f"{source}: {pulling} of {pulling + pushing} contacts looked at pull their particles together, so that "
            "pressure is negative nearly everywhere: contact_force is the force on contact_i, and where the data have "
            "that on the other, exchange the two (names=), or change the sign",
        )


def is_central(contacts: Frame, particles: Frame, lattice: Lattice) -> bool:
    """Whether all forces between particles lie along the line of their centres; False for few contacts."""
    some = _sample(len(contacts["contact_i"]))
    i, j = (rows_of(particles["particle_id"], contacts[name][some]) for name in ("contact_i", "contact_j"))
    pairs = (i >= 0) & (j >= 0)
    branch = lattice.shortest(particles["position"][i[pairs]] - particles["position"][j[pairs]])
    force = contacts["contact_force"][some][pairs]
    across = _lengths(np.cross(branch, force))
    return len(force) >= _FEW and bool((across <= _CENTRAL * _lengths(branch) * _lengths(force)).all())


def check_ends(raw: Frame, particles: Frame, lattice: Lattice, source: str) -> None:
    """Warn where the ends that a file of contacts holds are not the positions of the particles.

    Parameters
    ----------
    raw : Frame
        Contacts with ``wrapped_branch``, from j to i by the ends in the file (m), of any image.
    particles : Frame
        The particles of the same step.
    lattice : Lattice
        Periodic images.
    source : str
        Names the step.
    """
    some = _sample(len(raw["contact_i"]))
    row_i, row_j = (
        rows_of(particles["particle_id"], np.asarray(raw[name][some], "int64")) for name in ("contact_i", "contact_j")
    )
    pairs = np.flatnonzero((row_i >= 0) & (row_j >= 0))
    ends = lattice.shortest(raw["wrapped_branch"][some][pairs])
    centres = particles["position"][row_i[pairs]] - particles["position"][row_j[pairs]]
    off = np.flatnonzero(_lengths(lattice.shortest(ends - centres)) > _OFF * _lengths(ends))
    if off.size:
        first = off[0]
        i, j = (int(raw[name][some][pairs[first]]) for name in ("contact_i", "contact_j"))
        warn_once(
            "ends",
            f"{source}: the ends of {off.size} of {len(pairs)} contacts looked at are not the positions of their "
            f"particles (contact_i={i}, contact_j={j}: {ends[first]} from end to end, "
            f"{lattice.shortest(centres)[first]} from centre to centre): particles and contacts are of different "
            "steps or runs, columns are not in the order expected, or the box is another",
        )


def _lengths(vectors: NDArray) -> NDArray:
    return np.sqrt(np.einsum("ij,ij->i", vectors, vectors))
