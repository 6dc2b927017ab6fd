"""What a DEM dataset is: its names, dimensions and units, its checks, and what it completes.

A *scene* is an `xarray.Dataset` whose rows fill a prefix of the ``particle`` and ``contact`` dimensions; the
rest is padding (``particle_id == -1``, ``contact_i == -1``, NaN). Rows of particles are sorted by id. One step
on its own, without padding, is a *frame*: a plain ``dict`` from the names below to NumPy arrays.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

COMPONENTS = ("x", "y", "z")
PADDING = -1
MAX_GROUPS = 100

Frame: TypeAlias = dict[str, NDArray]


class SceneError(ValueError):
    """Something in the DEM data is missing, contradictory or not finite."""


class SceneWarning(UserWarning):
    """Something in the data or the request is probably not what was meant."""


# --- names, dimensions, units ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Variable:
    """One variable of the scene: dimensions besides time, powers of (length, mass, time), kind."""

    dims: tuple[str, ...]
    powers: tuple[int, int, int]
    long_name: str
    dtype: str = "float64"

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
    "particle_id": Variable(_PARTICLE, (0, 0, 0), "identifier of the particle", "int64"),
    "position": Variable((*_PARTICLE, "component"), (1, 0, 0), "position of the particle centre"),
    "velocity": Variable((*_PARTICLE, "component"), (1, 0, -1), "velocity of the particle"),
    "diameter": Variable(_PARTICLE, (1, 0, 0), "diameter"),
    "density": Variable(_PARTICLE, (-3, 1, 0), "density of the particle's material"),
    "mass": Variable(_PARTICLE, (0, 1, 0), "mass"),
    "volume": Variable(_PARTICLE, (3, 0, 0), "volume"),
    "species": Variable(_PARTICLE, (0, 0, 0), "species", "int64"),
    "body_id": Variable(_PARTICLE, (0, 0, 0), "identifier of the body that the particle is glued to", "int64"),
    "frozen": Variable(_PARTICLE, (0, 0, 0), "1 where the particle is held in place and acts as a wall", "int64"),
    "coordination_number": Variable(_PARTICLE, (0, 0, 0), "number of contact partners"),
    "contact_i": Variable(_CONTACT, (0, 0, 0), "id of the particle that the force acts on", "int64"),
    "contact_j": Variable(_CONTACT, (0, 0, 0), "id of its partner; negative for a wall", "int64"),
    "contact_force": Variable((*_CONTACT, "component"), (1, 1, -2), "contact force on particle i"),
    "contact_point": Variable((*_CONTACT, "component"), (1, 0, 0), "contact point"),
    "contact_normal": Variable((*_CONTACT, "component"), (0, 0, 0), "unit normal from j to i"),
    "overlap": Variable(_CONTACT, (1, 0, 0), "overlap"),
}
BOX = Variable(("component", "bound"), (1, 0, 0), "edges of the domain")

_NAMED_UNITS = {(0, 0, 0): "1", (1, 1, -2): "N", (-1, 1, -2): "Pa", (-2, 1, -2): "Pa m-1"}


def units_of(powers: tuple[int, int, int], unit_system: str = "SI") -> str:
    """Return the UDUNITS form of powers of (length, mass, time); "1" for everything in a reduced scene."""
    if unit_system != "SI":
        return "1"
    if powers in _NAMED_UNITS:
        return _NAMED_UNITS[powers]
    length, mass, time = powers
    parts = [(unit, power) for unit, power in (("kg", mass), ("m", length), ("s", time)) if power]
    return " ".join(unit if power == 1 else f"{unit}{power}" for unit, power in parts)


def variable(name: str, dtype: Any = "float64") -> Variable:
    """Return the row of a scene variable; any other name is one value a particle, without a unit."""
    kind = "int64" if np.issubdtype(dtype, np.integer) else "float64"
    return VARIABLES.get(name, Variable(_PARTICLE, (0, 0, 0), name.replace("_", " "), kind))


# --- what files do not say -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Setup:
    """What holds for the whole scene and is not in its rows.

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
        Depth of a one-layer scene; None takes the box depth where it is finite, else the largest diameter.
    shape : str
        "sphere" or "disc": how volume follows from diameter.
    density : float or None
        Material density where the data hold neither mass nor density.
    scales : tuple of float
        Factors from the data's units of (length, mass, time) to those of the scene.
    unit_system : str
        "SI" or "reduced".
    """

    periodic: str = ""
    gravity: tuple[float, float, float] | None = None
    dimension: int = 3
    plane: str = "xyz"
    thickness: float | None = None
    shape: str = "sphere"
    density: float | None = None
    scales: tuple[float, float, float] = (1.0, 1.0, 1.0)
    unit_system: str = "SI"

    def __post_init__(self) -> None:
        if set(self.periodic) - set(COMPONENTS):
            msg = f"periodic={self.periodic!r}: expected any of 'x', 'y', 'z', for example periodic='xy'"
            raise SceneError(msg)
        if self.dimension not in (2, 3) or len(self.plane) != self.dimension or set(self.plane) - set(COMPONENTS):
            msg = (
                f"dimension={self.dimension!r} with plane={self.plane!r}: expected dimension=3, "
                "or dimension=2 with the two axes of the plane, for example plane='xy'"
            )
            raise SceneError(msg)
        if self.shape not in ("sphere", "disc"):
            msg = f"shape={self.shape!r}: expected 'sphere' or 'disc'"
            raise SceneError(msg)
        for name in ("density", "thickness"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0):
                msg = f"{name}={value!r}: expected a positive number"
                raise SceneError(msg)
        if self.shape == "disc" and self.thickness is None:
            msg = "discs need thickness=: their volume is pi d^2/4 times the thickness of the layer"
            raise SceneError(msg)

    @classmethod
    def make(
        cls,
        *,
        units: Mapping[str, float] | str | None = None,
        gravity: Sequence[float] | None = None,
        dimension: int = 3,
        plane: str | None = None,
        **given: Any,
    ) -> Setup:
        """Build from the arguments of the public calls (`units` as a mapping, "reduced", or None for SI)."""
        scales, unit_system = (1.0, 1.0, 1.0), "SI"
        if units == "reduced":
            unit_system = "reduced"
        elif isinstance(units, Mapping):
            wrong = set(units) - {"length", "mass", "time"}
            if wrong or not all(np.isfinite(v) and v > 0 for v in units.values()):
                msg = (
                    f"units={dict(units)!r}: expected positive factors to SI for any of 'length' (m), 'mass' (kg) "
                    "and 'time' (s), for example units={'length': 1e-3}"
                )
                raise SceneError(msg)
            scales = (units.get("length", 1.0), units.get("mass", 1.0), units.get("time", 1.0))
        elif units is not None and str(units).upper() != "SI":
            msg = f"units={units!r}: expected None (SI), 'reduced', or factors like {{'length': 1e-3}}"
            raise SceneError(msg)
        if gravity is not None:
            vector = np.asarray(gravity, float)
            if vector.shape != (3,) or not np.isfinite(vector).all():
                msg = f"gravity={gravity!r}: expected three finite components, for example (0, 0, -9.81)"
                raise SceneError(msg)
            gravity = (float(vector[0]), float(vector[1]), float(vector[2]))
        plane = plane or ("xyz" if dimension == 3 else "xy")
        given["periodic"] = "".join(axis for axis in COMPONENTS if axis in (given.get("periodic") or "")) + "".join(
            sorted(set(given.get("periodic") or "") - set(COMPONENTS))
        )
        return cls(gravity=gravity, dimension=dimension, plane=plane, scales=scales, unit_system=unit_system, **given)

    def factor(self, powers: tuple[int, int, int]) -> float:
        """Factor from the data's units to the scene's, for powers of (length, mass, time)."""
        return float(np.prod([scale**power for scale, power in zip(self.scales, powers, strict=True)]))


# --- one frame: scale, check, complete -------------------------------------------------------------------


def _check_rows(frame: Frame, dim: str, where: str) -> None:
    """Refuse arrays of the wrong shape or with values that are not finite; name every bad variable at once."""
    first = next(name for name in frame if variable(name).dims[0] == dim)
    rows = len(frame[first])
    problems = []
    for name, values in frame.items():
        expected = variable(name, values.dtype).shape(rows)
        if values.shape != expected:
            problems.append(f"'{name}' has shape {values.shape}, expected {expected}")
        elif values.dtype.kind == "f" and not np.isfinite(values).all():
            bad = int(np.argwhere(~np.isfinite(values))[0][0])
            problems.append(f"'{name}' is not finite in row {bad}: {values[bad]}")
    if problems:
        msg = f"{where}: " + "; ".join(problems) + ". Every row must hold finite numbers: repair or drop it."
        raise SceneError(msg)


def _typed(frame: Mapping[str, ArrayLike], setup: Setup, where: str) -> Frame:
    """Give arrays their types and the scene's units."""
    typed: Frame = {}
    for name, values in frame.items():
        array = np.asarray(values)
        row = variable(name, array.dtype)
        if row.dtype == "int64" and array.dtype.kind == "f":
            if array.size and not (np.isfinite(array).all() and (array == np.rint(array)).all()):
                bad = int(np.flatnonzero(~np.isfinite(array) | (array != np.rint(array)))[0])
                msg = f"{where}: '{name}' must hold whole numbers, but row {bad} is {array.flat[bad]!r}"
                raise SceneError(msg)
            array = np.rint(array)
        array = array.astype(row.dtype)
        factor = setup.factor(row.powers)
        typed[name] = array if factor == 1.0 else array * factor
    return typed


def complete_particles(frame: Mapping[str, ArrayLike], setup: Setup, where: str) -> Frame:
    """Check the particles of one frame, sort them by id, and derive what is missing.

    Mass, volume, density and diameter follow from each other: volume ``pi d^3/6`` (discs: ``pi d^2/4`` times
    the layer's thickness), ``mass = density * volume``. What is given is taken as it is.

    Parameters
    ----------
    frame : mapping
        Arrays by scene name, at least ``position`` (n, 3).
    setup : Setup
        What the data do not say.
    where : str
        File and step, for messages.

    Raises
    ------
    SceneError
        If an array has the wrong shape or is not finite, an id occurs twice, or a size or mass is not positive.
    """
    given = _typed(frame, setup, where)
    if "position" not in given:
        msg = f"{where}: no positions; expected a variable 'position' with three components"
        raise SceneError(msg)
    count = len(given["position"])
    ids = given.setdefault("particle_id", np.arange(count, dtype="int64"))
    _check_rows(given, "particle", where)
    if count:
        order = np.argsort(ids, kind="stable")
        if (order[1:] != order[:-1] + 1).any():
            given = {name: values[order] for name, values in given.items()}
            ids = given["particle_id"]
        repeated = np.flatnonzero(ids[1:] == ids[:-1])
        if repeated.size:
            rows = order[repeated[0] : repeated[0] + 2]
            twice = f"particle id {ids[repeated[0]]} occurs twice (rows {rows[0]} and {rows[1]})"
            msg = f"{where}: {twice}; ids must be unique"
            raise SceneError(msg)
        if ids[0] < 0:
            negative = f"particle id {ids[0]} in row {order[0]} is negative"
            msg = f"{where}: {negative}; negative ids are kept for walls and padding"
            raise SceneError(msg)
    for name in ("diameter", "density", "mass", "volume"):
        if name in given and (given[name] <= 0).any() and not (name == "mass" and (given[name] >= 0).all()):
            bad = int(np.flatnonzero(given[name] <= 0)[0])
            msg = f"{where}: '{name}' of particle {ids[bad]} is {given[name][bad]!r}; expected a positive number"
            raise SceneError(msg)
    _complete_size_and_mass(given, setup)
    return given


def _complete_size_and_mass(frame: Frame, setup: Setup) -> None:
    count = len(frame["position"])
    disc = np.pi / 4 * (setup.thickness or 0.0)
    if "volume" not in frame:
        if "diameter" in frame:
            d = frame["diameter"]
            frame["volume"] = disc * d**2 if setup.shape == "disc" else np.pi / 6 * d**3
        elif {"mass", "density"} <= set(frame):
            frame["volume"] = frame["mass"] / frame["density"]
    if "diameter" not in frame and "volume" in frame:
        v = frame["volume"]
        frame["diameter"] = np.sqrt(v / disc) if setup.shape == "disc" else np.cbrt(6 / np.pi * v)
    if "density" not in frame and "mass" not in frame and setup.density is not None:
        frame["density"] = np.full(count, float(setup.density))
    if "volume" in frame:
        if "density" not in frame and "mass" in frame:
            frame["density"] = frame["mass"] / frame["volume"]
        elif "mass" not in frame and "density" in frame:
            frame["mass"] = frame["density"] * frame["volume"]


def periods(box: NDArray | None, periodic: str, where: str = "scene") -> NDArray:
    """Box length along the periodic axes, infinity along the others; shape (3,)."""
    lengths = np.full(3, np.inf)
    for axis in periodic:
        k = COMPONENTS.index(axis)
        lengths[k] = np.nan if box is None else box[k, 1] - box[k, 0]
        if not (np.isfinite(lengths[k]) and lengths[k] > 0):
            msg = (
                f"{where}: axis '{axis}' is periodic, but the box has no finite extent along it; give its edges, "
                f"for example box={{'{axis}': (0.0, 0.1)}}"
            )
            raise SceneError(msg)
    return lengths


def minimum_image(vector: NDArray, period: NDArray) -> NDArray:
    """Shortest periodic image of vectors (n, 3); `period` holds infinity along axes that are not periodic."""
    shortest = vector.copy()
    for k in np.flatnonzero(np.isfinite(period)):
        shortest[:, k] -= period[k] * np.rint(vector[:, k] / period[k])
    return shortest


def rows_of(ids: NDArray, wanted: NDArray) -> NDArray:
    """Row of each wanted id among sorted ids, -1 where it is not there."""
    if not len(ids):
        return np.full(len(wanted), -1)
    row = np.minimum(np.searchsorted(ids, wanted), len(ids) - 1)
    return np.where(ids[row] == wanted, row, -1)


def complete_contacts(
    frame: Mapping[str, ArrayLike],
    particles: Frame,
    box: NDArray | None,
    setup: Setup,
    where: str,
    *,
    allow_unknown: bool = False,
) -> Frame:
    """Check the contacts of one frame against its particles and derive missing contact points.

    For spheres the contact point lies on the branch at ``R_i - overlap/2`` from the centre of i, with
    ``overlap = R_i + R_j - |r_i - r_j|`` and ``r_i - r_j`` the minimum image.

    Parameters
    ----------
    frame : mapping
        Arrays by scene name, at least ``contact_i``, ``contact_j`` (n,) and ``contact_force`` (n, 3).
    particles : Frame
        The particles of the same step, completed.
    box : array (3, 2) or None
        Edges of the domain, in the scene's units.
    allow_unknown : bool
        Take contacts with ids that are not among the particles as contacts with a wall.

    Raises
    ------
    SceneError
        For unknown ids, a particle in contact with itself, values that are not finite, or a contact point that
        is missing and cannot be derived.
    """
    given = _typed(frame, setup, where)
    missing = [name for name in ("contact_i", "contact_j", "contact_force") if name not in given]
    if missing:
        msg = f"{where}: contacts lack {missing}; map the file's names to these with names={{...}}"
        raise SceneError(msg)
    _check_rows(given, "contact", where)
    i, j = given["contact_i"], given["contact_j"]
    ids = particles["particle_id"]
    row_i, row_j = rows_of(ids, i), rows_of(ids, j)
    self_contact = np.flatnonzero(i == j)
    if self_contact.size:
        row = self_contact[0]
        msg = f"{where}: contact row {row} joins particle {i[row]} with itself; drop such rows"
        raise SceneError(msg)
    if (i < 0).any():
        row = int(np.flatnonzero(i < 0)[0])
        msg = f"{where}: contact row {row} has id {i[row]} as 'contact_i'; a wall must stand as 'contact_j'"
        raise SceneError(msg)
    unknown = (row_i < 0) | ((row_j < 0) & (j >= 0))
    if unknown.any() and not allow_unknown:
        row = int(np.flatnonzero(unknown)[0])
        name, value = ("contact_i", i[row]) if row_i[row] < 0 else ("contact_j", j[row])
        msg = (
            f"{where}: contact row {row} has {name}={value}, and no particle has this id ({int(unknown.sum())} such "
            "rows); check that particles and contacts are of the same step, or pass allow_unknown=True to treat "
            "unknown partners as walls"
        )
        raise SceneError(msg)
    if "contact_point" not in given:
        given["contact_point"] = _contact_points(
            given, particles, row_i, row_j, periods(box, setup.periodic, where), where
        )
    return given


def _contact_points(
    contacts: Frame, particles: Frame, row_i: NDArray, row_j: NDArray, period: NDArray, where: str
) -> NDArray:
    partnerless = (row_i < 0) | (row_j < 0)
    if partnerless.any():
        row = int(np.flatnonzero(partnerless)[0])
        msg = (
            f"{where}: contact row {row} (i={contacts['contact_i'][row]}, j={contacts['contact_j'][row]}) has no "
            "contact point, and none follows without both spheres; give 'contact_point' for contacts with walls"
        )
        raise SceneError(msg)
    if "diameter" not in particles:
        msg = f"{where}: contact points follow from diameters, but the particles have none; give one of the two"
        raise SceneError(msg)
    branch = minimum_image(particles["position"][row_i] - particles["position"][row_j], period)
    length = np.linalg.norm(branch, axis=1)
    radius_i, radius_j = particles["diameter"][row_i] / 2, particles["diameter"][row_j] / 2
    share = (length + radius_i - radius_j) / (2 * np.where(length > 0, length, 1.0))
    return particles["position"][row_i] - share[:, None] * branch


# --- many frames: the Dataset ----------------------------------------------------------------------------


def stack(frames: Sequence[Frame], names: Sequence[str], rows: int) -> Frame:
    """Stack frames along a new first axis, padded to `rows` rows."""
    stacked = {}
    for name in names:
        row = variable(name, frames[0][name].dtype)
        out = np.full((len(frames), *row.shape(rows)), row.fill, row.dtype)
        for t, frame in enumerate(frames):
            out[t, : len(frame[name])] = frame[name]
        stacked[name] = out
    return stacked


def measure_frames(frames: Sequence[Frame]) -> dict[str, Any]:
    """Sizes and extent of particles, as attributes: what default widths and bounds follow from.

    ``d43 = S d^4 / S d^3``, ``d50`` the diameter below which half of the volume lies, ``dmin``, ``dmax``, the
    lowest and highest coordinates of the centres, and the values that integer variables take (``species_values``),
    over all the frames given.
    """
    measured: dict[str, Any] = {}
    positions = [f["position"] for f in frames if len(f["position"])]
    if positions:
        measured["particle_lower"] = np.min([p.min(axis=0) for p in positions], axis=0)
        measured["particle_upper"] = np.max([p.max(axis=0) for p in positions], axis=0)
    diameters = [f["diameter"] for f in frames if "diameter" in f]
    if diameters and sum(map(len, diameters)):
        d = np.sort(np.concatenate(diameters))
        share = np.cumsum(d**3)
        measured["d43"] = float((d**4).sum() / (d**3).sum())
        measured["d50"] = float(d[np.searchsorted(share, 0.5 * share[-1])])
        measured["dmin"], measured["dmax"] = float(d[0]), float(d[-1])
    for name in frames[0] if frames else ():
        values = [f[name] for f in frames if f[name].dtype.kind == "i"]
        if values and name != "particle_id":
            unique = np.unique(np.concatenate(values))
            if 0 < len(unique) <= MAX_GROUPS:
                measured[f"{name}_values"] = unique
    return measured


def to_dataset(
    arrays: Mapping[str, Any],
    *,
    time: ArrayLike,
    step: ArrayLike,
    box: NDArray | None,
    setup: Setup,
    measured: Mapping[str, Any],
) -> xr.Dataset:
    """Label padded arrays (NumPy or dask, time first) as a scene.

    Parameters
    ----------
    arrays : mapping
        Padded arrays by scene name, time first.
    time, step : array (t,)
        Times (s) and step numbers.
    box : array (t, 3, 2) or None
        Edges of the domain.
    """
    data = {}
    for name, values in arrays.items():
        row = variable(name, values.dtype)
        attrs = {"units": units_of(row.powers, setup.unit_system), "long_name": row.long_name}
        data[name] = xr.Variable(("time", *row.dims), values, attrs)
    if box is not None:
        attrs = {"units": units_of(BOX.powers, setup.unit_system), "long_name": BOX.long_name}
        data["box"] = xr.Variable(("time", *BOX.dims), box, attrs)
    second = "s" if setup.unit_system == "SI" else "1"
    coords = {
        "time": ("time", np.asarray(time, float), {"units": second, "long_name": "time", "axis": "T"}),
        "step": ("time", np.asarray(step, "int64"), {"units": "1", "long_name": "number of the time step"}),
        "component": ("component", list(COMPONENTS)),
    }
    if box is not None:
        measured = {"box_lower": box[0, :, 0], "box_upper": box[0, :, 1], **measured}
    attrs: dict[str, Any] = {
        "Conventions": "CF-1.11",
        "periodic": setup.periodic,
        "dimension": setup.dimension,
        "plane": setup.plane,
        "unit_system": setup.unit_system,
        **({} if setup.gravity is None else {"gravity": np.asarray(setup.gravity)}),
        **({} if setup.thickness is None else {"thickness": setup.thickness}),
        **measured,
    }
    return xr.Dataset(data, coords, attrs)


_BOX_FORMS = "six numbers as [[x0, x1], [y0, y1], [z0, z1]], or a mapping {'x': (x0, x1), ...}"


def box_array(box: ArrayLike | Mapping[str, Sequence[float]], steps: int) -> NDArray:
    """Edges of the domain as an array (steps, 3, 2); axes left out of a mapping are unbounded."""
    if isinstance(box, Mapping):
        wrong = set(box) - set(COMPONENTS)
        if wrong:
            msg = f"box has keys {sorted(wrong)}: expected {_BOX_FORMS}"
            raise SceneError(msg)
        box = [box.get(axis, (-np.inf, np.inf)) for axis in COMPONENTS]
    edges = np.asarray(box, float)
    if edges.shape not in ((3, 2), (steps, 3, 2)):
        msg = f"box has shape {edges.shape}: expected {_BOX_FORMS}, or one such array a step"
        raise SceneError(msg)
    if not (edges[..., 0] < edges[..., 1]).all():
        msg = f"box={box!r}: the lower edge of every axis must lie below the upper edge"
        raise SceneError(msg)
    return np.broadcast_to(edges, (steps, 3, 2)).copy()


def _split_steps(name: str, values: Any) -> list[NDArray]:
    """Arrays of one step each, from one step, a stack of steps, or a list of steps of different length."""
    if isinstance(values, (list, tuple)) and len(values) and np.ndim(values[0]) == len(variable(name).dims):
        return [np.asarray(v) for v in values]
    array = np.asarray(values)
    dims = len(variable(name).dims)
    if array.ndim == dims:
        return [array]
    if array.ndim == dims + 1:
        return list(array)
    msg = f"'{name}' has shape {array.shape}: expected {dims} dimensions for one step, or {dims + 1} with time first"
    raise SceneError(msg)


def scene_from_arrays(
    position: Any,
    *,
    time: ArrayLike | None = None,
    step: ArrayLike | None = None,
    box: ArrayLike | Mapping[str, Sequence[float]] | None = None,
    periodic: str = "",
    gravity: Sequence[float] | None = None,
    dimension: int = 3,
    plane: str | None = None,
    thickness: float | None = None,
    shape: str = "sphere",
    density: Any = None,
    units: Mapping[str, float] | str | None = None,
    allow_unknown: bool = False,
    **variables: Any,
) -> xr.Dataset:
    """Build a scene from arrays in memory.

    Every variable may be one step ``(n, ...)``, a stack of steps ``(t, n, ...)``, or a list of steps of
    different length. Mass, volume, density, diameter and contact points that are missing are completed
    (`complete_particles`, `complete_contacts`).

    Parameters
    ----------
    position : array (n, 3), array (t, n, 3) or list of arrays
        Positions of the centres (m).
    time, step : array (t,), optional
        Times (s) and step numbers; 0, 1, 2, ... by default.
    box : array (3, 2), array (t, 3, 2) or mapping, optional
        Edges of the domain (m), needed along periodic axes.
    periodic : str
        Periodic axes, for example "xy".
    gravity : three floats, optional
        Acceleration of gravity (m s-2).
    dimension, plane, thickness, shape
        ``dimension=2`` for one layer of particles in `plane` ("xy" by default), see `Setup`.
    density : float or array
        Density of the material (kg m-3): one number, or one a particle.
    units : mapping or "reduced", optional
        Factors from the data's units to SI, for example ``{"length": 1e-3}``; "reduced" for scaled data.
    allow_unknown : bool
        Take contacts with ids that are not among the particles as contacts with a wall.
    **variables
        Other variables by their scene name: ``velocity``, ``diameter``, ``mass``, ``volume``, ``particle_id``,
        ``species``, ``contact_i``, ``contact_j``, ``contact_force``, ``contact_point``, ...

    Returns
    -------
    xarray.Dataset
        The scene, in memory.

    Raises
    ------
    SceneError
        If arrays disagree or do not make a scene; the message names the variable and row.

    Examples
    --------
    >>> import xcg
    >>> ds = xcg.scene_from_arrays([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], diameter=[1.0, 1.0], density=2500.0)
    >>> dict(ds.sizes)
    {'time': 1, 'particle': 2, 'component': 3}
    """
    one_density = density if np.ndim(density) == 0 else None
    setup = Setup.make(
        units=units, gravity=gravity, dimension=dimension, plane=plane, periodic=periodic, thickness=thickness,
        shape=shape, density=one_density,
    )  # fmt: skip
    given = {"position": position, **variables}
    if density is not None and one_density is None:
        given["density"] = density
    steps = {name: _split_steps(name, values) for name, values in given.items() if values is not None}
    counts = {name: len(values) for name, values in steps.items()}
    if len(set(counts.values())) > 1:
        msg = f"variables have different numbers of steps: {counts}"
        raise SceneError(msg)
    total = counts["position"]
    edges = None if box is None else box_array(box, total) * setup.factor(BOX.powers)
    particle_names = [name for name in steps if variable(name).dims[0] == "particle"]
    contact_names = [name for name in steps if variable(name).dims[0] == "contact"]
    particles, contacts = [], []
    for t in range(total):
        where = f"step {t}" if total > 1 else "scene"
        particles.append(complete_particles(_prefix(steps, particle_names, "particle_id", t), setup, where))
        if contact_names:
            frame = _prefix(steps, contact_names, "contact_i", t)
            box_t = None if edges is None else edges[t]
            contacts.append(complete_contacts(frame, particles[-1], box_t, setup, where, allow_unknown=allow_unknown))
        periods(None if edges is None else edges[t], setup.periodic, where)
    arrays: Frame = {}
    for frames, key in ((particles, "particle_id"), (contacts, "contact_i")):
        if frames:
            arrays |= stack(frames, list(frames[0]), max(len(f[key]) for f in frames))
    return to_dataset(
        arrays,
        time=np.arange(total) if time is None else np.atleast_1d(np.asarray(time, float)) * setup.scales[2],
        step=np.arange(total) if step is None else np.atleast_1d(step),
        box=edges,
        setup=setup,
        measured=measure_frames(particles),
    )


def _prefix(steps: Mapping[str, list[NDArray]], names: Sequence[str], key: str, t: int) -> Frame:
    """Drop the rows of step t that `key` marks as padding."""
    frame = {name: steps[name][t] for name in names}
    if key in frame:
        valid = frame[key] != PADDING
        if not valid.all():
            frame = {name: values[valid] for name, values in frame.items()}
    return frame


# --- reading a scene -------------------------------------------------------------------------------------


def require_scene(ds: xr.Dataset, names: Sequence[str], purpose: str) -> None:
    """Refuse a Dataset that lacks variables; the message lists all that is missing.

    Raises
    ------
    SceneError
        If `ds` is not a scene or lacks any of `names`.
    """
    missing = [name for name in ("position", "particle_id", *names) if name not in ds]
    if missing:
        msg = (
            f"{purpose} needs {sorted(set(missing))}, which this Dataset does not hold (it has "
            f"{sorted(map(str, ds.data_vars))}); open it with xcg.open_scene or build it with xcg.scene_from_arrays, "
            "giving contacts= for fields of contacts and density= where files hold no mass"
        )
        raise SceneError(msg)


def setup_of(ds: xr.Dataset) -> Setup:
    """Return what a scene's attributes say."""
    gravity = ds.attrs.get("gravity")
    setup = Setup.make(
        periodic=ds.attrs.get("periodic", ""),
        gravity=None if gravity is None else np.asarray(gravity, float).tolist(),
        dimension=int(ds.attrs.get("dimension", 3)),
        plane=ds.attrs.get("plane"),
        thickness=ds.attrs.get("thickness"),
    )
    return replace(setup, unit_system=ds.attrs.get("unit_system", "SI"))


def frame_of(arrays: Mapping[str, NDArray], t: int) -> Frame:
    """One frame of padded arrays: the rows of step `t` that are not padding."""
    frame: Frame = {}
    for key, dim in (("particle_id", "particle"), ("contact_i", "contact")):
        if key not in arrays:
            continue
        valid = arrays[key][t] != PADDING
        count = int(valid.sum())
        rows: Any = slice(0, count) if valid[:count].all() else valid
        frame |= {name: a[t][rows] for name, a in arrays.items() if variable(name, a.dtype).dims[0] == dim}
    return frame


def measure(ds: xr.Dataset) -> xr.Dataset:
    """Measure sizes and extent of all steps of a scene and store them as attributes (computes).

    Returns
    -------
    xarray.Dataset
        The same scene with the attributes d43, d50, dmin, dmax, particle_lower and particle_upper set anew.
    """
    require_scene(ds, (), "measure")
    names = [str(name) for name in ds.data_vars if variable(str(name), ds[name].dtype).dims[0] == "particle"]
    frames = []
    for t in range(ds.sizes["time"]):
        arrays = {name: ds[name].isel(time=[t]).transpose("time", ...).to_numpy() for name in names}
        frames.append(frame_of(arrays, 0))
    return ds.assign_attrs(measure_frames(frames))


def summary(ds: xr.Dataset) -> str:
    """Tell what a Dataset holds of a scene, and what is missing."""
    if "position" not in ds:
        return "not a scene: no 'position' (fields are saved with .cg.to_vtkhdf, .to_netcdf, .to_zarr)"
    sizes = ", ".join(f"{ds.sizes[d]} {d}" for d in ("time", "particle", "contact") if d in ds.sizes)
    lines = [f"scene of {sizes} (largest step)"]
    for dim in ("particle", "contact"):
        names = [str(n) for n in ds.data_vars if dim in ds[n].dims]
        lines.append(f"  {dim + 's:':11s}{', '.join(names) or 'none'}")
    missing = [n for n in ("velocity", "diameter", "mass", "contact_force") if n not in ds]
    lines.append(f"  missing:   {', '.join(missing) or 'nothing'}")
    sizes = ", ".join(f"{k} = {ds.attrs[k]:.6g}" for k in ("dmin", "d50", "d43", "dmax") if k in ds.attrs)
    lines.append(f"  sizes:     {sizes or 'not measured'}")
    lines.append(f"  periodic:  {ds.attrs.get('periodic') or 'no axis'}; dimension {ds.attrs.get('dimension', 3)}")
    return "\n".join(lines)
