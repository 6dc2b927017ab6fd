"""Force chains of a scene: the search in each step, a description of each chain, and chains followed over time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.analysis.chain_results import (
    CHAINS,
    COPIED,
    RESULTS,
    require_chains,
    result_sizes,
    statistics_of,
    steps_of,
)
from xcg.analysis.chain_selection import Region, check_region
from xcg.analysis.particle_stress import StressRule, Volumes, carries
from xcg.common.checks import FINITE, above, check, check_choice, whole
from xcg.common.messages import warn_user
from xcg.compiled import chains as loops
from xcg.compiled._jit import for_parts
from xcg.scene.conform import takes_scene
from xcg.scene.frame import with_time
from xcg.scene.lattice import Lattice
from xcg.scene.scene import Scene
from xcg.scene.schema import BOX, Frame, Variable
from xcg.scene.times import require_rising_times, unit_of_times
from xcg.steps.analysis import FrameAnalysis, run
from xcg.steps.faults import OnError
from xcg.steps.labels import annotated, call_of, labelled_table, provenance

Algorithm: TypeAlias = Literal["branching", "peters2005"]
# Angles that exceed alpha by less (radians) count as equal to it, stresses that fall short of the
# `min_stress` by less than this share of it likewise: both are known to rounding only.
_ANGLE = 1e-9
_SHARE = 1e-12
# what a loop finds of each chain, in the order of its arguments
_DESCRIBED = ("particles", "links", "branchings", "stress", "orientation", "normal")


@takes_scene
def force_chains(
    scene: Scene,
    alpha: float = 45.0,
    min_stress: float | Literal["mean"] | None = None,
    min_length: int = 3,
    *,
    algorithm: Algorithm = "branching",
    one_sided: bool = False,
    region: Region | None = None,
    volume: Volumes = "particle",
    on_error: OnError = "raise",
) -> xr.Dataset:
    """Find the force chains of each step of a scene.

    A contact is a link where both of its particles are compressed (and reach `min_stress`), and
    the branch between their centres is within `alpha` of the direction of the most compressive
    stress of both. A particle whose two largest principal stresses are equal has no such direction,
    and takes no part in links below 90 degrees. A chain is what a depth-first search reaches
    through links, with all branches and loops. Lazy where the scene is, one task for each chunk of
    time.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with contacts.
    alpha : float
        Largest angle between branch and direction, in degrees, inclusive; above 0, up to 90, where
        every contact of two compressed particles is a link.
    min_stress : float or "mean", optional
        Least major stress of a particle (Pa), or "mean" for the mean of all particles of the step.
        By default any compressed particle may be part of a chain.
    min_length : int
        Least number of particles of a chain, 2 or more.
    algorithm : str
        "branching" (default), or "peters2005": chains without branches, from the particle of
        largest stress both ways, each time through the contact whose branch is closest to the
        direction of the major stress of the particle reached last, turned onward.
    one_sided : bool
        Go on from a particle only where the branch points along its direction, turned onward (both
        ways from the seed). Chains then depend on the order of the ids. By default both ways count,
        and they do not.
    region : Region, optional
        Particles whose centre is elsewhere take no part: `xcg.BoxRegion`, `xcg.Sphere`, at rest,
        moving or following a particle, combined with ``&``, ``|`` and ``~``.
    volume
        Volume of a particle, see `xcg.particle_stress`.
    on_error : {"raise", "skip"}
        What to do about a step that cannot be read or computed: stop with its error, or leave it
        out (NaN, or padding), warn of it, and mark it in the coordinate ``skipped`` (time).

    Returns
    -------
    xarray.Dataset
        By particle: ``chain_id`` (-1 for none), ``parent_id`` (the particle that it was reached
        from, -1 for the first of a chain), ``links``, ``branching`` (1 for more than two links),
        principal stresses (Pa) and directions, ``major_direction`` turned onward along the chain,
        ``isotropic`` (1 for a particle without a major direction, see `xcg.particle_stress`).
        By contact: ``link_chain``, the chain that it is a link of. By chain, row k for chain k:
        ``chain_particles``, ``chain_links``, ``chain_branchings``, ``chain_stress`` (Pa),
        ``chain_orientation``, ``chain_normal`` (NaN for a straight chain). By step:
        ``chain_count``, ``length_mean``, ``length_median``, ``length_min``, ``length_max``,
        ``length_share`` (time, length). Positions, diameters, ids and forces are copied from the
        scene.

        The dimension ``chain`` has as many rows as there could be chains, particles //
        `min_length`, so that nothing needs to be computed to know the shape; rows without a chain
        are padding (-1, NaN).

    Raises
    ------
    SceneError
        If the scene holds no contacts or no volumes.
    ValueError
        If an argument is wrong.

    Notes
    -----
    With b the branch and n the direction of the major stress of each of the two particles, a link
    has ``|b . n| >= |b| cos(alpha)``. Sources: Ejtehadi et al., Comput. Phys. Commun. 297 (2024)
    109070; Peters et al., Phys. Rev. E 72 (2005) 041307.

    Examples
    --------
    >>> import xcg
    >>> ds = xcg.datasets.random_scene(200, seed=1)
    >>> fc = force_chains(ds, alpha=45, min_stress="mean")
    >>> fc.chain_id.dims
    ('time', 'particle')
    """
    call = call_of("force_chains", locals())
    check("alpha", alpha, above(0, 90), "degrees")
    if alpha < np.pi / 2:
        warn_user(
            f"alpha={alpha!r} is in degrees, and few branches are as close to the stress; is it in radians?"
        )
    if not isinstance(min_stress, str) or min_stress != "mean":
        check("min_stress", min_stress, FINITE, "Pa", optional=True, hint=", or 'mean'")
    check("min_length", min_length, whole(2))
    check_choice("algorithm", algorithm, Algorithm)
    check_region(region, scene.ds)
    stress = StressRule.of(scene, "force_chains", volume=volume)
    scene.require(("diameter",), "force_chains")
    sizes = scene.ds.sizes
    analysis = _ForceChains(
        stress=stress,
        alpha=float(alpha),
        min_stress=min_stress,
        min_length=int(min_length),
        algorithm=algorithm,
        one_sided=one_sided,
        region=region,
        lengths=result_sizes(sizes["particle"], sizes["contact"], int(min_length)),
    )
    return run(scene, analysis, call=call, on_error=on_error)


@dataclass(frozen=True, eq=False, kw_only=True)
class _ForceChains(FrameAnalysis):
    """Force chains of each step, with what is copied from the scene.

    Attributes
    ----------
    stress : StressRule
        How the stress of a particle is made.
    alpha : float
        Largest angle between the major stress and the branch (degrees).
    min_stress : float or "mean" or None
        Least major stress (Pa).
    min_length : int
        Least number of particles.
    algorithm : str
        With branches, or without (Peters et al. 2005).
    one_sided : bool
        Go on only along the direction of travel.
    region : Region or None
        Where particles must be.
    lengths : mapping
        Upper bounds of the numbers of rows.
    """

    name = "force_chains"
    # regions move in time
    optional = ("frozen", "time")

    stress: StressRule
    alpha: float
    min_stress: float | Literal["mean"] | None
    min_length: int
    algorithm: Algorithm
    one_sided: bool
    region: Region | None
    lengths: Mapping[str, int]

    def reads(self, scene: Scene) -> list[str]:
        """Return what stress follows from, and what is copied."""
        return [*self.stress.variables, *COPIED]

    def rows(self, scene: Scene) -> dict[str, Variable]:
        """Return the rows of particles, contacts, chains, and statistics."""
        return RESULTS

    def coords(self, scene: Scene) -> dict[str, xr.Variable]:
        """Return the lengths that chains can have."""
        lengths = self.min_length + np.arange(self.lengths["length"])
        return {"length": annotated("length", lengths, "1", "particles of a chain")}

    def sizes(self, scene: Scene, ds: xr.Dataset) -> Mapping[str, int]:
        """Return upper bounds of the numbers of chains."""
        return self.lengths

    def attrs(self, scene: Scene) -> dict[str, Any]:
        """Return the criteria."""
        return {name: getattr(self, name) for name in ("alpha", "min_length", "algorithm")}

    def after(self, result: xr.Dataset, ds: xr.Dataset) -> xr.Dataset:
        """Add the box of the scene."""
        return result.assign({name: ds.variables[name] for name in BOX if name in ds})

    def qualifies(self, frame: Frame, stress: Frame, lattice: Lattice) -> NDArray:
        """Return a mask of the particles that may be part of a chain."""
        chosen = carries(stress)
        if "frozen" in frame:
            chosen &= frame["frozen"] != 1
        if self.min_stress is not None and len(chosen):
            major = stress["major_stress"]
            least = self.min_stress
            if isinstance(least, str):
                least = major.mean()
            chosen &= major >= least - _SHARE * abs(least)
        if self.region is not None:
            chosen &= self.region.contains(frame, float(frame.get("time", 0.0)), lattice)
        return chosen

    def frame(self, frame: Frame, lattice: Lattice, source: str) -> dict[str, Any]:
        """Find the chains of one step, with statistics of their lengths."""
        chains = self.find_chains(frame, lattice, source)
        lengths = chains["chain_particles"]
        statistics = statistics_of(lengths, self.min_length, self.lengths["length"])
        return chains | statistics | {name: frame[name] for name in COPIED}

    def find_chains(self, frame: Frame, lattice: Lattice, source: str) -> Frame:
        """Return arrays by particle, by contact and by chain, by the names in `RESULTS`.

        Threads share the stress and the test of contacts; the search itself, of links alone, is one
        thread's.
        """
        contacts = self.stress.contacts(frame, lattice, source, self.threads)
        stress = self.stress.evaluate(frame, contacts, lattice, source)
        major = stress["major_stress"]
        onward = np.nan_to_num(stress["major_direction"])
        qualifies = self.qualifies(frame, stress, lattice)
        i = contacts.i
        j = contacts.j
        particles = len(major)
        branch = contacts.between
        cosine = max(0.0, float(np.cos(np.deg2rad(self.alpha) + _ANGLE)))
        aligned = np.empty(len(i), bool)

        def test(first: int, last: int) -> None:
            some = slice(first, last)
            loops.aligned_contacts(
                i[some], j[some], branch[some], onward, qualifies, cosine, aligned[some]
            )

        for_parts(len(i), test, contacts.threads)
        graph = loops.graph_of(i, j, branch, aligned, particles)
        seeds = np.flatnonzero(qualifies)
        chain = np.full(particles, loops.UNSEEN)
        parent = np.full(particles, loops.UNSEEN)
        members = np.empty(particles, int)
        first = np.empty(particles + 1, int)
        unwrapped = frame["position"].copy()
        link = np.full(len(i), loops.UNSEEN)
        chains = loops.Chains(chain, parent, members, first, onward, unwrapped, link)
        if self.algorithm == "peters2005":
            seeds = seeds[np.argsort(-major[seeds], kind="stable")]
            count = loops.linear_chains(graph, seeds, self.min_length, chains)
        else:
            one_sided = bool(self.one_sided)
            count = loops.branching_chains(graph, seeds, one_sided, self.min_length, chains)
        links = np.empty(particles, int)
        loops.count_links(graph, link, links)
        by_chain = {
            name: np.full((count, 3)[: len(row.dims)], row.fill, row.dtype)
            for name, row in CHAINS.items()
        }
        shapes = loops.Shapes(*(by_chain[f"chain_{name}"] for name in _DESCRIBED))
        loops.describe_chains(chains, major, links, shapes)
        dropped = chain == loops.TOO_SHORT
        chain[dropped] = parent[dropped] = loops.UNSEEN
        return by_chain | {
            "chain_id": chain,
            "parent_id": np.where(parent >= 0, frame["particle_id"][parent], -1),
            "links": links,
            "branching": (links > 2).astype(int),
            "link_chain": link,
            **{name: values for name, values in stress.items() if name in RESULTS},
            "major_direction": np.where(np.isnan(stress["major_direction"]), np.nan, onward),
        }


# --- from step to step ------------------------------------------------------------------------------------


def track_chains(fc: xr.Dataset, overlap: float = 0.5) -> xr.Dataset:
    """Follow chains from step to step by the particles that they share (computes, one step at a time).

    Parameters
    ----------
    fc : xarray.Dataset
        A result of `force_chains`, with particles known by id in all steps.
    overlap : float
        Least share of common particles, above 0 and up to 1: the number that two chains have in
        common over the number in at least one of them (Jaccard index). Pairs of chains are taken
        from the largest share downward; each chain continues one chain at most. Above 0.5 no chain
        has two candidates.

    Returns
    -------
    xarray.Dataset
        ``track_id`` (time, chain), -1 for padding; ``births``, ``deaths`` and ``survivors`` (time):
        chains that continue none of the step before, chains of the step before that none continues,
        and the others; ``birth_time``, ``last_time``, ``lifetime`` (s) and ``steps`` (track). A
        track seen in one step has lifetime zero. What there is in the first step counts as born
        there, and what there is in the last does not die, so that lifetimes are lower bounds for
        these.

    Raises
    ------
    SceneError
        If `fc` is not a result of `force_chains`, or its times do not rise.
    ValueError
        If `overlap` is out of range, or the chains have no time dimension.
    """
    require_chains(fc, "track_chains", whole=("chain",))
    fc = with_time(fc)
    check("overlap", overlap, above(0, 1))
    if "time" not in fc.dims:
        raise ValueError(
            "the chains have no time dimension, expected several steps; keep it when selecting: fc.isel(time=[0, 1])"
        )
    Scene(fc).require_ids("track_chains")
    require_rising_times(fc, "track_chains")
    steps = fc.sizes["time"]
    track = np.full((steps, fc.sizes["chain"]), -1)
    survivors = np.zeros(steps, int)
    times = np.zeros(steps)
    tracks = 0
    before: tuple[NDArray, NDArray] = (np.zeros(0, int), np.zeros(0, int))
    for t, step in enumerate(steps_of(fc, ["chain_id"])):
        member = step.arrays["chain_id"] >= 0
        now = step.arrays["particle_id"][member], step.arrays["chain_id"][member]
        times[t] = step.time
        for a, b in _matches(before, now, overlap):
            track[t, b] = track[t - 1, a]
            survivors[t] += 1
        exists = np.unique(now[1])
        born = exists[track[t, exists] < 0]
        track[t, born] = tracks + np.arange(len(born))
        tracks += len(born)
        before = now
    number = (track >= 0).sum(axis=1)
    births = number - survivors
    deaths = np.append(0, number[:-1]) - survivors
    # a track is in all steps from its first to its last
    _, first, duration = np.unique(track[track >= 0], return_index=True, return_counts=True)
    first = np.nonzero(track >= 0)[0][first]
    birth = times[first]
    end = times[first + duration - 1]
    unit = unit_of_times(fc)
    in_step = partial(xr.Variable, "time")
    of_track = partial(xr.Variable, "track")
    table = {
        "track_id": (
            xr.Variable(("time", "chain"), track),
            "1",
            "track of the chain, -1 where there is none",
        ),
        "births": (in_step(births), "1", "chains that continue none of the step before"),
        "deaths": (in_step(deaths), "1", "chains of the step before that none continues"),
        "survivors": (in_step(survivors), "1", "chains that continue one of the step before"),
        "birth_time": (of_track(birth), unit, "first time of the track"),
        "last_time": (of_track(end), unit, "last time of the track"),
        "lifetime": (of_track(end - birth), unit, "time from first to last step"),
        "steps": (of_track(duration), "1", "steps of the track"),
    }
    data = labelled_table(table)
    coords = {name: fc[name].variable for name in ("time", "step") if name in fc.coords}
    return xr.Dataset(data, coords, provenance(fc, f"track_chains(overlap={overlap!r})"))


def _matches(
    before: tuple[NDArray, NDArray], now: tuple[NDArray, NDArray], overlap: float
) -> list[tuple[int, int]]:
    """Pairs of chains, each given by particle ids (sorted) and the chain of each, that share enough particles."""
    _, old, new = np.intersect1d(before[0], now[0], assume_unique=True, return_indices=True)
    if not old.size:
        return []
    pairs, common = np.unique(
        np.stack([before[1][old], now[1][new]], axis=1), axis=0, return_counts=True
    )
    a, b = pairs.T
    share = common / (np.bincount(before[1])[a] + np.bincount(now[1])[b] - common)
    matches: dict[int, int] = {}
    taken: set[int] = set()
    for k in np.lexsort((b, a, -share)).tolist():
        if share[k] >= overlap and a[k] not in matches and b[k] not in taken:
            matches[a[k]] = b[k]
            taken.add(b[k])
    return list(matches.items())
