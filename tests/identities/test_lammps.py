"""Against LAMMPS' own coarse-graining (compute continuum/chunk), an independent code, printed with 17 digits."""

import numpy as np
import pytest

import xcg
from tests import shared_data

SHAPE = (20, 10, 35)  # bins of 1, at whose centres the nodes are
WIDTH, CUTOFF = 0.5, 1.5
# Columns of the table: natoms, density, volume fraction, momentum, velocity, and stress by rows of components.
COLUMNS = {
    "density": slice(1, 2),
    "volume_fraction": slice(2, 3),
    "momentum_density": slice(3, 6),
    "contact_stress": slice(9, 18),
}


@pytest.fixture(scope="module")
def fields():
    folder = shared_data("lammps_continuum")
    ds = xcg.open_scene(folder / "particles.*.gz", contacts=folder / "contacts.*.gz", frozen=2).load()
    kernel = xcg.Gaussian(WIDTH, cutoff=CUTOFF, shifted=True)
    bounds = {"x": (0.5, 19.5), "y": (0.5, 9.5), "z": (-4.5, 29.5)}
    f = xcg.coarse_grain(ds, list(COLUMNS), kernel=kernel, bounds=bounds, spacing=1.0).isel(time=0)
    return f, np.loadtxt(folder / "fields_3d.txt.gz", skiprows=4)[:, 1:]


@pytest.mark.parametrize("name", COLUMNS)
def test_fields_are_those_of_lammps(fields, name):
    f, table = fields
    expected = table[:, COLUMNS[name]].reshape(*SHAPE, -1) * (-1 if "stress" in name else 1)  # tension is positive
    found = f[name].transpose("x", "y", "z", ...).values.reshape(*SHAPE, -1)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14 * np.abs(expected).max())
