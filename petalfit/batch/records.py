"""Records of a batch: one for each target, in the target's folder, written when it has been fitted."""

from __future__ import annotations

import datetime
import errno
import json
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from petalfit.batch.failure import FitFailure
from petalfit.batch.items import BETWEEN, Item
from petalfit.compilation import use_folder
from petalfit.fitting import FitResult, fit
from petalfit.observations import TargetError
from petalfit.observations.atomic import atomic_path
from petalfit.results import Status
from petalfit.version import VERSION

FIT = "fit.json"
RECORD = "record.json"
# Statuses that are not the target's fault and may change, so that the target is tried again.
PASSING = (Status.ERROR, Status.CRASHED, Status.NOT_WRITTEN)
_FULL = (errno.ENOSPC, errno.EDQUOT)


class Task(NamedTuple):
    """A target to fit, in any process, and the folder of its files.

    Attributes:
        item: The target.
        folder: The target's own folder, created if necessary.
        programs: The folder of compiled programs, or None.
    """

    item: Item
    folder: Path
    programs: Path | None


def finished(task: Task) -> dict[str, Any] | None:
    """The record of an item if it is still valid: same files and options, and no `PASSING` status."""
    record = read_record(task.folder)
    if record is None or record["status"] in PASSING:
        return None
    try:
        digest = task.item.digest()
    except TargetError:  # a file is missing, and its earlier record has an empty digest too
        digest = ""
    return record if record["input_hash"] == digest else None


def read_record(folder: Path) -> dict[str, Any] | None:
    """The record in a folder, or None."""
    try:
        record = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return record if isinstance(record, dict) and {"status", "input_hash"} <= {*record} else None


def perform(task: Task) -> dict[str, Any]:
    """Fit a target, and write `fit.json` and its record; raises no exceptions.

    Returns:
        The record, with the status "not_written" if it could not be written.
    """
    began, digest, result = time.perf_counter(), "", None
    try:
        digest = task.item.digest()
        with use_folder(task.programs):
            found = fit(target=task.item.read(), throw=False, **task.item.arguments())
        assert isinstance(found, FitResult), "patterns are not among the models"
        result = found
    except Exception as error:
        result = FitFailure.of(error)
    return keep(task, result, digest, time.perf_counter() - began)


def keep(task: Task, result: FitResult | FitFailure, digest: str, seconds: float) -> dict[str, Any]:
    """Write the outcome of a target, the fit first: a record implies that all files are complete."""
    with use_folder(task.programs):  # traits are measured with compiled programs
        record = _record(task.item, result, digest, seconds)
    try:
        task.folder.mkdir(parents=True, exist_ok=True)
        if isinstance(result, FitResult):
            result.save(task.folder / FIT)
        else:
            (task.folder / FIT).unlink(missing_ok=True)
        with atomic_path(task.folder / RECORD) as path:
            path.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        full = error.errno in _FULL
        reason = f"{task.folder} cannot be written: {error.strerror or error}"
        return record | {"status": str(Status.NOT_WRITTEN), "message": reason, "disk_full": full}
    return record


def _record(
    item: Item, result: FitResult | FitFailure, digest: str, seconds: float
) -> dict[str, Any]:
    record: dict[str, Any] = {
        "id": item.id,
        "target": BETWEEN.join(map(os.fspath, item.targets)),
        "status": str(result.status),
        "converged": result.converged,
        "message": result.message,
        **{name: item.options[name] for name in ("model", "pose", "loss")},
        "seconds": seconds,
        "version": VERSION,
        "input_hash": digest,
        "finished": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }
    if isinstance(result, FitFailure):
        return record
    first = result.agreements[0]
    identifiable = {name: result.identifiable.get(name) for name in result.values}
    misfit = result.discrepancy
    return record | {
        "model": type(result.model).__name__,
        "warnings": [warning.to_json() for warning in result.warnings],
        "timings": result.timings,
        "data": int(first.distances.size),
        "outliers": first.outliers,
        "rms": first.rms,
        "noise": first.noise,
        "values": result.values,
        "stderr": _known(result.stderr),
        "stderr_noise": _known(result.stderr_noise),
        "discrepancy": None if misfit is None else misfit.deviation,
        "discrepancy_length": None if misfit is None else misfit.length,
        "identifiable": identifiable,
        "traits": {n: trait.value for n, trait in result.traits.items()},
        "trait_stderr": _known({n: trait.stderr for n, trait in result.traits.items()}),
        "scale": float(result.pose.scale),
        "rotation": np.ravel(result.pose.rotation).tolist(),
        "translation": np.ravel(result.pose.translation).tolist(),
    }


def _known(errors: Mapping[str, float]) -> dict[str, float | None]:
    """Errors by name, None for those that are not finite."""
    return {name: x if np.isfinite(x) else None for name, x in errors.items()}
