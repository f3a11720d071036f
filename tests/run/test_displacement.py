"""Flow magnitude histograms match a pixel-by-pixel count."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robustflow.core.errors import DataError, ModelError, UsageError
from robustflow.data.benchmarks import load_benchmark
from robustflow.run.displacement import EDGES, displacement_histogram, histogram
from robustflow.testing import ZeroFlow


@given(st.integers(0, 2**32 - 1), st.sampled_from([EDGES, (0, 1, 5, 30), (0.0, math.inf), (0, 3)]))
def test_every_valid_pixel_is_counted_once(seed, edges):
    rng = np.random.default_rng(seed)
    flows = [(rng.integers(-80, 80, (4, 5, 2)).astype(np.float32), rng.random((4, 5)) < 0.7) for _ in range(3)]
    expected = [0] * (len(edges) - 1)
    valid = 0
    for flow, mask in flows:
        for (u, v), known in zip(flow.reshape(-1, 2), mask.ravel(), strict=True):
            valid += bool(known)
            for bin_, (low, high) in enumerate(pairwise(edges)):
                expected[bin_] += bool(known and low <= math.hypot(u, v) < high)
    table = histogram(flows, edges)
    assert table["pixels"].to_list() == expected
    assert table["share"].sum() == pytest.approx(sum(expected) / valid)


def test_displacement_is_counted_from_ground_truth_or_a_model():
    benchmark = load_benchmark("demo")
    truth = displacement_histogram(benchmark)
    sample = benchmark.dataset.load(benchmark.keys[0])
    assert truth["pixels"].sum() == int(sample.valid.sum())

    still = displacement_histogram(benchmark, ZeroFlow(), "still")
    assert still["pixels"][0] == sample.shape[0] * sample.shape[1]
    assert still["source"].unique().to_list() == ["still"]


def test_a_flow_that_is_not_finite_is_refused():
    class Broken(ZeroFlow):
        def predict(self, frame1, frame2):
            flow = super().predict(frame1, frame2)
            flow[0, :3, 1] = math.nan, math.inf, -math.inf
            return flow

    with pytest.raises(ModelError, match="3 pixels that are NaN or infinite on sample 'motorcycle'"):
        displacement_histogram(load_benchmark("demo"), Broken())


def test_displacement_without_ground_truth_needs_a_model(tmp_path):
    from robustflow.media.images import write_image

    for index in range(2):
        write_image(tmp_path / f"{index}.png", np.zeros((8, 8, 3), np.uint8))
    with pytest.raises(DataError, match="name the model"):
        displacement_histogram(load_benchmark("folder", tmp_path))


@pytest.mark.parametrize("edges", [(), (0,), (1, 2), (0, 2, 2), (0, 3, 2)])
def test_edges_that_do_not_ascend_are_refused(edges):
    with pytest.raises(UsageError, match="ascend"):
        histogram([], edges)
