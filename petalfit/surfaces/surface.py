"""The abstract surface: a map (u, v) → ℝ³ with the verbs that users call on it."""

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
    """A surface S(u, v) in ℝ³. A subclass gives `domain` and `position`; the rest follows by autodiff.

    See `AbstractMap` for its attributes.
    """

    def sample(self, n: int, seed: int = 0, noise: float = 0.0) -> PointCloud:
        """An area-uniform random cloud of the surface. See `petalfit.surfaces.sampling`."""
        return sample(self, n, seed, noise)

    def mesh(self, resolution: tuple[int, int] = (65, 65)) -> trimesh.Trimesh:
        """A triangle mesh with UVs. See `petalfit.surfaces.tessellation`."""
        return tessellate(self, resolution)

    def silhouette(self, camera: Camera) -> Silhouette:
        """The exact coverage of every pixel of a camera. See `petalfit.surfaces.silhouette`."""
        return silhouette(self, camera)
