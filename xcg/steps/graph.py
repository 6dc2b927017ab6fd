"""Dask arrays whose chunks are entries of what a task returns: all variables of a step come from one task.

`Gathered` looks through them: a task that takes many entries of one result depends on that result alone, which leaves
one task where there would be one a variable. What works on each chunk of such an array, as writing by xarray does, is
merged with the picking before there are tasks at all, since dask is told of it as one rule for all chunks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import numpy as np
from dask.blockwise import blockwise
from dask.highlevelgraph import HighLevelGraph
from numpy.typing import NDArray

if TYPE_CHECKING:
    import dask.array as da


def picked(
    graph: HighLevelGraph, layer: str, name: str, key: str, chunks: Sequence[int], shape: tuple[int, ...], dtype: Any
) -> da.Array:
    """Array of the entries `name` of the mappings that the tasks ``(layer, 0)``, ``(layer, 1)``, ... return.

    Parameters
    ----------
    graph : HighLevelGraph
        Holds `layer`.
    key : str
        Name of the array.
    chunks : sequence of int
        Steps in each chunk.
    shape : tuple of int
        Shape of one step.
    """
    import dask.array as da  # slow to import, and writers of arrays in memory take this module, too

    axes = tuple(range(1 + len(shape)))
    picks: Any = blockwise(
        itemgetter(name), key, axes, layer, (0,), numblocks={layer: (len(chunks),)}, new_axes=dict.fromkeys(axes[1:], 1)
    )
    picks.origin = layer, name
    whole = HighLevelGraph({**graph.layers, key: picks}, {**graph.dependencies, key: {layer}})
    sizes = (tuple(chunks), *((n,) for n in shape))
    return da.Array(whole, key, sizes, meta=np.empty((0,) * (1 + len(shape)), dtype))


def origin(array: da.Array) -> tuple[str, str] | None:
    """Layer and entry that all chunks of an array are picked from; None where it comes about otherwise."""
    return getattr(array.dask.layers.get(array.name), "origin", None)


@dataclass(frozen=True)
class Gathered:
    """Arrays of the same chunks of time, whole otherwise, for tasks that take one chunk of all of them.

    Attributes
    ----------
    sources : tuple
        What such a task depends on: layers by name and number of indices.
    entries : mapping
        Where each array is among them, and under which name in it; "" for an array itself.
    """

    sources: tuple[tuple[str, int], ...]
    entries: Mapping[str, tuple[int, str]]

    @classmethod
    def of(cls, arrays: Mapping[str, da.Array]) -> Gathered:
        """Look through the picks of these arrays."""
        sources: list[tuple[str, int]] = []
        entries = {}
        for name, array in arrays.items():
            found = origin(array)
            layer, entry = found or (array.name, "")
            source = (layer, 1 if found else array.ndim)
            if source not in sources:
                sources.append(source)
            entries[name] = (sources.index(source), entry)
        return cls(tuple(sources), entries)

    def keys(self, chunk: int) -> list[tuple[Any, ...]]:
        """Keys that the task of one chunk depends on."""
        return [(layer, chunk, *(0,) * (indices - 1)) for layer, indices in self.sources]

    def take(self, values: Sequence[Any]) -> dict[str, NDArray]:
        """Arrays by name, from the values of the keys."""
        return {name: values[k][entry] if entry else values[k] for name, (k, entry) in self.entries.items()}
