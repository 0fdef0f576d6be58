"""One case: a petal, how it was seen, and the cloud that follows from both."""

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

# Coordinates are rounded to this many decimals: the last bits of a surface's points depend on the
# processor and on jax, and files must not. At 1e-6 the rounding is far below any noise.
DECIMALS = 6
# Strays fill the bounding box of the points, enlarged by this factor.
_STRAY_BOX = 1.5


@dataclasses.dataclass(frozen=True)
class Case:
    """What a cloud is made from.

    Attributes:
        name: Of its folder.
        about: One line: what is hard about it.
        model: The truth.
        points: Number of points, strays included.
        noise: Standard deviation σ of every coordinate, in the unit of length.
        seed: Of the points; noise and strays have streams of their own derived from it.
        keep: (n, offset): only points x of the noise-free surface with n·x > offset are seen; all
            of them if None.
        strays: How many of the points, the last ones, are scattered uniformly over one and a half
            times the bounding box instead of lying near the surface.
        hidden: (u, v): nothing is seen of the part of the petal beyond both; all of it if None.
        thinning: How many times denser the points lie at the base than at the tip.
        turn: Rotation of the cloud about the petal's origin: a vector, by its length in rad.
        shift: Where the origin is then, in the cloud's unit.
        unit: Length of the petal's unit in the cloud's.
        suffix: Of the cloud's file; ".npz" holds float32, everything else doubles.
        sights: Masks; a case of masks alone has no points.
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
    """The cloud of a case: area-uniform points, noise, strays, in this order.

    Args:
        case: The recipe.

    Returns:
        Points without normals, as a scanner gives them, rounded to `DECIMALS`, wherever the case puts
        them.
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
    """Noise-free points, as many as wanted, of the part of the surface that is seen."""
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
