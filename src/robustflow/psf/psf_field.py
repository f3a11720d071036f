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
    """Normalised PSFs over the field.

    Attributes:
        stack: PSFs by field (0 is the image centre, 63 the corner) and colour (R, G, B), float32 (64, 3, 61, 61); the
            row index increases away from the image centre. Each PSF sums to 1.
        digest: SHA-256 of the stack's bytes, used as the cache key.

    >>> import numpy as np
    >>> point = np.zeros((64, 3, 61, 61)); point[:, :, 30, 30] = 5
    >>> float(PsfField(point).stack.max())
    1.0
    """

    def __init__(self, stack: npt.NDArray[Any]) -> None:
        """Build a field from a stack with arbitrary scaling; each PSF is divided by its sum.

        Raises:
            DataError: the stack has the wrong shape, non-finite values, or a PSF that sums to zero or less.
        """
        values = np.asarray(stack, np.float64)
        if values.shape != SHAPE:
            raise DataError(f"expected a PSF stack of shape {SHAPE}, got {values.shape}")
        sums = values.sum((2, 3), keepdims=True)
        if not np.isfinite(values).all() or (sums <= 0.0).any():
            raise DataError("a PSF in this stack is zero or has non-finite values")
        self.stack: npt.NDArray[np.float32] = np.ascontiguousarray(values / sums, np.float32)
        self.digest = hashlib.sha256(self.stack.tobytes()).hexdigest()
