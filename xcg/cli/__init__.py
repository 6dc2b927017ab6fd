"""The command ``xcg``."""

from xcg.cli.commands import main

__all__ = ["main"]
