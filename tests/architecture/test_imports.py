"""The rooms of the package stay apart, and the import stays light."""

import ast
import subprocess
import sys
from functools import cache

import pytest

from tests import ROOT
from tests.architecture import PACKAGE, nodes_of_package

# floors from the ground up; a room imports only from lower floors, so that the wings of one floor know nothing of each
# other
FLOORS = [
    ["compiled", "common"],
    ["scene"],
    ["steps"],
    ["fields", "readers"],
    ["analysis"],
    ["datasets", "writers"],
    ["explore"],
    ["accessor"],
    ["__init__"],
    ["jobs"],
    ["cli"],
]

# floors within the largest rooms
INSIDE = {
    "fields": [
        ["sums"],
        ["grids", "formulas"],
        ["request"],
        ["choice", "layout", "like"],
        ["plan"],
        ["pressures", "passes"],
        ["segments", "ring_means"],
        ["support"],
        ["advice"],
        ["evaluate"],
        ["accessible", "presets"],
        ["coarse_grain"],
        ["__init__"],
    ],
    "readers": [
        ["engine", "column_units"],
        ["names"],
        ["named_columns"],
        ["likely_names"],
        ["files", "cells", "caller_names"],
        ["filenames"],
        ["paths", "unread"],
        ["assigned", "recognise"],
        ["wall_columns"],
        ["report"],
        ["columns"],
        ["engines"],
        ["read_steps"],
        ["chunks"],
        ["order"],
        ["pairs"],
        ["saved"],
        ["arguments"],
        ["listing"],
        ["series_setup", "boxes"],
        ["ends", "series"],
        ["indexed", "lazy"],
        ["open"],
        ["backend", "from_table", "live"],
        ["__init__"],
    ],
}


def run(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


def test_compiled_loops_import_neither_xarray_nor_dask():
    code = """
import sys
for name in ("xarray", "dask", "pandas", "vtk"):
    sys.modules[name] = None
"""
    # importing xcg itself would pull xarray in, so its __init__ is left out
    stub = f"import sys, types; p = types.ModuleType('xcg'); p.__path__ = [{str(PACKAGE)!r}]; sys.modules['xcg'] = p\n"
    names = [f.stem for f in sorted((PACKAGE / "compiled").glob("[a-z]*.py"))]
    done = run(stub + code + "\n".join(f"import xcg.compiled.{n}" for n in names))
    assert names
    assert done.returncode == 0, done.stderr


# what a new process finds, in this order: each part loads more
FACTS = """
import sys, xcg
heavy = {"vtk", "vtkmodules", "matplotlib", "sklearn", "h5py", "click", "dask", "numba", "scipy"}
facts = {"heavy": heavy & set(sys.modules), "all": xcg.__all__, "dir": dir(xcg)}
import xarray as xr
facts["accessor"] = type(xr.Dataset().cg).__name__
xr.Dataset().cg.coarse_grain
facts["rooms"] = {m.split(".")[1] for m in sys.modules if m.startswith("xcg.")}
try:
    xcg.schema
except AttributeError as error:
    facts["error"] = str(error)
facts["missing"] = {name for name in xcg.__all__ if getattr(xcg, name, None) is None}
from xcg.accessor import CoarseGrainAccessor, Method
rows = vars(CoarseGrainAccessor).items()
facts["methods"] = {name: row.module for name, row in rows if isinstance(row, Method)}
print(facts)
"""


@cache
def facts():
    """Return what a new process finds when it imports the package."""
    done = run(FACTS)
    assert done.returncode == 0, done.stderr
    return eval(done.stdout)


def test_import_of_the_package_loads_no_heavy_library():
    assert facts()["heavy"] == set()


@pytest.mark.parametrize(
    ("folder", "floors"),
    [(PACKAGE, FLOORS), *((PACKAGE / room, floors) for room, floors in INSIDE.items())],
)
def test_all_rooms_and_modules_are_listed(folder, floors):
    found = {
        f.stem
        for f in folder.iterdir()
        if f.suffix == ".py" or (f.is_dir() and any(f.glob("*.py")))
    }
    assert found == {room for floor in floors for room in floor}


@cache
def _imports():
    """Return pairs (module, module that it imports), each as its path of names below xcg."""
    pairs = []
    for path, nodes in nodes_of_package().items():
        own = path.relative_to(PACKAGE).with_suffix("").parts
        for node in nodes:
            name = (node.module or "") if isinstance(node, ast.ImportFrom) else ""
            if isinstance(node, ast.ImportFrom) and node.level:  # in the stub of xcg alone
                name = f"xcg.{name}".strip(".")
            if isinstance(node, ast.ImportFrom) and name.split(".")[0] == "xcg":
                module = tuple(name.split(".")[1:])
                for alias in node.names:
                    deeper = (*module, alias.name)
                    is_module = (
                        PACKAGE.joinpath(*deeper).is_dir()
                        or PACKAGE.joinpath(*deeper).with_suffix(".py").exists()
                    )
                    pairs.append((own, deeper if is_module else module or ("__init__",)))
            elif isinstance(node, ast.Import) and any(alias.name == "xcg" for alias in node.names):
                pairs.append((own, ("__init__",)))
    return pairs


def _floor(room, floors):
    found = [k for k, floor in enumerate(floors) if room in floor]
    assert found, f"{room} stands on no floor: add it to the list of floors"
    return found[0]


def test_imports_only_go_down_and_wings_stay_apart():
    for own, target in _imports():
        floors = FLOORS
        if own[0] == target[0] in INSIDE and len(own) > 1 and len(target) > 1:
            own, target, floors = own[1:], target[1:], INSIDE[own[0]]
        if own[0] != target[0]:
            assert _floor(target[0], floors) < _floor(own[0], floors), (
                f"{'.'.join(own)} imports {'.'.join(target)}"
            )


def test_no_module_imports_itself_in_a_circle():
    graph = {}
    done = set()
    for own, target in _imports():
        graph.setdefault(own, set()).add(target)

    def visit(module, path):
        if module in path:
            pytest.fail(" -> ".join(".".join(m) for m in (*path[path.index(module) :], module)))
        if module not in done:
            for target in sorted(graph.get(module, ())):
                visit(target, (*path, module))
            done.add(module)

    for module in sorted(graph):
        visit(module, ())


# pairs of names that are not twins, in rooms that are still being joined
NOT_TWINS = {"contacts", "displacement", "lammps", "pairs"}
NAMED_TWICE: set[str] = set()


def test_modules_of_one_name_are_a_module_and_its_loops():
    homes = {}
    for path in PACKAGE.rglob("[a-z]*.py"):
        homes.setdefault(path.stem, []).append(path.parent.name)
    shared = {name: rooms for name, rooms in homes.items() if len(rooms) > 1}
    others = {name for name, rooms in shared.items() if len(rooms) > 2 or "compiled" not in rooms}
    assert others <= NOT_TWINS, {name: shared[name] for name in others - NOT_TWINS}


def test_classes_have_names_of_their_own():
    seen = set()
    twice = set()
    for nodes in nodes_of_package(".py").values():
        for node in nodes:
            if isinstance(node, ast.ClassDef):
                (twice if node.name in seen else seen).add(node.name)
    assert twice <= NAMED_TWICE, twice - NAMED_TWICE


def test_kernel_means_the_smoothing_function_alone():
    for path, nodes in nodes_of_package(".py").items():
        for node in nodes:
            if isinstance(node, ast.Import | ast.ImportFrom):
                assert "kernel" not in {alias.asname for alias in node.names}, path


def test_completion_shows_public_names_only():
    assert set(facts()["dir"]) == {*facts()["all"], "__version__"}


def test_names_are_imported_from_where_the_stubs_say():
    listed = []
    for file in ("__init__.pyi", "accessor.pyi"):
        for node in ast.parse((PACKAGE / file).read_text()).body:
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
                listed += ast.literal_eval(node.value)
    assert sorted(listed) == facts()["all"]
    assert len(listed) == len(set(listed))
    assert facts()["missing"] == set()


def test_unknown_names_raise_attribute_error():
    assert "module 'xcg' has no attribute 'schema'" in facts()["error"]


def test_every_dataset_has_the_accessor_once_the_package_is_imported():
    assert facts()["accessor"] == "CoarseGrainAccessor"


def test_a_method_loads_only_the_rooms_it_uses():
    rooms = facts()["rooms"]
    assert "fields" in rooms
    assert rooms.isdisjoint({"analysis", "readers", "writers", "datasets"})


def test_each_function_that_the_stub_imports_is_a_method_of_its_name():
    *_, accessor = (stub := ast.parse((PACKAGE / "accessor.pyi").read_text())).body
    functions = {}
    for node in stub.body:
        if isinstance(node, ast.ImportFrom) and node.level:
            for alias in node.names:
                functions[alias.name] = f"xcg.{node.module}"
    rows = [node for node in accessor.body if isinstance(node, ast.Assign)]
    assert [ast.unparse(row.targets[0]) for row in rows] == [
        ast.unparse(row.value.args[0]) for row in rows
    ]
    assert facts()["methods"] == functions != {}


# private names of other packages, which a new version may move
PRIVATE = {
    "numba.core": PACKAGE / "compiled" / "_jit.py",
    "xarray.core": PACKAGE / "common" / "compat.py",
}


def test_private_names_of_other_packages_are_in_one_module_each():
    files = nodes_of_package(".py")
    assert {*PRIVATE.values()} <= {*files}
    for file, nodes in files.items():
        for node in nodes:
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                names = [str(node.module)]
            for name in names:
                owner = PRIVATE.get(".".join(name.split(".")[:2]), file)
                assert owner == file, f"{file.name} imports {name}"
            reads_private = (
                isinstance(node, ast.Attribute)
                and node.attr == "_data"
                and ast.unparse(node.value) != "self"
            )
            assert not reads_private or file == PRIVATE["xarray.core"], f"{file}:{node.lineno}"


def test_scripts_of_pages_and_examples_import_no_test():
    for folder in ("docs", "examples"):
        for file in sorted((ROOT / folder).rglob("*.py")):
            for node in ast.walk(ast.parse(file.read_text())):
                name = str(node.module) if isinstance(node, ast.ImportFrom) else ""
                assert ".test_" not in name, f"{file} imports {name}"
