"""Values of grains as variables of the scene: coordination, stress, age of contacts, cells, order, velocity."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from xcg.analysis.bond_order import bond_order
from xcg.analysis.contact_history import contact_history
from xcg.analysis.derived import derive_velocity
from xcg.analysis.particle_stress import particle_stress
from xcg.analysis.voronoi import voronoi
from xcg.common.messages import unknown
from xcg.scene.conform import takes_scene
from xcg.scene.contacts import Contacts
from xcg.scene.frame import indices_of
from xcg.scene.lattice import Lattice
from xcg.scene.scene import Scene
from xcg.scene.schema import CONTACT_VARIABLES, VARIABLES, Frame, Variable
from xcg.steps.analysis import FrameAnalysis, run
from xcg.steps.labels import call_of, provenance


@takes_scene
def derive(scene: Scene, values: str | Sequence[str]) -> xr.Dataset:
    """Add values of single grains to the scene as variables; lazy where the scene and the analysis are.

    They can be drawn (``plot``, ``view``), selected by, averaged as fields (by their name in
    `coarse_grain`) and saved, as any variable of the particles.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene.
    values : str or list of str
        Names of the table below.

    Returns
    -------
    xarray.Dataset
        The scene with the values, in place of former variables of their names.

    Raises
    ------
    SceneError
        If the scene lacks what a value is computed from.
    ValueError
        If a value does not exist.

    Notes
    -----
    ========================  ==================================================  =====================
    value                     meaning                                             computed by
    ========================  ==================================================  =====================
    ``velocity``              differences of positions in time, by id             positions of steps
    ``coordination_number``   partners in contact, walls included                 contacts
    ``mean_contact_age``      mean age of the grain's contacts (s)                `contact_history`
    ``stress``                tensor of the grain's contacts (Pa)                 `particle_stress`
    ``pressure``              its trace over the number of dimensions             `particle_stress`
    ``major_stress``          most compressive principal stress                   `particle_stress`
    ``voronoi_volume``        volume of the Voronoi cell                          `voronoi`
    ``voronoi_fraction``      volume of the grain over its cell's                 `voronoi`
    ``voronoi_neighbours``    faces of the cell to others                         `voronoi`
    ``q4``, ``q6``, ``psi6``  bond order, of a layer psi6                         `bond_order`
    ========================  ==================================================  =====================

    A mean age is NaN for grains without contacts, and is computed at once, step by step. Values of
    analyses with other arguments than by default are added by ``ds.assign(q6=order.q6)``.

    **Velocity.** ``v(t_k) = (r_{k+1} - r_{k-1}) / (t_{k+1} - t_{k-1})``, one-sided in the first and
    last step and where a grain is missing before or after; exact for constant acceleration and even
    steps; NaN for grains in no neighbouring step. Across periodic edges grains are followed by
    ``image`` of the scene; without it the nearest image is taken, and steps have to be so close that
    no grain moves by half a period: a warning is given from a quarter on.

    Examples
    --------
    >>> import xcg
    >>> ds = xcg.datasets.simple_cubic(4, force=1.0).cg.derive(["coordination_number", "pressure"])
    >>> ds.coordination_number.values[0, :3].tolist(), float(ds.pressure[0, 0].round(3))
    ([6.0, 6.0, 6.0], 1.91)
    """
    if isinstance(values, str):
        values = [values]
    derived = scene.ds
    for name in values:
        if name not in VALUES:
            raise ValueError(
                unknown("value", name, VALUES, "other variables are added by ds.assign")
            )
    results: dict[Any, xr.Dataset] = {}  # of analyses that several values are parts of
    for name in values:
        analysis = VALUES[name]
        if analysis not in results:
            results[analysis] = analysis(scene.ds)
        derived = derived.assign({name: results[analysis][name].variable})
    return derived.assign_attrs(provenance(scene.ds, call_of("derive", {"values": list(values)})))


def _stress(ds: xr.Dataset) -> xr.Dataset:
    """Return the stress of particles with its pressure."""
    result = particle_stress(ds)
    plane = list(str(ds.attrs.get("plane", "xyz")))
    parts = [result["stress"].sel(component=a, direction=a, drop=True) for a in plane]
    pressure = sum(parts[1:], start=parts[0]) / len(plane)
    about = result["stress"].attrs | {"long_name": "pressure of the particle"}
    return result.assign(pressure=pressure.assign_attrs(about))


def _mean_ages(ds: xr.Dataset) -> xr.Dataset:
    """Return the mean age of the contacts of each particle."""
    ages = contact_history(ds, 1)["contact_age"]
    return run(Scene(ds.assign(contact_age=ages)), _MeanAge())


@dataclass(frozen=True)
class _Coordination(FrameAnalysis):
    """Number of partners of each particle of a step."""

    name = "derive"

    def reads(self, scene: Scene) -> list[str]:
        """Return the positions and partners."""
        return ["particle_id", "position", *CONTACT_VARIABLES[:-1]]

    def rows(self, scene: Scene) -> dict[str, Variable]:
        """Return the number of partners."""
        return {"coordination_number": VARIABLES["coordination_number"]}

    def frame(self, frame: Frame, lattice: Lattice, source: str) -> dict[str, ArrayLike]:
        """Count the partners."""
        return {"coordination_number": Contacts.of(frame, lattice, source).partners}


@dataclass(frozen=True)
class _MeanAge(FrameAnalysis):
    """Mean age of the contacts of each particle of a step."""

    name = "derive"

    def reads(self, scene: Scene) -> list[str]:
        """Return the partners and the ages."""
        return ["particle_id", "contact_i", "contact_j", "contact_age"]

    def rows(self, scene: Scene) -> dict[str, Variable]:
        """Return the mean age."""
        text = "mean age of the contacts of the particle"
        return {"mean_contact_age": Variable(("particle",), "s", text)}

    def frame(self, frame: Frame, lattice: Lattice, source: str) -> dict[str, ArrayLike]:
        """Average the ages over the contacts of each particle, from both sides."""
        ids = frame["particle_id"]
        index = np.concatenate(
            [indices_of(ids, frame[side]) for side in ("contact_i", "contact_j")]
        )
        age = np.tile(frame["contact_age"], 2)[index >= 0]
        index = index[index >= 0]
        count = np.bincount(index, minlength=len(ids))
        with np.errstate(invalid="ignore"):
            return {"mean_contact_age": np.bincount(index, age, len(ids)) / count}


def _coordination(ds: xr.Dataset) -> xr.Dataset:
    scene = Scene(ds)
    scene.require(CONTACT_VARIABLES[:-1], "derive")
    return run(scene, _Coordination())


VALUES: dict[str, Callable[[xr.Dataset], xr.Dataset]] = {
    "velocity": derive_velocity,
    "coordination_number": _coordination,
    "mean_contact_age": _mean_ages,
    **dict.fromkeys(("stress", "pressure", "major_stress"), _stress),
    **dict.fromkeys(("voronoi_volume", "voronoi_fraction", "voronoi_neighbours"), voronoi),
    **dict.fromkeys(("q4", "q6", "psi6"), bond_order),
}
