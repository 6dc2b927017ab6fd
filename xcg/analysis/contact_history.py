"""Contacts followed from step to step: ages, births and losses, lifetimes, and how normals turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from xcg.analysis.diffusion import chosen_lags
from xcg.common.messages import SceneWarning, warn_user
from xcg.fields.formulas.block_errors import block_errors
from xcg.scene.conform import takes_scene
from xcg.scene.contacts import Contacts
from xcg.scene.frame import steps_in
from xcg.scene.lattice import Lattice
from xcg.scene.scene import Scene
from xcg.scene.schema import CONTACT_VARIABLES, OF_STEP, PADDING, Frame, Variable
from xcg.scene.times import require_times
from xcg.steps.labels import call_of, label, labelled_table, with_errors
from xcg.steps.mapping import each_step

# intervals that are longer than the median by more than this share are gaps
_GAP = 0.01
# share of contacts lost from step to step above which a warning is given
_LOST = 0.5
_JUMP = 2.0  # times the usual losses
_MANY = 20  # contacts, of which a share is no chance

_ROWS = {
    "contact_age": Variable(("contact",), "s", "time since the first step of the contact"),
    "contact_turned": Variable(("contact",), "1", "angle of the normal to that of its first step"),
    "contact_turning_rate": Variable(
        ("contact",), "s^-1", "angle of the normal to that of the step before, over the interval"
    ),
    "contact_count": Variable((), "1", "number of contacts", "int64"),
    "births": Variable((), "1", "contacts that were not there in the step before", "int64"),
    "losses": Variable((), "1", "contacts of the step before that are not there", "int64"),
}


@takes_scene
def contact_history(scene: Scene, lags: int | Sequence[int] | None = None) -> xr.Dataset:
    """Follow contacts from step to step: ages, births, losses, lifetimes and turning (computes, step by step).

    A contact goes on where the same two particles, by their ids, or a particle and a wall, touch in
    the next step through the same periodic image. Two steps are in memory.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene of several steps with contacts.
    lags : int or list of int, optional
        Numbers of steps of `persistence`; one number for all up to it. By default 1, 2, 4, ... up to
        half of the steps.

    Returns
    -------
    xarray.Dataset
        By contact, in the rows of the scene: ``contact_age`` (s), 0 in the first step of a contact;
        ``contact_turned`` (radians), the angle between the normal and that of the first step;
        ``contact_turning_rate`` (radians/s), the angle to the normal of the step before over the
        interval, NaN in the first step of a contact. By step: ``contact_count``, ``births``, ``losses``; the
        first step has no births. By lag: ``persistence``, the share of contacts that are there in
        all steps up to a lag, and its standard error ``persistence_error``. By lost contact:
        ``lifetime`` (s), if it was born within the series.

    Raises
    ------
    SceneError
        If there are no contacts or ids, or times are unknown or do not rise.
    ValueError
        If a lag does not fit the series.

    Warns
    -----
    SceneWarning
        If steps are missing in the series: contacts that break and form again in a gap are not seen;
        or more than half of the contacts are lost from one step to the next, of all or of one interval.

    Notes
    -----
    ``C(t) = sum N(t0, t0 + t) / sum N(t0)``, N(t0) the contacts of step t0 and N(t0, t0 + t) its contacts
    that are in all steps up to ``t0 + t``, over all t0; pairs of steps with a gap between are left out.
    A contact is lost with its particle.

    Ages of contacts of the first step are lower bounds. Births and losses are dated to the middle
    of their intervals. Contacts shorter than an interval may be missed. Lifetimes that reach over an
    end of the series are unknown, so that ``lifetime`` has too few long ones; the mean of all is
    ``contact_count`` over the losses a time.

    Examples
    --------
    >>> import numpy as np
    >>> import xcg
    >>> apart = np.array([0.9, 0.95, 0.9, 1.2])  # two spheres touch for three steps
    >>> place = np.zeros((4, 2, 3))
    >>> place[:, 1, 0] = apart
    >>> ds = xcg.scene_from_arrays(place, diameter=np.ones((4, 2)), time=np.arange(4.0))
    >>> h = ds.cg.find_contacts().cg.contact_history([1])
    >>> h.losses.values.tolist(), float(h.persistence[0].round(3))
    ([0, 0, 0, 1], 0.667)
    """
    ds = scene.ds
    scene.require(CONTACT_VARIABLES[:-1], "contact_history")
    scene.require_ids("contact_history")
    chosen = chosen_lags(lags, ds.sizes["time"], "contact_history")
    require_times(ds, "contact_history")
    times = ds["time"].to_numpy()
    interval = float(np.median(np.diff(times)))
    _warn_of_gaps(times, interval)
    names = [n for n in ("particle_id", *CONTACT_VARIABLES, *OF_STEP) if n in ds]
    arrays = {}
    for name, row in _ROWS.items():
        shape = (len(times), *(ds.sizes[dim] for dim in row.dims))
        arrays[name] = np.full(shape, row.fill, row.dtype)
    arrays["births"][0] = arrays["losses"][0] = 0
    survivors = np.zeros((len(times), len(chosen)))  # by first step and lag
    lifetimes = []
    before = None
    for t, step in enumerate(each_step(ds[names])):
        padded = {name: step[name].to_numpy() for name in names}
        frame, lattice, source = next(steps_in(padded, scene.setup.periodic))
        now = _Touching.of(frame, lattice, source, t)
        rate = np.full(len(now.first), np.nan)
        if before is not None:
            new, old = now.continued(before, lattice)
            rate[new] = _angle(now.normal[new], before.normal[old]) / (times[t] - times[t - 1])
            now.first[new] = before.first[old]
            now.first_normal[new] = before.first_normal[old]
            is_lost = np.ones(len(before.first), bool)
            is_lost[old] = False
            arrays["births"][t] = len(rate) - len(new)
            arrays["losses"][t] = is_lost.sum()
            born = before.first[is_lost & (before.first > 0)]
            lifetimes.append(times[t - 1 : t + 1].mean() - (times[born - 1] + times[born]) / 2)
        is_contact = padded["contact_i"][0] != PADDING
        arrays["contact_age"][t, is_contact] = times[t] - times[now.first]
        arrays["contact_turned"][t, is_contact] = _angle(now.normal, now.first_normal)
        arrays["contact_turning_rate"][t, is_contact] = rate
        arrays["contact_count"][t] = len(rate)
        for k, lag in enumerate(chosen):
            if lag <= t:
                survivors[t - lag, k] = (now.first <= t - lag).sum()
        before = now
    _warn_of_losses(arrays["losses"], arrays["contact_count"], times, interval)
    call = call_of("contact_history", {"lags": chosen})
    result = label(ds, _ROWS, arrays, call)
    count = arrays["contact_count"]
    values, errors = _persistence(survivors, count, times, interval, chosen)
    system = scene.setup.unit_system
    ages = xr.Variable("lost", np.concatenate([np.zeros(0), *lifetimes]))
    at = xr.Variable("lag", interval * np.array(chosen))
    table = {
        "lifetime": (ages, "s", "lifetime of lost contacts"),
        "lag": (at, "s", "time between two steps"),
    }
    about = {"persistence": ("1", "share of contacts that last a lag")}
    return result.assign(labelled_table(table, system)).assign(with_errors(values, errors, about))


def _warn_of_gaps(times: NDArray, interval: float) -> None:
    """Warn if steps are further apart than the median of all."""
    gaps = np.flatnonzero(np.diff(times) > (1 + _GAP) * interval)
    if len(gaps):
        first, last = times[gaps[0] : gaps[0] + 2].tolist()
        warn_user(
            SceneWarning(
                f"contact_history: {len(gaps)} intervals are longer than the others ({interval:g} "
                f"s), the first from {first:g} to {last:g} s; contacts that break and form again "
                "there are not seen, and persistence leaves these intervals out"
            )
        )


def _warn_of_losses(losses: NDArray, count: NDArray, times: NDArray, interval: float) -> None:
    """Warn if most contacts are lost from one step to the next, or in one interval many more than in others."""
    share = losses[1:].sum() / max(1, count[:-1].sum())
    if share > _LOST:
        warn_user(
            SceneWarning(
                f"contact_history: {share:.0%} of the contacts are lost from one step to the next: they last "
                f"{1 / share:.2g} intervals ({interval:g} s) or less, and those that begin and end between two "
                "steps are not seen. Write steps more often"
            )
        )
        return
    shares = losses[1:] / np.maximum(count[:-1], 1)
    jumps = np.flatnonzero((shares > _LOST) & (count[:-1] >= _MANY))
    usual = float(np.median(shares))
    are_rare = 0 < 2 * len(jumps) < len(shares)
    if are_rare and shares[jumps].min() > _JUMP * usual:
        first, last = times[jumps[0] : jumps[0] + 2].tolist()
        warn_user(
            SceneWarning(
                f"contact_history: {shares[jumps[0]]:.0%} of the contacts are lost from {first:g} to {last:g} s, and "
                f"{usual:.0%} in the median of all intervals: steps are missing there, or ids or the packing changed. "
                "Ages and lifetimes end there: give the true times (times=), or take the parts before and after it "
                "by ds.isel(time=slice(...))"
            )
        )


@dataclass(frozen=True, eq=False)
class _Touching:
    """Contacts (n,) of a step: particles, branch and normal from the higher id to the lower.

    `first` is the step in which each was first seen, and `first_normal` its normal there.
    """

    pairs: pd.DataFrame
    branch: NDArray
    normal: NDArray
    first: NDArray
    first_normal: NDArray

    @classmethod
    def of(cls, frame: Frame, lattice: Lattice, source: str, t: int) -> _Touching:
        """Return the contacts of a frame, all of them first seen in it."""
        contacts = Contacts.of(frame, lattice, source)
        low = np.minimum(contacts.key_i, contacts.key_j)
        high = np.maximum(contacts.key_i, contacts.key_j)
        sign = np.where(contacts.key_i == low, 1.0, -1.0)[:, None]
        normal = sign * contacts.normal
        pairs = pd.DataFrame({"low": low, "high": high, "row": np.arange(len(low))})
        return cls(pairs, sign * contacts.between, normal, np.full(len(low), t), normal.copy())

    def continued(self, before: _Touching, lattice: Lattice) -> tuple[NDArray, NDArray]:
        """Return the rows of contacts that were there in the step before, and their rows in it.

        The image that touches is the same where the branch is nearer to that of the step before than
        all its images are.
        """
        both = self.pairs.merge(before.pairs, on=["low", "high"], suffixes=("", "_before"))
        new = both["row"].to_numpy()
        old = both["row_before"].to_numpy()
        same = ~lattice.numbers(self.branch[new] - before.branch[old]).any(axis=1)
        # several contact points of a pair go on together
        new, first = np.unique(new[same], return_index=True)
        return new, old[same][first]


def _angle(one: NDArray, other: NDArray) -> NDArray:
    """Return the angle between unit vectors (n, 3), exact for small ones, too."""
    across = np.linalg.norm(np.cross(one, other), axis=1)
    return np.arctan2(across, (one * other).sum(axis=1))


def _persistence(
    survivors: NDArray, count: NDArray, times: NDArray, interval: float, lags: Sequence[int]
) -> tuple[xr.Dataset, xr.Dataset]:
    """Return the persistence (lag) and its error, from survivors (first step, lag)."""
    values = []
    errors = []
    for k, lag in enumerate(lags):
        even = times[lag:] - times[:-lag] <= lag * interval * (1 + _GAP / lag)
        samples = xr.Dataset(
            {"of": ("first", count[:-lag][even]), "stay": ("first", survivors[:-lag, k][even])}
        ).astype(float)
        values.append(_share(samples.sum("first")))
        errors.append(block_errors(samples, "first", _share))
    return xr.concat(values, "lag"), xr.concat(errors, "lag")


def _share(sums: xr.Dataset) -> xr.Dataset:
    """Return the share of contacts that stay, NaN for none."""
    return xr.Dataset({"persistence": sums["stay"] / sums["of"].where(sums["of"] > 0)})
