"""`petalfit fit`: from a file to named parameters, a mesh and a report."""

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, UseAppendAction, arg

from petalfit.cli.options import Quiet, require_noise, require_seed
from petalfit.cli.status import NOT_CONVERGED, SUCCESS

Target = Annotated[
    Positional[Path],
    arg(
        metavar="TARGET",
        help="Point cloud (.ply .xyz .txt .csv .npy .npz) or mesh (.ply .obj .stl .glb .gltf), in the "
        "frame and unit of the model: its length along +y from the plane y = 0, its width along x.",
    ),
]
Folder = Annotated[
    Path,
    arg(
        metavar="DIR",
        help="Folder for fit.json, fit.glb and report.html; made if it does not exist. All of them "
        "are written or none.",
    ),
]
Free = Annotated[
    UseAppendAction[tuple[str, ...]],
    arg(
        metavar="NAME",
        help="Parameter to fit; repeat it, or separate names by commas. The others keep their "
        "defaults, or the values of --init. Without it all are fitted that `petalfit parameters` "
        "does not call fixed.",
    ),
]
Init = Annotated[
    Path | None,
    arg(metavar="FIT.json", help="An earlier result to start from, instead of searching."),
]
Noise = Annotated[
    float | None,
    arg(
        metavar="SIGMA",
        help="Standard deviation of the points, in their unit; estimated if not given.",
    ),
]
Seed = Annotated[int, arg(metavar="S", help="Of the random choice of points to start with.")]


def fit(
    target: Target,
    out: Folder,
    free: Free = (),
    init: Init = None,
    noise: Noise = None,
    seed: Seed = 0,
    quiet: Quiet = False,
) -> int:
    """Recover the parameters of a petal from a scan."""
    if noise is not None:
        require_noise(noise, least="a positive number, or leave it out")
    require_seed(seed)
    from petalfit.cli.compilation_cache import compilation_cache
    from petalfit.cli.console import fit_table, list_files, output, progress, summarise, warn
    from petalfit.cli.results import CONTENTS, check_folder, write_results, written_whole
    from petalfit.observations import PointCloud

    check_folder(out)
    with progress(quiet) as show:
        show(f"reading {target}")
        cloud = PointCloud.load(target)
        with compilation_cache() as compiled:
            from petalfit.fitting import FitResult, fit_petal

            again = "" if compiled else " (compiling, which only the first fit needs)"
            result = fit_petal(
                cloud,
                free=_names(free),
                init=None if init is None else FitResult.load(init).model,
                noise=noise,
                seed=seed,
                throw=False,
                progress=lambda text: show(text + again),
            )
            show(f"writing {out}")
            with written_whole(out) as folder:
                write_results(result, folder)
    if not quiet:
        console = output()
        console.print(fit_table(result))
        console.print(summarise(result, noise), soft_wrap=True)
        list_files(out, CONTENTS)
    warn(result)
    return SUCCESS if result.converged else NOT_CONVERGED


def _names(free: tuple[str, ...]) -> list[str] | None:
    """`--free a_x --free b_y` and `--free a_x,b_y` mean the same."""
    if not free:
        return None
    return [name for text in free for name in text.replace(",", " ").split()]
