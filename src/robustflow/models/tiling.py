"""Predict in overlapping tiles and blend them, as the authors of FlowFormer and SAMFlow do for large frames.

Their networks were trained on crops of a single size and are less accurate at other sizes; tiles have the training
size.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ..core.arguments import parse_size
from ..core.errors import UsageError
from ..core.types import Flow, Frame
from .calls import checked_flow
from .pair_network import check_pair
from .protocols import AnyModel, ClipModel, FlowModel, model_identity

OVERLAP = 20
"""Minimum overlap of neighbouring tiles, in pixels."""
LARGEST = 8192
"""Maximum side length of a tile in pixels: frames are padded to a tile, and a larger one would exhaust memory."""
SIGMA = 0.05
"""Standard deviation of the blending weight, as a fraction of the tile's side length."""


def tile_origins(length: int, tile: int) -> list[int]:
    """Return the start of each tile along an axis; the last tile is flush with the end."""
    return [*range(0, length - tile, tile - OVERLAP), length - tile]


def tile_weights(height: int, width: int) -> npt.NDArray[np.float64]:
    """Return the Gaussian weights of a tile's flow, (height, width), largest at the centre."""
    y, x = (np.arange(size) / size - 0.5 for size in (height, width))
    return np.exp(-(y[:, None] ** 2 + x**2) / (2 * SIGMA**2))


def tiled(model: AnyModel, tile: str | None) -> AnyModel:
    """Wrap `model` so that it predicts in tiles of HEIGHTxWIDTH; return it unchanged if `tile` is None or "none"."""
    if tile in (None, "none"):
        return model
    if isinstance(model, ClipModel):
        raise UsageError("tile", "a multi-frame model cannot predict in tiles; omit this option")
    if not isinstance(model, FlowModel):
        raise UsageError("tile", "precomputed flows cannot be predicted in tiles; omit this option")
    return TiledModel(model, str(tile))


class TiledModel:
    """Predict each tile separately; frames smaller than a tile are padded with black below and on the right."""

    def __init__(self, model: FlowModel, tile: str = "432x960") -> None:
        self.model = model
        self.trained_on: str | None = getattr(model, "trained_on", None)
        self._tile = parse_size(tile)
        if min(self._tile) <= OVERLAP:
            raise UsageError("tile", f"{tile} must be larger than the tile overlap of {OVERLAP} pixels")
        if max(self._tile) > LARGEST:
            raise UsageError("tile", f"{tile} must be at most {LARGEST} pixels per side; omit this option")
        self._weights = tile_weights(*self._tile)[..., None]

    @property
    def device(self) -> Any:
        """The device of the wrapped model."""
        return getattr(self.model, "device", "cpu")

    def identity(self) -> dict[str, Any]:
        """Return the identity of the wrapped model with the tile size."""
        return {**model_identity(self.model), "tile": list(self._tile), "overlap": OVERLAP, "sigma": SIGMA}

    def tiles(self, height: int, width: int) -> tuple[int, tuple[int, int]]:
        """Return the number of tiles of a frame of this size, and the size (height, width) of a tile, in pixels."""
        rows, columns = (
            len(tile_origins(max(side, tile), tile)) for side, tile in zip((height, width), self._tile, strict=True)
        )
        return rows * columns, (self._tile[0], self._tile[1])

    def predict(self, frame1: Frame, frame2: Frame) -> Flow:
        """Predict a flow as in `FlowModel.predict`."""
        return self.predict_batch([frame1], [frame2])[0]

    def predict_batch(self, frames1: Sequence[Frame], frames2: Sequence[Frame]) -> list[Flow]:
        """Predict several pairs, whose sizes may differ; each call of the model receives one tile from every pair."""
        blends = [_Blend(frame1, frame2, self._weights) for frame1, frame2 in zip(frames1, frames2, strict=True)]
        for index in range(max((len(blend.windows) for blend in blends), default=0)):
            active = [blend for blend in blends if index < len(blend.windows)]
            tiles1, tiles2 = zip(*(blend.tiles(index) for blend in active), strict=True)
            for blend, tile, flow in zip(active, tiles1, self._predict_tiles(tiles1, tiles2), strict=True):
                blend.add(index, checked_flow(flow, (tile,), "a tile"))
        return [blend.flow() for blend in blends]

    def _predict_tiles(self, tiles1: Sequence[Frame], tiles2: Sequence[Frame]) -> Sequence[Flow]:
        batched = getattr(self.model, "predict_batch", None)
        if batched is not None:
            flows: Sequence[Flow] = batched(tiles1, tiles2)
            return flows
        return [self.model.predict(tile1, tile2) for tile1, tile2 in zip(tiles1, tiles2, strict=True)]


class _Blend:
    """The running weighted mean of the tiles of one pair."""

    def __init__(self, frame1: Frame, frame2: Frame, weights: npt.NDArray[np.float64]) -> None:
        check_pair(frame1, frame2)
        tile_height, tile_width = weights.shape[:2]
        self._size = height, width = frame1.shape[:2]
        below, right = max(0, tile_height - height), max(0, tile_width - width)
        self._frames = [np.pad(frame, ((0, below), (0, right), (0, 0))) for frame in (frame1, frame2)]
        self._weights = weights
        self._sum = np.zeros((height + below, width + right, 2))
        self._weight = np.zeros((height + below, width + right, 1))
        self.windows = [
            (slice(y, y + tile_height), slice(x, x + tile_width))
            for y in tile_origins(height + below, tile_height)
            for x in tile_origins(width + right, tile_width)
        ]

    def tiles(self, index: int) -> tuple[Frame, Frame]:
        frame1, frame2 = (np.ascontiguousarray(frame[self.windows[index]]) for frame in self._frames)
        return frame1, frame2

    def add(self, index: int, flow: Flow) -> None:
        self._sum[self.windows[index]] += self._weights * flow
        self._weight[self.windows[index]] += self._weights

    def flow(self) -> Flow:
        height, width = self._size
        return (self._sum[:height, :width] / self._weight[:height, :width]).astype(np.float32)
