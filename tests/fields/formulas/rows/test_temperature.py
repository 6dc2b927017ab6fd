"""Granular temperature: what independent velocities leave, brute force over grains, gases of known temperature."""

import itertools
import re
import warnings

import numpy as np
import pytest
import xarray as xr

import xcg
from tests import truths
from tests.brute_force import BruteKernel

NAMES = ["granular_temperature", "directional_temperature", "fluctuation_density", "fluctuation_stress", "density",
         "sample_count"]  # fmt: skip


def random_gas(count, length, seed, *, spread=1.0, periodic="xyz", steps=1):
    """Grains anywhere in a box, with independent velocities of temperature 1 in shear; overlaps do not matter."""
    rng = np.random.default_rng(seed)
    position = rng.uniform(0, length, (steps, count, 3))
    diameter = rng.uniform(1 / spread, spread, (steps, count))
    velocity = rng.normal(size=(steps, count, 3))
    species = rng.integers(1, 3, count)
    species[:2] = 1, 2
    return xcg.scene_from_arrays(
        position, velocity=velocity, diameter=diameter, density=1.0, species=np.tile(species, (steps, 1)),
        box=dict.fromkeys("xyz", (0.0, length)), periodic=periodic,
    )  # fmt: skip


def left_by_fit(ds, kernel, node, axes, gradient):
    """Sum of w_i P_ij^2 over grains i of each phase and all j, with P v = v - fit: fitted grain by grain by LAPACK.

    Images of a grain share its velocity, so that they share a column. Also (sum w)^2 / sum over grains of w^2, and the
    first sums over the j of each phase.
    """
    one = ds.isel(time=0)
    box = (one["box"].values[:, 1] - one["box"].values[:, 0]) * [
        a in ds.attrs["periodic"] for a in "xyz"
    ]
    reach = [range(-5, 6) if k in axes else [0] for k in range(3)]
    mass = one["mass"].values
    species = one["species"].values
    parts = []
    for shift in itertools.product(*reach):
        x = (one["position"].values + np.array(shift) * box - node)[:, axes]
        weight = mass * kernel(np.linalg.norm(x, axis=1))
        parts += [(x[i], weight[i], i) for i in np.flatnonzero(weight)]
    x, weight, own = (np.array(values) for values in zip(*parts, strict=True))
    velocity = np.eye(len(mass))[own]  # row i: which velocities that of grain i is made of
    mean = weight @ velocity / weight.sum()
    y = x if gradient == "paper" else x - weight @ x / weight.sum()
    left = velocity - mean
    if gradient in ("least_squares", "paper"):
        root = np.sqrt(weight)[:, None]
        left = left - y @ np.linalg.lstsq(root * y, root * left, rcond=1e-6)[0]
    each = weight * (left**2).sum(axis=1)
    total = weight.sum() ** 2 / ((weight @ velocity) ** 2).sum()
    by_pair = [
        [weight[species[own] == a] @ left[species[own] == a][:, species == b] ** 2 for b in (1, 2)]
        for a in (1, 2)
    ]
    pairs = np.array([[column.sum() for column in row] for row in by_pair])
    return np.array([each.sum(), *(each[species[own] == k].sum() for k in (1, 2))]), total, pairs


@pytest.mark.parametrize("gradient", ["least_squares", "paper", "kernel"])
@pytest.mark.parametrize(("axes", "at"), [("xyz", {}), ("xz", {}), ("xy", {"z": 0.3}), ("z", {})])
@pytest.mark.parametrize(
    ("length", "count", "width"), [(6.0, 80, 1.0), (2.5, 10, 1.7), (1.7, 4, 1.6)]
)
def test_degrees_of_freedom_left_by_a_fit_equal_brute_force(
    length, count, width, axes, at, gradient
):
    ds = random_gas(count, length, seed=count, spread=1.5)
    options = {"width": width, "axes": axes, "at": at, "spacing": length / 2, "gradient": gradient}
    names = ["fluctuation_density", "effective_count", "fluctuation_density_by_pair"]
    f = ds.cg.coarse_grain(names, by="species", **options)
    bulk = ds.cg.coarse_grain(["fluctuation_density", "effective_count"], **options)
    seen = [k for k, a in enumerate("xyz") if a in axes or a in at]
    kernel = BruteKernel("lucy", width, 3, len(seen))
    nodes = f.stack(node=list(axes)).isel(time=0)
    for n in range(0, nodes.sizes["node"], 3):
        here = nodes.isel(node=n)
        node = np.array([float(here[a]) if a in here.coords else 0.0 for a in "xyz"])
        left, total, pairs = left_by_fit(ds, kernel, node, seen, gradient)
        scale = length ** (len(seen) - 3.0)
        left *= scale
        pairs *= scale
        size = 1e-12 * float(ds.mass.sum()) * scale
        np.testing.assert_allclose(here.fluctuation_density, left, rtol=1e-9, atol=size)
        by_pair = here.fluctuation_density_by_pair.transpose("phase", "other_phase").values
        np.testing.assert_allclose(by_pair[1:, :2], pairs, rtol=1e-9, atol=size)
        np.testing.assert_allclose(by_pair[0, :2], pairs.sum(axis=0), rtol=1e-9, atol=size)
        np.testing.assert_array_equal(by_pair[:, 2], 0.0)  # walls
        alone = bulk.stack(node=list(axes)).isel(time=0, node=n)
        np.testing.assert_allclose(alone.fluctuation_density, left[0], rtol=1e-9, atol=size)
        assert float(here.effective_count.sel(phase="bulk")) == pytest.approx(total, rel=1e-10)
        assert float(alone.effective_count) == pytest.approx(total, rel=1e-10)


def averaged(f, name="granular_temperature", of="fluctuation_density"):
    """Ratio of sums over the nodes where the temperature is known."""
    known = f[name].notnull()
    weight = f[of].where(known, 0.0)
    rest = [d for d in f[name].dims if d in ("time", "x", "y", "z")]
    return (f[name].fillna(0.0) * weight).sum(rest) / weight.sum(rest)


@pytest.mark.parametrize(
    ("width", "spread", "phi"), [(0.6, 1.0, 0.6), (0.75, 1.3, 0.4), (1, 1.6, 0.2), (2, 1, 0.1)]
)
def test_the_temperature_of_a_gas_is_recovered(width, spread, phi):
    length = 10.0
    count = round(phi * length**3 / float(random_gas(2000, length, 0, spread=spread).volume.mean()))
    ds = random_gas(count, length, seed=1, spread=spread, steps=16_000 // count)
    options = {"width": width, "by": "species"}
    for axes in ("xyz", "xz", "z"):
        f = ds.cg.coarse_grain(NAMES, axes=axes, spacing=1.4, **options)
        mean = f.cg.coarsen(**{a: f.sizes[a] for a in axes}).cg.time_average()
        np.testing.assert_allclose(mean.granular_temperature.squeeze(), 1.0, atol=0.05)
        bulk = ds.cg.coarse_grain(NAMES, axes=axes, spacing=1.4, width=width)
        np.testing.assert_allclose(averaged(bulk), 1.0, atol=0.03)


def test_a_layer_and_a_polydisperse_gas_by_direction():
    rng = np.random.default_rng(3)
    ds = xcg.scene_from_arrays(
        rng.uniform(0, 20, (10, 200, 3)) * [1, 1, 0], velocity=rng.normal(size=(10, 200, 3)) * [1, 2, 0], density=1.0,
        diameter=np.ones((10, 200)), box={"x": (0, 20), "y": (0, 20)}, periodic="xy", dimension=2, thickness=1.0,
    )  # fmt: skip
    f = ds.cg.coarse_grain(NAMES, width=1.0)
    assert float(averaged(f)) == pytest.approx(2.5, rel=0.05)
    np.testing.assert_allclose(averaged(f, "directional_temperature"), [1, 4, 0], rtol=0.06)


def test_the_biased_definition_is_a_choice():
    ds = random_gas(300, 6.0, seed=5)
    new, old = (
        ds.cg.coarse_grain(NAMES, width=1.0, temperature=way) for way in ("unbiased", "biased")
    )
    assert (new.attrs["temperature"], old.attrs["temperature"]) == ("unbiased", "biased")
    np.testing.assert_array_equal(old.fluctuation_density, old.density)
    np.testing.assert_array_equal(old.fluctuation_stress, new.fluctuation_stress)
    known = new.granular_temperature.notnull()
    trace = sum(new.fluctuation_stress.sel(component=a, direction=a, drop=True) for a in "xyz") / 3
    np.testing.assert_allclose(
        old.granular_temperature.where(known), (trace / new.density).where(known), rtol=1e-12
    )
    xr.testing.assert_allclose(
        new.granular_temperature, (trace / new.fluctuation_density).where(known), rtol=1e-12
    )
    with pytest.raises(
        ValueError, match="temperature='true': expected one of 'unbiased', 'biased'"
    ):
        ds.cg.coarse_grain(NAMES, width=1.0, temperature="true")


def test_nan_where_the_fit_leaves_less_than_half_a_grain():
    # four grains far apart and a fifth whose weight is small: the fit goes through it all but for a little
    rim = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) * 0.5
    f = {}
    for name, fifth in (("near", 0.1), ("far", 1.93)):
        position = np.vstack([rim, np.array([[fifth, 0, 0]])])
        velocity = np.random.default_rng(0).normal(size=(5, 3))
        ds = xcg.scene_from_arrays(position, velocity=velocity, diameter=np.ones(5), density=1.0)
        f[name] = ds.cg.coarse_grain(NAMES, width=1.0, axes="", at=dict.fromkeys("xyz", 0.0)).isel(
            time=0
        )
        assert int(f[name].sample_count) == 5
    assert np.isfinite(f["near"].granular_temperature)
    assert np.isnan(f["far"].granular_temperature)
    assert np.isnan(f["far"].directional_temperature).all()
    assert 0 < float(f["far"].fluctuation_density) < 0.1 * float(f["far"].density)


@pytest.mark.parametrize(
    ("ratio", "known"), [(1.0, True), (5.7, True), (5.9, False), (40.0, False)]
)
def test_two_grains_have_a_temperature_while_their_masses_are_alike(ratio, known):
    """Over a box the mean of masses 1 and x leaves 2 x / (1 + x), which is half of (1 + x) / 2 at x = 3 + sqrt(8)."""
    ds = xcg.scene_from_arrays(
        [[1.0, 1, 1], [3, 2, 3]], velocity=[[1.0, 2, 0], [0, 2, 3]], diameter=[0.4, 0.4], mass=[1.0, ratio],
        box=[[0, 4.0]] * 3, periodic="xyz",
    )  # fmt: skip
    f = ds.cg.coarse_grain("granular_temperature", axes="", width=1.0)
    np.testing.assert_allclose(
        f.granular_temperature, 10 / 6 if known else np.nan, rtol=1e-12
    )  # |u - v|^2 / 2 D


def test_averages_add_fluctuations_and_their_densities_separately():
    ds = random_gas(40, 6.0, seed=6, steps=40)
    f = ds.cg.coarse_grain(NAMES, width=0.9)
    assert float(f.granular_temperature.isnull().mean()) > 0.1
    profile = f.cg.profile("z")
    known = f.granular_temperature.notnull()
    top = (
        sum(f.fluctuation_stress.sel(component=a, direction=a, drop=True) for a in "xyz").where(
            known, 0.0
        )
        / 3
    )
    bottom = f.fluctuation_density.where(known, 0.0)
    np.testing.assert_allclose(
        profile.granular_temperature, top.sum(["x", "y"]) / bottom.sum(["x", "y"]), rtol=1e-10
    )
    mean = profile.cg.time_average()
    assert (np.abs(mean.granular_temperature - 1) < 4 * mean.granular_temperature_error).all()
    assert float(mean.granular_temperature_error.max()) < 0.2
    with pytest.raises(ValueError, match="granular_temperature needs fluctuation_density"):
        f.drop_vars("fluctuation_density").cg.profile("z")


def test_errors_of_one_step_follow_from_the_effective_count():
    ds = random_gas(600, 10.0, seed=7, steps=200)
    f = ds.cg.coarse_grain(
        ["velocity", "effective_count", "granular_temperature"], width=1.5, spacing=5.0
    )
    count = f.effective_count.mean("time")
    np.testing.assert_allclose(
        (f.velocity**2).mean(["time", "component"]), (1 / f.effective_count).mean("time"), rtol=0.2
    )
    scatter = f.granular_temperature.std("time")
    np.testing.assert_allclose(scatter, np.sqrt(2 / (3 * (count - 4))), rtol=0.3)


@pytest.mark.parametrize("lazy", [False, True])
def test_one_warning_where_most_nodes_have_too_few_grains(lazy):
    ds = random_gas(40, 6.0, seed=8, steps=3)
    if lazy:
        ds = ds.chunk(time=1)
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        f = ds.cg.coarse_grain(["granular_temperature"], width=0.6, spacing=1.0)
        assert len(found) == (0 if lazy else 1)
        f.compute()
    (warning,) = found
    assert issubclass(warning.category, xcg.SceneWarning)
    assert re.search(r"granular_temperature is NaN at \d+ of \d+ nodes", str(warning.message))
    assert warning.filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ds.cg.coarse_grain(["granular_temperature"], width=2.0, spacing=1.0).compute()
        ds.cg.coarse_grain(
            ["granular_temperature"], width=0.6, spacing=1.0, temperature="biased"
        ).compute()


# --- mixtures ---


def mixture(steps=40, *, equal_energy=True, side=12.0, phi=0.2, seed=0, **options):
    """Grains of sizes 1 and 2, of equal volume in all, with equal m <v^2> or equal <v^2>; masses 1 and 8."""
    rng = np.random.default_rng(seed)
    small = int(phi * side**3 / 2 / (np.pi / 6))
    species = np.repeat([1, 2], [small, small // 8])
    diameter = np.where(species == 1, 1.0, 2.0)
    temperature = diameter**-3.0 if equal_energy else np.ones(len(species))
    shape = (steps, len(species))
    velocity = rng.normal(size=(*shape, 3)) * np.sqrt(temperature)[:, None]
    ds = xcg.scene_from_arrays(
        rng.uniform(0, side, (*shape, 3)), velocity=velocity, species=np.broadcast_to(species, shape),
        diameter=np.broadcast_to(diameter, shape), density=6 / np.pi, time=np.arange(steps) * 1.0,
        **({"box": dict.fromkeys("xyz", (0.0, side)), "periodic": "xyz"} | options),
    )  # fmt: skip
    mass = diameter**3
    bulk = (mass * temperature).sum() / mass.sum()
    return ds, np.array([bulk, temperature[0], temperature[-1]])


OF_MIXTURES = ["granular_temperature", "directional_temperature", "mixture_temperature"]


@pytest.mark.parametrize("equal_energy", [True, False])
@pytest.mark.parametrize("gradient", ["least_squares", "paper"])
def test_temperatures_of_a_mixture_are_those_of_its_phases(equal_energy, gradient):
    ds, truth = mixture(equal_energy=equal_energy)
    f = ds.cg.coarse_grain(OF_MIXTURES, by="species", gradient=gradient, for_averages=True)
    assert f.attrs["temperature"] == "mixture"
    blocks = {a: f.sizes[a] for a in "xyz"}
    mean = f.cg.coarsen(**blocks).cg.time_average().squeeze()
    np.testing.assert_allclose(mean.granular_temperature / truth, 1.0, atol=0.12)
    along = mean.directional_temperature.mean("component")
    np.testing.assert_allclose(along, mean.granular_temperature, rtol=1e-9)
    np.testing.assert_allclose(mean.granular_temperature[:2] / truth[:2], 1.0, atol=0.06)
    # as energies: m_a T_a, and their mean by number
    energies = mean.mixture_temperature
    if equal_energy:
        np.testing.assert_allclose(energies, 1.0, atol=0.12)
    total = (mean.number_density * energies).isel(phase=[1, 2]).sum()
    assert float(total / (mean.number_density[0] * energies[0])) == pytest.approx(1.0, rel=1e-9)
    # without phases the bulk is that of equal variances
    alone = ds.cg.coarse_grain("granular_temperature", gradient=gradient)
    bulk = alone.cg.coarsen(**blocks).cg.time_average().squeeze().granular_temperature
    if equal_energy:
        assert float(bulk / truth[0]) > 1.25
    else:
        assert float(bulk / truth[0]) == pytest.approx(1.0, abs=0.06)


def test_temperatures_of_a_mixture_in_a_cylinder():
    ds, truth = mixture(box=dict.fromkeys("z", (0.0, 12.0)), periodic="z")
    frame = xcg.Cylindrical(axis="z", origin=(6.0, 6.0, 0.0))
    f = ds.cg.coarse_grain(
        OF_MIXTURES, by="species", frame=frame, axes="r", bounds={"r": (1.0, 4.0)}, spacing=1.0
    )
    mean = f.cg.time_average()
    np.testing.assert_allclose(mean.granular_temperature.mean("r") / truth, 1.0, atol=0.12)


def test_the_bulk_is_the_mean_by_mass_and_negative_temperatures_are_nan():
    ds, _ = mixture(2)
    f = ds.cg.coarse_grain(["granular_temperature", "fluctuation_stress"], by="species")
    t = f.granular_temperature
    rho = f.density
    left = f.fluctuation_density_by_pair.isel(other_phase=[0, 1]).rename(other_phase="of")
    residual = sum(f.fluctuation_stress.sel(component=a, direction=a) for a in "xyz") / 3
    c = left.isel(phase=[1, 2]).transpose(..., "phase", "of").values
    r = residual.isel(phase=[1, 2]).transpose(..., "phase").values
    weights = rho.transpose(..., "phase").values
    with np.errstate(all="ignore"):
        first = c[..., 0, 0] / weights[..., 1]
        second = (c[..., 1, 1] - c[..., 1, 0] * c[..., 0, 1] / c[..., 0, 0]) / weights[..., 2]
    usable = (first > 0.0011) & (second > 0.0011) & np.isfinite(r).all(axis=-1)
    solved = np.linalg.solve(c[usable], r[usable][..., None])[..., 0]
    got = t.transpose(..., "phase").values[usable]
    expected = np.where(solved < 0, np.nan, solved)
    np.testing.assert_allclose(got[:, 1:], expected, rtol=1e-8)
    assert np.isnan(expected).any()
    weights = weights[usable]
    bulk = (weights[:, 1:] * solved).sum(axis=1) / weights[:, 0]
    np.testing.assert_allclose(got[:, 0], np.where(bulk < 0, np.nan, bulk), rtol=1e-8)


def test_phases_that_are_absent_leave_the_others_known():
    ds, _ = mixture(1, phi=0.3)
    apart = ds.cg.select("species == 1 or x < 3")
    node = {"at": {"x": 8.0, "y": 6.0, "z": 6.0}, "width": 1.5}
    t = apart.cg.coarse_grain("granular_temperature", by="species", **node).granular_temperature
    alone = apart.cg.coarse_grain("granular_temperature", **node).granular_temperature
    np.testing.assert_allclose(t.sel(phase=["bulk", "1"]).squeeze(), float(alone.item()), rtol=1e-9)
    assert np.isnan(t.sel(phase="2")).all()


def test_warnings_about_mixtures_name_the_way_out():
    ds, _ = mixture(1)
    with pytest.warns(xcg.SceneWarning, match="masses differ by 8 assumes .* Pass by="):
        ds.cg.coarse_grain("granular_temperature")
    with pytest.warns(xcg.SceneWarning, match=r"granular_temperature is NaN, as .*time_average"):
        f = ds.cg.coarse_grain(["granular_temperature", "density"], by="species", for_averages=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ds.cg.coarse_grain(["granular_temperature"], by="species", axes="z")
        ds.cg.coarse_grain("granular_temperature", axes="z")  # of so many grains little is taken
        random_gas(300, 8.0, 1, spread=1.1).cg.coarse_grain("granular_temperature", axes="z")
    with pytest.raises(ValueError, match="choose phases after the average"):
        f.sel(phase=["bulk", "1"]).cg.time_average()


def test_one_step_warns_of_the_kinetic_stress_that_it_lacks():
    gas, _ = mixture(1, equal_energy=False)
    with pytest.warns(xcg.SceneWarning, match=r"kinetic_stress lacks about \d+ % of it,"):
        gas.cg.coarse_grain("kinetic_stress")
    packing = xcg.datasets.dense_packing()
    lazy = packing.chunk(time=1).cg.coarse_grain("pressure")
    with pytest.warns(xcg.SceneWarning, match=r"pressure lacks about \d+ % of the pressure"):
        lazy.compute()
    slow = packing.assign(
        velocity=1e-3 * packing.velocity, contact_force=1e3 * packing.contact_force
    )
    with warnings.catch_warnings():
        warnings.filterwarnings("error", ".*(lack|lacks) about")
        gas.cg.coarse_grain(["density", "kinetic_stress"], axes="z")  # many grains at a node
        gas.cg.coarse_grain()  # without contacts and names
        slow.cg.coarse_grain(["pressure", "kinetic_stress"])


@pytest.mark.parametrize(
    ("nodes", "match", "added"),
    [
        # <z^2> in the weights of a node, and the square of the slope of the best cubic through a period
        ({"axes": "z", "width": 1.5}, "support", 0.75 * 1.37 * (2 * np.pi / 12) ** 2 / 2),
        ({"axes": ""}, "along z, which .* resolve z too", 0.5),
    ],
)
def test_the_variation_of_the_flow_within_what_a_node_sees_is_named(nodes, match, added):
    """Of V_x = sin(2 pi z / L) and T = 0.25 the stress xx is rho (T + <(V_x - <V_x>)^2>)."""
    ds = truths.couette(1)
    with pytest.warns(xcg.SceneWarning, match=match) as told:
        f = ds.cg.coarse_grain(["kinetic_stress", "density"], **nodes)
    (text,) = [str(one.message) for one in told if "variation of the flow" in str(one.message)]
    named = float(re.search(r"about (\d+) % of the component xx", text)[1]) / 100
    assert named == pytest.approx(added / (added + 0.25), rel=0.1)
    xx = f.kinetic_stress.sel(component="x", direction="x")
    assert float(xx.mean() / f.density.mean()) == pytest.approx(added + 0.25, rel=0.12)


@pytest.mark.parametrize("axes", ["", "x"])
def test_a_temperature_that_holds_the_flow_along_an_averaged_axis_names_its_share(axes):
    """Of V_x = 2 sin(2 pi z / L) and T = 0.25, T is 0.25 + 2 / 3 where z is averaged."""
    ds = truths.couette(1)
    flow = np.sin(2 * np.pi * ds.position.sel(component="z", drop=True) / 12.0)
    x = xr.DataArray([1.0, 0.0, 0.0], coords={"component": ["x", "y", "z"]}, dims="component")
    ds = ds.assign(velocity=ds.velocity + flow * x)
    with pytest.warns(xcg.SceneWarning, match="along z, which fields are averaged over") as told:
        f = ds.cg.coarse_grain("granular_temperature", axes=axes)
    (text,) = [str(one.message) for one in told if "variation of the flow" in str(one.message)]
    named = float(re.search(r"about (\d+) % of it is", text)[1]) / 100
    assert named == pytest.approx(1 - 0.25 / float(f.granular_temperature.mean()), rel=0.15)
    with warnings.catch_warnings():
        warnings.filterwarnings("error", ".*variation of the flow")
        ds.cg.coarse_grain("granular_temperature", axes="z")
        ds.cg.coarse_grain(axes=axes)  # nobody asked for it by name
        truths.gas(1).cg.coarse_grain("granular_temperature", axes=axes)
        truths.gas(1, rate=2.0).cg.coarse_grain("granular_temperature", axes="")


def test_no_variation_is_named_of_gases_sheared_boxes_and_slow_flows():
    with warnings.catch_warnings():
        warnings.filterwarnings("error", ".*variation of the flow")
        truths.gas(1).cg.coarse_grain("kinetic_stress")
        truths.gas(1).cg.coarse_grain("kinetic_stress", axes="")
        truths.gas(2, rate=2.0).cg.coarse_grain("kinetic_stress", axes="")  # relative to the box
        truths.couette(1).cg.coarse_grain("kinetic_stress", axes="z", width=0.4)
        truths.packing(steps=1).cg.coarse_grain(["kinetic_stress", "pressure"])
        xcg.datasets.open("chute").cg.coarse_grain("pressure", axes="z")


@pytest.mark.parametrize("axes", ["rz", "rtz"])
def test_the_loss_of_kinetic_stress_in_rings_is_named(axes):
    ds = truths.gas(8)
    nodes = {"axes": axes, "bounds": {"r": (1.0, 4.0)}, "spacing": 1.5}
    with pytest.warns(xcg.SceneWarning, match="lacks about") as told:
        f = ds.cg.coarse_grain(
            ["kinetic_stress", "density"], frame=xcg.Cylindrical("z", (6, 6, 0)), **nodes
        )
    named = float(re.search(r"lacks about (\d+) %", str(told[-1].message))[1]) / 100
    trace = sum(f.kinetic_stress.sel(component=a, direction=a) for a in ("r", "theta", "z"))
    assert named == pytest.approx(1 - float(trace.mean() / (3 * f.density.mean())), rel=0.3)
