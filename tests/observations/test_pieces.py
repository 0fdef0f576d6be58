"""What a mask shows besides one petal: ignored and named, or refused."""

import numpy as np
import pytest

from petalfit.observations import Contour, Silhouette, TargetError, trace

SHAPE = (200, 160)
ROW, COLUMN = np.mgrid[: SHAPE[0], : SHAPE[1]]
LEAF = ((ROW - 90) / 70) ** 2 + ((COLUMN - 80) / 35) ** 2 < 1
FRAME = (ROW < 5) | (ROW > 194) | (COLUMN < 5) | (COLUMN > 154)


def disc(x, y, radius):
    return np.hypot(COLUMN - x, ROW - y) < radius


def test_a_scale_bar_is_ignored_and_named():
    found = Silhouette(LEAF | ((ROW > 180) & (ROW < 186) & (COLUMN > 10) & (COLUMN < 61)))
    np.testing.assert_array_equal(found.mask, LEAF)
    (note,) = found.notes
    assert "1 small other piece" in note
    assert "50 × 5 pixels at x = 11, y = 181" in note


def test_a_frame_is_ignored_whatever_its_area():
    found = Silhouette(LEAF | FRAME)
    np.testing.assert_array_equal(found.mask, LEAF)
    assert found.notes == ("A frame around the picture was ignored.",)


def test_holes_are_no_rims_and_are_counted():
    holes = disc(70, 80, 6) | disc(90, 110, 4)
    found = Silhouette(LEAF & ~holes)
    assert found.notes == ("2 holes in the mask were ignored: only its outer outline counts.",)
    place, *_ = trace(found.mask)
    assert np.hypot(*(place - [70.5, 80.5]).T).min() > 20
    np.testing.assert_array_equal(Contour.of(found).place, Contour.of(Silhouette(LEAF)).place)


def test_specks_are_not_mentioned():
    assert Silhouette((LEAF | disc(10, 10, 2)) & ~disc(80, 90, 1.5)).notes == ()


def test_a_stalk_is_named():
    stalk = (np.abs(COLUMN - 80) < 3) & (ROW > 150) & (ROW < 198)
    (note,) = Silhouette(LEAF | stalk).notes
    assert "hangs on the petal at x = 80" in note


@pytest.mark.parametrize("power", [0.5, 1.0, 1.5])
def test_a_pointed_tip_is_no_stalk(power):
    along = np.clip((ROW - 20) / 150, 0, 1)
    blade = np.abs(COLUMN - 80) < 40 * np.sin(np.pi * along) ** power
    assert Silhouette(blade & (along > 0) & (along < 1)).notes == ()


@pytest.mark.parametrize(
    ("mask", "match"),
    [
        (~LEAF, "is the mask inverted"),
        (COLUMN + ROW // 50 < 150, "fills .* % of the image's border, where no outline"),
        (LEAF | disc(20, 30, 19), "several objects: 1 more"),
    ],
    ids=["inverted", "background", "two"],
)
def test_what_is_refused(mask, match):
    with pytest.raises(TargetError, match=match):
        Silhouette(mask)


def test_a_fit_repeats_the_notes():
    from petalfit.fitting.inference.verdict import about_targets
    from petalfit.results import Agreement, WarningKind

    target = Silhouette(LEAF & ~disc(70, 80, 6))
    (warning,) = about_targets([Agreement(target, np.zeros(3), np.ones(3), 1.0, None)])
    assert warning.kind is WarningKind.TARGET
    assert warning == target.notes[0]
