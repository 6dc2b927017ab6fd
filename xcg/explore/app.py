"""The page of `ds.cg.explore()`: controls beside figures of Bokeh, and the calls that make the pictures."""

from __future__ import annotations

import asyncio
import html
import io
import sys
import warnings
from collections.abc import Mapping
from functools import partial
from typing import Any
from weakref import finalize

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.analysis.compare import ERROR
from xcg.analysis.picture import TITLED
from xcg.common.checks import extra
from xcg.common.messages import SceneWarning, printable
from xcg.explore.choices import Choice, Pictures, pictures_of
from xcg.explore.controls import Controls
from xcg.explore.figures import Errors, Map, Profile
from xcg.explore.server import serve

PAUSE = 0.03  # seconds after a change, in which further ones replace it
REST = 0.3  # seconds after a picture, before the errors of all widths are computed
COPY = "navigator.clipboard.writeText(code.tags[0]); button.label = 'copied'"
# as the button of the figure itself does
SAVE = """
const figure = map.visible ? map : profile;
figure.toolbar.tools.find(tool => tool.type == "SaveTool").do.emit("save");
"""
UNSEEN = (
    "explore: only notebooks show the explorer by itself; in a script, ds.cg.explore().show() opens it in "
    "the browser, as the command xcg explore FILES does\n"
)
NARROWEST = 500  # pixels of a picture
RED = {"background": "#f8d7da", "color": "#58151c"}  # of errors
YELLOW = {"background": "#fff3cd", "color": "#664d03"}  # of warnings
GREY = {"background": "#f4f4f4", "color": "#333333"}


def explore(ds: xr.Dataset) -> Explorer:
    """Show pictures of a scene or a result in a notebook, with controls.

    The controls choose the field, its component and phase, a map, a slice or a profile, the step
    and the position of a slice. Of a scene, grains can be drawn on top, and a slider changes the width
    of the kernel. Beside the field, bias, noise and total error of the step are drawn against the
    width, as `choose_width` computes them. The Python calls that make the picture
    are printed below it.

    In a script or at the prompt of Python, which show no widgets, ``ds.cg.explore().show()`` opens
    the page in the browser.

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
    pn = extra("panel", "explore", "explore")
    pn.extension(inline=True)  # without resources of the internet
    pictures = pictures_of(ds)
    explorer = Explorer(pictures)
    if "ipykernel" not in sys.modules:
        explorer.unseen = finalize(explorer, sys.stderr.write, UNSEEN)
    return explorer


class Explorer:
    """Controls and pictures of a scene or a result, which a notebook or a server shows.

    Parameters
    ----------
    pictures : Pictures
        Pictures to choose from.
    opened : str
        Python calls that come before the picture's, such as one that opens the files.

    Attributes
    ----------
    controls : Controls
        Widgets.
    layout : panel.Row
        The page.
    message : str
        Error or warnings of the present picture.
    unseen : weakref.finalize or None
        Says how to open the page, where it was never opened.
    """

    def __init__(self, pictures: Pictures, opened: str = "") -> None:
        self.pictures = pictures
        self.opened = opened
        self._picture: xr.Dataset | None = None
        self.message = ""
        self.unseen: finalize | None = None
        self._latest = object()  # of the last change
        self._errors_of: Choice | None = None  # that are drawn
        pn = self._pn = extra("panel", "explore", "explore")
        self.controls = Controls(pictures, pn.widgets)
        self.map = Map()
        self.profile = Profile()
        self.errors = Errors()
        # texts are models of Bokeh: new texts of Panel's panes load their style from the internet
        models = self._models = extra("bokeh.models", "explore", "explore")
        text = models.Div
        self._alert = text(visible=False, sizing_mode="stretch_width")
        self._code = text(sizing_mode="stretch_width")
        self._reason = text(visible=False, width=320)
        copy = pn.widgets.Button(name="copy", width=80)
        copy.js_on_click(args={"code": self._code, "button": copy}, code=COPY)
        figures = {"map": self.map.figure, "profile": self.profile.figure}
        picture = pn.widgets.Button(name="picture (PNG)", width=140)
        picture.js_on_click(args=figures, code=SAVE)
        self._table = pn.widgets.FileDownload(
            label="numbers (CSV)", callback=self._numbers_as_csv, filename="numbers.csv", width=140
        )
        wide = {"sizing_mode": "stretch_width", "min_width": NARROWEST}
        self._drawn = [
            *(
                pn.pane.Bokeh(model, **wide)
                for model in (self._alert, *figures.values(), self._code)
            ),
            pn.pane.Bokeh(self.errors.figure),
            pn.pane.Bokeh(self._reason),
        ]
        alert, drawn_map, drawn_profile, code, errors, reason = self._drawn
        self.layout = pn.Row(
            pn.Column(self.controls.search, *self.controls.by_name.values(), width=330),
            pn.Column(
                alert,
                drawn_map,
                drawn_profile,
                pn.FlexBox(copy, self._table, picture),
                code,
                **wide,
            ),
            pn.Column(errors, reason, visible=bool(pictures.widths)),
            sizing_mode="stretch_width",
            styles={"flex-wrap": "wrap"},  # the errors come below in narrow windows
        )
        self.update()
        for control in self.controls.by_name.values():
            control.param.watch(self._changed, "value")
        if _loop_runs():
            pn.state.onload(self._draw_errors)

    def show(self, port: int = 0) -> None:
        """Open the page in the browser, and serve it until it is closed.

        Parameters
        ----------
        port : int
            Port at 127.0.0.1; 0 takes a free one.

        Raises
        ------
        RuntimeError
            In a notebook, whose own loop runs.
        """
        if self.unseen is not None:
            self.unseen.detach()
        if _loop_runs():
            raise RuntimeError(
                "show is for scripts: a notebook shows the explorer as the last line of a cell, ds.cg.explore()"
            )
        serve(lambda: Explorer(self.pictures, self.opened).layout, port)

    def __repr__(self) -> str:
        return "<Explorer: show() opens it in the browser>"  # at the prompt of Python

    def _repr_mimebundle_(self, include: Any = None, exclude: Any = None) -> Any:
        return self.layout._repr_mimebundle_(include, exclude)

    @property
    def call(self) -> str:
        """The Python calls that make the present picture."""
        return self.opened + self.pictures.call(self.controls.choice)

    @property
    def numbers(self) -> xr.DataArray | None:
        """Numbers of the present picture; None after an error."""
        if self._picture is None:
            return None
        return self._picture[self._picture.attrs["drawn"]]

    def _numbers_as_csv(self) -> io.StringIO:
        """Return the numbers of the present picture and their errors, with coordinates, as CSV."""
        text = io.StringIO()
        if self._picture is not None:
            name = self._picture.attrs["drawn"]
            table = self._picture[[n for n in (name, f"{name}{ERROR}") if n in self._picture]]
            kept = {*table.dims, *TITLED, "step"}
            table = table.drop_vars([n for n in table.coords if n not in kept])
            table.to_dataframe().to_csv(text)
        text.seek(0)
        return text

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
        self.controls.offer()
        choice = self.controls.choice
        call = self.call
        self._code.update(
            text=f'<pre style="white-space: pre-wrap">{html.escape(call)}</pre>', tags=[call]
        )
        figure: Map | Profile = self.map
        if choice.view == "profile":
            figure = self.profile
        self.map.figure.visible = figure is self.map
        self.profile.figure.visible = figure is self.profile
        part = choice.part.replace(" ", "")
        name = "_".join(filter(None, (choice.field, part, choice.view, str(choice.time))))
        figure.figure.select_one(self._models.SaveTool).filename = name
        self._table.filename = f"{name}.csv"
        refused = ""
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", SceneWarning)
            try:
                self._picture = self.pictures.picture(choice)
                figure.draw(self._picture, choice)
                if not np.isfinite(self._picture[choice.field]).any():
                    text = f"{choice.field} is unknown (NaN) everywhere in this picture"
                    warnings.warn(text, SceneWarning, stacklevel=2)
                if figure is self.map:
                    self.controls.fix_range(*self.map.range)
                    self._draw_grains(choice)
            except Exception as error:  # any: the page has to go on, and to show it
                self._picture = None
                figure.clear()
                refused = repr(error)
                if isinstance(error, ValueError):
                    refused = str(error)
        texts = [str(w.message) for w in caught if issubclass(w.category, SceneWarning)]
        self.message = printable(refused or "\n\n".join(texts))
        _show(self._alert, self.message, RED if refused else YELLOW)
        if _of_errors(choice) == self._errors_of:
            self.errors.mark(_number_of(choice.width))
        else:
            self.errors.clear("errors are computed ..." if not refused else "")
            _show(self._reason, "", GREY)
        self._push()

    def _draw_grains(self, choice: Choice) -> None:
        pictures: Any = self.pictures
        box = self.controls.by_name.get("grains")
        if box is not None and box.value:
            self.map.draw_grains(*pictures.grains(choice))
        else:
            self.map.draw_grains({name: np.zeros(0) for name in ("x", "y", "radius")}, "")

    async def _draw_errors(self) -> None:
        """Draw the errors of all widths once the controls rest: they take longer than a picture."""
        latest = self._latest
        pictures: Any = self.pictures
        await asyncio.sleep(REST)
        choice = _of_errors(self.controls.choice)
        if latest is not self._latest or choice == self._errors_of or not pictures.widths:
            return
        if self._picture is None:  # the reason stands above
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
            self.errors.clear()
            _show(self._reason, errors, GREY)
        else:
            self.errors.draw(errors, _number_of(self.controls.choice.width))
        self._push()

    def _push(self) -> None:
        """Send changes of the figures to a notebook; a server sends them by itself."""
        if not self._pn.state.served:
            self._pn.io.push_notebook(*self._drawn)


def _show(div: Any, text: str, colours: dict[str, str]) -> None:
    """Show a text on a ground of its colours; nothing if it is empty."""
    styles = {"padding": "8px", "white-space": "pre-wrap", "box-sizing": "border-box", **colours}
    div.update(text=html.escape(text, quote=False), styles=styles, visible=bool(text))


def _loop_runs() -> bool:
    """Return whether a loop runs, as in notebooks and servers, and not in scripts."""
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        return False
    return True


def _of_errors(choice: Choice) -> Choice:
    """Return what the errors depend on: neither the present width nor colours and arrows."""
    return Choice(
        choice.field,
        choice.view,
        choice.axes,
        choice.time,
        choice.position,
        choice.part,
        choice.phase,
    )


def _number_of(width: str) -> float:
    """Return the multiple of a width such as "0.75 d43"."""
    return float(width.split()[0])
