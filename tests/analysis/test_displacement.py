"""Displacement, strain and non-affine motion: exact where the deformation is affine, brute force elsewhere."""

import re
from pathlib import Path

import matplotlib.pyplot
import numpy as np
import pytest
import xarray as xr
from scipy.linalg import polar
from scipy.spatial.transform import Rotation

import xcg
from tests import ROOT
from tests.brute_force import BruteKernel
from tests.scenes import spheres

TENSOR = ("component", "direction")
MIDDLE = {"x": 3.0, "y": 3.0, "z": 3.0}
DEFORMATIONS = {
    "simple shear": np.eye(3) + 0.3 * np.eye(3, k=1),
    "dilation": np.diag([1.1, 1.1, 1.1]),
    "stretch": np.diag([1.3, 0.8, 0.95]),
    "turn": Rotation.from_rotvec([0.3, -1.2, 0.5]).as_matrix(),
    "half a turn": Rotation.from_rotvec([0.0, 0.0, 3.1]).as_matrix(),
    "anything": np.array([[1.1, 0.2, -0.1], [0.05, 0.8, 0.3], [-0.2, 0.1, 1.2]]),
}


def places(count=1500, edge=6.0, seed=0):
    """Places (count, 3) in a cube."""
    return np.random.default_rng(seed).uniform(0, edge, (count, 3))


def moved(positions, **options):
    """Spheres in steps half a second apart."""
    return spheres(positions, time=0.5 * np.arange(len(positions)), **options)


def check_affine(f, deformation, atol=1e-13):
    """All fields of a displacement that is affine, whatever the nodes and phases."""

    def same(name, expected):
        np.testing.assert_allclose(
            f[name].values,
            np.broadcast_to(expected, f[name].shape),
            rtol=0,
            atol=atol,
            err_msg=name,
        )

    gradient, (turn, _) = deformation - np.eye(3), polar(deformation)
    strain = (deformation.T @ deformation - np.eye(3)) / 2
    same("displacement_gradient", gradient)
    same("deformation_gradient", deformation)
    same("strain", strain)
    same("small_strain", (gradient + gradient.T) / 2)
    same("volumetric_strain", np.linalg.det(deformation) - 1)
    axes = ["xyz".index(a) for a in f.attrs["plane"]]
    deviator = strain - np.diag(
        np.isin(range(3), axes) * np.trace(strain[np.ix_(axes, axes)]) / len(axes)
    )
    same("shear_strain", np.sqrt(2 * (deviator**2).sum()))
    same("rotation", turn)
    same("rotation_vector", Rotation.from_matrix(turn).as_rotvec())
    for name in ("nonaffine_covariance", "d2min", "self_diffusion"):
        same(name, 0.0)


@pytest.mark.parametrize("deformation", DEFORMATIONS.values(), ids=DEFORMATIONS)
def test_affine_deformation_is_exact(deformation):
    r = places()
    ds = moved([r, r @ deformation.T + [0.5, -2.0, 7.0]])
    f = ds.cg.displacement(["centre_offset", *NAMES], bounds=dict.fromkeys("xyz", (2.0, 4.0)))
    check_affine(f, deformation)
    node = xr.concat(xr.broadcast(f.x, f.y, f.z), "component")
    centre = node.assign_coords(component=f.component) + f.centre_offset
    expected = centre.transpose(*f.displacement.dims).values @ (deformation - np.eye(3)).T + [
        0.5,
        -2.0,
        7.0,
    ]
    np.testing.assert_allclose(f.displacement, expected, rtol=0, atol=1e-13)


NAMES = [name for name in xcg.FIELDS if xcg.FIELDS[name].option == "lag"]


def deforming(stretch, noise=0.0, first=0.0):
    """A periodic box that is stretched with its grains, wrapped at random, and the edges of which may be elsewhere."""
    rng = np.random.default_rng(1)
    share = rng.uniform(0, 1, (1500, 3))
    lower = np.array([[0.0, 0.0, 0.0], [0.4, -1.0, 0.2]])
    edge = np.array([[6.0] * 3, 6.0 * np.array(stretch)])
    away = rng.integers(-1, 2, (2, 1500, 3))
    position = lower[:, None] + (share + away) * edge[:, None]
    position[1] += noise * rng.normal(size=(1500, 3))
    lower += first * edge
    return moved(position, box=np.stack([lower, lower + edge], axis=-1), periodic="xyz")


@pytest.mark.parametrize(
    "place",
    [
        {},
        {"axes": "xz", "at": {"y": 0.0}},
        {"axes": "z"},
        {"axes": "x", "at": {"z": 6.0}},
        {"axes": ""},
        {"axes": "", "at": {"x": 0.0, "y": 6.0, "z": -0.1}},
    ],
)
def test_a_box_that_deforms_carries_its_images_with_it(place):
    stretch = (1.1, 0.93, 1.3)
    f = deforming(stretch).cg.displacement(spacing=1.0, **place)
    check_affine(f, np.diag(stretch))
    moved = np.array([0.4, -1.0, 0.2])
    for k, a in enumerate("xyz"):
        if a in f.coords:
            continue
        # along an averaged axis the box stands for its grains
        middle = moved[k] + 3.0 * (stretch[k] - 1)
        np.testing.assert_allclose(f.displacement.sel(component=a), middle, atol=1e-12)


def test_displacement_of_the_box_equals_that_of_the_grains_at_the_node():
    f = deforming((1.1, 1.0, 1.0)).cg.displacement(
        ["displacement", "centre_offset"], axes="x", spacing=0.5
    )
    expected = 0.4 + 0.1 * (f.x + f.centre_offset.sel(component="x"))
    np.testing.assert_allclose(
        f.displacement.sel(component="x"), expected.transpose("time", "x"), atol=1e-12
    )


def test_fields_do_not_depend_on_where_the_edges_are():
    at = {"x": 6.0, "y": 6.2, "z": 5.9}
    at_edge, within = (
        deforming((1.1, 0.9, 1.0), 0.05, first).cg.displacement(axes="", at=at) for first in (0.0, 0.5)
    )  # fmt: skip
    for name in at_edge.data_vars:
        np.testing.assert_allclose(at_edge[name], within[name], rtol=1e-9, atol=1e-12, err_msg=name)


def test_a_box_far_from_the_origin_keeps_its_images():
    stretch = np.array([1.3, 0.8, 1.0])
    away = np.array([100.0, -50.0, 0.0])
    r = places()
    edges = np.array([[6.0] * 3, 6.0 * stretch])
    box = np.stack([np.tile(away, (2, 1)), away + edges], axis=-1)
    ds = moved([away + r, away + (r * stretch + 0.3) % edges[1]], box=box, periodic="xyz")
    f = ds.cg.displacement([*NAMES, "centre_offset"], axes="y", spacing=1.0)
    check_affine(f, np.diag(stretch), atol=1e-12)
    expected = 0.3 + (f.y - away[1] + f.centre_offset.sel(component="y")) * (stretch[1] - 1)
    np.testing.assert_allclose(
        f.displacement.sel(component="y"), expected.transpose("time", "y"), atol=1e-12
    )


def test_open_and_periodic_axes_together():
    deformation = np.diag([1.2, 1.0, 1.0]) + 0.1 * np.outer([0, 1, 0], [0, 0, 1])
    r = places()
    box = np.array([[[0.0, 6.0]] * 3, [[0.0, 7.2], [0.0, 6.0], [0.0, 6.0]]])
    ds = moved([r, r @ deformation.T % [7.2, 6.0, 100.0]], box=box, periodic="xy")
    check_affine(ds.cg.displacement(bounds={"z": (2.0, 4.0)}, spacing=1.0), deformation, atol=1e-12)


def test_edges_a_period_apart_are_equivalent():
    r = places()
    box = np.array([[[0.0, 6.0]] * 3, [[6.0, 12.0]] * 3])
    f = moved([r, (r + np.array([0.1, 0, 0])) % 6 + 6], box=box, periodic="xyz").cg.displacement(
        ["displacement"], axes="z"
    )
    np.testing.assert_allclose(
        f.displacement, np.broadcast_to([0.1, 0, 0], f.displacement.shape), atol=1e-14
    )


def test_translation_across_periodic_edges():
    r = places()
    u = [2.9, -2.0, 0.5]
    ds = moved([r, (r + u) % 6], box=[[0, 6]] * 3, periodic="xyz")
    with pytest.warns(xcg.SceneWarning, match="by up to 0.48 of the period along 'x'"):
        f = ds.cg.displacement(spacing=1.5)
    check_affine(f, np.eye(3))
    np.testing.assert_allclose(f.displacement, np.broadcast_to(u, f.displacement.shape), atol=1e-13)


def test_displacements_of_a_layer():
    r = places(400) * [1, 0, 1] + [0, 0.5, 0]
    deformation = np.array([[1.1, 0, 0.3], [0, 1, 0], [-0.2, 0, 0.9]])
    ds = moved([r, r @ deformation.T + [0, 0.05, 0]], dimension=2, plane="xz", thickness=1.0)
    check_affine(ds.cg.displacement(axes="", at={"x": 3.0, "z": 3.0}), deformation)


def test_phases_are_about_the_bulk():
    deformation = DEFORMATIONS["anything"]
    r = places(4000)
    species = np.tile(np.arange(4000) % 2 + 1, (2, 1))
    ds = moved([r, r @ deformation.T], species=species)
    f = ds.cg.displacement(axes="", at=MIDDLE, by="species")
    assert f.phase.values.tolist() == ["bulk", "1", "2"]
    check_affine(f, deformation)
    noise = (
        np.random.default_rng(1).normal(size=(4000, 3))
        * np.where(species[0] == 1, 0.1, 0.3)[:, None]
    )
    f = moved([r, r + noise], species=species).cg.displacement(
        ["d2min"], axes="", at=MIDDLE, by="species", width=1.5
    )
    np.testing.assert_allclose(f.d2min.sel(phase=["1", "2"]).squeeze(), [0.03, 0.27], rtol=0.15)


# --- brute force -----------------------------------------------------------------------------------------


def test_d2min_is_the_weighted_sum_of_falk_and_langer():
    rng = np.random.default_rng(4)
    r = places(600)
    diameter = np.tile(rng.uniform(0.7, 1.3, 600), (2, 1))
    u = rng.normal(size=(600, 3)) * 0.1 + r @ rng.normal(size=(3, 3)) * 0.1
    kernel = BruteKernel("lucy", 0.9)
    at = np.array([3.1, 2.8, 3.3])
    f = moved([r, r + u], diameter=diameter).cg.displacement(
        [*NAMES, "fluctuation_density"], axes="", at=dict(zip("xyz", at, strict=True)), width=0.9
    ).squeeze()  # fmt: skip
    w = np.pi / 6 * diameter[0] ** 3 * kernel(np.linalg.norm(r - at, axis=1))
    near = np.flatnonzero(w > 0)
    design = np.sqrt(w[near])[:, None] * np.column_stack([np.ones(len(near)), r[near]])
    fit = np.linalg.lstsq(design, np.sqrt(w[near])[:, None] * u[near], rcond=None)[0]
    rest = u[near] - np.column_stack([np.ones(len(near)), r[near]]) @ fit
    hat = design @ np.linalg.pinv(design)
    # what independent displacements leave: sum_i w_i E|rest_i|^2 with rest = (1 - A) u, A_ij = sqrt(w_j / w_i) hat_ij
    smoother = hat * np.sqrt(w[near])[None, :] / np.sqrt(w[near])[:, None]
    free = (w[near][:, None] * (np.eye(len(near)) - smoother) ** 2).sum()
    covariance = np.einsum("n,ni,nj->ij", w[near], rest, rest) / free
    np.testing.assert_allclose(f.displacement_gradient, fit[1:].T, rtol=0, atol=1e-12)
    np.testing.assert_allclose(f.fluctuation_density, free, rtol=1e-12)
    np.testing.assert_allclose(f.nonaffine_covariance, covariance, rtol=1e-10, atol=1e-14)
    np.testing.assert_allclose(f.d2min, np.trace(covariance), rtol=1e-11)
    np.testing.assert_allclose(f.self_diffusion, covariance / (2 * 0.5), rtol=1e-10, atol=1e-14)


def test_independent_displacements_have_their_variance():
    rng = np.random.default_rng(5)
    r = places(400)
    ds = moved([r, r + rng.normal(size=(400, 3)) * 0.01], box=[[0, 6]] * 3, periodic="xyz")
    found = {}
    for way in ("unbiased", "biased"):
        f = ds.cg.displacement(
            ["d2min"], spacing=1.0, width=0.9, temperature=way, for_averages=True
        )
        weight = f.fluctuation_density.where(f.d2min.notnull(), 0.0)
        found[way] = float((weight * f.d2min.fillna(0.0)).sum() / weight.sum()) / 3e-4
    # 1200 numbers tell a variance to sqrt(2 / 1200) = 4 %
    assert abs(found["unbiased"] - 1) < 0.1
    assert found["biased"] < 0.85


# --- which grains, which frames --------------------------------------------------------------------------


def test_grains_that_enter_or_leave_are_counted_and_left_out():
    deformation = DEFORMATIONS["anything"]
    r = places()
    later = r @ deformation.T
    rng = np.random.default_rng(2)
    frames = []
    ids = []
    for x, here in ((r, range(1400)), (later, range(30, 1500))):
        order = rng.permutation(list(here))
        frames.append(x[order])
        ids.append(order + 7)
    ds = xcg.scene_from_arrays(
        frames,
        particle_id=ids,
        diameter=[np.ones(len(i)) for i in ids],
        density=1.0,
        time=[0.0, 1.0],
    )
    f = ds.cg.displacement(["sample_count", *NAMES], axes="", at=MIDDLE, width=2.0)
    assert (f.left.item(), f.entered.item()) == (30, 100)
    assert f.sample_count.item() == (np.linalg.norm(r[30:1400] - 3.0, axis=1) < 4.0).sum()
    check_affine(f, deformation)
    shuffled = ds.isel(particle=np.random.default_rng(3).permutation(ds.sizes["particle"]))
    again = shuffled.cg.displacement(["sample_count", *NAMES], axes="", at=MIDDLE, width=2.0)
    xr.testing.assert_allclose(again, f, rtol=1e-12, atol=1e-13)


def deformed_steps(steps=6, seed=3):
    """Grains that a random strain and a random walk move in each step."""
    rng = np.random.default_rng(seed)
    r = [places(300)]
    for _ in range(steps - 1):
        r.append(
            r[-1] @ (np.eye(3) + rng.normal(size=(3, 3)) * 0.02) + rng.normal(size=(300, 3)) * 0.01
        )
    return moved(r)


@pytest.mark.parametrize("chunks", [1, 2, 4])
def test_lazy_displacements_equal_eager_ones(chunks):
    ds = deformed_steps()
    options = {"axes": "z", "extent": {"x": 6.0, "y": 6.0}, "bounds": {"z": (2.0, 4.0)}, "lag": 2}
    eager = ds.cg.displacement(**options)
    lazy = ds.chunk(time=chunks).cg.displacement(width=0.75, **options)
    assert all(a.chunks is not None for a in lazy.data_vars.values())
    assert lazy.chunksizes["time"][0] <= chunks
    xr.testing.assert_identical(lazy.compute().drop_attrs(), eager.drop_attrs())
    assert eager.sizes["time"] == 4
    np.testing.assert_array_equal(eager.interval, 1.0)


def test_a_chunk_reads_its_frames_and_their_partners_only():
    read = []
    ds = deformed_steps()

    def note(block, block_info=None):
        read.append(block_info[0]["array-location"][0])
        return block

    lazy = ds.chunk(time=1)
    lazy["position"] = lazy.position.copy(
        data=lazy.position.data.map_blocks(note, meta=np.empty((0, 0, 0)))
    )
    f = lazy.cg.displacement(["strain"], axes="", at=MIDDLE, width=2.0, lag=2)
    assert read == []
    f.isel(time=1).compute()
    assert sorted(read) == [(1, 2), (3, 4)]


@pytest.mark.parametrize("chunks", [None, 1, 3])
def test_accumulated_deformations_are_composed(chunks):
    ds = deformed_steps(7)
    place = {"axes": "x", "at": {"y": 3.0, "z": 3.0}, "bounds": {"x": (2.0, 4.0)}, "width": 2.0}
    part = ds.cg.displacement(["deformation_gradient"], **place).deformation_gradient.values
    f = (ds if chunks is None else ds.chunk(time=chunks)).cg.displacement(accumulate=True, **place)
    total = np.eye(3)
    for t in range(6):
        total = part[t] @ total
        np.testing.assert_allclose(f.deformation_gradient[t], total, rtol=0, atol=1e-14)
        strain = (total.swapaxes(-1, -2) @ total - np.eye(3)) / 2
        np.testing.assert_allclose(f.strain[t], strain, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(f.time, ds.time[1:])
    np.testing.assert_allclose(f.interval, ds.time[1:] - ds.time[0])
    assert f.interval.attrs == {"units": "s", "long_name": "time since the first frame"}
    assert not {"d2min", "displacement"} & set(f.data_vars)
    every = ds.cg.displacement("deformation_gradient", 2, accumulate=True, **place)
    np.testing.assert_array_equal(every.time, ds.time[2::2])
    np.testing.assert_allclose(every.interval, ds.time[2::2] - ds.time[0])
    by_two = [
        ds.isel(time=[t, t + 2]).cg.displacement("deformation_gradient", **place) for t in (0, 2)
    ]
    first, second = (f.deformation_gradient.values[0] for f in by_two)
    np.testing.assert_allclose(every.deformation_gradient[1], second @ first, rtol=0, atol=1e-13)


def test_averages_follow_the_rules_of_the_registry():
    f = deformed_steps().cg.displacement(
        axes="z", extent={"x": 6.0, "y": 6.0}, bounds={"z": (2.0, 4.0)}, for_averages=True
    )
    a = f.cg.time_average()
    mean = (f.density * f.deformation_gradient).mean("time") / f.density.mean("time")
    np.testing.assert_allclose(a.deformation_gradient, mean)
    F = a.deformation_gradient.values
    np.testing.assert_allclose(a.strain, (F.swapaxes(-1, -2) @ F - np.eye(3)) / 2, atol=1e-14)
    assert np.isfinite(a.strain_error).all()
    mean = (f.fluctuation_density * f.d2min).mean("time") / f.fluctuation_density.mean("time")
    np.testing.assert_allclose(a.d2min, mean)
    assert set(f.cg.profile("z").data_vars) == set(f.data_vars)


def test_rotation_is_nan_under_a_reflection():
    r = places()
    f = moved([r, r * [1, 1, -1]]).cg.displacement(
        ["rotation", "rotation_vector", "strain"], axes="", at=MIDDLE
    )
    assert np.isnan(f.rotation).all()
    assert np.isnan(f.rotation_vector).all()
    np.testing.assert_allclose(f.strain, np.zeros_like(f.strain), atol=1e-13)


# --- wrong input -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "options", "error", "message"),
    [
        (lambda ds: ds, {"lag": 6}, ValueError, "lag=6: the scene has 6 frames"),
        (lambda ds: ds.isel(time=[0]), {}, ValueError, "lag=1: the scene has 1 frames"),
        (lambda ds: ds.isel(time=0), {}, ValueError, "lag=1: the scene has 1 frames"),
        (lambda ds: ds, {"lag": 0}, ValueError, "lag=0: expected a whole number of at least 1"),
        (lambda ds: ds, {"lag": 1.5}, ValueError, "lag=1.5: expected a whole number of at least 1"),
        (lambda ds: ds, {"lag": "two"}, ValueError, "lag='two': expected a whole number of at least 1"),
        (lambda ds: ds, {"lag": True}, ValueError, "lag=True: expected a whole number of at least 1"),
        (lambda ds: ds, {"fields": "velocity"}, ValueError, "unknown field of displacements 'velocity'"),
        (lambda ds: ds, {"fields": ["strian"]}, ValueError, "did you mean 'strain'"),
        (lambda ds: ds, {"fields": ["d2min"], "accumulate": True}, ValueError, "['d2min'] do not follow from one"),
        (lambda ds: ds, {"per": "accessible"}, TypeError, "unexpected keyword argument 'per'"),
        (lambda ds: ds, {"preset": "pysammos"}, ValueError, "preset='pysammos': not available for displacements"),
        (lambda ds: ds.isel(time=[1, 0]), {}, xcg.SceneError, "times that rise"),
        (lambda ds: ds.assign_coords(time=np.arange(6).astype("m8[ns]")), {}, xcg.SceneError, "times as numbers (s)"),
        (lambda ds: ds.assign(particle_id=ds.particle_id + 0.5), {}, xcg.SceneError, "'particle_id' holds"),
        (lambda ds: ds.drop_vars("particle_id"), {}, xcg.SceneError, "needs ['particle_id']"),
        (lambda ds: ds.drop_vars("mass"), {}, xcg.SceneError, "needs ['mass']"),
    ],
)  # fmt: skip
def test_wrong_input_raises(change, options, error, message):
    with pytest.raises(error, match=re.escape(message)):
        change(deformed_steps()).cg.displacement(**({"axes": "", "at": MIDDLE} | options))


def test_steps_without_common_ids_raise_or_are_skipped():
    ds = deformed_steps(3)
    ds = ds.assign(particle_id=ds.particle_id + xr.DataArray([0, 0, 1000], dims="time"))
    place = {"axes": "", "at": MIDDLE, "width": 2.0}
    with pytest.raises(xcg.SceneError, match="step 1 and step 2 have no particle id in common"):
        ds.cg.displacement(**place)
    with pytest.warns(xcg.SkippedStep, match="no particle id in common"):
        f = ds.chunk(time=1).cg.displacement("strain", on_error="skip", **place).compute()
    assert f.skipped.values.tolist() == [False, True]
    np.testing.assert_array_equal(np.isnan(f.strain).all(("component", "direction")), [False, True])


def test_coarse_grain_points_to_displacement():
    with pytest.raises(
        ValueError, match=r"strain compares two frames: call ds.cg.displacement\('strain'\)"
    ):
        deformed_steps().cg.coarse_grain("strain")


def test_the_page_on_displacement_runs(monkeypatch, capsys):
    monkeypatch.chdir(ROOT / "docs")
    names = {}
    with matplotlib.rc_context({"backend": "agg"}):
        for cell in re.findall(
            r"```\{code-cell\} python\n(.*?)```", Path("displacement.md").read_text(), re.DOTALL
        ):
            exec(compile(cell, "displacement.md", "exec"), names)
        matplotlib.pyplot.close("all")
    assert capsys.readouterr().out == "0.1 s between the frames, 0 grains left and 0 entered\n"
    f = names["f"]
    # the band carries the shear, and its grains stray
    band = f.shear_strain.max("y").mean()
    assert 0.5 < band < 2
    assert float(f.shear_strain.median()) < 0.03
    assert float(f.d2min.where(f.shear_strain > 0.5).median()) > 100 * float(
        f.d2min.where(f.shear_strain < 0.05).median()
    )
    # the top moves against the bottom by the integral of the shear
    ends = f.displacement.sel(component="x").mean("x").dropna("y")
    assert float(ends[-1] - ends[0]) == pytest.approx(0.02, rel=0.05)
