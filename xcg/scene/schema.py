"""Schema of a scene: names, dimensions and units of its variables, and its attributes.

A *scene* is an `xarray.Dataset` whose rows fill a prefix of the ``particle`` and ``contact``
dimensions; the rest is padding (``particle_id == -1``, ``contact_i == -1``, NaN). Rows of particles
are sorted by id. One step on its own, without padding, is a *frame*: a plain ``dict`` from the
names below to NumPy arrays.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.checks import is_finite, is_positive, vector
from xcg.common.compat import is_in_memory
from xcg.common.messages import SceneError, warn_user

COMPONENTS = ("x", "y", "z")
_ORDERED = ("", "x", "y", "z", "xy", "xz", "yz", "xyz")  # axes as attributes hold them
PADDING = -1
MAX_GROUPS = 100
# m; powers of lengths between these are numbers, too
SHORTEST = 1e-75
LONGEST = 1e75
_OF_EARTH = (9.75, 10.05)  # m s-2, between which gravity on Earth is rounded

Frame: TypeAlias = dict[str, NDArray]
Powers: TypeAlias = tuple[int, int, int]  # of length, mass, time
Shape: TypeAlias = Literal["sphere", "disc"]
# what becomes of contacts that are listed from both sides, see `xcg.scene.repeats`
Sides: TypeAlias = Literal["mean", "first", "separate"]


# --- names, dimensions, units ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Variable:
    """Variable of a scene or result: dimensions besides time, SI unit, name in words, kind.

    Parameters
    ----------
    dims : tuple of str
        Dimensions besides time.
    units : str
        SI unit such as "m s^-1"; "1" without one.
    long_name : str
        Name in words.
    dtype : {"float64", "int64"}
        Kind of number.
    formula : str
        Formula in words, for the attributes of a result.
    """

    dims: tuple[str, ...]
    units: str
    long_name: str
    dtype: str = "float64"
    formula: str = ""

    @property
    def fill(self) -> float | int:
        """Value of padding."""
        return PADDING if self.dtype == "int64" else np.nan

    def shape(self, rows: int) -> tuple[int, ...]:
        """Shape of one frame of `rows` rows."""
        return (rows, *(2 if dim == "bound" else 3 for dim in self.dims[1:]))


_PARTICLE = ("particle",)
_CONTACT = ("contact",)
VARIABLES: dict[str, Variable] = {
    "particle_id": Variable(_PARTICLE, "1", "identifier of the particle", "int64"),
    "position": Variable((*_PARTICLE, "component"), "m", "position of the particle centre"),
    # the unwrapped position is ``position + image @ lattice``, with the lattice vectors a, b, c of
    # the same step
    "image": Variable(
        (*_PARTICLE, "component"),
        "1",
        "number of periods along a, b and c between the position and the unwrapped position",
        "int64",
    ),
    "velocity": Variable((*_PARTICLE, "component"), "m s^-1", "velocity of the particle"),
    "angular_velocity": Variable(
        (*_PARTICLE, "component"), "s^-1", "angular velocity of the particle"
    ),
    "diameter": Variable(_PARTICLE, "m", "diameter"),
    "density": Variable(_PARTICLE, "kg m^-3", "density of the particle's material"),
    "mass": Variable(_PARTICLE, "kg", "mass"),
    "volume": Variable(_PARTICLE, "m^3", "volume"),
    "moment_of_inertia": Variable(_PARTICLE, "kg m^2", "moment of inertia about the centre"),
    "species": Variable(_PARTICLE, "1", "species", "int64"),
    "body_id": Variable(
        _PARTICLE, "1", "identifier of the body that the particle is glued to", "int64"
    ),
    "frozen": Variable(
        _PARTICLE, "1", "1 where the particle is fixed in place and acts as a wall", "int64"
    ),
    "director": Variable(
        (*_PARTICLE, "component"), "1", "director: the axis of a grain that is not round"
    ),
    **{
        f"quat_{k}": Variable(_PARTICLE, "1", f"{k} of the quaternion that turns the grain's axes")
        for k in "wxyz"
    },
    **{
        f"half_axis_{k}": Variable(_PARTICLE, "m", f"half-axis of the grain along its {k}")
        for k in COMPONENTS
    },
    "exponent_1": Variable(_PARTICLE, "1", "exponent n1 of a superquadric: 2 for ellipsoids"),
    "exponent_2": Variable(_PARTICLE, "1", "exponent n2 of a superquadric: 2 for ellipsoids"),
    "coordination_number": Variable(_PARTICLE, "1", "number of contact partners"),
    # an input only: `image` follows from it, and it is not kept
    "unwrapped_position": Variable(
        (*_PARTICLE, "component"), "m", "position that goes on across periodic edges"
    ),
    "contact_i": Variable(_CONTACT, "1", "id of the particle that the force acts on", "int64"),
    "contact_j": Variable(_CONTACT, "1", "id of its partner; negative for a wall", "int64"),
    "contact_force": Variable((*_CONTACT, "component"), "N", "contact force on particle i"),
    "contact_point": Variable((*_CONTACT, "component"), "m", "contact point"),
    "contact_normal": Variable((*_CONTACT, "component"), "1", "unit normal from j to i"),
    "contact_wall_velocity": Variable(
        (*_CONTACT, "component"), "m s^-1", "velocity of the wall at the contact"
    ),
    "overlap": Variable(_CONTACT, "m", "overlap"),
    # an input only: it says on which side of a grain the contact point is, and is not kept
    "contact_branch": Variable(
        (*_CONTACT, "component"), "m", "vector from j to i, in the image that touches"
    ),
}
# Read only where they are asked for, as few fields need them.
ROTATION = ("angular_velocity", "moment_of_inertia")
MOTION = ("image",)
# the domain of a step; the lattice is there where edges are not along x, y and z, its velocity
# where images move
BOX: dict[str, Variable] = {
    "box": Variable(("component", "bound"), "m", "edges of the domain"),
    "lattice": Variable(
        ("vector", "component"), "m", "vectors a, b, c to the next periodic images"
    ),
    "lattice_velocity": Variable(
        ("vector", "component"), "m s^-1", "rate at which the lattice vectors change"
    ),
}
SCHEMA = VARIABLES | BOX
# the long name of times that are numbers of steps
NUMBERED = "number of the time step, as the times are not known"
OF_STEP = (*BOX, "step")  # what tasks take of a step besides its rows
VECTORS = ("a", "b", "c")

_UNITS: dict[str, Powers] = {
    "kg": (0, 1, 0), "m": (1, 0, 0), "s": (0, 0, 1), "N": (1, 1, -2), "Pa": (-1, 1, -2), "J": (2, 1, -2),
    "W": (2, 1, -3),
}  # fmt: skip
_FACTOR = re.compile(r"([^\W\d_]+|%)(?:\^|\*\*)?(-?\d+)?")


def units_in(units: str, unit_system: str) -> str:
    """Return an SI unit as results of a scene have it: "1" in a reduced scene."""
    return units if unit_system == "SI" else "1"


def units_of(powers: Powers) -> str:
    """Return the SI unit of powers of (length, mass, time), as UDUNITS and pint read it."""
    length, mass, time = powers
    return _NAMED_UNITS.get(powers) or product_of_units({"kg": mass, "m": length, "s": time})


def powers_of(units: str) -> Powers:
    """Return the powers of (length, mass, time) of an SI unit such as "kg m^-3" or "Pa"; the inverse of `units_of`.

    Raises
    ------
    ValueError
        If it is not a product of known units.
    """
    factors = factors_of_unit(units)
    if factors is None or not factors.keys() <= _UNITS.keys():
        raise ValueError(
            f"units={units!r}: expected '1' or a product of {', '.join(_UNITS)} with whole powers, such as 'kg m^-3'; "
            "for angles, in radians, '1'"
        )
    length, mass, time = (
        sum(power * _UNITS[name][k] for name, power in factors.items()) for k in range(3)
    )
    return length, mass, time


def factors_of_unit(units: str) -> dict[str, int] | None:
    """Return the power of each factor of a unit such as "K kg m^-3", "K kg m-3" or "1"; None for another notation."""
    factors: dict[str, int] = {}
    if units == "1":
        return factors
    for part in units.split():
        match = _FACTOR.fullmatch(part)
        if match is None:
            return None
        factors[match[1]] = factors.get(match[1], 0) + int(match[2] or 1)
    return factors


def product_of_units(factors: Mapping[str, int]) -> str:
    """Return the unit with some factors and powers; "1" without any."""
    written = [
        name if power == 1 else f"{name}^{power}" for name, power in factors.items() if power
    ]
    return " ".join(written) or "1"


_NAMED_UNITS = {powers_of(units): units for units in ("N", "Pa", "Pa m^-1", "W m^-2", "W m^-3")}


def variable(name: str, dtype: Any = "float64", ndim: int = 1) -> Variable:
    """Return the row of a scene variable.

    Any other name is a variable of the particles, or of the contacts if it begins with "contact_":
    a scalar, vector or tensor by the number of dimensions of one step, without a unit.
    """
    if name in VARIABLES:
        return VARIABLES[name]
    kind = "float64"
    if np.issubdtype(dtype, np.integer):
        kind = "int64"
    rows = _PARTICLE
    if name.startswith("contact_"):
        rows = _CONTACT
    dims = (*rows, "component", "direction")
    return Variable(dims[:ndim], "1", name.replace("_", " "), kind)


# Factors to SI of LAMMPS's unit systems.
UNIT_SYSTEMS: dict[str, Mapping[str, float] | str | None] = {
    "si": None,
    "lj": "reduced",
    "cgs": {"length": 1e-2, "mass": 1e-3},
    "micro": {"length": 1e-6, "mass": 1e-15, "time": 1e-6},
    "nano": {"length": 1e-9, "mass": 1e-21, "time": 1e-9},
}
_UNIT_OF_FORCE = {"real": "kcal/mol/Angstrom", "metal": "eV/Angstrom", "electron": "Hartree/Bohr"}


def units_of_system(system: str, named: str) -> Mapping[str, float] | str | None:
    """Return the units of a system of LAMMPS by name; `named` begins the message about another one."""
    if system in _UNIT_OF_FORCE:
        raise SceneError(
            f"{named} the unit system {system!r}, whose unit of force, {_UNIT_OF_FORCE[system]}, does not follow from "
            "those of length, mass and time, and forces would be wrong: convert forces to a consistent unit, and give "
            "the factors to SI, for example units={'length': 1e-10, 'mass': 1.66054e-27, 'time': 1e-15}"
        )
    if system not in UNIT_SYSTEMS:
        raise SceneError(
            f"{named} the unit system {system!r}, known are {', '.join(UNIT_SYSTEMS)}; give the factors to SI, for "
            "example units={'length': 1e-10, 'mass': 1e-3, 'time': 1e-15}"
        )
    return UNIT_SYSTEMS[system]


# --- lazy variables as measured --------------------------------------------------------------------------

# A lazy variable that is as it was when its attributes were measured has an encoding: this mark, or
# what came with a file that holds the attributes, too. Selections keep encodings, arithmetic drops
# them.
MEASURED = "measured"


def mark_measured(ds: xr.Dataset, names: Sequence[str] | None = None) -> xr.Dataset:
    """Record that the attributes measured from some variables (all by default) match their present values."""
    for name in ds.data_vars if names is None else names:
        ds[name].encoding[MEASURED] = True
    return ds


def known_without_reading(ds: xr.Dataset, name: str) -> bool:
    """Return whether a variable is in memory, or as it was when its attributes were measured."""
    values = ds.variables[name]
    return is_in_memory(values) or bool(values.encoding)


# --- what files do not say -------------------------------------------------------------------------------


def periodic_axes(axes: Any, plane: str | None = None) -> str:
    """Return the periodic axes in order, such as "xy".

    Parameters
    ----------
    axes : str, bool, or list of axes or of a truth value for each axis
        As a user gives them: "xy", ["x", "y"], True for all axes, (True, True, False).
    plane : str, optional
        All axes of the scene.

    Raises
    ------
    SceneError
        If `axes` is something else.
    """
    if axes is None or (isinstance(axes, (bool, np.bool_)) and not axes):
        return ""
    if isinstance(axes, (bool, np.bool_)):
        return plane or "".join(COMPONENTS)
    parts = list(axes) if np.iterable(axes) else [axes]
    if len(parts) == len(COMPONENTS) and all(isinstance(part, (bool, np.bool_)) for part in parts):
        parts = [axis for axis, chosen in zip(COMPONENTS, parts, strict=True) if chosen]
    if not all(isinstance(part, str) and {*part.lower()} <= {*COMPONENTS} for part in parts):
        raise SceneError(
            f"periodic={axes!r}: expected any of 'x', 'y', 'z', for example periodic='xy', True for all axes or "
            "False for none"
        )
    return "".join(sorted({*"".join(parts).lower()}))


def _scales_of(units: Mapping[str, float] | str | None) -> tuple[tuple[float, float, float], str]:
    """Return the factors to the scene's units of (length, mass, time), and its unit system."""
    if isinstance(units, str) and units.lower() in (*UNIT_SYSTEMS, *_UNIT_OF_FORCE):
        units = units_of_system(units.lower(), f"units={units!r} is")
    if units is None:
        return (1.0, 1.0, 1.0), "SI"
    if units == "reduced":
        return (1.0, 1.0, 1.0), "reduced"
    if not isinstance(units, Mapping):
        raise SceneError(
            f"units={units!r}: expected 'SI', 'reduced', a unit system of LAMMPS ({', '.join(UNIT_SYSTEMS)}), or "
            "factors like {'length': 1e-3}"
        )
    wrong = set(units) - {"length", "mass", "time"}
    if wrong or not all(is_positive(v) for v in units.values()):
        raise SceneError(
            f"units={dict(units)!r}: expected positive factors to SI for any of 'length' (m), 'mass' (kg) "
            "and 'time' (s), for example units={'length': 1e-3}"
        )
    return (units.get("length", 1.0), units.get("mass", 1.0), units.get("time", 1.0)), "SI"


def _gravity_of(values: Sequence[float] | None) -> tuple[float, float, float] | None:
    """Return gravity as three numbers; None where it is not known."""
    if values is None:
        return None
    if is_finite(values):
        raise SceneError(
            f"gravity={values!r}: expected three numbers (x, y, z), such as (0.0, 0.0, -9.81)"
        )
    x, y, z = vector("gravity", values, error=SceneError).tolist()
    return x, y, z


@dataclass(frozen=True)
class Setup:
    """Properties of the whole scene that are not in its rows.

    Attributes
    ----------
    periodic : str
        Periodic axes, any of "xyz".
    gravity : tuple of float or None
        Acceleration of gravity (3 components), in the units of the scene.
    dimension : int
        3, or 2 for one layer of particles.
    plane : str
        The axes that the scene extends in: "xyz", or two of them for ``dimension=2``.
    thickness : float or None
        Depth of a one-layer scene; None takes the box depth where it is finite, else the largest
        diameter.
    shape : str
        "sphere" or "disc": how volume follows from diameter.
    density : float or None
        Material density where the data hold neither mass nor density.
    diameter, mass : float or None
        Diameter (m) and mass (kg) of all particles where the data hold neither sizes nor masses.
    scales : tuple of float
        Factors from the data's units of (length, mass, time) to the units of the scene.
    unit_system : str
        "SI" or "reduced".
    sides : str
        "mean", "first" or "separate": what becomes of contacts that are listed from both sides.
    """

    periodic: str = ""
    gravity: tuple[float, float, float] | None = None
    dimension: int = 3
    plane: str = "xyz"
    thickness: float | None = None
    shape: Shape = "sphere"
    density: float | None = None
    diameter: float | None = None
    mass: float | None = None
    scales: tuple[float, float, float] = (1.0, 1.0, 1.0)
    unit_system: str = "SI"
    sides: Sides = "mean"

    def __post_init__(self) -> None:
        plane = self.plane
        if self.dimension not in (2, 3) or len(plane) != self.dimension or {*plane} - {*COMPONENTS}:
            raise SceneError(
                f"dimension={self.dimension!r} with plane={plane!r}: expected dimension=3, "
                "or dimension=2 with the two axes of the plane, for example plane='xy'"
            )
        for name in ("density", "diameter", "mass", "thickness"):
            value = getattr(self, name)
            if value is not None and not is_positive(value):
                raise SceneError(f"{name}={value!r}: expected a positive number")

    @classmethod
    def make(
        cls,
        *,
        units: Mapping[str, float] | str | None = None,
        gravity: Sequence[float] | None = None,
        dimension: int = 3,
        plane: str | None = None,
        **options: Any,
    ) -> Setup:
        """Check the arguments of the public calls.

        `units` are a mapping, "reduced", the name of a unit system of LAMMPS, or None for SI.
        """
        scales, unit_system = _scales_of(units)
        if not plane:
            plane = "xyz" if dimension == 3 else "xy"
        options["periodic"] = periodic_axes(options.get("periodic"), plane)
        made = cls(
            gravity=_gravity_of(gravity),
            dimension=dimension,
            plane=plane,
            scales=scales,
            unit_system=unit_system,
            **options,
        )
        for name, choices in (("shape", Shape), ("sides", Sides)):
            if getattr(made, name) not in get_args(choices):
                expected = ", ".join(map(repr, get_args(choices)))
                raise SceneError(f"{name}={getattr(made, name)!r}: expected one of {expected}")
        if made.shape == "disc" and made.thickness is None:
            raise SceneError(
                "discs need thickness=: their volume is pi d^2/4 times the thickness of the layer"
            )
        made._check_gravity()
        return made

    def _check_gravity(self) -> None:
        """Warn of a gravity that is the Earth's in the units of the data."""
        if self.gravity is None or self.unit_system != "SI":
            return
        factor = self.factor((1, 0, -2))
        standard = tuple(factor * component for component in self.gravity)
        least, most = _OF_EARTH
        if factor != 1 and least < math.hypot(*standard) < most:
            shown = ", ".join(f"{component:.6g}" for component in standard)
            warn_user(
                f"gravity={self.gravity}: expected m s-2, beside units=, too, and this is that of the Earth in the "
                f"units of the data; give gravity=({shown})"
            )

    @classmethod
    def of(cls, attrs: Mapping[Any, Any]) -> Setup:
        """Return the properties that the attributes of a scene hold."""
        dimension = int(attrs.get("dimension", 3))
        plane = attrs.get("plane") or "xyz"[:dimension]
        periodic = attrs.get("periodic", "")
        if str(periodic) not in _ORDERED:  # written by users
            periodic = periodic_axes(periodic, plane)
        return cls(
            periodic=periodic,
            gravity=_gravity_of(attrs.get("gravity")),
            dimension=dimension,
            plane=plane,
            thickness=attrs.get("thickness"),
            unit_system=attrs.get("unit_system", "SI"),
        )

    @property
    def axes(self) -> list[int]:
        """Indices of the axes of `plane`."""
        return [COMPONENTS.index(axis) for axis in self.plane]

    def check_axis(self, axis: object) -> None:
        """Raise ValueError unless this is the name of an axis of the scene."""
        if axis not in [*self.plane]:
            raise ValueError(f"{axis=}: expected one of the scene's axes {', '.join(self.plane)}")

    def factor(self, powers: Powers) -> float:
        """Factor from the data's units to the scene's, for powers of (length, mass, time)."""
        return float(
            math.prod(scale**power for scale, power in zip(self.scales, powers, strict=True))
        )


CONTACT_VARIABLES = ("position", "contact_i", "contact_j", "contact_point", "contact_normal")
