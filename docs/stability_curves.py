"""Curves of error against what breaks a method: python -m docs.stability_curves.

Writes docs/_static/stability_curves.png. Each panel has the naive way, the program that takes it where one is
known, and xcg. Errors below 1e-16 are drawn there; where the answer is unknown, xcg returns NaN, and has no point.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import matplotlib as mpl
import numpy as np

import xcg
from docs import lattice
from tests.brute_force import BruteKernel

mpl.use("agg")
from matplotlib import pyplot as plt

PICTURE = Path(__file__).parent / "_static" / "stability_curves.png"
ROUNDING = 1e-16
Curves = dict[str, tuple[np.ndarray, np.ndarray]]  # by label: what breaks the method, error


def narrow_width() -> Curves:
    """Contact stress of a lattice over w/d, of contacts found by the centres of grains, and of all."""
    ds = lattice.lattice()
    widths = np.array([0.4, 0.5, 0.6, 0.75, 1.0, 1.5, 2.0, 3.0])
    error: dict[str, list[float]] = {}
    for width in widths * lattice.DIAMETER:
        for kind in (xcg.Lucy, xcg.Heaviside):
            kernel = kind(width, dimension=3)
            ours = lattice.at_point(ds, kind.__name__.lower(), width)["contact_stress"]
            name = kind.__name__
            centres = abs(lattice.by_centres(ds, kernel) / ours - 1)
            error.setdefault(f"contacts by centres (Pysammos 1.0.0), {name}", []).append(centres)
        exact = lattice.by_centres(ds, xcg.Lucy(width, dimension=3), beyond=lattice.DIAMETER)
        ours = lattice.at_point(ds, "lucy", width)["contact_stress"]
        error.setdefault("xcg, Lucy, against 64 Gauss points", []).append(abs(exact / ours - 1))
    return {name: (widths, np.array(values)) for name, values in error.items()}


def few_grains() -> Curves:
    """Temperature of independent velocities over the grains that a node sees."""
    ds = xcg.datasets.dense_packing(8000)
    velocity = np.random.default_rng(1).normal(size=ds.velocity.shape)
    ds = ds.assign(velocity=(ds.velocity.dims, velocity))
    truth = float((ds.velocity**2).mean())
    counts = []
    biased = []
    ours = []
    for width in (0.5, 0.6, 0.75, 1.0, 1.5, 2.0):
        names = ["granular_temperature", "fluctuation_density", "fluctuation_stress", "density"]
        f = ds.cg.coarse_grain([*names, "sample_count"], width=width, spacing=0.75)
        known = f.granular_temperature.notnull()
        free = f.fluctuation_density.where(known, 0.0)
        stress = f.fluctuation_stress.where(known, 0.0)
        left = sum(stress.sel(component=a, direction=a) for a in "xyz") / 3
        counts.append(float(f.sample_count.mean()))
        biased.append(abs(float(left.sum() / f.density.where(known, 0.0).sum()) / truth - 1))
        mean = (f.granular_temperature.fillna(0.0) * free).sum() / free.sum()
        ours.append(abs(float(mean) / truth - 1))
    x = np.array(counts)
    return {
        'over the density (temperature="biased")': (x, np.array(biased)),
        "xcg, over the density less the fit": (x, np.array(ours)),
    }


def fast_frame() -> Curves:
    """Kinetic stress over the speed of the frame."""
    ds = xcg.datasets.random_scene(300, seed=2)
    at = dict.fromkeys("xyz", 2.5)
    options = {"axes": "", "at": at, "width": 1.0}
    slow = ds.cg.coarse_grain("kinetic_stress", **options).kinetic_stress.values[0]
    position = ds.position.values[0] - 2.5
    position -= 5.0 * np.rint(position / 5.0)
    weight = ds.mass.values[0] * BruteKernel("lucy", 1.0)(np.linalg.norm(position, axis=1))
    speeds = 10.0 ** np.arange(0, 8)
    raw = []
    ours = []
    for speed in speeds:
        fast = ds.assign(velocity=ds.velocity + speed)
        v = fast.velocity.values[0]
        flow = weight @ v
        moments = np.einsum("n,ni,nj->ij", weight, v, v) - np.outer(flow, flow) / weight.sum()
        of_xcg = fast.cg.coarse_grain("kinetic_stress", **options).kinetic_stress.values[0]
        raw.append(np.abs(moments - slow).max() / np.abs(slow).max())
        ours.append(np.abs(of_xcg - slow).max() / np.abs(slow).max())
    return {
        r"$\sum m v v \Psi - \rho V V$": (speeds, np.array(raw)),
        "xcg, relative to a grain": (speeds, np.array(ours)),
    }


def size_ratio() -> Curves:
    """Volume fraction of a layer of small grains under large ones, of one width and of a width for each."""
    ratios = np.array([2.0, 4.0, 8.0, 16.0, 32.0])  # the layer is five small grains high
    one = []
    own = []
    rng = np.random.default_rng(7)
    for ratio in ratios:
        size = 4.0 / ratio
        height = 5 * size
        count = int(0.3 * 400 * height / (np.pi / 6 * size**3))
        small = rng.uniform([0, 0, 0], [20, 20, height], (count, 3))
        large = rng.uniform([0, 0, height], [20, 20, 20], (40, 3))
        ds = xcg.scene_from_arrays(
            np.concatenate([small, large]), diameter=[size] * count + [4.0] * 40, density=1.0,
            species=[1] * count + [2] * 40, box=[[0, 20]] * 3, periodic="xy",
        )  # fmt: skip
        at = {"axes": "z", "bounds": {"z": (height / 2,) * 2}, "spacing": 1.0, "by": "species"}
        truth = count * np.pi / 6 * size**3 / (400 * height)
        narrow = {1: 0.75 * size, 2: "0.75 d43"}
        for values, width in ((one, "0.75 d43"), (own, narrow)):
            f = ds.cg.coarse_grain("volume_fraction", width=width, **at)
            values.append(abs(f.volume_fraction.sel(phase="1").item() / truth - 1))
    return {
        "one width, 0.75 $d_{43}$": (ratios, np.array(one)),
        "xcg, a width for each size": (ratios, np.array(own)),
    }


def near_wall() -> Curves:
    """Density of points at random beside a wall, over the distance of the node."""
    rng = np.random.default_rng(3)
    x = rng.uniform(0, [8, 8, 4], (100_000, 3))
    ds = xcg.scene_from_arrays(
        x, diameter=0.05, density=1.0, box=[[0, 8], [0, 8], [0, 8]], periodic="xy"
    )
    truth = float(ds.mass.sum()) / (8 * 8 * 4)
    distances = np.array([0.0, 0.1, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5])
    mesh = {"axes": "z", "width": 0.75, "bounds": {"z": (0.0, 1.5)}, "spacing": 0.05}
    wall = xcg.Plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    plain = ds.cg.coarse_grain("density", **mesh).density.isel(time=0)
    divided = ds.cg.coarse_grain("density", surfaces=[wall], per="accessible", **mesh)
    accessible = divided.density.isel(time=0)
    return {
        name: (distances, np.abs(f.interp(z=distances).values / truth - 1))
        for name, f in (
            ("the whole support", plain),
            ('xcg, per="accessible"', accessible),
        )
    }


def gaps_in_time() -> Curves:
    """Velocity from wrapped positions over what a grain moves from step to step, in box lengths."""
    shares = np.array([0.05, 0.1, 0.2, 0.4, 0.45, 0.55, 0.7, 0.9])
    naive = []
    nearest = []
    rng = np.random.default_rng(5)
    first = rng.uniform(0, 1, (200, 3))
    for share in shares:
        moved = first + np.arange(3)[:, None, None] * [share, 0.0, 0.0]
        wrapped = moved % 1.0
        ds = xcg.scene_from_arrays(
            wrapped, diameter=0.05, density=1.0, particle_id=np.tile(np.arange(200), (3, 1)),
            time=[0.0, 1.0, 2.0], box=[[0, 1]] * 3, periodic="xyz",
        )  # fmt: skip
        v = ds.cg.derive("velocity").velocity.values[1, :, 0]
        nearest.append(np.sqrt(((v / share - 1) ** 2).mean()))
        differences = (wrapped[2] - wrapped[0])[:, 0] / 2
        naive.append(np.sqrt(((differences / share - 1) ** 2).mean()))
    return {
        "differences of wrapped positions": (shares, np.array(naive)),
        "xcg, nearest image": (shares, np.array(nearest)),
    }


PANELS = {
    "(a) contact stress": (narrow_width, "width over diameter, $w / d$", True),
    "(b) granular temperature": (few_grains, "grains that reach a node", True),
    "(c) kinetic stress in a fast frame": (fast_frame, "speed of the frame, $V / v'$", True),
    "(d) layer of small grains": (size_ratio, "large over small diameter", True),
    "(e) density beside a wall": (near_wall, "distance to the wall, $d$ ($w$ = 0.75 $d$)", False),
    "(f) velocity from positions": (gaps_in_time, "moved from step to step, in boxes", False),
}


def main() -> None:
    """Draw all panels, and print their errors."""
    figure, axes = plt.subplots(2, 3, figsize=(13, 8), layout="constrained")
    for ax, (title, (curves, breaks, is_log)) in zip(axes.flat, PANELS.items(), strict=True):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", xcg.SceneWarning)
            found = curves()
        for k, (name, (x, error)) in enumerate(found.items()):
            of_xcg = name.startswith("xcg")
            colour = "C0" if of_xcg else f"C{3 if k == 0 else 1}"
            ax.plot(x, np.maximum(error, ROUNDING), "o-", ms=4, color=colour, label=name)
            print(
                title,
                name,
                np.array2string(error, precision=1, formatter={"float": "{:.1e}".format}),
            )
        ax.set(yscale="log", xlabel=breaks, title=title)
        if is_log:
            ax.set_xscale("log")
            if max(x) < 1e3:
                kept = [k for k in x if np.isfinite(error[list(x).index(k)])]
                ax.set_xticks(kept, [f"{k:.3g}" for k in kept])
                ax.minorticks_off()
        low, high = ax.get_ylim()
        ax.set_ylim(low, high * (high / low) ** 0.35)
        ax.legend(fontsize="small", loc="upper right")
        ax.grid(alpha=0.3)
    for ax in axes[:, 0]:
        ax.set_ylabel("error relative to the field")
    figure.savefig(PICTURE, dpi=90)


if __name__ == "__main__":
    main()
