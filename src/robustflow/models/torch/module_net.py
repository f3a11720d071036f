"""Wrap torchvision's RAFT in the interface of the project's networks. Wrap a PyTorch module in the interface of the
project's networks.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import torch
from torch import Tensor, nn

from ...core.errors import ModelError, RobustFlowError, UsageError
from ..devices import traceback_hint
from ..signature import describe_arrays, flow_layout
from .weights import is_plain, kind_of


class TorchvisionRaft(nn.Module):
    """torchvision's RAFT with its input transform; returns only the last flow."""

    def __init__(self, model: Any, iterations: int) -> None:
        super().__init__()
        self.model = model
        self.iterations = iterations

    def forward(self, image1: Tensor, image2: Tensor) -> Tensor:
        """Predict the flow (N, 2, H, W) in pixels from RGB images (N, 3, H, W) in 0..255."""
        return self.predictions(image1, image2)[-1]

    def predictions(self, image1: Tensor, image2: Tensor) -> list[Tensor]:
        """Return the flow after every iteration, for the loss."""
        first, second = ((image.contiguous() / 255 - 0.5) / 0.5 for image in (image1, image2))
        flows: list[Tensor] = self.model(first, second, num_flow_updates=self.iterations)
        return flows


MODULE_LAYOUTS = ("pair", "concatenated", "stacked", "images")
"""Layouts of a module's input: two images (N, 3, H, W); one tensor (N, 6, H, W); one tensor (N, 2, 3, H, W); or the
latter in a dictionary, `{"images": ...}`, as in ptlflow.
"""


class ModuleNet(nn.Module):
    """Pass images to a module in its input layout, and extract the flow from its output."""

    def __init__(
        self,
        module: nn.Module,
        layout: str,
        output: Any,
        batched: bool,
    ) -> None:
        super().__init__()
        self.module = module
        self.layout = layout
        self.output = output
        self.batched = batched

    def train(self, mode: bool = True) -> ModuleNet:
        """Keep the module in its current training or evaluation mode."""
        self.training = mode
        return self

    def forward(self, image1: Tensor, image2: Tensor) -> Tensor:
        """Predict a flow (N, 2, H, W) in pixels from images (N, 3, H, W) in the module's colour order and value
        range.
        """
        if self.batched:
            return self._flow(image1, image2)
        return torch.cat([self._flow(*pair) for pair in zip(image1.split(1), image2.split(1), strict=True)])

    def predictions(self, image1: Tensor, image2: Tensor) -> list[Tensor]:
        """Return all flows in the chosen output, the final one last; without a choice, a list of outputs is a list of
        flows.
        """
        returned = self.returned(image1, image2)
        if isinstance(returned, dict) or self.output not in (None, -1):
            chosen_output(returned, self.output)  # raises an error for an output that is not a flow
            returned = _named_output(returned, self.output)[1]
        several = returned if isinstance(returned, list | tuple) and returned else [returned]
        return [as_flow(chosen_output(one, None), image1) for one in several]

    def returned(self, image1: Tensor, image2: Tensor) -> Any:
        """Return the module's raw output for these images."""
        inputs = self._inputs(image1, image2)
        try:
            return self.module(*inputs)
        except RobustFlowError:
            raise
        except Exception as error:  # any operator can fail; the last line of its message is the reason
            reason = next((line for line in reversed(str(error).splitlines()) if line.strip()), type(error).__name__)
            shapes = [value["images"].shape if isinstance(value, dict) else value.shape for value in inputs]
            what = describe_arrays([(f"input {i}", tuple(shape)) for i, shape in enumerate(shapes)])
            advice = "set its input layout, or the multiple that its height and width need (-O layout=, -O multiple=)"
            if isinstance(error, torch.OutOfMemoryError):
                advice = "use fewer pairs at once, smaller frames or crops, or the CPU"
            raise ModelError(
                f"the network failed on {what}: {type(error).__name__}: {reason.strip()[:200]}{traceback_hint(error)}; "
                f"{advice}"
            ) from error

    def _inputs(self, image1: Tensor, image2: Tensor) -> list[Any]:
        if self.layout == "pair":
            inputs = [image1.contiguous(), image2.contiguous()]
        elif self.layout == "concatenated":
            inputs = [torch.cat([image1, image2], dim=1)]
        else:
            inputs = [torch.stack([image1, image2], dim=1)]
        return [{"images": inputs[0]}] if self.layout == "images" else inputs

    def _flow(self, image1: Tensor, image2: Tensor) -> Tensor:
        return as_flow(chosen_output(self.returned(image1, image2), self.output), image1)


def as_flow(output: Tensor, image1: Tensor) -> Tensor:
    """Convert an output for images (N, 3, H, W) to a flow (N, 2, H, W)."""
    if not (is_plain(output) and output.is_floating_point()):
        raise ModelError(
            f"the network's flow is a tensor of {kind_of(output)}; return a dense floating-point tensor, or choose a "
            "different output with -O output="
        )
    pairs, _, height, width = image1.shape
    if output.ndim == 5 and output.shape[1] == 1:
        output = output[:, 0]
    channels_last = flow_layout(output.shape, pairs, height, width) == "nhwc"
    return output.permute(0, 3, 1, 2) if channels_last else output


def chosen_output(returned: Any, output: Any) -> Tensor:
    """Extract the flow from a module's output; if the chosen output is a list, use its last element.

    >>> chosen_output({"flows": [torch.zeros(1), torch.ones(1)], "other": 3}, "flows")
    tensor([1.])
    """
    name, flow = _named_output(returned, output)
    while isinstance(flow, list | tuple) and flow:
        flow = flow[-1]
    if not isinstance(flow, Tensor):
        known = ", ".join(outputs_of(returned))[:200] or "none"
        raise ModelError(
            f"output '{name}' of the network is {type(flow).__name__}, not a tensor; its outputs are {known}"
        )
    return flow


def _named_output(returned: Any, output: Any) -> tuple[str, Any]:
    """Return the name and value of the chosen output; None if there are no outputs to choose from."""
    outputs = outputs_of(returned)
    names = list(outputs)
    if output is None or output == -1:
        return (names[-1], outputs[names[-1]]) if names else ("", None)
    name = names[output] if isinstance(output, int) and -len(names) <= output < 0 else str(output)
    if name not in outputs:
        raise UsageError(
            f"output={name}: the network has no such output; choose from {', '.join(names)[:200] or 'none'}"
        )
    return name, outputs[name]


def outputs_of(returned: Any) -> dict[str, Any]:
    """Return a module's outputs, keyed by name or position.

    >>> list(outputs_of([torch.zeros(1), torch.ones(1)]))
    ['0', '1']
    """
    if isinstance(returned, dict):
        return {str(key): value for key, value in returned.items()}
    several: Iterable[Any] = returned if isinstance(returned, list | tuple) else [returned]
    return {str(i): value for i, value in enumerate(several) if not isinstance(value, str | bytes)}
