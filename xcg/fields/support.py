"""Effective numbers of the grains that a node sees, and the values that fields of single steps show by them alone."""

from __future__ import annotations

import math

import numpy as np

from xcg.fields.formulas.field import Field, Support
from xcg.fields.plan import DENSE, Plan
from xcg.fields.sums.kernels import Kernel
from xcg.scene.scene import Scene

# volume of a sphere over that of the cube around it, in layers area of a disc over that of its square
_SHARE_OF_CUBE = {2: math.pi / 4, 3: math.pi / 6}


def text_of_floors(scene: Scene, plan: Plan) -> str | None:
    """Return the floors of the requested fields in words, None where no field has one."""
    support = support_of(scene, plan)
    if support is None:
        return None
    floors = floors_of(plan, support)
    if not floors:
        return None
    values = ", ".join(
        f"{name} {field.floor_text(floor)}" for name, (floor, field) in floors.items()
    )
    return f"{values} in one step where the true value is 0, from {support.text()} at a node"


def effective_count(scene: Scene, plan: Plan) -> float | None:
    """N_eff at a node for equal spheres (or discs in a layer) of d43 that fill the share `DENSE` of the space.

    None for rings and widths by group, whose weights follow from no single kernel.
    """
    averaged = _averaged_over(scene, plan)
    other_weights = scene.cylindrical or len(plan.cutoffs) > 1
    if other_weights or "d43" not in scene.sizes or not math.isfinite(averaged):
        return None
    d = scene.setup.dimension
    number = DENSE / (_SHARE_OF_CUBE[d] * scene.sizes["d43"] ** d) * averaged
    return number / plan.kernel.squared_integral(len(plan.nodes.active_axes))


def numbers_of_floors(plan: Plan, support: Support) -> dict[str, float]:
    """Return the floor of each requested field that has one, in two digits, for its attributes."""
    floors = floors_of(plan, support)
    return {name: float(f"{floor:.2g}") for name, (floor, _) in floors.items()}


def floors_of(plan: Plan, support: Support) -> dict[str, tuple[float, Field]]:
    """Return floor and definition of each requested field whose floor is known."""
    floors = {}
    for name in plan.requested:
        field = plan.definitions[name]
        floor = field.floor(support) if field.floor is not None else math.nan
        if math.isfinite(floor):
            floors[name] = floor, field
    return floors


def support_of(scene: Scene, plan: Plan) -> Support | None:
    """Return the effective numbers of a node, of grains that fill their extent evenly.

    None for widths by group, whose weights follow from no single kernel, and where sizes, extent or
    the box are not known. For the rings of a cylinder it is the support of the middle one.
    """
    grid = plan.nodes
    count = scene.ds.sizes.get("particle", 0)
    other_weights = len(plan.cutoffs) > 1
    size = scene.sizes.get("d43", np.nan)
    filled = _extent(scene, size)
    # empty parts of a box hold no grains
    averaged = math.prod(length_along(scene, a, size) for a in plan.extent)
    if other_weights or not count or not np.isfinite(filled):
        return None
    d = scene.setup.dimension
    seen = len(grid.active_axes)
    if scene.cylindrical and "theta" not in grid.coords:
        seen -= 1
        averaged *= 2 * math.pi * float(np.median(grid.coords["r"]))
    # in a unit of the space that the kernel sees
    number = count / filled * averaged
    partners = 2 * scene.ds.sizes.get("contact", 0) / count
    # no more than there are, where the support holds more than the space that they fill
    grains = max(1.0, min(number / plan.kernel.squared_integral(seen), count))
    share = _SHARE_OF_CUBE[d] * size**d * count / filled
    return Support(
        grains=grains,
        contacts=max(1.0, grains * partners / 2),
        partners=partners,
        dimension=d,
        slope=_slope(plan.kernel, seen, d, number) * size,
        volume_fraction=share,
        diameter=float(size),
    )


def _averaged_over(scene: Scene, plan: Plan) -> float:
    """Return the product of the lengths that are averaged over (m^n); infinity where one is not known."""
    lengths = [
        length or np.ptp(scene.edges.get(a, (0.0, np.inf))) for a, length in plan.extent.items()
    ]
    return math.prod(lengths)


def _extent(scene: Scene, size: float) -> float:
    """Return the volume (in a layer the area) of the box around the grains; NaN where it is not known."""
    box = math.prod(length_along(scene, a, size) for a in scene.setup.plane)
    if scene.cylindrical and not {"x", "y"} & scene.periods.keys():
        return box * math.pi / 4  # a disc in its square
    return box


def length_along(scene: Scene, axis: str, size: float) -> float:
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
    r, psi = kernel.sampled(seen)
    shells = {1: 2.0 * r**2, 2: np.pi * r**3, 3: 4 / 3 * np.pi * r**4}[seen]
    squares = np.trapezoid(psi**2 * shells, dx=r[1])
    components = seen * (dimension + 1 - 2 / dimension)
    return math.sqrt(float(squares) * components / number) / kernel.second_moment(seen)
