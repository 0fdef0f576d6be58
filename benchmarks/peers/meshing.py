"""Areas of triangle meshes that Open3D makes of points: what one measures without a model.

Every mesh has the parameters, as multiples of the mean distance from a point to the nearest other one,
for which its areas are best on ten petals of the benchmark itself, so that parameters that are chosen
without knowing the answer do worse. Holes are filled where a mesh has a margin: each of its loops but
the longest is closed by triangles to the loop's centre.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import metadata
from typing import Any

import numpy as np
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

try:
    NAME = f"Open3D {metadata.version('open3d')}"
except metadata.PackageNotFoundError:
    NAME = "Open3D"
_NEIGHBOURS = 20  # for the normals
_TRIMMED = 2.5  # distance to the nearest point, beyond which Poisson's surface is cut off
_BALLS = (4.0, 8.0)  # radii
_ALPHA = 40.0


def available() -> str | None:
    """None if it works, else what is missing and what to install."""
    try:
        import open3d  # noqa: F401
    except ImportError as error:
        return f"Open3D does not load ({error}): pip install 'petalfit[bench]'."
    return None


def poisson(points: np.ndarray) -> float:
    """The area of a Poisson reconstruction (Kazhdan and Hoppe 2013) whose cells are one distance wide."""
    import open3d as o3d

    gap = _gap(points)
    depth = int(np.ceil(np.log2(1.1 * np.ptp(points, axis=0).max() / gap)))
    mesh, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
        _with_normals(points), depth=depth, n_threads=1
    )
    away, _ = KDTree(points).query(np.asarray(mesh.vertices))
    mesh.remove_vertices_by_mask(np.asarray(away) > _TRIMMED * gap)
    return _filled_area(mesh)


def ball_pivoting(points: np.ndarray) -> float:
    """The area of a mesh by ball pivoting (Bernardini et al. 1999)."""
    import open3d as o3d

    radii = o3d.utility.DoubleVector([x * _gap(points) for x in _BALLS])
    return _filled_area(
        o3d.geometry.TriangleMesh.create_from_point_cloud_ball_pivoting(
            _with_normals(points), radii
        )
    )


def alpha_shape(points: np.ndarray) -> float:
    """Half of the area of an alpha shape (Edelsbrunner and Mücke 1994), which has two faces."""
    import open3d as o3d

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    shape = o3d.geometry.TriangleMesh.create_from_point_cloud_alpha_shape(
        cloud, _ALPHA * _gap(points)
    )
    return 0.5 * float(shape.get_surface_area())


PEERS: dict[str, Callable[[np.ndarray], float]] = {
    "poisson": poisson,
    "ball_pivoting": ball_pivoting,
    "alpha_shape": alpha_shape,
}


def _gap(points: np.ndarray) -> float:
    """The mean distance from a point to the nearest other one."""
    return float(np.mean(np.asarray(KDTree(points).query(points, 2)[0])[:, 1]))


def _with_normals(points: np.ndarray) -> Any:
    import open3d as o3d

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(_NEIGHBOURS))
    cloud.orient_normals_consistent_tangent_plane(_NEIGHBOURS)
    return cloud


def _filled_area(made: Any) -> float:
    """The area of a mesh of Open3D with its holes filled."""
    mesh = trimesh.Trimesh(np.asarray(made.vertices), np.asarray(made.triangles), process=False)
    rim = mesh.edges_sorted[trimesh.grouping.group_rows(mesh.edges_sorted, require_count=1)]
    if not len(rim):
        return float(mesh.area)
    n = len(mesh.vertices)
    _, label = connected_components(coo_array((np.ones(len(rim)), rim.T), (n, n)), directed=False)
    loop = np.unique(label[rim[:, 0]], return_inverse=True)[1]
    start, end = mesh.vertices[rim[:, 0]], mesh.vertices[rim[:, 1]]
    long = np.linalg.norm(end - start, axis=1)
    total = np.bincount(loop, long)
    middle = 0.5 * long[:, None] * (start + end)
    centre = np.stack([np.bincount(loop, x) for x in middle.T], axis=1) / total[:, None]
    fan = 0.5 * np.linalg.norm(np.cross(start - centre[loop], end - centre[loop]), axis=1)
    return float(mesh.area + fan[loop != np.argmax(total)].sum())
