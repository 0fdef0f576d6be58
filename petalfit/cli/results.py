"""The files of a fit."""

from pathlib import Path
from typing import TYPE_CHECKING

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
    """Writes the files of `CONTENTS`."""
    from petalfit.export import export_mesh
    from petalfit.report import write_report

    result.save(folder / FIT)
    export_mesh(result, folder / MESH)
    write_report(result, folder / REPORT)
