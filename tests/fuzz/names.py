"""Names of columns in other spellings, orders and numbers: the same scene, or a message that names a column."""

from __future__ import annotations

import json
import random
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

import xcg
from tests import dumps
from xcg.readers.names import CONTACT_SLOTS, PARTICLE_SLOTS, Slots

FILE = "names.json"  # what is damaged: the columns of a table of grains and of one of contacts
SIGNS = {"csv": "_- .:/|", "text": "_-.:/|", "dump": "_-.:/|"}  # by the form of the tables
AXES = "xyz"

# columns of three grains and two contacts, by slot
GRAINS = {
    "particle_id": [3, 1, 7], "species": [1, 2, 1], "radius": [0.5, 0.4, 0.3],
    "position_x": [1.0, 1.85, 3.0], "position_y": [2.0, 2.1, 2.2], "position_z": [3.0, 3.1, 3.2],
    "velocity_x": [0.1, 0.2, 0.3], "velocity_y": [0.4, 0.5, 0.6], "velocity_z": [0.7, 0.8, 0.9],
}  # fmt: skip
CONTACTS = {
    "contact_i": [3, 7], "contact_j": [1, -1], "contact_force_x": [-4.0, 1.0], "contact_force_y": [0.5, 2.0],
    "contact_force_z": [0.25, 3.0], "contact_point_x": [1.47, 3.3], "contact_point_y": [2.05, 2.2],
    "contact_point_z": [3.05, 3.2],
}  # fmt: skip
TABLES: Mapping[str, tuple[Mapping[str, list], Slots]] = {
    "particles": (GRAINS, PARTICLE_SLOTS),
    "contacts": (CONTACTS, CONTACT_SLOTS),
}
ROWS = np.argsort(GRAINS["particle_id"])  # scenes are sorted by id
EXPECTED = {
    "particle_id": np.sort(GRAINS["particle_id"]),
    "species": np.array(GRAINS["species"])[ROWS],
    "diameter": 2 * np.array(GRAINS["radius"])[ROWS],
    "position": np.array([GRAINS[f"position_{axis}"] for axis in AXES]).T[ROWS],
    "velocity": np.array([GRAINS[f"velocity_{axis}"] for axis in AXES]).T[ROWS],
    "contact_i": CONTACTS["contact_i"],
    "contact_j": CONTACTS["contact_j"],
    "contact_force": np.array([CONTACTS[f"contact_force_{axis}"] for axis in AXES]).T,
    "contact_point": np.array([CONTACTS[f"contact_point_{axis}"] for axis in AXES]).T,
}


def seeds(folder: Path) -> dict[str, bytes]:
    """Return the usual names: a column is its name, its slot, and the factor of its values."""
    usual = {"particle_id": "id", "species": "type", "contact_i": "id1", "contact_j": "id2"}
    table = {"form": "csv", "equal": True}
    for kind, (columns, _) in TABLES.items():
        table[kind] = [[usual.get(slot, slot), slot, 1.0] for slot in columns]
    return {FILE: json.dumps(table).encode()}


# --- damage -----------------------------------------------------------------------------------------------


def damage(data: bytes, rng: random.Random, others: Sequence[bytes] = ()) -> bytes:
    """Write all names in other ways; and copy or misspell some in half of the cases."""
    table = json.loads(data)
    table["form"] = rng.choice(list(SIGNS))
    for kind, (_, slots) in TABLES.items():
        places: dict[str, int] = {}  # components of a vector are of one spelling
        for column in table[kind]:
            slot = column[1]
            vector = slot[:-2] if slot[-2:] in ("_x", "_y", "_z") else slot
            place = places.setdefault(vector, rng.randrange(len(slots[slot])))
            column[0] = spell(slots[slot][place], table["form"], rng)
        rng.shuffle(table[kind])
    if rng.random() < 0.5:
        table["equal"] = False
        kinds = rng.choices(list(TABLES), k=rng.choice([1, 1, 2, 3]))
        if rng.random() < 0.3:
            _lose(table[kinds[0]], rng)
        else:
            for kind in kinds:
                _copy(table[kind], table["form"], rng)
    return json.dumps(table).encode()


def spell(name: str, form: str, rng: random.Random) -> str:
    """Write a name in other cases, with signs between its letters; names of one letter stay."""
    if len(name) == 1:
        return name
    letters = [rng.choice([letter, letter, letter.upper()]) for letter in name]
    for place in range(len(name) - 1, 0, -1):
        if rng.random() < 0.15:
            letters.insert(place, rng.choice(SIGNS[form]))
    return "".join(letters)


def _copy(columns: list, form: str, rng: random.Random) -> None:
    """Copy a column with equal or other values, under its own or another spelling."""
    name, slot, _ = rng.choice(columns)
    copied = rng.choice([name, name.swapcase(), spell(name, form, rng)])
    columns.insert(rng.randrange(len(columns)), [copied, slot, rng.choice([1.0, 1.5])])


def _lose(columns: list, rng: random.Random) -> None:
    """Change a letter of a name, or leave a column out."""
    place = rng.randrange(len(columns))
    name = columns[place][0]
    if rng.random() < 0.5:
        letter = rng.randrange(len(name))
        columns[place][0] = name[:letter] + rng.choice("abexyz1_") + name[letter + 1 :]
    else:
        del columns[place]


# --- use --------------------------------------------------------------------------------------------------


def use(folder: Path) -> None:
    """Open the tables; raise AssertionError where a value is wrong, or lost although all names are known."""
    table = json.loads((folder / FILE).read_text())
    paths = [_write(folder, kind, table) for kind in TABLES]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            ds = xcg.open_scene(
                paths[0], contacts=paths[1], density=1.0, units="si", allow_unknown=True
            ).load()
        except xcg.SceneError as error:
            if table["equal"]:
                raise AssertionError("refused, although all names are known") from error
            raise
    messages = " ".join(str(warning.message) for warning in caught)
    for name, values in EXPECTED.items():
        if name in ds:
            found = ds[name].values[0]
            right = found.shape == np.shape(values) and np.array_equal(found, values)
            assert right or _is_named(name, table, messages), f"{name} is {found.tolist()}"
        else:
            assert not table["equal"], f"{name} is lost, although all names are known"


def _is_named(variable: str, table: Mapping, messages: str) -> bool:
    """Return whether a warning names a variable, or a column of it."""
    if f"of the {variable.replace('_', ' ')}" in messages:
        return True
    columns = [*table["particles"], *table["contacts"]]
    slots = {"diameter": "radius"}.get(variable, variable)
    return any(repr(name) in messages for name, slot, _ in columns if slot.startswith(slots))


def _write(folder: Path, kind: str, table: Mapping) -> Path:
    """Write a table of grains or contacts in its form."""
    names = [name for name, _, _ in table[kind]]
    values = [
        np.multiply(TABLES[kind][0][slot], factor).tolist() for _, slot, factor in table[kind]
    ]
    rows = [[repr(value) for value in row] for row in zip(*values, strict=True)]
    form = table["form"]
    path = folder / f"{kind}.{form}"
    if form == "dump":
        label = "ATOMS" if kind == "particles" else "ENTRIES"
        text = dumps.dump_text([" ".join(row) for row in rows], " ".join(names), label=label)
    else:
        separator = {"csv": ",", "text": " "}[form]
        text = "".join(separator.join(row) + "\n" for row in [names, *rows])
    path.write_text(text)
    return path
