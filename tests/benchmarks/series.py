"""Long series of synthetic files in real formats: what docs/scale.py and the tests of memory read.

A few packings are written in full; the other steps are hard links to them, so that a thousand steps of 100,000 grains
take no more room than four. Every step is still opened, read and parsed on its own.
"""

from __future__ import annotations

import base64
import gzip
import os
import zlib
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

import xcg
from tests.dumps import dump_text, pairs_text

PARTICLE_ARRAYS = {
    "Diameter": "diameter",
    "Velocity": "velocity",
    "Density": "density",
    "Mass": "mass",
    "Volume": "volume",
    "Particle_ID": "particle_id",
    "Particle_Phase_ID": "species",
}
CONTACT_ARRAYS = {
    "FORCE_CHAIN_GLOBAL_ID1": "contact_i",
    "FORCE_CHAIN_GLOBAL_ID2": "contact_j",
    "FORCE_CHAIN_FC": "contact_force",
}


def packings(particles: int, count: int) -> list[xr.Dataset]:
    """Packings of equal size with different numbers of contacts."""
    return [
        xcg.datasets.dense_packing(particles, seed=k, contacts=3.0 - 0.02 * k) for k in range(count)
    ]


def write_vtp_series(folder: Path, particles: int, steps: int, base: int = 4) -> dict[str, object]:
    """MFiX's binary regions: arguments for `xcg.open_scene`."""
    folder.mkdir(parents=True, exist_ok=True)
    scenes = packings(particles, min(base, steps))
    for kind, points, arrays in (
        ("P", "position", PARTICLE_ARRAYS),
        ("FC", "contact_point", CONTACT_ARRAYS),
    ):
        for k, ds in enumerate(scenes):
            write_vtp(folder / f"{kind}_base_{k}.vtp", ds, points, arrays)
        for t in range(steps):
            os.link(folder / f"{kind}_base_{t % len(scenes)}.vtp", folder / f"{kind}_{t:05d}.vtp")
    return _collected(folder, scenes[0], steps)


def write_distinct_vtp_series(folder: Path, particles: int, steps: int) -> dict[str, object]:
    """Write files of their own for each step: in step t velocities and forces are 1 + t / 100 times the first."""
    folder.mkdir(parents=True, exist_ok=True)
    (first,) = packings(particles, 1)
    for t in range(steps):
        growth = 1.0 + 0.01 * t
        ds = first.assign(
            velocity=first.velocity * growth, contact_force=first.contact_force * growth
        )
        write_vtp(folder / f"P_{t:05d}.vtp", ds, "position", PARTICLE_ARRAYS)
        write_vtp(folder / f"FC_{t:05d}.vtp", ds, "contact_point", CONTACT_ARRAYS)
    return _collected(folder, first, steps)


def _collected(folder: Path, ds: xr.Dataset, steps: int) -> dict[str, object]:
    """Write the collections of both kinds of files."""
    for kind in ("P", "FC"):
        entries = "".join(
            f'<DataSet timestep="{0.1 * t:.6f}" file="{kind}_{t:05d}.vtp"/>\n' for t in range(steps)
        )
        text = f'<VTKFile type="Collection" version="0.1"><Collection>\n{entries}</Collection></VTKFile>\n'
        (folder / f"{kind}.pvd").write_text(text)
    edges = ds.box.values[0]
    return {
        "particles": str(folder / "P.pvd"),
        "contacts": str(folder / "FC.pvd"),
        "box": {axis: tuple(edges[k]) for k, axis in enumerate("xyz")},
        "periodic": "xyz",
    }


def write_vtp(
    path: Path, ds: xr.Dataset, points: str, arrays: dict[str, str], encoding: str = "raw"
) -> Path:
    """One file as MFiX writes it ("raw"), or as VTK does: "base64", "zlib" (raw), "zlib base64"."""
    columns = {
        "coordinates": ds[points],
        **{name: ds[variable] for name, variable in arrays.items()},
    }
    order = ">" if encoding == "raw" else "<"
    blocks = [
        _block(a.to_numpy()[0].astype(f"{order}f4").tobytes(), order, encoding)
        for a in columns.values()
    ]
    offsets = np.cumsum([0, *map(len, blocks)])
    tags = [
        f'<DataArray type="Float32" Name="{name}" NumberOfComponents="{a[0].size // len(a[0])}" format="appended" '
        f'offset="{at}"/>'
        for (name, a), at in zip(columns.items(), offsets[:-1].tolist(), strict=True)
    ]
    compressor = ' compressor="vtkZLibDataCompressor"' if "zlib" in encoding else ""
    how = "base64" if "base64" in encoding else "raw"
    head = (
        f'<?xml version="1.0"?>\n<VTKFile type="PolyData" version="0.1" byte_order="'
        f'{"BigEndian" if order == ">" else "LittleEndian"}"{compressor}><PolyData>'
        f'<Piece NumberOfPoints="{len(columns["coordinates"][0])}" NumberOfVerts="0" NumberOfLines="0" '
        f'NumberOfStrips="0" NumberOfPolys="0">\n<Points>{tags[0]}</Points>\n<PointData>{"".join(tags[1:])}'
        f'</PointData>\n</Piece></PolyData>\n<AppendedData encoding="{how}">\n_'
    )
    path.write_bytes(head.encode() + b"".join(blocks) + b"\n</AppendedData></VTKFile>\n")
    return path


def _block(data: bytes, order: str, encoding: str) -> bytes:
    """One array with the header that its encoding wants."""
    if "zlib" not in encoding:
        whole = np.array([len(data)], f"{order}u4").tobytes() + data
        return base64.b64encode(whole) if encoding == "base64" else whole
    size = 1 << 15
    parts = [zlib.compress(data[at : at + size], 1) for at in range(0, len(data), size)]
    head = np.array([len(parts), size, len(data) % size, *map(len, parts)], f"{order}u4").tobytes()
    if encoding == "zlib":
        return head + b"".join(parts)
    return base64.b64encode(head) + base64.b64encode(b"".join(parts))


def dump_rows(ds: xr.Dataset) -> tuple[list[str], list[str]]:
    """Rows of LAMMPS dumps of one packing, with six digits: particles, and contacts with forces."""

    def lines(*parts: NDArray) -> list[str]:
        table = np.column_stack(parts)
        whole = [np.issubdtype(p.dtype, np.integer) for p in parts for _ in range(p[0].size)]
        form = " ".join("%d" if w else "%.6g" for w in whole)
        return [form % tuple(row) for row in table]

    one = ds.isel(time=0)
    get = {str(name): one[name].to_numpy() for name in ds.data_vars}
    particles = lines(
        get["particle_id"],
        get["species"],
        get["position"],
        get["velocity"],
        get["diameter"] / 2,
        get["mass"],
    )
    normal = 0.9 * get["contact_force"]
    return particles, lines(
        get["contact_i"], get["contact_j"], normal, get["contact_force"] - normal
    )


def dump_texts(ds: xr.Dataset, step: int) -> tuple[str, str]:
    """The same step as `dump custom` and `dump local` write it."""
    particles, contacts = dump_rows(ds)
    edges = ds.box.values[0]
    box = "ITEM: BOX BOUNDS pp pp pp\n" + "".join(
        f"{low:.10g} {high:.10g}\n" for low, high in edges
    )
    time = f"ITEM: TIME\n{0.1 * step:g}\n"
    return dump_text(particles, step=step, before=time, box=box), pairs_text(
        contacts, step=step, before=time, box=box
    )


def write_dumps(folder: str | Path, ds: xr.Dataset, step: int) -> None:
    """Write the two files of a step."""
    for kind, text in zip("pc", dump_texts(ds, step), strict=True):
        Path(folder, f"{kind}.{step}.dump").write_text(text)


def write_gzipped_dumps(folder: str | Path, particles: int, steps: int) -> dict[str, str]:
    """A series of one packing, a pair of gzipped files a step: arguments for `xcg.open_scene`."""
    (ds,) = packings(particles, 1)
    texts = dict(zip("pc", dump_texts(ds, 0), strict=True))
    for kind, text in texts.items():
        begin, rest = text.split("ITEM: TIMESTEP\n0\n")
        for step in range(steps):
            begins = begin.replace("ITEM: TIME\n0\n", f"ITEM: TIME\n{0.1 * step:g}\n")
            data = gzip.compress(f"{begins}ITEM: TIMESTEP\n{step}\n{rest}".encode(), 1)
            Path(folder, f"{kind}.{step}.dump.gz").write_bytes(data)
    return {"particles": f"{folder}/p.*.dump.gz", "contacts": f"{folder}/c.*.dump.gz"}


def fstat_text(ds: xr.Dataset) -> str:
    """The contacts of equal spheres in a step as MercuryDPM writes them, each from both sides, with 17 digits."""
    one = ds.isel(time=0)
    i = one["contact_i"].to_numpy()  # ids are rows
    j = one["contact_j"].to_numpy()
    force = one["contact_force"].to_numpy()
    point = one["contact_point"].to_numpy()
    arm = one["position"].to_numpy()[i] - point
    distance = np.linalg.norm(arm, axis=1, keepdims=True)
    normal = arm / distance
    pressing = (force * normal).sum(axis=1, keepdims=True)
    rest = force - pressing * normal
    sliding = np.linalg.norm(rest, axis=1, keepdims=True)
    tangent = rest / np.where(sliding > 0, sliding, 1)
    overlap = one["diameter"].to_numpy()[i, None] - 2 * distance
    nothing = np.zeros_like(distance)
    shared = [point, overlap, nothing, pressing, sliding]
    sides = [
        np.column_stack([i, j, *shared, normal, tangent]),
        np.column_stack([j, i, *shared, -normal, -tangent]),
    ]
    form = "0.01 %d %d " + " ".join(["%.17g"] * 13) + "\n"
    rows = np.stack(sides, axis=1).reshape(-1, sides[0].shape[1]).tolist()
    return "# 0.01 1\n# 0 0 0 4 4 2\n# 0.25 0.5 0 0 0 0\n" + "".join(
        [form % tuple(row) for row in rows]
    )
