"""Count the parameters and multiply-accumulates of a network, exactly and as in the paper's Tab. 3 (Sec. 4.2), and
measure the time and memory of actual predictions.

The paper's table was computed with thop, which only counts modules (convolutions, linear layers, norms, pooling and
upsampling). It ignores matrix products in correlation volumes and attention, layers that are not executed, and layers
whose class is not exactly PyTorch's own. A module that is registered at two points in the network is hooked twice and
added twice, so its operations are counted four times; this is the case for some norms in RAFT. thop's rules are
reimplemented here from its observed behaviour, because thop modifies the network and is no longer maintained.

The paper's FLOPs are thop's multiply-accumulates for 12 iterations at 1x3x432x720; for ARFlow they are measured at
256x832, the size to which it resizes KITTI. FlowFormer++ was counted without the padding to multiples of 32 that is
used in prediction. BrightFlow and SAMFlow were counted with a full-resolution flow after every iteration, as in
training; in prediction, our versions only upsample the last flow, which saves the computation of eleven upsampling
masks.
"""

from __future__ import annotations

import copy
import logging
import resource
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from math import prod
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch._subclasses.fake_tensor import (
    DataDependentOutputException,
    DynamicOutputShapeException,
    FakeTensorMode,
    unset_fake_temporarily,
)
from torch.utils.flop_counter import FlopCounterMode

from ..core.errors import AssetError, ModelError, RobustFlowError, UsageError, class_and_message
from .catalog import methods
from .loading import load_model
from .tiling import TiledModel
from .torch.build import RANDOM
from .torch.network_model import NetworkModel, TorchClipModel

_LOGGER = logging.getLogger("torch._subclasses.fake_tensor")


@dataclass(frozen=True)
class Counts:
    """The cost of one prediction."""

    parameters: int
    macs: int
    thop_parameters: int
    thop_macs: int


def count(net: nn.Module, height: int, width: int) -> Counts:
    """Count the cost of one call of `net` on two images (1, 3, height, width) without computing any values."""
    _LOGGER.disabled = True  # PyTorch logs a traceback in addition to raising an exception
    try:
        try:
            with FakeTensorMode(allow_non_fake_inputs=True):
                return _count(_copy(net), height, width)
        except (DataDependentOutputException, DynamicOutputShapeException):
            return _count(_copy(net), height, width)
    except RobustFlowError:
        raise
    except Exception as error:
        raise ModelError(
            f"{height}x{width}",
            f"the network fails on frames of this size ({class_and_message(error)}); try a larger size",
        ) from error
    finally:
        _LOGGER.disabled = False


def _copy(net: nn.Module) -> nn.Module:
    with unset_fake_temporarily():
        return copy.deepcopy(net).cpu().eval()


def _count(net: nn.Module, height: int, width: int) -> Counts:
    tally = _ThopTally(net)
    handles = [
        module.register_forward_hook(tally.hook, with_kwargs=True) for module in net.modules() if type(module) in _RULES
    ]
    counter = FlopCounterMode(display=False)
    try:
        with torch.no_grad(), counter:
            net(*(torch.zeros(1, 3, height, width) for _ in range(2)))
    finally:
        for handle in handles:
            handle.remove()
    return Counts(
        parameters=sum(value.numel() for value in net.parameters()),
        macs=int(counter.get_total_flops()) // 2,
        thop_parameters=sum(
            tally.places[module] * value.numel() for module in tally.run for value in module.parameters()
        ),
        thop_macs=tally.macs,
    )


class _ThopTally:
    def __init__(self, net: nn.Module) -> None:
        self.macs = 0
        self.run: dict[nn.Module, None] = {}
        self.places = Counter(_visits(net))

    def hook(self, module: nn.Module, inputs: tuple[Any, ...], named: dict[str, Any], output: Any) -> None:
        self.run[module] = None
        tensors = [value for value in (*inputs, *named.values()) if isinstance(value, Tensor)]
        if tensors and isinstance(output, Tensor):
            self.macs += self.places[module] ** 2 * _RULES[type(module)](module, tensors[0], output)


def _visits(net: nn.Module) -> Iterator[nn.Module]:
    """Yield each module once for every path that leads to it."""
    yield net
    for child in net.children():
        yield from _visits(child)


def _convolution(module: Any, x: Tensor, y: Tensor) -> int:
    return y.numel() * (x.shape[1] // module.groups) * prod(module.weight.shape[2:])


def _linear(module: Any, x: Tensor, y: Tensor) -> int:
    return y.numel() * int(module.in_features)


def _norm(module: Any, x: Tensor, y: Tensor) -> int:
    scaled = getattr(module, "affine", False) or getattr(module, "elementwise_affine", False)
    return x.numel() * (4 if scaled else 2)


def _softmax(module: Any, x: Tensor, y: Tensor) -> int:
    features = x.shape[module.dim]
    return x.numel() // features * (3 * features - 1)


def _adaptive_pooling(module: Any, x: Tensor, y: Tensor) -> int:
    return int((prod(x.shape[2:]) / prod(y.shape[2:]) + 1) * y.numel())


def _upsampling(module: Any, x: Tensor, y: Tensor) -> int:
    return y.numel() * {"nearest": 1, "linear": 5, "bilinear": 11, "bicubic": 259}.get(module.mode, 0)


_RULES: dict[type[nn.Module], Callable[[Any, Tensor, Tensor], int]] = {
    **dict.fromkeys((nn.Conv1d, nn.Conv2d, nn.Conv3d), _convolution),
    **dict.fromkeys((nn.ConvTranspose1d, nn.ConvTranspose2d, nn.ConvTranspose3d), _convolution),
    nn.Linear: _linear,
    **dict.fromkeys((nn.BatchNorm1d, nn.BatchNorm2d, nn.BatchNorm3d, nn.SyncBatchNorm, nn.LayerNorm), _norm),
    **dict.fromkeys((nn.InstanceNorm1d, nn.InstanceNorm2d, nn.InstanceNorm3d), _norm),
    nn.Softmax: _softmax,
    nn.PReLU: lambda module, x, y: x.numel(),
    **dict.fromkeys((nn.AvgPool1d, nn.AvgPool2d, nn.AvgPool3d), lambda module, x, y: y.numel()),
    **dict.fromkeys((nn.AdaptiveAvgPool1d, nn.AdaptiveAvgPool2d, nn.AdaptiveAvgPool3d), _adaptive_pooling),
    **dict.fromkeys((nn.Upsample, nn.UpsamplingNearest2d, nn.UpsamplingBilinear2d), _upsampling),
}


def network_of(model: Any) -> NetworkModel:
    """Return the adapter that contains a model's network, without the tiling wrapper."""
    while isinstance(model, TiledModel):
        model = model.model
    if isinstance(model, TorchClipModel):
        raise UsageError(model.name, "needs a clip, but only two-frame networks can be profiled; choose another model")
    if not isinstance(model, NetworkModel):
        raise UsageError(
            "only PyTorch networks can be profiled, but this model does not expose one; choose a model that "
            "robustflow list models shows with the source own, ptlflow or torchvision"
        )
    return model


def count_prediction(model: Any, height: int, width: int) -> Counts:
    """Count the cost of one prediction on frames of this size, over all tiles if the model predicts in tiles."""
    network = network_of(model)
    tiles, size = model.tiles(height, width) if isinstance(model, TiledModel) else (1, (height, width))
    one = count(network.net, *network.convention.fitted_size(*size))
    return replace(one, macs=tiles * one.macs, thop_macs=tiles * one.thop_macs)


@dataclass(frozen=True)
class PredictionCost:
    seconds: float
    peak_bytes: int
    device: str


def measure_prediction(model: NetworkModel | TiledModel, height: int, width: int, repeat: int = 1) -> PredictionCost:
    """Time predictions on a pair of random frames; on a GPU, one additional warm-up prediction is made first."""
    if repeat < 1:
        raise UsageError("--repeat", f"must be at least 1, not {repeat}")
    frames = np.random.default_rng(0).integers(0, 256, (2, height, width, 3)).astype(np.uint8)
    gpu = model.device.type == "cuda"
    if gpu:
        model.predict(*frames)
        torch.cuda.reset_peak_memory_stats(model.device)
    seconds = []
    for _ in range(repeat):
        start = time.perf_counter()
        model.predict(*frames)  # waits for the GPU, because the flow is copied to the CPU
        seconds.append(time.perf_counter() - start)
    unit = 1 if sys.platform == "darwin" else 1024
    peak = torch.cuda.max_memory_allocated(model.device) if gpu else 0
    peak = peak or resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit
    return PredictionCost(min(seconds), peak, str(model.device))


_UNPADDED = ("flowformer_pp",)
_EVERY_FLOW = ("brightflow", "samflow_t", "samflow_b", "samflow_h")


class EveryFlow(nn.Module):
    """Wrapper that makes a network compute all its `flows`, one per iteration, instead of only the last one."""

    def __init__(self, net: nn.Module) -> None:
        super().__init__()
        self.net = net

    def forward(self, image1: Tensor, image2: Tensor) -> Any:
        return self.net.flows(image1, image2)


def count_as_the_paper(
    published: Iterable[str], frames: tuple[int, int]
) -> Iterator[tuple[str, tuple[int, int], Counts | str]]:
    """Yield methods of the paper's table with their input sizes and their costs, or why these cannot be counted."""
    names = {entry.method: name for name, entry in methods().items()}
    for method in published:
        name = names[method]
        try:
            model = network_of(load_model(name, checkpoint=RANDOM, device="cpu"))
        except (AssetError, ModelError) as error:
            yield method, frames, str(error)
            continue
        if name in _UNPADDED:
            model.net.model.output_stride = 8
        size = model.convention.fitted_size(*frames)
        net = EveryFlow(model.net) if name in _EVERY_FLOW else model.net
        yield method, size, count(net, *size)
