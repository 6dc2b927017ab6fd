"""Fields at any points: those of a mesh with the same nodes, whatever the points, their order and their blocks."""

import os
import subprocess
import sys
import warnings
from unittest import mock

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

import xcg
from tests.brute_force import BruteKernel, brute_force
from xcg.fields.grids import points as module

# what fits through few grains, and ratios with pressures near zero, make of the last bit of their sums
FITTED = {
    "friction_coefficient",
    "velocity_gradient", "shear_rate_tensor", "shear_rate", "fluctuation_stress", "fluctuation_density",
    "granular_temperature", "directional_temperature", "inertial_number",
}  # fmt: skip
ALL = [name for name in xcg.FIELDS if name[0] != "_" and not xcg.FIELDS[name].option]


def shuffled(mesh, dim="point"):
    """The nodes of a mesh as points in any order."""
    axes = [a for a in "xyz" if a in mesh.coords]
    resolved = [a for a in axes if mesh[a].ndim]
    grid = np.stack(np.meshgrid(*(mesh[a].values for a in resolved), indexing="ij"), -1).reshape(
        -1, len(resolved)
    )
    order = np.random.default_rng(0).permutation(len(grid))
    at = {a: xr.DataArray(grid[order, k], dims=dim) for k, a in enumerate(resolved)}
    return order, at | {a: float(mesh[a]) for a in axes if not mesh[a].ndim}


def assert_as_mesh(f, mesh, order, rtol):
    resolved = [a for a in "xyz" if a in mesh.dims]
    assert set(f.data_vars) == set(mesh.data_vars)
    for name in mesh.data_vars:
        found = f[name].transpose("time", "point", ...).values
        expected = (
            mesh[name]
            .stack(point=resolved, create_index=False)
            .transpose("time", "point", ...)
            .values[:, order]
        )
        assert found.shape == expected.shape
        np.testing.assert_array_equal(np.isnan(found), np.isnan(expected), name)
        scale = np.nanmax(np.abs(expected), initial=0.0)
        tolerance = max(rtol, 1e-6 if name in FITTED else 0.0)
        np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance * scale, err_msg=name)


@pytest.fixture(scope="module")
def scene():
    return xcg.datasets.random_scene(40, seed=3)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"axes": "xz", "at": {"y": 1.3}},
        {"axes": "xz"},
        {"axes": "z"},
        {"axes": "y", "at": {"z": 7.0}},  # an image
        {"by": "species", "by_pair": True},
        {"by": "species", "width": {1: 0.4, 2: 0.8}},
        {"kernel": "gaussian"},
        {"kernel": "heaviside"},
        {"gradient": "kernel"},
        {"width": 2.9, "spacing": 1.0},  # images of one grain meet
    ],
    ids=str,
)
def test_points_equal_a_mesh_with_the_same_nodes(scene, options):
    mesh = scene.cg.coarse_grain(**options)
    order, at = shuffled(mesh)
    f = scene.cg.coarse_grain(
        at=at, **{k: v for k, v in options.items() if k not in ("axes", "at", "spacing")}
    )
    assert f.attrs["averaged_axes"] == mesh.attrs["averaged_axes"]
    assert_as_mesh(f, mesh, order, 1e-12)


@pytest.mark.parametrize("rtol", [1e-2, 1e-3, 1e-6])
def test_errors_of_quadrature_at_points_are_below_rtol(scene, rtol):
    exact = scene.cg.coarse_grain("contact_stress", axes="xz")
    order, at = shuffled(exact)
    assert_as_mesh(scene.cg.coarse_grain("contact_stress", at=at, rtol=rtol), exact, order, rtol)


def test_points_in_a_layer():
    rng = np.random.default_rng(1)
    ds = xcg.scene_from_arrays(
        np.column_stack([rng.uniform(0, 6, (30, 2)), np.zeros(30)]), diameter=np.ones(30), density=1.0,
        velocity=rng.normal(size=(30, 3)) * [1, 1, 0], box=[[0, 6], [0, 6], [-0.5, 0.5]], periodic="x", dimension=2,
    )  # fmt: skip
    mesh = ds.cg.coarse_grain()
    order, at = shuffled(mesh)
    assert_as_mesh(ds.cg.coarse_grain(at=at), mesh, order, 1e-12)


def test_points_against_the_definitions(scene):
    where = np.random.default_rng(2).uniform(-2, 7, (6, 3))
    at = {a: xr.DataArray(where[:, k], dims="point") for k, a in enumerate("xyz")}
    expected = brute_force(scene, BruteKernel("lucy", 0.8), where, gradient=False)
    f = scene.cg.coarse_grain(width=0.8, at=at).isel(time=0)
    for name in (
        "density",
        "momentum_density",
        "kinetic_stress",
        "contact_stress",
        "fabric",
        "boundary_force_density",
    ):
        values = np.array(expected[name], float)
        np.testing.assert_allclose(
            f[name], values, rtol=1e-11, atol=1e-12 * np.abs(values).max(), err_msg=name
        )
    np.testing.assert_array_equal(f.sample_count, expected["sample_count"])


# --- any set of points -------------------------------------------------------------------------------------

NUMBERS = st.floats(-1e3, 1e3) | st.sampled_from([0.0, 1.0, 2.5, 2.5 + 1e-9, 5.0, 1e6, -1e9])


@settings(max_examples=40, deadline=None)
@given(
    where=st.lists(st.tuples(NUMBERS, NUMBERS, NUMBERS), min_size=1, max_size=30),
    repeat=st.integers(1, 3),
)
@pytest.mark.filterwarnings("ignore::xcg.SceneWarning")
def test_points_do_not_influence_each_other(where, repeat):
    """Duplicates, points far from each other and outside the grains: every one sees what it sees by itself."""
    ds = xcg.datasets.random_scene(20, seed=5).assign_attrs(periodic="")
    where = np.array(where * repeat)
    names = ["density", "kinetic_stress", "contact_stress", "sample_count"]
    at = {a: xr.DataArray(where[:, k], dims="point") for k, a in enumerate("xyz")}
    f = ds.cg.coarse_grain(names, at=at, width=0.7).isel(time=0)
    for k in {0, len(where) // 2, len(where) - 1}:
        alone = ds.cg.coarse_grain(
            names, at=dict(zip("xyz", where[k].tolist(), strict=True)), width=0.7
        ).isel(time=0)
        for name in names:
            scale = max(1.0, float(abs(alone[name]).max()))
            np.testing.assert_allclose(
                f[name][k], alone[name], rtol=0, atol=1e-6 * scale, err_msg=name
            )


@pytest.fixture(scope="module")
def many():
    rng = np.random.default_rng(8)
    where = np.concatenate(
        [rng.uniform(0, 5, (9000, 3)), np.full((50, 3), 2.5), [[40.0, 0, 0], [-30, 19, 1]]]
    )
    return {a: xr.DataArray(where[:, k], dims="point") for k, a in enumerate("xyz")}


@pytest.mark.filterwarnings("ignore::xcg.SceneWarning")
def test_bits_do_not_depend_on_blocks_threads_and_order(scene, many):
    f = scene.cg.coarse_grain(at=many)
    order = np.random.default_rng(1).permutation(f.sizes["point"])
    turned = {a: x.isel(point=order) for a, x in many.items()}
    with mock.patch.object(module, "BLOCK_NODES", 700), mock.patch.object(module, "_FEW", 100):
        assert len(scene.cg.explain(at=turned).nodes.parts) > 10
        parts = scene.cg.coarse_grain(at=turned)
    with mock.patch("xcg.steps.analysis.THREADS", 1):
        alone = scene.cg.coarse_grain(at=many)
    for name in f.data_vars:
        np.testing.assert_array_equal(alone[name], f[name], name)
        np.testing.assert_array_equal(parts[name], f[name].isel(point=order), name)


def test_parts_cover_all_points_once(many, scene):
    for most, few in ((700, 100), (100_000, 4096), (10, 3)):
        with mock.patch.object(module, "BLOCK_NODES", most), mock.patch.object(module, "_FEW", few):
            nodes = module.make_points(many, plane="xyz", cutoff=1.5)
        places = np.concatenate([part.indices for part in nodes.parts])
        np.testing.assert_array_equal(np.sort(places), np.arange(nodes.count))
        for part in nodes.parts:
            assert part.count == len(part.indices)
            assert (np.diff(part.indices[part.order].astype(int)) > 0).all()
            assert len(part.cells.start) <= module._MOST_CELLS + 4 * part.count + 1
            for k, a in enumerate("xyz"):
                back = part.cells.points[k][: part.count] * part.unit + nodes.origin[k]
                np.testing.assert_allclose(
                    back, many[a].values[part.indices], rtol=1e-12, atol=1e-12
                )


def test_no_points_give_an_empty_result(scene):
    none = {a: xr.DataArray(np.zeros((0, 2)), dims=("point", "pair")) for a in "xyz"}
    f = scene.cg.coarse_grain(["velocity", "density"], at=none)
    assert f.velocity.dims == ("time", "point", "pair", "component")
    assert f.velocity.shape == (1, 0, 2, 3)


# --- labels ------------------------------------------------------------------------------------------------


def test_dimensions_and_coordinates_equal_those_of_the_arrays(scene):
    run = xr.DataArray(
        [0.1, 0.2, 0.3], dims="run", coords={"run": [7, 8, 9], "name": ("run", list("abc"))}
    )
    side = xr.DataArray([1.0, 2.0], dims="side", attrs={"long_name": "height"})
    f = scene.cg.coarse_grain("velocity", at={"x": run, "y": run + 1, "z": side})
    assert f.velocity.dims == ("time", "run", "side", "component")
    assert f.run.values.tolist() == [7, 8, 9]
    assert f.name.values.tolist() == ["a", "b", "c"]
    assert f.x.dims == ("run",)
    assert f.z.dims == ("side",)
    assert f.z.attrs["long_name"] == "height"
    assert f.z.attrs["units"] == "m"
    one = scene.cg.coarse_grain("velocity", at={"x": 0.2, "y": 1.2, "z": 2.0})
    np.testing.assert_allclose(f.velocity.sel(run=8).isel(side=1), one.velocity, rtol=1e-12)


def test_an_axis_with_a_dimension_of_its_own_name_makes_a_product(scene):
    z = xr.DataArray([0.5, 1.0, 1.5], dims="z")
    f = scene.cg.coarse_grain(
        "density", at={"x": xr.DataArray([1.0, 2.0], dims="point"), "y": 2.0, "z": z}
    )
    assert f.density.dims == ("time", "point", "z")
    assert f.sel(z=1.0).density.shape == (1, 2)
    mesh = scene.cg.coarse_grain(
        "density", axes="z", at={"x": 2.0, "y": 2.0}, bounds={"z": (0.5, 1.5)}, spacing=0.5
    )
    np.testing.assert_allclose(f.density.isel(point=1), mesh.density, rtol=1e-12)


def test_stacked_points_lose_their_index_only(scene):
    corners = xr.DataArray(np.zeros((2, 3)), coords={"i": [1, 2], "j": [1, 2, 3]}, dims=("i", "j"))
    stacked = corners.stack(point=("i", "j"))
    f = scene.cg.coarse_grain("density", at={"x": stacked, "y": stacked + 1})
    assert f.density.dims == ("time", "point")
    assert f.j.values.tolist() == [1, 2, 3, 1, 2, 3]


@pytest.mark.parametrize(
    ("at", "options", "message"),
    [
        ({"x": np.arange(3.0)}, {}, r"at\['x'\] is a ndarray of shape \(3,\): points are DataArrays"),
        ({"x": [1.0, 2.0]}, {}, "at\\['x'\\] is a list .* dims='point'"),
        ({"q": xr.DataArray([1.0], dims="p")}, {}, r"at names \['q'\]"),
        ({"x": xr.DataArray(["a"], dims="p")}, {}, "expected coordinates"),
        ({"x": xr.DataArray([0.0, np.nan], dims="p")}, {}, r"at\['x'\] is nan at \{'p': 1\}"),
        ({"x": xr.DataArray([0.0, 1e80], dims="p")}, {}, "expected finite"),
        ({"x": xr.DataArray([0.0], dims="time")}, {}, "'time'.* are other dimensions of results; rename"),
        ({"y": xr.DataArray([0.0], dims="x")}, {}, r"\['x'\] are other dimensions of results"),
        ({"x": xr.DataArray([0.0, 1], dims="p"), "y": xr.DataArray([0.0], dims="p")}, {}, "other sizes or labels"),
        ({"x": xr.DataArray([0.0], dims="p")}, {"axes": "z"}, "axes='z' lays a mesh.* one more array of at="),
        ({"x": xr.DataArray([0.0], dims="p")}, {"spacing": 0.1}, "spacing=0.1 lays a mesh"),
        ({"x": xr.DataArray([0.0], dims="p")}, {"bounds": {"x": (0, 1)}}, "bounds=.* lays a mesh"),
        ({"x": xr.DataArray([0.0], dims="p")}, {"gradient": "finite_difference"}, "points have no neighbours"),
    ],
)  # fmt: skip
def test_wrong_points_raise(scene, at, options, message):
    with pytest.raises(ValueError, match=message):
        scene.cg.coarse_grain("density", at=at, **options)


def test_finite_differences_between_points_raise(scene):
    with pytest.raises(ValueError, match=r"at= names \['x'\]: no derivative is taken"):
        scene.cg.balance(at={"x": xr.DataArray([0.0], dims="p")})


def test_points_outside_a_periodic_box_or_beyond_all_grains_warn(scene):
    far = xr.DataArray([1.0, 40.0], dims="p")
    with pytest.warns(xcg.SceneWarning, match=r"at=\{'x': 40\} is outside the box"):
        scene.cg.explain("density", at={"x": far})
    open_scene = scene.assign_attrs(periodic="")
    with pytest.warns(xcg.SceneWarning, match="no grain reaches any node"):
        open_scene.cg.coarse_grain("density", at={"x": far + 50, "y": far, "z": far})


# --- what takes a request ----------------------------------------------------------------------------------


def test_all_functions_of_fields_accept_points(scene, tmp_path):
    at = {
        "x": xr.DataArray([0.5, 2.0, 3.5], dims="point"),
        "z": xr.DataArray([0.5, 1.0, 1.5], dims="point"),
    }
    assert "3 point, points with x from 0.5 to 3.5, z from 0.5 to 1.5" in str(
        scene.cg.explain("density", at=at)
    )
    assert "y (box)" in str(scene.cg.explain("density", at=at))
    swept = scene.cg.width_sweep([0.5, 0.7, 0.9], "density", at=at)
    one = scene.cg.coarse_grain("density", at=at, width=0.7)
    np.testing.assert_array_equal(swept.density.sel(width=0.7), one.density)
    preset = scene.cg.coarse_grain(preset="pysammos", at=at)
    assert preset["sample_count"].dims == ("time", "point")
    averaged = scene.cg.coarse_grain("velocity", at=at, for_averages=True).cg.time_average()
    assert averaged.velocity.dims == ("point", "component")
    one.cg.save(tmp_path / "f.nc")
    xr.testing.assert_equal(xr.open_dataset(tmp_path / "f.nc").load().density, one.density)
    with pytest.raises(ValueError, match="to_vtu"):
        one.cg.save(tmp_path / "f.vtkhdf")


def test_a_lazy_scene_stays_lazy(scene):
    at = {a: xr.DataArray([0.5, 2.0, 3.5], dims="point") for a in "xyz"}
    lazy = scene.chunk({"time": 1}).cg.coarse_grain(["velocity", "contact_stress"], at=at)
    assert lazy.velocity.chunks is not None
    xr.testing.assert_equal(
        lazy.compute(), scene.cg.coarse_grain(["velocity", "contact_stress"], at=at)
    )


UNCOMPILED = """
import numpy as np, xarray as xr, xcg
ds = xcg.datasets.random_scene(6, seed=4)
at = {a: xr.DataArray(np.random.default_rng(k).uniform(0, 5, 12), dims="point") for k, a in enumerate("xyz")}
for rtol in (0.0, 1e-3):
    f = ds.cg.coarse_grain(["density", "kinetic_stress", "contact_stress", "sample_count"], at=at, width=0.6, rtol=rtol)
    f.to_netcdf(f"{folder}/{name}-{rtol}.nc")
"""


@pytest.mark.slow  # fields at points equal those of a mesh
def test_loops_over_points_run_uncompiled_to_the_same_bits(tmp_path):
    for name, disabled in (("compiled", "0"), ("python", "1")):
        code = f"folder, name = {str(tmp_path)!r}, {name!r}\n{UNCOMPILED}"
        subprocess.run(
            [sys.executable, "-c", code],
            check=True,
            env={**os.environ, "NUMBA_DISABLE_JIT": disabled},
        )
    for rtol in (0.0, 1e-3):
        one, other = (
            xr.open_dataset(tmp_path / f"{name}-{rtol}.nc") for name in ("compiled", "python")
        )
        for name in one.data_vars:
            if rtol == 0.0 and name == "contact_stress":  # logarithms of the C library
                np.testing.assert_allclose(other[name], one[name], rtol=1e-12, atol=1e-14)
            else:
                np.testing.assert_array_equal(other[name], one[name], name)


def test_usual_points_do_not_warn(scene):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene.cg.coarse_grain(
            "density", at={a: xr.DataArray([0.5, 2.0], dims="point") for a in "xyz"}
        )


@pytest.mark.parametrize("kind", [dict, xr.Dataset])
def test_the_history_of_points_is_one_line(scene, kind):
    at = kind({a: xr.DataArray(np.linspace(0.5, 2.0, 200), dims="point") for a in "xyz"})
    f = scene.cg.coarse_grain("density", at=at)
    assert "\n" not in f.attrs["history"].removeprefix(f"{scene.attrs.get('history')}\n")
    assert "at=dict(x=<array (200,)>, y=<array (200,)>, z=<array (200,)>)" in f.attrs["history"]
