"""Run exported networks from the command line."""

from pathlib import Path

import pytest

pytest.importorskip("onnx", reason="needs the onnx extra")
pytest.importorskip("onnxruntime", reason="needs the onnx extra")

import robustflow as rf

from ..models import onnx_graphs as graphs


def test_onnx_file_gives_the_same_rows_as_model_or_as_checkpoint(robustflow, tmp_path):
    graphs.channels(tmp_path / "net.onnx")
    run = ["run", "-c", "contrast", "-s", "1,2", "-O", "scaling=-1-1", "-O", "order=bgr", "--batch-size", "2"]
    for i, model in enumerate((["--model", "net.onnx"], ["--model", "onnx", "--checkpoint", "net.onnx"])):
        robustflow.prints(*run, *model, "--output", f"run{i}")
    one, other = (rf.Result(tmp_path / f"run{i}") for i in range(2))
    assert one.rows.equals(other.rows)
    assert one.manifest.identity.model.settings["input"]["mean"] == [127.5] * 3
    assert one.name == "onnx:net"


def test_onnx_file_given_as_model_and_checkpoint_is_refused(robustflow):
    Path("net.onnx").write_bytes(b"a network")
    robustflow.refuses("run", "--model", "net.onnx", "--checkpoint", "net.onnx")
