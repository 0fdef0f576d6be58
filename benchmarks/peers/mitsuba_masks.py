"""Mitsuba 3 + Adam: a petal from one mask by differentiable rendering, the general tool for the task.

Mitsuba renders the petal's mesh black before a white sky and differentiates the image by projective
sampling (`prb_projective`), whose boundary term gives the silhouette's derivative without bias; JAX pulls
the vertices' gradient back to the parameters. The mesh is laid out in the frame of a fixed pinhole camera
such that its vertices are seen where `camera` sees them. This is exact for orthographic cameras also,
which projective sampling itself does not know: a silhouette depends on the projected triangles alone.

It is a fair peer: only what a silhouette needs is rendered (one bounce; no continuous and no indirect
term; the boundary term samples nothing but the outline, 65,536 times a step), the loss compares 4 rays a
pixel with the mask, and compilation is not timed.
"""

from __future__ import annotations

import glob
import os
from importlib import metadata
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.peers.descent import Gradient, ProjectedPetal, grid_faces

try:
    NAME = f"Mitsuba {metadata.version('mitsuba')} + Adam"
except metadata.PackageNotFoundError:
    NAME = "Mitsuba 3 + Adam"
RAYS = 4  # a pixel, for the image
EDGE_RAYS = 1  # times the pixels, for the derivative
OLDEST_LLVM = 17  # 14 is refused by Dr.Jit 1.5; with 15 and 16 the process dies
_RELIEF = 0.2  # depth of the scene over its distance


def available() -> str | None:
    """None if it works, else what is missing and what to install."""
    if not os.environ.get("DRJIT_LIBLLVM_PATH"):
        libraries = [
            p for p in glob.glob("/usr/lib/*/libLLVM*.so*") if _llvm_version(p) >= OLDEST_LLVM
        ]
        if not libraries:
            return "Mitsuba's CPU backend needs LLVM 17 or newer: apt-get install libllvm19."
        os.environ["DRJIT_LIBLLVM_PATH"] = max(libraries, key=_llvm_version)
    try:
        import mitsuba as mi

        mi.set_variant("llvm_ad_rgb")
        mi.Float(0) + 1
    except ImportError as error:
        return f"Mitsuba 3 does not load ({error}): pip install mitsuba, apt-get install libllvm19."
    return None


def gradient_of(mask: np.ndarray, petal: ProjectedPetal) -> Gradient:
    """Of the mean squared difference between a mask and the rendered silhouette.

    Raises:
        RuntimeError: Mitsuba is not available.
    """
    if problem := available():
        raise RuntimeError(problem)
    import drjit as dr
    import mitsuba as mi

    place = jax.jit(_placed(petal))
    pull = jax.jit(lambda z, gradient: jax.vjp(place, z)[1](gradient)[0])
    scene, params = _scene(mask.shape, np.asarray(place(np.zeros(len(petal.scale)))))
    target = mi.TensorXf(mask[..., None].astype(np.float32))

    def gradient(z: np.ndarray, step: int) -> tuple[float, np.ndarray]:
        vertices = mi.Float(np.array(place(z)).ravel())
        dr.enable_grad(vertices)
        params["petal.vertex_positions"] = vertices
        params.update()
        sky = mi.render(scene, params, spp=RAYS, spp_grad=EDGE_RAYS, seed=step)
        loss = dr.mean(dr.square(1 - sky - target), axis=None)
        dr.backward(loss)
        slope = np.array(dr.grad(vertices)).reshape(-1, 3)
        return loss.numpy().item(), np.asarray(pull(z, slope), np.float64)

    return gradient


def _placed(petal: ProjectedPetal) -> Any:
    """Vertices (n, 3) before a camera at the origin that looks along +z with focal length = width."""
    _, depth = petal.project(jnp.zeros(len(petal.scale)))
    middle = float(depth.mean())
    near = _RELIEF / float(jnp.abs(depth - middle).max())
    height, width = petal.camera.shape
    middle_xy = jnp.array([0.5 * width, 0.5 * height])

    def place(z: jax.Array) -> jax.Array:
        xy, depth = petal.project(z)
        ahead = 1 + near * (jax.lax.stop_gradient(depth) - middle)  # unseen in a silhouette
        aside = (middle_xy - xy) / width * ahead[..., None]  # Mitsuba's x runs left, its y up
        return jnp.concatenate([aside, ahead[..., None]], -1).reshape(-1, 3).astype(jnp.float32)

    return place


def _scene(shape: tuple[int, int], vertices: np.ndarray) -> tuple[Any, Any]:
    """A black mesh, a white sky, and a camera."""
    import mitsuba as mi

    faces = grid_faces()
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(
        {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
    )
    mesh = mi.Mesh("petal", len(vertices), len(faces), properties)
    content = mi.traverse(mesh)
    content["faces"] = mi.UInt32(faces.ravel().astype(np.uint32))
    content["vertex_positions"] = mi.Float(vertices.ravel())
    content.update()
    film = {"type": "hdrfilm", "width": shape[1], "height": shape[0], "rfilter": {"type": "box"}}
    film |= {"pixel_format": "luminance", "sample_border": True}
    camera = {"type": "perspective", "fov": float(np.rad2deg(2 * np.arctan(0.5))), "film": film}
    camera["sampler"] = {"type": "multijitter", "sample_count": RAYS}
    integrator = {"type": "prb_projective", "max_depth": 1, "sppc": 0, "sppi": 0}
    scene = mi.load_dict(
        {"type": "scene", "integrator": integrator, "sensor": camera, "sky": {"type": "constant"}}
        | {"petal": mesh}
    )
    return scene, mi.traverse(scene)


def _llvm_version(path: str) -> int:
    digits = [
        int(part) for part in os.path.basename(path).replace("-", ".").split(".") if part.isdigit()
    ]
    return digits[0] if digits else 0
