"""Arguments of `coarse_grain` and of its callers: each once, with its type, default and meaning.

Functions take a request as one object. The decorator `takes` gives them its arguments instead, with
the documentation, so that users see plain functions.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, MISSING, Field, dataclass, fields
from functools import cache, wraps
from typing import (
    Any,
    Concatenate,
    Literal,
    ParamSpec,
    TypeAlias,
    TypeVar,
    cast,
    get_type_hints,
)

import numpy as np
import xarray as xr

from xcg.common.checks import NOT_NEGATIVE, POSITIVE, check, check_choice
from xcg.fields.formulas.field import Deviatoric, Gradient, InertialSize, Quantity, Temperature
from xcg.fields.grids.frames import Cylindrical, Rotated
from xcg.fields.grids.walls import Wall
from xcg.fields.sums.kernels import Kernel, KernelName
from xcg.scene.conform import takes_scene
from xcg.scene.scene import Scene
from xcg.steps.faults import OnError
from xcg.steps.labels import format_call


def _is_scalar_or_mapping(value: Any) -> bool:
    return isinstance(value, Mapping) or np.ndim(value) == 0


def _is_mapping(value: Any) -> bool:
    return isinstance(value, Mapping)


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and value != ""


def _are_walls(value: Any) -> bool:
    is_list = isinstance(value, Sequence) and not isinstance(value, str) and len(value) > 0
    return is_list and all(isinstance(wall, Wall) for wall in value)


# what arguments are, whatever the scene is; what depends on the scene is checked by the plan
_FORMS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "spacing": (
        _is_scalar_or_mapping,
        "a distance (m), a multiple of a size such as '0.5 d43', or one by axis such as {'x': 0.01, 'z': 0.005}",
    ),
    "width": (
        _is_scalar_or_mapping,
        "a length (m), a multiple of a size such as '0.75 d43', or one of these by group",
    ),
    "bounds": (_is_mapping, "first and last node by axis, such as {'z': (0.0, 0.1)}"),
    "extent": (_is_mapping, "a length (m) by axis, such as {'y': 0.1}"),
    "at": (
        _is_mapping,
        "a coordinate (m) by axis, such as {'y': 0.0}; axes='z' resolves an axis",
    ),
    "by": (_is_text, "the name of a variable of the particles, such as 'species'"),
    "pressure_dims": (_is_text, "axes such as 'z'"),
    "shear_dims": (_is_text, "axes such as 'xz'"),
    "frame": (
        lambda value: isinstance(value, (Rotated, Cylindrical)),
        "xcg.Rotated(...) or xcg.Cylindrical(...)",
    ),
    "surfaces": (_are_walls, "a list of xcg.Plane, xcg.Cylinder and xcg.Surface"),
}

Preset: TypeAlias = Literal["pysammos", "lammps"]
Per: TypeAlias = Literal["accessible"]
_CHOICES: dict[str, Any] = {
    "gradient": Gradient,
    "deviatoric": Deviatoric,
    "size": InertialSize,
    "temperature": Temperature,
    "preset": Literal[Preset, None],
    "per": Literal[Per, None],
}
# defaults of presets in place of those below
OF_PRESETS: dict[Any, dict[str, Any]] = {
    "lammps": {"kernel": "shifted gaussian", "gradient": "finite_difference"},
    "pysammos": {"temperature": "biased"},
}
P = ParamSpec("P")
A = TypeVar("A")
R = TypeVar("R")


@dataclass(frozen=True, kw_only=True)
class SharedOptions:
    """Arguments of all functions that coarse-grain a scene.

    Parameters
    ----------
    kernel : str or Kernel
        "lucy" (default), "gaussian", "shifted gaussian", "heaviside", a registered name, or an
        object such as ``xcg.Lucy(cutoff=0.01)``. Only kernels as smooth as Lucy give fields that
        satisfy the differential balance laws.
    spacing : float, str or mapping, optional
        Distance of nodes (m), or a multiple of a size such as "0.5 d43", for all axes or by axis;
        the width by default. Periodic axes without
        bounds take the nearest spacing that divides the period.
    axes : str, optional
        Resolved axes, for example "xyz" (the default), "xz", "z". Axes neither here nor in `at` are
        averaged: the exact integral over them (through the kernel's marginal), divided by their
        extent.
    bounds : mapping, optional
        First and last node of resolved axes (m); the last one lies before its bound where the
        spacing does not divide the range. By default the box along periodic axes, and the extent of
        the particles with their supports along the others.
    by : str, optional
        An integer variable of the particles, for example "species": adds the dimension ``phase``
        with "bulk" first. Fluctuations of each phase are about the bulk velocity; contact stress is
        split at the contact point.
    groups : list of int, optional
        All values of `by`, where they are not known without reading.
    extent : mapping, optional
        Length that the integral over an averaged axis is divided by (m); by default that of the box
        of each step.
    gradient : str
        The way to the velocity gradient, and with it to the granular temperature: "least_squares"
        (default), exact in linear flow; "kernel", the exact derivative of the field V(r);
        "finite_difference" between the nodes (resolved axes only); "paper", least squares about the
        node instead of the grains' centre of mass.
    pressure_dims : str, optional
        Axes whose normal stresses make the pressure: "z", "xy", ... (all axes of the scene by
        default).
    shear_dims : str, optional
        Axes that deviatoric stress, shear stress and shear rate are restricted to, for example
        "xz".
    deviatoric : str
        Magnitudes computed from deviators: of "both" stress and rate of shear (default), of the
        "stress" or the "rate" alone.
    size : str
        Diameter in the inertial number: "d43" (default) or "d32" of the node, "d50" or "dmax" of
        the scene.
    fluid_viscosity : float, optional
        Viscosity of the fluid between the grains (Pa s), for ``viscous_number`` and
        ``relative_viscosity``.
    friction : float, optional
        Coefficient of friction between the grains, for ``redundancy_number``, ``sliding_share`` and
        ``friction_mobilisation``: contacts at Coulomb's limit slide.
    by_pair : bool
        Also divide contact stress by the phase of the partner: ``contact_stress_by_pair`` with the
        dimension ``other_phase``, the phases and then "wall". Its sum over them is the contact
        stress of the phase.
    temperature : str
        "unbiased" (default) divides the fluctuations about the fitted velocity by the density less
        the degrees of freedom of the fit (``fluctuation_density``); "biased" by the density alone,
        which gives less than half of the temperature of a dense packing at the default width, and a
        tenth of that of a gas.
    by_body : str, optional
        An integer variable of the particles that says which body each component sphere belongs to,
        for example "body_id": bodies are coarse-grained instead of spheres, see `xcg.group_bodies`.
        Sizes and extent of the bodies of a lazy scene are not known: `width` and `bounds` have to
        be given then.
    frame : Rotated or Cylindrical, optional
        Axes chosen by the user; everything else in the request and the result refers to them.
    rtol : float
        Promise for the contact stress of every segment, relative to its largest value: the cheapest
        quadrature that keeps it is taken, from 1e-4 on with weights in single precision. 0
        (default) takes the closed form.
    preset : {"pysammos", "lammps"}, optional
        Names and variants of another program; `fields` are then its names. For "pysammos",
        `shear_dims` is its plane ("xy" by default), see `xcg.fields.presets.pysammos`; "lammps" is
        ``compute continuum/chunk``, see `xcg.fields.presets.lammps`.
    on_error : {"raise", "skip"}
        What to do about a step that cannot be read or computed: stop with its error (default), or
        leave it NaN, warn of it by file and cause when it is computed, and mark it in the
        coordinate ``skipped`` (time).
    """

    kernel: KernelName | str | Kernel = "lucy"
    spacing: float | str | Mapping[str, float | str] | None = None
    axes: str | None = None
    bounds: Mapping[str, Sequence[float]] | None = None
    by: str | None = None
    groups: Sequence[int] | None = None
    extent: Mapping[str, float] | None = None
    gradient: Gradient = "least_squares"
    pressure_dims: str | None = None
    shear_dims: str | None = None
    deviatoric: Deviatoric = "both"
    size: InertialSize = "d43"
    fluid_viscosity: float | None = None
    friction: float | None = None
    by_pair: bool = False
    temperature: Temperature = "unbiased"
    by_body: str | None = None
    frame: Rotated | Cylindrical | None = None
    rtol: float = 0.0
    preset: Preset | None = None
    on_error: OnError = "raise"

    def __post_init__(self) -> None:
        for name, (fits, expected) in _FORMS.items():
            value = getattr(self, name, None)
            if not (value is None or fits(value)):
                raise ValueError(f"{name}={value!r}: expected {expected}")
        for name, choices in _CHOICES.items():
            check_choice(name, getattr(self, name, None), choices)
        check("rtol", self.rtol, NOT_NEGATIVE, hint=", such as 1e-3")
        check("friction", self.friction, NOT_NEGATIVE, optional=True, hint=", such as 0.5")
        viscosity = self.fluid_viscosity
        check("fluid_viscosity", viscosity, POSITIVE, "Pa s", optional=True, hint=", such as 1e-3")
        for axis, length in (self.extent or {}).items():
            check(f"extent[{axis!r}]", length, POSITIVE, "m")

    def as_request(self, **own: Any) -> Request:
        """Return a `Request` with these options and further arguments of `coarse_grain`."""
        return Request(
            **own, **{field.name: getattr(self, field.name) for field in fields(SharedOptions)}
        )

    def call(self, function: str) -> str:
        """Write the call of a function with these arguments, for its history."""
        kind: Any = type(self)
        values: dict[str, Any] = {}
        for field in arguments(kind):
            value = getattr(self, field.name)
            if value is not None and (field.name, value) != ("on_error", "raise"):
                values[field.name] = value
        return format_call(function, values)


@dataclass(frozen=True)
class Request(SharedOptions):
    """Arguments of `coarse_grain`.

    Parameters
    ----------
    fields : str, quantity, or list of these, optional
        Names of fields, see `xcg.FIELDS` (names with an underscore first are parts of others), by
        default all that the scene's variables allow; names of other variables of the scene, for
        their means; and `xcg.Mean`, `xcg.Sum`, `xcg.Variance`, `xcg.Flux` or `xcg.Conduction` of
        any variable. Only what these need is read and summed.
    like : xarray.Dataset, optional
        A result of `coarse_grain`, of another scene perhaps: takes its nodes, width, kernel and
        options, so that the two results can be subtracted.
    width : float, str or mapping, optional
        Half-width w of the kernel (m), or a multiple of a size such as "0.75 d43" (the default).
        With `by`, a mapping gives each group its own, for very polydisperse scenes: ``{1: 1e-3, 2:
        "0.75 d43"}``. Every grain, and its side of its contacts, is then smeared by the width of
        its group.
    at : mapping, optional
        Coordinate of fixed axes, for example ``{"y": 0.0}`` (m). DataArrays name points, as in
        xarray's pointwise indexing: ``{"x": xa, "y": ya, "z": za}`` with arrays that share
        dimensions, or broadcast against each other; results have these dimensions and coordinates,
        and axes without an array are averaged.
    surfaces : list of Plane, Cylinder and Surface, optional
        Walls as geometry, in the axes of the scene: adds the field ``accessible_fraction``, the
        share of the kernel that lies on their accessible side, averaged axes included. A `frame`
        turns them with the scene.
    per : {"accessible"}, optional
        Divide sums by the accessible fraction, so that fields near walls are per volume that grains
        can reach. Ratios of sums stay, other fields follow from the sums. NaN where the fraction is
        below 0.01. Balance laws hold for fields per volume, without it.
    errors : bool
        Add ``<field>_error``, one standard deviation in one step, of velocity, its gradient and
        what is made of it, temperature, kinetic stress, spin, and means of variables of particles:
        as of independent fluctuations of the grains, see `xcg.fields.formulas.rows.errors`.
        Densities and contact stress have none, as neighbours are not independent: their errors come
        from several steps (`time_average`).
    for_averages : bool, optional
        What becomes of the sums that `time_average` and `profile` of the fields need beside them,
        such as the density beside a velocity. By default they are coordinates of the result; True
        makes them variables, and False leaves them out, so that averages of ratios raise an error.
    """

    fields: str | Quantity | Sequence[str | Quantity] | None = None
    _: KW_ONLY
    like: xr.Dataset | None = None
    width: float | str | Mapping[int, float | str] | None = None
    at: Mapping[str, float | xr.DataArray] | None = None
    surfaces: Sequence[Wall] | None = None
    per: Per | None = None
    errors: bool = False
    for_averages: bool | None = None

    def changed(self, names: Sequence[str]) -> list[str]:
        """Names of arguments that differ from their defaults."""
        usual = Request()
        return [name for name in names if getattr(self, name) != getattr(usual, name)]

    def axes_of(self, plane: str) -> str:
        """Return the resolved axes: by default, and without fixed axes, all axes of the scene."""
        if self.axes is None and self.at is None:
            return plane
        return self.axes or ""


# arguments that most calls give, in the order in which signatures show them
_FIRST = ("axes", "width", "spacing", "at", "bounds", "kernel", "by")


@cache
def arguments(request: Any) -> tuple[Field[Any], ...]:
    """Fields of a class of requests in the order of a call: by position, usual, its own, shared ones."""
    shared = {field.name for field in fields(SharedOptions)}

    def rank(field: Field[Any]) -> tuple[bool, int, bool]:
        usual = [*_FIRST, field.name].index(field.name)
        return bool(field.kw_only), usual, field.name in shared

    return tuple(sorted(fields(request), key=rank))


def takes(
    request: Callable[P, A],
) -> Callable[[Callable[[Scene, A], R]], Callable[Concatenate[xr.Dataset, P], R]]:
    """Decorate a function of a scene and a request: it takes the arguments that the request is made of.

    It takes any selection of a scene, as functions with `takes_scene` do. Signature and annotations
    come from the arguments, and ``{arguments}`` in the docstring is replaced by their descriptions.
    """

    def decorate(function: Callable[[Scene, A], R]) -> Callable[Concatenate[xr.Dataset, P], R]:
        @wraps(function)
        def call(scene: Scene, *args: P.args, **options: P.kwargs) -> R:
            arguments = OF_PRESETS.get(str(options.get("preset")), {}) | options
            return function(scene, request(*args, **arguments))

        of_call = inspect.Parameter
        kinds = {False: of_call.POSITIONAL_OR_KEYWORD, True: of_call.KEYWORD_ONLY}
        parameters = [of_call("scene", kinds[False])]
        for field in arguments(request):
            kind = kinds[bool(field.kw_only)]
            default = field.default
            if default is MISSING:
                default = of_call.empty
            parameters.append(of_call(field.name, kind, default=default, annotation=field.type))
        cast(Any, call).__signature__ = inspect.Signature(
            parameters, return_annotation=function.__annotations__["return"]
        )
        if function.__doc__:  # there is none under python -OO
            meanings = _meanings(request)
            descriptions = "\n".join(meanings[field.name] for field in arguments(request))
            call.__doc__ = inspect.cleandoc(function.__doc__).replace("{arguments}", descriptions)
        of_scene = takes_scene(call)
        hints = {
            "ds": xr.Dataset,
            **get_type_hints(request),
            "return": get_type_hints(function)["return"],
        }
        of_scene.__annotations__ = {name: hints[name] for name in of_scene.__annotations__}
        return of_scene

    return decorate


def _meanings(request: Any) -> dict[str, str]:
    """Entries of the parameters in the docstrings of a class of requests and of its bases."""
    meanings: dict[str, str] = {}
    for kind in reversed(request.__mro__):
        _, _, entries = inspect.cleandoc(kind.__doc__ or "").partition("Parameters\n----------\n")
        meanings |= {entry.split(" :")[0]: entry for entry in re.split(r"\n(?=\S)", entries)}
    return meanings
