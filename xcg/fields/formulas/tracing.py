"""Tracing of formulas: their instructions, written down once on symbols, as a program.

Results of instructions are held in registers, rows of the numbers that the loop works on.
"""

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
from xcg.fields.formulas import registry
from xcg.fields.formulas.algebra import Trace, as_symbols, zero_if_unknown
from xcg.fields.formulas.field import Options


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
    definitions = registry.fields_of(fields, options)
    moments = {
        name: record.load(name, moment.columns, groups, paired=moment.paired)
        for name, moment in registry.moments_of(definitions.values(), options).items()
    }
    moments["reference"] = zero_if_unknown(record.load("reference", np.arange(3))[0, 0])
    sums = SimpleNamespace(**moments)
    traced: dict[str, Any] = {}
    for name, field in definitions.items():
        if traced.keys() >= set(field.fields):
            try:
                traced[name] = as_symbols(field.compute(SimpleNamespace(**traced), sums, options))
            except Exception:  # numbers may do; if not, they give an error that says why
                continue
    results = {}
    for name in fields:
        if name not in traced:
            continue
        components = list(traced[name].flat)
        together = 3 ** definitions[name].rank
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
    """Assign results of instructions to registers, which are reused once nothing needs them.

    `results` holds the instructions that lead to the components of each store. What is stored
    together is stored as soon as it is there.
    """
    uses = _uses(recorded, results)
    register, constants, kept = _fixed_registers(recorded, sorted(uses))
    free: list[int] = []
    fresh = count(kept)
    instructions: list[tuple[int, int, int, int]] = []
    inputs: list[tuple[str, int, int]] = []
    stored: list[tuple[str, int, int]] = []
    target = np.zeros((len(results), 9), "uint64")

    def register_of(number: int) -> int:
        """Return the register of a result; a column is loaded when it is first needed."""
        operation, operands = recorded[number]
        if number not in register:
            register[number] = free.pop() if free else next(fresh)
        if operation == loops.LOAD and operands not in inputs:
            instructions.append((loops.LOAD, register[number], len(inputs), 0))
            inputs.append((operands[0], operands[1], operands[2]))
        return register[number]

    complete: dict[int, list[tuple[str, int, int]]] = {}
    for store, numbers in results.items():
        complete.setdefault(max(numbers), []).append(store)
    for number in sorted(uses):
        operation, operands = recorded[number]
        if operation == loops.FIT:
            taken_by_fit = [register_of(operand) for operand in operands[1:]]
            instructions.append((loops.FIT, register[number], taken_by_fit[0], operands[0]))
        elif operation not in (loops.CONSTANT, loops.LOAD, loops.PART):
            inputs_of = [register_of(operand) for operand in operands]
            instructions.append((operation, register_of(number), inputs_of[0], inputs_of[-1]))
        taken = list(_operands(operation, operands))
        for store in complete.get(number, ()):
            target[len(stored), : len(results[store])] = [register_of(k) for k in results[store]]
            instructions.append((loops.STORE, len(stored), 0, 0))
            stored.append(store)
            taken += results[store]
        for operand in taken:  # after its last use its register is free
            uses[operand] -= 1
            if not uses[operand] and register[operand] >= kept:
                free.append(register[operand])
    scratch = np.zeros((next(fresh), loops.TILE))
    for number, value in constants.items():
        scratch[number] = value
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


def _fixed_registers(
    recorded: Sequence[tuple[int, tuple[Any, ...]]], numbers: Iterable[int]
) -> tuple[dict[int, int], dict[int, float], int]:
    """Return the registers that are never reused, the constants by register, and the next register.

    Constants have such registers, and inputs and results of a fit, side by side.
    """
    register: dict[int, int] = {}
    constants: dict[int, float] = {}
    kept = 0
    for number in numbers:
        operation, operands = recorded[number]
        if operation == loops.CONSTANT:
            register[number] = kept
            constants[kept] = operands[0]
            kept += 1
        elif operation == loops.FIT:
            for operand in operands[1:]:
                register[operand] = kept
                kept += 1
            register[number] = kept
            kept += FOUND
        elif operation == loops.PART:
            register[number] = register[operands[1]] + operands[0]
    return register, constants, kept


def _table_of_stores(
    stored: Sequence[tuple[str, int, int]],
) -> tuple[dict[str, int], NDArray]:
    """Return how many numbers of each field a node holds, and the stores by field's number."""
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
