"""BrightFlow matches the outputs of the original implementation."""

import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch
import torch.nn.functional as F

from robustflow.models.conventions import InputConvention
from robustflow.models.networks.brightflow import BrightFlow

pytestmark = [pytest.mark.parity, pytest.mark.torch]
PACK = "brightflow"


def test_flows_and_features_equal_the_original(pack, case):
    expected = pack.expected(case)
    net = pack.fill(BrightFlow(iterations=12))
    images = [2 * pack.image(f"{case}_im{i}") / 255 - 1 for i in (1, 2)]
    height, width = images[0].shape[2:]
    left, right, above, below = InputConvention(fit="pad", multiple=8).padding_sides(height, width)
    image1, image2 = (F.pad(image, (left, right, above, below), mode="replicate") for image in images)
    pack.check_features(f"{case} fnet", net.model["fnet"](image1)[:, :16], expected["fnet_im1_ch0to15"])
    pack.check_features(f"{case} cnet", net.model["cnet"](image1)[:, :16], expected["cnet_im1_ch0to15"])
    flows = [flow[:, :, above : above + height, left : left + width] for flow in net.flows(image1, image2)]
    assert len(flows) == 12
    pack.check_flow(f"{case} flow_after_1_iter", flows[0][:, :, ::2, ::2], expected["flow_after_1_iter"])
    pack.check_flow(f"{case} flow", flows[-1], expected["flow"])


def test_the_model_loads_the_authors_layout_and_pads(pack, case, tmp_path):
    from robustflow import load_model

    # the authors' files come from data-parallel training and contain entries in addition to the network's
    state = {f"module.{key}": value for key, value in pack.fill(BrightFlow()).state_dict().items()}
    state["module.corrector.conv1.weight"] = torch.zeros(64, 7, 7, 7)
    state["module.census.kernel"] = torch.zeros(49, 1, 7, 7)
    torch.save(state, tmp_path / "brightflow.pt")
    model = load_model("brightflow", checkpoint=tmp_path / "brightflow.pt", device="cpu")
    frames = [pack.frame(f"{case}_im{i}") for i in (1, 2)]
    flows = {
        "through the adapter": model.predict(*frames),
        "in a batch": model.run(frames, frames[::-1])[0],
    }
    for how, flow in flows.items():
        pack.check_flow(f"{case} flow {how}", flow.transpose(2, 0, 1)[None], pack.expected(case)["flow"])
