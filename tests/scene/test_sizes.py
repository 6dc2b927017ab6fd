"""Sizes and extent that were measured count only while they hold for the particles."""

import dask.array as da
import numpy as np
import pytest
import xarray as xr

import xcg
from xcg.scene.scene import Scene
from xcg.scene.sizes import sizes_of

AXES = ("x", "y", "z")


@pytest.fixture
def ds():
    rng = np.random.default_rng(3)
    position = rng.uniform(0, [4, 2, 1], (3, 40, 3))
    diameter = rng.uniform(0.5, 1.0, (3, 40))
    species = np.tile(np.repeat([1, 2], 20), (3, 1))
    return xcg.scene_from_arrays(position, diameter=diameter, density=2.0, species=species)


def mass_in(f):
    """Mass under the density, which is all that there is if no support is cut off."""
    cell = np.prod([f[a].diff(a).values[0] for a in AXES])
    return f.density.sum(AXES).values * cell


def moved(ds, by):
    return ds.assign(position=ds.position + by)


def turned(ds):
    around = xr.DataArray([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]], dims=("component", "other"))
    rotated = (ds.position.rename(component="other") * around).sum("other", min_count=3)
    return ds.assign(position=rotated.transpose("time", "particle", "component"))


@pytest.mark.parametrize("change", [lambda ds: moved(ds, -100), lambda ds: moved(ds, 0.8), turned])
def test_bounds_follow_positions_in_memory(ds, change):
    options = {"width": 0.3, "spacing": 0.1}
    as_it_was = ds.cg.coarse_grain("density", **options)
    f = change(ds).cg.coarse_grain("density", **options)
    mass = ds.mass.sum("particle").values
    np.testing.assert_allclose(mass_in(as_it_was)[[0, -1]], mass[[0, -1]], rtol=2e-3)
    np.testing.assert_allclose(mass_in(f)[[0, -1]], mass[[0, -1]], rtol=2e-3)


def test_changed_lazy_positions_need_bounds_or_measure(ds):
    lazy = moved(ds.chunk(time=1), -100)
    with pytest.raises(ValueError, match=r"no longer, as positions were changed.*measure\(\)"):
        lazy.cg.coarse_grain("density")
    f = lazy.cg.measure().cg.coarse_grain("density", width=0.3, spacing=0.1).compute()
    np.testing.assert_allclose(mass_in(f), ds.mass.sum("particle").values, rtol=2e-3)
    lazy.cg.coarse_grain("density", bounds=dict.fromkeys(AXES, (-100, -99)))


def test_a_box_does_not_follow_lazy_positions_that_were_changed(ds):
    """Along open axes it gave the mesh, far from all grains; along periodic ones images are in it."""
    lazy = ds.chunk(time=1).assign(
        box=(("time", "component", "bound"), np.tile([-1.0, 5.0], (ds.sizes["time"], 3, 1)))
    )
    with pytest.raises(ValueError, match=r"axis 'x' has no bounds.*measure\(\)"):
        moved(lazy, -100).cg.coarse_grain("density")
    f = moved(lazy.assign_attrs(periodic="xyz"), -100).cg.coarse_grain("density")
    assert float(f.density.isel(time=0).mean()) > 0


def test_replaced_positions_with_old_attributes_warn(ds):
    """`copy(data=...)` keeps all marks: the mesh is the old one, and the sums are not zero in silence."""
    lazy = ds.chunk(time=1)
    f = lazy.assign(position=lazy.position.copy(data=lazy.position.data - 100)).cg.coarse_grain(
        "density"
    )
    with pytest.warns(xcg.SceneWarning, match="no grain reaches any node"):
        assert float(f.density.sum()) == 0.0


@pytest.mark.parametrize(
    "select",
    [
        lambda ds: ds.isel(time=[1]), lambda ds: ds.isel(particle=slice(None, None, -1)), lambda ds: ds.chunk(time=2),
        lambda ds: ds.sel(time=slice(0, 1)), lambda ds: ds.assign_attrs(a=1).persist(), lambda ds: ds.copy(),
    ],
)  # fmt: skip
def test_selections_keep_the_mesh_of_the_series(ds, select):
    lazy = ds.chunk(time=1)
    whole, part = (
        x.cg.coarse_grain("density", axes="x", extent={"y": 1, "z": 1})
        for x in (lazy, select(lazy))
    )
    assert part.x.equals(whole.x)


def test_in_memory_a_part_of_the_scene_keeps_the_mesh(ds):
    part = ds.isel(particle=slice(5))
    assert (
        part.cg.explain("density", spacing=0.2).nodes.shape
        == ds.cg.explain("density", spacing=0.2).nodes.shape
    )
    assert part.cg.explain("density").kernel.width == ds.cg.explain("density").kernel.width


def test_width_follows_diameters(ds):
    larger = ds.assign(diameter=3 * ds.diameter)
    assert larger.cg.explain("density").kernel.width == pytest.approx(
        3 * ds.isel(time=[0, -1]).cg.measure().cg.explain("density").kernel.width
    )
    lazy = ds.chunk(time=1).assign(diameter=3 * ds.chunk(time=1).diameter)
    with pytest.raises(
        ValueError, match=r"'d43', which the scene does not hold, or no longer, as diameters"
    ):
        lazy.cg.explain("density")
    assert lazy.cg.explain("density", width=1.0).kernel.width == 1.0
    assert (
        lazy.cg.measure().cg.explain("density").kernel.width
        > 2 * ds.cg.explain("density").kernel.width
    )


def test_measures_are_kept_in_files(ds, tmp_path):
    ds.to_netcdf(tmp_path / "ds.nc")
    for chunks in ({"time": 1}, None):
        with xr.open_dataset(tmp_path / "ds.nc", chunks=chunks) as again:
            assert again.cg.explain("density").nodes.shape == ds.cg.explain("density").nodes.shape


def test_changed_groups_need_measure(ds):
    lazy = ds.chunk(time=1)
    assert lazy.cg.explain("density", by="species").groups == (1, 2)
    with pytest.raises(ValueError, match="not known without reading"):
        lazy.assign(species=lazy.species + 1).cg.explain("density", by="species")


def test_messages_about_changed_positions_read_no_data(ds):
    def refuse(block):
        msg = "read"
        raise AssertionError(msg)

    lazy = ds.chunk(time=1)
    unread = lazy.assign(
        position=(lazy.position.dims, da.map_blocks(refuse, lazy.position.data, dtype=float))
    )
    with pytest.raises(ValueError, match="as positions were changed"):
        unread.cg.explain("density")


def test_sizes_stay_where_only_places_were_changed(ds):
    frames = [xcg.Rotated(z=(1, 1, 3)), xcg.Cylindrical("z")]
    width = ds.cg.explain("density").kernel.width
    middle = ds.isel(time=[0, -1]).cg.measure().cg.explain("density").kernel.width
    assert abs(middle / width - 1) > 1e-3  # sizes of the first and last step are not those of all
    for scene in (ds, ds.chunk(time=1), ds.isel(time=[1]), moved(ds, -0.8)):
        assert (
            scene.cg.explain("density", axes="", at=dict.fromkeys(AXES, 0.0)).kernel.width == width
        )
        f = scene.cg.coarse_grain(
            "density", axes="x", at={"y": 0.0, "z": 0.0}, frame=frames[0], bounds={"x": (0, 1)}
        )
        assert f.attrs["width"] == width
        assert f.attrs["size_diameter"] == ds.attrs["d43"]
        f = scene.cg.coarse_grain(
            "density", axes="r", at={"z": 0.0}, frame=frames[1], bounds={"r": (0, 1)}
        )
        assert f.attrs["width"] == width


@pytest.mark.parametrize("weighed", [True, False])
def test_half_of_the_mass_lies_in_grains_up_to_d50(weighed):
    rng = np.random.default_rng(3)
    diameter = rng.uniform(1.0, 3.0, 40)
    mass = rng.uniform(0.5, 2.0, 40)
    share = mass if weighed else diameter**3
    up_to = np.array([share[diameter <= d].sum() for d in diameter])
    expected = diameter[up_to >= 0.5 * share.sum()].min()
    assert sizes_of(diameter, mass if weighed else None)["d50"] == expected


@pytest.mark.parametrize("count", [4000, 5000, 50_000])
@pytest.mark.parametrize(
    "draw",
    [
        lambda rng, count: rng.uniform(0.9, 1.1, count),
        lambda rng, count: rng.lognormal(0.0, 2.0, count),
        lambda rng, count: rng.choice([1.0, 2.0, 5.0], count),
        lambda rng, count: np.full(count, 0.3),
        lambda rng, count: 1.0 + 1e-15 * rng.integers(0, 9, count),
    ],
    ids=["uniform", "wide", "three sizes", "one size", "rounding apart"],
)
@pytest.mark.parametrize("weights", ["drawn", "cubes", "zero"])
def test_d50_of_many_grains_is_that_of_all_of_them_in_order(count, draw, weights):
    rng = np.random.default_rng(count)
    diameter = draw(rng, count)
    mass = {"drawn": rng.uniform(0.5, 2.0, count), "zero": np.zeros(count)}.get(weights)
    order = np.argsort(diameter)
    share = np.cumsum((diameter**3 if mass is None else mass)[order])
    expected = diameter[order][np.searchsorted(share, 0.5 * share[-1])]
    assert sizes_of(diameter, mass)["d50"] == expected


def test_measure_reads_a_step_at_a_time_and_no_velocities(ds):
    read = []

    def positions(block, block_info=None):
        read.append(block_info[0]["chunk-location"][0])
        return block

    def refuse(block):
        raise AssertionError("velocities are not measured")

    lazy = ds.chunk(time=1)
    watched = da.map_blocks(positions, lazy.position.data, dtype=float, meta=np.empty((0, 0, 0)))
    unread = da.map_blocks(refuse, lazy.position.data, dtype=float, meta=np.empty((0, 0, 0)))
    lazy = lazy.assign(
        position=(lazy.position.dims, watched), velocity=(lazy.position.dims, unread)
    )
    measured = lazy.cg.measure()
    assert read == [0, 1, 2]
    for end in ("particle_lower", "particle_upper", "d43", "d50", "species_values"):
        np.testing.assert_array_equal(measured.attrs[end], ds.cg.measure().attrs[end])
    np.testing.assert_array_equal(measured.particle_lower, ds.position.min(("time", "particle")))


def test_sizes_of_whole_numbers_count_each_particle(ds):
    diameter = xr.full_like(ds.diameter, 1).astype(int)
    diameter[:, 0] = 9
    sizes = xcg.scene_from_arrays(ds.position.values, diameter=diameter.values, density=1.0).attrs
    assigned = Scene(ds.assign(diameter=diameter)).measures
    for name in ("d43", "d32", "drms", "dmin", "dmax"):
        np.testing.assert_allclose(assigned[name], sizes[name], rtol=1e-12)
