"""Masks with known cameras, of a petal that lies anywhere before them."""

import jax
import numpy as np
import pytest

import petalfit as pf
from petalfit.fitting.silhouettes.view_pose import middle
from petalfit.fitting.starts.support import Shadow
from petalfit.observations import Contour
from petalfit.synthetic import random_petal

DIRECTIONS = np.array([[0.6, -0.8, 1.2], [-1.0, 0.2, 0.8]])
ABOUT = np.array([0.0, 12.0, 0.0])


def seen(
    petal: pf.PeonyPetal, rotation: np.ndarray, shift: np.ndarray, directions: np.ndarray
) -> list[pf.Silhouette]:
    """Binary masks of the petal posed, which is seen where cameras that move with it see it."""
    masks = []
    for direction in directions / np.linalg.norm(directions, axis=1, keepdims=True):
        eye, up = ABOUT + 90 * direction, np.array([0.0, 1.0, 0.0])
        own = pf.Camera.look_at(eye, ABOUT, (256, 256), field_of_view=0.55, up=up)
        eye, about = rotation @ eye + shift, rotation @ ABOUT + shift
        camera = pf.Camera.look_at(eye, about, (256, 256), field_of_view=0.55, up=rotation @ up)
        masks.append(pf.Silhouette(petal.silhouette(own).mask >= 0.5, camera))
    return masks


@pytest.fixture(scope="module")
def pose() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(6)
    q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    return q * np.linalg.det(q), rng.uniform(-3, 3, 3)


def test_a_petal_is_found_before_two_cameras(pose):
    rotation, shift = pose
    petal = random_petal(np.random.default_rng(1))
    result = pf.fit_petal(seen(petal, rotation, shift, DIRECTIONS), pose="rigid")
    for name in ("a_x", "b_y", "c"):
        assert result.values[name] == pytest.approx(float(getattr(petal, name)), rel=0.01), name
    assert result.values["dx"] == pytest.approx(float(petal.dx), rel=0.03)
    turn = np.asarray(result.pose.rotation).T @ rotation
    assert np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))) < 0.3
    place = np.asarray(result.pose(np.zeros(3)))
    np.testing.assert_allclose(place, rotation @ [0, 0, float(petal.c_z)] + shift, atol=0.1)
    assert set(result.pose_stderr) == set(pf.components.Posed.rigid)
    assert "c_z" not in result.names
    assert not result.identifiable["rib_frequency"]


def test_the_middle_is_where_the_rays_meet():
    ball, eyes = pf.Ellipsoid(r_x=4.0, r_y=4.0, r_z=4.0), 60 * DIRECTIONS
    aside = np.array([3.0, -2.0, 5.0])  # so that it is not in the middle of its images
    cameras = [pf.Camera.look_at(eye, aside, (256, 256), field_of_view=0.4) for eye in eyes]
    with jax.enable_x64(True):
        shadows = [Shadow.of(Contour.of(ball.silhouette(camera))) for camera in cameras]
    # Perspective moves the middle of a ball's image a little.
    assert np.linalg.norm(middle(shadows)) < 0.1
    # A single ray has no end: the place on it nearest to the world's origin.
    single = middle(shadows[:1])
    ray = (single - eyes[0]) / np.linalg.norm(single - eyes[0])
    assert abs(single @ ray) < 1e-6
    assert np.linalg.norm(single) < 0.1


def test_masks_that_have_no_pose_to_be_found_are_refused(pose):
    masks = seen(pf.PeonyPetal(), *pose, DIRECTIONS[:1])
    with pytest.raises(pf.TargetError, match="does not go with these masks"):
        pf.fit_petal(masks, pose="similarity")
    with pytest.raises(pf.TargetError, match="does not go with these masks"):
        pf.fit_petal(pf.Silhouette(masks[0].mask), pose="rigid")
    with pytest.raises(pf.TargetError, match="init has no pose"):
        pf.fit_petal(masks, pose="rigid", init=pf.PeonyPetal())
    with pytest.raises(pf.TargetError, match="for one cloud, or for masks"):
        pf.fit_petal([*masks, pf.PeonyPetal().sample(50)], pose="rigid")
