"""Principal values and directions of tensor fields."""

import matplotlib as mpl
import numpy as np
import pytest
import xarray as xr

import xcg
from tests import raise_if_dask_computes

mpl.use("agg")


def _field(tensors, dims=("z",)):
    """Return a result that holds some tensors (..., 3, 3) along axes."""
    coords = {a: np.arange(n, dtype=float) for a, n in zip(dims, np.shape(tensors), strict=False)}
    axes = list("xyz")
    stress = xr.DataArray(
        tensors, coords | {"component": axes, "direction": axes}, (*dims, "component", "direction")
    )
    return stress.assign_attrs(units="Pa", long_name="stress").to_dataset(name="stress")


def _turned(values, seed):
    """Return tensors with known principal values (n, 3), in random axes (n, 3, 3)."""
    axes = np.linalg.qr(np.random.default_rng(seed).normal(size=(len(values), 3, 3)))[0]
    return np.einsum("nk,nik,njk->nij", values, axes, axes), axes.swapaxes(1, 2)


def test_values_and_axes_are_those_that_the_tensor_was_made_of():
    values = np.sort(np.random.default_rng(0).normal(size=(40, 3)), axis=1)[:, ::-1]
    tensors, axes = _turned(values, 1)
    skew = np.random.default_rng(2).normal(size=(40, 3, 3))
    p = _field(tensors + skew - skew.swapaxes(1, 2)).cg.principal("stress")
    np.testing.assert_allclose(p.stress_principal, values, atol=1e-13)
    along = np.einsum("nki,nki->nk", p.stress_axes, axes)
    np.testing.assert_allclose(np.abs(along), 1.0, atol=1e-9)
    assert p.stress_principal.attrs["units"] == "Pa"


def test_unknown_tensors_stay_unknown():
    tensors = np.ones((2, 3, 3))
    tensors[1, 0, 2] = np.nan
    p = _field(tensors).cg.principal("stress")
    assert np.isfinite(p.stress_principal[0]).all()
    assert np.isnan(p.stress_principal[1]).all()
    assert np.isnan(p.stress_axes[1]).all()


def test_lazy_fields_give_lazy_values():
    f = xcg.datasets.random_scene(200).cg.coarse_grain("contact_stress", axes="xz")
    with raise_if_dask_computes():
        lazy = f.chunk(x=2).cg.principal("contact_stress")
    xr.testing.assert_allclose(lazy.compute(), f.cg.principal("contact_stress"), rtol=1e-13)


def test_sum_of_values_is_the_trace():
    f = xcg.datasets.random_scene(200).cg.coarse_grain("contact_stress", axes="z")
    p = f.cg.principal("contact_stress")
    trace = sum(f.contact_stress.sel(component=a, direction=a, drop=True) for a in "xyz")
    xr.testing.assert_allclose(p.contact_stress_principal.sum("principal"), trace, rtol=1e-12)


def test_wrong_fields_are_named():
    f = xcg.datasets.random_scene(100).cg.coarse_grain(["velocity", "contact_stress"], axes="xz")
    with pytest.raises(ValueError, match=r"contact_stres.*did you mean 'contact_stress'"):
        f.cg.principal("contact_stres")
    with pytest.raises(ValueError, match="all three components, and 'component' has 2"):
        f.sel(component=["x", "z"]).cg.principal("contact_stress")
    with pytest.raises(ValueError, match=r"expected two axes, and the result has \['z'\]"):
        f.isel(x=0).cg.plot_principal("contact_stress")


def test_crosses_lie_along_the_principal_directions_of_the_plane():
    angle = np.deg2rad(30.0)
    turn = np.array(
        [[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]]
    )
    tensor = turn @ np.diag([2.0, 5.0, -1.0]) @ turn.T
    f = _field(np.broadcast_to(tensor, (3, 4, 3, 3)), ("x", "z")).expand_dims(time=[0.0])
    ax = f.cg.plot_principal("stress")
    major, dotted = (c for c in ax.collections if len(c.get_segments()))
    assert len(major.get_segments()) == len(dotted.get_segments()) == 12
    (x0, z0), (x1, z1) = major.get_segments()[0]
    assert np.isclose(np.hypot(x1 - x0, z1 - z0), 1.0)
    assert np.isclose(np.tan(angle), (z1 - z0) / (x1 - x0))
    (x0, z0), (x1, z1) = dotted.get_segments()[0]
    assert np.isclose(np.hypot(x1 - x0, z1 - z0), 0.5)


@pytest.mark.parametrize("kind", ["any", "of a layer", "two equal", "isotropic", "zero"])
def test_values_and_axes_rebuild_the_tensor_to_rounding(kind):
    """As those of LAPACK do; tensors of any size."""
    rng = np.random.default_rng(3)
    values = rng.normal(size=(200, 3)) * 10.0 ** rng.integers(-8, 8, (200, 1))
    values[:, 1:] *= {"of a layer": [1.0, 0.0], "zero": 0.0}.get(kind, 1.0)
    if kind == "two equal":
        values[:, 1] = values[:, 0]
    if kind in ("isotropic", "zero"):
        values = np.repeat(values[:, 2:], 3, axis=1)
    tensors, _ = _turned(values, 4)
    p = _field(tensors).cg.principal("stress")
    size = np.maximum(np.abs(values).max(axis=1), 1e-300)[:, None]
    by_lapack = np.linalg.eigvalsh(tensors)[:, ::-1]
    np.testing.assert_allclose(p.stress_principal / size, by_lapack / size, rtol=0, atol=1e-14)
    axes = p.stress_axes.values
    rebuilt = np.einsum("nk,nki,nkj->nij", p.stress_principal.values, axes, axes)
    np.testing.assert_allclose(
        rebuilt / size[..., None], tensors / size[..., None], rtol=0, atol=2e-14
    )
