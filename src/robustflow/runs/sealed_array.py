"""Store arrays that can be recomputed: clean flows of samples in progress, and perturbations of trained attacks.

A file contains a NumPy array, followed by 16 bytes: the digest of the array and of a description of its inputs. If the
digest does not match (truncated or changed file, or different inputs), the file counts as missing.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ..atomic import write_bytes
from ..sealed import sealed_bytes, unsealed_bytes

Array = npt.NDArray[np.float32]


def write_array(path: Path, array: Array, made_of: str) -> None:
    """Store an array."""
    file = io.BytesIO()
    np.save(file, np.ascontiguousarray(array, np.float32), allow_pickle=False)
    write_bytes(path, sealed_bytes(file.getvalue(), made_of), durable=False)  # a lost array is recomputed


def read_array(path: Path, made_of: str) -> Array | None:
    """Read an array stored earlier; None unless it is intact and was computed from the same inputs."""
    try:
        data = unsealed_bytes(path.read_bytes(), made_of)
    except OSError:
        return None
    if data is None:
        return None
    try:
        array = np.load(io.BytesIO(data), allow_pickle=False)
    except Exception:  # NumPy's parser can raise any exception on a manipulated header
        return None
    return array if isinstance(array, np.ndarray) and array.dtype == np.float32 else None
