"""The command line: `petalfit demo`, `fit`, `batch` and so on, with one file per command.

Modules here import jax, scipy, trimesh and the rest of petalfit only inside functions, so that
`petalfit --help` takes only the time of importing tyro.
"""

import atexit
import gc
import os
import sys
from collections.abc import Sequence

from petalfit.cli.interrupt import insistent_interrupt
from petalfit.cli.invocation import invoked_with
from petalfit.cli.status import BROKEN_PIPE, INTERRUPTED, SUCCESS, UNUSABLE, CommandError
from petalfit.version import VERSION

DESCRIPTION = (
    "Flowers from a few named numbers, and the numbers back from a scan.\n"
    "`petalfit demo` shows it in under a minute; `petalfit --version` prints the version."
)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command.

    Args:
        argv: The arguments without the program's name; by default those of the process.

    Returns:
        The exit status: 0 for success, 2 for unusable input or options, 3 for a fit that did not
        converge, 130 after Ctrl-C.
    """
    _expect_a_short_life()
    arguments = list(sys.argv[1:] if argv is None else argv)
    try:
        with insistent_interrupt(), invoked_with(arguments):
            status = _run(arguments)
            sys.stdout.flush()
        return status
    except KeyboardInterrupt:
        return _complain("interrupted; nothing was written", INTERRUPTED)
    except BrokenPipeError:  # the reader has closed the pipe, as in `petalfit parameters | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    except CommandError as error:
        return _complain(str(error), UNUSABLE)
    except ValueError as error:
        if not _is_about_the_input(error):
            raise
        return _complain(str(error), UNUSABLE)
    except SystemExit as error:  # tyro raises it after --help or an invalid option
        return error.code if isinstance(error.code, int) else int(error.code is not None)


def _expect_a_short_life() -> None:
    """Saves most of the garbage collector's work, which is a tenth of the time of a fit."""
    # Nearly all objects that imports and tracing create are in use until the end of the process.
    gc.set_threshold(200_000, *gc.get_threshold()[1:])
    atexit.register(gc.freeze)


def _run(arguments: list[str]) -> int:
    if arguments[:1] == ["--version"]:
        print(f"petalfit {VERSION}")
        return SUCCESS
    import tyro

    from petalfit.cli.batch import batch
    from petalfit.cli.demo import demo
    from petalfit.cli.fit import fit
    from petalfit.cli.flower import flower
    from petalfit.cli.grow import grow
    from petalfit.cli.mask import mask
    from petalfit.cli.parameters import parameters
    from petalfit.cli.studio import studio
    from petalfit.cli.synth import synth

    return tyro.extras.subcommand_cli_from_dict(
        {
            "demo": demo,
            "fit": fit,
            "flower": flower,
            "batch": batch,
            "studio": studio,
            "grow": grow,
            "mask": mask,
            "synth": synth,
            "parameters": parameters,
        },
        prog="petalfit",
        description=DESCRIPTION,
        args=arguments or ["--help"],
        config=(tyro.conf.FlagCreatePairsOff,),
    )


def _is_about_the_input(error: ValueError) -> bool:
    # Imported here, because --help imports this module too.
    from petalfit.observations import TargetError

    return isinstance(error, TargetError)


def _complain(sentence: str, status: int) -> int:
    print(f"petalfit: {sentence}", file=sys.stderr)
    return status
