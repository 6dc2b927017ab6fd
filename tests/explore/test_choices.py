"""Pictures that can be chosen: their numbers are those of the call that is shown."""

import numpy as np
import pytest
import xarray as xr

import xcg
from xcg.explore.choices import MOST_GRAINS, NODES_OF_ERRORS, Choice, pictures_of


def run(call, **names):
    """Run the shown calls; return the axes of the picture and the names."""
    *before, last = call.rsplit("\n" if call.startswith("f = ") else "\0", 1)
    if before and "plot(" not in last:  # the call of plot is on several lines
        before, last = call.split("\nf.cg.plot", 1)
        before, last = [before], f"f.cg.plot{last}"
    exec("\n".join(before), names)
    return eval(last, names), names


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
    numbers = pictures.numbers(choice)
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
    numbers = pictures.numbers(choice)
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
    numbers = pictures.numbers(choice)
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


def test_nodes_stay_where_they_are_in_all_steps():
    pictures = pictures_of(xcg.datasets.open("plane_shear"))
    first, last = (
        pictures.numbers(Choice("density", "profile", ("z",), time=time)) for time in (0, 4)
    )
    np.testing.assert_array_equal(first["z"], last["z"])
    assert not np.array_equal(first, last)


def test_only_the_shown_step_is_read_and_once_for_all_widths(reads):
    ds = xcg.datasets.open("plane_shear", chunks=1)
    pictures = pictures_of(ds)
    reads.clear()
    pictures.numbers(Choice("pressure", "map", ("x", "z"), time=2))
    shown = ds["step"][2].item()
    assert {step for _, step in reads} == {shown}
    before = dict(reads)
    pictures.numbers(Choice("pressure", "map", ("x", "z"), time=2, width="1.06 d43"))
    assert reads == before


def test_a_slice_shows_the_circles_in_which_it_cuts_the_grains():
    """Also through the periodic edge."""
    ds = xcg.datasets.simple_cubic(4)  # grains of 1 m, whose centres lie at 0, 1, 2, 3 of 4 m
    pictures = pictures_of(ds)
    low = ds["position"].isel(time=0).sel(component="y").min().item()
    for offset in (0.3, -0.3):
        choice = Choice("density", "slice", ("x", "z"), position=low + offset)
        circles, count = pictures.grains(choice)
        assert count == len(circles["radius"]) == 16
        np.testing.assert_allclose(circles["radius"], 0.4, rtol=1e-12)


def test_a_map_shows_at_most_as_many_grains_as_a_browser_draws():
    ds = xcg.datasets.random_scene(2 * MOST_GRAINS + 1, seed=1)
    circles, count = pictures_of(ds).grains(Choice("density", "map", ("x", "z")))
    assert count == 2 * MOST_GRAINS + 1
    assert MOST_GRAINS / 2 < len(circles["x"]) <= MOST_GRAINS


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
    assert "d2min" in pictures.fields["with further data or options"]
    with pytest.raises(ValueError, match=r"d2min compares two frames.*ds\.cg\.displacement"):
        pictures.numbers(Choice("d2min", "map", ("x", "z")))


def test_results_without_an_axis_and_chains_are_refused():
    ds = xcg.datasets.random_scene(50, seed=1)
    with pytest.raises(ValueError, match="no axis to draw along"):
        pictures_of(ds.cg.coarse_grain("density", axes=""))
    with pytest.raises(ValueError, match="these are force chains"):
        pictures_of(ds.cg.force_chains())
