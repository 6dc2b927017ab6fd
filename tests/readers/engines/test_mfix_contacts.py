"""Contact points and rows of MFiX: spheres of unlike sizes, superquadrics that stand once for each side."""

import re
import warnings

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner

import xcg
from tests import ROOT
from tests.readers.engines.test_mfix import read_contacts, write_contacts, write_vtp
from xcg.analysis.pairs import find_pairs
from xcg.cli import group
from xcg.common.messages import SceneError, SceneWarning
from xcg.readers.engine import ReadOptions
from xcg.readers.engines.mfix import Mfix
from xcg.readers.files import vtkheader, vtp
from xcg.scene.lattice import minimum_image

mfix = Mfix()

EXAMPLE = (ROOT / "examples" / "config.ini").read_text()


def open_folder(folder, **options):
    return xcg.open_scene(folder / "P_*.vtp", contacts=folder / "FC_*.vtp", **options).compute()


# --- spheres ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def unlike_spheres(tmp_path_factory):
    """Spheres of 1 and 4 mm, periodic along x, as MFiX writes them, and the same scene with exact contact points."""
    rng = np.random.default_rng(2)
    length = 0.02
    radius = np.where(np.arange(2000) < 60, 0.002, 0.0005)
    x = rng.uniform(0, length, (2000, 3)).astype("f4").astype(float)
    i, j = find_pairs(x, radius, {"x": (0.0, length)}, "x").T
    swap = rng.random(len(i)) < 0.5
    i, j = np.where(swap, j, i), np.where(swap, i, j)
    branch = minimum_image(x[i] - x[j], np.array([length, np.inf, np.inf]))
    distance = np.linalg.norm(branch, axis=1)
    overlap = radius[i] + radius[j] - distance
    shallow = overlap < 0.3 * np.minimum(radius[i], radius[j])
    i, j, branch, distance, overlap = (a[shallow] for a in (i, j, branch, distance, overlap))
    n = branch / distance[:, None]
    normal = 1e3 * overlap[:, None] * n
    sliding = 100 * overlap[:, None] * rng.normal(size=branch.shape)
    point = x[i] - (radius[i] - overlap / 2)[:, None] * n
    crossing = np.abs(x[i] - x[j])[:, 0] > length / 2
    assert (radius[i] > radius[j]).sum() > 10 < (radius[i] < radius[j]).sum()
    assert crossing.sum() > 3

    folder = tmp_path_factory.mktemp("mfix")
    size = {
        "Diameter": 2 * radius,
        "Density": np.full(2000, 2500.0),
        "Velocity": np.zeros((2000, 3)),
    }
    phase = np.where(radius > 0.001, 1, 2)
    write_vtp(
        folder / "P_0001.vtp", x, Particle_ID=np.arange(1, 2001), Particle_Phase_ID=phase, **size
    )
    rows = np.concatenate([np.arange(len(i)), np.flatnonzero(crossing)])
    again = np.arange(len(rows)) >= len(
        i
    )  # pairs across the edge stand once more, seen from the other particle
    first = np.where(again, j[rows], i[rows])
    second = np.where(again, i[rows], j[rows])
    sign = np.where(again, -1.0, 1.0)[:, None]
    towards = -sign * n[rows]
    write_contacts(
        folder / "FC_0001.vtp", first + 1, second + 1, sign * (normal + sliding)[rows],
        x[first] + 0.5 * distance[rows, None] * towards, FORCE_CHAIN_FN=sign * normal[rows],
        FORCE_CHAIN_LENGTH=distance[rows], FORCE_CHAIN_OVERLAP=overlap[rows],
        FORCE_CHAIN_CONTACT_POINT=x[first] + (radius[first] + 0.5 * overlap[rows])[:, None] * towards,
    )  # fmt: skip
    exact = xcg.scene_from_arrays(
        x, particle_id=np.arange(1, 2001), diameter=2 * radius, density=2500.0, species=phase,
        velocity=np.zeros((2000, 3)), contact_i=i + 1, contact_j=j + 1, contact_force=normal + sliding,
        contact_point=point, box={"x": (0.0, length)}, periodic="x",
    )  # fmt: skip
    return folder, exact


def by_pair(ds):
    """Contacts of the first step in the order of their ids."""
    contacts = ds[[n for n in ds.data_vars if "contact" in ds[n].dims]].isel(time=0)
    contacts = contacts.isel(contact=contacts.contact_i.values >= 0)
    low, high = np.sort([contacts.contact_i.values, contacts.contact_j.values], axis=0)
    return contacts.isel(contact=np.lexsort((high, low)))


def test_contact_points_of_unlike_spheres_follow_from_their_radii(unlike_spheres):
    folder, exact = unlike_spheres
    ds = open_folder(folder, periodic="x", box={"x": (0.0, 0.02)})
    one = by_pair(ds)
    two = by_pair(exact)
    pairs = [np.sort([s.contact_i.values, s.contact_j.values], axis=0) for s in (one, two)]
    np.testing.assert_array_equal(*pairs)
    off = minimum_image(
        one.contact_point.values - two.contact_point.values, np.array([0.02, np.inf, np.inf])
    )
    assert np.abs(off).max() < 2e-9  # single precision; the middle of the centres is 1.5e-3 away


def test_partial_pressure_particle_stress_and_chains_of_unlike_spheres(unlike_spheres):
    """What contact points enter into is that of exact ones; the middle of the centres gives something else."""
    folder, exact = unlike_spheres
    with pytest.warns(SceneWarning, match=r"recovered .*x: 0\.02"):
        ds = open_folder(folder, periodic="x")
    # by hand: the virial of both sides of each contact, by species
    virial = np.zeros((3, 3, 3))
    row = exact.species.values[0]
    names = ("contact_i", "contact_j", "contact_force", "contact_point")
    for i, j, f, c in zip(*(exact[name].values[0] for name in names), strict=True):
        for k, force in ((i - 1, f), (j - 1, -f)):
            arm = exact.position.values[0, k] - c
            arm[0] -= 0.02 * np.rint(arm[0] / 0.02)
            virial[row[k]] += np.outer(force, arm)
    virial = 0.5 * (virial + virial.transpose(0, 2, 1))
    stress = ds.cg.particle_stress().stress * ds.volume
    for species in (1, 2):
        total = stress.where(ds.species == species).sum("particle").values[0]
        np.testing.assert_allclose(
            total, virial[species], rtol=0, atol=1e-5 * np.abs(virial[species]).max()
        )
    mesh = {
        "axes": "x",
        "bounds": {"x": (0.0, 0.02)},
        "extent": {"y": 0.02, "z": 0.02},
        "spacing": 0.002,
        "width": 0.002,
    }
    one, two = (
        s.cg.coarse_grain("contact_stress", by="species", **mesh).contact_stress
        for s in (ds, exact)
    )
    for phase in two.phase.values:
        size = float(np.abs(two.sel(phase=phase)).max())
        np.testing.assert_allclose(
            one.sel(phase=phase), two.sel(phase=phase), rtol=0, atol=1e-5 * size
        )
    chains = [s.cg.force_chains()[["chain_id", "links"]] for s in (ds, exact)]
    xr.testing.assert_equal(*(c.drop_vars(set(c.coords)) for c in chains))
    assert int(chains[0].chain_id.max()) > 5


def test_a_sphere_whose_partner_is_not_in_the_file(tmp_path):
    """The middle of both centres and the overlap tell its size."""
    write_vtp(tmp_path / "P_1.vtp", [[0, 0, 0], [9, 9, 9]], Particle_ID=[4, 5], Diameter=[2.0, 2.0])
    # spheres of radius 1 and 4 that overlap by 0.5: centres 4.5 apart, the contact 0.75 from the small one
    middle = [[0, 0, 2.25]] * 2
    overlap = [0.5, 0.5]
    write_contacts(
        tmp_path / "FC_1.vtp",
        [4, 8],
        [7, 4],
        [[0, 0, -1], [0, 0, 1]],
        middle,
        FORCE_CHAIN_OVERLAP=overlap,
    )
    ds = open_folder(tmp_path, allow_unknown=True)
    np.testing.assert_allclose(ds.contact_point.values[0], [[0, 0, 0.75]] * 2, rtol=1e-6)
    write_contacts(tmp_path / "FC_1.vtp", [4, 8], [7, 4], [[0, 0, -1], [0, 0, 1]], middle)
    with pytest.raises(SceneError, match="none follows without both spheres"):
        open_folder(tmp_path, allow_unknown=True)


def test_messages_count_rows_of_the_file(tmp_path):
    """Rows of superquadrics come first in the file, and the contact of spheres after them is the one at fault."""
    write_vtp(
        tmp_path / "P_1.vtp",
        [[0, 0, 0], [2, 0, 0], [9, 9, 9]],
        Particle_ID=[4, 5, 6],
        Diameter=[2.0] * 3,
    )
    middle = [[0.5, 0, 0], [1.5, 0, 0], [0, 0, 2.25]]
    point = [[1, 0, 0], [1, 0, 0], [0, 0, 0.5]]
    write_contacts(
        tmp_path / "FC_1.vtp", [4, 4, 4], [5, 5, 7], np.eye(3)[[0, 0, 2]], middle, FORCE_CHAIN_CONTACT_POINT=point,
        FORCE_CHAIN_LENGTH=[1.0, 1.0, 4.5],
    )  # fmt: skip
    with pytest.raises(SceneError, match="contact row 2 has contact_j=7"):
        open_folder(tmp_path)
    with pytest.raises(SceneError, match=r"contact row 2 \(i=4, j=7\) has no contact point"):
        open_folder(tmp_path, allow_unknown=True)


def test_mapped_contact_points_are_kept(unlike_spheres):
    folder, _ = unlike_spheres
    for array in ("FORCE_CHAIN_CONTACT_POINT", "coordinates"):
        (ref,) = mfix.index_contacts([str(folder / "FC_0001.vtp")], ReadOptions())
        frame = mfix.read_contacts(ref, ReadOptions(names={array: "contact_point"}))
        points = vtkheader.read_arrays(vtp.read_header(ref.path), [array])[array]
        assert "point_is_middle" not in frame
        assert set(map(tuple, frame["contact_point"])) <= set(map(tuple, points))


# --- superquadrics ---------------------------------------------------------------------------------------


def write_superquadrics(folder, step=1, seed=0, shape="SQP_01"):
    """Bodies in a layer, periodic along x with 1 m, each contact from both sides, and some contacts of spheres.

    Returns the centres and the contacts, one row each: particles, force on the first, point.
    """
    rng = np.random.default_rng(seed)
    side = np.stack(np.meshgrid(np.arange(10), np.arange(5)), axis=-1).reshape(-1, 2)
    x = np.column_stack([0.1 * side + rng.uniform(0, 0.02, (50, 2)), np.zeros(50)])
    i, j = find_pairs(x, np.full(50, 0.055), {"x": (0.0, 1.0)}, "x").T
    period = np.array([1.0, np.inf, np.inf])
    branch = minimum_image(x[i] - x[j], period)
    distance = np.linalg.norm(branch, axis=1)
    sphere = (i % 5 == 0) & (j % 5 == 0)
    crossing = (np.abs(x[i] - x[j])[:, 0] > 0.5) & ~sphere
    assert sphere.sum() > 2 < crossing.sum()
    aside = rng.uniform(-0.01, 0.01, (len(i), 3)) * [1, 1, 0]
    point = x[i] - 0.5 * branch + np.where(sphere[:, None], 0.0, aside)
    force = branch / distance[:, None] + 0.1 * aside
    write_vtp(
        folder / f"P_{step:04d}.vtp", x, time=step, shape=shape, Particle_ID=np.arange(1, 51),
        Diameter=np.full(50, 0.1), Density=np.full(50, 2000.0), Velocity=np.zeros((50, 3)),
        Volume=np.full(50, 1e-4), Mass=np.full(50, 0.2),
    )  # fmt: skip
    rows = []
    for k in rng.permutation(len(i)):
        n = -branch[k] / distance[k]
        length = distance[k]
        if sphere[
            k
        ]:  # stands once: the middle of the centres, and a point that is off by one overlap
            rows.append(
                (
                    i[k],
                    j[k],
                    force[k],
                    x[i[k]] + 0.5 * length * n,
                    length,
                    x[i[k]] + (0.1 - 0.5 * length) * n,
                )
            )
            continue
        for own, other, sign in ((i[k], j[k], 1.0), (j[k], i[k], -1.0)):
            # across the edge each row is what was applied to its own first particle, else all but the side is the same
            first, second, said = (own, other, sign) if crossing[k] else (i[k], j[k], 1.0)
            arm = minimum_image(point[k : k + 1] - x[own], period)[0]
            touch = x[own] + arm if crossing[k] else point[k]
            f = said * force[k] * (1 + 0.005 * sign * crossing[k])
            rows.append((first, second, f, touch - 0.5 * arm, np.linalg.norm(arm), touch))
    first, second, f, middle, length, touch = map(np.array, zip(*rows, strict=True))
    write_contacts(
        folder / f"FC_{step:04d}.vtp", first + 1, second + 1, f, middle, time=step, shape=shape, FORCE_CHAIN_FN=f,
        FORCE_CHAIN_LENGTH=length, FORCE_CHAIN_CONTACT_POINT=touch, FORCE_CHAIN_OVERLAP=np.full(len(f), 0.01),
    )  # fmt: skip
    return x, i, j, force, point


def one_row_a_contact(x, i, j, force, point):
    same = {"diameter": 0.1, "density": 2000.0, "volume": 1e-4, "mass": 0.2}
    return xcg.scene_from_arrays(
        x, velocity=np.zeros((50, 3)), contact_i=i, contact_j=j, contact_force=force, contact_point=point,
        box={"x": (0.0, 1.0)}, periodic="x", dimension=2, **{name: np.full(50, value) for name, value in same.items()},
    )  # fmt: skip


def test_superquadrics_count_once(tmp_path):
    x, i, j, force, point = write_superquadrics(tmp_path)
    with pytest.warns(SceneWarning, match=r"recovered from contacts .*x: 1"):
        ds = open_folder(tmp_path, periodic="x")
    found = by_pair(ds)
    pairs = np.sort([found.contact_i.values, found.contact_j.values], axis=0)
    np.testing.assert_array_equal(pairs, np.array([i, j]) + 1)
    sign = np.where(found.contact_i.values == i + 1, 1.0, -1.0)[:, None]
    np.testing.assert_allclose(sign * found.contact_force, force, rtol=0, atol=1e-6)
    off = minimum_image(found.contact_point.values - point, np.array([1.0, np.inf, np.inf]))
    np.testing.assert_allclose(off, 0, atol=2e-7)
    assert ds.attrs["dimension"] == 2
    # by hand, and from arrays
    exact = one_row_a_contact(x, i, j, force, point)
    arms = [minimum_image(x[k] - point, np.array([1.0, np.inf, np.inf])) for k in (i, j)]
    virial = np.einsum("ni,nj->ij", force, arms[0] - arms[1])
    total = (ds.cg.particle_stress().stress * ds.volume).sum("particle").values[0]
    np.testing.assert_allclose(
        total, 0.5 * (virial + virial.T), rtol=0, atol=1e-6 * np.abs(virial).max()
    )
    mesh = {"bounds": {"x": (0.0, 1.0), "y": (0.0, 0.5)}, "spacing": 0.1, "width": 0.1}
    one, two = (
        s.cg.coarse_grain(["contact_stress", "fabric", "coordination_number"], **mesh)
        for s in (ds, exact)
    )
    for name in two.data_vars:
        size = float(np.abs(two[name]).max())
        np.testing.assert_allclose(one[name], two[name], rtol=0, atol=1e-5 * size, err_msg=name)


@pytest.mark.parametrize(("length", "matches"), [(1.0, True), (0.97, False), (1e3, False)])
def test_a_box_that_contradicts_contacts_across_its_edge_warns(tmp_path, length, matches):
    write_superquadrics(tmp_path)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        open_folder(tmp_path, periodic="x", box={"x": (-0.1, length - 0.1)})
    expected = (
        f"the period along 'x' is {length:g}, and contacts on both sides of an edge in .* are 1"
    )
    found = [one for one in said if re.search(expected, str(one.message))]
    assert len(found) == (0 if matches else 1)


def test_superquadrics_that_touch_on_both_sides_of_a_small_box_keep_both_contacts(tmp_path):
    """Two bodies in a box of two diameters: one pair of ids, two contacts, four rows."""
    force = np.array([[1.0, 0, 0], [-2, 0, 0]])
    touch = np.array([[0.5, 0, 0], [1.0, 0, 0]])
    centres = np.array([[0.25, 0, 0], [0.75, 0, 0]])
    rows = [(1, 2, -force[0], touch[0], centres[0]), (1, 2, -force[0], touch[0], centres[1]),
            (1, 2, -force[1], touch[1] - [1, 0, 0], centres[0]), (2, 1, force[1], touch[1], centres[1]),
            (3, 2, force[0], touch[0] + [0, 3, 0], centres[0] + [0, 3, 0]),
            (2, 3, -force[0], touch[0] + [1, 3, 0], centres[0] + [1, 3, 0])]  # fmt: skip
    i, j, f, point, centre = map(np.array, zip(*rows, strict=True))
    length = np.linalg.norm(point - centre, axis=1)
    path = write_contacts(
        tmp_path / "FC_1.vtp",
        i,
        j,
        f,
        (centre + point) / 2,
        FORCE_CHAIN_LENGTH=length,
        FORCE_CHAIN_CONTACT_POINT=point,
    )
    frame = read_contacts(path)
    np.testing.assert_array_equal(frame["contact_i"], [1, 1, 3])
    np.testing.assert_array_equal(frame["contact_force"], [-force[0], -force[1], force[0]])
    assert not frame["point_is_middle"].any()


def test_superquadrics_without_contact_points_raise(tmp_path):
    path = write_contacts(tmp_path / "FC_1.vtp", [1], [2], [[1, 0, 0]], shape="SQP_01")
    with pytest.raises(
        SceneError, match=r"FC_1\.vtp: contacts of superquadrics need FORCE_CHAIN_CONTACT_POINT"
    ):
        read_contacts(path)


# --- files to files, from a configuration alone -----------------------------------------------------------


def configuration(folder, last, **more):
    """Pysammos's config.ini as its authors write it for a bed that flows along x; axes across are cut at 0."""
    values = {
        "particles_path": "./P_", "contacts_path": "./FC_", "t0": 1, "tf": last, "dt": 1, "z_transect": 0.0,
        "x_min": 0.0, "y_min": 0.0, "z_axis_periodic": False, "contact_tensor": True,
        "Contact_ij": "FORCE_CHAIN_CONTACT_POINT",
        "Particle_i_ID": "FORCE_CHAIN_GLOBAL_ID1", "Particle_j_ID": "FORCE_CHAIN_GLOBAL_ID2", **more,
    }  # fmt: skip
    lines = EXAMPLE.splitlines()
    for key, value in values.items():
        (at,) = (n for n, line in enumerate(lines) if line.split(" = ")[0] == key)
        lines[at] = f"{key} = {value}"
    (folder / "config.ini").write_text("\n".join(lines))
    return folder / "config.ini"


def run(config):
    done = CliRunner().invoke(group, ["run", str(config)])
    assert done.exit_code == 0, done.output + repr(done.exception)
    return done.output


@pytest.mark.parametrize("across", [False, True], ids=["", "periodic across the layer"])
def test_a_bed_of_superquadrics_from_its_configuration_alone(tmp_path, across):
    for step in (1, 2):
        x, i, j, force, point = write_superquadrics(tmp_path, step, seed=step)
    said = run(configuration(tmp_path, 2, x_max=1.0, y_max=0.5, z_axis_periodic=across))
    assert "x: 1, in the files' unit" in said
    with xr.open_dataset(tmp_path / "PysammosCG" / "CG_Lucy_Monodisperse.h5") as f:
        got = f.contact_tensor.isel(time=1).load()
        width = f.attrs["width"]
    exact = one_row_a_contact(x, i, j, force, point)
    places = {a: got[a].values for a in "xy"}
    bounds = {a: (v[0], v[-1]) for a, v in places.items()}
    spacing = {a: v[1] - v[0] for a, v in places.items()}
    own = exact.cg.coarse_grain(
        ["contact_stress"], width=width, bounds=bounds, spacing=spacing
    ).contact_stress[0]
    np.testing.assert_allclose(
        got.transpose(*own.dims), own, rtol=0, atol=1e-5 * float(np.abs(own).max())
    )
