"""Run the scripts in `bench/` on small inputs, and `bench/gpu.py` on the CPU: every section that a CPU can compute, and
the report of a failing section.
"""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from robustflow.training.plan_text import TABLE

ROOT = Path(__file__).resolve().parent.parent
BENCH = ROOT / "bench"
TINY = next(line for line in (ROOT / "src/robustflow/training" / TABLE).read_text().splitlines() if "tiny," in line)
SMALL = {
    "attacks": ("--steps 1 --rounds 1", r"raft_small 256x320: passes \d\.\d+ s"),
    "augmentation": ("--rounds 1", r"KITTI( +\d+\.\d){2} "),
    "averaging": ("--pairs 3", "303 rows in 1 shards(.|\n)*means [0-9a-f]{12}"),
    "calibrated_severities": ("--corruptions contrast", r"contrast .* as shipped"),
    "corruptions": ("--size 64x96 --seconds 0", r"contrast +\d+\.\d\d(.|\n)*sum without"),
    "dis_rgb": ("--points 1 --rounds 1", r"mean of 1 of motorcycle( +\d\.\d+ / *\d+){6}"),
    "first_command": ("--rounds 0", r"corruption: fog +\d+\.\d\d"),
    "gradients": ("networks tiny", r"\| tiny \| 1\.00 \| 1\.00 \| whole \|"),
    "overhead": ("--pairs 1 --workers 1 --latency 1", r"steady \d+\.\d+(.|\n)*corrupt  mean of 100 cells"),
    "robust_training": ("--seeds 1 --steps 1 --pairs 2 --size 64x96", r"CRE under weather(.|\n)*no_weather +[+-]0"),
    "psf": ("--rounds 1", r"720x1280: .* error 0\.\d+ rms"),
    "scale": ("--cells 101 --folder .", "101 report "),
    "shapes": ("--pairs 2 --size 64x96", r"2 pairs of 64x96: \d+\.\d per second of CPU time"),
    "site": ("--models 3 --loads 1", r"with 3 more models +\d\.\d\d"),
    "training_memory": ("tiny", re.escape(TINY)),
    "video": ("--frames 32 --preset ultrafast", r"object motion blur \(5 severities\) +\d+\.\d"),
}
"""Arguments for a small run of each script, and a pattern of its results."""
PARTS = {"gpu_sections", "reference_corruptions", "synthetic_runs"}
"""Modules of other scripts."""
LONG = {"kills", "quick_subset", "ray_engine", "uncertainty"}
"""Scripts whose smallest runs take minutes."""
TORCH = {"attacks", "augmentation", "gradients", "robust_training", "training_memory"}


def test_every_script_is_run_here():
    assert {path.stem for path in BENCH.glob("*.py")} == {*SMALL, *PARTS, *LONG, "gpu"}


@pytest.mark.slow
@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.torch] * (name in TORCH)) for name in SMALL])
def test_a_script_prints_its_results(name, tmp_path):
    if name in TORCH:
        pytest.importorskip("torchvision", reason="needs the torch extra")
    arguments, result = SMALL[name]
    command = [sys.executable, str(BENCH / f"{name}.py"), *arguments.split()]
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src")}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=1800)
    assert done.returncode == 0, done.stderr[-3000:]
    assert re.search(result, done.stdout + done.stderr), done.stdout


def measured(folder, *arguments):
    pytest.importorskip("torch", reason="needs the torch extra")
    pytest.importorskip("ptlflow", reason="needs the ptlflow extra")
    command = [sys.executable, str(BENCH / "gpu.py"), "--device", "cpu", "--quick", "--output", str(folder), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=1800)
    return done.returncode, json.loads((folder / "results.json").read_text())["rows"], (folder / "results.md")


@pytest.mark.torch
@pytest.mark.slow
def test_every_section_reports_what_is_expected_on_the_cpu(tmp_path):
    code, rows, table = measured(tmp_path, "--budget", "600")
    assert [row for row in rows if row["as expected"] is False] == []
    assert code == 0
    whole = [row["section"] for row in rows if row["what"] == "the whole section"]
    assert whole == ["networks", "runs", "feeders", "memory", "training", "resume", "loader", "attacks"]
    assert all(sum(row["section"] == name for row in rows) > 1 for name in whole)
    assert table.read_text().count("\n| ") == len(rows) + 1


@pytest.mark.torch
@pytest.mark.slow
def test_a_section_beyond_its_budget_is_a_row_and_the_next_one_runs(tmp_path):
    code, rows, table = measured(tmp_path, "--budget", "1", "attacks", "resume")
    assert code == 1
    assert [row["section"] for row in rows] == ["attacks", "resume"]
    assert all("stopped after its time budget of 1 s" in row["figures"]["failed"] for row in rows)
    assert "**no**" in table.read_text()
