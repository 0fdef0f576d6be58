"""Whether points lie on two parallel sheets, as those of both faces of a thick petal do."""

import numpy as np
from jaxtyping import Float64, Num

from petalfit.observations.validation import LARGEST_COORDINATE, bounds

# Offsets from the middle of two sheets have a kurtosis of 1, of a tube 1.5, of noise 3. The least of
# single sheets was 1.88, among scans, made petals and tubes.
_TWO_SHEETS = 1.45
# Distances below this part of the neighbourhood are the curvature of a single sheet.
_CURVATURE = 0.02
_PLACES = 150
_POINTS = (20_000, 2_000)
_NEIGHBOURS = (40, 100, 250)


def sheet_notes(points: Num[np.ndarray, "n 3"]) -> list[str]:
    """A note if most of the points lie on two sheets, with the distance between them.

    Args:
        points: The points, finite, (N, 3).

    Returns:
        The note, or no notes.
    """
    low, high = (end.astype(np.float64) for end in bounds(points))
    extent = float((high - low).max())
    if not 0.0 < extent < LARGEST_COORDINATE:
        return []
    relative = _thickness(points, low, extent)
    if relative is None:
        return []
    thickness = relative * extent
    return [
        f"the points lie on two sheets that are {thickness:.2g} apart, as the faces of a thick petal do: "
        "a fitted surface runs between them; if they are too far apart for that, keep one of the faces"
    ]


def _thickness(
    points: Num[np.ndarray, "n 3"], low: Float64[np.ndarray, "3"], extent: float
) -> float | None:
    """The distance between two sheets, relative to the extent, or None if there are not two."""
    # Imported late: SciPy takes longer than reading a small file.
    from scipy.spatial import KDTree

    rng = np.random.default_rng(0)
    if len(points) > _POINTS[0]:
        points = points[rng.choice(len(points), _POINTS[0], replace=False)]
    points = (points - low) / extent
    # Neighbourhoods must be wider than the distance between the sheets, to have both: far ones are found
    # among few points.
    for most in _POINTS:
        if len(points) > most:
            points = points[rng.choice(len(points), most, replace=False)]
        tree = KDTree(points)
        centres = points[rng.choice(len(points), min(_PLACES, len(points)), replace=False)]
        for count in _NEIGHBOURS:
            if 3 * count > len(points):
                break
            distances, near = tree.query(centres, count)
            offsets = _offsets(points[near] - centres[:, None])
            spread = np.sqrt(np.mean(offsets**2, axis=1))
            known = spread > _CURVATURE * distances[:, -1]
            kurtosis = np.full(len(centres), np.inf)
            kurtosis[known] = np.mean(offsets[known] ** 4, axis=1) / spread[known] ** 4
            if np.median(kurtosis) < _TWO_SHEETS:
                return 2.0 * float(np.median(spread[kurtosis < _TWO_SHEETS]))
    return None


def _offsets(near: Float64[np.ndarray, "p k 3"]) -> Float64[np.ndarray, "p k"]:
    """The offsets of neighbours from the smooth surface closest to them, at each of p places."""
    near = near - near.mean(axis=1, keepdims=True)
    scale = np.abs(near).max(axis=(1, 2), keepdims=True).clip(1e-30)
    near = near / scale
    _, axes = np.linalg.eigh(np.einsum("pki,pkj->pij", near, near))
    height, a, b = np.einsum("pki,pij->jpk", near, axes)
    terms = np.stack([np.ones_like(a), a, b, a * a, a * b, b * b], axis=-1)
    fitted = np.linalg.pinv(terms) @ height[..., None]
    return (height - (terms @ fitted)[..., 0]) * scale[..., 0]
