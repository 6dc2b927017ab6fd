"""Time of everyday jobs beside short scripts and OVITO: a profile or a map from a dump, once, in a new process.

Run from the root of the repository, on a machine that does nothing else::

    python -m docs.everyday [--repeats 5] [--only one] [--write]

Every program is a process of its own, and the programs take turns. `--write` puts the table into docs/accuracy.md.
OVITO takes part where it is installed (``pip install ovito``). Optional packages that xarray and
pandas load with them, such as pint and pyarrow, make imports slower: leave them out.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from docs.accuracy import machine
from docs.marks import write_between

SOLID = 0.6  # volume fraction of the data
HEADER = (
    "ITEM: TIMESTEP\n{step}\nITEM: NUMBER OF ATOMS\n{count}\nITEM: BOX BOUNDS pp pp ff\n"
    "0 {edge}\n0 {edge}\n0 {edge}\nITEM: ATOMS id type x y z vx vy vz radius mass\n"
)
TIMED = """
import json, re, time
begin = time.perf_counter()
{imports}
loaded = time.perf_counter()
{job}
end = time.perf_counter()
print(json.dumps({{
    "imports": loaded - begin,
    "job": end - loaded,
    "memory": int(re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read())[1]) / 1024,
    "check": float(check),
}}))
"""

# --- the programs ----------------------------------------------------------------------------------------
#
# `check` is a number that all programs of a row find: a mean of the velocity along x, weighted by mass.

IMPORT_XCG = "import xcg, dask.array, xcg.fields.coarse_grain, xcg.readers.open"
XCG_PROFILE = """
ds = xcg.open_scene({files}, units="reduced")
f = ds.cg.coarse_grain(["velocity", "density"], axes="z").compute()
rho, v = f.density, f.velocity.sel(component="x")
check = (rho * v).sum() / rho.sum()
"""
SCRIPT_IMPORTS = "import glob, io, itertools\nimport numpy as np, pandas as pd"
SCRIPT_PROFILE = """
momentum, mass = np.zeros(60), np.zeros(60)
for path in sorted(glob.glob({files})):
    with open(path) as file:
        header = list(itertools.islice(file, 9))
    t = pd.read_csv(path, sep=" ", skiprows=9, names=header[8].split()[2:])
    edges = np.linspace(*map(float, header[7].split()), 61)
    momentum += np.histogram(t.z, edges, weights=t.mass * t.vx)[0]
    mass += np.histogram(t.z, edges, weights=t.mass)[0]
velocity, check = momentum / mass, momentum.sum() / mass.sum()
"""
SCRIPT_STEPS = """
momentum, mass = np.zeros(60), np.zeros(60)
for path in sorted(glob.glob({files})):
    with open(path) as file:
        while header := list(itertools.islice(file, 9)):
            names, rows = header[8].split()[2:], int(header[3])
            body = io.StringIO("".join(itertools.islice(file, rows)))
            t = pd.read_csv(body, sep=" ", names=names)
            edges = np.linspace(*map(float, header[7].split()), 61)
            momentum += np.histogram(t.z, edges, weights=t.mass * t.vx)[0]
            mass += np.histogram(t.z, edges, weights=t.mass)[0]
velocity, check = momentum / mass, momentum.sum() / mass.sum()
"""
OVITO_IMPORTS = (
    "from ovito.io import import_file\nfrom ovito.modifiers import SpatialBinningModifier"
)
OVITO_PROFILE = """
pipeline = import_file({files}, multiple_frames=True)
pipeline.modifiers.append(SpatialBinningModifier(
    property="Velocity.X", direction=SpatialBinningModifier.Direction.Z, bin_count=60,
    reduction_operation=SpatialBinningModifier.Operation.Mean))
means = []
for frame in range(pipeline.source.num_frames):
    data = pipeline.compute(frame)
    means.append(data.tables["binning"].y[...].mean())
check = sum(means) / len(means)
"""
XCG_MAP = """
ds = xcg.open_scene({files}, units="reduced")
edge = float(ds.box.isel(time=0, component=0, bound=1))
f = ds.cg.coarse_grain(["velocity", "density"], spacing=edge / 60).compute()
rho, v = f.density, f.velocity.sel(component="x")
check = (rho * v).sum() / rho.sum()
"""
SCRIPT_MAP = """
with open({files}) as file:
    header = list(itertools.islice(file, 9))
    t = pd.read_csv(file, sep=" ", names=header[8].split()[2:], nrows=int(header[3]), engine="c")
edges = [np.linspace(*map(float, line.split()), 61) for line in header[5:8]]
mass = np.histogramdd(t[["x", "y", "z"]].to_numpy(), edges, weights=t.mass)[0]
momentum = np.histogramdd(t[["x", "y", "z"]].to_numpy(), edges, weights=t.mass * t.vx)[0]
check = momentum.sum() / mass.sum()
"""
OVITO_MAP = """
pipeline = import_file({files})
pipeline.modifiers.append(SpatialBinningModifier(
    property="Velocity.X", direction=SpatialBinningModifier.Direction.XYZ, bin_count=(60, 60, 60),
    reduction_operation=SpatialBinningModifier.Operation.Mean))
check = pipeline.compute().grids["binning"]["Velocity.X"][...].mean()
"""
SCRIPT_CSV = """
t = pd.read_csv({files})
edges = np.linspace(0.0, t.z.max(), 61)
momentum = np.histogram(t.z, edges, weights=t.mass * t.vx)[0]
mass = np.histogram(t.z, edges, weights=t.mass)[0]
check = momentum.sum() / mass.sum()
"""

PYVISTA_IMPORTS = "import glob\nimport numpy as np, pyvista"
PYVISTA_PROFILE = """
momentum, mass = np.zeros(60), np.zeros(60)
for path in sorted(glob.glob({files})):
    grains = pyvista.read(path)
    z, m, v = grains.points[:, 2], grains["Mass"], grains["Velocity"][:, 0]
    edges = np.linspace(0.0, z.max(), 61)
    momentum += np.histogram(z, edges, weights=m * v)[0]
    mass += np.histogram(z, edges, weights=m)[0]
check = momentum.sum() / mass.sum()
"""
EDGE = float((500_000 / SOLID * np.pi / 6) ** (1 / 3))  # files of no dump hold no box
XCG_BOX = XCG_PROFILE.replace('"reduced"', f'"reduced", box=[[0.0, {EDGE}]] * 3, periodic="xy"')
XCG_VTP = XCG_BOX.replace(" periodic", " times=[0.0, 1.0], periodic")
XCG_MOVIE = """
ds = xcg.open_scene({files}, units="reduced")
f = ds.cg.coarse_grain(["velocity", "density"], axes="xz")
f.cg.movie({files} + ".gif", "velocity")
check = 0.0
"""
SCRIPT_MOVIE_IMPORTS = (
    SCRIPT_IMPORTS
    + "\nimport matplotlib; matplotlib.use('agg')\nfrom matplotlib import animation, pyplot"
)
SCRIPT_MOVIE = """
frames = []
with open({files}) as file:
    while header := list(itertools.islice(file, 9)):
        body = io.StringIO("".join(itertools.islice(file, int(header[3]))))
        t = pd.read_csv(body, sep=" ", names=header[8].split()[2:])
        edges = [np.linspace(*map(float, header[k].split()), 41) for k in (5, 7)]
        momentum = np.histogram2d(t.x, t.z, edges, weights=t.mass * t.vx)[0]
        frames.append(momentum / np.histogram2d(t.x, t.z, edges, weights=t.mass)[0])
figure, axes = pyplot.subplots()
image = axes.imshow(frames[0].T, origin="lower")
movie = animation.FuncAnimation(figure, lambda k: image.set_data(frames[k].T), len(frames))
movie.save({files} + ".gif")
check = 0.0
"""


@dataclass(frozen=True)
class Row:
    """Job of the table: its data, and what each program does with them (imports and job)."""

    title: str
    make: Callable[[Path], str]
    programs: dict[str, tuple[str, str]]


def grains(count: int, seed: int) -> tuple[pd.DataFrame, float]:
    """Return grains at random, and the edge of their cube."""
    rng = np.random.default_rng(seed)
    edge = float((count / SOLID * np.pi / 6) ** (1 / 3))
    diameter = rng.uniform(0.9, 1.1, count)
    table = pd.DataFrame({"id": rng.permutation(count) + 1, "type": rng.integers(1, 3, count)})
    place = pd.DataFrame(rng.random((count, 3)) * edge, columns=list("xyz"))
    velocity = pd.DataFrame(rng.normal(1.0, 1.0, (count, 3)), columns=["vx", "vy", "vz"])
    size = pd.DataFrame({"radius": diameter / 2, "mass": np.pi / 6 * diameter**3})
    return pd.concat([table, place, velocity, size], axis=1), edge


def dumps(name: str, count: int, steps: int, files: int = 1) -> Callable[[Path], str]:
    """Return a function that writes text dumps into a folder, and returns their glob."""

    def write(folder: Path) -> str:
        for number in range(files):
            with open(folder / f"{name}.{number}.dump", "w") as file:
                for step in range(steps):
                    table, edge = grains(count, number * steps + step)
                    time = 1000 * (number * steps + step)
                    file.write(HEADER.format(step=time, count=count, edge=edge))
                    table.to_csv(file, sep=" ", header=False, index=False, float_format="%.6g")
        return str(folder / f"{name}.{'*' if files > 1 else 0}.dump")

    return write


def csv(folder: Path) -> str:
    """Write a table of 500,000 grains."""
    table, _ = grains(500_000, 0)
    table.to_csv(folder / "grains.csv", index=False, float_format="%.6g")
    return str(folder / "grains.csv")


def vtp(folder: Path) -> str:
    """Write two steps of 500,000 grains as PolyData."""
    import pyvista

    for step in range(2):
        table, _ = grains(500_000, step)
        points = pyvista.PolyData(table[["x", "y", "z"]].to_numpy())
        points["Velocity"] = table[["vx", "vy", "vz"]].to_numpy()
        points["Mass"], points["Diameter"] = table.mass.to_numpy(), 2 * table.radius.to_numpy()
        points["Particle_ID"] = table.id.to_numpy()
        points.save(folder / f"grains_{step}.vtp")
    return str(folder / "grains_*.vtp")


PROFILES = {
    "xcg": (IMPORT_XCG, XCG_PROFILE),
    "script": (SCRIPT_IMPORTS, SCRIPT_PROFILE),
    "OVITO": (OVITO_IMPORTS, OVITO_PROFILE),
}
ROWS = (
    Row("profile, one step of 5e5 grains", dumps("half", 500_000, 1), PROFILES),
    Row("profile, one step of 1e6 grains", dumps("one", 1_000_000, 1), PROFILES),
    Row("profile, three files of 1e6 grains", dumps("three", 1_000_000, 1, 3), PROFILES),
    Row(
        "profile, 40 steps of 2e4 grains in one file",
        dumps("forty", 20_000, 40),
        PROFILES | {"script": (SCRIPT_IMPORTS, SCRIPT_STEPS)},
    ),
    Row(
        "profile, two .vtp files of 5e5 grains",
        vtp,
        {"xcg": (IMPORT_XCG, XCG_VTP), "script": (PYVISTA_IMPORTS, PYVISTA_PROFILE)},
    ),
    Row(
        "profile, a CSV of 5e5 grains",
        csv,
        {"xcg": (IMPORT_XCG, XCG_BOX), "script": (SCRIPT_IMPORTS, SCRIPT_CSV)},
    ),
    Row(
        "map of 60^3, one step of 5e5 grains",
        dumps("map", 500_000, 1),
        {
            "xcg": (IMPORT_XCG, XCG_MAP),
            "script": (SCRIPT_IMPORTS, SCRIPT_MAP),
            "OVITO": (OVITO_IMPORTS, OVITO_MAP),
        },
    ),
    Row(
        "movie of 100 frames of 1e4 grains",
        dumps("movie", 10_000, 100),
        {"xcg": (IMPORT_XCG, XCG_MOVIE), "script": (SCRIPT_MOVIE_IMPORTS, SCRIPT_MOVIE)},
    ),
)


def run(imports: str, job: str, files: str) -> dict[str, float]:
    """Run a program in a new process, and return what it measured."""
    code = TIMED.format(imports=imports, job=job.format(files=repr(files)))
    environment = os.environ | {"MPLBACKEND": "agg"}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # an installed package has its bytecode
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code],
        capture_output=True,
        text=True,
        check=False,
        env=environment,
    )
    if done.returncode:
        raise RuntimeError(done.stderr[-2000:])
    return json.loads(done.stdout.splitlines()[-1])


def measure(row: Row, repeats: int) -> dict[str, list[dict[str, float]]]:
    """Run the programs of a row in turns."""
    programs = dict(row.programs)
    if importlib.util.find_spec("ovito") is None:
        programs.pop("OVITO", None)
    with tempfile.TemporaryDirectory() as folder:
        files = row.make(Path(folder))
        for program in programs.values():  # compiles, and reads the files once
            run(*program, files)
        measured: dict[str, list[dict[str, float]]] = {name: [] for name in programs}
        for _ in range(repeats):
            for name, program in programs.items():
                measured[name].append(run(*program, files))
    return measured


def text_of(row: Row, measured: dict[str, list[dict[str, float]]]) -> str:
    """Return the rows of the table for one job."""
    lines = []
    script = measured["script"]
    for name, runs in measured.items():
        whole = [one["imports"] + one["job"] for one in runs]
        jobs = [one["job"] for one in runs]
        of_process = min(whole) / min(one["imports"] + one["job"] for one in script)
        of_job = min(jobs) / min(one["job"] for one in script)
        memory = max(one["memory"] for one in runs)
        lines.append(
            f"| {row.title} | {name} | {min(whole):.2f} to {max(whole):.2f} | {of_process:.2f} "
            f"| {min(jobs):.2f} to {max(jobs):.2f} | {of_job:.2f} | {memory:.0f} |"
        )
    return "\n".join(lines)


INTRO = """## Everyday jobs

A profile of velocity and density, or a map, once, in a new process, after everything was compiled: xcg beside a script
of ten lines (pandas or pyvista, and `np.histogram`) and OVITO's `SpatialBinningModifier`. *Process* is the time from
the first import to the result (s), *job* the same without imports, *ratio* that of the least times to the script's,
memory the peak of the process (MB). A histogram counts grains in bins: it has no kernel, so its values jump where
grains cross edges, no stress and no error bars; OVITO averages by grain, not by mass. Made, on {machine}, by
`python -m docs.everyday --repeats {repeats} --write`; ranges are over the repeats.

| job | program | process (s) | ratio | job (s) | ratio | memory (MB) |
|---|---|---|---|---|---|---|
"""


def main() -> None:
    """Measure, print, and write the table if that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--only", default="", help="rows with this word in their title")
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    table = []
    for row in ROWS:
        if options.only in row.title:
            table.append(text_of(row, measure(row, options.repeats)))
            print(table[-1], flush=True)
    if options.write:
        head = INTRO.format(machine=machine(), repeats=options.repeats)
        write_between("accuracy.md", "everyday", head + "\n".join(table))


if __name__ == "__main__":
    main()
