"""The adapted RAFT returns the same bits as torchvision itself, whether it is loaded by name or from a file."""

import numpy as np
import pytest

from robustflow import load_model
from robustflow.core.errors import ModelError, UsageError

from ..textures import textured_pair

pytestmark = pytest.mark.torch


@pytest.fixture
def optical_flow():
    return pytest.importorskip("torchvision", reason="needs the torch extra").models.optical_flow


@pytest.mark.parametrize("name", ["raft_large", "raft_small"])
def test_flow_is_bit_equal_to_that_of_the_library(optical_flow, name):
    import torch

    frames = textured_pair(131, 170)
    model = load_model(name, checkpoint="random", iterations=2, device="cpu")
    flow = model.predict(*frames)
    net = getattr(optical_flow, name)(weights=None).eval()
    net.load_state_dict(model.net.model.state_dict())
    weights = getattr(optical_flow, f"{name.title()}_Weights")
    padded = [np.pad(frame, ((2, 3), (3, 3), (0, 0)), mode="edge") for frame in frames]
    images = weights.DEFAULT.transforms()(*(torch.from_numpy(frame).permute(2, 0, 1)[None] for frame in padded))
    with torch.no_grad():
        expected = net(*images, num_flow_updates=2)[-1][0].permute(1, 2, 0).numpy()[2:-3, 3:-3]
    assert np.abs(expected).max() > 0
    np.testing.assert_array_equal(flow, expected)


def test_weights_are_given_by_name_or_file(optical_flow, tmp_path, monkeypatch):
    import torch

    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    monkeypatch.setattr(torch.hub, "download_url_to_file", lambda *args, **options: 1 / 0)
    with pytest.raises(
        ModelError, match=r"cannot download https://download\.pytorch\.org/models/raft_small_C_T_V2-\w+\.pth"
    ):
        load_model("raft_small", checkpoint="C_T_V2")
    with pytest.raises(UsageError, match="did you mean 'C_T_V2'"):
        load_model("raft_small", checkpoint="C_T_V3")
    torch.save(optical_flow.raft_small(weights=None).state_dict(), tmp_path / "mine.pth")
    model = load_model("raft_small", checkpoint=tmp_path / "mine.pth", device="cpu")
    assert model.identity()["iterations"] == 12
    with pytest.raises(ModelError, match="not a checkpoint of raft_large"):
        load_model("raft_large", checkpoint=tmp_path / "mine.pth")


@pytest.mark.parametrize("name", ["raft_large", "raft_small"])
def test_frames_too_small_for_the_correlation_volume_are_refused(optical_flow, name):
    model = load_model(name, checkpoint="random", iterations=1, device="cpu")
    assert np.isfinite(model.predict(*textured_pair(121, 121))).all()
    with pytest.raises(ModelError, match="a frame is 120x160, but below 121 pixels per side"):
        model.predict(*textured_pair(120, 160))
