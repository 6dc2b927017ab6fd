"""Second part of docs/accuracy.md: errors of width, spacing, frames and kernel in known flows."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from tests import flows
from tests.flows import LENGTH, NODES, Flow

PICTURE = Path(__file__).parent / "_static" / "physics.png"
DEFAULT = {
    "width": 0.75,
    "spacing": 1.0,
    "frames": 16,
    "kernel": "lucy",
}  # spacing in widths
CHOICES: Mapping[str, Sequence[Any]] = {
    "width": (0.5, 0.75, 1.0, 1.5, 2.0),
    "spacing": (0.5, 1.0, 1.5, 2.0),
    "frames": (1, 4, 16, 64),
    "kernel": ("heaviside", "lucy", "gaussian"),
}
MARKERS = "os^D"  # of choices
# where the labels of points stand: the width of 1 d lies beside the default, heaviside above the spacings
BESIDE: Mapping[str, Mapping[str, Any]] = {
    "width": {"xytext": (8, -12)},
    "spacing": {"xytext": (-7, -3), "ha": "right"},
}
SIDE = 12.0
REPEATS = 3  # of each choice, in turn; the least time counts
TEXT = """## Bias and noise: width, spacing, frames, kernel

The errors so far are numerical. Physical errors are a million times larger: noise of too few particles, and bias of
gradients that the width smears. The flows here are known (`tests/flows.py`): random grains at a volume fraction of 0.4
that follow a profile, with thermal noise of a temperature of 0.25 on speeds of about 1, placed anew in each frame.
Repeat with `python -m docs.accuracy --part physics`.

![Bias and noise against width, number of frames and spacing; error against time](_static/physics.png)

- **Width** (sine, profile): the bias rises as w^2; the noise falls as 1 / sqrt(N_eff), in a profile as 1 / sqrt(w).
  The noise of wide kernels falls less, because grains are placed anew in each frame of a smeared gradient.
- **Frames**: the noise falls as 1 / sqrt(frames), the bias stays.
- **Spacing**: what interpolation between the nodes adds to a smooth field.
{spacing}
- **Time** (sine, volume, {particles} particles; by default 0.75 d, nodes one width apart, 16 frames, Lucy): one choice
  is changed at a time. The error is that of the field interpolated linearly to random points.

In the last panel, no other choice is both faster and more exact than these:
{front}.
The default spacing of w is not among them, and is kept: 1.5 w takes about three quarters of the time, but its linear
interpolation has twice the error if there is little noise.

Bias and noise of one frame, relative to the root mean square of each field, in profiles at the default width and at the
width that `choose_width` takes for 16 frames:

{table}

The layer has bias at its edges only, and so has the column, whose stress is linear. Linear shear between walls has bias
beside the walls, where all particles are on one side of the node.
"""


def of_width(flow: Flow, width: float, **options: Any) -> tuple[float, float]:
    f = flow.scene.cg.coarse_grain(flow.field, width=width, **NODES | options)
    return flow.errors(f)


def of_spacing(flow: Flow, spacing: float) -> tuple[float, float]:
    """Errors of linear and cubic interpolation of a sine, relative to it: smearing changes its size alone."""
    between = np.linspace(0, LENGTH, 400)
    found = []
    for shift in np.linspace(0, 1, 8, endpoint=False):
        z = np.arange(-4, 20 + spacing, spacing) + shift * spacing
        ways = (np.interp(between, z, flow.truth(z)), CubicSpline(z, flow.truth(z))(between))
        found.append([np.sqrt(np.mean((way - flow.truth(between)) ** 2) / 0.5) for way in ways])
    linear, cubic = np.mean(found, axis=0)
    return float(linear), float(cubic)


def of_choice(whole: Flow, points: NDArray, choice: Mapping[str, Any]) -> tuple[float, float]:
    """Return processor time (µs a particle) and error of the velocity at points, from the nodes of a volume."""
    spacing = LENGTH / round(LENGTH / (choice["spacing"] * choice["width"]))
    bounds = dict.fromkeys("xyz", (0.0, LENGTH))
    squares = []
    times = []
    frames = choice["frames"]
    for first in range(0, 64, max(frames, 16)):
        scene = whole.scene.isel(time=slice(first, first + frames))
        begin = time.process_time()
        f = scene.cg.coarse_grain(
            "velocity", width=choice["width"], spacing=spacing, bounds=bounds, kernel=choice["kernel"],
            for_averages=True,
        )  # fmt: skip
        mean = (f.velocity.fillna(0.0) * f.density).sum("time") / f.density.sum("time")
        times.append(time.process_time() - begin)
        at = {a: xr.DataArray(points[:, k], dims="point") for k, a in enumerate("xyz")}
        found = mean.sel(component="x").interp(at) - flows.sine(1).truth(points[:, 2])
        squares.append(float((found**2).mean()))
    return 1e6 * min(times) / whole.scene.sizes["particle"], float(np.sqrt(np.mean(squares) / 0.5))


def on_the_front(points: Sequence[tuple[str, Any, float, float]]) -> list[str]:
    """Names of the choices that no other beats in both time and error."""
    return [
        f"{name} {value}".strip() for name, value, t, e in points if not any(u <= t and d < e for _, _, u, d in points)
    ]  # fmt: skip


def table_of_flows() -> str:
    rows = [
        "| flow | field | bias at 0.75 d | noise at 0.75 d | width chosen | bias there | noise there |",
        "|---" * 7 + "|",
    ]
    for name, make in {**flows.FLOWS, "column": flows.column}.items():
        flow = make(60)
        nodes = NODES if name != "column" else NODES | {"bounds": {"z": (3.0, 24.0)}}
        chosen = flow.scene.cg.choose_width(
            flow.field, frames=16, sample=16, **nodes
        ).best_width.item()
        size = float(np.sqrt(np.mean(flow.truth(np.linspace(*nodes["bounds"]["z"], 200)) ** 2)))
        cells = []
        for width in (0.75, chosen):
            f = flow.scene.cg.coarse_grain(flow.field, width=width, **nodes)
            cells.append([f"{100 * e / size:.2g} %" for e in flow.errors(f)])
        rows.append(
            f"| {name} | {flow.field} | {' | '.join(cells[0])} | {chosen:.2f} d | {' | '.join(cells[1])} |"
        )
    return "\n".join(rows)


def main() -> str:
    """Draw the picture, and return the text."""
    import matplotlib.pyplot as plt
    from matplotlib.patheffects import withStroke
    from matplotlib.ticker import LogLocator, NullFormatter

    figure, axes = plt.subplots(2, 2, figsize=(11, 8), layout="constrained")
    flow = flows.sine(64)
    size = np.sqrt(0.5)
    widths = np.geomspace(0.4, 4, 14)
    bias, noise = np.array([of_width(flow, w) for w in widths]).T / size
    ax = axes[0, 0]
    ax.loglog(widths, bias, "o", color="C0", label="bias")
    ax.loglog(widths, noise, "s", color="C1", label="noise of one frame")
    ax.loglog(widths, bias[6] * (widths / widths[6]) ** 2, "C0-", lw=1, label="slope 2")
    ax.loglog(widths, noise[6] * (widths / widths[6]) ** -0.5, "C1-", lw=1, label="slope -1/2")
    ax.loglog(
        widths, np.hypot(bias, noise / 4), "k--", lw=1, label="error of the mean of 16 frames"
    )
    ax.set(
        xlabel="width [diameters]",
        ylabel="relative error",
        title="Width (sine, profile)",
        ylim=(2e-3, 1),
    )
    ax.legend(fontsize="small")

    ax = axes[0, 1]
    counts = np.array([1, 2, 4, 8, 16, 32, 64])
    f = flow.scene.cg.coarse_grain("velocity", width=0.75, **NODES)
    value = flow.value(f) - flow.truth(f.z)
    total = [float((value.coarsen(time=n).mean() ** 2).mean() ** 0.5) / size for n in counts]
    spread = float(value.std("time", ddof=1).mean()) / size
    ax.loglog(counts, total, "ko", label="error of the mean")
    ax.loglog(counts, spread / np.sqrt(counts), "C1-", lw=1, label="noise, slope -1/2")
    ax.axhline(of_width(flow, 0.75)[0] / size, color="C0", lw=1, label="bias")
    ax.set(
        xlabel="number of frames",
        ylabel="relative error",
        title="Frames (sine, profile, w = 0.75 d)",
    )
    ax.legend(fontsize="small")

    ax = axes[1, 0]
    ratios = np.array([0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0])
    lines = {w: np.array([of_spacing(flow, r * w) for r in ratios]) for w in (0.75, 1.5)}
    for k, (w, loss) in enumerate(lines.items()):
        ax.loglog(ratios, loss[:, 0], f"C{k}o-", label=f"linear, w = {w} d")
        ax.loglog(ratios, loss[:, 1], f"C{k}s--", label=f"cubic, w = {w} d")
    ax.loglog(ratios, lines[0.75][3, 0] * ratios**2, "k:", lw=1, label="slope 2")
    ax.set(
        xlabel="spacing over width",
        ylabel="relative error",
        title="Spacing (sine of wavelength 12 d, no noise)",
    )
    ax.legend(fontsize="small")

    ax = axes[1, 1]
    whole = flows.sine(64, side=SIDE)
    points = np.random.default_rng(2).uniform(0, LENGTH, (2000, 3))
    choices = [DEFAULT]
    for name, values in CHOICES.items():
        choices += [{**DEFAULT, name: value} for value in values if value != DEFAULT[name]]
    found = [of_choice(whole, points, choice) for choice in choices * REPEATS]
    costs = []
    for k in range(len(choices)):
        repeats = found[k :: len(choices)]
        costs.append((min(t for t, _ in repeats), repeats[0][1]))
    measured = []
    for k, (name, values) in enumerate(CHOICES.items()):
        line = [costs[choices.index({**DEFAULT, name: value})] for value in values]
        ax.loglog(*zip(*line, strict=True), f"C{k}{MARKERS[k]}-", lw=1, label=name)
        for value, (t, e) in zip(values, line, strict=True):
            if value == DEFAULT[name]:
                continue
            measured.append((name, value, t, e))
            ax.annotate(
                f"{value}",
                (t, e),
                textcoords="offset points",
                fontsize=8,
                color=f"C{k}",
                path_effects=[withStroke(linewidth=3, foreground="white")],
                **BESIDE.get(name, {"xytext": (6, 5)}),
            )
    measured.append(("the default", "", *costs[0]))
    ax.loglog(*costs[0], "ko", mfc="none", ms=14, label="default")
    ax.margins(0.12)
    ax.set(
        xlabel="processor time [µs per particle]",
        ylabel="relative error",
        title="Time (sine, volume)",
    )
    ax.legend(fontsize="small")
    for ax in axes.flat:
        for axis in (ax.xaxis, ax.yaxis):
            axis.set_major_locator(
                LogLocator(
                    subs=(1.0, 2.0, 5.0)
                    if np.ptp(np.log10(axis.get_view_interval())) < 3
                    else (1.0,)
                )
            )
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter(NullFormatter())
    figure.savefig(PICTURE, dpi=110)
    plt.close(figure)

    rows = ["  | spacing | linear | cubic |", "  |---|---|---|"]
    for ratio in (0.5, 1.0, 1.5):
        linear, cubic = 100 * lines[0.75][list(ratios).index(ratio)]
        rows.append(f"  | {ratio:g} w | {linear:.2g} % | {cubic:.2g} % |")
    spacing = "\n" + "\n".join(rows) + "\n"
    front = ", ".join(on_the_front(measured))
    return TEXT.format(
        spacing=spacing,
        front=front,
        particles=whole.scene.sizes["particle"],
        table=table_of_flows(),
    )
