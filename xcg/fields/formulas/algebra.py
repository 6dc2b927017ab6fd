"""Functions of formulas: of arrays of numbers, or of symbols that write down the instructions for numbers.

A symbol is a number at a node that is not known yet. Formulas run on arrays of either kind, element
for element the same; a program of instructions is traced by running them once on symbols. Operations that
symbols lack raise UnknownOperation; such formulas are left to NumPy.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from functools import partialmethod, reduce
from itertools import product
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from xcg.compiled import program as loops
from xcg.compiled.gradient_fit import FOUND, flags_of


class UnknownOperation(NotImplementedError, TypeError):
    """A formula takes an operation that only numbers know."""


@dataclass(eq=False)
class Trace:
    """The instructions that were written down, each once however often it was asked for."""

    instructions: list[tuple[int, tuple[Hashable, ...]]] = field(default_factory=list)
    _number: dict[tuple[int, tuple[Hashable, ...]], int] = field(default_factory=dict)

    def add(self, operation: int, *operands: Hashable) -> Symbol:
        """Write down an instruction, of which the operands are numbers of earlier ones."""
        instruction = operation, operands
        if instruction not in self._number:
            self._number[instruction] = len(self.instructions)
            self.instructions.append(instruction)
        return Symbol(self, self._number[instruction])

    def of(self, value: Any) -> Symbol:
        """Return a symbol for a value that may be a number."""
        return value if isinstance(value, Symbol) else self.add(loops.CONSTANT, float(value))

    def load(
        self, name: str, columns: NDArray, groups: int = 0, *, paired: bool = False
    ) -> NDArray:
        """Return symbols (phase, 1, ...) for a moment at one node: of the bulk, the sum over groups, and of each group.

        It is made of these columns, in sums of each group, or of each pair of a group with another
        or with walls.
        """
        shape = [max(1, groups)]
        if groups and paired:
            shape.append(groups + 1)
        keys = product(range(math.prod(shape)), columns.ravel().tolist())
        loads = [self.add(loops.LOAD, name, group, column) for group, column in keys]
        phases = as_symbols(np.array(loads, object).reshape(*shape, *columns.shape))
        if groups:
            phases = np.stack([reduce(operator.add, phases), *phases])
        return phases[:, None]


@dataclass(eq=False, slots=True)
class Symbol:
    """The result of an instruction; arithmetic with it makes further ones."""

    record: Trace
    number: int

    def _with(self, operation: int, other: Any, *, reflected: bool = False) -> Symbol:
        numbers = [self.number, self.record.of(other).number]
        if reflected:
            numbers.reverse()
        if operation in (loops.ADD, loops.MULTIPLY):
            numbers.sort()  # the order of two does not matter, to the last bit
        return self.record.add(operation, *numbers)

    __add__ = __radd__ = partialmethod(_with, loops.ADD)
    __mul__ = __rmul__ = partialmethod(_with, loops.MULTIPLY)
    __sub__ = partialmethod(_with, loops.SUBTRACT)
    __rsub__ = partialmethod(_with, loops.SUBTRACT, reflected=True)
    __truediv__ = partialmethod(_with, loops.DIVIDE)
    __rtruediv__ = partialmethod(_with, loops.DIVIDE, reflected=True)

    def __neg__(self) -> Symbol:
        return self * -1.0

    def __pow__(self, exponent: int) -> Symbol:
        if exponent != 2:
            raise UnknownOperation(f"power {exponent}: only squares are known")
        return self * self

    def _no_value(self, *others: Any) -> NoReturn:
        raise UnknownOperation(
            "the value of a symbol is not known while instructions are written down"
        )

    __bool__ = __float__ = __int__ = __index__ = _no_value
    __eq__ = __ne__ = __lt__ = __le__ = __gt__ = __ge__ = _no_value
    __hash__ = None  # type: ignore[assignment]

    def sqrt(self) -> Symbol:
        """Return the square root; `np.sqrt` of an array of symbols calls it."""
        return self.record.add(loops.SQUARE_ROOT, self.number)


# What gives the same bits on symbols as on numbers: arithmetic element by element, and putting
# elements elsewhere. Sums over axes are not among it, as NumPy adds numbers in another order than
# symbols.
_ARITHMETIC = {
    np.add,
    np.subtract,
    np.multiply,
    np.divide,
    np.negative,
    np.square,
    np.sqrt,
    np.power,
}
_PLACEMENT = {
    np.array_split, np.broadcast_to, np.concatenate, np.copy, np.diagonal, np.expand_dims, np.flip, np.moveaxis,
    np.ravel, np.reshape, np.split, np.squeeze, np.stack, np.swapaxes, np.take, np.transpose, np.where,
}  # fmt: skip


class Symbols(np.ndarray):
    """An array of symbols."""

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        if method != "__call__" or ufunc not in _ARITHMETIC or options.keys() - {"out"}:
            raise UnknownOperation(
                f"{ufunc.__name__}: only {', '.join(sorted(known.__name__ for known in _ARITHMETIC))} are known"
            )
        if "out" in options:
            options["out"] = tuple(map(np.asarray, options["out"]))
        return as_symbols(ufunc(*map(np.asarray, inputs), **options))

    def __array_function__(self, function: Any, types: Any, args: Any, options: Any) -> Any:
        if function not in _PLACEMENT:
            raise UnknownOperation(f"{function.__name__} is not known")
        return as_symbols(super().__array_function__(function, types, args, options))


def as_symbols(value: Any) -> Any:
    """Return an array of symbols as `Symbols`, anything else as it is."""
    if isinstance(value, np.ndarray) and value.dtype == object:
        return value.view(Symbols)
    return value


def _each(array: NDArray, operation: int) -> NDArray:
    roots = [symbol.record.add(operation, symbol.number) for symbol in array.ravel()]
    return as_symbols(np.array(roots, object).reshape(array.shape))


def trace_fit(sums: NDArray, *, active: Sequence[bool], about_node: bool) -> NDArray:
    """As `xcg.compiled.gradient_fit.fit_gradient`, for symbols."""
    record = sums[0, 0].record
    flags = flags_of(active, about_node)
    operands = [[symbol.number for symbol in column] for column in sums.T]
    fits = [record.add(loops.FIT, flags, *numbers) for numbers in operands]
    parts = [[record.add(loops.PART, k, fit.number) for fit in fits] for k in range(FOUND)]
    return as_symbols(np.array(parts, object))


# --- functions of arrays of either kind ------------------------------------------------------------------


def where_positive(x: NDArray) -> NDArray:
    """Return x where it is positive, NaN elsewhere."""
    return _each(x, loops.WHERE_POSITIVE) if x.dtype == object else np.where(x > 0, x, np.nan)


def at_least_zero(x: NDArray) -> NDArray:
    """Return the larger of x and 0; NaN stays NaN."""
    return _each(x, loops.AT_LEAST_ZERO) if x.dtype == object else np.maximum(x, 0.0)


def zero_if_unknown(x: NDArray) -> NDArray:
    """Return x, 0 where it is NaN."""
    return _each(x, loops.ZERO_IF_UNKNOWN) if x.dtype == object else np.where(np.isnan(x), 0.0, x)


def _like(b: NDArray, a: NDArray) -> NDArray:
    """Return b with the last axes of a that it lacks, of one element."""
    return b.reshape(b.shape + (1,) * (a.ndim - b.ndim))


def ratio(a: NDArray, b: NDArray) -> NDArray:
    """Return a / b with NaN where b is not positive; b lacks the last axes of a."""
    return a / _like(where_positive(b), a)


def mean_of(sums: NDArray, weights: NDArray) -> NDArray:
    """Return the mean of what grains have, from sums over them; NaN where both are zero, as where nothing reaches.

    Weights are below zero where parts of the kernel are. The mean that belongs to them is p / rho
    there, too: what is about it, such as the kinetic stress, is then what the balances ask for.
    """
    return sums / _like(weights, sums)


def absolute(x: NDArray) -> NDArray:
    """Return |x|; NaN stays NaN."""
    return at_least_zero(x) + at_least_zero(-x)


def outer(a: NDArray, b: NDArray) -> NDArray:
    """Return a_i b_j."""
    return a[..., :, None] * b[..., None, :]


def trace(tensor: NDArray, axes: Sequence[int]) -> NDArray:
    """Trace over some axes."""
    return sum((tensor[..., k, k] for k in axes), start=np.zeros(tensor.shape[:-2]))


def mean_normal(tensor: NDArray, axes: Sequence[int]) -> NDArray:
    """Return the mean of the normal components along some axes."""
    return trace(tensor, axes) / len(axes)


def restricted(tensor: NDArray, axes: Sequence[int] | None) -> NDArray:
    """Return the components between some axes, the others set to zero; the whole tensor for None."""
    if axes is None:
        return tensor
    inside = np.isin(np.arange(3), axes)
    return np.where(inside[:, None] & inside, tensor, 0.0)


def deviator(tensor: NDArray, axes: Sequence[int]) -> NDArray:
    """Return X - tr(X) / D I, with trace, D and I restricted to some axes."""
    out = tensor.copy(order="K")
    mean = mean_normal(tensor, axes)
    for k in axes:
        out[..., k, k] -= mean
    return out


def stress_magnitude(tensor: NDArray) -> NDArray:
    """Return sqrt(X:X / 2)."""
    return np.sqrt(contraction(tensor) / 2)


def rate_magnitude(tensor: NDArray) -> NDArray:
    """Return sqrt(2 X:X), the shear rate in simple shear."""
    return np.sqrt(2 * contraction(tensor))


def contraction(tensor: NDArray) -> NDArray:
    """Return X:X over all components."""
    return double_dot(tensor, tensor)


def times(a: NDArray, b: NDArray) -> NDArray:
    """Return a_ik b_kj, term by term: see `double_dot`."""
    first, second, third = (a[..., :, k, None] * b[..., None, k, :] for k in range(3))
    return first + second + third


def transposed(tensor: NDArray) -> NDArray:
    """Return X_ji."""
    return np.swapaxes(tensor, -1, -2)


def dot(a: NDArray, b: NDArray) -> NDArray:
    """Return a_k b_k."""
    return sum((a[..., k] * b[..., k] for k in range(3)), start=np.zeros(b.shape[:-1]))


def double_dot(a: NDArray, b: NDArray) -> NDArray:
    """Return a_ij b_ij."""
    # term by term: the order in which numpy sums over axes depends on the number of nodes, and with
    # it the last bit
    return sum(
        (a[..., i, j] * b[..., i, j] for i in range(3) for j in range(3)),
        start=np.zeros(b.shape[:-2]),
    )
