"""Pictures of results: profiles with their errors, maps with arrows, comparisons, and grains of scenes."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import xarray as xr

from xcg.analysis.compare import COMPARED, ERROR
from xcg.analysis.draw_pictures import Frames, title_of
from xcg.analysis.fit_law import CURVE, draw_fit
from xcg.analysis.grain_plots import draw_grains
from xcg.analysis.picture import DENSITIES, Shading, Shown, axes_of
from xcg.common import drawing
from xcg.common.checks import extra
from xcg.common.messages import did_you_mean

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def plot(
    f: xr.Dataset,
    field: str | None = None,
    *,
    index: int = -1,
    component: str | None = None,
    direction: str | None = None,
    phase: int | str | None = None,
    at: Mapping[str, float] | None = None,
    arrows: str | None = "auto",
    shading: Shading = "smooth",
    ax: Axes | None = None,
    cmap: str | None = None,
    vmin: float | None = None,
    vmax: float | None = None,
    **options: Any,
) -> Axes:
    """Draw one field of a result, a profile along one axis or a map over two; or the grains of a scene.

    Profiles show one line for each component of a vector (of a layer, without components that are zero
    everywhere) or for each phase, and a band of one standard error on both sides where the result
    has errors (`time_average`). The axis z stands upright. Maps show numbers as colours, white
    where the field is unknown or no grains are. A map of a vector shows its magnitude, and its
    direction as arrows, which are left out where they would be dots (below a tenth of the 98th
    percentile of all). A map over r and theta lies in the plane of the circle; one over theta and
    z, such as a cylindrical wall, is unrolled and has no arrows. Of a volume, the slice in the
    middle of its shortest axis is drawn.

    Of a comparison (`compare`) both values and the difference are drawn, side by side in maps, and
    one above the other in profiles. Of a fit (`fit_law`) the points, the law and its band of one
    standard error are drawn.

    Grains are circles: of a layer, or the cuts of a plane with the spheres of a volume.
    Their colours show a variable of the particles.

    Parameters
    ----------
    f : xarray.Dataset
        A result with one, two or three axes, or a scene, lazy or in memory. Only what is drawn is
        computed.
    field : str, optional
        Which field; the first one but `sample_count` by default. Of a scene, a variable of the
        particles; grains are grey by default.
    index : int
        Position of the step in time; the last one by default.
    component, direction : str, optional
        "x", "y" or "z" (of a cylinder "r", "theta" or "z"): the part of a vector or tensor to draw.
        A tensor needs both.
    phase : int or str, optional
        Which phase; the bulk by default in maps, all phases in profiles.
    at : mapping, optional
        Where a volume is cut, for example ``{"y": 10.0}`` (m; the nearest nodes are drawn).
    arrows : str, optional
        The vector field that arrows show on a map. By default a map of a vector shows that vector
        ("auto"), and other maps have no arrows; None for no arrows.
    shading : {"smooth", "flat"}
        "smooth" interpolates linearly between the nodes of a map that are known; "flat" gives each
        node one colour.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure by default. Of a comparison only the difference is drawn there.
    cmap : str, optional
        Colours of a map, by the names of matplotlib. By default "viridis", or "RdBu_r" with white
        for zero where both signs matter: of the 2nd and the 98th percentile of the numbers that are
        not zero one is negative, one is positive, and the smaller is at least a tenth of the
        larger.
    vmin, vmax : float, optional
        Ends of the colours of a map; the smallest and largest number by default. If both signs
        matter, one end is minus the other. A field that is divided by the pressure, such as the
        inertial number at a free surface, or that is not of xcg, ends at the 98th, 95th or 90th
        percentile where larger numbers are more than four times the 90th; its label says so, also
        on a profile. `vmax` or a ``norm`` shows all.
    **options
        For matplotlib: of lines, such as ``color`` and ``linewidth``; of maps and grains, such as
        ``norm="log"`` and ``alpha``.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ImportError
        If matplotlib is not installed.
    TypeError
        If matplotlib has no such option.
    ValueError
        If the result has no such field, no axes to draw along, a part has to be named, a standard
        error is negative, or an argument is wrong.

    Examples
    --------
    >>> import xcg
    >>> f = xcg.datasets.random_scene().cg.coarse_grain(axes="xz", at={"y": 2.5}, width=1.0)
    >>> f.cg.plot("pressure")  # doctest: +SKIP
    """
    extra("matplotlib.pyplot", "plot", "drawing")
    _check_options(options)
    ends = {"cmap": cmap, "vmin": vmin, "vmax": vmax}
    if "particle_id" in f:
        _check_grains(direction, phase, arrows, shading)
        try:
            picture, ax = draw_grains(f, field, index, component, at, ax, ends, options)
        except AttributeError as error:  # of matplotlib, about keywords
            raise TypeError(f"plot: {error}") from None
        drawing.set_title(ax, title_of(picture))
        return ax
    if CURVE in f:
        return draw_fit(f, ax or drawing.new_axes(), **options)
    choice = Shown(field, component, direction, phase, at, arrows, shading)
    if COMPARED in f.attrs and ax is None:
        return _plot_compared(f, choice, index, ends, options)
    return _plot_step(choice.picture(f, index), shading, ax, ends, options)


def _plot_step(
    numbers: xr.Dataset,
    shading: Shading,
    ax: Axes | None,
    ends: Mapping[str, Any],
    options: Mapping[str, Any],
) -> Axes:
    """Draw the numbers of one step."""
    frames = Frames.of([numbers], shading, ends, options)
    (picture,) = frames.pictures
    ax = ax or drawing.new_axes(ratio=frames.ratio)
    try:
        frames.draw(picture, ax)
    except AttributeError as error:  # of matplotlib, about keywords
        raise TypeError(f"plot: {error}") from None
    drawing.set_title(ax, title_of(picture))
    return ax


def _plot_compared(
    f: xr.Dataset,
    choice: Shown,
    index: int,
    ends: Mapping[str, Any],
    options: Mapping[str, Any],
) -> Axes:
    """Draw both values of a comparison and their difference in a new figure; return the last axes."""
    compared = f.attrs[COMPARED].split()
    name = choice.field or compared[0]
    if name not in compared:
        return _plot_step(choice.picture(f, index), choice.shading, None, ends, options)
    choice = replace(choice, field=name)
    before = choice.picture(_side_of(f, "a"), index)
    after = choice.picture(_side_of(f, "b"), index)
    # the difference of densities is zero where both runs have the same, and not in air alone
    others = [other for other in DENSITIES if other != name]
    difference = choice.picture(f.drop_vars(others, errors="ignore"), index)
    pyplot = extra("matplotlib.pyplot", "plot", "drawing")
    wide, high = pyplot.rcParams["figure.figsize"]
    if len(axes_of(difference)) == 1:
        figure, axes = pyplot.subplots(1, 2, figsize=(1.6 * wide, high), layout=drawing.layout())
        runs = xr.concat([before, after], xr.Variable("run", ["a", "b"]), combine_attrs="override")
        _plot_step(runs, choice.shading, axes[0], ends, options)
        _plot_step(difference, choice.shading, axes[1], ends, options)
        zero = axes[1].axhline
        if axes_of(difference) == ["z"]:
            zero = axes[1].axvline
        zero(0.0, color="0.5", lw=0.8, zorder=0)
    else:
        frames = Frames.of([after, before], choice.shading, ends, options)
        wide, high = drawing.size_of_figure((wide, high), frames.ratio or 1.0)
        figure, axes = pyplot.subplots(1, 3, figsize=(2.6 * wide, high), layout=drawing.layout())
        frames.draw(before, axes[0])
        frames.draw(after, axes[1])  # with the colour bar of both
        _plot_step(difference, choice.shading, axes[2], dict.fromkeys(ends), {})
        axes[1].set_title("b")
    axes[0].set_title("a" if len(axes) == 3 else "a and b")
    axes[-1].set_title("b \N{MINUS SIGN} a")
    if title := title_of(difference):
        figure.suptitle(title)
    return axes[-1]


def _side_of(f: xr.Dataset, side: str) -> xr.Dataset:
    """Return the values of one side of a comparison under the names of their fields."""
    names = {}
    for name in f.attrs[COMPARED].split():
        for end in ("", ERROR):
            if f"{name}_{side}{end}" in f:
                names[f"{name}_{side}{end}"] = f"{name}{end}"
    return f[list(names)].rename(names)


# Options of other plotting functions, with what to do in place of them.
_OTHER_OPTIONS = {
    "time": "give index=, the position of a step, or select it before, .sel(time=...)",
    "step": "give index=, the position of a step",
    "figsize": "give ax=, from matplotlib.pyplot.subplots(figsize=...)",
    "title": "call set_title on what plot returns",
    "xlabel": "call set_xlabel on what plot returns",
    "ylabel": "call set_ylabel on what plot returns",
    "xlim": "call set_xlim on what plot returns",
    "ylim": "call set_ylim on what plot returns",
    "log": "give norm='log' for colours, or call set_xscale('log') on what plot returns",
    "clim": "give vmin= and vmax=",
    "colormap": "give cmap=",
}


def _check_options(options: Mapping[str, Any]) -> None:
    """Raise TypeError for keywords that are done in another way."""
    names = [name for name in inspect.signature(plot).parameters if len(name) > 2]
    for name in options:
        if name in _OTHER_OPTIONS:
            raise TypeError(f"plot has no argument {name!r}: {_OTHER_OPTIONS[name]}")
        if near := did_you_mean(name, names, 0.8):
            raise TypeError(f"plot has no argument {name!r}{near}")


def _check_grains(
    direction: str | None, phase: int | str | None, arrows: str | None, shading: Shading
) -> None:
    """Raise ValueError for arguments that pictures of grains have not."""
    options = {"direction": direction, "phase": phase, "arrows": arrows, "shading": shading}
    for name, value in options.items():
        if value not in (None, "auto", "smooth"):
            raise ValueError(
                f"{name}={value!r}: this is a scene, whose grains are drawn without it; fields are drawn by "
                "ds.cg.coarse_grain(...).cg.plot()"
            )
