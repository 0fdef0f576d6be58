"""The flower: a tree of posed, named organs, differentiable by each of its numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from petalfit.colours import Colour
from petalfit.components import AbstractAssembly, Pedicel
from petalfit.flowers.attachment import Attachment
from petalfit.flowers.phyllotaxis import Arrangement
from petalfit.surfaces import AbstractSurface, Pose

Values: TypeAlias = float | np.ndarray


class Series(eqx.Module):
    """The k organs of one kind: the petals, the stamens or the pistils.

    Every leaf of `organ` and of `attachment` has shape (k,), one value per organ.

    Attributes:
        name: The name of one organ; "petal" gives petal_1 to petal_k.
        organ: A component, or an assembly of several, with stacked leaves.
        attachment: The place and the orientation of each organ on the receptacle.
        colours: The colours by the name of the part; a component has one part, named "".
    """

    name: str = eqx.field(static=True)
    organ: AbstractSurface
    attachment: Attachment
    colours: dict[str, Colour]

    @classmethod
    def of(
        cls,
        name: str,
        organ: AbstractSurface | Sequence[AbstractSurface],
        arrangement: Arrangement,
        colours: Colour | Mapping[str, Colour],
        **attachment: Values,
    ) -> Series:
        """A series of organs in an arrangement.

        Args:
            name: The name of one organ.
            organ: One organ for all places, or a sequence with one for each place.
            arrangement: The places of the organs around the axis.
            colours: One colour for all parts, or colours by the name of the part.
            attachment: Fields of `Attachment`, each a number for all organs or an array of shape (k,).

        Raises:
            ValueError: The number of organs or of values differs from that of the places, or a part has
                no colour.
        """
        k = len(arrangement)
        each = [organ] * k if isinstance(organ, AbstractSurface) else [*organ]
        if len(each) != k:
            raise ValueError(f"{name}: {len(each)} organs for {k} places")
        stacked = jax.tree.map(lambda *leaves: np.array(leaves, np.float64), *each)
        given = {"azimuth": arrangement.azimuth} | attachment
        for field, values in given.items():
            if np.ndim(values) and np.shape(values) != (k,):
                raise ValueError(f"{name}: {np.size(values)} values of {field} for {k} places")
        default = Attachment()
        rows = [np.full(k, given.get(field, getattr(default, field)), np.float64)
                for field in vars(default)]  # fmt: skip
        places = jax.tree.unflatten(jax.tree.structure(default), rows)
        parts = _part_names(each[0])
        if isinstance(colours, Colour):
            colours = {short(part): colours for part in parts}
        if missing := {short(part) for part in parts} - set(colours):
            raise ValueError(f"{name}: no colour for {', '.join(sorted(missing))}")
        return cls(name, stacked, places, dict(colours))

    def __len__(self) -> int:
        return len(self.attachment.azimuth)  # pyright: ignore[reportArgumentType]

    @property
    def part_names(self) -> list[str]:
        """The names of the parts of one organ; [""] if it is a single surface."""
        return _part_names(self.one(0))

    @property
    def names(self) -> list[str]:
        """The names of all organs, numbered from 1 unless there is only one."""
        if len(self) == 1:
            return [self.name]
        return [f"{self.name}_{k + 1}" for k in range(len(self))]

    def one(self, k: int) -> AbstractSurface:
        """The organ with number k, counted from 0."""
        return jax.tree.map(lambda leaf: leaf[k], self.organ)


def _part_names(organ: AbstractSurface) -> list[str]:
    return [*organ.parts()] if isinstance(organ, AbstractAssembly) else [""]


def short(part: str) -> str:
    """The last name in the path of a part, by which its colour is found."""
    return part.rpartition("/")[2]


RECEPTACLE, PEDICEL = -1, -2


class Part(eqx.Module):
    """The same part of all k organs of a series.

    Attributes:
        series: The number of the series; −1 for the receptacle and −2 for the pedicel.
        name: The name of the part within its organ; "" if the organ is a single surface.
        surface: The surface, its leaves of shape (k,).
        inner: The poses from the part's frame to the organ's; leaves of shape (k, ...).
        outer: The poses from the organ's frame to the flower's; leaves of shape (k, ...).
    """

    series: int = eqx.field(static=True)
    name: str = eqx.field(static=True)
    surface: AbstractSurface
    inner: Pose
    outer: Pose

    @property
    def label(self) -> str:
        """The name of a part that belongs to no series: "receptacle" or "pedicel"."""
        return "receptacle" if self.series == RECEPTACLE else "pedicel"


class Flower(eqx.Module):
    """A flower: a receptacle on a pedicel, with series of organs on it. It grows along +y.

    A flower is a pytree: `jax.grad` of a scalar function of it gives the derivatives by every number of
    every organ.

    Attributes:
        name: The name of the flower, for instance "lily".
        receptacle: The surface that organs stand on; its u is their latitude, its v their azimuth.
        pedicel: The stalk, which ends where the receptacle begins; None for no pedicel.
        series: The series of organs, from outside to inside.
        colours: The colours of "receptacle" and "pedicel".
    """

    name: str = eqx.field(static=True)
    receptacle: AbstractSurface
    pedicel: Pedicel | None
    series: tuple[Series, ...]
    colours: dict[str, Colour]

    def __check_init__(self) -> None:
        names = [series.name for series in self.series]
        if len(set(names) | {"receptacle", "pedicel"}) != len(names) + 2:
            raise ValueError(f"names of organs must differ; received {', '.join(names)}")

    def parts(self) -> list[Part]:
        """All surfaces of the flower, with the same part of all organs of a series in one `Part`."""
        one = Pose(jnp.eye(3)[None], jnp.zeros((1, 3)), jnp.ones(1))
        found = [Part(RECEPTACLE, "", _batch(self.receptacle), one, one)]
        if self.pedicel is not None:
            bottom = self.receptacle.position(jnp.asarray(-0.5 * np.pi), jnp.zeros(()))
            top = self.pedicel.position(jnp.zeros(()), jnp.ones(()))[1]
            below = Pose(one.rotation, (bottom - jnp.array([0.0, 1.0, 0.0]) * top)[None], one.scale)
            found.append(Part(PEDICEL, "", _batch(self.pedicel), one, below))
        for number, series in enumerate(self.series):
            outer = jax.vmap(lambda place: place.pose(self.receptacle))(series.attachment)
            if not isinstance(series.organ, AbstractAssembly):
                inner = jax.vmap(_on_its_base)(series.organ)
                found.append(Part(number, "", series.organ, inner, outer))
                continue
            for name, (inner, surface) in jax.vmap(_broadcast_parts)(series.organ).items():
                found.append(Part(number, name, surface, inner, outer))
        return found

    def points(self, resolution: tuple[int, int] = (9, 9)) -> Float[Array, "n 3"]:
        """Points of all surfaces in the flower's frame, on a grid of each domain.

        Args:
            resolution: The numbers of points along u and along v, at least 2 each.
        """
        found = []
        for part in self.parts():
            u, v = (
                jnp.linspace(*side, n)
                for side, n in zip(part.surface.domain, resolution, strict=True)
            )

            def place(
                surface: AbstractSurface, inner: Pose, outer: Pose, u: Array = u, v: Array = v
            ) -> Array:
                return (outer @ inner)(surface(u[:, None], v[None, :]))

            found.append(jax.vmap(place)(part.surface, part.inner, part.outer).reshape(-1, 3))
        return jnp.concatenate(found)

    def colour(self, part: Part) -> Colour:
        """The colour of one of the flower's parts."""
        if part.series < 0:
            return self.colours[part.label]
        return self.series[part.series].colours[short(part.name)]


def _batch(surface: AbstractSurface) -> AbstractSurface:
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, float)[None], surface)


def _on_its_base(surface: AbstractSurface) -> Pose:
    """The pose that moves the middle of a petal's base to the origin, where other organs have it."""
    if not all(surface.edges):
        return jax.tree.map(lambda leaf: jnp.asarray(leaf, float), Pose.identity())
    base = surface.position(*map(jnp.asarray, surface.domain.base))
    return jax.tree.map(jnp.asarray, Pose(jnp.eye(3), -base, 1.0))


def _broadcast_parts(organ: AbstractAssembly) -> dict[str, tuple[Pose, AbstractSurface]]:
    """The parts of an organ with arrays as leaves, which vmap needs."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, float), organ.parts())
