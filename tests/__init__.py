"""Helpers shared by tests."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any
from unittest import mock

ROOT = Path(__file__).parents[1]


def real_data(name: str) -> Path:
    """Folder of real output of DEM codes that ships with the project."""
    folders = [ROOT / "tests" / "data" / name, ROOT / "examples" / "data" / name]
    return next(path for path in folders if path.exists())


@contextmanager
def planning(**replaced: Any) -> Iterator[None]:
    """Plan with other constants in `xcg.fields.plan`."""
    with mock.patch.multiple("xcg.fields.plan", **replaced):
        yield


@contextmanager
def sharing_threads(threads: int, worth: int = 0) -> Iterator[None]:
    """Let so many threads share steps of more visits of nodes than `worth`."""
    with (
        mock.patch("xcg.steps.analysis.THREADS", threads),
        mock.patch("xcg.fields.evaluate.WORTH_SHARING", worth),
    ):
        yield


@contextmanager
def raise_if_dask_computes() -> Iterator[None]:
    """Raise AssertionError where dask computes anything."""
    import dask

    def fail(*_: Any, **__: Any) -> None:
        raise AssertionError("dask computes")

    with dask.config.set(scheduler=fail):
        yield


@cache
def pyvista_draws() -> bool:
    """Whether PyVista is here and draws: VTK ends the process where there is neither a screen, EGL nor OSMesa."""
    code = "import pyvista as p; d = p.Plotter(off_screen=True); d.add_mesh(p.Sphere()); d.screenshot()"
    return (
        subprocess.run([sys.executable, "-c", code], capture_output=True, check=False).returncode
        == 0
    )
