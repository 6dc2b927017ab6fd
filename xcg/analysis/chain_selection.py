"""Chains in regions of space, and with other conditions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.analysis.chain_results import (
    CHAINS,
    MEMBERS,
    STATISTICS,
    require_chains,
    result_sizes,
    statistics_of,
)
from xcg.common.checks import FINITE, POSITIVE, check, check_choice, vector, whole
from xcg.scene.conform import takes_scene
from xcg.scene.lattice import Lattice
from xcg.scene.scene import Scene
from xcg.scene.schema import Frame, Variable
from xcg.scene.times import require_known_times
from xcg.steps.analysis import FrameAnalysis, run
from xcg.steps.labels import call_of


class Region:
    """Part of space; ``a & b``, ``a | b`` and ``~a`` are regions, too."""

    def contains(self, frame: Frame, time: float, lattice: Lattice) -> NDArray:
        """Return a mask of the particles whose centre is inside.

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
        return _Combined(np.logical_and, (self, other))

    def __or__(self, other: Region) -> Region:
        return _Combined(np.logical_or, (self, other))

    def __invert__(self) -> Region:
        return _Combined(np.logical_not, (self,))


@dataclass(frozen=True)
class _Combined(Region):
    """Regions whose masks are combined."""

    combine: Callable[..., NDArray]
    regions: tuple[Region, ...]

    def contains(self, frame: Frame, time: float, lattice: Lattice) -> NDArray:
        return self.combine(*(region.contains(frame, time, lattice) for region in self.regions))


def _moves(region: object) -> bool:
    """Return whether a region, or one that it is made of, has a velocity."""
    if isinstance(region, _Combined):
        return any(map(_moves, region.regions))
    return isinstance(region, _Moving) and bool(np.any(region.velocity))


def check_region(region: object, ds: xr.Dataset) -> None:
    """Raise ValueError unless this is a region, or None; SceneError if it moves, and times are not known."""
    if region is not None and not isinstance(region, Region):
        raise ValueError(
            f"region={region!r}: expected xcg.BoxRegion(lower, upper), xcg.Sphere(centre, radius), or a combination"
        )
    if _moves(region):
        require_known_times(ds, f"region={region!r} moves")


class _Moving(Region):
    """A region that moves at a velocity, or with a particle."""

    velocity: Sequence[float]
    follow: int | None

    def __post_init__(self) -> None:
        check("follow", self.follow, whole(0), optional=True, hint=" for no particle")
        if self.follow is not None and np.any(self.velocity):
            raise ValueError(
                f"velocity={self.velocity!r} and follow={self.follow!r}: expected one of the two"
            )
        self._keep("velocity")

    def _keep(self, name: str, *, infinite: bool = False) -> None:
        """Check that an attribute is three numbers, and keep them as a tuple."""
        three = vector(name, getattr(self, name), infinite=infinite)
        object.__setattr__(self, name, tuple(three.tolist()))

    def contains(self, frame: Frame, time: float, lattice: Lattice) -> NDArray:
        """Return a mask of the particles whose centre is inside; all False where the followed particle is missing."""
        position = frame["position"]
        offset = np.asarray(self.velocity) * time
        if self.follow is not None:
            index = np.flatnonzero(frame["particle_id"] == self.follow)
            if not index.size:
                return np.zeros(len(position), bool)
            offset = position[index[0]]
        return self._holds(position, offset, lattice)

    def _holds(self, position: NDArray, offset: NDArray, lattice: Lattice) -> NDArray:
        """Return a mask of the positions (n, 3) inside the region, moved by an offset (3,)."""
        raise NotImplementedError


@dataclass(frozen=True)
class BoxRegion(_Moving):
    """A box with edges along x, y, z; its faces belong to it.

    Attributes
    ----------
    lower, upper : three floats
        Corners (m), infinite on open sides. With `follow`, relative to that particle.
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
        super().__post_init__()
        self._keep("lower", infinite=True)
        self._keep("upper", infinite=True)
        if not np.less_equal(self.lower, self.upper).all():
            raise ValueError(
                f"lower={self.lower}, upper={self.upper}: expected every lower edge below the upper"
            )

    def _holds(self, position: NDArray, offset: NDArray, lattice: Lattice) -> NDArray:
        lower = np.asarray(self.lower)
        upper = np.asarray(self.upper)
        bounded = np.isfinite(lower) & np.isfinite(upper)
        # about its centre, so that a periodic image inside counts
        middle = np.zeros(3)
        middle[bounded] = 0.5 * (lower[bounded] + upper[bounded])
        away = position - (offset + middle)
        if lattice.vectors is not None:  # the image inside need not be the shortest
            of_region = lattice.seen(bounded, "region")
            inside, _, _ = of_region.images(away, lower - middle, upper - middle)
            return np.bincount(inside, minlength=len(away)) > 0
        away = np.where(bounded, lattice.shortest(away), away)
        return np.asarray(((away >= lower - middle) & (away <= upper - middle)).all(axis=1))


@dataclass(frozen=True)
class Sphere(_Moving):
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
        super().__post_init__()
        check("radius", self.radius, POSITIVE, "m")
        self._keep("centre")

    def _holds(self, position: NDArray, offset: NDArray, lattice: Lattice) -> NDArray:
        away = lattice.shortest(position - (offset + np.asarray(self.centre)))
        return np.asarray((away**2).sum(axis=1) <= self.radius**2)


How: TypeAlias = Literal["any", "all"]
_HOW = {"any": np.logical_or, "all": np.logical_and}


@takes_scene
def select_chains(
    fc: Scene,
    region: Region | None = None,
    *,
    min_stress: float | None = None,
    how: How = "any",
) -> xr.Dataset:
    """Keep the chains whose particles fulfil a condition; the others are dropped as if they had not been found.

    Conditions combine: regions with ``&``, ``|`` and ``~``; one selection after the other; and
    region and stress of one call hold for the same particle. Lazy where the result is.

    Parameters
    ----------
    fc : xarray.Dataset
        A result of `force_chains`.
    region : Region, optional
        Where particles must be: `xcg.BoxRegion`, `xcg.Sphere`, or a combination.
    min_stress : float, optional
        Least major stress (Pa).
    how : str
        "any" (default) keeps a chain if one of its particles fulfils the condition, "all" if all of
        them do.

    Returns
    -------
    xarray.Dataset
        The same variables. Chains keep their numbers, dropped ones leave padding; statistics cover
        the chains that are left.

    Raises
    ------
    SceneError
        If `fc` is not a result of `force_chains`.
    ValueError
        If an argument is wrong.
    """
    call = call_of("select_chains", locals())
    require_chains(fc.ds, "select_chains", whole=("chain", "length"))
    check_choice("how", how, How)
    if region is None and min_stress is None:
        raise ValueError(
            "nothing to select by: give region= (xcg.BoxRegion, xcg.Sphere), min_stress= (Pa), or both"
        )
    check_region(region, fc.ds)
    check("min_stress", min_stress, FINITE, "Pa", optional=True)
    analysis = _Selection(region, min_stress, how, int(fc.ds.attrs.get("min_length", 3)))
    return run(fc, analysis, call=call)


@dataclass(frozen=True)
class _Selection(FrameAnalysis):
    """Chains whose particles fulfil a condition."""

    name = "select_chains"
    optional = ("position", "major_stress", "time")

    region: Region | None
    min_stress: float | None
    how: How
    min_length: int

    def reads(self, scene: Scene) -> list[str]:
        """Return the chains."""
        return [*MEMBERS, *CHAINS]

    def rows(self, scene: Scene) -> dict[str, Variable]:
        """Return chains, their members, and the statistics of their lengths."""
        return MEMBERS | CHAINS | STATISTICS

    def frame(self, frame: Frame, lattice: Lattice, source: str) -> dict[str, Any]:
        """Replace the other chains of a step by padding."""
        fulfilled = np.ones(len(frame["particle_id"]), bool)
        if self.region is not None:
            fulfilled &= self.region.contains(frame, float(frame.get("time", 0.0)), lattice)
        if self.min_stress is not None:
            fulfilled &= frame["major_stress"] >= self.min_stress
        chain = frame["chain_id"]
        exists = frame["chain_particles"] > 0
        kept = np.full(len(exists), self.how == "all")
        _HOW[self.how].at(kept, chain[chain >= 0], fulfilled[chain >= 0])
        kept &= exists
        out: dict[str, Any] = {name: frame[name].copy() for name in (*MEMBERS, *CHAINS)}
        # everything of the other chains is padding, or no chain
        lost = (chain >= 0) & ~kept[chain]
        for name, none in (("chain_id", -1), ("parent_id", -1), ("links", 0), ("branching", 0)):
            out[name][lost] = none
        link = out["link_chain"]
        link[(link >= 0) & ~kept[link]] = -1
        for name, row in CHAINS.items():
            out[name][~kept] = row.fill
        bins = result_sizes(len(chain), 0, self.min_length)["length"]
        return out | statistics_of(out["chain_particles"][kept], self.min_length, bins)

    def after(self, result: xr.Dataset, ds: xr.Dataset) -> xr.Dataset:
        """Return all variables of the chains."""
        return ds.assign(result.data_vars).assign_attrs(history=result.attrs["history"])
