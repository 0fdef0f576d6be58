"""The protocol of a family of models: how its members are found in observations."""

from __future__ import annotations

import abc
from collections.abc import Iterator, Mapping, Sequence
from typing import ClassVar

from petalfit.components import Posed
from petalfit.fitting.coordinates import Coordinates
from petalfit.fitting.likelihood.cloud import ObservedCloud
from petalfit.fitting.likelihood.views import ObservedViews
from petalfit.fitting.request.request import Request
from petalfit.fitting.solver.iterate import Iterate
from petalfit.surfaces import AbstractSurface

EVERY_POSE = ("known", "rigid", "similarity")


class AbstractFamily(abc.ABC):
    """How the models of one kind are fitted.

    The rest of petalfit asks a family, and never the class of a model. `petalfit.register` makes a
    family known; it is then used for its kind and for subclasses that have no family of their own.

    Attributes:
        kind: The class of the models.
        poses: The poses in which one cloud can be fitted.
        gauges: For each pose that is not known, the parameters that it makes redundant: they keep the
            template's values.
        is_petal: Whether it takes part in model="auto".
        takes: Options beyond the target, the pose and the loss that its fits use.
        fewest: The least number of points; None for one more than there are free parameters.
        sees_outlines: Whether it can be fitted to silhouettes, and to several targets jointly.
        finds_outliers: Whether points may be outliers.
        named_errors: Whether its parameters are free, and have errors.
    """

    kind: ClassVar[type[AbstractSurface]]
    poses: ClassVar[tuple[str, ...]] = ("known",)
    gauges: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    is_petal: ClassVar[bool] = False
    takes: ClassVar[frozenset[str]] = frozenset({"free", "init", "noise", "seed"})
    fewest: ClassVar[int | None] = None
    sees_outlines: ClassVar[bool] = True
    finds_outliers: ClassVar[bool] = True
    named_errors: ClassVar[bool] = True

    @abc.abstractmethod
    def fit_cloud(self, request: Request) -> list[Iterate]:
        """Fit the family to one cloud, in the pose that the request asks for.

        Args:
            request: Its only target is a cloud. `free_in` says which names are free in its pose.

        Returns:
            The end of each start, the best first, in the target's frame and unit. Models are `Posed`
            unless the pose is known. The residuals of the best are those of all points as they came.
            Call it inside `jax.enable_x64(True)`.
        """

    def free_in(self, pose: str, free: tuple[str, ...]) -> tuple[str, ...]:
        """All that is free in a pose: what it leaves of the free parameters, and its own."""
        redundant = self.gauges.get(pose, ())
        return (*(name for name in free if name not in redundant), *Posed.free_in(pose))

    def rough(self, coordinates: Coordinates) -> Coordinates:
        """Coordinates that hold what no outline shows while the rest is only roughly right."""
        return coordinates

    def refined(
        self,
        coordinates: Coordinates,
        rough: AbstractSurface,
        clouds: Sequence[ObservedCloud],
        views: ObservedViews,
    ) -> Iterator[tuple[str, AbstractSurface]]:
        """More starts of a joint fit, with their labels, beside one that `rough` coordinates found.

        Args:
            coordinates: Free parameters.
            rough: The start that was found, which follows the outlines.
            clouds: All clouds of the fit.
            views: All silhouettes of the fit.
        """
        del coordinates, rough, clouds, views
        yield from ()

    def outcome(self, end: Iterate) -> str:
        """How a fit that converged says so."""
        return f"converged after {end.rounds} rounds"
