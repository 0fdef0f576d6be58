"""Which parameters the observations determine, judged by information against the typical ranges."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float

from petalfit.components import Parameter, parameters
from petalfit.fitting.coordinates import Coordinates, with_values
from petalfit.fitting.estimate import CLEAR_LEAD
from petalfit.fitting.peony_start import RIBS
from petalfit.fitting.rounds import Polished, Settled
from petalfit.fitting.solve import Prior
from petalfit.surfaces import AbstractSurface, value_at

# A parameter is determined if its standard error is below this many standard deviations of its
# typical range, taken as uniform.
DETERMINED = 0.3
_ALONE = DETERMINED / 2  # the same, if the others were known


def sizes(model: AbstractSurface) -> list[str]:
    """Parameters that grow with the model: lengths that are positive."""
    return [n for n, p in parameters(model).items() if p.unit == "length" and p.bounds[0] > 0]


def typical_spread(
    names: Sequence[str], declared: Mapping[str, Parameter]
) -> Float[np.ndarray, " p"]:
    """Standard deviations of the typical ranges, taken as uniform."""
    return np.array([np.ptp(declared[name].typical) for name in names]) / np.sqrt(12)


def known_alone(
    end: Settled, names: Sequence[str], declared: Mapping[str, Parameter]
) -> Bool[np.ndarray, " p"]:
    """Whether each parameter is determined, by the information where the fit ended."""
    spread = typical_spread(names, declared)
    scales = np.outer(spread, spread)
    # With the typical ranges as priors nothing is singular; a standard error of q becomes q/√(1 + q²).
    identity = np.eye(len(names))
    inverse = np.linalg.inv(end.information * scales + identity)
    posterior = np.sqrt(np.diag(inverse @ (end.spread * scales + identity) @ inverse))
    return posterior < DETERMINED / np.sqrt(1 + DETERMINED**2)


def _known_if_others_were(
    end: Settled, names: Sequence[str], declared: Mapping[str, Parameter]
) -> Bool[np.ndarray, " p"]:
    """Whether each parameter would clearly be determined if all others were known."""
    spread = typical_spread(names, declared)
    return np.diag(end.information) * spread**2 > _ALONE**-2


def known(
    ends: Sequence[Settled], names: Sequence[str], declared: Mapping[str, Parameter]
) -> Bool[np.ndarray, " p"]:
    """Whether each parameter is determined, rival rib frequencies considered."""
    found = known_alone(ends[0], names, declared)
    for name in [*_doubtful_ribs(names, found, ends), *_doubtful_sizes(names, ends)]:
        found[names.index(name)] = False
    return found


def covariance(
    ends: Sequence[Settled], names: Sequence[str], declared: Mapping[str, Parameter]
) -> tuple[Float[np.ndarray, "p p"], Bool[np.ndarray, " p"]]:
    """The covariance of the parameters, and which of them are determined.

    What is not determined gets infinite rows and columns; for the errors of the others it is left
    free within its typical range.
    """
    found = known(ends, names, declared)
    spread = typical_spread(names, declared)
    scales = np.outer(spread, spread)
    prior = np.diag(np.where(found, 0.0, 1.0))
    inverse = np.linalg.inv(ends[0].information * scales + prior)
    matrix = inverse @ (ends[0].spread * scales + prior) @ inverse
    return np.where(np.outer(found, found), matrix * scales, np.inf), found


def _nearly_as_good(ends: Sequence[Settled]) -> list[Settled]:
    """Other ends that explain the observations almost as well as the first."""
    return [end for end in ends[1:] if end.chi2 - ends[0].chi2 < CLEAR_LEAD]


def _doubtful_ribs(names: Sequence[str], found: np.ndarray, ends: Sequence[Settled]) -> list[str]:
    """Rib parameters that the local information is too sure of.

    Ribs that are not there have no frequency, whatever the curvature of the cost says; and where
    another frequency fits almost as well, neither is known, nor how high the ribs are.
    """
    ribs = [name for name in RIBS if name in names]
    if "rib_frequency" not in ribs:
        return []
    best = float(ends[0].model.rib_frequency)
    if any(abs(float(end.model.rib_frequency) - best) > 0.5 for end in _nearly_as_good(ends)):
        return ribs
    return ["rib_frequency"] if not found[names.index(ribs[-1])] else []


def _doubtful_sizes(names: Sequence[str], ends: Sequence[Settled]) -> list[str]:
    """The scale and the lengths that go with it, if another scale explains the view almost as well."""
    if "scale" not in names:
        return []
    best = float(ends[0].model.scale)
    if any(abs(float(end.model.scale) / best - 1) > 0.03 for end in _nearly_as_good(ends)):
        return [name for name in ("scale", *sizes(ends[0].model)) if name in names]
    return []


def combinations(
    end: Settled,
    names: Sequence[str],
    declared: Mapping[str, Parameter],
    found: Bool[np.ndarray, " p"],
) -> list[str]:
    """Sentences on parameters that only a combination is known of, from the information matrix."""
    spread = typical_spread(names, declared)
    information = end.information * np.outer(spread, spread)
    alone = _known_if_others_were(end, names, declared)
    eigenvalues, vectors = np.linalg.eigh(information)
    sentences = []
    if "scale" in names and not found[names.index("scale")]:
        seen = [n for n, yes in zip(names, ~found & alone, strict=True) if yes]
        lengths = [n for n in sizes(end.model) if n in seen]
        sentences += [f"{name} and scale are determined only as a product" for name in lengths]
    for direction in vectors[:, eigenvalues < DETERMINED**-2].T:
        members = np.flatnonzero(~found & alone & (np.abs(direction) > 0.1)).tolist()
        if len(members) < 2:
            continue
        values = np.array([float(value_at(end.model, names[k])) for k in members])
        relative = direction[members] * spread[members] / np.where(values == 0, np.inf, values)
        words = [names[k] for k in members]
        if "scale" in words:
            scale = words.index("scale")
            for k, word in enumerate(words):
                if k != scale:
                    sentences.append(_pair(word, "scale", relative[k], relative[scale]))
        elif len(words) == 2:
            sentences.append(_pair(words[0], words[1], relative[0], relative[1]))
        else:
            sentences.append(
                f"{', '.join(words[:-1])} and {words[-1]} are determined only in combination"
            )
    return list(dict.fromkeys(sentences))


def _pair(one: str, other: str, a: float, b: float) -> str:
    """What is known of two parameters whose relative changes a and b go together unseen."""
    kind = "in combination"
    if abs(a + b) < 0.2 * max(abs(a), abs(b)):
        kind = "as a product"
    elif abs(a - b) < 0.2 * max(abs(a), abs(b)):
        kind = "as a ratio"
    return f"{one} and {other} are determined only {kind}"


def stay_at_the_start(
    coordinates: Coordinates,
    end: Settled,
    again: Callable[[AbstractSurface, Polished | None, Prior], Settled],
) -> Settled:
    """An end in which what is not determined has the template's values, unless the data object.

    Args:
        coordinates: The free parameters.
        end: The best end.
        again: Follows a start with a prior.
    """
    free, template = coordinates.free, coordinates.template
    if not np.isfinite(end.information).all():
        return end
    found = known_alone(end, free, parameters(template))
    unknown = {name for name, yes in zip(free, found, strict=True) if not yes}
    start = {name: value_at(template, name) for name in free if name in unknown}
    if rest := {name: value for name, value in start.items() if name not in RIBS}:
        centre = coordinates.inverse(with_values(end.model, rest))
        prior = Prior(centre, np.isin(free, [*rest]).astype(float))
        # What is known in combination with others must not leave where they explain the data.
        alone = dict(zip(free, _known_if_others_were(end, free, parameters(template)), strict=True))
        model = with_values(end.model, {n: v for n, v in rest.items() if not alone[n]})
        end = dataclasses.replace(again(model, None, prior), chi2=end.chi2)
    # Ribs that do not show need not be in the fit to have values in the result.
    ribs = {name: value for name, value in start.items() if name in RIBS}
    return dataclasses.replace(end, model=with_values(end.model, ribs)) if ribs else end
