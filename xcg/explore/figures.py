"""Figures of Bokeh that are drawn once and then given new numbers: a map, a profile, errors against width."""

from __future__ import annotations

import textwrap
import warnings
from collections.abc import Mapping
from itertools import product
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.analysis.compare import ERROR
from xcg.analysis.draw_pictures import segments_of, title_of
from xcg.analysis.picture import CIRCLE, UNROLLED, may_diverge
from xcg.common import drawing
from xcg.common.checks import extra
from xcg.common.messages import SceneWarning
from xcg.explore.choices import Choice
from xcg.scene.frame import with_rising
from xcg.scene.times import evenly_spaced

HIGHEST = 620  # pixels of the height of a map
NARROWEST = 260  # pixels of its width, with labels; the narrowest maps are not to scale
SHORTEST = 80  # pixels of its height; very flat maps are not to scale
BESIDE = 170  # pixels of labels and colour bar
RATIO = 0.6  # of height to width of a map of an angle and a length
SIDE = 260  # pixels of the square of errors
LETTERS = 60  # in a line of a title
LINE = 19  # pixels of its height
OF_BAR = 50  # letters in a line beside a colour bar
COLOURS = 256
_OF_ERRORS = {"bias": "#1f77b4", "bias with noise": "#1f77b4", "noise": "#ff7f0e", "total": "black"}
CLEAR = "rgba(0, 0, 0, 0)"
TOOLS = "pan,wheel_zoom,box_zoom,reset,save"
_EMPTY_IMAGE: dict[str, list] = {"image": [], "x": [], "y": [], "dw": [], "dh": []}
_EMPTY_LINES: dict[str, list] = {"x": [], "y": [], "colour": [], "label": []}
_EMPTY_BANDS: dict[str, list] = {"x": [], "y": [], "colour": []}
_EMPTY_ARROWS: dict[str, list] = {"x0": [], "y0": [], "x1": [], "y1": []}
# colours by their names in matplotlib
PALETTES = {
    "viridis": "Viridis256",
    "plasma": "Plasma256",
    "inferno": "Inferno256",
    "cividis": "Cividis256",
    "turbo": "Turbo256",
    "RdBu_r": "RdBu11",
}
# a map fills the width of the page, and its height follows by the ratio of its axes
FOLLOW = """
const [ratio, shortest] = figure.tags;
const height = Math.max(shortest, Math.round(figure.inner_width * ratio));
if (figure.inner_width && figure.frame_height != height) figure.frame_height = height;
"""
_EMPTY_CIRCLES: dict[str, list] = {"x": [], "y": [], "radius": []}


def label_of(value: xr.DataArray, name: str) -> str:
    """Return the name in words of a variable, or the letter of an axis, with its unit."""
    letters = {"theta": "θ", **{a: a for a in "rxyz"}}
    text = letters.get(name) or drawing.long_name_of(value, name)
    return drawing.with_unit(text, str(value.attrs.get("units", "")), drawing.unit_in_unicode)


def _set_title(figure: Any, *lines: str) -> None:
    """Set the title of a figure, broken into lines, and make room for them."""
    text = "\n".join(textwrap.fill(line, LETTERS) for line in lines if line)
    figure.title.text = text
    figure.min_border_top = LINE * (1 + text.count("\n"))


def _ends_of_logarithm(values: NDArray, name: str, choice: Choice) -> tuple[float, float]:
    """Return the ends of logarithmic colours; warn of numbers that have no logarithm.

    Raises
    ------
    ValueError
        If no number or an end of the colours is not above 0.
    """
    positive = values[values > 0]
    if not positive.size:
        raise ValueError(f"logarithm: {name} is nowhere above 0 in this picture; untick logarithm")
    for end in (choice.vmin, choice.vmax):
        if end is not None and end <= 0:
            raise ValueError(f"logarithm: the colours end at {end:g}; give an end above 0")
    if positive.size < values.size:
        share = 100 * (1 - positive.size / values.size)
        warnings.warn(
            f"logarithm: {share:.2g} % of {name} is not above 0, and has no colour",
            SceneWarning,
            stacklevel=2,
        )
    low, high = positive.min(), positive.max()
    if low == high:
        low, high = low / 2, 2 * high
    if choice.vmin is not None:
        low = choice.vmin
    if choice.vmax is not None:
        high = choice.vmax
    drawing.check_ends(low, high, choice.vmin, choice.vmax)
    return float(low), float(high)


class Map:
    """Map with a colour bar, interpolated between evenly spaced nodes, and circles on top.

    Attributes
    ----------
    figure : bokeh.plotting.figure
        To be shown.
    image, circles, arrows : bokeh.models.ColumnDataSource
        Its numbers.
    bar : bokeh.models.ColorBar
        Its colour bar.
    range : tuple of float
        Ends of the colours.
    """

    def __init__(self) -> None:
        models = extra("bokeh.models", "explore", "explore")
        self._palettes = extra("bokeh.palettes", "explore", "explore")
        self._extent: tuple[Any, ...] = ()
        self.image = models.ColumnDataSource(_EMPTY_IMAGE)
        self.circles = models.ColumnDataSource(_EMPTY_CIRCLES)
        self.arrows = models.ColumnDataSource(_EMPTY_ARROWS)
        self._linear = models.LinearColorMapper(palette="Viridis256", nan_color=CLEAR)
        self._logarithm = models.LogColorMapper(palette="Viridis256", nan_color=CLEAR)
        self.figure = extra("bokeh.plotting", "explore", "explore").figure(
            x_range=models.Range1d(0, 1),
            y_range=models.Range1d(0, 1),
            tools=TOOLS,
            name="map",
            sizing_mode="stretch_width",
            frame_height=HIGHEST,
            min_width=NARROWEST,
        )
        self.figure.tags = [1.0, SHORTEST]
        follow = models.CustomJS(args={"figure": self.figure}, code=FOLLOW)
        self.figure.js_on_change("inner_width", follow)
        self.figure.js_on_change("tags", follow)
        # an image for each scale: one that got the other's colours would keep its own until new numbers
        columns: dict[str, Any] = {name: name for name in _EMPTY_IMAGE}
        columns["source"] = self.image
        self._linear_image = self.figure.image(**columns, color_mapper=self._linear)
        self._logarithmic_image = self.figure.image(**columns, color_mapper=self._logarithm)
        self.figure.circle(
            "x",
            "y",
            radius="radius",
            source=self.circles,
            fill_color=None,
            line_color="black",
            line_alpha=0.5,
        )
        self.figure.segment(
            **{name: name for name in _EMPTY_ARROWS},
            source=self.arrows,
            line_color="black",
            line_width=3.5,
        )
        self.figure.add_layout(
            models.Arrow(
                **{
                    f"{axis}_{end}": f"{axis}{k}"
                    for axis in "xy"
                    for k, end in enumerate(("start", "end"))
                },
                source=self.arrows,
                end=models.VeeHead(size=7, fill_color="white", line_color="black"),
                line_color="white",
                line_width=1.5,
            )
        )
        hover = models.HoverTool(
            renderers=[self._linear_image, self._logarithmic_image],
            tooltips=[("value", "@image"), ("place", "$x, $y")],
        )
        self.figure.add_tools(hover)
        self.bar = models.ColorBar(color_mapper=self._linear, title_standoff=8)
        self.figure.add_layout(self.bar, "right")
        self.figure.grid.visible = False
        self.figure.toolbar.logo = None

    def draw(self, picture: xr.Dataset, choice: Choice) -> None:
        """Draw numbers (up, across) and arrows. The view stays as the user zoomed it while the axes stay."""
        numbers = picture[choice.field]
        up, across = (str(dim) for dim in numbers.dims)
        numbers = with_rising(numbers, (up, across))
        label_across = label_of(numbers[across], across)
        label_up = label_of(numbers[up], up)
        label = self._colour(numbers, choice)
        if (across, up) == CIRCLE:
            edges_across, edges_up, values = drawing.pixels_of(numbers)
            unit = str(numbers["r"].attrs.get("units", ""))
            label_across = drawing.with_unit("r cos θ", unit, drawing.unit_in_unicode)
            label_up = drawing.with_unit("r sin θ", unit, drawing.unit_in_unicode)
        else:
            for axis in (across, up):
                if numbers.sizes[axis] > 2:
                    evenly_spaced(numbers[axis].to_numpy(), f"explore: nodes along {axis}")
            edges_across, edges_up, values = drawing.cells_of(numbers, "smooth")
        x, y = edges_across[0], edges_up[0]
        width = edges_across[-1] - x
        height = edges_up[-1] - y
        if choice.is_logarithmic:
            values = np.where(values > 0, values, np.nan)
        self.image.data = {"image": [values], "x": [x], "y": [y], "dw": [width], "dh": [height]}
        self.arrows.data = segments_of(picture, choice.field)
        figure = self.figure
        extent = (across, x, width, up, y, height)
        if extent != self._extent:
            self._extent = extent
            figure.x_range.update(start=x, end=x + width, reset_start=x, reset_end=x + width)
            figure.y_range.update(start=y, end=y + height, reset_start=y, reset_end=y + height)
            ratio = height / width
            if (across, up) == UNROLLED:
                ratio = RATIO
            figure.max_width = max(NARROWEST, round(HIGHEST / ratio) + BESIDE)
            figure.tags = [ratio, SHORTEST]
        figure.xaxis.axis_label = label_across
        figure.yaxis.axis_label = label_up
        _set_title(figure, label, title_of(numbers, drawing.unit_in_unicode))

    def _colour(self, numbers: xr.DataArray, choice: Choice) -> str:
        """Set colours and their ends as `plot` has them; return the label of the colour bar."""
        finite = numbers.to_numpy()
        finite = finite[np.isfinite(finite)]
        label = label_of(numbers, str(numbers.name))
        mapper = self._linear
        cmap = choice.cmap or "viridis"
        if choice.is_logarithmic:
            mapper = self._logarithm
            low, high = _ends_of_logarithm(finite, str(numbers.name), choice)
        else:
            if choice.vmax is None and may_diverge(numbers):
                finite, note = drawing.without_tail(finite)
                label += note
            colours = drawing.colours_of(finite, choice.cmap, choice.vmin, choice.vmax)
            low, high, cmap = colours["vmin"], colours["vmax"], colours["cmap"]
        palette = getattr(self._palettes, PALETTES[cmap])
        mapper.update(palette=self._palettes.interp_palette(palette, COLOURS), low=low, high=high)
        self._linear_image.visible = not choice.is_logarithmic
        self._logarithmic_image.visible = choice.is_logarithmic
        self.bar.update(color_mapper=mapper, title=textwrap.fill(label, OF_BAR), visible=True)
        self.range = (low, high)
        return label

    def draw_grains(self, circles: Mapping[str, NDArray], note: str) -> None:
        """Draw circles of grains, and write a note about them into the title."""
        self.circles.data = dict(circles)
        if note:
            _set_title(self.figure, *self.figure.title.text.splitlines(), note)

    def clear(self) -> None:
        """Draw nothing."""
        self.image.data = _EMPTY_IMAGE
        self.circles.data = _EMPTY_CIRCLES
        self.arrows.data = _EMPTY_ARROWS
        self.bar.visible = False
        self.figure.title.text = ""


def _band(nodes: NDArray, values: NDArray, errors: NDArray) -> tuple[NDArray, NDArray]:
    """Return the outline of a band of one error on both sides; NaN between parts with known numbers."""
    finite = np.isfinite(values + errors)
    parts = np.split(np.arange(len(nodes)), np.flatnonzero(np.diff(finite)) + 1)
    outlines = []
    for part in parts:
        if finite[part[0]]:
            low = [nodes[part], (values - errors)[part]]
            high = [nodes[part][::-1], (values + errors)[part][::-1]]
            outlines.append(np.concatenate([low, high, np.full((2, 1), np.nan)], axis=1))
    if not outlines:
        return np.zeros(0), np.zeros(0)
    along, across = np.concatenate(outlines, axis=1)[:, :-1]
    return along, across


class Profile:
    """Lines along one axis with bands of one standard error; z stands upright.

    Attributes
    ----------
    figure : bokeh.plotting.figure
        To be shown.
    lines, bands : bokeh.models.ColumnDataSource
        Its numbers.
    """

    def __init__(self) -> None:
        models = extra("bokeh.models", "explore", "explore")
        self.lines = models.ColumnDataSource(_EMPTY_LINES)
        self.bands = models.ColumnDataSource(_EMPTY_BANDS)
        self._palette = extra("bokeh.palettes", "explore", "explore").Category10[10]
        self.figure = extra("bokeh.plotting", "explore", "explore").figure(
            frame_height=HIGHEST * 3 // 4,
            sizing_mode="stretch_width",
            max_width=HIGHEST + BESIDE,
            min_width=NARROWEST,
            tools=TOOLS,
            name="profile",
        )
        self.figure.patches(
            "x", "y", source=self.bands, fill_color="colour", fill_alpha=0.25, line_color=None
        )
        self.figure.multi_line(
            "x", "y", source=self.lines, line_color="colour", line_width=2, legend_field="label"
        )
        self.figure.add_layout(self.figure.legend[0], "right")
        self.figure.toolbar.logo = None

    def draw(self, picture: xr.Dataset, choice: Choice) -> None:
        """Draw numbers (axis, ...): one line for each of the other labels."""
        numbers = picture[choice.field]
        axis, *others = (str(dim) for dim in numbers.dims)
        parts = list(product(*(numbers[dim].to_numpy() for dim in others)))
        selections = [dict(zip(others, part, strict=True)) for part in parts]
        nodes = numbers[axis].to_numpy()
        values = [numbers.sel(selection).to_numpy() for selection in selections]
        colours = [self._palette[k % len(self._palette)] for k in range(len(parts))]
        names = ["x", "y"]
        labels = [label_of(numbers[axis], axis), label_of(numbers, str(numbers.name))]
        if axis == "z":
            names.reverse()
            labels.reverse()
        along, drawn = names
        self.lines.data = {
            along: [nodes] * len(parts),
            drawn: values,
            "colour": colours,
            "label": [", ".join(map(str, part)) for part in parts],
        }
        self.bands.data = _EMPTY_BANDS
        error = picture.get(f"{choice.field}{ERROR}")
        title = ""
        if error is not None:
            errors = [error.sel(selection).to_numpy() for selection in selections]
            bands = [_band(nodes, *pair) for pair in zip(values, errors, strict=True)]
            self.bands.data = {
                along: [band[0] for band in bands],
                drawn: [band[1] for band in bands],
                "colour": colours,
            }
            title = "band: one standard error"
        self.figure.legend.visible = bool(others)
        self.figure.xaxis.axis_label, self.figure.yaxis.axis_label = labels
        _set_title(self.figure, title_of(numbers, drawing.unit_in_unicode), title)

    def clear(self) -> None:
        """Draw nothing."""
        self.lines.data = _EMPTY_LINES
        self.bands.data = _EMPTY_BANDS
        self.figure.title.text = ""


class Errors:
    """Bias, noise and total error against the width of the kernel, with the present width marked.

    Attributes
    ----------
    figure : bokeh.plotting.figure
        To be shown.
    lines : bokeh.models.ColumnDataSource
        Its numbers: a line each of bias, noise and total.
    """

    def __init__(self) -> None:
        models = extra("bokeh.models", "explore", "explore")
        self.lines = models.ColumnDataSource(_EMPTY_LINES)
        self.figure = extra("bokeh.plotting", "explore", "explore").figure(
            frame_width=SIDE,
            frame_height=SIDE,
            tools="save",
            name="errors",
            x_axis_type="log",
            y_axis_type="log",
            x_axis_label="width of the kernel [d43]",
            y_axis_label="relative error of this step",
        )
        self.figure.multi_line(
            "x", "y", source=self.lines, line_color="colour", line_width=2, legend_field="label"
        )
        self.figure.toolbar.logo = None
        self._mark = models.Span(dimension="height", line_color="black", line_dash="dashed")
        self.figure.add_layout(self._mark)
        self.figure.xaxis.ticker = models.FixedTicker(ticks=[0.25, 0.5, 1, 2, 4])
        decades = 10.0 ** np.arange(-6, 4)
        self.figure.yaxis.ticker = models.FixedTicker(
            ticks=[*decades, *(2 * decades), *(5 * decades)]
        )
        self.figure.yaxis.formatter = models.NumeralTickFormatter(format="0.[000] %")
        (legend,) = self.figure.legend
        legend.orientation = "horizontal"
        self.figure.add_layout(legend, "below")
        self._set_title("errors are computed ...")

    def draw(self, errors: Mapping[str, NDArray], width: float) -> None:
        """Draw the errors of widths (in d43) by their names, and mark the present width."""
        parts = [name for name in _OF_ERRORS if name in errors]
        self.lines.data = {
            "x": [errors["width"]] * len(parts),
            "y": [np.where(errors[name] > 0, errors[name], np.nan) for name in parts],
            "colour": [_OF_ERRORS[name] for name in parts],
            "label": parts,
        }
        self.mark(width)

    def clear(self, title: str = "") -> None:
        """Draw nothing but a title."""
        self.lines.data = _EMPTY_LINES
        self._set_title(title)

    def mark(self, width: float) -> None:
        """Mark the present width (d43), with its errors in the title."""
        self._mark.location = width
        lines = self.lines.data
        if not len(lines["label"]):
            return
        texts = [f"width {width:.3g}\N{NO-BREAK SPACE}d43"]
        for name, widths, values in zip(lines["label"], lines["x"], lines["y"], strict=True):
            error = np.interp(np.log(width), np.log(widths), values, np.nan, np.nan)
            if np.isfinite(error):
                texts.append(f"{name} {100 * error:.3g}\N{NO-BREAK SPACE}%")
        self._set_title(", ".join(texts))

    def _set_title(self, text: str) -> None:
        """Set the title, of two lines or more: browsers may keep the room of a shorter one before."""
        lines = textwrap.wrap(text, LETTERS // 2)
        if len(lines) < 2:
            lines.append(" ")
        self.figure.title.text = "\n".join(lines)
