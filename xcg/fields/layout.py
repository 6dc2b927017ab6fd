"""Layout of a result: nodes, averaged axes, the kernels that reach them, and the memory of the mesh."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np

from xcg.common.compat import is_in_memory
from xcg.compiled import smoothing as kinds
from xcg.fields.formulas import registry
from xcg.fields.formulas.field import Options
from xcg.fields.grids.frames import Cylindrical
from xcg.fields.grids.grid import MeshTooLargeError, make_grid
from xcg.fields.grids.points import make_points
from xcg.fields.grids.rings import letters_of, make_rings
from xcg.fields.request import Request
from xcg.fields.sums.kernels import Kernel, kernel_of, resolve_length
from xcg.fields.sums.nodes import Nodes
from xcg.scene.scene import Scene
from xcg.scene.schema import COMPONENTS, PADDING, known_without_reading

_NARROW = 0.1  # widths, in mean diameters, that show single grains only
_WIDE = 300  # largest diameters; a width beyond is in another unit, most likely


def nodes_of(scene: Scene, request: Request, kernels: Sequence[Kernel]) -> Nodes:
    """Return the nodes: points where coordinates are arrays, rings in a cylindrical frame, else a mesh."""
    plane = scene.setup.plane
    at: Mapping[str, Any] = request.at or {}
    smallest = min(kernels, key=lambda k: k.cutoff)
    if not scene.cylindrical and any(np.ndim(coordinate) > 0 for coordinate in at.values()):
        _check_pointwise(request)
        return make_points(at, plane=plane, cutoff=smallest.cutoff)
    spacing: Any = smallest.width
    if request.spacing is not None:
        spacing = _spacing_of(scene, request.spacing)
    automatic = automatic_bounds(scene, max(k.cutoff for k in kernels))
    if scene.cylindrical:
        return _rings_of(scene, request, smallest, spacing, automatic)
    return make_grid(
        request.axes_of(plane),
        at,
        request.bounds or {},
        spacing,
        plane=plane,
        cutoff=smallest.cutoff,
        automatic=automatic,
        period=scene.periods,
    )


def _rings_of(
    scene: Scene,
    request: Request,
    kernel: Kernel,
    spacing: Any,
    automatic: Mapping[str, Sequence[float]],
) -> Nodes:
    """Lay the nodes of a cylinder, see `make_rings`."""
    assert isinstance(request.frame, Cylindrical)
    if request.gradient == "finite_difference":
        raise ValueError(
            "gradient='finite_difference' takes a mesh along x, y and z, and a cylindrical frame has none: "
            "leave it out"
        )
    plane = scene.setup.plane
    return make_rings(
        request.axes_of(letters_of(plane)),
        request.at or {},
        request.bounds or {},
        spacing,
        plane=plane,
        kernel=kernel,
        error=request.frame.error,
        automatic=automatic,
        period=scene.periods,
    )


def _spacing_of(scene: Scene, spacing: Any) -> float | dict[str, float]:
    """Return the distance of nodes (m), for all axes or by axis, of the argument `spacing`."""
    advice = "by default it is the width"
    if isinstance(spacing, str):
        return resolve_length("spacing", spacing, scene.sizes, advice)
    if not isinstance(spacing, Mapping):
        return cast(float, spacing)
    lengths = dict(spacing)
    for axis, length in spacing.items():
        if isinstance(length, str):
            lengths[axis] = resolve_length(f"spacing[{axis!r}]", length, scene.sizes, advice)
    return lengths


def _check_pointwise(request: Request) -> None:
    """Raise ValueError for options that only meshes have."""
    for name in ("axes", "bounds", "spacing"):
        if getattr(request, name):
            raise ValueError(
                f"{name}={getattr(request, name)!r} lays a mesh, and at= has arrays, which name points: leave it out "
                "(axes that at= does not name are averaged), or give the nodes along an axis as one more array of at=, "
                "such as xr.DataArray(z, dims='z'), which broadcasts against the others"
            )
    if request.gradient == "finite_difference":
        raise ValueError(
            "gradient='finite_difference' takes differences between the nodes of a mesh, and points have no "
            "neighbours: take gradient='least_squares' or 'kernel'"
        )


def automatic_bounds(scene: Scene, cutoff: float) -> dict[str, tuple[float, float]]:
    """Bounds by default: the period, or the particles' extent with their supports, or the box they were read with."""
    periodic = scene.setup.periodic
    bounds = dict(scene.edges)
    if not known_without_reading(scene.ds, "position"):
        # a box does not follow positions that were changed
        bounds = {a: ends for a, ends in bounds.items() if a in periodic}
    if scene.corners is not None:
        for a, low, high in zip(COMPONENTS, *scene.corners, strict=True):
            if a not in periodic or a not in scene.edges:
                bounds[a] = (low - cutoff, high + cutoff)
    if scene.cylindrical and {"x", "y"} <= bounds.keys() and scene.radius is not None:
        bounds["r"] = (0.0, scene.radius + cutoff)
    return bounds


def takes_gradient(name: str, options: Options) -> bool:
    """Return whether a field follows from the velocity gradient."""
    if name == "velocity_gradient":
        return True
    if name == "fluctuation_stress":  # its fluctuations are about the mean without a gradient
        return False
    return any(
        takes_gradient(needed, options) for needed in registry.field_of(name, options).fields
    )


def extents_of(nodes: Nodes, extent: Mapping[str, float], scene: Scene) -> dict[str, float | None]:
    """Length of each averaged axis (m), None for that of the box of each step."""
    loose = [a for a in extent if a not in nodes.averaged]
    if loose:
        raise ValueError(
            f"extent names {loose}, but the averaged axes are {list(nodes.averaged)}: leave it out"
        )
    known = {*extent, *scene.edges}
    unknown = [a for a in nodes.averaged if a not in known and not scene.tilted]
    if unknown:
        edges = ", ".join(f"{a!r}: ({a}0, {a}1)" for a in unknown)
        lengths = ", ".join(f"{a!r}: length" for a in unknown)
        raise ValueError(
            f"fields are averaged along {' and '.join(map(repr, unknown))}, and the scene has no finite box there: "
            f"give its edges in xcg.open_scene or xcg.scene_from_arrays, box={{{edges}}}, or here the length that the "
            f"integral is divided by, extent={{{lengths}}}; or resolve or fix the axis (axes=, at=)"
        )
    return {a: float(extent[a]) if a in extent else None for a in nodes.averaged}


def kernels_of(scene: Scene, request: Request) -> list[Kernel]:
    """Return the kernel of all grains, or of each group where `width` maps groups to widths."""
    width = request.width
    if isinstance(width, Mapping):
        return _kernels_of_groups(scene, request, width)
    if width is None and isinstance(request.kernel, str) and "d43" not in scene.sizes:
        scene.require(("diameter",), "the usual width, 0.75 mean diameters,", "; or give width=")
    return [kernel_of(request.kernel, width, scene.sizes, scene.setup.dimension)]


def _kernels_of_groups(
    scene: Scene, request: Request, width: Mapping[int, float | str]
) -> list[Kernel]:
    """Return the kernel of each group."""
    by = request.by
    kernel = request.kernel
    dimension = scene.setup.dimension
    if by is None or not isinstance(kernel, str):
        raise ValueError(
            f"width={dict(width)!r} gives each group its own: name their variable with by=, and a kernel"
        )
    widths = {str(group): value for group, value in width.items()}
    groups = scene.groups(by, request.groups)
    if set(widths) != {str(group) for group in groups}:
        raise ValueError(
            f"width={dict(width)!r}: expected a width for each of the groups {list(groups)} of {by!r}"
        )
    return [kernel_of(kernel, widths[str(group)], scene.sizes, dimension) for group in groups]


def undercut_size(scene: Scene, request: Request, width: float) -> str | None:
    """Return the name of a size for which a width (m) is so narrow that the kernel sees single grains, or None.

    `width` is the least one where each group has its own.
    """
    sizes = scene.sizes
    compared = ["d43", "dmax"]
    if isinstance(request.width, Mapping):
        compared = ["dmin"]
    return next((s for s in compared if s in sizes and width < _NARROW * sizes[s]), None)


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


def check_differentiable(kernel: Kernel) -> None:
    """Raise ValueError for gradients of a kernel that has none."""
    if kernel.code == kinds.HEAVISIDE:
        raise ValueError(
            "gradient='kernel' needs a kernel that is differentiable: Heaviside is not; take gradient='least_squares'"
        )


LARGE = 1_000_000  # nodes, of such a mesh, below which nothing is said
_LARGEST = 100_000_000  # nodes, of such a mesh, whose width and spacing follow from sizes
_MIDDLE = 0.98  # share of the particles that the others are compared with


def too_large(scene: Scene, request: Request, width: float, error: MeshTooLargeError) -> str:
    """Return the message about a mesh of too many nodes, with its likely cause."""
    causes = [str(error), about_width(scene, width, undercut_size(scene, request, width))]
    if _by_sizes(request):
        causes.append("check that sizes and positions have one unit")
    causes.append(about_strays(scene))
    return "; ".join(filter(None, causes))


def _by_sizes(request: Request) -> bool:
    """Return whether width and spacing follow from the sizes of the grains."""
    return request.width is request.spacing is None and isinstance(request.kernel, str)


def check_size(scene: Scene, request: Request, grid: Nodes, numbers: int) -> None:
    """Raise ValueError unless a large automatic mesh, with so many numbers of fields a step, fits into memory at hand.

    Raises
    ------
    ValueError
        If the fields of one chunk do not fit into memory, or a mesh that follows from sizes alone
        has more than 1e8 nodes; particles that are far from the others are named.
    """
    if _by_sizes(request) and grid.count > _LARGEST:
        raise ValueError(
            f"the automatic mesh would have {' x '.join(map(str, grid.sizes))} nodes, more than {_LARGEST:g}, as its "
            f"spacing is 0.75 mean diameters (d43 = {scene.sizes.get('d43', np.nan):.4g}): check that sizes and "
            f"positions have one unit, or give width= or spacing=; {about_strays(scene)}"
        )
    if not grid.fitted:
        return
    ds = scene.ds
    # all steps, or those of the longest chunk of a lazy scene
    steps = max(ds["position"].chunksizes.get("time", (ds.sizes["time"], 1)))
    needed = 8 * numbers * steps
    free = memory_at_hand()
    shown = " x ".join(map(str, grid.sizes))
    if free is not None and needed > free:
        raise ValueError(
            f"the automatic mesh has {shown} nodes, and its fields take {needed / 1e9:.3g} GB at once where "
            f"{free / 1e9:.3g} GB are free: {about_strays(scene)}"
        )


def memory_at_hand() -> int | None:
    """Return the memory that is free (bytes), None where the system does not report it."""
    info = Path("/proc/meminfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return 1024 * int(line.split()[1])
    try:
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):  # Windows, macOS
        return None


def about_strays(scene: Scene) -> str:
    """Name the particle that is farthest from the others, or the extent where positions are not in memory."""
    way_out = "give bounds=, or a larger spacing=, or leave particles out with ds.cg.select"
    ds = scene.ds
    position = ds["position"].transpose("time", "particle", "component").variable
    if not is_in_memory(position):
        if scene.corners is None:
            return way_out
        ends = zip(COMPONENTS, *scene.corners, strict=True)
        extent = ", ".join(f"{a} from {low:.4g} to {high:.4g}" for a, low, high in ends)
        return f"particles extend over {extent}; some may have escaped; {way_out}"
    ids = ds["particle_id"].transpose("time", "particle").to_numpy()
    held = np.argwhere(ids != PADDING)
    of_grains = position.values[tuple(held.T)]
    low, high = np.quantile(of_grains, [(1 - _MIDDLE) / 2, (1 + _MIDDLE) / 2], axis=0)
    room = np.maximum(high - low, np.spacing(np.abs(of_grains).max()))
    beyond = np.maximum(low - of_grains, of_grains - high) / room
    if not (beyond > 1.0).any():
        return way_out
    t, row = held[int(beyond.max(axis=1).argmax())]
    x, y, z = position.values[t, row].tolist()
    return (
        f"particle {ids[t, row]} at ({x:.4g}, {y:.4g}, {z:.4g}) is far from the others; {way_out}"
    )
