"""The protocol of a family of models: how they are fitted to observations."""

from __future__ import annotations

import abc
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import ClassVar

from petalfit.components import Posed
from petalfit.fitting.coordinates import Coordinates
from petalfit.fitting.likelihood.cloud import ObservedCloud
from petalfit.fitting.likelihood.views import ObservedViews
from petalfit.fitting.request.request import Request
from petalfit.fitting.solver.iterate import Iterate
from petalfit.observations import Silhouette
from petalfit.surfaces import AbstractSurface


class AbstractFamily(abc.ABC):
    """A family of models: it knows how the models of one kind are fitted.

    The rest of petalfit asks the family of a model, and never the model's class. `petalfit.register` adds
    a family, which is then used for its kind and for subclasses that have no family of their own.

    Attributes:
        kind: The class of the models.
        poses: The poses in which a single cloud can be fitted.
        gauges: The parameters that a fitted pose makes redundant, by the name of the pose. They keep the
            template's values.
        is_petal: Whether the family takes part in model="auto".
        takes: Names of the options that its fits use, besides the target, the pose and the loss.
        fewest: The least number of points of a cloud; None for one more than there are free parameters.
        sees_outlines: Whether its models can be fitted to silhouettes, and to several targets jointly.
        finds_outliers: Whether its fits accept a loss that allows for outliers.
        named_errors: Whether its parameters are free, and have errors.
        late: Names of the parameters that follow outlines only once the others nearly do: a search for
            starts among outlines keeps the template's values.
        depth: Names of the parameters that bend its models out of a plane. A single outline hardly shows
            them: they keep the template's values, and are not determined.
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
    late: ClassVar[tuple[str, ...]] = ()
    depth: ClassVar[tuple[str, ...]] = ()

    @abc.abstractmethod
    def fit_cloud(self, request: Request) -> list[Iterate]:
        """Fits a model of the family to one cloud, in the pose that the request asks for.

        Call it inside `jax.enable_x64(True)`.

        Args:
            request: A request whose only target is a cloud. `free_in` gives the names that are free in
                its pose.

        Returns:
            The end of each start, the best first, in the target's frame and unit. Models are `Posed`
            unless the pose is known. The best end has the residuals of all points, in the given order.
        """

    def free_in(self, pose: str, free: tuple[str, ...]) -> tuple[str, ...]:
        """Names that are free in a pose: the parameters that it does not make redundant, and its own."""
        return (*self.not_redundant(pose, free), *Posed.free_in(pose))

    def free_in_image(self, free: tuple[str, ...]) -> tuple[str, ...]:
        """Names that are free in an image of unknown scale, where the same are redundant as in space."""
        return (*self.not_redundant("similarity", free), *Posed.in_image)

    def not_redundant(self, pose: str, free: tuple[str, ...]) -> tuple[str, ...]:
        """The names without those of the parameters that a pose makes redundant."""
        redundant = self.gauges.get(pose, ())
        return tuple(name for name in free if name not in redundant)

    def foresee(
        self, template: AbstractSurface, free: tuple[str, ...], pose: str
    ) -> tuple[Callable[[], None], ...]:
        """Begins to compile, beside what follows, programs that a fit to a cloud will need.

        Call it inside `jax.enable_x64(True)`.

        Args:
            template: A component of the family.
            free: Names of the free parameters.
            pose: "known", "rigid" or "similarity".

        Returns:
            Functions that wait until some of them are compiled.
        """
        del template, free, pose
        return ()

    def hidden_from(self, request: Request) -> tuple[str, ...]:
        """Names of the parameters that the targets of a request cannot show."""
        first, *others = request.targets
        if others or not isinstance(first, Silhouette):
            return ()
        return self.depth

    def rough(self, coordinates: Coordinates) -> Coordinates:
        """Coordinates for a first, rough fit to outlines; parameters that show only later are held."""
        return coordinates

    def refined(
        self,
        coordinates: Coordinates,
        rough: AbstractSurface,
        clouds: Sequence[ObservedCloud],
        views: ObservedViews,
    ) -> Iterator[tuple[str, AbstractSurface]]:
        """Further starts of a joint fit, with their labels, made from one that `rough` coordinates found.

        Args:
            coordinates: The free parameters.
            rough: The model of the start that was found, which follows the outlines.
            clouds: All clouds of the fit.
            views: All silhouettes of the fit.
        """
        del coordinates, rough, clouds, views
        yield from ()

    def the_other_way(self, posed: Posed) -> Posed | None:
        """A model with nearly the same outline, with its tip where the base was; None if there is none.

        Args:
            posed: A model that is seen from the front in an image.
        """
        del posed
        return None

    def is_usual_way(self, model: AbstractSurface) -> bool:
        """Whether the base of a model is where it usually is, if its outline can be read both ways."""
        del model
        return True

    def standard_form(self, end: Iterate, names: tuple[str, ...]) -> Iterate:
        """The end in standard form, if several sets of parameters describe the same surface.

        Args:
            end: An end in a fitted pose.
            names: Names of all free parameters, including those of the pose.
        """
        del names
        return end

    def outcome(self, end: Iterate) -> str:
        """The sentence by which a converged fit describes its end."""
        return f"converged after {end.rounds} rounds"
