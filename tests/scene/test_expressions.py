"""Expressions compute what Python's arithmetic does, and nothing else is run."""

import operator

import numpy as np
import pytest

import xcg
from xcg.scene.expressions import FUNCTIONS, evaluate

X = np.array([-1.5, 0.0, 2.0, 7.0])
Y = np.array([3, 2, 1, 0])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1 < x <= 2 < 3", (X > 1) & (X <= 2)),
        ("x > 0 and y > 0 or x < -1", ((X > 0) & (Y > 0)) | (X < -1)),
        ("not x > 0", X <= 0),
        ("~(x > 0) | (y == 0) & (x != 7)", X <= 0),
        ("-x + 2 * y - x / 4", -X + 2 * Y - X / 4),
        ("+x // 2 % 3", X // 2 % 3),
        ("2 ** -1 * x ** 2", X**2 / 2),
        (" hypot(x, 2) ", np.hypot(X, 2)),
        ("minimum(abs(x), maximum(y, 1.5))", np.minimum(abs(X), np.maximum(Y, 1.5))),
        ("isnan(x) or x >= 2", X >= 2),
    ],
)
def test_expressions_equal_numpy(text, expected):
    np.testing.assert_array_equal(evaluate(text, {"x": X, "y": Y}), expected)


def test_functions_are_those_of_numpy():
    for name, function in FUNCTIONS.items():
        arguments = ("y + 1", "y + 2")[: function.nin]
        result = evaluate(f"{name}({', '.join(arguments)})", {"y": Y})
        np.testing.assert_array_equal(
            result, getattr(np, name)(Y + 1, *[Y + 2][: function.nin - 1])
        )


class _Trap:
    """Fails at whatever is done with it."""

    def __getattribute__(self, name):
        raise AssertionError(f"{name} was taken")

    def __getitem__(self, key):
        raise AssertionError("an item was taken")

    def __call__(self, *arguments):
        raise AssertionError("it was called")

    def __iter__(self):
        raise AssertionError("it was iterated")


@pytest.mark.parametrize(
    "text",
    [
        "x.to_netcdf('f')", "x.__class__", "x()", "x[0]", "x[0:1]", "x.T[0]", "print(x)", "open('f', 'w')",
        "__import__('os')", "np.sqrt(x)", "(lambda: x)()", "lambda: x", "f'{x}'", "f'{x!r}'", "'a'", "b'a'",
        "[x]", "(x, x)", "{x}", "{1: x}", "[a for a in x]", "{a for a in x}", "(a for a in x)", "(a := x)",
        "abs(x=x)", "abs(*x)", "abs(**x)", "abs()", "minimum(x, x, x)", "sqrt(1, x)", "FUNCTIONS(x)", "x if x else x",
        "x in x", "x is x", "x @ x", "1 << 9", "9 >> 1", "1 ^ 2", "1j", "True", "None", "...", "await x", "*x",
        "x = 1", "del x", "import os", "x; x", "x\nx", "", "x >", "yield x", "x\\",
    ],
)  # fmt: skip
def test_other_parts_are_errors_and_are_not_run(text):
    with pytest.raises(SyntaxError):
        evaluate(text, {"x": _Trap()})


@pytest.mark.parametrize(
    "text", ["9**9**9**9 > x", "(9**9)**(9**9) > x", "2**5000 > x", "1 / 0 > x"]
)
def test_numbers_without_end_are_errors(text):
    with pytest.raises(ArithmeticError):
        evaluate(text, {"x": X})


@pytest.mark.parametrize(
    "text", ["(" * 5000 + "x" + ")" * 5000, "-" * 9999 + "x", "+".join("x" * 99999)]
)
def test_deep_expressions_are_errors(text):
    with pytest.raises(SyntaxError):
        evaluate(text, {"x": X})


def test_an_argument_too_many_does_not_write_to_a_variable():
    kept = X.copy()
    with pytest.raises(SyntaxError, match=r"minimum\(\) takes 2 arguments, not 3"):
        evaluate("minimum(x, y, x)", {"x": X, "y": Y})
    np.testing.assert_array_equal(X, kept)


def test_a_selection_writes_no_file_and_names_the_part(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ds = xcg.datasets.random_scene(9)
    message = (
        r"\"z\.to_netcdf\('f'\)\" is not allowed\. Allowed are names, numbers.*functions abs, sqrt"
    )
    with pytest.raises(ValueError, match=message):
        ds.cg.select("1 < z.to_netcdf('f')")
    assert not list(tmp_path.iterdir())


def test_signs_are_those_of_operator():
    for sign, function in {"<": operator.lt, ">": operator.gt, "==": operator.eq}.items():
        np.testing.assert_array_equal(evaluate(f"x {sign} 2", {"x": X}), function(X, 2))
