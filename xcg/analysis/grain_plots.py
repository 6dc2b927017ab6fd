"""Pictures of the grains of a scene: a layer, or a cut through a volume."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common import drawing
from xcg.common.checks import is_finite
from xcg.common.messages import plain, unknown
from xcg.scene.conform import conform
from xcg.scene.frame import frame_at, step_at
from xcg.scene.lattice import Lattice, minimum_image
from xcg.scene.scene import Scene
from xcg.scene.schema import COMPONENTS, Frame

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_PLAIN = "0.75"  # colour of grains without a variable
_RIM = 0.3  # points


def draw_grains(
    ds: xr.Dataset,
    name: str | None,
    index: int,
    component: str | None,
    at: Mapping[str, float] | None,
    ax: Axes | None,
    colours: Mapping[str, Any],
    options: Mapping[str, Any],
) -> tuple[xr.Dataset, Axes]:
    """Draw the grains of one step as circles: a whole layer, or a cut through a volume.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene.
    name : str or None
        Variable of the particles that colours show; None for grey grains.
    index, component, at, ax
        As in `xcg.plot`.
    colours : mapping
        ``cmap``, ``vmin`` and ``vmax`` of `xcg.plot`.
    options : mapping
        Keywords for the collection of matplotlib.

    Returns
    -------
    xarray.Dataset, matplotlib.axes.Axes
        Coordinates of the picture, for its title; and where it was drawn.

    Raises
    ------
    SceneError
        If the scene has no diameters.
    ValueError
        If it has no such variable or component, or `at` is wrong.
    """
    ds = conform(ds)
    Scene(ds).require(("diameter",), "plot of a scene")
    if name is not None:
        _check_variable(ds, name)
    names = {"particle_id", "position", "diameter", name or "position"}
    frame, lattice, _ = frame_at(ds, index, names)
    step = step_at(ds, index)
    plane = str(ds.attrs.get("plane", "xyz"))
    cut = _cut(plane, at, frame, lattice)
    axes = [axis for axis in plane if axis not in cut]
    offset, radius, drawn = circles_of(frame, axes, cut, lattice)
    if ax is None:
        ax = drawing.new_axes(ratio=drawing.ratio_of_circles(offset, radius))
    others = {key: value for key, value in options.items() if key != "norm"}
    rim = {"linewidth": _RIM, "edgecolor": "black"}
    circles = drawing.add_circles(ax, offset, radius, **(rim | others))
    if name is None:
        circles.set(**{"facecolor": _PLAIN, **options})
    else:
        variable = ds[name]
        values = _values(frame[name], variable, component)[drawn]
        if frame[name].ndim > 1:
            text = f"{drawing.long_name_of(variable, name)}, {component or 'magnitude'}"
            variable = variable.assign_attrs(long_name=text)
        label = drawing.label_of(variable, name)
        finite = values[np.isfinite(values)]
        chosen = drawing.colours_of(finite, **colours)
        circles.set_array(values)
        circles.set_cmap(chosen["cmap"])
        if "norm" in options:
            circles.set_norm(options["norm"])
        else:
            circles.set_clim(chosen["vmin"], chosen["vmax"])
        drawing.add_colour_bar(circles, ax, label, finite)
    for axis, of_axis in zip(axes, (ax.xaxis, ax.yaxis), strict=True):
        position = ds["position"].assign_attrs(long_name=axis)
        drawing.set_label(of_axis, drawing.label_of(position, axis))
    coords = {str(k): step[k] for k in ("time", "step") if k in step.coords}
    coords |= {
        axis: xr.DataArray(coordinate, attrs=ds["position"].attrs)
        for axis, coordinate in cut.items()
    }
    return xr.Dataset(coords=coords), ax


def _check_variable(ds: xr.Dataset, name: str) -> None:
    variables = ds.data_vars.items()
    names = [str(n) for n, v in variables if v.dims[:2] == ("time", "particle") and v.ndim <= 3]
    if name not in names:
        way = (
            "fields are drawn after ds.cg.coarse_grain(...), and particles are coloured by one of "
            + ", ".join(names)
        )
        raise ValueError(f"plot of a scene: {unknown('variable', name, names, way)}")


def _cut(
    plane: str, at: Mapping[str, float] | None, frame: Frame, lattice: Lattice
) -> dict[str, float]:
    """Return the axis and position of the plane that cuts a volume, by default in the middle of its shortest axis."""
    if at and len(plane) == 2:
        raise ValueError(
            f"at={plain(at)}: the scene is one layer along {', '.join(plane)}, which is drawn whole"
        )
    if len(plane) == 2:
        return {}
    if at:
        if len(at) != 1 or not {*at} <= {*plane} or not all(map(is_finite, at.values())):
            raise ValueError(
                f"at={plain(at)}: expected one axis and a coordinate, such as {{'y': 0.0}}"
            )
        return {axis: float(coordinate) for axis, coordinate in at.items()}
    position = frame["position"]
    if not len(position):
        return {plane[1]: 0.0}
    low = position.min(axis=0)
    high = position.max(axis=0)
    k = int(np.argmin(high - low))
    return {COMPONENTS[k]: float(0.5 * (low[k] + high[k]))}


def circles_of(
    frame: Frame, axes: Sequence[str], cut: Mapping[str, float], lattice: Lattice
) -> tuple[NDArray, NDArray, NDArray]:
    """Return centres (n, 2) and radii (n,) of circles on two axes, and the rows of their particles.

    They are cut at coordinates on other axes (m), also by planes through images; whole without a cut.
    """
    position = frame["position"]
    radius = frame["diameter"] / 2
    offset = position[:, [COMPONENTS.index(axis) for axis in axes]]
    indices = np.arange(len(position))
    for axis, coordinate in cut.items():
        k = COMPONENTS.index(axis)
        away = minimum_image(position - coordinate, lattice.axis_periods)[:, k]
        indices = np.flatnonzero(np.abs(away) < radius)
        radius = np.sqrt(radius[indices] ** 2 - away[indices] ** 2)
    return offset[indices], radius, indices


def _values(values: NDArray, variable: xr.DataArray, component: str | None) -> NDArray:
    """Return the numbers that colours show (n,): a scalar, a component, or the magnitude of a vector."""
    if values.ndim == 1:
        if component is not None:
            raise ValueError(f"component={component!r}: {variable.name} is a scalar")
        return values.astype(float)
    if component is None:
        return np.asarray(np.linalg.norm(values, axis=1))
    if component not in COMPONENTS:
        raise ValueError(f"component={component!r}: expected one of {', '.join(COMPONENTS)}")
    return values[:, COMPONENTS.index(component)]
