"""Points where spheres touch: the loop against NumPy."""

import numpy as np
import pytest

import xcg
from xcg.scene import contact_points
from xcg.scene.complete_contacts import complete_contacts
from xcg.scene.lattice import Lattice
from xcg.scene.schema import Setup
from xcg.scene.spheres import SphereContacts


@pytest.mark.parametrize("periodic", ["", "x", "xy", "xyz"])
@pytest.mark.parametrize("seen", [False, True])
def test_fast_and_careful_contact_points_agree(periodic, seen, monkeypatch):
    """A loop derives points up to a pair in doubt; NumPy derives, or refuses, those of its block: the same bits."""
    rng = np.random.default_rng(len(periodic))
    plain = []
    for edge in np.geomspace(1.5, 30.0, 40):
        position = rng.uniform(0.0, edge, (20, 3))
        diameter = rng.uniform(0.3, 1.5, 40)
        position = np.concatenate(
            [position, (position + rng.normal(scale=0.5, size=(20, 3))) % edge]
        )
        i, j = np.arange(40).reshape(2, 20)
        box = np.array([[0.0, edge]] * 3)
        lattice = Lattice.of({"box": box}, periodic)
        given = {"contact_i": i, "contact_j": j, "contact_force": rng.normal(size=(20, 3))}
        if seen:
            given["contact_branch"] = lattice.shortest(position[i] - position[j]) * rng.uniform(
                0.8, 1.2, (20, 1)
            )
        particles = {"particle_id": np.arange(40), "position": position, "diameter": diameter}
        found = []
        for closer in (False, True):
            with monkeypatch.context() as only:
                if closer:
                    only.setattr(contact_points, "_plain_points", lambda *_: None)
                try:
                    points = complete_contacts(given, particles, lattice, Setup.make(), "box")[
                        "contact_point"
                    ]
                    found.append(points.tobytes())
                except xcg.SceneError as error:
                    found.append(str(error))
        assert found[0] == found[1]
        spheres = SphereContacts(
            given, i, particles, i, j, given.get("contact_branch"), lattice, ""
        )
        plain.append(contact_points._plain_points(spheres, np.arange(20)) is not None)
    assert any(plain)
    assert not periodic or seen or not all(plain)
