"""Other axes than the scene's: axes of the user's choice, and the scene turned into them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.checks import POSITIVE, axis_vector, check, unit, unit_vector, vector
from xcg.common.compat import is_in_memory
from xcg.common.messages import SceneError
from xcg.scene.schema import COMPONENTS, MOTION, VECTORS, known_without_reading, mark_measured

CYLINDRICAL = "cylindrical"
_PARALLEL = 1e-6  # sine of the smallest angle between two axes that are given
_AT_ORIGIN = (0.0, 0.0, 0.0)
_FAR_AXIS = 10.0  # extents of the particles from their middle, beyond which no axis of theirs is
_POSITIONS = ("position", "contact_point")
_LATTICE = ("lattice", "lattice_velocity")
_SAME = 1e-12  # rounding of directions


def axis_of(direction: NDArray) -> int | None:
    """Return the axis that a unit vector is along, None for others."""
    k = int(np.argmax(np.abs(direction)))
    if abs(direction[k]) > 1 - _SAME:
        return k
    return None


def frame_about(direction: NDArray) -> tuple[NDArray, NDArray]:
    """Two unit vectors that make a right-handed frame with `direction` as the third; x and y for z."""
    k = axis_of(direction)
    first = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    if k is not None:
        first = np.eye(3)[(k + 1) % 3]
    first = first / np.linalg.norm(first)
    return first, np.cross(direction, first)


def corners(lower: NDArray, upper: NDArray) -> NDArray:
    """Corners (8, 3) of a box."""
    return np.array(list(product(*zip(lower, upper, strict=True))))


@dataclass(frozen=True)
class Rotated:
    """Axes x, y, z chosen by the user, for the argument ``frame``; right-handed, at right angles.

    One or two of them are given. Of two, the first of z, x, y is kept as it is, and of the other
    its part at a right angle to that. Of one, the second is the scene's own z, or x where that is
    z, likewise.

    Parameters
    ----------
    x, y, z : sequence of float, optional
        Directions of the new axes in the scene's own, of any length.
    origin : sequence of float
        Where the new axes meet, in the scene's own coordinates (m).

    Raises
    ------
    ValueError
        If none or three axes are given, two are parallel, or numbers are not finite.

    Notes
    -----
    Everything in the request and in the result is in these axes: ``axes``, ``at``, ``bounds``,
    ``extent``, ``pressure_dims``, coordinates, and the labels x, y, z of ``component`` and
    ``direction``. All is as if the scene itself were turned. Results hold the axes, row by row, and
    the origin as the attributes ``frame_axes`` and ``frame_origin``.

    Examples
    --------
    >>> import xcg
    >>> frame = xcg.Rotated(z=(0, 1, 1), x=(1, 0, 0))
    >>> frame.axes.round(3).tolist()
    [[1.0, 0.0, 0.0], [0.0, 0.707, -0.707], [0.0, 0.707, 0.707]]
    """

    x: Sequence[float] | None = None
    y: Sequence[float] | None = None
    z: Sequence[float] | None = None
    origin: Sequence[float] = _AT_ORIGIN

    def __post_init__(self) -> None:
        chosen = self._chosen
        if len(chosen) not in (1, 2):
            raise ValueError(
                f"{self}: expected one or two of the axes x, y, z; the others follow from right angles"
            )
        for name in chosen:
            unit_vector(name, getattr(self, name))
        vector("origin", self.origin)
        if len(chosen) == 2 and self._second(*chosen) is None:
            raise ValueError(
                f"{self}: the axes {' and '.join(chosen)} are parallel: give two different directions"
            )

    @classmethod
    def from_slope(cls, fit: xr.Dataset) -> Rotated:
        """Return axes along a fitted surface: z is normal to it, upwards, and x points down the slope.

        The origin lies on the surface, so that z is 0 there. If the surface was found along another
        axis than z, that axis becomes the normal. This computes the fit.

        Parameters
        ----------
        fit : xarray.Dataset
            One fit, from `xcg.fit_slope`: of one step, ``fit.isel(time=-1)``, or the mean of several,
            ``fit.mean("time")``.

        Returns
        -------
        Rotated
            Axes for the argument ``frame``. A level surface keeps the axes of the scene.

        Raises
        ------
        ValueError
            If it is not a fit, holds several of them, or found no surface.

        Examples
        --------
        >>> import numpy as np, xarray as xr, xcg
        >>> x = np.linspace(0, 1, 11)
        >>> fit = xcg.fit_slope(xr.DataArray(0.5 - 0.75 * x, {"x": x}))
        >>> xcg.Rotated.from_slope(fit).axes.round(3).tolist()
        [[0.8, 0.0, -0.6], [0.0, 1.0, 0.0], [0.6, 0.0, 0.8]]
        """
        if not (isinstance(fit, xr.Dataset) and {"slope", "intercept"} <= set(fit)):
            raise ValueError(
                "from_slope: expected a fit of xcg.fit_slope, such as f.cg.free_surface('z').cg.fit_slope()"
            )
        fit = fit.squeeze([dim for dim in fit.dims if fit.sizes[dim] == 1 and dim != "component"])
        if fit["slope"].dims != ("component",):
            sizes = {dim: n for dim, n in fit["slope"].sizes.items() if dim != "component"}
            raise ValueError(
                f"from_slope: expected one fit, and there are {sizes}: take one, fit.isel(time=-1), or their mean, "
                "fit.mean('time')"
            )
        level = [str(a) for a in fit["component"].values]
        across = str(fit.attrs.get("surface_axis") or next(a for a in "zyx" if a not in level))
        slope = fit["slope"].to_numpy()
        height = float(fit["intercept"])
        if not (np.isfinite(slope).all() and np.isfinite(height)):
            raise ValueError(
                "from_slope: the fit is NaN, as fewer nodes have a surface than it takes"
            )
        unit_of = dict(zip(COMPONENTS, np.eye(3), strict=True))
        rise = sum(s * unit_of[a] for s, a in zip(slope, level, strict=True))
        normal = unit_of[across] - rise
        down = -rise - (slope @ slope) * unit_of[across]
        if not slope.any():
            down = unit_of[level[0]]
        axes: dict[str, Any] = {across: tuple(normal.tolist()), level[0]: tuple(down.tolist())}
        return cls(**axes, origin=tuple((height * unit_of[across]).tolist()))

    @property
    def axes(self) -> NDArray:
        """The axes x, y, z in the scene's coordinates, a row each (3, 3)."""
        first, *others = self._chosen
        axes = {first: unit(self._direction(first))}
        for a in others or [a for a in "zxy" if a != first]:
            second = self._second(first, a)
            if second is not None:
                axes[a] = second
                break
        (k,) = (k for k, a in enumerate(COMPONENTS) if a not in axes)
        axes[COMPONENTS[k]] = np.cross(axes[COMPONENTS[k - 2]], axes[COMPONENTS[k - 1]])
        return np.array([axes[a] for a in COMPONENTS]) + 0.0

    @property
    def _chosen(self) -> list[str]:
        """Axes that are given, the one that is kept first."""
        return [a for a in "zxy" if getattr(self, a) is not None]

    def _direction(self, axis: str) -> NDArray:
        """Direction of an axis: given, or the scene's own."""
        value = getattr(self, axis)
        if value is None:
            value = np.eye(3)[COMPONENTS.index(axis)]
        return np.asarray(value, float)

    def _second(self, first: str, second: str) -> NDArray | None:
        """Part of an axis at a right angle to the first; None where they are parallel."""
        kept = unit(self._direction(first))
        other = unit(self._direction(second))
        part = other - (other @ kept) * kept
        if np.linalg.norm(part) <= _PARALLEL:
            return None
        return unit(part - (part @ kept) * kept)


@dataclass(frozen=True)
class Cylindrical:
    """Axes r, theta and z around a line, for the argument ``frame`` of `xcg.coarse_grain`.

    Parameters
    ----------
    axis : {"x", "y", "z"} or sequence of float
        Direction of the axis z of the cylinder, in the scene's own axes.
    origin : sequence of float
        A place on it, where z is 0 (m).
    x : sequence of float, optional
        Direction in which theta is 0; its part at a right angle to the axis counts. By default the
        scene's x, or y where x is the axis.
    error : float
        Largest error of averages over theta, relative to the most that one grain adds; it sets the
        number of angles. Kernels that jump at their cutoff do not meet it, as the attribute
        ``theta_error`` of results estimates the error.

    Raises
    ------
    ValueError
        If an argument is wrong.

    Notes
    -----
    ``axes`` is made of "r", "t" (theta) and "z": "r", "rz", "rt", "rtz"; ``at``, ``bounds`` and
    ``spacing`` name r, theta (rad) and z. Axes that are not named are averaged: theta over the
    circle, or over ``bounds["theta"]``, z as in `xcg.coarse_grain`. ``component`` and ``direction``
    are r, theta and z. At each angle the sums are turned into these axes, then they are averaged
    over theta, and fields follow from the averages: so the velocity gradient holds V_theta / r by
    itself, and a rigid rotation has no shear rate and no temperature. On the axis itself r and
    theta have no direction: there, vectors and tensors are NaN but for their part along z.

    Examples
    --------
    >>> import xcg
    >>> ds = xcg.datasets.simple_cubic(4)
    >>> frame = xcg.Cylindrical("z", origin=(2, 2, 0))
    >>> f = ds.cg.coarse_grain("velocity", axes="r", frame=frame, bounds={"r": (0, 2)}, spacing=0.5)
    >>> f.velocity.dims, f.component.values.tolist()
    (('time', 'r', 'component'), ['r', 'theta', 'z'])
    """

    axis: str | Sequence[float] = "z"
    origin: Sequence[float] = _AT_ORIGIN
    x: Sequence[float] | None = None
    error: float = 1e-3

    def __post_init__(self) -> None:
        axis_vector("axis", self.axis)
        check("error", self.error, POSITIVE, hint=", such as 1e-3")
        _ = self.rotated

    @property
    def rotated(self) -> Rotated:
        """The axes in which the cylinder's is z, and theta is 0 along x."""
        axis: Any = self.axis
        if isinstance(axis, str):
            axis = axis_vector("axis", axis)
        z = tuple(np.asarray(axis, float).tolist())
        x = self.x
        if x is None and Rotated(z=z).axes[2][0] > 1.0 - _PARALLEL**2:
            x = (0.0, 1.0, 0.0)
        return Rotated(z=z, x=x, origin=self.origin)


def check_axis(ds: xr.Dataset, frame: Cylindrical) -> None:
    """Raise ValueError for an axis that is farther from the particles than ten times their extent.

    Scenes whose extent is not known pass.
    """
    low = ds.attrs.get("particle_lower")
    high = ds.attrs.get("particle_upper")
    if low is None or high is None:
        return
    rotated = frame.rotated
    across = rotated.axes[:2] @ (corners(low, high) - np.asarray(rotated.origin)).T
    extent = np.ptp(across, axis=1).max()
    distance = np.linalg.norm(across.mean(axis=1))
    if distance > _FAR_AXIS * extent > 0:
        ranges = ", ".join(
            f"{axis} {a:.4g} to {b:.4g}" for axis, a, b in zip(COMPONENTS, low, high, strict=True)
        )
        raise ValueError(
            f"the axis of the cylinder is {distance:.4g} m from the middle of the particles ({ranges}): give a point "
            f"on the axis, origin= (now {tuple(frame.origin)}), in m, and its direction, axis= (now {frame.axis!r})"
        )


def refuse_cylindrical(ds: xr.Dataset, call: str) -> None:
    """Raise ValueError where a cylindrical frame has no meaning."""
    if is_cylindrical(ds):
        raise ValueError(
            f"{call} needs Cartesian axes: take frame=xcg.Rotated(...), not xcg.Cylindrical(...)"
        )


def is_cylindrical(ds: xr.Dataset) -> bool:
    """Return whether a scene was turned into, or a result is in, a cylindrical frame."""
    return bool(ds.attrs.get("frame") == CYLINDRICAL)


# --- the scene in other axes ------------------------------------------------------------------------------


def in_frame(ds: xr.Dataset, frame: Rotated | Cylindrical) -> xr.Dataset:
    """Return a scene in a frame, lazily where it is lazy: its variables, its box and its gravity; attributes name it.

    A box keeps its edges along axes that are among the new ones. Other periodic axes become vectors
    of a lattice.

    Raises
    ------
    SceneError
        If the axes lead out of the plane of a scene of one layer, or some components of a variable
        are not there.
    """
    name_of_frame = "rotated"
    if isinstance(frame, Cylindrical):
        name_of_frame = CYLINDRICAL
        frame = frame.rotated
    axes = frame.axes  # in the scene's own, a row each
    origin = np.asarray(frame.origin, float)
    across = [k for k, a in enumerate(COMPONENTS) if a not in ds.attrs.get("plane", "xyz")]
    plane = "".join(
        a for a, row in zip(COMPONENTS, axes, strict=True) if axis_of(row) not in across
    )
    if across and len(plane) != len(COMPONENTS) - len(across):
        raise SceneError(
            f"the scene is a layer in the plane {ds.attrs['plane']!r}, and the axes {axes.tolist()} lead out of it: "
            "turn it about the axis across its plane"
        )
    in_axes = {}
    for name in map(str, ds.data_vars):
        dims = [dim for dim in ("component", "direction") if dim in ds[name].dims]
        if not dims or name in ("box", *MOTION):
            continue
        turn: Any = partial(turned, axes=axes, origin=np.zeros(3))
        if name in _POSITIONS:
            turn = partial(turned, axes=axes, origin=origin)
        elif len(dims) == 2:
            turn = partial(_tensors, axes=axes)
        in_axes[name] = _mapped(turn, ds[name], dims).transpose(*ds[name].dims)
    out = _with_box(ds.assign(in_axes), axes, origin)
    attrs = {k: v for k, v in out.attrs.items() if k not in ("particle_lower", "particle_upper")}
    attrs["frame"] = name_of_frame
    attrs |= {"frame_axes": axes.ravel(), "frame_origin": origin}
    if across:
        attrs["plane"] = plane
    if "gravity" in attrs:
        attrs["gravity"] = axes @ np.asarray(attrs["gravity"], float)
    out = out.drop_attrs(deep=False).assign_attrs(attrs)
    is_measured = {"particle_lower", "particle_upper"} <= {*ds.attrs}
    is_lazy = not is_in_memory(ds["position"].variable)
    if is_lazy and is_measured and known_without_reading(ds, "position"):
        extent = corners(ds.attrs["particle_lower"], ds.attrs["particle_upper"])
        extremes = (extent - origin) @ axes.T
        out = out.assign_attrs(
            particle_lower=extremes.min(axis=0), particle_upper=extremes.max(axis=0)
        )
        mark_measured(out, ["position"])
    return out


def _mapped(
    function: Any, values: xr.DataArray, dims: Sequence[str], out: Sequence[str] | None = None
) -> xr.DataArray:
    """Apply a function along dimensions; `out` names the output's, by default the same; new ones have length 3."""
    return xr.apply_ufunc(
        function,
        values,
        input_core_dims=[list(dims)],
        output_core_dims=[list(out or dims)],
        dask="parallelized",
        keep_attrs=out is None,
        output_dtypes=[float],
        dask_gufunc_kwargs={
            "allow_rechunk": True,
            "output_sizes": dict.fromkeys(set(out or ()) - {*dims}, 3),
        },
    )


def turned(values: NDArray, axes: NDArray, origin: NDArray) -> NDArray:
    """Vectors (..., 3) in other axes, component by component, so that the bits do not depend on how many there are."""
    x, y, z = (values[..., k] - origin[k] for k in range(3))
    return np.stack([row[0] * x + row[1] * y + row[2] * z for row in axes.tolist()], axis=-1)


def _tensors(values: NDArray, axes: NDArray) -> NDArray:
    """Tensors (..., 3, 3) in other axes."""
    none = np.zeros(3)
    return turned(turned(values, axes, none).swapaxes(-1, -2), axes, none).swapaxes(-1, -2)


def _with_box(ds: xr.Dataset, axes: NDArray, origin: NDArray) -> xr.Dataset:
    """Turn the edges of a box, and take lattice vectors for periodic axes that are along none of the new ones."""
    if "box" not in ds:
        return ds
    own = [axis_of(row) for row in axes]
    others = [k for k in range(3) if k not in own]
    old_axes = []  # which of its axes becomes each new one
    for k in own:
        if k is None:
            k = others.pop(0)
        old_axes.append(k)
    periodic = str(ds.attrs.get("periodic", ""))
    loose = [k for k in range(3) if k not in own and COMPONENTS[k] in periodic]
    edges = partial(_edges, own=own, axes=axes, origin=origin)
    attrs = dict(ds.attrs)
    if {"box_lower", "box_upper"} <= set(attrs):
        box = edges(np.stack([attrs["box_lower"], attrs["box_upper"]], axis=-1))
        attrs |= {"box_lower": box[:, 0], "box_upper": box[:, 1]}
    attrs["periodic"] = "".join(
        a for a, k in zip(COMPONENTS, old_axes, strict=True) if COMPONENTS[k] in periodic
    )
    turned_box = {}
    turned_box["box"] = _mapped(edges, ds["box"], ["component", "bound"]).transpose(*ds["box"].dims)
    if "lattice" in ds:
        for name in _LATTICE:
            if name in ds:
                vectors = ds[name].isel(vector=old_axes)
                turned_box[name] = vectors.assign_coords(vector=list(VECTORS))
    elif loose:
        repeats = np.array([a in periodic for a in COMPONENTS])
        lattice_of = partial(_lattice_of, axes=axes, old_axes=old_axes, repeats=repeats)
        vectors = _mapped(lattice_of, ds["box"], ["component", "bound"], ["vector", "component"])
        turned_box["lattice"] = vectors.assign_coords(vector=list(VECTORS))
    if "image" in ds:
        images = ds["image"].isel(component=old_axes).assign_coords(component=ds["component"])
        if "lattice" not in ds and "lattice" not in turned_box:  # periods lead along the new axes
            ahead = np.sign(axes[range(3), old_axes]).astype("int64")
            images = images * xr.DataArray(ahead, dims="component")
        turned_box["image"] = images
    return ds.assign(turned_box).drop_attrs(deep=False).assign_attrs(attrs)


def _edges(box: NDArray, own: Sequence[int | None], axes: NDArray, origin: NDArray) -> NDArray:
    """Edges (..., 3, 2) along new axes that are parallel to old ones, else none."""
    out = np.empty(box.shape)
    out[...] = -np.inf, np.inf
    for j, k in enumerate(own):
        if k is not None:
            ends = np.sign(axes[j, k]) * (box[..., k, :] - origin[k])
            out[..., j, :] = np.sort(ends, axis=-1) + 0.0
    return out


def _lattice_of(box: NDArray, axes: NDArray, old_axes: Sequence[int], repeats: NDArray) -> NDArray:
    """Vectors a, b, c (..., 3, 3) to the next images in new axes, zero without images."""
    lengths = np.where(repeats, box[..., 1] - box[..., 0], 0.0)
    return (lengths[..., None] * axes.T)[..., list(old_axes), :]
