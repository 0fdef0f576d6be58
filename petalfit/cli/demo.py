"""`petalfit demo`: a complete run on a petal whose true parameters are known."""

from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from petalfit.cli.options import Quiet, require_noise, require_seed
from petalfit.cli.status import NOT_CONVERGED, SUCCESS, require

PICTURE = "picture.png"
MADE = ("the noisy points", "what they were made from")


Folder = Annotated[Path, arg(metavar="DIR", help="Folder for all files of the demo.")]
Points = Annotated[int, arg(metavar="N", help="Number of points of the cloud.")]
Noise = Annotated[
    float,
    arg(
        metavar="SIGMA",
        help="Standard deviation of every coordinate; petals are some 30 wide and 50 long.",
    ),
]
Seed = Annotated[int, arg(metavar="S", help="Random seed; another seed gives another petal.")]


def demo(
    out: Folder = Path("petalfit-demo"),
    points: Points = 1500,
    noise: Noise = 0.05,
    seed: Seed = 0,
    quiet: Quiet = False,
) -> int:
    """Make a noisy petal, fit it, and compare with the truth."""
    require(points >= 50, f"--points {points} are too few for a demonstration; give 50 or more.")
    require_noise(noise)
    require_seed(seed)
    from petalfit.cli.console import fit_table, list_files, output, progress, summarise, warn
    from petalfit.cli.results import CONTENTS, check_folder, write_results, written_whole
    from petalfit.compilation.cache import compilation_cache

    check_folder(out)
    with progress(quiet) as show, compilation_cache() as compiled:
        import numpy as np

        from petalfit.fitting import fit_petal
        from petalfit.report import write_picture
        from petalfit.synthetic import Case, make, random_petal, write_case

        again = "" if compiled else " (compiling, which only the first fit needs)"
        show("making a petal" + again)
        petal = random_petal(np.random.default_rng(seed))
        case = Case("demo", "made by petalfit demo", petal, points, noise, seed)
        cloud = make(case)
        result = fit_petal(cloud, throw=False, progress=lambda text: show(text + again))
        show(f"writing {out}")
        with written_whole(out) as folder:
            made = [path.name for path in write_case(case, cloud, folder)]
            write_results(result, folder)
            write_picture(result, folder / PICTURE)
    if not quiet:
        console = output()
        console.print(fit_table(result, {name: float(x) for name, x in vars(petal).items()}))
        console.print(summarise(result, None), soft_wrap=True)
        list_files(out, dict(zip(made, MADE, strict=True)) | CONTENTS | {PICTURE: "for the eye"})
    warn(result)
    return SUCCESS if result.converged else NOT_CONVERGED
