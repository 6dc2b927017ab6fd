"""Where names stand that are loaded when they are first used: read from the stub that tells it to editors."""

import ast
from pathlib import Path


def homes(module: str) -> dict[str, str]:
    """Names that the stub of a module imports, each with the module where it stands.

    Parameters
    ----------
    module : str
        The file of the module; its stub stands beside it.
    """
    stub = ast.parse(Path(module).with_suffix(".pyi").read_bytes())
    return {
        alias.name: node.module
        for node in stub.body
        if isinstance(node, ast.ImportFrom) and node.module
        for alias in node.names
    }
