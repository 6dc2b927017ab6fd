"""Helpers shared by tests."""

from __future__ import annotations

from pathlib import Path

import pytest


def shared_data(name: str) -> Path:
    """Folder of real output beside the repository; the test is skipped where it is absent."""
    path = Path(__file__).parents[2] / "shared" / "data" / name
    if not path.exists():
        pytest.skip(f"needs the shared data '{name}'")
    return path
