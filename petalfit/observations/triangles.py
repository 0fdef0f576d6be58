"""Sampling of points from the triangles of a mesh, uniformly by area."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64

from petalfit.observations.columns import Columns
from petalfit.observations.errors import TargetError
from petalfit.observations.mesh_pieces import piece_notes
from petalfit.observations.resolution import resolution_notes
from petalfit.observations.validation import LARGEST_COORDINATE

if TYPE_CHECKING:
    import trimesh
    import trimesh.parent

# Default number of points drawn from a mesh. Some 240 of them lie on the midrib of a petal (whose
# half-width is 0.03 of the petal's width), and it is a power of two, to which fits pad their targets.
DEFAULT_SAMPLES = 4096


def mesh_triangles(mesh: "trimesh.Trimesh") -> Float64[np.ndarray, "f 3 3"]:
    """The corners of each face of a mesh.

    Args:
        mesh: Any mesh with faces; vertices that no face uses are ignored.

    Returns:
        The coordinates in float64, shape (F, 3, 3), by face, corner and coordinate.

    Raises:
        TargetError: The mesh has no faces, they are not triangles in space, they use vertices that do
            not exist, or a corner is not finite or too far out to compute an area.
    """
    vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces)
    if not len(faces):
        raise TargetError("the mesh has no faces; if it is a cloud, give its vertices instead.")
    if (vertices.shape[1:], faces.shape[1:]) != ((3,), (3,)):
        raise TargetError(
            f"the mesh has vertices of shape {vertices.shape} and faces of shape {faces.shape}, "
            "expected (V, 3) and (F, 3); repair or export it again."
        )
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise TargetError(
            f"the mesh has faces that use vertices {faces.min()} to {faces.max()}, but its "
            f"vertices are 0 to {len(vertices) - 1}; repair or export it again."
        )
    corners = vertices[faces]
    usable = (np.abs(corners) <= LARGEST_COORDINATE).all(axis=(1, 2))  # False for NaN.
    if not usable.all():
        raise TargetError(
            f"the mesh has a corner that is NaN, infinite or beyond {LARGEST_COORDINATE:g} in "
            f"{(~usable).sum()} of {len(faces)} faces, the first is face {usable.argmin()}; "
            "remove them."
        )
    return corners


def sample_triangles(
    triangles: Float64[np.ndarray, "f 3 3"], n: int, seed: int
) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]]:
    """Draws independent points, uniformly by area, with the normals of their triangles.

    Args:
        triangles: The corners of each triangle, (F, 3, 3), anticlockwise as seen from outside.
        n: The number of points, positive.
        seed: The seed of `numpy.random.default_rng`.

    Returns:
        The points (n, 3) and their unit normals (n, 3).

    Raises:
        ValueError: `n` is not positive.
        TargetError: The triangles have no area.
    """
    if n < 1:
        raise ValueError(f"n is {n}, expected a positive number of points.")
    corner = triangles[:, 0]
    first, second = triangles[:, 1] - corner, triangles[:, 2] - corner
    longest = max(np.abs(first).max(), np.abs(second).max())
    if longest == 0.0:
        raise TargetError("the mesh has no area: the corners of every face coincide.")
    # Lengths are in units of the longest edge; otherwise the areas of tiny meshes would underflow.
    doubled = np.cross(first / longest, second / longest)
    area = np.linalg.norm(doubled, axis=1)
    if not area.sum() > 0.0:
        raise TargetError("the mesh has no area: every face is a line or a point.")
    rng = np.random.default_rng(seed)
    face = rng.choice(len(area), size=n, p=area / area.sum())
    s, t = rng.random((2, n, 1))
    # (s, t) are uniform on the parallelogram; its far half is folded back onto the triangle.
    s, t = np.where(s + t > 1.0, (1.0 - s, 1.0 - t), (s, t))
    points = corner[face] + s * first[face] + t * second[face]
    return points, doubled[face] / area[face, None]


def geometry_columns(
    geometries: "Sequence[trimesh.parent.Geometry]", n: int = DEFAULT_SAMPLES, seed: int = 0
) -> Columns:
    """The points of any trimesh geometries, as `trimesh.Scene.dump` gives them.

    Args:
        geometries: The geometries. Their faces are sampled together, as by `PointCloud.from_mesh`.
            Without any faces, the vertices are the points.
        n: The number of points to draw from faces; without faces all vertices are used.
        seed: The seed of `numpy.random.default_rng`.

    Returns:
        The points, with normals if they were drawn from faces, and with the colours of vertices if they
        were not.

    Raises:
        TargetError: There are neither faces nor vertices, or they cannot be used.
    """
    import trimesh

    meshes = [part for part in geometries if isinstance(part, trimesh.Trimesh) and len(part.faces)]
    if meshes:
        triangles = np.concatenate([mesh_triangles(mesh) for mesh in meshes])
        points, normals = sample_triangles(triangles, n, seed)
        return {
            "points": points,
            "normals": normals,
            "weights": None,
            "colours": None,
            "notes": (*resolution_notes(triangles.reshape(-1, 3)), *piece_notes(triangles)),
        }
    vertices = [getattr(part, "vertices", ()) for part in geometries]
    clouds = [np.asarray(points) for points in vertices if np.shape(points)[1:] == (3,)]
    if not sum(map(len, clouds)):
        raise TargetError("there are no vertices; give a mesh or a cloud that is not empty.")
    points = np.concatenate(clouds)
    colours = [np.asarray(getattr(part, "colors", ())) for part in geometries]
    colours = np.concatenate([part[:, :3] for part in colours if part.ndim == 2] or [points[:0]])
    return {
        "points": points,
        "normals": None,
        "weights": None,
        "colours": colours if len(colours) == len(points) else None,
    }
