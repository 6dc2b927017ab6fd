"""Principal values and directions of symmetric tensor fields."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common import drawing
from xcg.common.checks import check, extra, whole
from xcg.common.messages import plain, unknown
from xcg.compiled.matrices import principal as of_matrices
from xcg.fields.formulas.registry import OTHER_NAMES
from xcg.scene.frame import step_at
from xcg.scene.schema import COMPONENTS
from xcg.steps.mapping import apply_along

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_TENSOR = ("component", "direction")


def principal(f: xr.Dataset, field: str = "stress") -> xr.Dataset:
    """Principal values and directions of a tensor field, of its symmetric part; lazy where it is.

    Parameters
    ----------
    f : xarray.Dataset
        A result of `coarse_grain` with the field, and all components of it.
    field : str
        Name of a tensor: "stress", "contact_stress", "fabric", "shear_rate_tensor" ...

    Returns
    -------
    xarray.Dataset
        ``<field>_principal`` (..., principal), in the unit of the field, largest first: of a stress
        the most compressive, as compression is positive. ``<field>_axes`` (..., principal,
        component), unit vectors along them, of either sign. NaN where the field is.

    Raises
    ------
    ValueError
        If the result has no such tensor, or not all of its components.

    Notes
    -----
    ``(t + t^T) / 2 n_k = t_k n_k``. In a scene of one layer the third direction is that across it.

    Examples
    --------
    >>> import xcg
    >>> f = xcg.datasets.simple_cubic(4, force=1.0).cg.coarse_grain("contact_stress", axes="z")
    >>> f.cg.principal("contact_stress").contact_stress_principal.dims
    ('time', 'z', 'principal')
    """
    tensor = _tensor_of(f, field)
    values, axes = apply_along(
        _values_and_axes,
        tensor,
        along=[_TENSOR],
        to=[["principal"], ["principal", "component"]],
        sizes={"principal": 3, "component": 3},
        exclude_dims={"component"},
    )
    text = tensor.attrs.get("long_name", field)
    values.attrs["units"] = tensor.attrs.get("units", "1")
    values.attrs["long_name"] = f"principal values of the {text}, largest first"
    axes.attrs["units"] = "1"
    axes.attrs["long_name"] = f"principal directions of the {text}"
    return xr.Dataset(
        {f"{field}_principal": values, f"{field}_axes": axes},
        {"principal": [1, 2, 3], "component": f["component"]},
        f.attrs,
    )


def _tensor_of(f: xr.Dataset, field: str) -> xr.DataArray:
    """Return a tensor of a result; raise ValueError unless it is there with all its components."""
    tensors = [str(name) for name in f.data_vars if set(_TENSOR) <= set(f[name].dims)]
    if field not in tensors and not tensors:
        raise ValueError(
            f"principal({field!r}): this Dataset holds no tensor field; call it on a result that does, "
            f"ds.cg.coarse_grain({field!r}).cg.principal({field!r})"
        )
    if field not in tensors:
        raise ValueError(unknown("tensor of this result", field, tensors, synonyms=OTHER_NAMES))
    for dim in _TENSOR:
        if f.sizes[dim] != 3:
            raise ValueError(
                f"principal({field!r}): expected all three components, and {dim!r} has "
                f"{f.sizes[dim]}; select components after it"
            )
    return f[field]


def _values_and_axes(tensor: NDArray) -> tuple[NDArray, NDArray]:
    """Return eigenvalues (..., 3), largest first, and eigenvectors (..., 3, 3) of the symmetric part."""
    matrices = np.ascontiguousarray(tensor, "float64").reshape(-1, 3, 3)
    unknown_at = ~np.isfinite(matrices).all(axis=(1, 2))
    matrices = np.where(unknown_at[:, None, None], 0.0, matrices)
    values = np.empty((len(matrices), 3))
    axes = np.empty(matrices.shape)
    of_matrices(matrices, values, axes)
    values[unknown_at] = np.nan
    axes[unknown_at] = np.nan
    return values.reshape(tensor.shape[:-1]), axes.reshape(tensor.shape)


def _in_plane(tensor: NDArray) -> tuple[NDArray, NDArray]:
    """Return eigenvalues (..., 2), largest first, and eigenvectors (..., 2, 2) of tensors in a plane: Mohr's circle."""
    first, second = tensor[..., 0, 0], tensor[..., 1, 1]
    shear = (tensor[..., 0, 1] + tensor[..., 1, 0]) / 2
    radius = np.hypot((first - second) / 2, shear)
    values = ((first + second) / 2)[..., None] + radius[..., None] * [1.0, -1.0]
    angle = np.arctan2(2 * shear, first - second) / 2
    along = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    across = np.stack([-np.sin(angle), np.cos(angle)], axis=-1)
    return values, np.stack([along, across], axis=-2)


def plot_principal(
    f: xr.Dataset,
    field: str = "stress",
    *,
    index: int = -1,
    every: int = 1,
    ax: Axes | None = None,
    color: str = "black",
) -> Axes:
    """Draw the principal directions of a tensor in the plane of a map, as crosses.

    Bars are as long as the values in the plane, relative to the largest; positive values
    (compression) are drawn in full, negative ones dotted.

    Parameters
    ----------
    f : xarray.Dataset
        A result on two axes, such as ``coarse_grain("stress", axes="xz")``.
    field : str
        Name of a tensor.
    index : int
        Position of the step in time; the last one by default.
    every : int
        Nodes from one cross to the next along both axes.
    ax : matplotlib.axes.Axes, optional
        Where to draw, such as what `plot` of another field returned; a new figure by default.
    color : str
        Colour of the bars.

    Returns
    -------
    matplotlib.axes.Axes
        With the crosses.

    Raises
    ------
    ValueError
        If the result has no such tensor, or not two axes, or an argument is wrong.
    """
    collections = extra("matplotlib.collections", "plot", "plot_principal")
    colors = extra("matplotlib.colors", "plot", "plot_principal")
    check("every", every, whole(1), hint=", 1 for all nodes")
    if not colors.is_color_like(color):
        raise ValueError(f"color={plain(color)}: expected a colour of matplotlib, such as 'black'")
    f = step_at(f, index)
    plane = [a for a in COMPONENTS if a in f.dims]
    if len(plane) != 2:
        raise ValueError(f"plot_principal: expected two axes, and the result has {plane}")
    if "phase" in f.dims:
        f = f.sel(phase="bulk")
    of_plane = dict.fromkeys(_TENSOR, plane)
    tensor = (
        _tensor_of(f, field).sel(of_plane).isel({a: slice(None, None, int(every)) for a in plane})
    )
    tensor = tensor.transpose(*plane, *_TENSOR).compute()
    values, axes = _in_plane(tensor.to_numpy())
    x, y = np.meshgrid(tensor[plane[0]], tensor[plane[1]], indexing="ij")
    largest = np.nanmax(np.abs(values))
    spacing = min(float(np.ptp(tensor[a].to_numpy())) / max(1, tensor.sizes[a] - 1) for a in plane)
    if ax is None:
        ax = drawing.new_axes()
        ax.set_aspect("equal")
        drawing.set_label(ax.xaxis, drawing.label_of(f[plane[0]], plane[0]))
        drawing.set_label(ax.yaxis, drawing.label_of(f[plane[1]], plane[1]))
    for k in range(2):
        half = 0.5 * spacing * (np.abs(values[..., k]) / largest)[..., None] * axes[..., k, :]
        middle = np.stack([x, y], axis=-1)
        bars = np.stack([middle - half, middle + half], axis=-2).reshape(-1, 2, 2)
        for chosen, style in (values[..., k] > 0, "solid"), (values[..., k] < 0, "dotted"):
            ax.add_collection(
                collections.LineCollection(
                    list(bars[chosen.ravel()]), colors=color, linestyles=style
                )
            )
    ax.autoscale_view()
    return ax
