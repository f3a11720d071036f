"""`evaluate` shows its progress in a notebook by default; a real kernel executes a real cell.

The test needs nbclient and ipykernel, which the project does not require; it is skipped without them.
"""

from __future__ import annotations

import pytest

nbformat = pytest.importorskip("nbformat", reason="needs nbclient and ipykernel: pip install nbclient ipykernel")
nbclient = pytest.importorskip("nbclient", reason="needs nbclient and ipykernel: pip install nbclient ipykernel")
pytest.importorskip("ipykernel", reason="needs ipykernel: pip install nbclient ipykernel")

CELL = """
import robustflow
robustflow.evaluate("farneback", corruptions=["contrast"], severities=[1], output="run", examples=False{more})
None
"""


def _output(folder, more: str = "") -> str:
    """Return all output of a cell as plain text."""
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(CELL.format(more=more))])
    nbclient.NotebookClient(notebook, timeout=240, resources={"metadata": {"path": str(folder)}}).execute()
    shown = notebook.cells[0].outputs
    return "".join(one.get("text", "") or one.get("data", {}).get("text/plain", "") for one in shown)


def test_notebook_shows_progress_by_default(tmp_path):
    text = _output(tmp_path)
    assert "run: 2 steps (one pair under one condition per step)" in text
    assert "2/2" in text
    assert (tmp_path / "run" / "summary.json").is_file()


def test_notebook_shows_no_progress_if_switched_off(tmp_path):
    assert "step" not in _output(tmp_path, ", progress=False")
