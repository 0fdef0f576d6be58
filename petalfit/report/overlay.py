"""A silhouette beside the outline of the fit, in the pixels of its image."""

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
    """A part of an image that holds the mask and the fitted outline.

    Attributes:
        mask: Coverage of that part's pixels, shape (h, w).
        box: Its left, top, right and bottom edges, in pixels of the image.
        rings: The fitted outline, closed rings of shape (k, 2).
        places: Of the contour, shape (n, 2).
        distances: Of these places, positive outside of the fitted outline, shape (n,).
        used: Whether each had a weight, shape (n,).
    """

    mask: Float[np.ndarray, "h w"]
    box: tuple[int, int, int, int]
    rings: list[np.ndarray]
    places: Float[np.ndarray, "n 2"]
    distances: Float[np.ndarray, " n"]
    used: np.ndarray

    @classmethod
    def of(cls, result: FitRecord, part: Agreement) -> Overlay:
        """The overlay of a silhouette that was fitted."""
        silhouette = cast(Silhouette, part.target)
        contour = Contour.of(silhouette)
        vertices = np.asarray(result.mesh(_RESOLUTION).vertices).reshape(*_RESOLUTION, 3)
        outline = rings(contour.camera.project(vertices))
        shown = np.concatenate([contour.place, *outline])
        # What the fit puts far outside of the image is not looked for.
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
