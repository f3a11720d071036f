"""The small network in numbers, for both of its implementations."""

from __future__ import annotations

CHANNELS = (3, 16, 32, 48, 64, 80)
"""Channels of the image, then of the levels 1/2 to 1/32."""
LEVELS = len(CHANNELS) - 1
MULTIPLE = 2**LEVELS
"""Height and width of the input are multiples of it."""
RADIUS = 3
"""Radius of the correlation, in pixels of a level."""
REDUCED = 32
"""Channels of a level's features in the decoder."""
DECODER = ((80, 1), (64, 2), (48, 4), (32, 1))
"""Channels and dilation of the decoder's convolutions."""
FINEST = 4
"""The flow is decoded down to 1/4 of the frame's size."""
EPSILON = 1e-6
"""Added to the mean square of features before they are divided by its root."""
