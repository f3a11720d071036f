"""Overwrite bytes of a clip with bit errors."""

from __future__ import annotations

from typing import Any

from .clip_corruption import ClipCorruption


class BitError(ClipCorruption):
    """Overwrites bytes of the lossless clip (appendix, "Bit Error"); the parameter is N of FFmpeg's noise filter.

    At severity 5 the reference code uses 5 M, whereas the paper says 1 M.
    """

    name = "bit_error"
    family = "video"
    paper_severities = (50_000_000, 25_000_000, 15_000_000, 10_000_000, 1_000_000)

    def severities_of(self, variant: str) -> tuple[Any, ...]:
        """Return the reference code's parameters for the variant "reference", otherwise those of the paper."""
        if variant == "reference":
            return (*self.paper_severities[:4], 5_000_000)
        return self.paper_severities
