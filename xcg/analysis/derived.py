"""Variables derived from others: directors from quaternions, volumes from half-axes, velocities from positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.checks import POSITIVE, axis_vector, check
from xcg.common.messages import SceneError
from xcg.scene.box import BoxMotion
from xcg.scene.complete import superquadric_integrals
from xcg.scene.conform import takes_scene
from xcg.scene.frame import indices_of
from xcg.scene.scene import Scene
from xcg.scene.schema import COMPONENTS, MOTION, VARIABLES, Variable, units_in
from xcg.scene.times import require_times
from xcg.steps.analysis import FrameAnalysis, Step, run


@takes_scene
def derive_director(
    scene: Scene,
    *,
    axis: str | Sequence[float] = "z",
) -> xr.Dataset:
    """Add the director of each grain: an axis of its body, turned by its quaternion; lazy where the scene is.

    ``n = q a q*`` with q = (w, x, y, z) the rotation from the body's axes to the axes of space, as
    LAMMPS (``c_q[1]`` ... of ``compute property/atom quatw quati quatj quatk``) and MFiX write it.
    Take the longest axis of a prolate body, and the shortest of an oblate one.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with the four numbers as the variables ``quat_w``, ``quat_x``, ``quat_y`` and
        ``quat_z``, such as ``xcg.open_scene(..., names={"c_q[1]": "quat_w", ...})``.
    axis : str or three floats
        The axis in the body: "x", "y", "z", or a vector.

    Returns
    -------
    xarray.Dataset
        The scene with ``director`` (component), of length 1. If it holds angular velocities,
        ``body_angular_velocity`` (component, 1/s) is added: their components along the axes of the
        body, so that its z is the spin about the body's z axis, and x and y are tumbling.

    Raises
    ------
    SceneError
        If a variable is missing.
    ValueError
        If the axis is not a direction.

    Examples
    --------
    >>> import xcg
    >>> turned = {"quat_w": [0.5**0.5], "quat_x": [0.5**0.5], "quat_y": [0.0], "quat_z": [0.0]}  # a quarter about x
    >>> ds = xcg.scene_from_arrays([[0.0, 0.0, 0.0]], diameter=[1.0], **turned)
    >>> derive_director(ds).director.values.round(6)[0, 0].tolist()
    [0.0, -1.0, 0.0]
    """
    names = [f"quat_{part}" for part in "wxyz"]
    scene.require(names, "derive_director")
    ds = scene.ds
    a = axis_vector("axis", axis)
    w, x, y, z = (ds[name].drop_attrs(deep=False) for name in names)
    size = w * w + x * x + y * y + z * z
    rotation = (
        ((w * w + x * x - y * y - z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), (w * w - x * x + y * y - z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), (w * w - x * x - y * y + z * z)),
    )
    parts = [
        sum(entry * float(part) for entry, part in zip(line, a, strict=True)) / size
        for line in rotation
    ]
    director = _vector(parts).assign_attrs(units="1", long_name="director of the grain")
    ds = ds.assign(director=director)
    if "angular_velocity" not in ds:
        return ds
    spin = ds["angular_velocity"]
    omega = [spin.sel(component=c, drop=True).drop_attrs(deep=False) for c in COMPONENTS]
    along = [sum(rotation[k][c] * omega[k] for k in range(3)) / size for c in range(3)]
    about = {"units": spin.attrs.get("units", "s^-1"), "long_name": "angular velocity, body axes"}
    return ds.assign(body_angular_velocity=_vector(along).assign_attrs(about))


@takes_scene
def derive_superquadric(
    scene: Scene,
    *,
    density: float | None = None,
) -> xr.Dataset:
    """Add volume, mass, diameter and moments of inertia of ellipsoids and superquadrics; lazy where the scene is.

    The surface is ``(|x/a|^n2 + |y/b|^n2)^(n1/n2) + |z/c|^n1 = 1`` in the axes of the body. With e1 = 2/n1, e2 = 2/n2
    and Euler's beta function B::

        V         = 2 a b c e1 e2 B(e1/2 + 1, e1) B(e2/2, e2/2)
        int x^2   = 1/2 a^3 b c e1 e2 B(3 e2/2, e2/2) B(e1/2, 2 e1 + 1)      (y^2 with b^3)
        int z^2   = 2 a b c^3 e1 e2 B(e2/2, e2/2 + 1) B(3 e1/2, e1 + 1)

    Source: Jaklic, Leonardis & Solina (2000), Segmentation and Recovery of Superquadrics, chapter
    2.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with a, b and c as the variables ``half_axis_x``, ``half_axis_y`` and
        ``half_axis_z`` (m), and with n1 and n2 as ``exponent_1`` and ``exponent_2``, without which
        they are 2. Ellipsoids have 2 and 2, boxes with sharp edges large ones, such as 1e6.
    density : float, optional
        Of the material (kg/m^3). Without it the scene's masses are kept, or else its densities.

    Returns
    -------
    xarray.Dataset
        The scene with ``volume`` (m^3), ``mass`` (kg), ``density``, ``diameter`` (m) of the sphere
        of equal volume, ``principal_inertia`` (component, kg m^2) about the body's axes, and their
        mean ``moment_of_inertia``, which the fields of rotation take: exact where the three are
        equal.

    Raises
    ------
    SceneError
        If a variable is missing, or the scene has neither mass nor density and none is given.
    ValueError
        If `density` is not positive.

    Examples
    --------
    >>> import xcg
    >>> shape = {"half_axis_x": [1.0], "half_axis_y": [1.0], "half_axis_z": [3.0]}
    >>> rod = derive_superquadric(xcg.scene_from_arrays([[0.0, 0.0, 0.0]], **shape), density=1.0)
    >>> rod.volume.values.round(6), rod.principal_inertia.values.round(6).tolist()
    (array([[12.566371]]), [[[25.132741, 25.132741, 5.026548]]])
    """
    ds = scene.ds
    axes = [f"half_axis_{axis}" for axis in COMPONENTS]
    check("density", density, POSITIVE, "kg/m^3", optional=True)
    keeps_mass = density is None and "mass" in ds
    required = [*axes]
    if density is None and not keeps_mass:
        required.append("density")
    scene.require(required, "derive_superquadric")
    exponents = [name for name in ("exponent_1", "exponent_2") if name in ds]
    variables = {name: ds[name].drop_attrs(deep=False) for name in (*required, *exponents)}
    a, b, c = (variables[name] for name in axes)
    n1 = variables.get("exponent_1", 2.0)
    n2 = variables.get("exponent_2", 2.0)
    volume, square_x, square_z = superquadric_integrals(n1, n2)
    volume = volume * a * b * c
    new: dict[str, xr.DataArray] = {"volume": volume, "diameter": (6 / np.pi * volume) ** (1 / 3)}
    if keeps_mass:
        new["mass"] = ds.mass.drop_attrs(deep=False)
        new["density"] = new["mass"] / volume
    else:
        if density is None:
            new["density"] = variables["density"]
        else:
            new["density"] = xr.full_like(volume, density)
        new["mass"] = new["density"] * volume
    per_volume = new["mass"] * (a * b * c) / volume
    squares = square_x * a**2, square_x * b**2, square_z * c**2
    inertia = [per_volume * (squares[(k + 1) % 3] + squares[(k + 2) % 3]) for k in range(3)]
    new["moment_of_inertia"] = (inertia[0] + inertia[1] + inertia[2]) / 3
    system = scene.setup.unit_system
    for name, values in new.items():
        row = VARIABLES[name]
        new[name] = values.assign_attrs(units=units_in(row.units, system), long_name=row.long_name)
    new["principal_inertia"] = _vector(inertia).assign_attrs(
        units=units_in("kg m^2", system), long_name="moments of inertia about the axes of the body"
    )
    return ds.assign(new)


def _vector(parts: Sequence[xr.DataArray]) -> xr.DataArray:
    """Return components x, y and z as one vector."""
    return xr.concat(parts, xr.Variable("component", list(COMPONENTS))).transpose(
        *parts[0].dims, "component"
    )


_NAME = "derive('velocity')"

# --- velocities from positions ---------------------------------------------------------------------------


def derive_velocity(ds: xr.Dataset) -> xr.Dataset:
    """Add velocities from positions by differences in time; see `xcg.derive`."""
    scene = Scene(ds)
    scene.require((), _NAME)
    scene.require_ids(_NAME)
    count = ds.sizes["time"]
    if count < 2:
        raise SceneError("derive('velocity') needs two steps or more, and this scene has one")
    require_times(ds, _NAME)
    # displacements are relative to the box of each step, whose rates they do not need
    series = ds.drop_vars("lattice_velocity", errors="ignore")
    made = run(Scene(series), _Velocity())
    return ds.assign(velocity=made["velocity"].variable).assign_attrs(history=made.attrs["history"])


@dataclass(frozen=True)
class _Velocity(FrameAnalysis):
    """Velocity of each particle from its positions in the steps before and after."""

    name = _NAME
    optional = MOTION

    @property
    def lags(self) -> tuple[int, ...]:
        """Return the offsets of the step before and the step after."""
        return (-1, 1)

    def reads(self, scene: Scene) -> list[str]:
        """Return positions and times."""
        return ["position", "time"]

    def rows(self, scene: Scene) -> dict[str, Variable]:
        """Return the velocity."""
        return {"velocity": VARIABLES["velocity"]}

    def frames(self, now: Step, *others: Step | None) -> dict[str, NDArray]:
        """Compute velocities (n, 3), NaN for particles that are in neither of the other steps."""
        frame, lattice, source = now
        position = frame["position"]
        total = np.zeros_like(position)
        time = np.zeros(len(position))
        for other in others:
            if other is None:  # before the first step, or after the last
                continue
            other_frame, other_lattice, _ = other
            index = indices_of(other_frame["particle_id"], frame["particle_id"])
            stays = np.flatnonzero(index >= 0)
            motion = BoxMotion.between(lattice, other_lattice)
            moved = motion.relative(frame, other_frame, stays, index[stays])
            motion.warn_of_jumps(moved, frame, lattice, source, "velocities")
            moved += motion.shift + position[stays] @ motion.gradient.T
            apart = float(other_frame["time"] - frame["time"])
            total[stays] += np.sign(apart) * moved
            time[stays] += abs(apart)
        with np.errstate(invalid="ignore", divide="ignore"):
            return {"velocity": total / time[:, None]}
