"""What flows along contacts: by its definition, and in the balance with what grains carry and what they hold."""

from itertools import product

import numpy as np
import pytest
import xarray as xr
from numpy.polynomial import Polynomial

import xcg
from tests.brute_force import BruteKernel

WIDTH = 0.8


def heated_grains(periodic="xy", *, heat=1.0, **options):
    ds = xcg.datasets.random_scene(60, periodic=periodic, seed=2, **options)
    rate = np.random.default_rng(5).normal(size=ds.sizes["contact"]) * heat
    return ds.assign(contact_heat=(("time", "contact"), rate[None], {"units": "W"}))


def sides(ds):
    """Grain, contact point relative to it, and received rate of each side of each contact that is a grain."""
    g = ds.isel(time=0)
    edge = np.array([5.0 if a in ds.periodic else 0.0 for a in "xyz"])
    for i, j, point, rate in zip(g.contact_i.values, g.contact_j.values, g.contact_point.values,
                                 g.contact_heat.values, strict=True):  # fmt: skip
        for grain, received in ((i, rate), (j, -rate)):
            if grain >= 0:
                b = point - g.position.values[grain]
                yield grain, b - edge * np.rint(b / np.where(edge > 0, edge, 1.0)), received


def shifts(ds):
    return np.array(
        list(product(*((-5.0, 0.0, 5.0) if a in ds.periodic else (0.0,) for a in "xyz")))
    )


@pytest.mark.parametrize("periodic", ["", "xy", "xyz"])
def test_conduction_equals_its_definition(periodic):
    ds = heated_grains(periodic)
    kernel = BruteKernel("lucy", WIDTH)
    nodes = np.random.default_rng(1).uniform(0.2, 4.8, (7, 3))
    s, weights = np.polynomial.legendre.leggauss(120)
    expected = np.zeros_like(nodes)
    for grain, b, received in sides(ds):
        line = ds.position.values[0, grain] + (1 + s)[:, None] / 2 * b
        for shift in shifts(ds):
            psi = kernel(np.linalg.norm(nodes[:, None] - line - shift, axis=-1))
            expected += (
                received * (psi @ weights / 2)[:, None] * -b
            )  # from the contact point to the centre
    at = {a: xr.DataArray(nodes[:, k], dims="place") for k, a in enumerate("xyz")}
    q = ds.cg.coarse_grain(
        xcg.Conduction("contact_heat"), at=at, width=WIDTH
    ).conduction_contact_heat
    np.testing.assert_allclose(q[0], expected, atol=1e-6 * np.abs(expected).max())
    assert q.attrs["units"] == "W m^-2"


# Lucy's kernel 105 / (16 pi c^3) (1 + 3q)(1 - q)^3, integrated over planes, and then along the normal
LUCY = Polynomial([1, 3]) * Polynomial([1, -1]) ** 3
OVER_PLANE = (LUCY * Polynomial([0, 1])).integ()
BEYOND = (OVER_PLANE(1) - OVER_PLANE).integ()


def marginal(x, c):
    return 105 / (8 * c) * (OVER_PLANE(1) - OVER_PLANE(np.minimum(np.abs(x) / c, 1)))


def cumulative(x, c):
    return 0.5 + np.sign(x) * 105 / 8 * BEYOND(np.minimum(np.abs(x) / c, 1))


@pytest.mark.parametrize("periodic", ["", "xy", "xyz"])
def test_the_heat_balance_closes(periodic):
    """Content between two planes changes by what grains carry, what contacts conduct, and what walls give."""
    ds, c, (low, high) = heated_grains(periodic), 2 * WIDTH, (0.4, 3.1)
    r = ds.position.values[0]
    v = ds.velocity.values[0]
    content = np.random.default_rng(3).normal(size=len(r)) + 300.0
    gained = np.zeros(len(r))
    for grain, _, received in sides(ds):
        gained[grain] += received
    images = 5.0 * np.arange(-2, 3)[:, None] if "z" in periodic else 0.0

    def within(z):
        return np.atleast_2d(
            cumulative(z + images - low, c) - cumulative(z + images - high, c)
        ).sum(0)

    def passing(z):
        return np.atleast_2d(marginal(z + images - low, c) - marginal(z + images - high, c)).sum(0)

    change = gained @ within(r[:, 2]) + (content * v[:, 2]) @ passing(r[:, 2])
    wall = ds.contact_j.values[0] < 0
    assert wall.any() == (periodic != "xyz")
    given = ds.contact_heat.values[0][wall] @ within(ds.contact_point.values[0, wall, 2])

    ds = ds.assign(content=(("time", "particle"), content[None], {"units": "J"}))
    asked = [xcg.Flux("content", "number"), xcg.Mean("content", "number"), xcg.Sum("velocity", "number", "moved"),
             xcg.Conduction("contact_heat")]  # fmt: skip
    planes = {"z": xr.DataArray([low, high], dims="plane")}
    f = ds.cg.coarse_grain(asked, at=planes, width=WIDTH, extent={"x": 1.0, "y": 1.0}).isel(time=0)
    flux = f.flux_content + f.content * f.moved + f.conduction_contact_heat
    out = float(flux.sel(component="z").diff("plane").item())
    scale = np.abs(content * v[:, 2]).sum()
    assert change == pytest.approx(given - out, abs=1e-12 * scale)
    assert abs(float(f.conduction_contact_heat.sel(component="z").diff("plane").item())) > 1e-2


def test_heat_flows_from_j_to_i_and_phases_add_up():
    ds = xcg.scene_from_arrays(
        [[0.0, 0, 0], [1.0, 0, 0]], velocity=np.zeros((2, 3)), diameter=[1.0, 1.0], density=1.0, contact_i=[0],
        contact_j=[1], contact_force=[[0.0, 0, 0]], contact_point=[[0.5, 0, 0]], contact_heat=[2.0], species=[1, 2],
    )  # fmt: skip
    f = ds.cg.coarse_grain("conduction(contact_heat)", by="species", width=2.0, axes="",
                           extent={"x": 1, "y": 1, "z": 1})  # fmt: skip
    q = f.conduction_contact_heat.isel(time=0).transpose("phase", "component")
    np.testing.assert_allclose(q, [[-2.0, 0, 0], [-1.0, 0, 0], [-1.0, 0, 0]], atol=1e-12)


def test_wrong_conduction_raises():
    ds = heated_grains()
    for given, error, message in (
        (xcg.Conduction("mass"), ValueError, "one number for each contact"),
        (xcg.Conduction("contact_force"), ValueError, "one number for each contact"),
        (xcg.Conduction("contact_heat", "mass"), ValueError, "no mass"),
        (xcg.Conduction("contact_het"), xcg.SceneError, "contact_heat"),
    ):
        with pytest.raises(error, match=message):
            ds.cg.coarse_grain(given)
