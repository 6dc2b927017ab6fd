"""Time of g(r), bond order and Voronoi cells beside freud and OVITO: writes the table of docs/accuracy.md.

pip install . ovito --group test; python -m docs.structure_speed [--quick]

Random points in a periodic cube, one thread each. The programs take turns; times are the least
processor times of all turns. freud computes in single precision, and its Voronoi cells are those of
equal spheres.
"""

from __future__ import annotations

import os

# read when the packages are imported
os.environ |= {"NUMBA_NUM_THREADS": "1", "OVITO_THREAD_COUNT": "1"}

import argparse
import time
from collections.abc import Callable

import freud
import numpy as np
import ovito.modifiers as ovito_modifiers
import xarray as xr
from numpy.typing import NDArray
from ovito.data import DataCollection, ParticleType, SimulationCell
from ovito.pipeline import Pipeline, StaticSource

import xcg
from docs.marks import write_between

Run = Callable[[], object]
R_MAX = 5.0  # in diameters: 600 neighbours


def places(count: int, dimension: int) -> tuple[NDArray, float]:
    """Return random points at the number density of spheres of diameter one at a fraction of 0.6."""
    edge = (count * np.pi / 6 / 0.6) ** (1 / dimension)
    position = np.random.default_rng(0).uniform(0, edge, (count, 3))
    if dimension == 2:
        position[:, 2] = 0.0
    return position, edge


def scene(position: NDArray, edge: float, dimension: int) -> xr.Dataset:
    """Return the points as a scene in memory."""
    axes = "xyz"[:dimension]
    return xcg.scene_from_arrays(
        position,
        diameter=np.ones(len(position)),
        density=1.0,
        box=dict.fromkeys(axes, (0.0, edge)),
        periodic=axes,
        dimension=dimension,
    )


def with_ovito(position: NDArray, edge: float, modifier: object) -> Run:
    """Return a run of one of OVITO's modifiers; each run has a new pipeline, which has no results yet."""
    data = DataCollection()
    particles = data.create_particles(count=len(position))
    particles.create_property("Position", data=position)
    particles.create_property("Radius", data=np.full(len(position), 0.5))
    types = particles.create_property("Particle Type", data=np.ones(len(position), int))
    types.types.append(ParticleType(id=1, name="A"))
    cell = SimulationCell(pbc=(True, True, True))
    cell[:, :3] = edge * np.eye(3)
    data.objects.append(cell)

    def run() -> object:
        pipeline = Pipeline(source=StaticSource(data=data))
        pipeline.modifiers.append(modifier)
        return pipeline.compute()

    return run


def cases(count: int) -> dict[str, dict[str, Run]]:
    """Return what each program runs, by case."""
    freud.parallel.set_num_threads(1)
    position, edge = places(count, 3)
    ds = scene(position, edge, 3)
    system = freud.box.Box.cube(edge), position - edge / 2
    flat, side = places(count, 2)
    layer = scene(flat, side, 2)
    plane = freud.box.Box.square(side), flat - [side / 2, side / 2, 0]
    coordination = ovito_modifiers.CoordinationAnalysisModifier(cutoff=R_MAX, number_of_bins=100)
    voronoi = ovito_modifiers.VoronoiAnalysisModifier(use_radii=True)
    return {
        "g(r), 600 neighbours": {
            "xcg": lambda: ds.cg.radial_distribution(R_MAX),
            "freud": lambda: freud.density.RDF(100, R_MAX).compute(system),
            "OVITO": with_ovito(position, edge, coordination),
        },
        "q6, 12 nearest": {
            "xcg": lambda: ds.cg.bond_order([6]),
            "freud": lambda: freud.order.Steinhardt(6).compute(system, {"num_neighbors": 12}),
        },
        "psi6, 6 nearest, in a layer": {
            "xcg": lambda: layer.cg.bond_order(),
            "freud": lambda: freud.order.Hexatic(6).compute(plane, {"num_neighbors": 6}),
        },
        "Voronoi cells": {
            "xcg": lambda: ds.cg.voronoi(),
            "freud": lambda: freud.locality.Voronoi().compute(system),
            "OVITO": with_ovito(position, edge, voronoi),
        },
    }


def least_times(runs: dict[str, Run], turns: int) -> dict[str, float]:
    """Return the least processor time (s) of each program, which take turns."""
    least = dict.fromkeys(runs, np.inf)
    for turn in range(turns + 1):
        for name, run in runs.items():
            start = time.process_time()
            run()
            # the first turn compiles
            if turn:
                least[name] = min(least[name], time.process_time() - start)
    return least


def main() -> None:
    """Measure, print, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="5000 particles; print the table only")
    quick = parser.parse_args().quick
    count = 5000 if quick else 20_000
    lines = ["| | xcg, µs a particle | freud | OVITO |", "|---|---|---|---|"]
    for case, runs in cases(count).items():
        least = least_times(runs, 2 if quick else 7)
        own = least.pop("xcg")
        others = [f"{least[n] / own:.2g} x" if n in least else "-" for n in ("freud", "OVITO")]
        lines.append(f"| {case} | {1e6 * own / count:.3g} | {' | '.join(others)} |")
        print(lines[-1], flush=True)
    if not quick:
        write_between("accuracy.md", "structure speed", "\n".join(lines))


if __name__ == "__main__":
    main()
