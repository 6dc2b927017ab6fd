"""Averages over cells: totals of the scene at any spacing, and the kernel's mean over a cell by brute force."""

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial.legendre import leggauss

import xcg
from tests import planning
from xcg.fields.sums.kernels import kernel_of

# the loops of "gaussian" with a shift; it is slower than the other kernels
SLOWER = pytest.param("shifted gaussian", marks=pytest.mark.slow)
KERNELS = ["lucy", "gaussian", "shifted gaussian", "heaviside"]
SUMS = ["density", "momentum_density", "kinetic_stress", "contact_stress"]
MASS = 1e-5  # of all grains together; along one axis alone it is rounding
# of each grain, as docs/cfd_dem.md states
TOTALS = {"lucy": 3e-6, "shifted gaussian": 1e-5, "gaussian": 4e-5, "heaviside": 2e-8}


@pytest.fixture(scope="module")
def scene():
    return xcg.datasets.random_scene(25, seed=3)


def volume_of_cell(ds, options):
    """Volume that a value stands for: of the cell, and of the box along averaged axes."""
    grid = ds.cg.explain("density", **options).deposit.grid
    box = ds.box.values[0]
    return np.prod(
        [grid.spacing.get(a, np.diff(box["xyz".index(a)])[0]) for a in ds.attrs["plane"]]
    )


def total(ds, name, **options):
    """Integral of a field over all cells."""
    f = ds.cg.coarse_grain(name, sampling="cell", **options)[name].isel(time=0)
    resolved = [a for a in "xyz" if a in f.dims]
    return f.sum(resolved).values * volume_of_cell(ds, options | {"sampling": "cell"})


def total_contact_stress(ds):
    """Sum of f a over both sides of the contacts of a scene."""
    step, found = ds.isel(time=0), np.zeros((3, 3))
    rows = {int(n): k for k, n in enumerate(step.particle_id.values)}
    period = np.diff(step.box.values, axis=1)[:, 0]
    for i, j, f, c in zip(
        *(step[f"contact_{n}"].values for n in ("i", "j", "force", "point")), strict=True
    ):
        for k, sign in ((i, 1.0), (j, -1.0)):
            if k in rows:
                a = step.position.values[rows[k]] - c
                found += sign * np.outer(f, a - period * np.rint(a / period))
    return found


@pytest.mark.parametrize("kernel", ["lucy", "gaussian", SLOWER, "heaviside"])
@pytest.mark.parametrize(
    "mesh",
    [
        pytest.param({"spacing": 0.7}, marks=pytest.mark.slow),  # many cells; the same with fewer
        {"spacing": 3.0},
        {"spacing": 100.0},
        {"spacing": {"x": 1.0, "y": 9.0, "z": 2.5}},
        {"axes": "xz", "spacing": 1.1},
        {"axes": "y", "spacing": 0.7},
        {"axes": "z", "spacing": 50.0},
    ],
    ids=str,
)
def test_cells_hold_all_mass_and_momentum(scene, kernel, mesh):
    tolerance = 1e-13 if len(mesh.get("axes", "xyz")) == 1 else MASS
    step = scene.isel(time=0)
    momentum = (step.mass.values[:, None] * step.velocity.values).sum(axis=0)
    options = {"kernel": kernel, "width": 0.4, **mesh}
    np.testing.assert_allclose(total(scene, "density", **options), step.mass.sum(), rtol=tolerance)
    found = total(scene, "momentum_density", **options)
    np.testing.assert_allclose(
        found, momentum, rtol=0, atol=10 * tolerance * np.abs(momentum).max()
    )


# small cells repeat large ones; spline, kink and core do what jump and stairs do
@pytest.mark.parametrize("spacing", [pytest.param(0.6, marks=pytest.mark.slow), 3.0])
@pytest.mark.parametrize(
    ("profile", "error"),
    [
        (
            lambda q: np.where(q < 0.5, 1 - 6 * q**2 * (1 - q), 2 * (1 - q) ** 3),
            1e-6,
        ),  # cubic spline
        (lambda q: np.where(q < 0.4, 1.0, (1 - q) / 0.6), 1e-5),  # a kink
        pytest.param(  # a jump
            lambda q: np.where(q < 0.6, 1.0, 0.25), 1e-6, marks=pytest.mark.slow
        ),
        (lambda q: np.where(q < 0.3, 1.0, 0.0), 1e-6),  # nothing beyond
        pytest.param(  # as many jumps as there may be
            lambda q: 1.0 - np.floor(7.5 * q) / 8.0, 1e-6, marks=pytest.mark.slow
        ),
    ],
    ids=["spline", "kink", "jump", "core", "stairs"],
)
@pytest.mark.filterwarnings("ignore:kernel 'rims'", "ignore:.*jumps")
def test_polynomials_that_meet_inside_lose_no_mass(profile, error, spacing):
    xcg.register_kernel("rims", profile, smoothness=-1)
    scene = xcg.datasets.random_scene(1, seed=3)
    for axes in ("xyz", "xz"):
        found = total(scene, "density", kernel="rims", width=1.0, spacing=spacing, axes=axes)
        np.testing.assert_allclose(found, scene.mass.sum(), rtol=error)


def test_negative_parts_of_a_kernel_are_averaged(scene):
    xcg.register_kernel("negative", lambda q: (1 - q**2) ** 2 * (1 - 1.5 * q**2))
    found = total(scene, "density", kernel="negative", spacing=0.7, width=1.0)
    assert found == pytest.approx(scene.mass.values.sum(), rel=MASS)


@pytest.mark.parametrize(
    "mesh",
    [
        {"spacing": 1.5},
        {"spacing": 100.0},
        {"axes": "xz", "spacing": 2.5},
        {"axes": "z", "spacing": 0.5},
    ],
    ids=str,
)
def test_cells_hold_all_contact_stress(scene, mesh):
    """The table of means adds up to one; what it has of cells that are out of reach is left out."""
    expected = total_contact_stress(scene)
    found = total(scene, "contact_stress", width=0.4, **mesh)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


@pytest.mark.filterwarnings("ignore::xcg.SceneWarning")  # boxes smaller than grains
@pytest.mark.parametrize("kernel", TOTALS)
@pytest.mark.parametrize("spacing", [0.63, 1.37])
def test_cells_hold_the_mass_of_each_grain(kernel, spacing):
    """Anywhere between the nodes; the support, of radius 1, lies within the cells."""
    rng = np.random.default_rng(0)
    nodes = np.arange(-3, 4 + np.ceil(1.0 / spacing)) * spacing
    ds = xcg.scene_from_arrays(
        rng.uniform(0, spacing, (40, 3)),
        diameter=np.full(40, 0.1),
        density=1.0,
        species=np.arange(1, 41),
    )
    smooth = kernel_of(kernel, 1.0, {}, 3)
    options = {"kernel": kernel, "width": smooth.width / smooth.cutoff, "spacing": spacing}
    bounds = dict.fromkeys("xyz", (nodes[0], nodes[-1]))
    f = ds.cg.coarse_grain("density", sampling="cell", by="species", bounds=bounds, **options)
    mass = f.density.isel(time=0).sum(["x", "y", "z"]).sel(phase=ds.species.values[0]) * spacing**3
    np.testing.assert_allclose(mass, np.pi / 6 * 0.1**3, rtol=TOTALS[kernel])


@pytest.mark.slow  # totals on given meshes
@settings(max_examples=15, deadline=None)
@given(
    spacing=st.tuples(*[st.floats(0.5, 8.0)] * 2), periodic=st.sampled_from(["", "x", "xz"]),
    kernel=st.sampled_from(KERNELS), axes=st.sampled_from(["xz", "zy"]),
)  # fmt: skip
def test_totals_are_kept_at_any_spacing_and_edges(scene, spacing, periodic, kernel, axes):
    ds = scene.assign_attrs(periodic=periodic)
    options = {
        "axes": axes,
        "spacing": dict(zip(axes, spacing, strict=True)),
        "kernel": kernel,
        "width": 0.4,
    }
    assert total(ds, "density", **options) == pytest.approx(float(ds.mass.sum()), rel=MASS)


@pytest.mark.parametrize("periodic", ["", "x"])
def test_cells_of_a_layer_and_its_phases(periodic):
    rng = np.random.default_rng(1)
    ds = xcg.scene_from_arrays(
        np.column_stack([rng.uniform(0, 6, (30, 2)), np.zeros(30)]), diameter=np.ones(30), density=1.0,
        velocity=rng.normal(size=(30, 3)) * [1, 1, 0], box=[[0, 6], [0, 6], [-0.5, 0.5]], periodic=periodic,
        dimension=2, species=np.arange(30) % 2 + 1,
    )  # fmt: skip
    for spacing in (0.5, 2.5, 60.0):
        found = total(ds, "density", spacing=spacing, width=0.4, by="species")
        masses = [float(ds.mass.where(ds.species == k).sum()) for k in (1, 2)]
        np.testing.assert_allclose(found, [sum(masses), *masses], rtol=MASS)


def test_cells_in_a_tilted_box():
    """Cells fill the box without its tilt, which holds everything once."""
    rng = np.random.default_rng(4)
    lattice = np.array([[5.0, 0, 0], [2.1, 4.0, 0], [-1.3, 0.7, 6.0]])
    ds = xcg.scene_from_arrays(
        rng.random((30, 3)) @ lattice, diameter=np.ones(30), density=1.0, velocity=rng.normal(size=(30, 3)),
        box=[[0, 5], [0, 4], [0, 6]], lattice=lattice, periodic="xyz",
    )  # fmt: skip
    for spacing in (1.0, 2.3, 50.0):
        found = total(ds, "momentum_density", spacing=spacing, width=0.5)
        expected = (ds.mass.values[0][:, None] * ds.velocity.values[0]).sum(axis=0)
        np.testing.assert_allclose(found, expected, rtol=0, atol=10 * MASS * np.abs(expected).max())


def test_cells_with_a_width_for_each_group(scene):
    found = total(scene, "density", spacing=2.0, by="species", width={1: 0.3, 2: 0.6})
    masses = [float(scene.mass.where(scene.species == k).sum()) for k in (1, 2)]
    np.testing.assert_allclose(found, [sum(masses), *masses], rtol=MASS)


@pytest.mark.parametrize("width", [0.4, 1.5])
def test_one_cell_is_the_mean_of_the_box(scene, width):
    names = [
        "density",
        "momentum_density",
        "kinetic_stress",
        "contact_stress",
        "velocity",
        "granular_temperature",
    ]
    cell = scene.cg.coarse_grain(names, sampling="cell", spacing=100.0, width=width).isel(
        x=0, y=0, z=0
    )
    box = scene.cg.coarse_grain(names, axes="", at={}, width=width)
    for name in names:
        if name != "granular_temperature":  # its fit has a gradient, which that of the box has not
            scale = float(abs(box[name]).max())
            np.testing.assert_allclose(
                cell[name], box[name], rtol=0, atol=10 * MASS * scale, err_msg=name
            )
    np.testing.assert_allclose(cell.x, scene.box.values[0, 0].mean())


# --- the mean over a cell ----------------------------------------------------------------------------------


def points_in(edges, parts, order=6):
    """Gauss-Legendre points (n, m) and weights (n,), which sum to 1, in a cell between edges (m, 2)."""
    x, w = leggauss(order)
    axes = []
    for low, high in edges:
        part = (high - low) / parts
        middle = low + part * (np.arange(parts) + 0.5)
        axes.append(((middle[:, None] + 0.5 * part * x).ravel(), np.tile(0.5 * w / parts, parts)))
    places = np.stack(np.meshgrid(*(p for p, _ in axes), indexing="ij"), -1).reshape(-1, len(axes))
    weights = axes[0][1]
    for _, more in axes[1:]:
        weights = np.multiply.outer(weights, more)
    return places, weights.ravel()


@pytest.mark.parametrize(
    ("kernel", "rtol"),
    [
        ("lucy", 1e-5),
        pytest.param("shifted gaussian", 1e-4, marks=pytest.mark.slow),  # as `SLOWER`
        ("gaussian", 2e-3),
        ("heaviside", 3e-2),
    ],
)
@pytest.mark.parametrize(
    "mesh", [{}, {"axes": "xz"}, {"axes": "xz", "at": "y"}, {"axes": "z"}], ids=str
)
def test_cells_are_the_means_of_values_at_their_points(scene, kernel, rtol, mesh):
    """Fields at points within one cell, each exact, and their mean."""
    axes = mesh.get("axes", "xyz")
    near = dict(
        zip("xyz", scene.position.values[0, 0] + [0.2, -0.1, 0.3], strict=True)
    )  # of a grain, not at a rim
    middle, size = near, {"x": 0.9, "y": 0.4, "z": 1.6}
    mesh = mesh | ({"at": {"y": near["y"]}} if "at" in mesh else {})
    options = {"kernel": kernel, "width": 0.5}
    f = scene.cg.coarse_grain(
        SUMS, sampling="cell", bounds={a: (middle[a], middle[a]) for a in axes}, spacing={a: size[a] for a in axes},
        **mesh, **options,
    ).isel(time=0, **dict.fromkeys(axes, 0))  # fmt: skip
    edges = [(middle[a] - 0.5 * size[a], middle[a] + 0.5 * size[a]) for a in axes]
    places, weights = points_in(edges, 4)
    at = {a: xr.DataArray(places[:, k], dims="point") for k, a in enumerate(axes)} | mesh.get(
        "at", {}
    )
    fine = scene.cg.coarse_grain(SUMS, at=at, **options).isel(time=0)
    for name in ("density", "momentum_density", "contact_stress"):
        expected = np.tensordot(weights, fine[name].transpose("point", ...).values, 1)
        np.testing.assert_allclose(
            f[name], expected, rtol=0, atol=rtol * np.abs(expected).max(), err_msg=name
        )


def test_squares_counts_and_fits_equal_those_of_the_mean_kernel():
    """Fluctuations, what the fit leaves and effective counts by brute force, with images of one grain in one cell."""
    rng = np.random.default_rng(5)
    period, count = 3.0, 12
    ds = xcg.scene_from_arrays(
        rng.uniform(0, period, (count, 3)), diameter=np.full(count, 0.5), density=1.0,
        velocity=1e3 + rng.normal(size=(count, 3)), box=[[0, period]] * 3, periodic="xyz",
    )  # fmt: skip
    width, node = 0.5, np.array([1.4, 0.2, 2.3])
    size = np.array([1.7, 2.9, 1.2])  # nearly a period, so that images on both sides weigh as much
    names = [
        "fluctuation_density",
        "granular_temperature",
        "effective_count",
        "velocity_gradient",
        "sample_count",
    ]
    f = ds.cg.coarse_grain(
        names, width=width, sampling="cell", spacing=dict(zip("xyz", size, strict=True)),
        bounds={a: (x, x) for a, x in zip("xyz", node, strict=True)},
    ).isel(time=0, x=0, y=0, z=0)  # fmt: skip
    places, weights = points_in([(-0.5 * s, 0.5 * s) for s in size], 6, order=4)
    kernel = xcg.Lucy(width, dimension=3)
    mass, velocity = ds.mass.values[0], ds.velocity.values[0] - 1e3
    rows = []
    shifts = np.stack(np.meshgrid(*[period * np.arange(-2, 3)] * 3), -1).reshape(-1, 3)
    for k, position in enumerate(ds.position.values[0]):
        for shift in shifts:
            x = position + shift - node
            if (np.abs(x) < 0.5 * size + 2 * width).all():
                psi = weights @ kernel.value(np.linalg.norm(x - places, axis=1))
                if psi > 0:
                    rows.append((k, x, mass[k] * psi))
    owner, x, w = (np.array(column) for column in zip(*rows, strict=True))
    u, rho = velocity[owner], w.sum()
    x_bar, u_bar = w @ x / rho, w @ u / rho
    spread = (w[:, None] * (x - x_bar)).T @ (x - x_bar)
    gradient = (w[:, None] * (u - u_bar)).T @ (x - x_bar) @ np.linalg.inv(spread)
    rest = u - u_bar - (x - x_bar) @ gradient.T
    # the share of each grain in the fit at its place: its leverage, over all images of the grain
    hat = 1 / rho + (x - x_bar) @ np.linalg.inv(spread) @ (x - x_bar).T
    same = owner[:, None] == owner
    left = rho - (same * hat * np.outer(w, w)).sum()
    np.testing.assert_allclose(
        f.velocity_gradient, gradient, rtol=0, atol=1e-4 * np.abs(gradient).max()
    )
    np.testing.assert_allclose(f.fluctuation_density, left, rtol=1e-4)
    np.testing.assert_allclose(f.granular_temperature, (w @ rest**2).sum() / (3 * left), rtol=1e-4)
    np.testing.assert_allclose(f.effective_count, rho**2 / (same * np.outer(w, w)).sum(), rtol=1e-4)
    images = ds.position.values[0][:, None] + shifts - node
    outside = np.maximum(np.abs(images) - 0.5 * size, 0.0)
    assert int(f.sample_count) == (np.linalg.norm(outside, axis=-1) < 2 * width).sum()
    assert len(owner) > len(set(owner.tolist()))


def test_the_temperature_of_a_gas_in_large_cells_is_unbiased():
    ds = xcg.datasets.random_scene(4000, seed=2)
    velocity = np.random.default_rng(0).normal(size=ds.velocity.shape)
    ds = ds.assign(velocity=ds.velocity.copy(data=velocity))
    f = ds.cg.coarse_grain(
        ["granular_temperature", "fluctuation_density"], sampling="cell", spacing=3.0, width=0.3
    )
    weight = f.fluctuation_density.fillna(0.0)
    assert float(
        (f.granular_temperature.fillna(0.0) * weight).sum() / weight.sum()
    ) == pytest.approx(1.0, abs=0.03)


# --- what a request says -----------------------------------------------------------------------------------


def test_sampling_without_cells_raises(scene):
    with pytest.raises(ValueError, match="sampling='volume': expected one of 'node', 'cell'"):
        scene.cg.coarse_grain("density", sampling="volume")
    with pytest.raises(ValueError, match="points, which at= has arrays of, have none"):
        scene.cg.coarse_grain("density", sampling="cell", at={"x": xr.DataArray([1.0], dims="p")})
    with pytest.raises(ValueError, match="gradient='kernel' is the derivative at a node"):
        scene.cg.coarse_grain("density", sampling="cell", gradient="kernel")
    with pytest.raises(ValueError, match="a cylindrical frame has none"):
        scene.cg.coarse_grain("density", sampling="cell", frame=xcg.Cylindrical(axis="z"), axes="r")
    with pytest.raises(ValueError, match="the accessible fraction is that at a node"):
        scene.cg.coarse_grain(
            "density", sampling="cell", surfaces=[xcg.Plane((0, 0, 0), (0, 0, 1))]
        )


def test_sampling_does_not_matter_without_resolved_axes(scene):
    for options in ({"at": {"z": 1.0}}, {"at": {"x": 1.0, "y": 2.0, "z": 1.0}}, {"axes": ""}):
        node = scene.cg.coarse_grain(SUMS, **options)
        cell = scene.cg.coarse_grain(SUMS, sampling="cell", **options)
        assert cell.identical(node.assign_attrs(history=cell.attrs["history"])) or cell.equals(node)


def test_cells_lie_side_by_side(scene):
    f = scene.cg.coarse_grain("density", sampling="cell", spacing=1.3, axes="z", width=0.4)
    assert f.attrs["sampling"] == "cell"
    step, (low, high) = float(f.z[1] - f.z[0]), scene.box.values[0, 2]
    np.testing.assert_allclose([f.z[0] - step / 2, f.z[-1] + step / 2], [low, high])
    assert "averages over their cells" in str(
        scene.cg.explain("density", sampling="cell", axes="z")
    )


def test_blocks_threads_and_chunks_have_the_same_bits(scene):
    names = [*SUMS, "granular_temperature"]
    options = {"sampling": "cell", "spacing": 1.2, "width": 0.5}
    whole = scene.cg.coarse_grain(names, **options)
    with planning(BLOCK_NODES=7):
        for name, parts in scene.cg.coarse_grain(names, **options).items():
            np.testing.assert_array_equal(parts, whole[name], name)
        lazy = scene.chunk(time=1).cg.coarse_grain(names, **options)
        np.testing.assert_array_equal(lazy.density, whole.density)
