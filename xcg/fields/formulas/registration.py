"""Registration of fields by users: checks of a definition, and its trial on made-up moments of a few nodes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import unknown
from xcg.fields.formulas.field import Field, Options
from xcg.fields.formulas.registry import (
    COORDINATES,
    FIELDS,
    REGISTERED,
    NamedField,
    evaluate,
    fields_of,
    listed,
    moments_of,
)
from xcg.fields.sums.moments import MOMENTS, Moment
from xcg.scene.schema import powers_of, units_of

_PHASES = 3  # of the trial: the bulk and two phases
_NODES = 5  # of which the first is empty


def register_field(
    name: str,
    compute: Callable[[Any, Any, Options], NDArray],
    *,
    rank: int = 0,
    units: str | None = None,
    powers: Sequence[int] | None = None,
    long_name: str = "",
    formula: str = "",
    fields: str | Sequence[str] = (),
    moments: str | Sequence[str] = (),
    additive: bool = False,
    weight: str = "",
    constants: bool = False,
) -> None:
    """Register a custom field, which `coarse_grain` then takes by its name.

    Any NumPy will do. Arithmetic and square roots, element by element, run in the compiled program
    of the other fields; a formula with anything else runs in NumPy, block by block, with the same
    bits. `coarse_grain` without names computes the fields of xcg only. A name may be registered
    again, which replaces the former field.

    Parameters
    ----------
    name : str
        The name for ``fields=`` and in the result.
    compute : callable
        ``compute(f, s, o)`` gives the field, an array (phase, node), followed by 3 for a vector,
        (3, 3) for a tensor. ``f.<name>`` are the fields that it needs, ``s.<name>`` the moments, in
        the same form, and ``o`` the options (`xcg.fields.formulas.field.Options`), such as the axes
        ``o.plane`` of the scene. Phase 0 is the bulk. Nodes where nothing reaches hold zeros, and
        NaN in what is divided by a density.
    rank : int
        0 for a scalar, 1 for a vector, 2 for a tensor.
    units : str, optional
        SI unit, a product of m, kg, s, N, Pa, J and W, such as "Pa" or "kg m^-3". By default that of
        the formula, or "1" if it mixes dimensions, as ``np.exp(f.density)`` does.
    powers : tuple of int, optional
        Powers of (length, mass, time) of the unit instead of its name: (-1, 1, -2) is Pa.
    long_name, formula : str
        What it is, and its formula as text, for the attributes of the result.
    fields : str or list of str
        The fields that it is computed from.
    moments : str or list of str
        The moments that it is computed from, names in `xcg.fields.sums.moments.MOMENTS`.
    additive : bool
        Whether it is a sum: partial fields of phases add up to the bulk, and averages are means.
    weight : str
        For a ratio, the field that weighs its averages: the one in the denominator. A field that is
        neither additive nor weighted is computed anew from averages of the fields that it needs.
    constants : bool
        Whether numbers in the formula have units of their own, as 2500 kg/m^3 does: `units` are then
        taken as they are given.

    Returns
    -------
    None
        The field is known in this process; tasks take it with them to others.

    Raises
    ------
    ValueError
        If the unit is not that of the formula, the name is taken, what the field needs does not
        exist, or the formula fails on a trial of a few nodes: it raises, returns another shape,
        changes what it is given, or gives a node values that depend on other nodes.

    Examples
    --------
    >>> import numpy as np
    >>> import xcg
    >>> xcg.register_field(
    ...     "major_stress",
    ...     lambda f, s, o: np.linalg.eigvalsh(f.stress)[..., -1],
    ...     fields="stress",
    ...     units="Pa",
    ...     long_name="largest principal stress",
    ... )
    >>> f = xcg.datasets.simple_cubic(4).cg.coarse_grain("major_stress", axes="z")
    >>> f.major_stress.attrs["units"]
    'Pa'
    """
    field = Field(
        rank=rank,
        units=_unit(name, units, powers),
        long_name=long_name or str(name).replace("_", " "),
        formula=formula,
        compute=compute,
        fields=_names(fields),
        moments=_names(moments),
        additive=additive,
        weight=weight,
        default=False,
    )
    _check(name, field)
    field = replace(
        field,
        option=next((FIELDS[need].option for need in field.fields if FIELDS[need].option), ""),
    )
    trial = _try_out(name, field)
    if not constants:
        field = _with_unit_of_formula(name, field, trial, is_given=bool(units or powers))
    REGISTERED[name] = field


def _names(names: str | Sequence[str]) -> tuple[str, ...]:
    if isinstance(names, str):
        return (names,)
    return tuple(names)


def _unit(name: Any, units: str | None, powers: Sequence[int] | None) -> str:
    """Return the unit of a field, given as text or as powers."""
    if units is not None and powers is not None:
        _refuse(name, f"units={units!r} and powers={powers!r} both give its unit; pass one of them")
    if powers is not None:
        if len(powers) != 3 or not all(isinstance(power, int) for power in powers):
            _refuse(
                name,
                f"powers={powers!r}: expected whole powers of (length, mass, time), such as (-1, 1, -2) for Pa",
            )
        length, mass, time = powers
        return units_of((length, mass, time))
    try:
        powers_of(units or "1")
    except ValueError as error:
        _refuse(name, str(error))
    return units or "1"


def _refuse(name: Any, why: str) -> NoReturn:
    raise ValueError(f"register_field({name!r}): {why}") from None


def _check(name: str, field: Field) -> None:
    of_xcg = listed(registered=False)
    if not isinstance(name, str) or not name.isidentifier() or name.startswith("_"):
        _refuse(name, "expected a name of letters, digits and underscores, such as 'major_stress'")
    if name in (*of_xcg, *COORDINATES):
        _refuse(name, "the name is that of a field of xcg, or of a coordinate; choose another")
    if not callable(field.compute):
        _refuse(name, f"compute={field.compute!r}: expected a function compute(f, s, o)")
    if field.rank not in (0, 1, 2):
        _refuse(name, f"rank={field.rank!r}: expected 0 (scalar), 1 (vector) or 2 (tensor)")
    if not field.fields and not field.moments:
        _refuse(name, "name the fields= or moments= that it is computed from")
    for need in field.fields:
        if need not in listed():
            _refuse(
                name, f"it needs an {unknown('field', need, listed(), 'fields are in xcg.FIELDS')}"
            )
    for need in field.moments:
        if need not in MOMENTS:
            where = "moments are in xcg.fields.sums.moments.MOMENTS"
            _refuse(name, f"it needs an {unknown('moment', need, list(MOMENTS), where)}")
    if name in fields_of(field.fields, Options()):
        _refuse(name, f"it is needed for {', '.join(field.fields)}, which it needs itself")
    if field.weight and (
        field.additive or field.weight not in of_xcg or not FIELDS[field.weight].additive
    ):
        sums = [other for other in of_xcg if FIELDS[other].additive and FIELDS[other].rank == 0]
        _refuse(
            name,
            f"weight={field.weight!r}: expected, for a field that is not additive, one of {', '.join(sums)}",
        )


@dataclass(frozen=True, eq=False)
class _Trial:
    """Fields that were computed from made-up moments, by name."""

    fields: Mapping[str, NDArray]
    moments: Mapping[str, NDArray]
    options: Options


def _with_unit_of_formula(name: str, field: Field, trial: _Trial, *, is_given: bool) -> Field:
    """Return the field with the unit of its formula; raise ValueError if another one was given."""
    powers = _powers_of_formula(name, field, trial)
    if powers is None or powers == field.powers:
        return field
    way_out = "pass constants=True if numbers in the formula have units of their own"
    if not all(power.is_integer() for power in powers):
        if is_given:
            why = "its formula has none: it mixes dimensions, or takes a root of one"
            _refuse(name, f"its unit was given as {field.units!r}, and {why}; {way_out}")
        return field
    length, mass, time = map(int, powers)
    unit = units_of((length, mass, time))
    if is_given:
        why = f"its formula has the unit {unit!r}"
        _refuse(
            name,
            f"its unit was given as {field.units!r}, and {why}: leave units= and powers= out, or {way_out}",
        )
    return replace(field, units=unit)


def _powers_of_formula(name: str, field: Field, trial: _Trial) -> tuple[float, ...] | None:
    """Return the powers of (length, mass, time) of a formula, NaN if it mixes dimensions; None if it gives no numbers.

    It is computed again from inputs in units of half the length, mass or time.
    """
    values = np.asarray(trial.fields[name], float)
    is_number = np.isfinite(values) & (values != 0)
    if not is_number.any():
        return None
    powers = []
    for k in range(3):
        fields = {n: trial.fields[n] * 2.0 ** FIELDS[n].powers[k] for n in field.fields}
        moments = {n: trial.moments[n] * 2.0 ** MOMENTS[n].powers[..., k] for n in field.moments}
        viscosity = 2.0 ** powers_of("Pa s")[k] * (trial.options.fluid_viscosity or 0.0)
        options = replace(trial.options, fluid_viscosity=viscosity)
        with np.errstate(all="ignore"):
            scaled = field.compute(SimpleNamespace(**fields), SimpleNamespace(**moments), options)
            power = np.log2(np.asarray(scaled, float) / values)[is_number]
        nearest = np.round(2 * power[0]) / 2
        if not np.allclose(power, nearest, rtol=0.0, atol=1e-6):
            nearest = np.nan
        powers.append(float(nearest))
    return tuple(powers)


def _try_out(name: str, field: Field) -> _Trial:
    """Return the field, computed from made-up moments."""
    options = Options(fluid_viscosity=1.0, friction=1.0, own=(NamedField(name, field),))
    moments = _made_up(moments_of(fields_of((name,), options).values(), options))
    of_some = {moment: a[:, 2:4] for moment, a in moments.items() if moment != "reference"}
    of_some["reference"] = moments["reference"][2:4]
    try:
        fields = evaluate([*field.fields, name], moments, options)
        again = evaluate([name], of_some, options)[name]
    except Exception as error:
        why = "its formula fails on a trial of a few nodes, of which one sees no grains (ratios are NaN there)"
        if isinstance(error, AttributeError) and isinstance(error.obj, SimpleNamespace):
            why = f"its formula takes {error.name!r}, which neither fields= nor moments= names"
        raise ValueError(
            f"register_field({name!r}): {why}: {type(error).__name__}: {error}"
        ) from error
    values = np.asarray(fields[name])
    expected = (_PHASES, _NODES, *(3,) * field.rank)
    if values.shape != expected or values.dtype.kind not in "biuf":
        _refuse(
            name,
            f"of {_PHASES} phases at {_NODES} nodes its formula gives {values.dtype} {values.shape}; "
            f"of rank={field.rank} it has to give numbers {expected}",
        )
    for need, unchanged in evaluate(field.fields, moments, options).items():
        if not np.array_equal(fields[need], unchanged, equal_nan=True):
            _refuse(
                name,
                f"its formula changes the field {need!r} that it is given; let it work on a copy",
            )
    if not np.allclose(values[:, 2:4], again, rtol=1e-9, equal_nan=True):
        _refuse(
            name,
            "what its formula gives at a node depends on other nodes, which are computed block by block",
        )
    return _Trial(fields, moments, options)


def _made_up(moments: Mapping[str, Moment]) -> dict[str, NDArray]:
    """Moments (phase, node, ...) of two phases and the bulk, read-only; symmetric tensors are positive."""
    rng = np.random.default_rng(0)
    made_up = {}
    for name, moment in moments.items():
        tail = (_PHASES,) * moment.paired + moment.shape
        values = rng.uniform(0.5, 1.5, (_PHASES, _NODES, *tail))
        if tail[-2:] == (3, 3):
            values = values + values.swapaxes(-1, -2) + 4 * np.eye(3)
        values[0] = values[1] + values[2]
        values[:, 0] = 0.0
        made_up[name] = values
    made_up["reference"] = rng.uniform(-1.0, 1.0, (_NODES, 3))
    for values in made_up.values():
        values.flags.writeable = False
    return made_up
