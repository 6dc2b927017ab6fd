"""Displacement between two frames, strain and rotation, and the motion that an affine deformation leaves over.

In a scene of displacements (`xcg.displacement`) a grain's displacement replaces its velocity, so
that means, gradients and fluctuations are computed as for the flow.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.fields.formulas.algebra import contraction, deviator, ratio, times, trace, transposed
from xcg.fields.formulas.field import Field, Options


def _strain(f: Any, s: Any, o: Options) -> NDArray:
    stretch = times(transposed(f.deformation_gradient), f.deformation_gradient)
    return (stretch - np.eye(3)) / 2


def _volumetric_strain(f: Any, s: Any, o: Options) -> NDArray:
    rows = np.moveaxis(f.deformation_gradient, (-2, -1), (0, 1))
    (a, b, c), (d, e, g), (h, i, j) = rows
    return a * (e * j - g * i) - b * (d * j - g * h) + c * (d * i - e * h) - 1.0


def _rotation(f: Any, s: Any, o: Options) -> NDArray:
    """Return R of F = R U by singular values, NaN where F is not known or turns the inside out (det F <= 0)."""
    valid = (f.volumetric_strain > -1.0)[..., None, None]
    left, _, right = np.linalg.svd(np.where(valid, f.deformation_gradient, np.eye(3)))
    return np.where(valid, left @ right, np.nan)


def _rotation_vector(f: Any, s: Any, o: Options) -> NDArray:
    """Return axis times angle (rad) of the rotation."""
    from scipy.spatial.transform import Rotation

    turn = f.rotation.reshape(-1, 3, 3)
    finite = np.isfinite(turn).all(axis=(1, 2))
    vectors = np.full((len(turn), 3), np.nan)
    if finite.any():
        vectors[finite] = Rotation.from_matrix(turn[finite]).as_rotvec()
    return vectors.reshape(f.rotation.shape[:-1])


_ROWS: dict[str, Field] = {
    "displacement": Field(
        rank=1,
        units="m",
        long_name="displacement",
        formula="u = sum m_i u_i Psi / rho, u_i = r_i(t + lag) - r_i(t)",
        compute=lambda f, s, o: f.velocity,
        fields=("velocity",),
        weight="density",
    ),
    "displacement_gradient": Field(
        rank=2,
        long_name="displacement gradient, du_component / dx_direction",
        formula="H, as `velocity_gradient` with u_i for v_i",
        compute=lambda f, s, o: f.velocity_gradient,
        fields=("velocity_gradient",),
        weight="density",
    ),
    "deformation_gradient": Field(
        rank=2,
        long_name="deformation gradient",
        formula="F = I + H",
        compute=lambda f, s, o: f.displacement_gradient + np.eye(3),
        fields=("displacement_gradient",),
        weight="density",
    ),
    "strain": Field(
        rank=2,
        long_name="Green-Lagrange strain, extension positive",
        formula="E = (F^T F - I) / 2",
        compute=_strain,
        fields=("deformation_gradient",),
    ),
    "small_strain": Field(
        rank=2,
        long_name="small strain, extension positive",
        formula="epsilon = (H + H^T) / 2",
        compute=lambda f, s, o: (f.displacement_gradient + transposed(f.displacement_gradient)) / 2,
        fields=("displacement_gradient",),
        weight="density",
    ),
    "volumetric_strain": Field(
        long_name="volumetric strain, dilation positive",
        formula="det F - 1",
        fields=("deformation_gradient",),
        compute=_volumetric_strain,
    ),
    "shear_strain": Field(
        long_name="magnitude of the deviatoric strain",
        fields=("strain",),
        formula="|dev E| = sqrt(2 dev E : dev E), dev E = E - tr(E) / D I",
        compute=lambda f, s, o: np.sqrt(2 * contraction(deviator(f.strain, o.plane))),
        is_norm=True,
    ),
    "rotation": Field(
        rank=2,
        long_name="rotation",
        formula="R of F = R U, U symmetric and positive; NaN where det F <= 0",
        compute=_rotation,
        fields=("deformation_gradient", "volumetric_strain"),
    ),
    "rotation_vector": Field(
        rank=1,
        long_name="axis of the rotation, times its angle (rad)",
        formula="curl(u) / 2 where it is small",
        compute=_rotation_vector,
        fields=("rotation",),
    ),
    "nonaffine_covariance": Field(
        rank=2,
        units="m^2",
        long_name="covariance of the displacements about their affine fit",
        formula="sum m_i u'_i u'_i Psi / rho_T, u'_i = u_i - u - H (r_i - r_bar)",
        compute=lambda f, s, o: ratio(f.fluctuation_stress, f._free),
        fields=("fluctuation_stress", "_free"),
        weight="fluctuation_density",
    ),
    "d2min": Field(
        units="m^2",
        long_name="mean squared displacement of a grain about the affine fit",
        formula="D2min = tr(sum m_i u'_i u'_i Psi) / rho_T",
        compute=lambda f, s, o: trace(f.nonaffine_covariance, o.plane),
        fields=("nonaffine_covariance",),
        weight="fluctuation_density",
    ),
    "self_diffusion": Field(
        rank=2,
        units="m^2 s^-1",
        long_name="self-diffusion of the grains over the interval of the frames",
        formula="D = sum m_i u'_i u'_i Psi / (2 rho_T (t' - t))",
        compute=lambda f, s, o: ratio(f.nonaffine_covariance, 2 * ratio(s.interval, s.number)),
        fields=("nonaffine_covariance",),
        moments=("interval", "number"),
        weight="fluctuation_density",
    ),
}
ROWS = {name: replace(row, option="lag") for name, row in _ROWS.items()}
