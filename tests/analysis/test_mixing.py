"""Indices of mixing: limits in closed form, means over all arrangements, and sums written out."""

import itertools
import re

import numpy as np
import pytest
import xarray as xr

import xcg
from tests.scenes import spheres

# scenes here are small, so that their indices scatter
pytestmark = pytest.mark.filterwarnings("ignore:lacey_index scatters")

MIXING = [
    "lacey_index", "concentration_variance", "random_concentration_variance", "segregated_concentration_variance",
]  # fmt: skip


def of_phases(position, species, diameter=1.0, box=None, **options):
    """Spheres of several phases."""
    return spheres(position, diameter, species=species, box=box, **options)


def measured(ds, **options):
    m = ds.cg.microstructure(MIXING, by="species", **options).isel(time=0)
    return {name: m[name].sel(phase=options.get("phase", "bulk")).item() for name in MIXING}


def lattice(edge=4):
    return np.array(list(itertools.product(range(edge), repeat=3))) + 0.5


BOX = [[0.0, 4.0]] * 3


def test_a_checkerboard_is_mixed_better_than_random():
    """Every cell of eight holds four of each: no variance."""
    x = lattice()
    ds = of_phases(x, 1 + (x - 0.5).sum(axis=1).astype(int) % 2, box=BOX, periodic="xyz")
    m = measured(ds, cell=2.0)
    assert m["concentration_variance"] == 0.0
    # 8 cells of 64 grains: S_0^2 = 1/4 and S_r^2 = 7/63/4 for each phase, so 1 / (1 - 1/9)
    assert m["lacey_index"] == pytest.approx(9 / 8, rel=1e-14)


def test_few_large_grains_by_volume_have_no_index_and_a_warning():
    """One of eight grains holds most of the volume: at random its phase varies more than apart."""
    x = np.random.default_rng(0).uniform(0, 4, (8, 3))
    x[1] = x[0] + 0.01
    ds = of_phases(x, 1 + (np.arange(8) == 0), np.where(np.arange(8) == 0, 1.0, 0.3), box=BOX)
    options = {"by": "species", "cell": 1.0, "mixing_weight": "volume"}
    m = ds.cg.microstructure(MIXING[2:], **options)
    assert (m.random_concentration_variance > m.segregated_concentration_variance).all()
    with pytest.warns(xcg.SceneWarning, match="lacey_index is NaN: by volume a random mixture"):
        index = ds.cg.microstructure("lacey_index", **options).lacey_index
    assert index.isnull().all()
    assert ds.cg.microstructure("lacey_index", by="species", cell=1.0).lacey_index.notnull().all()


def test_cells_below_a_grain_have_no_index_and_a_warning_names_a_cell():
    x = lattice()
    ds = of_phases(x, 1 + (x - 0.5).sum(axis=1).astype(int) % 2, box=BOX, periodic="xyz")
    text = r"lacey_index is NaN: no cell of edge 0.5 holds more than one of the 64 grains"
    with pytest.warns(xcg.SceneWarning, match=text) as found:
        m = ds.cg.microstructure("lacey_index", by="species", cell=0.5).compute()
    assert np.isnan(m.lacey_index).all()
    (warning,) = found  # one for all phases
    cell = float(re.search(r"take cell=([\d.]+) or more", str(warning.message))[1])
    assert cell < 2.1  # of 8 grains each
    assert np.isfinite(
        ds.cg.microstructure("lacey_index", by="species", cell=cell).lacey_index
    ).all()
    few = of_phases(x[:3], [1, 1, 2], box=BOX)
    with pytest.warns(xcg.SceneWarning, match="the region holds too few grains"):
        few.cg.microstructure("lacey_index", by="species", cell=0.5).compute()


def mixed(count, share, edges, seed=0):
    """Grains at random places of a box, a share of them at random of species 2."""
    rng = np.random.default_rng(seed)
    species = np.where(rng.permutation(count) < share * count, 2, 1)
    position = rng.random((count, 3)) * edges
    return of_phases(position, species, 0.3, [[0, edge] for edge in edges], periodic="xy"), rng


@pytest.mark.parametrize(("share", "cell"), [(0.5, 1.0), (0.25, 2.0), (0.25, {"z": 0.5})])
def test_the_index_of_random_mixtures_has_mean_one_and_the_noise_of_its_formula(share, cell):
    ds, rng = mixed(400, share, (4.0, 4.0, 8.0))
    noise = ds.cg.microstructure("lacey_noise", by="species", cell=cell).lacey_noise[0, 0].item()
    # each step is another arrangement of the same grains
    species = np.array([rng.permutation(ds.species.values[0]) for _ in range(150)])
    many = ds.isel(time=[0] * 150).assign_coords(
        time=np.arange(150.0), step=("time", np.arange(150))
    )
    many["species"] = (("time", "particle"), species)
    index = many.cg.microstructure("lacey_index", by="species", cell=cell).lacey_index
    index = index.sel(phase="bulk")
    assert index.mean().item() == pytest.approx(1.0, abs=4 * noise / np.sqrt(150))
    assert index.std().item() == pytest.approx(noise, rel=0.25)  # 4 sqrt(1 / 300)


@pytest.mark.filterwarnings("default:lacey_index scatters")
def test_cells_of_few_grains_warn_and_the_named_cell_does_not():
    ds, _ = mixed(60, 0.5, (4.0, 4.0, 4.0))
    with pytest.warns(
        xcg.SceneWarning, match="lacey_index scatters by .* grains on average"
    ) as found:
        ds.cg.microstructure("lacey_index", by="species", cell=1.0).compute()
    cell = float(re.search(r"take cell=([\d.]+) or more", str(found[0].message))[1])
    m = ds.cg.microstructure(["lacey_index", "lacey_noise"], by="species", cell=cell).compute()
    assert (m.lacey_noise <= 0.1).all()


def test_one_cell_has_no_index():
    ds, _ = mixed(60, 0.5, (4.0, 4.0, 4.0))
    with pytest.warns(xcg.SceneWarning, match="one cell holds all 60 grains"):
        m = ds.cg.microstructure("lacey_index", by="species", cell=9.0).compute()
    assert np.isnan(m.lacey_index).all()


def test_layers_across_a_bed_see_segregation_over_height_alone():
    """Halves beside each other are mixed over the height, and apart in cells."""
    x = lattice()
    beside = of_phases(x, np.where(x[:, 0] < 2, 1, 2), box=BOX)
    above = of_phases(x, np.where(x[:, 2] < 2, 1, 2), box=BOX)
    layers = {"cell": {"z": 1.0}}
    cells = {"cell": 2.0}
    assert measured(beside, **layers)["concentration_variance"] == 0.0
    assert measured(beside, **cells)["lacey_index"] == pytest.approx(0.0, abs=1e-14)
    assert measured(above, **layers)["lacey_index"] == pytest.approx(0.0, abs=1e-14)
    grains = beside.cg.microstructure("grains_per_cell", by="species", **layers).grains_per_cell
    assert (grains == 16.0).all()


# --- segregation ---------------------------------------------------------------------------------


@pytest.mark.parametrize("below", [1, 2, 3])
def test_layers_have_the_largest_index_of_segregation_and_centres_half_a_height_apart(below):
    x = lattice()
    ds = of_phases(x, np.where(x[:, 2] < below, 1, 2), diameter=0.7, box=BOX, periodic="xy")
    m = ds.cg.microstructure(["segregation_index", "centre_of_mass"], by="species").isel(time=0)
    assert m.segregation_index.sel(phase="2").item() == pytest.approx(1.0, rel=1e-14)
    assert m.segregation_index.sel(phase="1").item() == pytest.approx(-1.0, rel=1e-14)
    assert np.isnan(m.segregation_index.sel(phase="bulk"))
    z = m.centre_of_mass.sel(component="z")
    assert z.sel(phase="bulk").item() == pytest.approx(2.0, rel=1e-14)
    assert (z.sel(phase="2") - z.sel(phase="1")).item() == pytest.approx(2.0, rel=1e-14)
    assert np.isnan(m.centre_of_mass.sel(component=["x", "y"])).all()  # they are periodic


def test_the_index_of_segregation_is_that_of_the_share_exchanged():
    """A bed of layers in which a share e of both is exchanged: 1 - 2 e."""
    x = lattice()
    species = np.where(x[:, 2] < 2, 1, 2)
    exchanged = (x[:, 0] < 1) & (x[:, 1] < 1)  # a sixteenth, at all heights
    ds = of_phases(x, np.where(exchanged, 3 - species, species), box=BOX)
    m = ds.cg.microstructure("segregation_index", by="species").segregation_index.isel(time=0)
    assert m.sel(phase="2").item() == pytest.approx(1 - 2 / 16, rel=1e-13)
    assert m.sel(phase="1").item() == pytest.approx(-(1 - 2 / 16), rel=1e-13)
    checkers = of_phases(x, 1 + (x[:, :2] - 0.5).sum(axis=1).astype(int) % 2, box=BOX)
    m = checkers.cg.microstructure("segregation_index", by="species").segregation_index
    assert m.sel(phase="1").item() == pytest.approx(0.0, abs=1e-14)


def test_segregation_of_sizes_weighs_heights_by_volume():
    """Eight small grains above one large one of the same volume: on top, in places of one large one."""
    position = [[0.0, 0, 1.0], *([k, 0.0, 3.0] for k in range(8))]
    ds = of_phases(position, [2, *[1] * 8], diameter=[1.0, *[0.5] * 8])
    m = ds.cg.microstructure(["segregation_index", "centre_of_mass"], by="species").isel(time=0)
    assert m.segregation_index.sel(phase="1").item() == pytest.approx(1.0, rel=1e-14)
    assert m.centre_of_mass.sel(component="z").values == pytest.approx([2.0, 3.0, 1.0])
    along_x = ds.cg.microstructure("segregation_index", by="species", axis="x").isel(time=0)
    # the first of the small grains is beside the large one, at the lowest place
    assert 0 < along_x.segregation_index.sel(phase="1").item() <= 1 + 1e-14


def test_a_periodic_axis_has_no_segregation_without_bounds():
    ds, _ = mixed(60, 0.5, (4.0, 4.0, 4.0))
    with pytest.raises(ValueError, match="periodic along 'x'"):
        ds.cg.microstructure("segregation_index", by="species", axis="x")
    bounds = {"x": (0.0, 4.0)}
    options = {"by": "species", "axis": "x", "bounds": bounds}
    assert np.isfinite(ds.cg.microstructure("segregation_index", **options).segregation_index[0, 1])


def test_separated_halves_have_a_lacey_index_of_zero():
    x = lattice()
    ds = of_phases(x, np.where(x[:, 0] < 2, 1, 2), box=BOX, periodic="xyz")
    m = measured(ds, cell=2.0)
    assert m["lacey_index"] == pytest.approx(0.0, abs=1e-14)
    assert (
        m["concentration_variance"] == m["segregated_concentration_variance"] == 0.5
    )  # 1/4 of each phase
    open_box = measured(of_phases(x, np.where(x[:, 0] < 2, 1, 2), box=BOX), cell=2.0)
    assert open_box["lacey_index"] == pytest.approx(0.0, abs=1e-14)


@pytest.mark.parametrize("phase", ["bulk", "1", "2"])
def test_the_mean_over_all_arrangements_is_the_random_limit(phase):
    """Seven grains in cells of three, two, one and one grains: all 35 ways to make three of them phase 1."""
    x = np.array([0.1, 0.2, 0.3, 1.1, 1.2, 2.5, 3.7])
    position = np.stack([x, 0 * x + 0.5, 0 * x + 0.5], axis=1)
    found = []
    for chosen in itertools.combinations(range(7), 3):
        species = np.full(7, 2)
        species[list(chosen)] = 1
        ds = of_phases(
            position, species, box=[[0, 4], [0, 1], [0, 1]], diameter=np.linspace(0.5, 1, 7)
        )
        m = ds.cg.microstructure(MIXING, by="species", cell=1.0).isel(time=0).sel(phase=phase)
        found.append([m[name].item() for name in MIXING])
    mean = dict(zip(MIXING, np.mean(found, axis=0), strict=True))
    assert mean["concentration_variance"] == pytest.approx(
        mean["random_concentration_variance"], rel=1e-13
    )
    assert mean["lacey_index"] == pytest.approx(1.0, rel=1e-13)


def test_the_random_limit_by_volume_equals_that_of_large_cells():
    """By volume the limit is of first order: within a few per cent for cells of 60 grains of two sizes."""
    rng = np.random.default_rng(0)
    x = rng.random((3000, 3))
    size = rng.uniform(0.5, 1.0, 3000)
    found = []
    limit = []
    for _ in range(40):
        species = rng.permutation(np.repeat([1, 2], [1000, 2000]))
        ds = of_phases(x, species, diameter=0.02 * size, box=[[0, 1]] * 3, periodic="xyz")
        m = ds.cg.microstructure(MIXING[1:3], by="species", cell=0.27, mixing_weight="volume").sel(
            phase="1"
        )
        found.append(m.concentration_variance.item())
        limit.append(m.random_concentration_variance.item())
    assert np.mean(found) == pytest.approx(np.mean(limit), rel=0.08)


@pytest.mark.parametrize("weight", ["number", "volume"])
@pytest.mark.parametrize("dimension", [2, 3])
def test_indices_equal_their_sums_written_out(weight, dimension):
    ds = xcg.datasets.random_scene(90, seed=5, dimension=dimension, periodic="x", edge=5.0)
    bounds = {"low": {"y": (0.0, 2.4)}, "all": {"y": (0.0, 5.0)}}
    cell = 1.3
    if dimension == 3:
        bounds = {name: b | {"z": (0.0, 5.0)} for name, b in bounds.items()}
    options = {"cell": cell, "mixing_weight": weight}
    found = ds.cg.microstructure(MIXING, by="species", bounds=bounds, **options).isel(time=0)
    axes = list(range(dimension))
    for region, limits in bounds.items():
        low = np.array([0.0, 0.0, 0.0])[axes]
        length = np.array([5.0, limits["y"][1], 5.0])[axes]
        x = ds.position.to_numpy()[0][:, axes]
        inside = ((x >= low) & (x < length)).all(axis=1)
        x = x[inside]
        species = ds.species.to_numpy()[0][inside]
        w = ds.volume.to_numpy()[0][inside] if weight == "volume" else np.ones(len(x))
        cells = {}
        for k in range(len(x)):
            place = tuple(int(x[k, a] / length[a] * max(1, round(length[a] / cell))) for a in axes)
            cells.setdefault(place, []).append(k)
        total = len(x)
        parts = {"1": [1], "2": [2], "bulk": [1, 2]}
        for phase, members in parts.items():
            m = found.sel(region=region, phase=phase)
            measured = random = apart = 0.0
            for a in members:
                p = w[species == a].sum() / w.sum()
                apart += p * (1 - p)
                random += (
                    (len(cells) - 1)
                    / (total - 1)
                    * total
                    * ((w * ((species == a) - p)) ** 2).sum()
                    / w.sum() ** 2
                )
                for rows in cells.values():
                    c = w[rows][species[rows] == a].sum() / w[rows].sum()
                    measured += w[rows].sum() / w.sum() * (c - p) ** 2
            want = [(apart - measured) / (apart - random), measured, random, apart]
            for name, value in zip(MIXING, want, strict=True):
                assert m[name].item() == pytest.approx(value, rel=1e-12), (name, phase, region)


def test_indices_of_three_phases_over_time():
    rng = np.random.default_rng(1)
    x = lattice()
    species = [
        1 + rng.permutation(len(x)) % 3,
        np.where(x[:, 0] < 1, 1, np.where(x[:, 0] < 2, 2, 3)),
    ]
    ds = xcg.scene_from_arrays(
        [x, x], diameter=[np.ones(64)] * 2, density=1.0, species=species, box=BOX, periodic="xyz"
    )
    m = ds.chunk(time=1).cg.microstructure(MIXING, by="species", cell=1.0, groups=[1, 2, 3])
    assert m.lacey_index.chunks is not None
    # cells of one grain hold one phase, whatever the mixture: the index tells nothing, and is 0 / 0
    with pytest.warns(xcg.SceneWarning, match="no cell of edge 1 holds more than one"):
        assert np.isnan(m.lacey_index).all()
    m = ds.cg.microstructure(MIXING, by="species", cell=2.0)
    assert m.lacey_index.dims == ("time", "phase")
    assert float(m.lacey_index.sel(phase="bulk")[0]) > float(m.lacey_index.sel(phase="bulk")[1])


def test_one_phase_and_wrong_arguments_raise():
    ds = of_phases(lattice(), np.ones(64, int), box=BOX)
    with pytest.warns(xcg.SceneWarning, match="all 64 grains are of one phase"):
        m = ds.cg.microstructure(MIXING, by="species")
    assert np.isnan(m.lacey_index).all()
    assert not set(MIXING) & set(ds.cg.microstructure(by="species"))
    with pytest.raises(ValueError, match="say which phases are mixed with by="):
        ds.cg.microstructure("lacey_index")
    for options, message in (
        ({"cell": 0.0}, "cell=0.0"), ({"cell": {"q": 1.0}}, "edges by axis"),
        ({"mixing_weight": "mass"}, "mixing_weight='mass'"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=message):
            ds.cg.microstructure("lacey_index", by="species", **options)
    one = of_phases([[1.0, 1, 1]], [1], box=BOX).cg.microstructure(MIXING, by="species")
    assert np.isnan(one.lacey_index).all()


def test_segregation_of_one_phase_is_nan_and_says_why():
    ds = xcg.datasets.random_scene(50, seed=1, walls=True, periodic="xy")
    alone = ds.assign(species=xr.ones_like(ds.species))
    with pytest.warns(
        xcg.SceneWarning, match="segregation_index is NaN: all 50 grains.*assign_phases"
    ):
        m = alone.cg.microstructure(["segregation_index"], by="species", axis="z")
    assert np.isnan(m.segregation_index.to_numpy()).all()
