"""The report page in a run's folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from ...atomic import write_bytes
from ...runs.made_from import is_current, made_from, note_made
from ...runs.run import Run

if TYPE_CHECKING:
    from .figures import FigureGroup

REPORT = "report.html"


def report_figures(folder: Path) -> list[FigureGroup]:
    """The figures of the report of the run in a folder; they do not depend on its examples."""
    from .content import run_content
    from .figures import page_figures

    return page_figures(run_content(Run(folder)))


def write_report(run: Run, figures: Callable[[], list[FigureGroup]] | None = None) -> None:
    """Write `report.html` into a run's folder, with the existing examples; not again while nothing has changed.

    Args:
        run: of the report.
        figures: gives `report_figures` of the run, if they are being drawn elsewhere.

    Raises:
        DataError: the folder cannot be written.
    """
    source = made_from(run.path, run.rows_digest, run.manifest, beside=True)
    if is_current(run.path, REPORT, source):
        return
    from .content import run_content
    from .page import render_site

    write_bytes(run.path / REPORT, render_site(run_content(run), figures=figures).encode())
    note_made(run.path, REPORT, source)
    run.keep()
