"""Program of the algebra of fields, which one compiled loop runs over the nodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xcg.compiled import program as loops
from xcg.compiled.simd import EIGHT

PADDED = 8  # least length of a tuple of arrays; others are 4, 16, ... times as long


@dataclass(frozen=True, eq=False)
class Program:
    """Instructions from the moments at a node to its fields.

    Attributes
    ----------
    instructions : array (n, 4)
        As `xcg.compiled.program.run` takes them.
    scratch : array (rows, TILE)
        Constants in their rows.
    inputs : tuple of (str, int, int)
        Moments, of which group, and which of their columns.
    target : array (stores, 9)
        Rows of these components.
    widths : dict
        How many numbers of each field, which it computes, are stored for a node.
    stores : array (stores, 4)
        Its field's number, as in `widths`; its first component; how many numbers the field holds for
        a node; how many there are.
    """

    instructions: NDArray
    scratch: NDArray
    inputs: tuple[tuple[str, int, int], ...]
    target: NDArray
    widths: Mapping[str, int]
    stores: NDArray

    def run(
        self,
        table: Mapping[str, tuple[int, NDArray, NDArray]],
        filled: Sequence[NDArray],
        indices: NDArray,
        out: Mapping[str, NDArray],
        order: NDArray | None,
    ) -> None:
        """Compute fields (nodes, ...) from sums at some nodes, with their `indices` (some nodes,) among all.

        They are taken in an `order` (some nodes,), such as that of their indices: memory is then written
        line by line.

        Parameters
        ----------
        table : mapping
            Where each moment is: which of the arrays, its columns, and a factor for each group.
        filled : sequence of array (groups, nodes, columns)
            Sums at the nodes.
        """
        arrays = [array for groups in filled for array in groups]
        first_array = np.cumsum([0, *map(len, filled)]).tolist()
        sources: list[tuple[int, int, float]] = []  # array, column and factor of each input
        for moment, group, column in self.inputs:
            number, columns, factor = table[moment]
            first_column = int(columns.min())
            sources.append(
                (first_array[number] + group, first_column + column, float(factor[group]))
            )
        factors = list(dict.fromkeys(factor for _, _, factor in sources))
        # rows of the scratch: constants, factors, columns of each array, results of instructions
        constants = len(self.scratch)
        widths = [array.shape[1] for array in arrays]
        whole_lines = [width + -width % EIGHT for width in widths]
        rows = np.cumsum([constants + len(factors), *whole_lines]).tolist()
        scratch = loops.room_for(rows[-1])
        scratch[:constants] = self.scratch
        scratch[constants : rows[0]] = np.reshape(factors, (-1, 1))
        inputs = [
            (rows[array] + column, constants + factors.index(factor))
            for array, column, factor in sources
        ]
        columns_of_arrays = np.column_stack([widths, rows[: len(arrays)]])
        if order is not None:
            indices = indices[order]
        loops.run(
            self.instructions,
            _padded(arrays),
            columns_of_arrays.astype("uint64"),
            np.array(inputs, "uint64").reshape(-1, 2),
            _padded([out[name] for name in self.widths]),
            self.stores,
            self.target,
            indices,
            order,
            True if (self.instructions[:, 0] == loops.FIT).any() else None,
            np.empty((loops.TILE + EIGHT) * max(widths)),
            scratch,
        )


def _padded(arrays: Sequence[NDArray]) -> tuple[NDArray, ...]:
    """Return arrays as rows of numbers, filled up to one of few lengths, for each of which the loop is compiled.

    The rows are views, as what the loop writes to a copy would be lost.
    """
    rows = []
    for array in arrays:
        if not array.flags.c_contiguous:
            raise ValueError(
                f"expected numbers one after the other, not with strides {array.strides}"
            )
        rows.append(array.reshape(-1))
    length = PADDED
    while length < len(rows):
        length *= 4
    return (*rows, *(np.empty(0) for _ in range(length - len(rows))))
