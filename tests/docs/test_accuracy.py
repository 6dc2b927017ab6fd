"""What docs/accuracy.md claims and does not depend on the clock, on the chart's own scenes and ways."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

import xcg
from docs import accuracy, alternatives
from tests import ROOT

PARTICLES = 2000


@pytest.fixture(scope="module", autouse=True)
def _one_thread():
    with accuracy.one_thread():
        yield


@pytest.fixture(scope="module")
def errors():
    """Errors of a panel by (series, name); panels are computed once."""
    found = {}

    def of(make):
        if make not in found:
            found[make] = {(w.series, w.name): w.error for w in make(PARTICLES).ways}
        return found[make]

    return of


# panels are made alike: one of them is enough for a change
@pytest.mark.parametrize(
    "make",
    [
        pytest.param(make, marks=() if make is accuracy.kinetic_stress else pytest.mark.slow)
        for make in accuracy.PANELS
    ],
    ids=lambda make: make.__name__,
)
def test_every_panel_has_a_default_in_each_group_of_ways(make):
    panel = make(PARTICLES)
    groups = {way.group for way in panel.ways}
    assert {way.group for way in panel.ways if way.default} == groups
    assert all(np.isfinite(way.error) for way in panel.ways)
    points, floors = accuracy.measure(panel, PARTICLES, 1)
    assert [point.way for point in points] == list(panel.ways)
    assert floors.keys() == panel.floors.keys()


def test_errors_of_contact_stress_are_below_rtol(errors):
    error = errors(accuracy.contact_stress)
    assert error["closed form", "rtol 0"] < 1e-14
    for exponent in range(1, 5):
        assert error["rule by branch length", f"rtol 1e-{exponent}"] <= 10.0**-exponent
    points = [error["Gauss-Legendre, all contacts", f"{k} points"] for k in (2, 4, 6, 8, 10, 12)]
    assert (np.diff(points) < 0).all()
    # two points more gain less and less: the kernel is smooth only to its second derivative
    assert points[0] > 1e-3
    assert points[2] > 1e-6
    assert points[5] > 1e-7


@pytest.mark.slow  # the other panels
def test_errors_of_kernel_tables_scale_with_their_bins(errors):
    error = errors(accuracy.volume_fraction)
    assert error["kernel evaluated", "evaluated"] < 1e-14
    assert 1e-8 < error["weights in single precision", "single precision"] < 1e-6
    for bins in (10**2, 10**3, 10**4, 10**5):
        # rounding down reads too large a weight everywhere, so that errors do not cancel
        assert 1 / bins < error["table, rounded down", f"{bins} bins"] < 10 / bins
        assert 0.5 / bins**2 < error["table, interpolated", f"{bins} bins"] < 10 / bins**2


def test_raw_moments_lose_digits_and_relative_ones_do_not(errors):
    error = errors(accuracy.kinetic_stress)
    for speed in (1e3, 1e6):
        series = f"V / v' = {speed:.0e}"
        assert 1e-18 * speed**2 < error[series, "raw moments"] < 1e-14 * speed**2
        assert error[series, "two passes"] < 1e-12
        assert error[series, "relative to the node"] < 1e-12
    assert error["V / v' = 1e+06", "raw moments"] > 1e-6


def test_only_least_squares_gives_zero_temperature_in_shear(errors):
    error = errors(accuracy.temperature)
    alone = {name: e for (series, name), e in error.items() if series == "shear alone"}
    assert alone.pop("linear, least squares") < 1e-13
    assert alone.pop("the same per density") < 1e-13
    assert min(alone.values()) > 1e-5
    assert alone["V at the grains"] < alone["linear, kernel gradient"] < alone["V at the node"]


def test_temperature_of_independent_fluctuations_per_density_needs_a_wide_kernel():
    """A fit takes four degrees of freedom away: two thirds of T at 0.75 d, little at 1.5 d."""
    ways, truth = accuracy.temperature_ways(accuracy.sheared(4000, 1.0), 1.5)
    found = {
        name: float(accuracy.inside(run()).mean() / accuracy.inside(truth).mean())
        for name, run in ways.items()
    }
    assert 0.88 < found["the same per density"] < 1.0
    assert found["linear, least squares"] == pytest.approx(1.0, abs=0.03)
    assert found["V at the node"] > 1.1
    ways, truth = accuracy.temperature_ways(accuracy.sheared(4000, 1.0), 0.75)
    narrow = float(
        accuracy.inside(ways["the same per density"]()).mean() / accuracy.inside(truth).mean()
    )
    assert 0.2 < narrow < 0.5
    assert float(accuracy.inside(ways["linear, least squares"]()).mean()) == pytest.approx(
        1.0, abs=0.05
    )


def test_gradients_in_uniform_shear(errors):
    error = errors(accuracy.velocity_gradient)
    assert error["fit through the grains", "least squares"] < 1e-13
    assert 0.02 < error["derivative of V(r)", "kernel gradient"] < 1.0
    # finer differences come nearer to the derivative of the field, not to the rate of the flow
    assert (
        error["differences on a mesh", "mesh w/2"] > error["differences on a mesh", "mesh w"] > 0.01
    )


def test_marginals_are_exact_and_meshes_are_not(errors):
    error = errors(accuracy.profiles)
    for series in ("density", "contact stress"):
        assert error[series, "marginal"] < 1e-13
        assert 1e-4 < error[series, "mesh w"] < 0.1
        assert error[series, "mesh w/4"] < 0.1 * error[series, "mesh w"]


@pytest.mark.parametrize("name", ["volume_fraction", "contact_stress"])
def test_interpolation_between_nodes_errs_as_documented(name):
    """What docs/evaluation.md says of finer meshes."""
    ds = accuracy.packing(PARTICLES)
    box = ds.attrs["box_upper"]
    count = np.rint(box / accuracy.WIDTH)

    def field(refined):
        spacing = dict(zip("xyz", box / (refined * count), strict=True))
        return ds.cg.coarse_grain(name, width=accuracy.WIDTH, spacing=spacing)[name].values[0]

    fine = field(4)
    error = {}
    for refined in (1, 2):
        coarse = field(refined)
        places = np.indices(fine.shape[:3]) * (refined / 4)
        for order in (1, 3):
            between = np.empty_like(fine)
            for k in np.ndindex(fine.shape[3:]):
                map_coordinates(
                    coarse[..., *k], places, between[..., *k], order=order, mode="grid-wrap"
                )
            error[refined, order] = accuracy.relative(between, fine)
    assert 0.2 < error[1, 1] < 0.4
    assert 0.05 < error[1, 3] < 0.2
    assert 0.05 < error[2, 1] < 0.2
    assert 0.005 < error[2, 3] < 0.02


def test_velocity_at_grains_equals_the_field():
    ds = accuracy.sheared(300, 1.0)
    x = ds.position.values[0]
    v = ds.velocity.values[0]
    m = ds.mass.values[0]
    found = accuracy.alternatives.velocity_at_grains(x, v, m, accuracy.CUTOFF)
    for i in (0, 17, 299):
        at = dict(zip("xyz", x[i].tolist(), strict=True))
        f = ds.cg.coarse_grain("velocity", axes="", at=at, width=accuracy.WIDTH)
        np.testing.assert_allclose(found[i], f.velocity.values[0], atol=1e-12)


def test_the_front_has_the_points_that_no_other_beats():
    way = accuracy.Way("", lambda: None, 0.0, "")
    points = [
        accuracy.Point(way, t, e)
        for t, e in ((1, 1e-2), (2, 1e-2), (3, 1e-4), (4, 1e-3), (5, 1e-9))
    ]
    assert [p.time for p in accuracy.front(points)] == [1, 3, 5]
    assert [p.beaten(points) for p in points] == [False, True, False, True, False]


@pytest.mark.parametrize("periodic", ["", "xz", "xyz"])
def test_no_contact_of_a_packing_crosses_an_edge_that_is_not_periodic(periodic):
    ds = xcg.datasets.dense_packing(1000, periodic=periodic)
    i, j = (np.searchsorted(ds.particle_id[0], ds[name][0]) for name in ("contact_i", "contact_j"))
    apart = np.abs(ds.position.values[0][i] - ds.position.values[0][j])
    across = (apart > 0.5 * ds.attrs["box_upper"]).any(axis=0)
    assert across.tolist() == [a in periodic for a in "xyz"]
    assert ds.sizes["contact"] == 3000


@pytest.mark.parametrize(
    ("particles", "contacts"), [(1, 0.0), (2, 0.5), (1000, 3.0), (1234, 3.0), (4000, 2.0)]
)
def test_the_dense_packing_is_dense(particles, contacts):
    ds = xcg.datasets.dense_packing(particles, diameter=2.0, contacts=contacts)
    volume = np.prod(ds.attrs["box_upper"] - ds.attrs["box_lower"])
    assert ds.sizes["particle"] == particles
    assert float(ds.volume.sum()) / volume == pytest.approx(0.6)
    assert ds.sizes["contact"] == round(contacts * particles)
    assert ds.identical(xcg.datasets.dense_packing(particles, diameter=2.0, contacts=contacts))
    if particles > 100:
        i, j = (
            np.searchsorted(ds.particle_id[0], ds[name][0]) for name in ("contact_i", "contact_j")
        )
        x = ds.position.values[0]
        box = ds.attrs["box_upper"]
        branch = x[i] - x[j] - box * np.rint((x[i] - x[j]) / box)
        assert np.linalg.norm(branch, axis=1).max() < 1.3 * 2.0
        assert len(np.unique(np.sort(np.stack([i, j]), axis=0), axis=1).T) == len(i)


def test_the_loop_in_c_adds_the_same_as_in_numba():
    """Both loops add the same: what they are compared by is the same work."""
    in_c = alternatives.multiply_add_in_c()
    if in_c is None:
        pytest.skip("no C compiler")
    rng = np.random.default_rng(5)
    weights = rng.normal(size=37)
    factors = rng.normal(size=101)
    sums = np.zeros(400), np.zeros(400)
    for loop, out in zip((alternatives.multiply_add, in_c), sums, strict=True):
        loop(out, weights, factors)
    np.testing.assert_allclose(sums[1], sums[0], rtol=1e-12, atol=1e-12)


def test_the_chart_can_be_drawn_again_from_the_page():
    panel = accuracy.kinetic_stress(PARTICLES)
    points, _ = accuracy.recorded(panel)
    page = (ROOT / "docs" / "accuracy.md").read_text()
    for point in points:
        assert f"| {point.time:.2f} | {point.error:.1e} |" in page
