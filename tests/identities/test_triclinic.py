"""A sheared triclinic box of LAMMPS: its own stress and volume, and no trace of its edges."""

from __future__ import annotations

import numpy as np
import pytest

import xcg
from tests import ROOT
from tests.dumps import write
from xcg import SceneError, SceneWarning

DATA = ROOT / "examples" / "data" / "lammps_triclinic"
RATE = 0.5
pytestmark = pytest.mark.filterwarnings("ignore:.*a node sees:xcg.SceneWarning")


@pytest.fixture(scope="module")
def sheared():
    return xcg.open_scene(DATA / "particles.dump.gz", contacts=DATA / "contacts.dump.gz")


@pytest.fixture(scope="module")
def thermo():
    return np.genfromtxt(DATA / "thermo.txt", names=True)


def test_the_box_equals_that_of_lammps_and_moves_as_it_is_deformed(sheared, thermo):
    lengths = sheared.box[..., 1] - sheared.box[..., 0]
    np.testing.assert_allclose(
        lengths, np.column_stack([thermo[n] for n in ("lx", "ly", "lz")]), rtol=1e-12
    )
    np.testing.assert_allclose(sheared.box[..., 0], np.zeros((6, 3)), atol=1e-12)
    for name, vector, axis in (("xy", "b", "x"), ("xz", "c", "x"), ("yz", "c", "y")):
        np.testing.assert_allclose(
            sheared.lattice.sel(vector=vector, component=axis), thermo[name], rtol=1e-11
        )
    assert (np.diff(thermo["xy"]) < 0).any()  # LAMMPS flipped the box in between
    expected = np.zeros((6, 3, 3))
    expected[:, 1, 0] = RATE * thermo["ly"]
    np.testing.assert_allclose(sheared.lattice_velocity, expected, rtol=1e-9, atol=1e-9)


def test_the_mean_of_stress_and_volume_fraction_equal_those_of_lammps(sheared, thermo):
    f = sheared.cg.coarse_grain(
        ["contact_stress", "volume_fraction", "density"], axes="", width=0.75
    )
    stress = f.contact_stress.transpose("time", ...).values
    for name in ("pxx", "pyy", "pzz", "pxy", "pxz", "pyz"):
        i, j = ("xyz".index(a) for a in name[1:])
        # LAMMPS sums r_x f_y for xy; friction makes that of yx another
        np.testing.assert_allclose(
            stress[:, j, i], thermo[name], rtol=0, atol=1e-6 * thermo["pxx"].max(), err_msg=name
        )
    np.testing.assert_allclose(f.volume_fraction, 400 * np.pi / 6 / thermo["volume"], rtol=1e-7)
    # the mean over a mesh is the same
    mesh = sheared.isel(time=[0, 4]).cg.coarse_grain(
        "contact_stress", width=0.75, spacing=0.4, axes="xyz"
    )
    np.testing.assert_allclose(
        mesh.contact_stress.mean([*"xyz"]), stress[[0, 4]], rtol=0, atol=1e-3 * stress.max()
    )


def test_the_flow_is_the_same_at_the_edges_of_the_box(sheared):
    options = {
        "axes": "yz",
        "width": 1.0,
        "spacing": {"y": 0.5, "z": 1.0},
        "bounds": {"y": (-3.5, 10), "z": (0, 6)},
    }
    fields = ["velocity", "velocity_gradient", "granular_temperature", "volume_fraction"]
    f = sheared.cg.coarse_grain(fields, **options)
    step = 14  # nodes in a period along y
    jump = f.velocity.values[:, step:] - f.velocity.values[:, :-step]
    np.testing.assert_allclose(
        jump, np.broadcast_to([RATE * 7.0, 0, 0], jump.shape), rtol=0, atol=1e-6
    )
    for name in ("velocity_gradient", "granular_temperature", "volume_fraction"):
        values = f[name].transpose("time", "y", ...).values
        np.testing.assert_allclose(values[:, step:], values[:, :-step], rtol=1e-6, atol=1e-6)
    one = f.isel(y=slice(7, 7 + step))
    rate = one.velocity_gradient.sel(component="x", direction="y").values
    assert abs(rate.mean() - RATE) < 0.1 * RATE
    still = xcg.open_scene(DATA / "particles.dump.gz", shear_rate={}).cg.coarse_grain(
        fields, **options
    )
    jump = still.velocity_gradient.sel(component="x", direction="y").values
    assert np.abs(jump - RATE).max() > 2 * np.abs(rate - RATE).max()
    edge = [g.granular_temperature.sel(y=0.0).mean().compute() for g in (still, f)]
    assert edge[0] > 2 * edge[1]
    with pytest.raises(SceneError, match="along x and z are shifted along y"):
        sheared.cg.coarse_grain("velocity", axes="y", width=1.0).load()


def test_contacts_found_equal_those_of_lammps(sheared):
    one = sheared.isel(time=[4])
    found = one.drop_dims("contact").cg.find_contacts()

    def pairs(ds):
        i = ds.contact_i.values[0]
        j = ds.contact_j.values[0]
        return {
            (min(a, b), max(a, b)) for a, b in zip(i.tolist(), j.tolist(), strict=True) if a >= 0
        }

    missed = pairs(found) ^ pairs(one)
    assert len(pairs(one)) > 600
    assert len(missed) <= 2  # overlaps of the rounding of positions


def test_contact_points_are_between_images_that_touch(sheared):
    forces = sheared.cg.coarse_grain("contact_force_density", axes="", width=0.75)
    assert np.isfinite(forces.contact_force_density).all()
    lazy = sheared.isel(time=4)
    m = lazy.cg.microstructure(["coordination_number", "volume_fraction"])
    assert float(m.volume_fraction) == pytest.approx(400 * np.pi / 6 / (8 * 7 * 6.561), rel=1e-7)
    assert 3 < float(m.coordination_number) < 7


ROWS = "1 0.25 0.5 0.75 0 0 0 0.5\n2 0.0 0.0 0.5 0 0 0 0.5\n"


def dump(bounds, columns="id xs ys zs vx vy vz radius", rows=ROWS, step=0):
    return (
        f"ITEM: UNITS\nlj\nITEM: TIMESTEP\n{step}\nITEM: NUMBER OF ATOMS\n2\nITEM: BOX BOUNDS xy xz yz pp pp pp\n"
        f"{bounds}ITEM: ATOMS {columns}\n{rows}"
    )


def test_scaled_positions_in_a_tilted_box(tmp_path):
    # a = (4, 0, 0), b = (-1, 5, 0), c = (0.5, 2, 6), from the corner (1, 2, 3)
    path = write(tmp_path / "p.dump", dump("0.0 5.5 -1.0\n2.0 9.0 0.5\n3.0 9.0 2.0\n"))
    ds = xcg.open_scene(path, density=1.0)
    np.testing.assert_allclose(ds.box[0], [[1.0, 5.0], [2.0, 7.0], [3.0, 9.0]])
    cell = np.array([[4, 0, 0], [-1, 5, 0], [0.5, 2, 6]])
    np.testing.assert_allclose(ds.lattice[0], cell)
    place = np.array([1, 2, 3]) + np.array([[0.25, 0.5, 0.75], [0, 0, 0.5]]) @ cell
    np.testing.assert_allclose(ds.position[0], place)
    assert "tilted" in repr(ds.cg)


def test_tilts_without_times_give_no_shear_rate(tmp_path):
    for step, tilt in ((0, 0.0), (10, 0.5)):
        write(tmp_path / f"p{step}.dump", dump(f"0.0 {4 + tilt} {tilt}\n0 5 0\n0 6 0\n", step=step))
    with pytest.warns(SceneWarning, match="the times of the steps are not known"):
        ds = xcg.open_scene(str(tmp_path / "p*.dump"), density=1.0)
    assert "lattice" in ds
    assert "lattice_velocity" not in ds
    ds = xcg.open_scene(str(tmp_path / "p*.dump"), density=1.0, timestep=0.1)
    np.testing.assert_allclose(ds.lattice_velocity.sel(vector="b", component="x"), 0.5)


def test_general_triclinic_boxes_raise(tmp_path):
    text = dump("0 1 0\n0 1 0\n0 1 0\n").replace("xy xz yz", "abc origin")
    with pytest.raises(SceneError, match="triclinic/general no"):
        xcg.open_scene(write(tmp_path / "p.dump", text), density=1.0)


def test_grains_written_by_images_that_move_give_the_same_fields(sheared):
    one = sheared.isel(time=[4]).load()
    numbers = np.random.default_rng(1).integers(-2, 3, (one.sizes["particle"], 3))
    two = one.copy()
    for name, vectors in (("position", one.lattice), ("velocity", one.lattice_velocity)):
        two[name] = (one[name].dims, one[name].values + numbers @ vectors.values[0])
    fields = [
        "momentum_density", "velocity_gradient", "kinetic_stress", "granular_temperature", "contact_stress", "fabric",
        "kinetic_energy", "kinetic_energy_flux", "dissipation_rate", "contact_energy_flux", "contact_power",
        "heat_flux", "vorticity",
    ]  # fmt: skip
    options = {"width": 1.0, "spacing": 2.0, "bounds": dict.fromkeys("xyz", (0.0, 6.0))}
    a = one.cg.coarse_grain(fields, **options)
    b = two.cg.coarse_grain(fields, **options)
    for name in fields:
        atol = 1e-9 * float(np.abs(a[name]).max())
        np.testing.assert_allclose(a[name], b[name], rtol=0, atol=atol, err_msg=name)
