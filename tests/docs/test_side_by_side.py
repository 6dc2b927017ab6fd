"""Jobs of docs/side_by_side.py: the files written for other programs hold the packing that their page names."""

import numpy as np
import pytest

from docs import side_by_side


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("side")
    side_by_side.write(folder, 600)
    return folder


def test_the_profile_from_files_is_that_of_the_packing(folder):
    names = ["density", "contact_stress"]
    job, _ = side_by_side.mercury(folder / "mercury")
    ds = side_by_side.packing_of(folder)
    here = side_by_side.profile(ds, names, folder, kernel=side_by_side.GAUSSIAN)
    f = job()
    for name in names:
        atol = 1e-4 * abs(here[name]).max()
        np.testing.assert_allclose(f[name], here[name], rtol=1e-4, atol=atol)


def test_the_mean_of_the_profile_of_a_periodic_dump_is_that_of_the_grains(folder):
    job, _ = side_by_side.lammps(folder / "lammps")
    f = job()
    ds = side_by_side.packing_of(folder)
    mean = ds.velocity.weighted(ds.mass).mean("particle")
    np.testing.assert_allclose(f.velocity.weighted(f.density).mean("z"), mean, atol=1e-5)


def test_points_and_the_mesh_of_pysammos_are_in_the_box(folder):
    job, _ = side_by_side.pycoarsegraining(folder / "pycoarsegraining")
    assert job().density.min() > 0
    job, _ = side_by_side.pysammos(folder / "pysammos")
    f = job()
    whole = float(f.density_mixture.integrate(["x", "y", "z"]).isel(time=0))
    mass = side_by_side.packing_of(folder).mass.sum().item()
    assert whole == pytest.approx(mass, rel=0.25)  # less what is smeared out of the box
