"""Steps that cannot be read or computed: raised by name, or skipped, NaN, named and marked."""

import gzip
import pickle
import warnings
import zlib

import dask
import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner

import xcg
from tests import dumps
from tests.readers.engines.test_mfix import write_contacts, write_particles
from xcg.cli import group
from xcg.steps.faults import SkippedStep

STEPS = (0, 10, 20, 30, 40)


@pytest.fixture
def folder(tmp_path):
    dumps.write_series(tmp_path, STEPS)
    return tmp_path


def open_dumps(folder, **options):
    return xcg.open_scene(str(folder / "p.*.dump"), contacts=str(folder / "c.*.dump"), **options)


def garble(path, old="1.9", new="oops"):
    path.write_text(path.read_text().replace(old, new))


@pytest.mark.parametrize("chunks", [1, 2, -1])
@pytest.mark.parametrize("name", ["p.20.dump", "c.20.dump"])
def test_a_garbled_body_is_raised_or_skipped(folder, name, chunks):
    whole = open_dumps(folder).cg.coarse_grain(["density", "stress"], axes="z").compute()
    garble(folder / name, *(("1.9", "oops") if name[0] == "p" else ("-9", "oops")))
    ds = open_dumps(folder, chunks=chunks)
    with pytest.raises(xcg.SceneError, match=rf"{name} \(step 20\): row \d has 'oops'"):
        ds.cg.coarse_grain(["density", "stress"], axes="z").compute()
    f = ds.cg.coarse_grain(["density", "stress"], axes="z", on_error="skip")
    with pytest.warns(
        SkippedStep, match=rf"step 20 is skipped: .*{name} \(step 20\): row \d has 'oops'"
    ) as said:
        f = f.compute()
    assert len(said) == 1
    assert f.skipped.values.tolist() == [False, False, True, False, False]
    assert np.isnan(f.density.isel(time=2)).all()
    xr.testing.assert_equal(
        f.isel(time=[0, 1, 3, 4]).drop_vars("skipped"), whole.isel(time=[0, 1, 3, 4])
    )


def test_fields_of_particles_do_not_read_damaged_contacts(folder):
    garble(folder / "c.20.dump", "-9", "oops")
    f = open_dumps(folder).cg.coarse_grain("density", axes="z", on_error="skip").compute()
    assert not f.skipped.any()


def test_skipping_is_lazy_and_nothing_is_skipped_in_whole_files(folder):
    def refuse(*_, **__):
        msg = "computed while the graph was built"
        raise AssertionError(msg)

    with dask.config.set(scheduler=refuse):
        f = open_dumps(folder).cg.coarse_grain(["density", "stress"], axes="z", on_error="skip")
    plain = open_dumps(folder).cg.coarse_grain(["density", "stress"], axes="z")
    xr.testing.assert_equal(f.drop_vars("skipped").compute(), plain.compute())
    assert not f.skipped.values.any()


def test_every_function_over_time_can_skip(folder):
    garble(folder / "p.20.dump")
    ds = open_dumps(folder)
    for result in (
        ds.cg.force_chains(on_error="skip"), ds.cg.particle_stress(on_error="skip"),
        ds.cg.microstructure(on_error="skip"), ds.cg.slice_temperature("z", on_error="skip"),
        ds.cg.coarse_grain("density_mixture", preset="pysammos", axes="z", on_error="skip"),
        ds.cg.find_contacts().cg.coarse_grain("density", axes="z", on_error="skip"),
        ds.cg.assign_phases(mapping={1: 0, 2: 1}).cg.coarse_grain("density", axes="z", by="phase", on_error="skip"),
    ):  # fmt: skip
        with pytest.warns(SkippedStep, match="step 20"):
            assert result.compute().skipped.values.tolist() == [False, False, True, False, False]


def test_a_step_in_memory_that_cannot_be_computed_is_skipped(folder):
    ds = open_dumps(folder).load()
    ds.box.values[1, 0] = np.nan
    with pytest.raises(xcg.SceneError, match="step 10: axis 'x' is periodic"):
        ds.cg.coarse_grain("density", axes="z", extent={"x": 1, "y": 1})
    with pytest.warns(SkippedStep, match="step 10"):
        f = ds.cg.coarse_grain("density", axes="z", extent={"x": 1, "y": 1}, on_error="skip")
    assert f.attrs["skipped_steps"].tolist() == [10]
    assert np.isnan(f.density.values).all(axis=1).tolist() == [False, True, False, False, False]


@pytest.mark.parametrize("lazy", [False, True])
def test_steps_with_the_number_of_a_skipped_one_stay(lazy):
    """As in scenes of two runs that were joined, whose steps have the same numbers."""
    one = xcg.datasets.random_scene(20, seed=1)
    steps = [one.assign_coords(time=[float(k)]) for k in range(4)]
    ds = xr.concat(
        steps, "time", data_vars="all", coords="minimal", compat="override", join="override"
    )
    ds = ds.assign_coords(step=("time", [0, 1, 1, 0])).assign(
        position=ds.position.where(ds.time != 1)
    )
    with pytest.warns(SkippedStep):
        f = (
            (ds.chunk(time=4) if lazy else ds)
            .cg.coarse_grain("density", width=1.0, on_error="skip")
            .compute()
        )
    assert f.skipped.values.tolist() == [False, True, False, False]
    np.testing.assert_array_equal(f.density[2], f.density[0])
    assert f.density[0].sum() > 0


def test_programming_errors_are_never_skipped(folder):
    from xcg.steps.analysis import map_over_time

    def broken(arrays):
        msg = "not the data's fault"
        raise TypeError(msg)

    ds = open_dumps(folder)
    out = map_over_time(ds, ["position"], broken, {"a": ((), "float64")}, "broken", "skip")
    with pytest.raises(TypeError, match="not the data"):
        out["a"].compute()


@pytest.mark.parametrize("error", [
    xcg.SceneError, ValueError, OSError, FileNotFoundError, EOFError, ArithmeticError, ZeroDivisionError,
    FloatingPointError, OverflowError, UnicodeDecodeError("utf-8", b"", 0, 1, ""),
])  # fmt: skip
@pytest.mark.parametrize("lazy", [False, True])
def test_faults_of_data_and_files_are_skipped(folder, error, lazy):
    from xcg.steps.analysis import map_over_time

    def faulty(arrays):
        if 20 in arrays["step"]:
            raise error
        return {"a": np.ones(len(arrays["step"])), "b": np.ones(len(arrays["step"]), int)}

    ds = open_dumps(folder) if lazy else open_dumps(folder).load()
    results = {"a": ((), "float64"), "b": ((), "int64")}
    with pytest.warns(
        SkippedStep, match=r"step 20 is skipped: \S"
    ):  # and why, also where the error says nothing
        out = dask.compute(
            map_over_time(ds, ["position", "step"], faulty, results, "faulty", "skip")
        )[0]
    a = out["a"]
    b = out["b"]
    skipped = out["skipped"]
    np.testing.assert_array_equal(a, [1, 1, np.nan, 1, 1])
    np.testing.assert_array_equal(b, [1, 1, -1, 1, 1])
    assert skipped.tolist() == [False, False, True, False, False]


@pytest.mark.parametrize("error", [
    TypeError, KeyError, IndexError, AttributeError, NameError, RuntimeError, NotImplementedError, AssertionError,
    MemoryError, RecursionError, StopIteration, ImportError, KeyboardInterrupt,
])  # fmt: skip
def test_errors_of_programs_are_raised(folder, error):
    from xcg.steps.analysis import map_over_time

    def broken(arrays):
        raise error

    ds = open_dumps(folder).load()
    with pytest.raises(error):
        map_over_time(ds, ["position"], broken, {"a": ((), "float64")}, "broken", "skip")


def test_whole_numbers_of_a_skipped_step_are_padding(folder):
    garble(folder / "p.20.dump")
    with pytest.warns(SkippedStep):
        got = open_dumps(folder).cg.force_chains(on_error="skip").compute()
    whole = [name for name, a in got.data_vars.items() if a.dtype.kind == "i"]
    assert len(whole) > 5
    for name in whole:
        assert (got[name].isel(time=2) == -1).all(), name


def test_wrong_on_error_raises(folder):
    for call in (lambda: open_dumps(folder, on_error="ignore"),
                 lambda: open_dumps(folder).cg.coarse_grain("density", on_error="ignore")):  # fmt: skip
        with pytest.raises(ValueError, match="on_error='ignore': expected 'raise'"):
            call()


def test_results_with_skipped_steps_are_saved(folder):
    garble(folder / "p.20.dump")
    f = open_dumps(folder).cg.coarse_grain(["density"], axes="z", on_error="skip")
    with pytest.warns(SkippedStep):
        f.to_netcdf(folder / "f.nc")
    with xr.open_dataset(folder / "f.nc") as g:
        assert g.skipped.dtype == bool
        assert g.density.sel(time=~g.skipped).notnull().all()
    with pytest.warns(SkippedStep):
        f.cg.save(folder / "f.vtkhdf")


# --- what messages quote ---------------------------------------------------------------------------------

CODES = "\x1b]0;title\x07\x9b31m\u202e"  # title of the window, colour, direction of writing
SHOWN = "\\x1b]0;title\\x07\\x9b31m\\u202e"


def test_messages_escape_control_characters(folder):
    dumps.write(
        folder / "p.10.dump",
        dumps.dump_text(columns=dumps.ATOMS.replace(" x ", f" {CODES} "), step=10),
    )
    with pytest.raises(xcg.SceneError) as error:
        xcg.open_scene(folder / "p.10.dump")
    with pytest.warns(xcg.SceneWarning) as said:
        open_dumps(folder, on_error="skip")
    command = CliRunner().invoke(group, ["info", str(folder / "p.10.dump")])
    for text in (str(error.value), " ".join(str(w.message) for w in said), command.output):
        assert SHOWN in text
        assert all(c.isprintable() or c == "\n" for c in text)


def test_the_summary_of_a_scene_is_printable(folder):
    ds = open_dumps(folder)
    text = repr(ds.assign({CODES: ds["diameter"]}).cg)
    assert SHOWN in text
    assert all(c.isprintable() or c == "\n" for c in text)


def test_errors_and_warnings_pickle():
    for one in (xcg.SceneError(CODES), xcg.SceneWarning(CODES), SkippedStep(3, CODES)):
        again = pickle.loads(pickle.dumps(one))
        assert (type(again), again.args, str(again)) == (type(one), one.args, str(one))


# --- files that cannot be opened -------------------------------------------------------------------------


@pytest.mark.parametrize(
    "damage", ["", "ITEM: TIMESTEP\n", "ITEM: TIMESTEP\nx\n", "\x00\x01\x02", "ITEM: ATOMS"]
)
@pytest.mark.parametrize("step", STEPS[::2])
def test_a_file_without_a_header_is_named_or_left_out(folder, damage, step):
    (folder / f"p.{step}.dump").write_text(damage)
    with pytest.raises(ValueError, match=rf"p\.{step}\.dump"):
        open_dumps(folder, engine="lammps")
    with pytest.warns(xcg.SceneWarning) as said:
        ds = open_dumps(folder, on_error="skip")
    assert any(f"p.{step}.dump" in str(w.message) for w in said)
    assert ds.attrs["skipped_files"].count(f"p.{step}.dump") == 1
    assert ds.step.values.tolist() == [s for s in STEPS if s != step]
    f = ds.cg.coarse_grain("density", axes="z", on_error="skip").compute()
    assert "skipped_files" in f.attrs
    assert not f.skipped.any()


def test_a_garbled_first_or_last_body_stays_a_step(folder):
    garble(folder / "p.0.dump")
    garble(folder / "p.40.dump")
    with pytest.raises(xcg.SceneError, match=r"p\.0\.dump"):
        open_dumps(folder)
    ds = open_dumps(folder, on_error="skip")
    with pytest.warns(SkippedStep) as said:
        f = ds.cg.coarse_grain("density", axes="z", on_error="skip").compute()
    assert len(said) == 2
    assert f.skipped.values.tolist() == [True, False, False, False, True]


def test_a_damaged_file_of_contacts_is_no_step_without_contacts(folder):
    (folder / "c.20.dump").write_text("")
    with pytest.warns(xcg.SceneWarning):
        assert open_dumps(folder, on_error="skip").step.values.tolist() == [0, 10, 30, 40]
    with pytest.raises(xcg.SceneError, match=r"c\.20\.dump.*missing='empty'"):
        open_dumps(folder, on_error="skip", missing="empty")


def test_missing_files_of_a_list_are_skipped(folder):
    paths = [folder / f"p.{step}.dump" for step in (*STEPS, 50)]
    with pytest.raises(FileNotFoundError, match=r"p\.50\.dump"):
        xcg.open_scene(paths)
    with pytest.warns(xcg.SceneWarning, match=r"p\.50\.dump"):
        assert xcg.open_scene(paths, on_error="skip").sizes["time"] == 5


def test_a_series_of_empty_files_raises(folder):
    for path in folder.glob("p.*"):
        path.write_text("")
    with pytest.raises(ValueError, match=r"p\.0\.dump"):
        open_dumps(folder, on_error="skip", engine="lammps")


def test_a_file_removed_after_opening_is_skipped(folder):
    ds = open_dumps(folder)
    (folder / "p.20.dump").unlink()
    with pytest.raises(xcg.SceneError, match="is gone"):
        ds.cg.coarse_grain("density", axes="z").compute()
    with pytest.warns(SkippedStep, match="is gone"):
        assert ds.cg.coarse_grain("density", axes="z", on_error="skip").skipped.values.sum() == 1


@pytest.mark.parametrize("keep", [0.45, 0.7, 0.85, 0.95])
@pytest.mark.parametrize("packed", [False, True])
def test_a_truncated_file_of_many_steps_raises_or_is_cut(tmp_path, keep, packed):
    data = "".join(dumps.dump_text(step=k) for k in range(6)).encode()
    path = tmp_path / ("many.dump.gz" if packed else "many.dump")
    step = len(data) / 6
    if packed:
        data = gzip.compress(data, 1)
    data = data[: int(keep * len(data))]
    path.write_bytes(data)
    there = len(zlib.decompressobj(31).decompress(data) if packed else data)
    whole = int((there - 1) / step)  # a step that nothing follows may go on
    with pytest.raises(xcg.SceneError, match=r"many\.dump"):
        xcg.open_scene(path).compute()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", xcg.SceneWarning)
        if not whole:
            with pytest.raises(xcg.SceneError, match=r"many\.dump"):
                xcg.open_scene(path, on_error="skip")
            return
        f = (
            xcg.open_scene(path, on_error="skip")
            .cg.coarse_grain("density", axes="z", on_error="skip")
            .compute()
        )
    good = f.sel(time=~f.skipped)
    assert good.step.values.tolist() == list(range(good.sizes["time"]))
    assert good.sizes["time"] == whole


def test_one_garbled_step_among_many_is_skipped(tmp_path):
    steps = [dumps.dump_text(step=k) for k in range(5)]
    steps[2] = steps[2].replace("ITEM: NUMBER OF ATOMS\n3", "ITEM: NUMBER OF ATOMS\nthree")
    path = dumps.write(tmp_path / "many.dump", steps)
    with pytest.warns(xcg.SceneWarning, match="'three' follows"):
        ds = xcg.open_scene(path, on_error="skip")
    assert ds.step.values.tolist() == [0, 1, 3, 4]


def test_damaged_vtp_files_are_skipped(tmp_path):
    for k in range(4):
        write_particles(
            tmp_path / f"P_{k}.vtp", time=k / 10, Density=np.ones(3), Velocity=np.zeros((3, 3))
        )
        write_contacts(tmp_path / f"F_{k}.vtp", [1], [2], [[1, 0, 0]], time=k / 10)
    whole = (tmp_path / "P_1.vtp").read_bytes()
    (tmp_path / "P_1.vtp").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "P_2.vtp").write_bytes(b"")
    patterns = {"particles": str(tmp_path / "P_*.vtp"), "contacts": str(tmp_path / "F_*.vtp")}
    with pytest.raises(xcg.SceneError, match=r"P_1\.vtp"):
        xcg.open_scene(**patterns)
    with pytest.warns(xcg.SceneWarning):
        ds = xcg.open_scene(**patterns, on_error="skip")
    assert ds.step.values.tolist() == [0, 3]


# --- headers that lie, and places beyond all meshes ------------------------------------------------------


@pytest.mark.parametrize("rows", [10**9, 10**15, 2**63 - 1, 2**64, -5])
def test_a_wrong_header_allocates_no_memory(tmp_path, rows):
    text = dumps.dump_text().replace("NUMBER OF ATOMS\n3", f"NUMBER OF ATOMS\n{rows}")
    dumps.write(tmp_path / "p.dump", text)
    with pytest.raises(xcg.SceneError, match=r"p\.dump"):
        xcg.open_scene(tmp_path / "p.dump")


def test_a_compressed_file_of_one_endless_line_raises(tmp_path):
    (tmp_path / "p.dump").write_bytes(gzip.compress(b"ITEM: TIMESTEP" + b"0" * (1 << 24)))
    with pytest.raises(xcg.SceneError, match="no end of a line"):
        xcg.open_scene(tmp_path / "p.dump", engine="lammps")


@pytest.mark.parametrize("far", [1e17, 1e30, -1e300])
def test_a_grain_beyond_countable_distance_raises(far):
    ds = xcg.datasets.simple_cubic(3)
    ds.position.values[0, 0, 1] = far
    with pytest.raises(xcg.SceneError, match=r"reaches .* from the mesh along 'y'"):
        ds.cg.coarse_grain("density", bounds=dict.fromkeys("xyz", (0, 1)))


def test_grains_far_away_take_no_memory_and_change_no_field():
    near = np.random.default_rng(0).uniform(0, 5, (50, 3))
    far = np.concatenate([near, [[1e6, 1e6, 1e6], [-1e6, 1e7, 1e5]]])
    options = {"bounds": dict.fromkeys("xyz", (0.0, 5.0)), "width": 0.5}
    few, more = (
        xcg.scene_from_arrays(x, diameter=np.ones(len(x)), density=2.0).cg.coarse_grain(
            "density", **options
        )
        for x in (near, far)
    )
    xr.testing.assert_allclose(more.density, few.density, rtol=1e-12)


def test_a_box_far_smaller_than_its_grains_raises():
    ds = xcg.datasets.simple_cubic(3)
    ds.box.values[:, 0] = (0, 1e-9)
    with pytest.raises(xcg.SceneError, match="along 'x' the period is 1e-09 m, and the reach 3 m"):
        ds.cg.coarse_grain("density", bounds=dict.fromkeys("xyz", (0, 1)), spacing=0.5, width=0.75)


def test_a_mesh_of_too_many_nodes_raises():
    ds = xcg.datasets.simple_cubic(3)
    with pytest.raises(ValueError, match="nodes along 'x', more than"):
        ds.cg.coarse_grain("density", bounds={"x": (0, 1e300)}, axes="x")


def test_a_box_far_smaller_than_the_widest_kernel_raises():
    ds = xcg.datasets.simple_cubic(3)
    ds["species"] = ds.diameter.dims, np.where(np.arange(ds.sizes["particle"]) < 9, 1, 2)[None]
    ds.box.values[:, 0] = (0, 0.1)
    wide = {"bounds": dict.fromkeys("xyz", (0, 1)), "spacing": 0.5, "by": "species"}
    ds.cg.coarse_grain("density", width={1: 0.3, 2: 0.4}, **wide)
    with pytest.raises(
        xcg.SceneError, match=r"along 'x' the period is 0\.1 m, and the reach 200 m"
    ):
        ds.cg.coarse_grain("density", width={1: 0.3, 2: 50.0}, **wide)
