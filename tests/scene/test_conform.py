"""Scenes that xarray selected from, masked, reordered or joined give what a user expects of them, or an error."""

import numpy as np
import pytest
import xarray as xr
from dask.callbacks import Callback

import xcg
from tests.scenes import random_steps
from xcg import SceneError

FIELDS = [
    "contact_stress",
    "kinetic_stress",
    "volume_fraction",
    "coordination_number",
    "boundary_force_density",
]
MESH = {
    "fields": FIELDS,
    "width": 0.8,
    "spacing": 1.25,
    "bounds": dict.fromkeys("xyz", (0.0, 3.75)),
}


@pytest.fixture(scope="module")
def scene():
    return random_steps(2)


def joined(*parts, **options):
    return xr.concat(parts, "particle", join="outer", **({"data_vars": "all"} | options))


def halves(scene):
    return scene.isel(particle=slice(20, None)), scene.isel(particle=slice(20))


SAME = {
    "reversed": lambda s: s.isel(particle=slice(None, None, -1)),
    "shuffled": lambda s: s.isel(
        particle=np.random.default_rng(0).permutation(s.sizes["particle"])
    ),
    "joined": lambda s: joined(*halves(s)),
    "joined, minimal": lambda s: joined(*halves(s), data_vars="minimal"),
    "components": lambda s: s.sel(component=["z", "x", "y"]),
    "all chosen": lambda s: s.where(s.diameter > 0),
    "padding in the middle": lambda s: s.pad(particle=(3, 0)).isel(
        particle=[5, 4, 0, 1, *range(6, 44), 2, 3]
    ),
    "transposed": lambda s: s.transpose("component", "contact", "particle", ...),
}


@pytest.mark.parametrize("lazy", [False, True])
@pytest.mark.parametrize("how", SAME)
def test_other_forms_of_one_scene_have_the_same_fields(scene, how, lazy):
    given = SAME[how](scene.chunk(time=1) if lazy else scene)
    xr.testing.assert_equal(given.cg.coarse_grain(**MESH).compute(), scene.cg.coarse_grain(**MESH))


@pytest.mark.parametrize("how", SAME)
def test_results_by_particle_keep_the_rows_of_the_scene(scene, how):
    given = SAME[how](scene)
    mine = given.cg.particle_stress()
    usual = scene.cg.particle_stress()
    chains = given.cg.force_chains(min_length=2)
    usual_chains = scene.cg.force_chains(min_length=2)
    assert (usual_chains.chain_count > 0).all()
    for t in range(2):
        ids = np.nan_to_num(given.particle_id.isel(time=t), nan=-1)
        expected = usual.particle_id[t].values
        np.testing.assert_array_equal(mine.particle_id[t], ids)
        row = np.array([np.flatnonzero(expected == i)[0] for i in ids[ids >= 0]])
        np.testing.assert_array_equal(mine.stress[t].values[ids >= 0], usual.stress[t].values[row])
        assert np.isnan(mine.stress[t].values[ids < 0]).all()
        for name in ("chain_id", "parent_id", "major_stress"):
            np.testing.assert_array_equal(
                chains[name][t].values[ids >= 0], usual_chains[name][t].values[row]
            )
    upper = usual_chains.cg.select_chains(min_stress=float(usual.major_stress.median()))
    kept = chains.cg.select_chains(min_stress=float(usual.major_stress.median()))
    np.testing.assert_array_equal(kept.chain_count, upper.chain_count)
    assert set(
        map(tuple, chains.cg.link_table()[["time", "particle_i", "particle_j"]].values)
    ) == set(map(tuple, usual_chains.cg.link_table()[["time", "particle_i", "particle_j"]].values))


def test_bodies_and_microstructure_of_shuffled_rows(scene):
    glued = scene.assign(body_id=(scene.particle_id // 2).where(scene.particle_id >= 0, -1))
    glued = glued.drop_vars("species")  # which differ within bodies
    shuffled = SAME["shuffled"](glued)
    xr.testing.assert_allclose(
        shuffled.cg.group_bodies().drop_attrs(), glued.cg.group_bodies().drop_attrs()
    )
    names = ["coordination_number", "stress", "fabric", "volume_fraction"]
    xr.testing.assert_allclose(
        shuffled.cg.microstructure(names).drop_attrs(), glued.cg.microstructure(names).drop_attrs()
    )


def test_one_step_has_results_of_one_step(scene):
    f = scene.cg.coarse_grain(**MESH)
    one = scene.isel(time=1)
    assert "time" not in one.dims
    xr.testing.assert_equal(one.cg.coarse_grain(**MESH), f.isel(time=1))
    xr.testing.assert_equal(
        scene.chunk(time=1).isel(time=1).cg.coarse_grain(**MESH).compute(), f.isel(time=1)
    )
    xr.testing.assert_equal(
        scene.sel(time=0.09, method="nearest").cg.coarse_grain(**MESH), f.isel(time=1)
    )
    xr.testing.assert_equal(
        scene.isel(time=1, drop=True).cg.coarse_grain(**MESH), f.isel(time=1, drop=True)
    )
    chains = scene.cg.force_chains(min_length=2)
    xr.testing.assert_equal(one.cg.force_chains(min_length=2), chains.isel(time=1))
    xr.testing.assert_equal(
        one.cg.force_chains(min_length=2).cg.select_chains(min_stress=0.1).chain_id,
        chains.cg.select_chains(min_stress=0.1).chain_id.isel(time=1),
    )
    for task in (
        "measure",
        "find_contacts",
        "microstructure",
        "particle_stress",
        "size_statistics",
        "slice_temperature",
    ):
        assert "time" not in getattr(one.cg, task)().dims
    assert "fields" in str(one.cg.explain("volume_fraction"))
    assert repr(one.cg).startswith("scene of 1 step")


CHOSEN = {
    "where": lambda s: s.where(s.species == 1),
    "where, dropped": lambda s: s.where((s.species == 1).compute(), drop=True),
    "marked": lambda s: s.assign(particle_id=s.particle_id.where(s.species == 1, -1)),
    "rows": lambda s: s.isel(time=[0]).isel(particle=np.flatnonzero(s.species[0] == 1)),
    "by variable": lambda s: s.map(
        lambda v: v.where(s.species == 1) if "particle" in v.dims else v
    ),
}


@pytest.mark.parametrize("lazy", [False, True])
@pytest.mark.parametrize("how", CHOSEN)
def test_chosen_particles_keep_the_contacts_with_all_others(scene, how, lazy):
    chosen = CHOSEN[how](scene.chunk(time=1) if lazy else scene)
    here = {"time": range(chosen.sizes["time"])}
    found = chosen.cg.coarse_grain(**MESH).compute().drop_vars("boundary_force_density")
    phase = scene.isel(here).cg.coarse_grain(by="species", **MESH).sel(phase="1", drop=True)
    for name in ("contact_stress", "volume_fraction", "coordination_number"):
        np.testing.assert_allclose(found[name], phase[name], rtol=1e-12, atol=1e-12)
    divided = chosen.cg.coarse_grain(by="species", groups=[1], **MESH)
    np.testing.assert_allclose(
        divided.contact_stress.sel(phase="1"), found.contact_stress, rtol=1e-12, atol=1e-12
    )


@pytest.mark.parametrize("how", CHOSEN)
def test_chosen_particles_of_a_lazy_scene_have_the_default_width_and_mesh_of_the_scene(scene, how):
    chosen = CHOSEN[how](scene)
    lazy = CHOSEN[how](scene.chunk(time=1))
    assert lazy.position.chunks is not None
    for options in ({}, {"axes": "z", "by": "species", "groups": [1]}):
        xr.testing.assert_equal(
            lazy.cg.coarse_grain(FIELDS, **options).compute(),
            chosen.cg.coarse_grain(FIELDS, **options),
        )
    assert lazy.cg.explain().nodes.shape == scene.cg.explain().nodes.shape
    assert lazy.cg.explain("density", by="species").groups == (1, 2)
    assert np.isfinite(lazy.cg.slice_temperature().velocity).any()
    measured = lazy.cg.measure()
    assert measured.cg.explain("density", by="species").groups == (1,)
    assert measured.attrs["dmax"] == float(chosen.diameter.max())


def test_diameters_changed_before_a_selection_warn(scene):
    lazy = scene.chunk(time=1)
    changed = lazy.assign(diameter=3 * lazy.diameter).where(lazy.species == 1)
    with pytest.warns(
        xcg.SceneWarning, match=r"diameters from .* not in the range that was measured.*measure\(\)"
    ):
        changed.cg.coarse_grain("coordination_number").compute()
    changed.cg.measure().cg.coarse_grain("coordination_number").compute()


@pytest.mark.parametrize("lazy", [False, True])
def test_one_particle_or_contact_has_results_without_that_dimension(scene, lazy):
    scene = scene.chunk(time=1) if lazy else scene
    one = scene.isel(particle=5)
    several = scene.isel(particle=[5])
    xr.testing.assert_equal(
        one.cg.coarse_grain(**MESH, by="species").compute(),
        several.cg.coarse_grain(**MESH, by="species").compute(),
    )
    assert one.cg.explain().kernel.width == several.cg.explain().kernel.width
    for task in ("particle_stress", "force_chains", "measure", "size_statistics"):
        got, expected = (getattr(s.cg, task)() for s in (one, several))
        assert "particle" not in got.dims
        xr.testing.assert_equal(
            got.compute(), expected.isel(particle=0, missing_dims="ignore").compute()
        )
    single = scene.isel(contact=0)
    first = scene.isel(contact=[0])
    xr.testing.assert_equal(
        single.cg.coarse_grain(**MESH).compute(), first.cg.coarse_grain(**MESH).compute()
    )
    xr.testing.assert_equal(
        single.isel(time=0, particle=5).cg.particle_stress().compute(),
        several.isel(contact=[0]).cg.particle_stress().isel(time=0, particle=0).compute(),
    )


@pytest.mark.parametrize("lazy", [False, True])
def test_variables_of_the_users_own_are_selected_along(scene, lazy):
    own = scene.assign(
        temperature=2 * scene.diameter, whirl=-scene.velocity, contact_heat=scene.contact_force.sum("component"),
        serial=("time", [1.0, 2.0]),
    )  # fmt: skip
    own = own.chunk(time=1) if lazy else own
    fields = ["temperature", "whirl", xcg.Sum("contact_heat")]
    whole = own.cg.coarse_grain(fields, width=0.8).compute()
    for how in ("transposed", "all chosen", "shuffled"):
        xr.testing.assert_equal(SAME[how](own).cg.coarse_grain(fields, width=0.8).compute(), whole)
    one, several = (
        s.cg.coarse_grain(fields, width=0.8) for s in (own.isel(particle=5), own.isel(particle=[5]))
    )
    xr.testing.assert_equal(one.compute(), several.compute())


@pytest.mark.parametrize("lazy", [False, True])
def test_rows_may_be_selected_by_label(scene, lazy):
    scene = scene.chunk(time=1) if lazy else scene
    by_number = scene.swap_dims(time="step")
    f = by_number.cg.coarse_grain(**MESH)
    xr.testing.assert_equal(
        f.sel(step=1).compute(), scene.cg.coarse_grain(**MESH).isel(time=1).compute()
    )
    by_id = scene.isel(time=1).set_coords("particle_id").compute().swap_dims(particle="particle_id")
    ids = [7, 3, 12]
    rows = scene.particle_id.isel(time=1).compute().to_index().get_indexer([7, 3, 12])
    stresses = by_id.sel(particle_id=ids).cg.particle_stress()
    assert stresses.particle_id.values.tolist() == ids
    expected = scene.isel(time=1, particle=rows).cg.particle_stress()
    np.testing.assert_array_equal(stresses.stress.sel(particle_id=3), expected.stress.compute()[1])
    assert (
        scene.set_coords(["particle_id", "box", "position"])
        .cg.width_sweep([0.6, 0.8, 1.0], "density")
        .density.any()
    )


def test_results_by_the_number_of_the_step_are_those_by_time(scene, tmp_path):
    """What follows from results whose steps go by their numbers, as from those of a scene that has them."""
    steps = xr.concat(
        [scene, scene.assign_coords(time=scene.time + 0.2, step=scene.step + 2)], "time"
    )
    f = steps.cg.coarse_grain(**MESH, for_averages=True)
    g = steps.swap_dims(time="step").cg.coarse_grain(**MESH, for_averages=True)
    assert "step" in g.dims
    xr.testing.assert_equal(g.cg.time_average(), f.cg.time_average())
    for method in ("spatial_correlation", "time_correlation"):
        found, expected = (getattr(one.cg, method)("volume_fraction") for one in (g, f))
        xr.testing.assert_equal(found, expected)
    assert str(g.cg).startswith("result of 4 steps on")
    f.cg.save(tmp_path / "f.vtkhdf")
    g.cg.save(tmp_path / "g.vtkhdf")
    assert (tmp_path / "g.vtkhdf").stat().st_size == (tmp_path / "f.vtkhdf").stat().st_size
    f.cg.save(tmp_path / "f.pvd")
    g.cg.save(tmp_path / "g.pvd")
    assert len([*tmp_path.glob("g_*.vti")]) == 4
    assert (tmp_path / "g_0003.vti").read_bytes() == (tmp_path / "f_0003.vti").read_bytes()


@pytest.mark.parametrize("suffix", [".nc", ".zarr"])
def test_results_by_the_number_of_the_step_are_computed_once_to_be_saved(scene, tmp_path, suffix):
    lazy = scene.chunk(time=1)
    f = lazy.cg.coarse_grain(**MESH)
    g = lazy.swap_dims(time="step").cg.coarse_grain(**MESH)
    tasks = []
    with Callback(pretask=lambda key, graph, state: tasks.append(str(key))):
        f.compute()
        once = len([key for key in tasks if "coarse" in key])
        tasks = []
        g.cg.save(tmp_path / f"g{suffix}")
    assert once > 0
    assert len([key for key in tasks if "coarse" in key]) == once
    with xr.open_dataset(tmp_path / f"g{suffix}") as saved:
        xr.testing.assert_equal(saved.load(), g.compute())


def test_chains_by_the_number_of_the_step_are_those_by_time(scene, tmp_path):
    fc = scene.cg.force_chains(min_length=2)
    by_number = scene.swap_dims(time="step").cg.force_chains(min_length=2)
    assert by_number.chain_count.dims == ("step",)
    for table in ("chain_table", "link_table"):
        assert getattr(by_number.cg, table)().equals(getattr(fc.cg, table)())
    xr.testing.assert_equal(by_number.cg.track_chains(), fc.cg.track_chains())
    files = [
        one.cg.to_csv(tmp_path / f"{name}_{{step}}.csv")
        for name, one in (("f", fc), ("g", by_number))
    ]
    assert [f.read_bytes() for f in files[0]] == [g.read_bytes() for g in files[1]]
    assert str(by_number.cg) == str(fc.cg)


def test_scenes_without_particles_are_accepted(scene):
    for none in (scene.isel(particle=[]), scene.chunk(time=1).isel(particle=[])):
        with pytest.warns(xcg.SceneWarning, match="no particle is left"):
            assert (none.cg.coarse_grain("density", width=0.8).density == 0).all()
        assert (none.cg.microstructure("coordination_number").coordination_number.isnull()).all()
        assert np.isnan(none.cg.size_statistics().d43).all()


def test_selections_of_nothing_are_named_with_the_range_of_positions():
    scene = xcg.datasets.random_scene(30)
    z = scene.position.values[0, :, 2]
    known = f"before, positions were .*z {z.min():.4g} to {z.max():.4g}"
    for nothing in (
        scene.isel(particle=[]),
        scene.cg.select("z > 1e9"),
        scene.assign(particle_id=scene.particle_id * 0 - 1).assign_attrs(scene.attrs),
    ):
        with pytest.warns(xcg.SceneWarning, match=f"no particle is left.*{known}") as caught:
            f = nothing.cg.coarse_grain("density", axes="z", bounds={"z": (0, 5)}, width=1.0)
        assert len(caught) == 1
        assert not f.density.any()
    with pytest.raises(xcg.SceneError, match="holds for no particle: change"):
        scene.where(scene.diameter > 1e9, drop=True).cg.coarse_grain("density", axes="z")
    with pytest.warns(xcg.SceneWarning, match="no step is left"):
        scene.isel(time=[]).cg.coarse_grain("density", axes="z")


def test_mean_stress_of_chosen_particles_is_the_sum_over_their_sides(scene):
    step = scene.isel(time=0)
    chosen = step.isel(particle=np.flatnonzero(step.species == 1))
    ids = set(chosen.particle_id.values.tolist())
    total = np.zeros((3, 3))
    centre = dict(zip(step.particle_id.values.tolist(), step.position.values, strict=True))
    for c in np.flatnonzero(step.contact_i.values >= 0):
        for name, sign in (("contact_i", 1), ("contact_j", -1)):
            one = int(step[name][c])
            if one in ids:
                branch = centre[one] - step.contact_point.values[c]
                branch -= 5 * np.round(branch / 5)
                total += sign * np.outer(step.contact_force.values[c], branch)
    f = chosen.cg.coarse_grain("contact_stress", axes="", width=0.8)
    np.testing.assert_allclose(f.contact_stress, total / 125, rtol=1e-12, atol=1e-14)
    stresses = chosen.cg.particle_stress()
    np.testing.assert_allclose(
        (stresses.stress * chosen.volume).sum("particle"), (total + total.T) / 2, atol=1e-12
    )


WRONG = {
    "occurs twice": lambda s: joined(s.isel(particle=slice(30)), s.isel(particle=slice(20, None))),
    "components": lambda s: s.sel(component=["x", "y"]),
    r"components \['x'\]": lambda s: s.sel(component="x"),
    "'box' differs along 'particle'": lambda s: joined(
        halves(s)[0], halves(s)[1].assign(box=s.box * 2)
    ),
    r"'diameter' has the dimensions .*'component'": lambda s: s.where(s.position > 1),
    "expected whole numbers": lambda s: s.assign(species=s.species + 0.5),
}


@pytest.mark.parametrize("what", WRONG)
def test_ambiguous_selections_raise(scene, what):
    with pytest.raises(SceneError, match=what):
        WRONG[what](scene).cg.coarse_grain(**MESH)


NOT_FINITE = {
    r"'velocity' of particle 0 is \[.*nan": lambda s: s.assign(
        velocity=s.velocity.where(s.particle_id != 0)
    ),
    r"'position' of particle 7 is \[.*nan": lambda s: s.assign(
        position=s.position.where(s.particle_id != 7)
    ),
    "'mass' of particle 3 is inf": lambda s: s.assign(
        mass=s.mass.where(s.particle_id != 3, np.inf)
    ),
    "'contact_force' of contact row 0 is": lambda s: s.assign(contact_force=s.contact_force / 0),
    "'contact_point' of contact row": lambda s: s.assign(
        contact_point=s.contact_point.where(s.contact_point > 1)
    ),
}


@pytest.mark.parametrize("lazy", [False, True])
@pytest.mark.parametrize("what", NOT_FINITE)
def test_assigned_variables_that_are_not_finite_raise(scene, what, lazy):
    with np.errstate(all="ignore"), pytest.raises(SceneError, match=what):
        NOT_FINITE[what](scene.chunk(time=1) if lazy else scene).cg.coarse_grain(**MESH).compute()


def test_variables_without_time_are_refused_with_the_call_that_adds_it(scene):
    constant = scene.assign(diameter=scene.diameter.isel(time=0, drop=True))
    with pytest.raises(xcg.SceneError, match="add the dimension time, ") as raised:
        constant.cg.coarse_grain("density", width=1.0)
    given = str(raised.value).split("add the dimension time, ")[1]
    assert given == "ds.assign(diameter=ds.diameter.expand_dims(time=ds.time))"
    again = constant.assign(diameter=constant.diameter.expand_dims(time=constant.time))
    assert again.cg.coarse_grain("density", width=1.0).density.notnull().all()


def test_masks_that_are_too_large_raise_before_reading():
    """A mask of particles spreads forces of contacts over the particles: 1.5e8 values, which are never computed."""
    large = xcg.datasets.simple_cubic(16).chunk(time=1)
    with pytest.raises(SceneError, match=r"ds\.map"):
        xcg.coarse_grain(large.where(large.particle_id > 0), **MESH)


def test_data_in_padding_rows_raise():
    at = {"position": [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], "diameter": [1.0, 1.0], "density": 2.0}
    with pytest.raises(
        SceneError, match=r"row 0 has 'particle_id' -1.*'position': number particles from 0 on"
    ):
        xcg.scene_from_arrays(**at, particle_id=[-1, 0])
    force = {"contact_force": np.ones((2, 3)), "contact_point": np.full((2, 3), [0.5, 0, 0])}
    with pytest.raises(
        SceneError, match=r"row 1 has 'contact_i' -1.*a wall must stand as 'contact_j'"
    ):
        xcg.scene_from_arrays(**at, contact_i=[0, -1], contact_j=[1, 0], **force)
    padded = at | {"position": [[0.0, 0.0, 0.0], [np.nan] * 3], "particle_id": [5, -1]}
    assert xcg.scene_from_arrays(**padded).sizes["particle"] == 1
    assert (
        xcg.scene_from_arrays(**at, contact_i=[0, -1], contact_j=[1, -1], **force).sizes["contact"]
        == 1
    )


def test_components_in_several_chunks_are_turned(scene):
    asked = {
        "fields": ["velocity", "contact_stress"],
        "at": {"x": 1.0, "y": 1.0, "z": 1.0},
        "width": 0.8,
        "axes": "",
    }
    asked["frame"] = xcg.Rotated(z=(1, 1, 3))
    f = scene.chunk(component=2, particle=7).cg.coarse_grain(**asked)
    xr.testing.assert_identical(
        f.compute().drop_attrs(), scene.cg.coarse_grain(**asked).drop_attrs()
    )


def test_masked_arrays_raise():
    position = np.eye(3)
    mask = [False, True, False]
    masked = np.ma.masked_array(np.ones(3), mask)
    for given in (
        {"diameter": masked},
        {"diameter": [masked]},
        {"velocity": np.ma.masked_equal(position, 1.0)},
    ):
        with pytest.raises(
            SceneError, match=rf"'{next(iter(given))}' is a masked array with \d masked values"
        ):
            xcg.scene_from_arrays(position, density=1.0, **given)
    with pytest.raises(SceneError, match="'time' is a masked array"):
        xcg.scene_from_arrays(
            position, diameter=np.ones(3), density=1.0, time=np.ma.masked_array([1.0], [True])
        )
    ds = xcg.scene_from_arrays(position, diameter=np.ma.masked_array(np.ones(3)), density=1.0)
    assert ds.sizes["particle"] == 3


@pytest.mark.parametrize("time", [[np.nan], [np.inf]])
def test_times_that_are_not_numbers_raise(time):
    with pytest.raises(SceneError, match="time"):
        xcg.scene_from_arrays(np.eye(3), diameter=np.ones(3), density=1.0, time=time)


@pytest.mark.parametrize("lazily", [False, True])
def test_scenes_that_were_averaged_over_time_are_refused(lazily):
    ds = xcg.datasets.open("biaxial").isel(time=slice(2))
    if not lazily:
        ds = ds.load()
    for averaged in (ds.mean("time"), ds.isel(particle=slice(9)).mean("time", keep_attrs=True)):
        for call in (
            averaged.cg.coarse_grain,
            averaged.cg.microstructure,
            averaged.cg.size_statistics,
        ):
            with pytest.raises(
                xcg.SceneError, match=r"after ds\.mean.*coarse_grain\(\.\.\.\)\.cg\.time_average"
            ):
                call()
    step = ds.isel(time=0)
    masked = step.where(step.particle_id > 100)
    for single in (step, step.drop_vars(["time", "step"]), masked, masked.drop_vars("step")):
        single.cg.coarse_grain("density")
    bare = masked.drop_vars(["time", "step"])
    xr.testing.assert_equal(
        bare.assign_coords(time=0.0).cg.coarse_grain("density").density.drop_vars("time"),
        masked.cg.coarse_grain("density").density.drop_vars(["time", "step"]),
    )
