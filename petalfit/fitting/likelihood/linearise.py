"""The linearisation of a cloud's likelihood at given foot points."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from petalfit.fitting.coordinates import Coordinates, Numbers
from petalfit.residuals import (
    ContourDistance,
    Data,
    Frame,
    edge_score,
    estimated_noise,
    frames,
    places,
    pulled,
)
from petalfit.surfaces import AbstractSurface


class Linearisation(NamedTuple):
    """Distances, their derivatives with respect to the coordinates t, and Fisher information.

    Attributes:
        position: Positions S of the foot points, shape (n, 3).
        normal: Unit normals, shape (n, 3).
        distance: Signed normal distances d, positive on the normal's side, shape (n,).
        slopes: ∂d/∂t, shape (n, p).
        edge: ∂e/∂t of the distance e beyond the nearer edge, times the curvature of its likelihood in
            units of 1/σ², shape (n, p).
        beyond: Distances beyond the nearer u edge and v edge, negative inside, shape (n, 2).
        sigma: Noise, given or estimated from the distances.
        information: Fisher information of t at this noise, shape (p, p): normal distances count by their
            Jacobian, points near the edge by the square of their score.
    """

    position: Float[np.ndarray, "n 3"]
    normal: Float[np.ndarray, "n 3"]
    distance: Float[np.ndarray, " n"]
    slopes: Float[np.ndarray, "n p"]
    edge: Float[np.ndarray, "n p"]
    beyond: Float[np.ndarray, "n 2"]
    sigma: float
    information: Float[np.ndarray, "p p"]


def slopes_at(
    coordinates: Coordinates,
    model: AbstractSurface,
    t: Float[np.ndarray, " p"],
    uv: Float[Numbers, "m 2"],
    covectors: Float[Numbers, "m 3"],
    position: Float[np.ndarray, "m 3"],
) -> Float[np.ndarray, "m p"]:
    """The derivatives of w·S(u, v) with respect to t, for places on the model at t.

    Args:
        coordinates: The free parameters.
        model: The model at t.
        t: Coordinates of the free parameters.
        uv: The places.
        covectors: A covector w for each place.
        position: The positions S of the places.
    """
    slopes = pulled(model, uv, np.asarray(covectors), coordinates.free, position)
    return slopes * coordinates.slopes(t)


def tangents_at(
    coordinates: Coordinates, t: Float[np.ndarray, " p"], uv: Float[Numbers, "n 2"]
) -> tuple[Frame, Float[np.ndarray, "n p"]]:
    """The frames of the model at t, and the derivatives with respect to t of distances from them."""
    model = coordinates.model(t)
    here = frames(model, uv)
    return here, -slopes_at(coordinates, model, t, uv, here.normal, here.position)


def contour_slopes(
    coordinates: Coordinates, t: Float[np.ndarray, " p"], term: ContourDistance
) -> Float[np.ndarray, "n p"]:
    """Derivatives with respect to t of a contour's residuals, in units of its noise."""
    model = coordinates.model(t)
    position = places(model, term.uv)
    return slopes_at(coordinates, model, t, term.uv, term.covectors(position), position)


def linearise(
    coordinates: Coordinates, data: Data, t: Float[np.ndarray, " p"], uv: Float[Numbers, "n 2"]
) -> Linearisation:
    """Linearises the distances of a cloud to the surface at t, at given foot points."""
    here, slopes = tangents_at(coordinates, t, uv)
    distance, beyond = here.distance(data.points), here.beyond(data.points)
    sigma = estimated_noise(data, distance, len(t))
    score = edge_score(beyond / sigma)
    outward = np.sum(score[..., None] * here.conormals, axis=1)
    edge = -slopes_at(coordinates, coordinates.model(t), t, uv, outward, here.position)
    root = (np.sqrt(data.weights) / sigma)[:, None]
    information = np.sum([(root * x).T @ (root * x) for x in (slopes, edge)], axis=0)
    # The second derivative of −log Φ(−e) is h(h − e), with h the first one.
    excess = np.max(score, axis=1) - np.max(beyond, axis=1) / sigma
    bent = np.where(np.max(score, axis=1) > 0, np.maximum(excess, 0.0), 0.0)
    return Linearisation(
        here.position,
        here.normal,
        distance,
        slopes,
        edge * bent[:, None],
        beyond,
        sigma,
        information,
    )
