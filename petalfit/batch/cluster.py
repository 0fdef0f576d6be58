"""Running the tasks of a batch on a cluster of dask.distributed."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from petalfit.batch.interrupt import undisturbed
from petalfit.batch.processes import Crash, Job, Outcome, cores, environment
from petalfit.observations import TargetError

if TYPE_CHECKING:
    from distributed import Client

LOCAL = "local"
_CONNECT = 20.0  # seconds


@contextmanager
def connected(scheduler: str, workers: int | None) -> Iterator[Client]:
    """Yields a client of the scheduler at an address, or of a local cluster on this machine.

    Raises:
        TargetError: dask.distributed is not installed, or no scheduler answers at the address.
    """
    try:
        import distributed
    except ImportError:
        raise TargetError(
            "a cluster needs dask.distributed, which is not installed: pip install 'petalfit[batch]'."
        ) from None
    if scheduler == LOCAL:
        cluster = distributed.LocalCluster(
            n_workers=workers or cores(),
            threads_per_worker=1,
            dashboard_address=None,  # pyright: ignore[reportArgumentType] - none
            env=environment(),
            silence_logs=50,
        )
        try:
            yield cluster.get_client()
        finally:
            with undisturbed():
                cluster.close()
        return
    try:
        asyncio.run(_greet(scheduler))
        client = distributed.Client(scheduler, timeout=_CONNECT)
    except (OSError, ValueError) as error:
        raise TargetError(
            f"no Dask scheduler answers at {scheduler} ({str(error) or 'silence'}); start one with "
            f"`dask scheduler`, or give --scheduler {LOCAL}."
        ) from None
    with client:
        yield client


async def _greet(scheduler: str) -> None:
    """Returns when a scheduler has answered; a client would wait without end for one that is silent.

    Raises:
        OSError: It does not answer in time.
    """
    import distributed
    from distributed.security import Security

    arguments = Security().get_connection_args("client")
    async with distributed.rpc(scheduler, connection_args=arguments) as greeted:
        await asyncio.wait_for(greeted.identity(), _CONNECT)


def as_finished(
    client: Client, function: Callable[[Job], Outcome], jobs: Sequence[Job]
) -> Iterator[tuple[Job, Outcome | Crash]]:
    """Yields each job with the function's outcome, in the order in which jobs finish.

    If a worker dies, the cluster repeats its job on another one; a job that kills four workers is a
    `Crash`.

    Raises:
        TargetError: The scheduler has gone.
    """
    import distributed

    futures: dict[Any, Job] = dict(zip(client.map(function, jobs, pure=False), jobs, strict=True))
    for future in distributed.as_completed([*futures], raise_errors=False):
        job = futures.pop(future)
        if future.status == "finished":
            yield job, future.result()
        elif future.status != "error":  # cancelled or lost, with the scheduler
            raise TargetError(
                "the Dask scheduler has gone. What is finished stays; start it, and run the batch again."
            )
        else:
            error = future.exception()
            if not isinstance(error, distributed.KilledWorker):
                raise error
            yield job, Crash()
        future.release()
