"""Previews match the library's output; one prediction runs at a time, and only while a client still waits for it."""

from __future__ import annotations

import base64
import io
import json
from contextlib import ExitStack

import numpy as np
import pytest
from PIL import Image

import robustflow as rf
from robustflow.app.models import Models
from robustflow.core.errors import ModelError
from robustflow.corruptions import load_corruption
from robustflow.data.benchmarks.paper import DEMO_CLASSES
from robustflow.models import ModelRef

from .launch import SCRIPTED
from .library import direct_numbers


@pytest.mark.parametrize(
    ("layers", "corruption", "severity", "seed"),
    [
        ([("fog", 3)], "fog", 3, 0),
        ([("impulse_noise", 2)], "impulse_noise", 2, 7),
        ([("fog", 2), ("jpeg_compression", 4)], "fog:2+jpeg_compression:4", 4, 1),
        ([("fog_3d", 5)], "fog_3d", 5, 2),
        ([("frost", 3)], load_corruption("frost", classes=DEMO_CLASSES), 3, 0),
    ],
)
def test_numbers_equal_those_of_the_library(app, demo_is_small, layers, corruption, severity, seed):
    request = {"layers": [{"name": name, "severity": level} for name, level in layers], "seed": seed, "frames": True}
    status, messages = app.preview(**request)
    assert status == 200
    result = messages[-1]["result"]
    data = rf.load_dataset("motorcycle")
    sample = data.load("motorcycle")
    depth = data.depth(sample)
    truth = (sample.flow, sample.valid)
    assert result["numbers"] == pytest.approx(
        direct_numbers(sample.frames, truth, corruption, severity, seed, sample.key, depth=depth)
    )
    assert (result["truth"], result["size"], result["invalid"]) == (True, [*sample.shape[::-1]], 0)
    stages = [message["stage"] for message in messages[:-1]]
    assert stages[0] == "starting"
    assert stages[-1] == "drawing"
    shown = {name: _picture(address) for name, address in result["pictures"].items()}
    assert set(shown) == {
        "frame1", "frame2", "corrupted1", "corrupted2", "clean_flow", "flow", "truth_flow", "error"
    }  # fmt: skip
    corrupted = rf.corrupt(*sample.frames, corruption, severity, seed=seed, key=sample.key, depth=depth)
    for name, frame in zip(("corrupted1", "corrupted2", "frame1", "frame2"), corrupted + sample.frames, strict=True):
        np.testing.assert_array_equal(shown[name], frame)
    names = {"depth": depth, "corrupt": rf.corrupt, "load_corruption": load_corruption, "robustflow": rf}
    called = eval(result["call"], names, dict(zip(("frame1", "frame2"), sample.frames, strict=True)))
    np.testing.assert_array_equal(called, corrupted)


def test_a_corruption_without_truth_has_rcre_only_and_the_pair_keeps_its_truth(app, demo_is_small):
    _, messages = app.preview(layers=[{"name": "elastic_transform", "severity": 1}], frames=True)
    result = messages[-1]["result"]
    assert result["truth"] is False
    assert {name for name, value in result["numbers"].items() if value is not None} == {"rcre"}
    assert "truth_flow" in result["pictures"]


def _picture(address: str) -> np.ndarray:
    kind, _, data = address.partition(",")
    assert kind == "data:image/png;base64"
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))))


@pytest.mark.parametrize(
    ("changed", "culprit"),
    [
        ({"layers": [{"name": "fog", "severity": 6}]}, "severity"),
        ({"layers": [{"name": "fog", "severity": True}]}, "severity"),
        ({"layers": [{"name": "fog:2+snow", "severity": 1}]}, "name"),
        ({"layers": []}, "layers"),
        ({"layers": [{"name": "fog", "severity": 1}] * 5}, "layers"),
        ({"model": "os:system"}, "os:system"),
        ({"model": "/etc"}, "/etc"),
        ({"source": "../../etc"}, "frames"),
        ({"index": -1}, "index"),
        ({"seed": 2**40}, "seed"),
        ({"seed": 1.5}, "seed"),
        ({"unknown": 1}, "unknown"),
        ({"page": "p" * 100}, "page"),
        ({"page": None}, "page"),
        ({"checkpoint": "things"}, "dis: "),
    ],
)
def test_impossible_request_is_refused_in_one_line(app, changed, culprit):
    status, (answer,) = app.preview(**changed)
    assert status == 400
    assert culprit in answer["error"]
    assert "\n" not in answer["error"]


def test_unknown_corruption_or_pair_is_reported_as_the_last_message(app):
    layers = [{"name": "no_such_thing", "severity": 1}]
    assert "no_such_thing" in app.preview(layers=layers)[1][-1]["error"]
    assert "pair 2" in app.preview(index=1)[1][-1]["error"]


@pytest.mark.parametrize("body", ["", "[]", "null", "{", '{"a": NaN}', "[" * 10000, '"\\ud800"', b"\xff\xfe"])
def test_malformed_request_body_is_refused(app, body):
    status, answer, _ = app.ask("POST", "/preview", body)
    assert (status, list(json.loads(answer))) == (400, ["error"])


def test_too_large_request_is_refused(app):
    assert app.ask("POST", "/preview", b" " * 20000)[0] == 413


def test_failing_model_is_reported_in_one_line(app):
    with app.model_does("fail"):
        error = app.preview(model=SCRIPTED)[1][-1]["error"]
    assert error.startswith("sample 'motorcycle', ")
    assert "ValueError: <b>no</b> weights at all (" in error
    assert app.preview()[1][-1]["result"]["numbers"]["epe"] > 0, "the next one is answered"


def test_a_model_that_ends_its_program_does_not_end_the_app(app):
    with app.model_does("exit"):
        for _ in range(2):
            assert "SystemExit" in app.preview(model=SCRIPTED)[1][-1]["error"]
    assert "result" in app.preview()[1][-1]


def test_a_newer_request_of_the_same_page_ends_the_older(app):
    def ask(page, severity):
        layers = [{"name": "contrast", "severity": severity}]
        return stack.enter_context(app.waiting_preview(page=page, layers=layers, seed=severity))

    def answer(response):
        return json.loads(response.read().splitlines()[-1])

    with ExitStack() as stack:
        with app.model_does("wait"):
            first = ask("a", 1).getresponse()
            assert b"stage" in first.readline()
            other, second = ask("b", 2), ask("a", 3)
            assert answer(first) == {"outdated": True}
            third = ask("a", 4)
            assert answer(second.getresponse()) == {"outdated": True}
        assert "result" in answer(other.getresponse())
        assert "severity=4" in answer(third.getresponse())["result"]["call"]


def test_the_page_is_served_while_a_model_works(app):
    with app.waiting_preview() as connection:
        with app.model_does("wait"):
            response = connection.getresponse()
            while b"predicting" not in response.readline():
                pass
            assert app.ask("GET", "/choices")[0] == 200
        assert b'"result"' in response.read()


def _needs_weights():
    raise ModelError("model 'net' needs its checkpoint: get it, and give its path as --checkpoint")


def test_an_error_of_loading_names_the_field_and_no_option(monkeypatch):
    models = Models([ModelRef.parse("mine:net")])
    monkeypatch.setattr(ModelRef, "load", lambda ref: _needs_weights())
    with pytest.raises(ModelError) as caught:
        models.load("mine:net")
    assert "--checkpoint" not in str(caught.value)


def test_choices_list_models_and_corruptions_of_pairs(app):
    found = json.loads(app.ask("GET", "/choices")[1])
    models = {model["name"]: model for model in found["models"]}
    assert next(iter(models)) == SCRIPTED
    assert {"dis", "farneback"} <= set(models)
    assert not {"onnx", "torch_export", "precomputed"} & set(models), "they need a file"
    assert not models["dis"]["takes_checkpoint"]
    offered = {name for names in found["families"].values() for name in names}
    assert {"fog", "elastic_transform"} <= offered
    assert not {"h264_crf", "object_motion_blur"} & offered, "a pair has no clip"
