"""Grains that are not round: directors from quaternions, volume and inertia from half-axes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from scipy.special import beta

from xcg.common.checks import is_positive, unit_vector
from xcg.scene.conform import require_scene, takes_scene
from xcg.scene.schema import COMPONENTS, VARIABLES, units_in


@takes_scene
def derive_director(
    ds: xr.Dataset,
    quaternion: Sequence[str] = ("quat_w", "quat_x", "quat_y", "quat_z"),
    *,
    axis: str | Sequence[float] = "z",
) -> xr.Dataset:
    """Add the director of each grain: an axis of its body, turned by its quaternion; lazy where the scene is.

    ``n = q a q*`` with q = (w, x, y, z) the rotation from the body's axes to the axes of space, as LAMMPS
    (``c_q[1]`` ... of ``compute property/atom quatw quati quatj quatk``) and MFiX write it. Take the longest axis of a
    prolate body, and the shortest of an oblate one.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with the four numbers as variables of the particles, such as
        ``xcg.open_scene(..., names={"c_q[1]": "quat_w", "c_q[2]": "quat_x", ...})``.
    quaternion : four names
        Of w, x, y and z.
    axis : str or three floats
        The axis in the body: "x", "y", "z", or a vector.

    Returns
    -------
    xarray.Dataset
        The scene with ``director`` (component), of length 1. If it holds angular velocities, ``body_angular_velocity``
        (component, 1/s) is added: their components along the axes of the body, so that its z is the spin about the
        body's z axis, and x and y are tumbling.

    Raises
    ------
    SceneError
        If a variable is missing.
    ValueError
        If there are not four names, or the axis is not a direction.

    Examples
    --------
    >>> import xcg
    >>> turned = {"quat_w": [0.5**0.5], "quat_x": [0.5**0.5], "quat_y": [0.0], "quat_z": [0.0]}  # a quarter about x
    >>> ds = xcg.scene_from_arrays([[0.0, 0.0, 0.0]], diameter=[1.0], **turned)
    >>> derive_director(ds).director.values.round(6)[0, 0].tolist()
    [0.0, -1.0, 0.0]
    """
    names = list(quaternion)
    if len(names) != 4:
        raise ValueError(f"quaternion={quaternion!r}: expected the names of four variables: w, x, y and z")
    require_scene(ds, names, "derive_director")
    a = np.eye(3)[COMPONENTS.index(axis)] if axis in COMPONENTS else unit_vector("axis", axis)
    w, x, y, z = (ds[name].drop_attrs() for name in names)
    size = w * w + x * x + y * y + z * z
    rows = (
        ((w * w + x * x - y * y - z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), (w * w - x * x + y * y - z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), (w * w - x * x - y * y + z * z)),
    )
    parts = [sum(entry * float(part) for entry, part in zip(row, a, strict=True)) / size for row in rows]
    found = {"director": _vector(parts).assign_attrs(units="1", long_name="director of the grain")}
    if "angular_velocity" in ds:
        omega = [ds.angular_velocity.sel(component=c, drop=True).drop_attrs() for c in COMPONENTS]
        along = [sum(rows[k][c] * omega[k] for k in range(3)) / size for c in range(3)]
        label = {"units": ds.angular_velocity.attrs.get("units", "s^-1"), "long_name": "angular velocity, body axes"}
        found["body_angular_velocity"] = _vector(along).assign_attrs(label)
    return ds.assign(found)


@takes_scene
def derive_superquadric(
    ds: xr.Dataset,
    half_axes: Sequence[str] = ("half_axis_x", "half_axis_y", "half_axis_z"),
    *,
    exponents: Sequence[str | float] | None = None,
    density: float | None = None,
) -> xr.Dataset:
    """Add volume, mass, diameter and moments of inertia of ellipsoids and superquadrics; lazy where the scene is.

    The surface is ``(|x/a|^n2 + |y/b|^n2)^(n1/n2) + |z/c|^n1 = 1`` in the axes of the body. With e1 = 2/n1, e2 = 2/n2
    and Euler's beta function B::

        V         = 2 a b c e1 e2 B(e1/2 + 1, e1) B(e2/2, e2/2)
        int x^2   = 1/2 a^3 b c e1 e2 B(3 e2/2, e2/2) B(e1/2, 2 e1 + 1)      (y^2 with b^3)
        int z^2   = 2 a b c^3 e1 e2 B(e2/2, e2/2 + 1) B(3 e1/2, e1 + 1)

    Source: Jaklic, Leonardis & Solina (2000), Segmentation and Recovery of Superquadrics, chapter 2.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with the half-axes (m) as variables of the particles.
    half_axes : three names
        Of a, b and c.
    exponents : two names or numbers, optional
        n1 and n2, by default ``exponent_1`` and ``exponent_2`` where the scene holds them, else 2. Ellipsoids have 2
        and 2, boxes with sharp edges infinitely large ones.
    density : float, optional
        Of the material (kg/m^3). Without it the scene's masses are kept, or else its densities.

    Returns
    -------
    xarray.Dataset
        The scene with ``volume`` (m^3), ``mass`` (kg), ``density``, ``diameter`` (m) of the sphere of equal volume,
        ``principal_inertia`` (component, kg m^2) about the body's axes, and their mean ``moment_of_inertia``, which the
        fields of rotation take: exact where the three are equal.

    Raises
    ------
    SceneError
        If a variable is missing, or the scene has neither mass nor density and none is given.
    ValueError
        If there are not three half-axes and two exponents, or a number is not positive.

    Examples
    --------
    >>> import xcg
    >>> shape = {"half_axis_x": [1.0], "half_axis_y": [1.0], "half_axis_z": [3.0]}
    >>> rod = derive_superquadric(xcg.scene_from_arrays([[0.0, 0.0, 0.0]], **shape), density=1.0)
    >>> rod.volume.values.round(6), rod.principal_inertia.values.round(6).tolist()
    (array([[12.566371]]), [[[25.132741, 25.132741, 5.026548]]])
    """
    axes = list(half_axes)
    powers = [n if n in ds else 2.0 for n in ("exponent_1", "exponent_2")] if exponents is None else list(exponents)
    named = [power for power in powers if isinstance(power, str)]
    valid = all(power in named or is_positive(power) for power in powers)
    if len(axes) != 3 or len(powers) != 2 or not valid:
        raise ValueError(f"{half_axes=}, {exponents=}: expected three names, and two names or positive numbers")
    if density is not None and not is_positive(density):
        raise ValueError(f"density={density!r}: expected a positive number (kg/m^3), or None")
    known = [] if density is not None else ["mass" if "mass" in ds else "density"]
    require_scene(ds, [*axes, *named, *known], "derive_superquadric")
    a, b, c = (ds[name].drop_attrs() for name in axes)
    n1, n2 = (ds[power].drop_attrs() if isinstance(power, str) else power for power in powers)
    volume, square_x, square_z = _moments(n1, n2)
    volume = volume * a * b * c
    new: dict[str, xr.DataArray] = {"volume": volume, "diameter": (6 / np.pi * volume) ** (1 / 3)}
    if density is None and "mass" in ds:
        new["mass"] = ds.mass.drop_attrs()
        new["density"] = new["mass"] / volume
    else:
        new["density"] = xr.full_like(volume, density) if density is not None else ds.density.drop_attrs()
        new["mass"] = new["density"] * volume
    per_volume = new["mass"] * (a * b * c) / volume
    squares = square_x * a**2, square_x * b**2, square_z * c**2
    inertia = [per_volume * (squares[(k + 1) % 3] + squares[(k + 2) % 3]) for k in range(3)]
    new["moment_of_inertia"] = (inertia[0] + inertia[1] + inertia[2]) / 3
    system = str(ds.attrs.get("unit_system", "SI"))
    for name, values in new.items():
        row = VARIABLES[name]
        new[name] = values.assign_attrs(units=units_in(row.units, system), long_name=row.long_name)
    label = {"units": units_in("kg m^2", system), "long_name": "moments of inertia about the axes of the body"}
    return ds.assign(new | {"principal_inertia": _vector(inertia).assign_attrs(label)})


def _vector(parts: Sequence[xr.DataArray]) -> xr.DataArray:
    """Return components x, y and z as one vector."""
    return xr.concat(parts, xr.Variable("component", list(COMPONENTS))).transpose(*parts[0].dims, "component")


def _moments(n1: Any, n2: Any) -> tuple[Any, Any, Any]:
    """Volume over abc, and the integrals of x^2 over a^3bc and of z^2 over abc^3, of superquadrics."""
    e1, e2 = 2.0 / n1, 2.0 / n2
    return (
        2 * e1 * e2 * beta(e1 / 2 + 1, e1) * beta(e2 / 2, e2 / 2),
        0.5 * e1 * e2 * beta(1.5 * e2, e2 / 2) * beta(e1 / 2, 2 * e1 + 1),
        2 * e1 * e2 * beta(e2 / 2, e2 / 2 + 1) * beta(1.5 * e1, e1 + 1),
    )
