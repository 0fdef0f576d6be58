"""`petalfit mask`: a mask of one petal or one flower from a photo."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, UseAppendAction, arg

from petalfit.cli.options import Quiet
from petalfit.cli.status import SUCCESS, CommandError, require

if TYPE_CHECKING:
    import numpy as np

_PREVIEW_SIDE = 2000  # pixels

Photo = Annotated[
    Positional[Path],
    arg(
        metavar="PHOTO",
        help="Image of any common format. If it has an alpha channel, that is the mask.",
    ),
]
File = Annotated[
    Path,
    arg(
        aliases=["-o"],
        metavar="MASK.png",
        help="The mask to write, white on black. MASK-preview.png is written beside it, for checking.",
    ),
]
Points = Annotated[
    UseAppendAction[tuple[str, ...]],
    arg(
        name="point",
        metavar="X,Y",
        help="A place on the petal, in pixels from the left and from the top; repeat it for parts of "
        "other colours. Without it, the mask is the largest region that differs most from the border of "
        "the photo, or the largest object on the paper of a scan.",
    ),
]


def mask(photo: Photo, out: File, points: Points = (), quiet: Quiet = False) -> int:
    """Cut a petal out of a photo."""
    import numpy as np

    require(out.suffix.lower() == ".png", f"{out} is no .png; a mask is written as one.")
    places = [_place(text) for text in points]
    from petalfit.cli.console import output, progress
    from petalfit.observations.photo import read_photo, segment
    from petalfit.observations.silhouette import write_mask

    with progress(quiet) as show:
        show(f"reading {photo}")
        image = read_photo(photo)
        show("finding the petal")
        found = segment(image, places)
        preview = out.with_name(f"{out.stem}-preview.png")
        try:
            _write_preview(image, found, preview)
            write_mask(out, found)
        except OSError as error:
            reason = error.strerror or error
            raise CommandError(f"{out} cannot be written ({reason}); choose another.") from error
    if not quiet:
        rows, columns = found.shape
        share = 100 * float(np.mean(found))
        line = f"{out}: {columns} × {rows} pixels, {share:.1f} % of them the petal's"
        output().print(line, soft_wrap=True)
        output().print(f"{preview}: for the eye", soft_wrap=True)
    return SUCCESS


def _place(text: str) -> tuple[float, float]:
    try:
        x, y = map(float, text.split(","))
    except ValueError:
        raise CommandError(f"--point {text} is no place; write --point 320,200.") from None
    return x, y


def _write_preview(image: "np.ndarray", found: "np.ndarray", path: Path) -> None:
    """Writes the photo, darkened outside the mask, with the outline drawn; not larger than a screen."""
    import numpy as np
    from PIL import Image
    from skimage.segmentation import find_boundaries

    from petalfit.observations.atomic import atomic_path
    from petalfit.observations.photo import resized

    step = max(1.0, max(found.shape) / _PREVIEW_SIDE)
    shape = round(found.shape[0] / step), round(found.shape[1] / step)
    colours = resized(np.ascontiguousarray(image[..., :3]), shape)
    inside = resized(found.astype(np.float32), shape) >= 0.5
    picture = np.where(inside[..., None], colours, 0.35 * colours)
    picture[find_boundaries(inside, mode="thick")] = 255.0
    with atomic_path(path) as temporary:
        Image.fromarray(np.rint(picture).astype(np.uint8)).save(temporary, format="PNG")
