"""Pair correlation at contact: g(r) of spheres that nearly touch, continued to touching ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr

from xcg.analysis.radial_distribution import RadialDistribution
from xcg.analysis.regions import Bounds
from xcg.common.checks import is_finite
from xcg.common.messages import plain
from xcg.scene.conform import takes_scene
from xcg.scene.lattice import Lattice
from xcg.scene.scene import Scene
from xcg.scene.schema import Frame, Variable
from xcg.steps.analysis import run
from xcg.steps.faults import OnError

BINS = 100  # of a mean diameter


@takes_scene
def contact_value(
    scene: Scene,
    reach: float = 1.2,
    *,
    bounds: Bounds | None = None,
    by: str | None = None,
    groups: Sequence[int] | None = None,
    on_error: OnError = "raise",
) -> xr.Dataset:
    r"""Compute the pair correlation at contact of each step, for collisional flows of spheres.

    Lazy where the scene is. Frozen particles are left out.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with diameters.
    reach : float
        Largest distance that is looked at, over the mean diameter of a pair; in hundredths, at
        least 1.05.
    bounds, by, groups, on_error
        As in `radial_distribution`.

    Returns
    -------
    xarray.Dataset
        ``contact_value`` and its standard error ``contact_value_error`` (time, phase, other_phase).
        NaN where a phase has no pairs.

    Raises
    ------
    SceneError, ValueError
        As `radial_distribution`, or if `reach` is too small.

    Notes
    -----
    A quadratic polynomial in s - 1 is fitted to g(s) between 1 and `reach`, with s the distance
    over the mean diameter of the pair, by least squares weighted with the expected numbers of
    pairs; its value at 1 is returned. Pairs that overlap take no part, so lasting contacts do not
    count. For hard spheres at a volume fraction phi it is about ``(1 - phi/2) / (1 - phi)^3``
    (Carnahan & Starling 1969). The error assumes independent pairs.

    References
    ----------
    Carnahan, N. F., Starling, K. E. (1969). Equation of state for nonattracting rigid spheres. J.
    Chem. Phys. 51.

    Examples
    --------
    >>> import xcg
    >>> ds = xcg.datasets.random_scene(2000)  # random places: spheres overlap freely
    >>> abs(float(ds.cg.contact_value().contact_value[0]) - 1) < 0.2
    True
    """
    if not (is_finite(reach) and 1.05 <= reach <= 10):
        raise ValueError(
            f"reach={plain(reach)}: expected a distance over the mean diameter, from 1.05 to 10"
        )
    bins = round(reach * BINS)
    analysis = ContactValue(
        r_max=bins / BINS, bins=bins, scaled=True, bounds=bounds, by=by, groups=groups, reach=reach
    )
    return run(scene, analysis, on_error=on_error)


@dataclass(frozen=True, kw_only=True)
class ContactValue(RadialDistribution):
    """Pair correlation at contact of a step, see `contact_value`."""

    name = "contact_value"

    reach: float

    def rows(self, scene: Scene) -> dict[str, Variable]:
        """Return the contact value and its error."""
        dims = self.dims_of_pairs
        text = "pair correlation at contact"
        return {
            "contact_value": Variable(dims, "1", text, formula="g(r -> d)"),
            "contact_value_error": Variable(dims, "1", f"standard error of the {text}"),
        }

    def frame(self, frame: Frame, lattice: Lattice, source: str) -> Frame:
        """Fit g(s) of a step."""
        counts, expected = self.pairs(frame, lattice, source)
        beyond = slice(BINS, None)
        middle = (np.arange(self.bins)[beyond] + 0.5) / BINS - 1
        powers = np.stack([middle**n for n in range(3)])
        values, errors = np.full((2, *counts.shape[:2]), np.nan)
        for a, b in np.ndindex(values.shape):
            weight = expected[a, b, 0, beyond]
            if not weight.any():
                continue
            number = counts[a, b, 0, beyond]
            normal = np.linalg.inv(powers * weight @ powers.T)
            values[a, b] = normal[0] @ powers @ number
            # pairs of a phase with itself are counted from both sides, and vary together
            both = np.zeros_like(number)
            if a == b or 0 in (a, b):
                both = counts[max(a, b), max(a, b), 0, beyond]
            errors[a, b] = np.sqrt(((normal[0] @ powers) ** 2 * (number + both)).sum())
        return {
            "contact_value": self.of_pairs(values),
            "contact_value_error": self.of_pairs(errors),
        }
