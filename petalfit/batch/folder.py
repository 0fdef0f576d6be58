"""A batch of files: missing or changed targets are fitted, and the table has a row for each target."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import NamedTuple

from petalfit.batch.cluster import as_finished, connected
from petalfit.batch.failure import FitFailure
from petalfit.batch.interrupt import undisturbed
from petalfit.batch.items import Item
from petalfit.batch.lock import locked
from petalfit.batch.many import CRASHED
from petalfit.batch.processes import Crash, cores, in_order
from petalfit.batch.records import Record, Task, finished, keep, perform, read_record
from petalfit.batch.table import TABLE, check_pyarrow, write_table
from petalfit.compilation.cache import folder_in_common
from petalfit.observations import TargetError
from petalfit.results import Status
from petalfit.schema import SchemaError

FITS = "fits"


class Shard(NamedTuple):
    """A share of the targets: every `of`-th target, beginning with the `number`-th (from 1)."""

    number: int
    of: int


class Progress(NamedTuple):
    """The progress of a batch.

    Attributes:
        done: The number of targets with a record, including those of earlier runs.
        total: The number of targets in this run's share.
        failed: The number of targets with a record that have not converged.
        last: The last event, in words; at the beginning, the number of targets from an earlier run.
    """

    done: int
    total: int
    failed: int
    last: str


class Outcome(NamedTuple):
    """The outcome of a run of a batch.

    Attributes:
        records: The records of this share's targets, in the order of the targets.
        fitted: The number of targets that this run has fitted.
        missing: The number of targets of the whole batch that have no record yet.
        damaged: Sentences on damaged records: those of this share were fitted again, others left out.
    """

    records: list[Record]
    fitted: int
    missing: int
    damaged: list[str]


def run_batch(
    items: Sequence[Item],
    out: Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    shard: Shard = Shard(1, 1),  # noqa: B008
    progress: Callable[[Progress], None] = lambda _: None,
) -> Outcome:
    """Fit all targets that have no record yet in the output folder, and write the table.

    The process that fits a target writes its files, `fit.json` and `record.json`, as soon as the fit has
    ended. However the run ends, these files stay, the table contains them, and the next run continues
    from there.

    Args:
        items: The targets of the whole batch.
        out: The folder of the results, created if necessary.
        workers: The number of processes on this machine; by default one for each core.
        scheduler: The address of a Dask scheduler, whose workers see the same files under the same names,
            or "local" for a local cluster on this machine; by default no cluster is used.
        shard: The share of the items that this run fits.
        progress: A function that is called at the beginning and after each target.

    Raises:
        TargetError: The output cannot be written, its disk is full, another process fits the same targets
            into it, or the scheduler does not answer.
    """
    check_pyarrow()
    try:
        out.mkdir(parents=True, exist_ok=True)
        held = locked(out, shard)
    except OSError as error:
        raise TargetError(f"{out} cannot be made: {error.strerror or error}.") from None
    with held:
        return _run(items, out, workers, scheduler, shard, progress)


def _run(
    items: Sequence[Item],
    out: Path,
    workers: int | None,
    scheduler: str | None,
    shard: Shard,
    progress: Callable[[Progress], None],
) -> Outcome:
    """See `run_batch`."""
    programs = folder_in_common()
    tasks = [Task(item, out / FITS / item.id, programs) for item in items]
    mine = tasks[shard.number - 1 :: shard.of]
    known, damaged = _sound(mine, finished)
    damaged = [f"{what}; its target is fitted again" for what in damaged]
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
            # The processes end first, so that the table contains everything they have finished.
            performed.close()
            missing, left_out = _write_whole(tasks, out)
    records = [known[task.item.id] for task in mine]
    damaged += [f"{what}; it is not in the table" for what in left_out]
    return Outcome(records, len(todo), missing, damaged)


def _sound(
    tasks: Sequence[Task], read: Callable[[Task], Record | None]
) -> tuple[dict[str, Record], list[str]]:
    """The records that a function finds, by id, and what is wrong with the damaged ones."""
    known, damaged = {}, []
    for task in tasks:
        try:
            record = read(task)
        except SchemaError as error:
            damaged.append(str(error))
        else:
            if record is not None:
                known[task.item.id] = record
    return known, damaged


def _performed(
    todo: Sequence[Task], workers: int | None, scheduler: str | None
) -> Generator[tuple[Task, Record | Crash]]:
    """Yields every task with its record, in the order in which they finish."""
    if not todo:
        return
    if scheduler is None:
        count = min(workers or cores(), len(todo))
        yield from zip(todo, in_order(perform, todo, count), strict=True)
        return
    with connected(scheduler, workers) as client:
        yield from as_finished(client, perform, todo)


def _crashed(task: Task) -> Record:
    return keep(task, FitFailure(Status.CRASHED, CRASHED), "", math.nan)


def _write_whole(tasks: Sequence[Task], out: Path) -> tuple[int, list[str]]:
    """Writes the table of all sound records; returns how many are missing, and what is wrong with others.

    Other shards may do the same at the same time; the last one to finish sees all records.
    """
    written = -1
    while True:
        known, damaged = _sound(tasks, read_record)
        if len(known) == written:
            return len(tasks) - written, damaged
        try:
            write_table([*known.values()], out / TABLE)
        except OSError as error:
            raise TargetError(
                f"{out / TABLE} cannot be written: {error.strerror or error}."
            ) from None
        written = len(known)
