"""Petals and leaves that nobody generated with our equations, from a folder of meshes.

PETALFIT_SHAPES names the folder; without it the suite looks for shared/data/petals beside the checkout.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import cKDTree

import petalfit as pf
from benchmarks.metric import Metric, Tell

_POINTS = 2000
_SAMPLES = 60_000


def shapes() -> list[Path]:
    """The meshes; none if there is no folder."""
    beside = Path(__file__).parents[3] / "shared" / "data" / "petals"
    return sorted(Path(os.environ.get("PETALFIT_SHAPES", beside)).glob("*.ply"))


def chosen(suite: str, quick: bool) -> tuple[list[Path], Metric]:
    """The meshes that a suite measures, all or three of them, and the row that counts them."""
    files, note = shapes(), ""
    if not files:
        note = "none found: set PETALFIT_SHAPES to a folder of meshes"
    if quick:
        files = files[:: max(1, len(files) // 3)][:3]
    return files, Metric(f"{suite}.shapes", len(files), "1", "more", note=note)


def run(quick: bool, tell: Tell) -> Iterator[Metric]:
    files, count = chosen("real", quick)
    yield count
    if not files:
        return
    for model in (pf.BladePetal, pf.SplinePetal):
        name = model.__name__
        off, times = [], []
        for k, path in enumerate(files):
            tell(f"{name}, {path.name}")
            mesh = trimesh.load(path, process=False)
            cloud = pf.PointCloud.load(path, n=_POINTS)
            if k == 0 and not quick:
                pf.fit_petal(cloud, model=model, pose="similarity", throw=False)
            began = time.perf_counter()
            result = pf.fit_petal(cloud, model=model, pose="similarity", throw=False)
            times.append(time.perf_counter() - began)
            off.append(_apart(mesh, result.mesh((129, 129))))
        yield Metric.median(
            f"real.distance_{name}", off, "%", "less", tolerance=0.1,
            note="of the bounding box's diagonal, the larger of mesh to model and model to mesh",
        )  # fmt: skip
        yield Metric(f"real.worst_{name}", max(off), "%", "less", 0.15, count=len(off))
        if not quick:  # another suite may run beside it
            yield Metric.median(f"real.seconds_{name}", times, "s", "less")


def _apart(mesh: trimesh.Trimesh, model: trimesh.Trimesh) -> float:
    """Mean distance in % of the diagonal."""
    fine, few = (
        [trimesh.sample.sample_surface(x, n, seed=seed)[0] for x in (mesh, model)]
        for n, seed in ((_SAMPLES, 1), (4000, 0))
    )
    there = cKDTree(fine[1]).query(few[0])[0].mean()
    back = cKDTree(fine[0]).query(few[1])[0].mean()
    return float(100 * max(there, back) / np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
