"""Analyses in boxes of Lees and Edwards: an offset of a whole period is no offset."""

import numpy as np
import pytest

from tests.analyses import CALLS, EDGE, moving_spheres

OFFSETS = np.array([0.0, 0.4, 2.3])


# where whole periods make a difference, or no box is tilted
OTHERS = {
    "displacement": "between steps, whose offsets differ by other periods",
    "mean_squared_displacement": "between steps",
    "velocity_autocorrelation": "between steps, of velocities alone",
    "derive": "between steps",
    "structure_factor of waves": "whole numbers name other waves",
    "cell_volumes": "cells lie along the axes",
}
# averages over x and y, and labels, for which images along y make no difference
WITHOUT_IMAGES = {"slice_temperature", "flow_rate", "assign_phases", "fit_law"}


@pytest.mark.filterwarnings("ignore:.*granular_temperature is NaN")
@pytest.mark.parametrize("name", [name for name in CALLS if name not in OTHERS])
def test_an_offset_of_whole_periods_changes_nothing(name):
    call = CALLS[name]
    f = call(moving_spheres(name, offsets=OFFSETS)).drop_vars("lattice", errors="ignore")
    later = call(moving_spheres(name, offsets=OFFSETS + np.array([EDGE, 2 * EDGE, EDGE])))
    for result in f.data_vars:
        np.testing.assert_allclose(later[result], f[result], rtol=1e-9, atol=1e-12)
    if name not in WITHOUT_IMAGES:
        values = f.reset_coords(drop=True)
        assert not values.isel(time=0).equals(values.isel(time=2))


def test_waves_of_a_sheared_box_have_its_periods():
    ds = moving_spheres("waves", offsets=OFFSETS)
    f = ds.cg.structure_factor(vectors=[(1, 2, 0), (0, 1, 3)])
    position = ds.position.to_numpy()
    for t, offset in enumerate(OFFSETS):
        cell = EDGE * np.eye(3)
        cell[1, 0] = offset
        vectors = 2 * np.pi * np.array([(1, 2, 0), (0, 1, 3)]) @ np.linalg.inv(cell).T
        sums = np.exp(-1j * position[t] @ vectors.T).sum(axis=0)
        np.testing.assert_allclose(f.structure_factor[t], np.abs(sums) ** 2 / 40, atol=1e-12)
