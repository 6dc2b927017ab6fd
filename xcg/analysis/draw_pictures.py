"""Drawing of pictures: profiles with their errors, maps with arrows, with axes and colours that several share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.analysis.compare import ERROR
from xcg.analysis.picture import (
    ARROW,
    CIRCLE,
    TITLED,
    UNROLLED,
    Shading,
    axes_of,
    check_errors,
    finite_of,
    may_diverge,
)
from xcg.common import drawing
from xcg.common.checks import extra
from xcg.scene.schema import NUMBERED

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ARROWS = 20  # along the longer axis of a map
AT_REST = 0.1  # of the speed whose arrow fills its cell: slower ones have no arrow
FASTEST = 98  # percentile of that speed, so that single grains do not make all other arrows short
NARROW = 2.0  # inches of a map, in which numbers below it may run into each other
LOWEST = 1.0  # inches of a colour bar, in which its label can be read
BESIDE = 0.8  # of the width that is left of a map beside its colour bar, about


@dataclass(frozen=True, eq=False)
class Frames:
    """Pictures of one field that share axes, colours and their ends.

    Attributes
    ----------
    pictures : list of Dataset
        Numbers of each step, with errors and arrows.
    name : str
        The field.
    axes : list of str
        Across, then up; one of profiles.
    values : array (n,)
        All numbers.
    limits : array (n,) or None
        Numbers that profiles extend over; None lets matplotlib choose.
    keywords : mapping
        Keywords of matplotlib: colours and their ends, and options of the caller.
    fastest : float
        Speed whose arrow is as long as arrows are apart.
    """

    pictures: list[xr.Dataset]
    name: str
    axes: list[str]
    shading: Shading
    values: NDArray
    limits: NDArray | None
    keywords: Mapping[str, Any]
    fastest: float

    @classmethod
    def of(
        cls,
        pictures: list[xr.Dataset],
        shading: Shading,
        ends: Mapping[str, Any],
        options: Mapping[str, Any],
    ) -> Frames:
        """Find what pictures share; pictures of several steps have the same limits.

        A field that is divided by the pressure, such as the inertial number, is thousands of times
        larger at a free surface than elsewhere: the pictures end before, and their labels say so.
        """
        name = pictures[0].attrs["drawn"]
        axes = axes_of(pictures[0])
        for picture in pictures:
            check_errors(picture)
        values = finite_of(picture[name] for picture in pictures)
        drawn = values
        note = ""
        if ends["vmax"] is None and "norm" not in options and may_diverge(pictures[0][name]):
            drawn, note = drawing.without_tail(values)
        if note:
            label = f"{drawing.long_name_of(pictures[0][name], name)}{note}"
            pictures = [p.assign({name: p[name].assign_attrs(long_name=label)}) for p in pictures]
        limits = None
        if note or len(pictures) > 1:
            limits = drawn
        if len(axes) == 1:
            return cls(pictures, name, axes, shading, values, limits, options, 0.0)
        if "color" in options:
            raise TypeError("plot: a map has many colours, and color= is for lines; give cmap=")
        if "norm" in options:
            colours = {"cmap": "viridis"}
            colours |= {end: value for end, value in ends.items() if value is not None}
        else:
            colours = drawing.colours_of(drawn, **ends)
        keywords = {"rasterized": shading == "smooth", **colours, **options}
        fastest = max(map(_fastest, pictures))
        return cls(pictures, name, axes, shading, values, limits, keywords, fastest)

    @property
    def ratio(self) -> float | None:
        """Height over width of a map; None of profiles and unrolled maps, which have any."""
        if len(self.axes) == 1 or tuple(self.axes) == UNROLLED:
            return None
        if tuple(self.axes) == CIRCLE:
            return 1.0
        return drawing.ratio_of(self.pictures[0][self.name].transpose(*self.axes[::-1]))

    def draw(self, picture: xr.Dataset, ax: Axes) -> None:
        """Draw a picture; a map of a figure's first with its colour bar."""
        if len(self.axes) == 1:
            self._draw_profile(picture, ax)
            return
        if tuple(self.axes) == CIRCLE:
            mesh = self._draw_circle(picture.sortby(self.axes), ax)
        else:
            mesh = self._draw_map(picture.sortby(self.axes), ax)
        if picture is self.pictures[0]:
            values = self.values
            if "norm" in self.keywords:  # its ends are those of the drawn numbers
                values = np.ma.compressed(mesh.get_array())
            _draw_colour_bar(picture, self.name, mesh, values)

    def _draw_profile(self, picture: xr.Dataset, ax: Axes) -> None:
        axis = self.axes[0]
        upright = axis == "z"
        fill: Any = ax.fill_between
        limits: Any = ax.get_ylim
        set_limits: Any = ax.set_ylim
        names = [axis, self.name]
        if upright:
            fill = ax.fill_betweenx
            limits = ax.get_xlim
            set_limits = ax.set_xlim
            names.reverse()
        before: Any = ()
        if ax.has_data():
            before = limits()
        nodes = picture[axis].to_numpy()
        value = picture[self.name]
        error = picture.get(f"{self.name}{ERROR}")
        others = [dim for dim in value.dims if dim != axis]
        for labels in product(*(value[dim].to_numpy() for dim in others)):
            selection = dict(zip(others, labels, strict=True))
            y = value.sel(selection).to_numpy()
            points = [nodes, y]
            if upright:
                points.reverse()
            label = ", ".join(map(str, labels)) or None
            (line,) = ax.plot(*points, **{"label": label, **self.keywords})
            if error is not None:
                e = error.sel(selection).to_numpy()
                fill(nodes, y - e, y + e, color=line.get_color(), alpha=0.25, lw=0)
        for name, of_axis in zip(names, (ax.xaxis, ax.yaxis), strict=True):
            drawing.set_label(of_axis, drawing.label_of(picture[name], name))
        if others:
            ax.legend(title=", ".join(map(str, others)))
        if self.limits is not None:
            low, high = drawing.ends_of(np.concatenate([self.limits, before]))
            margin = 0.05 * (high - low)
            set_limits(low - margin, high + margin)

    def _draw_map(self, picture: xr.Dataset, ax: Axes) -> Any:
        across, up = self.axes
        x, y, values = drawing.cells_of(picture[self.name].transpose(up, across), self.shading)
        mesh: Any
        if self.shading == "smooth" and _are_even(x) and _are_even(y):
            # draws in a quarter of the time of a mesh of as many cells
            mesh = ax.imshow(
                values,
                extent=(x[0], x[-1], y[0], y[-1]),
                origin="lower",
                aspect="auto",
                interpolation="nearest",
                **self.keywords,
            )
            ax.autoscale_view()  # an image sets the limits to its own extent
        else:
            mesh = ax.pcolormesh(x, y, values, **self.keywords)
        self._draw_arrows(picture, ax)
        if across != "theta":
            ax.set_aspect("equal")
        ax.apply_aspect()
        wide = ax.get_window_extent().width / ax.figure.dpi
        if wide < NARROW:
            ticker = extra("matplotlib.ticker", "plot", "drawing")
            ax.xaxis.set_major_locator(ticker.MaxNLocator(max(1, int(1.5 * wide))))
        drawing.set_label(ax.xaxis, drawing.label_of(picture[across], across))
        drawing.set_label(ax.yaxis, drawing.label_of(picture[up], up))
        return mesh

    def _draw_circle(self, picture: xr.Dataset, ax: Axes) -> Any:
        """Draw a map over r and theta in the plane of the circle, with arrows on a grid of squares."""
        value = picture[self.name].transpose("theta", "r")
        rim, turn, values = drawing.cells_of(value, self.shading)
        rim = rim.clip(0)
        across = rim * np.cos(turn[:, None])
        up = rim * np.sin(turn[:, None])
        mesh = ax.pcolormesh(across, up, values, **self.keywords)
        self._draw_arrows(picture, ax)
        ax.set_aspect("equal")
        unit = drawing.label_of(picture["r"], "r").removeprefix("$r$")
        drawing.set_label(ax.xaxis, rf"$r\,\cos\theta${unit}")
        drawing.set_label(ax.yaxis, rf"$r\,\sin\theta${unit}")
        return mesh

    def _draw_arrows(self, picture: xr.Dataset, ax: Axes) -> None:
        if not self.fastest > 0:
            return
        x, y, along, rise, apart = _arrows(picture, self.name, self.fastest)
        ax.quiver(
            x,
            y,
            along,
            rise,
            pivot="mid",
            color="white",
            edgecolor="black",
            linewidth=0.5,
            angles="xy",
            scale_units="xy",
            scale=self.fastest / apart,
            width=0.006,
        )


def _are_even(edges: NDArray) -> bool:
    """Return whether edges are equally far apart."""
    steps = np.diff(edges)
    return bool(np.ptp(steps) <= 1e-6 * abs(steps).max())


def _arrows(
    picture: xr.Dataset, name: str, fastest: float
) -> tuple[NDArray, NDArray, NDArray, NDArray, float]:
    """Return middles and components (n,) of arrows, which slow nodes have none of, and how far they are apart."""
    across, up = axes_of(picture)
    if (across, up) == CIRCLE:
        x, y, along, rise, apart = _arrows_in_circle(picture, name)
    else:
        x, y, along, rise, apart = _arrows_on(picture, across, up)
    moving = np.hypot(along, rise) >= AT_REST * fastest
    return x[moving], y[moving], along[moving], rise[moving], apart


def _arrows_on(
    picture: xr.Dataset, across: str, up: str
) -> tuple[NDArray, NDArray, NDArray, NDArray, float]:
    """Return positions and components of arrows on a map, (up, across), and how far they are apart."""
    every = max(1, round(max(picture.sizes[a] for a in (across, up)) / ARROWS))
    some = picture.isel({a: slice(every // 2, None, every) for a in (across, up)})
    along = some[f"{ARROW}{across}"].transpose(up, across).to_numpy()
    rise = some[f"{ARROW}{up}"].transpose(up, across).to_numpy()
    apart = [float(some[a][1] - some[a][0]) for a in (across, up) if some.sizes[a] > 1]
    x, y = np.meshgrid(some[across], some[up])
    return x, y, along, rise, min(apart, default=1.0)


def _arrows_in_circle(
    picture: xr.Dataset, name: str
) -> tuple[NDArray, NDArray, NDArray, NDArray, float]:
    """Return positions and components of arrows as `_arrows_on`, on a grid of squares in the plane of a circle."""
    rim, turn, _ = drawing.cells_of(picture[name].transpose("theta", "r"), "flat")
    apart = 2 * rim[-1] / ARROWS
    line = np.arange(-rim[-1] + apart / 2, rim[-1], apart)
    x, y = np.meshgrid(line, line)
    away = np.hypot(x, y)
    angle = np.mod(np.arctan2(y, x) - turn[0], 2 * np.pi) + turn[0]
    inside = (away >= rim[0]) & (away <= rim[-1]) & (angle <= turn[-1])
    x = x[inside]
    y = y[inside]
    away = away[inside]
    angle = angle[inside]
    points = {"r": xr.DataArray(away, dims="arrow"), "theta": xr.DataArray(angle, dims="arrow")}
    nearest = picture.sel(points, method="nearest")
    outward = nearest[f"{ARROW}r"].to_numpy()
    around = nearest[f"{ARROW}theta"].to_numpy()
    along = outward * np.cos(angle) - around * np.sin(angle)
    rise = outward * np.sin(angle) + around * np.cos(angle)
    return x, y, along, rise, apart


def segments_of(picture: xr.Dataset, name: str) -> dict[str, NDArray]:
    """Return the ends of the arrows that `plot` draws on a map of `picture_of`: x0, y0, x1, y1."""
    picture = picture.sortby(axes_of(picture))
    fastest = _fastest(picture)
    if not fastest > 0:
        return {end: np.zeros(0) for end in ("x0", "y0", "x1", "y1")}
    x, y, along, rise, apart = _arrows(picture, name, fastest)
    along = 0.5 * apart / fastest * along
    rise = 0.5 * apart / fastest * rise
    return {"x0": x - along, "y0": y - rise, "x1": x + along, "y1": y + rise}


def _fastest(picture: xr.Dataset) -> float:
    """Return the speed whose arrow is as long as arrows are apart; 0 without arrows."""
    parts = [picture[name].to_numpy() for name in picture if str(name).startswith(ARROW)]
    if not parts:
        return 0.0
    speeds = finite_of([np.hypot(*parts)])
    if not speeds.size:
        return 0.0
    return float(np.percentile(speeds, FASTEST))


def _draw_colour_bar(picture: xr.Dataset, name: str, mesh: Any, values: NDArray) -> None:
    """Draw the colour bar of a map, as high as the map."""
    ax = mesh.axes
    room = ax.get_position(original=True).transformed(ax.figure.transSubfigure)
    shrink = 1.0
    if ax.get_aspect() == 1:
        height = BESIDE * room.width * ax.get_data_ratio()
        shrink = min(1.0, max(height, LOWEST * ax.figure.dpi) / room.height)
    drawing.add_colour_bar(mesh, ax, drawing.label_of(picture[name], name), values, shrink=shrink)


def title_of(
    picture: xr.Dataset | xr.DataArray, write: Callable[[str], str] = drawing.unit_text
) -> str:
    """Return the time, the phase and the position of a slice as text, with units as `write` has them."""
    parts = []
    for name in [a for a in TITLED if a in picture.coords and not picture[a].ndim]:
        value = picture[name].item()
        unit = write(str(picture[name].attrs.get("units", "")))
        text = str(value)
        if isinstance(value, float):
            text = f"{value:.4g}"
        if picture[name].attrs.get("long_name") == NUMBERED:
            name = "step"
            text = f"{value:.0f}"
        parts.append(f"{name} = {text} {unit}".rstrip())
    return ", ".join(parts)
