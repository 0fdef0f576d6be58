"""The fit of a colour pattern to a texture: a search among candidates, and a descent from the best."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple, cast

import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, Float64

from petalfit.colours import AbstractPattern, to_linear, to_srgb
from petalfit.compilation import Program, bucket, pad_to, stage
from petalfit.components import Parameter, parameters
from petalfit.fitting.coordinates import Coordinates
from petalfit.fitting.inference.identifiability import covariance, known, typical_spread
from petalfit.fitting.inference.verdict import at_bounds, not_determined
from petalfit.fitting.solver.iterate import Iterate
from petalfit.fitting.solver.observer import report
from petalfit.observations import TargetError, Texture
from petalfit.results import (
    APART,
    CLEAR_LEAD,
    Estimate,
    FitWarning,
    Start,
    Status,
    WarningKind,
    in_order,
    rivals,
    standard_errors,
)
from petalfit.surfaces import value_at

_SOME = 4096  # places that candidates are scored on
_CANDIDATES = 8192
_FOLLOWED = 12  # candidates that are followed
# Candidates closer than this count as one, in standard deviations of the typical ranges.
_APART = 0.3
# Patterns that differ by less than this part of the noise everywhere count as one.
_SAME = 0.05
_EQUAL = 0.01  # difference in χ² below which patterns are equally good
_STEPS = 100
# If more than this part of the colours' variance is off a line, they are no mixtures of two colours.
_OFF_THE_LINE = 0.1
# Residuals beyond this part of the pattern's contrast hide the pattern, or are a misfit and no noise.
_MISFIT = 0.5
_SETTLED = 0.5  # standard errors


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class ColourFit(Estimate):
    """The outcome of a fit of a pattern to a texture, or to the colours of a cloud.

    Attributes:
        model: The fitted pattern.
        texture: The texture that it was fitted to.
        palette: sRGB of the two colours that the pattern mixes, the ground first; None for intensities.
        residuals: Intensity of every place minus that of the pattern, shape (n,).
        noise: Standard deviation of the residuals, given or estimated.
    """

    model: AbstractPattern
    texture: Texture
    palette: Float64[np.ndarray, "2 3"] | None
    residuals: Float64[np.ndarray, " n"]
    noise: float


class _Data(NamedTuple):
    """A texture as the compiled functions take it, padded with zero weights."""

    uv: Float[Array | np.ndarray, "n 2"]
    intensity: Float[Array | np.ndarray, " n"]
    weight: Float[Array | np.ndarray, " n"]

    @classmethod
    def of(cls, uv: np.ndarray, intensity: np.ndarray, weight: np.ndarray) -> _Data:
        size = bucket(len(uv))
        padding = np.zeros(size - len(uv))
        return cls(pad_to(uv, size), pad_to(intensity, size), np.concatenate([weight, padding]))


def fit_colours(
    template: AbstractPattern,
    free: tuple[str, ...],
    texture: Texture,
    *,
    palette: Float[np.ndarray, "2 3"] | None,
    noise: float | None,
    from_template: bool,
    seed: int,
) -> ColourFit:
    """Recover a pattern from a texture.

    Args:
        template: A pattern. Parameters that are not free keep its values.
        free: Names of the parameters to fit.
        texture: Intensities, or colours, which become intensities on the line between two of them.
        palette: sRGB of these two colours, the ground first; by default the ends of the range of the
            texture's own colours.
        noise: Standard deviation of the intensities; estimated if None.
        from_template: Whether to start at the template instead of searching for a start.
        seed: The seed of the choice of places that candidates are scored on.

    Raises:
        TargetError: The texture is of one colour.
    """
    with jax.enable_x64(True):
        seen = _intensities(texture, palette)
        used = texture.weights > 0
        uv, values, weights = texture.uv[used], seen.intensity[used], texture.weights[used]
        if len(values) < len(free) + 1:
            raise TargetError(
                f"{len(values)} places cannot determine {len(free)} free parameters; give more places."
            )
        if np.ptp(values) == 0:
            raise TargetError("the texture is of one colour, which shows no pattern.")
        coordinates = Coordinates.of(template, free)
        some = np.random.default_rng(seed).permutation(len(uv))[:_SOME]
        part = _Data.of(uv[some], values[some], weights[some])
        if from_template:
            starts = [coordinates.inverse(template)]
        else:
            report("searching the pattern")
            starts = _candidates(coordinates, part)
        data = _Data.of(uv, values, weights)
        report("polishing")
        with stage("polishing"):
            ends = [_polish(coordinates, part, t) for t in starts]
            ends = _different(coordinates, ends, data, noise)
            ends = [_polish(coordinates, data, end.t) for end in ends]
            ends = _different(coordinates, ends, data, noise)
        return _result(coordinates, ends, texture, seen, noise)


class _Seen(NamedTuple):
    """A texture as intensities.

    Attributes:
        intensity: The intensities, shape (n,).
        palette: sRGB of the colours at intensity 0 and 1; None if the texture has no colours.
        off: The part of the colours' variance that is not on the line between these, in [0, 1].
    """

    intensity: Float[np.ndarray, " n"]
    palette: Float64[np.ndarray, "2 3"] | None
    off: float


def _intensities(texture: Texture, palette: np.ndarray | None) -> _Seen:
    """The texture as intensities between the two colours of a palette, or between two of its own."""
    if texture.values.ndim == 1:
        return _Seen(np.asarray(texture.values), None, 0.0)
    linear = np.asarray(to_linear(texture.values))
    weights = texture.weights[:, None]
    spread = linear - np.average(linear, axis=0, weights=texture.weights)
    if palette is None:
        axis = np.linalg.eigh((weights * spread).T @ spread).eigenvectors[:, -1]
        axis = -axis if axis.sum() > 0 else axis  # from light to dark
        low, high = np.quantile((spread @ axis)[texture.weights > 0], [0.005, 0.995])
        ends = np.clip((linear - spread)[0] + np.outer([low, high], axis), 0, 1)
    else:
        ends = np.asarray(to_linear(palette))
    line = ends[1] - ends[0]
    if not line @ line > 0:
        raise TargetError("the palette's two colours, or all of the texture's, are the same.")
    intensity = (linear - ends[0]) @ line / (line @ line)
    rest = linear - ends[0] - np.outer(intensity, line)
    off = float(np.sum(weights * rest**2) / np.sum(weights * spread**2))
    return _Seen(intensity, np.asarray(to_srgb(ends)), off)


def _candidates(coordinates: Coordinates, data: _Data) -> list[Float[np.ndarray, " p"]]:
    """The best of many candidates over the typical ranges, with I₁ and I₂ by linear regression."""
    free, places = coordinates.free, coordinates.spread(_CANDIDATES)
    cost, ground, contrast = (np.asarray(x) for x in _score(coordinates, data, places))
    values = np.array(coordinates.values(places))
    spread = typical_spread(free, parameters(coordinates.template))
    chosen: list[int] = []
    for k in np.argsort(cost):
        gaps = np.abs(values[k] - values[chosen]) / spread
        if np.all(np.max(gaps, axis=1) > _APART):
            chosen.append(int(k))
        if len(chosen) == _FOLLOWED:
            break
    values = values[chosen]
    for name, fitted in ("i_1", ground), ("i_2", contrast):
        if name in free:
            values[:, free.index(name)] = fitted[chosen]
    return [*coordinates.place(values)]


def _scores(
    coordinates: Coordinates, data: _Data, places: Float[Array, "m p"]
) -> tuple[Array, Array, Array]:
    """The remaining sum of squares of every candidate, and the I₁ and I₂ that fit its figure best."""
    total = jnp.sum(data.weight)
    mean = jnp.sum(data.weight * data.intensity) / total
    y = data.intensity - mean

    def score(t: Array) -> tuple[Array, Array, Array]:
        figure = coordinates.model(t).figure(data.uv[:, 0], data.uv[:, 1])
        level = jnp.sum(data.weight * figure) / total
        g = figure - level
        power = jnp.sum(data.weight * g**2)
        contrast = jnp.sum(data.weight * g * y) / jnp.where(power > 0, power, 1.0)
        return jnp.sum(data.weight * (y - contrast * g) ** 2), mean - contrast * level, contrast

    return jax.lax.map(score, places, batch_size=8)


_score = Program(_scores)


def _polish(coordinates: Coordinates, data: _Data, t: Float[np.ndarray, " p"]) -> Iterate:
    """The end of a start, with χ² and information for a noise of 1."""
    t, squares, information, moved, steps = map(np.asarray, _descend(coordinates, data, t))
    return Iterate(
        coordinates.model(t),
        (),
        int(steps),
        float(moved),
        t,
        float(squares),
        information=information,
        score_covariance=information,
    )


def _descent(coordinates: Coordinates, data: _Data, t: Array) -> tuple[Array, ...]:
    """The minimum of the sum of squares from a start, and the Gauss-Newton step that remains there."""
    root = jnp.sqrt(data.weight)

    def residual(t: Array, data: _Data) -> Array:
        return root * (coordinates.model(t)(data.uv[:, 0], data.uv[:, 1]) - data.intensity)

    # Residuals are scaled to order one, to suit the damping that Levenberg-Marquardt begins with.
    scale = 10.0 / jnp.sqrt(jnp.sum(residual(t, data) ** 2) + 1e-300)
    solution = optx.least_squares(
        lambda t, data: scale * residual(t, data),
        optx.LevenbergMarquardt(rtol=1e-9, atol=1e-9, linear_solver=lx.Normal(lx.Cholesky())),
        t,
        data,
        max_steps=_STEPS,
        throw=False,
    )
    t = jnp.where(jnp.isfinite(solution.value).all(), solution.value, t)
    slopes = jax.jacfwd(residual)(t, data)
    left = residual(t, data)
    information = slopes.T @ slopes
    step = jnp.linalg.solve(information + 1e-9 * jnp.eye(len(t)), slopes.T @ left)
    # A noise-free texture leaves rounding errors only, so that a least variance is added.
    variance = jnp.sum(left**2 + 1e-16 * data.weight) / jnp.sum(data.weight)
    moved = jnp.sqrt(step @ information @ step / (variance * len(t)) + 0.0)
    return t, jnp.sum(left**2), information, moved, solution.stats["num_steps"]


_descend = Program(_descent)


def _different(
    coordinates: Coordinates, ends: Sequence[Iterate], data: _Data, noise: float | None
) -> list[Iterate]:
    """Ends that are different patterns, the best first.

    Of ends that describe the same pattern by other numbers, such as φ + π for an even n, the one with the
    most typical numbers is kept.
    """
    ends = sorted(ends, key=lambda end: end.chi2)
    total = float(np.sum(data.weight))
    sigma = noise or float(np.sqrt(ends[0].chi2 / total))
    groups: list[tuple[np.ndarray, list[Iterate]]] = []
    for end in ends:
        seen = np.asarray(_look(coordinates, data, end.t))
        for other, members in groups:
            apart = np.abs(seen - other)[np.asarray(data.weight) > 0].max()
            if apart < _SAME * max(sigma, 1e-6):
                members.append(end)
                break
        else:
            groups.append((seen, [end]))

    def as_good(members: list[Iterate]) -> list[Iterate]:
        return [end for end in members if end.chi2 - members[0].chi2 < _EQUAL * sigma**2]

    declared = parameters(coordinates.template)
    middle = np.array([np.mean(declared[name].typical) for name in coordinates.free])
    spread = typical_spread(coordinates.free, declared)

    def unusual(end: Iterate) -> float:
        return float(np.sum(((coordinates.values(cast(np.ndarray, end.t)) - middle) / spread) ** 2))

    return [min(as_good(members), key=unusual) for _, members in groups]


def _picture(coordinates: Coordinates, data: _Data, t: Array) -> Array:
    return coordinates.model(t)(data.uv[:, 0], data.uv[:, 1])


_look = Program(_picture)


def _result(
    coordinates: Coordinates,
    ends: Sequence[Iterate],
    texture: Texture,
    seen: _Seen,
    noise: float | None,
) -> ColourFit:
    best, names, weights = ends[0], coordinates.free, texture.weights
    declared = parameters(coordinates.template)
    sigma = noise or float(np.sqrt(best.chi2 / max(np.sum(weights) - len(names), 1.0)))
    sigma = max(sigma, 1e-12)
    scaled = [_in_units_of(sigma, coordinates, end) for end in ends]
    model = jax.tree.map(float, scaled[0].model)
    values = {name: float(value_at(model, name)) for name in declared}
    shown = np.asarray(_look(coordinates, _Data(texture.uv, seen.intensity, weights), best.t))
    starts = tuple(_start(end, scaled[0].chi2, names, sigma) for end in scaled)
    matrix, stderr, close = _uncertainty(scaled, starts, declared)
    mean = np.average(seen.intensity, weights=weights)
    gain = (np.sum(weights * (seen.intensity - mean) ** 2) - best.chi2) / sigma**2
    nothing = bool(gain < CLEAR_LEAD + 2 * len(names))
    if nothing:
        # If the figure explains no more than chance would, there is none, and neither are its parameters.
        rest = [k for k, name in enumerate(names) if name != "i_1"]
        matrix[rest, :] = matrix[:, rest] = np.inf
        stderr = {name: error if name == "i_1" else np.inf for name, error in stderr.items()}
    identifiable = {name: bool(np.isfinite(error)) for name, error in stderr.items()}
    contrast = float(np.ptp(shown[weights > 0]))
    warnings = [
        *at_bounds(values, names, declared),
        *not_determined(identifiable, "texture"),
    ]
    if close:
        text = f"almost as good: {'; '.join(start.label for start in close)}"
        warnings.append(FitWarning(text, WarningKind.RIVALS))
    if nothing:
        text = "the texture shows no pattern of this kind"
        warnings.append(FitWarning(text, WarningKind.NO_PATTERN))
    elif sigma > _MISFIT * contrast:
        text = (
            f"what the pattern leaves ({sigma:.2g}) is large beside its contrast ({contrast:.2g})"
        )
        warnings.append(FitWarning(text, WarningKind.CONTRAST))
    if seen.off > _OFF_THE_LINE:
        text = (
            f"{100 * seen.off:.0f} % of the colours' variance lies off the line between two colours: "
            "there are more"
        )
        warnings.append(FitWarning(text, WarningKind.COLOURS))
    status, reason = Status.CONVERGED, f"converged after {best.rounds} steps"
    if not np.isfinite(best.chi2):
        status, reason = Status.NOT_FINITE, "the solver met values that are not finite"
    elif best.moved > _SETTLED and not nothing:
        status = Status.ROUND_LIMIT
        reason = f"not converged: parameters still move by {best.moved:.2g} standard errors"
    return ColourFit(
        model=model,
        values=values,
        stderr=stderr,
        identifiable=identifiable,
        names=names,
        covariance=matrix,
        status=status,
        reason=reason,
        warnings=in_order(warnings),
        steps=best.rounds,
        starts=starts,
        texture=texture,
        palette=seen.palette,
        residuals=seen.intensity - shown,
        noise=sigma,
    )


def _uncertainty(
    scaled: list[Iterate], starts: tuple[Start, ...], declared: dict[str, Parameter]
) -> tuple[Float[np.ndarray, "p p"], dict[str, float], tuple[Start, ...]]:
    """Covariance and errors, infinite for parameters in which rivals differ, and these rivals."""
    names = tuple(starts[0].values)
    found = known(scaled, names, declared)
    matrix = covariance(scaled[0], names, declared, found)
    stderr = standard_errors(names, matrix)
    close = rivals(starts, stderr, declared)
    for k, name in enumerate(names):
        apart = [abs(start.values[name] - starts[0].values[name]) for start in close]
        if any(gap > APART * stderr[name] for gap in apart):
            matrix[k, :] = matrix[:, k] = np.inf
            stderr[name] = float("inf")
    return matrix, stderr, close


def _in_units_of(sigma: float, coordinates: Coordinates, end: Iterate) -> Iterate:
    """An end with its χ², and the information of its parameters, for noise of a given σ."""
    slopes = coordinates.slopes(cast(np.ndarray, end.t))
    information = end.information / sigma**2 / np.outer(slopes, slopes)
    chi2 = end.chi2 / sigma**2
    return dataclasses.replace(
        end, information=information, score_covariance=information, chi2=chi2
    )


def _start(end: Iterate, best: float, names: tuple[str, ...], sigma: float) -> Start:
    values = {name: float(value_at(end.model, name)) for name in names}
    label = ", ".join(f"{name} {value:.3g}" for name, value in values.items())
    return Start(label, values, sigma * math.sqrt(end.chi2 / max(best, 1e-300)), end.chi2 - best)
