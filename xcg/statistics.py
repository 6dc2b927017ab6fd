"""Statistics of scenes and results: sizes, profiles, averages over time with their standard errors."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.scene import SIZES, require_scene, sizes_of
from xcg.schema import units_of

_SIZE_NAMES = {
    "d43": "volume-weighted mean diameter",
    "d32": "surface-weighted mean diameter",
    "d50": "median diameter by mass",
    "drms": "root mean square diameter",
    "dmin": "smallest diameter",
    "dmax": "largest diameter",
}


def size_statistics(ds: xr.Dataset) -> xr.Dataset:
    """Sizes of the grains in each step, lazy where the scene is.

    ``d43 = S d^4 / S d^3``, ``d32 = S d^3 / S d^2``, ``drms = sqrt(S d^2 / n)``, ``d50`` the diameter below which half
    of the mass lies, ``dmin``, ``dmax``.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with ``diameter``, and ``mass`` (else d50 is by volume).

    Returns
    -------
    xarray.Dataset
        Variables (time,) in m; NaN for steps without grains.

    Raises
    ------
    SceneError
        If the scene holds no diameters.
    """
    require_scene(ds, ("diameter",), "size_statistics")
    weight = ds["mass"] if "mass" in ds else ds["diameter"] ** 3
    inputs = [a.chunk(particle=-1) if a.chunks is not None else a for a in (ds["diameter"], weight)]
    table = xr.apply_ufunc(
        _sizes_of_rows, *inputs, input_core_dims=[["particle"]] * 2, output_core_dims=[["size"]],
        dask="parallelized", output_dtypes=[float], dask_gufunc_kwargs={"output_sizes": {"size": len(SIZES)}},
    )  # fmt: skip
    units = units_of((1, 0, 0), ds.attrs.get("unit_system", "SI"))
    out = {
        name: table.isel(size=k).assign_attrs(units=units, long_name=_SIZE_NAMES[name]) for k, name in enumerate(SIZES)
    }
    return xr.Dataset(out)


def _sizes_of_rows(diameter: NDArray, weight: NDArray) -> NDArray:
    out = np.empty((*diameter.shape[:-1], len(SIZES)))
    for at in np.ndindex(diameter.shape[:-1]):
        here = np.isfinite(diameter[at])
        found = sizes_of(diameter[at][here], weight[at][here])
        out[at] = [found[name] for name in SIZES]
    return out
