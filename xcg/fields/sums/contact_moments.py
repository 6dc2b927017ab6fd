"""Columns of moments made of contacts: fabric, and moments, powers and energies of rotation."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from xcg.scene.contacts import Contacts
from xcg.scene.schema import Frame

Column = Callable[[Frame, Contacts], NDArray]
# Share of Coulomb's limit from which a contact slides: codes write forces with few digits.
AT_LIMIT = 0.999


def bearing(frame: Frame, contacts: Contacts) -> NDArray:
    """Return 1 for each grain that may bear load; (particles,)."""
    return contacts.bearing.astype(float)


def bearing_partners(frame: Frame, contacts: Contacts) -> NDArray:
    """Return number of partners of each grain that may bear load, else 0; (particles,)."""
    return np.where(contacts.bearing, contacts.partners, 0.0)


def one_a_contact(frame: Frame, contacts: Contacts) -> NDArray:
    """Return 1 for each contact; (n,)."""
    return np.ones(len(frame["contact_i"]))


def bearing_contacts(frame: Frame, contacts: Contacts) -> NDArray:
    """Return 1 for each contact between grains that may bear load; (n,)."""
    return contacts.between_bearing.astype(float)


def sliding_contacts(friction: float, frame: Frame, contacts: Contacts) -> NDArray:
    """Return 1 for each contact that slides, which has its tangential force at Coulomb's limit, else 0; (n,)."""
    tangential = np.linalg.norm(contacts.tangential_force, axis=1)
    slides = (contacts.normal_force > 0) & (tangential >= AT_LIMIT * friction * contacts.normal_force)
    return (slides & contacts.between_bearing).astype(float)


def none_slides(frame: Frame, contacts: Contacts) -> NDArray:
    """Return 0 for each contact, as without friction it is not known which slide; (n,)."""
    return np.zeros(len(frame["contact_i"]))


def normal_force(frame: Frame, contacts: Contacts) -> NDArray:
    """Return normal force of each contact (N); (n,)."""
    return contacts.normal_force


def branch_length(frame: Frame, contacts: Contacts) -> NDArray:
    """Return length of each branch along the normal (m); (n,)."""
    return np.einsum("ni,ni->n", contacts.between, contacts.normal)


def normals(of: Column) -> Column:
    """Return the column of a number times n n: xx xy xz yy yz zz."""

    def column(frame: Frame, contacts: Contacts) -> NDArray:
        first, second = (contacts.normal[:, k] for k in np.triu_indices(3))
        return of(frame, contacts)[:, None] * first * second

    return column


def tangential_normals(frame: Frame, contacts: Contacts) -> NDArray:
    """Return tangential force times normal of each contact (N); (n, 3, 3)."""
    tangential = contacts.tangential_force
    return tangential[:, :, None] * contacts.normal[:, None, :]


def strong_forces(frame: Frame, contacts: Contacts) -> NDArray:
    """Return the forces of strong contacts on both sides, zero for the others; (2, n, 3)."""
    force = np.where(contacts.strong[:, None], contacts.force, 0.0)
    return np.stack([force, -force])


WALL_VELOCITY = "contact_wall_velocity"


def _dot(a: NDArray, b: NDArray) -> NDArray:
    """Return a_k b_k of each row."""
    return np.einsum("ij,ij->i", a, b)


def surface_velocities(frame: Frame, contacts: Contacts, *, of_images: bool = False) -> tuple[NDArray, NDArray]:
    """Velocities of the surfaces of i and j at the contact points (m s-1), (n, 3) each.

    Walls have `WALL_VELOCITY` of the frame, or zero. In a sheared box velocities belong to the particles as
    they are written, or to the images that touch at the point.
    """
    found = []
    for row, branch in ((contacts.i, contacts.branch_i), (contacts.j, contacts.branch_j)):
        there, u = row >= 0, frame.get(WALL_VELOCITY, np.zeros((len(row), 3))).copy()
        u[there] = frame["velocity"][row[there]]
        if "angular_velocity" in frame:
            u[there] += np.cross(branch[there], frame["angular_velocity"][row[there]])
        if of_images:
            u[there] += contacts.lattice.drift((contacts.point + branch)[there] - frame["position"][row[there]])
        found.append(u)
    return found[0], found[1]


def velocities_of_walls(frame: Frame, free: Contacts, source: str) -> NDArray:
    """Velocities (n, 3) of the surfaces that act as walls on the free grains: of grains held in place, or as given."""
    every = Contacts.of(frame, free.lattice, source)
    u_i, u_j = surface_velocities(frame, every, of_images=True)
    return np.where((free.i < 0)[:, None], u_i, u_j)


def torques(frame: Frame, c: Contacts) -> NDArray:
    """Torque of the contact forces on each particle about its centre, sum of b x f (N m); (particles, 3)."""
    return c.sum_over_particles(np.cross(c.force, c.branch_i), np.cross(c.force, c.branch_j), -1.0)


def powers(frame: Frame, c: Contacts) -> NDArray:
    """Power of the contact forces on each particle, sum of f.u = F.v + T.omega (W); (particles,)."""
    u_i, u_j = surface_velocities(frame, c)
    return c.sum_over_particles(_dot(c.force, u_i), _dot(c.force, u_j), -1.0)


def couples(frame: Frame, c: Contacts) -> NDArray:
    """Couple of both forces of each contact, (b_i - b_j) x f (N m); of one force at walls; (contacts, 3)."""
    return np.cross(c.force, c.branch_i - c.branch_j)


def taken_up(frame: Frame, c: Contacts) -> NDArray:
    """Power that each contact takes up, -f.(u_i - u_j) (W); (contacts,)."""
    u_i, u_j = surface_velocities(frame, c, of_images=True)
    return -_dot(c.force, u_i - u_j)


def of_walls(frame: Frame, c: Contacts) -> NDArray:
    """Power of the wall in each contact with one, f.u of the wall's velocity (W), else zero; (contacts,)."""
    u_i, u_j = surface_velocities(frame, c, of_images=True)
    return np.where(c.j < 0, _dot(c.force, u_j), 0.0) - np.where(c.i < 0, _dot(c.force, u_i), 0.0)


def torque_of_sides(frame: Frame, c: Contacts) -> NDArray:
    """Torque b x f of each side of each contact (N m); (2, contacts, 3)."""
    return np.stack([np.cross(c.force, c.branch_i), -np.cross(c.force, c.branch_j)])


def power_of_sides(frame: Frame, c: Contacts) -> NDArray:
    """Power f.u of each side of each contact (W), as the first of three components; (2, contacts, 3)."""
    u_i, u_j = surface_velocities(frame, c)
    out = np.zeros((2, len(c.force), 3))
    out[0, :, 0], out[1, :, 0] = _dot(c.force, u_i), -_dot(c.force, u_j)
    return out


def energies(frame: Frame, contacts: Contacts) -> NDArray:
    """Kinetic energy of each particle, (m v^2 + I omega^2) / 2 (J); (particles,)."""
    v = frame["velocity"]
    return 0.5 * frame["mass"] * _dot(v, v) + rotational_energies(frame, contacts)


def rotational_energies(frame: Frame, _: Contacts) -> NDArray:
    """Energy of rotation of each particle, I omega^2 / 2 (J); zero without angular velocities; (particles,)."""
    if not {"angular_velocity", "moment_of_inertia"} <= set(frame):
        return np.zeros(len(frame["position"]))
    omega = frame["angular_velocity"]
    return 0.5 * frame["moment_of_inertia"] * _dot(omega, omega)


def energy_fluxes(frame: Frame, contacts: Contacts) -> NDArray:
    """Kinetic energy times velocity of each particle (W m); (particles, 3)."""
    return energies(frame, contacts)[:, None] * frame["velocity"]


def rotational_energy_fluxes(frame: Frame, contacts: Contacts) -> NDArray:
    """Energy of rotation times velocity of each particle (W m); (particles, 3)."""
    return rotational_energies(frame, contacts)[:, None] * frame["velocity"]


def spins(frame: Frame, _: Contacts) -> NDArray:
    """Spin I omega of each particle (N m s); (particles, 3)."""
    return frame["moment_of_inertia"][:, None] * frame["angular_velocity"]


def spin_fluxes(frame: Frame, contacts: Contacts) -> NDArray:
    """Spin times velocity of each particle, I omega v (N m2); (particles, 3, 3)."""
    return spins(frame, contacts)[:, :, None] * frame["velocity"][:, None, :]


def weighted_rotation(frame: Frame, _: Contacts) -> NDArray:
    """Moment of inertia and angular velocity of each particle; (particles, 4)."""
    return np.column_stack([frame["moment_of_inertia"], frame["angular_velocity"]])


def weighted_motion(frame: Frame, _: Contacts) -> NDArray:
    """Mass and velocity of each particle; (particles, 4)."""
    return np.column_stack([frame["mass"], frame["velocity"]])
