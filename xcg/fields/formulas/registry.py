"""The registry of fields: one row each, with its dimensions, units, formula, the moments it needs, and the algebra.

The rows are in `xcg.fields.formulas.rows`, a module for each topic. A row's function takes ``f`` (the fields it needs),
``s`` (the moments it needs, see `xcg.fields.sums.moments`) and ``o`` (`Options`). All arrays are (phase, node, ...),
with phase 0 the bulk; fluctuations of every phase are about the velocity of the bulk, so that partial fields add up.
"""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType, SimpleNamespace
from typing import Any, ClassVar, ParamSpec, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from xcg.fields.formulas.field import Field, Options
from xcg.fields.formulas.rows import (
    contacts,
    density,
    displacement,
    energy,
    errors,
    fabric,
    flow,
    phases,
    rheology,
    rotation,
)

P = ParamSpec("P")
R = TypeVar("R")
TOPICS = (density, flow, contacts, fabric, phases, rheology, rotation, energy, displacement, errors)
_ROWS: dict[str, Field] = {name: row for topic in TOPICS for name, row in topic.ROWS.items()}
_REGISTERED: dict[str, Field] = {}  # by users, see `xcg.register_field`
# All rows by name, read-only.
FIELDS: Mapping[str, Field] = MappingProxyType(ChainMap(_REGISTERED, _ROWS))
# Other ways to a field: the option that chooses, and the row for each of its values that is not the default.
WAYS = flow.WAYS | rheology.WAYS | fabric.WAYS

_FORGET: list[Callable[[], None]] = []


def on_register(forget: Callable[[], None]) -> None:
    """Have something forgotten when a field is registered."""
    _FORGET.append(forget)


def remembered(function: Callable[P, R]) -> Callable[P, R]:
    """Have equal calls answered at once, until a field is registered."""
    cached = lru_cache(maxsize=256)(function)
    on_register(cached.cache_clear)
    return cast("Callable[P, R]", cached)


def row(name: str, options: Options) -> Field:
    """Return the row of a field, as computed with some options."""
    if options.own and name in options.own_rows:
        return options.own_rows[name]
    usual = _ROWS[name] if name in _ROWS else _REGISTERED[name]
    if name in WAYS:
        option, ways = WAYS[name]
        usual = ways.get(getattr(options, option), usual)
    if name == "velocity_gradient" and options.averaged_gradient != "zero":
        return flow.with_averaged_axes(usual, options.averaged_gradient)
    return usual


def given_options(options: Options) -> dict[str, Any]:
    """Return the options that are set only if somebody gave them, as attributes of a result."""
    found: dict[str, Any] = {}
    if options.shear_axes is not None:
        found["shear_dims"] = "".join("xyz"[k] for k in options.shear_axes)
    if options.fluid_viscosity is not None:
        found["fluid_viscosity"] = options.fluid_viscosity
    if options.diameter is not None:
        found["size_diameter"] = options.diameter
    if options.lag is not None:
        found["lag"] = options.lag
    return found


def options_of(attrs: Mapping[Any, Any]) -> Options:
    """Return the choices that a result was computed with, from its attributes."""

    def axes(name: str) -> tuple[int, ...] | None:
        return tuple("xyz".index(a) for a in attrs[name]) if name in attrs else None

    viscosity, lag = attrs.get("fluid_viscosity"), attrs.get("lag")
    return Options(
        plane=axes("plane") or (0, 1, 2),
        gradient=str(attrs.get("gradient", "least_squares")),
        pressure_axes=axes("pressure_dims"),
        shear_axes=axes("shear_dims"),
        deviatoric=str(attrs.get("deviatoric", "stress")),
        size=str(attrs.get("size", "d43")),
        temperature=str(attrs.get("temperature", "biased")),
        diameter=float(attrs["size_diameter"]) if "size_diameter" in attrs else None,
        fluid_viscosity=None if viscosity is None else float(viscosity),
        lag=None if lag is None else int(lag),
    )


def listed(*, registered: bool = True) -> list[str]:
    """Names of all fields that can be asked for, with or without those that users registered."""
    return [name for name, field in (FIELDS if registered else _ROWS).items() if field.listed]


@dataclass(frozen=True)
class OwnRow:
    """A field that a user registered, or that a preset defines, as `Options.own` holds it."""

    name: str
    row: Field
    moments: ClassVar[Mapping[str, Any]] = MappingProxyType({})


def add(name: str, field: Field) -> None:
    """Put the row of a user's field beside the others; in place of a former one of its name."""
    _REGISTERED[name] = field
    for forget in _FORGET:
        forget()


def registered_for(fields: Iterable[str], options: Options) -> tuple[OwnRow, ...]:
    """Return what users registered of all that some fields need."""
    return tuple(OwnRow(name, _REGISTERED[name]) for name in order_of(tuple(fields), options) if name in _REGISTERED)


@remembered
def order_of(fields: tuple[str, ...], options: Options) -> tuple[str, ...]:
    """All rows needed for some fields, each after what it needs."""
    chains = ((*order_of(row(name, options).fields, options), name) for name in fields)
    return tuple(dict.fromkeys(name for chain in chains for name in chain))


@remembered
def moments_of(fields: tuple[str, ...], options: Options) -> tuple[str, ...]:
    """All moments needed for some fields."""
    return tuple(dict.fromkeys(s for name in order_of(fields, options) for s in row(name, options).moments))


def evaluate(fields: Sequence[str], moments: Mapping[str, NDArray], options: Options) -> dict[str, NDArray]:
    """Compute fields from moments with NumPy; arrays (phase, node, ...)."""
    s, f = SimpleNamespace(**moments), SimpleNamespace()
    with np.errstate(all="ignore"):  # as the program: nodes without grains divide 0 by 0
        for name in order_of(tuple(fields), options):
            setattr(f, name, row(name, options).compute(f, s, options))
    return {name: getattr(f, name) for name in fields}
