"""`python -m petalfit` is the command line."""

import sys

from petalfit.cli import main

if __name__ == "__main__":
    sys.exit(main())
