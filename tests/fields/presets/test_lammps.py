"""The preset of LAMMPS' own coarse-graining: against its output, and against its formulas written out."""

import numpy as np
import pytest
import xarray as xr

import xcg
from tests import ROOT

SHAPE = (20, 10, 35)  # bins of 1, at whose centres the nodes are
CUTOFF, WIDTH = 1.5, 0.5
# Columns of the table: bin, natoms, density, volume fraction, momentum, velocity, then tensors by rows of components.
COLUMNS = {
    "density": slice(2, 3), "volume/fraction": slice(3, 4), "momentum": slice(4, 7), "velocity": slice(7, 10),
    "stress/contacts": slice(10, 19),
}  # fmt: skip


@pytest.fixture(scope="module")
def chute():
    folder = ROOT / "tests" / "data" / "lammps_continuum"
    ds = xcg.open_scene(
        folder / "particles.*.gz", contacts=folder / "contacts.*.gz", frozen=2
    ).load()
    return ds, np.loadtxt(folder / "fields_3d.txt.gz")


def flat(field):
    """Values in the bins of the table, every 9th."""
    return field.isel(time=0).transpose("x", "y", "z", ...).values.reshape(np.prod(SHAPE), -1)[::9]


def test_fields_equal_those_of_lammps(chute):
    ds, table = chute
    mesh = xcg.lammps_mesh(ds, delta=1.0, cutoff=CUTOFF, width=WIDTH)
    f = ds.cg.coarse_grain([f"{name}/*" for name in COLUMNS], preset="lammps", **mesh)
    assert tuple(f.sizes[a] for a in "xyz") == SHAPE
    for name, columns in COLUMNS.items():
        found = flat(f[name.replace("/", "_")])
        expected = table[:, columns]
        if name == "velocity":  # zero there where nothing is, NaN here
            assert (np.isnan(found).any(axis=1) == (table[:, 2] == 0)).all()
            found = np.nan_to_num(found)
        rounding = (
            2e-13 if name == "stress/contacts" else 1e-14
        )  # of the polynomials along branches
        np.testing.assert_allclose(found, expected, rtol=0, atol=rounding * np.abs(expected).max())


def test_the_boundary_force_equals_that_of_lammps_where_no_contact_crosses_an_edge(chute):
    """Theirs loses contacts across periodic edges, so that only nodes that see none of these agree."""
    ds, table = chute
    mesh = xcg.lammps_mesh(ds, delta=1.0, cutoff=CUTOFF, width=WIDTH)
    f = ds.cg.coarse_grain(["boundary/force"], preset="lammps", **mesh)
    row = {name: np.searchsorted(ds.particle_id[0], ds[f"contact_{name}"][0]) for name in "ij"}
    x = ds.position.values[0]
    crossing = np.abs(x[row["i"]] - x[row["j"]])[:, :2].max(axis=1) > 5
    point = ds.contact_point.values[0][crossing]
    nodes = np.stack(np.meshgrid(*(f[a] for a in "xyz"), indexing="ij"), axis=-1).reshape(-1, 1, 3)
    apart = nodes - point
    apart -= np.array([20.0, 10.0, 0.0]) * np.rint(apart / np.array([20.0, 10.0, np.inf]))
    apart = (np.linalg.norm(apart, axis=2).min(axis=1) > CUTOFF)[::9]
    found = flat(f.boundary_force)[apart]
    expected = table[apart, 19:22]
    assert (np.abs(expected).max(axis=1) > 0).sum() > 15
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14 * np.abs(expected).max())


def kernel(r, dimension):
    """Its kernel, normalised numerically in the dimension of its bins."""

    def shape(r):
        inside = np.exp(-(r**2) / 2 / WIDTH**2) - np.exp(-(CUTOFF**2) / 2 / WIDTH**2)
        return np.where(r < CUTOFF, inside, 0.0)

    x, w = np.polynomial.legendre.leggauss(200)
    radii = 0.5 * CUTOFF * (1 + x)
    sphere = {1: 2.0, 2: 2 * np.pi, 3: 4 * np.pi}[dimension]
    return shape(r) / (0.5 * CUTOFF * w @ (sphere * radii ** (dimension - 1) * shape(radii)))


@pytest.mark.parametrize("axes", ["z", "xz", "xyz"])
def test_fields_equal_their_formulas_written_out(axes):
    """Over bins along some axes: a kernel of as many dimensions, over the length of the others."""
    ds = xcg.datasets.random_scene(80, periodic="xy", seed=8)
    size = 5.0
    mesh = xcg.lammps_mesh(ds, axes, delta=1.25, cutoff=CUTOFF, width=WIDTH)
    f = ds.cg.coarse_grain(preset="lammps", **mesh).isel(time=0).transpose(*axes, ...)
    seen = ["xyz".index(a) for a in axes]
    m = ds.mass.values[0]
    v = ds.velocity.values[0]
    x = ds.position.values[0]
    for place in ([0] * len(axes), [2] * len(axes), [1, 2, 2][: len(axes)]):
        apart = np.array([f[a].values[k] for a, k in zip(axes, place, strict=True)]) - x[:, seen]
        for column, k in enumerate(seen):
            if k < 2:
                apart[:, column] -= size * np.rint(apart[:, column] / size)
        w = kernel(np.linalg.norm(apart, axis=1), len(axes)) / size ** (3 - len(axes))
        rho = w @ m
        p = (w * m) @ v
        out = v - p / rho
        at = f.isel(dict(zip(axes, place, strict=True)))
        kinetic = -np.einsum("i,ia,ib->ab", w * m, out, out)
        expected = {
            "density": rho, "volume_fraction": w @ ds.volume.values[0], "momentum": p, "velocity": p / rho,
            "stress_ke": kinetic, "temperature": 0.5 * (w * m) @ (out**2).sum(axis=1),
            "stress": kinetic + at.stress_contacts.values,
        }  # fmt: skip
        for name, value in expected.items():
            np.testing.assert_allclose(
                at[name], value, rtol=1e-11, atol=1e-13 * np.abs(value).max(), err_msg=name
            )


def test_gradients_are_differences_between_bins():
    ds = xcg.datasets.random_scene(200, periodic="xyz", seed=9)
    mesh = xcg.lammps_mesh(ds, "xz", delta={"x": 1.0, "z": 1.25}, cutoff=CUTOFF, width=WIDTH)
    f = ds.cg.coarse_grain(["velocity", "velocity/grad", "strain_rate"], preset="lammps", **mesh)
    differences = (f.velocity.roll(z=-1) - f.velocity.roll(z=1)) / 2.5
    np.testing.assert_allclose(
        f.velocity_grad.sel(direction="z"), differences, rtol=1e-12, atol=1e-13
    )
    assert (f.velocity_grad.sel(direction="y") == 0).all()
    g = f.velocity_grad
    swapped = g.rename(component="direction", direction="component").transpose(*g.dims)
    np.testing.assert_allclose(f.strain_rate, (g + swapped) / 2, rtol=1e-12)


def test_mesh_equals_that_of_the_bins():
    ds = xcg.datasets.random_scene(20)  # a box of 5
    mesh = xcg.lammps_mesh(
        ds, "xy", delta={"x": 0.1, "y": 2.0}, cutoff=1.0, width=0.3, origin={"y": 0.5}
    )
    assert mesh["bounds"]["x"] == pytest.approx((0.05, 4.95))
    assert mesh["bounds"]["y"] == pytest.approx((1.5, 5.5))  # the last bin reaches beyond the box
    f = ds.cg.coarse_grain("density", **mesh)
    assert (f.sizes["x"], f.sizes["y"]) == (50, 3)
    assert f.attrs["kernel"] == "shifted gaussian"


def test_kernel_and_units_of_the_preset():
    ds = xcg.datasets.random_scene(60)
    f = ds.cg.coarse_grain(["temperature"], preset="lammps", axes="z", width=0.8)
    assert (f.attrs["kernel"], f.attrs["kernel_dimension"]) == ("shifted gaussian", 1)
    assert f.attrs["cutoff"] == pytest.approx(3 * 0.8)
    assert f.temperature.units == "Pa"
    assert set(f.data_vars) == {"temperature", "sample_count"}
    other = ds.cg.coarse_grain(["density"], preset="lammps", axes="z", kernel=xcg.Lucy(0.8))
    assert (other.attrs["kernel"], other.attrs["kernel_dimension"]) == ("lucy", 1)
    assert ds.cg.explain(preset="lammps", width=0.8).kernel.name == "shifted gaussian"


def test_arguments_that_are_defaults_elsewhere_count():
    ds = xcg.datasets.random_scene(60)
    f = ds.cg.coarse_grain(
        "velocity/grad", preset="lammps", width=0.8, kernel="lucy", gradient="least_squares"
    )
    ours = ds.cg.coarse_grain("velocity_gradient", width=0.8)
    np.testing.assert_array_equal(f.velocity_grad, ours.velocity_gradient)
    assert (f.attrs["kernel"], f.attrs["gradient"]) == ("lucy", "least_squares")


@pytest.mark.parametrize("place", [
    {"at": {a: xr.DataArray([2.0, 3.0], dims="point") for a in "xyz"}},
    {"frame": xcg.Cylindrical((0, 0, 1), (2, 2, 0)), "axes": "r"},
])  # fmt: skip
def test_places_without_differences_lack_gradients_alone(place):
    ds = xcg.datasets.random_scene(60)
    options = {"preset": "lammps", "width": 0.8} | place
    assert set(ds.cg.coarse_grain(**options)) >= {"density", "velocity", "stress"}
    with pytest.raises(ValueError, match="finite_difference"):
        ds.cg.coarse_grain("velocity/grad", **options)
    assert "velocity_grad" in ds.cg.coarse_grain(
        "velocity/grad", gradient="least_squares", **options
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            {"fields": "stress/xy"},
            r"'stress/xy' is a component: .*\.sel\(component='x', direction='y'\)",
        ),
        ({"fields": "velocity_x"}, r"take \.sel\(component='x'\)"),
        (
            {"fields": "fabric/*"},
            "'fabric/\\*' is not followed by the preset 'lammps': it is smeared",
        ),
        ({"fields": ["densty"]}, "preset='lammps': unknown field 'densty'; did you mean 'density'"),
        ({"size": "d32"}, r"none of its fields depends on \['size'\]"),
        ({"errors": True}, r"none of its fields depends on \['errors'\]"),
        ({"width": {1: 0.5}, "by": "species"}, "one kernel for all grains"),
        ({"preset": "lamps"}, "expected one of 'pysammos', 'lammps', None"),
    ],
)
def test_wrong_arguments_raise(arguments, message):
    ds = xcg.datasets.random_scene(20)
    with pytest.raises(ValueError, match=message):
        ds.cg.coarse_grain(**{"preset": "lammps", "width": 0.8} | arguments)


@pytest.mark.parametrize(("arguments", "message"), [
    ({"axes": "xw"}, r"axes names \['w'\]: the axes of this scene are x, y, z"),
    ({"axes": "x", "origin": {"w": 0.0}}, r"origin names \['w'\]"),
    ({"axes": "x", "delta": {"x": 1.0, "w": 1.0}}, r"delta names \['w'\]"),
    ({"axes": "xz", "delta": {"x": 1.0}}, r"delta\['z'\]=None: expected a positive length \(m\)"),
    ({"delta": 0.0}, "expected a positive length"),
])  # fmt: skip
def test_wrong_meshes_raise(arguments, message):
    with pytest.raises(ValueError, match=message):
        xcg.lammps_mesh(
            xcg.datasets.random_scene(20), **{"delta": 1.0, "cutoff": 1.0, "width": 0.3} | arguments
        )


@pytest.mark.parametrize(
    "select", [lambda ds: ds.isel(time=0), lambda ds: ds.set_coords(["box", "diameter"])]
)
def test_meshes_of_presets_take_any_selection_of_a_scene(select):
    ds = xcg.datasets.simple_cubic(10)
    options = {"delta": 1.0, "cutoff": CUTOFF, "width": WIDTH}
    of_bins = xcg.lammps_mesh(ds, "z", **options)
    selected = xcg.lammps_mesh(select(ds), "z", **options)
    assert of_bins.pop("kernel").cutoff == selected.pop("kernel").cutoff
    assert of_bins == selected
    assert xcg.pysammos_mesh(select(ds), "xz") == xcg.pysammos_mesh(ds, "xz")
