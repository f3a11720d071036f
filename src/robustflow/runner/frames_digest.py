"""Hash the frames given to a model, to check that runs, records and data have the same frames."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..digest import quick_digest_of_bytes
from ..sample import Frame


def frames_digest(frames: tuple[Frame, ...]) -> str:
    """Return a digest of the bytes and sizes of frames, as 32 hexadecimal digits."""
    return quick_digest_of_bytes(*_content(frames))


def _content(frames: tuple[Frame, ...]) -> Iterator[bytes | memoryview]:
    """Yield the size and the bytes of each frame, in row order and without copying."""
    for frame in frames:
        yield str(frame.shape).encode()
        if frame.size:
            yield np.ascontiguousarray(frame).data.cast("B")
