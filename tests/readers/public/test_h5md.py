"""H5MD: elements that change in time or not, boxes, and groups of particles."""

import h5py
import numpy as np
import pytest

import xcg

STEPS, ROWS = 3, 4
POSITION = np.random.default_rng(0).uniform(0, 1, (STEPS, ROWS, 3))
IDS = np.array([5, 4, 3, 2])
BY_ID = np.argsort(IDS)


def write(
    path, *, groups=("all",), boundary=("periodic", "periodic", "none"), edges=(1.0, 2.0, 3.0)
):
    """Positions and velocities in time; ids, masses, diameters and species that do not change."""
    with h5py.File(path, "w") as file:
        file.create_group("h5md").attrs["version"] = [1, 1]
        for name in groups:
            group = file.create_group(f"particles/{name}")
            group["position/value"] = POSITION
            group["position/step"] = [0, 10, 20]
            group["position/time"] = [0.0, 0.1, 0.2]
            group["velocity/value"] = 2 * POSITION
            group["velocity/step"] = group["position/step"]
            group["id"] = IDS
            group["mass"] = [1.0, 2, 3, 4]
            group["diameter"] = [0.1] * ROWS
            species = h5py.enum_dtype({"glass": 1, "steel": 2})
            group.create_dataset("species", data=[1, 2, 1, 2], dtype=species)
            box = group.create_group("box")
            box.attrs["dimension"] = 3
            box.attrs["boundary"] = np.array(boundary, "S")
            if edges is not None:
                box["edges"] = edges
    return path


def edit(path, change):
    with h5py.File(path, "r+") as file:
        change(file["particles/all"])


@pytest.mark.parametrize("name", ["run.h5", "run.h5md", "run.hdf5"])
def test_elements_are_read_whether_they_change_or_not(tmp_path, name):
    ds = xcg.open_scene(write(tmp_path / name)).load()
    assert ds.engine == "h5md"
    assert ds.time.values.tolist() == [0.0, 0.1, 0.2]
    assert ds.step.values.tolist() == [0, 10, 20]
    assert ds.particle_id.values.tolist() == [[2, 3, 4, 5]] * STEPS
    np.testing.assert_array_equal(ds.position, POSITION[:, BY_ID])
    np.testing.assert_array_equal(ds.velocity, 2 * POSITION[:, BY_ID])
    assert ds.mass.values.tolist() == [[4, 3, 2, 1]] * STEPS
    assert ds.species.values.tolist() == [[2, 1, 2, 1]] * STEPS


def test_without_ids_the_place_in_the_datasets_is_the_id(tmp_path):
    path = write(tmp_path / "run.h5")
    edit(path, lambda group: group.pop("id"))
    ds = xcg.open_scene(path)
    assert ds.particle_id.values.tolist() == [[0, 1, 2, 3]] * STEPS
    np.testing.assert_array_equal(ds.position, POSITION)


def test_steps_and_times_may_be_increments(tmp_path):
    def change(group):
        for name in ("step", "time"):
            del group[f"position/{name}"]
        group["position/step"] = 100
        group["position/step"].attrs["offset"] = 50
        group["position/time"] = 0.5
        del group["velocity/step"]
        group["velocity/step"] = [50, 150, 250]

    path = write(tmp_path / "run.h5")
    edit(path, change)
    ds = xcg.open_scene(path)
    assert ds.step.values.tolist() == [50, 150, 250]
    assert ds.time.values.tolist() == [0.0, 0.5, 1.0]
    assert "velocity" in ds


def test_elements_at_more_steps_are_taken_at_those_of_positions(tmp_path):
    def change(group):
        del group["velocity"]
        group["velocity/value"] = np.stack([k + 0 * POSITION[0] for k in range(5)])
        group["velocity/step"] = [0, 5, 10, 15, 20]

    path = write(tmp_path / "run.h5")
    edit(path, change)
    assert xcg.open_scene(path).velocity[:, 0, 0].values.tolist() == [0, 2, 4]


def test_elements_at_fewer_steps_are_named(tmp_path):
    def change(group):
        del group["velocity"]
        group["velocity/value"] = POSITION[:2]
        group["velocity/step"] = [0, 20]

    path = write(tmp_path / "run.h5")
    edit(path, change)
    with pytest.warns(
        xcg.SceneWarning, match="velocity of '/particles/all' are not there at each step"
    ):
        assert "velocity" not in xcg.open_scene(path)


@pytest.mark.parametrize(
    ("boundary", "periodic", "box"),
    [
        (("periodic", "periodic", "none"), "xy", [[0, 1], [0, 2], [-np.inf, np.inf]]),
        (("periodic",) * 3, "xyz", [[0, 1], [0, 2], [0, 3]]),
        (("none", "periodic", "none"), "y", [[-np.inf, np.inf], [0, 2], [-np.inf, np.inf]]),
    ],
)
def test_edges_count_along_periodic_axes(tmp_path, boundary, periodic, box):
    ds = xcg.open_scene(write(tmp_path / "run.h5", boundary=boundary))
    assert ds.periodic == periodic
    np.testing.assert_array_equal(ds.box, [box] * STEPS)


def test_an_open_box_needs_no_edges(tmp_path):
    ds = xcg.open_scene(write(tmp_path / "run.h5", boundary=("none",) * 3, edges=None))
    assert ds.periodic == ""
    assert "box" not in ds


def test_triclinic_edges_are_rows_of_the_lattice(tmp_path):
    cell = [[1, 0, 0], [0.2, 2, 0], [0.1, 0.3, 3.0]]
    ds = xcg.open_scene(write(tmp_path / "run.h5", boundary=("periodic",) * 3, edges=cell))
    np.testing.assert_array_equal(ds.lattice, [cell] * STEPS)


def test_edges_may_change_in_time(tmp_path):
    edges = np.array([[1.0, 2, 3], [1, 2.5, 3], [2, 2, 2]])

    def change(group):
        group["box/edges/value"] = edges
        group["box/edges/step"] = group["position/step"]

    path = write(tmp_path / "run.h5", boundary=("periodic",) * 3, edges=None)
    edit(path, change)
    np.testing.assert_array_equal(xcg.open_scene(path).box[..., 1], edges)


def test_particles_with_the_fill_value_as_id_do_not_exist(tmp_path):
    def change(group):
        del group["id"]
        ids = group.create_dataset("id/value", (STEPS, ROWS), "i4", fillvalue=-9)
        ids[:] = [[1, 2, 3, 4], [1, 2, 3, -9], [4, 2, -9, -9]]
        group["id/step"] = group["position/step"]

    path = write(tmp_path / "run.h5")
    edit(path, change)
    ds = xcg.open_scene(path)
    assert ds.particle_id.values.tolist() == [[1, 2, 3, 4], [1, 2, 3, -1], [2, 4, -1, -1]]
    np.testing.assert_array_equal(ds.position[2, :2], POSITION[2, [1, 0]])


def test_positions_that_do_not_change_are_one_step(tmp_path):
    def change(group):
        del group["position"], group["velocity"]
        group["position"] = POSITION[0]

    path = write(tmp_path / "run.h5")
    edit(path, change)
    np.testing.assert_array_equal(xcg.open_scene(path).position, POSITION[:1, BY_ID])


def test_two_dimensional_positions_lie_in_a_plane(tmp_path):
    def change(group):
        del group["position/value"], group["velocity"], group["box/edges"]
        group["position/value"] = POSITION[..., :2]
        group["box/edges"] = [1.0, 2.0]
        group["box"].attrs["boundary"] = np.array(["periodic", "none"], "S")

    path = write(tmp_path / "run.h5")
    edit(path, change)
    ds = xcg.open_scene(path, thickness=0.1)
    assert (ds.plane, ds.periodic, ds.dimension) == ("xy", "x", 2)
    np.testing.assert_array_equal(ds.position[..., :2], POSITION[:, BY_ID, :2])


def test_several_groups_are_opened_one_by_one(tmp_path):
    path = write(tmp_path / "run.h5", groups=("grains", "wall"))
    with pytest.raises(xcg.SceneError, match="grains, wall; open one, group='grains'"):
        xcg.open_scene(path)
    np.testing.assert_array_equal(xcg.open_scene(path, group="wall").position, POSITION[:, BY_ID])
    with pytest.raises(xcg.SceneError, match="unknown group 'walls'; did you mean 'wall'"):
        xcg.open_scene(path, group="walls")


def test_other_units_than_si_need_factors(tmp_path):
    def change(group):
        group["position/value"].attrs["unit"] = "mm"

    path = write(tmp_path / "run.h5")
    edit(path, change)
    with pytest.raises(xcg.SceneError, match=r"'mm of position'.*give the factors to SI"):
        xcg.open_scene(path)
    ds = xcg.open_scene(path, units={"length": 1e-3})
    np.testing.assert_allclose(ds.position, 1e-3 * POSITION[:, BY_ID], rtol=1e-15)


def _boundary(group):
    group["box"].attrs["boundary"] = np.array(["open"] * 3, "S")


def _no_edges(group):
    del group["box/edges"]


def _fewer_steps(group):
    del group["position/step"]
    group["position/step"] = [0, 10]


def _no_position(group):
    del group["position"]


def _words(group):
    del group["species"]
    group["species"] = np.array(["a", "b", "c", "d"], "S1")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_boundary, "expected 3 of 'none' and 'periodic'"),
        (
            _no_edges,
            r"edges of the box have the shape None at this step, expected \(3,\) or \(3, 3\)",
        ),
        (_fewer_steps, r"'/particles/all/position/step' has the shape \(2,\), expected 3"),
        (_no_position, "no group of particles with a position"),
        (_words, r"'/particles/all/species' holds \|S1, expected numbers"),
    ],
)
def test_damaged_files_raise(tmp_path, change, message):
    path = write(tmp_path / "run.h5")
    edit(path, change)
    with pytest.raises(xcg.SceneError, match=rf"run\.h5.*{message}"):
        xcg.open_scene(path)


def test_a_mapping_reads_what_does_not_change_beside_stacks(tmp_path):
    path = write(tmp_path / "run.h5")
    places = {
        "position": "position/value",
        "velocity": "velocity/value",
        "particle_id": "id",
        "mass": "mass",
        "species": "species",
        "time": "position/time",
    }
    mapping = {name: f"/particles/all/{place}" for name, place in places.items()}
    ds = xcg.open_scene(path, mapping=mapping, box=[[0, 3.0]] * 3)
    assert ds.engine == "hdf5"
    assert ds.mass.values.tolist() == [[4, 3, 2, 1]] * STEPS
    np.testing.assert_array_equal(ds.velocity, 2 * POSITION[:, BY_ID])


def test_a_damaged_tree_of_groups_is_refused_by_name(tmp_path):
    path = write(tmp_path / "run.h5")
    content = bytearray(path.read_bytes())
    content[content.index(b"SNOD")] = 0
    path.write_bytes(content)
    with pytest.raises(xcg.SceneError, match=r"run\.h5"):
        xcg.open_scene(path)
