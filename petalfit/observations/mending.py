"""Mending what files hold: rows without a place, normals without a direction, colours of any range."""

import numpy as np

from petalfit.observations.columns import Columns
from petalfit.observations.errors import TargetError
from petalfit.observations.resolution import resolution_notes
from petalfit.observations.sheets import sheet_notes
from petalfit.observations.validation import bounds

# Depth cameras write 0 0 0 for a pixel without depth. No surface has this many of its points at exactly
# one place.
_MANY_AT_ORIGIN = 20
_LARGE_SHARE_AT_ORIGIN = 0.002


def mended(columns: Columns) -> Columns:
    """The columns of a file without what a fit cannot use, with a note on everything that was done.

    - Points that are not finite are dropped, and points at exactly the origin if they are many.
    - Normals are dropped if one of them has no direction, because fits of the shape do not need them.
    - Weights that are NaN become 0; weights that are all 0 are dropped.
    - Colours become numbers from 0 to 1; those that cannot are dropped.

    Arrays of other shapes or types are left to the checks of `PointCloud`.

    Args:
        columns: The columns, as their reader gives them.

    Returns:
        The columns with notes.

    Raises:
        TargetError: No point is left, or the coordinates are rounded too much.
    """
    points, notes = columns["points"], [*columns.get("notes", ())]
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind not in "fiu":
        return columns
    if not len(points):
        return columns
    x, y, z = points.T
    low, high = bounds(points)
    kept = np.ones(len(points), bool)
    if not (np.isfinite(low).all() and np.isfinite(high).all()):
        kept = np.isfinite(x) & np.isfinite(y) & np.isfinite(z)
    lost = len(points) - int(np.count_nonzero(kept))
    if lost == len(points):
        raise TargetError(f"holds no point: all {lost:,} are NaN or infinite; export it again.")
    if lost:
        notes.append(f"{lost:,} of {len(points):,} points are NaN or infinite, and were left out")
    at_origin = (x == 0) & (y == 0) & (z == 0)
    missing = int(np.count_nonzero(at_origin))
    if missing == len(points) - lost:
        raise TargetError(
            f"points all coincide ({missing:,} at the origin), as those of a camera that saw no depth."
        )
    if missing >= max(_MANY_AT_ORIGIN, _LARGE_SHARE_AT_ORIGIN * len(points)):
        kept &= ~at_origin
        notes.append(
            f"{missing:,} of {len(points):,} points lie at exactly the origin, as depth cameras write "
            "missing ones, and were left out"
        )
    if not kept.all():
        columns = _rows(columns, kept)
    points = columns["points"]
    notes += resolution_notes(points)
    notes += sheet_notes(points)
    normals, weights, colours = columns["normals"], columns["weights"], columns["colours"]
    if normals is not None and normals.shape == points.shape:
        normals = _normals(normals, notes)
    if weights is not None and weights.shape == points.shape[:1]:
        weights = _weights(weights, notes)
    if colours is not None and colours.shape == points.shape:
        colours = _colours(colours, notes)
    return {
        "points": points,
        "normals": normals,
        "weights": weights,
        "colours": colours,
        "notes": tuple(notes),
    }


def _rows(columns: Columns, kept: np.ndarray) -> Columns:
    """Some rows of the columns."""

    def some(array: np.ndarray | None) -> np.ndarray | None:
        return array[kept] if array is not None and array.shape[:1] == kept.shape else array

    return {
        "points": columns["points"][kept],
        "normals": some(columns["normals"]),
        "weights": some(columns["weights"]),
        "colours": some(columns["colours"]),
    }


def _normals(normals: np.ndarray, notes: list[str]) -> np.ndarray | None:
    if normals.dtype.kind not in "fiu":
        return normals
    x, y, z = normals.T
    bad = (x == 0) & (y == 0) & (z == 0)
    if not all(np.isfinite(end).all() for end in bounds(normals)):
        bad |= ~np.isfinite(normals).all(axis=1)
    count = int(np.count_nonzero(bad))
    if not count:
        return normals
    if count < len(normals):
        notes.append(
            f"{count:,} of {len(normals):,} normals are zero or NaN: all normals were left out; fits do "
            "not need them"
        )
    # Normals that are all zero are not there: files of Gaussian splats have a place for them.
    return None


def _weights(weights: np.ndarray, notes: list[str]) -> np.ndarray | None:
    if weights.dtype.kind not in "fiu":
        return weights
    missing = np.isnan(weights) if weights.dtype.kind == "f" else np.zeros(len(weights), bool)
    count = int(np.count_nonzero(missing))
    if count:
        weights = np.where(missing, 0.0, weights)
    if not weights.any():
        notes.append("all weights are zero or NaN, and were left out")
        return None
    if count:
        notes.append(f"{count:,} of {len(weights):,} weights are NaN, and were set to 0")
    return weights


def _colours(colours: np.ndarray, notes: list[str]) -> np.ndarray | None:
    if colours.dtype == np.uint8 or colours.dtype.kind not in "fiu":
        return colours
    low, high = colours.min(), colours.max()  # NaN if one of them is
    if not (low >= 0 and high <= 65535):
        notes.append("colours are negative, NaN or beyond 65535, and were left out")
        return None
    if high > 255:
        notes.append("colours go beyond 255; they were read as 16 bits a channel")
        return colours / 65535.0
    is_fraction = high <= 1 and colours.dtype.kind == "f"
    return np.asarray(colours, np.float64) if is_fraction else colours / 255.0
