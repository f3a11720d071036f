"""An exported PyTorch program behind the call of the project's own networks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor, nn

from ...errors import ModelError
from .base import Layout, describe_arrays, flow_layout


class ExportedNet(nn.Module):
    """Gives a program its images the way it takes them and finds the flow in what it returns.

    Args:
        program: of TorchScript or torch.export.
        call: calls it with its list of inputs.
        layout: how the pair goes in.
        output: position or key of the flow among several outputs; None for the last.
        batched: the program takes several pairs at once; else each goes through by itself.
        dtypes: of its inputs; None for float32, where the file does not say.
    """

    def __init__(
        self,
        program: nn.Module,
        call: Callable[[list[Tensor]], Any],
        layout: Layout,
        output: Any,
        batched: bool,
        dtypes: Sequence[torch.dtype] | None = None,
    ) -> None:
        super().__init__()
        self.program = program
        self.call = call
        self.layout = layout
        self.output = output
        self.batched = batched
        self.dtypes = dtypes

    def train(self, mode: bool = True) -> ExportedNet:
        """An exported program is in the mode it was exported in; torch.export's refuse to be asked."""
        self.training = mode
        return self

    def forward(self, image1: Tensor, image2: Tensor) -> Tensor:
        """Images (N, 3, H, W) in the program's own colours and range, to flow (N, 2, H, W) in pixels."""
        if self.batched:
            return self._flow(image1, image2)
        return torch.cat([self._flow(*pair) for pair in zip(image1.split(1), image2.split(1), strict=True)])

    def _flow(self, image1: Tensor, image2: Tensor) -> Tensor:
        if self.layout == "pair":
            inputs = [image1.contiguous(), image2.contiguous()]
        elif self.layout == "stacked":
            inputs = [torch.stack([image1, image2], dim=1)]
        else:
            inputs = [torch.cat([image1, image2], dim=1)]
        if self.dtypes is not None:
            inputs = [value.to(dtype) for value, dtype in zip(inputs, self.dtypes, strict=True)]
        try:
            found = self.call(inputs)
        except Exception as error:  # whatever its operators raise; the last line says it, those above where
            reason = next((line for line in reversed(str(error).splitlines()) if line.strip()), type(error).__name__)
            what = describe_arrays([(f"input {i}", tuple(value.shape)) for i, value in enumerate(inputs)])
            raise ModelError(
                f"the network failed on {what}: {reason.strip()[:200]}; give the layout or the multiple it was "
                "exported for (-O layout=, -O multiple=; TorchScript also takes -O size=), or export it anew"
            ) from None
        flow = _chosen(found, self.output)
        pairs, _, height, width = image1.shape
        channels_last = flow_layout(flow.shape, pairs, height, width) == "nhwc"
        return flow.permute(0, 3, 1, 2) if channels_last else flow


def _chosen(found: Any, output: Any) -> Tensor:
    outputs = {str(key): value for key, value in found.items()} if isinstance(found, dict) else found
    if isinstance(outputs, Tensor):
        outputs = [outputs]
    if isinstance(outputs, list | tuple):
        outputs = {str(i): value for i, value in enumerate(outputs)}
    name = str(output) if output is not None else (list(outputs)[-1] if outputs else "")
    flow = outputs.get(name) if isinstance(outputs, dict) else None
    if not isinstance(flow, Tensor):
        known = ", ".join(outputs) if isinstance(outputs, dict) else type(found).__name__
        raise ModelError(f"the network has no flow as output '{name}'; its outputs are {known[:200] or 'none'}")
    return flow
