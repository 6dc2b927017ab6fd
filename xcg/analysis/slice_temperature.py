"""Granular temperature in slices, overlapping planes or bins, as it was published: coarser than `xcg.coarse_grain`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, Self, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.checks import POSITIVE, check, check_choice, rising_pair, whole
from xcg.common.messages import SceneError
from xcg.fields.grids.grid import warn_beyond
from xcg.scene.conform import takes_scene
from xcg.scene.frame import without_frozen
from xcg.scene.lattice import Lattice
from xcg.scene.scene import Scene
from xcg.scene.schema import COMPONENTS, Frame, Variable
from xcg.steps.analysis import FrameAnalysis, run
from xcg.steps.faults import OnError
from xcg.steps.labels import call_of, place_along

_HAIR = 1e-9  # rounding of edges, as a share of the width
_MOST_PERIODS = 1000  # that a grain may reach over
_MOST = 1 << 20  # planes of all slices, each a step of a loop
SliceMethod: TypeAlias = Literal["planes", "bins"]
_WEIGHTS = {"planes": "diameter", "bins": "mass"}


@takes_scene
def slice_temperature(
    scene: Scene,
    axis: str = "z",
    *,
    method: SliceMethod = "planes",
    width: float | None = None,
    spacing: float | None = None,
    bounds: Sequence[float] | None = None,
    planes: int = 5,
    on_error: OnError = "raise",
) -> xr.Dataset:
    """Granular temperature and velocity in slices across an axis, lazy where the scene is; without frozen grains.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with ``velocity``, and ``diameter`` (planes) or ``mass`` (bins).
    axis : str
        The axis that slices follow each other along.
    method : {"planes", "bins"}
        "planes": slices overlap, each holds ``2 planes + 1`` planes; on plane m a grain weighs by
        the area ``A_im`` of its cut, ``V_m = S A_im v_i / S A_im``, and the slice takes ``T = S_m
        w_m S_i A_im |v_i - V_m|^2 / (D S_m w_m S_i A_im)`` with weights ``w_m = 1 - |m| / (planes +
        1)``. Both sums of T are over the planes that cut two grains or more; one grain has no
        fluctuation about itself. After Zhang & Kamrin (2017). "bins": slices touch, a grain belongs to the one that
        holds its centre, ``T = S m_i |v_i - V|^2 / (D S m_i)`` about the velocity V of the bin, as
        LAMMPS computes it by chunks.
    width : float, optional
        Thickness of a slice (m), d43 by default.
    spacing : float, optional
        Distance of centres (m): half the width for planes; bins touch and take none.
    bounds : two floats, optional
        First and last centre for planes, edges of the first and last bin for bins (m). By default
        the edges of the box (of the first step) along a periodic axis, else the extent of the
        grains. Along a periodic axis every image of a grain counts, wherever its position is
        written.
    planes : int
        Planes on each side of a slice's centre.
    on_error : {"raise", "skip"}
        What to do about a step that cannot be read or computed: stop with its error, or leave it
        NaN, warn of it, and mark it in the coordinate ``skipped`` (time).

    Returns
    -------
    xarray.Dataset
        ``granular_temperature`` (time, axis) in m2 s-2, ``velocity`` (time, axis, component) in m
        s-1, and ``sample_count`` (time, axis), the grains in each slice. The temperature is NaN for
        slices with fewer than two (on one plane, for planes), the velocity for empty ones.

    Raises
    ------
    SceneError
        If the scene lacks what the method needs.
    ValueError
        If an argument is wrong.
    """
    call = call_of("slice_temperature", locals())
    check_choice("method", method, SliceMethod)
    if method == "bins" and spacing is not None:
        raise ValueError(
            f"spacing={spacing!r}: bins touch, and take their width=; leave spacing= out, or take planes"
        )
    scene.require(("velocity", _WEIGHTS[method]), "slice_temperature")
    setup = scene.setup
    setup.check_axis(axis)
    k = COMPONENTS.index(axis)
    fitted = None
    if width is None:
        width = scene.sizes.get("d43", np.nan)
    if bounds is None and axis in setup.periodic:
        bounds = scene.edges.get(axis)
    elif bounds is None and scene.corners is not None:
        bounds = fitted = scene.corners[0][k], scene.corners[1][k]
    check("width", width, POSITIVE, "m", hint="; by default it is d43, from ds.cg.measure()")
    check("spacing", spacing, POSITIVE, "m", optional=True)
    check("planes", planes, whole(0))
    low, high = rising_pair("bounds", bounds, equal=True)
    if method == "bins":
        count = max(1, _number(np.ceil((high - low) / width - 1e-9)))
        nodes = low + float(width) * (np.arange(count) + 0.5)
    else:
        distance = float(spacing or width / 2)
        count = _number((high - low) / distance + 1e-9, 2 * planes + 1) + 1
        nodes = low + distance * np.arange(count)
    analysis = _Slices(axis, method, float(width), nodes, low, int(planes), fitted)
    return run(scene, analysis, call=call, on_error=on_error)


def _number(count: float, planes: int = 1) -> int:
    """Whole number of slices, refused before anything is made for too many."""
    if not (count + 1) * planes < _MOST:
        raise ValueError(
            f"{count + 1:.3g} slices of {planes} planes are more than {_MOST} planes: choose larger or fewer ones"
        )
    return int(count)


@dataclass(frozen=True, eq=False)
class _Slices(FrameAnalysis):
    """Temperature and velocity in slices across an axis.

    Attributes
    ----------
    nodes : array (n,)
        Centres of the slices (m).
    low : float
        Lower bound of the slices (m).
    planes : int
        Planes on each side of a centre.
    fitted : tuple of float, optional
        Extent of the grains (m), where the slices follow from it.
    """

    name = "slice_temperature"
    optional = ("frozen",)

    axis: str
    method: SliceMethod
    width: float
    nodes: NDArray
    low: float
    planes: int
    fitted: tuple[float, float] | None

    def reads(self, scene: Scene) -> list[str]:
        """Return the velocity, and what grains weigh by."""
        return ["position", "velocity", _WEIGHTS[self.method]]

    def rows(self, scene: Scene) -> dict[str, Variable]:
        """Return temperature, velocity and number of grains in each slice."""
        return {
            "granular_temperature": Variable(
                (self.axis,), "m^2 s^-2", f"granular temperature in slices ({self.method})"
            ),
            "velocity": Variable((self.axis, "component"), "m s^-1", "velocity of the slice"),
            "sample_count": Variable((self.axis,), "1", "number of particles in the slice"),
        }

    def coords(self, scene: Scene) -> dict[str, xr.Variable]:
        """Return the centres of the slices."""
        return {self.axis: place_along(self.axis, self.nodes, self.setup.unit_system)}

    def attrs(self, scene: Scene) -> dict[str, Any]:
        """Return thickness and method."""
        return {"slice_width": self.width, "method": self.method}

    def prepare(self, scene: Scene) -> Self:
        """Leave out images along the slices, unless the box is tilted and shifts images across them."""
        if scene.tilted:
            return self
        periodic = self.axis if self.axis in self.setup.periodic else ""
        return replace(self, setup=replace(self.setup, periodic=periodic))

    def frame(self, frame: Frame, lattice: Lattice, source: str) -> dict[str, NDArray]:
        """Compute temperature, velocity and count in the slices of one step."""
        some = without_frozen(frame)
        k = COMPONENTS.index(self.axis)
        along = np.arange(3) == k
        lattice = lattice.seen(along, source)
        position = some["position"]
        velocity = some["velocity"]
        weight = some[_WEIGHTS[self.method]]
        grain = np.arange(len(position))
        if self.fitted is not None:
            warn_beyond(self.axis, position[:, k], *self.fitted, source)
        # every image stands for itself, as its velocity may be another
        if lattice.vectors is not None:
            # the ends of the first and the last slice; the last edge is the first over again
            hair = _HAIR * self.width
            first = self.low - hair
            last = self.low + len(self.nodes) * self.width - 2 * hair
            if self.method == "planes":
                reach = 0.5 * weight.max(initial=0.0)
                first = self.nodes[0] - self.width / 2 - reach
                last = self.nodes[-1] + self.width / 2 + reach
            low = np.where(along, first, -np.inf)
            high = np.where(along, last, np.inf)
            grain, shift, drift = lattice.images(position, low, high, source)
            position = position[grain] + shift
            velocity = velocity[grain] + drift
            weight = weight[grain]
        of_method = {"bins": _bins, "planes": _planes}[self.method]
        period = float(lattice.period[k])
        out = of_method(self, position[:, k], velocity, weight, grain, period)
        return {
            "granular_temperature": out[:, 0],
            "velocity": out[:, 1:4],
            "sample_count": out[:, 4],
        }


def _images_between(x: NDArray, low: float, high: float, period: float) -> NDArray:
    """Count the images of coordinates that lie in [low, high): 0 or 1 each without a period."""
    if not np.isfinite(period):
        return ((low <= x) & (x < high)).astype(float)
    return np.ceil((high - x) / period) - np.ceil((low - x) / period)


def _bins(
    slices: _Slices, x: NDArray, velocity: NDArray, mass: NDArray, grain: NDArray, period: float
) -> NDArray:
    """Return temperature, velocity and count (slices, 5) by the centres of grains."""
    low = slices.low
    width = slices.width
    dims = slices.setup.axes  # temperatures are a mean over these
    nodes = slices.nodes
    out = np.full((len(nodes), 5), np.nan)
    hair = _HAIR * width  # edges are known to rounding only
    for k in range(len(nodes)):
        end = -hair
        if k == len(nodes) - 1 and not np.isfinite(period):
            end = hair  # the last edge belongs to the last bin, unless it is the first over again
        images = _images_between(x, low + k * width - hair, low + (k + 1) * width + end, period)
        here = images > 0
        m = (images * mass)[here]
        v = velocity[here]
        out[k, 4] = len(np.unique(grain[here]))
        if len(m):
            out[k, 1:4] = (m @ v) / m.sum()
        if len(m) > 1:
            out[k, 0] = (m @ (v - out[k, 1:4])[:, dims] ** 2).sum() / (len(dims) * m.sum())
    return out


def _planes(
    slices: _Slices,
    x: NDArray,
    velocity: NDArray,
    diameter: NDArray,
    original: NDArray,
    period: float,
) -> NDArray:
    """Return temperature, velocity and count (slices, 5) by the cuts of grains with planes."""
    width = slices.width
    sides = slices.planes
    dims = slices.setup.axes  # temperatures are a mean over these
    count = len(x)
    radius = diameter / 2
    grain = np.arange(count)
    reach = radius.max(initial=0.0)
    if not reach < _MOST_PERIODS * period:
        raise SceneError(
            f"a grain of diameter {2 * reach:.3g} m reaches over more than {_MOST_PERIODS} periods of {period:.3g} m"
        )
    # planes and grains are taken to [0, period), and images as far as grains reach beyond it
    if np.isfinite(period):
        images = period * np.arange(-np.ceil(reach / period), np.ceil(reach / period) + 1)
        grain = np.tile(grain, len(images))
        x = (np.mod(x, period) + images[:, None]).ravel()
    order = np.argsort(x)
    grain = grain[order]
    x = x[order]
    velocity = velocity[grain]
    radius = radius[grain]
    out = np.full((len(slices.nodes), 5), np.nan)
    shifts = np.arange(-sides, sides + 1)
    for k, node in enumerate(slices.nodes):
        total = 0.0
        energy = 0.0
        momentum = np.zeros(3)
        is_cut = np.zeros(count, bool)
        shared = 0.0
        for m in shifts:
            plane = node + m * width / (2 * max(sides, 1))
            share = 1 - abs(m) / (sides + 1)
            if np.isfinite(period):
                plane = np.mod(plane, period)
            near = slice(*np.searchsorted(x, (plane - reach, plane + reach)))
            area = np.pi * np.maximum(radius[near] ** 2 - (x[near] - plane) ** 2, 0.0)
            if not area.sum() > 0:
                continue
            is_cut[grain[near][area > 0]] = True
            v = velocity[near]
            mean = (area @ v) / area.sum()
            momentum += share * area.sum() * mean
            total += share * area.sum()
            if (area > 0).sum() > 1:  # one grain has no fluctuation about itself
                energy += share * (area @ (v - mean)[:, dims] ** 2).sum()
                shared += share * area.sum()
        out[k, 4] = len(np.unique(original[is_cut]))
        if total > 0:
            out[k, 1:4] = momentum / total
        if shared > 0:
            out[k, 0] = energy / (len(dims) * shared)
    return out
