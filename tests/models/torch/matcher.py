"""A small matching network trained on BGR in -1..1, so that different conventions reduce its accuracy.

`matcher.npz` contains its weights after 120 steps of Adam (3e-3) on `shifted_pair(100)` to `shifted_pair(219)` at
48x64.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

REACH = 7


class Matcher(nn.Module):
    """Correlate the features of every pixel with those around its position in the second image, and return the soft
    argmax.
    """

    def __init__(self) -> None:
        super().__init__()
        self.f = nn.Sequential(nn.Conv2d(3, 16, 5, padding=2), nn.ReLU(), nn.Conv2d(16, 16, 5, padding=2))
        self.t = nn.Parameter(torch.tensor(3.0))

    def forward(self, image1, image2):
        first, second = (F.normalize(self.f(image), dim=1) for image in (image1, image2))
        height, width = first.shape[2:]
        around, side = F.pad(second, (REACH,) * 4), 2 * REACH + 1
        offsets = [(dy, dx) for dy in range(side) for dx in range(side)]
        cost = torch.stack([(first * around[:, :, y : y + height, x : x + width]).sum(1) for y, x in offsets], 1)
        weights = (F.avg_pool2d(cost, 5, 1, 2) * self.t.exp()).softmax(1)
        places = torch.tensor(offsets, dtype=weights.dtype) - REACH
        return torch.einsum("nkhw,kc->nchw", weights, places.flip(1))


def trained_matcher():
    """The network with the trained weights."""
    net = Matcher()
    with np.load(Path(__file__).with_name("matcher.npz")) as weights:
        net.load_state_dict({key: torch.from_numpy(weights[key].astype(np.float32)) for key in weights.files})
    return net
