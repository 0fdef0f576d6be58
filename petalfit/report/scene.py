"""The scene of the pictures: the fitted surface and the target, in the petal's own axes."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple, cast

import numpy as np
from jaxtyping import Bool, Float, UInt8

from petalfit.observations import PointCloud
from petalfit.report.colour import FRONT, IGNORED, POINT, REAR, diverging, shaded
from petalfit.report.raster import Canvas
from petalfit.results import Agreement, FitRecord

# The resolution of `FitRecord.mesh`, so that a process compiles only one tessellation.
_RESOLUTION = (65, 65)
# The most points that are drawn; of more points a random choice is drawn, always the same.
_IN_MAP = 20_000
_IN_VIEW = 2500  # more would cover the surface
LIGHT = np.array([-0.45, 0.55, 0.7]) / np.linalg.norm([-0.45, 0.55, 0.7])
_MARGIN = 0.04  # around what is drawn, as a fraction of a picture's sides


@dataclasses.dataclass(frozen=True)
class Scene:
    """A fit in the petal's axes (x across, y along, z its normal) and the target's unit.

    Attributes:
        vertices: The vertices of the surface, or of the k parts of an assembly, shape (k, n_u, n_v, 3).
        normals: The unit normals at the vertices, shape (k, n_u, n_v, 3).
        points: The points of the target that the map shows, shape (m, 3), in random order: the first n
            of them are a random choice for every n.
        distances: The signed distances of these points to the surface, shape (m,).
        used: Whether each point had a weight in the fit and is not an outlier, shape (m,).
    """

    vertices: Float[np.ndarray, "k n_u n_v 3"]
    normals: Float[np.ndarray, "k n_u n_v 3"]
    points: Float[np.ndarray, "m 3"]
    distances: Float[np.ndarray, " m"]
    used: Bool[np.ndarray, " m"]

    @classmethod
    def of(cls, result: FitRecord, part: Agreement | None = None) -> Scene:
        """The scene of a fit with one of its clouds, or without points if `part` is None."""
        mesh = result.model.mesh(_RESOLUTION)
        pose = result.pose
        points, distances, used = np.empty((0, 3)), np.empty(0), np.empty(0, bool)
        if part is not None:
            cloud = cast(PointCloud, part.target)
            chosen = np.random.default_rng(0).permutation(len(cloud))[:_IN_MAP]
            points = (cloud.points[chosen] - pose.translation) @ pose.rotation
            distances, used = part.distances[chosen], part.used[chosen]
        return cls(
            float(pose.scale) * np.array(mesh.vertices).reshape(-1, *_RESOLUTION, 3),
            np.array(mesh.vertex_normals).reshape(-1, *_RESOLUTION, 3),
            points,
            distances,
            used,
        )

    @property
    def finite(self) -> bool:
        """Whether all numbers are finite, as drawing requires; after a failed fit they may not be."""
        return bool(np.isfinite(self.vertices).all() and np.isfinite(self.points).all())

    @property
    def outlines(self) -> list[Float[np.ndarray, "l 3"]]:
        """The edge of every surface as a closed curve."""
        return [
            np.concatenate([grid[:, 0], grid[-1, 1:], grid[-2::-1, -1], grid[0, -2::-1]])
            for grid in self.vertices
        ]


def distance_limit(part: Agreement) -> float:
    """The distance at which the colours end: 3 σ, or the 98 % quantile of distances if above 4 σ."""
    usable = np.abs(part.distances[part.used & np.isfinite(part.distances)])
    noise = part.noise if np.isfinite(part.noise) else 0.0
    far = float(np.quantile(usable, 0.98)) if len(usable) else 0.0
    return far if far > 4 * noise else 3 * noise or 1.0


class View(NamedTuple):
    """A view of the scene: an orthographic camera.

    Attributes:
        name: The name of the view, for readers.
        axes: The directions right, up and towards the viewer as rows, in the petal's axes; shape (3, 3).
    """

    name: str
    axes: Float[np.ndarray, "3 3"]


def _turned(azimuth: float, elevation: float) -> Float[np.ndarray, "3 3"]:
    """The axes of a view of the upper side, tip up; degrees to the right (+) and upwards (+)."""
    a, e = np.radians([azimuth, elevation])
    right = np.array([np.cos(a), 0.0, -np.sin(a)])
    back = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
    return np.stack([right, np.cross(back, right), back])


OBLIQUE = View("oblique", _turned(-38.0, -36.0))
SIDE = View("from the side", np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]))
BASE = View("from the base", np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]))
FACE = View("from the front", np.eye(3))


class Picture(NamedTuple):
    """A drawn view.

    Attributes:
        rgba: The pixels, shape (h, w, 4), transparent where nothing is drawn.
        view: The view.
        corner: The coordinates of the left and the lower edge along the view's right and up, shape (2,).
        scale: The number of pixels per unit of length.
        drawn: The number of points drawn.
    """

    rgba: UInt8[np.ndarray, "h w 4"]
    view: View
    corner: Float[np.ndarray, "2"]
    scale: float
    drawn: int


def _framed(view: View, scene: Scene, width: int, aspects: tuple[float, float]) -> Picture:
    """An empty picture with room for the whole scene, as low as the scene allows."""
    everything = np.concatenate([scene.vertices.reshape(-1, 3), scene.points]) @ view.axes[:2].T
    low, high = everything.min(axis=0), everything.max(axis=0)
    sides = np.maximum(high - low, 1e-9 * np.abs(everything).max() + 1e-300)
    aspect = float(np.clip(sides[1] / sides[0], *aspects))
    shape = round(aspect * width), width
    scale = float(min((1 - 2 * _MARGIN) * np.array(shape[::-1]) / sides))
    corner = 0.5 * (low + high) - 0.5 * np.array(shape[::-1]) / scale
    return Picture(np.zeros((*shape, 4), np.uint8), view, corner, scale, 0)


def _place(picture: Picture, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The places of points in pixels (right, down) and their depths, shapes (..., 2) and (...)."""
    seen = points @ picture.view.axes.T
    xy = (seen[..., :2] - picture.corner) * picture.scale
    xy[..., 1] = len(picture.rgba) - xy[..., 1]
    return xy, seen[..., 2]


def draw_view(
    scene: Scene, view: View, width: int, aspects: tuple[float, float] = (0.3, 1.2)
) -> Picture:
    """Draws the shaded surface with the target's points on it, behind it and in front of it.

    Args:
        scene: The scene to draw.
        view: The view.
        width: The width of the picture, in pixels.
        aspects: The least and the greatest height, as fractions of the width.
    """
    picture = _framed(view, scene, width, aspects)
    canvas = Canvas(picture.rgba.shape[:2])
    xy, depth = _place(picture, scene.vertices)
    normals = scene.normals @ view.axes.T
    front = normals[..., 2:] >= 0
    lit = np.clip(np.where(front, normals, -normals) @ LIGHT, 0, 1)
    rgb = shaded(np.where(front, FRONT, REAR), lit)
    for sheet in zip(xy, depth, rgb, strict=True):
        canvas.sheet(*sheet)
    # Points lie within the noise of the surface. Those on the visible side are shown completely, and
    # those on the side that is turned away are hidden: a lift by some cells separates the two.
    lift = 0.01 * float(np.linalg.norm(np.ptp(scene.vertices.reshape(-1, 3), axis=0)))
    xy, depth = _place(picture, scene.points[:_IN_VIEW])
    colours = np.where(scene.used[:_IN_VIEW, None], POINT, IGNORED)
    radius = _dot_radius(picture, len(xy), 2.0, 3.2)
    canvas.discs(xy, depth + lift, 0.3 * colours + 0.7, radius + 1.3)
    canvas.discs(xy, depth + 1.001 * lift, colours, radius)
    return picture._replace(rgba=canvas.rgba, drawn=len(xy))


def draw_map(
    scene: Scene, limit: float, width: int, aspects: tuple[float, float] = (0.5, 1.4)
) -> Picture:
    """Draws the points from the front, coloured by signed distance, the largest distances on top.

    Args:
        scene: The scene to draw.
        limit: The distance at the two ends of the colours, positive.
        width: The width of the picture, in pixels.
        aspects: The least and the greatest height, as fractions of the width.
    """
    picture = _framed(FACE, scene, width, aspects)
    canvas = Canvas(picture.rgba.shape[:2])
    xy, _ = _place(picture, scene.points)
    colours = np.where(scene.used[:, None], diverging(scene.distances / limit), IGNORED)
    far = np.where(scene.used, np.abs(scene.distances), -1.0)
    rank = np.argsort(np.argsort(far)).astype(float)
    canvas.discs(xy, rank, colours, _dot_radius(picture, len(xy), 2.0, 5.5))
    return picture._replace(rgba=canvas.rgba, drawn=len(xy))


def _dot_radius(picture: Picture, n: int, least: float, greatest: float) -> float:
    """The radius in pixels of n dots that cover about a quarter of a picture, within the given range."""
    height, width, _ = picture.rgba.shape
    return float(np.clip(0.25 * np.sqrt(height * width / max(n, 1)), least, greatest))
