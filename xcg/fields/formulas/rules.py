"""Rules of averages: the fields that averages of a field are made of, by the rule of its definition."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from xcg.fields.formulas import registry
from xcg.fields.formulas.field import Field, Options

NO_RULE = "a rule: give it one with xcg.register_field, or leave it out with drop_vars"
OF_COVARIANCE = ("density", "velocity")
ENDS = ("_error", "_bias")  # of the names of what stands beside an average


def needed_for_averages(names: Iterable[str], options: Options) -> tuple[str, ...]:
    """Return the fields that have to be in a result beside some others, so that averages of all can be taken."""
    names = tuple(names)
    errors = errors_among(names)
    held = dict.fromkeys(name for name in names if name not in errors)
    for name in tuple(held):
        _obtained(name, registry.field_of(name, options), held, options)
    if any(takes_covariance(registry.field_of(name, options), options) for name in held):
        held |= dict.fromkeys(OF_COVARIANCE)
    return tuple(name for name in held if name not in names)


def lacking_sums(definitions: Mapping[str, Field | None], options: Options) -> dict[str, list[str]]:
    """Return the fields that averages of each field of a result lack, each named once; a definition may be None."""
    held = dict.fromkeys(definitions)
    lacking: dict[str, list[str]] = {}
    for name, field in definitions.items():
        of_field = _obtained(name, field, held, options)
        if of_field:
            lacking[name] = list(dict.fromkeys(of_field))
    return lacking


def _obtained(name: str, field: Field | None, held: dict[str, None], options: Options) -> list[str]:
    """Return what averages of a field lack, and add it to what is `held`."""
    if field is None:
        return [NO_RULE]
    parts = [name]
    if field.additive:
        if _follows(name, held, options):
            return []
    elif field.weight:
        parts.append(field.weight)
    elif field.moments:
        return [NO_RULE]
    else:
        lacking = []
        for need in field.fields:
            lacking += _obtained(need, registry.field_of(need, options), held, options)
        return lacking
    parts = [part for part in parts if part not in held]
    held |= dict.fromkeys(parts)
    return parts


def _follows(name: str, held: Mapping[str, None], options: Options) -> bool:
    """Return whether a sum is held, or follows from sums that are."""
    if name in held:
        return True
    field = registry.field_of(name, options)
    return (
        bool(field.fields)
        and not field.moments
        and all(_follows(need, held, options) for need in field.fields)
    )


def all_of(lacking: Mapping[str, Iterable[str]]) -> tuple[str, ...]:
    """Return the fields that averages of several fields lack, each once."""
    fields = dict.fromkeys(field for of_field in lacking.values() for field in of_field)
    fields.pop(NO_RULE, None)
    return tuple(fields)


def errors_among(names: Iterable[str]) -> list[str]:
    """Return the names of the errors and biases of other fields in the list."""
    names = list(names)
    errors = []
    for end in ENDS:
        errors += [name for name in names if name.endswith(end) and name.removesuffix(end) in names]
    return errors


def has_bias(field: Field, options: Options) -> bool:
    """Return whether a field of averaged sums has a known bias: it is neither linear in them, a ratio, nor an angle."""
    if field.is_angle:
        return False
    return not (field.additive or field.weight) or takes_covariance(field, options)


def takes_covariance(field: Field, options: Options) -> bool:
    """Return whether averages are about the averaged velocity: of kinetic stress, what is linear in it, and fluxes."""
    if field.covariance is not None:
        return True
    if not field.additive or field.moments:
        return False
    needs = [registry.field_of(name, options) for name in field.fields]
    is_linear = all(need.additive for need in needs)
    return is_linear and any(takes_covariance(need, options) for need in needs)


def takes_stress_of_step(field: Field, options: Options) -> bool:
    """Return whether a field follows from the kinetic stress, but for temperatures; a flux does not."""
    if field.rank == 1:
        return False
    if takes_covariance(field, options):
        return True
    return not field.moments and any(
        takes_stress_of_step(registry.field_of(name, options), options) for name in field.fields
    )
