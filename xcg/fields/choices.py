"""Which fields are meant, which variables they take, and the choices of their algebra."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import get_args

from xcg.common.checks import is_finite, is_positive
from xcg.common.messages import unknown
from xcg.fields.formulas import registry
from xcg.fields.formulas.field import Deviatoric, Gradient, InertialSize, Options, Temperature
from xcg.fields.formulas.variables import OwnField, Quantity, own_fields, own_moments
from xcg.fields.request import Request, Sampling
from xcg.fields.sums.contact_moments import sliding_contacts
from xcg.fields.sums.moments import MOMENTS, Moment
from xcg.scene.description import Description
from xcg.scene.schema import COMPONENTS, CONTACT_VARIABLES


def possible_fields(scene: Description, request: Request) -> tuple[str, ...]:
    """Return the names of the fields that the scene's variables allow: those of a request without names."""
    return choose_fields(None, scene, options_of(scene, request))[0]


def choose_fields(
    asked: str | Quantity | Sequence[str | Quantity | registry.OwnRow] | None, scene: Description, options: Options
) -> tuple[tuple[str, ...], tuple[OwnField | registry.OwnRow, ...]]:
    """Names of the fields of a result, and those of them that are quantities of the scene's own variables."""
    if asked is None:
        here = _possible(scene.names, options)
        if not here:
            scene.require(("mass",), "coarse_grain")
        return here, ()
    lacking = lacking_fields(options)
    given = list(asked) if isinstance(asked, Iterable) and not isinstance(asked, str) else [asked]
    own = own_fields(given, scene)
    names = [own[k].name if k in own else one for k, one in enumerate(given)]
    if not names:
        raise ValueError(f"fields={asked!r}: expected at least one; leave it out for all that the scene allows")
    known, ours = [*registry.listed(), *scene.rows], {o.name for o in own.values()}
    for name in names:
        if name not in registry.listed() and name not in ours:
            raise ValueError(unknown("field", name, known, "others are listed by xcg.FIELDS and by ds.data_vars"))
    for name in names:
        if name in lacking:
            option = registry.FIELDS[name].option
            msg = f"{name} needs the argument {option}="
            if option == "lag":
                msg = f"{name} compares two frames: call ds.cg.displacement({name!r}) instead of coarse_grain"
            raise ValueError(msg)
    return tuple(dict.fromkeys(map(str, names))), tuple(dict.fromkeys(own.values()))


def lacking_fields(options: Options) -> set[str]:
    """Fields that need an argument which was not given."""
    return {name for name, f in registry.FIELDS.items() if f.option and getattr(options, f.option) is None}


@registry.remembered
def _possible(here: frozenset[str], options: Options) -> tuple[str, ...]:
    """Fields by default, of a scene that holds some variables."""
    lacking = lacking_fields(options)
    possible = [name for name in registry.listed() if registry.FIELDS[name].default and name not in lacking]
    return tuple(name for name in possible if variables_of((name,), here, options) <= here)


@registry.remembered
def variables_of(fields: tuple[str, ...], here: frozenset[str], options: Options) -> frozenset[str]:
    """Variables that some fields need, of a scene that holds those that are here."""
    needed = {"position", "particle_id"}
    rows = MOMENTS | own_moments(options.own)
    for name in registry.moments_of(fields, options):
        needed |= set(rows[name].variables) | (set(rows[name].optional) & here)
        if name == "partners" and "coordination_number" in here:
            needed.add("coordination_number")
        elif rows[name].contacts:
            needed |= set(CONTACT_VARIABLES) - {"contact_normal"}
            needed |= {"diameter"} & here  # tells contacts that are far from their grains
    return frozenset(needed)


def options_of(scene: Description, request: Request) -> Options:
    """Check the choices of the algebra."""
    for name, known in (
        ("gradient", Gradient),
        ("deviatoric", Deviatoric),
        ("size", InertialSize),
        ("temperature", Temperature),
        ("sampling", Sampling),
    ):
        value = getattr(request, name)
        if value not in get_args(known):
            raise ValueError(f"{name}={value!r}: expected one of {', '.join(get_args(known))}")
    if request.sampling == "cell" and request.gradient == "kernel":
        raise ValueError(
            "gradient='kernel' is the derivative at a node, and sampling='cell' averages over cells: take "
            "gradient='least_squares' (the default), or 'finite_difference' between the cells"
        )
    setup, size, fluid_viscosity = scene.setup, request.size, request.fluid_viscosity
    for name in ("pressure_dims", "shear_dims"):
        axes = getattr(request, name)
        if axes is not None and (not axes or set(axes) - set(setup.plane) or len(set(axes)) < len(axes)):
            raise ValueError(f"{name}={axes!r}: expected some of the scene's axes {setup.plane!r}, each once")
    if fluid_viscosity is not None and not is_positive(fluid_viscosity):
        raise ValueError(
            f"fluid_viscosity={fluid_viscosity!r}: expected a positive viscosity (Pa s), such as 1e-3 for water"
        )
    if request.friction is not None and not (is_finite(request.friction) and request.friction >= 0):
        raise ValueError(f"friction={request.friction!r}: expected a coefficient of friction, such as 0.5")
    if size in ("d50", "dmax") and size not in scene.sizes:
        raise ValueError(f"size={size!r} is an attribute that the scene does not hold; call ds = ds.cg.measure() first")
    return Options(
        plane=tuple(COMPONENTS.index(a) for a in setup.plane),
        gradient=request.gradient,
        pressure_axes=_indices(request.pressure_dims),
        shear_axes=_indices(request.shear_dims),
        deviatoric=request.deviatoric,
        size=size,
        diameter=scene.sizes.get(size),
        fluid_viscosity=fluid_viscosity,
        friction=request.friction,
        temperature=request.temperature,
        lag=scene.lag,
        by=request.by,
    )


def with_friction(friction: float | None) -> dict[str, Moment]:
    """Return the moment that takes the coefficient of friction, with it."""
    name = "sliding_contacts"
    return {} if friction is None else {name: replace(MOMENTS[name], column=partial(sliding_contacts, friction))}


def _indices(axes: str | None) -> tuple[int, ...] | None:
    return None if axes is None else tuple(COMPONENTS.index(a) for a in axes)
