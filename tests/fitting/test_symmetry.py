"""The mirror line of a flat outline, which does not depend on how the outline lies or was sampled."""

import numpy as np
import pytest

from petalfit.fitting.starts.symmetry import onto_mirror_line


def heart(seed: int) -> np.ndarray:
    """Points of an outline as wide as long, alike on both sides of the y axis."""
    places = np.random.default_rng(seed).uniform(-1, 1, (9000, 2))
    half = np.sin(np.pi * np.clip(0.5 * places[:, 1] + 0.5, 0, 1) ** 0.6)
    inside = places[np.abs(places[:, 0]) < half][:1500]
    return inside - inside.mean(axis=0)


@pytest.mark.parametrize("angle", [0.0, 0.4, 1.0, -2.3])
@pytest.mark.parametrize("seed", [0, 1])
def test_one_axis_is_the_mirror_line(angle, seed):
    cosine, sine = np.cos(angle), np.sin(angle)
    places = heart(seed)
    turned = onto_mirror_line(places @ np.array([[cosine, -sine], [sine, cosine]]))
    # The rotation from the outline's own frame to that of the answer is one by quarter turns.
    turn, *_ = np.linalg.lstsq(places, turned, rcond=None)
    assert np.sort(np.abs(turn).ravel()) == pytest.approx([0, 0, 1, 1], abs=0.05)
    assert np.linalg.det(turn) == pytest.approx(1.0)


def test_a_long_outline_keeps_its_axes():
    places = heart(2) * [0.2, 1.0]
    turned = onto_mirror_line(places[:, ::-1])
    assert np.ptp(turned[:, 0]) > 4 * np.ptp(turned[:, 1])
