"""Clean flows on disk: computed once per sample, and kept until the sample's last unit is finished.

A file is a NumPy array followed by 16 bytes: the digest of the array and of what it was computed from. A file that does
not verify (truncated, changed, or from other frames) counts as missing, and the flow is recomputed.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from ..atomic import write_bytes
from ..links import not_a_link
from ..sample import Flow
from ..sealed import sealed_bytes, unsealed_bytes


def write_clean(path: Path, flow: Flow, made_of: str) -> None:
    """Store a clean flow for the remaining units of its sample.

    Args:
        path: where to store it.
        flow: float32 (H, W, 2), pixels.
        made_of: what it was computed from: the sample's key and the digest of its frames.
    """
    file = io.BytesIO()
    np.save(file, np.ascontiguousarray(flow, np.float32), allow_pickle=False)
    write_bytes(path, sealed_bytes(file.getvalue(), made_of), durable=False)  # a lost flow is recomputed


def read_clean(path: Path, made_of: str) -> Flow | None:
    """A clean flow stored earlier; None unless it is intact and was computed from the same frames."""
    try:
        with open(path, "rb", opener=not_a_link) as file:
            array = unsealed_bytes(file.read(), made_of)
    except OSError:
        return None
    flow: Flow | None = None if array is None else np.load(io.BytesIO(array), allow_pickle=False)
    return flow
