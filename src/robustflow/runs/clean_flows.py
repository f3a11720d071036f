"""Store clean flows on disk: computed once per sample, and kept until the sample's last unit is finished.

A file contains a NumPy array, followed by 16 bytes: the digest of the array, the sample's key and the frames. If the
digest does not match (truncated or changed file, or different frames), the file counts as missing and the flow is
recomputed.
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
        path: path of the file.
        flow: clean flow, float32 (H, W, 2), in pixels.
        made_of: the sample's key and the digest of the frames from which the flow was computed.
    """
    file = io.BytesIO()
    np.save(file, np.ascontiguousarray(flow, np.float32), allow_pickle=False)
    write_bytes(path, sealed_bytes(file.getvalue(), made_of), durable=False)  # a flow that was not stored is recomputed


def read_clean(path: Path, made_of: str) -> Flow | None:
    """Read a clean flow stored earlier; None unless it is intact and was computed from the same frames."""
    try:
        with open(path, "rb", opener=not_a_link) as file:
            array = unsealed_bytes(file.read(), made_of)
    except OSError:
        return None
    if array is None:
        return None
    try:
        flow = np.load(io.BytesIO(array), allow_pickle=False)
    except Exception:  # NumPy's parser can raise any exception on a manipulated header
        return None
    return flow if isinstance(flow, np.ndarray) and flow.dtype == np.float32 else None
