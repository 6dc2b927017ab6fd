from __future__ import annotations

import numpy as np
import pytest

import xcg
from xcg import BoxRegion, Sphere
from xcg.scene.lattice import Lattice

OPEN = np.full(3, np.inf)
FRAME = {
    "particle_id": np.array([2, 5, 7, 11]),
    "position": np.array([[0.5, 0.5, 0.5], [1.5, 0.5, 0.5], [3.9, 0.5, 0.5], [2.0, 2.0, 2.0]]),
}


def inside(region, time=0.0, period=OPEN):
    return FRAME["particle_id"][region.contains(FRAME, time, Lattice(period))].tolist()


def test_box():
    assert inside(BoxRegion((0, 0, 0), (1.5, 1, 1))) == [2, 5]  # faces belong to it
    assert inside(BoxRegion((1, -np.inf, -np.inf), (np.inf, np.inf, np.inf))) == [5, 7, 11]
    assert inside(BoxRegion((1, 0, 0), (2, 1, 1), velocity=(2, 0, 0)), time=1.0) == [7]
    assert inside(BoxRegion((-2, -1, -1), (2, 1, 1), follow=5)) == [2, 5]
    assert inside(BoxRegion((-2, -1, -1), (2, 1, 1), follow=3)) == []


def test_sphere():
    assert inside(Sphere((0.5, 0.5, 0.5), 1.0)) == [2, 5]
    assert inside(Sphere((0.5, 0.5, 0.5), 0.5, velocity=(1, 0, 0)), time=1.0) == [5]
    assert inside(Sphere((0, 0, 0), 2.4, follow=7)) == [5, 7]


def test_periodic_images_count():
    period = np.array([4.0, np.inf, np.inf])
    assert inside(Sphere((0, 0.5, 0.5), 0.5), period=period) == [2, 7]
    assert inside(BoxRegion((-0.2, 0, 0), (0.2, 1, 1)), period=period) == [7]
    assert inside(BoxRegion((0, 0, 0), (1, 1, 1), velocity=(4, 0, 0)), time=3.0, period=period) == [2]


def test_combinations():
    left, low = BoxRegion((0, 0, 0), (2, 4, 4)), BoxRegion((0, 0, 0), (4, 1, 1))
    assert inside(left & low) == [2, 5]
    assert inside(left | low) == [2, 5, 7, 11]
    assert inside(left & ~low) == [11]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: BoxRegion((0, 0), (1, 1, 1)), r"lower=\(0, 0\): expected three numbers"),
        (lambda: BoxRegion((0, 0, 2), (1, 1, 1)), "expected every lower edge below the upper"),
        (lambda: Sphere((0, 0, 0), 0), "radius=0: expected a positive length"),
        (lambda: Sphere((0, 0, np.nan), 1), "centre=.*expected three finite numbers"),
        (lambda: Sphere((0, 0, 0), 1, velocity=(1, 0, 0), follow=3), "expected one of the two"),
    ],
)
def test_wrong_regions(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_the_old_name_stays_for_a_release():
    assert xcg.Box is xcg.BoxRegion
