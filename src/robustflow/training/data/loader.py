"""Load training batches, starting at a given step; worker processes prepare them in advance."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from multiprocessing import connection, resource_tracker
from typing import Any, cast

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from ...core.errors import RunError
from ...core.processes import safe_path
from .pairs import TrainingPair, TrainingPairs, Whole

_STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)


@dataclass(frozen=True)
class WholeFrames:
    """The uncropped frames of a batch, stacked and zero-padded on the right and at the bottom."""

    image1: Tensor
    image2: Tensor
    corners: Tensor
    sizes: Tensor

    def to(self, device: torch.device) -> WholeFrames:
        """Return a copy on a different device."""
        return WholeFrames(*(value.to(device, non_blocking=True) for value in vars(self).values()))

    def crops(self, height: int, width: int) -> tuple[Tensor, Tensor]:
        """Return the crops of both frames, (B, 3, height, width)."""
        both = torch.stack((self.image1, self.image2), dim=1)
        corners = self.corners.long().tolist()
        cut = [frames[..., y : y + height, x : x + width] for frames, (x, y) in zip(both, corners, strict=True)]
        first, second = torch.stack(cut).unbind(dim=1)
        return first, second


@dataclass(frozen=True)
class Batch:
    """The pairs of a batch."""

    image1: Tensor
    image2: Tensor
    flow: Tensor
    valid: Tensor
    names: tuple[str, ...]
    time: int | None = None
    noise: Tensor | None = None
    whole: WholeFrames | None = None
    plain: WholeFrames | None = None
    changed: tuple[Tensor, Tensor] | None = None

    def to(self, device: torch.device) -> Batch:
        """Return a copy on a different device."""
        moved: dict[str, Any] = {
            name: value.to(device, non_blocking=True) for name, value in vars(self).items() if isinstance(value, Tensor)
        }
        for name, frames in (("whole", self.whole), ("plain", self.plain)):
            moved[name] = None if frames is None else frames.to(device)
        if self.changed is not None:
            moved["changed"] = tuple(value.to(device, non_blocking=True) for value in self.changed)
        return replace(self, **moved)


@dataclass(frozen=True)
class Share:
    """The share of each batch that one process computes; all processes have the same number of consecutive pairs."""

    batch: int
    rank: int = 0
    world: int = 1

    def positions(self, step: int) -> list[int]:
        """Return the positions of this process's pairs in a step."""
        each = self.batch // self.world
        first = step * self.batch + self.rank * each
        return list(range(first, first + each))


def batches(pairs: TrainingPairs, share: Share, steps: range, workers: int) -> Generator[Batch, None, None]:
    """Yield the batches of some steps, in order. Closing the generator ends its processes."""
    loader = DataLoader(
        cast("Dataset[TrainingPair]", pairs),
        batch_sampler=map(share.positions, steps),
        num_workers=workers,
        collate_fn=_collated,
        multiprocessing_context="spawn" if workers else None,
        worker_init_fn=_start_worker,
        prefetch_factor=4 if workers else None,
    )
    with safe_path(), _signals_blocked():
        reading = iter(loader)
    yield from reading


@contextmanager
def _signals_blocked() -> Iterator[None]:
    """Block stop signals while workers start, so that none kills a worker that does not ignore them yet; the main
    process would then wait for its data forever. The resource tracker must already be running, because starting it
    unblocks the signals."""
    resource_tracker.ensure_running()
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, _STOP_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


@contextmanager
def workers_watched() -> Iterator[None]:
    """Wrap all code that runs while workers are alive: PyTorch may report a dead worker at any time, even while a log
    is being closed after the first report.
    """
    try:
        yield
    except Exception as error:
        cut_off = isinstance(error, ConnectionError | EOFError)  # the worker's last batch, before its death is reported
        if not (cut_off or _is_dead_worker(error)):
            raise
        _reap(wait_s=5 if cut_off else 0)
        raise RunError(
            "--loaders",
            "a process that reads training pairs was killed, which happens when memory or /dev/shm is full; the last "
            "checkpoint is kept: use fewer, and continue with --resume",
        ) from error


def _reap(wait_s: float) -> None:
    """Reap dead workers: until then, PyTorch raises its report wherever the main thread is when any child ends."""
    while True:
        try:
            alive = {child.sentinel: child for child in multiprocessing.active_children()}
            for ended in connection.wait(list(alive), wait_s) if alive else ():
                alive[cast(int, ended)].join()
            return
        except RuntimeError:  # the report
            wait_s = 0


def _is_dead_worker(error: BaseException | None) -> bool:
    """Return whether an error, or its cause, is PyTorch's report of a dead worker. A report that interrupts the writing
    of a checkpoint is followed by an error about the unfinished file."""
    while error is not None:
        if isinstance(error, RuntimeError) and "DataLoader worker" in str(error):
            return True
        error = error.__cause__ or error.__context__
    return False


def _collated(pairs: Sequence[TrainingPair]) -> Batch:
    image1, image2, flow, valid = (
        torch.from_numpy(np.stack(arrays))
        for arrays in zip(*((pair.frame1, pair.frame2, pair.flow, pair.valid) for pair in pairs), strict=True)
    )
    changed = [pair.changed for pair in pairs if pair.changed is not None]
    both = tuple(torch.from_numpy(np.stack(arrays)) for arrays in zip(*changed, strict=True))
    return Batch(
        image1,
        image2,
        flow,
        valid,
        tuple(pair.name for pair in pairs),
        whole=_stacked_whole_frames([pair.whole for pair in pairs if pair.whole is not None]),
        plain=_stacked_whole_frames([pair.plain for pair in pairs if pair.plain is not None]),
        changed=(both[0], both[1]) if both else None,
    )


def _stacked_whole_frames(frames: Sequence[Whole]) -> WholeFrames | None:
    if not frames:
        return None
    sizes = [one.frame1.shape[1:] for one in frames]
    height, width = (max(sides) for sides in zip(*sizes, strict=True))
    images = torch.zeros(2, len(frames), 3, height, width)
    for number, (one, (rows, columns)) in enumerate(zip(frames, sizes, strict=True)):
        images[0, number, :, :rows, :columns] = torch.from_numpy(one.frame1)
        images[1, number, :, :rows, :columns] = torch.from_numpy(one.frame2)
    return WholeFrames(
        images[0],
        images[1],
        torch.tensor([one.corner for one in frames], dtype=torch.float32),
        torch.tensor([(columns, rows) for rows, columns in sizes], dtype=torch.float32),
    )


def _start_worker(number: int) -> None:
    # PyTorch notices only a parent that ends after this call, so a worker would outlive one that was killed before.
    threading.Thread(target=_exit_with_parent, daemon=True).start()
    # Ctrl-C and a scheduler's signals reach every process of a training run; the main process decides when to stop.
    for sent in _STOP_SIGNALS:
        signal.signal(sent, signal.SIG_IGN)
    cv2.setNumThreads(1)
    torch.set_num_threads(1)


def _exit_with_parent() -> None:
    if (parent := multiprocessing.parent_process()) is not None:
        parent.join()
        os._exit(1)
