"""Test the adapter for PyTorch networks: its input, its output, and the independence of the pairs in a batch."""

import re

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch

from robustflow import load_model
from robustflow.core.errors import ModelError, UsageError
from robustflow.models.conventions import InputConvention
from robustflow.models.execution import Execution
from robustflow.models.networks.brightflow import BrightFlow
from robustflow.models.torch.network_model import NetworkModel, resize, resize_flow

from ...refusals import refusal
from ..textures import noise_pair, textured_pair

pytestmark = pytest.mark.torch


def network(name, net, convention, settings, **execution):
    return NetworkModel(name, net, convention, settings, Execution(**execution))


class Spy(torch.nn.Module):
    """Stores its inputs, and returns the first two channels of the first image as the flow."""

    def forward(self, image1, image2):
        self.given = image1, image2
        self.precise = torch.is_autocast_enabled("cpu"), torch.get_num_threads()
        return image1[:, :2]


def spy(**convention):
    model = network("spy", Spy(), InputConvention(**convention), {}, device="cpu")
    return model, model.net


@pytest.mark.parametrize("order", ["rgb", "bgr"])
def test_colours_are_ordered_shifted_and_scaled(order):
    model, net = spy(order=order, mean=(10.0, 20.0, 30.0), scale=0.5)
    frame1, frame2 = noise_pair()
    model.predict(frame1, frame2)
    for frame, given in zip((frame1, frame2), net.given, strict=True):
        channels = frame if order == "rgb" else frame[..., ::-1]
        expected = (channels.astype(np.float64) - [10, 20, 30]) * 0.5
        np.testing.assert_allclose(given[0].permute(1, 2, 0), expected, atol=1e-5)


@pytest.mark.parametrize("vertical", ["both", "bottom"])
@pytest.mark.parametrize("padding", ["replicate", "zeros"])
@pytest.mark.parametrize("size", [(5, 7), (8, 16), (17, 9)])
def test_padding_is_added_and_taken_off_again(vertical, padding, size):
    mean = (10.0, 20.0, 30.0)
    model, net = spy(fit="pad", multiple=8, vertical=vertical, padding=padding, mean=mean, scale=1.0)
    frame1, frame2 = noise_pair(*size)
    flow = model.predict(frame1, frame2)
    height, width = size
    rows, columns = -height % 8, -width % 8
    above, left = rows // 2 if vertical == "both" else 0, columns // 2
    sides = ((above, rows - above), (left, columns - left), (0, 0))
    values = frame1.astype(np.float32) - np.float32(mean)
    expected = np.pad(values, sides, mode="edge" if padding == "replicate" else "constant")
    np.testing.assert_array_equal(net.given[0][0].permute(1, 2, 0), expected)
    np.testing.assert_array_equal(flow, values[..., :2])


def test_stretching_scales_the_flow_back():
    """A constant frame does not change when it is resized twice, so only the scale factors of the flow remain."""
    model, net = spy(fit="stretch", multiple=64, size=(64, 128), scale=1.0)
    frame = np.full((32, 256, 3), 100, np.uint8)
    flow = model.predict(frame, frame)
    assert net.given[0].shape == (1, 3, 64, 128)
    assert flow.shape == (32, 256, 2)
    np.testing.assert_allclose(flow[..., 0], 200, rtol=1e-6)
    np.testing.assert_allclose(flow[..., 1], 50, rtol=1e-6)
    model, net = spy(fit="stretch", multiple=64)
    model.predict(*noise_pair(65, 64))
    assert net.given[0].shape == (1, 3, 128, 64), "the next multiple"


def test_invalid_pairs_are_refused():
    model, _ = spy()
    for frame, culprit in (
        (np.zeros((5, 7, 3), np.float32), "float32 (5, 7, 3)"),
        (np.zeros((5, 7, 4), np.uint8), "uint8 (5, 7, 4)"),
    ):
        refusal(lambda frame=frame: model.predict(frame, frame), UsageError, culprit)
    refusal(lambda: model.predict(noise_pair()[0], noise_pair(5)[0]), UsageError, "(5, 19)")
    refusal(lambda: model.predict_batch(noise_pair(), noise_pair()[:1]), UsageError, "frames2")


@pytest.mark.parametrize(
    ("error", "culprit"),
    [
        (RuntimeError("kernel size\ncan't be greater"), "13x19"),
        (torch.OutOfMemoryError("CUDA out of memory"), "13x19"),
        (ModelError("window", "made for more frames"), "window"),
    ],
)
def test_error_of_a_network_names_the_frame_size(error, culprit):
    model, net = spy()
    net.forward = lambda *images: (_ for _ in ()).throw(error)
    refusal(lambda: model.predict(*noise_pair()), ModelError, culprit)


@pytest.mark.parametrize(
    ("options", "error", "culprit"),
    [
        ({"device": "gpu"}, UsageError, "gpu"),
        ({"device": "meta"}, UsageError, "meta"),
        ({"device": None}, UsageError, "None"),
        ({"device": "cuda:99"}, ModelError, "cuda:99"),
        ({"precision": "fp16"}, UsageError, "fp16"),
        ({"threads": 0}, UsageError, "threads"),
        ({"threads": 100_000}, UsageError, "threads"),
        ({"threads": 1.5}, UsageError, "threads"),
        ({"compile": "no"}, UsageError, "compile"),
    ],
)
def test_invalid_execution_options_are_refused(options, error, culprit):
    refusal(lambda: network("spy", Spy(), InputConvention(), {}, **options), error, culprit)


def test_threads_and_precision_hold_during_a_prediction_only():
    before = torch.get_num_threads()
    model = network("spy", Spy(), InputConvention(), {}, device="cpu", precision="bf16", threads=3)
    model.predict(*noise_pair())
    assert model.net.precise == (True, 3)
    assert torch.get_num_threads() == before
    assert not torch.is_autocast_enabled("cpu")


def test_identity_names_what_changes_the_numbers():
    convention = InputConvention(fit="pad", multiple=8)
    options = [{}, {"precision": "bf16"}, {"threads": 2}, {"compile": True}]
    models = [network("spy", Spy(), convention, {"iterations": 12}, device="cpu", **each) for each in options]
    models += [network("spy", Spy(), convention, {"iterations": 24}, device="cpu")]
    models += [network("spy", Spy(), InputConvention(), {"iterations": 12}, device="cpu")]
    identities = [model.identity() for model in models]
    assert all(identities[i] != identities[j] for i in range(6) for j in range(i))
    assert identities[0] == {
        "name": "spy",
        "iterations": 12,
        "input": {
            "order": "rgb",
            "mean": [0.0, 0.0, 0.0],
            "scale": 1 / 255,
            "fit": "pad",
            "multiple": 8,
            "padding": "replicate",
            "vertical": "both",
        },
        "device": "cpu",
        "precision": "fp32",
        "compile": False,
        "threads": 1,
        "torch": torch.__version__,
    }


CONVENTION = InputConvention(mean=(127.5,) * 3, scale=2 / 255, fit="pad", multiple=8)


def seeded_brightflow():
    """A network whose flow depends on its images: PyTorch's initial weights with a fixed seed, scaled up."""
    torch.manual_seed(0)
    net = BrightFlow(4)
    with torch.no_grad():
        for value in net.parameters():
            value.mul_(1.5 if value.ndim > 1 else 1.0)
    return net


def test_flow_on_the_cpu_does_not_depend_on_the_batch():
    model = network("brightflow", seeded_brightflow(), CONVENTION, {}, device="cpu")
    pairs = [textured_pair(100, 130, seed) for seed in range(3)]
    for flow, pair in zip(model.predict_batch(*zip(*pairs, strict=True)), pairs, strict=True):
        np.testing.assert_array_equal(flow, model.predict(*pair))


def test_bf16_flow_is_close_to_but_different_from_fp32():
    net = seeded_brightflow()
    full, half = (
        network("net", net, CONVENTION, {}, device="cpu", precision=precision).predict(*textured_pair(100, 130))
        for precision in ("fp32", "bf16")
    )
    difference = np.abs(full - half).mean()
    # bfloat16 has 8 significant bits, which results in a relative error of 0.4 % per operation.
    assert 0 < difference < 0.05 * np.abs(full).mean()


@pytest.mark.slow
def test_a_compiled_network_gives_the_same_flow():
    pair = textured_pair(100, 130)
    plain, compiled = (
        network("net", seeded_brightflow(), CONVENTION, {}, device="cpu", compile=compiled)
        for compiled in (False, True)
    )
    flow = compiled.predict(*pair)
    assert np.abs(flow - plain.predict(*pair)).max() <= 1e-3
    assert torch._dynamo.utils.counters["stats"]["unique_graphs"] > 0, "nothing was compiled"
    assert compiled.identity()["compile"] is True


def precisions():
    """Precision settings of float32 multiplication and convolution, keyed by backend."""
    backends = torch.backends
    places = (backends.cuda.matmul, backends.mkldnn.matmul, backends.cudnn.conv, backends.cudnn.rnn)
    return [place.fp32_precision for place in places]


@pytest.mark.skipif(not hasattr(torch.backends.cuda.matmul, "fp32_precision"), reason="needs PyTorch 2.9")
@pytest.mark.parametrize("owner", ["cuda.matmul", "cudnn.conv", ""])
def test_tf32_that_a_script_allowed_per_backend_is_off_in_a_prediction_and_back_after_it(owner):
    place = torch.backends
    for name in filter(None, owner.split(".")):
        place = getattr(place, name)
    during = []
    model, net = spy()
    net.register_forward_hook(lambda *_: during.extend(precisions()))
    before, place.fp32_precision = place.fp32_precision, "tf32"
    try:
        allowed = precisions()
        assert "tf32" in allowed
        model.predict(*noise_pair(16, 12))
        assert (during, precisions()) == (["ieee"] * 4, allowed)
    finally:
        place.fp32_precision = before


@pytest.mark.parametrize("size", [(12, 14), (11, 13), (3, 20), (6, 7)])
def test_a_linear_map_stays_linear_from_corner_to_corner(size):
    y, x = np.mgrid[:6, :7].astype(np.float64)
    maps = torch.from_numpy(np.stack((2 * x - y, x + 3 * y)))[None]
    rows, columns = np.linspace(0, 5, size[0])[:, None], np.linspace(0, 6, size[1])[None, :]
    expected = np.stack((2 * columns - rows, columns + 3 * rows))
    np.testing.assert_allclose(resize(maps, size)[0], expected, atol=1e-5)
    ratios = np.array([size[1] / 7, size[0] / 6])[:, None, None]
    np.testing.assert_allclose(resize_flow(maps, size)[0], expected * ratios, rtol=1e-5, atol=1e-5)


@pytest.fixture
def optical_flow():
    return pytest.importorskip("torchvision", reason="needs the torch extra").models.optical_flow


@pytest.mark.parametrize("name", ["raft_large", "raft_small"])
def test_flow_is_bit_equal_to_that_of_the_library(optical_flow, name):
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
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    monkeypatch.setattr(torch.hub, "download_url_to_file", lambda *args, **options: 1 / 0)
    with pytest.raises(ModelError) as caught:
        load_model("raft_small", checkpoint="C_T_V2")
    assert re.fullmatch(r"https://download\.pytorch\.org/models/raft_small_C_T_V2-\w+\.pth", caught.value.culprit)
    cached = tmp_path / "checkpoints" / caught.value.culprit.rpartition("/")[2]
    assert str(cached) in str(caught.value)
    torch.save(optical_flow.raft_small(weights=None).state_dict(), cached)
    assert "SHA-256" in str(refusal(lambda: load_model("raft_small", checkpoint="C_T_V2"), ModelError, cached))
    refusal(lambda: load_model("raft_small", checkpoint="C_T_V3"), UsageError, "C_T_V3")
    torch.save(optical_flow.raft_small(weights=None).state_dict(), tmp_path / "mine.pth")
    model = load_model("raft_small", checkpoint=tmp_path / "mine.pth", device="cpu")
    assert model.identity()["iterations"] == 12
    refusal(lambda: load_model("raft_large", checkpoint=tmp_path / "mine.pth"), ModelError, tmp_path / "mine.pth")


@pytest.mark.parametrize("name", ["raft_large", "raft_small"])
def test_frames_too_small_for_the_correlation_volume_are_refused(optical_flow, name):
    model = load_model(name, checkpoint="random", iterations=1, device="cpu")
    assert np.isfinite(model.predict(*textured_pair(121, 121))).all()
    refusal(lambda: model.predict(*textured_pair(120, 160)), ModelError, "120x160")
