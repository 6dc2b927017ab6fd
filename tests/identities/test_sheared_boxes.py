"""Structure in boxes of Lees and Edwards: an offset of a whole period is no offset."""

import numpy as np
import pytest
import xarray as xr

import xcg

EDGE = 5.0
OFFSETS = np.array([0.0, 0.4, 2.3])


def sheared(offsets: np.ndarray) -> xr.Dataset:
    """Return one arrangement of spheres, whose images along y have another offset in each step."""
    r = np.random.default_rng(4)
    steps = len(offsets)
    return xcg.scene_from_arrays(
        np.tile(r.uniform(0, EDGE, (80, 3)), (steps, 1, 1)),
        diameter=np.tile(r.uniform(0.3, 0.9, 80), (steps, 1)),
        density=1.0,
        time=np.arange(float(steps)),
        box=dict.fromkeys("xyz", (0, EDGE)),
        periodic="xyz",
        lattice={"xy": offsets},
        shear_rate={"xy": 0.1},
    )


CALLS = {
    "radial_distribution": lambda ds: ds.cg.radial_distribution(1.9, bins=9, axis="z", angles=4),
    "structure_factor": lambda ds: ds.cg.structure_factor(6.0, bins=4, samples=None),
    "bond_order": lambda ds: ds.cg.bond_order(),
    "voronoi": lambda ds: pytest.importorskip("pyvoro2") and ds.cg.voronoi(),
}


@pytest.mark.parametrize("call", CALLS)
def test_an_offset_of_whole_periods_changes_nothing(call):
    compute = CALLS[call]
    found = compute(sheared(OFFSETS))
    later = compute(sheared(OFFSETS + np.array([EDGE, 2 * EDGE, EDGE])))
    for name in found.data_vars:
        np.testing.assert_allclose(later[name], found[name], rtol=1e-9, atol=1e-12)
    # other offsets make a difference
    name = list(found.data_vars)[-1]
    assert (found[name].isel(time=0) != found[name].isel(time=2)).any()


def test_waves_of_a_sheared_box_have_its_periods():
    ds = sheared(OFFSETS)
    f = ds.cg.structure_factor(vectors=[(1, 2, 0), (0, 1, 3)])
    position = ds.position.to_numpy()
    for t, offset in enumerate(OFFSETS):
        cell = EDGE * np.eye(3)
        cell[1, 0] = offset
        vectors = 2 * np.pi * np.array([(1, 2, 0), (0, 1, 3)]) @ np.linalg.inv(cell).T
        sums = np.exp(-1j * position[t] @ vectors.T).sum(axis=0)
        np.testing.assert_allclose(f.structure_factor[t], np.abs(sums) ** 2 / 80, atol=1e-12)
