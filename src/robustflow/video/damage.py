"""Bit errors: FFmpeg's `noise` bitstream filter with an integer amount, exactly, in our own arithmetic.

The paper's Bit Error (appendix, "Video corruptions") runs this filter over the packets of the clip. Its rule, per
byte and across packets: `state += byte + 1` (uint32, from 0); where `state` is a multiple of the amount N, the byte
becomes the low byte of `state`. So about one byte in N is hit, always the same ones.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..compiled import njit
from ..errors import UsageError
from .codec import Packet


@dataclass
class Damage:
    """The effect of bit errors on a stream: counts, and the display indices of the frames whose packets were hit."""

    amount: int
    bytes_total: int = 0
    bytes_changed: int = 0
    frames_hit: list[int] = field(default_factory=list)


class NoiseFilter:
    """The state of the filter over one stream; feed it the packets in the order of the file.

    >>> noise = NoiseFilter(3)
    >>> noise(bytes([1, 0, 2]))  # state 2, 3 (hit: becomes 3), 6 (hit: becomes 6)
    (b'\\x01\\x03\\x06', 2)
    """

    def __init__(self, amount: int) -> None:
        if isinstance(amount, bool) or not isinstance(amount, int) or not 1 <= amount < 2**31:
            raise UsageError(f"the noise amount cannot be {amount!r}: give a whole number from 1 to 2**31 - 1")
        self.amount = amount
        self.state = 0

    def __call__(self, data: bytes) -> tuple[bytes, int]:
        """The damaged bytes, and how many of them changed."""
        buffer = np.frombuffer(data, np.uint8).copy()
        state, changed = _apply(buffer, self.state, self.amount)
        self.state = int(state)
        return buffer.tobytes(), int(changed)


def damage_packets(packets: Iterable[Packet], damage: Damage) -> Iterator[Packet]:
    """Run the filter of `damage.amount` over packets, keeping count in `damage`."""
    noise = NoiseFilter(damage.amount)
    for packet in packets:
        data, changed = noise(packet.data)
        damage.bytes_total += len(data)
        damage.bytes_changed += changed
        if changed:
            damage.frames_hit.append(packet.index)
        yield Packet(data, packet.index)


@njit(cache=True, nogil=True)
def _apply(buffer: Any, state: Any, amount: Any) -> Any:
    changed = 0
    for i in range(buffer.size):
        state = (state + int(buffer[i]) + 1) & 0xFFFFFFFF
        if state % amount == 0:
            hit = state & 255
            changed += hit != buffer[i]
            buffer[i] = hit
    return state, changed
