"""Fields against the width of the kernel: their bias, and their plateau."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from xcg.common.checks import NOT_NEGATIVE, check
from xcg.fields.coarse_grain import AnyRequest, answer, prepare
from xcg.fields.formulas.field import Quantity
from xcg.fields.grids.frames import refuse_cylindrical
from xcg.fields.plan import make_plan
from xcg.fields.request import Request, SharedOptions, takes
from xcg.fields.sums.kernels import resolve_length
from xcg.scene.facts import SETUP, with_setup
from xcg.scene.scene import Scene
from xcg.scene.schema import units_in
from xcg.steps.labels import labelled_table, provenance


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
        Points: one number an axis, or lists of the same length, one entry a point (dimension
        ``point``), or DataArrays as in `coarse_grain`. Axes not named are averaged, unless ``axes``
        resolves them; None averages over the whole box.
    max_slope : float
        Largest logarithmic slope of a plateau; 0.1 changes a field by 7 % when the width doubles.
    max_bias : float
        Largest bias of a width that is not too wide, relative to the largest value of the field.
    """

    widths: Sequence[float | str]
    fields: str | Quantity | Sequence[str | Quantity] | None = None
    _: KW_ONLY
    at: Mapping[str, ArrayLike | xr.DataArray] | None = None
    max_slope: float = 0.1
    max_bias: float = 0.1

    def __post_init__(self) -> None:
        super().__post_init__()
        check("max_slope", self.max_slope, NOT_NEGATIVE)
        check("max_bias", self.max_bias, NOT_NEGATIVE)


@takes(SweepRequest)
def width_sweep(scene: Scene, request: SweepRequest) -> xr.Dataset:
    """Coarse-grain with several widths: the bias of each width, and the plateau of each field.

    The plateau is where the logarithmic slope ``|d ln f / d ln w|`` is smallest, if it is below
    `max_slope` there; it takes three widths or more. Lazy where the scene is; computed in one go,
    all widths share one pass over the files.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene.
    {arguments}

    Returns
    -------
    xarray.Dataset
        The fields with the dimension ``width`` (m), and for each ``<field>_bias``, what the width
        adds to the field by smearing it; ``<field>_extrapolated``, the field less its bias;
        ``<field>_too_wide``, whether the bias exceeds `max_bias` times the largest value of the
        field in the step. Of three widths or more also ``<field>_slope``, ``<field>_plateau_width``
        (m, NaN without a plateau) and ``<field>_plateau`` (the value there).

    Raises
    ------
    ValueError
        If there are fewer than two different widths, or an argument of `coarse_grain` is wrong.

    Notes
    -----
    A kernel of the width w smears a field f to ``f_w = f + (mu_2 / 2) laplace f + O(w^4)``, its
    second moment ``mu_2`` in proportion to w^2. Two widths give the bias ``f_w - f = (f_w' - f_w)
    w^2 / (w'^2 - w^2)``, of each width with the next wider one (the widest with the one before). It
    is right to a third where it is below a fifth of the field; beside walls, surfaces and bands
    thinner than the width it is large, but no more than a sign that the width is too large there.
    The noise of few grains adds to it: compare with the errors of the field (``errors=True``).
    """
    lengths = sorted({resolve_length("width", width, scene.sizes) for width in request.widths})
    if len(lengths) < 2:
        raise ValueError(f"widths={list(request.widths)!r}: expected two or more different widths")
    points, along = _points(request.at)
    call = request.call("width_sweep")
    scene, request = prepare(scene, request)
    refuse_cylindrical(scene.ds, "width_sweep")
    request = replace(request, axes=request.axes or "")
    if request.axes:
        request = with_nodes(scene, request, lengths, points[0])
    swept = []
    for point in points:
        ask = partial(request.as_request, fields=request.fields, at=point, for_averages=False)
        swept.append(join_widths(scene, lengths, ask))
    joined = swept[0]
    if along:
        joined = xr.concat(swept, "point", coords="different", compat="equals")
    joined = joined.transpose("width", *along, ...)
    if joined.chunks:
        joined = joined.chunk({"width": -1})
    widths = np.array(lengths)
    more: dict[str, xr.DataArray] = {}
    for field in map(str, joined.data_vars):
        more |= _bias(field, joined[field], widths, request.max_bias)
        if len(lengths) > 2:
            more |= _plateau(field, joined[field], widths, request.max_slope)
    return joined.assign(more).assign_attrs(provenance(scene.ds, call))


def _points(
    at: Mapping[str, ArrayLike | xr.DataArray] | None,
) -> tuple[list[Mapping[str, Any]], list[str]]:
    """Points as single `at` mappings, and their dimension if there are several.

    DataArrays name all points at once.
    """
    if not at:
        return [{}], []
    if any(isinstance(values, xr.DataArray) and values.ndim for values in at.values()):
        return [at], []
    shapes = {axis: np.shape(values) for axis, values in at.items()}
    shape, *others = set(shapes.values())
    if others or len(shape) > 1:
        raise ValueError(
            f"at has shapes {shapes}: expected one number an axis, or lists of the same length, one entry a point"
        )
    places = np.column_stack([np.asarray(values, float) for values in at.values()])
    points: list[Mapping[str, Any]] = []
    for place in places.tolist():
        points.append(dict(zip(at, place, strict=True)))
    return points, ["point"] * len(shape)


def join_widths(scene: Scene, widths: Sequence[float], ask: Callable[..., Request]) -> xr.Dataset:
    """Coarse-grain a prepared scene with each of the widths (m): fields with the dimension width."""
    along = xr.Variable("width", widths, {"long_name": "width of the kernel"})
    # their setups differ in the width, which becomes a dimension
    fields = [answer(scene, ask(width=width)).drop_vars(["width", SETUP]) for width in widths]
    joined = xr.concat(fields, along, join="override")
    joined["width"].attrs["units"] = units_in("m", joined.attrs.get("unit_system", "SI"))
    for name in ("width", "cutoff"):
        joined.attrs.pop(name, None)
    return with_setup(joined)


def with_nodes(
    scene: Scene, request: AnyRequest, widths: Sequence[float], point: Mapping[str, Any]
) -> AnyRequest:
    """Keep nodes where they are for all widths: as close as the narrowest takes, as far as the widest reaches."""
    spacing = request.spacing
    if spacing is None:
        spacing = widths[0]
    if request.bounds is not None:
        return replace(request, spacing=spacing)
    placing = Request(
        "number_density",
        width=widths[-1],
        at=point,
        axes=request.axes,
        spacing=spacing,
        kernel=request.kernel,
        extent=request.extent,
    )
    nodes = make_plan(scene, placing).nodes
    ends = {a: tuple(nodes.coords[a].to_numpy()[[0, -1]].tolist()) for a in nodes.axes}
    return replace(request, spacing=spacing, bounds=ends)


def _bias(
    name: str, field: xr.DataArray, widths: NDArray, max_bias: float
) -> dict[str, xr.DataArray]:
    """Bias of a field in proportion to w^2, the field without it, and where it exceeds a share of the largest value."""
    squares = xr.DataArray(widths**2, {"width": widths}, "width")
    level = field.diff("width", label="lower") / squares.diff("width", label="lower")
    bias = (level.reindex(width=widths, method="ffill") * squares).transpose(*field.dims)
    parts = [dim for dim in ("component", "direction") if dim in field.dims]
    others = ("width", "time", "phase", "other_phase", *parts)
    node_dims = [dim for dim in field.dims if dim not in others]
    size = (bias**2).sum(parts, skipna=False) ** 0.5
    largest = ((field**2).sum(parts, skipna=False) ** 0.5).max(node_dims)
    what = field.attrs.get("long_name", name)
    units = field.attrs.get("units", "1")
    share = f"more than {max_bias:g} of its largest value"
    return labelled_table(
        {
            f"{name}_bias": (bias, units, f"bias of {what} by the width of the kernel"),
            f"{name}_extrapolated": (field - bias, units, f"{what} without the bias of the width"),
            f"{name}_too_wide": (
                size > max_bias * largest,
                "1",
                f"whether the width smears {what} by {share}",
            ),
        }
    )


def _plateau(
    name: str, field: xr.DataArray, widths: NDArray, max_slope: float
) -> dict[str, xr.DataArray]:
    """Slope of a field, and width and value where it is smallest."""
    # d ln f / d ln w = (w / f) df / dw, which also holds where f is negative
    by_width = field.assign_coords(width=np.log(widths)).differentiate("width")
    slope = abs(by_width.assign_coords(width=widths) / field.where(field != 0))
    # the ends have one neighbour only: no plateau is told from them
    inside = slope.where((slope.width > widths[0]) & (slope.width < widths[-1])).fillna(np.inf)
    numbers = xr.DataArray(np.arange(len(widths)), {"width": widths}, "width")
    best = (numbers == inside.argmin("width")) & (inside.min("width") < max_slope)
    value = field.where(best).sum("width", min_count=1)
    width = inside.width.where(best).sum("width", min_count=1)
    unit = field.coords["width"].attrs.get("units", "m")
    what = field.attrs.get("long_name", name)
    value = value.assign_attrs(field.attrs, long_name=f"{what} at its plateau")
    return labelled_table(
        {
            f"{name}_slope": (slope, "1", f"size of the logarithmic slope of {what} by width"),
            f"{name}_plateau_width": (width, unit, f"width at the plateau of {what}"),
        }
    ) | {f"{name}_plateau": value}
