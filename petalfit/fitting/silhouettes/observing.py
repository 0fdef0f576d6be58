"""The likelihoods of observations: for each kind, a function that makes them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from petalfit.fitting.likelihood.cloud import ObservedCloud
from petalfit.fitting.likelihood.observed import AbstractObserved
from petalfit.fitting.likelihood.views import ObservedViews
from petalfit.fitting.request.request import Request
from petalfit.observations import AbstractObservation, Contour, PointCloud, Silhouette, TargetError


class Part(NamedTuple):
    """Observations that share one likelihood.

    Attributes:
        observed: The likelihood.
        numbers: Indices of the observations among the targets.
    """

    observed: AbstractObserved
    numbers: tuple[int, ...]


Maker = Callable[
    [Sequence[AbstractObservation], Request, np.random.Generator], list[AbstractObserved]
]


def _clouds(
    clouds: Sequence[AbstractObservation], request: Request, rng: np.random.Generator
) -> list[AbstractObserved]:
    """One likelihood for each cloud, with its own noise, and its own outliers if the loss finds any."""
    made: list[AbstractObserved] = []
    for cloud in clouds:
        assert isinstance(cloud, PointCloud)
        background = request.loss.background(cloud.points[cloud.mass > 0])
        weigh = None if background is None else background.mixture
        made.append(ObservedCloud.used(cloud, request.noise, rng, weigh))
    return made


def _silhouettes(
    masks: Sequence[AbstractObservation], request: Request, rng: np.random.Generator
) -> list[AbstractObserved]:
    """One likelihood for all silhouettes, so that one program serves any number of them."""
    del request, rng
    return [ObservedViews.of([Contour.of(x) for x in masks if isinstance(x, Silhouette)])]


# One line for each kind of observation. A maker returns one likelihood for each, or one for all of them.
MAKERS: dict[type[AbstractObservation], Maker] = {
    PointCloud: _clouds,
    Silhouette: _silhouettes,
}


def observe(request: Request) -> tuple[Part, ...]:
    """The likelihoods of all targets, kind by kind.

    Raises:
        TargetError: No likelihood is known for a kind of target.
    """
    rng = np.random.default_rng(request.seed)
    parts: list[Part] = []
    for target in request.targets:
        if type(target) not in MAKERS:
            known = ", ".join(kind.__name__ for kind in MAKERS)
            raise TargetError(
                f"a {type(target).__name__} cannot be fitted: its likelihood is not known, only those of "
                f"{known}."
            )
    for kind, make in MAKERS.items():
        numbers = [k for k, target in enumerate(request.targets) if type(target) is kind]
        if not numbers:
            continue
        made = make([request.targets[k] for k in numbers], request, rng)
        groups = [(k,) for k in numbers] if len(made) == len(numbers) else [tuple(numbers)]
        parts += [Part(x, group) for x, group in zip(made, groups, strict=True)]
    return tuple(parts)
