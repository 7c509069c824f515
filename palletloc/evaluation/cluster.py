"""Evaluating recordings in parallel on Dask: workers of our own, or those of a scheduler that runs already."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from palletloc.errors import PalletLocError
from palletloc.evaluation.batch import BatchJob, BatchResult, evaluate_job

CONNECT_TIMEOUT = 10.0
"""How long to wait for a scheduler, in seconds."""


class ClusterError(PalletLocError):
    """Dask is not installed, or its scheduler cannot be reached."""


def evaluate_in_parallel(
    jobs: Sequence[BatchJob],
    workers: int | None = None,
    scheduler: str | None = None,
    work: Callable[[BatchJob], BatchResult] = evaluate_job,
) -> Iterator[BatchResult]:
    """Evaluate recordings and give the results as they come.

    Parameters
    ----------
    jobs : sequence of BatchJob
        What to do. Other machines have to see the same folders under the same paths.
    workers : int, optional
        How many processes of our own to start, reachable from this machine only; as many as there are processors if
        left out.
    scheduler : str, optional
        Address of a scheduler to use instead, like ``tcp://127.0.0.1:8786``.
    work : callable
        What a worker does with a job.

    Yields
    ------
    BatchResult
        One for each job; a worker that dies is the problem of its job alone.

    Raises
    ------
    ClusterError
        If Dask is not installed or the scheduler cannot be reached.
    """
    try:
        from distributed import Client, LocalCluster, as_completed  # an extra, and slow to import
    except ImportError:
        raise ClusterError(
            "--batch needs dask.distributed; expected it to be installed: python -m pip install 'palletloc[batch]'"
        ) from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what fails is told by the results
    if scheduler is not None:
        try:
            client = Client(scheduler, timeout=CONNECT_TIMEOUT)
        except (OSError, ValueError) as error:
            told = " ".join(str(error).split()) or type(error).__name__
            raise ClusterError(f"--scheduler {scheduler}: cannot be reached: {told}") from None
        with client:
            yield from _results(client, as_completed, jobs, work)
        return
    count = min(workers or os.cpu_count() or 1, len(jobs))
    cluster = LocalCluster(
        n_workers=count,
        threads_per_worker=1,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        silence_logs=logging.CRITICAL,
    )
    with cluster, Client(cluster) as client:
        yield from _results(client, as_completed, jobs, work)


def _results(
    client: Any, as_completed: Any, jobs: Sequence[BatchJob], work: Callable[[BatchJob], BatchResult]
) -> Iterator[BatchResult]:
    futures = client.map(work, jobs, pure=False)
    names = {future.key: job.recording.name for future, job in zip(futures, jobs, strict=True)}
    for future in as_completed(futures):
        error = future.exception()
        if error is None:
            yield future.result()
        else:
            told = " ".join(f"{type(error).__name__}: {error}".split())
            yield BatchResult(names[future.key], problem=told)
