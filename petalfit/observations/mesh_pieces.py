"""The separate pieces of a mesh: faces that share no corner, directly or through others."""

import numpy as np
from jaxtyping import Float64

# A piece with less of the area is a crumb, of which scans are full.
_CRUMB = 0.05
# Corners closer than this part of the extent are one: 2^20 steps, so that three of them make one integer.
_STEPS = 20

SEVERAL = "separate pieces"  # what the note on them says, which does not concern whole flowers


def piece_notes(triangles: Float64[np.ndarray, "f 3 3"]) -> list[str]:
    """A note if a mesh has several large pieces, which are perhaps several petals.

    Args:
        triangles: The corners of each triangle, (F, 3, 3), finite.

    Returns:
        The note, or no notes.
    """
    shares = np.sort(_areas(triangles))[::-1]
    large = int(np.count_nonzero(shares >= _CRUMB * shares.sum()))
    if large < 2:
        return []
    listed = ", ".join(f"{100 * share / shares.sum():.0f} %" for share in shares[: min(large, 6)])
    more = ", …" if large > 6 else ""
    return [
        f"the mesh has {large} {SEVERAL} ({listed}{more} of its area), which are fitted as one "
        "surface; if they are several petals, save each in a file of its own"
    ]


def _areas(triangles: Float64[np.ndarray, "f 3 3"]) -> Float64[np.ndarray, " p"]:
    """The area of each piece, in any unit."""
    # Imported late: SciPy takes longer than reading a small file.
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    low = triangles.min(axis=(0, 1))
    extent = float((triangles.max(axis=(0, 1)) - low).max())
    if extent == 0.0:
        return np.ones(1)
    # Corners are compared by place, because STL and seams of textures repeat them.
    steps = np.rint((triangles - low) * (2**_STEPS / extent)).astype(np.int64)
    keys = (steps[..., 0] << 2 * (_STEPS + 1)) | (steps[..., 1] << (_STEPS + 1)) | steps[..., 2]
    places, corners = np.unique(keys, return_inverse=True)
    corners = corners.reshape(-1, 3)
    ends = np.concatenate([corners[:, :2], corners[:, 1:]])
    links = coo_array((np.ones(len(ends), bool), ends.T), shape=(len(places), len(places)))
    _, labels = connected_components(links, directed=False)
    sides = (triangles[:, 1:] - triangles[:, :1]) / extent
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    return np.bincount(labels[corners[:, 0]], area)
