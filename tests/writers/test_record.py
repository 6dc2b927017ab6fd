"""Fields appended step after step: equal to those of the series, readable at any moment, continued."""

import os
import signal
import subprocess
import sys
import textwrap
import time
from contextlib import nullcontext

import numpy as np
import pytest
import xarray as xr

import xcg
from tests import ROOT, dumps
from tests.scenes import reopen

FIELDS = ["density", "velocity", "stress", "sample_count"]
OPTIONS = {"axes": "xz", "width": 0.8, "spacing": 1.0}


@pytest.fixture(params=["live.nc", "live.zarr"])
def path(request, tmp_path):
    if request.param.endswith("zarr"):
        pytest.importorskip("zarr")
    return tmp_path / request.param


def steps(count=4, **options):
    """A series, and its steps one by one."""
    ds = xcg.datasets.random_scene(60, periodic="xy", seed=5, **options)
    parts = []
    for k in range(count):
        moved = ds.assign(position=ds.position + 0.1 * k * np.array([1.0, 0.5, 0.0]))
        parts.append(moved.assign_coords(time=[0.5 * k], step=("time", [100 * k], ds.step.attrs)))
    return xr.concat(parts, "time", data_vars="all"), parts


def test_recorded_fields_equal_those_of_the_series(path):
    series, parts = steps()
    with xcg.record(path, FIELDS, **OPTIONS) as live:
        for k, part in enumerate(parts):
            live.append(part)
            assert live.steps == k + 1
            with reopen(path) as found:  # while it is recorded
                assert found.sizes["time"] == k + 1
    mesh = series.isel(time=0).cg.coarse_grain(FIELDS, **OPTIONS)
    bounds = {a: (float(mesh[a][0]), float(mesh[a][-1])) for a in "xz"}
    expected = series.cg.coarse_grain(FIELDS, bounds=bounds, **OPTIONS)
    with reopen(path) as found:
        for name in FIELDS:
            np.testing.assert_array_equal(found[name], expected[name])
            assert found[name].attrs == expected[name].attrs
        assert found.time.values.tolist() == [0.0, 0.5, 1.0, 1.5]
        assert found.step.values.tolist() == [0, 100, 200, 300]
        assert found.attrs["kernel"] == "lucy"
        assert found.component.values.tolist() == ["x", "y", "z"]
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_several_steps_and_fields_are_appended_at_once(path):
    series, _ = steps()
    fields = series.cg.coarse_grain("density", bounds={"x": (0, 4), "z": (0, 4)}, **OPTIONS)
    with xcg.record(path) as live:
        live.append(fields.isel(time=slice(0, 3)))
        live.append(fields.isel(time=3))  # without a dimension of time
    with reopen(path) as found:
        np.testing.assert_array_equal(found.density, fields.density)
        np.testing.assert_array_equal(found.step, fields.step)


def test_lazy_scenes_of_many_steps_are_recorded(path):
    series, _ = steps()
    with xcg.record(path, "density", bounds={"z": (-2.0, 7.0)}, **OPTIONS) as live:
        live.append(series.chunk({"time": 2}))
        assert live.steps == 4


def test_only_needed_variables_are_read(path):
    dumps.write_series(path.parent, (0, 10, 20))
    damaged = path.parent / "c.10.dump"
    damaged.write_text(damaged.read_text().replace("-9", "oops"))
    ds = xcg.open_scene(str(path.parent / "p.*.dump"), contacts=str(path.parent / "c.*.dump"))
    with xcg.record(path, "density", axes="z") as live:
        live.append(ds)
        assert live.steps == 3


def test_recording_continues_where_it_stopped(path):
    series, parts = steps()
    for part in parts:
        with xcg.record(path, FIELDS, **OPTIONS) as live:
            live.append(part)
    assert live.steps == 4
    with reopen(path) as found:
        assert np.isfinite(found.density).all()
        np.testing.assert_array_equal(found.time, series.time)


def test_recording_overwrites_on_request(path):
    _, parts = steps()
    with xcg.record(path, "density", **OPTIONS) as live:
        live.append(parts[0])
    with xcg.record(path, "velocity", overwrite=True, **OPTIONS) as live:
        with reopen(path) as found:  # until there is something else
            assert "density" in found
        live.append(parts[1])
    with reopen(path) as found:
        assert list(found.data_vars) == ["velocity"]
        assert found.time.values.tolist() == [0.5]


def test_the_mesh_of_the_first_step_holds_for_all(path):
    """Grains spread, and sizes change: nodes and width are those of the first step."""
    ds = xcg.datasets.random_scene(60, seed=5)
    spread = ds.assign(position=ds.position * 1.5).cg.measure().assign_coords(time=[1.0])
    with xcg.record(path, "density", by="species") as live:
        live.append(ds)
        live.append(spread)
    with reopen(path) as found:
        expected = ds.cg.coarse_grain("density", by="species")
        for a in "xyz":
            np.testing.assert_array_equal(found[a], expected[a])
        np.testing.assert_array_equal(found.density[0], expected.density[0])
        assert found.attrs["width"] == expected.attrs["width"]


def test_recorded_fields_are_rounded_to_digits(path):
    _, parts = steps()
    with xcg.record(path, "density", digits=3, dtype="float32", **OPTIONS) as live:
        live.append(parts[0])
        live.append(parts[1])
    exact = parts[1].cg.coarse_grain("density", **OPTIONS).density.values
    with reopen(path) as found:
        assert found.density.dtype == "float32"
        assert found.density.precision.startswith("rounded to 3 significant digits")
        error = np.abs(found.density[1:].values - exact)
        assert 1e-6 * exact.max() < error.max()
        assert (error <= 0.5e-3 * exact).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"time": 0.0}, "append steps in the order of time"),
        ({"fields": ["density", "velocity"]}, r"the fields \['velocity'\] are not in both"),
        ({"axes": "x"}, "'z' has the length None"),
        ({"kernel": "gaussian"}, "kernel is 'gaussian' instead of 'lucy'"),
        ({"width": 0.9}, "width is 0.9 instead of 0.8"),
        ({"spacing": 0.5}, "'x' has the length"),
    ],
)
def test_a_step_of_another_shape_raises(path, change, message):
    _, parts = steps(2)
    change = dict(change)
    later = parts[1].assign_coords(time=[change.pop("time", 0.5)])
    with xcg.record(path, "density", **OPTIONS) as live:
        live.append(parts[0])
        other = later.cg.coarse_grain(**{"fields": "density", **OPTIONS, **change})
        with pytest.raises(xcg.SceneError, match=message):
            live.append(other)
    with reopen(path) as found:
        assert found.sizes["time"] == 1


def test_a_second_recorder_raises(path):
    with (
        xcg.record(path, "density"),
        pytest.raises(FileExistsError, match="is being written by another run"),
    ):
        xcg.record(path, "density")
    xcg.record(path, "density").close()


def test_wrong_arguments_raise(tmp_path):
    with pytest.raises(ValueError, match=r"expected a name that ends with \.nc"):
        xcg.record(tmp_path / "f.vtkhdf", "density")
    with pytest.raises(ValueError, match="an HDF5 file is damaged where a process ends"):
        xcg.record(tmp_path / "f.h5", "density")
    with pytest.raises(TypeError, match="axis"):
        xcg.record(tmp_path / "f.nc", "density", axis="z")
    with pytest.raises(FileNotFoundError, match="create it first"):
        xcg.record(tmp_path / "nowhere" / "f.nc", "density")
    xr.Dataset({"a": 1}).to_netcdf(tmp_path / "f.nc")
    with pytest.raises(xcg.SceneError, match="no record of fields over time"):
        xcg.record(tmp_path / "f.nc", "density")


SCRIPT = """
    import sys, numpy as np, xarray as xr, xcg
    path, first = sys.argv[1], int(sys.argv[2])
    f = xr.Dataset({"a": (("time", "x"), np.ones((1, 400_000)))}, {"time": [0.0], "step": ("time", [0])})
    with xcg.record(path) as live:
        print("ready", flush=True)
        for k in range(first, 10**6):
            live.append(f.assign_coords(time=[float(k)], step=("time", [k])) * (k + 1.0))
            print(k, flush=True)
"""


# test_store kills processes that write NetCDF
@pytest.mark.parametrize(
    "path", [pytest.param("live.nc", marks=pytest.mark.slow), "live.zarr"], indirect=True
)
@pytest.mark.skipif(os.name != "posix", reason="kills a process")
def test_a_killed_recorder_leaves_a_readable_file(path, tmp_path):
    """Whenever the process is killed: all steps that were appended are whole, and it goes on from there."""
    script = tmp_path / "script.py"
    script.write_text(textwrap.dedent(SCRIPT))
    first = 0
    for delay in (0.0, 0.004):
        call = [sys.executable, script, path, str(first)]
        with subprocess.Popen(call, stdout=subprocess.PIPE, text=True, cwd=ROOT) as run:
            assert run.stdout.readline() == "ready\n"
            while (line := run.stdout.readline()) and int(line) < first + 5:
                pass
            assert line
            time.sleep(delay)
            run.send_signal(signal.SIGKILL)
            last = [int(line), *map(int, run.stdout.read().split())][-1]
        with reopen(path) as found:
            count = found.sizes["time"]
            assert count in (last + 1, last + 2)  # the last one may be there, and its line not
            np.testing.assert_array_equal(
                found.a, np.broadcast_to(np.arange(1.0, count + 1)[:, None], found.a.shape)
            )
            np.testing.assert_array_equal(found.step, np.arange(count))
        first = count


@pytest.mark.parametrize(("later", "message"), [
    ({"width": 0.5}, "width 0.5 is not 1.0"), ({"bounds": {"z": (0, 1)}}, "z .* is not"),
    ({"by": "species"}, "no phases"),
    ({"temperature": "biased"}, "temperature is 'biased' instead of 'unbiased'"),
    ({"spacing": 0.4}, "spacing along z 0.4 is not 0.5"), ({"extent": {"x": 3.0}}, "extent along x 3.0 is not 2.0"),
    ({"extent": None}, None), ({"spacing": None}, None),
])  # fmt: skip
def test_a_record_is_continued_with_the_same_options_only(tmp_path, later, message):
    ds = xcg.datasets.simple_cubic(4)
    ds = ds.assign(species=ds.particle_id * 0 + 1).assign_attrs(species_values=[1])
    given = {
        "axes": "z",
        "width": 1.0,
        "fields": "density",
        "spacing": 0.5,
        "extent": {"x": 2.0, "y": 2.0},
    }
    with xcg.record(tmp_path / "live.nc", **given) as live:
        live.append(ds)
    raises = pytest.raises(xcg.SceneError, match=message) if message else nullcontext()
    with raises, xcg.record(tmp_path / "live.nc", **(given | later)) as live:
        live.append(ds.assign_coords(time=ds.time + 1.0))
    if not message:
        with reopen(tmp_path / "live.nc") as found:
            np.testing.assert_array_equal(found.density[0], found.density[1])


def test_a_spacing_that_does_not_divide_the_period_is_continued(path):
    _, parts = steps(2)
    given = {"fields": "density", "axes": "x", "width": 0.8, "spacing": 0.7}
    for part in parts:
        with xcg.record(path, **given) as live:
            live.append(part)
    with pytest.raises(xcg.SceneError, match="spacing along x"):
        xcg.record(path, **(given | {"spacing": 0.9}))


def test_times_are_not_rounded_to_digits(path):
    _, parts = steps(2)
    with xcg.record(path, "density", digits=3, **OPTIONS) as live:
        for k, part in enumerate(parts):
            live.append(part.assign_coords(time=[1000.1 + 0.1 * k]))
    with reopen(path) as found:
        assert found.time.values.tolist() == [1000.1, 1000.2]


def test_bounds_that_the_spacing_does_not_divide_are_continued(tmp_path):
    ds = xcg.datasets.simple_cubic(4)
    given = {
        "fields": "density",
        "axes": "z",
        "width": 1.0,
        "bounds": {"z": (0, 1)},
        "spacing": 0.4,
    }
    for k in range(2):
        with xcg.record(tmp_path / "live.nc", **given) as live:
            live.append(ds.assign_coords(time=ds.time + k))
    assert live.steps == 2


def test_unknown_arguments_are_named(tmp_path):
    with pytest.raises(
        TypeError,
        match=r"record\(\) got an unexpected keyword argument 'axez'; did you mean 'axes'",
    ):
        xcg.record(tmp_path / "a.nc", "density", axez="z")


def test_records_take_the_kernel_of_their_preset(tmp_path):
    scene = xcg.datasets.random_scene(30)
    with xcg.record(tmp_path / "a.nc", "density", axes="z", width=1.0, preset="lammps") as live:
        live.append(scene)
    assert xr.open_dataset(tmp_path / "a.nc").attrs["kernel"] == "shifted gaussian"
