"""What a browser sends is parsed as data, or refused with a sentence that begins with its name."""

import io
import json
import zipfile

import numpy as np
import pytest
from PIL import Image

import petalfit as pf
from petalfit.components import models, parameters
from petalfit.studio.sliders import slider_range
from petalfit.studio.uploads import LARGEST, Photo, read_upload
from petalfit.surfaces import value_at

CLOUD = np.random.default_rng(0).normal(size=(50, 3))


def text(points: np.ndarray) -> bytes:
    file = io.StringIO()
    np.savetxt(file, points)
    return file.getvalue().encode()


def png(pixels: np.ndarray) -> bytes:
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, format="PNG")
    return file.getvalue()


def test_a_file_becomes_what_it_holds():
    read = read_upload("C:\\scans\\leaf.XYZ", text(CLOUD))
    assert isinstance(read, pf.PointCloud)
    np.testing.assert_allclose(read.points, CLOUD)
    disc = np.hypot(*np.mgrid[-50:50, -50:50]) < 30
    mask = read_upload("mask.png", png(np.where(disc, 255, 0).astype(np.uint8)))
    assert isinstance(mask, pf.Silhouette)
    assert mask.area == disc.sum()
    colours = np.where(disc[..., None], [200, 40, 90], [240, 240, 235]).astype(np.uint8)
    colours[::2] -= 3  # an image of two colours would be a mask
    photo = read_upload("photo.png", png(colours))
    assert isinstance(photo, Photo)
    assert photo.target.area == pytest.approx(disc.sum(), rel=0.03)
    camera = {"rotation": np.eye(3).tolist(), "pixels_per_unit": 2.0, "centre": [5, 5]}
    found = read_upload("camera.json", json.dumps(camera | {"shape": [9, 9]}).encode())
    assert isinstance(found, pf.Camera)


def bomb() -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("points.npy", bytes(LARGEST + 1))
    return file.getvalue()


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.xyz", b"", "a.xyz is empty"),
        ("../../etc/a.exe", b"x", "a.exe is of no kind that can be fitted"),
        ("a.gltf", b"{}", "a.gltf names other files"),
        ("a.ply", b"solid", "a.ply: is no PLY file: it does not begin with ply"),
        ("a.npz", bomb(), "a.npz: it unpacks to 100 MB"),
        ("a.json", b"[", "a.json: it is no JSON"),
        ("a.json", b"[" * 100_000, "a.json: it is no JSON"),
        ("a.json", b'{"format": "else"}', "a.json is not a fit result"),
        ("a.png", b"no picture", "a.png cannot be read as an image"),
        ("a.xyz", text(CLOUD * np.nan), "a.xyz: "),
    ],
)
def test_what_cannot_be_used_is_refused(name, content, said):
    with pytest.raises(pf.TargetError) as refused:
        read_upload(name, content)
    assert str(refused.value).startswith(said)
    assert "/tmp" not in str(refused.value)


def test_an_image_may_not_unpack_to_too_many_pixels():
    with pytest.raises(pf.TargetError, match=r"^a.png: it has 49 million pixels"):
        read_upload("a.png", png(np.zeros((7000, 7000), np.uint8)))


@pytest.mark.parametrize("name", models())
def test_sliders_reach_what_is_typical_and_stay_within_bounds(name):
    model = models()[name]()
    for each, parameter in parameters(model).items():
        value = float(value_at(model, each))
        low, high, step = slider_range(parameter, value)
        assert low <= value <= high
        assert parameter.bounds[0] <= low < high <= parameter.bounds[1]
        assert step < 0.01 * (high - low)
        inside = 0.02 * (high - low)
        assert low - inside <= max(parameter.typical[0], parameter.bounds[0])
        assert high + inside >= min(parameter.typical[1], parameter.bounds[1])
