"""Directors: isotropic 0, aligned 1, tensors that turn with the scene, quaternions, brute force."""

import numpy as np
import pytest
import xarray as xr

import xcg

NAMES = [
    "orientation_tensor",
    "nematic_tensor",
    "nematic_order",
    "nematic_director",
    "number_density",
]


def rods(director, count=4000, seed=1, **options):
    rng = np.random.default_rng(seed)
    n = director(rng, count)
    return xcg.scene_from_arrays(
        rng.uniform(0, 6, (count, 3)), diameter=rng.uniform(0.3, 0.6, count), density=1.0, director=n,
        species=rng.integers(1, 3, count), box=dict.fromkeys("xyz", (0.0, 6.0)), periodic="xyz", **options,
    )  # fmt: skip


def isotropic(rng, count):
    n = rng.normal(size=(count, 3))
    return n / np.linalg.norm(n, axis=1, keepdims=True)


def test_order_of_isotropic_directors_is_zero_and_of_aligned_ones_one():
    f = rods(isotropic).cg.coarse_grain(NAMES, axes="")
    np.testing.assert_allclose(f.orientation_tensor.values[0], np.eye(3) / 3, atol=0.02)
    assert f.nematic_order.item() == pytest.approx(0.0, abs=0.05)
    one = np.array([2.0, -1.0, 0.5]) / np.linalg.norm([2.0, -1.0, 0.5])
    signs = rods(lambda rng, count: rng.choice([-1.0, 1.0], (count, 1)) * one).cg.coarse_grain(
        NAMES, axes=""
    )
    assert signs.nematic_order.item() == pytest.approx(1.0, rel=1e-12)
    np.testing.assert_allclose(signs.nematic_director.values[0], one, atol=1e-12)


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (2.0, -1.0, 0.5)])
def test_order_of_directors_spread_over_a_plane_is_minus_one_half(normal):
    """Plates whose normals turn, or rods on a floor: the axis is the normal of the plane."""
    normal = np.array(normal) / np.linalg.norm(normal)
    across = np.cross(normal, [1.0, 0.3, 0.2])
    across /= np.linalg.norm(across)
    basis = np.stack([across, np.cross(normal, across)])

    def even(rng, count):
        angle = 2 * np.pi * np.arange(count) / count
        return np.stack([np.cos(angle), np.sin(angle)], axis=1) @ basis

    f = rods(even).cg.coarse_grain(NAMES, axes="")
    assert f.nematic_order.item() == pytest.approx(-0.5, rel=1e-12)
    np.testing.assert_allclose(f.nematic_director.values[0], normal, atol=1e-12)


def test_brute_force_at_a_node_with_phases():
    ds = rods(isotropic, 300)
    at = {"x": 2.0, "y": 3.0, "z": 2.5}
    width = 0.8
    f = ds.cg.coarse_grain(NAMES, axes="", at=at, width=width, by="species")
    apart = ds.position.values[0] - list(at.values())
    apart -= 6 * np.rint(apart / 6)
    w = xcg.Lucy(width, dimension=3).value(np.linalg.norm(apart, axis=1))
    n = ds.director.values[0]
    for phase, some in (("bulk", slice(None)), ("1", ds.species.values[0] == 1)):
        expected = np.einsum("n,ni,nj", w[some], n[some], n[some]) / w[some].sum()
        np.testing.assert_allclose(
            f.orientation_tensor.sel(phase=phase).values[0], expected, atol=1e-13
        )
        values = np.linalg.eigvalsh(1.5 * expected - 0.5 * np.eye(3))
        order = values[np.abs(values).argmax()]
        assert f.nematic_order.sel(phase=phase).item() == pytest.approx(order, rel=1e-12)


def test_the_tensor_turns_with_the_scene():
    ds = rods(isotropic, 200).drop_vars("box").assign_attrs(periodic="")
    frame = xcg.Rotated(z=(1, 2, 2), x=(2, 1, -2), origin=(3, 3, 3))
    options = {"axes": "", "width": 1.0}
    one = ds.cg.coarse_grain(NAMES, at=dict.fromkeys("xyz", 3.0), **options)
    turned = ds.cg.coarse_grain(NAMES, at=dict.fromkeys("xyz", 0.0), frame=frame, **options)
    r = np.asarray(frame.axes)
    np.testing.assert_allclose(
        turned.orientation_tensor.values[0], r @ one.orientation_tensor.values[0] @ r.T, atol=1e-12
    )
    np.testing.assert_allclose(turned.nematic_order, one.nematic_order, rtol=1e-10)


def test_order_in_a_layer_is_two_dimensional():
    rng = np.random.default_rng(3)
    angle = rng.normal(0.4, 0.2, 500)
    ds = xcg.scene_from_arrays(
        rng.uniform(0, 5, (500, 3)) * [1, 1, 0], diameter=np.full(500, 0.2), density=1.0, dimension=2, thickness=1.0,
        director=np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1), box={"x": (0, 5), "y": (0, 5)}, periodic="xy",
    )  # fmt: skip
    f = ds.cg.coarse_grain(NAMES, axes="")
    assert f.nematic_order.item() == pytest.approx(abs(np.exp(2j * angle).mean()), rel=1e-9)
    assert np.isfinite(f.nematic_tensor.values[0][:2, :2]).all()


@pytest.mark.parametrize("chunk", [False, True])
def test_directors_from_quaternions(chunk):
    from scipy.spatial.transform import Rotation

    turn = Rotation.random(50, random_state=2)
    x, y, z, w = 3.0 * turn.as_quat().T  # of any length
    ds = xcg.scene_from_arrays(np.random.default_rng(1).uniform(0, 4, (50, 3)), diameter=np.ones(50), density=1.0,
                               quat_w=w, quat_x=x, quat_y=y, quat_z=z)  # fmt: skip
    ds = ds.chunk(time=1) if chunk else ds
    found = ds.cg.derive_director(axis=(1.0, 2.0, 0.0))
    assert (found.director.chunks is not None) == chunk
    np.testing.assert_allclose(
        found.director.values[0], turn.apply(np.array([1.0, 2.0, 0.0]) / 5**0.5), atol=1e-12
    )
    with pytest.raises(xcg.SceneError, match="quat_w"):
        ds.drop_vars("quat_w").cg.derive_director()
    with pytest.raises(xcg.SceneError, match=r"give quaternions to ds\.cg\.derive_director\(\)"):
        ds.cg.coarse_grain("nematic_order")


def test_averages_recompute_the_director_from_the_mean_tensor():
    ds = rods(isotropic, 200)
    two = xr.concat([ds, ds.assign_coords(time=[1.0])], "time", data_vars="minimal")
    f = two.cg.coarse_grain(["nematic_order"], axes="z", width=1.0, for_averages=True)
    average = f.cg.time_average()
    np.testing.assert_allclose(average.nematic_order, f.nematic_order.isel(time=0), rtol=1e-10)


def solid_samples(a, b, c, n1, n2, count=400_000, seed=5):
    """Points drawn evenly in the box around a superquadric, and which of them are inside."""
    r = np.random.default_rng(seed).uniform(-1, 1, (count, 3))
    inside = (np.abs(r[:, 0]) ** n2 + np.abs(r[:, 1]) ** n2) ** (n1 / n2) + np.abs(
        r[:, 2]
    ) ** n1 <= 1
    return r * [a, b, c], inside


@pytest.mark.parametrize(("n1", "n2"), [(2.0, 2.0), (4.0, 2.0), (2.0, 6.0), (8.0, 3.0)])
def test_superquadrics_against_sampled_solids(n1, n2):
    """Volume and moments of inertia agree with 400,000 points to 1 %."""
    half = (1.0, 0.5, 2.0)
    named = dict(
        zip(("half_axis_x", "half_axis_y", "half_axis_z"), ([value] for value in half), strict=True)
    )
    named |= {"exponent_1": [n1], "exponent_2": [n2]}
    ds = xcg.scene_from_arrays([[0.0, 0.0, 0.0]], **named).cg.derive_superquadric(density=3.0)
    r, inside = solid_samples(*half, n1, n2)
    volume = inside.mean() * 8 * np.prod(half)
    assert ds.volume.item() == pytest.approx(volume, rel=0.01)
    assert ds.mass.item() == pytest.approx(3 * ds.volume.item(), rel=1e-14)
    squares = (r[inside] ** 2).mean(axis=0) * ds.mass.item()
    np.testing.assert_allclose(
        ds.principal_inertia.values[0, 0], squares.sum() - squares, rtol=0.01
    )
    assert ds.moment_of_inertia.item() == pytest.approx(
        ds.principal_inertia.values.mean(), rel=1e-14
    )
    assert ds.diameter.item() ** 3 * np.pi / 6 == pytest.approx(ds.volume.item(), rel=1e-14)


@pytest.mark.parametrize("chunk", [False, True])
def test_limits_of_superquadrics(chunk):
    """Spheres and ellipsoids exactly, boxes in the limit; masses of the file are kept."""
    half = {
        "half_axis_x": [1.0, 1.0, 1.0],
        "half_axis_y": [1.0, 2.0, 2.0],
        "half_axis_z": [1.0, 3.0, 3.0],
    }
    powers = {f"exponent_{k}": [2.0, 2.0, 2e4] for k in (1, 2)}
    ds = xcg.scene_from_arrays(np.eye(3) * 9, mass=[1.0, 2.0, 5.0], **powers, **half)
    ds = (ds.chunk(time=1) if chunk else ds).cg.derive_superquadric()
    np.testing.assert_allclose(ds.volume.values[0], [np.pi * 4 / 3, np.pi * 8, 48.0], rtol=1e-6)
    np.testing.assert_allclose(ds.principal_inertia.values[0, 0], 0.4, rtol=1e-12)
    np.testing.assert_allclose(
        ds.principal_inertia.values[0, 1], [2 / 5 * k for k in (13, 10, 5)], rtol=1e-12
    )
    np.testing.assert_allclose(
        ds.principal_inertia.values[0, 2], [5 / 3 * k for k in (13, 10, 5)], rtol=1e-6
    )
    np.testing.assert_allclose(ds.density * ds.volume, ds.mass)
    assert ds.volume.attrs["units"] == "m^3"
    assert ds.principal_inertia.attrs["units"] == "kg m^2"


def test_superquadrics_without_shape_variables_raise():
    half = {f"half_axis_{axis}": [1.0] for axis in "xyz"}
    ds = xcg.scene_from_arrays([[0.0, 0.0, 0.0]], **half)
    with pytest.raises(ValueError, match="density=-1"):
        ds.cg.derive_superquadric(density=-1.0)
    with pytest.raises(xcg.SceneError, match="density"):
        ds.cg.derive_superquadric()
    with pytest.raises(xcg.SceneError, match="half_axis_x"):
        ds.drop_vars("half_axis_x").cg.derive_superquadric(density=1.0)
    with pytest.raises(xcg.SceneError, match=r"derive_superquadric\(density=...\) gives them"):
        ds.cg.coarse_grain("density", axes="")


@pytest.mark.filterwarnings("ignore:width=.* is larger than the scene")
def test_angular_velocity_in_the_axes_of_the_body():
    """Means of spin and tumbling of rods: rotated back by the inverse rotation."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.random(40, random_state=4)
    x, y, z, w = turn.as_quat().T
    omega = np.random.default_rng(4).normal(size=(40, 3))
    ds = xcg.scene_from_arrays(
        np.random.default_rng(1).uniform(0, 4, (40, 3)), diameter=np.full(40, 0.5), density=1.0,
        angular_velocity=omega, quat_w=w, quat_x=x, quat_y=y, quat_z=z,
    ).cg.derive_director()  # fmt: skip
    expected = turn.inv().apply(omega)
    np.testing.assert_allclose(ds.body_angular_velocity.values[0], expected, atol=1e-13)
    f = ds.cg.coarse_grain(
        "body_angular_velocity", axes="", extent=dict.fromkeys("xyz", 4.0), width=40.0
    )
    assert f.body_angular_velocity.attrs["units"] == "s^-1"
    assert np.isfinite(f.body_angular_velocity).all()


# --- names that readers know -----------------------------------------------------------------------------------

ROWS = [
    "1 1 0.0 0.0 0.0 0.5 {shape} 0.8 0.6 0.0 0.0",
    "2 1 3.0 0.0 0.0 0.5 {shape} 1.0 0.0 0.0 0.0",
]


def dump_of(tmp_path, name, columns):
    rows = [row.format(shape="2.0 4.0 6.0 2.0 3.0") for row in ROWS]
    head = (
        "ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n2\nITEM: BOX BOUNDS ff ff ff\n-9 9\n-9 9\n-9 9\n"
    )
    (tmp_path / name).write_text(
        f"{head}ITEM: ATOMS id type x y z mass {columns}\n" + "\n".join(rows) + "\n"
    )
    return tmp_path / name


@pytest.mark.parametrize(
    ("engine", "columns", "whole"),
    [
        ("lammps", "shapex shapey shapez block1 block2 quatw quati quatj quatk", 2.0),
        ("liggghts", "shapex shapey shapez blockiness1 blockiness2 quat1 quat2 quat3 quat4", 1.0),
    ],
)
def test_dumps_of_superquadrics_need_no_names(tmp_path, engine, columns, whole):
    """LAMMPS writes whole axes, LIGGGHTS halves; units of the file scale them."""
    path = dump_of(tmp_path, "grains.dump", columns)
    ds = xcg.open_scene(path, engine=engine, units={"length": 1e-3})
    half = [float(ds[f"half_axis_{a}"][0, 0]) for a in "xyz"]
    np.testing.assert_allclose(half, np.array([2.0, 4.0, 6.0]) / whole * 1e-3)
    assert ds.half_axis_x.attrs["units"] == "m"
    assert [float(ds[f"quat_{a}"][0, 0]) for a in "wxyz"] == [0.8, 0.6, 0.0, 0.0]
    powers = [float(ds[name][0, 0]) for name in ("exponent_1", "exponent_2")]
    assert powers == [2.0, 3.0]
    np.testing.assert_allclose(
        ds.cg.derive_director().director[0, 0], [0.0, -0.96, 0.28], atol=1e-15
    )
