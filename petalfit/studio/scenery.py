"""The 3-D scene of a browser: a surface, its normals, and points."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import viser
from jaxtyping import Float, Int

from petalfit.report.colour import FRONT

_NORMALS = 12  # number of normals shown along each side of a surface


class Scenery:
    """The scene of one browser. Lengths are in the model's unit, and y points up."""

    def __init__(self, client: viser.ClientHandle) -> None:
        self._client, self._scene = client, client.scene
        self._scene.set_up_direction("+y")
        # Shadows cost most of the time of a frame, and a petal casts hardly any on itself.
        self._scene.configure_default_lights(cast_shadow=False)
        self._faces: Int[np.ndarray, "f 3"] | None = None
        self._surface: viser.MeshHandle | None = None
        self._points: viser.PointCloudHandle | None = None
        self._extent = 1.0

    def clear(self) -> None:
        """Removes everything from the scene."""
        self._scene.reset()
        self._scene.set_up_direction("+y")
        self._surface = self._points = None

    def look_at(self, points: Float[np.ndarray, "n 3"]) -> None:
        """Moves the viewer to a place obliquely in front, from which all points are visible."""
        low, high = points.min(axis=0), points.max(axis=0)
        middle, self._extent = 0.5 * (low + high), float(np.linalg.norm(high - low))
        away = np.array([0.45, 0.35, 1.0])
        camera = self._client.camera
        with self._client.atomic():
            camera.up_direction = (0.0, 1.0, 0.0)
            camera.position = middle + self._extent * away / np.linalg.norm(away)
            camera.look_at = middle

    def surface(
        self, vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "f 3"], visible: bool
    ) -> None:
        """Replaces the surface."""
        known = self._faces is not None and np.array_equal(self._faces, faces)
        if self._surface is not None and known:
            self._surface.vertices = np.asarray(vertices, np.float32)
            self._surface.visible = visible
            return
        self._faces = faces
        self._surface = self._scene.add_mesh_simple(
            "/surface",
            vertices,
            faces,
            color=tuple(np.rint(255 * FRONT).astype(int).tolist()),
            side="double",
            visible=visible,
        )

    def sheet(
        self,
        name: str,
        vertices: Float[np.ndarray, "n 3"],
        faces: Int[np.ndarray, "m 3"],
        colour: Float[np.ndarray, "3"],
        opacity: float | None,
        visible: bool,
        clicked: Callable[[Any], None],
    ) -> None:
        """Shows a sheet of one colour that reacts to clicks, and replaces an earlier one of its name."""
        self._scene.add_mesh_simple(
            f"/{name}",
            np.asarray(vertices, np.float32),
            faces,
            color=tuple(np.rint(255 * colour).astype(int).tolist()),
            opacity=opacity,
            side="double",
            visible=visible,
        ).on_click(clicked)

    def normals(
        self,
        vertices: Float[np.ndarray, "n 3"],
        normals: Float[np.ndarray, "n 3"],
        visible: bool,
    ) -> None:
        """Shows some normals of the surface as lines."""
        if not visible:
            self._scene.remove_by_name("/normals")
            return
        some = np.linspace(0, len(vertices) - 1, _NORMALS**2).astype(int)
        ends = vertices[some] + 0.06 * self._extent * normals[some]
        self._scene.add_line_segments(
            "/normals",
            np.stack([vertices[some], ends], axis=1),
            (90, 90, 110),
            thickness=0.002 * self._extent,
        )

    def points(
        self,
        points: Float[np.ndarray, "n 3"],
        colours: Float[np.ndarray, "n 3"],
        visible: bool,
        size: float = 0.006,
    ) -> None:
        """Replaces the points; colours run from 0 to 1, and the size is relative to what is in view."""
        shown = self._points
        if len(points) == 0 or not visible:
            if shown is not None:
                shown.visible = False
            return
        places, size = np.asarray(points, np.float32), size * self._extent
        if shown is not None and len(shown.points) == len(places):
            shown.points, shown.point_size, shown.visible = places, size, True
            shown.colors = np.rint(255 * colours).astype(np.uint8)
            return
        self._points = self._scene.add_point_cloud(
            "/points",
            places,
            colours,
            point_size=size,
            point_shape="circle",
            precision="float32",
        )
        # The page makes a new material whenever colours change. When the last material of a kind goes, so
        # does its program, which takes a quarter of a second to compile; an invisible cloud keeps one.
        self._scene.add_point_cloud("/unseen", places[:2], colours[:2], point_size=0.0)

    def model(self, name: str, glb: bytes) -> None:
        """Shows a glTF file, and replaces an earlier one of the same name."""
        self._scene.add_glb(f"/{name}", glb)
