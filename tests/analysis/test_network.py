"""The contact network against loops and networkx: graphs, matrices, clusters, percolation, distributions of forces."""

import itertools
import sys

import numpy as np
import pytest

import xcg
from tests.scenes import random_steps, spheres

nx = pytest.importorskip("networkx")

CLUSTERS = [
    "cluster_count",
    "largest_cluster",
    "largest_cluster_fraction",
    "percolation",
    "particle_count",
]


def touching(position, edge=5.0, diameter=1.0, **options):
    """Spheres in a periodic box and their contacts, with forces of a spring."""
    box = {"box": [[0.0, edge]] * 3, "periodic": "xyz"}
    return spheres(position, diameter, **(box | options)).cg.find_contacts(k_n=10.0)


def loose(count, seed, **options):
    return touching(np.random.default_rng(seed).uniform(0, 5, (count, 3)), **options)


def rows_of_contacts(ds, t=0):
    there = ds.contact_i.values[t] >= 0
    names = [
        n
        for n in ("contact_i", "contact_j", "contact_force", "contact_point", "overlap")
        if n in ds
    ]
    return {name: ds[name].values[t][there] for name in names}


# --- graphs and matrices ---------------------------------------------------------------------------------


def test_edges_are_sums_over_contacts():
    ds = xcg.datasets.random_scene(150, seed=4, periodic="xy")
    graph = ds.cg.contact_graph(include_walls=True)
    c = rows_of_contacts(ds)
    expected = {}
    for i, j, f in zip(
        c["contact_i"].tolist(), c["contact_j"].tolist(), c["contact_force"], strict=True
    ):
        low, high, sign = (i, j, 1) if j < 0 or i < j else (j, i, -1)
        total = expected.setdefault((low, high), [0, np.zeros(3)])
        total[0] += 1
        total[1] += sign * f
    assert {(a["i"], a["j"]) for _, _, a in graph.edges(data=True)} == set(expected)
    assert any(j < 0 for _, j in expected)
    for (i, j), (contacts, force) in expected.items():
        edge = graph.edges[i, j]
        assert edge["contacts"] == contacts
        np.testing.assert_allclose(edge["force"], force, atol=1e-12)
    # forces on a grain add up to what they are on its rows
    for node in (n for n, wall in graph.nodes(data="wall") if not wall):
        total = sum(
            (
                a["force"] if a["i"] == node else -a["force"]
                for *_, a in graph.edges(node, data=True)
            ),
            np.zeros(3),
        )
        brute = c["contact_force"][c["contact_i"] == node].sum(axis=0) - c["contact_force"][
            c["contact_j"] == node
        ].sum(axis=0)
        np.testing.assert_allclose(total, brute, atol=1e-12)


def test_nodes_have_the_variables_of_their_step():
    ds = random_steps(3)
    graph = ds.cg.contact_graph(index=1)
    step = ds.isel(time=1)
    ids = step.particle_id.values
    assert sorted(graph) == ids[ids >= 0].tolist()
    assert graph.graph == {"time": pytest.approx(0.1), "step": 1}
    for row in (0, 7):
        node = graph.nodes[int(ids[row])]
        assert type(node["diameter"]) is float
        assert type(node["species"]) is int
        assert node["diameter"] == step.diameter.values[row]
        np.testing.assert_array_equal(node["velocity"], step.velocity.values[row])
    assert set(node) == {"wall"} | {n for n in ds.data_vars if "particle" in ds[n].dims} - {
        "particle_id"
    }
    alone = step.cg.contact_graph()
    assert nx.utils.graphs_equal(nx.Graph(alone.edges), nx.Graph(graph.edges))
    lazy = ds.chunk(time=1).cg.contact_graph(index=-2)
    assert set(lazy.edges) == set(graph.edges)


def test_a_pair_that_touches_on_both_sides():
    ds = touching(
        [(0.5, 0.5, 0.5), (1.49, 0.5, 0.5)],
        edge=1.98,
        diameter=1.0,
        periodic="x",
        box={"x": (0, 1.98)},
    )
    edge = ds.cg.contact_graph().edges[0, 1]
    assert edge["contacts"] == 2
    np.testing.assert_allclose(edge["force"], 0, atol=1e-12)
    np.testing.assert_allclose(edge["normal"], 0, atol=1e-12)
    matrix = ds.cg.adjacency(weight="contacts").toarray()
    np.testing.assert_array_equal(matrix, [[0, 2], [2, 0]])


@pytest.mark.parametrize("weight", [None, "contacts", "force", "overlap"])
def test_the_matrix_equals_that_of_the_graph(weight):
    ds = loose(120, 3)
    matrix = ds.cg.adjacency(weight=weight)
    graph = ds.cg.contact_graph()
    value = {"force": lambda a: np.linalg.norm(a["force"]), None: lambda a: 1}.get(
        weight, lambda a: a[weight]
    )
    for *_, a in graph.edges(data=True):
        a["value"] = value(a)
    expected = nx.to_scipy_sparse_array(graph, sorted(graph), weight="value")
    np.testing.assert_allclose(matrix.toarray(), expected.toarray(), rtol=1e-12)
    assert (abs(matrix - matrix.T)).sum() == 0


def test_degrees_are_the_connectivity():
    ds = loose(150, 5)
    degrees = nx.degree_histogram(ds.cg.contact_graph())
    share = ds.cg.microstructure("connectivity").connectivity.values[0]
    np.testing.assert_allclose(share[: len(degrees)] * ds.sizes["particle"], degrees)


# --- clusters --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("count", [0, 1, 20, 60, 90, 140])
def test_clusters_equal_those_of_networkx(count, seed):
    ds = loose(count, seed)
    m = ds.cg.microstructure(CLUSTERS).isel(time=0)
    sizes = [len(c) for c in nx.connected_components(ds.cg.contact_graph())]
    assert m.cluster_count == len(sizes)
    assert m.largest_cluster == max(sizes, default=0)
    if count:
        assert m.largest_cluster_fraction == max(sizes) / count
    else:
        assert np.isnan(m.largest_cluster_fraction)


def winding_brute(ds, reach=2):
    """Axes along which a grain is connected with an image of its own, from copies of the box on all sides."""
    c = rows_of_contacts(ds)
    period = 5.0
    x = dict(zip(ds.particle_id.values[0].tolist(), ds.position.values[0], strict=True))
    copies = list(itertools.product(range(-reach, reach + 1), repeat=3))
    graph = nx.Graph()
    for i, j in zip(c["contact_i"].tolist(), c["contact_j"].tolist(), strict=True):
        away = x[i] - x[j]
        number = np.rint(away / period).astype(int)  # the image of j that is nearest to i
        for copy in copies:
            graph.add_edge((i, copy), (j, tuple(np.add(copy, number).tolist())))
    found = np.zeros(3)
    for part in nx.connected_components(graph):
        first = {}
        for i, copy in part:
            found = np.maximum(found, np.subtract(copy, first.setdefault(i, copy)) != 0)
    return found


@pytest.mark.parametrize("count", [40, 60, 75, 85, 95, 110])
@pytest.mark.parametrize("seed", range(5))
def test_percolation_equals_that_of_copies_of_the_box(count, seed):
    ds = loose(count, seed)
    np.testing.assert_array_equal(
        ds.cg.microstructure("percolation").percolation[0], winding_brute(ds)
    )


@pytest.mark.slow  # percolation equals that of copies of the box
def test_random_packings_percolate_about_half_the_time():
    found = np.array(
        [
            winding_brute(loose(count, seed))
            for count in (40, 60, 75, 85, 95, 110)
            for seed in range(5)
        ]
    )
    assert (found.mean(axis=0) > 0.1).all()
    assert (found.mean(axis=0) < 0.9).all()
    assert (found.min(axis=1) != found.max(axis=1)).any()


def test_a_loop_within_the_box_does_not_percolate():
    ring = [
        (2 + np.cos(a), 2 + np.sin(a), 2.0) for a in np.linspace(0, 2 * np.pi, 6, endpoint=False)
    ]
    m = touching(ring, diameter=1.01).cg.microstructure([*CLUSTERS, "contact_count"]).isel(time=0)
    assert m.contact_count == 6
    assert m.cluster_count == 1
    np.testing.assert_array_equal(m.percolation, 0)
    # also where it lies across the edges
    shifted = (
        touching(np.mod(np.add(ring, 2.3), 5.0), diameter=1.01)
        .cg.microstructure(CLUSTERS)
        .isel(time=0)
    )
    assert shifted.cluster_count == 1
    np.testing.assert_array_equal(shifted.percolation, 0)


@pytest.mark.parametrize("tilt", [0.0, 1.0, 2.5, 4.0])
def test_percolation_of_a_tilted_box_is_along_its_vectors(tilt):
    """A row of grains along the vector b of a box that is tilted along x."""
    vector = np.array([tilt, 5.0, 0.0])
    count = 6
    row = np.mod(np.outer(np.arange(count) / count, vector), 5.0) + 0.1
    diameter = 1.01 * np.linalg.norm(vector) / count
    ds = touching(row, diameter=diameter, lattice=[[5.0, 0, 0], vector, [0, 0, 5.0]])
    m = ds.cg.microstructure(CLUSTERS).isel(time=0)
    assert m.cluster_count == 1
    np.testing.assert_array_equal(m.percolation, [0, 1, 0])
    moved = (
        ds.assign(position=ds.position + np.array([3.3, 4.4, 1.1]))
        .drop_dims("contact")
        .cg.find_contacts()
    )
    np.testing.assert_array_equal(moved.cg.microstructure("percolation").percolation[0], [0, 1, 0])


@pytest.mark.parametrize(("share", "percolates"), [(0.24, 0), (0.40, 1)])
def test_random_sites_of_a_lattice_percolate_from_the_known_share_on(share, percolates):
    """Share 0.3116 of the sites of a simple cubic lattice (Lorenz & Ziff 1998)."""
    ds = xcg.datasets.simple_cubic(16)
    chosen = np.random.default_rng(3).random(ds.position.shape[:2]) < share
    m = ds.assign(chosen=(("time", "particle"), chosen.astype(int))).cg.microstructure(
        "percolation", by="chosen"
    )
    np.testing.assert_array_equal(m.percolation.sel(phase=1)[0], percolates)


def column(count, walls, frozen=False):
    """A column along z between walls at its ends, those that are there, or frozen grains in their place."""
    z = np.arange(count) + 0.5
    i = list(range(count - 1))
    j = list(range(1, count))
    force = [(0, 0, -1.0)] * (count - 1)
    point = [(0, 0, h + 1.0) for h in range(count - 1)]
    for number, (row, push, place) in {
        -2: (0, 1.0, 0.0),
        -3: (count - 1, -1.0, float(count)),
    }.items():
        if number in walls:
            i = [*i, row]
            j = [*j, number]
            force = [*force, (0, 0, push)]
            point = [*point, (0, 0, place)]
    position = np.column_stack([np.zeros(count), np.zeros(count), z])
    extra = {"frozen": np.isin(np.arange(count), [0, count - 1]).astype(int)} if frozen else {}
    return xcg.scene_from_arrays(
        position, diameter=np.ones(count), density=1.0, box={"z": (0, count)}, contact_i=i, contact_j=j,
        contact_force=force, contact_point=point, **extra,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("walls", "frozen", "spans"),
    [((), False, 0), ((-2,), False, 0), ((-3,), False, 0), ((-2, -3), False, 1), ((), True, 1)],
)
def test_a_column_between_walls_spans(walls, frozen, spans):
    np.testing.assert_array_equal(
        column(5, walls, frozen).cg.microstructure("percolation").percolation[0], [0, 0, spans]
    )


def test_columns_that_are_broken_do_not_span():
    ds = column(6, (-2, -3))
    cut = ds.sel(contact=~((ds.contact_i == 2) & (ds.contact_j == 3)).values[0])
    m = cut.cg.microstructure(CLUSTERS).isel(time=0)
    assert m.cluster_count == 2
    assert m.percolation.sel(component="z") == 0


def test_clusters_of_phases_and_regions_take_contacts_between_their_grains():
    ds = xcg.datasets.random_scene(200, seed=2)
    m = ds.cg.microstructure(
        CLUSTERS, by="species", bounds={"low": {"z": (0, 2.5)}, "high": {"z": (2.5, 5)}}
    )
    graph = ds.cg.contact_graph()
    species = ds.species.values[0]
    for region, chosen in (
        ("low", ds.position.values[0][:, 2] < 2.5),
        ("high", ds.position.values[0][:, 2] >= 2.5),
    ):
        for phase, of_phase in (("bulk", species > 0), ("1", species == 1), ("2", species == 2)):
            ids = ds.particle_id.values[0][chosen & of_phase].tolist()
            sizes = [len(c) for c in nx.connected_components(graph.subgraph(ids))]
            found = m.sel(region=region, phase=phase).isel(time=0)
            assert found.cluster_count == len(sizes)
            assert found.largest_cluster == max(sizes)
            assert found.largest_cluster_fraction == max(sizes) / found.particle_count


def test_a_layer_has_no_percolation_across():
    ds = xcg.datasets.random_scene(60, dimension=2, periodic="xy")
    found = ds.cg.microstructure("percolation").percolation[0]
    assert np.isnan(found.sel(component="z"))
    assert np.isfinite(found.sel(component=["x", "y"])).all()


# --- distributions of forces -----------------------------------------------------------------------------


def test_forces_over_their_means_by_phase():
    ds = xcg.datasets.random_scene(200, seed=7)
    names = [
        f"{kind}_force_{what}" for kind in ("normal", "tangential") for what in ("pdf", "count")
    ]
    edges = np.linspace(0, 3, 7)
    m = ds.cg.microstructure(
        [*names, "mean_normal_force", "mean_tangential_force"], by="species", force_bins=edges
    )
    c = rows_of_contacts(ds)
    row = {int(k): n for n, k in enumerate(ds.particle_id.values[0])}
    species = ds.species.values[0]
    x = ds.position.values[0]
    for phase in ("bulk", 1, 2):
        parts = []
        for i, j, f in zip(c["contact_i"], c["contact_j"], c["contact_force"], strict=True):
            branch = x[row[int(i)]] - x[row[int(j)]]
            branch -= 5.0 * np.rint(branch / 5.0)
            n = branch / np.linalg.norm(branch)
            sides = [phase == "bulk" or species[row[int(k)]] == phase for k in (i, j)]
            if f @ n > 0 and any(sides):
                parts.append((sum(sides) / 2, f @ n, np.linalg.norm(f - (f @ n) * n)))
        weight, normal, tangential = np.array(parts).T
        found = m.sel(phase=str(phase)).isel(time=0)
        for kind, size in (("normal", normal), ("tangential", tangential)):
            mean = (weight * size).sum() / weight.sum()
            assert found[f"mean_{kind}_force"] == pytest.approx(mean)
            count = [
                weight[(size >= low * mean) & (size < high * mean)].sum()
                for low, high in itertools.pairwise(edges)
            ]
            np.testing.assert_allclose(found[f"{kind}_force_count"], count)
            np.testing.assert_allclose(
                found[f"{kind}_force_pdf"], np.array(count) / weight.sum() / 0.5
            )


def test_without_friction_there_is_no_distribution_of_tangential_forces():
    m = loose(120, 1).cg.microstructure(
        ["mean_tangential_force", "tangential_force_pdf", "normal_force_pdf"]
    )
    assert m.mean_tangential_force == 0
    assert np.isnan(m.tangential_force_pdf).all()
    assert (m.normal_force_pdf * m.force_ratio_width).sum() == pytest.approx(1)


# --- messages --------------------------------------------------------------------------------------------


def test_wrong_arguments_raise(monkeypatch):
    ds = loose(20, 1)
    with pytest.raises(
        ValueError, match="weight='mass': expected one of 'contacts', 'force', 'overlap'"
    ):
        ds.cg.adjacency(weight="mass")
    with pytest.raises(
        ValueError, match="index=3: expected the position of a step, a whole number from -1 to 0"
    ):
        ds.cg.adjacency(3)
    with pytest.raises(xcg.SceneError, match="contact_force"):
        ds.drop_vars("contact_force").cg.adjacency(weight="force")
    with pytest.raises(xcg.SceneError, match=r"contact_graph needs .*find_contacts"):
        ds.drop_dims("contact").cg.contact_graph()
    monkeypatch.setitem(sys.modules, "networkx", None)
    with pytest.raises(
        ImportError, match=r"contact_graph needs networkx, .* pip install 'xcg\[network\]'"
    ):
        ds.cg.contact_graph()
    assert ds.cg.adjacency().shape == (20, 20)
