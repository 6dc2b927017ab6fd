"""Widgets of the explorer: which choices they offer, and the choice that they show."""

from __future__ import annotations

from typing import Any

from xcg.common.checks import extra
from xcg.explore.choices import USUAL_WIDTH, Choice, Pictures
from xcg.explore.figures import PALETTES

PLAY = 500  # milliseconds from one step to the next
BY_STEP = "of each step"
FIXED = "fixed"
NONE = "none"
USUAL = "automatic"
ONLY_MAPS = ("arrows", "cmap", "range", "log")


class Controls:
    """Widgets by name, which offer what fits the other choices.

    Parameters
    ----------
    pictures : Pictures
        Pictures to choose from.
    widgets : module
        Of Panel.

    Attributes
    ----------
    by_name : dict
        Widgets that change the picture, in their order on the page.
    search : panel widget
        Text that the list of fields is narrowed by.
    """

    def __init__(self, pictures: Pictures, widgets: Any) -> None:
        self.pictures = pictures
        self._shown: tuple[str, str] = ("", "")
        groups = pictures.fields
        first = next(name for group in groups.values() for name in group.values())
        if "velocity" in next(iter(groups.values())).values():
            first = "velocity"
        last = pictures.steps - 1
        models = extra("bokeh.models", "explore", "explore")
        four_digits = models.PrintfTickFormatter(format="%.4g")
        self.search = widgets.TextInput(name="search fields", placeholder="part of a name")
        self.search.param.watch(self._narrow, "value_input")
        self.by_name: dict[str, Any] = {
            "field": widgets.Select(name="field", groups=groups, value=first),
            "view": widgets.Select(name="picture", options=list(pictures.views)),
            "axes": widgets.Select(name="axes"),
            "part": widgets.Select(name="component"),
            "phase": widgets.Select(
                name="phase", options=pictures.phases or ["bulk"], visible=bool(pictures.phases)
            ),
            "time": widgets.Player(
                name="step",
                end=max(1, last),
                value=last,
                interval=PLAY,
                show_loop_controls=False,
                visible_buttons=["first", "previous", "pause", "play", "next", "last"],
                visible=last > 0,
                width=300,
            ),
            "position": widgets.FloatSlider(name="position of the slice", format=four_digits),
        }
        if pictures.widths:
            self.by_name["width"] = widgets.DiscreteSlider(
                name="width of the kernel", options=list(pictures.widths), value=USUAL_WIDTH
            )
        if pictures.has_grains:
            self.by_name["grains"] = widgets.Checkbox(name="grains")
        self.by_name |= {
            "arrows": widgets.Select(name="arrows", options=["auto", NONE, *pictures.vectors]),
            "cmap": widgets.Select(name="colours", options=[USUAL, *PALETTES]),
            "log": widgets.Checkbox(name="logarithm"),
            "range": widgets.Select(name="range of colours", options=[BY_STEP, FIXED]),
            "vmin": widgets.FloatInput(name="from", visible=False, width=140),
            "vmax": widgets.FloatInput(name="to", visible=False, width=140),
        }

    def _narrow(self, event: Any) -> None:
        """Offer the fields whose name has the text of the search in it, and the present one."""
        text = event.new.strip().lower().replace(" ", "_")
        field = self.by_name["field"]
        groups = {}
        for heading, names in self.pictures.fields.items():
            matching = {t: n for t, n in names.items() if text in n.lower() or n == field.value}
            if matching:
                groups[heading] = matching
        field.groups = groups

    def offer(self) -> None:
        """Offer the axes, components and positions that fit the other choices."""
        controls = self.by_name
        view = controls["view"].value
        _set_options(controls["axes"], {" ".join(axes): axes for axes in self.pictures.views[view]})
        parts = self.pictures.parts_of(self.choice)
        _set_options(controls["part"], parts)
        controls["part"].visible = len(parts) > 1
        shown = (controls["field"].value, controls["part"].value)
        if shown != self._shown:
            self._shown = shown
            controls["range"].value = BY_STEP  # the fixed one was of other numbers
        controls["time"].name = self.pictures.text_of_step(controls["time"].value)
        slider = controls["position"]
        slider.visible = view == "slice"
        if view == "slice":
            low, high = self.pictures.range_of(self.pictures.cut_axis(self.choice))
            if (slider.start, slider.end) != (low, high):
                count = self.pictures.intervals_of(self.pictures.cut_axis(self.choice))
                interval = (high - low) / count
                middle = low + (count + 1) // 2 * interval
                slider.param.update(start=low, end=high, step=interval, value=middle)
        is_map = view != "profile"
        for name in ONLY_MAPS:
            controls[name].visible = is_map
        if "grains" in controls:
            controls["grains"].visible = is_map
        for name in ("vmin", "vmax"):
            controls[name].visible = is_map and controls["range"].value == FIXED

    def fix_range(self, low: float, high: float) -> None:
        """Fill in the ends of the colours that are shown, while they follow each step."""
        if self.by_name["range"].value == BY_STEP:
            for name, value in (("vmin", low), ("vmax", high)):
                self.by_name[name].value = float(f"{value:.4g}")

    @property
    def choice(self) -> Choice:
        """The present choices."""
        values = {name: control.value for name, control in self.by_name.items()}
        ends = (None, None)
        if values["range"] == FIXED:
            ends = (values["vmin"], values["vmax"])
        return Choice(
            field=values["field"],
            view=values["view"],
            axes=values["axes"],
            time=values["time"],
            position=float(f"{values['position']:.4g}"),
            part=values["part"] or "",
            phase=values["phase"],
            width=values.get("width", USUAL_WIDTH),
            arrows=None if values["arrows"] == NONE else values["arrows"],
            cmap=None if values["cmap"] == USUAL else values["cmap"],
            vmin=ends[0],
            vmax=ends[1],
            is_logarithmic=values["log"],
        )


def _set_options(control: Any, options: dict[str, Any]) -> None:
    """Offer options in a control; its value stays if it is among them."""
    if control.options != options:
        values = list(options.values())
        value = values[0]
        if control.value in values:
            value = control.value
        control.param.update(options=options, value=value)
