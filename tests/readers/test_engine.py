"""Readers that users add, through public names only, as the page on own readers shows."""

import os
import re
import subprocess
import sys
import tomllib
from importlib.metadata import entry_points

import numpy as np
import pytest

import xcg
from tests import ROOT
from xcg.readers.engine import BUILT_IN, Engine, StepRef, engine_table, load_engine


def test_engines_are_called_by_the_name_that_they_have_in_messages_and_on_the_page():
    assert [load_engine(name).name for name in BUILT_IN] == list(BUILT_IN)
    listed = ", ".join(BUILT_IN)
    assert f"one of\n        {listed};\n" in xcg.open_scene.__doc__
    table = (ROOT / "docs" / "reading.md").read_text().partition("| engine |")[2]
    rows = re.findall(r"^\| `(\w+)` \|", table.partition("\n\n")[0], re.MULTILINE)
    assert sorted(rows) == sorted(BUILT_IN)


# --- a reader from another package -----------------------------------------------------------------------


def write_grit(folder):
    """Two steps of the code in the docs: three grains in a row, two contacts."""
    for k, time in enumerate((0.0, 0.5)):
        rows = [f"{i} {2 * i + time} 0 0 1 0 0 1" for i in (3, 1, 2)]
        (folder / f"grains_{k}.txt").write_text("\n".join([f"# grit t={time} n=3", *rows, ""]))
        (folder / f"forces_{k}.txt").write_text(f"# grit t={time} n=2\n1 2 -5 0 0\n2 3 -5 0 0\n")


@pytest.fixture
def site(tmp_path):
    """A folder with the engine of the docs as an installed package, in front of the path of modules."""
    page = (ROOT / "docs" / "custom.md").read_text().partition("## File formats")[2]
    source, project = (
        re.search(rf"```{kind}\n(.*?)```", page, re.DOTALL)[1] for kind in ("python", "toml")
    )
    entry = re.search(r'\[project.entry-points."xcg.readers"\]\n(.*)\n', project)[1].replace(
        '"', ""
    )
    site = tmp_path / "site"
    (site / "grit_tools-1.0.dist-info").mkdir(parents=True)
    (site / "grit_tools-1.0.dist-info" / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: grit-tools\nVersion: 1.0\n"
    )
    (site / "grit_tools-1.0.dist-info" / "entry_points.txt").write_text(f"[xcg.readers]\n{entry}\n")
    (site / "grit_tools.py").write_text(source)
    if not entry_points(
        group="xarray.backends", name="xcg"
    ):  # a checkout that was installed before there was any
        backends = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"][
            "xarray.backends"
        ]
        lines = "".join(f"{name} = {place}\n" for name, place in backends.items())
        (site / "grit_tools-1.0.dist-info" / "entry_points.txt").write_text(
            f"[xcg.readers]\n{entry}\n[xarray.backends]\n{lines}"
        )
    return site


def run(code, site, folder):
    """Run Python with a folder of packages, in a folder of data."""
    paths = os.pathsep.join([str(site), str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=folder,
        env={**os.environ, "PYTHONPATH": paths},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_an_installed_package_adds_a_reader(tmp_path, site):
    write_grit(tmp_path)
    code = """
import dask, xcg
for engine in (None, "grit"):
    ds = xcg.open_scene("grains_*.txt", contacts="forces_*.txt", engine=engine, density=2500, units={"length": 1e-3})
    if engine:
        dask.config.set(scheduler="processes", num_workers=1)
    ds = ds[["position", "diameter", "contact_point"]].compute()
    print((1e3 * ds.position[1, :, 0]).round(9).values.tolist(), float(ds.diameter.max()))
    print(ds.time.values.tolist(), ds.contact_point[0, :, 0].values.tolist())
try:
    xcg.open_scene("grains_0.txt", engine="grid")
except xcg.SceneError as error:
    print(error)
"""
    told = "[2.5, 4.5, 6.5] 0.002\n[0.0, 0.5] [0.003, 0.005]\n"
    shown = run(code, site, tmp_path)
    assert shown.startswith(2 * told)
    assert shown.endswith(f"; did you mean 'grit'? Expected one of {', '.join(BUILT_IN)}, grit\n")


@pytest.mark.slow  # test_backend, and the same package through open_scene
def test_xarray_opens_files_of_that_package(tmp_path, site):
    write_grit(tmp_path)
    code = """
import xarray as xr
for options in ({"engine": "xcg"}, {"engine": "xcg", "reader": "grit", "chunks": {}}, {}):
    ds = xr.open_dataset("grains_1.txt", contacts="forces_1.txt", density=2500, drop_variables="velocity", **options)
    force = ds.contact_force.compute(scheduler="processes", num_workers=1)
    print(ds.chunks.get("time"), force[0, :, 0].values.tolist(), "velocity" in ds)
"""
    told = "{} [-5.0, -5.0] False\n"
    assert run(code, site, tmp_path) == told.format(None) + told.format((1,)) + told.format(None)


def test_an_engine_class_of_a_script_reaches_other_processes(tmp_path, site, computing):
    write_grit(tmp_path)
    script = {"__name__": "script"}  # no module that another process could import
    exec((site / "grit_tools.py").read_text(), script)
    for engine in (script["Grit"], script["Grit"]()):
        ds = xcg.open_scene(
            tmp_path / "grains_*.txt",
            contacts=tmp_path / "forces_*.txt",
            engine=engine,
            density=2500,
            chunks=1,
        )
        assert float(ds.contact_force.sum().compute(**computing("processes"))) == -20.0


def test_a_broken_package_is_skipped_with_a_warning(tmp_path, site, monkeypatch):
    write_grit(tmp_path)
    (site / "grit_tools.py").write_text("import nowhere_to_be_found")
    monkeypatch.syspath_prepend(site)
    monkeypatch.setattr("xcg.readers.engine.engine_table", engine_table.__wrapped__)
    with (
        pytest.warns(
            xcg.SceneWarning,
            match=r"'grit' \(grit_tools:Grit\) cannot be imported: .* 'nowhere_to_be_found'",
        ),
        pytest.raises(
            xcg.SceneError,
            match=r"no engine recognises .*grains_0.txt; .*xcg.scene_from_arrays .*docs/custom.md",
        ),
    ):
        xcg.open_scene(tmp_path / "grains_0.txt")


def test_faulty_engines_are_named(tmp_path):
    from xcg.readers.engine import Engine, StepRef

    class Points(Engine):
        promised = 4

        def index_particles(self, paths, options):
            return [StepRef(path, rows=self.promised, step=k) for k, path in enumerate(paths)]

        def read_particles(self, ref, options):
            return {"position": np.load(ref.path)}

    class Fewer(Points):
        promised = 3

    class Paths(Points):
        def index_particles(self, paths, options):
            return paths

    class Bare(Points):
        def read_particles(self, ref, options):
            return np.load(ref.path)

    class Half(Engine):
        def index_particles(self, paths, options):
            return []

    class Asks(Points):
        def __init__(self, argument):
            pass

    path = tmp_path / "p.npy"
    np.save(path, np.eye(4, 3))
    ds = xcg.open_scene(path, engine=Points)
    np.testing.assert_array_equal(ds.position[0], np.eye(4, 3))
    np.testing.assert_array_equal(xcg.open_scene(path, engine=Asks(1)).position[0], np.eye(4, 3))
    for engine, message in [
        (Fewer, r"p\.npy.*4 rows, but its index promised 3"),
        (Bare, r"p\.npy.*'bare' gives particles as ndarray; expected a dict of arrays"),
        (Paths, "'paths' lists .* as a step; expected a list of xcg.readers.StepRef"),
        (Half, "Half.*read_particles"),
        (Asks, "Asks.*without arguments"),
        (np, "expected a name, or a class or object derived from xcg.readers.Engine"),
    ]:
        with pytest.raises(xcg.SceneError, match=message):
            xcg.open_scene(path, engine=engine).compute()
    for arguments, message in [
        ({"contacts": path}, "contacts=: the engine 'points' reads particles only"),
        ({"walls": path}, "walls=: the engine 'points' reads contacts with walls among"),
        ({"step": 1}, "no argument 'step' for the engine 'points'"),
    ]:
        with pytest.raises(xcg.SceneError, match=message):
            xcg.open_scene(path, engine=Points, **arguments)
    unread = xcg.open_scene(path, engine=Points, chunks=1)
    np.save(path, np.eye(5, 3))
    with pytest.raises(xcg.SceneError, match="after the scene was opened"):
        unread.compute()


# --- what readers get wrong ------------------------------------------------------------------------------


def reader(step=None, **changed):
    """A reader of three grains, of which some arrays, or something of the step, are others."""
    particles = {
        "particle_id": [3, 1, 2],
        "position": np.eye(3),
        "velocity": np.ones((3, 3)),
        "diameter": np.ones(3),
    }

    class Own(Engine):
        """Three grains."""

        def recognises(self, path):
            return False

        def index_particles(self, paths, options):
            return [StepRef(**({"path": paths[0], "rows": 3, "time": 0.0} | (step or {})))]

        def read_particles(self, ref, options):
            return particles | changed

    return Own


def open_own_file(tmp_path, engine):
    (tmp_path / "own.txt").touch()
    return xcg.open_scene(tmp_path / "own.txt", engine=engine, density=1.0).compute()


def test_engines_may_return_lists(tmp_path):
    step = {
        "box": [[0, 2], [0, 3], [0, 4]],
        "gravity": np.array([0.0, 0.0, -9.81]),
        "periodic": "x",
    }
    velocity = [[3, 3, 3], [1, 1, 1], [2, 2, 2]]
    ds = open_own_file(
        tmp_path, reader(step, position=np.eye(3).tolist(), velocity=velocity, charge=[6, 4, 5])
    )
    assert ds.velocity.values[0, :, 0].tolist() == [1, 2, 3]
    assert ds.charge.values[0].tolist() == [4, 5, 6]
    assert ds.box.values[0].tolist() == step["box"]


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        (
            {"velocity": np.ma.masked_equal(np.eye(3), 1)},
            "'velocity' is a masked array with 3 masked values",
        ),
        ({"velocity": 1j * np.eye(3)}, "'velocity' holds complex128, expected real numbers"),
        ({"particle_id": ["a", "b", "c"]}, "'particle_id' holds <U1, expected real numbers"),
        (
            {"particle_id": [2**70, 1, 2]},
            "'particle_id' holds object, expected real numbers of 64 bits",
        ),
        ({"velocity": [[1, 2, 3], [1, 2], [1, 2, 3]]}, "gives values that are no array"),
        ({"position": 3.0}, "no positions"),
        ({"step": {"box": [0, 1]}}, r"gives a step box=\(0, 1\)"),
        ({"step": {"gravity": (0, 0)}}, r"gives a step gravity=\(0, 0\)"),
        ({"step": {"periodic": (True, True, False)}}, r"gives a step periodic=\(True"),
        ({"step": {"time": "0.1", "rows": -1}}, "gives a step rows=-1, time='0.1'"),
    ],
)
def test_results_of_engines_are_checked(tmp_path, changed, told):
    with pytest.raises(xcg.SceneError, match=rf"own.txt.*{told}"):
        open_own_file(tmp_path, reader(**changed))
