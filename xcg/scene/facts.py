"""Facts that hold for a whole scene or result, such as periodic axes or the kernel: how they travel through xarray.

They are attributes. xarray drops attributes when Datasets are built from variables, and takes those
of the first part when it joins several. So a scalar coordinate, ``setup``, has the same facts as
attributes of its own, and a short code of them as its value: xarray keeps scalar coordinates with
every variable, refuses to merge unequal ones, and joins unequal ones to a value for each part.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

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
_ALWAYS = ("periodic", "dimension", "plane", "unit_system")


def extent_text(lengths: Mapping[str, float]) -> str:
    """Return the attribute ``extent`` of a result: lengths of averages along axes (m)."""
    return ", ".join(f"{axis} = {float(length)!r}" for axis, length in lengths.items())


def _lengths_of(text: str) -> dict[str, float]:
    """Return the lengths of averages (m) by axis from the attribute ``extent``, which was JSON in earlier versions."""
    if text.startswith("{"):
        return json.loads(text)
    lengths = {}
    for part in text.split(", "):
        axis, length = part.split(" = ")
        lengths[axis] = float(length)
    return lengths


class SavedOption(NamedTuple):
    """Option of a result: an attribute, which its averages and calls with ``like=`` read.

    Attributes
    ----------
    read : callable
        Converts what a file may hold in place of the value.
    always : bool
        Whether all results of `coarse_grain` have it.
    for_like : bool
        Whether ``like=`` passes it to the next call.
    is_fact : bool
        Whether averages depend on it, or sums of different calls have to share it: the coordinate
        `setup` then holds it.
    """

    read: Callable[[Any], Any]
    always: bool = True
    for_like: bool = True
    is_fact: bool = True


SAVED_OPTIONS: dict[str, SavedOption] = {
    "kernel": SavedOption(str),
    "width": SavedOption(float),
    "cutoff": SavedOption(float, for_like=False),
    "kernel_dimension": SavedOption(int, for_like=False),
    "gradient": SavedOption(str),
    "pressure_dims": SavedOption(str),
    "shear_dims": SavedOption(str, always=False),
    "deviatoric": SavedOption(str),
    "size": SavedOption(str),
    "size_diameter": SavedOption(float, always=False, for_like=False),
    "temperature": SavedOption(str),
    "sampling": SavedOption(str, always=False, for_like=False),  # of earlier versions
    "averaged_axes": SavedOption(str, for_like=False),
    "wrapped_axes": SavedOption(str, for_like=False),
    "extent": SavedOption(_lengths_of, always=False),
    "fluid_viscosity": SavedOption(float, always=False),
    "friction": SavedOption(float, always=False),
    "lag": SavedOption(int, always=False, for_like=False),
    "per": SavedOption(str, always=False, for_like=False),
    "rtol": SavedOption(float, is_fact=False),
}
OF_RESULTS = tuple(name for name, option in SAVED_OPTIONS.items() if option.is_fact)


def saved_options(attrs: Mapping[Any, Any]) -> dict[str, Any]:
    """Return the options that a result was computed with, from its attributes; values by group stay arrays."""
    options: dict[str, Any] = {}
    for name, option in SAVED_OPTIONS.items():
        if name in attrs:
            options[name] = attrs[name] if np.ndim(attrs[name]) else option.read(attrs[name])
    return options


# present names of fields, by their names in results of earlier versions
RENAMED = {
    "wall_traction": "boundary_force_density",
    "effective_viscosity": "relative_viscosity",
}
# the same of results of depth_average, which alone have a mass per area
_OF_DEPTH = {"depth": "solid_depth"}


def with_present_names(f: xr.Dataset) -> xr.Dataset:
    """Return a result with its fields, and their errors, under their present names."""
    names = {}
    table = RENAMED
    if "mass_per_area" in f.variables:
        table = RENAMED | _OF_DEPTH
    for old, new in table.items():
        for end in ("", "_error", "_error_from", "_bias"):
            if old + end in f.variables and new + end not in f.variables:
                names[old + end] = new + end
    return f.rename(names)


_CODE = re.compile("[0-9a-f]{8}")  # as the coordinate holds it
# facts by their codes, of this process: messages about joined parts name what differs
_SEEN: dict[str, dict[str, Any]] = {}


def setup_of(attrs: Mapping[Any, Any]) -> xr.Variable:
    """Return the coordinate `setup` of a Dataset with these attributes."""
    code, facts = _coded(attrs)
    # Zarr 3 specifies no text of fixed length
    return xr.Variable((), code, facts, {"dtype": object})


def with_setup(ds: xr.Dataset) -> xr.Dataset:
    """Return the Dataset with the coordinate `setup` made anew, after its attributes were changed."""
    return ds.assign_coords({SETUP: setup_of(ds.attrs)})


def with_facts(ds: xr.Dataset) -> xr.Dataset:
    """Return the Dataset with the attributes that it lost and its coordinate `setup` has.

    Attributes that are there are kept, as users may have changed them. Fields of results get their
    present names, and text of earlier versions (JSON) in the coordinate becomes a code with
    attributes.

    Raises
    ------
    SceneError
        If parts with different facts were joined, the coordinate has lost its attributes, too, or is
        something else.
    """
    if "particle" not in ds.dims:  # scenes may call their variables anything
        ds = with_present_names(ds)
    if SETUP not in ds.coords:
        return ds
    setup = ds.variables[SETUP]
    code, facts = _coded(setup.attrs)
    values = dict.fromkeys(np.ravel(setup.to_numpy()).tolist())
    if list(values) != [code]:
        return _with_unlike_facts(ds, values)
    lost = {name: value for name, value in facts.items() if name not in ds.attrs}
    if lost:
        ds = ds.assign_attrs(lost)
    return ds


def _with_unlike_facts(ds: xr.Dataset, values: Iterable[Any]) -> xr.Dataset:
    """Return `with_facts` of a Dataset whose coordinate has `values` that are not the code of its attributes."""
    parts = {}
    for value in values:
        if isinstance(value, str) and _CODE.fullmatch(value):
            _, parts[value] = _coded(ds.variables[SETUP].attrs)
            continue
        code, facts = _coded(_json_object(value))
        parts[code] = facts
        ds = ds.assign_coords({SETUP: setup_of(facts)})
    if len(parts) > 1:
        raise SceneError(
            f"parts that differ were joined: {_differences(list(parts))}. Fields and averages need parts of one kind: "
            "take the parts one by one, and join their averages"
        )
    for code, facts in parts.items():
        if _coded(facts)[0] == code:  # that of the text of an earlier version
            return with_facts(ds)
        _require_code(ds, code, facts)
    return ds


def _coded(attrs: Mapping[Any, Any]) -> tuple[str, dict[str, Any]]:
    """Return eight hexadecimal digits for the attributes that numbers depend on, and these, and remember both.

    The digits are the same when a file holds the attributes: files store whole numbers as floats,
    and lists of one number as the number.
    """
    facts = {name: attrs[name] for name in (*OF_SCENES, *OF_RESULTS) if name in attrs}
    if facts.get("size") not in ("d50", "dmax"):
        facts.pop("size_diameter", None)  # d43 and d32 are those of each node
    texts = []
    for name in sorted(facts):
        values = np.ravel(facts[name])
        if values.dtype.kind in "biuf":
            values = values.astype(float)
        texts.append(f"{name}={values.tolist()}")
    code = hashlib.blake2b("\n".join(texts).encode(), digest_size=4).hexdigest()
    _SEEN[code] = facts
    return code, facts


def _json_object(text: Any) -> dict[str, Any]:
    """Return the facts that a coordinate of an earlier version holds as text."""
    try:
        facts = json.loads(text)
    except (TypeError, ValueError):  # of values that are no text, and of other texts
        facts = None
    if not isinstance(facts, dict):
        raise SceneError(
            f"the coordinate {SETUP!r} holds {plain(text)}, expected the code that xcg writes: leave it out, "
            f"ds.drop_vars({SETUP!r}), or give a coordinate of your own another name"
        )
    return facts


def _require_code(ds: xr.Dataset, code: str, facts: Mapping[str, Any]) -> None:
    """Raise SceneError unless the attributes of a Dataset have its code.

    `facts` are the attributes of the coordinate, which have another code.
    """
    if _coded(ds.attrs)[0] == code:
        return
    if facts:
        raise SceneError(
            f"the attributes of the coordinate {SETUP!r} are not those of its code, {code}: parts that differ were "
            "joined, and this is one of them with the attributes of another. Select it before joining"
        )
    lost = [name for name in _ALWAYS if name not in ds.attrs] or ["that its numbers depend on"]
    raise SceneError(
        f"the Dataset has lost its attributes {', '.join(lost)}, and so has its coordinate {SETUP!r}, which keeps a "
        "copy of them: copy them from the original, ds.attrs = original.attrs; or compute with the attributes that "
        f"it has, ds.drop_vars({SETUP!r})"
    )


def _differences(codes: Sequence[str]) -> str:
    """Return the names of the facts that differ between parts, with two of their values each."""
    if not all(code in _SEEN for code in codes):
        return f"their {SETUP} is {' and '.join(codes[:2])}, see the attributes of {SETUP} in each"
    texts = []
    for name in (*OF_SCENES, *OF_RESULTS):
        values = []
        for code in codes:
            value = np.asarray(_SEEN[code].get(name)).tolist()
            values.append(json.dumps(value))
        values = list(dict.fromkeys(values))
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
