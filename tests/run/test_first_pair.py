"""A run warns on its first pair if the model's flow or the ground truth is in a wrong format, and says which."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

import robustflow as rf
from robustflow.data.benchmarks import Benchmark
from robustflow.data.datasets.shapes.dataset import FlyingShapes
from robustflow.testing import ConstantFlow, ZeroFlow

FEW = {"corruptions": "contrast", "severities": 1}


class Negated:
    def __init__(self):
        self.model = rf.load_model("farneback")

    def predict(self, frame1, frame2):
        return -self.model.predict(frame1, frame2)


def warned(model, folder, **options):
    """The warnings of a run that name its sample: those about the format of the flow."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        rf.evaluate(model, "demo", output=folder, **FEW | options)
    return [str(one.message) for one in caught if "'motorcycle'" in str(one.message)]


@pytest.mark.parametrize("workers", [None, 2])
def test_run_of_a_negated_flow_warns_once_and_names_it(tmp_path, workers):
    (warning,) = warned(Negated(), tmp_path, workers=workers)
    assert "backward" in warning
    assert not warned(Negated(), tmp_path, workers=workers, severities=2)  # the first pair is measured already


@pytest.mark.parametrize("model", ["dis", "farneback", "tiny", ConstantFlow(30, 5), ZeroFlow()])
def test_run_of_a_correct_or_constant_flow_does_not_warn(tmp_path, model):
    assert not warned(model, tmp_path)


class WrongTruth(FlyingShapes):
    """Flying shapes whose ground truth is multiplied by a factor."""

    def __init__(self, factor):
        super().__init__(pairs=1, size="128x160")
        self._factor = factor

    def load(self, key):
        sample = super().load(key)
        return replace(sample, flow=sample.flow * np.float32(self._factor))


@pytest.mark.parametrize(
    ("factor", "model", "accused"),
    [
        (1, "dis", []),
        (2, "dis", ["the ground truth"]),
        (-1, "dis", ["the ground truth"]),
        (0.5, ZeroFlow(), ["the ground truth"]),
        (1, Negated(), ["the model's flow"]),
        (-1, Negated(), ["the model's flow", "the ground truth"]),
    ],
)
def test_warning_says_whether_the_truth_or_the_model_is_doubted(tmp_path, factor, model, accused):
    data = WrongTruth(factor)
    benchmark = Benchmark("wrong", data, tuple(data.keys()), ("contrast",), (1,))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        rf.evaluate(model, benchmark, output=tmp_path, examples=False)
    assert [str(one.message).partition(" looks ")[0] for one in caught if "looks" in str(one.message)] == accused


def test_check_of_the_first_pair_predicts_nothing_again(tmp_path):
    calls = []

    def flow(frame1, frame2):
        calls.append(1)
        return np.zeros((*frame1.shape[:2], 2), np.float32)

    rf.evaluate(flow, "demo", output=tmp_path, **FEW)
    assert len(calls) == 2  # clean and contrast
