"""Headers as people write them: the scene is the same, or a message names what is not read.

Unlike those of `tests.fuzz.names`, these spellings are not taken from the table of aliases.
"""

from __future__ import annotations

import json
import random
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

import xcg
from tests import dumps
from tests.fuzz.names import CONTACTS, EXPECTED, GRAINS

FILE = "unsaid.json"  # what is damaged: the columns of both tables
FORMS = ("csv", "semicolons", "text", "dump", "xyz", "yade")
GRAINS_ONLY = ("xyz", "yade")

# spellings by variable, "?" in the place of the axis
SPELLINGS: Mapping[str, Sequence[str]] = {
    "particle_id": (
        "id", "ID", "pid", "idx", "gid", "Particle ID", "particle_no", "part_id", "ball_id", "sphereId",
        "No", "nr", "serial", "label", "index", "id_p", "ParticleIdentifier", "c_id", "v_tag", "uid", "Atom ID",
        "Grain.No", "IDs", "body_id_number", "num",
    ),
    "species": ("type", "Type", "species", "mat", "matId", "material", "Particle Type", "phase", "kind", "TYPE"),
    "radius": (
        "radius", "Radius", "RADIUS", "rad", "r", "R", "rp", "r_p", "Rp", "c_rad", "v_radius", "particle_rad",
        "sphere_radius", "Radii", "ball.radius", "grain radius", "R_grain",
    ),
    "position": (
        "?", "p?", "pos_?", "Pos.?", "Position ?", "position:?", "Points:?", "?_pos", "coord?", "c_?", "?c",
        "center_?", "x_?", "r?", "loc?", "? Position", "particle?", "?u",
    ),
    "velocity": (
        "v?", "V?", "vel_?", "Velocity ?", "u?", "v_?", "velocity:?", "?dot", "d?dt", "vel?", "?_velocity", "U?",
        "speed_?", "linVel?", "transVel?", "v.?", "VEL?", "f_vel[?]", "v_vel?", "momentum_?",
    ),
    "contact_i": ("id1", "ID1", "i", "particle_1", "idA", "P1", "atom_i", "first", "c_1[1]", "from", "id 1", "ball1"),
    "contact_j": ("id2", "ID2", "j", "particle_2", "idB", "P2", "atom_j", "second", "c_1[2]", "to", "id 2", "ball2"),
    "contact_force": ("f?", "F?", "force_?", "Force ?", "fc?", "force:?", "? Force", "contact_force_?", "F_?", "fij?"),
    "contact_point": (
        "contact_point_?", "c?", "p?", "point_?", "pos_?", "?", "cp_?", "xc_?", "contact ?", "Position ?", "loc_?",
    ),
}  # fmt: skip
UNITS: Mapping[str, Sequence[tuple[str, float]]] = {
    "radius": ((" [m]", 1), (" (mm)", 1e-3), ("_mm", 1e-3), (" [cm]", 1e-2), ("[um]", 1e-6)),
    "position": ((" [m]", 1), (" (mm)", 1e-3), ("_mm", 1e-3), (" [furlongs]", 1)),
    "velocity": ((" [m/s]", 1), (" (cm/s)", 1e-2), ("_mm_s", 1e-3), (" [mm/s]", 1e-3), (" (m s^-1)", 1)),
    "contact_force": ((" [N]", 1), (" (mN)", 1e-3), (" (kN)", 1e3)),
}  # fmt: skip
JUNK = (
    "temperature",
    "stress_xx",
    "q",
    "E_kin",
    "proc",
    "c_pe",
    "mu",
    "omegasq",
    "foo",
    "hue",
    "weight_fn",
)


def seeds(folder: Path) -> dict[str, bytes]:
    """Return the usual names: a column is its name, its slot, and the factor of its values."""
    usual = {"particle_id": "id", "species": "type", "contact_i": "id1", "contact_j": "id2"}
    table: dict = {"form": "csv", "changed": []}
    for kind, columns in (("particles", GRAINS), ("contacts", CONTACTS)):
        table[kind] = [[usual.get(slot, slot), slot, 1.0] for slot in columns]
    return {FILE: json.dumps(table).encode()}


# --- damage -----------------------------------------------------------------------------------------------


def variable_of(slot: str) -> str:
    """Variable of a slot, without its axis."""
    return slot[:-2] if slot[-2:] in ("_x", "_y", "_z") else slot


def damage(data: bytes, rng: random.Random, others: Sequence[bytes] = ()) -> bytes:
    """Rename one or two variables, reorder columns, add some, and change case or units."""
    table = json.loads(data)
    table["form"] = rng.choice(FORMS)
    variables = sorted({variable_of(slot) for slot in (*GRAINS, *CONTACTS)})
    for variable in rng.sample(variables, rng.choice([1, 1, 2])):
        kind = "particles" if any(variable_of(slot) == variable for slot in GRAINS) else "contacts"
        _rename(table, kind, variable, rng)
    for kind in ("particles", "contacts"):
        if rng.random() < 0.5:
            rng.shuffle(table[kind])
        for name in rng.sample(JUNK, rng.choice([0, 0, 1, 3])):
            table[kind].insert(rng.randrange(len(table[kind]) + 1), [name, "", 1.0])
    return json.dumps(table).encode()


def _rename(table: dict, kind: str, variable: str, rng: random.Random) -> None:
    """Write the columns of one variable otherwise, perhaps with a unit."""
    template = rng.choice(SPELLINGS[variable])
    axes = rng.choice(["xyz", "xyz", "XYZ", "012" if ":" in template else "xyz"])
    if "[?]" in template:
        axes = "123"
    unit, factor = "", 1.0
    if rng.random() < 0.3 and table["form"] in ("csv", "semicolons"):
        unit, factor = rng.choice(UNITS.get(variable, (("", 1.0),)))
    for column in table[kind]:
        if variable_of(column[1]) == variable:
            axis = "xyz".find(column[1][-1])
            column[0] = template.replace("?", axes[axis]) + unit
            column[2] = 1 / factor
    table["changed"].append(variable)


# --- use --------------------------------------------------------------------------------------------------


def use(folder: Path) -> None:
    """Open the tables; raise AssertionError where a value is wrong or lost, and no message names its columns."""
    table = json.loads((folder / FILE).read_text())
    kinds = ["particles"]
    if table["form"] not in GRAINS_ONLY:
        kinds.append("contacts")
    names = {kind: [name for name, _, _ in table[kind]] for kind in kinds}
    if any(len({*listed}) < len(listed) for listed in names.values()):
        raise xcg.SceneError(f"{folder}: columns of one name, which is another target")
    paths = [write(folder, kind, table) for kind in kinds]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            ds = xcg.open_scene(*paths, density=1.0, allow_unknown=True, units=units(table)).load()
        except xcg.SceneError:
            return  # something is said
    said = " ".join(str(warning.message) for warning in caught)
    ids = next(name for name, slot, _ in table["particles"] if slot == "particle_id")
    if ids in said:
        return  # the rows are in another order
    for name, values in EXPECTED.items():
        if name.startswith("contact") and "contacts" not in kinds:
            continue
        same = name in ds and _equal(ds[name].values[0], values)
        if not same:
            variable = {"diameter": "radius"}.get(name, name)
            columns = [
                column
                for kind in kinds
                for column, slot, _ in table[kind]
                if variable_of(slot) == variable
            ]
            assert any(column in said or column.replace(" ", "_") in said for column in columns), (
                f"{name}: {columns} of {names} as {table['form']}: nothing is said of them; said: {said!r}"
            )


def units(table: Mapping) -> str | None:
    """Units of a dump, which would be missed; none of tables, whose columns may name them."""
    return "si" if table["form"] == "dump" else None


def _equal(found: np.ndarray, values) -> bool:
    expected = np.asarray(values, float)
    if found.shape != expected.shape and len(found) > len(expected):
        return False
    return found.shape == expected.shape and np.allclose(found, expected, rtol=1e-9)


def write(folder: Path, kind: str, table: Mapping) -> Path:
    """Write a table of grains or contacts in its form."""
    names = [name for name, _, _ in table[kind]]
    values = GRAINS if kind == "particles" else CONTACTS
    count = len(next(iter(values.values())))
    columns = [
        np.multiply(values.get(slot, np.arange(count) + 0.125), factor).tolist()
        for _, slot, factor in table[kind]
    ]
    rows = [[repr(value) for value in row] for row in zip(*columns, strict=True)]
    form = table["form"]
    words = [name.replace(" ", "_") for name in names]
    path = (
        folder / f"{kind}.{ {'semicolons': 'csv', 'text': 'txt', 'yade': 'txt'}.get(form, form) }"
    )
    lines = [" ".join(row) for row in rows]
    if form == "dump":
        label = "ATOMS" if kind == "particles" else "ENTRIES"
        text = dumps.dump_text(lines, " ".join(words), label=label)
    elif form == "xyz":
        properties = ":".join(f"{word.replace(':', '_')}:R:1" for word in words)
        text = f"{count}\nProperties={properties}\n" + "".join(line + "\n" for line in lines)
    elif form == "yade":
        text = (
            "# time 0.5 step 7\n# "
            + " ".join(words)
            + "\n"
            + "".join(line + "\n" for line in lines)
        )
    else:
        separator = {"csv": ",", "semicolons": ";", "text": " "}[form]
        listed = words if form == "text" else names
        text = "".join(separator.join(row) + "\n" for row in [listed, *rows])
    path.write_text(text)
    return path
