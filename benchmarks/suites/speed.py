"""How long a warm fit takes, beside other tools on the same targets, and beside what nobody can avoid.

petalfit has no start; the others start 5 % off the truth in every parameter. All run in this process, one
after the other; compilation is not timed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import jax
import numpy as np

import petalfit as pf
from benchmarks.metric import Metric, Tell, timed
from benchmarks.peers import mitsuba_masks, sampled_surface, soft_raster
from benchmarks.peers.descent import fit_mask
from benchmarks.peers.found import Found
from benchmarks.targets import NAMES, SMOOTH, cloud_of, errors, mask_of, oblique, off, petal_of

_POINTS = 1500
_RIGHT = 3.0  # per cent, of a_x, b_y and the rib frequency
_LONGEST = 90.0  # seconds that a peer may take for one mask


def run(quick: bool, tell: Tell) -> Iterator[Metric]:
    yield from _clouds(1 if quick else 8, tell)
    yield from _masks(1 if quick else 4, tell)


def _clouds(petals: int, tell: Tell) -> Iterator[Metric]:
    peers: dict[str, Callable[[np.ndarray, pf.PeonyPetal], Found]] = {
        "scipy": sampled_surface.fit_scipy,
        "scipy_jacobian": sampled_surface.fit_scipy_jacobian,
    }
    missing = []
    try:
        lmfit = sampled_surface.lmfit_name()
        peers["lmfit"] = sampled_surface.fit_lmfit
    except ModuleNotFoundError:
        lmfit = "lmfit"
        missing.append(Metric("speed.cloud_over_lmfit", np.nan, "×", "more", note=_missing(lmfit)))
    own, bare = [], []
    ratios: dict[str, list[float]] = {name: [] for name in peers}
    right: dict[str, list[bool]] = {name: [] for name in ("petalfit", *peers)}
    for seed in range(petals):
        petal = petal_of(4000 + seed)
        points = cloud_of(petal, _POINTS, seed)
        tell(f"cloud {seed + 1} of {petals}: petalfit")
        taken, result = timed(lambda points=points: pf.fit_petal(points, throw=False), 5)
        own.append(taken)
        right["petalfit"].append(_is_right(result.values, petal))
        bare.append(_bare(petal, points))
        for name, fit in peers.items():
            tell(f"cloud {seed + 1} of {petals}: {name}")
            found = fit(points, off(petal, NAMES, seed))
            ratios[name].append(found.seconds / own[-1])
            right[name].append(_is_right(found.values, petal))
    yield Metric.median("speed.cloud_seconds", own, "s", "less", note=f"{_POINTS} points, no start")
    yield Metric.median(
        "speed.cloud_over_20_evaluations", [a / (20 * b) for a, b in zip(own, bare, strict=True)],
        "×", "less", tolerance=0.5,
        note="of foot points, normal distances and their Jacobian, at the truth",
    )  # fmt: skip
    named = {"scipy": "scipy.optimize.least_squares", "lmfit": lmfit}
    named["scipy_jacobian"] = "the same with normal distances and petalfit's Jacobian"
    for name, values in ratios.items():
        note = f"{named[name]}, from 5 % off; right in {sum(right[name])} of {petals}"
        yield Metric.median(
            f"speed.cloud_over_{name}", values, "×", "more", tolerance=0.5, note=note
        )
    yield Metric.rate("speed.cloud_right", right["petalfit"], 0.15)
    yield from missing


def _is_right(values: dict[str, float], petal: pf.PeonyPetal) -> bool:
    return max(errors(values, petal, ("a_x", "b_y", "rib_frequency")).values()) < _RIGHT


def _bare(petal: pf.PeonyPetal, points: np.ndarray) -> float:
    """Seconds of one evaluation that any solver needs: foot points, distances, Jacobian."""
    from petalfit.compilation import Program
    from petalfit.residuals import frame, nearest_nodes, newton, pull_back, refine_foot_points
    from petalfit.surfaces import in_doubles

    def evaluate(petal: pf.PeonyPetal, points: jax.Array, uv: jax.Array) -> tuple:
        uv, _, _ = newton(petal, points, uv, 2)
        here = frame(petal, uv)
        return here.distance(points), pull_back(petal, uv, -here.normal)

    with jax.enable_x64(True):
        model = in_doubles(petal)
        uv = refine_foot_points(model, points, nearest_nodes(model, points), 6)
        program = Program(evaluate)
        return timed(lambda: jax.block_until_ready(program(model, points, uv)), 20)[0]


def _masks(petals: int, tell: Tell) -> Iterator[Metric]:
    smooth = pf.PeonyPetal(rib_amplitude=0.0)
    own, search, accuracy = [], [], []
    cases = []
    for seed in range(petals):
        tell(f"mask {seed + 1} of {petals}: petalfit")
        made = petal_of(5000 + seed)
        petal = pf.PeonyPetal(
            rib_amplitude=0.0, **{name: float(getattr(made, name)) for name in SMOOTH}
        )
        mask = mask_of(petal, oblique(petal, seed))
        cases.append((petal, mask, off(petal, SMOOTH, seed)))
        taken, result = timed(
            lambda mask=mask: pf.fit_petal(mask, model=smooth, free=SMOOTH, throw=False), 3
        )
        own.append(taken)
        search.append(1 - result.timings["errors"] / sum(result.timings.values()))
        accuracy.append(max(errors(result.values, petal, ("a_x", "b_y")).values()))
    yield Metric.median("speed.mask_seconds", own, "s", "less", note="256 × 256 pixels, no start")
    yield Metric.median("speed.mask_error", accuracy, "%", "less", note="larger of a_x and b_y")
    for key, peer in (("mitsuba", mitsuba_masks), ("soft_raster", soft_raster)):
        problem = peer.available()
        if problem is not None:
            note = _missing(peer.NAME, problem)
            for ratio in ("mask", "mask_without_errors"):
                yield Metric(f"speed.{ratio}_over_{key}", np.nan, "×", "more", note=note)
            continue
        ratios, alone, ends, converged = [], [], [], 0
        for k, (petal, mask, start) in enumerate(cases):
            tell(f"mask {k + 1} of {petals}: {peer.NAME}")
            found = fit_mask(
                peer.gradient_of, mask.mask > 0.5, mask.camera, start, SMOOTH, _LONGEST
            )
            ratios.append(found.seconds / own[k])
            alone.append(found.seconds / (own[k] * search[k]))
            converged += found.converged
            ends.append(max(errors(found.values, petal, ("a_x", "b_y")).values()))
        note = (
            f"{peer.NAME}, from 5 % off; error {np.median(ends):.2g} %, "
            f"converged in {converged} of {petals}"
        )
        yield Metric.median(f"speed.mask_over_{key}", ratios, "×", "more", tolerance=0.5, note=note)
        yield Metric.median(
            f"speed.mask_without_errors_over_{key}", alone, "×", "more", tolerance=0.5,
            note="the same, without the pictures that petalfit measures its standard errors with",
        )  # fmt: skip


def _missing(name: str, why: str = "pip install 'petalfit[bench]'") -> str:
    return f"missing: {name}; {why}"
