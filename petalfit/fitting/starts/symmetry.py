"""The mirror symmetry of a flat outline, which shows the midrib of a petal that is as wide as long."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

_ANGLES = 60  # lines that are tried, over half a turn
_MIRRORED = 768  # points that are mirrored


def onto_mirror_line(plane: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Places in a plane, turned so that one of the axes is the line about which they are most alike.

    Principal axes of a round petal are chance, and differ between two scans of it; its mirror line does
    not. The turn is at most an eighth, so that the first axis remains that of the longer side.

    Args:
        plane: Places in the plane, centred.
    """
    tree, some = KDTree(plane), plane[:: -(-len(plane) // _MIRRORED)]
    turns = np.pi * np.arange(_ANGLES) / _ANGLES
    lines = np.stack([np.cos(turns), np.sin(turns)], axis=-1)
    mirrored = 2 * (some @ lines.T)[..., None] * lines - some[:, None]
    away = np.mean(np.asarray(tree.query(mirrored)[0]) ** 2, axis=0)
    best = int(np.argmin(away))
    before, least, after = away[best - 1], away[best], away[(best + 1) % _ANGLES]
    between = 0.5 * (before - after) / max(before - 2 * least + after, 1e-300)
    turn = turns[1] * (best + np.clip(between, -0.5, 0.5))
    turn = (turn + np.pi / 4) % (np.pi / 2) - np.pi / 4
    cosine, sine = np.cos(turn), np.sin(turn)
    return plane @ np.array([[cosine, -sine], [sine, cosine]])
