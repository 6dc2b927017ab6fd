"""Functions that only loops call, called from Python: compiled, or as Python runs them."""

from collections.abc import Callable
from functools import cache
from types import FunctionType
from typing import Any

import numba


@cache
def compiled(function: Callable) -> Callable:
    """Make a function of a loop one that Python can call."""

    @numba.njit(error_model="numpy")
    def call(*args: Any) -> Any:
        return function(*args)

    return call


@cache
def uncompiled(function: Any) -> Callable:
    """Make a compiled function the Python function that it was, and those that it calls too."""
    given = function.py_func
    used = given.__globals__
    called = {
        name: uncompiled(used[name])
        for name in given.__code__.co_names
        if hasattr(used.get(name), "py_func")
    }
    return FunctionType(given.__code__, used | called, given.__name__)
