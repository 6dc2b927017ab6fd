"""Meshes of PyVista against the numbers that they are made of, and pictures in 3D."""

import sys

import numpy as np
import pytest
import xarray as xr

import xcg
from tests import pyvista_draws
from tests.networks import network
from tests.scenes import random_steps

pv = pytest.importorskip("pyvista")
from vtkmodules.util.numpy_support import vtk_to_numpy  # noqa: E402


@pytest.fixture(scope="module")
def scene():
    return xcg.datasets.random_scene(60, seed=1, periodic="xy")


@pytest.fixture(scope="module")
def fields(scene):
    names = ["density", "velocity", "stress", "sample_count"]
    return scene.cg.coarse_grain(names, width=0.8, spacing={"x": 1.0, "y": 0.5, "z": 0.8})


@pytest.fixture
def plotter():
    if not pyvista_draws():
        pytest.skip("VTK finds no way to draw")
    found = pv.Plotter(off_screen=True, window_size=(300, 200))
    yield found
    found.close()


# --- images ----------------------------------------------------------------------------------------------


def test_an_image_has_each_number_at_its_node(fields):
    image = fields.cg.to_pyvista()
    assert isinstance(image, pv.ImageData)
    step = fields.isel(time=-1)
    assert image.dimensions == (step.sizes["x"], step.sizes["y"], step.sizes["z"])
    for k, point in enumerate(np.asarray(image.points)):
        there = step.sel(dict(zip("xyz", point, strict=True)), method="nearest")
        np.testing.assert_allclose([there[a] for a in "xyz"], point, atol=1e-12)
        for name in ("density", "velocity", "stress", "sample_count"):
            np.testing.assert_array_equal(image[name][k], there[name].values.ravel())
    sheared = image["stress"].reshape(-1, 3, 3)[:, 0, 2]
    np.testing.assert_array_equal(
        sheared.sum(), step.stress.sel(component="x", direction="z").values.ravel("F").sum()
    )


def test_meshes_hold_units_and_time(fields):
    noted = fields.cg.to_pyvista(index=0).user_dict
    assert noted["units"]["stress"] == "Pa"
    assert noted["units"]["velocity"] == "m s^-1"
    assert noted["time"] == 0.0


def test_meshes_of_steps_phases_and_planes():
    ds = random_steps(3)
    f = ds.chunk(time=1).cg.coarse_grain(
        ["density"], by="species", groups=[1, 2], axes="xz", at={"y": 1.5}, width=0.8, spacing=1.0
    )
    image = f.cg.to_pyvista(index=1)
    nx = f.sizes["x"]
    nz = f.sizes["z"]
    assert image.dimensions == (nx, 1, nz)
    assert image.origin[1] == 1.5
    for name, phase in (("density", "bulk"), ("density_phase_1", 1), ("density_phase_2", 2)):
        expected = f.density.sel(phase=phase).isel(time=1).transpose("z", "x").values.ravel()
        np.testing.assert_array_equal(image[name], expected)
        assert image.user_dict["units"][name] == "kg m^-3"
    one = f.isel(time=2).cg.to_pyvista()
    np.testing.assert_array_equal(one["density"], f.cg.to_pyvista(index=-1)["density"])


def test_nan_is_not_drawn(plotter):
    ds = xcg.scene_from_arrays(
        np.full((1, 3), 2.0), diameter=[1.0], density=1.0, velocity=[[1.0, 2.0, 3.0]]
    )
    f = ds.cg.coarse_grain(
        "velocity", width=0.8, spacing=0.5, bounds=dict.fromkeys("xyz", (0.0, 4.0))
    )
    image = f.cg.to_pyvista()
    unknown = np.isnan(image["velocity"]).any(axis=1)
    assert unknown.any()
    assert not unknown.all()
    f.cg.view("velocity", plotter=plotter)
    drawn = next(iter(plotter.meshes))
    assert drawn.n_points > 0
    assert np.isfinite(drawn["velocity"]).all()


def test_rings_uneven_axes_and_points_raise(scene):
    ring = scene.cg.coarse_grain(
        "density", frame=xcg.Cylindrical((2.5, 2.5, 0)), axes="rz", width=0.8
    )
    with pytest.raises(
        ValueError, match=r"on a cylinder, and an image has x, y and z: draw them with f\.cg\.plot"
    ):
        ring.cg.to_pyvista()
    f = scene.cg.coarse_grain("density", axes="z", width=0.8)
    with pytest.raises(ValueError, match="'z' is not evenly spaced"):
        f.isel(z=[0, 1, 3]).cg.to_pyvista()
    along = xr.DataArray(np.linspace(0, 4, 5), dims="s")
    with pytest.raises(ValueError, match="Fields at points are no image"):
        scene.cg.coarse_grain(
            "density", at={"x": along, "y": along, "z": along}, width=0.8
        ).cg.to_pyvista()
    with pytest.raises(ValueError, match="index=4: expected the position of a step"):
        f.cg.to_pyvista(4)


# --- grains, contacts, chains ----------------------------------------------------------------------------


def test_spheres_are_as_large_as_their_grains(scene):
    spheres = scene.cg.to_pyvista()["particles"]
    step = scene.isel(time=0)
    for row in (0, 10):
        own = np.asarray(spheres.points)[spheres["particle_id"] == step.particle_id.values[row]]
        away = np.linalg.norm(own - step.position.values[row], axis=1)
        np.testing.assert_allclose(away, step.diameter.values[row] / 2, rtol=1e-5)
    assert set(spheres.point_data) >= {"velocity", "species", "mass", "diameter"}


def test_lines_lead_from_grains_to_their_contact_points(scene):
    blocks = scene.cg.to_pyvista(shapes=False)
    assert isinstance(blocks, pv.MultiBlock)
    step = scene.isel(time=0)
    lines = blocks["contacts"]
    np.testing.assert_array_equal(
        blocks["particles"].points, step.position.values.astype(blocks["particles"].points.dtype)
    )
    there = step.contact_i.values >= 0
    walls = (step.contact_j.values[there] < 0).sum()
    assert walls
    assert lines.n_lines == 2 * there.sum() - walls
    start, end = np.asarray(lines.points)[lines.lines.reshape(-1, 3)[:, 1:]].transpose(1, 0, 2)
    period = np.array([5.0, 5.0, np.inf])
    for k in range(lines.n_lines):
        ids = lines.cell_data["contact_i"][k], lines.cell_data["contact_j"][k]
        grain = [
            np.abs(step.position.values[step.particle_id.values == n] - start[k]).max(initial=0)
            for n in ids
        ]
        assert min(g for g, n in zip(grain, ids, strict=True) if n >= 0) < 1e-6
        away = end[k] - lines.cell_data["contact_point"][k]
        away -= np.where(np.isfinite(period), 5.0 * np.rint(away / 5.0), 0.0)
        assert np.abs(away).max() < 1e-5
        assert np.linalg.norm(end[k] - start[k]) < 2.5
    force = lines.cell_data["contact_force"]
    np.testing.assert_allclose(lines.cell_data["force_magnitude"], np.linalg.norm(force, axis=1))


def test_tubes_grow_with_the_force():
    position = [(float(k), 0.0) for k in range(4)]
    ds = network(position, [(0, 1), (1, 2), (2, 3)], [1.0, 2.0, 4.0], dimension=2, thickness=1.0)
    tubes = ds.cg.to_pyvista()["contacts"]
    middle = np.asarray(tubes.points)
    widths = [np.abs(middle[np.abs(middle[:, 0] - x) < 0.3, 1]).max() for x in (0.5, 1.5, 2.5)]
    np.testing.assert_allclose(np.divide(widths, widths[0]), [1, 2, 4], rtol=0.05)
    assert widths[2] == pytest.approx(0.3 * 0.5, rel=0.05)


def test_drawn_chains_are_the_found_ones():
    position = [(0.0, float(k)) for k in range(5)]
    ds = network(position, [(k, k + 1) for k in range(4)], [1.0] * 4, dimension=2, thickness=1.0)
    fc = ds.cg.force_chains()
    links = fc.cg.to_pyvista(shapes=False)
    assert links.n_lines == 4
    np.testing.assert_allclose(links.cell_data["force_magnitude"], 1.0)
    assert links.user_dict["units"]["stress"] == "Pa"
    blocks = ds.cg.to_pyvista(chains=fc)
    assert set(blocks.keys()) >= {"particles", "contacts", "chains"}
    np.testing.assert_allclose(blocks["chains"].bounds[2:4], (0, 4), atol=1e-6)
    with pytest.raises(ValueError, match="chains= is drawn with a scene"):
        ds.cg.coarse_grain("density", width=1.0).cg.to_pyvista(chains=fc)


def test_the_box_equals_that_of_the_scene():
    box = xcg.datasets.random_scene(5).cg.to_pyvista()["box"]
    assert box.n_lines == 12
    np.testing.assert_allclose(box.bounds, (0, 5) * 3)
    ds = xcg.scene_from_arrays(
        np.full((1, 3), 0.5), diameter=[0.1], density=1.0, box=[[0, 1]] * 3, periodic="xyz",
        lattice=[[1, 0, 0], [0.5, 1, 0], [0, 0, 1]],
    )  # fmt: skip
    np.testing.assert_allclose(ds.cg.to_pyvista()["box"].bounds, (0, 1.5, 0, 1, 0, 1))


@pytest.mark.parametrize("count", [0, 1])
def test_scenes_of_up_to_two_grains_are_drawn(count, plotter):
    ds = xcg.datasets.random_scene(count)
    assert set(ds.cg.to_pyvista().keys()) == {"particles", "contacts", "box"}
    ds.cg.view(plotter=plotter)
    ds.cg.view(contacts=True, plotter=plotter)


# --- pictures --------------------------------------------------------------------------------------------


def colours(plotter):
    picture = plotter.screenshot(return_img=True)
    return len(np.unique(picture.reshape(-1, picture.shape[-1]), axis=0))


@pytest.mark.parametrize(
    "draw",
    [
        lambda ds, f, p: f.cg.view(plotter=p),
        lambda ds, f, p: f.cg.view("stress", component="x", direction="z", plotter=p),
        lambda ds, f, p: f.isel(y=3).cg.view(
            "velocity", component="z", vmin=0, vmax=1, cmap="magma", plotter=p
        ),
        lambda ds, f, p: ds.cg.view(plotter=p),
        lambda ds, f, p: ds.cg.view("diameter", contacts=True, plotter=p),
        lambda ds, f, p: ds.cg.view(chains=ds.cg.force_chains(), plotter=p),
        lambda ds, f, p: ds.cg.force_chains().cg.view(plotter=p),
    ],
)
def test_pictures_are_not_empty(scene, fields, draw, plotter):
    assert draw(scene, fields, plotter) is plotter
    assert colours(plotter) > 20


@pytest.mark.parametrize("ends", [(0, 10.43), (-0.0137, 0.0041), (3, 3000), (0.00431, 0.00544)])
def test_bars_have_round_ticks(scene, plotter, ends):
    """Ticks are multiples of 1, 2, 2.5 or 5 times a power of ten, between the ends."""
    scene.cg.view("diameter", vmin=ends[0], vmax=ends[1], plotter=plotter)
    (bar,) = plotter.scalar_bars.values()
    assert bar.GetUseCustomLabels()
    ticks = vtk_to_numpy(bar.GetCustomLabels())
    assert 3 <= len(ticks) <= 7
    assert ends[0] <= ticks[0] < ticks[-1] <= ends[1]
    step = np.diff(ticks).mean()
    np.testing.assert_allclose(ticks, step * np.rint(ticks / step), atol=1e-9 * step)
    assert np.isclose(step / 10 ** np.floor(np.log10(step) + 1e-9), [1, 2, 2.5, 5]).any()


def test_a_bar_of_one_number_keeps_its_labels(scene, plotter):
    scene.assign(diameter=0 * scene.diameter + 1).cg.view("diameter", plotter=plotter)
    (bar,) = plotter.scalar_bars.values()
    assert not bar.GetUseCustomLabels()


def test_ends_of_bars_that_clip_are_marked(scene, plotter):
    middle = float(scene.diameter.median())
    scene.cg.view("diameter", vmin=middle, plotter=plotter)
    (bar,) = plotter.scalar_bars.values()
    assert (bar.GetDrawBelowRangeSwatch(), bar.GetDrawAboveRangeSwatch()) == (1, 0)
    table = bar.GetLookupTable()
    np.testing.assert_array_equal(np.asarray(table.below_range_color.int_rgba), table.values[0])


def drawn_lines(plotter):
    """Bounds of the box or outline that a picture has."""
    (lines,) = [mesh for mesh in plotter.meshes if getattr(mesh, "n_lines", 0)]
    return lines.bounds


def test_boxes_are_no_taller_than_their_grains(plotter):
    """Along periodic axes the box is whole, and along others it ends where the grains do."""
    ds = xcg.scene_from_arrays(
        [[1.0, 1.0, 1.0], [2.0, 3.0, 4.0]], diameter=1.0, density=1.0,
        box=[[0, 5], [0, 5], [0, 50]], periodic="xy",
    )  # fmt: skip
    ds.cg.view("diameter", plotter=plotter)
    np.testing.assert_allclose(drawn_lines(plotter), (0, 5, 0, 5, 0.5, 4.5), atol=0.02)
    np.testing.assert_allclose(ds.cg.to_pyvista()["box"].bounds, (0, 5, 0, 5, 0, 50))


@pytest.mark.parametrize("names", [["pressure"], ["pressure", "density"]])
def test_air_is_not_drawn(scene, plotter, names):
    """Nodes above the grains are left out, and the outline ends below them."""
    f = scene.cg.coarse_grain(names, width=0.5, bounds={"z": (0.0, 20.0)})
    f.cg.view("pressure", plotter=plotter)
    highest = drawn_lines(plotter)[5]
    assert 4.0 < highest < 8.0
    assert next(iter(plotter.meshes)).bounds[5] <= highest


def test_a_notebook_shows_a_view_once(scene, plotter, monkeypatch):
    """The cell that shows the picture does not repeat it as its result, and later cells may."""
    interactiveshell = pytest.importorskip("IPython.core.interactiveshell")
    shown = []
    shell = interactiveshell.InteractiveShell.instance()
    try:
        monkeypatch.setattr(pv, "OFF_SCREEN", True)
        monkeypatch.setattr(pv.Plotter, "show", lambda self: shown.append("by view"))
        monkeypatch.setattr(pv.Plotter, "_repr_png_", lambda self: shown.append("as a result"))
        shell.user_ns["ds"] = scene
        shell.run_cell("p = ds.cg.view(); p", store_history=True)
        assert shown == ["by view"]
        shell.run_cell("p", store_history=True)
        shell.run_cell("p", store_history=True)
        assert shown == ["by view", "as a result", "as a result"]
    finally:
        shell.history_manager.end_session()
        interactiveshell.InteractiveShell.clear_instance()


def test_view_without_a_plotter_shows_one(scene, plotter, monkeypatch):
    monkeypatch.setattr(pv, "OFF_SCREEN", True)
    assert isinstance(scene.cg.view(), pv.Plotter)


def test_wrong_views_raise(scene, fields, plotter, monkeypatch):
    with pytest.raises(ValueError, match=r"unknown field 'densty'; did you mean 'density'"):
        fields.cg.view("densty", plotter=plotter)
    with pytest.raises(ValueError, match=r"unknown field 'weight'"):
        scene.cg.view("weight", plotter=plotter)
    with pytest.raises(ValueError, match=r"'component': 'q'.*'velocity' has no part of this name"):
        fields.cg.view("velocity", component="q", plotter=plotter)
    with pytest.raises(
        ValueError, match=r"two axes or three, and 'density' has 1: use f\.cg\.plot"
    ):
        fields.isel(x=0, y=0).cg.view("density", plotter=plotter)
    with pytest.raises(ValueError, match=r"no contacts; ds\.cg\.find_contacts\(\) finds them"):
        scene.drop_dims("contact").cg.view(contacts=True, plotter=plotter)
    for ds in (scene, scene.cg.force_chains()):
        for part in ({"component": "x"}, {"phase": 1}):
            with pytest.raises(
                ValueError, match=f"{next(iter(part))}= chooses a part of a field of a result"
            ):
                ds.cg.view(plotter=plotter, **part)
    monkeypatch.setitem(sys.modules, "pyvista", None)
    for draw in (scene.cg.view, fields.cg.to_pyvista):
        with pytest.raises(ImportError, match=r"needs pyvista, .* pip install 'xcg\[view\]'"):
            draw()


def test_a_notebook_without_ipywidgets_is_told_what_to_install(monkeypatch):
    pv = pytest.importorskip("pyvista")

    def show(self):
        raise ImportError("Please install `ipywidgets`.")

    monkeypatch.setattr(pv.Plotter, "show", show)
    with pytest.raises(
        ImportError, match=r"install `ipywidgets`.*pip install 'pyvista\[jupyter\]'"
    ):
        xcg.datasets.random_scene(20).cg.view()
