"""The registry of moments: sums over grains and contacts that fields are algebra on, and the columns they sum."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial, reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import warn_once
from xcg.compiled import points as loops
from xcg.scene.contacts import Contacts
from xcg.scene.schema import COMPONENTS, ROTATION, Frame, powers_of

Column = Callable[[Frame, Contacts], NDArray]
# Share of Coulomb's limit from which a contact slides: codes write forces with few digits.
AT_LIMIT = 0.999


def _dot(a: NDArray, b: NDArray) -> NDArray:
    """Return a_k b_k of each row."""
    return np.einsum("ij,ij->i", a, b)


def of_frame(name: str, frame: Frame, _: Contacts) -> NDArray:
    """Return a variable of each particle; (particles, ...)."""
    return frame[name]


def of_contacts(name: str, _: Frame, contacts: Contacts) -> NDArray:
    """Return an attribute of `Contacts` as numbers, of each particle or of each contact."""
    return np.asarray(getattr(contacts, name), float)


def load_bearing_partners(frame: Frame, contacts: Contacts) -> NDArray:
    """Return number of partners of each grain that may bear load, else 0; (particles,)."""
    return np.where(contacts.load_bearing, contacts.partners, 0.0)


def one_a_particle(frame: Frame, contacts: Contacts) -> NDArray:
    """Return 1 for each particle; (n,)."""
    return np.ones(len(frame["position"]))


def one_a_contact(frame: Frame, contacts: Contacts) -> NDArray:
    """Return 1 for each contact; (n,)."""
    return np.ones(len(frame["contact_i"]))


def sliding_contacts(friction: float | None, frame: Frame, contacts: Contacts) -> NDArray:
    """Return 1 for each contact that slides, which has its tangential force at Coulomb's limit, else 0; (n,).

    Without a coefficient of friction it is not known which slide: 0 for all.
    """
    if friction is None:
        return np.zeros(len(frame["contact_i"]))
    tangential = np.linalg.norm(contacts.tangential_force, axis=1)
    slides = (contacts.normal_force > 0) & (
        tangential >= AT_LIMIT * friction * contacts.normal_force
    )
    return slides.astype(float)


def load_bearing_sliding(friction: float | None, frame: Frame, contacts: Contacts) -> NDArray:
    """Return 1 for each contact between load-bearing grains that slides, else 0; (n,)."""
    return sliding_contacts(friction, frame, contacts) * contacts.between_load_bearing


def pushing_contacts(frame: Frame, contacts: Contacts) -> NDArray:
    """Return 1 for each contact whose normal force pushes, else 0; (n,)."""
    return (contacts.normal_force > 0).astype(float)


def slopes_of_forces(frame: Frame, contacts: Contacts) -> NDArray:
    """Return tangential over normal force of each contact that pushes, else 0; (n,)."""
    tangential = np.linalg.norm(contacts.tangential_force, axis=1)
    pushes = contacts.normal_force > 0
    return np.where(pushes, tangential / np.where(pushes, contacts.normal_force, 1.0), 0.0)


def branch_length(frame: Frame, contacts: Contacts) -> NDArray:
    """Return length of each branch along the normal (m); (n,)."""
    return _dot(contacts.between, contacts.normal)


def normals(of: Column, frame: Frame, contacts: Contacts) -> NDArray:
    """Return a number of each contact times n n: xx xy xz yy yz zz; (n, 6)."""
    first, second = (contacts.normal[:, k] for k in np.triu_indices(3))
    return of(frame, contacts)[:, None] * first * second


def tangential_normals(frame: Frame, contacts: Contacts) -> NDArray:
    """Return tangential force times normal of each contact (N); (n, 3, 3)."""
    tangential = contacts.tangential_force
    return tangential[:, :, None] * contacts.normal[:, None, :]


def strong_forces(frame: Frame, contacts: Contacts) -> NDArray:
    """Return the forces of strong contacts on both sides, zero for the others; (2, n, 3)."""
    _warn_of_depth(contacts)
    force = np.where(contacts.strong[:, None], contacts.force, 0.0)
    return np.stack([force, -force])


_SLICES = 8  # of equal numbers of contacts along an axis
_IN_A_SLICE = 25  # contacts, at least
_VARIED = 2.0  # ratio of mean forces from which strong contacts show the place
_ERRORS = 4.0  # of the difference of two slices, by which it has to exceed noise


def _warn_of_depth(contacts: Contacts) -> None:
    """Warn where the mean force varies along an axis, as with depth: strong contacts then lie in one region.

    Not along periodic axes, where no mean stress can grow steadily.
    """
    push = (contacts.normal_force > 0) & (contacts.first_index >= 0)
    force = contacts.normal_force[push]
    slices = min(_SLICES, len(force) // _IN_A_SLICE)
    if slices < 2:
        return
    noise = force.std() * math.sqrt(2 * slices / len(force))  # of the difference of two slices
    is_open = contacts.lattice.open_axes
    for axis, coordinates, is_bounded in zip(
        COMPONENTS, contacts.point[push].T, is_open, strict=True
    ):
        if not is_bounded or np.ptp(coordinates) == 0:
            continue
        parts = np.array_split(force[np.argsort(coordinates, kind="stable")], slices)
        means = [part.mean() for part in parts]
        low = min(means)
        high = max(means)
        if high > _VARIED * low and high - low > _ERRORS * noise:
            warn_once(
                "strong contacts",
                f"strong_contact_stress: the mean force of contacts varies by {high / low:.2g} along "
                f"{axis}, as with depth under gravity, so that strong contacts, which push more than the mean of the "
                f"step, are those of one region: select a part that is thin along {axis}, ds.cg.select(...)",
            )
            return


WALL_VELOCITY = "contact_wall_velocity"


def surface_velocities(
    frame: Frame, contacts: Contacts, *, of_images: bool = False
) -> tuple[NDArray, NDArray]:
    """Velocities of the surfaces of i and j at the contact points (m s-1), (n, 3) each.

    Walls have `WALL_VELOCITY` of the frame, or zero. In a sheared box velocities belong to the
    particles as they are written, or to the images that touch at the point.
    """
    velocities = []
    for index, branch in ((contacts.i, contacts.branch_i), (contacts.j, contacts.branch_j)):
        of_grain = index >= 0
        grain = index[of_grain]
        u = frame.get(WALL_VELOCITY, np.zeros((len(index), 3))).copy()
        u[of_grain] = frame["velocity"][grain]
        if "angular_velocity" in frame:
            u[of_grain] += np.cross(branch[of_grain], frame["angular_velocity"][grain])
        if of_images:
            centre = (contacts.point + branch)[of_grain]
            u[of_grain] += contacts.lattice.drift(centre - frame["position"][grain])
        velocities.append(u)
    return velocities[0], velocities[1]


def velocities_of_walls(frame: Frame, free: Contacts, source: str) -> NDArray:
    """Velocities (n, 3) of the surfaces that act as walls on the free grains: of grains fixed in place, or as given."""
    every = Contacts.of(frame, free.lattice, source)
    u_i, u_j = surface_velocities(frame, every, of_images=True)
    return np.where((free.i < 0)[:, None], u_i, u_j)


def torques(frame: Frame, c: Contacts) -> NDArray:
    """Torque of the contact forces on each particle, sum of b x f, b = c - r_i (N m); (particles, 3)."""
    return c.sum_over_particles(np.cross(c.force, c.branch_i), np.cross(c.force, c.branch_j), -1.0)


def powers(frame: Frame, c: Contacts) -> NDArray:
    """Power of the contact forces on each particle, sum of f.u = F.v + T.omega (W); (particles,)."""
    u_i, u_j = surface_velocities(frame, c)
    return c.sum_over_particles(_dot(c.force, u_i), _dot(c.force, u_j), -1.0)


def couples(frame: Frame, c: Contacts) -> NDArray:
    """Couple of both forces of each contact, (b_i - b_j) x f (N m); of one force at walls; (contacts, 3)."""
    return np.cross(c.force, c.branch_i - c.branch_j)


def taken_up(frame: Frame, c: Contacts) -> NDArray:
    """Power dissipated or stored by each contact, -f.(u_i - u_j) (W); (contacts,)."""
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
    return of_sides(_dot(c.force, u_i), -_dot(c.force, u_j))


def of_sides(on_i: NDArray, on_j: NDArray) -> NDArray:
    """Numbers of the sides of each contact (contacts,), as the first of three components; (2, contacts, 3)."""
    out = np.zeros((2, len(on_i), 3))
    out[0, :, 0] = on_i
    out[1, :, 0] = on_j
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


def carried(of: Column, frame: Frame, contacts: Contacts) -> NDArray:
    """Return a number or vector of each particle times its velocity; (particles, ..., 3)."""
    values = of(frame, contacts)
    velocity = frame["velocity"]
    return values[..., None] * velocity.reshape(len(velocity), *(1,) * (values.ndim - 1), 3)


def spins(frame: Frame, _: Contacts) -> NDArray:
    """Spin I omega of each particle (N m s); (particles, 3)."""
    return frame["moment_of_inertia"][:, None] * frame["angular_velocity"]


def weighted(weight: str, vector: str, frame: Frame, _: Contacts) -> NDArray:
    """Weight and vector of each particle; (particles, 4)."""
    return np.column_stack([frame[weight], frame[vector]])


@dataclass(frozen=True)
class Moment:
    """Moment: ``sum_i q_i Psi(r - r_i)`` over grains, or over contacts.

    Attributes
    ----------
    variables : tuple of str
        Scene variables that it needs besides positions. With "velocity", `column` is also evaluated
        with the velocities of images in sheared boxes.
    formula : str
        What is summed.
    units : str or tuple of str
        Unit of what is summed, or one for each component; the moment is that per volume.
    shape : tuple of int
        Components of the result at a node.
    level : int
        Kinematic columns that the point deposit must keep for it; 0 where it is a column of constants or
        of contacts.
    first : int
        Its first flow column.
    column : callable, optional
        ``column(frame, contacts) -> (n, ...)``, the q_i, where they do not depend on the node.
        Together with a `level` it gives (n, 4): a weight, and three numbers that take the place of
        velocity in the kinematic columns of a separate pass, so that their squares and products are kept
        relative to each node.
    contacts : bool
        Whether contacts are needed, in whole.
    over : str
        What is summed over: "grains"; "contacts", where a row of `column` is a contact, which
        stands at its contact point; "branches", where `column` gives what each side of a contact
        carries along its branch, (2, contacts, 3) for i and j, or without a column the force;
        "vectors", a `column` in the place of velocity, of grains or, with `contacts`, of contacts;
        "pairs", forces between phases at the contact points; "walls", forces of walls at the
        contact points; or "slopes", kinematic columns weighted by grad Psi.
    layout : tuple
        Columns of the components, counted from the first, where they do not stand one after the
        other.
    paired : bool
        Whether it is summed for each pair of phases, walls being the last of the other phases.
    optional : tuple of str
        Variables that are taken where the scene has them.
    vector : bool
        Whether the three numbers in the place of velocity are the components of a vector.
    """

    variables: tuple[str, ...]
    formula: str
    shape: tuple[int, ...] = ()
    level: int = loops.NONE
    first: int = 0
    column: Column | None = None
    contacts: bool = False
    over: str = "grains"
    layout: tuple[Any, ...] = ()
    paired: bool = False
    optional: tuple[str, ...] = ()
    vector: bool = True
    units: str | tuple[str, ...] = "1"

    @cached_property
    def powers(self) -> NDArray:
        """Powers of (length, mass, time) of the moment, (3,) or (components, 3)."""
        if isinstance(self.units, str):
            return np.array(powers_of(self.units)) - [3, 0, 0]
        return np.array([powers_of(units) for units in self.units]) - [3, 0, 0]

    @cached_property
    def columns(self) -> NDArray:
        """Columns of the components, counted from the first: an array of the moment's shape, read-only."""
        columns = np.arange(math.prod(self.shape)).reshape(self.shape)
        if self.layout:
            columns = np.array(self.layout)
        columns.flags.writeable = False
        return columns

    @cached_property
    def width(self) -> int:
        """Number of columns."""
        return 1 + int(self.columns.max(initial=-1))


def _power(exponent: int, frame: Frame, _: Contacts) -> NDArray:
    return reduce(np.multiply, [frame["diameter"]] * exponent)  # many times faster than `**`


def _partners(frame: Frame, contacts: Contacts) -> NDArray:
    if "coordination_number" in frame:
        return frame["coordination_number"]
    return contacts.partners


def _fabric(frame: Frame, contacts: Contacts) -> NDArray:
    total = contacts.normals
    total *= frame["volume"][:, None]
    return total


def _director_dyads(frame: Frame, _: Contacts) -> NDArray:
    n = frame["director"]
    n = n / np.linalg.norm(n, axis=1, keepdims=True)
    return np.stack([n[:, i] * n[:, j] for i, j in zip(*np.triu_indices(3), strict=True)], axis=1)


def _weighted_box_gradient(frame: Frame, _: Contacts) -> NDArray:
    mass = frame["mass"][:, None, None]
    return mass * frame.get("box_gradient", np.zeros((len(mass), 3, 3)))


_SYMMETRIC = ((0, 1, 2), (1, 3, 4), (2, 4, 5))  # kept as six
_NORMAL = ("contact_normal",)
_OFFSETS = (0, 4, 8)  # m x and m u x of one direction stand together
_SHEARS = ((0, 4, 8), (1, 5, 9), (2, 6, 10))
_MV = ("mass", "velocity")
_FORCE = ("contact_force",)
_NORMAL_FORCE = partial(of_contacts, "normal_force")
_ABOUT = tuple(range(loops.COUNT)) + tuple(range(loops.KINETIC, loops.SQUARE + 1))
_I_OMEGA = ("moment_of_inertia", "angular_velocity")
_power_moment = partial(
    Moment, (*_FORCE, "velocity"), contacts=True, optional=("angular_velocity", WALL_VELOCITY)
)
_at_contacts = partial(Moment, contacts=True, over="contacts")
_along_branches = partial(Moment, _FORCE, shape=(3, 3), contacts=True, over="branches")
MOMENTS: dict[str, Moment] = {
    # kinematic columns, relative to the node: x = r_i - r, u = v_i - U
    # not times Psi, and so a number, and not one per volume
    "count": Moment((), "1, where Psi > 0", (), loops.VELOCITY, loops.COUNT, units="m^3"),
    "mass": Moment(("mass",), "m", (), loops.VELOCITY, loops.MASS, units="kg"),
    "momentum": Moment(_MV, "m u", (3,), loops.VELOCITY, loops.MOMENTUM, units="kg m s^-1"),
    "kinetic": Moment(_MV, "m u u", (3, 3), loops.FLUCTUATION, loops.KINETIC, layout=_SYMMETRIC, units="J"),
    "offset": Moment(("mass",), "m x", (3,), loops.LINEAR, loops.OFFSET, layout=_OFFSETS, units="kg m"),
    "shear": Moment(_MV, "m u x", (3, 3), loops.LINEAR, loops.SHEAR, layout=_SHEARS, units="kg m^2 s^-1"),
    "spread": Moment(("mass",), "m x x", (3, 3), loops.LINEAR, loops.SPREAD, layout=_SYMMETRIC, units="kg m^2"),
    # these with Psi once more
    "square": Moment(("mass",), "m^2 Psi", (), loops.FLUCTUATION, loops.SQUARE, units="kg^2 m^-3"),
    "square_offset": Moment(("mass",), "m^2 Psi x", (3,), loops.SQUARED, loops.SQUARE_OFFSET, units="kg^2 m^-2"),
    "square_spread": Moment(
        ("mass",), "m^2 Psi x x", (3, 3), loops.SQUARED, loops.SQUARE_SPREAD, layout=_SYMMETRIC,
        units="kg^2 m^-1",
    ),
    # columns of constants
    "number": Moment((), "1", column=one_a_particle),
    "volume": Moment(("volume",), "V", column=partial(of_frame, "volume"), units="m^3"),
    "size2": Moment(("diameter",), "d^2", column=partial(_power, 2), units="m^2"),
    "size3": Moment(("diameter",), "d^3", column=partial(_power, 3), units="m^3"),
    "size4": Moment(("diameter",), "d^4", column=partial(_power, 4), units="m^4"),
    "box_gradient": Moment(
        ("mass",), "m, times the gradient along averaged axes of a sheared box", (3, 3), column=_weighted_box_gradient,
        units="kg s^-1",
    ),
    "interval": Moment(("interval",), "t' - t", column=partial(of_frame, "interval"), units="s"),
    "partners": Moment((), "z", column=_partners, contacts=True),
    "fabric": Moment(
        ("volume",), "V sum_c n n", (3, 3), column=_fabric, contacts=True, layout=_SYMMETRIC, optional=_NORMAL,
        units="m^3",
    ),
    "directors": Moment(("director",), "n n", (3, 3), column=_director_dyads, layout=_SYMMETRIC),
    "force": Moment(_FORCE, "sum_c f", (3,), column=partial(of_contacts, "forces"), contacts=True, units="N"),
    "inertia": Moment(("moment_of_inertia",), "I", column=partial(of_frame, "moment_of_inertia"), units="kg m^2"),
    "spin": Moment(_I_OMEGA, "I omega", (3,), column=spins, units="J s"),
    "spin_flux": Moment((*_I_OMEGA, "velocity"), "I omega v", (3, 3), column=partial(carried, spins), units="J m"),
    "rotational_energy": Moment(_I_OMEGA, "I omega^2 / 2", column=rotational_energies, units="J"),
    "rotational_energy_flux": Moment(
        ("velocity",), "I omega^2 v / 2", (3,), column=partial(carried, rotational_energies), optional=ROTATION,
        units="J m s^-1",
    ),
    "some_rotational_energy": Moment(
        (), "I omega^2 / 2", column=rotational_energies, optional=ROTATION,
        units="J",
    ),
    "energy": Moment(_MV, "(m v^2 + I omega^2) / 2", column=energies, optional=ROTATION, units="J"),
    "energy_flux": Moment(
        _MV, "(m v^2 + I omega^2) v / 2", (3,), column=partial(carried, energies), optional=ROTATION,
        units="J m s^-1",
    ),
    "torque": Moment(_FORCE, "sum_c b x f", (3,), column=torques, contacts=True, units="J"),
    "power": _power_moment("sum_c f.u", column=powers, units="W"),
    # in passes of their own, relative to the node
    "rotation": Moment(
        _I_OMEGA, "I (1, o, o o), I^2 Psi, o = omega", (11,), loops.FLUCTUATION,
        column=partial(weighted, *_I_OMEGA), over="vectors", layout=_ABOUT,
        units=("kg m^2", *("J s",) * 3, *("J",) * 6, "kg^2 m"),
    ),
    "cubes": Moment(
        _MV, "m u^2 u", (3,), loops.CUBIC, loops.CUBE, column=partial(weighted, *_MV), over="vectors",
        units="J m s^-1",
    ),
    "load_bearing": Moment((), "1, where z > 1", column=partial(of_contacts, "load_bearing"), contacts=True),
    "load_bearing_partners": Moment((), "z, where z > 1", column=load_bearing_partners, contacts=True),
    # at the contact points
    "contacts": _at_contacts((), "1", column=one_a_contact),
    "load_bearing_contacts": _at_contacts(
        (), "1, between grains of z > 1", column=partial(of_contacts, "between_load_bearing"),
    ),
    "sliding_contacts": _at_contacts(
        _FORCE, "1, where it slides", column=partial(sliding_contacts, None), optional=_NORMAL
    ),
    "load_bearing_sliding": _at_contacts(
        _FORCE, "1, where it slides, between grains of z > 1", column=partial(load_bearing_sliding, None),
        optional=_NORMAL,
    ),
    "pushing_contacts": _at_contacts(
        _FORCE, "1, where f . n > 0", column=pushing_contacts, optional=_NORMAL
    ),
    "force_slopes": _at_contacts(
        _FORCE, "|f_t| / f . n, where f . n > 0", column=slopes_of_forces, optional=_NORMAL
    ),
    "normals": _at_contacts(
        (), "n n", (3, 3), column=partial(normals, one_a_contact), layout=_SYMMETRIC, optional=_NORMAL,
    ),
    "branch_length": _at_contacts((), "l . n", column=branch_length, optional=_NORMAL, units="m"),
    "branch_normals": _at_contacts(
        (), "l . n n n", (3, 3), column=partial(normals, branch_length), layout=_SYMMETRIC, optional=_NORMAL,
        units="m",
    ),
    "normal_force": _at_contacts(_FORCE, "f . n", column=_NORMAL_FORCE, optional=_NORMAL, units="N"),
    "normal_force_normals": _at_contacts(
        _FORCE, "f . n n n", (3, 3), column=partial(normals, _NORMAL_FORCE), layout=_SYMMETRIC, optional=_NORMAL,
        units="N",
    ),
    "tangential_normals": _at_contacts(
        _FORCE, "f_t n", (3, 3), column=tangential_normals, optional=_NORMAL, units="N"
    ),
    "pair_force": Moment(
        _FORCE, "f, at the contact, by phase of the partner", (3,), contacts=True, over="pairs", paired=True, units="N"
    ),
    "contact_couple": _at_contacts(_FORCE, "(b_i - b_j) x f", (3,), column=couples, units="J"),
    "taken_up": _power_moment("-f.(u_i - u_j)", column=taken_up, over="contacts", units="W"),
    "wall_power": _power_moment("f.u of the wall", column=of_walls, over="contacts", units="W"),
    # weighted by grad Psi
    "mass_slope": Moment(("mass",), "m, with grad Psi", (3,), over="slopes", layout=_OFFSETS, units="kg m^-1"),
    "momentum_slope": Moment(_MV, "m u, with grad Psi", (3, 3), over="slopes", layout=_SHEARS, units="kg s^-1"),
    # along branches, and at walls
    "contact": _along_branches("f a, along the branch", units="J"),
    "strong_contact": _along_branches(
        "f a, along the branch, of contacts that push more than the mean", column=strong_forces,
        optional=_NORMAL,
        units="J",
    ),
    "pair_contact": _along_branches("f a, along the branch, by phase of the partner", paired=True, units="J"),
    "couple": _along_branches("(b x f) a, along the branch", column=torque_of_sides, units="J m"),
    "side_power": _power_moment(
        "(f.u) a, along the branch", (3,), column=power_of_sides, over="branches",
        units="W m",
    ),
    "traction": Moment(_FORCE, "f, at the wall", (3,), contacts=True, over="walls", units="N"),
}  # fmt: skip

# powers of the cutoff in the kinematic columns, which the deposit computes with lengths in cutoffs
CUTOFF_POWERS = {"offset": 1, "shear": 1, "spread": 2, "square_offset": 1, "square_spread": 2}
