"""Drawing of each kind of target beside a model: as points in the scene, or as a picture."""

from __future__ import annotations

import abc
from typing import ClassVar

import jax
import numpy as np
from jaxtyping import Float

from petalfit.fitting import FitResult
from petalfit.fitting.likelihood.foot_points import distances_beside, signed_distance
from petalfit.observations import AbstractObservation, PointCloud, Silhouette
from petalfit.report.colour import IGNORED, diverging
from petalfit.report.scene import distance_limit
from petalfit.studio.petal_controls import PetalControls
from petalfit.studio.pictures import picture
from petalfit.studio.scenery import Scenery
from petalfit.surfaces import AbstractSurface, Pose, in_doubles

_IN_VIEW = 20_000  # the most points drawn; of more points a random choice is drawn
_BESIDE = 2000  # the number of points whose distances follow the sliders


class AbstractDrawn(abc.ABC):
    """A target that the page draws.

    Attributes:
        in_picture: Whether the target is drawn in a picture, rather than as points in the scene.
        unit: The unit that is written after its distances.
    """

    in_picture: ClassVar[bool]
    unit: ClassVar[str]

    @abc.abstractmethod
    def look(self) -> None:
        """Brings the target into view, before there is a model."""

    @abc.abstractmethod
    def draw(
        self, model: AbstractSurface | None, pose: Pose, result: FitResult | None, measured: bool
    ) -> float | None:
        """Draws the target beside a model.

        Args:
            model: The model in its own frame, if there is one.
            pose: The pose from that frame to the target's.
            result: The fit that the model comes from, if there is one.
            measured: Whether the program that measures distances to an edited model is compiled.

        Returns:
            The root mean square of the distances that were drawn, or None.
        """

    def prepare(self, result: FitResult) -> bool:
        """Compiles the program that measures distances to an edited model; returns whether it exists."""
        del result
        return False

    def glimpse(self, model: AbstractSurface) -> None:
        """Draws the target beside a model while a fit runs, unless the fit itself provides its points."""
        del model


class DrawnCloud(AbstractDrawn):
    """A cloud, drawn as points in the model's frame that are coloured by their distances."""

    in_picture: ClassVar[bool] = False
    unit: ClassVar[str] = ""

    def __init__(self, cloud: PointCloud, scenery: Scenery, controls: PetalControls) -> None:
        self._cloud, self._scenery, self._controls = cloud, scenery, controls
        self._some = np.random.default_rng(0).permutation(len(cloud))[:_IN_VIEW]

    def look(self) -> None:
        self._scenery.look_at(self._cloud.points[self._some])

    def draw(
        self, model: AbstractSurface | None, pose: Pose, result: FitResult | None, measured: bool
    ) -> float | None:
        points = pose.into(self._cloud.points[self._some])
        colours, rms = np.tile(IGNORED, (len(points), 1)), None
        if result is not None and model is not None:
            part, distances = result.agreements[0], None
            limit, used = distance_limit(part), part.used[self._some]
            if model is result.model:
                distances = part.distances[self._some]
            elif measured:
                points, used = points[:_BESIDE], used[:_BESIDE]
                distances = float(pose.scale) * _distances(model, points)
            if distances is not None:
                colours = np.where(used[:, None], diverging(distances / limit), IGNORED)
                weights = part.weights[self._some[: len(distances)]]
                rms = float(np.sqrt(np.average(distances**2, weights=weights + 1e-300)))
        self._scenery.points(points, colours[: len(points)], self._controls.show_points.value)
        return rms

    def prepare(self, result: FitResult) -> bool:
        if result.agreements[0].uv is None:
            return False
        _distances(result.model, result.pose.into(self._cloud.points[self._some][:_BESIDE]))
        return True


class DrawnMask(AbstractDrawn):
    """A silhouette, drawn as a picture of the mask with the outline of the model."""

    in_picture: ClassVar[bool] = True
    unit: ClassVar[str] = " px"

    def __init__(self, mask: Silhouette, scenery: Scenery, controls: PetalControls) -> None:
        del scenery
        self._mask, self._controls = mask, controls
        self.photo: Float[np.ndarray, "h w 3"] | None = None

    def look(self) -> None:
        pass

    def draw(
        self, model: AbstractSurface | None, pose: Pose, result: FitResult | None, measured: bool
    ) -> float | None:
        self._controls.picture.image = picture(self._mask, self.photo, model, pose)
        return None

    def glimpse(self, model: AbstractSurface) -> None:
        self.draw(model, Pose.identity(), None, False)


def drawn(target: AbstractObservation, scenery: Scenery, controls: PetalControls) -> AbstractDrawn:
    """The object that draws a target on the page.

    Raises:
        TypeError: Targets of this kind cannot be drawn.
    """
    makers = {"cloud": DrawnCloud, "mask": DrawnMask}
    if target.kind not in makers:
        raise TypeError(f"the page cannot draw a {target.kind!r}, only {', '.join(makers)}")
    return makers[target.kind](target, scenery, controls)  # pyright: ignore[reportArgumentType]


def _distances(model: AbstractSurface, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """The signed distances of points to a surface with edges."""
    with jax.enable_x64(True):
        normal, beyond, _ = distances_beside(in_doubles(model), points)
    return signed_distance(normal, beyond)
