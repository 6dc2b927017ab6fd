"""Directors of grains that are not round, from the quaternions that codes write."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

from xcg.common.checks import unit_vector
from xcg.scene.conform import takes_scene
from xcg.scene.description import require_scene
from xcg.scene.schema import COMPONENTS

_QUATERNION = ("quat_w", "quat_x", "quat_y", "quat_z")


@takes_scene
def derive_director(
    ds: xr.Dataset,
    quaternion: Sequence[str] = ("quat_w", "quat_x", "quat_y", "quat_z"),
    *,
    axis: str | Sequence[float] = "z",
) -> xr.Dataset:
    """Add the director of each grain: an axis of its body, turned by its quaternion; lazy where the scene is.

    ``n = q a q*`` with q = (w, x, y, z) the rotation from the body's axes to those of space, as LAMMPS
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
        The scene with ``director`` (component), of length 1.

    Raises
    ------
    SceneError
        If a variable is missing.
    ValueError
        If there are not four names, or the axis is none.

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
    director = xr.concat(parts, xr.Variable("component", list(COMPONENTS)))
    director = director.transpose(*w.dims, "component").assign_attrs(units="1", long_name="director of the grain")
    return ds.assign(director=director)
