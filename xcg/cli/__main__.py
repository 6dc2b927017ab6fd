"""``python -m xcg.cli``."""

from xcg.cli import main

if __name__ == "__main__":
    main()
