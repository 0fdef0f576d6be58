"""Silhouettes of a surface: the exact coverage of every pixel by its projected mesh."""

from __future__ import annotations

import jax
import numpy as np
from jaxtyping import Float

from petalfit.observations import Camera, Silhouette, TargetError
from petalfit.surfaces.map import AbstractMap
from petalfit.surfaces.outline import rims_and_folds, sheets
from petalfit.surfaces.programs import grid_positions

RESOLUTION = (257, 129)
_GRID = 2.0**-20  # pixels


def silhouette(
    surface: AbstractMap, camera: Camera, resolution: tuple[int, int] = RESOLUTION
) -> Silhouette:
    """The silhouette of a surface for a camera: for each pixel, the fraction that the surface covers.

    It is exact for the projected mesh, including folds and self-occlusion, and therefore unbiased at the
    edge.

    Args:
        surface: Any surface.
        camera: The camera, in the surface's frame and unit.
        resolution: The numbers of vertices of the mesh along u and along v.

    Raises:
        TargetError: The camera looks away from the surface or stands in it, or sees too little of it.
    """
    camera = camera.pinhole()
    return Silhouette(coverage(outline_rings(surface, camera, resolution), camera.shape), camera)


def outline_rings(
    surface: AbstractMap, camera: Camera, resolution: tuple[int, int] = RESOLUTION
) -> list[np.ndarray]:
    """The boundary of the area that the projected mesh of a surface covers, in pixels.

    Returns:
        Closed rings of shape (k, 2). Outer rings run in one direction, holes in the other.

    Raises:
        TargetError: The camera looks away from the surface or stands in it.
    """
    u, v = (np.linspace(*side, n) for side, n in zip(surface.domain, resolution, strict=True))
    with jax.enable_x64(True):
        vertices = np.asarray(grid_positions(surface, u, v))
    if not camera.is_orthographic and camera.depth(vertices).min() <= 0:
        behind = np.mean(camera.depth(vertices) <= 0)
        where = "looks away from the surface" if behind == 1 else "stands in or beside the surface"
        raise TargetError(
            f"the camera {where}: {100 * behind:.0f} % of it lie behind the eye (z ≤ 0 in the "
            "camera's frame); OpenCV cameras look along +z."
        )
    return rings(camera.project(vertices))


def rings(grid: Float[np.ndarray, "n m 2"]) -> list[np.ndarray]:
    """The boundary of the union of a projected grid's triangles; see `outline_rings`.

    Rims and folds divide the plane into cells, each of which is covered completely or not at all.
    """
    import shapely

    edges, xy = rims_and_folds(grid), grid.reshape(-1, 2)
    lines = np.asarray(shapely.linestrings(xy[np.stack([edges.start, edges.end], axis=-1)]))
    try:
        lines = shapely.node(shapely.multilinestrings(lines))
    except shapely.errors.GEOSException:
        # Where a seam coincides with itself except for rounding, only snapping to a grid helps.
        lines = shapely.unary_union(lines, grid_size=_GRID)
    lines = np.asarray(shapely.get_parts(lines))
    cells = shapely.get_parts(shapely.polygonize(lines))
    inside = shapely.get_coordinates(shapely.point_on_surface(cells))
    covered = sheets(inside, xy, edges) > 0
    union = shapely.orient_polygons(shapely.get_parts(shapely.coverage_union_all(cells[covered])))
    return [shapely.get_coordinates(ring) for ring in shapely.get_rings(union)]


def coverage(rings: list[np.ndarray], shape: tuple[int, int]) -> Float[np.ndarray, "h w"]:
    """The exact fraction of every pixel that lies inside closed rings.

    Each piece of a ring within one pixel adds its height to all pixels on its right, and the area on its
    right to its own pixel; sums along the rows then give the coverage.
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
    """Divides segments where a coordinate is a whole number from 0 to `size`."""
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
