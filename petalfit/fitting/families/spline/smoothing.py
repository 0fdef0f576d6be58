"""Fit of a smoothed spline surface: linear solves for coefficients between searches for foot points."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from petalfit.components import SplinePetal
from petalfit.components.spline_petal import SEGMENTS
from petalfit.fitting.families.spline.equations import (
    COUNT,
    SHAPE,
    Equations,
    bending,
    rows_at,
    surface_of,
)
from petalfit.fitting.families.spline.posterior import Posterior, posterior_of
from petalfit.fitting.inference.coverage import reached_from_the_edge
from petalfit.fitting.likelihood.cloud import ObservedCloud
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
from petalfit.residuals import Data, TangentDistance, frames, refine_foot_points
from petalfit.surfaces import Pose

_ROUNDS = 14
_CLEARINGS = 3  # additional rounds among clutter
# The weight of bending falls from the first round to the last, as powers of ten.
_STIFF, _LIMP = -3.3, -5.5
_NODES = 33  # nodes per side at which the surface must lie near points
_SLACK = 1.2  # distance of a node from all points that costs nothing, in spacings of the points
_BESIDE = 16  # points beside a node, among which the nearest one is looked for
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
        posterior: What is known of the coefficients.
    """

    control: Float[np.ndarray, "k 3"]
    mixture: Mixture | None
    freedom: float
    rounds: int
    posterior: Posterior


def smooth(scan: Scan) -> Smoothed:
    """Fits a spline surface to a cloud; its coefficients are smoothed less and less."""
    own, mass = scan.points, scan.weights
    inside, mixture = scan.likely, None
    report("flattening the cloud")
    sheet = _Points(own[inside], mass[inside])
    uv = _rectangle(flatten(sheet.points))
    rows = rows_at(uv)
    bent = bending()
    start = rows.T @ (sheet.weights[:, None] * rows)
    start += np.sum(sheet.weights) * 1e-3 * bent + 1e-9 * np.eye(COUNT)
    control = np.linalg.solve(start, rows.T @ (sheet.weights[:, None] * sheet.points))
    rounds = _ROUNDS if scan.background is None else _ROUNDS + _CLEARINGS
    freedom = 0.0
    for number in range(rounds):
        if number >= _ROUNDS and scan.background is not None:
            report("searching for outliers")
            mixture = _mixture(control, scan, scan.background)
            inside = mixture.members > 0.5
            sheet = _Points(own[inside], (mass * mixture.members)[inside])
            uv = guess_foot_points(surface_of(control), sheet.points)
        report(f"smoothing less and less, round {number + 1} of {rounds}")
        stiffness = 10 ** np.interp(number / _ROUNDS, [0.0, 0.7], [_STIFF, _LIMP])
        uv, system = sheet.system(control, uv, stiffness * bent, 4 if number == 0 else 2)
        control = system.solved()
        show(surface_of(control), [sheet.at(uv)])
        if number + 1 == rounds:
            freedom = system.freedom()
    posterior = posterior_of(
        sheet.points, sheet.weights, control, uv, 10**_LIMP * bent, freedom, sheet.spacing
    )
    return Smoothed(posterior.control, mixture, freedom, rounds, posterior)


def _mixture(
    control: Float[np.ndarray, "k 3"], scan: Scan, background: AbstractBackground
) -> Mixture:
    """The mixture of points that belong to the surface of given coefficients, and others."""
    surface = surface_of(control)
    distance, beyond, _ = distances_beside(surface, scan.points)
    return background.mixture(surface, distance, beyond, scan.weights, scan.noise)


class _Points:
    """A cloud, with the equations for the coefficients that it gives."""

    def __init__(self, points: Float[np.ndarray, "n 3"], weights: Float[np.ndarray, " n"]) -> None:
        self.points, self.weights = points, weights
        self.cloud = ObservedCloud(Data.of(points, weights, None))
        self.spacing = spacing(KDTree(points))
        side = np.linspace(0, 1, _NODES)
        nodes = np.stack(np.meshgrid(side - 0.5, side, indexing="ij"), axis=-1).reshape(-1, 2)
        self.node_uv, self.nodes = nodes, rows_at(nodes)

    def system(
        self,
        control: Float[np.ndarray, "k 3"],
        uv: Float[np.ndarray, "n 2"],
        stiffness: Float[np.ndarray, "k k"],
        iterations: int,
    ) -> tuple[Float[np.ndarray, "n 2"], Equations]:
        """Foot points on the surface of given coefficients, and the equations for new coefficients."""
        surface = surface_of(control)
        uv = refine_foot_points(surface, self.points, uv, iterations)
        here = frames(surface, uv)
        normal, position, conormals, left = here.normal, here.position, here.conormals, here.left
        rows, total = rows_at(uv), float(np.sum(self.weights))
        tied = total * _TIED * (rows.mean(axis=0) + 1e-3)
        system = Equations(control, total * stiffness, tied)
        system.add(rows, normal, np.sum(normal * self.points, axis=1), self.weights)
        beyond = np.einsum("nij,nj->ni", conormals, self.points - position) - left
        for edge in range(2):
            on = (left[:, edge] < 1e-9) & (beyond[:, edge] > 0)
            along = conormals[on, edge]
            system.add(rows[on], along, np.sum(along * self.points[on], axis=1), self.weights[on])
        self._add_emptiness(system, control, uv, total)
        return uv, system

    def at(self, uv: Float[np.ndarray, "n 2"]) -> TangentDistance:
        """The term of the cloud with these foot points."""
        return self.cloud.at(uv)

    def _add_emptiness(
        self,
        system: Equations,
        control: Float[np.ndarray, "k 3"],
        uv: Float[np.ndarray, "n 2"],
        total: float,
    ) -> None:
        """Adds equations that draw nodes beyond the points' margin to the nearest point.

        Nodes in a hole are left alone: drawn to its rim, they would make the surface bulge.
        """
        places = self.nodes @ control
        grid = places.reshape(_NODES, _NODES, 3)
        area = areas_around(grid).ravel()
        # Only points beside a node on the surface count, not those on another fold of it.
        sides = [np.linalg.norm(np.diff(grid, axis=k), axis=-1).sum(k).mean() for k in (0, 1)]
        beside = np.asarray(KDTree(uv * sides).query(self.node_uv * sides, _BESIDE)[1])
        gaps = np.linalg.norm(places[:, None] - self.points[beside], axis=-1)
        each = np.arange(len(places))
        nearest = beside[each, np.argmin(gaps, axis=1)]
        gap = np.min(gaps, axis=1)
        far = reached_from_the_edge((gap > _SLACK * self.spacing).reshape(_NODES, _NODES)).ravel()
        there = self.points[nearest[far]]
        away = (places[far] - there) / gap[far, None]
        target = np.sum(away * there, axis=1) + _SLACK * self.spacing
        system.add(self.nodes[far], away, target, total * area[far] / area.sum())


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
    control = _base_first(control.reshape(*SHAPE, 3))
    # Coefficients by which the spline represents u and v themselves.
    u, v = ((np.arange(n) - 1) / segments for n, segments in zip(SHAPE, SEGMENTS, strict=True))
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
    rise = (0.5 * (control[1] + control[-2]) - control[SHAPE[0] // 2]).mean(axis=0)
    return control if rise @ up >= 0 else control[::-1]
