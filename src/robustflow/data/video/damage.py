"""Inject bit errors exactly like FFmpeg's `noise` bitstream filter with an integer amount.

The paper's Bit Error (appendix, "Video corruptions") applies this filter to the packets of the clip. For each byte,
`state += byte + 1` (uint32, initially 0, carried over between packets); if `state` is a multiple of the amount N, the
byte is replaced with the low byte of `state`. So about one byte in N is changed, and the positions are deterministic.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...core.compiled import njit
from ...core.errors import UsageError
from .codec import Packet


@dataclass
class Damage:
    """The effect of bit errors on a stream: counts and the display indices of the frames with damaged packets."""

    amount: int
    bytes_total: int = 0
    bytes_changed: int = 0
    frames_hit: list[int] = field(default_factory=list)


class NoiseFilter:
    """The filter state for one stream; packets must be passed in file order."""

    def __init__(self, amount: int) -> None:
        if isinstance(amount, bool) or not isinstance(amount, int) or not 1 <= amount < 2**31:
            raise UsageError(f"invalid noise amount {amount!r}: must be an integer from 1 to 2**31 - 1")
        self.amount = amount
        self.state = 0

    def __call__(self, data: bytes) -> tuple[bytes, int]:
        """Return the damaged bytes and the number of changed bytes."""
        buffer = np.frombuffer(data, np.uint8).copy()
        state, changed = _apply(buffer, self.state, self.amount)
        self.state = int(state)
        return buffer.tobytes(), int(changed)


def damage_packets(packets: Iterable[Packet], damage: Damage) -> Iterator[Packet]:
    """Apply the filter with `damage.amount` to packets and update the counts in `damage`."""
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
