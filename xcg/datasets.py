"""Sample data that come with xcg, and synthetic scenes: the same for documentation, tests and benchmarks."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.messages import unknown
from xcg.scene.from_arrays import scene_from_arrays
from xcg.scene.lattice import Lattice, minimum_image
from xcg.scene.schema import COMPONENTS


@dataclass(frozen=True)
class _Sample:
    """Files that come with xcg: in the installed package under ``data``, in a checkout among the examples."""

    folder: str
    particles: str = "particles.dump.gz"
    contacts: str | None = None
    options: dict[str, Any] = field(default_factory=dict)


_SERIES = "particles.*.dump.gz", "contacts.*.dump.gz"
_DISCS = {"shape": "disc", "thickness": 1.0}  # dumps hold radii and masses, and not of which shape
_FLOOR = {"floor": "f_floor[*]"}

# what the wheel holds stands in pyproject.toml
_SAMPLES = {
    "bedload": _Sample(
        "lammps_bedload",
        *_SERIES,
        {
            "frozen": 2,
            "gravity": (0.0, 0.0, -5.886),
            "names": {"v_fx": "drag", "v_fz": None},
        },
    ),
    "biaxial": _Sample("lammps_biaxial", *_SERIES, _DISCS),
    "chute": _Sample(
        "lammps_chute",
        "particles.00050000.dump.gz",
        "contacts.00050000.dump.gz",
        {
            "gravity": (0.4067, 0.0, -0.9135),
            "names": {"fz": "force_z"},  # the total force on each grain
        },
    ),
    **{
        f"column_{a}": _Sample("lammps_column", f"particles_{a}.dump.gz", options=_DISCS)
        for a in ("0.5", "1", "2", "4", "8")
    },
    "cooling": _Sample("lammps_cooling"),
    "glued": _Sample(
        "lammps_glued",
        contacts="contacts.dump.gz",
        options={
            "walls": _FLOOR,
            "gravity": (0.258819, 0.0, -0.965926),
        },
    ),
    "impact": _Sample(
        "lammps_impact",
        *_SERIES,
        {
            "walls": _FLOOR,
            "gravity": (0.0, 0.0, -9.81),
            "names": {"fz": "force_z"},
        },
    ),
    "segregation": _Sample("lammps_segregation", _SERIES[0], options={"frozen": 2}),
    "suspension": _Sample("lammps_suspension", *_SERIES, {"shear_rate": {"xy": 1.0}}),
    **{
        f"hopper_{width}": _Sample(
            "lammps_hopper",
            f"particles_{width}.dump.gz",
            options={
                "density": 6 / np.pi,
                "gravity": (0.0, 0.0, -1.0),
            },
        )
        for width in (4, 5, 6)
    },
    "mixing_drum": _Sample("lammps_mixing", options={"gravity": (0.0, 0.0, -1.0)}),
    "plane_shear": _Sample("lammps_plane_shear", *_SERIES, {"frozen": 2}),
    **{
        f"shear_cell_{rate}": _Sample(
            "lammps_shear_cell",
            f"particles_{rate}.dump.gz",
            f"contacts_{rate}.dump.gz",
            {**_DISCS, "shear_rate": {"xy": float(rate)}},
        )
        for rate in ("0.02", "0.03", "0.05", "0.1", "0.2", "0.3")
    },
    "silo": _Sample(
        "lammps_silo",
        contacts="contacts.dump.gz",
        options={
            "walls": {"side": "f_side[*]", **_FLOOR},
            "gravity": (0.0, 0.0, -9.81),
        },
    ),
}
_ABOUT = {
    "lammps_bedload": "1000 spheres of 1 mm that a viscous fluid shears from above",
    "lammps_biaxial": "2400 discs in a biaxial test",
    "lammps_chute": "4398 spheres that flow down a rough plane",
    "lammps_column": "columns of 1600 discs that collapse",
    "lammps_cooling": "2000 inelastic spheres that lose their energy in a periodic box",
    "lammps_glued": "400 rods of three glued spheres at rest on a tilted floor",
    "lammps_impact": "a sphere of 10 mm that falls on 2200 of 2.5 mm",
    "lammps_segregation": "1100 small and 140 large spheres that part in a flow down a plane",
    "lammps_suspension": "400 spheres sheared in a viscous drag",
    "lammps_hopper": "1300 spheres that flow out of a silo through a slot",
    "lammps_mixing": "700 spheres in a drum, whose left and right half mix in two turns",
    "lammps_plane_shear": "225 spheres sheared between two rough walls that move",
    "lammps_shear_cell": "400 discs in plane shear without walls",
    "lammps_silo": "3800 spheres at rest in a cylinder",
}
_FOLDERS = (Path(__file__).parent / "data", Path(__file__).parents[1] / "examples" / "data")


def __getattr__(name: str) -> Any:
    """Raise AttributeError; for the name of a sample, with the call that opens it."""
    message = f"module 'xcg.datasets' has no attribute {name!r}"
    if name in _SAMPLES:
        message += f"; open the sample by xcg.datasets.open({name!r})"
    raise AttributeError(message, name=name)


def samples() -> dict[str, str]:
    """Return the names of the sample data that come with xcg, each with a description.

    Examples
    --------
    >>> import xcg
    >>> xcg.datasets.samples()["silo"]
    '3800 spheres at rest in a cylinder'
    """
    return {name: _ABOUT[sample.folder] for name, sample in _SAMPLES.items()}


def open(name: str, **options: Any) -> xr.Dataset:  # noqa: A001
    """Open sample data that come with xcg; nothing is fetched from a network.

    Parameters
    ----------
    name : str
        One of the `sample data <../api.html#sample-data-and-synthetic-scenes>`_, which `samples`
        lists, such as "chute": one step of 4398 spheres that flow down a rough plane.
    **options
        For `xcg.open_scene`.

    Returns
    -------
    xarray.Dataset
        The scene, lazy.

    Raises
    ------
    ValueError
        If there are no data of this name.
    FileNotFoundError
        If the files are missing from the installation.

    Examples
    --------
    >>> import xcg
    >>> ds = xcg.datasets.open("chute")
    >>> ds.sizes["particle"]
    4398
    """
    if name not in _SAMPLES:
        listed = f"samples are {', '.join(_SAMPLES)}; files of your own open with xcg.open_scene"
        raise ValueError(unknown("sample", name, _SAMPLES, listed))
    from xcg.readers.open import open_scene  # and with it dask, which scenes in memory do without

    sample = _SAMPLES[name]
    for parent in _FOLDERS:
        folder = parent / sample.folder
        if folder.is_dir():
            arguments = sample.options | options
            if sample.contacts:
                arguments.setdefault("contacts", str(folder / sample.contacts))
            return open_scene(str(folder / sample.particles), **arguments)
    raise FileNotFoundError(
        f"open({name!r}): no folder {_FOLDERS[0] / sample.folder}; install xcg again"
    )


_FCC = np.array([[0.0, 0.0, 0.0], [0.5, 0.5, 0.0], [0.5, 0.0, 0.5], [0.0, 0.5, 0.5]])


def _lattice(cells: int | NDArray, basis: NDArray, edge: float) -> NDArray:
    counts = np.broadcast_to(cells, 3)
    corners = np.indices(tuple(counts)).reshape(3, -1).T
    return ((corners[:, None] + basis) * edge).reshape(-1, 3)


def simple_cubic(
    cells: int = 5, diameter: float = 1.0, force: float = 1.0, **options: Any
) -> xr.Dataset:
    """Periodic simple cubic packing of touching spheres, `cells` along each edge, with a force in every bond.

    Its volume fraction is pi/6 and its stress ``force / diameter^2`` times the identity.
    """
    sites = _lattice(cells, np.zeros((1, 3)), diameter)
    return _bonded(sites, cells * diameter, diameter, diameter, force, options)


def face_centred_cubic(
    cells: int = 4,
    diameter: float = 1.0,
    bond: float | None = None,
    force: float = 1.0,
    **options: Any,
) -> xr.Dataset:
    """Periodic face-centred cubic packing with the same force in every bond.

    Its volume fraction is ``pi / (3 sqrt 2) (diameter / bond)^3`` and its stress ``2 sqrt 2 force /
    bond^2`` times the identity: 6 bonds a particle, tr(sigma) = 6 n f l with n = sqrt 2 / l^3.

    Parameters
    ----------
    cells : int
        Cubic cells (4 particles each) along an edge.
    diameter, bond : float
        Diameter, and distance of neighbours (m; the diameter by default).
    force : float
        Magnitude of the bond force (N), repulsive.
    **options
        For `scene_from_arrays`.
    """
    if bond is None:
        bond = diameter
    edge = np.sqrt(2) * bond
    return _bonded(_lattice(cells, _FCC, edge), cells * edge, diameter, bond, force, options)


def _bonded(
    position: NDArray,
    edge: float,
    diameter: float,
    bond: float,
    force: float,
    options: dict[str, Any],
) -> xr.Dataset:
    """Scene of a periodic lattice whose neighbours at distance `bond` push each other."""
    from scipy.spatial import cKDTree

    reach = bond * (1 + 1e-6)
    period = np.full(3, edge)
    if edge <= reach:
        raise ValueError(
            f"the edge of the lattice is {edge:g}, where grains touch their own images: take more cells"
        )
    pairs = cKDTree(position % edge, boxsize=period).query_pairs(reach, output_type="ndarray")
    branch = minimum_image(position[pairs[:, 0]] - position[pairs[:, 1]], period)
    rows, branch = Lattice(period).within(branch, np.full(len(pairs), reach))
    pairs = pairs[rows]
    arguments = {
        "diameter": np.full(len(position), diameter),
        "density": 2500.0,
        "velocity": np.zeros_like(position),
        "contact_i": pairs[:, 0],
        "contact_j": pairs[:, 1],
        "contact_force": force * branch / np.linalg.norm(branch, axis=1, keepdims=True),
        "contact_branch": branch,
        "box": [[0.0, edge]] * 3,
        "periodic": "xyz",
    }
    return scene_from_arrays(position, **(arguments | options))


def random_scene(
    particles: int = 200,
    *,
    seed: int = 0,
    edge: float = 5.0,
    periodic: str = "xyz",
    dimension: int = 3,
    polydispersity: float = 2.0,
    walls: bool = True,
    **options: Any,
) -> xr.Dataset:
    """Random grains with forces between near neighbours: no physics, but every sum that a real scene has.

    Parameters
    ----------
    particles : int
        Number of grains.
    seed : int
        Seed of the random numbers.
    edge : float
        Edge of the box (m).
    periodic : str
        Periodic axes.
    dimension : int
        3, or 2 for a layer in the plane z = 0.
    polydispersity : float
        Largest over smallest diameter.
    walls : bool
        Whether grains near the edges of axes that are not periodic also touch walls there.
    **options
        For `scene_from_arrays`.
    """
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(seed)
    axes_count = 3 if dimension == 3 else 2
    moving = np.arange(3) < axes_count
    position = np.zeros((particles, 3))
    position[:, :axes_count] = rng.uniform(0, edge, (particles, axes_count))
    mean = edge * (0.6 / max(particles, 1)) ** (1 / axes_count)
    diameter = mean * rng.uniform(1.0, polydispersity, particles) * 2 / (1 + polydispersity)
    period = edge * np.array([a in periodic for a in COMPONENTS])
    tree = cKDTree(position, boxsize=period)
    pairs = tree.query_pairs(0.75 * diameter.max(initial=0.0), output_type="ndarray").reshape(-1, 2)
    i, j = pairs.T
    force = rng.normal(size=(len(pairs), 3)) * moving
    branch = minimum_image(position[i] - position[j], np.where(period > 0, period, np.inf))
    point = position[i] - 0.5 * branch
    for k, axis in enumerate(COMPONENTS[:axes_count]):
        if walls and axis not in periodic:
            near = np.flatnonzero(position[:, k] < 0.5 * diameter)
            foot = position[near]
            foot[:, k] = 0.0
            push = np.zeros_like(foot)
            push[:, k] = rng.uniform(0, 1, len(near))
            i = np.concatenate([i, near])
            j = np.concatenate([j, np.full(len(near), -1 - k)])
            force = np.concatenate([force, push])
            point = np.concatenate([point, foot])
    velocity = rng.normal(size=(particles, 3)) * moving
    species = 1 + rng.integers(0, 2, particles)
    turns = np.array([dimension == 3, dimension == 3, True])
    arguments = {
        "diameter": diameter,
        "density": 2500.0,
        "velocity": velocity,
        "angular_velocity": rng.normal(size=(particles, 3)) * turns,
        "species": species,
        "contact_i": i,
        "contact_j": j,
        "contact_force": force,
        "contact_point": point,
        "box": [[0.0, edge]] * 3,
        "periodic": periodic,
        "dimension": dimension,
    }
    with warnings.catch_warnings():  # points are in the middle of pairs that need not touch
        warnings.filterwarnings("ignore", ".*contact points lie")
        return scene_from_arrays(position, **(arguments | options))


def dense_packing(
    particles: int = 10_000,
    *,
    diameter: float = 1.0,
    volume_fraction: float = 0.6,
    contacts: float = 3.0,
    jitter: float = 0.05,
    seed: int = 0,
    periodic: str = "xyz",
    **options: Any,
) -> xr.Dataset:
    """Dense packing of equal spheres in a box, of any number: a scene for benchmarks and error studies.

    Spheres stand on the sites of a face-centred cubic lattice, a few left empty so that any number
    fits, each displaced at random; the pairs that are nearest to each other are in contact, pushed
    apart by random forces with some friction. The packing is not in balance, but its sums cost as
    much as a real one's.

    Parameters
    ----------
    particles : int
        Number of spheres.
    diameter : float
        Diameter of all of them (m).
    volume_fraction : float
        Volume of the spheres over that of the box.
    contacts : float
        Number of contacts over that of the spheres.
    jitter : float
        Standard deviation of the displacements along each axis, over the diameter.
    seed : int
        Seed of the random numbers.
    periodic : str
        Periodic axes; no contact crosses an edge of the box along the others.
    **options
        For `scene_from_arrays`.
    """
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(seed)
    across = max(1, round((particles / 4) ** (1 / 3)))
    cells = np.array([across, across, max(1, -(-particles // (4 * across**2)))])
    edge = diameter * (particles * np.pi / 6 / volume_fraction / cells.prod()) ** (1 / 3)
    position = rng.permutation(_lattice(cells, _FCC + 0.25, edge))[:particles]
    position += jitter * diameter * rng.normal(size=(particles, 3))
    box = cells * edge
    position %= box
    period = np.where([a in periodic for a in COMPONENTS], box, np.inf)
    tree = cKDTree(position, boxsize=np.where(np.isfinite(period), period, 0.0))
    wanted = round(contacts * particles)
    reach = 1.2 * edge / np.sqrt(2)
    pairs = tree.query_pairs(reach, output_type="ndarray")
    while len(pairs) < wanted and reach < box.min() / 2:
        reach *= 1.2
        pairs = tree.query_pairs(reach, output_type="ndarray")
    branch = minimum_image(position[pairs[:, 0]] - position[pairs[:, 1]], period)
    length = np.linalg.norm(branch, axis=1)
    nearest = np.argsort(length, kind="stable")[:wanted]
    nearest = nearest[np.lexsort((pairs[nearest, 1], pairs[nearest, 0]))]
    pairs = pairs[nearest]
    branch = branch[nearest]
    length = length[nearest]
    push = rng.exponential(size=(len(pairs), 1)) * branch / length[:, None]
    arguments = {
        "diameter": np.full(particles, diameter),
        "density": 2500.0,
        "velocity": rng.normal(size=(particles, 3)),
        "species": 1 + rng.integers(0, 2, particles),
        "contact_i": pairs[:, 0],
        "contact_j": pairs[:, 1],
        "contact_force": push + 0.1 * rng.normal(size=(len(pairs), 3)),
        "contact_branch": branch,
        "box": np.stack([np.zeros(3), box], axis=1),
        "periodic": periodic,
    }
    return scene_from_arrays(position, **(arguments | options))
