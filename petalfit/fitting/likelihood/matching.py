"""Correspondences between a contour and the outline of a model."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from petalfit.compilation import bucket, pad_to
from petalfit.fitting.likelihood.scales import spread_of
from petalfit.observations import Contour
from petalfit.residuals import ContourDistance
from petalfit.surfaces import AbstractSurface, Outline, outline

# Places are matched by where they are and where their normals point: one radian weighs as much as this
# fraction of the contour's size.
_TURN = 0.025
# Places of the outline that look for the contour, besides those of the contour that look for it.
_BACK = 512
# Distances far beyond this many pixels of an image of 256, or three times the typical one, hardly count.
_KERNEL = 2.0 / 256
# Neighbouring places of a contour err together: so many pixels count as one observation where starts are
# compared. What they weigh beside other observations is measured, within limits.
CORRELATED = 2.0
_LONGEST = 24
_TIMES = (0.7, 20.0)
# Whatever the residuals say, a contour is not known better than this, in pixels.
_FINEST = 0.02
_THIN = 1.5  # pixels


class Match(NamedTuple):
    """Places of a contour and of an outline that belong together, in both directions.

    Attributes:
        uv: On the surface, shape (n, 2).
        seen: Where that is in the image, shape (n, 2).
        normal: Of the outline, from the contour; or of the contour, from the outline; shape (n, 2).
        place: On the contour, shape (n, 2).
        length: How much of the contour or outline a row stands for, times its weight; shape (n,).
        forward: Whether a row began at the contour, shape (n,).
        number: Which place of the outline a row has, shape (n,).
    """

    uv: Float[np.ndarray, "n 2"]
    seen: Float[np.ndarray, "n 2"]
    normal: Float[np.ndarray, "n 2"]
    place: Float[np.ndarray, "n 2"]
    length: Float[np.ndarray, " n"]
    forward: Bool[np.ndarray, " n"]
    number: Int[np.ndarray, " n"]

    @property
    def distance(self) -> Float[np.ndarray, " n"]:
        """In pixels, positive where the outline lies outside of the contour."""
        return np.sum(self.normal * (self.seen - self.place), axis=-1)


@dataclasses.dataclass(frozen=True)
class View:
    """One silhouette's contour.

    Attributes:
        contour: The contour.
        size: Of the target's contour, in pixels.
    """

    contour: Contour
    size: float

    @property
    def turn(self) -> float:
        """Pixels that one radian between normals weighs as much as."""
        return _TURN * self.size

    @property
    def kernel(self) -> float:
        """Pixels beyond which distances hardly count."""
        return max(2.0, _KERNEL * self.size)

    @cached_property
    def tree(self) -> KDTree:
        """Of the contour's places and normals."""
        return KDTree(self.features(self.contour.place, self.contour.normal))

    def features(self, place: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """What is compared in matching."""
        return np.concatenate([place, self.turn * normal], axis=1)

    def match(self, model: AbstractSurface) -> Match:
        """Nearest places of the contour and the model's outline, in both directions."""
        return self.matched(outline(model, self.contour.camera))

    def matched(self, seen: Outline) -> Match:
        """The same for an outline that is known."""
        return MatchedOutline.of(self, seen).match(self)

    def like(self, place: np.ndarray, normal: np.ndarray, length: np.ndarray) -> View:
        """A view that has another contour and the same camera, trust and sizes."""
        length = length * self.contour.trust(place)
        return View(
            dataclasses.replace(self.contour, place=place, normal=normal, length=length), self.size
        )

    def noise(self, match: Match) -> float:
        """Standard deviation of the contour's distances, in pixels, robustly."""
        counts = match.forward & (match.length > 0)
        return max(spread_of(match.distance[counts]), _FINEST)

    def correlated(self, match: Match, noise: float) -> float:
        """How many neighbouring pixels of the contour count as one observation."""
        distance = np.clip(match.distance[match.forward], -3 * noise, 3 * noise)
        power = float(distance @ distance) + 1e-300
        lags = range(1, min(_LONGEST, len(distance) // 4))
        sums = [(1 - lag / _LONGEST) * float(distance[lag:] @ distance[:-lag]) for lag in lags]
        return float(np.clip(1 + 2 * sum(sums) / power, *_TIMES))

    def chi2(self, match: Match) -> float:
        """Comparable between models: n log of the mean squared distance, large ones tempered."""
        tempered = self.kernel**2 * np.log1p((match.distance / self.kernel) ** 2)
        squared = np.average(tempered, weights=match.length) + _FINEST**2
        return match.length.sum() / (2 * CORRELATED) * float(np.log(squared))

    def cauchy_weight(self, match: Match, noise: float) -> Float[np.ndarray, " n"]:
        """Weights of a heavy-tailed (Cauchy) distribution, in which wrong matches count for little."""
        return 1 / (1 + (match.distance / max(3 * noise, self.kernel)) ** 2)


@dataclasses.dataclass(frozen=True)
class MatchedOutline:
    """An outline that is ready to be matched with contours of one size.

    Attributes:
        seen: The outline.
        tree: Of its places and normals.
        some: Which places look for the contour.
        thin: Which of these lie where the model is thinner than a pixel, which leaves no trace in a mask:
            there is nothing to look for.
    """

    seen: Outline
    tree: KDTree
    some: Int[np.ndarray, " n"]
    thin: Bool[np.ndarray, " n"]

    @classmethod
    def of(cls, view: View, seen: Outline) -> MatchedOutline:
        tree = KDTree(view.features(seen.place, seen.normal))
        some = np.arange(len(seen.place))[:: len(seen.place) // _BACK]
        place, normal = seen.place[some], seen.normal[some]
        _, across = tree.query(view.features(place, -normal))
        width = np.linalg.norm(seen.place[across] - place, axis=-1)
        thin = (width < _THIN) & (np.sum(seen.normal[across] * normal, axis=-1) < 0)
        return cls(seen, tree, some, thin)

    def match(self, view: View) -> Match:
        """Nearest places of the outline and a view's contour, in both directions."""
        seen, some, contour = self.seen, self.some, view.contour
        forth = np.asarray(self.tree.query(view.tree.data)[1])
        _, back = view.tree.query(self.tree.data[some])
        share = len(seen.place) / len(some)
        trust = np.where(self.thin, 0.0, contour.trust(seen.place[some]))
        return Match(
            np.concatenate([seen.uv[forth], seen.uv[some]]),
            np.concatenate([seen.place[forth], seen.place[some]]),
            np.concatenate([seen.normal[forth], contour.normal[back]]),
            np.concatenate([contour.place, contour.place[back]]),
            np.concatenate([contour.length, share * seen.length[some] * trust]),
            np.arange(len(forth) + len(some)) < len(forth),
            np.concatenate([forth, some]),
        )


class Rows(NamedTuple):
    """Residuals of one view; see `ContourDistance`."""

    uv: Float[np.ndarray, "n 2"]
    plane: Float[np.ndarray, "n 4"]
    depth: Float[np.ndarray, "n 4"]
    root: Float[np.ndarray, " n"]


def rows(contour: Contour, match: Match, root: np.ndarray) -> Rows:
    """The residuals of matched places, each with the root of its weight over the noise."""
    matrix = contour.camera.matrix
    across = np.sum(match.normal * match.place, axis=-1, keepdims=True)
    plane = match.normal @ matrix[:2] - across * matrix[2]
    return Rows(match.uv, plane, np.tile(matrix[2], (len(plane), 1)), root)


def padded(parts: Sequence[Rows]) -> ContourDistance:
    """All rows one after the other, and copies of the first without weight up to a bucketed size."""
    uv, plane, depth, root = map(np.concatenate, zip(*parts, strict=True))
    size = bucket(len(root))
    return ContourDistance(
        uv=jnp.asarray(pad_to(uv, size)),
        plane=jnp.asarray(pad_to(plane, size)),
        depth=jnp.asarray(pad_to(depth, size)),
        root=jnp.asarray(np.concatenate([root, np.zeros(size - len(root))])),
        sigma=jnp.asarray(1.0),
    )
