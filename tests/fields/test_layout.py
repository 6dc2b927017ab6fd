"""One grain that escaped: its automatic mesh is refused, or warned of, before memory is taken."""

import warnings

import numpy as np
import pytest

import xcg
from tests.scenes import spheres
from xcg import SceneWarning
from xcg.fields import layout

R = np.random.default_rng(0).uniform(0, 10, (1000, 3))


def one_escaped(far, *, lazy=False, steps=1):
    """Grains in a box of 10 m, one of them far away."""
    position = R.copy()
    position[17] = [far, far / 2, far]
    ds = spheres([position] * steps, velocity=0 * R)
    return ds.chunk(time=1) if lazy else ds


@pytest.mark.parametrize("far", [1e6, 1e12])
def test_messages_name_the_escaped_particle_and_a_remedy(far):
    with pytest.raises(
        ValueError,
        match=r"particle 17 at \(1e\+.*far from the others; give bounds=, or .* ds\.cg\.select",
    ):
        one_escaped(far).cg.coarse_grain("density")
    with pytest.raises(
        ValueError,
        match=r"x from .* to 1e\+.*some may have escaped; give bounds=, or a larger spacing=",
    ):
        one_escaped(far, lazy=True).cg.coarse_grain("density")


def test_explain_names_the_escaped_particle_of_a_mesh_that_loops_cannot_count():
    with pytest.raises(ValueError, match=r"more than 16777216.*particle 17 .* far from the others"):
        one_escaped(1e12).cg.explain("density")


@pytest.mark.parametrize(("lazy", "steps", "factor"), [(False, 1, 1), (False, 3, 3), (True, 3, 1)])
def test_a_mesh_beyond_memory_raises_before_computing(monkeypatch, lazy, steps, factor):
    """All steps of a scene in memory, one chunk of a lazy one."""
    ds = one_escaped(150.0, lazy=lazy, steps=steps)
    nodes = 205 * 105 * 205
    monkeypatch.setattr(layout, "memory_at_hand", lambda: 8 * nodes * factor - 1)
    monkeypatch.setattr("xcg.fields.coarse_grain.run", lambda *_, **__: pytest.fail("computed"))
    with pytest.raises(
        ValueError, match=r"205 x 105 x 205 nodes, and its fields take .* GB at once"
    ):
        ds.cg.coarse_grain("density")


def test_many_nodes_per_grain_warn_and_name_the_particle():
    with pytest.warns(
        SceneWarning,
        match=r"4\.41e\+03 for each particle: particle 17 at .* is far from the others",
    ):
        one_escaped(150.0).cg.coarse_grain("density")


def test_given_meshes_do_not_warn(monkeypatch):
    monkeypatch.setattr(layout, "memory_at_hand", lambda: 1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        f = one_escaped(150.0).cg.coarse_grain(
            "density", bounds=dict.fromkeys("xyz", (0, 10)), spacing=2.0
        )
    assert f.density.size == 216


def test_available_memory_is_known_or_none():
    found = layout.memory_at_hand()
    assert found is None or found > 2**20


def test_meshes_of_sizes_in_another_unit_are_refused_before_they_are_computed():
    rng = np.random.default_rng(0)
    position = rng.uniform(0, 1, (500, 3))
    for diameter, limit in ((2e-3, r"1e\+08"), (1e-3, "2147483648")):
        ds = xcg.scene_from_arrays(position, diameter=diameter, density=1.0)
        text = f"more than {limit}.*check that sizes and positions have one unit"
        with pytest.raises(ValueError, match=text):
            ds.cg.coarse_grain("density")
    ds.cg.coarse_grain("density", width=0.1)  # nor where the mesh is the user's


def test_a_width_larger_than_the_scene_warns():
    ds = xcg.datasets.random_scene(500)
    with pytest.warns(xcg.SceneWarning, match=r"width=7 is larger than the scene, .* over 5:"):
        ds.cg.coarse_grain("density", axes="z", width=7.0)
    ds.cg.coarse_grain("density", axes="z", width=4.0)


@pytest.mark.parametrize(
    ("text", "factor"), [("0.5 d43", 0.5), ("0.5d43", 0.5), ("2 * d50", 2.0), ("dmax", 1.0)]
)
def test_lengths_are_multiples_of_sizes(text, factor):
    ds = xcg.datasets.random_scene(60)
    length = factor * ds.attrs[text.split()[-1].lstrip("0.5")]
    by_size = ds.cg.explain("density", axes="z", width=text, spacing=text)
    by_number = ds.cg.explain("density", axes="z", width=length, spacing=length)
    assert by_size.kernel.width == by_number.kernel.width == pytest.approx(length, rel=1e-14)
    assert by_size.nodes.spacing == by_number.nodes.spacing
    with pytest.raises(ValueError, match=r"multiple of .* such as '0\.75 d43'"):
        ds.cg.coarse_grain("density", axes="z", width=1.0, spacing="0.5 d")


def test_widths_in_another_unit_warn():
    ds = xcg.datasets.simple_cubic(3)
    with pytest.warns(xcg.SceneWarning, match="check the unit of lengths"):
        ds.cg.coarse_grain("density", axes="z", width=1e3)
