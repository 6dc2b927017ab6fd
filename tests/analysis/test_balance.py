"""Residuals of the balance laws fall as the mesh and the time between frames are refined."""

import dask
import numpy as np
import pytest

import xcg
from tests.scenes import random_steps


def close_frames(dt, seed=1, *, species=False):
    """Two frames, dt apart, of grains that move under constant forces from the middle between them.

    With `species`, there are two, which move apart.
    """
    middle = xcg.datasets.random_scene(100, seed=seed, periodic="xyz", gravity=(0.3, 0, -1.0))
    if species:
        middle["velocity"] = middle.velocity + 3.0 * (middle.species - 1.5)
    middle["contact_force"] = 1e3 * middle.contact_force  # as large as weight and inertia
    total = np.zeros((100, 3))
    i = middle.contact_i.values[0]
    j = middle.contact_j.values[0]
    force = middle.contact_force.values[0]
    np.add.at(total, i, force)
    np.add.at(total, j, -force)
    a = total / middle.mass.values[0][:, None] + np.array([0.3, 0, -1.0])
    frames = [
        (
            middle.position.values[0] + s * middle.velocity.values[0] + s**2 / 2 * a,
            middle.velocity.values[0] + s * a,
        )
        for s in (-dt / 2, dt / 2)
    ]
    names = ["diameter", "contact_i", "contact_j", "contact_force"]
    same = {n: [middle[n].values[0]] * 2 for n in names + ["species"] * species}
    point = [
        middle.contact_point.values[0] + s * middle.velocity.values[0][i] for s in (-dt / 2, dt / 2)
    ]
    return xcg.scene_from_arrays(
        [x for x, _ in frames], velocity=[v for _, v in frames], density=2500.0, contact_point=point,
        time=[0.0, dt], box=[[0, 5.0]] * 3, periodic="xyz", gravity=(0.3, 0, -1.0), **same,
    )  # fmt: skip


@pytest.mark.slow
def test_force_residual_falls_with_the_mesh():
    ds = xcg.datasets.random_scene(100, seed=1, periodic="xy")
    norms = [
        float(ds.cg.balance(width=0.8, spacing=h).force_residual_norm.item())
        for h in (0.4, 0.2, 0.1)
    ]
    assert norms[0] > 8 * norms[1] > 64 * norms[2]
    assert norms[2] < 1e-3


def test_mass_and_momentum_residuals_fall_with_the_time_between_frames():
    norms = [close_frames(dt).cg.balance(width=1.2, spacing=0.15) for dt in (0.1, 0.05)]
    for name in ("mass_residual_norm", "momentum_residual_norm"):
        values = [float(n[name].item()) for n in norms]
        assert values[0] > 3 * values[1], (name, values)
    assert norms[0].momentum_residual.dims == ("interval", "x", "y", "z", "component")


def test_residuals_of_each_phase_fall_with_the_mesh_and_with_the_time_between_frames():
    ds = xcg.datasets.random_scene(100, seed=1, periodic="xy")
    norms = [ds.cg.balance(width=0.8, spacing=h, by="species") for h in (0.4, 0.2, 0.1)]
    one, two, three = (float(b.force_residual_norm.item()) for b in norms)
    assert one > 8 * two > 64 * three
    assert three < 1e-3
    # species that move apart: the flux of their momentum is not rho_a V_a V_a
    ways = []
    for dt in (0.1, 0.05):
        half = close_frames(dt, species=True)
        ways.append(half.cg.balance(width=1.2, spacing=0.15, by="species"))
    for name in ("mass_residual", "momentum_residual"):
        for phase in ("bulk", "1", "2"):
            one, two = (float(np.sqrt((b[name].sel(phase=phase) ** 2).mean())) for b in ways)
            assert one > 3 * two, (name, phase, one, two)


@pytest.mark.parametrize("options", [{}, {"axes": "zx"}, {"by": "species"}])
def test_dimensions_and_coordinates_are_in_the_order_of_the_fields(options):
    ds = random_steps(2).assign_attrs(gravity=np.array([0, 0, -1.0]))
    f = ds.cg.coarse_grain("velocity", for_averages=False, **options)
    b = ds.cg.balance(**options)
    assert list(b.sizes) == [*f.sizes, "interval"]
    assert list(b.coords) == [*f.coords, "interval"]
    assert b.momentum_residual.dims == ("interval", *f.velocity.dims[1:])
    assert list(ds.isel(time=0).cg.balance(**options).sizes) == list(f.sizes)[1:]


def test_the_history_of_residuals_is_their_own_call():
    history = (
        xcg.datasets.random_scene(50)
        .cg.balance(width=1.2, quantities=["force"], spacing=1.0)
        .attrs["history"]
    )
    assert "balance(width=1.2, spacing=1.0, kernel='lucy'" in history
    assert "coarse_grain" not in history


def test_a_wrong_force_raises_the_residual():
    ds = close_frames(0.01)
    right = ds.cg.balance(width=1.2, spacing=0.15).momentum_residual_norm.item()
    wrong = ds.assign(contact_force=1.2 * ds.contact_force).cg.balance(width=1.2, spacing=0.15)
    assert wrong.momentum_residual_norm.item() > 5 * right


def test_balance_is_lazy_and_averages():
    ds = close_frames(0.05).chunk(time=1)

    def refuse(dsk, keys, **kwargs):
        pytest.fail("computed while the graph was built")

    with dask.config.set(scheduler=refuse):
        b = ds.cg.balance(width=1.2, spacing=0.1, axes="z")
    assert float(b.force_residual_norm.max()) < 1e-3


def test_wrong_arguments_raise():
    ds = xcg.datasets.random_scene(20)
    with pytest.raises(ValueError, match="fixed axis"):
        ds.cg.balance(axes="x", at={"y": 1.0, "z": 1.0})
    with pytest.raises(ValueError, match="fewer than five"):
        ds.cg.balance(width=1.0, spacing=2.0)


@pytest.mark.parametrize("by", [None, "species"])
def test_momentum_is_balanced_where_parts_of_the_kernel_are_negative(by):
    xcg.register_kernel("negative parts", lambda q: (1 - q**2) ** 4 * (1 - 3 * q**2), smoothness=3)
    rng = np.random.default_rng(1)
    dt = 1e-5
    position, velocity = (
        np.c_[x, np.zeros(25)] for x in (rng.uniform(0, 5, (25, 2)), rng.normal(size=(25, 2)))
    )
    ds = xcg.scene_from_arrays(
        [position, position + dt * velocity], velocity=[velocity] * 2, diameter=np.ones((2, 25)), density=1.0,
        species=[np.arange(25) % 2] * 2, time=[0.0, dt], box=[[0, 5]] * 3, periodic="xy", dimension=2,
        gravity=(0, 0, 0), contact_i=[[0]] * 2, contact_j=[[1]] * 2, contact_point=np.zeros((2, 1, 3)),
        contact_force=np.full((2, 1, 3), 1e-30),  # without a force it would be no contact
    )  # fmt: skip
    options = {"kernel": "negative parts", "width": 0.7, "spacing": 0.05, "by": by}
    assert float(ds.cg.coarse_grain("density", **options).density.min()) < 0
    assert float(ds.cg.balance(**options).momentum_residual_norm.item()) < 1e-3
