"""The entry points: `fit` and `fit_petal` take a model and a target, and return a `FitResult`."""

from __future__ import annotations

import dataclasses
import inspect
import os
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Literal, overload

import jax
import numpy as np
from jaxtyping import Float, Real

from petalfit.colours import AbstractPattern, from_hex
from petalfit.compilation import stage
from petalfit.fitting.choose import ranked
from petalfit.fitting.colours.fit import ColourFit, fit_colours
from petalfit.fitting.colours.texture import colours_on
from petalfit.fitting.error import FitError
from petalfit.fitting.families.registry import DEFAULT, families, family_of, petals
from petalfit.fitting.outliers.loss import AbstractLoss
from petalfit.fitting.outliers.registry import loss_named
from petalfit.fitting.request import checks
from petalfit.fitting.request.configuration import Fittable, configuration, inside_ranges
from petalfit.fitting.request.request import Request
from petalfit.fitting.request.targets import as_targets, is_one_image, with_noise_of_points
from petalfit.fitting.result import FitResult
from petalfit.fitting.run import run
from petalfit.fitting.solver.observer import prefixed, report, reporting_to
from petalfit.fitting.solver.threads import one_thread
from petalfit.fitting.summary import summarise
from petalfit.observations import (
    IMAGE_SUFFIXES,
    AbstractObservation,
    Camera,
    PointCloud,
    TargetError,
    Texture,
    as_point_cloud,
)
from petalfit.surfaces import AbstractSurface, Pose

Noise = float | Sequence[float] | Float[np.ndarray, " n"] | None
Base = str | Sequence[float | int] | Real[np.ndarray, " n"] | None


def fit_petal(
    target: object,
    *,
    model: type[AbstractSurface] | AbstractSurface | Literal["auto"] = DEFAULT,
    **options: object,
) -> FitResult:
    """Recover the parameters of a petal from a target: `fit` with a petal as the default model.

    With model="auto" all families of petals are fitted to a cloud. The result is the one that explains
    the cloud best, given its number of parameters; its `ranking` lists the others.

    Args:
        target: See `fit`.
        model: A class of petals or a petal, or "auto". Parameters that are not free keep the values of
            the petal, or the defaults of the class.
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
    init: Fittable | FitResult | None = None,
    noise: Noise = None,
    loss: str = "linear",
    seed: int = 0,
    base: Base = None,
    every_point: bool = False,
    throw: bool = True,
    progress: Callable[[str], None] | None = None,
    surface: type[AbstractSurface] | AbstractSurface | FitResult | None = None,
    palette: tuple[str, str] | None = None,
) -> FitResult | ColourFit:
    """Recover the parameters of a component from clouds and silhouettes, or of a pattern from colours.

    Args:
        model: A component or a pattern of colours, a class or an instance. Parameters that are not free
            keep the values of `init` or the instance, or the class's defaults. Or "auto": the best petal.
        target: For a component, a cloud: an (N, 3) array, a `PointCloud`, a trimesh mesh or cloud, or the
            path of a file. Or a silhouette: a `Silhouette`, an (H, W) mask, or the path of an image. Or
            the folder of a capture (see `read_capture`). Or a list of these, which are fitted jointly,
            each in units of its own noise. For a pattern, a `Texture`, an array or the path of an image
            that makes one, or a cloud with colours.
        pose: "known": clouds and cameras are in the model's frame and unit. "rigid": the cloud lies
            anywhere, in the model's unit, or what cameras of any unit see. "similarity": the unit of the
            cloud is unknown too, and the result's pose has the scale. Parameters that a pose makes
            redundant keep their values: c_z of a PeonyPetal, and with "similarity" length of a
            BladePetal.
        camera: The camera of all masks that are not a `Silhouette` with its own. A single mask may have
            no camera: it is then taken for an orthographic front view, anywhere in the image and turned
            there; the lengths are relative, and the result's pose maps the model to pixels.
        free: Names of the parameters to fit; by default all that the model does not declare fixed.
        init: An instance to start from; for a cloud in a fitted pose, or a mask without a camera, an
            earlier result, whose pose is then the start too. Without it the fit finds its own start.
        noise: Standard deviation σ of the clouds' noise, in their unit; estimated if None. An array of
            shape (N,) has one σ for each point of a single cloud. For silhouettes σ is always estimated.
        loss: "linear": least squares, right for noise without gross outliers. "robust": points may
            be outliers or clutter. Each point then counts by the probability that it belongs to the
            surface, which is in the result's weights. Where the pose of a petal is fitted, a table
            under it and its stalk are left out.
        seed: The seed of random choices; the result hardly depends on it.
        base: Which end of a blade is its base, if its pose is fitted: a point near it, in the cloud's
            or the cameras' frame, or "other", the end that the fit would take for the tip. Without it,
            the end for which the blade fits better; of masks with cameras, the one that is farther from
            the widest place, unless the other one fits clearly better. In a mask without a camera it is
            a place (x, y) in pixels; without it, the lower end, unless the other one fits clearly
            better.
        every_point: Whether every step takes every point of a cloud. Otherwise a large cloud is condensed
            for all steps but the last look at it, which is faster and changes no parameter by more than
            a fraction of its error; `points_used` of the result has the numbers.
        throw: Whether to raise `FitError` if the solver fails; else `converged` of the result is False.
        progress: A function that is called with a line of text whenever a stage of the fit begins.
        surface: For a pattern and a cloud, the surface of the cloud: a class, which is fitted first, an
            instance in the cloud's frame, or the result of a fit to the cloud; by default a petal.
        palette: For a pattern and colours, the two colours that it mixes, in CSS notation, the ground
            first. By default they are the ends of the range of the colours themselves, the lighter one
            as the ground. Intensities run from 0 to 1 between the two.

    Returns:
        The result. Read its `warnings`.

    Raises:
        TargetError: The target cannot be used, or the options do not fit the model.
        FitError: The solver failed, and `throw` is True.
    """
    earlier = init if isinstance(init, FitResult) else None
    if isinstance(init, FitResult):
        init = inside_ranges(init.model)
    check_request(
        model,
        pose=pose,
        loss=loss,
        free=free,
        init=init,
        noise=noise,
        base=base,
        every_point=every_point,
    )
    sigma = checks.valid_noise(noise)
    with one_thread(), reporting_to(progress) as seconds:
        if is_pattern(model):
            unused = {
                "pose": pose != "known",
                "loss": loss != "linear",
                "camera": camera is not None,
                "base": base is not None,
                "every_point": every_point,
            }
            checks.refuse("a pattern", [name for name, given in unused.items() if given])
            if isinstance(sigma, np.ndarray):
                raise TargetError("the noise of a pattern is one number.")
            texture = _as_texture(target, DEFAULT if surface is None else surface, seed, progress)
            template, names = configuration(model, free, init)  # pyright: ignore[reportArgumentType]
            result = fit_colours(
                template,  # pyright: ignore[reportArgumentType]
                names,
                texture,
                palette=None if palette is None else np.stack([from_hex(c) for c in palette]),
                noise=sigma,
                from_template=init is not None,
                seed=seed,
            )
        else:
            unused = {"surface": surface is not None, "palette": palette is not None}
            checks.refuse("a component", [name for name, given in unused.items() if given])
            targets, sigma = with_noise_of_points(as_targets(target, camera), sigma)
            asked = {
                "pose": pose,
                "loss": loss_named(loss),
                "noise": sigma,
                "seed": seed,
                "every_point": every_point,
                "begun": _begun(earlier, pose, targets),
            }
            if pose != "known" and init is None:
                targets = _petal_alone(model, targets, asked["loss"])
            if every_point and (len(targets) > 1 or targets[0].kind != "cloud"):
                raise TargetError(
                    "every_point is there for one cloud; leave it out for masks and joint fits."
                )
            if base is not None:
                checks.check_base(checks.valid_base(base), pose, targets)
                if asked["begun"] is not None:
                    raise TargetError("the pose of init says where the base is; leave base out.")
            if isinstance(model, str):
                result = _fit_best(targets, asked)
            elif isinstance(base, str):
                report("the fit whose tip will be the base")
                turned = _fit_component(model, targets, free, init, asked)  # pyright: ignore[reportArgumentType]
                asked["base"] = tip_of(turned)
                result = _fit_component(model, targets, free, init, asked)  # pyright: ignore[reportArgumentType]
            else:
                asked["base"] = checks.valid_base(base)
                result = _fit_component(model, targets, free, init, asked)  # pyright: ignore[reportArgumentType]
    result = dataclasses.replace(result, timings=dict(seconds))
    if throw and not result.converged:
        raise FitError(result.message, result)
    return result


def check_request(
    model: Fittable | type[Fittable] | str,
    *,
    pose: str,
    loss: str,
    free: Iterable[str] | None,
    init: Fittable | None,
    noise: Noise,
    base: Base = None,
    every_point: bool = False,
) -> None:
    """Checks all options of a fit that can be checked before its target is read.

    Raises:
        TargetError: The options do not fit the model.
        TypeError: The model cannot be fitted.
        ValueError: An option has a value that is not allowed.
    """
    checks.check_pose_name(pose)
    loss_named(loss)
    checks.valid_noise(noise)
    checks.valid_base(base)
    if isinstance(model, str):
        unused = {"base": base is not None, "every_point": every_point}
        checks.refuse("the best of all families", [name for name, given in unused.items() if given])
        if model != "auto" or free is not None or init is not None:
            raise TargetError(
                f"model={model!r} takes neither free nor init; only 'auto' has a name."
            )
        return
    template, _ = configuration(model, free, init)
    if not is_pattern(model):
        given = {"free": free, "init": init, "noise": noise, "base": base}
        given["every_point"] = every_point or None
        names = [name for name, value in given.items() if value is not None]
        checks.check_used(family_of(template), names)  # pyright: ignore[reportArgumentType]


def tip_of(result: FitResult) -> tuple[float, ...]:
    """The place in the target's frame that a fit takes for the tip.

    In an image it is (x, y) in pixels, else (x, y, z).
    """
    tip = np.asarray(result.model(*result.model.domain.tip), np.float64)
    place = result.pose(tip[None])[0].tolist()
    return tuple(place[:2] if result.in_image else place)


def is_pattern(model: object) -> bool:
    """Whether a model is a pattern of colours, rather than a component or a word."""
    kind = model if inspect.isclass(model) else type(model)
    return issubclass(kind, AbstractPattern)


def _begun(
    earlier: FitResult | None, pose: str, targets: Sequence[AbstractObservation]
) -> Pose | None:
    """The pose of an earlier result, if a fit in its target's frame or image may begin there."""
    if earlier is None:
        return None
    in_image = is_one_image(targets)
    return earlier.pose if in_image == earlier.in_image and (in_image or pose != "known") else None


def _fit_component(
    model: AbstractSurface | type[AbstractSurface],
    targets: list[AbstractObservation],
    free: Iterable[str] | None,
    init: AbstractSurface | None,
    asked: dict[str, Any],
) -> FitResult:
    """The result of a fit of a component, whether or not the solver failed."""
    template, names = configuration(model, free, init)
    assert isinstance(template, AbstractSurface)
    family = family_of(template)
    request = Request(
        template=template,
        free=names,
        targets=tuple(targets),
        from_template=init is not None,
        **asked,
    )
    checks.check_targets(family, template, targets)
    posable = [one.kind.__name__ for one in families() if request.pose in one.poses]
    checks.check_pose(family, request, posable)
    checks.check_loss(family, template, request.loss, targets)
    fitted, ends = run(family, request)
    with stage("errors"), jax.enable_x64(True):
        return summarise(family, fitted, ends)


def _petal_alone(
    model: Any, targets: list[AbstractObservation], loss: AbstractLoss
) -> list[AbstractObservation]:
    """The targets; of a single cloud of a petal, other sheets than the petal do not count."""
    first, *others = targets
    is_petal = isinstance(model, str) or family_of(model).is_petal
    if others or not is_petal or not isinstance(first, PointCloud):
        return targets
    return [loss.petal_alone(first)]


def _fit_best(targets: list[AbstractObservation], asked: dict[str, Any]) -> FitResult:
    """The result of the best of all families of petals for one cloud."""
    if len(targets) > 1 or targets[0].kind != "cloud":
        raise TargetError("model='auto' compares families on one cloud; name a model for masks.")
    results, refusals = [], []
    with jax.enable_x64(True):
        for family in petals():
            template, names = configuration(family.kind, None, None)
            if asked["pose"] in family.poses and isinstance(template, AbstractSurface):
                family.foresee(template, names, asked["pose"])
    for family in petals():
        try:
            with prefixed(family.kind.__name__):
                results.append(_fit_component(family.kind, targets, None, None, asked))
        except TargetError as error:
            refusals.append(error)
    if not results:
        raise refusals[0]
    return ranked(results, asked["loss"])


def _as_texture(
    target: object,
    surface: type[AbstractSurface] | AbstractSurface | FitResult,
    seed: int,
    progress: Callable[[str], None] | None,
) -> Texture:
    """The texture that a pattern is fitted to."""
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
