"""Texts and other things in the place of numbers are refused by a message that names the argument."""

from fractions import Fraction
from typing import get_args

import numpy as np
import pytest

import xcg
from tests import ROOT
from xcg.common.checks import (
    FINITE,
    NOT_NEGATIVE,
    POSITIVE,
    above,
    between,
    check,
    floats,
    is_finite,
    is_positive,
    is_whole,
    whole,
)
from xcg.fields.coarse_grain import PRESETS
from xcg.fields.formulas.field import (
    WEIGHTS,
    Deviatoric,
    Gradient,
    InertialSize,
    Options,
    Temperature,
    Weight,
)
from xcg.fields.formulas.registry import WAYS
from xcg.fields.request import Per, Preset
from xcg.fields.sums.kernels import KernelName
from xcg.steps.faults import OnError

DUMP = ROOT / "examples/data/lammps_chute/particles.00050000.dump.gz"


@pytest.fixture(scope="module")
def scene():
    return xcg.datasets.random_scene(30)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"axes": "xz", "at": {"y": "0.1"}}, r"at\['y'\]='0.1': expected a finite length \(m\)"),
        ({"bounds": {"x": ("0", "1")}}, r"bounds\['x'\]=\('0', '1'\): expected \(first, last\)"),
        ({"bounds": {"x": 1.0}}, r"bounds\['x'\]=1.0: expected \(first, last\)"),
        ({"spacing": "0.1"}, "spacing='0.1': expected a length in metres or a multiple of d43"),
        (
            {"spacing": {"x": "a", "y": 1.0, "z": 1.0}},
            r"spacing\['x'\]='a': expected a length in metres or a multiple of d43",
        ),
        ({"rtol": "0.001"}, "rtol='0.001': expected a finite number of at least 0, such as 1e-3"),
        ({"axes": 3}, "axes=3: expected any of 'xyz'"),
        ({"fields": 3}, "unknown field 3"),
        ({"fields": []}, r"fields=\[\]: expected at least one"),
        ({"groups": [1]}, r"groups=\[1\] are the values of .* say which with by="),
        (
            {"axes": "z", "extent": {"x": "1", "y": 1.0}},
            r"extent\['x'\]='1': expected a positive length",
        ),
        ({"width": True}, "width=True: expected a positive length"),
        ({"friction": "0.5"}, "friction='0.5': expected a finite number of at least 0"),
    ],
)
def test_wrong_arguments_of_coarse_grain_are_named(scene, options, match):
    with pytest.raises(ValueError, match=match):
        scene.cg.coarse_grain(**{"fields": "density", **options})


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (
            lambda ds: ds.cg.force_chains(alpha="45"),
            "alpha='45': expected a number .degrees. above 0",
        ),
        (
            lambda ds: ds.cg.force_chains(min_stress=[1.0]),
            r"min_stress=\[1.0\]: expected a finite stress",
        ),
        (lambda ds: ds.cg.force_chains(min_length="3"), "min_length='3': expected a whole number"),
        (lambda ds: ds.cg.find_phases(max_phases="2"), "max_phases='2': expected a whole number"),
        (lambda ds: ds.cg.assign_phases(edges=["a"]), r"edges=\['a'\]: expected diameters"),
        (
            lambda ds: ds.cg.coarse_grain("density").cg.time_average(window="2"),
            "window='2': expected a whole number from 1 to",
        ),
        (
            lambda ds: ds.cg.slice_temperature("z", bounds=("a", 1)),
            r"^bounds=\('a', 1\): expected \(first, last\)",
        ),
        (
            lambda ds: ds.cg.slice_temperature("z", spacing="a"),
            "spacing='a': expected a positive length",
        ),
        (
            lambda ds: ds.cg.slice_temperature("z", width="a"),
            "^width='a': expected a positive length",
        ),
        (lambda ds: xcg.Sphere((0, 0, 0), "1"), "radius='1': expected a positive length"),
        (lambda ds: xcg.Rotated(z=("0", 0, 1)), r"z=\('0', 0, 1\): expected three finite numbers"),
        (lambda ds: xcg.Gaussian("0.5"), "width='0.5': expected a positive length"),
        (lambda ds: xcg.Lucy(cutoff=True), "cutoff=True: expected a positive length"),
        (lambda ds: xcg.Rotated(z="up"), "z='up': expected three finite numbers"),
        (
            lambda ds: xcg.Cylindrical(axis=("a", 0, 0)),
            r"axis=\('a', 0, 0\): expected three finite numbers",
        ),
        (lambda ds: xcg.Cylindrical(error="small"), "error='small': expected a positive number"),
        (
            lambda ds: xcg.Plane(point=("a", 0, 0), normal=(0, 0, 1)),
            r"point=\('a', 0, 0\): expected three finite",
        ),
    ],
)
def test_wrong_arguments_of_other_calls_are_named(scene, call, match):
    with pytest.raises(ValueError, match=match):
        call(scene)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"density": "2500"}, "density='2500': expected a positive number"),
        ({"thickness": "a"}, "thickness='a': expected a positive number"),
        ({"gravity": "down"}, r"gravity='down': expected three finite numbers \(x, y, z\)"),
        (
            {"gravity": ["a", 0, 0]},
            r"gravity=\['a', 0, 0\]: expected three finite numbers \(x, y, z\)",
        ),
        ({"box": [["a", 1]] * 3}, "box has shape .*: expected six numbers"),
        ({"box": {"x": ("a", "b")}}, "box has shape .*: expected six numbers"),
        ({"units": {"length": "mm"}}, r"units=\{'length': 'mm'\}: expected positive factors"),
        ({"lattice": {"xy": "a"}}, r"lattice\['xy'\]=.*: expected a finite number"),
        ({"times": ["soon"]}, "'soon' is neither a number nor a date"),
        ({"frozen": "wall"}, "frozen='wall': expected the number of a species"),
        ({"timestep": "a"}, "timestep='a': expected a positive number"),
    ],
)
def test_wrong_arguments_of_open_scene_are_named(options, match):
    with pytest.raises(ValueError, match=match):
        xcg.open_scene(DUMP, **options)


def test_messages_print_numbers_as_written():
    given = {"position": np.eye(3), "diameter": np.ones(3), "density": 1.0}
    for options, match in (
        ({"diameter": np.array([1, -0.5, 1])}, "'diameter' of particle 1 is -0.5; expected"),
        ({"particle_id": np.array([0, 1.5, 2])}, "row 1 is 1.5$"),
        (
            {"position": [np.eye(3)] * 2, "diameter": np.ones((2, 3)), "time": [1.0, 0.5]},
            r"and 0.5 follows 1.0 at index 1",
        ),
    ):
        with pytest.raises(xcg.SceneError, match=match):
            xcg.scene_from_arrays(**(given | options))


def test_numbers_are_distinguished_from_text_and_booleans():
    for number in (2, 2.0, np.float32(2), np.array(2), Fraction(2), True + 1):
        assert is_whole(number, 1, 2)
        assert not is_whole(number, 3)
        assert is_positive(number)
    for other in (
        "2",
        b"2",
        None,
        [2.0],
        np.array(["2"]),
        {"x": 2},
        2j,
        object(),
        "abc",
        np.nan,
        np.inf,
        10**400,
    ):
        assert not is_finite(other)
    for other in (True, np.False_, np.array(True)):
        assert not is_finite(other)
        assert not is_whole(other, 0)
    assert not is_whole(2.5, 1)
    assert not is_positive(0.0)
    np.testing.assert_array_equal(floats([1, 2.5]), [1.0, 2.5])
    for other in ([1, "2"], [[1], [2, 3]], ["a"], np.array([1, "2"], object)):
        assert floats(other).ndim == 0
        assert np.isnan(floats(other))


def test_friction_is_ignored_by_fields_that_do_not_use_it(scene):
    given = scene.cg.coarse_grain("density", friction=0.5)
    np.testing.assert_array_equal(given.density, scene.cg.coarse_grain("density").density)


def test_choices_in_annotations_are_the_valid_ones():
    """Each list of choices is a Literal; tables that a choice is looked up in have a row for each."""
    ways = {option: set[str]() for option in ("gradient", "size", "temperature")}
    for option, rows in WAYS.values():
        ways.get(option, set()).update(rows)
    for option, known in (
        ("gradient", Gradient),
        ("size", InertialSize),
        ("temperature", Temperature),
    ):
        assert getattr(Options(), option) == get_args(known)[0]
        # phases choose the temperature of a mixture by themselves
        assert ways[option] - {"mixture"} == set(get_args(known)[1:])
    assert set(PRESETS) == set(get_args(Preset))
    assert set(WEIGHTS) == set(get_args(Weight))
    for name in get_args(KernelName):
        assert (
            xcg.datasets.simple_cubic(3)
            .cg.coarse_grain("density", axes="z", kernel=name)
            .density.notnull()
            .all()
        )


@pytest.mark.parametrize(("name", "choices"), [
    ("gradient", Gradient), ("deviatoric", Deviatoric), ("size", InertialSize), ("temperature", Temperature),
    ("preset", Preset), ("per", Per), ("on_error", OnError),
])  # fmt: skip
def test_a_wrong_choice_lists_the_valid_ones(name, choices):
    with pytest.raises(
        ValueError, match="(?s)" + ".*".join((f"{name}='other'", *get_args(choices)))
    ):
        xcg.datasets.simple_cubic(3).cg.coarse_grain("density", axes="z", **{name: "other"})


@pytest.mark.parametrize(
    ("kind", "taken", "others", "expected"),
    [
        (
            FINITE,
            [0, -1.5, np.float32(2)],
            [np.nan, np.inf, "1", True, [1.0]],
            "a finite length (m)",
        ),
        (POSITIVE, [1, 1e-300], [0.0, -1, np.inf], "a positive length (m)"),
        (NOT_NEGATIVE, [0.0, 3], [-1e-300, np.inf], "a finite length (m) of at least 0"),
        (whole(2), [2, 3.0, 10**30], [1, 2.5, None], "a whole length (m) of at least 2"),
        (whole(1, 3), [1, 3], [0, 4], "a whole length (m) from 1 to 3"),
        (above(0, 90), [1e-9, 90], [0, 91, "45"], "a length (m) above 0 and up to 90"),
        (between(0, 1), [0.5], [0, 1, np.nan], "a length (m) between 0 and 1"),
    ],
)
def test_kinds_of_numbers_take_what_their_words_say(kind, taken, others, expected):
    for value in taken:
        check("edge", value, kind, "m")
    for value in others:
        with pytest.raises(ValueError, match=r"^edge=") as raised:
            check("edge", value, kind, "m", hint="; see the docs")
        assert str(raised.value) == f"edge={value!r}: expected {expected}; see the docs"


def test_none_passes_only_where_it_is_optional():
    check("edge", None, POSITIVE, optional=True)
    with pytest.raises(ValueError, match=r"edge=None: expected a positive number$"):
        check("edge", None, POSITIVE)
    with pytest.raises(ValueError, match=r"edge=0: expected a positive number, or None$"):
        check("edge", 0, POSITIVE, optional=True)
