"""Silhouettes: distances between a contour and an outline, along the normal in the image.

A place x of the contour is matched with the (u, v) of a place on the outline whose normal in the image
is m. The distance m·(π(S(u, v)) − x) has the derivative m·∂π(S)/∂θ at fixed (u, v). A motion of (u, v)
does not change it: on a rim the place slides along the rim, and on a fold the images of both tangents lie
along the outline. In terms of the rows of the camera's matrix M, the distance is a ratio of two affine
functions of S, for orthographic and perspective cameras alike.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float, Int

from petalfit.residuals.term import AbstractFrozen, AbstractTerm
from petalfit.surfaces import AbstractSurface


@dataclasses.dataclass(frozen=True, eq=False)
class ContourDistance(AbstractTerm, AbstractFrozen):
    """The distances of matched places of one or several views.

    Places are matched again outside of the compiled rounds.

    Attributes:
        uv: The places on the surface, shape (n, 2).
        plane: The coefficients q, shape (n, 4); q·(S, 1) is the distance times the depth.
        depth: The coefficients z, shape (n, 4); z·(S, 1) is the depth, which is 1 for an orthographic
            camera.
        root: The square root of the weight over the noise, in 1/pixel, shape (n,).
        sigma: Always 1, because `root` contains the noise of each view.
    """

    uv: Float[np.ndarray, "n 2"]
    plane: Float[np.ndarray, "n 4"]
    depth: Float[np.ndarray, "n 4"]
    root: Float[np.ndarray, " n"]
    sigma: float

    def freeze(
        self, surface: AbstractSurface, free: int
    ) -> tuple[ContourDistance, ContourDistance, None]:
        return self, self, None

    def residual(self, position: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        seen, depth = self._seen(position)
        return self.root * seen / depth

    def slopes(
        self, position: Float[np.ndarray, "n 3"]
    ) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
        return np.arange(len(self.uv)), self.covectors(position)

    def covectors(self, position: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """The derivatives of the residuals with respect to the positions."""
        seen, depth = self._seen(position)
        covectors = self.plane[:, :3] - (seen / depth)[:, None] * self.depth[:, :3]
        return covectors * (self.root / depth)[:, None]

    def _seen(
        self, position: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """The distances in pixels, positive where the outline lies outside, times depths; the depths."""
        seen = np.sum(self.plane[:, :3] * position, axis=-1) + self.plane[:, 3]
        return seen, np.sum(self.depth[:, :3] * position, axis=-1) + self.depth[:, 3]
