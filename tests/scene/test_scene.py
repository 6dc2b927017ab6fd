"""A scene is asked for what is known of it, without reading it."""

import numpy as np
import pytest

import xcg
from tests import raise_if_dask_computes
from xcg import SceneError
from xcg.fields.plan import make_plan
from xcg.fields.request import Request
from xcg.scene.scene import Scene

FACTS = (
    "setup", "edges", "periods", "lasting_periods", "box_lasts", "tilted", "sizes", "corners",
    "cylindrical", "radius", "rows", "layer_depth",
)  # fmt: skip


def facts_of(ds):
    """Return what a scene is asked for, and the values of its species."""
    scene = Scene(ds)
    return {name: getattr(scene, name) for name in FACTS} | {"species": scene.values("species")}


@pytest.mark.parametrize("options", [{}, {"dimension": 2}, {"periodic": "xy"}, {"walls": False}])
def test_a_scene_in_memory_and_in_chunks_answer_alike(options):
    ds = xcg.datasets.random_scene(40, **options)
    with raise_if_dask_computes():
        lazy = facts_of(ds.chunk(time=1))
    in_memory = facts_of(ds)
    # of a lazy scene the distance of the farthest corner
    assert lazy.pop("radius") >= in_memory.pop("radius")
    assert lazy == in_memory


def test_lazy_files_are_not_read():
    ds = xcg.datasets.open("segregation")
    with raise_if_dask_computes():
        facts = facts_of(ds)
    assert facts["species"] == [1, 2]
    low, high = (np.array(corner) for corner in facts["corners"])
    assert (low < high).all()


def test_grains_are_measured_once_and_only_where_sizes_are_asked_for(monkeypatch):
    """Printing a scene and fields with a width and bounds of their own look at no grain."""
    ds = xcg.datasets.random_scene(40, periodic="xyz")
    looks = []
    ends = Scene._ends
    monkeypatch.setattr(Scene, "_ends", lambda *args: looks.append(1) or ends(*args))
    print(ds.cg)
    ds.cg.derive("coordination_number")
    assert looks == []
    ds.cg.coarse_grain("velocity", axes="z")
    assert looks == [1]


def test_a_plan_is_made_without_reading():
    """Equal scenes and requests give plans of the same shape, whatever the grains are."""
    one, other = (xcg.datasets.random_scene(40, seed=3).chunk(time=1) for _ in range(2))
    request = Request(["stress", "velocity"], axes="z", width=1.0, spacing=0.5)
    with raise_if_dask_computes():
        first, second = (make_plan(Scene(ds), request) for ds in (one, other))
    assert (first.shapes, first.variables, first.extent) == (
        second.shapes,
        second.variables,
        second.extent,
    )


def test_missing_variables_are_named_with_a_remedy():
    scene = Scene(xcg.datasets.random_scene(40).drop_vars(["contact_force", "mass"]))
    with pytest.raises(
        SceneError,
        match=r"stress needs \['contact_force', 'mass'\]: give contacts= .* and density= to ",
    ):
        scene.require(["contact_force", "mass"], "stress")


def test_variables_that_tasks_make_need_not_be_there():
    ds = xcg.datasets.random_scene(40).drop_vars("velocity")
    scene = Scene(ds, made={"velocity": ds.variables["position"]}, lag=2)
    scene.require(["velocity"], "displacement")
    assert "velocity" in scene.rows
    assert scene.lag == 2
