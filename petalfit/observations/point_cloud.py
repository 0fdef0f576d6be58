"""Point clouds of a petal, from a laser scanner, from photogrammetry or from a mesh."""

import copy
import math
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import msgspec
import numpy as np
from jaxtyping import Bool, Float64

from petalfit.observations.columns import Columns
from petalfit.observations.errors import TargetError
from petalfit.observations.observation import AbstractObservation
from petalfit.observations.readers import read_columns
from petalfit.observations.triangles import (
    DEFAULT_SAMPLES,
    geometry_columns,
    mesh_triangles,
    sample_triangles,
)
from petalfit.observations.validation import (
    ArrayLike,
    bounds,
    check_spread,
    valid_colours,
    valid_normals,
    valid_points,
    valid_weights,
)
from petalfit.observations.writers import write_columns
from petalfit.schema import unpacked

if TYPE_CHECKING:
    import trimesh


# Points that are sampled or measured seldom coincide; a place that many of them share is named.
_MANY_COINCIDE, _LARGE_SHARE_COINCIDES = 10, 0.01


class _Columns(msgspec.Struct):
    """What a file holds of a cloud."""

    points: list[list[float]] | bytes
    normals: list[list[float]] | bytes | None
    weights: list[float] | bytes | None
    colours: list[list[float]] | bytes | None


@dataclass(frozen=True, init=False, eq=False, repr=False)
class PointCloud(AbstractObservation):
    """A point cloud, optionally with normals, weights and colours.

    The arrays are checked, copied to float64 and made read-only. Two clouds are equal only if
    they are the same object.

    Args:
        points: (N, 3), in any unit of length. They must not all lie on one line.
        normals: (N, 3), of any length but zero; they are scaled to unit length.
        weights: (N,), the number of observations that each point counts for; 0 ignores a point.
        colours: (N, 3), sRGB from 0 to 1, or bytes. Fits of the shape do not use them.

    Raises:
        TargetError: The arrays cannot be used; the message says why and what to do.
    """

    kind: ClassVar[str] = "cloud"
    unit: ClassVar[str] = "length"
    points: Float64[np.ndarray, "n 3"]
    normals: Float64[np.ndarray, "n 3"] | None
    weights: Float64[np.ndarray, " n"] | None
    colours: Float64[np.ndarray, "n 3"] | None

    def __init__(
        self,
        points: ArrayLike,
        normals: ArrayLike | None = None,
        weights: ArrayLike | None = None,
        colours: ArrayLike | None = None,
    ) -> None:
        points = valid_points(points)
        normals = None if normals is None else valid_normals(normals, len(points))
        weights = None if weights is None else valid_weights(weights, len(points))
        colours = None if colours is None else valid_colours(colours, len(points))
        check_spread(points if weights is None else points[weights > 0.0])
        given = {"points": points, "normals": normals, "weights": weights, "colours": colours}
        for name, array in given.items():
            if array is not None:
                array.setflags(write=False)
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.points)

    def __repr__(self) -> str:
        extent = " × ".join(f"{side:.4g}" for side in self.extent)
        extras = [
            name for name in ("normals", "weights", "colours") if getattr(self, name) is not None
        ]
        return f"PointCloud({', '.join([f'{len(self)} points', f'extent {extent}', *extras])})"

    @property
    def centroid(self) -> Float64[np.ndarray, "3"]:
        """The mean of the points, weighted if there are weights; (3,)."""
        # Relative to one of the points: sums of coordinates near 5e6 would lose the petal to rounding.
        origin = self.points[0]
        weights = None if self.weights is None else self.weights / self.weights.max()
        return origin + np.average(self.points - origin, axis=0, weights=weights)

    @property
    def extent(self) -> Float64[np.ndarray, "3"]:
        """The sides of the axis-aligned bounding box; (3,)."""
        low, high = bounds(self.points)
        return high - low

    @property
    def diagonal(self) -> float:
        """The diagonal of the axis-aligned bounding box."""
        return math.hypot(*self.extent)

    @property
    def size(self) -> float:
        return self.diagonal

    @property
    def described(self) -> str:
        return f"{len(self):,} point{'s' * (len(self) != 1)}"

    @property
    def mass(self) -> Float64[np.ndarray, " n"]:
        """The number of observations that each point counts for: its weight, or 1; (N,)."""
        return np.ones(len(self)) if self.weights is None else self.weights

    def used(self, weights: Float64[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
        """A mask of the points that count: their weight is positive, and the fit kept at least half."""
        return (weights > 0) & (weights >= 0.5 * self.mass)

    def outliers(self, weights: Float64[np.ndarray, " n"]) -> int:
        return int(np.count_nonzero(self.mass) - np.count_nonzero(self.used(weights)))

    def each_once(self) -> "PointCloud":
        """The cloud with weight 0 for points that repeat an earlier one."""
        if _all_differ(self.points):
            return self
        places, first, counts = np.unique(
            self.points, axis=0, return_index=True, return_counts=True
        )
        if len(first) == len(self):
            return self
        once = np.zeros(len(self))
        once[first] = 1.0
        most = int(counts.argmax())
        cloud = self.weighted(once)
        if counts[most] >= max(_MANY_COINCIDE, _LARGE_SHARE_COINCIDES * len(self)):
            x, y, z = places[most]
            note = (
                f"{counts[most]:,} of {len(self):,} points coincide at ({x:.6g}, {y:.6g}, {z:.6g}) and "
                "count as one; if they stand for missing ones, remove them, or use loss='robust'"
            )
            return cloud.noting(note)
        return cloud

    def noting(self, *notes: str) -> "PointCloud":
        """The cloud with more notes on what is odd about it, in whole sentences."""
        cloud = copy.copy(self)
        object.__setattr__(cloud, "notes", (*self.notes, *notes))
        return cloud

    def counting(self, weights: Float64[np.ndarray, " n"]) -> "PointCloud":
        """The cloud with other weights."""
        cloud = PointCloud(self.points, self.normals, weights, self.colours)
        return cloud.noting(*self.notes)

    def weighted(self, factor: Float64[np.ndarray, " n"]) -> "PointCloud":
        """The cloud with the weight of each point multiplied by a factor."""
        return self.counting(self.mass * factor)

    def arrays(self) -> tuple[dict[str, Any], list[Float64[np.ndarray, "..."] | None]]:
        return {"camera": None}, [self.points, self.weights]

    def to_json(self) -> dict[str, Any]:
        parts = ("points", "normals", "weights", "colours")
        return {"kind": self.kind} | {name: getattr(self, name) for name in parts}

    @classmethod
    def from_json(cls, content: dict[str, Any]) -> "PointCloud":
        columns = msgspec.convert(content, _Columns)
        return cls(
            unpacked(columns.points, -1, 3),
            None if columns.normals is None else unpacked(columns.normals, -1, 3),
            None if columns.weights is None else unpacked(columns.weights, -1),
            None if columns.colours is None else unpacked(columns.colours, -1, 3),
        )

    @classmethod
    def load(
        cls, path: str | os.PathLike[str], *, n: int = DEFAULT_SAMPLES, seed: int = 0
    ) -> "PointCloud":
        """Reads a point cloud, or samples a mesh; see `petalfit.observations.readers.read_columns`.

        Names of columns may be quoted, in any case and with a unit. Coordinates are `x`, `x [mm]`,
        `x_mm`, `coord_x`, `pos.x`, `x_coordinate`, `Points:0`, `Points_0` or `easting`, and so on;
        normals `nx`, `normal_x` or `Normals:0`; weights `weight` or `weights`; colours `red`, `r`,
        `color_r` or `RGB:0`. A header without three coordinates is refused.

        Args:
            path: The path of the file, which must fit into memory.
            n: The number of points to draw from a file with faces; without faces all vertices are used.
            seed: The seed of `numpy.random.default_rng`, which draws the points.

        Returns:
            The cloud, in the file's unit of length and frame. Its `notes` say what was left out, and
            what is odd about it.

        Raises:
            TargetError: The file is missing, unreadable, too large, not of the format that its suffix
                names, or does not hold a usable cloud. The message begins with the path.
            ValueError: `n` is not positive.
        """
        path = Path(path)
        try:
            return cls._of(read_columns(path, n, seed))
        except TargetError as error:
            raise TargetError(f"{path}: {error}") from error.__cause__

    @classmethod
    def _of(cls, columns: Columns) -> "PointCloud":
        """The cloud of columns, with their notes."""
        parts = (columns["points"], columns["normals"], columns["weights"], columns["colours"])
        return cls(*parts).noting(*columns.get("notes", ()))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the cloud, completely or not at all; reading it back gives exactly the same numbers.

        Args:
            path: The path of the file. Its suffix names the format, see
                `petalfit.observations.writers`. An existing file is replaced.

        Raises:
            ValueError: The suffix names no format that can be written, or the format cannot hold
                weights or colours.
            OSError: The file cannot be written.
        """
        columns: Columns = {
            "points": self.points,
            "normals": self.normals,
            "weights": self.weights,
            "colours": self.colours,
        }
        write_columns(columns, path)

    @classmethod
    def from_mesh(
        cls, mesh: "trimesh.Trimesh", n: int = DEFAULT_SAMPLES, seed: int = 0
    ) -> "PointCloud":
        """Draws points from a mesh, uniformly by area, with the normals of their faces.

        Args:
            mesh: Any mesh with faces; it need not be closed.
            n: The number of points.
            seed: The seed of `numpy.random.default_rng`; the same seed gives the same points.

        Returns:
            A cloud of n points with normals.

        Raises:
            ValueError: `n` is not positive.
            TargetError: The mesh has no faces, no area, or faces without usable corners.
        """
        return cls(*sample_triangles(mesh_triangles(mesh), n, seed))


def as_point_cloud(target: object) -> PointCloud:
    """Converts an array, a mesh, a scene or a file to a point cloud.

    Args:
        target: An (N, 3) array-like of NumPy, JAX or plain lists; a `PointCloud`, which is
            returned unchanged; a `trimesh.Trimesh`, `trimesh.PointCloud` or `trimesh.Scene`, whose
            faces are sampled by area; or the path of a file.

    Returns:
        The cloud.

    Raises:
        TargetError: The target is none of these, or cannot be used.
    """
    if isinstance(target, PointCloud):
        return target
    if isinstance(target, str | os.PathLike):
        return PointCloud.load(target)
    # If the target is an object of trimesh, trimesh has been imported already.
    if "trimesh" in sys.modules:
        import trimesh

        if isinstance(target, trimesh.Scene):
            return PointCloud._of(geometry_columns(target.dump()))
        if isinstance(target, trimesh.Trimesh | trimesh.PointCloud):
            return PointCloud._of(geometry_columns([target]))
    if isinstance(target, list | tuple) or hasattr(target, "__array__"):
        return PointCloud(target)  # pyright: ignore[reportArgumentType] - checked in there
    raise TargetError(
        f"a target of type {type(target).__name__} is not a point cloud; give an (N, 3) array, "
        "a PointCloud, a trimesh mesh, cloud or scene, or the path of a file."
    )


def _all_differ(points: Float64[np.ndarray, "n 3"]) -> bool:
    """Whether no two points are equal; False too if two have the same key by chance, 1 in 10¹⁵ pairs."""
    x, y, z = points.T
    keys = np.sort(x + math.sqrt(2) * y + math.sqrt(3) * z)
    return bool(np.all(keys[1:] != keys[:-1]))
