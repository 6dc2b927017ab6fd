"""Warnings about requests: what fires them, what they say, and what stays silent."""

import re
import warnings
from functools import cached_property

import numpy as np
import pytest
import xarray as xr

import xcg
from tests import raise_if_dask_computes, truths
from xcg.fields.plan import make_plan
from xcg.fields.request import Request
from xcg.scene.sanity_sample import Particles
from xcg.scene.scene import Scene

NAMES = ["friction_coefficient", "inertial_number"]


def said(ds, *args, about="a node sees", **options):
    """Return what a call warns of single steps."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        ds.cg.coarse_grain(*args, **options).compute()
    texts = [str(warning.message) for warning in caught]
    return [text for text in texts if about in text]


def mixture(steps):
    """Return an elastic mixture in equilibrium, of sizes 1 and 2."""
    return truths.gas(steps, sizes=(1.0, 2.0))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"axes": "z", "width": 0.01}, "sees the inside of single grains"),
        ({"axes": "z", "width": 100.0}, "larger than the scene"),
        ({"axes": "x", "at": {"z": 50.0}, "width": 1.0}, "outside the box"),
        ({"axes": "", "width": 1.0}, "no neighbours to differ"),
        ({"axes": "z", "gradient": "kernel", "kernel": xcg.Gaussian(1.0)}, "leaves the jump out"),
    ],
)
def test_plans_are_made_silently_and_each_call_that_makes_one_warns(options, message):
    ds = xcg.datasets.random_scene(60, periodic="z")
    extent = {a: 5.0 for a in "xyz" if a not in options["axes"] and a not in options.get("at", {})}
    options = {"extent": extent, **options}
    fields = ["granular_temperature", "velocity_gradient"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        make_plan(Scene(ds), Request(fields, **options))
    for call in (ds.cg.coarse_grain, ds.cg.explain):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            call(fields, **options)
        assert sum(message in str(warning.message) for warning in caught) == 1


def test_a_mesh_that_is_too_large_for_a_narrow_kernel_names_the_width():
    with pytest.raises(ValueError, match=r"nodes, more than .*width=0\.0001 is .* of the diameter"):
        xcg.datasets.random_scene(60).cg.coarse_grain("density", width=1e-4)


def test_one_warning_names_all_fields_with_their_floors():
    (text,) = said(truths.gas(1), NAMES, width=1.5)
    assert re.search(r"friction_coefficient is about 0\.\d+, inertial_number is about \d", text)
    assert re.search("sees only about 1[23] grains", text)


def test_one_warning_names_every_field_that_few_grains_spoil():
    """Kinetic stress that is lost, a norm that is noise, and temperatures that are unknown have one cause."""
    ds = mixture(2)
    names = ["pressure", "friction_coefficient", "granular_temperature", "mixture_temperature"]
    (text,) = said(ds, names, by="species")
    shares = {
        name: re.search(
            rf"{name} is NaN, as its error is larger, at (\d+) % of the nodes of", text
        )[1]
        for name in names[2:]
    }
    assert len({*shares.values()}) == 1
    assert re.search("pressure, .*lack about|pressure lacks about", text)
    assert re.search(r"friction_coefficient is about \d", text)


def test_the_share_of_unknown_temperatures_is_that_of_the_nodes():
    ds = mixture(1)
    (text,) = said(ds, "mixture_temperature", by="species")
    share, phase = re.search(r"larger, at (\d+) % of the nodes of phase (\d)", text).groups()
    f = ds.cg.coarse_grain("mixture_temperature", by="species").sel(phase=phase)
    lost = f.mixture_temperature.isnull() & (f.density > 0)
    assert int(share) == pytest.approx(100 * float(lost.sum() / (f.density > 0).sum()), abs=0.51)


def test_the_warning_is_the_same_for_a_lazy_scene_whose_graph_reads_nothing():
    ds = truths.gas(2)
    lazy = ds.chunk(time=1)
    with raise_if_dask_computes(), warnings.catch_warnings():
        warnings.simplefilter("error")
        lazy.cg.coarse_grain(NAMES)
    (of_lazy,), (of_eager,) = said(lazy, NAMES), said(ds, NAMES)
    numbers = r"[\d.]+"  # of the step that was computed first
    assert re.sub(numbers, "", of_lazy) == re.sub(numbers, "", of_eager)


def test_the_floors_of_branches_and_tangential_forces_follow_from_the_contacts_of_the_step():
    names = ["branch_anisotropy", "tangential_force_anisotropy"]
    ds = truths.packing(count=200, steps=1)  # of two sizes, without friction
    (text,) = said(ds, names)
    said_of_branches = r"step branch_anisotropy is about 0\.\d+ where the true value is 0"
    floor = re.search(said_of_branches, text)[0]
    lengths = ("position", "diameter", "contact_point", "box")
    small = ds.assign({name: 1e-3 * ds[name] for name in lengths})
    small = small.assign({name: 1e-9 * ds[name] for name in ("volume", "mass")})
    measures = [name for name in ds.attrs if re.match("box_|particle_|d[^i]", name)]
    (text,) = said(small.assign_attrs({name: 1e-3 * ds.attrs[name] for name in measures}), names)
    assert floor in text
    (text,) = said(xcg.datasets.open("chute").isel(time=[0]), names)
    assert "tangential_force_anisotropy is about 0." in text
    # equal spheres without friction have neither
    assert said(truths.contacts(1), names) == []
    f = truths.contacts(1).cg.coarse_grain(names)
    assert "floor_of_one_step" not in f.branch_anisotropy.attrs


def test_fields_that_come_by_default_say_their_floor_by_an_attribute():
    ds = truths.packing(count=200, steps=2)  # at rest
    assert said(ds) == []
    floor = ds.cg.coarse_grain().friction_coefficient.attrs["floor_of_one_step"]
    (text,) = said(ds, ["friction_coefficient"])
    assert f"friction_coefficient is about {floor:.2g} where the true value is 0" in text


@pytest.mark.parametrize(
    ("fields", "options"),
    [
        (["velocity", "granular_temperature"], {"width": 1.0}),
        (["contact_stress", "shear_rate_tensor"], {}),
    ],
)
def test_fields_without_a_floor_are_silent(fields, options):
    assert said(truths.gas(1), fields, **options) == []


def test_many_grains_are_silent():
    many = xcg.datasets.dense_packing(20_000)
    assert said(many, ["friction_coefficient"], axes="z") == []
    assert said(many, axes="z") == []
    assert said(many, ["friction_coefficient"], width=3.0) == []
    assert said(many, ["friction_coefficient"]) != []


def test_a_profile_by_default_is_silent_where_a_named_field_is_not():
    chute = xcg.datasets.open("chute")
    assert said(chute, axes="z") == []
    assert said(chute, NAMES, axes="z") != []


def test_functions_that_measure_noise_give_no_advice():
    ds = truths.gas(3)
    with warnings.catch_warnings():
        warnings.filterwarnings("error", ".*a node sees")
        ds.cg.width_sweep(["1 d43", "1.5 d43"], ["friction_coefficient"], axes="z")


def test_the_floor_of_a_shear_rate_is_relative_to_the_fluctuations():
    ds = truths.gas(2)
    (text,) = said(ds, ["shear_rate", "granular_temperature"], width=1.5)
    floor = float(re.search(r"shear_rate is about ([\d.]+) sqrt\(T\) / d43", text)[1])
    f = ds.cg.coarse_grain("shear_rate", width=1.5)  # T = d43 = 1
    assert floor == pytest.approx(float(f.shear_rate.mean()), rel=0.15)


def test_the_pairs_of_one_step_are_looked_at(monkeypatch):
    steps = []
    neighbours = Particles.neighbours.func
    counted = cached_property(lambda grains: steps.append(grains) or neighbours(grains))
    counted.__set_name__(Particles, "neighbours")
    monkeypatch.setattr(Particles, "neighbours", counted)
    ds = truths.gas(4)
    steps.clear()
    assert len(said(ds, "shear_rate", width=1.5)) == 1
    assert len(steps) == 1


def test_explain_shows_the_floors():
    plan = truths.gas(1).cg.explain(NAMES, width=1.5)
    assert re.search(r"floors +friction_coefficient 0\.\d+, inertial_number", str(plan))
    assert "floors" not in str(truths.gas(1).cg.explain("velocity", width=1.5))


def test_unknown_extent_or_weights_have_no_floor():
    mixture = truths.gas(1, sizes=(1.0, 2.0))
    assert said(mixture, NAMES, width={1: 1.0, 2: 2.0}, by="species") == []


def test_the_floor_in_rings_is_that_of_the_grains_around_the_axis():
    ds = truths.gas(16)
    nodes = {"frame": xcg.Cylindrical("z", (6.0, 6.0, 0.0)), "axes": "rz", "bounds": {"r": (2, 4)}}
    (text,) = said(ds, NAMES[:1], **nodes)
    floor = float(re.search(r"friction_coefficient is about ([\d.]+)", text)[1])
    f = ds.cg.coarse_grain(NAMES[:1], **nodes)
    assert floor == pytest.approx(float(f.friction_coefficient.mean()), rel=0.25)


def test_the_warning_of_lost_kinetic_stress_names_a_field_that_takes_it():
    """Of grains in rotation the velocity varies within the support, and the vorticity takes no stress."""
    (system,) = truths.systems(["rigid rotation"])
    ds = system.make()
    ds = ds.assign(
        velocity=ds.velocity + 0.1 * np.random.default_rng(1).normal(size=ds.velocity.shape)
    )
    names = ["vorticity", "granular_temperature", "fluctuating_kinetic_energy"]
    nodes = system.nodes("volume")
    with pytest.warns(xcg.SceneWarning, match="fluctuating_kinetic_energy lacks about"):
        ds.cg.coarse_grain(names, width=1.0, **nodes)


FLOWS = {
    "plug": lambda x: np.broadcast_to([1e3, 0.3, 0.0], x.shape),
    "shear": lambda x: x[..., [2, 2, 2]] * [0.7, 0.0, 0.0],
    "rotation": lambda x: x[..., [1, 0, 2]] * [-0.7, 0.7, 0.0],
}


@pytest.mark.parametrize("flow", FLOWS)
@pytest.mark.parametrize("nodes", [{"axes": "xyz"}, {"axes": "xz", "at": {"y": 6.0}}])
def test_flows_without_fluctuations_have_no_noise(flow, nodes):
    ds = truths.gas(1)
    ds = ds.assign(velocity=(ds.velocity.dims, FLOWS[flow](ds.position.values - 6.0)))
    names = ["shear_rate", "granular_temperature", "velocity_gradient"]
    assert said(ds, names, about="", width=1.0, spacing=2.0, **nodes) == []


def test_a_converging_flow_without_fluctuations_has_no_noise():
    """The velocity falls with the square of the distance, which no cubic polynomial holds."""
    rng = np.random.default_rng(3)
    places = rng.uniform([-4, -4, 4], [4, 4, 12], (20_000, 3))
    velocity = -50 * places / np.linalg.norm(places, axis=1)[:, None] ** 3
    ds = xcg.scene_from_arrays(
        places, velocity=velocity, diameter=np.full(20_000, 0.4), density=1.0
    )
    bounds = {"x": (-1, 1), "y": (-1, 1), "z": (7, 9)}
    names = ["shear_rate", "granular_temperature"]
    assert said(ds, names, about="", width=0.5, spacing=0.5, bounds=bounds) == []


@pytest.mark.parametrize("axes", ["", "z"])
def test_a_plug_has_no_variation_of_the_flow(axes):
    ds = truths.gas(1)
    ds = ds.assign(velocity=(ds.velocity.dims, FLOWS["plug"](ds.position.values)))
    assert said(ds, ["kinetic_stress", "granular_temperature"], about="", axes=axes) == []


@pytest.mark.parametrize("strain", [0.0, 0.02])
@pytest.mark.parametrize("axes", ["", "z", "xyz"])
def test_contacts_of_a_lattice_have_no_noise(strain, axes):
    spacing = 0.95 * np.array([1 - strain, 1.0, 1.0])
    places = np.stack(np.meshgrid(*[np.arange(5)] * 3), axis=-1).reshape(-1, 3) + 0.5
    ds = xcg.scene_from_arrays(
        places * spacing,
        velocity=np.zeros((125, 3)),
        diameter=np.ones(125),
        density=1.0,
        box=[[0.0, 5 * side] for side in spacing],
        periodic="xyz",
    ).cg.find_contacts(k_n=1.0)
    names = ["friction_coefficient", "contact_anisotropy"]
    f = ds.cg.coarse_grain(names, axes=axes, width=1.5)
    pressures = (1 - spacing) * spacing / spacing.prod()
    mean = pressures.mean()
    friction = np.sqrt(((pressures - mean) ** 2).sum() / 2) / mean
    np.testing.assert_allclose(f.friction_coefficient, friction, rtol=0.01, atol=1e-3)
    assert said(ds, names, about="", axes=axes, width=1.5) == []


def sheared_crystal(noise, inertial=0.01):
    """Return touching spheres in a sheared box."""
    ds = xcg.datasets.simple_cubic(8, force=1.0)
    rate = inertial * float(ds.density[0, 0]) ** -0.5  # p = 1, d = 1
    velocity = noise * np.random.default_rng(1).normal(size=ds.position.shape)
    velocity[..., 0] += rate * ds.position.sel(component="z").values
    kept = ("diameter", "density", "contact_i", "contact_j", "contact_force")
    return xcg.scene_from_arrays(
        ds.position.values,
        velocity=velocity,
        box=ds.box.values[0],
        periodic="xyz",
        lattice={"xz": 0.0},
        shear_rate={"xz": rate},
        **{name: ds[name].values for name in kept},
    )


def test_the_noise_of_inertial_numbers_is_that_of_the_fluctuations_of_the_step():
    names = ["inertial_number", "shear_rate"]
    assert said(sheared_crystal(0.0), names, about="", width=1.0) == []
    noise = 2e-3  # at I = 0.1 fluctuations are about 4e-3
    (text,) = said(sheared_crystal(noise), names, width=1.0)
    floor = float(re.search(r"inertial_number is about ([\d.]+)", text)[1])
    f = sheared_crystal(noise, inertial=0.0).cg.coarse_grain("inertial_number", width=1.0)
    assert 1.0 < floor / float(f.inertial_number.mean()) < 1.25


def share_of_variation(text):
    """Share and component in a warning of the variation of the flow."""
    form = r"about (\d+) % of (the component \w\w of the stress|the pressure|it) is no fluctuation"
    share, component = re.search(form, text).groups()
    return int(share), component


@pytest.mark.parametrize("axes", ["xyz", "z"])
def test_the_component_of_a_stress_that_holds_the_variation_of_the_flow_is_named(axes):
    """In shear xx holds rate^2 <z^2> beside T, which is less than 5 % of the pressure."""
    rate, variance = 0.18, 3.0  # of places at the width 3
    added = rate**2 * variance
    ds = truths.gas(1, rate=rate)
    options = {"axes": axes, "width": 3.0, "about": "no fluctuation"}
    (text,) = said(ds, "kinetic_stress", **options)
    share, component = share_of_variation(text)
    assert component == "the component xx of the stress"
    assert share == pytest.approx(100 * added / (1 + added), abs=2.5)
    assert said(ds, "pressure", **options) == []


@pytest.mark.parametrize("seed", range(4))
def test_few_grains_without_flow_and_a_component_that_is_small_are_silent(seed):
    rng = np.random.default_rng(seed)
    ds = truths.gas(1, phi=0.1)
    at_random = rng.normal(size=ds.velocity.shape)
    flat = at_random * [1.0, 1.0, 0.0]
    # V_z varies along z, by less than 1 % of the pressure
    slow = flat.copy()
    slow[..., 2] = 0.05 * (ds.position[..., 2] - 6.0)
    for velocity in (at_random, flat, slow):
        gas = ds.assign(velocity=(ds.velocity.dims, velocity))
        assert said(gas, "kinetic_stress", about="", axes="z", width=3.0) == []


@pytest.mark.parametrize(
    ("factor", "warns"), [(0.5, False), (1, False), (10, False), (100, True), (1000, True)]
)
def test_an_extent_of_many_boxes_warns(factor, warns):
    ds = xcg.datasets.open("chute")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        f = ds.cg.coarse_grain("volume_fraction", axes="z", extent={"y": 10.0 * factor})
    named = [
        str(w.message) for w in caught if f"is {factor:.3g} times the length" in str(w.message)
    ]
    assert len(named) == warns
    assert not warns or "along 'y' (10 m)" in named[0]
    usual = ds.cg.coarse_grain("volume_fraction", axes="z").volume_fraction
    np.testing.assert_allclose(f.volume_fraction, usual / factor, rtol=1e-12)


def test_overlapping_grains_are_no_fault_of_the_kernel():
    """Of twelve grains in one place the kernel, in which one adds up to 0.56, is not the cause."""
    rng = np.random.default_rng(1)
    position = rng.uniform(0, 6, (100, 3))
    position[:12] = 3.0
    ds = xcg.scene_from_arrays(
        position, diameter=np.ones(100), density=1.0, box=[[0, 6]] * 3, periodic="xyz"
    )
    (text,) = said(ds, ["volume_fraction"], about="volume fraction", spacing=1.5)
    assert "grains overlap" in text
    assert "narrower" not in text


def test_variances_of_few_grains_say_what_they_lack():
    """Of independent values with the variance 1: 1 - 1 / N."""
    ds = truths.gas(4)
    values = np.random.default_rng(3).normal(size=ds.velocity.shape[:2])
    ds = ds.assign(charge=(("time", "particle"), values))
    fields = [xcg.Variance("charge"), xcg.Flux("charge")]
    (text,) = said(ds, fields, width=1.5, spacing=3.0)
    lost = int(re.search(r"variance_charge lacks about (\d+) % of it, flux_charge", text)[1])
    with pytest.warns(xcg.SceneWarning):
        f = ds.cg.coarse_grain(fields, width=1.5, spacing=3.0)
    assert float(f.variance_charge.mean()) == pytest.approx(1 - lost / 100, abs=0.03)
    assert said(ds, fields, axes="z") == []
    assert said(ds, [xcg.Mean("charge")], spacing=3.0, errors=True) == []


@pytest.mark.parametrize(("axes", "share"), [("", 0.94), ("z", 0.8)])
def test_a_jet_is_no_fluctuation(axes, share):
    """V_x = 1 in a third of the height, T = 0.01: the mean of kinetic_stress xx is 23 and 5 times the true one.

    Slopes between slices are a lower estimate of a jump's.
    """
    rng = np.random.default_rng(1)
    position = rng.uniform(0, 12, (700, 3))
    velocity = 0.1 * rng.normal(size=position.shape)
    still = {"diameter": np.ones(700), "density": 1.0, "box": [[0, 12]] * 3, "periodic": "xyz"}
    jet = velocity.copy()
    jet[:, 0] += (position[:, 2] > 4) & (position[:, 2] < 8)
    ds = xcg.scene_from_arrays(position, velocity=jet, **still)
    (text,) = said(ds, "kinetic_stress", axes=axes, about="no fluctuation")
    named = float(re.search(r"about (\d+) %", text)[1]) / 100
    assert share - 0.12 < named < share + 0.02
    ds = xcg.scene_from_arrays(position, velocity=velocity, **still)
    assert said(ds, "kinetic_stress", axes=axes, about="no fluctuation") == []


@pytest.mark.parametrize("sample", ["shear_cell_0.02", "shear_cell_0.03", "shear_cell_0.2"])
@pytest.mark.parametrize("axes", ["", "y"])
def test_waves_of_a_homogeneous_shear_are_fluctuations(sample, axes):
    ds = xcg.datasets.open(sample).compute()
    fields = ["granular_temperature", "stress"]  # which takes contacts
    for t in range(ds.sizes["time"]):
        assert said(ds.isel(time=[t]), fields, about="which fields are averaged", axes=axes) == []


@pytest.mark.parametrize("sample", ["hopper_4", "hopper_6"])
def test_grains_that_fall_through_a_period_vary_along_it(sample):
    """They come back at the top."""
    ds = xcg.datasets.open(sample)
    about = "variation of the flow along z, which fields are averaged"
    (text,) = said(ds.isel(time=[-1]), "granular_temperature", about=about, axes="x")
    assert 60 < float(re.search(r"about (\d+) %", text)[1]) < 85


def test_a_strong_wave_along_a_period_is_named_where_it_is_averaged():
    """Of V_y = 6 sin(2 pi x / L) and T = 1 a temperature averaged along x holds 18 beside 3."""
    ds = truths.gas(1)
    x = ds.position.sel(component="x") * (2 * np.pi / float(ds.box[0, 0, 1]))
    wave = xr.zeros_like(ds.velocity)
    wave[..., 1] = 6 * np.sin(x)
    ds = ds.assign(velocity=ds.velocity + wave)
    (text,) = said(ds, "granular_temperature", about="variation of the flow", axes="z")
    assert float(re.search(r"about (\d+) %", text)[1]) == pytest.approx(100 * 18 / 21, abs=4)
    assert "along x" in text


def test_a_node_sees_no_more_grains_than_there_are():
    ds = xcg.scene_from_arrays(np.zeros((1, 3)), velocity=np.eye(3)[:1], diameter=1.0, density=1.0)
    with pytest.warns(xcg.SceneWarning, match=r"sees only about 1\.0 grains"):
        ds.cg.coarse_grain(width=1.0).compute()
