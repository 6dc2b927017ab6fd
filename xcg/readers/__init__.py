"""Readers: engines for DEM codes and file layouts, and the series that they make one lazy scene of.

`Engine` is what a reader of another format derives from.
"""

from xcg.readers.engine import Engine, ReadOptions, StepRef

__all__ = ["Engine", "ReadOptions", "StepRef"]
