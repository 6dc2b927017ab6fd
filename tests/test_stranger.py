"""What users add, through public names only: as someone would who knows the documentation and not the code."""

import os
import re
import subprocess
import sys
import tomllib
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np
import pytest

import xcg
from xcg.readers import Engine, StepRef

ROOT = Path(__file__).parents[1]


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
    source, project = (re.search(rf"```{kind}\n(.*?)```", page, re.DOTALL)[1] for kind in ("python", "toml"))
    entry = re.search(r'\[project.entry-points."xcg.readers"\]\n(.*)\n', project)[1].replace('"', "")
    site = tmp_path / "site"
    (site / "grit_tools-1.0.dist-info").mkdir(parents=True)
    (site / "grit_tools-1.0.dist-info" / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: grit-tools\nVersion: 1.0\n"
    )
    (site / "grit_tools-1.0.dist-info" / "entry_points.txt").write_text(f"[xcg.readers]\n{entry}\n")
    (site / "grit_tools.py").write_text(source)
    if not entry_points(group="xarray.backends", name="xcg"):  # a checkout that was installed before there was any
        backends = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]["xarray.backends"]
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


def test_an_installed_package_brings_a_reader(tmp_path, site):
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
    assert shown.endswith(
        "; did you mean 'grit'? Expected one of lammps, liggghts, mercury, mfix, yade, table, hdf5, vtk, grit\n"
    )


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


def test_a_class_travels_to_other_processes(tmp_path, site):
    write_grit(tmp_path)
    code = (
        (site / "grit_tools.py").read_text()
        + """
import xarray as xr

import xcg
from xcg.readers import Engine, StepRef
for engine in (Grit, Grit()):
    ds = xcg.open_scene("grains_*.txt", contacts="forces_*.txt", engine=engine, density=2500)
    print(float(ds.contact_force.sum().compute(scheduler="processes", num_workers=1)))
"""
    )
    (site / "grit_tools.py").unlink()  # the class is that of the script
    assert run(code, tmp_path, tmp_path) == 2 * "-20.0\n"


def test_a_package_that_is_broken_is_left_out(tmp_path, site):
    write_grit(tmp_path)
    (site / "grit_tools.py").write_text("import nowhere_to_be_found")
    code = """
import warnings, xcg
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    try:
        xcg.open_scene("grains_0.txt")
    except xcg.SceneError as error:
        print(error)
print(*(w.message for w in caught))
"""
    shown = run(code, site, tmp_path)
    assert re.match(r"no engine recognises grains_0.txt; .*xcg.scene_from_arrays .*docs/custom.md", shown)
    assert "the engine 'grit' (grit_tools:Grit) cannot be imported: No module named 'nowhere_to_be_found'" in shown


def test_engines_at_fault_are_named(tmp_path):
    from xcg.readers import Engine, StepRef

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
    np.save(path, np.eye(5, 3))
    with pytest.raises(xcg.SceneError, match="after the scene was opened"):
        ds.compute()


# --- a field of one's own ----------------------------------------------------------------------------------


def test_a_field_with_an_eigenvalue():
    """The example of the docs: principal stresses by phase, averaged over nodes."""
    page = (ROOT / "docs" / "custom.md").read_text()
    names: dict = {}
    exec(re.search(r"```python\n(.*?)```", page, re.DOTALL)[1], names)
    ds, f, mean = names["ds"], names["f"], names["profile"]
    np.testing.assert_array_equal(f.major_stress, np.linalg.eigvalsh(f.stress)[..., -1])
    assert f.major_stress.dims == ("time", "x", "y", "z", "phase")
    assert f.major_stress.attrs["units"] == "Pa"
    assert f.major_stress.attrs["long_name"] == "largest principal stress"
    assert "major_stress" in xcg.FIELDS
    alone = ds.cg.coarse_grain("stress_anisotropy", width=0.8, by="species")
    np.testing.assert_array_equal(alone.stress_anisotropy, f.stress_anisotropy)
    sigma = f.stress.mean(["x", "y"])  # not the average of eigenvalues
    np.testing.assert_allclose(mean.major_stress, np.linalg.eigvalsh(sigma)[..., -1], rtol=1e-12)
    ratio = mean.major_stress / (sum(sigma.sel(component=a, direction=a) for a in "xyz") / 3) - 1
    np.testing.assert_allclose(mean.stress_anisotropy, ratio, rtol=1e-9)


# --- a variable of one's own -----------------------------------------------------------------------------


def test_mean_of_a_temperature():
    rng = np.random.default_rng(3)
    position = rng.random((300, 3)) * [1.0, 1.0, 2.0]
    ds = xcg.scene_from_arrays(
        position, diameter=np.full(300, 0.1), density=1000.0, velocity=rng.normal(size=(300, 3)),
        box={"x": (0, 1), "y": (0, 1), "z": (0, 2)}, periodic="xyz",
    )  # fmt: skip
    ds = ds.assign(temperature=(("time", "particle"), 290.0 + 10.0 * position[None, :, 2], {"units": "K"}))
    f = ds.cg.coarse_grain(["velocity", "temperature", xcg.Flux("temperature")], width=0.2, axes="z")
    assert f.temperature.dims == ("time", "z")
    assert f.temperature.attrs["units"] == "K"
    middle = f.temperature.sel(z=slice(0.6, 1.4)).isel(time=0)
    np.testing.assert_allclose(middle, 290.0 + 10.0 * middle.z, atol=0.7)
    weighed = f.temperature.attrs["weight"]
    average = ds.cg.coarse_grain(["temperature", weighed], width=0.2, axes="z").cg.profile("z")
    np.testing.assert_allclose(average.temperature, f.temperature)


# --- a smoothing function --------------------------------------------------------------------------------


def test_means_of_a_kernel_with_negative_parts():
    """What is about a mean is about sum m v Psi / sum m Psi, also where the sum of weights is below zero."""

    def profile(q):
        return (1 - q**2) ** 2 * (1 - 1.5 * q**2)

    xcg.register_kernel("with negative parts", profile)
    rng = np.random.default_rng(1)
    position, velocity, heat = rng.uniform(0, 4, (30, 3)), rng.normal(size=(30, 3)), rng.normal(300.0, 1.0, 30)
    ds = xcg.scene_from_arrays(
        position, velocity=velocity, diameter=rng.uniform(0.5, 1, 30), density=1000.0, heat=heat,
        species=rng.integers(1, 3, 30),
    )  # fmt: skip
    fields = ["density", "velocity", "kinetic_stress", "heat", xcg.Flux("heat"), xcg.Variance("heat")]
    at = {"bounds": dict.fromkeys("xyz", (0.0, 4.0)), "spacing": 1.0}
    f = ds.cg.coarse_grain(fields, width=0.7, kernel="with negative parts", by="species", **at).isel(time=0)

    nodes = np.stack(np.meshgrid(f.x, f.y, f.z, indexing="ij"), axis=-1)[..., None, :]
    q = np.minimum(np.linalg.norm(nodes - position, axis=-1) / 1.4, 1)
    radii = (np.arange(10_000) + 0.5) / 10_000
    psi = profile(q) / (4 * np.pi * np.mean(profile(radii) * radii**2) * 1.4**3)
    mass = ds.mass.values[0]
    rho = psi @ mass
    assert (rho < 0).sum() > 5
    with np.errstate(invalid="ignore"):
        v = velocity - ((psi * mass) @ velocity / rho[..., None])[..., None, :]
        dq = heat - (psi @ (mass * heat) / rho)[..., None]
    for phase in ("bulk", "1", "2"):
        weight = psi * mass * (1 if phase == "bulk" else ds.species.values[0] == int(phase))
        own = weight.sum(axis=-1)
        expected = {
            "density": own,
            "kinetic_stress": np.einsum("...g,...gi,...gj->...ij", weight, v, v),
            "flux_heat": np.einsum("...g,...g,...gi->...i", weight, dq, v),
        }
        seen = np.abs(psi).max(axis=-1) > 0
        for name, values in expected.items():
            found = f[name].sel(phase=phase).values
            np.testing.assert_allclose(found[seen], values[seen], rtol=0, atol=1e-7 * np.abs(values[seen]).max())
        with np.errstate(invalid="ignore"):
            ratios = {
                "velocity": weight @ velocity / own[..., None],
                "heat": weight @ heat / own,
                "variance_heat": np.maximum((weight * dq**2).sum(axis=-1) / own, 0),
            }
        for name, values in ratios.items():
            found = f[name].sel(phase=phase).values
            np.testing.assert_allclose(found, values, rtol=1e-6, atol=1e-6 * np.nanmedian(np.abs(values)))
    steps = ds.cg.coarse_grain(["density", "velocity", "heat"], width=0.7, kernel="with negative parts", **at)
    mean = xcg.time_average(steps)
    for name in ("density", "velocity", "heat"):
        np.testing.assert_allclose(mean[name], steps[name].isel(time=0), rtol=1e-12)


# --- what readers get wrong ------------------------------------------------------------------------------


def reader(step=None, **changed):
    """A reader of three grains, of which some arrays, or something of the step, are others."""
    particles = {"particle_id": [3, 1, 2], "position": np.eye(3), "velocity": np.ones((3, 3)), "diameter": np.ones(3)}

    class Own(Engine):
        """Three grains."""

        def recognises(self, path):
            return False

        def index_particles(self, paths, options):
            return [StepRef(**({"path": paths[0], "rows": 3, "time": 0.0} | (step or {})))]

        def read_particles(self, ref, options):
            return particles | changed

    return Own


def opened(tmp_path, engine):
    (tmp_path / "own.txt").touch()
    return xcg.open_scene(tmp_path / "own.txt", engine=engine, density=1.0).compute()


def test_readers_may_give_lists(tmp_path):
    step = {"box": [[0, 2], [0, 3], [0, 4]], "gravity": np.array([0.0, 0.0, -9.81]), "periodic": "x"}
    velocity = [[3, 3, 3], [1, 1, 1], [2, 2, 2]]
    ds = opened(tmp_path, reader(step, position=np.eye(3).tolist(), velocity=velocity, charge=[6, 4, 5]))
    assert ds.velocity.values[0, :, 0].tolist() == [1, 2, 3]
    assert ds.charge.values[0].tolist() == [4, 5, 6]
    assert ds.box.values[0].tolist() == step["box"]


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"velocity": np.ma.masked_equal(np.eye(3), 1)}, "'velocity' is a masked array with 3 masked values"),
        ({"velocity": 1j * np.eye(3)}, "'velocity' holds complex128, expected real numbers"),
        ({"particle_id": ["a", "b", "c"]}, "'particle_id' holds <U1, expected real numbers"),
        ({"velocity": [[1, 2, 3], [1, 2], [1, 2, 3]]}, "gives values that are no array"),
        ({"position": 3.0}, "no positions"),
        ({"step": {"box": [0, 1]}}, r"gives a step box=\(0, 1\)"),
        ({"step": {"gravity": (0, 0)}}, r"gives a step gravity=\(0, 0\)"),
        ({"step": {"periodic": (True, True, False)}}, r"gives a step periodic=\(True"),
        ({"step": {"time": "0.1", "rows": -1}}, "gives a step rows=-1, time='0.1'"),
    ],
)
def test_what_readers_give_is_checked(tmp_path, changed, told):
    with pytest.raises(xcg.SceneError, match=rf"own.txt.*{told}"):
        opened(tmp_path, reader(**changed))
