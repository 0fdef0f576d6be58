"""Cameras of reconstructions: COLMAP, calibrations, and which image a mask belongs to."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from petalfit.observations import (
    Camera,
    Silhouette,
    TargetError,
    cameras_of,
    read_cameras,
    read_frames,
)
from petalfit.observations.frames import Frame

TURN = Rotation.from_rotvec([0.3, -0.5, 1.1])
QUATERNION = TURN.as_quat(scalar_first=True)
SHIFT = (1.0, -2.0, 30.0)
K = [[500.0, 0, 320], [0, 510, 240], [0, 0, 1]]
ONE = Camera.perspective(K, TURN.as_matrix(), SHIFT, (480, 640))


def frames(*images, masks=None):
    return [
        Frame(name, Camera.perspective(K, np.eye(3), (0, 0, 1 + k), (480, 640)), mask)
        for k, (name, mask) in enumerate(zip(images, masks or [None] * len(images), strict=True))
    ]


@pytest.mark.parametrize(
    ("mask", "which"),
    [
        ("a.png", 0),
        ("masks/b.jpg.png", 1),
        ("b.jpg", 1),
        ("b.png.png", 1),
        ("masks/train/c.png", 2),
        ("test/c.png", 3),
        ("elsewhere/0007.png", 4),
        ("masks/0007.png", 4),
    ],
)
def test_masks_find_their_images(mask, which):
    known = frames(
        "images/a.JPG", "images/b.jpg", "train/c.png", "test/c.png", "images/IMG_1.jpg",
        masks=[None] * 4 + ["masks/0007.png"],
    )  # fmt: skip
    assert cameras_of([Path(mask)], known, Path("t.json")) == [known[which].camera]


def test_names_that_are_missing_or_ambiguous_are_refused():
    known = frames("images/a.png", "images_test/a.png")
    with pytest.raises(TargetError, match=r"images/a.png, images_test/a.png, which .* all has"):
        cameras_of([Path("a.png")], known, Path("t.json"))
    with pytest.raises(TargetError, match=r"no camera for b.png; it has those of a, a"):
        cameras_of([Path("b.png")], known, Path("t.json"))


def colmap_text(folder, model="PINHOLE", params="500 510 320 240"):
    (folder / "cameras.txt").write_text(f"# cameras\n1 {model} 640 480 {params}\n")
    pose = " ".join(map(repr, map(float, (*QUATERNION, *SHIFT))))
    lines = f"# images\n1 {pose} 1 a b.jpg\n\n2 {pose} 1 c.jpg\n1 2 -1 3 4 -1\n"
    (folder / "images.txt").write_text(lines)


def colmap_binary(folder):
    cameras = struct.pack("<QiiQQ4d", 1, 1, 1, 640, 480, 500, 510, 320, 240)
    images = struct.pack("<Q", 2)
    for number, name, points in ((1, b"a b.jpg", 0), (2, b"c.jpg", 2)):
        images += struct.pack("<i7di", number, *QUATERNION, *SHIFT, 1) + name + b"\0"
        images += struct.pack("<Q", points) + bytes(24 * points)
    (folder / "cameras.bin").write_bytes(cameras)
    (folder / "images.bin").write_bytes(images)


@pytest.mark.parametrize("write", [colmap_text, colmap_binary])
def test_models_of_colmap(tmp_path, write):
    folder = tmp_path / "sparse/0"
    folder.mkdir(parents=True)
    write(folder)
    for path in (folder, tmp_path, next(folder.glob("images.*"))):
        found = read_cameras(path)
        assert isinstance(found, dict)
        assert [*found] == ["a b.jpg", "c.jpg"]
        np.testing.assert_allclose(found["c.jpg"].matrix, ONE.matrix, atol=1e-9)


def test_lenses_of_colmap(tmp_path):
    colmap_text(tmp_path, "SIMPLE_RADIAL", "500 320 240 -0.1")
    found = read_frames(tmp_path)
    assert isinstance(found, list)
    assert found[0].camera.lens is not None
    assert found[0].camera.lens.coefficients == (-0.1, 0, 0, 0, 0, 0, 0, 0)


@pytest.mark.parametrize(
    ("model", "params", "match"),
    [
        ("FOV", "500 500 320 240 1", "camera model FOV is not known"),
        ("PINHOLE", "500", "has 4 parameters, not 1"),
        ("PINHOLE", "500 x 1 2", "could not convert"),
    ],
)
def test_models_that_cannot_be_used(tmp_path, model, params, match):
    colmap_text(tmp_path, model, params)
    with pytest.raises(TargetError, match=match):
        read_cameras(tmp_path)


@pytest.mark.parametrize(
    "content",
    [
        {"camera_matrix": K, "dist_coeff": [0] * 5, "rvec": [0.3, -0.5, 1.1], "tvec": SHIFT,
         "image_width": 640, "image_height": 480},
        {"K": K, "R": TURN.as_matrix().tolist(), "t": SHIFT, "width": 640, "height": 480},
        {"camera_matrix": {"rows": 3, "cols": 3, "data": np.ravel(K).tolist()},
         "rvecs": [[0.3], [-0.5], [1.1]], "T": [[x] for x in SHIFT], "image_size": [640, 480]},
        {"K": K, "rotation": TURN.as_matrix().tolist(), "translation": SHIFT, "shape": [480, 640]},
    ],
    ids=["opencv", "K R t", "nested", "own"],
)  # fmt: skip
def test_calibrations(tmp_path, content):
    (tmp_path / "camera.json").write_text(json.dumps(content))
    found = read_cameras(tmp_path / "camera.json")
    assert isinstance(found, Camera)
    np.testing.assert_allclose(found.matrix, ONE.matrix, atol=1e-9)
    assert found.shape == (480, 640)


@pytest.mark.parametrize(
    ("content", "match"),
    [
        ({"K": K, "width": 640, "height": 480}, "no pose of the camera"),
        ({"K": K, "R": np.eye(3).tolist(), "t": [0, 0, 1]}, "size of the image is missing"),
        ([1, 2], "no camera but list"),
        ({"K": K, "R": np.eye(3).tolist(), "t": [0, 0, 1e300], "w": 4, "h": 4}, "beyond"),
    ],
)
def test_calibrations_that_cannot_be_used(tmp_path, content, match):
    (tmp_path / "camera.json").write_text(json.dumps(content))
    with pytest.raises(TargetError, match=match):
        read_cameras(tmp_path / "camera.json")


def test_a_mask_may_be_a_smaller_copy_of_its_image():
    mask = np.zeros((120, 160))
    mask[40:80, 60:100] = 1
    silhouette = Silhouette(mask, ONE)
    assert silhouette.camera is not None
    assert silhouette.camera.shape == (120, 160)
    points = np.random.default_rng(0).normal(size=(5, 3))
    np.testing.assert_allclose(silhouette.camera.project(points), ONE.project(points) / 4)
    with pytest.raises(TargetError, match="lies on its side"):
        Silhouette(mask.T, ONE.resized((120, 160)))
    with pytest.raises(TargetError, match="must agree"):
        Silhouette(mask[:100], ONE)
