"""A scene is described once, by what is known without reading it."""

import dask
import numpy as np
import pytest

import xcg
from xcg import SceneError
from xcg.fields.plan import make_plan
from xcg.fields.request import Request
from xcg.scene.conform import require_scene
from xcg.scene.description import describe


def _refuse_to_compute(dsk, keys, **kwargs):
    raise AssertionError("something was computed")


@pytest.mark.parametrize("options", [{}, {"dimension": 2}, {"periodic": "xy"}, {"walls": False}])
def test_a_scene_in_memory_and_in_chunks_are_described_alike(options):
    ds = xcg.datasets.random_scene(40, **options)
    with dask.config.set(scheduler=_refuse_to_compute):
        lazy = describe(ds.chunk(time=1), by="species")
    assert lazy == describe(ds, by="species")


def test_lazy_files_are_described_without_reading_them():
    ds = xcg.datasets.open("segregation")
    with dask.config.set(scheduler=_refuse_to_compute):
        scene = describe(ds, by="species")
    assert scene.values == {"species": (1, 2)}
    assert scene.steps == 9
    low, high = (np.array(corner) for corner in scene.corners)
    assert (low < high).all()


def test_a_plan_is_made_without_the_dataset():
    """Equal descriptions and requests give plans of the same shape, whatever the grains are."""
    one, other = (xcg.datasets.random_scene(40, seed=3) for _ in range(2))
    request = Request(["stress", "velocity"], axes="z", width=1.0, spacing=0.5)
    first, second = (make_plan(describe(ds), request) for ds in (one, other))
    assert (first.shapes, first.variables, first.extent) == (second.shapes, second.variables, second.extent)
    assert describe(one) == describe(other)


def test_missing_variables_are_named_with_a_remedy():
    scene = describe(xcg.datasets.random_scene(40).drop_vars(["contact_force", "mass"]))
    with pytest.raises(
        SceneError, match=r"stress needs \['contact_force', 'mass'\]: give contacts= .* and density= to "
    ):
        require_scene(scene.columns, ["contact_force", "mass"], "stress")
