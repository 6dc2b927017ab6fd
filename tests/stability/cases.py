"""One function a case: the error of the naive method, that of xcg, and the bound that xcg is held to.

The same functions serve the tests and the table of `docs/stability.py`. Errors are relative to the size of the field.
"""

import warnings
from dataclasses import dataclass

import numpy as np

import xcg
from tests.brute_force import BruteKernel


@dataclass(frozen=True)
class Case:
    what: str
    fails: str
    does: str
    naive: float
    ours: float
    bound: float
    unknown: bool = False  # the right answer is NaN


def _relative(values, truth, scale=None):
    truth = np.asarray(truth, float)
    return float(
        np.nanmax(np.abs(np.asarray(values, float) - truth)) / (scale or np.nanmax(np.abs(truth)))
    )


def _point(r):
    return dict(zip("xyz", map(float, r), strict=True))


def part_of_the_box():
    """Depth profile of a lattice from a window half as wide as the box."""
    ds = xcg.datasets.simple_cubic(6, density=1.0)
    truth = float(ds.mass.sum()) / 6**3
    whole = ds.cg.coarse_grain("density", axes="", width=0.75)
    inside = (ds.position.sel(component=["x", "y"]) < 3.0).all("component")
    smeared = ds.isel(particle=inside.values[0]).cg.coarse_grain(
        "density", axes="xyz", width=0.75, spacing=0.25
    )
    window = smeared.density.sel(x=slice(0, 2.99), y=slice(0, 2.99)).mean()
    return Case(
        "average over part of the box", "kernels at the window's edge reach out, and none reach in",
        "integral over the whole axis, divided by its extent; bounds on an averaged axis are refused",
        _relative(window, truth), _relative(whole.density, truth), 1e-12,
    )  # fmt: skip


def few_grains():
    """Temperature at nodes that see one to four grains; the truth is unknown, so any number is wrong by 100 %."""
    rng = np.random.default_rng(1)
    ds = xcg.scene_from_arrays(
        rng.uniform(-0.3, 0.3, (4, 3)),
        velocity=rng.normal(size=(4, 3)),
        diameter=np.ones(4),
        density=1.0,
    )
    f = ds.cg.coarse_grain(
        ["granular_temperature", "velocity_gradient", "sample_count"], axes="", at=_point([0, 0, 0])
    )
    g = f.velocity_gradient.values[0]
    told = (
        np.isnan(f.granular_temperature.item())
        and f.sample_count.item() == 4
        and np.isfinite(g).all()
    )
    pair = ds.isel(particle=slice(0, 2)).cg.coarse_grain(
        "velocity_gradient", axes="", at=_point([0, 0, 0])
    )
    told = told and np.isnan(pair.velocity_gradient.values).all()
    return Case(
        "few grains in the support", "a fit through four grains leaves T = 0; through two, a singular matrix",
        "NaN with the count beside it; derivatives only along directions that the grains span",
        1.0, 0.0 if told else 1.0, 0.1, unknown=True,
    )  # fmt: skip


def temperature_at_the_default_width():
    """Mean temperature of independent velocities, where a node sees some 16 grains."""
    ds = xcg.datasets.dense_packing(4000)
    ds = ds.assign(
        velocity=(ds.velocity.dims, np.random.default_rng(1).normal(size=ds.velocity.shape))
    )
    f = ds.cg.coarse_grain(
        ["granular_temperature", "fluctuation_density", "fluctuation_stress", "density"]
    )
    known = f.granular_temperature.notnull()
    free = f.fluctuation_density.where(known, 0.0)
    ours = (f.granular_temperature.fillna(0.0) * free).sum() / free.sum()
    left = (
        sum(f.fluctuation_stress.sel(component=a, direction=a).where(known, 0.0) for a in "xyz") / 3
    )
    truth = float((ds.velocity**2).mean())
    return Case(
        "temperature at a width of 0.75 d", "the fitted V and gradient contain part of the fluctuations",
        "fluctuations over the density less what the fit takes (error left: one step)",
        _relative(left.sum() / f.density.where(known, 0.0).sum(), truth), _relative(ours, truth), 0.05,
    )  # fmt: skip


def fast_frame():
    """Temperature in a frame a million times faster than the fluctuations."""
    ds = xcg.datasets.random_scene(300, seed=2)
    fast = ds.assign(velocity=ds.velocity + 1e6)
    at = _point([2.5, 2.5, 2.5])
    slow = ds.cg.coarse_grain("kinetic_stress", axes="", at=at, width=1.0).kinetic_stress.values[0]
    ours = fast.cg.coarse_grain("kinetic_stress", axes="", at=at, width=1.0).kinetic_stress.values[
        0
    ]
    kernel = BruteKernel("lucy", 1.0)
    x = ds.position.values[0]
    v = fast.velocity.values[0]
    m = ds.mass.values[0]
    dx = x - 2.5
    dx -= 5.0 * np.rint(dx / 5.0)
    w = m * kernel(np.linalg.norm(dx, axis=1))
    naive = np.einsum("n,ni,nj->ij", w, v, v) - np.outer(w @ v, w @ v) / w.sum()
    # adding 1e6 rounds the fluctuations themselves to 1e-10
    return Case(
        "fast frame, |V| / |v'| = 1e6", "sum m v v - rho V V cancels",
        "velocities relative to the first grain that reaches a node",
        _relative(naive, slow), _relative(ours, slow), 1e-6,
    )  # fmt: skip


def far_origin():
    """Stress of a scene a million diameters from the origin."""
    ds = xcg.datasets.random_scene(200, seed=3, periodic="")
    shift = 2.0**20
    moved = ds.assign(
        position=ds.position + shift, contact_point=ds.contact_point + shift, box=ds.box + shift
    )
    # what is left of the coordinates: the same scene with the digits that the shift cut off
    back = moved.assign(
        position=moved.position - shift, contact_point=moved.contact_point - shift, box=ds.box
    )
    at = np.array([2.5, 2.5, 2.5])
    near = back.cg.coarse_grain("density", axes="", at=_point(at), width=0.8).density.item()
    ours = moved.cg.coarse_grain(
        "density", axes="", at=_point(at + shift), width=0.8
    ).density.item()
    x = moved.position.values[0]
    r = at + shift
    squared = np.maximum(
        (x**2).sum(axis=1) - 2 * x @ r + r @ r, 0
    )  # the expanded square of fast distance matrices
    naive = moved.mass.values[0] @ BruteKernel("lucy", 0.8)(np.sqrt(squared))
    return Case(
        "coordinates 1e6 diameters from the origin", "|x - r|^2 expanded into x^2 - 2 x r + r^2 keeps no digits",
        "coordinates relative to the grid", _relative(naive, near), _relative(ours, near), 1e-12,
    )  # fmt: skip


def narrow_kernel():
    """Contact stress at w = 0.3 d: the branch is as long as the support."""
    kernel = xcg.Lucy(0.3)
    start = np.zeros(3)
    end = np.array([1.0, 0.0, 0.0])
    points = np.random.default_rng(4).uniform([-0.6, -0.6, -0.6], [1.6, 0.6, 0.6], (4000, 3))
    points[::4, 1:] = 0
    truth = np.array([BruteKernel("lucy", 0.3).segment(p, start, end) for p in points])
    return Case(
        "width below half a diameter", "three Gauss points on the branch leave gaps between them",
        "closed form; with rtol, as many points as the branch over the cutoff needs",
        _relative(kernel.segment(points, start, end, 3), truth), _relative(kernel.segment(points, start, end), truth),
        1e-12,
    )  # fmt: skip


def support_beyond_the_box():
    """Density in a periodic box smaller than the support."""
    ds = xcg.datasets.random_scene(30, seed=5, edge=1.0)
    at = np.array([0.2, 0.4, 0.9])
    ours = ds.cg.coarse_grain("density", axes="", at=_point(at), width=0.9).density.item()
    x = ds.position.values[0]
    m = ds.mass.values[0]
    kernel = BruteKernel("lucy", 0.9)
    nearest = x - at - np.rint(x - at)
    naive = m @ kernel(np.linalg.norm(nearest, axis=1))
    shifts = np.stack(np.meshgrid(*[np.arange(-3, 4)] * 3), axis=-1).reshape(-1, 3)
    truth = sum(m @ kernel(np.linalg.norm(x + s - at, axis=1)) for s in shifts)
    return Case(
        "support larger than the periodic box", "the nearest image alone counts each grain once",
        "all images that reach a node", _relative(naive, truth), _relative(ours, truth), 1e-12,
    )  # fmt: skip


def contact_across_the_edge():
    """Stress of two grains that touch across a periodic edge, averaged over the box."""
    ds = xcg.scene_from_arrays(
        [[0.4, 5, 5], [9.5, 5, 5]], diameter=[1.0, 1.0], density=1.0, velocity=np.zeros((2, 3)),
        contact_i=[0], contact_j=[1], contact_force=[[2.0, 0, 0]], box=[[0, 10]] * 3, periodic="xyz",
    )  # fmt: skip
    truth = 2.0 * 0.9 / 1000
    naive = 2.0 * (0.4 - 9.5) / 1000
    ours = ds.cg.coarse_grain("contact_stress", axes="", width=0.75).contact_stress.values[0, 0, 0]
    return Case(
        "contact across a periodic edge", "the branch is a whole box long",
        "shortest image for the branch, all images for the deposit",
        _relative(naive, truth), _relative(ours, truth), 1e-12,
    )  # fmt: skip


def jumping_kernel():
    """Velocity gradient of a uniform shear, seen through a Heaviside."""
    ds = xcg.datasets.random_scene(400, seed=6, periodic="")
    ds["velocity"] = ds.position.sel(component=["y", "y", "y"]).drop_vars("component") * np.array(
        [1.0, 0, 0]
    )
    at = np.array([2.5, 2.5, 2.5])
    h = 1e-3
    options = {"kernel": "heaviside", "width": 1.2, "axes": ""}
    ours = ds.cg.coarse_grain(
        "velocity_gradient", at=_point(at), **options
    ).velocity_gradient.values[0, 0, 1]
    worst = 0.0
    for y in np.linspace(2, 3, 41):
        v = [
            ds.cg.coarse_grain("velocity", at=_point([2.5, y + s, 2.5]), **options).velocity.values[
                0, 0
            ]
            for s in (-h, h)
        ]
        worst = max(worst, abs((v[1] - v[0]) / (2 * h) - 1.0))
    return Case(
        "kernels that jump (Heaviside, cut Gaussian)", "finite differences divide the jumps by the step",
        "the fit through the grains needs no derivative of the kernel; gradient='kernel' refuses a Heaviside",
        worst, abs(ours - 1.0), 1e-12,
    )  # fmt: skip


def polydisperse():
    """Volume fraction of small grains in a layer, one width for all against one of their own."""
    rng = np.random.default_rng(7)
    small = rng.uniform([0, 0, 0], [20, 20, 1], (8000, 3))
    big = rng.uniform([0, 0, 1], [20, 20, 20], (40, 3))
    ds = xcg.scene_from_arrays(
        np.concatenate([small, big]), diameter=[0.2] * 8000 + [4.0] * 40, density=1.0,
        species=[1] * 8000 + [2] * 40, box=[[0, 20]] * 3, periodic="xy",
    )  # fmt: skip
    at = {"axes": "z", "bounds": {"z": (0.5, 0.5)}, "spacing": 1.0}
    truth = 8000 * np.pi / 6 * 0.2**3 / 400
    one = ds.cg.coarse_grain("volume_fraction", by="species", width="0.75 d43", **at)
    own = ds.cg.coarse_grain("volume_fraction", by="species", width={1: 0.15, 2: "0.75 d43"}, **at)
    return Case(
        "very polydisperse, dmax / dmin = 20", "the width that the large grains need smears a layer of small ones away",
        "each phase can take a width of its own (spread left: counting noise of the small grains)",
        _relative(one.volume_fraction.sel(phase="1"), truth), _relative(own.volume_fraction.sel(phase="1"), truth), 0.1,
    )  # fmt: skip


def near_a_wall():
    """Force balance of one grain that rests on a wall."""
    weight = np.pi / 6 * 9.81
    ds = xcg.scene_from_arrays(
        [[0.0, 0, 0.5]], diameter=[1.0], density=1.0, velocity=np.zeros((1, 3)), contact_i=[0], contact_j=[-1],
        contact_force=[[0, 0, weight]], contact_point=[[0, 0, 0.0]],
    )  # fmt: skip
    f = ds.cg.coarse_grain(
        ["contact_stress", "boundary_force_density", "density"], axes="z", extent={"x": 1.0, "y": 1.0},
        spacing=1e-3, bounds={"z": (-1.5, 2.0)},
    ).isel(time=0)  # fmt: skip
    slope = f.contact_stress.sel(component="z", direction="z").differentiate("z")
    load = -9.81 * f.density
    left = slope - load - f.boundary_force_density.sel(component="z")
    scale = float(np.abs(load).max())
    return Case(
        "near walls", "without the wall's contact the weight is not supported",
        "contacts with walls keep their side of the stress, and the wall's traction stands in the balance",
        float(np.abs(load).max()) / scale, float(np.abs(left[1:-1]).max()) / scale, 1e-5,
    )  # fmt: skip


def degenerate_rows():
    """A grain on a node, coincident grains, a branch of no length, a grain of no mass."""
    with warnings.catch_warnings():  # of the branch of no length
        warnings.filterwarnings("ignore", ".*at the same position")
        ds = xcg.scene_from_arrays(
            [[0.0, 0, 0], [0.0, 0, 0], [1.0, 0, 0], [0.5, 0.5, 0]],
            diameter=np.ones(4),
            mass=[1.0, 1.0, 1.0, 0.0],
            velocity=np.arange(12.0).reshape(4, 3),
            contact_i=[0, 0],
            contact_j=[1, 2],
            contact_force=np.ones((2, 3)),
            contact_normal=[[1.0, 0, 0], [-1.0, 0, 0]],
        )
    f = ds.cg.coarse_grain(axes="", at=_point([0, 0, 0]), width=0.75)
    finite = [
        name
        for name in f
        if name not in ("inertial_number", "friction_coefficient") and f[name].notnull().all()
    ]
    missing = (
        {str(n) for n in f} - set(map(str, finite)) - {"inertial_number", "friction_coefficient"}
    )
    expected = {
        "granular_temperature",
        "fluctuation_stress",
        "velocity_gradient",
        "shear_rate_tensor",
        "shear_rate",
    }
    try:
        xcg.scene_from_arrays([[np.nan, 0, 0]], diameter=[1.0], density=1.0)
    except xcg.SceneError as error:
        named = "row 0" in str(error)
    else:
        named = False
    return Case(
        "degenerate rows", "division by a length or mass of zero; NaN spreads",
        "a defined value, NaN where nothing is known, or an error that names the row",
        1.0, 0.0 if missing <= expected and named else 1.0, 0.1, unknown=True,
    )  # fmt: skip


CASES = [
    part_of_the_box, few_grains, temperature_at_the_default_width, fast_frame, far_origin, narrow_kernel,
    support_beyond_the_box, contact_across_the_edge, jumping_kernel, polydisperse, near_a_wall, degenerate_rows,
]  # fmt: skip
