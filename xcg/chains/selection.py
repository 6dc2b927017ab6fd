"""Some of the chains of a result: by region and by stress."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.chains.regions import Region
from xcg.chains.results import CHAINS, MEMBERS, STATISTICS, require_chains, result_sizes, statistics_of
from xcg.scene.conform import takes_scene
from xcg.scene.frame import particle_rows, steps_in
from xcg.scene.numbers import is_finite
from xcg.scene.schema import OF_STEP
from xcg.steps.label import label, results_of
from xcg.steps.map import map_over_time

_GRAINS = ("particle_id", "position", "major_stress", *OF_STEP)
OF = {"any": np.logical_or, "all": np.logical_and}


@dataclass(frozen=True)
class _Condition:
    """What the particles of a chain must fulfil, any or all of them."""

    region: Region | None
    min_stress: float | None
    of: str
    periodic: str
    min_length: int


@takes_scene
def select_chains(
    fc: xr.Dataset, region: Region | None = None, *, min_stress: float | None = None, of: str = "any"
) -> xr.Dataset:
    """Keep the chains whose particles fulfil a condition; the others are dropped as if they had not been found.

    Conditions combine: regions with ``&``, ``|`` and ``~``; one selection after the other; and region and stress of
    one call hold for the same particle. Lazy where the result is.

    Parameters
    ----------
    fc : xarray.Dataset
        A result of `force_chains`.
    region : Region, optional
        Where particles must be: `xcg.Box`, `xcg.Sphere`, or a combination.
    min_stress : float, optional
        Least major stress (Pa).
    of : str
        "any" (default) keeps a chain if one of its particles fulfils the condition, "all" if all of them do.

    Returns
    -------
    xarray.Dataset
        The same variables. Chains keep their numbers, dropped ones leave padding; statistics are those of the chains
        that are left.

    Raises
    ------
    SceneError
        If `fc` is not a result of `force_chains`.
    ValueError
        If an argument is wrong.
    """
    require_chains(fc, "select_chains")
    if of not in OF:
        raise ValueError(f"of={of!r}: expected 'any' or 'all' of a chain's particles")
    if region is None and min_stress is None:
        raise ValueError("nothing to select by: give region= (xcg.Box, xcg.Sphere), min_stress= (Pa), or both")
    if region is not None and not isinstance(region, Region):
        raise ValueError(
            f"region={region!r}: expected xcg.Box(lower, upper), xcg.Sphere(centre, radius), or a combination"
        )
    if min_stress is not None and not is_finite(min_stress):
        raise ValueError(f"min_stress={min_stress!r}: expected a finite stress (Pa), or None")
    condition = _Condition(region, min_stress, of, fc.attrs.get("periodic", ""), int(fc.attrs.get("min_length", 3)))
    changed = MEMBERS | CHAINS | STATISTICS
    names = [*(name for name in (*_GRAINS, "time") if name in fc), *MEMBERS, *CHAINS]
    arrays = map_over_time(fc, names, partial(_compute, condition), results_of(changed, fc.sizes), "select-chains")
    given = {"region": region, "min_stress": min_stress, "of": of}
    call = ", ".join(f"{name}={value!r}" for name, value in given.items() if value is not None)
    selected = label(fc, changed, arrays, f"select_chains({call})")
    return fc.assign(selected.data_vars).assign_attrs(history=selected.attrs["history"])


def _compute(condition: _Condition, arrays: Mapping[str, NDArray]) -> dict[str, NDArray]:
    """Chains of one chunk of time that fulfil a condition, from padded arrays."""
    out = {name: arrays[name].copy() for name in (*MEMBERS, *CHAINS)}
    steps, particles = arrays["particle_id"].shape
    lengths = result_sizes(particles, 0, condition.min_length)["length"]
    for name, row in STATISTICS.items():
        out[name] = np.empty((steps, *(lengths,) * len(row.dims)), row.dtype)
    grains = {name: arrays[name] for name in _GRAINS if name in arrays}
    for t, (frame, lattice, _) in enumerate(steps_in(grains, condition.periodic)):
        fulfilled = np.ones(len(frame["particle_id"]), bool)
        if condition.region is not None:
            time = float(arrays["time"][t]) if "time" in arrays else 0.0
            fulfilled &= condition.region.contains(frame, time, lattice)
        if condition.min_stress is not None:
            fulfilled &= frame["major_stress"] >= condition.min_stress
        inside = np.zeros(particles, bool)
        inside[particle_rows(arrays["particle_id"][t])] = fulfilled
        kept = _kept(arrays["chain_id"][t], arrays["chain_particles"][t] > 0, inside, condition.of)
        _drop(out, t, kept)
        for name, value in statistics_of(out["chain_particles"][t][kept], condition.min_length, lengths).items():
            out[name][t] = value
    return out


def _kept(chain: NDArray, exists: NDArray, inside: NDArray, of: str) -> NDArray:
    """Tell which chains have any, or all, of their particles inside."""
    kept = np.full(len(exists), of == "all")
    member = chain >= 0
    OF[of].at(kept, chain[member], inside[member])
    return kept & exists


def _drop(out: Mapping[str, NDArray], t: int, kept: NDArray) -> None:
    """Replace everything of the other chains by padding, or by no chain."""
    lost = (out["chain_id"][t] >= 0) & ~kept[out["chain_id"][t]]
    for name, none in (("chain_id", -1), ("parent_id", -1), ("links", 0), ("branching", 0)):
        out[name][t][lost] = none
    link = out["link_chain"][t]
    link[(link >= 0) & ~kept[link]] = -1
    for name, row in CHAINS.items():
        out[name][t][~kept] = row.fill
