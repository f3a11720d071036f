"""A run warns on its first pair if the model's flow or the ground truth is in a wrong format, and says which; and if
the model predicts another flow when it is asked twice."""

import time
import warnings
from dataclasses import replace

import numpy as np
import pytest

import robustflow as rf
from robustflow.data.benchmarks import Benchmark
from robustflow.data.datasets.shapes.dataset import FlyingShapes
from robustflow.stats.notes import comparison_note
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


class Counts:
    """Predicts a larger motion with every call, by `step`, and is slow when it is asked for the clean flow again."""

    def __init__(self, step):
        self.step, self.calls, self.clean = step, 0, None

    def predict(self, frame1, frame2):
        self.calls += 1
        again = np.array_equal(frame1, self.clean)
        self.clean = frame1 if self.clean is None else self.clean
        time.sleep(2 * again)
        return np.full((*frame1.shape[:2], 2), 4 + self.step * self.calls, np.float32)

    def identity(self):
        return {"name": "counts", "step": self.step}


class FromFiles(Counts):
    """The same, as precomputed flows."""

    predict = None

    def lookup(self, key, corruption, severity):
        frame = np.zeros((500, 741, 3), np.uint8)
        return Counts.predict(self, frame, frame)


@pytest.mark.parametrize("engine", ["serial", "processes"])
@pytest.mark.parametrize("step", [0, 0.5])
def test_a_model_that_answers_differently_when_asked_twice_is_named(tmp_path, step, engine):
    model = Counts(step)
    assert len(warned(model, tmp_path, engine=engine)) == bool(step)
    run = rf.load_run(tmp_path)
    assert run.manifest.flows_differ_on == ("motorcycle" if step else "")
    assert ("different flows" in comparison_note(run)) == bool(step)
    assert run.manifest.seconds["predict"] < 2  # the second prediction does not count
    if engine == "serial":
        assert model.calls == 3  # clean twice, and contrast


def test_precomputed_flows_are_not_asked_twice(tmp_path):
    model = FromFiles(0.5)
    assert not warned(model, tmp_path)
    assert model.calls == 2
