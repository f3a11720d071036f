"""What is missing is reported before any heavy library is imported."""

import json
import subprocess
import sys
from importlib import util

import pytest

from robustflow import load_model
from robustflow.core.errors import AssetError

from ..refusals import refused

HEAVY = ("torch", "torchvision", "ptlflow", "onnx", "onnxruntime", "matplotlib", "polars", "numba", "skimage")
SCRIPT = f"""
import json, sys
from robustflow.cli.main import main
for arguments in json.loads(sys.argv[1]):
    sys.argv = ["robustflow", "run", *arguments]
    try:
        main()
    except SystemExit as stop:
        print(f"exit {{stop.code}}", file=sys.stderr)
print([name for name in {HEAVY!r} if name in sys.modules])
"""

MISSING = (
    (("-m", "raft"), "model 'raft' needs its checkpoint: choose one of chairs, things, sintel, kitti"),
    (("-m", "raft", "--checkpoint", "no.ckpt"), "model 'raft': there is no file no.ckpt"),
    (("-m", "raft_large", "--checkpoint", "no.pth"), "model 'raft_large': there is no file no.pth"),
    (("-m", "arflow"), "model 'arflow' needs its checkpoint: get pwclite_ar.tar"),
    (("-m", "samflow_b", "--checkpoint", "no.pth"), "model 'samflow_b': there is no file no.pth"),
    (("-m", "missing.onnx"), "missing.onnx: no such file; pass the path of the exported network"),
)


def test_missing_files_and_libraries_are_reported_before_loading(tmp_path):
    """One process for all commands, because each has to start without the heavy libraries."""
    arguments = json.dumps([arguments for arguments, _ in MISSING])
    ran = subprocess.run([sys.executable, "-c", SCRIPT, arguments], capture_output=True, text=True, cwd=tmp_path)
    lines = ran.stderr.splitlines()
    assert len(lines) == 2 * len(MISSING), ran.stderr
    for (_, says), line, code in zip(MISSING, lines[::2], lines[1::2], strict=True):
        assert line.startswith(f"robustflow: {says}") or "which is not installed" in line
        assert code == "exit 1"
    assert ran.stdout == "[]\n"


@pytest.mark.parametrize(
    ("name", "library", "says"),
    [
        *((name, "ptlflow", r"needs ptlflow.*'robustflow\[ptlflow\]'") for name in ("raft", "dpflow", "memflow")),
        *((name, "torch", r"needs PyTorch.*'robustflow\[torch\]'") for name in ("arflow", "samflow_t")),
        ("raft_small", "torchvision", r"needs torchvision.*'robustflow\[torch\]'"),
    ],
)
def test_without_the_extra_the_message_names_it(name, library, says, monkeypatch):
    find = util.find_spec
    monkeypatch.setattr("robustflow.core.plugins.find_spec", lambda module: None if module == library else find(module))
    with refused(AssetError, f"model '{name}' {says}"):
        load_model(name, checkpoint="random")
