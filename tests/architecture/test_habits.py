"""What users of xarray expect: units that pint reads, accessors after reopening, plots without arguments."""

import re

import numpy as np
import pytest
import xarray as xr

import xcg
from tests import ROOT
from xcg.chains.results import RESULTS
from xcg.fields.formulas import registry
from xcg.packing.quantities import QUANTITIES
from xcg.scene.schema import BOX, VARIABLES, powers_of, units_in, units_of


@pytest.fixture(scope="module")
def scene():
    return xcg.datasets.random_scene(60, seed=1)


TABLES = (registry.FIELDS, VARIABLES, BOX, QUANTITIES, RESULTS)


def test_units_in_the_tables_are_canonical():
    for row in (row for table in TABLES for row in table.values()):
        assert units_of(powers_of(row.units)) == row.units == units_in(row.units, "SI"), row
        assert units_in(row.units, "reduced") == "1"


@pytest.mark.parametrize(("text", "powers"), [
    ("1", (0, 0, 0)), ("kg m^-3", (-3, 1, 0)), ("m**2 s-2", (2, 0, -2)), ("J s^-1 m^-3", (-1, 1, -3)),
    ("N m^-1 m^-1", (-1, 1, -2)),
])  # fmt: skip
def test_units_are_read_in_the_notations_of_udunits_and_pint(text, powers):
    assert powers_of(text) == powers


def test_pint_reads_all_units():
    pint = pytest.importorskip("pint")
    units = pint.UnitRegistry()
    base = {"kg": (0, 1, 0), "m": (1, 0, 0), "s": (0, 0, 1)}
    for row in (row for table in TABLES for row in table.values()):
        found = units.Quantity(1.0, row.units).to_base_units()
        assert found.magnitude == 1
        expected = units.Quantity(1.0, "")
        for symbol, power in base.items():
            expected = expected * units.Quantity(1.0, symbol) ** int(np.dot(power, powers_of(row.units)))
        assert found.units == expected.units, row


@pytest.mark.parametrize(
    "make",
    [
        lambda ds: ds,
        lambda ds: ds.cg.coarse_grain(axes="xz"),
        lambda ds: ds.cg.coarse_grain(["density", "velocity"], axes="z", by="species"),
        lambda ds: ds.cg.microstructure(),
        lambda ds: ds.cg.particle_stress(),
    ],
)
def test_pint_xarray_quantifies_scenes_and_results(scene, make):
    pytest.importorskip("pint_xarray")
    ds = make(scene)
    quantified = ds.pint.quantify()
    assert all(quantified[name].pint.units is not None for name in ds.data_vars if "units" in ds[name].attrs)
    back = quantified.pint.dequantify(format="~C")
    for name in ds.data_vars:
        np.testing.assert_array_equal(back[name], ds[name])


def test_pint_converts_units_of_results(scene):
    pytest.importorskip("pint_xarray")
    f = scene.cg.coarse_grain(["density", "stress"], axes="z")
    density = f.pint.quantify().density.pint.to("g/cm^3")
    np.testing.assert_allclose(density.pint.magnitude, f.density / 1000, rtol=1e-15)


def test_quantified_results_are_not_saved_until_dequantified(scene, tmp_path):
    pytest.importorskip("pint_xarray")
    f = scene.cg.coarse_grain(["density"], axes="z").pint.quantify()
    with pytest.raises(TypeError, match=r"density.*: expected plain numbers.*dequantify"):
        f.cg.save(tmp_path / "f.nc")
    f.pint.dequantify(format="~C").cg.save(tmp_path / "f.nc")
    assert xr.open_dataset(tmp_path / "f.nc").density.attrs["units"] == "kg/m**3"


@pytest.mark.parametrize("ending", ["nc", "zarr"])
def test_results_reopen_with_their_accessor(scene, tmp_path, ending):
    f = scene.cg.coarse_grain(["density", "velocity", "stress"], axes="xz")
    f.cg.save(tmp_path / f"f.{ending}")
    again = xr.open_dataset(tmp_path / f"f.{ending}", engine="zarr" if ending == "zarr" else None)
    xr.testing.assert_identical(again.cg.profile("z").load(), f.cg.profile("z"))
    assert repr(again.cg).splitlines()[0] == repr(f.cg).splitlines()[0]
    assert {"profile", "save", "to_vtkhdf"} <= set(dir(again.cg))


def test_the_first_plot_of_the_readme_has_x_across_and_z_up(scene):
    """The x axis is across, and z is up."""
    pyplot = pytest.importorskip("matplotlib.pyplot")
    page = (ROOT / "README.md").read_text()
    plot = re.search(r"^f\.sel.*\.plot\(.*$", page, re.MULTILINE)[0]
    f = scene.cg.coarse_grain(["stress"], spacing=1.0)
    drawn = eval(plot, {"f": f})
    axes = drawn.axs[0, 0]
    assert axes.get_xlim()[1] == pytest.approx(f.x[-1] + 0.5 * f.x.diff("x")[0])
    assert (axes.get_xlabel().split("[")[0], axes.get_ylabel().split("[")[0]) == tuple(
        f"{f[a].attrs['long_name']} " for a in "xz"
    )
    pyplot.close("all")
