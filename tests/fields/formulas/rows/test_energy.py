"""Rotation and energy: every field from its definition, the identities between them, and a sheared packing."""

import itertools
import math

import dask
import numpy as np
import pytest

import xcg
from tests import real_data
from tests.brute_force import BruteKernel
from tests.identities import residuals
from tests.identities.scenes import load
from xcg.fields.formulas.rows import energy
from xcg.readers.files import table
from xcg.scene.schema import VARIABLES, powers_of

NAMES = list(energy.ROWS)
ROTATIONAL = ["spin", "spin_density", "inertia_density", "spin_flux", "spin_fluctuation", "fluctuation_inertia",
              "rotational_temperature", "rotational_kinetic_energy"]  # fmt: skip


def by_definition(ds, kernel, points, seen="xyz", scale=1.0):
    """All fields at points (k, 3): loops over grains, contacts and images, formulas as in theory."""
    frame = {n: ds[n].values[0] for n in ds.data_vars}
    axes = ["xyz".index(a) for a in seen]
    period = np.array(
        [np.ptp(frame["box"][k]) if "xyz"[k] in ds.attrs["periodic"] else 0.0 for k in range(3)]
    )
    plane = ["xyz".index(a) for a in ds.attrs["plane"]]
    pos = frame["position"]
    vel = frame["velocity"]
    mass = frame["mass"]
    turn = frame.get("angular_velocity", np.zeros_like(vel))
    inertia = frame.get("moment_of_inertia", np.zeros(len(mass)))
    far = [math.ceil(2 * kernel.c / p) + 1 if p else 0 for p in period]
    shifts = [np.array(n) * period for n in
              itertools.product(*(range(-n, n + 1) if k in axes else (0,) for k, n in enumerate(far)))]  # fmt: skip

    def nearest(vector):
        return np.array(
            [v - p * round(v / p) if p else v for v, p in zip(vector, period, strict=True)]
        )

    torque = np.zeros((len(mass), 3))
    power = np.zeros(len(mass))
    sides = []
    contacts = []
    for n, (i, j) in enumerate(zip(frame["contact_i"], frame["contact_j"], strict=True)):
        if i < 0:
            continue
        c = frame["contact_point"][n]
        f = frame["contact_force"][n]
        speeds = []
        arms = []
        for k, sign in ((i, 1.0), (j, -1.0)):
            if k < 0:
                speeds.append(
                    frame["contact_wall_velocity"][n]
                    if "contact_wall_velocity" in frame
                    else np.zeros(3)
                )
                arms.append(np.zeros(3))
                continue
            b = nearest(c - pos[k])
            u = vel[k] + np.cross(turn[k], b)
            speeds.append(u)
            arms.append(b)
            torque[k] += np.cross(b, sign * f)
            power[k] += sign * f @ u
            sides.append((pos[k], b, np.cross(b, sign * f), sign * f @ u, sign * f))
        wall = f @ speeds[1] if j < 0 else 0.0
        contacts.append((c, np.cross(arms[0] - arms[1], f), -f @ (speeds[0] - speeds[1]), wall))

    out = {}

    def put(name, value):
        out.setdefault(name, []).append(value)

    for r in points:
        own = []
        weights = []
        for shift in shifts:
            q = np.linalg.norm((pos + shift - r)[:, axes], axis=1)
            hit = np.flatnonzero(q < kernel.c)
            own.append(hit)
            weights.append(scale * kernel(q[hit]))
        k = np.concatenate(own)
        w = np.concatenate(weights)
        v = vel[k]
        o = turn[k]
        m = mass[k] * w
        j = inertia[k] * w
        V = m @ v / m.sum() if len(k) else np.zeros(3)
        W = j @ o / j.sum() if j.any() else np.full(3, np.nan)
        put("inertia_density", j.sum())
        put("spin_density", j @ o)
        put("spin", W)
        put("spin_flux", np.einsum("n,ni,nj->ij", j, o, v))
        around = np.einsum("n,ni,nj->ij", j, o - W, o - W) if j.any() else np.zeros((3, 3))
        put("spin_fluctuation", around)
        each = np.bincount(k, j)
        free = j.sum() - (each**2).sum() / j.sum() if j.any() else 0.0
        put("fluctuation_inertia", free)
        about = [a for a in range(3) if a not in plane] if len(plane) == 2 else [0, 1, 2]
        known = len(k) > 0 and free > 0.5 * j.sum() / len(k)
        temperature = (
            sum(around[a, a] for a in about) / len(about) * j.sum() / free / m.sum()
            if known
            else np.nan
        )
        put("rotational_temperature", temperature)
        put("torque_density", w @ torque[k])
        put("contact_power", w @ power[k])
        kinetic = 0.5 * m * (v**2).sum(axis=1)
        whirl = 0.5 * j * (o**2).sum(axis=1)
        put("kinetic_energy", (kinetic + whirl).sum())
        put("rotational_kinetic_energy", whirl.sum())
        put("mean_kinetic_energy", 0.5 * m.sum() * V @ V)
        put("fluctuating_kinetic_energy", 0.5 * m @ ((v - V) ** 2).sum(axis=1))
        put("kinetic_energy_flux", (kinetic + whirl) @ v)
        q = (0.5 * m * ((v - V) ** 2).sum(axis=1) + whirl) @ (v - V)
        put("kinetic_heat_flux", q)
        couple = np.zeros((3, 3))
        flux = np.zeros(3)
        heat = np.zeros(3)
        points_of = dict.fromkeys(("contact_couple_density", "dissipation_rate", "wall_power"), 0.0)
        for shift in shifts:
            for start, b, t, p, f in sides:
                if (np.abs(start + shift - r)[axes] > kernel.c + np.abs(b)[axes]).any():
                    continue
                s = scale * kernel.segment(
                    r[axes], (start + shift)[axes], (start + b + shift)[axes]
                )
                couple += s * np.outer(t, -b)
                flux += -s * p * b
                heat += -s * (p - f @ V) * b
            for c, *values in contacts:
                q_c = np.linalg.norm((c + shift - r)[axes])
                if q_c < kernel.c:
                    for name, value in zip(points_of, values, strict=True):
                        points_of[name] = points_of[name] + scale * kernel(np.asarray(q_c)) * value
        for name, value in points_of.items():
            put(name, np.broadcast_to(value, 3 if name == "contact_couple_density" else ()))
        put("couple_stress", couple)
        put("contact_energy_flux", flux)
        put("contact_heat_flux", heat)
        put("heat_flux", q + heat)
    return {name: np.array(values) for name, values in out.items()}


def values_at(f, points):
    """Values of a result of one step at its nodes, (k, ...), and those nodes."""
    axes = [a for a in "xyz" if a in f.dims]
    grids = np.meshgrid(*[f[a].values for a in axes], indexing="ij")
    nodes = np.zeros((math.prod(f.sizes[a] for a in axes), 3))
    for k, a in enumerate("xyz"):
        nodes[:, k] = grids[axes.index(a)].ravel() if a in axes else float(f.get(a, 0.0))
    some = np.random.default_rng(2).permutation(len(nodes))[:points]
    return nodes[some], {
        n: f[n].values[0].reshape(len(nodes), *f[n].shape[1 + len(axes) :])[some] for n in f
    }


def assert_is_definition(
    ds,
    kernel,
    width,
    *,
    scale=1.0,
    dimension=3,
    points=10,
    tolerance=1e-12,
    fields=NAMES,
    **options,
):
    """Compare some nodes; the two fields that are algebra on others have a test of their own."""
    fields = [name for name in fields if name not in ("vorticity", "stress_power")]
    f = ds.cg.coarse_grain(fields, kernel=kernel, width=width, **options)
    nodes, found = values_at(f, points)
    seen = "".join(a for a in "xyz" if a in f.coords)
    truth = by_definition(ds, BruteKernel(kernel, width, dimension, len(seen)), nodes, seen, scale)
    assert set(found) <= set(truth)
    for name in found:
        size = np.nanmax(np.abs(f[name]))
        assert size > 0, name
        np.testing.assert_allclose(
            found[name], truth[name], rtol=0, atol=tolerance * size, err_msg=name
        )


def grains_at_moving_walls(seed=3, count=60, **options):
    """Random grains whose walls move, each contact with its own velocity."""
    ds = xcg.datasets.random_scene(count, seed=seed, **{"periodic": "xy", **options})
    rng = np.random.default_rng(seed)
    wall = (("time", "contact", "component"), rng.normal(size=ds.contact_force.shape))
    return ds.assign(
        contact_wall_velocity=wall,
        moment_of_inertia=ds.moment_of_inertia * rng.uniform(0.5, 2, count),
    )


@pytest.mark.parametrize("kernel", ["lucy", "gaussian", "heaviside"])
@pytest.mark.parametrize(
    ("axes", "at"), [("xyz", {}), ("xz", {"y": 1.0}), ("", {"x": 1.0, "y": 2.0, "z": 0.3})]
)
def test_fields_are_their_definitions(kernel, axes, at):
    width = 1.6 if kernel == "heaviside" else 0.9  # supports of much the same size
    assert_is_definition(
        grains_at_moving_walls(count=150), kernel, width, axes=axes, at=at, spacing=1.3, points=5
    )


@pytest.mark.parametrize("axes", ["xz", "z"])
def test_fields_on_planes_lines_and_points_are_integrals(axes):
    # 64 Gauss points leave 1e-11 of marginals
    assert_is_definition(
        grains_at_moving_walls(),
        "lucy",
        0.8,
        axes=axes,
        spacing=0.9,
        scale=5.0 ** (len(axes) - 3),
        tolerance=3e-11,
    )


def test_all_images_in_a_small_box_are_counted():
    ds = grains_at_moving_walls(5, 12, periodic="xyz", edge=1.5)
    inside = [name for name in NAMES if name != "wall_power"]
    # dozens of images of each contact add up, and cancel
    assert_is_definition(ds, "lucy", 1.2, spacing=0.5, points=4, fields=inside, tolerance=1e-11)


def test_a_layer_turns_about_its_normal():
    ds = grains_at_moving_walls(4, periodic="x", dimension=2, thickness=0.5)
    assert (ds.angular_velocity.sel(component=["x", "y"]) == 0).all()
    assert_is_definition(ds, "lucy", 0.8, spacing=0.9, scale=2.0, dimension=2)


def test_vorticity_and_stress_power():
    """In rigid rotation the vorticity is twice the rate; the power of the stress is that of its own formula."""
    ds = xcg.datasets.random_scene(200, seed=5, periodic="")
    rate = np.array([0.3, -0.7, 1.1])
    turning = ds.assign(velocity=(ds.velocity.dims, np.cross(rate, ds.position.values)))
    f = turning.cg.coarse_grain(["vorticity", "sample_count"], width=1.5)
    many = (f.sample_count > 20).values
    np.testing.assert_allclose(
        f.vorticity.values[many], np.tile(2 * rate, (many.sum(), 1)), rtol=1e-10
    )
    f = ds.cg.coarse_grain(
        ["vorticity", "velocity_gradient", "stress", "stress_power"], width=0.8, by="species"
    )
    g = f.velocity_gradient.values
    curl = np.stack(
        [g[..., 2, 1] - g[..., 1, 2], g[..., 0, 2] - g[..., 2, 0], g[..., 1, 0] - g[..., 0, 1]],
        axis=-1,
    )
    np.testing.assert_allclose(f.vorticity.values, curl, rtol=1e-12)
    bulk = f.velocity_gradient.sel(phase="bulk", drop=True)
    power = -(f.stress * bulk).sum(["component", "direction"], skipna=False)
    np.testing.assert_allclose(
        f.stress_power, power, rtol=1e-10, atol=1e-12 * float(abs(power).max())
    )


@pytest.mark.parametrize("name", [name for name in NAMES if xcg.FIELDS[name].additive])
def test_phases_add_up(name):
    ds = grains_at_moving_walls(7, 150)
    f = ds.cg.coarse_grain([name], by="species", width=0.8)[name]
    parts = f.isel(phase=slice(1, None)).sum("phase", skipna=False)
    bulk = f.sel(phase="bulk", drop=True)
    whole = ds.cg.coarse_grain([name], width=0.8)[name]
    assert float(abs(whole).max()) > 0
    for found in (parts, bulk):
        np.testing.assert_allclose(found, whole, rtol=1e-9, atol=1e-12 * float(abs(whole).max()))


def test_fluctuations_of_phases_are_about_the_bulk():
    ds = grains_at_moving_walls(8, 400)
    f = ds.cg.coarse_grain(["spin", "spin_fluctuation", "kinetic_heat_flux", "velocity"], by="species", width=1.0,
                           at={"x": 2.0, "y": 2.0, "z": 2.0}, axes="").isel(time=0)  # fmt: skip
    kernel = BruteKernel("lucy", 1.0)
    x = ds.position.values[0] - 2.0
    x -= np.array([5.0, 5.0, 0.0]) * np.rint(x / 5.0)
    w = kernel(np.linalg.norm(x, axis=1)) * (ds.species.values[0] == 1)
    inertia, mass, omega, v = (
        ds[n].values[0] for n in ("moment_of_inertia", "mass", "angular_velocity", "velocity")
    )
    o = omega - f.spin.sel(phase="bulk").values
    v = v - f.velocity.sel(phase="bulk").values
    one = f.sel(phase="1")
    np.testing.assert_allclose(
        one.spin_fluctuation, np.einsum("n,ni,nj->ij", w * inertia, o, o), rtol=1e-11
    )
    q = (w * 0.5 * (mass * (v**2).sum(axis=1) + inertia * (omega**2).sum(axis=1))) @ v
    np.testing.assert_allclose(one.kinetic_heat_flux, q, rtol=1e-11)


def test_energy_has_three_parts_and_fluxes_add_up():
    names = [*NAMES, "velocity", "stress", "density"]
    f = grains_at_moving_walls().cg.coarse_grain(names, width=0.8, by="species")
    parts = f.mean_kinetic_energy + f.fluctuating_kinetic_energy + f.rotational_kinetic_energy
    np.testing.assert_allclose(
        f.kinetic_energy, parts, rtol=0, atol=1e-13 * float(f.kinetic_energy.max())
    )
    f = f.sel(phase="bulk")
    V = f.velocity.fillna(0.0)
    work = (V * f.stress).sum("component").rename(direction="component")
    total = f.kinetic_energy_flux + f.contact_energy_flux
    found = f.kinetic_energy * V + work + f.heat_flux
    np.testing.assert_allclose(found, total, rtol=0, atol=1e-13 * float(abs(total).max()))


def test_heat_flux_of_a_fast_frame():
    """What moves with the frame is taken out at each node, before it is cubed."""
    ds = xcg.datasets.random_scene(100, seed=2)
    fast = ds.assign(
        velocity=ds.velocity + 2.0**20
    )  # a million times the fluctuations, and exact in the last bit
    names = ["kinetic_heat_flux", "heat_flux"]
    still = ds.assign(velocity=fast.velocity - 2.0**20)
    f, g = (scene.cg.coarse_grain(names, width=0.8) for scene in (still, fast))
    for name in names:
        np.testing.assert_allclose(g[name], f[name], rtol=0, atol=1e-6 * float(abs(f[name]).max()))


def test_spins_of_known_temperature():
    """Independent spins of variance 1: the mean of I <omega^2> over rho, whatever the width."""
    rng = np.random.default_rng(4)
    count, steps = 400, 40
    ds = xcg.scene_from_arrays(
        rng.uniform(0, 6.0, (steps, count, 3)), velocity=np.zeros((steps, count, 3)), diameter=np.ones((steps, count)),
        angular_velocity=3.0 + rng.normal(size=(steps, count, 3)), density=1.0, box=[[0, 6.0]] * 3, periodic="xyz",
    )  # fmt: skip
    for width in (0.6, 1.0):
        f = ds.cg.coarse_grain(
            "rotational_temperature", width=width, spacing=1.5, for_averages=True
        )
        t = xcg.profile(f, "z").mean("z").rotational_temperature.mean()
        assert float(t) == pytest.approx(0.1, rel=0.03)
    lonely = ds.isel(particle=[0], time=[0]).cg.coarse_grain(["rotational_temperature"], width=1.0)
    assert lonely.rotational_temperature.isnull().all()


@pytest.mark.parametrize(
    ("ratio", "known"), [(1.0, True), (5.7, True), (5.9, False), (40.0, False)]
)
def test_rotational_temperature_is_unknown_where_the_mean_leaves_less_than_half_a_grain(
    ratio, known
):
    """Of inertias 1 and x at one distance the mean leaves 2 x / (1 + x): half of (1 + x) / 2 at x = 3 + sqrt(8)."""
    ds = xcg.scene_from_arrays(
        [[-0.2, 0, 0], [0.2, 0, 0]], velocity=np.zeros((2, 3)), diameter=[0.4, 0.4], density=1.0,
        angular_velocity=[[1.0, 2.0, 0.0], [0.0, 2.0, 3.0]], moment_of_inertia=[1.0, ratio],
    )  # fmt: skip
    f = ds.cg.coarse_grain(
        ["rotational_temperature", "density"], at={"x": 0.0, "y": 0.0, "z": 0.0}, width=1.0
    )
    weight = xcg.Lucy(1.0).value(0.2)
    # sum I (o - b)^2 is that of two spins sqrt(10) apart, x / (1 + x) 10
    want = (
        (10 * ratio / (1 + ratio))
        * (1 + ratio)
        / (2 * ratio / (1 + ratio))
        * weight
        / (3 * f.density)
    )
    np.testing.assert_allclose(f.rotational_temperature, want if known else np.nan, rtol=1e-12)


def test_averages_equal_those_of_the_sums():
    steps = [grains_at_moving_walls(k, 40, periodic="xyz") for k in range(3)]
    names = [
        "velocity",
        "angular_velocity",
        "diameter",
        "contact_i",
        "contact_j",
        "contact_force",
        "contact_point",
    ]
    rows = {n: [s[n].values[0] for s in steps] for n in names}
    ds = xcg.scene_from_arrays([s.position.values[0] for s in steps], density=2500.0, box=[[0, 5.0]] * 3,
                               periodic="xyz", time=np.arange(3.0), **rows)  # fmt: skip
    f = ds.cg.coarse_grain([*NAMES, "density"], width=1.2, spacing=1.0, for_averages=True)
    mean = xcg.time_average(f)
    parts = ["mean_kinetic_energy", "fluctuating_kinetic_energy"]  # about the averaged velocity
    for of in (mean, f.mean("time", skipna=False)):
        total = sum(of[part] for part in parts)
        np.testing.assert_allclose(total, f[parts].mean("time").to_dataarray().sum("variable"))
    for name in NAMES:
        if xcg.FIELDS[name].additive and name not in parts:
            expected = f[name].mean("time", skipna=False)
            np.testing.assert_allclose(
                mean[name], expected, rtol=1e-12, atol=1e-12 * float(abs(expected).max())
            )
    np.testing.assert_allclose(
        mean.spin, f.spin_density.mean("time") / f.inertia_density.mean("time"), rtol=1e-12
    )
    sums = f[["spin_fluctuation", "fluctuation_inertia", "inertia_density", "density"]].mean("time")
    trace = sum(sums.spin_fluctuation.sel(component=a, direction=a) for a in "xyz")
    expected = trace / 3 * sums.inertia_density / sums.fluctuation_inertia / sums.density
    np.testing.assert_allclose(mean.rotational_temperature, expected, rtol=1e-10)


# --- without rotation, units, what is read ---------------------------------------------------------------


def test_rotation_is_left_out_and_noted_without_angular_velocity():
    ds = grains_at_moving_walls()
    bare = ds.drop_vars(["angular_velocity", "moment_of_inertia"])
    fields = [name for name in NAMES if name not in ROTATIONAL]
    assert_is_definition(bare, "lucy", 0.9, spacing=1.3, fields=fields)
    f = bare.cg.coarse_grain(fields, width=0.9, spacing=1.3)
    told = {name for name in f if "angular_velocity" in f[name].attrs.get("comment", "")}
    assert told == {"kinetic_energy", "kinetic_energy_flux", "contact_energy_flux", "kinetic_heat_flux",
                    "contact_heat_flux", "heat_flux", "contact_power", "dissipation_rate", "wall_power"}  # fmt: skip
    assert not any(
        "comment" in v.attrs for v in ds.cg.coarse_grain(NAMES, width=0.9, spacing=1.3).values()
    )
    with pytest.raises(xcg.SceneError, match="angular_velocity"):
        bare.cg.coarse_grain("spin")


def test_other_fields_do_not_depend_on_rotation():
    ds = grains_at_moving_walls()
    assert not {"angular_velocity", "moment_of_inertia"} & set(ds.cg.explain().variables)
    assert not set(NAMES) & set(ds.cg.coarse_grain(width=0.9))


def test_units_of_rotation_and_energy():
    f = grains_at_moving_walls().cg.coarse_grain(NAMES, width=0.9, spacing=1.3)
    units = {name: f[name].attrs["units"] for name in NAMES}
    assert units["heat_flux"] == units["contact_energy_flux"] == "W m^-2"
    assert units["dissipation_rate"] == units["stress_power"] == units["wall_power"] == "W m^-3"
    assert units["spin_density"] == "kg m^-1 s^-1"
    assert units["couple_stress"] == units["spin_flux"] == "kg s^-2"
    # a scene in other units of length, mass and time: each field changes as its unit says
    ds, (length, mass, time) = grains_at_moving_walls(), (2.0, 3.0, 0.5)
    powers = {name: powers_of(VARIABLES[name].units) for name in ds.data_vars if name != "box"} | {
        "box": (1, 0, 0)
    }
    other = ds.assign({n: ds[n] * (length ** p[0] * mass ** p[1] * time ** p[2]) if any(p) else ds[n]
                       for n, p in powers.items()})  # fmt: skip
    g = other.cg.measure().cg.coarse_grain(NAMES, width=0.9 * length, spacing=1.3 * length)
    for name in NAMES:
        p = xcg.FIELDS[name].powers
        expected = f[name].values * length ** p[0] * mass ** p[1] * time ** p[2]
        np.testing.assert_allclose(
            g[name], expected, rtol=1e-7, atol=1e-10 * np.nanmax(np.abs(expected)), err_msg=name
        )


def test_grains_held_in_place_are_walls_that_move():
    """Their own velocities and spins are those of the wall."""
    ds = xcg.datasets.random_scene(80, seed=6, periodic="xyz")
    held = ds.assign(frozen=(ds.species == 2).astype("int64"))
    names = [
        "dissipation_rate",
        "wall_power",
        "contact_power",
        "contact_energy_flux",
        "torque_density",
    ]
    f = held.cg.coarse_grain(names, width=0.9, spacing=1.0)
    # the same, with velocities of the walls written out
    i = ds.contact_i.values[0]
    j = ds.contact_j.values[0]
    species = ds.species.values[0]
    x = ds.position.values[0]
    c = ds.contact_point.values[0]
    b = c - x[j]
    b -= 5.0 * np.rint(b / 5.0)
    u_j = ds.velocity.values[0][j] + np.cross(ds.angular_velocity.values[0][j], b)
    b = c - x[i]
    b -= 5.0 * np.rint(b / 5.0)
    u_i = ds.velocity.values[0][i] + np.cross(ds.angular_velocity.values[0][i], b)
    wall = np.where((species[j] == 2)[:, None], u_j, u_i)
    free = ds.isel(particle=species == 1).assign(
        contact_wall_velocity=(ds.contact_force.dims, wall[None])
    )
    g = free.cg.coarse_grain(names, width=0.9, spacing=1.0, bounds=dict.fromkeys("xyz", (0.0, 5.0)))
    f = held.cg.coarse_grain(names, width=0.9, spacing=1.0, bounds=dict.fromkeys("xyz", (0.0, 5.0)))
    assert float(abs(f.wall_power).max()) > 0
    for name in names:
        np.testing.assert_allclose(
            f[name], g[name], rtol=1e-12, atol=1e-12 * float(abs(g[name]).max())
        )


def test_the_power_of_moving_walls_closes():
    """Walls given by velocities, and grains fixed in place on either side of a contact."""
    given = grains_at_moving_walls(1, 100)
    held = xcg.datasets.random_scene(100, seed=1, periodic="xy", walls=False)
    held = held.assign(frozen=(held.species == 2).astype("int64"))
    for ds in (given, held):
        b = ds.cg.balance(quantities=["torque", "power"], width=1.2, spacing=0.15)
        assert float(b.torque_residual_norm.max()) < 1e-3
        assert float(b.power_residual_norm.max()) < 1e-3


# --- balances --------------------------------------------------------------------------------------------


def closes(ds, width, points):
    """Largest residuals of the divergences of couple stress and contact energy flux, by sixth-order differences."""
    names = [
        "torque_density",
        "contact_couple_density",
        "contact_power",
        "dissipation_rate",
        "wall_power",
    ]
    f = residuals.at_points(ds, names, points, width=width)
    div = residuals.divergence(ds, ["couple_stress", "contact_energy_flux"], points, width)
    left = div["couple_stress"] + f["torque_density"] - f["contact_couple_density"]
    right = (
        div["contact_energy_flux"] + f["contact_power"] + f["dissipation_rate"] - f["wall_power"]
    )
    sizes = [max(np.abs(a).max() for a in parts) for parts in (
        (f["torque_density"], f["contact_couple_density"]), (f["contact_power"], f["dissipation_rate"]))]  # fmt: skip
    return np.abs(left).max() / sizes[0], np.abs(right).max() / sizes[1]


@pytest.mark.parametrize("options", [{}, {"periodic": "xyz"}, {"dimension": 2, "periodic": "y"}])
def test_spin_and_energy_of_contacts_close(options):
    ds = grains_at_moving_walls(3, **options)
    points = np.random.default_rng(1).uniform(0.5, 4.0, (4, 3)) * [
        1,
        1,
        0 if "dimension" in options else 1,
    ]
    assert max(closes(ds, 0.9, points)) < 1e-9


@pytest.mark.parametrize("name", ["lammps_chute", "mfix_chute", "liggghts_box"])
def test_spin_and_energy_of_contacts_close_in_output_of_codes(name):
    case = load(name)
    assert max(closes(case.ds, case.width, case.points)) < 1e-9


def test_residuals_fall_with_the_spacing():
    ds = grains_at_moving_walls(1, 100).drop_vars("contact_wall_velocity")
    b = [
        ds.cg.balance(quantities=["torque", "power"], width=1.2, spacing=h) for h in (0.4, 0.2, 0.1)
    ]
    for name in ("torque_residual_norm", "power_residual_norm"):
        norms = [float(one[name].item()) for one in b]
        assert norms[0] > 7 * norms[1] > 49 * norms[2], (name, norms)
        assert norms[0] > 64 * norms[2], (
            name,
            norms,
        )  # third order at least, as the third derivative of Lucy's jumps
        assert norms[2] < 1e-3
    assert b[0].torque_residual.dims == ("time", "x", "y", "z", "component")
    assert b[0].power_residual.attrs["units"] == "W m^-3"


def moving(dt, seed=1, gravity=(0.3, 0, -1.0)):
    """Two frames, dt apart, of grains that move and turn under constant forces and torques from the middle."""
    middle = xcg.datasets.random_scene(100, seed=seed, periodic="xyz")
    get = {name: middle[name].values[0] for name in middle.data_vars}
    i = get["contact_i"]
    j = get["contact_j"]
    force = 1e3 * get["contact_force"]
    point = get["contact_point"]
    total = np.zeros((100, 3))
    torque = np.zeros((100, 3))
    for row, sign in ((i, 1), (j, -1)):
        b = point - get["position"][row]
        b -= 5.0 * np.rint(b / 5.0)
        np.add.at(total, row, sign * force)
        np.add.at(torque, row, np.cross(b, sign * force))
    a = total / get["mass"][:, None] + np.array(gravity)
    alpha = torque / get["moment_of_inertia"][:, None]
    s = np.array([-dt / 2, dt / 2])
    x = get["position"]
    v = get["velocity"]
    o = get["angular_velocity"]
    # contact points move with i, and forces stay: branches and torques change by their size times dt^2 in the mean
    return xcg.scene_from_arrays(
        [x + t * v + t**2 / 2 * a for t in s], velocity=[v + t * a for t in s],
        angular_velocity=[o + t * alpha for t in s], diameter=[get["diameter"]] * 2, density=2500.0,
        contact_i=[i] * 2, contact_j=[j] * 2, contact_force=[force] * 2, contact_point=[point + t * v[i] for t in s],
        time=[0.0, dt], box=[[0, 5.0]] * 3, periodic="xyz", gravity=gravity,
    )  # fmt: skip


def test_residuals_of_spin_and_energy_fall_with_the_time_between_frames():
    b = [
        moving(dt).cg.balance(quantities=["spin", "energy"], width=1.2, spacing=0.15)
        for dt in (0.1, 0.05)
    ]
    for name in ("spin_residual_norm", "energy_residual_norm"):
        first, second = (float(one[name].item()) for one in b)
        assert first > 3 * second, (name, first, second)
        assert second < 0.01
    assert b[0].energy_residual.dims == ("interval", "x", "y", "z")


def test_a_wrong_force_raises_the_residual():
    ds = moving(0.02)
    options = {"quantities": ["spin", "energy"], "width": 1.2, "spacing": 0.15}
    right, wrong = (
        d.cg.balance(**options) for d in (ds, ds.assign(contact_force=1.2 * ds.contact_force))
    )
    for name in ("spin_residual_norm", "energy_residual_norm"):
        assert wrong[name].item() > 5 * right[name].item()


def test_wrong_balances_raise():
    ds = grains_at_moving_walls()
    with pytest.raises(ValueError, match="expected a list of any of force, torque"):
        ds.cg.balance(quantities="torque")
    with pytest.raises(ValueError, match="expected a list of any of force, torque"):
        ds.cg.balance(quantities=["heat"])
    with pytest.raises(ValueError, match="holds between steps, and takes the scene's gravity"):
        ds.cg.balance(quantities=["energy"])
    with pytest.raises(ValueError, match="leave out by="):
        ds.cg.balance(quantities=["power"], by="species")


# --- moments of inertia ------------------------------------------------------------------------------------


def test_moments_of_inertia_of_spheres_and_discs():
    """Of solid spheres or discs, and as they are given; none without angular velocities."""
    given = {"position": np.zeros((1, 3)), "diameter": [0.4], "mass": [5.0]}
    turning = {"angular_velocity": [[0.0, 0.0, 1.0]], **given}
    assert xcg.scene_from_arrays(**turning).moment_of_inertia.item() == pytest.approx(
        2 / 5 * 5.0 * 0.2**2
    )
    disc = xcg.scene_from_arrays(**turning, shape="disc", thickness=0.1, dimension=2)
    assert disc.moment_of_inertia.item() == pytest.approx(1 / 2 * 5.0 * 0.2**2)
    assert xcg.scene_from_arrays(**turning, moment_of_inertia=[7.0]).moment_of_inertia.item() == 7.0
    assert "moment_of_inertia" not in xcg.scene_from_arrays(**given)
    scaled = xcg.scene_from_arrays(
        **turning, moment_of_inertia=[7.0], units={"length": 10.0, "mass": 2.0, "time": 4.0}
    )
    assert (scaled.moment_of_inertia.item(), scaled.angular_velocity.values[0, 0, 2]) == (
        1400.0,
        0.25,
    )
    with pytest.raises(xcg.SceneError, match="'moment_of_inertia' of particle 0"):
        xcg.scene_from_arrays(**turning, moment_of_inertia=[-7.0])


# --- files -----------------------------------------------------------------------------------------------


def test_rotation_is_read_only_on_request(monkeypatch):
    folder = real_data("lammps_plane_shear")
    ds = xcg.open_scene(
        folder / "particles.*.dump.gz", contacts=folder / "contacts.*.dump.gz", frozen=2
    )
    asked = []
    parse = table.parse_table
    monkeypatch.setattr(table, "parse_table", lambda *a: asked.append(list(a[2])) or parse(*a))
    with dask.config.set(scheduler="synchronous"):
        ds.isel(time=[3]).cg.coarse_grain(["density", "velocity"], axes="z").compute()
        assert asked
        assert not any("omegax" in columns for columns in asked)
        f = ds.isel(time=[3]).cg.coarse_grain(["density", "spin"], axes="z").compute()
    assert any("omegax" in columns for columns in asked)
    assert float(abs(f.spin).max()) > 0


@pytest.mark.parametrize(("folder", "pattern", "options", "first"), [
    ("mfix_chute", "P_FB1_0004.vtp", {}, None),
    ("liggghts_box", "compress*.liggghts.gz", {"density": 2500.0}, None),
    ("mercury_synthetic", "syn200.data", {}, [-0.0327707, -0.0108021, 0.244621]),
    ("lammps_chute", "particles.00030000.dump.gz", {}, None),
])  # fmt: skip
def test_angular_velocities_are_read_from_other_codes(folder, pattern, options, first):
    ds = xcg.open_scene(real_data(folder) / pattern, **options)
    omega = ds.angular_velocity.isel(time=0).values
    assert omega.shape == ds.velocity.shape[1:]
    assert np.abs(omega).max() > 0
    if first is not None:
        np.testing.assert_allclose(omega[3], first, rtol=1e-6)
    np.testing.assert_allclose(ds.moment_of_inertia, ds.mass * ds.diameter**2 / 10, rtol=1e-12)


def test_angular_velocities_are_read_from_columns(tmp_path):
    """In a plane z alone will do; of three, one alone is an error if it was named."""
    head = "ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n1\nITEM: BOX BOUNDS pp pp pp\n0 1\n0 1\n0 1\nITEM: ATOMS "
    path = tmp_path / "a.dump"
    path.write_text(f"{head}id x y z radius mass omegaz wx\n1 0.1 0.2 0.3 0.05 1.0 4.0 5.0\n")
    ds = xcg.open_scene(path, units="SI")
    np.testing.assert_array_equal(ds.angular_velocity.values[0, 0], [0.0, 0.0, 4.0])
    with pytest.raises(xcg.SceneError, match="no y of the angular velocity"):
        xcg.open_scene(path, units="SI", names={"wx": "angular_velocity_x"})
    assert "angular_velocity" not in xcg.open_scene(path, units="SI", names={"omegaz": "turning"})


def test_rotation_and_energy_in_plane_shear():
    """Its own bookkeeping: energies of LAMMPS at each frame, power of its walls; dissipation is stress times rate."""
    folder = real_data("lammps_plane_shear")
    ds = xcg.open_scene(
        folder / "particles.*.dump.gz", contacts=folder / "contacts.*.dump.gz", frozen=2
    ).compute()
    names = ["kinetic_energy", "rotational_kinetic_energy", "dissipation_rate", "wall_power", "contact_power",
             "stress", "spin", "vorticity"]  # fmt: skip
    f = ds.cg.coarse_grain(names, axes="z", bounds={"z": (-2.0, 13.0)}, spacing=0.1)
    f = f.assign(
        {name: 6.0 * 4.0 * f[name] for name in [*names[:5], "stress"]}
    )  # in all of the cross-section
    total = f.integrate("z")
    _, moving_part, turning, power = np.loadtxt(folder / "energies.txt").T
    # bulk grains only: those of the walls are no part of a field
    np.testing.assert_allclose(
        total.kinetic_energy - total.rotational_kinetic_energy, moving_part, rtol=1e-4
    )
    np.testing.assert_allclose(total.rotational_kinetic_energy, turning, rtol=1e-4)
    # the forces in the dumps are those of velocities half a step later
    np.testing.assert_allclose(total.wall_power, power, rtol=0, atol=0.02 * np.abs(power).max())
    # each frame: power of contacts on grains is that of walls less what contacts take up
    np.testing.assert_allclose(
        total.contact_power, total.wall_power - total.dissipation_rate, rtol=1e-6, atol=1e-3
    )
    # all frames: what contacts take up is the power of the walls, and stress times rate, within the errors
    gamma = total.dissipation_rate.values
    walls = np.loadtxt(folder / "means.txt")[:, 3]
    error = np.hypot(standard_error(gamma), standard_error(walls))
    assert abs(gamma.mean() - walls.mean()) < 2 * error < 0.4 * walls.mean()
    middle = f.sel(z=slice(2.5, 8.5))
    times_rate = (
        -middle.stress.sel(component="x", direction="z").mean("z").values * 5.0
    )  # walls at -2.5 and 2.5
    assert (
        abs(gamma.mean() - times_rate.mean())
        < 2 * standard_error(gamma - times_rate)
        < 0.3 * times_rate.mean()
    )
    # grains turn with the flow
    turning, whirling = (
        middle[name].sel(component="y").mean(["time", "z"]) for name in ("spin", "vorticity")
    )
    assert float(turning) == pytest.approx(float(whirling) / 2, rel=0.1)


def standard_error(values):
    return values.std(ddof=1) / np.sqrt(values.size)
