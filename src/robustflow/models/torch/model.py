"""Run a network reproducibly. Use a PyTorch network as a flow model: the adapter handles the input images, the
output flow, the device and the precision. A multi-frame PyTorch network as a flow model.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from ...core.errors import ModelError, RobustFlowError, UsageError, first_line
from ...core.types import Flow, Frame
from ..conventions import InputConvention
from ..devices import Execution, traceback_hint
from ..pairs import PairNetwork, check_pair
from ..window import Window
from .fit import fitted_images, fitted_values, unfitted_flow

# Since PyTorch 2.9, precision is set per backend; the older functions, needed before 2.9, cannot report these settings.
_PER_BACKEND = hasattr(torch.backends.cuda.matmul, "fp32_precision")
_MATMULS: tuple[Any, ...] = (torch.backends.cuda.matmul, torch.backends.mkldnn.matmul) if _PER_BACKEND else ()
_IEEE: dict[str, Any] = {"fp32_precision": "ieee"} if _PER_BACKEND else {}


@contextmanager
def reproducible(threads: int = 1) -> Iterator[None]:
    """Run a block with true float32 (no TF32), deterministic algorithms and a fixed number of CPU threads, then restore
    the previous settings.
    """
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
        """Return everything that affects the results: the network's settings, its input convention, and the execution
        settings.
        """
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
        """Compute the flow as described in `Differentiable`."""
        height, width = images1.shape[2:]
        self.convention.fitted_size(height, width)
        values = (255 * image.to(self.device) for image in (images1, images2))
        fitted = [fitted_values(value, self.convention) for value in values]
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self._execution.precision == "bf16"):
            flow = self._ask(fitted, {}, height, width)
        return unfitted_flow(flow.float(), self.convention, height, width)

    def run(self, *batches: list[Frame], **arguments: Any) -> list[Flow]:
        """Call the network once."""
        height, width = batches[0][0].shape[:2]
        self.convention.fitted_size(height, width)
        with torch.inference_mode(), reproducible(self._execution.threads):
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
            message = " ".join(str(error).split())
            raise ModelError(
                f"model '{self.name}' fails on frames of {height}x{width} ({type(error).__name__}: {message}"
                f"{traceback_hint(error)}); {advice}"
            ) from error
        return flow


class ConfidentNetwork(NetworkModel):
    """A network that, called with `confidence=True`, returns the flow and a confidence for each pixel, (N, 3, H, W).
    Satisfies `ConfidentModel`.
    """

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
        raise UsageError(f"unknown device '{name}': use auto, cpu, cuda or cuda:0") from None
    try:
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        raise ModelError(
            f"torch cannot use a device '{name}' on this machine ({first_line(error)}); use cpu or auto"
        ) from None
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
            raise UsageError(f"{len(frames)} frames contain no pair at index {index}")
        return self._network.run(*([frame] for frame in frames), index=index)[0]


class TorchStreamModel(TorchClipModel):
    """A multi-frame network that can also predict from two frames; also satisfies `FlowModel`."""

    def predict(self, frame1: Frame, frame2: Frame) -> Flow:
        """Predict a flow as in `FlowModel.predict`, treating the pair as the first of a sequence."""
        return self.predict_clip((frame1, frame2), 0)
