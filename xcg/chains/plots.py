"""Pictures of chains."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.chains.results import ChainStep, require_chains, steps_of
from xcg.common.checks import extra
from xcg.common.drawing import add_colour_bar, label_of, new_axes, set_label, with_unit
from xcg.scene.frame import step_at, with_time
from xcg.scene.schema import COMPONENTS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = ("stress", "chain")


def plot_chains(
    fc: xr.Dataset, *, time: int = 0, colour: Literal["stress", "chain"] = "stress", grains: bool = True,
    ax: Axes | None = None,
) -> Axes:  # fmt: skip
    """Draw the chains of one step of a one-layer scene: links over grains, line width by force.

    Parameters
    ----------
    fc : xarray.Dataset
        A result of `force_chains`; its scene has ``dimension=2``.
    time : int
        Which step, by position.
    colour : {"stress", "chain"}
        Of the links: the mean major stress of the two particles of a link, or one colour a chain.
    grains : bool
        Draw the particles; particles of chains are darker.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure by default.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    SceneError
        If `fc` is not a result of `force_chains`.
    ValueError
        If the scene is not of one layer, or an argument is wrong.
    """
    require_chains(fc, "plot_chains")
    if int(fc.attrs.get("dimension", 3)) != 2:
        raise ValueError(
            "plot_chains draws one-layer scenes, and this one has dimension=3; write it with .cg.to_vtp for ParaView"
        )
    if colour not in COLOURS:
        raise ValueError(f"colour={colour!r}: expected one of {COLOURS}")
    collections = extra("matplotlib.collections", "plot", "drawing")
    plane = [COMPONENTS.index(axis) for axis in fc.attrs.get("plane", "xy")]
    step = _step(
        fc, time, ["position", "diameter", "chain_id", "link_chain", "contact_j", "contact_force", "major_stress"]
    )
    arrays = step.arrays
    ax = new_axes() if ax is None else ax
    position, diameter = arrays["position"][:, plane], arrays["diameter"]
    if grains:
        shade = np.where(arrays["chain_id"] >= 0, "0.8", "0.93")
        ax.add_collection(
            collections.EllipseCollection(
                diameter, diameter, np.zeros(len(diameter)), units="xy", offsets=position,
                offset_transform=ax.transData, facecolors=shade, edgecolors="none",
            )
        )  # fmt: skip
    contact, i, branch = _links(step)
    force = np.linalg.norm(arrays["contact_force"][contact], axis=1)
    ends = np.stack([position[i], position[i] + branch[:, plane]], axis=1)
    width = 0.5 + 3 * force / max(force.max(initial=0.0), np.finfo(float).tiny)
    lines = collections.LineCollection(
        list(ends), linewidths=width, capstyle="round", cmap="tab20" if colour == "chain" else "inferno_r"
    )
    if colour == "chain":
        lines.set_array(arrays["link_chain"][contact] % 20)
    else:
        j = step.links()[2]
        lines.set_array(0.5 * (arrays["major_stress"][i] + arrays["major_stress"][j]))
        add_colour_bar(lines, ax, label_of(fc["major_stress"], "major_stress"), shrink=0.8)
    ax.add_collection(lines)
    ax.set_aspect("equal")
    ax.autoscale_view()
    for axis, k in ((ax.xaxis, plane[0]), (ax.yaxis, plane[1])):
        set_label(axis, with_unit(f"${COMPONENTS[k]}$", fc["position"].attrs.get("units", "")))
    return ax


def plot_lengths(fc: xr.Dataset, *, ax: Axes | None = None) -> Axes:
    """Draw P(c), the share of chains that have c particles, of each step (grey) and of all (blue).

    Parameters
    ----------
    fc : xarray.Dataset
        A result of `force_chains`.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure by default.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    SceneError
        If `fc` is not a result of `force_chains`.
    """
    require_chains(fc, "plot_lengths")
    ax = new_axes() if ax is None else ax
    steps = with_time(fc[["length_share", "chain_count"]]).compute()
    steps = steps if "time" in steps.dims else steps.expand_dims("time")
    share, count = steps["length_share"].transpose("time", "length").to_numpy(), steps["chain_count"].to_numpy()
    length = fc["length"].to_numpy()
    for row in share:
        ax.plot(length[row > 0], row[row > 0], ".", ms=4, color="0.75")
    total = count @ share / max(count.sum(), 1)
    ax.plot(length[total > 0], total[total > 0], "o", ms=4, color="C0")
    ax.set_yscale("log")
    set_label(ax.xaxis, "length $c$ [particles]")
    set_label(ax.yaxis, "share of chains $P(c)$")
    return ax


def plot_rose(
    fc: xr.Dataset, *, time: int = 0, bins: int = 36, plane: str | None = None, ax: Axes | None = None
) -> Axes:
    """Draw how the links of one step are directed: a rose, both ways, weighted by force.

    Parameters
    ----------
    fc : xarray.Dataset
        A result of `force_chains`.
    time : int
        Which step, by position.
    bins : int
        Petals, an even number.
    plane : str, optional
        The two axes that directions are projected on; the axes of the layer by default, or "xz" in 3D.
    ax : matplotlib.axes.Axes, optional
        Polar axes; a new figure by default.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    SceneError
        If `fc` is not a result of `force_chains`.
    ValueError
        If an argument is wrong.
    """
    require_chains(fc, "plot_rose")
    if bins < 2 or bins % 2:
        raise ValueError(f"bins={bins!r}: expected an even number of petals, as every link points both ways")
    flat = int(fc.attrs.get("dimension", 3)) == 2
    plane = plane or (fc.attrs.get("plane", "xy") if flat else "xz")
    if len(plane) != 2 or len(set(plane) & set(COMPONENTS)) != 2:
        raise ValueError(f"plane={plane!r}: expected two axes, for example 'xz'")
    step = _step(fc, time, ["position", "link_chain", "contact_j", "contact_force"])
    ax = new_axes("polar") if ax is None else ax
    contact, _, branch = _links(step)
    along, up = (branch[:, COMPONENTS.index(axis)] for axis in plane)
    angle = np.arctan2(up, along) % np.pi
    force = np.linalg.norm(step.arrays["contact_force"][contact], axis=1)
    half, edges = np.histogram(angle, bins // 2, (0, np.pi), weights=force)
    petals = np.tile(half / max(2 * half.sum(), np.finfo(float).tiny), 2)
    middle = 0.5 * (edges[1:] + edges[:-1])
    ax.bar(
        np.concatenate([middle, middle + np.pi]), petals, width=2 * np.pi / bins, color="C3", edgecolor="white", lw=0.5
    )
    ax.set_yticklabels([])
    ax.set_xticks(np.deg2rad([0, 90, 180, 270]), [f"${sign}{axis}$" for sign in ("", "-") for axis in plane])
    return ax


def _step(fc: xr.Dataset, time: int, names: list[str]) -> ChainStep:
    (step,) = steps_of(step_at(fc, time, "time"), names)
    return step


def _links(step: ChainStep) -> tuple[NDArray, NDArray, NDArray]:
    """Contacts of the links, row of their first particle, and nearest image of the vector to the second (m)."""
    contact, i, j = step.links()
    position: Any = step.arrays["position"]
    return contact, i, step.lattice.shortest(position[j] - position[i])
