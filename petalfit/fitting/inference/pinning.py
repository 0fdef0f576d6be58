"""Pinning: parameters that the data do not determine keep the template's values."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from petalfit.components import bare, parameters
from petalfit.fitting.coordinates import Coordinates, Prior, with_values
from petalfit.fitting.inference.identifiability import known_alone, known_if_others_were
from petalfit.fitting.solver.iterate import Iterate
from petalfit.surfaces import AbstractSurface, value_at


def pinned(
    coordinates: Coordinates,
    end: Iterate,
    again: Callable[[AbstractSurface, Prior], Iterate],
) -> Iterate:
    """The end with the template's values for undetermined parameters, as far as the data allow.

    Args:
        coordinates: The free parameters.
        end: The best end.
        again: Solves again from a start, with a prior.
    """
    free, template = coordinates.free, coordinates.template
    if not end.is_finite:
        return end
    found = known_alone(end, free, parameters(template))
    unknown = {name for name, yes in zip(free, found, strict=True) if not yes}
    start = {name: value_at(template, name) for name in free if name in unknown}
    waves = bare(template).oscillation
    of_waves = () if waves is None else waves.names
    if rest := {name: value for name, value in start.items() if name not in of_waves}:
        centre = coordinates.inverse(with_values(end.model, rest))
        prior = Prior(centre, np.isin(free, [*rest]).astype(float))
        # Parameters that are known in combination start where that combination explains the data.
        alone = dict(zip(free, known_if_others_were(end, free, parameters(template)), strict=True))
        model = with_values(end.model, {n: v for n, v in rest.items() if not alone[n]})
        end = dataclasses.replace(again(model, prior), chi2=end.chi2)
    # Undetermined waves get the template's values without another fit: they do not show.
    hidden = {name: value for name, value in start.items() if name in of_waves}
    return dataclasses.replace(end, model=with_values(end.model, hidden)) if hidden else end
