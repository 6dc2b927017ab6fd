"""Data that can be computed but are hardly what was meant are pointed at, once a call."""

import warnings

import numpy as np
import pytest
import xarray as xr

import xcg
from tests import dumps
from xcg.scene.lattice import Lattice, minimum_image
from xcg.scene.sanity_contacts import check_ends

CONTACT_FIELDS = ["contact_stress"]


@pytest.fixture
def ds():
    return xcg.datasets.simple_cubic(4)


def several(ds, steps=3):
    """The scene, several times over."""
    return xr.concat(
        [ds.assign_coords(time=[float(t)]) for t in range(steps)], "time", data_vars="all"
    )


def only(said):
    assert len(said) == 1
    assert said[0].filename == __file__
    return str(said[0].message)


@pytest.mark.parametrize(
    "call",
    [
        lambda ds: ds.cg.coarse_grain(axes="xz", width=0.1),
        lambda ds: ds.cg.coarse_grain(["volume_fraction", "granular_temperature"], width=0.3),
        lambda ds: ds.cg.balance(axes="z", width=0.1),
        lambda ds: ds.cg.width_sweep([0.05, 0.08, 0.1], "volume_fraction", axes="z"),
        lambda ds: ds.cg.flow_rate(
            xcg.Plane((0, 0, 1), (0, 0, 1)), ["mass", "momentum"], width=0.1
        ),
        lambda ds: ds.chunk(time=1).cg.coarse_grain(axes="xz", width=0.1).compute(),
    ],
)
def test_a_narrow_kernel_warns_once(call):
    ds = several(xcg.datasets.random_scene(60, seed=1), 2)
    with pytest.warns(xcg.SceneWarning) as said:
        call(ds)
    # grains of several masses have a warning of their own
    of_width = [warning for warning in said if "whose masses differ" not in str(warning.message)]
    assert "width=" in only(of_width)


# --- sizes and places ------------------------------------------------------------------------------------


@pytest.mark.parametrize("dimension", [2, 3])
def test_radii_in_millimetres_at_positions_in_metres_warn(dimension):
    rng = np.random.default_rng(0)
    position = rng.uniform(0, 0.02, (400, 3)) * (1, 1, dimension == 3)
    given = {"dimension": dimension, "density": 2500.0}
    with pytest.warns(xcg.SceneWarning) as said:
        xcg.scene_from_arrays(position, diameter=rng.uniform(1, 2, 400), **given)
    text = only(said)
    assert "400 grains with a mean diameter of 1." in text
    assert "are the units of radius and position the same?" in text
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        xcg.scene_from_arrays(position, diameter=rng.uniform(1e-3, 2e-3, 400), **given)


# --- mesh and grains -------------------------------------------------------------------------------------


def test_grains_without_mass_are_named_as_the_cause_of_nan():
    position, velocity = np.random.default_rng(0).uniform(0, 5, (2, 60, 3))
    box = {"box": [[0, 5]] * 3, "periodic": "xyz"}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        ds = xcg.scene_from_arrays(
            position, velocity=velocity, diameter=0.5, mass=np.zeros(60), **box
        )
        ds.cg.coarse_grain(["granular_temperature", "velocity"], axes="z")
    (text,) = [str(warning.message) for warning in caught]
    assert "all 60 grains have the mass 0" in text


@pytest.mark.parametrize("lazy", [False, True])
def test_a_mesh_that_no_grain_reaches_warns(lazy):
    position = np.random.default_rng(0).uniform(0, 1, (4, 30, 3))
    ds = xcg.scene_from_arrays(position, diameter=np.full((4, 30), 0.1), density=1.0)
    ds = ds.chunk(time=1) if lazy else ds
    with pytest.warns(xcg.SceneWarning) as said:
        f = ds.cg.coarse_grain(
            "density", bounds=dict.fromkeys("xyz", (1000.0, 1001.0)), width=0.1
        ).compute()
    text = only(said)
    assert "no grain reaches any node" in text
    assert "x from 1000 to 1001" in text
    assert f"z from {position[0, :, 2].min():.6g}" in text or lazy
    assert not f.density.any()
    with pytest.warns(xcg.SceneWarning) as said:
        ds.cg.coarse_grain("density", axes="xz", at={"y": 3.0}, width=0.1).compute()
    assert "y from 3 to 3" in only(said)


@pytest.mark.parametrize("field", ["number_density", "contact_stress"])
def test_grains_of_a_middle_step_beyond_the_mesh_warn(field):
    """Neither takes velocities, by which nodes that grains reach are counted."""
    pair = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    shifted = pair + np.array([2.5, 0.0, 0.0])
    one = np.zeros((3, 1), int)
    ds = xcg.scene_from_arrays(
        [pair, shifted, pair],
        diameter=1.0,
        contact_i=one,
        contact_j=one + 1,
        contact_force=np.full((3, 1, 3), [-1.0, 0.0, 0.0]),
    )
    for name in ("particle_lower", "particle_upper"):
        del ds.attrs[name]  # so that the mesh is laid around the first and the last step
    with pytest.warns(xcg.SceneWarning) as said:
        ds.cg.coarse_grain(field, width=0.5)
    text = only(said)
    assert "grains lie at x from 2.5 to 3.5, and some are not or only partly on the mesh" in text
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ds.cg.coarse_grain(field, width=0.5, bounds={"x": (-1, 5), "y": (-1, 1), "z": (-1, 1)})


def test_a_step_without_grains_does_not_warn():
    ds = xcg.scene_from_arrays(
        [np.zeros((0, 3)), np.ones((2, 3))], diameter=[np.zeros(0), np.ones(2)], density=1.0
    )
    ds.cg.coarse_grain("density")


def test_grains_beyond_the_mesh_warn():
    position = np.zeros((3, 2, 3))
    position[1:, 1, 2] = 5.0, 0.1
    ds = xcg.scene_from_arrays(position, diameter=np.ones((3, 2)), density=1.0)
    ds = ds.assign_attrs(ds.isel(time=[0, 2]).cg.measure().attrs)
    with pytest.warns(xcg.SceneWarning) as said:
        ds.cg.coarse_grain("density")
    assert "step 1: grains lie at z from 0 to 5" in only(said)
    ds.cg.measure().cg.coarse_grain("density")  # no warning
    ds.cg.coarse_grain(
        "density", bounds=dict.fromkeys("xyz", (-1.0, 1.0))
    )  # nor where the mesh is the user's


# --- contacts --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lazy", [False, True])
@pytest.mark.parametrize(
    "call",
    [lambda ds: ds.cg.coarse_grain(CONTACT_FIELDS), lambda ds: ds.cg.particle_stress(),
     lambda ds: ds.cg.force_chains(), lambda ds: ds.cg.microstructure(["stress"])],
)  # fmt: skip
def test_attractive_contacts_warn(ds, call, lazy):
    ds = several(ds.assign(contact_force=-ds.contact_force))
    with pytest.warns(xcg.SceneWarning) as said:
        call(ds.chunk(time=1) if lazy else ds).compute()
    assert "contacts looked at pull their particles together" in only(said)


def test_repulsive_contacts_do_not_warn(ds):
    for scene in (
        ds,
        ds.assign(contact_i=ds.contact_j, contact_j=ds.contact_i, contact_force=-ds.contact_force),
    ):
        scene.cg.coarse_grain(CONTACT_FIELDS)


def test_distant_contact_points_warn(ds):
    moved = several(ds.assign(position=ds.position + 1.5).assign_attrs(periodic=""))
    moved = moved.assign(position=moved.position + 4.0)
    with pytest.warns(xcg.SceneWarning) as said:
        moved.cg.coarse_grain(CONTACT_FIELDS)
    assert "diameters from the centre of a particle" in only(said)


def test_contacts_across_an_open_box_warn(ds):
    with pytest.warns(xcg.SceneWarning) as said:
        ds.assign_attrs(periodic="").cg.coarse_grain(CONTACT_FIELDS)
    assert "another step or box" in only(said)


def test_ends_of_contacts_that_are_not_the_positions_warn(ds):
    frame = {
        name: ds[name].values[0] for name in ("particle_id", "position", "contact_i", "contact_j")
    }
    period = np.full(3, 4.0)
    branch = frame["position"][frame["contact_i"]] - frame["position"][frame["contact_j"]]
    check_ends(frame | {"wrapped_branch": branch}, frame, Lattice(period), "step 0")
    check_ends(
        frame | {"wrapped_branch": minimum_image(branch, period)}, frame, Lattice(period), "step 0"
    )
    with pytest.warns(xcg.SceneWarning, match="ends of .* are not the positions"):
        check_ends(frame | {"wrapped_branch": branch[:, ::-1]}, frame, Lattice(period), "step 0")


def test_lattices_do_not_warn():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for scene in (xcg.datasets.simple_cubic(4), xcg.datasets.simple_cubic(3)):
            scene.cg.coarse_grain()
            scene.cg.particle_stress()


# --- the call ---------------------------------------------------------------------------------------------


def test_a_width_far_below_the_diameter_warns(ds):
    with pytest.warns(xcg.SceneWarning) as said:
        ds.cg.coarse_grain("density", width="0.05 d43", axes="z")
    assert "0.05 of the diameter of the grains" in only(said)
    ds.cg.coarse_grain("density", width="0.125 d43", axes="z")  # as in studies of what width does


def test_a_plane_outside_a_periodic_box_warns(ds):
    with pytest.warns(xcg.SceneWarning) as said:
        f = ds.cg.coarse_grain("density", axes="x", at={"y": 13.0, "z": 1.0})
    assert "at={'y': 13} is outside the box, which is periodic from 0 to 4" in only(said)
    inside = ds.cg.coarse_grain("density", axes="x", at={"y": 1.0, "z": 1.0})
    np.testing.assert_allclose(f.density, inside.density, rtol=1e-12)


@pytest.mark.parametrize(
    "name",
    ["diametr", "diameters", "velocty", "velocities", "contact_forces", "periodc", "spieces"],
)
def test_a_misspelt_variable_raises(name):
    with pytest.raises(xcg.SceneError, match=f"'{name}' is neither .*did you mean"):
        xcg.scene_from_arrays(np.zeros((2, 3)), **{name: np.ones(2)})


def test_radius_suggests_twice_as_diameter():
    with pytest.raises(
        xcg.SceneError, match=r"'radius' is neither .*; did you mean diameter = 2 radius\?"
    ):
        xcg.scene_from_arrays(np.zeros((2, 3)), radius=np.ones(2))


def test_times_are_given_for_each_step():
    with pytest.raises(
        xcg.SceneError, match=r"'timestep' is neither .*; did you mean time=, an array"
    ):
        xcg.scene_from_arrays(np.zeros((2, 3)), timestep=0.1)


def test_a_variable_of_particles_has_a_row_for_each():
    with pytest.raises(xcg.SceneError, match=r"'charge' is one number, .* numpy\.full\(n, 0\.5\)"):
        xcg.scene_from_arrays(np.zeros((2, 3)), charge=0.5)


def test_contacts_as_one_table_raise():
    with pytest.raises(
        xcg.SceneError, match=r"'contacts' is neither .*; did you mean contact_i=, contact_j="
    ):
        xcg.scene_from_arrays(np.zeros((2, 3)), contacts={})


def test_wrong_shapes_raise_with_a_remedy():
    with pytest.raises(
        xcg.SceneError, match=r"add a column of zeros for z and give dimension=2\)$"
    ):
        xcg.scene_from_arrays(np.zeros((5, 2)))
    with pytest.raises(
        xcg.SceneError, match=r"'volume' has shape \(\): .*numpy\.full\(\(n,\), 0\.1\)"
    ):
        xcg.scene_from_arrays(np.zeros((5, 3)), volume=0.1)


@pytest.mark.parametrize(
    "name", ["temperature", "diameter_2", "charge", "species2", "moisture", "velocity_x", "age"]
)
def test_own_variables_are_accepted(name):
    assert name in xcg.scene_from_arrays(np.zeros((2, 3)), **{name: np.ones(2)})


# --- files ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("system", "units", "fits"),
    [
        ("si", "SI", True), ("si", {"length": 1.0}, True), ("si", {"length": 1e-3}, False), ("si", "reduced", True),
        ("lj", "reduced", True), ("lj", "SI", False), ("lj", {"length": 1e-3, "mass": 2.0}, True),
        ("cgs", {"length": 1e-2, "mass": 1e-3}, True), ("cgs", "SI", False),
        ("cgs", "reduced", False), ("metal", {"length": 1e-10}, True),
    ],
)  # fmt: skip
def test_units_that_contradict_the_header_warn(tmp_path, system, units, fits):
    path = dumps.write(tmp_path / "p.dump", dumps.dump_text(before=f"ITEM: UNITS\n{system}\n"))
    if fits:
        xcg.open_scene(path, units=units)
    else:
        with pytest.raises(xcg.SceneError, match=rf"p\.dump.* names the unit system '{system}'"):
            xcg.open_scene(path, units=units)


def test_contacts_of_another_box_warn(tmp_path):
    units = "ITEM: UNITS\nsi\n"
    particles = dumps.write(tmp_path / "p.dump", dumps.dump_text(before=units))
    same = dumps.write(
        tmp_path / "c.dump", dumps.pairs_text(before=units, box=dumps.BOX.replace("-1 9", "-1 8"))
    )
    xcg.open_scene(particles, contacts=same)  # along an axis that is not periodic
    other = dumps.write(
        tmp_path / "d.dump",
        dumps.pairs_text(before=units, box=dumps.BOX.replace("0 10", "0 20", 1)),
    )
    with pytest.warns(xcg.SceneWarning) as said:
        xcg.open_scene(particles, contacts=other)
    assert "d.dump (step 0) is [0.0, 20.0] along 'x'" in only(said)


def test_a_lammps_file_without_units_warns(tmp_path):
    path = dumps.write(tmp_path / "p.dump", dumps.dump_text().replace("ITEM: UNITS\nsi\n", ""))
    with pytest.warns(xcg.SceneWarning) as said:
        xcg.open_scene(path)
    assert "p.dump (step 0): the header does not name the units, and SI is taken" in only(said)
    for units in ("SI", "reduced", {"length": 1e-3}):
        xcg.open_scene(path, units=units)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", ["force_{}", "forces.{}", "Total Force {} (N)", "{} force"])
def test_the_force_on_a_grain_is_not_needed(tmp_path, name):
    names = [name.format(axis) for axis in "XYZ"]
    header = ",".join(["id,x,y,z,radius", *names])
    particles = dumps.write(tmp_path / "p.csv", f"{header}\n1,0,0,0,.5,1,2,3\n")
    ds = xcg.open_scene(particles, density=1.0)
    assert ds.attrs["not_read"] == "particles: " + ", ".join(names)


def test_unused_columns_of_walls_or_forces_warn(tmp_path):
    rows = [f"{row} 7" for row in dumps.ROWS]
    particles = dumps.write(tmp_path / "p.dump", dumps.dump_text(rows, f"{dumps.ATOMS} f_wall[1]"))
    with pytest.warns(xcg.SceneWarning) as said:
        xcg.open_scene(particles)
    assert "p.dump (step 0): columns f_wall[1] look like forces or contacts with walls" in only(
        said
    )
    xcg.open_scene(particles, names={"f_wall[1]": None})
    assert "at_wall" in xcg.open_scene(particles, names={"f_wall[1]": "at_wall"})
    contacts = dumps.write(
        tmp_path / "c.dump", dumps.pairs_text(["1 2 -9 0 0 0 1 0 3"], f"{dumps.PAIRS} force_x")
    )
    with pytest.warns(
        xcg.SceneWarning, match=r"c\.dump.* columns force_x look like .*'contact_force_x'"
    ):
        xcg.open_scene(particles, contacts=contacts, names={"f_wall[1]": None})


# --- columns that were mistaken ----------------------------------------------------------------------------

RAW = "c_1[1] c_1[2] " + " ".join(f"c_2[{k}]" for k in range(1, 10))
WHOLE = {"c_1[1]": "contact_i", "c_1[2]": "contact_j"} | {
    f"c_2[{k + 3 * part + 1}]": f"{name}_{a}"
    for part, name in enumerate(("contact_branch", "contact_force"))
    for k, a in enumerate("xyz")
}


def chain(shear, count=30):
    """Dumps of a row of grains that press on each other, with a tangential part of each force."""
    grains = [f"{k + 1} 1 {0.3 * k:.6g} {0.1 * (k % 2):.6g} 0 0 0 0 0.16 1" for k in range(count)]
    rows = []
    for k in range(1, count):
        branch = np.array([0.3, 0.1 * (k % 2) - 0.1 * ((k - 1) % 2), 0.0])
        numbers = [*branch, *(7.0 * branch), -shear * branch[1], shear * branch[0], 0.0]
        rows.append(f"{k + 1} {k} " + " ".join(f"{x:.6g}" for x in numbers))
    return grains, rows


def open_chain(tmp_path, shear, names, columns=RAW):
    grains, rows = chain(shear)
    particles = dumps.write(tmp_path / "p.dump", dumps.dump_text(grains))
    contacts = dumps.write(tmp_path / "c.dump", dumps.pairs_text(rows, columns))
    return xcg.open_scene(particles, contacts=contacts, names=names)


def test_normal_forces_read_as_whole_forces_warn(tmp_path):
    with pytest.warns(xcg.SceneWarning) as said:
        open_chain(tmp_path, 2.0, WHOLE).compute()
    text = only(said)
    assert "c.dump (step 0): all contact forces lie along the branches" in text
    assert "columns c_2[7] c_2[8] c_2[9] are not read" in text
    assert "names={'c_2[4]': 'normal_force_x', 'c_2[7]': 'tangential_force_x', ...}" in text


def test_normal_forces_without_branches_warn(tmp_path):
    """The centres tell the branches; the last columns that nobody wanted are the first guess."""
    names = {column: name for column, name in WHOLE.items() if "branch" not in name}
    with pytest.warns(xcg.SceneWarning) as said:
        open_chain(tmp_path, 2.0, names).compute()
    text = only(said)
    assert "columns c_2[1] c_2[2] c_2[3] c_2[7] c_2[8] c_2[9] are not read" in text
    assert "names={'c_2[4]': 'normal_force_x', 'c_2[7]': 'tangential_force_x', ...}" in text


def test_whole_forces_do_not_warn(tmp_path):
    dropped = WHOLE | {f"c_2[{k}]": None for k in (7, 8, 9)}
    open_chain(tmp_path, 2.0, dropped).compute()  # said not to be wanted
    parts = {
        column: slot.replace("contact_force", "normal_force") for column, slot in WHOLE.items()
    }
    both = parts | {f"c_2[{7 + k}]": f"tangential_force_{a}" for k, a in enumerate("xyz")}
    force = open_chain(tmp_path, 2.0, both).contact_force.values[0]
    np.testing.assert_allclose(force[0], [7 * 0.3 - 2 * 0.1, 7 * 0.1 + 2 * 0.3, 0.0], rtol=1e-5)
    # the sum of both in columns that have other columns beside them
    turned = {f"c_2[{7 + k}]": f"contact_force_{a}" for k, a in enumerate("xyz")}
    kept = {column: slot for column, slot in WHOLE.items() if "force" not in slot}
    open_chain(tmp_path, 2.0, kept | turned).compute()


def test_unnamed_columns_raise_with_a_table_of_names(tmp_path):
    with pytest.raises(xcg.SceneError) as raised:
        open_chain(tmp_path, 2.0, {})
    text = " ".join(str(raised.value).split())
    assert "no ids of both partners among the columns c_1[1] c_1[2] c_2[1]" in text
    assert "which become patom1 patom2 contact_i, contact_j dx dy dz contact_branch_x" in text
    assert (
        "fx fy fz normal_force_x, normal_force_y, normal_force_z p1 p2 p3 tangential_force_x"
        in text
    )
    with pytest.raises(xcg.SceneError) as raised:  # not where columns have names
        open_chain(tmp_path, 2.0, {}, columns=" ".join("abcdefghijk"))
    assert "patom1" not in str(raised.value)


def test_the_summary_states_the_assumed_units(tmp_path):
    text = dumps.dump_text().removeprefix("ITEM: UNITS\nsi\n")
    path = dumps.write(tmp_path / "p.dump", text)
    with pytest.warns(xcg.SceneWarning, match="the header does not name the units"):
        ds = xcg.open_scene(path)
    assert "SI (assumed: the files do not name them)" in str(ds.cg)
    assert "assumed" not in str(xcg.open_scene(path, units="SI").cg)
    named = dumps.write(tmp_path / "named.dump", dumps.dump_text())
    assert "assumed" not in str(xcg.open_scene(named).cg)


# --- discs -----------------------------------------------------------------------------------------------


def test_discs_read_as_spheres_warn():
    rng = np.random.default_rng(1)
    position = np.column_stack([rng.uniform(0, 9, (50, 2)), np.zeros(50)])
    d = rng.uniform(0.8, 1.2, 50)
    with pytest.warns(
        xcg.SceneWarning, match="as those of discs, .* give shape='disc' and thickness="
    ) as said:
        xcg.scene_from_arrays(position, diameter=d, mass=2.0 * d**2, dimension=2)
    only(said)
    with pytest.warns(xcg.SceneWarning, match="as those of discs, .* and dimension=2$") as said:
        xcg.scene_from_arrays(position, diameter=d, mass=2.0 * d**2)  # a layer read as a volume
    only(said)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        xcg.scene_from_arrays(
            position, diameter=d, mass=2.0 * d**2, dimension=2, shape="disc", thickness=1.0
        )
        xcg.scene_from_arrays(position, diameter=d, mass=2.0 * d**3, dimension=2)
        xcg.scene_from_arrays(position, diameter=np.ones(50), mass=np.ones(50), dimension=2)
        xcg.datasets.open("shear_cell_0.1")
    with pytest.warns(xcg.SceneWarning, match="as those of discs") as said:
        xcg.datasets.open("shear_cell_0.1", shape="sphere", thickness=None)
    only(said)
