"""What may be fitted: anything that can be made a cloud or a silhouette, or a list of these."""

from __future__ import annotations

import base64
import hashlib
import json
import os
import zlib
from collections.abc import Iterable
from typing import Any

import numpy as np
from jaxtyping import Float

from petalfit.observations import (
    Camera,
    PointCloud,
    Silhouette,
    TargetError,
    as_point_cloud,
    read_target,
)


def as_targets(target: object, camera: Camera | None) -> list[PointCloud | Silhouette]:
    """Every target as a cloud or a silhouette.

    Args:
        target: A cloud, a mask, or a list of these; see `petalfit.fit`.
        camera: Of masks that are arrays or files.

    Raises:
        TargetError: There is none, or one cannot be used.
    """
    parts = target if isinstance(target, list | tuple) and _is_list_of_targets(target) else [target]
    return [_as_target(part, camera) for part in parts]


def each_once(target: PointCloud | Silhouette) -> PointCloud | Silhouette:
    """A cloud in which points that repeat others count for nothing: they are no observations more."""
    if not isinstance(target, PointCloud):
        return target
    _, first = np.unique(target.points, axis=0, return_index=True)
    if len(first) == len(target):
        return target
    once = np.zeros(len(target))
    once[first] = 1.0
    return _weighted(target, once)


def with_noise_of_points(
    targets: list[PointCloud | Silhouette], noise: float | Float[np.ndarray, " n"] | None
) -> tuple[list[PointCloud | Silhouette], float | None]:
    """A cloud whose weights say how precise its points are, and the noise of weight 1.

    Args:
        targets: One cloud; anything if there is one noise.
        noise: Standard deviation of every point, positive, shape (n,); or one, which is returned.

    Raises:
        TargetError: There is more, or the noise is not that of its points.
    """
    if not isinstance(noise, np.ndarray):
        return targets, noise
    cloud = targets[0]
    if len(targets) > 1 or not isinstance(cloud, PointCloud):
        raise TargetError("a noise for each point is there for one cloud; give one number.")
    if noise.shape != (len(cloud),):
        raise TargetError(
            f"noise has shape {noise.shape}; give one number, or one for each of the {len(cloud)} points."
        )
    typical = float(np.mean(noise**-2.0) ** -0.5)
    return [_weighted(cloud, (typical / noise) ** 2)], typical


def _weighted(cloud: PointCloud, factor: np.ndarray) -> PointCloud:
    """The cloud with weights that are multiplied."""
    given = 1.0 if cloud.weights is None else cloud.weights
    return PointCloud(cloud.points, cloud.normals, given * factor, cloud.colours)


def _is_list_of_targets(target: list | tuple) -> bool:
    """Rather than rows of coordinates or of pixels."""
    kinds = (PointCloud, Silhouette, str, os.PathLike)
    return any(
        isinstance(part, kinds) or hasattr(part, "vertices") or np.ndim(part) == 2
        for part in target
    )


def _as_target(target: object, camera: Camera | None) -> PointCloud | Silhouette:
    if isinstance(target, Silhouette):
        if target.camera is None and camera is not None:
            return Silhouette(target.mask, camera, target.weights)
        return target
    if isinstance(target, str | os.PathLike):
        return read_target(target, camera)
    if isinstance(target, np.ndarray) and _looks_like_a_mask(target, camera):
        return Silhouette(target, camera)
    return as_point_cloud(target)


def _looks_like_a_mask(array: np.ndarray, camera: Camera | None) -> bool:
    """(N, 3) is a cloud, other matrices are masks, and so are pictures, which the mask refuses."""
    if array.ndim == 3:
        return True
    return array.ndim == 2 and (array.dtype == bool or camera is not None or min(array.shape) > 8)


def digest_of(targets: Iterable[PointCloud | Silhouette]) -> str:
    """SHA-256, in hexadecimal, of all numbers of targets that a fit looks at, in their order."""
    whole = hashlib.sha256()
    for target in targets:
        if isinstance(target, PointCloud):
            arrays, camera = (target.points, target.weights), None
        else:
            arrays, camera = (target.mask, target.weights), target.camera
        shapes = [None if array is None else array.shape for array in arrays]
        head = [type(target).__name__, shapes, None if camera is None else camera.to_json()]
        whole.update(json.dumps(head).encode())
        for array in arrays:
            if array is not None:
                whole.update(np.ascontiguousarray(array, "<f8").tobytes())
    return whole.hexdigest()


def target_to_json(target: PointCloud | Silhouette) -> dict[str, Any]:
    """A target as JSON holds it, lossless."""
    if isinstance(target, PointCloud):
        parts = ("points", "normals", "weights", "colours")
        return {"kind": "cloud"} | {name: getattr(target, name) for name in parts}
    camera = target.camera
    return {
        "kind": "silhouette",
        "shape": list(target.mask.shape),
        "mask": _packed(target.mask),
        "weights": None if target.weights is None else _packed(target.weights),
        "camera": None if camera is None else camera.to_json(),
    }


def target_from_json(content: dict[str, Any]) -> PointCloud | Silhouette:
    """What `target_to_json` made."""
    if content["kind"] == "cloud":
        points, normals, weights = (content[part] for part in ("points", "normals", "weights"))
        return PointCloud(points, normals, weights, content.get("colours"))
    shape = tuple(content["shape"])
    weights, camera = content["weights"], content["camera"]
    return Silhouette(
        _unpacked(content["mask"], shape),
        None if camera is None else Camera.from_json(camera),
        None if weights is None else _unpacked(weights, shape),
    )


def _packed(array: np.ndarray) -> str:
    """As bytes where multiples of 1/255 lose nothing, as doubles otherwise; deflated, in base 64."""
    eight = np.rint(255 * array)
    exact = bool(((eight / 255) == array).all() and (eight <= 255).all())
    content = eight.astype(np.uint8) if exact else array.astype("<f8")
    data = base64.b64encode(zlib.compress(content.tobytes(), 6)).decode("ascii")
    return f"{'u1' if exact else 'f8'}:{data}"


def _unpacked(text: str, shape: tuple[int, ...]) -> np.ndarray:
    kind, _, data = text.partition(":")
    content = zlib.decompress(base64.b64decode(data))
    if kind == "u1":
        return np.frombuffer(content, np.uint8).reshape(shape) / 255
    return np.frombuffer(content, "<f8").reshape(shape).astype(np.float64)
