"""Test the layers of the architecture (docs/design/architecture.md): import-linter checks the contracts in
pyproject.toml."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def _lint(source: Path) -> subprocess.CompletedProcess[str]:
    """Check the contracts for the package in `source`, including late and type-checking imports."""
    program = "import sys; from importlinter.cli import lint_imports_command; lint_imports_command(sys.argv[1:])"
    return subprocess.run(
        [sys.executable, "-c", program, "--no-cache", "--config", str(ROOT / "pyproject.toml")],
        env={**os.environ, "PYTHONPATH": str(source), "COLUMNS": "200"},
        capture_output=True,
        text=True,
        timeout=300,
    )


def test_imports_keep_the_contracts():
    linted = _lint(ROOT / "src")
    assert linted.returncode == 0, linted.stdout[-3000:]


def test_planted_violations_of_the_contracts_are_reported(tmp_path):
    """Plant an upward late import, an upward type-checking import, and two files that import each other."""
    package = tmp_path / "robustflow"
    shutil.copytree(ROOT / "src" / "robustflow", package, ignore=shutil.ignore_patterns("__pycache__", "*.csv"))
    late = "def table() -> object:\n    from ..report.table import Table\n\n    return Table\n"
    typed = "from typing import TYPE_CHECKING\n\nif TYPE_CHECKING:\n    from ..run.run import Run\n"
    (package / "metrics" / "planted.py").write_text(late)
    (package / "media" / "planted_typed.py").write_text(typed)
    (package / "media" / "planted.py").write_text("from . import planted_too\n")
    (package / "media" / "planted_too.py").write_text("def planted() -> object:\n    from . import planted\n")
    linted = _lint(tmp_path)
    assert linted.returncode == 1
    assert "robustflow.metrics.planted -> robustflow.report.table" in linted.stdout
    assert "robustflow.media.planted_typed -> robustflow.run.run" in linted.stdout
    cycles = linted.stdout.partition("No file imports itself through others\n---")[2]
    assert "robustflow.media" in cycles
    assert "planted" in cycles


def test_no_test_module_imports_from_a_test_module():
    """Objects that several modules need are fixtures, or live in a module without tests."""
    importing = re.compile(r"^\s*(?:from|import) (?:[\w.]*\.)?test_", re.MULTILINE)
    modules = (ROOT / "tests").rglob("*.py")
    assert [str(path) for path in modules if importing.search(path.read_text(encoding="utf-8"))] == []
