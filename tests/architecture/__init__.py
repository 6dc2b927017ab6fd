"""The package as syntax trees, parsed once."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

from tests import ROOT

PACKAGE = ROOT / "xcg"


def nodes_of_package(ending: str = "") -> dict[Path, list[ast.AST]]:
    """Return all nodes of each module, or of those with an ending; of stubs (.pyi), too, by default."""
    return {path: nodes for path, nodes in _parsed().items() if not ending or path.suffix == ending}


@cache
def _parsed() -> dict[Path, list[ast.AST]]:
    paths = sorted([*PACKAGE.rglob("*.py"), *PACKAGE.rglob("*.pyi")])
    return {path: list(ast.walk(ast.parse(path.read_text()))) for path in paths}
