"""FlowDiffuser, started from the original's noise, matches the outputs of the original implementation."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch
import torch.nn.functional as F

from robustflow.models.execution import Execution
from robustflow.models.networks.flowdiffuser import FlowDiffuser
from robustflow.models.networks.loaders import NETWORKS
from robustflow.models.torch.network_model import NetworkModel

from ..shared_data import shared_folder
from .pack import Pack

pytestmark = [pytest.mark.parity, pytest.mark.torch]
PACK = "flowdiffuser"


@pytest.fixture(scope="module")
def net():
    return Pack(shared_folder("parity", PACK)).fill(FlowDiffuser())


def test_features_and_steps_equal_the_original(pack, net, case):
    expected = pack.expected(case)
    height, width = pack.image(f"{case}_im1").shape[2:]
    sides = NETWORKS["flowdiffuser"].convention.padding_sides(height, width)
    images = [F.pad(pack.image(f"{case}_im{i}"), sides, mode="replicate") for i in (1, 2)]
    features8, features4 = net.encode(net.fnet, torch.cat([2 * image / 255 - 1 for image in images]))
    pack.check_features(f"{case} fnet8", features8[:1, :8], expected["fnet8_im1_ch0to7"])
    pack.check_features(f"{case} fnet4", features4[:1, :2], expected["fnet4_im1_ch0to1"])
    context8, _ = net.encode(net.cnet, 2 * images[0] / 255 - 1)
    pack.check_features(f"{case} cnet8", context8[:, :8], expected["cnet8_im1_ch0to7"])
    transformed, _ = net.trans(*features8.chunk(2))
    pack.check_features(f"{case} trans", transformed[:, :8], expected["trans_fmap1_ch0to7"])
    flows, quarter = net.flows(*images, torch.from_numpy(expected["noise"]))
    left, _, above, _ = sides
    flows = [flow[:, :, above : above + height, left : left + width] for flow in flows]
    for step in (0, 3):
        pack.check_flow(f"{case} flow_step{step}", flows[step][:, :, ::2, ::2], expected[f"flow_step{step}"])
    pack.check_flow(f"{case} flow", flows[-1], expected["flow"])
    pack.check_flow(f"{case} flow_low_quarter_res", quarter, expected["flow_low_quarter_res"])


class FromNoise(torch.nn.Module):
    """The network, started from given noise."""

    def __init__(self, net: FlowDiffuser, noise: np.ndarray) -> None:
        super().__init__()
        self.net = net
        self.noise = torch.from_numpy(noise)

    def forward(self, image1: torch.Tensor, image2: torch.Tensor) -> torch.Tensor:
        return self.net(image1, image2, self.noise.expand(len(image1), -1, -1, -1))


def test_the_adapter_pads_as_the_original_is_evaluated(pack, net, case):
    expected = pack.expected(case)
    if expected["flow"].shape[2] % 8 == expected["flow"].shape[3] % 8 == 0:
        pytest.skip("a case without padding")
    noisy, convention = FromNoise(net, expected["noise"]), NETWORKS["flowdiffuser"].convention
    model = NetworkModel("flowdiffuser", noisy, convention, {}, Execution("cpu"))
    frames = [pack.frame(f"{case}_im{i}") for i in (1, 2)]
    flows = {
        "through the adapter": model.predict(*frames),
        "in a batch": model.run(frames, frames[::-1])[0],
    }
    for how, flow in flows.items():
        pack.check_flow(f"{case} flow {how}", flow.transpose(2, 0, 1)[None], expected["flow"])
