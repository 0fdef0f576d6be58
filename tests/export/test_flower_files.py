"""Flowers as files: named nodes, their numbers, colours as glTF wants them, the same bytes."""

import io
import json
import struct

import jax
import numpy as np
import pytest
import trimesh
from PIL import Image

import petalfit as pf
from petalfit.colours import from_hex, to_linear


def glb(path) -> tuple[dict, bytes]:
    """The JSON and the binary chunk of a GLB file, by the specification."""
    content = path.read_bytes()
    magic, version, length = struct.unpack("<4sII", content[:12])
    assert (magic, version, length) == (b"glTF", 2, len(content))
    size, kind = struct.unpack("<I4s", content[12:20])
    assert kind == b"JSON"
    tree = json.loads(content[20 : 20 + size])
    return tree, content[20 + size + 8 :]


@pytest.fixture(scope="module")
def lily(tmp_path_factory):
    path = tmp_path_factory.mktemp("lily") / "lily.glb"
    pf.export_flower(pf.lily(), path)
    return path


def test_organs_are_named_nodes_with_their_numbers(lily):
    tree, _ = glb(lily)
    nodes = {node["name"]: node for node in tree["nodes"]}
    assert {f"petal_{k}" for k in range(1, 7)} | {f"stamen_{k}" for k in range(1, 7)} <= set(nodes)
    assert {"lily", "pistil", "receptacle", "pedicel", "stamen_3/anther"} <= set(nodes)
    children = {tree["nodes"][k]["name"] for k in nodes["pistil"]["children"]}
    assert children == {"pistil/ovary", "pistil/style", "pistil/stigma"}
    petal = nodes["petal_2"]["extras"]["petalfit"]
    flower = pf.lily()
    assert petal["component"] == "PeonyPetal"
    assert petal["parameters"]["dy"] == float(flower.series[0].organ.dy[1])
    assert petal["attachment"]["opening"] == float(flower.series[0].attachment.opening[1])
    assert nodes["stamen_3"]["extras"]["petalfit"]["parameters"] == {
        "tilt": float(flower.series[1].organ.tilt[2])
    }


def test_a_peony_has_its_petals_as_nodes_and_the_same_bytes_for_a_seed(tmp_path):
    paths = [tmp_path / f"{k}.glb" for k in range(3)]
    for path, seed in zip(paths, (7, 7, 8), strict=True):
        pf.export_flower(pf.peony(seed), path)
    names = {node["name"] for node in glb(paths[0])[0]["nodes"]}
    assert {f"petal_{k}" for k in range(1, 31)} <= names
    assert paths[0].read_bytes() == paths[1].read_bytes() != paths[2].read_bytes()


def test_meshes_lie_where_the_flower_is(lily):
    """What a reader of the file sees is what `points` says."""
    scene = trimesh.load_scene(lily)
    with jax.enable_x64(True):
        points = np.asarray(jax.jit(lambda flower: flower.points((25, 17)))(pf.lily()))
    np.testing.assert_allclose(scene.bounds[0], points.min(axis=0), atol=0.3)
    np.testing.assert_allclose(scene.bounds[1], points.max(axis=0), atol=0.3)


def test_plain_colours_are_linear_and_patterns_are_srgb_textures(lily):
    tree, binary = glb(lily)
    materials = {material["name"]: material for material in tree["materials"]}
    factor = materials["stamen/anther"]["pbrMetallicRoughness"]["baseColorFactor"]
    np.testing.assert_allclose(factor[:3], to_linear(from_hex("#9c4a1e")), atol=1e-6)
    petal = materials["petal"]["pbrMetallicRoughness"]
    image = tree["images"][tree["textures"][petal["baseColorTexture"]["index"]]["source"]]
    view = tree["bufferViews"][image["bufferView"]]
    start = view.get("byteOffset", 0)
    picture = np.asarray(Image.open(io.BytesIO(binary[start : start + view["byteLength"]])))
    expected = pf.lily().series[0].colours[""].texture((256, 256))
    np.testing.assert_array_equal(picture[..., :3], expected)


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".stl"])
def test_plain_meshes_have_the_same_triangles(lily, tmp_path, suffix):
    path = tmp_path / f"lily{suffix}"
    pf.export_flower(pf.lily(), path)
    mesh, scene = trimesh.load_mesh(path, process=False), trimesh.load_scene(lily)
    assert len(mesh.faces) == sum(len(part.faces) for part in scene.dump())
    assert mesh.area == pytest.approx(scene.area, rel=1e-4)
    np.testing.assert_allclose(mesh.bounds, scene.bounds, atol=1e-3)
    if suffix == ".obj":
        objects = [line[2:] for line in path.read_text().splitlines() if line.startswith("o ")]
        assert "petal_6" in objects
        assert "stamen_2/filament" in objects


def test_a_suffix_that_is_no_mesh(tmp_path):
    with pytest.raises(ValueError, match="meshes are written as"):
        pf.export_flower(pf.lily(), tmp_path / "lily.fbx")


def test_a_flower_too_large_for_memory_is_refused_before_it_is_grown(monkeypatch):
    monkeypatch.setattr("petalfit.flowers.grown._free_memory", lambda: 1e6)
    with pytest.raises(pf.FlowerError, match="give it fewer organs"):
        pf.export_flower(pf.lily(), "lily.glb")
