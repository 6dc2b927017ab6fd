"""Loops over plain arrays: NumPy and Numba only."""
