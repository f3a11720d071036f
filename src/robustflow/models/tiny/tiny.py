"""`tiny` and its variants: the project's small network with the weights shipped in the package.

The network runs in PyTorch if the torch extra is installed, otherwise in NumPy. Both use single precision, and the
network amplifies rounding errors: on real pairs the flows differ by up to about 4e-3 px (docs/tiny.md). A run's
identity records the runtime.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open

from ...core.errors import AssetError, UsageError, unknown_name
from ...core.plugins import install_command
from ...core.types import Flow, Frame
from ..conventions import InputConvention
from ..execution import Execution
from ..pair_network import check_pair
from ..protocols import AnyModel
from ..torch.build import network_model
from . import layers
from .layers import Maps, Weights

SHIPPED = ("tiny", "tiny_no_weather", "tiny_all")
"""Models trained without corruptions, with all families of corruptions except weather, and with all."""


@dataclass(frozen=True, eq=False)
class ShippedWeights:
    """The contents of a weight file."""

    arrays: Mapping[str, Weights]
    sha256: str
    about: Mapping[str, str]
    trained_on: str = "shapes:train"


def shipped_weights(name: str) -> ShippedWeights:
    """Return the weights of a model in `SHIPPED`."""
    path = files(__package__).joinpath("weights", f"{name}.safetensors")
    try:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        with safe_open(str(path), framework="numpy") as file:
            arrays = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 (it is not a mapping)
            about = dict(file.metadata() or {})
    except (OSError, SafetensorError) as error:
        raise AssetError(path, f"missing or damaged ({error}); reinstall robustflow") from error
    return ShippedWeights(arrays, digest, about)


def predict(weights: Mapping[str, Weights], frame1: Frame, frame2: Frame) -> Flow:
    """Compute the flow of a pair."""
    height, width = frame1.shape[:2]
    top, left = (-height % layers.MULTIPLE) // 2, (-width % layers.MULTIPLE) // 2
    first, second = (_pyramid(weights, _network_input(frame)) for frame in (frame1, frame2))
    flow = np.zeros((*first[-1].shape[:2], 2), np.float32)
    hidden = flow
    for level, (own, other) in enumerate(zip(first[::-1], second[::-1], strict=True)):
        if level:
            flow = layers.resized(flow, *own.shape[:2])
        hidden = _decoded(weights, level, own, other, flow)
        flow = flow + _layer(weights, "flow", hidden, linear=True)
    fine = layers.enlarge(flow, _layer(weights, "mask", hidden, linear=True), layers.FINEST)
    return np.ascontiguousarray(fine[top : top + height, left : left + width])


def _network_input(frame: Frame) -> Maps:
    """Convert a frame to the network's input: (H, W, 3) in -1..1, padded to multiples of 32 by repeating the border."""
    height, width = frame.shape[:2]
    rows, columns = -height % layers.MULTIPLE, -width % layers.MULTIPLE
    padded = np.pad(frame, ((rows // 2, rows - rows // 2), (columns // 2, columns - columns // 2), (0, 0)), mode="edge")
    return (padded.astype(np.float32) - np.float32(127.5)) * np.float32(2 / 255)


def _layer(
    weights: Mapping[str, Weights], name: str, maps: Maps, stride: int = 1, dilation: int = 1, linear: bool = False
) -> Maps:
    return layers.convolve(maps, weights[f"{name}.0.weight"], weights[f"{name}.0.bias"], stride, dilation, linear)


def _pyramid(weights: Mapping[str, Weights], maps: Maps) -> list[Maps]:
    """Return the features at 1/4, 1/8, 1/16 and 1/32 resolution."""
    levels = []
    for level in range(layers.LEVELS):
        for place, stride in ((0, 2), (1, 1)):
            maps = _layer(weights, f"pyramid.convs.{level}.{place}", maps, stride)
        levels.append(maps)
    return levels[1:]


def _decoded(weights: Mapping[str, Weights], level: int, own: Maps, other: Maps, flow: Maps) -> Maps:
    """Return the features of a level that are passed to the decoder, (H, W, 32)."""
    warped = np.empty(other.shape, np.float32)
    layers.warp(other, flow, warped)
    correlation = np.empty((*own.shape[:2], (2 * layers.RADIUS + 1) ** 2), np.float32)
    layers.correlate(
        layers.normalised(own, layers.EPSILON), layers.normalised(warped, layers.EPSILON), layers.RADIUS, correlation
    )
    reduced = _layer(weights, f"reduce.{level}", own)
    maps = np.concatenate((correlation, reduced, flow), axis=2)
    for place, (_, dilation) in enumerate(layers.DECODER):
        maps = _layer(weights, f"decoder.{place}", maps, dilation=dilation)
    return maps


class NumpyTiny:
    """The small network in NumPy; satisfies `FlowModel`.

    >>> import numpy as np
    >>> from robustflow.models.tiny.tiny import shipped_weights
    >>> frame = np.random.default_rng(0).integers(0, 255, (40, 70, 3)).astype(np.uint8)
    >>> NumpyTiny("tiny", shipped_weights("tiny")).predict(frame, frame).shape
    (40, 70, 2)
    """

    single_threaded = True

    def __init__(self, name: str, weights: ShippedWeights) -> None:
        self.name = name
        self.trained_on = weights.trained_on
        self._weights = weights

    def identity(self) -> dict[str, Any]:
        """Return the identity: the weights' SHA-256 and the runtime, NumPy."""
        return {"name": self.name, "checkpoint": self._weights.sha256, "runtime": "numpy"}

    def predict(self, frame1: Frame, frame2: Frame) -> Flow:
        """Predict a flow as in `FlowModel.predict`, for frames of any size."""
        check_pair(frame1, frame2)
        return predict(self._weights.arrays, frame1, frame2)


RUNTIMES = ("auto", "torch", "numpy")
_CONVENTION = InputConvention(mean=(127.5, 127.5, 127.5), scale=2 / 255, fit="pad", multiple=layers.MULTIPLE)


def small_network(
    name: str,
    checkpoint: str | Path | None = None,
    *,
    runtime: str = "auto",
    sha256: str | None = None,
    device: str = "auto",
    precision: str = "fp32",
    compile: bool = False,
    threads: int = 1,
) -> AnyModel:
    """Build the small network."""
    if runtime not in RUNTIMES:
        raise unknown_name("runtime", str(runtime), RUNTIMES)
    execution = Execution(device, precision, compile, threads)
    if runtime == "auto":
        runtime = "torch" if checkpoint is not None or find_spec("torch") is not None else "numpy"
    if runtime == "numpy":
        _check_for_numpy(name, checkpoint, execution)
        return NumpyTiny(name, shipped_weights(name))
    if checkpoint is None:
        return _with_shipped_weights(name, execution)
    source = "a file written by robustflow train tiny"
    return network_model(name, _net, _CONVENTION, checkpoint, source=source, sha256=sha256, execution=execution)


def _with_shipped_weights(name: str, execution: Execution) -> AnyModel:
    import torch

    from ..torch.network_model import NetworkModel

    weights, net = shipped_weights(name), _net()
    net.load_state_dict({key: torch.from_numpy(array.copy()) for key, array in weights.arrays.items()})
    model = NetworkModel(name, net, _CONVENTION, {"checkpoint": weights.sha256, "runtime": "torch"}, execution)
    model.trained_on = weights.trained_on
    return model


def _net() -> Any:
    from .network import Tiny as Network

    return Network()


def _check_for_numpy(name: str, checkpoint: str | Path | None, execution: Execution) -> None:
    if checkpoint is not None:
        raise UsageError("runtime", f"{name} with a checkpoint of yours needs PyTorch: omit runtime=numpy")
    if execution.device not in ("auto", "cpu") or execution.precision != "fp32" or execution.compile:
        raise UsageError(
            "runtime",
            f"{name} without PyTorch only runs on the CPU in fp32; omit device, precision and compile, or install "
            f"PyTorch: {install_command('torch')}",
        )


tiny = partial(small_network, "tiny")
tiny_no_weather = partial(small_network, "tiny_no_weather")
tiny_all = partial(small_network, "tiny_all")
