"""Width of the kernel with the least error, from bias and noise at several widths."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.analysis.widths import join_widths, with_nodes
from xcg.common import drawing
from xcg.common.checks import POSITIVE, check, whole
from xcg.common.messages import SceneWarning, warn_user
from xcg.fields.coarse_grain import prepare
from xcg.fields.formulas.averages import time_average
from xcg.fields.formulas.field import Quantity
from xcg.fields.grids.frames import refuse_cylindrical
from xcg.fields.request import SharedOptions, takes
from xcg.fields.sums.kernels import Kernel, kernel_of, resolve_length
from xcg.scene.scene import Scene
from xcg.steps.labels import labelled_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDTHS = tuple(f"{0.5 * 2 ** (k / 2):.4g} d43" for k in range(7))
KNOWN = 0.9  # share of the particles at nodes where a field is known, least
INTERVALS = 240  # between the widths, where bias and noise are interpolated as powers of the width
ENDS = {0: "the narrowest of those compared", INTERVALS: "the widest of those compared"}
_COUNT = "number_density"


@dataclass(frozen=True)
class ChoiceRequest(SharedOptions):
    """Arguments of `choose_width`.

    Parameters
    ----------
    fields : str, quantity, or list of these
        Names of fields, or quantities, as in `coarse_grain`.
    at : mapping, optional
        Coordinate of fixed axes (m), or points, as in `coarse_grain`.
    frames : int, optional
        Number of frames that the fields will be averaged over; all frames of the scene by default.
    target : float
        Largest error wanted, relative to the size of each field.
    widths : list of float or str
        Three or more widths to measure at (m), or multiples of sizes; by default seven from 0.5 to
        4 d43.
    sample : int
        Number of frames, spread over the scene, that bias and noise are measured on.
    """

    fields: str | Quantity | Sequence[str | Quantity]
    _: KW_ONLY
    at: Mapping[str, float | xr.DataArray] | None = None
    frames: int | None = None
    target: float = 0.02
    widths: Sequence[float | str] = WIDTHS
    sample: int = 8

    def __post_init__(self) -> None:
        super().__post_init__()
        check("frames", self.frames, whole(1), optional=True)
        check("sample", self.sample, whole(1))
        check("target", self.target, POSITIVE, hint=", such as 0.02")


@takes(ChoiceRequest)
def choose_width(scene: Scene, request: ChoiceRequest) -> xr.Dataset:
    """Choose the width of the kernel with the least error, from bias and noise at several widths.

    Computes: reads `sample` frames once. `plot_width` draws the result.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene.
    {arguments}

    Returns
    -------
    xarray.Dataset
        With the dimension ``width`` (m), relative to the root mean square of each field:
        ``<field>_bias``, ``<field>_noise`` of one frame, ``<field>_total``, the error of the
        average over `frames` frames, and ``total``, the largest of the fields'. All are root mean
        squares over the nodes, weighted by the number of particles; NaN where more than a tenth of
        the particles are at nodes where the field is unknown. As numbers: ``best_width`` (m) with
        ``best_bias``, ``best_noise`` (of the average) and ``best_total``; ``best_spacing`` (m), the
        widest spacing at which linear interpolation between nodes adds less than 5 % to the error;
        ``target_width`` (m) and ``target_frames``, the width that reaches `target` with the fewest
        frames and their number, NaN where none does.

    Raises
    ------
    ValueError
        If an argument is wrong, or a field without an error of a single frame (a density, contact
        stress) is asked for in a scene of one frame.

    Warns
    -----
    SceneWarning
        If the error is least at an end of the widths that are compared.

    Notes
    -----
    A narrow kernel sees few particles, a wide one smears gradients. The error of the average over n
    frames is ``sqrt(bias(w)^2 + noise(w)^2 / n)``. The bias comes from the differences between
    neighbouring widths, less their noise, as a power of the width that is fitted to them: 2 in
    smooth flow, as `width_sweep` assumes at each node, and about 1 where walls or jumps lead. The
    noise is the error of one frame (``coarse_grain(errors=True)``) or the scatter of the frames,
    whichever is larger: slow changes of the flow count as noise. Both are interpolated as powers of
    the width.

    Examples
    --------
    >>> import xcg
    >>> flow = xcg.datasets.open("plane_shear")
    >>> found = choose_width(flow, "velocity", axes="z", widths=[0.15, 0.3, 0.5])
    >>> sorted(found.sizes)
    ['width']
    """
    scene, request = prepare(scene, request)
    refuse_cylindrical(scene.ds, "choose_width")
    count = scene.ds.sizes.get("time", 1)
    widths = sorted({resolve_length("width", width, scene.sizes) for width in request.widths})
    if len(widths) < 3:
        raise ValueError(
            f"widths={list(request.widths)!r}: expected three or more different widths"
        )
    sample = np.unique(
        np.linspace(0, count - 1, min(count, int(request.sample))).round().astype(int)
    )
    sampled = Scene(scene.ds.isel(time=sample, missing_dims="ignore"))
    mean, names, dimensions = _averages(sampled, request, widths)
    frames = request.frames or count
    errors: dict[str, NDArray] = {}
    for name in names:
        bias, noise = _bias_and_noise(mean, name, dimensions)
        noise = noise * math.sqrt(len(sample))
        errors[f"{name}_bias"] = bias
        errors[f"{name}_noise"] = noise
        errors[f"{name}_total"] = np.hypot(bias, noise / frames**0.5)
    about = {name: {"units": "1", "long_name": name.replace("_", " ")} for name in errors}
    errors["total"] = np.max([errors[f"{name}_total"] for name in names], axis=0)
    about["total"] = {"units": "1", "long_name": "largest total of the fields"}
    out = xr.Dataset(
        {name: ("width", values, about[name]) for name, values in errors.items()},
        {"width": mean["width"]},
        {"frames": frames, "sampled_frames": len(sample), "target": request.target},
    )
    kernel = kernel_of(request.kernel, widths[0], {}, scene.setup.dimension)
    return out.assign(_choice(out, names, kernel))


def _averages(
    scene: Scene, request: ChoiceRequest, widths: Sequence[float]
) -> tuple[xr.Dataset, list[str], int]:
    """Averages over the frames at all widths with their errors, the names of the fields, and the axes of the kernel."""
    wanted: Any = request.fields
    if isinstance(wanted, str | Quantity):
        wanted = [wanted]
    at = request.at or {}
    axes = request.axes or ""
    if request.axes is None and request.at is None:
        axes = scene.setup.plane
    if axes:
        # nodes in a volume lie apart, or the widest kernel would reach too many
        spacing = widths[0] * (widths[-1] / widths[0]) ** ((len(axes) - 1) / 4)
        request = replace(request, axes=axes, spacing=request.spacing or spacing)
        request = with_nodes(scene, request, widths[:1], at)
    moving = "velocity" in scene.columns  # a velocity has an error beside fields without one
    fields = list(dict.fromkeys([*wanted, _COUNT, *["velocity"] * moving]))
    ask = partial(
        request.as_request, fields=fields, at=request.at, errors=moving, for_averages=True
    )
    f = join_widths(scene, widths, ask).compute()
    wanted_names = [getattr(field, "name", field) for field in wanted]
    names = [name for name in map(str, f.data_vars) if name in wanted_names]
    lone = [name for name in names if f"{name}_error" not in f]
    if lone and f.sizes.get("time", 1) < 2:
        raise ValueError(
            f"choose_width: {', '.join(lone)} has no error of a single frame: take sample=2 or more, of a scene "
            "with as many frames, or choose by a field with an error, such as velocity"
        )
    return time_average(f).assign_coords(width=f["width"]), names, len(axes) + len(at)


def _bias_and_noise(mean: xr.Dataset, name: str, dimensions: int) -> tuple[NDArray, NDArray]:
    """Bias and noise of an average at each width, relative to the size of the field."""
    field = mean[name]
    error = mean[f"{name}_error"]
    widths = mean["width"].to_numpy()
    parts = [dim for dim in ("component", "direction", "other_phase") if dim in field.dims]
    count = mean[_COUNT].isel(width=len(widths) // 2, drop=True)
    node_dims = list(count.dims)

    def mean_square(values: xr.DataArray) -> NDArray:
        squares = (values**2).sum(parts, skipna=False)
        counted = count.where(squares.notnull(), 0.0)
        particles = counted.sum(node_dims)
        enough = particles.where(particles >= KNOWN * count.sum())
        return ((squares * counted).sum(node_dims) / enough).transpose("width").to_numpy()

    noise = mean_square(error)
    change = mean_square(field.diff("width", label="lower"))
    # less the noise of the difference: of Gaussians, the noise at two widths is correlated by this
    correlation = (2 * widths[1:] * widths[:-1] / (widths[1:] ** 2 + widths[:-1] ** 2)) ** (
        dimensions / 2
    )
    change -= noise[1:] + noise[:-1] - 2 * correlation * np.sqrt(noise[1:] * noise[:-1])
    bias = _integrate(np.fmin.accumulate(np.clip(change, 0.0, None)[::-1])[::-1] ** 0.5, widths)
    size = mean_square(field)[len(widths) // 2 :]
    scale = next((square for square in size if np.isfinite(square)), 0.0) or np.nan
    return bias / np.sqrt(scale), np.sqrt(noise / scale)


def _integrate(change: NDArray, widths: NDArray) -> NDArray:
    """Return the bias of each width from its changes between widths: a power of the width that is fitted to them.

    The power is 2 where fields are smooth, 1 or less where they end or jump; ``change_k = c
    (w_k+1^p - w_k^p)``.
    """
    rises = change > 0
    power = 2.0
    if rises.sum() > 1:
        powers = np.linspace(0.3, 2.0, 86)
        power = min(powers, key=lambda p: np.var(np.log(change[rises] / np.diff(widths**p)[rises])))
    level = change / np.diff(widths**power)
    return np.append(level, level[-1]) * widths**power


def _choice(errors: xr.Dataset, names: Sequence[str], kernel: Kernel) -> dict[str, xr.DataArray]:
    """Return the best width with its errors and spacing, and the width and number of frames that reach the target."""
    frames = errors.attrs["frames"]
    target = errors.attrs["target"]
    widths = errors["width"].to_numpy()
    fine = np.geomspace(widths[0], widths[-1], INTERVALS + 1)

    def between(name: str) -> NDArray:
        values = np.maximum(errors[name].to_numpy(), 1e-9)
        return np.exp(np.interp(np.log(fine), np.log(widths), np.log(values)))

    biases = np.stack([between(f"{name}_bias") for name in names])
    noises = np.stack([between(f"{name}_noise") for name in names])
    totals = np.hypot(biases, noises / math.sqrt(frames))
    worst = totals.max(axis=0)
    needed = (noises**2 / np.maximum(target**2 - biases**2, 1e-300)).max(axis=0)
    needed = np.where((biases < target).all(axis=0) & np.isfinite(needed), np.ceil(needed), np.nan)
    if not np.isfinite(worst).any():
        raise ValueError(
            f"choose_width: {', '.join(names)} cannot be judged at any width: unknown at more than a tenth of the "
            "particles, or zero everywhere; choose by other fields, or measure at wider widths="
        )
    best = int(np.nanargmin(worst))
    fewest = int(np.lexsort((worst, needed))[0])
    text = "width with the least error"
    if best in ENDS:
        text = f"{text}, {ENDS[best]}"
        _warn_of_the_end(best, names, float(worst[best]), float(fine[best]))
    leading = int(totals[:, best].argmax())
    bias = biases[leading, best]
    noise = noises[leading, best] / math.sqrt(frames)
    total = worst[best]
    # between nodes h apart, linear interpolation is off by h^2 f'' / sqrt(120), f'' = 2 bias / mu_2
    second_moment = kernel.second_moment(kernel.dimension or 3)
    second_moment *= (fine[best] / kernel.width) ** 2
    spacing = math.sqrt(math.sqrt(120) * second_moment * 0.32 * total / (2 * bias))
    spacing = min(spacing, 2 * fine[best])
    target_width = np.where(needed > 0, fine, np.nan)[fewest]
    unit = errors["width"].attrs["units"]
    table = {
        "best_width": (fine[best], unit, text),
        "best_bias": (bias, "1", "relative bias at the best width"),
        "best_noise": (noise, "1", f"relative noise, mean of {frames} frames"),
        "best_total": (total, "1", "relative error at the best width"),
        "best_spacing": (spacing, unit, "widest spacing of nodes for linear interpolation"),
        "target_width": (target_width, unit, f"width to reach an error of {target:g}"),
        "target_frames": (needed[fewest], "1", f"frames to reach an error of {target:g}"),
    }
    return labelled_table(table)


def _warn_of_the_end(best: int, names: Sequence[str], error: float, width: float) -> None:
    """Warn that the width with the least error is the first or the last of those compared."""
    side = "wider"
    walls = ""
    if best == 0:
        side = "narrower"
        walls = (
            ". Where the field jumps at walls, as a velocity that slips, no width is right: leave them "
            "out with bounds="
        )
    warn_user(
        SceneWarning(
            f"choose_width: the error of {', '.join(names)} is least, {error:.2g}, at {width:.3g}, "
            f"{ENDS[best]}; a {side} one may be better: extend widths= to that side{walls}"
        )
    )


def plot_width(found: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Draw bias, noise and total error against width, with the best width marked.

    Parameters
    ----------
    found : xarray.Dataset
        A result of `choose_width`.
    ax : matplotlib.axes.Axes, optional
        Axes to draw into; new ones by default.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ValueError
        If the Dataset is not a result of `choose_width`.
    """
    if "best_width" not in found:
        raise ValueError("plot_width expects a result of ds.cg.choose_width(...)")
    ax = ax or drawing.new_axes()
    frames = found.attrs["frames"]
    width = found["width"]
    biases = [str(n) for n in found if str(n).endswith("_bias") and n != "best_bias"]
    names = [name.removesuffix("_bias") for name in biases]
    for k, name in enumerate(names):
        what = name.replace("_", " ")
        for label, values, style in (
            (f"bias of {what}", found[f"{name}_bias"], "--"),
            (f"noise of {what}", found[f"{name}_noise"] / math.sqrt(frames), ":"),
            (f"{what}, total", found[f"{name}_total"], "-"),
        ):
            ax.plot(width, values.where(values > 0), style, color=f"C{k}", marker=".", label=label)
    best = found["best_width"].item()
    ax.axvline(best, color="0.5", lw=1)
    label = f"best width, {best:.3g} {width.attrs['units']}".removesuffix(" 1")
    ax.plot(best, found["best_total"].item(), "o", mfc="none", mec="k", ms=9, label=label)
    ax.set(xscale="log", yscale="log")
    ax.locator_params("y", subs=(1.0, 2.0, 5.0))
    ax.yaxis.set_major_formatter("{x:g}")
    ax.set_xticks(width.to_numpy(), [f"{w:.3g}" for w in width.to_numpy()])
    ax.minorticks_off()
    drawing.set_label(ax.xaxis, drawing.with_unit("width", width.attrs["units"]))
    drawing.set_label(ax.yaxis, f"relative error, mean of {frames} frame{'s' * (frames > 1)}")
    ax.legend(frameon=False, fontsize="small")
    return ax
