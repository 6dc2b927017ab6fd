"""Fields against the width of the kernel: their bias, and the plateau where they hardly depend on it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from xcg.fields.coarse_grain import Asked, answer, prepare
from xcg.fields.formulas.field import Quantity
from xcg.fields.grids.frames import refuse_cylindrical
from xcg.fields.plan import make_plan
from xcg.fields.request import Request, SharedOptions, takes
from xcg.fields.sums.kernels import resolve_width
from xcg.scene.description import describe

THRESHOLD = 0.1


def _points(at: Mapping[str, ArrayLike | xr.DataArray] | None) -> tuple[list[Mapping[str, Any]], bool]:
    """Points as single `at` mappings, and whether there are several; DataArrays name all points at once."""
    if at is None:
        return [{}], False
    if any(isinstance(values, xr.DataArray) and values.ndim for values in at.values()):
        return [at], False
    columns = {axis: np.asarray(values, float) for axis, values in at.items()}
    if all(values.ndim == 0 for values in columns.values()):
        return [{axis: float(values) for axis, values in columns.items()}], False
    shapes = {axis: values.shape for axis, values in columns.items()}
    if len(set(shapes.values())) > 1 or any(len(shape) != 1 for shape in shapes.values()):
        raise ValueError(
            f"at has shapes {shapes}: expected one number an axis, or lists of the same length, one entry a point"
        )
    rows = zip(*columns.values(), strict=True)
    return [dict(zip(columns, map(float, row), strict=True)) for row in rows], True


@dataclass(frozen=True)
class SweepRequest(SharedOptions):
    """Arguments of `width_sweep`.

    Parameters
    ----------
    widths : list of float or str
        Two or more widths (m), or multiples of sizes such as "0.5 d43".
    fields : str, quantity, or list of these, optional
        Names of fields, or quantities, as in `coarse_grain`.
    at : mapping, optional
        Points: one number an axis, or lists of the same length, one entry a point (dimension ``point``), or DataArrays
        as in `coarse_grain`. Axes not named are averaged, unless ``axes`` resolves them; None averages over the whole
        box.
    threshold : float
        Largest logarithmic slope of a plateau; 0.1 changes a field by 7 % when the width doubles. Also the largest bias
        of a width that is not too wide, relative to the largest value of the field.
    """

    widths: Sequence[float | str]
    fields: str | Quantity | Sequence[str | Quantity] | None = None
    _: KW_ONLY
    at: Mapping[str, ArrayLike | xr.DataArray] | None = None
    threshold: float = THRESHOLD


@takes(SweepRequest)
def width_sweep(ds: xr.Dataset, asked: SweepRequest) -> xr.Dataset:
    """Coarse-grain with several widths: the bias of each width, and the plateau of each field.

    The plateau is where the logarithmic slope ``|d ln f / d ln w|`` is smallest, if it is below `threshold` there; it
    takes three widths or more. Lazy where the scene is; computed in one go, all widths share one pass over the files.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene.
    {arguments}

    Returns
    -------
    xarray.Dataset
        The fields with the dimension ``width`` (m), and for each ``<field>_bias``, what the width adds to the field by
        smearing it; ``<field>_extrapolated``, the field less its bias; ``<field>_too_wide``, whether the bias exceeds
        `threshold` times the largest value of the field in the step. Of three widths or more also ``<field>_slope``,
        ``<field>_plateau_width`` (m, NaN without a plateau) and ``<field>_plateau`` (the value there).

    Raises
    ------
    ValueError
        If there are fewer than two different widths, or an argument of `coarse_grain` is wrong.

    Notes
    -----
    A kernel of the width w smears a field f to ``f_w = f + (mu_2 / 2) laplace f + O(w^4)``, its second moment ``mu_2``
    in proportion to w^2. Two widths give the bias ``f_w - f = (f_w' - f_w) w^2 / (w'^2 - w^2)``, of each width with
    the next wider one (the widest with the one before). It is right to a third where it is below a fifth of the field;
    beside walls, surfaces and bands thinner than the width it is large, but no more than a sign that the width is too
    large there. The noise of few grains adds to it: compare with the errors of the field (``errors=True``).
    """
    measured = describe(ds).sizes
    lengths = sorted({resolve_width(width, measured) for width in asked.widths})
    if len(lengths) < 2:
        raise ValueError(f"widths={list(asked.widths)!r}: expected two or more different widths")
    points, several = _points(asked.at)
    ds, asked = prepare(ds, asked)
    refuse_cylindrical(ds, "width_sweep")
    asked = replace(asked, axes=asked.axes or "")
    if asked.axes:
        asked = with_nodes(ds, asked, lengths, points[0])
    ask = partial(asked.ask, fields=asked.fields)
    swept = [join_widths(ds, [ask(width=width, at=point) for width in lengths]) for point in points]
    joined = xr.concat(swept, "point", coords="different", compat="equals") if several else swept[0]
    joined = joined.transpose("width", *(["point"] if several else []), ...)
    if joined.chunks:
        joined = joined.chunk({"width": -1})
    found: dict[str, xr.DataArray] = {}
    for field in map(str, joined.data_vars):
        found |= _bias(field, joined[field], np.array(lengths), asked.threshold)
        if len(lengths) > 2:
            found |= _plateau(field, joined[field], np.array(lengths), asked.threshold)
    return joined.assign(found)


def join_widths(ds: xr.Dataset, requests: Sequence[Request]) -> xr.Dataset:
    """Coarse-grain a prepared scene with requests that differ in their widths (m): fields with the dimension width."""
    lengths = [request.width for request in requests]
    along = xr.Variable("width", lengths, {"long_name": "width of the kernel"})
    joined = xr.concat([answer(ds, request) for request in requests], along, join="override")
    joined["width"].attrs["units"] = "m" if joined.attrs.get("unit_system", "SI") == "SI" else "1"
    for name in ("width", "cutoff"):
        joined.attrs.pop(name, None)
    return joined


def with_nodes(ds: xr.Dataset, asked: Asked, widths: Sequence[float], point: Mapping[str, Any]) -> Asked:
    """Keep nodes where they are for all widths: as close as the narrowest asks, as far as the widest reaches."""
    spacing = widths[0] if asked.spacing is None else asked.spacing
    if asked.bounds is not None:
        return replace(asked, spacing=spacing)
    placing = Request(
        "number_density", width=widths[-1], at=point, axes=asked.axes, spacing=spacing, kernel=asked.kernel,
        extent=asked.extent, sampling=asked.sampling,
    )  # fmt: skip
    grid = make_plan(describe(ds), placing).deposit.grid
    nodes = {a: grid.coords[a].to_numpy() for a in grid.axes}
    return replace(asked, spacing=spacing, bounds={a: (float(x[0]), float(x[-1])) for a, x in nodes.items()})


def _bias(name: str, field: xr.DataArray, widths: NDArray, threshold: float) -> dict[str, xr.DataArray]:
    """Bias of a field, the field without it, and where it is more than `threshold` times the largest value.

    It is in proportion to w^2, by the difference from the next width, for the last width from the one before.
    """
    squares = xr.DataArray(widths**2, {"width": widths}, "width")
    level = field.diff("width", label="lower") / squares.diff("width", label="lower")
    bias = (level.reindex(width=widths, method="ffill") * squares).transpose(*field.dims)
    parts = [dim for dim in ("component", "direction") if dim in field.dims]
    places = [dim for dim in field.dims if dim not in ("width", "time", "phase", "other_phase", *parts)]
    size, largest = ((values**2).sum(parts, skipna=False) ** 0.5 for values in (bias, field))
    what = field.attrs.get("long_name", name)
    units = {"units": field.attrs.get("units", "1")}
    return {
        f"{name}_bias": bias.assign_attrs(units, long_name=f"bias of {what} by the width of the kernel"),
        f"{name}_extrapolated": (field - bias).assign_attrs(units, long_name=f"{what} without the bias of the width"),
        f"{name}_too_wide": (size > threshold * largest.max(places)).assign_attrs(
            units="1", long_name=f"whether the width smears {what} by more than {threshold:g} of its largest value"
        ),
    }


def _plateau(name: str, field: xr.DataArray, widths: NDArray, threshold: float) -> dict[str, xr.DataArray]:
    """Slope of a field, and width and value where it is smallest."""
    # d ln f / d ln w = (w / f) df / dw, which also holds where f is negative
    by_width = field.assign_coords(width=np.log(widths)).differentiate("width").assign_coords(width=widths)
    slope = abs(by_width / field.where(field != 0))
    # the ends have one neighbour only: no plateau is told from them
    inside = slope.where((slope.width > widths[0]) & (slope.width < widths[-1])).fillna(np.inf)
    flat = inside.min("width") < threshold
    rows = xr.DataArray(np.arange(len(widths)), {"width": widths}, "width")
    best = (rows == inside.argmin("width")) & flat
    value = field.where(best).sum("width", min_count=1)
    width = inside.width.where(best).sum("width", min_count=1)
    unit = field.coords["width"].attrs.get("units", "m")
    what = field.attrs.get("long_name", name)
    return {
        f"{name}_slope": slope.assign_attrs(units="1", long_name=f"logarithmic slope of {what} against width"),
        f"{name}_plateau_width": width.assign_attrs(units=unit, long_name=f"width at the plateau of {what}"),
        f"{name}_plateau": value.assign_attrs(field.attrs, long_name=f"{what} at its plateau"),
    }
