"""Silhouettes of a surface: the exact area that its projected mesh covers in every pixel."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from petalfit.observations import Camera, Silhouette, TargetError
from petalfit.surfaces.surface import AbstractSurface
from petalfit.surfaces.tessellation import tessellate

RESOLUTION = (257, 129)


def silhouette(
    surface: AbstractSurface, camera: Camera, resolution: tuple[int, int] = RESOLUTION
) -> Silhouette:
    """What a camera sees of a surface: for each pixel the share that the surface covers.

    Exact for the projected mesh, folds and self-occlusion included, hence unbiased at the edge.

    Args:
        surface: Any surface.
        camera: In the surface's frame and unit.
        resolution: Vertices of the mesh along u and along v.

    Raises:
        TargetError: The camera looks away from the surface or stands in it, or sees too little of it.
    """
    mesh = tessellate(surface, resolution)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    if not camera.is_orthographic and camera.depth(vertices).min() <= 0:
        behind = np.mean(camera.depth(vertices) <= 0)
        where = "looks away from the surface" if behind == 1 else "stands in or beside the surface"
        raise TargetError(
            f"the camera {where}: {100 * behind:.0f} % of it lie behind the eye (z ≤ 0 in the "
            "camera's frame); OpenCV cameras look along +z."
        )
    rings = outline(camera.project(vertices), faces)
    return Silhouette(coverage(rings, camera.shape), camera)


def outline(xy: Float[np.ndarray, "n 2"], faces: Int[np.ndarray, "m 3"]) -> list[np.ndarray]:
    """The boundary of the union of projected triangles.

    It runs along edges of the mesh where the mesh ends or folds over. These cut the plane into cells,
    each of which is covered wholly or not at all.

    Returns:
        Closed rings of shape (k, 2): outer ones in one sense of rotation, holes in the other.
    """
    import shapely

    lines = np.asarray(shapely.linestrings(xy[_rims_and_folds(xy, faces)]))
    lines = np.asarray(shapely.get_parts(shapely.node(shapely.multilinestrings(lines))))
    cells = shapely.get_parts(shapely.polygonize(lines))
    triangles = np.asarray(shapely.polygons(xy[faces[:, [0, 1, 2, 0]]]))
    inside = shapely.point_on_surface(cells)
    covered, _ = shapely.STRtree(triangles).query(inside, predicate="intersects")
    covered = np.unique(covered)
    union = shapely.orient_polygons(shapely.get_parts(shapely.coverage_union_all(cells[covered])))
    return [shapely.get_coordinates(ring) for ring in shapely.get_rings(union)]


def _rims_and_folds(xy: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Edges (k, 2) of one face only, or of two faces that are seen from different sides."""
    a, b, c = np.moveaxis(xy[faces], 1, 0)
    side = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0] >= 0
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    # As single numbers they are sorted ten times faster than as rows.
    numbers = edges[:, 0] * len(xy) + edges[:, 1]
    numbers, which, count = np.unique(numbers, return_inverse=True, return_counts=True)
    front = np.bincount(which, weights=np.tile(side, 3))
    kept = numbers[(count == 1) | ((front > 0) & (front < count))]
    return np.stack(np.divmod(kept, len(xy)), axis=-1)


def coverage(rings: list[np.ndarray], shape: tuple[int, int]) -> Float[np.ndarray, "h w"]:
    """The exact share of every pixel that lies within closed rings.

    Each piece of a ring within one pixel adds its height to all pixels to its right, and to its own by
    the area right of it; sums along the rows then give the coverage.
    """
    rows, columns = shape
    start = np.concatenate([ring[:-1] for ring in rings])
    end = np.concatenate([ring[1:] for ring in rings])
    for axis, size in ((1, rows), (0, columns)):
        start, end = _cut_at_integers(start, end, axis, size)
    middle = 0.5 * (start + end)
    height = end[:, 1] - start[:, 1]
    seen = (middle[:, 1] > 0) & (middle[:, 1] < rows)
    middle, height = middle[seen], height[seen]
    x = np.clip(middle[:, 0], 0, columns)
    row, column = middle[:, 1].astype(int), np.minimum(x.astype(int), columns)
    steps = np.zeros((rows, columns + 2))
    np.add.at(steps, (row, column), height * (column + 1 - x))
    np.add.at(steps, (row, column + 1), height * (x - column))
    return np.clip(np.abs(np.cumsum(steps, axis=1)[:, :columns]), 0.0, 1.0)


def _cut_at_integers(
    start: np.ndarray, end: np.ndarray, axis: int, size: int
) -> tuple[np.ndarray, np.ndarray]:
    """Segments cut where a coordinate is a whole number from 0 to `size`."""
    low, high = np.sort(np.stack([start[:, axis], end[:, axis]]), axis=0)
    first = np.clip(np.floor(low).astype(int) + 1, 0, size + 1)
    count = np.maximum(np.clip(np.ceil(high).astype(int), 0, size + 1) - first, 0)
    which = np.repeat(np.arange(len(start)), count)
    places = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count) + first[which]
    share = (places - start[which, axis]) / (end - start)[which, axis]
    cuts = start[which] + share[:, None] * (end - start)[which]
    cuts[:, axis] = places
    owner = np.concatenate([np.arange(len(start)), which, np.arange(len(start))])
    order = np.lexsort((np.concatenate([np.zeros(len(start)), share, np.ones(len(start))]), owner))
    points, owner = np.concatenate([start, cuts, end])[order], owner[order]
    joined = owner[1:] == owner[:-1]
    return points[:-1][joined], points[1:][joined]
