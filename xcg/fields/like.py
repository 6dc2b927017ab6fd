"""Requests on the mesh and with the options of a result, so that two runs can be compared."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from xcg.common.messages import SceneError
from xcg.fields.request import Request
from xcg.scene.facts import SAVED_OPTIONS, require_facts, saved_options, with_facts
from xcg.scene.frame import with_rising
from xcg.scene.schema import COMPONENTS

_SAME_NODES = 1e-9  # of the spacing


def request_like(request: Request) -> Request:
    """Fill in a request from the result in its argument `like`, and take that out.

    Raises
    ------
    SceneError
        If the result has lost the attributes that say how it was made.
    ValueError
        If it is not a result of `coarse_grain` in Cartesian axes with one width, or the request names
        what `like` determines.
    """
    result = request.like
    if not isinstance(result, xr.Dataset):
        raise ValueError(f"like={type(result).__name__}: expected a result of coarse_grain")
    f = with_facts(result)
    if "kernel" not in f.attrs and "position" in f:
        raise ValueError("like= is a scene: expected a result of coarse_grain")
    passed_on = {name: option for name, option in SAVED_OPTIONS.items() if option.for_like}
    required = [name for name, option in passed_on.items() if option.always]
    require_facts(f, required, "like=", "coarse-grain it again")
    if "r" in f.coords or "theta" in f.coords:
        raise ValueError(
            "like= has cylindrical axes: give axes=, spacing= and bounds= to both calls"
        )
    if f.attrs.get("sampling") == "cell":
        raise ValueError(
            "like= holds averages over cells, which earlier versions computed (sampling='cell'): "
            "give width=, spacing= and bounds= to both calls"
        )
    if np.ndim(f.attrs["width"]):
        raise ValueError("like= has a width for each group: give the same width= to both calls")
    saved = saved_options(f.attrs)
    options = {name: saved[name] for name in passed_on if name in saved} | arguments_of_nodes(f)
    if options["temperature"] == "mixture":
        options["temperature"] = "unbiased"  # with the same by=
    if "phase" in f.dims:
        options["by"] = str(f["phase"].attrs.get("long_name", "")).removeprefix("phase by ")
        options["groups"] = groups_of(f)
    named = request.changed(list(options))
    if named:
        raise ValueError(
            f"{', '.join(f'{name}=' for name in named)} and like=: the result given by like= "
            "determines this; leave one out"
        )
    return replace(request, like=None, **options)


def groups_of(f: xr.Dataset) -> list[int]:
    """Return the groups of the phases of a result, without the bulk."""
    labels = f["phase"].to_numpy().tolist()
    return [int(label) for label in labels if label != "bulk"]


def arguments_of_nodes(f: xr.Dataset) -> dict[str, Any]:
    """Return the arguments that lay the nodes of a result in Cartesian axes."""
    f = with_rising(f, COMPONENTS)
    at: dict[str, Any] = {}
    bounds: dict[str, tuple[float, float]] = {}
    spacing: dict[str, float] = {}
    for a in COMPONENTS:
        if a not in f.coords:
            continue
        nodes = f[a]
        if nodes.dims != (a,):
            at[a] = nodes
            if nodes.ndim == 0:
                at[a] = float(nodes)
            continue
        bounds[a] = (float(nodes[0]), float(nodes[-1]))
        # a single node fills a period, or has the spacing of a call by default
        spacing[a] = float(nodes.attrs.get("period", np.max(f.attrs["width"])))
        if nodes.size > 1:
            spacing[a] = (bounds[a][1] - bounds[a][0]) / (nodes.size - 1)
    return {
        "axes": "".join(bounds),
        "at": at or None,
        "bounds": bounds or None,
        "spacing": spacing or None,
    }


def with_nodes_of(f: xr.Dataset, like: xr.Dataset) -> xr.Dataset:
    """Return a result with the nodes of another, which are the same to rounding.

    xarray aligns nodes that are equal to the last bit only.

    Raises
    ------
    SceneError
        If nodes differ by more than rounding.
    """
    like = with_rising(like, COMPONENTS)
    nodes: dict[Hashable, xr.DataArray] = {}
    for a in COMPONENTS:
        if a not in f.dims or a not in like.dims:
            continue
        x = like[a].to_numpy()
        room = _SAME_NODES
        if len(x) > 1:
            room *= abs(x[1] - x[0])
        if f.sizes[a] != len(x) or not np.allclose(f[a], x, rtol=_SAME_NODES, atol=room):
            raise SceneError(
                f"like=: the nodes along {a} are {len(x)} in that result, {f.sizes[a]} here; "
                "give bounds= and spacing= to both calls"
            )
        nodes[a] = f[a].copy(data=x)
    return f.assign_coords(nodes)
