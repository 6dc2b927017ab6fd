"""Warnings point at the line of the caller, and come once a call."""

import gc
import pickle
import weakref
from concurrent.futures import ThreadPoolExecutor

import dask
import numpy as np
import pytest

import xcg
from xcg.common.messages import Once, active_call, did_you_mean, warn_once, warn_user
from xcg.steps.analysis import map_over_time
from xcg.steps.faults import SkippedStep


def line_of(record, text):
    """Line of this file that a warning points at."""
    assert record.filename == __file__, record
    with open(__file__) as stream:
        return text in stream.readlines()[record.lineno - 1]


def doubtful(arrays):
    for number in arrays["step"]:
        warn_once("doubt", f"step {number} is doubtful")
    return {"a": np.zeros(len(arrays["step"]))}


def mapped(ds):
    with active_call().active():  # as in functions that take a scene
        results = {"a": ((), "float64")}
        return map_over_time(ds, ["position", "step"], doubtful, results, "doubtful")["a"]


def without_box():
    """A scene whose step cannot be computed."""
    ds = xcg.datasets.simple_cubic(3)
    return ds.assign(box=np.nan * ds.box)


@pytest.fixture
def ds():
    return xcg.scene_from_arrays(np.zeros((6, 1, 3)), diameter=np.ones((6, 1)), density=1.0)


def test_warnings_point_at_the_line_of_the_call(ds):
    options = {
        "spacing": 9.0,
        "width": 1.0,
        "bounds": {"z": (-9, 9)},
        "axes": "z",
        "extent": {"x": 1, "y": 1},
    }
    with pytest.warns(xcg.SceneWarning, match="larger than the support") as said:
        ds.cg.coarse_grain("density", **options)  # by the accessor
    assert len(said) == 1
    assert line_of(said[0], "# by the accessor")
    with pytest.warns(xcg.SceneWarning, match="larger than the support") as said:
        xcg.coarse_grain(ds, "density", **options)  # as a function
    assert line_of(said[0], "# as a function")


def test_a_call_in_memory_warns_once(ds):
    with pytest.warns(xcg.SceneWarning, match="step 0 is doubtful") as said:
        mapped(ds)
    assert len(said) == 1
    with pytest.warns(xcg.SceneWarning):  # another call, another warning
        mapped(ds)


@pytest.mark.parametrize("scheduler", ["threads", "sync"])
def test_a_lazy_call_warns_once(ds, scheduler):
    a = mapped(ds.chunk(time=1))
    with (
        pytest.warns(xcg.SceneWarning, match="is doubtful") as said,
        dask.config.set(scheduler=scheduler),
    ):
        a.compute()
    assert len(said) == 1


@pytest.mark.parametrize("scheduler", ["threads", "sync"])
def test_warnings_of_lazy_calls_point_at_the_line_that_computes(scheduler):
    f = without_box().chunk(time=1).cg.coarse_grain("density", axes="z", on_error="skip")
    with pytest.warns(SkippedStep) as said, dask.config.set(scheduler=scheduler):
        f.compute()  # here
    assert line_of(said[0], "# here")


def test_equal_calls_have_equal_names_in_dask(ds):
    lazy = ds.chunk(time=1)
    assert mapped(lazy).name == mapped(lazy).name


def test_unpickled_copies_do_not_repeat_a_warning():
    once = Once()
    copy = pickle.loads(pickle.dumps(once))
    with pytest.warns(xcg.SceneWarning, match="first"):
        once.warn("a", "first")
    copy.warn("a", "second")  # a warning would be an error
    with pytest.warns(xcg.SceneWarning, match="third"):
        copy.warn("b", "third")


def test_the_memory_of_warnings_is_bounded(monkeypatch):
    monkeypatch.setattr(Once, "REMEMBERED", 3)
    monkeypatch.setattr(Once, "_said", {})
    once = Once()
    for k in range(5):
        with pytest.warns(xcg.SceneWarning, match=f"number {k}"):
            once.warn(f"fact {k}", f"number {k}")
    once.warn("fact 4", "the latest ones are remembered")  # a warning would be an error
    assert len(Once._said) == 3


def test_a_warning_does_not_keep_the_arrays_of_its_callers():
    def warn_beside_an_array():
        values = np.zeros(10)
        with pytest.warns(xcg.SceneWarning):
            warn_user("a few grains")
        return weakref.ref(values)

    gc.disable()
    try:
        assert warn_beside_an_array()() is None
    finally:
        gc.enable()


def test_warnings_from_a_user_thread_point_at_its_line():
    def work():
        warn_user("from a thread")  # the thread's own line

    with pytest.warns(xcg.SceneWarning) as said, ThreadPoolExecutor(1) as pool:
        pool.submit(work).result()
    assert line_of(said[0], "# the thread's own line")


def test_numbers_of_numpy_are_plain_in_messages_and_history():
    wrong = {"value": np.float64(-0.5), "other": [np.int64(3), np.float64(1e-20)]}
    assert str(xcg.SceneError(f"{wrong!r}")) == "{'value': -0.5, 'other': [3, 1e-20]}"
    ds = xcg.datasets.simple_cubic(3)
    with pytest.raises(ValueError, match=r"^edges=\[2.0, 1.0\]: expected"):
        ds.cg.assign_phases(edges=[np.float64(2), np.float64(1)])
    f = ds.cg.coarse_grain("density", axes="z", width=np.float64(0.5), at={"x": np.float64(1)})
    assert "width=0.5" in f.attrs["history"]
    assert "np." not in f.attrs["history"]


def test_names_of_others_are_answered_by_those_of_the_package(ds):
    f = ds.cg.coarse_grain("density", width=1.0)
    cases = [
        (lambda: ds.cg.coarse_grain("phi"), "did you mean 'volume_fraction'"),
        (lambda: ds.cg.coarse_grain("Volume Fraction"), "did you mean 'volume_fraction'"),
        (lambda: ds.cg.coarse_grain("density", w=1.0), "did you mean 'width'"),
        (lambda: ds.cg.coarse_grain("density", time=0), r"ds\.isel\(time=-1\)"),
        (lambda: ds.cg.coarse_grain("density", at="z"), "axes='z' resolves an axis"),
        (lambda: ds.cg.coarse_grain("density", kernel="gauss"), "did you mean 'gaussian'"),
        (lambda: ds.cg.stress, r"ds\.cg\.coarse_grain\('stress'\)"),
        (lambda: ds.cg.msd(), "did you mean 'mean_squared_displacement'"),
        (lambda: f.cg.save("f.vtu"), r"ParaView opens \.vtkhdf"),
        (lambda: xcg.open("file"), "did you mean 'open_scene'"),
        (lambda: xcg.coarsegrain, "did you mean 'coarse_grain'"),
        (lambda: xcg.datasets.chute, r"xcg\.datasets\.open\('chute'\)"),
        (lambda: xcg.scene_from_arrays(np.zeros((2, 3)), dt=0.1), "did you mean time="),
        (lambda: xcg.scene_from_arrays(np.zeros((3, 5))), r"give its transpose, position\.T"),
        (lambda: xcg.scene_from_arrays(np.zeros((2, 3)), gravity=9.8), r"\(0\.0, 0\.0, -9\.81\)"),
        (lambda: xcg.scene_from_arrays(np.zeros((2, 3)), periodic="all"), "True for all axes"),
    ]
    for call, message in cases:
        with pytest.raises((AttributeError, TypeError, ValueError), match=message):
            call()
    assert not hasattr(ds.cg, "_repr_png_")


@pytest.mark.parametrize("given", [True, "xy", ["y", "x"], (True, True), "YX"])
def test_periodic_axes_may_be_given_in_several_forms(given):
    if given == (True, True):
        given = (True, True, False)
    box = [[0.0, 2.0]] * 3
    ds = xcg.scene_from_arrays(
        np.zeros((2, 3)), diameter=0.5, box=box, periodic=given, dimension=2 if given is True else 3
    )
    assert ds.attrs["periodic"] == "xy"


@pytest.mark.parametrize(
    ("word", "meant"),
    [
        ("contact_heat", ""),
        ("contact_area", ""),
        ("particle_heat", ""),
        ("contact_forces", "contact_force"),
        ("contct_force", "contact_force"),
        ("contact_k", "contact_j"),
        ("Contact Force", "contact_force"),
        ("particel_id", "particle_id"),
    ],
)
def test_a_shared_beginning_makes_no_name_similar(word, meant):
    known = ["position", "particle_id", "contact_i", "contact_j", "contact_force", "contact_point"]
    assert did_you_mean(word, known) == (f"; did you mean {meant!r}?" if meant else "")
