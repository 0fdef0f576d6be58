"""Folders of a capture: masks or images, with the cameras of a reconstruction."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import petalfit as pf
from petalfit.fitting.request.targets import as_targets
from petalfit.observations import Silhouette, TargetError, read_capture

SHAPE = (60, 80)
ROW, COLUMN = np.mgrid[: SHAPE[0], : SHAPE[1]]


def leaf(number):
    return np.hypot(ROW - 30, COLUMN - 40 - number) < 12 + number


def photo(number):
    colours = np.where(leaf(number)[..., None], (60, 140, 50), (230, 225, 235))
    noise = np.random.default_rng(number).integers(-5, 6, colours.shape)
    return Image.fromarray((colours + noise).astype(np.uint8))


@pytest.fixture
def capture(tmp_path):
    """Cameras of three images; the files are written by each test."""
    frames = []
    for k in range(3):
        pose = np.eye(4)
        pose[2, 3] = 10.0 + k
        frames.append({"file_path": f"images/f_{k}.png", "transform_matrix": pose.tolist()})
    content = {"fl_x": 100.0, "w": 80, "h": 60, "frames": frames}
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    for name in ("images", "masks"):
        (tmp_path / name).mkdir()
    return tmp_path


def check(found: list[Silhouette], numbers: list[int], least: float = 1.0) -> None:
    assert len(found) == len(numbers)
    for silhouette, k in zip(found, numbers, strict=True):
        agreement = np.sum((silhouette.mask >= 0.5) & leaf(k)) / np.sum(
            (silhouette.mask >= 0.5) | leaf(k)
        )
        assert agreement >= least
        assert silhouette.camera is not None
        assert silhouette.camera.depth(np.zeros((1, 3)))[0] == pytest.approx(10 + k)


def test_masks_beside_the_images(capture):
    for k in range(3):
        photo(k).save(capture / f"images/f_{k}.png")
    for k in (0, 2):
        Silhouette(leaf(k)).save(capture / f"masks/f_{k}.png")
    check(read_capture(capture), [0, 2])


def test_masks_by_mask_path(capture):
    content = json.loads((capture / "transforms.json").read_text())
    for k, frame in enumerate(content["frames"]):
        frame["mask_path"] = f"masks/m{2 - k}.png"
        Silhouette(leaf(k)).save(capture / f"masks/m{2 - k}.png")
    (capture / "transforms.json").write_text(json.dumps(content))
    check(read_capture(capture), [0, 1, 2])


def test_images_that_are_masks_or_have_an_alpha_channel(capture):
    Silhouette(leaf(0)).save(capture / "images/f_0.png")
    image = photo(1)
    image.putalpha(Image.fromarray(np.uint8(255) * leaf(1)))
    image.save(capture / "images/f_1.png")
    check(read_capture(capture), [0, 1])


def test_photos_are_masked_and_say_so(capture):
    photo(1).save(capture / "images/f_1.png")
    found = read_capture(capture)
    check(found, [1], least=0.93)
    assert found[0].notes == (
        "Masks were found in 1 of the photos; `petalfit mask` shows what it finds.",
    )


def test_a_folder_is_a_target_in_python(capture):
    for k in range(3):
        Silhouette(leaf(k)).save(capture / f"masks/f_{k}.png")
    check([x for x in as_targets(str(capture), None) if isinstance(x, Silhouette)], [0, 1, 2])
    with pytest.raises(TargetError, match="cameras of its own"):
        as_targets(str(capture), pf.Camera.look_at((0, 0, 9), (0, 0, 0), SHAPE))


def test_a_folder_is_a_target_of_the_command(capture, monkeypatch):
    from petalfit.cli.fit import _read

    for k in range(3):
        Silhouette(leaf(k)).save(capture / f"masks/f_{k}.png")
    check([x for x in _read((capture,), ()) if isinstance(x, Silhouette)], [0, 1, 2])


def test_folders_without_what_is_needed(capture, tmp_path):
    with pytest.raises(TargetError, match=r"cameras of 3 images, such as images/f_0.png"):
        read_capture(capture)
    with pytest.raises(TargetError, match="is no folder"):
        read_capture(tmp_path / "missing")
    (empty := tmp_path / "empty").mkdir()
    with pytest.raises(TargetError, match=r"is a folder without transforms\.json"):
        read_capture(empty)
    Image.new("RGB", (80, 60), (90, 90, 90)).save(capture / "images/f_0.png")
    with pytest.raises(TargetError, match=r"f_0.png: .*Save masks as masks/f_0.png"):
        read_capture(Path(capture))
