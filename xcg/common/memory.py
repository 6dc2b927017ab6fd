"""Large arrays whose memory returns to the system when they are freed."""

from __future__ import annotations

import mmap
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

_LARGE = 1 << 20  # bytes; smaller ones are reused by the allocator
_HUGE = 1 << 22  # bytes from which on NumPy, too, asks for pages of 2 MB in place of 4 kB


def empty(shape: int | Sequence[int], dtype: DTypeLike = "float64") -> NDArray[Any]:
    """Make an array without values, in a map of its own where it is large.

    The allocator of C keeps freed arrays of tens of megabytes, for each thread apart, so that a
    series of steps would take more memory than any of its steps.
    """
    count = int(np.prod(shape))
    bytes_needed = count * np.dtype(dtype).itemsize
    if bytes_needed < _LARGE:
        return np.empty(shape, dtype)
    flags = {}
    if hasattr(mmap, "MAP_PRIVATE"):  # Windows has none
        flags["flags"] = mmap.MAP_PRIVATE
    pages = mmap.mmap(-1, bytes_needed, **flags)
    if bytes_needed >= _HUGE and hasattr(mmap, "MADV_HUGEPAGE"):
        with suppress(OSError):  # a kernel without them
            pages.madvise(mmap.MADV_HUGEPAGE)
    return np.ndarray(shape, dtype, buffer=pages)


def first_rows(array: NDArray, count: int) -> NDArray:
    """Return the first rows of an array of `empty`, which owns its memory then: large ones without a copy."""
    if count == len(array):
        return array
    if type(array.base) is mmap.mmap:
        return np.ndarray((count, *array.shape[1:]), array.dtype, buffer=array.base)
    return array[:count].copy()


def owns_memory(array: NDArray) -> bool:
    """Return whether an array owns its memory, which goes with it."""
    return array.base is None or type(array.base) is mmap.mmap
