"""The page in Chromium: controls change the picture, colours are right, closing it ends the server."""

import asyncio
import dataclasses
import io
import json
import pathlib
import re
import shutil
import socket
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import xcg
from tests import ROOT
from xcg.common.drawing import unit_in_unicode
from xcg.explore.choices import Choice, pictures_of

pytest.importorskip("panel")
pytestmark = [  # of panel's packages
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::PendingDeprecationWarning"),
]

DATA = ROOT / "examples" / "data" / "lammps_plane_shear"
FILES = [f"{DATA}/particles.*.dump.gz", "-c", f"{DATA}/contacts.*.dump.gz", "--frozen", "2"]
PATIENCE = 180_000  # milliseconds, for machines with other work
# numbers, labels and texts of the page
SEEN = """() => {
  const found = {};
  for (const name of ["map", "profile", "errors"]) {
    const figure = Bokeh.documents[0].get_model_by_name(name);
    if (figure == null) continue;
    found[name] = [figure.title.text, figure.above.length];
    for (const axis of [...figure.left, ...figure.below])
      if ("axis_label" in axis) found[name].push(axis.axis_label);
    for (const {data_source: {data}} of figure.renderers)
      for (const [key, column] of data instanceof Map ? data : Object.entries(data))
        found[name].push(key, [...column].map(one =>
          one?.length === undefined || typeof one === "string" ? one
          : [...one].reduce((sum, number) => isFinite(number) ? sum + number : sum, 0)));
    for (const {color_mapper: colours, title} of figure.right)
      if (colours) found[name].push(title, colours.type, colours.low, colours.high, colours.palette[200]);
    for (const span of figure.center) if ("location" in span) found[name].push(span.location);
  }
  return JSON.stringify(found);
}"""
WIDTH = """() => Bokeh.documents[0].get_model_by_name("map").inner_width"""
# the place of a point of the map on the page (pixels)
PIXEL = """([x, y]) => {
  const figure = Bokeh.documents[0].get_model_by_name("map");
  const view = Bokeh.index.find_one(figure);
  const page = view.canvas_view.el.getBoundingClientRect();
  return [page.x + view.frame.x_scale.compute(x), page.y + view.frame.y_scale.compute(y)];
}"""


class Page:
    """A page of the server in Chromium."""

    def __init__(self, page):
        self.page, self.errors = page, []
        page.set_default_timeout(PATIENCE)
        page.on("console", lambda one: one.type == "error" and self.errors.append(one.text))
        page.on("pageerror", lambda error: self.errors.append(str(error)))

    def seen(self):
        return self.page.evaluate(SEEN)

    def after(self, act, what="map"):
        """Do something, wait until what the page shows of a figure has changed, and return it."""
        before = self.page.evaluate(f"() => JSON.parse(({SEEN})())['{what}']")
        act()
        self.page.wait_for_function(
            f"before => JSON.stringify(JSON.parse(({SEEN})())['{what}']) != JSON.stringify(before)",
            arg=before,
        )
        shown = None
        while (now := self.page.evaluate(f"() => JSON.parse(({SEEN})())['{what}']")) != shown:
            shown = now
            self.page.wait_for_timeout(400)  # the parts of a picture arrive one after the other
        return shown

    def choose(self, label, value):
        return lambda: self.page.get_by_label(label, exact=True).select_option(value)

    def write(self, label, text):
        def act():
            self.page.get_by_label(label, exact=True).fill(text)
            self.page.get_by_label(label, exact=True).press("Enter")

        return act

    def slide(self, position, key="ArrowRight"):
        return lambda: self.page.locator(".noUi-handle:visible").nth(position).press(key)


@pytest.fixture
def chromium():
    playwright = pytest.importorskip("playwright.sync_api")
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("needs Chromium")
    with playwright.sync_playwright() as start:
        browser = start.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture
def served():
    """The command, and the address it prints."""
    command = [sys.executable, "-m", "xcg.cli", "explore", *FILES, "--no-browser"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, cwd=ROOT) as process:
        try:
            yield process, re.search(r"http://127\.0\.0\.1:(\d+)", process.stderr.readline())
        finally:
            process.kill()


def test_every_control_changes_the_page_and_closing_it_ends_the_server(served, chromium):
    process, address = served
    allowed = ["clipboard-read", "clipboard-write"]
    page = Page(chromium.new_page(viewport={"width": 1500, "height": 900}, permissions=allowed))
    page.page.goto(address[0])
    page.page.wait_for_function("() => document.querySelectorAll && Bokeh.documents.length > 0")
    page.page.wait_for_function(f"() => JSON.parse(({SEEN})()).map !== undefined")
    with pytest.raises(ConnectionRefusedError):  # listens at 127.0.0.1 only, not at all addresses
        socket.create_connection(("127.0.0.2", int(address[1])), timeout=5)

    # sliders are those of the step and of the width; in a slice the position is between them
    assert "time = 32" in json.loads(page.seen())["map"][0]  # starts at the last step
    page.after(page.page.locator("button.previous").click)
    page.page.get_by_text("time 30, step 60000").wait_for()
    page.after(page.slide(0))
    page.after(page.choose("arrows", "none"))
    page.after(page.choose("arrows", "velocity"))
    page.after(page.choose("colours", "plasma"))
    page.after(page.page.locator("input[type=checkbox]:visible").nth(1).check)
    page.after(page.page.locator("input[type=checkbox]:visible").nth(1).uncheck)
    page.choose("range of colours", "fixed")()
    page.after(page.write("to", "1.25"))
    page.choose("range of colours", "of each step")()
    page.choose("colours", "automatic")()
    page.after(page.choose("arrows", "auto"))
    page.after(page.choose("axes", "x y"))
    page.after(page.choose("axes", "x z"))
    page.after(page.choose("component", "x"))
    page.after(page.choose("phase", "1"))
    page.after(page.choose("phase", "bulk"))
    page.after(page.choose("picture", "slice"))
    page.after(page.slide(0))
    grains = page.after(page.page.locator("input[type=checkbox]:visible").nth(0).check)
    assert len(grains[grains.index("radius") + 1]) > 10
    page.after(page.choose("picture", "profile"), "profile")
    page.after(page.slide(0, "ArrowLeft"), "profile")
    # errors follow the picture by themselves
    page.page.wait_for_function(f"() => JSON.parse(({SEEN})()).errors[0].includes('noise')")
    page.after(page.slide(0, "ArrowLeft"), "errors")  # the mark of the width
    page.after(page.choose("component", "all"), "profile")

    # a field that the scene cannot give: the reason, and the page goes on
    page.page.get_by_label("search fields").fill("d2")
    page.choose("field", "d2min (needs lag=)")()
    page.page.get_by_text("d2min compares two frames").first.wait_for()
    page.page.get_by_label("search fields").fill("")
    page.after(page.choose("field", "velocity"), "profile")

    # colours at three points are those of the numbers of the shown call
    page.after(page.choose("picture", "map"))
    page.after(page.page.locator("input[type=checkbox]:visible").nth(0).uncheck)
    page.after(page.choose("arrows", "none"))
    shown = page.page.locator("pre", has_text="coarse_grain").inner_text()
    assert_colours(page, shown, np.asarray)
    page.after(page.page.locator("input[type=checkbox]:visible").nth(1).check)
    assert_colours(page, shown, np.log)
    page.after(page.page.locator("input[type=checkbox]:visible").nth(1).uncheck)
    page.page.get_by_role("button", name="copy").click()
    page.page.get_by_role("button", name="copied").wait_for()
    assert page.page.evaluate("navigator.clipboard.readText()") == shown
    with page.page.expect_download() as table:
        page.page.get_by_text("numbers (CSV)").click()
    assert "velocity" in pathlib.Path(table.value.path()).read_text().partition("\n")[0]
    with page.page.expect_download() as picture:
        page.page.get_by_role("button", name="picture (PNG)").click()
    assert picture.value.suggested_filename == "velocity_map_15.png"
    assert pathlib.Path(picture.value.path()).read_bytes().startswith(b"\x89PNG")
    page.after(page.choose("axes", "x y"))  # wide
    width = page.page.evaluate(WIDTH)
    page.page.set_viewport_size({"width": 900, "height": 900})
    page.page.wait_for_function(f"width => ({WIDTH})() < width", arg=width)

    assert page.errors == []
    page.page.close()
    assert process.wait(60) == 0


def assert_colours(page, call, scale):
    """Check colours at three nodes of a map of speeds: between the numbers of the nodes around."""
    palettes = pytest.importorskip("bokeh.palettes")
    image = pytest.importorskip("matplotlib.image")
    names = {}
    exec(call.rpartition("\nf.cg.plot")[0], names)
    velocity = names["f"]["velocity"].isel(time=0)
    speed = ((velocity**2).sum("component", skipna=False) ** 0.5).transpose("z", "x")
    numbers = scale(speed.to_numpy())
    low = np.nanmin(numbers)
    high = np.nanmax(numbers)
    palette = np.array([[int(c[k : k + 2], 16) for k in (1, 3, 5)] for c in palettes.Viridis256])
    for row, column in ((20, 10), (45, 30), (80, 20)):
        place = [speed["x"][column].item(), speed["z"][row].item()]
        x, y = page.page.evaluate(PIXEL, place)
        clip = {"x": round(x), "y": round(y), "width": 1, "height": 1}
        (pixel,) = image.imread(io.BytesIO(page.page.screenshot(clip=clip)))[0] * 255
        (index,) = np.flatnonzero((palette == pixel[:3].round()).all(axis=1))
        around = (numbers[row - 1 : row + 2, column - 1 : column + 2] - low) / (high - low) * 256
        assert np.floor(around.min()) <= index <= np.floor(around.max())


def test_a_picture_that_fails_leaves_its_reason_and_no_numbers():
    app = pytest.importorskip("xcg.explore.app")

    async def use():  # as in a notebook, whose loop runs
        page = app.Explorer(pictures_of(xcg.datasets.random_scene(100, seed=1)))
        assert page.numbers is not None
        page.controls.by_name["field"].value = "d2min"
        page.update()
        assert page.numbers is None
        assert "ds.cg.displacement" in page.message
        assert not len(page.map.image.data["image"])
        page.controls.by_name["field"].value = "density"
        page.update()
        assert page.numbers.name == "density"
        assert "d2min" not in page.message

    asyncio.run(use())


def test_a_picture_without_numbers_says_so():
    app = pytest.importorskip("xcg.explore.app")
    f = xcg.datasets.random_scene(50, seed=1).cg.coarse_grain("velocity", axes="xz", width=1.0)
    assert "unknown" not in app.Explorer(pictures_of(f)).message
    page = app.Explorer(pictures_of(f * np.nan))
    assert page.message == "velocity is unknown (NaN) everywhere in this picture"


def test_the_picture_has_the_numbers_of_the_nodes():
    """Also its largest one, whatever the number of nodes."""
    figures = pytest.importorskip("xcg.explore.figures")
    for count in (67, 80, 131):
        x = np.arange(count, dtype=float)
        peak = xr.DataArray(np.exp(-((x - 30.0) ** 2) / 4), {"x": x}, "x")
        picture = xr.Dataset({"density": peak * peak.rename(x="z")})
        shown = figures.Map()
        shown.draw(picture.transpose("z", "x"), Choice("density", "map", ("x", "z")))
        (image,) = shown.image.data["image"]
        assert image.max() == 1.0
        assert shown.range == (0.0, 1.0) or shown.range[1] == 1.0
        assert shown.bar.title == "density"


def test_slices_of_a_result_are_at_its_nodes():
    """The first one is that of `plot`: the middle of the axis that is cut."""
    controls = pytest.importorskip("xcg.explore.controls")
    widgets = pytest.importorskip("panel").widgets
    f = xcg.datasets.random_scene(300, seed=2).cg.coarse_grain("density", width=1.0).compute()
    for count in (1, 4, 5):
        shown = controls.Controls(pictures_of(f.isel(y=slice(0, count))), widgets)
        shown.offer()
        slider = shown.by_name["position"]
        nodes = f.y[:count].to_numpy()
        assert shown.choice.axes == ("x", "z")
        np.testing.assert_allclose(slider.value, nodes[count // 2], rtol=1e-12)
        np.testing.assert_allclose(slider.start + slider.step * np.arange(count), nodes)


def test_a_map_over_r_and_theta_lies_in_the_plane_of_the_circle():
    """Its pixels are x = r cos(theta) of the field x, to the distance of nodes."""
    figures = pytest.importorskip("xcg.explore.figures")
    r = xr.DataArray(np.linspace(1.0, 2.0, 21), dims="r", attrs={"units": "m"})
    theta = xr.DataArray(np.linspace(0, 2 * np.pi, 60, endpoint=False), dims="theta")
    x = (np.cos(theta) * r).assign_coords(r=r, theta=theta)
    for part in (slice(None), slice(0, 16)):  # the whole circle, and a quarter
        shown = figures.Map()
        picture = xr.Dataset({"density": x.isel(theta=part)})
        shown.draw(picture, Choice("density", "map", ("r", "theta")))
        (image,) = shown.image.data["image"]
        low, up = (shown.image.data[name][0] for name in "xy")
        wide, high = (shown.image.data[name][0] for name in ("dw", "dh"))
        middle = (np.arange(len(image)) + 0.5) / len(image)
        across, height = np.meshgrid(low + middle * wide, up + middle * high)
        away = np.hypot(across, height)
        angle = np.arctan2(height, across)
        inside = (away > 1.0) & (away < 2.0)
        if part.stop:
            inside &= (angle > 0) & (angle < theta[15].item())
            assert high < 2.2
        np.testing.assert_allclose(image[inside], across[inside], atol=0.11)
        assert np.isnan(image[(away < 0.95) | (away > 2.1)]).all()
        assert shown.figure.yaxis.axis_label == "r sin θ [m]"


def test_arrows_in_the_plane_of_a_circle_turn_with_the_angle():
    """A rigid rotation has arrows at right angles to the radius."""
    figures = pytest.importorskip("xcg.explore.figures")
    r = xr.DataArray(np.linspace(0.1, 1.0, 10), dims="r")
    theta = xr.DataArray(np.linspace(0, 2 * np.pi, 60, endpoint=False), dims="theta")
    turning = xr.zeros_like(theta) + r
    parts = [xr.zeros_like(turning), turning]
    velocity = xr.concat(parts, xr.Variable("component", ["r", "theta"]))
    f = xr.Dataset({"velocity": velocity}, {"r": r, "theta": theta})
    f["velocity"] = f["velocity"].transpose("r", "theta", "component")
    pictures = pictures_of(f)
    choice = Choice("velocity", "map", ("r", "theta"))
    shown = figures.Map()
    shown.draw(pictures.picture(choice), choice)
    x0, x1, y0, y1 = (shown.arrows.data[name] for name in ("x0", "x1", "y0", "y1"))
    along, rise, x, y = x1 - x0, y1 - y0, (x0 + x1) / 2, (y0 + y1) / 2
    length = np.hypot(along, rise) * np.hypot(x, y)
    assert len(x) > 100
    assert abs((along * x + rise * y) / length).max() < np.sin(np.pi / 60) + 1e-6
    assert (x * rise - y * along > 0).all()


def test_bands_are_one_error_wide_and_end_where_it_is_unknown():
    figures = pytest.importorskip("xcg.explore.figures")
    x = np.arange(6.0)
    error = np.array([0.1, 0.2, np.nan, 0.3, 0.1, 0.1])
    picture = xr.Dataset({"density": ("x", 2 * x), "density_error": ("x", error)}, {"x": x})
    shown = figures.Profile()
    shown.draw(picture, Choice("density", "profile", ("x",)))
    (along,) = shown.bands.data["x"]
    (across,) = shown.bands.data["y"]
    np.testing.assert_array_equal(along, [0, 1, 1, 0, np.nan, 3, 4, 5, 5, 4, 3])
    half = abs(across - 2 * along)
    np.testing.assert_allclose(half, [0.1, 0.2, 0.2, 0.1, np.nan, 0.3, 0.1, 0.1, 0.1, 0.1, 0.3])
    assert "one standard error" in shown.figure.title.text
    shown.draw(picture[["density"]], Choice("density", "profile", ("x",)))
    assert not len(shown.bands.data["x"])


def test_errors_have_labels_at_one_two_and_five_of_each_decade():
    figures = pytest.importorskip("xcg.explore.figures")
    ticks = np.sort(figures.Errors().figure.yaxis.ticker.ticks)
    percent = 100 * ticks[(ticks > 0.009) & (ticks < 1.1)]
    np.testing.assert_allclose(percent, [1, 2, 5, 10, 20, 50, 100])


def test_numbers_without_a_logarithm_are_named():
    figures = pytest.importorskip("xcg.explore.figures")
    x = np.arange(4.0)
    numbers = xr.DataArray([[-1.0, 1.0], [0.0, 4.0]], {"z": x[:2], "x": x[:2]}, ["z", "x"])
    picture = xr.Dataset({"stress": numbers})
    choice = Choice("stress", "map", ("x", "z"), is_logarithmic=True)
    shown = figures.Map()
    with pytest.warns(xcg.SceneWarning, match="50 % of stress is not above 0"):
        shown.draw(picture, choice)
    assert shown.range == (1.0, 4.0)
    (image,) = shown.image.data["image"]
    assert np.isnan(image[-1, 0])
    assert np.nanmin(image) > 0
    with pytest.raises(ValueError, match="stress is nowhere above 0"):
        shown.draw(-abs(picture), choice)
    with pytest.raises(ValueError, match="the colours end at -1"):
        shown.draw(picture, dataclasses.replace(choice, vmin=-1.0))


def test_numbers_are_saved_with_their_places_and_errors(tmp_path):
    app = pytest.importorskip("xcg.explore.app")
    mean = xcg.datasets.open("plane_shear").cg.coarse_grain("velocity", axes="z")
    page = app.Explorer(pictures_of(mean.cg.time_average().compute()))
    table = pd.read_csv(page._numbers_as_csv())
    assert [*table] == ["z", "component", "velocity", "velocity_error"]
    assert len(table) == 3 * page.numbers.sizes["z"]


def test_texts_need_no_style_of_the_internet():
    """Panes of Panel load theirs from it in notebooks when their text changes."""
    panel = pytest.importorskip("panel")
    app = pytest.importorskip("xcg.explore.app")
    page = app.Explorer(pictures_of(xcg.datasets.random_scene(50, seed=1)))
    panes = page.layout.select(panel.pane.base.PaneBase)
    assert {type(pane) for pane in panes} == {panel.pane.Bokeh}


def test_a_script_that_shows_nothing_is_told_how_to_open_the_page(capsys):
    pytest.importorskip("panel")
    page = xcg.datasets.random_scene(50, seed=1).cg.explore()
    assert page.numbers is not None
    assert "show() opens it" in repr(page)
    assert capsys.readouterr().err == ""
    page.unseen()  # as when the script ends
    assert "ds.cg.explore().show() opens it" in capsys.readouterr().err


def test_a_script_that_opens_the_page_is_told_nothing(capsys, monkeypatch):
    app = pytest.importorskip("xcg.explore.app")
    monkeypatch.setattr(app, "serve", lambda page, port: page())
    page = xcg.datasets.random_scene(50, seed=1).cg.explore()
    page.show()
    page.unseen()
    assert capsys.readouterr().err == ""


def test_notebooks_are_told_that_they_need_no_server():
    app = pytest.importorskip("xcg.explore.app")

    async def use():
        with pytest.raises(RuntimeError, match="last line of a cell"):
            app.Explorer(pictures_of(xcg.datasets.random_scene(50, seed=1))).show()

    asyncio.run(use())


def test_the_command_takes_results_that_were_saved(tmp_path, monkeypatch):
    from xcg import cli
    from xcg.explore import server

    served = []
    monkeypatch.setattr(server, "serve", lambda page, port=0, show=True: served.append(page()))
    f = xcg.datasets.random_scene(50, seed=1).cg.coarse_grain("density", axes="xz", width=1.0)
    for name in ("f.nc", "f.h5", "f.zarr"):
        f.cg.save(tmp_path / name)
        cli.explore.main([str(tmp_path / name), "--no-browser"], standalone_mode=False)
    assert len(served) == 3


def test_a_missing_package_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "panel", None)
    with pytest.raises(ImportError, match=r"explore needs panel.*pip install 'xcg\[explore\]'"):
        xcg.datasets.random_scene(10).cg.explore()


def test_units_have_raised_powers():
    assert unit_in_unicode("kg m^-3") == "kg m⁻³"
    assert unit_in_unicode("m s-1") == "m s⁻¹"
    assert unit_in_unicode("1") == ""
