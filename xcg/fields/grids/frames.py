"""Other axes than the scene's: nodes, vectors, tensors and gradients in axes of the user's choice."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.checks import is_positive, unit, unit_vector, vector
from xcg.scene.box import turn_scene
from xcg.scene.schema import COMPONENTS

CYLINDRICAL = "cylindrical"
_PARALLEL = 1e-6  # sine of the smallest angle between two axes that are given
_NO_PLACE = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Rotated:
    """Axes x, y, z chosen by the user, for the argument ``frame``; right-handed, at right angles.

    One or two of them are given. Of two, the first of z, x, y is kept as it is, and of the other its part at a right
    angle to that. Of one, the second is the scene's own z, or x where that is z, likewise.

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
    Everything in the request and in the result is in these axes: ``axes``, ``at``, ``bounds``, ``extent``,
    ``pressure_dims``, coordinates, and the labels x, y, z of ``component`` and ``direction``. All is as if the scene
    itself were turned. Results hold the axes, row by row, and the origin as the attributes ``frame_axes`` and
    ``frame_origin``.

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
    origin: Sequence[float] = _NO_PLACE

    def __post_init__(self) -> None:
        given = [a for a in COMPONENTS if getattr(self, a) is not None]
        if len(given) not in (1, 2):
            raise ValueError(f"{self}: expected one or two of the axes x, y, z; the others follow from right angles")
        for name in given:
            unit_vector(name, getattr(self, name))
        vector("origin", self.origin)
        if len(given) == 2 and self._second(*self._order(given)) is None:
            raise ValueError(f"{self}: the axes {' and '.join(given)} are parallel; they are to be at right angles")

    @property
    def axes(self) -> NDArray:
        """The axes x, y, z in the scene's coordinates, a row each (3, 3)."""
        given = self._order(a for a in COMPONENTS if getattr(self, a) is not None)
        first, others = given[0], given[1:] or [a for a in "zxy" if a != given[0]]
        second, beside = next((a, part) for a in others if (part := self._second(first, a)) is not None)
        (third,) = {*COMPONENTS} - {first, second}
        found = {first: unit(self._given(first)), second: beside}
        after = {a: COMPONENTS[(k + 1) % 3] for k, a in enumerate(COMPONENTS)}
        found[third] = np.cross(found[after[third]], found[after[after[third]]])
        return np.array([found[a] for a in COMPONENTS]) + 0.0

    @staticmethod
    def _order(axes: Any) -> list[str]:
        return sorted(axes, key="zxy".index)

    def _given(self, axis: str) -> NDArray:
        """Direction of an axis: given, or the scene's own."""
        value = getattr(self, axis)
        return np.eye(3)[COMPONENTS.index(axis)] if value is None else np.asarray(value, float)

    def _second(self, first: str, second: str) -> NDArray | None:
        """Part of an axis at a right angle to the first; None where they are parallel."""
        one, other = unit(self._given(first)), unit(self._given(second))
        part = other - (other @ one) * one
        return unit(part - (part @ one) * one) if np.linalg.norm(part) > _PARALLEL else None


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
        Direction in which theta is 0; its part at a right angle to the axis counts. By default the scene's x, or y
        where x is the axis.
    error : float
        What averages over theta may differ by from the exact integral, as a share of the most that one grain adds at
        any place: so many angles are taken. Kernels that jump at their cutoff do not meet it, as the attribute
        ``theta_error`` of results estimates the error.

    Raises
    ------
    ValueError
        If an argument is wrong.

    Notes
    -----
    ``axes`` is made of "r", "t" (theta) and "z": "r", "rz", "rt", "rtz"; ``at``, ``bounds`` and ``spacing`` name r,
    theta (rad) and z. Axes that are not named are averaged: theta over the circle, or over ``bounds["theta"]``, z as
    in `xcg.coarse_grain`. ``component`` and ``direction`` are r, theta and z. At each angle the sums are turned
    into these axes, then they are averaged over theta, and fields follow from the averages: so the velocity gradient
    holds V_theta / r by itself, and a rigid rotation has no shear rate and no temperature. On the axis itself r and
    theta have no direction: vectors and tensors are NaN there.

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
    origin: Sequence[float] = _NO_PLACE
    x: Sequence[float] | None = None
    error: float = 1e-3

    def __post_init__(self) -> None:
        if isinstance(self.axis, str) and self.axis not in COMPONENTS:
            raise ValueError(f"{self}: expected 'x', 'y', 'z' or a direction as its axis")
        if not isinstance(self.axis, str):
            unit_vector("axis", self.axis)
        if not is_positive(self.error):
            raise ValueError(f"{self}: expected a positive error, such as 1e-3")
        _ = self.rotated

    @property
    def rotated(self) -> Rotated:
        """The axes in which the cylinder's is z, and theta is 0 along x."""
        z = np.eye(3)[COMPONENTS.index(self.axis)] if isinstance(self.axis, str) else self.axis
        given = Rotated(z=tuple(np.asarray(z, float).tolist()), x=self.x, origin=self.origin)
        along_x = self.x is None and Rotated(z=given.z).axes[2] @ np.eye(3)[0] > 1.0 - _PARALLEL**2
        return Rotated(z=given.z, x=(0.0, 1.0, 0.0), origin=self.origin) if along_x else given


def in_frame(ds: xr.Dataset, frame: Rotated | Cylindrical) -> xr.Dataset:
    """Return the scene in a frame, which its attributes then name."""
    axes = frame if isinstance(frame, Rotated) else frame.rotated
    origin = np.asarray(frame.origin, float)
    turned = turn_scene(ds, axes.axes, origin)
    name = "rotated" if isinstance(frame, Rotated) else CYLINDRICAL
    return turned.assign_attrs(frame=name, frame_axes=axes.axes.ravel(), frame_origin=origin)


def refuse_cylindrical(ds: xr.Dataset, call: str) -> None:
    """Raise ValueError where a cylindrical frame has no meaning."""
    if is_cylindrical(ds):
        raise ValueError(f"{call} takes axes at right angles: frame=xcg.Rotated, not xcg.Cylindrical")


def is_cylindrical(ds: xr.Dataset) -> bool:
    """Return whether a scene was turned into, or a result is in, a cylindrical frame."""
    return bool(ds.attrs.get("frame") == CYLINDRICAL)
