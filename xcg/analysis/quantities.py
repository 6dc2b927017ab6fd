"""Quantities of packings: one row each, with its unit, formula, what it needs, and how it is computed from a sample."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.analysis.mixing import ratio
from xcg.analysis.network import CONTACTS
from xcg.analysis.samples import Sample


@dataclass(frozen=True)
class PackingQuantity:
    """Quantity of the microstructure.

    Attributes
    ----------
    long_name, formula : str
        For the attributes and the documentation.
    compute : callable
        ``compute(s)`` for a sample.
    units : str
        SI unit.
    dims : tuple of str
        Dimensions besides time, region and phase.
    needs : tuple of str
        Variables of the scene.
    of_phases : bool
        Whether it takes phases, and is measured only where it is asked for.
    """

    long_name: str
    formula: str
    compute: Callable[[Sample], Any]
    units: str = "1"
    dims: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    of_phases: bool = False


FORCES = (*CONTACTS, "contact_force")
TENSOR = ("component", "direction")


def _mechanical(s: Sample) -> float:
    load_bearing = s.partners[s.partners >= s.min_contacts]
    return ratio(load_bearing.sum(), len(load_bearing))


def _connectivity(s: Sample) -> NDArray:
    last = s.max_connectivity
    return ratio(np.bincount(np.minimum(s.partners, last).astype(int), minlength=last + 1), s.count)


def _mean_force(force: str, s: Sample) -> float:
    return float(ratio((s.pushing * getattr(s, force)).sum(), s.pushing.sum()))


def _force_pdf(force: str, s: Sample) -> NDArray:
    contacts = s.pushing.sum() * (_mean_force(force, s) > 0)
    return ratio(_force_count(force, s), contacts) / np.diff(s.force_bins)


def _force_count(force: str, s: Sample) -> NDArray:
    ratios = ratio(getattr(s, force), _mean_force(force, s))
    return np.histogram(ratios, s.force_bins, weights=s.pushing)[0]


def _fabric(s: Sample) -> NDArray:
    weights = s.weight * (s.normal**2).sum(axis=1)
    return ratio(np.einsum("n,ni,nj->ij", s.weight, s.normal, s.normal), weights.sum())


def _percolation(s: Sample) -> NDArray:
    reaches = np.full(3, np.nan)
    reaches[s.plane] = s.clusters.spans[s.plane]
    return reaches


def _plane(tensor: NDArray, s: Sample) -> NDArray:
    """Symmetric part of a tensor, in the axes of the scene."""
    return ((tensor + tensor.T) / 2)[np.ix_(s.plane, s.plane)]


def _deviator(tensor: NDArray) -> NDArray:
    return tensor - np.trace(tensor) / len(tensor) * np.eye(len(tensor))


def _norm(tensor: NDArray) -> float:
    return float(np.sqrt((tensor * tensor).sum()))


def _anisotropy(s: Sample) -> float:
    fabric = _norm(_deviator(_plane(_fabric(s), s)))
    # the norms of a = 15/2 F' and a = 4 F' that are a_1 - a_3 for an axisymmetric fabric and a_1 in
    # a plane
    if len(s.plane) == 3:
        return np.sqrt(3 / 2) * 7.5 * fabric
    return np.sqrt(0.5) * 4 * fabric


def _stress(s: Sample) -> NDArray:
    return ratio(s.virial, s.region_volume)


def _mean_stress(s: Sample) -> float:
    return float(np.trace(_plane(_stress(s), s)) / len(s.plane))


def _deviator_stress(s: Sample) -> float:
    factor = {3: 3 / 2, 2: 2}[len(s.plane)]
    return np.sqrt(factor) * _norm(_deviator(_plane(_stress(s), s)))


def _velocity_rate(s: Sample) -> float:
    """Deviatoric strain rate of the affine flow that fits the velocities best."""
    if s.count <= len(s.plane):
        return np.nan
    x = s.position[:, s.plane]
    away = x - x.mean(axis=0)
    v = s.velocity[:, s.plane]
    relative = v - v.mean(axis=0)
    # LAPACK would not come to an end
    if not (np.isfinite(away).all() and np.isfinite(relative).all()):
        return np.nan
    gradient = np.linalg.lstsq(away, relative, rcond=None)[0].T
    rate = _deviator((gradient + gradient.T) / 2)
    factor = {3: 2 / 3, 2: 2}[len(rate)]
    return np.sqrt(factor) * _norm(rate)


def _d50(s: Sample) -> float:
    if not s.count:
        return np.nan
    order = np.argsort(s.diameter, kind="stable")
    share = np.cumsum(s.volume[order])
    return s.diameter[order][np.searchsorted(share, 0.5 * share[-1])]


def _d_bar(s: Sample) -> float:
    load_bearing = s.partners >= s.min_contacts
    return ratio((s.volume * s.diameter)[load_bearing].sum(), s.volume[load_bearing].sum())


def _of_mixture(method: str, s: Sample) -> float:
    if s.mixture is None or not len(s.mixture.phase):
        return np.nan
    return getattr(s.mixture, method)(s.which)


def _centre_of_mass(s: Sample) -> NDArray:
    """Return the centre of mass (3,), NaN along periodic axes that no bounds end."""
    centre = ratio((s.mass[:, None] * s.position).sum(axis=0), s.mass.sum())
    return np.where(s.is_endless, np.nan, centre)


def _of_phases(method: str, long_name: str, formula: str) -> PackingQuantity:
    compute = partial(_of_mixture, method)
    needs = ("diameter", "volume")
    return PackingQuantity(long_name, formula, compute, needs=needs, of_phases=True)


def _of_force(kind: str, symbol: str) -> dict[str, PackingQuantity]:
    """Mean and distribution of one part of the forces, over the contacts that push."""
    force = f"{kind}_force"
    ratios = f"{symbol} / <{symbol}>"
    return {
        f"mean_{force}": PackingQuantity(
            f"mean {kind} force of contacts that push",
            f"<{symbol}>, f_c . n_c > 0",
            partial(_mean_force, force),
            units="N",
            needs=FORCES,
        ),
        f"{force}_pdf": PackingQuantity(
            f"probability density of the {kind} force over its mean",
            f"p({ratios})",
            partial(_force_pdf, force),
            dims=("force_ratio",),
            needs=FORCES,
        ),
        f"{force}_count": PackingQuantity(
            f"number of contacts by {kind} force over its mean",
            f"N_c({ratios})",
            partial(_force_count, force),
            dims=("force_ratio",),
            needs=FORCES,
        ),
    }


QUANTITIES: dict[str, PackingQuantity] = {
    "particle_count": PackingQuantity("number of particles", "N", lambda s: s.count),
    "contact_count": PackingQuantity(
        "number of contacts", "N_c = sum w_c", lambda s: s.weight.sum(), needs=CONTACTS
    ),
    "volume_fraction": PackingQuantity(
        "packing fraction",
        "sum V_i / V",
        lambda s: ratio(s.volume.sum(), s.region_volume),
        needs=("volume",),
    ),
    "coordination_number": PackingQuantity(
        "coordination number",
        "Z = sum z_i / N",
        lambda s: ratio(s.partners.sum(), s.count),
        needs=CONTACTS,
    ),
    "mechanical_coordination_number": PackingQuantity(
        "mechanical coordination number",
        "Z_mech = sum z_i / N over z_i >= m",
        _mechanical,
        needs=CONTACTS,
    ),
    "rattler_count": PackingQuantity(
        "number of rattlers",
        "N of z_i < D + 1",
        lambda s: s.count - s.backbone.sum(),
        needs=CONTACTS,
    ),
    "non_rattler_fraction": PackingQuantity(
        "fraction of particles that are no rattlers",
        "f_NR = 1 - rattlers / N",
        lambda s: ratio(s.backbone.sum(), s.count),
        needs=CONTACTS,
    ),
    "connectivity": PackingQuantity(
        "fraction of particles by number of contact partners",
        "N(z_i = z) / N",
        _connectivity,
        dims=("partners",),
        needs=CONTACTS,
    ),
    **_of_force("normal", "f_n"),
    **_of_force("tangential", "f_t"),
    "cluster_count": PackingQuantity(
        "number of clusters of grains in contact, single grains included",
        "number of connected components",
        lambda s: len(s.clusters.size),
        needs=CONTACTS,
    ),
    "largest_cluster": PackingQuantity(
        "number of grains of the largest cluster",
        "s_max",
        lambda s: s.clusters.size.max(initial=0),
        needs=CONTACTS,
    ),
    "largest_cluster_fraction": PackingQuantity(
        "share of the grains that the largest cluster has",
        "s_max / N",
        lambda s: ratio(s.clusters.size.max(initial=0), s.count),
        needs=CONTACTS,
    ),
    "percolation": PackingQuantity(
        "1 along axes on which a cluster reaches through the box",
        "1 where a cluster winds or joins walls, else 0",
        _percolation,
        dims=("component",),
        needs=CONTACTS,
    ),
    "fabric": PackingQuantity("fabric tensor", "F = <n n>", _fabric, dims=TENSOR, needs=CONTACTS),
    "fabric_anisotropy": PackingQuantity(
        "anisotropy of the fabric",
        "sqrt(3/2 a:a), a = 15/2 dev F (2D: sqrt(a:a / 2), a = 4 dev F)",
        _anisotropy,
        needs=CONTACTS,
    ),
    "stress": PackingQuantity(
        "contact stress, compression positive",
        "sum f_ij a_ij / V",
        _stress,
        units="Pa",
        dims=TENSOR,
        needs=FORCES,
    ),
    "mean_stress": PackingQuantity(
        "mean contact stress", "p' = tr sigma / D", _mean_stress, units="Pa", needs=FORCES
    ),
    "deviator_stress": PackingQuantity(
        "deviator of the contact stress",
        "q = sqrt(3/2 s:s), s = dev sym sigma (2D: sqrt(2 s:s))",
        _deviator_stress,
        units="Pa",
        needs=FORCES,
    ),
    "stress_ratio": PackingQuantity(
        "ratio of the contact stress",
        "eta = q / p'",
        lambda s: ratio(_deviator_stress(s), _mean_stress(s)),
        needs=FORCES,
    ),
    "d_max": PackingQuantity(
        "largest diameter",
        "max d_i",
        lambda s: max(s.diameter, default=np.nan),
        units="m",
        needs=("diameter",),
    ),
    "d50": PackingQuantity(
        "diameter below which half of the volume lies",
        "d50",
        _d50,
        units="m",
        needs=("diameter", "volume"),
    ),
    "d_bar": PackingQuantity(
        "volume-weighted mean diameter of particles that bear load",
        "sum V_i d_i / sum V_i over z_i >= m",
        _d_bar,
        units="m",
        needs=("diameter", "volume", *CONTACTS),
    ),
    "particle_density": PackingQuantity(
        "density of the particles' material",
        "sum m_i / sum V_i",
        lambda s: ratio(s.mass.sum(), s.volume.sum()),
        units="kg m^-3",
        needs=("mass", "volume"),
    ),
    "centre_of_mass": PackingQuantity(
        "centre of mass",
        "sum m_i r_i / sum m_i",
        _centre_of_mass,
        units="m",
        dims=("component",),
        needs=("mass",),
    ),
    "strain_rate": PackingQuantity(
        "deviatoric strain rate",
        "sqrt(2/3 e:e), e = dev strain rate (2D: sqrt(2 e:e))",
        _velocity_rate,
        units="s^-1",
        needs=("velocity",),
    ),
    "lacey_index": _of_phases(
        "lacey", "Lacey's index of mixing", "M = (S_0^2 - S^2) / (S_0^2 - S_r^2)"
    ),
    "lacey_noise": _of_phases(
        "noise",
        "standard deviation of Lacey's index in a random mixture",
        "S_r^2 / (S_0^2 - S_r^2) sqrt((2 + (1 - 6 p q) / (p q) <1 / n_k>) (1 - K / N) / (K - 1)), q = 1 - p",
    ),
    "grains_per_cell": _of_phases(
        "grains_per_cell", "mean number of grains in the cells that are not empty", "N / K"
    ),
    "segregation_index": _of_phases(
        "segregation",
        "height of the centre of a phase above that of the rest, over its largest value",
        "(z_a - z_rest) / (z_top - z_bottom)",
    ),
    "concentration_variance": _of_phases(
        "variance", "variance of the concentration between cells", "S^2 = sum_k W_k (c_k - p)^2 / W"
    ),
    "random_concentration_variance": _of_phases(
        "random_variance",
        "mean variance of the concentration where phases are at random",
        "S_r^2 = (K - 1) / (N - 1) N sum w_i^2 (a_i - p)^2 / W^2",
    ),
    "segregated_concentration_variance": _of_phases(
        "segregated_variance",
        "variance of the concentration where phases are apart",
        "S_0^2 = p (1 - p)",
    ),
}
