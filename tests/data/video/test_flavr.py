"""Test the FLAVR network and the interpolator that uses it."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch

from robustflow.core.errors import ModelError, UsageError
from robustflow.core.files import sha256_of_file
from robustflow.data.video.flavr import FLAVR, FlavrInterpolator, load_flavr
from tests.refusals import refusal

pytestmark = pytest.mark.torch


def network_and_file(outputs: int, path: Path) -> tuple[FLAVR, Path]:
    torch.manual_seed(0)
    net = FLAVR(outputs).eval().requires_grad_(False)
    torch.save({"epoch": 1, "state_dict": {f"module.{key}": value for key, value in net.state_dict().items()}}, path)
    return net, path


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    return network_and_file(1, tmp_path_factory.mktemp("flavr") / "FLAVR_2x.pth")


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    return network_and_file(3, tmp_path_factory.mktemp("flavr") / "FLAVR_4x.pth")


@pytest.fixture(scope="module")
def interpolator(weights):
    return FlavrInterpolator(weights[1])


def clip():
    generator = torch.Generator().manual_seed(0)
    return [torch.rand(2, 3, 16, 24, generator=generator) for _ in range(4)]


def test_brightness_offset_of_the_input_is_kept_in_interpolated_frames(saved):
    """The mean of each colour channel is subtracted from the input and added back to the output."""
    net, _ = saved
    shift = torch.tensor([0.1, -0.2, 0.3]).view(1, 3, 1, 1)
    (found,) = net([frame + shift for frame in clip()])
    (expected,) = net(clip())
    torch.testing.assert_close(found, expected + shift, atol=1e-5, rtol=0)


def test_interpolation_does_not_depend_on_the_batch_size(saved):
    net, _ = saved
    (together,) = net(clip())
    for i in range(2):
        (alone,) = net([frame[i : i + 1] for frame in clip()])
        torch.testing.assert_close(together[i : i + 1], alone, atol=1e-5, rtol=0)


def test_flavr_loads_the_authors_checkpoint(weights):
    net, path = weights
    loaded = load_flavr(path)
    assert not loaded.training
    assert torch.equal(loaded(clip())[0], net(clip())[0])


def test_checkpoint_for_a_different_factor_is_refused(saved):
    with pytest.raises(ModelError):
        load_flavr(saved[1])


def test_interpolated_frames_equal_the_network_output_rounded_and_cropped(weights, interpolator):
    window = [np.random.default_rng(i).integers(0, 256, (19, 26, 3), np.uint8) for i in range(4)]
    made = interpolator.between(window, 4)
    padded = [np.pad(frame, ((0, 5), (0, 6), (0, 0)), mode="edge") for frame in window]
    tensors = [torch.from_numpy(frame).permute(2, 0, 1)[None].float() / 255 for frame in padded]
    with torch.no_grad():
        expected = [out[0].permute(1, 2, 0).numpy() for out in weights[0](tensors)]
    assert len(made) == 3
    for frame, raw in zip(made, expected, strict=True):
        assert frame.shape == (19, 26, 3)
        assert (frame == np.clip(np.rint(raw[:19, :26] * np.float32(255)), 0, 255).astype(np.uint8)).all()


def test_flavr_refuses_another_factor_and_records_its_checkpoint(weights, interpolator):
    refusal(lambda: interpolator.between([np.zeros((16, 16, 3), np.uint8)] * 4, 2), UsageError, "--factor")
    assert interpolator.describe()["checkpoint_sha256"] == sha256_of_file(weights[1])
