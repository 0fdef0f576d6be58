"""Starts of blades: the flattened cloud shows their tip, margins and bending."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from petalfit.compilation import Program
from petalfit.components import BladePetal, parameters
from petalfit.components.blade_petal import bend, profile
from petalfit.fitting.coordinates import with_values
from petalfit.fitting.families.open_surface import CloudStart
from petalfit.fitting.starts.flatten import flatten
from petalfit.fitting.starts.symmetry import onto_mirror_line
from petalfit.surfaces import rotation

OUTLINE = ("width", "widest", "base_width", "tip_width", "base_taper", "tip_taper")
BENDS = (
    "bend",
    "bend_shift",
    "tip_roll",
    "sickle",
    "twist",
    "cup_base",
    "cup_mid",
    "cup_tip",
    "margin_curl",
    "keel",
)
_BENT = 512  # number of points that the bending is fitted to
_STRIPS = 16
_OUTSIDE = 0.02  # quantile of a strip's points at which its margins are taken
_TURNED = (
    "the same way round",
    "turned by an eighth",
    "turned by a quarter",
    "turned by three eighths",
    "base and tip exchanged",
    "turned by five eighths",
    "turned by three quarters",
    "turned by seven eighths",
)
_ROUND = 1.35
# Weight of usual outlines against widths of strips, as parts of the greatest: widths of an end and tapers
# can replace one another.
_USUALLY = 0.2
_HELD_BACK = 0.3  # weight of the prior (typical ranges) against distances in tenths of the length


@dataclasses.dataclass(frozen=True)
class BladeStart(CloudStart):
    """A blade that roughly follows a cloud. The length of its model is the template's.

    Attributes:
        misfit: Root mean square distance of points to their places on the blade, in blade lengths.
        eighth: The number of eighth turns of the flattened cloud that bring its tip up.
        side: The side of the cloud from which the blade is seen, 1 or −1.
        is_round: Whether the flattened cloud is nearly as wide as long, so that its extent does not show
            which way the blade lies.
    """

    misfit: float
    eighth: int
    side: float
    is_round: bool

    def beside(self, other: BladeStart) -> str:
        """Its orientation relative to another start of the same cloud, in words."""
        turned = _TURNED[(self.eighth - other.eighth) % 8]
        return turned if self.side == other.side else f"{turned}, from the other side"


def blade_starts(
    template: BladePetal, free: tuple[str, ...], points: Float[np.ndarray, "n 3"], posed: bool
) -> list[BladeStart]:
    """Starts for the directions in which the tip may lie, and for both sides, the best first.

    Args:
        template: A blade with the values of the parameters that are not free.
        free: Names of the free parameters.
        points: The points of the cloud.
        posed: Whether the pose is fitted; else the blade is in the cloud's frame, up to its size.
    """
    plane = onto_mirror_line(flatten(points))
    narrow, wide = np.sort(plane.std(axis=0)).tolist()
    is_round = wide < _ROUND * narrow
    found = []
    # The axes of a round cloud are chance: the tip may also lie half way between two of them.
    for eighth in range(0, 8, 1 if is_round else 2):
        turn = eighth * np.pi / 4
        s = plane @ [np.cos(turn), np.sin(turn)]
        q = plane @ [np.sin(turn), -np.cos(turn)]
        reach = float(np.ptp(s))
        s, q = (s - s.min()) / reach, q / reach
        q = q - 0.5 * np.sum(np.quantile(q, [_OUTSIDE, 1 - _OUTSIDE]))
        for side in (1.0,) if posed else (1.0, -1.0):
            start = _start(template, free, points, side * q, s, reach, posed)
            label = f"start {len(found) + 1}"
            found.append(BladeStart(*start[:4], label, start[4], eighth, side, is_round))
    return sorted(found, key=lambda start: start.misfit)


def _start(
    template: BladePetal,
    free: tuple[str, ...],
    points: Float[np.ndarray, "n 3"],
    q: Float[np.ndarray, " n"],
    s: Float[np.ndarray, " n"],
    reach: float,
    posed: bool,
) -> tuple[BladePetal, np.ndarray, np.ndarray, float, float]:
    """A blade with rotation, translation, scale and misfit, for one orientation of the flat cloud."""
    length = float(template.length)
    outline = {n: v for n, v in zip(OUTLINE, _outline(q, s), strict=True) if n in free}
    blade = with_values(template, outline)
    flat = np.stack([q, s, np.zeros(len(q))], axis=-1)
    turn, shift = np.eye(3), np.zeros(3)
    if posed:
        # Kabsch's algorithm gives the rotation that brings the flat blade nearest to its points.
        across = (points - points.mean(axis=0)).T @ (flat - flat.mean(axis=0))
        left, _, right = np.linalg.svd(across)
        turn = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
        shift = points.mean(axis=0) - reach * turn @ flat.mean(axis=0)
    # Of fewer points some count twice: another number would be another program.
    some = np.linspace(0, len(points) - 1, _BENT).astype(int)
    typical = np.array([parameters(blade)[name].typical for name in BENDS])
    may = np.isin(BENDS, free).astype(float)
    data = _Bending(
        with_values(blade, {"length": 1.0}),
        turn,
        shift,
        reach,
        np.stack([q, s], axis=-1)[some],
        points[some],
        typical[:, 1],
        np.concatenate([may, np.full(6, float(posed)), [1.0]]),
    )
    step, squares = (np.asarray(x) for x in _bend(data))
    angles = {name: float(step[k]) + float(getattr(blade, name)) for k, name in enumerate(BENDS)}
    angles = {name: value for name, value in angles.items() if name in free}
    size = reach * float(np.exp(step[16]))
    return (
        with_values(blade, angles),
        turn @ np.asarray(rotation(jnp.asarray(step[10:13]))),
        shift + reach * step[13:16],
        size / length,
        float(np.sqrt(squares)),
    )


class _Bending(NamedTuple):
    """The data of the bending's fit: places (q, s) on the flat blade, in lengths, and their points."""

    blade: BladePetal
    turn: Float[Array | np.ndarray, "3 3"]
    shift: Float[Array | np.ndarray, "3"]
    reach: float | Array
    places: Float[Array | np.ndarray, "n 2"]
    points: Float[Array | np.ndarray, "n 3"]
    typical: Float[Array | np.ndarray, "10"]
    active: Float[Array | np.ndarray, "17"]


def _gaps(step: Array, data: _Bending) -> Array:
    """Differences between points and their places on the blade, in blade lengths."""
    step = step * data.active
    angles = {name: getattr(data.blade, name) + step[k] for k, name in enumerate(BENDS)}
    values = vars(data.blade) | angles
    blade = BladePetal(**values)
    places = jnp.asarray(data.places)
    place = bend(blade, places[:, 0], places[:, 1])
    turn = data.turn @ rotation(step[10:13])
    there = jnp.exp(step[16]) * place @ turn.T + step[13:16]
    return jnp.asarray((data.points - data.shift) / data.reach - there)


def _residual(step: Array, data: _Bending) -> Array:
    held_back = _HELD_BACK * step[:10] / data.typical
    return jnp.concatenate([10 * _gaps(step, data).ravel(), held_back, 0.01 * step[10:]])


def _best_bending(data: _Bending) -> tuple[Array, Array]:
    solution = optx.least_squares(
        _residual,
        optx.LevenbergMarquardt(rtol=1e-3, atol=1e-3, linear_solver=lx.Normal(lx.Cholesky())),
        jnp.zeros(17),
        data,
        max_steps=40,
        throw=False,
    )
    step = jnp.where(jnp.isfinite(solution.value).all(), solution.value, 0.0) * data.active
    return step, jnp.mean(jnp.sum(_gaps(step, data) ** 2, axis=-1))


_bend = Program(_best_bending)


def compile_bending(template: BladePetal, free: tuple[str, ...]) -> None:
    """Compiles the fit of the bending, by a blade that lies where it should."""
    # Programs depend on the types of leaves: the outline of a start is in doubles, its size in floats.
    outline = {name: np.float64(getattr(template, name)) for name in OUTLINE if name in free}
    blade = with_values(with_values(template, outline), {"length": 1.0})
    flat, nowhere = np.zeros((_BENT, 2)), np.zeros((_BENT, 3))
    held = np.ones(10), np.zeros(17)
    _bend(_Bending(blade, np.eye(3), np.zeros(3), 1.0, flat, nowhere, *held))


def _outline(q: Float[np.ndarray, " n"], s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "6"]:
    """Width, position of the widest part, widths of the ends and tapers, from the widths of strips."""
    from scipy.optimize import least_squares

    edges = np.linspace(0, 1, _STRIPS + 1)
    strip = np.clip(np.searchsorted(edges, s, side="right") - 1, 0, _STRIPS - 1)
    place, width = [], []
    for k in range(_STRIPS):
        inside = q[strip == k]
        if len(inside) >= 4:
            place.append(0.5 * (edges[k] + edges[k + 1]))
            margins = np.quantile(inside, [_OUTSIDE, 1 - _OUTSIDE])
            width.append(float(np.ptp(margins)) / (1 - 2 * _OUTSIDE))
    v, w = np.array(place), np.array(width)

    def excess(p: np.ndarray) -> np.ndarray:
        greatest, widest, base, tip, base_taper, tip_taper = p
        shape = profile(v, widest, (base, tip), (base_taper, tip_taper), np)
        usual = _USUALLY * (p[1:] - [0.5, 0.2, 0.2, 0.8, 0.8])
        return np.concatenate([greatest * shape / w.max() - w / w.max(), usual])

    start = [w.max(), np.clip(v[np.argmax(w)], 0.15, 0.85), 0.2, 0.2, 0.8, 0.8]
    low = [0.2 * w.max(), 0.1, 0.005, 0.005, 0.2, 0.2]
    high = [2.0 * w.max(), 0.9, 0.98, 0.98, 4.0, 4.0]
    return least_squares(excess, start, bounds=(low, high), max_nfev=60).x
