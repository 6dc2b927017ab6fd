"""Values of grains become variables of the scene, the same as those of the analyses."""

from __future__ import annotations

import numpy as np
import pytest

import xcg


@pytest.fixture(scope="module")
def flow():
    return xcg.datasets.open("plane_shear").isel(time=slice(0, 3)).load()


def test_coordination_numbers_count_partners_by_brute_force(flow):
    ds = flow.cg.derive("coordination_number")
    for t in range(3):
        step = flow.isel(time=t)
        i, j = (step[f"contact_{side}"].to_numpy() for side in "ij")
        for particle, count in zip(
            step.particle_id.to_numpy()[:40], ds.coordination_number[t].to_numpy(), strict=False
        ):
            partners = {*j[i == particle].tolist()} | {*i[j == particle].tolist()}
            assert count == len(partners)


def test_stress_and_pressure_are_those_of_particle_stress(flow):
    ds = flow.cg.derive(["stress", "pressure", "major_stress"])
    stress = flow.cg.particle_stress()
    np.testing.assert_array_equal(ds.stress, stress.stress)
    np.testing.assert_array_equal(ds.major_stress, stress.major_stress)
    np.testing.assert_allclose(ds.pressure, stress.principal_stress.mean("principal"), atol=1e-12)


def test_mean_ages_grow_with_time_while_contacts_last():
    place = np.zeros((4, 3, 3))
    place[:, 1, 0] = 0.95  # touches the first for the whole series
    place[:, 2, 0] = [3.0, 3.0, 1.9, 1.9]  # touches the second from the third step on
    ds = xcg.scene_from_arrays(place, diameter=np.ones((4, 3)), time=np.arange(4.0))
    age = ds.cg.find_contacts().cg.derive("mean_contact_age").mean_contact_age
    expected = [[0, 0, np.nan], [1, 1, np.nan], [2, 1.0, 0], [3, 2.0, 1]]
    np.testing.assert_allclose(age, expected)


def test_values_are_lazy_where_the_scene_is():
    names = ("coordination_number", "pressure")
    lazy = xcg.datasets.open("plane_shear", chunks=1).isel(time=slice(0, 3))
    assert lazy.cg.derive(names).pressure.chunks is not None
    for name in names:
        np.testing.assert_array_equal(
            lazy.cg.derive(names)[name], lazy.load().cg.derive(names)[name]
        )


def test_values_are_drawn_and_averaged(flow):
    plt = pytest.importorskip("matplotlib.pyplot")
    ds = flow.cg.derive("coordination_number")
    ax = ds.cg.plot("coordination_number")
    assert "number of contact partners" in [axes.get_ylabel() for axes in ax.figure.axes]
    plt.close("all")
    f = ds.cg.coarse_grain(xcg.Mean("coordination_number", "number"), axes="z")
    assert 2 < float(f.mean_coordination_number.max()) < 12


def test_values_are_coloured_in_3d(flow):
    pytest.importorskip("pyvista")
    grains = flow.cg.derive(["coordination_number", "stress"]).cg.to_pyvista(shapes=False)
    assert {"coordination_number", "stress"} <= {*grains["particles"].point_data}


def test_unknown_values_are_named(flow):
    with pytest.raises(ValueError, match=r"'coordination'.*coordination_number"):
        flow.cg.derive("coordination")
    with pytest.raises(xcg.SceneError, match="contact"):
        xcg.datasets.random_scene(20).drop_dims("contact").cg.derive("coordination_number")
