"""The command ``python -m xcg.cli``."""

from xcg.cli import main

main(prog_name="xcg")
