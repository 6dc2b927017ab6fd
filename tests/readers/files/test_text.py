"""Tables of numbers: blocks, threads and white space change nothing; gzipped series are decompressed once."""

from __future__ import annotations

import gzip
import re
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.dumps import ATOMS, dump_text, write
from xcg.common import memory
from xcg.common.messages import SceneError, SceneWarning
from xcg.readers.engine import ReadOptions
from xcg.readers.engines.lammps import Lammps
from xcg.readers.files import text
from xcg.readers.files.table import parse_table
from xcg.readers.open import open_scene

lammps = Lammps()

COLUMNS = ("a", "b", "c")
numbers = st.floats(allow_nan=False, allow_infinity=False).map(lambda x: f"{x:.6g}") | st.integers(
    -(10**9), 10**9
).map(str)
tables = st.lists(st.tuples(numbers, numbers, numbers), min_size=1, max_size=20)


@settings(deadline=None, max_examples=50)
@given(tables, st.sampled_from([" \n", "\n"]))
def test_white_space_and_pieces_of_text_change_no_bit(rows, end):
    body = "".join(" ".join(row) + end for row in rows).encode()
    expected = np.array([[float(word) for word in row] for row in rows]).T.tobytes()
    for changed in (
        body,
        body.replace(b" ", b"  "),
        body.replace(b" ", b"\t"),
        body.replace(b"\n", b"\r\n\n"),
    ):
        for size in (1, 7, len(changed)):
            pieces = [changed[at : at + size] for at in range(0, len(changed), size)]
            table = parse_table(pieces, COLUMNS, COLUMNS, len(rows), "file")
            assert b"".join(table[name].tobytes() for name in COLUMNS) == expected


@pytest.mark.parametrize("digits", [(6, 6), (6, 15), (15, 6)])
@pytest.mark.parametrize("length_is_known", [True, False])
def test_rows_may_become_shorter_and_longer(digits, length_is_known):
    values = np.random.default_rng(0).uniform(1, 2, (60_000, 3))
    lines = [
        " ".join(f"{number:.{digits[k >= 30_000]}f}" for number in row) + "\n"
        for k, row in enumerate(values)
    ]
    body = "".join(lines).encode()
    pieces = [body[at : at + 100_000] for at in range(0, len(body), 100_000)]
    length = len(body) if length_is_known else 0
    table = parse_table(pieces, COLUMNS, COLUMNS, None, "file", vectors=[("a", "b")], length=length)
    expected = np.array([line.split() for line in lines], float)
    np.testing.assert_array_equal(table["c"], expected[:, 2])
    np.testing.assert_array_equal(table["a", "b"], expected[:, :2])


def test_memory_for_equal_rows_is_set_aside_once(monkeypatch):
    made = []
    empty = memory.empty
    monkeypatch.setattr(memory, "empty", lambda shape: made.append(shape) or empty(shape))
    parse_table(b"1.5 2.5 3.5\n" * 200_000, COLUMNS, COLUMNS, None, "file")
    assert [np.prod(shape) > 0 for shape in made] == [False] * 3 + [True] * 3


@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("rows", [20_000, None])
def test_blocks_and_threads_change_nothing(threads, rows):
    values = np.random.default_rng(0).normal(size=(20_000, 3))
    # 1.2 MB: ten pieces of text
    lines = [
        "{!r} {!r} {!r}\n".format(*row) + "\n" * (k % 700 == 5)
        for k, row in enumerate(values.tolist())
    ]

    def parse(lines, threads):
        return parse_table("".join(lines).encode(), COLUMNS, ("c", "a"), rows, "file", threads)

    table = parse(lines, threads)
    np.testing.assert_array_equal(table["a"], values[:, 0])
    np.testing.assert_array_equal(table["c"], values[:, 2])
    for row, line, found in [
        (15_000, "1 2\n", "2 values, expected 3 ('1 2'); the columns are a b c"),
        (19_999, "1 2\n", "2 values, expected 3 ('1 2'); the file is cut off here"),
        (7000, "1 2 x\n", "'x' in column 'c'"),
    ]:
        for further in (threads, 1):
            with pytest.raises(SceneError, match=re.escape(f"file: row {row} has {found}")):
                parse([*lines[:row], line, "\n", *lines[row + 1 :]], further)
    if rows:
        with pytest.raises(
            SceneError, match="19999 rows, but the header says 20000: row 19999 is missing"
        ):
            parse(lines[:-1], threads)
        with pytest.raises(
            SceneError, match="more rows than the 20000 that the header says; row 20000 is '7 8 9'"
        ):
            parse([*lines, "\n7 8 9\n\n", "8 9"], threads)


def test_an_endless_line_raises():
    with pytest.raises(SceneError, match="file: a line has no end in 1048576 bytes"):
        parse_table(b"1 2 3\n" + b"1 " * 600_000, COLUMNS, COLUMNS, None, "file")


@pytest.mark.parametrize(
    "body",
    [
        b"1 2 3\n4  5 6\n",
        b"1 2 3 \n 4 5 6\n",
        b"1 2 3\n4 5 6 \n",
        b"1 2 3 \n4 5 6\n",
        b"1 2 3\n4\t5 6\n",
        b" 1 2 3\n4 5 6\n",
        b"1 2 3 \n4  5 6\n",
        b"1 2 3\r\n4 5 6\r\n",
        b"1 2 3 \n\n4 5 6 \n",
        b"1 2 3\n 4 5 6\n",
        b"1 2 3\n4  5  6\n",
    ],
)
@pytest.mark.parametrize("wanted", [("a", "b", "c"), ("a",), ("b",), ("c",)])
def test_uneven_white_space_changes_nothing(body, wanted):
    table = parse_table(body, COLUMNS, wanted, 2, "file")
    whole = dict(zip(COLUMNS, ([1, 4], [2, 5], [3, 6]), strict=True))
    assert {name: values.tolist() for name, values in table.items()} == {
        name: whole[name] for name in wanted
    }


@pytest.mark.parametrize("rows", [2, None])
@pytest.mark.parametrize("separator", [" ", ",", ";", "\t"])
def test_vectors_hold_their_columns_in_order(rows, separator):
    body = separator.join("123").encode() + b"\n" + separator.join("456").encode() + b"\n"
    table = parse_table(
        body, COLUMNS, COLUMNS, rows, "file", vectors=[("c", "a")], separator=separator
    )
    assert table["c", "a"].tolist() == [[3, 1], [6, 4]]
    assert table["c", "a"].flags.c_contiguous
    for name, values in (("a", [1, 4]), ("b", [2, 5]), ("c", [3, 6])):
        assert table[name].tolist() == values
    assert np.shares_memory(table["a"], table["c", "a"])


@pytest.mark.parametrize(
    "body", [b"1 2 3 \n4 5 \n", b"1 2 3 \n4 5 6 7 \n", b"1 2 3\n4 5\n", b"1 2 3 \n4 x 6 \n"]
)
def test_errors_name_the_row(body):
    with pytest.raises(SceneError, match="file: row 1 has"):
        parse_table(body, COLUMNS, COLUMNS, 2, "file")


# --- gzipped series --------------------------------------------------------------------------------------


@pytest.fixture
def opened(monkeypatch):
    """Count how often files are decompressed from the start to read bodies, which is without naming their kind."""
    calls = []
    original = text.open_compressed

    def counted(path, *kind):
        if not kind:
            calls.append(path)
        return original(path, *kind)

    monkeypatch.setattr(text, "open_compressed", counted)
    monkeypatch.setattr(text, "_waiting", [])
    return calls


def rows(step):
    return [f"{k} 1 {k + 0.001 * step} 0 0 0 0 0 0.5 1" for k in range(1, 4)]


def test_a_series_is_decompressed_once(tmp_path, opened):
    path = write(tmp_path / "p.dump.gz", [dump_text(rows(t), ATOMS, step=t) for t in range(12)])
    refs = lammps.index_particles([str(path)], ReadOptions())
    for ref in refs:
        frame = lammps.read_particles(ref, ReadOptions())
        assert frame["position"][1, 0] == 2 + 0.001 * ref.step
    assert len(opened) == 1
    for ref in refs[::-1]:  # against the stream every step begins anew, and none is wrong
        assert lammps.read_particles(ref, ReadOptions())["position"][1, 0] == 2 + 0.001 * ref.step
    assert len(opened) > len(refs) // 2


def test_threads_do_not_share_a_stream(tmp_path, opened):
    path = write(tmp_path / "p.dump.gz", [dump_text(rows(t), ATOMS, step=t) for t in range(30)])
    scene = open_scene(path)
    found = scene.position.compute(scheduler="threads", num_workers=4)
    np.testing.assert_array_equal(found[:, 1, 0], 2 + 0.001 * np.arange(30))
    assert len(text._waiting) <= text._MOST_WAITING


def test_a_file_that_changed_is_opened_anew(tmp_path, opened):
    texts = [dump_text(rows(t), ATOMS, step=t) for t in range(3)]
    path = write(tmp_path / "p.dump.gz", texts)
    refs = lammps.index_particles([str(path)], ReadOptions())
    lammps.read_particles(refs[0], ReadOptions())
    path.write_bytes(gzip.compress("".join(texts).replace("2.001", "7.001").encode()))
    assert lammps.read_particles(refs[1], ReadOptions())["position"][1, 0] == 7.001


def zstd():
    return text._zstd() or pytest.skip("needs Python 3.14 or backports.zstd")


def test_zstd_is_read_as_plain_text_is(tmp_path, opened):
    texts = [dump_text(rows(t), ATOMS, step=t) for t in range(12)]
    plain = write(tmp_path / "plain.dump", texts)
    path = tmp_path / "p.dump.zst"
    path.write_bytes(
        b"".join(zstd().compress(text.encode()) for text in ["".join(texts[:5]), *texts[5:]])
    )  # frames
    scene = open_scene(path)
    expected = open_scene(plain)
    np.testing.assert_array_equal(scene.position, expected.position)
    opened.clear()
    for ref in lammps.index_particles([str(path)], ReadOptions()):
        lammps.read_particles(ref, ReadOptions())
    assert len(opened) == 1  # for all bodies


def test_damaged_zstd_raises(tmp_path):
    whole = zstd().compress("".join(dump_text(rows(t), ATOMS, step=t) for t in range(300)).encode())
    path = tmp_path / "p.dump.zst"
    for data in (whole[:-200], whole[:100] + b"xxxx" + whole[104:]):
        path.write_bytes(data)
        with pytest.raises(SceneError, match=r"p\.dump\.zst"):
            open_scene(path, engine="lammps").compute()


def test_zstd_without_its_package_names_the_extra(tmp_path, monkeypatch):
    path = tmp_path / "p.dump.zst"
    path.write_bytes(b"\x28\xb5\x2f\xfd")
    monkeypatch.setattr(text, "_zstd", lambda: None)
    with pytest.raises(SceneError, match=r"p\.dump\.zst: .*pip install 'xcg\[zstd\]'"):
        open_scene(path)


@pytest.mark.parametrize("count", [3, 4000])
def test_concatenated_gzip_files_are_read(tmp_path, count):
    """The last bytes of such a file tell the size of its last step only, which is that of one step."""
    rng = np.random.default_rng(0)
    texts = []
    positions = []
    for t in range(3):
        positions.append(rng.random((count, 3)))
        lines = [
            f"{k} 1 {x} {y} {z} 0 0 0 0.005 0.001"
            for k, (x, y, z) in enumerate(positions[-1].tolist(), 1)
        ]
        texts.append(dump_text(lines, ATOMS, step=10 * t))
    path = tmp_path / "p.0.dump.gz"
    path.write_bytes(b"".join(gzip.compress(text.encode()) for text in texts))
    assert (path.stat().st_size > 3 * text._SAMPLE) == (count > 3)
    scene = open_scene(path)
    assert scene.step.values.tolist() == [0, 10, 20]
    np.testing.assert_array_equal(scene.position, positions)
    # one member of three steps, and one of one step, which is not read through
    path.write_bytes(gzip.compress("".join(texts).encode()))
    np.testing.assert_array_equal(open_scene(path).position, positions)
    path.write_bytes(gzip.compress(texts[0].encode()))
    assert text.uncompressed_size(str(path)) == len(texts[0])
    assert lammps.index_particles([str(path)], ReadOptions())[0].alone


@pytest.mark.parametrize("count", [10, 400])
def test_whole_steps_of_a_gzip_file_that_ends_early_are_read(tmp_path, count):
    texts = [
        dump_text([f"{k} 1 {k / 7 + t} 1 1 0 0 0 0.5 1" for k in range(1, count)], step=t)
        for t in range(12)
    ]
    whole = gzip.compress("".join(texts).encode())
    data = whole[: int(0.9 * len(whole))]
    path = tmp_path / "p.dump.gz"
    path.write_bytes(data)
    stops = np.cumsum([len(text) for text in texts])
    complete = int((stops <= len(zlib.decompressobj(31).decompress(data))).sum())
    assert 6 < complete < 12
    with pytest.raises(
        SceneError, match=r"p\.dump\.gz: its compressed data are damaged or cut off"
    ):
        open_scene(path)
    with pytest.warns(SceneWarning):
        ds = open_scene(path, on_error="skip")
    assert ds.step.values.tolist() == [*range(complete)]
    assert "p.dump.gz" in ds.attrs["skipped_files"]
    np.testing.assert_array_equal(ds.position[:, 0, 0], 1 / 7 + np.arange(complete))


def test_a_second_step_in_a_file_of_one_step_raises(tmp_path, monkeypatch):
    rows = [
        f"{k} 1 {k} 1 1 0 0 0 0.5 1" for k in range(30)
    ]  # so many that lines of headers are few
    texts = [dump_text(rows, step=t).encode() for t in range(2)]
    path = tmp_path / "p.0.dump.gz"
    path.write_bytes(b"".join(map(gzip.compress, texts)))
    monkeypatch.setattr("xcg.readers.engines.lammps.uncompressed_size", lambda path: len(texts[0]))
    with pytest.raises(SceneError, match=r"p\.0\.dump\.gz \(step 0\): more follows"):
        open_scene(path)
