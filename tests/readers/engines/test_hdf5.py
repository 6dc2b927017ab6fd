"""HDF5 by mapping: groups, stacks and files as steps give the scene of the same arrays."""

import h5py
import numpy as np
import pytest

import xcg
from tests.scenes import random_steps

OPTIONS = {"box": [[0, 5.0]] * 3, "periodic": "xyz", "engine": "hdf5"}
VARIABLES = ("particle_id", "position", "velocity", "diameter", "density", "species",
             "contact_i", "contact_j", "contact_force", "contact_point")  # fmt: skip


def rows_of(scene, name, t):
    key = "particle_id" if "particle" in scene[name].dims else "contact_i"
    return scene[name].values[t][scene[key].values[t] >= 0]


@pytest.fixture(scope="module")
def scene():
    return random_steps(3)


def check(ds, scene, names=VARIABLES):
    for name in names:
        np.testing.assert_array_equal(ds[name], scene[name], err_msg=name)


@pytest.mark.parametrize("place", ["{time}", "{step}"])
def test_one_group_per_step(tmp_path, scene, place):
    path = tmp_path / "run.h5"
    with h5py.File(path, "w") as file:
        for t, time in enumerate(scene.time.values):
            group = file.create_group(f"data/Step{time if place == '{time}' else 100 * t}")
            group.attrs["now"] = time
            for name in VARIABLES:
                group.create_dataset(
                    f"own/{name}", data=rows_of(scene, name, t), compression="gzip"
                )
        file["data/notes"] = 1.0
    mapping = {name: f"/data/Step{place}/own/{name}" for name in VARIABLES}
    if place == "{step}":
        mapping["time"] = "/data/Step{step}@now"
    ds = xcg.open_scene(path, contacts=path, mapping=mapping, chunks=1, **OPTIONS)
    assert ds.position.chunks[0] == (1, 1, 1)
    np.testing.assert_array_equal(ds.time, scene.time)
    assert ds.step.values.tolist() == [0, 1, 2] if place == "{time}" else [0, 100, 200]
    check(ds, scene)
    found = xcg.open_scene(path, mapping=mapping, box=OPTIONS["box"], periodic="xyz")  # by its name
    check(found, scene, ["position"])


def test_steps_along_the_first_dimension(tmp_path, scene):
    """As H5MD has them."""
    n = min(len(rows_of(scene, "position", t)) for t in range(3))
    with h5py.File(tmp_path / "run.h5", "w") as file:
        for name in ("position", "velocity", "diameter"):
            file[f"particles/all/{name}/value"] = np.stack(
                [rows_of(scene, name, t)[:n] for t in range(3)]
            )
        file["particles/all/position/time"] = [0.5, 1.0, 1.5]
    mapping = {name: f"particles/all/{name}/value" for name in ("position", "velocity", "diameter")}
    with pytest.warns(xcg.SceneWarning, match="no column of particle ids.*mapping="):
        ds = xcg.open_scene(
            tmp_path / "run.h5",
            mapping=mapping | {"time": "particles/all/position/time"},
            density=1.0,
            **OPTIONS,
        )
    np.testing.assert_array_equal(ds.time, [0.5, 1.0, 1.5])
    np.testing.assert_array_equal(
        ds.velocity, np.stack([rows_of(scene, "velocity", t)[:n] for t in range(3)])
    )


def test_one_file_per_step_with_own_names(tmp_path, scene):
    for t in range(3):
        with h5py.File(tmp_path / f"run_{t}.h5", "w") as file:
            x = rows_of(scene, "position", t)
            file["x"], file["y"], file["z"], file["r"], file["q"] = (
                *x.T,
                rows_of(scene, "diameter", t) / 2,
                x[:, 0],
            )
            file["now"] = scene.time.values[t]
    mapping = {
        "position_x": "x",
        "position_y": "y",
        "position_z": "z",
        "radius": "r",
        "charge": "q",
        "time": "now",
    }
    with pytest.warns(xcg.SceneWarning, match="no column of particle ids"):
        ds = xcg.open_scene(str(tmp_path / "run_*.h5"), mapping=mapping, density=1.0, **OPTIONS)
    np.testing.assert_array_equal(ds.time, scene.time)
    check(ds, scene, ["position", "diameter"])
    np.testing.assert_array_equal(ds.charge, ds.position[..., 0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({}, "needs to be told"),
        ({"position": "/a/{step}/{time}"}, "at most one"),
        ({"positon": "/S{step}/x"}, "did you mean 'position'"),
        ({"velocity": "/S{step}/x"}, "mapping= lacks 'position'"),
        ({"position": "/T{step}/x"}, "no name like 'T{step}' in '/', which holds S0"),
        ({"position": "/S{step}/y"}, "no dataset '/S0/y'; '/S0' holds n, wide, words, x"),
        ({"position": "/S{step}/words"}, "expected numbers"),
        (
            {"position": "/S{step}/wide"},
            r"has the shape \(2, 5\), expected \(n\), \(n, 2\) or \(n, 3\) for 'position'",
        ),
        (
            {"position": "/S{step}/x", "radius": "/S{step}/x"},
            r"shape \(2, 3\), expected \(n\) for 'radius'",
        ),
        (
            {"position": "/many", "radius": "/S0/wide"},
            r"'/S0/wide' has the shape \(2, 5\), expected \(steps, n\) for 'radius'",
        ),
        ({"position": "/S{step}/x", "diameter": "/S{step}/n"}, "different numbers of rows"),
    ],
)
def test_damaged_files_raise(tmp_path, change, message):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["many"] = np.ones((4, 3, 3))
        file["S0/x"], file["S0/n"], file["S0/wide"], file["S0/words"] = (
            np.ones((2, 3)),
            np.ones(3),
            np.ones((2, 5)),
            "a",
        )
    with pytest.raises(xcg.SceneError, match=message) as error:
        xcg.open_scene(tmp_path / "a.h5", mapping=change, engine="hdf5")
    assert "a.h5" in str(error.value) or "mapping" in str(error.value)


def test_files_that_are_not_hdf5_raise(tmp_path):
    (tmp_path / "a.h5").write_bytes(b"nothing")
    with pytest.raises(xcg.SceneError, match=r"a\.h5: cannot be read as HDF5"):
        xcg.open_scene(tmp_path / "a.h5", mapping={"position": "x"}, engine="hdf5")


def test_a_dataset_larger_than_its_file_raises(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("x", (1 << 40, 3), "f8", chunks=(1 << 10, 3))
    with pytest.raises(xcg.SceneError, match=r"a\.h5: 'x' promises .* bytes, and 0 are stored"):
        xcg.open_scene(tmp_path / "a.h5", mapping={"position": "x"}, engine="hdf5")


@pytest.mark.parametrize(
    ("named", "lacking"),
    [
        ({"position_x": "x"}, "position_y and position_z"),
        ({"position_x": "x", "position_y": "y", "velocity_x": "x"}, "velocity_y"),
        (
            {"position_x": "x", "position_y": "y", "position_z": "y", "velocity_y": "x"},
            "velocity_x and velocity_z",
        ),
    ],
)
def test_components_that_a_mapping_lacks_are_named_with_that_argument(tmp_path, named, lacking):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["x"] = np.arange(3.0)
        file["y"] = np.arange(3.0)
    with pytest.raises(xcg.SceneError, match=rf"mapping= lacks {lacking}, .*mapping=\{{") as caught:
        xcg.open_scene(tmp_path / "a.h5", mapping=named)
    assert "names=" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "offer"),
    [
        ({"contact_force": None}, r"mapping=\{..., 'contact_force': '...'\}"),
        ({"contact_j": None}, r"mapping=\{..., 'contact_j': '...'\}"),
        ({"tangential_force": "/ft"}, "call the first 'normal_force' there"),
    ],
)
def test_mappings_of_contacts_are_offered_by_mapping(tmp_path, change, offer):
    arrays = {
        "x": [[0, 0, 0], [0.99, 0, 0]], "id": [1, 2], "i": [1], "j": [2], "f": [[-7.0, 0, 0]], "ft": [[0, 0, 1.0]],
    }  # fmt: skip
    path = tmp_path / "s.h5"
    with h5py.File(path, "w") as file:
        for name, values in arrays.items():
            file[name] = values
    mapping = {
        "position": "/x", "particle_id": "/id", "contact_i": "/i", "contact_j": "/j", "contact_force": "/f",
    } | change  # fmt: skip
    mapping = {name: place for name, place in mapping.items() if place}
    with pytest.raises(xcg.SceneError, match=offer) as error:
        xcg.open_scene(path, contacts=path, mapping=mapping)
    assert "names=" not in str(error.value)


@pytest.mark.parametrize("text", ["furlong", "kg"])
def test_units_of_datasets_that_are_not_of_the_variable_raise(tmp_path, text):
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["position"] = [[100.0, 200.0, 300.0]]
        file["radius"] = [0.05]
        file["position"].attrs["units"] = text
    options = {"mapping": {key: f"/{key}" for key in ("position", "radius")}, "density": 1.0}
    with pytest.raises(xcg.SceneError, match=f"'/position' has the unit '{text}'"):
        xcg.open_scene(tmp_path / "run.h5", **options).load()
    ds = xcg.open_scene(tmp_path / "run.h5", units="si", **options)
    np.testing.assert_array_equal(ds.position[0, 0], [100, 200, 300])


@pytest.mark.parametrize("name", ["units", "unit"])
@pytest.mark.parametrize("text", ["mm", np.bytes_("mm"), np.array(["mm"], object)])
def test_units_of_datasets_are_converted(tmp_path, name, text):
    with h5py.File(tmp_path / "run.h5", "w") as file:
        for step in (1, 2):
            group = file.create_group(f"step{step}")
            group["position"] = [[100.0, 200.0, 300.0]]
            group["radius"] = [0.05]
            group["velocity"] = [[1.0, 0.0, 0.0]]
            group["charge"] = [3.0]
            group["time"] = 500.0 * step
            group["position"].attrs[name] = text
            group["velocity"].attrs[name] = "cm/s"
            group["radius"].attrs[name] = "m"
            group["charge"].attrs[name] = "a word"
            group["time"].attrs[name] = "ms"
    names = ("position", "radius", "velocity", "charge", "time")
    options = {"mapping": {key: f"/step{{step}}/{key}" for key in names}, "density": 1.0}
    options["mapping"]["particle_id"] = "/step{step}/charge"
    ds = xcg.open_scene(tmp_path / "run.h5", **options)
    np.testing.assert_allclose(ds.position[0, 0], [0.1, 0.2, 0.3], rtol=1e-15)
    np.testing.assert_allclose(ds.velocity[0, 0], [0.01, 0, 0], rtol=1e-15)
    assert ds.diameter[0, 0] == 0.1
    assert ds.charge[0, 0] == 3.0
    np.testing.assert_allclose(ds.time, [0.5, 1.0], rtol=1e-15)
    ds = xcg.open_scene(tmp_path / "run.h5", units="si", **options)
    np.testing.assert_array_equal(ds.position[0, 0], [100, 200, 300])
    assert ds.time.values.tolist() == [500.0, 1000.0]
