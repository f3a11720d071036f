"""An ONNX network that requests too much memory or time is refused, and Ctrl-C ends it."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnx", reason="needs the onnx extra")
pytest.importorskip("onnxruntime", reason="needs the onnx extra")

import robustflow as rf
from robustflow.core.errors import ModelError, UsageError

from ..refusals import refused
from . import onnx_graphs as graphs
from .textures import channel_flow, noise_pair

_PREDICT = """
import resource, sys
import numpy as np
import robustflow as rf
model = rf.load_model(sys.argv[1])
print("loaded", flush=True)
frame = np.zeros((16, 24, 3), np.uint8)
try:
    model.predict(frame, frame)
except rf.RobustFlowError as error:
    assert sys.argv[1] in str(error) or "the network failed" in str(error)
    print(type(error).__name__, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""


def _started(network: Path) -> subprocess.Popen[str]:
    """Start a script, without a guard for child processes, that loads a network and predicts."""
    script = network.with_name("predict.py")
    script.write_text(_PREDICT)
    begun = subprocess.Popen(
        [sys.executable, script, network], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    assert begun.stdout is not None
    assert begun.stdout.readline() == "loaded\n"
    return begun


def test_network_that_requests_gigabytes_is_refused_before_it_gets_them(tmp_path):
    path = graphs.hungry(tmp_path / "net.onnx")
    assert path.stat().st_size < 500
    kind, peak = _started(path).communicate(timeout=100)[0].split()
    assert kind == "ModelError"
    assert int(peak) < 1_000_000  # KiB


@pytest.mark.usefixtures("quick_workers")
def test_network_that_never_ends_is_refused_after_the_time_limit_and_can_be_called_again(tmp_path):
    path = graphs.endless(tmp_path / "net.onnx")
    assert path.stat().st_size < 500
    model = rf.load_model(str(path), time_limit=1)
    for _ in range(2):
        with refused(ModelError, "longer than 1 s"):
            model.predict(*noise_pair())


@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGKILL])
def test_signal_ends_a_network_that_never_ends(tmp_path, stop):
    begun = _started(graphs.endless(tmp_path / "net.onnx"))
    children = [int(pid) for pid in Path(f"/proc/{begun.pid}/task/{begun.pid}/children").read_text().split()]
    assert children
    begun.send_signal(stop)
    begun.communicate(timeout=30)
    end = time.monotonic() + 60
    while running := [pid for pid in children if _runs(pid)]:
        assert time.monotonic() < end, f"{running} still run"
        time.sleep(0.05)


def _runs(pid: int) -> bool:
    try:
        return "zombie" not in Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return False


@pytest.mark.usefixtures("quick_workers")
def test_memory_limit_is_raised_by_the_option(tmp_path):
    with refused(ModelError, "the network failed"):
        rf.load_model(str(graphs.hungry(tmp_path / "net.onnx")), memory_limit=0.5).predict(*noise_pair())
    model = rf.load_model(str(graphs.channels(tmp_path / "net.onnx")), memory_limit=1, scaling="0-255")
    np.testing.assert_array_equal(model.predict(*noise_pair()), channel_flow(*noise_pair()))


@pytest.mark.parametrize("limits", [{"memory_limit": 0}, {"time_limit": -1}, {"time_limit": "long"}])
def test_limit_that_is_not_a_positive_number_is_refused(tmp_path, limits):
    with refused(UsageError, next(iter(limits))):
        rf.load_model(str(graphs.channels(tmp_path / "net.onnx")), **limits)
