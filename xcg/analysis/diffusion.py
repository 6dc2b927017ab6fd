"""Mean squared displacement and self-diffusion, with errors."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.analysis.by_phase import with_bulk
from xcg.common.checks import floats, is_whole
from xcg.common.messages import plain
from xcg.fields.formulas.block_errors import block_errors
from xcg.scene.box import BoxMotion, partners
from xcg.scene.conform import takes_scene
from xcg.scene.frame import indices_of, phase_of, steps_in, without_frozen
from xcg.scene.lattice import Lattice
from xcg.scene.scene import Scene
from xcg.scene.schema import COMPONENTS, MOTION, OF_STEP, Frame, units_in
from xcg.scene.times import evenly_spaced, require_known_times
from xcg.steps.labels import (
    annotated,
    call_of,
    labelled,
    phases_of,
    provenance,
    with_errors,
    with_phase_labels,
)
from xcg.steps.mapping import each_step

T = TypeVar("T")
_TENSOR = ("component", "direction")
_ABOUT = {
    "mean_squared_displacement": ("m^2", "mean squared displacement"),
    "displacement_products": ("m^2", "mean product of components of the displacement"),
    "velocity_autocorrelation": ("m^2 s^-2", "velocity autocorrelation"),
    "normalised_autocorrelation": ("1", "velocity autocorrelation over that at lag 0"),
    "self_diffusion": ("m^2 s^-1", "self-diffusion"),
    "diffusion_coefficient": ("m^2 s^-1", "coefficient of self-diffusion"),
}


@takes_scene
def mean_squared_displacement(
    scene: Scene,
    lags: int | Sequence[int] | None = None,
    *,
    by: str | None = None,
    groups: Sequence[int] | None = None,
    remove_drift: bool = True,
    fit: Sequence[float] | None = None,
) -> xr.Dataset:
    """Mean squared displacement of the grains over several lags, and their self-diffusion (computes, step by step).

    Grains are followed by their ids from step to step, across periodic edges by ``image`` of the
    scene, else by the image that moves least relative to the box, and each step and the one `lag`
    steps later are a pair. As many steps as the longest lag are in memory.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene of several steps at equal distances.
    lags : int or list of int, optional
        Numbers of steps; one number for all up to it. By default 1, 2, 4, ... up to half of the
        steps.
    by : str, optional
        An integer variable of the particles: adds the dimension ``phase`` with "bulk" first. A
        grain is of the phase that it has at the first step of a pair.
    groups : list of int, optional
        All values of `by`, where they are not known without reading.
    remove_drift : bool
        Subtract, at each step, the mean displacement of all grains (default).
    fit : (float, float), optional
        First and last lag (s) of the range where the mean squared displacement is linear in the
        lag: asks for self-diffusion.

    Returns
    -------
    xarray.Dataset
        ``mean_squared_displacement`` (lag, phase), the sum over the axes of the scene,
        ``displacement_products`` (.., component, direction), the mean of u_a u_b, and
        ``pair_count``, how many displacements are in them; with `fit` ``self_diffusion`` (phase,
        component, direction), half of the slope of ``displacement_products`` in a straight line by
        least squares, and ``diffusion_coefficient``, its trace over the number of dimensions.
        Standard errors are ``<name>_error``, from blocks of the first steps of pairs as in
        `time_average`.

    Raises
    ------
    SceneError
        If times are not known, the steps are not at equal distances, or one has no grain of the
        step before.
    ValueError
        If a lag or the range of the fit does not fit the series.

    Warns
    -----
    SceneWarning
        If more than 1 % of the particles move by more than a quarter of a period from one step to
        the next, or one by more than 0.4, and the scene has no ``image``.

    Notes
    -----
    ``D = lim <u u> / 2 t`` (Einstein 1905). In a box that deforms, displacements are those beside
    the motion of the box; in a flow that differs from place to place, displacements by the flow are in
    them: take ``d2min`` and ``self_diffusion`` of `displacement`, which leave out its linear part.
    Grains that leave and come back are new ones; frozen ones do not count.

    Examples
    --------
    >>> import numpy as np
    >>> import xcg
    >>> kicks = 0.1 * np.random.default_rng(1).normal(size=(65, 500, 3))
    >>> ds = xcg.scene_from_arrays(list(kicks.cumsum(axis=0)), diameter=np.full((65, 500), 0.01), time=np.arange(65.0))
    >>> m = ds.cg.mean_squared_displacement(4, fit=(1, 4))
    >>> round(float(m.diffusion_coefficient), 3)  # 0.1^2 / 2
    0.005
    """
    ds = scene.ds
    scene.require((), "mean_squared_displacement")
    chosen, at = _lags_of(scene, lags, "mean_squared_displacement")
    used = _range(fit, at)
    groups = scene.groups(by, groups)
    sums, counts = _sums(ds, chosen, by, groups, remove_drift)
    dims = ("first", "lag", "phase")
    samples = xr.Dataset(
        {"sum": ((*dims, *_TENSOR), sums), "count": (dims, counts)},
        {"lag": at} | {dim: list(COMPONENTS) for dim in _TENSOR},
    )
    if by is None:
        samples = samples.isel(phase=0)
    plane = [a for a in COMPONENTS if a in scene.setup.plane]

    def means(sums: xr.Dataset) -> xr.Dataset:
        tensor = sums["sum"] / sums["count"].where(sums["count"] > 0)
        return xr.Dataset(
            {"displacement_products": tensor, "mean_squared_displacement": _trace(tensor, plane)}
        )

    def slope(sums: xr.Dataset) -> xr.Dataset:
        away = xr.DataArray(at[used] - at[used].mean(), dims="lag")
        tensor = means(sums)["displacement_products"].isel(lag=used).drop_vars("lag")
        tensor = (tensor * away).sum("lag") / (2 * (away**2).sum())
        return xr.Dataset(
            {"self_diffusion": tensor, "diffusion_coefficient": _trace(tensor, plane) / len(plane)}
        )

    values, errors = _means_of_pairs(samples, chosen, means)
    if used.size:
        common = samples.isel(first=slice(0, ds.sizes["time"] - chosen[used[-1]]))
        values = values.merge(slope(samples.sum("first")))
        errors = errors.merge(block_errors(common, "first", slope))
    data = with_errors(values, errors, _ABOUT, scene.setup.unit_system)
    result = _labelled(scene, data, samples, chosen, "number of displacements")
    options = {"lags": chosen, "by": by, "remove_drift": remove_drift, "fit": fit}
    result.attrs = provenance(ds, call_of("mean_squared_displacement", options))
    if by is not None:
        result = result.assign_coords(phase=phases_of(by, groups))
    return with_phase_labels(result)


@takes_scene
def velocity_autocorrelation(
    scene: Scene,
    lags: int | Sequence[int] | None = None,
    *,
    remove_drift: bool = True,
) -> xr.Dataset:
    """Velocity autocorrelation of the grains over several lags (computes, step by step).

    Grains are followed by their ids. As many steps as the longest lag are in memory.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene of several steps at equal distances, with velocities.
    lags : int or list of int, optional
        Numbers of steps; one number for all up to it. By default 1, 2, 4, ... up to half of the
        steps. Lag 0 is always there.
    remove_drift : bool
        Subtract, at each step, the mean velocity of all grains (default).

    Returns
    -------
    xarray.Dataset
        ``velocity_autocorrelation`` (lag), the mean of v(t) . v(t + lag) over grains and steps, the
        axes of the scene added up; ``normalised_autocorrelation``, over its value at lag 0; their
        standard errors, ``<name>_error``, from blocks of steps as in `time_average`; and
        ``pair_count``. Frozen grains do not count.

    Raises
    ------
    SceneError
        If there are no velocities or ids, times are not known, or the steps are not at equal
        distances.
    ValueError
        If a lag does not fit the series.

    Notes
    -----
    The integral over the lag, divided by the number of dimensions, is the self-diffusion (Green
    1954; Kubo 1957). In a flow that differs from place to place the flow is part of it.

    Examples
    --------
    >>> import numpy as np
    >>> import xcg
    >>> v = np.tile([[1.0, 0, 0], [-1.0, 0, 0]], (4, 1, 1))  # straight on for four steps
    >>> r = v * np.arange(4.0)[:, None, None]
    >>> ds = xcg.scene_from_arrays(r, velocity=v, diameter=np.full((4, 2), 0.1), time=np.arange(4.0))
    >>> ds.cg.velocity_autocorrelation(2).velocity_autocorrelation.values.tolist()
    [1.0, 1.0, 1.0]
    """
    ds = scene.ds
    scene.require(("velocity",), "velocity_autocorrelation")
    chosen, at = _lags_of(scene, lags, "velocity_autocorrelation")
    chosen = [0, *chosen]
    at = np.append(0.0, at)
    # of products, of squares at the first step, of pairs
    sums = np.zeros((3, ds.sizes["time"], len(chosen)))
    velocities = _velocities(ds, list(scene.setup.axes), remove_drift)
    for first, k, (old_ids, old_velocity), (ids, velocity) in _pairs_of_steps(velocities, chosen):
        indices = indices_of(ids, old_ids)
        stay = indices >= 0
        old_velocity = old_velocity[stay]
        products = (old_velocity * velocity[indices[stay]]).sum()
        sums[:, first, k] = products, (old_velocity**2).sum(), stay.sum()
    dims = ("first", "lag")
    of_products, of_squares, counts = sums
    samples = xr.Dataset(
        {"sum": (dims, of_products), "size": (dims, of_squares), "count": (dims, counts)},
        {"lag": at},
    )

    def means(sums: xr.Dataset) -> xr.Dataset:
        return xr.Dataset(
            {
                "velocity_autocorrelation": sums["sum"] / sums["count"].where(sums["count"] > 0),
                "normalised_autocorrelation": sums["sum"] / sums["size"].where(sums["size"] > 0),
            }
        )

    values, errors = _means_of_pairs(samples, chosen, means)
    data = with_errors(values, errors, _ABOUT, scene.setup.unit_system)
    result = _labelled(scene, data, samples, chosen, "number of pairs of velocities")
    call = call_of("velocity_autocorrelation", {"lags": chosen, "remove_drift": remove_drift})
    return result.assign_attrs(provenance(ds, call))


def _lags_of(
    scene: Scene, lags: int | Sequence[int] | None, purpose: str
) -> tuple[list[int], NDArray]:
    """Return lags in steps and in s; raise unless grains have ids, and steps equal distances in time."""
    scene.require_ids(purpose)
    chosen = chosen_lags(lags, scene.ds.sizes["time"], purpose)
    require_known_times(scene.ds, purpose)
    return chosen, evenly_spaced(scene.ds["time"].to_numpy(), "times") * np.array(chosen)


def _pairs_of_steps(states: Iterable[T], lags: Sequence[int]) -> Iterator[tuple[int, int, T, T]]:
    """Yield first step, position of the lag, and both states of each pair of steps; keep as many as the longest lag."""
    recent: deque[T] = deque(maxlen=lags[-1] + 1)
    for t, now in enumerate(states):
        recent.append(now)
        for k, lag in enumerate(lags):
            if lag <= t:
                yield t - lag, k, recent[-1 - lag], now


def _means_of_pairs(
    samples: xr.Dataset, lags: Sequence[int], means: Callable[[xr.Dataset], xr.Dataset]
) -> tuple[xr.Dataset, xr.Dataset]:
    """Return means over pairs of steps by lag, and their errors, from sums by first step of the pair."""
    errors = []
    for k, lag in enumerate(lags):
        of_lag = samples.isel(lag=[k], first=slice(0, samples.sizes["first"] - lag))
        errors.append(block_errors(of_lag, "first", means))
    return means(samples.sum("first")), xr.concat(errors, "lag")


def _labelled(
    scene: Scene,
    data: Mapping[str, xr.DataArray],
    samples: xr.Dataset,
    lags: Sequence[int],
    counted: str,
) -> xr.Dataset:
    """Return a result by lag, with the number of its pairs, which are what is `counted`."""
    pairs = labelled(samples["count"].sum("first").astype("int64"), "1", counted)
    second = units_in("s", scene.setup.unit_system)
    return xr.Dataset({**data, "pair_count": pairs}).assign_coords(
        lag=annotated("lag", samples["lag"], second, "time between the steps of a pair"),
        steps=annotated("lag", lags, "1", "steps between"),
    )


def _frames(ds: xr.Dataset, names: Sequence[str]) -> Iterator[tuple[Frame, Lattice, str]]:
    """Compute frame, periodic images and name of each step, without frozen grains."""
    held = [name for name in (*names, "frozen", *OF_STEP) if name in ds]
    periodic = str(ds.attrs.get("periodic", ""))
    for step in each_step(ds[held]):
        padded = {name: step[name].to_numpy() for name in held}
        frame, lattice, source = next(steps_in(padded, periodic))
        yield without_frozen(frame), lattice, source


def _velocities(
    ds: xr.Dataset, axes: Sequence[int], remove_drift: bool
) -> Iterator[tuple[NDArray, NDArray]]:
    """Return the ids and velocities (n, axes) of the grains that move, step by step."""
    for frame, _, _ in _frames(ds, ("particle_id", "position", "velocity")):
        velocity = frame["velocity"][:, axes]
        if remove_drift and len(velocity):
            velocity = velocity - velocity.mean(axis=0)
        yield frame["particle_id"], velocity


def _trace(tensor: xr.DataArray, plane: Sequence[str]) -> xr.DataArray:
    parts = [tensor.sel(component=a, direction=a, drop=True) for a in plane]
    return sum(parts[1:], start=parts[0])


def chosen_lags(lags: int | Sequence[int] | None, steps: int, purpose: str) -> list[int]:
    """Return numbers of steps between two, sorted; None is powers of two up to half of the steps."""
    if steps < 2:
        raise ValueError(f"{purpose} needs two steps or more, and the scene has {steps}")
    if lags is None:
        return [2**k for k in range(64) if 2**k <= steps // 2]
    numbers: Any = lags
    if isinstance(lags, (int, np.integer)):
        numbers = range(1, lags + 1)
    if not len(numbers) or not all(is_whole(number, 1, steps - 1) for number in numbers):
        raise ValueError(
            f"lags={lags!r}: expected numbers of steps from 1 to {steps - 1}, the scene has {steps}"
        )
    return sorted({int(number) for number in numbers})


def _range(fit: Sequence[float] | None, at: NDArray) -> NDArray:
    """Return indices of the lags (n,) in the range of the fit."""
    if fit is None:
        return np.zeros(0, int)
    ends = floats(fit)
    used = np.zeros(0, int)
    if ends.shape == (2,):
        hair = 1e-9 * at[-1]
        used = np.flatnonzero((at >= ends[0] - hair) & (at <= ends[1] + hair))
    if used.size < 2:
        raise ValueError(
            f"fit={plain(fit)}: expected a range with two or more of the lags {at.tolist()} (s)"
        )
    return used


# --- grains on their way ---------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Displaced:
    """Displacements (n, 3) of the grains of one step since each was first seen, with ids and phases."""

    ids: NDArray
    displacement: NDArray
    first_step: NDArray
    phase: NDArray


def _displacements(
    ds: xr.Dataset, by: str | None, groups: Sequence[int], remove_drift: bool
) -> Iterator[_Displaced]:
    """Follow the grains from step to step."""
    names = ("particle_id", "position", *MOTION, str(by))
    before = None
    for t, (frame, lattice, source) in enumerate(_frames(ds, names)):
        ids = frame["particle_id"]
        position = frame["position"]
        displacement = np.zeros_like(position)
        first_step = np.full(len(ids), t)
        if before is not None:
            old, old_frame, old_lattice, old_source = before
            indices = partners(old_frame, frame, (old_source, source))
            stay = np.flatnonzero(indices >= 0)
            indices = indices[stay]
            motion = BoxMotion.between(old_lattice, lattice)
            moved = motion.relative(old_frame, frame, stay, indices)
            motion.warn_of_jumps(moved, old_frame, old_lattice, old_source, "displacements")
            if remove_drift and len(moved):
                moved -= moved.mean(axis=0)
            displacement[indices] = old.displacement[stay] + moved
            first_step[indices] = old.first_step[stay]
        now = _Displaced(ids, displacement, first_step, phase_of(frame, by, groups, source))
        yield now
        before = now, frame, lattice, source


def _sums(
    ds: xr.Dataset,
    lags: Sequence[int],
    by: str | None,
    groups: Sequence[int],
    remove_drift: bool,
) -> tuple[NDArray, NDArray]:
    """Sum u u, and count grains, by first step of the pair, lag and phase, all of them first."""
    phases = max(1, len(groups))
    counts = np.zeros((ds.sizes["time"], len(lags), phases))
    sums = np.zeros((*counts.shape, 3, 3))
    displaced = _displacements(ds, by, groups, remove_drift)
    for first, k, then, now in _pairs_of_steps(displaced, lags):
        indices = indices_of(now.ids, then.ids)
        stay = indices >= 0
        stay[stay] = now.first_step[indices[stay]] <= first
        moved = now.displacement[indices[stay]] - then.displacement[stay]
        for phase in range(phases):
            of_phase = moved[then.phase[stay] == phase]
            sums[first, k, phase] = of_phase.T @ of_phase
            counts[first, k, phase] = len(of_phase)
    return with_bulk(sums, axis=2), with_bulk(counts, axis=2)
