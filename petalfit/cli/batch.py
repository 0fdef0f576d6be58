"""`petalfit batch`: fits of thousands of files, with one table of the results."""

import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, arg

from petalfit.cli.fit import Free, LossOption, ModelName, Noise, PoseOption, Seed
from petalfit.cli.options import Quiet, names_of, require_noise, require_seed
from petalfit.cli.status import INTERRUPTED, NOT_CONVERGED, SUCCESS, require

if TYPE_CHECKING:
    from petalfit.batch.folder import Outcome, Progress

Source = Annotated[
    Positional[Path],
    arg(
        metavar="DIR|MANIFEST",
        help="Folder whose clouds, meshes and masks are fitted, including those in subfolders. Or a CSV "
        "file with a row for each target. Its column target has a path relative to the CSV file, or "
        "several paths separated by ; that are fitted together. Further columns, for values that differ "
        "between targets, are id, camera, model, pose, loss, noise, free and seed.",
    ),
]
Folder = Annotated[
    Path,
    arg(
        metavar="DIR",
        help="Folder for table.parquet, which has a row for each target, and for fits/ID/fit.json. If "
        "the command is repeated, it fits only targets that are missing or have changed.",
    ),
]
Workers = Annotated[
    int | None, arg(metavar="N", help="Number of processes; by default one for each core here.")
]
Scheduler = Annotated[
    str | None,
    arg(
        metavar="ADDRESS",
        help="Fit on a cluster of dask.distributed, whose workers see the same files under the same "
        "names: tcp://HOST:8786, or local for one on this machine.",
    ),
]
ShardOption = Annotated[
    str,
    arg(
        name="shard",
        metavar="I/N",
        help="Fit only every N-th target, beginning with the I-th: 1/N to N/N, for an array of jobs with "
        "a common --out. The last job to finish completes the table.",
    ),
]
Profile = Annotated[
    bool, arg(help="Print the time of each stage, and the targets that took longest.")
]


def batch(
    source: Source,
    out: Folder,
    model: ModelName = None,
    pose: PoseOption = "known",
    loss: LossOption = "linear",
    free: Free = (),
    noise: Noise = None,
    seed: Seed = 0,
    workers: Workers = None,
    scheduler: Scheduler = None,
    shard: ShardOption = "1/1",
    profile: Profile = False,
    quiet: Quiet = False,
) -> int:
    """Fit all files of a folder or a manifest; the table lists failures with their reasons."""
    if noise is not None:
        require_noise(noise, least="a positive number, or leave it out")
    require_seed(seed)
    require(
        workers is None or workers >= 1, f"--workers {workers} can fit nothing; give 1 or more."
    )
    require(source.exists(), f"{source} does not exist; give a folder or a .csv manifest.")
    number, count = _shard(shard)
    from petalfit.batch.folder import Shard, run_batch
    from petalfit.batch.items import items_of
    from petalfit.cli.models import kind_of
    from petalfit.cli.results import check_folder
    from petalfit.fitting.outliers.registry import loss_named

    check_folder(out)
    kind = kind_of(model)
    loss_named(loss)
    options: dict[str, Any] = {
        "model": kind if isinstance(kind, str) else kind.__name__,
        "pose": pose,
        "loss": loss,
        "noise": noise,
        "seed": seed,
        "free": names_of(free),
    }
    items = items_of(source, options)
    began = time.monotonic()
    latest: list[Progress] = []
    with _bar(quiet) as show:

        def progress(state: "Progress") -> None:
            latest[:] = [state]
            show(state)

        try:
            outcome = run_batch(
                items,
                out,
                workers=workers,
                scheduler=scheduler,
                shard=Shard(number, count),
                progress=progress,
            )
        except KeyboardInterrupt:
            done = f"{latest[0].done} of {latest[0].total}" if latest else "none"
            _say(f"interrupted: {done} are finished and kept; the same command goes on.")
            return INTERRUPTED
    for sentence in outcome.damaged:
        _say(f"warning: {sentence}.")
    if not quiet:
        _summarise(outcome, out, time.monotonic() - began)
        if profile:
            _profile(outcome)
    return SUCCESS if all(record["converged"] for record in outcome.records) else NOT_CONVERGED


def _shard(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d+)/(\d+)", text)
    number, count = map(int, found.groups()) if found else (0, 0)
    require(1 <= number <= count, f"--shard {text} is none; give 1/N to N/N.")
    return number, count


def _say(sentence: str) -> None:
    from petalfit.cli.console import errors

    errors().print(f"petalfit: {sentence}", soft_wrap=True)


@contextmanager
def _bar(quiet: bool) -> Iterator[Callable[["Progress"], None]]:
    """Yields a function that shows progress: as a bar in a terminal, or as occasional lines in a file."""
    from petalfit.cli.console import errors

    console = errors()
    if quiet:
        yield lambda state: None
        return
    if not console.is_terminal:
        yield _line_now_and_then()
        return
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.description}", markup=False),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("starting the workers", total=None)

        def show(state: "Any") -> None:
            failed = f"{state.failed} failed; " if state.failed else ""
            bar.update(
                task, total=state.total, completed=state.done, description=failed + state.last
            )

        yield show


def _line_now_and_then() -> Callable[["Progress"], None]:
    said = time.monotonic()

    def show(state: "Progress") -> None:
        nonlocal said
        if time.monotonic() - said > _EVERY:
            said = time.monotonic()
            _say(f"{state.done} of {state.total} done, {state.failed} of them failed")

    return show


def _summarise(outcome: "Outcome", out: Path, seconds: float) -> None:
    """Prints the numbers of fits by outcome, the reasons of failures, and the path of the table."""
    from collections import Counter

    from petalfit.batch.table import TABLE
    from petalfit.cli.console import output

    console = output()
    rate = f", {outcome.fitted / seconds:.3g} a second" if outcome.fitted > 1 else ""
    console.print(
        f"{len(outcome.records)} targets, {outcome.fitted} of them fitted now in {seconds:.3g} s{rate}",
        soft_wrap=True,
    )
    statuses = Counter(record["status"] for record in outcome.records)
    for status, count in statuses.most_common():
        example = next(record for record in outcome.records if record["status"] == status)
        of = "" if example["converged"] else f"  {example['id']}: {example['message']}"
        console.print(f"{count:>7} {status}{of}", soft_wrap=True)
    rest = f"; {outcome.missing} targets of other shards are missing" if outcome.missing else ""
    console.print(f"{out / TABLE!s}  a row for each target{rest}", soft_wrap=True)


def _profile(outcome: "Outcome") -> None:
    """Prints the time of each stage, and the slowest targets."""
    from collections import defaultdict

    from rich.table import Table

    from petalfit.cli.console import output

    stages: dict[str, float] = defaultdict(float)
    for record in outcome.records:
        for stage, seconds in record.get("timings", {}).items():
            stages[stage] += seconds
        stages["reading and writing"] += max(
            record["seconds"] - sum(record.get("timings", {}).values()), 0.0
        )
    total = sum(stages.values())
    table = Table("stage", header_style="bold")
    for heading in ("seconds", "share", "a target"):
        table.add_column(heading, justify="right")
    for stage, seconds in sorted(stages.items(), key=lambda entry: -entry[1]):
        each = 1000 * seconds / len(outcome.records)
        table.add_row(stage, f"{seconds:.2f}", f"{seconds / total:.0%}", f"{each:.1f} ms")
    output().print(table)
    for record in sorted(outcome.records, key=lambda record: -record["seconds"])[:_SLOWEST]:
        line = f"{record['seconds']:.3g} s  {record['id']}"
        output().print(line, soft_wrap=True)


_EVERY = 30.0  # seconds
_SLOWEST = 5
