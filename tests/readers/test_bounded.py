"""What files may ask for is bounded: steps, blank lines, headers, and what a few compressed bytes stand for."""

import gzip

import numpy as np
import pytest

import xcg
from tests import dumps
from xcg.readers import paths


def test_a_last_column_of_text_is_skipped(tmp_path):
    rows = ["2 1 1.9 1 1 0 0 0 0.5 1 NA", "1 1 1 1 1 0 0 0 0.5 1 Si"]
    for name, ends in (
        ("single.dump", rows),
        ("wide.dump", [row.replace(" ", "  ") for row in rows]),
    ):
        path = dumps.write(tmp_path / name, dumps.dump_text(ends, dumps.ATOMS + " element"))
        ds = xcg.open_scene(path, timestep=0.1).load()
        np.testing.assert_array_equal(ds.position[0, :, 0], [1, 1.9])
    cut = dumps.write(
        tmp_path / "cut.dump", dumps.dump_text([rows[0], rows[1][:-3]], dumps.ATOMS + " element")
    )
    with pytest.raises(xcg.SceneError, match="row 1 has 10 values, expected 11"):
        xcg.open_scene(cut, timestep=0.1)


@pytest.mark.parametrize("later", [1, 30, 99])
def test_later_steps_with_fewer_rows_in_a_file_named_by_the_first(tmp_path, later):
    rows = [f"{k} 1 {k % 10} {k // 10} 1.5 0 0 0 0.5 1" for k in range(1, 101)]
    whole = [
        dumps.dump_text(rows[:count], step=step)
        for step, count in ((0, 100), (10, later), (20, later))
    ]
    ds = xcg.open_scene(dumps.write(tmp_path / "p.0.dump", whole), timestep=0.1)
    assert (ds.particle_id >= 0).sum("particle").values.tolist() == [100, later, later]


def test_compressed_bytes_that_expand_too_much_raise(tmp_path):
    contact = b"0 0 1 0.75 0.5 0.5 0.1 0 3 1 -1 0 0 0 1 0\n"
    (tmp_path / "run.data").write_text("0 0 0 0 0 2 2 2\n")
    (tmp_path / "run.fstat.gz").write_bytes(
        gzip.compress(b"# 0 0\n# a\n# b\n" + contact * 2_000_000)
    )  # 86 MB
    with pytest.raises(xcg.SceneError, match=r"fstat.gz: its compressed bytes stand for more than"):
        xcg.open_scene(tmp_path / "run.data", contacts=tmp_path / "run.fstat.gz", engine="mercury")


def test_endless_blank_lines_and_headers_raise(tmp_path):
    whole = dumps.dump_text()
    blank = dumps.write(tmp_path / "blank.dump.gz", "\n" * 20_000 + whole)
    with pytest.raises(xcg.SceneError, match=r"more than 10000 lines .* are blank"):
        xcg.open_scene(blank, engine="lammps", timestep=0.1)
    endless = dumps.write(
        tmp_path / "endless.dump.gz", whole + "ITEM: TIMESTEP\n7\n" * 100_000 + whole
    )
    with pytest.raises(xcg.SceneError, match="has no end in 1048576 bytes"):
        xcg.open_scene(endless, timestep=0.1)


def test_too_many_steps_in_one_file_raise(tmp_path, monkeypatch):
    monkeypatch.setattr(paths, "_MOST_STEPS", 20)
    steps = dumps.write(tmp_path / "p.dump", [dumps.dump_text(step=step) for step in range(21)])
    with pytest.raises(xcg.SceneError, match="more than 20 steps in one file"):
        xcg.open_scene(steps, timestep=0.1)
