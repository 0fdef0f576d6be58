"""Estimation of a discrepancy by restricted likelihood, and what it adds to the errors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import eigh
from scipy.spatial.distance import cdist

from petalfit.results.discrepancy import Discrepancy

# Lengths that are tried, relative to the extent of the surface. The parameters absorb longer fields
# nearly wholly, and a longer and stronger rough field looks like a shorter one, σ²/ℓ³ being equal.
_LENGTHS = (0.02, 0.035, 0.06, 0.1, 0.17)
_STRONG = 2.0  # standard deviation of the prior on the field's own, in root mean square distances
_RATIOS = 10.0 ** np.linspace(-3, 5, 49)  # of the variances of field and noise
CELLS = 14  # cells per side of the domain, whose means the field is estimated from
_FEWEST = 4  # least number of cells for every parameter
# 2 log likelihood ratio from which on there is a field; by chance, noise alone exceeds it in 1 % of fits.
_CLEAR = 9.0
_SUSPECT = 1.0  # standard deviations of the squares of cell means, from which a field is looked for
INDEPENDENT = 100.0  # independent points that a cloud with a discrepancy counts as, at least
_ABSORBED = 1e-6  # least effect of a direction of the parameters, relative to the greatest
# Root of the information on a parameter, relative to the greatest. What is less may be rounding.
_UNTOLD = 1e-6
_EXACT = 1e-7  # noise, relative to the extent, below which only rounding is left


class Rows(NamedTuple):
    """What the likelihood of a cloud depends on, linearised: one row for each point.

    Attributes:
        place: Foot points in space, shape (n, 3).
        cell: The cell of the domain that each foot point lies in, shape (n,).
        distance: Signed distances, shape (n,).
        weights: Weights, shape (n,).
        slopes: Derivatives of the distances by the parameters, shape (n, p).
        edge: The same of the distances beyond the edge, times the curvature of their likelihood in units
            of 1/σ², shape (n, p).
        sigma: The noise that the fit assumed.
        information: Their Fisher information, if all distances are independent noise, shape (p, p).
    """

    place: Float[np.ndarray, "n 3"]
    cell: Int[np.ndarray, " n"]
    distance: Float[np.ndarray, " n"]
    weights: Float[np.ndarray, " n"]
    slopes: Float[np.ndarray, "n p"]
    edge: Float[np.ndarray, "n p"]
    sigma: float
    information: Float[np.ndarray, "p p"]


class _Trial(NamedTuple):
    """One correlation, with the log posterior and the variance of the noise at all of `_RATIOS`."""

    length: float
    smooth: bool
    correlation: Float[np.ndarray, "m m"]
    likelihood: Float[np.ndarray, " k"]
    noise: Float[np.ndarray, " k"]


class _Means(NamedTuple):
    """Weighted means over cells, and what is left of the squares within cells."""

    place: Float[np.ndarray, "m 3"]
    distance: Float[np.ndarray, " m"]
    slopes: Float[np.ndarray, "m p"]
    edge: Float[np.ndarray, "m p"]
    total: Float[np.ndarray, " m"]
    within: float
    freedom: float


def discrepancy_of(
    rows: Rows,
) -> tuple[Discrepancy, Float[np.ndarray, "p p"]] | None:
    """The likeliest discrepancy, and the covariance that it adds to the derivative of the cost.

    None if noise alone explains the distances, or if there are too few cells to tell.
    """
    means = _means(rows)
    m, p = means.slopes.shape
    if m < _FEWEST * p:
        return None
    root = np.sqrt(means.total)
    extent = float(np.linalg.norm(np.ptp(means.place, axis=0)))
    if rows.sigma < _EXACT * extent:
        return None
    # What the parameters cannot absorb: the complement of what their slopes span. What is left of slopes
    # that vanish, those of edges, and of directions in which parameters say the same, as a pose's scale
    # and all lengths do, is rounding, which must not choose directions.
    told = np.sqrt(np.diag(rows.information))
    told = np.maximum(told, _UNTOLD * np.max(told) + 1e-300)
    whole, sizes, _ = np.linalg.svd(root[:, None] * means.slopes / told)
    rest = whole[:, np.count_nonzero(sizes > _ABSORBED * sizes[0]) :]
    left = rest.T @ (root * means.distance)
    apart = cdist(means.place, means.place)
    alone = _none(left, means)
    trials: list[_Trial] = []
    for length in _LENGTHS:
        for smooth in (True, False):
            correlation = _correlation(apart / (length * extent), smooth)
            kernel = rest.T @ (root[:, None] * correlation * root) @ rest
            likelihood, noise = _restricted(kernel, left, means)
            strength = noise * _RATIOS / (_STRONG * rows.sigma) ** 2
            trial = _Trial(length * extent, smooth, correlation, likelihood - strength / 2, noise)
            trials.append(trial)
    highest = max(trial.likelihood.max() for trial in trials)
    if 2 * (highest - alone) < _CLEAR:
        return None
    # The likelihood hardly tells a long and weak field from a short and strong one: all are averaged.
    parts = [np.exp(trial.likelihood - highest) for trial in trials]
    total = sum(float(part.sum()) for part in parts)
    field = sum(
        float(part @ (trial.noise * _RATIOS)) / total * trial.correlation
        for part, trial in zip(parts, trials, strict=True)
    )
    pulls = means.total[:, None] * np.hstack([means.slopes, means.edge]) / rows.sigma**2
    both = pulls.T @ field @ pulls
    # The field moves points along the normal and within the surface, independently of each other.
    added = both[:p, :p] + both[p:, p:]
    best = max(trials, key=lambda trial: trial.likelihood.max())
    k = int(np.argmax(best.likelihood))
    deviation, noise = np.sqrt(best.noise[k] * _RATIOS[k]), np.sqrt(best.noise[k])
    inverse = np.linalg.pinv(rows.information, rcond=1e-10, hermitian=True)
    inflation = 1 + float(np.trace(inverse @ added)) / p
    found = Discrepancy(float(deviation), best.length, float(noise), best.smooth, inflation)
    return found, added


def temperature(rows: Rows, added: Float[np.ndarray, "p p"], total: float) -> float:
    """The temperature T at which the likelihood of a cloud with a discrepancy is used, at least 1.

    Points that a field moves together do not count as so many independent ones: −log L is divided by T,
    as in the power likelihoods of Miller and Dunson (2019). T is the lower quartile, over independent
    directions, of the factors by which the field increases variances, so that most directions remain
    less certain than the likelihood says. A cloud counts as at least `INDEPENDENT` points.

    Args:
        rows: The rows of the likelihood.
        added: What the field adds to the covariance of the derivative of the cost, shape (p, p).
        total: The weight of all points.
    """
    scale = 1 / np.sqrt(np.maximum(np.diag(rows.information), 1e-300))
    scales = np.outer(scale, scale)
    noise = rows.information * scales + 1e-9 * np.eye(len(scale))
    factors = 1 + eigh(added * scales, noise, eigvals_only=True)
    return float(np.clip(np.quantile(factors, 0.25), 1.0, max(total / INDEPENDENT, 1.0)))


def is_suspect(
    cell: Int[np.ndarray, " n"],
    distance: Float[np.ndarray, " n"],
    weights: Float[np.ndarray, " n"],
    free: int,
) -> bool:
    """Whether the means of cells differ by more than noise makes them: a quick first look.

    Args:
        cell: The cell of each point.
        distance: Signed distances.
        weights: Weights.
        free: The number of free parameters.
    """
    some = weights > 0
    total, (mean,), within, freedom = _over_cells(cell[some], weights[some], distance[some])
    if not freedom or not within:
        return False
    squares = float(np.sum(total * mean**2)) / (within / freedom)
    return bool(squares > len(total) - free + _SUSPECT * np.sqrt(2 * len(total)))


def _means(rows: Rows) -> _Means:
    some = rows.weights > 0
    columns = np.column_stack([rows.distance, rows.place, rows.slopes, rows.edge])[some]
    total, means, within, freedom = _over_cells(rows.cell[some], rows.weights[some], *columns.T)
    distance, place, slopes, edge = np.split(
        np.stack(means, axis=-1), np.cumsum([1, 3, rows.slopes.shape[1]]), axis=1
    )
    return _Means(place, distance[:, 0], slopes, edge, total, within, freedom)


def _over_cells(
    cell: Int[np.ndarray, " n"],
    weights: Float[np.ndarray, " n"],
    distance: Float[np.ndarray, " n"],
    *others: Float[np.ndarray, " n"],
) -> tuple[Float[np.ndarray, " m"], list[Float[np.ndarray, " m"]], float, float]:
    """Weights of the cells, means of all columns, squares of distances within cells, and their number."""
    _, cell = np.unique(cell, return_inverse=True)
    total = np.bincount(cell, weights)
    means = [np.bincount(cell, weights * column) / total for column in (distance, *others)]
    within = float(np.sum(weights * (distance - means[0][cell]) ** 2))
    return total, means, within, max(float(np.sum(weights)) - len(total), 0.0)


def _correlation(apart: Float[np.ndarray, "m m"], smooth: bool) -> Float[np.ndarray, "m m"]:
    """Correlations at distances in units of the length."""
    if smooth:
        return np.exp(-0.5 * apart**2)
    reach = np.sqrt(3.0) * apart
    return (1 + reach) * np.exp(-reach)


def _none(left: np.ndarray, means: _Means) -> float:
    """Restricted log likelihood without a field."""
    count = means.freedom + len(left)
    noise = (means.within + float(left @ left)) / count
    return -0.5 * count * float(np.log(noise))


def _restricted(
    kernel: Float[np.ndarray, "r r"], left: np.ndarray, means: _Means
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Restricted log likelihood and variance of the noise for every ratio of the variances."""
    values, vectors = eigh(kernel)
    squares = (vectors.T @ left) ** 2
    grown = 1 + _RATIOS[:, None] * np.maximum(values, 0.0)
    count = means.freedom + len(left)
    noise = (means.within + np.sum(squares / grown, axis=1)) / count
    return -0.5 * count * np.log(noise) - 0.5 * np.sum(np.log(grown), axis=1), noise
