"""The hash of the frames that a model was given: what tells runs, records and data that are about the same bytes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..digest import digest_of_bytes, quick_digest_of_bytes
from ..metrics.rows import ROW_MEANING_VERSION
from ..sample import Frame

_HASHES = {1: digest_of_bytes, 2: quick_digest_of_bytes}
"""By the version of the rows' meaning."""


def frames_digest(frames: tuple[Frame, ...], rows_version: int = ROW_MEANING_VERSION) -> str:
    """32 hexadecimal digits that name the exact bytes and the sizes of some frames.

    Args:
        frames: RGB uint8 (H, W, 3).
        rows_version: of the run whose digest is to be found again.

    >>> frame = np.zeros((2, 3, 3), np.uint8)
    >>> frames_digest((frame, frame))
    '0fb9c46e6d3903b609cd4df90c033d46'
    >>> frames_digest((frame, frame), rows_version=1)
    'd695cd999d6d135d05659c7c7115c9df'
    """
    return _HASHES[rows_version](*_content(frames))


def are_frames_of(digest: str, frames: tuple[Frame, ...]) -> bool:
    """Whether a row of any version could have this digest of these frames."""
    return any(frames_digest(frames, version) == digest for version in _HASHES)


def _content(frames: tuple[Frame, ...]) -> Iterator[bytes | memoryview]:
    """The size and the bytes of each frame, in row order and without a copy."""
    for frame in frames:
        yield str(frame.shape).encode()
        if frame.size:
            yield np.ascontiguousarray(frame).data.cast("B")
