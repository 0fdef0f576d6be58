"""The abstract surface: a map (u, v) → ℝ³ with methods to sample, mesh and project it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from petalfit.surfaces.map import AbstractMap
from petalfit.surfaces.sampling import sample
from petalfit.surfaces.silhouette import silhouette
from petalfit.surfaces.tessellation import tessellate

if TYPE_CHECKING:
    import trimesh

    from petalfit.observations import Camera, PointCloud, Silhouette


class AbstractSurface(AbstractMap):
    """A surface S(u, v) in ℝ³. A subclass defines `domain` and `position`; autodiff gives the rest.

    Its attributes are those of `AbstractMap`.
    """

    def sample(self, n: int, seed: int = 0, noise: float = 0.0) -> PointCloud:
        """Random points on the surface, uniform by area. See `petalfit.surfaces.sampling`."""
        return sample(self, n, seed, noise)

    def mesh(self, resolution: tuple[int, int] = (65, 65)) -> trimesh.Trimesh:
        """A triangle mesh with normals and texture coordinates. See `petalfit.surfaces.tessellation`."""
        return tessellate(self, resolution)

    def silhouette(self, camera: Camera) -> Silhouette:
        """The exact coverage of every pixel of a camera's image. See `petalfit.surfaces.silhouette`."""
        return silhouette(self, camera)
