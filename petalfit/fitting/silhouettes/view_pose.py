"""Frames for a component in silhouettes: before cameras in all directions, in an image by all turns."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import cast

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from petalfit.components import Posed, lengths, scales_with_lengths
from petalfit.fitting.coordinates import Coordinates
from petalfit.fitting.families.family import AbstractFamily
from petalfit.fitting.likelihood.quadrature import Quadrature
from petalfit.fitting.likelihood.views import ObservedViews
from petalfit.fitting.request.request import Request
from petalfit.fitting.silhouettes.joint import Joint, is_promising
from petalfit.fitting.silhouettes.observing import Part
from petalfit.fitting.solver.observer import report
from petalfit.fitting.starts.support import Shadow, search
from petalfit.observations import Contour
from petalfit.surfaces import AbstractSurface, in_doubles, value_at


def view_frames(
    family: AbstractFamily,
    template: AbstractSurface,
    names: tuple[str, ...],
    contours: Sequence[Contour],
    most: int,
) -> list[Posed]:
    """The component near its masks, in frames that differ from its pose by a small turn and shift.

    The likeliest is the first.

    Args:
        family: The family of the component.
        template: The component.
        names: Names of all free parameters, including those of the pose.
        contours: The contours of its masks, each with its camera.
        most: The largest number of them to return.
    """
    shadows = [Shadow.of(contour) for contour in contours]
    centre = middle(shadows)
    part = Part(ObservedViews.of(contours), tuple(range(len(contours))))
    places = Quadrature.of(in_doubles(template)).places
    own = 0.5 * (places.min(axis=0) + places.max(axis=0))
    ratio = size_in_space(shadows, centre) / float(np.linalg.norm(np.ptp(places, axis=0)))
    unit = _unit(family, template, names, ratio)
    around = [
        Posed(template, rotation, centre - unit * rotation @ own, np.float64(unit))
        for rotation in _TURNS
    ]
    near = _nearest(family, around, names, shadows, part, _LOOKED_AT)
    return [model for _, model in near[:most]]


def image_frames(
    family: AbstractFamily, request: Request, contour: Contour, most: int
) -> list[Posed]:
    """The component seen from the front, turned in its image, the likeliest turn first.

    Args:
        family: The family of the component.
        request: The request; the parameters of the place in the image are free.
        contour: The contour of its mask, which has no camera.
        most: The largest number of frames to return.
    """
    part, template = Part(ObservedViews.of([contour]), (0,)), request.template
    given = request.from_template
    names = Posed.in_image if given else request.free
    around = [_front(template, contour, turn) for turn in _TURNS_IN_IMAGE]
    if request.base is not None:
        around = [frame for frame in around if _is_below(frame, request.base)]
    near = _nearest(family, around, names, [Shadow.of(contour)], part, _LOOKED_AT)
    best, _ = near[0]
    frames: list[Posed] = []
    for misfit, model in near:
        turn = turn_in_image(model)
        apart = [abs(wrapped(turn - turn_in_image(frame))) for frame in frames]
        if is_promising(misfit, best) and min(apart, default=np.inf) > _APART:
            frame = model.at_rest(template) if given else _front(template, contour, turn)
            frames.append(frame)
    return frames[:most]


def _is_below(frame: Posed, place: Sequence[float]) -> bool:
    """Whether a place in the image is on the side of a frame's origin where y is negative."""
    across = np.asarray(place) - np.asarray(frame.origin)[:2]
    return bool(across @ np.asarray(frame.rotation)[:2, 1] <= 0)


def turn_in_image(posed: Posed) -> float:
    """The turn in rad, counterclockwise, of a component that is seen from the front; 0 if y is up."""
    turned = FRONT @ np.asarray(posed.placement.rotation)
    return float(np.arctan2(turned[1, 0], turned[0, 0]))


def wrapped(turn: float) -> float:
    """The same turn between −π and π."""
    return float(np.remainder(turn + np.pi, 2 * np.pi) - np.pi)


def _front(template: AbstractSurface, contour: Contour, turn: float) -> Posed:
    """A component seen from the front in the middle of a contour, counterclockwise by a turn in rad."""
    rotation = FRONT @ Rotation.from_rotvec([0.0, 0.0, turn]).as_matrix()
    low, high = contour.place.min(axis=0), contour.place.max(axis=0)
    along = np.ptp(contour.place @ rotation[:2, 1])
    middle = np.append(0.5 * (low + high), 0.0)
    return Posed(template, rotation, middle, np.float64(along / _TYPICAL_LENGTH))


def _nearest(
    family: AbstractFamily,
    around: Sequence[Posed],
    names: tuple[str, ...],
    shadows: Sequence[Shadow],
    part: Part,
    most: int,
) -> list[tuple[float, Posed]]:
    """Models near silhouettes with their misfits, of the frames in which they may be, the best first.

    Args:
        family: The family of the component.
        around: Frames from which the poses of the models differ by a small turn and shift.
        names: Names of all free parameters, including those of the pose.
        shadows: The shadows of the silhouettes.
        part: Their likelihood.
        most: The number of frames, the best by support functions, in which contours are matched.
    """
    glances = []
    for k, frame in enumerate(around):
        report(f"searching the pose, direction {k + 1} of {len(around)}")
        coordinates = family.rough(Coordinates.of(frame, names))
        (best,) = search(coordinates, shadows, 1, thorough=False)
        glances.append((best.score, coordinates, best.t))
    glances.sort(key=lambda glance: glance[0])
    found: list[tuple[float, Posed]] = []
    for k, (_, coordinates, t) in enumerate(glances[:most]):
        report(f"looking closer, direction {k + 1} of {min(most, len(glances))}")
        joint = Joint(family, coordinates, (part,))
        model = joint.minimise(coordinates, coordinates.model(t), 4, 0.5).model
        misfit = joint.misfit(model)
        found.append((misfit if np.isfinite(misfit) else np.inf, cast(Posed, model)))
    return sorted(found, key=lambda one: one[0])


def _unit(
    family: AbstractFamily, template: AbstractSurface, names: Sequence[str], ratio: float
) -> float:
    """The length of the model's unit in that of the cameras.

    Cameras often have the unit of a scene of size 1. Typical ranges belong to petals of typical size, so
    that a petal of another size is fitted in another unit. It is 1 if a length is held, and for nearly
    typical petals if the shape has lengths of its own.

    Args:
        family: The family of the component.
        template: The component, of typical size.
        names: Names of all free parameters.
        ratio: The size of the petal before the cameras in sizes of the template.
    """
    gauges = family.gauges.get("rigid", ())
    held = [name for name in lengths(template) if name not in (*names, *gauges)]
    if any(float(value_at(template, name)) != 0 for name in held):
        return 1.0
    if not scales_with_lengths(template) and 1 / _TYPICAL < ratio < _TYPICAL:
        return 1.0
    return ratio


def size_in_space(shadows: Sequence[Shadow], centre: Float[np.ndarray, "3"]) -> float:
    """The size that an object at a place has in space, by the sizes of its shadows: their largest."""
    sizes = []
    for shadow in shadows:
        depth = float(shadow.matrix[2] @ np.append(centre, 1.0))
        pixels_per_unit = np.linalg.norm(shadow.matrix[0, :3]) / abs(depth)
        if shadow.matrix[2, :3].any():
            # Of the row of a perspective camera only the part across its axis is the focal length.
            across = np.cross(shadow.matrix[0, :3], shadow.matrix[2, :3])
            pixels_per_unit = np.linalg.norm(across) / abs(depth)
        sizes.append(shadow.size / pixels_per_unit)
    return float(max(sizes))


def middle(shadows: Sequence[Shadow]) -> Float[np.ndarray, "3"]:
    """The place that cameras see nearest to the middles of all silhouettes.

    If several places do, it is the one nearest to the world's origin.
    """
    rows, right = [], []
    for shadow in shadows:
        centre = 0.5 * (shadow.place.min(axis=0) + shadow.place.max(axis=0))
        along = shadow.matrix[:2] - centre[:, None] * shadow.matrix[2]
        rows.append(along[:, :3])
        right.append(-along[:, 3])
    return np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=1e-9)[0]


def _quarter_turns() -> list[Float[np.ndarray, "3 3"]]:
    """The 24 rotations of a cube."""
    found = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            matrix = np.diag(signs)[:, list(order)]
            if np.linalg.det(matrix) > 0:
                found.append(matrix)
    return found


_TURNS = _quarter_turns()
_TYPICAL = 4.0  # a petal is of typical size if it is less than so many times larger or smaller
# The rotation that takes a component's axes to those of an image: x right, y down, z away.
FRONT = np.diag([1.0, -1.0, -1.0])
_TURNS_IN_IMAGE = np.pi / 3 * np.array([0, 1, -1, 2, -2, 3])
# Typical length of a petal in the model's unit, for a mask without a camera.
_TYPICAL_LENGTH = 40.0
_APART = 0.6  # rad; of turns that differ by less, one is followed
_LOOKED_AT = 8  # number of directions, the best by support functions, in which contours are matched
