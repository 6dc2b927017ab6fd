"""Large arrays are in maps of their own, and views are told from arrays that own their memory."""

import mmap

import numpy as np
import pytest

from xcg.common import memory


@pytest.mark.parametrize("rows", [0, 10, 1_000_000])
@pytest.mark.parametrize("dtype", ["float64", "int64"])
def test_arrays_are_writable_and_own_their_memory(rows, dtype):
    array = memory.empty((rows, 3), dtype)
    array[:] = 7
    assert array.shape == (rows, 3)
    assert array.dtype == dtype
    assert array.flags.c_contiguous
    assert (array == 7).all()
    assert memory.owns_memory(array)
    assert not memory.owns_memory(array[:, 0])
    assert (type(array.base) is mmap.mmap) == (array.nbytes >= 1 << 20)


def test_arrays_over_bytes_of_others_are_views():
    assert memory.owns_memory(np.zeros(3))
    assert not memory.owns_memory(np.frombuffer(bytes(24)))


@pytest.mark.parametrize("rows", [10, 1_000_000])
def test_first_rows_own_the_memory_of_the_whole(rows):
    array = memory.empty((rows, 3))
    array[:] = np.arange(rows)[:, None]
    for count in (0, rows - 3, rows):
        first = memory.first_rows(array, count)
        np.testing.assert_array_equal(first, array[:count])
        assert memory.owns_memory(first)
        assert not array.nbytes >= 1 << 20 or count == 0 or np.shares_memory(first, array)
