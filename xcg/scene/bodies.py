"""Bodies glued from spheres: one row a body instead of one row a sphere."""

from __future__ import annotations

from functools import partial

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.scene.conform import in_whole_rows, takes_scene
from xcg.scene.facts import SETUP
from xcg.scene.frame import indices_of, steps_in
from xcg.scene.lattice import Lattice
from xcg.scene.measure import measure
from xcg.scene.scene import Scene
from xcg.scene.schema import BOX, OF_STEP, units_in, variable

_SHARED = ("species", "frozen")  # by all spheres of a body
_PARTICLES = (
    "particle_id",
    "position",
    "velocity",
    "diameter",
    "density",
    "mass",
    "volume",
    *_SHARED,
)
_CONTACTS = (
    "contact_i",
    "contact_j",
    "contact_force",
    "contact_point",
    "contact_normal",
    "overlap",
)
# a partner that is not in the scene counts as a wall, and as none that has a name
_MISSING = -(2**31)


@takes_scene
def group_bodies(scene: Scene, by_body: str = "body_id") -> xr.Dataset:
    """Group component spheres into bodies, lazily where the scene is.

    A body has the mass and volume of its spheres together, their centre of mass (components joined
    across periodic edges), its velocity ``S m v / S m``, and the diameter of a sphere of its
    volume. Contacts then join bodies at the same points, with the same forces; contacts inside a
    body are dropped. Components that overlap count twice, unless their masses and volumes in the
    scene already allow for it. The spheres of a body are of one species, and all frozen or none.
    Variables that have no rule for bodies are left out, such as angular velocities.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with ``mass``.
    by_body : str
        An integer variable of the particles; spheres with a negative value are single bodies.

    Returns
    -------
    xarray.Dataset
        A scene whose particles are the bodies, sorted by id. Single spheres get ids above the
        bodies' ids. Sizes and extent of the bodies of a lazy scene are not known: call
        ``ds.cg.measure()``, which reads it, or give width and bounds.

    Raises
    ------
    SceneError
        If the scene lacks masses or the variable, the variable is not an integer, or the spheres of
        a body differ in ``species`` or ``frozen``.
    """
    scene.require(("mass", by_body), "group_bodies")
    ds = scene.ds
    if ds[by_body].dtype.kind not in "iu" or "particle" not in ds[by_body].dims:
        raise SceneError(
            f"by_body={by_body!r} holds {ds[by_body].dtype}: expected an integer variable of particles"
        )
    particles = [name for name in _PARTICLES if name in ds]
    contacts = [name for name in _CONTACTS if name in ds and "contact_i" in ds]
    outputs = [*particles, *contacts]
    if "volume" in ds and "diameter" not in ds:
        outputs.append("diameter")
    inputs = {name: ds[name] for name in (*particles, *contacts, *OF_STEP) if name in ds}
    inputs["body"] = ds[by_body]
    core = {name: [d for d in array.dims if d != "time"] for name, array in inputs.items()}
    whole = [in_whole_rows(array) for array in inputs.values()]
    setup = scene.setup
    arrays = xr.apply_ufunc(
        partial(_over_time, names=list(inputs), outputs=outputs, periodic=setup.periodic),
        *whole,
        input_core_dims=list(core.values()),
        output_core_dims=[list(variable(name).dims) for name in outputs],
        dask="parallelized",
        output_dtypes=[np.dtype(variable(name).dtype) for name in outputs],
    )
    data = {name: ds[name] for name in BOX if name in ds}
    for name, array in zip(outputs, arrays, strict=True):
        row = variable(name)
        data[name] = array.assign_attrs(
            units=units_in(row.units, setup.unit_system), long_name=row.long_name
        )
    attrs = {name: value for name, value in ds.attrs.items() if not str(name).endswith("_values")}
    line = f"xcg: group_bodies({by_body!r})"
    attrs["history"] = f"{attrs.get('history', '')}\n{line}".lstrip("\n")
    coords = {n: ds[n] for n in ("time", "step", "component", SETUP) if n in ds.coords}
    grouped = xr.Dataset(data, coords, attrs)
    if grouped.chunks:
        return grouped
    return measure(grouped)


def _over_time(
    *arrays: NDArray, names: list[str], outputs: list[str], periodic: str
) -> tuple[NDArray, ...]:
    inputs = dict(zip(names, arrays, strict=True))
    lengths = {
        variable(name).dims[0]: inputs[name].shape[1]
        for name in ("particle_id", "contact_i")
        if name in inputs
    }
    out = {}
    for name in outputs:
        kind = variable(name)
        shape = kind.shape(lengths[kind.dims[0]])
        out[name] = np.full((len(arrays[0]), *shape), kind.fill, kind.dtype)
    for t, (frame, lattice, source) in enumerate(steps_in(inputs, periodic)):
        bodies, body_of_sphere = _bodies(frame, lattice, f"group_bodies, {source}")
        if "contact_i" in frame:
            for side in ("contact_i", "contact_j"):
                index = indices_of(frame["particle_id"], frame[side])
                body = np.where(frame[side] < 0, frame[side], _MISSING)
                is_particle = index >= 0
                body[is_particle] = body_of_sphere[index[is_particle]]
                frame[side] = body
            outside = frame["contact_i"] != frame["contact_j"]
            bodies |= {name: frame[name][outside] for name in _CONTACTS if name in frame}
        for name in outputs:
            out[name][t, : len(bodies[name])] = bodies[name]
    return tuple(out.values())


def _bodies(
    frame: dict[str, NDArray], lattice: Lattice, source: str
) -> tuple[dict[str, NDArray], NDArray]:
    """Bodies of one frame, and the body's id of each sphere."""
    ids = frame["particle_id"]
    body = frame["body"]
    identity = np.where(body < 0, body.max(initial=-1) + 1 + ids, body)
    body_ids, first, group = np.unique(identity, return_index=True, return_inverse=True)
    mass = frame["mass"]

    def total(values: NDArray) -> NDArray:
        out = np.zeros((len(body_ids), *values.shape[1:]))
        np.add.at(out, group, values)
        return out

    bodies = {"particle_id": body_ids, "mass": total(mass)}
    anchor = frame["position"][first]
    apart = frame["position"] - anchor[group]
    offset = lattice.shortest(apart)
    bodies["position"] = anchor + total(mass[:, None] * offset) / bodies["mass"][:, None]
    if "velocity" in frame:
        velocity = frame["velocity"] + lattice.drift(offset - apart)
        bodies["velocity"] = total(mass[:, None] * velocity) / bodies["mass"][:, None]
    if "volume" in frame:
        bodies["volume"] = total(frame["volume"])
        bodies["density"] = bodies["mass"] / bodies["volume"]
        bodies["diameter"] = np.cbrt(6 / np.pi * bodies["volume"])
    bodies = {
        name: frame[name][first] for name in ("density", "diameter", *_SHARED) if name in frame
    } | bodies
    for name in _SHARED:
        if name in frame:
            differ = frame[name] != bodies[name][group]
            if differ.any():
                index = differ.argmax()
                leader = first[group[index]]
                raise SceneError(
                    f"{source}: spheres {ids[leader]} and {ids[index]} are of one body ({identity[leader]}) and differ "
                    f"in {name} ({frame[name][leader]}, {frame[name][index]}): give single spheres a negative body, or "
                    f"leave the variable out: ds.drop_vars({name!r})"
                )
    return bodies, identity
