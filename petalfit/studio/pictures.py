"""Pictures of a mask or a photo with the outline of a petal."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw

from petalfit.observations import Contour, Silhouette
from petalfit.report.colour import MASK, POINT, POSITIVE
from petalfit.surfaces import AbstractSurface, Pose, in_doubles, rings

_SIDE = 640  # pixels of the picture's longer side
_RESOLUTION = (97, 65)


def picture(
    silhouette: Silhouette,
    photo: Float[np.ndarray, "h w 3"] | None,
    model: AbstractSurface | None,
    pose: Pose,
) -> UInt8[np.ndarray, "h w 3"]:
    """A picture of the target, its contour, and the outline of a model if there is one.

    Args:
        silhouette: The target.
        photo: The photo that the target was cut out of, or None.
        model: The model in its own frame, or None.
        pose: The pose from the model's frame to the target's.
    """
    mask = silhouette.mask[..., None]
    if photo is None:
        ground = mask * MASK + (1 - mask) * 0.96
    else:
        ground = photo * np.where(mask >= 0.5, 1.0, 0.45)
    rows, columns = silhouette.mask.shape
    factor = _SIDE / max(rows, columns)
    size = max(1, round(columns * factor)), max(1, round(rows * factor))
    image = Image.fromarray(np.rint(255 * ground).astype(np.uint8)).resize(
        size, Image.Resampling.NEAREST if factor > 2 else Image.Resampling.LANCZOS
    )
    draw = ImageDraw.Draw(image)
    contour = Contour.of(silhouette)
    for x, y in (contour.place * factor).tolist():
        draw.ellipse((x - 1.2, y - 1.2, x + 1.2, y + 1.2), fill=_rgb(POINT))
    if model is not None:
        vertices = np.asarray(pose(np.asarray(in_doubles(model).mesh(_RESOLUTION).vertices)))
        for ring in rings(contour.camera.project(vertices.reshape(*_RESOLUTION, 3))):
            draw.line([*map(tuple, (ring * factor).tolist())], fill=_rgb(POSITIVE), width=2)
    return np.asarray(image)


def _rgb(colour: Float[np.ndarray, "3"]) -> tuple[int, int, int]:
    red, green, blue = np.rint(255 * colour).astype(int).tolist()
    return red, green, blue
