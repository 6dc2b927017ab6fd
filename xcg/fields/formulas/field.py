"""Definition of a field: its row in the registry, the options of its algebra, quantities of variables of the scene."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Literal, TypeAlias

from xcg.common.messages import did_you_mean
from xcg.fields.formulas.algebra import mean_of
from xcg.scene.schema import COMPONENTS, Powers, powers_of

# choices of the algebra, the default first
Gradient: TypeAlias = Literal["least_squares", "kernel", "finite_difference", "paper"]
Deviatoric: TypeAlias = Literal["both", "stress", "rate"]
InertialSize: TypeAlias = Literal["d43", "d32", "d50", "dmax"]
Temperature: TypeAlias = Literal["unbiased", "biased"]
Function = Callable[[Any, Any, "Options"], Any]

# options of the algebra that are arguments of calls, and that averages of a result take from it
OF_CALLS = ("gradient", "pressure_dims", "shear_dims", "deviatoric", "size", "fluid_viscosity")


@dataclass(frozen=True)
class Options:
    """Choices that the algebra depends on.

    Attributes
    ----------
    plane : tuple of int
        The axes of the scene: (0, 1, 2), or two of them.
    active : tuple of bool
        The axes along which grains differ at a node (resolved or fixed ones).
    shape : tuple of int
        Nodes along x, y, z, for finite differences.
    spacing : tuple of float
        Distance of nodes along x, y, z (m), for finite differences; 0 along axes that are not
        resolved.
    wrapped : tuple of bool
        The axes along which the last node is a neighbour of the first.
    gradient : str
        "least_squares", "kernel", "finite_difference" or "paper".
    pressure_dims : str, optional
        Axes of the normal stresses whose mean is the pressure; by default all axes of the scene.
        Formulas take `pressure_axes`, their indices.
    shear_dims : str, optional
        The axes that magnitudes of stress and shear rate are restricted to; the scene's by default.
        Formulas take `shear_axes`.
    deviatoric : str
        Magnitudes computed from deviators: of "both", "stress" or "rate".
    size : str
        The diameter in the inertial number: "d43", "d32", or "d50", "dmax" of the whole scene.
    diameter : float, optional
        The diameter that `size` names, of the whole scene (m); None where it is not known.
    fluid_viscosity : float, optional
        Viscosity of the fluid between the grains (Pa s).
    friction : float, optional
        Coefficient of friction between the grains.
    by : str, optional
        The variable that divides the grains into phases.
    temperature : str
        "unbiased"; "mixture", the same with phases, of which each has a temperature of its own; or
        "biased": per density, whatever the fit takes.
    lag : int, optional
        Frames from each frame to that which it is compared with; given in scenes of displacements.
    averaged_gradient : str
        Derivatives along averaged axes: "zero", "box" (rates of a sheared box), or "unknown", as no
        axis is resolved or fixed and an averaged one is not periodic.
    own : tuple
        Fields from outside xcg, each with a `name`, its `field`, and `moments` by name: of the
        scene's own variables, see `xcg.fields.formulas.variables.OwnField`, and fields that users
        registered, see `NamedField`. What computes a plan in another process finds them here.
    """

    plane: tuple[int, ...] = (0, 1, 2)
    active: tuple[bool, bool, bool] = (True, True, True)
    shape: tuple[int, int, int] = (1, 1, 1)
    spacing: tuple[float, float, float] = (0.0, 0.0, 0.0)
    wrapped: tuple[bool, bool, bool] = (False, False, False)
    gradient: str = "least_squares"
    pressure_dims: str | None = None
    shear_dims: str | None = None
    deviatoric: str = "both"
    size: str = "d43"
    diameter: float | None = None
    fluid_viscosity: float | None = None
    friction: float | None = None
    by: str | None = None
    temperature: str = "unbiased"
    lag: int | None = None
    averaged_gradient: str = "zero"
    own: tuple[Any, ...] = ()

    @cached_property
    def own_fields(self) -> dict[str, Field]:
        """Fields from outside xcg, by name."""
        return {own.name: own.field for own in self.own}

    @property
    def pressure_axes(self) -> tuple[int, ...] | None:
        """Return the indices of `pressure_dims`."""
        return _indices(self.pressure_dims)

    @property
    def shear_axes(self) -> tuple[int, ...] | None:
        """Return the indices of `shear_dims`."""
        return _indices(self.shear_dims)

    @property
    def sliding(self) -> bool:
        """Return whether it is known which contacts slide."""
        return self.friction is not None

    @property
    def dimension(self) -> int:
        """Number of dimensions D of the scene."""
        return len(self.plane)


def _indices(dims: str | None) -> tuple[int, ...] | None:
    """Return axes by their indices; None for None."""
    return None if dims is None else tuple(map(COMPONENTS.index, dims))


@dataclass(frozen=True)
class Support:
    """Effective numbers in the support of a node, of equal grains or contacts that are placed at random.

    Attributes
    ----------
    grains, contacts : float
        N_eff of grains and of contacts, at least 1.
    partners : float
        Contacts of a grain.
    dimension : int
        Number of dimensions D of the scene.
    slope : float
        Root mean square of |Gamma| d over the velocity fluctuation along an axis, of a fit to
        independent velocities without shear.
    volume_fraction : float
        Volume of the grains over that which they extend over.
    branch_spread : float
        Standard deviation of the branch lengths over their mean; NaN before a step is read.
    tangential : float
        Root mean square of the tangential forces over the mean normal one; NaN before a step is read.
    shaken : float
        Velocity fluctuation over sqrt(p / rho_p); infinite before a step is read.
    diameter : float
        d43 (m).
    """

    grains: float
    contacts: float
    partners: float
    dimension: int
    slope: float
    volume_fraction: float
    branch_spread: float = math.nan
    tangential: float = math.nan
    shaken: float = math.inf
    diameter: float = math.nan

    @property
    def is_dense(self) -> bool:
        """Return whether contacts, of which a grain has two halves at least, carry the stress."""
        return self.partners >= 2.0

    def text(self) -> str:
        """Return the numbers that fields of the scene follow from, in words."""
        numbers = {"grains": self.grains}
        if self.is_dense:
            numbers["contacts"] = self.contacts
        texts = [
            f"{number:.{0 if number >= 10 else 1}f} {name}" for name, number in numbers.items()
        ]
        return f"{' and '.join(texts)} (N_eff)"


@dataclass(frozen=True, kw_only=True)
class Field:
    """Field of the registry; names with an underscore first are parts of others, not fields themselves.

    Attributes
    ----------
    rank : int
        0 scalar, 1 vector (``component``), 2 tensor (``component``, ``direction``).
    units : str
        SI unit, such as "kg m^-3" or "Pa"; of a quantity with a `source` any unit, or empty.
    long_name, formula : str
        For the attributes and the table of the documentation.
    compute : callable
        ``compute(f, s, o)``.
    fields, moments : tuple of str
        What it needs.
    additive : bool
        Whether it is a sum: the partial fields of the phases add up to the bulk, and averages over
        nodes or steps are means.
    weight : str
        The additive field that weighs its averages, where it is a ratio: the one in the
        denominator. A field that is neither additive nor weighted is computed anew from averages of
        the fields it needs.
    by_bulk : bool
        Whether `weight` is that of the bulk, also for phases.
    harmonic : bool
        Whether it is its inverse that is averaged with `weight`, as the weight is the numerator.
    covariance : callable, optional
        ``covariance(f, s, o)`` gives what averages over steps or nodes add to the mean of an
        additive field, of ``f.covariance``, that of the velocities: mean rho (V - U)(V - U), U
        their mean, and of ``f.shift``: mean rho_a (V - U). Linear functions of such a field follow.
    references : str
        Where it is defined, authors and year.
    is_norm : bool
        Whether it is a norm of averaged sums, by itself or over others: the bias of its square is
        exact, see `xcg.fields.formulas.block_errors`.
    is_angle : bool
        Whether it is an angle of axes (rad): noise turns these, and blocks do not show by how much.
    averages : str
        What averages are, where a user may expect something else, for the attributes.
    floor : callable, optional
        ``floor(support)`` gives the value that a single step shows where the true one is zero, of a
        norm or an eigenvalue, see `xcg.fields.formulas.floors`.
    usual : float
        Value that the floor is compared with.
    floor_units : str
        Unit of both, where they are no plain numbers, such as "sqrt(T) / d43".
    default : bool
        Whether it is computed where no field is asked for by name.
    option : str
        An attribute of `Options` that has to be given for it.
    paired : bool
        Whether it has the dimension ``other_phase``.
    across_phases : bool
        Whether a phase's value takes the sums of all phases, also where it is computed anew.
    source : str
        The variable of the scene that it is made of, where it is not one that all scenes have.
    """

    rank: int = 0
    units: str = "1"
    long_name: str = ""
    formula: str
    compute: Function
    fields: tuple[str, ...] = ()
    moments: tuple[str, ...] = ()
    additive: bool = False
    weight: str = ""
    by_bulk: bool = False
    harmonic: bool = False
    covariance: Function | None = None
    is_norm: bool = False
    is_angle: bool = False
    references: str = ""
    averages: str = ""
    floor: Callable[[Support], float] | None = None
    usual: float = 0.0
    floor_units: str = ""
    default: bool = True
    option: str = ""
    paired: bool = False
    across_phases: bool = False
    source: str = ""

    def floor_text(self, floor: float) -> str:
        """Return a floor with its unit."""
        return f"{floor:.2g} {self.floor_units}".rstrip()

    @property
    def powers(self) -> Powers:
        """Powers of (length, mass, time) of the unit."""
        return powers_of(self.units)


# of the kinetic stress and what is linear in it
ABOUT_MEAN_VELOCITY = (
    "about the averaged velocity (f.cg.time_average(), f.cg.profile()); f.mean() is the mean of values about the "
    "velocity of each step and node"
)


def sum_of(moment: str, **about: Any) -> Field:
    """Return the row of a field that is one moment."""
    return Field(
        compute=lambda f, s, o: getattr(s, moment), moments=(moment,), additive=True, **about
    )


def mean_of_sums(top: str, bottom: str, **about: Any) -> Field:
    """Return the row of a field that is one moment over another, the sum of its weights."""
    return Field(
        compute=lambda f, s, o: mean_of(getattr(s, top), getattr(s, bottom)),
        moments=(top, bottom),
        **about,
    )


# --- quantities of variables ----------------------------------------------------------------------------

Weight: TypeAlias = Literal["mass", "volume", "number"]
# symbol, unit, and the moment and the field that are its sum
WEIGHTS: dict[Weight, tuple[str, str, str, str]] = {
    "mass": ("m", "kg", "mass", "density"),
    "volume": ("V", "m^3", "volume", "volume_fraction"),
    "number": ("1", "1", "number", "number_density"),
}


@dataclass(frozen=True)
class Quantity:
    """Quantity of a variable: `Mean`, `Sum`, `Variance`, `Flux` or `Conduction`, for the argument `fields`.

    Parameters
    ----------
    variable : str
        A variable of the scene: a scalar, a vector (``component``) or a tensor (``component``,
        ``direction``), of particles or of contacts.
    weight : {"mass", "volume", "number"}, optional
        What particles count by; contacts count by number.
    name : str, optional
        Name of the result.

    Raises
    ------
    ValueError
        If the weight is unknown.
    """

    variable: str
    weight: Weight | None = None
    name: str | None = None

    usual: ClassVar[Weight] = "mass"
    prefix: ClassVar[str] = ""

    def __post_init__(self) -> None:
        if not isinstance(self.variable, str):
            raise ValueError(
                f"{type(self).__name__}({self.variable!r}): expected the name of a variable of the scene"
            )
        if self.weight is not None and self.weight not in WEIGHTS:
            raise ValueError(
                f"{self}: weight={self.weight!r}, expected one of {', '.join(WEIGHTS)}"
            )


class Mean(Quantity):
    """The mean of a variable, ``sum u q Psi / sum u Psi``, in the variable's unit; u is the mass by default.

    The result has the variable's name, or ``mean_<variable>`` where that is the name of a field, as
    of ``density``. NaN where nothing reaches.

    Parameters
    ----------
    variable : str
        A variable of the scene: a scalar, vector or tensor of particles or of contacts.
    weight : {"mass", "volume", "number"}, optional
        What particles count by, "mass" by default; contacts count by number.
    name : str, optional
        Name of the result.
    """


class Sum(Quantity):
    """The sum of a variable in a unit of volume, ``sum u q Psi``; u is 1 by default: charges sum to their density.

    The result is ``sum_<variable>``.

    Parameters
    ----------
    variable : str
        A variable of the scene: a scalar, vector or tensor of particles or of contacts.
    weight : {"mass", "volume", "number"}, optional
        What each particle is multiplied by, "number" (1) by default; contacts count by number.
    name : str, optional
        Name of the result.
    """

    usual = "number"
    prefix = "sum_"


class Variance(Quantity):
    """The variance of each component of a variable, ``sum u (q - <q>)^2 Psi / sum u Psi``; u is the mass by default.

    The result is ``variance_<variable>``, about the bulk's mean also for phases. NaN where nothing
    reaches.

    Parameters
    ----------
    variable : str
        A variable of the scene: a scalar, vector or tensor of particles or of contacts.
    weight : {"mass", "volume", "number"}, optional
        What particles count by, "mass" by default; contacts count by number.
    name : str, optional
        Name of the result.
    """

    prefix = "variance_"


class Flux(Quantity):
    """The flux that fluctuations carry, ``sum u (q - <q>)(v - V) Psi``; u is the mass by default.

    The result is ``flux_<variable>``, a vector for a scalar, and for a vector a tensor
    (``component`` of the variable, ``direction`` of the velocity). The mean and V are the bulk's
    also for phases, so that partial fluxes add up.

    Parameters
    ----------
    variable : str
        A scalar or vector of the particles.
    weight : {"mass", "volume", "number"}, optional
        What particles count by, "mass" by default.
    name : str, optional
        Name of the result.
    """

    prefix = "flux_"


class Conduction(Quantity):
    """The flux of what flows along contacts, as heat or charge do: ``q = sum_c Q [(r_i - c) S_i + (c - r_j) S_j]``.

    The variable is a scalar of contacts, the rate Q that i receives from j (W for heat); j loses as
    much. S_i and S_j are the integrals of Psi from the contact point c to the centres, so that
    ``sum_i Psi_i sum_j Q_ij = -div q`` holds exactly: with `Flux` and the rate of the grains'
    content the balance closes. The flux is from j to i where Q > 0. Contacts with walls have the
    part of their grain only, and the contribution of walls is ``sum_w Q Psi(r - c)``. The result is
    ``conduction_<variable>``, a vector, per area (W m-2).

    Parameters
    ----------
    variable : str
        A scalar of the contacts.
    weight : {"mass", "volume", "number"}, optional
        Only "number", the default.
    name : str, optional
        Name of the result.

    Notes
    -----
    Written as the contact stress is: Goldhirsch (2010), with Q in place of the force; walls:
    Weinhart et al. (2012).

    Examples
    --------
    >>> import xcg
    >>> ds = xcg.datasets.random_scene(200)
    >>> heat = ds.contact_force.isel(component=0, drop=True).assign_attrs(units="W")  # any number for each contact
    >>> f = ds.assign(contact_heat=heat).cg.coarse_grain(xcg.Conduction("contact_heat"), axes="z")
    >>> f.conduction_contact_heat.dims, f.conduction_contact_heat.attrs["units"]
    (('time', 'z', 'component'), 'W m^-2')
    """

    usual = "number"
    prefix = "conduction_"


KINDS: dict[str, type[Quantity]] = {
    "mean": Mean,
    "sum": Sum,
    "variance": Variance,
    "flux": Flux,
    "conduction": Conduction,
}
_CALL = re.compile(r"\s*(\w+)\s*\(([^()]*)\)\s*")


def read_quantity(text: str) -> Quantity | None:
    """Return what a text such as ``"mean(charge, number)"`` or ``"sum(charge, name=c)"`` asks for; None for a name.

    Raises
    ------
    ValueError
        If the text is a call of something else.
    """
    call = _CALL.fullmatch(text)
    if call is None:
        return None
    kind = call[1].lower()
    parts = [part.strip() for part in call[2].split(",")]
    named: dict[str, Any] = dict(
        re.split(r"\s*=\s*", part, maxsplit=1) for part in parts if "=" in part
    )
    plain: list[Any] = [part for part in parts if "=" not in part]
    forms = (
        f"expected one of {', '.join(KINDS)} of a variable, such as 'mean(charge, number, name=q)'"
    )
    if kind not in KINDS:
        raise ValueError(f"{text!r}{did_you_mean(kind, KINDS)}: {forms}")
    if set(named) - {"weight", "name"} or not 0 < len(plain) <= 3:
        raise ValueError(f"{text!r}: {forms}")
    return KINDS[kind](*plain, **named)
