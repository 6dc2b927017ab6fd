"""Difference of two independent results, with its standard error."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from xcg.common.messages import SceneWarning, plain, warn_user
from xcg.scene.facts import OF_RESULTS, OF_SCENES, with_facts
from xcg.steps.labels import provenance

ERROR = "_error"
BIAS = "_bias"
COMPARED = "compared"  # attribute of a comparison: the names of its fields, as text that files keep
# facts in which two runs may differ, as they are of the runs and not of the way they are averaged
_OF_RUNS = ("periodic", "gravity", "thickness", "friction", "fluid_viscosity", "size_diameter")
_OF_METHOD = tuple(name for name in (*OF_SCENES, *OF_RESULTS) if name not in _OF_RUNS)
_CLOSE = 1e-9  # relative: of lengths that went through a file


def compare(a: xr.Dataset, b: xr.Dataset, relative: bool = False) -> xr.Dataset:
    """Return the difference of two independent results, b - a, with its standard error.

    The error is ``sqrt(a_error^2 + b_error^2)``: the variances of independent values add up. Plain
    ``b - a`` of xarray subtracts the errors instead.

    Parameters
    ----------
    a, b : xarray.Dataset
        Results on the same nodes, by the same options: compute the second with ``like=`` the first.
        Averages of `time_average` have errors. Results that share steps or grains are not
        independent, and the error is then wrong.
    relative : bool
        Divide the difference by the modulus of `a`, and propagate the error of both.

    Returns
    -------
    xarray.Dataset
        For each field of both results ``<field>``, the difference, and ``<field>_error`` if both
        have one; the two values and their errors as ``<field>_a``, ``<field>_a_error``,
        ``<field>_b`` and ``<field>_b_error``. Lazy if the results are. ``c.cg.plot`` draws both
        fields and the difference.

    Raises
    ------
    ValueError
        If nodes, options, frames or units differ, or the results have no field in common.
    SceneError
        If a result was joined of parts that differ.

    Warns
    -----
    SceneWarning
        If only one of the results has the error of a field: the difference has none.

    Notes
    -----
    With ``relative=True`` the error of (b - a)/abs(a) is
    ``sqrt(b_error^2 + (b/a)^2 a_error^2) / abs(a)``, to first order in a_error/a.

    Examples
    --------
    >>> import xarray as xr
    >>> a = xr.Dataset({"velocity": ("z", [1.0, 2.0]), "velocity_error": ("z", [0.3, 0.3])})
    >>> b = xr.Dataset({"velocity": ("z", [2.0, 2.0]), "velocity_error": ("z", [0.4, 0.4])})
    >>> c = compare(a, b)
    >>> c.velocity.values.tolist(), c.velocity_error.values.round(6).tolist()
    ([1.0, 0.0], [0.5, 0.5])
    """
    a = _one_step(with_facts(a))
    b = _one_step(with_facts(b))
    names = [str(name) for name in a.data_vars if name in b and not _is_beside(str(name), a)]
    if not names:
        raise ValueError(
            f"compare: the results have no field in common: a has {', '.join(map(str, a.data_vars))}, "
            f"b has {', '.join(map(str, b.data_vars))}"
        )
    _require_same_method(a, b)
    for name in names:
        _require_same_nodes(a[name], b[name])
    b = b.assign_coords({dim: a[dim] for dim in b.dims if dim in a.coords})  # to the last digit
    data: dict[str, xr.DataArray] = {}
    without_error = []
    for name in names:
        error = f"{name}{ERROR}"
        has_error = [error in f for f in (a, b)]
        if any(has_error) and not all(has_error):
            without_error.append(name)
        data |= _difference(a, b, name, relative)
    if without_error:
        warn_user(
            SceneWarning(
                f"compare: only one of the results has an error of {', '.join(without_error)}, so the "
                "difference has none: take the time_average of both"
            )
        )
    result = xr.Dataset(data)
    result.attrs = provenance(a, f"compare(a, b, relative={relative})")
    kept = {name: a.attrs[name] for name in _OF_METHOD if name in a.attrs}
    return result.assign_attrs(kept, **{COMPARED: " ".join(names)})


def _difference(a: xr.Dataset, b: xr.Dataset, name: str, relative: bool) -> dict[str, xr.DataArray]:
    """Return the difference of a field, its error and bias, and the values it is made of."""
    error = f"{name}{ERROR}"
    before, after = a[name].reset_coords(drop=True), b[name].reset_coords(drop=True)
    text = str(before.attrs.get("long_name", name.replace("_", " ")))
    about = {"long_name": f"difference of {text}"}
    scale: Any = 1.0
    if relative:
        about = {"long_name": f"relative difference of {text}", "units": "1"}
        scale = 1 / abs(before).where(before != 0)
    elif "units" in before.attrs:
        about["units"] = before.attrs["units"]
    data = {name: (after - before) * scale}
    if error in a and error in b:
        of_before = a[error].reset_coords(drop=True)
        of_after = b[error].reset_coords(drop=True)
        if relative:
            of_before = of_before * after * scale
        data[error] = (of_before**2 + of_after**2) ** 0.5 * scale
    for key, values in data.items():
        values.attrs = dict(about)
        if key == error:
            values.attrs["long_name"] = f"standard error of the {about['long_name']}"
    for side, f in (("a", a), ("b", b)):
        data[f"{name}_{side}"] = f[name].reset_coords(drop=True)
        if error in f:
            data[f"{name}_{side}{ERROR}"] = f[error].reset_coords(drop=True)
    return data


def _one_step(f: xr.Dataset) -> xr.Dataset:
    """Return a result without a dimension time of one step."""
    if f.sizes.get("time") == 1:
        return f.squeeze("time", drop=True)
    return f


def _is_beside(name: str, f: xr.Dataset) -> bool:
    """Return whether a variable is the error or bias of another, or no number."""
    is_number = f[name].dtype.kind in "fiu"
    ends = (ERROR, BIAS, f"{ERROR}_from")
    return not is_number or any(name.endswith(end) and name.removesuffix(end) in f for end in ends)


def _require_same_method(a: xr.Dataset, b: xr.Dataset) -> None:
    """Raise ValueError unless two results were made by the same options, in the same frame and units."""
    for name in _OF_METHOD:
        if not _are_equal(a.attrs.get(name), b.attrs.get(name)):
            raise ValueError(
                f"compare: {name} is {plain(a.attrs.get(name))} in a and {plain(b.attrs.get(name))} in "
                "b, so the difference would be one of methods: compute one by the options of the "
                "other, b = other.cg.coarse_grain(fields, like=a)"
            )


def _are_equal(value: Any, other: Any) -> bool:
    if value is None or other is None:
        return value is other
    if np.asarray(value).dtype.kind in "fiu" and np.asarray(other).dtype.kind in "fiu":
        same_shape = np.shape(value) == np.shape(other)
        return same_shape and bool(np.allclose(value, other, rtol=_CLOSE, atol=0))
    return bool(np.all(value == other))


def _require_same_nodes(before: xr.DataArray, after: xr.DataArray) -> None:
    """Raise ValueError unless a field of two results has the same nodes and unit."""
    units = [values.attrs.get("units") for values in (before, after)]
    if units[0] != units[1]:
        raise ValueError(f"compare: {before.name} is in {units[0]!r} in a and in {units[1]!r} in b")
    if {*before.dims} != {*after.dims}:
        raise ValueError(
            f"compare: {before.name} has the dimensions {', '.join(map(str, before.dims))} in a and "
            f"{', '.join(map(str, after.dims))} in b: average both alike, for example over time by "
            "time_average"
        )
    for dim in before.dims:
        nodes, others = before[dim].to_numpy(), after[dim].to_numpy()
        same = nodes.shape == others.shape
        if same and nodes.dtype.kind == "f" and nodes.size:
            room = _CLOSE * max(float(np.abs(nodes).max()), float(np.ptp(nodes)))
            same = bool(np.allclose(nodes, others, rtol=0, atol=room))
        elif same:
            same = bool((nodes == others).all())
        if same:
            continue
        way = "compute one on the nodes of the other, b = other.cg.coarse_grain(fields, like=a)"
        if dim == "time":
            way = "average both over time, time_average(), or select one step of each"
        raise ValueError(
            f"compare: the results differ in {dim}: {_ends(nodes)} in a, {_ends(others)} in b; {way}"
        )


def _ends(nodes: np.ndarray) -> str:
    """Return the number of labels, the first and the last one, as text."""
    if not nodes.size:
        return "none"
    return f"{nodes.size} from {plain(nodes[0])} to {plain(nodes[-1])}"
