"""A synthetic case: a petal, how it was observed, and the cloud that results."""

from __future__ import annotations

import dataclasses

import jax
import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from petalfit.components import PeonyPetal
from petalfit.observations import PointCloud, Silhouette
from petalfit.surfaces import sample_uv
from petalfit.synthetic.sight import Sight

# Coordinates are rounded to this many decimals, because the last bits of a surface's points depend on
# the processor and on jax, and files must not. At 1e-6 the rounding is far below any noise.
DECIMALS = 6
# Outliers fill the bounding box of the points, enlarged by this factor.
_STRAY_BOX = 1.5


@dataclasses.dataclass(frozen=True)
class Case:
    """The recipe of a synthetic case.

    Attributes:
        name: The name of the case and of its folder.
        about: One line on the difficulty of the case.
        model: The true petal.
        points: The number of points, outliers included.
        noise: The standard deviation σ of every coordinate, in the unit of length.
        seed: The seed of the points; noise and outliers have streams of their own derived from it.
        keep: (n, offset): only points x of the noise-free surface with n·x > offset are observed; all
            points if None.
        strays: The number of outliers. They are the last points, scattered uniformly over one and a half
            times the bounding box instead of lying near the surface.
        hidden: (u, v): the part of the petal beyond both is not observed; None to observe all of it.
        thinning: The ratio of the density of points at the base to that at the tip.
        turn: The rotation of the cloud about the petal's origin: a vector, by its length in rad.
        shift: The place of the petal's origin after that, in the cloud's unit.
        unit: The length of the petal's unit in the cloud's unit.
        suffix: The suffix of the cloud's file; ".npz" holds float32, all other formats doubles.
        sights: The views that masks are made from; a case of masks alone has no points.
    """

    name: str
    about: str
    model: PeonyPetal
    points: int
    noise: float
    seed: int
    keep: tuple[tuple[float, float, float], float] | None = None
    strays: int = 0
    hidden: tuple[float, float] | None = None
    thinning: float = 1.0
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    unit: float = 1.0
    suffix: str = ".ply"
    sights: tuple[Sight, ...] = ()

    def __post_init__(self) -> None:
        if not 0 <= self.strays < self.points and not (self.sights and self.points == 0):
            raise ValueError(
                f"{self.strays} strays of {self.points} points: some must be true ones"
            )


def make_masks(case: Case) -> list[Silhouette]:
    """The masks of a case, in the order of its sights."""
    return [sight.mask(case.model, case.seed + number) for number, sight in enumerate(case.sights)]


def make(case: Case) -> PointCloud:
    """The cloud of a case: points uniform by area, with noise, followed by the outliers.

    Args:
        case: The recipe.

    Returns:
        Points without normals, as a scanner gives them, in the pose of the case, rounded to `DECIMALS`.
    """
    true = case.points - case.strays
    surface = _seen(case, true)
    noise, strays = (np.random.default_rng([case.seed, stream]) for stream in (1, 2))
    points = surface + case.noise * noise.standard_normal(surface.shape)
    low, high = points.min(axis=0), points.max(axis=0)
    middle, half = 0.5 * (low + high), 0.5 * _STRAY_BOX * (high - low)
    scattered = middle + half * strays.uniform(-1.0, 1.0, (case.strays, 3))
    everything = np.concatenate([points, scattered])
    rotation = Rotation.from_rotvec(case.turn).as_matrix()
    return PointCloud(np.round(case.unit * everything @ rotation.T + case.shift, DECIMALS))


def _seen(case: Case, count: int) -> Float64[np.ndarray, "n 3"]:
    """`count` noise-free points of the observed part of the surface."""
    drawn = count
    while True:
        points = case.model.sample(drawn, seed=case.seed).points
        seen = np.ones(drawn, bool)
        if case.keep is not None:
            normal, offset = case.keep
            seen &= points @ np.array(normal) > offset
        if case.hidden is not None or case.thinning != 1.0:
            with jax.enable_x64(True):
                u, v = sample_uv(case.model, drawn, np.random.default_rng(case.seed)).T
            if case.hidden is not None:
                seen &= ~((u > case.hidden[0]) & (v > case.hidden[1]))
            seen &= np.random.default_rng([case.seed, 3]).random(drawn) < case.thinning**-v
        points = points[seen]
        if len(points) >= count:
            return points[:count]
        if drawn > 1000 * count:
            raise ValueError(f"case {case.name}: hardly anything of the surface is kept")
        drawn *= 2
