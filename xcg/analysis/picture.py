"""Pictures of results: which numbers of one field they show, and where no grains are."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any, Literal, TypeAlias, TypeVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.analysis.compare import ERROR
from xcg.common import drawing
from xcg.common.checks import check_choice
from xcg.common.messages import did_you_mean
from xcg.fields.formulas.field import Options
from xcg.fields.formulas.registry import FIELDS, OTHER_NAMES, REGISTERED, fields_of
from xcg.scene.facts import with_present_names
from xcg.scene.frame import step_at, with_time
from xcg.scene.schema import COMPONENTS

T = TypeVar("T", xr.Dataset, xr.DataArray)
Shading: TypeAlias = Literal["smooth", "flat"]

DENSITIES = ("sample_count", "density", "volume_fraction", "number_density")
ARROW = "arrow_"
AXES = ("r", "theta", *COMPONENTS)  # in the order in which maps have them across and up
TITLED = ("time", "phase", *AXES)  # coordinates that titles name
CIRCLE = ("r", "theta")  # axes of maps in the plane of a circle
UNROLLED = ("theta", "z")  # of maps of an angle and a length, which have any ratio


@dataclass(frozen=True)
class Shown:
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
        (picture,) = without_empty_parts([step], f)
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
        for axis in axes:
            if not cut.sizes[axis]:
                raise ValueError(
                    f"plot({name!r}): no node is left along {axis}; select one at least"
                )
        self._check(cut[name], axes, str(f.attrs.get("plane", AXES)))
        if len(axes) == 2:
            parts = self._of_map(cut, axes, name)
        else:
            parts = {name: self._component(cut[name], name)}
            error = f"{name}{ERROR}"
            if error in cut:
                parts[error] = self._component(cut[error], name)
        return xr.Dataset(parts, attrs={"drawn": name})

    def _of_map(self, cut: xr.Dataset, axes: list[str], name: str) -> dict[str, xr.DataArray]:
        """Return a field over two axes, of a vector its magnitude, and the components of arrows."""
        value = self._component(without_air(cut, name), name)
        arrows = self._arrows(cut, axes, value)
        if "component" in value.dims:
            size = (value**2).sum("component", skipna=False) ** 0.5
            text = f"magnitude of {drawing.long_name_of(value, name)}"
            value = size.assign_attrs(value.attrs, long_name=text)
        return {name: value, **arrows}

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
        return {f"{ARROW}{a}": cut[arrows].sel(component=a, drop=True) for a in axes}


def _other_way(f: xr.Dataset, value: xr.DataArray) -> str:
    """Return the message for a result that has no axes to draw along: xarray may draw it."""
    text = (
        f"plot draws along one or two of {', '.join(AXES)}; this result has the dimensions "
        f"{', '.join(map(str, f.dims))}"
    )
    dims = [str(dim) for dim in value.dims if dim not in ("component", "direction")]
    if not dims:
        return text
    along = next((dim for dim in dims if dim not in ("time", "phase")), dims[0])
    last = ""
    if "time" in dims and along != "time":
        last = ".isel(time=-1)"
    return f"{text}; xarray draws others, such as f[{value.name!r}]{last}.plot.line(x={along!r})"


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
    picture = Shown(field, component, direction, phase, at, arrows, "flat").picture(f, index)
    check_errors(picture)
    return picture.transpose(*axes_of(picture)[::-1], ...)


def check_errors(picture: xr.Dataset) -> None:
    """Raise ValueError if a standard error is negative: it is the difference of two errors."""
    for name in picture:
        if str(name).endswith(ERROR) and bool((picture[name] < 0).any()):
            raise ValueError(
                f"plot: {name} is negative, {float(picture[name].min()):.3g} at its lowest, and no "
                "standard error is: b - a subtracts errors, too; xcg.compare(a, b) adds them in squares"
            )


def without_air(f: xr.Dataset, name: str) -> xr.DataArray:
    """Return a field of a result, NaN at nodes that no grains reach; lazy where the field is.

    Fields that are sums over grains or contacts are zero there. Nodes are taken for air where a
    density of the result is zero. Without a density, they are where such a field is exactly zero,
    also at the next nodes, unless it is zero everywhere.
    """
    value = f[name]
    for density in map(f.get, DENSITIES):
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


def without_empty_parts(steps: list[xr.Dataset], f: xr.Dataset) -> list[xr.Dataset]:
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
    return [a for a in AXES if a in f.dims]


def finite_of(steps: Iterable[Any]) -> NDArray:
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
    return name in REGISTERED or "pressure" in fields_of((name,), Options())
