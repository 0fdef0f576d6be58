"""Whether a component is as large as its lengths: twice their values, and it is twice as large."""

from __future__ import annotations

import numpy as np

from petalfit.surfaces import AbstractSurface, parameters, with_value

_NODES = (9, 9)
_SAME = 1e-3  # largest difference, relative to the size; meshes may be in single precision


def lengths(model: AbstractSurface) -> list[str]:
    """Names of the parameters that are lengths."""
    return [name for name, p in parameters(model).items() if p.unit == "length"]


def scales_with_lengths(model: AbstractSurface) -> bool:
    """Whether all of the component's shape stays the same if its lengths are multiplied by a number.

    The shape of some models has lengths that are no parameters; their unit is that of the paper.
    """
    declared = parameters(model)
    small, large = model, model
    for name in lengths(model):
        low, high = declared[name].typical
        value = low + 0.7 * (high - low)
        small, large = with_value(small, name, 0.5 * value), with_value(large, name, value)
    half, whole = (np.asarray(sheet.mesh(_NODES).vertices) for sheet in (small, large))
    return bool(np.abs(2 * half - whole).max() <= _SAME * np.ptp(whole, axis=0).max())
