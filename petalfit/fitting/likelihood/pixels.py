"""The errors that pixels cause in a contour, measured on pictures of the fitted model itself.

A mask's contour differs from the outline by up to half a pixel, in a pattern that depends on where the
outline runs through the grid. Errors of neighbouring places are correlated, and corners are cut off on
one side, so that no formula for independent errors holds. Masks of the fitted model are therefore made
with the grid shifted by random fractions of a pixel, and their contours are matched like the target's.
The mean of the cost's derivative over these masks is the cause of a bias, and its covariance that of the
errors. With the grid unshifted, the simulated contour has the errors of the target's, as far as the mask
has no other noise. The correlation of the two shows how far, and that part is corrected as well, in a few
steps: the fit ends where a picture of the model has the score of the target.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from petalfit.fitting.coordinates import Coordinates
from petalfit.fitting.likelihood.linearise import contour_slopes
from petalfit.fitting.likelihood.matching import Match, MatchedOutline, View, rows, term_of_rows
from petalfit.observations import Contour, trace
from petalfit.surfaces import AbstractSurface, Outline, coverage, outline, outline_rings

_PICTURES = 32
_RINGS = (193, 129)  # vertices of the mesh whose masks are made
# Least part of the covariance that remains: no picture repeats all errors of the target, and corrections
# end where pictures change by leaps. Measured on 40 flat blades.
_LEFT = 0.75
# If the variance of residuals exceeds that of pictures by less than this fraction, pixels explain it all.
_NOISY = 0.15
_MOST = 600  # largest number of places of a contour for the covariance of its noise
_HALF = 1.177  # standard deviations at which a Gaussian falls to one half
# A parameter that shows in fewer pixels of the contour than this is not resolved. The place of the part
# that it moves is uncertain by half a pixel in a binary mask and a tenth in one of coverage, at least by
# 1.5 times the noise, and by more still if it shows in even fewer pixels.
_RESOLVED = 15.0
_BLUR = {True: 0.5, False: 0.1}


class PixelErrors(NamedTuple):
    """The effect of pixels on the cost of one view, in the coordinates t.

    Attributes:
        score: Expected derivative of the cost at the true parameters, shape (p,).
        begun: The derivative for the target's contour at these parameters, shape (p,).
        score_covariance: Covariance of that derivative, shape (p, p).
        likeness: The part of a simulated contour's errors, with the grid unshifted, that the target
            shares; from 0 to 1.
        noise: Standard deviation of the contour's distances that weights were computed with, in pixels.
        time: The number of pixels that counted as one observation.
    """

    score: Float[np.ndarray, " p"]
    begun: Float[np.ndarray, " p"]
    score_covariance: Float[np.ndarray, "p p"]
    likeness: float
    noise: float
    time: float


class _Scorer(NamedTuple):
    """Computes derivatives of the cost for contours that are matched with one outline.

    Attributes:
        model: The surface.
        view: The view of the target.
        matched: The model's outline.
        slopes: Derivatives with respect to t of the outline's places along their normals, in pixels,
            shape (n, p).
        noise: Standard deviation of the contour's distances, in pixels.
        time: The number of pixels that count as one observation.
    """

    model: AbstractSurface
    view: View
    matched: MatchedOutline
    slopes: Float[np.ndarray, "n p"]
    noise: float
    time: float

    def weighted(self, match: Match) -> Float[np.ndarray, " n"]:
        """Weights of the pairs of a match, divided by the variance of the noise."""
        share = match.length * self.view.cauchy_weight(match, self.noise)
        return share / (2 * self.time * self.noise**2)

    def rows(self, match: Match) -> Float[np.ndarray, "n p"]:
        """Derivatives with respect to t of the distances of a match."""
        return match.slopes(self.matched.seen, self.slopes)

    def score(self, match: Match) -> Float[np.ndarray, " p"]:
        """Derivative with respect to t of half the weighted sum of squared distances."""
        return self.rows(match).T @ (self.weighted(match) * match.distance)


def pixel_errors(
    coordinates: Coordinates, t: Float[np.ndarray, " p"], view: View, seed: int = 0
) -> PixelErrors:
    """Measures the errors that pixels cause, on pictures of the model at t compared with the target."""
    scorer, target = _scorer(coordinates, t, view)
    shifts = np.random.default_rng(seed).random((_PICTURES, 2))
    same, *others = _pictures(scorer, np.concatenate([np.zeros((1, 2)), shifts]))
    scores = np.array([scorer.score(match) for match in others])
    mean, spread = scores.mean(axis=0), np.cov(scores.T).reshape(len(t), len(t))
    # Distances are compared at the outline's places, which all matches share.
    middle = np.mean([match.distance[~match.forward] for match in others], axis=0)
    observed = target.distance[~target.forward] - middle
    simulated = same.distance[~same.forward] - middle
    cauchy = target.length[~target.forward] / (1 + (observed / view.kernel) ** 2)
    # Errors that the parameters can follow are left out: they may come from elsewhere, such as a cloud
    # that pulls at the outline.
    rows = np.sqrt(cauchy)[:, None] * scorer.rows(target)[~target.forward]
    basis = np.linalg.qr(np.concatenate([rows, 1e-3 * np.eye(len(t))]))[0][: len(rows)]
    one, other = (np.sqrt(cauchy) * distance for distance in (simulated, observed))
    one = one - basis @ (basis.T @ one)
    likeness = float(np.clip(one @ other / (one @ one + 1e-300), 0.0, 1.0))
    expected = np.mean([_variance(match) for match in others])
    excess = max(0.0, 1 - float(expected) / max(_variance(target), 1e-300))
    spread = max(1 - likeness**2, _LEFT) * spread
    if excess > _NOISY:
        spread = spread + _of_noise(scorer, target, excess)
    spread = spread + _unresolved(scorer, target)
    begun = scorer.score(target)
    return PixelErrors(mean, begun, spread, likeness, scorer.noise, scorer.time)


def repeated(
    coordinates: Coordinates, t: Float[np.ndarray, " p"], view: View, errors: PixelErrors
) -> Float[np.ndarray, " p"]:
    """The score that pixels cause at t, less the change of the target's score on the way there.

    As far as the target shares the errors of the picture with the grid unshifted, pixels cause that
    picture's score; else the mean one.
    """
    scorer, target = _scorer(coordinates, t, view, errors.noise, errors.time)
    (same,) = _pictures(scorer, np.zeros((1, 2)))
    share = errors.likeness
    expected = share * scorer.score(same) + (1 - share) * errors.score
    return expected - (scorer.score(target) - errors.begun)


def slopes_of_outline(
    coordinates: Coordinates, t: Float[np.ndarray, " p"], contour: Contour, seen: Outline
) -> Float[np.ndarray, "n p"]:
    """Derivatives with respect to t of an outline's places along their normals, in pixels."""
    count = len(seen.uv)
    every = np.arange(count)
    match = Match(seen.uv, seen.place, seen.normal, seen.place, seen.length, every >= 0, every)
    term = term_of_rows([rows(contour, match, np.ones(count))])
    return contour_slopes(coordinates, t, term)


def _scorer(
    coordinates: Coordinates,
    t: np.ndarray,
    view: View,
    noise: float | None = None,
    time: float | None = None,
) -> tuple[_Scorer, Match]:
    model = coordinates.model(t)
    seen = outline(model, view.contour.camera)
    matched = MatchedOutline.of(view, seen)
    target = matched.match(view)
    slopes = slopes_of_outline(coordinates, t, view.contour, seen)
    noise = noise or view.noise(target)
    return _Scorer(
        model, view, matched, slopes, noise, time or view.correlated(target, noise)
    ), target


def _pictures(scorer: _Scorer, shifts: np.ndarray) -> list[Match]:
    """Matches for masks whose grid is shifted, of the part of the image that the model covers."""
    view, contour = scorer.view, scorer.view.contour
    rings = outline_rings(scorer.model, contour.camera, _RINGS)
    # Parts of the model beyond the image are cut off: there is nothing to compare them with.
    low = np.maximum(np.floor(np.min([ring.min(axis=0) for ring in rings], axis=0)) - 2, -2)
    high = np.ceil(np.max([ring.max(axis=0) for ring in rings], axis=0)) + 3
    high = np.minimum(high, np.array(contour.camera.shape[::-1]) + 3)
    columns, lines = np.maximum(high - low, 1).astype(int)
    matches = []
    for shift in shifts:
        mask = coverage([ring - low + shift for ring in rings], (int(lines), int(columns)))
        place, normal, length = trace(mask >= 0.5 if contour.binary else mask)
        if len(place) == 0:
            # The model is hardly in the image: no fit here has errors that matter.
            place, normal, length = contour.place, contour.normal, contour.length
        else:
            place = place + low - shift
        matches.append(scorer.matched.match(view.like(place, normal, length)))
    return matches


def _variance(match: Match) -> float:
    counts = match.forward & (match.length > 0)
    return float(np.median(np.abs(match.distance[counts]))) ** 2


def _of_noise(scorer: _Scorer, match: Match, excess: float) -> Float[np.ndarray, "p p"]:
    """Covariance of the score that noise causes, if it is correlated along the contour.

    The correlation is taken as a Gaussian of the distance along the contour, as wide as that of the
    target's distances. These are smaller than the noise, because the parameters have followed a part of
    it. The variance of the noise is the one that would leave such distances.

    Args:
        scorer: The cost.
        match: The match of the target.
        excess: The part of the residuals' variance that is noise, and not caused by pixels.
    """
    every = np.flatnonzero(match.forward)
    every = every[:: -(-len(every) // _MOST)]
    weights = 2 * scorer.weighted(match)[every]
    slopes = scorer.rows(match)[every]
    # Distances at corners that the noise has rounded off are no measure of it: they are clipped.
    distance = np.clip(match.distance[every], -3 * scorer.noise, 3 * scorer.noise)
    counts = weights > 0
    weights = weights * (np.sum(match.length[match.forward]) / np.sum(match.length[every]))
    inverse = np.linalg.inv((weights[:, None] * slopes).T @ slopes + np.eye(slopes.shape[1]))
    followed = slopes @ inverse @ (weights[:, None] * slopes).T
    left = np.eye(len(every)) - followed
    lag = np.abs(np.subtract.outer(np.arange(len(every)), np.arange(len(every))))
    lag = np.minimum(lag, len(every) - lag)
    width = _half_lag(distance, counts) / _HALF
    noise = np.exp(-0.5 * (lag / width) ** 2)
    residual = np.diag(left @ noise @ left.T)
    variance = excess * np.sum(distance[counts] ** 2) / np.sum(residual[counts])
    # The variance is estimated from few independent stretches of contour: its error widens the
    # distribution to Student's.
    stretches = np.count_nonzero(counts) / (np.sqrt(2 * np.pi) * max(width, 0.4)) - slopes.shape[1]
    variance *= max(stretches, 4.0) / (max(stretches, 4.0) - 2)
    parts = weights[:, None] * slopes
    return variance * parts.T @ noise @ parts


def _half_lag(distance: np.ndarray, counts: np.ndarray) -> float:
    """The number of places along the contour at which the correlation of distances falls to one half."""
    distance, before = np.where(counts, distance, 0.0), 1.0
    power = float(np.mean(distance[counts] ** 2)) + 1e-300
    for lag in range(1, len(distance) // 4):
        pairs = max(int(np.count_nonzero(counts[lag:] & counts[:-lag])), 1)
        here = float(distance[lag:] @ distance[:-lag]) / pairs / power
        if here < 0.5:
            return lag - 1 + (before - 0.5) / max(before - here, 1e-12)
        before = here
    return len(distance) / 4


def _unresolved(scorer: _Scorer, match: Match) -> Float[np.ndarray, "p p"]:
    """Covariance of the score for parameters that show in few pixels only, where slopes mislead."""
    rows = scorer.rows(match)[match.forward]
    weighted = 2 * scorer.weighted(match)[match.forward, None] * rows
    power = weighted * rows
    total = power.sum(axis=0) + 1e-300
    pixels = total**2 / (np.sum(power**2, axis=0) + 1e-300)
    length = float(match.length[match.forward].mean())
    blur = max(_BLUR[scorer.view.contour.binary], 1.5 * scorer.noise)
    blur = blur * (_RESOLVED / (pixels * length + 1e-9)) ** 2
    # Speed: pixels by which one unit of t moves the contour. The error of t is at most the typical range.
    speed = np.sum(power * np.abs(rows), axis=0) / total + 1e-9
    information = weighted.T @ rows
    return (information * np.where(blur < speed, blur / speed, 1.0) ** 2) @ information
