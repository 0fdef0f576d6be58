"""Cameras against plain formulas, and against what people get wrong."""

import json

import numpy as np
import pytest
from PIL import Image

from petalfit.observations import Camera, TargetError, read_cameras, read_transforms

TURN = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
K = np.array([[300.0, 0.0, 120.0], [0.0, 310.0, 90.0], [0.0, 0.0, 1.0]])
POINTS = np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0], [-2.0, 0.5, 1.5]])


def test_orthographic():
    camera = Camera.orthographic(TURN, 5.0, (30.0, 40.0), (100, 200))
    expected = 5.0 * (POINTS @ TURN.T)[:, :2] + [30.0, 40.0]
    np.testing.assert_allclose(camera.project(POINTS), expected)
    np.testing.assert_allclose(camera.depth(POINTS), POINTS @ TURN[2])
    assert camera.is_orthographic
    assert repr(camera) == "Camera(orthographic, 100 × 200 pixels)"
    with pytest.raises(ValueError, match="read-only"):
        camera.matrix[0, 0] = 1.0


def test_perspective():
    translation = np.array([0.5, -1.0, 10.0])
    camera = Camera.perspective(2 * K, TURN, translation, (100, 200))  # K up to scale
    seen = (POINTS @ TURN.T + translation) @ K.T
    np.testing.assert_allclose(camera.project(POINTS), seen[:, :2] / seen[:, 2:])
    np.testing.assert_allclose(camera.depth(POINTS), seen[:, 2])
    assert not camera.is_orthographic


@pytest.mark.parametrize("scale", [None, 4.0], ids=["perspective", "orthographic"])
def test_look_at_sees_the_target_in_the_middle_and_up_upwards(scale):
    eye, target = np.array([3.0, 4.0, 5.0]), np.array([1.0, 2.0, 0.0])
    camera = Camera.look_at(eye, target, (60, 80), pixels_per_unit=scale)
    np.testing.assert_allclose(camera.project(target), [40.0, 30.0])
    above = camera.project(target + np.array([0.0, 0.1, 0.0]))
    assert above[0] == pytest.approx(40.0)
    assert above[1] < 30.0
    forward = target - eye
    np.testing.assert_allclose(camera.rotation[2], forward / np.linalg.norm(forward))
    assert camera.project(target + 0.1 * np.cross(forward, [0, 1, 0]))[0] > 40.0  # right is right


def test_field_of_view_spans_the_width():
    camera = Camera.look_at((0, 0, 10), (0, 0, 0), (60, 80), field_of_view=1.0)
    edge = 10 * np.tan(0.5)
    np.testing.assert_allclose(camera.project(np.array([edge, 0.0, 0.0])), [80.0, 30.0])


MIRROR = np.diag([1.0, 1.0, -1.0])


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: Camera.orthographic(1.01 * TURN, 5.0, (0, 0), (9, 9)), "not orthonormal"),
        (lambda: Camera.orthographic(MIRROR, 5.0, (0, 0), (9, 9)), "mirrors"),
        (lambda: Camera.orthographic(TURN[:2], 5.0, (0, 0), (9, 9)), r"shape \(3, 3\)"),
        (lambda: Camera.orthographic(TURN * np.nan, 5.0, (0, 0), (9, 9)), "NaN"),
        (lambda: Camera.orthographic(TURN, -5.0, (0, 0), (9, 9)), "pixels_per_unit is -5"),
        (lambda: Camera.orthographic(TURN, 5.0, (0, 0), (9, 0)), "rows, columns"),
        (lambda: Camera.orthographic(TURN, 5.0, (0, 0), (9, 10**6)), "32768"),
        (lambda: Camera.perspective(K * 0, TURN, (0, 0, 1), (9, 9)), "singular"),
        (lambda: Camera.perspective(K.T, TURN, (0, 0, 1), (9, 9)), "singular or no intrinsic"),
        (lambda: Camera.perspective(-K, MIRROR, (0, 0, 1), (9, 9)), "mirrors"),
        (lambda: Camera.look_at((0, 0, 1), (0, 0, 1), (9, 9)), "coincide"),
        (lambda: Camera.look_at((0, 5, 0), (0, 0, 0), (9, 9)), "up lies along"),
        (lambda: Camera.look_at((0, 0, 5), (0, 0, 0), (9, 9), field_of_view=60.0), "radians"),
    ],
    ids=[f"{i}" for i in range(13)],
)
def test_what_is_no_camera(make, match):
    with pytest.raises(TargetError, match=match):
        make()


POSE = np.eye(4)
POSE[:3, 3] = [0.0, 0.0, 10.0]  # ten units up the z axis, looking down it, y up


def write(folder, **fields):
    path = folder / "transforms.json"
    frames = fields.pop("frames", [{"file_path": "a.png", "transform_matrix": POSE.tolist()}])
    path.write_text(json.dumps(fields | {"frames": frames}))
    return path


def test_transforms_of_nerf_tools(tmp_path):
    path = write(tmp_path, fl_x=100.0, fl_y=110.0, cx=40.0, cy=30.0, w=80, h=60, k1=0.0)
    camera = read_transforms(path)["a.png"]
    assert camera.shape == (60, 80)
    seen = camera.project(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]))
    np.testing.assert_allclose(seen, [[40, 30], [50, 30], [40, 19]])  # y up is up in the image
    np.testing.assert_allclose(camera.depth(np.zeros((1, 3))), 10.0)


def test_transforms_of_blender_take_the_size_from_the_image(tmp_path):
    Image.new("RGBA", (80, 60)).save(tmp_path / "r_0.png")
    frames = [{"file_path": "./r_0", "transform_matrix": POSE.tolist()}]
    camera = read_transforms(write(tmp_path, camera_angle_x=1.0, frames=frames))["./r_0"]
    edge = np.array([[10 * np.tan(0.5), 0.0, 0.0]])
    np.testing.assert_allclose(camera.project(edge), [[80.0, 30.0]])


@pytest.mark.parametrize(
    ("fields", "match"),
    [
        ({"fl_x": 100.0}, "image .*a.png"),
        ({"fl_x": 100.0, "w": 8, "h": 6, "k4": 0.1}, "distortion k4 of this camera"),
        ({"w": 8, "h": 6, "camera_model": "EQUIRECTANGULAR", "fl_x": 1.0}, "EQUIRECTANGULAR"),
        ({"w": 8, "h": 6}, "camera_angle_x"),
        ({"frames": []}, "no frames"),
        ({"frames": [{"file_path": "a.png"}], "fl_x": 1.0, "w": 8, "h": 6}, "transform_matrix"),
        ({"frames": 3}, "no transforms.json"),
    ],
)
def test_transforms_that_cannot_be_used(tmp_path, fields, match):
    with pytest.raises(TargetError, match=match):
        read_transforms(write(tmp_path, **fields))


def test_no_transforms_at_all(tmp_path):
    with pytest.raises(TargetError, match="cannot be read"):
        read_transforms(tmp_path / "missing.json")
    (tmp_path / "list.json").write_text("[1, 2]")
    with pytest.raises(TargetError, match="is no transforms"):
        read_transforms(tmp_path / "list.json")


@pytest.mark.parametrize(
    "camera",
    [
        Camera.look_at((3, 4, 5), (0, 0, 0), (48, 64), pixels_per_unit=2.0),
        Camera.look_at((3, 4, 5), (0, 0, 0), (48, 64)),
    ],
)
def test_json_gives_back_the_same_camera(camera, tmp_path):
    (tmp_path / "camera.json").write_text(json.dumps(camera.to_json()))
    again = read_cameras(tmp_path / "camera.json")
    for name in ("matrix", "rotation", "translation"):
        np.testing.assert_array_equal(getattr(again, name), getattr(camera, name))
    assert again.shape == camera.shape
    assert again.is_orthographic == camera.is_orthographic


def test_json_of_a_constructors_arguments():
    rotation = np.eye(3).tolist()
    fields = {"rotation": rotation, "shape": [48, 64]}
    flat = Camera.from_json(fields | {"pixels_per_unit": 2.0, "centre": [1, 2]})
    np.testing.assert_allclose(flat.project(np.array([[1.0, 1, 1]])), [[3, 4]])
    intrinsics = [[10, 0, 3], [0, 10, 4], [0, 0, 1]]
    deep = Camera.from_json(fields | {"K": intrinsics, "translation": [0, 0, 5]})
    np.testing.assert_allclose(deep.project(np.array([[1.0, 1, 0]])), [[5, 6]])
    for bad in ({}, {"K": intrinsics}, fields, fields | {"matrix": [[1, 2], [3, 4]]}, [1, 2]):
        with pytest.raises(TargetError):
            Camera.from_json(bad)
