"""Identifiability: which parameters the data determine, by information relative to typical ranges."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import stdtrit

from petalfit.components import Parameter, Posed, parameters
from petalfit.fitting.solver.descent import ALWAYS
from petalfit.fitting.solver.iterate import Iterate
from petalfit.results import CLEAR_LEAD, FitWarning, Posterior, WarningKind, quantile
from petalfit.surfaces import AbstractSurface, value_at

# A parameter is determined if its standard error is below this many standard deviations of its
# typical range, taken as uniform.
DETERMINED = 0.3
_ALONE = DETERMINED / 2  # the same limit, if all other parameters were known
_MANY = 10  # points for each parameter, from which on it hardly matters how the noise is estimated


def sizes(model: AbstractSurface) -> list[str]:
    """Names of the parameters that scale with the model: lengths that are always positive."""
    return [n for n, p in parameters(model).items() if p.unit == "length" and p.bounds[0] > 0]


def typical_spread(
    names: Sequence[str], declared: Mapping[str, Parameter]
) -> Float[np.ndarray, " p"]:
    """Standard deviations of the typical ranges, taken as uniform."""
    return np.array([np.ptp(declared[name].typical) for name in names]) / np.sqrt(12)


def few_points(end: Iterate, free: int) -> float:
    """The factor by which variances are larger if the noise of one cloud is estimated from few points.

    The noise is then as uncertain as Student's distribution says, whose 95 % interval is that much wider
    than Gauss's.

    Args:
        end: The end of a fit of one cloud.
        free: The number of free parameters.
    """
    (seen,) = end.residuals
    count = float(np.sum(seen.weights))
    freedom = max(count - free, 1.0)
    left = float(np.sum(seen.weights * seen.distance**2)) / freedom
    wider = max(left / max(seen.noise, 1e-300) ** 2, 1.0) if count < _MANY * free else 1.0
    return wider * (float(stdtrit(freedom, 0.975)) / quantile(0.95)) ** 2


def known_alone(
    end: Iterate, names: Sequence[str], declared: Mapping[str, Parameter]
) -> Bool[np.ndarray, " p"]:
    """Whether each parameter is determined, judged by the information at one end alone."""
    spread = typical_spread(names, declared)
    scales = np.outer(spread, spread)
    # With the typical ranges as priors nothing is singular; a standard error of q becomes q/√(1 + q²).
    identity = np.eye(len(names))
    variance = np.diag(_sandwich(end, scales, identity))
    return (variance > 0) & (variance < DETERMINED**2 / (1 + DETERMINED**2))


def known_if_others_were(
    end: Iterate, names: Sequence[str], declared: Mapping[str, Parameter]
) -> Bool[np.ndarray, " p"]:
    """Whether each parameter would clearly be determined if all others were known."""
    spread = typical_spread(names, declared)
    return np.diag(end.information) * spread**2 > _ALONE**-2


def known(
    ends: Sequence[Iterate],
    names: Sequence[str],
    declared: Mapping[str, Parameter],
    hidden: Sequence[str] = (),
) -> Bool[np.ndarray, " p"]:
    """Whether each parameter is determined, also in view of rival ends.

    Args:
        ends: The ends, the best first.
        names: Names of the free parameters.
        declared: Their declarations.
        hidden: Names of parameters that the targets cannot show. If there are any, others that differ
            between rival ends are not determined either.
    """
    found = known_alone(ends[0], names, declared)
    if hidden:
        spread = typical_spread(names, declared)
        likely = [ends[0], *_nearly_as_good(ends)]
        values = np.array([[float(value_at(end.model, n)) for n in names] for end in likely])
        found &= np.ptp(values, axis=0) < DETERMINED * spread
        found &= ~np.isin(names, hidden)
    for name in [*_doubtful_waves(names, found, ends), *_doubtful_sizes(names, ends)]:
        found[names.index(name)] = False
    return found


def covariance(
    end: Iterate,
    names: Sequence[str],
    declared: Mapping[str, Parameter],
    found: Bool[np.ndarray, " p"],
    discrepancy: Float[np.ndarray, "p p"] | None = None,
) -> Float[np.ndarray, "p p"]:
    """The covariance of the parameters.

    Parameters that are not determined have infinite rows and columns. The errors of the others allow for
    them to be anywhere in their typical ranges. Those that are determined only together with others are
    held by the weak prior that fits of sheets have.

    Args:
        end: The end.
        names: Names of the free parameters.
        declared: Their declarations.
        found: Whether each of them is determined.
        discrepancy: What a discrepancy adds to the covariance of the derivative of the cost, if any.
    """
    spread = typical_spread(names, declared)
    scales = np.outer(spread, spread)
    prior = np.diag(np.where(found, ALWAYS**2, 1.0))
    matrix = _sandwich(end, scales, prior, discrepancy)
    return np.where(np.outer(found, found), matrix * scales, np.inf)


def _sandwich(
    end: Iterate,
    scales: Float[np.ndarray, "p p"],
    prior: Float[np.ndarray, "p p"],
    discrepancy: Float[np.ndarray, "p p"] | None = None,
) -> Float[np.ndarray, "p p"]:
    """The covariance under a Gaussian prior, in units of the spreads whose products are `scales`."""
    matrix = end.information * scales + prior
    # Information may span so many orders of magnitude that only a scaled matrix can be inverted.
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    inverse = np.linalg.inv(matrix * np.outer(scale, scale)) * np.outer(scale, scale)
    by_noise = inverse @ (end.score_covariance * scales + prior) @ inverse
    if discrepancy is None:
        return by_noise
    # A misfit could move weakly determined parameters beyond all that is usual: here the typical ranges
    # hold them. They hardly change errors that are small compared with these ranges.
    by_misfit = inverse @ (discrepancy * scales) @ inverse
    held = by_misfit @ np.linalg.solve(by_misfit + np.eye(len(by_misfit)), by_misfit)
    return by_noise + by_misfit - 0.5 * (held + held.T)


def posterior_of(
    end: Iterate,
    names: Sequence[str],
    declared: Mapping[str, Parameter],
    discrepancy: Float[np.ndarray, "p p"] | None = None,
) -> Posterior:
    """What is known of the parameters of the model and of its pose, with typical ranges as priors."""
    spread = typical_spread(names, declared)
    scales = np.outer(spread, spread)
    matrix = _sandwich(end, scales, np.eye(len(names)), discrepancy) * scales
    factors = np.ones(len(names))
    if _has_unknown_scale(end, names):
        # Its error is that of the factor by which it differs from the fitted scale.
        factors[list(names).index("scale")] = 1 / float(end.model.scale)
    return Posterior(tuple(names), matrix * np.outer(factors, factors))


def _nearly_as_good(ends: Sequence[Iterate]) -> list[Iterate]:
    """Other ends that explain the observations almost as well as the first."""
    return [end for end in ends[1:] if end.chi2 - ends[0].chi2 < CLEAR_LEAD]


def _doubtful_waves(names: Sequence[str], found: np.ndarray, ends: Sequence[Iterate]) -> list[str]:
    """Parameters of an oscillation that are less certain than the local information suggests.

    Waves of no height have no frequency, whatever the curvature of the cost is. And if another frequency
    fits almost as well, neither frequency is certain, nor is the height of the waves.
    """
    waves = getattr(ends[0].model, "oscillation", None)  # a pattern of colours has none
    if waves is None or waves.frequency not in names:
        return []
    own = [name for name in waves.names if name in names]

    def frequency(end: Iterate) -> float:
        return float(value_at(end.model, waves.frequency))

    if any(abs(frequency(end) - frequency(ends[0])) > 0.5 for end in _nearly_as_good(ends)):
        return own
    return [waves.frequency] if not found[names.index(own[-1])] else []


def _has_unknown_scale(end: Iterate, names: Sequence[str]) -> bool:
    """Whether the scale of a pose is free; a component may have a parameter of the same name."""
    posed = isinstance(end.model, Posed)
    return posed and "scale" in names and "scale" not in parameters(end.model.surface)


def _doubtful_sizes(names: Sequence[str], ends: Sequence[Iterate]) -> list[str]:
    """The scale and all sizes, if an end with another scale explains the data almost as well."""
    if not _has_unknown_scale(ends[0], names):
        return []
    best = float(ends[0].model.scale)
    if any(abs(float(end.model.scale) / best - 1) > 0.03 for end in _nearly_as_good(ends)):
        return [name for name in ("scale", *sizes(ends[0].model)) if name in names]
    return []


def combinations(
    end: Iterate,
    names: Sequence[str],
    declared: Mapping[str, Parameter],
    found: Bool[np.ndarray, " p"],
) -> list[FitWarning]:
    """Warnings about parameters of which only a combination is determined by the information."""
    spread = typical_spread(names, declared)
    information = end.information * np.outer(spread, spread)
    alone = known_if_others_were(end, names, declared)
    eigenvalues, vectors = np.linalg.eigh(information)
    warnings: list[FitWarning] = []
    scaled = _has_unknown_scale(end, names)
    if scaled and not found[names.index("scale")]:
        seen = [n for n, yes in zip(names, ~found & alone, strict=True) if yes]
        lengths = [n for n in sizes(end.model) if n in seen]
        warnings += [_combined([name, "scale"], "as a product") for name in lengths]
    for direction in vectors[:, eigenvalues < DETERMINED**-2].T:
        members = np.flatnonzero(~found & alone & (np.abs(direction) > 0.1)).tolist()
        if len(members) < 2:
            continue
        values = np.array([float(value_at(end.model, names[k])) for k in members])
        relative = direction[members] * spread[members] / np.where(values == 0, np.inf, values)
        words = [names[k] for k in members]
        if scaled and "scale" in words:
            scale = words.index("scale")
            for k, word in enumerate(words):
                if k != scale:
                    kind = _kind_of_pair(relative[k], relative[scale])
                    warnings.append(_combined([word, "scale"], kind))
        else:
            kind = _kind_of_pair(*relative) if len(words) == 2 else "in combination"
            warnings.append(_combined(words, kind))
    return [*dict.fromkeys(warnings)]


def _combined(words: Sequence[str], kind: str) -> FitWarning:
    text = f"{', '.join(words[:-1])} and {words[-1]} are determined only {kind}"
    return FitWarning(text, WarningKind.COMBINATION, words)


def _kind_of_pair(a: float, b: float) -> str:
    """The combination of two parameters that is known, if joint relative changes a and b do not show."""
    if abs(a + b) < 0.2 * max(abs(a), abs(b)):
        return "as a product"
    if abs(a - b) < 0.2 * max(abs(a), abs(b)):
        return "as a ratio"
    return "in combination"
