"""Warnings about averages: series that are not steady, means of few steps, temperatures and norms of few grains."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, TypeVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.messages import Once, active_call, warn_once
from xcg.fields.formulas import registry
from xcg.fields.formulas.block_errors import MIN_BIAS_BLOCKS, MIN_BLOCKS, ROUNDING, Jackknife
from xcg.fields.formulas.field import Field, Options
from xcg.fields.formulas.floors import CONSIDERABLE_FLOOR

CHANCE = 0.0027  # of more than three standard errors
SHARES = ("share_with_drift", "share_without_plateau")  # attributes of errors
NOT_NODES = ("component", "direction", "phase", "other_phase")
# Of fewer steps two errors hold less than 87 % (Student's t with one degree of freedom less).
_FEW = 5.0
# Share of the nodes without a temperature above which the others are too large on average: of
# normal values so many are negative where the error is as large as the mean.
UNKNOWN = 0.16
_REPEATED = 0.4  # share of the steps; of steps that are written twice it is a half


class Steadiness:
    """Checks of the errors of one average: no repeated steps, no trend, a plateau, weight in many steps."""

    def __init__(
        self,
        blocks: Jackknife,
        weights: Mapping[str, str],
        samples: xr.Dataset,
        dim: str,
        call: Once,
    ) -> None:
        self.blocks = blocks
        self.repeated = _share_of_repeats(samples, dim)
        self.weights = weights  # of each field that is checked, "" of sums
        self.steps = samples.sizes[dim]
        self.dim = dim
        self.call = call
        tests = 0
        for name in weights:
            sizes = blocks.errors[name].sizes
            tests += math.prod(sizes[dim] for dim in NOT_NODES if dim in sizes)
        self.chance = CHANCE / max(tests, 1)

    def checked(
        self,
        name: str,
        error: xr.Variable,
        weight: xr.DataArray | None,
        unsure: xr.Variable | None = None,
    ) -> xr.Variable:
        """Return an error with the shares of nodes that drift or have no plateau; lazy ones warn when computed.

        `weight` is the weight of each sample in the mean; None unless the field is a ratio of two sums. Nodes that
        are `unsure` are left out, as the sign of their blocks changes.
        """
        zero = xr.zeros_like(self.repeated)
        drift, growth, few, effective = zero, zero, zero, zero
        if self.blocks.drifts is not None:
            drift, growth_if_known = self._shares(name, unsure)
            if error.chunks is None:
                error.attrs[SHARES[0]] = float(drift)
                if growth_if_known is not None:
                    error.attrs[SHARES[1]] = float(growth_if_known)
            if growth_if_known is not None:
                growth = growth_if_known
            if weight is not None:
                few, effective = _effective(weight, self.dim)
        shares = [self.repeated, drift, growth, few, effective]

        # without the blocks: their graph would be pickled for each name
        sharing = [other for other, weight in self.weights.items() if weight == self.weights[name]]
        warn = partial(_warn, self.call, name, sharing, self.steps, self.blocks.number)
        return _with_warning(error, warn, *(share.variable for share in shares))

    def _shares(
        self, name: str, unsure: xr.Variable | None
    ) -> tuple[xr.DataArray, xr.DataArray | None]:
        """Return the shares of nodes with a drift and, without it, with an error that still grows."""
        from scipy.special import betainc  # slow to import

        assert self.blocks.drifts is not None
        count = self.blocks.number
        sure: Any = True
        if unsure is not None:
            sure = ~xr.DataArray(unsure)
        t = self.blocks.drifts[name].where(sure)
        # the two-sided t test
        unexplained = (count - 2) / (count - 2 + t**2)
        of_drift = _by_elements(betainc, count / 2 - 1, 0.5, unexplained)
        drifts = of_drift < self.chance
        share_of_drifts = _share(drifts, t.notnull())
        if self.blocks.growths is None:
            return share_of_drifts, None
        # the variance of n long blocks is one of 2 n - 1 squares of their halves, in steady series
        growth = self.blocks.growths[name].where(sure)
        of_long = (growth**2 * (count - 1) / (2 * count - 1)).clip(0.0, 1.0)
        of_growth = _by_elements(betainc, count / 2, (count - 1) / 2, 1.0 - of_long)
        grows = (of_growth < self.chance) & ~drifts
        return share_of_drifts, _share(grows, growth.notnull())


Values = TypeVar("Values", xr.DataArray, xr.Variable)


def _with_warning(values: Values, warn: Callable[..., None], *numbers: Any) -> Values:
    """Return values that warn when they are computed; `warn` takes the numbers as floats."""
    return xr.apply_ufunc(
        partial(_warned, warn),
        values,
        *numbers,
        dask="parallelized",
        output_dtypes=[float],
        keep_attrs="override",
    )


def _warned(warn: Callable[..., None], values: NDArray, *numbers: NDArray) -> NDArray:
    """Warn, and return the values; no closure, to which dask would give another name in each call."""
    warn(*(float(np.max(number)) for number in numbers))
    return values


def _share(mask: xr.DataArray, finite: xr.DataArray) -> xr.DataArray:
    """Return the share of nodes in a mask, of the component and phase with the largest."""
    nodes = [dim for dim in mask.dims if dim not in NOT_NODES]
    count = finite.sum(nodes)
    return ((mask & finite).sum(nodes) / count.where(count > 0, 1)).max()


def _share_of_repeats(samples: xr.Dataset, dim: str) -> xr.DataArray:
    """Return the share of samples that repeat all sums of the one before; 0 where no sum changes, as at rest."""
    if samples.sizes[dim] < 2:
        return xr.DataArray(0.0)
    repeats: Any = True
    changes: Any = False
    for values in samples.data_vars.values():
        sums = values.variable.fillna(0)
        equal = sums.isel({dim: slice(None, -1)}) == sums.isel({dim: slice(1, None)})
        repeats = repeats & equal.all([other for other in equal.dims if other not in (dim, "time")])
        if repeats.chunks is None and not repeats.any():  # the other sums need no look
            return xr.DataArray(0.0)
        rounding = ROUNDING * abs(sums).max()
        changes = changes | (sums.max(dim) - sums.min(dim) > rounding).any()
    return xr.DataArray((repeats & changes).mean())


def _effective(weight: xr.DataArray, dim: str) -> tuple[xr.DataArray, xr.DataArray]:
    """Return the share of nodes where few steps have the weight of a mean, and the effective number of steps there."""
    squares = (weight**2).sum(dim)
    finite = squares > 0
    number = weight.sum(dim) ** 2 / squares.where(finite)
    few = number < _FEW
    return _share(few, finite), number.where(few).mean()


def _warn(
    call: Once, name: str, sharing: Sequence[str], steps: int, blocks: int, *shares: float
) -> None:
    """Warn of repeated steps, and of most nodes with a drift, no plateau or few steps."""
    repeated, drift, growth, few, effective = shares
    different = 1 + (1 - repeated) * (steps - 1)
    times = round(steps / different)
    # blocks of 2, 4, 8, ... steps are of whole repeats
    has_blocks = times.bit_count() == 1 and different >= MIN_BLOCKS
    is_repeated = repeated > _REPEATED and not has_blocks
    if is_repeated:
        call.warn(
            "repeated steps",
            f"time_average: {100 * repeated:.0f} % of the {steps} steps repeat the one before in all fields, so that "
            "errors are too small, as of more steps than there are: leave them out, "
            f"f.isel(time=slice(None, None, {times})).cg.time_average()",
        )
    if drift > 0.5:
        call.warn(
            "drift",
            f"time_average: {name} changes over the {steps} steps by more than three errors of this change "
            f"at {100 * drift:.0f} % of the nodes, so that mean and error depend on where the series starts: "
            f"leave its start out, f.isel(time=slice({(steps + 1) // 2}, None)).cg.time_average(), or take moving "
            f"windows, time_average({max(steps // 4, 1)})",
        )
    if growth > 0.5 and not is_repeated:
        length = steps // (2 * blocks)
        call.warn(
            "plateau",
            f"time_average: the error of {name} is too small at {100 * growth:.0f} % of the nodes: it still "
            f"grows from blocks of {length} steps to blocks of {2 * length}, as steps are repeated or correlated over "
            "longer times. Average over a longer series, or leave repeated steps out, f.isel(time=slice(None, "
            f"None, {2 * length}))",
        )
    if few > 0.5:
        names = ", ".join(sharing)
        held = 100 * _held(effective)
        call.warn(
            f"few steps: {names}",
            f"time_average: at {100 * few:.0f} % of the nodes {effective:.1f} of the {steps} steps have the weight in "
            f"the mean of {names}, as a node sees too few grains in the others: about {held:.0f} % of the values are "
            "within two of their errors, in place of 95 %. Average over more steps or along axes (axes=), or increase "
            "width=",
        )


def _held(steps: float) -> float:
    """Return the chance that a mean of so many steps is within two of its errors, by Student's distribution."""
    from scipy.special import betainc

    freedom = max(steps - 1, 1.0)
    return float(1 - betainc(freedom / 2, 0.5, freedom / (freedom + 4)))


def _by_elements(function: Callable, *arrays: object) -> xr.DataArray:
    """Return a function of SciPy by elements, lazily where an array is."""
    return xr.apply_ufunc(function, *arrays, dask="parallelized", output_dtypes=[float])


def with_unknown_temperatures(mean: xr.Dataset, options: Options, purpose: str) -> xr.Dataset:
    """Return an average whose temperatures warn where they are NaN at many nodes of a phase; lazy ones when computed.

    Values elsewhere are then too large on average, as negative ones are NaN.
    """
    if options.temperature != "mixture" or "density" not in mean:
        return mean
    call = active_call()
    reached = mean["density"] > 0
    nodes = [dim for dim in reached.dims if dim not in NOT_NODES]
    warning = {}
    for name in ("granular_temperature", "mixture_temperature"):
        if name not in mean or "phase" not in mean[name].dims:
            continue
        values = mean[name]
        lost = (reached & values.isnull()).sum(nodes) / reached.sum(nodes).clip(1)
        phases = [label for label in values["phase"].to_numpy() if label != "bulk"]
        shares = [lost.sel(phase=label, drop=True) for label in phases]
        warn = partial(_warn_of_unknown, call, purpose, name, phases)
        warning[name] = _with_warning(values, warn, *shares)
    return mean.assign(warning)


def _warn_of_unknown(
    call: Once, purpose: str, name: str, phases: Sequence[str], *shares: float
) -> None:
    """Warn if the temperatures of a phase are NaN at many nodes."""
    texts = [
        f"{100 * share:.0f} % of the nodes of phase {phase}"
        for phase, share in zip(phases, shares, strict=True)
        if share > UNKNOWN
    ]
    if texts:
        call.warn(
            f"unknown {name}",
            f"{purpose}: {name} is NaN, as its error is larger, at {' and '.join(texts)}: the values at the others are "
            "too large on average. Average over more steps or along axes (axes=), or increase width=",
        )


_UNSURE = 0.1  # share of the nodes


def unsure_sign(
    mean: xr.Dataset, error: xr.Variable, call: Once
) -> tuple[xr.Variable, xr.Variable]:
    """Return where the sign of an averaged nematic order is unsure, and its error, which warns if nodes are many.

    The sign is that of the extreme eigenvalue of the larger modulus. The eigenvalues add up to zero,
    so that the moduli differ by that of the middle one: it is compared with their error. In a plane
    there are two eigenvalues of one modulus, and no sign.
    """
    tensor = mean["nematic_tensor"].variable
    unsure = xr.apply_ufunc(
        _with_small_middle,
        tensor,
        error,
        input_core_dims=[["component", "direction"], []],
        dask="parallelized",
        output_dtypes=[bool],
    )
    share = unsure.sum() / error.notnull().sum().clip(1)
    return unsure, _with_warning(error, partial(_warn_of_sign, call), share)


def _with_small_middle(tensor: NDArray, error: NDArray) -> NDArray:
    """Return where the middle eigenvalue of a tensor is smaller than an error."""
    finite = np.isfinite(tensor).all(axis=(-2, -1)) & np.isfinite(error)
    middle = np.linalg.eigvalsh(np.where(finite[..., None, None], tensor, 0.0))[..., 1]
    return finite & (np.abs(middle) < error)


def _warn_of_sign(call: Once, share: float) -> None:
    """Warn if the sign of a nematic order is unsure at many nodes."""
    if share > _UNSURE:
        call.warn(
            "sign of the nematic order",
            f"time_average: the sign of nematic_order is unsure at {100 * share:.0f} % of the nodes, where the largest "
            "and the smallest eigenvalue of nematic_tensor are equal in modulus within their error: bias and "
            "nematic_director are not known there. Average over more steps or along axes (axes=), or increase width=",
        )


# Bias over value of a norm, where noise and the true norm have equal squares.
_NOISY = 1 - math.sqrt(0.5)


def with_noise(
    name: str, field: Field, norm: xr.Variable, bias: xr.Variable, error: xr.Variable, call: Once
) -> xr.Variable:
    """Return the error of an averaged norm, which warns if noise is more than half of its square at most nodes.

    A mean bias that is small beside the field's usual value is silent.
    """
    finite = bias.notnull()
    count = finite.sum().clip(1)
    share = (bias > _NOISY * norm).sum() / count
    mean = norm.where(finite).sum() / count
    left = (norm - bias).sum() / count
    unit = norm.attrs.get("units", "1")
    least = 0.0 if field.floor_units else CONSIDERABLE_FLOOR * field.usual
    warn = partial(_warn_of_noise, call, name, "" if unit == "1" else f" {unit}", least)
    return _with_warning(error, warn, share, mean, left)


def _warn_of_noise(
    call: Once, name: str, unit: str, least: float, share: float, mean: float, left: float
) -> None:
    """Warn if the bias of a norm is considerable, and more than half of its square at most nodes."""
    if share > 0.5 and mean - left > least:
        call.warn(
            f"noise of {name}",
            f"time_average: {name} is {mean:.2g}{unit} in the mean of the nodes, {left:.2g}{unit} without its bias: "
            f"noise of few grains is more than half of its square at {100 * share:.0f} % of the nodes. Subtract "
            f"{name}_bias, of eight steps or more, average over more steps, runs or axes (axes=), or increase width=",
        )


def with_unsure_angle(name: str, angle: xr.Variable, error: xr.Variable, call: Once) -> xr.Variable:
    """Return the error of an averaged angle, which warns if its mean is more than half of that of the angle."""
    finite = angle.notnull() & error.notnull()
    means = [values.where(finite).sum() / finite.sum().clip(1) for values in (angle, error)]
    return _with_warning(error, partial(_warn_of_angle, call, name), *means)


def _warn_of_angle(call: Once, name: str, angle: float, error: float) -> None:
    """Warn if the error of an angle is more than half of it."""
    if error > angle / 2:
        call.warn(
            f"unsure {name}",
            f"time_average: {name} is {angle:.2g} rad in the mean of the nodes, with an error of {error:.2g} rad: "
            "noise turns the axes of few grains, so that small angles are too large. Average over more steps, runs or "
            "axes (axes=), or increase width=",
        )


# --- floors ------------------------------------------------------------------------------------------

FLOOR = "floor_of_one_step"
NAMED = "fields_by_name"  # 1 in results of fields that were asked for by name


def has_floors(f: xr.Dataset) -> bool:
    """Return whether a field of a result has a floor."""
    return any(FLOOR in values.attrs for values in f.data_vars.values())


def is_checked_for_noise(f: xr.Dataset, name: str, field: Field, count: int) -> bool:
    """Return whether an average of so many steps warns of the noise of a norm.

    Of few steps those alone that were asked for by name, and whose floor takes the contacts of a step.
    """
    if not field.is_norm:
        return False
    lacks_floor = field.floor is not None and FLOOR not in f[name].attrs
    return count >= MIN_BIAS_BLOCKS or (NAMED in f.attrs and lacks_floor)


def with_floors(mean: xr.Dataset, options: Options, purpose: str, places: float) -> xr.Dataset:
    """Return an average over so many independent places with its floors, which fall with the root of their number.

    It warns where they are considerable.
    """
    changed = {}
    for name in map(str, mean.data_vars):
        if FLOOR in mean[name].attrs:
            floor = float(f"{mean[name].attrs[FLOOR] / math.sqrt(places):.2g}")
            changed[name] = mean[name].assign_attrs({FLOOR: floor})
    mean = mean.assign(changed)
    warn_of_floors(mean, options, purpose)
    return mean


def warn_of_floors(mean: xr.Dataset, options: Options, purpose: str) -> None:
    """Warn of the floors of an average that are considerable, of fields that were asked for by name.

    Floors of one step fall with the root of the number of steps and runs that are averaged.
    """
    if NAMED not in mean.attrs:
        return
    number = mean.attrs.get("averaged_steps", 1) * mean.attrs.get("averaged_runs", 1)
    texts = []
    for name in map(str, mean.data_vars):
        if FLOOR not in mean[name].attrs:
            continue
        field = registry.field_of(name, options)
        floor = mean[name].attrs[FLOOR] / math.sqrt(number)
        if floor > CONSIDERABLE_FLOOR * field.usual:
            texts.append(f"{name} is about {field.floor_text(floor)}")
    if texts:
        warn_once(
            f"floors of {purpose}",
            f"{purpose}: {', '.join(texts)} where the true value is 0, as it is the average of few grains: average "
            "over more steps (from eight on, time_average returns the bias, <field>_bias), or increase width=",
        )
