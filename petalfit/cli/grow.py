"""`petalfit grow`: a whole flower as a mesh, as JSON or as a picture."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, UseAppendAction, arg

from petalfit.cli.options import Quiet, require_seed, setting_value
from petalfit.cli.status import SUCCESS, CommandError, require

if TYPE_CHECKING:
    from petalfit.flowers import Flower

SUFFIXES = (".glb", ".obj", ".ply", ".stl", ".json")

What = Annotated[
    Positional[str],
    arg(metavar="FLOWER", help="lily, peony, or the JSON file of a flower of your own."),
]
Out = Annotated[
    Path | None,
    arg(
        aliases=["-o"],
        metavar="FILE",
        help="File to write: a mesh (.glb with organs as named nodes; .obj .ply .stl), or the flower "
        "with all its numbers (.json), which can be changed and grown again.",
    ),
]
Seed = Annotated[int, arg(metavar="S", help="Random seed; another seed gives another flower.")]
Settings = Annotated[
    UseAppendAction[tuple[str, ...]],
    arg(
        name="set",
        metavar="NAME=VALUE",
        help="A number of an organ, such as petal.dy=4 for all petals or petal_3.dy=4 for one; repeat "
        "it. The error for an unknown name lists the known ones.",
    ),
]
Png = Annotated[Path | None, arg(metavar="FILE", help="File for a picture of the flower.")]


def grow(
    flower: What,
    out: Out = None,
    seed: Seed = 0,
    settings: Settings = (),
    png: Png = None,
    quiet: Quiet = False,
) -> int:
    """Grow a lily, a peony or a flower of your own, as glTF, as a plain mesh, or as a picture."""
    require(
        out is not None or png is not None,
        f"nothing to write: give -o {Path(flower).stem}.glb, or --png {Path(flower).stem}.png.",
    )
    if out is not None:
        require(
            out.suffix.lower() in SUFFIXES,
            f"{out} has the unknown suffix {out.suffix!r}; flowers are written as {' '.join(SUFFIXES)}.",
        )
    if png is not None:
        require(png.suffix.lower() == ".png", f"--png {png} is not named .png.")
    require_seed(seed)
    values = dict(_setting(text) for text in settings)
    from petalfit.cli.console import output, progress
    from petalfit.compilation.cache import compilation_cache

    with progress(quiet) as show, compilation_cache():
        show("arranging")
        from petalfit.flowers import FlowerError, with_settings

        try:
            grown = with_settings(_flower(flower, seed), values)
            if out is not None:
                show(f"growing {out}")
                _write(grown, out)
            if png is not None:
                show(f"drawing {png}")
                from petalfit.report.portrait import write_portrait

                write_portrait(grown, png)
        except FlowerError as error:
            raise CommandError(str(error)) from None
        except OSError as error:
            place = error.filename or out or png
            raise CommandError(f"{place} cannot be written ({error.strerror or error}).") from error
    if not quiet:
        organs = [
            f"{len(series)} {series.name}{'s' * (len(series) > 1)}" for series in grown.series
        ]
        written = " and ".join(str(path) for path in (out, png) if path is not None)
        output().print(f"{written}: {grown.name}, {', '.join(organs)}", soft_wrap=True)
    return SUCCESS


def _setting(text: str) -> tuple[str, float]:
    name, equals, value = text.partition("=")
    require(bool(equals and "." in name), f"--set {text} is not written like petal.dy=4.")
    return name, setting_value(text, name, value, "4")


def _flower(name: str, seed: int) -> "Flower":
    from petalfit.flowers import load_flower
    from petalfit.flowers.lily import lily
    from petalfit.flowers.peony import peony

    known = {"lily": lily, "peony": peony}
    if name in known:
        return known[name](seed)
    require(
        name.endswith(".json"),
        f"there is no flower {name!r}; there are {' and '.join(known)}, and JSON files of your own.",
    )
    return load_flower(name, seed)


def _write(flower: "Flower", path: Path) -> None:
    if path.suffix.lower() == ".json":
        from petalfit.flowers import save_flower

        save_flower(flower, path)
    else:
        from petalfit.export import export_flower

        export_flower(flower, path)
