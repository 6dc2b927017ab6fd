"""Flow through surfaces against sums written out: all that flows, parts of surfaces, and what left a silo."""

from itertools import product

import numpy as np
import pytest

import xcg
from tests.fields.formulas.test_field import LUCY, cumulative, marginal

ALL = ["mass", "number", "volume", "momentum", "energy"]


def lucy(distance, c):
    q = np.minimum(distance / c, 1)
    return 105 / (16 * np.pi * c**3) * LUCY(q)


def images(ds, reach=2):
    edges = np.diff(ds.box.values[0], axis=1)[:, 0]
    ranges = [range(-reach, reach + 1) if a in ds.periodic else (0,) for a in "xyz"]
    return np.array(list(product(*ranges))) * edges


def of_grains(ds, chosen=slice(None)):
    """Position, velocity, mass, volume, and kinetic energy of the grains of the first step."""
    g = ds.isel(time=0)
    r, v, omega = (g[name].values[chosen] for name in ("position", "velocity", "angular_velocity"))
    m, inertia = g.mass.values[chosen], g.moment_of_inertia.values[chosen]
    return r, v, m, g.volume.values[chosen], (m * (v**2).sum(1) + inertia * (omega**2).sum(1)) / 2


def by_definition(ds, point, normal, c):
    """Rates through a whole plane, by the kernel's marginal; images along the plane are what the others add up to."""
    n = np.asarray(normal, float) / np.linalg.norm(normal)
    r, v, m, volume, energy = of_grains(ds)
    shifts = np.unique(np.round(images(ds) @ n, 9))
    one = np.sum([marginal((r - point) @ n + s, c) for s in shifts], axis=0) * (v @ n)
    out = {"mass": m @ one, "number": one.sum(), "volume": volume @ one, "energy": energy @ one}
    out["momentum"] = (m * one) @ v
    g = ds.isel(time=0)
    edges = np.where([a in ds.periodic for a in "xyz"], np.diff(ds.box.values[0], axis=1)[:, 0], 0.0)
    for i, j, f, place in zip(g.contact_i.values, g.contact_j.values, g.contact_force.values, g.contact_point.values,
                              strict=True):  # fmt: skip
        for grain, force in ((i, f), (j, -f)):
            if grain < 0:
                continue
            b = place - r[grain]
            b -= edges * np.rint(b / np.where(edges > 0, edges, 1.0))
            at, x = r[grain], place  # the image of the contact near the grain
            x = at + b
            part = sum(cumulative((at - point) @ n + s, c) - cumulative((x - point) @ n + s, c) for s in shifts)
            out["momentum"] = out["momentum"] + force * part
            u = v[grain] + np.cross(g.angular_velocity.values[grain], b)
            out["energy"] += force @ u * part
    return out


@pytest.mark.parametrize(
    ("periodic", "normal"),
    [("xyz", (0, 0, -2)), ("xy", (0, 0, 1)), ("", (1, 0, 0)), ("", (1, 2, -3)), ("y", (1, 0, 2)), ("xz", (0, 1, 0))],
)
def test_whole_planes_by_definition(periodic, normal):
    ds = xcg.datasets.random_scene(120, periodic=periodic, seed=4)
    point = np.array([2.2, 2.5, 2.4])
    q = ds.cg.flow_rate(xcg.Plane(point, normal), ALL, width=0.7)
    expected = by_definition(ds, point, normal, 1.4)
    for name in ALL:
        np.testing.assert_allclose(q[f"{name}_flow_rate"][0], expected[name], rtol=1e-9, atol=1e-9)


def test_coordinates_of_the_plane_are_left_out():
    ds = xcg.datasets.random_scene(300, periodic="xyz").chunk(time=1)
    q = ds.cg.flow_rate(xcg.Plane((0, 0, 0.1), (0, 0, 1)))
    p = ds.cg.coarse_grain("momentum_density", axes="", at={"z": 0.1})
    np.testing.assert_allclose(q.mass_flow_rate, p.momentum_density.sel(component="z") * 25, rtol=1e-10)
    assert set(q.coords) == {"time", "step"}


def through_pieces(ds, places, across, c):
    """Integrals by places (n, 3) and n dA (n, 3) of many more pieces, and what crosses in either direction."""
    r, v, m, *_ = of_grains(ds)
    total = either = 0.0
    low, high = places.min(axis=0) - c, places.max(axis=0) + c
    for shift in images(ds, 1):
        near = ((r + shift > low) & (r + shift < high)).all(axis=1)
        for one, u, mass in zip((r + shift)[near], v[near], m[near], strict=True):
            psi = lucy(np.linalg.norm(places - one, axis=1), c)
            total += mass * (psi @ across) @ u
            either += mass * psi @ np.abs(across @ u)
    return total, either


def middles(low, high, count):
    return low + (high - low) * (np.arange(count) + 0.5) / count


def rectangle(count=100):
    x, y = (a.ravel() for a in np.meshgrid(middles(0.5, 3.5, count), middles(1.0, 4.5, count)))
    places = np.stack([x, y, np.full(x.size, 2.0)], axis=1)
    return places, np.full((x.size, 1), 3.0 * 3.5 / x.size) * [0, 0, 1.0]


def mantle(count=100):
    theta, z = (a.ravel() for a in np.meshgrid(middles(0, 2 * np.pi, count), middles(0.5, 4.0, count)))
    out = np.stack([np.cos(theta), np.sin(theta), 0 * theta], axis=1)
    places = [2.5, 2.5, 0] + 1.6 * out + z[:, None] * [0, 0, 1]
    return places, out * (2 * np.pi * 1.6 * 3.5 / theta.size)


TRIANGLES = xcg.Surface(np.array([[0.5, 1, 2], [3.5, 1, 2], [3.5, 4.5, 2], [0.5, 4.5, 2]]), [[0, 1, 2], [0, 2, 3]])
PARTS = {
    "rectangle": (xcg.Plane((0, 0, 2), (0, 0, 1), bounds=((0.5, 3.5), (1.0, 4.5))), rectangle),
    "triangles": (TRIANGLES, rectangle),
    "cylinder": (xcg.Cylinder((2.5, 2.5, 0), (0, 0, 1), 1.6, inside=False, low=0.5, high=4.0), mantle),
}


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_parts_err_by_less_than_they_say(part, seed):
    surface, pieces = PARTS[part]
    ds = xcg.datasets.random_scene(100, periodic="xyz", seed=seed)
    expected, either = through_pieces(ds, *pieces(), 1.0)
    error = [abs(float(ds.cg.flow_rate(surface, width=0.5, spacing=h).mass_flow_rate[0]) - expected) / either
             for h in (None, 0.25)]  # fmt: skip
    assert error[0] < 1e-3
    assert error[1] < 4e-3


def test_what_left_the_silo():
    """Steps are far apart, and the flow through the slot is not steady: some percent."""
    ds = xcg.datasets.open("hopper_6").compute()
    q = ds.cg.flow_rate(xcg.Plane((0, 0, 8), (0, 0, -1)), width=1.0).mass_flow_rate
    z, m = ds.position.sel(component="z").values, ds.mass.values[0]
    fallen = (z[:-1] - z[1:] + 2.0) % 34 - 2.0  # to where it falls back at the top, but for jumps upwards
    count = np.floor((z[:-1] - 8) / 34) - np.floor((z[:-1] - fallen - 8) / 34)
    assert float(q.integrate("time")) == pytest.approx((count * m).sum(), rel=0.05)
