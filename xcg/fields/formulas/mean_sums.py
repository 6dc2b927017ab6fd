"""Sums that averages of a result are made of, and the fields that follow from averaged sums.

The kinetic stress of an average is about the averaged velocity U, by the law of total covariance:
``mean sigma^k + mean rho (V - U)(V - U)`` (Weinhart et al. 2013; Artoni & Richard 2015).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.messages import warn_once
from xcg.fields.formulas import registry
from xcg.fields.formulas.field import Field, Options
from xcg.fields.formulas.rules import (
    OF_COVARIANCE,
    all_of,
    errors_among,
    lacking_sums,
    takes_covariance,
)
from xcg.fields.formulas.variables import field_of_result
from xcg.scene.conform import in_order, labels_along
from xcg.scene.facts import require_facts
from xcg.scene.schema import COMPONENTS
from xcg.steps.faults import SKIPPED


def require_fields(f: xr.Dataset, purpose: str) -> None:
    """Raise ValueError for a scene in place of a result."""
    if "particle" in f.dims:
        raise ValueError(
            f"{purpose} takes fields, and this is a scene: call {purpose} on what its coarse_grain returns"
        )


@dataclass(frozen=True, eq=False)
class Averaging:
    """Average of a result by the rules of its fields: to sums that may be averaged, and back.

    Attributes
    ----------
    purpose : str
        Name of the average, for messages.
    definitions : mapping
        Fields of the registry by name; None for other variables.
    options : Options
        Choices of the algebra that the fields were computed with.
    """

    purpose: str
    definitions: Mapping[str, Field | None]
    options: Options

    @classmethod
    def of(cls, f: xr.Dataset, purpose: str) -> Averaging:
        """Return the average of a result, whose attributes hold its options."""
        require_fields(f, purpose)
        options = registry.options_of(f.attrs)
        definitions: dict[str, Field | None] = {}
        for name in map(str, f.data_vars):
            if name in registry.FIELDS:
                definitions[name] = registry.field_of(name, options)
            else:
                definitions[name] = field_of_result(f[name])
        return cls(purpose, definitions, options)

    @property
    def anew(self) -> list[str]:
        """Fields that are computed anew from averages: neither sums nor ratios of two."""
        names = []
        for name, field in self.definitions.items():
            if field and not (field.additive or field.weight):
                names.append(name)
        return names

    def to_sums(self, f: xr.Dataset, dims: Sequence[str] = ()) -> xr.Dataset:
        """Return what may be averaged over some dims: additive fields, numerator and denominator of each ratio.

        Beside the fields that take the covariance of the velocity, the sums that it follows from.
        """
        definitions = self.definitions
        purpose = self.purpose
        errors = errors_among(definitions)
        if errors:
            raise ValueError(
                f"{purpose} takes no mean of errors and biases ({', '.join(errors)}): call it before time_average, on "
                "a result without errors=True"
            )
        if self.anew:
            required = ("plane", "gradient", "pressure_dims", "deviatoric", "size", "temperature")
            anew = ", ".join(self.anew)
            way_out = f"or leave out what {purpose} computes anew from averages, {anew}"
            require_facts(f, required, "this result", way_out)
        missing = lacking_sums(definitions, self.options)
        if missing:
            lacks = [f"{name} needs {', '.join(fields)}" for name, fields in missing.items()]
            sums = ", ".join(all_of(missing))
            way_out = ""
            if sums:
                way_out = (
                    f". Leave out for_averages=False in coarse_grain, or ask it for {sums} too"
                )
            raise ValueError(
                f"{purpose} averages ratios through their sums, and some are not in this result: "
                f"{'; '.join(lacks)}{way_out}"
            )
        f = _without_gaps(self._with_components(f), definitions)
        out: dict[str, xr.DataArray] = {}
        for name, field in definitions.items():
            assert field is not None
            if field.additive:
                out[name] = f[name].astype(float)
                if SKIPPED in f.coords:  # whole numbers of such steps are -1
                    out[name] = out[name].where(~f[SKIPPED])
            elif field.weight:
                weight = f[field.weight]
                if field.by_bulk:
                    weight = _of_bulk(weight, name, purpose)
                weight = weight.where(f[name].notnull(), 0.0)
                value = f[name].fillna(0.0)
                if field.harmonic:
                    out[f"{name}/top"] = weight
                    out[f"{name}/bottom"] = weight / value.where(weight != 0, 1.0)
                else:
                    out[f"{name}/top"] = weight * value
                    out[f"{name}/bottom"] = weight
        if dims:
            out |= self._about_mean_velocity(f, dims)
        return xr.Dataset(out)

    def from_sums(self, sums: xr.Dataset, f: xr.Dataset) -> xr.Dataset:
        """Fields of `f` from averaged quantities."""
        options = self.options
        fields: dict[str, xr.DataArray] = {}
        for name in map(str, sums.data_vars):
            ratio, _, part = name.partition("/")
            if not part:
                fields[name] = sums[name]
            elif part == "top":
                denominator = sums[f"{ratio}/bottom"]
                fields[ratio] = sums[name] / denominator.where(denominator != 0)
        if "velocity/second" in sums:
            added = _about_averaged_velocity(sums)
            for name, field in self.definitions.items():
                if field and takes_covariance(field, options):
                    fields[name] = fields[name] + _of_covariance(name, added, options)
        out = {}
        for name in map(str, f.data_vars):
            out[name] = derive(name, fields, options).assign_attrs(f[name].attrs)
        return xr.Dataset(out, attrs=f.attrs)

    def _with_components(self, f: xr.Dataset) -> xr.Dataset:
        """Sort components into the order of the formulas; raise if a field would be recomputed from some of them."""
        for dim in ("component", "direction"):
            if dim not in f.coords:
                continue
            ordered = in_order(f, dim, COMPONENTS)
            if ordered is None:
                ordered = in_order(f, dim, ("r", "theta", "z"))
            if ordered is not None:
                f = ordered
                continue
            anew = [name for name in self.anew if self._takes_tensors(name)]
            if anew:
                held = ", ".join(map(str, labels_along(f, dim)))
                raise ValueError(
                    f"{self.purpose} computes {', '.join(anew)} anew from averaged vectors and tensors, "
                    f"of which this result has the {dim} {held} alone: select after it, or leave "
                    "these fields out with drop_vars"
                )
        return f

    def _takes_tensors(self, name: str) -> bool:
        """Return whether a field is computed anew from vectors or tensors."""
        field = registry.field_of(name, self.options)
        if field.additive or field.weight:
            return field.rank > 0
        return any(map(self._takes_tensors, field.fields))

    def _about_mean_velocity(self, f: xr.Dataset, dims: Sequence[str]) -> dict[str, xr.DataArray]:
        """Return the sums of m (v - u)(v - u) less the kinetic stress, of m (v - u) and m (V - u), by phase, if needed.

        u is the mean over `dims` of the bulk's velocity: relative to it nothing large is subtracted.
        """
        names = [
            n
            for n, field in self.definitions.items()
            if field and takes_covariance(field, self.options)
        ]
        if not names:
            return {}
        lacking = _lacking_for_covariance(f)
        if lacking:
            warn_once(
                "covariance",
                f"{self.purpose}: the average of {', '.join(names)} leaves out how the velocity varies from step to "
                f"step and from node to node, as this result lacks {lacking}",
            )
            return {}
        weight = f["density"].where(f["velocity"].notnull(), 0.0)
        velocity = f["velocity"].fillna(0.0)
        if "theta" in f.dims:  # else its mean along a ring around the axis is zero
            velocity = f["velocity"].where(f["density"] > 0, 0.0)
        of_bulk = _of_bulk(velocity, "velocity", "averages")
        weight_of_bulk = _of_bulk(weight, "velocity", "averages")
        total = weight_of_bulk.sum(dims)
        mean = (weight_of_bulk * of_bulk).sum(dims) / total.where(total != 0)
        shift = (of_bulk - mean).where(weight_of_bulk != 0, 0.0)
        drift = weight * (velocity - of_bulk)
        return {
            "velocity/shift": weight * shift,
            "velocity/first": drift + weight * shift,
            "velocity/second": _outer(drift, shift)
            + _outer(shift, drift)
            + _outer(weight * shift, shift),
        }


# --- kinetic stress about the averaged velocity ----------------------------------------------------------


def _lacking_for_covariance(f: xr.Dataset) -> str:
    """Return what a result lacks for the covariance of its velocity, and where to obtain it; "" for nothing."""
    lacking = [name for name in OF_COVARIANCE if name not in f]
    if lacking:
        names = " and ".join(lacking)
        return f"{names}: leave out for_averages=False in coarse_grain, or ask it for {names} too"
    if "phase" in f.coords and "bulk" not in np.atleast_1d(f["phase"].to_numpy()):
        return "the bulk: choose phases after the average"
    if f.sizes.get("component") != 3 or f.sizes.get("direction", 3) != 3:
        return "components of the velocity: choose components after the average"
    return ""


def _outer(a: xr.DataArray, b: xr.DataArray) -> xr.DataArray:
    """Return a_i b_j."""
    return a * b.rename(component="direction")


def _about_averaged_velocity(sums: xr.Dataset) -> dict[str, xr.DataArray]:
    """Return what averages add, by phase: to kinetic stress the "covariance", to a flux of mass the "shift".

    The covariance is the averaged sum of m (v - U)(v - U) less the averaged kinetic stress, the
    shift the averaged rho (V - U), V the bulk's velocity.
    """
    weight = sums["velocity/bottom"]
    first = sums["velocity/first"]
    first_of_bulk = _of_bulk(first, "velocity", "averages")
    weight_of_bulk = _of_bulk(weight, "velocity", "averages")
    mean = (first_of_bulk / weight_of_bulk.where(weight_of_bulk != 0)).fillna(0.0)
    moved = first - weight * mean
    return {
        "covariance": sums["velocity/second"] - _outer(mean, first) - _outer(moved, mean),
        "shift": sums["velocity/shift"] - weight * mean,
    }


def _of_covariance(name: str, added: Mapping[str, xr.DataArray], options: Options) -> xr.DataArray:
    """Return what the covariance or the shift of the velocity adds to an averaged field."""
    field = registry.field_of(name, options)
    if field.covariance is not None:
        return _compute(replace(field, compute=field.covariance), added, options)
    parts = {}
    for need in field.fields:
        needed = registry.field_of(need, options)
        if takes_covariance(needed, options):
            parts[need] = _of_covariance(need, added, options)
        else:
            tail = ("component", "direction")[needed.rank :]
            parts[need] = xr.zeros_like(added["covariance"].isel(dict.fromkeys(tail, 0), drop=True))
    return _compute(field, parts, options)


def _without_gaps(f: xr.Dataset, definitions: Mapping[str, Field | None]) -> xr.Dataset:
    """Return the sums of the temperatures of phases, 0 where the grains are too few for a fit, which leaves nothing."""
    if not any(field and field.across_phases for field in definitions.values()):
        return f
    return f.assign(
        fluctuation_stress=f["fluctuation_stress"].fillna(0.0),
        fluctuation_density_by_pair=f["fluctuation_density_by_pair"].fillna(0.0),
    )


def _of_bulk(weight: xr.DataArray, name: str, purpose: str) -> xr.DataArray:
    """Return the bulk's part of the field that weighs another; the whole of it where there are no phases."""
    if "phase" not in weight.coords:
        return weight
    if "bulk" not in np.atleast_1d(weight["phase"].to_numpy()):
        raise ValueError(
            f"{purpose} averages {name} by the bulk's {weight.name}, which this result lacks: choose phases after it"
        )
    if "phase" not in weight.dims:
        return weight
    return weight.sel(phase="bulk", drop=True)


def derive(name: str, fields: dict[str, xr.DataArray], options: Options) -> xr.DataArray:
    """Return one of the fields, or compute it and add it and what it needed to them."""
    if name not in fields:
        field = registry.field_of(name, options)
        needs = {need: derive(need, fields, options) for need in field.fields}
        fields[name] = _compute(field, needs, options)
    return fields[name]


def _compute(field: Field, needs: Mapping[str, xr.DataArray], options: Options) -> xr.DataArray:
    """Compute one field of the registry on labelled arrays."""
    tail = ("component", "direction")
    dims: tuple[str, ...] = tail
    if field.across_phases:
        dims = ("phase", "other_phase", *tail)
        pairs = needs["fluctuation_density_by_pair"]
        if pairs.sizes.get("phase") != pairs.sizes.get("other_phase"):
            raise ValueError(
                "temperatures of phases take the sums of all phases: choose phases after the average"
            )
    of_needs = [[dim for dim in dims if dim in need.dims] for need in needs.values()]

    # neither a closure, which dask would name anew in each call, nor the graphs of what it needs
    plain = partial(_compute_plain, field, tuple(needs), of_needs, options)
    if not needs:
        return xr.DataArray(plain())
    return xr.apply_ufunc(
        plain,
        *needs.values(),
        input_core_dims=of_needs,
        output_core_dims=[(*dims[: field.across_phases], *tail[: field.rank])],
        dask="parallelized",
        dask_gufunc_kwargs={"allow_rechunk": True},  # of components, or of phases
        output_dtypes=[float],
    )


def _compute_plain(
    field: Field,
    needs: Sequence[str],
    core_dims: Sequence[Sequence[str]],
    options: Options,
    *arrays: NDArray,
) -> NDArray:
    """Compute one field of the registry on arrays whose last dimensions are `core_dims`."""
    if field.across_phases:
        arrays = tuple(
            np.moveaxis(a, -len(core), 0) for a, core in zip(arrays, core_dims, strict=True)
        )
    fields = SimpleNamespace(**dict(zip(needs, arrays, strict=True)))
    with np.errstate(all="ignore"):
        values = field.compute(fields, None, options)
    if field.across_phases:
        return np.moveaxis(values, 0, -1 - field.rank)
    return values
