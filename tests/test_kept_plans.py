"""Equal calls share their plan: what was changed in between, wherever it is held, changes the result all the same."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xcg
from xcg.fields import kept
from xcg.fields.kept import prepare_call
from xcg.fields.request import Request
from xcg.steps.label import _layouts

NAMES = ["volume_fraction", "velocity", "stress"]


@pytest.fixture(autouse=True)
def _nothing_kept() -> Iterator[None]:
    kept._kept.clear()
    yield
    kept._kept.clear()


@pytest.fixture
def scene() -> xr.Dataset:
    """Grains of two species, some of which lie near the edges of their extent."""
    return xcg.datasets.random_scene(30, periodic="x", seed=3)


def told(f: xr.Dataset) -> dict[str, Any]:
    """All that a result tells besides its numbers, without the moment of the call."""
    attrs = {name: value for name, value in f.attrs.items() if name != "history"}
    variables = {name: (given.dims, given.attrs, given.encoding) for name, given in f.variables.items()}
    indexes = {name: type(index) for name, index in f.indexes.items()}
    return {"attrs": {name: repr(value) for name, value in attrs.items()}, "variables": variables, "indexes": indexes}


def assert_same(one: xr.Dataset, other: xr.Dataset) -> None:
    xr.testing.assert_identical(one.drop_attrs(deep=False), other.drop_attrs(deep=False))
    assert told(one) == told(other)
    for name, given in one.variables.items():
        assert given.to_numpy().tobytes() == other.variables[name].to_numpy().tobytes()  # signs of zeros, too


def test_equal_calls_share_a_plan(scene: xr.Dataset) -> None:
    first = prepare_call(scene, Request(NAMES, axes="z"))
    assert prepare_call(scene.copy(), Request(list(NAMES), axes="z"))[0] is first[0]
    assert prepare_call(scene, Request(NAMES, axes="x"))[0] is not first[0]


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"fields": NAMES, "axes": "z", "by": "species"},
        {"fields": ["stress", "contact_stress_by_pair"], "axes": "xz", "by": "species", "by_pair": True},
        {"fields": xcg.Mean("species"), "at": {"y": 2.0}, "axes": "x"},
        {"fields": NAMES, "kernel": xcg.Gaussian(0.9), "sampling": "cell", "axes": "y"},
        {"fields": NAMES, "at": {a: xr.DataArray([1.0, 2.0], dims="probe") for a in "xyz"}},
        {"fields": NAMES, "frame": xcg.Rotated(z=(0, 1, 1)), "axes": "z", "extent": {"x": 5.0, "y": 5.0}},
        {"fields": NAMES, "axes": "z", "on_error": "skip"},
        {"preset": "pysammos", "fields": ["pressure_xyz"]},
    ],
    ids=str,
)
def test_a_result_by_a_kept_plan_is_that_of_a_new_one(scene: xr.Dataset, options: dict[str, Any]) -> None:
    new = scene.cg.coarse_grain(**options)
    assert_same(scene.cg.coarse_grain(**options), new)


def _replaced(name: str, change: Callable[[np.ndarray], None]) -> Callable[[xr.Dataset], None]:
    def act(ds: xr.Dataset) -> None:
        change(ds[name].values)  # in place

    return act


CHANGES: dict[str, Callable[[xr.Dataset], Any]] = {
    "positions": _replaced("position", lambda p: p.__iadd__(0.4)),
    "diameters": _replaced("diameter", lambda d: d.__imul__(1.5)),
    "box": _replaced("box", lambda b: b.__imul__(1.25)),
    "species": _replaced("species", lambda s: s.__iadd__(3)),
    "forces": _replaced("contact_force", lambda f: f.__imul__(2.0)),
    "size": lambda ds: ds.attrs.update(d43=ds.attrs["d43"] * 0.9),
    "size as an array": lambda ds: ds.attrs.update(d43=np.float64(ds.attrs["d43"])),
    "unit system": lambda ds: ds.attrs.update(unit_system="reduced"),
    "gravity": lambda ds: ds.attrs.update(gravity=np.array([0.0, 0.0, -9.81])),
    "periodic": lambda ds: ds.attrs.update(periodic="xy"),
    "time": lambda ds: ds.coords.update({"time": ("time", [4.0], {"units": "s"})}),
    "unit of time": lambda ds: ds["time"].attrs.update(units="min"),
    "unit of a variable": lambda ds: ds["species"].attrs.update(units="m"),
    "no rotation": lambda ds: ds.__delitem__("angular_velocity"),
    "numbers of steps": lambda ds: ds["step"].values.__iadd__(7),
}


@pytest.mark.parametrize("change", CHANGES)
def test_changes_in_place_are_seen(scene: xr.Dataset, change: str) -> None:
    ask: dict[str, Any] = {"fields": [*NAMES, "kinetic_energy", xcg.Mean("species")], "axes": "xz"}
    options = [ask, ask | {"by": "species"}]
    for each in options:
        scene.cg.coarse_grain(**each)
    CHANGES[change](scene)
    for each in options:
        found = scene.cg.coarse_grain(**each)
        kept._kept.clear()
        assert_same(found, scene.cg.coarse_grain(**each))


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ({"rtol": 0}, {"rtol": 0.0}),
        ({"bounds": {"z": (0.0, 4.0)}}, {"bounds": {"z": (-0.0, 4.0)}}),
        ({"width": 0.8}, {"width": np.float32(0.8)}),
        ({"kernel": xcg.Lucy(0.8)}, {"kernel": xcg.Heaviside(0.8)}),
        ({"kernel": xcg.Lucy(0.8)}, {"kernel": xcg.Lucy(0.8, dimension=2)}),
        ({"at": {"y": 1}}, {"at": {"y": 2}}),
    ],
    ids=str,
)
def test_equal_arguments_are_the_same_in_each_bit(
    scene: xr.Dataset, one: dict[str, Any], other: dict[str, Any]
) -> None:
    scene.cg.coarse_grain(NAMES, axes="z", **one)
    found = scene.cg.coarse_grain(NAMES, axes="z", **other)
    kept._kept.clear()
    assert_same(found, scene.cg.coarse_grain(NAMES, axes="z", **other))


def test_a_list_of_fields_may_grow_between_calls(scene: xr.Dataset) -> None:
    names = ["density"]
    scene.cg.coarse_grain(names, axes="z")
    names.append("velocity")
    assert list(scene.cg.coarse_grain(names, axes="z").data_vars) == names


def test_fields_and_kernels_that_are_registered_anew_are_seen(scene: xr.Dataset) -> None:
    highest = []
    for factor, power in ((2.0, 3), (3.0, 5)):
        xcg.register_field("kept_multiple", lambda f, s, o, k=factor: k * f.density, fields="density", additive=True)
        xcg.register_kernel("kept powers", lambda q, n=power: (1 - q * q) ** n)
        f = scene.cg.coarse_grain(["kept_multiple", "density"], kernel="kept powers", axes="z")
        np.testing.assert_array_equal(f.kept_multiple, factor * f.density)
        highest.append(float(f.density.max()))
    assert highest[1] > 1.02 * highest[0]  # a narrower kernel


def test_equal_calls_warn_each_time(scene: xr.Dataset) -> None:
    for _ in range(3):
        with pytest.warns(xcg.SceneWarning, match="the inside of single grains"):
            scene.cg.coarse_grain(NAMES, axes="z", width=0.05)


def test_results_of_one_plan_share_nothing_that_can_be_changed(scene: xr.Dataset) -> None:
    new, first = (ds.cg.coarse_grain(NAMES) for ds in (scene, scene.copy(deep=True)))
    want = new.copy(deep=True)
    for given in first.variables.values():
        given.attrs["units"] = "changed"
        given.encoding["dtype"] = "float32"
    first.attrs.clear()
    first["velocity"].values[:] = 0.0
    first["step"].values[:] = 99  # which is a plain array, as coordinates of points are
    for name in ("x", "component", "time"):  # which pandas holds, and gives read-only or as copies
        with suppress(ValueError):
            first[name].values[0] = first[name].values[-1]
    for found in (new, scene.cg.coarse_grain(NAMES)):
        assert_same(found, want)


def test_coordinates_of_one_scene_are_not_those_of_another(scene: xr.Dataset) -> None:
    twin, at = scene.copy(deep=True), {"x": 1.0, "y": 2.0}
    new = twin.cg.coarse_grain(NAMES, at=at)
    kept._kept.clear()
    first = scene.cg.coarse_grain(NAMES, at=at)
    scene["step"].values[:] = 5
    for name in ("step", "x", "y"):
        first[name].values[...] = 7
    assert_same(twin.cg.coarse_grain(NAMES, at=at), new)


def test_steps_without_times_are_counted() -> None:
    places = np.random.default_rng(0).uniform(0.0, 5.0, (2, 20, 3))
    ds = xcg.scene_from_arrays(list(places), diameter=[np.full(20, 0.5)] * 2, density=1.0).drop_vars(["time", "step"])
    for part in (ds, ds.isel(time=[1]), ds):
        f = part.cg.coarse_grain("density", width=2.0, at={"x": 2.5, "y": 2.5, "z": 2.5})
        assert f.density.shape == (part.sizes["time"],)


def test_no_array_is_kept_alive() -> None:
    scene = xcg.datasets.random_scene(30)
    f = scene.cg.coarse_grain(NAMES)
    assert kept._kept
    arrays = [weakref.ref(given.to_numpy()) for given in (*scene.data_vars.values(), *f.data_vars.values())]
    del scene, f
    gc.collect()
    assert not any(array() is not None for array in arrays)


def test_few_plans_are_kept(scene: xr.Dataset) -> None:
    for number in range(2 * kept._PLANS):
        scene.attrs["number"] = number
        prepare_call(scene, Request("density", axes="z"))
    for number in range(2 * kept._LAYOUTS):
        prepare_call(scene.assign_coords(time=[float(number)]), Request("density", axes="z"))
    assert len(kept._kept) == kept._PLANS
    assert max(len(one.layouts) for one in kept._kept.values()) == kept._LAYOUTS


def test_lazy_scenes_are_planned_anew(scene: xr.Dataset) -> None:
    lazy = scene.chunk(time=1)
    assert_same(lazy.cg.coarse_grain(NAMES, axes="z").compute(), scene.cg.coarse_grain(NAMES, axes="z"))
    kept._kept.clear()
    lazy.cg.coarse_grain(NAMES, axes="z")
    assert not kept._kept


# --- layouts of force chains and stresses of particles ----------------------------------------------------


@pytest.fixture
def _no_layouts() -> Iterator[None]:
    _layouts.clear()
    yield
    _layouts.clear()


def chains_made_anew(ds: xr.Dataset, **options: Any) -> xr.Dataset:
    _layouts.clear()
    return ds.cg.force_chains(**options)


OF_CHAINS: list[Callable[[xr.Dataset], Any]] = [
    lambda ds: None,
    lambda ds: ds.attrs.update(unit_system="lj"),
    lambda ds: ds["time"].attrs.update(units="ms"),
    lambda ds: ds["box"].attrs.update(comment="it moved"),
    lambda ds: ds["box"].values.__setitem__((0, 0, 1), 6.0),
    lambda ds: ds["contact_force"].values.__imul__(2.0),
    lambda ds: ds["position"].values.__setitem__((0, 0), 0.25),
]


@pytest.mark.usefixtures("_no_layouts")
@pytest.mark.parametrize("change", OF_CHAINS)
def test_chains_of_kept_layouts_are_those_of_new_ones(scene: xr.Dataset, change: Callable[[xr.Dataset], Any]) -> None:
    """In each bit, and in what they tell, whatever is changed in the scene between two calls."""
    scene.cg.force_chains()
    assert len(_layouts) == 1
    change(scene)
    found = scene.cg.force_chains()
    assert_same(found, chains_made_anew(scene))


@pytest.mark.usefixtures("_no_layouts")
def test_times_and_sizes_have_layouts_of_their_own(scene: xr.Dataset) -> None:
    later = scene.assign_coords(time=scene.time + 1.0)
    for ds in (scene, later, xcg.datasets.random_scene(31, seed=3)):
        for options in ({}, {"min_length": 4}):
            ds.cg.force_chains(**options)
            found = ds.cg.force_chains(**options)
            assert_same(found, chains_made_anew(ds, **options))
    stress = scene.cg.particle_stress()
    assert_same(scene.cg.particle_stress(), stress)
    assert "chain_id" not in stress


@pytest.mark.usefixtures("_no_layouts")
def test_chains_do_not_share_what_can_be_changed(scene: xr.Dataset) -> None:
    """What is done to one result is not seen in the next: numbers, attributes, coordinates."""
    first = scene.cg.force_chains()
    expected = first.copy(deep=True)
    second = scene.cg.force_chains()
    for name in second.data_vars:
        if name not in scene:  # those of the scene are its own
            second[name].values[...] = 7
        second[name].attrs["units"] = "none"
    second.attrs["alpha"] = 0.0
    for name in second.coords:
        second[name].attrs["long_name"] = "none"
        if second[name].values.flags.writeable and name not in second.indexes:
            second[name].values[...] = second[name].values[::-1]
    assert_same(scene.cg.force_chains(), expected)
