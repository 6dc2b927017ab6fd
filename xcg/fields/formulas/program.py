"""The algebra of fields as a program: traced once, then run over the nodes by one compiled loop."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import count
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.compiled import program as loops
from xcg.compiled.gradient_fit import FOUND
from xcg.compiled.simd import EIGHT
from xcg.fields.formulas import registry
from xcg.fields.formulas.algebra import Trace, as_symbols, zero_if_unknown
from xcg.fields.formulas.field import Options

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
        How many numbers of each field, which it computes, are stored for a place.
    stores : array (stores, 4)
        Its field's number, as in `widths`; its first component; how many numbers the field holds for
        a place; how many there are.
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
        place: NDArray,
        out: Mapping[str, NDArray],
        order: NDArray | None,
    ) -> None:
        """Compute fields (places, ...) from sums at some nodes, each to its `place` (nodes,).

        They are taken in an `order` (nodes,), such as that of their places: memory is then written
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
            place = place[order]
        loops.run(
            self.instructions,
            _padded([_flat(array) for array in arrays]),
            columns_of_arrays.astype("uint64"),
            np.array(inputs, "uint64").reshape(-1, 2),
            _padded([_flat(out[name]) for name in self.widths]),
            self.stores,
            self.target,
            place,
            order,
            np.empty((loops.TILE + EIGHT) * max(widths)),
            scratch,
        )


def _flat(numbers: NDArray) -> NDArray:
    """Return an array as one row of numbers; a view, as what the loop writes to a copy would be lost."""
    if not numbers.flags.c_contiguous:
        raise ValueError(
            f"expected numbers one after the other, not with strides {numbers.strides}"
        )
    return numbers.reshape(-1)


def _padded(arrays: Sequence[NDArray]) -> tuple[NDArray, ...]:
    """Fill up a tuple of arrays to one of few lengths, for each of which the loop is compiled."""
    length = PADDED
    while length < len(arrays):
        length *= 4
    return (*arrays, *(np.empty(0) for _ in range(length - len(arrays))))


@lru_cache(maxsize=64)
def program_for(fields: tuple[str, ...], options: Options, groups: int = 0) -> Program | None:
    """Trace the algebra of some fields, of the bulk and of groups.

    Fields that cannot be traced are left out, and None is returned where all are: those whose
    formula, or that of a field that they need, takes operations that the loop does not know, or
    other nodes.
    """
    if options.gradient == "finite_difference":  # of all nodes at once
        return None
    record = Trace()
    rows = registry.rows_of(fields, options)
    moments = {
        name: record.load(name, moment.columns, groups, paired=moment.paired)
        for name, moment in registry.moments_of(rows.values(), options).items()
    }
    moments["reference"] = zero_if_unknown(record.load("reference", np.arange(3))[0, 0])
    sums = SimpleNamespace(**moments)
    traced: dict[str, Any] = {}
    for name, row in rows.items():
        if traced.keys() >= set(row.fields):
            try:
                traced[name] = as_symbols(row.compute(SimpleNamespace(**traced), sums, options))
            except Exception:  # numbers may do; if not, they give an error that says why
                continue
    results = {}
    for name in fields:
        if name not in traced:
            continue
        components = list(traced[name].flat)
        together = 3 ** rows[name].rank
        for first in range(0, len(components), together):
            values = components[first : first + together]
            results[name, first, together] = [record.of(value).number for value in values]
    if not results:
        return None
    return _allocate(record.instructions, results)


def _allocate(
    recorded: Sequence[tuple[int, tuple[Any, ...]]],
    results: Mapping[tuple[str, int, int], Sequence[int]],
) -> Program:
    """Assign the instructions that lead to results to rows of numbers; rows are reused once nothing needs them.

    `results` holds the instructions that lead to the components of each store. What is stored together is
    stored as soon as it is there.
    """
    uses = _uses(recorded, results)
    row, constants, kept = _rows_for_good(recorded, sorted(uses))
    free: list[int] = []
    fresh = count(kept)
    instructions: list[tuple[int, int, int, int]] = []
    inputs: list[tuple[str, int, int]] = []
    stored: list[tuple[str, int, int]] = []
    target = np.zeros((len(results), 9), "uint64")

    def row_of(number: int) -> int:
        """Return the row of the result of an instruction; a column is loaded when it is first needed."""
        operation, operands = recorded[number]
        if number not in row:
            row[number] = free.pop() if free else next(fresh)
        if operation == loops.LOAD and operands not in inputs:
            instructions.append((loops.LOAD, row[number], len(inputs), 0))
            inputs.append((operands[0], operands[1], operands[2]))
        return row[number]

    complete: dict[int, list[tuple[str, int, int]]] = {}
    for store, numbers in results.items():
        complete.setdefault(max(numbers), []).append(store)
    for number in sorted(uses):
        operation, operands = recorded[number]
        if operation == loops.FIT:
            rows = [row_of(operand) for operand in operands[1:]]
            instructions.append((loops.FIT, row[number], rows[0], operands[0]))
        elif operation not in (loops.CONSTANT, loops.LOAD, loops.PART):
            rows = [row_of(operand) for operand in operands]
            instructions.append((operation, row_of(number), rows[0], rows[-1]))
        taken = list(_operands(operation, operands))
        for store in complete.get(number, ()):
            target[len(stored), : len(results[store])] = [row_of(k) for k in results[store]]
            instructions.append((loops.STORE, len(stored), 0, 0))
            stored.append(store)
            taken += results[store]
        for operand in taken:  # after its last use its row is free
            uses[operand] -= 1
            if not uses[operand] and row[operand] >= kept:
                free.append(row[operand])
    scratch = np.zeros((next(fresh), loops.TILE))
    for place, value in constants.items():
        scratch[place] = value
    widths, stores = _table_of_stores(stored)
    return Program(np.array(instructions, "uint64"), scratch, tuple(inputs), target, widths, stores)


def _uses(
    recorded: Sequence[tuple[int, tuple[Any, ...]]],
    results: Mapping[tuple[str, int, int], Sequence[int]],
) -> Counter[int]:
    """Return how often each instruction that leads to a result is used."""
    uses = Counter(number for numbers in results.values() for number in numbers)
    waiting = list(uses)
    while waiting:
        for operand in _operands(*recorded[waiting.pop()]):
            if not uses[operand]:
                waiting.append(operand)
            uses[operand] += 1
    return uses


def _rows_for_good(
    recorded: Sequence[tuple[int, tuple[Any, ...]]], numbers: Iterable[int]
) -> tuple[dict[int, int], dict[int, float], int]:
    """Return the rows of instructions that are never reused, the constants by row, and the next row.

    They are rows of constants, and of what a fit takes and finds, side by side.
    """
    row: dict[int, int] = {}
    constants: dict[int, float] = {}
    kept = 0
    for number in numbers:
        operation, operands = recorded[number]
        if operation == loops.CONSTANT:
            row[number] = kept
            constants[kept] = operands[0]
            kept += 1
        elif operation == loops.FIT:
            for operand in operands[1:]:
                row[operand] = kept
                kept += 1
            row[number] = kept
            kept += FOUND
        elif operation == loops.PART:
            row[number] = row[operands[1]] + operands[0]
    return row, constants, kept


def _table_of_stores(
    stored: Sequence[tuple[str, int, int]],
) -> tuple[dict[str, int], NDArray]:
    """Return how many numbers of each field a place holds, and the stores by field's number."""
    widths: dict[str, int] = {}
    for name, first, components in stored:
        widths[name] = max(widths.get(name, 0), first + components)
    names = list(widths)
    stores = [
        (names.index(name), first, widths[name], components) for name, first, components in stored
    ]
    return widths, np.array(stores, "uint64")


def _operands(operation: int, operands: tuple[Any, ...]) -> tuple[int, ...]:
    """Return the instructions that an instruction takes something from."""
    if operation in (loops.CONSTANT, loops.LOAD):
        return ()
    if operation in (loops.FIT, loops.PART):
        return operands[1:]
    return operands
