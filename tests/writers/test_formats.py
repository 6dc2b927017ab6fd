"""Files that are changed as a whole: they are read as they will be, and stay as they were until the end."""

from itertools import product

from xcg.writers.formats import Sink


def test_changes_are_read_back_before_they_are_in_the_file(tmp_path):
    """Of old bytes, later changes of the same ones, and of one that goes on beyond the old end."""
    path = tmp_path / "f.h5"
    path.write_bytes(b"0123456789")
    changes = {3: b"abcd", 5: b"XY", 8: b"efgh"}
    expected = bytearray(b"0123456789__")
    with Sink(path, "rb+", journal=True) as sink:
        for place, data in changes.items():
            sink.seek(place)
            assert sink.write(data) == len(data)
            expected[place : place + len(data)] = data
        for place, length in product(range(13), range(1, 14)):
            buffer = bytearray(length)
            sink.seek(place)
            got = sink.readinto(buffer)
            assert buffer[:got] == expected[place : place + length], (place, length)
        sink.check()
    assert path.read_bytes() == b"0123456789gh"
