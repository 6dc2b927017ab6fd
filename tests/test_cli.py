"""The command line: Pysammos's configuration and TOML, output read back, resumed runs, exit codes."""

import gzip
import os
import re
import shutil
import socket
import subprocess
import sys
from typing import get_args

import h5py
import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner

import xcg
from tests import ROOT, dumps, real_data
from tests.dumps import write_series
from tests.readers.engines.test_mfix import write_contacts, write_particles, write_pvd, write_vtp
from tests.writers.test_vtkhdf import read
from xcg.analysis.force_chains import Algorithm
from xcg.cli import group
from xcg.cli.chain_command import statistics_table
from xcg.jobs import pysammos_config
from xcg.jobs.config import read_config
from xcg.jobs.run import run_job
from xcg.steps.faults import ON_ERROR

EXAMPLE = (ROOT / "examples" / "config.ini").read_text()


def xcg_run(*words, code=0):
    done = CliRunner().invoke(group, [str(w) for w in words])
    assert done.exit_code == code, done.output + repr(done.exception)
    return done.output


def changed(text=EXAMPLE, **values):
    """Give keys of the example other values."""
    lines = text.splitlines()
    for key, value in values.items():
        (at,) = (n for n, line in enumerate(lines) if line.split(" = ")[0] == key)
        lines[at] = f"{key} = {value}"
    return "\n".join(lines)


@pytest.fixture
def series(tmp_path):
    """Three steps of 60 grains in a cube of 1 m, periodic along x; contacts stand twice; the second step has none."""
    rng = np.random.default_rng(0)
    (tmp_path / "VTU").mkdir()
    for number in (150, 151, 152):
        x = rng.uniform(0, 1, (60, 3))
        x[0], x[1] = (0.02, 0.5, 0.5), (0.97, 0.5, 0.5)
        x[3] = x[2] + (0.0, 0.0, 0.09)
        more = {
            "Velocity": rng.normal(size=(60, 3)),
            "Density": np.full(60, 2000.0),
            "Diameter": np.full(60, 0.1),
        }
        more["Volume"] = more["Diameter"] ** 3 * np.pi / 6
        write_vtp(
            tmp_path / f"VTU/DES_{number:04d}.vtp",
            x,
            time=number / 100,
            Particle_ID=np.arange(1, 61),
            **more,
        )
        if number != 151:
            force = np.array([[-3.0, 0.5, 0], [3.0, -0.5, 0], [1.0, 0, 0], [1.0, 0, 0]])
            point = np.array([[-0.005, 0.5, 0.5], [0.995, 0.5, 0.5], x[2], x[2]])
            i = [2, 1, 3, 3]  # a mirrored pair across the edge, and an exact copy
            j = [1, 2, 4, 4]
            write_contacts(
                tmp_path / f"VTU/FC_{number:04d}.vtp",
                i,
                j,
                force,
                point,
                FORCE_CHAIN_FN=force,
                time=number / 100,
            )
    bounds = {f"{a}_{end}": v for a in "xy" for end, v in (("min", 0.0), ("max", 1.0))}
    keys = {
        "Particle_i_ID": "FORCE_CHAIN_GLOBAL_ID1",
        "Particle_j_ID": "FORCE_CHAIN_GLOBAL_ID2",
        "Particle_Mass": "None",
    }
    text = changed(
        particles_path="./VTU/DES_", contacts_path="./VTU/FC_", t0=150, tf=152, dt=1, z_transect=0.5,
        z_axis_periodic=False, **bounds, **keys,
    )  # fmt: skip
    (tmp_path / "config.ini").write_text(text)
    return tmp_path


@pytest.fixture
def few(series):
    """Fields that are quick to build, with and without contacts, for what is about files and not about values."""
    costly = (
        "shear_rate_tensor",
        "pressure",
        "granular_temperature",
        "inertial_number",
        "frictional_coefficient",
    )
    path = series / "config.ini"
    path.write_text(changed(path.read_text(), **dict.fromkeys(costly, False)))
    return series


def test_a_pysammos_configuration_runs_on_real_mfix_frames(tmp_path):
    """The example as it is, on the frame beside it."""
    folder = real_data("mfix_chute")
    shutil.copy(ROOT / "examples" / "config.ini", tmp_path)
    shutil.copytree(folder, tmp_path / "data" / "mfix_chute")
    said = xcg_run("run", tmp_path / "config.ini")
    assert "x: 0.04, z: 0.02, in the files' unit" in said
    out = tmp_path / "PysammosCG"
    assert sorted(p.name for p in out.iterdir()) == [
        "CG_GranularTemperature_slices.h5", "CG_Lucy_Monodisperse.h5", "CG_Lucy_Monodisperse_0004.vtkhdf",
    ]  # fmt: skip
    numbers = [4]
    ds = xcg.open_scene(
        [folder / f"P_FB1_{n:04d}.vtp" for n in numbers], contacts=[folder / f"FC_{n:04d}.vtp" for n in numbers],
        periodic="xz", box={"x": (0, 0.04), "z": (0, 0.02)},
    )  # fmt: skip
    c = 2 * 0.75 * ds.attrs["d43"]
    ends = {"x": (0, 0.04), "y": (0, 0.03)}
    direct = ds.cg.coarse_grain(
        ["pressure", "velocity", "total_stress_tensor"], preset="pysammos", axes="xy", at={"z": 0.01},
        bounds=ends, spacing={a: high / np.ceil(2 * high / c) for a, (_, high) in ends.items()},
    ).compute()  # fmt: skip
    with xr.open_dataset(out / "CG_Lucy_Monodisperse.h5") as f:
        assert f.sizes["time"] == 1
        for name in direct:
            # the period is recovered in single precision
            size = float(np.abs(direct[name]).max())
            np.testing.assert_allclose(
                f[name], direct[name], rtol=0, atol=1e-5 * size, err_msg=name
            )
        assert float(f.pressure_xyz.max()) > 50
        assert float(f.volume_fraction.max()) < 0.75
        for t, number in enumerate(numbers):
            _, (nodes, _, _), (got,) = read(out / f"CG_Lucy_Monodisperse_{number:04d}.vtkhdf")
            assert nodes == (f.sizes["x"], f.sizes["y"], 1)
            np.testing.assert_array_equal(got["pressure_xy"][0].T, f.pressure_xy.isel(time=t))
            np.testing.assert_array_equal(
                got["velocity"][0].transpose(1, 0, 2),
                f.velocity.isel(time=t).transpose("x", "y", "component"),
            )
    with xr.open_dataset(out / "CG_GranularTemperature_slices.h5") as s:
        assert {"granular_temperature_Kamrin", "granular_temperature_LAMMPS"} <= set(s)
        assert float(s.granular_temperature_LAMMPS.max()) > 0


def test_a_series_written_by_mfix_runs(series):
    said = xcg_run("run", series / "config.ini")
    assert "recovered from contacts that stand on both sides" in said
    assert "3 steps" in said
    with xr.open_dataset(series / "PysammosCG" / "CG_Lucy_Monodisperse.h5") as f:
        assert f.step.values.tolist() == [150, 151, 152]
        np.testing.assert_allclose(f.time, [1.5, 1.51, 1.52])
        sigma = f.total_stress_tensor_xyz
        assert float(np.abs(sigma.isel(time=0)).max()) > 0
        assert np.isfinite(f.volume_fraction).all()
    with h5py.File(series / "PysammosCG" / "CG_Lucy_Monodisperse.h5") as f:
        assert f["pressure_xy"].attrs["units"] == b"Pa" or f["pressure_xy"].attrs["units"] == "Pa"
    ds = xcg.open_scene(
        sorted((series / "VTU").glob("DES*")), contacts=sorted((series / "VTU").glob("FC*")), missing="empty",
        periodic="x", box={"x": (0.0, 1.0)},
    )  # fmt: skip
    assert (ds.contact_i.values >= 0).sum(axis=1).tolist() == [2, 0, 2]  # mirror and copy are gone
    f = ds.cg.coarse_grain(
        "contact_stress", axes="x", width=0.2, extent={"y": 1, "z": 1}, spacing=0.05
    )
    assert (f.contact_stress.isel(time=1) == 0).all()
    total = f.contact_stress.isel(time=0).sum("x").values * 0.05
    x = ds.position.values[0]
    branch = x[1] - x[0] - [1, 0, 0]
    expected = np.outer([-3.0, 0.5, 0], branch) + np.outer(
        [1.0, 0, 0], x[2] - x[3] - [round(x[2, 0] - x[3, 0]), 0, 0]
    )
    np.testing.assert_allclose(total, expected, atol=2e-3)


def test_steps_without_contact_files_run(series):
    options = {"contacts": str(series / "VTU/FC_*.vtp"), "periodic": "", "engine": "mfix"}
    with pytest.raises(xcg.SceneError, match="missing='empty'"):
        xcg.open_scene(str(series / "VTU/DES_*.vtp"), **options)
    with pytest.warns(xcg.SceneWarning, match="are left out"):
        assert (
            xcg.open_scene(str(series / "VTU/DES_*.vtp"), missing="skip", **options).sizes["time"]
            == 2
        )
    assert (
        xcg.open_scene(str(series / "VTU/DES_*.vtp"), missing="empty", **options).sizes["time"] == 3
    )
    # the first step may be the empty one
    (series / "VTU/FC_0150.vtp").unlink()
    assert "contact_force" in xcg.open_scene(
        str(series / "VTU/DES_*.vtp"), missing="empty", **options
    )


@pytest.mark.parametrize(
    ("steps", "expected"),
    [
        ({"t0": "2", "tf": "9", "dt": "3"}, [2, 5, 8]),
        ({"t0": "1", "tf": "7", "dt": "3"}, [1, 4, 7]),
        ({"dt": "4"}, [4, 8]),
        ({"t0": "6"}, [6, 7, 8, 9, 10]),
    ],
)
def test_steps_of_a_configuration_count_from_the_first(tmp_path, steps, expected):
    for number in range(1, 11):
        (tmp_path / f"P_{number:04d}.vtp").touch()
    found = pysammos_config._files(
        tmp_path, "P_", pysammos_config._Section(tmp_path, "timesteps", steps), required=True
    )
    assert found == [str(tmp_path / f"P_{number:04d}.vtp") for number in expected]


def test_compressed_files_are_among_those_of_a_configuration(series):
    plain = read_config(series / "config.ini").scene
    last = series / "VTU/FC_0152.vtp"
    last.with_name("FC_0152.vtp.gz").write_bytes(gzip.compress(last.read_bytes()))
    assert read_config(series / "config.ini").scene == plain
    last.unlink()
    assert read_config(series / "config.ini").scene["contacts"] == [
        plain["contacts"][0],
        f"{last}.gz",
    ]


def test_an_unknown_period_must_be_given(series):
    one = {"engine": "mfix", "periodic": "xz", "missing": "empty"}
    with pytest.raises(
        xcg.SceneError, match="axis 'x' is periodic, but the box has no finite extent"
    ):
        xcg.open_scene(str(series / "VTU/DES_*.vtp"), contacts=str(series / "VTU/FC_*.vtp"), **one)
    with pytest.warns(xcg.SceneWarning, match="x: 1, in the files' unit"):
        ds = xcg.open_scene(
            str(series / "VTU/DES_*.vtp"),
            contacts=str(series / "VTU/FC_*.vtp"),
            **one | {"periodic": "x"},
        )
    assert float(ds.box.values[0, 0] @ [-1, 1]) == pytest.approx(1.0, rel=1e-6)


@pytest.fixture
def a_chunk_a_step(monkeypatch):
    monkeypatch.setattr("xcg.readers.chunks._TASK", 0.0)


@pytest.mark.usefixtures("a_chunk_a_step")
def test_a_run_resumes(few):
    job = read_config(few / "config.ini")
    steps = run_job(job, jobs=1)
    with pytest.warns(xcg.SceneWarning, match="recovered"):
        assert next(steps) == (0, 3)
    assert next(steps) == (1, 3)
    steps.close()
    assert not (few / "PysammosCG" / "CG_Lucy_Monodisperse.h5").exists()
    said = xcg_run("run", few / "config.ini")
    assert "1 of 3 steps are there from an earlier run" in said
    whole = xr.load_dataset(few / "PysammosCG" / "CG_Lucy_Monodisperse.h5")
    refused = xcg_run("run", few / "config.ini", code=1)
    assert "exists; choose another" in refused
    assert "are kept" not in refused
    again = xcg_run("run", few / "config.ini", "--overwrite", "--quiet")
    assert again == ""
    xr.testing.assert_equal(xr.load_dataset(few / "PysammosCG" / "CG_Lucy_Monodisperse.h5"), whole)
    assert not list((few / "PysammosCG").glob(".*"))


@pytest.mark.usefixtures("a_chunk_a_step")
def test_another_job_does_not_resume(few):
    steps = run_job(read_config(few / "config.ini"), jobs=1)
    with pytest.warns(xcg.SceneWarning, match="recovered"):
        next(steps)
    next(steps)
    steps.close()
    (few / "config.ini").write_text(
        changed((few / "config.ini").read_text(), type="Gaussian", x_max=0.9)
    )
    (few / "config.ini").write_text(changed((few / "config.ini").read_text(), type="Lucy"))
    assert "earlier run" not in xcg_run("run", few / "config.ini")


@pytest.mark.parametrize("spelled", ["vkthdf_output", "vtkhdf_output"])
def test_both_spellings_and_output_options(few, spelled):
    text = changed((few / "config.ini").read_text(), vkthdf_output="True", h5_output="False")
    text = changed(text, granular_temperature_slices="False").replace("vkthdf_output", spelled)
    (few / "config.ini").write_text(text)
    xcg_run("run", few / "config.ini", "-q")
    assert sorted(p.suffix for p in (few / "PysammosCG").iterdir()) == [".vtkhdf"] * 3


@pytest.mark.parametrize(("kernel", "name"), [("HeavySide", "HeavySide"), ("Gaussian", "Gaussian")])
def test_kernels_are_chosen_by_name(few, kernel, name):
    (few / "config.ini").write_text(changed((few / "config.ini").read_text(), type=kernel))
    xcg_run("run", few / "config.ini", "-q")
    assert (few / "PysammosCG" / f"CG_{name}_Monodisperse.h5").exists()


def test_automatic_grid_middle_transects_and_phases(few):
    text = changed((few / "config.ini").read_text(), z_transect="None", partialignore="False")
    (few / "config.ini").write_text(text)
    xcg_run("run", few / "config.ini", "-q")
    with xr.open_dataset(few / "PysammosCG" / "CG_Lucy_Polydisperse.h5") as f:
        assert "phase" not in f.dims  # all grains are alike
        assert 0.4 < float(f.z) < 0.6
    text = changed(text, automatic_grid="True", grid_dimension="3", grid_axes="xyz")
    (few / "config.ini").write_text(text)
    xcg_run("run", few / "config.ini", "-q", "--overwrite")
    with xr.open_dataset(few / "PysammosCG" / "CG_Lucy_Polydisperse.h5") as f:
        first, last = f.z.values[[0, -1]]
        assert f.sizes["z"] == np.ceil((last - first) / 0.075) + 1 > 2
        assert first == pytest.approx(0.425, abs=0.03)  # 2.5 c + 0.5 dmax from the outermost centre
        assert last == pytest.approx(0.575, abs=0.03)


def test_a_series_of_one_layer_runs(series):
    """As in its bedload case: all grains in one plane, z_transect = 0."""
    rng = np.random.default_rng(1)
    for number in (150, 151, 152):
        x = np.concatenate([rng.uniform(0, 1, (60, 2)), np.zeros((60, 1))], axis=1)
        more = {"Velocity": rng.normal(size=(60, 3)) * [1, 1, 0], "Density": np.full(60, 2000.0)}
        write_vtp(series / f"VTU/DES_{number:04d}.vtp", x, time=number / 100, Particle_ID=np.arange(1, 61),
                  Diameter=np.full(60, 0.1), **more)  # fmt: skip
    text = changed((series / "config.ini").read_text(), z_transect="0.0", x_axis_periodic="False")
    (series / "config.ini").write_text(text)
    xcg_run("run", series / "config.ini", "-q")
    with xr.open_dataset(series / "PysammosCG" / "CG_Lucy_Monodisperse.h5") as f:
        assert f.attrs["dimension"] == 2
        assert f.attrs["kernel_dimension"] == 2
        inside = f.volume_fraction.sel(x=slice(0.2, 0.8), y=slice(0.2, 0.8)).mean()
        assert float(inside) == pytest.approx(
            60 * np.pi / 6 * 0.1**3 / 0.1, rel=0.2
        )  # a layer as thick as its grains
        empty = f.sample_count == 0
        assert np.isnan(f.velocity.where(empty)).all()
        assert "pressure_z" not in f


def test_unknown_sections_and_keys_are_reported(few):
    text = (few / "config.ini").read_text().replace("[grid_info]", "[grid_info]\ncolour = red")
    text = changed(text, Contact_ij="FORCE_CHAIN_CONTACT_POINT", Coordination_Number="Neighbours")
    (few / "config.ini").write_text(text + "\n[plots]\na = 1\n")
    said = xcg_run("run", few / "config.ini")
    assert "[grid_info]: unknown and left out: colour" in said
    assert "unknown sections ['plots']" in said
    assert "off by one overlap" in said
    assert "Coordination_Number = Neighbours: no such array" in said


def test_a_series_without_contacts_runs(series):
    for file in (series / "VTU").glob("FC*"):
        file.unlink()
    text = changed((series / "config.ini").read_text(), x_axis_periodic="False")
    (series / "config.ini").write_text(text)
    assert "fields of contacts are left out" in xcg_run("run", series / "config.ini")
    with xr.open_dataset(series / "PysammosCG" / "CG_Lucy_Monodisperse.h5") as f:
        assert "granular_temperature_xyz" in f
        assert "pressure_xy" not in f


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"type": "Wendland"}, "expected Lucy, Gaussian or HeavySide"),
        ({"t0": "one"}, "expected a whole number"),
        ({"x_min": "left"}, "expected a number or None"),
        ({"x_min": "None"}, "x_min and x_max are needed"),
        ({"x_axis_periodic": "maybe"}, "expected True or False"),
        ({"grid_axes": "xyz"}, "as many axes"),
        ({"t0": 900, "tf": 901}, "numbers there: 150, 151, 152"),
        ({"particles_path": "./VTU/NO_"}, "there are none of that name"),
    ],
)
def test_faults_are_named_and_exit_with_1(series, values, message):
    (series / "config.ini").write_text(changed((series / "config.ini").read_text(), **values))
    said = xcg_run("run", series / "config.ini", code=1)
    assert message in " ".join(said.split())


def test_messages_name_options_of_the_command_line(tmp_path):
    one = write_particles(tmp_path / "P_0001.vtp", Velocity=np.zeros((3, 3)), Density=np.ones(3))
    pvd = write_pvd(tmp_path / "P.pvd", {"P_0001.vtp": "0.1", "P_0002.vtp": "0.2"})
    assert "or pass --missing skip to go on" in " ".join(xcg_run("info", pvd, code=1).split())
    assert "contacts= for" not in xcg_run("chains", one, code=1)
    assert "'contact_point']: give --contacts (this Dataset holds" in xcg_run("chains", one, code=1)
    assert "alpha=100.0: expected a number" in xcg_run("chains", one, "--alpha", 100, code=1)
    (tmp_path / "there.nc").touch()
    assert "or pass --overwrite to replace it" in xcg_run(
        "convert", one, "-o", tmp_path / "there.nc", code=1
    )
    text = '[scene]\nparticles = "P.pvd"\n'
    (tmp_path / "job.toml").write_text(text)  # where an argument is a key
    assert "or pass missing='skip' to go on" in " ".join(
        xcg_run("run", tmp_path / "job.toml", code=1).split()
    )


def test_a_dry_run_lists_all_fields(tmp_path):
    xcg.datasets.random_scene(50).cg.save(tmp_path / "scene.nc")
    text = '[scene]\nparticles = "scene.nc"\n[fields]\nfields = "density"\n[slices]\naxis = "z"\n'
    (tmp_path / "job.toml").write_text(text)
    said = xcg_run("run", tmp_path / "job.toml", "--dry-run")
    assert "\ndensity, " in said
    assert "temperature_Kamrin" in said


def test_a_dry_run_says_what_exists(tmp_path):
    xcg.datasets.random_scene(50).cg.save(tmp_path / "scene.nc")
    text = '[scene]\nparticles = "scene.nc"\n[fields]\nfields = "density"\n'
    (tmp_path / "job.toml").write_text(text)
    assert "exists" not in xcg_run("run", tmp_path / "job.toml", "--dry-run")
    xcg_run("run", tmp_path / "job.toml", "-q")
    assert "fields.nc exists; --overwrite replaces it" in xcg_run(
        "run", tmp_path / "job.toml", "--dry-run"
    )


def test_files_open_with_the_options_of_the_scene_of_a_job(tmp_path):
    particles, contacts = write_series(tmp_path)
    files = (particles, "-c", contacts)
    said = xcg_run("info", *files, "--box", "x=0:8,y=-1:9", "--units", "reduced", "--allow-unknown")
    box = {"x": (0, 8), "y": (-1, 9)}
    assert said.strip() == repr(
        xcg.open_scene(
            particles, contacts=contacts, box=box, units="reduced", allow_unknown=True
        ).cg
    )
    assert "is not of the form x=0:0.1,z=0:0.2" in xcg_run("chains", *files, "--box", "x=0", code=2)


def test_messages_name_commands_in_place_of_python(tmp_path):
    xcg.datasets.random_scene(50).cg.save(tmp_path / "scene.nc")
    for options, expected in (
        (
            'fields = "densty"',
            "Others are listed by 'xcg fields', variables of the scene by 'xcg info'",
        ),
        (
            'fields = "density"\nerrors = true',
            "errors = true: .* of xcg.time_average in Python",
        ),
    ):
        (tmp_path / "job.toml").write_text(
            f'[scene]\nparticles = "scene.nc"\n[fields]\n{options}\n'
        )
        said = " ".join(xcg_run("run", tmp_path / "job.toml", code=1).split())
        assert re.search(expected, said), said


def test_usage_errors_exit_with_2(tmp_path):
    xcg_run("run", tmp_path / "nothing.ini", code=2)
    xcg_run("march", code=2)


def test_a_job_in_toml_runs(tmp_path):
    pytest.importorskip("vtk")
    text = (ROOT / "examples" / "chute.toml").read_text()
    text = text.replace("data/lammps_chute", str(ROOT / "examples/data/lammps_chute")).replace(
        "../output", "out"
    )
    (tmp_path / "chute.toml").write_text(text)
    assert "into" in xcg_run("run", tmp_path / "chute.toml", "--dry-run")
    assert not (tmp_path / "out").exists()
    xcg_run("run", tmp_path / "chute.toml")
    with xr.open_dataset(tmp_path / "out" / "chute.nc") as f:
        assert f.pressure.dims == ("time", "z")
        times, _, steps = read(tmp_path / "out" / "chute.vtkhdf")
        assert times == f.time.values.tolist()
        for t, got in enumerate(steps):
            np.testing.assert_array_equal(got["pressure"].ravel(), f.pressure.isel(time=t))
    for bad, message in (
        ("[scene", "Expected ']'"),
        ("[scene]\na=1", "scene.particles"),
        ("x=1", "expected tables"),
    ):
        (tmp_path / "bad.toml").write_text(bad)
        assert message in xcg_run("run", tmp_path / "bad.toml", code=1)


def test_what_a_job_leaves_out_has_the_documented_default(tmp_path):
    (tmp_path / "job.toml").write_text('[scene]\nparticles = "p.*.dump"\n')
    job = read_config(tmp_path / "job.toml")
    assert (job.netcdf, job.vtkhdf, job.suffix, job.name, job.on_error) == (
        True,
        "",
        ".nc",
        "fields",
        "raise",
    )
    assert job.folder == tmp_path / "xcg-output"
    assert job.scene == {"particles": [str(tmp_path / "p.*.dump")]}
    assert (job.fields, job.encoding, job.phases, job.slices) == ({}, {}, None, None)


def test_info_and_fields_print_summaries(tmp_path):
    write_particles(tmp_path / "P_0001.vtp", Velocity=np.zeros((3, 3)), Density=np.ones(3))
    said = xcg_run("info", tmp_path / "P_0001.vtp")
    assert "scene of 1 step with up to 3 particles" in said
    assert "missing:   contact_force" in said
    assert "granular_temperature" in xcg_run("fields")
    assert "inertial_number_Sxy_Pxy_d32" in xcg_run("fields", "--pysammos")
    (tmp_path / "nonsense.txt").write_text("?")
    assert "no engine recognises" in xcg_run("info", tmp_path / "nonsense.txt", code=1)


NAMED = (
    '{"c_q[1]": "charge", "Drop": null}',
    '{"c_q[1]" = "charge"}',
    '"c_q[1]" = "charge"',
    '{"particles": {"c_q[1]": "charge"}}',
    '[particles]\n"c_q[1]" = "charge"',
)


@pytest.mark.parametrize("names", NAMED)
def test_names_are_toml_or_json(names, tmp_path):
    rows = [f"{k} {k} 0 0 0.5 {k} 9" for k in range(3)]
    dump = tmp_path / "p.dump"
    dumps.write(dump, dumps.dump_text(rows, columns="id x y z radius c_q[1] Drop", step=0))
    job = tmp_path / "job.toml"
    job.write_text(
        '[scene]\nparticles = "p.dump"\nunits = "reduced"\ndensity = 1.0\n[fields]\nfields = "density"\n'
    )
    assert "charge" not in xcg_run("info", dump, "--units", "reduced")
    assert "charge" in xcg_run("info", dump, "--units", "reduced", "--names", names)
    assert "charge" in xcg_run("run", job, "--dry-run", "--names", names)
    xcg_run(
        "convert", dump, "--units", "reduced", "--names", names, "-o", tmp_path / "scene.nc", "-q"
    )
    ds = xcg.open_scene(tmp_path / "scene.nc")
    np.testing.assert_array_equal(ds.charge.isel(time=0), [0, 1, 2])


def test_names_of_a_list_or_beside_those_of_a_job(tmp_path):
    (tmp_path / "p.csv").write_text("1,0,0,0,1\n2,2,0,0,1\n")
    columns = '["id", "x", "y", "z", "diameter"]'
    assert "up to 2 particles" in xcg_run("info", tmp_path / "p.csv", "--names", columns)
    rows = [f"{k} {k} 0 0 0.5 {k} 7" for k in range(3)]
    dumps.write(
        tmp_path / "p.dump", dumps.dump_text(rows, columns="id x y z radius c_q c_r", step=0)
    )
    (tmp_path / "job.toml").write_text(
        '[scene]\nparticles = "p.dump"\nunits = "reduced"\ndensity = 1.0\nnames = {c_r = "rank"}\n'
    )
    said = xcg_run("run", tmp_path / "job.toml", "--dry-run", "--names", '{c_q = "charge"}')
    assert "rank" in said
    assert "charge" in said


@pytest.mark.parametrize("names", ["", "c_q", "5", "{}", "{c_q: charge}", "{'c_q': None}"])
def test_names_that_are_neither_toml_nor_json_are_refused(names, tmp_path):
    write_particles(tmp_path / "P_0001.vtp", Velocity=np.zeros((3, 3)), Density=np.ones(3))
    said = " ".join(xcg_run("info", tmp_path / "P_0001.vtp", "--names", names, code=2).split())
    assert "is neither TOML nor JSON" in said


@pytest.mark.parametrize("port", [-1, 65536, "web"])
def test_ports_that_cannot_be_are_refused(port):
    assert "'--port'" in xcg_run("explore", "none.dump", "--port", port, code=2)


def test_a_busy_port_is_named():
    pytest.importorskip("panel")
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        file = ROOT / "examples/data/lammps_chute/particles.00050000.dump.gz"
        said = " ".join(xcg_run("explore", file, "--no-browser", "--port", port, code=1).split())
    assert f"port {port} at 127.0.0.1 cannot be used" in said
    assert "leave out --port" in said


# --- help ------------------------------------------------------------------------------------------------


def said_by(*commands, **environment):
    """Run commands in one process of their own, which lists the modules it has loaded after their output."""
    code = """
import atexit, sys
from contextlib import suppress
heavy = ("numba", "dask", "scipy", "vtkmodules", "h5py", "netCDF4", "zarr", "xcg.jobs", "xcg.readers.open")
atexit.register(lambda: print("loaded", [name for name in heavy if name in sys.modules]))
from xcg.cli import main
for command in sys.argv[1:]:
    sys.argv = ["xcg", *command.split()]
    with suppress(SystemExit):
        main()
"""
    done = subprocess.run([sys.executable, "-c", code, *commands], capture_output=True, text=True, check=True,
                          env=os.environ | {"PYTHONPATH": str(ROOT)} | environment)  # fmt: skip
    return done.stdout


def test_help_loads_no_more_than_the_package_does():
    names = ["", *group.commands]
    said = said_by(*(f"{name} --help" for name in names))
    usages = [line for line in said.splitlines() if line.startswith("Usage: ")]
    assert len(usages) == len(names)
    for name, usage in zip(names, usages, strict=True):
        assert usage.startswith(" ".join(("Usage: xcg", *name.split(), "[OPTIONS]")))
    assert said.endswith("\nloaded []\n")


def test_completion_loads_no_more_than_the_package_does():
    said = said_by(
        "", _XCG_COMPLETE="bash_complete", COMP_WORDS="xcg chains --algorithm ", COMP_CWORD="3"
    )
    assert said == "plain,branching\nplain,peters2005\nloaded []\n"


def test_options_have_the_choices_of_the_library():
    def taken(command, option):
        return next(
            tuple(p.type.choices) for p in group.commands[command].params if p.name == option
        )

    assert taken("run", "on_error") == taken("chains", "on_error") == ON_ERROR
    assert taken("chains", "algorithm") == get_args(Algorithm)


def selected(step):
    """Steps of a scene as xarray leaves them: one without a dimension of time, none, and by their numbers."""
    ds = xcg.datasets.open("plane_shear", frozen=2).isel(time=slice(0, 4))
    return {"one": ds.isel(time=2), "none": ds.isel(time=[]), "step": ds.swap_dims(time="step")}[
        step
    ]


@pytest.mark.filterwarnings("ignore:no step is left")
@pytest.mark.parametrize("suffix", ["zarr", "nc"])
@pytest.mark.parametrize("step", ["one", "none", "step"])
def test_selected_steps_open_again_once_saved(tmp_path, suffix, step):
    ds = selected(step)
    path = ds.cg.save(tmp_path / f"s.{suffix}")
    expected = ds.compute().cg.coarse_grain(["density", "stress"], axes="z", width=1.0)
    for chunks in ("auto", None, 3, -1):
        again = xcg.open_scene(path, chunks=chunks)
        found = again.cg.coarse_grain(["density", "stress"], axes="z", width=1.0).compute()
        xr.testing.assert_equal(found, expected)
        assert f"scene of {ds.time.size} step" in repr(again.cg)


def test_commands_accept_a_single_saved_step(tmp_path):
    path = selected("one").cg.save(tmp_path / "one.zarr")
    job = tmp_path / "job.toml"
    job.write_text(
        '[scene]\nparticles = "one.zarr"\n[fields]\nfields = ["density"]\naxes = "z"\nwidth = 1.0\n'
    )
    xcg_run("run", job, "-q")
    expected = selected("one").cg.coarse_grain("density", axes="z", width=1.0).compute()
    with xr.open_dataset(tmp_path / "xcg-output" / "fields.nc") as found:
        np.testing.assert_array_equal(found.density[0], expected.density)
    xcg_run("convert", path, "-o", tmp_path / "again.nc")
    assert xcg.open_scene(tmp_path / "again.nc").time.values == expected.time.values[None]
    assert str(int(expected.step)) in xcg_run("chains", path)
    selected("none").cg.save(tmp_path / "one.zarr", overwrite=True)
    assert "the scene has no steps" in xcg_run("run", job, "--overwrite", code=1)


def test_skipped_steps_have_no_statistics_of_chains():
    fc = xcg.datasets.random_scene(60).cg.force_chains()
    assert statistics_table(fc).splitlines()[1].split()[2] == str(fc.chain_count.item())
    skipped = fc.assign_coords(step=("time", [7]), skipped=("time", [True]))
    assert statistics_table(skipped).splitlines()[1].split() == ["7", "0", "skipped"]
