"""Parts of the pressure of one step, estimated from a sample of its grains and contacts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xcg.fields.plan import Plan
from xcg.scene.contacts import Contacts
from xcg.scene.frame import indices_of
from xcg.scene.lattice import Lattice
from xcg.scene.schema import COMPONENTS, Frame

_SLICES = 12  # along an axis
_HELD = 0.3  # share of the squared velocities that means of slices hold, of a flow that is no smooth one
_ROUNDING = 1e-12  # of the largest velocity: what is smaller is neither flow nor fluctuation
_SAMPLED = 2_000  # grains and contacts of a step from which its pressures are estimated


@dataclass(frozen=True, eq=False)
class Pressures:
    """Parts of the normal stresses xx, yy, zz of the sampled grains, times the volume (J).

    Attributes
    ----------
    kinetic, contact : array (3,)
        Of fluctuations, and of contacts.
    about_flow : array (3,)
        Of the fluctuations of all grains about the flow, such as waves of many grains.
    smeared : array (3,)
        Of the variation of the flow within the support of the kernel.
    averaged : dict
        Of the variation of the flow along each averaged axis.
    mass : float
        Of the sampled grains (kg).
    """

    kinetic: NDArray
    contact: NDArray
    about_flow: NDArray
    smeared: NDArray
    averaged: Mapping[str, NDArray]
    mass: float


def pressures_of(plan: Plan, frame: Frame, lattice: Lattice) -> Pressures:
    """Return the parts of the pressure of a step, from a sample of its grains and contacts.

    Fluctuations are those between grains in contact where there are many; else of all grains about
    the flow, as in a gas.
    """
    velocity = frame["velocity"]
    count = len(velocity)
    every = max(1, count // _SAMPLED)
    sample = {name: frame[name][::every] for name in ("position", "velocity", "mass")}
    mass = sample["mass"]
    flow, smeared, averaged = variation_of_flow(plan, sample, lattice)
    about_flow = mass @ (sample["velocity"] - flow) ** 2
    kinetic = about_flow
    contact = np.zeros(3)
    if "contact_i" in frame:
        contacts, rows = _sampled_contacts(frame, lattice)
        sides = (contacts.branch_i - contacts.branch_j) * contacts.force
        plane = list(plan.options.plane)
        contact[plane] = sides[:, plane].sum(axis=0) * rows / every
        pairs = (contacts.i >= 0) & (contacts.j >= 0)
        if 2 * rows * np.count_nonzero(pairs) > count:
            relative = _relative_velocities(contacts, velocity)[pairs]
            branch = contacts.between[pairs]
            # less the shear, which moves neighbours apart, too
            relative -= branch @ np.linalg.lstsq(branch, relative, rcond=None)[0]
            kinetic = (relative**2).mean(axis=0) * mass.sum() / 2
    least = mass.sum() * (_ROUNDING * np.abs(velocity).max()) ** 2
    return Pressures(
        kinetic * (kinetic > least),
        contact,
        about_flow * (about_flow > least),
        smeared * (smeared > least),
        {axis: part * (part > least) for axis, part in averaged.items()},
        float(mass.sum()),
    )


def _relative_velocities(contacts: Contacts, velocity: NDArray) -> NDArray:
    """Return the velocities (n, 3) of the images that touch, i less j (m s-1)."""
    apart = contacts.position[contacts.i] - contacts.position[contacts.j]
    of_image = contacts.lattice.drift(apart - contacts.between)
    return velocity[contacts.i] - velocity[contacts.j] - of_image


def _sampled_contacts(frame: Frame, lattice: Lattice) -> tuple[Contacts, int]:
    """Return every n-th contact of a step, and n."""
    rows = max(1, len(frame["contact_i"]) // _SAMPLED)
    key_i = frame["contact_i"][::rows]
    key_j = frame["contact_j"][::rows]
    point = frame["contact_point"][::rows]
    force = np.zeros_like(point)
    if "contact_force" in frame:
        force = frame["contact_force"][::rows]
    normal = None
    if "contact_normal" in frame:
        normal = frame["contact_normal"][::rows]
    # without the checks of `Contacts.of`, which the sums have made
    i = indices_of(frame["particle_id"], key_i)
    j = indices_of(frame["particle_id"], key_j)
    return Contacts(i, j, force, point, frame["position"], lattice, key_i, key_j, normal), rows


def spread_of_contacts(frame: Frame, lattice: Lattice) -> tuple[float, float]:
    """Return the standard deviation of the branch lengths over their mean, and that of tangential over normal forces.

    The latter is the root mean square of the tangential forces over the mean normal one. NaN without
    contacts or forces.
    """
    contacts, _ = _sampled_contacts(frame, lattice)
    if not len(contacts.i):
        return np.nan, np.nan
    length = np.einsum("ni,ni->n", contacts.between, contacts.normal)
    mean_force = contacts.normal_force.mean()
    tangential = np.nan
    if mean_force > 0:
        tangential = np.sqrt((contacts.tangential_force**2).sum(axis=1).mean()) / mean_force
    return float(length.std() / length.mean()), float(tangential)


def variation_of_flow(
    plan: Plan, frame: Frame, lattice: Lattice
) -> tuple[NDArray, NDArray, dict[str, NDArray]]:
    """Return the flow at the grains, and ``sum m (V_k - <V_k>)^2`` within supports and along averaged axes.

    The flow is a sum of cubic polynomials along each axis, and of means in slices where these hold
    much of the rest, as in jets and jumps. Of each part of V the noise of the fit is subtracted,
    from the squares and the squared derivatives of Legendre polynomials.
    """
    nodes = plan.nodes
    position = frame["position"]
    mass = frame["mass"]
    of_box = np.zeros_like(position)
    gradient = lattice.gradient_along(~nodes.active)
    if gradient is not None:
        of_box = (position - lattice.middle) @ gradient.T
    velocity = frame["velocity"] - of_box
    places = (position - position.mean(axis=0)).T
    spread = places.std(axis=1)
    places = places / np.where(spread > 0, spread, 1.0)[:, None]
    powers = [np.ones(len(mass))]
    for k in plan.options.plane:
        u = places[k]
        powers += [u, u * u, u * u * u]
    columns = np.stack(powers)
    weighted = mass * columns
    # normal equations: an orthogonal fit takes longer than the stress, and the columns are of one size
    terms = np.linalg.lstsq(weighted @ columns.T, weighted @ velocity, rcond=None)[0]
    flow = columns.T @ terms
    noise = mass @ (velocity - flow) ** 2 / max(len(mass), 1)
    smeared = np.zeros(3)
    averaged = {}
    variance = plan.kernel.second_moment(len(nodes.active_axes))
    for n, k in enumerate(plan.options.plane):
        first, second, third = terms[1 + 3 * n : 4 + 3 * n]
        u = places[k][:, None]
        along = first * u + second * (u * u) + third * (u * u * u)
        if COMPONENTS[k] in nodes.active_axes:
            slope = first + 2 * second * u + 3 * third * u * u
            line = np.mean(u * along, axis=0)  # u has the variance 1
            share = variance / spread[k] ** 2 if spread[k] > 0 else 0.0
            of_line = _beyond(mass.sum() * line**2, noise)  # the mean slope is less noisy
            smeared += share * np.maximum(of_line, _beyond(mass @ slope**2, 20 * noise))
        else:
            along -= along.mean(axis=0)
            averaged[COMPONENTS[k]] = _beyond(mass @ along**2, 3 * noise)
    for k in plan.options.plane:
        part, of_slopes = _in_slices(frame["position"][:, k], velocity - flow, mass, noise)
        flow = flow + part
        if COMPONENTS[k] in nodes.active_axes:
            smeared += variance * of_slopes
        else:
            averaged[COMPONENTS[k]] = averaged[COMPONENTS[k]] + mass @ part**2
    return flow + of_box, smeared, averaged


def _in_slices(
    x: NDArray, velocity: NDArray, mass: NDArray, noise: NDArray
) -> tuple[NDArray, NDArray]:
    """Return mean velocities (n, 3) of the slices that grains are in, and the sum of m times their squared slopes.

    Zero in components of which the means hold little, so that waves of a gas stay fluctuations.
    """
    extent = float(np.ptp(x))
    if not extent > 0:
        return np.zeros_like(velocity), np.zeros(3)
    row = np.minimum((_SLICES * (x - x.min()) / extent).astype(int), _SLICES - 1)
    total = np.bincount(row, mass, _SLICES)
    sums = np.stack([np.bincount(row, mass * v, _SLICES) for v in velocity.T], axis=1)
    means = sums / np.where(total > 0, total, 1.0)[:, None]
    of_means = total @ means**2
    scatter = (_SLICES + 6 * np.sqrt(2 * _SLICES)) * noise
    holds = of_means > np.maximum(_HELD * (mass @ velocity**2), scatter)
    means = np.where(holds, means, 0.0)
    slopes = np.diff(means, axis=0) * _SLICES / extent
    weights = (total[1:] + total[:-1]) / 2
    return means[row], weights @ slopes**2


def _beyond(total: NDArray, noise: NDArray) -> NDArray:
    """Return sums of squares less their noise; 0 unless they are well beyond the scatter of that noise."""
    return np.where(total < 9 * noise, 0.0, total - noise)
