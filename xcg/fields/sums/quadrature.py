"""Which quadrature keeps the promise `rtol`, and which is the quickest that does."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from xcg.compiled import smoothing as kinds
from xcg.compiled.lines import largest_error
from xcg.compiled.segments import RULES
from xcg.compiled.shells import RADIUS
from xcg.fields.sums.kernels import Kernel

# From this promise on, weights are computed in single precision, which rounds them to 1e-6 of the largest.
SINGLE = 1e-4


def _quicker(kind: int | None, spread: float | None, table: NDArray | None, rtol: float) -> tuple[int, ...]:
    """Gauss-Legendre rules that take less time than the closed form, by the kernel as it is seen, and the precision."""
    if kind is kinds.LUCY_FULL:
        return RULES if rtol >= SINGLE else RULES[:2]
    if spread is kinds.TABULATED and table is not None:
        # closed forms of one or two shells take less time than two points, of three less than four; not so in planes
        shells = np.count_nonzero(table[kinds.SHELLS, RADIUS])
        return RULES if kind == kinds.TABLE + 1 or shells == 0 else RULES[: 0 if shells <= 2 else 1]
    return RULES[:1]  # marginals take more time a point than a polynomial


@lru_cache(maxsize=64)
def _limits(
    kind: int | None, spread: float | None, table: bytes | None, table_shape: tuple[int, ...], seen: int, rtol: float
) -> NDArray:
    """Longest branch (cutoffs) for which each rule keeps to `rtol`, measured against the closed form.

    The error of a rule depends on nothing but the branch length over the cutoff and the place of the node, so that
    a scan over both bounds it for every scene. A twentieth is kept in hand for places between those scanned.
    """
    array = None if table is None else np.frombuffer(table).reshape(table_shape).copy()
    rows = 1 if seen == 1 else 24

    def kept(length: float, order: int) -> bool:
        return largest_error(length, order, rows, kind, spread, array) <= 0.95 * rtol

    limits, limit = [], 0.0
    for order in _quicker(kind, spread, array, rtol):
        for length in np.geomspace(1e-3, 8, 61):
            if length <= limit or kept(length, order):  # shorter ones are left to the order before
                limit = max(limit, length)
                continue
            for _ in range(4):  # and now between the last that keeps it and the first that does not
                middle = 0.5 * (limit + length)
                limit, length = (middle, length) if kept(middle, order) else (limit, middle)
            break
        limits.append(limit)
    return np.array(limits)


def gauss_limits(kernel: Kernel, seen: int, rtol: float) -> NDArray:
    """Longest branch (cutoffs) for which 2, 4, ... Gauss-Legendre points keep the promise `rtol`.

    The promise is ``|S_quadrature - S| <= rtol max S`` for every segment, the maximum taken over all places. Kernels
    that jump have no such bound and always take the closed form (an empty array), as does ``rtol=0``.
    """
    if rtol == 0 or kernel.smoothness < 0 or seen == 0:
        return np.zeros(0)
    w = kernel.weights(seen)
    if w.table is None:
        return _limits(w.kind, w.spread, None, (), seen, rtol)
    return _limits(w.kind, w.spread, w.table.tobytes(), w.table.shape, seen, rtol)
