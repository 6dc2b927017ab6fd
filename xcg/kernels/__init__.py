"""Loops over plain arrays: NumPy and Numba only."""

from xcg.kernels._jit import THREADS

__all__ = ["THREADS"]
