"""The share of the kernel that lies on the accessible side of walls, and fields per accessible volume.

``chi(r) = int Psi(r - r') dr'`` over the accessible side. Near a single plane it is the integral of
the kernel's marginal. Elsewhere the kernel is integrated exactly along rays from the node, between
their crossings of the walls, and over the directions of the rays by Gauss's rule about the normal
of the nearest wall. Averages along axes on which walls vary come from `xcg.fields.grids.sections`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
import xarray as xr
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray

from xcg.common.messages import warn_user
from xcg.fields.formulas.mean_sums import Averaging
from xcg.fields.grids.frames import Cylindrical
from xcg.fields.grids.rings import ring_points
from xcg.fields.grids.sections import GOLDEN, AveragedFraction, Span
from xcg.fields.grids.walls import Plane, Surface, Wall
from xcg.fields.plan import Plan
from xcg.fields.request import Request
from xcg.fields.sums.kernels import Kernel
from xcg.scene.facts import with_setup
from xcg.scene.scene import Scene
from xcg.scene.schema import COMPONENTS
from xcg.steps.mapping import is_lazy, shown

LEAST = 0.01  # of the kernel; nodes that see less have no fields per accessible volume
# rays: directions towards and away from the nearest wall, and around its normal
_POLAR = 12
_TURNS = 24
_BATCH = 256  # points at a time
_POINTS_TIMED = 256  # at most, of all
_LONG = 10.0  # seconds; longer work warns before it starts
_HAIR = 1e-9  # cutoffs; points that are nearer to a wall are on it
_ORDER = 24  # Gauss points of integrals over the kernel, exact for polynomials of Lucy's degree


def walls_of(request: Request) -> list[Wall]:
    """Return the walls of a request, in the axes of its frame.

    Raises
    ------
    ValueError
        For `per` without walls, and for walls with options that leave them no meaning.
    """
    if request.surfaces is None:
        if request.per is not None:
            raise ValueError(
                "per='accessible' needs surfaces=, for example surfaces=[xcg.Plane((0, 0, 0), (0, 0, 1))]"
            )
        return []
    if request.preset is not None:
        raise ValueError(
            f"surfaces= with preset={request.preset!r}: presets know no accessible volume; leave one out"
        )
    frame = request.frame
    if frame is None:
        return list(request.surfaces)
    if isinstance(frame, Cylindrical):
        frame = frame.rotated
    origin = np.asarray(frame.origin, float)
    return [wall.in_axes(frame.axes, origin) for wall in request.surfaces]


def with_accessible(
    f: xr.Dataset, scene: Scene, plan: Plan, request: Request, walls: Sequence[Wall]
) -> xr.Dataset:
    """Add the accessible fraction to a result, and divide by it where that is asked for.

    Parameters
    ----------
    f : xarray.Dataset
        The result, with the sums that averages need.
    walls : sequence of Wall
        The walls in the axes of the result.

    Raises
    ------
    ValueError
        As `accessible_of`.
    """
    beside = [name for name in plan.fields if name not in plan.requested]
    f = f.reset_coords(beside)
    accessible = accessible_of(scene, plan, walls)
    seconds = accessible.seconds()
    if seconds > _LONG:
        advice = "simplify the surfaces" if accessible.average else "take a larger spacing"
        warn_user(f"walls: {accessible.text(seconds)}: {advice}")
    chi: Any
    if is_lazy(f, plan.fields):
        import dask.array as da  # slow to import
        from dask.delayed import delayed

        chi = da.from_delayed(delayed(accessible.values)(), accessible.shape, float)
    else:
        with shown(accessible.work, None, what="rays and nodes at walls") as bar:
            chi = accessible.values(bar.update)
    field = xr.DataArray(chi, dims=accessible.dims).expand_dims(time=f.sizes["time"])
    field = field.assign_attrs(
        units="1",
        long_name="share of the kernel on the accessible side of the walls",
        source="walls",
        formula="chi = int Psi(r - r') dr' over the accessible side",
    )
    if request.per is not None:
        per = _per_fraction(f, field.where(field >= LEAST), plan)
        note = "per accessible volume where a sum: balances of mass and momentum hold for fields per volume"
        f = with_setup(per.assign_attrs(per="accessible", per_note=note))
    f = f.set_coords(beside)
    if request.for_averages is False:
        f = f.drop_vars(beside)
    return f.assign(accessible_fraction=field).assign_attrs(
        surfaces="\n".join(map(repr, request.surfaces or ()))
    )


def _per_fraction(f: xr.Dataset, fraction: xr.DataArray, plan: Plan) -> xr.Dataset:
    """Divide the sums of a result by a fraction of the volume; ratios of sums stay, other fields follow from the sums.

    `sample_count` does not change; other fields are NaN where the fraction is.
    """
    average = Averaging("per='accessible'", plan.definitions, plan.options)
    fraction = fraction.drop_attrs(deep=False)
    divided = {}
    for name, values in average.to_sums(f).items():
        part_of_ratio = "/" in str(name)
        if not (part_of_ratio or name == "sample_count"):
            values = values / fraction
        divided[name] = values
    out = average.from_sums(xr.Dataset(divided), f)
    finite = fraction.notnull()
    unchanged = {
        name: f[name].where(finite) for name, field in plan.definitions.items() if field.weight
    }
    if "sample_count" in plan.definitions:
        unchanged["sample_count"] = f["sample_count"]
    return out.assign(unchanged)


def accessible_of(scene: Scene, plan: Plan, walls: Sequence[Wall]) -> Accessible:
    """Plan the accessible fraction at the nodes of a plan.

    Raises
    ------
    ValueError
        If the kernel is not of the scene's dimension, groups have different widths, walls do not
        bound an averaged axis, or they vary across the layer of a two-dimensional scene.
    """
    kernel = plan.kernel
    plane = plan.setup.plane
    if len(plan.widths) > 1:
        raise ValueError(
            "surfaces= take one width for all groups, as the accessible fraction is that of one kernel"
        )
    if kernel.dimension != plan.setup.dimension:
        raise ValueError(
            f"surfaces= take kernels of the scene's dimension ({plan.setup.dimension}), not {kernel!r}"
        )
    layer = [a for a in COMPONENTS if a not in plane]
    if any(wall.varies(COMPONENTS.index(a)) for wall in walls for a in layer):
        raise ValueError(
            f"the scene is one layer across {layer[0]!r}: expected walls that are the same all along {layer[0]!r}"
        )
    if scene.corners is not None:
        middle = np.mean(scene.corners, axis=0, keepdims=True)
        for wall in walls:
            is_whole = isinstance(wall, Plane) and wall.bounds is None
            if is_whole and wall.distance(middle)[0] < 0:
                warn_user(
                    f"{wall!r}: the middle of the grains lies behind it; normals point to the grains, turn this one"
                )
    nodes = plan.nodes
    points, shares, first = _points_of(plan, walls, cylindrical=scene.cylindrical)
    averaged = _averaged(plan, walls, scene.edges)
    average = None
    if averaged:
        seen = [COMPONENTS.index(a) for a in plane if a not in nodes.averaged]
        average = AveragedFraction(points, walls, kernel, seen, averaged)
    return Accessible(points, shares, first, nodes.dims, nodes.sizes, walls, kernel, plane, average)


def _points_of(
    plan: Plan, walls: Sequence[Wall], *, cylindrical: bool
) -> tuple[NDArray, NDArray, NDArray]:
    """Return points (n, 3), their shares of the averages at nodes (n,), and the first point of each node (nodes,).

    Nodes of a cylinder have a point at each of their angles, or one where walls are the same at all
    angles.
    """
    nodes = plan.nodes
    if not cylindrical:
        sizes = dict(zip(nodes.dims, nodes.sizes, strict=True))
        points = np.zeros((nodes.count, 3))
        for a in nodes.active_axes:
            points[:, COMPONENTS.index(a)] = nodes.coords[a].set_dims(sizes).to_numpy().ravel()
        return points, np.ones(len(points)), np.arange(len(points))
    return ring_points(nodes, whole=any(wall.turns() for wall in walls))


@dataclass(frozen=True, eq=False)
class Accessible:
    """The accessible fraction of one call: `values` computes it.

    Attributes
    ----------
    points : array (n, 3)
        Points (m): the nodes, or those at all angles of nodes of a cylinder.
    shares : array (n,)
        Their shares of the averages at their nodes.
    first : array (nodes,)
        First point of each node.
    dims, shape : tuple
        Dimensions of the nodes.
    walls : sequence of Wall
        Walls.
    kernel : Kernel
        Kernel.
    plane : str
        Axes of the scene.
    average : AveragedFraction or None
        The fraction at the points, where it is averaged along axes on which walls vary.
    """

    points: NDArray
    shares: NDArray
    first: NDArray
    dims: tuple[str, ...]
    shape: tuple[int, ...]
    walls: Sequence[Wall]
    kernel: Kernel
    plane: str
    average: AveragedFraction | None

    @property
    def work(self) -> int:
        """Number of rays, or of points, that `values` goes through."""
        if self.average:
            return self.average.ray_count
        return len(self.points)

    def values(self, advance: Callable[[int], object] = lambda _: None) -> NDArray:
        """Compute the fraction at the nodes; `advance` is called with the number that is finished."""
        if self.average:
            fraction = self.average.values(advance)
        else:
            fraction = fraction_at(self.points, self.walls, self.kernel, self.plane, advance)
        if len(self.first) < len(self.points):
            fraction = np.add.reduceat(self.shares * fraction, self.first)
        return fraction.reshape(self.shape)

    def seconds(self) -> float:
        """Estimate how long `values` takes, from some of its points or rays."""
        if self.average:
            return self.average.seconds()
        count = min(_POINTS_TIMED, math.ceil(len(self.points) / 16))
        # at multiples of the golden ratio, modulo one, which no mesh repeats
        rows = (np.arange(count) * GOLDEN % 1.0 * len(self.points)).astype(int)
        times = [perf_counter()]
        # the first call compiles, the second shows what each call takes
        for some in (rows[:1], rows[:1], rows):
            fraction_at(self.points[some], self.walls, self.kernel, self.plane)
            times.append(perf_counter())
        _, once, sample = np.diff(times)
        return float(once + max(0.0, sample - once) * len(self.points) / count)

    def text(self, seconds: float) -> str:
        """Describe the work, which takes some seconds."""
        work = f"at {len(self.points)} points, by up to {2 * _POLAR * _TURNS} rays from each"
        if self.average:
            along = COMPONENTS[self.average.along]
            work = f"by {self.average.ray_count} rays along {along}"
        return f"the accessible fraction {work} takes about {seconds:.2g} s, once for all steps"


def _averaged(
    plan: Plan, walls: Sequence[Wall], edges: Mapping[str, tuple[float, float]]
) -> dict[int, Span]:
    """Return the bounds of each averaged axis along which walls vary.

    Surfaces may be open, so that they bound an axis only where nothing else does.
    """
    spans: dict[int, Span] = {}
    closed = [wall for wall in walls if not isinstance(wall, Surface)]
    for a in plan.nodes.averaged:
        k = COMPONENTS.index(a)
        if not any(wall.varies(k) for wall in walls):
            continue
        bounds = [edges.get(a, (-np.inf, np.inf)), *(wall.span(k) for wall in closed)]
        low = max(first for first, _ in bounds)
        high = min(last for _, last in bounds)
        ends = [wall.span(k) for wall in walls if isinstance(wall, Surface)]
        if ends and low == -np.inf:
            low = min(first for first, _ in ends)
        if ends and high == np.inf:
            high = max(last for _, last in ends)
        if not (np.isfinite(low) and np.isfinite(high) and low < high):
            raise ValueError(
                f"fields are averaged along {a!r}, where the walls differ, and neither they nor a box bound the space "
                f"that is accessible: give the scene a box, or resolve or fix the axis (axes=, at=)"
            )
        spans[k] = Span(low, high, plan.extent[a] or edges[a][1] - edges[a][0])
    return spans


def fraction_at(
    points: NDArray,
    walls: Sequence[Wall],
    kernel: Kernel,
    plane: str = "xyz",
    advance: Callable[[int], object] = lambda _: None,
) -> NDArray:
    """Share of a kernel about points (n, 3) that is accessible; (n,).

    `advance` is called with the number of points that are finished.

    Exact for a single plane within reach. Elsewhere the error is that of the rule for directions:
    root mean square up to 1e-3 and largest up to 5e-3, where curves, corners and the node are
    within a support of each other.
    """
    cutoff = kernel.cutoff
    distance = np.stack([wall.distance(points) for wall in walls])
    out = np.where((distance > -cutoff).all(axis=0), 1.0, 0.0)
    reached = (np.abs(distance) < cutoff) & (out > 0)
    single = reached.sum(axis=0) == 1
    for k, wall in enumerate(walls):
        here = reached[k] & single
        if isinstance(wall, Plane) and here.any():
            out[here] = _beside_plane(distance[k, here], kernel)
            reached[k, here] = False
    rest = np.flatnonzero(reached.any(axis=0))
    points = _off_walls(points, walls, cutoff)
    distance[:, rest] = [wall.distance(points[rest]) for wall in walls]
    cumulative = _cumulative(kernel)
    advance(len(points) - len(rest))
    for first in range(0, len(rest), _BATCH):
        rows = rest[first : first + _BATCH]
        near = [k for k in range(len(walls)) if reached[k, rows].any()]
        out[rows] = _along_rays(
            points[rows],
            [walls[k] for k in near],
            distance[near][:, rows],
            cumulative,
            cutoff,
            plane,
        )
        advance(len(rows))
    return out


def _off_walls(points: NDArray, walls: Sequence[Wall], cutoff: float) -> NDArray:
    """Move points that lie on a wall a hair off it, so that each is on one of its sides."""
    points = points.copy()
    for wall in walls:
        on = np.abs(wall.distance(points)) < _HAIR * cutoff
        points[on] += 2 * _HAIR * cutoff * wall.normals_at(points[on])
    return points


def _beside_plane(distance: NDArray, kernel: Kernel) -> NDArray:
    """Integrate the marginal over one axis, from the plane on: 1/2 and what is between the plane and the node."""
    x, w = leggauss(_ORDER)
    reach = np.minimum(np.abs(distance), kernel.cutoff)[:, None] / 2
    between = (kernel.value(reach * (x + 1), seen=1) * w * reach).sum(axis=1)
    return 0.5 + np.sign(distance) * between


def _cumulative(kernel: Kernel) -> Any:
    """Integral of the kernel over a ball, as a function of its radius (m)."""
    from scipy.interpolate import CubicHermiteSpline

    sphere = {2: 2 * np.pi, 3: 4 * np.pi}[kernel.dimension or 3]
    x, w = leggauss(8)
    # a kernel that jumps there has its value from inside
    edges = np.linspace(0, kernel.cutoff * (1 - 1e-12), 129)
    half = np.diff(edges)[:, None] / 2
    place = edges[:-1, None] + half * (x + 1)

    def shell(r: NDArray) -> NDArray:
        return sphere * kernel.value(r) * r ** ((kernel.dimension or 3) - 1)

    total = np.concatenate([[0.0], np.cumsum((shell(place) * w * half).sum(axis=1))])
    return CubicHermiteSpline(edges, total / total[-1], shell(edges) / total[-1])


def _along_rays(
    points: NDArray,
    walls: Sequence[Wall],
    distance: NDArray,
    cumulative: Any,
    cutoff: float,
    plane: str,
) -> NDArray:
    """Sum over rays from points (n, 3) of the kernel's share on their accessible parts."""
    nearest = np.argmin(np.abs(distance), axis=0)
    rows = np.arange(len(points))
    towards = -np.stack([wall.normals_at(points) for wall in walls])[nearest, rows]
    direction, weight = _rays(towards, np.clip(distance[nearest, rows] / cutoff, -1, 1), plane)
    crossings = [np.minimum(wall.crossings(points, direction, cutoff), cutoff) for wall in walls]
    ends = np.zeros((*direction.shape[:2], 1))
    breaks = np.sort(np.concatenate([ends, *crossings, ends + cutoff], axis=-1), axis=-1)
    middle = (breaks[..., 1:] + breaks[..., :-1]) / 2
    is_open = np.ones(middle.shape, bool)
    for of_wall, start in zip(crossings, distance > 0, strict=True):
        before = np.zeros(middle.shape, int)
        for k in range(of_wall.shape[-1]):
            before += of_wall[..., k, None] < middle
        is_open &= start[:, None, None] ^ (before % 2 == 1)
    share = np.diff(cumulative(np.minimum(breaks, cumulative.x[-1])), axis=-1) * is_open
    return np.asarray((share.sum(axis=-1) * weight).sum(axis=1))


def _rays(towards: NDArray, depth: NDArray, plane: str) -> tuple[NDArray, NDArray]:
    """Choose unit vectors (n, m, 3) and weights (n, m) that sum to one.

    The rule is about the direction to the nearest wall, split where rays begin to reach it if it is
    flat: at the cosine `depth` (n,), the distance in cutoffs. Rays are denser near that cosine,
    where what they see changes quickly.
    """
    x, w = leggauss(_POLAR)
    t = (x + 1) / 2
    w = w / 2
    if len(plane) == 2:
        split = np.arccos(depth)[:, None]
        angle = np.concatenate([split * (1 - t**2), split + (np.pi - split) * t**2], axis=1)
        weight = np.concatenate([split * 2 * t * w, (np.pi - split) * 2 * t * w], axis=1) / (
            2 * np.pi
        )
        normal = np.eye(3)[next(k for k, a in enumerate(COMPONENTS) if a not in plane)]
        beside = np.cross(normal, towards)
        up = np.cos(angle)[..., None] * towards[:, None]
        side = np.sin(angle)[..., None] * beside[:, None]
        return np.concatenate([up + side, up - side], axis=1), np.tile(weight, 2)
    split = depth[:, None]
    cosine = np.concatenate([split + (1 - split) * t**2, split - (1 + split) * t**2], axis=1)
    weight = np.concatenate([(1 - split) * 2 * t * w, (1 + split) * 2 * t * w], axis=1) / 2
    first = np.cross(towards, np.eye(3)[np.argmin(np.abs(towards), axis=1)])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(towards, first)
    turn = 2 * np.pi * (np.arange(_TURNS) + 0.37) / _TURNS  # no ray along an edge between triangles
    around = np.cos(turn)[:, None] * first[:, None] + np.sin(turn)[:, None] * second[:, None]
    sine = np.sqrt(np.maximum(0.0, 1 - cosine**2))
    direction = (
        cosine[..., None, None] * towards[:, None, None] + sine[..., None, None] * around[:, None]
    )
    shape = (len(towards), -1, 3)
    return direction.reshape(shape), np.repeat(weight / _TURNS, _TURNS, axis=1)
