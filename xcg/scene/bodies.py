"""Bodies glued from spheres: one row a body instead of one row a sphere."""

from __future__ import annotations

from functools import partial

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.scene.conform import require_scene, takes_scene
from xcg.scene.description import describe
from xcg.scene.frame import particle_rows
from xcg.scene.lattice import Lattice
from xcg.scene.sanity import rows_of
from xcg.scene.schema import BOX, PADDING, units_in, variable
from xcg.scene.sizes import measure

_SHARED = ("species", "frozen")  # by all spheres of a body
_PARTICLES = ("particle_id", "position", "velocity", "diameter", "density", "mass", "volume", *_SHARED)
_CONTACTS = ("contact_i", "contact_j", "contact_force", "contact_point", "contact_normal", "overlap")
_MISSING = -(2**31)  # a partner that is not in the scene counts as a wall, and as none that has a name


@takes_scene
def group_bodies(ds: xr.Dataset, by_body: str = "body_id") -> xr.Dataset:
    """Group component spheres into bodies, lazily where the scene is.

    A body has the mass and volume of its spheres together, their centre of mass (components joined across periodic
    edges), its velocity ``S m v / S m``, and the diameter of a sphere of its volume. Contacts then join bodies at
    the same points, with the same forces; contacts inside a body are dropped. Components that overlap count twice,
    unless their masses and volumes in the scene already allow for it. The spheres of a body are of one species, and all
    frozen or none. Variables that have no rule for bodies are left out, such as angular velocities.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with ``mass``.
    by_body : str
        An integer variable of the particles; spheres with a negative value are single bodies.

    Returns
    -------
    xarray.Dataset
        A scene whose particles are the bodies, sorted by id. Single spheres get ids above the bodies' ids.
        Sizes and extent of the bodies of a lazy scene are not known: call ``ds.cg.measure()``, which reads it, or
        give width and bounds.

    Raises
    ------
    SceneError
        If the scene lacks masses or the variable, the variable is not an integer, or the spheres of a body differ in
        ``species`` or ``frozen``.
    """
    require_scene(ds, ("mass", by_body), "group_bodies")
    if ds[by_body].dtype.kind not in "iu" or "particle" not in ds[by_body].dims:
        raise SceneError(f"by_body={by_body!r} holds {ds[by_body].dtype}: expected an integer variable of particles")
    particles = [name for name in _PARTICLES if name in ds]
    contacts = [name for name in _CONTACTS if name in ds and "contact_i" in ds]
    made = [*particles, *(name for name in ("volume", "diameter") if name not in particles and "volume" in ds)]
    inputs, dims = [], []
    box = [name for name in BOX if name in ds]
    for name in [*particles, by_body, *contacts, *box]:
        core = [d for d in ds[name].dims if d != "time"]
        whole = ds[name].chunk(dict.fromkeys(core, -1)) if ds[name].chunks is not None else ds[name]
        inputs.append(whole)
        dims.append([str(d) for d in core])
    setup = describe(ds).setup
    names = [*particles, "body", *contacts, *box]
    outputs = [*made, *contacts]
    out_dims = [list(variable(name).dims) for name in outputs]
    arrays = xr.apply_ufunc(
        partial(_over_time, names=names, made=made, contacts=contacts, periodic=setup.periodic), *inputs,
        input_core_dims=dims, output_core_dims=out_dims, dask="parallelized",
        output_dtypes=[np.dtype(variable(name).dtype) for name in outputs],
    )  # fmt: skip
    data = {}
    for name, array in zip(outputs, arrays if len(outputs) > 1 else [arrays], strict=True):
        row = variable(name)
        data[name] = array.assign_attrs(units=units_in(row.units, setup.unit_system), long_name=row.long_name)
    data |= {name: ds[name] for name in BOX if name in ds}
    line = f"xcg: group_bodies({by_body!r})"
    attrs = {name: value for name, value in ds.attrs.items() if not str(name).endswith("_values")}
    attrs["history"] = f"{attrs['history']}\n{line}" if "history" in attrs else line
    grouped = xr.Dataset(data, {n: ds[n] for n in ("time", "step", "component") if n in ds.coords}, attrs)
    return measure(grouped) if grouped.chunks == {} else grouped


def _over_time(
    *arrays: NDArray, names: list[str], made: list[str], contacts: list[str], periodic: str
) -> tuple[NDArray, ...]:
    outer = arrays[0].shape[:-1]
    given = dict(zip(names, arrays, strict=True))
    rows = int(arrays[0].shape[-1])
    lengths: dict[str, int] = dict.fromkeys(made, rows)
    if contacts:
        lengths |= dict.fromkeys(contacts, int(given["contact_i"].shape[-1]))
    out = {
        name: np.full((*outer, *variable(name).shape(n)), variable(name).fill, variable(name).dtype)
        for name, n in lengths.items()
    }
    for at in np.ndindex(outer):
        valid = particle_rows(given["particle_id"][at])
        frame = {name: given[name][at][valid] for name in names if name not in {*contacts, *BOX}}
        box = {name: given[name][at] for name in BOX if name in given}
        source = f"group_bodies, frame {at[0]} of its chunk" if at else "group_bodies"
        bodies, id_of_row = _bodies(frame, Lattice.of(box, periodic, source), source)
        for name in made:
            out[name][at][: len(bodies["particle_id"])] = bodies[name]
        if contacts:
            kept = given["contact_i"][at] != PADDING
            pairs = {name: given[name][at][kept] for name in contacts}
            for side in ("contact_i", "contact_j"):
                row = rows_of(frame["particle_id"], pairs[side])
                there = np.where(pairs[side] < 0, pairs[side], _MISSING)
                pairs[side] = np.where(row >= 0, id_of_row[row], there) if len(id_of_row) else there
            outside = pairs["contact_i"] != pairs["contact_j"]
            for name in contacts:
                out[name][at][: outside.sum()] = pairs[name][outside]
    return tuple(out.values())


def _bodies(frame: dict[str, NDArray], lattice: Lattice, source: str) -> tuple[dict[str, NDArray], NDArray]:
    """Bodies of one frame, and the body's id of each sphere."""
    ids, body = frame["particle_id"], frame["body"]
    own = body < 0
    identity = np.where(own, body.max(initial=-1) + 1 + ids, body)
    found, first, group = np.unique(identity, return_index=True, return_inverse=True)
    mass = frame["mass"]

    def total(values: NDArray) -> NDArray:
        out = np.zeros((len(found), *values.shape[1:]))
        np.add.at(out, group, values)
        return out

    bodies = {"particle_id": found, "mass": total(mass)}
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
    for name in ("density", "diameter"):
        if name in frame and name not in bodies:
            bodies[name] = frame[name][first]
    for name in _SHARED:
        if name in frame:
            bodies[name] = frame[name][first]
            differ = frame[name] != bodies[name][group]
            if differ.any():
                other = differ.argmax()
                one = first[group[other]]
                raise SceneError(
                    f"{source}: spheres {ids[one]} and {ids[other]} are of one body ({identity[one]}) and differ in "
                    f"{name} ({frame[name][one]}, {frame[name][other]}): give single spheres a negative body, or "
                    f"leave the variable out: ds.drop_vars({name!r})"
                )
    return bodies, identity
