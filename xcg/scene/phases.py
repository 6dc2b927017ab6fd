"""Phases: groups of grains by size and density, found by clustering or said by edges or types.

A phase is an integer variable of the particles, ``phase`` = 1, 2, ...; ``coarse_grain(by="phase")``
divides by it. It follows from each grain's own properties, not from its row, so that grains may
enter and leave.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.checks import check, extra, floats, is_whole, whole
from xcg.common.drawing import label_of, layout, set_label
from xcg.common.messages import SceneError, plain, warn_user
from xcg.scene.conform import takes_scene
from xcg.scene.frame import step_at
from xcg.scene.scene import Scene
from xcg.scene.schema import PADDING, mark_measured

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Of a single normal or uniform distribution cut in two or more, silhouettes stay below 0.65, of a
# lognormal one whose ln d has a standard deviation of 0.6 below 0.68; two sizes that differ by four
# standard deviations reach 0.7, by five 0.76.
MIN_SILHOUETTE = 0.7
# Spreads below this share of the mean are noise, such as densities that were computed from
# single-precision masses.
NOISE = 1e-3
MAX_GRAINS = 20_000
MAX_SILHOUETTES = 3_000


@takes_scene
def find_phases(scene: Scene, max_phases: int = 8, *, steps: int = 5, seed: int = 0) -> xr.Dataset:
    """Find phases as clusters of (diameter, density) (computes some steps).

    k-means for 2 to `max_phases` clusters on standardised diameters and densities; the number with
    the best mean silhouette is taken, or one phase where even that stays below 0.7: a single
    distribution that is not very wide stays whole. Sources: Lloyd (1982); Rousseeuw (1987).

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with ``diameter`` and ``density``.
    max_phases : int
        Most clusters that are tried.
    steps : int
        Steps that are read, evenly over the series, the first and the last among them. Grains of
        other steps are assigned to the nearest cluster when they are read.
    seed : int
        Seed of k-means and of the samples.

    Returns
    -------
    xarray.Dataset
        The scene with ``phase`` (time, particle), lazy where the scene is: 1, 2, ... in the order
        of diameter and density, -1 for padding. Attributes: ``phase_values``, ``phase_diameter``
        (m) and ``phase_density`` (kg m-3) of the clusters, ``phase_scores`` (mean silhouette for 2,
        3, ... clusters).

    Raises
    ------
    SceneError
        If the scene lacks diameters or densities, or holds no grains.
    ValueError
        If `max_phases` or `steps` is less than 1.
    """
    scene.require(("diameter", "density"), "find_phases")
    ds = scene.ds
    check("max_phases", max_phases, whole(1))
    check("steps", steps, whole(1))
    count = ds.sizes["time"]
    some = np.unique(np.linspace(0, count - 1, min(int(steps), count)).round().astype(int))
    read = ds[["diameter", "density"]].isel(time=some).compute()
    properties = np.stack(
        [read[name].to_numpy().ravel() for name in ("diameter", "density")], axis=1
    )
    properties = properties[np.isfinite(properties).all(axis=1)]
    if not len(properties):
        raise SceneError(
            f"find_phases: no grains in steps {some.tolist()}; give phases by assign_phases(edges=[...])"
        )
    mean = properties.mean(axis=0)
    scale = np.maximum(properties.std(axis=0), NOISE * np.abs(mean))
    labels, scores = _cluster((properties - mean) / scale, int(max_phases), seed)
    centres = np.array([properties[labels == k].mean(axis=0) for k in np.unique(labels)])
    centres = centres[np.lexsort((centres[:, 1], centres[:, 0]))]
    nearest = partial(_nearest, centres=centres, scale=scale)
    assigned = _by_properties(
        ds,
        ("diameter", "density"),
        nearest,
        "nearest (diameter, density)",
        range(1, len(centres) + 1),
    )
    return assigned.assign_attrs(
        phase_diameter=centres[:, 0], phase_density=centres[:, 1], phase_scores=np.array(scores)
    )


def _warn_of_empty(edges: NDArray, attrs: Mapping[Any, Any]) -> None:
    """Warn where an edge leaves all grains on one side, by the smallest and largest diameters as measured."""
    if not {"dmin", "dmax"} <= set(attrs):
        return
    smallest = float(attrs["dmin"])
    largest = float(attrs["dmax"])
    if beyond := [edge for edge in edges.tolist() if not smallest < edge <= largest]:
        warn_user(
            f"edges={beyond}: outside the diameters that were measured, {smallest:.6g} to {largest:.6g}, so that a "
            "phase has no grains; check the unit of the edges"
        )


@takes_scene
def assign_phases(
    scene: Scene,
    *,
    edges: Sequence[float] | None = None,
    mapping: Mapping[int, int] | None = None,
    by: str = "species",
) -> xr.Dataset:
    """Group grains into phases by size or by type.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene.
    edges : sequence of float, optional
        Diameters (m) between phases, rising: phase 1 below the first, phase 2 from the first to the
        second, ...
    mapping : mapping, optional
        From values of `by` to phases, for example ``{1: 1, 2: 1, 3: 2}``.
    by : str
        The integer variable of the particles that `mapping` is from.

    Returns
    -------
    xarray.Dataset
        The scene with ``phase`` (time, particle), lazy where the scene is, and the attribute
        ``phase_values``.

    Raises
    ------
    SceneError
        If the scene lacks what is asked for, or a grain has a type that is not in the mapping.
    ValueError
        Unless one of `edges` and `mapping` is given, or if edges do not rise.
    """
    ds = scene.ds
    if (edges is None) == (mapping is None):
        raise ValueError(
            "assign_phases takes one of edges=[...] (diameters between phases) and mapping={type: phase}"
        )
    if edges is not None:
        if by != "species":
            raise ValueError(
                f"by={by!r}: edges= are between diameters, and by= goes with mapping=; leave it out"
            )
        scene.require(("diameter",), "assign_phases")
        rising = floats(edges)
        if rising.ndim != 1 or not np.isfinite(rising).all() or not (np.diff(rising) > 0).all():
            raise ValueError(
                f"edges={plain(edges)}: expected diameters (m) that rise, such as [0.002, 0.004]"
            )
        _warn_of_empty(rising, ds.attrs)
        number = partial(np.digitize, bins=np.append(-np.inf, rising))
        return _by_properties(
            ds, ("diameter",), number, f"between {rising.tolist()}", range(1, len(rising) + 2)
        )
    scene.require((by,), "assign_phases")
    phase_of_value = mapping or {}
    are_whole = [
        is_whole(value, -(2**63), 2**63 - 1) and is_whole(phase, 0, 2**63 - 1)
        for value, phase in phase_of_value.items()
    ]
    if not phase_of_value or not all(are_whole):
        raise ValueError(
            f"mapping={plain(mapping)}: expected whole numbers of 64 bits, phases not negative, for example "
            "{1: 1, 2: 1, 3: 2}"
        )
    table = {int(value): int(phase) for value, phase in phase_of_value.items()}
    return _by_properties(
        ds, (by,), partial(_mapped, table=table, name=by), f"from {by} by {table}", table.values()
    )


@takes_scene
def plot_phases(scene: Scene, index: int = -1) -> Figure:
    """Draw the clusters of one step and the scores of `find_phases` (computes).

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with ``diameter``, ``density`` and ``phase``, such as one from `find_phases`, which has scores.
    index : int
        Position of the step, by default the last one.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    SceneError
        If the scene lacks sizes, densities or phases.
    ValueError
        If the step does not exist.
    """
    scene.require(("diameter", "density", "phase"), "plot_phases")
    ds = scene.ds
    frame = step_at(ds[["diameter", "density", "phase"]], index).compute()
    scores = np.atleast_1d(ds.attrs.get("phase_scores", []))
    plt = extra("matplotlib.pyplot", "plot", "drawing")
    columns, width = 1, 5
    if len(scores):
        columns, width = 2, 9
    figure, axes = plt.subplots(1, columns, figsize=(width, 4), layout=layout(), squeeze=False)
    left = axes[0, 0]
    for value in np.atleast_1d(ds.attrs["phase_values"]):
        here = frame["phase"].to_numpy() == value
        left.scatter(
            frame["diameter"].to_numpy()[here],
            frame["density"].to_numpy()[here],
            s=8,
            label=f"{value}",
        )
    if "phase_diameter" in ds.attrs:
        left.plot(ds.attrs["phase_diameter"], ds.attrs["phase_density"], "k+", ms=12)
    set_label(left.xaxis, label_of(ds["diameter"], "diameter"))
    set_label(left.yaxis, label_of(ds["density"], "density"))
    left.legend(title="phase")
    if len(scores):
        right = axes[0, 1]
        right.plot(np.arange(2, 2 + len(scores)), scores, "o-")
        right.axhline(MIN_SILHOUETTE, color="0.6", ls=":")
        right.set(xlabel="clusters", ylabel="mean silhouette", ylim=(0, 1.02))
    return figure


# --- clusters --------------------------------------------------------------------------------------------


def _cluster(points: NDArray, most: int, seed: int) -> tuple[NDArray, list[float]]:
    """Labels of the best number of clusters, and the mean silhouettes of 2, 3, ... of them."""
    KMeans = extra("sklearn.cluster", "phases", "finding phases").KMeans
    threadpool_limits = extra("threadpoolctl", "phases", "finding phases").threadpool_limits

    rng = np.random.default_rng(seed)
    sample = points
    if len(points) > MAX_GRAINS:
        sample = rng.permutation(points)[:MAX_GRAINS]
    distinct = len(np.unique(np.round(sample, 6), axis=0))
    labels = np.zeros(len(points), int)
    best = MIN_SILHOUETTE
    scores = []
    # threads of OpenMP wait in turns: 20 times as long beside other work
    with threadpool_limits(1):
        for k in range(2, min(most, distinct) + 1):
            model = KMeans(k, n_init=5, random_state=seed).fit(sample)
            scores.append(_silhouette(sample, model.labels_, rng))
            if scores[-1] > best + 1e-6:  # of equal ones the fewest clusters
                best = scores[-1]
                labels = model.predict(points)
    return labels, scores


def _silhouette(points: NDArray, labels: NDArray, rng: np.random.Generator) -> float:
    """Mean silhouette, from equally many points of every cluster, weighted by its size."""
    from sklearn.metrics import silhouette_samples

    values, counts = np.unique(labels, return_counts=True)
    share = max(2, MAX_SILHOUETTES // len(values))
    some = np.concatenate([rng.permutation(np.flatnonzero(labels == v))[:share] for v in values])
    if len(some) <= len(values):
        return 0.0  # one point a cluster: by definition
    each = silhouette_samples(points[some], labels[some])
    means = np.array([each[labels[some] == v].mean() for v in values])
    return float((means * counts).sum() / counts.sum())


# --- from properties to phases ---------------------------------------------------------------------------


def _by_properties(
    ds: xr.Dataset, names: Sequence[str], function: Any, how: str, phases: Iterable[int]
) -> xr.Dataset:
    """Add ``phase``, one of some `phases`, from some variables of each grain, chunk by chunk."""
    inputs = [ds["particle_id"], *(ds[name] for name in names)]
    phase = xr.apply_ufunc(
        partial(_unless_padding, function=function),
        *inputs,
        dask="parallelized",
        output_dtypes=["int64"],
    )
    phase.attrs = {"units": "1", "long_name": f"phase, {how}"}
    assigned = ds.assign(phase=phase.transpose(*ds["particle_id"].dims))
    return mark_measured(assigned, ["phase"]).assign_attrs(phase_values=np.unique(list(phases)))


def _unless_padding(ids: NDArray, *values: NDArray, function: Any) -> NDArray:
    out = np.full(ids.shape, PADDING)
    is_grain = ids != PADDING
    out[is_grain] = function(*(v[is_grain] for v in values))
    return out


def _nearest(diameter: NDArray, density: NDArray, *, centres: NDArray, scale: NDArray) -> NDArray:
    from scipy.spatial import cKDTree

    _, index = cKDTree(centres / scale).query(np.stack([diameter, density], axis=-1) / scale)
    return np.asarray(index) + 1


def _mapped(values: NDArray, *, table: Mapping[int, int], name: str) -> NDArray:
    types, index = np.unique(values, return_inverse=True)
    unknown = [value for value in types.tolist() if value not in table]
    if unknown:
        raise SceneError(
            f"mapping={dict(table)!r} lacks {name}={unknown}, which grains have; add all that occur"
        )
    return np.array([table[value] for value in types.tolist()], "int64")[index]
