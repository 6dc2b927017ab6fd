"""Arrays of callers and readers in the types and units of a scene, and their checks."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.common import memory
from xcg.common.messages import SceneError
from xcg.scene.schema import Frame, Setup, powers_of, variable

_WHOLE = 2.0**53  # from here on floats of 64 bits leave whole numbers out


def check_rows(frame: Frame, dim: str, source: str) -> None:
    """Raise SceneError for arrays of the wrong shape or with values that are not finite; name every bad variable."""
    first = next(name for name in frame if variable(name).dims[0] == dim)
    length = len(frame[first])
    if length == 3 and frame[first].shape != (3, 3) and frame[first].ndim == 2:
        raise SceneError(
            f"{source}: '{first}' has shape {frame[first].shape}, expected (n, 3), a row for each {dim}: give its "
            f"transpose, {first}.T"
        )
    problems = []
    for name, values in frame.items():
        expected = variable(name, values.dtype, values.ndim).shape(length)
        if values.shape != expected:
            hint = ""
            if values.shape == (length, 2) and expected == (length, 3):
                hint = " (of a layer, add a column of zeros for z and give dimension=2)"
            if values.shape == expected[::-1]:
                hint = f"; give its transpose, {name}.T"
            problems.append(f"'{name}' has shape {values.shape}, expected {expected}{hint}")
        elif values.dtype.kind == "f" and not _all_finite(values):
            bad = int(np.argwhere(~np.isfinite(values))[0][0])
            problems.append(f"'{name}' is not finite in row {bad}: {values[bad]}")
    if problems:
        message = f"{source}: {'; '.join(problems)}"
        if "not finite" in message:
            message += ". Every row must hold finite numbers: repair or drop it."
        raise SceneError(message)


def _all_finite(values: NDArray) -> bool:
    """Return whether all values are finite. Their sum, which takes no memory, shows it unless it overflows."""
    with np.errstate(invalid="ignore", over="ignore"):
        total = values.sum()
    return bool(np.isfinite(total)) or bool(np.isfinite(values).all())


def refuse_mask(name: str, values: Any, where: str = "") -> None:
    """Raise SceneError for masked values: the data below the mask would count."""
    if np.ma.is_masked(values):
        raise SceneError(
            f"{where}'{name}' is a masked array with {np.ma.count_masked(values)} masked values; leave out such rows "
            "of all variables (steps may differ in length), or fill them"
        )


def typed_arrays(frame: dict[str, Any], setup: Setup, source: str) -> Frame:
    """Convert arrays to their types and the scene's units, and take them out of the frame.

    Views are copied, so that the table of a reader, of which they are columns, can go.
    """
    typed: Frame = {}
    for name in list(frame):
        values = frame.pop(name)
        refuse_mask(name, values, f"{source}: ")
        array = np.asarray(values)
        row = variable(name, array.dtype, array.ndim)
        if row.dtype == "int64" and array.dtype.kind == "f":
            bad = np.flatnonzero(~((array == np.rint(array)) & (np.abs(array) < _WHOLE)))
            if bad.size:
                value = array.flat[bad[0]]
                why = "; tables are read as floats, which hold no larger ones: number them anew"
                raise SceneError(
                    f"{source}: '{name}' must hold whole numbers below 2^53, but row {bad[0]} is {value}"
                    f"{why * bool(_WHOLE <= abs(value) < np.inf)}"
                )
        try:
            if array.dtype.kind in "cmM":  # NumPy would make numbers of them
                raise TypeError
            typed[name] = array.astype(row.dtype, order="C", copy=not memory.owns_memory(array))
        except (TypeError, ValueError, OverflowError):  # the last of whole numbers beyond 64 bits
            raise SceneError(
                f"{source}: '{name}' holds {array.dtype}, expected real numbers of 64 bits; give each text a number of "
                "its own"
            ) from None
        factor = setup.factor(powers_of(row.units))
        if factor != 1.0:
            typed[name] = typed[name] * factor
    return typed
