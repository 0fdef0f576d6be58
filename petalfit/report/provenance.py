"""Where the numbers come from: what made them, of what, and all of their digits."""

from __future__ import annotations

import html

import numpy as np

from petalfit.components import parameters
from petalfit.fitting import result as results
from petalfit.fitting.result import Agreement, FitResult
from petalfit.observations import PointCloud
from petalfit.report.rounding import count, listed


def named(part: Agreement) -> str:
    """What was fitted, in words."""
    if isinstance(part.target, PointCloud):
        return count(int(np.count_nonzero(part.used)), "point")
    rows, columns = part.target.mask.shape
    return f"a mask of {columns} × {rows} pixels"


def provenance(result: FitResult) -> str:
    """The section of the page."""
    rows = {"made by": html.escape(result.made_by)}
    if result.command:
        rows["command"] = f"<code>{html.escape(result.command)}</code>"
    rows |= {
        "input": listed([named(part) for part in result.agreements]),
        "its SHA-256": f"<code>{result.input_hash}</code>",
        "model": html.escape(type(result.model).__name__),
        "status": html.escape(result.status),
        "message": html.escape(result.message),
        "rms distance": ", ".join(f"{part.rms!r}{_unit(part)}" for part in result.agreements),
        "noise σ": ", ".join(f"{part.noise!r}{_unit(part)}" for part in result.agreements),
        **_pose(result),
    }
    if result.timings:
        rows["seconds"] = ", ".join(f"{name} {x:.2g}" for name, x in result.timings.items())
    rows["file format"] = f"{results.FORMAT}, version {results.VERSION}"
    terms = "\n".join(
        f"<div><dt>{html.escape(key)}</dt><dd>{value}</dd></div>" for key, value in rows.items()
    )
    return (
        f'<section class="provenance"><h2>Provenance</h2><dl>{terms}</dl>'
        f"<details><summary>The fitted model as code</summary><pre>{_call(result)}</pre></details>"
        "</section>"
    )


def _unit(part: Agreement) -> str:
    return " px" if part.unit == "px" else ""


def _pose(result: FitResult) -> dict[str, str]:
    pose = result.pose
    if pose.scale == 1.0 and not pose.translation.any() and (pose.rotation == np.eye(3)).all():
        return {"pose": "the target is in the model's frame"}
    rotation = "<br>".join(
        " ".join(f"{number:+.6f}" for number in row) for row in pose.rotation.tolist()
    )
    return {
        "scale": f"{float(pose.scale)!r}",
        "rotation": f"<code>{rotation}</code>",
        "translation": ", ".join(map(repr, pose.translation.tolist())),
    }


def _call(result: FitResult) -> str:
    arguments = "\n".join(
        f"    {name}={result.values[name]!r}," for name in parameters(result.model)
    )
    return html.escape(f"petalfit.{type(result.model).__name__}(\n{arguments}\n)")
