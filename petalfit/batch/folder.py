"""A batch of files: what is missing or changed is fitted, and the table has a row for each target."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from petalfit.batch.cluster import as_finished, connected
from petalfit.batch.failure import FitFailure
from petalfit.batch.interrupt import undisturbed
from petalfit.batch.items import Item
from petalfit.batch.many import CRASHED
from petalfit.batch.processes import Crash, cores, in_order
from petalfit.batch.records import Task, finished, keep, perform, read_record
from petalfit.batch.table import TABLE, check_pyarrow, write_table
from petalfit.compilation.cache import folder_in_common
from petalfit.observations import TargetError
from petalfit.results import Status

FITS = "fits"


class Shard(NamedTuple):
    """Every `of`-th target from the `number`-th on; numbers begin with 1."""

    number: int
    of: int


class Progress(NamedTuple):
    """How far a batch is.

    Attributes:
        done: Targets with a record, those of earlier runs included.
        total: Targets of this run's share.
        failed: How many of those done have not converged.
        last: What happened last, in words; of an earlier run if nothing did.
    """

    done: int
    total: int
    failed: int
    last: str


class Outcome(NamedTuple):
    """What a run of a batch ends with.

    Attributes:
        records: Of this share's targets, in their order.
        fitted: How many were fitted by this run.
        missing: Targets of the whole batch that have no record yet.
    """

    records: list[dict[str, Any]]
    fitted: int
    missing: int


def run_batch(
    items: Sequence[Item],
    out: Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    shard: Shard = Shard(1, 1),  # noqa: B008
    progress: Callable[[Progress], None] = lambda _: None,
) -> Outcome:
    """Fit what has no record yet in the output's folder, and write the table.

    A target's files, `fit.json` and `record.json`, are written by the process that fits it as soon as
    it is fitted. Whatever ends the run, they stay, the next run goes on from there, and the table
    has what there is.

    Args:
        items: Of the whole batch.
        out: Folder of the results, made if need be.
        workers: Processes on this machine; by default one for each core.
        scheduler: Address of a Dask scheduler, whose workers see the same files under the same names; or
            "local" for one of this machine's own; by default none.
        shard: The part of the items that is this run's to fit.
        progress: Called after each target.

    Raises:
        TargetError: The output cannot be written, its disk is full, or the scheduler does not answer.
    """
    check_pyarrow()
    programs = folder_in_common()
    tasks = [Task(item, out / FITS / item.id, programs) for item in items]
    mine = tasks[shard.number - 1 :: shard.of]
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TargetError(f"{out} cannot be made: {error.strerror or error}.") from None
    known = {task.item.id: record for task in mine if (record := finished(task))}
    todo = [task for task in mine if task.item.id not in known]
    failed = sum(not record["converged"] for record in known.values())
    done = len(known)
    progress(Progress(done, len(mine), failed, f"{done} of an earlier run" if done else ""))
    performed = _performed(todo, workers, scheduler)
    try:
        for task, outcome in performed:
            record = _crashed(task) if isinstance(outcome, Crash) else outcome
            known[task.item.id] = record
            done, failed = done + 1, failed + (not record["converged"])
            progress(Progress(done, len(mine), failed, f"{task.item.id}: {record['status']}"))
            if record.get("disk_full"):
                raise TargetError(
                    f"{record['message']}. What is finished stays; make room, and run it again."
                )
    finally:
        with undisturbed():
            # Ends the processes first: what they finish till then is in the table.
            performed.close()
            missing = _write_whole(tasks, out)
    records = [known[task.item.id] for task in mine]
    return Outcome(records, len(todo), missing)


def _performed(
    todo: Sequence[Task], workers: int | None, scheduler: str | None
) -> Generator[tuple[Task, dict[str, Any] | Crash]]:
    """Every task with its record, as they come."""
    if not todo:
        return
    if scheduler is None:
        count = min(workers or cores(), len(todo))
        yield from zip(todo, in_order(perform, todo, count), strict=True)
        return
    with connected(scheduler, workers) as client:
        yield from as_finished(client, perform, todo)


def _crashed(task: Task) -> dict[str, Any]:
    return keep(task, FitFailure(Status.CRASHED, CRASHED), "", math.nan)


def _write_whole(tasks: Sequence[Task], out: Path) -> int:
    """The table of all records that there are, and how many are missing.

    Another shard may be doing the same: whoever comes last has seen them all.
    """
    written = -1
    while True:
        records = [record for task in tasks if (record := read_record(task.folder)) is not None]
        if len(records) == written:
            return len(tasks) - written
        try:
            write_table(records, out / TABLE)
        except OSError as error:
            raise TargetError(
                f"{out / TABLE} cannot be written: {error.strerror or error}."
            ) from None
        written = len(records)
