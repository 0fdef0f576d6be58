"""Traits: what botanists measure of a petal or leaf, with errors, in the target's unit."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import jax
import numpy as np
from jaxtyping import Array, Float, Float64

from petalfit.compilation import Program
from petalfit.components import parameters
from petalfit.surfaces import (
    AbstractSurface,
    Measures,
    batch_of,
    measures,
    nodes,
    value_at,
)

_AT_ONCE = 100  # sheets that are measured together, because of memory
_RELATIVE = 1e-3  # the largest step of a parameter that is always positive, relative to its value
_STEP = 1e-4  # step of the central differences, in standard deviations of a typical range
# Unit ("unit" for the target's unit of length), meaning, and identifier in the Plant Ontology or the
# Plant Trait Ontology, where there is one.
_DECLARED = {
    "length": ("unit", "arc of the midrib from base to tip", "TO:0000135"),
    "width": ("unit", "greatest width, along the surface", "TO:0000370"),
    "width_at": ("1", "where that is, from the base, in lengths", ""),
    "length_to_width": ("1", "length divided by width", ""),
    "area": ("unit²", "area of one face", ""),
    "perimeter": ("unit", "length of the whole margin", ""),
    "chord": ("unit", "straight distance from base to tip", ""),
    "chord_to_length": ("1", "chord divided by length: 1 for a straight midrib", ""),
    "bend": ("rad", "of the whole midrib, towards the upper side", ""),
    "cup": ("rad", "of the section at half length, from margin to margin", ""),
    "twist": ("rad", "of the surface about its midrib, from base to tip", ""),
}
TRAITS = frozenset(_DECLARED)


@dataclasses.dataclass(frozen=True)
class Trait:
    """A measured trait.

    Attributes:
        value: Its value.
        stderr: Its standard error; infinite if it is not known.
        unit: "unit" for the target's unit of length, "unit²", "rad" or "1"; "px" and "px²" for a mask
            without a camera.
        meaning: What is measured.
        term: Its identifier in the Plant Trait Ontology (of leaves); empty if there is none.
    """

    value: float
    stderr: float
    unit: str
    meaning: str
    term: str = ""


@dataclasses.dataclass(frozen=True, eq=False)
class Posterior:
    """What a fit knows of its free parameters, given the typical ranges as priors.

    Unlike the covariance of a result it is finite where the data do not determine a parameter, so that a
    quantity that they determine gets its error although its parameters do not.

    Attributes:
        names: Names of the free parameters, of the model and then of its pose.
        covariance: Their covariance, shape (q, q). A scale counts relative to the fitted one, shifts in
            units of `Posed`, turns in rad.
    """

    names: tuple[str, ...]
    covariance: Float64[np.ndarray, "q q"]


def traits_of(
    model: AbstractSurface,
    scale: float,
    posterior: Posterior | None,
    length: str = "unit",
    errors: Mapping[str, float] | None = None,
) -> dict[str, Trait]:
    """The traits of a sheet; none for a surface that is closed in a direction.

    Args:
        model: The model in its own frame.
        scale: The length of the model's unit in the target's.
        posterior: What is known of its parameters, for errors by the delta method; None if it is unknown.
        length: The name of the target's unit of length.
        errors: Standard errors by name, where no posterior is known.
    """
    if not all(model.edges):
        return {}
    names = () if posterior is None else posterior.names
    declared = parameters(model)
    own = [name for name in names if name in declared]
    sizing = [*own, *(name for name in names if name == "scale" and name not in declared)]
    steps = _STEP * np.array([np.ptp(declared[name].typical) for name in own]) / np.sqrt(12)
    # Lengths in metres are small beside their typical ranges.
    small = [
        _RELATIVE * float(value_at(model, name)) if declared[name].bounds[0] > 0 else np.inf
        for name in own
    ]
    steps = np.minimum(steps, small)
    # One sheet as fitted, and for each of its parameters one on either side.
    moved = np.array([value_at(model, name) for name in own], float) * np.ones(
        (1 + 2 * len(own), 1)
    )
    moved[1 : 1 + len(own)] += np.diag(steps)
    moved[1 + len(own) :] -= np.diag(steps)
    measured = _measured(model, own, moved, scale * np.ones(len(moved)))
    values = measured[:, 0]
    slopes = (measured[:, 1 : 1 + len(own)] - measured[:, 1 + len(own) :]) / (2 * steps)
    if len(own) < len(sizing):
        slopes = np.column_stack([slopes, values * _powers()])
    found = np.array([(errors or {}).get(name, np.inf) for name in _DECLARED])
    if posterior is not None:
        which = [names.index(name) for name in sizing]
        covariance = posterior.covariance[np.ix_(which, which)]
        found = np.sqrt(np.sum((slopes @ covariance) * slopes, axis=-1))
    return {
        name: Trait(float(value), float(error), unit.replace("unit", length), meaning, term)
        for (name, (unit, meaning, term)), value, error in zip(
            _DECLARED.items(), values, found, strict=True
        )
    }


def traits_of_many(
    model: AbstractSurface,
    names: Sequence[str],
    values: Float[np.ndarray, "k p"],
    scales: Float[np.ndarray, " k"],
) -> dict[str, Float[np.ndarray, " k"]]:
    """The values of the traits of many sheets; none for a surface that is closed in a direction.

    Args:
        model: A model with the values of all other parameters.
        names: Names of the parameters that differ between the sheets.
        values: Their values, a row for each sheet.
        scales: The length of each model's unit in the target's.
    """
    if not all(model.edges):
        return {}
    parts = [
        _measured(model, names, values[k : k + _AT_ONCE], scales[k : k + _AT_ONCE])
        for k in range(0, len(values), _AT_ONCE)
    ]
    return dict(zip(_DECLARED, np.concatenate(parts, axis=1), strict=True))


def errors_of(
    draws: AbstractSurface, scale: float, orientation: float, doubtful: float
) -> dict[str, float]:
    """Standard errors of the traits of a sheet, by name.

    Args:
        draws: Draws of the sheet from its posterior, a batch.
        scale: The length of their unit in the target's.
        orientation: The sign of the normal ∂S/∂u × ∂S/∂v on the upper side.
        doubtful: The part of the area that is in doubt besides, half of which is that of a length.
    """
    # Differences between sheets need fewer places than their traits.
    u, v = (np.ascontiguousarray(x[::2, ::2]) for x in nodes(draws.domain))
    with jax.enable_x64(True):
        grids = scale * np.asarray(_positions(draws, u, v), float)
    traits = _all(measures(grids, orientation))
    beside = 0.5 * doubtful * traits.mean(axis=1) * _powers()
    return dict(zip(_DECLARED, np.hypot(traits.std(axis=1), beside).tolist(), strict=True))


def _powers() -> Float[np.ndarray, " t"]:
    """The power of the unit of length in the unit of each trait."""
    units = [unit for unit, *_ in _DECLARED.values()]
    return np.array([unit.count("unit") * (2 if "²" in unit else 1) for unit in units], float)


def _measured(
    model: AbstractSurface,
    names: Sequence[str],
    values: Float[np.ndarray, "k p"],
    scales: Float[np.ndarray, " k"],
) -> Float[np.ndarray, "t k"]:
    """All traits of sheets that differ in some parameters."""
    batch = batch_of(model, names, values)
    u, v = nodes(model.domain)
    with jax.enable_x64(True):
        grids = scales[:, None, None, None] * np.asarray(_positions(batch, u, v), float)
    return _all(measures(grids, model.orientation))


def _all(found: Measures) -> Float[np.ndarray, "t k"]:
    """All declared traits, those that are ratios of others included."""
    derived = {
        "length_to_width": found.length / found.width,
        "chord_to_length": found.chord / found.length,
    }
    return np.stack([(found._asdict() | derived)[name] for name in _DECLARED])


def _batch(
    models: AbstractSurface, u: Float[Array, "m n"], v: Float[Array, "m n"]
) -> Float[Array, "k m n 3"]:
    # One after the other: all at once would not fit a processor's cache.
    return jax.lax.map(lambda model: model.position(u, v), models)


_positions = Program(_batch)
