"""The report page in a run's folder."""

from __future__ import annotations

from ...atomic import write_bytes
from ...runs.run import Run


def write_report(run: Run) -> None:
    """Write `report.html` into a run's folder, with the examples that are there.

    Raises:
        DataError: the folder cannot be written.
    """
    from .content import run_content
    from .page import render_site

    write_bytes(run.path / "report.html", render_site(run_content(run)).encode())
