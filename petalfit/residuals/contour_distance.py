"""Silhouettes: distances between a contour and an outline, along the normal in the image.

A place x of the contour is matched with the (u, v) of a place on the outline whose normal in the image
is m. The distance m·(π(S(u, v)) − x) has the derivative m·∂π(S)/∂θ at fixed (u, v). A motion of (u, v)
does not change it: on a rim the place slides along the rim, and on a fold the images of both tangents lie
along the outline. In terms of the rows of the camera's matrix M, the distance is a ratio of two affine
functions of S, for orthographic and perspective cameras alike.
"""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from petalfit.residuals.term import AbstractFrozen, AbstractTerm
from petalfit.surfaces import AbstractSurface


class ContourDistance(AbstractTerm, AbstractFrozen):
    """The distances of matched places of one or several views.

    Places are matched again outside of the compiled rounds.

    Attributes:
        uv: The places on the surface, shape (n, 2).
        plane: The coefficients q, shape (n, 4); q·(S, 1) is the distance times the depth.
        depth: The coefficients z, shape (n, 4); z·(S, 1) is the depth, which is 1 for an orthographic
            camera.
        root: The square root of the weight over the noise, in 1/pixel, shape (n,); 0 for padding.
        sigma: Always 1, because `root` contains the noise of each view.
    """

    uv: Float[Array, "n 2"]
    plane: Float[Array, "n 4"]
    depth: Float[Array, "n 4"]
    root: Float[Array, " n"]
    sigma: Float[Array, ""]

    def freeze(
        self, surface: AbstractSurface, free: int
    ) -> tuple[ContourDistance, ContourDistance, None]:
        return self, self, None

    def pixels(self, surface: AbstractSurface) -> Float[Array, " n"]:
        """The signed distances in pixels, positive where the outline lies outside the contour."""
        seen, depth = self._seen(surface)
        return seen / depth

    def residual(self, surface: AbstractSurface) -> Float[Array, " n"]:
        return self.root * self.pixels(surface)

    def slopes(self, surface: AbstractSurface) -> tuple[Float[Array, "n 2"], Float[Array, "n 3"]]:
        seen, depth = self._seen(surface)
        covectors = self.plane[:, :3] - (seen / depth)[:, None] * self.depth[:, :3]
        return self.uv, covectors * (self.root / depth)[:, None]

    def _seen(self, surface: AbstractSurface) -> tuple[Array, Array]:
        position = surface.position(self.uv[:, 0], self.uv[:, 1])
        seen = jnp.sum(self.plane[:, :3] * position, axis=-1) + self.plane[:, 3]
        return seen, jnp.sum(self.depth[:, :3] * position, axis=-1) + self.depth[:, 3]
