"""A scene in other axes: places, vectors, tensors and the box, turned about an origin."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import product
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.scene.schema import COMPONENTS, VECTORS, known_without_reading, mark_measured

_PLACES = ("position", "contact_point")
_LATTICE = ("lattice", "lattice_velocity")
_SAME = 1e-12  # rounding of directions


def turn_scene(ds: xr.Dataset, axes: NDArray, origin: NDArray) -> xr.Dataset:
    """Return a scene in other axes, lazily where it is lazy: its variables, its box and its gravity.

    A box keeps its edges along axes that are among the new ones. Other periodic axes become vectors of a
    lattice.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene.
    axes : array (3, 3)
        The new axes x, y, z in the scene's own: a rotation.
    origin : array (3,)
        Where they meet (m).

    Raises
    ------
    SceneError
        If the axes lead out of the plane of a scene of one layer, or some components of a variable are not there.
    """
    across = [k for k, a in enumerate(COMPONENTS) if a not in ds.attrs.get("plane", "xyz")]
    plane = "".join(
        a for a, row in zip(COMPONENTS, axes, strict=True) if not any(abs(row[k]) > 1.0 - _SAME for k in across)
    )
    if across and len(plane) != len(COMPONENTS) - len(across):
        raise SceneError(
            f"the scene is a layer in the plane {ds.attrs['plane']!r}, and the axes {axes.tolist()} lead out of it: "
            "turn it about the axis across its plane"
        )
    found = {}
    for name in map(str, ds.data_vars):
        dims = [dim for dim in ("component", "direction") if dim in ds[name].dims]
        if dims and name != "box":
            shift = origin if name in _PLACES else np.zeros(3)
            turned = partial(_vectors, axes=axes, origin=shift) if len(dims) == 1 else partial(_tensors, axes=axes)
            found[name] = _mapped(turned, ds[name], dims)
    out = _with_box(ds.assign(found), axes, origin)
    attrs = {k: v for k, v in out.attrs.items() if k not in ("particle_lower", "particle_upper")}
    if across:
        attrs["plane"] = plane
    if "gravity" in attrs:
        attrs["gravity"] = axes @ np.asarray(attrs["gravity"], float)
    out = out.drop_attrs(deep=False).assign_attrs(attrs)
    in_memory = isinstance(ds["position"].variable._data, np.ndarray)
    if not in_memory and known_without_reading(ds, "position") and {"particle_lower", "particle_upper"} <= {*ds.attrs}:
        corners = np.array(list(product(*zip(ds.attrs["particle_lower"], ds.attrs["particle_upper"], strict=True))))
        corners = (corners - origin) @ axes.T
        out = out.assign_attrs(particle_lower=corners.min(axis=0), particle_upper=corners.max(axis=0))
        mark_measured(out, ["position"])
    return out


def _mapped(function: Any, values: xr.DataArray, dims: Sequence[str]) -> xr.DataArray:
    return xr.apply_ufunc(
        function, values, input_core_dims=[list(dims)], output_core_dims=[list(dims)], dask="parallelized",
        keep_attrs=True, output_dtypes=[float], dask_gufunc_kwargs={"allow_rechunk": True},
    ).transpose(*values.dims)  # fmt: skip


def _vectors(values: NDArray, axes: NDArray, origin: NDArray) -> NDArray:
    """Vectors (..., 3) in other axes, component by component, so that the bits do not depend on how many there are."""
    x, y, z = (values[..., k] - origin[k] for k in range(3))
    return np.stack([row[0] * x + row[1] * y + row[2] * z for row in axes.tolist()], axis=-1)


def _tensors(values: NDArray, axes: NDArray) -> NDArray:
    """Tensors (..., 3, 3) in other axes."""
    none = np.zeros(3)
    return _vectors(_vectors(values, axes, none).swapaxes(-1, -2), axes, none).swapaxes(-1, -2)


# --- the box ---------------------------------------------------------------------------------------------


def _with_box(ds: xr.Dataset, axes: NDArray, origin: NDArray) -> xr.Dataset:
    """Turn the edges of a box, and take lattice vectors for periodic axes that are along none of the new ones."""
    if "box" not in ds:
        return ds
    own: list[int | None] = [next((k for k in range(3) if abs(row[k]) > 1.0 - _SAME), None) for row in axes]
    others = [k for k in range(3) if k not in own]
    rows = [others.pop(0) if k is None else k for k in own]  # which of its axes stands in the place of each new one
    periodic = str(ds.attrs.get("periodic", ""))
    loose = [k for k in range(3) if k not in own and COMPONENTS[k] in periodic]
    edges = partial(_edges, own=own, axes=axes, origin=origin)
    attrs = dict(ds.attrs)
    if {"box_lower", "box_upper"} <= set(attrs):
        box = edges(np.stack([attrs["box_lower"], attrs["box_upper"]], axis=-1))
        attrs |= {"box_lower": box[:, 0], "box_upper": box[:, 1]}
    attrs["periodic"] = "".join(a for a, k in zip(COMPONENTS, rows, strict=True) if COMPONENTS[k] in periodic)
    found = {"box": _mapped(edges, ds["box"], ["component", "bound"])}
    if "lattice" in ds:
        found |= {n: ds[n].isel(vector=rows).assign_coords(vector=list(VECTORS)) for n in _LATTICE if n in ds}
    elif loose:
        repeats = np.array([a in periodic for a in COMPONENTS])
        found["lattice"] = xr.apply_ufunc(
            partial(_lattice, axes=axes, rows=rows, repeats=repeats), ds["box"],
            input_core_dims=[["component", "bound"]], output_core_dims=[["vector", "component"]],
            dask="parallelized", output_dtypes=[float],
            dask_gufunc_kwargs={"output_sizes": {"vector": 3}, "allow_rechunk": True},
        ).assign_coords(vector=list(VECTORS))  # fmt: skip
    return ds.assign(found).drop_attrs(deep=False).assign_attrs(attrs)


def _edges(box: NDArray, own: Sequence[int | None], axes: NDArray, origin: NDArray) -> NDArray:
    """Edges (..., 3, 2) along new axes that are parallel to old ones, else none."""
    out = np.empty(box.shape)
    out[...] = -np.inf, np.inf
    for j, k in enumerate(own):
        if k is not None:
            out[..., j, :] = np.sort(np.sign(axes[j, k]) * (box[..., k, :] - origin[k]), axis=-1) + 0.0
    return out


def _lattice(box: NDArray, axes: NDArray, rows: Sequence[int], repeats: NDArray) -> NDArray:
    """Vectors a, b, c (..., 3, 3) to the next images in new axes, zero without images."""
    lengths = np.where(repeats, box[..., 1] - box[..., 0], 0.0)
    return (lengths[..., None] * axes.T)[..., list(rows), :]
