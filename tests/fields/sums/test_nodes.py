"""Places and reaches beyond what loops over nodes can count: right, or refused before they start."""

import numpy as np
import pytest
import xarray as xr
from scipy.integrate import quad

import xcg
from xcg.compiled.matrices import principal

# particles and partners far outside of their boxes
pytestmark = [
    pytest.mark.filterwarnings("ignore:.* of the grains looked at are outside the box"),
    pytest.mark.filterwarnings("ignore:.*lie more than 3 diameters from the centre"),
]

FORCE = np.array([0.3, -0.2, 1.0])
BOX = [[0, 1], [0, 1], [0, 1]]


def touching_pairs(position, contacts=((0, 1), (2, 1)), point=None, **options):
    position = np.asarray(position, float)
    i, j = np.array(contacts).T
    if point is None:
        point = 0.5 * (position[i] + position[j])
    return xcg.scene_from_arrays(
        position, diameter=np.full(len(position), 0.02), density=1.0, contact_i=i, contact_j=j,
        contact_force=np.tile(FORCE, (len(i), 1)), contact_point=point, **{"box": BOX, **options},
    )  # fmt: skip


def warned_of_far():
    """A partner that is far away is warned of, and its contact is taken as it is."""
    return pytest.warns(xcg.SceneWarning, match="more than 3 diameters from the centre")


def stress_along_z(z, contacts, cutoff):
    """Contact stress of branches along z by quadrature: sigma_iz = f_i times the integral of Psi from j to i."""
    kernel = xcg.Lucy(cutoff=cutoff)

    def reached(node, low, high):
        low = max(low, node - cutoff)
        high = min(high, node + cutoff)
        return (
            quad(lambda s: kernel.value(node - s, seen=1).item(), low, high, epsabs=1e-13)[0]
            if low < high
            else 0.0
        )

    return lambda node: (
        sum(
            np.sign(z[i] - z[j]) * reached(node, min(z[i], z[j]), max(z[i], z[j]))
            for i, j in contacts
        )
        * FORCE
    )


@pytest.mark.parametrize("rtol", [0.0, 1e-3])
@pytest.mark.parametrize("far", [1e3, 1e9, 1e12, -1e12])
@pytest.mark.parametrize("contacts", [((0, 1), (2, 1)), ((1, 0), (1, 2))])
def test_the_stress_of_a_contact_with_a_far_partner_is_exact_near_the_mesh(far, contacts, rtol):
    z = np.array([far, 0.5, 0.52])
    ds = touching_pairs(np.column_stack([0 * z, 0 * z, z]), contacts)
    options = {
        "axes": "z",
        "bounds": {"z": (0.47, 0.53)},
        "spacing": 3e-5,
        "width": 0.3,
        "rtol": rtol,
    }
    with warned_of_far():
        f = ds.cg.coarse_grain("contact_stress", **options)
    expected = stress_along_z(z, contacts, 0.6)
    for k in (0, 700, len(f.z) - 1):
        np.testing.assert_allclose(
            f.contact_stress[0, k, :, 2], expected(float(f.z[k])), rtol=1e-10 + rtol, atol=0
        )


def test_both_halves_of_a_far_branch_are_cut():
    """The contact point is off the line of centres, so that each half is a segment; along z they follow each other."""
    ds = touching_pairs([[0, 0, 1e9], [0, 0, 0.5]], [(0, 1)], point=[[3e8, 0, 0.8]])
    with warned_of_far():
        f = ds.cg.coarse_grain(
            "contact_stress", axes="z", bounds={"z": (0.4, 0.45)}, spacing=0.05, width=0.3
        )
    expected = stress_along_z([1e9, 0.5], [(0, 1)], 0.6)
    for k, node in enumerate(f.z.values):
        np.testing.assert_allclose(f.contact_stress[0, k, :, 2], expected(node), rtol=1e-9)


def test_the_far_part_of_a_slanted_branch_does_not_matter():
    """Cut or not, what nodes see of a branch is the same: two kernels' lengths and a million beyond them."""
    near = np.array([0.5, 0.5, 0.5])
    direction = np.array([0.6, -0.48, 0.64])
    options = {"bounds": dict.fromkeys("xyz", (0.0, 1.0)), "spacing": 0.25, "width": 0.2}
    with warned_of_far():
        long, short = (
            touching_pairs([near + length * direction, near], [(0, 1)]).cg.coarse_grain(
                "contact_stress", **options
            )
            for length in (1e6, 4.0)
        )
    np.testing.assert_allclose(long.contact_stress, short.contact_stress, rtol=1e-8, atol=1e-9)
    assert float(abs(short.contact_stress).max()) > 0.1


def test_the_part_of_a_far_branch_along_a_periodic_axis_is_that_near_the_mesh():
    """A branch that moves 0.3 m along x on a way of 1e6 m moves nothing on the 1 m that nodes see."""
    options = {"axes": "xz", "bounds": {"z": (0.4, 0.6)}, "spacing": 0.1, "width": 0.2}
    stresses = []
    for aside in (0.0, 0.3):
        pair = [[0.5, 0.5, 0.5], [0.5 + aside, 0.5, 1e6]]
        with warned_of_far():
            f = touching_pairs(pair, [(0, 1)], periodic="x").cg.coarse_grain(
                "contact_stress", **options
            )
        stresses.append(f.contact_stress.sel(direction="z"))
    straight, slanted = stresses
    assert float(abs(straight).max()) > 1.0
    np.testing.assert_allclose(slanted, straight, rtol=1e-5, atol=1e-5)


def test_a_far_branch_adds_nothing():
    ds = touching_pairs([[0, 0, 1e12], [1e3, 0, 1e12 + 1e9], [0, 0, 0.5]], [(0, 1)])
    options = {"axes": "z", "bounds": {"z": (0.4, 0.6)}, "spacing": 0.1, "width": 0.3}
    with warned_of_far():
        f = ds.cg.coarse_grain(["contact_stress", "density"], **options)
    assert (f.contact_stress == 0).all()
    alone = touching_pairs([[0, 0, 1e12], [1e3, 0, 1e12 + 1e9], [0, 0, 0.5]], [(0, 1)]).isel(
        particle=[2]
    )
    np.testing.assert_array_equal(f.density, alone.cg.coarse_grain("density", **options).density)


@pytest.mark.filterwarnings("ignore:width=")
def test_a_support_of_1e20_m_sees_all_grains():
    """The one node of a fixed axis has no spacing: a support of 2e20 m sees all grains at its middle."""
    ds = touching_pairs([[0, 0, 0.1], [0, 0, 0.5], [0, 0, 0.52]])
    f = ds.cg.coarse_grain("sample_count", axes="", at={"z": 0.0}, width=1e20)
    assert f.sample_count.item() == 3


@pytest.mark.filterwarnings("ignore:the grains have .* times the volume of the box")
def test_too_many_periodic_images_raise():
    ds = touching_pairs(
        [[0, 0, 0], [0.001, 0, 0], [0, 0.001, 0]], box=[[0, 0.006]] * 3, periodic="xyz"
    )
    with pytest.raises(
        xcg.SceneError, match=r"the box is so small .* in 2.98e\+08 periodic images"
    ):
        ds.cg.coarse_grain("density", width=1.0, spacing=0.006)
    few = ds.cg.coarse_grain("number_density", width=0.005, spacing=0.006)  # five in each axis
    np.testing.assert_allclose(few.number_density, 3 / 0.006**3, rtol=0.01)


@pytest.mark.filterwarnings("ignore:.*off the surfaces of both")
@pytest.mark.parametrize(
    ("position", "options", "message"),
    [
        ([[0, 0, 0.5], [0, 0, 1e30]], {}, "too far for double precision"),
        ([[0, 0, 0.5], [0, 0, 0.52]], {"point": [[0, 0, 1e30]]}, "too far for double precision"),
        ([[0, 0, 0.5], [0, 0, 0.52]], {"box": [[0, 1], [0, 1], [0, 1e9]], "periodic": "z", "point": [[0, 0, 4e8]]},
         "particles are not in touch"),
    ],
)  # fmt: skip
def test_places_too_far_away_raise(position, options, message):
    ds = touching_pairs(position, [(0, 1)], **options)
    with pytest.raises(xcg.SceneError, match=message), warned_of_far():
        ds.cg.coarse_grain(
            "contact_stress", axes="z", bounds={"z": (0.4, 0.6)}, spacing=0.1, width=0.3
        )


def test_a_spacing_far_beyond_the_support_raises():
    ds = touching_pairs([[0, 0, 0.5], [0, 0, 0.52]], [(0, 1)])
    with (
        pytest.raises(xcg.SceneError, match="closer to each other"),
        pytest.warns(xcg.SceneWarning, match="not seen"),
    ):
        ds.cg.coarse_grain("density", axes="z", bounds={"z": (0.0, 1e20)}, spacing=1e18, width=0.3)


# --- sizes and types ---------------------------------------------------------------------------------------


def test_sizes_whose_powers_overflow_raise():
    with pytest.raises(
        xcg.SceneError, match=r"'diameter' of particle 1 is 1e-110 m, expected 1e-75 to 1e\+75 m"
    ):
        xcg.scene_from_arrays(np.eye(3), diameter=[1.0, 1e-110, 1.0])
    ds = touching_pairs([[0, 0, 0.5], [0, 0, 0.52]], [(0, 1)])
    for width in (1e-310, 1e100):
        with pytest.raises(ValueError, match=r"expected a positive length \(m\) from 1e-75"):
            ds.cg.coarse_grain("density", axes="z", width=width, spacing=0.1)


def test_big_endian_numbers_give_equal_results():
    """As netCDF-3 gives them."""
    ds = xcg.datasets.random_scene(20, seed=1)
    turned = ds.map(lambda v: v.astype(v.dtype.newbyteorder(">")) if v.dtype.kind in "if" else v)
    names = ["stress", "fabric"]
    options = {"axes": "z", "by": "species"}
    xr.testing.assert_equal(
        turned.cg.coarse_grain(names, **options), ds.cg.coarse_grain(names, **options)
    )
    xr.testing.assert_equal(turned.cg.force_chains(), ds.cg.force_chains())


def test_wrong_numbers_of_times_and_steps_raise():
    for name in ("time", "step"):
        with pytest.raises(
            xcg.SceneError,
            match=f"{name}= has shape .2,.: expected one value for each of the 1 steps",
        ):
            xcg.scene_from_arrays(np.eye(3), **{name: [0, 1]})


def test_principal_axes_of_nan_are_nan():
    values = np.empty((4, 3))
    vectors = np.empty((4, 3, 3))
    tensor = np.tile(np.diag([1.0, 3.0, 2.0]), (4, 1, 1))
    tensor[[1, 2, 3], [0, 1, 2], [0, 1, 2]] = np.nan
    principal(tensor, values, vectors)
    assert values[0].tolist() == [3.0, 2.0, 1.0]
    assert (np.isnan(values[1:]).sum(axis=1) >= 1).all()


@pytest.mark.filterwarnings("ignore:width=")
@pytest.mark.parametrize("gradient", ["least_squares", "kernel", "finite_difference"])
def test_thousands_of_images_raise_where_they_are_paired(gradient):
    """Squares of weights take products of all pairs of images of a grain, also without those of offsets."""
    ds = xcg.scene_from_arrays(
        np.full((2, 3), 0.5), velocity=np.zeros((2, 3)), diameter=[0.1, 0.1], density=1.0, box=[[0, 1]] * 3,
        periodic="x",
    )  # fmt: skip
    with pytest.raises(
        xcg.SceneError, match="the box is so small that a particle or contact reaches the mesh in"
    ):
        ds.cg.coarse_grain(
            "granular_temperature", axes="x", spacing=0.2, width=500.0, gradient=gradient
        )
