"""Options that have no effect, and columns that contradict each other, are named."""

import h5py
import numpy as np
import pandas as pd
import pytest
import xarray as xr

import xcg
from tests.scenes import reopen

RNG = np.random.default_rng(3)
COUNT = 60
PLACES = RNG.uniform(0.0, 30.0, (COUNT, 3))
DIAMETER = RNG.uniform(0.8, 1.2, COUNT)
VOLUME = np.pi / 6 * DIAMETER**3
DISC = np.pi / 4 * DIAMETER**2


def from_arrays(**variables):
    return xcg.scene_from_arrays(PLACES, **({"diameter": DIAMETER} | variables))


def write_dump(folder, **columns):
    """One step as LAMMPS writes it, with six digits."""
    head = f"ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n{COUNT}\nITEM: BOX BOUNDS ff ff ff\n"
    head += "0 30\n" * 3 + f"ITEM: ATOMS id x y z {' '.join(columns)}\n"
    rows = np.column_stack([np.arange(1, COUNT + 1), PLACES, *columns.values()])
    path = folder / "one.dump"
    path.write_text(head + "".join(" ".join(f"{v:.6g}" for v in row) + "\n" for row in rows))
    return str(path)


def write_csv(folder, **columns):
    x, y, z = PLACES.T
    path = folder / "one.csv"
    pd.DataFrame({"x": x, "y": y, "z": z, **columns}).to_csv(path, index=False)
    return str(path)


def open_dump(folder, columns, **options):
    return xcg.open_scene(write_dump(folder, **columns), units="SI", timestep=1e-3, **options)


def open_csv(folder, columns, **options):
    return xcg.open_scene(write_csv(folder, **columns), **options)


def from_table(folder, columns, **options):
    x, y, z = PLACES.T
    return xcg.scene_from_table(pd.DataFrame({"x": x, "y": y, "z": z, **columns}), **options)


DOORS = [open_dump, open_csv, from_table]


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize(
    "column",
    [{"mass": 2600 * VOLUME}, {"density": np.full(COUNT, 2600.0)}],
    ids=["mass", "density"],
)
def test_density_beside_a_column_of_mass_or_density_is_named(tmp_path, door, column):
    with pytest.warns(xcg.SceneWarning, match=r"density=2500.* is not used, as the "):
        ds = door(tmp_path, {"radius": DIAMETER / 2} | column, density=2500.0)
    np.testing.assert_allclose(ds.density, 2600.0, rtol=1e-4)


@pytest.mark.parametrize("door", DOORS)
def test_density_that_is_that_of_the_columns_is_no_mistake(tmp_path, door):
    ds = door(tmp_path, {"radius": DIAMETER / 2, "mass": 2500 * VOLUME}, density=2500.0)
    np.testing.assert_allclose(ds.density, 2500.0, rtol=1e-4)


def test_density_beside_masses_without_sizes_is_named():
    with pytest.warns(xcg.SceneWarning, match=r"density=2500 is not used.*masses and no sizes"):
        from_arrays(diameter=None, mass=np.ones(COUNT), density=2500)


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("factor", [1e-3, 1e3, 8.0, 1.02])
def test_masses_that_are_not_density_times_volume_are_named(tmp_path, door, factor):
    columns = {
        "radius": DIAMETER / 2,
        "mass": 2600 * factor * VOLUME,
        "density": np.full(COUNT, 2600.0),
    }
    with pytest.warns(xcg.SceneWarning, match="masses are not density times volume .60 of 60"):
        door(tmp_path, columns)


def test_one_wrong_mass_is_named():
    mass = 2600 * VOLUME
    mass[7] *= 10
    with pytest.warns(xcg.SceneWarning, match="1 of 60 particles looked at, such as id 7: mass"):
        from_arrays(mass=mass, density=np.full(COUNT, 2600.0))


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("thickness", [1.0, 0.2])
def test_masses_of_discs_are_named_with_their_thickness(tmp_path, door, thickness):
    columns = {
        "radius": DIAMETER / 2,
        "mass": 2600 * thickness * DISC,
        "density": np.full(COUNT, 2600.0),
    }
    with pytest.warns(
        xcg.SceneWarning, match=rf"fit discs of thickness {thickness:g}, .*shape='disc'"
    ):
        door(tmp_path, columns)
    ds = door(tmp_path, columns, shape="disc", thickness=thickness)
    np.testing.assert_allclose(ds.volume.squeeze(), thickness * DISC, rtol=1e-4)


def test_equal_discs_of_thickness_one_are_named():
    with pytest.warns(xcg.SceneWarning, match="masses fit discs of thickness 1, m = rho pi r"):
        from_arrays(
            diameter=np.ones(COUNT),
            mass=np.full(COUNT, 2.6 * np.pi / 4),
            density=np.full(COUNT, 2.6),
        )


def test_columns_of_six_digits_do_not_contradict_each_other(tmp_path):
    columns = {
        "radius": DIAMETER / 2,
        "mass": 2600 * VOLUME,
        "density": np.full(COUNT, 2600.0),
    }
    open_dump(tmp_path, columns)


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("factor", [8.0, 1e9])
def test_volumes_larger_than_the_spheres_are_named(tmp_path, door, factor):
    columns = {"radius": DIAMETER / 2, "volume": factor * VOLUME}
    with pytest.warns(xcg.SceneWarning, match=r"volumes are (8|1e\+09) times .*names="):
        door(tmp_path, columns, density=2600.0)


def test_volumes_smaller_than_spheres_are_other_shapes(tmp_path):
    columns = {"radius": DIAMETER / 2, "volume": 0.7 * VOLUME}
    ds = open_csv(tmp_path, columns, density=2600.0)
    np.testing.assert_allclose(ds.mass.squeeze(), 0.7 * 2600 * VOLUME)


def test_grains_without_mass_open_without_a_warning_of_numpy(tmp_path):
    with pytest.warns(xcg.SceneWarning, match="have the mass 0"):
        ds = open_csv(tmp_path, {"radius": DIAMETER / 2, "mass": np.zeros(COUNT)})
    assert not ds.mass.any()


# --- times -----------------------------------------------------------------------------------------------


def write_steps(folder, kind, clock):
    """Two steps, 0 and 100, at the times of a clock."""
    if kind == "csv":
        rows = [f"{time},{step},1,{step},0,0" for step, time in zip((0, 100), clock, strict=True)]
        text = "\n".join(["time,step,id,x,y,z", *rows, ""])
    else:
        text = "".join(
            f"ITEM: UNITS\nsi\nITEM: TIME\n{time}\nITEM: TIMESTEP\n{step}\nITEM: NUMBER OF ATOMS\n1\n"
            f"ITEM: BOX BOUNDS ff ff ff\n0 200\n0 1\n0 1\nITEM: ATOMS id x y z\n1 {step} 0 0\n"
            for step, time in zip((0, 100), clock, strict=True)
        )
    path = folder / f"steps.{kind}"
    path.write_text(text)
    return path


@pytest.mark.parametrize("kind", ["csv", "dump"])
def test_a_time_step_beside_other_times_is_named(tmp_path, kind):
    path = write_steps(tmp_path, kind, (0.5, 0.6))
    with pytest.warns(xcg.SceneWarning, match=r"timestep=0\.01 is not used, .*0\.5 to 0\.6"):
        ds = xcg.open_scene(path, timestep=0.01)
    assert ds.time.values.tolist() == [0.5, 0.6]
    assert xcg.open_scene(path, timestep=0.001).time.values.tolist() == [0.5, 0.6]


# --- saving ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def average():
    """A result without time."""
    ds = xcg.datasets.random_scene(300, seed=1)
    return ds.cg.coarse_grain(["density", "velocity", "stress"], width=1.0).cg.time_average()


@pytest.mark.parametrize("suffix", [".nc", ".h5", ".zarr"])
def test_digits_are_those_of_a_result_without_time(tmp_path, average, suffix):
    back = reopen(xcg.save(average, tmp_path / f"f{suffix}", digits=3))
    error = np.abs(back.density / average.density - 1).max()
    assert 0.5e-4 < error <= 0.5e-3
    assert "3 significant digits" in back.density.attrs["precision"]


@pytest.mark.parametrize("suffix", [".nc", ".h5", ".zarr"])
@pytest.mark.parametrize("lazy", [False, True])
def test_the_type_is_that_of_a_result_without_time(tmp_path, average, suffix, lazy):
    f = average.chunk() if lazy else average
    back = reopen(xcg.save(f, tmp_path / f"f{suffix}", dtype="float32"))
    assert {back[name].dtype for name in ("density", "velocity", "stress")} == {np.dtype("float32")}
    np.testing.assert_array_equal(back.density, average.density.astype("float32"))


def test_compression_is_that_of_a_result_without_time(tmp_path, average):
    for level in (0, 1, 9):
        path = xcg.save(average, tmp_path / f"{level}.nc", compression=level)
        with h5py.File(path) as file:
            assert file["stress"].compression == ("gzip" if level else None)
            assert file["stress"].compression_opts == (level or None)
    xr.testing.assert_equal(reopen(path), average)


@pytest.mark.parametrize("suffix", [".nc", ".zarr", ".vtkhdf", ".pvd"])
@pytest.mark.parametrize("way", ["memory", "chunks", "without time"])
def test_numbers_beyond_single_precision_are_named(tmp_path, suffix, way):
    if suffix in (".vtkhdf", ".pvd"):
        pytest.importorskip("vtkmodules")
    f = xcg.datasets.simple_cubic(4).cg.coarse_grain(["density", "volume_fraction"], width=1.0)
    f = f.assign(density=f.density * 1e300)
    if way == "without time":
        f = f.isel(time=0)
    with pytest.raises(xcg.SceneError, match=r"'density' holds .*e\+30\d, beyond .* float32"):
        xcg.save(f.chunk() if way == "chunks" else f, tmp_path / f"f{suffix}", dtype="float32")
    assert not list(tmp_path.iterdir())


def test_a_record_names_numbers_beyond_single_precision(tmp_path):
    f = xcg.datasets.simple_cubic(4).cg.coarse_grain("density", width=1.0)
    with (
        pytest.raises(xcg.SceneError, match="'density' holds"),
        xcg.record(tmp_path / "live.nc", dtype="float32") as live,
    ):
        live.append(f.assign(density=f.density * 1e300))


@pytest.mark.parametrize(
    "options", [{"dtype": "float32"}, {"digits": 3}, {"compression": 5}], ids=str
)
def test_chains_in_vtkhdf_refuse_options_that_they_ignore(tmp_path, options):
    chains = xcg.datasets.random_scene(200, seed=1).cg.force_chains()
    name = next(iter(options))
    with pytest.raises(ValueError, match=f"chains in VTKHDF .*leave out {name}="):
        chains.cg.save(tmp_path / "chains.vtkhdf", **options)


def test_images_refuse_a_compression_that_they_ignore(tmp_path):
    pytest.importorskip("vtkmodules")
    f = xcg.datasets.simple_cubic(4).cg.coarse_grain("density", width=1.0)
    with pytest.raises(ValueError, match="leave out compression="):
        f.cg.save(tmp_path / "f.pvd", compression=5)


# --- presets ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("preset", ["lammps", "pysammos"])
@pytest.mark.parametrize(
    "option",
    [{"friction": 0.5}, {"fluid_viscosity": 1e-3}, {"deviatoric": "stress"}, {"size": "d32"}],
    ids=str,
)
def test_presets_refuse_options_that_they_ignore(preset, option):
    ds = xcg.datasets.random_scene(100, seed=1)
    with pytest.raises(ValueError, match=rf"preset='{preset}'.*'{next(iter(option))}'"):
        ds.cg.coarse_grain(preset=preset, axes="z", width=1.0, **option)


def test_the_preset_of_lammps_refuses_pairs_of_phases():
    ds = xcg.datasets.random_scene(100, seed=1)
    with pytest.raises(ValueError, match=r"none of its fields depends on \['by_pair'\]"):
        ds.cg.coarse_grain(preset="lammps", axes="z", width=1.0, by="species", by_pair=True)


def test_the_preset_of_lammps_takes_the_kernel_and_the_gradient_that_are_given():
    ds = xcg.datasets.random_scene(300, seed=1)
    own = {"kernel": "lucy", "gradient": "least_squares", "spacing": 2.0, "width": 1.0}
    there = ds.cg.coarse_grain(["density", "velocity/grad"], preset="lammps", **own)
    here = ds.cg.coarse_grain(["density", "velocity_gradient"], **own)
    np.testing.assert_array_equal(there.density, here.density)
    np.testing.assert_array_equal(there.velocity_grad, here.velocity_gradient)


def test_points_have_the_gradient_that_is_given_with_the_preset_of_lammps():
    ds = xcg.datasets.random_scene(300, seed=1)
    at = {"x": xr.DataArray([1.0, 2.0], dims="s"), "y": 2.0, "z": 2.0}
    own = {"at": at, "width": 1.0, "gradient": "least_squares"}
    there = ds.cg.coarse_grain(preset="lammps", **own)
    here = ds.cg.coarse_grain("velocity_gradient", kernel="shifted gaussian", **own)
    np.testing.assert_allclose(there.velocity_grad, here.velocity_gradient, rtol=1e-12)
