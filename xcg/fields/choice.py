"""Choice of fields: which a request means, the sums and variables that they take, and the options of their algebra."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from xcg.common.messages import unknown
from xcg.fields.formulas import registry
from xcg.fields.formulas.field import OF_CALLS, Field, Options, Quantity
from xcg.fields.formulas.rows.errors import OF_FITS, OF_PLACES
from xcg.fields.formulas.rows.flow import FITS
from xcg.fields.formulas.rules import needed_for_averages
from xcg.fields.formulas.variables import OwnField, check_turns, own_field, own_fields
from xcg.fields.grids.grid import check_axes
from xcg.fields.request import Per, Request
from xcg.fields.sums.moments import Moment
from xcg.fields.sums.nodes import Nodes
from xcg.scene.scene import Scene
from xcg.scene.schema import COMPONENTS, CONTACT_VARIABLES

_OF_FORMULAS = (*OF_CALLS, "friction", "by", "temperature")  # options that are arguments


@dataclass(frozen=True, eq=False)
class ChosenFields:
    """Fields of a call and what they take, with the meaning of the same attributes of a `Plan`."""

    fields: tuple[str, ...]
    requested: tuple[str, ...]
    variables: tuple[str, ...]
    moments: Mapping[str, Moment]
    options: Options


def choose_fields(scene: Scene, request: Request, nodes: Nodes) -> ChosenFields:
    """Choose the fields of a request at some nodes.

    Raises
    ------
    SceneError
        If the scene lacks variables that the fields need.
    ValueError
        If an argument is wrong.
    """
    if request.by_pair and request.by is None:
        raise ValueError(
            "by_pair=True splits stress by pairs of phases: name their variable, such as by='species'"
        )
    options = requested_options(scene, request, nodes)
    names, own = _named(request.fields, scene, options)
    if own and scene.cylindrical:
        check_turns(own)
    if request.errors:
        names, own = _with_errors(names, own, scene, _without_errors(scene, options))
    if any(name.endswith("_error") for name in names):
        _check_errors(names, _without_errors(scene, options), per=request.per)
    if request.by_pair:
        names = tuple(dict.fromkeys([*names, "contact_stress_by_pair"]))
    options = replace(options, own=own)
    requested = names
    if request.for_averages is not False or request.per is not None:
        names = (*names, *needed_for_averages(names, options))
    if request.for_averages:
        requested = names
    definitions = registry.fields_of(names, options)
    registered = [
        registry.NamedField(name, field)
        for name, field in definitions.items()
        if name in registry.REGISTERED
    ]
    options = replace(options, own=(*own, *registered))
    moments = registry.moments_of(definitions.values(), options)
    needed = _read_by(moments, scene.columns.keys())
    if not needed <= scene.columns.keys():
        _refuse(scene, names, needed, options)
    read = [n for n in scene.columns if n in {*needed, request.by, "frozen"}]
    return ChosenFields(names, requested, tuple(read), moments, options)


def _refuse(scene: Scene, names: Sequence[str], needed: Set[str], options: Options) -> None:
    """Raise SceneError as the scene lacks some of the variables that the fields need."""
    here = scene.columns.keys()
    lacking = [name for name in names if not variables_of((name,), here, options) <= here]
    instead = ""
    if "contact_stress" in registry.fields_of(lacking, options) and (
        variables_of(("contact_stress",), here, options) <= here
    ):
        instead = "; or ask for contact_stress, which needs no velocity"
    scene.require(sorted(needed), f"coarse_grain of {', '.join(lacking)}", instead)


# --- the fields that are meant ---------------------------------------------------------------------


def possible_fields(scene: Scene, request: Request) -> tuple[str, ...]:
    """Return the names of the fields that the scene's variables allow: the fields of a request without names."""
    options = Options(**{name: getattr(request, name) for name in _OF_FORMULAS})
    return _possible(scene, options)


def _possible(scene: Scene, options: Options) -> tuple[str, ...]:
    here = scene.columns.keys()
    possible = []
    for name in registry.listed():
        field = registry.FIELDS[name]
        has_option = not field.option or getattr(options, field.option) is not None
        if field.default and has_option and variables_of((name,), here, options) <= here:
            possible.append(name)
    if not possible:
        scene.require(("mass",), "coarse_grain")
    return tuple(possible)


def _named(
    fields: str | Quantity | Sequence[str | Quantity | registry.NamedField] | None,
    scene: Scene,
    options: Options,
) -> tuple[tuple[str, ...], tuple[OwnField | registry.NamedField, ...]]:
    """Return the names of the fields of a result, and the quantities of the scene's own variables among them."""
    if fields is None:
        return _possible(scene, options), ()
    requested: list[Any] = [fields]
    if isinstance(fields, Iterable) and not isinstance(fields, str):
        requested = list(fields)
    if not requested:
        raise ValueError(
            f"fields={fields!r}: expected at least one; leave it out for all that the scene allows"
        )
    names = requested.copy()
    own: dict[int, OwnField | registry.NamedField] = {}
    if not all(isinstance(name, str) and name in registry.FIELDS for name in requested):
        own = own_fields(requested, scene)
    for k, name in enumerate(requested):
        if k in own:
            names[k] = own[k].name
            continue
        # an underscore begins the names of parts of others
        if not isinstance(name, str) or name.startswith("_") or name not in registry.FIELDS:
            raise ValueError(_unknown_field(name, scene))
        field = registry.FIELDS[name]
        if field.option and getattr(options, field.option) is None:
            raise ValueError(_lacks_option(name, field))
    return tuple(dict.fromkeys(names)), tuple(dict.fromkeys(own.values()))


def _lacks_option(name: str, field: Field) -> str:
    """Return the message about a field that takes an option."""
    if field.option == "lag":
        return (
            f"{name} compares two frames: call ds.cg.displacement({name!r}) instead of coarse_grain"
        )
    return f"{name} needs the argument {field.option}="


def _unknown_field(name: Any, scene: Scene) -> str:
    """Return the message about a field that does not exist."""
    listed = registry.listed()
    word = str(name).lower()
    if word in registry.CALLS:
        return f"{name!r} is no field; did you mean {registry.CALLS[word]}?"
    if word == "all":
        return "fields='all': leave fields out for all that the scene allows"
    parts = re.findall(r"\w+", str(name))
    if len(parts) > 1 and all(part in listed for part in parts):
        return f"fields={name!r}: give several fields as a list, {parts}"
    others = "others are listed by xcg.FIELDS and by ds.data_vars"
    return unknown("field", name, [*listed, *scene.rows], others, registry.OTHER_NAMES)


# --- errors of one step ----------------------------------------------------------------------------


def _without_errors(scene: Scene, options: Options) -> Set[str]:
    """Return the errors that are not available in a frame, or for a way to the gradient."""
    if scene.cylindrical:
        return OF_PLACES
    if options.gradient not in FITS:
        return OF_FITS
    return set()


def _check_errors(names: Sequence[str], absent: Set[str], *, per: Per | None) -> None:
    """Raise ValueError for errors of one step that are not available."""
    if wrong := absent & {*names}:
        raise ValueError(
            f"{', '.join(sorted(wrong))}: available only in Cartesian axes, with gradient='least_squares' or "
            "'paper'"
        )
    if per is not None:
        raise ValueError(
            "errors=True with per='accessible': errors are those of sums per volume; leave one out"
        )


def _with_errors(
    names: tuple[str, ...],
    own: tuple[OwnField | registry.NamedField, ...],
    scene: Scene,
    absent: Set[str],
) -> tuple[tuple[str, ...], tuple[OwnField | registry.NamedField, ...]]:
    """Add the errors of one step of the fields that have them, unless absent."""
    quantities = [field.error for field in own if isinstance(field, OwnField)]
    further = tuple(own_field(quantity, scene) for quantity in quantities if quantity is not None)
    errors = [
        f"{name}_error" for name in names if f"{name}_error" in registry.FIELDS.keys() - absent
    ]
    if not errors and not further:
        raise ValueError(
            "errors=True: errors of a single step exist for velocity, granular_temperature and others, not for "
            f"{', '.join(names)}: leave errors= out, and take the errors of time_average over several steps"
        )
    names = (*names, *errors, *(field.name for field in further))
    return tuple(dict.fromkeys(names)), (*own, *further)


# --- variables and options -------------------------------------------------------------------------


def variables_of(fields: Iterable[str], here: Set[str], options: Options) -> set[str]:
    """Return the variables that some fields need, of a scene with the variables `here`."""
    definitions = registry.fields_of(fields, options)
    return _read_by(registry.moments_of(definitions.values(), options), here)


def _read_by(moments: Mapping[str, Moment], here: Set[str]) -> set[str]:
    """Return the variables that some moments need, of a scene with the variables `here`."""
    needed = {"position", "particle_id"}
    for name, moment in moments.items():
        needed |= {*moment.variables, *(here & {*moment.optional})}
        if name == "partners" and "coordination_number" in here:
            needed.add("coordination_number")
        elif moment.contacts:
            needed |= set(CONTACT_VARIABLES) - {"contact_normal"}
            needed |= here & {"diameter"}  # tells contacts that are far from their grains
    return needed


def requested_options(scene: Scene, request: Request, nodes: Nodes) -> Options:
    """Return the options of the algebra; raise ValueError if one is wrong."""
    setup = scene.setup
    size = request.size
    check_axes(
        setup.plane,
        pressure_dims=request.pressure_dims or "",
        shear_dims=request.shear_dims or "",
    )
    if size in ("d50", "dmax") and size not in scene.sizes:
        raise ValueError(
            f"size={size!r} is an attribute that the scene does not hold; call ds = ds.cg.measure() first"
        )
    averaged = {*nodes.averaged}
    derivatives = "zero"
    if "lattice_velocity" in scene.columns and averaged & {*setup.periodic}:
        derivatives = "box"
    elif averaged == {*setup.plane} and not averaged <= {*setup.periodic} and not scene.cylindrical:
        derivatives = "unknown"
    options = {name: getattr(request, name) for name in _OF_FORMULAS}
    if request.by is not None and request.temperature == "unbiased":
        options["temperature"] = "mixture"
    x, y, z = (nodes.spacing.get(a, 0.0) for a in COMPONENTS)
    return Options(
        **options,
        plane=tuple(setup.axes),
        active=tuple(nodes.active.tolist()),
        shape=nodes.shape,
        spacing=(x, y, z),
        wrapped=nodes.fills(np.array(scene.lasting_periods)),
        diameter=scene.sizes.get(size),
        lag=scene.lag,
        averaged_gradient=derivatives,
    )
