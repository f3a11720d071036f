"""Batches of a training, from a given step on, prepared in advance by worker processes."""

from __future__ import annotations

import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from ...errors import RunError
from ...safe_path import safe_path
from .pairs import TrainingPair, TrainingPairs, Whole


@dataclass(frozen=True)
class WholeFrames:
    """The frames from which the pairs of a batch were cropped, stacked, padded with zeros at the right and below.

    Attributes:
        image1, image2: float32 (B, 3, H', W'), RGB 0..255.
        corners: float32 (B, 2), x and y of each crop's first pixel.
        sizes: float32 (B, 2), width and height of each frame.
    """

    image1: Tensor
    image2: Tensor
    corners: Tensor
    sizes: Tensor

    def to(self, device: torch.device) -> WholeFrames:
        """A copy on another device."""
        parts = (self.image1, self.image2, self.corners, self.sizes)
        return WholeFrames(*(value.to(device, non_blocking=True) for value in parts))

    def crops(self, height: int, width: int) -> tuple[Tensor, Tensor]:
        """The crops of both frames, (B, 3, height, width)."""
        both = torch.stack((self.image1, self.image2), dim=1)
        corners = self.corners.long().tolist()
        cut = [frames[..., y : y + height, x : x + width] for frames, (x, y) in zip(both, corners, strict=True)]
        first, second = torch.stack(cut).unbind(dim=1)
        return first, second


@dataclass(frozen=True)
class Batch:
    """Pairs that go through the network together.

    Attributes:
        image1, image2: float32 (B, 3, H, W), RGB 0..255.
        flow: float32 (B, 2, H, W), pixels.
        valid: float32 (B, H, W), 0 or 1.
        names: of the pairs.
        time: from which the ground truth is denoised, 0 (clean) to 999 (noise); None if the loss does not denoise.
        noise: for that, standard normal, (B, 2, H / 8, W / 8).
        whole, plain, changed: see `TrainingPair`.
    """

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
        """A copy on another device."""
        image1, image2, flow, valid = (
            value.to(device, non_blocking=True) for value in (self.image1, self.image2, self.flow, self.valid)
        )
        whole, plain = (None if frames is None else frames.to(device) for frames in (self.whole, self.plain))
        changed = None
        if self.changed is not None:
            changed = (
                self.changed[0].to(device, non_blocking=True),
                self.changed[1].to(device, non_blocking=True),
            )
        return replace(
            self, image1=image1, image2=image2, flow=flow, valid=valid, whole=whole, plain=plain, changed=changed
        )


@dataclass(frozen=True)
class Share:
    """Which pairs of each batch a process computes: every process the same number, consecutively.

    Attributes:
        batch: pairs of a step, over all processes; a multiple of `world`.
        rank: of this process.
        world: processes.
    """

    batch: int
    rank: int = 0
    world: int = 1

    def positions(self, step: int) -> list[int]:
        """The positions of this process's pairs of a step.

        >>> Share(6, rank=1, world=2).positions(10)
        [63, 64, 65]
        """
        each = self.batch // self.world
        first = step * self.batch + self.rank * each
        return list(range(first, first + each))


def batches(pairs: TrainingPairs, share: Share, steps: range, workers: int) -> Iterator[Batch]:
    """The batches of some steps, in order.

    Args:
        pairs: of the training.
        share: of this process.
        steps: from the first to the last.
        workers: processes that read and augment in advance; with 0 this process does.
    """
    loader = DataLoader(
        _Positions(pairs),
        batch_sampler=_Steps(share, steps),
        num_workers=workers,
        collate_fn=_collated,
        multiprocessing_context="spawn" if workers else None,
        worker_init_fn=_quiet_worker,
        prefetch_factor=4 if workers else None,
    )
    with safe_path():
        reading = iter(loader)
    yield from reading


@contextmanager
def workers_watched() -> Iterator[None]:
    """Wraps everything that happens while workers live: PyTorch may notice at any moment that one is gone, even while a
    log is closed because of that.

    Raises:
        RunError: a worker was killed.
    """
    try:
        yield
    except Exception as error:
        if not (_tells_of_a_worker(error) or isinstance(error, ConnectionError | EOFError)):  # a batch it was sending
            raise
        raise RunError(
            "a process that reads training pairs was killed, as happens when memory or /dev/shm is full; "
            "the last checkpoint is kept: give fewer --loaders, and continue with --resume"
        ) from error


def _tells_of_a_worker(error: BaseException | None) -> bool:
    """Whether this error or its cause is PyTorch's about a worker: if it is raised while a checkpoint is written, an
    error about the unfinished file follows."""
    while error is not None:
        if isinstance(error, RuntimeError) and "DataLoader worker" in str(error):
            return True
        error = error.__cause__ or error.__context__
    return False


class _Positions(Dataset[TrainingPair]):
    def __init__(self, pairs: TrainingPairs) -> None:
        self._pairs = pairs

    def __getitem__(self, position: int) -> TrainingPair:
        return self._pairs[position]


class _Steps:
    """The batch sampler of a `DataLoader`: the positions of one step after the other."""

    def __init__(self, share: Share, steps: range) -> None:
        self._share = share
        self._steps = steps

    def __iter__(self) -> Iterator[list[int]]:
        return (self._share.positions(step) for step in self._steps)

    def __len__(self) -> int:
        return len(self._steps)


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
        whole=_whole([pair.whole for pair in pairs if pair.whole is not None]),
        plain=_whole([pair.plain for pair in pairs if pair.plain is not None]),
        changed=(both[0], both[1]) if both else None,
    )


def _whole(frames: Sequence[Whole]) -> WholeFrames | None:
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


def _quiet_worker(number: int) -> None:
    # Ctrl-C and a scheduler's signal reach every process of a training; its main process decides when it ends.
    for sent in (signal.SIGINT, signal.SIGTERM):
        signal.signal(sent, signal.SIG_IGN)
    cv2.setNumThreads(1)
    torch.set_num_threads(1)
