"""What a fit is asked for, and whether it can be had: a sentence for everything that cannot."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Sequence
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from petalfit.colours import AbstractPattern
from petalfit.components import AbstractAssembly, BladePetal, PeonyPetal, SplinePetal, parameters
from petalfit.observations import Contour, PointCloud, Silhouette, TargetError
from petalfit.surfaces import AbstractSurface, value_at

Fittable: TypeAlias = AbstractSurface | AbstractPattern


def configuration(
    model: Fittable | type[Fittable],
    free: Iterable[str] | None,
    init: Fittable | None,
) -> tuple[Fittable, tuple[str, ...]]:
    """The template and the names of its free parameters, checked."""
    kind = model if inspect.isclass(model) else type(model)
    fittable = inspect.isclass(kind) and issubclass(kind, AbstractSurface | AbstractPattern)
    if not (fittable and parameters(kind)):
        raise TypeError(
            f"model must be a component or a pattern with declared parameters, a class or an "
            f"instance; received {model!r}"
        )
    declared = parameters(kind)
    if init is not None and type(init) is not kind:
        raise TargetError(f"init must be a {kind.__name__}; received a {type(init).__name__}.")
    template = init if init is not None else model() if inspect.isclass(model) else model
    if free is None:
        names = tuple(name for name, p in declared.items() if not p.fixed)
    else:
        wanted = [free] if isinstance(free, str) else list(free)
        unknown = [name for name in wanted if name not in declared]
        if unknown or not wanted:
            raise TargetError(
                f"free names {', '.join(map(repr, unknown)) or 'no parameter'}; the parameters of "
                f"{kind.__name__} are {', '.join(declared)}."
            )
        names = tuple(name for name in declared if name in wanted)
    for name, parameter in declared.items():
        value = float(value_at(template, name))
        low, high = parameter.bounds
        if not low < value < high:
            raise TargetError(
                f"{name} = {value:g} of the start lies outside its range ({low:g}, {high:g}); give "
                "an init inside it."
            )
    return template, names


def check_request(
    model: Fittable | type[Fittable] | str,
    *,
    pose: str,
    loss: str,
    free: Iterable[str] | None,
    init: Fittable | None,
    noise: float | Sequence[float] | Float[np.ndarray, " n"] | None,
) -> None:
    """All that can be wrong about a fit before its target is seen."""
    check_options(pose, loss)
    valid_noise(noise)
    if isinstance(model, str):
        check_name(model, free, init)
    else:
        configuration(model, free, init)


def check_name(model: str, free: Iterable[str] | None, init: Fittable | None) -> None:
    """Models are classes or instances; the only one with a name chooses among several."""
    if model != "auto" or free is not None or init is not None:
        raise TargetError(f"model={model!r} takes neither free nor init; only 'auto' has a name.")


def check_options(pose: str, loss: str) -> None:
    """Words that no model and no target could go with."""
    if pose not in ("known", "rigid", "similarity"):
        raise ValueError(f"pose must be 'known', 'rigid' or 'similarity'; received {pose!r}")
    if loss not in ("linear", "robust"):
        raise ValueError(f"loss must be 'linear' or 'robust'; received {loss!r}")


def valid_noise(
    noise: float | Sequence[float] | Float[np.ndarray, " n"] | None,
) -> float | Float[np.ndarray, " n"] | None:
    """A positive length, or one for each point; None if it is to be estimated."""
    if noise is None:
        return None
    sigma = np.asarray(noise, np.float64)
    if sigma.ndim > 1 or not np.all(np.isfinite(sigma) & (sigma > 0)):
        raise ValueError(
            f"noise must be a positive length, one for each point, or None; received {noise}"
        )
    return sigma if sigma.ndim else float(sigma)


def check_pose(
    template: AbstractSurface,
    pose: str,
    targets: list[PointCloud | Silhouette],
    init: Fittable | None,
) -> None:
    """What a pose can be found for."""
    if pose == "known":
        return
    if init is not None:
        raise TargetError(f"init has no pose to start from; leave it out with pose={pose!r}.")
    kind = type(template).__name__
    views = [part for part in targets if isinstance(part, Silhouette)]
    if len(views) == len(targets):
        if pose == "similarity" or any(view.camera is None for view in views):
            raise TargetError(
                f"pose={pose!r} does not go with these masks: with a camera for each the pose may "
                "be 'rigid'; without one it is 'known' to be a front view."
            )
        if isinstance(template, AbstractAssembly | SplinePetal):
            raise TargetError(f"a {kind} is fitted to one cloud.")
        return
    if not isinstance(template, PeonyPetal | BladePetal | SplinePetal):
        raise TargetError(
            f"pose={pose!r} is there for PeonyPetal, BladePetal and SplinePetal; bring a {kind} into "
            "its own frame."
        )
    if len(targets) > 1:
        raise TargetError(f"pose={pose!r} is there for one cloud, or for masks with cameras.")


def check_loss(
    template: AbstractSurface, loss: str, targets: list[PointCloud | Silhouette]
) -> None:
    """What strays can be found in."""
    if loss == "linear":
        return
    if len(targets) > 1 or not isinstance(targets[0], PointCloud):
        raise TargetError(
            "loss='robust' is there for one cloud; masks discount strays by themselves."
        )
    if isinstance(template, AbstractAssembly):
        raise TargetError(
            f"loss='robust' is there for components of one surface; a {type(template).__name__} has "
            "several."
        )


def check_count(weights: np.ndarray, names: tuple[str, ...]) -> None:
    """More points than parameters."""
    count = np.count_nonzero(weights)
    if count < len(names) + 1:
        raise TargetError(
            f"{count} points cannot determine {len(names)} free parameters; at least "
            f"{len(names) + 1} are needed: give more points, or name fewer parameters in free."
        )


def check_frame(cloud: PointCloud, template: AbstractSurface, pose: str) -> None:
    """A unit in which the model's ranges can reach the points."""
    lengths = [p.bounds for p in parameters(template).values() if p.unit == "length"]
    largest = max(high for _, high in lengths)
    smallest = min(low for low, _ in lengths if low > 0)
    reach = float(np.abs(cloud.points).max()) if pose == "known" else cloud.diagonal
    kind = type(template).__name__
    if reach > 10 * largest:
        raise TargetError(
            f"coordinates reach {reach:.3g} where the lengths of {kind} end at {largest:g}: bring the "
            "target to the model's unit and near its origin."
        )
    if cloud.diagonal < 0.1 * smallest:
        raise TargetError(
            f"the target is only {cloud.diagonal:.3g} across where the lengths of {kind} begin at "
            f"{smallest:g}: bring it to the model's unit."
        )


def check_view(contour: Contour, template: AbstractSurface) -> None:
    """A camera that sees the model where it may be."""
    camera = contour.camera
    corners = np.asarray(template.mesh((5, 5)).vertices)
    if camera.is_orthographic:
        return
    depth = camera.depth(corners)
    if depth.max() <= 0:
        raise TargetError(
            "the camera looks away from the petal, which lies behind it (z ≤ 0 in the camera's frame); "
            "OpenCV cameras look along +z, and with pose='known' the petal begins at the origin."
        )
    if depth.min() <= 0:
        raise TargetError(
            "the camera stands in or beside the petal, part of which lies behind it; with pose='known' "
            "the petal begins at the origin and runs along +y."
        )
