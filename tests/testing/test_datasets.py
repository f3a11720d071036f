"""The small dataset satisfies the dataset contract, its flow is exact, and a benchmark can run on it."""

import numpy as np
import pytest

import robustflow as rf
from robustflow.core.errors import UsageError
from robustflow.data.benchmarks import Benchmark, load_benchmark
from robustflow.testing import ConstantFlow, TexturePairs, check_dataset

from ..refusals import refusal


@pytest.mark.parametrize("size", [(64, 96), (33, 61)])
def test_texture_pairs_pass_check_dataset(size):
    pairs = TexturePairs(4, size)
    assert check_dataset(pairs, samples=4) == "texture_pairs"
    assert {sample.shape for sample in pairs} == {size}
    assert len({sample.frames[0].tobytes() for sample in pairs}) == 4


@pytest.mark.parametrize("key", ["0", "1", "2"])
def test_flow_of_texture_pairs_maps_each_pixel_to_its_match(key):
    sample = TexturePairs(3, (40, 56), reach=6, seed=5).load(key)
    assert sample.occluded is not None
    y, x = np.nonzero(~sample.occluded)
    u, v = sample.flow[y, x].astype(int).T
    assert np.array_equal(sample.frames[0][y, x], sample.frames[1][y + v, x + u])
    assert sample.occluded.sum() == 40 * 56 - (40 - abs(v[0])) * (56 - abs(u[0]))


def test_shifted_truth_has_the_known_error_on_texture_pairs(tmp_path):
    pairs = TexturePairs(1)
    u, v = pairs.load("0").flow[0, 0]
    benchmark = Benchmark("textures", pairs, ("0",), ("contrast",), (1,))
    run = rf.evaluate(ConstantFlow(u + 3, v + 4), benchmark, output=tmp_path)
    assert run.epe_clean == 5.0
    assert run.cre == 0.0


def test_texture_pairs_load_by_name():
    assert load_benchmark("demo", "robustflow.testing:TexturePairs").keys == ("0", "1", "2")


@pytest.mark.parametrize("wrong", [{"count": 0}, {"size": (4, 40)}, {"reach": -1}])
def test_impossible_texture_pairs_are_refused(wrong):
    refusal(lambda: TexturePairs(**wrong), UsageError, "size")
