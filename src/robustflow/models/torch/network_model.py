"""PyTorch networks as flow models: input images, output flow, device, precision, and reproducible settings."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ...core.errors import ModelError, RobustFlowError, UsageError, class_and_message, first_line, unknown_name
from ...core.types import Flow, Frame
from ..calls import traceback_hint
from ..conventions import InputConvention
from ..execution import Execution
from ..pair_network import PairNetwork, check_pair
from ..protocols import Window
from .double import in_float64
from .whole import differentiated

# Since PyTorch 2.9, precision is set per backend; the older functions, needed before 2.9, cannot report these settings.
_PER_BACKEND = hasattr(torch.backends.cuda.matmul, "fp32_precision")
_MATMULS: tuple[Any, ...] = (torch.backends.cuda.matmul, torch.backends.mkldnn.matmul) if _PER_BACKEND else ()
_IEEE: dict[str, Any] = {"fp32_precision": "ieee"} if _PER_BACKEND else {}

_MOST_IN_FLOAT64 = 100_000_000
"""Number of parameters above which a network is not copied in float64."""


@contextmanager
def reproducible(threads: int = 1) -> Iterator[None]:
    """Run a block with true float32 (no TF32), deterministic algorithms and a fixed number of CPU threads."""
    before = torch.get_num_threads(), _matmul_precision(), [backend.fp32_precision for backend in _MATMULS]
    torch.set_num_threads(threads)
    torch.set_float32_matmul_precision("highest")
    try:
        with torch.backends.cudnn.flags(enabled=True, benchmark=False, deterministic=True, allow_tf32=False, **_IEEE):
            yield
    finally:
        torch.set_num_threads(before[0])
        torch.set_float32_matmul_precision(before[1])
        for backend, precision in zip(_MATMULS, before[2], strict=True):
            backend.fp32_precision = precision


def _matmul_precision() -> str:
    try:
        return torch.get_float32_matmul_precision()
    except RuntimeError:  # the precision was set per backend, and is restored in the same way
        return "highest"


class NetworkModel(PairNetwork):
    """A PyTorch network as a model; satisfies `FlowModel`."""

    trained_on: str | None = None
    """The training sets that the checkpoint declares."""
    frozen: frozenset[str] = frozenset()
    """Names of the parameters of `net` that the user's module excludes from training."""

    def __init__(
        self,
        name: str,
        net: nn.Module,
        convention: InputConvention,
        settings: Mapping[str, Any],
        execution: Execution,
    ) -> None:
        self.name = name
        self.convention = convention
        self.device = find_device(execution.device)
        self.net = net.to(self.device).eval().requires_grad_(False)
        self._settings = dict(settings)
        self._execution = execution
        self._call = torch.compile(self.net) if execution.compile else self.net

    @property
    def threads(self) -> int:
        """The number of CPU threads used in the forward and backward pass."""
        return self._execution.threads

    def identity(self) -> dict[str, Any]:
        """Return what affects the results: the network's settings, its input convention, the execution settings."""
        return {
            "name": self.name,
            **self._settings,
            "input": self.convention.describe(),
            **self._execution.record(self.device.type),
            "torch": torch.__version__,
        }

    @property
    def _batches_pairs(self) -> bool:
        return self.device.type != "cpu"

    @property
    def batched_gradients(self) -> bool:
        """Whether attacks evaluate several pairs in one call, as in `predict_batch`."""
        return self._batches_pairs

    def differentiable(self, images1: Tensor, images2: Tensor) -> Tensor:
        """Compute the flow as described in `Differentiable`, with the gradient through `detach` (see `whole`)."""
        height, width = images1.shape[2:]
        self.convention.fitted_size(height, width)
        values = (255 * image.to(self.device) for image in (images1, images2))
        fitted = [fitted_values(value, self.convention) for value in values]
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self._execution.precision == "bf16"):
            flow = differentiated(self.net, lambda: self._ask(fitted, {}, height, width))
        return unfitted_flow(_at_least_single(flow), self.convention, height, width)

    @cached_property
    def in_float64(self) -> NetworkModel | None:
        """The network in float64, for `differentiable`; None on an accelerator, and for very large networks."""
        if self.device.type != "cpu" or sum(weight.numel() for weight in self.net.parameters()) > _MOST_IN_FLOAT64:
            return None
        model, net = copy.copy(self), copy.deepcopy(self.net).double()
        model.net, model._call = net, in_float64(net)
        model._execution = replace(self._execution, precision="fp32")
        return model

    def run(self, *batches: list[Frame], **arguments: Any) -> list[Flow]:
        """Call the network once."""
        height, width = batches[0][0].shape[:2]
        self.convention.fitted_size(height, width)
        with torch.no_grad(), reproducible(self._execution.threads):
            images = [fitted_images(frames, self.convention, self.device) for frames in batches]
            with torch.autocast(self.device.type, torch.bfloat16, enabled=self._execution.precision == "bf16"):
                flow = self._ask(images, arguments, height, width)
            flow = unfitted_flow(flow.float(), self.convention, height, width)
            return list(flow.permute(0, 2, 3, 1).contiguous().cpu().numpy())

    def _ask(self, images: list[Tensor], arguments: dict[str, Any], height: int, width: int) -> Tensor:
        try:
            flow: Tensor = self._call(*images, **arguments)
        except RobustFlowError:
            raise
        except Exception as error:
            advice = "many networks fail on small frames, so try larger ones"
            if isinstance(error, torch.OutOfMemoryError):
                advice = "predict fewer pairs at once, in tiles (option tile), or on the CPU"
            reason = f"{class_and_message(error)}{traceback_hint(error)}"
            raise ModelError(
                f"{height}x{width}", f"model '{self.name}' fails on such frames ({reason}); {advice}"
            ) from error
        return flow


class ConfidentNetwork(NetworkModel):
    """A network that, called with `confidence=True`, returns the flow and a confidence, (N, 3, H, W)."""

    def predict_with_confidence(self, frame1: Frame, frame2: Frame) -> tuple[Flow, npt.NDArray[np.float32]]:
        """Predict as in `ConfidentModel.predict_with_confidence`."""
        check_pair(frame1, frame2)
        (answer,) = self.run([frame1], [frame2], confidence=True)
        return answer[..., :2], answer[..., 2]


def find_device(name: str) -> torch.device:
    """Return the torch device for a name."""
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
    except (RuntimeError, TypeError):
        device = torch.device("meta")
    if device.type == "meta":  # torch's device for tensors without values
        raise unknown_name("device", str(name), ("auto", "cpu", "cuda", "cuda:0")) from None
    try:
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        raise ModelError(name, f"torch cannot use this device here ({first_line(error)}); use cpu or auto") from None
    return device


class TorchClipModel:
    """A multi-frame network; satisfies `ClipModel`."""

    def __init__(self, network: NetworkModel, window: Window) -> None:
        self.window = window
        self._network = network

    @property
    def name(self) -> str:
        """The model's name."""
        return self._network.name

    @property
    def net(self) -> torch.nn.Module:
        """The network."""
        return self._network.net

    @property
    def device(self) -> torch.device:
        """The network's device."""
        return self._network.device

    def identity(self) -> dict[str, Any]:
        """Return the identity of the network. The window is only part of a run's identity if it is used."""
        return self._network.identity()

    def predict_clip(self, frames: Sequence[Frame], index: int) -> Flow:
        """Predict a flow as in `ClipModel.predict_clip`."""
        for frame in frames:
            check_pair(frames[0], frame)
        if not 0 <= index < len(frames) - 1:
            raise UsageError("index", f"{len(frames)} frames contain no pair at index {index}")
        return self._network.run(*([frame] for frame in frames), index=index)[0]


class TorchStreamModel(TorchClipModel):
    """A multi-frame network that can also predict from two frames; also satisfies `FlowModel`."""

    def predict(self, frame1: Frame, frame2: Frame) -> Flow:
        """Predict a flow as in `FlowModel.predict`, treating the pair as the first of a sequence."""
        return self.predict_clip((frame1, frame2), 0)


def _at_least_single(values: Tensor) -> Tensor:
    return values if values.dtype == torch.float64 else values.float()


def resize(maps: Tensor, size: tuple[int, int]) -> Tensor:
    """Resize maps (N, C, H, W) bilinearly, with aligned corner pixels, to float32 (N, C, *size)."""
    return F.interpolate(_at_least_single(maps), size=size, mode="bilinear", align_corners=True)


def resize_flow(flow: Tensor, size: tuple[int, int]) -> Tensor:
    """Resize a flow (N, 2, H, W) to (N, 2, *size), and scale u and v by the ratios of the sizes."""
    ratios = flow.new_tensor([size[1] / flow.shape[3], size[0] / flow.shape[2]], dtype=torch.float32)
    return resize(flow, size) * ratios.view(1, 2, 1, 1)


def fitted_images(frames: Sequence[Frame], convention: InputConvention, device: torch.device) -> Tensor:
    """Convert RGB uint8 frames (H, W, 3) of equal size to the input of a network, float32 (N, 3, H', W').

    >>> frame = np.full((3, 5, 3), 255, np.uint8)
    >>> fitted_images([frame], InputConvention(fit="pad", multiple=4), torch.device("cpu")).shape
    torch.Size([1, 3, 4, 8])
    """
    values = torch.from_numpy(np.stack(list(frames))).to(device).permute(0, 3, 1, 2).float()
    return fitted_values(values, convention)


def fitted_values(values: Tensor, convention: InputConvention) -> Tensor:
    """Convert RGB images in 0..255, float32 (N, 3, H, W), to the input of a network, float32 (N, 3, H', W')."""
    if convention.order == "bgr":
        values = values.flip(1)
    mean = values.new_tensor(convention.mean).view(1, 3, 1, 1)
    scale = convention.scale
    images = (values - mean) * (scale if isinstance(scale, float) else values.new_tensor(scale).view(1, 3, 1, 1))
    if convention.fit == "pad":
        mode = "replicate" if convention.padding == "replicate" else "constant"
        return F.pad(images, convention.padding_sides(*images.shape[2:]), mode=mode)
    if convention.fit == "stretch":
        size = convention.fitted_size(*images.shape[2:])
        return F.interpolate(images, size=size, mode="bilinear", align_corners=False)
    return images


def unfitted_flow(flow: Tensor, convention: InputConvention, height: int, width: int) -> Tensor:
    """Convert a network's flow (N, 2, H', W') to the frames' size, (N, 2, height, width)."""
    if convention.fit == "pad":
        left, _, above, _ = convention.padding_sides(height, width)
        return flow[:, :, above : above + height, left : left + width]
    if convention.fit == "stretch":
        return resize_flow(flow, (height, width))
    return flow


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
