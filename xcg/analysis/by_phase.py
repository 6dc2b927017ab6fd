"""Base class of analyses of groups of particles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.scene.frame import phase_of, without_frozen
from xcg.scene.scene import Scene
from xcg.scene.schema import Frame
from xcg.steps.analysis import FrameAnalysis
from xcg.steps.labels import phases_of


@dataclass(frozen=True, eq=False, kw_only=True)
class PhaseAnalysis(FrameAnalysis):
    """Base class of analyses of groups of particles that are not frozen.

    Attributes
    ----------
    by : str, optional
        An integer variable of the particles, whose values are the groups.
    groups : sequence of int, optional
        Its values.
    """

    optional: ClassVar[tuple[str, ...]] = ("frozen",)

    by: str | None = None
    groups: Sequence[int] | None = None

    def prepare(self, scene: Scene) -> Self:
        """Find the groups."""
        return replace(self, groups=scene.groups(self.by, self.groups))

    def reads(self, scene: Scene) -> list[str]:
        """Return the positions, and what the groups are known by."""
        return ["position"] if self.by is None else ["position", self.by]

    def coords(self, scene: Scene) -> dict[str, xr.Variable]:
        """Return the phases; dimensions that no result has are left out."""
        phase = phases_of(self.by, self.groups or ())
        return {"phase": phase, "other_phase": xr.Variable("other_phase", phase, phase.attrs)}

    @property
    def phase_count(self) -> int:
        """Number of groups; one without `by`."""
        return max(1, len(self.groups or ()))

    @property
    def dims_of_pairs(self) -> tuple[str, ...]:
        """Dimensions of numbers of pairs of phases."""
        return () if self.by is None else ("phase", "other_phase")

    def with_bulk(self, groups: NDArray, axis: int = 0) -> NDArray:
        """Add the bulk before the groups along an axis; without `by`, the only group is the bulk."""
        if self.by is None:
            return groups
        return with_bulk(groups, axis)

    def of_pairs(self, values: NDArray) -> NDArray:
        """Return values by pair of phases (phases, phases, ...); without `by`, of the bulk alone."""
        return values[0, 0] if self.by is None else values

    def moving(self, frame: Frame, source: str) -> tuple[Frame, NDArray]:
        """Return a frame without frozen particles, and the number of the group of each."""
        frame = without_frozen(frame)
        return frame, phase_of(frame, self.by, self.groups or (), source)


def with_bulk(groups: NDArray, axis: int = 0) -> NDArray:
    """Add the sum over all groups along an axis as the first of them."""
    return np.concatenate([groups.sum(axis=axis, keepdims=True), groups], axis=axis)
