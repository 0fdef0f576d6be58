"""`python -m benchmarks.trace`: which stage of a fit loses a petal among clutter.

For every seed a line says how well points were told from clutter before there was a model, one line for
each stage says how far its last surface is from the truth, and one how the fit ended.
"""

from __future__ import annotations

from typing import Annotated, cast

import numpy as np
import tyro
from tyro.conf import arg

import petalfit as pf
from benchmarks.targets import Scene, buried, errors
from petalfit.components import bare
from petalfit.fitting.outliers.local_planes import on_sheets
from petalfit.fitting.solver.observer import Glimpse, looking_on

_NAMES = ("a_x", "b_y", "rib_frequency")


def main(
    share: Annotated[float, arg(help="Share of all points that are clutter.")] = 0.6,
    seeds: Annotated[int, arg(help="Number of petals.")] = 10,
    first: Annotated[int, arg(help="Number of the first petal.")] = 0,
) -> None:
    """Fit petals among clutter, and print what every stage made of them."""
    for seed in range(first, first + seeds):
        _trace(seed, buried(seed, share))


def _trace(seed: int, scene: Scene) -> None:
    likely = on_sheets(scene.points)
    print(f"petal {seed}: likely points, {_told(likely, scene.inside)}")
    stage, last = "", cast("Glimpse | None", None)

    def begin(text: str) -> None:
        nonlocal stage, last
        if last is not None:
            print(f"  {stage}: {_apart(cast(pf.PeonyPetal, bare(last.model)), scene.petal)}")
        stage, last = text, None

    def look(glimpse: Glimpse) -> None:
        nonlocal last
        last = glimpse

    with looking_on(look):
        result = pf.fit_petal(
            scene.points, pose="rigid", loss="robust", throw=False, progress=begin
        )
    begin("")
    found = cast(pf.PeonyPetal, result.model)
    members = result.weights > 0.5
    print(
        f"  {result.status}: {_apart(found, scene.petal)}; members, {_told(members, scene.inside)}"
    )


def _apart(found: pf.PeonyPetal, petal: pf.PeonyPetal) -> str:
    off = errors({name: float(getattr(found, name)) for name in _NAMES}, petal, _NAMES)
    return ", ".join(f"{name} {x:.1f} %" for name, x in off.items())


def _told(chosen: np.ndarray, inside: np.ndarray) -> str:
    recall, precision = chosen[inside].mean(), inside[chosen].mean() if chosen.any() else 0.0
    return f"recall {recall:.3f}, precision {precision:.3f}"


if __name__ == "__main__":
    tyro.cli(main)
