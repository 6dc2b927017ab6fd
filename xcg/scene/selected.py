"""Selections of particles, with their contacts."""

from __future__ import annotations

from functools import partial
from typing import Literal, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.checks import check_choice
from xcg.common.messages import plain, unknown
from xcg.scene.conform import in_whole_rows, takes_scene
from xcg.scene.expressions import evaluate
from xcg.scene.scene import Scene
from xcg.scene.schema import COMPONENTS, MEASURED, PADDING, variable

Outside: TypeAlias = Literal["keep", "drop"]
# vectors whose components expressions name, by the letter before the axis
_VECTORS = {"": "position", "v": "velocity", "omega_": "angular_velocity"}
# variables by the words that others use for them
_OTHER_NAMES = {
    "type": "species",
    "id": "particle_id",
    "radius": "diameter",
    "d": "diameter",
    "m": "mass",
    "u": "vx",
    "v": "vy",
    "w": "vz",
}
# dimensions as ds.swap_dims may name them
_OTHER_DIMS = {"particle_id": "particle", "step": "time"}


@takes_scene
def select(scene: Scene, condition: xr.DataArray | str, *, outside: Outside = "keep") -> xr.Dataset:
    """Select particles of each step, with their contacts; lazy where the scene is.

    Contacts without a selected particle are dropped. A contact of a selected particle with another
    one is kept: it acts on the selected particle alone, and counts as a contact with a wall. So the
    contact stresses of a selection and of all other particles add up to that of the scene.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene.
    condition : DataArray or str
        Truth values (time, particle), such as ``ds.diameter > 1e-3``, or an expression of variables
        of the particles, such as ``"z > 0.1 and diameter < 2e-3"``. Expressions know scalars by
        their names, the components ``x y z``, ``vx vy vz`` and ``omega_x omega_y omega_z``, numbers,
        comparisons, ``and or not``, arithmetic, and the functions ``abs sqrt exp log sin cos tan
        arctan2 hypot minimum maximum floor isfinite isnan``. Nothing else is evaluated.
    outside : {"keep", "drop"}
        What becomes of contacts between selected particles and others.

    Returns
    -------
    xarray.Dataset
        The scene with all other particles and contacts turned into padding. Rows that are padding
        in all steps are left out where the scene is in memory. Measured sizes and extent, which
        default widths and meshes follow from, stay as in the scene; `measure` takes the values of the
        selection.

    Raises
    ------
    SceneError
        If `ds` is not a scene.
    TypeError
        If `condition` is neither a text nor an array of truth values.
    ValueError
        If it has other dimensions than time and particle, or an expression is wrong.

    Examples
    --------
    >>> import xcg
    >>> ds = xcg.datasets.random_scene(100)
    >>> upper = ds.cg.select("z > 2.5")
    >>> bool((upper.position.sel(component="z") > 2.5).all())
    True
    """
    scene.require((), "select")
    ds = scene.ds
    check_choice("outside", outside, Outside)
    chosen = _mask(ds, condition) & (ds["particle_id"] != PADDING)
    chosen = chosen.transpose("time", "particle")
    selected = _masked(ds, chosen, "particle")
    if "contact_i" in ds:
        kept = _contacts_of(selected["particle_id"], ds["contact_i"], ds["contact_j"], outside)
        selected = _masked(selected, kept, "contact")
        selected = _without_padding(selected, kept, "contact")
    return _without_padding(selected, chosen, "particle")


def _mask(ds: xr.Dataset, condition: xr.DataArray | str) -> xr.DataArray:
    """Return the truth values (time, particle) of a condition."""
    if isinstance(condition, str):
        condition = _evaluate(ds, condition)
    if not isinstance(condition, xr.DataArray) or condition.dtype.kind != "b":
        found = getattr(condition, "dtype", type(condition).__name__)
        raise TypeError(
            f"select: expected an array of truth values, such as ds.diameter > 1e-3, or a text such as 'z > 0.1', "
            f"not {found}"
        )
    # without coordinates, rows are matched by position
    condition = xr.DataArray(condition.variable).rename(
        {dim: name for dim, name in _OTHER_DIMS.items() if dim in condition.dims}
    )
    if "time" not in condition.dims and ds.sizes["time"] == 1:
        condition = condition.expand_dims("time")
    elif condition.dims == ("particle",):
        raise ValueError(
            f"select: the condition has no dimension 'time', and the scene has {ds.sizes['time']} steps, whose rows "
            "may be other particles. For the same particles in all steps give ds.particle_id.isin(ids)"
        )
    if {*condition.dims} != {"time", "particle"}:
        raise ValueError(
            f"select: the condition has the dimensions {dict(condition.sizes)}, expected (time, particle); take one "
            "component of vectors, ds.position.sel(component='z') > 0.1"
        )
    sizes = {dim: ds.sizes[dim] for dim in ("time", "particle")}
    if dict(condition.sizes) != sizes:
        raise ValueError(
            f"select: the condition has the sizes {dict(condition.sizes)}, and the scene has {sizes}"
        )
    return condition


def _evaluate(ds: xr.Dataset, expression: str) -> xr.DataArray:
    """Evaluate an expression of the particles' variables."""
    variables = {
        str(name): values.variable
        for name, values in ds.data_vars.items()
        if values.dims == ("time", "particle")
    }
    for letter, name in _VECTORS.items():
        if name in ds:
            for axis in COMPONENTS:
                variables.setdefault(
                    f"{letter}{axis}", ds[name].sel(component=axis, drop=True).variable
                )
    try:
        return xr.DataArray(evaluate(expression, variables))
    except NameError as error:
        unknown_name = unknown("variable", error.name, variables, synonyms=_OTHER_NAMES)
        raise ValueError(f"select({plain(expression)}): {unknown_name}") from None
    except SyntaxError as error:
        reason = error.msg
    except (ArithmeticError, TypeError, ValueError) as error:
        reason = str(error.args[-1])
    raise ValueError(
        f"select({plain(expression)}): {reason}; expected an expression such as 'z > 0.1 and species == 1'"
    )


def _contacts_of(
    ids: xr.DataArray, contact_i: xr.DataArray, contact_j: xr.DataArray, outside: Outside
) -> xr.DataArray:
    """Return which contacts (time, contact) belong to particles with some ids (time, particle), step by step."""
    arrays = [in_whole_rows(array) for array in (ids, contact_i, contact_j)]
    kept: xr.DataArray = xr.apply_ufunc(
        partial(_of_particles, outside=outside),
        *arrays,
        input_core_dims=[["particle"], ["contact"], ["contact"]],
        output_core_dims=[["contact"]],
        dask="parallelized",
        output_dtypes=[bool],
    )
    return kept


def _of_particles(
    ids: NDArray, contact_i: NDArray, contact_j: NDArray, outside: Outside
) -> NDArray:
    """Return which contacts (t, contacts) have one of the particles (t, particles), or only such ones."""
    kept = np.empty(contact_i.shape, bool)
    for t, (i, j) in enumerate(zip(contact_i, contact_j, strict=True)):
        i_selected = np.isin(i, ids[t])
        j_selected = np.isin(j, ids[t])
        kept[t] = (i_selected | j_selected) & (i != PADDING)
        if outside == "drop":
            kept[t] &= (i_selected | (i < 0)) & (j_selected | (j < 0))
    return kept


def _masked(ds: xr.Dataset, chosen: xr.DataArray, dim: str) -> xr.Dataset:
    """Turn the rows of particles or contacts that are not chosen into padding."""
    changed = {}
    for name, values in ds.data_vars.items():
        if dim not in values.dims:
            continue
        fill = variable(str(name), values.dtype, values.ndim - 1).fill
        if values.dtype.kind == "i":
            fill = PADDING
        masked = values.where(chosen, fill).transpose(*values.dims)
        masked.attrs = dict(values.attrs)
        if values.encoding:  # rows that are left have the sizes that were measured
            masked.encoding[MEASURED] = True
        changed[name] = masked
    return ds.assign(changed)


def _without_padding(ds: xr.Dataset, chosen: xr.DataArray, dim: str) -> xr.Dataset:
    """Leave out rows that are padding in all steps, where this is known without computing."""
    if chosen.chunks is not None:
        return ds
    return ds.isel({dim: np.flatnonzero(chosen.any("time"))})
