"""Audit a results file, a run's folder, or a record of a run."""

from __future__ import annotations

from pathlib import Path

from ..analysis.audit import Audit, audit_results, audit_run
from ..analysis.results_file import read_results
from ..layout import user_path
from .load import is_record, load_any_run


def audit(path: str | Path) -> Audit:
    """Audit a results file (CSV, see `analysis.results_file.read_results`) or a run, given as its folder or a record.

    Raises:
        DataError, RunError: the file is of neither kind, or cannot be read.
    """
    path = user_path(path)
    if path.is_dir() or is_record(path):
        return audit_run(load_any_run(path), str(path))
    return audit_results(read_results(path), audited=str(path))
