"""Sizes and extent of the particles: of a set, of a scene, of each step."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.scene.conform import require_scene, takes_scene
from xcg.scene.frame import frame_of
from xcg.scene.schema import MAX_GROUPS, PADDING, Frame, known_without_reading, mark_measured, units_in

_SIZE_NAMES = {
    "d43": "volume-weighted mean diameter",
    "d32": "surface-weighted mean diameter",
    "d50": "median diameter by mass",
    "drms": "root mean square diameter",
    "dmin": "smallest diameter",
    "dmax": "largest diameter",
}
SIZES = tuple(_SIZE_NAMES)


def sizes_of(diameter: NDArray, mass: NDArray | None = None) -> dict[str, float]:
    """Sizes of a set of particles (m); NaN for an empty one.

    ``d43 = S d^4 / S d^3``, ``d32 = S d^3 / S d^2``, ``drms = sqrt(S d^2 / n)``, ``d50`` the diameter below which half
    of the mass lies (of the volume, where no mass is given), ``dmin`` and ``dmax``.
    """
    if not len(diameter):
        return dict.fromkeys(SIZES, float("nan"))
    order = np.argsort(diameter, kind="stable")
    d = diameter[order]
    share = d**3 if mass is None else mass[order]
    del order
    np.cumsum(share, out=share)
    sums = [(d**k).sum() for k in range(5)]
    with np.errstate(invalid="ignore", divide="ignore"):  # powers of zero: NaN, which no width may be
        ratios = [float(sums[k] / sums[k - 1]) for k in (3, 4)]
    return {
        "d43": ratios[1],
        "d32": ratios[0],
        "d50": float(d[np.searchsorted(share, 0.5 * share[-1])]),
        "drms": float(np.sqrt(sums[2] / sums[0])),
        "dmin": float(d[0]),
        "dmax": float(d[-1]),
    }


def measure_frames(frames: Sequence[Frame]) -> dict[str, Any]:
    """Sizes and extent of particles, as attributes: what default widths and bounds follow from.

    The sizes of `sizes_of`, the lowest and highest coordinates of the centres, and the values that integer variables
    take (``species_values``), over all the frames given.
    """
    measured: dict[str, Any] = {}
    positions = [f["position"] for f in frames if "position" in f and len(f["position"])]
    if positions:
        # axis by axis: along the first axis of an array (n, 3) NumPy takes many times as long
        measured["particle_lower"] = np.min([[x.min() for x in p.T] for p in positions], axis=0)
        measured["particle_upper"] = np.max([[x.max() for x in p.T] for p in positions], axis=0)
    diameters = [f["diameter"] for f in frames if "diameter" in f]
    if diameters and sum(map(len, diameters)):
        masses = [f["mass"] for f in frames if "mass" in f]
        whole = len(masses) == len(diameters)
        measured |= sizes_of(np.concatenate(diameters), np.concatenate(masses) if whole else None)
    for name in frames[0] if frames else ():
        values = [f[name] for f in frames if f[name].dtype.kind == "i"]
        if values and name != "particle_id":
            unique = np.unique(np.concatenate(values))
            if 0 < len(unique) <= MAX_GROUPS:
                measured[f"{name}_values"] = unique
    return measured


_RANGES = {"position": ("particle_lower", "particle_upper"), "diameter": ("dmin", "dmax")}
MEASURED_ATTRIBUTES = {"position": _RANGES["position"], "diameter": SIZES}


def without_attrs(ds: xr.Dataset, names: Collection[str]) -> xr.Dataset:
    """Return the scene without some of its attributes."""
    return ds.drop_attrs(deep=False).assign_attrs({k: v for k, v in ds.attrs.items() if k not in names})


def with_measures(ds: xr.Dataset) -> xr.Dataset:
    """Return the scene with such sizes and extent as its attributes as hold for its particles. Nothing is read.

    Variables may have been replaced since they were measured. Those in memory are looked at: where grains of the first
    or the last step lie outside the extent, the extent of these steps is measured anew, and the sizes where diameters
    lie outside their range: places say nothing of sizes. Attributes of lazy variables that were computed from others
    are left out.
    """
    of = {name: attrs for name, attrs in MEASURED_ATTRIBUTES.items() if name in ds}
    lost = {attr for name in of if not known_without_reading(ds, name) for attr in of[name]} & set(ds.attrs)
    if lost:
        ds = without_attrs(ds, lost)
    order, given = ("time", "particle", ...), {n: ds.variables[n] for n in ("particle_id", *of, "mass") if n in ds}
    arrays = {
        name: v.transpose(*order).to_numpy()
        for name, v in given.items()
        if "time" in v.dims and isinstance(v._data, np.ndarray)
    }
    ends: list[Frame] = []
    if "particle_id" in arrays and ds.sizes["time"]:
        for t in sorted({0, ds.sizes["time"] - 1}):
            valid = arrays["particle_id"][t] != PADDING
            rows = slice(None) if valid.all() else valid
            ends.append({name: a[t][rows] for name, a in arrays.items()})
    outside = {attr for name in of if not all(_within(name, frame, ds.attrs) for frame in ends) for attr in of[name]}
    if outside:
        measured = measure_frames(ends)
        ds = ds.assign_attrs({attr: measured[attr] for attr in outside & set(measured)})
    return ds


def _within(name: str, frame: Frame, known: Mapping[Any, Any]) -> bool:
    """Return whether positions or diameters of a frame lie inside the range of them that is known."""
    values = frame.get(name)
    if values is None or not len(values):
        return True
    low, high = _RANGES[name]
    if low not in known:
        return False
    lower, upper = (np.ravel(known[end]) for end in (low, high))
    small = 1e-9 * np.abs([lower, upper]).max()
    inside = zip(np.atleast_2d(values.T), lower - small, upper + small, strict=True)
    return all(x.min() >= least and x.max() <= most for x, least, most in inside)


# --- measured on request ---------------------------------------------------------------------------------


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
