"""LIGGGHTS: columns that occur twice, and contacts by the words of their compute."""

from __future__ import annotations

import numpy as np
import pytest

from tests.dumps import dump_text, pairs_text, write
from xcg.common.messages import SceneError, SceneWarning
from xcg.readers.open import open_scene

GRAINS = ["1 1 1 2 1 1 0.5", "2 1 1.9 2 1 1 0.5"]
NUMBERS = {  # of the pair (1, 2) and of the contact of grain 1 with triangle 7 of mesh 3
    "pos": ("1 2 1 1.9 2 1", "1 2 0.55 1 2 1"),
    "vel": ("11 12 13 14 15 16", "0 0 0 14 15 16"),
    "id": ("1 2 0", "3 7 1"),
    "force": ("-4 1 0", "0 1 8"),
    "force_normal": ("-4 0 0", "0 0 8"),
    "force_tangential": ("0 1 0", "0 1 0"),
    "torque": ("0 0 -0.5", "-0.5 0 0"),
    "torque_normal": ("0 0 0", "0 0 0"),
    "torque_tangential": ("0 0 -0.5", "-0.5 0 0"),
    "history": ("21 22 23", "21 22 23"),
    "contactArea": ("0.149", "0.149"),
    "delta": ("0.1", "0.05"),
    "contactPoint": ("1.45 2 1", "0 0 0"),
    "ms_id": ("-1 -1", "-1 -1"),
    "heatFlux": ("0.7", "0.7"),
}
DEFAULT = "pos vel id force torque history contactArea"


def write_run(folder, words):
    """Write grains, a pair and a contact with a mesh, in the order in which LIGGGHTS writes the words."""
    paths = {
        "particles": write(folder / "p.liggghts", dump_text(GRAINS, "id type x y z type radius"))
    }
    for number, kind in enumerate(("contacts", "walls")):
        row = " ".join(
            numbers[number] for word, numbers in NUMBERS.items() if word in words.split()
        )
        columns = " ".join(f"c_3[{k}]" for k in range(1, len(row.split()) + 1))
        paths[kind] = write(folder / f"{kind}.txt", pairs_text([row], columns))
    return paths


def check(scene):
    step = scene.compute().isel(time=0)
    np.testing.assert_array_equal(step.contact_i, [1, 1])
    np.testing.assert_array_equal(step.contact_j, [2, -4])
    np.testing.assert_array_equal(step.contact_force, [[-4, 1, 0], [0, 1, 8]])
    np.testing.assert_allclose(step.contact_point, [[1.45, 2, 1], [1, 2, 0.55]])
    if "overlap" in step:
        np.testing.assert_allclose(step.overlap, [0.1, 0.05])


@pytest.mark.parametrize(
    "words",
    [
        DEFAULT,
        "pos id force",
        "delta force id pos",
        "pos id force contactArea",
        "pos id force contactArea delta history",
        "pos id force_normal force_tangential torque",
        " ".join(NUMBERS),
        "POS ID Force CONTACTAREA heatflux",
    ],
)
def test_columns_have_the_order_of_the_words(tmp_path, words):
    spelt = {word.casefold(): word for word in NUMBERS}
    paths = write_run(tmp_path, " ".join(spelt[word.casefold()] for word in words.split()))
    check(open_scene(**paths, names=words))
    check(open_scene(**paths, names=words.split()))
    check(
        open_scene(**paths, names={"contacts": words, "walls": words.split(), "radius": "radius"})
    )


@pytest.mark.parametrize("words", [DEFAULT, "pos id force", "pos id force delta"])
def test_usual_words_are_guessed(tmp_path, words):
    check(open_scene(**write_run(tmp_path, words)))


@pytest.mark.parametrize(
    ("words", "match"),
    [
        ("pos id force contactArea delta history", "17 columns .* not known; give the words"),
        ("id force", "6 columns .* not known; give the words"),
        ("pos id torque", "12 columns suggest the words 'pos id force', but .*names='pos id force"),
        ("vel id force", "12 columns suggest"),
        (
            "pos vel id force_normal force_tangential torque history contactArea",
            "28 columns suggest",
        ),
        ("pos id force force_normal force_tangential torque torque_normal", "24 columns suggest"),
    ],
)
def test_columns_of_unknown_words_are_refused(tmp_path, words, match):
    paths = write_run(tmp_path, words)
    with pytest.raises(SceneError, match=match) as error:
        open_scene(**paths)
    assert "colname" not in str(error.value)
    assert "patom1" not in str(error.value)


def test_few_columns_without_names_show_the_words_of_both_codes(tmp_path):
    paths = write_run(tmp_path, "id force delta")
    grains = paths["particles"].rename(tmp_path / "p.dump")
    grains.write_text(dump_text(GRAINS, "id type x y z c_1 radius"))
    with pytest.raises(SceneError, match=r"names='pos id force'(?s:.*)patom1 patom2"):
        open_scene(grains, contacts=paths["contacts"])
    ds = open_scene(grains, contacts=paths["contacts"], names="id force delta")
    np.testing.assert_array_equal(ds.contact_force[0], [[-4, 1, 0]])


@pytest.mark.parametrize(
    ("words", "match"),
    [
        ("pos id force", "have 12 columns, but the file has 13"),
        ("pos id force delta history", "have 13 columns and at least one of the history"),
        ("pos id farce delta", "unknown word 'farce'; did you mean 'force'"),
        ("pos force delta heatFlux", "lack 'id' or 'force'|columns, but the file has 13"),
    ],
)
def test_words_that_do_not_fit_are_refused(tmp_path, words, match):
    paths = write_run(tmp_path, "pos id force delta")
    with pytest.raises(SceneError, match=match):
        open_scene(**paths, names=words)


def test_normal_forces_alone_give_a_warning(tmp_path):
    paths = write_run(tmp_path, "pos id force_normal")
    with pytest.warns(SceneWarning, match="only normal forces"):
        open_scene(**paths, names="pos id force_normal")


def test_words_are_for_liggghts(tmp_path):
    path = write(tmp_path / "p.dump", dump_text())
    with pytest.raises(SceneError, match="words of a compute are for the engine 'liggghts'"):
        open_scene(path, names="pos id", engine="lammps")


@pytest.mark.parametrize(
    ("columns", "row"),
    [
        ("id type type x y z radius", "{} 2 2 1 1 1 0.5"),
        ("id type x y z thread thread radius", "{} 2 1 1 1 4 4 0.5"),
        ("id id type x y z id radius radius", "{0} {0} 2 1 1 1 {0} 0.5 0.5"),
    ],
)
def test_equal_columns_of_one_name_count_once(tmp_path, columns, row):
    text = dump_text([row.format(1), row.format(2)], columns)
    scene = open_scene(write(tmp_path / "p.liggghts", text))
    np.testing.assert_array_equal(scene.particle_id, [[1, 2]])
    np.testing.assert_array_equal(scene.species, [[2, 2]])
    np.testing.assert_array_equal(scene.diameter, [[1, 1]])
    assert "(column" not in str(scene.attrs)


def test_unequal_columns_of_one_name_are_refused(tmp_path):
    text = dump_text(["1 2 2 1 1 1 0.5", "2 2 3 2 1 1 0.5"], "id type type x y z radius")
    path = write(tmp_path / "p.liggghts", text)
    with pytest.raises(
        SceneError, match=r"two columns are called 'type', and in row 1 .* 2 .* 3; .*names="
    ):
        open_scene(path)
    first = open_scene(path, names={"type (column 3)": None})
    np.testing.assert_array_equal(first.species, [[2, 2]])
    second = open_scene(path, names={"type": None, "type (column 3)": "species"})
    np.testing.assert_array_equal(second.species, [[2, 3]])
