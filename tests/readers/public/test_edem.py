"""Several types of particles below one time, as in the files that EDEM writes, one a step."""

import h5py
import numpy as np
import pytest

import xcg

BASE = "/TimestepData/{time}/ParticleTypes/*"
MAPPING = {
    "position": f"{BASE}/position",
    "velocity": f"{BASE}/velocity",
    "particle_id": f"{BASE}/ids",
    "species": BASE,
}
COUNTS = {"0": 3, "2": 2, "10": 1}


def write(folder, counts=COUNTS):
    for k, time in enumerate(("0.05", "0.1")):
        with h5py.File(folder / f"{k}.h5", "w") as file:
            first = 0
            for name, count in counts.items():
                group = file.create_group(f"TimestepData/{time}/ParticleTypes/{name}")
                ids = first + np.arange(count)
                group["ids"] = ids
                group["position"] = ids[:, None] + np.array([0.0, 0.1, 0.2]) + 10 * k
                group["velocity"] = np.full((count, 3), float(len(name)))
                first += count
            file.create_group(f"TimestepData/{time}/ParticleTypes/1")  # without particles
    return str(folder / "*.h5")


def test_types_are_joined_in_the_order_of_their_numbers(tmp_path):
    ds = xcg.open_scene(write(tmp_path), mapping=MAPPING, density=1.0).load()
    assert ds.time.values.tolist() == [0.05, 0.1]
    assert ds.particle_id.values.tolist() == [[0, 1, 2, 3, 4, 5]] * 2
    assert ds.species.values.tolist() == [[0, 0, 0, 2, 2, 10]] * 2
    np.testing.assert_array_equal(ds.position[..., 0], [np.arange(6), 10 + np.arange(6)])
    assert ds.velocity[0, :, 2].values.tolist() == [1, 1, 1, 1, 1, 2]


def test_types_with_names_are_numbered_in_their_order(tmp_path):
    ds = xcg.open_scene(write(tmp_path, {"sand": 1, "clay": 2}), mapping=MAPPING)
    assert ds.species.values.tolist() == [[2, 1, 1]] * 2


def test_types_along_stacks_of_steps_are_joined(tmp_path):
    with h5py.File(tmp_path / "run.h5", "w") as file:
        for name, count in (("a", 2), ("b", 3)):
            file[f"types/{name}/x"] = np.full((4, count, 3), float(count))
            file[f"types/{name}/r"] = np.full(count, 0.1 * count)
    mapping = {"position": "types/*/x", "radius": "types/*/r", "species": "types/*"}
    with pytest.warns(xcg.SceneWarning, match="no column of particle ids"):
        ds = xcg.open_scene(tmp_path / "run.h5", mapping=mapping)
    assert ds.position[3, :, 0].values.tolist() == [2, 2, 3, 3, 3]
    np.testing.assert_allclose(ds.diameter[1], [0.4, 0.4, 0.6, 0.6, 0.6])
    assert ds.species.values.tolist() == [[1, 1, 2, 2, 2]] * 4


def test_a_file_without_mapping_is_listed(tmp_path):
    paths = write(tmp_path)
    with pytest.raises(
        xcg.SceneError, match=r"holds /TimestepData/0\.05/ParticleTypes/0/ids \(3,\)"
    ):
        xcg.open_scene(paths)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"radius": f"{BASE}/r"}, r"none of the members of .* \(0, 1, 2, 10\) has 'r'"),
        ({"species": "/TimestepData/*"}, "'/TimestepData/\\*' is no group of the positions"),
        ({"position": "/Other/*/position"}, "no group '/Other'"),
    ],
)
def test_wrong_paths_are_named(tmp_path, change, message):
    with pytest.raises(xcg.SceneError, match=message):
        xcg.open_scene(write(tmp_path), mapping=MAPPING | change)


def test_types_that_lack_a_variable_are_refused(tmp_path):
    paths = write(tmp_path)
    with h5py.File(tmp_path / "0.h5", "r+") as file:
        del file["TimestepData/0.05/ParticleTypes/2/velocity"]
    with pytest.raises(xcg.SceneError, match="different numbers of rows"):
        xcg.open_scene(paths, mapping=MAPPING)
