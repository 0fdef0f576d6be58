"""Organs that consist of several surfaces: a stamen has a filament and an anther, for instance."""

from __future__ import annotations

import abc
from typing import TYPE_CHECKING, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from petalfit.components.carrier import AbstractCarrier
from petalfit.surfaces import WRAPPED, AbstractSurface, Domain, Pose, moved

if TYPE_CHECKING:
    import trimesh

    from petalfit.observations import PointCloud


class AbstractAssembly(AbstractSurface):
    """Several named surfaces, each posed in the frame of the whole. A subclass defines `parts`.

    A pose may depend on the parts: an anther is placed at the end of its filament, whatever its length.

    Its domain as a surface is an atlas, u ∈ [0, 1] and v ∈ [0, number of parts]. Part k has the chart
    v ∈ [k + ¼, k + ¾]. Between charts, v maps to the edge of the nearer chart, or, for a part without an
    edge in v, continues the part periodically.
    """

    @abc.abstractmethod
    def parts(self) -> dict[str, tuple[Pose, AbstractSurface]]:
        """The pose and the surface of every part by its name; "a/b" is the part b of the part a."""

    @property
    def domain(self) -> Domain:  # pyright: ignore[reportIncompatibleVariableOverride]
        return Domain((0.0, 1.0), (0.0, float(len(self.parts()))))

    def position(self, u: Array, v: Array) -> Array:
        number = jnp.floor(v)
        found = jnp.zeros((*u.shape, 3), u.dtype)
        for k, (pose, surface) in enumerate(self.parts().values()):
            low, high = np.array(surface.domain).T
            along = 2 * jnp.clip(v - k, 0.0, 1.0) - 0.5
            if surface.edges[1]:
                along = jnp.clip(along, 0.0, 1.0)
            here = surface.position(low[0] + (high - low)[0] * u, low[1] + (high - low)[1] * along)
            found = jnp.where((number == k)[..., None], pose(here), found)
        return found

    def part(self, number: int) -> PartOf:
        """One part as a surface in the frame of the whole; parts are numbered from 0."""
        return PartOf(self, number)

    def in_atlas(self, number: int, uv: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Converts places (u, v) of a part's own domain to places of the atlas."""
        _, surface = [*self.parts().values()][number]
        low, high = np.array(surface.domain).T
        fraction = (uv - low) / (high - low)
        along = fraction[:, 1]
        if not surface.edges[1]:
            along = along % 1.0
        return np.stack([fraction[:, 0], number + 0.25 + 0.5 * along], axis=-1)

    def mesh(self, resolution: tuple[int, int] = (65, 65)) -> trimesh.Trimesh:
        """One triangle mesh of all parts."""
        import trimesh

        meshes = [moved(surface.mesh(resolution), pose) for pose, surface in self.parts().values()]
        return trimesh.util.concatenate(meshes)  # pyright: ignore[reportReturnType]

    def area(self, resolution: tuple[int, int] = (512, 256)) -> Float[Array, ""]:
        """The total area of all parts, including what other parts hide."""
        parts = self.parts().values()
        areas = [pose.scale**2 * surface.area(resolution) for pose, surface in parts]
        return jnp.sum(jnp.stack(areas))

    def sample(self, n: int, seed: int = 0, noise: float = 0.0) -> PointCloud:
        """Random points on all parts, uniform by area, including what other parts hide."""
        from petalfit.observations import PointCloud

        rng = np.random.default_rng(seed)
        parts = [*self.parts().values()]
        areas = np.array([float(pose.scale**2 * surface.area()) for pose, surface in parts])
        counts = rng.multinomial(n, areas / areas.sum())
        points, normals = [], []
        for k, (pose, surface) in enumerate(parts):
            if counts[k]:
                cloud = surface.sample(int(counts[k]), seed=seed + k)
                points.append(np.asarray(pose(cloud.points)))
                normals.append(cloud.normals @ np.asarray(pose.rotation).T)
        place = np.concatenate(points)
        return PointCloud(place + noise * rng.standard_normal(place.shape), np.concatenate(normals))


class PartOf(AbstractCarrier):
    """One part of an assembly in the frame of the whole, as a function of all parameters of the assembly.

    Attributes:
        assembly: The assembly.
        number: The number of the part, counted from 0.
    """

    assembly: AbstractAssembly = eqx.field(metadata=WRAPPED)
    number: int = eqx.field(static=True)
    model_field: ClassVar[str] = "assembly"

    @property
    def carried(self) -> AbstractSurface:
        return self._posed[1]

    @property
    def _posed(self) -> tuple[Pose, AbstractSurface]:
        return [*self.assembly.parts().values()][self.number]

    def position(self, u: Array, v: Array) -> Array:
        pose, surface = self._posed
        return pose(surface.position(u, v))
