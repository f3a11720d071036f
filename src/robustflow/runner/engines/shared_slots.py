"""Memory shared by two processes: slots of equal size, each of which contains the frames of a cell, then its flow.

The memory is anonymous (`memfd_create`), so it is always freed when both processes have ended, and it is not limited by
/dev/shm, which has 64 MB in a container. A slot takes up no memory until its first use.
"""

from __future__ import annotations

import mmap
import os
from collections.abc import Callable, Sequence
from multiprocessing.reduction import DupFd
from typing import Any

import numpy as np

from ...errors import RunError
from ...sample import Flow, Frame

BUDGET = 128 * 2**20
"""Maximum total size of a feeder's slots in bytes; exceeded only if the minimum number of slots needs more."""
MOST_SLOTS = 64
_PAGE = 4096


class SharedSlots:
    """Slots into which a feeder writes frames, and in which a predicting process replaces the frames with their
    flow.
    """

    def __init__(self, fewest: int) -> None:
        self._attach(os.memfd_create("robustflow-slots"), fewest)

    def _attach(self, descriptor: int, fewest: int) -> None:
        self._descriptor = descriptor
        self._fewest = fewest
        self._map: mmap.mmap | None = None
        self._free: list[int] = []
        self._used: set[int] = set()
        self.count = 0
        """Number of slots, free and used."""
        self.slot_bytes = 0
        """Size of a slot in bytes."""

    def __reduce__(self) -> tuple[Callable[..., SharedSlots], tuple[Any, int]]:
        return _attached, (DupFd(self._descriptor), self._fewest)

    def close(self) -> None:
        """Release the memory in this process; existing views remain valid."""
        os.close(self._descriptor)
        self._map = None

    # Methods used by the feeder.

    @property
    def free(self) -> int:
        """Return the number of free slots."""
        return len(self._free)

    @property
    def in_use(self) -> int:
        """Return the number of slots in use."""
        return self.count - len(self._free)

    def fit(self, size: int) -> bool:
        """Enlarge the slots to at least `size` bytes; return False if this has to wait until no slot is in use."""
        if size <= self.slot_bytes:
            return True
        if self.in_use:
            return False
        self.slot_bytes = -(-size // _PAGE) * _PAGE
        self.count = max(self._fewest, min(MOST_SLOTS, BUDGET // self.slot_bytes))
        self._free = list(range(self.count))[::-1]
        self._used = set()
        whole = max(self.count * self.slot_bytes, os.fstat(self._descriptor).st_size)
        os.ftruncate(self._descriptor, whole)  # reserved so that each process maps it once; takes up no memory yet
        return True

    def take(self) -> int:
        """Return the most recently used free slot, so that fewer slots take up memory."""
        slot = self._free.pop()
        if slot not in self._used:
            try:
                os.posix_fallocate(self._descriptor, slot * self.slot_bytes, self.slot_bytes)
            except OSError as error:
                raise RunError(
                    f"not enough memory for the frames sent to the model ({error.strerror}); try fewer --workers or a "
                    "smaller --batch-size"
                ) from error
            self._used.add(slot)
        return slot

    def put_back(self, slot: int) -> None:
        """Release a slot."""
        self._free.append(slot)

    # Both sides.

    def frames(self, slot: int, slot_bytes: int, shape: Sequence[int]) -> Frame:
        """Return a view of the frames in a slot, uint8 (count, H, W, 3)."""
        return self._view(slot, slot_bytes, shape, np.uint8)

    def flow(self, slot: int, slot_bytes: int, shape: Sequence[int]) -> Flow:
        """Return a view of the flow in a slot, float32 (H, W, 2), in pixels."""
        return self._view(slot, slot_bytes, shape, np.float32)

    def _view(self, slot: int, slot_bytes: int, shape: Sequence[int], dtype: Any) -> Any:
        begin = slot * slot_bytes
        size = int(np.prod(shape)) * np.dtype(dtype).itemsize
        if self._map is None or len(self._map) < begin + size:
            self._map = mmap.mmap(self._descriptor, os.fstat(self._descriptor).st_size)
        return np.frombuffer(self._map, dtype, int(np.prod(shape)), begin).reshape(shape)


def _attached(descriptor: Any, fewest: int) -> SharedSlots:
    slots = SharedSlots.__new__(SharedSlots)
    slots._attach(descriptor.detach(), fewest)
    return slots
