"""Frozen dataclasses: those with arrays are compared by identity, and the options of the algebra by their values."""

import ast
import pickle

import pytest

import xcg
from tests.architecture import PACKAGE, nodes_of_package
from xcg.fields.choice import requested_options
from xcg.fields.formulas.tracing import program_for
from xcg.fields.layout import kernels_of, nodes_of
from xcg.fields.request import Request
from xcg.scene.scene import Scene


def _with_arrays():
    for path, nodes in nodes_of_package(".py").items():
        for node in nodes:
            if not isinstance(node, ast.ClassDef):
                continue
            decorators = [ast.unparse(one) for one in node.decorator_list]
            types = [
                ast.unparse(one.annotation) for one in node.body if isinstance(one, ast.AnnAssign)
            ]
            arrays = any("NDArray" in one and "Callable" not in one for one in types)
            if arrays and any(one.startswith("dataclass") for one in decorators):
                yield f"{path.relative_to(PACKAGE)}: {node.name}", decorators


def test_dataclasses_that_hold_arrays_have_no_equality():
    """`==` of arrays is an array, so that comparing two of them would raise."""
    assert [
        name
        for name, decorators in _with_arrays()
        if not any("eq=False" in one for one in decorators)
    ] == []


@pytest.mark.parametrize("size", ["d43", "dmax"])
def test_options_equal_themselves_in_another_process(size):
    ds = xcg.datasets.simple_cubic(3)
    if size == "d43":
        ds = ds.drop_vars("diameter").drop_attrs(deep=False).assign_attrs(periodic="xyz")
    scene = Scene(ds)
    request = Request(size=size, width=1.0)
    nodes = nodes_of(scene, request, kernels_of(scene, request))
    options = requested_options(scene, request, nodes)
    assert (options.diameter is None) == (size == "d43")
    again = pickle.loads(pickle.dumps(options))
    assert again == options
    assert hash(again) == hash(options)
    assert program_for(("density",), again) is program_for(
        ("density",), options
    )  # traced once a process
