"""Systems whose fields are known, for the table of truths: gases, flows, a column, packings, contacts and rods."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.spatial import cKDTree

import xcg
from tests import flows

SIDE = 12.0  # of most boxes, in diameters
VOLUME = {"axes": "xyz", "spacing": 3.0}
PLANE = {"axes": "xz", "at": {"y": 6.0}, "spacing": 2.0}
PROFILE = {"axes": "z", "spacing": 1.0}
BOX = {"axes": ""}
MESHES: Mapping[str, Mapping[str, Any]] = {
    "volume": VOLUME,
    "plane": PLANE,
    "profile": PROFILE,
    "box": BOX,
}
Value: TypeAlias = float | Callable[[xr.Dataset], Any]


@dataclass(frozen=True)
class Truth:
    """True value of a field, or of one of its components, at the nodes of a result.

    Attributes
    ----------
    name : str
        The field.
    value : float or callable
        Its value, or a function of the result.
    part : str
        Component ("x"), components ("xz"), or "trace" for a third of the trace.
    phase : str, optional
        Of which phase.
    scale : float, optional
        What errors are compared with, where the value is zero.
    """

    name: str
    value: Value
    part: str = ""
    phase: str | None = None
    scale: float | None = None

    @property
    def label(self) -> str:
        """Name with component and phase."""
        parts = [f"`{self.name}`", self.part, self.phase and f"of species {self.phase}"]
        return " ".join(part for part in parts if part)

    def of(self, f: xr.Dataset, end: str = "") -> xr.DataArray | None:
        """Return the part of a result that has the value, or of its error where `end` is "_error"."""
        values = f.get(self.name + end)
        if values is None:
            return None
        if "phase" in values.dims:
            values = values.sel(phase=self.phase or "bulk", drop=True)
        if self.part == "trace":
            if end:
                return None
            return sum(values.sel(component=a, direction=a, drop=True) for a in "xyz") / 3
        axes = dict(zip(("component", "direction"), self.part, strict=False))
        return values.sel(axes, drop=True)

    def at(self, f: xr.Dataset) -> Any:
        """Return the true values at the nodes of a result."""
        return self.value(f) if callable(self.value) else self.value


@dataclass(frozen=True)
class System:
    """A scene, its true fields, and the meshes on which they are known."""

    name: str
    make: Callable[[], xr.Dataset]
    truths: Sequence[Truth]
    meshes: Sequence[str] = tuple(MESHES)
    options: Mapping[str, Any] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def nodes(self, mesh: str) -> dict[str, Any]:
        """Return the arguments of a kind of mesh."""
        nodes = dict(MESHES[mesh])
        if self.bounds:
            nodes["bounds"] = {a: ends for a, ends in self.bounds.items() if a in nodes["axes"]}
        return nodes


# --- grains --------------------------------------------------------------------------------------


def placed(rng: np.random.Generator, diameter: NDArray, side: float) -> NDArray:
    """Return places of spheres that do not overlap, in a periodic cube, one after the other at random."""
    position = np.empty((len(diameter), 3))
    for k, d in enumerate(diameter):
        reach = 0.5 * (d + diameter[:k])
        while True:
            position[k] = rng.uniform(0, side, 3)
            apart = position[:k] - position[k]
            apart -= side * np.round(apart / side)
            if ((apart**2).sum(axis=1) >= reach**2).all():
                break
    return position


@cache
def _places(
    steps: int, phi: float, sizes: tuple[float, ...], side: float
) -> tuple[NDArray, NDArray]:
    rng = np.random.default_rng(1)
    count = round(phi * side**3 / (np.pi / 6 * np.mean(np.power(sizes, 3))) / len(sizes))
    diameter = np.repeat(
        sorted(sizes, reverse=True), count
    )  # large ones first, while there is room
    return np.array([placed(rng, diameter, side) for _ in range(steps)]), diameter


def _no_contacts(steps: int) -> dict[str, Any]:
    return {
        "contact_i": [np.zeros(0, int)] * steps,
        "contact_j": [np.zeros(0, int)] * steps,
        "contact_force": [np.zeros((0, 3))] * steps,
        "contact_point": [np.zeros((0, 3))] * steps,
    }


def gas(
    steps: int = 16,
    *,
    phi: float = 0.2,
    sizes: tuple[float, ...] = (1.0,),
    rate: float = 0.0,
    side: float = SIDE,
) -> xr.Dataset:
    """Elastic spheres in equilibrium, m <v_k^2> = pi / 6 for each, placed anew in each step.

    With a `rate`, they are sheared, V_x = rate z, in a box whose images move with the flow.
    """
    position, diameter = _places(steps, phi, sizes, side)
    rng = np.random.default_rng(2)
    velocity = rng.normal(size=position.shape) / diameter[:, None] ** 1.5
    velocity[..., 0] += rate * position[..., 2]
    options: dict[str, Any] = {}
    if rate:
        options = {"lattice": {"xz": np.arange(steps) % side}, "shear_rate": {"xz": rate}}
    return xcg.scene_from_arrays(
        position,
        velocity=velocity,
        diameter=np.tile(diameter, (steps, 1)),
        species=np.tile(1 + (diameter > diameter.min()), (steps, 1)),
        density=1.0,
        time=np.arange(steps),
        box=dict.fromkeys("xyz", (0.0, side)),
        periodic="xyz",
        units="reduced",
        **_no_contacts(steps),
        **options,
    )


DRIFTS = {"1": -0.5, "2": 0.2}  # of small and large grains along z


def segregating(steps: int = 16) -> xr.Dataset:
    """Mixture of two sizes with m <v_k^2> = pi / 6 for each, small grains falling and large ones rising."""
    ds = gas(steps, sizes=(1.0, 1.5))
    drift = np.where(ds["species"] == 1, DRIFTS["1"], DRIFTS["2"])
    up = xr.DataArray([0.0, 0.0, 1.0], dims="component")
    return ds.assign(velocity=ds["velocity"] + xr.DataArray(drift, dims=("time", "particle")) * up)


def of_segregating(steps: int = 16) -> dict[str, dict[str, float]]:
    """Return density, flux of mass relative to the bulk, and temperature of each species, from its grains."""
    first = segregating(steps).isel(time=0)
    density = {
        phase: float(first["mass"].where(first["species"] == int(phase)).sum()) / SIDE**3
        for phase in DRIFTS
    }
    bulk = sum(density[phase] * DRIFTS[phase] for phase in DRIFTS) / sum(density.values())
    diameter = {"1": 1.0, "2": 1.5}
    return {
        phase: {
            "density": density[phase],
            "flux": density[phase] * (drift - bulk),
            "temperature": 1 / diameter[phase] ** 3 + (drift - bulk) ** 2 / 3,
        }
        for phase, drift in DRIFTS.items()
    }


FRICTION = 0.5
SLOPE = 0.25  # tangential over normal forces of the columns that do not slide


def inclined(steps: int = 16) -> xr.Dataset:
    """Columns of touching grains under gravity on a slope along x; two thirds of them slide, along y and along -y."""
    ds = flows.column(steps).scene
    slope = np.array([[-SLOPE, 0.0, 1.0], [0.0, FRICTION, 1.0], [0.0, -FRICTION, 1.0]])
    upper = ds["contact_i"] // 24  # of 24 grains a column
    direction = xr.DataArray(slope[upper % 3], dims=("time", "contact", "component"))
    return ds.assign(contact_force=ds["contact_force"].sel(component="z", drop=True) * direction)


def moving(gradient: NDArray, steps: int = 4) -> xr.Dataset:
    """Grains that follow a linear flow about the middle of the box exactly."""
    position, diameter = _places(steps, 0.2, (1.0,), SIDE)
    velocity = (position - SIDE / 2) @ np.transpose(gradient)
    return xcg.scene_from_arrays(
        position,
        velocity=velocity,
        diameter=np.tile(diameter, (steps, 1)),
        density=1.0,
        time=np.arange(steps),
        box=dict.fromkeys("xyz", (0.0, SIDE)),
        units="reduced",
    )


def couette(steps: int = 16) -> xr.Dataset:
    """Flow with a gradient, V_x = sin(2 pi z / L), of grains with a temperature of 0.25."""
    return flows.sine(steps).scene


@cache
def _packings(
    count: int, phi: float, steps: int, dimension: int
) -> tuple[NDArray, float, list[tuple[NDArray, NDArray, NDArray, NDArray]]]:
    """Return diameters, the side of the periodic box, and places and contacts of each packing."""
    rng = np.random.default_rng(5)
    diameter = np.where(np.arange(count) % 2, 1.0, 1.2)
    shares = {2: np.pi / 4, 3: np.pi / 6}
    side = (shares[dimension] * (diameter**dimension).sum() / phi) ** (1 / dimension)
    places = rng.uniform(0, side, (steps, count, dimension))
    return diameter, side, [_relax(place, diameter, side) for place in places]


def packing(count: int = 300, phi: float = 0.7, steps: int = 8, dimension: int = 3) -> xr.Dataset:
    """Isotropic packings at rest: soft spheres (discs) of two sizes, relaxed from random places."""
    diameter, side, relaxed = _packings(count, phi, steps, dimension)
    rows: dict[str, list[NDArray]] = {}
    for position, pairs, branch, force in relaxed:
        across = ((0, 0), (0, 3 - dimension))
        vectors = {"position": position, "contact_force": force, "contact_branch": branch}
        for name, values in vectors.items():
            rows.setdefault(name, []).append(np.pad(values, across))
        rows.setdefault("velocity", []).append(np.zeros((count, 3)))
        rows.setdefault("diameter", []).append(diameter)
        for name, values in zip(("contact_i", "contact_j"), pairs.T, strict=True):
            rows.setdefault(name, []).append(values)
    options: dict[str, Any] = {"dimension": 2, "thickness": 1.0} if dimension == 2 else {}
    return xcg.scene_from_arrays(
        **rows,
        density=1.0,
        time=np.arange(steps),
        box=dict.fromkeys("xyz"[:dimension], (0.0, side)),
        periodic="xyz"[:dimension],
        units="reduced",
        **options,
    )


def of_packing(
    count: int = 300, phi: float = 0.7, steps: int = 8, dimension: int = 3
) -> dict[str, float]:
    """Return the mean pressure and coordination number of a packing, straight from its contacts."""
    _, side, relaxed = _packings(count, phi, steps, dimension)
    virial = sum((branch * force).sum() for _, _, branch, force in relaxed)
    number = sum(len(pairs) for _, pairs, _, _ in relaxed)
    return {
        "volume_fraction": phi,
        "pressure": float(virial / dimension / side**dimension / steps),
        "coordination_number": 2 * number / count / steps,
    }


def _contacts(
    position: NDArray, diameter: NDArray, side: float
) -> tuple[NDArray, NDArray, NDArray]:
    """Return pairs, branches and forces of spheres that push each other by their overlap."""
    pairs = cKDTree(position % side, boxsize=side).query_pairs(
        diameter.max(), output_type="ndarray"
    )
    branch = position[pairs[:, 0]] - position[pairs[:, 1]]
    branch -= side * np.round(branch / side)
    distance = np.linalg.norm(branch, axis=1)
    overlap = diameter[pairs].mean(axis=1) - distance
    touching = overlap > 0
    force = (overlap / distance)[touching, None] * branch[touching]
    return pairs[touching], branch[touching], force


def _sums(pairs: NDArray, force: NDArray, count: int) -> NDArray:
    """Return the sum of a component of the contact forces on each sphere."""
    on_first, on_second = (np.bincount(row, force, count) for row in pairs.T)
    return on_first - on_second


def _relax(
    position: NDArray, diameter: NDArray, side: float
) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Return a packing in balance: FIRE (Bitzek et al. 2006), until forces are 1 % of the mean contact force."""
    velocity = np.zeros_like(position)
    step, mixing, downhill = 0.1, 0.1, 0
    for _ in range(3000):
        pairs, branch, force = _contacts(position, diameter, side)
        total = np.stack([_sums(pairs, along, len(position)) for along in force.T], axis=-1)
        size = np.linalg.norm(total)
        if size < 1e-2 * np.linalg.norm(force, axis=1).mean() * len(position) ** 0.5:
            break
        downhill += 1
        if (total * velocity).sum() < 0:
            velocity[:] = 0.0
            step = 0.5 * step
            mixing = 0.1
            downhill = 0
        elif downhill > 5:
            step = min(1.1 * step, 0.5)
            mixing = 0.99 * mixing
        velocity += step * total
        velocity += mixing * (np.linalg.norm(velocity) / size * total - velocity)
        position = (position + step * velocity) % side
    return position, pairs, branch, force


# --- contacts and rods of known tensors ----------------------------------------------------------

ALPHA = 0.3 / np.sqrt(3)  # a_c = 0.3
BETA = 0.2 / np.sqrt(3)  # of normal forces
_TENSOR = np.diag([1.0, 0.0, -1.0])
TURN = np.radians(30.0)  # of the axes of the normal forces from those of the contacts
RATE = 0.1  # of shear of contacts with turned axes, V_x = RATE z


def _sphere() -> tuple[NDArray, NDArray]:
    """Return directions (n, 3) and weights that integrate polynomials over the unit sphere."""
    z, weight = np.polynomial.legendre.leggauss(12)
    angle = np.arange(24) * np.pi / 12
    across = np.sqrt(1 - z**2)[:, None]
    n = np.stack(
        [across * np.cos(angle), across * np.sin(angle), np.broadcast_to(z[:, None], (12, 24))], -1
    )
    return n.reshape(-1, 3), np.repeat(weight / 48, 24)


def _of_forces(turn: float) -> NDArray:
    """Return the tensor of the normal forces, turned about y."""
    c = np.cos(turn)
    s = np.sin(turn)
    axes = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
    return axes @ _TENSOR @ axes.T


def known_contacts(turn: float = 0.0) -> dict[str, float]:
    """Return anisotropies, mu and angles of contacts with the density 1 + a : n n and normal forces 1 + b : n n.

    The axes of b are those of a, turned about y. In the shear V_x = z, compression is fastest along
    x - z.
    """
    n, weight = _sphere()
    density = weight * (1 + ALPHA * np.einsum("ni,ij,nj->n", n, _TENSOR, n))
    force = density * (1 + BETA * np.einsum("ni,ij,nj->n", n, _of_forces(turn), n))
    phi = np.einsum("n,ni,nj->ij", density, n, n)
    of_force = np.einsum("n,ni,nj->ij", force, n, n) / force.sum()

    def size(tensor: NDArray) -> float:
        return float(7.5 * np.sqrt(1.5 * (tensor**2).sum()))

    dev = of_force - np.eye(3) / 3
    stress_axis = np.linalg.eigh(of_force)[1][:, -1]
    fabric_axis = np.linalg.eigh(phi)[1][:, -1]
    rate_axis = np.array([1.0, 0.0, -1.0]) / np.sqrt(2)
    return {
        "contact_anisotropy": size(phi - np.eye(3) / 3),
        "normal_force_anisotropy": size(of_force - phi),
        "friction_coefficient": float(3 * np.sqrt((dev**2).sum() / 2)),
        "stress_fabric_angle": float(np.arccos(abs(stress_axis @ fabric_axis).clip(0, 1))),
        "stress_strain_rate_angle": float(np.arccos(abs(stress_axis @ rate_axis))),
    }


def contacts(
    steps: int = 16, count: int = 1500, side: float = SIDE, *, turn: float = 0.0, rate: float = 0.0
) -> xr.Dataset:
    """Pairs of touching spheres anywhere, with directions and forces of known distributions.

    With a `rate` they are sheared, V_x = rate z, in a box whose images move with the flow.
    """
    rng = np.random.default_rng(3)
    n = rng.normal(size=(steps, 4 * count, 3))
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    along = np.einsum("tci,ij,tcj->tc", n, _TENSOR, n)
    taken = rng.uniform(0, 1 + ALPHA, along.shape) < 1 + ALPHA * along
    rows = [np.flatnonzero(step)[:count] for step in taken]
    n = np.array([step[row] for step, row in zip(n, rows, strict=True)])
    along = np.einsum("tci,ij,tcj->tc", n, _of_forces(turn), n)
    force = rng.exponential(size=along.shape) * (1 + BETA * along)
    place = rng.uniform(0, side, n.shape)
    position = np.concatenate([place + n / 2, place - n / 2], axis=1)
    pairs = np.tile(np.arange(count), (steps, 1))
    velocity = np.zeros_like(position)
    velocity[..., 0] = rate * position[..., 2]
    options: dict[str, Any] = {}
    if rate:
        options = {"lattice": {"xz": np.arange(steps) % side}, "shear_rate": {"xz": rate}}
    return xcg.scene_from_arrays(
        position,
        velocity=velocity,
        diameter=np.ones(position.shape[:2]),
        density=0.1,
        time=np.arange(steps),
        contact_i=pairs,
        contact_j=pairs + count,
        contact_force=force[..., None] * n,
        contact_branch=n,
        box=dict.fromkeys("xyz", (0.0, side)),
        periodic="xyz",
        units="reduced",
        **options,
    )


def rods(
    order: float, steps: int = 16, phi: float = 0.4, side: float = SIDE, seed: int = 4
) -> xr.Dataset:
    """Grains whose director is along z for a share `order` of them, and anywhere for the others."""
    rng = np.random.default_rng(seed)
    count = round(phi * side**3 * 6 / np.pi)
    n = rng.normal(size=(steps, count, 3))
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    n[rng.uniform(size=(steps, count)) < order] = (0, 0, 1)
    return xcg.scene_from_arrays(
        rng.uniform(0, side, (steps, count, 3)),
        velocity=np.zeros((steps, count, 3)),
        director=n,
        diameter=np.ones((steps, count)),
        density=1.0,
        time=np.arange(steps),
        box=dict.fromkeys("xyz", (0.0, side)),
        periodic="xyz",
        units="reduced",
    )


# --- systems -------------------------------------------------------------------------------------

MU, SMALL = 0.3, 0.1  # usual friction coefficient; anisotropy, order, inertial number
MASS = np.pi / 6
_UP = 2 * np.pi / flows.LENGTH


def systems(names: Sequence[str] = ()) -> list[System]:
    """Return the systems, or those with some names."""
    makers: dict[str, Callable[[], System]] = {
        "elastic gas": _gas,
        "mixture in equilibrium": _mixture,
        "segregating mixture": _segregating,
        "uniform shear": _shear,
        "compression": _compression,
        "rigid rotation": _rotation,
        "static column": _column,
        "inclined column": _inclined,
        "isotropic packing": _packing,
        "Couette flow": _couette,
        "contacts": _known,
        "turned contacts": _turned,
        "rods": _rods,
    }
    return [make() for name, make in makers.items() if not names or name in names]


def _gas() -> System:
    number = float(gas(1).sizes["particle"]) / SIDE**3
    truths = [
        Truth("volume_fraction", number * MASS),
        Truth("velocity", 0.0, "x", scale=1.0),
        Truth("kinetic_stress", number * MASS, "trace"),
        Truth("pressure", number * MASS),
        Truth("granular_temperature", 1.0),
        Truth("friction_coefficient", 0.0, scale=MU),
        Truth("inertial_number", 0.0, scale=SMALL),
    ]
    return System("elastic gas", gas, truths)


def _mixture() -> System:
    truths = [
        Truth("granular_temperature", 2 / 9),
        Truth("granular_temperature", 1.0, phase="1"),
        Truth("granular_temperature", 1 / 8, phase="2"),
        Truth("mixture_temperature", MASS),
        Truth("mixture_temperature", MASS, phase="1"),
        Truth("mixture_temperature", MASS, phase="2"),
    ]
    return System(
        "mixture in equilibrium", lambda: gas(sizes=(1.0, 2.0)), truths, options={"by": "species"}
    )


def _segregating() -> System:
    truths = []
    for phase, values in of_segregating().items():
        truths += [
            Truth("velocity", DRIFTS[phase], "z", phase=phase),
            Truth("segregation_flux", values["flux"], "z", phase=phase),
            Truth("granular_temperature", values["temperature"], phase=phase),
        ]
    return System("segregating mixture", segregating, truths, options={"by": "species"})


def _shear() -> System:
    number = float(gas(1).sizes["particle"]) / SIDE**3
    rate = 0.5
    truths = [
        Truth("velocity_gradient", rate, "xz"),
        Truth("shear_rate", rate),
        Truth("granular_temperature", 1.0),
        Truth("kinetic_stress", number * MASS, "trace"),
        Truth("kinetic_stress", number * MASS, "xx"),
        Truth("friction_coefficient", 0.0, scale=MU),
        Truth("inertial_number", rate / np.sqrt(number * MASS)),
    ]
    return System("uniform shear", lambda: gas(rate=rate), truths)


_INNER = dict.fromkeys("xyz", (3.0, 9.0))


def _compression() -> System:
    truths = [
        Truth("velocity_gradient", -0.1, "xx"),
        Truth("shear_rate", 0.0, scale=0.1),
        Truth("vorticity", 0.0, "y", scale=0.1),
        Truth("granular_temperature", 0.0, scale=0.01),
    ]
    make = lambda: moving(-0.1 * np.eye(3))  # noqa: E731
    return System("compression", make, truths, ("volume", "plane"), bounds=_INNER)


def _rotation() -> System:
    turn = 0.1 * np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    truths = [
        Truth("vorticity", 0.2, "y"),
        Truth("shear_rate", 0.0, scale=0.1),
        Truth("granular_temperature", 0.0, scale=0.01),
        Truth("fluctuating_kinetic_energy", 0.0, scale=0.01),
    ]
    make = lambda: moving(turn)  # noqa: E731
    return System("rigid rotation", make, truths, ("volume", "plane"), bounds=_INNER)


def _column() -> System:
    weight = 30 / 36

    def along(f: xr.Dataset) -> Any:
        return weight * (24.0 - f["z"])

    truths = [
        Truth("contact_stress", along, "zz"),
        Truth("pressure", lambda f: along(f) / 3),
        Truth("volume_fraction", weight * MASS),
    ]
    bounds = {"z": (7.0, 17.0)}
    meshes = ("volume", "plane", "profile")
    return System("static column", lambda: flows.column(16).scene, truths, meshes, bounds=bounds)


def _inclined() -> System:
    weight = 30 / 36
    shear = -SLOPE / 3

    def along(f: xr.Dataset) -> Any:
        return weight * (24.0 - f["z"])

    stress = np.array([[0.0, 0.0, shear], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    deviator = stress - np.eye(3) / 3
    truths = [
        Truth("contact_stress", lambda f: shear * along(f), "xz"),
        Truth("first_normal_stress_difference", along),
        Truth("second_normal_stress_difference", lambda f: -along(f)),
        Truth("friction_coefficient", float(3 * np.sqrt((deviator**2).sum() / 2))),
        Truth("sliding_share", 2 / 3),
        Truth("friction_mobilisation", (2 + SLOPE / FRICTION) / 3),
    ]
    bounds = {"z": (7.0, 17.0)}
    meshes = ("volume", "plane", "profile")
    options = {"friction": FRICTION}
    return System("inclined column", inclined, truths, meshes, options, bounds)


def _packing() -> System:
    truths = [
        *(Truth(name, value) for name, value in of_packing(steps=16).items()),
        Truth("friction_coefficient", 0.0, scale=MU),
        Truth("contact_anisotropy", 0.0, scale=SMALL),
        Truth("normal_force_anisotropy", 0.0, scale=SMALL),
    ]
    return System("isotropic packing", lambda: packing(steps=16), truths)


def _couette() -> System:
    truths = [
        Truth("velocity", lambda f: np.sin(_UP * f["z"]), "x"),
        Truth("velocity_gradient", lambda f: _UP * np.cos(_UP * f["z"]), "xz"),
        Truth("shear_rate", lambda f: _UP * np.abs(np.cos(_UP * f["z"]))),
        Truth("granular_temperature", 0.25),
    ]
    return System("Couette flow", couette, truths, ("volume", "plane", "profile"))


def _known() -> System:
    truths = [Truth(n, v) for n, v in known_contacts().items() if not n.endswith("_angle")]
    return System("contacts", contacts, truths)


def _turned() -> System:
    known = known_contacts(TURN)
    names = ("friction_coefficient", "stress_fabric_angle", "stress_strain_rate_angle")
    make = lambda: contacts(turn=TURN, rate=RATE)  # noqa: E731
    return System("turned contacts", make, [Truth(name, known[name]) for name in names])


def _rods() -> System:
    return System("rods", lambda: rods(0.5), [Truth("nematic_order", 0.5)])
