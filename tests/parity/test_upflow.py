"""UPFlow matches the outputs of the original implementation."""

import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch

from robustflow.models.networks.upflow import UPFlow

pytestmark = [pytest.mark.parity, pytest.mark.torch]
PACK = "upflow"


def images(pack, case):
    mean = torch.tensor([104.920005, 110.1753, 114.785955]).view(1, 3, 1, 1)
    return [(pack.image(f"{case}_im{i}") - mean) * 0.0039216 for i in (1, 2)]


def test_flows_features_and_visibility_equal_the_original(pack, case):
    expected = pack.expected(case)
    net = pack.fill(UPFlow())
    image1, image2 = images(pack, case)
    features = net.feature_pyramid_extractor(image1)
    pack.check_features(f"{case} feat_level6", features[5], expected["feat_level6"])
    pack.check_features(f"{case} feat_level3", features[2][:, :8], expected["feat_level3_ch0to7"])
    both = net.both(image1, image2)
    pack.check_flow(f"{case} flow_level0", both.levels[0][0], expected["flow_level0"])
    pack.check_flow(f"{case} flow_quarter", both.levels[-1][0], expected["flow_quarter"])
    pack.check_flow(f"{case} flow", both.forward, expected["flow"])
    pack.check_flow(f"{case} flow_bw", both.backward[:, :, ::2, ::2], expected["flow_bw"])
    beside = net(torch.cat([image1, image2]), torch.cat([image2, image1]))
    pack.check_flow(f"{case} flow in a batch", beside[:1], expected["flow"])
    visible = both.visible()[0].numpy()
    differing = int((visible != expected["occ_fw"].astype(bool)).sum())
    # the README states no tolerance for masks; a pixel whose flow is exactly at the bound may fall on either side
    assert differing <= visible.size / 1000, f"{differing} of {visible.size} pixels differ"


def test_sampling_follows_later_versions_of_pytorch(pack, case):
    net = pack.fill(UPFlow(align_corners=False))
    flow = net(*images(pack, case))
    pack.check_flow(f"{case} flow_alignfalse", flow[:, :, ::2, ::2], pack.expected(case)["flow_alignfalse"])
