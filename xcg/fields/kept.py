"""Plans are kept for equal calls: of scenes that are alike but for their grains and contacts.

Both sides of the comparison are values, so that it does not matter what was changed in place. Kept things hold no array
of grains, contacts or fields.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field

import xarray as xr

from xcg.fields.formulas import registry
from xcg.fields.places.frames import is_cylindrical
from xcg.fields.planning.make import plan_measured
from xcg.fields.planning.plan import Plan
from xcg.fields.request import Request
from xcg.fields.results import layout
from xcg.fields.sums.smoothing import kind_of
from xcg.scene.kept import Kept
from xcg.scene.outline import NoKeyError, key_of, outline
from xcg.scene.query import groups_of, require_scene
from xcg.scene.sizes import with_measures
from xcg.scene.warn import warnings_given
from xcg.steps.label import key_of_variable, times_of

_PLANS, _LAYOUTS = 32, 4  # that are kept, and of each plan
_LONGEST = 10_000  # nodes along an axis, of plans that are kept


@dataclass(frozen=True)
class _Kept:
    """A plan, and the layouts of its results by their times."""

    plan: Plan
    layouts: Kept[xr.Dataset] = field(default_factory=lambda: Kept(_LAYOUTS))


_kept: Kept[_Kept] = Kept(_PLANS)
registry.on_register(_kept.clear)


def prepare_call(ds: xr.Dataset, request: Request) -> tuple[Plan, xr.Dataset]:
    """Return the plan of a call and the layout of its result: those of an equal call before, or new ones.

    Raises
    ------
    SceneError, ValueError
        As `make_plan`.
    """
    require_scene(ds, (), "coarse_grain")
    ds = with_measures(ds)
    try:
        key, times = _key(ds, request), (ds.sizes["time"], *(key_of_variable(given) for given in times_of(ds).values()))
    except (NoKeyError, ValueError):  # planning tells what is wrong
        plan = plan_measured(ds, request)
        return plan, layout(ds, plan)
    found = _kept.get(key)
    if found is None:
        before = warnings_given()
        found = _Kept(plan_measured(ds, request))
        # where planning warned, an equal call has to warn, too
        if warnings_given() == before and max(found.plan.deposit.grid.sizes, default=1) <= _LONGEST:
            _kept.keep(key, found)
    return found.plan, found.layouts.or_new(times, lambda: layout(ds, found.plan))


def _key(ds: xr.Dataset, request: Request) -> Hashable:
    """Return all that planning looks at."""
    if is_cylindrical(ds):
        msg = "the radius of a cylindrical mesh depends on positions"
        raise NoKeyError(msg)
    kernel = kind_of(request.kernel) if isinstance(request.kernel, str) else None  # names may be registered anew
    groups = None if request.by is None else groups_of(ds, request.by, request.groups)
    return outline(ds), key_of(vars(request)), kernel, groups
