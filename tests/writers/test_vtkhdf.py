from __future__ import annotations

import dask
import dask.array as da
import h5py
import numpy as np
import pytest
import xarray as xr

import xcg

AXES = ("x", "y", "z")
SHAPE = {"x": 3, "y": 4, "z": 5}
ORIGIN = {"x": -1.0, "y": 0.25, "z": 10.0}
SPACING = {"x": 0.5, "y": 0.125, "z": 2.0}


def result(axes="xyz", steps=3, shape=SHAPE) -> xr.Dataset:
    """Fields that tell every node, step, component and direction apart."""
    coords = {a: ORIGIN[a] + SPACING[a] * np.arange(shape[a]) for a in axes}
    coords |= {"component": list(AXES), "direction": list(AXES), "time": 0.5 * np.arange(steps)}
    ramp = {
        dim: xr.DataArray(np.arange(float(len(values))), dims=dim) for dim, values in coords.items()
    }
    scalar = 1000.0 * ramp["time"]
    for axis, factor in zip(AXES, (1, 10, 100), strict=True):
        scalar = scalar + factor * ramp.get(axis, 0.0)
    velocity = scalar + 0.1 * ramp["component"]
    data = {
        "density": scalar,
        "velocity": velocity,
        "stress": velocity + 0.01 * ramp["direction"],
        "sample_count": scalar.astype("int64"),
    }
    ds = xr.Dataset(
        data, coords, {"kernel": "lucy", "width": 0.5, "axes": ["x", "z"], "nothing": None}
    )
    ds["stress"].attrs = {"units": "Pa", "long_name": "stress σ"}
    return ds


def read(path):
    """Steps of a file as VTK reads them: times, geometry, arrays (z, y, x[, components]) by name."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline
    from vtkmodules.vtkIOHDF import vtkHDFReader

    reader = vtkHDFReader()
    assert reader.CanReadFile(str(path))
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    key = vtkStreamingDemandDrivenPipeline.TIME_STEPS()
    info = reader.GetOutputInformation(0)
    times = [info.Get(key, step) for step in range(info.Length(key))] if info.Has(key) else None
    steps = []
    for step in range(len(times or [0])):
        reader.SetStep(step)
        reader.Update()
        image = reader.GetOutput()
        data = image.GetPointData()
        arrays = {}
        for index in range(data.GetNumberOfArrays()):
            values = vtk_to_numpy(data.GetArray(index)).copy()
            arrays[data.GetArrayName(index)] = values.reshape(
                *image.GetDimensions()[::-1], *values.shape[1:]
            )
        steps.append(arrays)
    return times, (image.GetDimensions(), image.GetOrigin(), image.GetSpacing()), steps


def assert_read_equal(
    path, ds: xr.Dataset, names=("density", "velocity", "stress", "sample_count")
) -> None:
    times, _, steps = read(path)
    full = ds.expand_dims([dim for dim in ("time", *AXES) if dim not in ds.dims])
    assert len(steps) == full.sizes["time"]
    if len(steps) > 1:
        assert times == full["time"].values.tolist()
    for step, arrays in enumerate(steps):
        assert set(arrays) == set(names)
        for name in names:
            there = full[name].isel(time=step).transpose("z", "y", "x", ...).values
            components = there.shape[3:]
            assert components == (3,) * len(components)
            np.testing.assert_array_equal(
                arrays[name],
                there.reshape(*there.shape[:3], *[3 ** len(components)] * bool(components)),
            )


@pytest.mark.parametrize("axes", ["xyz", "xy", "xz", "yz", "x", "y", "z", ""])
@pytest.mark.parametrize("steps", [1, 3])
@pytest.mark.parametrize("lazy", [False, True])
def test_reads_back_equal(tmp_path, axes, steps, lazy):
    ds = result(axes, steps)
    path = xcg.save(ds.chunk(time=2) if lazy else ds, tmp_path / "f.vtkhdf")
    assert path == tmp_path / "f.vtkhdf"
    assert_read_equal(path, ds)
    _, (nodes, origin, spacing), _ = read(path)
    for k, axis in enumerate(AXES):
        expected = (SHAPE[axis], ORIGIN[axis], SPACING[axis]) if axis in axes else (1, 0.0, 1.0)
        assert (nodes[k], origin[k], spacing[k]) == expected


@pytest.mark.parametrize("axis", AXES)
def test_axes_with_one_node(tmp_path, axis):
    ds = result(shape=SHAPE | {axis: 1})
    assert_read_equal(xcg.save(ds, tmp_path / "f.vtkhdf"), ds)


def test_dimensions_in_any_order(tmp_path):
    ds = result()
    path = xcg.save(
        ds.transpose("direction", "z", "component", "x", "time", "y"), tmp_path / "f.vtkhdf"
    )
    assert_read_equal(path, ds)


def test_components_in_any_order(tmp_path):
    ds = result()
    path = xcg.save(ds.isel(component=[2, 0, 1], direction=[1, 2, 0]), tmp_path / "f.vtkhdf")
    assert_read_equal(path, ds)


def test_one_component_is_a_scalar(tmp_path):
    ds = result()[["stress"]].sel(component="x")
    assert_read_equal(xcg.save(ds, tmp_path / "f.vtkhdf"), ds, ["stress"])


def test_fields_without_time_are_written(tmp_path):
    ds = result()
    assert_read_equal(xcg.save(ds.mean("time"), tmp_path / "mean.vtkhdf"), ds.mean("time"))
    path = xcg.save(ds.isel(time=1), tmp_path / "one.vtkhdf")
    assert_read_equal(path, ds.isel(time=1))
    with h5py.File(path) as file:
        np.testing.assert_array_equal(file["VTKHDF/Steps/Values"], [0.5])


def test_fixed_axes_give_the_origin(tmp_path):
    ds = result("xz").assign_coords(y=-0.75)
    _, (nodes, origin, _), _ = read(xcg.save(ds, tmp_path / "f.vtkhdf"))
    assert nodes == (3, 1, 5)
    assert origin == (-1.0, -0.75, 10.0)


def test_phases_become_arrays(tmp_path):
    ds = result()
    phases = xr.concat(
        [ds + 0.5 * k for k in range(3)], xr.IndexVariable("phase", ["bulk", "1", "a/b"])
    )
    phases["count"] = ds["sample_count"]
    path = xcg.save(phases.chunk(time=1), tmp_path / "f.vtkhdf")
    _, _, steps = read(path)
    wide = {"count": ds["sample_count"]}
    for k, suffix in enumerate(("", "_phase_1", "_phase_a_b")):
        wide |= {f"{name}{suffix}": phases[name].isel(phase=k, drop=True) for name in ds.data_vars}
    assert set(steps[0]) == set(wide)
    assert_read_equal(path, xr.Dataset(wide), list(wide))


def test_fields_without_some_dimensions_are_repeated(tmp_path):
    ds = result()
    ds["mass"] = ds["density"].isel(x=0, y=0, z=0, drop=True).chunk()
    ds["weight"] = xr.DataArray(da.full(5, 2.0), dims="z")
    filled = ds.assign(
        mass=ds["mass"].broadcast_like(ds["density"]),
        weight=ds["weight"].broadcast_like(ds["density"]),
    )
    assert_read_equal(xcg.save(ds, tmp_path / "f.vtkhdf"), filled, list(ds.data_vars))


def test_values_that_are_not_finite_stay(tmp_path):
    ds = result()[["density"]]
    ds["density"][1, 1, 2, 3] = np.nan
    ds["density"][2, 0, 0, 1] = np.inf
    assert_read_equal(xcg.save(ds, tmp_path / "f.vtkhdf"), ds, ["density"])


@pytest.mark.parametrize(
    "dtype", ["int64", "int32", "uint8", "bool", "float32", "float16", "float64"]
)
def test_types_of_numbers_are_kept(tmp_path, dtype):
    ds = (result()[["density"]] % 2).astype(dtype)
    path = xcg.save(ds, tmp_path / "f.vtkhdf")
    assert_read_equal(path, ds, ["density"])
    stored = read(path)[2][0]["density"].dtype
    assert stored == {"bool": "uint8", "float16": "float32"}.get(dtype, dtype)


def test_attributes_are_kept(tmp_path):
    with h5py.File(xcg.save(result(), tmp_path / "f.vtkhdf")) as file:
        assert dict(file["VTKHDF/PointData/stress"].attrs) == {
            "units": "Pa",
            "long_name": "stress σ",
        }
        assert file["xcg"].attrs["kernel"] == "lucy"
        assert file["xcg"].attrs["width"] == 0.5
        assert list(file["xcg"].attrs["axes"]) == ["x", "z"]
        assert file["xcg"].attrs["nothing"] == "None"


def test_large_steps_are_split_into_blocks(tmp_path):
    ds = xr.Dataset(
        {"density": (("time", "x", "y", "z"), np.random.default_rng(1).random((2, 90, 100, 110)))},
        {"time": [0.0, 1.0], "x": np.arange(90.0), "y": np.arange(100.0), "z": np.arange(110.0)},
    )
    path = xcg.save(ds, tmp_path / "f.vtkhdf", compression=1)
    with h5py.File(path) as file:
        blocks = file["VTKHDF/PointData/density"].chunks
    assert blocks[0] == 1
    assert np.prod(blocks) * 8 <= 1 << 22
    assert_read_equal(path, ds, ["density"])


def test_compression_is_a_choice(tmp_path):
    ds = xr.Dataset(
        {"density": (("time", "x", "y", "z"), np.zeros((1, 40, 40, 40)))},
        {"time": [0.0], **{a: np.arange(40.0) for a in "xyz"}},
    )
    plain, small = (
        xcg.save(ds, tmp_path / f"{level}.vtkhdf", compression=level) for level in (0, 1)
    )
    assert small.stat().st_size < 0.2 * plain.stat().st_size
    assert_read_equal(plain, ds, ["density"])
    assert_read_equal(small, ds, ["density"])
    with pytest.raises(ValueError, match="from 0 to 9"):
        xcg.save(ds, tmp_path / "no.vtkhdf", compression=10)


# --- lazy ------------------------------------------------------------------------------------------------


def test_each_chunk_is_computed_once_with_all_its_variables(tmp_path):
    seen = []
    calls = []

    def parse(block, block_info=None):
        seen.append(block_info[0]["chunk-location"][0])
        return block

    def count(graph, keys, **kwargs):
        calls.append(1)
        return dask.get(graph, keys, **kwargs)

    ds = result(steps=6)[["density"]]
    parsed = da.map_blocks(
        parse, da.from_array(ds["density"].data, (2, -1, -1, -1)), meta=np.empty((0,) * 4)
    )
    ds["density"] = (ds["density"].dims, parsed)
    ds["twice"] = (ds["density"].dims, (2 * parsed).rechunk((3, -1, -1, -1)))
    ds["velocity"] = ds["density"] + 1
    with dask.config.set(scheduler=count):
        xcg.save(ds.drop_vars("twice"), tmp_path / "f.vtkhdf")
    assert sorted(seen) == [0, 1, 2]
    assert len(calls) == 1
    seen.clear()
    with dask.config.set(scheduler=count):
        xcg.save(ds, tmp_path / "g.vtkhdf")
    assert sorted(seen) == [0, 1, 2]


def test_no_file_is_left_after_an_error(tmp_path):
    def fail(block, block_info=None):
        if block_info[0]["chunk-location"][0] == 1:
            message = "file 2 is damaged"
            raise RuntimeError(message)
        return block

    ds = result().chunk(time=1)
    broken = da.map_blocks(fail, ds["density"].data, meta=np.empty((0,) * 4))
    ds["density"] = (ds["density"].dims, broken)
    path = tmp_path / "f.vtkhdf"
    with pytest.raises(RuntimeError, match="file 2 is damaged"):
        xcg.save(ds, path)
    assert list(tmp_path.iterdir()) == []
    path.write_text("mine")
    with pytest.raises(RuntimeError, match="file 2 is damaged"):
        xcg.save(ds, path, overwrite=True)
    assert path.read_text() == "mine"
    assert list(tmp_path.iterdir()) == [path]


# --- refused ---------------------------------------------------------------------------------------------


def test_existing_files_stay_unless_overwrite(tmp_path):
    path = tmp_path / "f.vtkhdf"
    path.write_text("mine")
    with pytest.raises(FileExistsError, match="overwrite=True"):
        xcg.save(result(), path)
    assert path.read_text() == "mine"
    ds = result()
    assert_read_equal(xcg.save(ds, str(path), overwrite=True), ds)
    with pytest.raises(FileNotFoundError, match="create it first"):
        xcg.save(ds, tmp_path / "none" / "f.vtkhdf")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda ds: ds.assign_coords(y=[0.0, 1.0, 2.0, 4.0]), r"'y' is not evenly spaced.*node 2 is at 2\.0"),
        (lambda ds: ds.isel(z=slice(None, None, -1)), r"'z' is not evenly spaced and rising.* use fields.sortby"),
        (lambda ds: ds.assign_coords(x=[0.0, np.nan, 2.0]), "coordinate 'x' holds .*nan"),
        (lambda ds: ds.assign_coords(x=["a", "b", "c"]), "coordinate 'x' holds .*'a'"),
        (lambda ds: ds.drop_vars("x"), "'x' has no coordinate; assign one"),
        (lambda ds: ds.isel(x=slice(0, 0)), "'x' has no nodes"),
        (lambda ds: ds.isel(time=slice(0, 0)), "no time steps"),
        (lambda ds: ds.isel(time=[0, 2, 1]), r"0\.5 follows 1\.0 at index 2; order the steps"),
        (lambda ds: ds.assign_coords(time=[0.0, np.nan, 1.0]), "coordinate 'time' holds"),
        (lambda ds: ds.rename(z="radius"), r"'density' has the dimensions \['radius'\]"),
        (lambda ds: ds.isel(component=[0, 2]), r"'component' of \['stress', 'velocity'\] holds \['x', 'z'\]"),
        (lambda ds: ds.assign(name=("x", ["a", "b", "c"])), "'name' holds <U1, expected numbers"),
        (lambda ds: ds.assign(wave=ds["density"] * 1j), "'wave' holds complex128"),
        (lambda ds: ds.drop_vars(list(ds.data_vars)), "holds no variables"),
    ],
)  # fmt: skip
def test_fields_that_are_no_image_raise(tmp_path, change, message):
    with pytest.raises(ValueError, match=message):
        xcg.save(change(result()), tmp_path / "f.vtkhdf")
    assert list(tmp_path.iterdir()) == []


def test_phases_that_clash_with_variables_raise(tmp_path):
    ds = result()
    phases = xr.concat([ds, ds], xr.IndexVariable("phase", ["bulk", "1"]))
    phases["density_phase_1"] = ds["density"]
    with pytest.raises(ValueError, match=r"several arrays would be named \['density_phase_1'\]"):
        xcg.save(phases, tmp_path / "f.vtkhdf")


def test_large_fields_take_hardly_any_memory_beyond_their_end(tmp_path):
    """Chunks of 4 MB are even slabs, as the last one is stored whole."""
    edges = {"x": (0.0, 5.9), "y": (0.0, 5.7), "z": (0.0, 5.7)}
    f = xcg.datasets.random_scene(5, seed=1).cg.coarse_grain(
        "contact_stress", width=0.5, spacing=0.1, bounds=edges
    )
    f.cg.save(tmp_path / "f.vtkhdf")
    with h5py.File(tmp_path / "f.vtkhdf") as file:
        stored = file["VTKHDF/PointData/contact_stress"]
        assert stored.chunks[0] < stored.shape[0]
        slabs = -(-stored.shape[0] // stored.chunks[0])
        assert stored.chunks[0] * slabs < stored.shape[0] + slabs
        assert stored.id.get_storage_size() < 1.05 * f.contact_stress.nbytes
