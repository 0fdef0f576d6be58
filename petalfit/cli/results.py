"""The folder of a fit's results: its files, which are written completely or not at all."""

import dataclasses
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from petalfit.cli.invocation import command_line
from petalfit.cli.status import CommandError, require

if TYPE_CHECKING:
    from petalfit.fitting import FitResult

FIT = "fit.json"
MESH = "fit.glb"
REPORT = "report.html"

CONTENTS = {
    FIT: "all that is known, for petalfit.FitResult.load",
    MESH: "the petal, for any 3D program",
    REPORT: "parameters and pictures, for a browser",
}


def write_results(result: "FitResult", folder: Path) -> None:
    """Writes the files of `CONTENTS`, which name the command that made them."""
    from petalfit.export import export_mesh
    from petalfit.report import write_report

    result = dataclasses.replace(result, command=command_line())
    result.save(folder / FIT)
    export_mesh(result, folder / MESH)
    write_report(result, folder / REPORT)


def check_folder(folder: Path) -> None:
    """Checks, before a long fit, that its results can be written.

    Args:
        folder: The folder for the results. It and the folders above it need not exist yet.

    Raises:
        CommandError: The path is not a folder, or there is no permission.
    """
    place = _workplace(folder)
    require(place.is_dir(), f"{place} is not a folder; choose another --out.")
    require(
        os.access(place, os.W_OK | os.X_OK),
        f"{place} cannot be written to; choose another --out, or change its permissions.",
    )


@contextmanager
def written_whole(folder: Path) -> Iterator[Path]:
    """Yields an empty folder, whose files move to `folder` when the block ends without an error.

    If the block raises anything, `KeyboardInterrupt` included, or a file cannot be moved, then
    nothing is left behind and the previous content of `folder` is kept. Files of other names in
    `folder` are kept in any case.

    Args:
        folder: The folder for the files. It and the folders above it are created if necessary.

    Yields:
        The temporary folder.

    Raises:
        CommandError: The files cannot be written or moved.
    """
    final = Path(os.path.realpath(folder))
    # The temporary folder is in the same file system, so that moving is renaming.
    temporary = _workplace(final) / f".petalfit-{secrets.token_hex(8)}"
    try:
        temporary.mkdir()
        yield temporary
        if final.is_dir():
            _move_files(temporary, final)
        else:
            final.parent.mkdir(parents=True, exist_ok=True)
            temporary.rename(final)
    except OSError as error:
        reason = error.strerror or error
        raise CommandError(f"{folder} cannot be written ({reason}); nothing was.") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _workplace(folder: Path) -> Path:
    """The folder itself, or the nearest one above it that exists."""
    final = Path(os.path.realpath(folder))
    return next(place for place in (final, *final.parents) if os.path.lexists(place))


def _move_files(source: Path, folder: Path) -> None:
    """Moves every file of `source` into `folder`, or none of them."""
    names = sorted(os.listdir(source))
    for name in names:
        require(not (folder / name).is_dir(), f"{folder / name} is a folder; choose another --out.")
    before = source / "before"
    before.mkdir()
    try:
        for name in names:
            if os.path.lexists(folder / name):
                os.replace(folder / name, before / name)
            os.replace(source / name, folder / name)
    except BaseException:
        # The places of the files decide, because an interrupt may fall between any two steps above.
        for name in names:
            if os.path.lexists(before / name):
                os.replace(before / name, folder / name)
            elif not os.path.lexists(source / name):
                (folder / name).unlink()
        raise
