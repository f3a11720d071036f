"""Resize a flow and scale its values accordingly. Convert frames to a network's input, and resize the network's
flow to the frames.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from ...core.types import Frame
from ..conventions import InputConvention


def resize(maps: Tensor, size: tuple[int, int]) -> Tensor:
    """Resize maps (N, C, H, W) bilinearly, with aligned corner pixels, to float32 (N, C, *size)."""
    return F.interpolate(maps.float(), size=size, mode="bilinear", align_corners=True)


def resize_flow(flow: Tensor, size: tuple[int, int]) -> Tensor:
    """Resize a flow (N, 2, H, W) to (N, 2, *size), and multiply u by the ratio of the widths and v by the ratio of the
    heights.
    """
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
