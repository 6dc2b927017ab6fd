from __future__ import annotations

import numpy as np
import pytest

from tests import real_data
from tests.dumps import dump_text, pairs_text, write
from xcg.common.messages import SceneError
from xcg.readers.engine import ReadOptions
from xcg.readers.engines.liggghts import Liggghts
from xcg.readers.open import open_scene
from xcg.scene.lattice import minimum_image

liggghts = Liggghts()

DEFAULTS = ReadOptions()
COLUMNS = " ".join(f"c_3[{k}]" for k in range(1, 14))
PAIR = "1 1 1 1.9 1 1 7 4 0 -3 2 1 0.1"
WALL = "1 1 0 1 1 0.45 2 5 7 0.5 0.25 8 0.05"


@pytest.fixture
def box():
    """Open the real box with pairs and walls."""
    folder = real_data("liggghts_box")
    scene = open_scene(
        folder / "compress*.liggghts.gz",
        contacts=folder / "pair*.txt.gz",
        walls=folder / "wall_pair*.txt.gz",
        density=2500,
        gravity=(0, 0, -9.81),
        timestep=1e-5,
        names={f"f{axis}": f"total_force_{axis}" for axis in "xyz"},
    )
    return scene.compute()


def test_pairs_are_read(tmp_path):
    path = str(write(tmp_path / "pair.txt", pairs_text([PAIR], COLUMNS)))
    (ref,) = liggghts.index_contacts([path], DEFAULTS)
    frame = liggghts.read_contacts(ref, DEFAULTS)
    # the normal follows from the branch where the periods are known
    assert set(frame) - {"wrapped_branch"} | {"contact_normal"} == set(
        liggghts.contact_variables(ref, DEFAULTS)
    )
    assert (frame["contact_i"], frame["contact_j"], frame["overlap"]) == (7, 4, 0.1)
    np.testing.assert_allclose(frame["wrapped_branch"], [[-0.9, 0, 0]])
    np.testing.assert_array_equal(frame["contact_force"], [[-3, 2, 1]])


def test_contacts_with_walls_are_read(tmp_path):
    path = str(write(tmp_path / "wall.txt", pairs_text([WALL], COLUMNS)))
    (ref,) = liggghts.index_walls([path], DEFAULTS)
    frame = liggghts.read_contacts(ref, DEFAULTS)
    assert (frame["contact_i"], frame["contact_j"], frame["overlap"]) == (7, -3, 0.05)
    np.testing.assert_array_equal(frame["contact_point"], [[1, 1, 0]])
    np.testing.assert_array_equal(frame["contact_force"], [[0.5, 0.25, 8]])
    np.testing.assert_allclose(frame["wrapped_branch"], [[0, 0, 0.45]])


def test_contacts_without_overlap_are_read(tmp_path):
    text = pairs_text([PAIR.rsplit(" ", 1)[0]], COLUMNS.rsplit(" ", 1)[0])
    (ref,) = liggghts.index_contacts([str(write(tmp_path / "pair.txt", text))], DEFAULTS)
    assert set(liggghts.read_contacts(ref, DEFAULTS)) == {
        "contact_i",
        "contact_j",
        "contact_force",
        "wrapped_branch",
    }


def test_other_layouts_of_columns_are_mapped(tmp_path):
    columns = " ".join(f"c_3[{k}]" for k in range(1, 7))
    path = str(write(tmp_path / "pair.txt", pairs_text(["1 2 0 4 5 6"], columns)))
    with pytest.raises(SceneError, match=r"6 columns .* not known; give the words .*names="):
        liggghts.index_contacts([path], DEFAULTS)
    names = {"c_3[1]": "contact_i", "c_3[2]": "contact_j"}
    names |= {f"c_3[{k}]": f"contact_force_{axis}" for k, axis in enumerate("xyz", 4)}
    (ref,) = liggghts.index_contacts([path], ReadOptions(names))
    frame = liggghts.read_contacts(ref, ReadOptions(names))
    np.testing.assert_array_equal(frame["contact_force"], [[4, 5, 6]])


def test_engine_is_guessed_from_contacts(tmp_path):
    rows = ["7 1 1 1 1 0.5", "4 1 1.9 1 1 0.5"]
    particles = write(tmp_path / "p.dump", dump_text(rows, "id type x y z radius"))
    pairs = write(tmp_path / "pair.txt", pairs_text([PAIR], COLUMNS))
    walls = write(tmp_path / "wall.txt", pairs_text([WALL], COLUMNS.replace("c_3", "c_4")))
    scene = open_scene(particles, pairs, walls).compute()
    np.testing.assert_array_equal(scene.contact_j, [[4, -3]])
    np.testing.assert_allclose(scene.contact_point[0], [[1.45, 1, 1], [1, 1, 0]])
    np.testing.assert_array_equal(scene.overlap, [[0.1, 0.05]])
    only_walls = open_scene(particles, walls=walls, engine="liggghts").compute()
    np.testing.assert_array_equal(only_walls.contact_j, [[-3]])
    # pairs without overlap: no overlap at all, rather than gaps
    short = pairs_text([PAIR.rsplit(" ", 1)[0]], COLUMNS.rsplit(" ", 1)[0])
    mixed = open_scene(particles, contacts=write(tmp_path / "short.txt", short), walls=walls)
    assert "overlap" not in mixed
    assert mixed.compute().sizes["contact"] == 2


def test_walls_are_for_engines_that_keep_them_apart(tmp_path):
    path = write(tmp_path / "p.dump", dump_text())
    with pytest.raises(
        SceneError, match="walls=: the engine 'lammps' reads contacts with walls among"
    ):
        open_scene(path, walls=path, engine="lammps")


def test_contact_forces_sum_to_the_forces_on_particles(box):
    """Contact forces, with walls, and weight make the dumped force (written with 6 digits)."""
    for t in range(box.sizes["time"]):
        step = box.isel(time=t)
        valid = step.contact_i.values >= 0
        i, j, force = (
            step[name].values[valid] for name in ("contact_i", "contact_j", "contact_force")
        )
        ids = step.particle_id.values
        total = step.mass.values[:, None] * step.gravity
        np.add.at(total, np.searchsorted(ids, i), force)
        pairs = j >= 0
        np.add.at(total, np.searchsorted(ids, j[pairs]), -force[pairs])
        dumped = np.stack([step[f"total_force_{axis}"].values for axis in "xyz"], axis=1)
        error = np.linalg.norm(total - dumped, axis=1) / np.linalg.norm(force, axis=1).mean()
        assert np.median(error) < 1e-5
        assert (
            np.sqrt(np.mean(error**2)) < 3e-3
        )  # a few contacts of the first frame are not settled


def test_contact_points_lie_half_an_overlap_inside(box):
    """Pairs meet at R - overlap/2 from both centres, walls at R - overlap."""
    step = box.isel(time=0)
    valid = step.contact_i.values >= 0
    i, j, point, overlap = (
        step[name].values[valid] for name in ("contact_i", "contact_j", "contact_point", "overlap")
    )
    period = np.array([0.05, 0.05, np.inf])
    row = np.searchsorted(step.particle_id.values, i)
    radius = step.diameter.values[row] / 2
    arm = np.linalg.norm(minimum_image(point - step.position.values[row], period), axis=1)
    np.testing.assert_allclose(arm, radius - np.where(j < 0, overlap, overlap / 2), atol=2e-8)
    assert (j[j < 0] == -1).all()


def test_normals_of_pairs_and_walls(box):
    """Normals of pairs from the file's positions are those of the particles; those of walls point off the wall."""
    step = box.isel(time=0)
    valid = step.contact_i.values >= 0
    i, j, point, normal = (
        step[name].values[valid]
        for name in ("contact_i", "contact_j", "contact_point", "contact_normal")
    )
    arm = minimum_image(
        step.position.values[np.searchsorted(step.particle_id.values, i)] - point,
        np.array([0.05, 0.05, np.inf]),
    )
    arm /= np.linalg.norm(arm, axis=1, keepdims=True)
    np.testing.assert_allclose(normal[j >= 0], arm[j >= 0], atol=1e-4)
    np.testing.assert_allclose(normal[j < 0], np.tile([0, 0, 1.0], ((j < 0).sum(), 1)), atol=1e-3)


def test_time_and_density_are_read(box):
    np.testing.assert_allclose(box.time, [0.5])
    assert box.time.attrs["units"] == "s"
    np.testing.assert_allclose(box.mass, 2500 * np.pi / 6 * box.diameter**3)
