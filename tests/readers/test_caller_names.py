"""The argument ``names=`` in each of its forms, by every door."""

import numpy as np
import pandas as pd
import pytest

import xcg
from xcg import SceneError
from xcg.readers.caller_names import CallerNames

GRAINS = pd.DataFrame({"id": [1, 2], "x": [0.0, 1.0], "y": 0.0, "z": 0.0, "size": 1.0})
BOTH_FORMS = (
    r"names=\{'particles': \{...\}, 'contacts': \{...\}\}.*names=\{'particles': \[...\], 'contacts'"
)


def test_text_is_a_list_of_its_words():
    text = "pos id force"
    words = tuple(text.split())
    every_kind = dict.fromkeys(("particles", "contacts", "walls"), words)
    assert CallerNames.parse(text) == CallerNames.parse(words) == CallerNames(listed=every_kind)
    of_contacts = CallerNames.parse({"contacts": text, "c_q": "charge", "walls": None})
    assert of_contacts.listed == {"contacts": words}
    assert of_contacts.mapped == {"c_q": "charge", "walls": None}


def test_a_column_may_be_called_as_a_kind():
    assert CallerNames.parse({"contacts": "coordination_number"}).mapped == {
        "contacts": "coordination_number"
    }


@pytest.mark.parametrize(
    "names",
    [
        {"particles": ["id", "x"], "contacts": {"a": "contact_i"}},
        {"particles": {"a": "diameter"}, "x": "position_x"},
        {"grains": {"a": "diameter"}},
        {"grains": ["id", "x"]},
        {"a": 3},
        {"particles": {"a": 3}},
        3,
    ],
)
def test_names_of_another_form_show_each_form(tmp_path, names):
    path = tmp_path / "p.csv"
    GRAINS.to_csv(path, index=False)
    with pytest.raises(SceneError, match=BOTH_FORMS):
        xcg.open_scene(path, names=names, density=1)
    with pytest.raises(SceneError, match=BOTH_FORMS):
        xcg.scene_from_table(GRAINS, names=names, density=1)


def test_a_mapping_renames_columns_of_a_list(tmp_path):
    path = tmp_path / "p.csv"
    GRAINS.to_csv(path, index=False, header=False)
    names = {"particles": ["id", "x", "y", "z", "size"], "size": "radius"}
    scene = xcg.open_scene(path, names=names, density=1)
    np.testing.assert_array_equal(scene.diameter, [[2.0, 2.0]])
    assert "size" not in scene


def test_a_text_lists_columns_of_a_table(tmp_path):
    path = tmp_path / "p.txt"
    GRAINS.to_csv(path, index=False, header=False, sep=" ")
    scene = xcg.open_scene(path, names="id x y z radius", density=1)
    np.testing.assert_array_equal(scene.diameter, [[2.0, 2.0]])


@pytest.mark.parametrize("names", ["id x y z radius", ["id", "x"], {"particles": ["id", "x"]}])
def test_tables_in_memory_take_no_list(names):
    with pytest.raises(SceneError, match="tables in memory name their columns; map them"):
        xcg.scene_from_table(GRAINS, names=names, density=1)


def test_a_list_for_a_kind_without_lists_is_an_error(tmp_path):
    path = tmp_path / "p.csv"
    GRAINS.to_csv(path, index=False, header=False)
    names = {"particles": list(GRAINS), "walls": ["id1", "id2"]}
    with pytest.raises(SceneError, match=r"Lists are for tables .* \(particles, contacts\)"):
        xcg.open_scene(path, names=names, density=1)
