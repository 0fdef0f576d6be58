"""Fits of many targets in memory, with a result for each."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable, Iterator, Sized
from pathlib import Path
from typing import Any, Literal, NamedTuple, overload

import numpy as np

from petalfit.batch.failure import FitFailure
from petalfit.batch.processes import Crash, cores, in_order
from petalfit.compilation import use_folder
from petalfit.compilation.cache import folder_in_common
from petalfit.fitting import DEFAULT, FitResult, check_request, fit
from petalfit.observations import AbstractObservation, Camera, TargetError
from petalfit.results import Status
from petalfit.surfaces import AbstractSurface

CRASHED = (
    "the process that fitted it died twice, the second time alone: of too little memory, or of a "
    "fault in a compiled library"
)


@overload
def fit_batch(targets: Collection[object], **options: Any) -> list[FitResult | FitFailure]: ...
@overload
def fit_batch(targets: Iterator[object], **options: Any) -> Iterator[FitResult | FitFailure]: ...
def fit_batch(  # pyright: ignore[reportInconsistentOverload]
    targets: object,
    *,
    model: type[AbstractSurface] | AbstractSurface | Literal["auto"] = DEFAULT,
    pose: str = "known",
    camera: Camera | None = None,
    free: Iterable[str] | None = None,
    init: AbstractSurface | None = None,
    noise: float | None = None,
    loss: str = "linear",
    seed: int = 0,
    workers: int | None = None,
    progress: Callable[[str], None] | None = None,
) -> list[FitResult | FitFailure] | Iterator[FitResult | FitFailure]:
    """Fit many targets, each by itself, on all cores of this machine.

    Processes are started when they are needed and are kept for the next batch. They share compiled
    programs, in the store in use or in the user's cache. They compute on the processor even where jax
    has a GPU, to which a petal is too small: 16 cores fit a batch 7 times faster than an H200.

    Args:
        targets: The targets, each as in `fit`: a cloud, mesh, mask or path, or a list of these that
            belong together. A list of targets gives a list of results. An iterator, for instance a
            generator, gives an iterator: targets are taken a few at a time, so memory does not grow with
            their number.
        model: The component to fit, by default a petal. This and the following options of `fit` apply to
            all targets.
        pose: See `fit`.
        camera: See `fit`.
        free: See `fit`.
        init: See `fit`.
        noise: See `fit`.
        loss: See `fit`.
        seed: See `fit`.
        workers: The number of processes; by default one for each core. With 1, the targets are fitted in
            this process.
        progress: A function that is called with a line of text after each target.

    Returns:
        One outcome per target, in the order of the targets. It is a `FitResult`, which may not have
        converged, or a `FitFailure` with the reason why there is no result. Both have `converged`,
        `status` and `message`.

    Raises:
        TargetError: The options cannot be used for any target, or `targets` is a single target.
    """
    if (
        isinstance(targets, str | os.PathLike | AbstractObservation)
        or (isinstance(targets, np.ndarray) and targets.ndim == 2)
        or not isinstance(targets, Iterable)
    ):
        raise TargetError("fit_batch takes many targets; give a list of them, or call fit_petal.")
    if workers is not None and workers < 1:
        raise TargetError(f"workers={workers} can fit nothing; give 1 or more.")
    # A tuple, because several fits read it and an iterator could be read only once; text is one name.
    names = free if free is None or isinstance(free, str) else tuple(free)
    request = {"pose": pose, "loss": loss, "free": names, "init": init, "noise": noise}
    check_request(model, **request)
    options = {"model": model, "camera": camera, "seed": seed, **request}
    total = len(targets) if isinstance(targets, Sized) else None
    outcomes = _outcomes(targets, total, options, workers, progress)
    return outcomes if total is None else [*outcomes]


def _outcomes(
    targets: Iterable[object],
    total: int | None,
    options: dict[str, Any],
    workers: int | None,
    progress: Callable[[str], None] | None,
) -> Iterator[FitResult | FitFailure]:
    count = workers or cores()
    if total is not None:
        count = min(count, max(total, 1))
    if count == 1:
        outcomes = map(_fit_one, (_Job(target, options, None) for target in targets))
    else:
        folder = folder_in_common()
        jobs = (_Job(target, options, folder) for target in targets)
        outcomes = in_order(_fit_one, jobs, count)
    failed = 0
    for done, outcome in enumerate(outcomes, 1):
        if isinstance(outcome, Crash):
            outcome = FitFailure(Status.CRASHED, CRASHED)
        failed += not outcome.converged
        if progress is not None:
            of = "" if total is None else f" of {total}"
            progress(f"{done}{of} fitted" + f", {failed} without success" * bool(failed))
        yield outcome


class _Job(NamedTuple):
    """A target, the options of its fit, and the folder of compiled programs."""

    target: object
    options: dict[str, Any]
    folder: Path | None


def _fit_one(job: _Job) -> FitResult | FitFailure:
    """Fits one target, in any process, and returns a failure instead of raising an exception."""
    try:
        with use_folder(job.folder):
            return fit(target=job.target, throw=False, **job.options)
    except Exception as error:
        return FitFailure.of(error)
