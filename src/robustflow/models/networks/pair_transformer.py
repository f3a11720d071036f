"""The feature transformer of FlowDiffuser: self-attention in shifted windows within each image, then cross-attention
between the images.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .blocks.attention import attend, from_windows, to_windows

_WIDTH, _WINDOW = 256, 8


def mask_bias(labels: Tensor) -> Tensor:
    """Return a bias of -100 for the logits of token pairs with different labels: (..., N, N) for labels (..., N)."""
    return (labels[..., :, None] != labels[..., None, :]).to(torch.float32) * -100


class Attention(nn.Module):
    """Single-head attention."""

    def __init__(self) -> None:
        super().__init__()
        self.q = nn.Linear(_WIDTH, _WIDTH)
        self.k = nn.Linear(_WIDTH, _WIDTH)
        self.v = nn.Linear(_WIDTH, _WIDTH)
        self.proj = nn.Linear(_WIDTH, _WIDTH)

    def forward(self, x: Tensor, other: Tensor, bias: Tensor) -> Tensor:
        """Map tokens (..., N, 256), which attend to (..., M, 256), to the same shape."""
        return self.proj(attend(self.q(x), self.k(other), self.v(other), bias=bias.to(x.dtype)))


def _mlp() -> nn.Sequential:
    return nn.Sequential(nn.Linear(_WIDTH, 4 * _WIDTH), nn.GELU(), nn.Linear(4 * _WIDTH, _WIDTH))


class WindowBlock(nn.Module):
    """Self-attention in windows of 8 x 8."""

    def __init__(self, shift: int) -> None:
        super().__init__()
        self.shift = shift
        self.layer_norm1 = nn.LayerNorm(_WIDTH)
        self.layer_norm2 = nn.LayerNorm(_WIDTH)
        self.self_attn = Attention()
        self.mlp = _mlp()

    def forward(self, x: Tensor, labels: Tensor) -> Tensor:
        """Update a map (N, H, W, 256), H and W multiples of 8; pixels with different `labels` (H, W) do not attend to
        each other.
        """
        height, width = labels.shape
        if self.shift:
            # The shift also puts pixels from opposite edges into one window; these must not attend to each other.
            y, x_ = (torch.arange(size, device=x.device) for size in (height, width))
            wrapped = 2 * (y < self.shift).long()[:, None] + (x_ < self.shift).long()
            labels = 4 * labels + wrapped
        roll = (-self.shift, -self.shift)
        windows = to_windows(self.layer_norm1(x).roll(roll, (1, 2)), _WINDOW)
        bias = mask_bias(to_windows(labels.roll(roll, (0, 1))[None, ..., None], _WINDOW)[..., 0])[:, :, None]
        mixed = from_windows(self.self_attn(windows, windows, bias), height, width)
        x = x + mixed.roll((self.shift, self.shift), (1, 2))
        return x + self.mlp(self.layer_norm2(x))


class CrossBlock(nn.Module):
    """Global cross-attention from one image to the other."""

    def __init__(self) -> None:
        super().__init__()
        self.layer_norm1 = nn.LayerNorm(_WIDTH)
        self.layer_norm2 = nn.LayerNorm(_WIDTH)
        self.layer_norm3 = nn.LayerNorm(_WIDTH)
        self.cross_attn = Attention()
        self.mlp = _mlp()

    def forward(self, x: Tensor, other: Tensor, bias: Tensor) -> Tensor:
        """Update tokens (N, H * W, 256) by attention to those of the second image, with `bias` (H * W, H * W) added to
        the logits.
        """
        x = x + self.cross_attn(self.layer_norm1(x), self.layer_norm2(other), bias)
        return x + self.mlp(self.layer_norm3(x))


class Layer(nn.Module):
    """A layer of two window blocks and, in the first layer only, a cross-attention block."""

    def __init__(self, cross: bool) -> None:
        super().__init__()
        self.blocks = nn.ModuleList((WindowBlock(0), WindowBlock(_WINDOW // 2)))
        if cross:
            self.cross_transformer = CrossBlock()

    def forward(self, x: Tensor, labels: Tensor) -> Tensor:
        """Update the features of images 1 and 2, stacked along the batch axis, (2 * N, H, W, 256)."""
        for block in self.blocks:
            x = block(x, labels)
        if not hasattr(self, "cross_transformer"):
            return x
        first, second = x.flatten(1, 2).chunk(2)
        bias = mask_bias(labels.flatten())
        # The block already contains residuals; the published model adds another one around the block.
        second = second + self.cross_transformer(second, first, bias)
        first = first + self.cross_transformer(first, second, bias)
        return torch.cat((first, second)).view(x.shape)


class PairTransformer(nn.Module):
    """The transformer that enhances the features of both images by attention between the images."""

    def __init__(self) -> None:
        super().__init__()
        self.tb = nn.ModuleDict({"blocks": nn.ModuleList((Layer(cross=True), Layer(cross=False)))})

    def forward(self, features1: Tensor, features2: Tensor) -> tuple[Tensor, Tensor]:
        """Update features (N, 256, H, W) of any size; they are padded at the top and on both sides to a multiple of the
        window size, and masked.
        """
        _, _, height, width = features1.shape
        over_x, over_y = -width % _WINDOW, -height % _WINDOW
        left = over_x // 2
        x = torch.cat((features1, features2)).permute(0, 2, 3, 1)
        x = F.pad(x, (0, 0, left, over_x - left, over_y, 0))
        labels = torch.ones(x.shape[1:3], dtype=torch.long, device=x.device)
        labels[over_y:, left : left + width] = 0
        for layer in self.tb["blocks"]:
            x = layer(x, labels)
        x = x[:, over_y:, left : left + width].permute(0, 3, 1, 2)
        return x.chunk(2)
