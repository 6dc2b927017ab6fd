"""Chains and links as tables: one row each, no padding."""

from __future__ import annotations

import numpy as np
import pandas as pd
import xarray as xr

from xcg.chains.results import CHAINS, require_chains, steps_of
from xcg.scene.schema import COMPONENTS, SceneError


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
    require_chains(fc, "chain_table")
    _require_steps(fc, "chain_table")
    tables = []
    for step in steps_of(fc, list(CHAINS)):
        chain = np.flatnonzero(step.arrays["chain_particles"] > 0)
        columns = {"time": step.time, "step": step.number, "chain": chain}
        for name, row in CHAINS.items():
            values = step.arrays[name][chain]
            short = name.removeprefix("chain_")
            if "component" in row.dims:
                columns |= {f"{short}_{axis}": values[:, k] for k, axis in enumerate(COMPONENTS)}
            else:
                columns[short] = values
        tables.append(pd.DataFrame(columns))
    return pd.concat(tables, ignore_index=True)


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
    require_chains(fc, "link_table")
    _require_steps(fc, "link_table")
    tables = []
    for step in steps_of(fc, ["link_chain", "contact_j", "contact_force", "major_stress"]):
        contact, i, j = step.links()
        major = step.arrays["major_stress"]
        columns = {
            "time": step.time,
            "step": step.number,
            "chain": step.arrays["link_chain"][contact],
            "contact": contact,
            "particle_i": step.arrays["contact_i"][contact],
            "particle_j": step.arrays["contact_j"][contact],
            "force": np.linalg.norm(step.arrays["contact_force"][contact], axis=1),
            "stress": 0.5 * (major[i] + major[j]),
        }
        tables.append(pd.DataFrame(columns))
    return pd.concat(tables, ignore_index=True)


def _require_steps(fc: xr.Dataset, purpose: str) -> None:
    """Refuse a result that a selection left without steps."""
    if not fc.sizes.get("time", 1):
        raise SceneError(f"{purpose} needs one step or more, and these chains have none: check how steps were selected")
