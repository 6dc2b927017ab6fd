"""Results of a search for chains: labels, tables, and chains that are followed from step to step."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from xcg.chains.particle_stress import RESULTS as STRESSES
from xcg.common.checks import is_positive
from xcg.common.messages import SceneError
from xcg.scene.conform import with_components
from xcg.scene.description import Summary, rows_of_origin
from xcg.scene.frame import particle_rows, require_rising_times, with_time
from xcg.scene.lattice import Lattice
from xcg.scene.sanity import rows_of
from xcg.scene.schema import BOX, COMPONENTS, PADDING, VARIABLES, Frame, Variable, units_in
from xcg.steps.labels import provenance
from xcg.steps.mapping import each_step

COPIED = ("particle_id", "position", "diameter", "contact_i", "contact_j", "contact_force")


@dataclass(frozen=True)
class LengthStatistic:
    """A statistic of the lengths of the chains of one step.

    Attributes
    ----------
    variable : Variable
        Dimensions, unit and type.
    compute : callable
        ``compute(lengths)`` from the numbers of particles of the chains, an array (chains,) of at least one.
    """

    variable: Variable
    compute: Callable[[NDArray], float]


_OF_LENGTHS: dict[str, LengthStatistic] = {
    "length_mean": LengthStatistic(Variable((), "1", "mean length of the chains (particles)"), np.mean),
    "length_median": LengthStatistic(Variable((), "1", "median length of the chains (particles)"), np.median),
    "length_min": LengthStatistic(Variable((), "1", "shortest chain (particles)"), np.min),
    "length_max": LengthStatistic(Variable((), "1", "longest chain (particles)"), np.max),
}
STATISTICS: dict[str, Variable] = {
    "chain_count": Variable((), "1", "number of chains", "int64"),
    **{name: row.variable for name, row in _OF_LENGTHS.items()},
    "length_share": Variable(("length",), "1", "share of the chains that have this length, P(c)"),
}
CHAINS: dict[str, Variable] = {
    "chain_particles": Variable(("chain",), "1", "length of the chain: its particles", "int64"),
    "chain_links": Variable(("chain",), "1", "links of the chain", "int64"),
    "chain_branchings": Variable(("chain",), "1", "branching points of the chain", "int64"),
    "chain_stress": Variable(("chain",), "Pa", "mean major stress of the chain's particles"),
    "chain_orientation": Variable(("chain", "component"), "1", "axis of the chain's largest extent"),
    "chain_normal": Variable(("chain", "component"), "1", "normal of the chain's best-fit plane"),
}
MEMBERS: dict[str, Variable] = {
    "chain_id": Variable(("particle",), "1", "chain of the particle, -1 for none", "int64"),
    "parent_id": Variable(("particle",), "1", "id of the particle it was reached from, -1 for a seed", "int64"),
    "links": Variable(("particle",), "1", "links of the particle", "int64"),
    "branching": Variable(("particle",), "1", "1 where the particle has more than two links", "int64"),
    "link_chain": Variable(("contact",), "1", "chain that the contact is a link of, -1 for none", "int64"),
}
RESULTS: dict[str, Variable] = (
    {name: VARIABLES[name] for name in COPIED}
    | MEMBERS
    | {name: row for name, row in STRESSES.items() if name not in ("particle_id", "stress")}
    | CHAINS
    | STATISTICS
)


def result_sizes(particles: int, contacts: int, min_length: int) -> dict[str, int]:
    """Sizes of the dimensions of a result: as many chains, and as long ones, as there could be, but at least one."""
    chains, lengths = max(1, particles // min_length), max(1, particles - min_length + 1)
    return {"particle": particles, "contact": contacts, "chain": chains, "length": lengths}


def statistics_of(lengths: NDArray, min_length: int, bins: int) -> dict[str, NDArray | float]:
    """Statistics of the lengths of the chains of one step, by the names in `STATISTICS`; NaN without chains."""
    count = len(lengths)
    found: dict[str, NDArray | float] = {"chain_count": count}
    found |= {name: row.compute(lengths) if count else np.nan for name, row in _OF_LENGTHS.items()}
    found["length_share"] = np.bincount(lengths - min_length, minlength=bins)[:bins] / max(count, 1)
    return found


def require_chains(fc: xr.Dataset, purpose: str) -> None:
    """Raise SceneError unless a Dataset is a result of `force_chains`.

    Raises
    ------
    SceneError
        If it lacks ``chain_id`` or ``link_chain``; the message says how to get them.
    """
    missing = [name for name in ("chain_id", "link_chain", "particle_id") if name not in fc]
    if missing:
        raise SceneError(
            f"{purpose} needs {missing}, which this Dataset does not hold; call it on a result of ds.cg.force_chains()"
        )


def summary_of_chains(fc: xr.Dataset) -> Summary:
    """Return a summary of a result of `force_chains`, without computing it."""
    fc = with_time(fc)
    words = {"time": "steps", "particle": "particles", "contact": "contacts"}
    sizes = ", ".join(f"{fc.sizes[dim]} {word}" for dim, word in words.items() if dim in fc.sizes)
    rule = ", ".join(f"{name} = {fc.attrs[name]}" for name in ("alpha", "min_length", "algorithm") if name in fc.attrs)
    kinds = (("particles", MEMBERS), ("chains", CHAINS), ("steps", STATISTICS))
    held = [(what, ", ".join(name for name in rows if name in fc)) for what, rows in kinds]
    return Summary.of(f"force chains of {sizes} (largest step)", [("rule", rule), *held, *rows_of_origin(fc)])


@dataclass(frozen=True, eq=False)
class ChainStep:
    """Single step of a result, in memory.

    Attributes
    ----------
    arrays : Frame
        Variables by name, without padding (by chain: row k is chain k).
    time : float
        Time (s).
    number : int
        Number of the time step.
    lattice : Lattice
        Periodic images.
    """

    arrays: Frame
    time: float
    number: int
    lattice: Lattice

    def links(self) -> tuple[NDArray, NDArray, NDArray]:
        """Contact rows of the links, and the rows of the two particles of each."""
        contact = np.flatnonzero(self.arrays["link_chain"] >= 0)
        ids = self.arrays["particle_id"]
        i, j = (rows_of(ids, self.arrays[name][contact]) for name in ("contact_i", "contact_j"))
        return contact, i, j


def steps_of(fc: xr.Dataset, names: Sequence[str]) -> Iterator[ChainStep]:
    """Yield the steps of a result one after the other, each chunk of time computed once."""
    fc = with_time(with_components(fc))
    if "time" not in fc.dims:
        fc = fc.expand_dims("time")
    names = [*dict.fromkeys(("particle_id", "contact_i", *names))]
    for t, one in enumerate(each_step(fc[[*names, *(BOX.keys() & set(fc.data_vars))]])):
        step = one.isel(time=0)
        valid = step.contact_i.to_numpy() != PADDING
        rows: dict[str, Any] = {"particle": particle_rows(step.particle_id.to_numpy()), "contact": valid}
        arrays = {}
        for name in names:
            dims = RESULTS[name].dims
            values = step[name].transpose(*dims).to_numpy()
            arrays[name] = values[rows[dims[0]]] if dims[0] in rows else values
        number = int(step["step"]) if "step" in step.coords else t
        box = {name: step[name].transpose(*row.dims).to_numpy() for name, row in BOX.items() if name in step}
        lattice = Lattice.of(box, fc.attrs.get("periodic", ""), f"step {number}")
        yield ChainStep(arrays, float(step["time"]) if "time" in step.coords else 0.0, number, lattice)


def chain_table(fc: xr.Dataset) -> pd.DataFrame:
    """Table of all chains (computes, one step at a time).

    Returns
    -------
    pandas.DataFrame
        One row a chain and step: ``time``, ``step``, ``chain``, ``particles``, ``links``, ``branchings``, ``stress``
        (Pa), ``orientation_x`` ... and ``normal_x`` ....

    Raises
    ------
    SceneError
        If `fc` is not a result of `force_chains`, or has no step.
    """

    def columns(step: ChainStep) -> dict[str, NDArray]:
        chain = np.flatnonzero(step.arrays["chain_particles"] > 0)
        found = {"chain": chain}
        for name, row in CHAINS.items():
            values, short = step.arrays[name][chain], name.removeprefix("chain_")
            if "component" in row.dims:
                found |= {f"{short}_{axis}": values[:, k] for k, axis in enumerate(COMPONENTS)}
            else:
                found[short] = values
        return found

    return _table(fc, "chain_table", list(CHAINS), columns)


def link_table(fc: xr.Dataset) -> pd.DataFrame:
    """Table of all links (computes, one step at a time).

    Returns
    -------
    pandas.DataFrame
        One row a link and step: ``time``, ``step``, ``chain``, ``contact`` (its row among the contacts of the step),
        ``particle_i`` and ``particle_j`` (ids), ``force`` (magnitude, N) and ``stress`` (mean major stress of the two
        particles, Pa).

    Raises
    ------
    SceneError
        If `fc` is not a result of `force_chains`, or has no step.
    """

    def columns(step: ChainStep) -> dict[str, NDArray]:
        contact, i, j = step.links()
        arrays = step.arrays
        return {
            "chain": arrays["link_chain"][contact],
            "contact": contact,
            "particle_i": arrays["contact_i"][contact],
            "particle_j": arrays["contact_j"][contact],
            "force": np.linalg.norm(arrays["contact_force"][contact], axis=1),
            "stress": 0.5 * (arrays["major_stress"][i] + arrays["major_stress"][j]),
        }

    return _table(fc, "link_table", ["link_chain", "contact_j", "contact_force", "major_stress"], columns)


def _table(
    fc: xr.Dataset, purpose: str, names: Sequence[str], columns: Callable[[ChainStep], dict[str, NDArray]]
) -> pd.DataFrame:
    """Join the columns of all steps below each other, with time and number of the step."""
    require_chains(fc, purpose)
    if not fc.sizes.get("time", 1):
        raise SceneError(f"{purpose} needs one step or more, and these chains have none: check how steps were selected")
    steps = steps_of(fc, names)
    tables = [pd.DataFrame({"time": step.time, "step": step.number, **columns(step)}) for step in steps]
    return pd.concat(tables, ignore_index=True)


def track_chains(fc: xr.Dataset, overlap: float = 0.5) -> xr.Dataset:
    """Follow chains from step to step by the particles that they share (computes, one step at a time).

    Parameters
    ----------
    fc : xarray.Dataset
        A result of `force_chains`, with particles known by id in all steps.
    overlap : float
        Least share of common particles, above 0 and up to 1: the number that two chains have in common over the
        number in at least one of them (Jaccard index). Pairs of chains are taken from the largest share downward; each
        chain continues one chain at most. Above 0.5 no chain has two candidates.

    Returns
    -------
    xarray.Dataset
        ``track_id`` (time, chain), -1 for padding; ``births``, ``deaths`` and ``survivors`` (time):
        chains that continue none of the step before, chains of the step before that none continues, and the others;
        ``birth_time``, ``last_time``, ``lifetime`` (s) and ``steps`` (track). A track seen in one step has lifetime
        zero. What there is in the first step counts as born there, and what there is in the last does not die, so
        that lifetimes are lower bounds for these.

    Raises
    ------
    SceneError
        If `fc` is not a result of `force_chains`, or its times do not rise.
    ValueError
        If `overlap` is out of range, or the chains have no time dimension.
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
