"""`check_model` accepts models that follow the rules and reports each broken rule; the small models behave as
documented.
"""

import sys

import numpy as np
import pytest

import robustflow as rf
from robustflow.core.errors import ModelError, UsageError
from robustflow.testing import BrightnessFlow, ConstantFlow, ZeroClipFlow, ZeroFlow, check_model

from ..refusals import refusal


class Batched(ConstantFlow):
    """A model whose batches are changed by a function of the flows and the first frames."""

    def __init__(self, change=lambda flows, frames: flows):
        super().__init__(1, 1)
        self.change = change

    def predict_batch(self, frames1, frames2):
        return self.change([self.predict(a, b) for a, b in zip(frames1, frames2, strict=True)], frames1)


class Clip(ZeroClipFlow):
    def predict_clip(self, frames, index):
        assert (len(frames), index) == (5, 2)
        return super().predict_clip(frames, index)


class Sure(ZeroFlow):
    """A model with the same confidence everywhere, changed by a function of flow, confidence and number of calls."""

    def __init__(self, change=lambda flow, confidence, calls: (flow, confidence)):
        super().__init__()
        self.change, self.calls = change, 0

    def predict_with_confidence(self, frame1, frame2):
        self.calls += 1
        return self.change(self.predict(frame1, frame2), np.ones(frame1.shape[:2], np.float32), self.calls)


@pytest.mark.parametrize("model", [ZeroFlow, ConstantFlow(2, 1), BrightnessFlow(), Batched(), Clip((2, 1)), Sure()])
def test_check_model_accepts_models_that_keep_the_rules(model):
    assert check_model(model) == (model.__name__ if isinstance(model, type) else type(model).__name__)


@pytest.mark.parametrize("name", ["dis", "farneback"])
def test_check_model_accepts_every_shipped_model(name):
    check_model(rf.load_model(name))


class Writes(ZeroFlow):
    def predict(self, frame1, frame2):
        frame1[0, 0] = 255 - frame1[0, 0]
        return super().predict(frame1, frame2)


class Remembers(ZeroFlow):
    calls = 0

    def predict(self, frame1, frame2):
        self.calls += 1
        return super().predict(frame1, frame2) + np.float32(self.calls)


class Broken(ZeroFlow):
    def __init__(self):
        raise OSError("no card")


def padded(frame1, frame2):
    return np.zeros((-(-frame1.shape[0] // 8) * 8, frame1.shape[1], 2), np.float32)


def never(frame1, frame2):
    return np.full((*frame1.shape[:2], 2), np.nan, np.float32)


BATCHES = [
    lambda flows, frames: [flow + np.float32(0.01) for flow in flows],
    lambda flows, frames: flows[:1],
    lambda flows, frames: [flow * np.float32(np.nan) for flow in flows],
    lambda flows, frames: flows[9],
    lambda flows, frames: None,
    lambda flows, frames: frames[0].fill(0) or flows,
]
"""Batches that are not the flows of single pairs, and one that overwrites its frames."""


@pytest.mark.parametrize(
    ("model", "culprit"),
    [
        *((model, "predict") for model in (Writes(), Remembers(), padded, never)),
        *((model, "predict") for model in (lambda a, b: a[..., :2], lambda a, b: [[0]], lambda a, b: a.nothing)),
        (lambda a, b: sys.exit(3), "predict"),
        *((Batched(change), "predict_batch") for change in BATCHES),
        (Sure(lambda flow, confidence, calls: (flow + 1, confidence)), "predict_with_confidence"),
        (Sure(lambda flow, confidence, calls: (flow, calls * confidence)), "predict_with_confidence"),
    ],
)
def test_check_model_names_the_method_that_breaks_a_rule(model, culprit):
    refusal(lambda: check_model(model), ModelError, culprit)


@pytest.mark.parametrize("model", [3, Broken, Sure(lambda flow, confidence, calls: (flow, confidence[1:]))])
def test_object_that_is_not_a_model_is_refused(model):
    with pytest.raises(ModelError):
        check_model(model)


class Changed:
    """Farneback's flow in a different format, or from frame 2 to frame 1."""

    def __init__(self, change, backward=False):
        self.model, self.change, self.backward = rf.load_model("farneback"), change, backward

    def predict(self, frame1, frame2):
        frames = (frame2, frame1) if self.backward else (frame1, frame2)
        return np.ascontiguousarray(self.change(self.model.predict(*frames)), np.float32)


FORMATS = {
    "(v, u)": Changed(lambda flow: flow[..., ::-1]),
    "backward": Changed(lambda flow: flow, backward=True),
    "negated": Changed(lambda flow: -flow),
    "divided by the size": Changed(lambda flow: flow / np.array(flow.shape[1::-1])),
    "x 0.55": Changed(lambda flow: 0.55 * flow),
}


@pytest.mark.parametrize("name", FORMATS)
def test_model_that_returns_its_flow_in_a_wrong_format_is_refused(name):
    with pytest.raises(ModelError) as caught:
        check_model(FORMATS[name])
    assert caught.value.culprit not in ("", "predict")


def test_model_that_underestimates_the_motion_a_little_is_accepted():
    check_model(Changed(lambda flow: 0.9 * flow))


@pytest.mark.parametrize(("attribute", "value"), [("trained_on", ""), ("trained_on", "none"), ("name", "a\nb")])
def test_declaration_that_a_run_refuses_is_refused(tmp_path, attribute, value):
    model = ZeroFlow()
    setattr(model, attribute, value)
    for use in (check_model, lambda model: rf.evaluate(model, "demo", output=tmp_path, corruptions="contrast")):
        with pytest.raises(UsageError):
            use(model)
