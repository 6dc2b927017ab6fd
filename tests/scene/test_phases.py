"""Phases by clustering, by edges, by type; sizes; stress by pairs of phases."""

import pickle

import numpy as np
import pytest
import xarray as xr

import xcg
from tests.brute_force import BruteKernel, weights
from tests.scenes import random_steps, spheres
from xcg.scene.phases import MIN_SILHOUETTE

RNG = np.random.default_rng(0)


def at_rest(diameter, density=2500.0, **options):
    """Spheres of some diameters at random places."""
    position = np.random.default_rng(1).uniform(0, 1, (len(diameter), 3))
    density = np.broadcast_to(np.asarray(density, float), (len(diameter),))
    return spheres(position, diameter, density=density, velocity=np.zeros_like(position), **options)


def phases(ds, **options):
    return ds.cg.find_phases(**options).attrs["phase_values"].tolist()


@pytest.mark.parametrize(
    "diameter",
    [
        np.full(300, 0.003),
        RNG.normal(0.003, 0.00005, 1000),
        RNG.normal(0.003, 0.0003, 1000).clip(1e-4),
        RNG.uniform(0.002, 0.004, 1000),
        RNG.lognormal(-6, 0.1, 1000),
        np.random.default_rng(5).lognormal(-6, 0.6, 1000),
        np.full(300, 0.003) * (1 + 1e-7 * RNG.normal(size=300)),
    ],
    ids=[
        "monodisperse",
        "narrow normal",
        "normal",
        "uniform",
        "lognormal",
        "wide lognormal",
        "single precision",
    ],
)
def test_one_distribution_is_one_phase(diameter):
    ds = at_rest(diameter).cg.find_phases()
    assert ds.attrs["phase_values"].tolist() == [1]
    assert (ds.phase == 1).all()
    assert ds.attrs["phase_diameter"][0] == pytest.approx(diameter.mean())
    assert (np.atleast_1d(ds.attrs["phase_scores"]) < MIN_SILHOUETTE).all()


@pytest.mark.parametrize("noise", [0.0, 1e-7, 0.05])
@pytest.mark.parametrize("share", [0.5, 0.02])
def test_two_sizes_are_two_phases(noise, share):
    large = np.random.default_rng(2).random(1500) < share
    diameter = np.where(large, 0.004, 0.002) * (
        1 + noise * np.random.default_rng(3).normal(size=1500)
    )
    ds = at_rest(diameter).cg.find_phases()
    np.testing.assert_array_equal(ds.phase.values[0], 1 + large)
    np.testing.assert_allclose(ds.attrs["phase_diameter"], [0.002, 0.004], rtol=0.01)


def test_sizes_five_standard_deviations_apart_are_two_phases():
    normal = np.random.default_rng(6).normal(size=(2, 1000))
    for apart, expected in ((3, [1]), (5, [1, 2])):
        assert (
            phases(at_rest(0.003 + 1e-4 * np.concatenate([normal[0], apart + normal[1]])))
            == expected
        )


def test_threads_are_limited_once_for_all_numbers_of_clusters(monkeypatch):
    """Each time reads the list of all mapped files, which grows with the libraries of a process."""
    threadpoolctl = pytest.importorskip("threadpoolctl")
    calls = []
    limits = threadpoolctl.threadpool_limits
    monkeypatch.setattr(threadpoolctl, "threadpool_limits", lambda n: calls.append(n) or limits(n))
    assert phases(at_rest(np.repeat([0.002, 0.004, 0.006], 20))) == [1, 2, 3]
    assert calls == [1]


def test_same_size_other_density_and_three_phases():
    kind = np.random.default_rng(4).integers(0, 3, 900)
    d = np.array([0.002, 0.002, 0.005])[kind]
    rho = np.array([1000.0, 2500.0, 2500.0])[kind]
    ds = at_rest(d, rho).cg.find_phases()
    np.testing.assert_array_equal(ds.phase.values[0], 1 + kind)
    assert phases(at_rest(d, rho), max_phases=1) == [1]
    assert phases(at_rest(d, rho), max_phases=3.0, steps=1.0) == [1, 2, 3]


def test_grains_that_enter_and_leave_keep_their_phase():
    sizes = {7: 0.004, 3: 0.002, 9: 0.002, 1: 0.004, 5: 0.002}
    steps = [[3, 7, 9], [1, 3, 5, 7], [5, 9, 1]]
    position = [np.random.default_rng(0).uniform(0, 1, (len(s), 3)) for s in steps]
    ds = xcg.scene_from_arrays(
        position, particle_id=[np.array(s) for s in steps], diameter=[np.array([sizes[i] for i in s]) for s in steps],
        density=2500.0,
    )  # fmt: skip
    found = ds.cg.find_phases()
    for t in range(3):
        for i, phase in zip(found.particle_id.values[t], found.phase.values[t], strict=True):
            assert phase == (-1 if i < 0 else 1 + (sizes[int(i)] > 0.003))
    # lazy, and the same in steps that were not read
    lazy = ds.chunk(time=1).cg.find_phases(steps=2)
    assert lazy.phase.chunks is not None
    xr.testing.assert_equal(lazy.phase.compute(), found.phase)
    f = lazy.cg.coarse_grain("density", by="phase", width=0.2, bounds=dict.fromkeys("xyz", (0, 1)))
    assert f.phase.values.tolist() == ["bulk", "1", "2"]
    np.testing.assert_allclose(
        f.density.sel(phase="bulk"), f.density.sel(phase=["1", "2"]).sum("phase")
    )


def test_an_edge_beyond_all_diameters_warns():
    ds = at_rest(np.array([0.001, 0.002, 0.004]))
    for edge in (0.0005, 4.0):
        with pytest.warns(
            xcg.SceneWarning, match=r"outside the diameters that were measured, 0\.001 to 0\.004"
        ):
            phase = ds.cg.assign_phases(edges=[edge]).phase
        assert len(np.unique(phase)) == 1
    assert (
        len(np.unique(ds.cg.assign_phases(edges=[0.004]).phase)) == 2
    )  # an edge belongs to the phase above


def test_phases_by_edges_and_by_type():
    ds = at_rest(np.array([0.001, 0.002, 0.003, 0.004]), species=np.array([4, 4, 6, 9]))
    assert ds.cg.assign_phases(edges=[0.002, 0.0035]).phase.values[0].tolist() == [1, 2, 2, 3]
    mapped = ds.cg.assign_phases(mapping={4: 1, 6: 2, 9: 1})
    assert mapped.phase.values[0].tolist() == [1, 1, 2, 1]
    assert mapped.attrs["phase_values"].tolist() == [1, 2]
    with pytest.raises(xcg.SceneError, match=r"lacks species=\[9\]"):
        ds.cg.assign_phases(mapping={4: 1, 6: 2})
    for options, message in (
        ({}, "one of edges"),
        ({"edges": [2, 1]}, "that rise"),
        ({"mapping": {}}, "expected whole numbers"),
        ({"mapping": {1: 1, 2: 1.5}}, "expected whole numbers"),
        ({"mapping": {"a": 1}}, "expected whole numbers"),
        ({"mapping": {1: 2**63}}, "expected whole numbers of 64 bits"),
        ({"mapping": {-(2**63) - 1: 1}}, "expected whole numbers of 64 bits"),
        ({"edges": [0.004], "by": "nonexistent"}, "by='nonexistent': edges= are between diameters"),
    ):
        with pytest.raises(ValueError, match=message):
            ds.cg.assign_phases(**options)
    with pytest.raises(ValueError, match="max_phases=0"):
        ds.cg.find_phases(0)
    with pytest.raises(xcg.SceneError, match="no grains"):
        at_rest(np.zeros(0)).cg.find_phases()


def test_plot_of_clusters_and_scores():
    pytest.importorskip("matplotlib").use("Agg")
    import matplotlib.pyplot as plt

    figure = at_rest(np.repeat([0.002, 0.004], 50)).cg.find_phases().cg.plot_phases()
    left, right = figure.axes
    assert [t.get_text() for t in left.get_legend().get_texts()] == ["1", "2"]
    assert right.get_ylabel() == "mean silhouette"
    assert left.get_xlabel() == "diameter [m]"
    assert (
        left.get_ylabel().replace("\n", " ") == "density of the particle's material [kg m$^{-3}$]"
    )
    assert right.lines[0].get_xydata()[0].tolist() == [2.0, 1.0]
    with pytest.raises(
        ValueError, match="index=1: expected the position of a step, a whole number from -1 to 0"
    ):
        at_rest(np.repeat([0.002, 0.004], 50)).cg.find_phases().cg.plot_phases(index=1)
    plt.close(figure)


# --- pairs -----------------------------------------------------------------------------------------------


def test_stress_by_pairs_adds_up_and_is_right_for_one_pair():
    ds = xcg.datasets.random_scene(150, periodic="xy", seed=7)
    f = ds.cg.coarse_grain(["contact_stress"], by="species", by_pair=True, width=0.8)
    pair = f.contact_stress_by_pair
    assert pair.dims[-4:] == ("phase", "other_phase", "component", "direction")
    assert pair.other_phase.values.tolist() == ["1", "2", "wall"]
    scale = float(np.abs(f.contact_stress).max())
    np.testing.assert_allclose(pair.sum("other_phase"), f.contact_stress, atol=1e-12 * scale)
    for phase in ("1", "2"):
        whole = pair.sel(phase="bulk", other_phase=phase)
        np.testing.assert_allclose(
            whole, pair.sel(phase=["1", "2"], other_phase=phase).sum("phase"), atol=1e-12 * scale
        )
    assert float(np.abs(pair.sel(other_phase="wall")).max()) > 0
    # one contact between unlike grains: each phase keeps its own side
    one = xcg.scene_from_arrays(
        [[0.0, 0, 0], [1.5, 0, 0]], velocity=np.zeros((2, 3)), diameter=[1.0, 2.0], density=1.0, species=[1, 2],
        contact_i=[0], contact_j=[1], contact_force=[[-2.0, 0, 0]],
    )  # fmt: skip
    at = {"x": 0.25, "y": 0.3, "z": 0.0}
    got = one.cg.coarse_grain(
        "density", by="species", by_pair=True, axes="", at=at, width=0.75
    ).contact_stress_by_pair
    kernel = BruteKernel("lucy", 0.75)
    r = np.array([0.25, 0.3, 0.0])
    point = np.array([0.5, 0, 0])
    sides = {
        "1": kernel.segment(r, np.zeros(3), point) * 1.0,
        "2": kernel.segment(r, np.array([1.5, 0, 0]), point) * 2.0,
    }
    for phase, other in (("1", "2"), ("2", "1")):
        value = got.sel(phase=phase, other_phase=other, component="x", direction="x").item()
        assert value == pytest.approx(sides[phase], rel=1e-12)
        assert float(np.abs(got.sel(phase=phase, other_phase=phase)).max()) == 0
    with pytest.raises(ValueError, match="name their variable, such as by="):
        one.cg.coarse_grain("density", by_pair=True, width=0.75)


# --- phases on each other --------------------------------------------------------------------------------

EXCHANGE = ["interphase_force", "segregation_flux", "concentration", "void_fraction"]


PLACES = [
    ({"periodic": "xy"}, "xyz"), ({"periodic": "xy"}, "xz"), ({"periodic": "xy", "edge": 3.0}, "z"), ({}, ""),
    ({"dimension": 2, "periodic": "x"}, "xy"), ({"dimension": 2, "periodic": "x"}, "y"),
]  # fmt: skip


@pytest.mark.parametrize(("scene", "axes"), PLACES)
def test_exchange_between_phases_equals_brute_force(scene, axes):
    ds = xcg.datasets.random_scene(60, seed=11, **scene)
    extent = {a: 4.0 for a in ds.attrs["plane"] if a not in axes and a not in ds.attrs["periodic"]}
    f = ds.cg.coarse_grain(EXCHANGE, by="species", axes=axes, width=0.8, spacing=0.9, extent=extent)
    kernel = BruteKernel("lucy", 0.8, ds.attrs["dimension"], len(axes)) if axes else None
    frame = {name: ds[name].to_numpy()[0] for name in ds.data_vars}
    species = frame["species"]
    grains, contacts = (
        weights(ds, kernel, f, frame[name], extent) for name in ("position", "contact_point")
    )
    i = frame["contact_i"]
    j = frame["contact_j"]
    phases = {"bulk": (1, 2), "1": (1,), "2": (2,)}
    of = dict(zip(frame["particle_id"].tolist(), species.tolist(), strict=True))
    side_i, side_j = (np.array([of.get(k, "wall") for k in ids.tolist()], object) for ids in (i, j))
    nodes = grains.shape[0]
    rho, volume = (grains * frame[name] for name in ("mass", "volume"))
    total = rho.sum(1)[:, None]
    velocity = rho @ frame["velocity"] / np.where(total > 0, total, np.inf)
    for phase, members in phases.items():
        g = f.sel(phase=phase)
        own = np.isin(species, members)
        for other in ("1", "2", "wall"):
            partner = "wall" if other == "wall" else int(other)
            force = np.zeros((nodes, 3))
            for one, two, sign in ((side_i, side_j, 1.0), (side_j, side_i, -1.0)):
                acts = np.isin(one.astype(str), [str(m) for m in members]) & (two == partner)
                force += sign * (contacts[:, acts] @ frame["contact_force"][acts])
            close(
                g.interphase_force.sel(other_phase=other),
                force,
                float(abs(f.interphase_force).max()),
            )
        flux = rho[:, own] @ frame["velocity"][own] - rho[:, own].sum(1)[:, None] * velocity
        close(
            g.segregation_flux,
            np.where(rho.sum(1)[:, None] > 0, flux, 0.0),
            float(abs(rho).sum(1).max()),
        )
        phi = volume[:, own].sum(1)
        total = volume.sum(1)
        close(g.void_fraction, 1 - phi, 1.0)
        with np.errstate(invalid="ignore"):
            close(g.concentration, np.where(total > 0, phi / total, np.nan), 1.0)


def close(found, expected, scale):
    np.testing.assert_allclose(
        found.to_numpy()[0].reshape(expected.shape), expected, rtol=0, atol=1e-12 * scale
    )


def test_forces_between_phases_have_the_kernel_of_the_phase_they_act_on():
    ds = xcg.datasets.random_scene(150, periodic="xy", seed=7)
    place = {"spacing": 0.4, "axes": "z", "bounds": {"z": (0.0, 4.0)}, "by": "species"}
    own = ds.cg.coarse_grain("interphase_force", width={1: 0.4, 2: 0.9}, **place)
    for phase, width in (("1", 0.4), ("2", 0.9)):
        same = ds.cg.coarse_grain("interphase_force", width=width, **place).interphase_force.sel(
            phase=phase
        )
        np.testing.assert_allclose(
            own.interphase_force.sel(phase=phase), same, atol=1e-12 * float(abs(same).max())
        )


def test_segregation_flux_keeps_its_digits_in_a_fast_frame():
    ds = xcg.datasets.random_scene(150, seed=7)
    fast = ds.assign(velocity=ds.velocity + 1e6)
    one, other = (
        d.cg.coarse_grain("segregation_flux", by="species", width=0.8).segregation_flux
        for d in (ds, fast)
    )
    np.testing.assert_allclose(other, one, atol=1e-8 * float(abs(one).max()))


def test_pairs_of_phases_need_phases():
    with pytest.raises(ValueError, match="interphase_force needs the argument by="):
        xcg.datasets.random_scene(20).cg.coarse_grain("interphase_force")


def test_averages_of_concentrations_are_ratios_of_averages():
    ds = random_steps(4)
    f = ds.cg.coarse_grain(
        ["concentration", "volume_fraction", "void_fraction"], by="species", width=0.8
    )
    mean = f.cg.time_average()
    phi = f.volume_fraction.mean("time")
    bulk = phi.sel(phase="bulk", drop=True)
    xr.testing.assert_allclose(
        mean.concentration, (phi / bulk.where(bulk > 0)).transpose(*mean.concentration.dims)
    )
    xr.testing.assert_allclose(mean.void_fraction, 1 - phi)
    with pytest.raises(ValueError, match="choose phases after it"):
        f.sel(phase=[1]).cg.time_average()
    with pytest.raises(ValueError, match="choose phases after it"):
        f.sel(phase=1).cg.time_average()
    assert float(f.sel(phase="bulk").cg.time_average().concentration.max()) == 1.0


# --- sizes -----------------------------------------------------------------------------------------------


def test_size_statistics_of_each_step():
    steps = [np.array([1.0, 2.0, 2.0]), np.array([3.0]), np.array([1.0, 1.0, 1.0, 4.0])]
    density = [np.array([1000.0, 1.0, 1.0]), np.array([1.0]), np.full(4, 1.0)]
    mass = [rho * d**3 for rho, d in zip(density, steps, strict=True)]
    ds = xcg.scene_from_arrays(
        [np.arange(3.0 * len(d)).reshape(-1, 3) for d in steps], diameter=steps, mass=mass
    )
    lazy = ds.chunk(time=1, particle=2).cg.size_statistics()
    assert lazy.d43.chunks is not None
    for s in (ds.cg.size_statistics(), lazy.compute()):
        for t, d in enumerate(steps):
            row = s.isel(time=t)
            assert row.d43.item() == pytest.approx((d**4).sum() / (d**3).sum())
            assert row.d32.item() == pytest.approx((d**3).sum() / (d**2).sum())
            assert row.drms.item() == pytest.approx(np.sqrt((d**2).mean()))
            assert (row.dmin.item(), row.dmax.item()) == (d.min(), d.max())
        # by mass, not by volume: the heavy small grain outweighs the large ones
        assert s.d50.values.tolist() == [1.0, 3.0, 4.0]
    assert s.d43.attrs["units"] == "m"
    assert np.isnan(at_rest(np.zeros(0)).cg.size_statistics().d43).all()


def test_phases_are_found_by_number_and_by_text(tmp_path):
    ds = random_steps(2)
    f = ds.cg.coarse_grain(
        ["density", "velocity", "contact_stress_by_pair"], axes="z", by="species", by_pair=True
    )
    mean = f[["density", "velocity"]].cg.time_average()
    packing = ds.cg.microstructure("coordination_number", by="species")
    for g in (
        f,
        mean,
        f.isel(phase=[0, 2, 1]),
        f * 2.0,
        f.chunk(phase=1),
        pickle.loads(pickle.dumps(f)),
        packing,
    ):
        for number in (2, np.int64(2)):
            xr.testing.assert_identical(g.sel(phase=number), g.sel(phase="2"))
        xr.testing.assert_identical(g.sel(phase=[2, 1]), g.sel(phase=["2", "1"]))
        xr.testing.assert_identical(g.sel(phase=slice(1, 2)), g.sel(phase=slice("1", "2")))
        assert g.sel(phase="bulk").phase.item() == "bulk"
        for unknown in (3, "3", True):
            with pytest.raises(KeyError):
                g.sel(phase=unknown)
    by_pair = f.contact_stress_by_pair
    assert by_pair.sel(phase=1, other_phase=2).equals(by_pair.sel(phase="1", other_phase="2"))
    assert by_pair.sel(phase=1, other_phase="wall").other_phase.item() == "wall"
    for suffix, reopen in (("nc", xr.open_dataset), ("zarr", xr.open_zarr)):
        again = reopen(f.cg.save(tmp_path / f"f.{suffix}"))
        xr.testing.assert_equal(again, f)
        assert again.phase.values.tolist() == ["bulk", "1", "2"]
        xr.testing.assert_equal(
            (f - again).sel(phase=1), f.sel(phase=1) - again.sel(phase="1")
        )  # they align
        total = again.isel(phase=[2, 1]) + f
        xr.testing.assert_equal(total.sel(phase=["1", "2"]), f.sel(phase=[1, 2]) * 2.0)


def test_few_grains_of_two_sizes_are_two_phases():
    diameter = [1.0, 1.01, 0.99, 1.02, 2.0, 2.02, 1.98, 2.01]
    ds = xcg.scene_from_arrays(np.arange(24.0).reshape(8, 3), diameter=diameter, density=1.0)
    assert np.atleast_1d(ds.cg.find_phases().attrs["phase_values"]).tolist() == [1, 2]


def test_groups_may_be_an_array_of_whole_numbers():
    ds = xcg.datasets.random_scene(50)
    f = ds.cg.coarse_grain("density", axes="z", by="species", groups=np.array([2, 1]), width=1.0)
    assert f.phase.values.tolist() == ["bulk", "1", "2"]
    with pytest.raises(ValueError, match="expected whole numbers"):
        ds.cg.coarse_grain("density", axes="z", by="species", groups=[1.5], width=1.0)
