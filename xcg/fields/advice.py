"""Warnings about requests whose fields are noise or in another unit, from scene and plan; nothing is read."""

from __future__ import annotations

import math

import numpy as np

from xcg.common.messages import warn_once
from xcg.fields.formulas import registry
from xcg.fields.formulas.averages import second_moment, squared_integral, takes_stress_of_step
from xcg.fields.formulas.field import Support
from xcg.fields.plan import Plan
from xcg.fields.sums.kernels import Kernel
from xcg.scene.description import Description

# Share of the usual value of a field above which its floor is a reason for a warning.
_CONSIDERABLE = 0.2


def advise(scene: Description, plan: Plan, *, named: bool) -> None:
    """Warn of fields whose values in single steps are far from those of averages, or from the truth.

    `named` is whether they were asked for by name.
    """
    if plan.is_narrow:
        return  # the plan has warned of the cause
    for about, advice in _ADVICE.items():
        text = advice(scene, plan, named)
        if text:
            warn_once(about, text)


def _few_grains(scene: Description, plan: Plan, named: bool) -> str:
    """Return a warning if norms and eigenvalues of few grains or contacts are noise; "" if they are not.

    Nearly every map has such fields among those that come by default: these say it by an attribute.
    """
    support = support_of(scene, plan) if named else None
    if support is None:
        return ""
    floors = floors_of(plan, support)
    large = [name for name, (floor, usual) in floors.items() if floor > _CONSIDERABLE * usual]
    if not large:
        return ""
    values = ", ".join(f"{name} of about {_number(plan, name, floors[name][0])}" for name in large)
    return (
        f"single steps show {values} where the true value is 0, as a node sees only about {support.text()}: take the "
        f"time_average of the result, average along axes (axes=), or increase width= (it is {plan.kernel.width:.3g})"
    )


def _without_friction(scene: Description, plan: Plan, named: bool) -> str:
    """Return a warning if a redundancy counts sliding contacts as sticking; "" if it does not."""
    if "redundancy_number" not in plan.asked or plan.options.sliding:
        return ""
    return (
        "redundancy_number without friction= counts sliding contacts as sticking: where all slide it is "
        f"{scene.setup.dimension} times too large. Pass friction=, the coefficient between the grains (0 without, "
        "a large one where none slides)"
    )


# Ratio of the largest to the smallest mass above which the bulk's temperature is off by 5 % or more
# in equilibrium (sizes 0.85 to 1.15, volume fraction 0.2, default width: 9 %).
_ALIKE = 2.0
_BIAS = 0.05


def _mixed_masses(scene: Description, plan: Plan, named: bool) -> str:
    """Return a warning if a temperature was asked for of grains of different masses together; "" if not.

    Where the temperature is one of all fields, nobody asked for it: packings of many sizes, most of
    them at rest, would all warn.
    """
    fields = [name for name in _OF_ONE_VARIANCE if name in plan.asked]
    smallest = scene.sizes.get("dmin", 0.0)
    if not named or not fields or plan.options.temperature != "unbiased" or not smallest > 0:
        return ""
    masses = (scene.sizes["dmax"] / smallest) ** 3
    if masses <= _ALIKE:
        return ""
    # at most the share that the fit of velocity and gradient takes, if only the slow grains lose it
    support = support_of(scene, plan)
    if support is not None and (1 + len(plan.deposit.grid.seen)) / support.grains < _BIAS:
        return ""
    return (
        f"{', '.join(fields)} of grains whose masses differ by {masses:.2g} assumes that all have the same variance of "
        "velocities: where light grains are faster, as in equilibrium, it is too large. Pass by= of species or of "
        "ds.cg.find_phases(...): each phase then has its temperature, and the bulk their mean by mass"
    )


_LONG = 50.0  # extents of the scene by which extent= is in another unit, most likely


def _long_extent(scene: Description, plan: Plan, named: bool) -> str:
    """Return a warning if the length of an average is many times that of the scene; "" if it is not."""
    if scene.cylindrical:
        return ""
    for axis, length in plan.extent.items():
        known = _length(scene, axis, scene.sizes.get("d43", np.nan))
        if not length or not length > _LONG * known:
            continue
        return (
            f"extent={{{axis!r}: {length:.4g}}} is {length / known:.3g} times the length of the scene along {axis!r} "
            f"({known:.4g} m), so that sums over it are as many times too small: lengths are in m. Leave it out where "
            f"the box has edges along {axis!r}, or give extent={{{axis!r}: {known:.4g}}}"
        )
    return ""


_OF_ONE_VARIANCE = ("granular_temperature", "directional_temperature", "mixture_temperature")

# what a warning is about, and a function of scene, plan and whether fields were named
_ADVICE = {
    "few grains": _few_grains,
    "redundancy without friction": _without_friction,
    "mixed masses": _mixed_masses,
    "long extent": _long_extent,
}


def lost_share(scene: Description, plan: Plan) -> float:
    """Return the share of the kinetic stress that single steps lack, 1 / N_eff; 0 if no requested field takes it."""
    takes = any(
        takes_stress_of_step(registry.row(name, plan.options), plan.options) for name in plan.asked
    )
    support = support_of(scene, plan) if takes else None
    if support is None:
        return 0.0
    return 1.0 / support.grains


def text_of_floors(scene: Description, plan: Plan) -> str | None:
    """Return the floors of the requested fields in words, None where no field has one."""
    support = support_of(scene, plan)
    if support is None:
        return None
    floors = floors_of(plan, support)
    if not floors:
        return None
    values = ", ".join(
        f"{name} {_number(plan, name, floor)}" for name, (floor, _) in floors.items()
    )
    return f"{values} in one step where the true value is 0, from {support.text()} at a node"


def describe_floors(scene: Description, plan: Plan) -> dict[str, str]:
    """Return the floor of each requested field that has one, in words, for its attributes."""
    if all(registry.row(name, plan.options).floor is None for name in plan.asked):
        return {}
    support = support_of(scene, plan)
    if support is None:
        return {}
    return {
        name: f"about {_number(plan, name, floor)} where the true value is 0"
        for name, (floor, _) in floors_of(plan, support).items()
    }


def _number(plan: Plan, name: str, floor: float) -> str:
    """Return a floor with its unit."""
    return f"{floor:.2g} {registry.row(name, plan.options).floor_units}".rstrip()


def floors_of(plan: Plan, support: Support) -> dict[str, tuple[float, float]]:
    """Return floor and usual value of each requested field that has a floor."""
    floors = {}
    for name in plan.asked:
        row = registry.row(name, plan.options)
        if row.floor is not None:
            floors[name] = row.floor(support), row.usual
    return floors


def support_of(scene: Description, plan: Plan) -> Support | None:
    """Return the effective numbers of a node, of grains that fill their extent evenly.

    None for widths by group, whose weights are not those of one kernel, and where sizes, extent or
    the box are not known. Of the rings of a cylinder it is that of the middle one.
    """
    grid = plan.deposit.grid
    count = scene.counts["particle"]
    other_weights = len(plan.deposit.cutoffs) > 1
    size = scene.sizes.get("d43", np.nan)
    filled = _extent(scene, size)
    lengths = [
        length or np.ptp(scene.edges.get(a, (0.0, np.inf))) for a, length in plan.extent.items()
    ]
    if other_weights or not count or not np.isfinite([filled, *lengths]).all():
        return None
    d = scene.setup.dimension
    seen = len(grid.seen)
    if scene.cylindrical and "theta" not in grid.coords:
        seen -= 1
        lengths.append(2 * math.pi * float(np.median(grid.coords["r"])))
    # in a unit of the space that the kernel sees
    number = count / filled * math.prod(lengths)
    partners = 2 * scene.counts["contact"] / count
    grains = max(1.0, number / squared_integral(plan.kernel, seen))
    share = {2: math.pi / 4, 3: math.pi / 6}[d] * size**d * count / filled
    return Support(
        grains=grains,
        contacts=max(1.0, grains * partners / 2),
        partners=partners,
        dimension=d,
        slope=_slope(plan.kernel, seen, d, number) * size,
        volume_fraction=share,
    )


def _extent(scene: Description, size: float) -> float:
    """Return the volume (in a layer the area) of the box around the grains; NaN where it is not known."""
    box = math.prod(_length(scene, a, size) for a in scene.setup.plane)
    if scene.cylindrical and not {"x", "y"} & scene.periods.keys():
        return box * math.pi / 4  # a disc in its square
    return box


def _length(scene: Description, axis: str, size: float) -> float:
    """Return the period along an axis, or the extent of the grains; NaN where it is not known."""
    if axis in scene.periods:
        return scene.periods[axis]
    if scene.corners is None:
        return np.nan
    k = "xyz".index(axis)
    return scene.corners[1][k] - scene.corners[0][k] + size


def _slope(kernel: Kernel, seen: int, dimension: int, number: float) -> float:
    """Root mean square of |dev Gamma| of independent velocities with the variance 1 along each axis (m^-1).

    Each of the components of the gradient along the axes that are seen has the variance
    ``S = int Psi^2 x^2 / n (int Psi x^2)^2``, of n grains in a unit of what the kernel sees.
    """
    if not seen:
        return 0.0
    r, step = np.linspace(0.0, kernel.cutoff, 2001, retstep=True)
    shells = {1: 2.0 * r**2, 2: np.pi * r**3, 3: 4 / 3 * np.pi * r**4}[seen]
    psi = kernel.value(r, seen)
    squares = np.trapezoid(psi**2 * shells, dx=step)
    components = seen * (dimension + 1 - 2 / dimension)
    return math.sqrt(float(squares) * components / number) / second_moment(kernel, seen)
