"""Fits of silhouettes: alone, several together, or together with clouds."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from petalfit.compilation import stage
from petalfit.components import PeonyPetal, Posed, bare, parameters
from petalfit.fitting import programs
from petalfit.fitting.cloud import ObservedCloud, with_all_points
from petalfit.fitting.cloud_fit import fit_cloud, ribs_beside, with_ribs
from petalfit.fitting.coordinates import Coordinates, with_values
from petalfit.fitting.determined import DETERMINED, sizes, stay_at_the_start, typical_spread
from petalfit.fitting.peony_start import FREQUENCIES, RIBS, RibBasin, close, rib_basins, rib_waves
from petalfit.fitting.rounds import (
    AbstractObserved,
    Polished,
    Progress,
    Settled,
    finish,
    glance,
    minimise,
)
from petalfit.fitting.solve import Prior
from petalfit.fitting.view_start import Shadow, search
from petalfit.fitting.views import CORRELATED, ObservedViews, View, padded, rows
from petalfit.observations import Contour, PointCloud, TargetError
from petalfit.surfaces import AbstractSurface, outline, value_at

_CANDIDATES = 20
# A candidate that follows the contours as closely as this is right; others need not be looked at.
_RIGHT = 0.03
_FOLLOWED = 3
_ROUNDS = 20
_TOLERANCE = 2e-2
# How many scales are tried for a mask without a camera.
_SCALES = 25
# Coordinates closer than this are one outline.
_SAME = 0.3

Start = tuple[str, AbstractSurface]


@dataclasses.dataclass(frozen=True)
class Joint:
    """Everything that is seen in one fit, and how a start is followed.

    Attributes:
        coordinates: Free parameters.
        clouds: Clouds, without their weightless points.
        views: The silhouettes.
        progress: Called with a line of text when a stage begins.
    """

    coordinates: Coordinates
    clouds: tuple[ObservedCloud, ...]
    views: ObservedViews
    progress: Progress

    @property
    def observed(self) -> list[AbstractObserved]:
        """All of it, clouds first."""
        return [*self.clouds, self.views] if self.views.views else [*self.clouds]

    def minimise(
        self,
        coordinates: Coordinates,
        model: AbstractSurface,
        rounds: int = _ROUNDS,
        tolerance: float = _TOLERANCE,
        prior: Prior | None = None,
    ) -> Polished:
        """Rounds between which all foot points look around."""
        terms = [None] * len(self.observed)
        return minimise(coordinates, self.observed, model, terms, rounds, tolerance, prior, every=1)

    def misfit(self, model: AbstractSurface) -> float:
        """For a choice between starts: logarithms of squared distances, small where it follows."""
        return sum(part.misfit(model) for part in self.observed)

    def follow(self, label: str, model: AbstractSurface, *, held: tuple[str, ...] = ()) -> Ended:
        """A start's end, with some parameters held."""
        self.progress(f"polishing from {label}")
        with stage("polishing"):
            polished = self.minimise(self.coordinates.holding(held).around(model), model)
        return Ended(polished, glance(self.coordinates, label, self.observed, polished), held)


@dataclasses.dataclass(frozen=True)
class Ended:
    """Where a start ended, before anything is accounted for, and what was held on the way."""

    polished: Polished
    end: Settled
    held: tuple[str, ...]


def fit_joint(
    template: AbstractSurface,
    free: tuple[str, ...],
    clouds: Sequence[PointCloud],
    contours: Sequence[Contour],
    *,
    noise: float | None,
    from_template: bool,
    seed: int,
    progress: Progress,
    glance_only: bool = False,
) -> list[Settled]:
    """Fit a component to silhouettes, and to clouds in its own frame.

    Args:
        template: Values of the fixed parameters; of all parameters if `from_template`.
        free: Names of the parameters to fit.
        clouds: May be none.
        contours: May be none if there are clouds.
        noise: σ of the clouds, or None to estimate it.
        from_template: Start at the template instead of searching.
        seed: Of random choices.
        progress: Called with a line of text when a stage begins.
        glance_only: Stop where the solver stops: biases stay, and errors are not computed.

    Returns:
        What each start reached, the best first, its observations in the order clouds, contours. Call
        it inside `jax.enable_x64(True)`.
    """
    coordinates = Coordinates.of(template, free)
    rng = np.random.default_rng(seed)
    observed = tuple(ObservedCloud.used(cloud, noise, rng) for cloud in clouds)
    joint = Joint(coordinates, observed, ObservedViews.of(contours), progress)
    if from_template:
        ends = [joint.follow("given", coordinates.template)]
    else:
        ends = [*_from_clouds(joint, clouds, noise, seed), *_from_outlines(joint)]
    best, *others = sorted(ends, key=lambda ended: ended.end.chi2)
    if glance_only:
        return [best.end, *(other.end for other in others)]

    def end(
        model: AbstractSurface, polished: Polished | None, prior: Prior | None = None
    ) -> Settled:
        if polished is None:
            held = coordinates.holding(best.held).around(model)
            polished = joint.minimise(held, model, prior=prior)
        known = Prior.none(len(free)) if prior is None else prior
        # What was held stays where it is.
        root = np.where(np.isin(free, best.held), 1e6, known.root)
        around = coordinates.around(polished.model)
        return finish(around, best.end.label, joint.observed, polished, Prior(known.centre, root))

    progress("taking pictures of the fit")
    with stage("errors"):
        final = stay_at_the_start(coordinates, end(best.polished.model, best.polished), end)
    final = dataclasses.replace(final, chi2=best.end.chi2)
    for k, cloud in enumerate(clouds):
        final = with_all_points(coordinates, final, k, cloud)
    return [final, *(other.end for other in others)]


def _from_clouds(
    joint: Joint, clouds: Sequence[PointCloud], noise: float | None, seed: int
) -> Iterator[Ended]:
    """Ends that begin where a fit of the clouds alone does."""
    coordinates = joint.coordinates
    points = [cloud.points for cloud in clouds]
    weights = [np.ones(len(c)) if c.weights is None else c.weights for c in clouds]
    if sum(map(np.count_nonzero, weights)) < len(coordinates.free) + 1:
        if clouds and not joint.views.views:
            raise TargetError(
                f"{sum(map(len, clouds))} points cannot determine {len(coordinates.free)} free "
                "parameters: give more points, or name fewer parameters in free."
            )
        return
    _, _, starts = fit_cloud(
        coordinates.template,
        coordinates.free,
        np.concatenate(points),
        np.concatenate(weights),
        noise=noise,
        from_template=False,
        seed=seed,
        progress=joint.progress,
    )
    for start in starts:
        yield joint.follow(start.label, start.model)


def _from_outlines(joint: Joint) -> Iterator[Ended]:
    """Ends without ribs, and with those that show in the silhouettes or the clouds."""
    coordinates = joint.coordinates
    if not joint.views.views:
        return
    free = coordinates.free
    held = without_ribs(coordinates)
    for label, smooth in _smooth(joint, held):
        yield joint.follow(label, smooth, held=tuple(n for n in free if n not in held.moving))
        if held is coordinates:
            continue
        joint.progress("searching the rib frequency")
        for cloud in joint.clouds:
            assert isinstance(smooth, PeonyPetal)
            for basin in close(ribs_beside(coordinates, smooth, cloud)):
                yield joint.follow(*with_ribs(smooth, basin))
        basins, visible = _rib_basins(joint, held, smooth)
        for basin in close(basins) if visible else []:
            yield joint.follow(*with_ribs(smooth, basin))


def without_ribs(coordinates: Coordinates) -> Coordinates:
    """Those of a petal without ribs, which no outline shows while the rest is rough; or the same."""
    template = coordinates.template
    if not isinstance(bare(template), PeonyPetal) or "rib_amplitude" not in coordinates.free:
        return coordinates
    return coordinates.around(with_values(template, {"rib_amplitude": 0.0})).holding(RIBS)


def _smooth(joint: Joint, held: Coordinates) -> Iterator[Start]:
    """Surfaces that follow the silhouettes, different ones, the best first."""
    joint.progress("searching the outline")
    shadows = [Shadow.of(view.contour) for view in joint.views.views]
    found: list[tuple[float, AbstractSurface]] = []
    for t, _ in search(held, shadows, _CANDIDATES):
        model = joint.minimise(held, held.model(t), 3, 0.5).model
        found.append((joint.misfit(model), model))
        if found[-1][0] < _RIGHT:
            break
    found.sort(key=lambda start: start[0])
    promising = [model for misfit, model in found[:_FOLLOWED] if misfit < 3 * found[0][0] + _RIGHT]
    if "scale" in held.free:
        promising = _rescaled(joint, held, promising[0])
    ends = [joint.minimise(held, model).model for model in promising]
    ends.sort(key=joint.misfit)
    different: list[Float[np.ndarray, " p"]] = []
    for model in ends:
        t = held.inverse(model)
        if all(np.max(np.abs(t - other)) > _SAME for other in different):
            different.append(t)
            yield f"outline {len(different)}", model


def _rescaled(joint: Joint, held: Coordinates, model: AbstractSurface) -> list[AbstractSurface]:
    """The same outline at other scales: nothing but the scallops of its tip tells them apart."""
    lengths = [name for name in sizes(model) if name in held.free]
    assert isinstance(model, Posed)
    found: list[tuple[float, AbstractSurface]] = []
    for factor in np.geomspace(0.4, 2.5, _SCALES):
        values = {name: float(value_at(model, name)) * factor for name in lengths}
        typical = [parameters(model)[name].typical for name in lengths]
        if not all(
            0.8 * low < value < 1.25 * high
            for value, (low, high) in zip(values.values(), typical, strict=True)
        ):
            continue
        other = with_values(model, values | {"scale": model.scale / factor})
        other = joint.minimise(held, other, 4, 0.2).model
        found.append((joint.misfit(other), other))
    found.sort(key=lambda start: start[0])
    return [other for _, other in found[: 2 * _FOLLOWED]] or [model]


def _rib_basins(
    joint: Joint, held: Coordinates, smooth: AbstractSurface
) -> tuple[list[RibBasin], bool]:
    """Rib frequencies that explain best what the silhouettes leave, and whether ribs would show."""
    free, t = joint.coordinates.free, held.inverse(smooth)
    frequencies = FREQUENCIES
    if "rib_frequency" not in free:
        frequencies = np.array([float(held.template.rib_frequency)])
    covariance, power = np.zeros((2, len(frequencies)))
    for view in joint.views.views:
        slopes, waves, distance = _weighted(held, t, view, frequencies)
        # What the smooth parameters can follow within their typical ranges does not speak for ribs.
        inverse = np.linalg.inv(slopes.T @ slopes + np.eye(len(t)))
        distance = distance - slopes @ (inverse @ (slopes.T @ distance))
        waves = waves - (waves @ slopes) @ inverse @ slopes.T
        covariance -= waves @ distance
        power += np.sum(waves**2, axis=1)
    basins = rib_basins(frequencies, covariance, power + 1e-300, 1.0)
    (spread,) = typical_spread(("rib_amplitude",), parameters(bare(held.template)))
    return basins, bool(np.max(power) * spread**2 > DETERMINED**-2)


def _weighted(
    held: Coordinates, t: Float[np.ndarray, " p"], view: View, frequencies: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Slopes, waves and distances of the outline and the contour, in units of the noise."""
    smooth = held.model(t)
    match = view.matched(outline(smooth, view.contour.camera))
    noise = view.noise(match)
    root = np.sqrt(match.length * view.calm(match, noise) / (2 * CORRELATED)) / noise
    term = padded([rows(view.contour, match, root)])
    slopes = np.asarray(programs.contour_slopes(held, t, term))[: len(root)]
    # Ribs rise along z.
    rise = np.asarray(programs.contour_covectors(smooth, term))[: len(root), 2]
    return slopes, rib_waves(match.uv, frequencies) * rise, root * match.distance
