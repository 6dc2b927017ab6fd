"""All fields against brute force; laziness; schedulers; labels; errors."""

import pickle
import warnings
from concurrent.futures import ThreadPoolExecutor
from unittest import mock

import dask
import numpy as np
import pytest
import xarray as xr
from hypothesis import example, given, settings
from hypothesis import strategies as st

import xcg
from tests import planning, sharing_threads
from tests.brute_force import KERNELS, BruteKernel, brute_force
from tests.scenes import random_steps
from xcg import SceneWarning
from xcg.compiled.points import deposit
from xcg.compiled.segments import deposit_segments, list_segments
from xcg.fields.evaluate import WORTH_SHARING
from xcg.fields.sums.nodes import BLOCK_NODES

RATIOS = {"velocity", "effective_count", "particle_density", "coordination_number", "d32",
          "d43", "granular_temperature", "friction_coefficient", "velocity_gradient", "shear_rate",
          "inertial_number"}  # fmt: skip
OVER_PRESSURE = {"friction_coefficient", "inertial_number"}


def nodes_of(f):
    """All nodes (n, 3), and values of a field of the first step (n, ...)."""
    axes = [a for a in "xyz" if a in f.dims]
    grids = np.meshgrid(*[f[a].values for a in axes], indexing="ij")
    points = np.zeros((int(np.prod([f.sizes[a] for a in axes])), 3))
    for k, a in enumerate("xyz"):
        if a in axes:
            points[:, k] = grids[axes.index(a)].ravel()
        elif a in f.coords:
            points[:, k] = float(f[a])

    def values(name):
        v = f[name].isel(time=0).values
        return v.reshape(len(points), *v.shape[len(axes) :])

    return points, values


def sizes_of_terms(ds, truth, peak, width):
    """Size of what each field adds up, by name: rounding is relative to it, also where the sum cancels."""
    speed, force, diameter, mass, volume = (
        np.abs(ds[name].values).max(initial=0)
        for name in ("velocity", "contact_force", "diameter", "mass", "volume")
    )
    density, number_density = (
        np.max(truth[name], initial=0) for name in ("density", "number_density")
    )
    # one minus the distance cancels at the rim, so coordinates give fewer digits of weights below a thousandth
    rim = 1e-3 * peak
    # velocities relative to the mean: where all are the same, their rounding is left
    kinetic = density * speed**2
    # segments are exact relative to their largest value, which no node need reach
    contact = peak * force * diameter
    return {
        # sums of weights
        "number_density": rim,
        "density": rim * mass,
        "momentum_density": rim * mass * speed,
        "volume_fraction": rim * volume,
        "fabric": rim * volume,
        # forces on the two sides of a contact cancel
        "contact_force_density": number_density * force,
        # differences of velocities
        "kinetic_stress": kinetic,
        "granular_temperature": speed**2,
        # differences of velocities across the support
        "velocity_gradient": speed / width,
        "shear_rate": speed / width,
        # the density less what a fit takes
        "fluctuation_density": density,
        "contact_stress": contact,
        # both parts of the stress
        **dict.fromkeys(
            ["stress", "pressure", "deviatoric_stress", "shear_stress"], kinetic + contact
        ),
    }


def comparable(name, truth, sizes, count, fitted):
    """Nodes at which a field holds digits in both computations."""
    density = np.array(truth["density"])
    pressure = np.abs(truth["pressure"])
    keep = np.array([value is not None for value in truth[name]])
    if name in RATIOS:  # weights at the rim hold few digits, and their ratios none
        keep &= (density == 0) | (density > 1e-6 * density.max(initial=0))
    if name in OVER_PRESSURE:  # so does a pressure that cancels
        keep &= pressure > 1e-4 * max(pressure.max(initial=0), sizes["pressure"])
    if (
        name == "fluctuation_density"
    ):  # a fit through few grains amplifies rounding by its condition
        keep &= count >= fitted
    return keep


def assert_equals_brute_force(
    ds, kernel, width, *, nodes=12, tolerance=1e-12, dimension=3, scale=1.0, fitted=0, **options
):
    """Compare all fields at some nodes; what a fit takes, only where at least `fitted` grains reach the node."""
    f = ds.cg.coarse_grain(kernel=kernel, width=width, rtol=0, **options)
    points, values = nodes_of(f)
    some = np.random.default_rng(1).permutation(len(points))[:nodes]
    seen = "".join(a for a in "xyz" if a in f.coords)
    brute = BruteKernel(kernel, width, dimension, len(seen))
    truth = brute_force(ds, brute, points[some], seen, scale)
    sizes = sizes_of_terms(ds, truth, scale * brute(np.zeros(1))[0], width)
    for name, expected in truth.items():
        keep = comparable(name, truth, sizes, values("sample_count")[some], fitted)
        if keep.any():
            want = np.array([expected[i] for i in np.flatnonzero(keep)], float)
            size = max(np.nanmax(np.abs(want), initial=0.0), sizes.get(name, 0.0))
            np.testing.assert_allclose(
                values(name)[some][keep], want, rtol=0, atol=tolerance * size, err_msg=name
            )
    return f


CASES = [
    ("xyz", {}), ("xz", {}), ("xz", {"y": 1.0}), ("z", {}), ("z", {"x": 1.0, "y": 2.0}), ("x", {"y": 2.2}),
    ("", {"x": 1.0, "y": 2.0, "z": 2.5}),
]  # fmt: skip


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize(("axes", "at"), CASES)
def test_fields_in_3d_equal_brute_force(kernel, axes, at):
    ds = xcg.datasets.random_scene(60, periodic="xy", seed=3)
    averaged = 3 - len(axes) - len(at)
    # 64 Gauss points leave 1e-11 of a quotient of marginals, which amplifies the error of its parts
    tolerance = 1e-12 if averaged == 0 else 3e-11
    assert_equals_brute_force(
        ds, kernel, 0.8, axes=axes, at=at, spacing=1.3, scale=5.0**-averaged, tolerance=tolerance
    )


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("axes", ["xy", "y"])
def test_fields_in_2d_equal_brute_force(kernel, axes):
    ds = xcg.datasets.random_scene(60, periodic="x", dimension=2, seed=4, thickness=0.5)
    scale = 2.0 if axes == "xy" else 2.0 / 5.0
    f = assert_equals_brute_force(
        ds,
        kernel,
        0.8,
        axes=axes,
        spacing=0.9,
        scale=scale,
        dimension=2,
        tolerance=1e-12 if axes == "xy" else 3e-11,
    )
    assert f.attrs["kernel_dimension"] == 2


def test_support_larger_than_the_box_counts_all_images():
    ds = xcg.datasets.random_scene(20, periodic="xyz", seed=5, edge=1.5)
    assert_equals_brute_force(ds, "lucy", 1.2, spacing=0.5, nodes=4)


@pytest.mark.filterwarnings(
    "ignore:.*contacts looked at lie more than"
)  # of random places, some are
@pytest.mark.filterwarnings("ignore:.*width")  # and some grains are far wider than the kernel
@example(particles=1, seed=1, periodic="yz", width=1.5, polydispersity=1.0, offset=1e4)
@example(particles=1, seed=13, periodic="xyz", width=1.5, polydispersity=1.0, offset=0.0)
@settings(deadline=None, max_examples=15)
@given(
    particles=st.integers(0, 30),
    seed=st.integers(0, 10_000),
    periodic=st.sampled_from(["", "x", "yz", "xyz"]),
    width=st.floats(0.2, 1.5),
    polydispersity=st.floats(1.0, 20.0),
    offset=st.sampled_from([0.0, 1e4]),
)
def test_fields_of_any_scene_equal_brute_force(
    particles, seed, periodic, width, polydispersity, offset
):
    ds = xcg.datasets.random_scene(
        particles, seed=seed, periodic=periodic, polydispersity=polydispersity, edge=3.0
    )
    ds = ds.assign(
        position=ds.position + offset, contact_point=ds.contact_point + offset, box=ds.box + offset
    )
    bounds = dict.fromkeys("xyz", (offset, offset + 3.0))
    # coordinates of size 1e4 hold 12 digits of an offset
    tolerance = 1e-11 if offset == 0 else 3e-9
    assert_equals_brute_force(
        ds, "lucy", width, nodes=4, spacing=2 * width, bounds=bounds, tolerance=tolerance, fitted=10
    )


def test_kernel_gradient_is_the_derivative_of_velocity():
    ds = xcg.datasets.random_scene(200, seed=6)
    h = 1e-4
    for axes, fixed in (("x", {"y": 2.5, "z": 2.5}), ("x", {"z": 2.5}), ("x", {})):
        options = {
            "axes": axes,
            "at": fixed,
            "bounds": {"x": (2.0 - 2 * h, 2.0 + 2 * h)},
            "spacing": h,
            "width": 0.8,
        }
        f = ds.cg.coarse_grain(["velocity", "velocity_gradient"], gradient="kernel", **options)
        v = f.velocity.isel(time=0).values
        slope = (8 * (v[3] - v[1]) - (v[4] - v[0])) / (12 * h)
        exact = f.velocity_gradient.isel(time=0, x=2).values
        np.testing.assert_allclose(exact[:, 0], slope, rtol=1e-7, atol=1e-8)
        averaged = [k for k, a in enumerate("xyz") if a not in axes and a not in fixed]
        assert (exact[:, averaged] == 0).all()


def test_kernel_gradient_refuses_heaviside_and_warns_of_gaussian():
    ds = xcg.datasets.random_scene(20)
    with pytest.raises(ValueError, match="Heaviside is not"):
        ds.cg.coarse_grain("shear_rate", kernel="heaviside", gradient="kernel", width=1.0)
    with pytest.warns(xcg.SceneWarning, match="jumps at its cutoff"):
        ds.cg.coarse_grain("shear_rate", kernel="gaussian", gradient="kernel", width=1.0)
    with pytest.warns(xcg.SceneWarning, match="its gradient is exact almost everywhere"):
        ds.cg.coarse_grain("shear_rate", kernel="shifted gaussian", gradient="kernel", width=1.0)


@pytest.mark.filterwarnings("ignore:the shifted gaussian kernel is continuous")
def test_kernel_gradient_of_the_shifted_gaussian_equals_that_of_the_velocity():
    """Between nodes so close that no grain comes into reach from one to the next."""
    ds = xcg.datasets.random_scene(60, seed=3)
    h = 1e-6
    at = {"y": 2.0, "z": 2.1}
    options = {
        "kernel": xcg.Gaussian(0.9, shifted=True),
        "axes": "x",
        "at": at,
        "gradient": "kernel",
    }
    f = ds.cg.coarse_grain(
        ["velocity", "velocity_gradient"], bounds={"x": (2.0, 2.0 + 2 * h)}, spacing=h, **options
    )
    v = f.velocity.isel(time=0).values
    slope = (v[2] - v[0]) / (2 * h)
    np.testing.assert_allclose(
        f.velocity_gradient.isel(time=0, x=1).values[:, 0], slope, rtol=1e-8, atol=1e-8
    )


# --- phases ----------------------------------------------------------------------------------------------


def test_phases_add_up_and_each_is_its_own_sum():
    ds = xcg.datasets.random_scene(150, seed=7)
    f = ds.cg.coarse_grain(by="species", width=0.8, fluid_viscosity=1e-3)
    assert f.phase.values.tolist() == ["bulk", "1", "2"]
    whole = ds.cg.coarse_grain(width=0.8, fluid_viscosity=1e-3)
    for name, row in xcg.FIELDS.items():
        if name not in f or row.paired:
            continue
        bulk = f[name].sel(phase="bulk", drop=True)
        assert f[name].dims[:5] == ("time", "x", "y", "z", "phase")
        scale = np.abs(whole[name]).max().item() + 1e-300
        if name not in (
            "friction_coefficient",
            "inertial_number",
            "viscous_number",
            "relative_viscosity",
            "granular_temperature",  # of the bulk without phases: that of equal variances
            "directional_temperature",
        ):
            np.testing.assert_allclose(bulk, whole[name], rtol=1e-9, atol=1e-9 * scale)
        if row.additive:
            parts = f[name].sel(phase=["1", "2"]).sum("phase", skipna=False)
            np.testing.assert_allclose(
                parts.values, bulk.values, rtol=0, atol=1e-12 * scale, err_msg=name
            )
    only = (ds.species == 1).values[0]
    alone = ds.isel(particle=only).cg.coarse_grain(["density", "velocity", "d43"], width=0.8)
    for name in alone:
        phase = f[name].sel(phase="1", drop=True)
        np.testing.assert_allclose(phase, alone[name], rtol=1e-12, atol=1e-12)


def test_partial_fluctuations_are_about_the_bulk():
    ds = xcg.datasets.random_scene(2000, seed=8)
    moving = ds.velocity + xr.where(ds.species == 1, 10.0, 0.0)
    f = ds.assign(velocity=moving.transpose(*ds.velocity.dims)).cg.coarse_grain(
        by="species", width=1.0
    )
    v = f.velocity.sel(phase="1") - f.velocity.sel(phase="bulk")
    assert float(v.mean()) == pytest.approx(5.0, rel=0.05)
    # species move at +-5 about the mean in each direction: 25 + 1 in each component
    assert float(f.granular_temperature.sel(phase="1").mean()) == pytest.approx(26.0, rel=0.05)


@pytest.mark.parametrize("axes", ["xyz", "xz", "z"])
def test_each_phase_takes_a_width_of_its_own(axes):
    ds = xcg.datasets.random_scene(150, seed=7)
    place = {"spacing": 0.4, "axes": axes, "bounds": dict.fromkeys(axes, (0.0, 1.9))}
    own = ds.cg.coarse_grain(by="species", width={1: 0.4, 2: 0.9}, by_pair=True, **place)
    assert own.attrs["width"] == [0.4, 0.9]
    for phase, width in (("1", 0.4), ("2", 0.9)):
        same = ds.cg.coarse_grain(by="species", width=width, by_pair=True, **place)
        # fluctuations are about the velocity of the bulk, which the other phase has a part in
        sums = (
            "sample_count",
            "density",
            "momentum_density",
            "contact_force_density",
            "contact_stress",
        )
        for name in (
            *sums,
            "volume_fraction",
            "number_density",
            "contact_stress_by_pair",
            "boundary_force_density",
        ):
            want = same[name].sel(phase=phase)
            got = own[name].sel(phase=phase)
            np.testing.assert_allclose(
                got, want, rtol=0, atol=1e-12 * float(abs(want).max()), err_msg=name
            )
    for name, row in xcg.FIELDS.items():
        if row.additive and name[0] != "_" and not row.paired and name in own:
            parts = own[name].sel(phase=["1", "2"]).sum("phase", skipna=False)
            bulk = own[name].sel(phase="bulk")
            np.testing.assert_allclose(
                parts, bulk, rtol=0, atol=1e-12 * float(abs(bulk).max()), err_msg=name
            )


def test_the_traction_of_a_wall_belongs_to_the_phase_that_touches_it():
    ds = xcg.datasets.random_scene(150, seed=7, periodic="xy")
    own = ds.cg.coarse_grain("boundary_force_density", by="species", axes="z", width=0.6)
    first = ds.particle_id.values[0][ds.species.values[0] == 1]
    for phase, kept in (("1", np.isin(ds.contact_i, first)), ("2", ~np.isin(ds.contact_i, first))):
        alone = ds.assign(
            contact_force=ds.contact_force.where(xr.DataArray(kept, dims=("time", "contact")), 0.0)
        )
        expected = alone.cg.coarse_grain(
            "boundary_force_density", axes="z", width=0.6
        ).boundary_force_density
        assert float(abs(expected).max()) > 0
        np.testing.assert_allclose(
            own.boundary_force_density.sel(phase=phase),
            expected,
            atol=1e-12 * float(abs(expected).max()),
        )


def test_linear_flow_is_exact_with_two_widths():
    ds = xcg.datasets.random_scene(300, seed=9, periodic="")
    g = np.array([[0.1, 2.0, 0.0], [0.0, -0.3, 0.5], [0.0, 0.0, 0.2]])
    ds = ds.assign(velocity=(ds.velocity.dims, ds.position.values @ g.T))
    f = ds.cg.coarse_grain(
        ["velocity_gradient", "granular_temperature"], by="species", width={1: 0.4, 2: 0.9}, spacing=0.5,
        bounds=dict.fromkeys("xyz", (1.0, 2.0)),
    ).sel(phase="bulk")  # fmt: skip
    np.testing.assert_allclose(
        f.velocity_gradient.values, np.broadcast_to(g, f.velocity_gradient.shape), atol=1e-11
    )
    assert float(f.granular_temperature.max()) < 1e-12


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"width": {1: 0.4, 2: 0.9}}, "with by="),
        ({"width": {1: 0.4}, "by": "species"}, r"each of the groups \[1, 2\]"),
        ({"width": {1: 0.4, 2: -1.0}, "by": "species"}, "positive length"),
        ({"width": {1: 0.4, 2: 0.9}, "by": "species", "kernel": xcg.Lucy(0.5)}, "and a kernel"),
    ],
)
def test_wrong_widths_of_groups_raise(options, message):
    with pytest.raises(ValueError, match=message):
        xcg.datasets.random_scene(20).cg.coarse_grain("density", **options)


def test_equal_diameters_take_one_column():
    """Columns that all grains share are multiples of their number."""
    ds = xcg.datasets.random_scene(60, seed=3)
    d = np.full_like(ds.diameter, 0.7)
    ds = ds.assign(diameter=(ds.diameter.dims, d), volume=(ds.volume.dims, np.pi / 6 * d**3))
    one = ds.cg.coarse_grain(["volume_fraction", "d43", "d32", "number_density"], width=0.8)
    np.testing.assert_allclose(
        one.volume_fraction, np.pi / 6 * 0.7**3 * one.number_density, rtol=1e-14
    )
    np.testing.assert_allclose(one.d43.where(one.number_density > 0, 0.7), 0.7, rtol=1e-14)
    with mock.patch("xcg.fields.passes.loops.deposit", wraps=deposit) as loop:
        ds.cg.coarse_grain(["volume_fraction", "d43", "d32", "number_density"], width=0.8)
    assert (
        loop.call_args.args[0].constants.shape[1] == 4
    )  # one column, and three that fill up the four


def test_an_unknown_group_raises():
    ds = xcg.datasets.random_scene(20)
    with pytest.raises(xcg.SceneError, match=r"species=2, which is not among\s+the groups"):
        ds.cg.coarse_grain("density", by="species", groups=[1], width=1.0)
    with pytest.raises(ValueError, match="integer variable"):
        ds.cg.coarse_grain("density", by="mass", width=1.0)
    with pytest.raises(ValueError, match="pass groups="):
        ds.drop_attrs(deep=False).chunk().cg.coarse_grain(
            "density", by="species", width=1.0, bounds=dict.fromkeys("xyz", (0, 1))
        )


def test_frozen_grains_act_as_walls():
    ds = xcg.datasets.random_scene(100, seed=9, periodic="xy", walls=False)
    ds["frozen"] = (ds.species == 2).astype("int64")
    f = ds.cg.coarse_grain(width=0.8)
    free = (
        ds.isel(particle=(ds.species == 1).values[0]).drop_vars("frozen").cg.coarse_grain(width=0.8)
    )
    xr.testing.assert_identical(f.drop_attrs(), free.drop_attrs())
    assert float(np.abs(f.boundary_force_density).max()) > 0


# --- lazy ------------------------------------------------------------------------------------------------


def test_nothing_computes_while_the_graph_is_built():
    ds = xcg.datasets.random_scene(50).chunk(time=1)

    def refuse(dsk, keys, **kwargs):
        pytest.fail("computed while the graph was built")

    with dask.config.set(scheduler=refuse):
        f = ds.cg.coarse_grain(by="species", axes="z")
        g = f.pressure.sel(phase="bulk").mean("z")
    assert isinstance(g.data, dask.array.Array)


@pytest.mark.parametrize("scheduler", ["synchronous", "threads", "processes"])
def test_lazy_equals_eager_under_every_scheduler(scheduler, computing):
    ds = random_steps(5)
    eager = ds.cg.coarse_grain(width=0.8, spacing=1.0)
    for chunk in (1, 2, 5):
        f = ds.chunk(time=chunk).cg.coarse_grain(width=0.8, spacing=1.0)
        assert f.density.chunks[0] == ds.chunk(time=chunk).position.chunks[0]
        xr.testing.assert_equal(f.compute(**computing(scheduler)), eager)


def test_time_verbs_and_chunks_along_particles():
    ds = random_steps(5)
    whole = ds.cg.coarse_grain(["density", "contact_stress"], width=0.8)
    chunked = ds.chunk(time=2, particle=7, contact=11)
    part = chunked.isel(time=[3, 1]).cg.coarse_grain(["density", "contact_stress"], width=0.8)
    xr.testing.assert_equal(part.compute(), whole.isel(time=[3, 1]))
    np.testing.assert_allclose(part.time, [0.3, 0.1])
    one = ds.isel(time=3).cg.coarse_grain(["density", "contact_stress"], width=0.8)
    xr.testing.assert_equal(one, whole.isel(time=3))


def test_plan_pickles_and_explains():
    ds = xcg.datasets.random_scene(20)
    assert "averaged  x (box), y (box)" in str(ds.cg.explain("pressure", axes="z"))
    plan = ds.cg.explain(["pressure"], rtol=1e-3)
    assert str(pickle.loads(pickle.dumps(plan))) == str(plan)
    text = str(plan)
    assert "Gauss points by branch length" in text
    assert "<td" in plan._repr_html_()
    assert "Gauss points by branch length" in plan._repr_html_()
    assert "contact_i" not in str(ds.cg.explain("density"))


def test_blocks_are_smaller_where_a_grain_reaches_many_nodes():
    """Their sums then take 10 MB, instead of 40 and more."""
    ds = xcg.datasets.random_scene(20)
    bounds = dict.fromkeys("xyz", (0.0, 40.0))
    coarse, fine = (ds.cg.explain(width=0.8, spacing=0.8 / k, bounds=bounds) for k in (1, 4))
    of_one_field = ds.cg.explain("density", width=0.8, spacing=0.2, bounds=bounds)
    assert coarse.block_nodes == of_one_field.block_nodes == BLOCK_NODES
    assert fine.block_nodes < 0.3 * BLOCK_NODES
    assert "memory    10 MB of sums a thread" in str(fine)


def test_explain_accepts_bodies_and_presets():
    ds = xcg.datasets.random_scene(20)
    ds = ds.drop_vars("species").assign(body_id=(ds.particle_id.dims, np.arange(20)[None] // 2))
    assert "volume_fraction" in str(ds.cg.explain("volume_fraction", by_body="body_id", width=1.0))
    with pytest.raises(xcg.SceneError, match="body"):
        ds.cg.explain("volume_fraction", by_body="no_body")
    assert str(ds.cg.explain("density", width=1.0, on_error="skip")) == str(
        ds.cg.explain("density", width=1.0)
    )
    theirs = str(ds.cg.explain(preset="pysammos", width=1.0, on_error="skip"))
    assert "shear_rate_tensor" in theirs
    with pytest.raises(ValueError, match="'pysammos'"):
        ds.cg.explain(preset="other")


@pytest.mark.parametrize("row", [0, 7, 19])
def test_positions_that_are_nan_raise(row):
    ds = xcg.datasets.random_scene(20)
    position = ds.position.values.copy()
    position[0, row, 1] = np.nan
    with pytest.raises(xcg.SceneError):
        ds.assign(position=(ds.position.dims, position)).cg.coarse_grain("density", width=1.0)


@pytest.mark.parametrize("changed", ["components in another order", "no grains", "grains at rest"])
def test_loops_are_compiled_once_for_scenes_of_any_form(changed):
    ds = xcg.datasets.random_scene(20, seed=1).drop_vars("wall_velocity", errors="ignore")
    ds.cg.coarse_grain(width=1.0)
    forms = {
        "components in another order": lambda: ds.isel(component=[2, 0, 1]),
        "no grains": lambda: ds.isel(particle=slice(0, 0), contact=slice(0, 0)),
        "grains at rest": lambda: ds.assign(velocity=0.0 * ds.velocity),
    }
    loops = deposit, deposit_segments, list_segments
    before = [set(loop.signatures) for loop in loops]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        forms[changed]().cg.coarse_grain(width=1.0, bounds=dict.fromkeys("xyz", (0.0, 1.0)))
    assert [set(loop.signatures) for loop in loops] == before


def test_grains_of_one_velocity_have_no_temperature():
    ds = xcg.datasets.random_scene(60, seed=4)
    f = ds.assign(velocity=xr.full_like(ds.velocity, 0.3)).cg.coarse_grain(by="species", width=1.0)
    seen = f.granular_temperature.sel(phase="bulk").dropna("z", how="all")
    assert seen.size
    assert float(abs(seen).max()) == 0.0


@pytest.mark.parametrize("rtol", [0.0, 1e-3])
@pytest.mark.parametrize("long", ["x", "y", "z"])
def test_threads_and_blocks_change_no_bit(long, rtol):
    """What is left out in a box of nodes must not change what is added there."""
    ds = xcg.datasets.random_scene(150, seed=12)
    options = {
        "by": "species",
        "width": 0.6,
        "rtol": rtol,
        "spacing": {a: 0.31 if a == long else 0.7 for a in "xyz"},
    }
    results = []
    for threads, box in ((1, 65_000), (3, 65_000), (2, 7)):
        with (
            planning(BLOCK_NODES=box),
            sharing_threads(threads),
        ):
            results.append(
                [ds.cg.coarse_grain(**options), ds.cg.coarse_grain(axes=long, rtol=rtol, width=0.6)]
            )
    for other in results[1:]:
        for one, another in zip(results[0], other, strict=True):
            for name in one:
                assert one[name].values.tobytes() == another[name].values.tobytes(), name


@pytest.mark.parametrize("gradient", ["least_squares", "paper"])
@pytest.mark.parametrize("axes", ["xyz", "xz", "z"])
def test_fluctuation_stress_is_the_same_with_and_without_phases(axes, gradient):
    """Without phases the part that the fit explains is subtracted, with phases moments are expanded about it."""
    ds = xcg.datasets.random_scene(200, seed=6)
    options = {"axes": axes, "width": 0.7, "spacing": 0.5, "gradient": gradient}
    alone = ds.cg.coarse_grain(["fluctuation_stress", "kinetic_stress"], **options)
    split = ds.cg.coarse_grain(["fluctuation_stress"], by="species", **options).sel(phase="bulk")
    size = float(alone.kinetic_stress.max())
    np.testing.assert_allclose(
        alone.fluctuation_stress, split.fluctuation_stress, rtol=0, atol=1e-9 * size
    )
    assert float(alone.fluctuation_stress.max()) > 1e-3 * size


@pytest.mark.parametrize(
    ("steps", "worth", "shared"), [(1, 0, True), (2, 0, False), (1, WORTH_SHARING, False)]
)
def test_one_large_lazy_step_uses_all_threads_and_others_take_one_each(steps, worth, shared):
    one = xcg.datasets.random_scene(60, seed=2)
    times = [one.assign_coords(time=[float(t)], step=("time", [t])) for t in range(steps)]
    lazy = xr.concat(times, "time", combine_attrs="override").chunk(time=1)
    pool = mock.patch("xcg.compiled._jit.ThreadPoolExecutor", wraps=ThreadPoolExecutor)
    with (
        sharing_threads(2, worth),
        pool as pools,
    ):
        f = lazy.cg.coarse_grain(width=0.8).compute()
    assert pools.called == shared
    for name, values in one.cg.coarse_grain(width=0.8).items():
        assert f[name][:1].values.tobytes() == values.values.tobytes(), name


def test_sub_selection_of_particles_keeps_their_side():
    """Contacts whose partner is gone count as contacts with a wall."""
    ds = xcg.datasets.random_scene(80, seed=10)
    half = ds.isel(particle=slice(0, 40)).cg.coarse_grain(
        ["contact_stress", "boundary_force_density"], width=0.8
    )
    rest = ds.isel(particle=slice(40, None)).cg.coarse_grain(
        ["contact_stress", "boundary_force_density"], width=0.8
    )
    whole = ds.cg.coarse_grain(["contact_stress"], width=0.8)
    both = half.contact_stress + rest.contact_stress
    np.testing.assert_allclose(
        both, whole.contact_stress, atol=1e-12 * float(whole.contact_stress.max())
    )
    np.testing.assert_allclose(
        half.boundary_force_density, -rest.boundary_force_density, atol=1e-12
    )


# --- labels and requests ---------------------------------------------------------------------------------


def test_labels_and_provenance(tmp_path):
    f = xcg.datasets.random_scene(20).cg.coarse_grain(
        width=1.5, axes="xz", at={"y": 1.0}, by="species"
    )
    assert f.stress.dims == ("time", "x", "z", "phase", "component", "direction")
    assert f.stress.attrs["units"] == "Pa"
    assert f.velocity_gradient.attrs["units"] == "s^-1"
    assert float(f.y) == 1.0
    assert "coarse_grain(axes='xz', width=1.5" in f.attrs["history"]
    f.to_netcdf(tmp_path / "f.nc")
    with xr.open_dataset(tmp_path / "f.nc") as again:
        xr.testing.assert_equal(again, f)
    reduced = xcg.datasets.random_scene(20, units="reduced").cg.coarse_grain("stress", width=0.8)
    assert reduced.stress.attrs["units"] == "1"


def test_empty_nodes_are_nan_with_a_count_beside():
    ds = xcg.scene_from_arrays(
        [[0.0, 0, 0], [9.0, 0, 0]], velocity=np.ones((2, 3)), diameter=[1.0, 1.0], density=1.0
    )
    f = ds.cg.coarse_grain(
        axes="x", at={"y": 0, "z": 0}, bounds={"x": (0, 9)}, spacing=4.5, width=1.2
    )
    assert f.sample_count.values.tolist() == [[1, 0, 1]]
    assert f.density.values[0, 1] == 0
    for name in ("velocity", "granular_temperature", "d43", "particle_density"):
        assert np.isnan(f[name].values[0, 1]).all(), name
    # one grain has a velocity, but neither a gradient nor a temperature
    assert (f.velocity.values[0, 0] == 1).all()
    assert np.isnan(f.velocity_gradient.values[0, 0]).all()
    assert np.isnan(f.granular_temperature.values[0, 0])


def test_fields_of_a_scene_without_particles():
    ds = xcg.datasets.random_scene(0)
    f = ds.cg.coarse_grain(width=1.0)
    assert float(f.density.sum()) == 0
    assert float(f.stress.sum()) == 0
    assert np.isnan(f.velocity).all()


@pytest.mark.filterwarnings("ignore:no particle is left")
@pytest.mark.parametrize("none", ["selected", "free"])
def test_contacts_without_free_particles_add_nothing(none):
    """As where a selection leaves a step without grains, but its contacts; or where all grains are frozen."""
    ds = xcg.datasets.random_scene(20)
    frozen = ds["particle_id"].copy(data=np.ones((1, 20), "int64"))
    ds = ds.isel(particle=slice(0, 0)) if none == "selected" else ds.assign(frozen=frozen)
    names = [
        "contact_number_density",
        "interphase_force",
        "stress",
        "couple_stress",
        "heat_flux",
        "dissipation_rate",
    ]
    f = ds.cg.coarse_grain(
        names, by="species", groups=(1, 2), axes="z", width=1.0, bounds={"z": (0, 5)}
    )
    for name in names:
        assert not f[name].any(), name


def test_fields_that_the_scene_allows_are_the_default():
    ds = xcg.datasets.random_scene(20)
    bare = ds.drop_vars([n for n in ds.data_vars if str(n).startswith("contact")] + ["velocity"])
    f = bare.cg.coarse_grain(width=1.0)
    assert "density" in f
    assert "velocity" not in f
    assert "contact_stress" not in f
    with pytest.raises(xcg.SceneError, match="contact_force"):
        bare.cg.coarse_grain("stress", width=1.0)


def test_given_coordination_number_is_used():
    ds = xcg.datasets.random_scene(30)
    ds["coordination_number"] = xr.full_like(ds.mass, 7.0)
    f = ds.cg.coarse_grain("coordination_number", width=1.0)
    np.testing.assert_allclose(f.coordination_number.values[f.coordination_number.notnull()], 7.0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"width": 0.0}, "width=0.0: expected a positive"),
        ({"width": -1.0}, "expected a positive"),
        ({"width": float("nan")}, "expected a positive"),
        ({"width": "0.75 d44"}, "multiple of d43, d32, d50"),
        ({"fields": "densty"}, "unknown field"),
        ({"kernel": "cubic"}, "expected one of"),
        ({"axes": "xq"}, "axes names"),
        ({"axes": "x,y"}, r"axes names \[','\]: the axes of this scene are x, y, z"),
        ({"fields": "vel"}, "unknown field 'vel'; did you mean 'velocity'"),
        ({"axes": "z", "bounds": {"x": (0, 1)}}, "bounds are given for"),
        ({"axes": "xz", "at": {"x": 0.0}}, "both name"),
        ({"axes": "x", "spacing": -1.0}, "expected a positive distance"),
        ({"axes": "x", "bounds": {"x": (1, 0)}}, "first <= last"),
        ({"axes": "x", "extent": {"x": 1.0}}, "extent names"),
        ({"gradient": "magic"}, "expected one of"),
        ({"rtol": -1e-3}, "rtol=-0.001"),
        ({"at": {"x": float("nan")}}, r"expected a finite length \(m\)"),
        ({"spacing": 1e-5}, "nodes, more than"),
    ],
)
def test_wrong_arguments_raise(options, message):
    ds = xcg.datasets.random_scene(20)
    with pytest.raises(ValueError, match=message):
        ds.cg.coarse_grain(**options)


def test_spacing_larger_than_the_support_warns():
    with pytest.warns(xcg.SceneWarning, match="larger than the support"):
        xcg.datasets.random_scene(20).cg.coarse_grain("density", width=0.22, spacing=1.0)


def test_average_without_a_box_needs_an_extent():
    ds = xcg.scene_from_arrays(np.eye(3), diameter=np.ones(3), density=1.0)
    way = r"along 'x' and 'y', .*box=\{'x': .*'y': .*extent=\{'x': length, 'y': length\}"
    with pytest.raises(ValueError, match=way):
        ds.cg.coarse_grain("density", axes="z")
    f = ds.cg.coarse_grain("density", axes="z", extent={"x": 4.0, "y": 2.0}, spacing=0.05)
    assert float(f.density.sum() * 0.05 * 8) == pytest.approx(float(ds.mass.sum()), rel=1e-6)


def test_a_dataset_that_is_no_scene_raises():
    with pytest.raises(xcg.SceneError, match="open_scene"):
        xr.Dataset({"a": 1.0}).cg.coarse_grain()


def test_preferred_width_and_spacing():
    f = xcg.datasets.random_scene(50).cg.coarse_grain("density", width="0.5 dmax")
    assert f.attrs["width"] == pytest.approx(
        0.5 * float(xcg.datasets.random_scene(50).diameter.max())
    )
    # periodic axes divide the period evenly
    step = float(f.x[1] - f.x[0])
    assert step * f.sizes["x"] == pytest.approx(5.0)


def test_messages_name_only_fields_with_missing_variables():
    ds = xcg.scene_from_arrays(np.eye(3), velocity=np.eye(3), diameter=np.ones(3), density=1.0)
    with pytest.raises(
        xcg.SceneError,
        match=r"coarse_grain of stress, pressure needs \['contact_force', 'contact_i'",
    ):
        ds.cg.coarse_grain(["density", "stress", "velocity", "pressure"])


def test_messages_say_how_to_provide_missing_variables():
    ds = xcg.scene_from_arrays(np.eye(3), diameter=np.ones(3))
    with pytest.raises(
        xcg.SceneError, match=r"contacts= to xcg\.open_scene \(contact_i=.*ds\.cg\.find_contacts"
    ):
        ds.cg.microstructure(["coordination_number"])
    with pytest.raises(xcg.SceneError, match=r"needs \['mass'\]: give density= to"):
        ds.cg.coarse_grain("density")
    with pytest.raises(
        xcg.SceneError, match=r"needs \['velocity'\]: give velocity= to xcg\.scene_from_arrays"
    ):
        ds.assign(mass=ds.diameter).cg.coarse_grain("velocity")
    touching = ds.assign(mass=ds.diameter, velocity=ds.position).cg.find_contacts(skin=1.0)
    with pytest.raises(
        xcg.SceneError,
        match=r"needs \['contact_force'\]: ds\.cg\.find_contacts\(k_n=\.\.\.\) estimates",
    ):
        touching.cg.coarse_grain("stress")
    with pytest.raises(xcg.SceneError, match=r"call it on a scene, .*not on a result"):
        ds.cg.coarse_grain("number_density").cg.coarse_grain("number_density")
    with pytest.raises(
        ValueError, match=r"by='species': .* this scene has none; ds\.cg\.assign_phases"
    ):
        ds.cg.coarse_grain("number_density", by="species")


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            {"spacing": [1, 1, 1]},
            r"spacing=\[1, 1, 1\]: expected a distance \(m\), a multiple of a size such as '0.5 d43', or one by axis",
        ),
        ({"spacing": "1"}, "spacing='1': expected a length in metres or a multiple of"),
        (
            {"width": np.array([1.0])},
            r"width=array.* expected a length \(m\), a multiple of a size",
        ),
        ({"bounds": [(0, 1)] * 3}, "bounds=.* expected first and last node by axis"),
        ({"extent": 1.0, "axes": "z"}, "extent=1.0: expected a length"),
        ({"at": 1.0}, "at=1.0: expected a coordinate"),
        ({"by": ["species"]}, r"by=\['species'\]: expected the name of a variable"),
        ({"frame": "z"}, r"frame='z': expected xcg.Rotated\(...\) or xcg.Cylindrical\(...\)"),
    ],
)
def test_arguments_of_another_form_raise(wrong, message):
    ds = xcg.datasets.simple_cubic(3)
    for call in (ds.cg.coarse_grain, ds.cg.explain):
        with pytest.raises(ValueError, match=message):
            call("density", **wrong)
    f = ds.cg.coarse_grain("density", axes="z", width=xr.DataArray(1.0), spacing=np.float32(0.5))
    assert f.attrs["width"] == 1.0


# --- computing a plan ---


@pytest.mark.parametrize("dimension", [3, 2])
def test_a_kernel_narrower_than_the_largest_grain_warns(dimension):
    """Its volume times the kernel's largest value is the fraction at its centre."""
    small = xcg.datasets.random_scene(200, dimension=dimension, seed=2)
    position = small.position.values[0]
    diameter = small.diameter.values[0].copy()
    diameter[:] = 0.1
    diameter[5] = 1.0
    ds = xcg.scene_from_arrays(
        position, velocity=0 * position, diameter=diameter, density=1.0, dimension=dimension
    )
    at = (
        dict(zip("xyz", position[5], strict=True))
        if dimension == 3
        else dict(zip("xy", position[5], strict=False))
    )
    kernel = xcg.Lucy(0.2, dimension=dimension)
    with pytest.warns(
        SceneWarning, match="kernel is narrower than the largest grains, one of which alone"
    ) as told:
        f = ds.cg.coarse_grain("volume_fraction", axes="", at=at, kernel=kernel)
    volume = np.pi / 6 * (1.0 if dimension == 3 else 1.0 / 1.0)
    assert float(f.volume_fraction.max()) >= volume * float(kernel.value(0.0)) > 1.0
    assert len(told) == 1
    assert all(f"{a} = {value:.4g}" in str(told[0].message) for a, value in at.items())


def test_overlapping_grains_warn():
    position = np.random.default_rng(0).uniform(0, 2, (200, 3))
    ds = xcg.scene_from_arrays(
        position, velocity=0 * position, diameter=np.full(200, 0.8), density=1.0
    )
    with pytest.warns(SceneWarning, match="grains overlap, or their sizes"):
        ds.cg.coarse_grain("volume_fraction", width=0.8, axes="", at={"x": 1.0, "y": 1.0, "z": 1.0})


def test_possible_volume_fractions_do_not_warn():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        xcg.datasets.face_centred_cubic().cg.coarse_grain("volume_fraction")


def test_a_width_below_the_largest_diameter_warns():
    position = np.random.default_rng(0).uniform(0, 5, (300, 3))
    diameter = np.full(300, 0.1)
    diameter[0] = 3.0
    ds = xcg.scene_from_arrays(
        position, velocity=0 * position, diameter=diameter, mass=np.ones(300), box=[[0, 5.0]] * 3
    )
    ds.attrs["d43"] = 0.1  # the width is narrow for the largest grain alone
    with pytest.warns(SceneWarning, match="of the diameter of the largest grains"):
        ds.cg.coarse_grain("number_density", width=0.2, axes="")


def test_a_volume_fraction_above_one_by_a_narrow_kernel_names_the_kernel():
    """Layers of a cubic packing, whose spheres do not overlap."""
    x = np.arange(6.0)
    centres = np.stack(np.meshgrid(x, x, x, indexing="ij"), -1).reshape(-1, 3)
    ds = xcg.scene_from_arrays(
        centres,
        diameter=np.ones(216),
        density=1.0,
        box=dict.fromkeys("xyz", (-0.5, 5.5)),
        periodic="xyz",
    )
    with pytest.warns(
        SceneWarning, match=r"ends at 0.4, is narrower than the grains of 1.*cell_volumes"
    ):
        f = ds.cg.coarse_grain(["volume_fraction"], axes="z", width=0.2, spacing=0.05).compute()
    assert f.volume_fraction.max() > 1


def test_scenes_without_sizes_are_refused_for_their_sizes():
    ds = xcg.scene_from_arrays(np.eye(3), velocity=np.eye(3))
    for fields in ("density", "velocity", "number_density", None):
        with pytest.raises(xcg.SceneError, match=r"no sizes of the grains.* or give width="):
            ds.cg.coarse_grain(fields)
    for options in ({"width": 0.5}, {"kernel": xcg.Lucy(width=0.5)}):
        f = ds.cg.coarse_grain("number_density", **options)
        assert f.width == 0.5
