"""Motion across periods in files, and files without times."""

import h5py
import netCDF4
import numpy as np
import pandas as pd
import pytest

import xcg
from tests.dumps import dump_text, write
from tests.lammps_forms import BOX, binary_step, write_netcdf
from tests.readers.engines.test_vtk import write_spheres
from xcg.common.messages import SceneError, SceneWarning

# scenes of a few grains
pytestmark = pytest.mark.filterwarnings("ignore:width=.* is larger than the scene")

VELOCITY = np.array([20.5, -7.0, 0.25])  # the periods are 10 along x and y, and z is open
STEPS = 4
LOW = np.array(BOX)[:, 0]
START = np.random.default_rng(4).uniform(0.5, 9.5, (5, 3)) + LOW
STRAIGHT = np.diag([10.0, 10.0, 10.0])
TILTED = np.array([[10.0, 0, 0], [4.0, 10.0, 0], [0, 0, 10.0]])


class Grain:
    """Places of the grains at a step, as codes write them."""

    def __init__(self, step, lattice=STRAIGHT):
        self.unwrapped = START + VELOCITY * step
        fractions = (self.unwrapped - LOW) @ np.linalg.inv(lattice)
        self.image = np.floor(fractions) * [1, 1, 0]
        self.position = self.unwrapped - self.image @ lattice
        self.scaled = fractions - self.image
        self.unwrapped_scaled = fractions

    def rows(self, columns):
        """Rows of columns such as "x y z ix iy iz", between ids and sizes, the last grain first."""
        values = {}
        for k, axis in enumerate("xyz"):
            values[axis] = self.position[:, k]
            values[f"{axis}u"] = self.unwrapped[:, k]
            values[f"{axis}s"] = self.scaled[:, k]
            values[f"{axis}su"] = self.unwrapped_scaled[:, k]
            values[f"i{axis}"] = self.image[:, k]
        ids = np.arange(1.0, len(START) + 1)
        places = [values[name] for name in columns.split()]
        table = [ids, np.ones_like(ids), *places, np.full_like(ids, 0.5), np.ones_like(ids)]
        return np.stack(table, axis=1)[::-1]


def columns_of(places):
    return f"id type {places} radius mass"


def check_motion(ds):
    """Velocities, displacements and diffusion are those of a constant velocity of two periods a step."""
    ds = ds.cg.derive("velocity")
    np.testing.assert_allclose(
        ds.velocity, np.broadcast_to(VELOCITY, ds.velocity.shape), rtol=1e-9, atol=1e-9
    )
    msd = ds.cg.mean_squared_displacement(2, remove_drift=False).mean_squared_displacement
    np.testing.assert_allclose(msd, (VELOCITY**2).sum() * np.array([1, 4]), rtol=1e-9)
    moved = ds.cg.displacement("displacement", axes="", at={"x": 5, "y": 5, "z": 4}, width=20.0)
    np.testing.assert_allclose(
        moved.displacement, np.broadcast_to(VELOCITY, moved.displacement.shape), rtol=1e-9
    )


PLACES = [
    "x y z ix iy iz",
    "x y z ix iy",  # z is not periodic
    "xu yu zu",
    "xu yu z",
    "xs ys zs ix iy iz",
    "xsu ysu zsu",
    "x y z xu yu zu",
    "xs ys zs xsu ysu zsu",
    "xu yu zu ix iy iz",
    "x y z xu yu zu ix iy iz",
]


@pytest.mark.parametrize("places", PLACES)
@pytest.mark.parametrize(("lattice", "form"), [(STRAIGHT, "binary"), (TILTED, "text")])
def test_dumps_tell_motion_across_periods(tmp_path, monkeypatch, places, lattice, form):
    if lattice is TILTED:  # headers hold the bounding box
        monkeypatch.setattr("tests.lammps_forms.BOX", ((0, 14), (0, 10), (-1, 9)))
    tilts = (lattice[1, 0], 0.0, 0.0) if lattice is TILTED else ()
    lines = ["ITEM: BOX BOUNDS pp pp ff", "0 10", "0 10", "-1 9"]
    if tilts:
        lines = ["ITEM: BOX BOUNDS xy xz yz pp pp ff", "0 14 4", "0 10 0", "-1 9 0"]
    parts = []
    for step in range(STEPS):
        rows = Grain(step, lattice).rows(places)
        names = columns_of(places)
        if form == "text":
            text = [" ".join(map(repr, row)) for row in rows.tolist()]
            parts.append(dump_text(text, names, step=step, box="\n".join([*lines, ""])).encode())
        else:
            parts.append(binary_step(rows, names.split(), step=step, tilts=tilts))
    path = tmp_path / ("p.bin" if form == "binary" else "p.dump")
    path.write_bytes(b"".join(parts))
    check_motion(xcg.open_scene(path, timestep=1.0, engine="lammps"))


@pytest.mark.parametrize("vector", ["unwrapped_coordinates", "ix"])
def test_netcdf_tells_motion_across_periods(tmp_path, vector):
    path = tmp_path / "p.nc"
    steps = {k: Grain(k).rows("x y z ix iy iz") for k in range(STEPS)}
    bare = {k: np.delete(rows, [5, 6, 7], axis=1) for k, rows in steps.items()}
    still = {k: np.insert(rows, [5, 5, 5], 0.0, axis=1) for k, rows in bare.items()}
    write_netcdf(path, still, timestep=1.0)
    with netCDF4.Dataset(path, "a") as file:
        file.set_auto_mask(False)
        if vector == "ix":
            for axis in "xyz":
                file.createVariable(f"i{axis}", "i4", ("frame", "atom"))
        else:
            file.createVariable(vector, "f8", ("frame", "atom", "spatial"))
        for k, rows in steps.items():
            for n, axis in enumerate("xyz") if vector == "ix" else ():
                file[f"i{axis}"][k] = rows[:, 5 + n]
            if vector != "ix":
                file[vector][k] = Grain(k).unwrapped[::-1]
    check_motion(xcg.open_scene(path))


def frame_table(places, step):
    names = columns_of(places).split()
    return pd.DataFrame(Grain(step).rows(places), columns=names).assign(time=float(step))


EDGES = {"x": BOX[0], "y": BOX[1], "z": BOX[2]}


@pytest.mark.parametrize("places", ["x y z ix iy iz", "xu yu zu", "x y z xu yu zu"])
@pytest.mark.parametrize("end", ["csv", "parquet", "memory"])
def test_tables_tell_motion_across_periods(tmp_path, places, end):
    table = pd.concat([frame_table(places, step) for step in range(STEPS)])
    if end == "memory":
        check_motion(xcg.scene_from_table(table, box=EDGES, periodic="xy"))
        return
    path = tmp_path / f"p.{end}"
    table.to_csv(path, index=False) if end == "csv" else table.to_parquet(path)
    check_motion(xcg.open_scene(path, box=EDGES, periodic="xy"))


def test_names_map_images_and_unwrapped_positions(tmp_path):
    table = pd.concat([frame_table("x y z ix iy iz", step) for step in range(STEPS)])
    words = {f"i{axis}": f"Periodic Image.{axis.upper()}" for axis in "xyz"}
    table.rename(columns=words).to_csv(tmp_path / "images.csv", index=False)
    names = {f"Periodic Image.{axis.upper()}": f"image_{axis}" for axis in "xyz"}
    check_motion(xcg.open_scene(tmp_path / "images.csv", names=names, box=EDGES, periodic="xy"))


@pytest.mark.parametrize("name", ["image", "unwrapped_position"])
def test_hdf5_tells_motion_across_periods(tmp_path, name):
    with h5py.File(tmp_path / "p.h5", "w") as file:
        for step in range(STEPS):
            grain = Grain(step)
            group = file.create_group(f"particles/{step}")
            group["r"] = grain.position
            group["motion"] = grain.image.astype("i4") if name == "image" else grain.unwrapped
            group["d"] = np.ones(len(START))
            group["id"] = np.arange(len(START))
    mapping = {"position": "r", name: "motion", "diameter": "d", "particle_id": "id"}
    mapping = {key: f"particles/{{time}}/{value}" for key, value in mapping.items()}
    options = {"mapping": mapping, "density": 1.0, "box": EDGES, "periodic": "xy"}
    check_motion(xcg.open_scene(tmp_path / "p.h5", engine="hdf5", **options))


def test_h5md_tells_motion_across_periods(tmp_path):
    grains = [Grain(step) for step in range(STEPS)]
    elements = {
        "position": [grain.position for grain in grains],
        "image": [grain.image.astype("i4") for grain in grains],
        "id": [np.arange(len(START))] * STEPS,
        "diameter": [np.ones(len(START))] * STEPS,
    }
    with h5py.File(tmp_path / "p.h5", "w") as file:
        file.create_group("h5md").attrs["version"] = [1, 1]
        group = file.create_group("particles/all")
        for name, values in elements.items():
            group[f"{name}/value"] = np.array(values)
            group[f"{name}/step"] = np.arange(STEPS)
            group[f"{name}/time"] = np.arange(STEPS, dtype=float)
        box = group.create_group("box")
        box.attrs["dimension"] = 3
        box.attrs["boundary"] = np.array([b"periodic", b"periodic", b"none"])
        box["edges"] = [10.0, 10.0, 10.0]
    check_motion(xcg.open_scene(tmp_path / "p.h5", density=1.0, box=EDGES))


@pytest.mark.parametrize("name", ["i", "image", "Turns"])
def test_vtk_tells_motion_across_periods(tmp_path, name):
    for step in range(STEPS):
        grain = Grain(step)
        arrays = {name: grain.image, "id": np.arange(len(START)), "radius": np.full(5, 0.5)}
        write_spheres(tmp_path / f"p_{step}.vtu", grain.position, **arrays)
    names = {"Turns": "image"} if name == "Turns" else {}
    options = {"names": names, "times": range(STEPS), "density": 1.0, "box": EDGES}
    check_motion(xcg.open_scene(str(tmp_path / "p_*.vtu"), periodic="xy", **options))


# --- what cannot be used ---------------------------------------------------------------------------------


def dump_of(path, places, steps=STEPS, box=None):
    texts = []
    for step in range(steps):
        rows = [" ".join(map(repr, row)) for row in Grain(step).rows(places).tolist()]
        box = box or "ITEM: BOX BOUNDS pp pp ff\n0 10\n0 10\n-1 9\n"
        texts.append(dump_text(rows, columns_of(places), step=step, box=box))
    return write(path, texts)


@pytest.mark.parametrize("places", ["x y z ix", "x y z iy iz", "x y z yu"])
def test_images_along_some_of_the_periodic_axes_warn(tmp_path, places):
    path = dump_of(tmp_path / "p.dump", places)
    with pytest.warns(SceneWarning, match="count periods along some axes only"):
        ds = xcg.open_scene(path, timestep=1.0)
    assert "image" not in ds


def test_unwrapped_positions_of_another_period_raise(tmp_path):
    path = dump_of(tmp_path / "p.dump", "x y z xu yu zu")
    with pytest.raises(
        SceneError, match=r"unwrapped position of particle 1 .* no sum of the periods"
    ):
        xcg.open_scene(path, timestep=1.0, box={"x": (0, 11), "y": (0, 10)})
    names = {"xu": None, "yu": None, "zu": None}
    assert "image" not in xcg.open_scene(
        path, timestep=1.0, names=names, box={"x": (0, 11), "y": (0, 10)}
    )


def test_images_along_an_axis_that_is_not_periodic_raise(tmp_path):
    path = dump_of(tmp_path / "p.dump", "x y z ix iy iz")
    ds = xcg.open_scene(path, timestep=1.0, periodic="x")
    with pytest.raises(SceneError, match="another image along 'y'"):
        ds.cg.derive("velocity").compute()


# --- times that are not known ----------------------------------------------------------------------------


def still_flow(path, steps=(0, 1000, 2000)):
    """Write grains that move by 0.001 a step, without times."""
    rows = [[f"{k} 1 {0.1 * k + 1e-3 * n} 0.5 0.5 0.02 1" for k in range(1, 6)] for n in range(3)]
    texts = [
        dump_text(
            row,
            "id type x y z radius mass",
            step=step,
            box="ITEM: BOX BOUNDS ff ff ff\n0 1\n0 1\n0 1\n",
        )
        for row, step in zip(rows, steps, strict=True)
    ]
    return write(path, texts)


def untimed(tmp_path, kind):
    if kind in ("lammps", "liggghts"):
        return xcg.open_scene(still_flow(tmp_path / f"p.{kind}"), engine=kind, units="SI")
    places = [START * 0.1 + [1e-3 * n, 0, 0] for n in range(3)]
    for n, place in enumerate(places):
        table = pd.DataFrame(place, columns=list("xyz")).assign(id=range(5), radius=0.02)
        table.to_csv(tmp_path / f"p_{1000 * n}.csv", index=False)
        arrays = {"id": np.arange(5), "radius": np.full(5, 0.02)}
        write_spheres(tmp_path / f"p_{1000 * n}.vtu", place, **arrays)
    if kind == "arrays":
        return xcg.scene_from_arrays(places, diameter=np.full((3, 5), 0.04), density=1.0)
    return xcg.open_scene(str(tmp_path / f"p_*.{kind}"), density=1.0)


CENTRE = {"y": 0.5, "z": 0.5}
RATES = {
    "derive": lambda ds: ds.cg.derive("velocity"),
    "mean_squared_displacement": lambda ds: ds.cg.mean_squared_displacement(1),
    "self_diffusion": lambda ds: ds.cg.displacement("self_diffusion"),
    "balance": lambda ds: ds.assign(velocity=0 * ds.position).cg.balance(
        quantities=["mass"], axes="x", extent={"y": 1.0, "z": 1.0}
    ),
    "time_correlation": lambda ds: ds.cg.coarse_grain(
        "density", axes="x", at=CENTRE, width=0.5
    ).cg.time_correlation("density"),
}


@pytest.mark.parametrize("kind", ["lammps", "liggghts", "csv", "vtu", "arrays"])
@pytest.mark.parametrize("rate", RATES)
def test_rates_without_times_raise(tmp_path, kind, rate):
    ds = untimed(tmp_path, kind)
    assert ds.time.attrs["units"] == "1"
    with pytest.raises(SceneError, match=r"times of the steps are not known.* timestep= or times="):
        RATES[rate](ds)


@pytest.mark.parametrize("kind", ["lammps", "csv"])
def test_displacements_need_no_times(tmp_path, kind):
    ds = untimed(tmp_path, kind)
    f = ds.cg.displacement(axes="", at=dict.fromkeys("xyz", 0.4), width=0.5)
    np.testing.assert_allclose(f.displacement.sel(component="x"), 1e-3, rtol=1e-9)
    assert f.displacement.attrs["units"] == "m"
    assert "self_diffusion" not in f
    assert f.interval.attrs == {
        "units": "1",
        "long_name": "steps of the simulation to the later frame",
    }
    np.testing.assert_array_equal(f.interval, 1000)


def test_times_given_at_any_place_make_rates(tmp_path):
    path = still_flow(tmp_path / "p.dump")
    expected = 1e-3 / 0.01
    ds = xcg.open_scene(path)
    scenes = [
        xcg.open_scene(path, timestep=1e-5),
        xcg.open_scene(path, times=[0, 0.01, 0.02]),
        ds.assign_coords(time=[0, 0.01, 0.02]),
        ds.assign_coords(time=ds.time * 1e-5),  # which keeps the attributes of the numbers
        ds.chunk(time=1).assign_coords(time=ds.time * 1e-5),
    ]
    for scene in scenes:
        velocity = scene.cg.derive("velocity").velocity
        np.testing.assert_allclose(velocity.sel(component="x"), expected, rtol=1e-9)


@pytest.mark.parametrize("word", ["dt", "DT", "time_step"])
def test_other_names_of_the_time_step_are_answered(tmp_path, word):
    path = still_flow(tmp_path / "p.dump")
    with pytest.raises(SceneError, match=r"did you mean '?timestep"):
        xcg.open_scene(path, **{word: 1e-5})


def test_engines_without_a_time_step_are_told_of_times(tmp_path):
    path = write(tmp_path / "p.data", "1 0 0 0 0 1 1 1\n")
    with pytest.raises(SceneError, match="did you mean 'times'"):
        xcg.open_scene(path, engine="mercury", dt=1e-5)


def test_strain_rates_of_a_box_need_times():
    places = [START, START, START]
    box = [[[0, 10 - k]] * 3 for k in range(3)]
    ds = xcg.scene_from_arrays(places, diameter=np.ones((3, 5)), density=1.0, box=box)
    with pytest.raises(SceneError, match=r"strain rate of the box: the times .* not known"):
        ds.cg.microstructure("strain_rate", strain_rate="box")
    assert "strain_rate" in ds.assign_coords(time=[0, 1, 2]).cg.microstructure("strain_rate")
