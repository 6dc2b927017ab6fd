"""Averages of small lazy results in one task: the bits, names, attributes, warnings and errors of those in memory."""

import warnings

import numpy as np
import pytest
import xarray as xr

import xcg
from tests import raise_if_dask_computes
from tests.scenes import random_steps
from xcg.fields.formulas import one_task
from xcg.fields.formulas.doubts import SHARES

STEPS = 17
# of each rule of averages: sums, one with a covariance, weights by mass, number and fluctuations, inverses, norms
RULES = (
    "density",
    "kinetic_stress",
    "velocity",
    "coordination_number",
    "granular_temperature",
    "d32",
    "friction_coefficient",
)


def lazy_result(**options):
    ds = random_steps(STEPS, first=60, more=0)
    ds = ds.assign(phase=ds.particle_id % 2 + 1)
    return ds.chunk(time=5).cg.coarse_grain(width=0.9, spacing=1.2, **options)


def without_shares(average):
    """Results in memory have shares of nodes among their attributes, too."""
    for variable in average.variables.values():
        for share in SHARES:
            variable.attrs.pop(share, None)
    return average


@pytest.mark.parametrize(
    ("result", "average"),
    [
        ({}, {}),
        ({"axes": "z"}, {"window": 9, "every": 4}),
        ({"axes": "xz", "by": "phase", "groups": [1, 2]}, {}),
        ({"axes": "z", "errors": True, "fields": ["velocity", "granular_temperature"]}, {}),
        ({"axes": "", "fields": "stress"}, {}),
    ],
    ids=["volume", "windows", "phases", "errors", "box"],
)
@pytest.mark.filterwarnings("ignore:time_average")
def test_lazy_averages_are_those_of_memory_to_the_bit(result, average):
    f = lazy_result(**result)
    with raise_if_dask_computes():
        lazy = f.cg.time_average(**average)
    assert all(values.chunks is not None for values in lazy.data_vars.values())
    xr.testing.assert_identical(
        lazy.compute(), without_shares(f.compute().cg.time_average(**average))
    )


def test_the_graph_of_an_average_does_not_grow_with_its_fields(monkeypatch):
    """The average takes less than a task a field and step beside those of the result."""
    f = lazy_result(axes="z", fields=RULES)
    tasks = len(f.cg.time_average().__dask_graph__()) - len(f.__dask_graph__())
    assert tasks < 6 * len(f.variables)
    monkeypatch.setattr(one_task, "_MOST", 0)
    assert len(f.cg.time_average().__dask_graph__()) > 10 * tasks


@pytest.mark.filterwarnings("ignore:time_average")
def test_larger_results_have_the_same_averages(monkeypatch):
    f = lazy_result(axes="z", fields=RULES)
    small = f.cg.time_average().compute()
    monkeypatch.setattr(one_task, "_MOST", 0)
    xr.testing.assert_allclose(small, f.cg.time_average().compute(), rtol=1e-12)


def test_warnings_about_the_result_come_with_the_call_and_about_its_values_once_when_computed():
    t = np.arange(32.0)
    x = np.broadcast_to([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], (32, 2, 3))
    velocity = np.zeros((32, 2, 3))
    velocity[..., 0] = t[:, None]  # a drift
    ds = xcg.scene_from_arrays(
        x, velocity=velocity, diameter=1.0, density=1.0, time=t, box=[[-2.0, 2.0]] * 3
    )
    lazy = ds.chunk(time=8)
    options = {"width": 1.0, "axes": "x"}
    f = lazy.cg.coarse_grain("kinetic_stress", for_averages=False, **options)
    with pytest.warns(xcg.SceneWarning, match="leaves out how the velocity varies") as caught:
        f.cg.time_average().compute()
    assert len([w for w in caught if "leaves out" in str(w.message)]) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        average = lazy.cg.coarse_grain("velocity", **options).cg.time_average()
    with pytest.warns(xcg.SceneWarning, match="velocity changes over the 32 steps") as caught:
        average.compute()
    assert len([w for w in caught if "changes over" in str(w.message)]) == 1


def test_variables_may_differ_in_their_chunks():
    f = lazy_result(axes="z", fields="velocity")
    average = f.assign(velocity=f.velocity.chunk(time=2)).cg.time_average()
    xr.testing.assert_identical(average.compute(), f.cg.time_average().compute())


def test_wrong_arguments_of_lazy_averages_raise_at_the_call():
    f = lazy_result(axes="z", fields=["velocity", "density"])
    with raise_if_dask_computes():
        with pytest.raises(ValueError, match="window=40"):
            f.cg.time_average(window=40)
        with pytest.raises(ValueError, match="velocity needs density"):
            f.drop_vars("density").cg.time_average()


def test_averages_of_one_number_a_step_are_lazy_too():
    """As of a flow rate, which has no nodes."""
    plane = xcg.Plane((0, 0, 2), (0, 0, 1))
    rate = random_steps(STEPS, first=60, more=0).chunk(time=5).cg.flow_rate(plane, width=0.9)
    with raise_if_dask_computes():
        average = rate.cg.time_average()
    xr.testing.assert_equal(average.compute(), rate.compute().cg.time_average())
