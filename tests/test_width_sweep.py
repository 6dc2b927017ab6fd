"""Fields against width, and plateaus that are known."""

import numpy as np
import pytest
import xarray as xr

import xcg

WIDTHS = np.geomspace(0.3, 2.0, 9)


def test_each_width_is_the_field_at_that_width():
    ds = xcg.datasets.random_scene(100, seed=1)
    at = {"x": [1.0, 2.0], "y": [2.0, 3.0], "z": [2.5, 2.4]}
    s = ds.cg.width_sweep(WIDTHS, ["density", "stress"], at=at)
    assert s.stress.dims[:2] == ("width", "point")
    for k, w in enumerate(WIDTHS):
        alone = ds.cg.coarse_grain("density", axes="", at={"x": 2.0, "y": 3.0, "z": 2.4}, width=w).density
        assert s.density.isel(width=k, point=1).item() == alone.item()


def test_the_plateau_of_a_lattice_is_its_volume_fraction():
    ds = xcg.datasets.face_centred_cubic(5)
    s = ds.cg.width_sweep(WIDTHS, "volume_fraction", at={"x": 0.1, "y": 0.2, "z": 0.4})
    assert s.volume_fraction_plateau.item() == pytest.approx(np.pi / (3 * np.sqrt(2)), rel=1e-2)
    assert s.volume_fraction_plateau_width.item() > 0.5


def test_no_plateau_is_said():
    """The density at a lone grain falls as w^-3 for ever."""
    ds = xcg.scene_from_arrays([[0.0, 0, 0]], diameter=[1.0], density=1.0)
    s = ds.cg.width_sweep(WIDTHS, "density", at={"x": 0, "y": 0, "z": 0})
    assert np.isnan(s.density_plateau_width.item())
    np.testing.assert_allclose(s.density_slope[1:-1], 3.0, rtol=0.1)


def test_profiles_keep_their_nodes():
    ds = xcg.datasets.random_scene(100, seed=1, periodic="xy").chunk()
    s = ds.cg.width_sweep(WIDTHS[::3], "density", axes="z")
    assert s.density.dims == ("width", "time", "z")
    assert s.density.notnull().all()
    lone = ds.cg.coarse_grain("density", axes="z", width=WIDTHS[3], bounds={"z": (s.z[0], s.z[-1])}, spacing=WIDTHS[0])
    xr.testing.assert_allclose(s.density.isel(width=1, drop=True), lone.density)


def test_bad_requests():
    ds = xcg.datasets.random_scene(20)
    with pytest.raises(ValueError, match="three or more"):
        ds.cg.width_sweep([0.5, 1.0], "density")
    with pytest.raises(ValueError, match="same length"):
        ds.cg.width_sweep(WIDTHS, "density", at={"x": [1.0, 2.0], "y": [1.0]})
