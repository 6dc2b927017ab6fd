"""Averages of results over axes and over time, with standard errors.

Averages of ratios are ratios of averages, by the rule on each field's row in the registry. Sums
(`additive` fields) are averaged as they are. A ratio, such as a velocity, is averaged with the sum
in its denominator as its `weight`: this is the ratio of the averaged sums. What is not linear in
these (magnitudes, friction, inertial number) is computed anew from the averages. The sums have to
be in the result beside the ratios, as variables or coordinates: `needed_for_averages` says which
these are, and an error which are missing.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any, TypeVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.checks import check, whole
from xcg.common.messages import active_call
from xcg.fields.formulas import registry
from xcg.fields.formulas.block_errors import MIN_BIAS_BLOCKS, Jackknife, jackknife
from xcg.fields.formulas.doubts import (
    NOT_NODES,
    Steadiness,
    has_floors,
    is_checked_for_noise,
    unsure_sign,
    warn_of_floors,
    with_floors,
    with_noise,
    with_unknown_temperatures,
    with_unsure_angle,
)
from xcg.fields.formulas.mean_sums import Averaging, require_fields
from xcg.fields.formulas.one_task import in_one_task, is_small
from xcg.fields.formulas.rules import ENDS, errors_among, has_bias
from xcg.fields.sums.kernels import kernel_of
from xcg.scene.facts import with_facts
from xcg.scene.frame import require_steps, with_time
from xcg.scene.schema import COMPONENTS
from xcg.steps.labels import format_call, provenance

T = TypeVar("T", xr.Dataset, xr.DataArray)
_SAMPLE = "_sample"


def profile(f: xr.Dataset, axis: str) -> xr.Dataset:
    """Average a result over its other axes, nodes weighing the same, or by their radius in a cylinder.

    This is for results that are there already; the exact marginal profile, without a mesh along the
    other axes, is ``coarse_grain(axes=axis)``. Over whole periods or supports the two agree but for
    the ratios' small parts.

    Parameters
    ----------
    f : xarray.Dataset
        A result of `xcg.coarse_grain`.
    axis : str
        The axis to keep.

    Returns
    -------
    xarray.Dataset
        Fields without the other axes; ratios are ratios of averaged sums. Where the result has
        errors of one step (``coarse_grain(errors=True)``), errors of the average: of the noise,
        with as many places as supports of the kernel, ``n = A int Psi^2 / int psi^2`` (psi the
        marginal along the axis that is kept), or of the scatter of the places over sqrt(n - 1); the
        larger, and ``<name>_error_from`` says which.

    Raises
    ------
    SceneError
        If results of different options were joined, or the result has lost its options.
    ValueError
        If the axis is not resolved, or a sum that a ratio needs is not in the result.
    """
    require_fields(f, "profile")
    f, beside = _with_sums(with_facts(f))
    f, noise = _without_noise(f)
    axes = [a for a in (*COMPONENTS, "r", "theta") if a in f.dims]
    if axis not in axes:
        raise ValueError(f"profile({axis!r}): the resolved axes of this result are {axes}")
    f = f.assign_attrs(provenance(f, format_call("profile", {"axis": axis})))
    others = [a for a in axes if a != axis]
    average = Averaging.of(f, "profile")
    sums = average.to_sums(f, others)
    if "r" in others:  # rings have areas r dr; the axis itself has none
        sums = sums.sel(r=sums["r"] > 0.0)
        area = float(sums["r"].sum()) * math.prod(sums.sizes[d] for d in others if d != "r")
        mean = _average_of((sums * sums["r"]).sum(others, skipna=False) / area, f, average)
        return mean.set_coords(beside)
    mean = _average_of(sums.mean(others, skipna=False), f, average)
    if not (noise or has_floors(f)) or not set(others) <= set(COMPONENTS):
        return mean.set_coords(beside)
    count = _independent(f, others)
    mean = with_floors(mean, average.options, "profile", count)
    of_nodes = {}
    for name, error in noise.items():
        if count > 1:
            mean[f"{name}_error"] = f[name].std(others) / np.sqrt(count - 1.0)
        of_nodes[name] = _noise(error, sums, name, others, count)
    return _with_larger(mean, of_nodes, "scatter_of_places").set_coords(beside)


def time_average(
    f: xr.Dataset, window: int | None = None, *, every: int = 1, dim: str = "time"
) -> xr.Dataset:
    """Average a result over time, over moving windows, or over runs, with standard errors.

    Steps of a simulation are correlated, so the scatter of single steps over sqrt(n) is too small
    an error. Means of blocks of 1, 2, 4, ... steps give errors that grow with the block until
    blocks are independent: the error is that of the smallest block beyond which it no longer grows
    (Flyvbjerg & Petersen 1989), each value by itself, ratios by the jackknife over blocks of their
    sums. Where the series is too short to reach that plateau (fewer than 16 blocks left), the last
    error is a lower bound.

    Runs are independent: their error is the scatter over sqrt(n), of ratios by the jackknife.

    Parameters
    ----------
    f : xarray.Dataset
        A result of `xcg.coarse_grain` with several steps, weighing the same. With `dim`, results of
        several runs, or their averages over time, joined by ``xr.concat(results, dim)``.
    window : int, optional
        Steps in a moving window; all by default.
    every : int
        Steps from one window to the next.
    dim : str
        Dimension that samples are along: "time", or that of runs, which time_average keeps apart
        from the steps: with both, the average of the runs at each time.

    Returns
    -------
    xarray.Dataset
        Means and, under ``<name>_error``, their standard errors; NaN for a single step or run. Fields that
        are no sums and no ratios of two sums, such as pressure, mu, I, anisotropies, order and
        shear rate, have their bias from the same blocks beside them, ``<name>_bias``: the mean of a
        norm of few samples is larger than the norm of the mean. Subtract it; there is none for
        fewer than 8 steps or runs. Without `time`, or with the mean time of each window. Where the result
        has errors of one step (``coarse_grain(errors=True)``), the larger of the two, and
        ``<name>_error_from`` says which: noise of independent steps, or their scatter.

        From 8 steps on, attributes of the errors of results in memory are shares of nodes (the
        largest of components and phases): ``share_with_drift``, where the least-squares line
        through 8 to 15 blocks changes by more than three of its errors (t test), and from 16 steps
        on ``share_without_plateau``, where the error of the largest blocks is exceeded by that of
        blocks twice as long by more than their scatter. More than half of the nodes warn.

    Raises
    ------
    SceneError
        If results of different options were joined, or the result has lost its options or has no
        step.
    ValueError
        If there is no time or no dimension of runs, the meshes of runs differ, the window does not
        fit, or a sum that a ratio needs is not in the result.
    """
    arguments: dict[str, Any] = {"window": window, "every": every, "dim": dim}
    if dim == "time" and is_small(f):
        return in_one_task(_time_average, f, arguments)
    return _time_average(f, **arguments)


def _time_average(f: xr.Dataset, window: int | None, every: int, dim: str) -> xr.Dataset:
    """Average a result as `time_average` does, variable by variable."""
    of_runs = dim != "time"
    if not of_runs:
        f = with_time(f)
    f, sums_beside = _with_sums(with_facts(f))
    if of_runs:
        f = _of_equal_runs(f, dim, window)
    f, noise = _without_noise(f)
    if dim not in f.dims:
        raise ValueError("time_average needs a result with the dimension 'time'")
    require_steps(f, "time_average")
    count = f.sizes[dim]
    check("window", window, whole(1, count), optional=True, hint=", the number of steps")
    check("every", every, whole(1, count), hint=", the number of steps")
    if window is None and every != 1:
        raise ValueError(
            f"every={every!r} is the distance of windows: give their length, window=, too"
        )
    arguments: dict[str, Any] = {"window": window, "every": every}
    if of_runs:
        arguments = {"dim": dim}
    f = f.assign_attrs(provenance(f, format_call("time_average", arguments)))
    steps = None
    if window is not None:
        firsts = np.arange(0, count - int(window) + 1, int(every))
        steps = firsts[:, None] + np.arange(int(window))
    samples = _samples_of(f, dim, steps)
    average = Averaging.of(f, "time_average")
    samples = average.to_sums(samples, [_SAMPLE])
    mean = _average_of(samples.mean(_SAMPLE, skipna=False), f, average)
    norms = [name for name, field in average.definitions.items() if field and field.is_norm]
    blocks = jackknife(
        samples,
        _SAMPLE,
        lambda means: average.from_sums(means, f),
        norms=norms,
        independent=of_runs,
    )
    in_a_mean = samples.sizes[_SAMPLE]
    mean = mean.assign(_beside(mean, f, average, blocks, samples, sums_beside))
    averaged = "averaged_runs" if of_runs else "averaged_steps"
    mean = mean.assign_attrs({averaged: in_a_mean})
    if 1 < in_a_mean < MIN_BIAS_BLOCKS:  # it has no bias
        warn_of_floors(mean, average.options, "time_average")
    of_steps = {}
    for name, error in noise.items():
        error = _samples_of(error, dim, steps)
        of_steps[name] = _noise(error, samples, name, [_SAMPLE], in_a_mean)
    mean = _with_larger(mean, of_steps, "scatter_of_runs" if of_runs else "scatter_of_steps")
    # what was not asked for has no error
    loose = [f"{name}{end}" for name in sums_beside for end in ENDS]
    mean = mean.drop_vars(loose, errors="ignore")
    return mean.set_coords(sums_beside)


def _samples_of(f: T, dim: str, steps: NDArray | None) -> T:
    """Return data whose steps or runs are samples; with `steps` (windows, samples), those of each window."""
    if dim == "time":
        f = f.drop_vars("step", errors="ignore")
    if steps is None:
        return f.rename({dim: _SAMPLE}).drop_vars(_SAMPLE, errors="ignore")
    samples = f.drop_vars("time").isel(time=xr.DataArray(steps, dims=("time", _SAMPLE)))
    middle = _mean_times(f["time"].to_numpy()[steps])
    return samples.assign_coords(time=("time", middle, f["time"].attrs))


def _mean_times(times: NDArray) -> NDArray:
    """Return the mean time of each window (windows, steps): of numbers, durations or dates."""
    if times.dtype.kind in "fiu":
        return times.mean(axis=1)
    first = times[:, :1]
    return first[:, 0] + (times - first).mean(axis=1)


def _beside(
    mean: xr.Dataset,
    f: xr.Dataset,
    average: Averaging,
    blocks: Jackknife,
    samples: xr.Dataset,
    unchecked: Sequence[str],
) -> dict[str, xr.Variable]:
    """Return the errors and biases of the fields of an average; errors that are checked warn."""
    count = samples.sizes[_SAMPLE]
    options = average.options
    definitions = average.definitions
    weights = {}
    for name in map(str, mean.data_vars):
        field = definitions.get(name)
        if name not in unchecked:
            weights[name] = field.weight if field else ""
    call = active_call()
    steadiness = Steadiness(blocks, weights, samples, _SAMPLE, call)
    beside = {}
    for name in map(str, mean.data_vars):
        field = definitions.get(name)
        finite = mean[name].variable.notnull()
        units = f[name].attrs.get("units", "1")
        # without coordinates, which are the mean's; an error may be known where the mean is not
        error = blocks.errors[name].variable.where(finite)
        error.attrs = {"units": units, "long_name": f"standard error of {name}"}
        unsure = None
        if name == "nematic_order" and options.dimension == 3 and count >= MIN_BIAS_BLOCKS:
            unsure, error = unsure_sign(mean, error, call)
        if name in weights:
            error = steadiness.checked(name, error, samples.get(f"{name}/bottom"), unsure)
        if field and is_checked_for_noise(f, name, field, count):
            norm = mean[name].variable
            error = with_noise(name, field, norm, blocks.biases[name].variable, error, call)
        if field and field.is_angle and count >= MIN_BIAS_BLOCKS:
            error = with_unsure_angle(name, mean[name].variable, error, call)
        if field and count >= MIN_BIAS_BLOCKS and has_bias(field, options):
            bias = blocks.biases[name].variable.where(finite)
            if unsure is not None:
                bias = bias.where(~unsure)
            bias.attrs = {"units": units, "long_name": f"bias of {name}: subtract it"}
            beside[f"{name}_bias"] = bias
        beside[f"{name}_error"] = error
    return beside


def _of_equal_runs(f: xr.Dataset, dim: str, window: int | None) -> xr.Dataset:
    """Return results of runs without their errors; raise ValueError unless all have the same nodes and times.

    xarray joins different nodes to those of all, where the fields of some runs are NaN. Lazy fields
    raise when they are computed.
    """
    axes = (*COMPONENTS, "r", "theta", *NOT_NODES)
    if dim in axes or dim not in f.dims:
        raise ValueError(
            f"time_average(dim={dim!r}): join the results of runs along a dimension of its own first, "
            "xr.concat(results, 'run').cg.time_average(dim='run'); averages over axes are those of f.cg.profile(axis)"
        )
    if window is not None:
        raise ValueError(f"time_average(dim={dim!r}): a window is of steps; leave window= out")
    differing = [axis for axis in axes if axis in f.coords and dim in f[axis].dims]
    if differing:
        raise ValueError(_of_different_meshes(dim, differing))
    fields = Averaging.of(f, "time_average").definitions
    definitions = {name: field for name, field in fields.items() if field}
    sums = [name for name, field in definitions.items() if field.additive and dim in f[name].dims]
    if sums:
        lacking = f[sums[0]].isnull().any(dim)
        nodes = [axis for axis in lacking.dims if axis in axes or axis == "time"]
        gaps = []
        for axis in nodes:
            gaps.append(lacking.all([other for other in lacking.dims if other != axis]).any())
        checked = {}
        for name in definitions:
            if dim in f[name].dims:
                checked[name] = xr.apply_ufunc(
                    partial(_refuse_gaps, dim, nodes),
                    f[name],
                    *gaps,
                    dask="parallelized",
                    output_dtypes=[f[name].dtype],
                    keep_attrs=True,
                )
        f = f.assign(checked)
    if _is_average(f):
        errors = errors_among(map(str, f.data_vars))
        f = f.drop_vars([*errors, *(f"{name}_from" for name in errors)], errors="ignore")
    # xarray joins sums that are equal in all runs to one
    equal = {}
    for name in definitions:
        if name in f and dim not in f[name].dims:
            equal[name] = f[name].expand_dims({dim: f.sizes[dim]})
    return f.assign(equal)


def _refuse_gaps(dim: str, axes: Sequence[Hashable], values: NDArray, *gaps: NDArray) -> NDArray:
    """Return the values of a field; raise ValueError where axes have nodes that some runs lack."""
    differing = [str(axis) for axis, gap in zip(axes, gaps, strict=True) if np.any(gap)]
    if differing:
        raise ValueError(_of_different_meshes(dim, differing))
    return values


def _of_different_meshes(dim: str, axes: Iterable[str]) -> str:
    return (
        f"time_average(dim={dim!r}): the results differ in {', '.join(axes)}, so that some "
        "have no value where others have: compute all on one mesh, ds.cg.coarse_grain(..., like=first), and at "
        "equal times, or take f.cg.time_average() of each before they are joined"
    )


def coarsen(f: xr.Dataset, **blocks: int) -> xr.Dataset:
    """Average a result over blocks of nodes; ratios are ratios of averaged sums.

    The `coarsen` of xarray averages ratios as they are: velocities without the density that weighs
    them, and a friction coefficient of each node. The mass of all nodes does not change.

    Parameters
    ----------
    f : xarray.Dataset
        A result of `xcg.coarse_grain`, without errors of one step.
    **blocks : int
        Nodes of a block along axes: x, y, z, or theta.

    Returns
    -------
    xarray.Dataset
        The fields at the means of the blocks' nodes.

    Raises
    ------
    SceneError
        If results of different options were joined, or the result has lost its options.
    ValueError
        If an axis is not resolved or no whole number of blocks, if a sum that a ratio needs is not
        in the result, or if it holds standard errors.

    Examples
    --------
    >>> import xcg
    >>> f = xcg.datasets.random_scene(100).cg.coarse_grain(["density", "velocity"], spacing=0.5)
    >>> f.cg.coarsen(x=5, z=2).density.dims
    ('time', 'x', 'y', 'z')
    """
    require_fields(f, "coarsen")
    f, beside = _with_sums(with_facts(f))
    axes = [a for a in (*COMPONENTS, "theta") if a in f.dims]
    for axis, size in blocks.items():
        if axis not in axes:
            raise ValueError(
                f"coarsen({axis}={size!r}): blocks are along {', '.join(axes) or 'no axis'} here"
            )
        nodes = f.sizes[axis]
        check(axis, size, whole(1, nodes), hint=f", nodes of a block along {axis!r}")
        left = nodes % size
        if left:
            raise ValueError(
                f"coarsen({axis}={size}): {nodes} nodes along {axis!r} are {left} more than a multiple of {size}: "
                f"call f.isel({axis}=slice({nodes - left})).cg.coarsen(...), or take a divisor of {nodes}"
            )
    f = f.assign_attrs(provenance(f, format_call("coarsen", blocks)))
    one_block = f
    middles = {}
    inside = {}
    for axis, size in blocks.items():
        one_block = one_block.isel({axis: slice(size)})
        middles[axis] = f[axis].coarsen({axis: size}).mean()
        inside[axis] = f"{axis} in block"
    split = {axis: (axis, inside[axis]) for axis in blocks}
    f = f.drop_vars([*blocks]).coarsen(blocks).construct(split)
    dims = [*inside.values()]
    average = Averaging.of(f, "coarsen")
    mean = _average_of(average.to_sums(f, dims).mean(dims, skipna=False), f, average)
    if has_floors(f) and set(blocks) <= set(COMPONENTS):
        count = _independent(one_block, [*blocks])
        mean = with_floors(mean, average.options, "coarsen", count)
    return mean.assign_coords(middles).set_coords(beside)


# --- errors of one step ----------------------------------------------------------------------------------


def _with_sums(f: xr.Dataset) -> tuple[xr.Dataset, list[str]]:
    """Make variables of the sums that are coordinates beside a result; return their names, too."""
    options = registry.options_of(f.attrs)
    beside = []
    for name, coord in f.coords.items():
        if name in registry.FIELDS and name not in f.dims:
            label = registry.field_of(str(name), options).long_name
            if coord.attrs.get("long_name") == label:
                beside.append(str(name))
    return f.reset_coords(beside), beside


def _without_noise(f: xr.Dataset) -> tuple[xr.Dataset, dict[str, xr.DataArray]]:
    """Remove the errors of single steps from a result; return them by the names of their fields."""
    noise: dict[str, xr.DataArray] = {}
    if _is_average(f):
        return f, noise
    for name in map(str, f.data_vars):
        error = f"{name}_error"
        if error in f:
            noise[name] = f[error]
    beside = [f"{name}{end}" for name in noise for end in ("_error", "_error_from")]
    return f.drop_vars(beside, errors="ignore"), noise


def _is_average(f: xr.Dataset) -> bool:
    """Return whether a result is an average over steps or runs, whose errors are not those of one step."""
    return not {"averaged_steps", "averaged_runs"}.isdisjoint(f.attrs)


def _noise(
    noise: xr.DataArray, sums: xr.Dataset, name: str, dims: Sequence[str], independent: float
) -> xr.DataArray:
    """Error of an average of some independent values over dimensions; of a ratio with the weights of its average."""
    denominator = sums.get(f"{name}/bottom")
    if denominator is None:
        variance = (noise**2).mean(dims)
    else:
        weight = denominator.where(noise.notnull(), 0.0)
        total = weight.sum(dims)
        share = ((weight * noise.fillna(0.0)) ** 2).sum(dims) / total.where(total != 0) ** 2
        variance = share * math.prod(sums.sizes[dim] for dim in dims)
    return variance.clip(0.0) ** 0.5 / independent**0.5


def _independent(f: xr.Dataset, axes: Sequence[str]) -> float:
    """Return how many places along some axes share no grains: at most as many as there are nodes."""
    dimension = int(f.attrs["kernel_dimension"])
    kernel = kernel_of(str(f.attrs["kernel"]), float(np.max(f.attrs["width"])), {}, dimension)
    resolved = sum(a in f.coords for a in COMPONENTS)
    nodes = 1
    volume = 1.0
    for axis in axes:
        x = f[axis].to_numpy()
        nodes *= len(x)
        volume *= len(x) * abs(x[1] - x[0]) if len(x) > 1 else 0.0
    before = kernel.squared_integral(resolved)
    after = kernel.squared_integral(resolved - len(axes))
    places = volume * before / after
    return float(max(1.0, min(nodes, places)))


def _with_larger(mean: xr.Dataset, noise: Mapping[str, xr.DataArray], source: str) -> xr.Dataset:
    """Add the larger of two errors of each field to an average, and its source: noise or scatter."""
    beside = {}
    for name, of_noise in noise.items():
        of_scatter = mean.get(f"{name}_error", of_noise)
        scatter_is_larger = (of_scatter > of_noise) | of_noise.isnull()
        scatter_is_larger = scatter_is_larger.drop_attrs(deep=False)
        error = of_scatter.where(scatter_is_larger, of_noise).where(mean[name].notnull())
        beside[f"{name}_error"] = error.drop_attrs(deep=False).assign_attrs(
            units=mean[name].attrs.get("units", "1"), long_name=f"standard error of {name}"
        )
        beside[f"{name}_error_from"] = scatter_is_larger.astype("int8").assign_attrs(
            long_name=f"source of the error of {name}",
            flag_values=np.array([0, 1], "int8"),
            flag_meanings=f"noise_of_each_step {source}",
        )
    return mean.assign(beside)


def _average_of(sums: xr.Dataset, f: xr.Dataset, average: Averaging) -> xr.Dataset:
    """Return the fields of `f` from averaged quantities, with the warnings that they are due."""
    mean = average.from_sums(sums, f)
    return with_unknown_temperatures(mean, average.options, average.purpose)
