"""The page of `ds.cg.explore()`: widgets of Panel beside figures of Bokeh, and the server of ``xcg explore``."""

from __future__ import annotations

import asyncio
import html
import sys
import warnings
import webbrowser
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.checks import extra
from xcg.common.messages import SceneWarning, printable
from xcg.explore.choices import USUAL_WIDTH, Choice, Pictures, pictures_of
from xcg.explore.figures import Errors, Map, Profile

PAUSE = 0.03  # seconds after a change, in which further ones replace it
REST = 0.3  # seconds after a picture, before the errors of all widths are computed
ADDRESS = "127.0.0.1"
CLOSED = 10_000  # milliseconds without a connection, after which a page counts as closed


def explore(ds: xr.Dataset) -> Explorer:
    """Show pictures of a scene or a result in a notebook, with controls.

    The controls choose the field, its component and phase, a map, a slice or a profile, the step
    and the place of a slice. Of a scene, grains can be drawn on top, and a slider changes the width
    of the kernel. Beside the field, bias, noise and total error of the step are drawn against the
    width, as `choose_width` computes them. A button shows the Python calls that make the picture.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene or a result, lazy or in memory. Only the step that is shown is read and computed.

    Returns
    -------
    Explorer
        A notebook shows it where it is the last line of a cell.

    Raises
    ------
    ImportError
        If Panel is not installed.
    ValueError
        If the Dataset is neither a scene nor a result with an axis.

    See Also
    --------
    plot : one picture.
    choose_width : bias and noise against width, over several steps.

    Examples
    --------
    >>> import xcg
    >>> xcg.datasets.open("plane_shear").cg.explore()  # doctest: +SKIP
    """
    extra("panel", "explore", "explore").extension()
    return Explorer(pictures_of(ds))


class Explorer:
    """Controls and pictures of a scene or a result, which a notebook or a server shows.

    Parameters
    ----------
    pictures : Pictures
        Pictures to choose from.
    opened : str
        Python calls that come before those of a picture, such as one that opens the files.

    Attributes
    ----------
    controls : dict
        Widgets by name.
    layout : panel.Row
        The page.
    numbers : xarray.DataArray or None
        Numbers of the present picture; None after an error.
    message : str
        Error or warnings of the present picture.
    """

    def __init__(self, pictures: Pictures, opened: str = "") -> None:
        self.pictures = pictures
        self.opened = opened
        self.numbers: xr.DataArray | None = None
        self.message = ""
        self._latest = object()  # of the last change
        self._errors_of: Choice | None = None  # that are drawn
        pn = self._pn = extra("panel", "explore", "explore")
        self.controls = self._make_controls(pn.widgets)
        self._alert = pn.pane.Alert(visible=False, width=520)
        self._code = pn.pane.Str(visible=False, width=560, styles={"overflow": "auto"})
        self.map = Map()
        self.profile = Profile()
        self.errors = Errors()
        self._map = pn.pane.Bokeh(self.map.figure)
        self._profile = pn.pane.Bokeh(self.profile.figure)
        self._errors = pn.pane.Bokeh(self.errors.figure, visible=bool(pictures.widths))
        self.layout = pn.Row(
            pn.Column(*self.controls.values(), width=330),
            pn.Column(self._alert, self._map, self._profile, self._code),
            self._errors,
        )
        self.update()
        for control in self.controls.values():
            control.param.watch(self._changed, "value")
        with suppress(RuntimeError):  # a script has no loop, and shows nothing
            asyncio.get_running_loop()
            pn.state.onload(self._draw_errors)

    def _repr_mimebundle_(self, include: Any = None, exclude: Any = None) -> Any:
        return self.layout._repr_mimebundle_(include, exclude)

    # --- controls ------------------------------------------------------------------------------

    def _make_controls(self, widgets: Any) -> dict[str, Any]:
        """Return the widgets by name; `_offer` fills the ones that depend on others."""
        pictures = self.pictures
        groups = list(pictures.fields.values())
        first = next(name for group in groups for name in group)
        if "velocity" in groups[0]:
            first = "velocity"
        controls = {
            "field": widgets.Select(name="field", groups=pictures.fields, value=first),
            "view": widgets.Select(name="picture", options=list(pictures.views)),
            "axes": widgets.Select(name="axes"),
            "part": widgets.Select(name="component"),
            "phase": widgets.Select(
                name="phase", options=pictures.phases or ["bulk"], disabled=not pictures.phases
            ),
            "time": widgets.IntSlider(
                name="step", end=max(1, pictures.steps - 1), disabled=pictures.steps < 2
            ),
            "position": widgets.FloatSlider(name="position of the slice", format="0.[0000]"),
        }
        if pictures.widths:
            controls["width"] = widgets.DiscreteSlider(
                name="width of the kernel", options=list(pictures.widths), value=USUAL_WIDTH
            )
            controls["grains"] = widgets.Checkbox(name="grains", disabled=not pictures.has_grains)
        controls["call"] = widgets.Toggle(name="Python call")
        return controls

    def _offer(self) -> None:
        """Offer the axes, components and positions that fit the other choices."""
        pictures = self.pictures
        controls = self.controls
        view = controls["view"].value
        _set_options(controls["axes"], {" ".join(axes): axes for axes in pictures.views[view]})
        parts = pictures.parts_of(self.choice)
        _set_options(controls["part"], parts)
        controls["part"].disabled = len(parts) == 1
        slider = controls["position"]
        slider.visible = view == "slice"
        if view == "slice":
            low, high = pictures.range_of(pictures.cut_axis(self.choice))
            if (slider.start, slider.end) != (low, high):
                slider.param.update(
                    start=low, end=high, step=(high - low) / 100, value=(low + high) / 2
                )

    @property
    def choice(self) -> Choice:
        """The present choices."""
        values = {name: control.value for name, control in self.controls.items()}
        return Choice(
            field=values["field"],
            view=values["view"],
            axes=values["axes"],
            time=values["time"],
            position=float(f"{values['position']:.4g}"),
            part=values["part"] or "",
            phase=values["phase"],
            width=values.get("width", USUAL_WIDTH),
        )

    @property
    def call(self) -> str:
        """The Python calls that make the present picture."""
        return self.opened + self.pictures.call(self.choice)

    async def _changed(self, *_: object) -> None:
        """Draw once the controls rest for a moment, so that a slider on the move leaves no queue."""
        latest = self._latest = object()
        await asyncio.sleep(PAUSE)
        if latest is self._latest:
            self._pn.state.execute(self.update, schedule=True)
            await self._draw_errors()

    # --- pictures ------------------------------------------------------------------------------

    def update(self) -> None:
        """Draw the picture of the present choices, or show why it cannot be drawn."""
        self._offer()
        choice = self.choice
        self._code.param.update(object=self.call, visible=self.controls["call"].value)
        figure: Map | Profile = self.map
        if choice.view == "profile":
            figure = self.profile
        self._map.visible = figure is self.map
        self._profile.visible = figure is self.profile
        refused = ""
        alert_type = "warning"
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", SceneWarning)
            try:
                self.numbers = self.pictures.numbers(choice)
                figure.draw(self.numbers)
                if figure is self.map and self.controls.keys() >= {"grains"}:
                    self._draw_grains(choice)
            except Exception as error:  # any: the page has to go on, and to show it
                self.numbers = None
                figure.clear()
                refused = repr(error)
                if isinstance(error, ValueError):
                    refused = str(error)
                alert_type = "danger"
        texts = [str(w.message) for w in caught if issubclass(w.category, SceneWarning)]
        self.message = printable(refused or "\n\n".join(texts))
        self._alert.param.update(
            object=html.escape(self.message, quote=False),
            alert_type=alert_type,
            visible=bool(self.message),
        )
        if replace(choice, width=USUAL_WIDTH) == self._errors_of:
            self.errors.mark(_number_of(choice.width))
        else:
            self.errors.refuse("errors are computed ...")
        self._push()

    def _draw_grains(self, choice: Choice) -> None:
        pictures: Any = self.pictures
        if self.controls["grains"].value:
            self.map.draw_grains(*pictures.grains(choice))
        else:
            self.map.draw_grains({name: np.zeros(0) for name in ("x", "y", "radius")}, 0)

    async def _draw_errors(self) -> None:
        """Draw the errors of all widths once the controls rest: they take longer than a picture."""
        latest = self._latest
        pictures: Any = self.pictures
        await asyncio.sleep(REST)
        choice = replace(self.choice, width=USUAL_WIDTH)
        if latest is not self._latest or choice == self._errors_of or not pictures.widths:
            return
        try:
            errors = await asyncio.to_thread(pictures.errors, choice)
        except Exception as error:  # any, as in `update`
            errors = str(error)
        if latest is self._latest:
            self._errors_of = choice
            self._pn.state.execute(partial(self._show_errors, errors), schedule=True)

    def _show_errors(self, errors: Mapping[str, NDArray] | str) -> None:
        """Draw errors by their names, or show the message of why they are unknown."""
        if isinstance(errors, str):
            self.errors.refuse(errors)
        else:
            self.errors.draw(errors, _number_of(self.choice.width))
        self._push()

    def _push(self) -> None:
        """Send changes of the figures to a notebook; a server sends them by itself."""
        if not self._pn.state.served:
            self._pn.io.push_notebook(self._map, self._profile, self._errors)


def _number_of(width: str) -> float:
    """Return the multiple of a width such as "0.75 d43"."""
    return float(width.split()[0])


def _set_options(control: Any, options: dict[str, Any]) -> None:
    """Offer options in a control; its value stays if it is among them."""
    if control.options != options:
        values = list(options.values())
        value = values[0]
        if control.value in values:
            value = control.value
        control.param.update(options=options, value=value)


def serve(ds: xr.Dataset, opened: str, port: int = 0, show: bool = True) -> None:
    """Serve pictures of a scene or a result to this machine alone, until their page is closed.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene or a result.
    opened : str
        Python calls that make it, as the variable of the calls of pictures.
    port : int
        Port at 127.0.0.1; 0 takes a free one.
    show : bool
        Open the page in the browser.

    Raises
    ------
    ImportError
        If Panel is not installed.
    OSError
        If the port is taken, or not allowed to this user.
    """
    pn = extra("panel", "explore", "explore")
    pictures = pictures_of(ds)
    try:
        server = pn.serve(
            lambda: Explorer(pictures, opened).layout,
            address=ADDRESS,
            port=port,
            start=False,
            show=False,
            verbose=False,
            title="xcg explore",
            unused_session_lifetime_milliseconds=CLOSED,
            check_unused_sessions_milliseconds=CLOSED // 10,
        )
    except OSError as error:
        raise OSError(
            f"port {port} at {ADDRESS} cannot be used ({error.strerror or error}): give another one, "
            "or leave out --port, which takes a free one"
        ) from error
    page = f"http://{ADDRESS}:{server.port}"

    def stop_without_pages(session: Any) -> None:
        if all(other.id == session.id for other in server.get_sessions()):
            server.io_loop.add_callback(server.io_loop.stop)

    pn.state.on_session_destroyed(stop_without_pages)
    sys.stderr.write(f"{page} (close the page, or press Ctrl-C, to end)\n")
    if show:
        server.io_loop.add_callback(webbrowser.open, page)
    server.run_until_shutdown()
