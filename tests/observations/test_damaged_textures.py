"""Damaged images of textures: refused with a sentence, or usable."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import petalfit as pf
from tests.mutations import damaged, each_case


@pytest.fixture(scope="module")
def images(tmp_path_factory) -> list[tuple[str, bytes]]:
    folder, found = tmp_path_factory.mktemp("images"), []
    pixels = np.random.default_rng(0).integers(0, 256, (9, 9, 3), np.uint8)
    for name in ("a.png", "a.bmp", "a.tif", "a.gif", "a.jpg"):
        Image.fromarray(pixels).save(folder / name)
        found.append((name, (folder / name).read_bytes()))
    return found


def attempt(path: Path) -> None:
    try:
        texture = pf.Texture.load(path)
    except pf.TargetError as error:
        said = str(error)
    else:
        assert np.isfinite(texture.values).all()
        return
    assert str(path) in said


@pytest.mark.filterwarnings("ignore")  # Pillow's, on what it repairs
@pytest.mark.parametrize("seed", range(100))
def test_a_damaged_texture_is_refused_or_usable(seed, images, tmp_path):
    name, content = images[seed % len(images)]
    (tmp_path / name).write_bytes(damaged(content, seed))
    attempt(tmp_path / name)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_many_damaged_textures_are_refused_or_usable(images, tmp_path):
    for seed in range(100, 2100):
        name, content = images[seed % len(images)]
        (tmp_path / name).write_bytes(damaged(content, seed))
        attempt(tmp_path / name)


@each_case("texture*")
def test_textures_that_were_seen_to_break(path):
    attempt(path)
