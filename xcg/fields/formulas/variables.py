"""Any variable of particles or contacts as a field: its sum, its mean, its variance, and the flux it is carried by.

With q the variable, u a weight and <q> the mean at the node: ``sum u q Psi``, ``<q> = sum u q Psi /
sum u Psi``, ``sum u (q - <q>)^2 Psi / sum u Psi`` and ``sum u (q - <q>)(v - V) Psi``, over
particles. Variables of contacts are summed at the contact points, each contact once. What is about
a mean is summed as velocity is, relative to a value at each node, so that nothing large is
subtracted from something equally large. What flows along contacts is summed along their branches,
as stress is.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.messages import SceneError, unknown
from xcg.compiled import points as loops
from xcg.fields.formulas import registry
from xcg.fields.formulas.algebra import at_least_zero, mean_of, where_positive, zero_if_unknown
from xcg.fields.formulas.field import (
    WEIGHTS,
    Conduction,
    Field,
    Flux,
    Mean,
    Options,
    Quantity,
    Sum,
    Variance,
    Weight,
    read_quantity,
)
from xcg.fields.sums.moments import Moment, of_sides
from xcg.scene.contacts import Contacts
from xcg.scene.scene import Scene
from xcg.scene.schema import (
    Frame,
    factors_of_unit,
    powers_of,
    product_of_units,
    units_in,
    units_of,
    variable,
)


class _MeanError(Variance):
    """The standard error of a mean in one step, ``sqrt(variance / N_eff)``, as of independent values of the particles.

    The variance is about the mean of each phase, and unbiased: ``sum u (q - <q>)^2 Psi / (sum u Psi
    - sum (u Psi)^2 / sum u Psi)``; ``N_eff = (sum u Psi)^2 / sum (u Psi)^2``. See
    `xcg.fields.formulas.rows.errors`.
    """

    prefix = ""


# --- in a plan -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class OwnField:
    """A quantity of a scene's variable: what the registry and the deposits know of a field, for this one.

    Attributes
    ----------
    quantity : Quantity
    name : str
        Of the result.
    weight : str
        A key of `WEIGHTS`.
    rank : int
        Of the variable: 0 scalar, 1 vector, 2 tensor.
    at_contacts : bool
        Whether it is a variable of contacts.
    units : str
        Of the result; empty where the variable has none.
    what : str
        The variable in words.
    """

    quantity: Quantity
    name: str
    weight: Weight
    rank: int
    at_contacts: bool
    units: str
    what: str

    @property
    def follows_mean(self) -> bool:
        """Return whether it is about the mean at the node, which follows the grains there."""
        return type(self.quantity) in (Variance, Flux)

    @property
    def moments(self) -> dict[str, Moment]:
        """The sums that it needs and that are not in the registry of moments."""
        q = self.quantity.variable
        if isinstance(self.quantity, Conduction):
            formula = f"{q} a, along the branch"
            moment = Moment(
                self._reads,
                formula,
                (3,),
                column=partial(_of_sides, q),
                contacts=True,
                over="branches",
            )
            return {formula: moment}
        if isinstance(self.quantity, (Mean, Sum)):
            moment = Moment(
                self._reads,
                f"{WEIGHTS[self.weight][0]} {q}".removeprefix("1 "),
                (3,) * self.rank,
                column=partial(_weighted, q, self.weight),
                contacts=self.at_contacts,
                over="contacts" if self.at_contacts else "grains",
            )
            return {f"{self.weight} {q}": moment}
        return dict(map(self._products, self._triples))

    @property
    def _reads(self) -> tuple[str, ...]:
        """Variables that its sums read."""
        if self.weight == "number":
            return (self.quantity.variable,)
        return (self.quantity.variable, self.weight)

    @property
    def _triples(self) -> list[tuple[_Number, ...]]:
        """Three numbers a pass, whose products are summed relative to each node."""
        components: list[_Number] = [(self.quantity.variable, k) for k in range(3**self.rank)]
        if isinstance(self.quantity, Variance):
            components += [None] * (-len(components) % 3)
            return [tuple(components[k : k + 3]) for k in range(0, len(components), 3)]
        x, y, z = (("velocity", k) for k in range(3))
        triples: list[tuple[_Number, ...]] = []
        for component in components:
            triples.append((component, x, y))
            triples.append((component, z, None))
        return triples

    def _products(self, triple: tuple[_Number, ...]) -> tuple[str, Moment]:
        """Return the name and the moment of the sums of products of three numbers."""
        symbol = WEIGHTS[self.weight][0]
        layout = _ABOUT
        squares = ""
        if isinstance(self.quantity, _MeanError):
            layout = (*_ABOUT, loops.SQUARE)
            squares = f", {symbol}^2 Psi"
        parts = [part for part in triple if part is not None]
        variables = [name for name, _ in parts]
        moment = Moment(
            tuple(dict.fromkeys([*self._reads, *variables])),
            f"{symbol} (1, q, q q){squares} of {', '.join(map(_text, parts))}",
            (len(layout),),
            loops.FLUCTUATION,
            loops.MASS,
            partial(_numbers, triple, self.weight),
            layout=layout,
            vector=self.rank == 1 and isinstance(self.quantity, Variance),
            contacts=self.at_contacts,
            over="vectors",
        )
        return f"{self.weight} about {', '.join(map(_text, triple))}{squares}", moment

    @property
    def error(self) -> Quantity | None:
        """Error of this quantity in one step, a quantity; None if unknown."""
        if not isinstance(self.quantity, Mean) or self.at_contacts:
            return None
        return _MeanError(self.quantity.variable, self.weight, f"{self.name}_error")

    @property
    def field(self) -> Field:
        """The field as the registry would hold it."""
        names = tuple(self.moments)
        rank = self.rank
        q = self.quantity.variable
        kind = type(self.quantity)
        # what weights sum to: a moment, and the field that weighs averages over nodes or steps
        symbol, _, total, counts = WEIGHTS[self.weight]
        point = "Psi"
        rows = "particles"
        if self.at_contacts:
            total = "contacts"
            counts = "contact_number_density"
            point = "Psi(r - c)"
            rows = "contacts"
        u = f"{symbol}_i ".removeprefix("1_i ")
        below = f"sum {u}{point}"
        mean = f"<q> = sum {u}q {point} / {below}"
        forms: dict[type[Quantity], tuple[Any, ...]] = {
            Mean: (
                f"mean of {self.what}, weighted by {self.weight}",
                f"sum {u}q {point} / {below}",
                lambda f, s, o: mean_of(getattr(s, names[0]), getattr(s, total)),
                (total,),
            ),
            Sum: (
                f"sum of {self.what} in a unit of volume",
                f"sum {u}q {point}",
                lambda f, s, o: getattr(s, names[0]),
                (),
            ),
            Variance: (
                f"variance of {self.what}, weighted by {self.weight}",
                f"sum {u}(q - <q>)^2 {point} / {below}, {mean}",
                partial(_variance, names, rank),
                (),
            ),
            _MeanError: (
                f"standard error in one step of the mean of {self.what}",
                f"sqrt(var(q) sum ({u}{point})^2) / {below}",
                partial(_mean_error, names, rank),
                (),
            ),
            Flux: (
                f"flux of {self.what} by fluctuations of the velocity",
                f"sum {u}(q - <q>)(v_i - V) {point}, {mean}",
                partial(_flux, names, rank),
                ("mass", "momentum"),
            ),
            Conduction: (
                f"flux of {self.what} along contacts",
                "sum_c q [(r_i - c) S_i + (c - r_j) S_j], S_i = int_0^1 Psi(r - c - s (r_i - c)) ds",
                lambda f, s, o: getattr(s, names[0]),
                (),
            ),
        }
        long_name, formula, compute, more = forms[kind]
        weight = ""
        if kind in (Mean, Variance):
            weight = counts
        return Field(
            rank=rank + (kind in (Flux, Conduction)),
            units=self.units,
            long_name=long_name,
            formula=f"{formula}, q = {q}",
            compute=compute,
            fields=("_drift",) * (kind is Flux),
            moments=(*names, *more),
            additive=kind in (Sum, Flux, Conduction),
            weight=weight,
            source=f"variable {q!r} of the {rows}",
        )


def field_of_result(field: xr.DataArray) -> Field | None:
    """Return what averages have to know of a quantity in a result, from its attributes; None for other fields."""
    if "source" not in field.attrs:
        return None
    weight = str(field.attrs.get("weight", ""))
    return Field(formula="", compute=lambda f, s, o: None, additive=not weight, weight=weight)


def own_fields(
    requested: Iterable[str | Quantity | registry.NamedField], scene: Scene
) -> dict[int, OwnField | registry.NamedField]:
    """Return the requested fields that are quantities of a variable, or named fields, by their index in the list.

    Names of fields come first: ``"density"`` is the field, and ``Mean("density")`` the mean of the
    variable.

    Raises
    ------
    SceneError, ValueError
        As `own_field`, or if two have the same name.
    """
    own: dict[int, OwnField | registry.NamedField] = {}
    by_name: dict[str, list[Quantity]] = {}
    for k, field in enumerate(requested):
        quantity: Any = field
        if isinstance(field, registry.NamedField):
            own[k] = field
            continue
        if isinstance(field, str) and field not in registry.FIELDS:
            quantity = read_quantity(field)
            if quantity is None and field in scene.rows:
                quantity = Mean(field)
        if isinstance(quantity, Quantity):
            result = own_field(quantity, scene)
            own[k] = result
            by_name.setdefault(result.name, []).append(quantity)
    for name, quantities in by_name.items():
        different = dict.fromkeys(quantities)
        if len(different) > 1:
            raise ValueError(
                f"{' and '.join(map(str, different))} would both be called {name!r}; pass name="
            )
    return own


def own_field(quantity: Quantity, scene: Scene) -> OwnField:
    """Return a quantity as a field of the scene, checked against its variable; reads attributes only.

    Raises
    ------
    SceneError
        If the scene has no such variable, or the variable has other dimensions than one of
        particles or contacts.
    ValueError
        If the quantity is not defined for it.
    """
    name = quantity.variable
    if name not in scene.columns:
        raise SceneError(f"{quantity}: {unknown('variable', name, scene.rows)}")
    column = scene.columns[name]
    dtypes = {"i": "int64", "u": "int64"}
    row = variable(name, dtypes.get(column.dtype.kind, "float64"), max(len(column.dims) - 1, 1))
    rank = len(row.dims) - 1
    if set(column.dims) != {"time", *row.dims} or column.dtype.kind not in "fiub":
        raise SceneError(_wrong_dims(name, column, row.dims))
    at_contacts = row.dims[0] == "contact"
    weight = quantity.weight or quantity.usual
    if at_contacts and quantity.weight is None:
        weight = "number"
    if at_contacts and (weight != "number" or isinstance(quantity, Flux)):
        lack = {"number": "velocity"}.get(weight, weight)
        raise ValueError(
            f"{quantity}: {name!r} is a variable of contacts, which have no {lack}: "
            "leave weight= out, and take Mean, Sum or Variance"
        )
    if isinstance(quantity, Conduction) and not (at_contacts and rank == 0):
        raise ValueError(
            f"{quantity}: {name!r} is {column.dims}; what flows along contacts is one number "
            "for each contact"
        )
    if isinstance(quantity, Flux) and rank == 2:
        raise ValueError(
            f"{quantity}: {name!r} is a tensor, and its flux would have 27 components; "
            "take those of its components"
        )
    result = quantity.name or quantity.prefix + name
    if quantity.name is None and result in registry.FIELDS:
        result = f"mean_{name}"
    if result in registry.FIELDS or result in registry.COORDINATES:
        raise ValueError(
            f"{quantity}: the result cannot be called {result!r}, which is something else "
            "in a result; pass name="
        )
    unit = column.attrs.get("units")
    long_name = column.attrs.get("long_name") or name.replace("_", " ")
    return OwnField(
        quantity,
        result,
        weight,
        rank,
        at_contacts,
        units=_units(quantity, weight, unit and str(unit), scene.setup.unit_system),
        what=str(long_name),
    )


def check_turns(own: Iterable[Any]) -> None:
    """Raise ValueError for quantities whose sums cannot be rotated from place to place, as a cylindrical frame does.

    Raises
    ------
    ValueError
        If one is a flux, or a variance of tensors.
    """
    for field in own:
        if not isinstance(field, OwnField):
            continue
        quantity = field.quantity
        of_tensors = isinstance(quantity, Variance) and field.rank == 2
        if isinstance(quantity, Flux) or of_tensors:
            raise ValueError(
                f"{quantity} is not there in a cylindrical frame: take it in the scene's axes, "
                "or Mean, Sum and the Variance of scalars and vectors"
            )


def _wrong_dims(name: str, column: xr.Variable, expected: tuple[str, ...]) -> str:
    rows = expected[0]
    way_out = (
        f"expected numbers with ('time', {rows!r}), and 'component' for vectors, "
        "or 'component' and 'direction' for tensors"
    )
    if "contact" in column.dims and rows == "particle":
        rename = f"ds = ds.rename({name}='contact_{name}')"
        way_out = f"names of variables of contacts begin with 'contact_'; call {rename}"
    elif "particle" in column.dims and rows == "contact":
        way_out = (
            "names that begin with 'contact_' are for contacts; give it another name, by ds.rename"
        )
    elif "time" not in column.dims:
        way_out = f"add the dimension time, ds.assign({name}=ds.{name}.expand_dims(time=ds.time))"
    dims = f"{name!r} has the dimensions {column.dims} and NumPy's type {column.dtype.kind!r}"
    return f"{dims}: {way_out}"


def _units(quantity: Quantity, weight: Weight, unit: str | None, system: str) -> str:
    """Return the unit of a quantity, from that of its variable; empty where the variable has none."""
    if unit is None:
        return ""
    if isinstance(quantity, (Mean, _MeanError)):
        return unit
    if isinstance(quantity, Variance):
        return _times(unit, 2, "1")
    length, mass, time = powers_of(WEIGHTS[weight][1])
    length -= 3  # in a unit of volume
    time = 0
    if isinstance(quantity, Flux):  # times a velocity
        length += 1
        time = -1
    if isinstance(quantity, Conduction):  # times a branch
        length += 1
    return _times(unit, 1, units_in(units_of((length, mass, time)), system))


def _times(unit: str, exponent: int, other: str) -> str:
    """Return the unit of a power of what has one unit, times what has another: ``K kg m^-3``."""
    factors = factors_of_unit(unit)
    if factors is None:  # another notation
        return f"({unit})^{exponent} {other}".replace("^1 ", " ").removesuffix(" 1")
    powers = {name: exponent * power for name, power in factors.items()}
    for name, power in (factors_of_unit(other) or {}).items():
        powers[name] = powers.get(name, 0) + power
    return product_of_units(powers)


# --- sums ------------------------------------------------------------------------------------------------

# a component of a variable, numbered row by row; None for zeros
_Number = tuple[str, int] | None
# of three numbers a, b, c: the weight; a, b, c; their products aa ab ac bb bc cc; of errors also
# the weight's square
_ABOUT = (
    loops.MASS,
    *(loops.MOMENTUM + k for k in range(3)),
    *(loops.KINETIC + k for k in range(6)),
)
_FIRST = 1
_SQUARES = (4, 7, 9)
_PRODUCTS = (5, 6)
_OF_WEIGHTS = 10
# components of a scalar, vector or tensor in one pass
_IN_A_PASS = (1, 3, 3)


def _text(part: _Number) -> str:
    if part is None:
        return "0"
    return f"{part[0]}[{part[1]}]"


def _weights(weight: str, frame: Frame, count: int) -> NDArray:
    if weight == "number":
        return np.ones(count)
    return frame[weight]


def _weighted(name: str, weight: str, frame: Frame, _: Contacts) -> NDArray:
    q = frame[name]
    return q * _weights(weight, frame, len(q)).reshape(-1, *(1,) * (q.ndim - 1))


def _of_sides(name: str, frame: Frame, _: Contacts) -> NDArray:
    """Return what each side of each contact receives."""
    return of_sides(frame[name], -frame[name])


def _numbers(triple: Iterable[_Number], weight: str, frame: Frame, _: Contacts) -> NDArray:
    """Weight and three numbers (n, 4)."""
    count = next(len(frame[part[0]]) for part in triple if part)
    out = np.zeros((count, 4))
    out[:, 0] = _weights(weight, frame, count)
    for k, part in enumerate(triple, start=1):
        if part is not None:
            values = frame[part[0]]
            out[:, k] = values.reshape(count, math.prod(values.shape[1:]))[:, part[1]]
    return out


# --- algebra ---------------------------------------------------------------------------------------------


def _bulk_mean(weight: NDArray, first: NDArray) -> NDArray:
    """Mean of the bulk, relative to the node's value, 0 where there are no grains."""
    return zero_if_unknown(mean_of(first[:1], weight[:1]))


def _variance(names: tuple[str, ...], rank: int, f: Any, s: Any, o: Options) -> NDArray:
    """Return S u (q - b)^2 / S u, with S u (q - b)^2 = S u q q - b S u q - (S u q - b S u) b."""
    variances = []
    for name, k in product(names, range(_IN_A_PASS[rank])):
        sums = getattr(s, name)
        weight = sums[..., 0]
        first = sums[..., _FIRST + k]
        b = _bulk_mean(weight, first)
        squares = sums[..., _SQUARES[k]] - b * first - (first - b * weight) * b
        variances.append(at_least_zero(mean_of(squares, weight)))
    return _components(variances, rank)


def _mean_error(names: tuple[str, ...], rank: int, f: Any, s: Any, o: Options) -> NDArray:
    """Return the error of a mean, see `_MeanError`."""
    errors = []
    for name, k in product(names, range(_IN_A_PASS[rank])):
        sums = getattr(s, name)
        weight = where_positive(sums[..., 0])
        first = sums[..., _FIRST + k]
        square = sums[..., _OF_WEIGHTS]
        scatter = at_least_zero(sums[..., _SQUARES[k]] - first * first / weight)
        freedom = where_positive(weight - square / weight)
        errors.append(np.sqrt(scatter * square / (freedom * weight * weight)))
    return _components(errors, rank)


def _flux(names: tuple[str, ...], rank: int, f: Any, s: Any, o: Options) -> NDArray:
    """Return S u (q - b)(v - V) = S u q v - b S u v - V (S u q - b S u).

    V is relative to the velocity that the main pass refers to at the node, which is that of the
    same grain.
    """
    fluxes = []
    drift = f._drift[:1]
    for name_of_xy, name_of_z in zip(names[::2], names[1::2], strict=True):
        with_xy = getattr(s, name_of_xy)
        with_z = getattr(s, name_of_z)
        weight = with_xy[..., 0]
        first = with_xy[..., _FIRST]
        b = _bulk_mean(weight, first)
        rest = first - b * weight  # nothing but for phases
        for axis, (sums, k) in enumerate(((with_xy, 0), (with_xy, 1), (with_z, 0))):
            with_speed = sums[..., _PRODUCTS[k]]
            speed = sums[..., _FIRST + 1 + k]
            drifting = zero_if_unknown(drift[..., axis]) * rest
            fluxes.append(with_speed - b * speed - drifting)
    return _components(fluxes, rank + 1)


def _components(components: list[NDArray], rank: int) -> NDArray:
    """Return fields (phase, node, ...) from their components; nodes run fastest in memory."""
    shape = (3,) * rank
    whole = np.stack(components).reshape(*shape, *components[0].shape)
    return whole.transpose(rank, rank + 1, *range(rank))
