"""FLAVR: interpolate frames from four neighbouring frames (Kalluri et al., WACV 2023; used in the paper)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ...core.errors import UsageError
from ...core.files import sha256_of_file
from ...core.types import Frame
from ...models.torch.checkpoint import load_weights, read_checkpoint
from ...models.torch.network_model import find_device


class Gate(nn.Module):
    """Multiplies each channel by a weight computed from the channel means. Keys: `attn_layer.0`."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.attn_layer = nn.Sequential(nn.Conv3d(channels, channels, 1), nn.Sigmoid())

    def forward(self, x: Tensor) -> Tensor:
        return x * self.attn_layer(x.mean(dim=(2, 3, 4), keepdim=True))


class BasicBlock(nn.Module):
    """A residual block of two 3 x 3 x 3 convolutions and a gate. Keys: `conv1.0 conv2.0 fg` and `downsample.0`."""

    def __init__(self, inputs: int, outputs: int, stride: int, bias: bool) -> None:
        super().__init__()
        steps = (1, stride, stride)
        self.conv1 = nn.Sequential(nn.Conv3d(inputs, outputs, 3, steps, padding=1, bias=bias), nn.ReLU())
        self.conv2 = nn.Sequential(nn.Conv3d(outputs, outputs, 3, padding=1, bias=bias))
        self.fg = Gate(outputs)
        self.downsample = None
        if stride > 1 or inputs != outputs:
            self.downsample = nn.Sequential(nn.Conv3d(inputs, outputs, 1, steps, bias=False))

    def forward(self, x: Tensor) -> Tensor:
        shortcut = x if self.downsample is None else self.downsample(x)
        return F.relu(self.fg(self.conv2(self.conv1(x))) + shortcut)


class ResNet18(nn.Module):
    """A 3D ResNet-18. Keys: `stem.0`, `layer<1..4>.<0|1>.*`."""

    def __init__(self, bias: bool) -> None:
        super().__init__()
        self.stem = nn.Sequential(nn.Conv3d(3, 64, (3, 7, 7), (1, 2, 2), (1, 3, 3), bias=bias), nn.ReLU())
        self.layer1 = nn.Sequential(BasicBlock(64, 64, 1, bias), BasicBlock(64, 64, 1, bias))
        self.layer2 = nn.Sequential(BasicBlock(64, 128, 2, bias), BasicBlock(128, 128, 1, bias))
        self.layer3 = nn.Sequential(BasicBlock(128, 256, 2, bias), BasicBlock(256, 256, 1, bias))
        self.layer4 = nn.Sequential(BasicBlock(256, 512, 1, bias), BasicBlock(512, 512, 1, bias))

    def forward(self, clip: Tensor) -> list[Tensor]:
        maps = [self.stem(clip)]
        for layer in (self.layer1, self.layer2, self.layer3, self.layer4):
            maps.append(layer(maps[-1]))
        return maps


class Widen(nn.Module):
    """A decoder step that doubles height and width. Keys: `upconv.0`, `upconv.1` (a gate)."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        up = nn.ConvTranspose3d(inputs, outputs, (3, 4, 4), stride=(1, 2, 2), padding=1)
        self.upconv = nn.Sequential(up, Gate(outputs))

    def forward(self, x: Tensor) -> Tensor:
        return F.leaky_relu(self.upconv(x), 0.2)


class Refine(nn.Module):
    """A decoder step that keeps the size. Keys: `conv.0`, `conv.1` (a gate)."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.conv = nn.Sequential(nn.Conv3d(inputs, outputs, 3, padding=1), Gate(outputs))

    def forward(self, x: Tensor) -> Tensor:
        return F.leaky_relu(self.conv(x), 0.2)


class Fuse(nn.Module):
    """Fuses the features of all frames at each pixel. Key: `conv.0`."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.conv = nn.Sequential(nn.Conv2d(inputs, outputs, 1, bias=False))

    def forward(self, x: Tensor) -> Tensor:
        return F.leaky_relu(self.conv(x.transpose(1, 2).flatten(1, 2)), 0.2)


class FLAVR(nn.Module):
    """A flow-free 3D U-Net that predicts `n_outputs` frames between the second and third of four input frames."""

    def __init__(self, n_outputs: int = 3) -> None:
        super().__init__()
        # In the authors' code, the encoder has biases only if the network predicts several frames.
        self.encoder = ResNet18(bias=n_outputs > 1)
        self.decoder = nn.Sequential(Refine(512, 256), Widen(512, 128), Widen(256, 64), Refine(128, 64), Widen(128, 64))
        self.feature_fuse = Fuse(4 * 64, 64)
        self.outconv = nn.Sequential(nn.ReflectionPad2d(3), nn.Conv2d(64, 3 * n_outputs, 7))

    def forward(self, frames: Sequence[Tensor]) -> list[Tensor]:
        clip = torch.stack(tuple(frames), dim=2)
        mean = clip.mean(dim=(2, 3, 4), keepdim=True)
        *skips, x = self.encoder(clip - mean)
        for i, step in enumerate(self.decoder):
            x = step(x)
            if i < len(skips):
                x = torch.cat((x, skips[-1 - i]), dim=1)
        between = self.outconv(self.feature_fuse(x)).split(3, dim=1)
        return [frame + mean[:, :, 0] for frame in between]


def load_flavr(checkpoint: str | Path, device: str = "cpu") -> FLAVR:
    net = FLAVR()
    load_weights(net, read_checkpoint(checkpoint), "flavr (4x)")
    return net.to(find_device(device)).eval().requires_grad_(False)


MULTIPLE = 8
"""Height and width must be multiples of this number; other sizes are padded by repeating the border, and cropped
again.
"""


class FlavrInterpolator:
    """The interpolator "flavr", 4x (Kalluri et al., WACV 2023; used in the paper). Requires the extra `torch`."""

    name = "flavr"

    def __init__(self, checkpoint: Path, device: str = "cpu") -> None:
        self._model = load_flavr(checkpoint, device)
        self._device = device
        self._sha256 = sha256_of_file(checkpoint)

    def between(self, window: Sequence[Frame], factor: int) -> list[Frame]:
        if factor != 4:
            raise UsageError("--factor", f"FLAVR's weights do not support {factor}; use 4, or --interpolator flow")
        height, width = window[0].shape[:2]
        pad = ((0, -height % MULTIPLE), (0, -width % MULTIPLE), (0, 0))
        tensors = [
            torch.from_numpy(np.pad(frame, pad, mode="edge")).permute(2, 0, 1)[None].to(self._device).float() / 255
            for frame in window
        ]
        with torch.inference_mode():
            outputs = self._model(tensors)
        return [self._frame(output)[:height, :width] for output in outputs]

    def describe(self) -> dict[str, Any]:
        about = {"name": self.name, "checkpoint_sha256": self._sha256, "torch": torch.__version__}
        return about | {"device": self._device}

    @staticmethod
    def _frame(output: Tensor) -> Frame:
        scaled = (output[0] * 255).clamp(0, 255).round().permute(1, 2, 0)
        return np.ascontiguousarray(scaled.to("cpu").numpy().astype(np.uint8))
