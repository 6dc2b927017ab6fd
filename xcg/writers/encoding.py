"""Encoding of numbers in files: type, digits, compression."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import DTypeLike, NDArray

from xcg.common.checks import check, whole
from xcg.common.messages import SceneError
from xcg.compiled.arrays import round_bits

_MANTISSA = {4: 23, 8: 52}  # bits, by the bytes of a number
_SINGLE = 2.0**-24  # relative error of a number in single precision
_MOST_DIGITS = {"float32": 7, "float64": 15}


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
        kind = None
        if dtype is not None:
            with suppress(TypeError):  # of other texts
                kind = np.dtype(dtype).name
            if kind not in _MOST_DIGITS:
                raise ValueError(f"dtype={dtype!r}: expected 'float32' or 'float64'")
        most = _MOST_DIGITS[kind or "float64"]
        hint = f"; {kind or 'float64'} holds {most} digits"
        check("digits", digits, whole(1, most), optional=True, hint=hint)
        check("compression", compression, whole(0, 9), optional=True, hint="; 0 for none")
        if compression is None:  # see the table in docs/saving.md
            padded = "particle" in ds.dims or "contact" in ds.dims
            compression = int(padded or digits is not None or kind == "float32")
        return cls(kind, digits and int(digits), int(compression))

    def type_of(self, dtype: np.dtype[Any]) -> np.dtype[Any]:
        """Type on disk of numbers of a type."""
        if self.dtype and dtype.kind == "f":
            return np.dtype(self.dtype)
        return dtype

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
        drop = 0
        if self.digits is not None:
            bits = _bits(self.digits, twice=kind.itemsize < values.itemsize)
            drop = _MANTISSA[kind.itemsize] - bits
        if drop > 0:
            unsigned = np.dtype(f"u{kind.itemsize}")
            special = np.array(np.inf, kind).view(unsigned)[()]
            round_bits(out.reshape(-1).view(unsigned), unsigned.type(drop), special)
        infinite = np.isinf(out)
        if infinite.any():
            changed = infinite & np.isfinite(values)
            with np.errstate(over="ignore"):
                unrounded = values[changed].astype(kind)
            beyond = values[changed][np.isinf(unrounded)]
            if beyond.size:
                variable = repr(name) if name else "a variable"
                raise SceneError(
                    f"{variable} holds {beyond[0]:g}, beyond the range of {kind} (up to "
                    f"{np.finfo(kind).max:.3g}): save it with dtype='float64', or convert it to other units"
                )
            out[changed] = unrounded  # rounding carried these beyond the range
        return out

    def noted(self, ds: xr.Dataset) -> xr.Dataset:
        """Record on each variable how it was rounded."""
        if self.digits is None:
            return ds
        error = 0.5 * 10.0**-self.digits
        if self.dtype == "float32":
            error = max(error, _SINGLE)
        note = f"rounded to {self.digits} significant digits: relative error of at most {error:.2g}"
        floats = {name: data for name, data in ds.data_vars.items() if data.dtype.kind == "f"}
        return ds.assign({name: data.assign_attrs(precision=note) for name, data in floats.items()})


def _bits(digits: int, *, twice: bool) -> int:
    """Bits of the mantissa that the digits take; `twice` where numbers are rounded to single precision before."""
    share = 10.0**-digits  # twice the error that is left for these bits
    if twice:
        share -= 2 * _SINGLE
    if share <= 0:
        return _MANTISSA[4]
    return math.ceil(-math.log2(share))
