"""Jobs of docs/side_by_side.py: the files written for other programs hold the packing that their page names."""

import numpy as np
import pytest

from docs import side_by_side


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("side")
    side_by_side.write(folder, 600)
    return folder


@pytest.mark.parametrize("name", ["mercury", "lammps"])
def test_profiles_from_files_are_those_of_the_packing(folder, name):
    prepare = getattr(side_by_side, name)
    job, _ = prepare(folder / name)
    names = ["density", "contact_stress"] if name == "mercury" else ["velocity"]
    kernel = {"kernel": side_by_side.GAUSSIAN} if name == "mercury" else {"width": 0.75}
    here = side_by_side.profile(side_by_side.packing_of(folder), names, folder, **kernel)
    f = job()
    for field in names:
        np.testing.assert_allclose(
            f[field], here[field], rtol=1e-4, atol=1e-4 * abs(here[field]).max()
        )


def test_points_and_the_mesh_of_pysammos_are_in_the_box(folder):
    job, _ = side_by_side.pycoarsegraining(folder / "pycoarsegraining")
    assert job().density.min() > 0
    job, _ = side_by_side.pysammos(folder / "pysammos")
    f = job()
    whole = float(f.density_mixture.integrate(["x", "y", "z"]).isel(time=0))
    mass = side_by_side.packing_of(folder).mass.sum().item()
    assert whole == pytest.approx(mass, rel=0.25)  # less what is smeared out of the box
