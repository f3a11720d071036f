"""What a model raises or returns is reported with the sample; the frames and devices that a model gets."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robustflow.core.errors import ModelError, UsageError
from robustflow.models import ModelRef, Window
from robustflow.models.calls import predict_checked
from robustflow.models.devices import device_of, devices_of
from robustflow.models.objects import FunctionModel
from robustflow.models.protocols import model_identity, place_of_pair, window_of

from ..refusals import refusal

FRAMES = (np.zeros((4, 5, 3), np.uint8),) * 2


def predicted(function):
    return predict_checked(FunctionModel(function, {}), FRAMES, "a", "fog", 3)


def test_error_of_a_model_names_the_sample_and_the_line_of_its_code():
    error = refusal(lambda: predicted(lambda *_: [][1]), ModelError, "sample 'a', fog severity 3")
    assert "test_calls.py:" in str(error)

    def small(frame1, frame2):
        raise ModelError("4x5", "too small")

    refusal(lambda: predicted(small), ModelError, "4x5")


class _OnAGpu:
    """An object that NumPy cannot convert, like a tensor on a GPU or one that requires gradients."""

    def __array__(self, *args, **kwargs):
        raise TypeError("can't convert cuda:0 device type tensor to numpy.")


@pytest.mark.parametrize(
    "answer", [_OnAGpu(), None, [[1.0], [1.0, 2.0]], np.zeros((2, 4, 5), np.float32), np.zeros((4, 5, 2), np.int16)]
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


def on(device):
    return SimpleNamespace(device=device)


@pytest.mark.parametrize(
    ("device", "is_on"),
    [("cuda:1", "cuda:1"), (SimpleNamespace(type="cuda"), "namespace(type='cuda')"), (None, "cpu"), ("", "cpu")],
)
def test_device_of_a_model_is_normalised(device, is_on):
    assert device_of(on(device)) == is_on


def _ref(name, device=None):
    return ModelRef.parse(name, (("device", device),) if device else ())


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
    assert devices_of(name and _ref(name, option), model) == devices


def test_only_gpus_are_listed_and_their_number_is_not_part_of_an_identity():
    refusal(lambda: devices_of(_ref("raft", "cuda:0,cpu"), on("cuda:0")), UsageError, "--device")
    model = SimpleNamespace(identity=lambda: {"name": "mine"})
    assert _ref("mine:Model", "cuda:0,cuda:1").identity(model) == _ref("mine:Model", "cuda:2,cuda:3").identity(model)


there = st.builds(lambda before, after: range(-before, 2 + after), st.integers(0, 9), st.integers(0, 9))
windows = st.builds(Window, st.integers(0, 5), st.integers(0, 5), st.sampled_from(["repeat", "short", "inside"]))


@given(window=windows, there=there)
def test_window_contains_the_pair_and_only_existing_frames(window, there):
    offsets = window.offsets(there)
    first = place_of_pair(offsets)
    assert offsets[first : first + 2] == (0, 1)
    assert set(offsets) <= set(there)
    assert list(offsets) == sorted(offsets)
    assert list(dict.fromkeys(offsets)) == list(range(offsets[0], offsets[-1] + 1)), "no frame may be skipped"


@given(window=windows, there=there)
def test_window_has_as_many_frames_as_its_ends_allow(window, there):
    offsets, whole = window.offsets(there), window.before + 2 + window.after
    if window.ends == "repeat":
        assert len(offsets) == whole
        assert place_of_pair(offsets) == window.before
    elif window.ends == "inside":
        assert len(offsets) == min(whole, len(there))
    else:
        assert place_of_pair(offsets) == min(window.before, -there.start)
        assert len(offsets) - place_of_pair(offsets) == 2 + min(window.after, there.stop - 2)


@given(window=windows, there=there)
def test_frames_farther_than_the_reach_make_no_difference(window, there):
    near = range(max(there.start, -window.reach), min(there.stop, 2 + window.reach))
    assert window.offsets(near) == window.offsets(there)


def test_window_is_read_from_a_tuple_or_list():
    assert window_of(SimpleNamespace(window=(3, 1))) == Window(3, 1, "repeat")
    assert window_of(SimpleNamespace(window=[0, 2, "short"])) == Window(0, 2, "short")


@pytest.mark.parametrize("declared", [None, 2, (2,), (0, 0), (-1, 1), (1.0, 1), (True, 1), (1, 1, "wrap"), "21"])
def test_invalid_window_is_refused(declared):
    refusal(lambda: window_of(SimpleNamespace(window=declared)), ModelError, "window")
