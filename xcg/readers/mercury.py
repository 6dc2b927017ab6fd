"""MercuryDPM: ``.data`` (particles), ``.fstat`` (contacts) and the head of ``.restart`` (densities, gravity).

Particles are numbered by their row in ``.data``, from 0, as ``.fstat`` does. A pair stands in ``.fstat`` twice or
once; of two rows the one with i < j is read, the other has fewer digits.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from xcg.readers.engine import ReadOptions, StepRef
from xcg.readers.text import Scanner, first_lines, open_binary, parse_table, read_body, where
from xcg.scene import COMPONENTS, Frame, SceneError

OPTIONS = ("restart",)

_ROW_3D = ("x", "y", "z", "vx", "vy", "vz", "radius", "alpha", "beta", "gamma", "omx", "omy", "omz", "species")
_ROW_2D = ("x", "y", "vx", "vy", "radius", "alpha", "om", "species")
_CONTACT = ("t", "i", "j", "cx", "cy", "cz", "delta", "ctheta", "fn", "ft", "nx", "ny", "nz", "tx", "ty", "tz")
_EXTRA_HINT = "names= maps a column to another variable of particles, such as {'omx': 'spin_x'}"


def recognises(path: str) -> bool:
    """Tell ``.data`` by its header of 8 (2D: 6) numbers, ``.fstat`` by its three comment lines."""
    name = os.path.basename(path)
    lines = first_lines(path)
    if ".fstat" in name:
        return len(lines) > 2 and all(line.startswith("#") for line in lines[:3])
    return ".data" in name and bool(lines) and _numbers(lines[0]) is not None


# --- index -----------------------------------------------------------------------------------------------


def index_particles(paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
    """List the steps in ``.data`` files, numbered from 0 over all files."""
    refs = []
    for path in paths:
        restart = _read_restart(path, options)
        for ref in _data_steps(path):
            if restart is not None:
                ref = replace(ref, periodic=restart.periodic, gravity=restart.gravity)
            refs.append(ref)
    return [replace(ref, step=k) for k, ref in enumerate(refs)]


def _data_steps(path: str) -> Iterator[StepRef]:
    size = os.path.getsize(path)
    with open_binary(path) as stream:
        scanner = Scanner(stream)
        while line := scanner.line():
            if not line.strip():
                continue
            header = _numbers(line.decode("utf-8", "replace"))
            if header is None:
                msg = (
                    f"{path}: expected a header 'N t xmin ymin zmin xmax ymax zmax' (2D: without z) before byte "
                    f"{scanner.offset}, found {line[:60]!r}"
                )
                raise SceneError(msg)
            rows, time, *edges = header
            axes = len(edges) // 2
            start = scanner.offset
            for _ in range(int(rows)):
                scanner.line()
            yield StepRef(
                path,
                int(rows),
                time=time,
                box=tuple(
                    (edges[k], edges[axes + k]) if k < axes else (-np.inf, np.inf) for k in range(3)
                ),
                columns=_ROW_3D if axes == 3 else _ROW_2D,
                offset=start,
                length=scanner.offset - start,
                size=size,
            )


def _numbers(line: str) -> list[float] | None:
    try:
        values = [float(token) for token in line.split()]
    except ValueError:
        return None
    return values if len(values) in (6, 8) and values[0] >= 0 and values[0] == int(values[0]) else None


def index_contacts(paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
    """List the steps in ``.fstat`` files; as nothing tells their numbers of rows, ids are read for it."""
    refs: list[StepRef] = []
    for path in paths:
        size = os.path.getsize(path)
        with open_binary(path) as stream:
            scanner = Scanner(stream)
            while comments := [line for line in _comments(scanner)]:
                time = _time(comments, path)
                start = scanner.offset
                body = b"".join(scanner.until(b"#"))
                ref = StepRef(
                    path, 0, time, len(refs), columns=_CONTACT, offset=start, length=len(body), size=size
                )
                refs.append(replace(ref, rows=int(_kept(ref, body).sum())))
    return refs
