"""Results of a search for chains: labels, steps, tables and pictures."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from xcg.analysis.particle_stress import RESULTS as STRESSES
from xcg.common.checks import check_choice, extra
from xcg.common.drawing import (
    add_circles,
    add_colour_bar,
    label_of,
    new_axes,
    ratio_of_circles,
    set_label,
    with_unit,
)
from xcg.common.messages import SceneError
from xcg.scene.conform import conform, with_components
from xcg.scene.contacts import Contacts
from xcg.scene.facts import require_facts
from xcg.scene.frame import frame_at, indices_of, particle_rows, step_at, with_time
from xcg.scene.lattice import Lattice
from xcg.scene.scene import Scene
from xcg.scene.schema import BOX, COMPONENTS, CONTACT_VARIABLES, PADDING, VARIABLES, Frame, Variable
from xcg.scene.summary import Summary, rows_of_origin
from xcg.steps.mapping import each_step

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Color: TypeAlias = Literal["stress", "chain"]
# variables that links follow from, besides the ids
_OF_LINKS = ("link_chain", "contact_j", "contact_force")
_OF_CONTACTS = (*CONTACT_VARIABLES[:-1], "contact_force")
COPIED = ("particle_id", "position", "diameter", "contact_i", "contact_j", "contact_force")


# from the lengths of the chains of one step, an array (chains,) of at least one
_OF_LENGTHS: dict[str, tuple[str, Callable[[NDArray], Any]]] = {
    "length_mean": ("mean length of the chains (particles)", np.mean),
    "length_median": ("median length of the chains (particles)", np.median),
    "length_min": ("shortest chain (particles)", np.min),
    "length_max": ("longest chain (particles)", np.max),
}
STATISTICS: dict[str, Variable] = {
    "chain_count": Variable((), "1", "number of chains", "int64"),
    **{name: Variable((), "1", long_name) for name, (long_name, _) in _OF_LENGTHS.items()},
    "length_share": Variable(("length",), "1", "share of the chains that have this length, P(c)"),
}
CHAINS: dict[str, Variable] = {
    "chain_particles": Variable(("chain",), "1", "length of the chain: its particles", "int64"),
    "chain_links": Variable(("chain",), "1", "links of the chain", "int64"),
    "chain_branchings": Variable(("chain",), "1", "branching points of the chain", "int64"),
    "chain_stress": Variable(("chain",), "Pa", "mean major stress of the chain's particles"),
    "chain_orientation": Variable(
        ("chain", "component"), "1", "axis of the chain's largest extent"
    ),
    "chain_normal": Variable(("chain", "component"), "1", "normal of the chain's best-fit plane"),
}
MEMBERS: dict[str, Variable] = {
    "chain_id": Variable(("particle",), "1", "chain of the particle, -1 for none", "int64"),
    "parent_id": Variable(
        ("particle",), "1", "id of the particle it was reached from, -1 for a seed", "int64"
    ),
    "links": Variable(("particle",), "1", "links of the particle", "int64"),
    "branching": Variable(
        ("particle",), "1", "1 where the particle has more than two links", "int64"
    ),
    "link_chain": Variable(
        ("contact",), "1", "chain that the contact is a link of, -1 for none", "int64"
    ),
}
RESULTS: dict[str, Variable] = (
    {name: VARIABLES[name] for name in COPIED}
    | MEMBERS
    | {name: row for name, row in STRESSES.items() if name not in ("particle_id", "stress")}
    | CHAINS
    | STATISTICS
)


def result_sizes(particles: int, contacts: int, min_length: int) -> dict[str, int]:
    """Sizes of the dimensions of a result: as many chains, and as long ones, as there could be, but at least one."""
    chains = max(1, particles // min_length)
    lengths = max(1, particles - min_length + 1)
    return {"particle": particles, "contact": contacts, "chain": chains, "length": lengths}


def statistics_of(lengths: NDArray, min_length: int, bins: int) -> dict[str, NDArray | float]:
    """Statistics of the lengths of the chains of one step, by the names in `STATISTICS`; NaN without chains."""
    count = len(lengths)
    statistics: dict[str, NDArray | float] = dict.fromkeys(_OF_LENGTHS, np.nan)
    if count:
        statistics = {name: compute(lengths) for name, (_, compute) in _OF_LENGTHS.items()}
    shares = np.bincount(lengths - min_length, minlength=bins)[:bins] / max(count, 1)
    return statistics | {"chain_count": count, "length_share": shares}


def require_chains(fc: xr.Dataset, purpose: str, *, whole: Sequence[str] = ()) -> None:
    """Raise SceneError unless a Dataset is a result of `force_chains`, whole along some dimensions.

    Raises
    ------
    SceneError
        If it lacks ``chain_id`` or ``link_chain``, parts of it, or its attributes; the message says
        what to do.
    """
    missing = [name for name in ("chain_id", "link_chain", "particle_id") if name not in fc]
    if missing:
        raise SceneError(
            f"{purpose} needs {missing}, which this Dataset does not hold; call it on a result of ds.cg.force_chains()"
        )
    require_facts(
        fc,
        ("periodic", "dimension", "min_length"),
        "this result of force_chains",
        "or call force_chains again",
    )
    full = result_sizes(fc.sizes.get("particle", 1), 0, int(fc.attrs["min_length"]))
    sizes = full | dict(fc.sizes)
    is_part = {"chain": sizes["chain"] < full["chain"], "length": sizes["length"] != full["length"]}
    if any(is_part[dim] for dim in whole):
        raise SceneError(
            f"{purpose} needs all particles and chains of a step, and this Dataset holds a part of them: select chains "
            "by fc.cg.select_chains(...), steps by fc.isel(time=...)"
        )


def summary_of_chains(fc: xr.Dataset) -> Summary:
    """Return a summary of a result of `force_chains`, without computing it."""
    fc = with_time(fc)
    words = {"time": "steps", "particle": "particles", "contact": "contacts"}
    sizes = ", ".join(f"{fc.sizes[dim]} {word}" for dim, word in words.items() if dim in fc.sizes)
    options = ("alpha", "min_length", "algorithm")
    rule = ", ".join(f"{name} = {fc.attrs[name]}" for name in options if name in fc.attrs)
    kinds = (("particles", MEMBERS), ("chains", CHAINS), ("steps", STATISTICS))
    held = [(what, ", ".join(name for name in table if name in fc)) for what, table in kinds]
    return Summary.of(
        f"force chains of {sizes} (largest step)", [("rule", rule), *held, *rows_of_origin(fc)]
    )


@dataclass(frozen=True, eq=False)
class ChainStep:
    """Single step of a result, in memory.

    Attributes
    ----------
    arrays : Frame
        Variables by name, without padding (by chain: row k is chain k).
    time : float
        Time (s).
    number : int
        Number of the time step.
    lattice : Lattice
        Periodic images.
    """

    arrays: Frame
    time: float
    number: int
    lattice: Lattice

    def links(self) -> tuple[NDArray, NDArray, NDArray]:
        """Contact rows of the links, and the rows of the two particles of each."""
        contact = np.flatnonzero(self.arrays["link_chain"] >= 0)
        ids = self.arrays["particle_id"]
        i = indices_of(ids, self.arrays["contact_i"][contact])
        j = indices_of(ids, self.arrays["contact_j"][contact])
        return contact, i, j


def steps_of(fc: xr.Dataset, names: Sequence[str]) -> Iterator[ChainStep]:
    """Yield the steps of a result one after the other, each chunk of time computed once."""
    fc = _with_dimension_of_time(with_components(fc))
    names = [*dict.fromkeys(("particle_id", "contact_i", *names))]
    of_box = [name for name in BOX if name in fc]
    dims = {name: RESULTS[name].dims for name in names} | {name: BOX[name].dims for name in of_box}
    for t, chunk in enumerate(each_step(fc[[*names, *of_box]])):
        step = chunk.isel(time=0)
        arrays = {name: step[name].transpose(*dims[name]).to_numpy() for name in dims}
        box = {name: arrays.pop(name) for name in of_box}
        kept = {
            "particle": particle_rows(arrays["particle_id"]),
            "contact": arrays["contact_i"] != PADDING,
        }
        for name in names:
            if dims[name][0] in kept:
                arrays[name] = arrays[name][kept[dims[name][0]]]
        number = int(step.coords.get("step", t))
        lattice = Lattice.of(box, fc.attrs.get("periodic", ""), f"step {number}")
        yield ChainStep(arrays, float(step.coords.get("time", 0.0)), number, lattice)


def _with_dimension_of_time(fc: xr.Dataset) -> xr.Dataset:
    """Return a single step as a series of one."""
    fc = with_time(fc)
    if "time" in fc.dims:
        return fc
    return fc.expand_dims("time")


def chain_table(fc: xr.Dataset) -> pd.DataFrame:
    """Return the table of all chains (computes, one step at a time).

    Parameters
    ----------
    fc : xarray.Dataset
        A result of `force_chains`, of one step or several.

    Returns
    -------
    pandas.DataFrame
        One row a chain and step: ``time``, ``step``, ``chain``, ``particles``, ``links``,
        ``branchings``, ``stress`` (Pa), ``orientation_x`` ... and ``normal_x`` ....

    Raises
    ------
    SceneError
        If `fc` is not a result of `force_chains`, or has no step.
    """

    def columns(step: ChainStep) -> dict[str, NDArray]:
        chain = np.flatnonzero(step.arrays["chain_particles"] > 0)
        table = {"chain": chain}
        for name, row in CHAINS.items():
            values = step.arrays[name][chain]
            short = name.removeprefix("chain_")
            if "component" in row.dims:
                table |= {f"{short}_{axis}": values[:, k] for k, axis in enumerate(COMPONENTS)}
            else:
                table[short] = values
        return table

    return _table(fc, "chain_table", list(CHAINS), columns)


def link_table(fc: xr.Dataset) -> pd.DataFrame:
    """Return the table of all links (computes, one step at a time).

    Parameters
    ----------
    fc : xarray.Dataset
        A result of `force_chains`, of one step or several.

    Returns
    -------
    pandas.DataFrame
        One row a link and step: ``time``, ``step``, ``chain``, ``contact`` (its row among the
        contacts of the step), ``particle_i`` and ``particle_j`` (ids), ``force`` (magnitude, N) and
        ``stress`` (mean major stress of the two particles, Pa).

    Raises
    ------
    SceneError
        If `fc` is not a result of `force_chains`, or has no step.
    """

    def columns(step: ChainStep) -> dict[str, NDArray]:
        contact, i, j = step.links()
        arrays = step.arrays
        return {
            "chain": arrays["link_chain"][contact],
            "contact": contact,
            "particle_i": arrays["contact_i"][contact],
            "particle_j": arrays["contact_j"][contact],
            "force": np.linalg.norm(arrays["contact_force"][contact], axis=1),
            "stress": 0.5 * (arrays["major_stress"][i] + arrays["major_stress"][j]),
        }

    return _table(fc, "link_table", [*_OF_LINKS, "major_stress"], columns)


def _table(
    fc: xr.Dataset,
    purpose: str,
    names: Sequence[str],
    columns: Callable[[ChainStep], dict[str, NDArray]],
) -> pd.DataFrame:
    """Join the columns of all steps below each other, with time and number of the step."""
    require_chains(fc, purpose)
    if not fc.sizes.get("time", 1):
        raise SceneError(
            f"{purpose} needs one step or more, and these chains have none: check how steps were selected"
        )
    steps = steps_of(fc, names)
    tables = [
        pd.DataFrame({"time": step.time, "step": step.number, **columns(step)}) for step in steps
    ]
    return pd.concat(tables, ignore_index=True)


# --- pictures --------------------------------------------------------------------------------------------


def plot_chains(
    fc: xr.Dataset,
    *,
    index: int = -1,
    color: Color = "stress",
    grains: bool = True,
    ax: Axes | None = None,
) -> Axes:
    """Draw the chains of one step of a one-layer scene: links over grains, line width by force.

    Parameters
    ----------
    fc : xarray.Dataset
        A result of `force_chains`; its scene has ``dimension=2``.
    index : int
        Position of the step in time; the last one by default.
    color : {"stress", "chain"}
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
    check_choice("color", color, Color)
    collections = extra("matplotlib.collections", "plot", "drawing")
    plane = [COMPONENTS.index(axis) for axis in fc.attrs.get("plane", "xy")]
    names = ["position", "diameter", *_OF_LINKS, "chain_id", "major_stress"]
    (step,) = steps_of(step_at(fc, index), names)
    arrays = step.arrays
    position = arrays["position"][:, plane]
    diameter = arrays["diameter"]
    ax = ax or new_axes(ratio=ratio_of_circles(position, diameter / 2))
    if grains:
        shade = np.where(arrays["chain_id"] >= 0, "0.8", "0.93")
        add_circles(ax, position, diameter / 2, facecolors=shade, edgecolors="none")
    contact, i, j, branch = _links(step)
    force = np.linalg.norm(arrays["contact_force"][contact], axis=1)
    ends = np.stack([position[i], position[i] + branch[:, plane]], axis=1)
    width = 0.5 + 3 * force / max(force.max(initial=0.0), np.finfo(float).tiny)
    lines = collections.LineCollection(list(ends), linewidths=width, capstyle="round")
    if color == "chain":
        lines.set_cmap("tab20")
        lines.set_array(arrays["link_chain"][contact] % 20)
    else:
        stress = 0.5 * (arrays["major_stress"][i] + arrays["major_stress"][j])
        lines.set_cmap("inferno_r")
        lines.set_array(stress)
        label = label_of(fc["major_stress"], "major_stress")
        add_colour_bar(lines, ax, label, stress, shrink=0.8)
    ax.add_collection(lines)
    ax.set_aspect("equal")
    ax.autoscale_view()
    unit = fc["position"].attrs.get("units", "")
    across, up = plane
    set_label(ax.xaxis, with_unit(f"${COMPONENTS[across]}$", unit))
    set_label(ax.yaxis, with_unit(f"${COMPONENTS[up]}$", unit))
    return ax


def plot_rose(
    fc: xr.Dataset,
    *,
    index: int = -1,
    bins: int = 36,
    plane: str | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the rose diagram of one step: how contacts or links of chains are directed, weighted by force.

    Each contact counts both ways. Contacts of a scene are directed along their normals, contacts with
    walls included, and links of chains from centre to centre.

    Parameters
    ----------
    fc : xarray.Dataset
        A scene with contact forces, or a result of `force_chains`.
    index : int
        Position of the step in time; the last one by default.
    bins : int
        Petals, an even number.
    plane : str, optional
        The two axes that directions are projected on; the axes of the layer by default, or "xz" in
        3D.
    ax : matplotlib.axes.Axes, optional
        Polar axes; a new figure by default.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    SceneError
        If `fc` is a scene without contact forces, or neither a scene nor a result of
        `force_chains`.
    ValueError
        If an argument is wrong.
    """
    if "particle_id" in fc and "chain_id" not in fc:
        fc = conform(fc)
        Scene(fc).require(_OF_CONTACTS, "plot_rose")
    else:
        require_chains(fc, "plot_rose")
    if bins < 2 or bins % 2:
        raise ValueError(
            f"bins={bins!r}: expected an even number of petals, as every link points both ways"
        )
    is_layer = int(fc.attrs.get("dimension", 3)) == 2
    if plane is None:
        plane = "xz"
        if is_layer:
            plane = str(fc.attrs.get("plane", "xy"))
    if len(plane) != 2 or len(set(plane) & set(COMPONENTS)) != 2:
        raise ValueError(f"plane={plane!r}: expected two axes, for example 'xz'")
    direction, force = _directions(fc, index)
    ax = ax or new_axes("polar")
    along, up = direction[:, [COMPONENTS.index(axis) for axis in plane]].T
    angle = np.arctan2(up, along) % np.pi
    half, edges = np.histogram(angle, bins // 2, (0, np.pi), weights=force)
    petals = np.tile(half / max(2 * half.sum(), np.finfo(float).tiny), 2)
    middle = 0.5 * (edges[1:] + edges[:-1])
    ax.bar(
        np.concatenate([middle, middle + np.pi]),
        petals,
        width=2 * np.pi / bins,
        color="C3",
        edgecolor="white",
        lw=0.5,
    )
    ax.set_yticklabels([])
    ax.set_xticks(
        np.deg2rad([0, 90, 180, 270]), [f"${sign}{axis}$" for sign in ("", "-") for axis in plane]
    )
    return ax


def _directions(fc: xr.Dataset, index: int) -> tuple[NDArray, NDArray]:
    """Return directions (n, 3) of the contacts of a scene or of the links of chains, and their forces (n,)."""
    if "chain_id" in fc:
        (step,) = steps_of(step_at(fc, index), ["position", *_OF_LINKS])
        contact, _, _, branch = _links(step)
        return branch, np.linalg.norm(step.arrays["contact_force"][contact], axis=1)
    names = ["particle_id", *_OF_CONTACTS, "contact_normal"]
    frame, lattice, source = frame_at(fc, index, [name for name in names if name in fc])
    contacts = Contacts.of(frame, lattice, source)
    return contacts.normal, np.linalg.norm(contacts.force, axis=1)


def _links(step: ChainStep) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Contacts of the links, rows of their two particles, and nearest image of the vector between these (m)."""
    contact, i, j = step.links()
    position = step.arrays["position"]
    return contact, i, j, step.lattice.shortest(position[j] - position[i])
