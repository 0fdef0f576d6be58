"""The family of blades: a lamina that is bent, cupped and twisted, in any pose."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar, cast

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from petalfit.compilation import prepared
from petalfit.components import BladePetal, Posed, bare
from petalfit.fitting.families.blade.start import BladeStart, blade_starts, compile_bending
from petalfit.fitting.families.open_surface import CloudStart, OpenSurfaceFamily, turned_over
from petalfit.fitting.solver.iterate import Iterate
from petalfit.surfaces import AbstractSurface, position_and_tangents


class BladeFamily(OpenSurfaceFamily):
    """The family of blades; the flattened cloud shows their base, tip and bending."""

    kind: ClassVar[type[AbstractSurface]] = BladePetal
    gauges: ClassVar[Mapping[str, tuple[str, ...]]] = {"similarity": ("length",)}
    is_petal: ClassVar[bool] = True
    # Fewer do not show widths of strips, in which the search for a start begins.
    fewest: ClassVar[int | None] = 64
    late: ClassVar[tuple[str, ...]] = ("tip_edge", "base_edge")
    depth: ClassVar[tuple[str, ...]] = (
        "bend",
        "bend_shift",
        "tip_roll",
        "twist",
        "cup_base",
        "cup_mid",
        "cup_tip",
        "margin_curl",
        "keel",
    )

    def starts(
        self,
        template: AbstractSurface,
        free: tuple[str, ...],
        points: Float[np.ndarray, "n 3"],
        pose: str,
    ) -> Sequence[BladeStart]:
        found = blade_starts(cast(BladePetal, template), free, points, pose != "known")
        return [start.scaled("length", pose) for start in found]

    def foresee(
        self, template: AbstractSurface, free: tuple[str, ...], pose: str
    ) -> tuple[Callable[[], None], ...]:
        blade = cast(BladePetal, template)
        others = super().foresee(template, free, pose)
        return (*others, prepared(lambda: compile_bending(blade, free)))

    def the_other_way(self, posed: Posed) -> Posed:
        blade = cast(BladePetal, posed.surface)
        place, tangents = position_and_tangents(posed, jnp.zeros(1), jnp.ones(1))
        (tip,) = np.asarray(place, np.float64)
        across, along = -np.asarray(tangents, np.float64)[:, 0]
        along = along / np.linalg.norm(along)
        across = across - along * (across @ along)
        across = across / np.linalg.norm(across)
        turned = np.stack([across, along, np.cross(across, along)], axis=-1)
        scale = np.float64(posed.placement.scale)
        return Posed(blade.reversed(), turned, tip, scale)

    def is_usual_way(self, model: AbstractSurface) -> bool:
        """Most petals are widest beyond the middle of their length."""
        return float(cast(BladePetal, bare(model)).widest) >= 0.5

    def followed(self, starts: Sequence[CloudStart]) -> Sequence[CloudStart]:
        """Both ends of a long blade; of one as wide as long, every direction."""
        best, *_ = found = cast(Sequence[BladeStart], starts)
        return found if best.is_round else super().followed(found)

    def labels(self, starts: Sequence[CloudStart]) -> list[str]:
        best, *_ = found = cast(Sequence[BladeStart], starts)
        return [start.beside(best) for start in found]

    def standard_form(self, end: Iterate, names: tuple[str, ...]) -> Iterate:
        """The end with the hollow side of the blade up; the other side gives the same blade in space.

        Bend and mean cup both count, so that the sides of few blades are nearly alike.
        """
        blade = cast(BladePetal, bare(end.model))
        # Simpson's rule is exact for the cup, which is a quadratic polynomial.
        cup = float(blade.cup_base + 4 * blade.cup_mid + blade.cup_tip) / 6
        if float(blade.bend) + cup >= 0:
            return end
        return turned_over(end, names, blade.turned_over(), BladePetal.sided)
