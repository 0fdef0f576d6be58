"""Evaluation of the end of an optimisation: residuals, information, and removal of the bias."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from petalfit.fitting.coordinates import Coordinates, Prior, with_values
from petalfit.fitting.likelihood.observed import AbstractObserved
from petalfit.fitting.solver.iterate import Iterate
from petalfit.surfaces import AbstractSurface

# Corrections at most, and the square of one in standard errors that is none any more.
_CORRECTIONS, _CORRECTED = 5, 1e-9
Surface = TypeVar("Surface", bound=AbstractSurface)


def evaluate(
    coordinates: Coordinates[Surface],
    label: str,
    observed: Sequence[AbstractObserved],
    end: Iterate[Surface],
) -> Iterate[Surface]:
    """The end of a fit with its label, residuals and χ², by which it is compared with other ends.

    The information, which takes longer, is not computed.
    """
    t = coordinates.inverse(end.model)
    residuals = [
        part
        for x, term in zip(observed, end.terms, strict=True)
        for part in x.residuals(coordinates, t, term)
    ]
    chi2 = sum(part.chi2 for part in residuals)
    return dataclasses.replace(end, label=label, residuals=tuple(residuals), chi2=chi2)


def without_bias(
    coordinates: Coordinates[Surface],
    label: str,
    observed: Sequence[AbstractObserved],
    end: Iterate[Surface],
    prior: Prior | None = None,
) -> Iterate[Surface]:
    """Removes the bias of an end, and adds converged foot points, residuals and information."""
    begun = coordinates.inverse(end.model)
    t = begun
    found = [
        x.score_and_information(coordinates, t, term)
        for x, term in zip(observed, end.terms, strict=True)
    ]
    information = np.sum([part.information for part in found], axis=0)
    covariance = np.sum([part.score_covariance for part in found], axis=0)
    scales = np.outer(coordinates.slopes(t), coordinates.slopes(t))
    root = np.zeros(len(t)) if prior is None else np.asarray(prior.root)
    best, least, pairs = t, np.inf, list(zip(observed, found, strict=True))
    for _ in range(_CORRECTIONS):
        left = np.sum([x.remaining(coordinates, t, t - begun, part) for x, part in pairs], axis=0)
        step = _correction(information, root, left - (1 + root**2) * (t - begun))
        size = float(step @ information @ step)
        if size < least:
            best, least = t, size
        if not size > _CORRECTED:
            break
        t = t + step
    t = best
    values = dict(zip(coordinates.free, coordinates.values(t), strict=True))
    model = with_values(coordinates.template, values)
    # The foot points move only along the surface, which changes no distance to first order.
    corrected = dataclasses.replace(end, model=model, terms=tuple(part.term for part in found))
    return dataclasses.replace(
        evaluate(coordinates, label, observed, corrected),
        information=information / scales,
        score_covariance=covariance / scales,
    )


def _correction(
    information: Float[np.ndarray, "p p"], root: Float[np.ndarray, " p"], score: np.ndarray
) -> Float[np.ndarray, " p"]:
    """The Gauss-Newton step that cancels a score; zero if it cannot be computed."""
    nowhere = np.zeros(len(root))
    if not (np.isfinite(information).all() and np.isfinite(score).all()):
        return nowhere
    step = np.linalg.solve(information + np.eye(len(root)) + np.diag(root**2), score)
    # A bias beyond a few standard errors is no small correction any more: the step is limited to three.
    size = np.sqrt(step @ information @ step / len(step))
    return step * min(1.0, 3.0 / max(size, 1e-300)) if np.isfinite(size) else nowhere
