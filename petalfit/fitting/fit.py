"""The public entry: a target and a model in, a `FitResult` out."""

from __future__ import annotations

import dataclasses
import inspect
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple, overload

import jax
import numpy as np
from jaxtyping import Float

from petalfit.colours import AbstractPattern, from_hex
from petalfit.compilation import stage, watched
from petalfit.components import (
    AbstractAssembly,
    BladePetal,
    PeonyPetal,
    Posed,
    SplinePetal,
    parameters,
)
from petalfit.fitting.assembly import fit_assembly
from petalfit.fitting.checks import (
    Fittable,
    check_count,
    check_frame,
    check_loss,
    check_name,
    check_options,
    check_pose,
    check_view,
    configuration,
    valid_noise,
)
from petalfit.fitting.cloud_fit import fit_cloud
from petalfit.fitting.colours import ColourFit, colours_on, fit_colours
from petalfit.fitting.estimate import FitError
from petalfit.fitting.families import FAMILIES, ranked
from petalfit.fitting.joint import fit_joint
from petalfit.fitting.result import Agreement, FitResult
from petalfit.fitting.rounds import Settled
from petalfit.fitting.sheet import fit_sheet
from petalfit.fitting.spline import fit_spline
from petalfit.fitting.summary import strays, summarise, systematic
from petalfit.fitting.targets import as_targets, each_once, with_noise_of_points
from petalfit.fitting.view_pose import view_frames
from petalfit.observations import (
    IMAGE_SUFFIXES,
    Camera,
    Contour,
    PointCloud,
    Silhouette,
    TargetError,
    Texture,
    as_point_cloud,
)
from petalfit.surfaces import AbstractSurface

# Of a petal, in the model's unit, for a mask without a camera.
_TYPICAL_LENGTH = 40.0
_FEWEST_FOR_SPLINES = 200
# Directions that a component in an unknown pose before cameras is followed from, until one follows its
# contours as closely as this.
_FRAMES, _RIGHT_PIXELS = 3, 0.5


def fit_petal(
    target: object,
    *,
    model: type[AbstractSurface] | AbstractSurface | Literal["auto"] = PeonyPetal,
    **options: object,
) -> FitResult:
    """Recover the parameters of a petal from a target: `fit` with a petal as the default model.

    With model="auto" all families of petals are fitted to a cloud, and the one that explains it best for
    what it may choose is the result; its `ranking` has the others.

    Args:
        target: See `fit`.
        model: A petal; of an instance, parameters that are not free keep their values. Or "auto".
        options: The other options of `fit`.

    Returns:
        The result. Read its `warnings`.

    Raises:
        TargetError: The target cannot be used, or the options do not fit the model.
        FitError: The solver failed, and `throw` is True.
    """
    return fit(model, target, **options)  # pyright: ignore[reportArgumentType]


@overload
def fit(
    model: type[AbstractSurface] | AbstractSurface | Literal["auto"],
    target: object,
    **options: Any,
) -> FitResult: ...
@overload
def fit(
    model: type[AbstractPattern] | AbstractPattern, target: object, **options: Any
) -> ColourFit: ...
def fit(  # pyright: ignore[reportInconsistentOverload]
    model: Fittable | type[Fittable] | Literal["auto"],
    target: object,
    *,
    pose: str = "known",
    camera: Camera | None = None,
    free: Iterable[str] | None = None,
    init: Fittable | None = None,
    noise: float | Sequence[float] | Float[np.ndarray, " n"] | None = None,
    loss: str = "linear",
    seed: int = 0,
    throw: bool = True,
    progress: Callable[[str], None] | None = None,
    surface: type[AbstractSurface] | AbstractSurface | FitResult = PeonyPetal,
    palette: tuple[str, str] | None = None,
) -> FitResult | ColourFit:
    """Recover the parameters of a component from point clouds, silhouettes, or both; or of a pattern.

    Args:
        model: A component, or a pattern of colours; of an instance, parameters that are not free keep
            their values. "auto" for the best of several petals.
        target: Of a cloud an (N, 3) array, a `PointCloud`, a trimesh mesh or cloud, or the path of a
            file; of a silhouette a `Silhouette`, an (H, W) mask, or the path of an image; or a list of
            these, which are fitted jointly, each in units of its own noise. Of a pattern a `Texture`, an
            array or the path of an image that makes one, or a cloud with colours.
        pose: "known": clouds are in the model's frame and unit, and cameras stand in it. "rigid": a
            cloud, or what cameras see, lies somewhere, in the model's unit. "similarity": a cloud's unit
            is unknown too, and the result's pose has the scale; a BladePetal keeps its length, and of a
            PeonyPetal the waves tell the unit. A PeonyPetal that lies somewhere keeps its c_z.
        camera: What took the masks that are no `Silhouette` with a camera of their own. A single mask
            may have none: it is then an orthographic front view of unknown scale and position, the
            lengths are relative, and the result's pose maps the model to pixels.
        free: Names of the parameters to fit; by default all that the model does not declare fixed.
        init: An instance to start from. Without it the fit finds its own start.
        noise: Standard deviation σ of the clouds' noise, in their unit; estimated if None. That of
            silhouettes is always estimated. An array has one σ for each point of a cloud.
        loss: "linear": least squares, right for noise without gross outliers. "robust": points may
            be strays or clutter; each counts by the probability that it belongs to the surface, which
            is in the result's weights.
        seed: Of random choices; the result hardly depends on it.
        throw: Raise `FitError` if the solver fails; else return a result with `converged` False.
        progress: Called with a line of text whenever a stage of the fit begins.
        surface: For a pattern and a cloud, what the cloud is of: a class, which is fitted first, an
            instance in the cloud's frame, or the result of a fit to the cloud.
        palette: For a pattern and colours, the two colours that it mixes, as CSS writes them, the ground
            first. Without it they are the ends of the colours themselves, the ground the lighter one,
            and intensities count between those.

    Returns:
        The result. Read its `warnings`.

    Raises:
        TargetError: The target cannot be used, or the options do not fit the model.
        FitError: The solver failed, and `throw` is True.
    """
    check_options(pose, loss)
    sigma = valid_noise(noise)
    tell = progress or (lambda text: None)
    with watched("starts") as watch:
        if isinstance(model, str):
            check_name(model, free, init)
            options = {"pose": pose, "loss": loss, "noise": sigma, "seed": seed}
            result = _fit_best(as_targets(target, camera), options, tell)
        else:
            template, names = configuration(model, free, init)
            if isinstance(template, AbstractPattern):
                if isinstance(sigma, np.ndarray):
                    raise TargetError("the noise of a pattern is one number.")
                result = fit_colours(
                    template,
                    names,
                    _as_texture(target, surface, seed, progress),
                    palette=None if palette is None else np.stack([from_hex(c) for c in palette]),
                    noise=sigma,
                    from_template=init is not None,
                    seed=seed,
                    progress=tell,
                )
            else:
                result = _fit_component(
                    template,
                    names,
                    as_targets(target, camera),
                    pose=pose,
                    loss=loss,
                    noise=sigma,
                    init=init,
                    seed=seed,
                    progress=tell,
                )
    result = dataclasses.replace(result, timings=dict(watch.seconds))
    if throw and not result.converged:
        raise FitError(result.message, result)
    return result


def _fit_component(
    template: AbstractSurface,
    names: tuple[str, ...],
    targets: list[PointCloud | Silhouette],
    *,
    pose: str,
    loss: str,
    noise: float | Float[np.ndarray, " n"] | None,
    init: Fittable | None,
    seed: int,
    progress: Callable[[str], None],
) -> FitResult:
    """A component beside its targets, whether or not the solver failed."""
    targets = [each_once(part) for part in targets]
    targets, sigma = with_noise_of_points(targets, noise)
    check_pose(template, pose, targets, init)
    check_loss(template, loss, targets)
    if isinstance(template, SplinePetal):
        return _fit_spline(targets, pose, loss, progress)
    fitted = run(
        template,
        names,
        targets,
        pose=pose,
        loss=loss,
        noise=sigma,
        from_template=init is not None,
        seed=seed,
        progress=progress,
    )
    with stage("errors"):
        return summarise(*fitted, sigma)


def _fit_best(
    targets: list[PointCloud | Silhouette],
    options: dict[str, Any],
    progress: Callable[[str], None],
) -> FitResult:
    """The best of all families of petals for one cloud."""
    if len(targets) > 1 or not isinstance(targets[0], PointCloud):
        raise TargetError("model='auto' compares families on one cloud; name a model for masks.")
    results, refusals = [], []
    for family in FAMILIES:
        name = family.__name__

        def tell(text: str, name: str = name) -> None:
            progress(f"{name}: {text}")

        try:
            own = configuration(family, None, None)
            results.append(_fit_component(*own, targets, init=None, progress=tell, **options))  # pyright: ignore[reportArgumentType]
        except TargetError as error:
            refusals.append(error)
    if not results:
        raise refusals[0]
    return ranked(results, options["loss"])


def _as_texture(
    target: object,
    surface: type[AbstractSurface] | AbstractSurface | FitResult,
    seed: int,
    progress: Callable[[str], None] | None,
) -> Texture:
    """What a pattern is fitted to."""
    if isinstance(target, Texture):
        return target
    if isinstance(target, str | os.PathLike) and Path(target).suffix.lower() in IMAGE_SUFFIXES:
        return Texture.load(target)
    if isinstance(target, np.ndarray) and not (target.ndim == 2 and target.shape[1] == 3):
        return Texture(target)
    cloud = as_point_cloud(target)
    if inspect.isclass(surface):
        surface = fit(surface, cloud, seed=seed, progress=progress)
    return colours_on(surface, cloud)


def _fit_spline(
    targets: list[PointCloud | Silhouette],
    pose: str,
    loss: str,
    progress: Callable[[str], None],
) -> FitResult:
    """A spline sheet, whose coefficients are too many for a table of parameters."""
    cloud = targets[0]
    if len(targets) > 1 or not isinstance(cloud, PointCloud):
        raise TargetError("a SplinePetal is fitted to one cloud.")
    weights = np.ones(len(cloud)) if cloud.weights is None else np.array(cloud.weights)
    if np.count_nonzero(weights) < _FEWEST_FOR_SPLINES:
        raise TargetError(
            f"{np.count_nonzero(weights)} points are too few for a SplinePetal; give "
            f"{_FEWEST_FOR_SPLINES} or more, or fit a BladePetal."
        )
    with jax.enable_x64(True), stage("polishing"):
        found = fit_spline(cloud.points, weights, pose, loss, progress)
    weights = weights * found.members
    noise = float(np.sqrt(np.average(found.distance**2, weights=weights)))
    coefficients = np.size(found.model.offsets)
    agreement = Agreement(cloud, found.distance, weights, noise, found.uv)
    warnings = systematic(agreement, found.model)
    message = f"{coefficients} coefficients, smoothed in {found.rounds} rounds; they have no errors"
    return FitResult(
        model=found.model,
        pose=found.pose,
        agreements=(agreement,),
        values={name: float(getattr(found.model, name)) for name in parameters(found.model)},
        stderr={},
        identifiable={},
        names=(),
        covariance=np.zeros((0, 0)),
        converged=True,
        status="converged",
        message="; ".join([message, *strays(agreement), *warnings]),
        warnings=tuple(warnings),
        steps=found.rounds,
        starts=(),
        freedom=found.freedom,
    )


class Fitted(NamedTuple):
    """What a fit ended with.

    Attributes:
        template: The component that it started from, perhaps posed.
        names: The free parameters, a pose's included.
        targets: Clouds first.
        ends: What each start reached, the best first; observations in the order of the targets.
    """

    template: AbstractSurface
    names: tuple[str, ...]
    targets: list[PointCloud | Silhouette]
    ends: list[Settled]


def run(
    template: AbstractSurface,
    names: tuple[str, ...],
    targets: list[PointCloud | Silhouette],
    *,
    pose: str = "known",
    loss: str = "linear",
    noise: float | None,
    from_template: bool,
    seed: int,
    progress: Callable[[str], None],
    placed: Mapping[str, float] | None = None,
    glance_only: bool = False,
) -> Fitted:
    """A fit from checked options to where its starts ended.

    Args:
        template: A component; values to start from if `from_template`.
        names: Its free parameters.
        targets: All that was seen.
        pose: "known", "rigid" or "similarity".
        loss: "linear" or "robust".
        noise: Of the clouds; estimated if None.
        from_template: Start at the template instead of searching.
        seed: Of random choices.
        progress: Called with a line of text whenever a stage of the fit begins.
        placed: For a mask without a camera, the scale and the shifts to start from, in pixels.
        glance_only: Leave out what silhouettes need besides the solution: its bias and its errors.
    """
    clouds = [part for part in targets if isinstance(part, PointCloud)]
    views = [part for part in targets if isinstance(part, Silhouette)]
    for cloud in clouds:
        if pose != "similarity":
            check_frame(cloud, template, pose)
    options: Any = {
        "noise": noise,
        "from_template": from_template,
        "seed": seed,
        "progress": progress,
    }
    with jax.enable_x64(True):
        if len(clouds) == 1 and not views:
            (cloud,) = clouds
            weights = np.ones(len(cloud)) if cloud.weights is None else cloud.weights
            check_count(weights, names)
            if isinstance(template, AbstractAssembly):
                ends = fit_assembly(template, names, cloud.points, weights, **options)
                return Fitted(template, names, targets, ends)
            follow = fit_sheet if isinstance(template, BladePetal) else fit_cloud
            posed, names, ends = follow(
                template,  # pyright: ignore[reportArgumentType]
                names,
                cloud.points,
                weights,
                pose=pose,
                loss=loss,
                **options,
            )
            return Fitted(posed, names, targets, ends)
        if isinstance(template, AbstractAssembly):
            raise TargetError(
                f"a {type(template).__name__} has several surfaces, which are fitted to one cloud; "
                "masks, or several targets, need a component of one."
            )
        contours = [Contour.of(view) for view in views]
        if pose != "known":
            posed, names, ends = _fit_views_anywhere(template, names, contours, options)
            return Fitted(posed, names, targets, ends)
        if any(view.camera is None for view in views):
            template = _without_camera(template, targets, contours, placed or {})
            names = (*names, *Posed.in_image)
        for contour in contours:
            check_view(contour, template)
        ends = fit_joint(template, names, clouds, contours, **options, glance_only=glance_only)
        return Fitted(template, names, [*clouds, *views], ends)


def _fit_views_anywhere(
    template: AbstractSurface,
    free: tuple[str, ...],
    contours: list[Contour],
    options: dict[str, Any],
) -> tuple[AbstractSurface, tuple[str, ...], list[Settled]]:
    """A fit of masks with cameras, and of a component that lies anywhere before them."""
    names = (*(name for name in free if name != "c_z"), *Posed.rigid)
    frames = view_frames(template, names, contours, _FRAMES, options["progress"])
    ends: list[Settled] = []
    for k, frame in enumerate(frames):
        options["progress"](f"following direction {k + 1} of {len(frames)}")
        for end in fit_joint(frame, names, [], contours, **options):
            ends.append(dataclasses.replace(end, label=f"direction {k + 1}, {end.label}"))
        if min(end.seen[0].noise for end in ends) < _RIGHT_PIXELS:
            break
    ends.sort(key=lambda end: end.chi2)
    return ends[0].model, names, ends


def _without_camera(
    template: AbstractSurface,
    targets: list[PointCloud | Silhouette],
    contours: list[Contour],
    placed: Mapping[str, float],
) -> Posed:
    """For a mask without a camera, the component in an unknown place of its image."""
    if len(targets) > 1:
        raise TargetError(
            "a mask without a camera can only be fitted alone: where the petal lies in its image is not "
            "known. Give the camera of every mask."
        )
    (contour,) = contours
    low, high = contour.place.min(axis=0), contour.place.max(axis=0)
    middle, unit = 0.5 * (low + high), float(high[1] - low[1]) / _TYPICAL_LENGTH
    return Posed(
        template,
        # From the petal's axes to the image's: x right, y down, z away from the viewer.
        np.diag([1.0, -1.0, -1.0]),
        np.append(middle, 0.0),
        unit,
        placed.get("scale", unit) / unit,
        (placed.get("shift_x", middle[0]) - middle[0]) / unit,
        (placed.get("shift_y", middle[1]) - middle[1]) / unit,
    )
