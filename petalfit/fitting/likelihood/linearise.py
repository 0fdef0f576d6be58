"""The linearisation of a cloud's likelihood at given foot points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from petalfit.fitting.coordinates import Coordinates
from petalfit.residuals import Data, edge_score, estimate_sigma, frame, pull_back


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

    position: Float[Array, "n 3"]
    normal: Float[Array, "n 3"]
    distance: Float[Array, " n"]
    slopes: Float[Array, "n p"]
    edge: Float[Array, "n p"]
    beyond: Float[Array, "n 2"]
    sigma: Float[Array, ""]
    information: Float[Array, "p p"]


def linearise(
    coordinates: Coordinates, data: Data, t: Float[Array, " p"], uv: Float[Array, "n 2"]
) -> Linearisation:
    """Linearises the distances of a cloud to the surface at t, at given foot points."""
    model = coordinates.model(t)
    here = frame(model, uv)
    distance, beyond = here.distance(data.points), here.beyond(data.points)
    sigma = estimate_sigma(data, distance, len(t))
    score = edge_score(beyond / sigma)
    edge = jnp.sum(score[..., None] * here.conormals, axis=1)
    pulled = pull_back(model, jnp.tile(uv, (2, 1)), -jnp.concatenate([here.normal, edge]))
    slopes = coordinates.gather(pulled) * coordinates.slopes(t)
    rows = slopes * (jnp.sqrt(jnp.tile(data.weights, 2)) / sigma)[:, None]
    information = rows.T @ rows
    # The second derivative of −log Φ(−e) is h(h − e), with h the first one.
    excess = jnp.max(score, axis=1) - jnp.max(beyond, axis=1) / sigma
    bent = jnp.where(jnp.max(score, axis=1) > 0, jnp.maximum(excess, 0.0), 0.0)
    return Linearisation(
        here.position,
        here.normal,
        distance,
        slopes[: len(uv)],
        slopes[len(uv) :] * bent[:, None],
        beyond,
        sigma,
        information,
    )


def together(parts: Sequence[Linearisation]) -> Linearisation:
    """The linearisation of several blocks of points at once."""
    rows = {
        name: jnp.asarray(np.concatenate([getattr(part, name) for part in parts]))
        for name in Linearisation._fields
        if name not in ("sigma", "information")
    }
    information = jnp.asarray(np.sum([part.information for part in parts], axis=0))
    return parts[0]._replace(**rows, information=information)
