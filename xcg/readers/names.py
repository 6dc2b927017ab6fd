"""Names in files: one table of the aliases of each variable, for all engines.

Names are compared without case, blanks and punctuation, and without a unit: ``Particle ID``,
``particle_id`` and ``ParticleId`` are one name, as are ``Diameter [m]``, ``diameter_mm`` and
``diameter``. Names of one letter keep their case (``t`` is a time, ``T`` a temperature). Components
are called by letters, or numbered: ``v_x``, ``Velocity X``, ``Velocity:0``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeAlias

from xcg.readers.column_units import unit_of
from xcg.scene.schema import COMPONENTS

Slots: TypeAlias = Mapping[str, Sequence[str]]
"""Canonical names of the columns that fill each slot, the preferred first."""


@lru_cache(maxsize=1 << 14)
def canonical(name: str) -> str:
    """Return a name without case, blanks and punctuation, and without a unit in brackets."""
    unit = unit_of(name)
    if unit is not None and unit.in_brackets:
        name = unit.stem
    letters = re.sub(r"[\W_]", "", name)
    return letters if len(letters) == 1 else letters.casefold()


@dataclass(frozen=True)
class Names:
    """Names of one variable in files.

    Attributes
    ----------
    aliases : str
        What it is called, with commas between, the preferred first; "?" stands where the axis does.
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
        "grain id, grain, ball id, global id, particle identifier, id p",
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
