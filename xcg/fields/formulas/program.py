"""The algebra of fields as a program: traced once, then run over the nodes by one compiled loop."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import count
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.compiled import program as loops
from xcg.compiled.matrices import FOUND
from xcg.compiled.simd import EIGHT
from xcg.fields.formulas import registry
from xcg.fields.formulas.algebra import Trace, as_symbols, zero_if_unknown
from xcg.fields.formulas.field import Options
from xcg.fields.sums.deposit import BlockSums
from xcg.fields.sums.step import Layout


@dataclass(frozen=True, eq=False)
class Program:
    """Steps from the moments at a node to its fields.

    Attributes
    ----------
    steps : array (n, 4)
        As `xcg.compiled.program.run` takes them.
    scratch : array (rows, TILE)
        Constants in their rows.
    inputs : tuple of (str, int, int)
        Moments, of which group, and which of their columns.
    target : array (stores, 9)
        Rows of these components.
    widths : dict
        How many numbers of each field, which it computes, are stored for a place.
    stores : array (stores, 3)
        Its field's number, as in `widths`; its first component; how many there are.
    """

    steps: NDArray
    scratch: NDArray
    inputs: tuple[tuple[str, int, int], ...]
    target: NDArray
    widths: Mapping[str, int]
    stores: NDArray

    def run(
        self, sums: BlockSums, place: NDArray, out: Mapping[str, NDArray], order: NDArray | None
    ) -> None:
        """Compute fields (places, ...) from the moments at some nodes, each to its `place` (nodes,).

        They are taken in an `order` (nodes,), such as that of their places: memory is then written line by line.

        Raises
        ------
        ValueError
            If an array is not as the loop expects it, which reads and writes by address.
        """
        # the reference velocity and the groups of each pass, (nodes, columns) each; where those of a moment begin
        arrays, found = [sums.velocity], dict[str, tuple[int, Layout]]()
        for done, filled in zip(sums.of.passes, sums.filled, strict=True):
            for name in done.layout.moments:
                found.setdefault(name, (len(arrays), done.layout))
            arrays += list(filled)
        # inputs: of which array, which column, and which factor
        source, factors = list[tuple[int, int, int]](), list[float]()
        for moment, group, column in self.inputs:
            number, first, factor = 0, 0, 1.0
            if moment != "reference":
                number, layout = found[moment]
                columns, each = layout.moments[moment]
                number, first = number + group, int(columns.min())
                factor = each if isinstance(each, float) else float(each[group])
            if factor not in factors:
                factors.append(factor)
            source.append((number, first + column, factors.index(factor)))
        # rows of the scratch: constants of the program, factors, columns of each array, and results of steps
        own, widths = len(self.scratch), [a.shape[1] for a in arrays]
        rows = np.cumsum(
            [own + len(factors), *(width + -width % EIGHT for width in widths)]
        ).tolist()
        scratch = loops.room_for(rows[-1])
        scratch[:own], scratch[own : rows[0]] = self.scratch, np.reshape(factors, (-1, 1))
        inputs = [(rows[number] + column, own + factor) for number, column, factor in source]
        nodes, places = len(place), 1 + int(place.max(initial=0))
        records = [
            (loops.address_of(a, nodes, width, "moments"), width, row)
            for a, width, row in zip(arrays, widths, rows, strict=False)
        ]
        begins = [
            loops.address_of(out[name], places, width, name) for name, width in self.widths.items()
        ]
        which, first, count = self.stores.T
        address = np.array(begins, "uint64")[which] + loops.BYTES * first.astype("uint64")
        fields = np.stack(
            [
                address,
                np.array(list(self.widths.values()), "uint64")[which],
                count.astype("uint64"),
            ],
            1,
        )
        tile = np.empty((loops.TILE + EIGHT) * max(widths))
        to = place if order is None else place[order]
        lists = (
            np.array(records, "uint64"),
            np.array(inputs, "uint64").reshape(-1, 2),
            fields,
            self.target,
        )
        loops.run(self.steps, *lists, to, order, tile.ctypes.data, scratch)


@lru_cache(maxsize=64)
def program_for(fields: tuple[str, ...], options: Options, groups: int = 0) -> Program | None:
    """Trace the algebra of some fields, of the bulk and of groups.

    Fields that cannot be traced are left out, and None is returned where all are: those whose formula, or that of a
    field that they need, takes operations that the loop does not know, or other nodes.
    """
    if options.gradient == "finite_difference":  # of all nodes at once
        return None
    record, found = Trace(), dict[str, Any]()
    wanted = registry.moments_of(fields, options)
    moments = {
        name: record.load(name, row.columns, groups, paired=row.paired)
        for name, row in wanted.items()
    }
    moments["reference"] = zero_if_unknown(record.load("reference", np.arange(3))[0, 0])
    s = SimpleNamespace(**moments)
    for name in registry.order_of(fields, options):
        row = registry.row(name, options)
        if found.keys() >= set(row.fields):
            try:
                found[name] = as_symbols(row.compute(SimpleNamespace(**found), s, options))
            except Exception:  # numbers may do; if not, they give an error that says why
                continue
    results = {
        (name, first, number): [
            record.of(value).number for value in found[name].flat[first : first + number]
        ]
        for name in fields
        if name in found
        for number in [3 ** registry.row(name, options).rank]
        for first in range(0, found[name].size, number)
    }
    return _allocate(record.steps, results) if results else None


def _allocate(
    recorded: Sequence[tuple[int, tuple[Any, ...]]],
    results: Mapping[tuple[str, int, int], Sequence[int]],
) -> Program:
    """Assign the steps that lead to results to rows of numbers; rows are reused once nothing needs them.

    `results` holds the steps that lead to the components of each store. What is stored together is stored as soon as
    it is there.
    """
    uses = Counter(number for numbers in results.values() for number in numbers)
    waiting = list(uses)
    while waiting:
        for operand in _operands(*recorded[waiting.pop()]):
            if not uses[operand]:
                waiting.append(operand)
            uses[operand] += 1
    # rows for good: of constants, and of what a fit takes and finds, side by side
    row, constants, kept = dict[int, int](), dict[int, float](), 0
    for number in sorted(uses):
        operation, operands = recorded[number]
        if operation == loops.CONSTANT:
            row[number], constants[kept], kept = kept, operands[0], kept + 1
        elif operation == loops.FIT:
            row |= {operand: kept + k for k, operand in enumerate(operands[1:])}
            row[number] = kept + len(operands) - 1
            kept = row[number] + FOUND
        elif operation == loops.PART:
            row[number] = row[operands[1]] + operands[0]
    free, fresh = list[int](), count(kept)
    steps, inputs = list[tuple[int, int, int, int]](), list[tuple[str, int, int]]()
    stored, target = list[tuple[str, int, int]](), np.zeros((len(results), 9), "uint64")

    def row_of(number: int) -> int:
        """Row of the result of a step; a column is loaded when it is first needed."""
        operation, operands = recorded[number]
        if number not in row:
            row[number] = free.pop() if free else next(fresh)
        if operation == loops.LOAD and operands not in inputs:
            steps.append((loops.LOAD, row[number], len(inputs), 0))
            inputs.append((operands[0], operands[1], operands[2]))
        return row[number]

    complete = dict[int, list[tuple[str, int, int]]]()
    for store, numbers in results.items():
        complete.setdefault(max(numbers), []).append(store)
    for number in sorted(uses):
        operation, operands = recorded[number]
        if operation == loops.FIT:
            rows = [row_of(operand) for operand in operands[1:]]
            steps.append((loops.FIT, row[number], rows[0], operands[0]))
        elif operation not in (loops.CONSTANT, loops.LOAD, loops.PART):
            rows = [row_of(operand) for operand in operands]
            steps.append((operation, row_of(number), rows[0], rows[-1]))
        taken = [*_operands(operation, operands)]
        for store in complete.get(number, ()):
            target[len(stored), : len(results[store])] = [row_of(k) for k in results[store]]
            steps.append((loops.STORE, len(stored), 0, 0))
            stored.append(store)
            taken += results[store]
        for operand in taken:  # after its last use its row is free
            uses[operand] -= 1
            if not uses[operand] and row[operand] >= kept:
                free.append(row[operand])
    scratch = np.zeros((next(fresh), loops.TILE))
    for number, value in constants.items():
        scratch[number] = value
    widths: dict[str, int] = {}
    for name, first, components in stored:
        widths[name] = max(widths.get(name, 0), first + components)
    names = list(widths)
    stores = np.array(
        [(names.index(name), first, components) for name, first, components in stored]
    )
    return Program(np.array(steps, "uint64"), scratch, tuple(inputs), target, widths, stores)


def _operands(operation: int, operands: tuple[Any, ...]) -> tuple[int, ...]:
    """Return the steps that a step takes something from."""
    if operation in (loops.CONSTANT, loops.LOAD):
        return ()
    return operands[1:] if operation in (loops.FIT, loops.PART) else operands
