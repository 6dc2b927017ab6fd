from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOHDF import vtkHDFReader
from vtkmodules.vtkIOXML import vtkXMLPolyDataReader

import xcg
from tests import ROOT
from tests.networks import fork, nine_particles, read_fcf
from xcg.cli import chains

BIAXIAL = ROOT / "examples" / "data" / "lammps_biaxial2d"


@pytest.fixture(scope="module")
def sheared():
    """Open the chains of a sheared layer, periodic along x."""
    scene = xcg.open_scene(
        BIAXIAL / "particles.*.gz", contacts=BIAXIAL / "contacts.*.gz", periodic="x", frozen=2
    )
    return scene.cg.force_chains(min_stress="mean").compute()


def read_vtp(path):
    reader = vtkXMLPolyDataReader()
    reader.SetFileName(str(path))
    reader.Update()
    return reader.GetOutput()


def arrays(data):
    return {
        data.GetArrayName(k): vtk_to_numpy(data.GetArray(k)).copy()
        for k in range(data.GetNumberOfArrays())
    }


def content(poly):
    """Points, ends of lines, arrays of both."""
    ends = vtk_to_numpy(poly.GetLines().GetConnectivityArray()).reshape(-1, 2).copy()
    points = vtk_to_numpy(poly.GetPoints().GetData()).copy()
    return points, ends, arrays(poly.GetPointData()), arrays(poly.GetCellData())


COLUMNS = (
    "LiggghtsId,X,Y,Z,radius,chainId,minorStress,minorDirX,minorDirY,minorDirZ,"
    "PrincipleStress0,PrincipleStress1,PrincipleStress2,StressDir00,StressDir10,StressDir20,"
    "StressDir01,StressDir11,StressDir21,StressDir02,StressDir12,StressDir22,linkNodes,"
)


def test_csv_has_the_columns_of_force_chain_finder(tmp_path, sheared):
    """Rows are the particles of chains; stresses are negative in compression, and rise."""
    fc = sheared.isel(time=[1])
    (path,) = fc.cg.to_csv(tmp_path / "f.csv")
    assert path.read_text().splitlines()[0] == COLUMNS
    rows = read_fcf(path)
    step = fc.isel(time=0)
    row = np.searchsorted(step.particle_id.values, [int(r["LiggghtsId"]) for r in rows])
    assert sorted(row) == np.flatnonzero(step.chain_id >= 0).tolist()

    def columns(*names):
        return np.array([[float(r[name]) for name in names] for r in rows])

    def of_scene(name):
        return step[name].values[row]

    np.testing.assert_array_equal(columns("chainId")[:, 0], of_scene("chain_id"))
    np.testing.assert_allclose(columns(*"XYZ"), of_scene("position"), rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(2 * columns("radius")[:, 0], of_scene("diameter"), rtol=1e-5)
    np.testing.assert_allclose(-columns("minorStress")[:, 0], of_scene("major_stress"), rtol=1e-5)
    minor = columns("minorDirX", "minorDirY", "minorDirZ")
    along = np.abs((minor * of_scene("major_direction")).sum(axis=1))
    np.testing.assert_allclose(along, 1.0, atol=1e-5)
    principal = columns(*(f"PrincipleStress{k}" for k in range(3)))
    assert (np.diff(principal, axis=1) >= 0).all()
    np.testing.assert_array_equal(principal[:, :1], columns("minorStress"))
    first = columns("StressDir00", "StressDir10", "StressDir20")
    np.testing.assert_allclose(np.abs((first * minor).sum(axis=1)), 1.0, atol=1e-6)
    starting = [r["linkNodes"] == "starting" for r in rows]
    np.testing.assert_array_equal(starting, of_scene("parent_id") < 0)


def test_signs_of_forces_in_csv(tmp_path):
    """Compression is negative in the file, as there."""
    fc = fork().cg.force_chains()
    (path,) = fc.cg.to_csv(tmp_path / "f.csv")
    row = read_fcf(path)[1]
    assert float(row["minorStress"]) == pytest.approx(-fc.major_stress.values[0, 1])
    assert float(row["minorStress"]) == float(row["PrincipleStress0"]) < 0
    assert row["linkNodes"] == "0"
    assert read_fcf(path)[0]["linkNodes"] == "starting"


def test_chains_are_written_to_vtp(tmp_path):
    fc = fork().cg.force_chains()
    (path,) = fc.cg.to_vtp(tmp_path / "f.vtp")
    points, ends, point_data, line_data = content(read_vtp(path))
    np.testing.assert_array_equal(points, fc.position.values[0])
    links = fc.cg.link_table()
    np.testing.assert_array_equal(ends, links[["particle_i", "particle_j"]])
    np.testing.assert_allclose(line_data["stress"], links["stress"])
    np.testing.assert_allclose(line_data["force_magnitude"], links["force"])
    assert (line_data["chain_id"] == 0).all()
    assert (point_data["radius"] == 0.5).all()
    np.testing.assert_array_equal(point_data["major_stress"], fc.major_stress.values[0])
    assert not point_data["image"].any()


def test_temporal_vtkhdf_equals_vtp(tmp_path, sheared):
    paths = sheared.cg.to_vtp(tmp_path / "f_{step}.vtp")
    assert [p.name for p in paths] == ["f_50000.vtp", "f_100000.vtp"]
    reader = vtkHDFReader()
    path = sheared.cg.save(tmp_path / "f.vtkhdf")
    assert reader.CanReadFile(str(path))
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    assert reader.GetNumberOfSteps() == 2
    for t, vtp in enumerate(paths):
        reader.SetStep(t)
        reader.Update()
        for there, here in zip(content(reader.GetOutput()), content(read_vtp(vtp)), strict=True):
            np.testing.assert_equal(there, here)
        assert reader.GetTimeValue() == pytest.approx(float(sheared.time[t]))


def test_components_in_any_order_make_the_same_files(tmp_path, sheared):
    turned = sheared.sel(component=["z", "x", "y"])
    for write in ("to_csv", "to_vtp"):
        paths = (
            getattr(sheared.cg, write)(tmp_path / f"{write}_a_{{step}}"),
            getattr(turned.cg, write)(tmp_path / f"{write}_b_{{step}}"),
        )
        for one, other in zip(*paths, strict=True):
            assert one.read_bytes() == other.read_bytes()
    xr.testing.assert_equal(
        turned.cg.chain_table().to_xarray(), sheared.cg.chain_table().to_xarray()
    )
    with pytest.raises(xcg.SceneError, match="holds the components"):
        sheared.sel(component=["x", "y"]).cg.to_csv(tmp_path / "some_{step}.csv")


def test_links_across_the_boundary_end_at_an_image(tmp_path, sheared):
    (path,) = sheared.isel(time=[0]).cg.to_vtp(tmp_path / "f.vtp")
    points, ends, point_data, _ = content(read_vtp(path))
    length = np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1)
    assert length.max() < sheared.diameter.max()
    assert point_data["image"].sum() > 0
    assert len(ends) == int((sheared.link_chain[0] >= 0).sum())
    members = int((sheared.chain_id[0] >= 0).sum())
    assert (point_data["image"] == 0).sum() == members


def test_every_link_goes_from_its_first_particle_to_the_nearest_image_of_its_second(
    tmp_path, sheared
):
    one = sheared.isel(time=[0])
    (path,) = one.cg.to_vtp(tmp_path / "f.vtp")
    points, ends, point_data, line_data = content(read_vtp(path))
    ids = one.particle_id.values[0]
    place = dict(zip(ids.tolist(), one.position.values[0], strict=True))
    links = one.cg.link_table()
    np.testing.assert_array_equal(point_data["id"][ends], links[["particle_i", "particle_j"]])
    assert not point_data["image"][ends[:, 0]].any()
    period = float(np.ptp(one.box.values[0, 0]))
    crossing = 0
    for (a, b), i, j in zip(ends, links["particle_i"], links["particle_j"], strict=True):
        np.testing.assert_array_equal(points[a], place[i])
        away = place[j] - place[i]
        turns = np.rint(away[0] / period)
        np.testing.assert_allclose(
            points[b] - points[a], away - [turns * period, 0, 0], rtol=0, atol=1e-12 * period
        )
        assert point_data["image"][b] == abs(turns)
        crossing += turns != 0
    assert crossing > 2
    np.testing.assert_array_equal(line_data["stress"], links["stress"])
    np.testing.assert_array_equal(line_data["chain_id"], links["chain"])


def test_files_without_chains_are_valid(tmp_path):
    fc = nine_particles().cg.force_chains(min_stress=1e9)
    assert len(fc.cg.to_csv(tmp_path / "f.csv")[0].read_text().splitlines()) == 1
    assert read_vtp(fc.cg.to_vtp(tmp_path / "f.vtp")[0]).GetNumberOfPoints() == 0
    fc.cg.save(tmp_path / "f.vtkhdf")
    reader = vtkHDFReader()
    reader.SetFileName(str(tmp_path / "f.vtkhdf"))
    reader.Update()
    assert reader.GetOutput().GetNumberOfPoints() == 0


def test_existing_files_are_kept(tmp_path):
    fc = fork().cg.force_chains()
    for write, name in (
        (fc.cg.to_csv, "f.csv"),
        (fc.cg.to_vtp, "f.vtp"),
        (fc.cg.save, "f.vtkhdf"),
    ):
        write(tmp_path / name)
        with pytest.raises(FileExistsError, match="overwrite=True"):
            write(tmp_path / name)
        write(tmp_path / name, overwrite=True)
        with pytest.raises(FileNotFoundError, match="create it first"):
            write(tmp_path / "nowhere" / name)
    assert len(list(tmp_path.iterdir())) == 3


def test_several_steps_need_several_names(tmp_path, sheared):
    with pytest.raises(ValueError, match=r"there are 2 steps; put \{step\} into the name"):
        sheared.cg.to_csv(tmp_path / "f.csv")


# --- the command -----------------------------------------------------------------------------------------


def run(*arguments):
    return CliRunner().invoke(chains, list(map(str, arguments)))


def test_the_command_writes_chains(tmp_path, sheared):
    files = [
        BIAXIAL / "particles.*.gz",
        "--contacts",
        BIAXIAL / "contacts.*.gz",
        "--periodic",
        "x",
        "--frozen",
        "2",
    ]
    names = {
        "--csv": "f_{step}.csv",
        "--vtp": "f_{step}.vtp",
        "--vtkhdf": "f.vtkhdf",
        "--netcdf": "f.nc",
    }
    outputs = [word for option, name in names.items() for word in (option, tmp_path / name)]
    done = run(*files, "--min-stress", "mean", *outputs)
    assert done.exit_code == 0, done.output
    rows = [line.split() for line in done.output.splitlines()[1:]]
    assert [int(r[2]) for r in rows] == sheared.chain_count.values.tolist()
    assert len(list(tmp_path.iterdir())) == 6
    again = run(*files, "--netcdf", tmp_path / "f.nc")
    assert again.exit_code == 1
    assert "pass --overwrite" in again.output


def test_no_chain_is_written_where_a_name_is_taken(tmp_path, sheared):
    steps = sheared.step.values.tolist()
    (tmp_path / f"f_{steps[-1]}.vtp").touch()
    with pytest.raises(FileExistsError, match=rf"f_{steps[-1]}\.vtp exists"):
        sheared.cg.to_vtp(tmp_path / "f_{step}.vtp")
    same = sheared.assign_coords(step=("time", [7] * len(steps)))
    with pytest.raises(
        ValueError, match=r"f_7\.csv is the name of several steps, whose numbers are equal"
    ):
        same.cg.to_csv(tmp_path / "f_{step}.csv", overwrite=True)
    files = [BIAXIAL / "particles.*.gz", "--contacts", BIAXIAL / "contacts.*.gz", "--periodic", "x"]
    names = {"--netcdf": "f.nc", "--csv": "f_{step}.csv", "--vtp": "f_{step}.vtp"}
    done = run(
        *files, *(word for option, name in names.items() for word in (option, tmp_path / name))
    )
    assert done.exit_code == 1
    assert "pass --overwrite" in done.output
    assert "median" not in done.output  # nothing is computed
    assert [p.name for p in tmp_path.iterdir()] == [f"f_{steps[-1]}.vtp"]


def test_the_command_reports_errors():
    files = [BIAXIAL / "particles.*.gz", "--contacts", BIAXIAL / "contacts.*.gz", "--periodic", "x"]
    assert "expected a number (degrees) above 0" in run(*files, "--alpha", 100).output
    assert "neither 'mean' nor a stress" in run(*files, "--min-stress", "median").output
