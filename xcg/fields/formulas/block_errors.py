"""Standard errors and biases of means over consecutive samples, which may be correlated, from blocks of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
import xarray as xr

# Blocks fewer than this tell too little of their own scatter.
MIN_BLOCKS = 16
MIN_BIAS_BLOCKS = 8
ROUNDING = 1e-6  # of the largest value


def block_errors(
    samples: xr.Dataset, dim: str, function: Callable[[xr.Dataset], xr.Dataset]
) -> xr.Dataset:
    """Return standard errors of a function of the mean over consecutive samples, which may be correlated.

    They come from the first size of blocks beyond which they do not grow, see `time_average`.
    """
    return jackknife(samples, dim, function).errors


class Jackknife(NamedTuple):
    """Errors and biases of a function of the mean over blocks, and whether they hold."""

    errors: xr.Dataset
    biases: xr.Dataset
    drifts: xr.Dataset | None
    """Slope over the blocks divided by its error; None below 8 samples."""
    growths: xr.Dataset | None
    """Error of the blocks beyond the largest over theirs, 1 at a plateau; None below 16 samples."""
    number: int
    """Blocks of drifts and growths."""


def jackknife(
    samples: xr.Dataset,
    dim: str,
    function: Callable[[xr.Dataset], xr.Dataset],
    *,
    norms: Iterable[str] = (),
    independent: bool = False,
) -> Jackknife:
    """Return standard errors and biases of a function of the mean over consecutive samples.

    Both come from the blocks of `block_errors`, of independent samples from the samples themselves;
    the bias is ``(n - 1) (<f of all but one> - f)`` of n blocks (Quenouille 1956). Of `norms` that of
    the square is taken, which is the variance of the mean to all orders: where noise is as large as
    the norm, the bias of the norm itself is right to first order only. From 8 correlated samples on
    the last 8 to 15 blocks show drift and growth.
    """
    levels: list[xr.Dataset] = []
    biases: list[xr.Dataset] = []
    doubt = []  # relative scatter of each level's error
    drifts = None
    growths = None
    while (count := samples.sizes[dim]) >= 2 and (not levels or count >= MIN_BLOCKS):
        # jackknife: for sums the scatter over sqrt(n), for functions of sums right to first order
        mean = samples.mean(dim, skipna=False)
        of_others = function((count * mean - samples) / (count - 1))
        of_mean = function(mean)
        levels.append(_jackknife_error(of_others, dim))
        biases.append(_jackknife_bias(of_others, of_mean, dim, norms))
        doubt.append(1 / np.sqrt(2 * (count - 1)))
        if independent:
            return Jackknife(levels[0], biases[0], None, None, 0)
        samples = samples.coarsen({dim: 2}, boundary="trim").mean()
    if not levels:
        unknown = function(samples.mean(dim)) * np.nan
        return Jackknife(unknown, unknown, None, None, 0)
    errors = levels[-1]
    bias = biases[-1]
    has_plateau = xr.zeros_like(errors, dtype=bool)
    for k in reversed(range(len(levels) - 1)):
        flat = levels[k + 1] * (1 - doubt[k + 1]) <= levels[k]
        for m in range(k + 2, len(levels)):
            flat = flat & (levels[m] * (1 - doubt[m]) <= levels[k])
        errors = xr.where(flat, levels[k], errors)
        bias = xr.where(flat, biases[k], bias)
        has_plateau = has_plateau | flat
    if count >= MIN_BIAS_BLOCKS:  # of longer blocks than any error is from
        mean = samples.mean(dim, skipna=False)
        of_others = function((count * mean - samples) / (count - 1))
        next_error = _jackknife_error(of_others, dim)
        growths = (next_error / levels[-1].where(levels[-1] > 0)).where(~has_plateau, 1.0)
        # errors of rounding have no plateau
        growths = growths.where(~(next_error <= ROUNDING * abs(of_mean).max()), 1.0)
    elif of_others.sizes[dim] >= MIN_BIAS_BLOCKS:
        count = of_others.sizes[dim]
    if count >= MIN_BIAS_BLOCKS:
        drifts = _drift(of_others, of_mean, dim)
    return Jackknife(errors, bias, drifts, growths, count)


def _jackknife_error(of_others: xr.Dataset, dim: str) -> xr.Dataset:
    """Return the standard error of a function from its values without each block."""
    return of_others.std(dim, ddof=0, skipna=False) * np.sqrt(of_others.sizes[dim] - 1)


def _jackknife_bias(
    of_others: xr.Dataset, of_mean: xr.Dataset, dim: str, norms: Iterable[str]
) -> xr.Dataset:
    """Return the bias of a function from its values without each block; of norms from that of their squares."""
    count = of_others.sizes[dim]
    deviation = of_others - of_mean
    bias = (count - 1) * deviation.mean(dim, skipna=False)
    of_norms = {}
    for name in norms:
        norm = of_mean[name]
        # o^2 - f^2 without its cancellation
        of_square = (deviation[name] * (of_others[name] + norm)).mean(dim, skipna=False)
        of_norms[name] = norm - (norm**2 - (count - 1) * of_square).clip(0.0) ** 0.5
    return bias.assign(of_norms)


def _drift(of_others: xr.Dataset, of_mean: xr.Dataset, dim: str) -> xr.Dataset:
    """Return the slope of the least-squares line over the blocks, divided by its error; 0 where it is rounding."""
    count = of_others.sizes[dim]
    x = xr.DataArray(np.arange(count) - (count - 1) / 2, dims=dim)
    squares = float((x**2).sum())
    deviation = of_others.mean(dim, skipna=False) - of_others  # of a block, over count - 1
    slope = (deviation * x).sum(dim, skipna=False) / squares
    rest = (deviation**2).sum(dim, skipna=False) - slope**2 * squares
    error = (rest.clip(0.0) / (count - 2) / squares) ** 0.5
    change = abs(slope) * count * (count - 1)
    is_rounding = change <= ROUNDING * abs(of_mean).max()
    return xr.where(is_rounding, 0.0, slope / error.where(error > 0, np.finfo(float).tiny))
