"""ARFlow matches the outputs of the original implementation."""

import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch

from robustflow.models.conventions import InputConvention
from robustflow.models.execution import Execution
from robustflow.models.networks.arflow import ARFlow
from robustflow.models.torch.network_model import NetworkModel

pytestmark = [pytest.mark.parity, pytest.mark.torch]
PACK = "arflow"


def test_flows_and_features_equal_the_original(pack, case):
    expected = pack.expected(case)
    if "flows_fw_4" not in expected:
        pytest.skip("a stretched case, compared in the next test")
    net = pack.fill(ARFlow())
    features1, features2 = (net.features(pack.image(f"{case}_im{i}") / 255) for i in (1, 2))
    pack.check_features(f"{case} feat_level6", features1[5], expected["feat_level6"])
    pack.check_features(f"{case} feat_level3", features1[2][:, :8], expected["feat_level3_ch0to7"])
    flows = net.flows(features1, features2)
    pack.check_flow(f"{case} flows_fw_4", flows[4], expected["flows_fw_4"])
    pack.check_flow(f"{case} flow", flows[0], expected["flow"])
    backward = net.flows(features2, features1)[0]
    pack.check_flow(f"{case} flow_bw", backward[:, :, ::2, ::2], expected["flow_bw"])


def test_the_adapter_stretches_as_the_original_is_evaluated(pack, case):
    expected = pack.expected(case)
    frames = [pack.frame(f"{case}_im{i}") for i in (1, 2)]
    # A stretched case stores only every second pixel of its flow, so its shape must be inferred.
    stretched = expected.get("flow_at_test_shape")
    size = tuple(2 * side for side in stretched.shape[2:]) if stretched is not None else None
    convention = InputConvention(fit="stretch", multiple=64, size=size)
    model = NetworkModel("arflow", pack.fill(ARFlow()), convention, {}, execution=Execution("cpu"))
    flow = torch.from_numpy(model.predict(*frames)).permute(2, 0, 1)[None]
    pack.check_flow(f"{case} flow through the adapter", flow, expected["flow"])
    batched = model.run(frames, frames[::-1])[0].transpose(2, 0, 1)[None]
    pack.check_flow(f"{case} flow in a batch", batched, expected["flow"])
