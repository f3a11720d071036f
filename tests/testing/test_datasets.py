"""The small dataset satisfies the dataset contract, its flow is exact, and a benchmark can run on it."""

from dataclasses import replace

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


class WrongTruth(TexturePairs):
    """Textures with integer shifts whose ground truth is changed."""

    def __init__(self, change, known=1.0):
        super().__init__(3, (64, 96), reach=5, seed=1)
        self._change, self._known = change, known

    def load(self, key):
        sample = super().load(key)
        flow = np.ascontiguousarray(CHANGES[self._change](sample.flow), np.float32)
        valid = np.random.default_rng(0).random(sample.shape) < self._known
        return replace(sample, flow=np.where(valid[..., None], flow, np.float32(0)), valid=valid)


CHANGES = {
    "right": lambda flow: flow,
    "doubled": lambda flow: 2 * flow,
    "halved": lambda flow: flow / 2,
    "swapped": lambda flow: flow[..., ::-1],
    "negated": lambda flow: -flow,
    "v up": lambda flow: flow * [1, -1],
    "divided": lambda flow: flow / [96, 64],
    "in 64ths": lambda flow: flow * 64,
}


@pytest.mark.parametrize("known", [1.0, 0.2])
@pytest.mark.parametrize("change", CHANGES)
def test_dataset_with_truth_in_another_convention_is_refused(change, known):
    dataset = WrongTruth(change, known)
    if change == "right":
        assert check_dataset(dataset) == "texture_pairs"
    else:
        refusal(lambda: check_dataset(dataset), UsageError, "texture_pairs")
