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
    """PSFs over the field, normalised.

    Attributes:
        stack: float32 (64, 3, 61, 61): field 0 the image centre, 63 the corner; R, G, B; rows grow away from the
            image centre. Each PSF adds up to 1.
        digest: SHA-256 of the stack's bytes; names the field in caches.

    >>> import numpy as np
    >>> point = np.zeros((64, 3, 61, 61)); point[:, :, 30, 30] = 5
    >>> float(PsfField(point).stack.max())
    1.0
    """

    def __init__(self, stack: npt.NDArray[Any]) -> None:
        """Take a stack of any scale; each PSF is divided by its sum.

        Raises:
            DataError: another shape, values that are not finite, or a PSF without energy.
        """
        values = np.asarray(stack, np.float64)
        if values.shape != SHAPE:
            raise DataError(f"a PSF stack has the shape {SHAPE}, this one {values.shape}")
        sums = values.sum((2, 3), keepdims=True)
        if not np.isfinite(values).all() or (sums <= 0.0).any():
            raise DataError("a PSF of this stack has no energy or values that are not finite")
        self.stack: npt.NDArray[np.float32] = np.ascontiguousarray(values / sums, np.float32)
        self.digest = hashlib.sha256(self.stack.tobytes()).hexdigest()
