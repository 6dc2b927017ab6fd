"""Choice of the width, against the true errors of flows that are known."""

import warnings

import numpy as np
import pytest
import xarray as xr

import xcg
from tests.flows import FLOWS, NODES


def bias_and_noise(flow, width):
    """Error of the mean of all frames, and the scatter of a frame."""
    f = flow.scene.cg.coarse_grain(flow.field, width=width, **NODES)
    parts = f[flow.field].sizes.get("component", 1)
    return flow.errors(f)[0], np.sqrt(parts * float(f[flow.field].var("time", ddof=1).mean()))


def true_error(flow, width, frames):
    """Error of the average over some frames."""
    bias, noise = bias_and_noise(flow, width)
    return np.hypot(bias, noise / np.sqrt(frames))


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
    bias, noise = np.transpose([bias_and_noise(flow, width) for width in np.geomspace(0.5, 4, 13)])
    for frames in (4, 16, 60):
        found = flow.scene.cg.choose_width(flow.field, frames=frames, sample=16, **NODES)
        best = np.hypot(bias, noise / np.sqrt(frames)).min()
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
