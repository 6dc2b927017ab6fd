"""Wrong arguments: one traceback with one error, which names the argument or its value.

An argument is tried once for each parser: arguments of one name and annotation are read by the same
lines.
"""

import inspect
import warnings
from typing import NamedTuple

import pytest
import xarray as xr

import xcg
from tests import dumps, pyvista_draws
from xcg.accessor import CoarseGrainAccessor, Method

plt = pytest.importorskip("matplotlib.pyplot")
WRONG = ["nonsense", -3.5, {"nonsense": 1}, ["nonsense"]]
# passed on to other packages, or free text
FREE = {"args", "kwargs", "options", "ax", "title", "mapping", "scheme", "progress", "fps", "name"}


def scene():
    one = xcg.datasets.random_scene(30, seed=1)
    series = one.isel(time=[0, 0, 0]).assign_coords(time=[0.0, 1.0, 2.0], step=("time", [0, 1, 2]))
    rows = xr.ones_like(series.diameter)
    return series.assign({f"quat_{letter}": rows for letter in "wxyz"}).cg.assign_phases(
        edges=[1.0]
    )


def result():
    return scene().cg.coarse_grain(["density", "velocity"], axes="xz", width=1.0, spacing=1.0)


def chains():
    return xcg.datasets.random_scene(30, seed=1, dimension=2).cg.force_chains()


KINDS = {"scene": scene, "result": result, "chains": chains}
PLANE = xcg.Plane((0, 0, 0), (0, 0, 1))
# what a function needs besides one wrong argument
NEEDED = {
    "width_sweep": {"widths": [1.0, 2.0]},
    "choose_width": {"fields": "density"},
    "flow_rate": {"surface": PLANE},
    "free_surface": {"field": "density"},
    "wall_stress": {"surface": PLANE},
    "spatial_correlation": {"field": "density"},
    "time_correlation": {"field": "density"},
    "radial_distribution": {"r_max": 1.0},
    "structure_factor": {"k_max": 5.0},
    "assign_phases": {"edges": [1.0]},
    "plot": {"field": "density"},
    "movie": {"field": "density", "path": "f.gif"},
    "save": {"path": "f.nc"},
    "to_vtu": {"path": "f.vtu", "mesh": "none.vtu"},
    "to_csv": {"path": "f.csv"},
    "to_vtp": {"path": "f.vtp"},
    "scene_from_arrays": {
        "position": [[0.0, 0, 0], [1, 0, 0]],
        "diameter": [1.0, 1.0],
        "density": 1.0,
    },
    "scene_from_table": {
        "particles": {"x": [0.0], "y": [0.0], "z": [0.0], "radius": [0.5], "time": [0.0]}
    },
    "open_scene": {"particles": "p.*.dump"},
    "find_pairs": {"position": [[0.0, 0, 0], [1, 0, 0]], "radius": [0.6, 0.6]},
    "mesh_points": {"path": "nowhere.vtu"},
    "register_field": {"name": "mine", "compute": lambda f, s, o: f.density, "fields": "density"},
    "Plane": {"point": (0, 0, 0), "normal": (0, 0, 1)},
    "Cylinder": {"point": (0, 0, 0), "axis": (0, 0, 1), "radius": 1.0},
    "Rotated": {"z": (0, 0, 1)},
    "Cylindrical": {},
    "BoxRegion": {"lower": (0, 0, 0), "upper": (1, 1, 1)},
    "Sphere": {"centre": (0, 0, 0), "radius": 1.0},
    "Lucy": {"width": 1.0},
    "Gaussian": {"width": 1.0},
    "Heaviside": {"width": 1.0},
    "Mean": {"variable": "mass"},
}
# one of the values means something, or is looked at only when a scene is there
ACCEPTED = {
    ("Cylinder", "high"),
    ("Cylinder", "low"),
    ("Mean", "variable"),
    ("force_chains", "min_stress"),
    ("microstructure", "strain_rate"),
    ("open_scene", "names"),
    ("plot", "vmin"),
    ("register_field", "formula"),
    ("register_field", "long_name"),
    ("scene_from_arrays", "step"),
    ("scene_from_arrays", "time"),
    ("select_chains", "min_stress"),
    # to be checked
    ("find_pairs", "max_pairs"),
    ("view", "vmin"),
}
# arguments whose errors speak of something else: to be bettered
UNNAMED = {
    ("fit_law", "constants"),  # the result lacks what laws are fitted to
    ("fit_law", "guess"),
    ("scene_from_arrays", "step"),
    ("scene_from_table", "particles"),
    ("width_sweep", "widths"),
}
PYTHON = (TypeError, AttributeError, LookupError)


class Parser(NamedTuple):
    """An argument, and the first function that reads it."""

    kind: str | None  # of the Dataset; None for functions of the package
    function: str
    argument: str


def parsers():
    """Return each argument once, with the first function that takes it with the same annotation."""
    functions = [
        (kind, name, getattr(CoarseGrainAccessor, name))
        for name, method in vars(CoarseGrainAccessor).items()
        if isinstance(method, Method)
        for kind in method.kinds
    ]
    functions += [
        (None, name, getattr(xcg, name)) for name in NEEDED if name not in vars(CoarseGrainAccessor)
    ]
    first = {}
    for kind, name, function in functions:
        parameters = list(inspect.signature(function).parameters.values())
        for parameter in parameters if kind is None else parameters[1:]:
            variadic = parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD)
            # any value is true or false
            if (
                variadic
                or parameter.name in FREE
                or parameter.annotation in ("bool", "bool | None")
            ):
                continue
            key = parameter.name, str(parameter.annotation)
            first.setdefault(key, Parser(kind, name, parameter.name))
    return list(first.values())


PARSERS = parsers()


@pytest.fixture(scope="module")
def made():
    """One Dataset of each kind."""
    return {kind: make() for kind, make in KINDS.items()}


def internal(error: BaseException) -> BaseException | None:
    """Return the error that the traceback shows above this one without a reason."""
    while error is not None:
        if (
            error.__context__ is not None
            and not error.__suppress_context__
            and error.__cause__ is None
        ):
            return error.__context__
        error = error.__cause__
    return None


def error_of(parser, wrong, made):
    """Return the error of a call with one wrong argument; None if it is accepted."""
    target = xcg if parser.kind is None else made[parser.kind].cg
    function = getattr(target, parser.function)
    arguments = NEEDED.get(parser.function, {}) | {parser.argument: wrong}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            function(**arguments)
        except ImportError as error:
            pytest.skip(str(error))
        except Exception as error:
            return error
        finally:
            plt.close("all")
    return None


@pytest.mark.parametrize(
    "parser", PARSERS, ids=lambda parser: f"{parser.function}-{parser.argument}"
)
def test_wrong_arguments_raise_one_error_that_names_them(parser, made, tmp_path, monkeypatch):
    if parser.function == "view" and not pyvista_draws():
        pytest.skip("VTK finds no way to draw")
    monkeypatch.chdir(tmp_path)
    dumps.write_series(tmp_path, (0, 10))
    accepted = []
    unnamed = []
    for wrong in WRONG:
        error = error_of(parser, wrong, made)
        if error is None:
            accepted.append(wrong)
            continue
        assert internal(error) is None, f"{parser} {wrong!r}: {internal(error)!r}"
        message = str(error)
        named = any(word in message for word in (parser.argument, "nonsense", "-3.5"))
        # Python's own error is enough for a value of another type
        if not named and not isinstance(error, PYTHON):
            unnamed.append((wrong, message))
    place = parser.function, parser.argument
    assert bool(accepted) == (place in ACCEPTED), f"{parser} accepts {accepted}"
    assert bool(unnamed) == (place in UNNAMED), f"{parser}: {unnamed}"


def test_a_misspelt_field_of_a_lazy_scene_has_no_context():
    with pytest.raises(ValueError, match="did you mean 'velocity'") as caught:
        scene().chunk(time=1).cg.coarse_grain("velocty")
    assert caught.value.__context__ is None
