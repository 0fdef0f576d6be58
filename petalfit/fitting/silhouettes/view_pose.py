"""Starts for the pose of a component in silhouettes: its place by triangulation, in all directions."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import cast

import numpy as np
from jaxtyping import Float

from petalfit.components import Posed, lengths, scales_with_lengths
from petalfit.fitting.coordinates import Coordinates
from petalfit.fitting.families.family import AbstractFamily
from petalfit.fitting.likelihood.quadrature import Quadrature
from petalfit.fitting.likelihood.views import ObservedViews
from petalfit.fitting.silhouettes.joint import Joint
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
    """The component in frames that differ from its pose by a small turn and shift, the likeliest first.

    Args:
        family: The family of the component.
        template: The component.
        names: Names of all free parameters, including those of the pose.
        contours: The contours of its masks, each with its camera.
        most: The largest number of frames to return.
    """
    shadows = [Shadow.of(contour) for contour in contours]
    centre = middle(shadows)
    part = Part(ObservedViews.of(contours), tuple(range(len(contours))))
    places = Quadrature.of(in_doubles(template)).places
    own = 0.5 * (places.min(axis=0) + places.max(axis=0))
    ratio = size_in_space(shadows, centre) / float(np.linalg.norm(np.ptp(places, axis=0)))
    unit = _unit(family, template, names, ratio)
    glances = []
    for k, rotation in enumerate(_TURNS):
        report(f"searching the pose, direction {k + 1} of {len(_TURNS)}")
        posed = Posed(template, rotation, centre - unit * rotation @ own, np.float64(unit))
        coordinates = family.rough(Coordinates.of(posed, names))
        (best,) = search(coordinates, shadows, 1, thorough=False)
        glances.append((best.score, coordinates, best.t))
    glances.sort(key=lambda glance: glance[0])
    found: list[tuple[float, Posed]] = []
    for k, (_, coordinates, t) in enumerate(glances[:_LOOKED_AT]):
        report(f"looking closer, direction {k + 1} of {_LOOKED_AT}")
        joint = Joint(family, coordinates, (part,))
        model = joint.minimise(coordinates, coordinates.model(t), 4, 0.5).model
        found.append((joint.misfit(model), cast(Posed, model).at_rest(template)))
    found.sort(key=lambda one: one[0])
    return [frame for _, frame in found[:most]]


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
_LOOKED_AT = 8  # number of directions, the best by support functions, in which contours are matched
