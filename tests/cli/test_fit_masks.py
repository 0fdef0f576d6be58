"""`petalfit fit` with masks and cameras."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from petalfit import Camera, FitResult, PointCloud, Silhouette
from tests.cli.conftest import contents

CASES = Path(__file__).parents[2] / "data_synthetic" / "cases"
TRUTH = json.loads((CASES / "mask-oblique/truth.json").read_text())["parameters"]


def test_a_mask_and_its_camera(petalfit, tmp_path):
    folder = CASES / "mask-oblique"
    outcome = petalfit(
        "fit", folder / "mask-1.png", "--camera", folder / "camera-1.json", "--out", tmp_path / "o"
    )
    assert outcome.status == 0
    assert "mask of 256 × 256 pixels" in outcome.out
    assert "px (estimated); converged" in outcome.out
    assert "parameters are not determined by this target: rib_frequency" in outcome.err
    result = FitResult.load(tmp_path / "o/fit.json")
    assert abs(result.values["a_x"] - TRUTH["a_x"]) < 5 * result.stderr["a_x"]
    page = (tmp_path / "o/report.html").read_text()
    assert "PeonyPetal fitted to a mask of 256 × 256 pixels" in page
    assert "mask and fitted outline" in page
    assert contents(tmp_path / "o").keys() == {"fit.json", "fit.glb", "report.html"}


def test_a_mask_without_a_camera_is_a_front_view(petalfit, tmp_path):
    outcome = petalfit(
        "fit", CASES / "mask-front/mask-1.png", "--out", tmp_path / "o", "--profile", "c"
    )
    assert outcome.status == 0
    assert "lengths are relative" in outcome.err
    assert "scale" in outcome.out
    assert "c: 95 % profile interval" in outcome.out
    assert "Profile likelihoods" in (tmp_path / "o/report.html").read_text()


@pytest.fixture
def scene(tmp_path):
    """A transforms.json with one camera, its mask, and a cloud."""
    camera = Camera.look_at((40, -50, 80), (0, 12, 0), (256, 256), field_of_view=0.5)
    flip = np.diag([1.0, -1.0, -1.0])
    pose = np.eye(4)
    pose[:3, :3] = camera.rotation.T @ flip
    pose[:3, 3] = -camera.rotation.T @ camera.translation
    frame = {"file_path": "images/petal.jpg", "transform_matrix": pose.tolist()}
    content = {"camera_angle_x": 0.5, "w": 256, "h": 256, "frames": [frame]}
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    shutil.copy(CASES / "mask-oblique/mask-1.png", tmp_path / "petal.png")
    PointCloud(np.random.default_rng(0).normal(size=(50, 3))).save(tmp_path / "cloud.ply")
    return tmp_path, camera


def test_targets_and_cameras_reach_the_fit(petalfit, scene, monkeypatch):
    from tests.fitted import known_pose

    folder, camera = scene
    received = {}

    def fit_petal(target, **options):
        received.update(options, target=target)
        return known_pose()

    monkeypatch.setattr("petalfit.fitting.fit_petal", fit_petal)
    options = ["--camera", folder / "transforms.json", "--model", "Ellipsoid"]
    outcome = petalfit(
        "fit", folder / "cloud.ply", folder / "petal.png", *options, "--out", folder / "o"
    )
    assert outcome.status == 0
    cloud, mask = received["target"]
    assert isinstance(cloud, PointCloud)
    assert isinstance(mask, Silhouette)
    assert received["model"].__name__ == "Ellipsoid"
    np.testing.assert_allclose(mask.camera.matrix, camera.matrix, atol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ([], "there is no TARGET"),
        (["cloud.ply", "--camera", "transforms.json"], "--camera is for masks"),
        (["other.png", "--camera", "transforms.json"], "has no camera for .*other.png; .* petal"),
        (["petal.png", "--camera", "c.json", "--camera", "c.json"], "2 --camera for 1 masks"),
        (["petal.png", "--camera", "bad.json"], "this is no camera"),
        (["petal.png", "--camera", "missing.json"], "cannot be read as cameras"),
        (["petal.png", "--camera", "small.json"], "256 × 256 pixels and its camera 64 × 64"),
        (["photo.png"], "petalfit mask .*photo.png"),
        (["petal.png", "--model", "Rose"], "there is no model 'Rose'; the models are"),
    ],
)
def test_what_cannot_be_used_is_said_with_status_2(petalfit, scene, arguments, match):
    import re

    from PIL import Image

    folder, camera = scene
    shutil.copy(folder / "petal.png", folder / "other.png")
    (folder / "c.json").write_text(json.dumps(camera.to_json()))
    (folder / "bad.json").write_text('{"focal": 3}')
    small = {"rotation": np.eye(3).tolist(), "pixels_per_unit": 1.0, "centre": [0, 0]}
    (folder / "small.json").write_text(json.dumps(small | {"shape": [64, 64]}))
    noise = np.random.default_rng(0).integers(0, 255, (64, 64, 3)).astype(np.uint8)
    Image.fromarray(noise).save(folder / "photo.png")
    paths = [folder / a if "." in a else a for a in arguments]
    outcome = petalfit("fit", *paths, "--out", folder / "o")
    assert outcome.status == 2
    assert re.search(match, outcome.err), outcome.err
    assert outcome.err.count("\n") == 1
    assert not (folder / "o").exists()
