"""Silhouettes of a component whose pose, or whose place in the image, is not known."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import cast

import numpy as np

from petalfit.components import Posed
from petalfit.fitting.families.family import AbstractFamily
from petalfit.fitting.request.request import Request
from petalfit.fitting.silhouettes.joint import Followed, Joint, approach, finish, follow
from petalfit.fitting.silhouettes.view_pose import image_frames, turn_in_image, view_frames, wrapped
from petalfit.fitting.solver.iterate import Iterate
from petalfit.fitting.solver.observer import report
from petalfit.observations import Contour
from petalfit.results import CLEAR_LEAD

# Number of directions from which a component in an unknown pose before cameras is fitted, and the noise
# of contour distances, in pixels, below which no further direction is tried.
_FRAMES, _RIGHT_PIXELS = 3, 0.5
# Noise of binary masks that have no errors but those of their pixels. An end with as little is right.
_PIXELS = 0.35
# Two ends are the same if no place of a grid of so many nodes a side differs by more sizes of the petal.
_NODES, _SAME = 9, 0.01
_WAYS = ("up", "to the left", "down", "to the right")


def fit_views_anywhere(
    family: AbstractFamily, request: Request, contours: Sequence[Contour]
) -> list[Iterate]:
    """Fit a component that lies anywhere before the cameras of its masks.

    Outlines seldom tell base and tip for certain. Of ends that are almost as good as the best, the answer
    is one whose base is where it usually is, by the family, unless the base was given.

    Args:
        family: The family of the template.
        request: The request; the parameters of its pose are free.
        contours: The contours of the masks.

    Returns:
        The ends for all directions that were tried, the best first.
    """
    near = view_frames(family, request.template, request.free, contours, _FRAMES)
    frames = [model.at_rest(request.template) for model in near]
    joint = Joint.of(family, dataclasses.replace(request, template=frames[0]))
    found: list[Followed] = []
    for k, (frame, model) in enumerate(zip(frames, near, strict=True)):
        report(f"following direction {k + 1} of {len(near)}")
        here = joint.in_frame(frame)
        followed: list[Followed] = []
        if here.views is not None and not request.from_template:
            followed += approach(here, here.views, model.at_rest(model.surface))
        if not any(_noise(one) < _PIXELS for one in followed):
            followed += follow(here, request)
        found += [one.labelled(f"direction {k + 1}") for one in followed]
        # One mask tells so little of a blade in an unknown pose that its ends hardly matter.
        if request.base is not None or not joint.hidden:
            other = _other_way(family, request, joint, followed)
            found += other
            # Two ways that are nearly one surface are compared where both were followed as far.
            if other and min(one.cost for one in followed) - other[0].cost > CLEAR_LEAD:
                back = _other_way(family, request, joint, other)
                found += [one.labelled(f"direction {k + 1}") for one in back]
        if min(map(_noise, found)) < _RIGHT_PIXELS:
            break
    found = sorted(found, key=lambda one: one.cost)
    if request.base is not None:
        place = np.asarray(request.base)
        found = [one for one in found if _begins_near(one, place)] or found
    else:
        found = _usual_first(family, found)
    return [family.standard_form(end, request.free) for end in finish(request, found)]


def fit_in_image(family: AbstractFamily, request: Request, contour: Contour) -> list[Iterate]:
    """Fit a component that is seen from the front, in an unknown place of its image and turned there.

    An outline seldom tells base and tip for certain. Of ends that are almost as good as the best, the
    answer is the one with y nearest to up, whose base is below the tip, unless the base was given.

    Args:
        family: The family of the template.
        request: The request; the parameters of the place in the image are free.
        contour: The contour of its mask, which has no camera.

    Returns:
        The ends for all turns that were tried, the answer first.
    """
    if request.begun is not None:
        place = request.begun
        shift, scale = np.asarray(place.translation), float(place.scale)
        frames = [Posed(request.template, np.asarray(place.rotation), shift, np.float64(scale))]
    else:
        frames = image_frames(family, request, contour, _FRAMES)
    joint = Joint.of(family, dataclasses.replace(request, template=frames[0]))
    found: list[Followed] = []
    for k, frame in enumerate(frames):
        report(f"following turn {k + 1} of {len(frames)}")
        followed = follow(joint.in_frame(frame), request, ("turn_z",))
        found += [one.labelled(_way(family, frame)) for one in followed]
        if request.begun is None and request.base is None:
            for other in _other_way(family, request, joint, followed):
                found.append(other.labelled(_way(family, cast(Posed, other.end.model))))
    found = _different(sorted(found, key=lambda one: one.cost))
    good = _as_good(found)
    if request.base is None:
        turn = min((_turn(one) for one in good), key=abs)
        good = [one for one in good if not abs(wrapped(_turn(one) - turn)) > 0.25 * np.pi]
    return finish(request, [good[0], *(one for one in found if one is not good[0])])


def _other_way(
    family: AbstractFamily, request: Request, joint: Joint, followed: Sequence[Followed]
) -> list[Followed]:
    """The end with base and tip exchanged that is reached from the best of some ends, if there is one."""
    best = min(followed, key=lambda one: one.cost)
    other = family.the_other_way(cast(Posed, best.end.model))
    if other is None:
        return []
    turned = joint.in_frame(other.at_rest(request.template))
    return [turned.follow("base and tip exchanged", other.at_rest(other.surface), best.held)]


def _noise(followed: Followed) -> float:
    """The noise of contour distances at an end, in pixels."""
    return followed.end.residuals[0].noise


def _as_good(found: Sequence[Followed]) -> list[Followed]:
    """The first of several ends, and those that are almost as good."""
    return [one for one in found if one is found[0] or one.cost - found[0].cost < CLEAR_LEAD]


def _usual_first(family: AbstractFamily, found: Sequence[Followed]) -> list[Followed]:
    """Ends, of which one that is almost as good as the first comes first if its base is the usual one."""
    good = _as_good(found)
    usual = [one for one in good if family.is_usual_way(one.end.model)]
    best, *_ = usual or good
    return [best, *(one for one in found if one is not best)]


def _begins_near(followed: Followed, place: np.ndarray) -> bool:
    """Whether a place is nearer to the base of an end than to its tip."""
    model = followed.end.model
    ends = np.array([model.domain.base, model.domain.tip])
    base, tip = np.asarray(model(*ends.T), np.float64)
    return bool(np.linalg.norm(base - place) < np.linalg.norm(tip - place))


def _different(found: Sequence[Followed]) -> list[Followed]:
    """The ends without those that are nearly the same surface as an earlier one."""
    kept: list[Followed] = []
    places: list[np.ndarray] = []
    for one in found:
        model = one.end.model
        u, v = np.meshgrid(
            *(np.linspace(low, high, _NODES) for low, high in model.domain), indexing="ij"
        )
        own = np.asarray(model(u, v), np.float64)
        size = np.ptp(own.reshape(-1, 3), axis=0).max()
        if all(np.abs(own - other).max() > _SAME * size for other in places):
            kept.append(one)
            places.append(own)
    return kept


def _turn(followed: Followed) -> float:
    return turn_in_image(cast(Posed, followed.end.model))


def _way(family: AbstractFamily, posed: Posed) -> str:
    """The words for a turn in an image, such as "tip up"."""
    quarter = round(turn_in_image(posed) / (0.5 * np.pi)) % 4
    return f"{'tip' if family.is_petal else 'y'} {_WAYS[quarter]}"
