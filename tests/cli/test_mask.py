"""`petalfit mask`: two pictures, or a sentence."""

import numpy as np
import pytest
from PIL import Image

from petalfit.observations import Silhouette

Y, X = np.mgrid[:120, :160] + 0.5
DISC = np.hypot(X - 80, Y - 55) < 35


@pytest.fixture
def photo(tmp_path):
    colours = np.where(DISC[..., None], (240, 150, 90), (30, 90, 60))
    noise = np.random.default_rng(0).integers(-8, 9, colours.shape)
    path = tmp_path / "photo.jpg"
    Image.fromarray((colours + noise).astype(np.uint8)).save(path, quality=90)
    return path


def test_a_mask_and_a_preview(petalfit, photo, tmp_path):
    outcome = petalfit("mask", photo, "-o", tmp_path / "m.png", "--point", "80,55")
    assert outcome.status == 0
    assert outcome.err == ""
    assert "160 × 120 pixels, 20" in outcome.out
    mask = Silhouette.load(tmp_path / "m.png").mask > 0.5
    assert np.sum(mask & DISC) / np.sum(mask | DISC) > 0.97
    with Image.open(tmp_path / "m-preview.png") as preview:
        assert preview.size == (160, 120)
    assert petalfit("mask", photo, "-o", tmp_path / "n.png", "--quiet").out == ""


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        (["-o", "m.jpg"], "m.jpg is no .png"),
        (["-o", "m.png", "--point", "left"], "--point left is no place"),
        (["-o", "m.png", "--point", "999,5"], "outside the photo of 160 × 120"),
        (["-o", "no/folder/m.png"], "cannot be written"),
    ],
    ids=["suffix", "place", "outside", "folder"],
)
def test_bad_options(petalfit, photo, tmp_path, monkeypatch, arguments, match):
    monkeypatch.chdir(tmp_path)
    outcome = petalfit("mask", photo, *arguments)
    assert outcome.status == 2
    assert match in outcome.err
    assert [path.name for path in tmp_path.iterdir()] == ["photo.jpg"]
