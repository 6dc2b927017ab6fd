"""NetCDF files of LAMMPS."""

import math

import numpy as np
import pytest

import xcg
from tests.lammps_forms import COLUMNS, DEFAULTS, check, frames_of, lammps, rows_of, write_netcdf
from xcg.readers.engines.lammps_netcdf import ClassicFile


@pytest.mark.parametrize("version", ["DATA", "OFFSET"])
def test_netcdf_holds_the_rows_of_each_step(tmp_path, version):
    steps = {10 * k: rows_of(7, seed=k) for k in range(3)}
    path = write_netcdf(tmp_path / "n.nc", steps, version=version)
    refs, frames = frames_of(path)
    edges = ((0.0, 10.0), (0.0, 10.0), (-math.inf, math.inf))
    assert [(ref.step, ref.time, ref.units, ref.box, ref.periodic) for ref in refs] == [
        (step, 0.5 * step, "si", edges, "xy") for step in steps
    ]
    for frame, rows in zip(frames, steps.values(), strict=True):
        check(frame, rows)


def test_the_header_of_netcdf_equals_that_of_the_library(tmp_path):
    import netCDF4

    path = write_netcdf(
        tmp_path / "n.nc", {0: rows_of(5), 10: rows_of(5, seed=1)}, extra=np.ones((5, 2))
    )
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

    values = {"odd": np.arange(9, dtype="i1").reshape(3, 3)} | (
        {"real": np.arange(3.0)} if several else {}
    )
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


def test_variables_beyond_what_a_file_can_hold_raise(tmp_path):
    path = write_netcdf(tmp_path / "n.nc", {0: rows_of()})
    ours = ClassicFile(str(path))
    begin = ours.variables["cell_origin"].begin.to_bytes(8, "big")
    data = path.read_bytes()
    assert data.count(begin) == 1  # offsets of 64 bits
    path.write_bytes(data.replace(begin, b"\xff" * 8))
    with pytest.raises(
        xcg.SceneError, match="'cell_origin' at byte 18446744073709551615, and is damaged"
    ):
        ClassicFile(str(path))


def test_columns_of_netcdf_have_the_names_of_text(tmp_path):
    path = write_netcdf(tmp_path / "n.nc", {0: rows_of()}, extra=np.arange(6.0).reshape(3, 2))
    (ref,) = lammps.index_particles([str(path)], DEFAULTS)
    assert set(ref.columns) == {*COLUMNS, "c_own[1]", "c_own[2]"}
    ds = xcg.open_scene(path, names={"c_own[2]": "heat"})
    order = np.argsort(rows_of()[:, 0])
    np.testing.assert_array_equal(ds.heat.values[0], np.array([1.0, 3.0, 5.0])[order])


def test_lost_atoms_are_left_out(tmp_path):
    whole = rows_of(4)
    some = rows_of(4)
    some[2:] = np.nan
    _, frames = frames_of(write_netcdf(tmp_path / "n.nc", {0: whole, 10: some}))
    check(frames[0], whole)
    check(frames[1], some[:2])
    assert xcg.open_scene(tmp_path / "n.nc").particle_id.values[1].tolist().count(-1) == 2


def test_single_precision_without_timestep_is_read(tmp_path):
    rows = rows_of()
    path = write_netcdf(tmp_path / "n.nc", {0: rows, 20: rows}, double=False, timestep=None)
    refs, frames = frames_of(path)
    assert [ref.time for ref in refs] == [None, None]
    np.testing.assert_array_equal(frames[0]["position"], rows[:, 2:5].astype("f4"))
    np.testing.assert_allclose(xcg.open_scene(path, timestep=0.5).time, [0, 10])


def test_times_that_are_no_numbers_of_steps_raise(tmp_path):
    """They were rounded to steps, which have no times."""
    path = write_netcdf(tmp_path / "n.nc", {0.0: rows_of(), 1.5: rows_of()}, timestep=None)
    with pytest.raises(xcg.SceneError, match=r"n\.nc.* time 1\.5 in record 1 and no scale_factor"):
        frames_of(path)


def test_a_tilted_netcdf_box(tmp_path):
    """Lengths and angles of a lattice give the lattice back."""
    lattice = np.array([[10.0, 0, 0], [2, 9, 0], [-1, 1.5, 8]])
    lengths = np.linalg.norm(lattice, axis=1)
    cosine = [
        lattice[i] @ lattice[j] / lengths[i] / lengths[j] for i, j in ((1, 2), (0, 2), (0, 1))
    ]
    path = write_netcdf(
        tmp_path / "n.nc", {0: rows_of()}, lengths=lengths, angles=np.degrees(np.arccos(cosine))
    )
    (ref,), _ = frames_of(path)
    np.testing.assert_allclose(ref.lattice, lattice, atol=1e-13)
    np.testing.assert_allclose(ref.box, [[0, 10], [0, 9], [-1, 7]], atol=1e-13)
    assert ref.periodic == "xyz"


def test_damaged_netcdf_raises(tmp_path):
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
