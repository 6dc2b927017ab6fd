"""Your own analysis: the radial distribution of grains, in memory, lazily and on a cluster.

    python examples/own_analysis.py

Grains at random places are an ideal gas: g(r) is 1, and its mean over the bins is printed.
"""

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from distributed import Client

import xcg


@dataclass(frozen=True)
class RadialDistribution(xcg.FrameAnalysis):
    """Pairs of grains at a distance, over those of an ideal gas."""

    reach: float | None = None
    bins: int = 20

    def prepare(self, scene):
        """Return the analysis with the default reach, three mean diameters."""
        return self if self.reach else replace(self, reach=3 * scene.sizes["d43"])

    @property
    def edges(self):
        """Edges of the bins (m)."""
        return np.linspace(0, self.reach, self.bins + 1)

    def reads(self, scene):
        """Return the variables of the scene that are needed."""
        return ["position"]

    def rows(self, scene):
        """Return dimensions, unit and name of each result."""
        return {"g": xcg.Variable(("distance",), "1", "radial distribution function")}

    def coords(self, scene):
        """Return the middle of each bin."""
        middle = (self.edges[1:] + self.edges[:-1]) / 2
        return {"distance": xr.Variable("distance", middle, {"units": "m"})}

    def frame(self, frame, lattice, source):
        """Count the pairs of one step, nearest images across periodic edges."""
        position = frame["position"]
        i, j = np.triu_indices(len(position), 1)
        distance = np.linalg.norm(lattice.shortest(position[i] - position[j]), axis=1)
        pairs, _ = np.histogram(distance, self.edges)
        shells = 4 / 3 * np.pi * np.diff(self.edges**3)
        return {"g": pairs * np.prod(lattice.lengths) / (len(i) * shells)}


def gas(steps: int = 4, grains: int = 1000) -> xr.Dataset:
    """Return grains at random places of a periodic box."""
    places = np.random.default_rng(1).uniform(0, 1, (steps, grains, 3))
    return xcg.scene_from_arrays(
        places, diameter=np.full((steps, grains), 0.1), box=[(0, 1)] * 3, periodic="xyz"
    )


def main() -> None:
    """Run the analysis in three ways."""
    ds = gas()
    analysis = RadialDistribution()
    eager = analysis.run(ds)
    print(f"in memory: mean g = {float(eager.g.mean()):.3f}, {eager.g.dims}")
    lazy = analysis.run(ds.chunk(time=1))  # nothing is computed yet
    print(f"lazy: {lazy.g.chunks[0]} steps a task, same = {lazy.compute().equals(eager)}")
    with Client(n_workers=2, threads_per_worker=1, dashboard_address=None) as client:
        result = client.compute(lazy).result()
    print(f"on a cluster: same = {result.equals(eager)}")


if __name__ == "__main__":
    main()
