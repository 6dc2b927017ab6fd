"""Pictures that can be chosen of a scene or a result: their numbers, and the Python calls that make them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from typing import Any, Literal, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.analysis.choose_width import WIDTHS as SWEPT
from xcg.analysis.choose_width import choose_width
from xcg.analysis.compare import BIAS, ERROR
from xcg.analysis.grain_plots import circles_of
from xcg.analysis.picture import axes_of, picture_of
from xcg.analysis.widths import width_sweep
from xcg.common import drawing
from xcg.fields.choice import possible_fields, variables_of
from xcg.fields.coarse_grain import coarse_grain
from xcg.fields.formulas.averages import profile
from xcg.fields.formulas.field import Options
from xcg.fields.formulas.registry import FIELDS, listed
from xcg.fields.request import Request
from xcg.scene.conform import conform
from xcg.scene.frame import frame_at, with_time
from xcg.scene.scene import Scene
from xcg.scene.schema import COMPONENTS
from xcg.steps.labels import format_call

View: TypeAlias = Literal["map", "slice", "profile"]
# nodes along the longest axis: more where the kernel is narrower than their spacing, and fewer where
# grains would visit more nodes than this, which takes 0.1 to 0.2 s
NODES = {"map": 80, "slice": 80, "profile": 160}
MOST_NODES = 300
SLICES = 100  # intervals between slices of a scene
VISITS = 2e6
REACH = 2.0  # of Lucy's kernel, in widths
NODES_OF_ERRORS = {"map": 20, "slice": 20, "profile": 80}  # along the longest axis
MOST_GRAINS = 10_000  # circles that a browser draws in a fraction of a second
WIDTHS = tuple(f"{0.75 * 2 ** (k / 4):.3g} d43" for k in range(-6, 11))
USUAL_WIDTH = WIDTHS[6]


@dataclass(frozen=True)
class Choice:
    """Choices of one picture.

    Attributes
    ----------
    field : str
        Name of the field.
    view : {"map", "slice", "profile"}
        A map of a scene or a result averages its third axis; a slice cuts it.
    axes : tuple of str
        Axes of the picture: across and up, or the one of a profile.
    time : int
        Position of the step.
    position : float
        Where a slice cuts the third axis (m).
    part : str
        Components: "" for all of a profile and the magnitude in a map, "x" of a vector, "zz" of a
        tensor.
    phase : str
        "bulk", or the label of a phase.
    width : str
        Width of the kernel, such as "0.75 d43".
    arrows : str or None
        Vector field that arrows of a map show; "auto" as in `plot`.
    cmap : str or None
        Colours of a map, as in `plot`.
    vmin, vmax : float or None
        Ends of the colours of a map; None for the ends of each step.
    is_logarithmic : bool
        Whether colours follow the logarithm.
    """

    field: str
    view: View
    axes: tuple[str, ...]
    time: int = 0
    position: float = 0.0
    part: str = ""
    phase: str = "bulk"
    width: str = USUAL_WIDTH
    arrows: str | None = "auto"
    cmap: str | None = None
    vmin: float | None = None
    vmax: float | None = None
    is_logarithmic: bool = False

    def colours(self) -> dict[str, Any]:
        """Return the arguments of `plot` for arrows and colours that are not those by default."""
        if self.view == "profile":
            return {}
        limits = {"cmap": self.cmap, "vmin": self.vmin, "vmax": self.vmax}
        arguments: dict[str, Any] = {name: v for name, v in limits.items() if v is not None}
        if self.is_logarithmic:
            arguments["norm"] = "log"
        if self.arrows != "auto":
            arguments["arrows"] = self.arrows
        return arguments


class Pictures:
    """Pictures of a result: its own axes, fields, phases and steps.

    Parameters
    ----------
    ds : xarray.Dataset
        A result, lazy or in memory.

    Attributes
    ----------
    name : str
        Name of its variable in the calls that are shown.
    fields : dict of dict of str
        Names of fields by the texts that they are listed as, by their heading.
    views : dict of list
        Axes of the pictures of each view.
    plane : list of str
        Axes that pictures can be drawn along.
    axes : list of str
        Letters of the components of vectors.
    phases : list of str
        "bulk" and labels of phases; empty without phases.
    drawn_phases : list of str
        Phases that `plot` is called with.
    widths : tuple of str
        Widths of the kernel to choose from; none of a result.
    size : float
        d43 of the scene (m), the unit of these widths.
    steps : int
        Number of steps.
    """

    name = "f"
    widths: tuple[str, ...] = ()
    size = 0.0
    has_grains = False
    _prepare = staticmethod(with_time)

    def __init__(self, ds: xr.Dataset) -> None:
        self.ds = self._prepare(ds)
        self._dim = "time" if "time" in ds.dims else "step"  # of steps, in calls
        self.steps = self.ds.sizes.get("time", 1)
        self._describe()
        self.views: dict[str, list[tuple[str, ...]]] = {}
        if self.widths or len(self.plane) == 2:
            self.views["map"] = self._pairs()
        if len(self.plane) == 3:
            self.views["slice"] = self._pairs()
        self.views["profile"] = [(a,) for a in reversed(self.plane)]
        self._step = lru_cache(maxsize=2)(self._read)

    def _describe(self) -> None:
        self.plane = axes_of(self.ds)
        if not self.plane:
            raise ValueError(
                f"explore: this result has no axis to draw along, of {', '.join(COMPONENTS)}, r and "
                f"theta; its dimensions are {', '.join(map(str, self.ds.dims)) or 'none'}"
            )
        names = [str(name) for name in self.ds.data_vars if {*self.plane} & {*self.ds[name].dims}]
        self.fields = {"fields": dict(zip(names, names, strict=True))}
        self.vectors = [name for name in names if self.rank_of(name) == 1]
        self.axes = self._labels_of("component")
        self.phases = self._labels_of("phase")
        self.drawn_phases = self.phases

    def _pairs(self) -> list[tuple[str, ...]]:
        """Return the axes of maps: the first and the last axis come first."""
        pairs: list[tuple[str, ...]] = list(combinations(self.plane, 2))
        return sorted(pairs, key=lambda pair: pair != (self.plane[0], self.plane[-1]))

    def _labels_of(self, dim: str) -> list[str]:
        if dim not in self.ds.dims:
            return []
        return [str(label) for label in self.ds[dim].to_numpy()]

    def text_of_step(self, time: int) -> str:
        """Return the time and number of a step, as text."""
        texts = []
        for name in ("time", "step"):
            if name in self.ds.coords:
                value = np.atleast_1d(self.ds[name].to_numpy())[time]
                unit = drawing.unit_in_unicode(str(self.ds[name].attrs.get("units", "")))
                texts.append(f"{name} {value:.6g} {unit}".rstrip())
        return ", ".join(texts) or f"step {time + 1} of {self.steps}"

    def rank_of(self, field: str) -> int:
        """Return the number of indices of a field: 0 of a scalar, 1 of a vector, 2 of a tensor."""
        return len({"component", "direction"} & {*self.ds[field].dims})

    def parts_of(self, choice: Choice) -> dict[str, str]:
        """Return the parts of the field that a view can show, by their labels."""
        rank = self.rank_of(choice.field)
        if rank == 2:
            return {a + b: f"{a} {b}" for a in self.axes for b in self.axes}
        if rank == 0:
            return {"the field itself": ""}
        whole = "all" if choice.view == "profile" else "magnitude"
        return {whole: "", **{a: a for a in self.axes}}

    def cut_axis(self, choice: Choice) -> str:
        """Return the axis that a slice cuts."""
        return next(a for a in self.plane if a not in choice.axes)

    def range_of(self, axis: str) -> tuple[float, float]:
        """Return the first and last coordinate along an axis."""
        return float(self.ds[axis][0]), float(self.ds[axis][-1])

    def intervals_of(self, axis: str) -> int:
        """Return the number of intervals between slices along an axis: those between nodes."""
        return max(1, self.ds.sizes[axis] - 1)

    def _read(self, time: int) -> xr.Dataset:
        """Return the step at a position, in memory."""
        if "time" not in self.ds.dims:
            return self.ds.compute()
        return self.ds.isel(time=[time]).compute()

    def _selection(self, time: int) -> str:
        if self.steps == 1:
            return ""
        return f".isel({self._dim}=[{time}])"

    def _drawing(self, choice: Choice) -> dict[str, Any]:
        """Return the arguments of `plot`."""
        drawing: dict[str, Any] = {}
        component, _, direction = choice.part.partition(" ")
        if component:
            drawing["component"] = component
        if direction:
            drawing["direction"] = direction
        if choice.phase in self.drawn_phases:
            drawing["phase"] = choice.phase
        if choice.view == "slice" and not self.widths:
            drawing["at"] = {self.cut_axis(choice): choice.position}
        return drawing

    def result(self, choice: Choice) -> xr.Dataset:
        """Return the fields of the step that the picture is drawn from."""
        step = self._step(choice.time)
        if choice.view == "profile" and len(self.plane) > 1:
            return profile(step.drop_vars(self._beside(choice.field)), choice.axes[0])
        return step

    def _beside(self, field: str) -> list[str]:
        """Return the errors and biases of averages, of which profiles take no mean."""
        if "averaged_steps" not in self.ds.attrs:
            return []
        names = [str(name) for name in self.ds.data_vars]
        return [name for name in names if name.endswith((ERROR, BIAS)) and name != field]

    def picture(self, choice: Choice) -> xr.Dataset:
        """Return the numbers of the picture and its arrows, as `plot` draws them; ``attrs["drawn"]`` is its name."""
        arrows = choice.arrows
        if choice.view == "profile":
            arrows = None
        return picture_of(self.result(choice), choice.field, arrows=arrows, **self._drawing(choice))

    def call(self, choice: Choice) -> str:
        """Return the Python call that makes the picture."""
        averaged = ""
        if choice.view == "profile" and len(self.plane) > 1:
            if beside := self._beside(choice.field):
                averaged = f".drop_vars({beside!r})"
            averaged += f".cg.profile({choice.axes[0]!r})"
        return f"{self.name}{self._selection(choice.time)}{averaged}.cg.{self._plot(choice)}"

    def _plot(self, choice: Choice) -> str:
        """Return the call of `plot`."""
        arguments = {"field": choice.field, **self._drawing(choice), **choice.colours()}
        return written_call("plot", arguments)


class ScenePictures(Pictures):
    """Pictures of a scene: each is coarse-grained from its step, which is read once."""

    name = "ds"
    widths = WIDTHS
    _prepare = staticmethod(conform)

    def _describe(self) -> None:
        self.scene = Scene(self.ds)
        self.size = self.scene.sizes.get("d43", 0.0)
        self.plane = list(self.scene.setup.plane)
        possible = possible_fields(self.scene, Request())
        on_request = {}
        impossible = {}
        for name in listed():
            missing = missing_for(name, self.scene)
            if missing:
                impossible[f"{name} (needs {', '.join(missing)})"] = name
            elif name not in possible:
                on_request[name] = name
        self.fields = {
            "of this scene": dict(zip(possible, possible, strict=True)),
            "on request": on_request,
            "not of this scene": impossible,
        }
        self.vectors = ["velocity"] if "velocity" in possible else []
        self.axes = self.plane
        self.by = next((name for name in ("phase", "species") if name in self.ds), None)
        groups = self.scene.values(self.by) if self.by else []
        self.phases = []
        if len(groups) > 1:
            self.phases = ["bulk", *map(str, groups)]
        self.drawn_phases = self.phases[1:]
        self.has_grains = "diameter" in self.ds

    def rank_of(self, field: str) -> int:  # noqa: D102
        return FIELDS[field].rank

    def range_of(self, axis: str) -> tuple[float, float]:  # noqa: D102
        k = COMPONENTS.index(axis)
        if self.scene.corners is not None and axis not in self.scene.setup.periodic:
            return self.scene.corners[0][k], self.scene.corners[1][k]
        if axis in self.scene.edges:
            return self.scene.edges[axis]
        positions = self._step(0)["position"].sel(component=axis)
        return float(positions.min()), float(positions.max())

    def intervals_of(self, axis: str) -> int:  # noqa: D102
        return SLICES

    def _request(self, choice: Choice) -> dict[str, Any]:
        """Return the arguments of `coarse_grain`."""
        request: dict[str, Any] = {"axes": "".join(choice.axes)}
        if choice.view == "slice":
            request["at"] = {self.cut_axis(choice): choice.position}
        request["width"] = choice.width
        request["spacing"] = float(f"{self._spacing(choice):.3g}")
        # the same nodes in all steps; along periodic axes they are those of the box
        bounds = {}
        extent = {}
        for a in self.axes:
            low, high = self.range_of(a)
            if a in choice.axes and a not in self.scene.setup.periodic:
                bounds[a] = (float(f"{low - self.size:.5g}"), float(f"{high + self.size:.5g}"))
            is_averaged = a not in choice.axes and a not in request.get("at", {})
            if is_averaged and a not in self.scene.edges:
                extent[a] = float(f"{high - low + self.size:.5g}")
        if bounds:
            request["bounds"] = bounds
        if extent:
            request["extent"] = extent
        if choice.phase in self.drawn_phases:
            request["by"] = self.by
        return request

    def _longest(self, choice: Choice) -> float:
        ends = [self.range_of(a) for a in choice.axes]
        return max(high - low for low, high in ends)

    def _spacing(self, choice: Choice) -> float:
        """Return the distance of nodes (m): fine enough for the picture and the kernel, and soon computed."""
        longest = self._longest(choice)
        width = float(choice.width.split()[0]) * self.size
        reach = REACH * width
        grains = float(self.ds.sizes["particle"])
        if choice.view == "slice":
            low, high = self.range_of(self.cut_axis(choice))
            grains *= min(1.0, 2 * reach / max(high - low, reach))
        soonest = reach * np.sqrt(np.pi * grains / VISITS)
        if choice.view == "profile":
            soonest = 2 * reach * grains / VISITS
        wanted = max(longest / NODES[choice.view], soonest)
        return float(max(min(wanted, width), longest / MOST_NODES))

    def result(self, choice: Choice) -> xr.Dataset:
        """Return the field of the step, coarse-grained."""
        fields = self._fields(choice)
        return coarse_grain(self._step(choice.time), fields, **self._request(choice))

    def _fields(self, choice: Choice) -> str | list[str]:
        """Return the field, and that of the arrows."""
        if choice.view != "profile" and choice.arrows not in (None, "auto", choice.field):
            return [choice.field, str(choice.arrows)]
        return choice.field

    def call(self, choice: Choice) -> str:
        """Return the Python calls that make the picture."""
        request = {"fields": self._fields(choice), **self._request(choice)}
        scene = f"{self.name}{self._selection(choice.time)}"
        return f"f = {scene}.cg.{written_call('coarse_grain', request)}\nf.cg.{self._plot(choice)}"

    def grains(self, choice: Choice) -> tuple[Mapping[str, NDArray], str]:
        """Return circles of the grains of a step on a map, and a note about which they are.

        In a volume they are the circles in which a plane cuts the grains: that of the slice, or in
        a map the one in the middle. Of more than `MOST_GRAINS`, those with the smallest hash of
        their id are returned: a random choice that stays the same in all steps.
        """
        frame, lattice, _ = frame_at(
            self._step(choice.time), 0, ["particle_id", "position", "diameter"]
        )
        cut = {}
        note = ""
        if choice.view == "slice":
            cut = {self.cut_axis(choice): choice.position}
        elif len(self.plane) == 3:
            axis = self.cut_axis(choice)
            cut = {axis: float(f"{np.mean(self.range_of(axis)):.4g}")}
            note = f"grains at {axis} = {cut[axis]:.4g}"
        centre, radius, drawn = circles_of(frame, choice.axes, cut, lattice)
        if len(drawn) > MOST_GRAINS:
            note = f"{MOST_GRAINS} of {len(drawn)} grains are drawn"
            # Knuth's multiplicative hash, 32 bits
            ids = frame["particle_id"][drawn].astype(np.uint64)
            hashed = ids * np.uint64(2654435761) % np.uint64(2**32)
            some = np.argsort(hashed, kind="stable")[:MOST_GRAINS]
            centre = centre[some]
            radius = radius[some]
        across, up = centre.T
        return {"x": across, "y": up, "radius": radius}, note

    def errors(self, choice: Choice) -> dict[str, NDArray]:
        """Return bias, noise and total error of one step against ``width`` (in d43), by name.

        They are as in `choose_width`, of the scatter of grains about the mean at each node. A field
        without such an error, as stress and density, has ``bias with noise``: the bias of
        `width_sweep`, which the noise of few grains adds to.
        """
        if choice.field.endswith((ERROR, BIAS)):
            raise ValueError(f"{choice.field} is an error itself, and has none of its own")
        step = self._step(choice.time)
        request = self._request(choice)
        nodes: dict[str, Any] = {
            name: request[name] for name in ("axes", "at", "extent") if name in request
        }
        far = self._longest(choice) / NODES_OF_ERRORS[choice.view]
        nodes["spacing"] = min(far, 1.9 * self.size)  # the narrowest kernel still sees all grains
        if f"{choice.field}_error" in FIELDS:
            sweep = choose_width(step, choice.field, frames=1, **nodes)
            parts = {part: sweep[f"{choice.field}_{part}"] for part in ("bias", "noise", "total")}
        else:
            sweep = width_sweep(step, SWEPT, [choice.field, "number_density"], **nodes)
            bias = sweep[f"{choice.field}_bias"]
            field = sweep[choice.field]
            weight = sweep["number_density"].where(field.notnull() & bias.notnull(), 0.0)
            others = [dim for dim in field.dims if dim != "width"]
            of_bias = (bias.fillna(0.0) ** 2 * weight).sum(others)
            of_field = (field.fillna(0.0) ** 2 * weight).sum(others)
            parts = {"bias with noise": (of_bias / of_field) ** 0.5}
        values = {part: errors.to_numpy() for part, errors in parts.items()}
        return {"width": sweep["width"].to_numpy() / self.size, **values}


def missing_for(name: str, scene: Scene) -> list[str]:
    """Return the variables and the option that a field needs and a scene lacks."""
    row = FIELDS[name]
    missing = sorted(variables_of((name,), {*scene.columns}, Options()) - scene.columns.keys())
    if row.option:
        missing.append(f"{row.option}=")
    return missing


def written_call(function: str, arguments: Mapping[str, Any]) -> str:
    """Return a call as text, one argument a line where there are several."""
    if len(arguments) < 3:
        return format_call(function, arguments)
    words = [format_call("", {name: value})[1:-1] for name, value in arguments.items()]
    lines = "".join(f"    {word},\n" for word in words)
    return f"{function}(\n{lines})"


def pictures_of(ds: xr.Dataset) -> Pictures:
    """Return the pictures of a scene or a result.

    Raises
    ------
    ValueError
        If the Dataset is neither, or has no axis to draw along.
    """
    if "chain_id" in ds:
        raise ValueError(
            "explore draws scenes and fields, and these are force chains: plot_chains and view draw "
            "them"
        )
    if "position" in ds:
        return ScenePictures(ds)
    return Pictures(ds)
