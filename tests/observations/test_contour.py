"""Contours to a fraction of a pixel, and which of them are trusted."""

import numpy as np
import pytest

from petalfit.observations import Camera, Contour, Silhouette, TargetError, trace

SHAPE = (120, 160)
ROW, COLUMN = np.mgrid[: SHAPE[0], : SHAPE[1]] + 0.5


def disc(x, y, radius):
    return np.clip(radius + 0.5 - np.hypot(COLUMN - x, ROW - y), 0, 1)


@pytest.mark.parametrize("binary", [True, False])
def test_a_disc(binary):
    mask = disc(70.3, 60.8, 35)
    place, normal, length = trace(mask >= 0.5 if binary else mask)
    offset = place - [70.3, 60.8]
    radius = np.linalg.norm(offset, axis=1)
    np.testing.assert_allclose(radius, 35, atol=0.75 if binary else 0.12)
    assert radius.mean() == pytest.approx(35, abs=0.05)
    assert np.sum(offset * normal, axis=1).min() > 34
    assert length.sum() == pytest.approx(2 * np.pi * 35, rel=0.06 if binary else 0.01)
    np.testing.assert_allclose(length, length.mean(), rtol=1e-9)


def test_specks_and_pinholes_are_left_out():
    mask = disc(70, 60, 35)
    mask[5:7, 5:7] = 1
    mask[60, 70] = 0
    place, *_ = trace(mask)
    assert np.linalg.norm(place - [70, 60], axis=1).min() > 34


def test_the_border_of_the_image_is_no_contour():
    contour = Contour.of(Silhouette(disc(150, 60, 35)))
    used = contour.length > 0
    assert contour.place[used, 0].max() < 159
    assert not contour.binary
    np.testing.assert_array_equal(contour.camera.project(np.array([[3.0, 4.0, 5.0]])), [[3, 4]])
    assert contour.trust(np.array([[-5.0, 10], [80, 60], [80, 0.5], [170, 60]])).tolist() == [
        0, 1, 0, 0,
    ]  # fmt: skip


def test_weights_take_the_contour_away():
    weights = np.where(COLUMN < 70, 1.0, 0.0)
    weights[:, :50] = 0.5
    contour = Contour.of(Silhouette(disc(70, 60, 35), weights=weights))
    assert contour.place[contour.length > 0, 0].max() < 70
    step = contour.length.max()
    far_left = contour.place[:, 0] < 48
    np.testing.assert_allclose(contour.length[far_left], 0.5 * step)


def test_a_long_contour_is_sampled_widely():
    big = np.zeros((1500, 1500), bool)
    big[100:1400, 100:1400] = True
    place, _, length = trace(big)
    assert len(place) <= 2100
    assert length.sum() == pytest.approx(4 * 1300, rel=0.01)


def test_a_contour_that_nobody_vouches_for():
    weights = np.ones(SHAPE)
    weights[20:100, 30:110] = 0
    weights[55:65, 65:75] = 1
    camera = Camera.orthographic(np.eye(3), 1.0, (0, 0), SHAPE)
    with pytest.raises(TargetError, match="too little of the mask's contour"):
        Contour.of(Silhouette(disc(70, 60, 35), camera, weights))


def test_an_empty_picture_has_no_contour():
    assert len(trace(np.zeros((10, 10)))[0]) == 0
