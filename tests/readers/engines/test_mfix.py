from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import xcg
from tests import real_data
from xcg.common.messages import SceneError, SceneWarning
from xcg.readers.engine import ReadOptions
from xcg.readers.engines.mfix import Mfix
from xcg.readers.files import vtkheader, vtp
from xcg.readers.report import warn_of_columns
from xcg.scene.lattice import minimum_image

mfix = Mfix()

DEFAULTS = ReadOptions()
PERIOD = np.array([0.04, np.inf, 0.02])  # of the real chute


# --- small files of our own ------------------------------------------------------------------------------


def write_vtp(path: Path, points, time=0.5, shape="", shapes=None, **arrays) -> Path:
    """Write a file as MFiX does: big-endian, appended raw, Float32, the time in a comment, shapes of SuperDEM."""
    shapes = shapes or ({shape: [1.0]} if shape else {})
    listed = "".join(
        f'<DataArray type="Float32" Name="{name}">  {" ".join(map(str, numbers))}</DataArray>\n'
        for name, numbers in shapes.items()
    )
    blocks = {"coordinates": np.reshape(points, (-1, 3)), **arrays}
    count = len(blocks["coordinates"])
    tags = []
    body = b""
    for name, values in blocks.items():
        data = np.asarray(values, ">f4").tobytes()
        components = np.shape(values)[1] if np.ndim(values) == 2 else 1
        tags.append(
            f'<DataArray type="Float32" Name="{name}"  NumberOfComponents="{components}" format="appended" '
            f'offset="  {len(body)} " />'
        )
        body += np.array(len(data), ">u4").tobytes() + data
    header = (
        f'<?xml version="1.0"?>\n <!-- Time =  {time}       sec. -->\n'
        '<VTKFile type="PolyData" version="0.1" byte_order="BigEndian">\n<PolyData>\n'
        + (f"<FieldData>\n{listed}</FieldData>\n" if listed else "")
        + f'<Piece NumberOfPoints="   {count} " NumberOfVerts="  0 " NumberOfLines ="0" NumberOfStrips="0" '
        f'NumberOfPolys="0" >\n<Points>\n{tags[0]}\n</Points>\n<PointData Scalars="Diameter">\n'
        + "\n".join(tags[1:])
        + '\n</PointData>\n<Verts> </Verts>\n</Piece>\n</PolyData>\n<AppendedData encoding="raw">\n _'
    )
    path.write_bytes(header.encode() + body + b"\n</AppendedData>\n</VTKFile>\n")
    return path


def write_particles(path: Path, ids=(3, 1, 2), **more) -> Path:
    points = np.arange(3.0 * len(ids)).reshape(-1, 3)
    return write_vtp(path, points, Particle_ID=list(ids), Diameter=np.ones(len(ids)), **more)


def write_contacts(path: Path, i, j, force, point=None, **more) -> Path:
    force = np.asarray(force, float).reshape(-1, 3)
    point = np.zeros((len(i), 3)) if point is None else point
    ids = {"FORCE_CHAIN_GLOBAL_ID1": i, "FORCE_CHAIN_GLOBAL_ID2": j}
    return write_vtp(path, point, **ids, FORCE_CHAIN_FC=force, **more)


def write_pvd(path: Path, files: dict[str, str]) -> Path:
    entries = "".join(
        f'<DataSet timestep="{t}" group="1" part="0" file="{f}"/>\n' for f, t in files.items()
    )
    path.write_text(
        f'<?xml version="1.0"?>\n<VTKFile type="Collection">\n<Collection>\n{entries}</Collection></VTKFile>'
    )
    return path


def read_particles(path: Path, options=DEFAULTS):
    (ref,) = mfix.index_particles([str(path)], options)
    return mfix.read_particles(ref, options)


def read_contacts(path: Path, options=DEFAULTS):
    (ref,) = mfix.index_contacts([str(path)], options)
    frame = mfix.read_contacts(ref, options)
    assert set(frame) - {"point_is_middle", "row_of_file"} == set(
        mfix.contact_variables(ref, options)
    )
    return frame


OLD_ASCII = """<?xml version="1.0"?>
<!-- Time =  0.2500000000000000E+00s -->
<VTKFile type="PolyData" version="0.1" byte_order="LittleEndian">
<PolyData>
<Piece NumberOfPoints="0000000002" NumberOfVerts="0" NumberOfLines="0" NumberOfStrips="0" NumberOfPolys="0">
<Points>
<DataArray type="Float32" Name="Position" NumberOfComponents="3" format="ascii">
  0.000000E+00   1.000000E+00   2.000000E+00   3.000000E+00   4.000000E+00   5.000000E+00</DataArray>
</Points>
<PointData Scalars="Diameter" Vectors="Velocity">
<DataArray type="Float32" Name="Diameter" format="ascii">
  2.500000E-01   5.000000E-01</DataArray>
<DataArray type="Float32" Name="ID" format="ascii">
         7          9</DataArray>
</PointData>
<CellData></CellData>
<Verts></Verts>
</Piece>
</PolyData>
</VTKFile>
"""


# --- index -----------------------------------------------------------------------------------------------


def test_the_index_holds_the_header(tmp_path):
    path = write_particles(tmp_path / "P_0042.vtp", time=0.40000344388050202)
    (ref,) = mfix.index_particles([str(path)], DEFAULTS)
    assert (ref.rows, ref.time, ref.step) == (3, 0.40000344388050202, 42)
    assert ref.columns == ("coordinates", "Particle_ID", "Diameter")
    assert ref.size == path.stat().st_size


def test_header_longer_than_one_read(tmp_path):
    many = {f"user_scalar_with_a_long_name_{n:04d}": np.full(3, n) for n in range(300)}
    path = write_particles(tmp_path / "P_1.vtp", **many)
    options = ReadOptions(names={"user_scalar_with_a_long_name_0299": "temperature"})
    np.testing.assert_array_equal(read_particles(path, options)["temperature"], 299)


@pytest.mark.parametrize(
    ("name", "expected"), [("P.vtp", True), ("P.pvd", True), ("P.dump", False)]
)
def test_files_of_mfix_are_recognised(tmp_path, name, expected):
    path = write_particles(tmp_path / name.replace("pvd", "vtp"))
    if name == "P.pvd":
        path = write_pvd(tmp_path / name, {"P.vtp": "0.5"})
    assert mfix.recognises(str(path)) is expected
    path.write_text("ITEM: TIMESTEP\n")
    assert not mfix.recognises(str(path))


def test_missing_files_of_a_collection_are_no_steps_without_contacts(tmp_path):
    for t in range(2):
        write_particles(tmp_path / f"P_{t}.vtp", time=t)
    write_contacts(tmp_path / "F_0.vtp", [1], [2], [1.0, 0, 0], time=0)
    times = dict.fromkeys("01")
    pvd = [
        write_pvd(tmp_path / f"{kind}.pvd", {f"{kind}_{t}.vtp": t for t in times}) for kind in "PF"
    ]
    options = {"contacts": pvd[1], "density": 1.0, "periodic": ""}
    with pytest.raises(SceneError, match=r"1 of 2 files do not exist: .*F_1\.vtp"):
        xcg.open_scene(pvd[0], missing="empty", **options)
    with pytest.raises(
        SceneError, match=r"F_1\.vtp.*missing='empty' its step would count as one without contacts"
    ):
        xcg.open_scene(pvd[0], missing="empty", on_error="skip", **options)
    with pytest.warns(SceneWarning) as said:
        ds = xcg.open_scene(pvd[0], on_error="skip", **options)
    assert any("F_1.vtp; they are skipped" in str(warning.message) for warning in said)
    assert ds.time.values.tolist() == [0]
    assert ds.attrs["skipped_files"].count("F_1.vtp") == 1


def test_a_collection_names_or_skips_all_missing_files(tmp_path):
    write_particles(tmp_path / "P_0001.vtp", time=0.1000025)
    pvd = write_pvd(
        tmp_path / "P.pvd",
        {"P_0000.vtp": " 0.0E+00", "P_0001.vtp": " 0.1E+00", "P_0002.vtp": " 0.2E+00"},
    )
    with pytest.raises(
        SceneError,
        match=r"2 of 3 files do not exist: .*P_0000\.vtp, .*P_0002\.vtp; .*missing='skip'",
    ):
        mfix.index_particles([str(pvd)], DEFAULTS)
    skip = ReadOptions(extra={"missing": "skip"})
    with pytest.warns(SceneWarning, match=r"P_0000\.vtp, .*P_0002\.vtp; they are skipped"):
        (ref,) = mfix.index_particles([str(pvd)], skip)
    assert ref.path == str(tmp_path / "P_0001.vtp")
    assert ref.time == 0.1  # the list and the file disagree: the list counts
    (tmp_path / "P_0001.vtp").unlink()
    with pytest.raises(SceneError, match="3 of 3 files"):
        mfix.index_particles([str(pvd)], skip)


def test_times_of_a_list_have_fewer_digits_than_those_of_the_files(tmp_path):
    write_particles(tmp_path / "P_1.vtp", time=0.40000344388050202)
    pvd = write_pvd(tmp_path / "P.pvd", {"P_1.vtp": " 0.4000034E+00"})
    assert mfix.index_particles([str(pvd)], DEFAULTS)[0].time == 0.40000344388050202


def test_last_frame_written_twice_counts_once(tmp_path):
    paths = [
        str(write_particles(tmp_path / f"P_{n}.vtp", time=t))
        for n, t in ((1, 0.1), (2, 0.2), (3, 0.2))
    ]
    assert [ref.step for ref in mfix.index_particles(paths, DEFAULTS)] == [1, 2]
    pvd = write_pvd(tmp_path / "P.pvd", {"P_1.vtp": "0.1", "P_2.vtp": "0.2", "P_4.vtp": "0.2"})
    assert [ref.step for ref in mfix.index_particles([str(pvd)], DEFAULTS)] == [1, 2]


def test_the_later_of_two_files_of_one_time_is_read_with_a_warning(tmp_path):
    """Also where both have equally many bytes."""
    paths = [
        write_particles(tmp_path / f"P_{n}.vtp", ids) for n, ids in ((1, (1, 2, 3)), (2, (3, 5, 6)))
    ]
    listed = write_pvd(tmp_path / "P.pvd", {"P_1.vtp": "0.5", "P_2.vtp": "0.5"})
    for given in (paths, listed):
        with pytest.warns(
            SceneWarning, match=r"P_1\.vtp .*is left out, as .*P_2\.vtp .*has its time"
        ):
            ds = xcg.open_scene(given, density=1.0)
        np.testing.assert_array_equal(ds.particle_id, [[3, 5, 6]])


def test_parts_of_one_time_are_one_step_and_share_no_ids(tmp_path):
    for n in (1, 2):
        write_particles(tmp_path / f"P_{n}.vtp", [3 * n, 3 * n + 1])
    listed = write_pvd(tmp_path / "P.pvd", {"P_1.vtp": "0.5", "P_2.vtp": "0.5"})
    listed.write_text(listed.read_text().replace('part="0" file="P_2', 'part="1" file="P_2'))
    ds = xcg.open_scene(listed, density=1.0)
    np.testing.assert_array_equal(ds.particle_id, [[3, 4, 6, 7]])
    write_particles(tmp_path / "P_2.vtp", [4, 5])
    with pytest.raises(SceneError, match=r"P_1\.vtp.*4"):
        xcg.open_scene(listed, density=1.0)


def test_two_regions_raise(tmp_path):
    paths = [str(write_particles(tmp_path / f"{region}_0001.vtp")) for region in ("P_FB1", "P_FB2")]
    with pytest.raises(SceneError, match="different regions; open one"):
        mfix.index_particles(paths, DEFAULTS)


# --- particles -------------------------------------------------------------------------------------------


def test_particles_by_their_names_in_the_scene(tmp_path):
    frame = read_particles(
        write_particles(
            tmp_path / "P_1.vtp", Velocity=np.eye(3), Density=[1, 2, 3], Mass=[4, 5, 6], Volume=[7, 8, 9],
            Particle_Phase_ID=[1, 1, 2], Coordination=[0, 3, 4], Residence_Time=[0, 0, 0],
        )
    )  # fmt: skip
    assert set(frame) == {
        "position", "particle_id", "diameter", "velocity", "density", "mass", "volume", "species",
        "coordination_number",
    }  # fmt: skip
    assert all(values.dtype == "float64" for values in frame.values())
    np.testing.assert_array_equal(frame["position"], np.arange(9.0).reshape(3, 3))
    np.testing.assert_array_equal(frame["velocity"], np.eye(3))
    np.testing.assert_array_equal(frame["particle_id"], [3, 1, 2])
    np.testing.assert_array_equal(frame["species"], [1, 1, 2])


def test_half_axes_of_superquadrics_are_those_of_the_phase_times_the_scale(tmp_path):
    shapes = {"SQP_01": [0.3, 0.2, 0.1, 2.0, 2.0], "SQP_02": [0.5, 0.6, 0.7, 4.0, 4.0]}
    turn = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    given = {"Particle_Phase_ID": [2, 1, 2], "SQP_POLY_SCALE": [1.0, 2.0, 0.5]}
    path = write_particles(tmp_path / "a_1.vtp", shapes=shapes, QUATERNION=turn, **given)
    frame = read_particles(path)
    np.testing.assert_allclose(frame["half_axis_x"], [0.5, 0.6, 0.25], rtol=1e-6)
    np.testing.assert_allclose(frame["half_axis_z"], [0.7, 0.2, 0.35], rtol=1e-6)
    np.testing.assert_array_equal(frame["exponent_2"], [4, 2, 4])
    np.testing.assert_array_equal(frame["quat_z"], turn[:, 3])


def test_names_add_replace_and_drop(tmp_path):
    path = write_particles(tmp_path / "P_1.vtp", Temperature=[10, 20, 30], Diameter_2=[2, 2, 2])
    names = {"Temperature": "temperature", "Diameter_2": "diameter", "Other_ID": "contact_i"}
    frame = read_particles(path, ReadOptions(names=names))
    np.testing.assert_array_equal(frame["temperature"], [10, 20, 30])
    np.testing.assert_array_equal(frame["diameter"], 2)
    dropping = ReadOptions(names={"Diameter": None})
    assert "diameter" not in read_particles(path, dropping)
    (ref,) = mfix.index_particles([str(path)], dropping)
    with pytest.warns(SceneWarning, match=r"'Diameter_2' \(diameter\?\) resemble"):
        warn_of_columns(mfix, ref, dropping, contacts=False)
    with pytest.raises(
        SceneError, match=r"maps \['Temp'\], which are not in this file; it holds \['coordinates'"
    ):
        read_particles(path, ReadOptions(names={"Temp": "temperature"}))
    with pytest.raises(SceneError, match=r"several arrays to \['diameter'\]"):
        read_particles(path, ReadOptions(names={"Diameter": "diameter", "Diameter_2": "diameter"}))


def test_particles_without_ids_warn(tmp_path):
    path = write_vtp(tmp_path / "P_1.vtp", np.zeros((2, 3)))
    assert set(read_particles(path)) == {"position"}
    write_vtp(tmp_path / "P_2.vtp", np.ones((2, 3)))
    with pytest.warns(SceneWarning, match="no column of particle ids.*the columns are coordinates"):
        ds = xcg.open_scene(str(tmp_path / "P_*.vtp"), times=[0.0, 1.0])
    with pytest.raises(SceneError, match=r"derive\('velocity'\) follows particles by their ids"):
        ds.cg.derive("velocity")


def test_colliding_ids_beyond_float32_raise(tmp_path):
    path = write_particles(tmp_path / "P_1.vtp", [2**24, 2**24 + 1, 5])
    with pytest.raises(SceneError, match="Float32"):
        read_particles(path)
    assert (
        read_particles(write_particles(path, [2**24, 2**24 + 2, 5]))["particle_id"].max()
        == 2**24 + 2
    )


def test_an_empty_step_is_read(tmp_path):
    frame = read_particles(
        write_vtp(tmp_path / "P_1.vtp", [], Particle_ID=[], Velocity=np.empty((0, 3)))
    )
    assert {name: values.shape for name, values in frame.items()} == {
        "position": (0, 3), "particle_id": (0,), "velocity": (0, 3),
    }  # fmt: skip
    contacts = read_contacts(write_contacts(tmp_path / "FC_1.vtp", [], [], []))
    assert contacts["contact_force"].shape == (0, 3)


def test_old_ascii_files_are_read(tmp_path):
    path = tmp_path / "CHUTE_DES_00003.vtp"
    path.write_text(OLD_ASCII)
    (ref,) = mfix.index_particles([str(path)], DEFAULTS)
    assert (ref.rows, ref.time, ref.step, ref.columns) == (
        2,
        0.25,
        3,
        ("Position", "Diameter", "ID"),
    )
    frame = mfix.read_particles(ref, DEFAULTS)
    np.testing.assert_array_equal(frame["position"], [[0, 1, 2], [3, 4, 5]])
    np.testing.assert_array_equal(frame["particle_id"], [7, 9])


# --- damaged files ---------------------------------------------------------------------------------------


ENTITIES = b'<!DOCTYPE VTKFile [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]>\n<VTKFile'
DAMAGES = {
    "garbage": lambda text: b"\x00\xff" * 500,
    "empty": lambda text: b"",
    "other xml": lambda text: b'<?xml version="1.0"?><html></html>',
    "another kind of VTK": lambda text: text.replace(b'"PolyData"', b'"ImageData"'),
    "entities": lambda text: text.replace(b"<VTKFile", ENTITIES),
    "cut in the header": lambda text: text[:400],
    "cut before the data": lambda text: text[: text.index(b"<AppendedData")],
    "cut in the data": lambda text: text[: text.index(b" _") + 60],
    "two pieces": lambda text: text.replace(
        b"</Piece>", b'</Piece><Piece NumberOfPoints="3"></Piece>'
    ),
    "no number": lambda text: text.replace(b'"   3 "', b'"three"'),
    "more points than data": lambda text: text.replace(b'"   3 "', b'"9000 "'),
    "a few more points than data": lambda text: text.replace(b'"   3 "', b'"   4 "'),
    "fewer points than data": lambda text: text.replace(b'"   3 "', b'"   2 "'),
    "strange type": lambda text: text.replace(b"Float32", b"Float31"),
    "two components": lambda text: text.replace(
        b'NumberOfComponents="3"', b'NumberOfComponents="2"'
    ),
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_damaged_files_are_named(tmp_path, capfd, damage):
    path = write_particles(tmp_path / "P_0001.vtp")
    intact = path.read_bytes()
    damaged = damage(intact)
    assert damaged != intact
    path.write_bytes(damaged)
    with pytest.raises(SceneError, match=r"P_0001\.vtp"):
        read_particles(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"0000000002"', '"0000000003"'),
        ('"0000000002"', '"0000000001"'),
        ("2.500000E-01", "x"),
        ("</PolyData>", "</Polly>"),
        ("</PointData>", ""),
    ],
)
def test_damaged_ascii_files_are_named(tmp_path, capfd, old, new):
    path = tmp_path / "A_DES_00001.vtp"
    path.write_text(OLD_ASCII.replace(old, new))
    with pytest.raises(SceneError, match=r"A_DES_00001\.vtp"):
        read_particles(path)
    assert capfd.readouterr() == ("", "")


def test_a_file_that_changed_after_the_index_is_noticed(tmp_path):
    path = write_particles(tmp_path / "P_1.vtp")
    (ref,) = mfix.index_particles([str(path)], DEFAULTS)
    write_particles(path, [1, 2, 3, 4])
    with pytest.raises(SceneError, match="changed after the scene was opened"):
        mfix.read_particles(ref, DEFAULTS)


def test_damaged_collections_raise(tmp_path):
    pvd = tmp_path / "P.pvd"
    pvd.write_text("nothing")
    with pytest.raises(SceneError, match="expected VTK XML of type 'Collection'"):
        mfix.index_particles([str(pvd)], DEFAULTS)
    write_pvd(pvd, {})
    with pytest.raises(SceneError, match="names no files"):
        mfix.index_particles([str(pvd)], DEFAULTS)


# --- contacts --------------------------------------------------------------------------------------------


def test_contacts_by_their_names_in_the_scene(tmp_path):
    path = write_contacts(
        tmp_path / "FC_1.vtp", [1, 3], [2, 1], [[1, 2, 3], [4, 5, 6]], [[7, 8, 9], [1, 1, 1]],
        FORCE_CHAIN_CONTACT_POINT=np.full((2, 3), 99.0), FORCE_CHAIN_OVERLAP=[0.5, 0.25],
        FORCE_CHAIN_ORIENTATION=np.eye(2, 3), Particle_ID_1=[9, 9], Diameter_1=[1, 1],
    )  # fmt: skip
    frame = read_contacts(path)
    assert set(frame) == {
        "contact_i",
        "contact_j",
        "contact_force",
        "contact_point",
        "point_is_middle",
        "overlap",
        "row_of_file",
    }
    assert frame["point_is_middle"].all()
    np.testing.assert_array_equal(frame["contact_i"], [1, 3])
    np.testing.assert_array_equal(frame["contact_j"], [2, 1])
    np.testing.assert_array_equal(frame["contact_force"], [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_array_equal(frame["contact_point"], [[7, 8, 9], [1, 1, 1]])


def test_other_arrays_for_ids_and_force(tmp_path):
    path = write_vtp(
        tmp_path / "FC_1.vtp", [[0, 0, 0]], Particle_ID_1=[4], Particle_ID_2=[2], FORCE_CHAIN_FN=[[1, 2, 3]],
        FORCE_CHAIN_FT=[[0.5, 0, 0]],
    )  # fmt: skip
    frame = read_contacts(path)
    assert (frame["contact_i"], frame["contact_j"]) == (4, 2)
    np.testing.assert_array_equal(frame["contact_force"], [[1.5, 2, 3]])
    normal_only = read_contacts(path, ReadOptions(names={"FORCE_CHAIN_FN": "contact_force"}))
    np.testing.assert_array_equal(normal_only["contact_force"], [[1, 2, 3]])


def test_contacts_without_forces_raise(tmp_path):
    path = write_particles(tmp_path / "P_1.vtp", FORCE_CHAIN_FN=np.zeros((3, 3)))
    with pytest.raises(SceneError, match=r"lack \['contact_i', 'contact_j', 'contact_force'\]"):
        read_contacts(path)


def test_mirrored_rows_become_one_with_the_mean_force(tmp_path):
    # 1-2 once; 3-4 twice, with sliding forces that differ; 5-2 twice, exact; 6-1 once, higher id first.
    i = [1, 4, 5, 3, 2, 6]
    j = [2, 3, 2, 4, 5, 1]
    normal = np.array([[1, 0, 0], [0, -2, 0], [0, 0, 5], [0, 2, 0], [0, 0, -5], [3, 0, 0]], float)
    sliding = np.array(
        [[0, 1, 0], [-0.5, 0, 0], [0, 0, 0], [0.25, 0, 0], [0, 0, 0], [0, 0, 1]], float
    )
    point = np.arange(18.0).reshape(6, 3)
    path = write_contacts(
        tmp_path / "FC_1.vtp", i, j, normal + sliding, point, FORCE_CHAIN_FN=normal
    )
    frame = read_contacts(path)
    np.testing.assert_array_equal(frame["contact_i"], [1, 3, 2, 6])
    np.testing.assert_array_equal(frame["contact_j"], [2, 4, 5, 1])
    np.testing.assert_array_equal(
        frame["contact_force"], [[1, 1, 0], [0.375, 2, 0], [0, 0, -5], [3, 0, 1]]
    )
    np.testing.assert_array_equal(frame["contact_point"], point[[0, 3, 4, 5]])


def test_mirrors_are_found_without_normal_forces(tmp_path):
    force = np.array([[1, 2, 3], [-1, -2, -3]])
    assert (
        len(
            read_contacts(write_contacts(tmp_path / "FC_1.vtp", [1, 2], [2, 1], force))["contact_i"]
        )
        == 1
    )
    path = write_contacts(
        tmp_path / "FC_2.vtp", [1, 2], [2, 1], [[1, 0, 0], [-0.5, 0, 0]], FORCE_CHAIN_OVERLAP=[2, 2]
    )
    np.testing.assert_array_equal(read_contacts(path)["contact_force"], [[0.75, 0, 0]])


def test_exact_copies_are_dropped(tmp_path):
    force = [[1, 2, 3], [1, 2, 3], [0, 0, 1], [1, 2, 3]]
    frame = read_contacts(write_contacts(tmp_path / "FC_1.vtp", [1, 1, 3, 1], [2, 2, 1, 2], force))
    np.testing.assert_array_equal(frame["contact_i"], [1, 3])


def test_several_contacts_of_one_pair_stay(tmp_path):
    """Concave grains: other forces, or the same force at other points, each with its mirrored row."""
    force = np.array([[1, 0, 0], [2, 0, 0], [2, 0, 0]], float)
    point = np.array([[0, 0, 0], [0, 0.5, 0], [0, 1, 0]], float)
    i = np.array([1, 1, 1])
    j = np.array([2, 2, 2])
    once = read_contacts(write_contacts(tmp_path / "FC_1.vtp", i, j, force, point))
    np.testing.assert_array_equal(once["contact_point"], point)
    shuffle = [4, 0, 5, 2, 3, 1]
    i, j, force = (np.concatenate(pair)[shuffle] for pair in ((i, j), (j, i), (force, -force)))
    point = np.concatenate([point, point + np.array([10, 0, 0])])[shuffle]
    twice = read_contacts(write_contacts(tmp_path / "FC_2.vtp", i, j, force, point))
    np.testing.assert_array_equal(twice["contact_i"], [1, 1, 1])
    np.testing.assert_array_equal(np.sort(twice["contact_point"][:, 1]), [0, 0.5, 1])
    np.testing.assert_array_equal(np.sort(twice["contact_force"][:, 0]), [1, 2, 2])


def test_same_pair_with_unlike_forces_is_not_a_mirror(tmp_path):
    frame = read_contacts(
        write_contacts(tmp_path / "FC_1.vtp", [1, 2], [2, 1], [[1, 0, 0], [-2, 0, 0]])
    )
    np.testing.assert_array_equal(frame["contact_force"], [[1, 0, 0], [-2, 0, 0]])


# --- real output -----------------------------------------------------------------------------------------


def test_real_contacts_fit_the_particles():
    folder = real_data("mfix_chute")
    particles = read_particles(folder / "P_FB1_0004.vtp")
    options = ReadOptions(names={"FORCE_CHAIN_ORIENTATION": "contact_normal"})
    frame = read_contacts(folder / "FC_0004.vtp", options)
    contacts = len(frame["contact_i"])
    assert contacts == 7276
    pairs = np.sort(np.stack([frame["contact_i"], frame["contact_j"]]), axis=0)
    assert len(np.unique(pairs, axis=1).T) == contacts

    row = np.argsort(particles["particle_id"])
    i, j = (row[frame[name].astype(int) - 1] for name in ("contact_i", "contact_j"))
    branch = minimum_image(particles["position"][i] - particles["position"][j], PERIOD)
    length = np.linalg.norm(branch, axis=1)
    # Contacts are one time step older than positions: a few micrometres, of diameters of 2 mm.
    np.testing.assert_allclose(length, 0.002 - frame["overlap"], atol=5e-6)
    normal = branch / length[:, None]
    orientation = frame["contact_normal"]
    attractive = np.sum(orientation * normal, axis=1) < 0
    assert 0 < attractive.mean() < 0.02
    np.testing.assert_allclose(
        np.where(attractive[:, None], -1, 1) * orientation, normal, atol=5e-3
    )
    arm = minimum_image(frame["contact_point"] - particles["position"][i], PERIOD)
    np.testing.assert_allclose(arm, -(0.001 - frame["overlap"] / 2)[:, None] * normal, atol=2e-5)


def test_real_forces_add_up_to_what_mfix_applied():
    path = real_data("mfix_chute") / "P_FB1_0004.vtp"
    particles = read_particles(path)
    applied = vtkheader.read_arrays(vtp.read_header(str(path)), ["Collision_force"])[
        "Collision_force"
    ]
    frame = read_contacts(path.with_name("FC_0004.vtp"))
    row = np.argsort(particles["particle_id"])
    total = np.zeros_like(applied)
    for name, sign in (("contact_i", 1), ("contact_j", -1)):
        np.add.at(total, row[frame[name].astype(int) - 1], sign * frame["contact_force"])
    inside = particles["position"][:, 1] > 0.00115  # contacts with the wall are not in the file
    error = np.linalg.norm(total - applied, axis=1)[inside]
    # The others are at the cyclic boundaries, in pairs whose two sliding forces differ or that stand once.
    assert np.mean(error < 1e-9) > 0.93
    assert error.max() < 5e-3


# --- how VTK may write it --------------------------------------------------------------------------------


@pytest.mark.parametrize("compressor", [None, "ZLib", "LZ4", "LZMA"])
@pytest.mark.parametrize("mode", ["Ascii", "Binary", "Appended", "AppendedRaw"])
@pytest.mark.parametrize("header", [32, 64])
def test_every_encoding_of_vtk_is_read(tmp_path, compressor, mode, header):
    path = write_by_vtk(tmp_path / "P_1.vtp", mode, compressor, header)
    got = read_particles(path)
    np.testing.assert_array_equal(got["position"], np.arange(15000.0).reshape(-1, 3))
    np.testing.assert_array_equal(got["particle_id"], np.arange(5000))


def write_by_vtk(path: Path, mode="Appended", compressor="ZLib", header=32, rows=5000) -> Path:
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkPolyData
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter

    mesh = vtkPolyData()
    points = vtkPoints()
    points.SetData(numpy_to_vtk(np.arange(3.0 * rows, dtype="f4").reshape(-1, 3), deep=True))
    mesh.SetPoints(points)
    for name, values in (("Particle_ID", np.arange(rows)), ("Diameter", np.full(rows, 0.1))):
        array = numpy_to_vtk(values, deep=True)
        array.SetName(name)
        mesh.GetPointData().AddArray(array)
    writer = vtkXMLPolyDataWriter()
    writer.SetInputData(mesh)
    writer.SetFileName(str(path))
    getattr(writer, f"SetDataModeTo{mode.removesuffix('Raw')}")()
    writer.SetEncodeAppendedData(mode == "Appended")
    writer.SetHeaderType(header)
    getattr(writer, f"SetCompressorTypeTo{compressor}")()
    writer.SetBlockSize(4096)
    writer.Write()
    return path


# --- compressed files ------------------------------------------------------------------------------------


def pack(path: Path, *, members=1, keep=False) -> Path:
    """Compress a file in so many members one after the other, as `gzip` and `cat` do."""
    data = path.read_bytes()
    parts = [
        data[len(data) * k // members : len(data) * (k + 1) // members] for k in range(members)
    ]
    packed = path.with_name(path.name + ".gz")
    packed.write_bytes(b"".join(map(gzip.compress, parts)))
    if not keep:
        path.unlink()
    return packed


@pytest.mark.parametrize("members", [1, 3])
@pytest.mark.parametrize("form", ["mfix", "old", "AppendedRaw", "Appended", "Binary", "Ascii"])
def test_compressed_files_equal_their_originals(tmp_path, form, members):
    path = tmp_path / "P_0007.vtp"
    if form == "mfix":
        write_particles(path, Velocity=np.arange(9.0).reshape(3, 3))
    elif form == "old":
        path.write_text(OLD_ASCII)
    else:
        write_by_vtk(path, form)
    plain = xcg.open_scene(path, density=1.0).load()
    packed = xcg.open_scene(pack(path, members=members), density=1.0).load()
    xr.testing.assert_identical(packed.drop_attrs(), plain.drop_attrs())
    assert packed.attrs["engine"] == "mfix"
    assert "P_0007.vtp.gz" in packed.attrs["files"]


def test_a_compressed_series_opens(tmp_path):
    for number in (2, 10):
        write_particles(tmp_path / f"P_{number}.vtp", time=number / 10)
        write_contacts(tmp_path / f"FC_{number}.vtp", [1], [2], [number, 0, 0], time=number / 10)
    kinds = {"particles": "P_*.vtp", "contacts": "FC_*.vtp"}
    lists = {
        "particles": {f"P_{n}.vtp": n / 10 for n in (2, 10)},
        "contacts": {f"FC_{n}.vtp": n / 10 for n in (2, 10)},
    }
    for kind, files in lists.items():
        write_pvd(tmp_path / f"{kind}.pvd", files)

    def opened(**names):
        return xcg.open_scene(
            **{kind: tmp_path / name for kind, name in names.items()}, density=1.0
        )

    plain = opened(**kinds).load().drop_attrs()
    for path in tmp_path.glob("*.vtp"):
        pack(path)
    by_glob = opened(**{kind: f"{name}.gz" for kind, name in kinds.items()})
    assert by_glob.step.values.tolist() == [2, 10]
    xr.testing.assert_identical(by_glob.load().drop_attrs(), plain)
    by_list = {kind: f"{kind}.pvd" for kind in kinds}  # which name the files as they were written
    xr.testing.assert_identical(opened(**by_list).load().drop_attrs(), plain)
    for name in by_list.values():
        pack(tmp_path / name)
    by_packed_list = opened(**{kind: f"{name}.gz" for kind, name in by_list.items()})
    xr.testing.assert_identical(by_packed_list.load().drop_attrs(), plain)


def test_a_file_beside_its_compressed_copy_is_one_step(tmp_path):
    packed = pack(write_particles(tmp_path / "P_0001.vtp"), keep=True)
    with pytest.warns(SceneWarning, match=r"is left out, as .*P_0001\.vtp\.gz .*has its time"):
        ds = xcg.open_scene([tmp_path / "P_0001.vtp", packed], density=1.0)
    assert ds.sizes["time"] == 1


@pytest.mark.parametrize("share", [0.3, 0.95])
def test_truncated_compressed_files_raise(tmp_path, share):
    path = pack(write_by_vtk(tmp_path / "P_0001.vtp", "AppendedRaw"))
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    with pytest.raises(SceneError, match=r"P_0001\.vtp\.gz: .*(damaged or cut off|cut short)"):
        xcg.open_scene(path, density=1.0).load()
