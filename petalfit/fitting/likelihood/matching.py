"""Correspondences between a contour and the outline of a model."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from petalfit.fitting.likelihood.scales import spread_of
from petalfit.observations import Contour
from petalfit.residuals import ContourDistance
from petalfit.surfaces import AbstractSurface, Outline, outline

# Places are matched by position and by the direction of their normals: one radian weighs as much as this
# fraction of the contour's size.
_TURN = 0.025
# About this many places of the outline are matched with the contour, besides all those of the contour
# that are matched with the outline.
_BACK = 512
# Distances far beyond this many pixels of an image of 256, or three times the typical one, hardly count.
_KERNEL = 2.0 / 256
# The errors of neighbouring places of a contour are correlated: this many pixels count as one observation
# when starts are compared. Beside other observations the number is measured, within the limits _TIMES.
CORRELATED = 2.0
_LONGEST = 24
_TIMES = (0.7, 20.0)
# A contour is never taken to be known better than this, in pixels, whatever the residuals are.
_FINEST = 0.02
# The cosine of the angle up to which the normals of a contour are those of an outline but for the steps
# of pixels.
_ALIKE = 0.7
_THIN = 1.5  # pixels; a thinner part of the model leaves no trace in a mask


class Match(NamedTuple):
    """Pairs of corresponding places of a contour and an outline, matched in both directions.

    Attributes:
        uv: The place on the surface, shape (n, 2).
        seen: The same place in the image, on the outline, shape (n, 2).
        normal: The normal of the outline there, shape (n, 2). That of the contour is no direction to
            measure in: it follows the steps of the pixels.
        place: The place on the contour, shape (n, 2).
        length: The length of contour or outline that a pair stands for, times its weight; shape (n,).
        forward: Whether a pair was searched for from the contour, shape (n,).
        number: The index of the place among those of the outline, shape (n,).
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
        """Distances in pixels, positive where the outline lies outside of the contour."""
        return np.sum(self.normal * (self.seen - self.place), axis=-1)

    def slopes(self, seen: Outline, outwards: Float[np.ndarray, "m p"]) -> Float[np.ndarray, "n p"]:
        """Derivatives of the distances.

        Args:
            seen: The outline that is matched.
            outwards: Derivatives of all of its places along their own normals, in pixels.
        """
        facing = np.sum(self.normal * seen.normal[self.number], axis=-1)
        return facing[:, None] * outwards[self.number]


@dataclasses.dataclass(frozen=True)
class View:
    """The contour of one silhouette, ready to be matched.

    Attributes:
        contour: The contour.
        size: The size of the target's contour, in pixels.
    """

    contour: Contour
    size: float

    @property
    def turn(self) -> float:
        """The number of pixels that counts as much as one radian between normals."""
        return _TURN * self.size

    @property
    def kernel(self) -> float:
        """The distance in pixels beyond which places hardly count."""
        return max(2.0, _KERNEL * self.size)

    @cached_property
    def tree(self) -> KDTree:
        """The tree of the contour's places and normals."""
        return KDTree(self.features(self.contour.place, self.contour.normal))

    def features(self, place: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """The feature vectors that matching compares: places, and normals in units of `turn`."""
        return np.concatenate([place, self.turn * normal], axis=1)

    def match(self, model: AbstractSurface) -> Match:
        """Matches the contour and the model's outline in both directions, by nearest features."""
        return self.matched(outline(model, self.contour.camera))

    def matched(self, seen: Outline) -> Match:
        """Matches the contour with a given outline, in the same way."""
        return MatchedOutline.of(self, seen).match(self)

    def like(self, place: np.ndarray, normal: np.ndarray, length: np.ndarray) -> View:
        """A view that has another contour and the same camera, trust and sizes."""
        length = length * self.contour.trust(place)
        return View(
            dataclasses.replace(self.contour, place=place, normal=normal, length=length), self.size
        )

    def noise(self, match: Match) -> float:
        """Robust standard deviation of the contour's distances, in pixels."""
        counts = match.forward & (match.length > 0)
        return max(spread_of(match.distance[counts]), _FINEST)

    def correlated(self, match: Match, noise: float) -> float:
        """The number of neighbouring pixels of the contour that count as one observation."""
        distance = np.clip(match.distance[match.forward], -3 * noise, 3 * noise)
        power = float(distance @ distance) + 1e-300
        lags = range(1, min(_LONGEST, len(distance) // 4))
        sums = [(1 - lag / _LONGEST) * float(distance[lag:] @ distance[:-lag]) for lag in lags]
        return float(np.clip(1 + 2 * sum(sums) / power, *_TIMES))

    def chi2(self, match: Match) -> float:
        """A χ² for comparing models: n log of the mean squared distance, with large ones tempered."""
        tempered = self.kernel**2 * np.log1p((match.distance / self.kernel) ** 2)
        squared = np.average(tempered, weights=match.length) + _FINEST**2
        return match.length.sum() / (2 * CORRELATED) * float(np.log(squared))

    def cauchy_weight(self, match: Match, noise: float) -> Float[np.ndarray, " n"]:
        """Weights for a heavy-tailed (Cauchy) distribution, by which wrong matches count for little."""
        return 1 / (1 + (match.distance / max(3 * noise, self.kernel)) ** 2)


@dataclasses.dataclass(frozen=True)
class MatchedOutline:
    """An outline that is ready to be matched with contours of one size.

    Attributes:
        seen: The outline.
        tree: The tree of its places and normals.
        some: Indices of the places that are matched with the contour, shape (n,).
        thin: Whether the model is so thin at each of these that it leaves no trace in a mask, and so has
            no counterpart there; shape (n,).
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
        """Matches the outline and a view's contour in both directions, by nearest features."""
        seen, some, contour = self.seen, self.some, view.contour
        forth = np.asarray(self.tree.query(view.tree.data)[1])
        _, back = view.tree.query(self.tree.data[some])
        share = len(seen.place) / len(some)
        trust = np.where(self.thin, 0.0, contour.trust(seen.place[some]))
        own, theirs = seen.normal[some], contour.normal[back]
        alike = np.sum(own * theirs, axis=-1, keepdims=True) > _ALIKE
        across = np.where(alike, own, theirs)
        return Match(
            np.concatenate([seen.uv[forth], seen.uv[some]]),
            np.concatenate([seen.place[forth], seen.place[some]]),
            np.concatenate([seen.normal[forth], across]),
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
    """The residuals of matched places; `root` is the root of their weights, divided by the noise."""
    matrix = contour.camera.matrix
    across = np.sum(match.normal * match.place, axis=-1, keepdims=True)
    plane = match.normal @ matrix[:2] - across * matrix[2]
    return Rows(match.uv, plane, np.tile(matrix[2], (len(plane), 1)), root)


def term_of_rows(parts: Sequence[Rows]) -> ContourDistance:
    """The term of all rows in sequence."""
    uv, plane, depth, root = map(np.concatenate, zip(*parts, strict=True))
    return ContourDistance(uv=uv, plane=plane, depth=depth, root=root, sigma=1.0)
