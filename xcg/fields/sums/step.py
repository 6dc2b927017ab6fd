"""One step as its passes take it: its rows, their images, and the nodes and kernels of its box in each cutoff."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import warn_once
from xcg.compiled.arrays import bounds_of
from xcg.compiled.points import SQUARED
from xcg.compiled.reach import spatial_order
from xcg.fields.sums.contact_moments import WALL_VELOCITY, velocities_of_walls
from xcg.fields.sums.moments import Moment
from xcg.fields.sums.passes import AnyKernel, DepositSpec
from xcg.fields.sums.reach import Mesh
from xcg.scene.contacts import Contacts
from xcg.scene.frame import phase_of, without_frozen
from xcg.scene.lattice import Lattice
from xcg.scene.schema import Frame

_HIDDEN_SHEAR = (
    "the box is sheared across an axis that is averaged, and {names} take velocities at contacts as they are written, "
    "so that they depend on how grains are wrapped; resolve that axis"
)
_AT_ONE_PLACE = "taken_up"  # relative velocities, which are those of the images that touch


@dataclass(frozen=True, eq=False)
class Images:
    """Where rows of the data stand.

    Periodic images along axes are found node by node. In boxes that are tilted, or whose images move, each image is a
    place of its own.

    Attributes
    ----------
    position : array (m, 3)
    order : array (m,)
        Their order in space.
    row : array (m,) or None
        Row of each; None where that is the place's own number.
    drift : array (m, 3) or None
        How fast each moves relative to the row's velocity (m/s); None where none does.
    """

    position: NDArray
    order: NDArray
    row: NDArray | None = None
    drift: NDArray | None = None

    def of(self, values: NDArray) -> NDArray:
        """Values (m, ...) at the places from those of the rows."""
        return values if self.row is None else values[self.row]


class StepRows:
    """One frame, what is wanted of it, and what several passes share.

    Attributes
    ----------
    frame : Frame
        Variables of the step, without frozen grains.
    spec : DepositSpec
    position, velocity, mass, phase : array (n, 3), (n, 3), (n,), (n,)
    contacts : Contacts, optional
    lattice : Lattice
        Periodic images, as seen along the axes of the nodes.
    meshes : dict
        Nodes and what surrounds them, by cutoff, in cutoffs.
    kernels : dict
        The kernel by cutoff, times `scale`, which divides by the extent of averaged axes.
    grains : Images

    Raises
    ------
    SceneError
        If the box is too small, or has no images as seen along some axes.
    """

    def __init__(self, frame: Frame, spec: DepositSpec, lattice: Lattice, scale: float, source: str) -> None:
        self.frame = without_frozen(frame)
        if not len(self.frame["position"]):
            frame = self.frame = {name: values[:0] for name, values in self.frame.items()}  # nor contacts of theirs
        self.spec, self.source = spec, source
        self.position = np.ascontiguousarray(self.frame["position"])
        self.count = len(self.position)
        self.phase = phase_of(self.frame, spec.by, spec.groups, source)
        self.contacts = Contacts.of(self.frame, lattice, source) if "contact_i" in self.frame else None
        if self.contacts and spec.takes(WALL_VELOCITY) and "frozen" in frame:
            self.frame[WALL_VELOCITY] = velocities_of_walls(frame, self.contacts, source)
        velocity, mass = self.frame.get("velocity"), self.frame.get("mass")
        self.velocity = np.zeros((self.count, 3)) if velocity is None else np.ascontiguousarray(velocity)
        self.mass = np.ones(self.count) if mass is None else np.ascontiguousarray(mass)
        self.lattice = replace(lattice.seen(spec.grid.active, source), edges=None)  # which are a part of the scene
        self.meshes = {cutoff: Mesh.of(spec.grid, self.lattice.period, cutoff) for cutoff in spec.distinct}
        self.kernels, seen = dict[float, AnyKernel](), int(spec.grid.active.sum())
        for cutoff, mesh in self.meshes.items():
            if cutoff in (spec.distinct[0], spec.distinct[-1]):
                mesh.check_reach(mesh.reach, source, paired=spec.level >= SQUARED)
            norm = spec.weights.norm * (spec.cutoffs[0] / cutoff) ** seen
            self.kernels[cutoff] = spec.weights._replace(norm=norm * scale)
        self.of_grains = self._without_hidden_shear(lattice)
        self.grains = self.images(self.position)

    def _without_hidden_shear(self, lattice: Lattice) -> Frame:
        """Return the frame with velocities relative to the motion that a sheared box imposes along averaged axes.

        They are those in the middle of the box, for every image of a grain, as images along these axes are one.
        """
        gradient = lattice.gradient_along(~self.spec.grid.active)
        if gradient is None:
            return self.frame
        rows = self.spec.rows.items()
        names = [name for name, row in rows if row.contacts and "velocity" in row.variables and name != _AT_ONE_PLACE]
        if names:
            warn_once("hidden shear", f"{self.source}: {_HIDDEN_SHEAR.format(names=', '.join(names))}")
        self.velocity = self.velocity - (self.position - lattice.middle) @ gradient.T
        of_box = np.broadcast_to(gradient, (self.count, 3, 3))
        return {**self.frame, "velocity": self.velocity, "box_gradient": of_box}

    def images(self, position: NDArray) -> Images:
        """Where rows of the data stand: at these positions, and where a box is tilted at all images near the mesh."""
        if self.lattice.vectors is None:
            return Images(position, self.in_space(position))
        row, shift, drift = self.near_mesh(position, self.spec.distinct[-1])
        position = position[row] + shift
        return Images(position, self.in_space(position), row, drift if drift.any() else None)

    def near_mesh(self, position: NDArray, reach: float) -> tuple[NDArray, NDArray, NDArray]:
        """Images of positions no further than `reach` (m) from the nodes, see `Lattice.images`."""
        first, last = self.spec.grid.lower, self.spec.grid.upper
        active = self.spec.grid.active
        low, high = np.where(active, first - reach, -np.inf), np.where(active, last + reach, np.inf)
        return self.lattice.images(position, low, high, self.source)

    def translations(self, cutoff: float) -> NDArray | None:
        """Return translations (m, 3), in cutoffs, between images of a grain that reach one node; None where none do."""
        both_seen = 2.0 + 2.0 * float(np.linalg.norm(self.meshes[cutoff].half))
        found = self.lattice.scaled(cutoff).translations(both_seen, self.source)
        return found if len(found) else None

    def column(self, row: Moment, at: Images, contact: NDArray | None = None) -> NDArray:
        """Columns (n, q) of a moment: its values at the grains, or of the contacts that stand at places."""
        assert row.column is not None
        which = at.row if contact is None else contact
        frame = self.frame if row.contacts else self.of_grains
        values = row.column(frame, self.contacts)
        values = (values if which is None else values[which]).reshape(len(at.position), math.prod(values.shape[1:]))
        if at.drift is not None and which is not None and "velocity" in row.variables:
            # images that move alike take one call, as a grain's value may be a sum over its contacts
            for drift, here in alike(at.drift):
                found = row.column(frame | {"velocity": frame["velocity"] + drift}, self.contacts)
                values[here] = found[which[here]].reshape(-1, values.shape[1])
        return values

    def moving(self, drift: NDArray) -> Frame:
        """Give all grains another velocity more: the frame as it is in images that drift."""
        return self.frame | {"velocity": self.frame["velocity"] + drift}

    @property
    def flow(self) -> tuple[NDArray, NDArray]:
        """Velocity (n, 3) and mass (n,) of the grains and their images."""
        velocity = self.grains.of(self.velocity)
        return velocity if self.grains.drift is None else velocity + self.grains.drift, self.grains.of(self.mass)

    @cached_property
    def contact_points(self) -> tuple[Images, NDArray, NDArray, NDArray]:
        """Where contacts are, the phase of each place, its share in the contact, and the row of that; (n,).

        A contact between two phases is half one's and half the other's, so that phases add up to the bulk.
        """
        c = self.contacts
        assert c is not None
        first = np.flatnonzero(c.first_row >= 0)
        mixed = (c.i >= 0) & (c.j >= 0) & (self.phase[c.i] != self.phase[c.j])
        contact = np.concatenate([first, np.flatnonzero(mixed)])
        phase = np.concatenate([self.phase[c.first_row[first]], self.phase[c.j[mixed]]])
        images, share = self.images(c.point[contact]), np.where(mixed[contact], 0.5, 1.0)
        return images, images.of(phase), images.of(share), images.of(contact)

    def in_space(self, position: NDArray) -> NDArray:
        """Order in space, so that neighbours add to the same nodes while these are in cache."""
        if not len(position):
            return np.zeros(0, "int64")
        lower, upper = bounds_of(position)
        farthest = [max(abs(a - o), abs(b - o)) for a, b, o in zip(lower, upper, self.spec.origin, strict=True)]
        for cutoff in {self.spec.distinct[0], self.spec.distinct[-1]}:
            self.meshes[cutoff].check_far([x / cutoff + 2.0 for x in farthest], self.source)
        return spatial_order(position, self.spec.distinct[0], lower, upper, self.spec.grid.active.tolist())


def alike(drifts: NDArray) -> Iterator[tuple[NDArray, NDArray]]:
    """Each velocity among drifts (n, 3), and which of them are that; (n,)."""
    for drift in np.unique(drifts, axis=0):
        yield drift, (drifts == drift).all(axis=1)
