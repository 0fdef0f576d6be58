"""The family of any component of one surface, in a known pose, with starts by the cloud's extent."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from petalfit.fitting.coordinates import Coordinates, Prior
from petalfit.fitting.families.family import AbstractFamily
from petalfit.fitting.families.polish import START_POINTS, Polishing, follow
from petalfit.fitting.likelihood.cloud import ObservedCloud
from petalfit.fitting.likelihood.quadrature import Quadrature
from petalfit.fitting.outliers.scan import Scan
from petalfit.fitting.request.request import Request, scan_of
from petalfit.fitting.solver.all_points import with_all_points
from petalfit.fitting.solver.iterate import Iterate
from petalfit.fitting.starts.extent import extent_starts
from petalfit.fitting.starts.frame import NormalisedFrame
from petalfit.residuals import Data
from petalfit.surfaces import AbstractSurface, Rectangle


class ComponentFamily(AbstractFamily):
    """The family of components that have no family of their own."""

    kind: ClassVar[type[AbstractSurface]] = AbstractSurface
    takes: ClassVar[frozenset[str]] = AbstractFamily.takes | {"every_point"}

    def fit_cloud(self, request: Request) -> list[Iterate]:
        coordinates = Coordinates.of(request.template, request.free)
        scan, _ = scan_of(request, NormalisedFrame.of(request.cloud.points, "known"), False)
        starts = [("given", coordinates.template)]
        if not request.from_template:
            some = scan.some(START_POINTS)
            starts = extent_starts(coordinates, _observed, scan.points[some], scan.weights[some])

        polish = Polishing(scan, coordinates)

        def end_of(label: str, model: AbstractSurface, prior: Prior | None) -> Iterate | None:
            end = polish(label, model, prior)
            return None if end is None else _uniformly_covered(end, scan)

        best, *others = follow(coordinates, starts, end_of)
        return [with_all_points(best, 0, request.cloud), *others]


class RectangleFamily(ComponentFamily):
    """The family of rectangles; a fitted pose makes their place along the normal redundant."""

    kind: ClassVar[type[AbstractSurface]] = Rectangle
    gauges: ClassVar[Mapping[str, tuple[str, ...]]] = {"rigid": ("c_z",)}


def _observed(points: np.ndarray, weights: np.ndarray, noise: float | None) -> ObservedCloud:
    return ObservedCloud(Data.of(points, weights, noise))


def _uniformly_covered(end: Iterate, scan: Scan) -> Iterate:
    """The end with a χ² that includes the likelihood of points that cover its area evenly.

    By distances alone, a surface that extends beyond all points would be as good as a shorter one.
    """
    area = float(np.sum(Quadrature.of(end.model).area))
    chi2 = 2 * float(np.sum(scan.weights) * np.log(max(area, 1e-300)))
    return dataclasses.replace(end, chi2=end.chi2 + chi2)
