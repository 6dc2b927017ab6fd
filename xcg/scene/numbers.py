"""Numbers as callers give them, told from texts and all else that is none."""

from __future__ import annotations

import math
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import NDArray


def floats(given: Any) -> NDArray[np.float64]:
    """Numbers as an array; NaN, without dimensions, where they are texts or anything else that is no number."""
    try:
        values = np.asarray(given)
        numeric = values.dtype.kind in "biuf" or (values.dtype.kind == "O" and not _holds_text(values))
        return values.astype("float64") if numeric else np.full((), np.nan)
    except (TypeError, ValueError, OverflowError):
        return np.full((), np.nan)


def _holds_text(values: NDArray) -> bool:
    return any(isinstance(value, (str, bytes)) for value in values.flat)


def is_finite(value: Any) -> TypeGuard[float]:
    """Whether this is one finite number."""
    number = floats(value)
    return number.ndim == 0 and math.isfinite(number)


def is_positive(value: Any) -> TypeGuard[float]:
    """Whether this is one finite number above zero."""
    return is_finite(value) and bool(value > 0)


def is_whole(value: Any, least: int, most: float = math.inf) -> bool:
    """Whether this is one whole number in a range."""
    return is_finite(value) and float(value).is_integer() and least <= value <= most
