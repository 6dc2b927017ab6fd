"""Contacts of one step: checks against its particles, and contact points that follow from spheres."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from xcg.common.messages import SceneError
from xcg.scene.contact_points import REPEAT, touching_points_of
from xcg.scene.frame import indices_of
from xcg.scene.gaps import are_single_spheres, warn_of_gaps
from xcg.scene.lattice import Lattice, unit_vectors
from xcg.scene.normals import checked_normals
from xcg.scene.repeats import without_repeats
from xcg.scene.schema import Frame, Setup
from xcg.scene.spheres import SphereContacts, are_spheres
from xcg.scene.typed import check_rows, typed_arrays

# What readers say of contacts besides variables of the scene.
HINTS = ("wrapped_branch", "point_is_middle", "row_of_file")


def complete_contacts(
    frame: Mapping[str, ArrayLike],
    particles: Frame,
    lattice: Lattice,
    setup: Setup,
    source: str,
    *,
    allow_unknown: bool = False,
    columns: Mapping[str, str] | None = None,
) -> Frame:
    """Check the contacts of one frame against its particles and derive contact points that are not given.

    For spheres the contact point lies on the branch at ``R_i - overlap/2`` from the centre of i,
    with ``overlap = R_i + R_j - |r_i - r_j|`` and ``r_i - r_j`` the image nearest to the branch
    that the data hold, or else the shortest one.

    Contacts that are listed again are taken once, see `xcg.scene.repeats.without_repeats`. Between
    spheres, pairs without a force and with a gap are dropped, overlaps that are another quantity
    are replaced, contact points midway between the centres are moved, and normals of another length
    or sign are scaled or turned, each with a warning, see `xcg.scene.spheres` and
    `xcg.scene.normals`. Forces across gaps are warned of, see `xcg.scene.gaps`.

    Parameters
    ----------
    frame : mapping
        Arrays by scene name, at least ``contact_i``, ``contact_j`` (n,) and ``contact_force`` (n,
        3). ``contact_branch`` (n, 3), from j to i as the code saw it, selects the images.
        ``wrapped_branch`` (n, 3), from j, or the wall, to i, but of any image, becomes the normal.
        Where ``point_is_middle`` (n,) is true, ``contact_point`` is the middle of the centres of
        two spheres, and becomes the point where they touch. Messages count rows by ``row_of_file``
        (n,), where rows were joined or reordered.
    particles : Frame
        The particles of the same step, completed.
    lattice : Lattice
        Periodic images, in the scene's units.
    allow_unknown : bool
        Take contacts with ids that are not among the particles as contacts with a wall.
    columns : mapping, optional
        Columns of the file by variable, for messages.

    Raises
    ------
    SceneError
        For unknown ids, a particle in contact with itself, values that are not finite, a contact
        point that is missing and cannot be derived, as in a box so small that grains touch on both
        sides, a contact that is listed from both sides with the same force, or normals across the
        lines of centres of spheres.
    """
    typed = typed_arrays(
        {name: values for name, values in frame.items() if name not in HINTS}, setup, source
    )
    if "wrapped_branch" in frame and "contact_normal" not in typed:
        branch = np.asarray(frame["wrapped_branch"]) * setup.scales[0]
        typed["contact_normal"] = unit_vectors(lattice.shortest(branch))
    missing = [name for name in ("contact_i", "contact_j", "contact_force") if name not in typed]
    if missing:
        raise SceneError(
            f"{source}: contacts lack {', '.join(missing)}; pass {missing[0]}=, or map columns by names="
        )
    check_rows(typed, "contact", source)
    data_branch = typed.pop("contact_branch", None)
    count = len(typed["contact_i"])
    number = np.asarray(frame.get("row_of_file", np.arange(count)))
    index_i, index_j = _partners(
        typed, number, particles["particle_id"], source, allow_unknown=allow_unknown
    )
    derived = np.asarray(frame.get("point_is_middle", np.full(count, "contact_point" not in typed)))
    spheres = SphereContacts(
        typed, number, particles, index_i, index_j, data_branch, lattice, source
    )
    if are_spheres(particles):
        dropped = spheres.without_contact()
        if dropped.size:  # all else depends on the rows
            kept = {
                name: np.delete(np.asarray(values), dropped, axis=0)
                for name, values in {**frame, "row_of_file": number}.items()
            }
            return complete_contacts(
                kept,
                particles,
                lattice,
                setup,
                source,
                allow_unknown=allow_unknown,
                columns=columns,
            )
        typed |= _checked_geometry(spheres, frame, columns or {}, setup.shape)
        if "contact_point" in typed and "point_is_middle" not in frame:
            spheres.warn_of_coincident_centres()
            if spheres.points_are_middles():
                derived = (index_i >= 0) & (index_j >= 0)
            else:
                spheres.warn_of_points_elsewhere()
    if derived.any() or "contact_point" not in typed:
        typed["contact_point"] = touching_points_of(spheres, derived)
    del spheres, index_i, index_j, derived
    return without_repeats(typed, number, particles, lattice, setup.sides, source)


def _partners(
    typed: Frame, number: NDArray, ids: NDArray, source: str, *, allow_unknown: bool
) -> tuple[NDArray, NDArray]:
    """Return the indices (n,) of both partners among sorted ids, negative for walls and unknown partners.

    Raises
    ------
    SceneError
        If a particle touches itself, i is a wall, or an id is unknown, unless that is allowed.
    """
    i, j = typed["contact_i"], typed["contact_j"]
    index_i, index_j = indices_of(ids, i), indices_of(ids, j)
    self_contact = np.flatnonzero(i == j)
    if self_contact.size:
        index = self_contact[0]
        raise SceneError(
            f"{source}: contact row {number[index]} joins particle {i[index]} with itself; drop such rows. If it "
            f"touches its own image, {REPEAT}"
        )
    if (i < 0).any():
        index = int(np.flatnonzero(i < 0)[0])
        raise SceneError(
            f"{source}: contact row {number[index]} has id {i[index]} as 'contact_i'; a wall must stand as 'contact_j'"
        )
    unknown = index_j < 0
    unknown &= j >= 0
    unknown |= index_i < 0
    if unknown.any() and not allow_unknown:
        index = int(np.flatnonzero(unknown)[0])
        name = "contact_i" if index_i[index] < 0 else "contact_j"
        raise SceneError(
            f"{source}: contact row {number[index]} has {name}={typed[name][index]}, and no particle has this id "
            f"({int(unknown.sum())} such rows); check that particles and contacts are of the same step, or pass "
            "allow_unknown=True to treat unknown partners as walls"
        )
    return index_i, index_j


def _checked_geometry(
    spheres: SphereContacts,
    frame: Mapping[str, ArrayLike],
    columns: Mapping[str, str],
    shape: str,
) -> Frame:
    """Return the normals and overlaps that the data hold, compared with positions and radii."""
    checked = Frame()
    if are_single_spheres(spheres.particles, shape):
        # points in another unit have a warning of their own, and lead to other images
        if "point_is_middle" in frame or spheres.unit_of_points is None:
            warn_of_gaps(spheres)
        if "contact_normal" in frame:
            checked["contact_normal"] = checked_normals(spheres)
    if "overlap" in frame:
        checked["overlap"] = spheres.checked_overlaps(columns.get("overlap", "overlap"))
    return checked
