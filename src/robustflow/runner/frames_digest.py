"""The hash of the frames that a model was given, by which runs, records and data are recognised as being about the same
bytes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..digest import quick_digest_of_bytes
from ..sample import Frame


def frames_digest(frames: tuple[Frame, ...]) -> str:
    """32 hexadecimal digits that name the exact bytes and the sizes of some frames.

    Args:
        frames: RGB uint8 (H, W, 3).

    >>> frame = np.zeros((2, 3, 3), np.uint8)
    >>> frames_digest((frame, frame))
    '0fb9c46e6d3903b609cd4df90c033d46'
    """
    return quick_digest_of_bytes(*_content(frames))


def _content(frames: tuple[Frame, ...]) -> Iterator[bytes | memoryview]:
    """The size and the bytes of each frame, in row order and without a copy."""
    for frame in frames:
        yield str(frame.shape).encode()
        if frame.size:
            yield np.ascontiguousarray(frame).data.cast("B")
