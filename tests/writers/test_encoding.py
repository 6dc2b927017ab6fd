"""Numbers on disk: rounded to what was promised, compressed by filters that every HDF5 reads, in few files."""

import zlib

import h5py
import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

import xcg
from tests.dumps import write_series
from tests.scenes import random_steps, reopen
from xcg.cli import group
from xcg.compiled.arrays import round_bits
from xcg.writers.encoding import Encoding
from xcg.writers.formats import deflated


@settings(deadline=None)
@given(
    st.lists(st.floats(width=64), min_size=1, max_size=50),
    st.integers(1, 15),
)
def test_rounding_errors_are_within_the_stated_bound(numbers, digits):
    values = np.array(numbers)
    rounded = Encoding(digits=digits).reduced(values)
    normal = np.isfinite(values) & (np.abs(values) > 1e-300) & (np.abs(values) < 1e308)
    error = np.abs(rounded[normal] - values[normal])
    assert (error <= 0.5 * 10.0**-digits * np.abs(values)[normal]).all()
    np.testing.assert_array_equal(rounded[~np.isfinite(values)], values[~np.isfinite(values)])
    assert Encoding(digits=digits).reduced(rounded).tobytes() == rounded.tobytes()


@pytest.mark.parametrize("drop", [1, 3, 5])
def test_bits_are_rounded_to_nearest_even(drop):
    numbers = np.arange(200, dtype="uint32")
    special = np.uint32(0xF0000000)
    bits = np.append(numbers, [special, special + np.uint32(7)])
    round_bits(bits, np.uint32(drop), special)
    assert bits[:200].tolist() == [
        round(n / 2**drop) * 2**drop for n in range(200)
    ]  # Python's ties go to even, too
    assert bits[200:].tolist() == [special, special + 7]


@pytest.mark.parametrize("digits", range(1, 8))
def test_single_precision_errors_are_within_the_note(digits):
    values = 10.0 ** np.random.default_rng(digits).uniform(-6, 6, 100_000)
    encoding = Encoding(dtype="float32", digits=digits)
    told = encoding.noted(xr.Dataset({"a": ("time", values)})).a.attrs["precision"]
    error = np.abs(encoding.reduced(values).astype("float64") / values - 1).max()
    assert error <= float(told.split()[-1]) <= max(0.5 * 10.0**-digits, 6e-8) * 1.001


def test_rounding_keeps_no_more_digits_than_requested():
    values = np.random.default_rng(0).uniform(1, 10, 1000)
    worst = [np.abs(Encoding(digits=d).reduced(values) / values - 1).max() for d in range(1, 8)]
    assert all(error > 0.05 * 10.0**-d for d, error in enumerate(worst, start=1))
    single = Encoding(dtype="float32", digits=3).reduced(values)
    assert single.dtype == "float32"
    assert 5e-5 < np.abs(single / values - 1).max() <= 5e-4


@pytest.mark.parametrize("dtype", ["f8", "f4", "i8", "i4", "i2", "u1"])
def test_bytes_are_shuffled_as_hdf5_does(dtype):
    values = np.random.default_rng(1).integers(-100, 100, (17, 300)).astype(dtype)
    plain = np.ascontiguousarray(values.reshape(-1).view("u1").reshape(-1, values.itemsize).T)
    assert zlib.decompress(deflated(values)) == plain.tobytes()


@pytest.mark.parametrize("lazy", [False, True])
@pytest.mark.parametrize("suffix", [".nc", ".zarr"])
@pytest.mark.parametrize(
    "options", [{"compression": 1}, {"compression": 9}, {"digits": 4}, {"dtype": "float32"}]
)
def test_values_read_back_equal_the_rounded_ones(tmp_path, suffix, lazy, options):
    ds = random_steps(5)
    f = (ds.chunk(time=2) if lazy else ds).cg.coarse_grain(["density", "velocity", "stress"])
    back = reopen(xcg.save(f, tmp_path / f"f{suffix}", **options)).compute()
    f = f.compute()
    for name, field in f.data_vars.items():
        there = back[name]
        assert there.dtype == options.get("dtype", "float64")
        bound = {"digits": 0.5e-4, "dtype": 2.0**-24}.get(next(iter(options)), 0.0)
        error = np.abs(there.astype("float64") - field)
        assert (error <= bound * np.abs(field)).where(field.notnull(), True).all(), name
        assert (there.isnull() == field.isnull()).all()
        assert ("precision" in there.attrs) == ("digits" in options)


def test_files_of_fields_are_smaller_by_digits(tmp_path):
    f = xcg.datasets.dense_packing(2000).cg.coarse_grain()
    sizes = [
        xcg.save(f, tmp_path / f"{k}.nc", **options).stat().st_size
        for k, options in enumerate([{}, {"compression": 1}, {"digits": 4}])
    ]
    assert sizes[0] >= f.nbytes
    assert sizes[1] < 0.95 * sizes[0]
    assert sizes[2] < 0.4 * sizes[0]
    with h5py.File(tmp_path / "2.nc") as file:
        assert file["stress"].shuffle
        assert file["stress"].compression == "gzip"
    with h5py.File(tmp_path / "0.nc") as file:
        assert file["stress"].compression is None


def test_all_levels_of_hdf5_take_one_encoder(tmp_path):
    f = random_steps(2).cg.coarse_grain(["density"])
    chunks = []
    for level in (1, 4, 9):
        path = xcg.save(f, tmp_path / f"{level}.nc", compression=level)
        with h5py.File(path) as file:
            _, chunk = file["density"].id.read_direct_chunk((0, 0, 0, 0))
        chunks.append(chunk)
    assert chunks[0] == chunks[1] == chunks[2]


def test_scenes_are_compressed_without_loss(tmp_path):
    ds = random_steps(3)
    path = xcg.save(ds, tmp_path / "scene.nc")
    with h5py.File(path) as file:
        assert file["position"].compression == "gzip"
    xr.testing.assert_identical(ds.drop_encoding(), xr.open_dataset(path).compute().drop_encoding())


def test_vtkhdf_takes_the_same_options(tmp_path):
    f = random_steps(2).cg.coarse_grain(["density"])
    with h5py.File(xcg.save(f, tmp_path / "f.vtkhdf", digits=3, dtype="float32")) as file:
        data = file["VTKHDF/PointData/density"]
        assert data.dtype == "float32"
        assert data.compression == "gzip"
        values = np.moveaxis(f.density.to_numpy(), (1, 2, 3), (3, 2, 1))
        assert 0 < np.abs(data[...] - values).max() <= 0.5e-3 * values.max()


def test_short_steps_share_files(tmp_path):
    ds = random_steps(4)
    f = ds.isel(time=np.arange(60) % 4).assign_coords(time=np.arange(60.0)).chunk(time=1)
    f = f.cg.coarse_grain(["density", "velocity"], axes="z")
    path = xcg.save(f, tmp_path / "f.zarr")
    assert sum(p.is_file() for p in path.rglob("*")) < 30
    xr.testing.assert_equal(reopen(path).compute(), f.compute())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"digits": 0}, "digits=0"),
        ({"digits": 2.5}, "digits=2.5"),
        ({"digits": 8, "dtype": "float32"}, "from 1 to 7"),
        ({"dtype": "int32"}, "dtype='int32'"),
        ({"compression": 11}, "compression=11"),
    ],
)
def test_wrong_digits_raise(tmp_path, options, message):
    f = xcg.datasets.simple_cubic(3).cg.coarse_grain(["density"])
    for suffix in (".nc", ".vtkhdf"):
        with pytest.raises(ValueError, match=message):
            xcg.save(f, tmp_path / f"f{suffix}", **options)
    assert not list(tmp_path.iterdir())


def test_the_command_line_takes_digits_and_compression(tmp_path):
    write_series(tmp_path)
    job = tmp_path / "job.toml"
    job.write_text(
        '[scene]\nparticles = "p.*.dump"\ncontacts = "c.*.dump"\n[fields]\nfields = ["density"]\n'
        '[output]\nfolder = "out"\ndigits = 3\nvtkhdf = "temporal"\n'
    )
    done = CliRunner().invoke(group, ["run", "--quiet", str(job)])
    assert done.exit_code == 0, done.output
    assert (
        "3 significant digits"
        in xr.open_dataset(tmp_path / "out" / "fields.nc").density.attrs["precision"]
    )
    job.write_text(job.read_text().replace("digits = 3", "digits = 99"))
    done = CliRunner().invoke(group, ["run", "--quiet", str(job)])
    assert done.exit_code == 1
    assert "digits=99" in done.output


def test_users_register_a_format(tmp_path):
    def write_text(ds, path, encoding, *, overwrite):
        np.savetxt(path, encoding.reduced(ds.density.to_numpy()))

    xcg.register_writer(".txt", write_text)
    xcg.register_writer(".txt", write_text)
    f = random_steps(2).cg.coarse_grain(["density"], axes="z")
    path = xcg.save(f, tmp_path / "f.txt", digits=3)
    np.testing.assert_allclose(np.loadtxt(path), f.density, rtol=0.5e-3)
    with pytest.raises(FileExistsError, match=r"f\.txt exists"):
        xcg.save(f, path)
    with pytest.raises(ValueError, match="taken"):
        xcg.register_writer(".nc", write_text)
    with pytest.raises(ValueError, match="with its dot"):
        xcg.register_writer("txt", write_text)
    with pytest.raises(ValueError, match="write=3: expected a function"):
        xcg.register_writer(".none", 3)
    with pytest.raises(ValueError, match=r"\.txt"):
        xcg.save(f, tmp_path / "f.tex")


def test_a_folder_in_place_of_a_file_raises_before_computing(tmp_path):
    def fail(values):
        raise AssertionError

    f = xcg.datasets.random_scene(50, seed=1).chunk(time=1).cg.coarse_grain("density", axes="z")
    for name in ("f.nc", "f.h5", "f.vtkhdf"):
        (tmp_path / name).mkdir()
        lazy = f.assign(
            density=f.density.copy(data=f.density.data.map_blocks(fail, meta=np.empty((0, 0))))
        )
        with pytest.raises(IsADirectoryError, match=f"{name} is a folder, .* choose another name"):
            lazy.cg.save(tmp_path / name, overwrite=True)
        assert not list((tmp_path / name).iterdir())


def test_scenes_saved_as_images_raise(tmp_path):
    for name in ("s.vtkhdf", "s.pvd"):
        with pytest.raises(
            ValueError, match="particles and contacts are no dimensions of an image"
        ):
            xcg.datasets.random_scene(50, seed=1).cg.save(tmp_path / name)
    assert not list(tmp_path.iterdir())
