"""The provenance of the numbers: the program and the data behind them, and all of their digits."""

from __future__ import annotations

import dataclasses
import html

import equinox as eqx
import numpy as np

from petalfit.report.rounding import listed
from petalfit.report.shown import shown
from petalfit.results import Agreement, FitRecord
from petalfit.results.file import FORMAT, VERSION

_AS_CODE = ("command", "its SHA-256", "rotation")


def provenance(result: FitRecord) -> str:
    """The section of the page on provenance, as HTML."""
    rows = {"made by": result.made_by, "command": result.command}
    rows |= {
        "input": listed([shown(part).whole(part) for part in result.agreements]),
        "its SHA-256": result.input_hash,
        "model": type(result.model).__name__,
        "status": f"{result.status}: {result.status.meaning}",
        "message": result.message,
        "rms distance": ", ".join(f"{part.rms!r}{_unit(part)}" for part in result.agreements),
        "noise σ": ", ".join(f"{part.noise!r}{_unit(part)}" for part in result.agreements),
        **_pose(result),
        "seconds": ", ".join(f"{name} {x:.2g}" for name, x in result.timings.items()),
        "file format": f"{FORMAT}, version {VERSION}",
    }
    terms = "\n".join(
        f"<div><dt>{html.escape(key)}</dt><dd>{_as_html(key, value)}</dd></div>"
        for key, value in rows.items()
        if value
    )
    return (
        f'<section class="provenance"><h2>Provenance</h2><dl>{terms}</dl>'
        f"{_details(result.model)}</section>"
    )


def _as_html(key: str, value: str) -> str:
    """A value, which is plain text wherever it comes from, as HTML."""
    text = html.escape(value).replace("\n", "<br>")
    return f"<code>{text}</code>" if key in _AS_CODE else text


def _unit(part: Agreement) -> str:
    return " px" if part.unit == "px" else ""


def _pose(result: FitRecord) -> dict[str, str]:
    pose = result.pose
    if pose.scale == 1.0 and not pose.translation.any() and (pose.rotation == np.eye(3)).all():
        return {"pose": "the target is in the model's frame"}
    rotation = "\n".join(
        " ".join(f"{number:+.6f}" for number in row) for row in pose.rotation.tolist()
    )
    return {
        "scale": f"{float(pose.scale)!r}",
        "rotation": rotation,
        "translation": ", ".join(map(repr, pose.translation.tolist())),
    }


def _code(model: eqx.Module, depth: int = 1) -> str | None:
    """A call that makes the model, as text; None for a model with arrays, which are too long to read."""
    lines = []
    for field in dataclasses.fields(model):
        value = getattr(model, field.name)
        if isinstance(value, eqx.Module):
            text = _code(value, depth + 1)
        elif field.metadata.get("static"):
            text = repr(value)
        else:
            text = repr(float(value)) if np.ndim(value) == 0 else None
        if text is None:
            return None
        lines.append(f"{'    ' * depth}{field.name}={text},\n")
    name, indent = type(model).__name__, "    " * (depth - 1)
    return f"petalfit.{name}(\n{''.join(lines)}{indent})"


def _details(model: eqx.Module) -> str:
    code = _code(model)
    if code is None:
        return ""
    code = html.escape(code)
    return f"<details><summary>The fitted model as code</summary><pre>{code}</pre></details>"
