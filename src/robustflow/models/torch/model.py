"""A PyTorch network as a flow model: the adapter owns the images' way in, the flow's way out, device and precision."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ...errors import ModelError, RobustFlowError, UsageError, unknown_name
from ...sample import Flow, Frame
from ..input_convention import InputConvention
from ..option_checks import check_count, check_switch
from ..own.blocks.resize import resize_flow
from ..pairs import predict_by_size
from .reproducible import reproducible

PRECISIONS = ("fp32", "bf16")


class TorchModel:
    """Satisfies `FlowModel`.

    Args:
        name: of the model.
        net: two images (N, 3, H, W) to one flow (N, 2, H, W) in pixels; put into evaluation mode here.
        convention: how the network wants its images.
        settings: what else changes its numbers (checkpoint hash, iterations), for `identity`.
        device: "auto" (a CUDA device where there is one, else the CPU), "cpu", "cuda", "cuda:1", ...
        precision: "fp32" (without TF32) or "bf16" (automatic mixed precision).
        compile: compile the network with `torch.compile` on its first call.
        threads: of the CPU. One by default: more can change the last bits of a result, and runs use more processes.

    Raises:
        UsageError: an unknown device or precision.
        ModelError: a device this machine does not have.
    """

    def __init__(
        self,
        name: str,
        net: nn.Module,
        convention: InputConvention,
        settings: Mapping[str, Any],
        *,
        device: str = "auto",
        precision: Literal["fp32", "bf16"] = "fp32",
        compile: bool = False,
        threads: int = 1,
    ) -> None:
        if precision not in PRECISIONS:
            raise unknown_name("precision", str(precision), PRECISIONS)
        check_count("threads", threads)
        check_switch("compile", compile)
        self.name = name
        self.convention = convention
        self.device = find_device(device)
        self.net = net.to(self.device).eval().requires_grad_(False)
        self._settings = dict(settings)
        self._precision = precision
        self._compile = compile
        self._threads = threads
        self._call = torch.compile(self.net) if compile else self.net

    def identity(self) -> dict[str, Any]:
        """What changes the numbers: the network's settings, its input, and how it is executed."""
        return {
            "name": self.name,
            **self._settings,
            "input": self.convention.describe(),
            "device": self.device.type,
            "precision": self._precision,
            "compile": self._compile,
            "threads": self._threads,
            "torch": torch.__version__,
        }

    def predict(self, frame1: Frame, frame2: Frame) -> Flow:
        """See `FlowModel.predict`."""
        return self.predict_batch([frame1], [frame2])[0]

    def predict_batch(self, frames1: Sequence[Frame], frames2: Sequence[Frame]) -> list[Flow]:
        """Flows of several pairs; on a GPU those of one size go through the network together.

        On the CPU each goes by itself: together they are no faster there, and change the last bits of each other's flow
        (up to 1e-4 px), because convolutions of another batch add up in another order.

        Args:
            frames1: RGB uint8 (H, W, 3) each, sizes may differ from pair to pair.
            frames2: as many, each of its first frame's size.

        Returns:
            float32 (H, W, 2) each, (u right, v down) in pixels.

        Raises:
            UsageError: frames that are no pairs of RGB uint8 images.
        """
        return predict_by_size(self._predict, frames1, frames2)

    def _predict(self, frames1: list[Frame], frames2: list[Frame]) -> list[Flow]:
        if self.device.type == "cpu":
            return [self.run([frame1], [frame2])[0] for frame1, frame2 in zip(frames1, frames2, strict=True)]
        return self.run(frames1, frames2)

    def run(self, *batches: list[Frame], **arguments: Any) -> list[Flow]:
        """One call of the network.

        Args:
            batches: of RGB uint8 frames of one size, one batch for each image that the network takes.
            arguments: what else it takes.

        Returns:
            A flow for each frame of a batch, as `predict` returns it.

        Raises:
            ModelError: frames of a size that the network cannot take, or the network fails on them.
        """
        height, width = batches[0][0].shape[:2]
        self.convention.fitted_size(height, width)
        with torch.inference_mode(), reproducible(self._threads):
            images = [self._images(frames) for frames in batches]
            with torch.autocast(self.device.type, torch.bfloat16, enabled=self._precision == "bf16"):
                flow = self._ask(images, arguments, height, width)
            flow = self._unfit(flow.float(), height, width)
            return list(flow.permute(0, 2, 3, 1).contiguous().cpu().numpy())

    def _ask(self, images: list[Tensor], arguments: dict[str, Any], height: int, width: int) -> Tensor:
        try:
            flow: Tensor = self._call(*images, **arguments)
        except RobustFlowError:
            raise
        except Exception as error:
            advice = "many networks fail on small frames: try larger ones"
            if isinstance(error, torch.OutOfMemoryError):
                advice = "predict fewer pairs at once, in tiles (option tile), or on the cpu"
            message = " ".join(str(error).split())
            raise ModelError(
                f"model '{self.name}' fails on frames of {height}x{width} ({type(error).__name__}: {message}); {advice}"
            ) from error
        return flow

    def _images(self, frames: list[Frame]) -> Tensor:
        values = torch.from_numpy(np.stack(frames)).to(self.device).permute(0, 3, 1, 2).float()
        if self.convention.order == "bgr":
            values = values.flip(1)
        mean = values.new_tensor(self.convention.mean).view(1, 3, 1, 1)
        scale = self.convention.scale
        images = (values - mean) * (scale if isinstance(scale, float) else values.new_tensor(scale).view(1, 3, 1, 1))
        if self.convention.fit == "pad":
            mode = "replicate" if self.convention.padding == "replicate" else "constant"
            return F.pad(images, self.convention.padding_sides(*images.shape[2:]), mode=mode)
        if self.convention.fit == "stretch":
            size = self.convention.fitted_size(*images.shape[2:])
            return F.interpolate(images, size=size, mode="bilinear", align_corners=False)
        return images

    def _unfit(self, flow: Tensor, height: int, width: int) -> Tensor:
        if self.convention.fit == "pad":
            left, _, above, _ = self.convention.padding_sides(height, width)
            return flow[:, :, above : above + height, left : left + width]
        if self.convention.fit == "stretch":
            return resize_flow(flow, (height, width))
        return flow


def find_device(name: str) -> torch.device:
    """The device of a name.

    >>> find_device("cpu").type
    'cpu'

    Raises:
        UsageError: no device's name.
        ModelError: this machine has no such device.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
    except (RuntimeError, TypeError):
        device = torch.device("meta")
    if device.type == "meta":  # torch's name for tensors without values
        raise UsageError(f"'{name}' is no device: give auto, cpu, cuda or cuda:0") from None
    try:
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        reason = next(iter(str(error).splitlines()), type(error).__name__)
        raise ModelError(
            f"this machine has no device '{name}' that torch can use ({reason}); give cpu or auto"
        ) from None
    return device
