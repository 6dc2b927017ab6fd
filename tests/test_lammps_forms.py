"""LAMMPS dumps that are no text: binary ones, and NetCDF."""

import math

import numpy as np
import pytest
import xarray as xr

import xcg
from tests import real_data
from tests.dumps import dump_text, pairs_text, write
from tests.lammps_forms import BOX, COLUMNS, binary_step, rows_of, write_netcdf
from xcg.readers.engine import ReadOptions
from xcg.readers.engines.lammps import Lammps
from xcg.readers.files.classic_netcdf import ClassicFile

lammps = Lammps()
DEFAULTS = ReadOptions()


def frames_of(path):
    refs = lammps.index_particles([str(path)], DEFAULTS)
    return refs, [lammps.read_particles(ref, DEFAULTS) for ref in refs]


def check(frame, rows):
    np.testing.assert_array_equal(frame["particle_id"], rows[:, 0])
    np.testing.assert_array_equal(frame["position"], rows[:, 2:5])
    np.testing.assert_array_equal(frame["velocity"], rows[:, 5:8])
    np.testing.assert_array_equal(frame["diameter"], 2 * rows[:, 8])
    np.testing.assert_array_equal(frame["mass"], rows[:, 9])


# --- binary ----------------------------------------------------------------------------------------------


def test_a_binary_dump_is_the_text_that_lammps_writes_beside_it():
    """Both by LAMMPS 22Jul2025, the text with all digits."""
    folder, walls = real_data("lammps_binary"), {"floor": "f_floor[*]"}
    text, binary = (xcg.open_scene(folder / f"particles.{end}", walls=walls) for end in ("dump.gz", "bin"))
    xr.testing.assert_identical(binary.drop_attrs(deep=False).compute(), text.drop_attrs(deep=False).compute())
    assert binary.sizes["time"] == 2
    assert binary.attrs["periodic"] == "xy"
    assert (binary.contact_j.values[0] == -2).any()


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("parts", [1, 3])
@pytest.mark.parametrize("word", [b"DUMPCUSTOM", b"DUMPATOM"])
def test_orders_of_bytes_and_processes(tmp_path, order, parts, word):
    steps = [rows_of(7, seed=k) for k in range(3)]
    data = [binary_step(rows, step=10 * k, time=0.5 * k, units="" if k else "cgs", order=order, parts=parts, word=word)
            for k, rows in enumerate(steps)]  # fmt: skip
    (tmp_path / "p.bin").write_bytes(b"".join(data))
    refs, frames = frames_of(tmp_path / "p.bin")
    assert [(ref.step, ref.time, ref.units, ref.box, ref.periodic) for ref in refs] == [
        (10 * k, 0.5 * k, "cgs", BOX, "xy") for k in range(3)
    ]
    for frame, rows in zip(frames, steps, strict=True):
        check(frame, rows)


def test_a_tilted_box_is_that_of_the_text(tmp_path):
    tilts = (2.0, 0.5, -0.25)
    (tmp_path / "p.bin").write_bytes(binary_step(rows_of(), tilts=tilts))
    bounds = [f"{low} {high} {tilt}" for (low, high), tilt in zip(BOX, tilts, strict=True)]
    lines = "\n".join(["ITEM: BOX BOUNDS xy xz yz pp pp ff", *bounds, ""])
    text = write(tmp_path / "p.dump", dump_text(box=lines))
    (binary,), (of_text,) = (lammps.index_particles([str(p)], DEFAULTS) for p in (tmp_path / "p.bin", text))
    assert (binary.box, binary.lattice, binary.periodic) == (of_text.box, of_text.lattice, of_text.periodic)


def test_binary_particles_with_contacts_in_text_are_lazy(tmp_path):
    rows = np.array([[1, 1, 1, 1, 1, 0, 0, 0, 0.5, 1], [2, 1, 1.9, 1, 1, 0, 0, 0, 0.5, 1]])
    for step in (0, 10):
        (tmp_path / f"p.{step}.bin").write_bytes(binary_step(rows, step=step, time=step / 10))
        write(tmp_path / f"c.{step}.dump", pairs_text(step=step, before=f"ITEM: TIME\n{step / 10}\n"))
    ds = xcg.open_scene(str(tmp_path / "p.*.bin"), contacts=str(tmp_path / "c.*.dump"), chunks=1)
    assert ds.position.chunks[0] == (1, 1)
    np.testing.assert_array_equal(ds.contact_force.values[:, 0], [[-9, 1, 0]] * 2)
    xr.testing.assert_identical(
        xr.open_dataset(str(tmp_path / "p.10.bin"), engine="xcg").position.load(),
        ds.position.isel(time=[1]).compute().drop_attrs(deep=False).assign_attrs(ds.position.attrs),
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: data[:-8], "followed by a block of 30 values"),
        (lambda data: data[:60], "is cut off"),
        (lambda data: data.replace(b"radius", b"mass  "), "names id type x"),
        (lambda data: data + b"\0" * 8, "does not begin with"),
        (lambda data: data[:34] + (2**40).to_bytes(8, "little") + data[42:], "promises 1099511627776 rows"),
        (lambda data: data.replace(b"\x01\0\0\0\x02\0\0\0", b"\x01\0\0\0\x09\0\0\0", 1), "is of revision 9"),
    ],
)
def test_damaged_binary_dumps(tmp_path, change, message):
    path = tmp_path / "p.bin"
    path.write_bytes(change(binary_step(rows_of())))
    with pytest.raises(xcg.SceneError, match=message) as error:
        frames_of(path)
    assert "p.bin" in str(error.value)


def test_a_binary_dump_holds_no_contacts(tmp_path):
    (tmp_path / "p.bin").write_bytes(binary_step(rows_of()))
    with pytest.raises(xcg.SceneError, match=r"p\.bin: .* for particles="):
        lammps.index_contacts([str(tmp_path / "p.bin")], DEFAULTS)


# --- NetCDF ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("version", ["DATA", "OFFSET"])
def test_netcdf(tmp_path, version):
    steps = {10 * k: rows_of(7, seed=k) for k in range(3)}
    path = write_netcdf(tmp_path / "n.nc", steps, version=version)
    refs, frames = frames_of(path)
    edges = ((0.0, 10.0), (0.0, 10.0), (-math.inf, math.inf))
    assert [(ref.step, ref.time, ref.units, ref.box, ref.periodic) for ref in refs] == [
        (step, 0.5 * step, "si", edges, "xy") for step in steps
    ]
    for frame, rows in zip(frames, steps.values(), strict=True):
        check(frame, rows)


def test_the_header_of_netcdf_is_that_of_the_library(tmp_path):
    import netCDF4

    path = write_netcdf(tmp_path / "n.nc", {0: rows_of(5), 10: rows_of(5, seed=1)}, extra=np.ones((5, 2)))
    ours = ClassicFile(str(path))
    with netCDF4.Dataset(path) as file:
        file.set_auto_maskandscale(False)
        assert set(ours.variables) == set(file.variables)
        for name, variable in file.variables.items():
            for record in range(2 if ours.variables[name].recorded else 1):
                expected = variable[record] if ours.variables[name].recorded else variable[:]
                np.testing.assert_array_equal(ours.read(name, record), expected)


@pytest.mark.parametrize("several", [True, False])
def test_records_of_odd_length_are_padded_unless_they_are_alone(tmp_path, several):
    import netCDF4

    values = {"odd": np.arange(9, dtype="i1").reshape(3, 3)} | ({"real": np.arange(3.0)} if several else {})
    with netCDF4.Dataset(tmp_path / "n.nc", "w", format="NETCDF3_64BIT_OFFSET") as file:
        file.createDimension("frame", None)
        file.createDimension("three", 3)
        for name, given in values.items():
            file.createVariable(name, given.dtype, ("frame", "three")[: given.ndim])[:] = given
    ours = ClassicFile(str(tmp_path / "n.nc"))
    assert ours.records == 3
    for name, given in values.items():
        for record in range(3):
            np.testing.assert_array_equal(ours.read(name, record), given[record])


def test_columns_of_netcdf_have_the_names_of_text(tmp_path):
    path = write_netcdf(tmp_path / "n.nc", {0: rows_of()}, extra=np.arange(6.0).reshape(3, 2))
    (ref,) = lammps.index_particles([str(path)], DEFAULTS)
    assert set(ref.columns) == {*COLUMNS, "c_own[1]", "c_own[2]"}
    ds = xcg.open_scene(path, names={"c_own[2]": "heat"})
    order = np.argsort(rows_of()[:, 0])
    np.testing.assert_array_equal(ds.heat.values[0], np.array([1.0, 3.0, 5.0])[order])


def test_lost_atoms_are_left_out(tmp_path):
    whole, some = rows_of(4), rows_of(4)
    some[2:] = np.nan
    _, frames = frames_of(write_netcdf(tmp_path / "n.nc", {0: whole, 10: some}))
    check(frames[0], whole)
    check(frames[1], some[:2])
    assert xcg.open_scene(tmp_path / "n.nc").particle_id.values[1].tolist().count(-1) == 2


def test_single_precision_and_no_timestep(tmp_path):
    rows = rows_of()
    path = write_netcdf(tmp_path / "n.nc", {0: rows, 20: rows}, double=False, timestep=None)
    refs, frames = frames_of(path)
    assert [ref.time for ref in refs] == [None, None]
    np.testing.assert_array_equal(frames[0]["position"], rows[:, 2:5].astype("f4"))
    np.testing.assert_allclose(xcg.open_scene(path, timestep=0.5).time, [0, 10])


def test_a_tilted_netcdf_box(tmp_path):
    """Lengths and angles of a lattice give the lattice back."""
    lattice = np.array([[10.0, 0, 0], [2, 9, 0], [-1, 1.5, 8]])
    lengths = np.linalg.norm(lattice, axis=1)
    cosine = [lattice[i] @ lattice[j] / lengths[i] / lengths[j] for i, j in ((1, 2), (0, 2), (0, 1))]
    path = write_netcdf(tmp_path / "n.nc", {0: rows_of()}, lengths=lengths, angles=np.degrees(np.arccos(cosine)))
    (ref,), _ = frames_of(path)
    np.testing.assert_allclose(ref.lattice, lattice, atol=1e-13)
    np.testing.assert_allclose(ref.box, [[0, 10], [0, 9], [-1, 7]], atol=1e-13)
    assert ref.periodic == "xyz"


def test_damaged_netcdf(tmp_path):
    path = write_netcdf(tmp_path / "n.nc", {0: rows_of(100), 10: rows_of(100)})
    whole = path.read_bytes()
    for data, message in (
        (whole[:-200], "promises 2 records, and has room for 1"),
        (whole[:100], "ends in its header"),
        (whole.replace(b"cell_angles", b"cell_angle_"), "lacks cell_angles"),
        (whole[:4] + b"\xff" * 4 + whole[8:], "records"),
    ):
        path.write_bytes(data)
        with pytest.raises(xcg.SceneError, match=message) as error:
            frames_of(path)
        assert "n.nc" in str(error.value)
