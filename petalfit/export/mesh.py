"""Export of a fitted surface as a mesh: glTF with its parameters, or plain OBJ, PLY and STL."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from petalfit.observations.atomic import atomic_path
from petalfit.results import FitRecord
from petalfit.version import VERSION

if TYPE_CHECKING:
    import trimesh

SUFFIXES = (".glb", ".obj", ".ply", ".stl")

# A light rose, #ecaabe in sRGB. glTF requires linear light, and trimesh writes factors as given.
_COLOUR = [214, 103, 131, 255]
_ROUGHNESS = 0.75


def export_mesh(
    result: FitRecord, path: str | os.PathLike[str], resolution: tuple[int, int] = (65, 65)
) -> None:
    """Write the fitted surface in the target's frame, in the format that the suffix names.

    - `.glb`: as by `export_glb`.
    - `.obj`: vertices, texture coordinates and normals.
    - `.ply`: binary; vertices and normals.
    - `.stl`: binary; triangles only.

    The file is written completely or not at all. The same result gives the same bytes.

    Args:
        result: The fit.
        path: The path of the file; an existing file is replaced.
        resolution: The numbers of vertices along u and along v, at least 2 each.

    Raises:
        ValueError: The suffix is none of these, or the resolution is too small.
        OSError: The file cannot be written.
    """
    from trimesh.exchange.ply import export_ply
    from trimesh.exchange.stl import export_stl

    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise ValueError(
            f"{os.fspath(path)} has the suffix {suffix!r}; meshes are written as "
            f"{' '.join(SUFFIXES)}."
        )
    if suffix == ".glb":
        export_glb(result, path, resolution)
        return
    mesh = result.mesh(resolution)
    if suffix == ".obj":
        title = f"{type(result.model).__name__} fitted by petalfit {VERSION}"
        _write(obj_text(mesh, header=title).encode(), path)
    elif suffix == ".ply":
        _write(export_ply(mesh, vertex_normal=True), path)
    else:
        _write(export_stl(mesh), path)


def export_glb(
    result: FitRecord, path: str | os.PathLike[str], resolution: tuple[int, int] = (65, 65)
) -> None:
    """Write the fitted surface as `export_petals` does, with a node that is named after the model."""
    export_petals({type(result.model).__name__: result}, path, resolution)


def export_petals(
    results: Mapping[str, FitRecord],
    path: str | os.PathLike[str],
    resolution: tuple[int, int] = (65, 65),
) -> None:
    """Write fitted surfaces in the target's frame as binary glTF.

    The meshes have normals, texture coordinates and a matt, double-sided material. Their nodes have the
    given names and hold the numbers of the fits in their `extras` (see the function `extras`). Lengths
    are in the target's unit, and the target's axes are kept. The file is written completely or not at
    all. The same results give the same bytes.

    Args:
        results: The fits by the name of their nodes.
        path: The path of the file; an existing file is replaced.
        resolution: The numbers of vertices along u and along v, at least 2 each.

    Raises:
        ValueError: The suffix is not .glb, or the resolution is too small.
        OSError: The file cannot be written.
    """
    import trimesh
    from trimesh.exchange.gltf import export_glb as to_bytes
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    if Path(path).suffix.lower() != ".glb":
        name = os.fspath(path)
        raise ValueError(f"{name}: petals are written as glTF; give a name that ends in .glb.")
    scene = trimesh.Scene()
    for name, result in results.items():
        mesh = result.mesh(resolution)
        assert isinstance(mesh.visual, TextureVisuals)
        mesh.visual.material = PBRMaterial(
            name="petal",
            baseColorFactor=_COLOUR,
            metallicFactor=0.0,
            roughnessFactor=_ROUGHNESS,
            doubleSided=True,
        )
        numbers = {"petalfit": extras(result)}
        scene.add_geometry(mesh, node_name=name, geom_name=name, metadata=numbers)
    _write(to_bytes(scene, include_normals=True), path)


def extras(result: FitRecord) -> dict[str, Any]:
    """The numbers of a fit as plain JSON, for glTF's `extras`.

    Returns:
        petalfit's version, the model's name, `parameters` by name (value, stderr, stderr_noise,
        whether it is free, whether the target determines it), noise, rms, whether the fit converged,
        and the pose. Numbers that are not finite, and errors of parameters that are not free, are None.
    """
    free = set(result.names)
    return {
        "version": VERSION,
        "model": type(result.model).__name__,
        "parameters": {
            name: {
                "value": _finite(value),
                "stderr": _finite(result.stderr.get(name, math.inf)),
                "stderr_noise": _finite(result.stderr_noise.get(name, math.inf)),
                "free": name in free,
                "identifiable": result.identifiable.get(name),
            }
            for name, value in result.values.items()
        },
        "noise": _finite(result.noise),
        "rms": _finite(result.rms),
        "converged": result.converged,
        "pose": {
            "rotation": result.pose.rotation.tolist(),
            "translation": result.pose.translation.tolist(),
            "scale": float(result.pose.scale),
        },
    }


def _finite(number: float) -> float | None:
    """The number, or None if it is not finite, because JSON has no infinities."""
    return float(number) if math.isfinite(number) else None


def obj_text(mesh: trimesh.Trimesh, **options: Any) -> str:
    """A mesh as OBJ, without lines that name a material file, because there is none.

    Args:
        mesh: A mesh with normals.
        options: Further options of trimesh's `export_obj`.
    """
    from trimesh.exchange.obj import export_obj

    text = str(export_obj(mesh, include_normals=True, write_texture=False, digits=9, **options))
    lines = text.splitlines(keepends=True)
    return "".join(line for line in lines if not line.startswith(("mtllib ", "usemtl ")))


def _write(content: bytes, path: str | os.PathLike[str]) -> None:
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)
