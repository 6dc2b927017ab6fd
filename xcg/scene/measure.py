"""Sizes and extent of the particles, measured on request: of all steps together, and of each step."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.scene.conform import takes_scene
from xcg.scene.frame import frame_of
from xcg.scene.scene import Scene
from xcg.scene.schema import Frame, mark_measured, units_in
from xcg.scene.sizes import OF_SIZE, SIZE_NAMES, SIZES, measure_frames, sizes_of, without_measures


def measure(ds: xr.Dataset) -> xr.Dataset:
    """Measure sizes and extent of all steps of a scene and store them as attributes (computes).

    Parameters
    ----------
    ds : xarray.Dataset
        A scene, lazy or in memory.

    Returns
    -------
    xarray.Dataset
        The same scene with the attributes ``d43``, ``d32``, ``d50``, ``drms``, ``dmin``, ``dmax``,
        ``particle_lower`` and ``particle_upper`` (m), and the values of its integer variables, such as
        ``species_values``.

    Raises
    ------
    SceneError
        If the Dataset is not a scene.
    """
    Scene(ds).require((), "measure")
    return _measure(without_measures(ds))


@takes_scene
def _measure(scene: Scene) -> xr.Dataset:
    ds = scene.ds
    names = [
        name
        for name, values in scene.columns.items()
        if "particle" in values.dims
        and (name in ("position", *OF_SIZE) or values.dtype.kind == "i")
    ]

    def frame(t: int) -> Frame:
        step = ds[names].isel(time=[t]).compute()
        arrays = {name: step[name].transpose("time", ...).to_numpy() for name in names}
        return frame_of(arrays, 0, f"step {t}")

    measured = measure_frames(frame(t) for t in range(ds.sizes["time"]))
    return mark_measured(ds.assign_attrs(measured))


@takes_scene
def size_statistics(scene: Scene) -> xr.Dataset:
    """Sizes of the grains in each step, lazy where the scene is.

    ``d43 = S d^4 / S d^3``, ``d32 = S d^3 / S d^2``, ``drms = sqrt(S d^2 / n)``, ``d50`` the
    diameter below which half of the mass lies, ``dmin``, ``dmax``.

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
    scene.require(("diameter",), "size_statistics")
    ds = scene.ds
    weight = ds["mass"] if "mass" in ds else ds["diameter"] ** 3
    inputs = [a.chunk(particle=-1) if a.chunks is not None else a for a in (ds["diameter"], weight)]
    if not ds.sizes["particle"]:  # which dask takes no function over
        inputs = [a.compute() for a in inputs]
    table = xr.apply_ufunc(
        _sizes_of_steps,
        *inputs,
        input_core_dims=[["particle"]] * 2,
        output_core_dims=[["size"]],
        dask="parallelized",
        output_dtypes=[float],
        dask_gufunc_kwargs={"output_sizes": {"size": len(SIZES)}},
    )
    units = units_in("m", scene.setup.unit_system)
    out = {
        name: table.isel(size=k).assign_attrs(units=units, long_name=SIZE_NAMES[name])
        for k, name in enumerate(SIZES)
    }
    return xr.Dataset(out)


def _sizes_of_steps(diameter: NDArray, weight: NDArray) -> NDArray:
    out = np.empty((*diameter.shape[:-1], len(SIZES)))
    for index in np.ndindex(diameter.shape[:-1]):
        is_grain = np.isfinite(diameter[index])
        sizes = sizes_of(diameter[index][is_grain], weight[index][is_grain])
        out[index] = [sizes[name] for name in SIZES]
    return out
