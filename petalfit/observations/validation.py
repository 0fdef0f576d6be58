"""Checks of the arrays of a point cloud. Each function returns a float64 copy or raises an error.

Rows are counted from 0 in every message, as NumPy does.
"""

import numpy as np
import numpy.typing as npt
from jaxtyping import Float64, Num

from petalfit.observations.errors import TargetError

# Checked at run time, NumPy's own type does not cover tuples, because they have no __reversed__.
ArrayLike = npt.ArrayLike | tuple[object, ...]

# Squares of larger coordinates, and sums of such squares, come near the limit of float64.
LARGEST_COORDINATE = 1e150
# The smallest extent, relative to the largest coordinate. Rounding to float64 moves a point by
# 1.1e-16 of its coordinate, hence by at most 2e-7 of the extent, which is less than STRAIGHTNESS.
RESOLVED_EXTENT = 1e-9
# The largest distance to a line, relative to the extent, at which points count as collinear. For a
# petal of 20 cm that is 0.2 µm: far below any scanner's noise, above float32's rounding.
STRAIGHTNESS = 1e-6
# A normal this close to unit length is kept unchanged, so that saving and loading is exact.
UNIT_LENGTH = 4 * np.finfo(np.float64).eps
# Rows that are checked at a time: intermediate results stay in the cache, and take no memory.
_CHUNK = 1 << 15


def bounds(points: Num[np.ndarray, "n k"]) -> tuple[Num[np.ndarray, " k"], Num[np.ndarray, " k"]]:
    """The smallest and the largest value of each column, NaN if there is one in it; (k,) each."""
    # Column by column: NumPy takes ten times as long for short rows.
    low, high = zip(*((column.min(), column.max()) for column in points.T), strict=True)
    return np.array(low), np.array(high)


def valid_points(points: ArrayLike) -> Float64[np.ndarray, "n 3"]:
    """Checks type, shape and finiteness of points.

    Args:
        points: An array-like (N, 3), in any unit of length.

    Returns:
        A C-contiguous copy in float64.

    Raises:
        TargetError: The points are not numbers, not (N, 3), empty, not finite or too large to square.
    """
    array = _real_array(points, "points")
    if array.size == 0:
        raise TargetError(f"points are empty (shape {array.shape}), expected shape (N, 3).")
    if array.ndim != 2 or array.shape[1] != 3:
        raise TargetError(
            f"points have shape {array.shape}, expected (N, 3); {_shape_remedy(array.shape)}."
        )
    low, high = bounds(array)
    if not (np.isfinite(low).all() and np.isfinite(high).all()):
        _refuse_rows(
            ~np.isfinite(array).all(axis=1),
            "points have a NaN or infinite coordinate",
            "drop them: points[np.isfinite(points).all(axis=1)]",
        )
    largest = max(-low.min(), high.max())
    if largest > LARGEST_COORDINATE:
        raise TargetError(
            f"points have coordinates up to {largest:.3g}, expected at most "
            f"{LARGEST_COORDINATE:g}; check the file, or use a larger unit of length."
        )
    return array


def valid_normals(normals: ArrayLike, n: int) -> Float64[np.ndarray, "n 3"]:
    """Checks normals and scales them to unit length.

    Args:
        normals: An array-like (N, 3), of any length but zero.
        n: The number of points.

    Returns:
        The unit normals, as a copy in float64.

    Raises:
        TargetError: The normals are not numbers, not one per point, not finite or of zero length.
    """
    array = _real_array(normals, "normals")
    if array.shape != (n, 3):
        raise TargetError(
            f"normals have shape {array.shape}, expected {(n, 3)}, one for each point."
        )
    if not all(np.isfinite(end).all() for end in bounds(array)):
        _refuse_rows(
            ~np.isfinite(array).all(axis=1),
            "normals have a NaN or infinite component",
            "drop those points, or leave the normals out",
        )
    x, y, z = array.T
    _refuse_rows(
        (x == 0.0) & (y == 0.0) & (z == 0.0),
        "normals have zero length",
        "drop those points, or leave the normals out",
    )
    for start in range(0, n, _CHUNK):
        part = array[start : start + _CHUNK]
        x, y, z = part.T
        with np.errstate(over="ignore"):
            length = np.sqrt(x * x + y * y + z * z)
        if not (length.min() > 1e-100 and length.max() < 1e100):
            # Divided by the largest component first, because the square of 1e-200 is zero.
            part /= np.maximum(np.maximum(np.abs(x), np.abs(y)), np.abs(z))[:, None]
            length = np.sqrt(x * x + y * y + z * z)
        part /= np.where(np.abs(length - 1.0) <= UNIT_LENGTH, 1.0, length)[:, None]
    return array


def valid_weights(weights: ArrayLike, n: int) -> Float64[np.ndarray, " n"]:
    """Checks weights.

    Args:
        weights: An array-like (N,), not negative, not all zero.
        n: The number of points.

    Returns:
        A copy in float64, not rescaled.

    Raises:
        TargetError: The weights are not numbers, not one per point, not finite, negative or all zero.
    """
    array = _real_array(weights, "weights")
    if array.shape != (n,):
        raise TargetError(f"weights have shape {array.shape}, expected {(n,)}, one for each point.")
    _refuse_rows(~np.isfinite(array), "weights are NaN or infinite", "use 0 to ignore a point")
    _refuse_rows(array < 0.0, "weights are negative", "use 0 to ignore a point")
    if not array.any():
        raise TargetError("weights are all zero, expected at least one that is positive.")
    return array


def valid_colours(colours: ArrayLike, n: int) -> Float64[np.ndarray, "n 3"]:
    """Checks colours.

    Args:
        colours: An array-like (N, 3) in sRGB: numbers from 0 to 1, or bytes from 0 to 255.
        n: The number of points.

    Returns:
        A copy in float64, from 0 to 1.

    Raises:
        TargetError: The colours are not numbers, not one per point, not finite or out of range.
    """
    is_bytes = np.asarray(colours).dtype == np.uint8
    array = _real_array(colours, "colours")
    if array.shape != (n, 3):
        raise TargetError(
            f"colours have shape {array.shape}, expected {(n, 3)}: red, green, blue of each point."
        )
    if is_bytes:
        array /= 255.0
    elif not (array.min() >= 0.0 and array.max() <= 1.0):
        _refuse_rows(
            ~((array >= 0.0) & (array <= 1.0)).all(axis=1),
            "colours lie outside 0 to 1",
            "divide numbers from 0 to 255 by 255, or give them as uint8",
        )
    return array


def check_spread(points: Float64[np.ndarray, "n 3"]) -> None:
    """Checks that points span more than a line, as far as float64 resolves them.

    Args:
        points: The points, (N, 3), finite.

    Raises:
        TargetError: The points all coincide, lie on one line, or lie so far from the origin, compared
            with their extent, that rounding has destroyed their shape.
    """
    low, high = bounds(points)
    span = (high - low).max()
    offset = max(-low.min(), high.max())
    need = "at least three that are not on one line are needed"
    if span == 0.0:
        raise TargetError(f"points all coincide ({len(points)} at {low.tolist()}); {need}.")
    if span < RESOLVED_EXTENT * offset:
        raise TargetError(
            f"points span only {span:.3g} at coordinates up to {offset:.9g}, which float64 does "
            "not resolve; subtract a common offset before the coordinates are rounded."
        )
    if _mean_width(points, low, span) > 10 * STRAIGHTNESS:
        return
    # Relative to the extent and about the mean, so that neither unit nor offset matters.
    centred = (points - low) / span
    centred -= centred.mean(axis=0)
    direction = np.linalg.eigh(centred.T @ centred).eigenvectors[:, -1]
    from_line = centred - np.outer(centred @ direction, direction)
    # The largest distance and not the second singular value: one real point off a long line counts.
    if np.linalg.norm(from_line, axis=1).max() <= STRAIGHTNESS:
        raise TargetError(f"points all lie on one line ({len(points)} of them); {need}.")


def _mean_width(
    points: Float64[np.ndarray, "n 3"], low: Float64[np.ndarray, "3"], span: float
) -> float:
    """The root mean square distance to the line that is closest, relative to the extent."""
    total, products = np.zeros(3), np.zeros((3, 3))
    for start in range(0, len(points), _CHUNK):
        part = (points[start : start + _CHUNK] - low) / span
        total += part.sum(axis=0)
        products += part.T @ part
    mean = total / len(points)
    variances = np.linalg.eigvalsh(products / len(points) - np.outer(mean, mean))
    return float(np.sqrt(max(variances[:2].sum(), 0.0)))


def _real_array(values: ArrayLike, name: str) -> Float64[np.ndarray, "..."]:
    """A C-contiguous float64 copy of an array-like of real numbers."""
    try:
        if isinstance(values, np.ma.MaskedArray):
            # np.asarray would return the values that the mask hides.
            values = np.ma.filled(values.astype(np.float64), np.nan)
        array = np.asarray(values)
    except Exception as error:  # Ragged lists and foreign arrays raise exceptions of any kind.
        raise TargetError(
            f"{name} cannot be made an array ({error}); give a rectangular array of numbers."
        ) from error
    if array.dtype.kind not in "fiu":
        raise TargetError(
            f"{name} have the type {array.dtype}, expected real numbers; "
            "convert them, for example with .astype(float)."
        )
    return np.array(array, dtype=np.float64, order="C")


def _shape_remedy(shape: tuple[int, ...]) -> str:
    """Advice for points that are not (N, 3)."""
    match shape:
        case (_, 2):
            return "a point needs three coordinates, so add the missing column"
        case (3, _):
            return "transpose them: points.T"
        case (_, columns) if columns > 3:
            return "keep the coordinates only: points[:, :3]"
        case _:
            return "give one row of x, y, z for each point"


def _refuse_rows(bad: npt.ArrayLike, complaint: str, remedy: str) -> None:
    """Raises a TargetError that counts the rows where `bad` (N,) is true and names the first."""
    rows = np.flatnonzero(bad)
    if rows.size:
        raise TargetError(
            f"{rows.size} of {np.size(bad)} {complaint}, the first in row {rows[0]}; {remedy}."
        )
