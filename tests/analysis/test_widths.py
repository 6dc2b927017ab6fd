"""Bias, plateau and choice of the width against flows that are known."""

import warnings
from functools import partial

import numpy as np
import pytest
import xarray as xr

import xcg
from tests import flows
from tests.flows import FLOWS, NODES

WIDTHS = np.geomspace(0.3, 2.0, 9)


def test_each_width_is_the_field_at_that_width():
    ds = xcg.datasets.random_scene(100, seed=1)
    at = {"x": [1.0, 2.0], "y": [2.0, 3.0], "z": [2.5, 2.4]}
    s = ds.cg.width_sweep(WIDTHS, ["density", "stress"], at=at)
    assert s.stress.dims[:2] == ("width", "point")
    for k, w in enumerate(WIDTHS):
        alone = ds.cg.coarse_grain(
            "density", axes="", at={"x": 2.0, "y": 3.0, "z": 2.4}, width=w
        ).density
        assert s.density.isel(width=k, point=1).item() == alone.item()


def test_the_plateau_of_a_lattice_is_its_volume_fraction():
    ds = xcg.datasets.face_centred_cubic(5)
    s = ds.cg.width_sweep(WIDTHS, "volume_fraction", at={"x": 0.1, "y": 0.2, "z": 0.4})
    assert s.volume_fraction_plateau.item() == pytest.approx(np.pi / (3 * np.sqrt(2)), rel=1e-2)
    assert s.volume_fraction_plateau_width.item() > 0.5


def test_the_history_of_a_sweep_is_its_own_call():
    ds = xcg.datasets.random_scene(100, seed=1)
    s = ds.cg.width_sweep([0.6, 0.9, 1.2], "density", at={"x": 1.0, "y": 2.0, "z": 2.5})
    (call,) = s.attrs["history"].splitlines()[-1:]
    assert "width_sweep(widths=[0.6, 0.9, 1.2], fields='density'" in call
    assert "coarse_grain" not in s.attrs["history"]
    assert "on_error" not in call
    assert (
        s.density_slope.attrs["long_name"]
        == "size of the logarithmic slope of mass density of the mixture by width"
    )


def test_biases_and_slopes_have_no_formula_or_averaging_rule_of_their_field():
    ds = xcg.datasets.random_scene(60, seed=1)
    s = ds.cg.width_sweep([0.5, 0.7, 0.9], "velocity", axes="z")
    assert "formula" in s.velocity.attrs
    for name in ("bias", "extrapolated", "too_wide", "slope", "plateau_width"):
        assert set(s[f"velocity_{name}"].attrs) == {"units", "long_name"}


def test_a_missing_plateau_is_reported():
    """The density at a lone grain falls as w^-3 for ever."""
    ds = xcg.scene_from_arrays([[0.0, 0, 0]], diameter=[1.0], density=1.0)
    s = ds.cg.width_sweep(WIDTHS, "density", at={"x": 0, "y": 0, "z": 0})
    assert np.isnan(s.density_plateau_width.item())
    np.testing.assert_allclose(s.density_slope[1:-1], 3.0, rtol=0.1)


def test_profiles_keep_their_nodes():
    ds = xcg.datasets.random_scene(100, seed=1, periodic="xy").chunk()
    s = ds.cg.width_sweep(WIDTHS[::3], "density", axes="z")
    assert s.density.dims == ("width", "time", "z")
    assert s.density.notnull().all()
    lone = ds.cg.coarse_grain(
        "density", axes="z", width=WIDTHS[3], bounds={"z": (s.z[0], s.z[-1])}, spacing=WIDTHS[0]
    )
    swept = s.density.isel(width=1, drop=True).drop_vars("setup")  # which has no width
    xr.testing.assert_allclose(swept, lone.density.drop_vars(["setup", "width"]))


def test_wrong_arguments_raise():
    ds = xcg.datasets.random_scene(20)
    with pytest.raises(ValueError, match="two or more"):
        ds.cg.width_sweep([0.5, 0.5], "density")
    with pytest.raises(ValueError, match="same length"):
        ds.cg.width_sweep(WIDTHS, "density", at={"x": [1.0, 2.0], "y": [1.0]})


@pytest.mark.parametrize("name", ["sine", "band"])
def test_the_bias_of_two_widths_is_the_true_bias_within_a_third(name):
    """Without fluctuations and with many grains, where the bias is below a fifth of the field."""
    flow = {"sine": flows.sine, "band": partial(flows.band, thickness=3.0)}[name](
        60, temperature=0.0
    )
    for width in (0.75, 1.0, 1.4):
        s = flow.scene.cg.width_sweep([width, width * 2**0.5], "velocity", axes="z", spacing=0.5)
        f = s.isel(width=0).sel(component="x").mean("time")
        true = f.velocity - flow.truth(f.z)
        left = f.velocity_extrapolated - flow.truth(f.z)
        true, size, found, left = (
            float((x**2).mean() ** 0.5) for x in (true, f.velocity, f.velocity_bias, left)
        )
        assert 0.01 < true < 0.2 * size
        assert found == pytest.approx(true, rel=0.3)
        assert left < 0.35 * true


def test_the_bias_of_a_parabola_is_exact():
    """Of V = z^2 on a fine lattice, the kernel adds mu_2 at every node inside, and the extrapolated field is V."""
    z = np.linspace(-4, 4, 4001)
    ds = xcg.scene_from_arrays(
        np.stack([0 * z, 0 * z, z], 1), velocity=np.stack([z**2, 0 * z, 0 * z], 1), diameter=np.full(z.size, 0.1),
        density=1.0, box=np.array([[-1, 1], [-1, 1], [-8, 8]]), periodic="xy",
    )  # fmt: skip
    s = ds.cg.width_sweep(
        [0.5, 0.8], "velocity", axes="z", kernel="gaussian", bounds={"z": (-1, 1)}, spacing=0.25
    )
    s = s.sel(component="x", drop=True).isel(time=0, drop=True)
    moment = s.velocity.sel(z=0)
    assert moment.values[0] == pytest.approx(0.25, rel=0.1)
    xr.testing.assert_allclose(s.velocity_bias, moment * xr.ones_like(s.velocity), rtol=1e-4)
    np.testing.assert_allclose(
        s.velocity_extrapolated, xr.ones_like(s.velocity) * s.z**2, atol=1e-4
    )
    assert s.velocity_too_wide.all()  # by a fifth and by a third of the largest value
    assert not ds.cg.width_sweep(
        [0.1, 0.2], "velocity", axes="z", bounds={"z": (-1, 1)}
    ).velocity_too_wide.any()


# --- the width with the least error ----------------------------------------------------------------------


def true_error(flow, width, frames):
    """Error of the average over some frames, from the mean and the scatter of all."""
    f = flow.scene.cg.coarse_grain(flow.field, width=width, **NODES)
    parts = f[flow.field].sizes.get("component", 1)
    return np.hypot(
        flow.errors(f)[0], np.sqrt(parts * float(f[flow.field].var("time", ddof=1).mean()) / frames)
    )


@pytest.mark.parametrize(
    "name",
    [
        "sine",
        # they show the same for flows with other boundaries and gradients
        *(pytest.param(name, marks=pytest.mark.slow) for name in FLOWS if name != "sine"),
    ],
)
def test_the_chosen_width_is_nearly_the_best(name):
    flow = FLOWS[name](60)
    for frames in (4, 16, 60):
        found = flow.scene.cg.choose_width(flow.field, frames=frames, sample=16, **NODES)
        best = min(true_error(flow, width, frames) for width in np.geomspace(0.5, 4, 13))
        chosen = true_error(flow, found.best_width.item(), frames)
        assert chosen < 1.15 * best
        size = np.sqrt((flow.truth(np.arange(0.25, 12, 0.5)) ** 2).mean())
        assert found.best_total.item() == pytest.approx(chosen / size, rel=0.35)


@pytest.mark.parametrize("frames", [1, 9])
def test_the_total_adds_the_bias_and_the_noise_of_the_mean_over_frames(frames):
    found = FLOWS["sine"](8).scene.cg.choose_width(
        "velocity", frames=frames, widths=[0.8, 1.2, 1.8], **NODES
    )
    expected = np.sqrt(found.velocity_bias**2 + found.velocity_noise**2 / frames)
    np.testing.assert_allclose(found.velocity_total, expected, rtol=1e-12)
    assert (found.velocity_noise > 0).all()


def test_the_frames_for_a_target_reach_it():
    flow = FLOWS["sine"](60)
    found = flow.scene.cg.choose_width("velocity", frames=4, target=0.08, sample=30, **NODES)
    frames = found.target_frames.item()
    width = found.target_width.item()
    assert 2 < frames < 20
    size = np.sqrt(0.5)
    assert true_error(flow, width, frames) / size == pytest.approx(0.08, rel=0.2)
    assert true_error(flow, width, frames / 2) / size > 0.085
    with pytest.warns(
        xcg.SceneWarning,
        match="at 2, the narrowest .* a narrower one may be better.* leave them out with bounds=",
    ):
        wide = flow.scene.cg.choose_width("velocity", widths=[2.0, 3.0, 4.0], target=0.02, **NODES)
    assert np.isnan(wide.target_frames)


def test_the_spacing_adds_less_error_than_stated():
    """Linear interpolation between the nodes against nodes that are ten times as close."""
    flow = FLOWS["sine"](60)
    found = flow.scene.cg.choose_width("velocity", frames=60, **NODES)
    options = {"axes": "z", "width": found.best_width.item()}
    spacing = found.best_spacing.item()
    coarse = flow.scene.cg.coarse_grain(
        "velocity", **options, bounds={"z": (1, 11)}, spacing=spacing
    )
    fine = flow.scene.cg.coarse_grain(
        "velocity", **options, bounds={"z": (1, coarse.z[-1])}, spacing=spacing / 10
    )
    errors = []
    for f in (fine, coarse.interp(z=fine.z)):
        error = f.velocity.mean("time") - xr.DataArray([1.0, 0, 0], dims="component") * flow.truth(
            fine.z
        )
        errors.append(float((error**2).sum("component").mean() ** 0.5))
    assert errors[1] < 1.1 * errors[0]
    assert 0.3 < spacing < 3.0


def test_densities_take_their_noise_from_the_frames():
    flow = FLOWS["layer"](20)
    with pytest.warns(xcg.SceneWarning, match="at 4, the widest .* a wider one may be better"):
        found = flow.scene.cg.choose_width(["density", "velocity"], **NODES)
    assert (found.density_noise > 0).all()
    np.testing.assert_array_equal(
        found.total, np.maximum(found.density_total, found.velocity_total)
    )
    with pytest.raises(ValueError, match="density has no error of a single frame"):
        flow.scene.isel(time=[0]).cg.choose_width("density", axes="z")
    with pytest.raises(ValueError, match="take sample=2 or more"):
        flow.scene.cg.choose_width("density", axes="z", sample=1)


def test_widths_for_volumes_planes_and_points():
    ds = xcg.datasets.open("plane_shear")
    line = xr.DataArray(np.linspace(1, 10, 8), dims="s")
    points = {"x": 3.0 + 0 * line, "y": 2.0 + 0 * line, "z": line}
    for options in (
        {},
        {"axes": "xz", "at": {"y": 2.0}},
        {"axes": "z", "by": "species"},
        {"at": points},
    ):
        found = ds.cg.choose_width("velocity", sample=2, **options)
        assert found.best_width > 0
        assert found.best_total < 1


def test_wrong_arguments_of_a_choice_raise():
    ds = xcg.datasets.random_scene(50)
    for options, message in (
        ({"widths": [1.0, 2.0]}, "three or more"), ({"target": 0.0}, "target=0.0"), ({"frames": 0}, "frames=0"),
        ({"sample": 1.5}, "sample=1.5"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=message):
            ds.cg.choose_width("velocity", axes="z", **options)


def test_the_picture_has_labels_and_the_choice():
    pytest.importorskip("matplotlib").use("agg")
    found = FLOWS["sine"](4).scene.cg.choose_width("velocity", axes="z")
    ax = found.cg.plot_width()
    assert ax.get_xlabel() == "width [m]"
    assert ax.get_ylabel().replace("\n", " ") == "relative error, mean of 4 frames"
    texts = [text.get_text() for text in ax.get_legend().get_texts()]
    assert texts[:2] == ["bias of velocity", "noise of velocity"]
    assert texts[-1] == f"best width, {found.best_width.item():.3g} m"
    with pytest.raises(ValueError, match="choose_width"):
        found.drop_vars("best_width").cg.plot_width()


def test_slip_at_the_walls_of_a_shear_cell_asks_for_bounds_between_them():
    """The velocity jumps by a third from the walls of frozen grains to the first layer."""
    ds = xcg.datasets.open("plane_shear")
    with pytest.warns(
        xcg.SceneWarning, match="slips, no width is right: leave them out with bounds="
    ):
        ds.cg.choose_width("velocity", axes="z")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = ds.cg.choose_width("velocity", axes="z", bounds={"z": (3.0, 8.2)})
        xcg.datasets.open("chute").cg.choose_width("velocity", axes="z")
    size = ds.attrs["d43"]
    assert size < found.best_width < 2 * size
