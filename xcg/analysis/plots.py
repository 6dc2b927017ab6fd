"""Pictures and movies of results: profiles with their errors, maps with arrows."""

from __future__ import annotations

import inspect
import os
import shutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypeVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.analysis.compare import COMPARED, ERROR
from xcg.analysis.film import Film
from xcg.analysis.fit_law import CURVE, draw_fit
from xcg.analysis.grain_plots import draw_grains
from xcg.common import drawing
from xcg.common.checks import POSITIVE, check, check_choice, extra
from xcg.common.messages import did_you_mean, unknown
from xcg.fields.formulas.field import Options
from xcg.fields.formulas.registry import FIELDS, OTHER_NAMES, REGISTERED, order_of
from xcg.scene.facts import with_present_names
from xcg.scene.frame import require_steps, step_at, with_time
from xcg.scene.schema import COMPONENTS, NUMBERED
from xcg.steps.mapping import each_step, shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes

T = TypeVar("T", xr.Dataset, xr.DataArray)
Shading: TypeAlias = Literal["smooth", "flat"]

ARROWS = 20  # along the longer axis of a map
AT_REST = 0.1  # of the speed whose arrow fills its place: slower ones have no arrow
FASTEST = 98  # percentile of that speed, so that single grains do not make all other arrows short
NARROW = 2.0  # inches of a map, in which numbers below it may run into each other
LOWEST = 1.0  # inches of a colour bar, in which its label can be read
BESIDE = 0.8  # of the width that is left of a map beside its colour bar, about
FRAME = (7.0, 5.0)  # inches of a movie
_DENSITIES = ("sample_count", "density", "volume_fraction", "number_density")
_ARROW = "arrow_"
_AXES = ("r", "theta", *COMPONENTS)  # in the order in which maps have them across and up
PLACES = ("time", "phase", *_AXES)  # coordinates that titles name
CIRCLE = ("r", "theta")  # axes of maps in the plane of a circle
UNROLLED = ("theta", "z")  # of maps of an angle and a length, which have any ratio


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
        drawing.set_title(ax, place_of(picture))
        return ax
    if CURVE in f:
        return draw_fit(f, ax or drawing.new_axes(), **options)
    choice = _Shown(field, component, direction, phase, at, arrows, shading)
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
    frames = _Frames.of([numbers], shading, ends, options)
    (picture,) = frames.pictures
    ax = ax or drawing.new_axes(ratio=frames.ratio)
    try:
        frames.draw(picture, ax)
    except AttributeError as error:  # of matplotlib, about keywords
        raise TypeError(f"plot: {error}") from None
    drawing.set_title(ax, place_of(picture))
    return ax


def _plot_compared(
    f: xr.Dataset,
    choice: _Shown,
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
    before, after = (choice.picture(_side_of(f, side), index) for side in ("a", "b"))
    # the difference of densities is zero where both runs have the same, and not in air alone
    others = [other for other in _DENSITIES if other != name]
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
        frames = _Frames.of([after, before], choice.shading, ends, options)
        wide, high = drawing.size_of_figure((wide, high), frames.ratio or 1.0)
        figure, axes = pyplot.subplots(1, 3, figsize=(2.6 * wide, high), layout=drawing.layout())
        frames.draw(before, axes[0])
        frames.draw(after, axes[1])  # with the colour bar of both
        _plot_step(difference, choice.shading, axes[2], dict.fromkeys(ends), {})
        axes[1].setplace_of("b")
    axes[0].setplace_of("a" if len(axes) == 3 else "a and b")
    axes[-1].setplace_of("b \N{MINUS SIGN} a")
    if title := place_of(difference):
        figure.suptitle(title)
    return axes[-1]


def _side_of(f: xr.Dataset, side: str) -> xr.Dataset:
    """Return the values of one side of a comparison under the names of their fields."""
    names: dict[str, str] = {}
    for name in f.attrs[COMPARED].split():
        names |= {f"{name}_{side}{end}": f"{name}{end}" for end in ("", ERROR)}
    return f[[name for name in names if name in f]].rename({n: names[n] for n in names if n in f})


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
    known = [name for name in inspect.signature(plot).parameters if len(name) > 2]
    for name in options:
        if name in _OTHER_OPTIONS:
            raise TypeError(f"plot has no argument {name!r}: {_OTHER_OPTIONS[name]}")
        if near := did_you_mean(name, known, 0.8):
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


def movie(
    f: xr.Dataset,
    path: str | os.PathLike[str],
    field: str | None = None,
    *,
    component: str | None = None,
    direction: str | None = None,
    phase: int | str | None = None,
    at: Mapping[str, float] | None = None,
    arrows: str | None = "auto",
    shading: Shading = "smooth",
    fps: float = 10.0,
    dpi: float = 120.0,
    progress: bool | None = None,
    cmap: str | None = None,
    vmin: float | None = None,
    vmax: float | None = None,
) -> Path:
    """Write a movie of one field: the picture of `plot` for each step, with the same axes and colours in all of them.

    Parameters
    ----------
    f : xarray.Dataset
        A result with several steps, lazy or in memory. What is drawn of all steps is held in
        memory.
    path : str or path
        ``*.gif``, or ``*.mp4``, which needs the program ffmpeg (``pip install imageio-ffmpeg``). A
        file of this name is replaced.
    field, component, direction, phase, at, arrows, shading, cmap, vmin, vmax
        As in `plot`; all steps share the ends of the colours.
    fps : float
        Steps in a second.
    dpi : float
        Dots in an inch; a frame is up to 7 by 5 inches, or 7 inches high where a map is tall.
    progress : bool, optional
        Show the progress on the standard error; by default in a terminal or notebook where it takes
        long.

    Returns
    -------
    pathlib.Path
        The file.

    Raises
    ------
    ImportError
        If matplotlib is not installed.
    OSError
        If there is neither ffmpeg nor imageio-ffmpeg, for mp4.
    ValueError
        If the result has no dimension ``time``, the name ends otherwise, or as in `plot`.
    """
    path = Path(path)
    if path.suffix not in (".gif", ".mp4"):
        raise ValueError(f"{path}: expected a name that ends with .gif or .mp4")
    check("fps", fps, POSITIVE)
    check("dpi", dpi, POSITIVE)
    matplotlib = extra("matplotlib", "plot", "a movie")
    maps = matplotlib.colormaps
    if cmap is not None and not (isinstance(cmap, str) and cmap in maps):
        raise ValueError(
            unknown("colour map", cmap, maps, "others are listed by matplotlib.colormaps")
        )
    f = with_time(f)
    if "time" not in f.dims:
        raise ValueError(
            "movie needs a result with the dimension 'time'; draw a single step with plot"
        )
    require_steps(f, "movie")
    animation = extra("matplotlib.animation", "plot", "a movie")
    program = "pillow"
    settings = {}
    if path.suffix == ".mp4":
        program = "ffmpeg"
        settings["animation.ffmpeg_path"] = _ffmpeg(path)
    choice = _Shown(field, component, direction, phase, at, arrows, shading)
    part = choice.part(f)
    count = part.sizes["time"]
    steps = []
    with shown(count, progress, what="steps computed") as bar:
        for step in each_step(part):
            steps.append(choice.step(step, 0))
            bar.update()
    ends = {"cmap": cmap, "vmin": vmin, "vmax": vmax}
    frames = _Frames.of(_without_empty_parts(steps, f), shading, ends, {})
    size = FRAME
    if frames.ratio is not None:
        size = drawing.size_of_figure(FRAME, frames.ratio)
    film = Film(size, dpi)
    part_of_file = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        with (
            shown(count, progress, what="frames drawn") as bar,
            matplotlib.rc_context(settings),
        ):
            writer = animation.writers[program](fps=fps)
            with writer.saving(film, part_of_file, dpi):
                for picture in frames.pictures:
                    film.clear()
                    frames.draw(picture, film.axes)
                    drawing.set_title(film.axes, place_of(picture))
                    film.draw()
                    writer.grab_frame()
                    bar.update()
        part_of_file.replace(path)
    finally:
        part_of_file.unlink(missing_ok=True)
    return path


def _ffmpeg(path: Path) -> str:
    """Return the program ffmpeg: the one of the system, or the one that imageio-ffmpeg brings along."""
    program = shutil.which(extra("matplotlib", "plot", "a movie").rcParams["animation.ffmpeg_path"])
    if program is not None:
        return program
    try:
        from imageio_ffmpeg import get_ffmpeg_exe

        return str(get_ffmpeg_exe())
    except (ImportError, RuntimeError):  # RuntimeError: without a program for this machine
        raise OSError(
            f"{path}: mp4 needs the program ffmpeg: pip install imageio-ffmpeg, or apt or conda install "
            "ffmpeg; or write a .gif"
        ) from None


# --- what is drawn ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Shown:
    """Numbers of a result that a picture shows, by the arguments of `plot`."""

    field: str | None
    component: str | None
    direction: str | None
    phase: int | str | None
    at: Mapping[str, float] | None
    arrows: str | None
    shading: Shading

    def picture(self, f: xr.Dataset, index: int) -> xr.Dataset:
        """Return the numbers of one step, in memory."""
        step = self.step(self.part(with_time(f)), index).compute()
        (picture,) = _without_empty_parts([step], f)
        return picture

    def step(self, part: xr.Dataset, index: int) -> xr.Dataset:
        """Select a step, and of maps a phase."""
        part = step_at(part, index)
        phase = self.phase
        if phase is None and "phase" in part.dims and len(axes_of(part)) == 2:
            phase = "bulk"
        if phase is None:
            return part
        return _labelled(part, "phase", phase)

    def part(self, f: xr.Dataset) -> xr.Dataset:
        """Return the field, its errors and arrows of all steps and phases; ``attrs["drawn"]`` is its name."""
        check_choice("shading", self.shading, Shading)
        f = with_present_names(f)
        name = self._name_in(f)
        cut = _slice(f, self.at)
        axes = axes_of(cut)
        if not 1 <= len(axes) <= 2 or "point" in cut.dims:
            raise ValueError(_other_way(f, cut[name]))
        value = cut[name]
        if len(axes) == 2:
            value = without_air(cut, name)
        self._check(value, axes, str(f.attrs.get("plane", _AXES)))
        parts = {name: self._component(value, name)}
        error = f"{name}{ERROR}"
        if len(axes) == 1 and error in cut:
            parts[error] = self._component(cut[error], name)
        if len(axes) == 2:
            parts |= self._arrows(cut, axes, parts[name])
            if "component" in parts[name].dims:
                size = (parts[name] ** 2).sum("component", skipna=False) ** 0.5
                text = f"magnitude of {drawing.long_name_of(value, name)}"
                parts[name] = size.assign_attrs(value.attrs, long_name=text)
        return xr.Dataset(parts, attrs={"drawn": name})

    def _name_in(self, f: xr.Dataset) -> str:
        """Return the name of the field; raise ValueError if the result has none."""
        name = self.field or next((str(n) for n in f.data_vars if n != "sample_count"), None)
        if "particle_id" in f:
            raise ValueError(
                "movie draws results, and this is a scene: draw fields, ds.cg.coarse_grain(...).cg.movie(path)"
            )
        if name is not None and name in f:
            return name
        fields = list(map(str, f.data_vars))
        hint = did_you_mean(str(name), fields, synonyms=OTHER_NAMES)
        if name in FIELDS:
            hint = f"; name {name!r} in coarse_grain to get it, or to learn what the scene lacks for it"
        raise ValueError(f"plot({name!r}): the result has {', '.join(fields) or 'no fields'}{hint}")

    def _check(self, value: xr.DataArray, axes: list[str], plane: str) -> None:
        """Raise ValueError for a tensor without a part, and for dimensions that a map has not."""
        if "direction" in value.dims and (self.component is None or self.direction is None):
            labels = [label for label in map(str, value["component"].values) if label in plane]
            raise ValueError(
                f"{value.name} is a tensor: name a part of it, for example component={labels[0]!r}, "
                f"direction={labels[-1]!r}"
            )
        spare = set(value.dims) - {*axes, "time", "phase", "component", "direction"}
        if len(axes) == 2 and spare:
            dim = str(min(spare, key=str))
            raise ValueError(
                f"a map of {value.name} needs one value of its dimension {dim!r}: select it first, f.sel({dim}=...)"
            )

    def _component(self, value: xr.DataArray, name: str) -> xr.DataArray:
        """Select the part of a vector or tensor, and name it."""
        text = drawing.long_name_of(value, name)
        chosen = {"component": self.component, "direction": self.direction}
        labels = {dim: label for dim, label in chosen.items() if label is not None}
        if not labels:
            return value
        for dim, label in labels.items():
            if dim in value.dims and not isinstance(label, str):
                raise TypeError(
                    f"{dim}={label!r}: expected a name, one of {', '.join(map(str, value[dim].values))}"
                )
            value = _labelled(value, dim, label).drop_vars(dim)
        return value.assign_attrs(value.attrs, long_name=f"{text}, {''.join(labels.values())}")

    def _arrows(
        self, cut: xr.Dataset, axes: list[str], value: xr.DataArray
    ) -> dict[str, xr.DataArray]:
        """Return the components that arrows show on a map, if there are any."""
        unrolled = tuple(axes) == UNROLLED  # an angle and a length: arrows would have no direction
        arrows = self.arrows
        if arrows == "auto":
            arrows = None
            if "component" in value.dims and not unrolled:
                arrows = str(value.name)
        if arrows is None:
            return {}
        if unrolled or arrows not in cut or cut[arrows].dims[-1:] != ("component",):
            raise ValueError(
                f"arrows={arrows!r}: expected a vector field of the result, on a map that is not unrolled"
            )
        return {f"{_ARROW}{a}": cut[arrows].sel(component=a, drop=True) for a in axes}


def _other_way(f: xr.Dataset, value: xr.DataArray) -> str:
    """Return the message for a result that has no axes to draw along: xarray may draw it."""
    text = (
        f"plot draws along one or two of {', '.join(_AXES)}; this result has the dimensions "
        f"{', '.join(map(str, f.dims))}"
    )
    dims = [str(dim) for dim in value.dims if dim not in ("component", "direction")]
    if not dims:
        return text
    along = next((dim for dim in dims if dim not in ("time", "phase")), dims[0])
    step = ""
    if "time" in dims and along != "time":
        step = ".isel(time=-1)"
    return f"{text}; xarray draws others, such as f[{value.name!r}]{step}.plot.line(x={along!r})"


def picture_of(
    f: xr.Dataset,
    field: str,
    *,
    index: int = -1,
    component: str | None = None,
    direction: str | None = None,
    phase: int | str | None = None,
    at: Mapping[str, float] | None = None,
    arrows: str | None = None,
) -> xr.Dataset:
    """Return the numbers and arrows that `plot` draws with these arguments, in memory; errors as `plot`.

    Maps have the dimensions (up, across), and profiles that of their axis first.
    """
    picture = _Shown(field, component, direction, phase, at, arrows, "flat").picture(f, index)
    _check_errors(picture)
    return picture.transpose(*axes_of(picture)[::-1], ...)


def without_air(f: xr.Dataset, name: str) -> xr.DataArray:
    """Return a field of a result, NaN at nodes that no grains reach; lazy where the field is.

    Fields that are sums over grains or contacts are zero there. Nodes are taken for air where a
    density of the result is zero. Without a density, they are where such a field is exactly zero,
    also at the next nodes, unless it is zero everywhere.
    """
    value = f[name]
    for density in map(f.get, _DENSITIES):
        if density is None:
            continue
        if "phase" in density.coords and "bulk" not in density["phase"].values.astype(str):
            continue  # a phase may be nowhere where others are
        if "phase" in density.dims:
            density = density.sel(phase="bulk", drop=True)
        if set(density.dims) <= set(value.dims):
            return value.where(density != 0)
    if not _is_sum(name):
        return value
    parts = [dim for dim in ("component", "direction", "other_phase") if dim in value.dims]
    empty = (value == 0).all(parts)
    axes = axes_of(f)
    air = empty & ~empty.all(axes)
    # contacts reach single nodes beyond the rim of the grains: air has no neighbour with a number
    for axis, way in product(axes, (1, -1)):
        air = air & empty.shift({axis: way}, fill_value=True)
    return value.where(~air)


def _is_sum(name: str) -> bool:
    """Return whether a field is made of sums over grains or contacts only, such as the pressure."""
    row = FIELDS.get(name)
    if row is None or row.weight:
        return False
    return row.additive or (bool(row.fields) and all(map(_is_sum, row.fields)))


def _slice(f: xr.Dataset, at: Mapping[str, float] | None) -> xr.Dataset:
    """Cut a result where it is asked for, and a volume through the middle of its shortest axis."""
    if set(at or ()) - set(axes_of(f)):
        raise ValueError(
            f"at={dict(at or {})!r}: the axes of this result are {', '.join(axes_of(f)) or 'none'}"
        )
    cut = f.sel(at or {}, method="nearest")
    if len(axes := axes_of(cut)) < 3:
        return cut
    shortest = min(axes, key=lambda a: abs(float(cut[a][-1] - cut[a][0])))
    return cut.isel({shortest: cut.sizes[shortest] // 2})


def _without_empty_parts(steps: list[xr.Dataset], f: xr.Dataset) -> list[xr.Dataset]:
    """Leave out components that are zero in all steps of a layer: the one across it, of spins those along it."""
    values = [step[step.attrs["drawn"]] for step in steps]
    plane = str(f.attrs.get("plane", "xyz"))
    if len(plane) > 2 or "component" not in values[0].dims:
        return steps
    is_used = np.zeros(values[0].sizes["component"], bool)
    for value in values:
        is_used |= (value != 0).any([dim for dim in value.dims if dim != "component"]).to_numpy()
    if not is_used.any():
        is_used = values[0]["component"].isin([*plane]).to_numpy()
    return [step.isel(component=is_used) for step in steps]


def _labelled(part: T, dim: str, label: int | str) -> T:
    """Select by a label, and refuse one that the result does not have."""
    if dim not in part.dims:
        name = getattr(part, "name", None) or "the result"
        raise ValueError(f"{dim}={label!r}: {name} has no dimension {dim!r}")
    labels = list(map(str, part[dim].to_numpy()))
    if str(label) not in labels:
        raise ValueError(f"{dim}={label!r}: expected one of {', '.join(labels)}")
    return part.isel({dim: labels.index(str(label))})


def axes_of(f: xr.Dataset) -> list[str]:
    """Return the axes of a result in the order in which maps have them: across, then up."""
    return [a for a in _AXES if a in f.dims]


def _known(steps: Iterable[Any]) -> NDArray:
    """Return the finite numbers of all steps."""
    values = np.concatenate([np.ravel(step) for step in steps])
    return values[np.isfinite(values)]


def may_diverge(value: xr.DataArray) -> bool:
    """Return whether a field may be a quotient whose denominator vanishes: by the pressure, or of the user's own."""
    name = str(value.name)
    if name not in FIELDS:
        return "source" not in value.attrs  # sums and means of variables have one
    row = FIELDS[name]
    if row.additive or row.weight:
        return False
    return name in REGISTERED or "pressure" in order_of((name,), Options())


# --- drawing ---------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Frames:
    """Pictures of one field that share axes, colours and their ends.

    Attributes
    ----------
    pictures : list of Dataset
        Numbers of each step, with errors and arrows.
    name : str
        The field.
    axes : list of str
        Across, then up; one of profiles.
    values : array (n,)
        All numbers.
    limits : array (n,) or None
        Numbers that profiles extend over; None lets matplotlib choose.
    keywords : mapping
        Keywords of matplotlib: colours and their ends, and options of the caller.
    fastest : float
        Speed whose arrow is as long as arrows are apart.
    """

    pictures: list[xr.Dataset]
    name: str
    axes: list[str]
    shading: Shading
    values: NDArray
    limits: NDArray | None
    keywords: Mapping[str, Any]
    fastest: float

    @classmethod
    def of(
        cls,
        pictures: list[xr.Dataset],
        shading: Shading,
        ends: Mapping[str, Any],
        options: Mapping[str, Any],
    ) -> _Frames:
        """Find what pictures share; pictures of several steps have the same limits.

        A field that is divided by the pressure, such as the inertial number, is thousands of times
        larger at a free surface than elsewhere: the pictures end before, and their labels say so.
        """
        name = pictures[0].attrs["drawn"]
        axes = axes_of(pictures[0])
        for picture in pictures:
            _check_errors(picture)
        values = _known(picture[name] for picture in pictures)
        drawn = values
        note = ""
        if ends["vmax"] is None and "norm" not in options and may_diverge(pictures[0][name]):
            drawn, note = drawing.without_tail(values)
        if note:
            label = f"{drawing.long_name_of(pictures[0][name], name)}{note}"
            pictures = [p.assign({name: p[name].assign_attrs(long_name=label)}) for p in pictures]
        limits = None
        if note or len(pictures) > 1:
            limits = drawn
        if len(axes) == 1:
            return cls(pictures, name, axes, shading, values, limits, options, 0.0)
        if "color" in options:
            raise TypeError("plot: a map has many colours, and color= is for lines; give cmap=")
        if "norm" in options:
            colours = {"cmap": "viridis"}
            colours |= {end: value for end, value in ends.items() if value is not None}
        else:
            colours = drawing.colours_of(drawn, **ends)
        keywords = {"rasterized": shading == "smooth", **colours, **options}
        fastest = max(map(_fastest, pictures))
        return cls(pictures, name, axes, shading, values, limits, keywords, fastest)

    @property
    def ratio(self) -> float | None:
        """Height over width of a map; None of profiles and unrolled maps, which have any."""
        if len(self.axes) == 1 or tuple(self.axes) == UNROLLED:
            return None
        if tuple(self.axes) == CIRCLE:
            return 1.0
        return drawing.ratio_of(self.pictures[0][self.name].transpose(*self.axes[::-1]))

    def draw(self, picture: xr.Dataset, ax: Axes) -> None:
        """Draw a picture; a map of a figure's first with its colour bar."""
        if len(self.axes) == 1:
            self._draw_profile(picture, ax)
            return
        if tuple(self.axes) == CIRCLE:
            mesh = self._draw_circle(picture.sortby(self.axes), ax)
        else:
            mesh = self._draw_map(picture.sortby(self.axes), ax)
        if picture is self.pictures[0]:
            values = self.values
            if "norm" in self.keywords:  # its ends are those of the drawn numbers
                values = np.ma.compressed(mesh.get_array())
            _draw_colour_bar(picture, self.name, mesh, values)

    def _draw_profile(self, picture: xr.Dataset, ax: Axes) -> None:
        axis = self.axes[0]
        upright = axis == "z"
        fill: Any = ax.fill_between
        limits: Any = ax.get_ylim
        set_limits: Any = ax.set_ylim
        names = [axis, self.name]
        if upright:
            fill = ax.fill_betweenx
            limits = ax.get_xlim
            set_limits = ax.set_xlim
            names.reverse()
        before: Any = ()
        if ax.has_data():
            before = limits()
        nodes = picture[axis].to_numpy()
        value = picture[self.name]
        error = picture.get(f"{self.name}{ERROR}")
        others = [dim for dim in value.dims if dim != axis]
        for labels in product(*(value[dim].to_numpy() for dim in others)):
            place = dict(zip(others, labels, strict=True))
            y = value.sel(place).to_numpy()
            points = [nodes, y]
            if upright:
                points.reverse()
            label = ", ".join(map(str, labels)) or None
            (line,) = ax.plot(*points, **{"label": label, **self.keywords})
            if error is not None:
                e = error.sel(place).to_numpy()
                fill(nodes, y - e, y + e, color=line.get_color(), alpha=0.25, lw=0)
        for name, of_axis in zip(names, (ax.xaxis, ax.yaxis), strict=True):
            drawing.set_label(of_axis, drawing.label_of(picture[name], name))
        if others:
            ax.legend(title=", ".join(map(str, others)))
        if self.limits is not None:
            low, high = drawing.ends_of(np.concatenate([self.limits, before]))
            margin = 0.05 * (high - low)
            set_limits(low - margin, high + margin)

    def _draw_map(self, picture: xr.Dataset, ax: Axes) -> Any:
        across, up = self.axes
        x, y, values = drawing.cells_of(picture[self.name].transpose(up, across), self.shading)
        mesh = ax.pcolormesh(x, y, values, **self.keywords)
        if self.fastest > 0:
            self._draw_arrows(ax, *_arrows_on(picture, across, up))
        if across != "theta":
            ax.set_aspect("equal")
        ax.apply_aspect()
        wide = ax.get_window_extent().width / ax.figure.dpi
        if wide < NARROW:
            ticker = extra("matplotlib.ticker", "plot", "drawing")
            ax.xaxis.set_major_locator(ticker.MaxNLocator(max(1, int(1.5 * wide))))
        drawing.set_label(ax.xaxis, drawing.label_of(picture[across], across))
        drawing.set_label(ax.yaxis, drawing.label_of(picture[up], up))
        return mesh

    def _draw_circle(self, picture: xr.Dataset, ax: Axes) -> Any:
        """Draw a map over r and theta in the plane of the circle, with arrows on a grid of squares."""
        value = picture[self.name].transpose("theta", "r")
        rim, turn, values = drawing.cells_of(value, self.shading)
        rim = rim.clip(0)
        across = rim * np.cos(turn[:, None])
        up = rim * np.sin(turn[:, None])
        mesh = ax.pcolormesh(across, up, values, **self.keywords)
        if self.fastest > 0:
            self._draw_arrows(ax, *_arrows_in_circle(picture, self.name))
        ax.set_aspect("equal")
        unit = drawing.label_of(picture["r"], "r").removeprefix("$r$")
        drawing.set_label(ax.xaxis, rf"$r\,\cos\theta${unit}")
        drawing.set_label(ax.yaxis, rf"$r\,\sin\theta${unit}")
        return mesh

    def _draw_arrows(self, ax: Axes, x: Any, y: Any, along: Any, rise: Any, apart: float) -> None:
        """Draw arrows; the longest are as long as their spacing, and slow places have none."""
        moving = np.hypot(along, rise) >= AT_REST * self.fastest
        ax.quiver(
            x[moving],
            y[moving],
            along[moving],
            rise[moving],
            pivot="mid",
            color="white",
            edgecolor="black",
            linewidth=0.5,
            angles="xy",
            scale_units="xy",
            scale=self.fastest / apart,
            width=0.006,
        )


def _check_errors(picture: xr.Dataset) -> None:
    """Raise ValueError if a standard error is negative: it is the difference of two errors."""
    for name in picture:
        if str(name).endswith(ERROR) and bool((picture[name] < 0).any()):
            raise ValueError(
                f"plot: {name} is negative, {float(picture[name].min()):.3g} at its lowest, and no "
                "standard error is: b - a subtracts errors, too; xcg.compare(a, b) adds them in squares"
            )


def _arrows_on(
    picture: xr.Dataset, across: str, up: str
) -> tuple[NDArray, NDArray, NDArray, NDArray, float]:
    """Return places and components of arrows on a map, (up, across), and how far they are apart."""
    every = max(1, round(max(picture.sizes[a] for a in (across, up)) / ARROWS))
    some = picture.isel({a: slice(every // 2, None, every) for a in (across, up)})
    along = some[f"{_ARROW}{across}"].transpose(up, across).to_numpy()
    rise = some[f"{_ARROW}{up}"].transpose(up, across).to_numpy()
    apart = [float(some[a][1] - some[a][0]) for a in (across, up) if some.sizes[a] > 1]
    x, y = np.meshgrid(some[across], some[up])
    return x, y, along, rise, min(apart, default=1.0)


def _arrows_in_circle(
    picture: xr.Dataset, name: str
) -> tuple[NDArray, NDArray, NDArray, NDArray, float]:
    """Return places and components of arrows as `_arrows_on`, on a grid of squares in the plane of a circle."""
    rim, turn, _ = drawing.cells_of(picture[name].transpose("theta", "r"), "flat")
    apart = 2 * rim[-1] / ARROWS
    line = np.arange(-rim[-1] + apart / 2, rim[-1], apart)
    x, y = (a.ravel() for a in np.meshgrid(line, line))
    away = np.hypot(x, y)
    angle = np.mod(np.arctan2(y, x) - turn[0], 2 * np.pi) + turn[0]
    inside = (away >= rim[0]) & (away <= rim[-1]) & (angle <= turn[-1])
    x, y, away, angle = (a[inside] for a in (x, y, away, angle))
    places = {"r": xr.DataArray(away, dims="arrow"), "theta": xr.DataArray(angle, dims="arrow")}
    nearest = picture.sel(places, method="nearest")
    outward = nearest[f"{_ARROW}r"].to_numpy()
    around = nearest[f"{_ARROW}theta"].to_numpy()
    along = outward * np.cos(angle) - around * np.sin(angle)
    rise = outward * np.sin(angle) + around * np.cos(angle)
    return x, y, along, rise, apart


def segments_of(picture: xr.Dataset, name: str) -> dict[str, NDArray]:
    """Return the ends of the arrows that `plot` draws on a map of `picture_of`: x0, y0, x1, y1."""
    across, up = axes_of(picture)
    picture = picture.sortby([across, up])
    fastest = _fastest(picture)
    if not fastest > 0:
        return {end: np.zeros(0) for end in ("x0", "y0", "x1", "y1")}
    if (across, up) == CIRCLE:
        x, y, along, rise, apart = _arrows_in_circle(picture, name)
    else:
        x, y, along, rise, apart = _arrows_on(picture, across, up)
    moving = np.hypot(along, rise) >= AT_REST * fastest
    half = 0.5 * apart / fastest
    x, y, along, rise = x[moving], y[moving], half * along[moving], half * rise[moving]
    return {"x0": x - along, "y0": y - rise, "x1": x + along, "y1": y + rise}


def _fastest(picture: xr.Dataset) -> float:
    """Return the speed whose arrow is as long as arrows are apart; 0 without arrows."""
    parts = [picture[name].to_numpy() for name in picture if str(name).startswith(_ARROW)]
    if not parts:
        return 0.0
    speeds = _known([np.hypot(*parts)])
    if not speeds.size:
        return 0.0
    return float(np.percentile(speeds, FASTEST))


def _draw_colour_bar(picture: xr.Dataset, name: str, mesh: Any, values: NDArray) -> None:
    """Draw the colour bar of a map, as high as the map."""
    ax = mesh.axes
    room = ax.get_position(original=True).transformed(ax.figure.transSubfigure)
    shrink = 1.0
    if ax.get_aspect() == 1:
        height = BESIDE * room.width * ax.get_data_ratio()
        shrink = min(1.0, max(height, LOWEST * ax.figure.dpi) / room.height)
    drawing.add_colour_bar(mesh, ax, drawing.label_of(picture[name], name), values, shrink=shrink)


def place_of(
    picture: xr.Dataset | xr.DataArray, write: Callable[[str], str] = drawing.unit_text
) -> str:
    """Return the time, the phase and the place of a slice as text, with units as `write` has them."""
    parts = []
    for name in [a for a in PLACES if a in picture.coords and not picture[a].ndim]:
        value = picture[name].item()
        unit = write(str(picture[name].attrs.get("units", "")))
        text = str(value)
        if isinstance(value, float):
            text = f"{value:.4g}"
        if picture[name].attrs.get("long_name") == NUMBERED:
            name = "step"
            text = f"{value:.0f}"
        parts.append(f"{name} = {text} {unit}".rstrip())
    return ", ".join(parts)
