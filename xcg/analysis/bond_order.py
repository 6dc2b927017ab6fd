"""Bond order of each particle: directions of its neighbours, compared with crystals."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.analysis.pairs import pairs_of
from xcg.common.checks import POSITIVE, check, floats, is_whole, whole
from xcg.common.messages import SceneError, plain
from xcg.scene.conform import takes_scene
from xcg.scene.frame import check_finite
from xcg.scene.lattice import Lattice
from xcg.scene.scene import Scene
from xcg.scene.schema import VARIABLES, Frame, Variable
from xcg.steps.analysis import FrameAnalysis, run
from xcg.steps.faults import OnError

NEAREST = {3: 12, 2: 6}
DEGREES = {3: (4, 6), 2: (6,)}


@takes_scene
def bond_order(
    scene: Scene,
    degrees: Sequence[int] | None = None,
    *,
    neighbours: int | None = None,
    r_max: float | None = None,
    on_error: OnError = "raise",
) -> xr.Dataset:
    r"""Compute the bond order of each particle: Steinhardt's q_l, or psi_l in one layer.

    Lazy where the scene is.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene.
    degrees : list of int, optional
        Degrees l from 1 to 30; by default 4 and 6, in a one-layer scene 6.
    neighbours : int, optional
        Number of nearest particles that are neighbours; by default 12, in a one-layer scene 6.
    r_max : float, optional
        All particles closer than this are neighbours (m), in place of a number of them.
    on_error : {"raise", "skip"}
        What to do about a step that cannot be read or computed: stop with its error, or leave it
        out (NaN), warn of it, and mark it in the coordinate ``skipped`` (time).

    Returns
    -------
    xarray.Dataset
        ``q4``, ``q6`` (time, particle), and ``global_q4``, ``global_q6`` (time), from means over
        all neighbours of all particles. In a one-layer scene ``psi6`` and ``global_psi6``, and
        ``psi6_angle``, the angle in radians from the first axis of the plane to the nearest of the
        six directions of a particle. NaN for particles without neighbours.

    Raises
    ------
    SceneError
        If a step holds too few particles, or the box is too small for so distant neighbours.
    ValueError
        If an argument is wrong.

    Notes
    -----
    Over the :math:`n_i` neighbours j of particle i, in the directions :math:`\theta_{ij},
    \varphi_{ij}`,

    .. math::

        q_{lm}(i) = \frac{1}{n_i} \sum_j Y_{lm}(\theta_{ij}, \varphi_{ij}), \quad
        q_l(i) = \sqrt{\frac{4\pi}{2l + 1} \sum_{m=-l}^{l} |q_{lm}(i)|^2}, \quad
        \psi_l(i) = \left| \frac{1}{n_i} \sum_j e^{i l \varphi_{ij}} \right|

    q_4, q_6 are 0.191, 0.575 in a face-centred cubic crystal, 0.097, 0.485 in a hexagonal
    close-packed one; psi_6 is 1 in a triangular lattice.

    References
    ----------
    Steinhardt, P. J., Nelson, D. R., Ronchetti, M. (1983). Bond-orientational order in liquids and
    glasses. Phys. Rev. B 28.

    Examples
    --------
    >>> import xcg
    >>> order = xcg.datasets.face_centred_cubic(4).cg.bond_order()
    >>> order.q6[0, 0].round(4).item()
    0.5745
    """
    return run(scene, BondOrder(degrees, neighbours, r_max), on_error=on_error)


@dataclass(frozen=True)
class BondOrder(FrameAnalysis):
    """Bond order of the particles of a step, see `bond_order`."""

    name = "bond_order"

    degrees: Sequence[int] | None = None
    neighbours: int | None = None
    r_max: float | None = None

    def prepare(self, scene: Scene) -> Self:
        """Check the options, and fill in defaults."""
        dimension = self.setup.dimension
        degrees = floats(DEGREES[dimension])
        if self.degrees is not None:
            degrees = floats(self.degrees)
        if degrees.ndim != 1 or not degrees.size or not all(is_whole(n, 1, 30) for n in degrees):
            raise ValueError(
                f"degrees={plain(self.degrees)}: expected whole numbers from 1 to 30, such as [4, 6]"
            )
        if self.neighbours is not None and self.r_max is not None:
            raise ValueError("bond_order takes one of neighbours= (a number) and r_max= (m)")
        check("neighbours", self.neighbours, whole(1, 1e4), optional=True)
        check("r_max", self.r_max, POSITIVE, "m", optional=True)
        return replace(
            self,
            degrees=tuple(dict.fromkeys(degrees.astype(int).tolist())),
            neighbours=int(self.neighbours or NEAREST[dimension]),
        )

    def reads(self, scene: Scene) -> tuple[str, ...]:
        """Return the positions."""
        return ("position",)

    def rows(self, scene: Scene) -> dict[str, Variable]:
        """Return the order of each degree, of particles and of all of them."""
        rows = {"particle_id": VARIABLES["particle_id"]}
        letter = self._letter
        for n in self.degrees or ():
            text = f"bond order of degree {n}"
            rows[f"{letter}{n}"] = Variable(("particle",), "1", f"{text} of the particle")
            rows[f"global_{letter}{n}"] = Variable((), "1", f"{text} of all particles")
            if letter == "psi":
                text = f"angle to the nearest of the {n} directions of the particle"
                rows[f"psi{n}_angle"] = Variable(("particle",), "1", text)
        return rows

    def frame(self, frame: Frame, lattice: Lattice, source: str) -> Frame:
        """Compute the bond order of a step."""
        check_finite("position", frame, source)
        axes = self.setup.axes
        position = np.where(np.isin(np.arange(3), axes), frame["position"], 0.0)
        particle, bond = self._bonds(position, lattice, source)
        bond = bond[:, axes]
        if (is_zero := ~bond.any(axis=1)).any():
            where = frame["particle_id"][particle[is_zero.argmax()]]
            raise SceneError(
                f"{source}: particle {where} has a neighbour at its own place, in a direction that "
                "is not known; remove one of them"
            )
        count = len(position)
        numbers = np.bincount(particle, minlength=count)
        results: Frame = {"particle_id": frame["particle_id"]}
        letter = self._letter
        for n in self.degrees or ():
            sums = np.array(
                [
                    np.bincount(particle, wave.real, count)
                    + 1j * np.bincount(particle, wave.imag, count)
                    for wave in _waves(n, bond)
                ]
            )
            means = np.full(sums.shape, np.nan, complex)
            np.divide(sums, numbers, out=means, where=numbers > 0)
            whole = np.full(len(sums), np.nan, complex)
            if len(particle):
                whole = sums.sum(axis=1) / len(particle)
            results[f"{letter}{n}"] = _length(means)
            results[f"global_{letter}{n}"] = _length(whole)
            if letter == "psi":
                results[f"psi{n}_angle"] = np.angle(means[0]) / n
        return results

    @property
    def _letter(self) -> str:
        return {2: "psi", 3: "q"}[self.setup.dimension]

    def _bonds(self, position: NDArray, lattice: Lattice, source: str) -> tuple[NDArray, NDArray]:
        """Return vectors (bonds, 3) to all neighbours, and the row (bonds,) of their particle."""
        half = lattice.closest[0] / 2
        if self.r_max is not None:
            if self.r_max > half * (1 + 1e-12):
                raise SceneError(
                    f"{source}: r_max={self.r_max:g} is beyond half the distance to the nearest "
                    f"image; take r_max={half:.6g} or less"
                )
            pairs = pairs_of(
                position,
                np.zeros(len(position)),
                lattice,
                skin=self.r_max,
                threads=self.threads,
                max_pairs=2**62,
                source=source,
            )
            bond = lattice.shortest(position[pairs[:, 1]] - position[pairs[:, 0]])
            return pairs.T.ravel(), np.concatenate([bond, -bond])
        from scipy.spatial import cKDTree

        count = self.neighbours or 0
        if len(position) <= count:
            raise SceneError(
                f"{source}: bond_order takes the nearest {count} particles, and the step holds "
                f"{len(position)}; take fewer neighbours, or leave the step out by on_error='skip'"
            )
        position = lattice.wrapped(position, lattice.corner, source)
        tree = cKDTree(position)
        # in the order of the tree, which keeps near particles together in memory
        particle = tree.indices
        centre = position[particle]
        nearest: Any = tree.query(centre, count + 1)
        distance, near = nearest
        places = position
        if len(lattice.basis):
            # with images, neighbours are no farther away than without
            reach = min(float(distance.max()), half)
            low = position.min(axis=0) - reach
            high = position.max(axis=0) + reach
            originals, shift, _ = lattice.images(position, low, high, source)
            others = shift.any(axis=1)
            places = np.concatenate([position, position[originals[others]] + shift[others]])
            nearest = cKDTree(places[len(position) :]).query(
                centre, count + 1, distance_upper_bound=reach * (1 + 1e-12)
            )
            changed = nearest[0][:, 0] < distance[:, -1]
            all_distances = np.hstack([distance[changed], nearest[0][changed]])
            all_near = np.hstack([near[changed], len(position) + nearest[1][changed]])
            order = np.argsort(all_distances, axis=1)[:, : count + 1]
            distance[changed] = np.take_along_axis(all_distances, order, axis=1)
            near[changed] = np.take_along_axis(all_near, order, axis=1)
            if distance.max() > reach * (1 + 1e-12):
                raise SceneError(
                    f"{source}: some of the nearest {count} particles are beyond half the distance "
                    f"to the nearest image ({half:g} m); take fewer neighbours"
                )
        is_itself = near == particle[:, None]
        # particles at the same position may push the particle itself out of the list
        is_itself[~is_itself.any(axis=1), -1] = True
        near = near[~is_itself].reshape(len(position), count)
        bond = places[near] - centre[:, None]
        return np.repeat(particle, count), bond.reshape(-1, 3)


def _waves(degree: int, bond: NDArray) -> Iterator[NDArray]:
    """Yield exp(i l phi) of bonds in a plane, or else spherical harmonics Y_lm, m = 0 ... l.

    They are scaled so that `_length` is the bond order: values at -m have the same length, and count
    by a factor of sqrt(2).
    """
    length = np.linalg.norm(bond, axis=1, keepdims=True)
    unit = np.divide(bond, length, out=np.zeros(bond.shape), where=length > 0)
    across = unit[:, 0] + 1j * unit[:, 1]
    if bond.shape[1] == 2:
        yield across**degree
        return
    cosine = np.ascontiguousarray(unit[:, 2])
    power = np.ones(len(bond), complex)
    for m in range(degree + 1):
        scale = math.factorial(degree - m) / math.factorial(degree + m)
        if m:
            scale *= 2
        yield math.sqrt(scale) * _legendre(m, degree, cosine) * power
        power *= across


def _legendre(m: int, degree: int, cosine: NDArray) -> NDArray:
    """Return the associated Legendre function P_l^m over sin^m, with the sign (-1)^m.

    From P_m^m up by (l - m) P_l = (2l - 1) cos P_(l-1) - (l + m - 1) P_(l-2), Abramowitz & Stegun
    (1964), 8.5.3.
    """
    below = np.zeros(len(cosine))
    values = np.full(len(cosine), float(math.prod(range(-1, -2 * m, -2))))
    for n in range(m + 1, degree + 1):
        below *= -(n + m - 1) / (n - m)
        below += (2 * n - 1) / (n - m) * cosine * values
        below, values = values, below
    return values


def _length(means: NDArray) -> NDArray:
    return np.sqrt((np.abs(means) ** 2).sum(axis=0))
