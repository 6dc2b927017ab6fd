"""Packages that not everyone needs: imported when they are used, with an error that says what to install."""

from __future__ import annotations

import importlib
from typing import Any


def extra(module: str, name: str, purpose: str) -> Any:
    """Import a module of an optional package.

    Parameters
    ----------
    module : str
        What to import, for example ``matplotlib.pyplot``.
    name : str
        The extra of xcg that holds its package (``project.optional-dependencies`` in pyproject.toml).
    purpose : str
        What it is needed for, as the subject of a sentence.

    Raises
    ------
    ImportError
        If it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        msg = f"{purpose} needs {error.name or module}, which is not installed: pip install 'xcg[{name}]'"
        raise ImportError(msg, name=error.name) from error
