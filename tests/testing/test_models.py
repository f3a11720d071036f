"""`check_model` accepts models that follow the rules and reports each broken rule; the small models behave as
documented.
"""

import numpy as np
import pytest

import robustflow as rf
from robustflow.core.errors import ModelError, UsageError
from robustflow.testing import BrightnessFlow, ConstantFlow, ShiftedTruth, ZeroClipFlow, ZeroFlow, check_model


class Batched(ConstantFlow):
    def predict_batch(self, frames1, frames2):
        return [self.predict(a, b) for a, b in zip(frames1, frames2, strict=True)]


class Clip(ZeroClipFlow):
    def predict_clip(self, frames, index):
        assert (len(frames), index) == (5, 2)
        return super().predict_clip(frames, index)


class Sure(ZeroFlow):
    """A model with the same confidence everywhere."""

    def predict_with_confidence(self, frame1, frame2):
        return self.predict(frame1, frame2), np.ones(frame1.shape[:2], np.float32)


@pytest.mark.parametrize("model", [ZeroFlow, ConstantFlow(2, 1), BrightnessFlow(), Batched(1, 1), Clip((2, 1)), Sure()])
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


class Mixes(Batched):
    def predict_batch(self, frames1, frames2):
        return [flow + np.float32(0.01) for flow in super().predict_batch(frames1, frames2)]


class Loses(Batched):
    def predict_batch(self, frames1, frames2):
        return super().predict_batch(frames1, frames2)[:1]


class Broken(ZeroFlow):
    def __init__(self):
        raise OSError("no card")


class NotANumber(Batched):
    def predict_batch(self, frames1, frames2):
        return [flow * np.float32(np.nan) for flow in super().predict_batch(frames1, frames2)]


class Fails(Batched):
    def predict_batch(self, frames1, frames2):
        raise KeyError("weights")


class Forgets(Batched):
    def predict_batch(self, frames1, frames2):
        super().predict_batch(frames1, frames2)


class WritesInBatch(Batched):
    def predict_batch(self, frames1, frames2):
        flows = super().predict_batch(frames1, frames2)
        frames1[0][:] = 0
        return flows


class SureOfOther(Sure):
    def predict_with_confidence(self, frame1, frame2):
        flow, confidence = super().predict_with_confidence(frame1, frame2)
        return flow + 1, confidence


class SurerEachTime(Sure):
    calls = 0

    def predict_with_confidence(self, frame1, frame2):
        self.calls += 1
        flow, confidence = super().predict_with_confidence(frame1, frame2)
        return flow, self.calls * confidence


class SureOfLess(Sure):
    def predict_with_confidence(self, frame1, frame2):
        flow, confidence = super().predict_with_confidence(frame1, frame2)
        return flow, confidence[1:]


def padded(frame1, frame2):
    return np.zeros((-(-frame1.shape[0] // 8) * 8, frame1.shape[1], 2), np.float32)


def never(frame1, frame2):
    return np.full((*frame1.shape[:2], 2), np.nan, np.float32)


@pytest.mark.parametrize(
    ("model", "says"),
    [
        (Writes(), "modifies its input frames"),
        (Remembers(), r"a different flow for the same frames \(off by up to 2 px\)"),
        (Mixes(), "a different flow in a batch than for single pairs"),
        (Loses(), "returned 1 flows for 2 pairs"),
        (NotANumber(), "a different flow in a batch than for single pairs"),
        (Fails(), "predict_batch raised KeyError on frames of 128x160: 'weights'"),
        (Forgets(), "predict_batch returned NoneType on frames of 128x160; expected one flow per pair"),
        (WritesInBatch(), "modifies its input frames"),
        (
            padded,
            r"returned float32 \(128, 147, 2\) on frames of 121x147; expected a float array of shape",
        ),
        (never, "on frames of 128x160 returned 20480 pixels that are NaN"),
        (lambda a, b: a[..., :2], r"returned uint8 \(128, 160, 2\)"),
        (lambda a, b: [[0]], "returned list"),
        (lambda a, b: a.nothing, "raised AttributeError on frames of 128x160"),
        (3, "has neither a method predict"),
        (Broken, "model 'Broken' cannot be built: OSError: no card"),
        (SureOfOther(), "predict_with_confidence returns a different flow than predict on frames of 128x160"),
        (SurerEachTime(), "a different confidence for the same frames on frames of 128x160"),
        (SureOfLess(), r"confidence on frames of 128x160 has the shape \(127, 160\); expected \(128, 160\)"),
    ],
)
def test_check_model_names_every_broken_rule(model, says):
    with pytest.raises(ModelError, match=says) as error:
        check_model(model)
    assert "\n" not in str(error.value)


def test_the_shifted_truth_has_the_error_it_says(tmp_path):
    sample = rf.load_dataset("motorcycle").load("motorcycle")
    known = np.where(sample.valid[..., None], sample.flow, 0)
    result = rf.evaluate(ShiftedTruth(known, 3, 4), output=tmp_path / "run", corruptions=["contrast"], severities=[1])
    assert result.epe_clean == pytest.approx(5.0, abs=1e-5)
    assert result.cre == pytest.approx(0.0, abs=1e-9)


class Changed:
    """Farneback's flow in a different format, or from frame 2 to frame 1."""

    def __init__(self, change, backward=False):
        self.model, self.change, self.backward = rf.load_model("farneback"), change, backward

    def predict(self, frame1, frame2):
        frames = (frame2, frame1) if self.backward else (frame1, frame2)
        return np.ascontiguousarray(self.change(self.model.predict(*frames)), np.float32)


FORMATS = {
    "(v, u)": (Changed(lambda flow: flow[..., ::-1]), "swapped"),
    "backward": (Changed(lambda flow: flow, backward=True), "backward"),
    "negated": (Changed(lambda flow: -flow), "backward"),
    "divided by the size": (Changed(lambda flow: flow / np.array(flow.shape[1::-1])), "divided by the size"),
    "x 0.55": (Changed(lambda flow: 0.55 * flow), "too short"),
}


@pytest.mark.parametrize("name", FORMATS)
def test_model_that_returns_its_flow_in_a_wrong_format_is_refused(name):
    model, words = FORMATS[name]
    with pytest.raises(ModelError, match=words):
        check_model(model)


def test_model_that_underestimates_the_motion_a_little_is_accepted():
    check_model(Changed(lambda flow: 0.9 * flow))


@pytest.mark.parametrize(("attribute", "value"), [("trained_on", ""), ("trained_on", "none"), ("name", "a\nb")])
def test_declaration_that_a_run_refuses_is_refused(tmp_path, attribute, value):
    model = ZeroFlow()
    setattr(model, attribute, value)
    for use in (check_model, lambda model: rf.evaluate(model, "demo", output=tmp_path, corruptions="contrast")):
        with pytest.raises(UsageError):
            use(model)
