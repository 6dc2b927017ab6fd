"""Files and jobs of one packing for other programs, and their fields and times beside those of xcg.

Run from the root of the repository, with the commands of docs/side_by_side.md between the two::

    python -m docs.side_by_side write side [--particles 10000]
    python -m docs.side_by_side compare side

Each program computes with one thread, and its job writes its fields and its least time into the folder.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import h5py
import numpy as np
import xarray as xr
from numpy.typing import NDArray

import xcg
from docs.accuracy import machine
from docs.marks import write_between
from tests.benchmarks.series import (
    CONTACT_ARRAYS,
    PARTICLE_ARRAYS,
    dump_texts,
    fstat_text,
    write_vtp,
)

REPEATS = 5
NODES = 60  # of profiles
WIDTH = 0.75  # diameters
GAUSSIAN = xcg.Gaussian(WIDTH, dimension=1)  # that of `fstatistics` along one axis
POINTS = 12  # along each axis, of PyCoarseGraining, which looks at all pairs of points and grains

PYSAMMOS = """\
import json, time
from pysammos.coarse_graining import CoarseGraining
from pysammos.utils.config_loader import load_config

cfg = load_config("config.ini")
cg = CoarseGraining(
    particle_path=cfg["particles_path"], contacts_path=cfg["contacts_path"],
    output_path=cfg["output_path"], start_timestep=cfg["t0"], end_timestep=cfg["tf"],
    dt_time_step=cfg["dt"], DEM_keymap=cfg["key_mapping"], grid_info=cfg["grid_info"],
    weight_function=cfg["smoothing_function"], fields_to_export=cfg["fields_to_export"],
    ignore_phases=cfg["partialignore"], vkthdf_output=cfg["vkthdf_output"], h5_output=cfg["h5_output"],
)
_, diameter, density, mass, ids = cg.data_sampling()
cg.get_particle_size_statistics(diameter, mass)
cg.get_particle_phases(diameter, density, ids, 8)
cg.set_resolution(cg.d43)
cg.generate_grid()
seconds = []
for _ in range(6):  # the first one compiles
    begin = time.perf_counter()
    cg.fields_in_time()
    seconds.append(time.perf_counter() - begin)
json.dump({"least": min(seconds[1:])}, open("times.json", "w"))
"""
CONFIG = """\
[paths]
particles_path = ./P_
contacts_path = ./FC_
output_path = ./PysammosCG/

[timesteps]
t0 = 1
tf = 1
dt = 1

[smoothing_function]
type = Lucy

[flags]
partialignore = True

[key_mapping]
Global_ID = Particle_ID
Particle_Velocity = Velocity
Particle_Diameter = Diameter
Particle_Density = Density
Particle_Volume = Volume
Particle_Mass = Mass
Particle_Radius = None
Coordination_Number = None
Particle_i_ID = FORCE_CHAIN_GLOBAL_ID1
Particle_j_ID = FORCE_CHAIN_GLOBAL_ID2
Force_ij = FORCE_CHAIN_FC
Contact_ij = None

[grid_info]
grid_dimension = 3
grid_axes = xyz
automatic_grid = False
x_min = {low[0]}
x_max = {high[0]}
y_min = {low[1]}
y_max = {high[1]}
z_min = {low[2]}
z_max = {high[2]}
x_transect = None
y_transect = None
z_transect = None
x_axis_periodic = False
y_axis_periodic = False
z_axis_periodic = False

[fields_to_export]
volume_fraction = True
density_mixture = True
density_particle = False
momentum_density = True
velocity = True
velocity_gradient = False
kinetic_tensor = True
contact_tensor = True
total_stress_tensor = False
shear_rate_tensor = False
pressure = False
granular_temperature = False
granular_temperature_slices = False
fabric_tensor = False
inertial_number = False
frictional_coefficient = False
coordination_number = False
d43 = False
d32 = False

[output_options]
vkthdf_output = False
h5_output = True
"""
PYCG = """\
import json, time
import numpy as np
import CGfunctions as cg

data = np.load("packing.npz")
points, position, mass, velocity = (data[name] for name in ("points", "position", "mass", "velocity"))
width = float(data["width"])
seconds = []
for _ in range(6):  # the first one compiles
    begin = time.perf_counter()
    pairs, weight = cg.Compute_CG_visibility_weight(points, position, 2 * width, width, "Lucy")
    density = cg.Compute_CG_scalar(pairs, weight, mass, len(points))
    momentum = cg.Compute_CG_vector(pairs, weight, velocity * mass[:, None], len(points))
    seconds.append(time.perf_counter() - begin)
json.dump({"least": min(seconds[1:])}, open("times.json", "w"))
np.savez("fields.npz", density=density[:, 0], momentum=momentum)
"""
PROGRAM = """\
import json, subprocess, sys, time

seconds = []
for _ in range(5):
    begin = time.perf_counter()
    subprocess.run([sys.argv[1], *{arguments}], check=True, capture_output=True)
    seconds.append(time.perf_counter() - begin)
json.dump({{"least": min(seconds)}}, open("times.json", "w"))
"""
FSTATISTICS = [
    "packing",
    "-stattype",
    "Z",
    "-CGtype",
    "Gaussian",
    "-w",
    str(WIDTH),
    "-n",
    str(NODES),
]
RESTART = """\
restart_version 1.0 name packing
dataFile    fileType ONE_FILE saveCount 1 counter 0 nextSavedTimeStep 0
fStatFile   fileType ONE_FILE saveCount 1 counter 0 nextSavedTimeStep 0
eneFile     fileType ONE_FILE saveCount 1 counter 0 nextSavedTimeStep 0
restartFile fileType ONE_FILE saveCount 1 counter 0 nextSavedTimeStep 0
statFile    fileType ONE_FILE saveCount 1 counter 0 nextSavedTimeStep 0
xMin {low[0]} xMax {high[0]} yMin {low[1]} yMax {high[1]} zMin {low[2]} zMax {high[2]}
timeStep 0.01 time 0 ntimeSteps 0 timeMax 0.02
systemDimensions 3 particleDimensions 3 gravity 0 0 -1
Species 1
LinearViscoelasticSpecies id 0 density {density} stiffness 1000.0 dissipation 0
Walls 0
Boundaries 0
Particles 1
BaseParticle id 0 indSpecies 0 position 0 0 0 orientation 0 0 0 0 velocity 0 0 0 \
angularVelocity 0 0 0 0 force 0 0 0 torque 0 0 0 radius 0.5 invMass 1
Interactions 0
"""
LAMMPS = """\
units        lj
atom_style   sphere
boundary     p p p
region       box block {box}
create_box   2 box
pair_style   zero 1.0
pair_coeff   * *
variable     every equal 1
compute      bins all chunk/atom bin/1d z {low[2]} {size} bound z {low[2]} {high[2]}
fix          profile all ave/chunk 1 1 1 bins density/mass vx vy vz file profile.txt
thermo       1
rerun        p.0.dump dump x y z vx vy vz add yes replace no purge yes
"""


def packing(particles: int) -> xr.Dataset:
    """Return a packing without periodic axes, in units of the diameter and the density."""
    return xcg.datasets.dense_packing(particles, periodic="")


def write(folder: Path, particles: int) -> None:
    """Write the packing and the job of each program."""
    ds = packing(particles)
    low, high = ds.box.values[0].T.tolist()
    one = {str(name): values.to_numpy()[0] for name, values in ds.data_vars.items()}
    for name in ("pysammos", "pycoarsegraining", "mercury", "lammps"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    (folder / "particles.txt").write_text(str(particles))

    at = folder / "pysammos"
    write_vtp(at / "P_0001.vtp", ds, "position", PARTICLE_ARRAYS)
    write_vtp(at / "FC_0001.vtp", ds, "contact_point", CONTACT_ARRAYS)
    (at / "config.ini").write_text(CONFIG.format(low=low, high=high))
    (at / "job.py").write_text(PYSAMMOS)

    at = folder / "pycoarsegraining"
    (at / "job.py").write_text(PYCG)
    np.savez(
        at / "packing.npz",
        points=points(ds),
        position=one["position"],
        mass=one["mass"],
        velocity=one["velocity"],
        width=WIDTH,
    )

    at = folder / "mercury"
    zeros = np.zeros((particles, 1))
    columns = [one["position"], one["velocity"], one["diameter"][:, None] / 2, *[zeros] * 7]
    rows = np.column_stack(columns)
    head = f"{particles} 0.01 " + " ".join(map(repr, [*low, *high]))
    np.savetxt(at / "packing.data", rows, "%.17g", header=head, comments="")
    (at / "packing.fstat").write_text(fstat_text(ds))
    density = float(ds.density[0, 0])
    (at / "packing.restart").write_text(RESTART.format(low=low, high=high, density=density))

    (at / "job.py").write_text(PROGRAM.format(arguments=FSTATISTICS))

    at = folder / "lammps"
    text, _ = dump_texts(ds, 0)
    (at / "p.0.dump").write_text(text)
    edges = [f"{a:.10g} {b:.10g}" for a, b in zip(low, high, strict=True)]
    size = (high[2] - low[2]) / NODES
    (at / "in.rerun").write_text(LAMMPS.format(low=low, high=high, box=" ".join(edges), size=size))
    (at / "job.py").write_text(PROGRAM.format(arguments=["-in", "in.rerun"]))


def points(ds: xr.Dataset) -> NDArray:
    """Return the points of PyCoarseGraining (n, 3), a width and more inside of the box."""
    low, high = ds.box.values[0].T
    axes = [np.linspace(a, b, POINTS) for a, b in zip(low + 2, high - 2, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


# --- xcg, and the differences ------------------------------------------------------------------------------

# Fields by name: of the other program, and ours, at the same nodes.
Pairs = dict[str, tuple[NDArray, NDArray]]


def pysammos(folder: Path) -> tuple[Callable[[], xr.Dataset], Callable[[xr.Dataset], Pairs]]:
    """From the pair of files to fields in HDF5, on the mesh of Pysammos."""
    names = ["volume_fraction", "density_mixture", "velocity", "kinetic_tensor", "contact_tensor"]

    def job() -> xr.Dataset:
        ds = xcg.open_scene(folder / "P_0001.vtp", contacts=folder / "FC_0001.vtp", periodic="")
        mesh = xcg.pysammos_mesh(ds, "xyz", bounds=bounds_of(folder.parent))
        f = ds.cg.coarse_grain([*names, "momentum_density"], preset="pysammos", **mesh)
        f.cg.save(folder / "xcg.h5", overwrite=True)
        return f

    def pairs(f: xr.Dataset) -> Pairs:
        with h5py.File(folder / "PysammosCG/CG_Lucy_Monodisperse.h5") as file:
            theirs = {name: file[name][...] for name in ["positions", *names]}
        inner = inside(theirs["positions"], folder.parent)
        nodes = f.isel(time=0).stack(node=["x", "y", "z"]).transpose("node", ...)
        return {name: (theirs[name][0][inner], nodes[name].values[inner]) for name in names}

    return job, pairs


def pycoarsegraining(
    folder: Path,
) -> tuple[Callable[[], xr.Dataset], Callable[[xr.Dataset], Pairs]]:
    """From arrays in memory to density and momentum at points."""
    ds = packing_of(folder.parent)
    places = {axis: ("node", values) for axis, values in zip("xyz", points(ds).T, strict=True)}

    def job() -> xr.Dataset:
        return ds.cg.coarse_grain(
            ["density", "momentum_density"], width=WIDTH, at=xr.Dataset(places)
        )

    def pairs(f: xr.Dataset) -> Pairs:
        theirs = np.load(folder / "fields.npz")
        return {
            "density": (theirs["density"], f.density.values[0]),
            "momentum_density": (theirs["momentum"], f.momentum_density.values[0]),
        }

    return job, pairs


def mercury(folder: Path) -> tuple[Callable[[], xr.Dataset], Callable[[xr.Dataset], Pairs]]:
    """From the files to a profile."""
    names = ["density", "momentum_density", "momentum_flux", "contact_stress"]

    def job() -> xr.Dataset:
        ds = xcg.open_scene(folder / "packing.data", contacts=folder / "packing.fstat")
        return profile(ds, names, folder.parent, kernel=GAUSSIAN)

    def pairs(f: xr.Dataset) -> Pairs:
        columns = (folder / "packing.stat").read_text().split("\n", 1)[0].split()
        table = np.loadtxt(folder / "packing.stat", skiprows=3)
        theirs = dict(zip(columns, table[:, 3:].T, strict=False))
        ours = f.isel(time=0)
        stress = [
            theirs[f"NormalStress{a}{b}"] + theirs[f"TangentialStress{a}{b}"]
            for a in "XYZ"
            for b in "XYZ"
        ]
        momentum = [theirs[f"Momentum{a}"] for a in "XYZ"]
        flux = [theirs[f"MomentumFlux{a}{a}"] for a in "XYZ"]
        return {
            "density": (theirs["Density"], ours.density.values),
            "momentum_density": (np.array(momentum).T, ours.momentum_density.values),
            "momentum_flux": (
                np.array(flux).T,
                np.diagonal(ours.momentum_flux.values, axis1=1, axis2=2),
            ),
            "contact_stress": (np.array(stress).T, ours.contact_stress.values.reshape(-1, 9)),
        }

    return job, pairs


def lammps(folder: Path) -> tuple[Callable[[], xr.Dataset], Callable[[xr.Dataset], Pairs]]:
    """From the dump of a periodic box to a profile, smooth here and of bins there: their means are the same."""

    def job() -> xr.Dataset:
        ds = xcg.open_scene(folder / "p.0.dump", units="reduced")
        return profile(ds, ["density", "velocity"], folder.parent, width=WIDTH)

    def pairs(f: xr.Dataset) -> Pairs:
        table = np.loadtxt(folder / "profile.txt", skiprows=4)
        theirs = np.average(table[:, 4:], weights=table[:, 3], axis=0)
        return {"mean velocity": (theirs, f.velocity.weighted(f.density).mean("z").values[0])}

    return job, pairs


def packing_of(folder: Path) -> xr.Dataset:
    """Return the packing that was written into a folder."""
    return packing(int((folder / "particles.txt").read_text()))


def bounds_of(folder: Path) -> dict[str, tuple[float, float]]:
    """Return the ends of the box along each axis."""
    low, high = packing_of(folder).box.values[0].T.tolist()
    return dict(zip("xyz", zip(low, high, strict=True), strict=True))


def profile(ds: xr.Dataset, names: list[str], folder: Path, **options: Any) -> xr.Dataset:
    """Return fields at the centres of the bins along z."""
    bounds = bounds_of(folder)
    low, high = bounds["z"]
    half = (high - low) / NODES / 2
    extent = {axis: bounds[axis][1] - bounds[axis][0] for axis in "xy"}
    nodes = np.linspace(low + half, high - half, NODES)
    places = {"z": xr.DataArray(nodes, dims="z")}
    return ds.cg.coarse_grain(names, at=places, extent=extent, **options).compute()


def inside(places: NDArray, folder: Path) -> NDArray:
    """Return which nodes are two diameters from the sides of the box."""
    low, high = np.array(list(bounds_of(folder).values())).T
    return ((places > low + 2) & (places < high - 2)).all(axis=1)


def compare(folder: Path) -> list[str]:
    """Return a table of both times, their ratio, and the largest differences of fields, over the largest value."""
    lines = [
        "| program | its time (s) | xcg (s) | ratio | xcg in a new process (s) | largest differences |",
        "|---|---|---|---|---|---|",
    ]
    for prepare in (pysammos, pycoarsegraining, mercury, lammps):
        at = folder / prepare.__name__
        if not (at / "times.json").exists():
            continue
        theirs = json.loads((at / "times.json").read_text())["least"]
        job, pairs = prepare(at)
        f = job()
        ours = min(timed(job) for _ in range(REPEATS))
        whole = min(timed(partial(in_new_process, at)) for _ in range(REPEATS))
        differences = []
        for name, (there, here) in pairs(f).items():
            share = np.abs(there - here).max() / np.abs(here).max()
            differences.append(f"{name} {share:.0e}")
        lines.append(
            f"| {at.name} | {theirs:.3g} | {ours:.3g} | {theirs / ours:.3g} | {whole:.3g} | "
            f"{', '.join(differences)} |"
        )
    return lines


def timed(job: Callable[[], object]) -> float:
    """Return the seconds that a job takes."""
    begin = time.perf_counter()
    job()
    return time.perf_counter() - begin


def in_new_process(folder: Path) -> None:
    """Do the job of xcg beside a program in a new process, as programs are started."""
    code = f"from docs import side_by_side as s; s.{folder.name}(s.Path({str(folder)!r}))[0]()"
    subprocess.run([sys.executable, "-W", "ignore", "-c", code], check=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("what", choices=["write", "compare"])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--particles", type=int, default=10_000, help="grains (default 10000)")
    parser.add_argument("--write", action="store_true", help="write the table into the page")
    given = parser.parse_args()
    if given.what == "write":
        write(given.folder, given.particles)
        return
    with mock.patch.dict(os.environ, XCG_INDEX_CACHE="0"):  # headers are not remembered
        table = "\n".join(compare(given.folder))
    print(table)
    if given.write:
        write_between(
            "side_by_side.md",
            "measured",
            table + f"\n\nSeconds, least of {REPEATS}, on {machine()}.\n",
        )


if __name__ == "__main__":
    main()
