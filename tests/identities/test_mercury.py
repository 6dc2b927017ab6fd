"""Against MercuryCG, an independent code: sums of the synthetic scene with Lucy's kernel, printed with 17 digits."""

import json

import numpy as np
import pytest

import xcg
from tests import real_data
from tests.identities.scenes import load

COORDINATES = ("O", "X", "Y", "Z", "XY", "XZ", "YZ", "XYZ")
# The columns agree to 17 printed digits where both codes add the same numbers; an independent recomputation got 6e-13.
# 1e-9 is what is promised; the rounding of differences of coordinates and of the logarithm in the closed form is below.
TOLERANCE = 1e-9


@pytest.fixture(scope="module")
def reference():
    with open(real_data("mercury_synthetic") / "reference_lucy.json") as file:
        return json.load(file)


def case_of(reference, coordinates):
    (case,) = [c for c in reference["cases"] if f"-coordinates {coordinates} " in c["command"]]
    names = reference["columns"]
    values = np.array([node["values"] for node in case["nodes"]])
    columns = {name: values[:, k] for k, name in enumerate(names)}
    points = np.array([node["coords"] for node in case["nodes"]]).reshape(len(values), -1)
    kinetic = np.array([node["kinetic_stress"] for node in case["nodes"]])
    return (
        columns,
        points,
        kinetic,
        float(case["header"].split("width")[1].split()[0]),
        case["n_rows_per_time"],
    )


def evaluate(axes, points, cutoff):
    """Fields at nodes; MercuryCG sees d axes with the d-dimensional Lucy polynomial, not with a marginal."""
    ds = load("mercury_synthetic").ds
    kernel = xcg.Lucy(cutoff=cutoff, dimension=max(len(axes), 1))
    rows = []
    for point in points:
        nodes = {
            "kernel": kernel,
            "axes": "",
            "at": dict(zip(axes, map(float, point), strict=True)),
        }
        flux = xcg.coarse_grain(ds, "momentum_flux", **nodes)
        rows.append(xcg.coarse_grain(ds, **nodes).assign(flux).isel(time=0))
    return {str(name): np.array([row[name].values for row in rows]) for name in rows[0].data_vars}


def assert_close(found, expected, name):
    scale = np.abs(expected).max()
    np.testing.assert_allclose(found, expected, rtol=0, atol=TOLERANCE * scale, err_msg=name)


@pytest.mark.filterwarnings("ignore:.*NaN, as no axis is resolved")  # of O, the mean of all
@pytest.mark.parametrize("coordinates", COORDINATES)
def test_fields_equal_the_columns_of_mercury(reference, coordinates):
    columns, points, kinetic, cutoff, _ = case_of(reference, coordinates)
    f = evaluate("" if coordinates == "O" else coordinates.lower(), points, cutoff)
    assert_close(f["volume_fraction"], columns["VolumeFraction"], "VolumeFraction")
    assert_close(f["density"], columns["Density"], "Density")
    assert_close(
        f["particle_density"],
        np.full(len(points), reference["particle_density"]),
        "particle density",
    )
    for k, a in enumerate("XYZ"):
        assert_close(f["momentum_density"][:, k], columns[f"Momentum{a}"], f"Momentum{a}")
        assert_close(
            f["boundary_force_density"][:, k],
            columns[f"InteractionForce{a}"],
            f"InteractionForce{a}",
        )
        for j, b in enumerate("XYZ"):
            assert_close(
                f["contact_stress"][:, k, j],
                columns[f"ContactStress{a}{b}"],
                f"ContactStress{a}{b}",
            )
            if k <= j:
                assert_close(
                    f["momentum_flux"][:, k, j],
                    columns[f"MomentumFlux{a}{b}"],
                    f"MomentumFlux{a}{b}",
                )
    assert_close(f["kinetic_stress"][:, *np.triu_indices(3)], kinetic, "kinetic stress")
    # sums of powers of the radius
    assert_close(f["number_density"], columns["ParticleSize0"], "ParticleSize0")
    assert_close(f["d32"], 2 * columns["ParticleSize3"] / columns["ParticleSize2"], "d32")
    assert_close(f["d43"], 2 * columns["ParticleSize4"] / columns["ParticleSize3"], "d43")


@pytest.mark.parametrize("coordinates", COORDINATES[1:])
def test_cell_centres_are_nodes(reference, coordinates):
    """The mesh of MercuryCG, as bounds and spacing, and its order of rows."""
    columns, points, _, cutoff, rows = case_of(reference, coordinates)
    axes = coordinates.lower()
    edge = 5.44
    n = 7
    h = edge / n
    ds = load("mercury_synthetic").ds
    f = xcg.coarse_grain(
        ds, ["density", "contact_stress"], kernel=xcg.Lucy(cutoff=cutoff, dimension=len(axes)), axes=axes,
        bounds=dict.fromkeys(axes, (h / 2, edge - h / 2)), spacing=h,
    )  # fmt: skip
    assert f.density.size == rows
    picked = np.ravel_multi_index(np.rint(points / h - 0.5).astype(int).T, (n,) * len(axes))
    assert_close(f.density.values.ravel()[picked], columns["Density"], "Density")
    stress = f.contact_stress.values.reshape(rows, 3, 3)[picked]
    assert_close(stress[:, 0, 2], columns["ContactStressXZ"], "ContactStressXZ")


def test_the_marginal_is_another_kernel(reference):
    """Averaged exactly, with the 3D kernel's marginal, the profile is not MercuryCG's."""
    columns, points, _, cutoff, _ = case_of(reference, "Z")
    ds = load("mercury_synthetic").ds
    found = [
        float(
            xcg.coarse_grain(
                ds, "density", kernel=xcg.Lucy(cutoff=cutoff), axes="", at={"z": float(z)}
            ).density[0]
        )
        for (z,) in points
    ]
    assert np.abs(found - columns["Density"]).max() > 0.01 * columns["Density"].max()
