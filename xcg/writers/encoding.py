"""Encoding of numbers in files: type, digits, compression."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import DTypeLike, NDArray

from xcg.common.messages import SceneError
from xcg.compiled.arrays import round_bits

_MANTISSA = {4: 23, 8: 52}  # bits, by the bytes of a number
_SINGLE = 2.0**-24  # relative error of a number in single precision
_MOST_DIGITS = {4: 7, 8: 15}


@dataclass(frozen=True)
class Encoding:
    """Encoding of a Dataset in a file.

    Attributes
    ----------
    dtype : str or None
        "float32" or "float64" for all variables of floating point; None keeps the type of each.
    digits : int or None
        Significant digits that are kept; None keeps all.
    level : int
        Level of compression, 1 to 9; 0 for none.
    """

    dtype: str | None = None
    digits: int | None = None
    level: int = 0

    @classmethod
    def of(
        cls,
        ds: xr.Dataset,
        dtype: DTypeLike | None = None,
        digits: int | None = None,
        compression: int | None = None,
    ) -> Encoding:
        """Check the arguments of `xcg.save`, and choose a level of compression where none is given.

        Raises
        ------
        ValueError
            If one of them is unknown.
        """
        try:
            kind = None if dtype is None else np.dtype(dtype).name
        except TypeError:  # of other texts
            kind = str(dtype)
        if kind not in (None, "float32", "float64"):
            raise ValueError(f"dtype={dtype!r}: expected 'float32' or 'float64'")
        most = _MOST_DIGITS[4 if kind == "float32" else 8]
        if digits is not None and not (isinstance(digits, int) and 1 <= digits <= most):
            raise ValueError(
                f"digits={digits!r}: expected a whole number from 1 to {most} for {kind or 'float64'}"
            )
        if compression is not None and compression not in range(10):
            raise ValueError(
                f"compression={compression!r}: expected a level from 1 to 9, or 0 for none"
            )
        if compression is None:  # see the table in docs/saving.md
            padded = "particle" in ds.dims or "contact" in ds.dims
            compression = int(padded or digits is not None or kind == "float32")
        return cls(kind, digits, int(compression))

    def type_of(self, dtype: np.dtype[Any]) -> np.dtype[Any]:
        """Type on disk of numbers of a type."""
        return np.dtype(self.dtype) if self.dtype and dtype.kind == "f" else dtype

    def reduced(self, values: NDArray, name: str = "") -> NDArray:
        """Numbers in their type on disk, rounded to the digits that are kept; `name` is the variable's, for messages.

        The relative error of rounding is at most ``0.5 * 10**-digits``, or that of single precision
        where it is larger: ``ceil(digits * log2(10))`` bits of the mantissa are kept (one more for
        six digits in single precision), and the rest is rounded to nearest even. NaN and infinity
        stay what they are.

        Raises
        ------
        SceneError
            If a finite number is beyond the range of the type.
        """
        kind = self.type_of(values.dtype)
        if values.dtype.kind != "f" or (kind == values.dtype and self.digits is None):
            return values
        with np.errstate(over="ignore"):
            out = np.array(values, dtype=kind, order="C", copy=True)
        bits = self.digits and _bits(self.digits, twice=kind.itemsize < values.itemsize)
        if bits and (drop := _MANTISSA[kind.itemsize] - bits) > 0:
            whole = np.dtype(f"u{kind.itemsize}")
            special = np.array(np.inf, kind).view(whole)[()]
            round_bits(out.reshape(-1).view(whole), whole.type(drop), special)
        infinite = np.isinf(out)
        if infinite.any():
            changed = infinite & np.isfinite(values)
            with np.errstate(over="ignore"):
                unrounded = values[changed].astype(kind)
            beyond = values[changed][np.isinf(unrounded)]
            if beyond.size:
                raise SceneError(
                    f"{repr(name) if name else 'a variable'} holds {beyond[0]:g}, beyond the range of {kind} (up to "
                    f"{np.finfo(kind).max:.3g}): save it with dtype='float64', or convert it to other units"
                )
            out[changed] = unrounded  # rounding carried these beyond the range
        return out

    def noted(self, ds: xr.Dataset) -> xr.Dataset:
        """Record on each variable how it was rounded."""
        if self.digits is None:
            return ds
        error = max(0.5 * 10.0**-self.digits, _SINGLE if self.dtype == "float32" else 0.0)
        note = f"rounded to {self.digits} significant digits: relative error of at most {error:.2g}"
        floats = {name: data for name, data in ds.data_vars.items() if data.dtype.kind == "f"}
        return ds.assign({name: data.assign_attrs(precision=note) for name, data in floats.items()})


def _bits(digits: int, *, twice: bool) -> int:
    """Bits of the mantissa that the digits take; `twice` where numbers are rounded to single precision before."""
    # twice the error that is left for these bits
    share = 10.0**-digits - (2 * _SINGLE if twice else 0.0)
    return math.ceil(-math.log2(share)) if share > 0 else _MANTISSA[4]
