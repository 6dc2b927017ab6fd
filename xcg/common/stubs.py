"""Stubs (.pyi) as tables: names are loaded at run time from the modules that editors read in stubs."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

_PACKAGE = Path(__file__).parents[1]


@cache  # the accessor reads its own again
def read_stub(name: str) -> list[ast.stmt]:
    """Return the statements of a stub of the package, such as "accessor.pyi"."""
    return ast.parse((_PACKAGE / name).read_text("utf-8")).body


def modules_of(stub: list[ast.stmt]) -> dict[str, str]:
    """Return the module of each name that a stub imports from the package; "" for a module itself."""
    modules = {}
    for node in stub:
        if isinstance(node, ast.ImportFrom) and node.level:
            for alias in node.names:
                modules[alias.name] = node.module or ""
    return modules


def public_names(stub: list[ast.stmt]) -> list[str]:
    """Return the names in the list ``__all__`` of a stub."""
    for node in stub:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return list(ast.literal_eval(node.value))
    return []
