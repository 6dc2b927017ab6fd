"""Pictures and movies show the numbers of a result, and packages that are missing are named with what to install."""

from __future__ import annotations

import itertools
import re
import sys
import tomllib

import matplotlib as mpl
import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import LogNorm
from scipy import ndimage

import xcg
from tests import ROOT
from xcg.analysis.picture import picture_of, without_empty_parts
from xcg.common.drawing import unit_text, without_tail
from xcg.scene.schema import units_of

mpl.use("agg")
plt = pytest.importorskip("matplotlib.pyplot")


@pytest.fixture(autouse=True)
def _close():
    yield
    plt.close("all")


@pytest.fixture(scope="module")
def result():
    """Three steps of random grains; those of the second are twice as fast, of the third four times."""
    ds = xcg.datasets.random_scene(200, seed=3)
    steps = [
        ds.assign(velocity=2.0**k * ds.velocity).assign_coords(time=[float(k)]) for k in range(3)
    ]
    scene = xr.concat(
        steps, "time", data_vars="all", coords="minimal", compat="override", join="override"
    )
    fields = ["volume_fraction", "velocity", "stress", "density"]
    return scene, scene.cg.coarse_grain(fields, axes="xz", at={"y": 2.5}, width=1.0).compute()


def test_a_map_shows_the_field_with_arrows_of_the_flow(result):
    _, f = result
    ax = f.cg.plot(index=1, arrows="velocity", shading="flat")
    mesh, arrows = map_and_arrows(ax)
    np.testing.assert_array_equal(
        mesh.get_array(), f.volume_fraction.isel(time=1).transpose("z", "x")
    )
    flow = f.velocity.isel(time=1).transpose("z", "x", "component").to_numpy()
    every = max(1, round(max(f.sizes["x"], f.sizes["z"]) / 20))
    shown_arrows = flow[every // 2 :: every, every // 2 :: every]
    # all but those of a tenth of the fastest
    fastest = np.percentile(np.hypot(flow[..., 0], flow[..., 2]), 98)
    moving = np.hypot(shown_arrows[..., 0], shown_arrows[..., 2]) >= 0.1 * fastest
    np.testing.assert_array_equal(arrows.U, shown_arrows[moving][:, 0])
    np.testing.assert_array_equal(arrows.V, shown_arrows[moving][:, 2])
    assert ax.get_title() == "time = 1, y = 2.5 m"
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("$x$ [m]", "$z$ [m]")
    assert ax.figure.axes[1].get_ylabel() == "volume fraction"


def test_a_map_over_radius_and_height():
    """r is across, z up, and arrows have the components along both."""
    ds = xcg.datasets.random_scene(60, seed=1, periodic="", gravity=(0, 0, -1))
    frame = xcg.Cylindrical(origin=(2.5, 2.5, 0))
    ends = {"r": (0.0, 2.0), "z": (1.0, 4.0)}
    f = ds.cg.coarse_grain(
        ["density", "velocity"], axes="rz", frame=frame, bounds=ends, width=1.0, spacing=0.5
    )
    ax = f.cg.plot("density", arrows="velocity", shading="flat")
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("$r$ [m]", "$z$ [m]")
    mesh, arrows = map_and_arrows(ax)
    np.testing.assert_array_equal(mesh.get_array(), f.density.isel(time=-1).transpose("z", "r"))
    flow = f.velocity.isel(time=-1)
    for (r, z), rise in zip(arrows.get_offsets(), arrows.V, strict=True):
        assert rise == flow.sel(r=r, z=z, component="z").item()
    assert len(arrows.V) > 20


def test_a_map_over_radius_and_angle_lies_in_the_plane_of_the_circle():
    """In a drum that turns as one body the arrows are at right angles to the radius, as long as it is."""
    ds = xcg.datasets.random_scene(400, seed=1, periodic="z")
    around = ds.position - xr.DataArray([2.5, 2.5, 0.0], dims="component")
    spin = xr.DataArray([[0.0, -1, 0], [1, 0, 0], [0, 0, 0]], dims=("component", "c"))
    ds = ds.assign(
        velocity=xr.dot(spin, around.rename(component="c"), dim="c").transpose(*ds.position.dims)
    )
    frame = xcg.Cylindrical(origin=(2.5, 2.5, 0))
    f = ds.cg.coarse_grain(
        ["density", "velocity"], axes="rt", frame=frame, bounds={"r": (0, 2)}, width=0.6
    ).compute()
    ax = f.cg.plot("density", arrows="velocity", shading="flat")
    assert (ax.get_xlabel(), ax.get_ylabel()) == (r"$r\,\cos\theta$ [m]", r"$r\,\sin\theta$ [m]")
    mesh, arrows = map_and_arrows(ax)
    np.testing.assert_array_equal(mesh.get_array(), f.density.isel(time=-1).transpose("theta", "r"))
    corner = mesh.get_coordinates()
    first, last = f.theta.to_numpy()[[0, -1]]
    np.testing.assert_allclose(
        np.hypot(*corner[:, -1].T), f.r[-1] + (f.r[1] - f.r[0]) / 2
    )  # the rim
    np.testing.assert_allclose(
        np.arctan2(*corner[0, -1, ::-1]), first - (2 * np.pi - last) / 2, atol=1e-12
    )
    flow = np.stack([arrows.U, arrows.V], -1)
    place = arrows.get_offsets()
    known = np.isfinite(flow).all(-1)
    assert known.sum() > 100
    across = np.stack([-place[known, 1], place[known, 0]], -1)
    size = np.linalg.norm(flow[known], axis=-1)
    # the mean velocity is that of the grains' centre, which is some way beside the node
    assert np.mean((flow[known] * across).sum(-1) / size / np.linalg.norm(across, axis=-1)) > 0.95
    with pytest.raises(ValueError, match="draws along one or two of r, theta, x, y, z"):
        f.isel(r=1, theta=2).cg.plot("density")


def test_a_cylindrical_wall_is_unrolled():
    ds = xcg.datasets.open("silo")
    side = xcg.Cylinder((0, 0, 0), (0, 0, 1), radius=0.025, low=0.0, high=0.24)
    f = ds.cg.wall_stress(side, 0.01, walls="side").compute()
    ax = f.cg.plot("normal_traction", shading="flat")
    (mesh,) = map_and_arrows(ax)
    np.testing.assert_array_equal(mesh.get_array(), f.normal_traction[0].transpose("z", "theta"))
    assert (ax.get_xlabel(), ax.get_aspect()) == (r"$\theta$ [rad]", "auto")
    with pytest.raises(ValueError, match=r"f\.sel\(along=...\)"):
        f.cg.plot("shear_traction")


def test_maps_of_vectors_show_the_magnitude_and_signed_maps_are_white_at_zero(result):
    _, f = result
    (mesh, _) = map_and_arrows(f.cg.plot("velocity", shading="flat"))
    np.testing.assert_allclose(
        mesh.get_array(), np.sqrt((f.velocity[-1] ** 2).sum("component")).transpose("z", "x")
    )
    plt.figure()
    (mesh,) = map_and_arrows(f.cg.plot("stress", component="x", direction="z"))
    low, high = mesh.get_clim()
    assert low == -high
    assert high == pytest.approx(
        float(np.abs(f.stress[-1].sel(component="x", direction="z")).max())
    )


def test_a_profile_has_a_band_of_one_standard_error(result):
    scene, _ = result
    p = (
        scene.cg.coarse_grain(["velocity", "density"], axes="z", width=1.0)
        .compute()
        .cg.time_average()
    )
    ax = p.cg.plot("velocity", component="x")
    (line,), (band,) = ax.lines, ax.collections
    value, error = (p[name].sel(component="x") for name in ("velocity", "velocity_error"))
    np.testing.assert_array_equal(line.get_xdata(), value)
    np.testing.assert_array_equal(line.get_ydata(), p.z)
    corners = band.get_paths()[0].vertices
    assert corners[:, 0].max() == pytest.approx(float((value + error).max()))
    assert corners[:, 0].min() == pytest.approx(float((value - error).min()))
    plt.figure()
    assert [t.get_text() for t in p.cg.plot("velocity").get_legend().get_texts()] == ["x", "y", "z"]


@pytest.mark.parametrize(
    ("field", "parts"),
    [
        ("velocity", "xy"),
        ("spin_density", "z"),
        ("boundary_force_density", "xy"),
        ("contact_force_density", "xy"),
    ],
)
def test_profiles_of_discs_leave_out_components_that_are_zero(field, parts):
    f = xcg.datasets.random_scene(60, dimension=2).cg.coarse_grain(field, axes="y", width=1.0)
    ax = f.cg.plot()
    assert [line.get_label() for line in ax.lines] == [*parts]
    assert picture_of(f, field).component.values.tolist() == [*parts]


def test_a_component_that_is_zero_in_some_steps_stays_in_all():
    f = xcg.datasets.random_scene(60, dimension=2).cg.coarse_grain("velocity", axes="y", width=1.0)
    step = f.isel(time=0).assign_attrs(drawn="velocity")
    along_x = step.assign(velocity=step.velocity * [1, 0, 0])
    for shown in without_empty_parts([along_x, step], f):
        assert shown.component.values.tolist() == ["x", "y"]


@pytest.fixture(scope="module")
def surface():
    """A map whose numbers are 0.1 to 0.4 in the bulk, and 2500 at the 2 of 40 nodes of a free surface."""
    f = xcg.datasets.random_scene(60).cg.coarse_grain(
        ["inertial_number", "density"], axes="xz", width=1.0, bounds={"x": (0, 4), "z": (0, 4)},
        spacing={"x": 0.5, "z": 0.1},
    )  # fmt: skip
    z = f.z.broadcast_like(f.density)
    return f.map(lambda old: (0.1 + 0.075 * z).where(z < 3.85, 2500.0).assign_attrs(old.attrs))


def test_a_free_surface_does_not_flatten_the_inertial_number(surface):
    ax = surface.cg.plot("inertial_number")
    mesh = map_and_arrows(ax)[0]
    bar = ax.figure.axes[-1]
    assert mesh.get_clim() == pytest.approx((0.1, 0.385))  # at z = 3.8, below the surface
    assert bar.get_ylabel() == "inertial number, up to its 95th percentile"
    assert bar._colorbar.extend == "max"
    profile = surface.isel(x=0)
    ax = profile.cg.plot("inertial_number")
    assert 0.37 < ax.get_xlim()[1] < 0.5
    assert ax.get_xlabel() == "inertial number, up to its 95th percentile"
    assert max(ax.lines[0].get_xdata()) == 2500.0


def test_a_tail_is_drawn_where_it_is_asked_for_or_the_field_has_a_bound(surface):
    whole = surface.cg.plot("density")
    assert map_and_arrows(whole)[0].get_clim()[1] == 2500.0
    given = surface.cg.plot("inertial_number", vmax=9.0)
    assert map_and_arrows(given)[0].get_clim() == pytest.approx((0.1, 9.0))
    log = surface.cg.plot("inertial_number", norm="log")
    assert map_and_arrows(log)[0].get_clim()[1] == pytest.approx(2500.0)
    for ax in (whole, given, log):
        assert "percentile" not in ax.figure.axes[-1].get_ylabel()


def test_quotients_of_the_user_are_shown_without_their_tail(surface):
    f = surface.assign(mine=-surface.density / surface.density.max())
    mesh = map_and_arrows(f.cg.plot("mine"))[0]
    assert mesh.get_clim()[0] == pytest.approx(float(f.mine.quantile(0.1)), rel=0.05)
    xcg.register_field("quotient", lambda f, s, o: 1 / f.pressure, fields="pressure", units="Pa^-1")
    f = surface.assign(quotient=surface.density)
    assert map_and_arrows(f.cg.plot("quotient"))[0].get_clim()[1] < 0.4


@pytest.mark.parametrize("values", [[], [0.0], [0.0] * 30 + [1.0], [1.0, 2.0, 3.9], np.arange(50)])
def test_numbers_without_a_tail_are_shown_whole(values):
    values = np.array(values)
    shown, note = without_tail(values)
    assert shown is values
    assert note == ""


def test_vectors_of_a_volume_keep_components_that_are_zero():
    ds = xcg.datasets.random_scene(60)
    f = ds.assign(velocity=ds.velocity * [1, 0, 0]).cg.coarse_grain("velocity", axes="y", width=1.0)
    assert [line.get_label() for line in f.cg.plot().lines] == ["x", "y", "z"]


def test_a_volume_is_cut_through_the_middle_of_its_shortest_axis_or_at_the_given_place():
    f = xcg.datasets.random_scene(60).cg.coarse_grain(
        "density", width=1.0, bounds={"y": (1.0, 3.0)}
    )
    (mesh,) = map_and_arrows(f.cg.plot(shading="flat"))
    np.testing.assert_array_equal(
        mesh.get_array(), f.density.isel(time=0, y=f.sizes["y"] // 2).transpose("z", "x").compute()
    )
    assert f.isel(x=slice(None, None, -1)).cg.plot().get_title().startswith("step = 0, y = ")
    plt.figure()
    ax = f.cg.plot(at={"x": 2.0})
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("$y$ [m]", "$z$ [m]")


def test_phases_are_lines_of_a_profile():
    p = xcg.datasets.random_scene(60).cg.coarse_grain(
        "volume_fraction", axes="x", by="species", width=1.0
    )
    ax = p.cg.plot()
    assert [t.get_text() for t in ax.get_legend().get_texts()] == ["bulk", "1", "2"]
    np.testing.assert_array_equal(
        ax.lines[1].get_ydata(), p.volume_fraction.sel(phase="1").isel(time=0).compute()
    )


def plane(values, name="density", **attrs):
    """A map over x and z, one m between the nodes; rows are z."""
    values = np.asarray(values, float)
    coords = {
        a: (a, np.arange(n) + 0.5, {"units": "m"}) for a, n in zip("zx", values.shape, strict=True)
    }
    return xr.Dataset({name: (("z", "x"), values, attrs)}, coords)


def map_and_arrows(ax):
    """Map, arrows and bands of a pair of axes: smooth maps of even nodes are images."""
    return [*ax.images, *ax.collections]


def numbers_at(mesh, x, z):
    """Numbers of the drawn cells that hold points."""
    left, right, bottom, top = mesh.get_extent()
    rows, columns = mesh.get_array().shape
    column = ((x - left) / (right - left) * columns).astype(int)
    row = ((z - bottom) / (top - bottom) * rows).astype(int)
    return mesh.get_array()[row, column]


def test_a_smooth_map_interpolates_linearly_between_the_nodes():
    z, x = np.mgrid[0:4, 0:5] + 0.5
    (mesh,) = map_and_arrows(plane(1 + 2 * x - z + 0.5 * x * z).cg.plot())
    rng = np.random.default_rng(0)
    x = rng.uniform(0.5, 4.5, 100)
    z = rng.uniform(0.5, 3.5, 100)
    np.testing.assert_allclose(numbers_at(mesh, x, z), 1 + 2 * x - z + 0.5 * x * z, atol=0.03)
    assert mesh.get_extent() == pytest.approx((0, 5, 0, 4))  # as far as the cells of the nodes


def test_nodes_at_uneven_distances_are_drawn_as_a_mesh_at_their_places():
    even = plane(np.arange(20.0).reshape(4, 5))
    ax = even.assign_coords(x=[0.5, 1.5, 2.5, 3.5, 6.5]).cg.plot()
    (mesh,) = ax.collections
    assert not ax.images
    assert mesh.get_coordinates()[0, -1, 0] == pytest.approx(8.0)
    (image,) = even.cg.plot().images
    assert image.get_interpolation() == "nearest"


@pytest.mark.parametrize("shading", ["smooth", "flat"])
def test_maps_side_by_side_in_one_pair_of_axes_are_shown_whole(shading):
    f = plane(np.arange(20.0).reshape(4, 5))
    ax = f.isel(x=slice(0, 2)).cg.plot(shading=shading)
    f.isel(x=slice(2, None)).cg.plot(shading=shading, ax=ax)
    assert ax.get_xlim() == pytest.approx((0, 5))
    assert ax.get_ylim() == pytest.approx((0, 4))
    ax.set_xlim(1, 3)
    f.cg.plot(shading=shading, ax=ax)
    assert ax.get_xlim() == (1, 3)


def test_a_smooth_map_is_white_at_unknown_nodes_and_nothing_bleeds():
    """Beside unknown nodes the numbers are those of the known ones."""
    values = np.full((4, 5), 3.0)
    values[1, 2] = values[3, 0] = np.nan
    values[0, 4] = np.inf
    (mesh,) = map_and_arrows(plane(values).cg.plot())
    mesh.axes.figure.canvas.draw()
    z, x = (axis.ravel() + 0.5 for axis in np.mgrid[0:4, 0:5])
    at_nodes = numbers_at(mesh, x, z)
    np.testing.assert_array_equal(np.ma.getmaskarray(at_nodes), ~np.isfinite(values).ravel())
    np.testing.assert_allclose(mesh.get_array().compressed(), 3.0, rtol=1e-14)
    plane(np.full((4, 5), np.nan)).cg.plot().figure.canvas.draw()


@pytest.mark.parametrize("radius", [5.0, 9.3, 14.0])
def test_the_rim_of_a_smooth_map_has_no_stairs(radius):
    """The rim of a disc is within half a spacing of its circle, and so smooth that its length is that of the circle."""
    z, x = np.mgrid[0:40, 0:40] + 0.5
    inside = np.hypot(x - 20, z - 20) < radius
    (mesh,) = map_and_arrows(plane(np.where(inside, 1.0, np.nan)).cg.plot())
    line = np.linspace(0.05, 39.95, 400)
    columns, rows = np.meshgrid(line, line)
    drawn = ~np.ma.getmaskarray(numbers_at(mesh, columns, rows))
    from contourpy import contour_generator  # comes with matplotlib

    (rim,) = contour_generator(line, line, ndimage.gaussian_filter(drawn.astype(float), 2)).lines(
        0.5
    )
    away = np.hypot(*(rim - 20).T)
    assert abs(away - radius).max() < 0.5
    assert np.hypot(*np.diff(rim, axis=0).T).sum() < 1.03 * 2 * np.pi * away.mean()
    flat = map_and_arrows(plane(np.where(inside, 1.0, np.nan)).cg.plot(shading="flat"))[0]
    assert flat.get_array().count() == inside.sum()


def test_straight_rims_stay_between_the_nodes():
    half = np.where(np.arange(6)[:, None] < 3, np.ones((6, 8)), np.nan)
    (mesh,) = map_and_arrows(plane(half).cg.plot())
    (rows,) = np.nonzero(~np.ma.getmaskarray(mesh.get_array()).any(axis=1))
    assert 6 * (rows[-1] + 1) / len(mesh.get_array()) == pytest.approx(3.0, abs=0.02)


def test_a_smooth_circle_has_no_seam():
    theta = (np.arange(12) + 0.5) * np.pi / 6
    values = np.broadcast_to(np.cos(theta), (6, 12))
    f = xr.Dataset({"density": (("r", "theta"), values)}, {"r": np.arange(6) + 0.5, "theta": theta})
    (mesh,) = map_and_arrows(f.cg.plot())
    drawn = mesh.get_array()
    np.testing.assert_allclose(drawn[0], drawn[-1], atol=0.01)
    np.testing.assert_allclose(drawn[0], np.cos(theta[0]), atol=0.01)
    (sector,) = map_and_arrows(f.isel(theta=slice(0, 6)).cg.plot())
    np.testing.assert_allclose(sector.get_array()[-1], values[0, 5])


def test_diverging_colours_only_where_both_signs_matter():
    """The smaller of two percentiles is a tenth of the larger, or more."""
    values = np.linspace(0, 50, 400).reshape(20, 20)
    values[0, :3] = -40  # fewer than 2 % of the nodes
    values[1:10, 0] = -4.0  # less than a tenth
    f = plane(values)
    mesh = map_and_arrows(f.cg.plot())[0]
    assert (mesh.get_cmap().name, mesh.get_clim()) == ("viridis", (-40, 50))
    values[1:10, 0] = -6.0
    mesh = map_and_arrows(plane(values).cg.plot())[0]
    assert (mesh.get_cmap().name, mesh.get_clim()) == ("RdBu_r", (-50, 50))
    mesh = map_and_arrows(plane(values).cg.plot(vmax=20))[0]
    assert (mesh.get_cmap().name, mesh.get_clim()) == ("RdBu_r", (-20, 20))
    assert mesh.colorbar.extend == "both"
    mesh = map_and_arrows(plane(values).cg.plot(vmin=0))[0]
    assert (mesh.get_cmap().name, mesh.get_clim()) == ("viridis", (0, 50))
    empty = np.zeros((20, 20))  # where no grain is, the stress is zero
    empty[:2, 0], empty[:2, 1] = 1.0, -1.0
    assert map_and_arrows(plane(empty).cg.plot())[0].get_cmap().name == "RdBu_r"


def test_arrows_are_drawn_where_grains_move(result):
    """On maps of a vector, and on others if asked for; none where grains rest."""
    _, f = result
    assert len(map_and_arrows(f.cg.plot("density"))) == 1
    assert len(map_and_arrows(f.cg.plot("velocity", component="z"))) == 1
    assert len(map_and_arrows(f.cg.plot("velocity"))) == 2
    assert len(map_and_arrows(f.cg.plot("velocity", arrows=None))) == 1
    moving = xr.where(f.x < 2.5, f.velocity, 0.01 * f.velocity).transpose(*f.velocity.dims)
    _, arrows = map_and_arrows(f.assign(velocity=moving).cg.plot("velocity"))
    assert 0 < len(arrows.U) == (arrows.get_offsets()[:, 0] < 2.5).sum()


def test_a_colour_bar_is_as_high_as_its_map():
    for shape in ((40, 10), (10, 10), (10, 16), (10, 40)):
        ax = plane(np.arange(float(np.prod(shape))).reshape(shape)).cg.plot()
        ax.figure.canvas.draw()
        bar = map_and_arrows(ax)[0].colorbar.ax
        assert bar.get_window_extent().height == pytest.approx(
            ax.get_window_extent().height, rel=0.15
        )


@pytest.mark.parametrize("shape", [(60, 10), (40, 20), (20, 20), (20, 60)])
def test_maps_fill_their_figure(shape):
    """The map takes the figure but for the room of labels and bar, as high as wide ones are wide."""
    numbers = plane(np.arange(float(np.prod(shape))).reshape(shape))
    ax = numbers.cg.plot()
    figure = ax.figure
    figure.canvas.draw()
    drawn = ax.get_window_extent().transformed(figure.dpi_scale_trans.inverted())
    wide, high = figure.get_size_inches()
    assert high - drawn.height < 1.2
    assert wide - drawn.width < 2.3 or wide == pytest.approx(3.2)
    assert max(wide, high) <= max(plt.rcParams["figure.figsize"])
    assert high > 6 or shape[0] <= shape[1]
    _, own = plt.subplots(figsize=(5, 5))
    assert tuple(numbers.cg.plot(ax=own).figure.get_size_inches()) == (5, 5)


def test_titles_of_narrow_figures_are_broken():
    place = {"time": ((), 1.25, {"units": "s"}), "y": ((), 3.325e-5, {"units": "m"})}
    f = plane(np.arange(80.0).reshape(20, 4)).assign_coords(place)
    ax = f.cg.plot()
    ax.figure.canvas.draw()
    title = ax.title.get_window_extent()
    assert ax.get_title() == "time = 1.25 s\ny = 3.325e-05 m"
    assert 0 < title.x0 < title.x1 < ax.figure.bbox.width
    wide = plane(np.arange(80.0).reshape(4, 20)).assign_coords(place)
    assert wide.cg.plot().get_title() == "time = 1.25 s, y = 3.325e-05 m"


def half_filled(names, **options):
    """Fields of grains below z = 5 up to a height of 12, and whether grains reach their nodes."""
    ds = xcg.datasets.random_scene(100, seed=2, periodic="")
    bounds = {"x": (0.0, 5.0), "z": (0.0, 12.0)}
    options |= {"axes": "xz", "width": 0.5, "bounds": bounds}
    density = ds.cg.coarse_grain("density", **options).density.isel(time=0)
    return ds.cg.coarse_grain(names, **options), density > 0


@pytest.mark.parametrize("names", [["pressure", "density"], ["pressure", "velocity"]])
def test_air_is_white_for_pressure_too(names):
    f, is_reached = half_filled(names)
    (mesh,) = map_and_arrows(f.cg.plot("pressure", shading="flat"))
    filled = ~np.ma.getmaskarray(mesh.get_array())
    np.testing.assert_array_equal(filled, is_reached.transpose("z", "x"))
    assert 0.1 < filled.mean() < 0.9


def test_air_is_white_for_pressure_without_a_density():
    """Zeros that no number is beside are air, and other fields keep their zeros."""
    f, is_reached = half_filled(["pressure"])
    (mesh,) = map_and_arrows(f.cg.plot("pressure", shading="flat"))
    drawn = mesh.get_array()
    high = (f.z > 8).to_numpy()
    assert np.ma.getmaskarray(drawn)[high].all()
    assert drawn[high == 0].count() >= int(is_reached.sum())
    zeros = np.zeros((4, 5))
    zeros[0] = 1.0
    (mesh,) = map_and_arrows(plane(zeros, "speed").cg.plot(shading="flat"))
    np.testing.assert_array_equal(mesh.get_array(), zeros)
    (mesh,) = map_and_arrows(plane(np.zeros((4, 5)), "pressure").cg.plot(shading="flat"))
    assert mesh.get_array().count() == 20


def test_a_share_of_zero_is_not_air():
    """Where only the other species is, its share is drawn as 0."""
    ds = xcg.datasets.random_scene(200, seed=1, periodic="")
    half = (ds.position.sel(component="x", drop=True) > 2.5).astype(int)
    ds = ds.assign(species=half.drop_attrs())
    f = ds.cg.coarse_grain("concentration", axes="xz", by="species", width=0.4)
    some = f.sel(phase=["0", "1"])
    for g, options in ((f, {"phase": 1}), (f.sel(phase="1"), {}), (some, {"phase": 1})):
        (mesh,) = map_and_arrows(g.cg.plot("concentration", shading="flat", **options))
        assert (mesh.get_array()[:, :3] == 0).any()
        assert (mesh.get_array() == 1).any()


@pytest.mark.parametrize(
    ("ends", "extend"),
    [({}, "neither"), ({"vmax": 20.0}, "max"), ({"vmin": 2.0}, "min")],
)
def test_bars_of_logarithms_have_arrows_where_they_are_clipped(ends, extend):
    """Numbers without a logarithm are not drawn, and are not below the bar."""
    values = np.arange(80.0).reshape(8, 10) - 5
    (mesh,) = map_and_arrows(plane(values).cg.plot(norm=LogNorm(**ends)))
    assert mesh.colorbar.extend == extend


def test_bars_of_grains_have_arrows_where_they_are_clipped():
    ds = xcg.datasets.random_scene(200, seed=1)
    middle = float(np.median(np.linalg.norm(ds.velocity[0], axis=1)))
    for ends, extend in (
        ({}, "neither"),
        ({"vmax": middle}, "max"),
        ({"vmin": middle}, "min"),
        ({"vmin": 0.9 * middle, "vmax": middle}, "both"),
    ):
        (circles,) = ds.cg.plot("velocity", **ends).collections
        assert circles.colorbar.extend == extend


def test_numbers_below_a_narrow_map_do_not_touch():
    f = plane(np.arange(96.0).reshape(24, 4))
    ax = f.assign_coords(x=0.02 * (f.x - 2), z=0.01 * f.z).cg.plot()
    ax.figure.canvas.draw()
    low, high = ax.get_xlim()
    drawn = [
        t.label1.get_window_extent()
        for t in ax.xaxis.get_major_ticks()
        if low <= t.get_loc() <= high
    ]
    assert drawn
    assert all(a.x1 < b.x0 for a, b in itertools.pairwise(drawn))


def test_pictures_have_figures_of_their_own(result):
    """They do not paint over the current one."""
    _, f = result
    mine = plt.figure().add_subplot()
    drawn = [f.cg.plot("density"), f.cg.profile("z").cg.plot("density"), f.cg.plot("density")]
    assert not mine.collections
    assert len({ax.figure for ax in [mine, *drawn]}) == 4
    assert f.cg.plot("density", ax=mine) is mine


# --- labels ----------------------------------------------------------------------------------------------


UNITS = {
    "1": "", "m": "m", "m s^-1": "m s⁻¹", "kg m^-3": "kg m⁻³", "Pa m^-1": "Pa m⁻¹", "m^2 s^-2": "m² s⁻²", "": "",
    "W m^-2": "W m⁻²", "m s-1": "m s⁻¹", "m**2/s": "m²/s", "m/s": "m/s", "10^-3 m": "10⁻³ m", "µm2": "µm²", "%": "%",
    "s^0.5": "s⁰·⁵", "degree": "degree", "10 kg": "10 kg", "1/s": "1/s", "$\\mu$m": "$\\mu$m", "kg^(-1)": "kg⁻¹",
}  # fmt: skip


def raised(text):
    """A label as it is read: powers as raised digits."""
    up = str.maketrans("-+.0123456789", "⁻⁺·⁰¹²³⁴⁵⁶⁷⁸⁹")
    return re.sub(r"\$\^\{([^}]*)\}\$", lambda power: power[1].translate(up), text)


@pytest.mark.parametrize("units", UNITS)
def test_units_have_raised_powers(units):
    assert raised(unit_text(units)) == UNITS[units]


def whole(unit):
    """A unit of the registry with raised powers, by another way."""
    return " ".join(
        base + power.translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
        for base, _, power in (part.partition("^") for part in unit.split())
    )


NAMES = [name for name in xcg.FIELDS if not name.startswith("_")]
LONGEST = sorted(NAMES, key=lambda name: len(xcg.FIELDS[name].long_name))[-10:]  # which may not fit


def field_plane(name):
    """A plane of any numbers of a field, and its label with the whole unit."""
    field = xcg.FIELDS[name]
    unit = units_of(field.powers)
    f = plane(np.arange(12.0).reshape(3, 4), name, units=unit, long_name=field.long_name)
    return f, field.long_name if unit == "1" else f"{field.long_name} [{whole(unit)}]"


@pytest.mark.parametrize("name", NAMES)
def test_the_label_of_each_field_has_its_whole_unit_in_one_line(name):
    f, wanted = field_plane(name)
    text = f.isel(x=0).cg.plot(name).get_xlabel()
    assert raised(text.replace("\n", " ")) == wanted
    assert re.search(r"\[[^\]\n]*\]$", text) or "[" not in wanted


@pytest.mark.parametrize("name", LONGEST)
def test_long_labels_fit_the_picture(name):
    f, wanted = field_plane(name)
    bar = map_and_arrows(f.cg.plot(name, shading="flat"))[0].colorbar.ax
    line = f.isel(x=0).cg.plot(name)
    assert raised(bar.get_ylabel().replace("\n", " ")) == wanted
    for axis, side in ((bar.yaxis, "height"), (line.xaxis, "width")):
        axis.figure.canvas.draw()
        label = axis.label.get_window_extent()
        room = axis.axes.get_window_extent()
        assert getattr(label, side) <= getattr(room, side)
        corners = axis.figure.bbox.get_points()
        assert (label.get_points()[0] >= corners[0]).all()
        assert (label.get_points()[1] <= corners[1]).all()


def test_derived_fields_have_their_own_labels(result):
    _, f = result
    bar = map_and_arrows(f.cg.plot("velocity"))[0].colorbar.ax
    assert raised(bar.get_ylabel()) == "magnitude of velocity [m s⁻¹]"
    mean = f.cg.profile("z").cg.time_average()
    assert raised(mean.cg.plot("velocity", component="x").get_xlabel()) == "velocity, x [m s⁻¹]"
    assert (
        raised(mean.cg.plot("velocity_error").get_xlabel()) == "standard error of velocity [m s⁻¹]"
    )


def test_labels_of_fields_of_users_have_their_units():
    ds = xcg.datasets.random_scene(40, seed=2)
    charge = (ds.mass * 0 + 1.0).assign_attrs(units="C s^-1", long_name="current of a grain")
    names = [xcg.Sum("charge"), xcg.Mean("charge")]
    f = ds.assign(charge=charge).cg.coarse_grain(names, axes="z", width=1.0).compute()
    ends = [f"[{whole(f[name].attrs['units'])}]" for name in f.data_vars]
    assert "s⁻¹" in ends[0]
    assert "[C s⁻¹]" in ends
    for name, end in zip(f.data_vars, ends, strict=True):
        assert raised(f.cg.plot(name).get_xlabel()).replace("\n", " ").endswith(end)


@pytest.mark.parametrize("axes", ["xz", "z"])
def test_a_movie_has_a_frame_a_step(result, tmp_path, axes, capsys):
    from PIL import Image

    _, f = result
    path = (f if axes == "xz" else f.cg.profile("z")).cg.movie(
        tmp_path / "f.gif", "velocity", dpi=40, progress=True
    )
    lines = [line.split(",")[0] for line in capsys.readouterr().err.splitlines()]
    assert lines == [
        f"{k} of 3 {what}" for what in ("steps computed", "frames drawn") for k in (1, 2, 3)
    ]
    with Image.open(path) as film:
        assert film.n_frames == 3
        frames = []
        for k in range(3):
            film.seek(k)
            frames.append(np.asarray(film.convert("RGB"), int))
    assert not np.array_equal(frames[0], frames[1])
    assert [p.name for p in tmp_path.iterdir()] == ["f.gif"]


def test_the_suggested_part_of_a_tensor_lies_in_the_layer():
    p = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    arrays = {"velocity": p, "diameter": np.ones(2), "density": 1.0}
    ds = xcg.scene_from_arrays(p, **arrays, dimension=2, plane="xy", thickness=1.0)
    f = ds.cg.coarse_grain("kinetic_stress", axes="x", extent={"y": 1.0})
    with pytest.raises(ValueError, match="for example component='x', direction='y'"):
        f.cg.plot()
    f.cg.plot(component="x", direction="y")


def test_wrong_plots_raise(result, tmp_path):
    scene, f = result
    with pytest.raises(
        ValueError, match=r"stress is a tensor: name a part of it, for example component='x'"
    ):
        f.cg.plot("stress")
    with pytest.raises(
        ValueError,
        match=r"plot\('velocty'\): the result has volume_fraction, .*; did you mean 'velocity'",
    ):
        f.cg.plot("velocty")
    with pytest.raises(
        ValueError, match=r"plot\('pressure'\): the result has .*; name 'pressure' in coarse_grain"
    ):
        f.cg.plot("pressure")
    with pytest.raises(ValueError, match=r"this is a scene: .*coarse_grain\(\.\.\.\)\.cg\.movie"):
        scene.isel(time=[0]).cg.movie("picture.gif")
    for keyword, message in (
        ("figsize", "give ax="),
        ("vmx", "did you mean 'vmax'"),
        ("foo", "foo"),
    ):
        with pytest.raises(TypeError, match=message):
            f.cg.plot("velocity", **{keyword: 1})
    with pytest.raises(TypeError, match="give cmap="):
        f.cg.plot("volume_fraction", color="red")
    with pytest.raises(TypeError, match="component=0: expected a name, one of x, y, z"):
        f.cg.plot("velocity", component=0)
    with pytest.raises(
        ValueError, match=r"xarray draws others, such as f\['density'\]\.plot\.line\(x='time'\)"
    ):
        f.isel(x=0, z=0).cg.plot("density")
    f.isel(x=0, z=0)["density"].plot.line(x="time")
    with pytest.raises(ValueError, match=r"component='x': density has no dimension 'component'"):
        f.cg.plot("density", component="x")
    with pytest.raises(ValueError, match=r"at={'y': 1.0}: the axes of this result are x, z"):
        f.cg.plot(at={"y": 1.0})
    with pytest.raises(ValueError, match="plot draws along one or two of r, theta, x, y, z"):
        f.isel(x=0, z=0).cg.plot()
    with pytest.raises(ValueError, match="shading='gouraud': expected one of 'smooth', 'flat'"):
        f.cg.plot("density", shading="gouraud")
    for wrong in ("speed", "density"):
        with pytest.raises(
            ValueError, match=f"arrows='{wrong}': expected a vector field of the result"
        ):
            f.cg.plot("density", arrows=wrong)
    with pytest.raises(ValueError, match=r"ends with \.gif or \.mp4"):
        f.cg.movie(tmp_path / "f.avi")
    with pytest.raises(ValueError, match="movie needs a result with the dimension 'time'"):
        f.isel(time=0).cg.movie(tmp_path / "f.gif")
    with pytest.raises(ValueError, match=r"component='q': expected one of x, y, z$"):
        f.cg.plot("velocity", component="q")
    for wrong in (3, -4, 0.5, "last"):
        with pytest.raises(
            ValueError, match=f"index={wrong!r}: expected the position of a step, a whole number"
        ):
            f.cg.plot("density", index=wrong)
    with pytest.raises(ValueError, match="phase=1: the result has no dimension 'phase'"):
        f.cg.plot("density", phase=1)
    by_species = xcg.datasets.random_scene(20).cg.coarse_grain(
        "density", axes="z", by="species", width=1.0
    )
    for draw in (
        by_species.cg.plot,
        lambda *a, **k: by_species.cg.movie(tmp_path / "f.gif", *a, **k),
    ):
        with pytest.raises(ValueError, match=r"phase=9: expected one of bulk, 1, 2$"):
            draw("density", phase=9)
    assert not [*tmp_path.iterdir()]


def test_a_movie_without_ffmpeg(result, tmp_path, monkeypatch):
    monkeypatch.setitem(plt.rcParams, "animation.ffmpeg_path", "no-such-program")
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(OSError, match="mp4 needs the program ffmpeg: pip install imageio-ffmpeg"):
        result[1].cg.movie(tmp_path / "f.mp4")
    assert not list(tmp_path.iterdir())


def test_a_movie_by_imageio_ffmpeg(result, tmp_path, monkeypatch):
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    monkeypatch.setitem(plt.rcParams, "animation.ffmpeg_path", "no-such-program")
    path = result[1].cg.movie(tmp_path / "f.mp4", "velocity", dpi=41, fps=3)
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(path)
    assert frames == 3
    assert seconds == pytest.approx(1.0, abs=0.01)
    assert [file.name for file in tmp_path.iterdir()] == ["f.mp4"]


@pytest.mark.parametrize(
    ("package", "extra", "call"),
    [
        ("matplotlib.pyplot", "plot", lambda f, folder: f.cg.plot()),
        ("PIL.Image", "plot", lambda f, folder: f.cg.movie(folder / "f.gif")),
        ("zarr.codecs", "zarr", lambda f, folder: f.cg.save(folder / "f.zarr")),
        (
            "sklearn.cluster",
            "phases",
            lambda f, folder: xcg.datasets.random_scene(9).cg.find_phases(),
        ),
    ],
)
def test_errors_name_the_extra_to_install(result, tmp_path, monkeypatch, package, extra, call):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ImportError, match=re.escape(f"pip install 'xcg[{extra}]'")):
        call(result[1], tmp_path)


def test_extras_named_in_messages_exist():
    known = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    named = set()
    for path in [*ROOT.glob("xcg/**/*.py"), *ROOT.glob("docs/*.md"), ROOT / "README.md"]:
        named |= set(re.findall(r"xcg\[(\w+)\]", path.read_text()))
        named |= set(re.findall(r'extra\("[\w.]+", "(\w+)"', path.read_text()))
    assert named
    assert named <= set(known)


@pytest.mark.parametrize("axes", ["z", "xz"])
def test_a_selection_without_nodes_names_its_axis(axes):
    f = xcg.datasets.open("chute").cg.coarse_grain("density", axes=axes, width=1.0)
    with pytest.raises(ValueError, match="no node is left along z; select one at least"):
        f.isel(z=slice(0, 0)).cg.plot("density")
