"""FlowDiffuser (Luo et al., CVPR 2024): flow denoised from Gaussian noise by a recurrent decoder, refined at 1/4."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ..blocks.allpairs import CorrelationPyramid, pixel_grid
from ..blocks.convex_upsample import convex_upsample
from ..blocks.twins import Twins
from .denoiser import Denoiser
from .diffusion import initial_noise, register_schedule, renoise, sampling_times
from .pair_transformer import PairTransformer
from .sk_update import MaskHead, SkUpdate
from .window_volume import WindowVolume

_ITERATIONS = 6


class FlowDiffuser(nn.Module):
    """The published model; keys are those of the authors' checkpoints.

    The number of steps is part of the method: four of denoising with six iterations each, then six at 1/4.

    Args:
        seed: of the noise where none is given.
    """

    def __init__(self, seed: int = 0) -> None:
        super().__init__()
        self.seed = seed
        # Constants that the checkpoints hold: a placeholder, and the factor between normalised flow and sample.
        self.zero = nn.Parameter(torch.zeros(12), requires_grad=False)
        self.scale = nn.Parameter(torch.full((1,), 0.5), requires_grad=False)
        register_schedule(self)
        self.fnet = Twins(large=True)
        self.cnet = Twins(large=False)
        self.trans = PairTransformer()
        self.C_inp = nn.Conv2d(128, 128, 1)
        self.C_net = nn.Conv2d(128, 128, 1)
        self.update = SkUpdate()
        self.um8 = MaskHead(8)
        self.um4 = MaskHead(4)
        self.update_dfm = Denoiser()

    def encode(self, encoder: Twins, image: Tensor) -> tuple[Tensor, Tensor]:
        """Features at 1/8 and at 1/4: the second stage runs twice with the same weights."""
        quarter = encoder.stage(0, image)
        return encoder.stage(1, quarter), encoder.stage(1, quarter, dense=True)

    def forward(self, image1: Tensor, image2: Tensor, noise: Tensor | None = None) -> Tensor:
        """The flow from image 1 to image 2, (N, 2, H, W) in pixels; arguments as for `flows`."""
        return self.flows(image1, image2, noise)[0][-1]

    def flows(self, image1: Tensor, image2: Tensor, noise: Tensor | None = None) -> tuple[list[Tensor], Tensor]:
        """The flow after each denoising step and after the refinement.

        Args:
            image1: RGB (N, 3, H, W) in 0..255; H and W multiples of 8.
            image2: the same.
            noise: (N, 2, H / 8, W / 8), from the standard normal distribution, the only randomness; without it
                `initial_noise` of the seed, the same for every pair of one size.

        Returns:
            full-resolution flows (N, 2, H, W) in pixels, after each denoising step and after the refinement; and the
            flow at 1/4 (N, 2, H / 4, W / 4), in its own pixels.
        """
        image1, image2 = 2 * image1 / 255 - 1, 2 * image2 / 255 - 1
        features8, features4 = self.encode(self.fnet, torch.cat((image1, image2)))
        context8, context4 = self.encode(self.cnet, image1)
        features1, features2 = features8.chunk(2)
        pyramid = CorrelationPyramid(*self.trans(features1, features2))
        if noise is None:
            noise = initial_noise(self.seed, *context8.shape[2:]).to(image1.device).expand(len(image1), -1, -1, -1)
        net, start, target, flows = self._denoise(pyramid, context8, noise)
        fine, quarter = self._refine(features4, context4, net, target - start)
        return [*flows, fine], quarter

    def _denoise(
        self, pyramid: CorrelationPyramid, context: Tensor, noise: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, list[Tensor]]:
        inp, net = self.C_inp(context), self.C_net(context)
        attention = self.update.aggregator.attention(inp)
        start = target = pixel_grid(context)
        size = target.new_tensor((context.shape[3], context.shape[2]))[:, None, None]
        times = sampling_times()
        sample, flows = noise, []
        for step, time in enumerate(times):
            shift = sample.clamp(-1, 1).to(target.dtype) * 0.1 * size
            target = target + (shift if step == 0 else 0.2 * shift)
            for iteration in range(_ITERATIONS):
                target = target.detach()
                correlation = pyramid.lookup(target)
                moment = int(time - time / _ITERATIONS * iteration)
                net = self.update_dfm(self.update, net, inp, correlation, target - start, attention, moment)
                target = target + self.update.flow_head(net)
            flows.append(convex_upsample(target - start, self.um8(net)))
            clean = (self.scale * (target - start) / size).clamp(-0.5, 0.5)
            following = times[step + 1] if step + 1 < len(times) else -1
            sample = renoise(sample, clean, self.alphas_cumprod[time], self.alphas_cumprod[following])
        return net, start, target, flows

    def _refine(self, features: Tensor, context: Tensor, net: Tensor, flow: Tensor) -> tuple[Tensor, Tensor]:
        enlarge = {"size": context.shape[2:], "mode": "bilinear", "align_corners": True}
        flow, net = F.interpolate(2 * flow, **enlarge), F.interpolate(net, **enlarge)
        start = pixel_grid(context)
        target = start + flow
        features1, features2 = features.chunk(2)
        volume = WindowVolume(features1, features2, target)
        for _ in range(_ITERATIONS):
            target = target.detach()
            motion = self.update.encoder(target - start, volume.lookup(target))
            net = self.update(net, context, motion, motion)
            target = target + self.update.flow_head(net)
        return convex_upsample(target - start, self.um4(net), factor=4), target - start
