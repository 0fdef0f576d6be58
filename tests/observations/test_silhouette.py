"""Masks: read as they were written, and refused with a reason."""

import numpy as np
import pytest
from PIL import Image

from petalfit.observations import Camera, Silhouette, TargetError

SHAPE = (40, 60)
ROW, COLUMN = np.mgrid[: SHAPE[0], : SHAPE[1]]
DISC = np.hypot(ROW - 20, COLUMN - 30) < 12
RAMP = np.clip(12.5 - np.hypot(ROW - 20, COLUMN - 30), 0, 1)
CAMERA = Camera.orthographic(np.eye(3), 1.0, (30, 20), SHAPE)


def test_masks_are_copied_checked_and_read_only():
    weights = np.where(COLUMN < 30, 1.0, 0.5)
    silhouette = Silhouette(DISC, CAMERA, weights)
    assert silhouette.mask.dtype == np.float64
    assert silhouette.area == DISC.sum()
    assert silhouette.is_binary
    assert repr(silhouette) == "Silhouette(40 × 60 pixels, binary, camera, weights)"
    assert repr(Silhouette(RAMP)) == "Silhouette(40 × 60 pixels, coverage)"
    with pytest.raises(ValueError, match="read-only"):
        silhouette.mask[0, 0] = 1


@pytest.mark.parametrize("mask", [DISC, RAMP], ids=["binary", "coverage"])
def test_saving_keeps_eight_bits(tmp_path, mask):
    Silhouette(mask).save(tmp_path / "mask.png")
    loaded = Silhouette.load(tmp_path / "mask.png", CAMERA)
    np.testing.assert_allclose(loaded.mask, mask, atol=0.5 / 255 + 1e-9)
    assert loaded.camera is CAMERA


@pytest.mark.parametrize("kind", ["alpha", "bit", "palette", "rgb", "sixteen"])
def test_kinds_of_images(tmp_path, kind):
    grey = Image.fromarray((255 * DISC).astype(np.uint8))
    photo = np.random.default_rng(0).integers(0, 256, (*SHAPE, 3)).astype(np.uint8)
    image = {
        "alpha": lambda: Image.fromarray(np.dstack([photo, np.asarray(grey)])),
        "bit": lambda: grey.convert("1"),
        "palette": lambda: grey.convert("P"),
        "rgb": lambda: grey.convert("RGB"),
        "sixteen": lambda: Image.fromarray((65535 * DISC).astype(np.uint16)),
    }[kind]()
    image.save(tmp_path / "mask.png")
    np.testing.assert_array_equal(Silhouette.load(tmp_path / "mask.png").mask, DISC)


TWO = DISC | (np.hypot(ROW - 20, COLUMN - 52) < 6)


@pytest.mark.parametrize(
    ("mask", "options", "match"),
    [
        (DISC & False, {}, "blank"),
        (DISC | True, {}, "full"),
        (255 * RAMP, {}, "divide 8-bit grey values by 255"),
        (np.where(DISC, np.nan, 0), {}, "NaN"),
        (np.dstack([DISC] * 3), {}, "petalfit mask PHOTO"),
        (DISC.ravel(), {}, r"expected \(H, W\)"),
        (np.full(SHAPE, "a"), {}, r"expected \(H, W\)"),
        (DISC[:30], {"camera": CAMERA}, "30 × 60 pixels and its camera 40 × 60"),
        (TWO, {}, "several objects: 1 more"),
        (DISC, {"weights": np.ones((3, 3))}, "weights have shape"),
        (DISC, {"weights": -np.ones(SHAPE)}, "at least 0"),
        (DISC, {"weights": np.zeros(SHAPE)}, "not 0 everywhere"),
    ],
)
def test_what_is_no_mask(mask, options, match):
    with pytest.raises(TargetError, match=match):
        Silhouette(mask, **options)


def test_another_object_without_weight_is_let_pass():
    assert Silhouette(TWO, weights=np.where(COLUMN < 44, 1.0, 0.0)).area == TWO.sum()
    speck = DISC.copy()
    speck[2, 2] = True
    Silhouette(speck)


def test_files_that_are_no_masks(tmp_path):
    with pytest.raises(TargetError, match="does not exist"):
        Silhouette.load(tmp_path / "missing.png")
    (tmp_path / "a.png").write_bytes(b"no image")
    with pytest.raises(TargetError, match="cannot be read as an image"):
        Silhouette.load(tmp_path / "a.png")
    photo = np.random.default_rng(0).integers(0, 256, (*SHAPE, 3)).astype(np.uint8)
    Image.fromarray(photo).save(tmp_path / "photo.png")
    with pytest.raises(TargetError, match=r"petalfit mask .*photo\.png -o MASK\.png"):
        Silhouette.load(tmp_path / "photo.png")
    Image.fromarray(photo).convert("L").save(tmp_path / "grey.png")
    with pytest.raises(TargetError, match="looks like a photo"):
        Silhouette.load(tmp_path / "grey.png")
    Image.fromarray(np.dstack([photo, np.full(SHAPE, 255, np.uint8)])).save(tmp_path / "opaque.png")
    with pytest.raises(TargetError, match="looks like a photo"):
        Silhouette.load(tmp_path / "opaque.png")
