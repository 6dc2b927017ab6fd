"""The command ``python -m xcg_start``."""

from xcg_start import main

main()
