"""Random petals from clouds, no start given: how many are found, how well, how honestly."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import petalfit as pf
from benchmarks.metric import Curve, Metric, Tell
from benchmarks.targets import NAMES, cloud_of, cramer_rao, petal_of

# A petal is found if everything that the cloud tells well is within so many per cent.
_WITHIN = {"a_x": 3.0, "b_y": 3.0, "rib_frequency": 1.0}


def run(quick: bool, tell: Tell) -> Iterator[Metric | Curve]:
    for points, petals in ((1500, 16 if quick else 100), (300, 8 if quick else 50)):
        found, inside, over = [], [], {name: [] for name in NAMES}
        for seed in range(petals):
            tell(f"{points} points, petal {seed + 1} of {petals}")
            petal = petal_of(1000 + seed)
            result = pf.fit_petal(cloud_of(petal, points, seed), throw=False)
            right = all(
                100 * abs(result.values[name] / float(getattr(petal, name)) - 1) < limit
                for name, limit in _WITHIN.items()
            )
            found.append(right and result.converged)
            bound = cramer_rao(petal, points, seed)
            for name, (low, high) in result.interval(0.95).items():
                truth = float(getattr(petal, name))
                inside.append(low <= truth <= high)
                if right:
                    over[name].append((result.values[name] - truth) / bound[name])
        yield Metric.rate(f"recovery.found_{points}", found, 0.06)
        yield Metric.rate(
            f"recovery.coverage_{points}", inside, 0.06, "of 95 % intervals, all parameters"
        )
        rms = {name: float(np.sqrt(np.mean(np.square(z)))) for name, z in over.items()}
        yield Metric(
            f"recovery.error_over_bound_{points}",
            float(np.median([*rms.values()])),
            "×",
            "less",
            0.25,
            spread=float(np.ptp([*rms.values()])) / 4,
            count=sum(map(len, over.values())),
            note="rms error over the Cramér–Rao bound of normal distances, median of the parameters",
        )
        yield Curve(
            f"recovery.bound_{points}", [*range(len(NAMES))], [rms[name] for name in NAMES],
            "parameter: " + ", ".join(NAMES), "rms error / Cramér–Rao bound", group="recovery",
        )  # fmt: skip
