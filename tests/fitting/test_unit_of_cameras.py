"""Masks with cameras in any unit show the same petal: tools scale their scenes as they like."""

import numpy as np
import pytest

import petalfit as pf
from petalfit.components import scales_with_lengths
from petalfit.fitting.silhouettes.view_pose import size_in_space
from petalfit.fitting.starts.support import Shadow
from petalfit.observations import Contour

SCALES = (0.0061, 1.0, 1000.0)
EYES = np.array([[60.0, -70.0, 90.0], [-100.0, 30.0, 60.0]])
FREE = ("length", "width", "bend", "cup_mid")
TURN = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
SHIFT = np.array([5.0, -8.0, 3.0])


def camera(eye, scale):
    target = TURN @ [0.0, 10.0, 0.0] + SHIFT
    return pf.Camera.look_at(scale * eye, scale * target, (160, 160), field_of_view=0.5)


@pytest.fixture(scope="module")
def masks():
    leaf = pf.BladePetal(length=25.0, width=0.5, bend=0.6, cup_mid=0.5)
    posed = pf.components.Posed(leaf, TURN, SHIFT, np.float64(1.0))
    return [posed.silhouette(camera(eye, 1.0)).mask >= 0.5 for eye in EYES]


@pytest.mark.parametrize(
    "scale", [SCALES[0], *(pytest.param(s, marks=pytest.mark.slow) for s in SCALES[1:])]
)
def test_the_petal_is_the_same(masks, scale):
    targets = [
        pf.Silhouette(mask, camera(eye, scale)) for mask, eye in zip(masks, EYES, strict=True)
    ]
    result = pf.fit_petal(targets, model=pf.BladePetal, pose="rigid", free=FREE, throw=False)
    assert result.pose.scale == pytest.approx(1.0)
    assert result.values["length"] / scale == pytest.approx(25.0, rel=0.02)
    assert result.values["width"] == pytest.approx(0.5, rel=0.03)
    assert result.stderr["length"] / scale < 0.5
    assert result.traits["length"].value / scale == pytest.approx(25.0, rel=0.02)
    place = np.asarray(result.pose.translation) / scale
    np.testing.assert_allclose(place, SHIFT, atol=0.5)
    for start in result.starts:
        assert 5 < start.values["length"] / scale < 100


@pytest.mark.parametrize("scale", SCALES)
def test_the_size_in_space(masks, scale):
    shadows = [
        Shadow.of(Contour.of(pf.Silhouette(mask, camera(eye, scale))))
        for mask, eye in zip(masks, EYES, strict=True)
    ]
    centre = scale * (TURN @ [0.0, 10.0, 0.0] + SHIFT)
    assert size_in_space(shadows, centre) / scale == pytest.approx(25.0, rel=0.15)


def test_which_shapes_have_lengths_of_their_own():
    assert scales_with_lengths(pf.BladePetal())
    assert scales_with_lengths(pf.Ellipsoid())
    assert not scales_with_lengths(pf.PeonyPetal())
