"""The jobs whose speed and memory are watched: the same for pytest-benchmark and for docs/speed.py.

The scene is a dense packing (`xcg.datasets.dense_packing`): volume fraction 0.6, three contacts a grain, w = 0.75 d,
nodes w apart, all fields unless it says otherwise. Threads share the nodes of one step in memory, or take a step
each, one chunk of time, of a lazy scene.
"""

from __future__ import annotations

import atexit
import math
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import xarray as xr

import xcg
from tests import ROOT
from tests.benchmarks.series import write_vtp_series

WIDTH = "0.75 d43"


@dataclass(frozen=True)
class Case:
    """One job: `work(scene)` on `steps` packings of `share` times the grains asked for."""

    name: str
    work: Callable[[xr.Dataset], xr.Dataset | None]
    threads: int = 1
    steps: int = 1
    share: float = 1.0

    def scene(self, particles: int) -> xr.Dataset:
        return packing(round(self.share * particles), self.steps)

    def run(self, ds: xr.Dataset) -> xr.Dataset | None:
        with ExitStack() as few:
            for name, module in list(sys.modules.items()):
                if name.startswith("xcg.") and "THREADS" in vars(
                    module
                ):  # whatever another commit calls it
                    few.enter_context(mock.patch.object(module, "THREADS", self.threads))
            return self.work(ds)

    @property
    def over(self) -> str:
        return "" if self.threads == 1 else " over space" if self.steps == 1 else " over time"


@cache
def packing(particles: int, steps: int = 1) -> xr.Dataset:
    one = xcg.datasets.dense_packing(particles)
    if steps == 1:
        return one
    times = [one.assign_coords(time=[float(t)], step=("time", [t])) for t in range(steps)]
    return xr.concat(times, "time", combine_attrs="override").chunk(time=1)


def fields(
    ds: xr.Dataset, names: list[str] | None = None, rtol: float = 0.0, refined: float = 1
) -> xr.Dataset:
    """Fields in memory; a lazy scene is computed by as many threads as it has steps."""
    spacing = 0.75 * ds.attrs["d43"] / refined
    f = ds.cg.coarse_grain(names, width=WIDTH, spacing=spacing, rtol=rtol)
    return f.compute(scheduler="threads", num_workers=ds.sizes["time"])


def at_points(ds: xr.Dataset, shuffled: bool = False) -> xr.Dataset:
    """All fields at the nodes of a mesh, given as points."""
    at = nodes_as_points(ds.sizes["particle"], shuffled)
    return ds.cg.coarse_grain(width=WIDTH, at=at, rtol=1e-3)


@cache
def nodes_as_points(particles: int, shuffled: bool) -> dict[str, xr.DataArray]:
    """Nodes of a mesh around the packing, ten for each grain, in its order or in any."""
    ds = packing(particles)
    mesh = ds.chunk().cg.coarse_grain(
        "density", width=WIDTH, spacing=0.75 * ds.attrs["d43"] / TEN_NODES
    )
    order = (
        np.random.default_rng(0).permutation(math.prod(mesh.density.shape))
        if shuffled
        else slice(None)
    )
    columns = np.meshgrid(*(mesh[a].to_numpy() for a in "xyz"), indexing="ij")
    return {
        a: xr.DataArray(x.ravel()[order], dims="point") for a, x in zip("xyz", columns, strict=True)
    }


def end_to_end(ds: xr.Dataset) -> None:
    """A pair of MFiX's binary files to all fields, as NetCDF and VTKHDF."""
    anew = mock.patch.dict(os.environ, XCG_INDEX_CACHE="0")  # headers are not remembered
    with tempfile.TemporaryDirectory() as folder, anew:
        f = fields(xcg.open_scene(**pair(ds.sizes["particle"])))
        f.to_netcdf(Path(folder) / "fields.nc")
        f.cg.save(Path(folder) / "fields.vtkhdf")


def parse(ds: xr.Dataset) -> xr.Dataset:
    """A pair of LAMMPS' dumps to a scene in memory."""
    with mock.patch.dict(os.environ, XCG_INDEX_CACHE="0"):
        return xcg.open_scene(**dumps(ds.sizes["particle"])).compute(scheduler="synchronous")


@cache
def dumps(particles: int) -> dict[str, str]:
    """Arguments for `xcg.open_scene` of the packing as text, which another process writes: it takes much memory."""
    folder = temporary_folder()
    fresh(DUMPS, folder, str(particles))
    return {"particles": f"{folder}/p.0.dump", "contacts": f"{folder}/c.0.dump"}


@cache
def pair(particles: int) -> dict[str, Any]:
    """Arguments for `xcg.open_scene` of the packing as files, which are there as long as the process."""
    return write_vtp_series(Path(temporary_folder()) / "pair", particles, 1)


def temporary_folder() -> str:
    """A new folder, which goes when the process ends."""
    folder = tempfile.mkdtemp()
    atexit.register(shutil.rmtree, folder)
    return folder


SUMS = ["volume_fraction", "contact_stress"]
TEN_NODES = 1.7  # w over the spacing at which the packing has ten nodes for each grain
CASES = [
    Case("all fields, rtol = 1e-3", partial(fields, rtol=1e-3)),
    Case("all fields, rtol = 1e-3", partial(fields, rtol=1e-3), threads=2),
    Case("all fields, rtol = 1e-3", partial(fields, rtol=1e-3), threads=2, steps=2),
    Case("all fields, closed form", fields),
    Case("all fields, closed form", fields, threads=2),
    Case("all fields, closed form", fields, threads=2, steps=2),
    Case("volume fraction alone", partial(fields, names=["volume_fraction"])),
    Case("contact stress alone", partial(fields, names=["contact_stress"])),
    Case("from a pair of .vtp to NetCDF and VTKHDF", end_to_end),
    Case("from a pair of .vtp to NetCDF and VTKHDF", end_to_end, threads=2),
    Case("a pair of dumps of LAMMPS to a scene in memory", parse),
    Case("a pair of dumps of LAMMPS to a scene in memory", parse, threads=2),
    Case("volume fraction and contact stress, spacing w", partial(fields, names=SUMS), share=0.1),
    Case(
        "volume fraction and contact stress, spacing w/2",
        partial(fields, names=SUMS, refined=2),
        share=0.1,
    ),
    Case(
        "volume fraction and contact stress, spacing w/4",
        partial(fields, names=SUMS, refined=4),
        share=0.1,
    ),
    Case(
        "all fields, rtol = 1e-3, ten nodes a grain", partial(fields, rtol=1e-3, refined=TEN_NODES)
    ),
    Case("all fields, rtol = 1e-3, ten nodes a grain as points", at_points),
    Case(
        "all fields, rtol = 1e-3, ten nodes a grain as points in random order",
        partial(at_points, shuffled=True),
    ),
]
# those worth a million grains; all fields on one thread take 2 to 6 s, by where the system has its pages from
LARGE = [CASES[1], CASES[6], CASES[10], CASES[11]]


# --- in a fresh process ----------------------------------------------------------------------------------

FIRST = """
import sys, time
import numpy as np
import xcg
with np.load(sys.argv[1]) as arrays:
    xcg.scene_from_arrays(density=2500.0, periodic="xyz", **arrays).cg.coarse_grain()
print(time.time())
"""
LIBRARIES = """
import time
import dask.array, numba, xarray
numba.core.registry.cpu_target.target_context.refresh()  # as the first loop that is loaded does
print(time.time())
"""
GIVEN = (
    "position",
    "diameter",
    "velocity",
    "contact_i",
    "contact_j",
    "contact_force",
    "contact_point",
    "box",
)
# the high-water mark of this process alone: that of getrusage starts from the parent's
RESIDENT = """
for line in open("/proc/self/status"):
    if line.startswith("VmHWM"):
        print(line.split()[1])
"""
SMALL_STEPS = """
import sys, time
import dask, xcg
from tests.benchmarks.series import write_gzipped_dumps
folder, particles, steps, threads = sys.argv[1], *map(int, sys.argv[2:])
ds = xcg.open_scene(**write_gzipped_dumps(folder, particles, steps), density=2500.0)
with dask.config.set(scheduler="threads", num_workers=threads):
    for name, part in (("first", ds.isel(time=[0])), ("all", ds)):
        begin = time.perf_counter()
        part.cg.coarse_grain().cg.save(f"{folder}/{name}.zarr")
print(time.perf_counter() - begin)
"""
DUMPS = """
import sys
from tests.benchmarks.series import packings, write_dumps
write_dumps(sys.argv[1], packings(int(sys.argv[2]), 1)[0], 0)
"""
PEAK = """
import sys
import xarray as xr
from tests.benchmarks import cases
case = cases.CASES[int(sys.argv[2])]
case.run(xr.load_dataset(sys.argv[1]) if case.steps == 1 else xr.open_dataset(sys.argv[1], chunks={"time": 1}))
"""


def fresh(code: str, *arguments: str, **environment: str) -> str:
    """What a Python process of its own prints."""
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    # modules are compiled once, as they are where nobody says otherwise
    environment = {**os.environ, "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "", **environment}
    command = [sys.executable, "-c", code, *arguments]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return done.stdout


def first_result() -> tuple[float, float]:
    """Seconds from the start of a process to all fields of 1000 grains, from arrays: with nothing compiled, and later.

    Later is the least of four. The end of the process, which Python takes half a second for, is not in it.
    """
    took = []
    with tempfile.TemporaryDirectory() as folder:
        arrays = str(Path(folder) / "arrays.npz")
        np.savez(arrays, **{name: packing(1000)[name].values[0] for name in GIVEN})
        for _ in range(5):
            begin = time.time()
            took.append(float(fresh(FIRST, arrays, NUMBA_CACHE_DIR=folder)) - begin)
    return took[0], min(took[1:])


def libraries() -> float:
    """Seconds from the start of a process until the libraries of a first result are loaded; the least of four."""
    took = []
    for _ in range(4):
        begin = time.time()
        took.append(float(fresh(LIBRARIES)) - begin)
    return min(took)


def small_steps(particles: int, steps: int, threads: int) -> float:
    """Seconds a step of a series of gzipped dumps to a Zarr folder of all fields, after a first step."""
    with tempfile.TemporaryDirectory() as folder:
        return (
            float(
                fresh(
                    SMALL_STEPS, folder, *map(str, (particles, steps, threads)), XCG_INDEX_CACHE="0"
                )
            )
            / steps
        )


def peak_memory(case: Case, particles: int) -> float:
    """Largest resident memory of a process that reads the scene from a file and does the job (MB); on Linux only."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.nc"
        case.scene(particles).to_netcdf(path)
        return int(fresh(PEAK + RESIDENT, str(path), str(CASES.index(case)))) / 1000
