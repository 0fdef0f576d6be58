"""`petalfit flower`: all petals of a flower from one scan."""

import dataclasses
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, UseAppendAction, arg

from petalfit.cli.options import Quiet, names_of, require_seed
from petalfit.cli.status import NOT_CONVERGED, SUCCESS, CommandError

FLOWER = "flower.json"
MESH = "flower.glb"
TABLE = "petals.csv"
REPORT = "report.html"
CONTENTS = {
    FLOWER: "all that is known, for petalfit.FlowerResult.load",
    MESH: "the petals, each with its name, for any 3D program",
    TABLE: "what is measured of each petal, a row a petal",
    REPORT: "petals and their points in pictures, for a browser",
}

Scan = Annotated[
    Positional[Path],
    arg(
        metavar="SCAN",
        help="Point cloud or mesh of one flower, in any position and unit; the formats are those of "
        "`petalfit fit`.",
    ),
]
Folder = Annotated[
    Path,
    arg(
        metavar="DIR",
        help="Folder for flower.json, flower.glb, petals.csv and report.html; it is created if it does "
        "not exist. Either all of them are written or none.",
    ),
]
Petals = Annotated[
    int | None, arg(metavar="K", help="The number of petals, if you know it; found if not given.")
]
ModelName = Annotated[
    str | None, arg(name="model", metavar="MODEL", help="Component to fit, by default BladePetal.")
]
LossOption = Annotated[
    str, arg(name="loss", metavar="LOSS", help="linear or robust, as for `petalfit fit`.")
]
Shared = Annotated[
    UseAppendAction[tuple[str, ...]],
    arg(
        metavar="NAME",
        help="A shape parameter that is the same for all petals; may be repeated, or names separated by "
        "commas.",
    ),
]
Seed = Annotated[int, arg(metavar="S", help="Seed of the random choices.")]


def flower(
    scan: Scan,
    out: Folder,
    petals: Petals = None,
    model: ModelName = None,
    loss: LossOption = "robust",
    shared: Shared = (),
    seed: Seed = 0,
    quiet: Quiet = False,
) -> int:
    """Recover all petals of a flower, and how they are arranged, from one scan."""
    require_seed(seed)
    from petalfit.cli.console import list_files, output, progress, warn_of
    from petalfit.cli.invocation import command_line
    from petalfit.cli.models import kind_of
    from petalfit.cli.results import check_folder, written_whole
    from petalfit.compilation.cache import compilation_cache
    from petalfit.fitting import FOR_SCANS

    check_folder(out)
    kind = FOR_SCANS if model is None else kind_of(model)
    if isinstance(kind, str):
        raise CommandError("--model auto is there for single petals; name a component.")
    with progress(quiet) as show:
        show(f"reading {scan}")
        with compilation_cache() as compiled:
            from petalfit.fitting import fit_flower

            again = "" if compiled else " (compiling, which only the first fit needs)"
            result = fit_flower(
                scan,
                model=kind,
                petals=petals,
                loss=loss,
                shared=names_of(shared) or (),
                seed=seed,
                progress=lambda text: show(text + again),
                throw=False,
            )
            result = dataclasses.replace(result, command=command_line())
            show(f"writing {out}")
            with written_whole(out) as folder:
                result.save(folder / FLOWER)
                result.export(folder / MESH)
                (folder / TABLE).write_text(result.table(), encoding="utf-8")
                result.report(folder / REPORT)
    if not quiet:
        on = 100 * float((result.labels >= 0).mean())
        line = (
            f"{result.count} petals, {result.layout.described}, {on:.1f} % of the points on petals"
        )
        output().print(line, soft_wrap=True)
        list_files(out, CONTENTS)
    warn_of(result.warnings)
    return SUCCESS if result.converged else NOT_CONVERGED
