"""A silhouette and the outline of the fit, in the pixels of the silhouette's image."""

from __future__ import annotations

import dataclasses
from typing import cast

import numpy as np
from jaxtyping import Float

from petalfit.observations import Contour, Silhouette
from petalfit.results import Agreement, FitRecord
from petalfit.surfaces import rings

_RESOLUTION = (193, 129)
_MARGIN = 0.06  # around mask and outline, as a fraction of their size


@dataclasses.dataclass(frozen=True)
class Overlay:
    """The part of an image that contains the mask and the fitted outline.

    Attributes:
        mask: The coverage of the pixels of that part, shape (h, w).
        box: The left, top, right and bottom edges of that part, in pixels of the image.
        rings: The fitted outline, closed rings of shape (k, 2).
        places: Places on the contour of the mask, shape (n, 2).
        distances: The distances of these places, positive outside the fitted outline, shape (n,).
        used: Whether each place had a weight, shape (n,).
    """

    mask: Float[np.ndarray, "h w"]
    box: tuple[int, int, int, int]
    rings: list[np.ndarray]
    places: Float[np.ndarray, "n 2"]
    distances: Float[np.ndarray, " n"]
    used: np.ndarray

    @classmethod
    def of(cls, result: FitRecord, part: Agreement) -> Overlay:
        """The overlay of a fitted silhouette and the result of the fit."""
        silhouette = cast(Silhouette, part.target)
        contour = Contour.of(silhouette)
        vertices = np.asarray(result.mesh(_RESOLUTION).vertices).reshape(*_RESOLUTION, 3)
        outline = rings(contour.camera.project(vertices))
        shown = np.concatenate([contour.place, *outline])
        # Parts of the fitted outline that lie far outside the image are not shown.
        shape = np.array(silhouette.mask.shape[::-1])
        low, high = np.clip([shown.min(axis=0), shown.max(axis=0)], -0.2 * shape, 1.2 * shape)
        margin = _MARGIN * np.max(high - low)
        left, top = np.floor(np.maximum(low - margin, 0)).astype(int)
        right, bottom = np.ceil(np.minimum(high + margin, shape)).astype(int)
        return cls(
            silhouette.mask[top:bottom, left:right],
            (int(left), int(top), int(right), int(bottom)),
            outline,
            contour.place,
            part.distances,
            part.weights > 0,
        )
