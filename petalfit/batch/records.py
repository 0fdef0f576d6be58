"""Records of a batch: one for each target, in the target's folder, written when it has been fitted."""

from __future__ import annotations

import datetime
import errno
import json
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, NamedTuple, Required, TypedDict

import msgspec
import numpy as np

from petalfit import schema
from petalfit.batch.failure import FitFailure
from petalfit.batch.items import BETWEEN, Item
from petalfit.compilation import use_folder
from petalfit.fitting import FitResult, fit
from petalfit.observations import TargetError
from petalfit.observations.atomic import atomic_path
from petalfit.results import Status
from petalfit.schema import Count, NotNegative, SchemaError, encode
from petalfit.version import VERSION

FIT = "fit.json"
RECORD = "record.json"
# Statuses that are not the target's fault and may change, so that the target is tried again.
PASSING = (Status.ERROR, Status.CRASHED, Status.NOT_WRITTEN)
_FULL = (errno.ENOSPC, errno.EDQUOT)
_LARGEST = 10_000_000  # bytes


class WarningOfRecord(TypedDict):
    """A warning of a fit."""

    kind: str
    parameters: list[str]
    text: str


class Record(TypedDict, total=False):
    """A row of the table; see `petalfit.batch.table.write_table`. Failures have the required members."""

    id: Required[str]
    target: Required[str]
    status: Required[Status]
    converged: Required[bool]
    message: Required[str]
    model: Required[str]
    pose: Required[str]
    loss: Required[str]
    seconds: Required[float]
    version: Required[str]
    input_hash: Required[str]
    finished: Required[str]
    disk_full: bool
    warnings: list[WarningOfRecord]
    timings: dict[str, NotNegative]
    data: Count
    outliers: Count
    rms: float
    noise: float
    values: dict[str, float]
    stderr: dict[str, float | None]
    stderr_noise: dict[str, float | None]
    discrepancy: float | None
    discrepancy_length: float | None
    identifiable: dict[str, bool | None]
    traits: dict[str, float]
    trait_stderr: dict[str, float | None]
    scale: float
    rotation: Annotated[list[float], msgspec.Meta(min_length=9, max_length=9)]
    translation: Annotated[list[float], msgspec.Meta(min_length=3, max_length=3)]


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


def finished(task: Task) -> Record | None:
    """The record of an item if it is still valid: same files and options, and no `PASSING` status.

    Raises:
        SchemaError: The record is damaged.
    """
    record = read_record(task)
    if record is None or record["status"] in PASSING:
        return None
    if "values" in record and not (task.folder / FIT).is_file():
        return None
    try:
        digest = task.item.digest()
    except TargetError:  # a file is missing, and its earlier record has an empty digest too
        digest = ""
    return record if record["input_hash"] == digest else None


def read_record(task: Task) -> Record | None:
    """The record in the folder of an item, or None if there is none.

    Raises:
        SchemaError: It is damaged, or that of another item.
    """
    path = task.folder / RECORD
    try:
        record = schema.read(path, Record, _LARGEST)
    except FileNotFoundError:
        return None
    except (OSError, SchemaError) as error:
        raise SchemaError(f"{path} is damaged ({error})") from None
    if record["id"] != as_text(task.item.id):
        raise SchemaError(f"{path} is damaged (it is the record of {record['id']!r})")
    return record


def perform(task: Task) -> Record:
    """Fit a target, and write `fit.json` and its record; raises no exceptions.

    Returns:
        The record, with the status "not_written" if it could not be written.
    """
    began, digest, result = time.perf_counter(), "", None
    try:
        digest = task.item.digest()
        targets = task.item.read()
        if task.item.digest() != digest:
            digest = ""
            raise TargetError("its file changed while it was read; run the batch again.")
        with use_folder(task.programs):
            found = fit(target=targets, throw=False, **task.item.arguments())
        assert isinstance(found, FitResult), "patterns are not among the models"
        result = found
    except Exception as error:
        result = FitFailure.of(error)
    seconds = time.perf_counter() - began
    try:
        return keep(task, result, digest, seconds)
    except Exception as error:
        return keep(task, FitFailure.of(error), digest, seconds)


def keep(task: Task, result: FitResult | FitFailure, digest: str, seconds: float) -> Record:
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
            path.write_text(json.dumps(encode(record), indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        reason = f"{as_text(task.folder)} cannot be written: {error.strerror or error}"
        full = error.errno in _FULL
        return {**record, "status": Status.NOT_WRITTEN, "message": reason, "disk_full": full}
    return record


def as_text(name: str | Path) -> str:
    """A name of a file as text that can be written: bytes that are not UTF-8 become escapes."""
    return os.fspath(name).encode("utf-8", "backslashreplace").decode()


def _record(item: Item, result: FitResult | FitFailure, digest: str, seconds: float) -> Record:
    record: Record = {
        "id": as_text(item.id),
        "target": as_text(BETWEEN.join(map(os.fspath, item.targets))),
        "status": result.status,
        "converged": result.converged,
        "message": as_text(result.message),
        "model": item.options["model"],
        "pose": item.options["pose"],
        "loss": item.options["loss"],
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
    return {
        **record,
        "model": type(result.model).__name__,
        "warnings": [WarningOfRecord(**warning.to_json()) for warning in result.warnings],
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
