"""Hyperparameters of the small network, shared by its two implementations."""

from __future__ import annotations

CHANNELS = (3, 16, 32, 48, 64, 80)
"""Numbers of channels: of the image, then of the levels 1/2 to 1/32."""
LEVELS = len(CHANNELS) - 1
MULTIPLE = 2**LEVELS
"""The input's height and width must be multiples of this number."""
RADIUS = 3
"""Radius of the correlation window, in pixels of a level."""
REDUCED = 32
"""Number of feature channels that each level passes to the decoder."""
DECODER = ((80, 1), (64, 2), (48, 4), (32, 1))
"""Number of channels and dilation of each convolution in the decoder."""
FINEST = 4
"""Finest resolution at which the flow is decoded: 1/4 of the frame's size."""
EPSILON = 1e-6
"""Constant added to the mean square of the features; the features are divided by the square root of the sum."""
