"""One mask, written as different tools write it, is one mask."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import petalfit as pf
from petalfit.observations import Contour, Silhouette, TargetError, read_target

SHAPE = (60, 90)
ROW, COLUMN = np.mgrid[: SHAPE[0], : SHAPE[1]]
LEAF = ((ROW - 30) / 24) ** 2 + ((COLUMN - 45) / 14) ** 2 < 1
SOFT = np.clip(12.5 - np.hypot(ROW - 30, COLUMN - 45), 0, 1)
CASES = Path(__file__).parents[3] / "shared/cases"


def grey(values, kind=np.uint8):
    return Image.fromarray(np.asarray(values).astype(kind))


def palette(colours):
    image = grey(LEAF).convert("P")
    image.putpalette([*colours[0], *colours[1]] + [0] * 3 * 254)
    return image


def coloured(ground, leaf):
    return Image.fromarray(np.where(LEAF[..., None], leaf, ground).astype(np.uint8))


def with_alpha(alpha):
    photo = np.random.default_rng(0).integers(0, 256, (*SHAPE, 3)).astype(np.uint8)
    return Image.fromarray(np.dstack([photo, alpha.astype(np.uint8)]))


IMAGES = {
    "one": lambda: grey(LEAF),
    "class number": lambda: grey(38 * LEAF),
    "two labels": lambda: grey(1 + LEAF),
    "grey": lambda: grey(128 * LEAF),
    "twelve bits": lambda: grey(4095 * LEAF, np.uint16),
    "sixteen bits of one": lambda: grey(LEAF, np.uint16),
    "float": lambda: grey(LEAF, np.float32),
    "alpha 180": lambda: with_alpha(180 * LEAF),
    "palette": lambda: palette([(0, 0, 0), (128, 0, 0)]),
    "palette without black": lambda: palette([(250, 240, 230), (0, 128, 0)]),
    "green on black": lambda: coloured((0, 0, 0), (0, 200, 40)),
    "black on white is no colour": lambda: coloured((0, 0, 0), (255, 255, 255)),
    "red on blue": lambda: coloured((40, 60, 200), (220, 30, 20)),
}


@pytest.mark.parametrize("kind", IMAGES)
def test_two_values_are_a_mask_whatever_they_are(tmp_path, kind):
    path = tmp_path / ("mask.tif" if kind == "float" else "mask.png")
    IMAGES[kind]().save(path)
    np.testing.assert_array_equal(Silhouette.load(path).mask, LEAF)


@pytest.mark.parametrize("kind", [bool, np.uint8, np.int64, np.float32])
def test_arrays_in_files(tmp_path, kind):
    np.save(tmp_path / "mask.npy", LEAF.astype(kind))
    found = read_target(tmp_path / "mask.npy")
    assert isinstance(found, Silhouette)
    np.testing.assert_array_equal(found.mask, LEAF)
    np.save(tmp_path / "cloud.npy", np.random.default_rng(0).normal(size=(50, 3)))
    assert isinstance(read_target(tmp_path / "cloud.npy"), pf.PointCloud)


@pytest.mark.parametrize("top", [255, 128, 180])
def test_soft_edges_are_coverage(tmp_path, top):
    grey(np.rint(top * SOFT)).save(tmp_path / "mask.png")
    found = Silhouette.load(tmp_path / "mask.png")
    np.testing.assert_allclose(found.mask, SOFT, atol=0.51 / top)
    colour = np.array([0, 200, 40]) * SOFT[..., None]
    Image.fromarray(np.rint(colour).astype(np.uint8)).save(tmp_path / "colour.png")
    np.testing.assert_allclose(Silhouette.load(tmp_path / "colour.png").mask, SOFT, atol=0.01)


def test_a_bilevel_tiff_is_as_it_is_seen(tmp_path):
    seen = Image.fromarray(LEAF)
    seen.save(tmp_path / "plain.tif")
    seen.save(tmp_path / "fax.tif", compression="group4")
    for name in ("plain.tif", "fax.tif"):
        np.testing.assert_array_equal(Silhouette.load(tmp_path / name).mask, LEAF)


def test_the_orientation_counts(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6  # to be turned by a quarter to the right
    grey(255 * LEAF).save(tmp_path / "mask.png", exif=exif)
    np.testing.assert_array_equal(Silhouette.load(tmp_path / "mask.png").mask, np.rot90(LEAF, -1))


def test_an_alpha_channel_with_a_corner_cut_off_is_no_mask(tmp_path):
    corner = np.where(ROW + COLUMN < 6, 0, 255)
    with_alpha(corner).save(tmp_path / "photo.png")
    with pytest.raises(TargetError, match="looks like a photo"):
        Silhouette.load(tmp_path / "photo.png")


def test_labels_of_several_objects_are_named(tmp_path):
    grey(np.where(LEAF, 1 + (ROW > 30), 0)).save(tmp_path / "labels.png")
    with pytest.raises(TargetError, match=r"2 labels \(1, 2\)"):
        Silhouette.load(tmp_path / "labels.png")


def test_heic(tmp_path):
    pytest.importorskip("pillow_heif").register_heif_opener()
    grey(255 * LEAF).convert("RGB").save(tmp_path / "mask.heic", quality=-1)
    assert np.mean(Silhouette.load(tmp_path / "mask.heic").mask.round() == LEAF) > 0.99


def test_heic_without_its_reader(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pillow_heif", None)
    (tmp_path / "p.heic").write_bytes(b"")
    with pytest.raises(TargetError, match=r"petalfit\[formats\]"):
        Silhouette.load(tmp_path / "p.heic")


def test_a_bomb_is_refused_from_its_header(tmp_path, monkeypatch):
    grey(255 * LEAF).save(tmp_path / "mask.png")
    monkeypatch.setattr("petalfit.observations.images.available_memory", lambda: 1000)
    with pytest.raises(TargetError, match=r"90 × 60 pixels, which take .* GB"):
        Silhouette.load(tmp_path / "mask.png")


@pytest.mark.skipif(not CASES.is_dir(), reason="the cases are not here")
@pytest.mark.parametrize(
    "name",
    [
        "mask_01/m_01.png",
        "mask_01/m_float.tif",
        "mask_alpha180/m_rootpainter_alpha180.png",
        "mask_palette/m_palette_voc.png",
        "mask_scalebar/m_scalebar.png",
        "mask_scalebar/m_frame.png",
    ],
)
def test_cases_are_the_same_leaf(name):
    leaf = Silhouette.load(CASES / "mask_flat_leaf/m_base.png")
    np.testing.assert_array_equal(Silhouette.load(CASES / name).mask, leaf.mask)
    assert len(Contour.of(leaf).place) > 500
