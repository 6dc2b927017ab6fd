"""Selections of grains keep their contacts: parts add up to the whole, and contacts outside are kept or dropped."""

import dask
import numpy as np
import pytest
import xarray as xr

import xcg
from tests.scenes import random_steps

MESH = {"width": 0.8, "spacing": 1.25, "bounds": dict.fromkeys("xyz", (0.0, 3.75))}
SUMS = ["density", "momentum_density", "contact_stress"]


@pytest.fixture(scope="module")
def scene():
    return random_steps(3)


def _refuse(*args, **options):
    raise AssertionError("nothing may be computed while a graph is built")


def pairs_of(ds, t=0):
    """Return the contacts of a step as a set of (i, j, force)."""
    rows = ds.contact_i[t].values >= 0
    force = ds.contact_force[t].values[rows]
    ends = (ds.contact_i[t].values[rows].tolist(), ds.contact_j[t].values[rows].tolist())
    return {(i, j, *f) for i, j, f in zip(*ends, force.tolist(), strict=True)}


@pytest.mark.parametrize("lazy", [False, True])
def test_the_stress_of_a_selection_and_of_the_others_add_up(scene, lazy):
    ds = scene.chunk(time=1) if lazy else scene
    upper = ds.position.sel(component="z") > 2.0
    whole = ds.cg.coarse_grain(SUMS, **MESH)
    parts = [ds.cg.select(chosen).cg.coarse_grain(SUMS, **MESH) for chosen in (upper, ~upper)]
    for name in SUMS:
        expected = whole[name]
        total = parts[0][name] + parts[1][name]
        scale = float(abs(expected).max())
        np.testing.assert_allclose(total, expected, rtol=0, atol=1e-13 * scale)


@pytest.mark.parametrize("sample", ["silo", "glued", "suspension", "plane_shear", "biaxial"])
def test_the_mean_stress_of_samples_is_that_of_their_parts(sample):
    ds = xcg.datasets.open(sample).isel(time=[-1])
    axis = ds.attrs["plane"][-1]
    middle = float(ds.position.sel(component=axis).compute().median())
    options = {
        "axes": "",
        "width": 2 * ds.attrs["d43"],
        "extent": dict.fromkeys(ds.attrs["plane"], 1.0),
    }
    stress = [
        s.cg.coarse_grain("contact_stress", **options).contact_stress.compute()
        for s in (ds, ds.cg.select(f"{axis} > {middle}"), ds.cg.select(f"{axis} <= {middle}"))
    ]
    atol = 1e-13 * float(abs(stress[0]).max())
    np.testing.assert_allclose(stress[1] + stress[2], stress[0], rtol=0, atol=atol)


@pytest.mark.parametrize("outside", ["keep", "drop"])
def test_contacts_equal_those_of_a_loop(scene, outside):
    chosen = scene.cg.select(scene.species == 1, outside=outside)
    for t in range(3):
        ids = set(scene.particle_id[t].values[scene.species[t].values == 1].tolist())
        assert set(chosen.particle_id[t].values.tolist()) - {-1} == ids
        expected = set()
        for i, j, *force in pairs_of(scene, t):
            inside = [end in ids for end in (i, j)]
            others = [end >= 0 and end not in ids for end in (i, j)]
            if any(inside) and not (outside == "drop" and any(others)):
                expected.add((i, j, *force))
        assert pairs_of(chosen, t) == expected


def test_a_selection_is_the_phase(scene):
    chosen = scene.cg.select("species == 2").cg.coarse_grain(SUMS, **MESH)
    phase = scene.cg.coarse_grain(SUMS, by="species", **MESH).sel(phase="2", drop=True)
    for name in SUMS:
        np.testing.assert_allclose(chosen[name], phase[name], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "condition"),
    [
        ("z > 2 and diameter < 0.9", lambda s: (s.position[..., 2] > 2) & (s.diameter < 0.9)),
        ("vx < 0 or species == 1", lambda s: (s.velocity[..., 0] < 0) | (s.species == 1)),
        ("not (vy > x)", lambda s: ~(s.velocity[..., 1] > s.position[..., 0])),
        ("particle_id % 2 == 0", lambda s: s.particle_id % 2 == 0),
    ],
)
def test_expressions_are_conditions(scene, text, condition):
    xr.testing.assert_identical(
        scene.cg.select(text),
        scene.cg.select(condition(scene).drop_vars("component", errors="ignore")),
    )


def test_lazy_selections_compute_nothing_and_equal_eager_ones(scene):
    lazy = scene.chunk(time=1)
    with dask.config.set(scheduler=_refuse):
        chosen = lazy.cg.select("z > 2")
        fields = chosen.cg.coarse_grain(SUMS, **MESH)
    assert chosen.contact_force.chunks is not None
    eager = scene.cg.select("z > 2")
    assert eager.isel(time=[0]).cg.select("z > 2").sizes["contact"] < scene.sizes["contact"]
    np.testing.assert_array_equal(
        fields.contact_stress, eager.cg.coarse_grain(SUMS, **MESH).contact_stress
    )
    assert float(chosen.diameter.mean()) == pytest.approx(float(eager.diameter.mean()), rel=1e-14)
    one = scene.isel(time=0)
    assert "time" not in one.cg.select(one.diameter > 0.5).dims
    assert pairs_of(one.cg.select("z > 2").expand_dims("time")) == pairs_of(eager)


def test_wrong_conditions_raise(scene):
    cases = [
        ("height > 2", ValueError, "unknown variable 'height'"),
        ("diamter > 2", ValueError, "did you mean 'diameter'"),
        ("z >", ValueError, r"select\('z >'\)"),
        ("z", TypeError, "expected an array of truth values"),
        (2.0, TypeError, "not float"),
        (scene.position > 2, ValueError, "take one component"),
        (scene.diameter.isel(time=0) > 0.5, ValueError, r"ds\.particle_id\.isin\(ids\)"),
        (scene.diameter.isel(particle=slice(3)) > 0.5, ValueError, "has the sizes"),
    ]
    for condition, kind, message in cases:
        with pytest.raises(kind, match=message):
            scene.cg.select(condition)
    with pytest.raises(ValueError, match="outside='all': expected one of 'keep', 'drop'"):
        scene.cg.select("z > 2", outside="all")
    with pytest.raises(xcg.SceneError, match="select needs"):
        scene.cg.coarse_grain("density", axes="z").cg.select("z > 2")
