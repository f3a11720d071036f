"""Use a PyTorch module as a flow model, in one line: pass images in its input layout, take the flow from its output."""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.parameter import is_lazy

from ...core.arguments import check_switch
from ...core.errors import ModelError, RobustFlowError, UsageError, class_and_message, unknown_name
from ..calls import traceback_hint
from ..conventions import named_convention
from ..execution import Execution
from ..pair_network import describe_arrays, flow_layout
from .checkpoint import is_plain, kind_of, load_weights, read_checkpoint
from .network_model import NetworkModel, find_device

LAYOUTS = ("pair", "concatenated", "stacked", "images")
_DEFAULT: dict[str, Any] = {"scaling": "0-1", "order": "rgb", "multiple": 8, "layout": "pair", "output": None}
_OF_LIBRARIES: dict[str, dict[str, Any]] = {
    "torchvision.models.optical_flow": {"scaling": "-1-1"},
    "ptlflow.models": {"order": "bgr", "multiple": 1, "layout": "images", "output": "flows"},
}
"""What differs from the defaults in libraries whose networks share one input format."""


class TorchModel(NetworkModel):
    """A PyTorch module as a flow model. Satisfies `FlowModel`.

    Declare the input format with which the network was trained: without a declaration, it is the default, or that of
    the library for networks of torchvision and ptlflow. It is part of `identity` and therefore of a run's manifest.
    `robustflow check` and the first pair of a run report a flow that is not (u right, v down) in pixels.

    Args:
        net: PyTorch module. The model uses a copy in evaluation mode, so training of the original can continue.
        scaling: range of the values: "0-1" (default), "-1-1", "0-255", or "imagenet" (0..1, standardised with
            ImageNet's mean and standard deviation).
        order: colour order, "rgb" (default) or "bgr".
        multiple: number of which height and width must be multiples, 8 by default; frames are padded by repeating the
            border, half on each side.
        layout: input layout: "pair" (default; two images (N, 3, H, W)), "concatenated" (one (N, 6, H, W)), "stacked"
            (one (N, 2, 3, H, W)) or "images" (the stacked tensor in a dictionary, as in ptlflow).
        output: index or key of the flow among several outputs, by default the last; if that output is a list, its last
            element is used. The flow is (N, 2, H, W) or (N, H, W, 2), (u right, v down) in pixels, at the images'
            resolution.
        checkpoint: path of a file with weights to load first, strictly and without executing code in the file.
        sha256: expected SHA-256 of the file, or at least its first eight digits.
        name: name in tables and figures; by default the class name.
        trained_on: training sets, for example "C+T"; see `robustflow list models`. By default those that the checkpoint
            declares.
        batched: whether the module accepts several pairs per call and processes them independently.
        device, precision, compile, threads: execution settings, see `Execution`.

    Raises:
        UsageError: `net` is not a module, or an option is invalid.
        ModelError: the module cannot be copied or has no weights, or the checkpoint does not match it.

    >>> class Net(nn.Module):
    ...     def forward(self, image1, image2):
    ...         return (image1 - image2)[:, :2]
    >>> import numpy as np
    >>> frame = np.zeros((30, 41, 3), np.uint8)
    >>> TorchModel(Net(), scaling="0-1", order="rgb", device="cpu").predict(frame, frame).shape
    (30, 41, 2)
    """

    def __init__(
        self,
        net: nn.Module,
        *,
        scaling: str | None = None,
        order: str | None = None,
        multiple: int | None = None,
        layout: str | None = None,
        output: str | int | None = None,
        checkpoint: str | Path | None = None,
        sha256: str | None = None,
        name: str | None = None,
        trained_on: str | None = None,
        batched: bool = False,
        device: str = "auto",
        precision: str = "fp32",
        compile: bool = False,
        threads: int = 1,
    ) -> None:
        if not isinstance(net, nn.Module):
            raise UsageError("net", f"TorchModel expects a torch.nn.Module, not {type(net).__name__}")
        kind = f"{type(net).__module__}.{type(net).__qualname__}"
        declared = {"scaling": scaling, "order": order, "multiple": multiple, "layout": layout, "output": output}
        library = next((own for start, own in _OF_LIBRARIES.items() if kind.startswith(start)), {})
        given = _DEFAULT | library | {key: value for key, value in declared.items() if value is not None}
        layout, output = given["layout"], given["output"]
        if layout not in LAYOUTS:
            raise unknown_name("layout", str(layout), LAYOUTS)
        convention = named_convention(order=given["order"], scaling=given["scaling"], multiple=given["multiple"])
        check_switch("batched", batched)
        execution = Execution(device, precision, compile, threads)
        self._class = type(net).__name__
        module = _copied(net, kind)
        weights, trained = _loaded(module, checkpoint, sha256, self._class)
        self.frozen = frozenset(
            f"module.{name}" for name, parameter in module.named_parameters() if not parameter.requires_grad
        )
        """Names of the parameters that the module excludes from training."""
        self.trained_on = trained_on or trained
        """The training sets, as abbreviated in the literature; None if they are not declared."""
        module.to(find_device(device)).eval().requires_grad_(False)
        settings = {
            "object": kind,
            "checkpoint": weights,
            "layout": layout,
            "output": "last" if output in (None, -1) else output,
            "batched": batched,
        }
        wrapped = ModuleNet(module, layout, output, batched)
        super().__init__(name or self._class, wrapped, convention, settings, execution)

    def identity(self) -> dict[str, Any]:
        """Return the identity as in `NetworkModel.identity`, but without the name, which does not affect the
        results.
        """
        return {**super().identity(), "name": self._class}


def _copied(net: nn.Module, kind: str) -> nn.Module:
    try:
        return copy.deepcopy(net)
    except Exception as error:
        reason = f"{class_and_message(error)}{traceback_hint(error)}"
        raise ModelError(kind, f"the module cannot be copied ({reason}); pass a newly built module") from error


def _loaded(module: nn.Module, checkpoint: str | Path | None, sha256: str | None, name: str) -> tuple[str, str | None]:
    """Load the checkpoint, if any. Return its hash, or that of the module's weights, and its training sets."""
    for key, value in (*module.named_parameters(), *module.named_buffers()):
        if is_lazy(value):
            raise ModelError(key, f"in a lazy layer of {name}: call the module once on a pair before you pass it")
        if value.is_meta or value.layout is not torch.strided:
            raise ModelError(key, f"a tensor of {kind_of(value)} in {name}: replace it by a dense tensor with values")
    if checkpoint is not None:
        read = read_checkpoint(checkpoint, sha256)
        load_weights(module, read, name)
        return read.sha256, read.trained_on
    if sha256 is not None:
        raise UsageError("sha256", "refers to a checkpoint file: pass a checkpoint, or omit it")
    digest = hashlib.sha256()
    for key, value in sorted(module.state_dict().items()):
        if isinstance(value, Tensor):
            digest.update(f"{key} {value.dtype} {tuple(value.shape)}\n".encode())
            digest.update(value.detach().cpu().contiguous().view(-1).view(torch.uint8).numpy().tobytes())
    return f"state_dict {digest.hexdigest()}", None


class ModuleNet(nn.Module):
    """Pass images to a module in its input layout, and extract the flow from its output."""

    def __init__(self, module: nn.Module, layout: str, output: Any, batched: bool) -> None:
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
        """Predict a flow (N, 2, H, W) in pixels from images (N, 3, H, W) in the module's order and range."""
        if self.batched:
            return self._flow(image1, image2)
        return torch.cat([self._flow(*pair) for pair in zip(image1.split(1), image2.split(1), strict=True)])

    def predictions(self, image1: Tensor, image2: Tensor) -> list[Tensor]:
        """Return all flows in the chosen output, the final one last; by default, a list is a list of flows."""
        returned = self._returned(image1, image2)
        if isinstance(returned, dict) or self.output not in (None, -1):
            chosen_output(returned, self.output)  # raises an error for an output that is not a flow
            returned = _named_output(returned, self.output)[1]
        several = returned if isinstance(returned, list | tuple) and returned else [returned]
        return [_as_flow(chosen_output(output, None), image1) for output in several]

    def _flow(self, image1: Tensor, image2: Tensor) -> Tensor:
        return _as_flow(chosen_output(self._returned(image1, image2), self.output), image1)

    def _returned(self, image1: Tensor, image2: Tensor) -> Any:
        if self.layout == "pair":
            inputs = [image1.contiguous(), image2.contiguous()]
        else:
            join = torch.cat if self.layout == "concatenated" else torch.stack
            inputs = [join([image1, image2], dim=1)]
        try:
            return self.module(*([{"images": inputs[0]}] if self.layout == "images" else inputs))
        except RobustFlowError:
            raise
        except Exception as error:  # any operator can fail; the last line of its message is the reason
            reason = next((line for line in reversed(str(error).splitlines()) if line.strip()), type(error).__name__)
            what = describe_arrays([(f"input {i}", tuple(value.shape)) for i, value in enumerate(inputs)])
            advice = "set its input layout, or the multiple that its height and width need (-O layout=, -O multiple=)"
            if isinstance(error, torch.OutOfMemoryError):
                advice = "use fewer pairs at once, smaller frames or crops, or the CPU"
            reason = f"{type(error).__name__}: {reason.strip()[:200]}{traceback_hint(error)}"
            raise ModelError(type(self.module).__name__, f"the network failed on {what}: {reason}; {advice}") from error


def _as_flow(output: Tensor, image1: Tensor) -> Tensor:
    """Convert an output for images (N, 3, H, W) to a flow (N, 2, H, W)."""
    if not (is_plain(output) and output.is_floating_point()):
        advice = "return a dense floating-point tensor, or choose a different output with -O output="
        raise ModelError(kind_of(output), f"the type of the network's output; {advice}")
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
        outputs = ", ".join(_outputs_of(returned))[:200] or "none"
        raise ModelError(
            f"output={name}", f"it is {type(flow).__name__}, not a tensor; the network's outputs are {outputs}"
        )
    return flow


def _named_output(returned: Any, output: Any) -> tuple[str, Any]:
    """Return the name and value of the chosen output; None if there are no outputs to choose from."""
    outputs = _outputs_of(returned)
    names = list(outputs)
    if output is None or output == -1:
        return (names[-1], outputs[names[-1]]) if names else ("", None)
    name = names[output] if isinstance(output, int) and -len(names) <= output < 0 else str(output)
    if name not in outputs:
        choice = ", ".join(names)[:200] or "none"
        raise UsageError(f"output={name}", f"the network has no such output; choose from {choice}")
    return name, outputs[name]


def _outputs_of(returned: Any) -> dict[str, Any]:
    """Return a module's outputs, keyed by name or position."""
    if isinstance(returned, dict):
        return {str(key): value for key, value in returned.items()}
    several: Iterable[Any] = returned if isinstance(returned, list | tuple) else [returned]
    return {str(i): value for i, value in enumerate(several) if not isinstance(value, str | bytes)}
