"""What users of xarray expect: units that pint reads, accessors after reopening, plots without arguments."""

import re

import numpy as np
import pytest
import xarray as xr

import xcg
from tests import ROOT
from xcg.analysis.chain_results import RESULTS
from xcg.analysis.quantities import QUANTITIES
from xcg.fields.formulas import registry
from xcg.scene.schema import BOX, VARIABLES, powers_of, units_in, units_of

# of grains at random, the widest kernel has the least error
pytestmark = pytest.mark.filterwarnings("ignore:choose_width. the error of velocity is least")


@pytest.fixture(scope="module")
def scene():
    return xcg.datasets.random_scene(60, seed=1)


TABLES = (registry.FIELDS, VARIABLES, BOX, QUANTITIES, RESULTS)


def test_units_in_the_tables_are_canonical():
    for row in (row for table in TABLES for row in table.values()):
        canonical = units_of(powers_of(row.units))
        if row.units in ("Pa s", "J"):  # of a viscosity; a density of spin has the same powers
            canonical = row.units
        assert canonical == row.units == units_in(row.units, "SI"), row
        assert units_in(row.units, "reduced") == "1"


FLOOR, MIDDLE = (xcg.Plane(point=(0, 0, z), normal=(0, 0, 1)) for z in (0.0, 1.0))
RESULTS_OF = {
    "coarse_grain": lambda ds: ds.cg.coarse_grain(width=0.6, axes="z"),
    "accessible": lambda ds: ds.cg.coarse_grain("density", width=0.6, axes="z", surfaces=[FLOOR]),
    "displacement": lambda ds: ds.cg.displacement(width=0.6, axes="z"),
    "time_average": lambda ds: ds.cg.coarse_grain("density", width=0.6).cg.time_average(),
    "profile": lambda ds: ds.cg.coarse_grain("density", width=0.6).cg.profile("z"),
    "spatial_correlation": lambda ds: ds.cg.coarse_grain(
        "density", width=0.6
    ).cg.spatial_correlation("density"),
    "time_correlation": lambda ds: ds.cg.coarse_grain("density", width=0.6).cg.time_correlation(
        "density"
    ),
    "free_surface": lambda ds: ds.cg.coarse_grain("volume_fraction", width=0.6).cg.free_surface(),
    "balance": lambda ds: ds.cg.balance(width=0.6, axes="z", spacing=0.2),
    "cell_volumes": lambda ds: ds.cg.cell_volumes(spacing=0.5),
    "choose_width": lambda ds: ds.cg.choose_width("velocity", axes="z"),
    "depth_average": lambda ds: ds.cg.depth_average(width=0.6),
    "flow_rate": lambda ds: ds.cg.flow_rate(MIDDLE, width=0.6),
    "mean_squared_displacement": lambda ds: ds.cg.mean_squared_displacement(),
    "velocity_autocorrelation": lambda ds: ds.cg.velocity_autocorrelation(),
    "slice_temperature": lambda ds: ds.cg.slice_temperature(axis="z"),
    "wall_stress": lambda ds: ds.cg.wall_stress(FLOOR, width=0.6),
    "width_sweep": lambda ds: ds.cg.width_sweep([0.4, 0.5, 0.6], "density", axes="z"),
    "size_statistics": lambda ds: ds.cg.size_statistics(),
    "microstructure": lambda ds: ds.cg.microstructure(),
    "particle_stress": lambda ds: ds.cg.particle_stress(),
    "radial_distribution": lambda ds: ds.cg.radial_distribution(
        1.0, axis="z", by="species", bounds={"z": (0, 5)}
    ),
    "contact_value": lambda ds: ds.cg.contact_value(bounds={"z": (0, 5)}),
    "structure_factor": lambda ds: (
        ds.assign_attrs(periodic="xyz").drop_vars("setup").cg.structure_factor(k_max=5.0)
    ),
    "bond_order": lambda ds: ds.cg.bond_order(neighbours=4),
    "force_chains": lambda ds: ds.cg.force_chains(),
    "find_contacts": lambda ds: ds.cg.find_contacts(k_n=1.0),
    "derive": lambda ds: ds.drop_vars("velocity").cg.derive("velocity"),
    "derive_superquadric": lambda ds: ds.assign(
        {f"half_axis_{a}": ds.diameter.assign_attrs(units="m") for a in "xyz"}
    ).cg.derive_superquadric(),
    "assign_phases": lambda ds: ds.cg.assign_phases(edges=[1.0]),
}


@pytest.fixture(scope="module")
def walled():
    one = xcg.datasets.random_scene(60, seed=1, walls=True, periodic="xy")
    steps = [one.assign_coords(time=one.time + k, step=one.step + k) for k in range(3)]
    joined = xr.concat(steps, "time", data_vars="all", coords="minimal", combine_attrs="override")
    joined["time"].attrs = {"units": "s", "long_name": "time", "axis": "T"}
    return joined


@pytest.mark.parametrize("name", RESULTS_OF)
def test_every_number_of_a_result_has_a_unit(walled, name):
    """Coordinates, too, as plots take their labels from them."""
    found = RESULTS_OF[name](walled)
    bare = {
        str(n)
        for n, v in found.variables.items()
        if v.dtype.kind in "fi" and "units" not in v.attrs
    }
    assert not bare - {"principal"}  # 1, 2, 3: labels
    if "time" in found.dims:
        assert found["time"].attrs == walled["time"].attrs


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
            expected = expected * units.Quantity(1.0, symbol) ** int(
                np.dot(power, powers_of(row.units))
            )
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
    assert all(
        quantified[name].pint.units is not None
        for name in ds.data_vars
        if "units" in ds[name].attrs
    )
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
    assert {"profile", "save"} <= set(dir(again.cg))


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
