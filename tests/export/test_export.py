import json
import os
import struct

import jax
import numpy as np
import pytest
import trimesh

from petalfit import __version__
from petalfit.export import SUFFIXES, export_glb, export_mesh
from tests.fitted import posed

MODEL = "PeonyPetal"


def normals() -> np.ndarray:
    """Of the fitted surface in the target's frame, from the surface and not from a mesh."""
    result = posed()
    u, v = np.meshgrid(np.linspace(-0.5, 0.5, 65), np.linspace(0, 1, 65), indexing="ij")
    with jax.enable_x64(True):
        own = np.asarray(result.model.normal(u, v))
    return own.reshape(-1, 3) @ result.pose.rotation.T


@pytest.fixture(scope="module")
def glb(tmp_path_factory) -> os.PathLike:
    path = tmp_path_factory.mktemp("glb") / "fit.glb"
    export_glb(posed(), path)
    return path


class TestGlb:
    def test_loads_as_the_surface_in_the_targets_frame(self, glb):
        scene = trimesh.load_scene(glb, process=False)
        (node,) = scene.graph.nodes_geometry
        matrix, name = scene.graph[node]
        mesh = scene.geometry[name]
        assert node == MODEL
        np.testing.assert_array_equal(matrix, np.eye(4))
        expected = posed().mesh()
        reach = np.abs(expected.vertices).max()
        np.testing.assert_allclose(mesh.vertices, expected.vertices, atol=1e-7 * reach)
        np.testing.assert_array_equal(mesh.faces, expected.faces)
        np.testing.assert_allclose(mesh.vertex_normals, normals(), atol=1e-7)
        np.testing.assert_allclose(mesh.visual.uv, expected.visual.uv, atol=1e-7)
        assert mesh.visual.material.doubleSided
        assert mesh.visual.material.metallicFactor == 0

    def test_holds_the_numbers(self, glb):
        data = glb.read_bytes()
        length = struct.unpack("<I", data[12:16])[0]

        def refuse(constant: str) -> None:
            raise AssertionError(f"{constant} is not JSON")

        tree = json.loads(data[20 : 20 + length], parse_constant=refuse)
        (node,) = tree["nodes"]
        found, result = node["extras"]["petalfit"], posed()
        assert (found["version"], found["model"]) == (__version__, MODEL)
        assert (found["noise"], found["rms"]) == (result.noise, result.rms)
        assert found["converged"] is True
        for name, value in result.values.items():
            row = found["parameters"][name]
            assert row["value"] == value
            assert row["free"] == (name in result.names)
            assert row["identifiable"] == result.identifiable.get(name)
            if name in ("rib_frequency", "midrib_sharpness"):
                assert row["stderr"] is None
            else:
                assert row["stderr"] == result.stderr[name]
        assert found["pose"]["rotation"] == result.pose.rotation.tolist()
        assert found["pose"]["translation"] == result.pose.translation.tolist()
        assert found["pose"]["scale"] == result.pose.scale
        assert {"NORMAL", "POSITION", "TEXCOORD_0"} == set(
            tree["meshes"][0]["primitives"][0]["attributes"]
        )

    def test_trimesh_finds_the_numbers(self, glb):
        scene = trimesh.load_scene(glb, process=False)
        edge = scene.graph.transforms.edge_data[("world", MODEL)]
        assert edge["metadata"]["petalfit"]["model"] == MODEL


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_every_format_holds_the_surface_and_is_deterministic(tmp_path, suffix):
    first, second = tmp_path / f"a{suffix}", tmp_path / f"b{suffix.upper()}"
    export_mesh(posed(), first, (17, 33))
    export_mesh(posed(), second, (17, 33))
    assert first.read_bytes() == second.read_bytes()
    assert sorted(os.listdir(tmp_path)) == [first.name, second.name]
    loaded, expected = trimesh.load_mesh(first, process=False), posed().mesh((17, 33))
    reach = np.abs(expected.vertices).max()
    triangles = expected.vertices[expected.faces]
    np.testing.assert_allclose(loaded.vertices[loaded.faces], triangles, atol=1e-7 * reach)
    if suffix in (".obj", ".glb"):
        np.testing.assert_allclose(loaded.visual.uv, expected.visual.uv, atol=1e-7)


@pytest.mark.parametrize("name", ["fit.fbx", "fit", "fit.glb.txt"])
def test_other_suffixes_are_refused(tmp_path, name):
    with pytest.raises(ValueError, match=r"has the suffix .*; meshes are written as \.glb \.obj"):
        export_mesh(posed(), tmp_path / name)
    assert not os.listdir(tmp_path)


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError])
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_what_fails_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch, error, suffix):
    path = tmp_path / f"fit{suffix}"
    path.write_bytes(b"old")

    def fail(*_arguments):
        raise error

    monkeypatch.setattr("os.replace", fail)
    with pytest.raises(error):
        export_mesh(posed(), path, (5, 5))
    assert os.listdir(tmp_path) == [path.name]
    assert path.read_bytes() == b"old"
