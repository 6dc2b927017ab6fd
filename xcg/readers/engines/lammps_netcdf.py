"""LAMMPS dumps in NetCDF (``dump netcdf``, ``dump netcdf/mpiio``), in the conventions of AMBER.

``time`` counts steps, and its ``scale_factor`` is the time between two of them. Lengths of the box are 0 along axes
that are not periodic. Rows of atoms that were lost hold the fill value as their id.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.readers.engine import StepRef
from xcg.readers.files.classic_netcdf import ClassicFile
from xcg.readers.files.classic_netcdf import begins as begins
from xcg.readers.files.text import source_of
from xcg.scene.schema import COMPONENTS

# names of vectors, and those of their components in dumps of text
_VECTORS = {
    "coordinates": "{}",
    "unwrapped_coordinates": "{}u",
    "scaled_coordinates": "{}s",
    "velocities": "v{}",
    "forces": "f{}",
    "mu": "mu{}",
}
_UNITS = {"meter": "si", "centimeter": "cgs", "micrometers": "micro", "nanometers": "nano", "lj": "lj"}
_LOST = -(2**31) + 1  # the fill value of ids


def steps_of(path: str) -> Iterator[StepRef]:
    """List the steps of a file from its header and its times and boxes.

    Raises
    ------
    SceneError
        If the file is of another format, or damaged.
    """
    file = ClassicFile(path)
    needed = {"time": (), "cell_origin": (3,), "cell_lengths": (3,), "cell_angles": (3,)}
    names = tuple(_places(file))
    lacking = [name for name, shape in needed.items()
               if name not in file.variables or not file.variables[name].recorded
               or file.variables[name].shape != shape]  # fmt: skip
    lacking += [] if names else ["columns of atoms"]
    if lacking:
        file.refuse(f"lacks {', '.join(lacking)}, and was not written by 'dump netcdf'")
    scale = np.asarray(file.variables["time"].attrs.get("scale_factor", np.nan), float).ravel()
    length = file.variables["cell_lengths"].attrs.get("units")
    for k in range(file.records):
        number = float(file.read("time", k))
        if not (math.isfinite(number) and abs(number) < 2**63):
            file.refuse(f"has the time {number} in record {k}, and is damaged")
        time = number * float(scale[0]) if len(scale) == 1 and np.isfinite(scale[0]) else None
        yield StepRef(
            path, file.dims["atom"], time=time, step=round(number), columns=names, offset=k,
            units=_UNITS.get(str(length), str(length)) if length else None, **_box(file, k),
        )  # fmt: skip


def _box(file: ClassicFile, record: int) -> dict[str, Any]:
    """Edges, tilt and periodic axes of a step."""
    low, lengths, angles = (file.read(f"cell_{what}", record).astype(float) for what in ("origin", "lengths", "angles"))
    if not np.isfinite([low, lengths, angles]).all() or (lengths < 0).any() or (np.abs(angles - 90) >= 90).any():
        file.refuse(f"has a box of lengths {lengths} and angles {angles} in record {record}, and is damaged")
    periodic = lengths > 0
    told = {"periodic": "".join(a for a, there in zip(COMPONENTS, periodic, strict=True) if there)}
    if (np.abs(angles - 90) < 1e-4).all():  # angles in single precision
        high = [a + b if b else math.inf for a, b in zip(low, lengths, strict=True)]
        edges = [(a if b else -math.inf, c) for a, b, c in zip(low.tolist(), lengths, high, strict=True)]
        return told | {"box": tuple(edges)}
    if not periodic.all():
        file.refuse("has a tilted box that is not periodic along all axes, whose tilts are not told; dump text")
    alpha, beta, gamma = np.cos(np.radians(angles))
    a, b, c = lengths
    xy, xz = b * gamma, c * beta
    y = math.sqrt(max(b**2 - xy**2, 0.0))
    yz = (b * c * alpha - xy * xz) / y
    z = math.sqrt(max(c**2 - xz**2 - yz**2, 0.0))
    edges = [(float(start), float(start + size)) for start, size in zip(low, (a, y, z), strict=True)]
    lattice = ((float(a), 0.0, 0.0), (float(xy), float(y), 0.0), (float(xz), float(yz), float(z)))
    return told | {"box": tuple(edges), "lattice": lattice}


def _places(file: ClassicFile) -> dict[str, tuple[str, int | None]]:
    """Variable and component of each column, named as in dumps of text."""
    found: dict[str, tuple[str, int | None]] = {}
    for name, variable in file.variables.items():
        of_atoms = variable.recorded and variable.dims[:2] == ("frame", "atom") and variable.dtype.kind != "S"
        if not of_atoms or len(variable.dims) > 3:
            continue
        if len(variable.dims) == 2:
            found[name] = (name, None)
        elif name in _VECTORS and variable.shape[1] == len(COMPONENTS):
            found |= {_VECTORS[name].format(axis): (name, k) for k, axis in enumerate(COMPONENTS)}
        else:
            found |= {f"{name}[{k + 1}]": (name, k) for k in range(min(variable.shape[1], 100))}
    return found


def read_columns(ref: StepRef, wanted: Iterable[str]) -> dict[str, NDArray]:
    """Read columns of one step, without atoms that were lost."""
    file = ClassicFile(ref.path)
    places = _places(file)
    if tuple(places) != ref.columns or ref.offset >= file.records:
        raise SceneError(f"{source_of(ref)}: the file changed after the scene was opened; open it again")
    arrays = {
        name: file.read(name, ref.offset) for name in {places[column][0] for column in wanted} | {"id"} & {*places}
    }
    there = arrays["id"] != _LOST if "id" in arrays else slice(None)
    return {
        column: np.asarray(arrays[name] if k is None else arrays[name][:, k])[there].astype("f8")
        for column, (name, k) in places.items()
        if column in wanted
    }
