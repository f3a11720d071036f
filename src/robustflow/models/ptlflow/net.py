"""ptlflow's networks with the interface of the project's networks: two-frame, modified and multi-frame ones."""

from __future__ import annotations

from typing import Any, Literal

import torch
from torch import Tensor, nn

from ...core.errors import ModelError


class PtlflowNet(nn.Module):
    """Call a ptlflow model with its dictionary of images and extract the flow from the dictionary it returns."""

    def __init__(self, model: Any, batched: bool) -> None:
        super().__init__()
        self.model = model
        self.batched = batched

    def forward(self, image1: Tensor, image2: Tensor, confidence: bool = False) -> Tensor:
        """Predict a flow (N, 2, H, W) in pixels from images (N, 3, H, W), BGR, 0..255. For networks that return a
        confidence, the result is (N, 3, H, W) and includes the confidence.
        """
        images = torch.stack([image1, image2], dim=1).contiguous() / 255
        if self.batched:
            return self._flow(images, confidence)
        return torch.cat([self._flow(pair, confidence) for pair in images.split(1)])

    def predictions(self, image1: Tensor, image2: Tensor) -> list[Tensor]:
        """Return the flow after every iteration, for the loss; in training mode only."""
        return self._training_outputs(image1, image2)[0]

    def matched_predictions(self, image1: Tensor, image2: Tensor) -> tuple[list[Tensor], Tensor]:
        """Return the flow after every iteration and GMFlowNet's matching confidence at 1/8, (N, P, P)."""
        flows, outputs = self._training_outputs(image1, image2)
        if "soft_corr_map" not in outputs:
            raise ModelError("this ptlflow network has no matching step before its iterations; use the loss 'sequence'")
        return flows, outputs["soft_corr_map"]

    def _training_outputs(self, image1: Tensor, image2: Tensor) -> tuple[list[Tensor], dict[str, Tensor]]:
        images = torch.stack([image1, image2], dim=1).contiguous() / 255
        outputs = self.model({"images": images})
        if "flow_preds" not in outputs:
            raise ModelError(
                "this ptlflow network does not return the flows of its iterations, so robustflow cannot train it"
            )
        return list(outputs["flow_preds"]), outputs

    def _flow(self, images: Tensor, confidence: bool) -> Tensor:
        outputs = self.model({"images": images})
        flows: Tensor = outputs["flows"]
        if flows.ndim != 5 or flows.shape[1] != 1:
            raise ModelError(str(tuple(flows.shape)), "the flows of a multi-frame network: choose a two-frame model")
        return torch.cat([flows[:, 0], outputs["confs"][:, 0]], dim=1) if confidence else flows[:, 0]


_STRIDE = 8
"""Number of image pixels per pixel of the cost volume; the sides of a crop are multiples of it."""


class FlowFormerPlusPlusNet(PtlflowNet):
    """FlowFormer++ (Shi et al., CVPR 2023), modified to match the authors' code where ptlflow 0.4.2 differs from it."""

    def __init__(self, model: Any) -> None:
        super().__init__(model, batched=True)
        for module in model.modules():
            if hasattr(module, "context_proj"):
                module.register_forward_pre_hook(_with_own_context)

    def _training_outputs(self, image1: Tensor, image2: Tensor) -> tuple[list[Tensor], dict[str, Tensor]]:
        padded_to, self.model.output_stride = self.model.output_stride, _STRIDE
        try:
            return super()._training_outputs(image1, image2)
        finally:
            self.model.output_stride = padded_to


def _with_own_context(attention: nn.Module, inputs: tuple[Any, ...]) -> tuple[Any, ...]:
    """Repeat each pair's context (N, C, H, W) for its tokens (N * K, H * W, D), so that ptlflow does not tile it."""
    tokens, size, context = inputs
    return tokens, size, context.repeat_interleave(len(tokens) // len(context), dim=0)


class CraftNet(PtlflowNet):
    """CRAFT (Sui et al., CVPR 2022), modified to work in mixed precision as in the authors' code: ptlflow 0.4.2 writes
    its position biases, which are weights in float32, into an array with the type of the features, and fails."""

    def __init__(self, model: Any) -> None:
        super().__init__(model, batched=True)
        for module in model.modules():
            if type(module).__name__ == "SlidingPosBiases2D":
                module.register_forward_pre_hook(_in_dtype_of_biases)


def _in_dtype_of_biases(module: nn.Module, inputs: tuple[Any, ...]) -> tuple[Any, ...]:
    shape, _, device = inputs
    return shape, module.biases.dtype, device


Reading = Literal["middle", "each", "memory"]
"""Pairs that a network predicts: the one in the middle, each in one call, or all one after another from the first."""

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
