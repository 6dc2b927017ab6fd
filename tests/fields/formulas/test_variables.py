"""Any variable of particles or contacts as a field, against sums written out."""

import itertools
import pickle
import re

import dask.array as da
import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

import xcg
from tests.brute_force import BruteKernel
from xcg.jobs.config import read_config
from xcg.jobs.run import run_job

WIDTH = 0.12
N, CONTACTS = 60, 90
EDGES = np.array([[0.0, 1.0], [-0.5, 0.7], [0.0, 0.9]])


def arrays(seed=0):
    """Grains and contacts at random places."""
    rng = np.random.default_rng(seed)
    i = rng.integers(0, N, CONTACTS)
    j = (i + 1 + rng.integers(0, N - 1, CONTACTS)) % N
    j[:9] = -1  # walls
    position = EDGES[:, 0] + rng.random((N, 3)) * np.diff(EDGES)[:, 0]
    return {
        "position": position,
        "velocity": rng.normal(size=(N, 3)),
        "diameter": rng.uniform(0.08, 0.12, N),
        "density": rng.uniform(900.0, 2500.0, N),
        "contact_i": i,
        "contact_j": j,
        "contact_force": rng.normal(size=(CONTACTS, 3)),
        "contact_point": position[i] + rng.normal(size=(CONTACTS, 3)) * 0.03,
        "species": rng.integers(1, 4, N),
        "heat": rng.normal(size=N) + 300.0,
        "whirl": rng.normal(size=(N, 3)),
        "inner": rng.normal(size=(N, 3, 3)),
        "contact_wear": rng.normal(size=CONTACTS),
        "contact_slip": rng.normal(size=(CONTACTS, 3)),
    }


def build(seed=0, **options):
    with_box = {"box": EDGES, "periodic": "xz", **options}
    return xcg.scene_from_arrays(**arrays(seed), **with_box)


pytestmark = pytest.mark.filterwarnings("ignore::xcg.SceneWarning")


def kernel_sums(f, points, axes="xyz", width=WIDTH, periodic="xz"):
    """Weights (nodes, points) of points at the nodes of a result, over all images."""
    seen = [k for k, a in enumerate("xyz") if a in axes]
    kernel = BruteKernel("lucy", width, seen=len(seen))
    nodes = np.stack(
        np.meshgrid(*(f[a].to_numpy() for a in axes if f[a].ndim), indexing="ij"), axis=-1
    )
    nodes = nodes.reshape(-1, nodes.shape[-1])
    for k, a in enumerate(axes):
        if not f[a].ndim:
            nodes = np.insert(nodes, k, f[a].item(), axis=1)
    length = np.diff(EDGES)[:, 0]
    total = np.zeros((len(nodes), len(points)))
    for image in itertools.product(*((-1, 0, 1) if "xyz"[k] in periodic else (0,) for k in seen)):
        away = nodes[:, None] - points[None][..., seen] - np.array(image) * length[seen]
        total += kernel(np.linalg.norm(away, axis=-1))
    averaged = [k for k in range(3) if k not in seen]
    return total / np.prod(length[averaged])


def close(found, expected, tolerance=1e-12):
    found = found.to_numpy()[0]
    expected = np.asarray(expected).reshape(found.shape)
    scale = np.nanmax(np.abs(expected))
    np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
    assert np.nanmax(np.abs(found - expected)) <= tolerance * scale


def written_out(psi, u, q, v, bulk=None):
    """Sum, mean, variance and flux of a scalar, vector or tensor; `bulk` are (q, v) means of all phases."""
    weights = psi * u
    q = q.reshape(len(q), -1)
    with np.errstate(invalid="ignore", divide="ignore"):
        below = weights.sum(1)[:, None]
        mean = weights @ q / below
        about_q, about_v = (mean, None) if bulk is None else bulk
        variance = np.einsum("ni,nik->nk", weights, (q[None] - about_q[:, None]) ** 2) / below
    flux = None
    if about_v is not None:
        terms = (
            weights[:, :, None, None]
            * (q - about_q[:, None])[..., None]
            * (v - about_v[:, None])[:, :, None]
        )
        flux = np.nan_to_num(terms).sum(1)
    return weights @ q, mean, variance, flux


def weights_of(a, ds):
    return {"mass": ds.mass.to_numpy()[0], "volume": ds.volume.to_numpy()[0], "number": np.ones(N)}[
        a
    ]


@pytest.mark.parametrize("axes", ["xyz", "xz", "z"])
@given(
    st.sampled_from(["mass", "volume", "number"]),
    st.sampled_from(["heat", "whirl", "inner"]),
    st.integers(0, 3),
)
@settings(max_examples=8, deadline=None)
def test_variables_of_particles_are_their_sums(axes, weight, name, seed):
    a = arrays(seed)
    ds = build(seed)
    kinds = [xcg.Sum, xcg.Mean, xcg.Variance, *([] if name == "inner" else [xcg.Flux])]
    asked = [kind(name, weight) for kind in kinds]
    f = ds.cg.coarse_grain([*asked, "velocity"], width=WIDTH, spacing=0.21, axes=axes)
    psi = kernel_sums(f, a["position"], axes)
    u = weights_of(weight, ds)
    velocity = f.velocity.to_numpy().reshape(-1, 3)
    _, mean, _, _ = written_out(psi, u, a[name], a["velocity"])
    total, mean, variance, flux = written_out(psi, u, a[name], a["velocity"], (mean, velocity))
    close(f[f"sum_{name}"], total)
    close(f[name], mean)
    close(f[f"variance_{name}"], variance)
    if name != "inner":
        close(f[f"flux_{name}"], flux)


@pytest.mark.parametrize("weight", ["mass", "volume", "number"])
def test_parts_of_phases_are_about_the_bulk_and_add_up(weight):
    a = arrays()
    ds = build()
    asked = [kind("heat", weight) for kind in (xcg.Sum, xcg.Mean, xcg.Variance, xcg.Flux)]
    width = {1: 0.1, 2: 0.12, 3: 0.15}
    f = ds.cg.coarse_grain([*asked, "velocity"], width=width, spacing=0.21, by="species")
    psi = np.empty((f.x.size * f.y.size * f.z.size, N))
    u = weights_of(weight, ds)
    for species, w in width.items():
        one = a["species"] == species
        psi[:, one] = kernel_sums(f, a["position"][one], width=w)
    velocity = f.velocity.sel(phase="bulk").to_numpy().reshape(-1, 3)
    _, mean, _, _ = written_out(psi, u, a["heat"], a["velocity"])
    for phase in ("bulk", "1", "2", "3"):
        here = u if phase == "bulk" else u * (a["species"] == int(phase))
        total, _, variance, flux = written_out(
            psi, here, a["heat"], a["velocity"], (mean, velocity)
        )
        g = f.sel(phase=phase)
        close(g.sum_heat, total)
        close(g.variance_heat, variance)
        close(g.flux_heat, flux)


@pytest.mark.parametrize("by", [None, "species"])
@pytest.mark.parametrize("name", ["contact_wear", "contact_slip"])
def test_variables_of_contacts_are_sums_at_the_contact_points(name, by):
    a = arrays()
    ds = build()
    asked = [kind(name) for kind in (xcg.Sum, xcg.Mean, xcg.Variance)]
    f = ds.cg.coarse_grain(asked, width=WIDTH, spacing=0.21, by=by)
    psi = kernel_sums(f, a["contact_point"])
    _, mean, _, _ = written_out(psi, 1.0, a[name], None)
    for phase in ["bulk", "1", "2", "3"] if by else ["bulk"]:
        sides = [
            a["species"][a["contact_i"]],
            np.where(a["contact_j"] < 0, 0, a["species"][a["contact_j"]]),
        ]
        share = np.ones(CONTACTS)
        if phase != "bulk":
            one, other = (side == int(phase) for side in sides)
            share = np.where(a["contact_j"] < 0, one, (one.astype(float) + other) / 2)
        total, own_mean, variance, _ = written_out(psi, share, a[name], None, (mean, None))
        g = f.sel(phase=phase) if by else f
        close(g[f"sum_{name}"], total)
        close(g[name], own_mean)
        close(g[f"variance_{name}"], variance)


def test_variables_on_a_plane_and_at_a_point():
    a = arrays()
    ds = build()
    f = ds.cg.coarse_grain("heat", width=WIDTH, spacing=0.21, axes="xz", at={"y": 0.1})
    psi = kernel_sums(f, a["position"])
    close(f.heat, written_out(psi, ds.mass.to_numpy()[0], a["heat"], None)[1])


SIGNS = st.sampled_from([-1.0, 0.0, 1.0])
SIZES = st.floats(1e-6, 1e12)
WEIGHTS = st.sampled_from(["mass", "volume", "number"])


@given(SIGNS, SIZES, WEIGHTS, st.booleans())
@settings(max_examples=20, deadline=None)
def test_the_mean_of_a_constant_is_the_constant(sign, size, weight, by_phase):
    value = sign * size
    ds = build().assign(q=lambda d: d.heat * 0 + value)
    asked = [kind("q", weight) for kind in (xcg.Mean, xcg.Variance, xcg.Flux)]
    f = ds.cg.coarse_grain(asked, width=WIDTH, spacing=0.3, by="species" if by_phase else None)
    known = f.q.to_numpy()[np.isfinite(f.q)]
    assert known.size
    np.testing.assert_allclose(known, value, rtol=4e-15)
    assert (f.variance_q.to_numpy()[np.isfinite(f.variance_q)] == 0).all()
    assert (f.flux_q == 0).all()


@pytest.mark.parametrize("large", ["everywhere", "gradient"])
def test_fluctuations_of_a_millionth_keep_their_digits(large):
    """What is large, the same for all or varying slowly, is never squared and subtracted."""
    ds = build()
    rng = np.random.default_rng(5)
    small = rng.integers(-512, 513, N) / 1024  # exact beside the large part
    if large == "everywhere":
        base = np.full(N, 2.0**20)
        plain = ds.assign(q=(("time", "particle"), small[None]))
        shifted = ds.assign(q=(("time", "particle"), (small + base)[None]))
        options = {"width": WIDTH, "spacing": 0.3}
    else:  # one value in each half, which no node sees both of
        base = np.where(ds.position.to_numpy()[0, :, 1] > 0.1, 2.0**30, -(2.0**30))
        plain = ds.assign(q=(("time", "particle"), small[None]))
        shifted = ds.assign(q=(("time", "particle"), (small + base)[None]))
        options = {
            "width": 0.2,
            "spacing": {"x": 0.3, "y": 1.0, "z": 0.3},
            "bounds": {"y": (-0.4, 0.6)},
        }
    asked = [xcg.Variance("q"), xcg.Flux("q")]
    one, other = (s.cg.coarse_grain(asked, **options) for s in (plain, shifted))
    for name in ("variance_q", "flux_q"):
        scale = float(np.abs(one[name]).max())
        assert float(np.abs(one[name] - other[name]).max()) <= 1e-9 * scale


def test_names_units_and_sources_of_variables():
    ds = build()
    ds["heat"].attrs.update(units="K", long_name="temperature of the grain")
    ds["whirl"].attrs["units"] = "rad s-1"
    ds["inner"].attrs.pop("units")
    ds["contact_wear"].attrs["units"] = "J/m2"
    asked = [
        "velocity", "heat", xcg.Sum("heat"), xcg.Sum("heat", "mass", name="content"), xcg.Flux("heat"),
        xcg.Variance("heat"), xcg.Variance("whirl"), xcg.Mean("density"), "inner", xcg.Sum("contact_wear"),
        xcg.Variance("contact_wear"),
    ]  # fmt: skip
    f = ds.cg.coarse_grain(asked, axes="z")
    assert {str(name): f[name].attrs.get("units") for name in f} == {
        "velocity": "m s^-1", "heat": "K", "sum_heat": "K m^-3", "content": "K kg m^-3", "flux_heat": "K kg m^-2 s^-1",
        "variance_heat": "K^2", "variance_whirl": "rad^2 s^-2", "mean_density": "kg m^-3", "inner": None,
        "sum_contact_wear": "(J/m2) m^-3", "variance_contact_wear": "(J/m2)^2",
    }  # fmt: skip
    assert f.heat.attrs["long_name"] == "mean of temperature of the grain, weighted by mass"
    assert f.heat.attrs["source"] == "variable 'heat' of the particles"
    assert f.sum_contact_wear.attrs["source"] == "variable 'contact_wear' of the contacts"
    assert "q = heat" in f.flux_heat.attrs["formula"]
    assert f.inner.dims == ("time", "z", "component", "direction")
    assert f.flux_heat.dims == ("time", "z", "component")


def test_fields_of_the_registry_come_first():
    ds = build()
    f = ds.cg.coarse_grain(["density", xcg.Mean("density")], axes="z")
    assert f.density.attrs["long_name"] == xcg.FIELDS["density"].long_name
    assert float(f.mean_density.min()) > 800


@pytest.mark.parametrize(
    ("text", "quantity"),
    [
        ("mean(heat, number)", xcg.Mean("heat", "number")),
        ("sum( heat )", xcg.Sum("heat")),
        ("Variance(heat, weight=volume, name=s)", xcg.Variance("heat", "volume", "s")),
        ("flux(heat)", xcg.Flux("heat")),
    ],
)
def test_quantities_are_parsed_from_text(text, quantity):
    ds = build()
    xr.testing.assert_equal(
        ds.cg.coarse_grain([text], axes="z"), ds.cg.coarse_grain(quantity, axes="z")
    )


def test_wrong_quantities_raise():
    ds = build().assign(wear=lambda d: d.contact_wear, still=lambda d: d.heat.isel(time=0))
    ds["odd"] = ("time", [1.0])
    for asked, words in [
        (xcg.Mean("heet"), "did you mean 'heat'"),
        ("men(heat)", "did you mean 'mean'"),
        ("mean(heat, weight=mess)", "expected one of mass, volume, number"),
        ("mean(heat, wait=mass)", "expected one of mean, sum"),
        ("nothing", "others are listed by xcg.FIELDS and by ds.data_vars"),
        (xcg.Flux("contact_wear"), "contacts, which have no velocity"),
        (xcg.Mean("contact_wear", "mass"), "contacts, which have no mass"),
        (xcg.Flux("inner"), "27 components"),
        (xcg.Mean("heat", name="x"), "pass name="),
        (xcg.Mean("heat", name="stress"), "pass name="),
        ([xcg.Mean("heat"), xcg.Mean("heat", "volume")], "pass name="),
        (xcg.Mean("wear"), "ds.rename(wear='contact_wear')"),
        (
            xcg.Mean("still"),
            "add the dimension time, ds.assign(still=ds.still.expand_dims(time=ds.time))",
        ),
        (xcg.Mean("odd"), "'odd' has the dimensions"),
    ]:
        with pytest.raises(ValueError, match=re.escape(words)):
            ds.cg.coarse_grain(asked, axes="z")
    with pytest.raises(ValueError, match="expected one of mass"):
        xcg.Mean("heat", "weight")
    for name, whose in (("heat", "particle 3"), ("contact_wear", "contact row 3")):
        broken = ds.copy(deep=True)
        broken[name].values[0, 3] = np.nan
        with pytest.raises(xcg.SceneError, match=f"'{name}' of {whose} is nan"):
            broken.cg.coarse_grain(name, axes="z")


def test_mass_weights_need_masses():
    bare = xcg.scene_from_arrays(arrays()["position"], heat=arrays()["heat"])
    with pytest.raises(xcg.SceneError, match="mass"):
        bare.cg.coarse_grain("heat", width=WIDTH, axes="z", extent={"x": 1, "y": 1})
    f = bare.cg.coarse_grain("mean(heat, number)", width=WIDTH, axes="z", extent={"x": 1, "y": 1})
    assert float(f.heat.mean()) == pytest.approx(300, abs=1)


def uneven_steps(steps=3):
    """Steps with different numbers of grains and contacts."""
    many = [arrays(seed) for seed in range(steps)]
    for k, a in enumerate(many):
        for name in a:
            if name in ("contact_i", "contact_j") or name.startswith("contact"):
                a[name] = a[name][: CONTACTS - k]
    return xcg.scene_from_arrays(
        **{name: [a[name] for a in many] for name in many[0]},
        time=np.arange(steps) * 0.1,
        box=EDGES,
        periodic="xz",
    )


ASKED = [
    "velocity",
    "heat",
    "inner",
    "contact_slip",
    xcg.Flux("whirl"),
    xcg.Variance("contact_wear"),
    xcg.Sum("heat"),
]


def test_lazy_scenes_give_the_same_bits():
    ds = uneven_steps()
    whole = ds.cg.coarse_grain(ASKED, width=WIDTH, spacing=0.3, by="species")
    lazy = ds.chunk(time=1)
    f = lazy.cg.coarse_grain(
        ASKED, width=WIDTH, spacing=0.3, by="species", groups=[1, 2, 3], bounds=bounds_of(whole)
    )
    assert all(isinstance(a.data, da.Array) for a in f.data_vars.values())
    xr.testing.assert_identical(whole.drop_attrs(), f.compute(scheduler="threads").drop_attrs())
    one = ds.isel(time=1).cg.coarse_grain(
        ASKED, width=WIDTH, spacing=0.3, by="species", bounds=bounds_of(whole)
    )
    xr.testing.assert_identical(whole.isel(time=1).drop_attrs(), one.drop_attrs())


def bounds_of(f):
    return {a: (float(f[a][0]), float(f[a][-1])) for a in "xyz" if a == "y"}


def test_variables_may_be_assigned_lazily():
    ds = uneven_steps().chunk(time=1)
    ds = ds.assign(energy=0.5 * ds.mass * (ds.velocity**2).sum("component"))
    dyad = (ds.velocity * ds.whirl.rename(component="direction")).transpose(
        "direction", "component", "time", "particle"
    )
    ds = ds.assign(dyad=dyad)
    f = ds.cg.coarse_grain(
        ["sum(energy)", "mean(dyad)", "kinetic_stress", "momentum_density"], width=WIDTH, axes="z"
    )
    assert f.dyad.dims == ("time", "z", "component", "direction")
    a = ds.isel(time=0)
    v = a.velocity.to_numpy()
    w = a.whirl.to_numpy()
    psi = kernel_sums(f.isel(time=[0]), a.position.to_numpy(), "z")
    close(f.dyad, written_out(psi, a.mass.to_numpy(), v[:, :, None] * w[:, None], None)[1])
    drift = f.momentum_density.to_numpy()[0]
    assert drift.shape[-1] == 3
    assert float(f.sum_energy.min()) >= 0


def test_steps_that_fail_may_be_skipped():
    ds = uneven_steps()
    ds["heat"].values[1, 7] = np.inf
    with pytest.warns(xcg.SkippedStep, match="'heat' of particle 7 is inf"):
        f = ds.cg.coarse_grain("heat", width=WIDTH, axes="z", on_error="skip")
    assert f.skipped.to_numpy().tolist() == [False, True, False]
    assert np.isnan(f.heat.to_numpy()[1]).all()


def test_frozen_grains_are_not_counted():
    a = arrays()
    frozen = (a["species"] == 3).astype(int)
    held = build().assign(frozen=(("time", "particle"), frozen[None]))
    f = held.cg.coarse_grain(["heat", "contact_wear"], width=WIDTH, spacing=0.3)
    psi = kernel_sums(f, a["position"]) * (frozen == 0)
    close(f.heat, written_out(psi, held.mass.to_numpy()[0], a["heat"], None)[1])
    free = (frozen[a["contact_i"]] == 0) | ((a["contact_j"] >= 0) & (frozen[a["contact_j"]] == 0))
    close(
        f.contact_wear,
        written_out(kernel_sums(f, a["contact_point"]) * free, 1.0, a["contact_wear"], None)[1],
    )


def test_averages_are_ratios_of_sums(tmp_path):
    ds = uneven_steps()
    asked = [
        "heat",
        "density",
        "contact_slip",
        "contact_number_density",
        xcg.Flux("heat"),
        xcg.Variance("heat"),
    ]
    f = ds.cg.coarse_grain(asked, width=WIDTH, axes="yz", spacing=0.3)
    f.to_netcdf(tmp_path / "f.nc")
    with xr.open_dataset(tmp_path / "f.nc") as reopened:
        mean = reopened.cg.time_average()
        line = reopened.cg.profile("z")
    for name, weight in (
        ("heat", "density"),
        ("variance_heat", "density"),
        ("contact_slip", "contact_number_density"),
    ):
        w = f[weight]
        q = f[name].fillna(0)
        xr.testing.assert_allclose(mean[name], (w * q).sum("time") / w.sum("time"))
        xr.testing.assert_allclose(line[name], (w * q).sum("y") / w.sum("y"))
    xr.testing.assert_allclose(mean.flux_heat, f.flux_heat.mean("time"))
    with pytest.raises(ValueError, match="heat needs density"):
        f[["heat"]].cg.time_average()


def test_contacts_are_counted_on_request():
    ds = build()
    f = ds.cg.coarse_grain("contact_number_density", width=WIDTH, spacing=0.3)
    close(f.contact_number_density, kernel_sums(f, arrays()["contact_point"]).sum(1))
    assert "contact_number_density" not in ds.cg.coarse_grain(width=WIDTH, axes="z")


def test_a_job_file_holds_quantities_as_text(tmp_path):
    ds = uneven_steps()
    job = tmp_path / "job.toml"
    for t in range(2):
        one = ds.isel(time=t)
        rows = np.column_stack(
            [one.particle_id, one.position, one.velocity, one.diameter, one.heat]
        )
        table = "\n".join(" ".join(f"{x:.17g}" for x in row) for row in rows)
        head = f"ITEM: TIMESTEP\n{t}\nITEM: NUMBER OF ATOMS\n{N}\nITEM: BOX BOUNDS pp ff pp\n"
        head += "\n".join(f"{low} {high}" for low, high in EDGES)
        columns = "\nITEM: ATOMS id x y z vx vy vz diameter c_heat\n"
        (tmp_path / f"grains.{t}.dump").write_text(f"{head}{columns}{table}\n")
    job.write_text(
        '[scene]\nparticles = "grains.*.dump"\ndensity = 2500.0\nunits = "SI"\nnames = {c_heat = "heat"}\n'
        '[fields]\nfields = ["density", "heat", "sum(heat)", "mean(heat, number, name=plain)"]\naxes = "z"\n'
        '[output]\nfolder = "out"\n'
    )
    list(run_job(read_config(str(job))))
    with xr.open_dataset(tmp_path / "out" / "fields.nc") as f:
        assert set(f.data_vars) == {"density", "heat", "sum_heat", "plain"}
        assert float(f.heat.mean()) == pytest.approx(300, abs=1)


def test_columns_of_contacts_become_variables(tmp_path):
    rows = [(1, 0.0, 0.0, 0.0), (2, 1.0, 0.0, 0.0), (3, 2.0, 0.0, 0.0)]
    head = "ITEM: TIMESTEP\n0\nITEM: NUMBER OF {}\n{}\nITEM: BOX BOUNDS ff ff ff\n-1 3\n-1 1\n-1 1\nITEM: {} {}\n"
    grains = tmp_path / "grains.dump"
    contacts = tmp_path / "contacts.dump"
    table = "\n".join(f"{i} {x} {y} {z} 1.0" for i, x, y, z in rows)
    grains.write_text(head.format("ATOMS", 3, "ATOMS", "id x y z diameter") + table + "\n")
    pairs = "1 2 1 0 0 7.5\n2 3 1 0 0 2.5\n"
    contacts.write_text(head.format("ENTRIES", 2, "ENTRIES", "id1 id2 fx fy fz c_age") + pairs)
    open_files = {
        "particles": str(grains),
        "contacts": str(contacts),
        "density": 1.0,
        "units": "SI",
    }
    for chunks in (None, 1):
        ds = xcg.open_scene(**open_files, chunks=chunks, names={"c_age": "contact_age"})
        assert ds.contact_age.dims == ("time", "contact")
        assert ds.contact_age.to_numpy()[0].tolist() == [7.5, 2.5]
        f = ds.cg.coarse_grain(
            "contact_age", width=0.4, axes="x", at={"y": 0.0, "z": 0.0}, spacing=0.25
        )
        assert f.contact_age.sel(x=0.5, method="nearest").to_numpy().item() == pytest.approx(7.5)


def test_variables_of_one_layer():
    rng = np.random.default_rng(1)
    position = np.column_stack([rng.random((40, 2)), np.zeros(40)])
    ds = xcg.scene_from_arrays(
        position, diameter=np.full(40, 0.1), density=2.0, dimension=2, charge=np.arange(40.0)
    )
    f = ds.cg.coarse_grain("sum(charge)", width=0.15, spacing=0.05)
    assert f.sum_charge.dims == ("time", "x", "y")
    cell = (float(f.x[1] - f.x[0]) * float(f.y[1] - f.y[0])) * 0.1
    assert float(f.sum_charge.sum()) * cell == pytest.approx(np.arange(40).sum(), rel=1e-3)


def test_plans_pickle_and_explain():
    plan = build().cg.explain(ASKED)
    text = str(plan)
    assert all(words in text for words in ("sum_heat", "contact points", "relative to means"))
    assert pickle.loads(pickle.dumps(plan.options.own)) == plan.options.own


def test_other_fields_keep_their_bits_beside_quantities():
    ds = build()
    names = ["velocity", "granular_temperature", "stress", "coordination_number", "d43"]
    alone = ds.cg.coarse_grain(names, width=WIDTH, spacing=0.3)
    beside = ds.cg.coarse_grain([*names, *ASKED[1:]], width=WIDTH, spacing=0.3)
    for name in names:
        xr.testing.assert_equal(alone[name].variable, beside[name].variable)


@pytest.mark.parametrize("shape", [(N, 2), (N + 1,), (2, N), (N, 3, 3, 3)])
def test_arrays_of_other_shapes_raise(shape):
    with pytest.raises(xcg.SceneError, match="'own'"):
        xcg.scene_from_arrays(arrays()["position"], own=np.zeros(shape))


def test_own_variables_of_a_series_may_be_stacks_or_lists():
    position = (
        np.zeros((2, 3, 3)) + np.arange(3)[:, None]
    )  # two steps of three grains: what is (2, 3) is no vector
    ds = xcg.scene_from_arrays(
        position, q=np.zeros((2, 3)), w=[np.ones((3, 3))] * 2, tensor=np.zeros((2, 3, 3, 3))
    )
    assert ds.q.dims == ("time", "particle")
    assert ds.w.dims == ("time", "particle", "component")
    assert ds.tensor.dims == ("time", "particle", "component", "direction")
    one = xcg.scene_from_arrays(position[0], q=np.zeros((1, 3)), w=np.ones((3, 3)))
    assert one.q.dims == ("time", "particle", "component") or one.q.sizes["particle"] == 3


def test_names_with_contact_are_variables_of_contacts():
    given = {"diameter": np.ones(3), "density": 1.0}
    with pytest.raises(
        xcg.SceneError, match=r"'contact_heat' is a variable of contacts.*there are none"
    ):
        xcg.scene_from_arrays(np.eye(3) * 5, contact_heat=np.ones(3), **given)
    ds = xcg.datasets.random_scene(20).assign(contact_heat=(("time", "particle"), np.ones((1, 20))))
    with pytest.raises(
        xcg.SceneError,
        match=r"has the dimensions .*names that begin with 'contact_'.* another name",
    ):
        ds.cg.coarse_grain("contact_heat")


# --- averages along an axis ------------------------------------------------------------------------------


def test_the_mean_of_a_linear_temperature_is_linear():
    rng = np.random.default_rng(3)
    position = rng.random((300, 3)) * [1.0, 1.0, 2.0]
    ds = xcg.scene_from_arrays(
        position, diameter=np.full(300, 0.1), density=1000.0, velocity=rng.normal(size=(300, 3)),
        box={"x": (0, 1), "y": (0, 1), "z": (0, 2)}, periodic="xyz",
    )  # fmt: skip
    ds = ds.assign(
        temperature=(("time", "particle"), 290.0 + 10.0 * position[None, :, 2], {"units": "K"})
    )
    f = ds.cg.coarse_grain(
        ["velocity", "temperature", xcg.Flux("temperature")], width=0.2, axes="z"
    )
    assert f.temperature.dims == ("time", "z")
    assert f.temperature.attrs["units"] == "K"
    middle = f.temperature.sel(z=slice(0.6, 1.4)).isel(time=0)
    np.testing.assert_allclose(middle, 290.0 + 10.0 * middle.z, atol=0.7)
    weighed = f.temperature.attrs["weight"]
    average = ds.cg.coarse_grain(["temperature", weighed], width=0.2, axes="z").cg.profile("z")
    np.testing.assert_allclose(average.temperature, f.temperature)
