"""Other ways to compute the same sums, each different from xcg's loops in one thing only: for docs/accuracy.py.

Weights from tables or in single precision are xcg's own loop compiled anew with another function in the place of the
one that computes weights. Ways to the kinetic moments are xcg's own loop, called with another reference velocity.
"""

from __future__ import annotations

import atexit
import ctypes
import inspect
import math
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from xcg.compiled.points import MASS, MOMENTUM, VELOCITY, deposit

jit = numba.njit(nogil=True, error_model="numpy")  # as in xcg, but for the cache on disk
IN_C = Path(__file__).parents[1] / "tests" / "benchmarks" / "multiply_add.c"
_ARGUMENTS = list(inspect.signature(deposit.py_func).parameters)

# --- weights ---------------------------------------------------------------------------------------------


@cache
def with_weights(fill: Callable[..., None]) -> Callable[..., None]:
    """Compile xcg's point deposit with another function that writes weights."""
    loop = deposit.py_func
    if "fill_values" not in loop.__code__.co_names:
        msg = "the point deposit no longer calls fill_values: say here what to put in its place"
        raise NotImplementedError(msg)
    return jit(
        FunctionType(loop.__code__, {**loop.__globals__, "fill_values": fill}, loop.__name__)
    )


def _lucy_table(bins: int) -> NDArray:
    """Lucy's profile at 0, 1, ... bins intervals of q, and zero beyond."""
    q = np.minimum(np.arange(bins + 2) / bins, 1.0)
    return (1 - q) ** 3 * (1 + 3 * q)


@jit
def _fill_floored(kind, table, norm, by_gradient, q2, count, out):
    scale = float(table.shape[2] - 2)
    for k in range(count):
        out[k] = norm * table[0, 0, int(math.sqrt(q2[k]) * scale)]


@jit
def _fill_interpolated(kind, table, norm, by_gradient, q2, count, out):
    scale = float(table.shape[2] - 2)
    for k in range(count):
        x = math.sqrt(q2[k]) * scale
        n = int(x)
        low = table[0, 0, n]
        out[k] = norm * (low + (x - n) * (table[0, 0, n + 1] - low))


_ONE = np.float32(1.0)
_THREE = np.float32(3.0)


@jit
def _fill_single(kind, table, norm, by_gradient, q2, count, out):
    factor = np.float32(norm)
    for k in range(count):
        q = np.sqrt(np.float32(q2[k]))
        p = _ONE - q
        out[k] = factor * (p * p * p * (_ONE + _THREE * q))


def floored_table(bins: int) -> Callable[..., None]:
    """Weights looked up at the distance rounded down to the table's next entry, as Pysammos does."""
    return _with_table(with_weights(_fill_floored), bins)


def interpolated_table(bins: int) -> Callable[..., None]:
    """Weights interpolated linearly between the table's entries."""
    return _with_table(with_weights(_fill_interpolated), bins)


def single_precision() -> Callable[..., None]:
    """Weights in single precision, sums in double."""
    return with_weights(_fill_single)


def _with_table(loop: Callable[..., None], bins: int) -> Callable[..., None]:
    table = _lucy_table(bins).reshape(1, 1, -1)
    return lambda *args: loop(*changed(args, kernel=_of(args, "kernel")._replace(table=table)))


# --- moments ---------------------------------------------------------------------------------------------


def changed(args: tuple[Any, ...], **new: Any) -> tuple[Any, ...]:
    """Arguments of the point deposit, some of them others."""
    return tuple(new.get(name, value) for name, value in zip(_ARGUMENTS, args, strict=True))


def _of(args: tuple[Any, ...], name: str) -> Any:
    return args[_ARGUMENTS.index(name)]


def raw_moments(*args: Any) -> None:
    """One pass over velocities as they are: sum m v v, of which rho V V is subtracted afterwards."""
    _of(args, "reference")[:] = 0.0
    deposit(*args)


def two_passes(*args: Any) -> None:
    """V = p / rho first, then the moments of v - V in a second pass."""
    reference = _of(args, "reference")
    moments = _of(args, "moments")
    reference[:] = 0.0
    first = np.zeros((*moments.shape[:2], VELOCITY))
    grains = _of(args, "grains")
    grains = grains._replace(constants=np.zeros((len(grains.mass), 0)))
    deposit(*changed(args, level=VELOCITY, grains=grains, moments=first))
    total = first.sum(axis=0)
    mass = total[:, [MASS]]
    momentum = total[:, MOMENTUM : MOMENTUM + 3]
    reference[:] = np.divide(momentum, mass, out=reference, where=mass > 0)
    deposit(*args)


# --- velocity at the grains ------------------------------------------------------------------------------


def velocity_at_grains(
    position: NDArray, velocity: NDArray, mass: NDArray, cutoff: float
) -> NDArray:
    """V(r_i) of every grain by Lucy's kernel: the field evaluated at the grains instead of at nodes (no periods)."""
    cell = ((position - position.min(axis=0)) / cutoff).astype(int)
    order = np.lexsort(cell.T[::-1])
    found = np.empty_like(velocity)
    found[order] = _velocity_at(position[order] / cutoff, velocity[order], mass[order])
    return found


@jit
def _velocity_at(position, velocity, mass):
    """Cells of one cutoff, 27 of them searched for each grain; grains come in the order of the cells, x slowest."""
    count = position.shape[0]
    lower = np.empty(3)
    cells = np.empty(3, np.int64)
    for k in range(3):
        lower[k] = position[:, k].min()
        cells[k] = int(position[:, k].max() - lower[k]) + 1
    cell = np.empty((count, 3), np.int64)
    start = np.zeros(cells[0] * cells[1] * cells[2] + 1, np.int64)
    for i in range(count):
        for k in range(3):
            cell[i, k] = int(position[i, k] - lower[k])
        start[(cell[i, 0] * cells[1] + cell[i, 1]) * cells[2] + cell[i, 2] + 1] += 1
    start = np.cumsum(start)
    out = np.empty((count, 3))
    for i in range(count):
        total, px, py, pz = 0.0, 0.0, 0.0, 0.0
        z0 = max(cell[i, 2] - 1, 0)
        z1 = min(cell[i, 2] + 2, cells[2])
        for ix in range(max(cell[i, 0] - 1, 0), min(cell[i, 0] + 2, cells[0])):
            for iy in range(max(cell[i, 1] - 1, 0), min(cell[i, 1] + 2, cells[1])):
                row = (ix * cells[1] + iy) * cells[2]
                for j in range(start[row + z0], start[row + z1]):
                    x = position[i, 0] - position[j, 0]
                    y = position[i, 1] - position[j, 1]
                    z = position[i, 2] - position[j, 2]
                    q2 = x * x + y * y + z * z
                    if q2 < 1.0:
                        q = math.sqrt(q2)
                        p = 1.0 - q
                        w = mass[j] * p * p * p * (1.0 + 3.0 * q)
                        total += w
                        px += w * (velocity[j, 0] - velocity[i, 0])
                        py += w * (velocity[j, 1] - velocity[i, 1])
                        pz += w * (velocity[j, 2] - velocity[i, 2])
        out[i, 0] = velocity[i, 0] + px / total
        out[i, 1] = velocity[i, 1] + py / total
        out[i, 2] = velocity[i, 2] + pz / total
    return out


# --- how fast it could be --------------------------------------------------------------------------------


@jit
def multiply_add(sums, weights, factors):
    """Bare multiply-adds: ``sums += weight x factor`` over a run of consecutive numbers for each item.

    Each item adds to as many numbers as it has nodes times columns, without finding nodes or weights; items go
    through memory in order, as grains sorted in space do.
    """
    size = weights.size
    items = factors.size
    room = sums.size - size
    for i in range(items):
        first = int(room * (i / items))
        for k in range(size):
            sums[first + k] += weights[k] * factors[i]


@cache
def multiply_add_in_c() -> Callable[[NDArray, NDArray, NDArray], None] | None:
    """The same loop in C, by the compiler of the machine; None where it has none."""
    compiler = shutil.which("cc")
    if compiler is None:
        return None
    folder = tempfile.mkdtemp()
    atexit.register(shutil.rmtree, folder)
    library = f"{folder}/multiply_add.so"
    flags = ["-O3", "-march=native", "-shared", "-fPIC"]
    subprocess.run([compiler, *flags, str(IN_C), "-o", library], check=True)
    compiled = ctypes.CDLL(library).multiply_add
    compiled.argtypes = [*[np.ctypeslib.ndpointer(float)] * 3, *[ctypes.c_long] * 3]
    compiled.restype = None

    def run(sums: NDArray, weights: NDArray, factors: NDArray) -> None:
        compiled(sums, weights, factors, sums.size - weights.size, weights.size, factors.size)

    return run
