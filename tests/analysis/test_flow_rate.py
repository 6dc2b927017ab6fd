"""Flow through surfaces: brute force, sums, closed surfaces."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import xarray as xr

import xcg
from tests.dumps import BOX, dump_text, write
from tests.fields.formulas.test_field import LUCY, cumulative, marginal
from xcg.analysis.surfaces import parts_of_triangles

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
    centre, area = parts_of_triangles(xcg.Surface(corners, [[0, 1, 2]]), spacing)
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


def test_rates_of_flow_are_averaged_over_time_with_their_errors():
    q = xcg.datasets.open("hopper_6").cg.flow_rate(xcg.Plane((9, 0, 6), (0, 0, -1)))
    mean = q.cg.time_average().compute()
    rate = q.mass_flow_rate.to_numpy()
    assert mean.mass_flow_rate.item() == pytest.approx(rate.mean())
    assert mean.mass_flow_rate_error.item() >= 0.99 * rate.std(ddof=1) / len(rate) ** 0.5
