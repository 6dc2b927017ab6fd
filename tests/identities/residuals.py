"""How far a scene is from the identities that hold on any scene, in numbers.

Every function evaluates fields with `xcg.coarse_grain` (Lucy's kernel, closed forms) and compares them with what
must come out. Where that takes a sum over grains, it is written out here in NumPy (`smear`, `forces_on`), with
nothing from the package. Used by the tests of identities and by ``docs/residuals.py``.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

import xcg
from xcg.fields.formulas import registry

# Sixth order, in steps of STEP cutoffs. Smooth parts are then exact to rounding, of order 1e-15 / STEP = 5e-12. Lucy's
# kernel has two continuous derivatives: a grain whose rim lies between the nodes of the stencil leaves up to
# 0.027 J STEP^2 (J = 24 the jump of the third derivative, in units of its peak and c), that is, 3e-8 of its own
# peak. Such grains are rare, a few in a thousand of those that reach the node. Branches are smoother: STEP^2.5.
STENCIL = np.array([-1, 9, -45, 0, 45, -9, 1]) / 60
STEP = 2e-4


@dataclass(frozen=True)
class Residual:
    """Difference of both sides of an identity, and the size of its terms."""

    difference: NDArray
    scale: float

    @property
    def relative(self) -> float:
        """Largest difference, in units of the scale."""
        return float(np.max(np.abs(self.difference)) / self.scale)

    def __or__(self, other: Residual) -> Residual:
        """Return the larger of two."""
        return max(self, other, key=lambda residual: residual.relative)


# --- fields at points, their derivatives and integrals ---------------------------------------------------


def frame_of(ds: xr.Dataset) -> dict[str, NDArray]:
    """Arrays of the only step, without padding; grains that are not frozen, in `free`."""
    frame = {str(name): ds[name].values[0] for name in ds.data_vars}
    grain = frame["particle_id"] >= 0
    contact = frame["contact_i"] >= 0
    for name in frame:
        dims = ds[name].dims
        frame[name] = (
            frame[name][grain if "particle" in dims else contact]
            if "box" not in name
            else frame[name]
        )
    frame["free"] = frame["frozen"] != 1 if "frozen" in frame else np.ones(grain.sum(), bool)
    return frame


def axes_of(ds: xr.Dataset) -> list[int]:
    """Indices of the axes that the scene has."""
    return ["xyz".index(a) for a in ds.attrs["plane"]]


def period_of(ds: xr.Dataset) -> NDArray:
    """Length of periodic axes, 0 along the others."""
    box = ds["box"].values[0] if "box" in ds else np.zeros((3, 2))
    return np.array(
        [np.ptp(box[k]) if a in ds.attrs["periodic"] else 0.0 for k, a in enumerate("xyz")]
    )


def depth_of(ds: xr.Dataset) -> float:
    """Thickness of a layer, 1 in 3D."""
    if ds.attrs["dimension"] == 3:
        return 1.0
    (across,) = set("xyz") - set(ds.attrs["plane"])
    box = ds["box"].values[0] if "box" in ds else np.full((3, 2), np.inf)
    length = np.ptp(box["xyz".index(across)])
    return float(ds.attrs.get("thickness", length if np.isfinite(length) else ds.attrs["dmax"]))


def at_point(
    ds: xr.Dataset, fields: list[str], point: NDArray, **options: Any
) -> dict[str, NDArray]:
    """Fields at one point."""
    at = {a: float(point["xyz".index(a)]) for a in ds.attrs["plane"]}
    f = xcg.coarse_grain(ds, fields, axes="", at=at, **options)
    return {name: f[name].values[0] for name in fields}


def at_points(
    ds: xr.Dataset, fields: list[str], points: NDArray, **options: Any
) -> dict[str, NDArray]:
    """Fields at points, points first."""
    rows = [at_point(ds, fields, point, **options) for point in points]
    return {name: np.array([row[name] for row in rows]) for name in fields}


def derivative(
    ds: xr.Dataset,
    fields: list[str],
    point: NDArray,
    axis: int,
    width: float,
    step: float = STEP,
    **options: Any,
) -> dict[str, NDArray]:
    """Derivative of fields along an axis at a point, by finite differences; with momentum_flux, see `with_flux`."""
    h = step * 2 * width
    a = "xyz"[axis]
    at = {b: float(point["xyz".index(b)]) for b in ds.attrs["plane"] if b != a}
    bounds = {a: (point[axis] - 3 * h, point[axis] + 3 * h)}
    f = xcg.coarse_grain(
        ds, fields, axes=a, at=at, bounds=bounds, spacing=h, width=width, **options
    )
    values = with_flux({name: f[name].values[0] for name in fields})
    return {name: np.tensordot(STENCIL, v, 1) / h for name, v in values.items()}


def divergence(
    ds: xr.Dataset, fields: list[str], points: NDArray, width: float, **options: Any
) -> dict[str, NDArray]:
    """Divergence of vector and tensor fields at points; of tensors over the last index, the direction."""
    total: dict[str, NDArray] = {}
    for k, axis in itertools.product(range(len(points)), axes_of(ds)):
        for name, slope in derivative(ds, fields, points[k], axis, width, **options).items():
            if slope.ndim:
                out = total.setdefault(name, np.zeros((len(points), *slope.shape[:-1])))
                out[k] += slope[..., axis]
    return total


def with_flux(f: dict[str, NDArray]) -> dict[str, NDArray]:
    """Add momentum_flux = sum m v v Psi = rho V V + sigma^k to fields that hold its parts."""
    if not {"density", "momentum_density", "kinetic_stress"} <= set(f):
        return f
    p = f["momentum_density"]
    rho = f["density"][..., None, None]
    advected = np.divide(
        p[..., :, None] * p[..., None, :],
        rho,
        out=np.zeros_like(f["kinetic_stress"]),
        where=rho > 0,
    )
    return f | {"momentum_flux": advected + f["kinetic_stress"]}


def support(ds: xr.Dataset, axis: int, cutoff: float) -> tuple[float, float]:
    """First and last coordinate that any grain or contact reaches."""
    frame = frame_of(ds)
    ends = np.concatenate([frame["position"][:, axis], frame["contact_point"][:, axis]])
    return float(ends.min() - cutoff), float(ends.max() + cutoff)


def integral(
    ds: xr.Dataset,
    fields: list[str],
    axis: int,
    width: float,
    at: dict[str, float],
    step: float,
    **options: Any,
) -> dict[str, NDArray]:
    """Integral of fields along one axis by the sum over nodes; axes neither here nor in `at` by marginals."""
    a = "xyz"[axis]
    averaged = {b: 1.0 for b in ds.attrs["plane"] if b not in at and b != a}
    bounds = None if a in ds.attrs["periodic"] else {a: support(ds, axis, 2 * width)}
    f = xcg.coarse_grain(
        ds,
        fields,
        axes=a,
        at=at,
        bounds=bounds,
        spacing=step * 2 * width,
        width=width,
        extent=averaged,
        **options,
    )
    spacing = float(f[a][1] - f[a][0])
    values = with_flux({name: f[name].values[0] for name in fields})
    return {name: v.sum(axis=0) * spacing for name, v in values.items()}


# --- sums over grains, written out -----------------------------------------------------------------------


def smear(
    ds: xr.Dataset, columns: NDArray, points: NDArray, width: float, *, slope: bool = False
) -> NDArray:
    """Sum of q_i Psi(r - r_i) over free grains, for columns (n, ...); with `slope`, of q_i grad Psi (last index)."""
    c = 2 * width
    axes = axes_of(ds)
    period = period_of(ds)
    norm = {2: 5 / (math.pi * c**2), 3: 105 / (16 * math.pi * c**3)}[len(axes)] / depth_of(ds)
    frame = frame_of(ds)
    position = frame["position"][frame["free"]][:, axes]
    period = period[axes]
    reach = [
        range(-n, n + 1)
        for n in np.where(
            period > 0, np.floor(c / np.where(period > 0, period, 1) + 0.5), 0
        ).astype(int)
    ]
    out = []
    for point in points:
        offset = point[axes] - position
        offset -= period * np.rint(offset / np.where(period > 0, period, 1))
        total = 0.0
        for image in itertools.product(*reach):
            x = offset + np.array(image) * period
            q = np.linalg.norm(x, axis=1) / c
            hit = q < 1
            if slope:  # (1 - q)^3 (1 + 3 q) has the derivative -12 q (1 - q)^2
                weight = np.zeros((hit.sum(), 3))
                weight[:, axes] = (-12 * norm / c**2) * ((1 - q[hit]) ** 2)[:, None] * x[hit]
                total = total + np.einsum("n...,nk->...k", columns[hit], weight)
            else:
                total = total + np.tensordot(
                    norm * (1 - q[hit]) ** 3 * (1 + 3 * q[hit]), columns[hit], 1
                )
        out.append(total)
    return np.array(out)


def forces_on(ds: xr.Dataset) -> NDArray:
    """Total contact force on each free grain (N)."""
    frame = frame_of(ds)
    ids = frame["particle_id"].tolist()
    row = {number: k for k, number in enumerate(ids)}
    total = np.zeros((len(ids), 3))
    for i, j, force in zip(
        frame["contact_i"].tolist(),
        frame["contact_j"].tolist(),
        frame["contact_force"],
        strict=True,
    ):
        if i in row:
            total[row[i]] += force
        if j in row:
            total[row[j]] -= force
    return total[frame["free"]]


def gravity_of(ds: xr.Dataset) -> NDArray:
    """Acceleration of gravity, zero where the scene has none."""
    return np.asarray(ds.attrs.get("gravity", np.zeros(3)), float)


# --- the identities --------------------------------------------------------------------------------------


def mass(ds: xr.Dataset, width: float) -> Residual:
    """1: the integral of rho over the whole support is the mass of the grains; along each axis by a sum over nodes.

    The error of the sum over nodes falls as the transform of the kernel, (h / c)^5: 1e-14 with 128 nodes in c.
    """
    frame = frame_of(ds)
    total = frame["mass"][frame["free"]].sum()
    found = [
        integral(ds, ["density"], axis, width, {}, 1 / 128)["density"] * depth_of(ds)
        for axis in axes_of(ds)
    ]
    return Residual(np.array(found) - total, float(total))


def continuity(ds: xr.Dataset, width: float, points: NDArray) -> Residual:
    """2: the exact rate of rho, -sum m_i v_i . grad Psi, is -div p; in units of the largest rho |v| / w."""
    frame = frame_of(ds)
    momentum = (frame["mass"][:, None] * frame["velocity"])[frame["free"]]
    rate = -np.einsum("nkk->n", smear(ds, momentum, points, width, slope=True))
    found = divergence(ds, ["momentum_density"], points, width)["momentum_density"]
    speed = np.linalg.norm(frame["velocity"][frame["free"]], axis=1).max()
    rho = at_points(ds, ["density"], points, width=width)["density"].max()
    return Residual(rate + found, float(rho * speed / width))


def stress_divergence(ds: xr.Dataset, width: float, points: NDArray, **options: Any) -> Residual:
    """3: div sigma^c = -sum F_i Psi + t; in units of the largest |sigma^c| / w."""
    fields = ["contact_stress", "boundary_force_density", "contact_force_density"]
    f = at_points(ds, fields, points, width=width, **options)
    found = divergence(ds, ["contact_stress"], points, width, **options)["contact_stress"]
    force = smear(ds, forces_on(ds), points, width)
    scale = float(np.abs(f["contact_stress"]).max() / width)
    own = Residual(found + f["contact_force_density"] - f["boundary_force_density"], scale)
    return own | Residual(found + force - f["boundary_force_density"], scale)


def static_equilibrium(
    ds: xr.Dataset, width: float, points: NDArray
) -> tuple[Residual, Residual, float]:
    """4: div sigma - rho g - t, and its difference from -sum (F_i + m_i g) Psi + div sigma^k, which must vanish.

    Both in units of the largest |sigma^c| / w. The third number is how static the data are: the largest resultant
    |F_i + m_i g| of a grain in units of the mean contact force.
    """
    frame = frame_of(ds)
    f = at_points(ds, ["contact_stress", "density", "boundary_force_density"], points, width=width)
    div = divergence(ds, ["contact_stress", "kinetic_stress"], points, width)
    weight = gravity_of(ds)
    left = (
        div["contact_stress"]
        + div["kinetic_stress"]
        - f["density"][:, None] * weight
        - f["boundary_force_density"]
    )
    resultant = forces_on(ds) + frame["mass"][frame["free"], None] * weight
    right = -smear(ds, resultant, points, width) + div["kinetic_stress"]
    scale = float(np.abs(f["contact_stress"]).max() / width)
    largest = (
        np.linalg.norm(resultant, axis=1).max()
        / np.linalg.norm(frame["contact_force"], axis=1).mean()
    )
    return Residual(left, scale), Residual(left - right, scale), float(largest)


def moved(ds: xr.Dataset, dt: float, acceleration: NDArray | float = 0.0) -> xr.Dataset:
    """Return the grains, without contacts, after dt of constant acceleration (n, 3)."""
    contacts = [name for name in ds.data_vars if "contact" in ds[name].dims]
    position = ds["position"].values
    velocity = ds["velocity"].values
    new = position + velocity * dt + acceleration * dt**2 / 2, velocity + acceleration * dt
    return ds.drop_vars(contacts).assign(
        {
            name: (ds[name].dims, values)
            for name, values in zip(("position", "velocity"), new, strict=True)
        }
    )


def accelerations(ds: xr.Dataset) -> NDArray:
    """Acceleration of every grain (n, 3) by its contact forces and gravity; frozen grains have none."""
    frame = frame_of(ds)
    acceleration = np.zeros_like(frame["position"])
    free = frame["free"]
    acceleration[free] = forces_on(ds) / frame["mass"][free, None] + gravity_of(ds)
    return acceleration


def time_scale(ds: xr.Dataset, width: float, acceleration: NDArray | float = 0.0) -> float:
    """Time in which no grain moves or is accelerated by more than w."""
    frame = frame_of(ds)
    fastest = np.linalg.norm(frame["velocity"][frame["free"]], axis=1).max()
    largest = np.linalg.norm(np.atleast_2d(acceleration), axis=1).max()
    with np.errstate(divide="ignore"):
        return float(min(np.divide(width, fastest), np.sqrt(np.divide(width, largest))))


def mass_between_frames(
    ds: xr.Dataset, width: float, points: NDArray, *steps: float
) -> list[Residual]:
    """2: (rho(t + dt) - rho(t - dt)) / 2 dt + div p for each dt, of order dt^2; in units of rho |v| / w."""
    div = divergence(ds, ["momentum_density"], points, width)["momentum_density"]
    middle = at_points(ds, ["density"], points, width=width)["density"].max()
    found = []
    for dt in steps:
        rho = [
            at_points(moved(ds, s * dt), ["density"], points, width=width)["density"]
            for s in (-1, 1)
        ]
        found.append(
            Residual((rho[1] - rho[0]) / (2 * dt) + div, float(middle / time_scale(ds, width)))
        )
    return found


def momentum_between_frames(
    ds: xr.Dataset, width: float, points: NDArray, *steps: float
) -> list[Residual]:
    """5: d(rho V)/dt + div(rho V V + sigma) - rho g - t for each dt, of order dt^2; in units of |rho V V + sigma| / w.

    Frames at t -+ dt follow from the contact forces and gravity at t; grains that are frozen do not move.
    """
    acceleration = accelerations(ds)
    weight = gravity_of(ds)
    fields = ["density", "momentum_density", "kinetic_stress", "contact_stress"]
    div = divergence(ds, fields, points, width)
    f = with_flux(at_points(ds, [*fields, "boundary_force_density"], points, width=width))
    flux = np.abs(f["momentum_flux"] + f["contact_stress"]).max()
    still = (
        div["momentum_flux"]
        + div["contact_stress"]
        - f["density"][:, None] * weight
        - f["boundary_force_density"]
    )
    found = []
    for dt in steps:
        p = [
            at_points(moved(ds, s * dt, acceleration), ["momentum_density"], points, width=width)[
                "momentum_density"
            ]
            for s in (-1, 1)
        ]
        found.append(Residual((p[1] - p[0]) / (2 * dt) + still, float(flux / width)))
    return found


def shifted(ds: xr.Dataset, vector: NDArray) -> xr.Dataset:
    """Return the scene moved by a vector: grains and contact points wrapped into the box along periodic axes."""
    period = period_of(ds)
    lower = ds["box"].values[0, :, 0] if "box" in ds else np.zeros(3)
    vector = np.where([a in ds.attrs["plane"] for a in "xyz"], vector, 0.0)
    new = {}
    for name in ("position", "contact_point"):
        values = ds[name].values + vector
        for k in np.flatnonzero(period > 0):
            values[..., k] = lower[k] + np.mod(values[..., k] - lower[k], period[k])
        new[name] = (ds[name].dims, values)
    return ds.assign(new)


def periodicity(ds: xr.Dataset, width: float, points: NDArray, seed: int = 0) -> Residual:
    """7: moving everything by any vector, with wrapping, moves the fields; all fields that the scene allows."""
    lengths = np.where(period_of(ds) > 0, period_of(ds), 10 * width)
    vector = np.random.default_rng(seed).uniform(-1, 1, 3) * lengths
    vector = np.where([a in ds.attrs["plane"] for a in "xyz"], vector, 0.0)
    skipped = ("friction_coefficient", "inertial_number")
    directed = (
        "orientation_tensor",
        "nematic_tensor",
        "nematic_order",
        "nematic_director",
    )  # see test_orientation
    skipped += (
        *directed,
        *(name for name in registry.listed() if name.endswith("_error")),
    )  # roots of differences
    fields = [
        name for name in registry.listed() if name not in skipped and not xcg.FIELDS[name].option
    ]
    here = at_points(ds, fields, points, width=width)
    there = at_points(shifted(ds, vector), fields, points + vector, width=width)
    return difference(ds, width, here, there)


def scales_of(ds: xr.Dataset, width: float, f: dict[str, NDArray]) -> dict[str, float]:
    """Size of the terms that each field sums, where they may cancel; by name."""
    frame = frame_of(ds)
    speed = float(np.linalg.norm(frame["velocity"][frame["free"]], axis=1).max(initial=0.0))
    scales = {name: float(np.nanmax(np.abs(values), initial=0.0)) for name, values in f.items()}
    rho = scales["density"]
    stress = scales["contact_stress"]
    scales |= {"momentum_density": rho * speed, "velocity": speed, "fluctuation_density": rho}
    scales |= dict.fromkeys(["granular_temperature", "directional_temperature"], speed**2)
    scales |= dict.fromkeys(["velocity_gradient", "shear_rate_tensor", "shear_rate"], speed / width)
    scales |= dict.fromkeys(
        ["kinetic_stress", "fluctuation_stress", "momentum_flux"], rho * speed**2
    )
    # tensors whose traces are 1; where forces of both signs leave a mean of 1/k of their size to divide by, values are
    # k times as large, and their rounding k^2 times
    ratios = [name for name in scales if name.endswith(("_anisotropy", "_force_fabric"))]
    scales |= dict.fromkeys(ratios, max([1.0, *(scales[name] for name in ratios)]) ** 2)
    scales |= dict.fromkeys(["strong_contact_stress", "weak_contact_stress"], stress)
    scales |= dict.fromkeys(["boundary_force_density", "contact_force_density"], stress / width)
    # torques and powers of forces that cancel
    spin = np.linalg.norm(frame.get("angular_velocity", np.zeros(3)), axis=-1).max()
    radius = ds.attrs["dmax"] / 2
    surface = speed + float(spin) * radius
    scales |= {"vorticity": speed / width, "couple_stress": stress * radius}
    scales |= dict.fromkeys(["torque_density", "contact_couple_density"], stress)
    scales |= dict.fromkeys(
        ["contact_power", "dissipation_rate", "wall_power"], stress * surface / width
    )
    scales |= {"stress_power": (stress + rho * speed**2) * speed / width}
    scales |= dict.fromkeys(["contact_energy_flux", "contact_heat_flux"], stress * surface)
    scales |= dict.fromkeys(["kinetic_energy_flux", "kinetic_heat_flux"], rho * surface**3)
    scales |= {"heat_flux": stress * surface + rho * surface**3}
    scales |= dict.fromkeys(["mean_kinetic_energy", "fluctuating_kinetic_energy"], rho * speed**2)
    return scales | dict.fromkeys(
        ["stress", "pressure", "deviatoric_stress", "shear_stress"], stress + rho * speed**2
    )


def difference(
    ds: xr.Dataset, width: float, a: dict[str, NDArray], b: dict[str, NDArray]
) -> Residual:
    """Return the worst difference of fields, each in units of its size; NaN must stand in the same places.

    Fits through fewer than FEW grains, which amplify rounding by their condition, are compared only for NaN.
    """
    scales = scales_of(ds, width, a)
    worst = Residual(np.zeros(1), 1.0)
    for name in a:
        known = np.isfinite(a[name])
        assert (known == np.isfinite(b[name])).all(), f"{name}: NaN in different places"
        if name in FITS and "sample_count" in a:
            known &= (a["sample_count"] >= FEW).reshape(-1, *(1,) * (known.ndim - 1))
        if known.any() and scales[name] > 0:
            worst |= Residual((a[name] - b[name])[known], scales[name])
    return worst


FEW = 10
FITS = ("velocity_gradient", "shear_rate_tensor", "shear_rate", "fluctuation_stress", "fluctuation_density",
        "granular_temperature", "directional_temperature", "vorticity", "stress_power")  # fmt: skip
ADDITIVE = ["density", "volume_fraction", "momentum_density", "kinetic_stress", "contact_stress",
            "boundary_force_density", "contact_force_density"]  # fmt: skip


def marginals(ds: xr.Dataset, width: float, point: NDArray) -> Residual:
    """8: a field from the kernel's marginal is the field integrated along the axis that it leaves out.

    3D to 2D along every axis, 2D to 1D along every axis, through a point: chained, these are the profile. Sums over
    grains and contacts only, with sum m v v Psi in place of the kinetic stress. In units of the largest value, or of
    the peak of the largest term where the point is at the rim of all of them.
    """
    worst = Residual(np.zeros(1), 1.0)
    plane = ds.attrs["plane"]
    frame = frame_of(ds)
    m = frame["mass"]
    v = np.linalg.norm(frame["velocity"], axis=1)
    force = np.linalg.norm(frame["contact_force"], axis=1).max(initial=0.0)
    terms = {
        "density": m, "volume_fraction": frame["volume"], "momentum_density": m * v, "momentum_flux": m * v**2,
        "contact_stress": force * width, "boundary_force_density": force, "contact_force_density": force,
    }  # fmt: skip
    kernel = xcg.Lucy(width, dimension=len(plane))
    for a in plane:
        others = [b for b in plane if b != a]
        for kept in itertools.chain([others], ([b] for b in others if len(others) > 1)):
            at = {b: float(point["xyz".index(b)]) for b in kept}
            averaged = {b: 1.0 for b in plane if b not in kept}
            # a line through 3D (or 2D) kernels meets their kinks, and the sum converges as h^4; marginals are smoother
            step = 1 / (512 if kept == others else 256)
            numeric = integral(ds, ADDITIVE, "xyz".index(a), width, at, step)
            f = xcg.coarse_grain(ds, ADDITIVE, axes="", at=at, width=width, extent=averaged)
            exact = with_flux({name: f[name].values[0] for name in ADDITIVE})
            peak = float(kernel.value(0.0, seen=len(kept))) / depth_of(ds)
            for name, term in terms.items():
                scale = max(peak * float(np.max(term)), float(np.abs(exact[name]).max()))
                if scale > 0:
                    worst |= Residual(numeric[name] - exact[name], scale)
    return worst


def virial(ds: xr.Dataset, width: float) -> Residual:
    """9: the integral of sigma^c over its whole support is sum f a over both sides; in units of sum |f| |a|."""
    frame = frame_of(ds)
    period = period_of(ds)
    ids = frame["particle_id"][frame["free"]].tolist()
    row = {number: k for k, number in enumerate(ids)}
    position = frame["position"][frame["free"]]
    total = np.zeros((3, 3))
    size = 0.0
    rows = (frame[f"contact_{name}"] for name in ("i", "j", "force", "point"))
    for i, j, force, point in zip(*rows, strict=True):
        for number, on_it in ((int(i), force), (int(j), -force)):
            if number in row:
                arm = position[row[number]] - point
                arm -= period * np.rint(arm / np.where(period > 0, period, 1))
                total += np.outer(on_it, arm)
                size += np.linalg.norm(on_it) * np.linalg.norm(arm)
    found = [
        integral(ds, ["contact_stress"], axis, width, {}, 1 / 128)["contact_stress"] * depth_of(ds)
        - total
        for axis in axes_of(ds)
    ]
    return Residual(np.array(found), float(size))


def phase_divergence(
    ds: xr.Dataset, width: float, points: NDArray, by: str, groups: list[int]
) -> Residual:
    """3, of each phase: div sigma^c_a = -sum F_i Psi over its grains + what walls and the other phases do to it.

    In units of the largest |sigma^c| / w. Forces of phases on each other are opposite, and none acts on itself.
    """
    fields = ["contact_stress", "interphase_force", "boundary_force_density"]
    options = {"by": by, "groups": groups}
    f = at_points(ds, fields, points, width=width, **options)
    found = divergence(ds, ["contact_stress"], points, width, **options)["contact_stress"]
    scale = float(np.abs(f["contact_stress"]).max() / width)
    frame = frame_of(ds)
    force = forces_on(ds)
    phase = frame[by][frame["free"]]
    own = [force, *(np.where(phase[:, None] == group, force, 0.0) for group in groups)]
    resultant = np.stack([smear(ds, column, points, width) for column in own], axis=1)
    between = f["interphase_force"]
    balance = Residual(found + resultant - between.sum(axis=2), scale)
    opposite = between[:, 1:, :-1] + between[:, 1:, :-1].swapaxes(1, 2)
    size = float(np.abs(between).max()) or 1.0
    walls = between[:, :, -1] - f["boundary_force_density"]
    return balance | Residual(opposite, 1e-2 * size) | Residual(walls, 1e-2 * size)
