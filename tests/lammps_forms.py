"""Dumps of LAMMPS that are no text, written by the layouts that it documents."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import netCDF4
import numpy as np
from numpy.typing import NDArray

from xcg.readers.engine import ReadOptions
from xcg.readers.engines.lammps import Lammps

COLUMNS = ("id", "type", "x", "y", "z", "vx", "vy", "vz", "radius", "mass")
BOX = ((0.0, 10.0), (0.0, 10.0), (-1.0, 9.0))


def rows_of(count: int = 3, seed: int = 0) -> NDArray:
    """Rows of `COLUMNS`."""
    rng = np.random.default_rng(seed)
    rows = rng.uniform(0.2, 0.8, (count, len(COLUMNS)))
    rows[:, 0], rows[:, 1] = rng.permutation(count) + 1, 1
    return rows


def binary_step(
    rows: NDArray, columns: Sequence[str] = COLUMNS, *, step: int = 0, time: float | None = None, units: str = "si",
    order: str = "<", parts: int = 1, tilts: Sequence[float] = (), word: bytes = b"DUMPCUSTOM",
) -> bytes:  # fmt: skip
    """One step of a binary dump, in as many blocks as there were processes."""
    names = " ".join(columns).encode()
    head = struct.pack(f"{order}q", -len(word)) + word
    head += struct.pack(f"{order}iiqqi6i", 1, 2, step, len(rows), bool(tilts), 0, 0, 0, 0, 1, 1)
    head += struct.pack(f"{order}{6 + len(tilts)}d", *np.ravel(BOX), *tilts)
    head += struct.pack(f"{order}ii", len(columns), len(units)) + units.encode()
    head += struct.pack(f"{order}?", time is not None) + (
        b"" if time is None else struct.pack(f"{order}d", time)
    )
    head += struct.pack(f"{order}i", len(names)) + names + struct.pack(f"{order}i", parts)
    blocks = np.array_split(rows, parts)
    return head + b"".join(
        struct.pack(f"{order}i", block.size) + block.astype(f"{order}f8").tobytes()
        for block in blocks
    )


def write_netcdf(
    path: Path, steps: dict[int, NDArray], *, timestep: float | None = 0.5, double: bool = True, version: str = "DATA",
    lengths: Sequence[float] = (10, 10, 0), angles: Sequence[float] = (90, 90, 90), extra: NDArray | None = None,
) -> Path:  # fmt: skip
    """Write `dump netcdf`: rows of `COLUMNS` of each step; rows of NaN are atoms that were lost."""
    real = "f8" if double else "f4"
    with netCDF4.Dataset(path, "w", format="NETCDF3_64BIT_" + version) as file:
        file.set_auto_mask(False)
        sizes = {
            "frame": None,
            "atom": len(next(iter(steps.values()))),
            "cell_spatial": 3,
            "cell_angular": 3,
        }
        for name, size in (sizes | {"label": 10, "spatial": 3, "vec2": 2}).items():
            file.createDimension(name, size)
        file.createVariable("spatial", "S1", ("spatial",))[:] = list("xyz")
        time = file.createVariable("time", real, ("frame",))
        time.units = "second"
        if timestep is not None:
            time.scale_factor = np.float32(timestep)
        time.set_auto_maskandscale(False)
        for what in ("origin", "lengths", "angles"):
            dims = ("frame", "cell_angular" if what == "angles" else "cell_spatial")
            file.createVariable(f"cell_{what}", real, dims)
        file["cell_lengths"].units = "meter"
        for name in ("id", "type"):
            file.createVariable(name, "i4", ("frame", "atom"))
        for name in ("coordinates", "velocities"):
            file.createVariable(name, real, ("frame", "atom", "spatial"))
        for name in ("radius", "mass"):
            file.createVariable(name, real, ("frame", "atom"))
        if extra is not None:
            file.createVariable("c_own", real, ("frame", "atom", "vec2"))
        file.setncatts({"Conventions": "AMBER", "ConventionVersion": "1.0", "program": "LAMMPS"})
        for k, (step, rows) in enumerate(steps.items()):
            there = ~np.isnan(rows[:, 0])
            time[k] = step
            file["cell_origin"][k], file["cell_lengths"][k], file["cell_angles"][k] = (
                (0, 0, -1),
                lengths,
                angles,
            )
            for name, at in (("id", 0), ("type", 1), ("radius", 8), ("mass", 9)):
                file[name][k, : there.sum()] = rows[there, at]
            file["coordinates"][k, : there.sum()] = rows[there, 2:5]
            file["velocities"][k, : there.sum()] = rows[there, 5:8]
            if extra is not None:
                file["c_own"][k] = extra
    return path


lammps = Lammps()


DEFAULTS = ReadOptions()


def frames_of(path):
    refs = lammps.index_particles([str(path)], DEFAULTS)
    return refs, [lammps.read_particles(ref, DEFAULTS) for ref in refs]


def check(frame, rows):
    np.testing.assert_array_equal(frame["particle_id"], rows[:, 0])
    np.testing.assert_array_equal(frame["position"], rows[:, 2:5])
    np.testing.assert_array_equal(frame["velocity"], rows[:, 5:8])
    np.testing.assert_array_equal(frame["diameter"], 2 * rows[:, 8])
    np.testing.assert_array_equal(frame["mass"], rows[:, 9])
