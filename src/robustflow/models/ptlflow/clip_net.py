"""Wrap a multi-frame ptlflow network so that it maps a clip to the flow of one pair in the clip."""

from __future__ import annotations

from typing import Any, Literal

import torch
from torch import Tensor, nn

Reading = Literal["middle", "each", "memory"]
"""Pairs that a network predicts. "middle": the pair whose first frame is the middle one. "each": all pairs in one call.
"memory": all pairs one after another, starting with the first.
"""

_Named = tuple[str, Tensor]
"""An image and its name; copies of a repeated frame share the name."""


class PtlflowClipNet(nn.Module):
    """Call a multi-frame ptlflow model with a clip, and select the flow of the requested pair from its output."""

    def __init__(self, model: Any, reading: Reading, least: int, twice: int = 0) -> None:
        super().__init__()
        self.model = model
        self.reading = reading
        self.least = least
        self.twice = twice

    def forward(self, *images: Tensor, index: int) -> Tensor:
        """Predict the flow (1, 2, H, W), in pixels, of the pair that starts at `index`, from images (1, 3, H, W) in
        temporal order, BGR, 0..255.
        """
        clip = [(str(place), image / 255) for place, image in enumerate(images)]
        if self.twice and index < (self.twice - 1) // 2:
            clip, index = [clip[0], *clip][: self.twice], index + 1
        missing = max(0, self.least - len(clip))
        clip, index = [clip[0]] * missing + clip, index + missing
        if self.reading == "memory":
            return self._memory(clip, index)
        if self.reading == "each":
            return self._ask(clip)[:, index]
        left, right = padding_to_middle(len(clip), index - 1)
        return self._ask([clip[0]] * left + clip + [clip[-1]] * right)[:, 0]

    def _memory(self, clip: list[_Named], index: int) -> Tensor:
        for place in range(index + 1):
            pair = clip[place : place + 2]
            flows = self._ask(pair, is_seq_start=place == 0, is_seq_end=place == index)
        self.model.clear_memory()
        return flows[:, 0]

    def _ask(self, clip: list[_Named], **meta: Any) -> Tensor:
        images = torch.stack([image for _, image in clip], dim=1)
        names = [[name] for name, _ in clip]
        flows: Tensor = self.model({"images": images, "meta": {"image_paths": names, **meta}})["flows"]
        return flows


def padding_to_middle(frames: int, wanted: int) -> tuple[int, int]:
    """Return how often the first and the last frame must be repeated so that VideoFlow returns the requested flow.

    >>> padding_to_middle(5, 1), padding_to_middle(5, 0), padding_to_middle(5, 2)
    ((0, 0), (2, 0), (0, 1))
    """
    extra = 0
    while True:
        middle = (frames + extra - 2) // 2
        if middle - extra == wanted:
            return extra, 0
        if middle == wanted:
            return 0, extra
        extra += 1
