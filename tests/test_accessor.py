"""The accessor shows what its functions take, offers what fits, and says what was meant."""

import gc
import inspect
import pydoc
import re
import weakref
from dataclasses import dataclass

import dask
import numpy as np
import pytest
import xarray as xr

import xcg
from xcg.accessor import CoarseGrainAccessor, Method
from xcg.explore.app import explore
from xcg.fields.coarse_grain import coarse_grain, explain
from xcg.fields.request import SharedOptions, arguments, takes
from xcg.writers import chains, view
from xcg.writers import paraview as vtu

METHODS = sorted(
    name for name, member in vars(CoarseGrainAccessor).items() if isinstance(member, Method)
)
# methods whose functions have no place at the top of the package
DEEPER = {
    "explain": explain, "to_csv": chains.to_csv, "to_vtp": chains.to_vtp,
    "to_vtu": vtu.to_vtu, "to_pyvista": view.to_pyvista, "view": view.view, "explore": explore,
}  # fmt: skip


@pytest.fixture(scope="module")
def scene():
    return xcg.datasets.random_scene(30, seed=1)


@pytest.mark.parametrize("name", METHODS)
def test_a_method_is_its_function(scene, name):
    function = DEEPER.get(name) or getattr(xcg, name)
    method = getattr(scene.cg, name)
    _, *parameters = inspect.signature(function).parameters.values()
    assert list(inspect.signature(method).parameters.values()) == parameters
    assert (
        inspect.signature(method).return_annotation == inspect.signature(function).return_annotation
    )
    assert method.__doc__ == function.__doc__
    assert inspect.getsource(method) == inspect.getsource(function)
    assert getattr(CoarseGrainAccessor, name) is function


@pytest.mark.parametrize("name", METHODS)
def test_every_argument_has_a_type_and_a_meaning(name):
    function = getattr(CoarseGrainAccessor, name)
    _, *parameters = inspect.signature(function).parameters.values()
    told = (
        inspect.cleandoc(function.__doc__)
        .partition("Parameters\n----------\n")[2]
        .partition("\n\n")[0]
    )
    entries = [line.split(" : ")[0] for line in told.splitlines() if not line.startswith(" ")]
    named = {word.strip() for entry in entries for word in entry.split(",")}
    for parameter in parameters:
        assert parameter.kind != parameter.VAR_POSITIONAL
        if parameter.kind == parameter.VAR_KEYWORD:  # for matplotlib
            assert f"**{parameter.name}" in told
            continue
        assert "Any" not in str(parameter.annotation)
        assert parameter.annotation is not parameter.empty
        assert not told or parameter.name in named


def test_help_is_complete(scene):
    text = pydoc.plain(pydoc.render_doc(scene.cg.coarse_grain))
    assert re.search(r"kernel: '[^']*\bKernel' = 'lucy'", text)
    assert "rtol: 'float' = 0.0" in text
    assert "Half-width w of the kernel (m)" in text
    assert "keeps it is taken, from 1e-4 on" in text
    assert "{arguments}" not in text


def test_all_coarse_graining_methods_share_options():
    shared = {field.name: field for field in arguments(SharedOptions)}
    assert inspect.signature(explain).parameters == inspect.signature(coarse_grain).parameters
    for function in (coarse_grain, explain, xcg.balance, xcg.width_sweep):
        parameters = inspect.signature(function).parameters
        assert [p.default for name, p in parameters.items() if name in shared] == [
            f.default for f in shared.values()
        ]
    assert coarse_grain.__annotations__["rtol"] is float  # types, where they are asked for


@dataclass(frozen=True, kw_only=True)
class Undocumented(SharedOptions):
    """Arguments of a function.

    Parameters
    ----------
    other : int
        Not the one.
    """

    one: int = 1


def test_each_argument_of_a_request_needs_a_meaning():
    def function(ds: xr.Dataset, asked: Undocumented) -> xr.Dataset:
        """Do something."""

    with pytest.raises(KeyError, match="one"):
        takes(Undocumented)(function)


def test_completion_offers_the_methods_of_each_kind(scene):
    fields = scene.cg.coarse_grain("density", width=1.0)
    found = scene.cg.force_chains()
    offered = {kind: {n for n in dir(ds.cg) if n in METHODS} for kind, ds in
               {"scene": scene, "fields": fields, "chains": found}.items()}  # fmt: skip
    assert offered["scene"] >= {"coarse_grain", "explain", "force_chains", "measure", "save"}
    correlations = {"spatial_correlation", "time_correlation"}
    pictures = {
        "plot",
        "plot_width",
        "plot_principal",
        "movie",
        "free_surface",
        "fit_slope",
        "fit_law",
    }
    shared = {"view", "to_pyvista", "save", "explore", "principal"}
    assert (
        offered["fields"]
        == {"coarsen", "compare", "profile", "time_average", "to_vtu"}
        | correlations
        | pictures
        | shared
    )
    assert offered["chains"] >= {
        "select_chains",
        "chain_table",
        "plot_rose",
        "to_csv",
        "to_vtp",
        "save",
    }
    assert not offered["scene"] & offered["chains"] - shared - {"plot_rose"}
    assert set.union(*offered.values()) == set(METHODS)
    assert "__repr__" in dir(scene.cg)


@pytest.mark.parametrize(
    ("method", "given", "message"),
    [
        (
            "coarse_grain",
            {"widht": 1.0},
            r"coarse_grain\(\) got an unexpected .* 'widht'; did you mean 'width'\?",
        ),
        ("explain", {"spacin": 1.0}, "did you mean 'spacing'"),
        (
            "width_sweep",
            {"widths": [1, 2, 3], "max_slop": 1.0},
            r"width_sweep\(\).*did you mean 'max_slope'",
        ),
        ("width_sweep", {}, r"width_sweep\(\).*'widths'"),
        ("balance", {"kernal": "lucy"}, "did you mean 'kernel'"),
        ("balance", {"fields": "density"}, "'fields'"),
        ("force_chains", {"alfa": 30.0}, r"force_chains\(\).*did you mean 'alpha'"),
        ("microstructure", {"rattler": "count"}, "did you mean 'rattlers'"),
        ("find_contacts", {"zzzz": 1}, "'zzzz'$"),
    ],
)
def test_misspelt_arguments_suggest_the_right_ones(scene, method, given, message):
    with pytest.raises(TypeError, match=message):
        getattr(scene.cg, method)(**given)


def test_too_many_arguments_raise(scene):
    with pytest.raises(TypeError, match=r"coarse_grain\(\).*too many positional"):
        scene.cg.coarse_grain("density", 1.0)


@pytest.mark.parametrize(
    ("method", "given", "message"),
    [
        (
            "coarse_grain",
            "densty",
            r"^unknown field 'densty'; did you mean 'density'\? Others are listed by xcg.FIELDS",
        ),
        ("explain", ["velocty", "density"], "did you mean 'velocity'"),
        (
            "microstructure",
            "mean_stres",
            "unknown quantity 'mean_stres'; did you mean 'mean_stress'",
        ),
    ],
)
def test_misspelt_names_suggest_the_right_ones(scene, method, given, message):
    with pytest.raises(ValueError, match=message):
        getattr(scene.cg, method)(given)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda ds: ds.cg.coarse_grain("principal"), r"f\.cg\.principal\('stress'\)"),
        (lambda ds: ds.cg.coarse_grain("eigenvalues"), r"f\.cg\.principal\('stress'\)"),
        (lambda ds: ds.cg.coarse_grain("lacey_index"), r"microstructure\(\['lacey_index'"),
        (lambda ds: ds.cg.coarse_grain("rdf"), r"radial_distribution\(r_max\)"),
        (lambda ds: ds.cg.coarse_grain("all"), "leave fields out"),
        (lambda ds: ds.cg.coarse_grain("velocity, stress"), r"a list, \['velocity', 'stress'\]"),
        (lambda ds: ds.cg.coarse_grain("density", kernel="tophat"), "did you mean 'heaviside'"),
        (lambda ds: ds.cg.coarse_grain("density", cutoff=1.0), r"kernel=xcg.Lucy\(cutoff=0.01\)"),
        (lambda ds: ds.cg.coarse_grain("density", walls=[]), "did you mean 'surfaces'"),
        (lambda ds: ds.cg.coarse_grain("density", nx=10), "did you mean 'spacing'"),
        (lambda ds: ds.cg.coarse_grain("density", periodic=True), r"given to xcg\.open_scene"),
        (lambda ds: ds.cg.principal("stress"), r"ds\.cg\.coarse_grain\('stress'\)\.cg\.principal"),
        (lambda ds: ds.cg.profile("z"), "this is a scene"),
        (lambda ds: ds.cg.microstructure("phi"), "did you mean 'volume_fraction'"),
        (lambda ds: ds.cg.select("species = 1"), "== compares"),
        (lambda ds: ds.cg.select("type == 1"), "did you mean 'species'"),
        (lambda ds: ds.cg.info, r"print\(ds\.cg\)"),
        (lambda ds: ds.cg.to_dataframe, r"ds\.to_dataframe, a method of xarray"),
        (lambda ds: ds.cg.mixing_index, r"microstructure\(\['lacey_index'"),
        (lambda ds: ds.cg.principal_stress, "did you mean 'principal'"),
        (lambda ds: ds.cg.strain, r"ds\.cg\.displacement\('strain'\)"),
        (lambda ds: ds.cg.rotate, r"frame=xcg\.Rotated"),
        (lambda ds: xcg.read_lammps, "did you mean 'open_scene'"),
        (lambda ds: xcg.scene_from_arrays(ds.position[0], dim=2), "did you mean dimension="),
    ],
)
def test_words_of_others_are_answered_with_the_call(scene, call, message):
    with pytest.raises((AttributeError, TypeError, ValueError), match=message):
        call(scene)


def test_misspelt_names_of_a_preset_suggest_the_right_ones(scene):
    with pytest.raises(ValueError, match="did you mean 'density_mixture'"):
        scene.cg.coarse_grain("density_mixtur", preset="pysammos", width=1.0)


def test_balance_refuses_presets_and_takes_bodies_and_skips(scene):
    with pytest.raises(ValueError, match="preset='pysammos'"):
        scene.cg.balance(preset="pysammos", width=1.0)
    options = {"width": 1.0, "spacing": 0.3, "axes": "z"}
    plain = scene.cg.balance(**options)
    same = scene.cg.balance(on_error="skip", **options)
    np.testing.assert_array_equal(plain.force_residual, same.force_residual)
    alone = scene.assign(body_id=scene.particle_id)
    of_bodies = alone.cg.balance(by_body="body_id", **options)
    np.testing.assert_allclose(of_bodies.force_residual, plain.force_residual, atol=1e-9)


PICTURES = {
    "plot": lambda f, fc, ds, **at: f.cg.plot("density", **at).images[0].get_array(),
    "to_pyvista": lambda f, fc, ds, **at: f.cg.to_pyvista(**at)["density"],
    "plot_chains": lambda f, fc, ds, **at: fc.cg.plot_chains(**at).collections[-1].get_array(),
    "plot_rose": lambda f, fc, ds, **at: [p.get_height() for p in fc.cg.plot_rose(**at).patches],
    "adjacency": lambda f, fc, ds, **at: ds.cg.adjacency(**at).toarray(),
    "contact_graph": lambda f, fc, ds, **at: sorted(ds.cg.contact_graph(**at).edges),
    "plot_phases": lambda f, fc, ds, **at: ds.cg.plot_phases(**at).axes[0].collections[0].get_offsets(),
}  # fmt: skip


@pytest.mark.parametrize("name", PICTURES)
def test_an_index_is_a_position_in_time_as_in_isel(name):
    plt = pytest.importorskip("matplotlib.pyplot")
    pytest.importorskip(
        {"to_pyvista": "pyvista", "contact_graph": "networkx"}.get(name, "matplotlib")
    )
    steps = [
        xcg.datasets.random_scene(60, seed=k, dimension=2).isel(contact=slice(50)) for k in range(3)
    ]
    ds = xr.concat(steps, "time", data_vars="all", combine_attrs="override")
    ds = ds.assign_coords(time=[0.0, 1.0, 2.0])
    ds = ds.cg.assign_phases(mapping={1: 1, 2: 2}, by="species")
    f = ds.cg.coarse_grain("density", width=1.0)
    fc = ds.cg.force_chains(alpha=80.0, min_length=2)

    def draw(*data, **at):
        picture = np.array(PICTURES[name](*data, **at))
        plt.close("all")
        return picture

    pictures = [draw(f, fc, ds, index=k) for k in range(3)]
    for k, picture in enumerate(pictures):
        one = draw(f.isel(time=k), fc.isel(time=k), ds.isel(time=k))
        np.testing.assert_array_equal(picture, one)
        np.testing.assert_array_equal(picture, draw(f, fc, ds, index=k - 3))
    assert not any(np.array_equal(pictures[0], picture) for picture in pictures[1:])
    np.testing.assert_array_equal(pictures[-1], draw(f, fc, ds))
    for index in (1, "first", None, 0.0):
        with pytest.raises(ValueError, match=re.escape(f"index={index!r}: expected the position")):
            draw(f.isel(time=0), fc.isel(time=0), ds.isel(time=0), index=index)


def test_completion_by_jedi(scene):
    jedi = pytest.importorskip("jedi")
    names = {c.name for c in jedi.Interpreter("ds.cg.", [{"ds": scene}]).complete()}
    assert {"coarse_grain", "explain"} <= names
    assert not {"to_csv", "profile"} & names
    (signature, *_) = jedi.Interpreter("ds.cg.coarse_grain(", [{"ds": scene}]).get_signatures()
    assert [p.name for p in signature.params] == list(
        inspect.signature(scene.cg.coarse_grain).parameters
    )
    assert [
        c.name for c in jedi.Interpreter("ds.cg.width_sweep(max_s", [{"ds": scene}]).complete()
    ] == ["max_slope="]


def test_the_accessor_keeps_no_dataset_alive():
    """Its arrays do not wait for Python to look for circles of references."""
    gc.disable()
    try:
        ds = xcg.datasets.random_scene(20)
        f = ds.cg.coarse_grain("density", axes="z")
        assert "density" in str(f.cg)
        held = [weakref.ref(ds), weakref.ref(f)]
        del ds, f
        assert [ref() for ref in held] == [None, None]
    finally:
        gc.enable()


@pytest.mark.parametrize("given", ["particles.dump", 3, xr.DataArray([1.0])])
def test_objects_that_are_no_scene_raise(given):
    with pytest.raises(
        TypeError,
        match=f"coarse_grain: expected a scene.*, not {type(given).__name__}; files are opened",
    ):
        xcg.coarse_grain(given)


@pytest.mark.parametrize("part", [
    lambda ds: ds.sel(component="x"), lambda ds: ds.isel(particle=0), lambda ds: ds.rename(particle="grain"),
    lambda ds: ds.isel(time=[]), lambda ds: ds.isel(component=[0, 1]),
])  # fmt: skip
def test_parts_of_scenes_have_a_summary(part):
    assert "scene" in repr(part(xcg.datasets.random_scene(20)).cg)


def test_a_summary_computes_nothing():
    ds = xcg.datasets.random_scene(20)
    lazy = xr.concat([ds, ds.assign_coords(time=ds.time + 1.0)], "time", data_vars="all").chunk(
        time=1
    )
    lazy.attrs = {k: v for k, v in lazy.attrs.items() if not k.startswith("box_")}
    with dask.config.set(scheduler=lambda *_, **__: pytest.fail("a summary computes")):
        assert "changes with time" in repr(lazy.cg)
