"""Sizes and extent of the particles of all steps, measured on request."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.scene.conform import takes_scene
from xcg.scene.description import require_scene
from xcg.scene.frame import frame_of
from xcg.scene.schema import units_in
from xcg.scene.sizes import MEASURED_ATTRIBUTES, SIZES, mark_measured, measure_frames, sizes_of, without_attrs


def measure(ds: xr.Dataset) -> xr.Dataset:
    """Measure sizes and extent of all steps of a scene and store them as attributes (computes).

    Returns
    -------
    xarray.Dataset
        The same scene with the attributes of `sizes_of`, particle_lower and particle_upper set anew.
    """
    require_scene(ds, (), "measure")
    return _measure(without_attrs(ds, {attr for attrs in MEASURED_ATTRIBUTES.values() for attr in attrs}))


@takes_scene
def _measure(ds: xr.Dataset) -> xr.Dataset:
    names = [str(name) for name in ds.data_vars if "particle" in ds[name].dims]
    frames = []
    for t in range(ds.sizes["time"]):
        arrays = {name: ds[name].isel(time=[t]).transpose("time", ...).to_numpy() for name in names}
        frames.append(frame_of(arrays, 0, f"step {t}"))
    return mark_measured(ds.assign_attrs(measure_frames(frames)))


_SIZE_NAMES = {
    "d43": "volume-weighted mean diameter",
    "d32": "surface-weighted mean diameter",
    "d50": "median diameter by mass",
    "drms": "root mean square diameter",
    "dmin": "smallest diameter",
    "dmax": "largest diameter",
}


@takes_scene
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
    if not ds.sizes["particle"]:  # which dask takes no function over
        inputs = [a.compute() for a in inputs]
    table = xr.apply_ufunc(
        _sizes_of_rows, *inputs, input_core_dims=[["particle"]] * 2, output_core_dims=[["size"]],
        dask="parallelized", output_dtypes=[float], dask_gufunc_kwargs={"output_sizes": {"size": len(SIZES)}},
    )  # fmt: skip
    units = units_in("m", ds.attrs.get("unit_system", "SI"))
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
