"""Writes docs/truth.md: fields of systems whose answer is known, over the truth: python -m docs.truth, from the root.

The systems are in `tests/truths.py`. `python -m docs.truth --rows` prints every row as well.
"""

from __future__ import annotations

import argparse
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr

from docs.marks import write_between
from tests.truths import MESHES, System, Truth, systems
from xcg.fields.formulas import registry

PICTURE = Path(__file__).parent / "_static" / "truth.png"
WIDTHS = (0.5, 0.75, 1.0, 1.5, 2.0, 3.0)
DEFAULT = 0.75
CLOSE = 0.05
# within 5 % blue, beyond it yellow to brown, which colour-blind readers tell apart
COLOURS = ("#74add1", "#c6dff0", "#fee391", "#fec44f", "#fb8c29", "#cc4c02", "#7f2704")
GROUPS = 8  # of steps, that are left out in turn
WAYS = ("one step", "average")


@dataclass(frozen=True)
class Row:
    """Comparison of a field with its truth, on one kind of mesh at one width.

    Attributes
    ----------
    system : str
        Name of the system.
    truth : Truth
        The field and its true value.
    mesh : str
        Kind of mesh.
    width : float
        Width over d43.
    way : str
        "one step", or "average" over all steps.
    value : float
        Mean of the field over its mean truth; the value itself where the truth is zero.
    unbiased : float
        As `value`, of an average less its bias; NaN where it has none.
    uncertainty : float
        Standard error of `unbiased` or `value`, from the scatter over the steps.
    within : float
        Share of the nodes whose value, less its bias, is within two of its errors; NaN where it has
        none.
    said : str
        "warning", "NaN" (at most nodes), or nothing.
    """

    system: str
    truth: Truth
    mesh: str
    width: float
    way: str
    value: float
    unbiased: float
    uncertainty: float
    within: float
    said: str

    @property
    def best(self) -> float:
        """The value less its bias, where that is known."""
        return self.value if np.isnan(self.unbiased) else self.unbiased

    @property
    def error(self) -> float:
        """Deviation of the best value, relative to the truth or the scale."""
        return _relative(self.truth, self.best)

    @property
    def excess(self) -> float:
        """Modulus of the error less two uncertainties, 0 where it is within these."""
        scatter = 2 * self.uncertainty
        if self.truth.scale is not None:
            scatter /= self.truth.scale
        return max(abs(self.error) - scatter, 0.0)


def _relative(truth: Truth, value: float) -> float:
    """Return the deviation from 1, or over the scale where the truth is zero."""
    if truth.scale is not None:
        return value / truth.scale
    return value - 1.0


def _mean_of(truth: Truth, values: xr.DataArray, true: xr.DataArray) -> float:
    """Return the mean over the nodes, over that of the truth where it is not zero."""
    if truth.scale is not None:
        return float(values.mean())
    return float((values * true).sum() / (true.where(values.notnull()) ** 2).sum())


def best_of(truth: Truth, f: xr.Dataset) -> float:
    """Return the mean of a field over nodes and steps, as in `Row`, less its bias where that is known."""
    values = truth.of(f)
    assert values is not None
    bias = truth.of(f, "_bias")
    if bias is not None:
        values = values - bias.fillna(0.0)
    return _mean_of(truth, values, xr.zeros_like(values) + truth.at(f))


def compare(
    system: str,
    truth: Truth,
    f: xr.Dataset,
    mesh: str,
    width: float,
    way: str,
    texts: str,
    parts: Sequence[xr.Dataset],
) -> Row:
    """Compare one field of a result with its truth; `parts` are results without each of some groups of steps."""
    values = truth.of(f)
    assert values is not None
    true = xr.zeros_like(values) + truth.at(f)
    known = values.notnull()
    value = _mean_of(truth, values, true)
    bias = truth.of(f, "_bias")
    unbiased = np.nan
    if bias is not None:
        values = values - bias.fillna(0.0)
        unbiased = _mean_of(truth, values, true)
    scatter = np.std([best_of(truth, part) for part in parts])
    uncertainty = float(scatter * np.sqrt(len(parts) - 1))
    error = truth.of(f, "_error")
    within = np.nan
    if error is not None and bool(error.notnull().any()):
        has_error = known & error.notnull()
        # of exact values errors are rounding
        close = np.abs(values - true) <= 2 * error + 1e-9
        within = float(close.where(has_error).mean())
    said = ""
    if re.search(rf"\b{truth.name}\b(?! at a node)", texts):
        said = "warning"
    elif float(known.mean()) < 0.5:
        said = "NaN"
    return Row(system, truth, mesh, width, way, value, unbiased, uncertainty, within, said)


def measure(
    system: System, meshes: Iterable[str] = tuple(MESHES), widths: Sequence[float] = WIDTHS
) -> Iterator[Row]:
    """Yield the comparison of each field of a system, of single steps and of averages."""
    ds = system.make()
    names = list(dict.fromkeys(truth.name for truth in system.truths))
    has_error = any(f"{name}_error" in registry.FIELDS for name in names)
    for mesh in (mesh for mesh in meshes if mesh in system.meshes):
        # fields of the whole box do not depend on the width
        for width in (DEFAULT,) if mesh == "box" else widths:
            options = {"width": f"{width} d43", **system.nodes(mesh), **system.options}
            with warnings.catch_warnings(record=True) as of_steps:
                warnings.simplefilter("always")
                f = ds.cg.coarse_grain(
                    names,
                    for_averages=True,
                    errors=has_error and mesh != "box",
                    **options,
                )
            with warnings.catch_warnings(record=True) as of_average:
                warnings.simplefilter("always")
                mean = f.cg.time_average()
            parts = _without_groups(f)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                means = [part.cg.time_average() for part in parts]
            for truth in system.truths:
                for way, result, caught, some in (
                    (WAYS[0], f, of_steps, parts),
                    (WAYS[1], mean, of_average, means),
                ):
                    texts = " ".join(str(warning.message) for warning in caught)
                    yield compare(system.name, truth, result, mesh, width, way, texts, some)


def _without_groups(f: xr.Dataset) -> list[xr.Dataset]:
    """Return a result without each of some groups of its steps, which are independent of each other."""
    steps = np.arange(f.sizes["time"])
    groups = min(GROUPS, len(steps))
    return [f.isel(time=steps % groups != group) for group in range(groups)]


# --- the page ------------------------------------------------------------------------------------


def _number(row: Row) -> str:
    if np.isnan(row.value):
        return "NaN"
    text = f"{row.best:.2f}"
    if row.excess > CLOSE:
        text = f"**{text}**"
    if row.uncertainty > 0.005:
        text += f" ± {row.uncertainty:.2f}"
    if abs(row.unbiased - row.value) > 0.005:
        text = f"{row.value:.2f}, {text}"
    if np.isfinite(row.within):
        text += f" ({100 * row.within:.0f} %)"
    if row.said == "warning":
        text += " w"
    return text


def _from_width(rows: Sequence[Row]) -> str:
    """Return the longest range of widths at which a field is not shown to be beyond 5 % of its truth."""
    runs: list[list[float]] = [[]]
    for row in rows:
        if row.excess <= CLOSE:
            runs[-1].append(row.width)
        else:
            runs.append([])
    close = max(runs, key=len)
    if not close:
        return "none"
    if len(close) == len(rows):
        return "all"
    if close[-1] == WIDTHS[-1]:
        return f"from {close[0]:g}"
    if close[0] == WIDTHS[0]:
        return f"to {close[-1]:g}"
    if len(close) == 1:
        return f"{close[0]:g}"
    return f"{close[0]:g} to {close[-1]:g}"


def _truth_of(truth: Truth) -> str:
    if truth.scale is not None:
        return f"0 (5 % of {truth.scale:g})"
    if callable(truth.value):
        return "varies"
    return f"{truth.value:.3g}"


def groups_of(rows: Iterable[Row]) -> dict[tuple[str, str], list[Row]]:
    """Return rows by system and field."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.system, row.truth.label), []).append(row)
    return groups


def table_of_values(rows: Sequence[Row], way: str) -> str:
    """Return the table of values over truth at the default width."""
    lines = ["| system | field | truth | " + " | ".join(MESHES) + " |", "|---" * 7 + "|"]
    for (system, label), group in groups_of(rows).items():
        cells = dict.fromkeys(MESHES, "")
        for row in group:
            if row.way == way and row.width == DEFAULT:
                cells[row.mesh] = _number(row)
        lines.append(
            f"| {system} | {label} | {_truth_of(group[0].truth)} | {' | '.join(cells.values())} |"
        )
    return "\n".join(lines)


def table_of_widths(rows: Sequence[Row]) -> str:
    """Return the table of widths within which fields are close to their truth."""
    head = [f"{mesh}, {way}" for way in WAYS for mesh in MESHES]
    lines = ["| system | field | " + " | ".join(head) + " |", "|---" * (2 + len(head)) + "|"]
    for (system, label), group in groups_of(rows).items():
        cells: Mapping[tuple[str, str], list[Row]] = {(w, m): [] for w in WAYS for m in MESHES}
        for row in group:
            cells[row.way, row.mesh].append(row)
        texts = [_from_width(cell) if cell else "" for cell in cells.values()]
        lines.append(f"| {system} | {label} | {' | '.join(texts)} |")
    return "\n".join(lines)


def draw(rows: Sequence[Row]) -> None:
    """Draw the deviations of all fields, meshes and widths."""
    import matplotlib.pyplot as plt
    from matplotlib.colors import BoundaryNorm, ListedColormap

    groups = groups_of(rows)
    columns = [(mesh, width) for mesh in MESHES for width in WIDTHS if mesh != "box"]
    columns.append(("box", DEFAULT))
    edges = [0.0, 0.01, 0.05, 0.1, 0.25, 0.5, 1.0, 10.0]
    colours = ListedColormap(COLOURS)
    figure, axes = plt.subplots(
        1, 2, figsize=(13, 0.24 * len(groups) + 1.8), sharey=True, layout="constrained"
    )
    for ax, way in zip(axes, WAYS, strict=True):
        table = np.full((len(groups), len(columns)), np.nan)
        for k, group in enumerate(groups.values()):
            for row in group:
                if row.way != way:
                    continue
                column = columns.index((row.mesh, row.width))
                table[k, column] = row.excess
                if row.said == "warning":
                    ax.plot(column, k, "ko", ms=2.6, mec="white", mew=0.5)
        image = ax.imshow(
            np.minimum(table, 9.9),
            aspect="auto",
            cmap=colours,
            norm=BoundaryNorm(edges, len(COLOURS)),
            interpolation="nearest",
        )
        ax.set_title(way)
        ax.set_xticks(range(len(columns)), [f"{w:g}" for _, w in columns[:-1]] + [""], fontsize=6)
        for k, mesh in enumerate(MESHES):
            middle = k * len(WIDTHS)
            if mesh != "box":
                middle += len(WIDTHS) / 2 - 0.5
            ax.text(middle, len(groups) + 1.0, mesh, ha="center", va="top", fontsize=9)
            ax.axvline(k * len(WIDTHS) - 0.5, color="white", lw=2)
        ax.set_xlabel("\n\nwidth over d43, by kind of mesh")
        names = [system for system, _ in groups]
        for k in range(1, len(names)):
            if names[k] != names[k - 1]:
                ax.axhline(k - 0.5, color="white", lw=2)
    labels = [f"{system}: {label.replace('`', '')}" for system, label in groups]
    axes[0].set_yticks(range(len(groups)), labels, fontsize=8)
    bar = figure.colorbar(image, ax=axes, ticks=edges[:-1], pad=0.01)
    bar.set_label("|value - truth| less two uncertainties, over the truth")
    bar.ax.set_yticklabels([f"{100 * edge:g} %" for edge in edges[:-1]])
    figure.savefig(PICTURE, dpi=110)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", action="store_true", help="print each row, too")
    parser.add_argument("--only", default="", help="systems whose names contain these words")
    arguments = parser.parse_args()
    rows = []
    for system in systems():
        if arguments.only in system.name:
            rows += measure(system)
            print(f"{system.name}: {len(rows)} rows", flush=True)
    if arguments.rows:
        for row in rows:
            print(
                f"{row.system} | {row.truth.label} | {row.mesh} | {row.width:g} | {row.way} | {row.value:.4g} | "
                f"{100 * row.error:+.1f} % | {row.unbiased:.4g} | {row.uncertainty:.3g} | {row.within:.2f} | {row.said}"
            )
    for way in WAYS:
        print(f"\n{way}\n{table_of_values(rows, way)}")
    print(f"\n{table_of_widths(rows)}")
    if not arguments.only:
        write_between("truth.md", "one step", table_of_values(rows, WAYS[0]))
        write_between("truth.md", "average", table_of_values(rows, WAYS[1]))
        write_between("truth.md", "widths", table_of_widths(rows))
        draw(rows)


if __name__ == "__main__":
    main()
