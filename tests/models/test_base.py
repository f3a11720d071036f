"""An exception raised by a model is reported with its location."""

import numpy as np
import pytest

from robustflow.core.errors import ModelError
from robustflow.models.base import model_identity, predict_checked
from robustflow.models.loading import FunctionModel

FRAMES = (np.zeros((4, 5, 3), np.uint8),) * 2


@pytest.mark.parametrize(
    ("error", "says"),
    [
        (ModelError("a frame is 4x5"), r"^a frame is 4x5 \(on sample 'a', fog severity 3\)$"),
        (
            IndexError("no row"),
            r"^the model raised IndexError on sample 'a', fog .* 3: no row \(at .*_base\.py:\d+\); use",
        ),
    ],
)
def test_error_of_a_model_names_the_sample(error, says):
    def fails(frame1, frame2):
        raise error

    with pytest.raises(ModelError, match=says):
        predict_checked(FunctionModel(fails, {}), FRAMES, "a", "fog", 3)


class _OnAGpu:
    """An object that NumPy cannot convert, like a tensor on a GPU or one that requires gradients."""

    def __array__(self, *args, **kwargs):
        raise TypeError("can't convert cuda:0 device type tensor to numpy.")


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        (_OnAGpu(), r"returned a _OnAGpu on sample 'a', clean that is not an array \(can't convert cuda.*detach"),
        (None, r"returned NoneType on sample 'a', clean; expected a float array of shape \(4, 5, 2\)"),
        ([[1.0], [1.0, 2.0]], "returned a list on sample 'a', clean that is not an array"),
        (np.zeros((2, 4, 5), np.float32), r"returned float32 \(2, 4, 5\) on sample"),
        (np.zeros((4, 5, 2), np.int16), r"returned int16 \(4, 5, 2\) on sample"),
    ],
)
def test_answer_that_is_not_a_flow_is_refused_with_its_type(answer, says):
    with pytest.raises(ModelError, match=says):
        predict_checked(FunctionModel(lambda frame1, frame2: answer, {}), FRAMES, "a", "clean", 0)


def test_masked_values_of_an_answer_are_not_numbers():
    flow = np.ma.masked_greater(np.arange(40, dtype=np.float32).reshape(4, 5, 2), 30)
    checked = predict_checked(FunctionModel(lambda frame1, frame2: flow, {}), FRAMES, "a", "clean", 0)
    np.testing.assert_array_equal(np.isnan(checked), flow.mask)
    assert not isinstance(checked, np.ma.MaskedArray)


class _Says:
    def __init__(self, identity):
        self._identity = identity

    def identity(self):
        return self._identity


@pytest.mark.parametrize("identity", [{"x": float("nan")}, {"x": {"y": [float("inf")]}}, {"x": {(1, 2): 3}}])
def test_identity_that_json_cannot_hold_is_refused_in_one_sentence(identity):
    with pytest.raises(ModelError, match=r"^the model's identity\(\) cannot be written as JSON \(.*finite"):
        model_identity(_Says(identity))
