"""Names in files: one table of the aliases of each variable, for all engines.

Names are compared without case, blanks and punctuation, and without a unit: ``Particle ID``,
``particle_id`` and ``ParticleId`` are one name, as are ``Diameter [m]``, ``diameter_mm`` and
``diameter``. Names of one letter keep their case (``t`` is a time, ``T`` a temperature). Components
are called by letters, or numbered: ``v_x``, ``Velocity X``, ``Velocity:0``.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import chain
from typing import TypeAlias

from xcg.readers.column_units import unit_of
from xcg.scene.schema import COMPONENTS, VARIABLES, Powers, powers_of

Slots: TypeAlias = Mapping[str, Sequence[str]]
"""Canonical names of the columns that fill each slot, the preferred first."""

_NUMBERED = re.compile(r"(.*?)([^A-Za-z0-9]?)[\[(]?(\d)[\])]?$")


@lru_cache(maxsize=1 << 14)
def canonical(name: str) -> str:
    """Return a name without case, blanks and punctuation, and without a unit in brackets."""
    unit = unit_of(name)
    if unit is not None and unit.in_brackets:
        name = unit.stem
    letters = re.sub(r"[\W_]", "", name)
    return letters if len(letters) == 1 else letters.casefold()


def canonical_columns(columns: Iterable[str]) -> dict[str, list[str]]:
    """Return the columns of each canonical name, in the order of the file.

    Three columns that are numbered 0, 1, 2 or 1, 2, 3 are components x, y, z of one vector. A
    number follows a sign (``v:0``, ``v[1]``, ``v_2``) or a word (``vel0``), so that ``d1``, ``d2``
    and ``d3`` are not taken for a vector. Names that end in a unit (``x_mm``) come last.
    """
    named: dict[str, list[str]] = defaultdict(list)
    vectors: dict[str, dict[int, str]] = defaultdict(dict)
    with_unit: list[tuple[str, str]] = []
    for column in columns:
        named[canonical(column)].append(column)
        unit = unit_of(column)
        if unit is not None and not unit.in_brackets:
            with_unit.append((canonical(unit.stem), column))
        numbered = _NUMBERED.match(unit.stem if unit and unit.in_brackets else column)
        if numbered:
            stem, sign, number = numbered.groups()
            brackets = column.endswith(("]", ")"))
            if sign or brackets or len(canonical(stem)) >= 3:
                vectors[canonical(stem)][int(number)] = column
    for stem, components in vectors.items():
        if sorted(components) in ([0, 1, 2], [1, 2, 3]):
            for axis, number in zip(COMPONENTS, sorted(components), strict=True):
                named[stem + axis].append(components[number])
    for name, column in with_unit:
        named[name].append(column)
    return named


# --- the table -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Names:
    """Names of one variable in files.

    Attributes
    ----------
    aliases : str
        What it is called, with commas between, the preferred first; "?" is the place of the axis.
    hints : str
        Words that resemble it, by their beginning ("veloc*"), or as the only one ("=cx"): named in
        a warning where such a column is not read.
    instead : str
        Variables that are read in its place, so that hints say nothing.
    """

    aliases: str
    hints: str = ""
    instead: str = ""

    @property
    def listed(self) -> list[str]:
        """Aliases, one by one."""
        return [name.strip() for name in self.aliases.split(",") if name.strip()]

    @property
    def is_vector(self) -> bool:
        """Return whether this is a vector by its components."""
        return "?" in self.aliases


PARTICLES: Mapping[str, Names] = {
    "particle_id": Names(
        "particle id, track id, id, particle, particle number, particle no, label, tag, atom id, "
        "grain id, grain, global id, particle identifier, id p",
        "id =ids idx uid pid gid label* tag* number num no nr index serial identifier key",
    ),
    "species": Names(
        "species, type, species id, type id, particle type, particle species, mat id, material, "
        "material id, phase, phase id, particle phase id",
        "species type types =ptype kind material* mat phase",
    ),
    "position": Names(
        "position ?, ?, pos ?, ? position, ? pos, points ?, coordinate ?, coordinates ?, coord ?, "
        "coords ?, ? coordinate, ? coord, center ?, centre ?, centroid ?, particle position ?, "
        "particle ? coordinate, particle ? position, location ?, loc ?",
    ),
    "scaled": Names("scaled ?, ?s"),
    "unwrapped_position": Names(
        "unwrapped position ?, ?u, ? unwrapped, unwrapped ?, unwrapped coordinates ?",
    ),
    "unwrapped_scaled": Names("unwrapped scaled ?, ?su"),
    "image": Names(
        "image ?, i?, images ?, image flag ?, image flags ?, periodic image ?",
        "image* wraps unwrap*",
        "unwrapped_",
    ),
    "velocity": Names(
        "velocity ?, v?, vel ?, velo ?, ? velocity, ? vel, velocities ?, linear velocity ?, "
        "lin vel ?, lin vel vec ?, translational velocity ?, particle velocity ?, "
        "particle ? velocity",
        "vel* linvel* transvel* geschw* vitesse* speed* u v xdot ydot zdot momentum momenta =ux =uy "
        "=uz =dxdt =dydt =dzdt",
    ),
    "angular_velocity": Names(
        "angular velocity ?, omega ?, ang vel ?, ang vel vec ?, ? angular velocity, "
        "rotational velocity ?, rot vel ?, particle angular velocity ?, spin ?, w?, om?, omg?, ome?, "
        "ω?",
        "angvel* angular* omega* spin rot rotational rotvel* vrot*",
    ),
    "diameter": Names(
        "diameter, diameters, diam, dia, particle diameter",
        "diam* dia d dp size durchm*",
        "radius half_axis whole_axis",
    ),
    "radius": Names(
        "radius, radii, rad, particle radius",
        "radi* rad r rp",
        "diameter half_axis whole_axis",
    ),
    "density": Names(
        "density, rho, ρ, particle density, material density, rho p", "dens* rho rhop", "mass"
    ),
    "mass": Names("mass, masses, particle mass", "mass* m weight", "density"),
    "volume": Names(
        "volume, vol, particle volume", "vol volume*", "radius diameter half_axis whole_axis"
    ),
    "moment_of_inertia": Names("moment of inertia, inertia"),
    "coordination_number": Names(
        "coordination number, coordination, number of contacts, num contacts, n contacts",
    ),
    "body_id": Names(
        "body id, mol, molecule, molecule id, clump, clump id, id multisphere",
        "clump* molecule* mol body",
    ),
    "frozen": Names("frozen"),
    # of LAMMPS' compute property/atom, LIGGGHTS and OVITO
    "quat_w": Names("quat w, quat 1, orientation w", "=q1 =cq1"),
    "quat_x": Names("quat i, quat 2, quat x, orientation x", "=q2 =cq2"),
    "quat_y": Names("quat j, quat 3, quat y, orientation y", "=q3 =cq3"),
    "quat_z": Names("quat k, quat 4, quat z, orientation z", "=q4 =cq4"),
    "half_axis": Names("half axis ?, aspherical shape ?, semi axis ?", "semi* half", "whole_axis"),
    "whole_axis": Names("whole axis ?, shape ?", "shape", "half_axis"),
    "exponent_1": Names("exponent 1, block 1, blockiness 1, roundness 1"),
    "exponent_2": Names("exponent 2, block 2, blockiness 2, roundness 2"),
}
CONTACTS: Mapping[str, Names] = {
    "contact_i": Names(
        "contact i, id1, id i, patom1, particle 1, particle i, particle id 1, particle i id, "
        "particle 1 id, global id 1, atom1, atom id 1, grain 1, grain i, i",
        "=a =A =end1 =p1 =ida =ball1 =first =from =elementa home =pid1 =body1 =bodyid1 =ballid1 =node1 "
        "=nodei =source =particlea =particleaid =idofparticle1",
    ),
    "contact_j": Names(
        "contact j, id2, id j, patom2, particle 2, particle j, particle id 2, particle j id, "
        "particle 2 id, global id 2, atom2, atom id 2, grain 2, grain j, j",
        "=b =B =end2 =p2 =idb =ball2 =second =to =elementb near =pid2 =body2 =bodyid2 =ballid2 =node2 "
        "=nodej =target =particleb =particlebid =idofparticle2",
    ),
    "contact_force": Names(
        "contact force ?, f?, force ?, ? force, total force ?, force ij ?, force total ?, f tot ?"
    ),
    "normal_force": Names(
        "normal force ?, fn?, f normal ?, force normal ?, f norm ?, normal contact force ?, "
        "contact force normal ?, force n ?"
    ),
    "tangential_force": Names(
        "tangential force ?, ft?, shear force ?, shear ?, f tangential ?, force tangential ?, fs?, "
        "f shear ?, force shear ?, f tang ?, tangential contact force ?, contact force tangential ?, "
        "contact force shear ?, force t ?",
        "tang* shear* frict* ft fs =tx =ty =tz",
        "contact_force",
    ),
    "contact_point": Names(
        "contact point ?, point ?, contact position ?, contact ij ?, contact point position ?, cp?",
        "point* pos position location* =cx =cy =cz =x =y =z =xc =yc =zc =posx =posy =posz",
        "end_",
    ),
    "contact_normal": Names("contact normal ?"),
    "contact_branch": Names("contact branch ?, branch ?, d?"),
    "end_i": Names("end i ?"),
    "end_j": Names("end j ?"),
    "overlap": Names(
        "overlap, delta, delta n, penetration, penetration depth, normal overlap",
        "overlap* penetr* delta gap indentation",
    ),
}
CLOCK_SLOTS: Slots = {
    "time": ("time", "t", "simulationtime", "simtime", "physicaltime"),
    "step": ("step", "timestep", "frame", "iteration", "snapshot"),
}
# What single codes call otherwise.
_OF_CODES: Mapping[str, Mapping[str, str]] = {
    "yade": {
        "radius": "r, " + PARTICLES["radius"].aliases,
        # the force acts on the second body
        "contact_i": "id2",
        "contact_j": "id1",
        "tangential_force": "fs?, shear force ?, tangential force ?",
        "contact_point": "c?, contact point ?",
        "contact_normal": "n?, contact normal ?",
    },
    "mercury": {"angular_velocity": "om?"},
    # its axes of superquadrics are halves, where those of LAMMPS are whole
    "liggghts": {"half_axis": "half axis ?, shape ?", "whole_axis": "whole axis ?"},
}
_OF_LIGGGHTS = {
    "blockiness1",
    "blockiness2",
    "roundness1",
    "roundness2",
    "quat1",
    "quat2",
    "quat3",
    "quat4",
}
OF_MFIX: Slots = {
    "contact_i": ("forcechainglobalid1", "particleid1"),
    "contact_j": ("forcechainglobalid2", "particleid2"),
    "contact_force": ("forcechainfc",),
    "overlap": ("forcechainoverlap",),
}


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


def slots_of(table: Mapping[str, Names], code: str = "") -> dict[str, tuple[str, ...]]:
    """Return the slots of columns of particles or contacts, as one code calls them."""
    slots: dict[str, tuple[str, ...]] = {}
    for variable, names in table.items():
        names = Names(_OF_CODES.get(code, {}).get(variable, names.aliases))
        if names.is_vector:
            slots |= components(variable, *names.listed)
        else:
            slots[variable] = tuple(map(canonical, names.listed))
    return slots


PARTICLE_SLOTS: Slots = slots_of(PARTICLES)
CONTACT_SLOTS: Slots = slots_of(CONTACTS)
ALL_SLOTS: Slots = {**PARTICLE_SLOTS, **CONTACT_SLOTS}
_LIGGGHTS_SLOTS: Slots = slots_of(PARTICLES, "liggghts")


def is_of_liggghts(columns: Iterable[str]) -> bool:
    """Return whether columns of particles have names that only LIGGGHTS writes."""
    return not _OF_LIGGGHTS.isdisjoint(map(canonical, columns))


def slots_for(columns: Iterable[str], slots: Slots) -> Slots:
    """Return the slots of particles for the columns of a file, whose code they may show."""
    if "half_axis_x" not in slots or not is_of_liggghts(columns):
        return slots
    axes = ("half_axis_", "whole_axis_")
    return {
        slot: _LIGGGHTS_SLOTS[slot] if slot.startswith(axes) else names
        for slot, names in slots.items()
    }


def _arrays(table: Mapping[str, Names], without: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return the slots of whole arrays: vectors are called without their axis."""
    slots: dict[str, tuple[str, ...]] = {}
    for variable, names in table.items():
        if variable not in without:
            words = [canonical(name.replace("?", "")) for name in names.listed]
            # LAMMPS and LIGGGHTS make "i" of ix iy iz
            slots[variable] = tuple(word for word in words if len(word) > 1 or word in "vij")
    return slots


PARTICLE_ARRAYS: Slots = {
    **_arrays(PARTICLES, ("position", "scaled", "unwrapped_scaled", "half_axis", "whole_axis")),
    **{
        slot: names
        for slot, names in PARTICLE_SLOTS.items()
        if slot not in PARTICLES and not slot.startswith(("position", "scaled", "unwrapped_scaled"))
    },
}
CONTACT_ARRAYS: Slots = _arrays(CONTACTS, ("contact_branch", "end_i", "end_j"))


# --- columns by name -------------------------------------------------------------------------------

_UNITS_OF_SLOTS = {
    "radius": "m", "half_axis": "m", "whole_axis": "m", "normal_force": "N", "tangential_force": "N",
    "end_i": "m", "end_j": "m", "time": "s",
}  # fmt: skip


def vector_of(slot: str) -> str:
    """Return the variable of a slot: the vector of a component."""
    vector, _, axis = slot.rpartition("_")
    return vector if axis in COMPONENTS and slot in ALL_SLOTS and vector != "quat" else slot


def powers_of_slot(slot: str) -> Powers:
    """Return the powers of length, mass and time of a slot; zeros for a variable of the caller's own."""
    name = vector_of(slot)
    units = _UNITS_OF_SLOTS.get(name)
    if units is None:
        units = VARIABLES[name].units if name in VARIABLES else "1"
    return powers_of(units)


def factor_of(column: str, slot: str) -> float:
    """Return the factor from the unit in the name of a column to SI; 1 where it names none of this slot."""
    unit = unit_of(column)
    if unit is None or unit.powers != powers_of_slot(slot):
        return 1.0
    return unit.factor


def columns_by_name(columns: Sequence[str], slots: Slots) -> dict[str, str]:
    """Return the column of each slot that is called by one of its aliases, the preferred first.

    All components of a vector are of one spelling, the one with the most components: ``wx`` beside
    ``omega_z`` is something else. An ending such as ``_mm`` is a unit where it is one of the slot.
    """
    aliases = tuple((slot, tuple(names)) for slot, names in slots.items())
    return dict(_columns_by_name(tuple(columns), aliases))


def _named(slot: str, alias: str, candidates: Iterable[str]) -> Iterator[str]:
    """Yield the columns that are called by an alias, or by it and a unit of the slot."""
    for column in candidates:
        unit = unit_of(column)
        is_plain = unit is None or unit.in_brackets or canonical(unit.stem) != alias
        if is_plain or (unit is not None and unit.powers == powers_of_slot(slot) != (0, 0, 0)):
            yield column


@lru_cache(maxsize=256)  # the steps of a series have the same columns
def _columns_by_name(
    columns: tuple[str, ...], slots: tuple[tuple[str, tuple[str, ...]], ...]
) -> dict[str, str]:
    named = canonical_columns(columns)
    by_alias: dict[str, dict[int, str]] = {}
    for slot, aliases in slots:
        by_alias[slot] = {}
        for place, alias in enumerate(map(canonical, aliases)):
            for column in _named(slot, alias, named.get(alias, ())):
                by_alias[slot].setdefault(place, column)
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

_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")
_OF_LAMMPS = re.compile(r"^(?:[vcfdi]|[di]2)_(?=\w\w)")  # variables, computes, fixes, properties
# vectors of contacts that are no forces, by the beginning of their names
_OTHER_VECTORS = (
    "n",
    "torq",
    "moment",
    "m",
    "vel",
    "v",
    "omega",
    "w",
    "branch",
    "l",
    "pos",
    "end",
    "heat",
)
_OF_VELOCITY = re.compile(
    "v(?!ec|ir|is|ol|or|ar)"
)  # no vector, virial, volume, vorticity, variance
_TOLD_BY_UNITS = {"density", "velocity"}  # units of nothing else
_OF_PARAVIEW = {
    "pointid", "cellid", "celltype", "blockname", "blocknumber", "vtkoriginalpointids",
    "vtkoriginalcellids", "vtkghosttype",
}  # fmt: skip
_CLOCK_WORDS = {
    "t", "time", "times", "zeit", "temps", "tiempo", "tempo", "timestep", "timestamp", "step", "steps", "frame",
    "slice", "iteration", "cycle",
}  # fmt: skip
_BESIDE_CLOCK_WORDS = {
    "sim", "simulation", "physical", "elapsed", "current", "position", "no", "nr", "number", "index",
    "id", "s", "sec", "seconds", "ms", "us", "ns", "min",
}  # fmt: skip


def words_of(column: str) -> list[str]:
    """Return the words in the name of a column, without its unit and the prefix of LAMMPS."""
    unit = unit_of(column)
    name = column
    if unit is not None and (unit.in_brackets or unit.powers != (0, 0, 0)):
        name = unit.stem
    return [word.casefold() for word in _WORD.findall(_OF_LAMMPS.sub("", name))]


@cache
def aliases_of(names: Names) -> frozenset[str]:
    """Return the canonical names of the columns of a variable."""
    aliases = (
        components("", *names.listed) if names.is_vector else {"": map(canonical, names.listed)}
    )
    return frozenset(chain(*aliases.values()))


def resembles(column: str, names: Names) -> bool:
    """Return whether the name of a column has a word of the hints of a variable."""
    hints = names.hints.split()
    stems = tuple(hint[:-1] for hint in hints if hint.endswith("*"))
    words = words_of(column)
    unit = unit_of(column)
    plain = canonical(_OF_LAMMPS.sub("", column))
    whole = {canonical(column), plain, canonical(unit.stem) if unit is not None else ""}
    if any("=" + name in hints for name in whole):
        return True
    if _OF_LAMMPS.match(column) and plain in aliases_of(names):
        return True
    return any(word in hints or (stems and word.startswith(stems)) for word in words)


def vectors_among(columns: Iterable[str]) -> list[tuple[str, dict[str, str]]]:
    """Return the canonical name of each vector, without its axis, and its columns by axis.

    Columns of a vector differ by a letter x, y, z, of which one may be missing, or by a number from
    0 or 1 on. Components of tensors, as xx, xy and xz, and four numbered columns are none.
    """
    names = list(dict.fromkeys(columns))
    vectors: list[tuple[str, dict[str, str]]] = []
    for column in names:
        for place, letter in enumerate(column):
            for axes in ("xyz", "XYZ", "012", "123"):
                parts = {
                    axis: column[:place] + mark + column[place + 1 :]
                    for axis, mark in zip(COMPONENTS, axes, strict=True)
                }
                present = {axis: name for axis, name in parts.items() if name in names}
                is_first = column == next(iter(present.values()), "") and letter in axes
                if is_first and len(present) >= (2 if axes.isalpha() else 3):
                    stem = _OF_LAMMPS.sub("", column[:place] + column[place + 1 :])
                    vectors.append((canonical(stem), present))
    counts = Counter(chain(*(parts.values() for _, parts in vectors)))
    return [
        (stem, parts)
        for stem, parts in vectors
        if all(counts[column] == 1 for column in parts.values())
    ]


def resembling(
    columns: Iterable[str], variables: Iterable[str], *, contacts: bool
) -> dict[str, str]:
    """Return columns that are not read and resemble a variable that is not read either, by words or unit.

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
    table = CONTACTS if contacts else PARTICLES
    lacking = {
        variable: names
        for variable, names in table.items()
        if not any(slot.startswith((variable, *names.instead.split())) for slot in slots)
    }
    likely: dict[str, str] = {}
    candidates = [name for name in columns if canonical(name) not in _OF_PARAVIEW]
    for variable, names in lacking.items():
        powers = powers_of_slot(variable)
        for column in candidates:
            unit = unit_of(column)
            has_other_unit = unit is not None and unit.in_brackets and unit.powers != powers
            of_spin = variable == "velocity" and resembles(column, PARTICLES["angular_velocity"])
            of_another = has_other_unit or of_spin
            is_alias = not aliases_of(names).isdisjoint(words_of(column))
            if not of_another and resembles(column, names) and (is_alias or column not in likely):
                likely[column] = variable
    for stem, parts in vectors_among(candidates):
        meant = ""
        # of any name, where the force is the normal one
        if contacts and "tangential_force" in lacking and not stem.startswith(_OTHER_VECTORS):
            meant = "tangential_force"
        elif not contacts and "velocity" in lacking and _OF_VELOCITY.match(stem):
            meant = "velocity"
        for column in parts.values() if meant else ():
            likely.setdefault(column, meant)
    of_quaternion = [name for name, variable in likely.items() if variable.startswith("quat_")]
    if len(of_quaternion) < 4:
        likely = {name: meant for name, meant in likely.items() if name not in of_quaternion}
    for column in candidates:
        unit = unit_of(column)
        for variable in _TOLD_BY_UNITS & lacking.keys():
            if unit and unit.in_brackets and unit.powers == powers_of_slot(variable):
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


def times_by_unit(columns: Iterable[str]) -> list[str]:
    """Return the column that resembles a time, and names a unit of time in brackets; nothing if there are two."""
    times = []
    for column in resembling_clock(columns):
        unit = unit_of(column)
        is_time = unit is not None and unit.in_brackets and unit.powers == powers_of_slot("time")
        if is_time and "step" not in canonical(column):
            times.append(column)
    return times if len(times) == 1 else []
