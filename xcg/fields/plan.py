"""From what is asked for to what will be done: columns, rules, passes and memory."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.compiled import smoothing as kinds
from xcg.compiled.points import LINEAR
from xcg.compiled.segments import RULES
from xcg.fields.formulas import registry
from xcg.fields.formulas.averages import needed_for_averages
from xcg.fields.formulas.field import Options
from xcg.fields.formulas.variables import OwnField, Quantity, check_turns, own_fields, own_moments, rows_of
from xcg.fields.places.frames import Cylindrical, is_cylindrical
from xcg.fields.places.grid import make_grid
from xcg.fields.places.points import is_pointwise, make_points
from xcg.fields.places.rings import Rings, make_rings
from xcg.fields.request import Request
from xcg.fields.sums.blocks import BLOCK_NODES, FINE, nodes_in_cache
from xcg.fields.sums.fabric import sliding_contacts
from xcg.fields.sums.moments import MOMENTS, Moment
from xcg.fields.sums.nodes import Grid
from xcg.fields.sums.passes import DepositSpec
from xcg.fields.sums.quadrature import SINGLE, gauss_limits
from xcg.fields.sums.smoothing import Kernel, as_kernel, choose_width
from xcg.scene.lattice import Lattice
from xcg.scene.numbers import is_finite, is_positive
from xcg.scene.query import (
    axes_that_stay,
    box_stays,
    edges_of,
    groups_of,
    known_without_reading,
    require_scene,
    setup_of,
)
from xcg.scene.schema import BOX, COMPONENTS, CONTACT_VARIABLES, ROTATION, SceneError, Setup, did_you_mean
from xcg.scene.sizes import layer_depth, with_measures
from xcg.scene.warn import warn_user


@dataclass(frozen=True)
class Plan:
    """What one call of `coarse_grain` will do; printing it explains it.

    Attributes
    ----------
    fields : tuple of str
        What is computed: what was asked for, and what averages of it need where they are to be taken.
    asked : tuple of str
        What was asked for.
    variables : tuple of str
        What is read from the scene.
    deposit : DepositSpec
        Sums, nodes and kernel.
    options : Options
        Choices of the algebra.
    kernel : Kernel
        The widest, where each group has its own.
    extent : dict
        Length of each averaged axis (m); None takes the box of each step.
    depth : float or str or None
        Thickness of a one-layer scene (m), or the axis whose box extent it is.
    setup : Setup
        What holds for the whole scene.
    rtol : float
        Promise for the contact stress.
    """

    fields: tuple[str, ...]
    asked: tuple[str, ...]
    variables: tuple[str, ...]
    deposit: DepositSpec
    options: Options
    kernel: Kernel
    extent: Mapping[str, float | None]
    depth: float | str | None
    setup: Setup
    rtol: float

    @property
    def dims(self) -> tuple[str, ...]:
        """Dimensions of the nodes, and phase where there are several."""
        return (*self.deposit.grid.dims, *(("phase",) if self.deposit.by else ()))

    @property
    def phases(self) -> int:
        """Number of phases in the result, the bulk included."""
        return 1 + len(self.deposit.groups)

    @property
    def widths(self) -> list[float]:
        """Width of each group (m), or one for all."""
        return [self.kernel.spread * cutoff for cutoff in self.deposit.cutoffs]

    @cached_property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of one step of each field."""
        return {name: self._shape(name) for name in self.fields}

    def _shape(self, name: str) -> tuple[int, ...]:
        phases = (self.phases,) if self.deposit.by else ()
        row = registry.row(name, self.options)
        return (*self.deposit.grid.sizes, *phases, *((self.phases,) if row.paired else ()), *(3,) * row.rank)

    def left_out(self, name: str) -> list[str]:
        """Name the variables of rotation that a field would take and that the scene does not hold."""
        if not self._absent:
            return []
        absent = {v for moment in registry.moments_of([name], self.options) for v in self._absent.get(moment, ())}
        return [v for v in ROTATION if v in absent]

    @cached_property
    def _absent(self) -> dict[str, set[str]]:
        """Variables of rotation that the scene does not hold, by the moments that would take them."""
        absent = set(ROTATION) - set(self.variables)
        found = {moment: absent & set(row.optional) for moment, row in self.deposit.rows.items()}
        return {moment: variables for moment, variables in found.items() if variables}

    @cached_property
    def reached(self) -> float:
        """Nodes in the box around the support of a grain."""
        grid, reach = self.deposit.grid, 2.0 * max(self.deposit.cutoffs)
        return float(np.clip(reach / grid.steps, 1.0, grid.shape)[grid.active].prod())

    @cached_property
    def block_nodes(self) -> int:
        """Nodes that are computed at one time."""
        return BLOCK_NODES if self.reached <= FINE else min(BLOCK_NODES, nodes_in_cache(self._numbers))

    @property
    def _numbers(self) -> int:
        """How many numbers are summed at a node."""
        return max(1, self.phases - 1) * sum(sum(columns) for columns in self._columns.values())

    @cached_property
    def _columns(self) -> dict[str, list[int]]:
        """Columns of each pass, by what it goes over."""
        moments = self.deposit.rows.values()
        constants = [m for m in moments if m.column and not m.level and not m.along_branches]
        grains = self.deposit.level + sum(math.prod(m.shape) for m in constants if not m.at_contacts)
        points = sum(math.prod(m.shape) for m in constants if m.at_contacts)
        return {
            "particles": [grains] if grains else [],
            "slopes": [LINEAR] if any(name.endswith("_slope") for name in self.deposit.moments) else [],
            "contacts": [9 for m in moments if m.along_branches],
            "contact points": [points] if points else [],
            "means": [m.level for m in moments if m.column and m.level],
        }

    def __str__(self) -> str:
        grid, moments = self.deposit.grid, self.deposit.rows
        passes = {over: len(columns) for over, columns in self._columns.items()}
        outputs = sum(map(math.prod, self.shapes.values()))
        sums = min(grid.count, self.block_nodes) * self._numbers
        own = f"; widths by group {[float(f'{w:.4g}') for w in self.widths]}" if len(self.widths) > 1 else ""
        rules = "closed form"
        if len(self.deposit.limits):
            steps = ", ".join(f"{k} to {x:.3g} c" for k, x in zip(RULES, self.deposit.limits, strict=False))
            rules = f"Gauss points by branch length ({steps}), closed form beyond"
            rules += ", weights in single precision" if self.deposit.coarse else ""
        lines = {
            "fields": ", ".join(self.fields),
            "read": ", ".join(self.variables),
            **grid.describe(),
            "averaged": ", ".join(f"{a} ({self.extent[a] or 'box'})" for a in grid.averaged) or "none",
            "kernel": f"{self.kernel!r}, seen in {len(grid.seen)} of {self.kernel.dimension} dimensions{own}",
            "sums": ", ".join(f"{m} ({row.formula})" for m, row in moments.items()),
            "passes": f"{passes['particles']} over particles, {passes['slopes']} with grad Psi, "
            f"{passes['contacts']} over contacts"
            + (f", {passes['contact points']} over contact points" if passes["contact points"] else "")
            + (f", {passes['means']} relative to means" if passes["means"] else ""),
            "contacts": f"{rules} (rtol = {self.rtol:g})" if passes["contacts"] else "not read for stress",
            "memory": f"{8 * sums / 1e6:.3g} MB of sums a thread and {8 * outputs / 1e6:.3g} MB of fields a step",
        }
        return "\n".join(f"{key:9s} {text}" for key, text in lines.items())


SAMPLINGS = ("node", "cell")
_NARROW = 0.1  # widths, in mean diameters, that show single grains only


def _choose_fields(
    asked: str | Quantity | Sequence[str | Quantity | registry.OwnRow] | None, ds: xr.Dataset, options: Options
) -> tuple[tuple[str, ...], tuple[OwnField | registry.OwnRow, ...]]:
    """Names of the fields of a result, and those of them that are quantities of the scene's own variables."""
    if asked is None:
        here = _possible(frozenset(map(str, ds.data_vars)), options)
        if not here:
            require_scene(ds, ("mass",), "coarse_grain")
        return here, ()
    lacking = _lacking(options)
    given = list(asked) if isinstance(asked, Iterable) and not isinstance(asked, str) else [asked]
    own = own_fields(given, ds)
    names = [own[k].name if k in own else one for k, one in enumerate(given)]
    unknown = [name for name in names if name not in registry.listed() and name not in {o.name for o in own.values()}]
    if unknown or not names:
        more = [name for name in rows_of(ds) if name not in registry.FIELDS]
        msg = f"unknown fields {unknown}: choose from {', '.join(registry.listed())}"
        msg += f", or a variable of the scene: {', '.join(more)}"
        msg += "".join(did_you_mean(str(name), [*registry.listed(), *more]) for name in unknown)
        raise ValueError(msg)
    for name in names:
        if name in lacking:
            option = registry.FIELDS[name].option
            msg = f"{name} needs the argument {option}="
            if option == "lag":
                msg = f"{name} compares two frames: call ds.cg.displacement({name!r}) instead of coarse_grain"
            raise ValueError(msg)
    return tuple(dict.fromkeys(map(str, names))), tuple(dict.fromkeys(own.values()))


def _lacking(options: Options) -> set[str]:
    """Fields that need an argument which was not given."""
    return {name for name, f in registry.FIELDS.items() if f.option and getattr(options, f.option) is None}


@registry.remembered
def _possible(here: frozenset[str], options: Options) -> tuple[str, ...]:
    """Fields by default, of a scene that holds some variables."""
    lacking = _lacking(options)
    possible = [name for name in registry.listed() if registry.FIELDS[name].default and name not in lacking]
    return tuple(name for name in possible if _variables((name,), here, options) <= here)


@registry.remembered
def _variables(fields: tuple[str, ...], here: frozenset[str], options: Options) -> frozenset[str]:
    """Variables that some fields need, of a scene that holds those that are here."""
    needed = {"position", "particle_id"}
    rows = MOMENTS | own_moments(options.own)
    for name in registry.moments_of(fields, options):
        needed |= set(rows[name].variables) | (set(rows[name].optional) & here)
        if name == "partners" and "coordination_number" in here:
            needed.add("coordination_number")
        elif rows[name].contacts:
            needed |= set(CONTACT_VARIABLES) - {"contact_normal"}
            needed |= {"diameter"} & here  # tells contacts that are far from their grains
    return frozenset(needed)


def possible_fields(ds: xr.Dataset, request: Request) -> tuple[str, ...]:
    """Name the fields that a request without names is answered with: those that the scene's variables allow."""
    options = replace(_options(ds, setup_of(ds), request), by=request.by)
    return _choose_fields(None, ds, options)[0]


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
    setup = setup_of(ds)
    options = _options(ds, setup, request)
    rtol, by = request.rtol, request.by
    if request.by_pair and by is None:
        msg = "by_pair=True divides contact stress by pairs of phases: say which with by=, for example by='species'"
        raise ValueError(msg)
    if not (is_finite(rtol) and rtol >= 0):
        msg = f"rtol={rtol!r}: expected 0 (closed form) or a positive number such as 1e-3"
        raise ValueError(msg)
    options = replace(options, by=by)
    names, own = _choose_fields(request.fields, ds, options)
    if is_cylindrical(ds):
        check_turns(own)
    if registered := registry.registered_for(names, replace(options, own=own)):
        own = (*own, *registered)
    options = replace(options, own=own)
    if request.by_pair:
        names = tuple(dict.fromkeys([*names, "contact_stress_by_pair"]))
    asked = names
    if request.for_averages or request.per is not None:
        names = (*names, *needed_for_averages(names, options))
    held = frozenset(map(str, ds.data_vars))
    variables = _variables(names, held, options)
    lacking = [] if variables <= held else [name for name in names if not _variables((name,), held, options) <= held]
    require_scene(ds, sorted(variables), f"coarse_grain of {', '.join(lacking)}")
    kernels = _kernels(ds, request, setup.dimension)
    chosen = max(kernels, key=lambda k: k.cutoff)
    _warn_of_width(min(k.width for k in kernels), ds.attrs.get("dmin" if isinstance(request.width, Mapping) else "d43"))
    edges = edges_of(ds)
    period = {a: edges[a][1] - edges[a][0] for a in setup.periodic if a in edges}
    grid = _grid(ds, request, setup, kernels, edges, period)
    _warn_of_cuts(grid, {a: edges[a] for a in period}, chosen.cutoff)
    if request.gradient == "kernel" and {"mass_slope", "momentum_slope"} & set(registry.moments_of(names, options)):
        _check_differentiable(chosen, len(grid.seen))
    limits = gauss_limits(chosen, len(grid.seen), rtol)
    deposit = DepositSpec(
        moments=registry.moments_of(names, options),
        grid=grid,
        weights=(kernels[0].over_cells if grid.half.any() else kernels[0].weights)(len(grid.seen)),
        cutoffs=tuple(k.cutoff for k in kernels),
        limits=limits,
        coarse=limits.size > 0 and rtol >= SINGLE,
        by=by,
        groups=() if by is None else groups_of(ds, by, request.groups),
        own=own_moments(own) | _with_friction(options.friction),
    )
    x, y, z = (grid.spacing.get(a, 0.0) for a in COMPONENTS)
    wrapped = grid.fills(_lasting_periods(ds, setup, period))
    options = replace(
        options, active=tuple(grid.active.tolist()), shape=grid.shape, spacing=(x, y, z), wrapped=wrapped
    )  # fmt: skip
    extra = {by} if by else set()
    extra |= {"frozen"} & set(ds.data_vars)
    read = [n for n in ds.data_vars if n in variables | extra]
    return Plan(
        fields=names, asked=asked, variables=tuple(map(str, read)), deposit=deposit, options=options, kernel=chosen,
        extent=_extents(grid, request.extent or {}, edges, tilted="lattice" in ds),
        depth=layer_depth(ds, setup, edges), setup=setup, rtol=rtol,
    )  # fmt: skip


def _grid(
    ds: xr.Dataset, request: Request, setup: Setup, kernels: Sequence[Kernel],
    edges: Mapping[str, tuple[float, float]], period: Mapping[str, float],
) -> Grid:  # fmt: skip
    """Lay the nodes: points, where coordinates are arrays, or a mesh."""
    at: Mapping[str, Any] = request.at or {}
    narrowest = min(k.cutoff for k in kernels)
    if is_cylindrical(ds):
        return _rings(ds, request, setup, kernels, edges, period)
    if is_pointwise(at):
        _check_pointwise(request)
        return make_points(at, plane=setup.plane, cutoff=narrowest)
    return make_grid(
        setup.plane if request.axes is None and request.at is None else request.axes or "",
        at,
        request.bounds or {},
        min(k.width for k in kernels) if request.spacing is None else request.spacing,
        plane=setup.plane,
        cutoff=narrowest,
        automatic=_automatic(ds, setup, edges, max(k.cutoff for k in kernels)),
        period=period,
        cells=request.sampling == "cell",
    )


def _rings(
    ds: xr.Dataset, request: Request, setup: Setup, kernels: Sequence[Kernel],
    edges: Mapping[str, tuple[float, float]], period: Mapping[str, float],
) -> Rings:  # fmt: skip
    """Lay the nodes of a cylinder."""
    assert isinstance(request.frame, Cylindrical)
    if request.gradient == "finite_difference":
        msg = "gradient='finite_difference' takes a mesh along x, y and z, not a cylindrical frame; take another way"
        raise ValueError(msg)
    if request.sampling == "cell":
        msg = (
            "sampling='cell' takes the cells of a mesh along x, y and z, and a cylindrical frame has none: leave it out"
        )
        raise ValueError(msg)
    reach = max(k.cutoff for k in kernels)
    automatic = _automatic(ds, setup, edges, reach)
    if {"x", "y"} <= set(automatic):
        automatic["r"] = 0.0, _largest_radius(ds) + reach
    axes = ("rtz" if "z" in setup.plane else "rt") if request.axes is None and request.at is None else request.axes
    return make_rings(
        axes or "",
        request.at or {},
        request.bounds or {},
        min(k.width for k in kernels) if request.spacing is None else request.spacing,
        plane=setup.plane,
        kernel=min(kernels, key=lambda k: k.cutoff),
        seen_all=setup.dimension,
        error=request.frame.error,
        automatic=automatic,
        period=period,
    )


def _largest_radius(ds: xr.Dataset) -> float:
    """Distance from the axis z of the outermost grain of the first and last step; of the corners of a lazy scene."""
    if isinstance(ds["position"].variable._data, np.ndarray):
        ends = ds["position"].transpose("time", "particle", "component")[[0, -1]].to_numpy()
        return float(np.nanmax(np.hypot(ends[..., 0], ends[..., 1])))
    far = np.maximum(np.abs(ds.attrs["particle_lower"]), np.abs(ds.attrs["particle_upper"]))
    return float(np.hypot(far[0], far[1]))


def _check_pointwise(request: Request) -> None:
    """Refuse what only meshes have."""
    if request.sampling == "cell":
        msg = (
            "sampling='cell' takes averages over the cells of a mesh, and points, which at= has arrays of, have none: "
            "leave it out, or lay a mesh with axes=, bounds= and spacing="
        )
        raise ValueError(msg)
    for name in ("axes", "bounds", "spacing"):
        if getattr(request, name):
            msg = (
                f"{name}={getattr(request, name)!r} lays a mesh, and at= has arrays, which name points: leave it out "
                "(axes that at= does not name are averaged), or give the nodes along an axis as one more array of at=, "
                "such as xr.DataArray(z, dims='z'), which broadcasts against the others"
            )
            raise ValueError(msg)
    if request.gradient == "finite_difference":
        msg = (
            "gradient='finite_difference' takes differences between the nodes of a mesh, and points have no "
            "neighbours: take gradient='least_squares' (the default) or 'kernel'"
        )
        raise ValueError(msg)


def _warn_of_width(width: float, diameter: Any) -> None:
    if diameter is not None and width < _NARROW * diameter:
        msg = (
            f"width={width:.4g} is {width / diameter:.2g} of the grains' diameter ({diameter:.4g}): the kernel sees "
            "the inside of single grains, and no field of a continuum (volume fractions far above 1); the usual choice "
            "is 0.75 mean diameters, see the page on width"
        )
        warn_user(msg)


def _lasting_periods(ds: xr.Dataset, setup: Setup, period: Mapping[str, float]) -> NDArray:
    """Period (3,) along each axis alone, infinity where there is none that is the same in all steps."""
    if "lattice" not in ds:
        lasting = axes_that_stay(ds)
        return np.array([period.get(a, np.inf) if a in lasting else np.inf for a in COMPONENTS])
    if not box_stays(ds):
        return np.full(3, np.inf)
    box = {name: ds[name].isel(time=0).transpose(*row.dims).to_numpy() for name, row in BOX.items() if name in ds}
    return Lattice.of(box, setup.periodic).axis_periods


def _warn_of_cuts(grid: Grid, edges: Mapping[str, tuple[float, float]], reach: float) -> None:
    for a, (low, high) in edges.items():
        # grains and cuts of scenes that were shifted, or are not wrapped, are beyond an edge by up to a period
        room = high - low + reach
        beyond = [x for x in grid.cuts.get(a, ()) if not low - room <= x <= high + room]
        if beyond:
            msg = (
                f"at={{{a!r}: {beyond[0]:g}}} is outside the box, which is periodic from {low:g} to {high:g} along "
                f"{a!r}: fields are those of the image inside; check the units of lengths"
            )
            warn_user(msg)


def _kernels(ds: xr.Dataset, request: Request, dimension: int) -> list[Kernel]:
    """One kernel for all, or one for each group where `width` maps groups to widths."""
    kernel, width, by = request.kernel, request.width, request.by
    if not isinstance(width, Mapping):
        has_own = isinstance(kernel, Kernel) and width is None
        return [as_kernel(kernel, None if has_own else choose_width(width, ds.attrs), dimension)]
    if by is None or not isinstance(kernel, str):
        msg = f"width={dict(width)!r} gives each group its own: name the groups' variable with by=, and a kernel"
        raise ValueError(msg)
    own = {str(group): value for group, value in width.items()}
    known = groups_of(ds, by, request.groups)
    if set(own) != {str(g) for g in known}:
        msg = f"width={dict(width)!r}: expected a width for each of the groups {list(known)} of {by!r}"
        raise ValueError(msg)
    return [as_kernel(kernel, choose_width(own[str(g)], ds.attrs), dimension) for g in known]


def _options(ds: xr.Dataset, setup: Setup, request: Request) -> Options:
    """Check the choices of the algebra."""
    for name, known in (
        ("gradient", registry.GRADIENTS),
        ("deviatoric", registry.DEVIATORIC),
        ("size", registry.INERTIAL_SIZES),
        ("temperature", registry.TEMPERATURES),
        ("sampling", SAMPLINGS),
    ):
        value = getattr(request, name)
        if value not in known:
            msg = f"{name}={value!r}: expected one of {', '.join(known)}"
            raise ValueError(msg)
    if request.sampling == "cell" and request.gradient == "kernel":
        msg = (
            "gradient='kernel' is the derivative at a node, and sampling='cell' averages over cells: take "
            "gradient='least_squares' (the default), or 'finite_difference' between the cells"
        )
        raise ValueError(msg)
    size, fluid_viscosity = request.size, request.fluid_viscosity
    for name in ("pressure_dims", "shear_dims"):
        axes = getattr(request, name)
        if axes is not None and (not axes or set(axes) - set(setup.plane) or len(set(axes)) < len(axes)):
            msg = f"{name}={axes!r}: expected some of the scene's axes {setup.plane!r}, each once"
            raise ValueError(msg)
    if fluid_viscosity is not None and not is_positive(fluid_viscosity):
        msg = f"fluid_viscosity={fluid_viscosity!r}: expected a positive viscosity (Pa s), such as 1e-3 for water"
        raise ValueError(msg)
    if request.friction is not None and not (np.isfinite(request.friction) and request.friction >= 0):
        msg = f"friction={request.friction!r}: expected a coefficient of friction, such as 0.5"
        raise ValueError(msg)
    if size in ("d50", "dmax") and size not in ds.attrs:
        msg = f"size={size!r} is an attribute that the scene does not hold; call ds = ds.cg.measure() first"
        raise ValueError(msg)
    return Options(
        plane=tuple(COMPONENTS.index(a) for a in setup.plane),
        gradient=request.gradient,
        pressure_axes=_indices(request.pressure_dims),
        shear_axes=_indices(request.shear_dims),
        deviatoric=request.deviatoric,
        size=size,
        diameter=float(ds.attrs.get(size, np.nan)),
        fluid_viscosity=fluid_viscosity,
        friction=request.friction,
        temperature=request.temperature,
        lag=ds.attrs.get("lag"),
    )


def _with_friction(friction: float | None) -> dict[str, Moment]:
    """Return the moment that takes the coefficient of friction, with it."""
    name = "sliding_contacts"
    return {} if friction is None else {name: replace(MOMENTS[name], column=partial(sliding_contacts, friction))}


def _indices(axes: str | None) -> tuple[int, ...] | None:
    return None if axes is None else tuple(COMPONENTS.index(a) for a in axes)


def _automatic(
    ds: xr.Dataset, setup: Setup, edges: Mapping[str, tuple[float, float]], cutoff: float
) -> dict[str, tuple[float, float]]:
    """Bounds by default: the period, or the particles' extent with their supports, or the box they were read with."""
    lower, upper = ds.attrs.get("particle_lower"), ds.attrs.get("particle_upper")
    # a box does not follow positions that were changed
    follows = known_without_reading(ds, "position")
    found = {a: ends for a, ends in edges.items() if follows or a in setup.periodic}
    if lower is not None and upper is not None:
        for k, a in enumerate(COMPONENTS):
            if a not in setup.periodic or a not in edges:
                found[a] = (float(lower[k]) - cutoff, float(upper[k]) + cutoff)
    return found


def _check_differentiable(kernel: Kernel, seen: int) -> None:
    if kernel.code == kinds.HEAVISIDE:
        msg = "gradient='kernel' needs a kernel that is differentiable: Heaviside is not; take gradient='least_squares'"
        raise ValueError(msg)
    if kernel.smoothness == 0:
        msg = (
            f"the {kernel.name} kernel is continuous, but its slope jumps at its cutoff: its gradient is exact almost "
            "everywhere, and the fields made of it jump where a grain comes into reach; take Lucy for smooth ones"
        )
        warn_user(msg)
    elif not kernel.differentiable:
        msg = (
            f"the {kernel.name} kernel jumps at its cutoff: its gradient leaves the jump out (8 % low for a Gaussian "
            "cut at 3 w); take Lucy, or gradient='least_squares'"
        )
        warn_user(msg)


def _extents(
    grid: Grid, extent: Mapping[str, float], edges: Mapping[str, tuple[float, float]], *, tilted: bool
) -> dict[str, float | None]:
    loose = [a for a in extent if a not in grid.averaged]
    if loose:
        msg = f"extent names {loose}, but the averaged axes are {list(grid.averaged)}: leave it out"
        raise ValueError(msg)
    found: dict[str, float | None] = {}
    for a in grid.averaged:
        length = extent.get(a)
        if length is None and a not in edges and not tilted:
            msg = (
                f"fields are averaged along {a!r}, and the scene has no finite box there: give the length that the "
                f"integral is divided by, extent={{{a!r}: length}}, or resolve or fix the axis (axes=, at=)"
            )
            raise ValueError(msg)
        if length is not None and not is_positive(length):
            msg = f"extent[{a!r}]={length!r}: expected a positive length (m)"
            raise ValueError(msg)
        found[a] = None if length is None else float(length)
    return found


def scale_of(plan: Plan, lattice: Lattice, source: str) -> float:
    """1 / (extents of the averaged axes x thickness of the layer) for one step."""
    given = {**plan.extent, **({plan.depth: None} if isinstance(plan.depth, str) else {})}
    lengths = [length for length in given.values() if length is not None]
    of_box = np.array([a in given and given[a] is None for a in COMPONENTS])
    if of_box.any():
        lengths.append(lattice.extent(of_box))
        if not (np.isfinite(lengths[-1]) and lengths[-1] > 0):
            lattice.seen(plan.deposit.grid.active, source)  # which may say more
            axes = " and ".join(repr(a) for a, averaged in zip(COMPONENTS, of_box, strict=True) if averaged)
            msg = (
                f"{source}: fields are averaged along {axes}, and the box of this step is not finite there; give the "
                "length that the integral is divided by (extent=)"
            )
            raise SceneError(msg)
    if isinstance(plan.depth, float):
        lengths.append(plan.depth)
    return 1.0 / float(np.prod(lengths))
