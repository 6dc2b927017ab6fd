"""One traceback, one error: no error of a call has an internal one as its context."""

import inspect
import warnings

import pytest

import xcg
from xcg.accessor import CoarseGrainAccessor, Method

plt = pytest.importorskip("matplotlib.pyplot")
WRONG = ["nonsense", -3.5, {"nonsense": 1}, ["nonsense"]]
FREE = {"args", "kwargs", "options", "ax", "title", "mapping", "scheme"}


def scene():
    return xcg.datasets.random_scene(30, seed=1)


KINDS = {
    "scene": scene,
    "result": lambda: scene().cg.coarse_grain(
        ["density", "velocity"], axes="xz", width=1.0, spacing=1.0
    ),
    "chains": lambda: scene().cg.force_chains(),
}
METHODS = [
    (kind, name)
    for name, method in vars(CoarseGrainAccessor).items()
    if isinstance(method, Method)
    for kind in method.kinds
    if not name.startswith(("plot", "movie", "save", "to_"))
]


def internal(error: BaseException) -> BaseException | None:
    """Return the error that a reader of the traceback sees above this one without being told why."""
    while error is not None:
        if (
            error.__context__ is not None
            and not error.__suppress_context__
            and error.__cause__ is None
        ):
            return error.__context__
        error = error.__cause__
    return None


def _internal_error(method, arguments):
    try:
        method(**arguments)
    except Exception as error:
        return internal(error)
    return None


@pytest.mark.parametrize("lazy", [False, True], ids=["eager", "lazy"])
@pytest.mark.parametrize(("kind", "name"), METHODS)
def test_wrong_arguments_raise_an_error_without_a_context(kind, name, lazy):
    ds = KINDS[kind]()
    ds = ds.chunk(time=1) if lazy else ds
    method = getattr(ds.cg, name)
    for parameter in inspect.signature(method).parameters.values():
        if parameter.name in FREE or parameter.kind in (
            parameter.VAR_POSITIONAL,
            parameter.VAR_KEYWORD,
        ):
            continue
        for wrong in WRONG:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                above = _internal_error(method, {parameter.name: wrong})
            assert above is None, f"{name}({parameter.name}={wrong!r}): {above!r}"


# what draws or writes, and what it needs besides one wrong argument
SHOWN = {
    "plot": {"name": "density"},
    "movie": {"name": "density", "path": "f.gif"},
    "plot_chains": {}, "plot_lengths": {}, "plot_rose": {}, "plot_phases": {},
    "save": {"path": "f.nc"},
    "to_vtkhdf": {"path": "f.vtkhdf"},
    "to_vtu": {"path": "f.vtu", "mesh": "none.vtu"},
    "to_csv": {"path": "f.csv"},
    "to_vtp": {"path": "f.vtp"},
}  # fmt: skip


@pytest.mark.parametrize("name", SHOWN)
def test_wrong_arguments_of_plots_and_writers_raise_an_error_without_a_context(
    name, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    method = vars(CoarseGrainAccessor)[name]
    for kind in method.kinds:
        ds = KINDS[kind]()
        bound = getattr(ds.cg, name)
        parameters = inspect.signature(bound).parameters
        needed = {key: value for key, value in SHOWN[name].items() if key in parameters}
        for parameter in set(parameters) - {"progress", "fps"}:
            for wrong in WRONG:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    above = _internal_error(bound, needed | {parameter: wrong})
                    plt.close("all")
                assert above is None, f"{name}({parameter}={wrong!r}): {above!r}"


# what functions of the package that take no scene need besides one wrong argument
NEEDED = {
    "scene_from_arrays": {
        "position": [[0.0, 0, 0], [1, 0, 0]],
        "diameter": [1.0, 1.0],
        "density": 1.0,
    },
    "scene_from_table": {
        "particles": {"x": [0.0], "y": [0.0], "z": [0.0], "radius": [0.5], "time": [0.0]}
    },
    "open_scene": {"particles": "nowhere.*.dump"},
    "find_pairs": {"position": [[0.0, 0, 0], [1, 0, 0]], "radius": [0.6, 0.6]},
    "mesh_points": {"path": "nowhere.vtu"},
    "register_field": {"name": "mine", "compute": lambda: None, "fields": "density"},
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


@pytest.mark.parametrize("name", NEEDED)
def test_wrong_arguments_of_other_functions_raise_an_error_without_a_context(name):
    function, needed = getattr(xcg, name), NEEDED[name]
    for parameter in inspect.signature(function).parameters:
        if parameter in FREE:
            continue
        for wrong in WRONG:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                above = _internal_error(function, needed | {parameter: wrong})
            assert above is None, f"{name}({parameter}={wrong!r}): {above!r}"


def test_a_misspelt_field_of_a_lazy_scene_has_no_context():
    with pytest.raises(ValueError, match="did you mean 'velocity'") as caught:
        scene().chunk(time=1).cg.coarse_grain("velocty")
    assert caught.value.__context__ is None
