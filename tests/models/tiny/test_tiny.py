"""The small network, loaded by name, with and without PyTorch; its layers match SciPy and naive loops."""

import json
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates
from scipy.signal import correlate2d

from robustflow import load_model
from robustflow.data.datasets import load_dataset
from robustflow.models.tiny import layers
from robustflow.models.tiny.tiny import SHIPPED, shipped_weights
from robustflow.testing import check_model

from ...guide_blocks import DOCS
from ...shared_data import shared_folder

PAGE = DOCS / "tiny.md"


def error(flow, sample):
    return float(np.linalg.norm(flow - sample.flow, axis=2)[sample.valid].mean())


@pytest.mark.parametrize(
    ("name", "shapes", "most"),
    [
        *((name, {"pairs": 6, "size": "96x160", "seed": 11}, 0.35) for name in SHIPPED),
        pytest.param("tiny", {"pairs": 200, "size": "160x224"}, 0.2, marks=pytest.mark.slow),
    ],
)
def test_on_unseen_shapes_the_error_is_a_fraction_of_zero_flows(name, shapes, most):
    model = load_model(name, runtime="numpy")
    samples = load_dataset("shapes", **shapes)
    found = [error(model.predict(*sample.frames), sample) for sample in samples]
    still = [error(np.zeros_like(sample.flow), sample) for sample in samples]
    assert np.mean(found) <= most * np.mean(still)


def test_the_weights_differ_and_say_how_they_were_made():
    shipped = [shipped_weights(name) for name in SHIPPED]
    assert len({one.sha256 for one in shipped}) == len(SHIPPED)
    for one in shipped:
        assert one.about["made_by"].startswith("robustflow train tiny --recipe shapes")
        assert re.fullmatch("[0-9a-f]{40}", one.about["commit"])
        training = json.loads(one.about["training"])
        assert {"recipe", "seed", "data", "start", "corruptions"} <= training.keys()
        assert training["start_trained_on"] == ["shapes"]
        assert one.trained_on == "shapes:train"


def test_tiny_passes_check_model_and_is_identified_by_weights_and_runtime():
    model = load_model("tiny", runtime="numpy")
    check_model(model)
    assert model.identity() == {"name": "tiny", "checkpoint": shipped_weights("tiny").sha256, "runtime": "numpy"}


@pytest.mark.torch
@pytest.mark.parametrize("name", SHIPPED)
@pytest.mark.parametrize("size", [(96, 160), (101, 75), (33, 250)])
def test_numpy_and_pytorch_agree(name, size):
    """PyTorch's single precision differs from double precision by up to 1.6e-4 px on KITTI pairs."""
    pytest.importorskip("torch", reason="needs the torch extra")
    sample = load_dataset("shapes", pairs=1, size=f"{size[0]}x{size[1]}", seed=5)[0]
    flows = [load_model(name, runtime=runtime, **device).predict(*sample.frames)
             for runtime, device in (("numpy", {}), ("torch", {"device": "cpu"}))]  # fmt: skip
    difference = np.abs(flows[0] - flows[1])
    assert difference.mean() < 1e-5
    assert np.percentile(difference, 99.9) < 1e-4
    assert difference.max() < 5e-4


@pytest.mark.torch
def test_numpy_and_pytorch_agree_on_long_motion_as_closely_as_the_docs_say():
    pytest.importorskip("torch", reason="needs the torch extra")
    stated = re.search(
        r"agree\s+within (\S+) px at 99\.9 % of\s+the\s+pixels and (\S+) px at the worst", PAGE.read_text()
    )
    assert stated is not None
    sample = load_dataset("kitti2012", shared_folder("data", "kitti2012"))["000151"]  # the largest of 15 values
    flows = [load_model("tiny", runtime=runtime).predict(*sample.frames) for runtime in ("numpy", "torch")]
    difference = np.abs(flows[0] - flows[1])
    assert np.percentile(difference, 99.9) < float(stated[1])
    assert difference.max() < float(stated[2])


def maps(rng, *shape):
    return rng.standard_normal(shape).astype(np.float32)


@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 10**6),
    st.tuples(st.integers(1, 19), st.integers(1, 17)),
    st.sampled_from([1, 3]),
    st.sampled_from([1, 2]),
    st.sampled_from([1, 2, 4]),
    st.booleans(),
)
def test_convolution_equals_scipy(seed, size, kernel, stride, dilation, linear):
    rng = np.random.default_rng(seed)
    image, weight, bias = maps(rng, *size, 3), maps(rng, 2, 3, kernel, kernel), maps(rng, 2)
    spread = np.zeros((2, 3, (kernel - 1) * dilation + 1, (kernel - 1) * dilation + 1))
    spread[:, :, ::dilation, ::dilation] = weight
    reach = (kernel - 1) // 2 * dilation
    padded = np.pad(image.astype(float), ((reach, reach), (reach, reach), (0, 0)))
    channels = [sum(correlate2d(padded[..., i], taps[i], mode="valid") for i in range(3)) for taps in spread]
    expected = np.stack(channels, axis=2)[::stride, ::stride] + bias
    if not linear:
        expected = np.where(expected > 0, expected, 0.1 * expected)
    found = layers.convolve(image, weight, bias, stride, dilation, linear)
    np.testing.assert_allclose(found, expected, atol=1e-4)


def test_convolution_in_strips_is_the_same(monkeypatch):
    rng = np.random.default_rng(0)
    arguments = maps(rng, 33, 21, 5), maps(rng, 4, 5, 3, 3), maps(rng, 4)
    whole = layers.convolve(*arguments, 2)
    monkeypatch.setattr(layers, "_STRIP", 50)
    np.testing.assert_allclose(layers.convolve(*arguments, 2), whole, atol=1e-5)


def test_warp_equals_scipy():
    rng = np.random.default_rng(1)
    image, flow = maps(rng, 9, 12, 2), 3 * maps(rng, 9, 12, 2)
    found = np.empty_like(image)
    layers.warp(image, flow, found)
    rows, columns = np.mgrid[:9, :12]
    place = np.clip(rows + flow[..., 1], 0, 8), np.clip(columns + flow[..., 0], 0, 11)
    expected = np.stack([map_coordinates(image[..., i].astype(float), place, order=1) for i in (0, 1)], axis=2)
    np.testing.assert_allclose(found, expected, atol=1e-5)


@pytest.mark.parametrize("radius", [1, 3])
def test_correlation_equals_the_definition(radius):
    rng = np.random.default_rng(2)
    first, second = maps(rng, 6, 7, 4), maps(rng, 6, 7, 4)
    found = np.empty((6, 7, (2 * radius + 1) ** 2), np.float32)
    layers.correlate(first, second, radius, found)
    for row in range(6):
        for column in range(7):
            window = []
            for y in range(row - radius, row + radius + 1):
                for x in range(column - radius, column + radius + 1):
                    inside = 0 <= y < 6 and 0 <= x < 7
                    window.append(first[row, column] @ second[y, x] / 4 if inside else 0.0)
            np.testing.assert_allclose(found[row, column], window, atol=1e-5)


def test_convex_upsampling_of_a_constant_flow_keeps_it_inside():
    rng = np.random.default_rng(3)
    found = layers.enlarge(np.full((5, 6, 2), 1.5, np.float32), maps(rng, 5, 6, 144), 4)
    np.testing.assert_allclose(found[4:-4, 4:-4], 6.0, atol=1e-5)
    assert (found[0] < 6.0).all()  # the zeros around the map contribute


def test_resized_ramp_stays_a_ramp():
    ramp = np.stack([np.tile(np.arange(5, dtype=np.float32), (4, 1)), np.ones((4, 5), np.float32)], axis=2)
    found = layers.resized(ramp, 8, 9)
    np.testing.assert_allclose(found[..., 0], np.tile(np.linspace(0, 4, 9) * 9 / 5, (8, 1)), atol=1e-5)
    np.testing.assert_allclose(found[..., 1], 2.0, atol=1e-6)


def test_normalised_features_have_mean_square_one():
    found = layers.normalised(maps(np.random.default_rng(4), 3, 5, 16), 1e-9)
    np.testing.assert_allclose((found**2).mean(axis=2), 1.0, atol=1e-4)
