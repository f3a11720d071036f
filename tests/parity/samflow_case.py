"""What the packs of all SAMFlow sizes have in common."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from robustflow.models.networks.samflow import SamFlow

from .pack import Pack


def check_case(pack: Pack, net: SamFlow, case: str, suffix: str = "") -> None:
    """Compare every array of a case, from the first features to the flow, in one run of the network."""
    expected = pack.expected(case, suffix)
    image1, image2 = (pack.image(f"{case}_im{i}") for i in (1, 2))
    with watching(net) as found:
        flows, eighth = net.flows(image1, image2)
    for name in sorted(set(found) & set(expected)):
        part = tuple(slice(size) for size in expected[name].shape)
        pack.check_features(f"{case}{suffix} {name}", found[name][part], expected[name])
    step = image1.shape[-1] // expected["flow"].shape[-1]  # some are stored as every second row and column
    pack.check_flow(f"{case}{suffix} flow", flows[-1][..., ::step, ::step], expected["flow"])
    if "flow_eighth" in expected:
        pack.check_flow(f"{case} flow_eighth", eighth, expected["flow_eighth"])


@contextmanager
def watching(net: SamFlow) -> Iterator[dict[str, torch.Tensor]]:
    """What the parts give while the network runs, by the packs' names."""
    found: dict[str, torch.Tensor] = {}
    parts = {
        "sam_feat_ch0to15": net.sam_encoder,
        "feat_encoder_im1_ch0to7": net.memory_encoder.feat_encoder,
        "cfm_ch0to7": net.CFM,
        "cam_ch0to7": net.CAM,
        "cost_memory_first64_tok": net.memory_encoder.cost_perceiver_encoder,
    }
    hooks = [
        part.register_forward_hook(lambda module, inputs, output, name=name: found.update({name: output}))
        for name, part in parts.items()
    ]
    try:
        yield found
    finally:
        for hook in hooks:
            hook.remove()


def check_24_iterations(pack: Pack, net: SamFlow, case: str) -> None:
    """Rounding grows with every iteration, and the pack's floor is for 12: measure it as the pack's README does, by
    noise of 0.0001 grey levels on image 1."""
    expected = pack.expected(case)["flow_24_iters"]
    image1, image2 = (pack.image(f"{case}_im{i}") for i in (1, 2))
    noise = 1e-4 * torch.randn(image1.shape, generator=torch.Generator().manual_seed(0))
    before, net.iterations = net.iterations, 24
    try:
        flow, shaken = net(image1, image2)[..., ::4, ::4], net(image1 + noise, image2)[..., ::4, ::4]
    finally:
        net.iterations = before
    change = (flow - shaken).abs()
    pack.check_flow(f"{case} flow_24_iters", flow, expected, (float(change.max()), float(change.mean())))
