"""Contacts over time: hand-made histories, images, gaps, and the collisions of an elastic gas."""

import numpy as np
import pytest
import xarray as xr
from scipy.spatial import cKDTree

import xcg
from tests.analysis import percus_yevick_g


def _scene(position, time=None, diameter=1.0, box=None, periodic="", **options):
    position = np.asarray(position, float)
    return xcg.scene_from_arrays(
        position,
        diameter=np.full(position.shape[:2], diameter),
        time=np.arange(float(len(position))) if time is None else np.asarray(time, float),
        box=box,
        periodic=periodic,
        **options,
    ).cg.find_contacts()


def _pair(distance, **options):
    """Two spheres at a distance along x in each step."""
    position = np.zeros((len(distance), 2, 3))
    position[:, 1, 0] = distance
    return _scene(position, **options)


TOUCH, APART = 0.9, 1.5


def test_ages_births_losses_and_lifetimes_of_one_contact():
    h = _pair(
        [APART, TOUCH, TOUCH, TOUCH, APART, TOUCH], time=[0, 2, 4, 6, 8, 10]
    ).cg.contact_history([1, 2])
    np.testing.assert_array_equal(h.contact_age[:, 0], [np.nan, 0, 2, 4, np.nan, 0])
    np.testing.assert_array_equal(h.births, [0, 1, 0, 0, 0, 1])
    np.testing.assert_array_equal(h.losses, [0, 0, 0, 0, 1, 0])
    np.testing.assert_array_equal(h.contact_count, [0, 1, 1, 1, 0, 1])
    np.testing.assert_array_equal(h.lifetime, [6.0])  # from 1 to 7
    # starts at 2, 4, 6 (lag 1), and at 2, 4, 6 (lag 2)
    np.testing.assert_allclose(h.persistence, [2 / 3, 1 / 3])
    np.testing.assert_array_equal(h.lag, [2.0, 4.0])


def test_contacts_of_the_first_step_have_no_lifetime():
    h = _pair([TOUCH, TOUCH, APART]).cg.contact_history()
    assert h.sizes["lost"] == 0
    assert h.losses.values.tolist() == [0, 0, 1]
    assert int(h.births.sum()) == 0


def test_a_contact_stays_where_a_particle_crosses_the_edge():
    x = np.array([9.2, 9.6, 10.0, 10.4])
    position = np.zeros((4, 2, 3))
    position[:, 0, 0] = x % 10
    position[:, 1, 0] = (x + 0.9) % 10
    h = _scene(position, box={"x": (0, 10)}, periodic="x").cg.contact_history()
    assert (h.contact_count == 1).all()
    np.testing.assert_array_equal(h.contact_age[:, 0], [0, 1, 2, 3])
    np.testing.assert_allclose(h.contact_turned[:, 0], 0, atol=1e-12)


@pytest.mark.parametrize("share", [0.3, 0.5, 0.8])
def test_contacts_stay_where_grains_cross_half_a_period_between_steps(share):
    """Branches show which image touches, not how far the grains have moved."""
    x = 10 * share * np.arange(5)
    position = np.zeros((5, 2, 3))
    position[:, 0, 0] = x % 10
    position[:, 1, 0] = (x + 0.9) % 10
    h = _scene(position, box={"x": (0, 10)}, periodic="x").cg.contact_history()
    assert h.losses.values.tolist() == [0] * 5
    np.testing.assert_allclose(h.contact_turned, 0.0, atol=1e-12)


@pytest.mark.filterwarnings("ignore:contact_history. 100% of the contacts are lost")
def test_another_image_is_another_contact():
    """A sphere leaves its neighbour at one side, and touches it at the other."""
    h = _pair([0.9, 1.6], box={"x": (0, 2.5)}, periodic="x").cg.contact_history()
    assert h.births.values.tolist() == [0, 1]
    assert h.losses.values.tolist() == [0, 1]
    both = _pair([0.9, 0.9, 0.98], box={"x": (0, 1.88)}, periodic="x").cg.contact_history()
    assert both.contact_count.values.tolist() == [2, 2, 2]
    assert int(both.births.sum()) == int(both.losses.sum()) == 0


def test_images_of_a_sheared_box_move():
    """Across the edge of a box with a tilt that grows, the pair shears with its images."""
    steps = 4
    tilt = 0.05 * np.arange(steps)
    position = np.tile([[0.5, 0.1, 1.0], [0.5, 3.2, 1.0]], (steps, 1, 1))
    position[:, 1, 0] += tilt  # below, by the image at y - 4, it stays at its place
    lattice = np.tile(4.0 * np.eye(3), (steps, 1, 1))
    lattice[:, 1, 0] = tilt
    box = dict.fromkeys("xyz", (0, 4))
    h = _scene(position, box=box, periodic="xyz", lattice=lattice).cg.contact_history()
    assert (h.contact_count == 1).all()
    assert int(h.births.sum()) == int(h.losses.sum()) == 0
    np.testing.assert_allclose(h.contact_turned[:, 0], 0, atol=1e-12)


def test_normals_turn_by_the_angle_of_the_pair():
    angle = np.array([0.0, 1e-9, 0.2, 0.5, 1.4])
    time = np.array([0.0, 0.5, 1.0, 1.5, 2.0])
    position = np.zeros((5, 2, 3))
    position[:, 1] = 0.9 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    h = _scene(position, time=time).cg.contact_history()
    np.testing.assert_allclose(h.contact_turned[:, 0], angle, rtol=1e-9, atol=1e-16)
    np.testing.assert_allclose(h.contact_turning_rate[1:, 0], np.diff(angle) / 0.5, rtol=1e-7)
    assert np.isnan(h.contact_turning_rate[0, 0])


def test_order_of_ids_and_of_contacts_makes_no_difference():
    r = np.random.default_rng(1)
    walk = r.uniform(0, 3, (30, 3)) + 0.05 * r.normal(size=(6, 30, 3)).cumsum(axis=0)
    ds = _scene(walk, diameter=0.8)
    expected = ds.cg.contact_history()
    mixed = ds.isel(contact=r.permutation(ds.sizes["contact"]))
    swapped = mixed.assign(contact_i=mixed.contact_j, contact_j=mixed.contact_i)
    swapped["contact_normal"] = -mixed.contact_normal
    for other in (mixed, swapped):
        h = other.cg.contact_history()
        for name in ("births", "losses", "contact_count", "persistence", "persistence_error"):
            xr.testing.assert_equal(h[name], expected[name])
        np.testing.assert_array_equal(np.sort(h.lifetime), np.sort(expected.lifetime))
    assert int(expected.births.sum()) > 5
    # what is there is what was, and was born, less what was lost
    count = expected.contact_count.to_numpy()
    np.testing.assert_array_equal(np.diff(count), (expected.births - expected.losses)[1:])


def test_gaps_are_named_and_persistence_leaves_them_out():
    ds = _pair([TOUCH, TOUCH, TOUCH, APART, APART], time=[0, 1, 2, 5, 6])
    with pytest.warns(xcg.SceneWarning, match=r"1 intervals are longer .* from 2 to 5 s"):
        h = ds.cg.contact_history([1])
    assert float(h.persistence[0]) == 1.0


def test_ages_are_variables_of_contacts_with_fields():
    ds = _pair([TOUCH, TOUCH, TOUCH])
    ds = ds.assign(contact_age=ds.cg.contact_history().contact_age)
    f = ds.cg.coarse_grain(xcg.Mean("contact_age"), at={"x": 0.45, "y": 0.0, "z": 0.0}, width=1.0)
    np.testing.assert_allclose(f.contact_age.squeeze(), [0, 1, 2], atol=1e-14)


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: _pair([TOUCH]).cg.contact_history(), ValueError, "needs two steps or more"),
        (lambda: _pair([TOUCH] * 3).cg.contact_history([3]), ValueError, "from 1 to 2"),
        (
            lambda: _pair([TOUCH] * 3).drop_vars(["contact_i", "contact_j"]).cg.contact_history(),
            xcg.SceneError,
            "contact_i",
        ),
        (
            lambda: _pair([TOUCH] * 3).isel(time=[1, 0, 2]).cg.contact_history(),
            xcg.SceneError,
            "sortby",
        ),
    ],
)
def test_bad_input_is_named(make, error, message):
    with pytest.raises(error, match=message):
        make()


STEP = 0.1  # of a simulation, in contact times


def _elastic_gas(particles, fraction, contact_time, duration, seed):
    """Positions of elastic spheres (d = m = T = 1) every half of a contact time, by velocity Verlet."""
    r = np.random.default_rng(seed)
    length = (particles * np.pi / 6 / fraction) ** (1 / 3)
    side = int(np.ceil(particles ** (1 / 3)))
    grid = np.stack(np.meshgrid(*[np.arange(side)] * 3), axis=-1).reshape(-1, 3)
    place = grid[r.permutation(side**3)[:particles]] * (length / side)
    velocity = r.normal(size=(particles, 3))
    velocity -= velocity.mean(axis=0)
    velocity *= np.sqrt(3 * particles / (velocity**2).sum())
    stiffness = np.pi**2 / (2 * contact_time**2)  # half a period of the reduced mass 1/2

    def force(place):
        pairs = cKDTree(place, boxsize=length).query_pairs(1.0, output_type="ndarray")
        away = place[pairs[:, 0]] - place[pairs[:, 1]]
        away -= length * np.rint(away / length)
        distance = np.linalg.norm(away, axis=1, keepdims=True)
        push = stiffness * (1 - distance) * away / distance
        total = np.zeros_like(place)
        np.add.at(total, pairs[:, 0], push)
        np.add.at(total, pairs[:, 1], -push)
        return total

    step = STEP * contact_time
    recorded = []
    push = force(place)
    for k in range(int(duration / step)):
        velocity += push * step / 2
        place = (place + velocity * step) % length
        push = force(place)
        velocity += push * step / 2
        # the lattice at the start has forgotten itself after some free paths
        if k * step > 1.0 and k % 5 == 0:
            recorded.append(place)
    time = contact_time / 2 * np.arange(len(recorded))
    return _scene(recorded, time=time, box=dict.fromkeys("xyz", (0, length)), periodic="xyz")


@pytest.mark.filterwarnings("ignore:contact_history. 51% of the contacts are lost")
@pytest.mark.parametrize("seed", [3, 4])
def test_an_elastic_gas_collides_at_the_rate_of_kinetic_theory(seed):
    """Spheres that are not quite hard: their contacts are shorter and rarer than those of hard ones.

    In equilibrium, pairs are at a distance r as often as y(r) exp(-u(r) / T) says, with the
    potential u = k (1 - r)^2 / 2 of a contact, and approach at a mean speed of sqrt(T / pi). Mean
    number over rate is the mean lifetime

        int_0^1 r^2 y(r) / y(1) exp(-u / T) dr / sqrt(T / pi)

    which is half a period but for r^2 (tangential motion drives pairs apart) and y, each of the
    order of the overlap. y inside contact is that of Percus and Yevick.
    """
    particles, fraction, contact_time = 400, 0.1, 0.03
    ds = _elastic_gas(particles, fraction, contact_time, duration=2.5, seed=seed)
    h = ds.cg.contact_history([1])
    stiffness = np.pi**2 / (2 * contact_time**2)
    r = np.linspace(0.8, 1, 2001)
    a = (1 + 2 * fraction) ** 2 / (1 - fraction) ** 4
    b = -6 * fraction * (1 + fraction / 2) ** 2 / (1 - fraction) ** 4
    y = a + b * r + fraction * a / 2 * r**3
    density_at_r = r**2 * y / y[-1] * np.exp(-stiffness * (1 - r) ** 2 / 2)
    lifetime = np.trapezoid(density_at_r, r) * np.sqrt(np.pi)
    # the steps of velocity Verlet raise the frequency
    phase = np.pi / contact_time * STEP * contact_time / 2
    lifetime *= phase / np.arcsin(phase)
    error = float(h.lifetime.std()) / np.sqrt(h.sizes["lost"])
    assert abs(float(h.lifetime.mean()) - lifetime) < 3 * error
    assert error < 0.01 * lifetime
    # hard spheres of the same second virial coefficient, at a distance of one
    diameter = 1 - np.sqrt(np.pi / (2 * stiffness))
    at, g = percus_yevick_g(fraction * diameter**3)
    chi = np.interp(1 / diameter, at, g)
    # Enskog's rate of each sphere is 4 n d^2 chi sqrt(pi T)
    rate = particles / 2 * 4 * (6 * fraction / np.pi) * chi * np.sqrt(np.pi)
    expected = rate * float(ds.time[-1])
    assert abs(int(h.births.sum()) - expected) < 3 * np.sqrt(expected)
    assert abs(float(h.contact_count.sum()) * float(ds.time[1]) - expected * lifetime) < (
        3 * np.sqrt(expected) * lifetime
    )


@pytest.mark.parametrize("interval", [1, 5])
def test_steps_too_far_apart_for_contacts_are_named(interval):
    """A row of ten contacts, of which one in five is open at each step; five steps apart all have changed."""
    place = np.zeros((16, 20, 3))
    place[:, :, 0] = 10.0 * (np.arange(20) // 2)
    for t, k in np.ndindex(16, 10):
        place[t, 2 * k + 1, 0] += 0.9 if (t // 5 + k) % 2 else 1.2
    ds = _scene(place, np.arange(16.0), 1.0).isel(time=slice(None, None, interval))
    contacts = ds.cg.find_contacts()
    if interval == 1:
        contacts.cg.contact_history([1])
        return
    with pytest.warns(xcg.SceneWarning, match="100% of the contacts are lost"):
        contacts.cg.contact_history([1])


def test_an_interval_in_which_most_contacts_change_is_named():
    """Forty pairs, of which a tenth changes between steps; between 4 and 5 s 24 of 40 do, as of a lost step."""
    rng = np.random.default_rng(7)
    place = np.zeros((10, 80, 3))
    place[:, :, 0] = 10.0 * (np.arange(80) // 2)
    is_open = np.zeros(40, bool)
    for t in range(10):
        changed = rng.permutation(40)[: 38 if t == 5 else 2]
        is_open[changed] = ~is_open[changed]
        place[t, 1::2, 0] += np.where(is_open, 1.2, 0.9)
    contacts = _scene(place, np.arange(10.0), 1.0).cg.find_contacts()
    with pytest.warns(xcg.SceneWarning, match=r"are lost from 4 to 5 s, and \d% in the median"):
        contacts.cg.contact_history([1])
    contacts.isel(time=slice(5)).cg.contact_history([1])
