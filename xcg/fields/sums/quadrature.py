"""Gauss-Legendre rules for segments of contacts that keep the promise rtol."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from xcg.compiled import smoothing as kinds
from xcg.compiled.lines import largest_error
from xcg.compiled.polynomials import RADIUS
from xcg.compiled.segments import RULES
from xcg.compiled.smoothing import PLAIN
from xcg.fields.sums.kernel_tables import Profile, table_of
from xcg.fields.sums.kernels import Kernel

# From this promise on, weights are computed in single precision, which rounds them to 1e-6 of the
# largest.
SINGLE = 1e-4


def _quicker(kind: int | None, table: NDArray | None, rtol: float) -> tuple[int, ...]:
    """Gauss-Legendre rules that take less time than the closed form, by the kernel as it is seen, and the precision."""
    if kind is kinds.LUCY_FULL:
        if rtol >= SINGLE:
            return RULES
        return RULES[:2]
    if table is not None:
        shells = np.count_nonzero(table[kinds.SHELLS, RADIUS])
        if kind == kinds.TABLE + 1 or shells == 0:
            return RULES
        # closed forms of one or two shells take less time than two points, of three less than four
        return RULES[: int(shells > 2)]
    return ()  # marginals take more time a point


@lru_cache(maxsize=64)
def _limits(
    kind: int | None, profile: Profile | None, codimension: int, seen: int, rtol: float
) -> NDArray:
    """Longest branch (cutoffs) for which each rule keeps to `rtol`, measured against the closed form.

    The error of a rule depends on nothing but the branch length over the cutoff and the position of
    the node, so that a scan over both bounds it for every scene. A twentieth is kept in hand for
    positions between those scanned.
    """
    table = PLAIN
    if profile is not None:
        table = table_of(profile, codimension)
    rows = 24
    if seen == 1:
        rows = 1

    def kept(length: float, order: int) -> bool:
        return largest_error(length, order, rows, kind, table) <= 0.95 * rtol

    limits = []
    limit = 0.0
    for order in _quicker(kind, table, rtol):
        for length in np.geomspace(1e-3, 8, 61):
            if length <= limit or kept(length, order):  # shorter ones are left to the order before
                limit = max(limit, length)
                continue
            for _ in range(4):  # and now between the last that keeps it and the first that does not
                middle = 0.5 * (limit + length)
                if kept(middle, order):
                    limit = middle
                else:
                    length = middle
            break
        limits.append(limit)
    return np.array(limits)


def gauss_limits(kernel: Kernel, seen: int, rtol: float) -> NDArray:
    """Longest branch (cutoffs) for which 2, 4, ... Gauss-Legendre points keep the promise `rtol`.

    The promise is ``|S_quadrature - S| <= rtol max S`` for every segment, the maximum taken over
    all positions. Kernels that jump have no such bound and always take the closed form (an empty
    array), as does ``rtol=0``.
    """
    if rtol == 0 or kernel.smoothness < 0 or seen == 0:
        return np.zeros(0)
    codimension = (kernel.dimension or 3) - seen
    return _limits(kernel.weights(seen).kind, kernel.profile, codimension, seen, rtol)
