"""Steps of so many contacts that their segments are not kept: each bit is that of segments that are."""

from unittest import mock

import numpy as np
import pytest
import xarray as xr

import xcg
from tests import planning, sharing_threads
from xcg.fields import segments

SCENES = {
    "periodic": {"particles": 260},
    "walls": {"particles": 260, "periodic": "x"},
    "plane": {"particles": 200, "dimension": 2},
}
CALLS = {
    "all fields": {"width": 0.3, "rtol": 1e-3},
    "points and closed form": {
        "fields": "contact_stress",
        "width": 0.12,
        "spacing": 0.4,
        "rtol": 1e-2,
    },
    "widths by phase, by pair": {
        "fields": ["contact_stress", "density"],
        "by": "species",
        "by_pair": True,
        "width": {1: 0.2, 2: 0.35},
    },
    "two segments a contact": {
        "fields": ["couple_stress", "heat_flux", "weak_contact_stress"],
        "width": 0.4,
    },
    "a kernel that wraps": {"fields": "stress", "width": 2.2, "spacing": 0.9},
    "averages along axes": {"fields": "contact_stress", "axes": "x", "width": 0.3},
    "points": {"fields": "contact_stress", "width": 0.4, "at": "points"},
}


@pytest.fixture(scope="module", params=SCENES)
def scene(request):
    return xcg.datasets.random_scene(seed=3, **SCENES[request.param])


def same_bits(one, other):
    for name in one:
        assert one[name].values.tobytes() == other[name].values.tobytes(), name


def anew(found):
    """List few contacts at a time, of any number; `found` gets those that are listed."""

    def near(self, nodes, listed=segments.ListedAnew.near):
        for some in listed(self, nodes):
            found.append(len(some.records))
            yield some

    return mock.patch.multiple(segments, MOST_LISTED_ONCE=0, _TOGETHER=2), mock.patch.object(
        segments.ListedAnew, "near", near
    )


@pytest.mark.parametrize("call", CALLS)
def test_segments_listed_anew_have_the_same_bits(scene, call):
    given = dict(CALLS[call])
    if call == "points":
        places = np.random.default_rng(0).uniform(0.0, 5.0, (scene.attrs["dimension"], 90))
        given["at"] = {
            a: xr.DataArray(x, dims="point") for a, x in zip("xyz", places, strict=False)
        }
    kept = scene.cg.coarse_grain(**given)
    found = []
    few = sharing_threads(2)
    some, told = anew(found)
    with planning(BLOCK_NODES=300), few, some, told:
        same_bits(kept, scene.cg.coarse_grain(**given))
    assert max(found) <= 2 * segments.RUN
    assert len(found) > 1


def test_long_branches_are_listed_once():
    """A branch that is cut where the mesh ends: all segments are kept, whatever their number."""
    ds = xcg.datasets.random_scene(120, periodic="")
    ds["contact_point"][0, 0] = 1e4
    given = {"fields": "contact_stress", "width": 0.3}
    with pytest.warns(UserWarning, match="diameters from the centre"):
        kept = ds.cg.coarse_grain(**given)
    some, told = anew(found := [])
    with pytest.warns(UserWarning, match="diameters from the centre"), some, told:
        same_bits(kept, ds.cg.coarse_grain(**given))
    assert not found
