"""The page offers the models that can be loaded by name and that predict from two frames."""

import pytest

from robustflow.app.pairs import Models
from robustflow.core.errors import ModelError, UsageError
from robustflow.models import ModelSpec

from ..refusals import refusal


def test_model_that_needs_a_file_is_offered_only_with_one():
    offered = Models([]).names
    assert offered[:2] == ["dis", "farneback"]
    assert not {"onnx", "torch_export", "precomputed"} & set(offered)
    assert Models([ModelSpec("mine.onnx")]).names[0] == "mine.onnx"


def _needs_weights():
    raise ModelError("model 'net' needs its checkpoint: get it, and give its path as --checkpoint")


def test_an_error_of_loading_names_the_field_and_no_option(monkeypatch):
    models = Models([ModelSpec("net")])
    monkeypatch.setattr(ModelSpec, "load", lambda spec: _needs_weights())
    with pytest.raises(ModelError) as caught:
        models.load("net")
    assert "--checkpoint" not in str(caught.value)


def test_a_name_that_is_not_offered_is_refused():
    refusal(lambda: Models([]).check("os:system"), UsageError, "os:system")
