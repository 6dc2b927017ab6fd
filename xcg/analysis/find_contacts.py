"""Contacts from positions: a scene whose code wrote none gets them back, with forces where a stiffness is given."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.analysis.pairs import check_search, pairs_of
from xcg.common.checks import POSITIVE, above, check, whole
from xcg.common.messages import SceneError
from xcg.compiled._jit import threads_for
from xcg.scene.conform import takes_scene
from xcg.scene.contact_points import REPEAT, contact_points
from xcg.scene.frame import require_steps
from xcg.scene.lattice import Lattice, unit_vectors
from xcg.scene.scene import Scene
from xcg.scene.schema import OF_STEP, Frame, Variable, variable
from xcg.scene.spheres import warn_of_coincident
from xcg.steps.analysis import FrameAnalysis, run
from xcg.steps.labels import call_of
from xcg.steps.mapping import is_lazy

READ = ("particle_id", "position", "diameter")
# Pairs of these are left out: two frozen grains are one wall, and grains of one body are glued.
OPTIONAL = ("frozen", "body_id")
FOUND = ("contact_i", "contact_j", "contact_point", "contact_normal", "overlap")

# Contacts a particle that spheres without overlap can have on average, of any sizes: half the
# average kissing number, at most 13.955 for spheres (Glazyrin 2020), and 6 in a plane (contact
# graphs of discs are planar).
MOST_CONTACTS = {3: 7, 2: 3}


@dataclass(frozen=True)
class Stiffness:
    """Law of the normal force as a function of overlap.

    Attributes
    ----------
    k_n : float or None
        Linear spring (N m-1): ``f = k_n overlap``.
    E, nu : float or None
        Young's modulus (Pa) and Poisson's ratio of both spheres, Hertz: ``f = 4/3 E* sqrt(R*)
        overlap^(3/2)`` with ``E* = E / (2 (1 - nu^2))`` and ``R* = R_i R_j / (R_i + R_j)`` (Johnson
        1985, eq. 4.22).
    """

    k_n: float | None = None
    E: float | None = None
    nu: float | None = None

    def __post_init__(self) -> None:
        check("k_n", self.k_n, POSITIVE, "N m-1", optional=True)
        check("E", self.E, POSITIVE, "Pa", optional=True)
        check("nu", self.nu, above(-1, 0.5), optional=True)
        names = [name for name in ("k_n", "E", "nu") if getattr(self, name) is not None]
        if names not in ([], ["k_n"], ["E", "nu"]):
            raise ValueError(
                f"k_n={self.k_n!r}, E={self.E!r}, nu={self.nu!r}: expected k_n (N m-1) for linear springs, or both E "
                "(Pa) and nu for Hertz contacts, or none of them"
            )

    @property
    def gives_forces(self) -> bool:
        """Return whether forces are wanted."""
        return self.k_n is not None or self.E is not None

    def __str__(self) -> str:
        if self.k_n is not None:
            return f"linear spring, k_n = {self.k_n:g}"
        return f"Hertz, E = {self.E:g}, nu = {self.nu:g}"

    def force(self, overlap: NDArray, radius_i: NDArray, radius_j: NDArray) -> NDArray:
        """Magnitude of the normal force (N); zero across a gap."""
        depth = np.maximum(overlap, 0.0)
        if self.k_n is not None:
            return self.k_n * depth
        E = self.E or 0.0
        nu = self.nu or 0.0
        total = radius_i + radius_j
        reduced = np.divide(radius_i * radius_j, total, out=np.zeros_like(total), where=total > 0)
        return 4 / 3 * E / (2 * (1 - nu**2)) * np.sqrt(reduced) * depth**1.5


@dataclass(frozen=True)
class _Search(FrameAnalysis):
    """Contacts of each step; `max_contacts` is the number of rows set aside, None for as many as needed."""

    name = "find_contacts"
    optional = OPTIONAL

    stiffness: Stiffness
    skin: float
    levels: int | None
    max_contacts: int | None

    def reads(self, scene: Scene) -> tuple[str, ...]:
        """Return positions and sizes."""
        return READ

    def rows(self, scene: Scene) -> dict[str, Variable]:
        """Return the variables of contacts, forces where a stiffness is given."""
        rows = {name: variable(name) for name in FOUND}
        if self.stiffness.gives_forces:
            rows["contact_force"] = variable("contact_force")
        return rows

    def sizes(self, scene: Scene, ds: xr.Dataset) -> dict[str, int | None]:
        """Return the number of rows of contacts."""
        return {"contact": self.max_contacts}

    def frame(self, frame: Frame, lattice: Lattice, source: str) -> Frame:
        """Find the contacts of one step."""
        ids = frame["particle_id"]
        position = frame["position"]
        radius = frame["diameter"] / 2
        self._refuse_own_images(frame, lattice, source)
        pairs = pairs_of(
            position,
            radius,
            lattice,
            skin=self.skin,
            levels=self.levels,
            threads=threads_for(len(position), self.threads),
            max_pairs=self.max_contacts,
            source=source,
        )
        if "frozen" in frame:
            pairs = pairs[(frame["frozen"][pairs] != 1).any(axis=1)]
        if "body_id" in frame:
            body_i, body_j = frame["body_id"][pairs].T
            pairs = pairs[(body_i != body_j) | (body_i < 0)]  # negative for spheres of their own
        i, j = pairs.T
        reach = radius[i] + radius[j] + self.skin
        within, branch = lattice.within(lattice.shortest(position[i] - position[j]), reach)
        i, j = pairs[within].T
        if self.max_contacts is not None and len(i) > self.max_contacts:
            raise SceneError(
                f"{source}: {len(i)} contacts among {len(ids)} particles, more than the {self.max_contacts} rows "
                "set aside; "
                f"pass max_contacts={len(i)} or more to find_contacts, or load the scene first with ds.load()"
            )
        length = np.linalg.norm(branch, axis=1)
        same = length == 0.0
        warn_of_coincident(ids[i[same]], ids[j[same]], source)
        normal = unit_vectors(branch)
        overlap = radius[i] + radius[j] - length
        contacts = {
            "contact_i": ids[i],
            "contact_j": ids[j],
            "contact_point": contact_points(position[i], branch, radius[i], radius[j]),
            "contact_normal": normal,
            "overlap": overlap,
        }
        if self.stiffness.gives_forces:
            force = self.stiffness.force(overlap, radius[i], radius[j])
            contacts["contact_force"] = force[:, None] * normal
        return contacts

    def after(self, result: xr.Dataset, ds: xr.Dataset) -> xr.Dataset:
        """Return the scene with these contacts in place of former ones."""
        scene = ds.drop_dims("contact", errors="ignore").assign(result.data_vars)
        scene.attrs["history"] = result.attrs["history"]
        scene.attrs.pop("sides", None)  # of the contacts that are replaced
        if self.stiffness.gives_forces:
            estimate = f"normal force from the overlap of spheres: {self.stiffness}"
            scene.attrs["estimated_forces"] = estimate
            scene["contact_force"].attrs["estimated"] = estimate
        return scene

    def _refuse_own_images(self, frame: Frame, lattice: Lattice, source: str) -> None:
        """Raise SceneError for a period that a grain spans: it would touch itself."""
        ids = frame["particle_id"]
        diameter = frame["diameter"]
        if "frozen" in frame:
            ids = ids[frame["frozen"] != 1]
            diameter = diameter[frame["frozen"] != 1]
        period, direction = lattice.closest
        if diameter.max(initial=0.0) + self.skin > period:
            largest = int(np.argmax(diameter))
            raise SceneError(
                f"{source}: particle {ids[largest]} of diameter {diameter[largest]:g} touches its own image (skin "
                f"{self.skin:g}), as the period {direction} is {period:g}, and a contact with itself "
                f"has no place in a scene; {REPEAT}"
            )


@takes_scene
def find_contacts(
    scene: Scene,
    *,
    levels: int | None = None,
    skin: float = 0.0,
    k_n: float | None = None,
    E: float | None = None,
    nu: float | None = None,
    max_contacts: int | None = None,
) -> xr.Dataset:
    """Find the contacts of a scene from positions and diameters, and their normal forces from a stiffness.

    All pairs with ``|r_i - r_j| < R_i + R_j + skin``, each once, sorted by the rows of i, then j
    (see `xcg.find_pairs`); in a box so small that two grains touch on several sides, each of these
    contacts. Pairs of two frozen grains and pairs within one body are left out. Walls that are not
    made of grains leave no trace in positions: their contacts are not found.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with diameters. Contacts that it holds are replaced.
    levels : int, optional
        Number of levels of the hierarchy; by default one for each factor of 3 in size. 1 is the
        method of linked cells, to compare with.
    skin : float
        Width of gaps that still count as contacts (m); their overlap is negative and their force
        zero.
    k_n : float, optional
        Stiffness of linear springs (N m-1), for ``contact_force = k_n overlap n``.
    E, nu : float, optional
        Young's modulus (Pa) and Poisson's ratio, for Hertz contacts: ``4/3 E* sqrt(R*)
        overlap^(3/2) n`` with ``E* = E / (2 (1 - nu^2))``, ``R* = R_i R_j / (R_i + R_j)``.
        Friction, damping and cohesion are not in it.
    max_contacts : int, optional
        Rows set aside for the contacts of a step. By default a scene in memory takes as many as it
        finds; a lazy one takes 7 a particle (3 in a one-layer scene), more than spheres without
        overlap can have on average whatever their sizes (Glazyrin 2020): the average kissing number
        is below 13.955. Rows that are not needed are padding.

    Returns
    -------
    xarray.Dataset
        The scene with ``contact_i``, ``contact_j``, ``contact_point``, ``contact_normal``,
        ``overlap``, and ``contact_force`` where a stiffness is given, marked by its attribute
        ``estimated``. Lazy over time where the scene is, one task for each chunk.

    Raises
    ------
    SceneError
        If the scene has no diameters, or no step; on computing, if a step has more than
        `max_contacts`, or a grain touches its own image across a periodic axis.
    ValueError
        If an argument is wrong.

    Notes
    -----
    The contact point lies at ``R_i - overlap / 2`` from the centre of i, the normal points from j
    to i. Where both centres coincide, the normal and the force are zero, with a warning. Source of
    the method: Ogarko & Luding (2012); Shire, Hanley & Stratford (2020). Of Hertz contacts: Johnson
    (1985), eq. 4.22.

    Examples
    --------
    >>> import xcg
    >>> ds = xcg.datasets.simple_cubic(4).cg.find_contacts(skin=1e-9, k_n=1e5)
    >>> ds.sizes["contact"] / ds.sizes["particle"]
    3.0
    """
    call = call_of("find_contacts", locals())
    ds = scene.ds
    scene.require(("diameter",), "find_contacts")
    require_steps(ds, "find_contacts")
    check_search(skin, levels)
    check("max_contacts", max_contacts, whole(0), optional=True)
    if max_contacts is not None:
        max_contacts = int(max_contacts)
    elif is_lazy(ds, [n for n in (*READ, *OPTIONAL, *OF_STEP) if n in ds]):
        max_contacts = MOST_CONTACTS[scene.setup.dimension] * ds.sizes["particle"]
    analysis = _Search(Stiffness(k_n, E, nu), skin, levels, max_contacts)
    return run(scene, analysis, call=call)
