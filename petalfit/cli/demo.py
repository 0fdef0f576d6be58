"""`petalfit demo`: everything at once, on a petal whose truth is known."""

import math
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from petalfit.cli.failure import require

PICTURE = "picture.png"
MADE = ("the noisy points", "what they were made from")


def demo(
    out: Annotated[Path, arg(metavar="DIR", help="Folder for all that it makes.")] = Path(
        "petalfit-demo"
    ),
    points: Annotated[int, arg(metavar="N", help="How many points the cloud has.")] = 1500,
    noise: Annotated[
        float,
        arg(
            metavar="SIGMA",
            help="Standard deviation of every coordinate; petals are some 30 wide and 50 long.",
        ),
    ] = 0.05,
    seed: Annotated[int, arg(metavar="S", help="Another seed is another petal.")] = 0,
    quiet: Annotated[bool, arg(help="Print warnings only.")] = False,
) -> int:
    """Make a noisy petal, fit it, and compare with the truth."""
    require(points >= 50, f"--points {points} are too few for a demonstration; give 50 or more.")
    require(
        math.isfinite(noise) and noise >= 0,
        f"--noise {noise} is no standard deviation; give 0 or more.",
    )
    require(seed >= 0, f"--seed {seed} is negative; give 0 or more.")
    from petalfit.cli.compilation_cache import compilation_cache
    from petalfit.cli.console import fit_table, list_files, output, progress, summarise, warn
    from petalfit.cli.folder import check_folder, written_whole
    from petalfit.cli.results import CONTENTS, write_results

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
    return 0 if result.converged else 3
