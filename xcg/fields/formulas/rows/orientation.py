"""Grains that are not round: how their axes are aligned, from the director n of each.

A director has no head: n and -n are one. With D the dimension of the scene and <> the mean over
grains, each counted once, Q = (D <n n> - I) / (D - 1) is 0 for directors of all directions, has the
eigenvalue 1 where all are along one, and -1/2 along the normal of a plane in which they are spread
evenly: the eigenvalue of largest modulus distinguishes these states. Source: de Gennes & Prost
(1993), The Physics of Liquid Crystals.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.fields.formulas import floors
from xcg.fields.formulas.field import Field, Options, mean_of_sums


def _nematic(f: Any, s: Any, o: Options) -> NDArray:
    nematic = f.orientation_tensor * (o.dimension / (o.dimension - 1))
    for k in o.plane:
        nematic[..., k, k] -= 1 / (o.dimension - 1)
    return nematic


_TIE = 1e-9  # relative difference of moduli that is rounding, as in a plane, where they are equal


def _axes(tensor: NDArray, o: Options) -> tuple[NDArray, NDArray]:
    """Return the eigenvalue of largest modulus (...) of tensors (..., 3, 3), and its axis (..., 3); NaN if unknown.

    Of two equal moduli the positive eigenvalue is taken.
    """
    inside = tensor[..., o.plane, :][..., o.plane]
    finite = np.isfinite(inside).all(axis=(-2, -1))
    values, vectors = np.linalg.eigh(np.where(finite[..., None, None], inside, 0.0))
    is_planar = -values[..., 0] > (1 + _TIE) * values[..., -1]
    axis = np.zeros((*finite.shape, 3))
    axis[..., o.plane] = np.where(is_planar[..., None], vectors[..., 0], vectors[..., -1])
    largest = np.argmax(np.abs(axis), axis=-1)[..., None]
    # of both signs the one whose largest part is positive
    axis = axis * np.sign(np.take_along_axis(axis, largest, -1))
    order = np.where(is_planar, values[..., 0], values[..., -1])
    return np.where(finite, order, np.nan), np.where(finite[..., None], axis, np.nan)


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
        long_name="nematic order, 0 for directors of all directions, 1 where all are along one axis, "
        "-1/2 where all directions of a plane are equal",
        formula="S, the eigenvalue of Q with the largest modulus",
        compute=lambda f, s, o: _axes(f.nematic_tensor, o)[0],
        fields=("nematic_tensor",),
        floor=floors.order,
        usual=0.1,
    ),
    "nematic_director": Field(
        rank=1,
        long_name="mean axis of the directors, or the normal of their plane where S < 0",
        formula="eigenvector of the eigenvalue S of Q",
        compute=lambda f, s, o: _axes(f.nematic_tensor, o)[1],
        fields=("nematic_tensor",),
    ),
}
ROWS = {name: replace(row, default=False) for name, row in _ROWS.items()}
