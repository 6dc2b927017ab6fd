"""Structure factor: density waves of the particles of a periodic scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from xcg.analysis.by_phase import PhaseAnalysis
from xcg.common.checks import POSITIVE, check, floats, whole
from xcg.common.messages import SceneError, plain
from xcg.compiled._jit import for_parts
from xcg.compiled.structure_factor import sum_waves
from xcg.scene.conform import takes_scene
from xcg.scene.frame import check_finite
from xcg.scene.lattice import Lattice
from xcg.scene.scene import Scene
from xcg.scene.schema import Frame, Variable, units_in
from xcg.steps.analysis import run
from xcg.steps.faults import OnError
from xcg.steps.labels import annotated

MOST_NUMBERS = 3e8  # wave vectors that are looked at in a step


@takes_scene
def structure_factor(
    scene: Scene,
    k_max: float | None = None,
    *,
    bins: int = 100,
    samples: int | None = 100,
    vectors: ArrayLike | None = None,
    by: str | None = None,
    groups: Sequence[int] | None = None,
    on_error: OnError = "raise",
) -> xr.Dataset:
    r"""Compute the structure factor S(k) of each step, isotropic or by wave vector.

    Lazy where the scene is. Frozen particles are left out.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene that is periodic along all its axes, in a tilted box, too.
    k_max : float, optional
        Largest wavenumber (m-1) of the isotropic structure factor, which is averaged over
        directions.
    bins : int
        Number of bins of equal width between 0 and `k_max`.
    samples : int, optional
        Most wave vectors of a bin, one of each k and -k; they are drawn at random, the same in each
        run. None takes all.
    vectors : array (waves, dimension), optional
        Whole numbers (h, k, l) of reciprocal lattice vectors, in place of `k_max`.
    by : str, optional
        An integer variable of the particles: adds the dimensions ``phase`` and ``other_phase``,
        with "bulk" first.
    groups : list of int, optional
        All values of `by`, where they are not known without reading.
    on_error : {"raise", "skip"}
        What to do about a step that cannot be read or computed: stop with its error, or leave it
        out (NaN), warn of it, and mark it in the coordinate ``skipped`` (time).

    Returns
    -------
    xarray.Dataset
        ``structure_factor`` (time, phase, other_phase, k), and ``wave_count`` (time, k), the number
        of wave vectors in each bin, one of each k and -k, which have the same S; NaN in bins without
        any. With `vectors`, ``structure_factor``
        (time, phase, other_phase, wave) and ``wave_vector`` (time, wave, component), in m-1. NaN
        for phases without particles.

    Raises
    ------
    SceneError
        If the scene is not periodic along all its axes, a step holds no particles, or the box holds
        too many wave vectors.
    ValueError
        If an argument is wrong.

    Notes
    -----
    :math:`S_{ab}(k) = \mathrm{Re}\, \rho_a \rho_b^* / \sqrt{N_a N_b}` with :math:`\rho_a(k) =
    \sum_{i \in a} \exp(-i k \cdot r_i)`, at the wave vectors of the periodic box but zero. For
    small k, S of a fluid is the variance of the number of particles in a large region over its
    mean.

    References
    ----------
    Ashcroft, N. W., Langreth, D. C. (1967). Structure of binary liquid mixtures. Phys. Rev. 156.

    Examples
    --------
    >>> import xcg
    >>> ds = xcg.datasets.simple_cubic(5)
    >>> s = ds.cg.structure_factor(vectors=[(5, 0, 0), (1, 0, 0)])  # a Bragg peak, and another
    >>> s.structure_factor.values.round(9).tolist()
    [[125.0, 0.0]]
    """
    analysis = StructureFactor(
        k_max=k_max, bins=bins, samples=samples, vectors=vectors, by=by, groups=groups
    )
    return run(scene, analysis, on_error=on_error)


@dataclass(frozen=True, kw_only=True)
class StructureFactor(PhaseAnalysis):
    """Structure factor of a step, see `structure_factor`."""

    name = "structure_factor"

    k_max: float | None = None
    bins: int = 100
    samples: int | None = 100
    vectors: ArrayLike | None = None

    def prepare(self, scene: Scene) -> Self:
        """Check the options, and find groups."""
        plane = self.setup.plane
        if (self.k_max is None) == (self.vectors is None):
            raise ValueError(
                "structure_factor takes one of k_max= (largest wavenumber, m-1) and vectors= "
                "(whole numbers of reciprocal lattice vectors)"
            )
        check("k_max", self.k_max, POSITIVE, "m-1", optional=True)
        check("bins", self.bins, whole(1, 1e7))
        check("samples", self.samples, whole(1, 1e7), optional=True)
        vectors = None
        if self.vectors is not None:
            vectors = floats(self.vectors)
            is_table = vectors.ndim == 2 and vectors.shape[1:] == (len(plane),) and vectors.size
            if not is_table or (np.abs(vectors) > 2**20).any() or (vectors % 1 != 0).any():
                raise ValueError(
                    f"vectors={plain(self.vectors)}: expected whole numbers (waves, {len(plane)}), "
                    f"such as {[tuple(int(k == 0) for k in range(len(plane)))]}"
                )
            vectors = vectors.astype("int64")
        if is_open := [a for a in plane if a not in self.setup.periodic]:
            raise SceneError(
                f"structure_factor needs periodic axes; open: {', '.join(is_open)}. "
                "radial_distribution takes open axes by bounds="
            )
        return replace(super().prepare(scene), vectors=vectors)

    def rows(self, scene: Scene) -> dict[str, Variable]:
        """Return S(k), and wave vectors or their number."""
        along = "k"
        rows = {
            "wave_count": Variable(
                ("k",), "1", "number of wave vectors, one of each k and -k", "int64"
            )
        }
        if self.vectors is not None:
            along = "wave"
            rows = {"wave_vector": Variable(("wave", "component"), "m^-1", "wave vector")}
        formula = "Re rho_a rho_b^* / sqrt(N_a N_b)"
        dims = (*self.dims_of_pairs, along)
        return {"structure_factor": Variable(dims, "1", "structure factor", formula=formula)} | rows

    def coords(self, scene: Scene) -> dict[str, xr.Variable]:
        """Return phases, and the middle of the bins of wavenumbers or the numbers of the waves."""
        coords = super().coords(scene)
        if self.k_max is not None:
            k = self.k_max * (np.arange(self.bins) + 0.5) / self.bins
            unit = units_in("m^-1", self.setup.unit_system)
            coords["k"] = annotated("k", k, unit, "wavenumber")
        else:
            labels = [" ".join(map(str, numbers)) for numbers in np.asarray(self.vectors).tolist()]
            about = {"long_name": "numbers of reciprocal lattice vectors"}
            coords["wave"] = xr.Variable("wave", labels, about)
        return coords

    def frame(self, frame: Frame, lattice: Lattice, source: str) -> Frame:
        """Compute S(k) of a step."""
        frame, phase = self.moving(frame, source)
        check_finite("position", frame, source)
        if not len(frame["position"]):
            raise SceneError(
                f"{source}: structure_factor needs a particle, and the step holds none; leave it "
                "out by on_error='skip'"
            )
        axes = self.setup.axes
        edges = lattice.periodic_vectors[np.isin(lattice.axes, axes)][:, axes]
        inverse = np.linalg.inv(edges)
        if self.k_max is None:
            numbers = np.asarray(self.vectors)
            bins = np.arange(len(numbers))
        else:
            numbers, bins = self._drawn(edges, inverse, source)
        share = frame["position"][:, axes] @ inverse
        angle = 2 * np.pi * (share - np.floor(share))
        groups = range(self.phase_count)
        waves = self.with_bulk(np.array([self._sums(angle[phase == k], numbers) for k in groups]))
        particles = self.with_bulk(np.bincount(phase, minlength=self.phase_count))
        products = (waves[:, None] * waves.conj()[None]).real
        scale = np.sqrt(np.multiply.outer(particles, particles).astype(float))[:, :, None]
        ratio = np.divide(products, scale, out=np.full(products.shape, np.nan), where=scale > 0)
        ratio = self.of_pairs(ratio)
        if self.k_max is None:
            vectors = np.zeros((len(numbers), 3))
            vectors[:, axes] = 2 * np.pi * numbers @ inverse.T
            return {"structure_factor": ratio, "wave_vector": vectors}
        waves_a_bin = np.bincount(bins, minlength=self.bins)
        flat = ratio.reshape(-1, len(numbers))
        sums = [np.bincount(bins, values, minlength=self.bins) for values in flat]
        mean = np.array(sums) / np.where(waves_a_bin > 0, waves_a_bin, np.nan)
        return {
            "structure_factor": mean.reshape(*ratio.shape[:-1], self.bins),
            "wave_count": waves_a_bin,
        }

    def _sums(self, angle: NDArray, numbers: NDArray) -> NDArray:
        """Return the sum of the waves over some particles; complex (waves,)."""
        sums = np.zeros((len(numbers), 2))
        if len(angle):
            for_parts(
                len(numbers),
                lambda first, last: sum_waves(angle, numbers[first:last], sums[first:last]),
                self.threads,
            )
        return sums[:, 0] - 1j * sums[:, 1]

    def _drawn(self, edges: NDArray, inverse: NDArray, source: str) -> tuple[NDArray, NDArray]:
        """Return numbers (waves, dimension) of wave vectors up to `k_max`, and the bin of each.

        Of a vector and its opposite one is taken, as both have the same S.
        """
        k_max = self.k_max or 0.0
        most = np.floor(k_max * np.linalg.norm(edges, axis=1) / (2 * np.pi)).astype("int64")
        if np.prod(2.0 * most + 1) > MOST_NUMBERS:
            raise SceneError(
                f"{source}: the box has more than {MOST_NUMBERS:.0e} wave vectors below "
                f"k_max={k_max:g}; take a smaller k_max"
            )
        ranges = [np.arange(-n, n + 1) for n in most[1:]]
        plane = np.stack(np.meshgrid(*ranges, indexing="ij"), axis=-1).reshape(-1, len(ranges))
        random = np.random.default_rng(0)
        numbers = np.zeros((0, len(most)), "int64")
        bins = np.zeros(0, "int64")
        keys = np.zeros(0)
        for h in range(most[0] + 1):
            # the first number that is not zero is positive
            half = plane if h else plane[len(plane) // 2 + 1 :]
            new = np.column_stack([np.full(len(half), h), half])
            k = np.linalg.norm(2 * np.pi * new @ inverse.T, axis=1)
            new = new[k < k_max]
            k = k[k < k_max]
            numbers = np.concatenate([numbers, new])
            bins = np.concatenate([bins, (k / k_max * self.bins).astype("int64")])
            keys = np.concatenate([keys, random.random(len(new))])
            if self.samples is not None:
                order = np.lexsort((keys, bins))
                of_bin = bins[order]
                rank = np.arange(len(order)) - np.searchsorted(of_bin, of_bin)
                kept = order[rank < self.samples]
                numbers = numbers[kept]
                bins = bins[kept]
                keys = keys[kept]
        return numbers, np.minimum(bins, self.bins - 1)
