"""What a model raises or returns is reported with the sample and the corruption."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from robustflow.core.errors import ModelError, UsageError
from robustflow.models import ModelSpec
from robustflow.models.base import model_identity, predict_checked
from robustflow.models.conventions import InputConvention, check_count, check_switch
from robustflow.models.loading import FunctionModel, device_of, devices_of

from ..refusals import refusal

FRAMES = (np.zeros((4, 5, 3), np.uint8),) * 2


def predicted(function):
    return predict_checked(FunctionModel(function, {}), FRAMES, "a", "fog", 3)


def test_error_of_a_model_names_the_sample_and_the_line_of_its_code():
    error = refusal(lambda: predicted(lambda *_: [][1]), ModelError, "sample 'a', fog severity 3")
    assert "test_base.py:" in str(error)

    def small(frame1, frame2):
        raise ModelError("4x5", "too small")

    refusal(lambda: predicted(small), ModelError, "4x5")


class _OnAGpu:
    """An object that NumPy cannot convert, like a tensor on a GPU or one that requires gradients."""

    def __array__(self, *args, **kwargs):
        raise TypeError("can't convert cuda:0 device type tensor to numpy.")


@pytest.mark.parametrize(
    "answer",
    [_OnAGpu(), None, [[1.0], [1.0, 2.0]], np.zeros((2, 4, 5), np.float32), np.zeros((4, 5, 2), np.int16)],
)
def test_answer_that_is_not_a_flow_is_refused(answer):
    refusal(lambda: predicted(lambda *_: answer), ModelError, "sample 'a', fog severity 3")


def test_masked_values_of_an_answer_are_not_numbers():
    flow = np.ma.masked_greater(np.arange(40, dtype=np.float32).reshape(4, 5, 2), 30)
    checked = predicted(lambda frame1, frame2: flow)
    np.testing.assert_array_equal(np.isnan(checked), flow.mask)
    assert not isinstance(checked, np.ma.MaskedArray)


def test_identity_of_a_model_is_converted_to_json(tmp_path):
    said = {"checkpoint": tmp_path, "scale": (1, np.float32(0.5)), 3: "a"}
    converted = {"checkpoint": str(tmp_path), "scale": [1, "0.5"], "3": "a"}
    assert model_identity(SimpleNamespace(identity=lambda: said)) == converted
    for wrong in ("version 2", {"x": float("nan")}, {"x": {"y": [float("inf")]}}, {"x": {(1, 2): 3}}):
        refusal(lambda said=wrong: model_identity(SimpleNamespace(identity=lambda: said)), ModelError, "identity")


COUNTS = [0, -1, 1.0, "3", None, True]


@pytest.mark.parametrize("value", COUNTS)
def test_value_that_is_not_a_count_or_a_boolean_is_refused(value):
    refusal(lambda: check_count("iterations", value), UsageError, "iterations")
    if value is not True:
        refusal(lambda: check_switch("compile", value), UsageError, "compile")


def test_a_count_may_begin_elsewhere_and_end():
    check_count("levels", 0, least=0)
    check_count("levels", 5, most=5)
    for limits in ({"least": 2}, {"most": 0}):
        refusal(lambda limits=limits: check_count("winsize", 1, **limits), UsageError, "winsize")


@pytest.mark.parametrize("vertical", ["both", "bottom"])
@pytest.mark.parametrize("multiple", [1, 8, 16, 32])
def test_padding_is_up_to_the_next_multiple(vertical, multiple):
    convention = InputConvention(fit="pad", multiple=multiple, vertical=vertical)
    for height in range(1, 70, 3):
        for width in range(1, 70, 4):
            left, right, above, below = convention.padding_sides(height, width)
            fitted = convention.fitted_size(height, width)
            assert fitted == (height + above + below, width + left + right)
            assert all(
                fit % multiple == 0 and 0 <= fit - own < multiple
                for fit, own in zip(fitted, (height, width), strict=True)
            )
            assert right - left in (0, 1)
            assert (above == 0) if vertical == "bottom" else (below - above in (0, 1))


def on(device):
    return SimpleNamespace(device=device)


@pytest.mark.parametrize(
    ("device", "is_on"),
    [("cuda:1", "cuda:1"), (SimpleNamespace(type="cuda"), "namespace(type='cuda')"), (None, "cpu"), ("", "cpu")],
)
def test_device_of_a_model_is_normalised(device, is_on):
    assert device_of(on(device)) == is_on


def _spec(name, device=None):
    return ModelSpec(name, (("device", device),) if device else ())


EVERY = ("cuda:0", "cuda:1", "cuda:2", "cuda:3")


@pytest.mark.parametrize(
    ("name", "option", "model", "devices"),
    [
        ("raft", None, on("cpu"), ()),
        (None, None, object(), ()),
        ("raft", None, on("cuda"), EVERY),
        ("mine:Model", "cuda", on("cuda"), EVERY),
        ("raft", "cuda:2", on("cuda:2"), ("cuda:2",)),
        ("raft", "cuda:2, cuda:3", on("cuda:2"), ("cuda:2", "cuda:3")),
        ("mine:Model", None, on("cuda"), ("cuda",)),  # a user's model that is given no device is where it says
        (None, None, on("cuda"), ("cuda",)),
    ],
)
def test_cuda_is_every_visible_gpu_and_a_number_is_that_one(monkeypatch, name, option, model, devices):
    monkeypatch.setitem(sys.modules, "torch", SimpleNamespace(cuda=SimpleNamespace(device_count=lambda: 4)))
    assert devices_of(name and _spec(name, option), model) == devices


def test_only_gpus_are_listed_and_their_number_is_not_part_of_an_identity():
    refusal(lambda: devices_of(_spec("raft", "cuda:0,cpu"), on("cuda:0")), UsageError, "--device")
    model = SimpleNamespace(identity=lambda: {"name": "mine"})
    assert _spec("m", "cuda:0,cuda:1").identity(model) == _spec("m", "cuda:2,cuda:3").identity(model)
