"""Triangle meshes of surfaces."""

from __future__ import annotations

from typing import TYPE_CHECKING

import jax
import numpy as np
from jaxtyping import Float, Int

from petalfit.surfaces.map import AbstractMap
from petalfit.surfaces.pose import Pose
from petalfit.surfaces.programs import position_and_normal

if TYPE_CHECKING:
    import trimesh


def tessellate(surface: AbstractMap, resolution: tuple[int, int] = (65, 65)) -> trimesh.Trimesh:
    """A triangle mesh on a regular grid of the domain.

    Args:
        surface: Any surface.
        resolution: The numbers of vertices along u and along v, at least 2 each.

    Returns:
        A mesh with the unit normals of the surface at its vertices, and with (u, v) scaled to [0, 1]² as
        texture coordinates. Faces are wound so that their normals agree with those of the vertices.

    Raises:
        ValueError: The resolution is too small.
    """
    import trimesh
    from trimesh.visual import TextureVisuals

    n_u, n_v = resolution
    if n_u < 2 or n_v < 2:
        raise ValueError(f"a mesh needs at least 2 × 2 vertices; received {n_u} × {n_v}")
    u, v = (np.linspace(*side, n) for side, n in zip(surface.domain, resolution, strict=True))
    u, v = (x.ravel() for x in np.meshgrid(u, v, indexing="ij"))
    with jax.enable_x64(True):
        vertices, normals = (np.asarray(x) for x in position_and_normal(surface, u, v))
    return trimesh.Trimesh(
        vertices,
        grid_faces(resolution, surface.orientation),
        vertex_normals=normals,
        visual=TextureVisuals(uv=grid_uv(resolution)),
        process=False,
    )


def moved(mesh: trimesh.Trimesh, pose: Pose) -> trimesh.Trimesh:
    """Moves a mesh in place and returns it; its normals are rotated, not recomputed as by trimesh."""
    normals = mesh.vertex_normals @ np.asarray(pose.rotation).T
    mesh.apply_transform(pose.matrix())
    mesh.vertex_normals = normals
    return mesh


def grid_faces(resolution: tuple[int, int], orientation: float) -> Int[np.ndarray, "m 3"]:
    """The faces of a grid, two triangles per cell; v varies fastest among the vertices.

    Args:
        resolution: The numbers of vertices along u and along v.
        orientation: The orientation of the surface; −1 reverses the winding of the triangles.
    """
    n_u, n_v = resolution
    corner = (np.arange(n_u - 1)[:, None] * n_v + np.arange(n_v - 1)).ravel()
    across, along = corner + n_v, corner + 1
    faces = np.concatenate(
        [
            np.stack([corner, across, across + 1], axis=-1),
            np.stack([corner, across + 1, along], axis=-1),
        ]
    )
    return faces if orientation > 0 else faces[:, ::-1]


def grid_uv(resolution: tuple[int, int]) -> Float[np.ndarray, "n 2"]:
    """The texture coordinates of a grid of the whole domain: (u, v) scaled to [0, 1]²."""
    u, v = (np.linspace(0, 1, n) for n in resolution)
    return np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
