"""Loops over plain arrays: NumPy and Numba only."""

from xcg.compiled._jit import THREADS

__all__ = ["THREADS"]
