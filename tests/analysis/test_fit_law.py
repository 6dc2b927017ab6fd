"""Fits of laws: known parameters come back within their errors, and bad input is named."""

import numpy as np
import pytest
import xarray as xr
from scipy.stats import t as student_t

import xcg
from xcg.analysis.laws import LAWS

_I = np.geomspace(1e-3, 0.6, 24)
_HEIGHT = np.linspace(0.5, 9.5, 24)
# x, parameters, constants, and the noise as a share of y
CASES = {
    "mu_of_I": (_I, {"mu_s": 0.38, "mu_2": 0.64, "I_0": 0.28}, {}, 0.005),
    "mu_of_I_line": (_I, {"mu_s": 0.25, "slope": 1.1}, {}, 0.03),
    "phi_of_I": (_I, {"phi_c": 0.6, "slope": 0.2}, {}, 0.01),
    "fluidity": (_HEIGHT, {"g_first": 2.0, "length": 1.7}, {}, 0.05),
    "bagnold": (_HEIGHT, {"V_s": 8.0, "V_first": 1.0, "h": 10.0}, {}, 0.005),
    "haff": (np.linspace(3, 40, 24), {"T_first": 2.0, "tau": 7.0}, {}, 0.05),
    "beverloo": (
        np.linspace(0.02, 0.06, 12),
        {"C": 0.58, "k": 1.4},
        {"density": 1500.0, "diameter": 0.003},
        0.02,
    ),
}


def _result(law, x, y, **errors):
    row = LAWS[law]
    data = {row.y: ("node", y)} | {f"{n}_error": ("node", e) for n, e in errors.items()}
    return xr.Dataset(data, {row.x: ("node", x)})


def _exact(law):
    x, parameters, constants, _ = CASES[law]
    keywords = constants | ({"first": x.min()} if law in ("fluidity", "bagnold", "haff") else {})
    return x, LAWS[law].function(x, *parameters.values(), **keywords)


def test_laws_have_the_properties_that_define_them():
    law = {name: row.function for name, row in LAWS.items()}
    # half of the rise from mu_s to mu_2 at I_0
    np.testing.assert_allclose(
        law["mu_of_I"](np.array([0, 0.3, 1e12]), 0.4, 0.6, 0.3), [0.4, 0.5, 0.6]
    )
    np.testing.assert_allclose(law["mu_of_I_line"](np.array([0, 0.5]), 0.4, 2.0), [0.4, 1.4])
    np.testing.assert_allclose(law["phi_of_I"](np.array([0, 0.5]), 0.6, 0.2), [0.6, 0.5])
    # falls by e over a length
    np.testing.assert_allclose(
        law["fluidity"](np.array([1.0, 3.5]), 2.0, 2.5, first=1.0), [2, 2 / np.e]
    )
    # the rate of shear is the root of the depth, and zero above the surface
    z = np.array([1.0, 4.0, 8.0, 9.0])
    v = law["bagnold"](z, 5.0, 2.0, 8.0, first=1.0)
    np.testing.assert_allclose(v[[0, 2, 3]], [2, 5, 5])
    rate = np.diff(
        [law["bagnold"](z[:2] + h, 5.0, 2.0, 8.0, first=1.0) for h in (-1e-6, 1e-6)], axis=0
    )
    assert rate[0, 0] / rate[0, 1] == pytest.approx(np.sqrt(7 / 4))
    # a quarter of the temperature after tau
    np.testing.assert_allclose(law["haff"](np.array([3.0, 10.0]), 2.0, 7.0, first=3.0), [2, 0.5])
    # nothing through an opening of k diameters, 2^5/2 as much through twice what is beyond it
    flow = law["beverloo"](
        np.array([0.01, 0.014, 0.016, 0.018]), 0.58, 1.4, density=1500.0, diameter=0.01
    )
    np.testing.assert_allclose(flow[:2], 0, atol=1e-15)
    assert flow[3] / flow[2] == pytest.approx(2**2.5)
    assert flow[3] == pytest.approx(0.58 * 1500 * np.sqrt(9.81) * 0.004**2.5)


@pytest.mark.parametrize("law", CASES)
def test_exact_points_give_the_parameters_back(law):
    x, y = _exact(law)
    _, parameters, constants, _ = CASES[law]
    fit = xcg.fit_law(_result(law, x, y), law, constants=constants)
    for name, value in parameters.items():
        assert float(fit[name]) == pytest.approx(value, rel=1e-6)
    np.testing.assert_allclose(fit.fitted, y, rtol=1e-6)
    assert fit.attrs["law"] == law
    assert np.isnan(fit.chi_squared)


# laws with and without constants or a first point; the errors of all are made in one way
@pytest.mark.parametrize(
    ("law", "weighted"),
    [("mu_of_I", True), ("bagnold", True), ("beverloo", True), ("mu_of_I", False), ("haff", False)],
)
def test_parameters_are_within_two_errors_in_95_of_100_draws(law, weighted):
    """Without errors of the points, estimates over their errors have Student's distribution."""
    x, y = _exact(law)
    _, parameters, constants, noise = CASES[law]
    r = np.random.default_rng(7)
    spread = r.uniform(0.5, 1.5, len(x)) if weighted else np.ones(len(x))
    sigma = noise * np.abs(y).max() * spread
    draws = 200
    inside = np.zeros(len(parameters))
    chi_squared = []
    for _ in range(draws):
        measured = y + sigma * r.normal(size=len(x))
        errors = {LAWS[law].y: sigma} if weighted else {}
        fit = xcg.fit_law(_result(law, x, measured, **errors), law, constants=constants)
        away = [abs(float(fit[n]) - v) / float(fit[f"{n}_error"]) for n, v in parameters.items()]
        inside += np.array(away) < 2
        chi_squared.append(float(fit.chi_squared))
    freedom = int(fit.degrees_of_freedom)
    share = 1 - 2 * student_t.sf(2, np.inf if weighted else freedom)
    noise_of_share = np.sqrt(share * (1 - share) / draws)
    assert (np.abs(inside / draws - share) < 3 * noise_of_share).all(), inside / draws
    if weighted:
        assert np.mean(chi_squared) == pytest.approx(freedom, abs=3 * np.sqrt(2 * freedom / draws))


def test_errors_of_parameters_are_in_proportion_to_those_of_the_points():
    x, y = _exact("mu_of_I_line")
    measured = y + 0.01 * np.random.default_rng(7).normal(size=len(x))
    fits = []
    for sigma in (0.01, 0.02):
        errors = {"friction_coefficient": np.full(len(x), sigma)}
        fits.append(xcg.fit_law(_result("mu_of_I_line", x, measured, **errors), "mu_of_I_line"))
    for name in CASES["mu_of_I_line"][1]:
        assert float(fits[1][name]) == pytest.approx(float(fits[0][name]), rel=1e-4)
        assert float(fits[1][f"{name}_error"]) == pytest.approx(
            2 * float(fits[0][f"{name}_error"]), rel=1e-3
        )


@pytest.mark.parametrize("points", [4, 5])
def test_fits_of_few_points_say_how_uncertain_their_errors_are(points):
    x = np.linspace(0.01, 0.1, points)
    y = 0.3 + 0.9 * x + 0.01 * np.random.default_rng(2).normal(size=points)
    f = _result("mu_of_I_line", x, y)
    if points == 5:
        xcg.fit_law(f, "mu_of_I_line")
        return
    text = "4 points for 2 parameters leave 2 degrees of freedom.* uncertain by 50%.* Fit 5 points"
    with pytest.warns(xcg.SceneWarning, match=text):
        xcg.fit_law(f, "mu_of_I_line")


def test_errors_of_x_count_by_the_slope_of_the_law():
    """A line y = a + b x with errors of x alone has those of y = b s_x."""
    x, y = _exact("mu_of_I_line")
    sigma = np.full(len(x), 0.02)
    both = {"inertial_number": 0.03 * np.ones(len(x)), "friction_coefficient": sigma}
    fit = xcg.fit_law(_result("mu_of_I_line", x, y, **both), "mu_of_I_line")
    effective = np.hypot(0.02, 1.1 * 0.03)
    matrix = np.stack([np.ones(len(x)), x], axis=1) / effective
    np.testing.assert_allclose(fit.covariance, np.linalg.inv(matrix.T @ matrix), rtol=1e-4)


@pytest.mark.filterwarnings("ignore:fit_law. 3 points for 2 parameters")
@pytest.mark.parametrize("points", [3, 8])
def test_a_line_where_the_points_hold_no_more_says_so(points):
    x = np.linspace(0.001, 0.02, points)
    y = 0.3 + 0.9 * x + 0.002 * np.random.default_rng(2).normal(size=points)
    f = _result("mu_of_I", x, y, friction_coefficient=np.full(points, 0.002))
    with pytest.warns(xcg.SceneWarning, match="hold no more than a line"):
        fit = xcg.fit_law(f)
    assert fit.attrs["law"] == "mu_of_I_line"
    line = xcg.fit_law(f, "mu_of_I_line")
    xr.testing.assert_identical(fit.drop_attrs(), line.drop_attrs())
    assert abs(float(fit.slope) - 0.9) < 3 * float(fit.slope_error)


def test_custom_laws_take_names_and_constants_from_their_arguments():
    x = np.linspace(1, 3, 9)
    f = xr.Dataset({"load": ("node", 2 * x**1.5 + 4)}, {"depth": ("node", x)})
    with pytest.raises(ValueError, match="needs x= and y="):
        xcg.fit_law(f, lambda x, a: a * x)
    fit = f.cg.fit_law(
        lambda x, a, b, *, start: a * x**b + start,
        x="depth",
        y="load",
        constants={"start": 4.0},
        guess=(1.0, 1.0),
    )
    assert float(fit.a) == pytest.approx(2, rel=1e-8)
    assert float(fit.b) == pytest.approx(1.5, rel=1e-8)
    assert fit.attrs["law"] == "custom"


def test_maps_are_fitted_along_axes_of_any_name():
    """The axes x and y of a map are not the x and y of the law."""
    z = xr.DataArray(np.linspace(0.0, 4.0, 9), dims="z")
    for axis in "xy":
        places = xr.DataArray(np.arange(5.0), dims=axis)
        field = 2.0 - 0.3 * z + 0 * places
        f = xr.Dataset({"volume_fraction": field}, {"z": z, axis: places})
        fit = xcg.fit_law(f, "phi_of_I", x="z")
        assert float(fit.slope) == pytest.approx(0.3)
        assert int(fit.point_count) == 45
        xr.testing.assert_allclose(fit.fitted, field.assign_coords(z=z, **{axis: places}))


def test_nodes_closer_than_a_support_are_fewer_points():
    z = np.linspace(0, 4, 21)
    f = xr.Dataset({"fluidity": ("z", np.exp(-z)), "fluidity_error": ("z", 0.1 + 0 * z)}, {"z": z})
    apart = f.cg.fit_law("fluidity")
    shared = f.assign_attrs(cutoff=1.0).cg.fit_law("fluidity")
    np.testing.assert_allclose(shared.covariance, 10 * apart.covariance, rtol=1e-12)


def test_fields_of_a_scene_are_fitted_with_units():
    f = xcg.datasets.open("cooling").isel(time=slice(0, 8))
    f = f.cg.coarse_grain("granular_temperature", errors=True, axes="", at={})
    fit = f.chunk(time=2).cg.fit_law("haff")
    assert 0 < float(fit.tau_error) < 0.2 * float(fit.tau)
    assert fit.fitted.dims == ("time",)
    assert set(fit.tau.attrs) == {"units", "long_name"}
    assert "fit_law(law='haff')" in fit.attrs["history"]


@pytest.mark.parametrize(
    ("change", "options", "message"),
    [
        ({}, {"law": "mu_of_j"}, "unknown law 'mu_of_j'; did you mean 'mu_of_I'"),
        ({}, {"x": "inertia_number"}, "did you mean 'inertial_number'"),
        ({}, {"constants": {"d": 1.0}}, "unknown constant 'd'"),
        ({}, {"constants": [1.0]}, r"constants=\[1.0\]: expected numbers by name"),
        ({}, {"law": lambda x: x, "x": "inertial_number", "y": "friction_coefficient"},
         "the law has no parameters"),
        ({"friction_coefficient": -1.0}, {"law": "fluidity", "x": "inertial_number",
          "y": "friction_coefficient"}, "needs values above zero, and the largest is -"),
        ({}, {"guess": (1.0, np.nan, 1.0)}, "a finite number for each of mu_s, mu_2, I_0"),
        ({}, {"law": "beverloo", "x": "inertial_number", "y": "friction_coefficient"},
         "needs the constants density, diameter"),
        ({"friction_coefficient": np.nan}, {"law": "mu_of_I_line"}, "0 points with finite"),
    ],
)  # fmt: skip
def test_bad_input_is_named(change, options, message):
    x, y = _exact("mu_of_I")
    f = _result("mu_of_I", x, y)
    f = f.assign({name: f[name] * value for name, value in change.items()})
    with pytest.raises(ValueError, match=message):
        xcg.fit_law(f, **options)


def test_points_that_leave_a_parameter_open_are_named():
    x = np.linspace(0.1, 1, 9)
    f = xr.Dataset({"load": ("node", x)}, {"depth": ("node", x)})
    with pytest.warns(xcg.SceneWarning, match="do not determine all parameters"):
        fit = f.cg.fit_law(lambda x, a, b: a * x + 0 * b, x="depth", y="load")
    assert np.isinf(fit.b_error)


def test_vectors_need_a_component():
    f = xr.Dataset({"velocity": (("z", "component"), np.ones((5, 3)))}, {"z": np.arange(5.0)})
    with pytest.raises(ValueError, match="select a component first"):
        f.cg.fit_law("bagnold")


def test_dates_are_no_numbers_to_fit():
    """They would be nanoseconds since 1970."""
    times = np.datetime64("2024-01-01", "ns") + np.arange(5) * np.timedelta64(1, "s")
    f = xr.Dataset({"density": ("time", np.arange(5.0))}, {"time": times})
    with pytest.raises(ValueError, match=r"'time' holds datetime64\[ns\]; f.assign_coords\(time="):
        f.cg.fit_law(lambda t, a, b: a + b * t, x="time", y="density")


def test_points_without_an_error_among_others_are_left_out_with_a_warning():
    x, y = _exact("phi_of_I")
    sigma = np.full(len(x), 0.01)
    sigma[3] = np.nan
    with pytest.warns(xcg.SceneWarning, match="1 of 24 points have no standard error"):
        fit = xcg.fit_law(_result("phi_of_I", x, y, volume_fraction=sigma), "phi_of_I")
    assert int(fit.point_count) == 23


def test_the_band_of_a_line_is_that_of_its_formula():
    """The variance of a + b x is C_aa + 2 x C_ab + x^2 C_bb."""
    rng = np.random.default_rng(2)
    x = np.linspace(1.0, 3.0, 20)
    f = xr.Dataset({"q": ("z", x), "g": ("z", 2 + 3 * x + rng.normal(0, 0.1, 20))})
    f = f.assign(g_error=("z", np.full(20, 0.1)))
    fit = xcg.fit_law(f, lambda x, a, b: a + b * x, x="q", y="g")
    places = fit.curve_x.to_numpy()
    c = fit.covariance.to_numpy()
    np.testing.assert_allclose(fit.curve, fit.a.item() + fit.b.item() * places)
    variance = c[0, 0] + 2 * places * c[0, 1] + places**2 * c[1, 1]
    np.testing.assert_allclose(fit.curve_error, variance**0.5, rtol=1e-6)
    np.testing.assert_array_equal(fit.fit_y, f.g)
    np.testing.assert_array_equal(fit.fit_y_error, f.g_error)


def test_the_picture_of_a_fit_has_points_curve_and_band():
    plt = pytest.importorskip("matplotlib.pyplot")
    numbers = np.geomspace(1e-3, 0.5, 12)
    mu = 0.38 + (0.64 - 0.38) / (1 + 0.28 / numbers) * (1 + 0.01 * (-1.0) ** np.arange(12))
    f = xr.Dataset({"inertial_number": ("z", numbers), "friction_coefficient": ("z", mu)})
    fit = xcg.fit_law(f, "mu_of_I")
    ax = fit.cg.plot()
    points, curve = ax.lines
    np.testing.assert_array_equal(points.get_ydata(), mu)
    assert len(curve.get_xdata()) == 200
    x = curve.get_xdata()
    law = fit.mu_s.item() + (fit.mu_2 - fit.mu_s).item() / (1 + fit.I_0.item() / x)
    np.testing.assert_allclose(curve.get_ydata(), law)
    assert ax.get_xscale() == "log"
    assert "inertial number" in ax.get_xlabel()
    assert len(ax.collections) >= 1
    label = fit.assign(mu_s=0.38214, mu_s_error=0.0068, I_0=0.0, mu_2=63.79, mu_2_error=1.24)
    _, *parameters = label.cg.plot(ax=plt.figure().gca()).lines[1].get_label().split("\n")
    written = dict(line.split(" = ") for line in parameters)
    assert written["mu_s"] == "0.3821 ± 0.0068"
    assert written["mu_2"] == "63.8 ± 1.2"
    assert written["I_0"].startswith("0 ± ")
    plt.close("all")
