"""Sizes and extent: of a set of particles, of frames, and of a scene as its attributes hold them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.scene.schema import MAX_GROUPS, Frame

SIZE_NAMES = {
    "d43": "volume-weighted mean diameter",
    "d32": "surface-weighted mean diameter",
    "d50": "median diameter by mass",
    "drms": "root mean square diameter",
    "dmin": "smallest diameter",
    "dmax": "largest diameter",
}
SIZES = tuple(SIZE_NAMES)


def sizes_of(diameter: NDArray, mass: NDArray | None = None) -> dict[str, float]:
    """Sizes of a set of particles (m); NaN for an empty one.

    ``d43 = S d^4 / S d^3``, ``d32 = S d^3 / S d^2``, ``drms = sqrt(S d^2 / n)``, ``d50`` the
    diameter below which half of the mass lies (of the volume, where no mass is given), ``dmin`` and
    ``dmax``.
    """
    if not len(diameter):
        return dict.fromkeys(SIZES, float("nan"))
    d = np.sort(diameter)
    squares, cubes, fourths = [(d**k).sum() for k in (2, 3, 4)]
    # powers of zero: NaN, which no width may be
    with np.errstate(invalid="ignore", divide="ignore"):
        d32 = float(cubes / squares)
        d43 = float(fourths / cubes)
    smallest = float(d[0])
    largest = float(d[-1])
    del d
    return {
        "d43": d43,
        "d32": d32,
        "d50": _median_by(diameter, diameter**3 if mass is None else mass),
        "drms": float(np.sqrt(squares / len(diameter))),
        "dmin": smallest,
        "dmax": largest,
    }


_BINS = 4096  # of values, to find those that their median by weight is among


def _median_by(values: NDArray, weights: NDArray) -> float:
    """Return the smallest of the values up to which half of the weight lies. Only those near it are sorted."""
    near = np.arange(len(values))
    below = 0.0
    total = weights.sum()
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        per_value = (_BINS - 1) / (values.max() - values.min())
    if len(values) > _BINS and np.isfinite(per_value) and weights.min() >= 0:
        scaled = values - values.min()
        scaled *= per_value
        bin_of = scaled.astype("int16")
        sums = np.cumsum(np.bincount(bin_of, weights, _BINS))
        total = sums[-1]
        middle = int(np.searchsorted(sums, 0.5 * total))
        near = np.flatnonzero(bin_of == middle)
        if middle:
            below = sums[middle - 1]
    near = near[np.argsort(values[near])]
    up_to = below + np.cumsum(weights[near])
    # the last one where rounding keeps the sum below its half
    return float(values[near[min(np.searchsorted(up_to, 0.5 * total), len(near) - 1)]])


OF_SIZE = ("diameter", "mass")  # which sizes follow from


def measured_variables(frame: Frame) -> Frame:
    """Return what `measure_frames` looks at; all other memory of the frame can go before.

    Of positions these are the lowest and highest ones (2, 3), of integer variables the values that
    they take.
    """
    measured: Frame = {name: frame[name] for name in OF_SIZE if name in frame}
    if "position" in frame and len(frame["position"]):
        # axis by axis: along the first axis of an array (n, 3) NumPy takes many times as long
        axes = frame["position"].T
        measured["position"] = np.array([[x.min() for x in axes], [x.max() for x in axes]])
    for name, values in frame.items():
        is_number = values.dtype.kind == "i" and values.ndim == 1
        if is_number and name not in ("particle_id", *OF_SIZE):
            measured[name] = _different(values)
    return measured


def measure_frames(frames: Iterable[Frame]) -> dict[str, Any]:
    """Sizes and extent of particles, as attributes: what default widths and bounds follow from.

    The sizes of `sizes_of`, the lowest and highest coordinates of the centres, and the values that
    integer variables take (``species_values``), over all the frames given, one of which is held
    whole at a time. Frames may be such as `measured_variables` returns.
    """
    measured: dict[str, Any] = {}
    parts = [measured_variables(frame) for frame in frames]
    corners = [part["position"] for part in parts if "position" in part]
    if corners:
        measured["particle_lower"] = np.min(corners, axis=(0, 1))
        measured["particle_upper"] = np.max(corners, axis=(0, 1))
    diameters = [part["diameter"] for part in parts if "diameter" in part]
    if diameters and sum(map(len, diameters)):
        masses = [part["mass"] for part in parts if "mass" in part]
        mass = None
        if len(masses) == len(diameters):
            mass = _joined(masses)
        measured |= sizes_of(_joined(diameters), mass)
    for name in dict.fromkeys(name for part in parts for name in part):
        if name not in ("position", *OF_SIZE):
            unique = np.unique(np.concatenate([part[name] for part in parts if name in part]))
            if 0 < len(unique) <= MAX_GROUPS:
                measured[f"{name}_values"] = unique
    return measured


def _joined(arrays: Sequence[NDArray]) -> NDArray:
    """Return arrays one after the other; a single one is not copied."""
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)


def _different(values: NDArray) -> NDArray:
    """Return the different values of whole numbers, sorted; by counting where they are few."""
    if not len(values):
        return values
    lowest = int(values.min())
    highest = int(values.max())
    if highest - lowest < len(values):
        return np.flatnonzero(np.bincount(values - lowest)) + lowest
    return np.unique(values)


MEASURES = ("particle_lower", "particle_upper", *SIZES)  # attributes of a scene


def without_measures(ds: xr.Dataset) -> xr.Dataset:
    """Return a scene without attributes of sizes and extent."""
    kept = {name: value for name, value in ds.attrs.items() if name not in MEASURES}
    return ds.drop_attrs(deep=False).assign_attrs(kept)
