"""From what is asked for to what will be done: a plan of one call, which travels to the tasks that carry it out."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import unknown
from xcg.compiled.segments import RULES
from xcg.fields.formulas import registry
from xcg.fields.formulas.averages import needed_for_averages, squared_integral
from xcg.fields.formulas.field import Options, Quantity, Support
from xcg.fields.formulas.rows.errors import OF_FITS, OF_PLACES
from xcg.fields.formulas.rows.flow import FITS
from xcg.fields.formulas.variables import OwnField, check_turns, own_field, own_fields
from xcg.fields.grids.grid import check_axes
from xcg.fields.layout import (
    check_differentiable,
    extents_of,
    kernels_of,
    nodes_of,
    undercut_size,
)
from xcg.fields.request import Request
from xcg.fields.sums.kernels import Kernel
from xcg.fields.sums.moments import Moment
from xcg.fields.sums.nodes import BLOCK_NODES, CACHED, FEWEST_NODES, FINE, Nodes
from xcg.fields.sums.quadrature import SINGLE, gauss_limits
from xcg.scene.facts import extent_text
from xcg.scene.scene import Scene
from xcg.scene.schema import COMPONENTS, CONTACT_VARIABLES, Setup
from xcg.scene.summary import Summary

# what passes go over, as the text of a plan names it, by `over` of their moments
_OVER = {
    "grains": "particles",
    "slopes": "particles, with grad Psi",
    "vectors": "particles or contact points, relative to means",
    "contacts": "contact points",
    "branches": "contacts",
    "pairs": "contact points of two phases",
    "walls": "contact points at walls",
}
_PASS_EACH = ("vectors", "branches")  # whose moments have a pass each
DENSE = 0.6  # volume fraction of the packing for which the noise is estimated


@dataclass(eq=False)
class Plan:
    """Plan of one call of `coarse_grain`; print it to see what the call will do.

    Attributes
    ----------
    fields : tuple of str
        What is computed: what was asked for, and the sums that averages of it need.
    requested : tuple of str
        The variables of the result; the other fields are its coordinates.
    variables : tuple of str
        What is read from the scene.
    moments : mapping
        Sums that are made, by name.
    nodes : Nodes
        Where.
    options : Options
        Choices of the algebra.
    kernels : tuple of Kernel
        The kernel of each group, or one for all.
    limits : array
        Longest branch (cutoffs) for 2, 4, ... Gauss-Legendre points; empty for closed forms.
    coarse : bool
        Whether single precision is enough for the weights of quadrature.
    by : str or None
        Integer particle variable that divides the grains into phases.
    groups : tuple of int
        Its values, one phase each.
    extent : dict
        Length of each averaged axis (m); None takes the box of each step.
    depth : float or str or None
        Thickness of a one-layer scene (m), or the axis whose box extent it is.
    setup : Setup
        What holds for the whole scene.
    rtol : float
        Promise for the contact stress.
    undercut : str, optional
        Size beside which the kernel is so narrow that it sees single grains, such as "d43".
    effective_count : float, optional
        Particles of d43 that a node sees as equals (N_eff) in a packing of the volume fraction
        `DENSE`; None where d43 or the box is not known. Estimated by `explain` alone.
    floors : str, optional
        Values that single steps show where the true one is 0. Estimated by `explain` alone.
    named : bool
        Whether the fields were asked for by name.
    support : Support, optional
        Effective numbers of a node, where fields of single steps depend on them and they are known.
    stretch : array (3, 2), optional
        Least and largest rate at which the box changes its length along each axis (s-1), where it
        does and its images are taken to be at rest.
    walls : str, optional
        What the accessible fraction takes. Measured by `explain` alone.

    Other attributes follow from these: `dims`, of the nodes, and phase where there are several;
    `phases`, their number, the bulk included; `group_count`, without it, and `other_count`, groups of
    partners, the last one for walls; `kernel`, the widest; `weights`, the first kernel as loops take
    it; `cutoffs` and `widths` of the kernels (m), and `cutoff_of_group`; `shapes`, of one step of
    each field in the result; `reached`, the number of nodes in the box around the support of a grain;
    `block_nodes`, of those computed at a time; `attrs`, attributes of the result.
    """

    fields: tuple[str, ...]
    requested: tuple[str, ...]
    variables: tuple[str, ...]
    moments: Mapping[str, Moment]
    nodes: Nodes
    options: Options
    kernels: tuple[Kernel, ...]
    limits: NDArray
    coarse: bool
    by: str | None
    groups: tuple[int, ...]
    extent: Mapping[str, float | None]
    depth: float | str | None
    setup: Setup
    rtol: float
    undercut: str | None = None
    effective_count: float | None = None
    floors: str | None = None
    named: bool = False
    support: Support | None = None
    stretch: NDArray | None = None
    walls: str | None = None

    def __post_init__(self) -> None:
        self.phases = 1 + len(self.groups)
        self.group_count = max(1, len(self.groups))
        self.other_count = self.group_count + 1
        self.kernel = max(self.kernels, key=lambda k: k.cutoff)
        self.weights = self.kernels[0].weights(len(self.nodes.seen))
        self.cutoffs = [k.cutoff for k in self.kernels]
        self.widths = [k.width for k in self.kernels]
        self.cutoff_of_group = np.resize(self.cutoffs, self.group_count)
        self.dims = self.nodes.dims
        sizes = self.nodes.sizes
        if self.by:
            self.dims += ("phase",)
            sizes += (self.phases,)
        self.shapes: dict[str, tuple[int, ...]] = {}
        for name in self.fields:
            row = registry.row(name, self.options)
            self.shapes[name] = sizes + (self.phases,) * row.paired + (3,) * row.rank
        self.reached = self.nodes.nodes_within(2.0 * max(self.cutoffs))

    @cached_property
    def block_nodes(self) -> int:
        """Number of nodes that are computed at a time."""
        if self.reached <= FINE:
            return BLOCK_NODES
        in_cache = CACHED // (8 * max(1, self._numbers))
        return min(BLOCK_NODES, max(FEWEST_NODES, in_cache))

    @property
    def _numbers(self) -> int:
        """Number of sums at a node."""
        return self.group_count * sum(moment.width for moment in self.moments.values())

    @cached_property
    def attrs(self) -> dict[str, Any]:
        """Attributes of the result: nodes, kernel and options."""
        options = self.options
        width: Any = self.kernel.width
        cutoff: Any = self.kernel.cutoff
        if len(self.widths) > 1:
            width = self.widths
            cutoff = self.cutoffs
        wraps = zip(COMPONENTS, options.wrapped, strict=True)
        lengths = {axis: length for axis, length in self.extent.items() if length is not None}
        attrs = {
            **self.nodes.attrs,
            "kernel": self.kernel.name,
            "width": width,
            "cutoff": cutoff,
            "kernel_dimension": self.kernel.dimension,
            "rtol": self.rtol,
            "gradient": options.gradient,
            "pressure_dims": _letters(options.pressure_axes or options.plane),
            "deviatoric": options.deviatoric,
            "size": options.size,
            "temperature": options.temperature,
            "averaged_axes": self.nodes.averaged,
            "wrapped_axes": "".join(a for a, is_wrapped in wraps if is_wrapped),
            "shear_dims": _letters(options.shear_axes or ()) or None,
            "fluid_viscosity": options.fluid_viscosity,
            "friction": options.friction,
            "size_diameter": options.diameter,
            "lag": options.lag,
            "extent": extent_text(lengths) or None,
            "fields_by_name": int(self.named) or None,
        }
        return {name: value for name, value in attrs.items() if value is not None}

    def __str__(self) -> str:
        return "\n".join(f"{key:9s} {text}" for key, text in self._lines().items())

    def _repr_html_(self) -> str:
        return Summary.of("plan of a call of coarse_grain", self._lines().items()).html()

    def _lines(self) -> dict[str, str]:
        """Return the text of the plan by headings."""
        nodes = self.nodes
        averaged = [f"{a} ({self.extent[a] or 'box'})" for a in nodes.averaged]
        kernel = f"{self.kernel!r}, seen in {len(nodes.seen)} of {self.kernel.dimension} dimensions"
        if len(self.widths) > 1:
            kernel += f"; widths by group {[float(f'{w:.4g}') for w in self.widths]}"
        counts = Counter(moment.over for moment in self.moments.values())
        loops = []
        for over, passes in counts.items():
            if over not in _PASS_EACH:
                passes = 1
            loops.append(f"{passes} over {_OVER[over]}")
        sums = min(nodes.count, self.block_nodes) * self._numbers
        outputs = sum(map(math.prod, self.shapes.values()))
        lines = {
            "fields": ", ".join(self.requested),
            "read": ", ".join(self.variables),
            **nodes.text,
            "averaged": ", ".join(averaged) or "none",
            "kernel": kernel,
            "sums": ", ".join(f"{m} ({row.formula})" for m, row in self.moments.items()),
            "loops": ", ".join(loops),
            "contacts": self._rules(),
            "memory": f"{8 * sums / 1e6:.3g} MB of sums a thread and {8 * outputs / 1e6:.3g} MB of fields a step",
        }
        beside = [name for name in self.fields if name not in self.requested]
        if beside:
            lines["averages"] = f"{', '.join(beside)} (as coordinates, for averages)"
        seen = self.effective_count
        if seen is not None:
            velocity = min(1.0, math.sqrt(1 / seen))
            temperature = min(1.0, math.sqrt(2 / self.setup.dimension / seen))
            lines["noise"] = (
                f"velocity +-{velocity:.2g} sqrt(T), temperature +-{100 * temperature:.0f} % in one frame, from "
                f"{seen:.3g} particles (N_eff) at a node with a volume fraction of {DENSE}"
            )
        if self.floors is not None:
            lines["floors"] = self.floors
        if self.walls is not None:
            lines["walls"] = self.walls
        return lines

    def _rules(self) -> str:
        """Return how contacts are integrated along their branches, in words."""
        if not any(moment.over == "branches" for moment in self.moments.values()):
            return "not read for stress"
        rules = "closed form"
        if len(self.limits):
            limits = zip(RULES, self.limits, strict=False)
            steps = ", ".join(f"{k} to {x:.3g} c" for k, x in limits)
            rules = f"Gauss points by branch length ({steps}), closed form beyond"
        if self.coarse:
            rules += ", weights in single precision"
        return f"{rules} (rtol = {self.rtol:g})"


def _letters(axes: Sequence[int]) -> str:
    """Return axes by their letters."""
    return "".join(COMPONENTS[k] for k in axes)


def effective_count(scene: Scene, plan: Plan) -> float | None:
    """N_eff at a node for equal spheres (or discs in a layer) of d43 that fill the share `DENSE` of the space.

    None for rings and widths by group, whose weights are not those of one kernel.
    """
    lengths = [
        length or np.ptp(scene.edges.get(a, (0.0, np.inf))) for a, length in plan.extent.items()
    ]
    other_weights = scene.cylindrical or len(plan.cutoffs) > 1
    if other_weights or "d43" not in scene.sizes or not np.isfinite(lengths).all():
        return None
    space = scene.setup.dimension
    number = DENSE / ({2: math.pi / 4, 3: math.pi / 6}[space] * scene.sizes["d43"] ** space)
    return number * math.prod(lengths) / squared_integral(plan.kernel, len(plan.nodes.seen))


def make_plan(scene: Scene, request: Request) -> Plan:
    """Plan what a request takes, of grains and fields of xcg.

    Raises
    ------
    SceneError
        If the scene lacks variables that the fields need.
    ValueError
        If an argument is wrong.
    """
    scene.require((), "coarse_grain")
    rtol = request.rtol
    by = request.by
    names, requested, options = _fields_and_options(scene, request)
    needed = variables_of(names, scene.columns.keys(), options)
    if not needed <= scene.columns.keys():
        _refuse(scene, names, needed, options)
    read = [n for n in scene.columns if n in {*needed, by, "frozen"}]
    kernels = kernels_of(scene, request)
    widest = max(kernels, key=lambda k: k.cutoff)
    narrowest = min(k.width for k in kernels)
    nodes = nodes_of(scene, request, kernels)
    seen = len(nodes.seen)
    moments = registry.moments_of(names, options)
    if request.gradient == "kernel" and {"mass_slope", "momentum_slope"} & moments.keys():
        check_differentiable(widest)
    limits = np.zeros(0)
    if rtol and any(moment.over == "branches" for moment in moments.values()):
        limits = gauss_limits(widest, seen, rtol)
    groups: tuple[int, ...] = ()
    if by is not None or request.groups is not None:
        groups = scene.groups(by, request.groups)
    x, y, z = (nodes.spacing.get(a, 0.0) for a in COMPONENTS)
    options = replace(
        options,
        active=tuple(nodes.active.tolist()),
        shape=nodes.shape,
        spacing=(x, y, z),
        wrapped=nodes.fills(np.array(scene.lasting_periods)),
    )
    return Plan(
        fields=names,
        requested=requested,
        variables=tuple(read),
        moments=moments,
        nodes=nodes,
        options=options,
        kernels=tuple(kernels),
        limits=limits,
        coarse=limits.size > 0 and rtol >= SINGLE,
        by=by,
        groups=groups,
        extent=extents_of(nodes, request.extent or {}, scene),
        depth=scene.layer_depth,
        setup=scene.setup,
        rtol=rtol,
        undercut=undercut_size(scene, request, narrowest),
    )


def _refuse(scene: Scene, names: Sequence[str], needed: Set[str], options: Options) -> None:
    """Raise SceneError as the scene lacks some of the variables that the fields need."""
    here = scene.columns.keys()
    lacking = [name for name in names if not variables_of((name,), here, options) <= here]
    instead = ""
    if "contact_stress" in registry.order_of(lacking, options) and (
        variables_of(("contact_stress",), here, options) <= here
    ):
        instead = "; or ask for contact_stress, which needs no velocity"
    scene.require(sorted(needed), f"coarse_grain of {', '.join(lacking)}", instead)


# --- which fields are meant, which variables they take, and the choices of their algebra ---------------------


def _fields_and_options(
    scene: Scene, request: Request
) -> tuple[tuple[str, ...], tuple[str, ...], Options]:
    """Return the computed fields, the requested fields, and the choices of their algebra."""
    if request.by_pair and request.by is None:
        raise ValueError(
            "by_pair=True splits stress by pairs of phases: name their variable, such as by='species'"
        )
    options = _options_of(scene, request)
    names, own = _choose_fields(request.fields, scene, options)
    if scene.cylindrical and own:
        check_turns(own)
    absent: Set[str] = set()
    if scene.cylindrical:
        absent = OF_PLACES
    elif options.gradient not in FITS:
        absent = OF_FITS
    if request.errors:
        names, own = _with_errors(names, own, scene, absent)
    if unknown_here := absent & {*names}:
        raise ValueError(
            f"{', '.join(sorted(unknown_here))}: available only in Cartesian axes, with gradient='least_squares' or "
            "'paper'"
        )
    if request.per is not None and any(name.endswith("_error") for name in names):
        raise ValueError(
            "errors=True with per='accessible': errors are those of sums per volume; leave one out"
        )
    needed = registry.order_of(names, replace(options, own=own))
    registered = (
        registry.OwnRow(name, registry.REGISTERED[name])
        for name in needed
        if name in registry.REGISTERED
    )
    options = replace(options, own=(*own, *registered))
    if request.by_pair:
        names = tuple(dict.fromkeys([*names, "contact_stress_by_pair"]))
    requested = names
    if request.for_averages is not False or request.per is not None:
        names = (*names, *needed_for_averages(names, options))
    if request.for_averages:
        requested = names
    return names, requested, options


def possible_fields(scene: Scene, request: Request) -> tuple[str, ...]:
    """Return the names of the fields that the scene's variables allow: the fields of a request without names."""
    return _possible(scene, _options_of(scene, request))


def _possible(scene: Scene, options: Options) -> tuple[str, ...]:
    here = scene.columns.keys()
    rows = registry.FIELDS
    lacking = {n for n, row in rows.items() if row.option and getattr(options, row.option) is None}
    usual = [name for name in registry.listed() if rows[name].default and name not in lacking]
    possible = tuple(name for name in usual if variables_of((name,), here, options) <= here)
    if not possible:
        scene.require(("mass",), "coarse_grain")
    return possible


def _choose_fields(
    fields: str | Quantity | Sequence[str | Quantity | registry.OwnRow] | None,
    scene: Scene,
    options: Options,
) -> tuple[tuple[str, ...], tuple[OwnField | registry.OwnRow, ...]]:
    """Names of the fields of a result, and of the quantities of the scene's own variables among them."""
    if fields is None:
        return _possible(scene, options), ()
    requested: list[Any] = [fields]
    if isinstance(fields, Iterable) and not isinstance(fields, str):
        requested = list(fields)
    listed = registry.listed()
    names = requested.copy()
    own: dict[int, OwnField | registry.OwnRow] = {}
    if not all(isinstance(name, str) and name in listed for name in names):
        own = own_fields(requested, scene)
    for k, field in own.items():
        names[k] = field.name
    if not names:
        raise ValueError(
            f"fields={fields!r}: expected at least one; leave it out for all that the scene allows"
        )
    available = [*listed, *(field.name for field in own.values())]
    for name in names:
        if name not in available:
            raise ValueError(_unknown_field(name, scene))
        row = registry.FIELDS.get(name)
        if row is None or not row.option or getattr(options, row.option) is not None:
            continue
        if row.option == "lag":
            raise ValueError(
                f"{name} compares two frames: call ds.cg.displacement({name!r}) instead of coarse_grain"
            )
        raise ValueError(f"{name} needs the argument {row.option}=")
    return tuple(dict.fromkeys(map(str, names))), tuple(dict.fromkeys(own.values()))


def _unknown_field(name: Any, scene: Scene) -> str:
    """Return the message about a field that does not exist."""
    listed = registry.listed()
    word = str(name).lower()
    if word in registry.CALLS:
        return f"{name!r} is no field; did you mean {registry.CALLS[word]}?"
    if word == "all":
        return "fields='all': leave fields out for all that the scene allows"
    parts = re.findall(r"\w+", str(name))
    if len(parts) > 1 and all(part in listed for part in parts):
        return f"fields={name!r}: give several fields as a list, {parts}"
    others = "others are listed by xcg.FIELDS and by ds.data_vars"
    return unknown("field", name, [*listed, *scene.rows], others, registry.OTHER_NAMES)


def _with_errors(
    names: tuple[str, ...],
    own: tuple[OwnField | registry.OwnRow, ...],
    scene: Scene,
    absent: Set[str],
) -> tuple[tuple[str, ...], tuple[OwnField | registry.OwnRow, ...]]:
    """Add the errors of one step of the fields that have them, unless absent."""
    quantities = [field.error for field in own if isinstance(field, OwnField)]
    further = tuple(own_field(quantity, scene) for quantity in quantities if quantity is not None)
    errors = [
        f"{name}_error" for name in names if f"{name}_error" in registry.FIELDS.keys() - absent
    ]
    if not errors and not further:
        raise ValueError(
            "errors=True: errors of a single step exist for velocity, granular_temperature and others, not for "
            f"{', '.join(names)}: leave errors= out, and take the errors of time_average over several steps"
        )
    names = (*names, *errors, *(field.name for field in further))
    return tuple(dict.fromkeys(names)), (*own, *further)


def variables_of(fields: Iterable[str], here: Set[str], options: Options) -> set[str]:
    """Variables that some fields need, of a scene with the variables `here`."""
    needed = {"position", "particle_id"}
    for name, row in registry.moments_of(fields, options).items():
        needed |= {*row.variables, *(here & {*row.optional})}
        if name == "partners" and "coordination_number" in here:
            needed.add("coordination_number")
        elif row.contacts:
            needed |= set(CONTACT_VARIABLES) - {"contact_normal"}
            needed |= here & {"diameter"}  # tells contacts that are far from their grains
    return needed


def _options_of(scene: Scene, request: Request) -> Options:
    """Return the options of the algebra; raise ValueError if one is wrong."""
    setup = scene.setup
    size = request.size
    indices: dict[str, tuple[int, ...]] = {}
    for name in ("pressure_dims", "shear_dims"):
        axes = getattr(request, name)
        if axes is not None:
            check_axes(setup.plane, **{name: axes})
            indices[name] = tuple(map(COMPONENTS.index, axes))
    if size in ("d50", "dmax") and size not in scene.sizes:
        raise ValueError(
            f"size={size!r} is an attribute that the scene does not hold; call ds = ds.cg.measure() first"
        )
    axes = request.axes_of(setup.plane)
    at = request.at or {}
    averaged = {a for a in setup.plane if isinstance(axes, str) and a not in axes and a not in at}
    derivatives = "zero"
    if "lattice_velocity" in scene.columns and averaged & {*setup.periodic}:
        derivatives = "box"
    elif averaged == {*setup.plane} and not averaged <= {*setup.periodic} and not scene.cylindrical:
        derivatives = "unknown"
    temperature: str = request.temperature
    if request.by is not None and temperature == "unbiased":
        temperature = "mixture"
    return Options(
        plane=tuple(COMPONENTS.index(a) for a in setup.plane),
        gradient=request.gradient,
        pressure_axes=indices.get("pressure_dims"),
        shear_axes=indices.get("shear_dims"),
        deviatoric=request.deviatoric,
        size=size,
        diameter=scene.sizes.get(size),
        fluid_viscosity=request.fluid_viscosity,
        friction=request.friction,
        temperature=temperature,
        lag=scene.lag,
        by=request.by,
        averaged_gradient=derivatives,
    )
