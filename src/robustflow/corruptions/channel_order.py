"""Reproduce the channel order of the published results: the reference code treats BGR frames as RGB."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..random.rng import Rng
from ..sample import Frame, SceneDepth
from .base import BGR, Corruption


class ChannelsReversed(Corruption):
    """A corruption applied with red and blue swapped (variant "reference-bgr"); input and output frames are RGB.

    >>> import numpy as np
    >>> from robustflow.corruptions import load_corruption
    >>> red = np.zeros((16, 16, 3), np.uint8)
    >>> red[..., 0] = 200
    >>> as_red, as_blue = (load_corruption("jpeg_compression", v).apply(red, 25, 0) for v in ("reference", BGR))
    >>> as_red[0, 0].tolist() == as_blue[0, 0].tolist()
    False
    """

    def __init__(self, inner: Corruption) -> None:
        self.name = inner.name
        self.family = inner.family
        self.temporal = inner.temporal
        self.truth = inner.truth
        self.paper_severities = inner.paper_severities
        super().__init__(inner.variant, inner.severities)
        self.variant = BGR
        self.needs_depth = inner.needs_depth
        self._inner = inner

    @property
    def source(self) -> str:
        """Return the inner corruption's source."""
        return self._inner.source

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> Any:
        """Return the inner corruption's state."""
        return self._inner.draw(rng, severity, shape)

    def draw_with_depth(self, rng: Rng, severity: int, shape: tuple[int, int], depth: SceneDepth | None) -> Any:
        """Return the inner corruption's state."""
        return self._inner.draw_with_depth(rng, severity, shape, depth)

    def apply(self, frame: Frame, state: Any, index: int) -> Frame:
        """Reverse the channels, corrupt the frame, and restore the channel order."""
        corrupted = self._inner.apply(np.ascontiguousarray(frame[..., ::-1]), state, index)
        return np.ascontiguousarray(corrupted[..., ::-1])
