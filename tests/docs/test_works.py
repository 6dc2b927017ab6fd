"""Claims of docs/works.md beside those of the papers, on the scripts' own scenes."""

import json
import re
import runpy

import numpy as np
import pytest

import xcg
from docs import (
    contact_speed,
    cost,
    lattice,
    levels,
    needs,
    nine_grains,
    stability,
    stability_curves,
)
from tests import ROOT
from tests.stability import cases


def test_an_erodible_bed_speeds_up_from_above_and_heats_up_from_below():
    script = runpy.run_path(str(ROOT / "examples" / "erodible_bed.py"))
    ds = script["open_bed"]()
    f = script["profiles"](ds)
    # mass of a step, by the profile and by the grains, but for the one above the mesh
    area = np.prod(np.diff(ds.box[0, :2])[:, 0])
    loose = ds.where(ds.frozen == 0)
    on_mesh = loose.mass.where(loose.position.sel(component="z") < 17).sum("particle")
    assert area * f.density.integrate("z").values == pytest.approx(on_mesh.values, rel=2e-3)
    first, last = (
        script["temperatures"](ds, f, steps) for steps in (slice(None, 9), slice(-9, None))
    )
    dense = {"z": np.arange(2.0, 11.5)}
    for name, other in last.items():
        share = other.interp(dense) / last["kernel"].interp(dense)
        assert share.values == pytest.approx(1.0, abs=0.1), name
    assert last["kernel"].interp(z=2.0) > 4 * last["kernel"].interp(z=11.0)
    assert first["kernel"].interp(z=11.0) > 2 * first["kernel"].interp(z=2.0)
    speed = f.velocity.sel(component="x").interp(z=8.0)
    assert speed[-9:].mean() > 2 * speed[:9].mean()


def test_fields_of_the_strained_lattice_are_its_closed_forms():
    ds = lattice.lattice()
    closed = lattice.exact()
    wide = lattice.at_point(ds, "lucy", 3 * lattice.DIAMETER)
    for name, value in closed.items():
        assert wide[name] == pytest.approx(value, rel=1e-5, abs=1e-6), name
    spread = lattice.second_moment(lattice.KERNELS[0](3 * lattice.DIAMETER, dimension=3))
    flow = closed["volume_fraction"] * lattice.DENSITY * lattice.RATE**2 * spread
    assert wide["kinetic_stress"] == pytest.approx(flow, rel=1e-4)
    # contacts by centres of grains: of a step function, a part is lost
    kernel = lattice.KERNELS[2](3 * lattice.DIAMETER, dimension=3)
    assert lattice.by_centres(ds, kernel) < 0.96 * closed["contact_stress"]


@pytest.mark.parametrize("program", [lattice.mercury, lattice.lammps])
def test_nodes_of_other_programs_have_what_they_printed(program):
    printed = program()
    for name, values in printed.sweep(np.array([printed.width])).items():
        assert values == pytest.approx(printed.fields[name], rel=1e-11), name


@pytest.mark.parametrize("turn", [0, 1, 30])
def test_nine_grains_have_straight_chains_where_stresses_have_an_axis(turn):
    def found(along_rows, **options):
        ds = nine_grains.nine_grains(along_rows, turn)
        return nine_grains.chains(ds.cg.force_chains(**options).compute())

    assert found(1.0, alpha=90) == [tuple(range(1, 10))]
    assert found(1.0, alpha=45) == []
    assert found(1.01, alpha=45) == [(1, 2, 3), (7, 8, 9)]
    # with equal forces grains of equal stress are equally good beginnings, and rounding chooses
    assert found(1.01, alpha=90, algorithm="peters2005") == [(1, 2, 3), (7, 8, 9)]


def test_chains_of_a_compressed_box_grow_in_number_and_then_merge_into_one():
    script = runpy.run_path(str(ROOT / "examples" / "compression.py"))
    ds = script["open_box"]()
    fc = ds.cg.force_chains(alpha=90).compute()
    count = fc.chain_count.values
    assert count.max() > 2 * count[0]
    assert (count[-8:] == 1).all()
    assert fc.length_max[-1] > 990
    # the pressure is the virial of all contacts over the volume of the box
    x = ds.position.values[-1]
    force = ds.contact_force.values[-1]
    kept = ds.contact_i.values[-1] >= 0
    row = {key: k for k, key in enumerate(ds.particle_id.values[-1])}
    i, j = ([row[key] for key in ds[name].values[-1][kept]] for name in ("contact_i", "contact_j"))
    edge = np.diff(ds.box.values[-1])[:, 0]
    branch = x[i] - x[j]
    branch -= edge * np.rint(branch / edge)
    virial = (branch * force[kept]).sum() / 3 / edge.prod()
    assert script["pressure"](ds).values[-1] == pytest.approx(virial, rel=1e-6)


def test_phases_of_the_mixture_and_of_the_pile_are_those_put_in():
    script = runpy.run_path(str(ROOT / "examples" / "pile.py"))
    mixed = script["mixture"]().cg.find_phases()
    assert mixed.attrs["phase_diameter"] == pytest.approx([2e-3, 2e-3, 4e-3, 4e-3], rel=0.02)
    assert mixed.attrs["phase_density"] == pytest.approx([2500, 4500] * 2, rel=0.02)
    ds = script["open_pile"]()
    assert ds.attrs["phase_diameter"] == pytest.approx([1.0, 1.5, 2.0])
    f = script["profile"](ds)
    parts = f.isel(phase=f.phase != "bulk").contact_stress.sum("phase")
    bulk = f.contact_stress.sel(phase="bulk")
    np.testing.assert_allclose(parts, bulk, rtol=0, atol=1e-12 * float(abs(bulk).max()))


def test_scripts_that_measure_run():
    (row,) = contact_speed.measure("bidisperse", 500, (2,), 1)
    assert row["levels"] == 1
    assert levels.times("series A", 3, range(1, 3), 500).keys() == {0, 1, 2}
    table = cost.measure(1000, 1)
    assert len(table) == 2 * len(cost.WIDTHS)
    assert cost.rows(table).count("\n") == 1 + len(table)


def test_the_notebook_runs(tmp_path, monkeypatch):
    """Its cells in order, beside the sample data."""
    from matplotlib import pyplot as plt

    plt.switch_backend("agg")
    (tmp_path / "data").symlink_to(ROOT / "examples" / "data")
    monkeypatch.chdir(tmp_path)
    cells = json.loads((ROOT / "examples" / "first_steps.ipynb").read_text())["cells"]
    names = {}
    for cell in cells:
        assert not cell.get("outputs"), "the notebook is kept without outputs"
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), "first_steps.ipynb", "exec"), names)
    plt.close("all")
    assert names["ds"].velocity.chunks is not None
    assert "phase" not in names["f"].velocity.dims
    assert "phase" in names["by_species"].velocity.dims
    assert (names["m"].velocity_error.sel(component="x", z=8.0) > 0).all()
    assert (tmp_path / "erodible.nc").exists()


def test_the_sheet_of_the_gallery_shows_scripts():
    pytest.importorskip("pyvista")
    from docs import gallery_sheet

    for script in gallery_sheet.SCRIPTS:
        assert (gallery_sheet.GALLERY / f"{script}.py").exists()
    assert gallery_sheet.picture_of("cases/heap").ndim == 3


def test_a_box_is_exact_and_nodes_owe_their_spread_to_few_grains():
    ds = xcg.datasets.dense_packing(4000)
    for fields in needs.FIELDS:
        places = [needs.Job(place, fields).spread(ds) for place in needs.PLACES]
        assert places[0] < 1e-10
        assert places[1] < 0.3 * places[3]
    assert needs.explained().count("```text") == 3


@pytest.mark.filterwarnings("ignore::xcg.SceneWarning")
@pytest.mark.parametrize(
    ("curves", "part", "gain"),
    [
        (stability_curves.fast_frame, slice(2, None), 100),
        (stability_curves.near_wall, slice(None, 4), 20),
        (stability_curves.gaps_in_time, slice(None, 5), 1e10),
        (stability_curves.few_grains, slice(2, None), 20),
    ],
)
def test_naive_errors_grow_with_what_breaks_the_method(curves, part, gain):
    naive, ours = (error for _, error in curves().values())
    assert (naive[part] > gain * ours[part]).all()


def test_the_unknown_is_nan_and_no_error_of_zero():
    assert stability.error_of(cases.few_grains()) == "NaN"
    assert stability.error_of(cases.fast_frame()) != "NaN"


def test_one_session_makes_all_pictures_of_the_page():
    page = (ROOT / "docs" / "works.md").read_text()
    session = (ROOT / "noxfile.py").read_text()
    modules, examples = (
        set(re.findall(r'"(\w+)"', re.search(rf"^{name} = \[(.*?)\]", session, re.M | re.S)[1]))
        for name in ("MODULES", "EXAMPLES")
    )
    assert set(re.findall(r"\]\((\w+)\.py\)", page)) <= modules
    assert set(re.findall(r"\]\(\.\./examples/(\w+)\.py\)", page)) <= examples
    for name in modules:
        assert (ROOT / "docs" / f"{name}.py").exists()
    for picture in re.findall(r"_static/(\w+\.png)", page):
        assert (ROOT / "docs" / "_static" / picture).exists()
