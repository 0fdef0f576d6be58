"""A flower: a tree of posed, named organs, whose numbers can all be varied and differentiated by."""

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
    """Organs of one kind: the petals, the stamens, a pistil.

    Every leaf of `organ` and of `attachment` has shape (k,), one value an organ.

    Attributes:
        name: Of one of them; `petal` makes petal_1 to petal_k.
        organ: A component, or an assembly of several.
        attachment: How each stands on the receptacle.
        colours: By the name of the part; by "" for a component.
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
        """Organs in an arrangement.

        Args:
            name: Of one of them.
            organ: One for all, or one each.
            arrangement: Where they stand around the axis.
            colours: One for all parts, or by the name of the part.
            attachment: Fields of `Attachment`, a number for all or an array of one each.

        Raises:
            ValueError: There are as many organs or values as there are places.
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
        """Of the surfaces that one organ has."""
        return _part_names(self.one(0))

    @property
    def names(self) -> list[str]:
        """Of every organ: numbered from 1 unless there is only one."""
        if len(self) == 1:
            return [self.name]
        return [f"{self.name}_{k + 1}" for k in range(len(self))]

    def one(self, k: int) -> AbstractSurface:
        """The organ of that number, counted from 0."""
        return jax.tree.map(lambda leaf: leaf[k], self.organ)


def _part_names(organ: AbstractSurface) -> list[str]:
    return [*organ.parts()] if isinstance(organ, AbstractAssembly) else [""]


def short(part: str) -> str:
    """The last name of a part's path, which its colour goes by."""
    return part.rpartition("/")[2]


RECEPTACLE, PEDICEL = -1, -2


class Part(eqx.Module):
    """One surface of every organ of a series.

    Attributes:
        series: Number of the series, −1 for the receptacle and −2 for the pedicel.
        name: Of the part within its organ, "" if the organ is nothing else.
        surface: With leaves of shape (k,).
        inner: From the part's frame to the organ's; leaves of shape (k, ...).
        outer: From the organ's frame to the flower's; leaves of shape (k, ...).
    """

    series: int = eqx.field(static=True)
    name: str = eqx.field(static=True)
    surface: AbstractSurface
    inner: Pose
    outer: Pose

    @property
    def label(self) -> str:
        """Of what belongs to no series."""
        return "receptacle" if self.series == RECEPTACLE else "pedicel"


class Flower(eqx.Module):
    """A receptacle on a pedicel, and the series of organs on it; it grows along +y.

    A pytree: `jax.grad` of a scalar of it has the derivative by every number of every organ.

    Attributes:
        name: What it is.
        receptacle: Its surface's u is the latitude of attachments, its v their azimuth.
        pedicel: Ends where the receptacle begins; None for no pedicel.
        series: From outside to inside.
        colours: Of "receptacle" and "pedicel".
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
        """Every surface of the flower, those of one kind of organ together."""
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
            resolution: Number of points along u and along v, at least 2 each.
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
        """Of one of its parts."""
        if part.series < 0:
            return self.colours[part.label]
        return self.series[part.series].colours[short(part.name)]


def _batch(surface: AbstractSurface) -> AbstractSurface:
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, float)[None], surface)


def _on_its_base(surface: AbstractSurface) -> Pose:
    """Puts the middle of a petal's base at the origin, where other organs have theirs."""
    if not all(surface.edges):
        return jax.tree.map(lambda leaf: jnp.asarray(leaf, float), Pose.identity())
    (u_low, u_high), (v_low, _) = surface.domain
    base = surface.position(jnp.asarray(0.5 * (u_low + u_high)), jnp.asarray(v_low))
    return jax.tree.map(jnp.asarray, Pose(jnp.eye(3), -base, 1.0))


def _broadcast_parts(organ: AbstractAssembly) -> dict[str, tuple[Pose, AbstractSurface]]:
    """Parts with arrays for leaves, as vmap wants them."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, float), organ.parts())
