"""Binary dumps of LAMMPS."""

import numpy as np
import pytest
import xarray as xr

import xcg
from tests import real_data
from tests.dumps import dump_text, pairs_text, write
from tests.lammps_forms import BOX, DEFAULTS, binary_step, check, frames_of, lammps, rows_of


def test_a_binary_dump_equals_the_text_dump_beside_it():
    """Both by LAMMPS 22Jul2025, the text with all digits."""
    folder = real_data("lammps_binary")
    walls = {"floor": "f_floor[*]"}
    text, binary = (
        xcg.open_scene(folder / f"particles.{end}", walls=walls) for end in ("dump.gz", "bin")
    )
    xr.testing.assert_identical(
        binary.drop_attrs(deep=False).compute(), text.drop_attrs(deep=False).compute()
    )
    assert binary.sizes["time"] == 2
    assert binary.attrs["periodic"] == "xy"
    assert (binary.contact_j.values[0] == -2).any()
    assert "floor" not in binary.attrs.get("not_read", "")


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("parts", [1, 3])
@pytest.mark.parametrize("word", [b"DUMPCUSTOM", b"DUMPATOM"])
def test_both_byte_orders_and_several_processes_are_read(tmp_path, order, parts, word):
    steps = [rows_of(7, seed=k) for k in range(3)]
    data = [binary_step(rows, step=10 * k, time=0.5 * k, units="" if k else "cgs", order=order, parts=parts, word=word)
            for k, rows in enumerate(steps)]  # fmt: skip
    (tmp_path / "p.bin").write_bytes(b"".join(data))
    refs, frames = frames_of(tmp_path / "p.bin")
    assert [(ref.step, ref.time, ref.units, ref.box, ref.periodic) for ref in refs] == [
        (10 * k, 0.5 * k, "cgs", BOX, "xy") for k in range(3)
    ]
    for frame, rows in zip(frames, steps, strict=True):
        check(frame, rows)


def test_a_tilted_box_equals_that_of_the_text(tmp_path):
    tilts = (2.0, 0.5, -0.25)
    (tmp_path / "p.bin").write_bytes(binary_step(rows_of(), tilts=tilts))
    bounds = [f"{low} {high} {tilt}" for (low, high), tilt in zip(BOX, tilts, strict=True)]
    lines = "\n".join(["ITEM: BOX BOUNDS xy xz yz pp pp ff", *bounds, ""])
    text = write(tmp_path / "p.dump", dump_text(box=lines))
    (binary,), (of_text,) = (
        lammps.index_particles([str(p)], DEFAULTS) for p in (tmp_path / "p.bin", text)
    )
    assert (binary.box, binary.lattice, binary.periodic) == (
        of_text.box,
        of_text.lattice,
        of_text.periodic,
    )


def test_binary_particles_with_contacts_in_text_are_lazy(tmp_path):
    rows = np.array([[1, 1, 1, 1, 1, 0, 0, 0, 0.5, 1], [2, 1, 1.9, 1, 1, 0, 0, 0, 0.5, 1]])
    for step in (0, 10):
        (tmp_path / f"p.{step}.bin").write_bytes(binary_step(rows, step=step, time=step / 10))
        write(
            tmp_path / f"c.{step}.dump", pairs_text(step=step, before=f"ITEM: TIME\n{step / 10}\n")
        )
    ds = xcg.open_scene(str(tmp_path / "p.*.bin"), contacts=str(tmp_path / "c.*.dump"), chunks=1)
    assert ds.position.chunks[0] == (1, 1)
    np.testing.assert_array_equal(ds.contact_force.values[:, 0], [[-9, 1, 0]] * 2)
    xr.testing.assert_identical(
        xr.open_dataset(str(tmp_path / "p.10.bin"), engine="xcg").position.load(),
        ds.position.isel(time=[1]).compute().drop_attrs(deep=False).assign_attrs(ds.position.attrs),
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: data[:-8], "followed by a block of 30 values"),
        (lambda data: data[:60], "is cut off"),
        (lambda data: data.replace(b"radius", b"mass  "), "names id type x"),
        (lambda data: data + b"\0" * 8, "does not begin with"),
        (
            lambda data: data[:34] + (2**40).to_bytes(8, "little") + data[42:],
            "promises 1099511627776 rows",
        ),
        (
            lambda data: data.replace(b"\x01\0\0\0\x02\0\0\0", b"\x01\0\0\0\x09\0\0\0", 1),
            "is of revision 9",
        ),
    ],
)
def test_damaged_binary_dumps_raise(tmp_path, change, message):
    path = tmp_path / "p.bin"
    path.write_bytes(change(binary_step(rows_of())))
    with pytest.raises(xcg.SceneError, match=message) as error:
        frames_of(path)
    assert "p.bin" in str(error.value)


def test_a_binary_dump_of_contacts_raises(tmp_path):
    (tmp_path / "p.bin").write_bytes(binary_step(rows_of()))
    with pytest.raises(xcg.SceneError, match=r"p\.bin: .* for particles="):
        lammps.index_contacts([str(tmp_path / "p.bin")], DEFAULTS)
