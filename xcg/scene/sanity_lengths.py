"""Checks that sizes, positions and the box of a scene have one unit, and the axes one order.

Each returns a message, or None.
"""

from __future__ import annotations

from itertools import permutations

import numpy as np

from xcg.scene.sanity_sample import FEW, Particles
from xcg.scene.schema import COMPONENTS

_MOST_FILLED = 100.0  # grains in the cube of a diameter, also of glued ones that overlap
# Nearest distances over sums of radii pile up at 1 in a packing. Where they pile up at another
# factor, sizes are off by it.
_FACTORS = (2.0, 0.5, *(f * 10.0**k for k in (1, 2, 3, 4, 6) for f in (1.0, 2.0)), 0.1, 0.01, 1e-3)
_PILE = (0.93, 1.03)  # range of the distances of grains that touch, over the factor
_PILED = 0.25  # share of the grains in this range
_LOWEST = 0.9  # 5th percentile of the distances, over the factor
_REGULAR = 1e-4  # scatter of the distances in a lattice, which may be as loose as one likes
# neighbours, of eight, that overlap by a tenth if sizes are doubled
_OVERLAPPING = {2: 4.0, 3: 6.0}

_OUTSIDE = 0.01  # share of the grains that are farther from the box than its length
_MOST_OUTSIDE = 0.5  # share of the grains outside the box
_OTHER_ORDER = 0.2  # share of the grains outside the box along an axis, if axes are swapped
_EDGE = 0.02  # of the length of the box, by which grains may lie outside
_OVERFULL = 30.0  # volume of the grains over that of the box, also of glued ones that overlap
_WIDE = 50.0  # length of a box over the extent of the grains along each axis

_MOVED = 0.05  # least share of the grains outside periodic edges
_FEW_MOVED = 16  # of these that are looked at
_ON_OTHERS = 0.8  # distance over the sum of radii of grains that lie on one another


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
    low, high = _PILE
    for factor in _FACTORS:
        piled = float(((nearest >= low * factor) & (nearest <= high * factor)).mean())
        if nearly_least < _LOWEST * factor or piled < _PILED:
            continue
        if factor > 1 and grains.is_lattice:
            return None
        near = (distances < 1.8 * factor).sum(axis=1).mean()
        if factor < 1 and near < _OVERLAPPING[len(grains.setup.axes)]:
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
    position = grains.frame["position"]
    diameter = grains.frame["diameter"]
    for k, (low, high) in grains.edges.items():
        if COMPONENTS[k] not in grains.setup.periodic:
            continue
        x = position[:, k]
        outside = np.flatnonzero((x < low) | (x > high))
        if len(outside) < max(FEW, _MOVED * grains.count):
            continue
        some = outside[:: max(1, len(outside) // _FEW_MOVED)][:_FEW_MOVED]
        before = 0
        after = 0
        for index in some:
            away = position - position[index]
            touching = 0.5 * _ON_OTHERS * (diameter + diameter[index])
            # the grain itself is one of them
            before += int(np.count_nonzero((away**2).sum(axis=1) < touching**2) > 1)
            moved = grains.lattice.shortest(away)
            after += int(np.count_nonzero((moved**2).sum(axis=1) < touching**2) > 1)
        if after <= 0.5 * len(some) or before > 0.1 * len(some):
            continue
        axis = COMPONENTS[k]
        return (
            f"the box is periodic along {axis!r} with a length of {high - low:.4g}, and grains lie at {x.min():.4g} to "
            f"{x.max():.4g}: {after} of {len(some)} grains outside the box that were looked at lie on others once they "
            "are moved inside, so that volume fractions and stresses are too large. The box is too short or in another "
            f"unit: give its edges, box={{{axis!r}: (low, high)}}, or periodic= without {axis!r}"
        )
    return None


OF_LENGTHS = (
    _overfilled_space,
    _factor_of_sizes,
    _order_of_axes,
    _grains_outside,
    _wide_box,
    _overfilled_box,
    _short_period,
)
