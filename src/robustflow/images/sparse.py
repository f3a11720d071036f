"""Make sparse maps visible: lidar measures only some of the pixels, and these would vanish in a downscaled image."""

from __future__ import annotations

import numpy as np

from ..sample import Frame, Mask

REACH = 2.0
"""Radius in pixels by which known points are dilated, for display only."""

SPARSE = 0.5
"""Maps with a smaller fraction of known pixels are treated as sparse; in dense maps, unknown pixels stay visible."""


def thickened(picture: Frame, known: Mask) -> Frame:
    """Fill unknown pixels of a sparse map with the colour of the nearest known pixel within `REACH`; leave dense maps
    unchanged.
    """
    if not 0 < known.mean() < SPARSE:
        return picture
    from scipy.ndimage import distance_transform_edt  # dense maps do not need this import of 0.15 s

    distance, nearest = distance_transform_edt(~known, return_indices=True)
    grown = picture[tuple(nearest)]
    return np.where((distance <= REACH)[..., None], grown, picture)
