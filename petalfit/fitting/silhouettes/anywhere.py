"""Silhouettes of a component whose pose, or whose place in the image, is not known."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from petalfit.components import Posed
from petalfit.fitting.families.family import AbstractFamily
from petalfit.fitting.request.request import Request
from petalfit.fitting.silhouettes.joint import fit_joint
from petalfit.fitting.silhouettes.view_pose import view_frames
from petalfit.fitting.solver.iterate import Iterate, best_first
from petalfit.fitting.solver.observer import report
from petalfit.observations import Contour
from petalfit.surfaces import AbstractSurface

# Typical length of a petal in the model's unit, for a mask without a camera.
_TYPICAL_LENGTH = 40.0
# Number of directions from which a component in an unknown pose before cameras is fitted, and the noise
# of contour distances, in pixels, below which no further direction is tried.
_FRAMES, _RIGHT_PIXELS = 3, 0.5


def fit_views_anywhere(
    family: AbstractFamily, request: Request, contours: Sequence[Contour]
) -> list[Iterate]:
    """Fit a component that lies anywhere before the cameras of its masks.

    Args:
        family: The family of the template.
        request: The request; the parameters of its pose are free.
        contours: The contours of the masks.

    Returns:
        The ends for all directions that were tried, the best first.
    """
    frames = view_frames(family, request.template, request.free, contours, _FRAMES)
    ends: list[Iterate] = []
    for k, frame in enumerate(frames):
        report(f"following direction {k + 1} of {len(frames)}")
        for end in fit_joint(family, dataclasses.replace(request, template=frame)):
            ends.append(dataclasses.replace(end, label=f"direction {k + 1}, {end.label}"))
        if min(end.residuals[0].noise for end in ends) < _RIGHT_PIXELS:
            break
    return best_first(ends)


def in_image(template: AbstractSurface, contour: Contour, placed: Mapping[str, float]) -> Posed:
    """A component seen from the front in an unknown place of its image.

    Args:
        template: The component.
        contour: The contour of its mask, which has no camera.
        placed: The scale and the shifts to start from, in pixels; may be empty.
    """
    low, high = contour.place.min(axis=0), contour.place.max(axis=0)
    middle, unit = 0.5 * (low + high), float(high[1] - low[1]) / _TYPICAL_LENGTH
    return Posed(
        template,
        # This turns the petal's axes to those of the image: x right, y down, z away from the viewer.
        np.diag([1.0, -1.0, -1.0]),
        np.append(middle, 0.0),
        unit,
        placed.get("scale", unit) / unit,
        (placed.get("shift_x", middle[0]) - middle[0]) / unit,
        (placed.get("shift_y", middle[1]) - middle[1]) / unit,
    )
