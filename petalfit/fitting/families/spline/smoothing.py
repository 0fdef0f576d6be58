"""Fit of a smoothed spline surface: linear solves for coefficients between searches for foot points."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.spatial import KDTree

from petalfit.compilation import pad_to
from petalfit.components import SplinePetal
from petalfit.components.spline_petal import SEGMENTS, basis
from petalfit.fitting.likelihood import programs
from petalfit.fitting.likelihood.cloud import ObservedCloud, pad
from petalfit.fitting.likelihood.foot_points import (
    distances_beside,
    guess_foot_points,
)
from petalfit.fitting.likelihood.mixture import Mixture
from petalfit.fitting.likelihood.quadrature import areas_around
from petalfit.fitting.likelihood.scales import spacing
from petalfit.fitting.outliers.loss import AbstractBackground
from petalfit.fitting.outliers.scan import Scan
from petalfit.fitting.solver.observer import report, show
from petalfit.fitting.starts.flatten import flatten
from petalfit.fitting.starts.frame import NormalisedFrame
from petalfit.residuals import TangentDistance
from petalfit.surfaces import Pose

_SHAPE = (SEGMENTS[0] + 3, SEGMENTS[1] + 3)
_COUNT = _SHAPE[0] * _SHAPE[1]
_ROUNDS = 14
_CLEARINGS = 3  # additional rounds among clutter
# The weight of bending falls from the first round to the last, as powers of ten.
_STIFF, _LIMP = -3.3, -5.5
_NODES = 33  # nodes per side at which the surface must lie near points
_SLACK = 1.2  # distance of a node from all points that costs nothing, in spacings of the points
_TIED = 1e-4  # weight that keeps coefficients in place in directions that no distance determines
_LENGTH = 10.0  # length of a model whose unit is free
_STRIPS = 24


class Smoothed(NamedTuple):
    """A spline surface that was fitted to a cloud.

    Attributes:
        control: Coefficients, as places in the cloud's normalised frame, shape (k, 3).
        mixture: The probability of each point to belong to the surface; None if all belong to it.
        freedom: Effective number of parameters of the smoothed coefficients.
        rounds: The number of iterations.
    """

    control: Float[np.ndarray, "k 3"]
    mixture: Mixture | None
    freedom: float
    rounds: int


def smooth(scan: Scan) -> Smoothed:
    """Fits a spline surface to a cloud; its coefficients are smoothed less and less."""
    own, mass = scan.points, scan.weights
    inside, mixture = scan.likely, None
    report("flattening the cloud")
    sheet = _Points(own[inside], mass[inside])
    uv = _rectangle(flatten(sheet.points))
    rows = _rows(uv)
    bending = _bending()
    start = rows.T @ (sheet.weights[:, None] * rows)
    start += np.sum(sheet.weights) * 1e-3 * bending + 1e-9 * np.eye(_COUNT)
    control = np.linalg.solve(start, rows.T @ (sheet.weights[:, None] * sheet.points))
    rounds = _ROUNDS if scan.background is None else _ROUNDS + _CLEARINGS
    freedom = 0.0
    for number in range(rounds):
        if number >= _ROUNDS and scan.background is not None:
            report("searching for outliers")
            mixture = _mixture(control, scan, scan.background)
            inside = mixture.members > 0.5
            sheet = _Points(own[inside], (mass * mixture.members)[inside])
            near = guess_foot_points(_surface(control), sheet.padded)
            uv = np.asarray(near)[: len(sheet.points)]
        report(f"smoothing less and less, round {number + 1} of {rounds}")
        stiffness = 10 ** np.interp(number / _ROUNDS, [0.0, 0.7], [_STIFF, _LIMP])
        uv, system = sheet.system(control, uv, stiffness * bending, 4 if number == 0 else 2)
        control = system.solved()
        show(_surface(control), [sheet.at(uv)])
        if number + 1 == rounds:
            freedom = system.freedom()
    return Smoothed(control, mixture, freedom, rounds)


def _mixture(
    control: Float[np.ndarray, "k 3"], scan: Scan, background: AbstractBackground
) -> Mixture:
    """The mixture of points that belong to the surface of given coefficients, and others."""
    surface = _surface(control)
    distance, beyond, _ = distances_beside(surface, scan.points)
    return background.mixture(surface, distance, beyond, scan.weights, scan.noise)


def _surface(control: Float[np.ndarray, "k 3"]) -> SplinePetal:
    """The surface of coefficients that are places, not offsets."""
    zero = np.float64(0.0)
    return SplinePetal(a_x=zero, b_y=zero, c_z=zero, offsets=control.reshape(*_SHAPE, 3))


class _Points:
    """A cloud, with the equations for the coefficients that it gives."""

    def __init__(self, points: Float[np.ndarray, "n 3"], weights: Float[np.ndarray, " n"]) -> None:
        self.points, self.weights = points, weights
        self.cloud = ObservedCloud(pad(points, weights, None))
        self.tree = KDTree(points)
        self.slack = _SLACK * spacing(self.tree)
        side = np.linspace(0, 1, _NODES)
        nodes = np.stack(np.meshgrid(side - 0.5, side, indexing="ij"), axis=-1).reshape(-1, 2)
        self.nodes = _rows(nodes)

    def system(
        self,
        control: Float[np.ndarray, "k 3"],
        uv: Float[np.ndarray, "n 2"],
        stiffness: Float[np.ndarray, "k k"],
        iterations: int,
    ) -> tuple[Float[np.ndarray, "n 2"], _System]:
        """Foot points on the surface of given coefficients, and the equations for new coefficients."""
        surface, n = _surface(control), len(self.points)
        uv = np.asarray(programs.refine(surface, self.padded, self._padded(uv), iterations))
        here = programs.frames(surface, jnp.asarray(uv))
        uv = uv[:n]
        normal, position, conormals, left = (
            np.asarray(x)[:n] for x in (here.normal, here.position, here.conormals, here.left)
        )
        rows, total = _rows(uv), float(np.sum(self.weights))
        system = _System(control, total, stiffness, rows)
        system.add(rows, normal, np.sum(normal * self.points, axis=1), self.weights)
        beyond = np.einsum("nij,nj->ni", conormals, self.points - position) - left
        for edge in range(2):
            on = (left[:, edge] < 1e-9) & (beyond[:, edge] > 0)
            along = conormals[on, edge]
            system.add(rows[on], along, np.sum(along * self.points[on], axis=1), self.weights[on])
        self._add_emptiness(system, control, total)
        return uv, system

    @property
    def padded(self) -> Float[Array, "m 3"]:
        """The points of the padded cloud."""
        return self.cloud.data.points

    def at(self, uv: Float[np.ndarray, "n 2"]) -> TangentDistance:
        """The term of the cloud with these foot points."""
        return self.cloud.at(self._padded(uv))

    def _padded(self, uv: Float[np.ndarray, "n 2"]) -> Float[Array, "m 2"]:
        return jnp.asarray(pad_to(uv, len(self.padded)))

    def _add_emptiness(
        self, system: _System, control: Float[np.ndarray, "k 3"], total: float
    ) -> None:
        """Adds equations that draw nodes far from all points to the nearest point."""
        places = self.nodes @ control
        area = areas_around(places.reshape(_NODES, _NODES, 3)).ravel()
        gap, nearest = map(np.asarray, self.tree.query(places))
        far = gap > self.slack
        there = self.points[nearest[far]]
        away = (places[far] - there) / gap[far, None]
        target = np.sum(away * there, axis=1) + self.slack
        system.add(self.nodes[far], away, target, total * area[far] / area.sum())


class _System:
    """Normal equations of all three coordinates of all coefficients."""

    def __init__(
        self,
        control: Float[np.ndarray, "k 3"],
        total: float,
        stiffness: Float[np.ndarray, "k k"],
        rows: Float[np.ndarray, "n k"],
    ) -> None:
        tied = total * _TIED * (rows.mean(axis=0) + 1e-3)
        self.matrix = np.kron(total * stiffness + np.diag(tied), np.eye(3))
        self.right = (tied[:, None] * control).ravel()
        self.held = self.matrix.copy()

    def add(
        self,
        rows: Float[np.ndarray, "m k"],
        directions: Float[np.ndarray, "m 3"],
        target: Float[np.ndarray, " m"],
        weights: Float[np.ndarray, " m"],
    ) -> None:
        """Adds equations: places (`rows` of coefficients) should have `target` along `directions`."""
        root = np.sqrt(weights)
        slopes = rows[:, :, None] * directions[:, None, :] * root[:, None, None]
        slopes = slopes.reshape(len(rows), 3 * rows.shape[1])
        self.matrix += slopes.T @ slopes
        self.right += slopes.T @ (target * root)

    def freedom(self) -> float:
        """Effective number of parameters: the trace of the matrix from given to fitted positions."""
        return len(self.matrix) - float(np.trace(np.linalg.solve(self.matrix, self.held)))

    def solved(self) -> Float[np.ndarray, "k 3"]:
        return np.linalg.solve(self.matrix, self.right).reshape(-1, 3)


def _rows(uv: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n k"]:
    """The weight of every coefficient at given places."""
    first = (uv[:, 0] + 0.5, SEGMENTS[0]), (uv[:, 1], SEGMENTS[1])
    (i, across), (j, along) = (map(np.asarray, basis(jnp.asarray(x), n)) for x, n in first)
    rows = np.zeros((len(uv), *_SHAPE))
    number = np.arange(len(uv))
    for k in range(4):
        for m in range(4):
            rows[number, i + k, j + m] = across[:, k] * along[:, m]
    return rows.reshape(len(uv), -1)


def _bending() -> Float[np.ndarray, "k k"]:
    """The matrix of the sum of squared second differences of the coefficients."""

    def squares(n: int, times: int) -> np.ndarray:
        step = np.diff(np.eye(n), times, axis=0)
        return step.T @ step

    (m, n), eye = _SHAPE, np.eye
    return (
        np.kron(squares(m, 2), eye(n))
        + np.kron(eye(m), squares(n, 2))
        + 2 * np.kron(squares(m, 1), squares(n, 1))
    )


def _rectangle(plane: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """(u, v) of flattened points: v runs along the longer axis, u between the margins at that v."""
    q, s = plane[:, 1], plane[:, 0]
    v = (s - s.min()) / np.ptp(s)
    place, low, high = [], [], []
    for middle in np.linspace(0, 1, _STRIPS):
        strip = q[np.abs(v - middle) < 1.1 / _STRIPS]
        if len(strip) >= 6:
            place.append(middle)
            low.append(strip.min())
            high.append(strip.max())
    left, right = (np.interp(v, place, margin) for margin in (low, high))
    u = (q - left) / np.maximum(right - left, 1e-3 * np.ptp(s)) - 0.5
    return np.stack([np.clip(u, -0.5, 0.5), v], axis=-1)


def in_own_frame(
    control: Float[np.ndarray, "k 3"], frame: NormalisedFrame, pose: str
) -> tuple[SplinePetal, Pose]:
    """The petal with offsets from the rectangle nearest to the surface, and that rectangle's pose."""
    control = _base_first(control.reshape(*_SHAPE, 3))
    # Coefficients by which the spline represents u and v themselves.
    u, v = ((np.arange(n) - 1) / segments for n, segments in zip(_SHAPE, SEGMENTS, strict=True))
    u = u - 0.5
    inner = control[1:-1, 1:-1]
    across = np.tensordot(u[1:-1], inner - inner.mean(axis=0), (0, 0)).mean(axis=0)
    along = np.tensordot(v[1:-1] - 0.5, inner - inner.mean(axis=(0, 1)), (0, 1)).mean(axis=0)
    across, along = across / np.sum(u[1:-1] ** 2), along / np.sum((v[1:-1] - 0.5) ** 2)
    middle = inner.mean(axis=(0, 1))
    rotation, size, place = frame.axes, frame.unit, frame.centre
    if pose == "known":
        control = size * control @ rotation.T + place
        offsets = control
        scale, turn, origin = 1.0, np.eye(3), np.zeros(3)
        a_x = size * float(np.linalg.norm(across))
        b_y = size * float(np.linalg.norm(along))
    else:
        left, _, right = np.linalg.svd(np.stack([across, along], axis=1), full_matrices=False)
        axes = left @ right
        own = np.column_stack([axes, np.cross(axes[:, 0], axes[:, 1])])
        start = middle - 0.5 * along
        unit = size if pose == "rigid" else _LENGTH / float(np.linalg.norm(along))
        offsets = unit * (control - start) @ own
        a_x, b_y = unit * float(np.linalg.norm(across)), unit * float(np.linalg.norm(along))
        scale, turn, origin = size / unit, rotation @ own, size * rotation @ start + place
    flat = np.zeros_like(offsets)
    flat[..., 0], flat[..., 1] = a_x * u[:, None], b_y * v[None, :]
    return SplinePetal(a_x, b_y, 0.0, offsets - flat), Pose(turn, origin, scale)


def _base_first(control: Float[np.ndarray, "m n 3"]) -> Float[np.ndarray, "m n 3"]:
    """The coefficients in the order in which the narrower end is at v = 0, and the hollow side up."""
    widths = np.linalg.norm(control[-2] - control[1], axis=-1)
    if widths[1:3].sum() > widths[-3:-1].sum():
        control = control[:, ::-1]
    # Once the base is fixed, exchanging the sides turns the normal over.
    across, along = control[-2] - control[1], np.gradient(control, axis=1).mean(axis=0)
    up = np.cross(across, along).mean(axis=0)
    rise = (0.5 * (control[1] + control[-2]) - control[_SHAPE[0] // 2]).mean(axis=0)
    return control if rise @ up >= 0 else control[::-1]
