"""Organs of several surfaces, a stamen or a pistil, in a known pose."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from petalfit.components import AbstractAssembly
from petalfit.fitting.coordinates import Coordinates, Prior
from petalfit.fitting.families.assembly.observed import ObservedParts
from petalfit.fitting.families.family import AbstractFamily
from petalfit.fitting.families.polish import START_POINTS, follow
from petalfit.fitting.request.request import Request
from petalfit.fitting.solver.alternate import minimise
from petalfit.fitting.solver.debias import without_bias
from petalfit.fitting.solver.iterate import Iterate
from petalfit.fitting.starts.extent import extent_starts
from petalfit.surfaces import AbstractSurface

_ROUNDS = 30
_TOLERANCE = 1e-2  # standard errors


class AssemblyFamily(AbstractFamily):
    """The family of assemblies, in which points are shared among the parts by their likelihood."""

    kind: ClassVar[type[AbstractSurface]] = AbstractAssembly
    sees_outlines: ClassVar[bool] = False
    finds_outliers: ClassVar[bool] = False

    def fit_cloud(self, request: Request) -> list[Iterate]:
        coordinates = Coordinates.of(request.template, request.free)
        points, weights = request.cloud.points, request.cloud.mass
        observed = ObservedParts.of(points, weights, request.noise)
        used = np.flatnonzero(weights > 0)
        some = used[np.random.default_rng(request.seed).permutation(len(used))][:START_POINTS]
        starts = [("given", coordinates.template)]
        if not request.from_template:
            starts = extent_starts(coordinates, ObservedParts.of, points[some], weights[some])

        def end_of(label: str, model: AbstractSurface, prior: Prior | None) -> Iterate:
            end = minimise(
                coordinates, [observed], model, [None], _ROUNDS, _TOLERANCE, prior, every=2
            )
            return without_bias(coordinates, label, [observed], end, prior)

        return follow(coordinates, starts, end_of)
