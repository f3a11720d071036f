"""Make sparse maps visible: laser scanners measure one in several pixels, which would vanish in a smaller picture."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import distance_transform_edt

from ..sample import Frame, Mask

REACH = 2.0
"""Pixels by which a known point is enlarged, only for display."""

SPARSE = 0.5
"""Maps with a smaller share of known pixels are sparse; in dense ones the unknown pixels stay visible."""


def thickened(picture: Frame, known: Mask) -> Frame:
    """Give unknown pixels of a sparse map the colour of a known one within `REACH`; other pictures are unchanged.

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
