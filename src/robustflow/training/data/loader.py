"""Load training batches, starting at a given step; child processes prepare them in advance."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import cycle, islice, zip_longest
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...core.processes import STOP_SIGNALS, Child
from .training_pairs import TrainingPair, TrainingPairs, Whole

_AHEAD = 4
"""Number of batches that each child prepares in advance."""
_ADVICE = "free memory and /dev/shm, or use fewer; the last checkpoint is kept: continue with --resume"


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
        share = self.batch // self.world
        first = step * self.batch + self.rank * share
        return list(range(first, first + share))


def batches(pairs: TrainingPairs, share: Share, steps: range, loaders: int) -> Generator[Batch, None, None]:
    """Yield the batches of some steps, in order. Closing the generator ends its processes."""
    if not loaders:
        yield from (_collated([pairs[position] for position in share.positions(step)]) for step in steps)
        return
    with ExitStack() as stack:
        children: list[Child] = []
        for _ in steps[:loaders]:
            children.append(Child(_load, pairs, share, ignored=STOP_SIGNALS))
            stack.callback(children[-1].end)
        ahead = _AHEAD * len(children)
        for child, step in zip(cycle(children), steps[:ahead], strict=False):
            child.send(step)
        for child, after in zip_longest(islice(cycle(children), len(steps)), steps[ahead:]):
            batch: Batch = child.receive("--loaders", _ADVICE, _ADVICE)[1]
            if after is not None:
                child.send(after)
            yield batch


def _load(pipe: Connection, pairs: TrainingPairs, share: Share) -> None:
    """Send the batches of the steps that arrive, as tensors in shared memory; the main function of a child,
    which ends with its parent, not on a signal to stop: the current update still needs its batches."""
    torch.set_num_threads(1)
    while True:
        step: int = pipe.recv()
        pipe.send(("batch", _collated([pairs[position] for position in share.positions(step)])))


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
    sizes = [whole.frame1.shape[1:] for whole in frames]
    height, width = (max(sides) for sides in zip(*sizes, strict=True))
    images = torch.zeros(2, len(frames), 3, height, width)
    for number, (whole, (rows, columns)) in enumerate(zip(frames, sizes, strict=True)):
        images[0, number, :, :rows, :columns] = torch.from_numpy(whole.frame1)
        images[1, number, :, :rows, :columns] = torch.from_numpy(whole.frame2)
    return WholeFrames(
        images[0],
        images[1],
        torch.tensor([whole.corner for whole in frames], dtype=torch.float32),
        torch.tensor([(columns, rows) for rows, columns in sizes], dtype=torch.float32),
    )
