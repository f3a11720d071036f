"""A multi-frame network of ptlflow: the frames of a clip in, the flow of one pair among them out."""

from __future__ import annotations

from typing import Any, Literal

import torch
from torch import Tensor, nn

Reading = Literal["middle", "each", "memory"]
"""Which pairs a network predicts. "middle": the one whose first frame is in the middle. "each": all at once. "memory":
one after the other, from the first on."""

_Named = tuple[str, Tensor]
"""An image and its name; a frame that is repeated keeps its name."""


class PtlflowClipNet(nn.Module):
    """Gives a multi-frame model of ptlflow its clip, and takes the flow of the requested pair from what it returns.

    Nothing is kept from one call to the next.

    Args:
        model: of ptlflow.
        reading: which pairs it predicts, see `Reading`.
        least: frames that it needs; the first is repeated before a clip that has fewer.
        twice: frames of a whole clip, where its authors put the first frame of every sequence twice; else 0. A pair
            that is not in the middle of its clip, but before it, is then taken to be at the beginning of a sequence.
    """

    def __init__(self, model: Any, reading: Reading, least: int, twice: int = 0) -> None:
        super().__init__()
        self.model = model
        self.reading = reading
        self.least = least
        self.twice = twice

    def forward(self, *images: Tensor, index: int) -> Tensor:
        """Images (1, 3, H, W) in the order of time, BGR, 0..255, and the place of the pair's first among them, to flow
        (1, 2, H, W) in pixels."""
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
    """How often the first and the last frame must be repeated for VideoFlow to return the requested flow.

    It predicts a flow for every frame but the first and the last, and returns number (n - 2) // 2 of them, where n
    counts repeated frames, less the repetitions on the left; then it drops the repeated frames before it predicts.

    Args:
        frames: in the clip, 3 or more.
        wanted: number of the flow, 0 to frames - 3.

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
