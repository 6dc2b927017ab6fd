"""Labels of pictures, and the figures they are drawn in: the same for scenes, fields and chains."""

from __future__ import annotations

import re
import textwrap
from typing import TYPE_CHECKING, Any, cast

import xarray as xr

from xcg.common.checks import extra

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis

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
    return _POWER.sub(lambda found: f"$^{{{found[1] or found[2]}}}$", units)


def with_unit(text: str, units: str) -> str:
    """Return a label: a text with its unit in brackets."""
    unit = unit_text(units)
    return f"{text} [{unit}]" if unit else text


def label_of(value: xr.DataArray, name: str) -> str:
    """Return the label of a variable: the symbol of an axis, the long name, or the name, and the unit."""
    text = _SYMBOLS.get(name) or str(value.attrs.get("long_name", name.replace("_", " ")))
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


def add_colour_bar(drawn: Any, ax: Axes, text: str, **options: Any) -> None:
    """Add a labelled colour bar beside axes; `options` are those of matplotlib."""
    bar = ax.figure.colorbar(drawn, ax=ax, **options)
    powers: Any = bar.formatter
    powers.set_powerlimits((-3, 4))
    powers.set_useMathText(True)
    set_label(bar.ax.yaxis, text)


def new_axes(projection: str | None = None) -> Axes:
    """Return the axes of a new figure of pyplot, with room for labels."""
    figure = extra("matplotlib.pyplot", "plot", "drawing").figure(layout="constrained")
    return cast("Axes", figure.add_subplot(projection=projection))
