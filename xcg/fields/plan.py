"""From what is asked for to what will be done: a plan of one call, which travels to the tasks that carry it out."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.compiled.segments import RULES
from xcg.fields.choice import choose_fields
from xcg.fields.formulas import registry
from xcg.fields.formulas.field import Field, Options, Support
from xcg.fields.grids.grid import MeshTooLargeError
from xcg.fields.layout import (
    check_differentiable,
    extents_of,
    kernels_of,
    nodes_of,
    too_large,
    undercut_size,
)
from xcg.fields.request import Request
from xcg.fields.sums.kernels import Kernel
from xcg.fields.sums.moments import Moment
from xcg.fields.sums.nodes import BLOCK_NODES, CACHED, FEWEST_NODES, FINE, Nodes
from xcg.fields.sums.quadrature import SINGLE, gauss_limits
from xcg.scene.facts import extent_text
from xcg.scene.scene import Scene
from xcg.scene.schema import COMPONENTS, Setup, Variable
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
_OF_TENSORS = ("component", "direction")
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
    `phases`, their number, the bulk included; `definitions` of the fields; `group_count`, without it, and
    `other_count`, groups of partners, the last one for walls; `kernel`, the widest; `weights`, the
    first kernel as loops take it; `cutoffs` and `widths` of the kernels (m), and `cutoff_of_group`;
    `outputs`, the fields as variables of the result, and `shapes`, of one step of each; `reached`,
    the number of nodes in the box around the support of a grain; `sum_count`, of sums at a node;
    `block_nodes`, of nodes computed at a time; `attrs`, attributes of the result.
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
        self.weights = self.kernels[0].weights(len(self.nodes.active_axes))
        self.cutoffs = [k.cutoff for k in self.kernels]
        self.widths = [k.width for k in self.kernels]
        self.cutoff_of_group = np.resize(self.cutoffs, self.group_count)
        self.dims = self.nodes.dims
        if self.by:
            self.dims += ("phase",)
        lengths = dict(zip(self.nodes.dims, self.nodes.sizes, strict=True))
        lengths |= {"phase": self.phases, "other_phase": self.phases} | dict.fromkeys(
            _OF_TENSORS, 3
        )
        self.outputs: dict[str, Variable] = {}
        self.shapes: dict[str, tuple[int, ...]] = {}
        for name, field in self.definitions.items():
            dims = self.dims + ("other_phase",) * field.paired + _OF_TENSORS[: field.rank]
            self.outputs[name] = Variable(dims, field.units, field.long_name)
            self.shapes[name] = tuple(lengths[dim] for dim in dims)
        self.reached = self.nodes.nodes_within(2.0 * max(self.cutoffs))
        self.sum_count = self.group_count * sum(moment.width for moment in self.moments.values())
        self.block_nodes = BLOCK_NODES
        if self.reached > FINE:
            in_cache = CACHED // (8 * max(1, self.sum_count))
            self.block_nodes = min(BLOCK_NODES, max(FEWEST_NODES, in_cache))

    @cached_property
    def definitions(self) -> dict[str, Field]:
        """Fields of the registry by name."""
        return {name: registry.field_of(name, self.options) for name in self.fields}

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the definitions: other processes look them up, as formulas travel by their names."""
        return {name: value for name, value in vars(self).items() if name != "definitions"}

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
        extent = extent_text(lengths) if lengths else None
        attrs = {
            **self.nodes.attrs,
            "kernel": self.kernel.name,
            "width": width,
            "cutoff": cutoff,
            "kernel_dimension": self.kernel.dimension,
            "rtol": self.rtol,
            "gradient": options.gradient,
            "pressure_dims": options.pressure_dims or self.setup.plane,
            "deviatoric": options.deviatoric,
            "size": options.size,
            "temperature": options.temperature,
            "averaged_axes": self.nodes.averaged,
            "wrapped_axes": "".join(a for a, is_wrapped in wraps if is_wrapped),
            "shear_dims": options.shear_dims,
            "fluid_viscosity": options.fluid_viscosity,
            "friction": options.friction,
            "size_diameter": options.diameter,
            "lag": options.lag,
            "extent": extent,
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
        kernel = f"{self.kernel!r}, seen in {len(nodes.active_axes)} of {self.kernel.dimension} dimensions"
        if len(self.widths) > 1:
            kernel += f"; widths by group {[float(f'{w:.4g}') for w in self.widths]}"
        counts = Counter(moment.over for moment in self.moments.values())
        loops = []
        for over, passes in counts.items():
            if over not in _PASS_EACH:
                passes = 1
            loops.append(f"{passes} over {_OVER[over]}")
        sums = min(nodes.count, self.block_nodes) * self.sum_count
        outputs = sum(map(math.prod, self.shapes.values()))
        lines = {
            "fields": ", ".join(self.requested),
            "read": ", ".join(self.variables),
            **nodes.text,
            "averaged": ", ".join(averaged) or "none",
            "kernel": kernel,
            "sums": ", ".join(
                f"{name} ({moment.formula})" for name, moment in self.moments.items()
            ),
            "loops": ", ".join(loops),
            "contacts": self._rules(),
            "memory": f"{8 * sums / 1e6:.3g} MB of sums a thread and {8 * outputs / 1e6:.3g} MB of fields a step",
        }
        beside = [name for name in self.fields if name not in self.requested]
        if beside:
            lines["averages"] = f"{', '.join(beside)} (as coordinates, for averages)"
        grains = self.effective_count
        if grains is not None:
            velocity = min(1.0, math.sqrt(1 / grains))
            temperature = min(1.0, math.sqrt(2 / self.setup.dimension / grains))
            lines["noise"] = (
                f"velocity +-{velocity:.2g} sqrt(T), temperature +-{100 * temperature:.0f} % in one frame, from "
                f"{grains:.3g} particles (N_eff) at a node with a volume fraction of {DENSE}"
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


def make_plan(scene: Scene, request: Request) -> Plan:
    """Plan what a request takes, of grains and fields of xcg.

    Raises
    ------
    SceneError
        If the scene lacks variables that the fields need.
    ValueError
        If an argument is wrong, or the mesh has too many nodes; the message then names particles
        that are far from the others.
    """
    scene.require((), "coarse_grain")
    rtol = request.rtol
    by = request.by
    kernels = kernels_of(scene, request)
    widest = max(kernels, key=lambda k: k.cutoff)
    narrowest = min(k.width for k in kernels)
    try:
        nodes = nodes_of(scene, request, kernels)
    except MeshTooLargeError as error:
        raise ValueError(too_large(scene, request, narrowest, error)) from None
    chosen = choose_fields(scene, request, nodes)
    moments = chosen.moments
    if request.gradient == "kernel" and {"mass_slope", "momentum_slope"} & moments.keys():
        check_differentiable(widest)
    limits = np.zeros(0)
    if rtol and any(moment.over == "branches" for moment in moments.values()):
        limits = gauss_limits(widest, len(nodes.active_axes), rtol)
    groups: tuple[int, ...] = ()
    if by is not None or request.groups is not None:
        groups = scene.groups(by, request.groups)
    return Plan(
        fields=chosen.fields,
        requested=chosen.requested,
        variables=chosen.variables,
        moments=moments,
        nodes=nodes,
        options=chosen.options,
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
