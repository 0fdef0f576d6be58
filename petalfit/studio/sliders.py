"""Sliders for parameters; ranges and units come from the declarations of the parameters."""

from __future__ import annotations

import math
from collections.abc import Callable

import viser

from petalfit.surfaces import Parameter

_STEPS = 400


def slider_range(parameter: Parameter, value: float) -> tuple[float, float, float]:
    """Lowest value, highest value and step: 1.5 typical ranges and the value, within the bounds."""
    low, high = parameter.typical
    room = 0.25 * (high - low)
    low, high = min(low - room, value), max(high + room, value)
    # Bounds are open intervals, whose ends are not valid values.
    inside = 1e-3 * (high - low)
    low, high = max(low, parameter.bounds[0] + inside), min(high, parameter.bounds[1] - inside)
    decimals = -math.floor(math.log10((high - low) / _STEPS))
    step = round(10.0**-decimals, max(decimals, 0))
    low, high = step * math.floor(low / step), step * math.ceil(high / step)
    return max(low, parameter.bounds[0]), min(high, parameter.bounds[1]), step


def add_slider(
    gui: viser.GuiApi,
    label: str,
    parameter: Parameter,
    value: float,
    moved: Callable[[viser.GuiEvent[viser.GuiSliderHandle[float]]], None],
) -> viser.GuiSliderHandle[float]:
    """A slider that calls `moved` when it moves; its hint shows the declaration of the parameter."""
    unit = {"1": "no unit"}.get(parameter.unit, parameter.unit)
    lowest, highest = parameter.typical
    typical = f"typically {lowest:g} to {highest:g}"
    hint = f"{parameter.meaning} ({parameter.symbol}; {unit}; {typical})"
    low, high, step = slider_range(parameter, value)
    shown = min(max(step * round(value / step), low), high)
    handle = gui.add_slider(label, float(low), float(high), float(step), float(shown), hint=hint)
    handle.on_update(moved)
    return handle
