"""Speed against accuracy: measures, and writes docs/accuracy.md with its picture.

Run from the root of the repository, on a machine that does nothing else::

    python -m docs.accuracy [--particles 20000]
"""

from __future__ import annotations

import argparse
import os
import sys
import textwrap
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Any
from unittest import mock

import llvmlite.binding as llvm
import numpy as np
import xarray as xr
from numpy.typing import NDArray

import xcg
from docs import alternatives, physics
from docs.marks import write_between
from tests import planning
from tests.brute_force import BruteKernel
from xcg.compiled.points import deposit
from xcg.compiled.segments import BRANCH, RULES, deposit_segments

HERE = Path(__file__).parent
WIDTH = 0.75  # diameters, which are 1
CUTOFF = 2 * WIDTH
RATE = 1.0  # of the uniform shear
POINTS = "xcg.compiled.points.deposit"
SEGMENTS = "xcg.fields.segments.deposit_segments"
FEW = 2000  # grains of panels that are only drawn again
ROUNDING = 1e-15  # smaller errors are drawn here


@dataclass(frozen=True)
class Way:
    """One way to a field: what is timed, and how far off its result is.

    Ways of one `series` are drawn alike; those of one `group` can be compared, and have a front.
    """

    name: str
    run: Callable[[], Any]
    error: float
    series: str
    default: bool = False
    group: str = ""
    label: str = "right"  # of the point; "left", "below", "up" (slanted), or nothing


@dataclass(frozen=True)
class Panel:
    """Ways to one field."""

    title: str
    measure: str
    timed: str
    ways: Sequence[Way]
    legend: str = "lower left"
    headroom: float = 100.0  # factor above the largest error, for labels
    floors: Mapping[str, Callable[[], Any]] = field(
        default_factory=dict
    )  # what no way can be faster than
    numbered: bool = False  # points have numbers, which a key beside the panel explains


# --- scenes and exact values -----------------------------------------------------------------------------


@cache
def packing(particles: int, periodic: str = "xyz") -> xr.Dataset:
    return xcg.datasets.dense_packing(particles, periodic=periodic)


def sheared(particles: int, fluctuation: float) -> xr.Dataset:
    """Dense packing in uniform shear, dV_x/dz = RATE, with independent fluctuations of every grain."""
    ds = packing(particles, "")
    velocity = fluctuation * np.random.default_rng(1).normal(size=ds.velocity.shape)
    velocity[..., 0] += RATE * ds.position.values[..., 2]
    return ds.assign(velocity=(ds.velocity.dims, velocity))


def mesh(ds: xr.Dataset, width: float = WIDTH, refined: int = 1) -> dict[str, Any]:
    """Nodes over the whole box for scenes that are not periodic, w / `refined` apart."""
    return {
        "width": width,
        "spacing": width / refined,
        "bounds": {
            a: (0.0, float(edge)) for a, edge in zip("xyz", ds.attrs["box_upper"], strict=True)
        },
    }


def inside(f: xr.DataArray) -> xr.DataArray:
    """Nodes whose grains all have whole supports: two cutoffs from the edges of the mesh."""
    return f.isel({a: slice(4, -4) for a in "xyz"})


def some_nodes(f: xr.Dataset, count: int = 96) -> tuple[tuple[NDArray, ...], NDArray]:
    """Indices of nodes drawn at random, and where they are (count, 3)."""
    rng = np.random.default_rng(2)
    index = tuple(rng.integers(0, f.sizes[a], count) for a in "xyz")
    return index, np.stack([f[a].values[i] for a, i in zip("xyz", index, strict=True)], axis=1)


def nearest_image(vectors: NDArray, ds: xr.Dataset) -> NDArray:
    box = ds.attrs["box_upper"]
    return vectors - box * np.rint(vectors / box) if ds.attrs["periodic"] else vectors


def exact_point_sums(
    ds: xr.Dataset, nodes: NDArray, column: NDArray, kernel: BruteKernel, axes: slice
) -> NDArray:
    """Sum of column x Psi at points, straight from the definition; `axes` are those that are seen."""
    position = ds.position.values[0]
    distances = (np.linalg.norm(nearest_image(position - r, ds)[:, axes], axis=1) for r in nodes)
    return np.array([np.tensordot(kernel(distance), column, 1) for distance in distances])


def exact_contact_stress(
    ds: xr.Dataset, nodes: NDArray, kernel: BruteKernel, axes: slice
) -> NDArray:
    """Contact stress at points by composite quadrature of every branch, times the extent of axes that are not seen."""
    position = ds.position.values[0]
    force = ds.contact_force.values[0]
    rows = [
        np.searchsorted(ds.particle_id.values[0], ds[name].values[0])
        for name in ("contact_i", "contact_j")
    ]
    start = position[rows[0]]
    branch = nearest_image(start - position[rows[1]], ds)
    longest = np.linalg.norm(branch, axis=1).max()
    out = np.zeros((len(nodes), 3, 3))
    for n, node in enumerate(nodes):
        away = nearest_image(start - node, ds)
        for c in np.flatnonzero(np.linalg.norm(away[:, axes], axis=1) < kernel.c + longest):
            weight = kernel.segment(np.zeros(3)[axes], away[c, axes], (away[c] - branch[c])[axes])
            out[n] += weight * np.outer(force[c], branch[c])
    return out


def relative(values: NDArray, exact: NDArray) -> float:
    """Largest error over nodes and components, in units of the largest exact value."""
    return float(np.abs(values - exact).max() / np.abs(exact).max())


def captured(target: str, call: Callable[[], Any]) -> list[tuple[Any, ...]]:
    """Arguments with which a call enters a loop, each time for all nodes at once."""
    original = {POINTS: deposit, SEGMENTS: deposit_segments}[target]
    with mock.patch(target, wraps=original) as loop, planning(BLOCK_NODES=sys.maxsize):
        call()
    return [each.args for each in loop.call_args_list]


def again(loop: Callable[..., None], calls: list[tuple[Any, ...]]) -> None:
    """Enter a loop as often as a call did, with its arguments."""
    for args in calls:
        loop(*args)


# --- panels ----------------------------------------------------------------------------------------------


def contact_stress(particles: int) -> Panel:
    """Rules for the integral along the branch."""
    ds = packing(particles)

    def stress(rtol: float) -> xr.Dataset:
        return ds.cg.coarse_grain("contact_stress", width=WIDTH, rtol=rtol)

    index, nodes = some_nodes(stress(0.0))
    exact = exact_contact_stress(ds, nodes, BruteKernel("lucy", WIDTH), slice(0, 3))

    def way(
        name: str, series: str, rtol: float, label: str = "right", default: bool = False
    ) -> Way:
        error = relative(stress(rtol).contact_stress.values[0][index], exact)
        run = partial(again, deposit_segments, captured(SEGMENTS, lambda: stress(rtol)))
        return Way(name, run, error, series, default, label=label)

    ways = []
    for order in RULES:
        limits = np.where(np.array(RULES) == order, np.inf, 0.0)
        # the others lie among those of `rtol`
        label = "right" if order in (RULES[0], RULES[-1]) else ""
        with planning(gauss_limits=lambda *_, limits=limits: limits):
            ways.append(way(f"{order} points", "Gauss-Legendre, all contacts", 1.0, label))
    for exponent in range(
        1, 5
    ):  # from 1e-5 on the rule is the closed form for branches of this length
        ways.append(way(f"rtol 1e-{exponent}", "rule by branch length", 10.0**-exponent, "left"))
    ways.append(way("rtol 0", "closed form", 0.0, default=True))
    (args,) = captured(SEGMENTS, lambda: stress(0.0))
    return Panel(
        "(a) contact stress",
        "|error| / max |sigma|",
        "loop over contacts",
        ways,
        floors=floors(SEGMENTS, args),
    )


def volume_fraction(particles: int) -> Panel:
    """Ways to the weights."""
    ds = packing(particles)

    def fraction() -> xr.Dataset:
        return ds.cg.coarse_grain("volume_fraction", width=WIDTH)

    index, nodes = some_nodes(fraction())
    exact = exact_point_sums(
        ds, nodes, ds.volume.values[0], BruteKernel("lucy", WIDTH), slice(0, 3)
    )
    (args,) = captured(POINTS, fraction)

    def way(name: str, series: str, loop: Callable[..., None], default: bool = False) -> Way:
        with mock.patch(POINTS, loop):
            error = relative(fraction().volume_fraction.values[0][index], exact)
        label = "right" if "interpolated" in series else "left"
        return Way(name, partial(loop, *args), error, series, default, label=label)

    ways = [way("evaluated", "kernel evaluated", deposit, default=True)]
    ways.append(
        way("single precision", "weights in single precision", alternatives.single_precision())
    )
    for series, make in (
        ("table, rounded down", alternatives.floored_table),
        ("table, interpolated", alternatives.interpolated_table),
    ):
        ways += [way(f"{bins} bins", series, make(bins)) for bins in (10**2, 10**3, 10**4, 10**5)]
    return Panel(
        "(b) volume fraction",
        "|error| / max phi",
        "loop over grains",
        ways,
        floors=floors(POINTS, args),
    )


def kinetic_stress(particles: int) -> Panel:
    """Ways to the kinetic stress in a frame that moves fast."""
    ds = packing(particles)
    ways = []
    for speed in (1e3, 1e6):
        fast = ds.assign(velocity=ds.velocity + speed)
        # what adding the speed has left of the fluctuations, without its rounding
        left = fast.assign(velocity=fast.velocity - speed)

        def field(of: xr.Dataset) -> NDArray:
            return of.cg.coarse_grain("kinetic_stress", width=WIDTH).kinetic_stress.values[0]

        f = ds.cg.coarse_grain("density", width=WIDTH)
        index, nodes = some_nodes(f)
        m = left.mass.values[0]
        v = left.velocity.values[0]
        moments = np.concatenate(
            [m[:, None], m[:, None] * v, (m * v.T[:, None] * v.T).reshape(9, -1).T], axis=1
        )
        sums = exact_point_sums(ds, nodes, moments, BruteKernel("lucy", WIDTH), slice(0, 3))
        p = sums[:, 1:4]
        exact = sums[:, 4:].reshape(-1, 3, 3) - p[:, :, None] * p[:, None, :] / sums[:, :1, None]
        for name, loop in (
            ("raw moments", alternatives.raw_moments),
            ("two passes", alternatives.two_passes),
            ("relative to the node", deposit),
        ):

            def run(of: xr.Dataset = fast, loop: Callable[..., None] = loop) -> NDArray:
                with mock.patch(POINTS, loop):
                    return field(of)

            error = relative(run()[index], exact)
            group = f"V / v' = {speed:.0e}"
            label = {"raw moments": "left", "two passes": "right"}.get(name, "below")
            if speed > 1e3 and name != "raw moments":
                label = ""  # the point lies on that of the other frame
            ways.append(Way(name, run, error, group, loop is deposit, group, label))
    return Panel(
        "(c) kinetic stress of a fast frame",
        "|error| / max |sigma_k|",
        "scene to field",
        ways,
        "center right",
    )


def temperature_ways(
    ds: xr.Dataset, width: float
) -> tuple[dict[str, Callable[[], xr.DataArray]], xr.DataArray]:
    """Ways to the velocity that fluctuations are about, and the temperature of the fluctuations that were put in."""
    nodes = mesh(ds, width)
    x = ds.position.values[0]
    v = ds.velocity.values[0]
    m = ds.mass.values[0]

    def about(reference: NDArray) -> xr.DataArray:
        """Sum of m v' v' Psi / (3 rho), with v' about a velocity at every grain."""
        moved = ds.assign(velocity=(ds.velocity.dims, (v - reference)[None]))
        f = moved.cg.coarse_grain(["kinetic_stress", "velocity", "density"], **nodes)
        return trace(f.kinetic_stress) / (3 * f.density) + (f.velocity**2).sum("component") / 3

    def about_node() -> xr.DataArray:
        f = ds.cg.coarse_grain(["kinetic_stress", "density"], **nodes)
        return trace(f.kinetic_stress) / (3 * f.density)

    def about_fit(gradient: str, way: str = "unbiased") -> xr.DataArray:
        names = ["granular_temperature"]
        return ds.cg.coarse_grain(
            names, gradient=gradient, temperature=way, **nodes
        ).granular_temperature

    ways: dict[str, Callable[[], xr.DataArray]] = {
        "V at the node": about_node,
        "linear, kernel gradient": partial(about_fit, "kernel"),
        "linear, least squares": partial(about_fit, "least_squares"),
        "the same per density": partial(about_fit, "least_squares", "biased"),
        "V at the grains": lambda: about(alternatives.velocity_at_grains(x, v, m, 2 * width)),
    }
    return ways, about(np.stack([RATE * x[:, 2], 0 * x[:, 2], 0 * x[:, 2]], axis=1))


def temperature(particles: int) -> Panel:
    """Ways to the granular temperature: uniform shear without fluctuations, and with independent ones."""
    found = []
    for series, fluctuation in (("shear alone", 0.0), ("shear and fluctuations", RATE)):
        ways, truth = temperature_ways(sheared(particles, fluctuation), WIDTH)
        scale = float(inside(truth).mean()) if fluctuation else RATE**2
        for name, run in ways.items():
            error = float((inside(run() - truth) ** 2).mean() ** 0.5) / scale
            label = "up" if fluctuation else "left"
            if fluctuation and name == "V at the grains":
                label = "below"  # beside the kernel gradient, which takes as long
            if (fluctuation and name == "V at the node") or name == "the same per density":
                label = ""  # right above that of the other series; right beside the default
            found.append(
                Way(name, run, error, series, name == "linear, least squares", series, label)
            )
    return Panel(
        "(d) granular temperature",
        "rms error / T, or / (shear rate x d)^2",
        "scene to field",
        found,
        "upper center",
        1e7,
        numbered=True,
    )


def trace(tensor: xr.DataArray) -> xr.DataArray:
    return sum(tensor.sel(component=a, direction=a, drop=True) for a in "xyz")  # type: ignore[return-value]


def velocity_gradient(particles: int) -> Panel:
    """Ways to the velocity gradient in uniform shear."""
    ds = sheared(particles, 0.0)
    truth = RATE * np.outer([1, 0, 0], [0, 0, 1])

    def of_grains(gradient: str) -> xr.DataArray:
        return ds.cg.coarse_grain(
            "velocity_gradient", gradient=gradient, **mesh(ds)
        ).velocity_gradient

    def of_nodes(refined: int) -> xr.DataArray:
        """Central differences of V on a mesh, at every `refined`-th node."""
        v = ds.cg.coarse_grain("velocity", **mesh(ds, refined=refined)).velocity
        slopes = np.gradient(v.values[0], WIDTH / refined, axis=(0, 1, 2), edge_order=2)
        whole = xr.DataArray(
            np.stack(slopes, axis=-1)[None], dims=(*v.dims, "direction"), coords=v.coords
        )
        return whole.isel({a: slice(None, None, refined) for a in "xyz"})

    ways = []
    for name, series, run in (
        ("least squares", "fit through the grains", partial(of_grains, "least_squares")),
        ("kernel gradient", "derivative of V(r)", partial(of_grains, "kernel")),
        ("mesh w", "differences on a mesh", partial(of_nodes, 1)),
        ("mesh w/2", "differences on a mesh", partial(of_nodes, 2)),
    ):
        error = ((inside(run()).values - truth) ** 2).sum(axis=(-2, -1)).mean() ** 0.5 / RATE
        label = "up" if name == "kernel gradient" else "right"
        ways.append(Way(name, run, float(error), series, name == "least squares", label=label))
    return Panel(
        "(e) velocity gradient in uniform shear",
        "rms |error| / shear rate",
        "scene to field",
        ways,
        "upper center",
        1e7,
        numbered=True,
    )


def profiles(particles: int) -> Panel:
    """Depth profiles: the exact marginal, or a mesh averaged afterwards."""
    ds = packing(particles)
    box = ds.attrs["box_upper"]
    kernel = BruteKernel("lucy", WIDTH, seen=1)
    ways = []
    for name in ("density", "contact_stress"):

        def marginal(name: str = name) -> NDArray:
            return ds.cg.coarse_grain(name, axes="z", width=WIDTH)[name].values[0]

        def averaged(refined: int, name: str = name) -> NDArray:
            spacing = {"x": WIDTH / refined, "y": WIDTH / refined, "z": WIDTH}
            return (
                ds.cg.coarse_grain(name, width=WIDTH, spacing=spacing)[name]
                .mean(["x", "y"])
                .values[0]
            )

        z = ds.cg.coarse_grain("density", axes="z", width=WIDTH).z.values
        rows = np.linspace(0, len(z) - 1, 3).astype(int)
        nodes = np.stack([0 * z[rows], 0 * z[rows], z[rows]], axis=1)
        if name == "density":
            exact = exact_point_sums(ds, nodes, ds.mass.values[0], kernel, slice(2, 3))
        else:
            exact = exact_contact_stress(ds, nodes, kernel, slice(2, 3))
        exact = exact / (box[0] * box[1])
        series = name.replace("_", " ")
        ways.append(
            Way(
                "marginal",
                marginal,
                relative(marginal()[rows], exact),
                series,
                True,
                series,
                "below",
            )
        )
        for refined in (1, 2, 4):
            side = "right" if name != "density" else "below" if refined == 4 else "left"
            label = "mesh w" if refined == 1 else f"mesh w/{refined}"
            run = partial(averaged, refined)
            ways.append(
                Way(label, run, relative(run()[rows], exact), series, group=series, label=side)
            )
    return Panel(
        "(f) depth profile", "|error| / largest value", "scene to field", ways, "lower right"
    )


PANELS = (contact_stress, volume_fraction, kinetic_stress, temperature, velocity_gradient, profiles)


# --- measuring -------------------------------------------------------------------------------------------


def in_turn(runs: Sequence[Callable[[], Any]], repeats: int) -> list[list[float]]:
    """Times of each run (s); they take turns, so that what disturbs the machine disturbs all of them.

    Each time in another order: what one leaves of the heap makes the next faster or slower.
    """
    rng = np.random.default_rng(1)
    for run in runs:
        run()
    times: list[list[float]] = [[] for _ in runs]
    for _ in range(repeats):
        for k in rng.permutation(len(runs)):
            begin = time.perf_counter()
            runs[k]()
            times[k].append(time.perf_counter() - begin)
    return times


def fastest(runs: Sequence[Callable[[], Any]], repeats: int) -> list[float]:
    """Least time of each run (s)."""
    return list(map(min, in_turn(runs, repeats)))


@dataclass(frozen=True)
class Point:
    """A way with its time (µs a particle) and its error, not less than rounding."""

    way: Way
    time: float
    error: float

    def beaten(self, others: Sequence[Point]) -> bool:
        """Whether another way is as exact and faster, by more than the noise of the clock."""
        return any(o.error <= 1.01 * self.error and o.time < 0.97 * self.time for o in others)


def measure(panel: Panel, particles: int, repeats: int) -> tuple[list[Point], dict[str, float]]:
    """Points of the ways, and times of the floors (µs a particle)."""
    times = fastest([*(way.run for way in panel.ways), *panel.floors.values()], repeats)
    times = [1e6 * t / particles for t in times]
    points = [Point(w, t, max(w.error, ROUNDING)) for w, t in zip(panel.ways, times, strict=False)]
    return points, dict(zip(panel.floors, times[len(points) :], strict=True))


def by_group(points: Sequence[Point]) -> dict[str, list[Point]]:
    """Points that can be compared with each other."""
    return {
        g: [p for p in points if p.way.group == g]
        for g in dict.fromkeys(p.way.group for p in points)
    }


def front(points: Sequence[Point]) -> list[Point]:
    """Points that no other beats in both, fastest first."""
    found: list[Point] = []
    for p in sorted(points, key=lambda p: (p.time, p.error)):
        if not found or p.error < 0.99 * found[-1].error:
            found.append(p)
    return found


# --- kernels and widths ----------------------------------------------------------------------------------

KERNELS = {"lucy": 2.0, "gaussian": 3.0, "heaviside": 1.0, "wendland": 2.0}
WIDTHS = (0.5, 0.75, 1.0, 2.0)
WIDTHS_OF_TEMPERATURE = (0.75, 1.0, 1.5, 2.0)
LOOPS = {
    "volume fraction": ("volume_fraction", POINTS),
    "temperature": ("granular_temperature", POINTS),
    "contact stress": ("contact_stress", SEGMENTS),
}


@dataclass(frozen=True)
class Rate:
    """Time of a loop (µs a particle), node updates per second, and those of bare multiply-adds (1e6 / s)."""

    columns: int
    time: float
    updates: float
    bare: float


def nodes_reached(target: str, args: Sequence[Any], ratio: float) -> float:
    """Mean number of nodes in the support of a grain or a branch, with nodes one width apart; `ratio` is c / w."""
    ball = 4 / 3 * np.pi * ratio**3
    tube = np.pi * ratio**3
    if target == POINTS:
        return ball
    return float(
        ball + tube * np.linalg.norm(args[0].records[:, BRANCH : BRANCH + 3], axis=1).mean()
    )


def bare_sums(target: str, args: Sequence[Any], reached: float) -> tuple[NDArray, NDArray, NDArray]:
    """Arguments of `multiply_add` for as many sums as a loop adds to."""
    moments = args[-1] if target == SEGMENTS else args[-2]
    items = len(args[0].records if target == SEGMENTS else args[0].order)
    return (
        np.zeros(moments.size),
        np.ones(max(1, round(reached * moments.shape[-1]))),
        np.ones(items),
    )


def floors(target: str, args: Sequence[Any]) -> dict[str, Callable[[], Any]]:
    """Bare multiply-adds of the sums of a loop with Lucy's kernel, by Numba and in C."""
    given = bare_sums(target, args, nodes_reached(target, args, KERNELS["lucy"]))
    found = {"bare sums": partial(alternatives.multiply_add, *given)}
    if in_c := alternatives.multiply_add_in_c():
        found["bare sums in C"] = partial(in_c, *given)
    return found


def rate(ds: xr.Dataset, name: str, target: str, kernel: str, width: float, repeats: int) -> Rate:
    (args,) = captured(target, lambda: ds.cg.coarse_grain(name, kernel=kernel, width=width))
    columns = (args[-1] if target == SEGMENTS else args[-2]).shape[-1]
    reached = nodes_reached(target, args, KERNELS[kernel])
    given = bare_sums(target, args, reached)
    loop, bare = fastest(
        [
            partial({POINTS: deposit, SEGMENTS: deposit_segments}[target], *args),
            partial(alternatives.multiply_add, *given),
        ],
        repeats,
    )
    updates = len(given[2]) * reached / 1e6
    return Rate(columns, 1e6 * loop / ds.sizes["particle"], updates / loop, updates / bare)


def temperatures_by_width(particles: int) -> dict[float, dict[str, float]]:
    """Mean temperature over the true one, for independent fluctuations in uniform shear."""
    found = {}
    for width in WIDTHS_OF_TEMPERATURE:
        ways, truth = temperature_ways(sheared(particles, RATE), width)
        mean = {name: float(inside(run()).mean()) for name, run in ways.items()}
        found[width] = {name: value / float(inside(truth).mean()) for name, value in mean.items()}
    return found


# --- the page --------------------------------------------------------------------------------------------


class Times:
    """Ratios of measured times, for the text."""

    def __init__(self, points: Sequence[Point]) -> None:
        self._points = points

    def __call__(self, name: str, than: str, series: str | None = None) -> str:
        """Time of one way over that of another; `series` is that of the first, and of both where it is a group."""

        def time_of(name: str, series: str | None) -> float:
            found = [
                p.time
                for p in self._points
                if p.way.name == name and series in (None, p.way.series)
            ]
            return found[0] if found else time_of(name, None)

        return f"{time_of(name, series) / time_of(than, series):.2g}"


HEAD = """\
A field can be computed in several ways. The chart shows the error of each way against its time per particle: down is
more exact, left is faster, and a ring marks xcg's default. Errors of different fields cannot be compared, so each
field has a panel. The grey line is the *front*: no other way is both faster and more exact than those on it (in the
tables, times within 3 % of each other count as equal). Made, on {machine}, by

```bash
python -m docs.accuracy --particles {particles} --repeats {repeats}
```

![Error against time per particle](_static/accuracy.png)

The scene is `xcg.datasets.dense_packing`: {particles} spheres at a volume fraction of 0.6 with three contacts
each, nodes w = 0.75 d apart, Lucy's kernel, one thread. Times are the least of {repeats}, the ways of a panel
taking turns. In (a) and (b) they are of the loop that differs, in the others of the whole call of `coarse_grain`,
from a scene in memory to labelled fields. Errors are against other code (`tests/brute_force.py`): sums over all
grains straight from the definition, and 64-point quadrature of pieces of every branch. They are the largest over
components and nodes, 96 random nodes in (a) to (c) and three heights in (f), unless it says otherwise. The
alternatives (`docs/alternatives.py`) are xcg's own loops with one thing exchanged.

The floors in (a) and (b) are the times of the additions alone. A grain or branch that reaches N nodes
adds to N times K sums, and an instruction of AVX-512 loads, adds to and stores eight of them. At one store a cycle
of 3 GHz this is N K / 24 ns; the measured floor is higher, as sums come from the second cache. The loop takes longer
because it has to find the nodes and their weights. The ways of other programs are on the chart: Pysammos looks
weights up in 1000 bins, MercuryCG and LAMMPS take the closed form; points of such ways name the program.
{tests}
"""
TESTS = (
    "Tests (`tests/docs/test_accuracy.py`) check everything here that does not depend on the clock."
)


def says_contact_stress(x: Times) -> str:
    return f"""**Default: the closed form (`rtol=0`).** It takes {x("rtol 0", "2 points")} times as long as
two Gauss points and {x("rtol 0", "12 points")} times as long as twelve, and is exact to rounding, so that the
identities of the theory hold for the fields. A larger `rtol` saves time, because fewer points suffice and
weights are then in single precision: 1e-3 takes {x("rtol 1e-3", "rtol 0")} of the time of the closed form, and
1e-4 {x("rtol 1e-4", "rtol 0")}. A rule of an odd number of points takes as long as the next even one. At this
width xcg uses the closed form for 1e-5 and less, because it is faster than the points needed. The errors are at
least ten times smaller than `rtol`, because `rtol` bounds the error of each branch at its worst node, and a
node sees a hundred branches.
"""


def says_volume_fraction(x: Times) -> str:
    return f"""**Default: the kernel is evaluated.** A polynomial of the distance is faster than a table. A
table of 1000 bins takes {x("1000 bins", "evaluated", "table, rounded down")} times as long if the distance is
rounded down, as in Pysammos, with an error of 0.3 %, and {x("1000 bins", "evaluated", "table, interpolated")}
times as long with interpolation. More bins are more exact and no faster. Weights in single precision take
{x("single precision", "evaluated")} times as long, with an error of 1e-7. They are not the default, because
identities would then hold to seven digits instead of fifteen.
"""


def says_kinetic_stress(x: Times) -> str:
    return f"""**Default: one pass, velocities relative to the first grain that reaches a node.** The sum of
m v v less rho V V (raw moments) loses digits with the square of V / v': six at 1e3, twelve at 1e6. Two passes,
V first and then the sums about it, keep all digits, but take
{x("two passes", "relative to the node", "V / v' = 1e+06")} times as long as the default, which keeps them in
one pass. Raw moments take {x("raw moments", "relative to the node", "V / v' = 1e+06")} times as long as the
default, so they save little and lose digits without a warning.
"""


def says_temperature(x: Times) -> str:
    return f"""**Default: the velocity at each grain by linear extrapolation from the node, with the
least-squares gradient.** In shear without fluctuations the temperature is zero. If fluctuations are taken about
the velocity at the node, the shear contributes in proportion to w^2. About V evaluated at the grains, a smaller
contribution remains, because V(r) is the velocity at the grains' centre of mass. Only extrapolation by least
squares gives zero, to rounding. It takes {x("linear, least squares", "V at the node", "shear alone")} times as
long as fluctuations about the node.

**Where fluctuations are independent from grain to grain**, every way has an error at one node. A node sees
about 16 grains of unequal weights, equivalent to seven of equal weight. A mean velocity follows one seventh of
their fluctuations, a fit of four numbers more than half, and V evaluated at a grain is largely the velocity of
that grain. This part is missing from the temperature. The default subtracts the degrees of freedom of its fit
from the density in the denominator, so its **mean is right at every width**: the table below has the mean of
the temperature over the true one. Divided by the full density instead (`temperature="biased"`), the same
fluctuations give a third at this width and 7 % too little at twice it. About the velocity at the node, the
temperature grows with w without limit. More under [granular temperature](temperature.md).
"""


def says_velocity_gradient(x: Times) -> str:
    return f"""**Default: least squares through the grains.** It is exact in uniform shear. The kernel gradient
is the exact derivative of the field V(r), but that field is rough at this width: V(r) is the velocity at the grains'
centre of mass, which is now on one side of the node, now on another. Differences on the mesh converge to the same
derivative, so refining the mesh (w/2) makes them worse. On a coarse mesh they smooth a little, and take
{x("mesh w", "least squares")} of the time, with an error of some percent. `gradient="kernel"` is there for balances,
which need the derivative of the field.
"""


def says_profiles(x: Times) -> str:
    return f"""**Default: the exact marginal.** It is faster and exact: a mesh of spacing w takes
{x("mesh w", "marginal", "density")} times as long for the density and
{x("mesh w", "marginal", "contact stress")} for the contact stress and is off by up to 1 %; one of w/4 takes
{x("mesh w/4", "marginal", "contact stress")} times as long. The box is periodic here, which is the best case for a
mesh.
"""


TEXTS = (
    says_contact_stress, says_volume_fraction, says_kinetic_stress, says_temperature, says_velocity_gradient,
    says_profiles,
)  # fmt: skip
TEMPERATURES = """Mean temperature over that of the fluctuations put in, by width:
"""
RATES = """## Kernels and widths

Each cell has three numbers. The first is the time for each particle in the loop alone, with closed forms and nodes
one width apart. The second is how many million *node updates* a second that is: one update adds all columns of one
grain or contact to one node, and includes finding the node and its weight. The third, after "of", is how many
updates bare additions reach, ``sums[k] += weight[k] * factor`` over as many consecutive numbers.

**Default: Lucy.** Its value is a polynomial of the distance, its integral along a branch polynomials and one
logarithm, and both run as vector instructions. Gaussians and registered kernels are polynomials, and a Gaussian reaches
three times as many nodes at the same width. The Heaviside is the fastest because it reaches the fewest nodes, each of
which then sees few grains. Wendland's C2 function, (1 - q)^4 (1 + 4 q), stands for registered kernels.
"""

MARKERS = "osD^v"
# programs that go this way, by series (or nothing) and name
PROGRAMS = {
    ("closed form", "rtol 0"): "MercuryCG, LAMMPS",
    ("table, rounded down", "1000 bins"): "Pysammos",
    ("", "V at the node"): "LAMMPS, about its bins",
    ("differences on a mesh", "mesh w"): "Pysammos",
}
# offset in points, alignments, rotation
LABELS: dict[str, dict[str, Any]] = {
    "right": {"xytext": (9, 0), "ha": "left", "va": "center"},
    "left": {"xytext": (-9, 0), "ha": "right", "va": "center"},
    "below": {"xytext": (0, -10), "ha": "center", "va": "top"},
    "up": {
        "xytext": (-2, 9),
        "ha": "left",
        "va": "bottom",
        "rotation": 30,
        "rotation_mode": "anchor",
    },
}


# of numbers, below the points of one series and above those of the next
SIDES: tuple[dict[str, Any], ...] = (
    {"xytext": (0, -10), "ha": "center", "va": "top"},
    {"xytext": (0, 10), "ha": "center", "va": "bottom"},
)


def named(way: Way) -> str:
    """Return the name of a way, with the program that goes it."""
    program = PROGRAMS.get((way.series, way.name)) or PROGRAMS.get(("", way.name))
    return f"{way.name} ({program})" if program else way.name


def recorded(panel: Panel) -> tuple[list[Point], dict[str, float]]:
    """Return the points and floors of a panel as they are on the page."""
    page = (HERE / "accuracy.md").read_text()
    section = page.split(f"## {panel.title}\n")[1].split("\n## ")[0]
    times: dict[tuple[str, str], tuple[float, float]] = {}
    bare: dict[str, float] = {}
    for line in section.split("| on the front |\n")[1].splitlines()[1:]:
        if not line.startswith("|"):
            break
        series, name, seconds, error, _ = (cell.strip() for cell in line.split("|")[1:-1])
        if series == "floor":
            bare[name] = float(seconds)
        else:
            plain = name.removesuffix(" (default)").strip("*")
            times[series or plain, plain] = float(seconds), float(error)
    return [Point(way, *times[way.series, way.name]) for way in panel.ways], bare


def draw(panels: Sequence[tuple[Panel, list[Point], Mapping[str, float]]], path: Path) -> None:
    import matplotlib.pyplot as plt
    from matplotlib.patheffects import withStroke
    from matplotlib.ticker import LogLocator, NullFormatter

    halo = [withStroke(linewidth=3, foreground="white")]  # no line crosses a label
    figure, grid = plt.subplots(2, 3, figsize=(15, 9.5), layout="constrained")
    for ax, (panel, points, bare) in zip(grid.flat, panels, strict=True):
        ax.set(xscale="log", yscale="log", title=panel.title, ylabel=panel.measure)
        ax.set_xlabel(f"{panel.timed} [µs per particle]")
        for group in by_group(points).values():
            line = front(group)
            ax.step(
                [p.time for p in line], [p.error for p in line], "0.8", lw=5, where="post", zorder=1
            )
        numbers: dict[str, int] = {}
        for k, name in enumerate(dict.fromkeys(p.way.series for p in points)):
            own = [p for p in points if p.way.series == name]
            ax.plot(
                [p.time for p in own],
                [p.error for p in own],
                MARKERS[k],
                color=f"C{k}",
                ms=6,
                label=name,
            )
            for p in own:
                if panel.numbered:
                    number = numbers.setdefault(named(p.way), len(numbers) + 1)
                    text = str(number)
                    about = SIDES[k % len(SIDES)]
                else:
                    text = named(p.way)
                    about = LABELS.get(p.way.label)
                    if p.way.label == "right":
                        text = text.replace(" (", "\n(").replace(", ", ",\n")
                if about:
                    ax.annotate(
                        text,
                        (p.time, p.error),
                        textcoords="offset points",
                        fontsize=8.5,
                        color=f"C{k}",
                        path_effects=halo,
                        **about,
                    )
        chosen = [p for p in points if p.way.default]
        ax.plot(
            [p.time for p in chosen],
            [p.error for p in chosen],
            "ko",
            mfc="none",
            ms=14,
            label="xcg's default",
        )
        for style, (name, least) in zip(("-.", ":"), bare.items(), strict=False):
            ax.axvline(least, color="k", ls=style, lw=1, label=f"floor: {name}")
        every = [*(p.time for p in points), *bare.values()]
        low = min(every)
        high = max(every)
        room = 1.2 * (high / low) ** 0.45
        ax.set_xlim(low / room, high * room)
        ax.set_ylim(ROUNDING / 30, panel.headroom * max(p.error for p in points))
        wide = high * room > 30 * low / room
        ax.xaxis.set_major_locator(
            LogLocator(subs=(1.0, 3.0) if wide else (1.0, 1.5, 2.0, 3.0, 5.0, 7.0))
        )
        ax.xaxis.set_major_formatter("{x:g}")
        ax.xaxis.set_minor_formatter(NullFormatter())
        ax.grid(alpha=0.25)
        legend = ax.legend(fontsize=8.5, loc=panel.legend)
        if numbers:
            key = "\n".join(f"{number}  {name}" for name, number in numbers.items())
            ax.text(
                0.97, 0.37, key, transform=ax.transAxes, ha="right", va="center", fontsize=8.5,
                multialignment="left",
                bbox={"facecolor": "white", "edgecolor": "0.8"},
            )  # fmt: skip
            ax.add_artist(legend)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def table(points: Sequence[Point], bare: Mapping[str, float]) -> str:
    """The points and floors of one panel, in markdown."""
    groups = by_group(points)
    lines = ["| way | | time (µs a particle) | error | on the front |", "|---|---|---|---|---|"]
    for p in points:
        series = p.way.series if p.way.series != p.way.name else ""
        name = f"**{p.way.name}** (default)" if p.way.default else p.way.name
        on = "" if p.beaten(groups[p.way.group]) else "yes"
        lines.append(f"| {series} | {name} | {p.time:.2f} | {p.error:.1e} | {on} |")
    lines += [f"| floor | {name} | {least:.2f} | | |" for name, least in bare.items()]
    return "\n".join(lines) + "\n"


def table_of_rates(particles: int, repeats: int) -> str:
    ds = packing(particles)
    xcg.register_kernel("wendland", lambda q: (1 - q) ** 4 * (1 + 4 * q), ratio=KERNELS["wendland"])
    columns = {label: rate(ds, *LOOPS[label], "lucy", WIDTH, 1).columns for label in LOOPS}
    heads = [f"{label}, {columns[label]} column{'s' * (columns[label] > 1)}" for label in LOOPS]
    lines = ["| kernel | w / d | " + " | ".join(heads) + " |", "|---" * (2 + len(heads)) + "|"]
    for kernel in KERNELS:
        for width in WIDTHS:
            rates = [rate(ds, *LOOPS[label], kernel, width, repeats) for label in LOOPS]
            cells = [f"{r.time:.2f} us, {r.updates:.0f} of {r.bare:.0f}" for r in rates]
            lines.append(f"| {kernel} | {width} | " + " | ".join(cells) + " |")
            print(lines[-1], flush=True)
    return "\n".join(lines) + "\n"


def table_of_temperatures(particles: int) -> str:
    found = temperatures_by_width(particles)
    ways = list(next(iter(found.values())))
    lines = ["| w / d | " + " | ".join(ways) + " |", "|---" * (1 + len(ways)) + "|"]
    lines += [
        f"| {w} | " + " | ".join(f"{mean:.2f}" for mean in row.values()) + " |"
        for w, row in found.items()
    ]
    return "\n".join(lines) + "\n"


def wrapped(text: str) -> str:
    """Paragraphs in lines of even length, also after numbers have been put in."""
    return (
        "\n\n".join(textwrap.fill(part, 118, break_on_hyphens=False) for part in text.split("\n\n"))
        + "\n"
    )


def one_thread() -> Any:
    """Hold everything to one thread: the alternatives fill all nodes in one call."""
    return mock.patch("xcg.steps.analysis.THREADS", 1)


@one_thread()
def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument(
        "--particles", type=int, default=20_000, help="grains of the packing (default 20000)"
    )
    parser.add_argument(
        "--repeats", type=int, default=15, help="times that each way is run (default 15)"
    )
    parser.add_argument(
        "--part", choices=["arithmetic", "physics", "both"], default="both", help="what to measure"
    )
    parser.add_argument(
        "--redraw", action="store_true", help="draw what stands on the page, without measuring"
    )
    given = parser.parse_args()
    if given.redraw:
        panels = [make(FEW) for make in PANELS]
        draw([(panel, *recorded(panel)) for panel in panels], HERE / "_static" / "accuracy.png")
        return
    if given.part != "physics":
        write_between("accuracy.md", "arithmetic", arithmetic(given.particles, given.repeats))
    if given.part != "arithmetic":
        write_between("accuracy.md", "physics", physics.main())


def arithmetic(n: int, repeats: int) -> str:
    """Measure the ways of all panels, draw them, and return the text."""
    measured = []
    for make in PANELS:
        panel = make(n)
        measured.append((panel, *measure(panel, n, repeats)))
        print(panel.title, table(*measured[-1][1:]), sep="\n\n", flush=True)
    draw(measured, HERE / "_static" / "accuracy.png")
    parts = [HEAD.format(machine=machine(), particles=n, repeats=repeats, tests=TESTS)]
    for (panel, points, bare), text in zip(measured, TEXTS, strict=True):
        parts += [f"## {panel.title}\n", wrapped(text(Times(points))), table(points, bare)]
        if "temperature" in panel.title:
            parts += [TEMPERATURES, table_of_temperatures(n)]
    parts += [RATES, table_of_rates(n, repeats)]
    return "\n".join(parts)


def machine() -> str:
    features = llvm.get_host_cpu_features()
    vectors = next(
        (name for key, name in (("avx512f", "AVX-512"), ("avx2", "AVX2")) if features.get(key)),
        None,
    )
    return f"one of {os.cpu_count()} cores" + (f" with {vectors}" if vectors else "")


if __name__ == "__main__":
    main()
