"""Tables of text with a header, whatever their suffix and separator."""

import numpy as np
import pandas as pd
import pytest

import xcg

TABLE = pd.DataFrame(
    {"x": [0.1, 0.5], "y": [0.2, 0.3], "z": [0.0, 1.0], "radius": [0.1, 0.2], "id": [4, 2]}
)


@pytest.mark.parametrize(
    ("name", "options", "encoding"),
    [
        ("grains.txt", {}, "utf-8"),  # with an index, whose column has no name
        ("grains.txt", {"index": False, "sep": " "}, "utf-8"),
        ("grains.dat", {"index": False, "sep": "\t"}, "utf-8"),
        ("grains", {"index": False, "sep": ";"}, "utf-8"),
        ("grains.0100", {"index": False}, "utf-8-sig"),
        ("grains.txt.gz", {"index": False}, "utf-8"),
        ("grains.csv", {}, "utf-8"),
    ],
)
def test_a_header_makes_a_table(tmp_path, name, options, encoding):
    TABLE.to_csv(tmp_path / name, encoding=encoding, **options)
    ds = xcg.open_scene(tmp_path / name)
    assert ds.engine == "table"
    np.testing.assert_array_equal(ds.position[0], [[0.5, 0.3, 1.0], [0.1, 0.2, 0.0]])
    assert ds.particle_id.values.tolist() == [[2, 4]]


def test_tables_of_pandas_in_columns_of_text_are_tables(tmp_path):
    (tmp_path / "a.txt").write_text(TABLE.to_string(index=False))
    assert xcg.open_scene(tmp_path / "a.txt").diameter.values.tolist() == [[0.4, 0.2]]


def test_contacts_are_found_beside_particles(tmp_path):
    TABLE.to_csv(tmp_path / "p.txt", index=False)
    (tmp_path / "c.txt").write_text("id1,id2,fx,fy,fz\n4,2,1,0,0\n")
    ds = xcg.open_scene(tmp_path / "p.txt", contacts=tmp_path / "c.txt", density=1.0)
    assert ds.engine == "table"
    np.testing.assert_array_equal(ds.contact_force[0], [[1, 0, 0]])


@pytest.mark.parametrize("start", ["", "# "])
def test_names_in_quotes_may_hold_blanks(tmp_path, start):
    header = '"Particle Identifier" "Position.X" "Position.Y" "Position.Z" "Radius"'
    (tmp_path / "a.txt").write_text(f"{start}{header}\n7 0.1 0.2 0.3 0.5\n")
    ds = xcg.open_scene(tmp_path / "a.txt")
    assert ds.particle_id.values.tolist() == [[7]]
    np.testing.assert_array_equal(ds.position[0], [[0.1, 0.2, 0.3]])


@pytest.mark.parametrize("sign", [" ", ","])
@pytest.mark.filterwarnings("error")
def test_numbers_of_fortran_are_read(tmp_path, sign):
    rows = (
        "# t = 5.0D-01\nid x y z radius\n4 1.0D-01 2.0d-1 0.0D+00 1.0D-01\n2 .5D0 3.D-1 1D0 2d-1\n"
    )
    (tmp_path / "a.txt").write_text(
        rows.replace(" ", sign).replace(f"#{sign}t{sign}={sign}", "# t = ")
    )
    ds = xcg.open_scene(tmp_path / "a.txt")
    assert ds.time.values.tolist() == [0.5]
    np.testing.assert_array_equal(ds.position[0], [[0.5, 0.3, 1.0], [0.1, 0.2, 0.0]])
    np.testing.assert_array_equal(ds.diameter[0], [0.4, 0.2])


def test_a_header_without_rows_warns(tmp_path):
    (tmp_path / "a.csv").write_text("id,x,y,z,radius\n")
    with pytest.warns(
        xcg.SceneWarning, match="neither the first nor the last step holds particles"
    ):
        assert xcg.open_scene(tmp_path / "a.csv", density=1).sizes["particle"] == 0


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (b"<!DOCTYPE html>\n<html>", "a page of HTML.*download the file again"),
        ("id,x,y,z\n1,0,0,0\n".encode("utf-16"), "text in UTF-16.*save it as UTF-8"),
        (b"version https://git-lfs.github.com/spec/v1\n", "a pointer of Git LFS.*git lfs pull"),
        (b"PK\x03\x04", "a ZIP archive"),
    ],
)
def test_other_files_that_are_called_csv_are_named(tmp_path, content, match):
    (tmp_path / "a.csv").write_bytes(content)
    with pytest.raises(xcg.SceneError, match=match):
        xcg.open_scene(tmp_path / "a.csv")


def test_columns_of_words_are_dropped_as_the_error_says(tmp_path):
    (tmp_path / "a.csv").write_text("x,y,z,radius,Label\n1,2,3,0.5,image.tif\n")
    with pytest.raises(xcg.SceneError, match=r"'image.tif' .* dropped by names={'Label': None}"):
        xcg.open_scene(tmp_path / "a.csv")
    ds = xcg.open_scene(tmp_path / "a.csv", names={"Label": None})
    assert ds.diameter.values.tolist() == [[1]]


@pytest.mark.parametrize(("name", "separator"), [("a.csv", ";"), ("a.txt", ";"), ("a.dat", "\t")])
def test_decimal_commas_are_named(tmp_path, name, separator):
    TABLE.to_csv(tmp_path / name, index=False, sep=separator, decimal=",")
    with pytest.raises(
        xcg.SceneError, match=r"has '0,1' in column .* decimal commas are read by pandas"
    ):
        xcg.open_scene(tmp_path / name)


def test_an_index_without_a_name_is_named(tmp_path):
    (tmp_path / "a.txt").write_text(TABLE.to_string())
    with pytest.raises(xcg.SceneError, match=r"has 6 values, expected 5 .* index without a name"):
        xcg.open_scene(tmp_path / "a.txt")


@pytest.mark.parametrize(
    "text",
    [
        "Step Temp Press\n0 1 2\n",  # a log
        "x y z\nfirst second third\n",
        "x y\n",
        "position velocity\n1 2\n",
    ],
)
def test_other_texts_are_no_tables(tmp_path, text):
    (tmp_path / "a.txt").write_text(text)
    with pytest.raises(xcg.SceneError, match="no engine recognises"):
        xcg.open_scene(tmp_path / "a.txt")
