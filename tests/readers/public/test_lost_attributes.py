"""Scenes and results whose attributes xarray dropped, or that it joined of parts with different ones."""

import numpy as np
import pytest
import xarray as xr

import xcg
from xcg.scene.facts import with_setup

MESH = {"width": 1.0, "axes": "z", "bounds": {"z": (0.0, 4.5)}, "spacing": 0.5}
NUMBERS = ["density", "stress", "friction_coefficient"]


def lattice(time=0.0, **options):
    """Grains of mass 1 at unit distances, in a periodic box of 125: the density is 1 everywhere."""
    axis = np.arange(5) + 0.5
    position = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    box = dict.fromkeys("xyz", (0.0, 5.0))
    return xcg.scene_from_arrays(
        position,
        diameter=np.ones(125),
        mass=np.ones(125),
        velocity=position[:, [2, 0, 1]] + 0.1 * np.sin(7 * position),
        time=[time],
        **({"box": box, "periodic": "xyz", "gravity": (0.0, 0.0, -9.81)} | options),
    )


def from_variables(ds):
    return xr.Dataset({name: ds[name] for name in ds.data_vars})


def from_numbers(ds):
    return xr.Dataset({name: (values.dims, values.data) for name, values in ds.data_vars.items()})


LOST = {
    "Dataset": from_variables,
    "drop_attrs(deep=False)": lambda ds: ds.drop_attrs(deep=False),
    "concat": lambda ds: xr.concat(
        [ds, ds.assign_coords(time=ds.time + 1)], "time", data_vars="all", combine_attrs="drop"
    ),
    "merge": lambda ds: xr.merge(
        [ds[["position", "particle_id"]], ds.drop_vars("position")], combine_attrs="override"
    ),
    "step": lambda ds: from_variables(ds.isel(time=0)),
    "chunks": lambda ds: ds.drop_attrs(deep=False).chunk(time=1),
}


@pytest.mark.parametrize("way", LOST)
def test_a_scene_without_attributes_keeps_its_periodic_axes(way):
    f = LOST[way](lattice()).cg.coarse_grain("density", **MESH)
    np.testing.assert_allclose(f.density, 1.0, rtol=1e-2)
    assert f.attrs["periodic"] == "xyz"
    assert list(f.attrs["gravity"]) == [0.0, 0.0, -9.81]


def test_a_layer_without_attributes_stays_one():
    ds = xcg.scene_from_arrays(
        [[0.5, 0.5, 0.0], [1.5, 0.5, 0.0]],
        diameter=[1.0, 1.0],
        density=1.0,
        shape="disc",
        thickness=0.25,
        dimension=2,
        box={"x": (0.0, 2.0), "y": (0.0, 1.0)},
        periodic="xy",
    )
    f = from_variables(ds).cg.coarse_grain("volume_fraction", axes="", width=3.0)
    np.testing.assert_allclose(f.volume_fraction, np.pi / 4, rtol=1e-12)


def test_a_saved_scene_without_attributes_keeps_its_periodic_axes(tmp_path):
    for name in ("scene.nc", "scene.zarr"):
        ds = xcg.open_scene(str(xcg.save(lattice(), tmp_path / name)))
        np.testing.assert_allclose(
            ds.drop_attrs(deep=False).cg.coarse_grain("density", **MESH).density, 1.0, rtol=1e-2
        )


@pytest.mark.parametrize("call", ["coarse_grain", "find_contacts", "measure"])
def test_a_scene_of_bare_numbers_is_refused(call):
    with pytest.raises(
        xcg.SceneError, match=r"lost its attributes periodic, dimension, .*ds\.attrs"
    ):
        getattr(from_numbers(lattice()).cg, call)()


def test_attributes_that_were_given_are_a_scene():
    bare = from_numbers(lattice()).assign_attrs(periodic="xyz", dimension=3)
    np.testing.assert_allclose(bare.cg.coarse_grain("density", **MESH).density, 1.0, rtol=1e-2)


def test_attributes_that_were_changed_count():
    ds = lattice()
    expected = lattice(periodic="").cg.coarse_grain("density", **MESH)
    changed = ds.assign_attrs(periodic="").cg.coarse_grain("density", **MESH)
    np.testing.assert_array_equal(changed.density, expected.density)


@pytest.mark.filterwarnings("ignore:In a future version of xarray:FutureWarning")
@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"periodic": "xy"}, 'periodic is "xyz" and "xy"'),
        ({"periodic": ""}, 'periodic is "xyz" and ""'),
        ({"gravity": (0, 1, 0)}, "gravity is"),
        ({"dimension": 2, "thickness": 5.0}, "dimension is 3 and 2.*thickness is not given and 5"),
        ({"units": "reduced"}, 'unit_system is "SI" and "reduced"'),
    ],
)
@pytest.mark.parametrize("combine_attrs", ["override", "drop", "drop_conflicts"])
def test_joined_scenes_that_differ_are_refused(options, named, combine_attrs):
    parts = [lattice(), lattice(1.0, **options)]
    both = xr.concat(parts, "time", data_vars="all", combine_attrs=combine_attrs)
    with pytest.raises(xcg.SceneError, match=named):
        both.cg.coarse_grain("density", **MESH)
    with pytest.raises(xcg.SceneError, match=named):
        both.chunk(time=1).cg.coarse_grain("density", **MESH)


@pytest.mark.parametrize("new_defaults", [True, False])
def test_joined_scenes_that_differ_are_refused_where_xarray_compares(new_defaults):
    """As docs/reading.md says, whatever the defaults of xarray are."""
    parts = [lattice(), lattice(1.0, periodic="xy")]
    with xr.set_options(use_new_combine_kwarg_defaults=new_defaults):
        both = xr.concat(parts, "time", data_vars="all", coords="different", compat="equals")
        with pytest.raises(xr.MergeError, match="setup"):
            xr.merge([lattice()[["mass"]], lattice(periodic="")[["box"]]], compat="no_conflicts")
    with pytest.raises(xcg.SceneError, match='periodic is "xyz" and "xy"'):
        both.cg.coarse_grain("density", **MESH)


# --- results ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scenes():
    return [
        xcg.datasets.random_scene(200, seed=1, periodic="xyz").assign_coords(time=[float(k)])
        for k in range(2)
    ]


ASKED = {"width": 1.0, "axes": "z", "bounds": {"z": (0.0, 4.0)}, "for_averages": True}
VARIANT = {"pressure_dims": "z", "shear_dims": "xz", "size": "d32"}


def result(ds, **options):
    return ds.cg.coarse_grain(["friction_coefficient", "inertial_number"], **(ASKED | options))


@pytest.mark.parametrize("average", ["time_average", "profile"])
@pytest.mark.parametrize("way", ["Dataset", "drop_attrs(deep=False)", "concat", "merge"])
def test_a_result_without_attributes_is_averaged_with_its_options(scenes, way, average):
    ways = {**LOST, "merge": lambda f: xr.merge([f[[name]] for name in f])}
    f = result(scenes[0], **VARIANT)
    arguments = ("z",) if average == "profile" else ()
    kept = getattr(f.cg, average)(*arguments)
    lost = getattr(ways[way](f).cg, average)(*arguments)
    other = getattr(result(scenes[0]).cg, average)(*arguments)
    for name in ("friction_coefficient", "inertial_number"):
        np.testing.assert_allclose(
            lost[name].values.ravel()[: kept[name].size], kept[name].values.ravel(), rtol=1e-12
        )
        assert not np.allclose(other[name], kept[name], rtol=1e-2)


def test_a_result_of_bare_numbers_is_averaged_as_far_as_no_option_matters(scenes):
    f = from_numbers(result(scenes[0]))
    with pytest.raises(xcg.SceneError, match=r"lost its attributes plane, .*friction_coefficient"):
        f.cg.time_average()
    density = f[["density"]].cg.time_average().density
    np.testing.assert_array_equal(density, f.density.isel(time=0))


def test_correlations_need_the_axes_that_wrap_around(scenes):
    f = scenes[0].cg.coarse_grain("density", axes="z", width=1.0)
    kept = f.cg.spatial_correlation("density")
    lost = f.drop_attrs(deep=False).cg.spatial_correlation("density")
    np.testing.assert_array_equal(lost.correlation, kept.correlation)
    with pytest.raises(xcg.SceneError, match="lost its attributes wrapped_axes"):
        f.drop_attrs(deep=False).drop_vars("setup").cg.spatial_correlation("density")


def test_slopes_of_surfaces_keep_the_support_of_the_kernel_in_their_errors():
    surface = xcg.datasets.random_scene(400, seed=1, periodic="xy").cg.coarse_grain(
        "volume_fraction", axes="xz", width=1.0
    )
    surface = surface.cg.free_surface("z")
    kept = surface.cg.fit_slope().slope_error
    for lost in (surface.drop_attrs(deep=False), from_variables(surface), surface.height):
        np.testing.assert_array_equal(xcg.fit_slope(lost).slope_error, kept)
    with pytest.raises(xcg.SceneError, match=r"lost its attributes cutoff.*heights alone"):
        surface.drop_attrs().drop_vars("setup").cg.fit_slope()
    with pytest.raises(xcg.SceneError, match="lost its attributes periodic"):
        surface.drop_attrs().cg.fit_slope()


@pytest.mark.filterwarnings("ignore:In a future version of xarray:FutureWarning")
@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"width": 1.2, "spacing": 1.0}, r"width is 1\.0 and 1\.2"),
        ({"kernel": "gaussian"}, 'kernel is "lucy" and "gaussian"'),
        ({"gradient": "kernel"}, 'gradient is "least_squares" and "kernel"'),
        ({"temperature": "biased"}, 'temperature is "unbiased" and "biased"'),
        ({"pressure_dims": "z"}, 'pressure_dims is "xyz" and "z"'),
        ({"shear_dims": "xz"}, 'shear_dims is not given and "xz"'),
        ({"size": "dmax"}, 'size is "d43" and "dmax"'),
        ({"deviatoric": "stress"}, 'deviatoric is "both" and "stress"'),
        ({"extent": {"x": 1.0}}, "extent is not given and"),
        (
            {"surfaces": [xcg.Plane((0, 0, 0), (0, 0, 1))], "per": "accessible"},
            "per is not given and",
        ),
    ],
)
def test_joined_results_that_differ_are_refused(scenes, options, named):
    names = ["friction_coefficient", "inertial_number"]
    parts = [result(scenes[0], spacing=1.0), result(scenes[1], **({"spacing": 1.0} | options))]
    fields = [name for name in parts[0] if name in parts[1]]
    for combine_attrs in ("override", "drop", "drop_conflicts"):
        both = xr.concat([f[fields] for f in parts], "time", combine_attrs=combine_attrs)
        for lazy in (both, both.chunk(time=1)):
            with pytest.raises(xcg.SceneError, match=named):
                lazy.cg.time_average()
            with pytest.raises(xcg.SceneError, match=named):
                lazy.cg.profile("z")
    with pytest.raises(xr.MergeError, match=r"setup|width"):
        xr.merge([parts[0][names], parts[1][["density"]]], join="override")


@pytest.mark.filterwarnings("ignore:In a future version of xarray:FutureWarning")
def test_joined_results_of_other_periodic_axes_are_refused():
    parts = [lattice(), lattice(1.0, periodic="z")]
    both = xr.concat([ds.cg.coarse_grain("density", **MESH) for ds in parts], "time")
    with pytest.raises(xcg.SceneError, match='periodic is "xyz" and "z"'):
        both.cg.time_average()


def test_joined_results_of_one_kind_are_averaged(scenes):
    both = xr.concat([result(ds, **VARIANT) for ds in scenes], "time", combine_attrs="drop")
    mean = both.cg.time_average().friction_coefficient
    alone = result(scenes[0], **VARIANT).cg.time_average().friction_coefficient
    np.testing.assert_allclose(mean, alone, rtol=1e-12)  # both steps are the same grains


def test_chains_without_attributes_are_refused():
    ds = xcg.datasets.random_scene(200, seed=1, periodic="xyz")
    chains = ds.cg.force_chains()
    with pytest.raises(xcg.SceneError, match="lost its attributes periodic, dimension, min_length"):
        chains.drop_attrs().cg.chain_table()


@pytest.mark.parametrize("sampling", ["node", "cell"])
def test_results_of_earlier_versions_open_and_are_averaged(scenes, tmp_path, sampling):
    """They name how they were sampled."""
    f = result(scenes[0], spacing=1.0)
    earlier = with_setup(f.assign_attrs(sampling=sampling))
    earlier.to_netcdf(tmp_path / "earlier.nc")
    with xr.open_dataset(tmp_path / "earlier.nc") as opened:
        assert opened.attrs["sampling"] == sampling
        averages = opened.drop_attrs(deep=False).cg.time_average()
        xr.testing.assert_equal(averages.drop_vars("setup"), f.cg.time_average().drop_vars("setup"))
