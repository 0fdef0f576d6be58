"""Point clouds: what a laser scanner, photogrammetry or a mesh says about where a petal is."""

import math
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64

from petalfit.observations.errors import TargetError
from petalfit.observations.triangles import mesh_triangles, sample_triangles
from petalfit.observations.validation import (
    ArrayLike,
    check_spread,
    valid_colours,
    valid_normals,
    valid_points,
    valid_weights,
)

if TYPE_CHECKING:
    import trimesh
    import trimesh.parent

# Points drawn from a mesh when nobody says how many: some 240 of them on the midrib of a petal
# (half-width 0.03 of its width), and a power of two, to which fits pad their targets.
DEFAULT_SAMPLES = 4096


@dataclass(frozen=True, init=False, eq=False, repr=False)
class PointCloud:
    """Points, perhaps with normals, weights and colours.

    The arrays are checked, copied to float64 and made read-only. Two clouds are equal only if
    they are the same object.

    Args:
        points: (N, 3), in any unit of length. They must not all lie on one line.
        normals: (N, 3), of any length but zero; they are brought to unit length.
        weights: (N,), how many observations each point counts for; 0 ignores a point.
        colours: (N, 3), sRGB from 0 to 1, or bytes. They say nothing of the shape.

    Raises:
        TargetError: the arrays cannot be used; the message says why and what to do.
    """

    points: Float64[np.ndarray, "n 3"]
    normals: Float64[np.ndarray, "n 3"] | None
    weights: Float64[np.ndarray, " n"] | None
    colours: Float64[np.ndarray, "n 3"] | None

    def __init__(
        self,
        points: ArrayLike,
        normals: ArrayLike | None = None,
        weights: ArrayLike | None = None,
        colours: ArrayLike | None = None,
    ) -> None:
        points = valid_points(points)
        normals = None if normals is None else valid_normals(normals, len(points))
        weights = None if weights is None else valid_weights(weights, len(points))
        colours = None if colours is None else valid_colours(colours, len(points))
        check_spread(points if weights is None else points[weights > 0.0])
        given = {"points": points, "normals": normals, "weights": weights, "colours": colours}
        for name, array in given.items():
            if array is not None:
                array.setflags(write=False)
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.points)

    def __repr__(self) -> str:
        extent = " × ".join(f"{side:.4g}" for side in self.extent)
        extras = [
            name for name in ("normals", "weights", "colours") if getattr(self, name) is not None
        ]
        return f"PointCloud({', '.join([f'{len(self)} points', f'extent {extent}', *extras])})"

    @property
    def centroid(self) -> Float64[np.ndarray, "3"]:
        """The mean of the points, weighted if there are weights; (3,)."""
        # About one of the points: a sum of coordinates of 5e6 would round the petal away.
        origin = self.points[0]
        weights = None if self.weights is None else self.weights / self.weights.max()
        return origin + np.average(self.points - origin, axis=0, weights=weights)

    @property
    def extent(self) -> Float64[np.ndarray, "3"]:
        """The sides of the axis-aligned bounding box; (3,)."""
        return np.ptp(self.points, axis=0)

    @property
    def diagonal(self) -> float:
        """The diagonal of the axis-aligned bounding box."""
        return math.hypot(*self.extent)

    @classmethod
    def load(
        cls, path: str | os.PathLike[str], *, n: int = DEFAULT_SAMPLES, seed: int = 0
    ) -> "PointCloud":
        """Reads a cloud, or samples a mesh: see `read_point_cloud`, which does the work."""
        # Here, because the readers make clouds and so import this file.
        from petalfit.observations.readers import read_point_cloud

        return read_point_cloud(path, n, seed)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the cloud whole or not at all: see `write_point_cloud`, which does the work."""
        from petalfit.observations.writers import write_point_cloud

        write_point_cloud(self, path)

    @classmethod
    def from_mesh(
        cls, mesh: "trimesh.Trimesh", n: int = DEFAULT_SAMPLES, seed: int = 0
    ) -> "PointCloud":
        """Draws points from a mesh, uniformly by area, with the normals of their faces.

        Args:
            mesh: any mesh with faces; it need not be closed.
            n: number of points.
            seed: of `numpy.random.default_rng`; the same seed gives the same points.

        Returns:
            A cloud of n points with normals.

        Raises:
            ValueError: n is not positive.
            TargetError: the mesh has no faces, no area, or faces without usable corners.
        """
        return cls(*sample_triangles(mesh_triangles(mesh), n, seed))


def from_trimesh(
    geometries: "Sequence[trimesh.parent.Geometry]", n: int = DEFAULT_SAMPLES, seed: int = 0
) -> PointCloud:
    """The cloud of any trimesh geometries, as `trimesh.Scene.dump` gives them.

    Args:
        geometries: their faces are sampled together, as by `PointCloud.from_mesh`. Where there
            are no faces at all, the vertices are the cloud.
        n: number of points to draw from faces; vertices are all taken.
        seed: of `numpy.random.default_rng`.

    Returns:
        A cloud, with normals if it was drawn from faces.

    Raises:
        TargetError: there are neither faces nor vertices, or they cannot be used.
    """
    import trimesh

    meshes = [part for part in geometries if isinstance(part, trimesh.Trimesh) and len(part.faces)]
    if meshes:
        triangles = np.concatenate([mesh_triangles(mesh) for mesh in meshes])
        return PointCloud(*sample_triangles(triangles, n, seed))
    vertices = [getattr(part, "vertices", ()) for part in geometries]
    vertices = [points for points in vertices if np.shape(points)[1:] == (3,)]
    if not sum(map(len, vertices)):
        raise TargetError("there are no vertices; give a mesh or a cloud that is not empty.")
    return PointCloud(np.concatenate(vertices))


def as_point_cloud(target: object) -> PointCloud:
    """Makes a point cloud of whatever may be called one.

    Args:
        target: an (N, 3) array-like of NumPy, JAX or plain lists; a `PointCloud`, which is
            returned as it is; a `trimesh.Trimesh`, `trimesh.PointCloud` or `trimesh.Scene`, of
            which faces are sampled by area; or the path of a file.

    Returns:
        The cloud.

    Raises:
        TargetError: it is none of these, or cannot be used.
    """
    if isinstance(target, PointCloud):
        return target
    if isinstance(target, str | os.PathLike):
        return PointCloud.load(target)
    # Whoever holds an object of trimesh has imported it already.
    if "trimesh" in sys.modules:
        import trimesh

        if isinstance(target, trimesh.Scene):
            return from_trimesh(target.dump())
        if isinstance(target, trimesh.Trimesh | trimesh.PointCloud):
            return from_trimesh([target])
    if isinstance(target, list | tuple) or hasattr(target, "__array__"):
        return PointCloud(target)  # pyright: ignore[reportArgumentType] - checked in there
    raise TargetError(
        f"a target of type {type(target).__name__} is not a point cloud; give an (N, 3) array, "
        "a PointCloud, a trimesh mesh, cloud or scene, or the path of a file."
    )
