"""Random petals from one oblique binary mask of 256 × 256 pixels, its camera known, no start given."""

from __future__ import annotations

from collections.abc import Iterator

import petalfit as pf
from benchmarks.metric import Metric, Tell
from benchmarks.targets import SMOOTH, errors, mask_of, oblique, petal_of


def run(quick: bool, tell: Tell) -> Iterator[Metric]:
    petals = 6 if quick else 40
    found, inside = [], []
    off: dict[str, list[float]] = {name: [] for name in SMOOTH}
    ribs = []
    for seed in range(petals):
        tell(f"petal {seed + 1} of {petals}")
        petal = petal_of(2000 + seed)
        result = pf.fit_petal(mask_of(petal, oblique(petal, seed)), throw=False)
        off_by = errors(result.values, petal, SMOOTH)
        found.append(off_by["a_x"] < 2 and off_by["b_y"] < 2)
        for name, percent in off_by.items():
            off[name].append(percent)
        for name, (low, high) in result.interval(0.95).items():
            if result.identifiable[name]:
                inside.append(low <= float(getattr(petal, name)) <= high)
        right = abs(result.values["rib_frequency"] / float(petal.rib_frequency) - 1) < 0.01
        ribs.append(right or not result.identifiable["rib_frequency"])
    yield Metric.rate("silhouette.found", found, 0.13)
    yield Metric.rate(
        "silhouette.coverage", inside, 0.1, "of 95 % intervals of what is identifiable"
    )
    yield Metric.rate(
        "silhouette.ribs_honest", ribs, 0.1, "rib frequency right, or said not to be identifiable"
    )
    for name, percents in off.items():
        yield Metric.median(f"silhouette.error_{name}", percents, "%", "less", tolerance=1.0)
