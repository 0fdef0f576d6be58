"""The family of spline surfaces, whose many coefficients follow a scan closely and have no names."""

from __future__ import annotations

from typing import ClassVar, cast

import numpy as np

from petalfit.compilation import stage
from petalfit.components import Posed, SplinePetal, bare
from petalfit.fitting.families.family import AbstractFamily
from petalfit.fitting.families.spline.equations import surfaces_of
from petalfit.fitting.families.spline.smoothing import in_own_frame, smooth
from petalfit.fitting.likelihood.foot_points import distances_beside, signed_distance
from petalfit.fitting.likelihood.observed import Residuals
from petalfit.fitting.request.checks import POSES
from petalfit.fitting.request.request import Request, scan_of
from petalfit.fitting.solver.iterate import Iterate
from petalfit.fitting.starts.frame import NormalisedFrame
from petalfit.results import errors_of
from petalfit.surfaces import AbstractSurface

# Only of these traits the errors of the coefficients are all: others depend on where on the surface the
# midrib and the corners lie, which follows from how the cloud was flattened.
_KNOWN = ("area",)


class SplineFamily(AbstractFamily):
    """The family of spline surfaces. Their fits take no start, and no parameter is free."""

    kind: ClassVar[type[AbstractSurface]] = SplinePetal
    poses: ClassVar[tuple[str, ...]] = POSES
    is_petal: ClassVar[bool] = True
    takes: ClassVar[frozenset[str]] = frozenset({"noise", "seed"})
    fewest: ClassVar[int | None] = 200
    sees_outlines: ClassVar[bool] = False
    named_errors: ClassVar[bool] = False

    def fit_cloud(self, request: Request) -> list[Iterate]:
        cloud = request.cloud
        frame = NormalisedFrame.of(cloud.points[cloud.mass > 0], "similarity")
        scan, order = scan_of(request, frame, True)
        with stage("polishing"):
            found = smooth(scan)
            model, pose = in_own_frame(found.control, frame, request.pose)
            distance, beyond, uv = distances_beside(model, pose.into(cloud.points))
            distance = float(pose.scale) * signed_distance(distance, beyond)
        weights = np.array(cloud.mass)
        if found.mixture is not None:
            weights[np.flatnonzero(weights > 0)[order]] *= found.mixture.members
        noise = request.noise or float(np.sqrt(np.average(distance**2, weights=weights)))
        residuals = Residuals(distance, weights, noise, "length", 0.0, uv)
        with stage("errors"):
            known = found.posterior
            errors = errors_of(
                surfaces_of(known.draws()), frame.unit, model.orientation, known.doubtful
            )
        posed = model
        if request.pose != "known":
            posed = Posed(model, pose.rotation, pose.translation, pose.scale)
        return [
            Iterate(
                posed,
                (),
                found.rounds,
                0.0,
                chi2=0.0,
                information=np.zeros((0, 0)),
                score_covariance=np.zeros((0, 0)),
                residuals=(residuals,),
                mixture=found.mixture,
                freedom=found.freedom,
                trait_errors={name: errors[name] for name in _KNOWN},
            )
        ]

    def outcome(self, end: Iterate) -> str:
        count = np.size(cast(SplinePetal, bare(end.model)).offsets)
        return f"{count} coefficients, smoothed in {end.rounds} rounds; only traits have errors"
