"""Bit errors."""

from __future__ import annotations

from typing import Any

from .clip_corruption import ClipCorruption


class BitError(ClipCorruption):
    """Bytes of the lossless clip overwritten (appendix, "Bit Error"); parameter N of FFmpeg's noise filter.

    The reference code's severity 5 is 5 M where the paper says 1 M.
    """

    name = "bit_error"
    family = "video"
    paper_severities = (50_000_000, 25_000_000, 15_000_000, 10_000_000, 1_000_000)

    def severities_of(self, variant: str) -> tuple[Any, ...]:
        """The reference's numbers for the variant "reference", the paper's otherwise."""
        if variant == "reference":
            return (*self.paper_severities[:4], 5_000_000)
        return self.paper_severities
