"""The page in Chromium: controls change the picture, colours are right, closing it ends the server."""

import asyncio
import io
import json
import pathlib
import re
import shutil
import socket
import subprocess
import sys

import numpy as np
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
    assert_colours(page, shown)
    page.page.get_by_role("button", name="copy").click()
    page.page.get_by_role("button", name="copied").wait_for()
    assert page.page.evaluate("navigator.clipboard.readText()") == shown
    with page.page.expect_download() as table:
        page.page.get_by_text("numbers (CSV)").click()
    assert "velocity" in pathlib.Path(table.value.path()).read_text().partition("\n")[0]
    width = page.page.evaluate(WIDTH)
    page.page.set_viewport_size({"width": 900, "height": 900})
    page.page.wait_for_function(f"width => ({WIDTH})() < width", arg=width)

    assert page.errors == []
    page.page.close()
    assert process.wait(60) == 0


def assert_colours(page, call):
    """Check colours at three nodes of a map of speeds: between the numbers of the nodes around."""
    palettes = pytest.importorskip("bokeh.palettes")
    image = pytest.importorskip("matplotlib.image")
    names = {}
    exec(call.rpartition("\nf.cg.plot")[0], names)
    velocity = names["f"]["velocity"].isel(time=0)
    speed = ((velocity**2).sum("component", skipna=False) ** 0.5).transpose("z", "x")
    numbers = speed.to_numpy()
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


def test_a_script_is_told_how_to_open_the_page(capsys):
    page = xcg.datasets.random_scene(50, seed=1).cg.explore()
    assert "ds.cg.explore().show() opens the page" in capsys.readouterr().err
    assert page.numbers is not None


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
