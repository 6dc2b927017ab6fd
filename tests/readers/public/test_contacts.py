"""Rows that are no contacts, columns that are no overlaps, points off the surfaces, bodies that are defaults."""

import itertools

import numpy as np
import pytest

import xcg
from tests import dumps
from xcg import SceneWarning

BOX = "ITEM: BOX BOUNDS ff ff ff\n0 1\n0 1\n0 1\n"
GRAINS = ["1 1 .5 .5 .4 .05 1", "2 1 .5 .5 .49 .05 1", "3 1 .5 .5 .6 .05 1", "4 1 .62 .5 .4 .05 1"]
# a contact, and three pairs of a neighbour list without a force and with gaps of .01, .02 and .05
NEIGHBOURS = {
    "1 2": [0, 0, -0.09, -7],
    "2 3": [0, 0, -0.11, 0],
    "1 4": [-0.12, 0, 0, 0],
    "2 4": [-0.12, 0, 0.09, 0],
}


def dump(folder, rows, columns, name="p.dump", label="ATOMS"):
    text = dumps.dump_text(rows, columns, label=label, box=BOX)
    return dumps.write(folder / name, text)


def neighbour_list(folder, form):
    """Grains, and pairs of a neighbour list as a code writes them; the arguments of open_scene."""
    grains = dump(folder, GRAINS, "id type x y z radius mass")
    pairs = NEIGHBOURS.items()
    if form == "lammps":
        rows = [f"{ids} {x} {y} {z} 0 0 {force} 0 0 0" for ids, (x, y, z, force) in pairs]
        columns = "id1 id2 dx dy dz fnx fny fnz ftx fty ftz"
    elif form == "lammps, without branches":
        rows = [f"{ids} 0 0 {force}" for ids, (*_, force) in pairs]
        columns = "patom1 patom2 fx fy fz"
    else:  # numbered columns of LIGGGHTS: both centres, ids, a flag, force, overlap
        centre = {row.split()[0]: " ".join(row.split()[2:5]) for row in GRAINS}
        rows = []
        for ids, (x, y, z, force) in pairs:
            i, j = ids.split()
            overlap = 0.1 - np.linalg.norm([x, y, z])
            rows.append(f"{centre[i]} {centre[j]} {ids} 0 0 0 {force} {overlap}")
        columns = " ".join(f"c_1[{k}]" for k in range(1, 14))
    contacts = dump(folder, rows, columns, "c.dump", "ENTRIES")
    return {"particles": grains, "contacts": contacts, "engine": form.split(",")[0]}


@pytest.mark.parametrize("form", ["lammps", "lammps, without branches", "liggghts"])
def test_pairs_of_a_neighbour_list_are_no_contacts(tmp_path, form):
    ds = xcg.open_scene(**neighbour_list(tmp_path, form))
    match = (
        r"3 of 4 rows of contacts have no force, and a gap .*contact row 1, contact_i=2, .*0\.01"
    )
    with pytest.warns(SceneWarning, match=match) as warned:
        ds = ds.load()
    assert len(warned) == 1
    assert ds.contact_i.values[ds.contact_i.values >= 0].tolist() == [1]
    assert ds.cg.microstructure().coordination_number.item() == 0.5


def arrays(distance, force, **more):
    """Two spheres of radius 0.5 at a distance along x, and a contact with a force along x."""
    return {
        "position": [[0.0, 0, 0], [distance, 0, 0]],
        "diameter": [1.0, 1.0],
        "density": 1.0,
        "contact_i": [0],
        "contact_j": [1],
        "contact_force": [[force, 0, 0]],
    } | more


@pytest.mark.parametrize("distance", [1.0, 1.0 + 1e-9, 0.9])
def test_spheres_that_touch_without_a_force_are_contacts(distance):
    assert xcg.scene_from_arrays(**arrays(distance, 0.0)).sizes["contact"] == 1


@pytest.mark.parametrize("force", [1e-30, 2.0])
def test_a_force_across_a_gap_is_a_contact(force):
    assert xcg.scene_from_arrays(**arrays(1.1, force)).sizes["contact"] == 1


@pytest.mark.parametrize(
    "how",
    [
        {"contact_point": [[0.55, 0, 0]]},
        {"contact_branch": [[-1.1, 0, 0]]},
        {"contact_point": [[0.55, 0, 0]], "box": [[0, 3.0]] * 3, "periodic": "x"},
    ],
)
def test_a_gap_without_a_force_is_no_contact_in_arrays(how):
    with pytest.warns(SceneWarning, match=r"1 of 1 rows .* gap .*0\.1\)"):
        assert xcg.scene_from_arrays(**arrays(1.1, 0.0, **how)).sizes["contact"] == 0


def test_walls_and_grains_of_other_shapes_have_no_gaps():
    wall = arrays(3.0, 0.0, contact_j=[-1], contact_point=[[-0.7, 0, 0]])
    assert xcg.scene_from_arrays(**wall).sizes["contact"] == 1
    axes = {
        f"half_axis_{axis}": [size] * 2 for axis, size in zip("xyz", (1.0, 0.5, 0.25), strict=True)
    }
    rods = arrays(1.9, 0.0, contact_point=[[0.95, 0, 0]], overlap=[0.1], **axes)
    ds = xcg.scene_from_arrays(**rods)
    assert ds.overlap.values.tolist() == [[0.1]]


# --- overlaps --------------------------------------------------------------------------------------------

SEPARATION, RADIUS = 0.09, 0.05
OTHER_QUANTITIES = {
    "contact area": np.pi * (RADIUS**2 - SEPARATION**2 / 4),
    "contact area without pi": RADIUS**2 - SEPARATION**2 / 4,
    "distance of the centres": SEPARATION,
    "overlap with the other sign": -0.01,
    "half the overlap": 0.005,
    "overlap over the diameter": 0.1,
    "number of a contact": 17.0,
}


@pytest.mark.parametrize("quantity", OTHER_QUANTITIES)
@pytest.mark.parametrize("form", ["liggghts", "table", "lammps"])
def test_a_column_of_another_quantity_is_no_overlap(tmp_path, quantity, form):
    value = OTHER_QUANTITIES[quantity]
    if form == "liggghts":
        column, engine = "c_1[13]", "liggghts"
        row = f".5 .5 .4 .5 .5 .49 1 2 0 0 0 -7 {value}"
        contacts = dump(
            tmp_path, [row], " ".join(f"c_1[{k}]" for k in range(1, 14)), "c.dump", "ENTRIES"
        )
    elif form == "lammps":
        column, engine = "delta", "lammps"
        contacts = dump(
            tmp_path, [f"1 2 0 0 -7 {value}"], "id1 id2 fx fy fz delta", "c.dump", "ENTRIES"
        )
    else:
        column, engine = "overlap", "table"
        contacts = dumps.write(
            tmp_path / "c.csv", f"id1,id2,fx,fy,fz,overlap\n1,2,0,0,-7,{value}\n"
        )
    if engine == "table":
        text = "id,x,y,z,radius,mass\n1,.5,.5,.4,.05,1\n2,.5,.5,.49,.05,1\n"
        grains = dumps.write(tmp_path / "p.csv", text)
    else:
        grains = dump(tmp_path, GRAINS[:2], "id type x y z radius mass")
    ds = xcg.open_scene(grains, contacts=contacts, engine=engine)
    with pytest.warns(SceneWarning) as warned:
        overlap = ds.overlap.compute()
    assert overlap.item() == pytest.approx(0.01, rel=1e-12)
    assert f"{column!r} is not the overlap" in str(warned[0].message)
    named = xcg.open_scene(
        grains, contacts=contacts, engine=engine, names={column: "contact_quantity"}
    )
    assert named.contact_quantity.compute().item() == pytest.approx(value)


@pytest.mark.parametrize(("overlap", "right"), [(0.02, 0.02), (0.01, 0.01), (5e-4, 0.01)])
def test_overlaps_with_walls_follow_from_points_at_either_depth(tmp_path, overlap, right):
    """The point is 0.01 below the surface: at R - overlap, or at R - overlap / 2."""
    grains = dump(tmp_path, GRAINS[:1], "id type x y z radius mass")
    row = f".5 .5 .36 .5 .5 .4 0 5 1 0 0 7 {overlap}"
    columns = " ".join(f"c_2[{k}]" for k in range(1, 14))
    walls = dump(tmp_path, [row], columns, "w.dump", "ENTRIES")
    ds = xcg.open_scene(grains, walls=walls, engine="liggghts")
    if overlap == right:
        assert ds.overlap.compute().item() == overlap
    else:
        with pytest.warns(SceneWarning, match=r"'c_2\[13\]' is not the overlap"):
            assert ds.overlap.compute().item() == pytest.approx(right, rel=1e-12)


def test_noise_of_six_digits_and_old_positions_leave_overlaps_as_they_are():
    rng = np.random.default_rng(2)
    count = 2000
    first = rng.uniform(0, 100, (count, 3))
    overlap = rng.exponential(1e-4, count)
    normal = rng.normal(size=(count, 3))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    second = first - (1 - overlap)[:, None] * normal
    position = np.concatenate([first, second]) + rng.normal(0, 1e-5, (2 * count, 3))
    position = np.array([[float(f"{x:.6g}") for x in row] for row in position])
    ds = xcg.scene_from_arrays(
        position, diameter=np.ones(2 * count), density=1.0, contact_i=np.arange(count),
        contact_j=np.arange(count, 2 * count), contact_force=normal, overlap=overlap,
    )  # fmt: skip
    np.testing.assert_array_equal(ds.overlap.values[0], overlap)


# --- contact points --------------------------------------------------------------------------------------


@pytest.mark.parametrize("point", [0.62, 0.995])
def test_points_of_old_fstat_files_are_moved_to_the_surfaces(tmp_path, point):
    """Spheres of radius 1 and 0.25 that touch with a force of 200, 0.995 and 0.245 from their centres."""
    rest = "0 0 0 0 0 0"
    data = f"2 0 -2 -2 -2 2 2 2\n0 0 0 0 0 0 1 {rest} 0\n0 0 1.24 0 0 0 .25 {rest} 1\n"
    row = "0 {} {} 0 0 {} .01 0 200 0 0 0 {} 0 0 0\n"
    rows = row.format(0, 1, point, -1) + row.format(1, 0, point, 1)
    head = "# 0 0\n# -2 -2 -2 2 2 2\n# .25 1 0 0 0 0\n"
    ds = xcg.open_scene(
        dumps.write(tmp_path / "run.data", data),
        contacts=dumps.write(tmp_path / "run.fstat", head + rows),
        density=1.0,
    )
    if point == 0.995:
        ds = ds.load()
    else:
        with pytest.warns(SceneWarning, match="midway between the centres .* before 2016"):
            ds = ds.load()
    f = ds.cg.coarse_grain("contact_stress", axes="", by="species")
    stress = f.contact_stress.sel(component="z", direction="z").values.ravel() * 4.0**3
    np.testing.assert_allclose(stress, [248, 199, 49], rtol=1e-12)


@pytest.mark.parametrize("edge", [None, 3.0])
@pytest.mark.parametrize("large", [1.05, 2.0, 8.0])
def test_middles_in_arrays_are_moved_to_the_surfaces(large, edge):
    distance = 0.99 * (1 + large) / 2
    periods = {} if edge is None else {"box": [[0, edge * large]] * 3, "periodic": "xyz"}
    given = arrays(distance, -1.0, diameter=[1.0, large], contact_point=[[distance / 2, 0, 0]])
    with pytest.warns(SceneWarning, match="they are moved to where the spheres touch"):
        ds = xcg.scene_from_arrays(**given, **periods)
    overlap = 0.01 * (1 + large) / 2
    np.testing.assert_allclose(ds.contact_point.values, [[[0.5 - overlap / 2, 0, 0]]], rtol=1e-12)


@pytest.mark.parametrize("depth", [0.0, 0.005, 0.01])
def test_points_on_a_surface_stay(depth):
    given = arrays(0.99, -1.0, diameter=[1.0, 1.0], contact_point=[[0.5 - depth, 0, 0]])
    assert xcg.scene_from_arrays(**given).contact_point.values[0, 0, 0] == 0.5 - depth
    given = arrays(1.49, -1.0, diameter=[1.0, 2.0], contact_point=[[0.5 - depth, 0, 0]])
    assert xcg.scene_from_arrays(**given).contact_point.values[0, 0, 0] == 0.5 - depth


@pytest.mark.parametrize("large", [1.0, 1.02, 2.0, 4.0])
@pytest.mark.parametrize("centre", ["of i", "of j", "beside both"])
def test_points_far_from_both_surfaces_are_named(large, centre):
    distance = 0.99 * (1 + large) / 2
    point = {"of i": [0.0, 0, 0], "of j": [distance, 0, 0], "beside both": [0.5, 1.5 * large, 0]}
    given = arrays(distance, -1.0, diameter=[1.0, large], contact_point=[point[centre]])
    with pytest.warns(SceneWarning, match="points lie off the surfaces of both spheres .*names="):
        ds = xcg.scene_from_arrays(**given)
    assert ds.contact_point.values[0, 0].tolist() == point[centre]


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("unit", [1e3, 1.0, 1e-3])
def test_points_in_another_unit_are_named_with_it(unit, periodic, recwarn):
    places = np.stack(np.meshgrid(*[np.arange(4)] * 3, indexing="ij"), -1).reshape(-1, 3)
    position = 0.98e-3 * places + 2e-3
    away = np.linalg.norm(position[:, None] - position, axis=2)
    i, j = np.nonzero(np.triu((away > 0) & (away < 1.1e-3)))
    box = {}
    if periodic:
        box = {"box": [[2e-3, 2e-3 + 4 * 0.98e-3]] * 3, "periodic": "xyz"}
    xcg.scene_from_arrays(
        position,
        diameter=1e-3,
        density=1.0,
        contact_i=i,
        contact_j=j,
        contact_force=position[i] - position[j],
        contact_point=unit * (position[i] + position[j]) / 2,
        **box,
    )
    messages = [str(w.message) for w in recwarn if issubclass(w.category, SceneWarning)]
    assert len(messages) == (unit != 1.0)
    assert all(f"Divided by {unit:g} they lie on them" in text for text in messages)


# --- several contacts of a pair, and coincident centres --------------------------------------------------


@pytest.mark.parametrize("sides", ["mean", "first", "separate"])
@pytest.mark.parametrize("apart", [1e-3, 0.02, 0.3])
@pytest.mark.parametrize("turned", [False, True])
def test_contacts_of_a_pair_at_different_points_all_count(tmp_path, sides, apart, turned):
    """Two contacts of 5 at a distance of 1 between the centres: zz times V is 10, listed from one or both sides."""
    grains = dumps.write(tmp_path / "g.csv", "id,x,y,z,diameter\n0,0,0,0,1.02\n1,0,0,1,1.02\n")
    rows = [f"1,0,0,0,5,{x},0,.5" for x in (0.0, apart)]
    if turned:
        rows += [f"0,1,0,0,-5,{x},0,.5" for x in (0.0, apart)]
    header = "id1,id2,fx,fy,fz,contact_point_x,contact_point_y,contact_point_z"
    contacts = dumps.write(tmp_path / "c.csv", "\n".join([header, *rows, ""]))
    ds = xcg.open_scene(grains, contacts=contacts, density=1.0, sides=sides).load()
    force = ds.contact_force.values[0, :, 2] * np.where(ds.contact_i.values[0] == 1, 1, -1)
    assert np.nansum(force) == 10.0
    assert (ds.contact_i.values >= 0).sum() == 2


@pytest.mark.parametrize("sides", ["mean", "first", "separate"])
@pytest.mark.parametrize("order", list(itertools.permutations(range(4)))[::5])
def test_contacts_from_both_sides_at_close_points_all_count(sides, order):
    rows = [(1, 0, 5.0, 0.0), (0, 1, -5.0, 0.0), (1, 0, 5.0, 0.02), (0, 1, -5.0, 0.02)]
    i, j, force, x = zip(*(rows[k] for k in order), strict=True)
    ds = xcg.scene_from_arrays(
        [[0.0, 0, 0], [0, 0, 1]],
        diameter=[1.02, 1.02],
        density=1.0,
        contact_i=i,
        contact_j=j,
        contact_force=[[0, 0, f] for f in force],
        contact_point=[[place, 0, 0.5] for place in x],
        sides=sides,
    )
    on_upper = ds.contact_force.values[0, :, 2] * np.where(ds.contact_i.values[0] == 1, 1, -1)
    assert on_upper.tolist() == [5.0, 5.0]


def test_rows_that_are_the_same_count_once(tmp_path):
    given = arrays(0.9, -1.0, contact_i=[0, 0], contact_j=[1, 1], contact_force=[[-1.0, 0, 0]] * 2)
    for sides in ("mean", "first", "separate"):
        for points in ({}, {"contact_point": [[0.45, 0, 0]] * 2}):
            assert xcg.scene_from_arrays(**given, **points, sides=sides).sizes["contact"] == 1


@pytest.mark.parametrize("point", [{}, {"contact_point": [[0.0, 0, 0]]}])
def test_coincident_centres_warn(point):
    with pytest.warns(SceneWarning, match=r"same position \(contact_i=0, contact_j=1\)"):
        ds = xcg.scene_from_arrays(**arrays(0.0, 1.0, **point))
    assert ds.contact_point.values.tolist() == [[[0.0, 0.0, 0.0]]]


# --- bodies ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("bodies", "right"),
    [
        ([1, 1, 1, 1], [-1, -1, -1, -1]),
        ([7, 7, 2, 7], [-1, -1, 2, -1]),
        ([0, 0, 0, 0], [-1, -1, -1, -1]),  # molecule 0 is none, without a warning
        ([5, 5, 2, 2], [5, 5, 2, 2]),
        ([1, 2, 3, 4], [1, 2, 3, 4]),
    ],
)
def test_a_body_of_most_grains_is_none(tmp_path, bodies, right):
    rows = [f"{body} {row}" for body, row in zip(bodies, GRAINS, strict=True)]
    path = dump(tmp_path, rows, "mol id type x y z radius mass")
    if bodies == right or not any(bodies):
        ds = xcg.open_scene(path)
    else:
        with pytest.warns(SceneWarning, match=r"[34] of 4 particles are of one body") as warned:
            ds = xcg.open_scene(path).load()
        assert len(warned) == 1
    assert ds.body_id.values.tolist() == [right]
    glued = bodies[0] == bodies[1] == right[0]
    found = ds.cg.find_contacts().compute()
    assert (found.contact_i.values >= 0).sum() == (0 if glued else 1)


def test_a_single_body_that_is_glued_can_be_assigned(tmp_path):
    rows = [f"1 {row}" for row in GRAINS]
    path = dump(tmp_path, rows, "mol id type x y z radius mass")
    ds = xcg.open_scene(path, names={"mol": "my_body"})
    ds = ds.assign(body_id=ds.my_body.fillna(-1).astype(int))
    mass = ds.cg.group_bodies().compute().mass.values
    assert mass[np.isfinite(mass)].tolist() == [4.0]
    assert (ds.cg.find_contacts().contact_i.compute() >= 0).sum() == 0
