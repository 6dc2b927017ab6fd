"""Labels, colours and cells of pictures, and the figures they are drawn in: the same for scenes, fields and chains."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.checks import extra

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis

# of the larger end of a field, which the smaller one has where colours are about zero
BOTH_SIGNS = 0.1
PERCENTILES = (90, 95, 98)  # of sizes, where a picture may end
FAR = 4.0  # times the first of these: beyond, numbers are so large that others could not be told apart
SMOOTH = 400  # cells along an axis of a smooth map
ROUNDED = 1.5  # nodes over which the rim of a smooth map is rounded
NEAREST = 0.1  # of the distance between nodes: a rim is at least as far from every node
BESIDE = 1.9  # inches of labels and bar beside a map
BELOW = 1.0  # inches of labels below and above it
ROUNDS = 8  # in which a figure makes room for its text
TITLE = 0.75  # of the width of a figure, which the longest line of a title may have
SMALLEST = (3.2, 2.0)  # inches of a figure, for its title and for the label of its bar
_SYMBOLS = {"x": "$x$", "y": "$y$", "z": "$z$", "r": "$r$", "theta": r"$\theta$"}  # of axes
# powers as UDUNITS has them: "m^-1", "m**-1" and "m-1"
_POWER = re.compile(r"(?:\^|\*\*)\(?([+-]?[\d.]+)\)?|(?<=[^\W\d_])([+-]?\d+)(?![\w.])")
_UNIT = re.compile(r"\[[^\]]*\]$")


def unit_text(units: str) -> str:
    """Return a unit with raised powers, for matplotlib: "m s^-1" as "m s$^{-1}$"; empty for numbers without a unit.

    Units that are already in the mathematical form of matplotlib (with "$") stay as they are.
    """
    units = units.strip()
    if units == "1" or "$" in units:
        return units.removeprefix("1")
    return _POWER.sub(lambda power: f"$^{{{power[1] or power[2]}}}$", units)


def unit_in_unicode(units: str) -> str:
    """Return a unit with raised powers, as plain text: "m s^-1" as "m s⁻¹"; empty for numbers without a unit."""
    raised = str.maketrans("0123456789-.+", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻·⁺")
    units = units.strip().removeprefix("1")
    return _POWER.sub(lambda power: (power[1] or power[2]).translate(raised), units)


def with_unit(text: str, units: str, write: Callable[[str], str] = unit_text) -> str:
    """Return a label: a text with its unit in brackets."""
    unit = write(units)
    return f"{text} [{unit}]" if unit else text


def long_name_of(value: xr.DataArray, name: str) -> str:
    """Return the long name of a variable, or its name in words."""
    return str(value.attrs.get("long_name", name.replace("_", " ")))


def label_of(value: xr.DataArray, name: str) -> str:
    """Return the label of a variable: the symbol of an axis, the long name, or the name, and the unit."""
    text = _SYMBOLS.get(name) or long_name_of(value, name)
    return with_unit(text, str(value.attrs.get("units", "")))


def set_label(axis: Axis, text: str) -> None:
    """Set the label of an axis or colour bar, broken into lines where it is longer than the axis.

    The axis has the length that it has now. A unit in brackets at the end stays in one line.
    """
    axis.axes.apply_aspect()
    side = "width" if axis is axis.axes.xaxis else "height"
    length = getattr(axis.axes.get_window_extent(), side)
    whole = _UNIT.sub(lambda unit: unit[0].replace(" ", "\0"), text)
    for letters in range(len(whole), 0, -1):
        broken = textwrap.fill(whole, letters, break_long_words=False, break_on_hyphens=False)
        axis.set_label_text(broken.replace("\0", " "))
        if getattr(axis.label.get_window_extent(), side) <= length:
            return


def set_title(ax: Axes, text: str) -> None:
    """Set the title of axes, broken into lines at its commas where the figure is too narrow for it."""
    title = ax.set_title(text)
    if title.get_window_extent().width > TITLE * ax.figure.bbox.width:
        title.set_text(text.replace(", ", "\n"))


def add_colour_bar(drawn: Any, ax: Axes, text: str, values: NDArray, **options: Any) -> None:
    """Add a labelled colour bar beside axes, with an arrow at an end that `values` exceed.

    `options` go to matplotlib.
    """
    low, high = drawn.get_clim()
    values = values[~np.ma.getmaskarray(drawn.norm(values))]  # those that have a logarithm
    is_above = bool((values > high).any())
    is_below = bool((values < low).any())
    extend = {(0, 0): "neither", (0, 1): "max", (1, 0): "min", (1, 1): "both"}[is_below, is_above]
    bar = ax.figure.colorbar(drawn, ax=ax, extend=extend, **options)
    powers: Any = bar.formatter
    if hasattr(powers, "set_powerlimits"):  # those of logarithmic scales have none
        powers.set_powerlimits((-3, 4))
        powers.set_useMathText(True)
    set_label(bar.ax.yaxis, text)


def add_circles(ax: Axes, centre: NDArray, radius: NDArray, **options: Any) -> Any:
    """Draw circles in units of the axes, and make room for them; `options` go to matplotlib."""
    collections = extra("matplotlib.collections", "plot", "drawing")
    circles = collections.EllipseCollection(
        2 * radius,
        2 * radius,
        np.zeros(len(radius)),
        units="xy",
        offsets=centre,
        offset_transform=ax.transData,
        **options,
    )
    ax.add_collection(circles, autolim=False)
    if len(centre):
        rim = radius[:, None]
        ax.update_datalim(np.concatenate([centre - rim, centre + rim]))
    ax.autoscale_view()
    ax.set_aspect("equal")
    return circles


def new_axes(projection: str | None = None, ratio: float | None = None) -> Axes:
    """Return the axes of a new figure of pyplot, with room for labels.

    A map of this `ratio` of height to width fills the figure.
    """
    pyplot = extra("matplotlib.pyplot", "plot", "drawing")
    size = tuple(pyplot.rcParams["figure.figsize"])
    if ratio is not None:
        size = size_of_figure(size, ratio, pyplot.rcParams["font.size"] / 10.0)
    figure = pyplot.figure(figsize=size, layout=layout())
    return cast("Axes", figure.add_subplot(projection=projection))


def layout() -> Any:
    """Return the layout of a figure: that of matplotlib ("constrained"), with all text inside of the figure.

    Ticks change with the size of the axes, after matplotlib has made room for the former ticks: where
    text is beyond an edge, the room is made smaller by as much.
    """
    engine: Any = extra("matplotlib.layout_engine", "plot", "drawing").ConstrainedLayoutEngine

    class RoomForText(engine):
        def execute(self, fig: Any) -> None:
            left, low, right, up = 0.0, 0.0, 0.0, 0.0  # inches that are left free
            wide, high = fig.get_size_inches()
            for _ in range(ROUNDS):
                room = (left / wide, low / high, 1 - (left + right) / wide, 1 - (low + up) / high)
                self.set(rect=room)
                super().execute(fig)
                drawn = fig.get_tightbbox()
                beyond = [-drawn.x0, -drawn.y0, drawn.x1 - wide, drawn.y1 - high]
                if max(beyond) <= 0 or not np.isfinite(beyond).all():
                    break
                left, low, right, up = np.add((left, low, right, up), np.maximum(beyond, 0))

    return RoomForText()


def size_of_figure(
    size: tuple[float, float], ratio: float, letters: float = 1.0
) -> tuple[float, float]:
    """Return width and height (inches) of a figure that a map with a colour bar fills.

    Parameters
    ----------
    size : tuple of float
        Largest width and height (inches). Tall maps are as high as the larger of both.
    ratio : float
        Height of the map over its width.
    letters : float
        Size of letters, in 10 points.
    """
    beside = letters * BESIDE
    below = letters * BELOW
    highest = size[1]
    if ratio > 1:
        highest = max(size)
    width = min(size[0] - beside, (highest - below) / ratio)
    fitted = (width + beside, width * ratio + below)
    smallest = np.minimum(np.multiply(letters, SMALLEST), size)
    wide, high = np.maximum(fitted, smallest).tolist()
    return wide, high


def ratio_of(value: xr.DataArray) -> float:
    """Return height over width of the cells of a map (up, across)."""
    up, across = (np.ptp(_edges(np.sort(value[dim].to_numpy()))) for dim in value.dims)
    if up > 0 and across > 0:
        return float(up / across)
    return 1.0


def ratio_of_circles(centre: NDArray, radius: NDArray) -> float:
    """Return height over width of what circles extend over, by their centres (n, 2) and radii (n,)."""
    if not len(centre):
        return 1.0
    rims = np.concatenate([centre - radius[:, None], centre + radius[:, None]])
    width, height = np.ptp(rims, axis=0)
    return float(height / width)


def ends_of(values: NDArray) -> tuple[float, float]:
    """Return the smallest and the largest number; two that differ, whatever the numbers."""
    if not values.size:
        return 0.0, 1.0
    low, high = float(values.min()), float(values.max())
    if low < high:
        return low, high
    return low - 0.5, high + 0.5


def check_ends(low: float, high: float, vmin: float | None, vmax: float | None) -> None:
    """Raise ValueError unless colours begin at or below their end, as `vmin` and `vmax` choose them."""
    if low > high:
        argument = f"vmax={vmax!r}"
        if vmax is None:
            argument = f"vmin={vmin!r}"
        raise ValueError(
            f"{argument}: the colours would go from {low:.4g} to {high:.4g}; expected vmin below vmax, and numbers "
            "between them"
        )


def without_tail(values: NDArray) -> tuple[NDArray, str]:
    """Return numbers without the tail that makes a picture flat, and a note for its label.

    Numbers far beyond the 90th percentile of all sizes are set to the highest of `PERCENTILES` that
    is not. The note is empty without such numbers.
    """
    if not values.size:
        return values, ""
    size = np.abs(values)
    # of few numbers, too, a percentile is one of them
    levels = np.percentile(size, PERCENTILES, method="lower")
    if not 0 < FAR * levels[0] < size.max():
        return values, ""
    k = np.flatnonzero(levels <= FAR * levels[0])[-1]
    return values.clip(-levels[k], levels[k]), f", up to its {PERCENTILES[k]}th percentile"


def _has_both_signs(values: NDArray) -> bool:
    """Return whether both signs matter: neither is a trace beside the other, by percentiles of what is not zero."""
    values = values[values != 0]
    if not values.size:
        return False
    low, high = np.percentile(values, (2, 98))
    return bool(low < 0 < high and min(-low, high) >= BOTH_SIGNS * max(-low, high))


def colours_of(
    values: NDArray, cmap: str | None, vmin: float | None, vmax: float | None
) -> dict[str, Any]:
    """Return colours and their ends as asked for; by default of all numbers, about zero where both signs matter."""
    low, high = ends_of(values)
    both_signs = _has_both_signs(values)
    end = max(-low, high)
    if vmin is not None:
        end = -vmin
    if vmax is not None:
        end = vmax
    if both_signs and end > 0:
        low, high = -end, end
    if vmin is not None:
        low = vmin
    if vmax is not None:
        high = vmax
    check_ends(low, high, vmin, vmax)
    usual = "RdBu_r" if both_signs and low == -high else "viridis"
    return {"cmap": cmap or usual, "vmin": low, "vmax": high}


def cells_of(value: xr.DataArray, shading: str) -> tuple[NDArray, NDArray, NDArray]:
    """Return the edges of the cells to draw, across and up, and the number in each of them.

    A smooth map has cells finer than the nodes. Their numbers are interpolated linearly between the
    nodes with finite numbers. The rim runs between these and nodes without, and is
    rounded, so that it has no stairs.
    """
    up, across = (value[dim].to_numpy() for dim in value.dims)
    numbers = value.to_numpy()
    if shading == "flat":
        return _edges(across), _edges(up), numbers
    finite = np.isfinite(numbers)
    is_circle = value.dims[0] == "theta"
    x, weight_x = _finer(across)
    y, weight_y = _finer(up, is_circle=is_circle)
    if finite.all():
        return x, y, weight_y @ numbers @ weight_x.T
    top = weight_y @ np.where(finite, numbers, 0.0) @ weight_x.T
    bottom = weight_y @ finite.astype(float) @ weight_x.T
    inside = weight_y @ _distance_from_rim(finite, is_circle=is_circle) @ weight_x.T > 0
    return x, y, np.where(inside, top / np.where(bottom > 0, bottom, 1.0), np.nan)


def pixels_of(value: xr.DataArray) -> tuple[NDArray, NDArray, NDArray]:
    """Return edges (across, up) and numbers of pixels in the plane of a circle: smooth cells of a map (theta, r)."""
    rim, turn, cells = cells_of(value, "smooth")
    rim = rim.clip(0)
    ends = rim[[0, -1]]
    across = np.linspace(*ends_of(ends * np.cos(turn[:, None])), SMOOTH + 1)
    up = np.linspace(*ends_of(ends * np.sin(turn[:, None])), SMOOTH + 1)
    x, y = np.meshgrid(0.5 * (across[1:] + across[:-1]), 0.5 * (up[1:] + up[:-1]))
    away = np.hypot(x, y)
    angle = np.mod(np.arctan2(y, x) - turn[0], 2 * np.pi) + turn[0]
    inside = (away >= rim[0]) & (away <= rim[-1]) & (angle <= turn[-1])
    row = np.searchsorted(turn, angle, "right").clip(1, len(cells)) - 1
    column = np.searchsorted(rim, away, "right").clip(1, len(cells.T)) - 1
    return across, up, np.where(inside, cells[row, column], np.nan)


def _distance_from_rim(finite: NDArray, *, is_circle: bool) -> NDArray:
    """Return the distance (up, across) of each node from the rounded rim of the finite ones, in nodes.

    It is positive at finite nodes and negative at others, whatever the rounding. The first node
    follows the last one upwards on a circle.
    """
    if not finite.any():
        return np.full(finite.shape, -1.0)
    from scipy.ndimage import distance_transform_edt, gaussian_filter  # slow to import

    turn = 0
    if is_circle:
        turn = len(finite)
    around = np.pad(finite, ((turn, turn), (0, 0)), mode="wrap")
    distance = np.where(
        around, distance_transform_edt(around) - 0.5, 0.5 - distance_transform_edt(~around)
    )
    smooth = gaussian_filter(distance, ROUNDED, mode="nearest")[turn : turn + len(finite)]
    return np.where(finite, np.maximum(smooth, NEAREST), np.minimum(smooth, -NEAREST))


def _finer(nodes: NDArray, *, is_circle: bool = False) -> tuple[NDArray, NDArray]:
    """Divide the cells of nodes into parts: edges (m + 1,), and weights of the nodes (m, n)."""
    count = len(nodes)
    parts = -(-SMOOTH // count) // 2 * 2 + 1  # odd: the middle of a cell is at each node
    edges = np.interp(np.arange(count * parts + 1) / parts, np.arange(count + 1), _edges(nodes))
    middle = 0.5 * (edges[1:] + edges[:-1])
    period = None
    if is_circle and edges[-1] - edges[0] >= 2 * np.pi * (1 - 1e-9):  # else a sector of it
        period = 2 * np.pi
    weights = np.stack(
        [np.interp(middle, nodes, unit, period=period) for unit in np.eye(count)], axis=1
    )
    return edges, weights


def _edges(nodes: np.ndarray) -> np.ndarray:
    """Find the ends of the cells around nodes."""
    if nodes.size < 2:
        return np.repeat(nodes, 2)
    middle = 0.5 * (nodes[1:] + nodes[:-1])
    return np.concatenate([[2 * nodes[0] - middle[0]], middle, [2 * nodes[-1] - middle[-1]]])
