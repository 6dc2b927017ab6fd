"""Algebra of vectors and tensors at nodes: arrays (phase, node, ...), of numbers or of symbols."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from xcg.fields.formulas.trace import at_least_zero, where_positive


def ratio(a: NDArray, b: NDArray) -> NDArray:
    """Return a / b with NaN where b is not positive; b lacks the last axes of a."""
    return a / where_positive(b).reshape(b.shape + (1,) * (a.ndim - b.ndim))


def mean_of(sums: NDArray, weights: NDArray) -> NDArray:
    """Return the mean of what grains have, from sums over them; NaN where both are zero, as where nothing reaches.

    Weights are below zero where parts of the kernel are. The mean that belongs to them is p / rho there, too: what is
    about it, such as the kinetic stress, is then what the balances ask for.
    """
    return sums / weights.reshape(weights.shape + (1,) * (sums.ndim - weights.ndim))


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
    """Return X - tr(X) / D I, with trace, D and I those of some axes."""
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
    # term by term: the order in which numpy sums over axes depends on the number of nodes, and with it the last bit
    return sum((tensor[..., i, j] ** 2 for i in range(3) for j in range(3)), start=np.zeros(tensor.shape[:-2]))


def times(a: NDArray, b: NDArray) -> NDArray:
    """Return a_ik b_kj, term by term: see `contraction`."""
    first, second, third = (a[..., :, k, None] * b[..., None, k, :] for k in range(3))
    return first + second + third


def transposed(tensor: NDArray) -> NDArray:
    """Return X_ji."""
    return np.swapaxes(tensor, -1, -2)


def dot(a: NDArray, b: NDArray) -> NDArray:
    """Return a_k b_k."""
    return sum((a[..., k] * b[..., k] for k in range(3)), start=np.zeros(b.shape[:-1]))


def double_dot(a: NDArray, b: NDArray) -> NDArray:
    """Return a_ij b_ij, term by term: see `contraction`."""
    return sum((a[..., i, j] * b[..., i, j] for i in range(3) for j in range(3)), start=np.zeros(b.shape[:-2]))
