"""Stress, force and fabric: sums against brute force, anisotropies against distributions that have them."""

import re
import warnings

import numpy as np
import pytest
import xarray as xr

import xcg
from tests import truths
from tests.brute_force import BruteKernel, weights
from tests.scenes import random_steps

TENSORS = ["contact_fabric", "branch_fabric", "normal_force_fabric", "tangential_force_fabric"]
ANISOTROPIES = [
    "contact_anisotropy",
    "branch_anisotropy",
    "normal_force_anisotropy",
    "tangential_force_anisotropy",
]
SPLIT = ["strong_contact_stress", "weak_contact_stress"]
GRAINS = ["load_bearing_number_density", "mechanical_coordination_number", "redundancy_number"]
DENSITIES = ["contact_number_density", "branch_length_density", "normal_force_density"]
SLIDING = ["pushing_contact_number_density", "sliding_share", "friction_mobilisation"]
ALL = [*TENSORS, *ANISOTROPIES, "fabric_stress", *SPLIT, *GRAINS, *DENSITIES, *SLIDING]


# --- distributions with known anisotropies ---------------------------------------------------------------


def at_one_point(normal, force, branch=1.0, dimension=3):
    """Contacts that all have their point in the origin, each with grains of its own."""
    half = np.broadcast_to(branch, len(normal))[:, None] * normal / 2
    count = len(normal)
    return xcg.scene_from_arrays(
        np.stack([half, -half], axis=1).reshape(-1, 3), diameter=np.repeat(2 * np.linalg.norm(half, axis=1), 2),
        density=1.0, contact_i=2 * np.arange(count), contact_j=2 * np.arange(count) + 1, contact_force=force,
        contact_point=np.zeros((count, 3)), dimension=dimension,
    )  # fmt: skip


def found_at(ds, fields=(*TENSORS, *ANISOTROPIES, *DENSITIES, "fabric_stress")):
    at = dict.fromkeys(ds.attrs["plane"], 0.0)
    f = ds.cg.coarse_grain(list(fields), axes="", at=at, width=2.0).isel(time=0)
    return {name: f[name].to_numpy() for name in fields}


def plane_directions(a_c, count=240):
    """Angles that are distributed as (1 + a_c cos 2 theta) / 2 pi, each standing for an equal share."""
    share = (np.arange(count) + 0.5) / count * 2 * np.pi
    theta = share.copy()
    for _ in range(60):
        theta -= (theta + a_c / 2 * np.sin(2 * theta) - share) / (1 + a_c * np.cos(2 * theta))
    return theta


@pytest.mark.filterwarnings("ignore:.*do not fit")  # grains lie on each other
@pytest.mark.parametrize(("a_c", "a_n", "a_t", "a_b"), [
    (0.3, 0, 0, 0), (0, 0.4, 0.2, 0), (0, 0, 0.3, 0.1), (0.25, 0.4, 0.15, 0), (0.3, -0.2, 0.1, 0),
])  # fmt: skip
def test_anisotropies_of_a_plane(a_c, a_n, a_t, a_b):
    """Rothenburg & Bathurst: f_n = f0 (1 + a_n cos 2 theta), f_t = -f0 a_t sin 2 theta; of E and f, exactly.

    With both a_c and a_n, the mean force is f0 (1 + a_c a_n / 2), a product that first order leaves out.
    """
    turn, f0, d0 = 0.4, 3.0, 1.5
    theta = plane_directions(a_c)
    angle = theta + turn
    zero = np.zeros_like(theta)
    normal = np.stack([np.cos(angle), np.sin(angle), zero], axis=1)
    tangent = np.stack([-np.sin(angle), np.cos(angle), zero], axis=1)
    along = f0 * (1 + a_n * np.cos(2 * theta))
    across = -f0 * a_t * np.sin(2 * theta)
    force = along[:, None] * normal + across[:, None] * tangent
    ds = at_one_point(normal, force, d0 * (1 + a_b * np.cos(2 * theta)), dimension=2)
    f = found_at(ds)
    mean = 1 + a_c * a_n / 2
    expected = (a_c, a_b, (a_c + a_n) / mean - a_c, a_t / mean)
    for name, value in zip(ANISOTROPIES, expected, strict=True):
        assert f[name] == pytest.approx(abs(value), abs=1e-12), name
    axis = np.array([[np.cos(2 * turn), np.sin(2 * turn)], [np.sin(2 * turn), -np.cos(2 * turn)]])
    np.testing.assert_allclose(
        f["contact_fabric"][:2, :2], np.eye(2) / 2 + a_c / 4 * axis, atol=1e-12
    )
    np.testing.assert_allclose(
        f["tangential_force_fabric"][:2, :2], a_t / 4 / mean * axis, atol=1e-12
    )
    if not a_b:  # sin phi = (a_c + a_n + a_t) / 2, with all of them about the same axis
        n_c = f["contact_number_density"]
        sums = n_c * np.einsum("ni,nj->ij", force, normal * d0) / len(normal)
        np.testing.assert_allclose(f["fabric_stress"], sums, atol=1e-12 * n_c * f0)
        one, two = np.linalg.eigvalsh((sums + sums.T)[:2, :2])
        assert (two - one) / (two + one) == pytest.approx(sum(expected) / 2, abs=1e-12)


GOLDEN = (1 + np.sqrt(5)) / 2
# twelve directions over which polynomials of degree five have the mean that they have over the sphere
ICOSAHEDRON = np.array(
    [np.roll([0, s, t * GOLDEN], k) for k in range(3) for s in (-1, 1) for t in (-1, 1)]
) / np.sqrt(1 + GOLDEN**2)  # fmt: skip


def test_anisotropies_of_forces_and_branches_in_space():
    """Guo & Zhao: f_n = f0 (1 + a : n n), f_t = f0 (a . n - (n . a . n) n), and the stress from them."""
    rng = np.random.default_rng(2)
    n = ICOSAHEDRON
    f0 = 2.0
    d0 = 1.5
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    a_n, a_t, a_b = (turn @ np.diag([-x / 3, -x / 3, 2 * x / 3]) @ turn.T for x in (0.4, 0.3, 0.2))
    along = f0 * (1 + np.einsum("ij,ni,nj->n", a_n, n, n))
    across = f0 * (n @ a_t - np.einsum("ij,ni,nj->n", a_t, n, n)[:, None] * n)
    force = along[:, None] * n + across
    f = found_at(at_one_point(n, force, d0 * (1 + np.einsum("ij,ni,nj->n", a_b, n, n))))
    for name, value in zip(ANISOTROPIES, (0.0, 0.2, 0.4, 0.3), strict=True):
        assert f[name] == pytest.approx(value, abs=1e-12), name
    np.testing.assert_allclose(f["normal_force_fabric"], np.eye(3) / 3 + 2 / 15 * a_n, atol=1e-12)
    np.testing.assert_allclose(f["tangential_force_fabric"], a_t / 5, atol=1e-12)
    f = found_at(at_one_point(n, force, d0))
    pressure = f["contact_number_density"] * f0 * d0 / 3
    np.testing.assert_allclose(
        f["fabric_stress"], pressure * (np.eye(3) + 2 / 5 * (a_n + 1.5 * a_t)), rtol=1e-12
    )


@pytest.mark.filterwarnings("ignore:.*do not fit")  # grains lie on each other
def test_anisotropy_of_contacts_in_space():
    """Contacts by direction as (1 + a (z^2 - 1/3)) / 4 pi, each an equal share: a_1 - a_3 = a."""
    a = 0.6
    share = (np.arange(1500) + 0.5) / 1500
    z = 2 * share - 1
    for _ in range(60):
        z -= ((z + 1) / 2 + a / 6 * (z**3 - z) - share) / (0.5 + a / 6 * (3 * z**2 - 1))
    around = np.arange(6) * np.pi / 3
    ring = np.sqrt(1 - z**2)[:, None]
    normal = np.stack(
        [ring * np.cos(around), ring * np.sin(around), z[:, None] + 0 * around], axis=-1
    ).reshape(-1, 3)
    f = found_at(
        at_one_point(normal, normal, 1.0),
        ["contact_anisotropy", "contact_fabric", "normal_force_anisotropy"],
    )
    assert f["contact_anisotropy"] == pytest.approx(a, rel=1e-5)
    assert f["normal_force_anisotropy"] == pytest.approx(0.0, abs=1e-12)
    assert f["contact_fabric"][2, 2] == pytest.approx(1 / 3 + 2 / 15 * 2 / 3 * a, rel=1e-6)


# --- brute force -----------------------------------------------------------------------------------------


PLACES = [
    ({"periodic": "xy"}, "xyz"), ({"periodic": "xy", "edge": 3.0}, "xz"), ({}, "z"), ({}, ""),
    ({"dimension": 2, "periodic": "x"}, "xy"), ({"dimension": 2}, "y"),
]  # fmt: skip


@pytest.mark.parametrize(("scene", "axes"), PLACES)
def test_sums_over_contacts_equal_brute_force(scene, axes):
    ds = xcg.datasets.random_scene(60, seed=12, **scene)
    plane = ds.attrs["plane"]
    dimension = ds.attrs["dimension"]
    friction = 0.4
    extent = {a: 4.0 for a in plane if a not in axes and a not in ds.attrs["periodic"]}
    options = {"axes": axes, "width": 0.8, "spacing": 0.9, "extent": extent, "by": "species"}
    f = ds.cg.coarse_grain(ALL, friction=friction, **options)
    free = ds.cg.coarse_grain("redundancy_number", friction=1e9, **options).redundancy_number
    frame = {name: ds[name].to_numpy()[0] for name in ds.data_vars}
    position = frame["position"]
    point = frame["contact_point"]
    force = frame["contact_force"]
    box = frame["box"]
    period = np.array(
        [np.ptp(box[k]) if a in ds.attrs["periodic"] else np.inf for k, a in enumerate("xyz")]
    )
    row = {number: k for k, number in enumerate(frame["particle_id"].tolist())}
    i, j = (
        np.array([row.get(k, -1) for k in frame[name].tolist()])
        for name in ("contact_i", "contact_j")
    )

    def nearest(v):
        return v - np.where(np.isfinite(period), period, 0.0) * np.rint(v / period)

    branch = nearest(position[i] - np.where(j[:, None] < 0, point, position[j]))
    normal = branch / np.linalg.norm(branch, axis=1)[:, None]
    along = (force * normal).sum(1)
    across = force - along[:, None] * normal
    partners = [{(b, True) if b >= 0 else (n, False) for n, (a, b) in enumerate(zip(i, j, strict=True)) if a == k}
                | {(a, True) for a, b in zip(i, j, strict=True) if b == k} for k in range(len(position))]  # fmt: skip
    z = np.array([len(p) for p in partners])
    load_bearing = z >= 2
    both = load_bearing[i] & (load_bearing[j] | (j < 0))
    pushes = along > 0
    mobilised = np.linalg.norm(across, axis=1) / np.where(pushes, friction * along, np.inf)
    at_limit = mobilised >= 0.999
    slides = both & at_limit
    assert slides.any()
    assert not pushes.all()
    assert (both & ~slides).any()
    kernel = BruteKernel("lucy", 0.8, dimension, len(axes)) if axes else None
    grains, contacts = (weights(ds, kernel, f, places, extent) for places in (position, point))
    inside = np.isin(np.arange(3), ["xyz".index(a) for a in plane])

    def total(weight, *columns):
        """Sum over contacts of the product of columns, with one index more for each vector."""
        letters = "ij"[: sum(c.ndim == 2 for c in columns)]
        subscripts = [
            "pn",
            *("n" if c.ndim == 1 else "n" + letters[k] for k, c in numbered(columns)),
        ]
        return np.einsum(f"{','.join(subscripts)}->p{letters}", weight, *columns)

    def numbered(columns):
        k = 0
        for c in columns:
            yield k, c
            k += c.ndim == 2

    def dev(x):
        x = (x + x.swapaxes(-1, -2)) / 2
        return x - np.einsum("...kk->...", x)[..., None, None] / dimension * np.diag(
            inside.astype(float)
        )

    def size(x):
        return np.sqrt((3 / 2 if dimension == 3 else 1 / 2) * (x**2).sum((-1, -2)))

    k, k_t = (7.5, 5.0) if dimension == 3 else (4.0, 4.0)
    species = frame["species"]
    for phase in ("bulk", "1", "2"):
        g = f.sel(phase=phase)
        one = np.ones(len(species)) if phase == "bulk" else (species == int(phase)).astype(float)
        psi = contacts * np.where(j < 0, one[i], (one[i] + one[j]) / 2)
        n_c = psi.sum(1)
        length = psi @ (branch * normal).sum(1)
        push = psi @ along
        with np.errstate(all="ignore"):

            def over(a, b):
                return a / np.where(b > 0, b, np.nan).reshape(-1, *(1,) * (a.ndim - 1))

            phi = over(total(psi, normal, normal), n_c)
            x_b = over(total(psi, np.linalg.norm(branch, axis=1), normal, normal), length)
            x_n = over(total(psi, along, normal, normal), push)
            x_t = over(total(psi, across, normal), push)
            sums = grains @ (one * load_bearing)
            per_grain = dimension * (dimension + 1) / 2
            expected = {
                "contact_number_density": n_c, "branch_length_density": length, "normal_force_density": push,
                "contact_fabric": phi, "branch_fabric": x_b, "normal_force_fabric": x_n,
                "tangential_force_fabric": x_t, "contact_anisotropy": size(k * dev(phi)),
                "branch_anisotropy": size(k * dev(x_b - phi)), "normal_force_anisotropy": size(k * dev(x_n - phi)),
                "tangential_force_anisotropy": size(k_t * dev(x_t)),
                "fabric_stress": over(push * length, n_c)[:, None, None] * (x_n + x_b - phi + x_t),
                "load_bearing_number_density": sums,
                "mechanical_coordination_number": over(grains @ (one * load_bearing * z), sums),
                "redundancy_number": over(
                    psi @ (both * (dimension - (dimension - 1) * slides)), per_grain * sums
                ),
                "pushing_contact_number_density": psi @ pushes,
                "sliding_share": over(psi @ at_limit, psi @ pushes),
                "friction_mobilisation": over(psi @ mobilised, psi @ pushes),
            }  # fmt: skip
        for name, value in expected.items():
            close(g[name], value, name)
        close(
            free.sel(phase=phase),
            over(psi @ both * dimension, per_grain * sums),
            "without friction",
        )
    strong = along > along[along > 0].mean()
    for name, kept in zip(SPLIT, (strong, ~strong), strict=True):
        part = ds.assign(
            contact_force=ds.contact_force.where(
                xr.DataArray(kept[None], dims=("time", "contact")), 0.0
            )
        )
        alone = part.cg.coarse_grain("contact_stress", **options).contact_stress
        np.testing.assert_allclose(f[name], alone, rtol=0, atol=1e-12 * float(abs(alone).max()))


def close(found, expected, name):
    found = found.to_numpy()[0].reshape(expected.shape)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(expected), err_msg=name)
    # ratios of sums of forces of both signs amplify rounding
    scale = max(np.nanmax(np.abs(expected), initial=0.0), 1e-300)
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-12 * scale, err_msg=name)


# --- beside the microstructure, and identities -----------------------------------------------------------


@pytest.mark.parametrize("dimension", [2, 3])
def test_averages_of_a_whole_box_are_the_microstructure(dimension):
    ds = xcg.datasets.random_scene(150, seed=3, dimension=dimension, periodic="xyz"[:dimension])
    f = ds.cg.coarse_grain(
        ["contact_fabric", "contact_anisotropy", "mechanical_coordination_number"], axes=""
    )
    m = ds.cg.microstructure(["fabric", "fabric_anisotropy", "mechanical_coordination_number"])
    for name, other in (
        ("contact_fabric", "fabric"),
        ("contact_anisotropy", "fabric_anisotropy"),
        2 * (GRAINS[1],),
    ):
        np.testing.assert_allclose(f[name], m[other], rtol=1e-12, atol=1e-14)


def test_fabric_tensors_give_the_stress_where_branches_are_equal():
    """In a whole box contact stress is the sum of f l, whatever the kernel."""
    ds = xcg.datasets.face_centred_cubic(3)
    noise = np.random.default_rng(1).normal(size=ds.contact_force.shape)
    ds = ds.assign(contact_force=ds.contact_force * (1 + 0.2 * noise))
    f = ds.cg.coarse_grain(["fabric_stress", "contact_stress"], axes="")
    np.testing.assert_allclose(
        f.fabric_stress, f.contact_stress, rtol=0, atol=1e-12 * float(f.contact_stress.max())
    )


def test_redundancy_factor_of_a_lattice():
    """Three contacts a grain: 9 constraints for 6 degrees of freedom; 3 where they only push."""
    ds = xcg.datasets.simple_cubic(4)
    with pytest.warns(xcg.SceneWarning, match="without friction= .* 3 times too large"):
        f = ds.cg.coarse_grain(GRAINS, axes="")
    assert f.redundancy_number.item() == pytest.approx(1.5, rel=1e-12)
    f = ds.cg.coarse_grain(GRAINS, axes="", friction=0.0)
    assert f.redundancy_number.item() == pytest.approx(0.5, rel=1e-12)
    assert f.mechanical_coordination_number.item() == pytest.approx(6.0, rel=1e-12)
    f = ds.cg.coarse_grain(GRAINS, axes="", friction=0.3)
    assert f.redundancy_number.item() == pytest.approx(1.5, rel=1e-12)
    with pytest.raises(ValueError, match="friction=-1"):
        ds.cg.coarse_grain("redundancy_number", friction=-1)


@pytest.mark.parametrize("name", ["sliding_share", "friction_mobilisation"])
def test_mobilised_friction_needs_its_coefficient(name):
    ds = xcg.datasets.random_scene(60, seed=12)
    with pytest.raises(ValueError, match=f"{name} needs the argument friction="):
        ds.cg.coarse_grain(name)
    assert ds.cg.coarse_grain(name, axes="", friction=0.4)[name].notnull().all()


@pytest.mark.parametrize("lattice", [xcg.datasets.simple_cubic, xcg.datasets.face_centred_cubic])
def test_equal_forces_are_all_weak(lattice):
    """Normal forces that are the same but for rounding, on either side of their mean."""
    ds = lattice(5, diameter=0.1, force=0.1)
    f = ds.cg.coarse_grain([*SPLIT, "contact_stress"], axes="z", width=0.1)
    assert not f.strong_contact_stress.any()
    np.testing.assert_array_equal(f.weak_contact_stress, f.contact_stress)


def test_strong_contacts_push_more_than_the_mean():
    force = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 4.0], [-9.0, 0, 0]])  # the last one pulls
    normal = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 0]])
    f = found_at(
        at_one_point(normal, force),
        ["strong_contact_stress", "weak_contact_stress", "contact_stress"],
    )
    np.testing.assert_allclose(
        np.diag(f["strong_contact_stress"]), [0, 0, f["contact_stress"][2, 2]]
    )
    np.testing.assert_allclose(
        f["strong_contact_stress"] + f["weak_contact_stress"], f["contact_stress"]
    )


@pytest.mark.filterwarnings("ignore:time_average. tangential_force_anisotropy is")
def test_averages_are_ratios_of_averaged_sums():
    ds = random_steps(3)
    f = ds.cg.coarse_grain(
        ALL, by="species", width=0.9, spacing=0.8, friction=0.4, for_averages=True
    )
    mean = f.cg.time_average()
    n_c = f.contact_number_density
    total = (f.contact_fabric.fillna(0.0) * n_c).mean("time") / n_c.mean("time").where(
        n_c.mean("time") > 0
    )
    xr.testing.assert_allclose(mean.contact_fabric, total.transpose(*mean.contact_fabric.dims))
    pushing = f.pushing_contact_number_density
    slides = (f.sliding_share.fillna(0.0) * pushing).mean("time")
    share = (slides / pushing.mean("time")).where(pushing.mean("time") > 0)
    xr.testing.assert_allclose(mean.sliding_share, share.transpose(*mean.sliding_share.dims))
    lazy = ds.chunk(time=1).cg.coarse_grain(ALL, by="species", width=0.9, spacing=0.8, friction=0.4)
    assert lazy.contact_fabric.chunks is not None
    xr.testing.assert_equal(lazy.compute(), f[list(lazy)])


def test_only_needed_variables_are_read():
    ds = xcg.datasets.random_scene(30)
    without = ds.drop_vars(["contact_force", "velocity", "mass", "density", "volume"])
    f = without.cg.coarse_grain(
        ["contact_fabric", "branch_fabric", "mechanical_coordination_number"], axes="z"
    )
    assert float(f.contact_fabric.isnull().mean()) < 1
    plan = ds.cg.explain(["contact_anisotropy"], axes="z")
    assert set(plan.variables) == {
        "particle_id",
        "position",
        "diameter",
        "contact_i",
        "contact_j",
        "contact_point",
    }


def of_depth(ds, force):
    """Return what strong contacts of a packing warn of, whose forces are multiplied by a function of z."""
    z = ds.contact_point.sel(component="z", drop=True)
    ds = ds.assign(contact_force=ds.contact_force * force(z))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        ds.cg.coarse_grain("strong_contact_stress")
    return [str(one.message) for one in told if "strong_contact_stress" in str(one.message)]


def test_strong_contacts_warn_where_the_mean_force_grows_with_depth():
    ds = xcg.datasets.dense_packing(2000, periodic="xy")
    height = float(ds.position.sel(component="z").max())
    (text,) = of_depth(ds, lambda z: 1.0 - 0.9 * z / height)
    assert re.search(r"varies by [3-9][.\d]* along z, .*thin along z", text)
    assert of_depth(ds, lambda z: 1.0 - 0.3 * z / height) == []
    assert of_depth(ds, xr.ones_like) == []


def test_strong_contacts_of_packings_without_gravity_and_along_periods_are_silent():
    for seed in range(5):
        ds = xcg.datasets.random_scene(300, seed=seed, periodic="")
        assert of_depth(ds, xr.ones_like) == []
    assert of_depth(truths.packing(steps=1), xr.ones_like) == []
    waves = xcg.datasets.dense_packing(2000)
    assert of_depth(waves, lambda z: 1.1 + np.sin(z)) == []
