"""Parts of space, at rest, moving, or following a particle, and what is made of them with ``&``, ``|`` and ``~``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xcg.scene.lattice import Lattice
from xcg.scene.numbers import is_positive, vector
from xcg.scene.schema import Frame


class Region:
    """Part of space; ``a & b``, ``a | b`` and ``~a`` are regions, too."""

    def contains(self, frame: Frame, time: float, lattice: Lattice) -> NDArray:
        """Tell which particles have their centre inside.

        Parameters
        ----------
        frame : Frame
            One step of a scene: ``position`` and ``particle_id``.
        time : float
            Its time (s).
        lattice : Lattice
            Periodic images.

        Returns
        -------
        array of bool (n,)
        """
        raise NotImplementedError

    def __and__(self, other: Region) -> Region:
        return _Both(self, other)

    def __or__(self, other: Region) -> Region:
        return _Either(self, other)

    def __invert__(self) -> Region:
        return _Outside(self)


@dataclass(frozen=True)
class _Both(Region):
    first: Region
    second: Region

    def contains(self, frame: Frame, time: float, lattice: Lattice) -> NDArray:
        return self.first.contains(frame, time, lattice) & self.second.contains(frame, time, lattice)


@dataclass(frozen=True)
class _Either(Region):
    first: Region
    second: Region

    def contains(self, frame: Frame, time: float, lattice: Lattice) -> NDArray:
        return self.first.contains(frame, time, lattice) | self.second.contains(frame, time, lattice)


@dataclass(frozen=True)
class _Outside(Region):
    region: Region

    def contains(self, frame: Frame, time: float, lattice: Lattice) -> NDArray:
        return ~self.region.contains(frame, time, lattice)


def _three(name: str, given: Sequence[float], *, infinite: bool = False) -> tuple[float, float, float]:
    x, y, z = vector(name, given, infinite=infinite).tolist()
    return x, y, z


def _offset(frame: Frame, time: float, velocity: Sequence[float], follow: int | None) -> NDArray | None:
    """How far a region has moved from where it was given (m); None where the particle that it follows is gone."""
    if follow is None:
        return np.asarray(velocity) * time
    row = np.flatnonzero(frame["particle_id"] == follow)
    return frame["position"][row[0]] if row.size else None


def _check_motion(velocity: Sequence[float], follow: int | None) -> tuple[float, float, float]:
    if follow is not None and np.any(velocity):
        raise ValueError(f"velocity={velocity!r} and follow={follow!r}: expected one of the two")
    return _three("velocity", velocity)


@dataclass(frozen=True)
class Box(Region):
    """A box with edges along x, y, z; its faces belong to it.

    Attributes
    ----------
    lower, upper : three floats
        Corners (m), infinite where there is no face. With `follow`, relative to that particle.
    velocity : three floats
        Of the box (m s-1); `lower` and `upper` hold at time 0.
    follow : int, optional
        Id of the particle that the box moves with; where it is gone the box is empty.

    Raises
    ------
    ValueError
        If the corners are not three numbers each, or a lower one is above the upper.
    """

    lower: Sequence[float]
    upper: Sequence[float]
    velocity: Sequence[float] = (0.0, 0.0, 0.0)
    follow: int | None = None

    def __post_init__(self) -> None:
        lower, upper = _three("lower", self.lower, infinite=True), _three("upper", self.upper, infinite=True)
        if not all(a <= b for a, b in zip(lower, upper, strict=True)):
            raise ValueError(f"lower={lower}, upper={upper}: expected every lower edge below the upper")
        object.__setattr__(self, "velocity", _check_motion(self.velocity, self.follow))
        object.__setattr__(self, "lower", lower)
        object.__setattr__(self, "upper", upper)

    def contains(self, frame: Frame, time: float, lattice: Lattice) -> NDArray:
        """Tell which particles have their centre inside."""
        position = frame["position"]
        offset = _offset(frame, time, self.velocity, self.follow)
        if offset is None:
            return np.zeros(len(position), bool)
        lower, upper = np.asarray(self.lower), np.asarray(self.upper)
        bounded = np.isfinite(lower) & np.isfinite(upper)
        # about its centre, so that a periodic image inside counts
        middle = np.where(bounded, 0.5 * (np.where(bounded, lower, 0.0) + np.where(bounded, upper, 0.0)), 0.0)
        away = position - (offset + middle)
        if lattice.vectors is not None:  # the image inside need not be the shortest
            inside, _, _ = lattice.seen(bounded, "region").images(away, lower - middle, upper - middle)
            return np.bincount(inside, minlength=len(away)) > 0
        away = np.where(bounded, lattice.shortest(away), away)
        return np.asarray(((away >= lower - middle) & (away <= upper - middle)).all(axis=1))


@dataclass(frozen=True)
class Sphere(Region):
    """A ball; its surface belongs to it.

    Attributes
    ----------
    centre : three floats
        Centre (m). With `follow`, relative to that particle.
    radius : float
        Radius (m).
    velocity : three floats
        Of the centre (m s-1); `centre` holds at time 0.
    follow : int, optional
        Id of the particle that the ball moves with; where it is gone the ball is empty.

    Raises
    ------
    ValueError
        If the centre is not three numbers, or the radius is not positive.
    """

    centre: Sequence[float]
    radius: float
    velocity: Sequence[float] = (0.0, 0.0, 0.0)
    follow: int | None = None

    def __post_init__(self) -> None:
        if not is_positive(self.radius):
            raise ValueError(f"radius={self.radius!r}: expected a positive length (m)")
        object.__setattr__(self, "velocity", _check_motion(self.velocity, self.follow))
        object.__setattr__(self, "centre", _three("centre", self.centre))

    def contains(self, frame: Frame, time: float, lattice: Lattice) -> NDArray:
        """Tell which particles have their centre inside."""
        position = frame["position"]
        offset = _offset(frame, time, self.velocity, self.follow)
        if offset is None:
            return np.zeros(len(position), bool)
        away = lattice.shortest(position - (offset + np.asarray(self.centre)))
        return np.asarray((away**2).sum(axis=1) <= self.radius**2)
