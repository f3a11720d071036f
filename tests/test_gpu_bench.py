"""Run bench/gpu.py on the CPU: every section that a CPU can compute, and the report of a failing section."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("torch", reason="needs the torch extra")
pytest.importorskip("ptlflow", reason="needs the ptlflow extra")

SCRIPT = Path(__file__).resolve().parent.parent / "bench" / "gpu.py"
pytestmark = [pytest.mark.torch, pytest.mark.slow]


def measured(folder, *arguments):
    command = [sys.executable, str(SCRIPT), "--device", "cpu", "--quick", "--output", str(folder), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=1800)
    return done.returncode, json.loads((folder / "results.json").read_text())["rows"], (folder / "results.md")


def test_every_section_reports_what_is_expected_on_the_cpu(tmp_path):
    code, rows, table = measured(tmp_path, "--budget", "600")
    assert [row for row in rows if row["as expected"] is False] == []
    assert code == 0
    whole = [row["section"] for row in rows if row["what"] == "the whole section"]
    assert whole == ["networks", "runs", "feeders", "memory", "training", "resume", "loader", "attacks"]
    assert all(sum(row["section"] == name for row in rows) > 1 for name in whole)
    assert table.read_text().count("\n| ") == len(rows) + 1


def test_a_section_beyond_its_budget_is_a_row_and_the_next_one_runs(tmp_path):
    code, rows, table = measured(tmp_path, "--budget", "1", "attacks", "resume")
    assert code == 1
    assert [row["section"] for row in rows] == ["attacks", "resume"]
    assert all("stopped after its time budget of 1 s" in row["figures"]["failed"] for row in rows)
    assert "**no**" in table.read_text()
