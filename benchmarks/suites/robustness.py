"""What spoils a cloud of 2,000 points: clutter, noise, a hole, an unknown pose; no start given."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

import petalfit as pf
from benchmarks.metric import Curve, Metric, Tell
from benchmarks.targets import SIGMA, among_strays, buried, errors, petal_of

_POINTS = 2000


def run(quick: bool, tell: Tell) -> Iterator[Metric | Curve]:
    petals = 2 if quick else 10
    clutter = (0.0, 0.3) if quick else (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
    rates = []
    for share in clutter:
        trials = []
        for seed in range(petals):
            tell(f"{share:.0%} clutter, petal {seed + 1} of {petals}")
            trials.append(_found(seed, clutter=share, pose="rigid", loss="robust"))
        rates.append(float(np.mean(trials)))
        yield Metric.rate(f"robustness.clutter_{100 * share:.0f}", trials, 0.51 if quick else 0.11)
    if not quick:
        yield Curve(
            "robustness.clutter", [100 * x for x in clutter], rates, "clutter / %", "found",
            group="clutter",
        )  # fmt: skip
    shares = (0.6,) if quick else (0.4, 0.6, 0.8)
    for share in shares:
        trials = []
        for seed in range(petals):
            tell(f"buried under {share:.0%}, petal {seed + 1} of {petals}")
            trials.append(_unburied(seed, share))
        yield Metric.rate(f"robustness.buried_{100 * share:.0f}", trials, 0.51 if quick else 0.11)
    noises = (0.2,) if quick else (0.02, 0.05, 0.1, 0.2, 0.4, 0.8)
    rates = []
    for noise in noises:
        trials = []
        for seed in range(petals):
            tell(f"noise {noise:g}, petal {seed + 1} of {petals}")
            trials.append(_found(seed, noise=noise))
        rates.append(float(np.mean(trials)))
        yield Metric.rate(f"robustness.noise_{noise:g}", trials, 0.51 if quick else 0.11)
    if not quick:
        yield Curve(
            "robustness.noise", [*noises], rates, "noise σ / length", "found", group="noise"
        )
    for name, options in (("hole", {"hole": True}), ("pose", {"pose": "rigid"})):
        trials = []
        for seed in range(petals):
            tell(f"{name}, petal {seed + 1} of {petals}")
            trials.append(_found(seed, **options))
        yield Metric.rate(f"robustness.{name}", trials, 0.51 if quick else 0.11)


def _found(
    seed: int,
    *,
    clutter: float = 0.0,
    noise: float = SIGMA,
    hole: bool = False,
    pose: str = "known",
    loss: str = "linear",
) -> bool:
    """Whether a_x and b_y come back within 3 % or three errors, and the rib frequency within 1 %."""
    rng = np.random.default_rng([seed, 11])
    petal = petal_of(3000 + seed)
    points = petal.sample(_POINTS, seed=seed, noise=noise).points
    if hole:
        middle = points[rng.integers(len(points))]
        points = points[np.linalg.norm(points - middle, axis=1) > 0.2 * np.ptp(points[:, 1])]
    if clutter:
        points = among_strays(points, clutter, rng)
    if pose != "known":
        points = points @ Rotation.random(random_state=seed).as_matrix().T + rng.uniform(-40, 40, 3)
    result = pf.fit_petal(points, pose=pose, loss=loss, throw=False)
    off = errors(result.values, petal, ("a_x", "b_y", "rib_frequency"))
    near = all(
        off[name] < max(3.0, 300 * result.stderr[name] / float(getattr(petal, name)))
        for name in ("a_x", "b_y")
    )
    return bool(near and off["rib_frequency"] < 1)


def _unburied(seed: int, share: float) -> bool:
    """Whether a petal without a quadrant comes back: a_x to 3 %, b_y to 2 %, the rib frequency to 1 %."""
    scene = buried(seed, share)
    result = pf.fit_petal(scene.points, pose="rigid", loss="robust", throw=False)
    off = errors(result.values, scene.petal, ("a_x", "b_y", "rib_frequency"))
    return off["a_x"] < 3 and off["b_y"] < 2 and off["rib_frequency"] < 1
