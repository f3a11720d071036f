"""Use a PyTorch module as a flow model, in one line."""

from __future__ import annotations

import copy
import hashlib
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.parameter import is_lazy

from ...core.errors import ModelError, UsageError, unknown_name
from ..conventions import ORDERS, SCALINGS, check_switch, named_convention
from ..devices import Execution, traceback_hint
from .checkpoint import read_checkpoint
from .guess import LAST_OUTPUT, Declared, infer_convention
from .model import NetworkModel, find_device
from .module_net import MODULE_LAYOUTS, ModuleNet
from .weights import kind_of, load_weights

_KNOWN = {
    "torchvision.models.optical_flow": (Declared("-1-1", "rgb", "pair", LAST_OUTPUT), 8),
    "ptlflow.models": (Declared("0-1", "bgr", "images", "flows"), 1),
}
"""Libraries whose models share one input convention, and the multiple that they require for height and width."""
MULTIPLE = 8


class ConventionWarning(UserWarning):
    """Warns that the declared input or output fails on shifted textures, or states which convention was determined."""


class TorchModel(NetworkModel):
    """A PyTorch module as a flow model. Satisfies `FlowModel`.

    Declare the input convention with which the network was trained; it is checked on shifted textures. Missing values
    are looked up (torchvision, ptlflow), or determined by trying the common conventions on these textures. A convention
    is only used if it is clearly the best, and is stated in a warning. For a network without trained weights, the
    convention cannot be determined and must be declared. The convention is part of `identity` and therefore of a run's
    manifest.

    Args:
        net: PyTorch module. The model uses a copy in evaluation mode, so training of the original can continue.
        scaling: range of the values: "0-1", "-1-1", "0-255", or "imagenet" (0..1, standardised with ImageNet's mean and
            standard deviation).
        order: colour order, "rgb" or "bgr".
        multiple: number of which height and width must be multiples, 8 by default; frames are padded by repeating the
            border, half on each side.
        layout: input layout: "pair" (two images (N, 3, H, W)), "concatenated" (one (N, 6, H, W)), "stacked" (one (N, 2,
            3, H, W)) or "images" (the stacked tensor in a dictionary, as in ptlflow).
        output: index or key of the flow among several outputs; if that output is a list, its last element is used. The
            flow is (N, 2, H, W) or (N, H, W, 2), (u right, v down) in pixels, at the images' resolution.
        checkpoint: path of a file with weights to load first, strictly and without executing code in the file.
        sha256: expected SHA-256 of the file, or at least its first eight digits.
        name: name in tables and figures; by default the class name.
        trained_on: training sets, for example "C+T"; see `robustflow list models`. By default those that the checkpoint
            declares.
        batched: whether the module accepts several pairs per call and processes them independently.
        device, precision, compile, threads: execution settings, see `Execution`.

    Raises:
        UsageError: `net` is not a module, or an option is invalid.
        ModelError: no convention is clearly the best, the declared convention is wrong, the module fails, or the
            checkpoint does not match it.

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
            raise UsageError(f"TorchModel expects a torch.nn.Module, not {type(net).__name__}")
        choices = {"scaling": (scaling, SCALINGS), "order": (order, ORDERS), "layout": (layout, MODULE_LAYOUTS)}
        for option, (value, choice) in choices.items():
            if value is not None and value not in choice:
                raise unknown_name(option, str(value), choice)
        check_switch("batched", batched)
        execution = Execution(device, precision, compile, threads)
        kind = f"{type(net).__module__}.{type(net).__qualname__}"
        module = _copied(net, kind)
        weights, trained = _loaded(module, checkpoint, sha256, type(net).__name__)
        frozen = [name for name, value in module.named_parameters() if not value.requires_grad]
        module.to(find_device(device)).eval().requires_grad_(False)

        library = next((known for start, known in _KNOWN.items() if kind.startswith(start)), None)
        known, known_multiple = library or (Declared(), MULTIPLE)
        declared = Declared(scaling or known.scaling, order or known.order, layout or known.layout, output)
        if declared.output is None and declared.layout == known.layout:
            declared = replace(declared, output=known.output)

        multiple = known_multiple if multiple is None else multiple
        if library is None or declared != known:  # the conventions of these libraries are known
            declared, remark = infer_convention(module, declared, multiple, find_device(device), threads)
            if remark:
                warnings.warn(f"{type(net).__name__}: {remark}", ConventionWarning, stacklevel=2)
        self.declared = declared
        self.trained_on = trained_on or trained
        """The training sets, as abbreviated in the literature; None if they are not declared."""
        convention = named_convention(
            order=declared.order or "rgb",
            scaling=declared.scaling or "0-1",
            multiple=multiple,
        )
        settings = {
            "object": kind,
            "checkpoint": weights,
            "layout": declared.layout,
            "output": "last" if declared.output in (None, LAST_OUTPUT) else declared.output,
            "batched": batched,
        }
        wrapped = ModuleNet(module, declared.layout or "pair", declared.output, batched)
        self._class = type(net).__name__
        super().__init__(name or self._class, wrapped, convention, settings, execution)
        self.frozen = frozenset(f"module.{name}" for name in frozen)
        """Names of the parameters that the module excludes from training."""

    def identity(self) -> dict[str, Any]:
        """Return the identity as in `NetworkModel.identity`, but without the name, which does not affect the
        results.
        """
        return {**super().identity(), "name": self._class}


def _copied(net: nn.Module, kind: str) -> nn.Module:
    try:
        return copy.deepcopy(net)
    except Exception as error:
        raise ModelError(
            f"the module {kind} cannot be copied ({type(error).__name__}: {' '.join(str(error).split())}"
            f"{traceback_hint(error)}); pass a newly built module"
        ) from error


def _loaded(module: nn.Module, checkpoint: str | Path | None, sha256: str | None, name: str) -> tuple[str, str | None]:
    """Load the checkpoint, if there is one. Return the hash of the checkpoint, or else of the module's weights, and the
    training sets that the checkpoint declares.
    """
    _refuse_missing_weights(module, name)
    if checkpoint is not None:
        read = read_checkpoint(checkpoint, sha256)
        load_weights(module, read, name)
        return read.sha256, read.trained_on
    if sha256 is not None:
        raise UsageError("sha256 refers to a checkpoint file: pass a checkpoint, or omit sha256")
    digest = hashlib.sha256()
    for key, value in sorted(module.state_dict().items()):
        if isinstance(value, Tensor):
            digest.update(f"{key} {value.dtype} {tuple(value.shape)}\n".encode())
            digest.update(value.detach().cpu().contiguous().view(-1).view(torch.uint8).numpy().tobytes())
    return f"state_dict {digest.hexdigest()}", None


def _refuse_missing_weights(module: nn.Module, name: str) -> None:
    for key, value in (*module.named_parameters(), *module.named_buffers()):
        if is_lazy(value) or value.is_meta or value.layout is not torch.strided:
            what = "is in a lazy layer: call the module once on a pair of images"
            if not is_lazy(value):
                what = f"is a tensor of {kind_of(value)}: replace it by a dense tensor with values"
            raise ModelError(f"'{key}' of {name} {what} before you pass the module")
