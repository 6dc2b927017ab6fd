"""Correlations of a field in space and time, with errors, and their length and time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.checks import check, whole
from xcg.fields.formulas.block_errors import block_errors
from xcg.fields.formulas.mean_sums import require_fields
from xcg.scene.facts import require_facts, with_facts
from xcg.scene.frame import require_steps, with_rising, with_time
from xcg.scene.schema import COMPONENTS
from xcg.scene.times import evenly_spaced, require_known_times
from xcg.steps.labels import (
    annotated,
    format_call,
    labelled,
    labelled_table,
    provenance,
    with_errors,
)
from xcg.steps.mapping import apply_along

_TAIL = ("component", "direction")
_SUMS = ("products", "pairs", "square", "count", "other_square", "other_count")


def spatial_correlation(f: xr.Dataset, field: str, other: str | None = None) -> xr.Dataset:
    """Correlate a field with itself, or with another one, at all distances between nodes.

    ``C(l) = <a'(r) . b'(r + l)> / sqrt(<a'.a'> <b'.b'>)``, with a' and b' the fields less their
    means over the nodes of each step, and the mean over all pairs of nodes with values and over
    time. Components of vectors and tensors are summed. Along axes where the nodes span the period
    (the attribute ``period`` of the coordinate), pairs reach across the edges; along the others,
    and in a selection of such nodes, they end there. Lazy where the result is, a chunk of time
    after the other.

    Parameters
    ----------
    f : xarray.Dataset
        A result of `xcg.coarse_grain` with one resolved axis or more.
    field, other : str
        Fields in it; `other` is `field` by default. A node where a field is NaN takes no part in the
        sums of this field: its mean, its square, and its products with the other one.

    Returns
    -------
    xarray.Dataset
        ``correlation`` (lag_x, lag_y, lag_z), those axes that are resolved, and ``pairs``, how many
        pairs of nodes a step has at each lag; ``radial_correlation`` (r), the mean over lags of
        about the same length; and ``correlation_length`` (m), the distance at which that first
        falls to 1/e, NaN where it does not. Their standard errors from the scatter over time,
        ``<name>_error``, as in `time_average`: NaN for a single step.

    Raises
    ------
    SceneError
        If results of different options were joined, or the result has lost its options.
    ValueError
        If a field is not in the result, the two have other dimensions, or no axis is resolved by
        two nodes or more at equal distances.

    Notes
    -----
    Computed by fast Fourier transforms, open axes padded with zeros (Wiener & Khinchin). The mean
    that is subtracted is that of the nodes, so that the sum over all pairs of a periodic mesh is
    zero: in a mesh of few correlation lengths C is too low by about the share of the mesh that is
    correlated. Smearing correlates nodes over the support of the kernel, whatever the grains do.

    Examples
    --------
    >>> import xcg
    >>> f = xcg.datasets.random_scene(400, seed=1).cg.coarse_grain("volume_fraction")
    >>> c = f.cg.spatial_correlation("volume_fraction")
    >>> round(float(c.correlation.sel(lag_x=0, lag_y=0, lag_z=0)), 12)
    1.0
    """
    other = other or field
    require_fields(f, "spatial_correlation")
    f = with_facts(with_time(f))
    require_steps(f, "spatial_correlation")
    way_out = "or give the axes that wrap around, f.assign_attrs(wrapped_axes='xy')"
    require_facts(f, ("wrapped_axes",), "this result", way_out)
    f = with_rising(f, COMPONENTS)
    a = _field_of(f, field, "spatial_correlation")
    b = _field_of(f, other, "spatial_correlation")
    if set(a.dims) != set(b.dims):
        raise ValueError(
            f"{field!r} has the dimensions {a.dims} and {other!r} {b.dims}: "
            "correlate components, a vector with a vector"
        )
    axes = [axis for axis in COMPONENTS if a.sizes.get(axis, 0) > 1]
    if not axes:
        raise ValueError(
            "spatial_correlation needs resolved axes of two nodes or more, and "
            f"{field!r} has the dimensions {a.dims}"
        )
    sums = _sums_over_pairs(f, a, b, axes)
    length = sums["r"].attrs["units"]
    about = {
        "correlation": ("1", f"correlation of {field} with {other}"),
        "radial_correlation": ("1", f"correlation of {field} with {other} by distance"),
        "correlation_length": (length, "distance at which the correlation falls to 1/e"),
    }
    call = format_call("spatial_correlation", {"field": field, "other": other})
    series = sums
    if "time" not in sums.dims:
        series = sums.expand_dims("time")
    of_steps = [name for name in series.coords if name not in series.dims or name == "time"]
    series = series.drop_vars(of_steps)
    mean = _correlation_in_space(series.mean("time"))
    errors = block_errors(series, "time", _correlation_in_space)
    data = with_errors(mean, errors, about)
    result = xr.Dataset(data, attrs=provenance(f, call))
    pairs = sums["pairs"]
    if "time" in sums.dims:
        pairs = pairs.mean("time")
    return result.assign(pairs=labelled(pairs, "1", "pairs of nodes in a step"))


def _sums_over_pairs(
    f: xr.Dataset, a: xr.DataArray, b: xr.DataArray, axes: Sequence[str]
) -> xr.Dataset:
    """Return sums of each step over pairs of nodes, by lag along each axis and by distance."""
    length = f[axes[0]].attrs.get("units", "m")
    spacing = {}
    wraps = {}
    lags = {}
    for axis in axes:
        apart = evenly_spaced(f[axis].to_numpy(), f"nodes along {axis!r}")
        extent = apart * f.sizes[axis]
        whole_period = np.isclose(f[axis].attrs.get("period", extent), extent, atol=0.0)
        spacing[axis] = apart
        wraps[axis] = axis in str(f.attrs["wrapped_axes"]) and bool(whole_period)
        lag = apart * _lags(a.sizes[axis], wraps[axis])
        dim = f"lag_{axis}"
        lags[dim] = annotated(dim, lag, length, f"distance along {axis}")
    tail = [dim for dim in _TAIL if dim in a.dims]
    core = [*axes, *tail]
    arrays = apply_along(
        _products,
        a.drop_vars(axes),
        b.drop_vars(axes),
        along=[core, core],
        to=[[*lags]] * 2 + [[]] * 4,
        sizes={dim: len(lag) for dim, lag in lags.items()},
        kwargs={"wraps": tuple(wraps.values()), "rank": len(tail)},
    )
    sums = xr.Dataset(dict(zip(_SUMS, arrays, strict=True))).assign_coords(lags)
    r, add_by_shell = _shells([lag.values for lag in lags.values()], min(spacing.values()))
    for kind in ("products", "pairs"):
        sums[f"radial_{kind}"] = apply_along(
            add_by_shell, sums[kind], along=[[*lags]], to=[["r"]], sizes={"r": len(r)}
        )
    return sums.assign_coords(r=annotated("r", r, length, "distance"))


def time_correlation(f: xr.Dataset, field: str, max_lag: int | None = None) -> xr.Dataset:
    """Correlate a field with itself at later times, at each node and over all nodes.

    ``C(tau) = <a'(t) . a'(t + tau)> / <a'.a'>`` with a' the field less its mean over time at the
    node. Components of vectors and tensors are summed. Lazy where the result is; all steps of some
    nodes are in memory at once.

    Parameters
    ----------
    f : xarray.Dataset
        A result of `xcg.coarse_grain` with steps at equal distances.
    field : str
        A field in it. Steps in which a node is NaN take no part there.
    max_lag : int, optional
        The longest lag, in steps; half of the steps by default.

    Returns
    -------
    xarray.Dataset
        ``correlation`` (lag, and the dimensions of the field but time and components),
        ``mean_correlation`` (lag), that of sums over all nodes, and ``correlation_time`` (s), the
        time at which it first falls to 1/e, NaN where it does not; ``mean_correlation_error`` and
        ``correlation_time_error`` from blocks of the times t, as in `time_average`.

    Raises
    ------
    SceneError
        If the steps are not at equal distances, or results of different options were joined.
    ValueError
        If the field is not in the result, there are fewer than three steps, or the lag is out of
        range.

    Notes
    -----
    The mean that is subtracted is that of the series, so that C is too low by about twice the
    correlation time over the length of the series.
    """
    f = with_facts(with_time(f))
    f = with_rising(f, ["time"])
    a = _field_of(f, field, "time_correlation")
    steps = a.sizes.get("time", 1)
    if steps < 3:
        raise ValueError(f"time_correlation needs three steps or more, and {field!r} has {steps}")
    check("max_lag", max_lag, whole(1, steps - 1), optional=True)
    last = int(max_lag or steps // 2)
    require_known_times(f, "time_correlation")
    interval = evenly_spaced(f["time"].to_numpy(), "times")
    tail = [dim for dim in _TAIL if dim in a.dims]
    nodes = [str(dim) for dim in a.dims if dim in COMPONENTS]
    values = a.drop_vars(["time", "step"], errors="ignore").transpose("time", ...)
    if values.chunks is not None:
        values = values.chunk({"time": -1} | dict.fromkeys(nodes, "auto"))
    deviation = values - values.mean("time")
    exists = deviation.notnull().all(tail)
    deviation = deviation.where(exists, 0.0)
    at_nodes = []
    by_time = []
    for lag in range(last + 1):
        now = {"time": slice(0, steps - lag)}
        then = {"time": slice(lag, None)}
        products = (deviation.isel(now) * deviation.isel(then)).sum(tail)
        pairs = (exists.isel(now) & exists.isel(then)).astype(float)
        sums = xr.Dataset({"products": products, "pairs": pairs})
        at_nodes.append(sums.sum("time"))
        # the last steps have no partner
        by_time.append(sums.sum(nodes).pad(time=(0, lag), constant_values=0.0))
    second = f["time"].attrs.get("units", "s")
    lags = interval * np.arange(last + 1)
    coords = {
        "lag": annotated("lag", lags, second, "time between the steps"),
        "steps": annotated("lag", np.arange(last + 1), "1", "steps between"),
    }
    correlation = _by_lag(xr.concat(at_nodes, "lag"))["correlation"]
    series = xr.concat(by_time, "lag")
    mean, error, duration, duration_error = apply_along(
        _correlation_in_time,
        series["products"],
        series["pairs"],
        along=[["lag", "time"]] * 2,
        to=[["lag"], ["lag"], [], []],
        kwargs={"lags": lags},
        vectorize=True,
    )
    what = f"correlation of {field} with itself"
    about = {
        "correlation": (correlation, "1", f"{what} at later times"),
        "mean_correlation": (mean, "1", f"{what} at later times, over all nodes"),
        "mean_correlation_error": (error, "1", "standard error of mean_correlation"),
        "correlation_time": (duration, second, "time at which the mean correlation falls to 1/e"),
        "correlation_time_error": (duration_error, second, "standard error of correlation_time"),
    }
    data = labelled_table(about)
    call = format_call("time_correlation", {"field": field, "max_lag": last})
    return xr.Dataset(data, attrs=provenance(f, call)).assign_coords(coords)


def _field_of(f: xr.Dataset, name: str, purpose: str) -> xr.DataArray:
    if name not in f.data_vars:
        fields = ", ".join(map(str, f.data_vars))
        raise ValueError(f"{purpose}({name!r}): no such field; the result has {fields}")
    return f[name].astype(float)


# --- in space -------------------------------------------------------------------------------------


def _lags(nodes: int, wrapped: bool) -> NDArray:
    """Return the lags between nodes along an axis, in nodes: each once if it wraps around."""
    if wrapped:
        return np.arange(-(nodes // 2), nodes - nodes // 2)
    return np.arange(1 - nodes, nodes)


def _products(a: NDArray, b: NDArray, wraps: Sequence[bool], rank: int) -> tuple[NDArray, ...]:
    """Sum products of the deviations of two fields (..., nodes, components) over pairs of nodes.

    Returns
    -------
    tuple of array
        By the names in `_SUMS`: products and numbers of pairs (..., lags), then for each field the
        sum of its squares and the number of its nodes (...).
    """
    from scipy import fft

    axes = tuple(range(-len(wraps), 0))
    nodes = a.shape[: a.ndim - rank][-len(wraps) :]
    padded: list[int] = []
    indices: list[NDArray] = []  # of the lags in an inverse transform
    for count, wrapped in zip(nodes, wraps, strict=True):
        size = count
        if not wrapped:
            size = fft.next_fast_len(2 * count - 1)
        padded.append(size)
        indices.append(_lags(count, wrapped) % size)

    def transforms(field: NDArray) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        """Return transforms of deviation and known nodes, the sum of squares, the node count."""
        flat = np.moveaxis(field.reshape(*field.shape[: field.ndim - rank], -1), -1, 0)
        exists = np.isfinite(flat).all(axis=0)
        count = exists.sum(axis=axes, keepdims=True)
        mean = np.where(exists, flat, 0.0).sum(axis=axes, keepdims=True) / np.maximum(count, 1)
        deviation = np.where(exists, flat - mean, 0.0)
        return (
            fft.rfftn(deviation, padded, axes),
            fft.rfftn(exists.astype(float), padded, axes),
            (deviation**2).sum(axis=(0, *axes)),
            count.reshape(count.shape[: -len(wraps)]).astype(float),
        )

    def at_lags(one: NDArray, other: NDArray) -> NDArray:
        """Return the correlation of two transformed arrays."""
        index: Any = np.ix_(*indices)
        return fft.irfftn(one.conj() * other, padded, axes)[(..., *index)]

    deviation_a, exists_a, square_a, count_a = transforms(a)
    deviation_b, exists_b, square_b, count_b = transforms(b)
    products = at_lags(deviation_a, deviation_b).sum(axis=0)
    pairs = np.rint(at_lags(exists_a, exists_b))
    return products, pairs, square_a, count_a, square_b, count_b


def _shells(
    lags: Sequence[NDArray], thickness: float
) -> tuple[NDArray, Callable[[NDArray], NDArray]]:
    """Return the mean length (m) of the lags in each shell, and a function to add up by shell.

    The function takes sums (..., lags). A shell is as thick as the smallest spacing; the longest
    length is the longest lag along an axis.
    """
    lengths = np.sqrt(sum(x**2 for x in np.meshgrid(*lags, indexing="ij"))).ravel()
    shell = np.rint(lengths / thickness).astype(int)
    longest = max(np.abs(x).max() for x in lags)
    used = np.flatnonzero(lengths <= longest * (1 + 1e-12))
    used = used[np.argsort(shell[used], kind="stable")]
    _, first, count = np.unique(shell[used], return_index=True, return_counts=True)

    def add(sums: NDArray) -> NDArray:
        flat = sums.reshape(*sums.shape[: -len(lags)], -1)
        return np.add.reduceat(flat[..., used], first, axis=-1)

    return np.add.reduceat(lengths[used], first) / count, add


def _correlation_in_space(sums: xr.Dataset) -> xr.Dataset:
    """Return correlations and their length, from sums over pairs of nodes."""

    def mean(total: str, number: str) -> xr.DataArray:
        return sums[total] / sums[number].where(sums[number] > 0)

    product = mean("square", "count") * mean("other_square", "other_count")
    scale = np.sqrt(product.where(product > 0))
    by_distance = mean("radial_products", "radial_pairs") / scale
    length = apply_along(falls_to, by_distance, sums["r"], along=[["r"]] * 2, to=[[]])
    return xr.Dataset(
        {
            "correlation": mean("products", "pairs") / scale,
            "radial_correlation": by_distance,
            "correlation_length": length,
        }
    )


def falls_to(values: NDArray, at: NDArray, level: float = np.exp(-1.0)) -> NDArray:
    """Return where values (..., n) at rising coordinates (n,) first fall to a level, by interpolation.

    NaN where they do not, are not above it at first, or are not known before.
    """
    below = ~(values > level)
    k = below.argmax(axis=-1)[..., None]
    before = np.maximum(k - 1, 0)
    x0 = at[before]
    x1 = at[k]
    y0 = np.take_along_axis(values, before, axis=-1)
    y1 = np.take_along_axis(values, k, axis=-1)
    falls = below.any(axis=-1, keepdims=True) & (k > 0) & np.isfinite(y1)
    share = (y0 - level) / np.where(falls, y0 - y1, 1.0)
    return np.where(falls, x0 + share * (x1 - x0), np.nan)[..., 0]


# --- in time --------------------------------------------------------------------------------------


def _by_lag(sums: xr.Dataset) -> xr.Dataset:
    """Return the correlation by lag, from sums over pairs of steps."""
    mean = sums["products"] / sums["pairs"].where(sums["pairs"] > 0)
    square = mean.isel(lag=0)
    return xr.Dataset({"correlation": mean / square.where(square > 0)})


def _correlation_in_time(products: NDArray, pairs: NDArray, lags: NDArray) -> tuple[NDArray, ...]:
    """Return correlation (lag,), its error, the time to 1/e and its error; sums are (lag, time)."""
    steps = products.shape[1]
    whole = xr.Dataset({"products": (("lag", "time"), products), "pairs": (("lag", "time"), pairs)})
    mean = _by_lag(whole.sum("time"))["correlation"].to_numpy()
    errors = []
    for lag in range(len(lags)):
        part = whole.isel(lag=[0, lag], time=slice(0, steps - lag))
        errors.append(float(block_errors(part, "time", _by_lag)["correlation"][1]))
    common = whole.isel(time=slice(0, steps - len(lags) + 1))

    def duration(sums: xr.Dataset) -> xr.Dataset:
        correlation = _by_lag(sums)["correlation"].transpose(..., "lag")
        times = falls_to(correlation.to_numpy(), lags)
        return xr.Dataset({"duration": (correlation.dims[:-1], times)})

    duration_error = block_errors(common, "time", duration)["duration"].to_numpy()
    return mean, np.array(errors), falls_to(mean, lags), duration_error
