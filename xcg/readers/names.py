"""Names in files: one table of the aliases of each variable, for all engines.

Names are compared without case, blanks and punctuation, and without a unit of SI in brackets:
``Particle ID``, ``particle_id`` and ``ParticleId`` are one name, as are ``Diameter [m]`` and
``diameter``. Names of one letter keep their case (``t`` is a time, ``T`` a temperature).
Components are called by letters, or numbered: ``v_x``, ``Velocity X``, ``Velocity:0``.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from itertools import chain
from typing import TypeAlias

from xcg.scene.schema import COMPONENTS

Slots: TypeAlias = Mapping[str, Sequence[str]]
"""Canonical names of the columns that fill each slot, the preferred first."""

_UNITS_OF_SI = {
    "-", "m", "s", "kg", "n", "m/s", "ms-1", "1/s", "s-1", "rad/s", "rads-1", "m2", "m3",
    "kg/m3", "kgm-3", "kgm2", "sec",
}  # fmt: skip
_OTHER_UNIT = re.compile(
    r"[\[(]\s*((?:[mcdknuµμ]m|in|ft)(?:/s|\^?3)?|[mnuµμ]s|min|h|m?g|t|g/cm\^?3|kN|mN)\s*[\])]$"
    r"|_((?:[mcnuµμ]m)|[mnuµμ]s)$"
)
_BRACKETS = re.compile(r"[\[(]([^\])]*)[\])]\s*$")
_NUMBERED = re.compile(r"(.*?)([^A-Za-z0-9]?)[\[(]?(\d)[\])]?$")


def other_unit(column: str) -> str:
    """Return the unit in the name of a column, as in ``x (mm)`` or ``x_mm``; "" for SI or none."""
    unit = _OTHER_UNIT.search(column)
    return (unit[1] or unit[2]) if unit else ""


@lru_cache(maxsize=1 << 14)
def canonical(name: str) -> str:
    """Return a name without case, blanks and punctuation, and without a unit of SI in brackets."""
    brackets = _BRACKETS.search(name)
    if brackets and re.sub(r"[\s^*]", "", brackets[1]).lower() in _UNITS_OF_SI:
        name = name[: brackets.start()]
    letters = re.sub(r"[\W_]", "", name)
    return letters if len(letters) == 1 else letters.casefold()


def canonical_columns(columns: Iterable[str]) -> dict[str, list[str]]:
    """Return the columns of each canonical name, in the order of the file.

    Three columns that are numbered 0, 1, 2 or 1, 2, 3 are components x, y, z of one vector. A
    number follows a sign (``v:0``, ``v[1]``, ``v_2``) or a word (``vel0``), so that ``d1``, ``d2``
    and ``d3`` are not taken for a vector.
    """
    named: dict[str, list[str]] = defaultdict(list)
    vectors: dict[str, dict[int, str]] = defaultdict(dict)
    for column in columns:
        named[canonical(column)].append(column)
        numbered = _NUMBERED.match(column)
        if numbered:
            stem, sign, number = numbered.groups()
            brackets = column.endswith(("]", ")"))
            if sign or brackets or len(canonical(stem)) >= 3:
                vectors[canonical(stem)][int(number)] = column
    for stem, components in vectors.items():
        if sorted(components) in ([0, 1, 2], [1, 2, 3]):
            for axis, number in zip(COMPONENTS, sorted(components), strict=True):
                named[stem + axis].append(components[number])
    return named


# --- the table -------------------------------------------------------------------------------------
#
# Vectors by the names of their components, with "?" in the place of the axis.

_PARTICLE_SCALARS = {
    "particle_id": (
        "particle id", "track id", "id", "particle", "particle number", "particle no", "label", "tag",
        "atom id", "grain id", "grain", "global id", "particle identifier",
    ),
    "species": (
        "species", "type", "species id", "type id", "particle type", "particle species", "mat id",
        "material", "material id", "phase", "phase id", "particle phase id",
    ),
    "body_id": ("body id", "mol", "molecule", "molecule id", "clump", "clump id", "id multisphere"),
    "frozen": ("frozen",),
    "coordination_number": (
        "coordination number", "coordination", "number of contacts", "num contacts", "n contacts",
    ),
    "diameter": ("diameter", "diameters", "diam", "dia", "particle diameter"),
    "radius": ("radius", "radii", "rad", "particle radius"),
    "density": ("density", "rho", "ρ", "particle density", "material density"),
    "mass": ("mass", "masses", "particle mass"),
    "volume": ("volume", "vol", "particle volume"),
    "moment_of_inertia": ("moment of inertia", "inertia"),
}  # fmt: skip
_PARTICLE_VECTORS = {
    "position": (
        "position ?", "?", "pos ?", "? position", "? pos", "points ?", "coordinate ?",
        "coordinates ?", "coord ?", "coords ?", "? coordinate", "? coord", "center ?", "centre ?",
        "centroid ?", "particle position ?", "particle ? coordinate", "particle ? position",
        "location ?", "loc ?",
    ),
    "scaled": ("scaled ?", "?s"),
    "unwrapped_position": (
        "unwrapped position ?", "?u", "? unwrapped", "unwrapped ?", "unwrapped coordinates ?",
    ),
    "unwrapped_scaled": ("unwrapped scaled ?", "?su"),
    "image": (
        "image ?", "i?", "images ?", "image flag ?", "image flags ?", "periodic image ?",
    ),
    "velocity": (
        "velocity ?", "v?", "vel ?", "velo ?", "? velocity", "? vel", "velocities ?", "linear velocity ?",
        "lin vel ?", "lin vel vec ?", "translational velocity ?", "particle velocity ?",
        "particle ? velocity",
    ),
    "angular_velocity": (
        "angular velocity ?", "omega ?", "ang vel ?", "ang vel vec ?", "? angular velocity",
        "rotational velocity ?", "rot vel ?", "particle angular velocity ?", "spin ?", "w?", "om?",
        "omg?", "ome?", "ω?",
    ),
}  # fmt: skip
_CONTACT_SCALARS = {
    "contact_i": (
        "contact i", "id1", "id i", "patom1", "particle 1", "particle i", "particle id 1",
        "particle i id", "particle 1 id", "global id 1", "atom1", "atom id 1", "grain 1", "grain i",
        "i",
    ),
    "contact_j": (
        "contact j", "id2", "id j", "patom2", "particle 2", "particle j", "particle id 2",
        "particle j id", "particle 2 id", "global id 2", "atom2", "atom id 2", "grain 2", "grain j",
        "j",
    ),
    "overlap": ("overlap", "delta", "delta n", "penetration", "penetration depth"),
}  # fmt: skip
_CONTACT_VECTORS = {
    "contact_force": ("contact force ?", "f?", "force ?", "? force", "total force ?", "force ij ?"),
    "normal_force": ("normal force ?", "fn?", "f normal ?", "force normal ?"),
    "tangential_force": (
        "tangential force ?", "ft?", "shear force ?", "f tangential ?", "force tangential ?",
    ),
    "contact_point": ("contact point ?", "point ?", "contact position ?", "contact ij ?"),
    "contact_normal": ("contact normal ?",),
    "contact_branch": ("contact branch ?", "branch ?", "d?"),
    "end_i": ("end i ?",),
    "end_j": ("end j ?",),
}  # fmt: skip


def components(slot: str, *templates: str) -> dict[str, tuple[str, ...]]:
    """Return the slots of three components, filled by canonical names such as "v?"."""
    slots = {}
    for axis in COMPONENTS:
        names = [canonical(template.replace("?", axis)) for template in templates]
        if "?" in templates:
            names.append(axis.upper())
        slots[f"{slot}_{axis}"] = tuple(names)
    return slots


def vector_columns(name: str, width: int) -> list[str]:
    """Return the names of the columns of a vector: v_x v_y v_z, or v[1] v[2] ... of more than three."""
    if width <= len(COMPONENTS):
        return [f"{name}_{axis}" for axis in COMPONENTS[:width]]
    return [f"{name}[{k}]" for k in range(1, width + 1)]


def _slots(
    scalars: Mapping[str, Sequence[str]], vectors: Mapping[str, Sequence[str]]
) -> dict[str, tuple[str, ...]]:
    slots = {slot: tuple(map(canonical, names)) for slot, names in scalars.items()}
    for slot, templates in vectors.items():
        slots |= components(slot, *templates)
    return slots


PARTICLE_SLOTS: Slots = {
    **_slots(_PARTICLE_SCALARS, _PARTICLE_VECTORS),
    # of LAMMPS' compute property/atom, and of LIGGGHTS
    "quat_w": ("quatw", "quat1"),
    "quat_x": ("quati", "quat2", "quatx"),
    "quat_y": ("quatj", "quat3", "quaty"),
    "quat_z": ("quatk", "quat4", "quatz"),
    **components("half_axis", "half axis ?"),
    **components("whole_axis", "whole axis ?", "shape ?"),
    "exponent_1": ("exponent1", "block1", "blockiness1"),
    "exponent_2": ("exponent2", "block2", "blockiness2"),
}
CONTACT_SLOTS: Slots = _slots(_CONTACT_SCALARS, _CONTACT_VECTORS)


ALL_SLOTS: Slots = {**PARTICLE_SLOTS, **CONTACT_SLOTS}
CLOCK_SLOTS: Slots = {
    "time": ("time", "t", "simulationtime", "simtime", "physicaltime"),
    "step": ("step", "timestep", "frame", "iteration", "snapshot"),
}


def _arrays(
    scalars: Mapping[str, Sequence[str]], vectors: Mapping[str, Sequence[str]]
) -> dict[str, str]:
    """Return the variable of each canonical name of a whole array, vectors without their axis."""
    arrays: dict[str, str] = {}
    for variable, names in (*scalars.items(), *vectors.items()):
        for name in names:
            word = canonical(name.replace("?", ""))
            if len(word) > 1 or word in "vij":  # LAMMPS and LIGGGHTS make "i" of ix iy iz
                arrays.setdefault(word, variable)
    return arrays


_WHOLE_VECTORS = {
    slot: _PARTICLE_VECTORS[slot]
    for slot in ("velocity", "angular_velocity", "unwrapped_position", "image")
}
PARTICLE_ARRAYS = _arrays(_PARTICLE_SCALARS, _WHOLE_VECTORS)
CONTACT_ARRAYS = _arrays(
    _CONTACT_SCALARS,
    {slot: _CONTACT_VECTORS[slot] for slot in ("contact_force", "contact_point", "contact_normal")},
)


def columns_by_name(columns: Sequence[str], slots: Slots) -> dict[str, str]:
    """Return the column of each slot that is called by one of its aliases, the preferred first.

    All components of a vector are of one spelling, the one with the most components: ``wx`` beside
    ``omega_z`` is something else.
    """
    aliases = tuple((slot, tuple(names)) for slot, names in slots.items())
    return dict(_columns_by_name(tuple(columns), aliases))


@lru_cache(maxsize=256)  # the steps of a series have the same columns
def _columns_by_name(
    columns: tuple[str, ...], slots: tuple[tuple[str, tuple[str, ...]], ...]
) -> dict[str, str]:
    named = canonical_columns(columns)
    by_alias = {
        slot: {
            place: named[canonical(alias)][0]
            for place, alias in enumerate(aliases)
            if canonical(alias) in named
        }
        for slot, aliases in slots
    }
    filled = {}
    for slot, candidates in by_alias.items():
        places = list(candidates)
        vector, _, axis = slot.rpartition("_")
        if axis in COMPONENTS:
            siblings = [by_alias.get(f"{vector}_{other}", {}) for other in COMPONENTS]
            counts = Counter(sorted(chain(*siblings)))
            places = [place for place, _ in counts.most_common(1) if place in candidates]
        if places:
            filled[slot] = candidates[places[0]]
    return filled


# --- names that resemble a variable ----------------------------------------------------------------

# Words in the names of columns, whole or by their beginning ("veloc*").
_HINTS_OF_PARTICLES = {
    "particle_id": "id ids label tag number no nr index identifier",
    "species": "species type material mat phase",
    "velocity": "vel veloc* speed u v momenta",
    "angular_velocity": "angvel angular* omega spin rot rotational",
    "radius": "radi* rad r rp",
    "diameter": "diam* dia d dp size vol volume*",
    "density": "dens* rho",
    "mass": "mass* m",
    "body_id": "clump* molecule* mol body",
    "image": "image* wraps unwrap*",
}
_HINTS_OF_CONTACTS = {
    "overlap": "overlap* penetr* delta gap",
    "contact_point": "point*",
    "tangential_force": "tang* shear* frict* ft fs",
}
_ENOUGH = {  # what is read in place of a variable
    "radius": ("diameter", "volume"),
    "diameter": ("radius", "volume"),
    "image": ("unwrapped_",),
    "tangential_force": ("contact_force",),
}
_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")
_OF_LAMMPS = re.compile(r"^[vcf]_(?=\w\w)")  # variables, computes and fixes
_OF_PARAVIEW = {
    "pointid", "cellid", "celltype", "blockname", "blocknumber", "vtkoriginalpointids",
    "vtkoriginalcellids", "vtkghosttype",
}  # fmt: skip
_CLOCK_WORDS = {
    "t", "time", "times", "timestep", "timestamp", "step", "steps", "frame", "slice", "iteration",
    "cycle",
}  # fmt: skip
_BESIDE_CLOCK_WORDS = {
    "sim", "simulation", "physical", "elapsed", "current", "position", "no", "nr", "number", "index",
    "id", "s", "sec", "seconds", "ms", "us", "ns", "min",
}  # fmt: skip


def resembling(
    columns: Iterable[str], variables: Iterable[str], *, contacts: bool
) -> dict[str, str]:
    """Return columns whose names resemble a variable that is not read.

    Parameters
    ----------
    columns : iterable of str
        Columns that are not read.
    variables : iterable of str
        Variables or slots that are read.
    contacts : bool
        Whether the file holds contacts.
    """
    slots = tuple(variables)
    likely: dict[str, str] = {}
    hints = _HINTS_OF_CONTACTS if contacts else _HINTS_OF_PARTICLES
    for variable, text in hints.items():
        enough = (variable, *_ENOUGH.get(variable, ()))
        if any(slot.startswith(enough) for slot in slots):
            continue
        stems = tuple(word[:-1] for word in text.split() if word.endswith("*"))
        whole = set(text.split())
        for column in columns:
            if canonical(column) in _OF_PARAVIEW:
                continue
            words = [word.casefold() for word in _WORD.findall(_OF_LAMMPS.sub("", column))]
            if any(word in whole or (stems and word.startswith(stems)) for word in words):
                likely.setdefault(column, variable)
    return likely


def resembling_clock(columns: Iterable[str]) -> list[str]:
    """Return columns whose names resemble a time or the number of a step; ``T`` is a temperature."""
    likely = []
    for column in columns:
        words = {word.casefold() for word in _WORD.findall(column)}
        of_clock = words & _CLOCK_WORDS
        if of_clock and words <= _CLOCK_WORDS | _BESIDE_CLOCK_WORDS and canonical(column) != "T":
            likely.append(column)
    return likely
