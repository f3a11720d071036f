"""The PSFs of a lens over its field: 64 field points from centre to corner, 3 colours, 61 x 61 pixels."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import DataError

FIELDS = 64
SIZE = 61
SHAPE = (FIELDS, 3, SIZE, SIZE)


class PsfField:
    """Normalised PSFs over the field."""

    def __init__(self, stack: npt.NDArray[Any]) -> None:
        """Build a field from a stack with arbitrary scaling; each PSF is divided by its sum."""
        values = np.asarray(stack, np.float64)
        if values.shape != SHAPE:
            raise DataError(f"expected a PSF stack of shape {SHAPE}, got {values.shape}")
        sums = values.sum((2, 3), keepdims=True)
        if not np.isfinite(values).all() or (sums <= 0.0).any():
            raise DataError("a PSF in this stack is zero or has non-finite values")
        self.stack: npt.NDArray[np.float32] = np.ascontiguousarray(values / sums, np.float32)
        self.digest = hashlib.sha256(self.stack.tobytes()).hexdigest()
