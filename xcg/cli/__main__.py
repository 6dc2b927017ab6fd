"""``python -m xcg.cli``."""

from xcg.cli import main

main()
