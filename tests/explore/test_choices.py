"""Pictures that can be chosen: their numbers are those of the call that is shown."""

import numpy as np
import pytest
import xarray as xr

import xcg
from xcg.analysis.draw_pictures import segments_of
from xcg.explore.choices import MOST_GRAINS, NODES_OF_ERRORS, Choice, pictures_of


def run(call, **names):
    """Run the shown calls; return the axes of the picture and the names."""
    *before, last = call.rsplit("\n" if call.startswith("f = ") else "\0", 1)
    if before and "plot(" not in last:  # the call of plot is on several lines
        before, last = call.split("\nf.cg.plot", 1)
        before = [before]
        last = f"f.cg.plot{last}"
    exec("\n".join(before), names)
    return eval(last, names), names


def numbers_of(pictures, choice):
    """Return the numbers of a picture."""
    return pictures.picture(choice)[choice.field]


def open_scene():
    """Return grains without a box."""
    rng = np.random.default_rng(3)
    velocity = rng.normal(size=(300, 3))
    return xcg.scene_from_arrays(
        rng.uniform(0, 5, (300, 3)), velocity=velocity, diameter=np.full(300, 0.5), density=1.0
    )


SCENES = {
    "open": open_scene,
    "3D": lambda: xcg.datasets.random_scene(300, seed=2, periodic="xy"),
    "2D": lambda: xcg.datasets.open("biaxial"),
    "files": lambda: xcg.datasets.open("plane_shear"),
}
CHOICES = [
    ("3D", Choice("velocity", "profile", ("z",), width="1.06 d43")),
    ("3D", Choice("velocity", "profile", ("x",), part="y", phase="2")),
    ("3D", Choice("stress", "profile", ("z",), part="z x")),
    ("2D", Choice("pressure", "profile", ("y",), time=2)),
    ("files", Choice("volume_fraction", "profile", ("z",), time=2, width="0.375 d43")),
]
MAPS = [
    ("open", Choice("velocity", "map", ("x", "z"), width="1.5 d43")),
    ("3D", Choice("velocity", "map", ("x", "z"))),
    ("3D", Choice("velocity", "slice", ("y", "z"), position=1.2)),
    ("2D", Choice("velocity", "map", ("x", "y"), time=1, width="2.12 d43")),
    ("files", Choice("velocity", "map", ("x", "z"), time=1)),
]


@pytest.mark.parametrize(("scene", "choice"), CHOICES)
def test_the_shown_call_draws_the_lines_of_the_profile(scene, choice):
    pyplot = pytest.importorskip("matplotlib.pyplot")
    ds = SCENES[scene]()
    pictures = pictures_of(ds)
    numbers = numbers_of(pictures, choice)
    ax, _ = run(pictures.call(choice), ds=ds)
    get = "get_xdata" if choice.axes == ("z",) else "get_ydata"
    drawn = np.array([getattr(line, get)() for line in ax.lines])
    np.testing.assert_array_equal(drawn, numbers.to_numpy().reshape(len(numbers), -1).T)
    assert np.isfinite(drawn).any()
    pyplot.close("all")


@pytest.mark.parametrize(("scene", "choice"), MAPS)
def test_the_shown_call_gives_the_numbers_of_the_map(scene, choice):
    pyplot = pytest.importorskip("matplotlib.pyplot")
    ds = SCENES[scene]()
    pictures = pictures_of(ds)
    numbers = numbers_of(pictures, choice)
    _, names = run(pictures.call(choice), ds=ds)
    f = names["f"].isel(time=0)
    assert numbers.dims == choice.axes[::-1]
    size = (f["velocity"] ** 2).sum("component", skipna=False) ** 0.5
    np.testing.assert_array_equal(size.transpose(*numbers.dims), numbers)
    assert np.isfinite(numbers).any()
    if choice.view == "slice":
        assert f["x"].item() == choice.position
    pyplot.close("all")


@pytest.mark.parametrize(
    "choice",
    [
        Choice("velocity", "slice", ("x", "z"), position=2.0, part="z"),
        Choice("velocity", "profile", ("z",), part="x"),
        Choice("density", "slice", ("y", "z"), position=0.9),
    ],
)
def test_the_shown_call_of_a_result_gives_the_numbers_of_the_picture(choice):
    pyplot = pytest.importorskip("matplotlib.pyplot")
    ds = xcg.datasets.random_scene(300, seed=2)
    f = ds.cg.coarse_grain(["density", "velocity"], for_averages=True)
    pictures = pictures_of(f)
    assert choice.view in pictures.views
    numbers = numbers_of(pictures, choice)
    ax, _ = run(pictures.call(choice), f=f)
    if choice.view == "profile":
        expected = f.isel(time=[0]).cg.profile("z")["velocity"].sel(component="x").isel(time=0)
        np.testing.assert_array_equal(numbers, expected)
        np.testing.assert_array_equal(ax.lines[0].get_xdata(), expected)
    else:
        (cut,) = {*"xyz"} - {*choice.axes}
        there = f[choice.field].isel(time=0).sel({cut: choice.position}, method="nearest")
        there = there.sel(component=choice.part) if choice.part else there
        np.testing.assert_array_equal(numbers, there.transpose(*numbers.dims))
    pyplot.close("all")


def test_components_and_phases_of_a_result_are_offered_by_their_labels():
    f = xcg.datasets.open("plane_shear").cg.coarse_grain("velocity", axes="xz", by="species")
    pictures = pictures_of(f)
    parts = pictures.parts_of(Choice("velocity", "map", ("x", "z")))
    assert parts == {"magnitude": "", "x": "x", "y": "y", "z": "z"}
    assert pictures.phases == ["bulk", "1", "2"]


def test_an_error_that_is_negative_is_refused():
    f = xcg.datasets.open("plane_shear").cg.coarse_grain("velocity", axes="z")
    mean = f.cg.time_average().compute()
    difference = mean.assign(velocity_error=-mean.velocity_error)
    with pytest.raises(ValueError, match=r"velocity_error is negative.*xcg\.compare"):
        numbers_of(pictures_of(difference), Choice("velocity", "profile", ("z",)))


def test_nodes_stay_where_they_are_in_all_steps():
    pictures = pictures_of(xcg.datasets.open("plane_shear"))
    first, last = (
        numbers_of(pictures, Choice("density", "profile", ("z",), time=time)) for time in (0, 4)
    )
    np.testing.assert_array_equal(first["z"], last["z"])
    assert not np.array_equal(first, last)


def test_only_the_shown_step_is_read_and_once_for_all_widths(reads):
    ds = xcg.datasets.open("plane_shear", chunks=1)
    pictures = pictures_of(ds)
    reads.clear()
    numbers_of(pictures, Choice("pressure", "map", ("x", "z"), time=2))
    shown = ds["step"][2].item()
    assert {step for _, step in reads} == {shown}
    before = dict(reads)
    numbers_of(pictures, Choice("pressure", "map", ("x", "z"), time=2, width="1.06 d43"))
    assert reads == before


def test_a_slice_shows_the_circles_in_which_it_cuts_the_grains():
    """Also through the periodic edge."""
    ds = xcg.datasets.simple_cubic(4)  # grains of 1 m, whose centres lie at 0, 1, 2, 3 of 4 m
    pictures = pictures_of(ds)
    low = ds["position"].isel(time=0).sel(component="y").min().item()
    for offset in (0.3, -0.3):
        choice = Choice("density", "slice", ("x", "z"), position=low + offset)
        circles, note = pictures.grains(choice)
        assert len(circles["radius"]) == 16
        assert note == ""
        np.testing.assert_allclose(circles["radius"], 0.4, rtol=1e-12)


def test_a_map_of_a_volume_shows_the_grains_in_its_middle():
    ds = xcg.datasets.random_scene(300, seed=2)
    pictures = pictures_of(ds)
    circles, note = pictures.grains(Choice("density", "map", ("x", "z")))
    low, high = pictures.range_of("y")
    middle = (low + high) / 2
    slice_, _ = pictures.grains(Choice("density", "slice", ("x", "z"), position=middle))
    np.testing.assert_array_equal(circles["x"], slice_["x"])
    assert 10 < len(circles["x"]) < 150
    assert note == f"grains at y = {middle:.4g}"


def test_no_layer_of_a_large_scene_is_left_out():
    """A row of 10 grains at each height, in the order of their ids: every tenth one would be one column."""
    rows = 2 * MOST_GRAINS // 10
    z, x = np.mgrid[:rows, :10]
    position = np.stack([x.ravel(), 0 * x.ravel(), z.ravel()], axis=1).astype(float)
    ds = xcg.scene_from_arrays(
        position, diameter=np.ones(len(position)), density=1.0, dimension=2, plane="xz"
    )
    pictures = pictures_of(ds)
    circles, note = pictures.grains(Choice("density", "map", ("x", "z")))
    assert note == f"{MOST_GRAINS} of {len(position)} grains are drawn"
    assert len(circles["x"]) == MOST_GRAINS
    columns = np.bincount(circles["x"].astype(int), minlength=10)
    assert abs(columns - MOST_GRAINS / 10).max() < 5 * (MOST_GRAINS / 10) ** 0.5
    moved = ds.assign(position=ds.position + 0.25)
    again, _ = pictures_of(moved).grains(Choice("density", "map", ("x", "z")))
    np.testing.assert_array_equal(again["x"], circles["x"] + 0.25)


def test_fields_that_a_scene_lacks_data_for_come_last_with_the_reason():
    fields = pictures_of(xcg.datasets.random_scene(50, seed=1, walls=True)).fields
    *_, last = fields
    assert last == "not of this scene"
    assert fields[last]["d2min (needs lag=)"] == "d2min"
    assert fields[last]["nematic_order (needs director)"] == "nematic_order"
    assert fields["of this scene"]["velocity"] == "velocity"
    assert fields["on request"]["momentum_flux"] == "momentum_flux"


def test_averages_with_errors_have_profiles_and_errors_have_none_of_their_own():
    pyplot = pytest.importorskip("matplotlib.pyplot")
    ds = xcg.datasets.open("plane_shear").isel(time=slice(0, 3))
    mean = ds.cg.coarse_grain(["velocity", "density"], axes="xz").cg.time_average().compute()
    pictures = pictures_of(mean)
    choice = Choice("velocity", "profile", ("z",), part="x")
    np.testing.assert_array_equal(
        numbers_of(pictures, choice), mean[["velocity", "density"]].cg.profile("z").velocity[:, 0]
    )
    ax, _ = run(pictures.call(choice), f=mean)
    np.testing.assert_array_equal(ax.lines[0].get_xdata(), numbers_of(pictures, choice))
    pyplot.close("all")
    with pytest.raises(ValueError, match="velocity_error is an error itself"):
        pictures_of(ds).errors(Choice("velocity_error", "profile", ("z",)))


def test_colours_and_arrows_of_the_page_are_in_the_call():
    pyplot = pytest.importorskip("matplotlib.pyplot")
    ds = SCENES["3D"]()
    pictures = pictures_of(ds)
    axes = ("x", "z")
    choice = Choice("density", "map", axes, arrows="velocity", cmap="plasma", vmin=0.5, vmax=9.0)
    ax, _ = run(pictures.call(choice), ds=ds)
    (mesh,), (arrows,) = ax.images, ax.collections
    assert mesh.get_clim() == (0.5, 9.0)
    assert mesh.get_cmap().name == "plasma"
    drawn = segments_of(pictures.picture(choice), "density")
    np.testing.assert_allclose((drawn["x0"] + drawn["x1"]) / 2, arrows.X)
    np.testing.assert_allclose(drawn["x1"] - drawn["x0"], arrows.U / arrows.scale, atol=1e-12)
    np.testing.assert_allclose(drawn["y1"] - drawn["y0"], arrows.V / arrows.scale, atol=1e-12)
    logarithmic = Choice("density", "map", axes, is_logarithmic=True, arrows=None)
    ax, _ = run(pictures.call(logarithmic), ds=ds)
    assert type(ax.images[0].norm).__name__ == "LogNorm"
    pyplot.close("all")


def test_errors_are_those_of_choose_width():
    ds = xcg.datasets.open("plane_shear")
    choice = Choice("velocity", "profile", ("z",), time=1)
    pictures = pictures_of(ds)
    found = pictures.errors(choice)
    np.testing.assert_allclose(found["total"], np.hypot(found["bias"], found["noise"]), rtol=1e-12)
    spacing = np.ptp(pictures.range_of("z")) / NODES_OF_ERRORS["profile"]
    expected = ds.isel(time=[1]).cg.choose_width("velocity", axes="z", frames=1, spacing=spacing)
    np.testing.assert_array_equal(found["noise"], expected["velocity_noise"])
    np.testing.assert_allclose(found["width"], expected["width"] / pictures.size, rtol=1e-12)


def test_a_pressure_that_rises_in_time_is_no_noise():
    """Errors of a step do not depend on the next one."""
    ds = xcg.datasets.open("plane_shear").isel(time=[3, 4]).load()
    rising = ds.assign(contact_force=ds.contact_force * xr.DataArray([1.0, 2.0], dims="time"))
    choice = Choice("pressure", "profile", ("z",))
    errors = [pictures_of(scene).errors(choice) for scene in (ds, rising)]
    assert set(errors[0]) == {"width", "bias with noise"}
    np.testing.assert_array_equal(errors[0]["bias with noise"], errors[1]["bias with noise"])


def test_a_field_without_an_error_of_one_step_still_has_a_bias():
    """It vanishes in a uniform packing, and not where the density changes."""
    uniform = pictures_of(xcg.datasets.simple_cubic(6)).errors(
        Choice("volume_fraction", "profile", ("z",))
    )
    assert set(uniform) == {"width", "bias with noise"}
    assert (uniform["bias with noise"][2:] < 0.02).all()
    layered = pictures_of(xcg.datasets.open("chute")).errors(
        Choice("volume_fraction", "profile", ("z",))
    )
    assert (layered["bias with noise"][2:] > 0.02).all()


def test_fields_that_the_scene_cannot_give_are_refused_with_the_reason():
    pictures = pictures_of(xcg.datasets.random_scene(50, seed=1))
    with pytest.raises(ValueError, match=r"d2min compares two frames.*ds\.cg\.displacement"):
        numbers_of(pictures, Choice("d2min", "map", ("x", "z")))


def test_results_without_an_axis_and_chains_are_refused():
    ds = xcg.datasets.random_scene(50, seed=1)
    with pytest.raises(ValueError, match="no axis to draw along"):
        pictures_of(ds.cg.coarse_grain("density", axes=""))
    with pytest.raises(ValueError, match="these are force chains"):
        pictures_of(ds.cg.force_chains())
