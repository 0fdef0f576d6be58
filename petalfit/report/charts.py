"""The charts of the page as inline SVG; text and lines take the page's colours, light or dark."""

from __future__ import annotations

import base64
import html
import math

import numpy as np
from jaxtyping import Float

from petalfit.report.colour import IGNORED, MASK, NEGATIVE, POSITIVE, ZERO, css, diverging
from petalfit.report.overlay import Overlay
from petalfit.report.raster import png
from petalfit.report.rounding import fixed, plain, round_up, ticks
from petalfit.report.scene import Picture, Scene
from petalfit.results import Profile

_LIMIT = 3.84  # χ² of one degree of freedom, 95 %
DENSITY = 2  # pixels of a picture per pixel of the page


def _svg(width: float, height: float, label: str, content: list[str], enlarged: float = 1.0) -> str:
    """An SVG drawing that scales with its column, with a label for readers who cannot see it."""
    return (
        f'<svg viewBox="0 0 {width:g} {height:g}" style="max-width:{enlarged * width:g}px" '
        f'role="img" aria-label="{html.escape(label)}">\n' + "\n".join(content) + "\n</svg>"
    )


def _text(x: float, y: float, text: str, anchor: str = "middle", extra: str = "") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"{extra}>{html.escape(text)}</text>'


def _line(x1: float, y1: float, x2: float, y2: float, kind: str = "axis") -> str:
    return f'<line class="{kind}" x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"/>'


def _path(points: Float[np.ndarray, "n 2"], kind: str) -> str:
    steps = " ".join(f"{x:.1f},{y:.1f}" for x, y in points.tolist())
    return f'<polyline class="{kind}" points="{steps}"/>'


def _image(picture: Picture, x: float, y: float) -> str:
    height, width = (side / DENSITY for side in picture.rgba.shape[:2])
    data = base64.b64encode(png(picture.rgba)).decode("ascii")
    return (
        f'<image x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" '
        f'href="data:image/png;base64,{data}"/>'
    )


def _tick_labels(values: list[float]) -> list[str]:
    """The labels of ticks, all with the decimals that their step needs."""
    step = values[1] - values[0] if len(values) > 1 else abs(values[0]) or 1.0
    if not 1e-5 < step < 1e6:
        return [plain(value) for value in values]
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    return [fixed(value, decimals) for value in values]


def view_chart(picture: Picture) -> str:
    """A drawn view, with the petal's axes and a scale bar below it."""
    height, width = (side / DENSITY for side in picture.rgba.shape[:2])
    middle = height + 24
    content = [_image(picture, 0.0, 0.0)]
    for name, (x, y) in zip("xyz", picture.view.axes[:2].T, strict=True):
        if math.hypot(x, y) < 0.2:
            continue
        start = 28.0, middle + 6
        end = start[0] + 24 * x, start[1] - 24 * y
        content.append(_line(*start, *end))
        content.append(_text(end[0] + 9 * x, end[1] - 9 * y + 4, name, extra=' class="axis-name"'))
    per_unit = picture.scale / DENSITY
    length = round_up(0.12 * width / per_unit)
    right, left = width - 12, width - 12 - length * per_unit
    content.append(_line(left, middle + 10, right, middle + 10, "bar"))
    content.append(_text((left + right) / 2, middle + 3, plain(length, 1)))
    return _svg(width, height + 44, f"fitted surface and target, {picture.view.name}", content)


def map_chart(picture: Picture, scene: Scene, limit: float, noise: float) -> str:
    """The map of distances with its axes, the fitted outline and a key to the colours."""
    left, top, key = 46.0, 8.0, 76.0
    height, width = (side / DENSITY for side in picture.rgba.shape[:2])
    per_unit = picture.scale / DENSITY
    bottom, right = top + height, left + width
    content = [f'<rect class="plot" x="{left}" y="{top}" width="{width:g}" height="{height:g}"/>']
    (x_low, y_low), spans = picture.corner, np.array([width, height]) / per_unit
    x_ticks = ticks(x_low, x_low + spans[0])
    for value, label in zip(x_ticks, _tick_labels(x_ticks), strict=True):
        x = left + (value - x_low) * per_unit
        content += [_line(x, bottom, x, bottom + 4), _text(x, bottom + 17, label)]
    y_ticks = ticks(y_low, y_low + spans[1])
    for value, label in zip(y_ticks, _tick_labels(y_ticks), strict=True):
        y = bottom - (value - y_low) * per_unit
        content += [_line(left - 4, y, left, y), _text(left - 7, y + 4, label, "end")]
    content.append(_text(left + width / 2, bottom + 34, "x", extra=' class="axis-name"'))
    content.append(_text(8.0, top + height / 2, "y", extra=' class="axis-name"'))
    for outline in scene.outlines:
        edge = (outline[:, :2] - picture.corner) * per_unit
        content.append(_path(np.array([left, bottom]) + edge * [1, -1], "outline"))
    content.append(_image(picture, left, top))
    content += _key(right + 16, top + 22, min(height - 30.0, 200.0), limit, noise)
    return _svg(right + key, bottom + 40, "map of signed distances", content)


def overlay_chart(overlay: Overlay, limit: float, noise: float) -> str:
    """A mask, its contour coloured by distance, and the fitted outline."""
    left, top, right, bottom = overlay.box
    per_pixel = min(440.0 / (right - left), 520.0 / (bottom - top))
    width, height = (right - left) * per_pixel, (bottom - top) * per_pixel
    rgba = np.zeros((*overlay.mask.shape, 4), np.uint8)
    rgba[..., :3] = np.rint(255 * MASK)
    rgba[..., 3] = np.rint(150 * overlay.mask)
    data = base64.b64encode(png(rgba)).decode("ascii")
    content = [
        f'<image width="{width:.1f}" height="{height:.1f}" preserveAspectRatio="none" '
        f'style="image-rendering:pixelated" href="data:image/png;base64,{data}"/>',
        f'<rect class="plot" x="1" y="1" width="{width - 2:.1f}" height="{height - 2:.1f}"/>',
    ]
    # The outline may extend beyond the image, so it is clipped. Drawings of one size may share a name.
    frame = f"frame-{width:.0f}-{height:.0f}"
    content.append(
        f'<clipPath id="{frame}"><rect width="{width:.1f}" height="{height:.1f}"/></clipPath>'
        f'<g clip-path="url(#{frame})">'
    )
    corner = np.array([left, top])
    for ring in overlay.rings:
        thinned = ring[:: max(1, len(ring) // 2000)]
        content.append(_path((np.concatenate([thinned, ring[:1]]) - corner) * per_pixel, "outline"))
    content.append("</g>")
    colours = np.where(overlay.used[:, None], diverging(overlay.distances / limit), IGNORED)
    places = (overlay.places - corner) * per_pixel
    for (x, y), colour in zip(places.tolist(), colours, strict=True):
        content.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="1.6" fill="{css(colour)}"/>')
    content += _key(width + 16, 22.0, min(height - 30.0, 200.0), limit, noise)
    return _svg(width + 76, height + 6, "mask and fitted outline", content)


def _key(x: float, y: float, height: float, limit: float, noise: float) -> list[str]:
    """A colour bar with the distances at its ends and in its middle."""
    stops = zip((0, 0.5, 1), (POSITIVE, ZERO, NEGATIVE), strict=True)
    gradient = "".join(f'<stop offset="{at}" stop-color="{css(c)}"/>' for at, c in stops)
    content = [
        f'<linearGradient id="distance" x2="0" y2="1">{gradient}</linearGradient>',
        f'<rect x="{x:g}" y="{y:g}" width="12" height="{height:g}" rx="2" fill="url(#distance)"/>',
        _text(x - 4, y - 12, "distance", "start"),
    ]
    for part in (1.0, 0.0, -1.0):
        at = y + height * (1 - part) / 2
        content.append(_text(x + 18, at + 4, plain(part * limit, 2), "start"))
    if 0 < noise < math.inf and limit < 1e3 * noise:
        content.append(_text(x - 4, y + height + 20, f"±{limit / noise:.2g} σ", "start"))
    return content


def histogram_chart(
    distances: Float[np.ndarray, " n"], weights: Float[np.ndarray, " n"]
) -> tuple[str, int]:
    """A histogram of distances in units of σ, with the Gaussian that noise alone would give.

    Args:
        distances: The distances in units of σ, finite.
        weights: The weight of each distance, not all 0.

    Returns:
        The drawing, and the number of distances beyond its ends.
    """
    width, height, left, bottom = 390.0, 240.0, 12.0, 200.0
    right = width - 12
    reach = float(max(4, math.ceil(min(np.quantile(np.abs(distances), 0.99), 1e6))))
    bins = int(np.clip(math.sqrt(len(distances)), 16, 48))
    # Normalised by all distances, so that bars and curve are comparable if some lie beyond the ends.
    parts, edges = np.histogram(distances, bins, (-reach, reach), weights=weights)
    density = parts / weights.sum() / np.diff(edges)
    curve_x = np.unique(np.concatenate([np.linspace(-reach, reach, 161), np.linspace(-4, 4, 81)]))
    curve = np.exp(-0.5 * curve_x**2) / math.sqrt(2 * math.pi)
    tallest = 1.06 * max(float(density.max()), float(curve.max()))

    def place(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        across = left + (x + reach) / (2 * reach) * (right - left)
        return np.stack([across, bottom - y / tallest * (bottom - 10)], axis=-1)

    content = []
    tops, ends = place(edges[:-1], density), place(edges[1:], density)
    for (x, y), (x_end, _) in zip(tops.tolist(), ends.tolist(), strict=True):
        if y < bottom:
            size = f'width="{max(x_end - x - 1, 0.5):.1f}" height="{bottom - y:.1f}"'
            content.append(f'<rect class="bin" x="{x + 0.5:.1f}" y="{y:.1f}" {size}/>')
    content += [_path(place(curve_x, curve), "gauss"), _line(left, bottom, right, bottom)]
    values = ticks(-reach, reach, 9)
    for value, label in zip(values, _tick_labels(values), strict=True):
        x = float(place(np.array(value), np.array(0.0))[0])
        content += [_line(x, bottom, x, bottom + 4), _text(x, bottom + 17, label)]
    content.append(_text((left + right) / 2, height - 4, "signed distance / σ"))
    label = "histogram of distances in units of the noise"
    drawing = _svg(width, height, label, content, enlarged=1.25)
    return drawing, int(np.count_nonzero(np.abs(distances) > reach))


def profile_chart(profile: Profile, name: str, value: float) -> str:
    """A chart of a profile likelihood, the fitted value, and the limit of the 95 % interval."""
    width, height, left, bottom, tallest = 300.0, 170.0, 34.0, 132.0, 12.0
    right = width - 12
    x = np.array(profile.values)
    low, high = float(x.min()), float(x.max())

    def place(values: np.ndarray, costs: np.ndarray) -> np.ndarray:
        across = left + (values - low) / (high - low) * (right - left)
        down = bottom - np.minimum(costs, tallest) / tallest * (bottom - 8)
        return np.stack([across, down], axis=-1)

    limit, middle = place(x, np.full(len(x), _LIMIT)), place(np.full(2, value), np.zeros(2))[0]
    content = [
        _line(left, bottom, right, bottom),
        _line(limit[0, 0], limit[0, 1], limit[-1, 0], limit[-1, 1], "track"),
        _text(left - 5, limit[0, 1] + 4, "3.84", "end"),
        _text(left - 5, bottom + 4, "0", "end"),
        _path(place(x, np.array(profile.delta_chi2)), "gauss"),
        f'<circle class="dot" cx="{middle[0]:.1f}" cy="{middle[1]:.1f}" r="3.5"/>',
    ]
    values = ticks(low, high, 5)
    for tick, label in zip(values, _tick_labels(values), strict=True):
        at = float(place(np.array([tick]), np.zeros(1))[0, 0])
        content += [_line(at, bottom, at, bottom + 4), _text(at, bottom + 17, label)]
    content.append(_text((left + right) / 2, height - 4, name))
    return _svg(width, height, f"profile likelihood of {name}", content, enlarged=1.25)


def range_chart(
    value: float, interval: tuple[float, float] | None, typical: tuple[float, float]
) -> str:
    """A chart of a value and its interval within the parameter's typical range."""
    width, height, middle, pad = 110.0, 14.0, 7.0, 7.0
    low, high = typical

    def place(x: float) -> float:
        return pad + float(np.clip((x - low) / (high - low), -0.05, 1.05)) * (width - 2 * pad)

    content = [_line(place(low), middle, place(high), middle, "track")]
    if interval is not None and all(map(math.isfinite, interval)):
        content.append(_line(place(interval[0]), middle, place(interval[1]), middle, "interval"))
    if math.isfinite(value):
        known = "dot" if interval is None or math.isfinite(interval[0]) else "dot open"
        content.append(f'<circle class="{known}" cx="{place(value):.1f}" cy="{middle:g}" r="3.5"/>')
    label = f"in the typical range {plain(low)} to {plain(high)}"
    return _svg(width, height, label, content)
