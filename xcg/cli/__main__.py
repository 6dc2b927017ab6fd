"""The command ``python -m xcg.cli``."""

from xcg_start import main

main()
