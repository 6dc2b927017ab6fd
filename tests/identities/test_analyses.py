"""What holds for every analysis of the steps of a scene: selections of a lazy series are those of one in memory."""

from __future__ import annotations

from contextlib import nullcontext
from functools import cache
from unittest import mock

import pytest

from tests import raise_if_dask_computes
from tests.analyses import CALLS, COMPUTED, OTHERS, PARTS, classes, methods, moving_spheres
from tests.writers.test_save import assert_same_bits
from xcg.steps import analysis

STEPS = 8
# selections of a series in chunks of two: a whole one, a part of one, and with an empty chunk at the end
SLICES = {"one chunk": slice(2, 4), "a part": slice(1, 6), "an empty chunk": slice(1, 7, 3)}


@cache
def series(name):
    return moving_spheres(name, STEPS)


@pytest.mark.filterwarnings("ignore:.*granular_temperature is NaN")
def test_all_analyses_are_called():
    """A new method of the accessor, and a new FrameAnalysis, has a call in `tests/analyses.py`."""
    called = {name.split()[0].strip(",") for name in CALLS}
    assert methods("scene") - called == set(OTHERS)
    ran = set()
    map_over_time = analysis.map_over_time

    def recorded(ds, names, task, *args):
        ran.add(type(task.analysis))
        return map_over_time(ds, names, task, *args)

    with mock.patch.object(analysis, "map_over_time", recorded):
        for name, call in CALLS.items():
            call(series(name).isel(time=slice(2)).chunk(time=1))
    names = {cls.__name__ for cls in classes()}
    assert names - {cls.__name__ for cls in ran} == set(PARTS)


@pytest.mark.filterwarnings("ignore:.*granular_temperature is NaN")
@pytest.mark.parametrize("steps", SLICES)
@pytest.mark.parametrize("name", CALLS)
def test_slices_of_lazy_series_equal_those_in_memory(name, steps):
    call = CALLS[name]
    guard = nullcontext() if name in COMPUTED else raise_if_dask_computes()
    with guard:
        lazy = call(series(name).chunk(time=2).isel(time=SLICES[steps]))
    assert_same_bits(lazy.compute(), call(series(name).isel(time=SLICES[steps])))


@pytest.mark.filterwarnings("ignore:.*granular_temperature is NaN")
@pytest.mark.parametrize("name", [name for name in CALLS if name not in COMPUTED])
def test_equal_calls_have_tasks_of_equal_names(name):
    ds = series(name).isel(time=slice(3)).chunk(time=1)
    first, second = CALLS[name](ds), CALLS[name](ds)
    assert first.__dask_layers__() == second.__dask_layers__()
