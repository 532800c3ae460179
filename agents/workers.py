"""Jobs done one after another, or by several processes."""

from __future__ import annotations

import concurrent.futures
import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

Result = TypeVar("Result")


def run_jobs(function: Callable[..., Result], jobs: Sequence[tuple[Any, ...]], workers: int) -> Iterator[Result]:
    """What `function(*job)` returns for each job, in the jobs' order; what has not begun is dropped on an error.

    Args:
        function: of a module's top level, for workers that start afresh.
        workers: processes; 1 is this one.
    """
    if workers == 1:
        for job in jobs:
            yield function(*job)
        return
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # read by the workers, which start afresh
        os.environ.setdefault(variable, "1")
    context = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(workers, mp_context=context) as pool:
        futures = [pool.submit(function, *job) for job in jobs]
        try:
            for future in futures:
                yield future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
