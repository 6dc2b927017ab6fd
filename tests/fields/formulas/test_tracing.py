"""The algebra, traced and run by one loop, gives what the registry gives on arrays, to the bit."""

from itertools import product
from types import SimpleNamespace
from typing import get_args
from unittest import mock

import numpy as np
import pytest

import xcg
from xcg.compiled import program as kernel
from xcg.fields.formulas import algebra as symbols
from xcg.fields.formulas import registry, tracing
from xcg.fields.formulas.field import Gradient, Options, Temperature
from xcg.fields.formulas.registration import _made_up
from xcg.fields.formulas.rows import orientation

# scenes here hold no directors, and axes of tensors are found by NumPy, see test_orientation and test_rheology
OF_NUMPY = {*orientation.ROWS, "lode_angle", "stress_strain_rate_angle", "stress_fabric_angle"}
LISTED = [name for name in registry.listed() if name not in OF_NUMPY]
ALL = tuple(
    name for name in LISTED if not (registry.FIELDS[name].option or registry.FIELDS[name].paired)
)


def played_and_plain(ds, *fields, **options):
    """The same fields by the program, and by the registry on arrays; how often the program was run."""
    with mock.patch.object(kernel, "run", wraps=kernel.run) as run:
        played = ds.cg.coarse_grain(*fields, **options)
    with mock.patch("xcg.fields.evaluate.program_for", return_value=None):
        return played, ds.cg.coarse_grain(*fields, **options), run.call_count


def assert_same(played, plain):
    for name in plain:
        np.testing.assert_array_equal(played[name], plain[name], err_msg=name)


@pytest.mark.parametrize("options", [
    {}, {"gradient": "paper"}, {"axes": "xz", "at": {"y": 1.0}}, {"axes": "z"}, {"axes": ""},
    {"shear_dims": "xz", "pressure_dims": "z", "deviatoric": "both"}, {"deviatoric": "rate", "size": "d32"},
    {"size": "d50", "fluid_viscosity": 1e-3}, {"gradient": "kernel"}, {"by": "species"},
    {"by": "species", "gradient": "kernel", "axes": "yz"}, {"by": "species", "by_pair": True},
    {"by": "species", "width": {1: 0.4, 2: 0.7}, "axes": "xz"},
])  # fmt: skip
def test_a_program_gives_what_the_registry_gives(options):
    ds = xcg.datasets.random_scene(200, seed=21)
    played, plain, times = played_and_plain(ds, **{"width": 0.5, **options})
    assert times >= 1
    assert_same(played, plain)


@pytest.mark.parametrize(
    ("field", "fits"), [("density", None), ("velocity", None), ("granular_temperature", True)]
)
def test_code_of_the_fit_is_left_out_where_no_field_takes_it(field, fits):
    ds = xcg.datasets.random_scene(60, seed=1)
    with mock.patch.object(kernel, "run", wraps=kernel.run) as run:
        ds.cg.coarse_grain(field, width=0.6)
    assert {call.args[9] for call in run.call_args_list} == {fits}


@pytest.mark.parametrize("seed", range(12))
def test_programs_of_any_fields_in_any_order(seed):
    """Rows are used anew: each field must be stored before that, whatever else is asked for."""
    rng = np.random.default_rng(seed)
    names = rng.permutation(ALL)[: rng.integers(1, len(ALL) + 1)].tolist()
    assert_same(*played_and_plain(xcg.datasets.random_scene(60, seed=seed), names, width=0.6)[:2])


@pytest.mark.parametrize(
    "nodes", [1, 7, kernel.TILE - 1, kernel.TILE, kernel.TILE + 1, 3 * kernel.TILE]
)
def test_programs_on_any_number_of_nodes(nodes):
    ds = xcg.datasets.random_scene(60, seed=4)
    bounds = {"z": (0.0, 0.1 * (nodes - 1))}
    played, plain, _ = played_and_plain(ds, axes="z", width=0.6, spacing=0.1, bounds=bounds)
    assert played.sizes["z"] == nodes
    assert_same(played, plain)


def test_fits_by_eigenvectors_equal_those_of_the_loop():
    """Grains almost in a plane: neither clearly flat nor clearly spread."""
    ds = xcg.datasets.random_scene(200, seed=3)
    z = 1.0 + 1e-3 * (ds.position.isel(component=2) - 1.0)
    thin = ds.assign(position=ds.position.where(ds.component != "z", z))
    names = ["velocity_gradient", "granular_temperature"]
    options = {"width": 0.6}
    played, plain, _ = played_and_plain(thin, names, **options)
    assert_same(played, plain)
    with mock.patch.object(registry, "evaluate") as by_numpy:
        thin.cg.coarse_grain(names, **options)
    assert not by_numpy.called
    assert bool(np.isfinite(played.velocity_gradient).any())


def test_programs_of_a_static_scene_and_of_equal_grains():
    """Columns that are the same for all grains are multiples of their number, and have a factor of their own."""
    for ds in (xcg.datasets.simple_cubic(4), xcg.datasets.dense_packing(300)):
        assert_same(*played_and_plain(ds, width="0.9 d43")[:2])


def test_differences_between_nodes_are_left_to_the_registry():
    ds = xcg.datasets.random_scene(60, seed=5)
    assert played_and_plain(ds, width=0.6, gradient="finite_difference")[2] == 0


def test_phases_of_few_grains():
    """Fits of several phases take eigenvectors at the same nodes."""
    ds = xcg.datasets.random_scene(40, seed=6)
    ds["species"] = ("time", "particle"), np.arange(40)[None] % 8
    assert_same(*played_and_plain(ds, width=0.5, by="species")[:2])


def test_equal_operations_are_traced_once():
    record = symbols.Trace()
    a, b = record.load("momentum", np.arange(2))[0, 0]
    assert (a + b).number == (b + a).number
    assert (a - b).number != (b - a).number
    written = len(record.instructions)
    assert (a * b + 1.0).number != (a * b + 2.0).number
    assert len(record.instructions) == written + 5  # the product, two constants, two sums


def test_the_program_of_stress_has_no_superfluous_instructions():
    instructions = tracing.program_for(("stress",), Options()).instructions[:, 0]
    assert not np.isin(instructions, [kernel.FIT, kernel.SQUARE_ROOT]).any()
    # six kinetic components of symmetric tensors, not nine; each to nine of the contacts
    assert (instructions == kernel.ADD).sum() == 9
    assert (instructions == kernel.STORE).sum() == 1


@pytest.mark.parametrize("gradient", ["least_squares", "kernel", "paper"])
@pytest.mark.parametrize("groups", [0, 2])
def test_all_fields_of_the_registry_are_traced(gradient, groups):
    options = Options(gradient=gradient, fluid_viscosity=1e-3, friction=0.4)
    names = tuple(name for name in LISTED if groups or not registry.FIELDS[name].paired)
    # rotations take singular values, and follow from the deformation gradient when that is whole
    assert set(tracing.program_for(names, options, groups).widths) == set(names) - {
        "rotation",
        "rotation_vector",
    }


def test_negation_is_traced_to_the_bit():
    (a,) = symbols.Trace().load("mass", np.arange(1))[0, 0]
    kind, operands = a.record.instructions[(-a).number]
    assert kind == kernel.MULTIPLY
    assert (kernel.CONSTANT, (-1.0,)) in [a.record.instructions[k] for k in operands]


@pytest.mark.parametrize("operation", [
    np.exp, np.abs, np.isnan, np.nan_to_num, np.linalg.eigvalsh, np.linalg.norm, lambda x: x.sum(-1), lambda x: x @ x,
    lambda x: x**3, lambda x: x > 0, lambda x: x == x, lambda x: np.where(x > 0, x, 1.0), lambda x: np.maximum(x, 0.0),
    lambda x: x.astype(float), lambda x: np.einsum("...ij,...ij", x, x), lambda x: x.max(), float, sorted, abs,
])  # fmt: skip
def test_unknown_operations_on_symbols_raise(operation):
    """What is let through must give the bits of NumPy, which sums over axes in an order of its own."""
    x = symbols.Trace().load("contact", np.arange(9).reshape(3, 3))[0, 0]
    with pytest.raises((symbols.UnknownOperation, TypeError)):
        operation(x)


def test_symbols_have_no_truth_value_and_no_cubes():
    (a,) = symbols.Trace().load("mass", np.arange(1))[0, 0]
    with pytest.raises(TypeError, match="not known"):
        bool(a)
    with pytest.raises(NotImplementedError, match="only squares"):
        a**3


def test_loops_are_compiled_for_few_numbers_of_arrays():
    for count, padded in ((1, 8), (8, 8), (9, 32), (33, 128)):
        arrays = [np.full(3, k, float) for k in range(count)]
        tuples = kernel.as_tuple(arrays)
        assert len(tuples) == padded
        assert all(map(np.shares_memory, arrays, tuples))


def test_rows_list_exactly_the_inputs_of_their_formulas():
    """A formula runs on exactly the fields and moments that its row names; without any one of them it fails."""
    rows = {}
    needed = {}
    for gradient, deviatoric, temperature, friction, size in product(
        get_args(Gradient),
        ("stress", "rate"),
        (*get_args(Temperature), "mixture"),
        (None, 0.5),
        ("d43", "d32", "d50"),
    ):
        options = Options(
            gradient=gradient, deviatoric=deviatoric, temperature=temperature, friction=friction, size=size,
            diameter=1.0, shape=(5, 1, 1), spacing=(1.0, 0.0, 0.0), fluid_viscosity=1.0, by="species", lag=1,
        )  # fmt: skip
        names = tuple(
            name
            for name in registry._ROWS
            if friction is not None or registry.field_of(name, options).option != "friction"
        )
        for phases in (slice(0, 1), slice(None)):  # formulas may differ for the bulk alone
            if temperature == "mixture" and phases.stop:
                continue
            ordered = registry.fields_of(names, options)
            made_up = _made_up(registry.moments_of(ordered.values(), options))
            s = {name: a if name == "reference" else a[phases] for name, a in made_up.items()}
            f = registry.evaluate(tuple(ordered), s, options)
            for name in names:
                row = registry.field_of(name, options)
                rows[id(row)] = row
                taken = needed.setdefault(id(row), set())
                with np.errstate(all="ignore"):
                    row.compute(some(f, row.fields), some(s, (*row.moments, "reference")), options)
                    for need in {*row.fields, *row.moments} - taken:
                        fields, moments = (
                            [n for n in kind if n != need] for kind in (row.fields, row.moments)
                        )
                        try:
                            row.compute(some(f, fields), some(s, (*moments, "reference")), options)
                        except AttributeError:
                            taken.add(need)
    for key, row in rows.items():
        assert needed[key] == {*row.fields, *row.moments}, row.formula


def some(values, names):
    return SimpleNamespace(**{name: values[name] for name in names})
