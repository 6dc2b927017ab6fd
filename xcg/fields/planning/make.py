"""From what is asked for to what will be done: columns, rules, passes and memory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import xarray as xr

from xcg.fields.formulas import registry
from xcg.fields.formulas.averages import needed_for_averages
from xcg.fields.formulas.field import Options
from xcg.fields.formulas.variables import check_turns, own_moments
from xcg.fields.places.frames import is_cylindrical
from xcg.fields.planning.choices import choose_fields, options_of, variables_of, with_friction
from xcg.fields.planning.layout import (
    check_differentiable,
    extents_of,
    kernels_of,
    lasting_periods,
    nodes_of,
    warn_of_cuts,
    warn_of_width,
)
from xcg.fields.planning.plan import Plan
from xcg.fields.request import Request
from xcg.fields.sums.passes import DepositSpec
from xcg.fields.sums.quadrature import SINGLE, gauss_limits
from xcg.scene.numbers import is_finite
from xcg.scene.query import edges_of, groups_of, require_scene, setup_of
from xcg.scene.schema import COMPONENTS, Setup
from xcg.scene.sizes import layer_depth, with_measures


def make_plan(ds: xr.Dataset, request: Request) -> Plan:
    """Plan what a request takes, of grains and fields of xcg. Reads attributes only, never data.

    Raises
    ------
    SceneError
        If the scene lacks variables that the fields need.
    ValueError
        If an argument is wrong.
    """
    require_scene(ds, (), "coarse_grain")
    return plan_measured(with_measures(ds), request)


def plan_measured(ds: xr.Dataset, request: Request) -> Plan:
    """Plan as `make_plan`, of a scene whose sizes and extent are known to hold."""
    setup, rtol, by = setup_of(ds), request.rtol, request.by
    if not (is_finite(rtol) and rtol >= 0):
        msg = f"rtol={rtol!r}: expected 0 (closed form) or a positive number such as 1e-3"
        raise ValueError(msg)
    names, asked, options = _fields_and_options(ds, setup, request)
    variables = _held_variables(ds, names, options)
    kernels = kernels_of(ds, request, setup.dimension)
    chosen = max(kernels, key=lambda k: k.cutoff)
    warn_of_width(min(k.width for k in kernels), ds.attrs.get("dmin" if isinstance(request.width, Mapping) else "d43"))
    edges = edges_of(ds)
    period = {a: edges[a][1] - edges[a][0] for a in setup.periodic if a in edges}
    grid = nodes_of(ds, request, setup, kernels, edges, period)
    warn_of_cuts(grid, {a: edges[a] for a in period}, chosen.cutoff)
    moments = registry.moments_of(names, options)
    if request.gradient == "kernel" and {"mass_slope", "momentum_slope"} & set(moments):
        check_differentiable(chosen, len(grid.seen))
    limits = gauss_limits(chosen, len(grid.seen), rtol)
    own = own_moments(options.own) | with_friction(options.friction)
    deposit = DepositSpec(
        moments=moments,
        grid=grid,
        weights=(kernels[0].over_cells if grid.half.any() else kernels[0].weights)(len(grid.seen)),
        cutoffs=tuple(k.cutoff for k in kernels),
        limits=limits,
        coarse=limits.size > 0 and rtol >= SINGLE,
        by=by,
        groups=() if by is None else groups_of(ds, by, request.groups),
        own={name: row for name, row in own.items() if name in moments},
    )
    x, y, z = (grid.spacing.get(a, 0.0) for a in COMPONENTS)
    wrapped = grid.fills(lasting_periods(ds, setup, period))
    options = replace(
        options, active=tuple(grid.active.tolist()), shape=grid.shape, spacing=(x, y, z), wrapped=wrapped
    )  # fmt: skip
    extra = {by} if by else set()
    extra |= {"frozen"} & set(ds.data_vars)
    read = [n for n in ds.data_vars if n in variables | extra]
    return Plan(
        fields=names, asked=asked, variables=tuple(map(str, read)), deposit=deposit, options=options, kernel=chosen,
        extent=extents_of(grid, request.extent or {}, edges, tilted="lattice" in ds),
        depth=layer_depth(ds, setup, edges), setup=setup, rtol=rtol,
    )  # fmt: skip


def _fields_and_options(
    ds: xr.Dataset, setup: Setup, request: Request
) -> tuple[tuple[str, ...], tuple[str, ...], Options]:
    """Fields that are computed, those of them that were asked for, and the choices of their algebra."""
    if request.by_pair and request.by is None:
        msg = "by_pair=True divides contact stress by pairs of phases: say which with by=, for example by='species'"
        raise ValueError(msg)
    if request.groups is not None and request.by is None:
        msg = f"groups={request.groups!r} are the values of an integer variable of the particles: say which with by="
        raise ValueError(msg)
    options = replace(options_of(ds, setup, request), by=request.by)
    names, own = choose_fields(request.fields, ds, options)
    if is_cylindrical(ds):
        check_turns(own)
    options = replace(options, own=(*own, *registry.registered_for(names, replace(options, own=own))))
    if request.by_pair:
        names = tuple(dict.fromkeys([*names, "contact_stress_by_pair"]))
    asked = names
    if request.for_averages or request.per is not None:
        names = (*names, *needed_for_averages(names, options))
    return names, asked, options


def _held_variables(ds: xr.Dataset, names: tuple[str, ...], options: Options) -> frozenset[str]:
    """Variables that some fields take, all of which the scene holds."""
    held = frozenset(map(str, ds.data_vars))
    variables = variables_of(names, held, options)
    lacking = [] if variables <= held else [name for name in names if not variables_of((name,), held, options) <= held]
    require_scene(ds, sorted(variables), f"coarse_grain of {', '.join(lacking)}")
    return variables
