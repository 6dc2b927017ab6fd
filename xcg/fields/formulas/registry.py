"""The registry of fields: one row each, with its dimensions, units, formula, the moments it needs, and the algebra.

The rows are in `xcg.fields.formulas.rows`, a module for each topic. A row's function takes ``f``
(the fields it needs), ``s`` (the moments it needs, see `xcg.fields.sums.moments`) and ``o``
(`Options`). All arrays are (phase, node, ...), with phase 0 the bulk; fluctuations of every phase
are about the velocity of the bulk, so that partial fields add up.
"""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType, SimpleNamespace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from xcg.fields.formulas.field import OF_CALLS, Field, Options
from xcg.fields.formulas.rows import (
    contacts,
    displacement,
    energy,
    errors,
    flow,
    orientation,
    rheology,
)
from xcg.fields.sums.moments import MOMENTS, Moment, load_bearing_sliding, sliding_contacts
from xcg.scene.facts import RENAMED, SETUP, saved_options
from xcg.scene.schema import COMPONENTS


class _Fields(ChainMap[str, Field]):
    """Rows of fields by name, registered by users and by xcg."""

    def __repr__(self) -> str:
        """Return the number of fields, by topic, and how to see them."""
        counts = []
        for topic in TOPICS:
            count = sum(not name.startswith("_") for name in topic.ROWS)
            counts.append(f"{topic.__name__.rpartition('.')[2]} {count}")
        if REGISTERED:
            counts.append(f"registered {len(REGISTERED)}")
        return (
            f"{len(listed())} fields ({', '.join(counts)}): list(xcg.FIELDS) for their names, "
            "xcg.FIELDS['density'] for one of them"
        )


TOPICS = (flow, contacts, rheology, energy, orientation, displacement, errors)
_ROWS: dict[str, Field] = {name: field for topic in TOPICS for name, field in topic.ROWS.items()}
REGISTERED: dict[str, Field] = {}  # by users, see `xcg.register_field`
# All rows by name, read-only.
_NOTHING: Any = MappingProxyType({})  # is what would be written to
FIELDS: Mapping[str, Field] = _Fields(_NOTHING, REGISTERED, _ROWS)
# Fields by the symbols and words that others use for them.
OTHER_NAMES = RENAMED | {
    "phi": "volume_fraction",
    "nu": "volume_fraction",
    "solid_fraction": "volume_fraction",
    "solids_fraction": "volume_fraction",
    "packing_fraction": "volume_fraction",
    "solid_volume_fraction": "volume_fraction",
    "vof": "volume_fraction",
    "porosity": "void_fraction",
    "voidage": "void_fraction",
    "rho": "density",
    "bulk_density": "density",
    "mass_density": "density",
    "u": "velocity",
    "v": "velocity",
    "vx": "velocity",
    "vy": "velocity",
    "vz": "velocity",
    "flow": "velocity",
    "momentum": "momentum_density",
    "t": "granular_temperature",
    "temperature": "granular_temperature",
    "theta": "granular_temperature",
    "sigma": "stress",
    "total_stress": "stress",
    "p": "pressure",
    "tau": "shear_stress",
    "mu": "friction_coefficient",
    "friction": "friction_coefficient",
    "macroscopic_friction": "friction_coefficient",
    "i": "inertial_number",
    "strain_rate": "shear_rate_tensor",
    "rate_of_strain": "shear_rate_tensor",
    "gamma_dot": "shear_rate",
    "gammadot": "shear_rate",
    "coordination": "coordination_number",
    "contacts": "contact_number_density",
    "omega": "spin",
    "angular_velocity": "spin",
    "fabric_tensor": "fabric",
    "count": "sample_count",
}
_PRINCIPAL = "f.cg.principal('stress'), of a result f that holds the stress"
_MIXING = "ds.cg.microstructure(['lacey_index', 'segregation_index'], by='species')"
_PAIRS = "ds.cg.radial_distribution(r_max)"
_SPREADING = "ds.cg.mean_squared_displacement(lags=[1, 2, 4])"
# Calls that return results which are no fields, by the words for these.
CALLS = {
    "principal": _PRINCIPAL,
    "principal_stress": _PRINCIPAL,
    "principal_stresses": _PRINCIPAL,
    "stress_principal": _PRINCIPAL,
    "eigenvalues": _PRINCIPAL,
    "lacey": _MIXING,
    "lacey_index": _MIXING,
    "mixing": _MIXING,
    "mixing_index": _MIXING,
    "segregation": _MIXING,
    "segregation_index": _MIXING,
    "rdf": _PAIRS,
    "g_r": _PAIRS,
    "gr": _PAIRS,
    "pair_correlation": _PAIRS,
    "pair_distribution": _PAIRS,
    "msd": _SPREADING,
    "diffusion": _SPREADING,
    "mass_flow_rate": "ds.cg.flow_rate(surface)",
    "discharge": "ds.cg.flow_rate(surface)",
}
# Other ways to a field: the option that chooses, and the row for each of its values that is not the
# default.
WAYS = flow.WAYS | rheology.WAYS | contacts.WAYS | errors.WAYS


def field_of(name: str, options: Options) -> Field:
    """Return the field of a name, as computed with some options."""
    if options.own and name in options.own_fields:
        return options.own_fields[name]
    usual = FIELDS[name]
    if name in WAYS:
        option, ways = WAYS[name]
        usual = ways.get(getattr(options, option), usual)
    if name == "velocity_gradient" and options.averaged_gradient != "zero":
        return flow.with_averaged_axes(usual, options.averaged_gradient)
    return usual


def options_of(attrs: Mapping[Any, Any]) -> Options:
    """Return the choices of the algebra that a result was computed with, from its attributes."""
    saved = saved_options(attrs)
    options: dict[str, Any] = {n: saved[n] for n in (*OF_CALLS, "lag") if n in saved}
    if "plane" in attrs:
        options["plane"] = tuple(map(COMPONENTS.index, str(attrs["plane"])))
    options["temperature"] = saved.get("temperature", "biased")  # of files without it
    return Options(**options, diameter=saved.get("size_diameter"))


def listed(*, registered: bool = True) -> list[str]:
    """Names of all fields that can be asked for, with or without fields that users registered."""
    names = [name for name in FIELDS if not name.startswith("_")]
    if registered:
        return names
    return [name for name in names if name not in REGISTERED]


@dataclass(frozen=True)
class NamedField:
    """A field that a user registered, or that a preset defines, as `Options.own` holds it."""

    name: str
    field: Field
    moments: ClassVar[Mapping[str, Moment]] = MappingProxyType({})


def fields_of(
    names: Iterable[str], options: Options, definitions: dict[str, Field] | None = None
) -> dict[str, Field]:
    """Return some fields and all that they follow from by name, each after its own inputs.

    They are added to `definitions` where these are given.
    """
    definitions = {} if definitions is None else definitions
    for name in names:
        if name not in definitions:
            field = field_of(name, options)
            fields_of(field.fields, options, definitions)
            definitions[name] = field
    return definitions


def moments_of(fields: Iterable[Field], options: Options) -> dict[str, Moment]:
    """Return the moments that fields need, by name: of `MOMENTS`, or of fields from outside xcg."""
    moments = ChainMap({}, *(named.moments for named in options.own), MOMENTS)
    if options.friction is not None:
        for name, column in (
            ("sliding_contacts", sliding_contacts),
            ("load_bearing_sliding", load_bearing_sliding),
        ):
            moments[name] = replace(MOMENTS[name], column=partial(column, options.friction))
    return {name: moments[name] for field in fields for name in field.moments}


def evaluate(
    fields: Sequence[str], moments: Mapping[str, NDArray], options: Options
) -> dict[str, NDArray]:
    """Compute fields from moments with NumPy; arrays (phase, node, ...)."""
    s = SimpleNamespace(**moments)
    f = SimpleNamespace()
    with np.errstate(all="ignore"):  # as the program: nodes without grains divide 0 by 0
        for name, field in fields_of(fields, options).items():
            setattr(f, name, field.compute(f, s, options))
    return {name: getattr(f, name) for name in fields}


COORDINATES = (
    "time",
    "step",
    "skipped",
    "width",
    SETUP,
    *COMPONENTS,
    "phase",
    "other_phase",
    "component",
    "direction",
)
