"""FLAVR behind the protocol: sizes, values and what it refuses. The network's own parity is tested elsewhere."""

from __future__ import annotations

import numpy as np
import pytest

from robustflow.errors import UsageError
from robustflow.video.flavr_interpolator import FlavrInterpolator

pytestmark = pytest.mark.torch
torch = pytest.importorskip("torch")


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    from robustflow.video.flavr import FLAVR

    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("flavr") / "FLAVR_4x.pth"
    torch.save({"state_dict": {f"module.{k}": v for k, v in FLAVR(3).state_dict().items()}}, path)
    return path


def test_frames_are_the_networks_rounded_and_cropped(weights):
    from robustflow.video.flavr import load_flavr

    window = [np.random.default_rng(i).integers(0, 256, (19, 26, 3), np.uint8) for i in range(4)]
    made = FlavrInterpolator(weights).between(window, 4)
    padded = [np.pad(frame, ((0, 5), (0, 6), (0, 0)), mode="edge") for frame in window]
    tensors = [torch.from_numpy(frame).permute(2, 0, 1)[None].float() / 255 for frame in padded]
    with torch.no_grad():
        expected = [out[0].permute(1, 2, 0).numpy() for out in load_flavr(weights)(tensors)]
    assert len(made) == 3
    for frame, raw in zip(made, expected, strict=True):
        assert frame.shape == (19, 26, 3)
        assert (frame == np.clip(np.rint(raw[:19, :26] * np.float32(255)), 0, 255).astype(np.uint8)).all()


def test_other_factors(weights):
    with pytest.raises(UsageError, match="factor of 2"):
        FlavrInterpolator(weights).between([np.zeros((16, 16, 3), np.uint8)] * 4, 2)


def test_the_checkpoint_is_in_the_manifest(weights):
    from robustflow.digest import sha256_of_file

    assert FlavrInterpolator(weights).describe()["checkpoint_sha256"] == sha256_of_file(weights)
