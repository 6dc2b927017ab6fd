from __future__ import annotations

import numpy as np
import pytest

import xcg
from tests import ROOT
from tests.networks import network
from xcg.compiled.matrices import principal

EXAMPLES = ROOT / "examples" / "data"


@pytest.mark.parametrize("periodic", ["", "xy", "xyz"])
def test_stress_equals_brute_force(periodic):
    """Loop over contacts, both sides, walls, nearest images."""
    ds = xcg.datasets.random_scene(80, seed=3, periodic=periodic)
    stress = np.zeros((80, 3, 3))
    x = ds.position.values[0]
    volume = ds.volume.values[0]
    period = np.array([5.0 if a in periodic else np.inf for a in "xyz"])
    names = ("contact_i", "contact_j", "contact_force", "contact_point")
    for i, j, f, c in zip(*(ds[name].values[0] for name in names), strict=True):
        for row, force in ((i, f), (j, -f)):
            if row >= 0:
                a = x[row] - c
                a = a - np.where(np.isfinite(period), period, 0) * np.rint(a / period)
                stress[row] += np.outer(force, a) / volume[row]
    result = ds.cg.particle_stress()
    symmetric = 0.5 * (stress + stress.transpose(0, 2, 1))
    np.testing.assert_allclose(result.stress.values[0], symmetric, rtol=1e-12, atol=1e-12)
    values = result.principal_stress.values[0]
    vectors = result.principal_direction.values[0]
    np.testing.assert_allclose(values, np.linalg.eigvalsh(symmetric)[:, ::-1], rtol=1e-9, atol=1e-9)
    touched = symmetric.any(axis=(1, 2))
    rebuilt = np.einsum("nk,nki,nkj->nij", values, vectors, vectors)[touched]
    np.testing.assert_allclose(rebuilt, symmetric[touched], rtol=1e-9, atol=1e-9)
    assert np.isnan(vectors[~touched]).all()
    np.testing.assert_array_equal(result.major_stress.values[0], values[:, 0])


def test_virial_equals_that_of_the_code():
    """The sum of stress times volume over all grains is minus the sum of LAMMPS's own stress/atom."""
    folder = EXAMPLES / "lammps_biaxial2d"
    ds = xcg.open_scene(
        folder / "particles.*.dump.gz",
        contacts=folder / "contacts.*.dump.gz",
        periodic="x",
        names={f"c_sa[{k}]": f"stress_{k}" for k in range(1, 7)},
    ).compute()
    total = (ds.cg.particle_stress().stress * ds.volume).sum("particle").values
    # its order is xx yy zz xy xz yz; of the two unequal values that friction leaves it takes one
    np.testing.assert_allclose(total[:, 0, 0], -ds.stress_1.sum("particle"), rtol=1e-6)
    np.testing.assert_allclose(total[:, 1, 1], -ds.stress_2.sum("particle"), rtol=1e-6)
    np.testing.assert_allclose(total[:, 0, 1], -ds.stress_4.sum("particle"), rtol=5e-3)


def test_uniform_packing():
    ds = xcg.datasets.simple_cubic(4, diameter=0.5, force=2.0)
    result = ds.cg.particle_stress()
    np.testing.assert_allclose(result.principal_stress, 2.0 * 0.5 / (np.pi / 6 * 0.125), rtol=1e-12)
    assert result.major_stress.attrs["units"] == "Pa"


def test_discs_take_the_thickness_of_the_layer():
    chain = {"position": [(0, 0), (1, 0), (2, 0)], "pairs": [(0, 1), (1, 2)], "force": [1, 1]}
    thick = network(**chain, dimension=2, thickness=0.3)
    found = thick.cg.particle_stress(volume="disc").major_stress.values[0]
    np.testing.assert_allclose(found, np.array([0.5, 1, 0.5]) / (np.pi / 4 * 0.3))
    box = network(**chain, dimension=2, box={"z": (0, 0.2)})
    found = box.cg.particle_stress(volume="disc").major_stress.values[0]
    np.testing.assert_allclose(found, np.array([0.5, 1, 0.5]) / (np.pi / 4 * 0.2))
    with pytest.raises(xcg.SceneError, match="volume='disc' is for one-layer scenes"):
        network(**chain).cg.particle_stress(volume="disc")


def test_branches_follow_from_overlaps():
    """Rounded positions do not matter where the overlap is known; other bodies keep their contact points."""
    overlap = np.array([0.1, 0.1])
    position = np.array([(0.0, 0, 0), (0.9004, 0, 0), (1.8, 0, 0)])
    given = {"diameter": np.ones(3), "density": 1.0, "contact_i": [0, 1], "contact_j": [1, 2]}
    given["contact_force"] = [[-1.0, 0, 0], [-1.0, 0, 0]]
    volume = np.pi / 6
    ds = xcg.scene_from_arrays(position, overlap=overlap, **given)
    np.testing.assert_allclose(
        ds.cg.particle_stress().major_stress.values[0] * volume, [0.45, 0.9, 0.45], rtol=1e-12
    )
    long = xcg.scene_from_arrays(
        position, overlap=overlap, contact_point=[[0.2, 0, 0], [1.1, 0, 0]], **given
    )
    np.testing.assert_allclose(
        long.cg.particle_stress().major_stress.values[0] * volume,
        [0.2, 0.7004 + 0.1996, 0.7],
        rtol=1e-12,
    )


def test_padding_is_nan():
    ds = xcg.scene_from_arrays(
        [[[0, 0, 0], [1, 0, 0]], [[0, 0, 0], [1, 0, 0], [5.0, 0, 0]]][0], diameter=[1, 1], density=1.0,
        contact_i=[0], contact_j=[1], contact_force=[[-1.0, 0, 0]],
    )  # fmt: skip
    padded = ds.pad(particle=(0, 1), constant_values={"particle_id": -1, "position": np.nan})
    result = padded.assign(
        particle_id=padded.particle_id.fillna(-1).astype(int)
    ).cg.particle_stress()
    assert np.isnan(result.stress.values[0, 2]).all()
    assert np.isfinite(result.stress.values[0, :2]).all()


def test_eigenvalues():
    rng = np.random.default_rng(0)
    q = np.linalg.qr(rng.normal(size=(300, 3, 3)))[0]
    d = rng.normal(size=(300, 3)) * 10.0 ** rng.integers(-8, 8, (300, 1))
    d[:50, 1] = d[:50, 0]
    d[:20] = 1.0
    d[280:, 1:] = 0
    matrix = np.einsum("nik,nk,njk->nij", q, d, q)
    values = np.empty((300, 3))
    vectors = np.empty((300, 3, 3))
    principal(matrix, values, vectors)
    scale = np.abs(d).max(axis=1, keepdims=True)
    np.testing.assert_allclose(values / scale, np.sort(d)[:, ::-1] / scale, atol=1e-14)
    np.testing.assert_allclose(
        np.einsum("nki,nli->nkl", vectors, vectors), np.tile(np.eye(3), (300, 1, 1)), atol=1e-14
    )
