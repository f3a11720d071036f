"""Sparse maps made visible: laser scanners measure every few pixels, which a shrunken picture averages away."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import distance_transform_edt

from ..sample import Frame, Mask

REACH = 2.0
"""Pixels that a known point grows by, for the eye alone."""

SPARSE = 0.5
"""Maps with a smaller share of known pixels are sparse; in a dense one, what is unknown is worth seeing."""


def thickened(picture: Frame, known: Mask) -> Frame:
    """A picture of a sparse map whose unknown pixels take the colour of a known one within `REACH`; others as they are.

    Args:
        picture: RGB uint8 (H, W, 3).
        known: bool (H, W).

    >>> row = np.array([[[9, 9, 9], [0, 0, 0], [0, 0, 0], [0, 0, 0]]], np.uint8)
    >>> thickened(row, np.array([[True, False, False, False]]))[0, :, 0].tolist()
    [9, 9, 9, 0]
    """
    if not 0 < known.mean() < SPARSE:
        return picture
    distance, nearest = distance_transform_edt(~known, return_indices=True)
    grown = picture[tuple(nearest)]
    return np.where((distance <= REACH)[..., None], grown, picture)
