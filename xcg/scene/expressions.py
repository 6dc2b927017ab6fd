"""Conditions and arithmetic of variables, written as text: parsed here, and never run as Python."""

from __future__ import annotations

import ast
import operator
import re
from collections.abc import Callable, Mapping
from functools import reduce
from itertools import pairwise
from types import MappingProxyType
from typing import Any

import numpy as np

FUNCTIONS: Mapping[str, np.ufunc] = MappingProxyType(
    {
        "abs": np.abs,
        "sqrt": np.sqrt,
        "exp": np.exp,
        "log": np.log,
        "sin": np.sin,
        "cos": np.cos,
        "tan": np.tan,
        "arctan2": np.arctan2,
        "hypot": np.hypot,
        "minimum": np.minimum,
        "maximum": np.maximum,
        "floor": np.floor,
        "isfinite": np.isfinite,
        "isnan": np.isnan,
    }
)
_OPERATORS: Mapping[type[ast.AST], Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.Pow: operator.pow,
    ast.BitAnd: operator.and_,
    ast.BitOr: operator.or_,
    ast.And: operator.and_,
    ast.Or: operator.or_,
    ast.UAdd: operator.pos,
    ast.USub: operator.neg,
    ast.Invert: np.logical_not,
    ast.Not: np.logical_not,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}
_ASSIGNMENT = re.compile(r"(?<![<>=!:])=(?!=)")
_LONGEST = 60  # letters of a part in a message


def evaluate(expression: str, variables: Mapping[str, Any]) -> Any:
    """Return the value of an expression of variables.

    Expressions hold names, numbers, comparisons, ``and or not``, arithmetic, and calls of
    `FUNCTIONS`. The text is parsed, and only these parts are computed.

    Parameters
    ----------
    expression : str
        Such as ``"z > 0.1 and hypot(x, y) < 2"``.
    variables : mapping
        Arrays by name.

    Raises
    ------
    NameError
        If a name is not among `variables`.
    SyntaxError
        If the text is not an expression, or has other parts.
    """
    try:
        return _value(_parsed(expression), variables)
    except (MemoryError, RecursionError):
        # of the parser, for deeply nested brackets and very long sums
        raise SyntaxError("it has too many parts within each other") from None


def _parsed(expression: str) -> ast.expr:
    try:
        return ast.parse(expression.strip(), mode="eval").body
    except SyntaxError:
        if _ASSIGNMENT.search(expression):
            raise SyntaxError("= assigns, and == compares") from None
        raise


def _value(node: ast.expr, variables: Mapping[str, Any]) -> Any:
    """Return the value of one part of an expression."""
    match node:
        case ast.Name(name):
            if name not in variables:
                raise NameError(f"name {name!r} is not defined", name=name)
            return variables[name]
        case ast.Constant(number) if type(number) in (int, float):
            return number
        case ast.UnaryOp(sign, operand):
            return _OPERATORS[type(sign)](_value(operand, variables))
        case ast.BinOp(left, sign, right) if type(sign) in _OPERATORS:
            base = _value(left, variables)
            if isinstance(sign, ast.Pow):
                # powers of whole numbers overflow or never end
                base = base * 1.0
            return _OPERATORS[type(sign)](base, _value(right, variables))
        case ast.BoolOp(word, operands):
            values = [_value(operand, variables) for operand in operands]
            return reduce(_OPERATORS[type(word)], values)
        case ast.Compare(left, signs, others) if all(type(sign) in _OPERATORS for sign in signs):
            values = [_value(part, variables) for part in (left, *others)]
            compared = [
                _OPERATORS[type(sign)](*ends)
                for sign, ends in zip(signs, pairwise(values), strict=True)
            ]
            return reduce(operator.and_, compared)
        case ast.Call(ast.Name(name), arguments, []) if name in FUNCTIONS:
            function = FUNCTIONS[name]
            # NumPy would write to one argument more
            if len(arguments) != function.nin:
                raise SyntaxError(f"{name}() takes {function.nin} arguments, not {len(arguments)}")
            return function(*(_value(argument, variables) for argument in arguments))
    raise SyntaxError(
        f"{ast.unparse(node)[:_LONGEST]!r} is not allowed. Allowed are names, numbers, "
        f"comparisons, and, or, not, + - * / // % **, and the functions {', '.join(FUNCTIONS)}"
    )
