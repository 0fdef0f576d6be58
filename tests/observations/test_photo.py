"""Masks of photos that were painted, so that the right mask is known."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from petalfit.observations import TargetError
from petalfit.observations.photo import read_photo, segment

CASES = Path(__file__).parents[3] / "shared/cases"
ROWS, COLUMNS = 240, 320
Y, X = np.mgrid[:ROWS, :COLUMNS] + 0.5
GREEN, ORANGE, RED = (0.12, 0.35, 0.22), (0.95, 0.6, 0.35), (0.85, 0.25, 0.1)


def ellipse(x, y, across, along):
    return ((X - x) / across) ** 2 + ((Y - y) / along) ** 2 < 1


def painted(*objects):
    """Objects on mottled leaves, with the noise and the shading of a photo."""
    rng = np.random.default_rng(0)
    image = np.ones((ROWS, COLUMNS, 3)) * GREEN
    image *= (1 + 0.4 * np.sin(X / 23) * np.cos(Y / 31))[..., None]
    for mask, colour in objects:
        image[mask] = np.array(colour) * (0.85 + 0.15 * np.sin(X / 9))[mask][:, None]
    return np.clip(image + 0.02 * rng.standard_normal(image.shape), 0, 1)


def overlap(a, b):
    return np.sum(a & b) / np.sum(a | b)


FLOWER = ellipse(150, 110, 70, 60)
HEART = ellipse(150, 110, 22, 20)


def test_a_flower_of_two_colours_is_found_alone():
    photo = painted((FLOWER, ORANGE), (HEART, RED))
    assert overlap(segment(photo), FLOWER) > 0.98
    assert overlap(segment(photo, [(200.0, 110.0)]), FLOWER) > 0.98


def test_another_flower_at_the_border_is_cut_off_at_the_neck():
    other = ellipse(180, 245, 60, 50)
    neck = (np.abs(X - 160) < 6) & (Y > 160) & (Y < 220)
    photo = painted((neck, ORANGE), (other, ORANGE), (FLOWER, ORANGE), (HEART, RED))
    assert overlap(segment(photo), FLOWER) > 0.95


def test_a_scan_on_plain_white():
    photo = np.ones((ROWS, COLUMNS, 3))
    photo[FLOWER] = ORANGE
    assert overlap(segment(photo), FLOWER) > 0.98


def test_the_point_chooses():
    other = ellipse(270, 180, 30, 40)
    photo = painted((FLOWER, ORANGE), (other, ORANGE))
    assert overlap(segment(photo), FLOWER) > 0.98
    assert overlap(segment(photo, [(270.0, 180.0)]), other) > 0.95


def test_large_photos_keep_their_edges():
    photo = np.kron(painted((FLOWER, ORANGE)), np.ones((4, 4, 1)))
    expected = np.kron(FLOWER, np.ones((4, 4), bool))
    assert overlap(segment(photo), expected) > 0.98


def test_alpha_is_taken_as_it_is(tmp_path):
    photo = np.dstack([painted(), FLOWER])
    Image.fromarray(np.rint(255 * photo).astype(np.uint8)).save(tmp_path / "a.png")
    np.testing.assert_array_equal(segment(read_photo(tmp_path / "a.png")), FLOWER)


@pytest.mark.parametrize(
    ("photo", "points", "match"),
    [
        (painted((FLOWER, ORANGE)), [(400.0, 10.0)], r"point 400,10 lies outside .* 320 × 240"),
        (np.full((ROWS, COLUMNS, 3), 0.5), [], "nothing stands out|no object"),
    ],
    ids=["outside", "empty"],
)
def test_photos_without_a_petal(photo, points, match):
    with pytest.raises(TargetError, match=match):
        segment(photo, points)


def test_files_that_are_no_photos(tmp_path):
    with pytest.raises(TargetError, match="does not exist"):
        read_photo(tmp_path / "missing.jpg")
    (tmp_path / "a.jpg").write_bytes(b"no photo")
    with pytest.raises(TargetError, match="cannot be read as an image"):
        read_photo(tmp_path / "a.jpg")


CHART = (X < 40) & (Y < 200)
LEAVES = ellipse(150, 130, 22, 45), ellipse(250, 130, 25, 50)


def scanned():
    """Two leaves on paper, with a green chart and tape that touch the border."""
    rng = np.random.default_rng(1)
    image = np.ones((ROWS, COLUMNS, 3)) * (0.92, 0.91, 0.95)
    image[CHART] = (0.45, 0.7, 0.35)
    image[(Y > 230) & (X > 100) & (X < 200)] = (0.85, 0.83, 0.7)
    image[:8] = (0.8, 0.78, 0.65)
    for leaf in LEAVES:
        image[leaf] = (0.25, 0.5, 0.15)
    return np.clip(image + 0.01 * rng.standard_normal(image.shape), 0, 1)


def test_the_paper_of_a_scan_is_no_petal():
    assert overlap(segment(scanned()), LEAVES[1]) > 0.95
    assert overlap(segment(scanned(), [(150.0, 130.0)]), LEAVES[0]) > 0.95


def test_what_fills_the_border_is_refused():
    with pytest.raises(TargetError, match=r"fills .* of its border, .* name more points"):
        segment(scanned(), [(100.0, 50.0)])


def test_bytes_and_numbers_are_the_same_photo():
    photo = np.rint(255 * painted((FLOWER, ORANGE))).astype(np.uint8)
    np.testing.assert_array_equal(segment(photo), segment(photo / 255))


def test_a_corner_cut_off_is_no_mask(tmp_path):
    alpha = np.where(X + Y < 9, 0.0, 1.0)
    photo = np.dstack([painted((FLOWER, ORANGE)), alpha])
    Image.fromarray(np.rint(255 * photo).astype(np.uint8)).save(tmp_path / "a.png")
    assert read_photo(tmp_path / "a.png").shape == (ROWS, COLUMNS, 3)


def test_a_large_alpha_channel_keeps_its_pixels():
    large = np.kron(FLOWER, np.ones((8, 8), bool))
    photo = np.zeros((*large.shape, 4), np.uint8)
    photo[..., 3] = np.uint8(255) * large
    assert np.mean(segment(photo) != large) < 1e-4


@pytest.mark.skipif(not CASES.is_dir(), reason="the cases are not here")
def test_a_scan_with_a_colour_card():
    found = segment(read_photo(CASES / "photo_colour_card/scan_card.jpg"))
    rows, columns = np.nonzero(found)
    assert 0.02 < found.mean() < 0.05
    assert columns.min() > 700
    assert rows.min() > 500
