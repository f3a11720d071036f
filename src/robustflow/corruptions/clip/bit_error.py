"""Simulate bit errors in a compressed clip."""

from __future__ import annotations

from typing import Any

from .clip_corruption import ClipCorruption


class BitError(ClipCorruption):
    """Overwrites bytes in the losslessly compressed clip (appendix, "Bit Error").

    The parameter is N in FFmpeg's noise filter. At severity 5, the reference code uses 5 million, whereas the
    paper states 1 million.
    """

    name = "bit_error"
    family = "video"
    paper_severities = (50_000_000, 25_000_000, 15_000_000, 10_000_000, 1_000_000)

    def severities_of(self, variant: str) -> tuple[Any, ...]:
        """Return the reference code's parameters for the variant "reference", and the paper's parameters otherwise."""
        if variant == "reference":
            return (*self.paper_severities[:4], 5_000_000)
        return self.paper_severities
