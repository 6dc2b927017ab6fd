"""A volume fraction that cannot be is warned of: where, why, and what to do."""

import warnings

import numpy as np
import pytest

import xcg
from xcg import SceneWarning


@pytest.mark.parametrize("dimension", [3, 2])
def test_a_kernel_narrower_than_the_largest_grain_warns(dimension):
    """Its volume times the kernel's largest value is the fraction at its centre."""
    small = xcg.datasets.random_scene(200, dimension=dimension, seed=2)
    position, diameter = small.position.values[0], small.diameter.values[0].copy()
    diameter[:] = 0.1
    diameter[5] = 1.0
    ds = xcg.scene_from_arrays(position, velocity=0 * position, diameter=diameter, density=1.0, dimension=dimension)
    at = dict(zip("xyz", position[5], strict=True)) if dimension == 3 else dict(zip("xy", position[5], strict=False))
    kernel = xcg.Lucy(0.2, dimension=dimension)
    with pytest.warns(SceneWarning, match="kernel is narrower than the largest grains, one of which alone") as told:
        f = ds.cg.coarse_grain("volume_fraction", axes="", at=at, kernel=kernel)
    volume = np.pi / 6 * (1.0 if dimension == 3 else 1.0 / 1.0)
    assert float(f.volume_fraction.max()) >= volume * float(kernel.value(0.0)) > 1.0
    assert len(told) == 1
    assert all(f"{a} = {value:.4g}" in str(told[0].message) for a, value in at.items())


def test_overlapping_grains_warn():
    position = np.random.default_rng(0).uniform(0, 2, (200, 3))
    ds = xcg.scene_from_arrays(position, velocity=0 * position, diameter=np.full(200, 0.8), density=1.0)
    with pytest.warns(SceneWarning, match="grains overlap, or their sizes"):
        ds.cg.coarse_grain("volume_fraction", width=0.8, axes="", at={"x": 1.0, "y": 1.0, "z": 1.0})


def test_possible_volume_fractions_do_not_warn():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        xcg.datasets.face_centred_cubic().cg.coarse_grain("volume_fraction")


def test_a_width_below_the_largest_diameter_warns():
    position = np.random.default_rng(0).uniform(0, 5, (300, 3))
    diameter = np.full(300, 0.1)
    diameter[0] = 3.0
    ds = xcg.scene_from_arrays(
        position, velocity=0 * position, diameter=diameter, mass=np.ones(300), box=[[0, 5.0]] * 3
    )
    ds.attrs["d43"] = 0.1  # the width is narrow for the largest grain alone
    with pytest.warns(SceneWarning, match="of the diameter of the largest grains"):
        ds.cg.coarse_grain("number_density", width=0.2, axes="")
