"""The four operating points of dense inverse search, from the fastest to the most accurate."""

from __future__ import annotations

from dataclasses import dataclass

_REACHED_BY_THE_PAPER = 5
"""The coarsest scale of 1024 px at every operating point."""


@dataclass(frozen=True)
class OperatingPoint:
    """How much work the method does; Kroeger et al. 2016, section 3.

    Attributes:
        finest_scale: the flow of frames 1024 px wide is searched down to frames shrunk by 2**finest_scale, and enlarged
            from there; see `scales`.
        patch_size: side of a patch in pixels.
        overlap: how much of a patch's side the next one shares, 0 to 1 (1 excluded).
        iterations: steps of gradient descent per patch and scale, at most.
        refined: whether each scale's dense flow is refined variationally.
    """

    finest_scale: int
    patch_size: int
    overlap: float
    iterations: int
    refined: bool

    @property
    def stride(self) -> int:
        """Pixels from one patch to the next."""
        return max(1, self.patch_size - int(self.patch_size * self.overlap))

    def scales(self, height: int, width: int) -> tuple[int, int]:
        """The coarsest and the finest scale for frames of a size.

        The coarsest is the one where a patch can reach a motion of a fifth of the longer side, but no coarser than
        leaves room for a patch. The finest is `finest_scale` for frames of the paper's width, 1024 px, or larger; for
        smaller ones it is finer by as many scales as the reach is.

        >>> [OPERATING_POINTS[2].scales(*size) for size in [(375, 1242), (436, 1024), (240, 320), (16, 16)]]
        [(5, 3), (5, 3), (4, 2), (0, 0)]
        """
        reach, room = 2 * max(height, width) // (5 * self.patch_size), min(height, width) // self.patch_size
        reached, roomy = (max(0, pixels.bit_length() - 1) for pixels in (reach, room))
        finest = max(0, self.finest_scale - max(0, _REACHED_BY_THE_PAPER - reached))
        return min(reached, roomy), min(finest, roomy)


OPERATING_POINTS = {
    1: OperatingPoint(finest_scale=3, patch_size=8, overlap=0.30, iterations=16, refined=False),
    2: OperatingPoint(finest_scale=3, patch_size=8, overlap=0.40, iterations=12, refined=True),
    3: OperatingPoint(finest_scale=1, patch_size=12, overlap=0.75, iterations=16, refined=True),
    4: OperatingPoint(finest_scale=0, patch_size=12, overlap=0.75, iterations=256, refined=True),
}
