"""Analyses of users: labelled, lazy, with steps beside each other, and checked."""

from dataclasses import dataclass

import numpy as np
import pytest
import xarray as xr

import xcg
from tests import raise_if_dask_computes


@dataclass(frozen=True)
class _MeanSpeed(xcg.FrameAnalysis):
    power: float = 1.0

    def reads(self, scene):
        return ["velocity"]

    def rows(self, scene):
        return {"mean_speed": xcg.Variable((), "m s^-1", "mean speed")}

    def frame(self, frame, lattice, source):
        speed = np.linalg.norm(frame["velocity"], axis=1)
        return {"mean_speed": (speed**self.power).mean() ** (1 / self.power)}


class _Numbers(xcg.FrameAnalysis):
    """Numbers of the particles and contacts of a step, in their rows, and by coordinate."""

    def reads(self, scene):
        return ["mass", "contact_force", "time"]

    def rows(self, scene):
        return {
            "doubled": xcg.Variable(("particle",), "kg", "twice the mass"),
            "count": xcg.Variable(("contact",), "1", "number of the contact", "int64"),
            "of_bin": xcg.Variable(("bin",), "s", "time of the step", formula="t"),
        }

    def coords(self, scene):
        return {"bin": xr.Variable("bin", [0.5, 1.5])}

    def frame(self, frame, lattice, source):
        return {
            "doubled": 2 * frame["mass"],
            "count": np.arange(len(frame["contact_force"])),
            "of_bin": np.full(2, frame["time"]),
        }


class _Moved(xcg.FrameAnalysis):
    lags = (-1, 2)

    def reads(self, scene):
        return ["time"]

    def rows(self, scene):
        return {name: xcg.Variable((), "s", name) for name in ("before", "after")}

    def frames(self, now, *others):
        times = [np.nan if step is None else step[0]["time"] for step in others]
        return dict(zip(("before", "after"), times, strict=True))


def _scene(steps=4):
    r = np.random.default_rng(3)
    position = r.uniform(0, 3, (steps, 30, 3))
    return xcg.scene_from_arrays(
        position,
        diameter=np.ones((steps, 30)),
        velocity=r.normal(size=(steps, 30, 3)),
        density=2.0,
        time=np.arange(steps) * 0.5,
        box=[(0, 3)] * 3,
        periodic="xyz",
    ).cg.find_contacts(k_n=1.0)


def test_options_are_in_the_history_and_values_are_those_of_numpy():
    ds = _scene()
    f = _MeanSpeed(power=2.0).run(ds)
    speed = np.linalg.norm(ds.velocity, axis=-1)
    np.testing.assert_allclose(f.mean_speed, np.sqrt((speed**2).mean(axis=1)), rtol=1e-14)
    assert f.mean_speed.attrs["units"] == "m s^-1"
    assert "_MeanSpeed(power=2.0)" in f.attrs["history"]


@pytest.mark.parametrize("analysis", [_MeanSpeed(), _Numbers(), _Moved()])
def test_lazy_results_are_those_in_memory(analysis):
    ds = _scene()
    with raise_if_dask_computes():
        lazy = analysis.run(ds.chunk(time=1))
    eager = analysis.run(ds)
    xr.testing.assert_equal(lazy.compute(), eager)
    for name in eager:
        assert lazy[name].dtype == eager[name].dtype
        assert lazy[name].attrs == eager[name].attrs


def test_rows_of_particles_and_contacts_stay_in_their_places():
    ds = _scene()
    shuffled = ds.isel(particle=np.random.default_rng(1).permutation(30))
    f = _Numbers().run(shuffled)
    np.testing.assert_array_equal(f.doubled, 2 * shuffled.mass)
    padding = ds.contact_i.to_numpy() < 0
    assert padding.any()
    assert ((f["count"].to_numpy() < 0) == padding).all()
    np.testing.assert_array_equal(f.of_bin.sel(bin=0.5), ds.time)
    assert f.of_bin.attrs["formula"] == "t"


def test_a_step_sees_the_steps_at_its_lags():
    f = _Moved().run(_scene(5))
    np.testing.assert_array_equal(f.before, [np.nan, 0.0, 0.5, 1.0, 1.5])
    np.testing.assert_array_equal(f.after, [1.0, 1.5, 2.0, np.nan, np.nan])


def test_selections_give_results_of_their_dimensions():
    one = _MeanSpeed().run(_scene().isel(time=2))
    assert one.mean_speed.dims == ()


def test_skipped_steps_are_marked():
    ds = _scene()
    ds["velocity"] = ds.velocity.where(ds.time != 0.5, np.inf)
    with pytest.warns(xcg.SkippedStep, match="velocity"):
        f = _MeanSpeed().run(ds, on_error="skip")
    np.testing.assert_array_equal(f.skipped, [False, True, False, False])
    assert np.isnan(f.mean_speed[1])


def test_missing_variables_are_one_error():
    with pytest.raises(xcg.SceneError, match=r"_Numbers needs \['contact_force', 'mass'\]"):
        _Numbers().run(_scene().drop_vars(["mass", "contact_force"]))


class _Wrong(_MeanSpeed):
    def frame(self, frame, lattice, source):
        return {"mean_speed": np.zeros(3)}


class _Missing(_MeanSpeed):
    def frame(self, frame, lattice, source):
        return {"speed": 1.0}


@pytest.mark.parametrize(
    ("analysis", "message"),
    [
        (_Wrong(), r"'mean_speed' has the shape \(3,\), expected \(\) for the dimensions \(\)"),
        (_Missing(), r"'mean_speed' is missing; frame\(\) returned \['speed'\]"),
    ],
)
def test_wrong_results_are_errors_of_the_program(analysis, message):
    with pytest.raises(TypeError, match=message):
        analysis.run(_scene(), on_error="skip")


class _Listed(_MeanSpeed):
    """Numbers of any length, a dimension whose length is that of the longest step."""

    def rows(self, scene):
        return {"fast": xcg.Variable(("fast",), "m s^-1", "fast ones")}

    def frame(self, frame, lattice, source):
        speed = np.linalg.norm(frame["velocity"], axis=1)
        return {"fast": speed[speed > 1.5]}


class _Counted(_Listed):
    def sizes(self, scene, ds):
        return {"fast": None}


def test_dimensions_without_a_length_are_named():
    ds = _scene()
    with pytest.raises(TypeError, match=r"'fast' of 'fast' has no length; return one in sizes"):
        _Listed().run(ds)
    most = (np.linalg.norm(ds.velocity, axis=2) > 1.5).sum(axis=1).max()
    assert _Counted().run(ds).sizes["fast"] == most
    for lazy in (ds.chunk(time=2), ds.assign(box=ds.box.chunk())):
        with pytest.raises(TypeError, match="'fast' of a lazy scene has no length"):
            _Counted().run(lazy)


@dataclass(frozen=True)
class _Weighted(xcg.FrameAnalysis):
    optional = ("frozen",)

    def reads(self, scene):
        return ["diameter"]

    def rows(self, scene):
        return {"known": xcg.Variable((), "1", "whether there is a variable", "int64")}

    def frame(self, frame, lattice, source):
        return {"known": int("frozen" in frame) + 2 * self.setup.dimension}


def test_optional_variables_are_read_where_the_scene_has_them():
    ds = xcg.datasets.random_scene(5)
    assert _Weighted().run(ds).known.values.tolist() == [6]
    frozen = xr.zeros_like(ds["particle_id"])
    assert _Weighted().run(ds.assign(frozen=frozen)).known.values.tolist() == [7]
    layer = xcg.scene_from_arrays([[0.0, 0.0, 0.0]], diameter=[1.0], dimension=2)
    assert _Weighted().run(layer).known.values.tolist() == [4]
