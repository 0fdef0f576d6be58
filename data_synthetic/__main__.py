"""Makes the cases of this folder again, or checks them: `python -m data_synthetic [--check]`."""

import argparse
import sys
from pathlib import Path

FOLDER = Path(__file__).parent


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m data_synthetic", description=__doc__)
    parser.add_argument("--check", action="store_true", help="change nothing; say what differs")
    arguments = parser.parse_args()
    # Here, so that --help does not import jax.
    from petalfit.synthetic import check_cases, write_cases

    if arguments.check:
        wrong = check_cases(FOLDER)
        print("\n".join(wrong) or "every file is what the manifest says, and can be made again")
        return 1 if wrong else 0
    for path in write_cases(FOLDER):
        print(f"{path.relative_to(FOLDER.parent)}  {path.stat().st_size:,} bytes")
    return 0


if __name__ == "__main__":
    sys.exit(main())
