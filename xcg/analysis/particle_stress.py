"""Stress of single particles from their contacts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.checks import check_choice, is_positive
from xcg.common.messages import SceneError
from xcg.compiled._jit import for_parts, threads_for
from xcg.compiled.contacts import blank_zero_tensors, scale_tensors
from xcg.compiled.matrices import principal
from xcg.scene.conform import takes_scene
from xcg.scene.contacts import Contacts
from xcg.scene.lattice import Lattice
from xcg.scene.scene import Scene
from xcg.scene.schema import VARIABLES, Frame, Variable
from xcg.steps.analysis import FrameAnalysis, run
from xcg.steps.faults import OnError
from xcg.steps.labels import call_of

Volumes: TypeAlias = Literal["particle", "disc"]
_CONTACTS = ("position", "contact_i", "contact_j", "contact_point", "contact_force")
# Eigenvalues below this share of the whole tensor are rounding.
ROUNDING = 1e-12
# Two largest eigenvalues whose difference is below this share of the whole tensor are equal.
# Rounding (1e-15) turns their directions by its ratio to the share, so those that are kept are
# known to 1e-9 rad, within which angles count as equal to `alpha` of force chains.
ISOTROPIC = 1e-6

RESULTS: dict[str, Variable] = {
    "particle_id": VARIABLES["particle_id"],
    "stress": Variable(("particle", "component", "direction"), "Pa", "stress of the particle"),
    "principal_stress": Variable(
        ("particle", "principal"), "Pa", "principal stresses, most compressive first"
    ),
    "principal_direction": Variable(
        ("particle", "principal", "component"), "1", "principal directions"
    ),
    "major_stress": Variable(("particle",), "Pa", "most compressive principal stress"),
    "major_direction": Variable(("particle", "component"), "1", "direction of the major stress"),
    "isotropic": Variable(
        ("particle",), "1", "1 where the two largest principal stresses are equal", "int64"
    ),
}


@dataclass(frozen=True)
class StressRule:
    """Options of the stress of a particle.

    Attributes
    ----------
    thickness : float or str or None
        Of discs (m), or the axis whose box extent it is; None for the scene's volumes.
    spheres : tuple of str
        Variables that the branches of spheres follow from; empty where all follow from contact
        points.
    variables : tuple of str
        Variables of the scene that the stress is made from.
    """

    thickness: float | str | None
    spheres: tuple[str, ...]
    variables: tuple[str, ...]

    @classmethod
    def of(cls, scene: Scene, purpose: str, *, volume: str) -> StressRule:
        """Check that a scene holds what the stress needs, without reading any of it."""
        check_choice("volume", volume, Volumes)
        size = {"particle": "volume", "disc": "diameter"}[volume]
        scene.require((*_CONTACTS, size), purpose)
        thickness = None
        if volume == "disc":
            thickness = scene.layer_depth
            if thickness is None:
                raise SceneError(
                    "volume='disc' is for one-layer scenes, and this one has dimension=3; leave volume= out"
                )
        columns = scene.columns
        spheres = tuple(
            name for name in ("diameter", "overlap", "contact_normal") if name in columns
        )
        if not {"diameter", "overlap"} <= set(spheres):
            spheres = ()
        variables = dict.fromkeys(("particle_id", *_CONTACTS, size, *spheres))
        return cls(thickness, spheres, tuple(variables))

    def contacts(self, frame: Frame, lattice: Lattice, source: str, threads: int) -> Contacts:
        """Join the contacts of a frame to its particles; threads share a step of many."""
        threads = threads_for(len(frame["particle_id"]), threads)
        contacts = Contacts.of(frame, lattice, source, threads)
        if self.spheres:
            contacts = contacts.with_overlaps(frame["diameter"], frame["overlap"])
        return contacts

    def volumes(self, frame: Frame, lattice: Lattice, source: str) -> NDArray:
        """Volume of each particle (m3)."""
        thickness = self.thickness
        if thickness is None:
            return frame["volume"]
        if isinstance(thickness, str):
            thickness = lattice.length(thickness)
            if not is_positive(thickness):
                raise SceneError(
                    f"{source}: the layer is as thick as the box along {self.thickness!r}, which is not finite"
                )
        return np.pi / 4 * frame["diameter"] ** 2 * thickness

    def evaluate(self, frame: Frame, contacts: Contacts, lattice: Lattice, source: str) -> Frame:
        """Stress of each particle of a frame, and its principal values, by name."""
        stress = contacts.dyads
        values = np.empty((len(stress), 3))
        vectors = np.empty((len(stress), 3, 3))
        volumes = self.volumes(frame, lattice, source)

        def write(first: int, last: int) -> None:
            some = slice(first, last)
            scale_tensors(stress[some], volumes[some])
            principal(stress[some], values[some], vectors[some])
            blank_zero_tensors(stress[some], vectors[some])

        for_parts(len(stress), write, contacts.threads)
        size = _norms(stress)
        isotropic = (size > 0) & (values[:, 0] - values[:, 1] <= ISOTROPIC * size)
        direction = vectors[:, 0].copy()
        direction[isotropic] = np.nan
        return {
            "stress": stress,
            "principal_stress": values,
            "principal_direction": vectors,
            "major_stress": values[:, 0].copy(),
            "major_direction": direction,
            "isotropic": isotropic.astype(int),
        }


def carries(result: Mapping[str, NDArray]) -> NDArray:
    """Particles under compression: their largest principal stress is positive, and not by rounding."""
    return result["major_stress"] > ROUNDING * _norms(result["stress"])


def _norms(stress: NDArray) -> NDArray:
    """Frobenius norm of each tensor."""
    return np.sqrt(np.einsum("nij,nij->n", stress, stress))


@takes_scene
def particle_stress(
    scene: Scene,
    *,
    volume: Volumes = "particle",
    on_error: OnError = "raise",
) -> xr.Dataset:
    """Stress tensor of each particle from its contacts, with principal stresses and directions.

    Lazy where the scene is.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with contacts.
    volume : str
        "particle" (default), the scene's volumes; "disc" for a one-layer scene, ``pi d^2/4`` times
        the thickness of the layer.
    on_error : {"raise", "skip"}
        What to do about a step that cannot be read or computed: stop with its error, or leave it
        out (NaN, or padding), warn of it, and mark it in the coordinate ``skipped`` (time).

    Returns
    -------
    xarray.Dataset
        ``stress`` (time, particle, component, direction), in Pa with compression positive;
        ``principal_stress`` (time, particle, principal), most compressive first;
        ``principal_direction`` (time, particle, principal, component), unit vectors;
        ``major_stress`` and ``major_direction``, the most compressive one and its direction;
        ``isotropic``, 1 where the two largest principal stresses are equal (to 1e-6 of the norm of
        the stress), so that the particle has no major direction (NaN), and its principal directions
        are any basis of the plane of both. A particle without contacts has stress zero and no
        direction (NaN), padding is NaN.

    Raises
    ------
    SceneError
        If the scene holds no contacts or no volumes.
    ValueError
        If an argument is wrong.

    Notes
    -----
    ``sigma = 1/V sum_c (f a + a f) / 2``, over the contacts of the particle with others and with
    walls: f the force on the particle, a the branch from the contact point to its centre (nearest
    image), V its volume. It is the symmetric part, because friction makes ``f a`` of a single
    particle asymmetric, and its eigenvalues may then be complex. Where the scene holds overlaps,
    branches of spheres are ``n (R - overlap/2)``: files hold these with more digits than positions.
    Sources: Ejtehadi et al. (2024), where tension is positive; Goldhirsch (2010).

    Examples
    --------
    >>> import xcg
    >>> ds = xcg.datasets.simple_cubic(4, force=1.0)
    >>> float(particle_stress(ds).major_stress[0, 0].round(3))  # 1/V sum f a = 6 / pi for d = f = 1
    1.91
    """
    call = call_of("particle_stress", locals())
    rule = StressRule.of(scene, "particle_stress", volume=volume)
    return run(scene, _ParticleStress(rule), call=call, on_error=on_error)


@dataclass(frozen=True)
class _ParticleStress(FrameAnalysis):
    """Stress of each particle of a step."""

    name = "particle_stress"

    rule: StressRule

    def reads(self, scene: Scene) -> tuple[str, ...]:
        """Return the variables of the rule."""
        return self.rule.variables

    def rows(self, scene: Scene) -> dict[str, Variable]:
        """Return the stress and its principal values."""
        return RESULTS

    def frame(self, frame: Frame, lattice: Lattice, source: str) -> Frame:
        """Compute the stress of the particles of a step."""
        contacts = self.rule.contacts(frame, lattice, source, self.threads)
        stress = self.rule.evaluate(frame, contacts, lattice, source)
        return {"particle_id": frame["particle_id"], **stress}
