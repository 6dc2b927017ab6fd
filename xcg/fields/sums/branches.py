"""Segments of the contacts of a step: kept, or in large steps listed anew for each block of nodes that they reach."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from xcg.compiled.reach import Nodes, batches_in_reach
from xcg.compiled.segments import (
    RUN,
    SEGMENT,
    ContactRows,
    Segments,
    bounds_of_segments,
    list_segments,
    measure_segments,
    no_bounds,
)

# Segments of more contacts than this are not kept, as each takes 80 bytes.
MOST_LISTED_ONCE = 1 << 22
# Runs that are listed at one time, so that their segments stay in cache.
_TOGETHER = 256

# the first arguments of `list_segments`, up to the origin
Listing: TypeAlias = tuple[
    ContactRows, NDArray | None, bool, int, NDArray, float, tuple[float, float, float]
]  # fmt: skip


class Branches(Protocol):
    """Segments of contacts, in an order that is the same for all blocks of nodes."""

    def near(self, nodes: Nodes) -> Iterator[Segments]:
        """All segments that reach a block of nodes, some at a time."""


@dataclass(frozen=True, eq=False)
class ListedOnce:
    """Segments that stay in memory, some of which may be out of reach."""

    segments: Segments

    @classmethod
    def of(cls, records: NDArray, limits: NDArray) -> ListedOnce:
        """Keep records of segments; `limits` are those of `Segments`."""
        return cls(Segments(records, limits, bounds_of_segments(records)))

    def near(self, nodes: Nodes) -> Iterator[Segments]:
        """All segments."""
        yield self.segments


@dataclass(frozen=True, eq=False)
class ListedAnew:
    """Segments of which the bounds alone stay in memory."""

    listing: Listing
    contacts: NDArray
    bounds: NDArray
    limits: NDArray

    def near(self, nodes: Nodes) -> Iterator[Segments]:
        """Segments of the runs that reach a block of nodes, listed again."""
        reaches = np.empty(len(self.bounds), bool)
        batches_in_reach(self.bounds, nodes.begin, nodes.end, nodes.active, nodes.period, reaches)
        runs = np.flatnonzero(reaches)
        for first in range(0, len(runs), _TOGETHER):
            some = runs[first : first + _TOGETHER]
            places = (RUN * some[:, None] + np.arange(RUN)).ravel()
            contacts = self.contacts[places[places < len(self.contacts)]]  # the last run may be shorter
            records, _, _ = list_some(self.listing, contacts)
            yield Segments(records, self.limits, self.bounds[some])


def list_some(listing: Listing, contacts: NDArray) -> tuple[NDArray, NDArray, bool]:
    """List the segments of some contacts: records, the longest (4,), and whether any contact has a second segment."""
    records, longest = np.empty((len(contacts), SEGMENT)), np.empty(4)
    more = list_segments(*listing, contacts, records, longest)
    return records, longest, more


def measure(listing: Listing, contacts: NDArray) -> tuple[NDArray, NDArray, bool]:
    """Measure the segments of some contacts: bounds of runs, the longest, and whether any has a second segment."""
    bounds, longest = no_bounds(len(contacts)), np.empty(4)
    more = measure_segments(*listing, contacts, bounds, longest)
    return bounds, longest, more
