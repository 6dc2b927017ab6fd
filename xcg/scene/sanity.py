"""Warnings about implausible scenes: sizes, places, boxes, densities and times that contradict each other.

Each check returns a message, or None. Checks look at samples of the grains, so that they take no
noticeable time: rows spread over all for values, neighbours in a small region for distances.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import warn_user
from xcg.scene.complete import superquadric_integrals
from xcg.scene.frame import rows_of
from xcg.scene.lattice import Lattice
from xcg.scene.schema import COMPONENTS, Frame, Setup

FEW = 20  # grains or contacts that are too few for a verdict
_SAMPLE = 4096  # rows looked at, spread over all
_REGION = 300  # grains of a region whose neighbours are looked at
_HALVINGS = 30  # of a region, until it holds so few
_BLOCK = 64  # grains of a region that are compared with the others at once
_CROWD = 8  # nearest grains that are looked at

_SAME = 2e-3  # scatter of masses over d^2, from sizes and masses of four digits
_MOST_FILLED = 100.0  # grains in the cube of a diameter, also of glued ones that overlap
_SHAPE = 0.02  # error of volumes of half-axes and exponents of three digits
_DIGITS = 5e-3  # error of products of masses, sizes and densities of three digits
_VARIED = 0.02  # scatter of diameters by which d^2 and d^3 differ

# Nearest distances over sums of radii pile up at 1 in a packing. Where they pile up at another
# factor, sizes are off by it.
_FACTORS = (2.0, 0.5, *(f * 10.0**k for k in (1, 2, 3, 4, 6) for f in (1.0, 2.0)), 0.1, 0.01, 1e-3)
_PILE = (0.93, 1.03)  # range of the distances of grains that touch, over the factor
_PILED = 0.25  # share of the grains in this range
_LOWEST = 0.9  # 5th percentile of the distances, over the factor
_REGULAR = 1e-4  # scatter of the distances in a lattice, which may be as loose as one likes
# Nearest grains of a lattice, also of one with scatter, lie in few directions: 1/6 (fcc), 1/4 (bcc)
# or 1/3 (cubic) of all pairs of directions are parallel, in a plane 1/3 (hexagonal) or 1/2. Of
# directions at random 1/66 are within ten degrees, in a plane 1/9.
_PARALLEL = np.cos(np.radians(10.0))
_ALIGNED = {2: 0.22, 3: 0.1}  # least share of parallel pairs in a lattice
_EVEN = 0.1  # most scatter of nearest distances in a lattice
_OVERLAPPING = {
    2: 4.0,
    3: 6.0,
}  # neighbours, of eight, that overlap by a tenth if sizes are doubled

_OUTSIDE = 0.01  # share of the grains that are farther from the box than its length
_MOST_OUTSIDE = 0.5  # share of the grains outside the box
_OTHER_ORDER = (
    0.2  # share of the grains outside the box along an axis, if axes are in another order
)
_EDGE = 0.02  # of the length of the box, by which grains may lie outside
_OVERFULL = 30.0  # volume of the grains over that of the box, also of glued ones that overlap
_WIDE = 50.0  # length of a box over the extent of the grains along each axis
_FLAT_BOX = 3.0  # diameters: a thinner box is meant as the thickness of a layer

_MOVED = 0.05  # least share of the grains outside periodic edges
_FEW_MOVED = 16  # of these that are looked at
_ON_OTHERS = 0.8  # distance over the sum of radii of grains that lie on one another

_DENSITIES = (100.0, 30_000.0)  # kg m-3
_LARGE = 0.05  # m; larger grains of another density are of scaled data, most likely
_WRONG_TIME = 5.0  # displacements over those that follow from velocities
_ALIKE = 0.9  # correlation of both, so that velocities hardly changed in between


def sample_of(rows: int) -> slice:
    """Return rows spread over all of them, about 4096."""
    return slice(None, None, max(1, rows // _SAMPLE))


@dataclass(frozen=True, eq=False)
class Particles:
    """Particles of one step, as the checks take them.

    Attributes
    ----------
    frame : Frame
        Particles, completed.
    setup : Setup
        Arguments of the scene.
    lattice : Lattice
        Box and periodic axes of the step.
    is_volume : bool
        Whether the scene was named three-dimensional, or found to be so.
    """

    frame: Frame
    setup: Setup
    lattice: Lattice
    is_volume: bool = False

    @cached_property
    def count(self) -> int:
        """Number of particles."""
        return len(self.frame["position"])

    @cached_property
    def sample(self) -> Frame:
        """Rows spread over all particles."""
        some = sample_of(self.count)
        return {name: values[some] for name, values in self.frame.items()}

    @cached_property
    def diameter(self) -> float:
        """Mean diameter (m), NaN where it is not known."""
        sizes = self.sample.get("diameter", np.empty(0))
        return float(sizes.mean()) if len(sizes) else np.nan

    @cached_property
    def edges(self) -> dict[int, tuple[float, float]]:
        """Edges of the box along the axes of the scene on which it is finite (m)."""
        if self.lattice.edges is None:
            return {}
        lengths = np.diff(self.lattice.edges, axis=1)[:, 0]
        return {
            k: (float(self.lattice.edges[k, 0]), float(self.lattice.edges[k, 1]))
            for k in self.setup.axes
            if np.isfinite(lengths[k])
        }

    @cached_property
    def neighbours(self) -> tuple[NDArray, NDArray]:
        """Neighbours of the grains inside of a small region.

        Distances over sums of radii to the nearest grains (n, k), sorted, and vectors to the
        very nearest (n, 3).
        """
        nothing = np.empty((0, 0)), np.empty((0, 3))
        if "diameter" not in self.frame or self.count < FEW:
            return nothing
        middle = self.frame["position"][self.count // 2]
        low, high = np.quantile(self.sample["position"][:, self.setup.axes], [0.02, 0.98], axis=0)
        share = min(1.0, _REGION / self.count)
        reach = 0.5 * (high - low).max() * share ** (1 / len(self.setup.axes))
        inside = self._around(middle, reach)
        for _ in range(_HALVINGS):
            if len(inside) <= 2 * _REGION:
                break
            reach *= 0.5
            inside = self._around(middle, reach)
        if not FEW <= len(inside) <= 2 * _REGION:  # few, or many in one place
            return nothing
        position, diameter = (self.frame[name][inside] for name in ("position", "diameter"))
        to_edge = reach - np.abs(position - middle)[:, self.setup.axes].max(axis=1)
        nearest = []
        directions = []
        # of so few, all pairs are quicker than the import of a tree; in blocks, which take less memory
        for first in range(0, len(inside), _BLOCK):
            rows = np.arange(first, min(first + _BLOCK, len(inside)))
            away = np.sqrt(sum((x[rows, None] - x) ** 2 for x in position.T))
            away[rows - first, rows] = np.inf
            ratio = 2 * away / (diameter[rows, None] + diameter)
            if len(inside) < self.count:  # the nearest grain may be outside of the region
                is_known = to_edge[rows] >= away.min(axis=1)
                ratio = ratio[is_known]
                rows = rows[is_known]
            nearest.append(np.sort(ratio, axis=1)[:, :_CROWD])
            directions.append(position[rows] - position[ratio.argmin(axis=1)])
        return np.concatenate(nearest), np.concatenate(directions)

    @property
    def is_lattice(self) -> bool:
        """Return True if nearest grains lie at one distance and in few directions."""
        _, directions = self.neighbours
        length = np.linalg.norm(directions, axis=1)
        if len(length) < FEW or not length.min() > 0 or length.std() > _EVEN * length.mean():
            return False
        units = directions / length[:, None]
        parallel = (np.abs(units @ units.T) > _PARALLEL).sum() - len(units)
        return bool(parallel > _ALIGNED[len(self.setup.axes)] * len(units) * (len(units) - 1))

    def _around(self, middle: NDArray, reach: float) -> NDArray:
        """Return the rows of the particles in a cube, axis by axis, as few are left after the first."""
        position = self.frame["position"]
        rows = np.arange(self.count)
        for k in self.setup.axes:
            x = position[:, k] if len(rows) == self.count else position[rows, k]
            rows = rows[(x >= middle[k] - reach) & (x <= middle[k] + reach)]
        return rows

    def outside(self, k: int, position: NDArray, room: float) -> float:
        """Return the share of positions (n,) that are farther than `room` (m) from the box along an axis."""
        low, high = self.edges[k]
        return float(((position < low - room) | (position > high + room)).mean())


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
    for checks in (_OF_LENGTHS, _OF_MASSES, _OF_ARGUMENTS):
        for check in checks:
            message = check(grains)
            if message:
                warn_user(message)
                break


# --- lengths -------------------------------------------------------------------------------------


def _overfilled_space(grains: Particles) -> str | None:
    """Check that the grains fit into the space that their centres take."""
    if not grains.diameter > 0:
        return None
    extent = np.ptp(grains.sample["position"], axis=0)
    if grains.count <= _MOST_FILLED * (extent[grains.setup.axes] / grains.diameter + 1).prod():
        return None
    lengths = " x ".join(f"{length:.3g}" for length in extent)
    return (
        f"{grains.count} grains with a mean diameter of {grains.diameter:.3g} have their centres "
        f"within {lengths}, where they do not fit: are the units of radius and position the same?"
    )


def _factor_of_sizes(grains: Particles) -> str | None:
    """Check that nearest distances pile up at the sum of radii, if they pile up at a factor of it."""
    distances, _ = grains.neighbours
    if len(distances) < FEW:
        return None
    nearest = distances[:, 0]
    nearly_least, middle = np.quantile(nearest, [0.05, 0.5])
    if np.ptp(nearest) <= _REGULAR * middle:
        return None
    for factor in _FACTORS:
        low, high = (end * factor for end in _PILE)
        piled = float(((nearest >= low) & (nearest <= high)).mean())
        if nearly_least < _LOWEST * factor or piled < _PILED:
            continue
        if factor > 1 and grains.is_lattice:
            return None
        if (
            factor < 1
            and (distances < 1.8 * factor).sum(axis=1).mean() < _OVERLAPPING[len(grains.setup.axes)]
        ):
            continue  # spheres of a body that is not named
        text = (
            f"nearest grains are {np.median(nearest):.3g} sums of their radii apart (the median of "
            f"{len(nearest)} grains looked at; the mean diameter is {grains.diameter:.3g})"
        )
        if factor == 2.0:
            return (
                f"{text}: radii were given as diameters, most likely; diameter is twice the radius"
            )
        if factor == 0.5:
            return (
                f"{text}: diameters were given as radii, most likely. If the spheres are glued to "
                "bodies, give body_id"
            )
        return (
            f"{text}: positions and sizes have different units, most likely; give both in one unit"
        )
    return None


def _order_of_axes(grains: Particles) -> str | None:
    """Check that no other order of the components of positions is that of the box."""
    if len(grains.edges) < 3 or grains.count < FEW:
        return None
    position = grains.sample["position"]

    def outside(order: tuple[int, ...]) -> float:
        room = [_EDGE * (grains.edges[k][1] - grains.edges[k][0]) for k in range(3)]
        if grains.diameter > 0:
            room = [length + grains.diameter for length in room]
        return max(grains.outside(k, position[:, order[k]], room[k]) for k in range(3))

    if outside((0, 1, 2)) < _OTHER_ORDER:
        return None
    for order in permutations(range(3)):
        if outside(order) <= _OUTSIDE:
            names = ", ".join(COMPONENTS[k] for k in order)
            return (
                "positions lie outside the box, and inside if their components are taken in the order "
                f"{names}: positions and box have their axes in different orders, most likely"
            )
    return None


def _grains_outside(grains: Particles) -> str | None:
    """Check that grains lie in the box along axes that are not periodic."""
    for k, (low, high) in grains.edges.items():
        if COMPONENTS[k] in grains.setup.periodic:
            continue
        position = grains.sample["position"][:, k]
        length = high - low
        far = grains.outside(k, position, length)
        outside = grains.outside(k, position, _EDGE * length)
        if far >= _OUTSIDE or outside >= _MOST_OUTSIDE:
            return (
                f"{100 * outside:.0f} % of the grains looked at are outside the box along "
                f"{COMPONENTS[k]!r}: the box is {low:.4g} to {high:.4g}, and grains lie at "
                f"{position.min():.4g} to {position.max():.4g}. Check the units of box and positions, "
                "and the order of the axes"
            )
    return None


def _overfilled_box(grains: Particles) -> str | None:
    """Check that the volume of the grains, or the area of discs in a layer, fits into a finite box."""
    if "diameter" not in grains.frame or len(grains.edges) < len(grains.setup.axes):
        return None
    dimension = len(grains.setup.axes)
    shares = {2: np.pi / 4, 3: np.pi / 6}
    lengths = [high - low for low, high in grains.edges.values()]
    filled = (
        grains.count * shares[dimension] * float((grains.sample["diameter"] ** dimension).mean())
    )
    if not filled > _OVERFULL * np.prod(lengths):
        return None
    return (
        f"the grains have {filled / np.prod(lengths):.3g} times the volume of the box "
        f"({' x '.join(f'{length:.4g}' for length in lengths)}; the mean diameter is "
        f"{grains.diameter:.3g}): the box is in another unit than sizes, or smaller than that of the simulation"
    )


def _wide_box(grains: Particles) -> str | None:
    """Check that the grains are not lost in a box that is many times longer than their extent along all axes."""
    if grains.count < FEW or len(grains.edges) < len(grains.setup.axes):
        return None
    position = grains.frame["position"]
    room = 0.0 if np.isnan(grains.diameter) else grains.diameter
    lengths = {k: high - low for k, (low, high) in grains.edges.items()}
    ratio = min(length / (np.ptp(position[:, k]) + room) for k, length in lengths.items())
    if not ratio > _WIDE:
        return None
    k = next(iter(lengths))
    low, high = grains.edges[k]
    return (
        f"the box is {ratio:.3g} times or more as long as the extent of the grains along all of its axes (along "
        f"{COMPONENTS[k]!r} it is {low:.4g} to {high:.4g}, and grains lie at {position[:, k].min():.4g} to "
        f"{position[:, k].max():.4g}): check the units of box and positions, or give box="
    )


def _short_period(grains: Particles) -> str | None:
    """Check that grains outside periodic edges do not lie on others once they are moved inside.

    Positions that were not wrapped lie outside as well, and between the others once they are moved.
    """
    if "diameter" not in grains.frame or grains.lattice.edges is None:
        return None
    position, diameter = (grains.frame[name] for name in ("position", "diameter"))
    for k in (k for k in grains.edges if COMPONENTS[k] in grains.setup.periodic):
        low, high = grains.edges[k]
        x = position[:, k]
        outside = np.flatnonzero((x < low) | (x > high))
        if len(outside) < max(FEW, _MOVED * grains.count):
            continue
        rows = outside[:: max(1, len(outside) // _FEW_MOVED)][:_FEW_MOVED]
        before = 0
        after = 0
        for row in rows:
            away = position - position[row]
            touching = 0.5 * _ON_OTHERS * (diameter + diameter[row])
            # the grain itself is one of them
            before += int(np.count_nonzero((away**2).sum(axis=1) < touching**2) > 1)
            moved = grains.lattice.shortest(away)
            after += int(np.count_nonzero((moved**2).sum(axis=1) < touching**2) > 1)
        if after <= 0.5 * len(rows) or before > 0.1 * len(rows):
            continue
        axis = COMPONENTS[k]
        return (
            f"the box is periodic along {axis!r} with a length of {high - low:.4g}, and grains lie at {x.min():.4g} to "
            f"{x.max():.4g}: {after} of {len(rows)} grains outside the box that were looked at lie on others once they "
            "are moved inside, so that volume fractions and stresses are too large. The box is too short or in another "
            f"unit: give its edges, box={{{axis!r}: (low, high)}}, or periodic= without {axis!r}"
        )
    return None


# --- masses and densities ------------------------------------------------------------------------


def _contradiction(grains: Particles) -> str | None:
    """Check that masses are densities times volumes."""
    if not {"mass", "diameter", "volume", "density"} <= set(grains.frame):
        return None
    sample = grains.sample
    mass, volume, density, d = (sample[name] for name in ("mass", "volume", "density", "diameter"))
    expected = density * volume
    wrong = np.flatnonzero((np.abs(mass - expected) > _DIGITS * expected) & (mass > 0))
    if not wrong.size:
        return None
    row = wrong[0]
    numbers = (
        f"{wrong.size} of {len(mass)} particles looked at, such as id {sample['particle_id'][row]}: mass "
        f"{mass[row]:.6g}, density {density[row]:.6g}, diameter {d[row]:.6g}, volume {volume[row]:.6g}"
    )
    thickness = mass / (density * np.pi / 4 * d**2)
    depth = thickness.mean()
    varied = np.std(d) > _VARIED * np.mean(d)
    # of equal grains only a thickness of 1 shows discs, which two-dimensional simulations have
    is_one = abs(depth / grains.setup.scales[0] - 1) < _SAME
    if np.std(thickness) < _SAME * depth and (varied or is_one):
        return (
            f"masses fit discs of thickness {depth:.4g}, m = rho pi r^2 times that, and volumes do not ({numbers}): "
            f"give shape='disc' and thickness={depth:.4g}{_with_dimension(grains.setup)}"
        )
    return (
        f"masses are not density times volume ({numbers}): check the units of these columns, or drop one of them, "
        "such as names={'density': None}"
    )


def _volumes_of_shapes(grains: Particles) -> str | None:
    """Check that volumes agree with ellipsoids or superquadrics of the half-axes."""
    sample = grains.sample
    axes = [f"half_axis_{axis}" for axis in COMPONENTS]
    if not {"volume", *axes} <= set(sample):
        return None
    n1, n2 = (sample.get(name, 2.0) for name in ("exponent_1", "exponent_2"))
    volume, _, _ = superquadric_integrals(n1, n2)
    for name in axes:
        volume = volume * sample[name]
    ratio = float(np.median(sample["volume"] / volume))
    if abs(ratio - 1) <= _SHAPE:
        return None
    way_out = "check the units of the columns, or drop the wrong one, names={'column': None}"
    if abs(ratio / 8 - 1) <= _SHAPE:
        way_out = "the columns of whole axes hold half-axes: map them, names={'shapex': 'half_axis_x', ...}"
    elif abs(ratio * 8 - 1) <= _SHAPE:
        way_out = "the columns of half-axes hold whole axes: map them, names={'shapex': 'whole_axis_x', ...}"
    return (
        f"volumes, or masses over densities, are {ratio:.4g} times those of the half-axes (the median; in the first "
        f"row {sample['volume'][0]:.6g}, and {axes[0]} is {sample[axes[0]][0]:.6g}): {way_out}"
    )


def _with_dimension(setup: Setup) -> str:
    return " and dimension=2" if setup.dimension == 3 else ""


def _large_volumes(grains: Particles) -> str | None:
    """Check that volumes do not exceed pi d^3 / 6."""
    named = {"diameter", "volume", "mass"} <= set(grains.frame)
    if not named or grains.setup.shape != "sphere" or "half_axis_x" in grains.frame:
        return None
    d = grains.sample["diameter"]
    volume = grains.sample["volume"]
    ratio = np.median(volume / (np.pi / 6 * d**3))
    if ratio <= 1 + _DIGITS:
        return None
    return (
        f"volumes are {ratio:.4g} times those of spheres with the diameters (the median; in the first row volume "
        f"{volume[0]:.6g} and diameter {d[0]:.6g}): a column holds radii in place of diameters or has another "
        "unit, or grains are discs (shape='disc', thickness=). Drop the wrong column, names={'column': None}"
    )


def _discs(grains: Particles) -> str | None:
    """Check that masses of spheres do not go with the square of the diameter."""
    if not {"mass", "diameter", "volume"} <= set(grains.frame) or grains.setup.shape != "sphere":
        return None
    d, mass, volume = (grains.sample[name] for name in ("diameter", "mass", "volume"))
    varied = len(d) >= FEW and np.std(d) >= _VARIED * np.mean(d)
    if not varied or not np.allclose(volume, np.pi / 6 * d**3, rtol=1e-6, atol=0):
        return None
    if np.std(mass / d**2) >= _SAME * np.mean(mass / d**2):
        return None
    return (
        "masses go with the square of the diameter, as those of discs, and volumes and densities are taken to be "
        f"those of spheres: give shape='disc' and thickness={_with_dimension(grains.setup)}"
    )


def _layer(grains: Particles) -> str | None:
    """Check that grains of a volume do not all lie in a plane.

    A box of at most three diameters across the plane is the layer's thickness.
    """
    if grains.is_volume or grains.setup.dimension == 2 or grains.count < FEW:
        return None
    flat = np.flatnonzero(np.ptp(grains.sample["position"], axis=0) == 0)
    position = grains.frame["position"]
    if len(flat) != 1 or np.ptp(position[:, flat[0]]):
        return None
    low, high = grains.edges.get(flat[0], (-np.inf, np.inf))
    if high - low <= _FLAT_BOX * grains.diameter:
        return None
    axis = COMPONENTS[flat[0]]
    plane = "".join(a for a in COMPONENTS if a != axis)
    named = "" if plane == "xy" else f", plane={plane!r}"
    return (
        f"all {grains.count} grains have {axis} = {position[0, flat[0]]:g}, and the scene is taken as "
        f"three-dimensional: give dimension=2{named} if it is one layer, with thickness= where volumes matter"
    )


def _density_in_si(grains: Particles) -> str | None:
    """Check that small grains of a scene in SI units have a density of a solid."""
    if grains.setup.unit_system != "SI" or "density" not in grains.frame:
        return None
    densities = grains.sample["density"]
    # grains without mass have none, and one of 1 is of scaled data
    densities = densities[(densities > 0) & (densities != 1)]
    if len(densities) < FEW or not grains.diameter < _LARGE:
        return None
    density = float(np.median(densities))
    low, high = _DENSITIES
    if low <= density <= high:
        return None
    return (
        f"the density of the grains is {density:.4g} kg m-3 (the median), and solids have {low:g} to {high:,.0f}; the "
        f"mean diameter is {grains.diameter:.4g} m: check the units of masses, sizes and density, and give factors "
        "to SI, such as units={'length': 1e-3}, or units='reduced' for scaled data"
    )


def _unused_density(grains: Particles) -> str | None:
    """Check that the data hold no masses or densities other than density=."""
    argument = grains.setup.density
    if argument is None:
        return None
    if "density" not in grains.frame:
        if "mass" not in grains.frame:
            return None
        return (
            f"density={argument:g} is not used, as the data hold masses and no sizes: leave it out, or give "
            "sizes, a column or diameter="
        )
    density = grains.sample["density"]
    if np.abs(density / argument - 1).max() <= _DIGITS:
        return None
    return (
        f"density={argument:g} is not used, as the data hold masses or densities (densities are "
        f"{density.min():.6g} to {density.max():.6g}): leave it out, or drop these columns, "
        "names={'mass': None, 'density': None}"
    )


def _unused_size(grains: Particles) -> str | None:
    """Check that the data hold no diameters or masses other than diameter= and mass=."""
    for name in ("diameter", "mass"):
        argument = getattr(grains.setup, name)
        if argument is None or name not in grains.frame:
            continue
        values = grains.sample[name]
        if np.abs(values / argument - 1).max() > _DIGITS:
            return (
                f"{name}={argument:g} is not used, as the data hold others ({values.min():.6g} to "
                f"{values.max():.6g}): leave it out, or drop their column, names={{'column': None}}"
            )
    return None


Check = Callable[[Particles], str | None]
_OF_LENGTHS: tuple[Check, ...] = (
    _overfilled_space,
    _factor_of_sizes,
    _order_of_axes,
    _grains_outside,
    _wide_box,
    _overfilled_box,
    _short_period,
)
_OF_MASSES: tuple[Check, ...] = (
    _contradiction,
    _volumes_of_shapes,
    _large_volumes,
    _discs,
    _layer,
    _density_in_si,
)
_OF_ARGUMENTS: tuple[Check, ...] = (_unused_density, _unused_size)


# --- two steps -----------------------------------------------------------------------------------


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
    rows = rows_of(second["particle_id"], first["particle_id"][some])
    before = {name: values[some][rows >= 0] for name, values in first.items()}
    after = {name: values[rows[rows >= 0]] for name, values in second.items()}
    if len(after["position"]) < FEW:
        return
    moved = after["position"] - before["position"]
    expected = 0.5 * lapse * (before["velocity"] + after["velocity"])
    if "image" in before and "image" in after and len(lattice.given):
        moved += (after["image"] - before["image"])[:, lattice.axes] @ lattice.given
    elif len(lattice.given):
        # whole periods are unknown, and motion by more than half of one has no direction
        moved = lattice.shortest(moved)
        periods = lattice.period
        if lattice.vectors is not None:
            periods = np.full(3, np.linalg.norm(lattice.given, axis=1).min())
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
