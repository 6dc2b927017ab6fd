"""Flow through surfaces: brute force, sums, closed surfaces. Traction on walls: closed forms, what LAMMPS says."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import xcg
from tests.dumps import BOX, dump_text, write
from tests.fields.formulas.test_field import LUCY, cumulative, marginal
from tests.scene.test_contacts import DATA, GRAVITY, SUMS, WALLS
from xcg.analysis.surfaces import _points
from xcg.fields.grids.walls import Wall

L = np.array([6.0, 5.0, 4.0])


def falling_grains(periodic="xy", count=120, seed=3, steps=1, dt=0.0, contacts=False):
    rng = np.random.default_rng(seed)
    start = rng.uniform(0, 1, (count, 3)) * L
    velocity = rng.normal([0.3, 0.1, -0.5], size=(count, 3))
    diameter = rng.uniform(0.6, 1.0, count)
    position = start + velocity * dt * (np.arange(steps) - (steps - 1) / 2)[:, None, None]
    more = {}
    if contacts:
        i = np.arange(0, count - 1, 2)
        j = np.arange(1, count, 2)
        position[..., j, :] = start[j] = start[i] + rng.uniform(-0.4, 0.4, (len(i), 3))
        more = {"contact_i": i, "contact_j": j, "contact_force": rng.normal(size=(len(i), 3)),
                "contact_point": (start[i] + start[j]) / 2}  # fmt: skip
    return xcg.scene_from_arrays(
        position if steps > 1 else position[0], velocity=np.broadcast_to(velocity, position.shape)[: steps or 1]
        if steps > 1 else velocity, diameter=diameter, density=2.0, species=1 + (diameter > 0.8),
        box={a: (0.0, float(length)) for a, length in zip("xyz", L, strict=True)}, periodic=periodic,
        time=np.arange(steps) * (dt or 1.0), **more,
    )  # fmt: skip


def plane_marginal(width, x):
    """Lucy's kernel of three dimensions, integrated over planes by Gauss's rule."""
    c = 2 * width
    nodes, weights = np.polynomial.legendre.leggauss(60)
    x = np.abs(x)[..., None]
    reach = np.sqrt(np.maximum(c**2 - x**2, 0.0))
    s = reach * (nodes + 1) / 2
    q = np.sqrt(x**2 + s**2) / c
    psi = np.where(q < 1, 105 / (16 * np.pi * c**3) * (1 - 6 * q**2 + 8 * q**3 - 3 * q**4), 0.0)
    return (psi * 2 * np.pi * s * weights * reach / 2).sum(-1)


def images(ds, k, reach=2):
    shift = np.zeros((2 * reach + 1, 1, 3))
    if "xyz"[k] in ds.attrs["periodic"]:
        shift[:, 0, k] = L[k] * np.arange(-reach, reach + 1)
    else:
        shift = shift[:1]
    return ds.position.values[0] + shift


@pytest.mark.parametrize("periodic", ["", "xy", "xyz"])
@pytest.mark.parametrize("k", [0, 2])
def test_a_whole_plane_by_brute_force(periodic, k):
    ds = falling_grains(periodic, contacts=True)
    width = 0.8
    place = 1.7
    normal = -2.0 * np.eye(3)[k]
    point = np.full(3, 0.4)
    point[k] = place
    q = ds.cg.flow_rate(
        xcg.Plane(point, normal), ["mass", "number", "volume", "momentum"], width=width
    )
    v, m, volume = (ds[name].values[0] for name in ("velocity", "mass", "volume"))
    psi = plane_marginal(width, images(ds, k)[..., k] - place).sum(0)
    for name, weight in (("mass", m), ("number", np.ones_like(m)), ("volume", volume)):
        assert q[f"{name}_flow_rate"].item() == pytest.approx(
            -(weight * v[:, k] * psi).sum(), rel=1e-10
        )
    stress = ds.cg.coarse_grain("contact_stress", width=width, axes="", at={"xyz"[k]: place},
                                extent={a: 1.0 for j, a in enumerate("xyz") if j != k})  # fmt: skip
    expected = (
        -(m[:, None] * v * v[:, [k]] * psi[:, None]).sum(0)
        - stress.contact_stress.values.reshape(3, 3)[:, k]
    )
    np.testing.assert_allclose(q.momentum_flow_rate.values[0], expected, rtol=1e-9, atol=1e-9)
    assert q.mass_flow_rate.attrs["units"] == "kg s^-1"
    assert q.momentum_flow_rate.attrs["units"] == "N"


def test_momentum_density_times_the_area():
    ds = falling_grains("xyz")
    p = ds.cg.coarse_grain("momentum_density", width=1.0, axes="", at={"z": 2.0})
    q = ds.cg.flow_rate(xcg.Plane((0, 0, 2.0), (0, 0, 1)), width=1.0)
    assert q.mass_flow_rate.item() == pytest.approx(
        p.momentum_density.sel(component="z").item() * L[0] * L[1], rel=1e-10
    )


def test_a_tilted_plane_by_brute_force():
    ds = falling_grains("")
    width = 0.8
    normal = np.array([1.0, 2.0, -0.5])
    point = np.array([3.0, 2.0, 2.0])
    q = ds.cg.flow_rate(xcg.Plane(point, normal), ["mass", "momentum"], width=width)
    n = normal / np.linalg.norm(normal)
    v = ds.velocity.values[0]
    m = ds.mass.values[0]
    psi = plane_marginal(width, (ds.position.values[0] - point) @ n)
    assert q.mass_flow_rate.item() == pytest.approx((m * (v @ n) * psi).sum(), rel=1e-10)
    np.testing.assert_allclose(
        q.momentum_flow_rate.values[0], (m[:, None] * v * (v @ n)[:, None] * psi[:, None]).sum(0)
    )
    with pytest.raises(xcg.SceneError, match="average"):
        falling_grains("xyz").cg.flow_rate(xcg.Plane(point, normal), width=width)


def test_phases_add_up():
    ds = falling_grains()
    q = ds.cg.flow_rate(
        xcg.Plane((0, 0, 2), (0, 0, 1)), ["mass", "momentum"], width=1.0, by="species"
    )
    for name in q.data_vars:
        parts = q[name].sel(phase=["1", "2"]).sum("phase")
        xr.testing.assert_allclose(parts, q[name].sel(phase="bulk", drop=True))


def faces(low, high):
    """Six sides of a box, with normals that point out."""
    found = []
    for k in range(3):
        bounds = [(low[j], high[j]) for j in range(3) if j != k]
        for end, sign in ((low, -1.0), (high, 1.0)):
            found.append(xcg.Plane(end, sign * np.eye(3)[k], bounds=bounds))
    return found


def mass_within(ds, low, high, width):
    """Smoothed mass within a box: the density at Gauss points of small cells."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    x = [a + (b - a) * (nodes + 1) / 2 for a, b in zip(low, high, strict=True)]
    w = np.einsum("i,j,k->ijk", *([weights / 2] * 3)).ravel() * np.prod(np.subtract(high, low))
    grid = np.stack(np.meshgrid(*x, indexing="ij"), -1).reshape(-1, 3)
    at = {a: xr.DataArray(grid[:, k], dims="place") for k, a in enumerate("xyz")}
    return (
        ds.cg.coarse_grain("density", width=width, at=at).density * xr.Variable("place", w)
    ).sum("place")


def test_outflow_of_a_closed_box_is_its_loss_of_mass():
    ds = falling_grains("", count=60, steps=3, dt=1e-3)
    low = [1.5, 1.2, 1.0]
    high = [4.2, 3.9, 3.1]
    width = 0.7
    mass = mass_within(ds, low, high, width)
    rate = float(mass[2] - mass[0]) / float(ds.time[2] - ds.time[0])
    out = sum(
        ds.cg.flow_rate(face, width=width).mass_flow_rate.values[1] for face in faces(low, high)
    )
    scale = float(ds.mass[0].sum())
    assert rate == pytest.approx(-out, abs=1e-3 * scale)
    assert abs(rate) > 0.02 * scale


def test_triangles_and_cylinders_are_sums_over_points():
    ds = falling_grains("", count=200)
    width = 0.8
    bounds = ((1.0, 5.0), (0.5, 4.5))
    plane = ds.cg.flow_rate(
        xcg.Plane((0, 0, 2.0), (0, 0, 1), bounds=bounds), ["mass", "momentum"], width=width
    )
    corners = np.array([[1.0, 0.5, 2.0], [5.0, 0.5, 2.0], [5.0, 4.5, 2.0], [1.0, 4.5, 2.0]])
    same = ds.cg.flow_rate(
        xcg.Surface(corners, np.array([[0, 1, 2], [0, 2, 3]])), ["mass", "momentum"], width=width
    )
    scale = float((ds.mass * abs(ds.velocity).sum("component")).sum())
    for name in ("mass_flow_rate", "momentum_flow_rate"):
        np.testing.assert_allclose(same[name], plane[name], atol=1e-3 * scale)
    # a wide enough part is the whole
    whole = ds.cg.flow_rate(xcg.Plane((0, 0, 2.0), (0, 0, 1)), width=width).mass_flow_rate.item()
    part = xcg.Plane((0, 0, 2.0), (0, 0, 1), bounds=((-3, 9), (-3, 8)))
    assert ds.cg.flow_rate(part, width=width).mass_flow_rate.item() == pytest.approx(
        whole, rel=1e-5
    )
    # a cylinder about all grains with two lids far away is passed by none
    side = xcg.Cylinder((3, 2.5, 0), (0, 0, 1), 12.0, inside=False, low=-4.0, high=8.0)
    assert abs(ds.cg.flow_rate(side, width=width, spacing=0.5).mass_flow_rate.item()) < 1e-12


@pytest.mark.parametrize("spacing", [9.0, 1.0, 0.3])
def test_parts_of_a_triangle_have_its_area_and_its_centre(spacing):
    """Parts are congruent, so that the sum is exact for whatever varies linearly over the triangle."""
    corners = np.array([[1.0, 0.5, 2.0], [5.0, 1.5, 2.5], [2.0, 4.5, -1.0]])
    cells = _points(xcg.Surface(corners, [[0, 1, 2]]), None, spacing)
    centre = cells.centre
    area = cells.area
    whole = 0.5 * np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0]))
    assert area.sum() == pytest.approx(whole)
    np.testing.assert_allclose(area @ centre / whole, corners.mean(axis=0), rtol=1e-12)
    gaps = np.linalg.norm(centre[:, None] - centre, axis=2)[~np.eye(len(centre), dtype=bool)]
    assert len(centre) == 1 or 0.3 * spacing < gaps.min() < spacing


def test_lazy_flow_rates_equal_eager_ones_also_of_one_step():
    ds = falling_grains(steps=4, dt=0.1)
    plane = xcg.Plane((0, 0, 2), (0, 0, 1))
    eager, lazy = (one.cg.flow_rate(plane, width=1.0) for one in (ds, ds.chunk(time=1)))
    assert lazy.mass_flow_rate.chunks is not None
    np.testing.assert_array_equal(lazy.mass_flow_rate, eager.mass_flow_rate)
    assert ds.isel(time=0).cg.flow_rate(plane, width=1.0).mass_flow_rate.dims == ()


def test_energy_of_grains_without_contacts():
    ds = falling_grains("xy")
    width = 0.9
    v = ds.velocity.values[0]
    m = ds.mass.values[0]
    psi = plane_marginal(width, ds.position.values[0][:, 2] - 2.0)
    q = ds.cg.flow_rate(xcg.Plane((0, 0, 2.0), (0, 0, 1)), "energy", width=width)
    assert q.energy_flow_rate.item() == pytest.approx(
        (0.5 * m * (v**2).sum(1) * v[:, 2] * psi).sum(), rel=1e-10
    )
    assert ("comment" in q.energy_flow_rate.attrs) == ("contact_force" not in ds)
    alone = ds.drop_dims("contact", errors="ignore").cg.flow_rate(
        xcg.Plane((0, 0, 2.0), (0, 0, 1)), "momentum", width=width
    )
    assert "comment" in alone.momentum_flow_rate.attrs


@pytest.mark.parametrize(
    "lacking", [["angular_velocity"], ["moment_of_inertia"], ["angular_velocity", "contact_force"]]
)
def test_energy_without_rotation_says_so(lacking):
    ds = xcg.datasets.random_scene(50)
    plane = xcg.Plane((0, 0, 2.0), (0, 0, 1))
    ds = ds.assign(angular_velocity=ds.velocity / 0.5)
    assert "comment" not in ds.cg.flow_rate(plane, "energy").energy_flow_rate.attrs
    part = ds.drop_vars(lacking)
    comment = part.cg.coarse_grain("kinetic_energy_flux", axes="z").kinetic_energy_flux.attrs[
        "comment"
    ]
    found = part.cg.flow_rate(plane, ["energy", "mass"])
    assert comment in found.energy_flow_rate.attrs["comment"]
    assert ("particles alone" in found.energy_flow_rate.attrs["comment"]) == (
        "contact_force" in lacking
    )
    assert "comment" not in found.mass_flow_rate.attrs


@pytest.mark.parametrize(("surface", "of", "message"), [
    ("z", "mass", "expected an xcg.Plane"), (xcg.Plane((0, 0, 1), (0, 0, 1)), "maß", "unknown flow 'maß'"),
])  # fmt: skip
def test_wrong_arguments_raise(surface, of, message):
    with pytest.raises(ValueError, match=message):
        falling_grains().cg.flow_rate(surface, of)


def test_a_layer_has_its_thickness():
    ds = xcg.scene_from_arrays(
        [[0.5, 0.5, 0.0], [1.5, 0.5, 0.0]], velocity=[[1.0, 0, 0], [2.0, 0, 0]], diameter=[1.0, 1.0], mass=[3.0, 5.0],
        dimension=2, thickness=0.1, box={"x": (0, 4), "y": (0, 1)}, periodic="y",
    )  # fmt: skip
    kernel = xcg.Lucy(0.6, dimension=2)
    q = ds.cg.flow_rate(xcg.Plane((1.0, 0, 0), (1, 0, 0)), kernel=kernel)
    psi = kernel.value(np.array([0.5, 0.5]), seen=1)
    assert q.mass_flow_rate.item() == pytest.approx((np.array([3.0, 10.0]) * psi).sum(), rel=1e-9)


def layer(box=(), **more):
    """Twenty discs side by side on the floor of a layer about z = 0."""
    place = np.stack([np.arange(20) * 0.25 + 0.1, np.full(20, 0.1), np.zeros(20)], axis=1)
    return xcg.scene_from_arrays(
        place, velocity=np.tile([1.0, 0.5, 0], (20, 1)), diameter=np.full(20, 0.2), density=1.0, dimension=2,
        box={"x": (0, 5), "y": (0, 5), **dict(box)}, periodic="x", contact_i=np.arange(20), contact_j=np.full(20, -2),
        contact_force=np.tile([0, 1.0, 0], (20, 1)), contact_point=place * [1, 0, 1], **more,
    )  # fmt: skip


@pytest.mark.parametrize("normal", [(1, 0, 0), (1, 2, 0)])
@pytest.mark.parametrize(
    ("bounds", "part"), [((-0.5, 0.5), 1), ((-5, 5), 1), ((0, 3), 0.5), ((0.6, 2), 0)]
)
def test_a_surface_counts_within_the_thickness_of_a_layer(normal, bounds, part):
    ds = layer(thickness=1.0)
    ends = ((-2, 2), bounds if normal[1] == 0 else (-bounds[1], -bounds[0]))  # v is along -z
    plane = xcg.Plane((2.5, 0, 0), normal, bounds=ends)
    once = xcg.Plane((2.5, 0, 0), normal, bounds=((-2, 2), (-0.5, 0.5)))
    found, whole = (ds.cg.flow_rate(one, width=0.5).mass_flow_rate.item() for one in (plane, once))
    assert whole != 0
    assert found == pytest.approx(part * whole, rel=1e-9)
    drum = [ds.cg.flow_rate(xcg.Cylinder((2.5, 0.1, 0), (0, 0, 1), 0.3, low=low, high=high), width=0.5)
            for low, high in (bounds, (None, None))]  # fmt: skip
    assert drum[0].mass_flow_rate.item() == pytest.approx(
        part * drum[1].mass_flow_rate.item(), rel=1e-9, abs=1e-15
    )


def test_a_cylinder_without_ends_counts_a_period_of_the_scene():
    ds = xcg.datasets.random_scene(100, periodic="z", walls=False)
    side = xcg.Cylinder((2.5, 2.5, 0), "z", 1.0)
    whole, period = (
        ds.cg.flow_rate(one, width=0.8).mass_flow_rate
        for one in (side, replace(side, low=0.0, high=5.0))
    )
    np.testing.assert_array_equal(whole, period)


def test_grains_beyond_the_ends_of_a_cylinder_warn_where_the_ends_follow_from_a_lazy_scene(
    tmp_path,
):
    for step in range(3):
        rows = [
            f"{k} 1 1 1 {z} 0.1 0.2 0.3 0.5 1" for k, z in enumerate((1, 2, 3 + 4 * (step == 1)))
        ]
        write(tmp_path / f"p.{step}.dump", dump_text(rows, step=step, box=BOX.replace("pp", "ff")))
    ds = xcg.open_scene(tmp_path / "p.*.dump", times=[0.0, 1.0, 2.0])
    side = xcg.Cylinder((1, 1, 0), "z", 0.5)
    flow = ds.cg.flow_rate(side, width=1.0)
    with pytest.warns(xcg.SceneWarning, match=r"grains lie at z from 1 to 7, .* from 1 to 3; give"):
        flow.compute()
    for one in (
        ds.cg.measure().cg.flow_rate(side, width=1.0),
        ds.cg.flow_rate(replace(side, low=0.0, high=9.0)),
    ):
        one.compute()  # without a warning


@pytest.mark.parametrize(("more", "depth"), [
    ({"thickness": 1.0}, 1.0), ({"thickness": 0.1}, 0.1), ({"box": {"z": (-0.1, 0.4)}}, 0.5), ({}, 0.2),
])  # fmt: skip
def test_the_traction_on_the_wall_of_a_layer_is_per_its_thickness(more, depth):
    """20 N on 5 m, without thickness and box by the largest diameter; the same all across the layer."""
    f = layer(**more).cg.wall_stress(xcg.Plane((0, 0, 0), (0, 1, 0)), 0.5)
    np.testing.assert_allclose(f.normal_traction, 4.0 / depth, rtol=1e-9)


@pytest.mark.filterwarnings("ignore:.*no grain reaches any node")  # before and after
def test_the_integral_over_time_is_the_mass_that_crossed():
    """Grains that fall freely from above a plane to below it; the kernel holds nothing on both sides in the end."""
    rng = np.random.default_rng(2)
    start = rng.uniform([0, 0, 4], [6, 5, 6], (80, 3))
    time = np.linspace(0.0, 1.6, 161)
    fall = -0.5 * 9.81 * time**2
    position = start + fall[:, None, None] * [0, 0, 1]
    velocity = np.zeros_like(position) + (-9.81 * time)[:, None, None] * [0, 0, 1]
    ds = xcg.scene_from_arrays(
        position, velocity=velocity, diameter=np.full(80, 0.5), density=1.0, time=time
    )
    q = ds.cg.flow_rate(xcg.Plane((0, 0, 2.0), (0, 0, -1)), width=0.5)
    left = float(q.mass_flow_rate.integrate("time"))
    assert left == pytest.approx(float(ds.mass[0].sum()), rel=1e-4)


# --- sums written out ------------------------------------------------------------------------------------

ALL = ["mass", "number", "volume", "momentum", "energy"]


def lucy(distance, c):
    q = np.minimum(distance / c, 1)
    return 105 / (16 * np.pi * c**3) * LUCY(q)


def images_of(ds, reach=2):
    edges = np.diff(ds.box.values[0], axis=1)[:, 0]
    ranges = [range(-reach, reach + 1) if a in ds.periodic else (0,) for a in "xyz"]
    return np.array(list(product(*ranges))) * edges


def of_grains(ds, chosen=slice(None)):
    """Position, velocity, mass, volume, and kinetic energy of the grains of the first step."""
    g = ds.isel(time=0)
    r, v, omega = (g[name].values[chosen] for name in ("position", "velocity", "angular_velocity"))
    m = g.mass.values[chosen]
    inertia = g.moment_of_inertia.values[chosen]
    return r, v, m, g.volume.values[chosen], (m * (v**2).sum(1) + inertia * (omega**2).sum(1)) / 2


def by_definition(ds, point, normal, c):
    """Rates through a whole plane, by the kernel's marginal; images along the plane are what the others add up to."""
    n = np.asarray(normal, float) / np.linalg.norm(normal)
    r, v, m, volume, energy = of_grains(ds)
    shifts = np.unique(np.round(images_of(ds) @ n, 9))
    one = np.sum([marginal((r - point) @ n + s, c) for s in shifts], axis=0) * (v @ n)
    out = {"mass": m @ one, "number": one.sum(), "volume": volume @ one, "energy": energy @ one}
    out["momentum"] = (m * one) @ v
    g = ds.isel(time=0)
    edges = np.where(
        [a in ds.periodic for a in "xyz"], np.diff(ds.box.values[0], axis=1)[:, 0], 0.0
    )
    for i, j, f, place in zip(g.contact_i.values, g.contact_j.values, g.contact_force.values, g.contact_point.values,
                              strict=True):  # fmt: skip
        for grain, force in ((i, f), (j, -f)):
            if grain < 0:
                continue
            b = place - r[grain]
            b -= edges * np.rint(b / np.where(edges > 0, edges, 1.0))
            at = r[grain]  # the image of the contact near the grain
            x = place
            x = at + b
            part = sum(
                cumulative((at - point) @ n + s, c) - cumulative((x - point) @ n + s, c)
                for s in shifts
            )
            out["momentum"] = out["momentum"] + force * part
            u = v[grain] + np.cross(g.angular_velocity.values[grain], b)
            out["energy"] += force @ u * part
    return out


@pytest.mark.parametrize(
    ("periodic", "normal"),
    [
        ("xyz", (0, 0, -2)),
        ("xy", (0, 0, 1)),
        ("", (1, 0, 0)),
        ("", (1, 2, -3)),
        ("y", (1, 0, 2)),
        ("xz", (0, 1, 0)),
    ],
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
    np.testing.assert_allclose(
        q.mass_flow_rate, p.momentum_density.sel(component="z") * 25, rtol=1e-10
    )
    assert set(q.coords) == {"time", "step"}


def through_pieces(ds, places, across, c):
    """Integrals by places (n, 3) and n dA (n, 3) of many more pieces, and what crosses in either direction."""
    r, v, m, *_ = of_grains(ds)
    total = either = 0.0
    low = places.min(axis=0) - c
    high = places.max(axis=0) + c
    for shift in images_of(ds, 1):
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
    theta, z = (
        a.ravel() for a in np.meshgrid(middles(0, 2 * np.pi, count), middles(0.5, 4.0, count))
    )
    out = np.stack([np.cos(theta), np.sin(theta), 0 * theta], axis=1)
    places = [2.5, 2.5, 0] + 1.6 * out + z[:, None] * [0, 0, 1]
    return places, out * (2 * np.pi * 1.6 * 3.5 / theta.size)


TRIANGLES = xcg.Surface(
    np.array([[0.5, 1, 2], [3.5, 1, 2], [3.5, 4.5, 2], [0.5, 4.5, 2]]), [[0, 1, 2], [0, 2, 3]]
)
PARTS = {
    "rectangle": (xcg.Plane((0, 0, 2), (0, 0, 1), bounds=((0.5, 3.5), (1.0, 4.5))), rectangle),
    "triangles": (TRIANGLES, rectangle),
    "cylinder": (
        xcg.Cylinder((2.5, 2.5, 0), (0, 0, 1), 1.6, inside=False, low=0.5, high=4.0),
        mantle,
    ),
}


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_errors_of_parts_are_below_the_stated_ones(part, seed):
    surface, pieces = PARTS[part]
    ds = xcg.datasets.random_scene(100, periodic="xyz", seed=seed)
    expected, either = through_pieces(ds, *pieces(), 1.0)
    error = [abs(float(ds.cg.flow_rate(surface, width=0.5, spacing=h).mass_flow_rate[0]) - expected) / either
             for h in (None, 0.25)]  # fmt: skip
    assert error[0] < 1e-3
    assert error[1] < 4e-3


def test_flow_out_of_the_silo_is_its_loss_of_grains():
    """Steps are far apart, and the flow through the slot is not steady: some percent."""
    ds = xcg.datasets.open("hopper_6").compute()
    q = ds.cg.flow_rate(xcg.Plane((0, 0, 8), (0, 0, -1)), width=1.0).mass_flow_rate
    z = ds.position.sel(component="z").values
    m = ds.mass.values[0]
    fallen = (
        z[:-1] - z[1:] + 2.0
    ) % 34 - 2.0  # to where it falls back at the top, but for jumps upwards
    count = np.floor((z[:-1] - 8) / 34) - np.floor((z[:-1] - fallen - 8) / 34)
    assert float(q.integrate("time")) == pytest.approx((count * m).sum(), rel=0.05)


# --- traction on walls -----------------------------------------------------------------------------------

DIAMETER = 1.0
FLOOR = xcg.Plane((0, 0, 0), (0, 0, 1))


def touching(point, force, *, depth=0.5, **more):
    """Grains that touch a wall at some points, with some forces on them."""
    point = np.asarray(point, float)
    centre = np.asarray(more.pop("centre", point + np.array([0, 0, depth])), float)
    number = np.full(len(point), -1)
    diameter = np.full(len(point), DIAMETER)
    return xcg.scene_from_arrays(
        centre, diameter=diameter, density=1.0, contact_i=np.arange(len(point)), contact_j=number,
        contact_force=np.asarray(force, float), contact_point=point, **more,
    )  # fmt: skip


def sums(f):
    """Traction times area, normal, along the surface and as a vector, summed over the cells."""
    cells = list(f.area.dims)
    return [
        (f[name] * f.area).sum(cells).to_numpy()
        for name in ("normal_traction", "shear_traction", "traction")
    ]


def plate(count=12):
    """Grains above the centres of the cells of a periodic floor."""
    x = np.arange(count) + 0.5
    return np.stack([*(a.ravel() for a in np.meshgrid(x, x)), np.zeros(count**2)], axis=1)


def test_uniform_pressure_and_shear_on_a_plane():
    point = plate()
    force = np.tile([3.0, -2.0, 7.0], (len(point), 1))  # of the wall on the grains, one a unit area
    ds = touching(point, force, box=[[0, 12], [0, 12], [0, 2]], periodic="xy")
    f = ds.cg.wall_stress(FLOOR, 0.8, spacing=1.0)
    np.testing.assert_allclose(f.normal_traction, 7.0, rtol=1e-12)
    np.testing.assert_allclose(f.shear_traction.sel(along="x"), -3.0, rtol=1e-12)
    np.testing.assert_allclose(f.shear_traction.sel(along="y"), 2.0, rtol=1e-12)
    np.testing.assert_allclose(f.traction.sel(component="z"), -7.0, rtol=1e-12)
    turned = touching(
        point + np.array([0, 0, 1e-3]), force, box=[[0, 12], [0, 12], [0, 2]], periodic="xy"
    )
    np.testing.assert_allclose(
        turned.cg.wall_stress(FLOOR, 0.8, spacing=1.0).normal_traction, 7.0, rtol=1e-12
    )


@pytest.mark.parametrize(("within", "taken"), [(None, 4), (0.3, 3), (0.1, 1)])
def test_contacts_farther_than_within_are_left_out(within, taken):
    """On both sides of the wall; by default up to the width, 0.5."""
    point = np.array([[2.0, 2, 0], [2, 3, 0.29], [3, 2, -0.29], [3, 3, 0.45], [4, 4, 0.55]])
    force = np.arange(15.0).reshape(5, 3)
    f = touching(point, force).cg.wall_stress(FLOOR, 0.5, within=within)
    assert f.wall_contacts.item() == taken
    np.testing.assert_allclose(f.wall_force[0], -force[:taken].sum(axis=0))


def test_a_wall_larger_than_the_grains_says_where_its_cells_end():
    ds = xcg.datasets.random_scene(100, walls=True, periodic="y")
    x = ds.position[0, :, 0]
    radius = ds.diameter[0] / 2
    low = float((x - radius).min())
    high = float((x + radius).max())
    floor = xcg.Plane((0, 0, 0), (0, 0, 1))
    f = ds.cg.wall_stress(floor)
    size = f.x[1] - f.x[0]
    dmax = float(ds.diameter.max()) / 2  # the cells reach as far as the largest grain would
    assert float(f.x[0] - size / 2) <= low < float(f.x[0] - size / 2) + dmax
    assert float(f.x[-1] + size / 2) - dmax < high <= float(f.x[-1] + size / 2)
    assert f"x from {float(f.x[0] - size / 2):.4g}" in f.attrs["comment"]
    assert "y from" not in f.attrs["comment"]
    wider = xcg.Plane((0, 0, 0), (0, 0, 1), bounds=((-3, 8), (0, 5)))
    g = ds.cg.wall_stress(wider)
    assert "comment" not in g.attrs
    np.testing.assert_allclose(g.wall_force, f.wall_force)
    assert not g.normal_traction.sel(x=slice(None, low - 2 * f.attrs["cutoff"])).any()


@pytest.mark.parametrize("direction", [(0, 0, 1), (0, 2, 0), (1, 1, 0.5)])
def test_hydrostatic_pressure_in_a_cylinder(direction):
    """Pressure that falls along the axis and a friction that holds: both come back but for the ends."""
    silo = xcg.Cylinder((1, 2, 3), direction, 5.0, low=0.0, high=20.0)
    cells = silo.cells(np.zeros(3), np.ones(3), 0.5)
    axis = np.array(direction) / np.linalg.norm(direction)
    along = (cells.centre - [1, 2, 3]) @ axis
    inwards = silo.normals_at(cells.centre)
    pressure = 4.0 * (20 - along)
    friction = 0.3 * along
    force = (pressure[:, None] * inwards + friction[:, None] * axis) * cells.area[:, None]
    ds = touching(cells.centre, force, centre=cells.centre + 0.5 * inwards)
    f = ds.cg.wall_stress(silo, 1.0, spacing=0.5)
    inner = f.isel(time=0).sel(z=slice(4.5, 15.5))  # an end is felt two supports away
    law = 4.0 * (20 - inner.z)
    np.testing.assert_allclose(
        inner.normal_traction, law.broadcast_like(inner.normal_traction), rtol=1e-10
    )
    np.testing.assert_allclose(
        inner.shear_traction.sel(along="z").mean("theta"), -0.3 * inner.z, rtol=1e-10
    )
    np.testing.assert_allclose(inner.shear_traction.sel(along="theta"), 0.0, atol=1e-10)
    turn = 1 - (inner.traction * -inwards.reshape(f.centre.shape)[:, 9:31]).sum("component") / law
    assert (
        0 < float(turn.mean()) < (1.0 / 5.0) ** 2
    )  # cos of what the normal turns by within the support


def box_surface(low=0.0, high=6.0) -> xcg.Surface:
    """A closed cube, seen from the inside."""
    corners = np.array(list(np.ndindex(2, 2, 2)), float) * (high - low) + low
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    rows = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    surface = xcg.Surface(corners, rows)
    inside = surface.distance(np.full((1, 3), (low + high) / 2))[0] > 0
    return surface if inside else xcg.Surface(corners, rows, flip=True)


SURFACES: dict[str, Wall] = {
    "plane": FLOOR,
    "tilted plane": xcg.Plane((3, 3, 0), (0.3, 0.1, 1)),
    "cylinder": xcg.Cylinder((3, 3, 0), (0, 0, 1), 3.0),
    "triangles": box_surface(),
}


@pytest.mark.filterwarnings("ignore:all .* grains have")  # they touch the wall
@pytest.mark.parametrize("name", SURFACES)
@pytest.mark.parametrize("width", [0.1, 0.9])
def test_traction_times_area_is_the_sum_of_the_forces(name, width):
    """For any forces anywhere near, however cells and support compare."""
    rng = np.random.default_rng(5)
    wall = SURFACES[name]
    place = rng.uniform(0, 6, (300, 3))
    point = place - wall.distance(place)[:, None] * wall.normals_at(place)
    np.testing.assert_allclose(wall.distance(point), 0, atol=1e-9)
    force = rng.normal(size=(2, 300, 3))
    ds = xcg.scene_from_arrays(
        np.stack([point + 0.4 * wall.normals_at(point)] * 2), diameter=np.full((2, 300), DIAMETER), density=1.0,
        contact_i=np.tile(np.arange(300), (2, 1)), contact_j=np.full((2, 300), -1), contact_force=force,
        contact_point=np.stack([point] * 2),
    )  # fmt: skip
    f = ds.cg.wall_stress(wall, width, spacing=0.5)
    taken = f.wall_contacts.to_numpy()
    assert (taken > 100).all()
    if name == "triangles":
        assert (taken == 300).all()
        np.testing.assert_allclose(f.wall_force, -force.sum(axis=1), atol=1e-11)
    normal, _, vector = sums(f)
    np.testing.assert_allclose(vector, f.wall_force, atol=1e-11)
    if "plane" in name:  # on a flat wall the three say the same
        np.testing.assert_allclose(
            (f.traction**2).sum(), (f.normal_traction**2).sum() + (f.shear_traction**2).sum()
        )
        np.testing.assert_allclose(
            normal, -(f.wall_force.to_numpy() @ wall.normals_at(point[:1])[0]), atol=1e-11
        )
    lazy = ds.chunk(time=1).cg.wall_stress(wall, width, spacing=0.5)
    assert lazy.traction.chunks is not None
    np.testing.assert_array_equal(lazy.traction.to_numpy(), f.traction.to_numpy())


@pytest.mark.filterwarnings("ignore:all .* grains have")  # they touch the wall
@pytest.mark.filterwarnings("ignore:time_average. normal_traction changes")  # it does
def test_averages_over_time_are_means_of_the_steps():
    plates = [
        touching(plate(), np.tile([0.5 * k, 0, k + 1], (144, 1)), time=[float(k)]) for k in range(8)
    ]
    scene = xr.concat(
        plates, "time", data_vars="all", coords="minimal", compat="override", join="override"
    )
    f = scene.cg.wall_stress(xcg.Plane((0, 0, 0), (0, 0, 1), bounds=((0, 12), (0, 12))), width=1.0)
    mean = f.cg.time_average()
    for name in f.data_vars:
        np.testing.assert_allclose(mean[name], f[name].mean("time"), rtol=1e-12, err_msg=name)
        assert f"{name}_error" in mean
    assert (mean.normal_traction_error > 0).all()
    damaged = scene.assign(contact_force=scene.contact_force.where(scene.time != 2.0))
    with pytest.warns(xcg.SkippedStep):
        f_damaged = damaged.cg.wall_stress(
            xcg.Plane((0, 0, 0), (0, 0, 1)), width=1.0, on_error="skip"
        ).compute()
    assert f_damaged.wall_contacts.values.tolist() == [144, 144, -1, *[144] * 5]
    assert np.isnan(f_damaged.cg.time_average().wall_contacts)
    np.testing.assert_allclose(
        f.cg.profile("x").normal_traction, f.normal_traction.mean("y"), rtol=1e-12
    )


def test_kernels_with_negative_parts_lose_no_force_between_coarse_cells():
    xcg.register_kernel("negative parts", lambda q: (1 - q**2) ** 4 * (1 - 3 * q**2), smoothness=3)
    place = np.random.default_rng(5).uniform(0, 6, (300, 3)) * [1, 1, 0]
    ds = touching(place, np.ones((300, 3)), box=[[0, 6], [0, 6], [0, 2]], periodic="xy")
    for kernel in ("lucy", "negative parts"):
        f = ds.cg.wall_stress(FLOOR, 0.9, spacing=2.0, kernel=kernel)
        np.testing.assert_allclose(sums(f)[2], f.wall_force, rtol=1e-11)


def test_walls_of_the_silo_carry_its_weight():
    ds = xcg.open_scene(DATA / "particles.dump.gz", walls=WALLS).compute()
    side = ds.cg.wall_stress(
        xcg.Cylinder((0, 0, 0), (0, 0, 1), 0.025, low=0, high=0.24), walls="side"
    )
    floor = ds.cg.wall_stress(FLOOR, walls="floor", within=1e-6)
    for f, (count, *force) in zip((side, floor), SUMS, strict=True):
        assert f.wall_contacts.item() == count
        np.testing.assert_allclose(sums(f)[2][0], -np.array(force), atol=1e-6)
    weight = GRAVITY * float(ds.mass.sum())
    np.testing.assert_allclose(-sums(side)[1][0, 1] - sums(floor)[2][0, 2], weight, rtol=1e-4)
    np.testing.assert_allclose(sums(floor)[0][0], SUMS[1, 3], rtol=1e-6)
    deep = side.normal_traction.mean("theta")[0]
    density = 2500 * GRAVITY * 0.6
    assert (
        float(deep.sel(z=slice(0.02, 0.08)).mean()) < 0.6 * density * 0.17
    )  # Janssen: less than the weight above


def test_contacts_across_a_periodic_edge_count_on_both_sides():
    ds = touching([[0.05, 3, 0]], [[0, 0, 1.0]], box=[[0, 6], [0, 6], [0, 2]], periodic="xy")
    p = ds.cg.wall_stress(FLOOR, 0.8, spacing=0.5).normal_traction[0]
    np.testing.assert_allclose((p * 0.25).sum(), 1.0)
    assert float(p.sel(x=5.75, y=2.75)) > 0.1
    shifted = touching([[3.05, 3, 0]], [[0, 0, 1.0]], box=[[0, 6], [0, 6], [0, 2]], periodic="xy")
    q = shifted.cg.wall_stress(FLOOR, 0.8, spacing=0.5).normal_traction[0]
    np.testing.assert_allclose(q.roll(x=-6), p, atol=1e-14)


def test_a_part_of_a_plane_carries_the_force_above_it():
    ds = touching([[1, 1, 0], [4, 1, 0], [1, 1, 3]], [[0, 0, 1.0]] * 3)
    part = xcg.Plane((0, 0, 0), (0, 0, 1), bounds=((0, 2), (0, 2)))
    f = ds.cg.wall_stress(part, 0.5)
    assert f.wall_contacts.item() == 1
    np.testing.assert_allclose(sums(f)[0], 1.0)
    with pytest.warns(xcg.SceneWarning, match=r"no contact with a wall is within .* of Plane"):
        ds.cg.wall_stress(xcg.Plane((0, 0, -9), (0, 0, 1)), 0.5)


def test_distances_from_triangles_equal_those_of_brute_force():
    rng = np.random.default_rng(1)
    surface = box_surface()
    points = rng.uniform(-2, 8, (200, 3))
    inside = ((points > 0) & (points < 6)).all(axis=1)
    outside = np.linalg.norm(np.maximum(0, np.maximum(-points, points - 6)), axis=1)
    depth = np.minimum(points, 6 - points).min(axis=1)
    np.testing.assert_allclose(
        surface.distance(points), np.where(inside, depth, -outside), atol=1e-12
    )


def test_surfaces_are_read_from_files(tmp_path):
    path = tmp_path / "floor.stl"
    facet = (
        "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex {}\nvertex {}\nendloop\nendfacet\n"
    )
    path.write_text(
        "solid\n" + facet.format("6 0 0", "6 6 0") + facet.format("6 6 0", "0 6 0") + "endsolid\n"
    )
    surface = xcg.Surface(path)
    np.testing.assert_allclose(surface.area, [18, 18])
    np.testing.assert_allclose(surface.normals, [[0, 0, 1]] * 2)
    np.testing.assert_allclose(
        xcg.Surface(str(path), flip=True, scale=1e-3).distance(np.ones((1, 3)) * 1e-3), -1e-3
    )
    ds = touching([[1, 2, 0.0]], [[0, 0, 5.0]])
    f = ds.cg.wall_stress(surface, 0.5)
    np.testing.assert_allclose(sums(f)[0], 5.0)
    (tmp_path / "empty.stl").write_text("solid\nendsolid\n")
    with pytest.raises(ValueError, match="holds no triangle"):
        xcg.Surface(tmp_path / "empty.stl")
    with pytest.raises(FileNotFoundError, match=r"none\.stl"):
        xcg.Surface(tmp_path / "none.stl")
    with pytest.raises(ValueError, match=r"expected a surface in \.stl"):
        xcg.Surface(Path("floor.dxf"))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: xcg.Plane((0, 0), (0, 0, 1)), "point="),
        (lambda: xcg.Plane((0, 0, 0), (0, 0, 0)), "not all zero"),
        (lambda: xcg.Plane((0, 0, 0), (0, 0, 1), bounds=((1, 0), (0, 1))), r"bounds\[0\]"),
        (lambda: xcg.Plane((0, 0, 0), (0, 0, 1), bounds=3), "two pairs"),
        (lambda: xcg.Cylinder((0, 0, 0), (0, 0, 1), -1.0), "radius=-1"),
        (lambda: xcg.Cylinder((0, 0, 0), (0, 0, 1), 1.0, low=2, high=1), "first < last"),
        (lambda: xcg.Cylinder((0, 0, 0), (0, 0, 1), 1.0, high=np.nan), "high=nan"),
        (lambda: xcg.Cylinder((0, 0, 0), "w", 1.0), "axis='w': expected 'x', 'y', 'z'"),
        (lambda: xcg.Surface(np.zeros((3, 3)), [[0, 1, 2]]), "no area"),
        (lambda: xcg.Surface(np.eye(3), [[0, 1, 3]]), "there are 3"),
        (lambda: xcg.Surface(np.eye(3), [[0.0, 1, 2]]), "whole numbers"),
        (lambda: xcg.Surface(np.eye(3)), "expected triangles"),
        (lambda: xcg.Surface(np.eye(3), [[0, 1, 2]], scale=0), "scale=0"),
    ],
)
def test_wrong_walls_raise(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"surface": "floor"}, "expected an xcg.Plane"),
        ({"spacing": 0}, "spacing=0"),
        ({"within": -1}, "within=-1"),
        ({"walls": "floor"}, "no wall of this scene has a name"),
        ({"width": "2 d99"}, "d99"),
    ],
)
def test_wrong_arguments_of_wall_stress_raise(options, message):
    ds = touching([[1, 1, 0]], [[0, 0, 1.0]])
    with pytest.raises(ValueError, match=message):
        ds.cg.wall_stress(**{"surface": FLOOR, **options})


def test_a_scene_without_contacts_raises():
    ds = xcg.datasets.random_scene(20, seed=1)
    with pytest.raises(xcg.SceneError, match="wall_stress needs"):
        ds.drop_vars("contact_force").cg.wall_stress(FLOOR)


def test_rates_of_flow_are_averaged_over_time_with_their_errors():
    q = xcg.datasets.open("hopper_6").cg.flow_rate(xcg.Plane((9, 0, 6), (0, 0, -1)))
    mean = q.cg.time_average().compute()
    rate = q.mass_flow_rate.to_numpy()
    assert mean.mass_flow_rate.item() == pytest.approx(rate.mean())
    assert mean.mass_flow_rate_error.item() >= 0.99 * rate.std(ddof=1) / len(rate) ** 0.5


@pytest.mark.parametrize(
    "wall",
    [
        xcg.Cylinder((0.0, 0.0, 0.0), "z", 5000.0, low=0.0, high=10000.0),
        xcg.Plane((0, 0, 0), (0, 0, 1), bounds=((0, 5000.0), (0, 5000.0))),
        xcg.Cylinder((0.0, 0.0, 0.0), "z", 1e9),
    ],
)
def test_a_wall_in_another_unit_is_refused_before_memory_ends(wall):
    ds = xcg.datasets.random_scene(200, walls=True, periodic="xy")
    with pytest.raises(ValueError, match="in another unit of length than the scene"):
        ds.cg.wall_stress(wall, width=0.5)
