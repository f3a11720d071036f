"""The smooth network of the parity packs, models with a known gradient, and attacks with few steps on a small pair."""

import numpy as np
import torch
from torch import nn

import robustflow as rf
from robustflow.attacks.registry import SHIPPED


class SmoothNet(nn.Module):
    """Maps two images (N, 3, H, W) in 0..1 to a flow (N, 2, H, W): three tanh convolutions and a linear one."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(6, 12, 5, padding=2)
        self.conv2 = nn.Conv2d(12, 12, 5, padding=4, dilation=2)
        self.conv3 = nn.Conv2d(12, 12, 5, padding=8, dilation=4)
        self.head = nn.Conv2d(12, 2, 5, padding=2)

    def forward(self, image1, image2):
        hidden = torch.cat([image1, image2], dim=1) - 0.5
        for layer in (self.conv1, self.conv2, self.conv3):
            hidden = torch.tanh(layer(hidden))
        return 12 * self.head(hidden)


class Given:
    """A differentiable two-frame model defined by a function of images in 0..1."""

    def __init__(self, function) -> None:
        self.function = function

    def differentiable(self, images1, images2):
        return self.function(images1, images2)

    def predict(self, frame1, frame2):
        images = [torch.from_numpy(frame).permute(2, 0, 1)[None].float() / 255 for frame in (frame1, frame2)]
        with torch.no_grad():
            return self.function(*images)[0].permute(1, 2, 0).contiguous().numpy()


def linear_model(seed: int = 0) -> Given:
    """u = 100 px plus a weighted sum of a pixel's values in both frames, v = 0; for frames of 8 x 10 pixels."""
    weights = torch.from_numpy(np.random.default_rng(seed).normal(size=(2, 3, 8, 10)).astype(np.float32))

    def flow(images1, images2):
        u = (weights[0] * images1).sum(dim=1) + (weights[1] * images2).sum(dim=1) + 100
        return torch.stack([u, torch.zeros_like(u)], dim=1)

    model = Given(flow)
    model.weights = weights.numpy()
    return model


def smooth_model() -> Given:
    """The network with seeded weights of the same scale as in the packs."""
    net, rng = SmoothNet().requires_grad_(False), np.random.default_rng(3)
    for name, value in net.named_parameters():
        scale = 1.4 / np.sqrt(np.prod(value.shape[1:])) if name.endswith("weight") else 0.03
        value.copy_(torch.from_numpy(scale * rng.standard_normal(value.shape)))
    return Given(net)


def random_pair(height: int = 8, width: int = 10, seed: int = 0):
    """Return two frames of noise, RGB uint8, with a few black and white values."""
    rng = np.random.default_rng(seed)
    return tuple(np.clip(rng.integers(-4, 260, (2, height, width, 3)), 0, 255).astype(np.uint8))


FEW = {
    "pgd": {"steps": 4, "starts": 1},
    "bim": {"steps": 4},
    "cospgd": {"steps": 4, "starts": 1},
    "apgd": {"steps": 12, "starts": 1},
    "pcfa": {"steps": 2},
    "square": {"queries": 30},
    "transfer": {"on": smooth_model(), "attack": "pgd", "steps": 4, "starts": 1},
    "worst_of": {"parts": "fgsm+square", "queries": 30},
}
"""Options that make an attack fast."""
ON_SMALL_PAIRS = [name for name in SHIPPED if name not in ("random_patch", "patch", "universal")]
"""Attacks that need no training samples and work on very small frames."""
TRUTH = np.zeros((8, 10, 2), np.float32)


def attacked_pair(name: str, model=None, severity: int = 4, seed: int = 0, **options):
    pair, options = random_pair(), {**FEW.get(name, {}), **options}
    return pair, rf.attack(*pair, model or smooth_model(), name, severity, flow=TRUTH, seed=seed, **options)
