"""Distortion by a lens is removed from masks: the outline lies where a pinhole would have seen it."""

import numpy as np
import pytest
from scipy.optimize import fsolve

from petalfit.observations import Camera, Contour, Silhouette, TargetError

SHAPE = (360, 480)
FOCAL, MIDDLE = 400.0, (240.0, 180.0)
K = [[FOCAL, 0, MIDDLE[0]], [0, FOCAL, MIDDLE[1]], [0, 0, 1]]
ROW, COLUMN = np.mgrid[: SHAPE[0], : SHAPE[1]] + 0.5


def camera(distortion, fisheye=False):
    return Camera.perspective(
        K, np.eye(3), (0, 0, 1), SHAPE, distortion=distortion, fisheye=fisheye
    )


def opencv(x, y, k1, k2, p1, p2, k3=0.0):
    """The formula of OpenCV's documentation, written down a second time."""
    r = np.sqrt(x * x + y * y)
    radial = 1 + k1 * r**2 + k2 * r**4 + k3 * r**6
    return (
        x * radial + 2 * p1 * x * y + p2 * (r**2 + 2 * x * x),
        y * radial + p1 * (r**2 + 2 * y * y) + 2 * p2 * x * y,
    )


def fisheye(x, y, k1, k2, k3, k4):
    r = np.hypot(x, y)
    angle = np.arctan(r)
    bent = angle + k1 * angle**3 + k2 * angle**5 + k3 * angle**7 + k4 * angle**9
    return x * bent / r, y * bent / r


LENSES = [
    (opencv, (-0.12, 0.05, 0.001, -0.0005)),
    (opencv, (0.2, -0.1, -0.002, 0.003, 0.01)),
    (fisheye, (0.05, -0.02, 0.004, 0.0)),
]
IDS = ["barrel", "cushion", "fisheye"]


@pytest.mark.parametrize(("formula", "coefficients"), LENSES, ids=IDS)
def test_the_contour_is_that_of_a_pinhole(formula, coefficients):
    # A disc in the photo; its rim is undistorted place by place with SciPy.
    place, radius = np.array([290.0, 150.0]), 110.0
    mask = np.clip(radius + 0.5 - np.hypot(COLUMN - place[0], ROW - place[1]), 0, 1)
    angles = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    rim = place + radius * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    seen = (rim - MIDDLE) / FOCAL
    ideal = [fsolve(lambda xy, s=s: np.subtract(formula(*xy, *coefficients), s), s) for s in seen]
    expected = FOCAL * np.array(ideal) + MIDDLE
    silhouette = Silhouette(mask, camera(coefficients, formula is fisheye))
    assert silhouette.camera is not None
    assert silhouette.camera.lens is None
    found = Contour.of(silhouette)
    moved = silhouette.camera.matrix[:2, 2] - MIDDLE  # a margin, if there is one
    apart = np.linalg.norm(found.place[:, None] - (expected + moved), axis=-1).min(axis=0)
    assert apart.max() < 2.0  # places are a step apart
    across = np.linalg.norm(found.place - found.place.mean(axis=0), axis=1)
    middle = (expected + moved).mean(axis=0)
    direction = np.arctan2(*(found.place - middle).T[::-1])
    other = expected + moved - middle
    radii = np.interp(
        direction,
        *zip(
            *sorted(zip(np.arctan2(*other.T[::-1]), np.hypot(*other.T), strict=True)), strict=True
        ),
        period=2 * np.pi,
    )
    np.testing.assert_allclose(np.linalg.norm(found.place - middle, axis=1), radii, atol=0.15)
    assert across.min() > 90


def test_a_petal_at_the_border_stays_in_the_picture():
    mask = np.hypot(COLUMN - 80, ROW - 180) < 74
    silhouette = Silhouette(mask, camera((-0.25, 0.0, 0.0, 0.0)))
    assert silhouette.mask.shape[0] > SHAPE[0]
    assert silhouette.area > mask.sum()
    contour = Contour.of(silhouette)
    assert np.mean(contour.length > 0) > 0.97


def test_a_lens_that_moves_no_pixel_is_none():
    assert camera((1e-6, 0, 0, 0)).lens is None
    assert camera((0.01, 0, 0, 0)).lens is not None


def test_cameras_with_a_lens_are_saved_and_scaled():
    one = camera((-0.1, 0.02, 0.001, 0))
    again = Camera.from_json(one.to_json())
    assert again.lens == one.lens
    half = one.resized((180, 240))
    assert half.lens is not None
    places = np.array([[100.0, 60.0], [10.0, 170.0]])
    np.testing.assert_allclose(half.lens.distorted(places), one.lens.distorted(2 * places) / 2)


def test_coefficients_that_are_not_known_are_refused():
    with pytest.raises(TargetError, match="undistort the images"):
        camera((0.1, 0, 0, 0, 0, 0, 0, 0, 0.2))
    with pytest.raises(TargetError, match="NaN"):
        camera((np.nan, 0, 0, 0))
