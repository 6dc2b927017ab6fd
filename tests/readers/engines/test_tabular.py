"""Tables: CSV, Parquet and pandas give the scene of the same arrays, to the last bit."""

import gzip

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import xcg
from tests.dumps import write
from tests.scenes import random_steps
from xcg.readers.files.table import way_of_words


def tables_of(ds):
    """Particles and contacts of a scene as tables, a row a particle or contact and step."""
    rows = {"particle": [], "contact": []}
    for t in range(ds.sizes["time"]):
        step = ds.isel(time=t)
        for dim, key in (("particle", "particle_id"), ("contact", "contact_i")):
            there = step[key].values >= 0
            frame = {"time": np.full(there.sum(), step.time.item())}
            for name, values in step.data_vars.items():
                if values.dims == (dim,):
                    frame[name] = values.values[there]
                elif values.dims == (dim, "component"):
                    frame |= {f"{name}_{a}": values.values[there, k] for k, a in enumerate("xyz")}
            rows[dim].append(pd.DataFrame(frame))
    return [pd.concat(parts, ignore_index=True) for parts in rows.values()]


@pytest.fixture(scope="module")
def scene():
    ds = random_steps(3)
    return ds.drop_vars(["contact_normal", "overlap"], errors="ignore")


OPTIONS = {"box": [[0, 5.0]] * 3, "periodic": "xyz"}


def check(ds, scene):
    for name in scene.data_vars:
        np.testing.assert_array_equal(ds[name], scene[name], err_msg=name)
    np.testing.assert_array_equal(ds.time, scene.time)


@pytest.mark.parametrize(
    "ending", ["csv", "tsv", "csv.gz", "semicolon.csv", "blanks.csv", "parquet"]
)
def test_scenes_written_as_tables_read_back_equal(tmp_path, scene, ending):
    if ending == "parquet":
        pytest.importorskip("pyarrow")
    mark = {"tsv": "\t", "semicolon.csv": ";", "blanks.csv": " "}.get(ending, ",")
    paths = [tmp_path / f"{what}.{ending}" for what in ("particles", "contacts")]
    for path, table in zip(paths, tables_of(scene), strict=True):
        if ending == "parquet":
            table.to_parquet(path, row_group_size=50)
        else:
            table.to_csv(path, sep=mark, index=False)
    ds = xcg.open_scene(paths[0], contacts=paths[1], chunks=1, **OPTIONS)
    assert ds.attrs["engine"] == "table"
    assert ds.position.chunks[0] == (1, 1, 1)
    check(ds, scene)
    one = xr.open_dataset(paths[0], engine="xcg", **OPTIONS)
    np.testing.assert_array_equal(one.velocity[1], scene.velocity[1])


def test_tables_in_memory_give_an_equal_scene(scene):
    particles, contacts = tables_of(scene)
    shuffled = particles.sample(frac=1, random_state=0)
    check(xcg.scene_from_table(shuffled, contacts, **OPTIONS), scene)


def test_short_and_own_names_of_columns(tmp_path):
    text = "t, ID ,x,y,z,vx,vy,vz,r,charge\r\n0.0,3,1,1,1,0.1,0.2,0.3,0.5,7\r\n0.5,3,2,1,1,0.1,0.2,0.3,0.5,8\r\n"
    names = {"t": "time", "ID": "particle_id", "r": "radius", "charge": "charge"}
    ds = xcg.open_scene(write(tmp_path / "a.csv", text), names=names, density=2.0)
    np.testing.assert_array_equal(ds.time, [0, 0.5])
    np.testing.assert_array_equal(ds.charge[:, 0], [7, 8])
    np.testing.assert_array_equal(ds.diameter[:, 0], [1, 1])
    np.testing.assert_array_equal(ds.velocity[0, 0], [0.1, 0.2, 0.3])
    table = pd.read_csv(tmp_path / "a.csv", skipinitialspace=True).rename(columns=str.strip)
    check(xcg.scene_from_table(table, names=names, density=2.0), ds.load())


def test_steps_are_numbered_by_file_names(tmp_path):
    for step in (2, 10):
        write(tmp_path / f"p_{step}.csv", f"id,x,y,z,radius\n0,{step},0,0,0.5\n\n")
    ds = xcg.open_scene(str(tmp_path / "p_*.csv"), density=1.0, timestep=0.1)
    np.testing.assert_array_equal(ds.step, [2, 10])
    np.testing.assert_allclose(ds.time, [0.2, 1.0])
    np.testing.assert_array_equal(ds.position[:, 0, 0], [2, 10])
    for step in (2, 10):
        (tmp_path / f"p_{step}.csv").rename(tmp_path / f"p.csv.{step}")
    np.testing.assert_array_equal(
        xcg.open_scene(str(tmp_path / "p.csv.*"), engine="table", density=1.0).step, [2, 10]
    )


def test_files_without_numbers_are_steps_from_zero_on(tmp_path):
    names = ["one.csv", "two.csv"]
    for name in names:
        write(tmp_path / name, f"id,x,y,z,radius\n0,{len(name)},0,0,0.5\n1,1,0,0,0.5\n")
        write(tmp_path / f"contacts_of_{name}", "id1,id2,fx,fy,fz\n0,1,-1,0,0\n")
    for count in (1, 2):
        contacts = [tmp_path / f"contacts_of_{name}" for name in names[:count]]
        ds = xcg.open_scene(
            [tmp_path / name for name in names[:count]],
            contacts=contacts,
            density=1.0,
            timestep=0.5,
        )
        np.testing.assert_array_equal(ds.step, np.arange(count))
        np.testing.assert_array_equal(ds.time, 0.5 * np.arange(count))
        assert (ds.contact_force.isel(contact=0, component=0) == -1).all()


def test_one_file_of_each_kind_is_paired_whatever_their_names_count(tmp_path):
    particles = write(tmp_path / "p.3.csv", "id,x,y,z,radius\n0,0,0,0,0.5\n1,1,0,0,0.5\n")
    contacts = write(tmp_path / "c.12.csv", "id1,id2,fx,fy,fz\n0,1,-1,0,0\n")
    ds = xcg.open_scene(particles, contacts=contacts, density=1.0)
    assert ds.step.values.tolist() == [3]
    assert ds.contact_force.values.tolist() == [[[-1, 0, 0]]]
    stated = write(tmp_path / "stated.csv", "step,id1,id2,fx,fy,fz\n12,0,1,-1,0,0\n")
    assert (
        xcg.open_scene(particles, contacts=stated, density=1.0).sizes["contact"] == 1
    )  # one name counts
    both = write(tmp_path / "both.csv", "step,id,x,y,z,radius\n3,0,0,0,0,0.5\n3,1,1,0,0,0.5\n")
    for one, other in ((both, stated), (tmp_path / "p.*.csv", tmp_path / "c.*.csv")):
        with pytest.raises(xcg.SceneError, match="no step with the same step number"):
            xcg.open_scene(str(one), contacts=str(other), density=1.0)


def test_unnumbered_steps_at_fault_are_skipped(tmp_path):
    rows = ["0,1,0,0,0.5,1", "1,one,0,0,0.5,1", "2,1,0,0,0.5,1"]
    path = write(tmp_path / "a.csv", "time,x,y,z,radius,id\n" + "\n".join(rows))
    ds = xcg.open_scene(path, density=1.0, box=[[-1.0, 2.0]] * 3)
    with pytest.warns(
        xcg.SceneWarning, match=r"step 1 is skipped: .*a\.csv \(step 1\): row 0 has 'one'"
    ):
        f = ds.cg.coarse_grain("density", axes="z", on_error="skip").compute()
    assert f.skipped.values.tolist() == [False, True, False]


def test_one_step_is_read_alone(tmp_path, monkeypatch):
    rows = "".join(f"{k // 100},{k % 100},{k},0,0.5,{k % 100}\n" for k in range(1000))
    path = write(tmp_path / "a.csv", "step,x,y,z,radius,id\n" + rows)
    ds = xcg.open_scene(path, density=1.0, chunks=1)
    ds.isel(time=-1).load()  # it was read when the scene was opened
    read = []
    table = xcg.readers.files.table
    original = table.body_of
    monkeypatch.setattr(table, "body_of", lambda ref: read.append(ref.length) or original(ref))
    assert ds.position.isel(time=-1, particle=5).values.tolist() == [5, 905, 0]
    assert read == [sum(len(f"9,{k},{k + 900},0,0.5,{k}\n") for k in range(100))]


def test_particles_without_ids_are_numbered_by_row(tmp_path):
    ds = xcg.open_scene(
        write(tmp_path / "a.csv", "x,y,z,radius\n5,0,0,0.5\n1,0,0,0.5\n"), density=1.0
    )
    np.testing.assert_array_equal(ds.particle_id[0], [0, 1])
    np.testing.assert_array_equal(ds.position[0, :, 0], [5, 1])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1,2,3\n4,5,6\n", "expected a first line that names each column once"),
        ("x,y,x\n1,2,3\n", "'x' twice"),
        ("x,y,z,radius\n1,2,3,0.5\n1,2,3\n", "row 1 has 3 values, expected 4"),
        ("x,y,z,radius\n1,2,,0.5\n", "row 0 has 3 values, expected 4"),
        ("x,y,z,radius\n1,2,three,0.5\n", "row 0 has 'three' in column 'z'"),
        (
            "time,x,y,z,radius\n0,1,2,3,0.5\n1,1,2,3,0.5\n0,1,2,3,0.5\n",
            "rows of the time 0.0 stand apart",
        ),
        ("time,x,y,z,radius\n0,1,2,3,0.5\n-,1,2,3,0.5\n", "row 1 has '-' in column 'time'"),
        ("step,x,y,z,radius\n0.5,1,2,3,0.5\n", "the step of row 0"),
        ("a,b,c\n1,2,3\n", "no x of the position"),
        ("", "expected a first line"),
    ],
)
def test_damaged_tables_raise(tmp_path, text, message):
    path = write(tmp_path / "a.csv", text)
    with pytest.raises(xcg.SceneError, match=message) as error:
        xcg.open_scene(path, density=1.0).load()
    assert "a.csv" in str(error.value)


def test_wrong_tables_in_memory_raise():
    good = pd.DataFrame({"id": [0], "x": 0.0, "y": 0.0, "z": 0.0, "radius": 0.5})
    with pytest.raises(
        xcg.SceneError, match="particles: column 'x' holds other things than numbers"
    ):
        xcg.scene_from_table(good.assign(x="a"), density=1.0)
    with pytest.raises(xcg.SceneError, match=r"particles .*no x of the position"):
        xcg.scene_from_table(good.drop(columns=["x", "y"]), density=1.0)
    contacts = {"time": [1.0], "contact_i": 0, "contact_j": 1, "fx": 0.0, "fy": 0.0, "fz": 0.0}
    with pytest.raises(xcg.SceneError, match=r"contacts: rows of 1\.0, and no particles"):
        xcg.scene_from_table(good.assign(time=0.0), contacts=contacts, density=1.0)
    with pytest.raises(xcg.SceneError, match="particles: the table has no rows"):
        xcg.scene_from_table(good[:0], density=1.0)
    with pytest.raises(xcg.SceneError, match="contacts: the table has no columns"):
        xcg.scene_from_table(good, contacts=pd.DataFrame(), density=1.0)


@pytest.mark.parametrize("name", ["time", "diameter", "particle_id", "mass", "position"])
def test_arguments_do_not_repeat_columns(name):
    table = pd.DataFrame(
        {"time": [1.0, 2.0], "id": 3, "x": 0.0, "y": 0.0, "z": 0.0, "radius": 0.5, "mass": 1.0}
    )
    with pytest.raises(
        xcg.SceneError, match=f"{name}= is given, and the tables hold '{name}', too"
    ):
        xcg.scene_from_table(table, **{name: [[7.0], [7.0]]})
    options = {name: None, "density": 5.0, "velocity": [[[1.0, 0, 0]]] * 2}
    with pytest.warns(xcg.SceneWarning, match="density=5 is not used"):
        ds = xcg.scene_from_table(table, **options)
    assert (ds.mass == 1).all()
    assert (ds.velocity[:, :, 0] == 1).all()


def test_a_wrong_step_is_named_by_its_row_in_the_table():
    table = pd.DataFrame({"step": [3.0, 2.0, 1.5], "id": 1, "x": 0.0, "y": 0.0, "radius": 0.5})
    with pytest.raises(xcg.SceneError, match=r"particles: the step of row 2 is 1\.5"):
        xcg.scene_from_table(table, density=1.0)


def test_columns_that_are_not_read_are_listed_whatever_the_table(tmp_path):
    table = pd.DataFrame(
        {
            "x": [0.0, 1.0],
            "position_x": [7.0, 8.0],
            "y": 0.0,
            "z": 0.0,
            "radius": 0.5,
            "diameter": 1.0,
        }
    )
    table = table.assign(id=[3, 4], particle_id=[5, 6], type=1, species=2)
    contacts = pd.DataFrame({"id1": [5], "id2": [6], "fx": [1.0], "fy": 0.0, "fz": 0.0, "age": 3.0})
    paths = [tmp_path / "p.csv", tmp_path / "c.csv"]
    for path, rows in zip(paths, (table, contacts), strict=True):
        rows.to_csv(path, index=False)
    ignored = "particles: position_x, id, type\ncontacts: age"
    with pytest.warns(xcg.SceneWarning) as caught:
        ds = xcg.open_scene(paths[0], contacts=paths[1], density=1.0)
    assert ds.attrs["not_read"] == ignored
    messages = [str(warning.message) for warning in caught]
    assert "both 'x' and 'position_x' may be 'position_x'" in messages[0]
    assert "both 'particle_id' and 'id' may be 'particle_id'" in messages[0]
    assert "both 'species' and 'type' may be 'species'" in messages[0]
    assert len(messages) == 1
    with pytest.warns(xcg.SceneWarning) as caught:
        ds = xcg.scene_from_table(table, contacts=contacts, density=1.0)
    assert ds.attrs["not_read"] == ignored
    assert [str(warning.message).partition(": ")[2] for warning in caught] == [
        message.partition(": ")[2] for message in messages
    ]
    with pytest.raises(
        xcg.SceneError, match=r"particles.*: diameter 3 of row 1 is not 2 times radius 0\.5"
    ):
        xcg.scene_from_table(table.assign(diameter=[1.0, 3.0]), density=1.0)


@pytest.mark.parametrize("forces", [["fx", "fy", "fz"], ["normal_force", "tangential_force"]])
def test_a_table_of_no_contacts_is_a_scene_in_which_nothing_touches(forces):
    grains = pd.DataFrame(
        {"time": [1.0, 1.0, 2.0], "id": [0, 1, 0], "x": [0.0, 1.0, 0.5], "y": 0.0, "z": 0.0}
    ).assign(radius=0.5)
    contacts = pd.DataFrame(columns=["time", "contact_i", "contact_j", *forces], dtype=float)
    ds = xcg.scene_from_table(grains, contacts=contacts, density=1.0, box=[[-1.0, 2.0]] * 3)
    assert (ds.contact_i < 0).all()
    assert (ds.cg.coarse_grain("contact_stress", axes="z").contact_stress == 0).all()


def test_steps_without_rows_of_contacts_are_named():
    grains = pd.DataFrame(
        {"time": [1.0, 1.0, 2.0, 2.0], "id": [0, 1] * 2, "x": [0.0, 1.0] * 2, "y": 0.0, "z": 0.0}
    ).assign(radius=0.5)
    contacts = pd.DataFrame({"time": [1.0], "id1": 0, "id2": 1, "fx": -1.0, "fy": 0.0, "fz": 0.0})
    with pytest.warns(
        xcg.SceneWarning, match=r"no rows for 1 of 2 steps of the particles, such as 2, and nothing"
    ):
        ds = xcg.scene_from_table(grains, contacts=contacts, density=1.0)
    np.testing.assert_array_equal(ds.contact_i, [[0], [-1]])


def test_parquet_without_pyarrow_names_the_extra(tmp_path, monkeypatch):
    import importlib

    def no_pyarrow(name, *rest):
        if name.startswith("pyarrow"):
            raise ImportError(name)
        return original(name, *rest)

    original = importlib.import_module
    monkeypatch.setattr("xcg.readers.files.table.importlib.import_module", no_pyarrow)
    (tmp_path / "a.parquet").write_bytes(b"PAR1")
    with pytest.raises(xcg.SceneError, match=r"pip install 'xcg\[parquet\]'"):
        xcg.open_scene(tmp_path / "a.parquet")


def test_damaged_parquet_files_raise(tmp_path):
    pytest.importorskip("pyarrow")
    good = pd.DataFrame({"x": [0.0, 1.0], "y": 0.0, "z": 0.0, "radius": 0.5})
    for table, message in (
        (good.assign(x=["a", "b"]), "column 'x' holds"),
        (good.assign(x=[0.0, None]), "row 1 has no value in column 'x'|not finite"),
    ):
        table.to_parquet(tmp_path / "a.parquet")
        with pytest.raises(xcg.SceneError, match=message) as error:
            xcg.open_scene(tmp_path / "a.parquet", density=1.0).load()
        assert "a.parquet" in str(error.value)
    (tmp_path / "a.parquet").write_bytes((tmp_path / "a.parquet").read_bytes()[:-10])
    with pytest.raises(xcg.SceneError, match="cannot be read as Parquet") as error:
        xcg.open_scene(tmp_path / "a.parquet", density=1.0)
    assert "a.parquet" in str(error.value)


def test_compressed_text_of_two_steps_is_read(tmp_path, scene):
    particles, _ = tables_of(scene)
    data = particles.to_csv(index=False).encode()
    (tmp_path / "p.csv.gz").write_bytes(gzip.compress(data))
    check(
        xcg.open_scene(tmp_path / "p.csv.gz", **OPTIONS),
        scene[[n for n in scene if "contact" not in scene[n].dims]],
    )


def test_empty_cells_and_names_of_columns_raise(tmp_path):
    shifted = write(
        tmp_path / "a.csv", "id,x,y,z,radius,note\n1,0,0,0,0.5,7\n2,0.5,,0.9,0.05,1,5\n"
    )
    with pytest.raises(
        xcg.SceneError, match=r"1 more ',' than 6 columns have.*every cell must hold a number"
    ):
        xcg.open_scene(shifted, density=1.0)
    short = write(tmp_path / "s.csv", "id,x,y,z,radius\n1,0,0,0,0.5\n2,0.5,,0.9,0.05\n")
    with pytest.raises(
        xcg.SceneError, match=r"row 1 has 4 values, expected 5 .*; the columns are id x y z radius"
    ):
        xcg.open_scene(short, density=1.0)
    named = write(tmp_path / "b.csv", "ID,x,y,z,radius\n1,0,0,0,0.5\n")
    with pytest.raises(
        xcg.SceneError, match=r"'id'}: that is a column; its variable is 'particle_id'"
    ):
        xcg.open_scene(named, density=1.0, names={"ID": "id"})
    unknown = write(tmp_path / "c.csv", "East X,North Y,Up Z,radius\n0,0,0,0.5\n")
    with pytest.raises(
        xcg.SceneError, match=r"names={'East X': 'position_x', 'North Y': 'position_y'"
    ):
        xcg.open_scene(unknown, density=1.0)


@pytest.mark.parametrize("form", [dict, np.ndarray])
def test_vectors_of_mappings_and_structured_arrays_are_columns_by_component(form):
    kinds = [("id", "i8"), ("position", "f8", 3), ("velocity", "f8", 3), ("radius", "f8")]
    rows = np.zeros(4, kinds)
    rng = np.random.default_rng(1)
    rows["id"] = [3, 0, 2, 1]
    rows["position"], rows["velocity"] = rng.random((2, 4, 3))
    rows["radius"] = 0.1
    table = rows
    if form is dict:
        table = {name: rows[name] for name in rows.dtype.names}
    ds = xcg.scene_from_table(table, density=1.0)
    order = np.argsort(rows["id"])
    np.testing.assert_array_equal(ds.position[0], rows["position"][order])
    np.testing.assert_array_equal(ds.velocity[0], rows["velocity"][order])


def test_mappings_hold_labelled_vectors_beside_lists_of_any_length():
    places = np.random.default_rng(1).random((2, 3))
    of_rows = {"id": [0, 1], "radius": 0.1, "neighbour_ids": [[1], [0, 1]]}
    for position in (xr.DataArray(places, dims=("row", "axis")), places.tolist()):
        ds = xcg.scene_from_table({**of_rows, "position": position}, density=1.0)
        np.testing.assert_array_equal(ds.position[0], places)


def test_two_columns_of_one_name_raise():
    table = pd.DataFrame(
        [[0, 0.0, 1.0, 0.0, 0.1, 0.2]], columns=["id", "x", "y", "z", "radius", "x"]
    )
    with pytest.raises(xcg.SceneError, match="particles: two columns are called 'x'"):
        xcg.scene_from_table(table, density=1.0)


@pytest.mark.parametrize("key", ["units", "unit"])
def test_units_in_the_metadata_of_parquet_are_read(tmp_path, key):
    pa = pytest.importorskip("pyarrow")
    units = dict.fromkeys("xyz", "mm") | dict.fromkeys(("vx", "vy", "vz"), "cm/s")
    units |= {"time": "ms", "radius": "um", "id": "1"}
    values = {name: np.arange(2.0) + 1 for name in units}
    values["time"] = np.array([5.0, 5.0])
    fields = [pa.field(name, pa.float64(), metadata={key: units[name]}) for name in units]
    table = pa.table([*values.values()], schema=pa.schema(fields))
    path = str(tmp_path / "grains.parquet")
    pytest.importorskip("pyarrow.parquet").write_table(table, path)
    ds = xcg.open_scene(path, density=1.0)
    np.testing.assert_allclose(ds.position[0], [[1e-3] * 3, [2e-3] * 3])
    np.testing.assert_allclose(ds.diameter[0], [2e-6, 4e-6])
    np.testing.assert_allclose(ds.velocity[0, :, 0], [1e-2, 2e-2])
    assert ds.time.values.tolist() == [5e-3]
    with pytest.raises(xcg.SceneError, match=r"unknown column 'vx'; did you mean 'vx \[cm/s\]'\?"):
        xcg.open_scene(path, density=1.0, names={"vx": None})
    given = xcg.open_scene(path, density=1.0, units={"length": 1.0, "time": 1.0})
    assert given.position[0, 0].values.tolist() == [1.0, 1.0, 1.0]


def test_metadata_of_parquet_that_are_no_text_are_no_unit(tmp_path):
    pa = pytest.importorskip("pyarrow")
    fields = [
        pa.field(name, pa.float64(), metadata={"units": b"\xff\xfe"}) for name in ("x", "y", "z")
    ]
    table = pa.table([np.arange(2.0)] * 3, schema=pa.schema(fields))
    path = str(tmp_path / "grains.parquet")
    pytest.importorskip("pyarrow.parquet").write_table(table, path)
    assert xcg.open_scene(path).position.values.tolist() == [[[0.0] * 3, [1.0] * 3]]


def test_fields_of_structs_in_parquet_are_columns(tmp_path):
    pa = pytest.importorskip("pyarrow")
    places = np.random.default_rng(1).random((4, 3))
    vectors = [dict(zip("xyz", row, strict=True)) for row in places.tolist()]
    parts = {"id": np.arange(4), "velocity": vectors, "position": vectors, "radius": np.ones(4)}
    table = pa.table({**parts, "extra.x": np.zeros(4)})
    path = str(tmp_path / "grains.parquet")
    pytest.importorskip("pyarrow.parquet").write_table(table, path, row_group_size=3)
    ds = xcg.open_scene(path, density=1.0, names={"extra.x": "charge"})
    np.testing.assert_array_equal(ds.position[0], places)
    np.testing.assert_array_equal(ds.velocity[0], places)
    np.testing.assert_array_equal(ds.charge[0], 0.0)


@pytest.mark.parametrize("kind", ["list", "large_list", "fixed"])
def test_lists_in_parquet_are_vectors(tmp_path, kind):
    pa = pytest.importorskip("pyarrow")
    places = np.random.default_rng(1).random((4, 3))
    types = {
        "list": pa.list_(pa.float64()),
        "large_list": pa.large_list(pa.float64()),
        "fixed": pa.list_(pa.float64(), 3),
    }
    lists = {"position": places, "velocity": places[::-1], "neighbours": places}
    columns = {name: pa.array(rows.tolist(), types[kind]) for name, rows in lists.items()}
    table = pa.table({"id": np.arange(4), **columns, "radius": np.ones(4)})
    fields = [
        field.with_metadata({"units": "mm"}) for field in table.schema if field.name == "position"
    ]
    schema = table.schema.set(1, fields[0])
    path = str(tmp_path / "grains.parquet")
    pytest.importorskip("pyarrow.parquet").write_table(table.cast(schema), path, row_group_size=3)
    ds = xcg.open_scene(path, density=1.0)
    np.testing.assert_allclose(ds.position[0], places * 1e-3, rtol=1e-15)
    np.testing.assert_array_equal(ds.velocity[0], places[::-1])


@pytest.mark.parametrize("kind", [list, tuple, np.array])
def test_lists_in_cells_of_tables_are_vectors(kind):
    places = np.random.default_rng(1).random((4, 3))
    cells = [kind(row) for row in places.tolist()]
    others = [[1], [2, 3], [], [4]]
    table = pd.DataFrame({"position": cells, "neighbours": others, "radius": 0.1}, [4, 3, 2, 1])
    ds = xcg.scene_from_table(table.rename_axis("id"), density=1.0)
    np.testing.assert_array_equal(ds.position[0], places[::-1])


@pytest.mark.parametrize("kind", ["csv", "parquet", "memory"])
def test_species_that_are_words_name_two_ways(tmp_path, kind):
    table = pd.DataFrame({"x": [0.0, 1.0], "y": 0.0, "z": 0.0, "radius": 0.1, "type": ["b", "a"]})
    path = tmp_path / f"grains.{kind}"
    source, read = path, xcg.open_scene
    if kind == "memory":
        source, read = table, xcg.scene_from_table
    else:
        getattr(table, f"to_{kind}")(path, index=False)
    with pytest.raises(
        xcg.SceneError, match=r"'type'.* names=\{'type': None\}.*factorize"
    ) as error:
        read(source, density=1.0).load()
    assert "factorize" not in way_of_words("id1")  # numbers of ids would be those of other grains
    call = str(error.value).partition("table of pandas, ")[2].partition(", for ")[0]
    exec(call, {"table": table, "pandas": pd})
    assert xcg.scene_from_table(table, density=1.0).species.values.tolist() == [[1, 0]]


def test_variables_of_datasets_are_columns_with_units():
    places = np.random.default_rng(1).random((2, 4))
    per_step = xr.DataArray(places, dims=("time", "grain"), attrs={"units": "mm"})
    columns = {"x": per_step, "y": 2 * per_step, "z": 3 * per_step}
    columns = {name: values.assign_attrs(units="mm") for name, values in columns.items()}
    columns["radius"] = ("grain", [5.0] * 4, {"units": "um"})
    columns["id"] = ("grain", [4, 3, 2, 1], {"units": "1"})
    table = xr.Dataset(columns, {"time": ("time", [1.0, 2.0], {"units": "ms"})})
    ds = xcg.scene_from_table(table, density=1.0)
    expected = places[:, ::-1, None] * [1e-3, 2e-3, 3e-3]
    np.testing.assert_allclose(ds.position, expected, rtol=1e-15)
    np.testing.assert_allclose(ds.diameter, 1e-5, rtol=1e-15)
    np.testing.assert_allclose(ds.time, [1e-3, 2e-3], rtol=1e-15)
    table.x.attrs["units"] = "furlong"
    with pytest.raises(xcg.SceneError, match=r"x \[furlong\]"):
        xcg.scene_from_table(table, density=1.0)
