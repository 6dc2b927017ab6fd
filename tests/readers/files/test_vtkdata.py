"""Base64 that is damaged is refused; parts that unpack without a limit."""

import base64
import io
import tracemalloc
import zlib
from contextlib import nullcontext

import numpy as np
import pytest

from tests.benchmarks import series
from xcg.common.messages import SceneError
from xcg.readers.files import vtkdata, vtkheader, vtp

# --- base64 ----------------------------------------------------------------------------------------------

PLAIN = vtkdata.VtkEncoding("<", np.dtype("<u4"), "")


def block(values):
    """Values as VTK encodes them: their length and they in one piece."""
    return base64.b64encode(np.uint32(values.nbytes).tobytes() + values.tobytes())


def decoded(text, count):
    return vtkdata.read_base64(io.BytesIO(text), 0, PLAIN, np.dtype("<i4"), count)


@pytest.mark.parametrize("count", range(1, 8))
def test_base64_of_every_length_is_decoded(count):
    values = np.random.default_rng(count).integers(-(2**31), 2**31, count, "<i4")
    np.testing.assert_array_equal(decoded(block(values) + b"  <", count), values)


def test_damaged_base64_raises_or_reads_as_in_python():
    """What the standard library refuses is refused, and what is read is what it reads."""
    text = block(np.arange(4, dtype="<i4"))
    for place in range(len(text)):
        for byte in range(256):
            changed = text[:place] + bytes([byte]) + text[place + 1 :]
            try:
                got = decoded(changed, 4)
            except vtkdata.DataError:
                continue
            expected = np.frombuffer(base64.b64decode(changed, validate=True)[4:20], "<i4")
            np.testing.assert_array_equal(got, expected.astype("f8"))


@pytest.mark.parametrize("piece", [b"=", b"==", b"=A", b"\n", b" ", b"\xff", b"-"])
def test_foreign_characters_raise(piece):
    values = np.arange(4, dtype="<i4")
    text = block(values)
    for at in range(len(text) - 4):  # the last group may be padded
        with pytest.raises(vtkdata.DataError):
            decoded(text[:at] + piece + text[at + len(piece) :], 4)


# --- text ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("between", [" ", "\n", "\t", "\r\n", " \n \v\f", "   "])
def test_ascii_has_the_numbers_of_python_whatever_stands_between(between):
    rng = np.random.default_rng(1)
    words = [
        repr(x) for x in (rng.normal(size=9000) * 10.0 ** rng.integers(-300, 300, 9000)).tolist()
    ]
    words += ["7", "+1.", "-.5", "1E5", "4.9e-324", "9007199254740993", "1e-400"]
    text = (between + between.join(words) + between).encode()
    values = vtkdata.parse_text(text, "Float64", len(words))
    np.testing.assert_array_equal(values, [float(word) for word in words])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"1 2", "2 numbers, not 3"),
        (b"1 2 3\n4", "4 numbers, not 3"),
        (b"", "0 numbers, not 3"),
        (b"1 x 3", "something else than finite numbers"),
        (b"1 nan 3", "something else than finite numbers"),
        (b"1 1_0 3", "something else than finite numbers"),
    ],
)
def test_ascii_that_is_not_as_promised_raises(text, message):
    with pytest.raises(vtkdata.DataError, match=message):
        vtkdata.parse_text(text, "Float64", 3)


def test_ascii_of_single_precision_is_rounded_to_it():
    (value,) = vtkdata.parse_text(b"0.1", "Float32", 1)
    assert value == np.float64(np.float32(0.1))


# --- zlib ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("encoding", ["zlib", "zlib base64"])
def test_arrays_compressed_by_zlib_are_read(tmp_path, encoding):
    (ds,) = series.packings(3000, 1)
    path = series.write_vtp(tmp_path / "p.vtp", ds, "position", series.PARTICLE_ARRAYS, encoding)
    header = vtp.read_header(str(path))
    got = vtkheader.read_arrays(header, header.names)
    np.testing.assert_array_equal(got["coordinates"], ds.position.values[0].astype("f4"))
    np.testing.assert_array_equal(got["Velocity"], ds.velocity.values[0].astype("f4"))


@pytest.mark.parametrize(
    ("number", "size", "last", "part", "message"),
    [
        (1, 12_000, 0, bytes(1 << 24), None),  # what is beyond the promise is never unpacked
        (2, 0, 12_000, bytes(1 << 24), "2 parts of 0 bytes"),
        (1, 12_000, 0, bytes(11_999), "does not unpack to 12000 bytes"),
        (1, 12_000, 0, b"", "does not unpack to 12000 bytes"),
    ],
)
def test_wrong_sizes_of_compressed_parts_raise(tmp_path, number, size, last, part, message):
    parts = [zlib.compress(part, 9), zlib.compress(bytes(12_000))][:number]
    path = tmp_path / "block"
    path.write_bytes(
        np.array([number, size, last, *map(len, parts)], "<u4").tobytes() + b"".join(parts)
    )
    encoding = vtkdata.VtkEncoding("<", np.dtype("<u4"), "vtkZLibDataCompressor")
    tracemalloc.start()
    try:
        with (
            path.open("rb") as file,
            pytest.raises(vtkdata.DataError, match=message) if message else nullcontext(),
        ):
            assert not vtkdata.read_raw(file, 0, encoding, np.dtype("<f4"), 3000).any()
        assert tracemalloc.get_traced_memory()[1] < 1 << 22
    finally:
        tracemalloc.stop()


def test_damaged_compressed_parts_raise(tmp_path):
    (ds,) = series.packings(500, 1)
    path = series.write_vtp(tmp_path / "p.vtp", ds, "position", series.PARTICLE_ARRAYS, "zlib")
    header = vtp.read_header(str(path))
    data = path.read_bytes()
    start = header.pieces[0].arrays[0].start + 16
    path.write_bytes(data[:start] + b"\xff" * 400 + data[start + 400 :])
    with pytest.raises(
        SceneError, match=r"p\.vtp: 'coordinates' is not as its header says.*does not unpack"
    ):
        vtkheader.read_arrays(header, header.names)
