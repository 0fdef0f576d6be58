"""Damaged masks, photos and cameras: read, or refused with one sentence, never anything else."""

import io
import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from petalfit.observations import Camera, Contour, Silhouette, TargetError, read_cameras
from petalfit.observations.photo import read_photo

CASES = Path(__file__).parents[3] / "shared/cases/damaged"
ROW, COLUMN = np.mgrid[:48, :48]
LEAF = np.hypot(ROW - 24, COLUMN - 22) < 14
FEW, MANY = 100, 2000


def image(form, mode="L", **options):
    written = io.BytesIO()
    Image.fromarray(np.uint8(255) * LEAF).convert(mode).save(written, form, **options)
    return written.getvalue()


def array():
    written = io.BytesIO()
    np.save(written, LEAF)
    return written.getvalue()


def transforms():
    frame = {"file_path": "a.png", "transform_matrix": np.eye(4).tolist(), "mask_path": "m.png"}
    content = {"fl_x": 50.0, "w": 48, "h": 48, "k1": 0.1, "frames": [frame, frame | {"k2": 0.1}]}
    return json.dumps(content).encode()


def one_camera():
    camera = Camera.look_at((0, 0, 9), (0, 0, 0), (48, 48))
    return json.dumps(camera.to_json()).encode()


def colmap():
    """The files of two models of COLMAP: cameras and images, as text and in binary."""
    images = struct.pack("<Q", 2)
    for number, points in ((1, 0), (2, 3)):
        images += struct.pack("<i7di", number, 0.5, 0.5, 0.5, 0.5, 1, 2, 3, 1) + b"a.png\0"
        images += struct.pack("<Q", points) + bytes(24 * points)
    return {
        "cameras.txt": b"1 OPENCV 48 48 50 50 24 24 0.1 0 0 0\n",
        "images.txt": b"1 0.5 0.5 0.5 0.5 1 2 3 1 a.png\n\n2 1 0 0 0 0 0 9 1 b.png\n1 2 3\n",
        "cameras.bin": struct.pack("<QiiQQ8d", 1, 1, 4, 48, 48, 50, 50, 24, 24, 0.1, 0, 0, 0),
        "images.bin": images,
    }


READERS = {
    "png": (image("PNG"), ".png", Silhouette.load),
    "palette": (image("PNG", "P"), ".png", Silhouette.load),
    "alpha": (image("PNG", "RGBA"), ".png", Silhouette.load),
    "jpg": (image("JPEG"), ".jpg", Silhouette.load),
    "tif": (image("TIFF", compression="tiff_lzw"), ".tif", Silhouette.load),
    "bmp": (image("BMP", "P"), ".bmp", Silhouette.load),
    "gif": (image("GIF", "P"), ".gif", Silhouette.load),
    "webp": (image("WEBP", "RGB"), ".webp", Silhouette.load),
    "npy": (array(), ".npy", Silhouette.load),
    "photo": (image("PNG", "RGB"), ".png", read_photo),
    "transforms": (transforms(), ".json", read_cameras),
    "camera": (one_camera(), ".json", read_cameras),
}
TOKENS = [b"1e999", b"-1", b"null", b"[]", b'"x"', b"NaN", b"1" * 400, b"{}", b"true", b"0"]


def mutated(content: bytes, rng: np.random.Generator, is_text: bool) -> bytes:
    """The content with a few bytes changed, a part cut out or twice, or a number exchanged."""
    changed = bytearray(content)
    kind = rng.integers(4 if is_text else 3)
    start, stop = sorted(rng.integers(0, len(changed) + 1, 2))
    if kind == 0:
        for place in rng.integers(0, len(changed), rng.integers(1, 6)):
            changed[place] = rng.integers(256)
    elif kind == 1:
        del changed[start:stop]
    elif kind == 2:
        changed[stop:stop] = changed[start : min(stop, start + 64)]
    else:
        digits = [k for k, byte in enumerate(changed) if chr(byte).isdigit()]
        place = digits[rng.integers(len(digits))]
        changed[place : place + 1] = TOKENS[rng.integers(len(TOKENS))]
    return bytes(changed)


def complaint(read: Callable[[], object]) -> str:
    """The sentence in which reading ends, empty if it succeeds."""
    try:
        read()
    except TargetError as error:
        return str(error)
    return ""


def is_sentence(text: str) -> bool:
    return "\n" not in text and len(text) < 1000


def read_mutations(folder: Path, kind: str, seeds: range) -> None:
    content, suffix, reader = READERS[kind]
    path = folder / f"damaged{suffix}"
    for seed in seeds:
        path.write_bytes(mutated(content, np.random.default_rng(seed), suffix == ".json"))
        try:
            assert is_sentence(complaint(lambda: reader(path)))
        except Exception as error:
            raise AssertionError(f"seed {seed} of {kind}") from error


@pytest.mark.parametrize("kind", READERS)
def test_mutations_end_in_a_sentence(tmp_path, kind):
    read_mutations(tmp_path, kind, range(FEW))


@pytest.mark.slow
@pytest.mark.parametrize("kind", READERS)
def test_many_mutations_end_in_a_sentence(tmp_path, kind):
    read_mutations(tmp_path, kind, range(FEW, FEW + MANY))


def read_mutated_models(folder: Path, name: str, seeds: range) -> None:
    suffix = Path(name).suffix
    for other, content in colmap().items():
        if other.endswith(suffix):
            (folder / other).write_bytes(content)
    assert not complaint(lambda: read_cameras(folder))
    for seed in seeds:
        content = mutated(colmap()[name], np.random.default_rng(seed), suffix == ".txt")
        (folder / name).write_bytes(content)
        try:
            assert is_sentence(complaint(lambda: read_cameras(folder)))
        except Exception as error:
            raise AssertionError(f"seed {seed} of {name}") from error


@pytest.mark.parametrize("name", colmap())
def test_mutated_models_of_colmap(tmp_path, name):
    read_mutated_models(tmp_path, name, range(FEW))


@pytest.mark.slow
@pytest.mark.parametrize("name", colmap())
def test_many_mutated_models_of_colmap(tmp_path, name):
    read_mutated_models(tmp_path, name, range(FEW, FEW + MANY))


@pytest.mark.skipif(not CASES.is_dir(), reason="the cases are not here")
@pytest.mark.parametrize("pattern", ["img_*", "cam_*", "npy_*"])
def test_damaged_cases(pattern):
    for path in sorted(CASES.glob(pattern)):
        assert is_sentence(
            complaint(lambda path=path: (read_cameras if path.suffix == ".json" else seen)(path))
        )


def seen(path: Path) -> Contour:
    return Contour.of(Silhouette.load(path))
