"""Runs the command line, for `python -m petalfit`."""

import sys

from petalfit.cli import main

if __name__ == "__main__":
    sys.exit(main())
