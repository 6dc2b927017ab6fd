"""Checks of numbers as callers give them, and of packages that not everyone has."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeGuard, get_args

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import plain


def floats(argument: Any) -> NDArray[np.float64]:
    """Numbers as an array; NaN, without dimensions, where they are texts, booleans or other objects."""
    try:
        values = np.asarray(argument)
        texts = values.dtype.kind == "O" and any(
            isinstance(value, (str, bytes)) for value in values.flat
        )
        numeric = values.dtype.kind in "iufO" and not texts
        return values.astype("float64") if numeric else np.full((), np.nan)
    except (TypeError, ValueError, OverflowError):
        return np.full((), np.nan)


def is_finite(value: Any) -> TypeGuard[float]:
    """Return whether this is one finite number."""
    number = floats(value)
    return number.ndim == 0 and math.isfinite(number)


def is_positive(value: Any) -> TypeGuard[float]:
    """Return whether this is one finite number above zero."""
    return is_finite(value) and bool(value > 0)


def is_whole(value: Any, least: int, most: float = math.inf) -> bool:
    """Return whether this is one whole number in a range."""
    return is_finite(value) and float(value).is_integer() and least <= value <= most


@dataclass(frozen=True)
class Kind:
    """Kind of numbers that an argument takes.

    Attributes
    ----------
    fits : function
        Whether a value is one of them.
    adjective : str
        In messages, with its article: "a positive".
    limits : str
        What follows the noun in messages: "from 1 to 30".
    """

    fits: Callable[[Any], bool]
    adjective: str
    limits: str = ""


FINITE = Kind(is_finite, "a finite")
POSITIVE = Kind(is_positive, "a positive")
NOT_NEGATIVE = Kind(lambda value: is_finite(value) and value >= 0, "a finite", "of at least 0")


def whole(least: int, most: float = math.inf) -> Kind:
    """Return the kind of whole numbers in a range, ends included."""
    limits = f"of at least {least}"
    if math.isfinite(most):
        limits = f"from {least} to {most:.0f}"
    return Kind(lambda value: is_whole(value, least, most), "a whole", limits)


def above(low: float, high: float) -> Kind:
    """Return the kind of numbers above `low` and up to `high`."""
    return Kind(
        lambda value: is_finite(value) and low < value <= high,
        "a",
        f"above {low:g} and up to {high:g}",
    )


def between(low: float, high: float) -> Kind:
    """Return the kind of numbers between two that do not belong to it."""
    return Kind(
        lambda value: is_finite(value) and low < value < high, "a", f"between {low:g} and {high:g}"
    )


_NOUNS = {"m": "length", "Pa": "stress", "s": "time", "s-1": "rate", "kg": "mass"}


def check(
    name: str,
    value: Any,
    kind: Kind,
    unit: str = "",
    *,
    optional: bool = False,
    hint: str = "",
) -> None:
    """Raise ValueError unless an argument is one number of a kind.

    Parameters
    ----------
    name : str
        The caller's name for the argument, at the start of the message.
    unit : str
        Unit that the argument is in; lengths, times and others are called so.
    optional : bool
        None passes, too.
    hint : str
        End of the message, such as ", such as 0.02".

    Examples
    --------
    >>> check("spacing", -1.0, POSITIVE, "m", optional=True)
    Traceback (most recent call last):
    ValueError: spacing=-1.0: expected a positive length (m), or None
    """
    if (optional and value is None) or kind.fits(value):
        return
    expected = [kind.adjective, _NOUNS.get(unit, "number")]
    if unit:
        expected.append(f"({unit})")
    if kind.limits:
        expected.append(kind.limits)
    otherwise = ", or None" if optional else ""
    raise ValueError(f"{name}={plain(value)}: expected {' '.join(expected)}{otherwise}{hint}")


def check_choice(name: str, argument: Any, choices: Any) -> None:
    """Raise ValueError unless an argument is one of the values of a Literal."""
    if argument not in get_args(choices):
        raise ValueError(
            f"{name}={argument!r}: expected one of {', '.join(map(repr, get_args(choices)))}"
        )


def vector(
    name: str, argument: Any, *, infinite: bool = False, error: type[ValueError] = ValueError
) -> NDArray:
    """Check three finite numbers (3,), or infinite ones where these mean something; `name` is the caller's for them."""
    values = floats(argument)
    if (
        values.shape != (3,)
        or np.isnan(values).any()
        or not (infinite or np.isfinite(values).all())
    ):
        raise error(
            f"{name}={plain(argument)}: expected three {'' if infinite else 'finite '}numbers (x, y, z)"
        )
    return values


def unit_vector(name: str, argument: Any) -> NDArray:
    """Check three finite numbers that are not all zero, and make their length one; (3,)."""
    values = vector(name, argument)
    if not values.any():
        raise ValueError(
            f"{name}={plain(argument)}: expected a direction, three finite numbers (x, y, z), not all zero"
        )
    return unit(values)


def axis_vector(name: str, argument: Any) -> NDArray:
    """Return a unit vector (3,) along "x", "y" or "z", or along three numbers that are not all zero."""
    if not isinstance(argument, str):
        return unit_vector(name, argument)
    if argument not in ("x", "y", "z"):
        raise ValueError(f"{name}={argument!r}: expected 'x', 'y', 'z' or a direction (x, y, z)")
    return np.eye(3)["xyz".index(argument)]


def unit(values: NDArray) -> NDArray:
    """Make the length of a vector (3,) one, whatever it is: squares of its largest component would not be finite."""
    values = values / np.abs(values).max()
    return np.asarray(values / np.linalg.norm(values))


def rising_pair(name: str, argument: Any, *, equal: bool = False) -> tuple[float, float]:
    """Check two finite numbers of which the second is larger, or `equal` to the first where that is allowed."""
    ends = floats(argument)
    if (
        ends.shape != (2,)
        or not np.isfinite(ends).all()
        or ends[0] > ends[1]
        or (ends[0] == ends[1] and not equal)
    ):
        raise ValueError(
            f"{name}={plain(argument)}: expected (first, last) with first {'<=' if equal else '<'} last"
        )
    low, high = ends.tolist()
    return low, high


def extra(module: str, name: str, purpose: str) -> Any:
    """Import a module of an optional package.

    Parameters
    ----------
    module : str
        What to import, for example ``matplotlib.pyplot``.
    name : str
        The extra of xcg that holds its package (``project.optional-dependencies`` in
        pyproject.toml).
    purpose : str
        What it is needed for, as the subject of a sentence.

    Raises
    ------
    ImportError
        If it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        msg = f"{purpose} needs {error.name or module}, which is not installed: pip install 'xcg[{name}]'"
        raise ImportError(msg, name=error.name) from error
