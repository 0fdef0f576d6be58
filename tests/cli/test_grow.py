"""`petalfit grow`: flowers as files, and what it says of those that it cannot grow."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

SMALL = {
    "name": "daisy",
    "pedicel": None,
    "series": [
        {"name": "ray", "component": "Sepal", "whorls": [5], "attachment": {"opening": 1.2}},
        {"stamens": "synantherous"},
    ],
}


@pytest.fixture
def daisy(tmp_path: Path) -> Path:
    path = tmp_path / "daisy.json"
    path.write_text(json.dumps(SMALL))
    return path


@pytest.mark.parametrize("suffix", ["glb", "obj", "ply", "stl", "json"])
def test_a_flower_of_ones_own_in_every_format(petalfit, daisy, tmp_path, suffix):
    import trimesh

    out = tmp_path / f"flower.{suffix}"
    done = petalfit("grow", daisy, "-o", out)
    assert done.status == 0, done.err
    assert "5 rays, 5 stamens" in done.out
    if suffix == "json":
        assert petalfit("grow", out, "-o", tmp_path / "again.json").status == 0
        assert (tmp_path / "again.json").read_bytes() == out.read_bytes()
        return
    mesh = trimesh.load_scene(out).to_geometry()
    assert len(mesh.faces) > 1000
    again = tmp_path / f"again.{suffix}"
    assert petalfit("grow", daisy, "-o", again, "--quiet").out == ""
    assert again.read_bytes() == out.read_bytes()


def test_a_picture_and_settings(petalfit, daisy, tmp_path):
    low, high = tmp_path / "low.png", tmp_path / "high.png"
    assert petalfit("grow", daisy, "--png", low).status == 0
    assert petalfit("grow", daisy, "--png", high, "--set", "ray.opening=0.2").status == 0
    closed, open_ = (np.asarray(Image.open(path)) for path in (high, low))
    assert closed.shape == open_.shape
    covered = [np.mean(picture[..., 3] > 128) for picture in (closed, open_)]
    assert 0.02 < covered[0] < covered[1] < 0.9


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["lily"], "nothing to write: give -o lily.glb"),
        (["lily", "-o", "lily.xyz"], "unknown suffix '.xyz'"),
        (["lily", "--png", "lily.jpg"], "is not named .png"),
        (["rose", "-o", "rose.glb"], "there is no flower 'rose'; there are lily and peony"),
        (["absent.json", "-o", "a.glb"], "absent.json cannot be read as a flower: No such file"),
        (["lily", "-o", "a.glb", "--seed", "-1"], "--seed -1 is negative"),
        (["lily", "-o", "a.glb", "--set", "dy=4"], "is not written like petal.dy=4"),
        (["lily", "-o", "a.glb", "--set", "petal.dy=big"], "gives no number"),
        (["lily", "-o", "a.glb", "--set", "leaf.dy=4"], "no organ 'leaf'; its organs are"),
        (["lily", "-o", "a.glb", "--set", "petal.dz=4"], "no parameter 'dz'; it has"),
        (["lily", "-o", "a.glb", "--set", "petal.dy=1e9"], "outside its range"),
        (["lily", "-o", "a.glb", "--set", "petal.dy=nan"], "outside its range"),
        (["lily", "-o", "no/such/folder/a.glb"], "cannot be written"),
    ],
)
def test_what_cannot_be_grown_is_said_in_a_sentence(
    petalfit, tmp_path, monkeypatch, arguments, words
):
    monkeypatch.chdir(tmp_path)
    done = petalfit("grow", *arguments)
    assert done.status == 2
    assert words in done.err
    assert len(done.err.splitlines()) == 1
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "cannot be read as a flower"),
        ('{"series": [{"name": "p", "component": "Sepal", "whorls": [-3]}]}', "received -3"),
        (
            '{"series": [{"name": "p", "component": "Sepal", "recursion": 4000000000}]}',
            "where .* are free: give it fewer organs",
        ),
    ],
    ids=["no json", "negative", "too large"],
)
def test_files_that_describe_no_flower(petalfit, tmp_path, text, words):
    import re

    path = tmp_path / "flower.json"
    path.write_text(text)
    done = petalfit("grow", path, "-o", tmp_path / "a.glb")
    assert done.status == 2
    assert re.search(words, done.err)
    assert str(path) in done.err
    assert not (tmp_path / "a.glb").exists()


def test_nothing_half_written_is_left(petalfit, daisy, tmp_path, monkeypatch):
    def interrupted(*_: object) -> bytes:
        raise KeyboardInterrupt

    monkeypatch.setattr("petalfit.export.flower._WRITERS", {".glb": interrupted})
    out = tmp_path / "a.glb"
    out.write_bytes(b"before")
    assert petalfit("grow", daisy, "-o", out).status == 130
    assert out.read_bytes() == b"before"
    assert {path.name for path in tmp_path.iterdir()} == {"daisy.json", "a.glb"}
