"""A missing file or checkpoint is reported before any heavy library is imported."""

import subprocess
import sys

import pytest

HEAVY = ("torch", "torchvision", "ptlflow", "onnx", "onnxruntime", "matplotlib", "polars", "numba", "skimage")
SCRIPT = f"""
import sys
from robustflow.cli.main import main
sys.argv = ["robustflow", "run", *sys.argv[1:]]
try:
    main()
finally:
    loaded = [name for name in {HEAVY!r} if name in sys.modules]
    assert not loaded, loaded
"""


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("-m", "raft"), "model 'raft' needs its checkpoint: choose one of chairs, things, sintel, kitti"),
        (("-m", "raft", "--checkpoint", "no.ckpt"), "model 'raft': there is no file no.ckpt"),
        (("-m", "raft_large", "--checkpoint", "no.pth"), "model 'raft_large': there is no file no.pth"),
        (("-m", "arflow"), "model 'arflow' needs its checkpoint: get pwclite_ar.tar"),
        (("-m", "samflow_b", "--checkpoint", "no.pth"), "model 'samflow_b': there is no file no.pth"),
        (("-m", "missing.onnx"), "missing.onnx: no such file; pass the path of the exported network"),
    ],
)
def test_what_is_missing_is_reported_at_once(arguments, says, tmp_path):
    ran = subprocess.run([sys.executable, "-c", SCRIPT, *arguments], capture_output=True, text=True, cwd=tmp_path)
    if "which is not installed" in ran.stderr:
        pytest.skip("needs the extra of this model")
    assert ran.stderr.startswith(f"robustflow: {says}"), ran.stderr
    assert ran.stderr.count("\n") == 1
    assert ran.returncode == 1
