"""Facts that hold for a whole scene or result, such as periodic axes or the kernel: how they travel through xarray.

They are attributes. xarray drops attributes when Datasets are built from variables, and takes those
of the first part when it joins several. So a scalar coordinate, ``setup``, holds the same facts as
JSON: xarray keeps scalar coordinates with every variable, refuses to merge unequal ones, and joins
unequal ones to a value for each part.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from xcg.common.messages import SceneError, plain

SETUP = "setup"
# attributes of a scene that numbers depend on, without those that follow from its variables
OF_SCENES = (
    "periodic",
    "dimension",
    "plane",
    "thickness",
    "unit_system",
    "gravity",
    "frame",
    "frame_axes",
    "frame_origin",
)
# further attributes of a result that its averages depend on, or that sums of different calls have
# to share
OF_RESULTS = (
    "kernel",
    "width",
    "cutoff",
    "kernel_dimension",
    "gradient",
    "pressure_dims",
    "shear_dims",
    "deviatoric",
    "size",
    "size_diameter",
    "temperature",
    "sampling",
    "averaged_axes",
    "wrapped_axes",
    "extent",
    "fluid_viscosity",
    "friction",
    "lag",
    "per",
)


# present names of fields, by their names in results of earlier versions
RENAMED = {
    "wall_traction": "boundary_force_density",
    "effective_viscosity": "relative_viscosity",
}


def with_present_names(f: xr.Dataset) -> xr.Dataset:
    """Return a result with its fields, and their errors, under their present names."""
    names = {}
    for old, new in RENAMED.items():
        for end in ("", "_error", "_error_from", "_bias"):
            if old + end in f.variables and new + end not in f.variables:
                names[old + end] = new + end
    return f.rename(names)


def setup_of(attrs: Mapping[Any, Any]) -> xr.Variable:
    """Return the coordinate `setup` of a Dataset with these attributes."""
    facts = {name: attrs[name] for name in (*OF_SCENES, *OF_RESULTS) if name in attrs}
    if facts.get("size") not in ("d50", "dmax"):
        facts.pop("size_diameter", None)  # d43 and d32 are those of each node
    text = json.dumps({name: np.asarray(value).tolist() for name, value in facts.items()})
    about = {"long_name": "attributes that hold for all steps, as JSON"}
    # Zarr 3 specifies no text of fixed length
    return xr.Variable((), text, about, {"dtype": object})


def with_setup(ds: xr.Dataset) -> xr.Dataset:
    """Return the Dataset with the coordinate `setup` made anew, after its attributes were changed."""
    return ds.assign_coords({SETUP: setup_of(ds.attrs)})


def with_facts(ds: xr.Dataset) -> xr.Dataset:
    """Return the Dataset with the attributes that it lost and its coordinate `setup` holds.

    Attributes that are there are kept, as users may have changed them. Fields of results get their
    present names.

    Raises
    ------
    SceneError
        If parts with different facts were joined, or the coordinate is something else.
    """
    if "particle" not in ds.dims:  # scenes may call their variables anything
        ds = with_present_names(ds)
    if SETUP not in ds.coords:
        return ds
    parts = [
        _facts_of(text) for text in dict.fromkeys(np.ravel(ds.coords[SETUP].to_numpy()).tolist())
    ]
    if len(parts) > 1:
        raise SceneError(
            f"parts that differ were joined: {_differences(parts)}. Fields and averages need parts of one kind: take "
            "the parts one by one, and join their averages"
        )
    lost = {name: value for part in parts for name, value in part.items() if name not in ds.attrs}
    if not lost:
        return ds
    return ds.assign_attrs(lost)


def _facts_of(text: Any) -> dict[str, Any]:
    """Return the facts that a value of the coordinate holds."""
    try:
        facts = json.loads(text)
    except (TypeError, ValueError):  # of values that are no text, and of other texts
        facts = None
    if not isinstance(facts, dict):
        raise SceneError(
            f"the coordinate {SETUP!r} holds {plain(text)}, expected the JSON object that xcg writes: leave it out, "
            f"ds.drop_vars({SETUP!r}), or give a coordinate of your own another name"
        )
    return facts


def _differences(parts: Sequence[dict[str, Any]]) -> str:
    """Return the names of the facts that differ between parts, with two of their values each."""
    texts = []
    for name in (*OF_SCENES, *OF_RESULTS):
        values = list(dict.fromkeys(json.dumps(part.get(name)) for part in parts))
        if len(values) > 1:
            texts.append(f"{name} is {values[0]} and {values[1]}".replace("null", "not given"))
    return "; ".join(texts)


def require_facts(ds: xr.Dataset, names: Sequence[str], purpose: str, way_out: str) -> None:
    """Raise SceneError unless the Dataset has these attributes; the message lists the missing ones."""
    missing = [name for name in names if name not in ds.attrs]
    if missing:
        raise SceneError(
            f"{purpose} has lost its attributes {', '.join(missing)}, without which numbers would be wrong: copy them "
            f"from the original, ds.attrs = original.attrs, {way_out}"
        )
