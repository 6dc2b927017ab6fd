"""Radial distribution: density of particles at a distance from others, relative to the mean."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.analysis.by_phase import PhaseAnalysis
from xcg.analysis.pairs import cells_of
from xcg.analysis.regions import Bounds, images_in
from xcg.common.checks import POSITIVE, check, rising_pair, whole
from xcg.common.messages import SceneError, plain
from xcg.compiled._jit import for_parts, threads_for
from xcg.compiled.radial_distribution import Histogram
from xcg.scene.conform import takes_scene
from xcg.scene.frame import check_finite
from xcg.scene.lattice import Lattice
from xcg.scene.scene import Scene
from xcg.scene.schema import COMPONENTS, Frame, Variable, units_in
from xcg.steps.analysis import run
from xcg.steps.faults import OnError
from xcg.steps.labels import annotated

HALF_BOX = 1 + 1e-12  # share of half a period that distances may reach


@takes_scene
def radial_distribution(
    scene: Scene,
    r_max: float,
    *,
    bins: int = 100,
    scaled: bool = False,
    axis: str | None = None,
    angles: int = 18,
    bounds: Bounds | None = None,
    by: str | None = None,
    groups: Sequence[int] | None = None,
    on_error: OnError = "raise",
) -> xr.Dataset:
    r"""Compute the radial distribution g(r) of the particles of each step.

    Lazy where the scene is. Frozen particles are left out.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene. In a one-layer scene, distances are those in its plane.
    r_max : float
        Largest distance (m), at most half the distance to the nearest periodic image, and at most
        the width of `bounds`.
    bins : int
        Number of bins of equal width between 0 and `r_max`.
    scaled : bool
        Divide each distance by the mean diameter of the two particles. `r_max` and ``r`` then have
        no unit, and spheres of all sizes touch at 1.
    axis : {"x", "y", "z"}, optional
        Resolve directions about this axis, such as the vorticity of a shear flow: adds the
        dimension ``theta``. It is the angle of the pair, seen along the axis, from the first of the
        other two axes towards the second (x to y, x to z, y to z), between 0 and pi. In a one-layer
        scene it is the axis across the layer.
    angles : int
        Number of bins of ``theta``.
    bounds : mapping, optional
        Bounds of the region (m), ``{"z": (0.0, 0.1)}``. Only particles with their centre in the
        region count. Required along axes that are not periodic: the part that particles fill.
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
        ``radial_distribution`` and ``pair_count`` (time, phase, other_phase, theta, r), as these
        dimensions apply. ``pair_count`` is the number of particles of ``other_phase`` in the bin,
        summed over the particles of ``phase``: a pair of one phase counts twice. NaN where a phase
        has no pairs.

    Raises
    ------
    SceneError
        If an axis is neither periodic nor bounded, `r_max` is too large for the box, bounds cut
        tilted images, or a region holds fewer than two particles.
    ValueError
        If an argument is wrong.

    Notes
    -----
    :math:`g_{ab} = N_{ab}(r, \theta) / E_{ab}`, with :math:`N_{ab}` the pairs in a bin, and
    :math:`E_{ab}` their expected number if all particles were anywhere in the region V,
    independently:

    .. math::

        E_{ab} = \frac{N_a N_b - N_{a \cap b}}{V} \int_\mathrm{bin} \prod_k \left(1 -
        \frac{|h_k|}{L_k}\right) dh

    over the bounded axes k of length :math:`L_k`. The product is the share of places in the region
    from which h leads to another place in it, so the integral is the volume of the shell that is
    accessible on average (Ohser 1983); it has a closed form. The standard error of a bin of an
    ideal gas is g over the root of the number of its pairs.

    References
    ----------
    Hansen, J.-P., McDonald, I. R. (2013). Theory of Simple Liquids, 4th ed., section 2.5.
    Ohser, J. (1983). On estimators for the reduced second moment measure of point processes. Math.
    Operationsforsch. Statist. 14.

    Examples
    --------
    >>> import xcg
    >>> ds = xcg.datasets.face_centred_cubic(4)  # diameter 1: 12 neighbours at distance 1
    >>> g = ds.cg.radial_distribution(1.2, bins=12)
    >>> int(g.pair_count.sum()) // ds.sizes["particle"]
    12
    """
    analysis = RadialDistribution(
        r_max=r_max,
        bins=bins,
        scaled=scaled,
        axis=axis,
        angles=angles,
        bounds=bounds,
        by=by,
        groups=groups,
    )
    return run(scene, analysis, on_error=on_error)


@dataclass(frozen=True, kw_only=True)
class RadialDistribution(PhaseAnalysis):
    """Radial distribution of a step, see `radial_distribution`."""

    name = "radial_distribution"

    r_max: float
    bins: int = 100
    scaled: bool = False
    axis: str | None = None
    angles: int = 18
    bounds: Bounds | None = None

    def prepare(self, scene: Scene) -> Self:
        """Check the options, and find groups."""
        plane = self.setup.plane
        check("r_max", self.r_max, POSITIVE, "m")
        check("bins", self.bins, whole(1, 1e7))
        check("angles", self.angles, whole(1, 1e7))
        # of a layer only that across it
        turning = [a for a in COMPONENTS if len(plane) == 3 or a not in plane]
        if self.axis is not None and self.axis not in turning:
            raise ValueError(f"axis={self.axis!r}: expected one of {', '.join(turning)}")
        bounds = self.bounds or {}
        if not isinstance(bounds, Mapping) or not bounds.keys() <= set(plane):
            raise ValueError(
                f"bounds={plain(bounds)}: expected (low, high) for axes of the scene "
                f"({', '.join(plane)}), for example {{{plane[-1]!r}: (0.0, 0.1)}}"
            )
        bounds = {a: rising_pair(f"bounds[{a!r}]", ends) for a, ends in bounds.items()}
        if is_open := [a for a in plane if a not in self.setup.periodic and a not in bounds]:
            missing = ", ".join(f"{a!r}: (low, high)" for a in is_open)
            extent = ""
            if scene.corners is not None:
                low, high = scene.corners
                ends = [f"{low[k]:g} and {high[k]:g}" for k in map(COMPONENTS.index, is_open)]
                extent = f"; centres lie between {', '.join(ends)}"
            raise SceneError(
                f"{self.name}: not periodic along {', '.join(is_open)}: give the part that "
                f"particles fill, bounds={{{missing}}}{extent}"
            )
        return replace(super().prepare(scene), bounds=bounds)

    def reads(self, scene: Scene) -> list[str]:
        """Return positions, groups, and sizes if distances are scaled by them."""
        return [*super().reads(scene), *(["diameter"] * self.scaled)]

    def rows(self, scene: Scene) -> dict[str, Variable]:
        """Return g(r) and numbers of pairs."""
        dims = self.dims_of_pairs
        if self.axis is not None:
            dims = (*dims, "theta")
        dims = (*dims, "r")
        formula = "number of pairs / mean number of a random arrangement"
        return {
            "radial_distribution": Variable(dims, "1", "radial distribution", formula=formula),
            "pair_count": Variable(
                dims, "1", "number of particles around those of the phase", "int64"
            ),
        }

    def coords(self, scene: Scene) -> dict[str, xr.Variable]:
        """Return phases, and the middle of the bins of angle and distance."""
        coords = super().coords(scene)
        theta = np.pi * (np.arange(self.angles) + 0.5) / self.angles
        coords["theta"] = annotated("theta", theta, "rad", f"angle of the pair about {self.axis}")
        r = self.r_max * (np.arange(self.bins) + 0.5) / self.bins
        coords["r"] = annotated("r", r, units_in("m", self.setup.unit_system), "distance")
        if self.scaled:
            coords["r"] = annotated("r", r, "1", "distance over mean diameter")
        return coords

    def frame(self, frame: Frame, lattice: Lattice, source: str) -> Frame:
        """Compute g(r) of a step."""
        counts, expected = self.pairs(frame, lattice, source)
        g = np.divide(counts, expected, out=np.full(counts.shape, np.nan), where=expected > 0)
        results = {"radial_distribution": g, "pair_count": counts}
        if self.axis is None:
            results = {name: values[:, :, 0] for name, values in results.items()}
        return {name: self.of_pairs(values) for name, values in results.items()}

    def pairs(self, frame: Frame, lattice: Lattice, source: str) -> tuple[NDArray, NDArray]:
        """Count pairs, and compute their expected numbers: (phases, phases, angles, bins)."""
        frame, group = self.moving(frame, source)
        check_finite("position", frame, source)
        position, inside = images_in(self.bounds or {}, frame["position"], lattice, source)
        in_plane = np.isin(np.arange(3), self.setup.axes)
        position = np.where(in_plane, position[inside], 0.0)
        if len(position) < 2:
            raise SceneError(
                f"{source}: {self.name} needs two particles, and the region holds {len(position)}; "
                "take wider bounds, or leave this step out by on_error='skip'"
            )
        group = group[inside]
        # distances are counted in units of the sum of two radii, which are half a metre unless
        # they are those of the particles
        radius = np.full(len(position), 0.5)
        if self.scaled:
            check_finite("diameter", frame, source)
            radius = 0.5 * frame["diameter"][inside]
            if not radius.any():
                raise SceneError(
                    f"{source}: {self.name} divides distances by diameters, and all diameters are "
                    "zero; assign those of the particles"
                )
        region = self._region(lattice, 2 * float(radius.max()), source)
        counts = self._counted(position, radius, group, region, source)
        counts = counts + counts.swapaxes(0, 1)
        expected = self._expected(radius, group, region)
        counts = self.with_bulk(self.with_bulk(counts), axis=1)
        return counts, self.with_bulk(self.with_bulk(expected), axis=1)

    @property
    def _shape(self) -> tuple[int, int, int, int]:
        """Numbers of groups (twice), angles and bins."""
        angles = 1 if self.axis is None else self.angles
        return self.phase_count, self.phase_count, angles, self.bins

    @property
    def _lengths(self) -> dict[int, float]:
        """Lengths of the region along the bounded axes (m), by the number of the axis."""
        bounds = self.bounds or {}
        return {COMPONENTS.index(axis): high - low for axis, (low, high) in bounds.items()}

    @property
    def _turning(self) -> tuple[int, int, int]:
        """Numbers of the axis that directions are about, and of the two others."""
        (default,) = set(COMPONENTS) - set(self.setup.plane) or "z"
        axis = COMPONENTS.index(self.axis or default)
        first, second = (k for k in range(3) if k != axis)
        return axis, first, second

    def _region(self, lattice: Lattice, largest: float, source: str) -> Lattice:
        """Return the images of the region along its periodic axes; check that r_max fits into it."""
        setup = self.setup
        bounds = self.bounds or {}
        periodic = "".join(a for a in setup.plane if a in setup.periodic and a not in bounds)
        box = {"box": lattice.edges, "lattice": lattice.cell}
        sides = {name: values for name, values in box.items() if values is not None}
        region = Lattice.of(sides, periodic, source)
        lengths = np.abs(region.basis)
        removed = ~np.isin([*COMPONENTS], [*periodic])
        if lengths[:, removed].max(initial=0.0) > 1e-9 * lengths.max(initial=0.0):
            raise SceneError(
                f"{source}: the box is tilted, so that its images along {periodic!r} are "
                "shifted across the region; bound other axes, or none"
            )
        reach = self.r_max * largest
        distance, along = region.closest
        widest = min([distance / 2, *self._lengths.values()])
        if reach > widest * HALF_BOX:
            limit = f"{distance:g} {along}"
            if widest < distance / 2:
                limit = f"{widest:g} of bounds"
            most = widest / largest
            raise SceneError(
                f"{source}: r_max={self.r_max:g} is beyond half the distance to the nearest image, "
                f"or the width of the region ({limit}); take r_max={most:.6g} or less"
            )
        return region

    def _counted(
        self, position: NDArray, radius: NDArray, group: NDArray, region: Lattice, source: str
    ) -> NDArray:
        """Count each pair once."""
        workers = threads_for(len(position), self.threads)
        lists, whose = cells_of(
            position, self.r_max * radius, region, threads=workers, source=source
        )
        particle = whose[lists.original]
        images = None
        is_original = None
        if region.vectors is not None:
            images = particle
            is_original = lists.original < len(position)
        across = None
        if self.axis is not None:
            across = np.array([lists.axes.index(k) for k in self._turning[1:]])
        of_record = group[particle]

        def count(first: int, last: int) -> NDArray:
            counts = np.zeros(self._shape, "int64")
            lists.count(first, last, Histogram(of_record, images, is_original, across, counts))
            return counts

        return np.sum(for_parts(len(particle), count, workers, each=8), axis=0)

    def _expected(self, radius: NDArray, group: NDArray, region: Lattice) -> NDArray:
        """Compute the mean number of pairs of particles that are anywhere in the region."""
        groups, _, angles, bins = self._shape
        sides = [length * np.eye(3)[k] for k, length in self._lengths.items()]
        vectors = np.concatenate([region.basis, np.reshape(sides, (-1, 3))])
        volume = abs(np.linalg.det(vectors[:, self.setup.axes]))
        dimension = self.setup.dimension
        # over pairs of different particles, sums of powers of the sum of their radii
        powers = [np.bincount(group, radius**n, minlength=groups) for n in range(2 * dimension + 1)]

        def pair_sum(n: int) -> NDArray:
            products = (math.comb(n, k) * np.outer(powers[k], powers[n - k]) for k in range(n + 1))
            return sum(products) - np.diag(2.0**n * powers[n])

        edges = self.r_max * np.arange(bins + 1) / bins
        whole = 2 * np.pi * (dimension - 1)
        expected = np.zeros(self._shape)
        for q, share in enumerate(self._shares(angles)):
            n = dimension + q
            shells = whole / angles * np.diff(edges**n) / n
            expected += pair_sum(n)[:, :, None, None] / volume * share[:, None] * shells
        return expected

    def _shares(self, angles: int) -> list[NDArray]:
        """Return the factors (angles,) of powers of r in the mean of prod (1 - r |u_k| / L_k).

        u are all directions of each bin of angles.
        """
        axis, first, second = self._turning
        inverse = [1 / self._lengths.get(k, np.inf) for k in range(3)]
        turn = np.pi * np.arange(angles + 1) / angles
        width = np.pi / angles
        sine = np.sin(turn)
        is_late = turn > np.pi / 2
        cosines = inverse[first] * np.diff(np.where(is_late, 2 - sine, sine)) / width
        sines = inverse[second] * np.diff(1 - np.cos(turn)) / width
        square = np.where(is_late, 1 - sine**2 / 2, sine**2 / 2)
        both = inverse[first] * inverse[second] * np.diff(square) / width
        ones = np.ones(angles)
        if self.setup.dimension == 2:
            return [ones, -(cosines + sines), both]
        along = inverse[axis]
        return [
            ones,
            -(np.pi / 4 * (cosines + sines) + along / 2),
            2 / 3 * both + along / 3 * (cosines + sines),
            -along / 4 * both,
        ]
