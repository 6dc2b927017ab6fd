"""What grains and contacts give to the sums of `xcg.fields.formulas.rows.fabric`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from xcg.scene.contacts import Contacts
from xcg.scene.schema import Frame

Column = Callable[[Frame, Contacts | None], NDArray]
# Share of Coulomb's limit from which a contact slides: codes write forces with few digits.
AT_LIMIT = 0.999


def bearing(frame: Frame, contacts: Contacts | None) -> NDArray:
    """Return 1 for each grain that may bear load; (particles,)."""
    assert contacts is not None
    return contacts.bearing.astype(float)


def bearing_partners(frame: Frame, contacts: Contacts | None) -> NDArray:
    """Return number of partners of each grain that may bear load, else 0; (particles,)."""
    assert contacts is not None
    return np.where(contacts.bearing, contacts.partners, 0.0)


def one_a_contact(frame: Frame, contacts: Contacts | None) -> NDArray:
    """Return 1 for each contact; (n,)."""
    return np.ones(len(frame["contact_i"]))


def bearing_contacts(frame: Frame, contacts: Contacts | None) -> NDArray:
    """Return 1 for each contact between grains that may bear load; (n,)."""
    assert contacts is not None
    return contacts.between_bearing.astype(float)


def sliding_contacts(friction: float, frame: Frame, contacts: Contacts | None) -> NDArray:
    """Return 1 for each contact that slides, which has its tangential force at Coulomb's limit, else 0; (n,)."""
    assert contacts is not None
    tangential = np.linalg.norm(contacts.force - contacts.normal_force[:, None] * contacts.normal, axis=1)
    slides = (contacts.normal_force > 0) & (tangential >= AT_LIMIT * friction * contacts.normal_force)
    return (slides & contacts.between_bearing).astype(float)


def none_slides(frame: Frame, contacts: Contacts | None) -> NDArray:
    """Return 0 for each contact, as without friction it is not known which slide; (n,)."""
    return np.zeros(len(frame["contact_i"]))


def normal_force(frame: Frame, contacts: Contacts | None) -> NDArray:
    """Return normal force of each contact (N); (n,)."""
    assert contacts is not None
    return contacts.normal_force


def branch_length(frame: Frame, contacts: Contacts | None) -> NDArray:
    """Return length of each branch along the normal (m); (n,)."""
    assert contacts is not None
    return np.einsum("ni,ni->n", contacts.between, contacts.normal)


def normals(of: Column) -> Column:
    """Return the column of a number times n n: xx xy xz yy yz zz."""

    def column(frame: Frame, contacts: Contacts | None) -> NDArray:
        assert contacts is not None
        first, second = (contacts.normal[:, k] for k in np.triu_indices(3))
        return of(frame, contacts)[:, None] * first * second

    return column


def tangential_normals(frame: Frame, contacts: Contacts | None) -> NDArray:
    """Return tangential force times normal of each contact (N); (n, 3, 3)."""
    assert contacts is not None
    tangential = contacts.force - contacts.normal_force[:, None] * contacts.normal
    return tangential[:, :, None] * contacts.normal[:, None, :]


def strong_forces(frame: Frame, contacts: Contacts | None) -> NDArray:
    """Return the forces of strong contacts on both sides, zero for the others; (2, n, 3)."""
    assert contacts is not None
    force = np.where(contacts.strong[:, None], contacts.force, 0.0)
    return np.stack([force, -force])
