"""Meshes and scenes that trimesh reads: OBJ, STL, OFF, GLB and glTF."""

import io
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from petalfit.observations.errors import TargetError
from petalfit.observations.memory import check_memory

if TYPE_CHECKING:
    import trimesh.parent

# Extensions of glTF that trimesh does not know: it would read every vertex as zero.
_COMPRESSIONS = (b"KHR_draco_mesh_compression", b"EXT_meshopt_compression")
# A vertex of a scene takes some arrays of three numbers in double precision.
_BYTES_A_VERTEX = 150


def read_scene(path: Path) -> "list[trimesh.parent.Geometry]":
    """Reads the meshes and clouds of a file, each as often and where it appears in the scene.

    Args:
        path: The path of the file.

    Raises:
        TargetError: There are no vertices, they are compressed, or they do not fit into memory.
    """
    import trimesh
    from trimesh.resolvers import FilePathResolver

    kind = path.suffix.lower().removeprefix(".")
    data = path.read_bytes()
    if kind == "gltf":
        # Checked here: for a file that is not JSON, trimesh would only say that it finds no "model.gltf".
        _check_scene(json.loads(data))
    if kind == "glb" and data[:4] == b"glTF":
        _check_scene(json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")]))
    for compression in _COMPRESSIONS:
        if kind in {"glb", "gltf"} and compression in data:
            raise TargetError(f"is compressed ({compression.decode()}); export it uncompressed.")
    if kind == "stl" and not _is_binary_stl(data):
        # A file that is not text either is cut short; with some packages trimesh guesses an encoding.
        data.decode("utf-8")
    # Decoded here: for names that are not UTF-8 trimesh would need another package.
    is_text = kind in {"obj", "off"}
    file = io.StringIO(data.decode("utf-8", "replace")) if is_text else io.BytesIO(data)
    # process=False, because trimesh would otherwise silently drop vertices that are NaN.
    scene = trimesh.load_scene(
        file,
        file_type=kind,
        resolver=FilePathResolver(str(path)),
        skip_materials=True,
        process=False,
    )
    # `dump` copies every mesh into the frame of the scene, once for each place where it appears.
    geometries = scene.dump()
    if not any(len(getattr(geometry, "vertices", ())) for geometry in geometries):
        raise TargetError(f"holds no vertices; it is empty, or no {path.suffix.lower()} file.")
    return geometries


def _check_scene(content: dict[str, Any]) -> None:
    """Raises an error for a glTF scene that becomes much larger than its file."""
    counts = [int(accessor["count"]) for accessor in content.get("accessors", ())]
    meshes = [
        sum(counts[part["attributes"]["POSITION"]] for part in mesh["primitives"])
        for mesh in content.get("meshes", ())
    ]
    placed = sum(meshes[node["mesh"]] for node in content.get("nodes", ()) if "mesh" in node)
    check_memory(_BYTES_A_VERTEX * (sum(counts) + placed))


def _is_binary_stl(data: bytes) -> bool:
    """Whether the file has as many triangles, of 50 bytes each, as its header of 84 bytes says."""
    return len(data) >= 84 and len(data) == 84 + 50 * int.from_bytes(data[80:84], "little")
