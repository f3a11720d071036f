"""Use a PyTorch network as a flow model: the adapter handles the input images, the output flow, the device and the
precision.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from ...errors import ModelError, RobustFlowError, UsageError, first_line
from ...sample import Flow, Frame
from ..execution import Execution
from ..input_convention import InputConvention
from ..pairs import PairNetwork, check_pair
from ..traceback_hint import traceback_hint
from .fit import fitted_images, fitted_values, unfitted_flow
from .reproducible import reproducible


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
