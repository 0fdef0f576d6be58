"""Export of a whole flower as a mesh: glTF with organs as named nodes, or plain OBJ, PLY and STL."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from petalfit.colours import Colour, to_linear
from petalfit.components import parameters
from petalfit.export.mesh import SUFFIXES, obj_text
from petalfit.flowers import Flower, Grown, grow
from petalfit.flowers.flower import short
from petalfit.observations.atomic import atomic_path
from petalfit.surfaces import AbstractSurface, grid_faces, grid_uv
from petalfit.version import VERSION

if TYPE_CHECKING:
    import trimesh
    from trimesh.visual.material import PBRMaterial

_TEXTURE = (256, 256)
_ROUGHNESS = 0.75


def export_flower(flower: Flower, path: str | os.PathLike[str]) -> None:
    """Write a flower, +y up, in the format that the suffix names.

    - `.glb`: binary glTF. Every organ is a node with its name, its pose, and its parameters in `extras`;
      the parts of an organ are nodes below it. Colours with patterns are embedded textures in sRGB, plain
      colours are factors in linear light, as glTF requires.
    - `.obj`: one group per surface, with texture coordinates and normals.
    - `.ply`, `.stl`: binary, all surfaces in one mesh.

    The file is written completely or not at all. The same flower gives the same bytes.

    Args:
        flower: The flower.
        path: The path of the file; an existing file is replaced.

    Raises:
        ValueError: The suffix is none of these.
        FlowerError: The flower would not fit into memory.
        OSError: The file cannot be written.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise ValueError(
            f"{os.fspath(path)} has the suffix {suffix!r}; meshes are written as {' '.join(SUFFIXES)}."
        )
    content = _WRITERS[suffix](flower)
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def _scene(flower: Flower) -> tuple[trimesh.Scene, dict[str, Colour]]:
    """The flower as a scene of named nodes, and the colours of its materials."""
    import trimesh

    scene = trimesh.Scene(metadata={"petalfit": {"version": VERSION, "flower": flower.name}})
    scene.graph.update(frame_to=flower.name, matrix=np.eye(4))
    seen: dict[bytes, str] = {}
    colours: dict[str, Colour] = {}
    for grown in grow(flower):
        label = _label(flower, grown)
        colours[label] = flower.colour(grown.part)
        material = _material(colours[label], label)
        for k, mesh in enumerate(_meshes(grown)):
            mesh.visual.material = material  # pyright: ignore
            organ, node = _names(flower, grown, k)
            parent = flower.name
            if organ != node:
                # A part goes below its organ, which is a node without a mesh of its own.
                if organ not in scene.graph.nodes:
                    scene.graph.update(
                        frame_to=organ,
                        frame_from=flower.name,
                        matrix=grown.outer[k],
                        metadata={"petalfit": _organ_extras(flower, grown, k)},
                    )
                parent = _below(scene, organ, node)
            matrix = grown.inner[k] if organ != node else grown.outer[k] @ grown.inner[k]
            # Identical organs share one mesh.
            key = label.encode() + np.asarray(mesh.vertices).tobytes()
            if key not in seen:
                seen[key] = node
                scene.geometry[node] = mesh
            scene.graph.update(
                frame_to=node,
                frame_from=parent,
                matrix=matrix,
                geometry=seen[key],
                metadata={"petalfit": _extras(flower, grown, k)},
            )
    return scene, colours


def _below(scene: trimesh.Scene, organ: str, node: str) -> str:
    """The parent node of a part: its organ, or the part of the organ that the path names."""
    group = node.rpartition("/")[0]
    if group != organ and group not in scene.graph.nodes:
        scene.graph.update(frame_to=group, frame_from=organ, matrix=np.eye(4))
    return group


def _names(flower: Flower, grown: Grown, k: int) -> tuple[str, str]:
    """The names of the organ's node and of the part's node."""
    part = grown.part
    if part.series < 0:
        return part.label, part.label
    organ = flower.series[part.series].names[k]
    return organ, f"{organ}/{part.name}" if part.name else organ


def _label(flower: Flower, grown: Grown) -> str:
    """The name that the same part of all organs of a series shares, for materials."""
    part = grown.part
    if part.series < 0:
        return part.label
    series = flower.series[part.series].name
    return f"{series}/{short(part.name)}" if part.name else series


def _extras(flower: Flower, grown: Grown, k: int) -> dict[str, Any]:
    """The numbers of one surface, and, if the surface is a whole organ, its attachment."""
    surface = jax.tree.map(lambda leaf: float(leaf[k]), grown.part.surface)
    extras = {"component": type(surface).__name__, "parameters": _values(surface)}
    if grown.part.series >= 0 and not grown.part.name:
        extras["attachment"] = _attachment(flower, grown, k)
    return extras


def _organ_extras(flower: Flower, grown: Grown, k: int) -> dict[str, Any]:
    """The numbers of an assembly that do not belong to one of its parts, and its attachment."""
    organ = jax.tree.map(float, flower.series[grown.part.series].one(k))
    return {
        "component": type(organ).__name__,
        "parameters": _values(organ),
        "attachment": _attachment(flower, grown, k),
    }


def _values(organ: AbstractSurface) -> dict[str, float]:
    return {name: getattr(organ, name) for name in parameters(organ) if "." not in name}


def _attachment(flower: Flower, grown: Grown, k: int) -> dict[str, float]:
    values = vars(flower.series[grown.part.series].attachment)
    return {name: float(value[k]) for name, value in values.items()}


def _meshes(grown: Grown) -> list[trimesh.Trimesh]:
    """One mesh for each organ."""
    import trimesh
    from trimesh.visual import TextureVisuals

    shape = grown.vertices.shape[1:3]
    faces, uv = grid_faces(shape, grown.part.surface.orientation), grid_uv(shape)
    return [
        trimesh.Trimesh(
            vertices.reshape(-1, 3),
            faces,
            vertex_normals=normals.reshape(-1, 3),
            visual=TextureVisuals(uv=uv),
            process=False,
        )
        for vertices, normals in zip(grown.vertices, grown.normals, strict=True)
    ]


def _material(colour: Colour, name: str) -> PBRMaterial:
    from PIL import Image
    from trimesh.visual.material import PBRMaterial

    # trimesh rounds factors to eight bits, too few for dark linear light; `_glb` writes exact ones.
    options: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": _ROUGHNESS}
    options |= {"name": name, "doubleSided": True}
    if colour.is_plain:
        linear = np.rint(255 * np.asarray(to_linear(colour.palette[0]))).astype(int)
        return PBRMaterial(baseColorFactor=[*linear.tolist(), 255], **options)
    picture = Image.fromarray(colour.texture(_TEXTURE))
    return PBRMaterial(baseColorTexture=picture, **options)


def _glb(flower: Flower) -> bytes:
    from trimesh.exchange.gltf import export_glb

    scene, colours = _scene(flower)

    def exact(tree: dict[str, Any]) -> None:
        for material in tree["materials"]:
            colour = colours[material["name"]]
            if colour.is_plain:
                linear = np.asarray(to_linear(np.asarray(colour.palette[0], np.float32)))
                factor = [*(round(float(x), 7) for x in linear), 1.0]
                material["pbrMetallicRoughness"]["baseColorFactor"] = factor

    return export_glb(scene, include_normals=True, tree_postprocessor=exact)


def _posed(flower: Flower) -> list[tuple[str, trimesh.Trimesh]]:
    """The names and meshes of all surfaces, in the flower's frame."""
    return [
        (_names(flower, grown, k)[1], mesh)
        for grown in grow(flower)
        for k, mesh in enumerate(_meshes(grown.in_flower()))
    ]


def _obj(flower: Flower) -> bytes:
    # Not written as a scene, because trimesh would recompute its normals from faces.
    lines, offset = [f"# {flower.name} grown by petalfit {VERSION}\n"], 0
    for name, mesh in _posed(flower):
        text = io.StringIO(obj_text(mesh))
        lines.append(f"o {name}\n")
        for line in text:
            if line.startswith("f "):
                corners = [int(corner.split("/")[0]) + offset for corner in line.split()[1:]]
                line = "f " + " ".join(f"{c}/{c}/{c}" for c in corners) + "\n"
            if not line.startswith(("o ", "#")):
                lines.append(line)
        offset += len(mesh.vertices)
    return "".join(lines).encode()


def _whole(flower: Flower) -> trimesh.Trimesh:
    import trimesh

    meshes = [mesh for _, mesh in _posed(flower)]
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    faces = [mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=True)]
    return trimesh.Trimesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate(faces),
        vertex_normals=np.concatenate([mesh.vertex_normals for mesh in meshes]),
        process=False,
    )


def _ply(flower: Flower) -> bytes:
    from trimesh.exchange.ply import export_ply

    return export_ply(_whole(flower), vertex_normal=True)


def _stl(flower: Flower) -> bytes:
    from trimesh.exchange.stl import export_stl

    return export_stl(_whole(flower))


_WRITERS = {".glb": _glb, ".obj": _obj, ".ply": _ply, ".stl": _stl}
