"""From observations to likelihoods: for each kind of observation, what a solver compares a model with."""

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
    """Observations that are compared with a model together.

    Attributes:
        observed: Their likelihood.
        numbers: Their numbers among the targets.
    """

    observed: AbstractObserved
    numbers: tuple[int, ...]


Maker = Callable[
    [Sequence[AbstractObservation], Request, np.random.Generator], list[AbstractObserved]
]


def _clouds(
    clouds: Sequence[AbstractObservation], request: Request, rng: np.random.Generator
) -> list[AbstractObserved]:
    """Each cloud by itself, with its own noise, and its own outliers if the loss finds any."""
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
    """All silhouettes together, so that their number changes no program but its size."""
    del request, rng
    return [ObservedViews.of([Contour.of(x) for x in masks if isinstance(x, Silhouette)])]


# One line for each kind. A maker gives one likelihood for each observation, or one for all of them.
MAKERS: dict[type[AbstractObservation], Maker] = {
    PointCloud: _clouds,
    Silhouette: _silhouettes,
}


def observe(request: Request) -> tuple[Part, ...]:
    """The likelihoods of all targets, kind by kind.

    Raises:
        TargetError: There is a target of a kind that no likelihood is known for.
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
