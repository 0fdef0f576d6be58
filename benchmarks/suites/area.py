"""How well areas of petals that nobody generated are measured, beside meshes of Open3D.

The petals are those of the suite `real`. Each is known from 2,000 points with noise of 0.1 % of its
diagonal, and the innermost 30 % of its area are missing, as where a stamen or a hand hid them.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

import petalfit as pf
from benchmarks.metric import Metric, Tell
from benchmarks.peers import meshing
from benchmarks.suites.real import chosen
from petalfit.results import quantile

_POINTS = 2000
_NOISE = 0.001  # of the diagonal
_HOLE = 0.3  # of the area
_MODELS = (pf.BladePetal, pf.SplinePetal)
_LEVEL = 0.95


def run(quick: bool, tell: Tell) -> Iterator[Metric]:
    files, count = chosen("area", quick)
    yield count
    if not files:
        return
    reach = quantile(_LEVEL)
    missing = meshing.available()
    errors: dict[str, list[float]] = {}
    stderr: dict[str, list[float]] = {}
    for path in files:
        mesh = trimesh.load(path, process=False)
        mesh.merge_vertices()
        points = with_hole(mesh, np.random.default_rng(0))
        for model in _MODELS:
            name = model.__name__
            tell(f"{name}, {path.name}")
            result = pf.fit_petal(points, model=model, pose="similarity", throw=False)
            trait = result.traits["area"]
            errors.setdefault(name, []).append(100 * (trait.value / mesh.area - 1))
            stderr.setdefault(name, []).append(100 * trait.stderr / mesh.area)
        for name, area in {} if missing else meshing.PEERS.items():
            tell(f"{name}, {path.name}")
            errors.setdefault(name, []).append(100 * (area(points) / mesh.area - 1))
    for model in _MODELS:
        name = model.__name__
        off, known = np.array(errors[name]), np.array(stderr[name])
        yield Metric.median(f"area.error_{name}", np.abs(off), "%", "less", tolerance=0.2)
        yield Metric.rate(
            f"area.covered_{name}",
            np.abs(off) < reach * known,
            0.51 if quick else 0.05,
            f"of the 95 % intervals; the median standard error is {np.median(known):.2g} %",
        )
    for name in meshing.PEERS:
        if missing:
            yield Metric(f"area.error_{name}", np.nan, "%", "less", note=f"missing: {missing}")
        else:
            yield Metric.median(
                f"area.error_{name}", np.abs(errors[name]), "%", "less", note=meshing.NAME
            )


def with_hole(mesh: trimesh.Trimesh, rng: np.random.Generator) -> np.ndarray:
    """Points of a petal without those that are the farthest from its margin, along its edges."""
    many = 3 * _POINTS
    points, face = trimesh.sample.sample_surface(mesh, many, seed=int(rng.integers(2**31)))
    edges, count = np.unique(mesh.edges_sorted, axis=0, return_counts=True)
    n = len(mesh.vertices)
    long = np.linalg.norm(np.diff(mesh.vertices[edges], axis=1)[:, 0], axis=-1)
    rim = np.unique(edges[count == 1])
    deep = dijkstra(coo_array((long, edges.T), (n, n)).tocsr(), False, rim, min_only=True)
    part = trimesh.triangles.points_to_barycentric(mesh.triangles[face], points)
    depth = np.sum(part * np.asarray(deep)[mesh.faces[face]], axis=1)
    points = points[depth <= np.quantile(depth, 1 - _HOLE)][:_POINTS]
    diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    return points + _NOISE * diagonal * rng.standard_normal(points.shape)
