"""Processes that share the batches of one training: each computes the gradients of its pictures, all take the mean.

The networks begin alike and take equal steps, so nothing but gradients is ever exchanged. Statistics of batch
normalisation are each process's own; the first one's are saved.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor, distributed


class Shard(NamedTuple):
    """Which part of every batch a process computes."""

    rank: int
    processes: int


ALONE = Shard(0, 1)
PATIENCE = timedelta(hours=2)
"""How long the others wait for the first process, which validates."""


def share_gradients(parameters: Iterable[Tensor], shard: Shard) -> None:
    """Replace the gradients by their mean over all processes."""
    if shard.processes == 1:
        return
    gradients = [value.grad for value in parameters if value.grad is not None]
    flat = torch.cat([gradient.reshape(-1) for gradient in gradients])
    distributed.all_reduce(flat)
    flat /= shard.processes
    for gradient, mean in zip(gradients, flat.split([gradient.numel() for gradient in gradients]), strict=True):
        gradient.copy_(mean.view(gradient.shape))


@contextmanager
def others(make: Callable[[Shard], Any], count: int, folder: Path) -> Iterator[Shard]:
    """Start count − 1 more processes of a training, and end them with this one's part in it.

    Args:
        make: makes a process's training; it is sent to the others.
        count: processes in all.
        folder: of the run.
    """
    if count == 1:
        yield ALONE
        return
    context = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory(prefix=".workers-", dir=folder) as meeting:
        place = f"file://{Path(meeting).absolute() / 'place'}"
        processes = [
            context.Process(target=_work, args=(make, Shard(rank, count), place), daemon=True)
            for rank in range(1, count)
        ]
        before = os.environ.get("OMP_NUM_THREADS")
        os.environ["OMP_NUM_THREADS"] = "1"  # read by the workers, which start afresh
        try:
            for process in processes:
                process.start()
            shard = Shard(0, count)
            _meet(shard, place)
            yield shard
        finally:
            if before is None:
                del os.environ["OMP_NUM_THREADS"]
            else:
                os.environ["OMP_NUM_THREADS"] = before
            for process in processes:
                process.terminate()
            for process in processes:
                process.join()
            if distributed.is_initialized():
                distributed.destroy_process_group()


def _work(make: Callable[[Shard], Any], shard: Shard, place: str) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the first process finishes its step, and then ends this one
    training = make(shard)
    _meet(shard, place)
    training.run(progress=False)


def _meet(shard: Shard, place: str) -> None:
    rank, count = shard
    distributed.init_process_group("gloo", init_method=place, rank=rank, world_size=count, timeout=PATIENCE)
