"""The processes of one training run: a single process, or one per device, started by `torchrun`."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta

import torch
from torch import distributed

from ..core.errors import UsageError
from ..models.torch.network_model import find_device


@dataclass(frozen=True)
class Process:
    """This process's place among the processes of a training run."""

    rank: int
    world: int
    device: torch.device

    def any(self, mine: bool) -> bool:
        """Return whether a value is true in any process; all processes must call this method."""
        if self.world == 1:
            return mine
        answer = torch.tensor(int(mine), device=self.device)
        distributed.all_reduce(answer, distributed.ReduceOp.MAX)
        return bool(answer.item())


@contextmanager
def this_process(device: str) -> Iterator[Process]:
    """Join the other processes of a training run, if `torchrun` started several."""
    world, rank = int(os.environ.get("WORLD_SIZE", "1")), int(os.environ.get("RANK", "0"))
    if world == 1:
        yield Process(0, 1, find_device(device))
        return
    local = int(os.environ.get("LOCAL_RANK", "0"))
    if device in ("auto", "cuda") and torch.cuda.is_available():
        if local >= torch.cuda.device_count():
            raise UsageError(f"{world} processes for {torch.cuda.device_count()} GPUs; start one process per GPU")
        device = f"cuda:{local}"
    chosen = find_device(device)
    # The others wait while process 0 validates, which may take longer than the 10 minutes that NCCL waits by default.
    distributed.init_process_group("nccl" if chosen.type == "cuda" else "gloo", timeout=timedelta(days=1))
    try:
        yield Process(rank, world, chosen)
    finally:
        distributed.destroy_process_group()
