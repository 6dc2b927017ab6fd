"""Chains over time: which chain of a step is that of the step before."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.chains.results import require_chains, steps_of
from xcg.common.checks import is_positive
from xcg.scene.frame import require_rising_times, with_time
from xcg.scene.schema import units_in
from xcg.steps.labels import provenance


def track_chains(fc: xr.Dataset, overlap: float = 0.5) -> xr.Dataset:
    """Follow chains from step to step by the particles that they share (computes, one step at a time).

    Parameters
    ----------
    fc : xarray.Dataset
        A result of `force_chains`, with particles known by id in all steps.
    overlap : float
        Least share of common particles, above 0 and up to 1: the number that two chains have in common over the
        number in either of them. Pairs of chains are taken from the largest share downward; each chain continues one
        chain at most. Above 0.5 no chain has two candidates.

    Returns
    -------
    xarray.Dataset
        ``track_id`` (time, chain), -1 where there is no chain; ``births``, ``deaths`` and ``survivors`` (time):
        chains that continue none of the step before, chains of the step before that none continues, and the others;
        ``birth_time``, ``last_time``, ``lifetime`` (s) and ``steps`` (track). A track seen in one step has lifetime
        zero. What there is in the first step counts as born there, and what there is in the last does not die, so
        that lifetimes are lower bounds for these.

    Raises
    ------
    SceneError
        If `fc` is not a result of `force_chains`, or its times do not rise.
    ValueError
        If `overlap` is out of range.
    """
    require_chains(fc, "track_chains")
    fc = with_time(fc)
    if not (is_positive(overlap) and overlap <= 1):
        raise ValueError(f"overlap={overlap!r}: expected a share above 0 and up to 1, for example 0.5")
    if "time" not in fc.dims:
        raise ValueError(
            "the chains have no time dimension, expected several steps; keep it when selecting: fc.isel(time=[0, 1])"
        )
    require_rising_times(fc, "track_chains")
    chains, steps = fc.sizes["chain"], fc.sizes["time"]
    track = np.full((steps, chains), -1)
    births, deaths, survivors = (np.zeros(steps, int) for _ in range(3))
    times = np.zeros(steps)
    first: list[int] = []  # step, by track
    last: list[int] = []
    seen: list[int] = []
    before: tuple[NDArray, NDArray] = (np.zeros(0, int), np.zeros(0, int))
    for t, step in enumerate(steps_of(fc, ["chain_id"])):
        member = step.arrays["chain_id"] >= 0
        now = step.arrays["particle_id"][member], step.arrays["chain_id"][member]
        times[t] = step.time
        exists = np.unique(now[1])
        for a, b in _matches(before, now, overlap):
            track[t, b] = track[t - 1, a]
            survivors[t] += 1
        if t:
            deaths[t] = (track[t - 1] >= 0).sum() - survivors[t]
        born = exists[track[t, exists] < 0]
        births[t] = len(born)
        track[t, born] = len(first) + np.arange(len(born))
        first += [t] * len(born)
        last += [t] * len(born)
        seen += [0] * len(born)
        for k in track[t, exists]:
            last[k] = t
            seen[k] += 1
        before = now
    second = units_in("s", fc.attrs.get("unit_system", "SI"))
    birth, end = times[np.array(first, int)], times[np.array(last, int)]
    data = {
        "track_id": (("time", "chain"), track, {"long_name": "track of the chain, -1 where there is none"}),
        "births": ("time", births, {"long_name": "chains that continue none of the step before"}),
        "deaths": ("time", deaths, {"long_name": "chains of the step before that none continues"}),
        "survivors": ("time", survivors, {"long_name": "chains that continue one of the step before"}),
        "birth_time": ("track", birth, {"units": second, "long_name": "first time of the track"}),
        "last_time": ("track", end, {"units": second, "long_name": "last time of the track"}),
        "lifetime": ("track", end - birth, {"units": second, "long_name": "time from first to last step"}),
        "steps": ("track", np.array(seen, int), {"long_name": "steps of the track"}),
    }
    coords = {name: fc[name].variable for name in ("time", "step") if name in fc.coords}
    return xr.Dataset(data, coords, provenance(fc, f"track_chains(overlap={overlap!r})"))


def _matches(before: tuple[NDArray, NDArray], now: tuple[NDArray, NDArray], overlap: float) -> list[tuple[int, int]]:
    """Pairs of chains, each given by particle ids (sorted) and the chain of each, that share enough particles."""
    _, old, new = np.intersect1d(before[0], now[0], assume_unique=True, return_indices=True)
    if not old.size:
        return []
    pairs, common = np.unique(np.stack([before[1][old], now[1][new]], axis=1), axis=0, return_counts=True)
    a, b = pairs.T
    share = common / (np.bincount(before[1])[a] + np.bincount(now[1])[b] - common)
    taken_a: set[int] = set()
    taken_b: set[int] = set()
    matches = []
    for k in np.lexsort((b, a, -share)):
        if share[k] < overlap or a[k] in taken_a or b[k] in taken_b:
            continue
        taken_a.add(int(a[k]))
        taken_b.add(int(b[k]))
        matches.append((int(a[k]), int(b[k])))
    return matches
