"""Parse sizes given as HEIGHTxWIDTH."""

from __future__ import annotations

from .errors import UsageError


def parse_size(text: str, multiple: int = 1, smallest: int = 1, largest: int = 99_999) -> tuple[int, int]:
    """Parse a text such as "256x832" into height and width, in pixels."""
    height, cross, width = str(text).lower().partition("x")
    if not (cross and all(side.isdecimal() and len(side) <= 5 for side in (height, width))):
        raise UsageError(f"{str(text)[:40]!r} is not a size: write HEIGHTxWIDTH, for example 256x832")
    size = int(height), int(width)
    if any(side % multiple or not max(multiple, smallest) <= side <= largest for side in size):
        must = f"multiples of {multiple}" if multiple > 1 else f"{smallest} to {largest} pixels"
        raise UsageError(f"size {text}: height and width must be {must}, for example 256x832")
    return size
