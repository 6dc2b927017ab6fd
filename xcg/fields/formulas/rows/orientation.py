"""Grains that are not round: how their axes are aligned, from the director n of each.

A director has no head: n and -n are one. With D the dimension of the scene and <> the mean over
grains, each counted once, Q = (D <n n> - I) / (D - 1) is 0 for directors of all directions and has
the largest eigenvalue 1 where all are along one. Source: de Gennes & Prost (1993), The Physics of
Liquid Crystals.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.fields.formulas.field import Field, Options, mean_of_sums


def _nematic(f: Any, s: Any, o: Options) -> NDArray:
    nematic = f.orientation_tensor * (o.dimension / (o.dimension - 1))
    for k in o.plane:
        nematic[..., k, k] -= 1 / (o.dimension - 1)
    return nematic


def _axes(tensor: NDArray, o: Options) -> tuple[NDArray, NDArray]:
    """Largest eigenvalue (...) of tensors (..., 3, 3) in the scene's axes, and its axis (..., 3); NaN if unknown."""
    inside = tensor[..., o.plane, :][..., o.plane]
    known = np.isfinite(inside).all(axis=(-2, -1))
    values, vectors = np.linalg.eigh(np.where(known[..., None, None], inside, 0.0))
    axis = np.zeros((*known.shape, 3))
    axis[..., o.plane] = vectors[..., -1]
    largest = np.argmax(np.abs(axis), axis=-1)[..., None]
    # of both signs the one whose largest part is positive
    axis = axis * np.sign(np.take_along_axis(axis, largest, -1))
    return np.where(known, values[..., -1], np.nan), np.where(known[..., None], axis, np.nan)


_ROWS: dict[str, Field] = {
    "orientation_tensor": mean_of_sums(
        "directors",
        "number",
        rank=2,
        long_name="orientation tensor of the directors",
        formula="<n n> = sum n_i n_i Psi / sum Psi",
        weight="number_density",
    ),
    "nematic_tensor": Field(
        rank=2,
        long_name="nematic tensor of the directors",
        formula="Q = (D <n n> - I) / (D - 1)",
        compute=_nematic,
        fields=("orientation_tensor",),
        weight="number_density",
    ),
    "nematic_order": Field(
        long_name="nematic order, 0 for directors of all directions, 1 where all are along one",
        formula="S, the largest eigenvalue of Q",
        compute=lambda f, s, o: _axes(f.nematic_tensor, o)[0],
        fields=("nematic_tensor",),
    ),
    "nematic_director": Field(
        rank=1,
        long_name="mean axis of the directors",
        formula="eigenvector of the largest eigenvalue of Q",
        compute=lambda f, s, o: _axes(f.nematic_tensor, o)[1],
        fields=("nematic_tensor",),
    ),
}
ROWS = {name: replace(row, default=False) for name, row in _ROWS.items()}
