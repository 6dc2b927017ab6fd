"""What one field is: a row of the registry, and the choices that its algebra depends on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, TypeAlias

from xcg.scene.schema import Powers, powers_of

# choices of the algebra, the default first
Gradient: TypeAlias = Literal["least_squares", "kernel", "finite_difference", "paper"]
Deviatoric: TypeAlias = Literal["stress", "rate", "both", "neither"]
InertialSize: TypeAlias = Literal["d43", "d32", "d50", "dmax"]
Temperature: TypeAlias = Literal["unbiased", "biased"]
Function = Callable[[Any, Any, "Options"], Any]


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
        Distance of nodes along x, y, z (m), for finite differences; 0 along axes that are not resolved.
    wrapped : tuple of bool
        The axes along which the last node is a neighbour of the first.
    gradient : str
        "least_squares", "kernel", "finite_difference" or "paper".
    pressure_axes : tuple of int, optional
        The normal stresses whose mean is the pressure; those of the scene by default.
    shear_axes : tuple of int, optional
        The axes that magnitudes of stress and shear rate are restricted to; the scene's by default.
    deviatoric : str
        Which magnitudes are those of deviators: of "stress", "rate", "both" or "neither".
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
        "unbiased", or "biased": per density, whatever the fit takes.
    lag : int, optional
        Frames from each frame to that which it is compared with; given in scenes of displacements.
    averaged_gradient : str
        Derivatives along averaged axes: "zero", "box" (those of a sheared box), or "unknown", as no axis is resolved or
        fixed and an averaged one is not periodic.
    own : tuple
        Fields that are not those of xcg, each with a `name`, its `row`, and `moments` by name: of the scene's own
        variables, see `xcg.fields.formulas.variables.OwnField`, and those that users registered, see `OwnRow`. What
        computes a plan in another process finds them here.
    """

    plane: tuple[int, ...] = (0, 1, 2)
    active: tuple[bool, bool, bool] = (True, True, True)
    shape: tuple[int, int, int] = (1, 1, 1)
    spacing: tuple[float, float, float] = (0.0, 0.0, 0.0)
    wrapped: tuple[bool, bool, bool] = (False, False, False)
    gradient: str = "least_squares"
    pressure_axes: tuple[int, ...] | None = None
    shear_axes: tuple[int, ...] | None = None
    deviatoric: str = "stress"
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
    def own_rows(self) -> dict[str, Field]:
        """Rows of the fields that are not those of xcg, by name."""
        return {one.name: one.row for one in self.own}

    @property
    def sliding(self) -> bool:
        """Whether it is known which contacts slide."""
        return self.friction is not None

    @property
    def dimension(self) -> int:
        """Number of dimensions D of the scene."""
        return len(self.plane)


@dataclass(frozen=True, kw_only=True)
class Field:
    """One field.

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
        Whether it is a sum: the partial fields of the phases add up to the bulk, and averages over nodes or steps are
        means.
    weight : str
        The additive field that weighs its averages, where it is a ratio: the one in the denominator. A field that is
        neither additive nor weighted is computed anew from averages of the fields it needs.
    by_bulk : bool
        Whether `weight` is that of the bulk, also for phases.
    harmonic : bool
        Whether it is its inverse that is averaged with `weight`, as the weight is the numerator.
    listed : bool
        False for steps of the algebra that are not fields of their own.
    default : bool
        Whether it is computed where no field is asked for by name.
    option : str
        An attribute of `Options` that has to be given for it.
    paired : bool
        Whether it has the dimension ``other_phase``.
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
    listed: bool = True
    default: bool = True
    option: str = ""
    paired: bool = False
    source: str = ""

    @property
    def powers(self) -> Powers:
        """Powers of (length, mass, time) of the unit."""
        return powers_of(self.units)
