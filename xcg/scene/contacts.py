"""Contacts of one frame: partners, branch vectors, normals and sums; walls as partners, and their contacts alone."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.checks import is_whole
from xcg.common.messages import SceneError, plain, unknown
from xcg.compiled._jit import for_parts
from xcg.compiled.arrays import counting_sort, short_integers
from xcg.compiled.contacts import add_dyads, add_rows, add_unit_squares, between, k_core, sides
from xcg.scene.conform import takes_scene
from xcg.scene.frame import indices_of
from xcg.scene.lattice import Lattice, unit_vectors
from xcg.scene.repeats import repeated_pairs
from xcg.scene.sanity_contacts import check_contacts
from xcg.scene.scene import Scene
from xcg.scene.schema import PADDING, Frame

# Contacts are those of spheres where the branches are as spheres have them, to this share of the
# radius.
SPHERES = 1e-2
# Partners from which a grain may bear load, with friction (Thornton 2000).
LOAD_BEARING = 2
Walls: TypeAlias = str | int | Sequence[str | int]
FIRST_WALL = PADDING - 1  # walls that have names are -2, -3, ... in their order


@dataclass(frozen=True, eq=False)
class Contacts:
    """Contacts by the indices of their particles.

    Attributes
    ----------
    i, j : array (n,)
        Indices of the two particles; -1 for a wall or a partner that is not in the scene.
    force : array (n, 3)
        Force on i (N); zero where the frame has no forces.
    point : array (n, 3)
        Contact point (m).
    position : array (particles, 3)
        Centres (m).
    lattice : Lattice
        Periodic images.
    key_i, key_j : array (n,)
        Identifiers of the partners, walls included.
    data_normal : array (n, 3) or None
        Unit vector from j to i, where the data hold it.
    exact_branches : tuple of array (n, 3) or None
        Branches of i and j, where they are known better than from centres and contact points.
    threads : int
        Threads that share the loops over contacts; results do not depend on it.
    """

    i: NDArray
    j: NDArray
    force: NDArray
    point: NDArray
    position: NDArray
    lattice: Lattice
    key_i: NDArray
    key_j: NDArray
    data_normal: NDArray | None
    exact_branches: tuple[NDArray, NDArray] | None = None
    threads: int = 1

    @classmethod
    def of(
        cls, frame: Frame, lattice: Lattice, source: str = "scene", threads: int = 1
    ) -> Contacts:
        """Join the contacts of a frame to its particles; `source` names the step in warnings."""
        ids = frame["particle_id"]
        position = frame["position"]
        key_i = frame["contact_i"]
        key_j = frame["contact_j"]
        point = frame["contact_point"]
        index_i, index_j = indices_of(ids, key_i), indices_of(ids, key_j)
        check_contacts(frame, index_i, index_j, lattice, source)
        normal = frame.get("contact_normal")
        # contacts found from positions without a stiffness have no forces
        force = frame.get("contact_force", np.zeros_like(point))
        return cls(
            index_i, index_j, force, point, position, lattice, key_i, key_j, normal, threads=threads
        )

    @cached_property
    def branches(self) -> tuple[NDArray, NDArray]:
        """From the contact point to the centres, ``r_i - c`` (m), nearest image; zero for a partner not there."""
        if self.exact_branches is not None:
            return self.exact_branches
        return self._sides(self.i), self._sides(self.j)

    def _sides(self, index: NDArray) -> NDArray:
        """Vectors (n, 3) from the contact points to one particle of each contact, zero where it is not there."""
        out = np.empty_like(self.point)
        periods = self.lattice.for_loops

        def write(first: int, last: int) -> None:
            sides(
                index[first:last], self.position, self.point[first:last], *periods, out[first:last]
            )

        for_parts(len(index), write, self.threads)
        return out

    @property
    def first_index(self) -> NDArray:
        """The first particle of each contact that is there; negative where none is; (n,)."""
        return np.where(self.i >= 0, self.i, self.j)

    @property
    def branch_i(self) -> NDArray:
        """Branch of i, see `branches`; (n, 3)."""
        return self.branches[0]

    @property
    def branch_j(self) -> NDArray:
        """Branch of j, see `branches`; (n, 3)."""
        return self.branches[1]

    def with_overlaps(self, diameter: NDArray, overlap: NDArray) -> Contacts:
        """Return the contacts with branches of spheres as the code had them: ``a = n (R - overlap/2)``.

        Text files hold normals and overlaps with more digits than positions determine. Contacts
        whose branches differ from that by more than `SPHERES` of a radius are not between spheres,
        and stay as they are.
        """
        both = np.flatnonzero((self.i >= 0) & (self.j >= 0))
        normal = self.normal[both]
        spheres = np.ones(len(both), bool)
        branches = []
        for index, own_branch, sign in (
            (self.i, self.branch_i, 1.0),
            (self.j, self.branch_j, -1.0),
        ):
            radius = diameter[index[both]] / 2
            branch = sign * (radius - overlap[both] / 2)[:, None] * normal
            spheres &= np.linalg.norm(branch - own_branch[both], axis=1) <= SPHERES * radius
            branches.append(branch)
        branch_i = self.branch_i.copy()
        branch_j = self.branch_j.copy()
        branch_i[both[spheres]] = branches[0][spheres]
        branch_j[both[spheres]] = branches[1][spheres]
        return replace(self, exact_branches=(branch_i, branch_j))

    @property
    def between(self) -> NDArray:
        """From j to i, ``r_i - r_j`` (m), or between the contact point and the only particle that is there; (n, 3).

        Of all images of the two, those touching at the contact point are taken: the nearest ones,
        unless grains are larger than half the box. The contact point itself, and which of the two
        comes first, make no difference.
        """
        if self.exact_branches is not None:
            return self.branch_i - self.branch_j
        out = np.empty_like(self.point)
        periods = self.lattice.for_loops

        def write(first: int, last: int) -> None:
            some = slice(first, last)
            between(
                self.i[some], self.j[some], self.position, self.point[some], *periods, out[some]
            )

        for_parts(len(out), write, self.threads)
        return out

    @cached_property
    def normal(self) -> NDArray:
        """Unit vector from j to i, along `between` where none is given; zero where it is undefined; (n, 3)."""
        if self.data_normal is not None:
            return self.data_normal
        return unit_vectors(self.between)

    @cached_property
    def normal_force(self) -> NDArray:
        """Normal force of each contact (N), positive where it pushes; (n,)."""
        return np.einsum("ni,ni->n", self.force, self.normal)

    @property
    def tangential_force(self) -> NDArray:
        """Tangential force on i of each contact (N), (n, 3)."""
        return self.force - self.normal_force[:, None] * self.normal

    @property
    def strong(self) -> NDArray:
        """Return whether each contact pushes more than the mean of all contacts that push; (n,)."""
        push = (self.normal_force > 0) & (self.first_index >= 0)
        if not push.any():
            return push
        # a hair more, so that of equal forces none is strong by rounding
        return push & (self.normal_force > self.normal_force[push].mean() * (1 + 1e-12))

    def sum_over_particles(self, on_i: NDArray, on_j: NDArray, sign_j: float = 1.0) -> NDArray:
        """Sum what contacts give to their particles, `on_i` and `sign_j` x `on_j`; (n, ...) to (particles, ...)."""
        width = math.prod(on_i.shape[1:])
        total = np.zeros((len(self.position), width))
        for index, sign, values in ((self.i, 1.0, on_i), (self.j, sign_j, on_j)):
            add_rows(index, sign, values.reshape(len(index), width), total)
        return total.reshape(len(self.position), *on_i.shape[1:])

    @property
    def first(self) -> NDArray:
        """1 for the first contact of each pair, 0 for further ones (bodies may touch at several points).

        Periodic images of one particle are several partners: in small boxes, grains touch on both
        sides.
        """
        first = np.ones(len(self.key_i))
        indices, pair = repeated_pairs(self.key_i, self.key_j)
        if indices.size:
            from_lower = np.where((self.key_i < self.key_j)[:, None], self.crossed, -self.crossed)
            keys = np.column_stack([from_lower[indices], pair])
            order = np.lexsort(keys.T)
            repeated = (np.diff(keys[order], axis=0) == 0).all(axis=1)
            first[indices[order[1:][repeated]]] = 0.0
        return first

    @cached_property
    def crossed(self) -> NDArray:
        """Periods (n, k) between j and the image of it that touches i; zero at walls."""
        both = np.flatnonzero((self.i >= 0) & (self.j >= 0))
        number = np.zeros((len(self.i), len(self.lattice.basis)))
        away = self.position[self.i[both]] - self.position[self.j[both]]
        number[both] = self.lattice.numbers(self.between[both] - away)
        return number

    @cached_property
    def partners(self) -> NDArray:
        """Number of contact partners of each particle, walls included; several contacts with one count once."""
        first = self.first
        return self.sum_over_particles(first, first)

    @cached_property
    def load_bearing(self) -> NDArray:
        """Return whether each particle has two contact partners or more, so that it may bear load; (particles,)."""
        return self.partners >= LOAD_BEARING

    @property
    def between_load_bearing(self) -> NDArray:
        """Return whether all particles of each contact that are there may bear load; (n,)."""
        load_bearing = np.append(self.load_bearing, True)  # index -1 is that of a wall
        return load_bearing[self.i] & load_bearing[self.j] & (self.first_index >= 0)

    def k_core(self, least: int) -> NDArray:
        """Return whether each particle keeps `least` partners when all that have fewer are taken out, again and again.

        Partners that are not particles of the scene (walls) stay.
        """
        degree = self.partners.copy()
        kept = np.ones(len(self.position), bool)
        k_core(self.i, self.j, self.first, least, degree, kept)
        return kept

    @property
    def normals(self) -> NDArray:
        """Sum over contacts of n n for each particle (particles, 6): xx xy xz yy yz zz."""
        along = self.data_normal
        if along is None:
            along = self.between
        total = np.zeros((len(self.position), 6))
        add_unit_squares(self.i, self.j, along, total)
        return total

    @property
    def dyads(self) -> NDArray:
        """Sum over contacts of f a for each particle, force times branch (J); shape (particles, 3, 3)."""
        total = np.zeros((len(self.position), 3, 3))
        branch_i, branch_j = self.branches

        def add(first: int, last: int) -> None:
            add_dyads(self.i, 1.0, self.force, branch_i, first, total[first:last])
            add_dyads(self.j, -1.0, self.force, branch_j, first, total[first:last])

        for_parts(len(total), add, self.threads)
        return total

    @property
    def forces(self) -> NDArray:
        """Total contact force on each particle (N); shape (particles, 3)."""
        return self.sum_over_particles(self.force, self.force, -1.0)

    @property
    def at_walls(self) -> tuple[NDArray, NDArray, NDArray]:
        """Particle index, contact point (m) and force on the particle (N) of the contacts with walls."""
        walls = np.flatnonzero((self.i < 0) != (self.j < 0))  # few, if any
        wall_j = walls[self.j[walls] < 0]
        wall_i = walls[self.i[walls] < 0]
        return (
            np.concatenate([self.i[wall_j], self.j[wall_i]]),
            np.concatenate([self.point[wall_j], self.point[wall_i]]),
            np.concatenate([self.force[wall_j], -self.force[wall_i]]),
        )

    def in_order_of(self, order: NDArray) -> NDArray:
        """Return the contacts in the order that their first particles have in an order (particles,) of these; (n,).

        Contacts without a particle come last.
        """
        keys = len(order) + 1
        # index -1 is that of no particle
        rank = np.full(keys, len(order), short_integers(max(keys, len(self.i))))
        rank[order] = np.arange(len(order), dtype=rank.dtype)
        return counting_sort(rank[self.first_index], keys)


# --- walls -----------------------------------------------------------------------------------------------


def named_walls(names: Iterable[str]) -> dict[str, Any]:
    """Attributes of a scene whose walls -2, -3, ... have names.

    Raises
    ------
    SceneError
        If a name is not a single word, as the attribute is words with blanks between.
    """
    names = list(names)
    wrong = [name for name in names if not isinstance(name, str) or len(name.split()) != 1]
    if wrong:
        raise SceneError(
            f"walls: {wrong[0]!r} is no name of a wall: expected a word without blanks"
        )
    return {"wall_names": " ".join(names), "wall_ids": FIRST_WALL - np.arange(len(names))}


def walls_of(ds: xr.Dataset) -> dict[str, int]:
    """Names of a scene's walls and their numbers in ``contact_j``; empty where walls have no names."""
    names = str(ds.attrs.get("wall_names", "")).split()
    numbers = np.atleast_1d(ds.attrs.get("wall_ids", [])).tolist()
    return {name: int(number) for name, number in zip(names, numbers, strict=True)}


def numbers_of_walls(ds: xr.Dataset, walls: Walls) -> tuple[int, ...]:
    """Numbers in ``contact_j`` of walls that are given by number or by name.

    Raises
    ------
    ValueError
        If the scene has no wall of a name, or a number is not negative.
    """
    by_name = walls_of(ds)
    wanted = [walls] if isinstance(walls, str) or not np.iterable(walls) else list(walls)
    numbers = []
    for wall in wanted:
        if is_whole(wall, -(2**63), -1):
            numbers.append(int(wall))
        elif isinstance(wall, str) and wall in by_name:
            numbers.append(by_name[wall])
        elif isinstance(wall, str):
            listed = "no wall of this scene has a name"
            if by_name:
                listed = f"the walls of this scene are {', '.join(by_name)}"
            raise ValueError(
                unknown("wall", wall, by_name, f"{listed}; or give numbers as in contact_j")
            )
        else:
            raise ValueError(
                f"walls: {plain(wall)} is no wall: expected names, or negative numbers as in contact_j"
            )
    if not numbers:
        raise ValueError(
            "walls: none is given; expected names, or negative numbers as in contact_j"
        )
    return tuple(dict.fromkeys(numbers))


@takes_scene
def select_walls(scene: Scene, walls: Walls) -> xr.Dataset:
    """Keep the contacts with some walls, and no others; lazy where the scene is.

    Fields of contacts are then the part that these walls have in them: ``boundary_force_density`` of several
    walls adds up to that of all.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with contacts.
    walls : str, int or list of these
        Names of walls, as `open_scene` was given them, or their numbers in ``contact_j``: LAMMPS
        -2, -3, ... in the order of ``walls=``; LIGGGHTS -(mesh + 1); MercuryDPM -(index + 1).

    Returns
    -------
    xarray.Dataset
        The scene with the other contacts turned into padding (``contact_i == -1``).

    Raises
    ------
    SceneError
        If the scene has no contacts.
    ValueError
        If a name of a wall is unknown.

    Examples
    --------
    >>> import xcg
    >>> ds = xcg.datasets.random_scene(100)
    >>> int((select_walls(ds, -1).contact_i >= 0).sum()) == int((ds.contact_j == -1).sum() - (ds.contact_i < 0).sum())
    True
    """
    scene.require(("contact_i", "contact_j"), "select_walls")
    ds = scene.ds
    kept = ds["contact_j"].isin(numbers_of_walls(ds, walls))
    return ds.assign(
        contact_i=ds["contact_i"].where(kept, PADDING).assign_attrs(ds["contact_i"].attrs)
    )
