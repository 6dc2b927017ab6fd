"""Warnings about what a call makes of a scene, from scene and plan; nothing is read.

Each piece of advice is a function of what it is about, called only where a plan has that, and warns
once a call. None changes a result.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.compat import is_in_memory
from xcg.common.messages import warn_once
from xcg.fields.formulas.rules import takes_stress_of_step
from xcg.fields.layout import LARGE, about_strays, takes_gradient
from xcg.fields.plan import Plan
from xcg.fields.sums.kernels import Kernel
from xcg.fields.sums.nodes import Nodes
from xcg.fields.support import length_along, support_of
from xcg.scene.scene import Scene
from xcg.scene.schema import COMPONENTS, PADDING
from xcg.scene.times import times_are_known

_WIDE = 300  # largest diameters; a width beyond is in another unit, most likely
_MANY = 1000  # nodes a particle, of a mesh that was laid around the particles
_LONG = 50.0  # extents of the scene by which extent= is in another unit, most likely
# Ratio of the largest to the smallest mass above which the bulk's temperature is off by 5 % or more
# in equilibrium (sizes 0.85 to 1.15, volume fraction 0.2, default width: 9 %).
_ALIKE = 2.0
_BIAS = 0.05
_OF_ONE_VARIANCE = ("granular_temperature", "directional_temperature", "mixture_temperature")


def advise(scene: Scene, plan: Plan) -> None:
    """Warn of empty scenes, and of nodes and kernels that are hardly meant."""
    options = plan.options
    if options.averaged_gradient == "unknown":
        _warn_of_unknown_gradients(plan)
    text = about_width(scene, min(plan.widths), plan.undercut)
    if text:
        warn_once("width", text)
    has_cut = len(plan.nodes.active_axes) > len(plan.nodes.spacing)
    if has_cut and scene.periods and not scene.cylindrical:
        _warn_of_cuts(scene, plan)
    if options.gradient == "kernel" and {"mass_slope", "momentum_slope"} & plan.moments.keys():
        _warn_of_jumping_kernels(plan.kernel)
    if plan.nodes.fitted and plan.nodes.count >= LARGE:
        _warn_of_strays(scene, plan.nodes)
    ids = scene.columns["particle_id"]
    if not ids.size or (is_in_memory(ids) and not (ids.to_numpy() != PADDING).any()):
        _warn_of_nothing_left(scene.ds)


def advise_on_steps(scene: Scene, plan: Plan, *, named: bool) -> None:
    """Warn of fields that are far from the truth in single steps, and let the plan's steps warn of theirs.

    `named` is whether the user named the fields. Functions that measure the noise of single steps
    leave this advice out.
    """
    plan.named = named
    if "velocity" in plan.variables and scene.setup.periodic and scene.ds.sizes["time"] > 1:
        plan.stretch = _stretch_of(scene)
    if _depends_on_support(plan):
        plan.support = support_of(scene, plan)
    if plan.undercut is not None:  # `advise` has warned of the cause
        return
    if "redundancy_number" in plan.requested and not plan.options.sliding:
        _warn_of_unknown_sliding(scene.setup.dimension)
    variances = [name for name in _OF_ONE_VARIANCE if name in plan.requested]
    if variances and plan.named and plan.options.temperature == "unbiased":
        _warn_of_mixed_masses(scene, plan, variances)
    if any(plan.extent.values()) and not scene.cylindrical:
        _warn_of_long_extent(scene, plan.extent)


def _stretch_of(scene: Scene) -> NDArray | None:
    """Return the least and largest rates (3, 2) of a periodic box whose length changes; None where none do.

    None as well where the rates were given, as images move with such a box.
    """
    ds = scene.ds
    box = scene.columns.get("box")
    moves = "lattice_velocity" in scene.columns
    if box is None or moves or "time" not in box.dims:
        return None
    if not is_in_memory(box) or not times_are_known(ds):
        return None
    lengths = np.diff(box.to_numpy(), axis=-1)[..., 0]
    periodic = [axis in scene.setup.periodic for axis in COMPONENTS]
    lengths = np.where(periodic, lengths, 1.0)
    if (lengths == lengths[0]).all():
        return None
    rates = np.diff(np.log(lengths), axis=0) / np.diff(ds["time"].to_numpy())[:, None]
    return np.stack([rates.min(axis=0), rates.max(axis=0)], axis=1)


def _depends_on_support(plan: Plan) -> bool:
    """Return whether a requested field of single steps depends on how many grains a node sees."""
    options = plan.options
    fields = [plan.definitions[name] for name in plan.requested]
    follows_grains = {*_OF_ONE_VARIANCE, "segregation_flux"}
    if plan.about_means or follows_grains & {*plan.requested}:
        return True
    if any(field.floor is not None for field in fields):
        return True
    return any(takes_stress_of_step(field, options) for field in fields)


# --- of all plans ----------------------------------------------------------------------------------


def _warn_of_unknown_gradients(plan: Plan) -> None:
    """Warn of fields of a velocity gradient that no axis shows."""
    lost = [name for name in plan.requested if takes_gradient(name, plan.options)]
    if lost:
        text = (
            f"{', '.join(lost)}: NaN, as no axis is resolved or fixed, and so the velocity has no neighbours to differ "
            "from: resolve the axis that it varies along, axes='z' for example, and average the result"
        )
        warn_once("unknown gradients", text)


def about_width(scene: Scene, width: float, undercut: str | None) -> str:
    """Return why a width (m) is hardly meant, "" if it may be; `undercut` as in a plan."""
    sizes = scene.sizes
    largest = sizes.get("dmax", math.inf)
    extent = math.inf
    if scene.corners is not None:
        lengths = [high - low for low, high in zip(*scene.corners, strict=True)]
        extent = max(*lengths, *scene.periods.values())
    if width > _WIDE * largest:
        return f"width={width:.4g} is {width / largest:.2g} largest diameters; check the unit of lengths"
    if width > extent > 0 and extent > 2 * largest:
        return (
            f"width={width:.4g} is larger than the scene, whose grains extend over {extent:.4g}: fields hardly vary, "
            "and most of the kernel is outside; check the unit of lengths (the usual choice is 0.75 mean diameters)"
        )
    if undercut is None:
        return ""
    size = sizes[undercut]
    whose = {"d43": "the grains", "dmax": "the largest grains", "dmin": "the smallest grains"}
    return (
        f"width={width:.4g} is {width / size:.2g} of the diameter of {whose[undercut]} ({size:.4g}): the "
        "kernel sees the inside of single grains, and no field of a continuum (volume fractions far above 1, "
        "too few particles per node); the usual choice is 0.75 mean diameters, see the page on width"
    )


def _warn_of_cuts(scene: Scene, plan: Plan) -> None:
    """Warn of fixed coordinates that lie outside a periodic box."""
    nodes = plan.nodes
    for k, a in enumerate(COMPONENTS):
        is_fixed = a in nodes.active_axes and a not in nodes.spacing
        if not is_fixed or a not in scene.periods:
            continue
        low, high = scene.edges[a]
        # grains and cuts of scenes that were shifted, or are not wrapped, are beyond an edge by up
        # to a period
        room = high - low + plan.kernel.cutoff
        ends = (nodes.lower[k], nodes.upper[k])
        beyond = [x for x in ends if not low - room <= x <= high + room]
        if beyond:
            text = (
                f"at={{{a!r}: {beyond[0]:g}}} is outside the box, which is periodic from {low:g} to {high:g} along "
                f"{a!r}: fields are those of the image inside; check the units of lengths"
            )
            warn_once(f"cut along {a}", text)


def _warn_of_jumping_kernels(kernel: Kernel) -> None:
    """Warn of gradients of a kernel that jumps, or whose slope does."""
    if kernel.smoothness == 0:
        text = (
            f"the {kernel.name} kernel is continuous, but its slope jumps at its cutoff: its gradient is exact almost "
            "everywhere, and the fields made of it jump where a grain comes into reach; take Lucy for smooth ones"
        )
        warn_once("kernel of gradients", text)
    elif not kernel.differentiable:
        text = (
            f"the {kernel.name} kernel jumps at its cutoff: its gradient leaves the jump out (8 % low for a Gaussian "
            "cut at 3 w); take Lucy, or gradient='least_squares'"
        )
        warn_once("kernel of gradients", text)


def _warn_of_strays(scene: Scene, nodes: Nodes) -> None:
    """Warn of a mesh with many nodes for each particle, as of particles that are far from the others."""
    particles = max(1, scene.ds.sizes["particle"])
    if nodes.count > _MANY * particles:
        text = (
            f"the automatic mesh has {' x '.join(map(str, nodes.sizes))} nodes, {nodes.count / particles:.3g} for each "
            f"particle: {about_strays(scene)}"
        )
        warn_once("strays", text)


def _warn_of_nothing_left(ds: xr.Dataset) -> None:
    """Warn of a selection that left no step or no particle, with the range of positions before."""
    if ds.sizes["particle"] and not ds.sizes["time"]:
        nothing = "no step is left, as of a selection of times that holds for none"
        warn_once("nothing left", f"{nothing}; fields are those of no grain")
        return
    # a scene that never had particles has no range
    if {"particle_lower", "particle_upper"} <= ds.attrs.keys():
        ends = zip(COMPONENTS, ds.attrs["particle_lower"], ds.attrs["particle_upper"], strict=True)
        ranges = ", ".join(f"{axis} {low:.4g} to {high:.4g}" for axis, low, high in ends)
        text = (
            "no particle is left, as of a selection whose condition holds for none: before, positions "
            f"were {ranges}; fields are those of no grain"
        )
        warn_once("nothing left", text)


# --- of fields of single steps ---------------------------------------------------------------------


def _warn_of_unknown_sliding(dimension: int) -> None:
    """Warn of a redundancy that counts sliding contacts as sticking."""
    warn_once(
        "redundancy without friction",
        "redundancy_number without friction= counts sliding contacts as sticking: where all slide it is "
        f"{dimension} times too large. Pass friction=, the coefficient between the grains (0 without, "
        "a large one where none slides)",
    )


def _warn_of_mixed_masses(scene: Scene, plan: Plan, fields: Sequence[str]) -> None:
    """Warn of a temperature that was asked for of grains of different masses together.

    Where the temperature is one of all fields, nobody asked for it: packings of many sizes, most of
    them at rest, would all warn.
    """
    smallest = scene.sizes.get("dmin", 0.0)
    if not smallest > 0:
        return
    masses = (scene.sizes["dmax"] / smallest) ** 3
    if masses <= _ALIKE:
        return
    # at most the share that the fit of velocity and gradient takes, if only the slow grains lose it
    support = plan.support
    if support is not None and (1 + len(plan.nodes.active_axes)) / support.grains < _BIAS:
        return
    text = (
        f"{', '.join(fields)} of grains whose masses differ by {masses:.2g} assumes that all have the same variance of "
        "velocities: where light grains are faster, as in equilibrium, it is too large. Pass by= of species or of "
        "ds.cg.find_phases(...): each phase then has its temperature, and the bulk their mean by mass"
    )
    warn_once("mixed masses", text)


def _warn_of_long_extent(scene: Scene, extent: Mapping[str, float | None]) -> None:
    """Warn of a length of an average that is many times that of the scene."""
    for axis, length in extent.items():
        of_scene = length_along(scene, axis, scene.sizes.get("d43", np.nan))
        if length and length > _LONG * of_scene:
            text = (
                f"extent={{{axis!r}: {length:.4g}}} is {length / of_scene:.3g} times the length of the scene along "
                f"{axis!r} ({of_scene:.4g} m), so that sums over it are as many times too small: lengths are in m. "
                f"Leave it out where the box has edges along {axis!r}, or give extent={{{axis!r}: {of_scene:.4g}}}"
            )
            warn_once("long extent", text)
