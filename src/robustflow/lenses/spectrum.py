"""The three colour channels: bands of 100 nm, sampled using the midpoint rule."""

from __future__ import annotations

from ..errors import unknown_name

CHANNELS: dict[str, float] = {"red": 0.64, "green": 0.54, "blue": 0.46}
"""Centre of each channel's band in micrometres, in the order R, G, B."""

BANDWIDTH = 0.1
"""Width of each band in micrometres."""


def channel_wavelengths(channel: str, samples: int = 5) -> tuple[float, ...]:
    """Return equally spaced wavelengths within a channel, in micrometres.

    >>> channel_wavelengths("green")
    (0.5, 0.52, 0.54, 0.56, 0.58)
    """
    if channel not in CHANNELS:
        raise unknown_name("channel", channel, CHANNELS)
    step = BANDWIDTH / samples
    return tuple(round(CHANNELS[channel] + (k - (samples - 1) / 2) * step, 6) for k in range(samples))
