"""Write the report page in a run's folder."""

from __future__ import annotations

from ...runs.run import Run
from ...runs.staleness import is_current, source_digest, write_made

REPORT = "report.html"


def write_report(run: Run) -> None:
    """Write `report.html`, with any existing example pictures, to a run's folder unless it is up to date."""
    source = source_digest(run.path, run.rows_digest, run.manifest, beside=True)
    if is_current(run.path, REPORT, source):
        return
    from .content import run_content
    from .page import render_site

    write_made(run.path, REPORT, render_site(run_content(run)).encode(), source)
    run.keep()
