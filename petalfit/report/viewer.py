"""The interactive 3-D view: surfaces and points that a reader turns, drawn by a script in the page."""

from __future__ import annotations

import base64
import hashlib
import html
import importlib.resources
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from petalfit.report.colour import FRONT, IGNORED, NEGATIVE, POSITIVE, REAR, ZERO, css
from petalfit.report.rounding import count, plain
from petalfit.report.scene import BASE, FACE, LIGHT, OBLIQUE, SIDE, Scene, View, distance_limit
from petalfit.report.shown import shown
from petalfit.report.swatch import ignored, swatch
from petalfit.results import Agreement, FitRecord

# The most points of all clouds together. A point takes 7 bytes.
_POINTS = 20_000
# A surface takes 50 kB. If there are more surfaces than this, each is small and gets every second vertex.
_FINE_SHEETS = 4
# Places are written as fractions of the range of their coordinates, normals and values as fractions of 1.
_PLACES, _SIGNED = 65535, 127

_LABEL = "The fit in 3-D. Arrow keys turn it, plus and minus zoom, 0 resets it."
_HINT = (
    "Drag to turn, with shift to move; two fingers or the wheel (after a click) zoom, a double click "
    "resets. Keys: arrows, + and −, 0."
)


def viewer(result: FitRecord, scenes: Sequence[Scene], parts: Sequence[Agreement | None]) -> str:
    """The viewer as a figure that stays hidden until its script runs.

    Args:
        result: The fit.
        scenes: The scenes of the fit with each of its clouds, or one scene without points; finite.
        parts: The observation that the points of each scene belong to; None for a scene without points.
    """
    clouds = [(scene, part) for scene, part in zip(scenes, parts, strict=True) if part is not None]
    # All clouds share the widest scale, so that a colour means the same distance everywhere.
    limit = max((distance_limit(part) for _, part in clouds), default=0.0)
    shown, area = [_sheets(scenes[0])], _area(scenes[0].vertices)
    each = _POINTS // max(len(clouds), 1)
    for number, (scene, _) in enumerate(clouds, 1):
        shown += _dots(scene, each, limit, area, f" {number}" if len(clouds) > 1 else "")
    views = _views(result, bool(clouds))
    content = {
        "colours": {
            "front": FRONT.tolist(), "rear": REAR.tolist(), "ignored": IGNORED.tolist(),
            "negative": NEGATIVE.tolist(), "zero": ZERO.tolist(), "positive": POSITIVE.tolist(),
        },
        "light": LIGHT.tolist(),
        "views": [{"name": view.name, "axes": view.axes.tolist()} for view in views],
        "parts": shown,
    }  # fmt: skip
    data = json.dumps(content, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    noise = clouds[0][1].noise if len(clouds) == 1 else 0.0
    unit = "pixels" if result.in_image else "the target's unit"
    return (
        '<figure class="viewer" hidden><div class="stage">'
        f'<canvas tabindex="0" role="application" aria-label="{_LABEL}"></canvas>'
        f'{_GIZMO}<span class="scale"></span></div>\n<div class="controls">'
        f"{_switches(shown)}{_colour_bar(limit, noise) if clouds else ''}{_buttons(views)}</div>\n"
        f"<figcaption>{_caption(scenes[0], clouds, each)} The bar is in {unit}. {_HINT}</figcaption>"
        f'<script type="application/json">{data}</script></figure>'
    )


def script() -> str:
    """The script that starts every viewer of a page."""
    source = importlib.resources.files("petalfit.report").joinpath("viewer.js").read_text("utf-8")
    return (
        f"{source}\nfor (const root of document.querySelectorAll('.viewer')) {{\n"
        "  petalfitViewer(root, JSON.parse(root.querySelector('script').textContent));\n}\n"
    )


def fingerprint(script: str) -> str:
    """The hash by which a page's security policy identifies a script."""
    digest = hashlib.sha256(script.encode()).digest()
    return f"sha256-{base64.b64encode(digest).decode('ascii')}"


def _sheets(scene: Scene) -> dict[str, Any]:
    """The surfaces of all parts, one after the other, as data for the script."""
    step = 1 if len(scene.vertices) <= _FINE_SHEETS else 2
    vertices, normals = scene.vertices[:, ::step, ::step], scene.normals[:, ::step, ::step]
    normals = np.rint(_SIGNED * np.nan_to_num(normals)).astype(np.int8)
    return {
        "name": "surface",
        "grid": vertices.shape[1:3],
        "position": _packed(vertices.reshape(-1, 3)),
        "normal": _base64(normals),
    }


def _area(vertices: Float[np.ndarray, "k n_u n_v 3"]) -> float:
    """The area of all surfaces, summed over their cells."""
    diagonals = (
        vertices[:, 1:, 1:] - vertices[:, :-1, :-1],
        vertices[:, 1:, :-1] - vertices[:, :-1, 1:],
    )
    return float(0.5 * np.linalg.norm(np.cross(*diagonals), axis=-1).sum())


def _dots(scene: Scene, most: int, limit: float, area: float, suffix: str) -> list[dict[str, Any]]:
    """Points with their distances in units of the limit, and separately those without weight."""
    # The mean distance of points spread over the surface; dots of this size leave some of it visible.
    spacing = (area / max(len(scene.points[:most]), 1)) ** 0.5
    points, used = scene.points[:most], scene.used[:most]
    values = np.clip(np.nan_to_num(scene.distances[:most][used] / limit), -1, 1)
    found: list[dict[str, Any]] = []
    if used.any():
        found.append(
            {
                "name": f"points{suffix}",
                "count": int(used.sum()),
                "spacing": spacing,
                "position": _packed(points[used]),
                "value": _base64(np.rint(_SIGNED * values).astype(np.int8)),
            }
        )
    if not used.all():
        without = {
            "count": int((~used).sum()),
            "spacing": spacing,
            "position": _packed(points[~used]),
        }
        found.append({"name": f"ignored points{suffix}", **without})
    return found


def _packed(points: Float[np.ndarray, "n 3"]) -> dict[str, Any]:
    low, size = points.min(axis=0), np.ptp(points, axis=0)
    fractions = (points - low) / np.where(size > 0, size, 1.0)
    whole = np.rint(_PLACES * fractions).astype("<u2")
    return {"low": low.tolist(), "size": size.tolist(), "data": _base64(whole)}


def _base64(array: np.ndarray) -> str:
    return base64.b64encode(array.tobytes()).decode("ascii")


def _views(result: FitRecord, clouds: bool) -> list[View]:
    """The views a reader may choose; the initial one comes first, a camera's if there are only masks."""
    usual = [OBLIQUE, FACE, SIDE, BASE]
    cameras = [
        camera for part in result.agreements if (camera := shown(part).camera(part)) is not None
    ]
    seen = [
        View(
            f"camera {number}" if len(cameras) > 1 else "camera",
            # A camera's axes point right, down and forward, in the target's frame.
            np.array([[1.0], [-1.0], [-1.0]]) * camera.rotation @ np.asarray(result.pose.rotation),
        )
        for number, camera in enumerate(cameras, 1)
    ]
    return [*usual, *seen] if clouds else [*seen, *usual]


def _switches(parts: Sequence[dict[str, Any]]) -> str:
    swatches = {"surface": f"linear-gradient(135deg, {css(FRONT)} 50%, {css(REAR)} 50%)"}
    scale = f"linear-gradient(90deg, {css(NEGATIVE)}, {css(ZERO)}, {css(POSITIVE)})"
    rows = []
    for part in parts:
        colour = swatches.get(part["name"], scale if "value" in part else css(IGNORED))
        rows.append(_switch(part["name"], "checked", colour))
    rows += [_switch("grid lines", "", "var(--grid)"), _switch("normals", "", "var(--accent)")]
    return f'<fieldset class="switches"><legend>Show</legend>{"".join(rows)}</fieldset>'


def _switch(name: str, checked: str, colour: str) -> str:
    box = f'<input type="checkbox" name="{name}" autocomplete="off" {checked}>'
    return f"<label>{box}{swatch(colour)}{name}</label>"


def _colour_bar(limit: float, noise: float) -> str:
    """The colour bar of the distances, with the distances at both ends."""
    of_noise = f" (±{limit / noise:.2g} σ)" if 0 < noise < np.inf and limit < 1e3 * noise else ""
    ends = "".join(f"<span>{plain(part * limit, 2)}</span>" for part in (-1.0, 0.0, 1.0))
    colours = ", ".join(map(css, (NEGATIVE, ZERO, POSITIVE)))
    return (
        f'<div class="colours"><span>Distance{of_noise}</span>'
        f'<div class="bar" style="background:linear-gradient(90deg, {colours})"></div>'
        f'<div class="ends">{ends}</div></div>'
    )


def _buttons(views: Sequence[View]) -> str:
    look = "".join(
        f'<button type="button" value="{i}">{html.escape(view.name.removeprefix("from the "))}</button>'
        for i, view in enumerate(views)
    )
    zoom = (
        '<button type="button" value="nearer" aria-label="nearer">+</button>'
        '<button type="button" value="farther" aria-label="farther">−</button>'
        '<button type="button" value="reset">reset</button>'
    )
    return (
        f'<fieldset class="look"><legend>Look from</legend>{look}</fieldset>'
        f'<fieldset class="look"><legend>Zoom</legend>{zoom}</fieldset>'
    )


def _caption(scene: Scene, clouds: Sequence[tuple[Scene, Agreement]], each: int) -> str:
    total = sum(len(part.distances) for _, part in clouds)
    drawn = sum(min(len(scene.points), each) for scene, _ in clouds)
    sheets = "surfaces" if len(scene.vertices) > 1 else "surface"
    if not clouds:
        return f"The fitted {sheets}, both sides."
    which = f"all {count(total, 'point')}"
    if drawn < total:
        which = f"{drawn:,} of {count(total, 'point')}, chosen at random,"
    return (
        f"The fitted {sheets} and {which} coloured by signed distance, positive on the side of the "
        f"normal{''.join({ignored(scene) for scene, _ in clouds})}."
    )


def _axis(name: str) -> str:
    return f'<g><line/><text text-anchor="middle" dy="4" class="axis-name">{name}</text></g>'


_GIZMO = (
    '<svg class="gizmo" viewBox="-44 -44 88 88" aria-hidden="true">'
    + "".join(map(_axis, "xyz"))
    + "</svg>"
)
