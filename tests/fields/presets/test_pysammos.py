"""The preset of Pysammos: each of its names by an independent computation, and where it errs, the right value."""

import pickle

import numpy as np
import pytest
import xarray as xr

import xcg
from tests.brute_force import BruteKernel, brute_force
from xcg.fields.formulas.tracing import program_for

ISSUE_NAMES = """
volume_fraction density_mixture density_particle d32 d43 coordination_number momentum_density velocity
velocity_gradient kinetic_tensor contact_tensor total_stress_tensor_xyz total_stress_tensor_xyz_mag
total_stress_tensor_xyz_dev total_stress_tensor_xyz_dev_mag total_stress_tensor_xy_dev total_stress_tensor_xy_dev_mag
fabric_tensor shear_rate_tensor_xy shear_rate_tensor_xy_mag shear_rate_tensor_xy_dev shear_rate_tensor_xy_dev_mag
shear_rate_tensor_xyz shear_rate_tensor_xyz_mag shear_rate_tensor_xyz_dev shear_rate_tensor_xyz_dev_mag
pressure_xyz pressure_xy pressure_x pressure_y pressure_z granular_temperature_xyz granular_temperature_x
granular_temperature_y granular_temperature_z inertial_number_Sxy_Pxyz_d43 inertial_number_Sxy_Pxy_d43
inertial_number_Sxy_Py_d43 inertial_number_Sxy_Pxyz_d32 inertial_number_Sxy_Pxy_d32 inertial_number_Sxy_Py_d32
frictional_coefficient_Dxyz_Pxyz frictional_coefficient_Dxyz_Pxy frictional_coefficient_Dxyz_Py
frictional_coefficient_Dxy_Pxyz frictional_coefficient_Dxy_Pxy frictional_coefficient_Dxy_Py
frictional_coefficient_01_Pxyz frictional_coefficient_01_Pxy frictional_coefficient_01_Py
""".split()  # noqa: SIM905


def preset(ds, fields=None, **options):
    return ds.cg.coarse_grain(fields, preset="pysammos", **options)


def by_hand(base, fluctuation):
    """All names at one node from plain numbers, without the package: stress about V(r), temperature about the fit."""
    sigma = base["contact_stress"] + base["kinetic_stress"]
    out = {
        "density_mixture": base["density"], "density_particle": base["particle_density"],
        "kinetic_tensor": base["kinetic_stress"], "contact_tensor": base["contact_stress"],
        "fabric_tensor": base["fabric"],
        **{n: base[n] for n in ("volume_fraction", "d32", "d43", "coordination_number", "momentum_density", "velocity",
                                "velocity_gradient")},
    }  # fmt: skip
    grad = base["velocity_gradient"]
    gamma = np.array([[(grad[i, j] + grad[j, i]) / 2 for j in range(3)] for i in range(3)])
    flat = gamma.copy()
    flat[2, :] = flat[:, 2] = 0.0

    def dev(x, axes):
        keep = np.diag([1.0 if k in axes else 0.0 for k in range(3)])
        cut = keep @ x @ keep
        return cut - keep * sum(x[k, k] for k in axes) / len(axes)

    both = {"xyz": (0, 1, 2), "xy": (0, 1)}
    for dims, axes in both.items():
        d = dev(sigma, axes)
        size = np.sqrt(sum(d[i, j] ** 2 for i in range(3) for j in range(3)) / 2)
        out |= {f"total_stress_tensor_{dims}_dev": d, f"total_stress_tensor_{dims}_dev_mag": size}
        g = gamma if dims == "xyz" else flat
        e = dev(gamma, axes)
        out |= {f"shear_rate_tensor_{dims}": g, f"shear_rate_tensor_{dims}_dev": e}
        out[f"shear_rate_tensor_{dims}_mag"] = np.sqrt(2 * (g**2).sum())
        out[f"shear_rate_tensor_{dims}_dev_mag"] = np.sqrt(2 * (e**2).sum())
        out[f"pressure_{dims}"] = sum(sigma[k, k] for k in axes) / len(axes)
    out |= {
        "total_stress_tensor_xyz": sigma,
        "total_stress_tensor_xyz_mag": np.sqrt((sigma**2).sum() / 2),
    }
    for k, a in enumerate("xyz"):
        out[f"pressure_{a}"] = sigma[k, k]
        out[f"granular_temperature_{a}"] = fluctuation[k, k] / base["density"]
    out["granular_temperature_xyz"] = np.trace(fluctuation) / 3 / base["density"]
    for p in ("xyz", "xy", "y"):
        pressure = out[f"pressure_{p}"]
        for d in ("d43", "d32"):
            number = (
                out["shear_rate_tensor_xy_dev_mag"]
                * base[d]
                * np.sqrt(base["particle_density"] / abs(pressure))
            )
            out[f"inertial_number_Sxy_P{p}_{d}"] = number if pressure > 0 else np.nan
        shears = {
            "Dxyz": "total_stress_tensor_xyz_dev_mag",
            "Dxy": "total_stress_tensor_xy_dev_mag",
        }
        shears = {k: out[v] for k, v in shears.items()} | {"01": abs(sigma[0, 1])}
        for kind, shear in shears.items():
            out[f"frictional_coefficient_{kind}_P{p}"] = (
                shear / pressure if pressure > 0 else np.nan
            )
    return out


def test_all_fields_equal_independent_sums():
    ds = xcg.datasets.random_scene(250, periodic="", seed=3)
    f = preset(ds, width=0.8, spacing=1.0, bounds=dict.fromkeys("xyz", (1.0, 4.0))).isel(time=0)
    more = {"sample_count", "total_stress_tensor_xy", "total_stress_tensor_xy_mag"}
    assert set(f.data_vars) == {*ISSUE_NAMES, *more}
    x, v, m = (ds[n].values[0] for n in ("position", "velocity", "mass"))
    kernel = BruteKernel("lucy", 0.8)
    nodes = np.stack(np.meshgrid(f.x, f.y, f.z, indexing="ij"), axis=-1).reshape(-1, 3)
    some = np.random.default_rng(0).permutation(len(nodes))[:8]
    truth = brute_force(ds, kernel, nodes[some])
    checked = 0
    for row, n in enumerate(some):
        base = {name: values[row] for name, values in truth.items()}
        if base["velocity_gradient"] is None:
            continue
        w = m * kernel(np.linalg.norm(x - nodes[n], axis=1))
        mean = (w @ v) / w.sum()
        rest = v - mean - (x - (w @ x) / w.sum()) @ base["velocity_gradient"].T
        expected = by_hand(base, np.einsum("n,ni,nj->ij", w, rest, rest))
        assert set(expected) == set(ISSUE_NAMES)
        at = f.isel(dict(zip("xyz", np.unravel_index(n, (4, 4, 4)), strict=True)))
        for name, value in expected.items():
            # contact stress is exact relative to the largest segment; the forces cancel here
            np.testing.assert_allclose(at[name].values, value, rtol=1e-8, atol=1e-9, err_msg=name)
        checked += 1
    assert checked >= 4


def test_temperature_about_the_node():
    """With its own least squares: v' = v_i - V - G (r_i - r), whatever the temperature of xcg divides by."""
    ds = xcg.datasets.random_scene(250, periodic="", seed=3)
    x, v, m = (ds[n].values[0] for n in ("position", "velocity", "mass"))
    kernel = BruteKernel("lucy", 0.9)
    for r in np.random.default_rng(0).uniform(1.5, 3.5, (5, 3)):
        w = m * kernel(np.linalg.norm(x - r, axis=1))
        at = dict(zip("xyz", r, strict=True))
        mean = w @ v / w.sum()
        root = np.sqrt(w)[:, None]
        gradient = np.linalg.lstsq(root * (x - r), root * (v - mean), rcond=None)[0].T
        rest = v - mean - (x - r) @ gradient.T
        expected = w @ rest**2 / w.sum()
        f = preset(ds, "granular_temperature", gradient="paper", width=0.9, axes="", at=at).isel(
            time=0
        )
        for k, a in enumerate("xyz"):
            assert f[f"granular_temperature_{a}"].item() == pytest.approx(expected[k], rel=1e-9)
        assert f.granular_temperature_xyz.item() == pytest.approx(expected.mean(), rel=1e-9)


def test_fields_are_computed_in_one_pass_with_those_of_xcg():
    ds = xcg.datasets.random_scene(60)
    plans = [ds.cg.explain(preset="pysammos", width=0.9) for _ in range(2)]
    programs = [program_for(plan.fields, plan.options) for plan in plans]
    assert set(programs[0].widths) == set(plans[0].fields) >= set(ISSUE_NAMES)
    assert programs[0] is programs[1]  # traced once
    sent = pickle.loads(pickle.dumps(plans[0]))
    assert sent.options.own == plans[0].options.own


def test_units_equal_those_of_the_quantities():
    f = preset(xcg.datasets.random_scene(60), width=0.9)
    expected = {"density_mixture": "kg m^-3", "pressure_xy": "Pa", "total_stress_tensor_xy_dev_mag": "Pa",
                "shear_rate_tensor_xy_mag": "s^-1", "granular_temperature_x": "m^2 s^-2", "d32": "m",
                "inertial_number_Sxy_Py_d32": "1"}  # fmt: skip
    assert {n: f[n].attrs["units"] for n in expected} == expected


def test_keys_choose_families_and_planes():
    ds = xcg.datasets.random_scene(60)
    f = preset(ds, ["pressure", "inertial_number", "velocity"], shear_dims="xz", width=0.9)
    assert set(f) - {"sample_count"} == {
        "velocity", *(f"pressure_{p}" for p in ("xyz", "xz", "x", "y", "z")),
        *(f"inertial_number_Sxz_P{p}_{d}" for p in ("xyz", "xz", "z") for d in ("d43", "d32")),
    }  # fmt: skip
    options = {
        "width": 0.9,
        "shear_dims": "xz",
        "pressure_dims": "z",
        "deviatoric": "both",
        "size": "d32",
    }
    ours = ds.cg.coarse_grain(["inertial_number", "pressure"], **options)
    np.testing.assert_allclose(f.pressure_z, ours.pressure, rtol=1e-9)
    assert ours.inertial_number.notnull().sum() > 100
    np.testing.assert_allclose(f.inertial_number_Sxz_Pz_d32, ours.inertial_number, rtol=1e-9)


def test_lazy_scenes_phases_and_wrong_arguments():
    ds = xcg.datasets.random_scene(100)
    eager = preset(ds, width=0.9, by="species")
    lazy = preset(ds.chunk(time=1), width=0.9, by="species")
    assert lazy.inertial_number_Sxy_Py_d32.chunks is not None
    xr.testing.assert_equal(lazy.compute(), eager)
    assert eager.pressure_xy.dims == ("time", "x", "y", "z", "phase")
    bare = ds.drop_vars([n for n in ds.data_vars if str(n).startswith("contact")])
    assert "velocity" in preset(bare, width=0.9)
    assert "pressure_xy" not in preset(bare, width=0.9)
    for options, message in (
        ({"fields": "densty"}, "preset='pysammos': unknown field 'densty'"),
        ({"size": "d32"}, "has a name for each variant"),
        ({"temperature": "unbiased"}, "has a name for each variant"),
        ({"for_averages": True}, "averages take fields under names of xcg"),
        ({"shear_dims": "x"}, "two axes of 'xyz'"),
    ):
        with pytest.raises(ValueError, match=message):
            preset(ds, **options)
    with pytest.raises(ValueError, match="expected one of 'pysammos', 'lammps', None"):
        ds.cg.coarse_grain(preset="mercury")


def its_nodes(first, last, c):
    """As Pysammos makes them: ends included, at most c / 2 apart."""
    return np.linspace(first, last, int(np.ceil(2 * (last - first) / c)) + 1)


def test_the_mesh_equals_that_of_pysammos():
    ds = xcg.datasets.simple_cubic(14)  # centres from 0 to 13
    c = 1.5
    margin = 2.5 * 1.5 + 0.5
    mesh = xcg.pysammos_mesh(ds, "xz")
    f = ds.cg.coarse_grain("density", **mesh)
    for a in "xz":
        np.testing.assert_allclose(f[a], its_nodes(margin, 13 - margin, c), rtol=1e-12)
        assert len(f[a]) == 7  # and not nodes at c / 2 from the first, which are six
    assert float(f.y) == 6.5
    with pytest.raises(ValueError, match=r"less than twice the margin .* along \['x', 'y', 'z'\]"):
        xcg.pysammos_mesh(xcg.datasets.simple_cubic(5))


@pytest.mark.parametrize(("last", "count"), [(3.0, 5), (3.0001, 6), (0.1, 2), (0.0, 1)])
def test_the_mesh_divides_given_bounds(last, count):
    ds = xcg.datasets.simple_cubic(5)
    mesh = xcg.pysammos_mesh(ds, "xy", bounds={"x": (0, last), "y": (1, 2)}, at={"z": 1.5})
    f = ds.cg.coarse_grain("density", **mesh)
    np.testing.assert_allclose(f.x, its_nodes(0, last, 1.5), rtol=1e-12, atol=1e-15)
    assert f.sizes["x"] == count
    np.testing.assert_allclose(f.y, [1, 1.5, 2], rtol=1e-12)
    assert float(f.z) == 1.5
    with pytest.raises(ValueError, match=r"along \['y'\]"):
        xcg.pysammos_mesh(ds, "xy", bounds={"x": (0, last)})
    for options in ({"axes": "xq"}, {"bounds": {"q": (0, 1)}}, {"at": {"q": 0.0}}):
        with pytest.raises(ValueError, match=r"names \['q'\]: the axes of this scene are x, y, z"):
            xcg.pysammos_mesh(ds, **options)
    for ends in ((2.0, 1.0), (0.0, np.nan), (0.0, np.inf)):
        with pytest.raises(ValueError, match="expected \\(first, last\\)"):
            ds.cg.coarse_grain("density", **xcg.pysammos_mesh(ds, "x", bounds={"x": ends}))


def test_fabric_is_smeared_along_the_branch():
    """Ours is of the grains at their centres: as much in all, elsewhere by a part of the width."""
    ds = xcg.datasets.random_scene(250, periodic="", seed=3)
    x, volume = (ds[n].values[0] for n in ("position", "volume"))
    i, j, point = (ds[f"contact_{n}"].values[0] for n in ("i", "j", "point"))
    kernel = BruteKernel("lucy", 0.75 * ds.attrs["d43"])
    found = []
    theirs = []
    for r in np.random.default_rng(1).uniform(1.5, 3.5, (20, 3)):
        at = dict(zip("xyz", r, strict=True))
        f = preset(ds, "fabric_tensor", width=0.75 * ds.attrs["d43"], axes="", at=at)
        found.append(f.fabric_tensor.values[0])
        total = np.zeros((3, 3))
        for a, b, c in zip(i, j, point, strict=True):
            if b >= 0:
                n = (x[a] - x[b]) / np.linalg.norm(x[a] - x[b])
                for own in (a, b):
                    total += volume[own] * kernel.segment(r, x[own], c) * np.outer(n, n)
        theirs.append(total)
    difference = np.subtract(found, theirs)
    assert 0.09 < np.sqrt((difference**2).mean() / np.square(theirs).mean()) < 0.10


# --- where it errs: the right value, and by how much -----------------------------------------------------


@pytest.mark.parametrize(("kernel", "low"), [("lucy", (0.002, 0.008)), ("heaviside", (0.18, 0.30))])
def test_contacts_are_found_by_their_segments_not_by_the_particle_s_centre(kernel, low):
    ds = xcg.datasets.face_centred_cubic(3)
    edge = float(ds.box.values[0, 0, 1])
    position = ds.position.values[0]
    points = np.random.default_rng(0).uniform(0, edge, (12, 3))
    k = BruteKernel(kernel, 0.75)
    whole, centred, ours = 0.0, 0.0, 0.0
    for r in points:
        at = dict(zip("xyz", r, strict=True))
        f = ds.cg.coarse_grain(
            "contact_tensor", preset="pysammos", kernel=kernel, width=0.75, axes="", at=at
        )
        ours += float(np.trace(f.contact_tensor.values[0])) / 3
        for i, j, force in zip(
            ds.contact_i.values[0], ds.contact_j.values[0], ds.contact_force.values[0], strict=True
        ):
            branch = position[i] - position[j]
            branch -= edge * np.rint(branch / edge)
            for own, side in ((i, branch / 2), (j, -branch / 2)):
                d = position[own] - r
                d -= edge * np.rint(d / edge)
                share = k.segment(np.zeros(3), d, d - side) * abs(force @ side) / 3
                whole += share
                centred += share * (np.linalg.norm(d) < k.c)
    assert ours == pytest.approx(whole, rel=1e-9)
    assert low[0] < 1 - centred / whole < low[1]


def test_stress_of_a_lattice_is_the_closed_form():
    f = preset(xcg.datasets.face_centred_cubic(4), "pressure", width=2.0)
    np.testing.assert_allclose(f.pressure_xyz, 2 * np.sqrt(2), rtol=5e-3)


def test_images_at_faces_and_corners_are_counted():
    lattice = xcg.datasets.simple_cubic(6)
    ds = lattice.assign(position=lattice.position + 0.5).drop_vars(
        [n for n in lattice if str(n).startswith("contact")]
    )
    for at, share in (
        ({"x": 0.0, "y": 3.0, "z": 3.0}, 1 / 2),
        ({"x": 0.0, "y": 0.0, "z": 0.0}, 1 / 8),
    ):
        inside = preset(
            ds, "density_mixture", axes="", at=dict.fromkeys("xyz", 3.0), width=0.75
        ).density_mixture
        here = preset(ds, "density_mixture", axes="", at=at, width=0.75).density_mixture
        assert here.item() == pytest.approx(inside.item(), rel=1e-12)
        cut = preset(
            ds.assign_attrs(periodic=""), "density_mixture", axes="", at=at, width=0.75
        ).density_mixture
        assert (cut / here).item() == pytest.approx(share, rel=1e-12)


def test_the_period_is_the_box_not_the_extent_of_the_centres():
    ds = xcg.datasets.random_scene(150, edge=3.0, seed=2, polydispersity=1.0)
    position = ds.position.values[0]
    edge = 3.0
    difference = position[ds.contact_i.values[0]] - position[ds.contact_j.values[0]]
    across = (np.abs(difference) > edge / 2).any(axis=1)
    right = difference - edge * np.rint(difference / edge)
    extent = np.ptp(position, axis=0)
    wrong = difference - extent * np.rint(difference / extent)
    error = np.linalg.norm(wrong - right, axis=1)[across] / np.linalg.norm(right, axis=1)[across]
    assert across.sum() >= 10
    assert error.mean() > 0.02
    # virial: the stress summed over the box is the sum of force times branch
    f = preset(ds, "contact_tensor", width=0.5, spacing=0.125)
    total = f.contact_tensor.isel(time=0).sum(["x", "y", "z"]).values * 0.125**3
    virial = np.einsum("ni,nj->ij", ds.contact_force.values[0], right)
    np.testing.assert_allclose(total, virial, atol=2e-3 * np.abs(virial).max())


def test_the_kernel_is_evaluated_not_looked_up():
    ds = xcg.scene_from_arrays(
        [[0.0, 0, 0]], velocity=np.zeros((1, 3)), diameter=[1.0], density=1.0
    )
    for r in (0.1, 0.7, 1.3):
        f = preset(ds, "density_mixture", axes="", at={"x": r, "y": 0, "z": 0}, width=0.75)
        psi = 105 / (16 * np.pi * 1.5**3) * (1 - r / 1.5) ** 3 * (1 + 3 * r / 1.5)
        assert f.density_mixture.item() == pytest.approx(psi * np.pi / 6, rel=1e-13)
    # what the outer edge of 1000 bins costs in mass
    q = (np.arange(100_000) + 0.5) / 100_000
    lucy = lambda q: (1 - q) ** 3 * (1 + 3 * q) * (q <= 1)  # noqa: E731
    table = (lucy(np.ceil(1000 * q) / 1000) * q**2).sum() / (lucy(q) * q**2).sum() - 1
    assert table == pytest.approx(-2.6e-3, rel=0.02)


def test_temperature_is_zero_in_linear_shear():
    rng = np.random.default_rng(0)
    ds = xcg.datasets.random_scene(600, periodic="", seed=1)
    shear = np.zeros((1, 600, 3))
    shear[..., 0] = 2.0 * ds.position.values[..., 1]
    options = {"width": 0.6, "spacing": 0.6, "bounds": dict.fromkeys("xyz", (1.5, 3.5))}
    sheared = ds.assign(velocity=ds.velocity.copy(data=shear))
    t = preset(sheared, "granular_temperature", **options).granular_temperature_xyz
    assert np.isfinite(t).all()
    assert float(t.max()) < 1e-14
    steps = preset(
        sheared, "granular_temperature", gradient="finite_difference", **options
    ).granular_temperature_xyz
    assert float(steps.max()) > 1e-3
    # uncorrelated velocities of variance 1 on a lattice: every fit takes its freedoms out, the fewer grains the more
    gas = xcg.datasets.face_centred_cubic(6)
    gas = gas.assign(velocity=gas.velocity.copy(data=rng.normal(size=gas.velocity.shape)))
    low = {}
    for gradient in ("least_squares", "finite_difference"):
        for width in (0.75, 2.5):
            f = preset(gas, "granular_temperature", gradient=gradient, width=width, spacing=width)
            low[gradient, width] = 1 - float(f.granular_temperature_xyz.mean())
    assert 0.30 < low["finite_difference", 0.75] < 0.45
    assert 0.40 < low["least_squares", 0.75] < 0.55
    assert max(low["finite_difference", 2.5], low["least_squares", 2.5]) < 0.05


@pytest.mark.parametrize("scale", [1.0, 3e-3, 1e-6])
def test_velocity_gradient_of_small_grains_and_its_order(scale):
    ds = xcg.datasets.random_scene(300, periodic="", seed=4)
    small = xcg.scene_from_arrays(
        ds.position.values[0] * scale, diameter=ds.diameter.values[0] * scale, density=2500.0,
        velocity=np.stack([3.0 * ds.position.values[0][:, 2] * scale, *np.zeros((2, 300))], axis=1),
    )  # fmt: skip
    f = preset(
        small, "velocity_gradient", width=0.8 * scale, axes="", at=dict.fromkeys("xyz", 2.5 * scale)
    )
    expected = np.zeros((3, 3))
    expected[0, 2] = 3.0  # dVx / dz, and nothing in dVz / dx
    np.testing.assert_allclose(f.velocity_gradient.values[0], expected, atol=1e-10)


def test_magnitudes_take_both_triangles():
    i = [0]
    j = [1]
    force = [[1.0, 5.0, 0.0]]
    ds = xcg.scene_from_arrays(
        [[0.5, 0, 0], [-0.5, 0, 0]], velocity=np.zeros((2, 3)), diameter=[1.0, 1.0], density=1.0,
        contact_i=i, contact_j=j, contact_force=force,
    )  # fmt: skip
    f = ds.cg.coarse_grain(
        ["deviatoric_stress", "shear_stress"], axes="", at=dict.fromkeys("xyz", 0.0), width=1.0
    )
    s = f.deviatoric_stress.values[0]
    assert s[0, 1] == 0  # force along y, branch along x: only sigma_yx
    assert s[1, 0] > 0
    assert f.shear_stress.item() == pytest.approx(np.sqrt((s**2).sum() / 2), rel=1e-14)
    upper = np.sqrt((np.triu(s) ** 2).sum() / 2)
    assert upper < 0.6 * f.shear_stress.item()


@pytest.mark.parametrize("width", [0.75, 1.5, 3.0])
def test_a_layer_does_not_scale_with_the_width(width):
    n, thickness = 12, 1.0
    position = np.stack(
        [*np.meshgrid(np.arange(n) + 0.5, np.arange(n) + 0.5), np.zeros((n, n))], axis=-1
    )
    ds = xcg.scene_from_arrays(
        position.reshape(-1, 3), velocity=np.zeros((n * n, 3)), diameter=np.ones(n * n), density=2000.0, dimension=2,
        periodic="xy", box={"x": (0, n), "y": (0, n)}, thickness=thickness,
    )  # fmt: skip
    f = preset(ds, ["volume_fraction", "density_mixture"], width=width, spacing=0.25)
    assert float(f.volume_fraction.mean()) == pytest.approx(np.pi / 6 / thickness, rel=1e-4)
    assert float(f.density_mixture.mean()) == pytest.approx(2000 * np.pi / 6, rel=1e-4)


def test_a_profile_of_a_constant_is_that_constant():
    ds = xcg.datasets.simple_cubic(4)
    exact = preset(ds, ["volume_fraction", "pressure"], axes="z", width=2.0)
    np.testing.assert_allclose(exact.volume_fraction, np.pi / 6, rtol=3e-3)
    np.testing.assert_allclose(exact.pressure_xyz, 1.0, rtol=3e-3)
    n = 5  # what (n / (n - 1))^2 makes of it on 5 x 5 nodes
    assert (n / (n - 1)) ** 2 == pytest.approx(1.5625)


# --- what makes it stop ----------------------------------------------------------------------------------


@pytest.mark.parametrize("plane", ["xy", "xz", "yz"])
def test_fields_on_every_plane(plane):
    ds = xcg.datasets.random_scene(150, seed=5)
    (across,) = set("xyz") - set(plane)
    f = preset(ds, axes=plane, at={across: 2.5}, width=0.8, spacing=1.0)
    whole = preset(ds, axes="xyz", width=0.8, spacing=1.0, bounds={across: (2.5, 2.5)})
    for name in f:
        xr.testing.assert_allclose(f[name], whole[name].isel({across: 0}), rtol=1e-9, atol=1e-9)


def test_a_line_as_vtkhdf(tmp_path):
    pytest.importorskip("vtk")
    from tests.writers.test_vtkhdf import read

    ds = xcg.datasets.random_scene(150, seed=5)
    f = preset(ds, ["density_mixture", "velocity"], axes="z", at={"x": 2.5, "y": 2.5}, width=0.8)
    _, _, (got,) = read(f.cg.save(tmp_path / "line.vtkhdf"))
    np.testing.assert_array_equal(got["density_mixture"].ravel(), f.density_mixture.values.ravel())


def test_steps_without_contacts_and_grains_that_enter():
    a = xcg.datasets.random_scene(40, seed=1)
    b = xcg.datasets.random_scene(60, seed=2)
    names = ["velocity", "diameter", "contact_i", "contact_j", "contact_force", "contact_point"]
    second = {n: b[n].values[0] for n in names}
    first = {
        n: a[n].values[0] if not n.startswith("contact") else b[n].values[0][:0] for n in names
    }
    ds = xcg.scene_from_arrays(
        [a.position.values[0], b.position.values[0]], density=2500.0, box=[[0, 5.0]] * 3, periodic="xyz",
        **{n: [first[n], second[n]] for n in names},
    )  # fmt: skip
    f = preset(ds, width=0.8, spacing=1.0)
    assert (f.contact_tensor.isel(time=0) == 0).all()
    assert float(np.abs(f.contact_tensor.isel(time=1)).max()) > 0
    alone = preset(b, width=0.8, spacing=1.0)
    np.testing.assert_allclose(
        f.density_mixture.isel(time=1), alone.density_mixture.isel(time=0), rtol=1e-12
    )


def test_unknown_ids_are_named_or_become_walls():
    given = {"velocity": np.zeros((2, 3)), "diameter": [1.0, 1.0], "density": 1.0, "contact_i": [0], "contact_j": [7],
             "contact_force": [[1.0, 0, 0]], "contact_point": [[-0.5, 0, 0]]}  # fmt: skip
    with pytest.raises(xcg.SceneError, match="contact_j=7, and no particle has this id"):
        xcg.scene_from_arrays([[0.0, 0, 0], [3, 0, 0]], **given)
    ds = xcg.scene_from_arrays([[0.0, 0, 0], [3, 0, 0]], allow_unknown=True, **given)
    f = preset(ds, "contact_tensor", axes="", at=dict.fromkeys("xyz", 0.0), width=0.75)
    assert float(f.contact_tensor.values[0, 0, 0]) > 0


def test_empty_nodes_are_unknown_with_a_count_of_zero():
    ds = xcg.scene_from_arrays(
        [[0.0, 0, 0], [9.0, 0, 0]], velocity=np.ones((2, 3)), diameter=[1.0, 1.0], density=1.0
    )
    f = preset(ds, axes="x", at={"y": 0, "z": 0}, bounds={"x": (0, 9)}, spacing=4.5, width=1.2)
    assert f.sample_count.values.tolist() == [[1, 0, 1]]
    assert float(f.density_mixture[0, 1]) == 0
    # one grain is too few for a fit: no temperature, but no unknown stress
    assert np.isnan(f.granular_temperature_xyz.values[0, 0])
    assert (f.kinetic_tensor.values[0, 0] == 0).all()
    for name in (
        "velocity",
        "density_particle",
        "d43",
        "granular_temperature_xyz",
        "velocity_gradient",
    ):
        assert np.isnan(f[name].values[0, 1]).all()
